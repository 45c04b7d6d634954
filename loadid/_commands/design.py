"""``loadid design``: which of many candidate sensors to place, before anything is measured."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from typing import Any

from structures.files import _storage as storage

from . import Bar, Command, channels, count, emit, load_model, positive, require_outputs, stds

CRITERIA = ("D", "worst")
UNSEEN = 0.995  # std over size of a load that no reading says anything of
EXAMPLES = """\
examples:
  a model whose sensors are all that could be placed, made by loadid model with one --sensor for each:
    loadid design candidates.h5 -n 4 --plot layout.png
  the load that is known least counts, one gauge is there already, loads of about 200 N, noise of 1 um/m:
    loadid design candidates.h5 -n 6 --criterion worst --keep root --amplitude 200 --noise 1e-6

Loads are static here. Sensors of different units need their noise, in the model (noise= of a sensor) or by --noise.
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
    parser.add_argument("--criterion", choices=CRITERIA, default="D",
                        help="D (default): most information in all; worst: the load that is known least")  # fmt: skip
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
    from ..design import place

    model = load_model(args.model)
    with Bar() as bar:
        found = place(
            model, args.number, loads=args.loads, criterion=args.criterion, keep=args.keep, noise=args.noise,
            amplitude=args.amplitude, snr=args.snr, progress=bar,
        )  # fmt: skip
    written: list[str] = []
    if args.plot is not None:
        from .._plots import rendered

        storage.replace(storage.as_path(args.plot), rendered(found.plot(), args.plot))
        written.append(str(args.plot))
    layout = found.layout
    worst = layout.worst
    known = f"the load known least, {layout.loads[worst]}, to ±{layout.share[worst]:.1%} of its size (std)"
    if layout.share[worst] > UNSEEN:
        known = f"the load known least, {layout.loads[worst]}, is not seen by them"
    first = f"place {', '.join(found.sensors)}: {known}"
    last = [f"written: {', '.join(written)}"] if written else []
    data: dict[str, Any] = {**found.to_dict(), "sensors": list(found.sensors), "written": written}
    emit(args, data, "\n".join([first, found.table(), *last]))
    return 0


command = Command("design", "which of many candidate sensors to place", _configure, _run)
