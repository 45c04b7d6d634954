"""``loadid identify``: the load that a log tells of."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.errors import InputError

from . import Command, emit, names
from ._logs import add_log_options, load_model, one_record, settings

if TYPE_CHECKING:
    from loadid.estimate import LoadEstimate
    from loadid.record import Record
    from structures.model import Model

FAMILIES = {"deconvolution": ("loadid.families.deconvolution", "Deconvolution")}


def identify(
    log: str | Path | Record,
    model: str | Path | Model,
    *,
    family: str = "deconvolution",
    responses: Sequence[str] | None = None,
    record: str | None = None,
    reading: dict[str, Any] | None = None,
    **options: Any,
) -> LoadEstimate:
    """Load from a log and a model, each given as a file or as an object.

    Parameters
    ----------
    family : str
        ``"deconvolution"``.
    responses : sequence of str, optional
        Channels of the log in the order of the sensors of the model; default those of the same names.
    record : str, optional
        Record of a log that holds several.
    reading : dict, optional
        Keyword arguments of `loadid.readers.read`.
    **options
        Settings of the family; those that are None are left to it.

    Raises
    ------
    InputError, NotIdentifiable
        From the reader, the model and the family.
    """
    from importlib import import_module

    if family not in FAMILIES:
        raise InputError("no such family", where="family", found=family, expected=" or ".join(FAMILIES))
    known = load_model(model) if isinstance(model, str | Path) else model
    found = _read(log, record, reading) if isinstance(log, str | Path) else log
    module, name = FAMILIES[family]
    chosen = getattr(import_module(module), name)
    given = {key: value for key, value in options.items() if value is not None}
    return chosen(known, **given).estimate(responses_of(found, known, responses))


def _read(log: str | Path, record: str | None, reading: dict[str, Any] | None) -> Record:
    from loadid.readers import read

    return read(log, record=record, **(reading or {}))


def responses_of(record: Record, model: Model, chosen: Sequence[str] | None) -> Record:
    """The channels of a record that the model predicts, in the order and under the names of its sensors."""
    from dataclasses import replace

    labels = [s.label for s in model.sensors]
    if chosen is None:
        return record.select(labels)
    if len(chosen) != len(labels):
        raise InputError("one channel per sensor is needed", where="--response", found=list(chosen), expected=labels)
    some = record.select(list(chosen))
    return replace(some, channels=tuple(replace(c, label=s) for c, s in zip(some.channels, labels, strict=True)))


def relative_error(estimate: LoadEstimate, truth: Any) -> dict[str, float]:
    """Relative L2 error and relative error of the peak of the first load against a known one (samples,)."""
    import numpy as np

    load, known = estimate.load[:, 0], np.asarray(truth, float)
    peak, real = (float(x[np.argmax(np.abs(x))]) for x in (load, known))
    return {
        "error": float(np.linalg.norm(load - known) / np.linalg.norm(known)),
        "peak_error": peak / real - 1,
        "coverage_95": float(np.mean((known >= estimate.band()[0][:, 0]) & (known <= estimate.band()[1][:, 0]))),
    }


def show_error(error: dict[str, float]) -> str:
    """Answer of `relative_error` as one line."""
    return (
        f"against the known load: relative error {error['error']:.2%}, peak error {error['peak_error']:+.2%}, "
        f"95 % band holds {error['coverage_95']:.1%} of the samples"
    )


def _number_or(name: Callable[[str], str]) -> Callable[[str], float | str]:
    def parse(text: str) -> float | str:
        try:
            return float(text)
        except ValueError:
            return name(text)

    return parse


def _configure(parser: ArgumentParser) -> None:
    parser.add_argument("log", metavar="LOG", help="log with the responses")
    parser.add_argument("--model", required=True, metavar="MODEL.h5", help="model file, from calibrate for example")
    parser.add_argument("-o", "--output", required=True, metavar="RESULT.h5", help="result file to write")
    parser.add_argument("--family", choices=sorted(FAMILIES), default="deconvolution")
    parser.add_argument("--method", metavar="NAME", help="tikhonov or tsvd")
    parser.add_argument("--penalty", metavar="NAME", help="identity, first_difference, second_difference, ...")
    parser.add_argument("--choice", type=_number_or(str), metavar="RULE", help="rule, or a relative lambda")
    parser.add_argument(
        "--allow", type=names, metavar="CODE,...", help="refusals to override; printed on every picture"
    )
    parser.add_argument(
        "--response", type=names, metavar="CH,...", help="channels, in the order of the model's sensors"
    )
    parser.add_argument(
        "--truth", metavar="CH", help="channel of the log that holds the measured load, to compare with"
    )
    parser.add_argument("--report", metavar="PAGE.html", help="also write a report")
    parser.add_argument("--plot", metavar="PICTURE", help="also write a picture (png, svg, pdf)")
    add_log_options(parser)


def _run(args: Namespace) -> int:
    from loadid.progress import Bar

    log = _read(args.log, one_record(args), settings(args))
    truth = None if args.truth is None else log[args.truth]
    with Bar() as bar:
        estimate = identify(
            log, args.model, family=args.family, responses=args.response, method=args.method, penalty=args.penalty,
            choice=args.choice, allow=args.allow, progress=bar,
        )  # fmt: skip
    error = None if truth is None else relative_error(estimate, truth)
    written = write_all(estimate, args.output, report=args.report, plot=args.plot, truth=truth)
    lines = [estimate.summary(), *([show_error(error)] if error else []), f"written: {', '.join(written)}"]
    emit(args, {**estimate.to_dict(), "against_known": error, "written": written}, "\n".join(lines))
    return 0


def write_all(
    estimate: LoadEstimate,
    result: str | Path,
    *,
    report: str | Path | None = None,
    plot: str | Path | None = None,
    truth: Any = None,
) -> list[str]:
    """Write the result file and, where named, the report and the picture; the paths written."""
    estimate.save(result)
    if report is not None:
        estimate.report(report, truth=truth)
    if plot is not None:
        estimate.plot(truth=truth, path=plot)
    return [str(path) for path in (result, report, plot) if path is not None]


command = Command("identify", "reconstruct the load from a log and a model", _configure, _run)
