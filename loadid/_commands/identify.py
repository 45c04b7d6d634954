"""``loadid identify``: the load that a log tells of."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures._advice import Advice
from structures._flags import known_codes
from structures.errors import InputError
from structures.files import _storage as storage

from .._results.summary import against, comparison, summary
from ..constraints import NonNegative
from . import (
    DICTIONARIES,
    NONE,
    STARTS,
    Bar,
    Command,
    add_details,
    add_log_options,
    band,
    channels,
    choice,
    count,
    emit,
    leak,
    load_model,
    names,
    one_record,
    penalty,
    positive,
    require_outputs,
    resolved,
    settings,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from structures._model import Model

    from .._record import Record
    from .._results.estimate import LoadEstimate


FAMILIES = {
    "deconvolution": ("loadid._families.deconvolution", "Deconvolution"),
    "frequency": ("loadid._families.frequency", "FrequencyInversion"),
    "sparse": ("loadid._families.sparse", "SparseDeconvolution"),
}


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
        ``"deconvolution"``, ``"frequency"`` or ``"sparse"``.
    responses : sequence of str, optional
        Channels of the log in the order of the sensors of the model; default those of the same names.
    record : str, optional
        Record of a log that holds several.
    reading : dict, optional
        Keyword arguments of `loadid._readers.read`.
    **options
        Settings of the family; those that are None are left to it, the penalty ``"none"`` is plain least squares, and
        ``nonnegative=True`` asks every family for loads that only push.

    Returns
    -------
    LoadEstimate
        The notes of the record stand in its provenance.

    Raises
    ------
    InputError, NotIdentifiable
        From the reader, the model and the family.
    """
    from dataclasses import replace
    from importlib import import_module

    if family not in FAMILIES:
        raise InputError("no such family", where="family", found=family, expected=" or ".join(FAMILIES))
    known = load_model(model) if isinstance(model, str | Path) else model
    found = _read(log, record, reading) if isinstance(log, str | Path) else log
    module, name = FAMILIES[family]
    chosen = getattr(import_module(module), name)
    given = _given(options, chosen)
    try:
        estimate: LoadEstimate = chosen(known, **given).estimate(responses_of(found, known, responses))
    except InputError as error:
        raise _with_contradiction(error, found) from error
    return (
        replace(estimate, provenance={**estimate.provenance, "notes": list(found.notes)}) if found.notes else estimate
    )


JOB = (
    "family", "method", "penalty", "variance", "choice", "path", "initial", "leak", "dictionary", "nonnegative",
    "signal", "over", "level", "band", "segment", "allow",
)  # fmt: skip


def job(args: Namespace) -> dict[str, Any]:
    """Keyword arguments of `identify` that say how a load is found, as the options give them."""
    return {**{name: getattr(args, name) for name in JOB}, "nonnegative": args.nonnegative or None}


def _given(options: dict[str, Any], family: Any) -> dict[str, Any]:
    """The settings that were given, as the family takes them.

    Raises
    ------
    InputError
        One that it does not take.
    """
    from .._spellings import ARGUMENTS, folded
    from ..settings import Penalty

    written = ARGUMENTS[family.__name__]
    given = {key: value for key, value in options.items() if value is not None}
    taken = [name for name in (*written.defaults, *written.former) if name != "model"]
    known = dict(written.kinds).get("penalty", (Penalty, ()))[1]
    taken += [name for name in ("variance",) if name in known]
    if given.get("nonnegative") and "nonnegative" not in taken and "constraints" in taken:
        del given["nonnegative"]
        given["constraints"] = [*given.get("constraints", ()), NonNegative()]
    unknown = [name for name in given if name not in taken]
    if unknown:
        raise InputError(f"{family.__name__} has no such setting", where="identify", found=", ".join(unknown),
                         expected=f"some of {', '.join(taken)}")  # fmt: skip
    if given.get("penalty") == NONE:
        given["penalty"] = None
    if "variance" in given:
        given["penalty"] = Penalty(given.get("penalty", "identity"), variance=given.pop("variance"))
    return folded(family, given)


def _with_contradiction(error: InputError, record: Record) -> InputError:
    """The error; where the stated step contradicts that of the file, this is said too: it is the likely cause."""
    from .._readers.settle import contradict, replaced

    if record.file_dt is None or not contradict(record.file_dt, record.dt):
        return error
    hint = Advice(error.hint, "; " if error.hint else "", replaced(record.file_dt, record.dt))
    parts = {k: getattr(error, k) for k in ("where", "found", "expected", "code")}
    return InputError(error.what, hint=hint, **parts)


def _read(log: str | Path, record: str | None, reading: dict[str, Any] | None) -> Record:
    from .._readers import read

    return read(log, record=record, **(reading or {}))


def responses_of(record: Record, model: Model, chosen: Sequence[str] | None) -> Record:
    """The channels of a record that the model predicts, in the order and under the names of its sensors.

    Raises
    ------
    InputError
        Too few or too many channels, one that is not there or given twice, or of another unit than its sensor.
    """
    from dataclasses import replace

    labels = [s.label for s in model.sensors]
    if chosen is None:
        return record.select(labels)
    if len(chosen) != len(labels):
        raise InputError(
            "one channel per sensor is needed",
            where="--response",
            found=f"{len(chosen)} channels: {', '.join(map(str, chosen))}",
            expected=f"{len(labels)}, for the sensors {', '.join(labels)}",
            hint="name one for every sensor of the model, in its order; for fewer sensors calibrate a model of them",
        )
    some = record.select(resolved(record, chosen, where="--response"))
    for channel, sensor in zip(some.channels, model.sensors, strict=True):
        if "arbitrary" not in (channel.unit, sensor.unit) and channel.unit != sensor.unit:
            raise InputError(
                f"channel {channel.label!r} is in another unit than the sensor {sensor.label!r} of the model",
                where="--response",
                found=f"{channel.unit} ({channel.quantity})",
                expected=f"{sensor.unit} ({sensor.quantity})",
                hint="name the channels in the order of the model's sensors",
            )
    return replace(some, channels=tuple(replace(c, label=s) for c, s in zip(some.channels, labels, strict=True)))


def known_load(record: Record, model: Model, channel: str) -> NDArray[Any]:
    """The measured load, shape (samples,), that an estimate of this model can be compared with.

    Raises
    ------
    InputError
        A channel that is not there, in another unit than the load, or with gaps; a model of several loads.
    """
    import numpy as np

    column = record.index(channel)
    known, loads = record.channels[column], model.loads
    if len(loads) != 1:
        raise InputError("one load is compared with one channel", where="--truth",
                         found=f"{len(loads)} loads: {', '.join(c.label for c in loads)}",
                         expected="a model of one load", hint="leave --truth out")  # fmt: skip
    if "arbitrary" not in (known.unit, loads[0].unit) and known.unit != loads[0].unit:
        raise InputError(
            f"channel {known.label!r} is in another unit than the load",
            where="--truth",
            found=f"{known.unit} ({known.quantity})",
            expected=f"{loads[0].unit} ({loads[0].quantity})",
            hint=f"name the channel of the load, or state its unit (--unit {known.label}={loads[0].unit})",
        )
    values = record.values[:, column]
    if not np.all(np.isfinite(values)) or not np.any(values):
        raise InputError(
            f"channel {known.label!r} is nothing to compare with",
            where="--truth",
            found=f"{int(np.sum(~np.isfinite(values)))} missing samples" if np.any(values) else "zero throughout",
            expected="a measured load without gaps",
            hint="leave --truth out, or name another channel",
        )
    return values


def _configure(parser: ArgumentParser) -> None:
    from ..settings import METHODS, OVER, PATHS, SIGNALS, VARIANCES

    parser.add_argument("log", metavar="LOG", help="log with the responses")
    parser.add_argument("--model", required=True, metavar="MODEL.h5", help="model file, from calibrate for example")
    parser.add_argument("-o", "--output", required=True, metavar="RESULT.h5", help="result file to write")
    parser.add_argument("--family", choices=sorted(FAMILIES), default="deconvolution")
    parser.add_argument("--method", choices=METHODS, help="default tikhonov")
    parser.add_argument(
        "--penalty",
        type=penalty,
        metavar="NAME",
        help="identity (default), first_difference, second_difference; none is plain least squares",
    )
    parser.add_argument(
        "--variance", choices=VARIANCES, help="of the load: local learns from the record where it acts, for impacts"
    )
    parser.add_argument(
        "--choice",
        type=choice,
        metavar="RULE",
        help="rule (discrepancy, upre, gcv, robust_gcv, l_curve, evidence, ...), or a relative lambda",
    )
    parser.add_argument(
        "--path", choices=PATHS, help="solver; default auto, which the result names: by length and model"
    )
    parser.add_argument("--initial", choices=STARTS, help="state of the structure at the first sample; default rest")
    parser.add_argument(
        "--leak",
        type=leak,
        metavar="PHI",
        help="with first_difference: a load that returns to zero by itself, for sensors that see no constant",
    )
    parser.add_argument(
        "--dictionary",
        choices=DICTIONARIES,
        help="waveforms of the sparse family: spikes (default), splines for longer pulses, wavelets",
    )
    parser.add_argument(
        "--signal",
        choices=SIGNALS,
        help="frequency family: averaged into spectra of the loads, or transformed once into their history",
    )
    parser.add_argument("--over", choices=OVER, help="frequency family: who decides on lambda; default neighbours")
    parser.add_argument(
        "--level", type=positive, metavar="SHARE", help="frequency family: predicted error to flag, as 0.1"
    )
    parser.add_argument("--band", type=band, metavar="LOW:HIGH", help="frequency family: lines that are inverted, Hz")
    parser.add_argument(
        "--segment", type=count, metavar="SAMPLES", help="frequency family: length of the averaged segments"
    )
    parser.add_argument("--nonnegative", action="store_true", help="loads that push and never pull")
    parser.add_argument(
        "--allow", type=names, metavar="CODE,...", help="refusals to override (E306, ...); printed on every picture"
    )
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


def _run(args: Namespace) -> int:
    require_outputs({"-o": args.output, "--report": args.report, "--plot": args.plot}, [args.log, args.model])
    allow = None if args.allow is None else known_codes(args.allow, where="--allow")
    model = load_model(args.model)
    log = _read(args.log, one_record(args), settings(args))
    truth = None if args.truth is None else known_load(log, model, args.truth)
    with Bar() as bar:
        estimate = identify(log, model, responses=args.response, progress=bar, **{**job(args), "allow": allow})
    if truth is not None and (estimate.axis is None or estimate.axis.name != "time"):
        raise InputError("a history cannot be compared with spectra", where="--truth", found="--signal stationary",
                         expected="a load over time", hint="leave --truth out")  # fmt: skip
    error = None if truth is None else against(estimate, truth)
    written = write_all(estimate, args.output, report=args.report, plot=args.plot, truth=truth)
    said = summary(estimate, details=args.details, command=True)
    lines = [said, *([comparison(error)] if error else []), f"written: {', '.join(written)}"]
    answer = {**estimate.to_dict(arrays=args.json_full), "against_known": error, "written": written}
    emit(args, answer, "\n".join(lines))
    return 0


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
