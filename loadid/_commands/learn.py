"""``loadid learn``: training sets, learned maps, what they are worth, and what they answer."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.errors import InputError

from .. import _toml
from .._toml import PlanReader
from . import (
    Bar,
    Command,
    UsageError,
    add_details,
    add_log_options,
    channels,
    count,
    emit,
    exit_code,
    load_model,
    one_record,
    require_outputs,
    settings,
)

if TYPE_CHECKING:
    from .._families.learned import FittedMap

ACTIONS = ("generate", "fit", "check", "run", "demo")
DEMOS = "loadid.demos"  # entry points of demonstrations that other packages bring
NAMES = {
    "plan": ("model", "truth", "sensor", "set", "draws", "seed", "workers", "declaration", "page", "map"),
    "map": ("engine", "output", "hold", "coverage", "seed", "file", "settings"),
    "sensor's map": ("engine", "seed", "file", "settings"),
}
EXAMPLES = """\
examples:
  learn maps of a small skin from 1500 simulated presses, with a picture of truth, linear map, network and alarm:
    loadid learn demo --out learn-demo
  draw the training set that a job declares, and learn a map from it:
    loadid learn generate job.toml
    loadid learn fit job.toml -o map.h5     # a network: killed and run again, it goes on (map.training.h5)
  hold it against a set of another seed, and use it:
    loadid learn check map.h5 other-set
    loadid learn run map.h5 log.csv -o load.h5
    loadid identify log.csv --model map.h5 -o load.h5

JOB.toml names a model file and the folder of a training set, and may say how each is made (a gel pad is a table
[sensor] in place of the model, and its map is for loadid tactile FRAMES --map):
    model = "model.h5"
    set = "training"
    draws = 600
    seed = 1
    declaration = "loads.toml"      # what is drawn (docs/generate.md)
    truth = "finer.h5"              # optional: a model better than that of the map
    [map]
    engine = "linear"     # or "torch"
    output = "load"       # or "resultant"
paths count from the job.
"""


def job_of(path: str | Path) -> tuple[dict[str, Any], PlanReader, Path]:
    """A job, its reader and the folder that its paths count from.

    Raises
    ------
    InputError
        No such file, no TOML, keys or values that are none.
    """
    plan = PlanReader(str(path), NAMES)
    job = _toml.read(path, "job")
    plan.known(job, "plan", str(path))
    plan.known(plan.table(job, "map"), "map", "[map]")
    for name in ("draws", "seed", "workers"):
        if name in job and (isinstance(job[name], bool) or not isinstance(job[name], int) or job[name] < 0):
            plan.refused(name, job[name], "a whole number")
    return job, plan, Path(path).resolve().parent


def fitted(path: str | Path, progress: Any = None, checkpoint: str | Path | None = None) -> FittedMap:
    """The map of a job; a network's training is kept in `checkpoint` where the job names no file of its own.

    Raises
    ------
    InputError
        From the job, the training set and the family.
    """
    from .._families.learned import LearnedMap
    from ..generate import TrainingSet
    from ..generate._plan import of_sensor

    job, plan, folder = job_of(path)
    told = dict(plan.table(job, "map"))
    own = told.pop("settings", {})
    told.pop("file", None)
    if not isinstance(own, dict):
        plan.refused("settings of [map]", own, "a table [map.settings]")
    if "checkpoint" in own:
        own["checkpoint"] = folder / plan.text(own, "checkpoint", "[map.settings]")
    elif told.get("engine") == "torch" and checkpoint is not None:
        own["checkpoint"] = checkpoint
    training = TrainingSet.open(folder / plan.text(job, "set", str(path)))
    if "sensor" in job:
        plan.known(told, "sensor's map", "[map]")
        learn = of_sensor(job, plan, Path(path).resolve())[2]
        learned: FittedMap = learn(training, progress=progress, **told, **own)
        return learned
    model = load_model(plan.file(job, "model", str(path), folder))
    return LearnedMap(model, progress=progress, **told).fit(training, **own)


# -- the command -------------------------------------------------------------------------------------------------------
def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument("action", choices=ACTIONS, metavar=f"{{{','.join(ACTIONS)}}}", help="what to do")
    parser.add_argument("source", metavar="JOB.toml|MAP.h5", nargs="?", help="job (generate, fit), or map (check, run)")
    parser.add_argument("input", metavar="SET|LOG", nargs="?", help="folder of a held-out set (check), or log (run)")
    parser.add_argument("-o", "--output", metavar="MAP.h5|RESULT.h5", help="file to write (fit, run)")
    parser.add_argument("--draws", type=count, metavar="N", help="generate, demo: how many; check: of the first N")
    parser.add_argument(
        "--out", metavar="DIR", help="generate: folder of the set; demo: folder to write to (default: learn-demo)"
    )
    parser.add_argument(
        "--response", type=channels, metavar="CH,...", help="run: channels, in the order of the sensors"
    )
    parser.add_argument("--report", metavar="PAGE.html", help="run: also write a report")
    parser.add_argument("--plot", metavar="PICTURE", help="run: also write a picture (png, svg, pdf)")
    add_details(parser)
    add_log_options(parser)


NEEDS: dict[str, tuple[str, ...]] = {
    "generate": ("source",), "fit": ("source", "output"), "check": ("source", "input"),
    "run": ("source", "input", "output"), "demo": (),
}  # fmt: skip


def _run(args: Namespace) -> int:
    needs = NEEDS[args.action]
    words = {
        "source": "MAP.h5" if args.action in ("check", "run") else "JOB.toml",
        "input": "SET" if args.action == "check" else "LOG",
        "output": "-o MAP.h5" if args.action == "fit" else "-o RESULT.h5",
    }
    lacking = [words[name] for name in needs if getattr(args, name) is None]
    if lacking:
        raise UsageError(f"learn {args.action} needs {' and '.join(lacking)} (see loadid learn --help)")
    for name, word in words.items():
        if getattr(args, name) is not None and name not in needs:
            raise UsageError(f"learn {args.action} takes no {word} (see loadid learn --help)")
    if args.out is not None and args.action not in ("demo", "generate"):
        raise UsageError("--out is for generate and the demo only")
    acts = {"generate": _generate, "fit": _fit, "check": _check, "run": _answer, "demo": _demo}
    return acts[args.action](args)


def _demo(args: Namespace) -> int:
    """The demonstration that another package brings: this one knows of no skin."""
    from importlib.metadata import entry_points

    point = next(iter(entry_points(group=DEMOS, name="learn")), None)
    if point is None:
        raise InputError("no package here brings a demonstration", where="learn demo", expected="tactile",
                         hint="python -m pip install loadid")  # fmt: skip
    shown = point.load()
    with Bar() as bar:
        done = shown.demo(
            args.out or "learn-demo", progress=bar, **({} if args.draws is None else {"draws": args.draws})
        )
    emit(args, done.data, shown.text(done))
    return 0


def _generate(args: Namespace) -> int:
    from ..generate import generate_from

    with Bar() as bar:
        found = generate_from(args.source, args.out, draws=args.draws, progress=bar)
    data = {"draws": len(found), "kinds": list(found.kinds), "fingerprint": found.fingerprint}
    emit(args, data, f"{len(found)} draws of {', '.join(found.kinds)}; fingerprint {found.fingerprint[:12]}")
    return 0


def _fit(args: Namespace) -> int:
    require_outputs({"-o": args.output}, [args.source])
    with Bar() as bar:
        found = fitted(args.source, bar, Path(args.output).with_suffix(".training.h5"))
    found.save(args.output)
    data: Mapping[str, Any] = {"engine": found.engine.name, **found.facts, "written": [str(args.output)]}
    emit(args, dict(data), f"{found.engine.name} map of {found.facts['draws']} draws\nwritten: {args.output}")
    return 0


def _check(args: Namespace) -> int:
    from .._families.learned import map_alone
    from ..generate import TrainingSet

    learned, training = map_alone(args.source), TrainingSet.open(args.input)
    with Bar() as bar:
        found = learned.check(training, draws=args.draws, progress=bar)
    emit(args, found.to_dict(), str(found))
    return 0


def _answer(args: Namespace) -> int:
    from .._families.learned import load_map
    from .._results.summary import summary
    from . import identify

    require_outputs({"-o": args.output, "--report": args.report, "--plot": args.plot}, [args.source, args.input])
    reading = settings(args)
    estimate = identify.identify(args.input, load_map(args.source), responses=args.response, record=one_record(args),
                                 reading=reading or None)  # fmt: skip
    written = identify.write_all(estimate, args.output, report=args.report, plot=args.plot)
    said = [summary(estimate, details=args.details, command=True), f"written: {', '.join(written)}"]
    emit(args, {**estimate.to_dict(arrays=False), "written": written}, "\n".join(said))
    return exit_code(estimate)


command = Command("learn", "learn a map from simulated examples, check it and use it", _configure, _run)
