"""``loadid identify``: the load that a log tells of, by any family, as options or a job file ask for it."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures._advice import Advice
from structures._flags import known_codes
from structures.errors import InputError
from structures.files import _storage as storage

from .._results.summary import against, comparison, summary
from . import (
    NONE,
    Bar,
    Command,
    UsageError,
    add_details,
    add_log_options,
    channels,
    emit,
    exit_code,
    load_model,
    one_record,
    require_outputs,
    settings,
)
from . import (
    _inputs as inputs,
)
from ._inputs import candidates, sensor_table
from ._inputs import known_load as known_load
from ._inputs import responses_of as responses_of
from ._settings import CONSTRAINTS, FAMILIES, OPTIONS, add_settings, known, load_family, require_known
from ._settings import given as given_settings

if TYPE_CHECKING:
    from structures._model import Model

    from .._families.learned import FittedMap
    from .._record import Record
    from .._results.estimate import LoadEstimate
    from .._results.location import LocationResult


EXAMPLES = """\
examples:
  the load of a record, by the family that model and data ask for, with a report and a picture:
    loadid identify log.csv --model model.h5 -o load.h5 --report load.html --plot load.png
  channels of other names, a load that only pushes, and the load cell of the log to compare with:
    loadid identify log.csv --model model.h5 -o load.h5 --response acc1,acc2 --nonnegative --truth hammer
  a static load from readings, with the noise of the gauges and one gauge kept out:
    loadid identify gauges.csv --model wing.h5 -o load.h5 --family static --noise 1e-6 --validation root
  a job file, as it is written beside every result; options override it:
    loadid identify load.job.toml --choice gcv

FRFs are models: --model takes those of a universal file or a text table.
"""
JOB = (
    "family", "method", "penalty", "variance", "choice", "path", "initial", "leak", "dictionary", "nonnegative",
    "signal", "over", "level", "band", "segment", "allow",
)  # fmt: skip


def identify(
    log: str | Path | Record | Any,
    model: str | Path | Model | FittedMap,
    *,
    family: str = "auto",
    responses: Sequence[str] | None = None,
    record: str | Sequence[str] | None = None,
    reading: dict[str, Any] | None = None,
    **options: Any,
) -> Any:
    """Load from a log and a model, each given as a file or as an object.

    Parameters
    ----------
    log : path, Record, Spectra, CrossSpectra, or mapping of sensor to reading
        Of static readings also a text file with one row for each sensor, its label and its number.
    model : path, Model or learned map
    family : str
        ``"auto"`` takes what model and data ask for (`loadid.AutomaticInversion`); where a setting is given that says
        more of the prior than it takes, the plain family of the data. Else ``"deconvolution"``, ``"sparse"``,
        ``"field"``, ``"location"``, ``"static"``, ``"harmonic"``, ``"frequency"`` or ``"tracker"`` (smoothed).
    responses : sequence of str, optional
        Channels of the log in the order of the sensors of the model; default those of the same names.
    record : str, optional
        Record of a log that holds several.
    reading : dict, optional
        Keyword arguments of `loadid.read`.
    **options
        Settings of the family, those that belong together one by one (``noise``, ``noise_source``), as commands and job
        files have them; those that are None are left to it. The penalty ``"none"`` is plain least squares; ``noise``
        may be a mapping of sensor to std; ``nonnegative`` (True, or labels of loads), ``bounds``, ``resultant``
        (``{"Fz": 100.0}``) and ``acting`` are constraints by name; sensors of ``validation`` are kept out and
        predicted; ``grid`` spreads candidates over the structure; ``at`` or ``mean`` takes static readings of a log.

    Returns
    -------
    LoadEstimate or LocationResult
        The notes of the record stand in its provenance.

    Raises
    ------
    InputError, NotIdentifiable
        From the reader, the model and the family.
    """
    from dataclasses import replace

    own, fitted = _opened(model)
    settings = {name: value for name, value in options.items() if value is not None}
    labels = [s.label for s in own.sensors]
    found: Any = log
    if isinstance(log, str | Path):
        static = family == "static" or (family == "auto" and own.gives("static"))
        table = sensor_table(log, labels) if static and record is None and not reading else None
        found = _read(log, record, reading) if table is None else table
    if fitted is not None:
        return _mapped(fitted, found, responses, settings, family)
    taken = family_of(family, settings, own, found)
    require_known(taken, {name: None for name in settings if name not in ("progress", "constraints")})
    notes = [*found.notes, *inputs.lacking(found, settings)] if _is_record(found) else []
    try:
        estimate = _estimated(taken, found, own, responses, settings)
    except InputError as error:
        raise (_with_contradiction(error, found) if _is_record(found) else error) from error
    return replace(estimate, provenance={**estimate.provenance, "notes": notes}) if notes else estimate


def _opened(given: str | Path | Model | FittedMap) -> tuple[Model, FittedMap | None]:
    """A forward model, of a file where one is named; and the learned map that it belongs to, where that was given."""
    from .._learning.file import KIND

    if isinstance(given, str | Path):
        path = storage.as_path(given)
        if not (path.is_file() and path.suffix.lower() in storage.HDF5 and storage.kind_of(path) == KIND):
            return load_model(given), None
        from .._families.learned import load_map

        given = load_map(path)
    own = getattr(given, "model", None)  # models have none
    return (given, None) if own is None else (own, given)  # type: ignore[return-value]


def _mapped(
    fitted: FittedMap, found: Any, responses: Sequence[str] | None, settings: Mapping[str, Any], family: str
) -> LoadEstimate:  # fmt: skip
    """The answer of a learned map, which has its settings."""
    given = [name for name in settings if name not in ("progress", "mean", "at")]
    if given or family != "auto":
        raise InputError("a learned map has its settings", where="identify",
                         found=", ".join(given) or f"family {family}", expected="none",
                         hint="leave them out, or give a model")  # fmt: skip
    if _is_record(found):
        found = responses_of(found, fitted.model, responses, None)
        found = inputs.reading(found, dict(settings)) if fitted.dt is None else found
    return fitted.estimate(found)


def family_of(family: str, settings: Mapping[str, Any], model: Model, found: Any) -> str:
    """The family that is asked for: of ``auto`` with settings that it leaves to a family, the plain one of the data.

    Raises
    ------
    InputError
        No such family, or data that none takes.
    """
    load_family(family)
    if family != "auto":
        return family
    taken = known("auto")
    if all(name in taken or name in ("progress", "constraints") for name in settings):
        return family
    return plain_family(model, found)


def plain_family(model: Model, found: Any) -> str:
    """The plain family of some data: ``"static"``, ``"frequency"`` or ``"deconvolution"``.

    Raises
    ------
    InputError
        Data that none takes.
    """
    from .._families.automatic import kind_of

    return {"static": "static", "lines": "frequency", "history": "deconvolution"}[kind_of(model, found)]


def _estimated(family: str, found: Any, model: Model, responses: Sequence[str] | None, settings: dict[str, Any]) -> Any:
    """The answer of a family, whose data and settings are made first."""
    settings = dict(settings)
    chosen, progress = load_family(family), settings.pop("progress", None)
    if "grid" in settings:
        model = candidates(model, settings.pop("grid"))
    labels = [s.label for s in model.sensors]
    kept_out = _sensors(settings, labels, family)
    if _is_record(found):
        wanted = None if responses is not None else [*(settings.get("sensors") or labels), *kept_out]
        found = responses_of(found, model, responses, list(dict.fromkeys(map(str, wanted))) if wanted else None)
    whole = found = inputs.reading(found, settings) if _is_record(found) else found
    used = [str(s) for s in settings.get("sensors") or labels]
    if "noise" in settings:
        order = used if "sensors" in settings or family != "frequency" else labels
        order = [*order, *settings.get("validation", ())] if "sensors" in settings else order
        settings["noise"] = inputs.noise(settings["noise"], labels, order)
    if family == "harmonic":
        inputs.require_frequency(settings)
    if isinstance(found, Mapping) and "sensors" in settings:
        found = {label: found[label] for label in used if label in found}
    made = chosen(model, **family_settings(settings, chosen, model), progress=progress)
    if family == "tracker":
        from .._families.recommend import smoothed

        estimate: Any = smoothed(made, found)
    else:
        estimate = made.estimate(found)
    return inputs.held_out(estimate, model, whole, kept_out) if kept_out else estimate


def _sensors(settings: dict[str, Any], labels: list[str], family: str) -> list[str]:
    """Sensors that are kept out here, not by the family; the others are put into the settings."""
    kept_out = [str(one) for one in settings.get("validation", ())]
    if not kept_out or family == "frequency":
        return []
    for label in kept_out:
        if label not in labels:
            raise InputError("the model has no such sensor", where="validation", found=repr(label),
                             expected=", ".join(labels))  # fmt: skip
    given = [str(one) for one in settings.get("sensors") or [label for label in labels if label not in kept_out]]
    if not given or set(given) & set(kept_out):
        raise InputError("a sensor cannot train and validate", where="validation", found=", ".join(kept_out),
                         expected="other sensors for training")  # fmt: skip
    del settings["validation"]
    settings["sensors"] = given
    return kept_out


def job(args: Namespace) -> dict[str, Any]:
    """Keyword arguments of `identify` of a batch that say how histories are found, as the options give them."""
    values = given_settings(vars(args))
    return {**{name: values.get(name) for name in JOB}, "family": args.family or "deconvolution"}


def family_settings(options: dict[str, Any], family: Any, model: Model) -> dict[str, Any]:
    """The settings that were given, as the family takes them.

    Raises
    ------
    InputError
        One that it does not take.
    """
    from .._spellings import ARGUMENTS, folded
    from ..settings import Penalty

    written = ARGUMENTS[family.__name__]
    given = {key: value for key, value in options.items() if value is not None or key == "gate"}
    by_name = [name for name in CONSTRAINTS if name in given and name not in written.names]
    if by_name:
        found = inputs.constraints(model, {name: given.pop(name) for name in by_name})
        if found:
            given["constraints"] = [*given.get("constraints", ()), *found]
    for name in ("penalty", "time"):
        if given.get(name) == NONE:
            given[name] = None
    if "variance" in given:
        given["penalty"] = Penalty(given.get("penalty", "identity"), variance=given.pop("variance"))
    return folded(family, given)


def _is_record(found: Any) -> bool:
    from .._record import Record

    return isinstance(found, Record)


def _with_contradiction(error: InputError, record: Record) -> InputError:
    """The error; where the stated step contradicts that of the file, this is said too: it is the likely cause."""
    from .._readers.settle import contradict, replaced

    if record.file_dt is None or not contradict(record.file_dt, record.dt):
        return error
    hint = Advice(error.hint, "; " if error.hint else "", replaced(record.file_dt, record.dt))
    parts = {k: getattr(error, k) for k in ("where", "found", "expected", "code")}
    return InputError(error.what, hint=hint, **parts)


def _read(log: str | Path, record: str | Sequence[str] | None, reading: dict[str, Any] | None) -> Record:
    from .._readers import read

    return read(log, record=record, **(reading or {}))


def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument("log", metavar="LOG|JOB.toml", nargs="?", help="log with the responses, or a job that names it")
    parser.add_argument("--job", metavar="JOB.toml", help="job file; options override what it says")
    parser.add_argument("--model", metavar="MODEL.h5", help="model file, from calibrate for example")
    parser.add_argument("-o", "--output", metavar="RESULT.h5", help="result file to write; RESULT.job.toml beside it")
    parser.add_argument(
        "--family", choices=sorted(FAMILIES), help="default auto: what model and data ask for, said in one line"
    )
    add_settings(parser)
    parser.add_argument(
        "--response", type=channels, metavar="CH,...", help="channels, in the order of the model's sensors"
    )
    parser.add_argument(
        "--truth", metavar="CH", help="channel of the log that holds the measured load, to compare with"
    )
    parser.add_argument("--json-full", action="store_true", help="as --json, with all arrays")
    parser.add_argument("--report", metavar="PAGE.html", help="also write a report")
    add_details(parser)
    parser.add_argument("--plot", metavar="PICTURE", help="also write a picture (png, svg, pdf)")
    add_log_options(parser)


def asked(args: Namespace) -> dict[str, Any]:
    """What a command line and its job ask for together, by the names of a job; options override.

    Raises
    ------
    InputError
        From the job.
    UsageError
        No log, no model, no output.
    """
    from ._job import read as read_job

    log, path = args.log, args.job
    if path is None and log is not None and str(log).lower().endswith(".toml"):
        log, path = None, log
    found = {} if path is None else read_job(path)
    words = {"log": log, "model": args.model, "output": args.output, "report": args.report, "plot": args.plot,
             "family": args.family, "record": one_record(args), "responses": args.response,
             "truth": args.truth}  # fmt: skip
    found |= {name: value for name, value in words.items() if value is not None}
    if read_as := settings(args):
        found["reading"] = {**found.get("reading", {}), **read_as}
    found |= given_settings(vars(args))
    lacking = [name for name in ("log", "model", "output") if name not in found]
    if lacking:
        options = {"log": "LOG", "model": "--model", "output": "-o"}
        raise UsageError(f"the following arguments are required: {', '.join(options[name] for name in lacking)} "
                         "(see loadid identify --help)")  # fmt: skip
    return found


def _run(args: Namespace) -> int:
    from ._job import FILES, OUTPUTS, beside
    from ._job import resolved as as_text

    job = asked(args)
    require_outputs({"-o": job["output"]})
    kept = beside(job["output"])
    require_outputs({"-o": job["output"], "--report": job.get("report"), "--plot": job.get("plot"),
                     "the resolved job": kept if kept != _own_job(args) else None},
                    [job["log"], job["model"]])  # fmt: skip
    if job.get("allow"):
        job["allow"] = list(known_codes(job["allow"], where="--allow"))
    model, fitted = _opened(job["model"])
    labels = [s.label for s in model.sensors]
    family = job.get("family", "auto")
    table = None
    if family in ("static", "auto") and model.gives("static") and not (job.get("record") or job.get("reading")):
        table = sensor_table(job["log"], labels)
    log: Any = _read(job["log"], job.get("record"), job.get("reading")) if table is None else table
    if table is not None and job.get("truth") is not None:
        raise InputError("a table of readings holds no measured load", where="--truth", found=job["truth"],
                         expected="a log with a channel of the load", hint="leave --truth out")  # fmt: skip
    truth = None if job.get("truth") is None else known_load(log, model, job["truth"])
    options = {name: value for name, value in job.items() if name in OPTIONS}
    job["family"] = family if fitted is not None else family_of(family, options, model, log)
    with Bar() as bar:
        estimate = identify(
            log, fitted or model, family=job["family"], responses=job.get("responses"), progress=bar, **options
        )
    text = as_text({**{n: job.get(n) for n in (*FILES, *OUTPUTS)}, **job}, kept.resolve().parent)
    if job["family"] == "location":
        return _located(args, job, estimate, kept, text)
    if truth is not None and (estimate.axis is None or estimate.axis.name != "time"):
        raise InputError("a history cannot be compared with spectra", where="--truth", found="--signal stationary",
                         expected="a load over time", hint="leave --truth out")  # fmt: skip
    error = None if truth is None else against(estimate, truth)
    written = write_all(estimate, job["output"], report=job.get("report"), plot=job.get("plot"), truth=truth)
    storage.replace(kept, text.encode())
    written.append(str(kept))
    said = summary(estimate, details=args.details, command=True)
    chosen = [f"chosen: {estimate.facts.chosen}"] if estimate.facts.get("chosen") else []
    tested = [f"kept out: {', '.join(estimate.facts.held_out)}"] if estimate.facts.get("held_out") else []
    lines = [
        said,
        *chosen,
        *tested,
        *([comparison(error)] if error else []),
        f"written: {', '.join(written)}",
    ]
    answer = {**estimate.to_dict(arrays=args.json_full), "against_known": error, "written": written}
    emit(args, answer, "\n".join(lines))
    return exit_code(estimate)


def _own_job(args: Namespace) -> Path | None:
    """The job that is run, which may be rewritten as resolved."""
    named = args.job if args.job is not None else args.log
    return None if named is None else Path(named)


def _located(args: Namespace, job: Mapping[str, Any], found: LocationResult, kept: Path, text: str) -> int:
    """Write and print a search for the place of a load."""
    ready = []
    if job.get("plot") is not None:
        from .._plots import rendered

        ready.append((Path(job["plot"]), rendered(found.plot(), job["plot"])))
    if job.get("report") is not None and found.estimate is not None:
        from .._results.report import page

        ready.append((Path(job["report"]), page(found.estimate).encode()))
    found.save(job["output"])
    for path, data in [*ready, (kept, text.encode())]:
        storage.replace(path, data)
    written = [str(job["output"]), *(str(path) for path, _ in ready), str(kept)]
    lines = [found.summary(command=True)]
    if found.estimate is not None:
        lines.append(summary(found.estimate, details=args.details, command=True))
    full = {} if found.estimate is None else {"estimate": found.estimate.to_dict(arrays=args.json_full)}
    emit(args, {**found.to_dict(), **full, "written": written}, "\n".join([*lines, f"written: {', '.join(written)}"]))
    return exit_code(found.estimate)


def write_all(
    estimate: LoadEstimate,
    result: str | Path,
    *,
    report: str | Path | None = None,
    plot: str | Path | None = None,
    truth: Any = None,
) -> list[str]:
    """Write the result file and, where named, the report and the picture; the paths written.

    Report and picture are made before the first file is written, so that a fault in them leaves nothing behind.
    """
    ready, png = [], None
    if plot is not None:
        from .._plots import load_figure, picture_format, rendered

        drawn = rendered(load_figure(estimate, truth=truth), plot)
        png = drawn if picture_format(plot) == "png" else None
        ready.append((Path(plot), drawn))
    if report is not None:
        from .._results.report import page

        ready.append((Path(report), page(estimate, truth=truth, png=png).encode()))
    estimate.save(result)
    for path, data in ready:
        storage.replace(path, data)
    return [str(path) for path in (result, report, plot) if path is not None]


command = Command("identify", "reconstruct the load from a log and a model", _configure, _run)
