"""``loadid design``: which of many candidate sensors to place, before anything is measured."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from typing import Any

from structures.files import _storage as storage

from . import Bar, Command, UsageError, channels, count, emit, hit, load_model, positive, require_outputs, stds

CRITERIA = ("D", "worst", "mean")
UNSEEN = 0.995  # std over size of a load that no reading says anything of
EXAMPLES = """\
examples:
  a model whose sensors are all that could be placed, made by loadid model with one --sensor for each:
    loadid design candidates.h5 -n 4 --plot layout.png
  the load that is known least counts, one gauge is there already, loads of about 200 N, noise of 1 um/m:
    loadid design candidates.h5 -n 6 --criterion worst --keep root --amplitude 200 --noise 1e-6
  a hit of 2 ms and 500 N, which any dynamic model takes (FRFs, modes, state space, finite elements):
    loadid design frfs.h5 -n 3 --pulse 0.002:500

Loads are static unless --pulse states a hit, or no sensor sees a load that stands still (then 1 ms and 100 units).
Sensors of different units need their noise for static loads, in the model (noise= of a sensor) or by --noise.
"""


def _stds(text: str) -> float | list[float]:
    found = stds(text)
    return found[0] if len(found) == 1 else found


def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument("model", metavar="MODEL.h5", help="model whose sensors are the candidates")
    parser.add_argument(
        "-n", "--number", type=count, required=True, metavar="N", help="sensors to place, kept ones too"
    )
    parser.add_argument("--criterion", choices=CRITERIA,
                        help="of static loads D (default): most information in all; worst (default of hits): the load "
                        "that is known least; of hits mean: all loads alike")  # fmt: skip
    parser.add_argument("--pulse", type=hit, metavar="S:PEAK", help="hit to place for, peak in the load's unit")
    parser.add_argument(
        "--keep", type=channels, metavar="SENSOR,...", default=[], help="sensors that are there already"
    )
    parser.add_argument("--loads", type=channels, metavar="LOAD,...", help="loads that count; default all")
    parser.add_argument("--noise", type=_stds, metavar="STD,...", help="of the candidates in SI: one, or one for each")
    group = parser.add_mutually_exclusive_group()
    group.add_argument("--amplitude", type=_stds, metavar="SIZE,...", help="expected size of the loads in SI")
    group.add_argument("--snr", type=positive, metavar="RATIO", help="or what the best sensor reads over its noise; "
                       "default 100")  # fmt: skip
    parser.add_argument("--plot", metavar="PICTURE", help="also write a picture (png, svg, pdf)")


def _run(args: Namespace) -> int:
    require_outputs({"--plot": args.plot}, [args.model])
    model = load_model(args.model)
    hits = args.pulse is not None or not _seen_standing(model)
    wrong = [f"--{name}" for name in ("amplitude", "snr", "loads") if getattr(args, name) is not None] if hits else []
    if wrong:
        raise UsageError(f"{wrong[0]} is of static loads: of a hit --pulse S:PEAK states the size, and all loads count")
    if args.criterion == ("D" if hits else "mean"):
        raise UsageError(f"--criterion {args.criterion} is of {'static loads' if hits else 'hits'}: choose "
                         f"{'worst or mean' if hits else 'D or worst'}")  # fmt: skip
    with Bar() as bar:
        found, first = (_for_hits if hits else _for_static)(model, args, bar)
    written: list[str] = []
    if args.plot is not None:
        from .._plots import rendered

        storage.replace(storage.as_path(args.plot), rendered(found.plot(), args.plot))
        written.append(str(args.plot))
    last = [f"written: {', '.join(written)}"] if written else []
    data: dict[str, Any] = {**found.to_dict(), "sensors": list(found.sensors), "written": written}
    emit(args, data, "\n".join([f"place {', '.join(found.sensors)}: {first}", found.table(), *last]))
    return 0


def _seen_standing(model: Any) -> bool:
    """Whether the model tells what a load that stands still does to some sensor."""
    from structures.errors import InputError, NotIdentifiable

    if not model.gives("static"):
        return False
    try:
        return bool((model.static() != 0).any())
    except NotIdentifiable:
        return False
    except InputError:  # said by the static search, in its words
        return True


def _for_hits(model: Any, args: Namespace, bar: Bar) -> tuple[Any, str]:
    from ..design import place_for_hits

    given = {} if args.pulse is None else {"pulse": args.pulse}
    found = place_for_hits(model, args.number, criterion=args.criterion or "worst", keep=args.keep, noise=args.noise,
                           progress=bar, **given)  # fmt: skip
    return found, str(found.forecast)


def _for_static(model: Any, args: Namespace, bar: Bar) -> tuple[Any, str]:
    from ..design import place

    found = place(
        model, args.number, loads=args.loads, criterion=args.criterion or "D", keep=args.keep, noise=args.noise,
        amplitude=args.amplitude, snr=args.snr, progress=bar,
    )  # fmt: skip
    layout = found.layout
    worst = layout.worst
    if layout.share[worst] > UNSEEN:
        return found, f"the load known least, {layout.loads[worst]}, is not seen by them"
    return found, f"the load known least, {layout.loads[worst]}, to ±{layout.share[worst]:.1%} of its size (std)"


command = Command("design", "which of many candidate sensors to place", _configure, _run)
