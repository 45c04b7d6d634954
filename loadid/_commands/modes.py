"""``loadid modes``: natural frequencies, damping and shapes from a test, and a forward model made of them."""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.errors import InputError

from . import (
    Command,
    add_log_options,
    band,
    channels,
    count,
    emit,
    load_model,
    names,
    read_records,
    require_outputs,
    resolved,
    settings,
    table,
)

if TYPE_CHECKING:
    from structures import MeasuredModes
    from structures._model import Model


def pair(text: str) -> tuple[str, str]:
    """``"a1,F"`` as a sensor and a load."""
    found = names(text)
    if len(found) != 2:
        raise ArgumentTypeError(f"{text!r} is not SENSOR,LOAD")
    return found[0], found[1]


def measured(paths: Sequence[str | Path], args: Namespace) -> MeasuredModes:
    """Modes from files of FRFs, or from logs where forces are named.

    Raises
    ------
    InputError
        From the readers; several files of FRFs that do not belong together; as `structures.identify_modes`.
    """
    import structures

    common = {"band": args.band, "order": args.order, "driven": args.driven}
    if args.force is None:
        if args.response is not None:
            raise InputError("responses without a force", where="--response", expected="--force CH,... of a log",
                             hint="files of FRFs know their channels")  # fmt: skip
        found: MeasuredModes = structures.identify_modes(_frfs(paths), **common)
        return found
    if args.response is None:
        raise InputError("a force without responses", where="--force", expected="--response CH,... of the log")
    records = []
    for path in paths:
        for record in read_records(path, args.record, settings(args)):
            records.append(record.select(resolved(record, [*args.force, *args.response], where="--force, --response")))
    labels = records[0].labels
    forces, responses = labels[: len(args.force)], labels[len(args.force) :]
    return structures.identify_modes(records, forces=forces, responses=responses, segment=args.segment, **common)


def _frfs(paths: Sequence[str | Path]) -> Model:
    """FRFs of one file, or of several that were driven one place after the other."""
    import structures

    models = [load_model(path) for path in paths]
    for path, model in zip(paths, models, strict=True):
        if model.frequencies is None:
            raise InputError("no FRFs", where=str(path), found=type(model).__name__,
                             expected="measured FRFs, or logs with --force and --response",
                             hint="loadid calibrate makes FRFs of hammer hits")  # fmt: skip
    if len(models) == 1:
        return models[0]
    return structures.FrfModel.joined([structures.FrfModel.of(m, m.frequencies) for m in models])


def describe(found: MeasuredModes) -> dict[str, Any]:
    """Modes as plain values."""
    modes = [
        {
            "frequency": float(found.frequencies[k]), "frequency_std": float(found.frequency_std[k]),
            "damping": float(found.damping[k]), "damping_std": float(found.damping_std[k]),
            "mpc": float(found.mpc[k]), "modal_mass": _number(found.modal_mass[k]),
            "modal_mass_std": _number(found.modal_mass_std[k]), "shape": found.normal_shapes[:, k].tolist(),
            "complex_shape": {"real": found.shapes[:, k].real.tolist(), "imag": found.shapes[:, k].imag.tolist()},
        }
        for k in range(len(found))
    ]  # fmt: skip
    s = found.stabilisation
    return {
        "sensors": [c.label for c in found.frf.sensors], "loads": [c.label for c in found.frf.loads],
        "band": list(found.band), "modes": modes, "mac": found.mac.tolist(), "scaled": found.scaled,
        "misfit": float(found.misfit), "dropped": found.dropped, "unstable_poles": s.unstable,
        "poles_outside": s.outside, "flags": [f.to_dict() for f in found.flags],
    }  # fmt: skip


def _number(value: float) -> float | None:
    return float(value) if value == value else None


def show(data: dict[str, Any]) -> str:
    """Answer of `describe` as text."""
    rows = [["mode", "f [Hz]", "std", "damping [%]", "std", "MPC", "modal mass [kg]", "std"]]
    for k, m in enumerate(data["modes"]):
        mass = ["-", ""] if m["modal_mass"] is None else [f"{m['modal_mass']:.4g}", f"{m['modal_mass_std']:.2g}"]
        rows.append([str(k + 1), f"{m['frequency']:.6g}", f"{m['frequency_std']:.2g}", f"{100 * m['damping']:.4g}",
                     f"{100 * m['damping_std']:.2g}", f"{m['mpc']:.3f}", *mass])  # fmt: skip
    lines = [
        _head(data),
        table(rows),
        f"  left out: {data['unstable_poles']} poles that grow, {data['dropped']} that explain nothing",
    ]
    if not data["scaled"]:
        lines.append("  no driven point: the model knows the forces of the test alone (--driven SENSOR,LOAD)")
    return "\n".join(lines)


def _head(data: dict[str, Any]) -> str:
    low, high = data["band"]
    counts = ((len(data[name]), name[:-1]) for name in ("modes", "sensors", "loads"))
    modes, *sizes = (f"{count} {word}{'s' * (count != 1)}" for count, word in counts)
    return f"{modes} in the band of {low:.5g} to {high:.5g} Hz; {', '.join(sizes)}"


def _configure(parser: ArgumentParser) -> None:
    parser.add_argument("source", nargs="+", metavar="FRFS|RECORDS",
                        help="FRFs (universal or model file; several: one driven place each), or logs")  # fmt: skip
    parser.add_argument("--force", type=channels, metavar="CH,...", help="force channels of logs")
    parser.add_argument("--response", type=channels, metavar="CH,...", help="channels of the sensors")
    parser.add_argument("--band", type=band, metavar="LOW:HIGH", help="band in Hz; default all lines")
    parser.add_argument("--order", type=count, metavar="N", help="highest order of the polynomials")
    parser.add_argument("--driven", type=pair, metavar="SENSOR,LOAD",
                        help="a response and a force at one place, which gives modal masses; "
                        "labels that name one DOF (12+Z) say so themselves")  # fmt: skip
    parser.add_argument("--segment", type=count, metavar="N", help="samples of the segments of shaker records")
    parser.add_argument("-o", "--output", metavar="MODEL.h5", help="model file to write")
    parser.add_argument("--plot", metavar="PICTURE", help="stabilisation picture to write (png, svg, pdf)")
    add_log_options(parser, several=True)


def _run(args: Namespace) -> int:
    require_outputs({"-o": args.output, "--plot": args.plot}, args.source)
    found = measured(args.source, args)
    drawn = None
    if args.plot is not None:
        from .._plots import rendered
        from .._plots.modal import stabilisation_figure

        drawn = rendered(stabilisation_figure(found), args.plot)
    if args.output is not None:
        found.model().save(args.output)
    if drawn is not None:
        from structures.files import _storage as storage

        storage.replace(Path(args.plot), drawn)
    written = [str(path) for path in (args.output, args.plot) if path is not None]
    data = describe(found)
    said = [show(data), *(f"  {flag.command}" for flag in found.flags)]
    said += [f"written: {', '.join(written)}"] if written else []
    emit(args, {**data, "written": written}, "\n".join(said))
    return 0


command = Command("modes", "natural frequencies, damping and shapes from a test, and a model of them", _configure, _run)
