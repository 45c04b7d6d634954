"""``loadid calibrate``: a measured forward model, from hammer hits or from shaker records with measured forces."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import structures
from structures._advice import Advice, Option
from structures.errors import InputError

from . import (
    Command,
    UsageError,
    add_log_options,
    band,
    channels,
    count,
    emit,
    number,
    read_records,
    require_outputs,
    resolved,
    settings,
    table,
)

if TYPE_CHECKING:
    from structures._models.measured import MeasuredModel
    from structures._models.tabulated import FrfModel

    from .._record import Record

EXCITATIONS = ("hammer", "shaker", "random")
ESTIMATORS = ("H1", "H2", "Hv", "Hs")
OF_HITS = ("gate", "decay")  # windows of hammer hits
AVERAGING = ("estimator", "window", "segment", "overlap")  # of records that are averaged
ON_LINES = ("coherence", "band", "frf_error", "interpolate")  # of FRFs on the lines that a shaker excites
EXAMPLES = """\
examples:
  three hits of an instrumented hammer:
    loadid calibrate hit1.csv hit2.csv hit3.csv --force hammer --response acc1,acc2 -o model.h5
  two shakers with independent random signals, a model with an impulse response:
    loadid calibrate random.csv --excitation random --force F1,F2 --response a1,a2,a3 -o model.h5
  a shaker that makes some lines: the part of the test that is stationary, and the lines that are coherent:
    loadid calibrate sine.csv --excitation shaker --force F --response tip --between 3:20 --segment 320 \\
        --coherence 0.99 --band 85:165 -o model.h5
"""


def calibrate(
    paths: Sequence[str | Path],
    *,
    force: str | Sequence[str],
    responses: Sequence[str],
    records: list[str] | None = None,
    excitation: str = "hammer",
    between: tuple[float, float] | None = None,
    averaging: Mapping[str, Any] | None = None,
    on_lines: Mapping[str, Any] | None = None,
    of_hits: Mapping[str, Any] | None = None,
    **reading: Any,
) -> MeasuredModel | FrfModel:
    """Model from the hits, or from the shaker records, in some logs.

    Parameters
    ----------
    paths : sequence of path
        Logs; every record of every log is one hit, or one run of the shakers.
    force, responses : str or sequence of str, sequence of str
        Channels, by name or index; several forces for shakers.
    records : list of str, optional
        Names of the records to use; default all.
    excitation : {"hammer", "shaker", "random"}
        Hits; FRFs on the lines that the forces excite (`FrfModel`); broadband forces, of which a model with an impulse
        response is made (`MeasuredModel`).
    between : (float, float), optional
        Part of every record that is used, in s.
    averaging : dict, optional
        ``estimator``, ``window``, ``segment``, ``overlap`` as for `structures.FrfModel.from_records`; not for hits.
    on_lines : dict, optional
        Of ``"shaker"``: ``coherence``, the least of a line; ``band`` in Hz; ``frf_error``, relative std that is stated
        of the FRF beside the noise which the segments show; ``interpolate`` between the lines.
    of_hits : dict, optional
        ``gate`` in s and ``decay`` in 1/s, as for `structures.MeasuredModel.from_hits`.
    **reading
        As for `loadid._readers.read`.

    Raises
    ------
    InputError
        From the readers, or when no usable hit or line is left; settings of another excitation.
    NotIdentifiable
        Forces that are one (LID-E212).
    """
    if excitation not in EXCITATIONS:
        raise InputError("no such excitation", where="excitation", found=repr(excitation),
                         expected=", ".join(EXCITATIONS))  # fmt: skip
    averaged, lines, windows = (_given(x) for x in (averaging, on_lines, of_hits))
    unused = [*(averaged if excitation == "hammer" else windows), *(lines if excitation != "shaker" else ())]
    if unused:
        fits = "shaker" if unused[0] in ON_LINES else "hammer" if unused[0] in OF_HITS else "shaker or random"
        raise InputError(f"{unused[0]} is no setting of excitation {excitation!r}", where="calibrate",
                         expected=f"excitation {fits}",
                         hint=Advice("say what moved the structure: ",
                                     Option("excitation", fits.split()[0])))  # fmt: skip
    forces = [force] if isinstance(force, str) else list(force)
    if excitation == "hammer" and len(forces) > 1:
        raise InputError("one hammer has one force", where="--force", found=", ".join(forces), expected="one channel",
                         hint=Advice("calibrate each place of the hammer on its own; for shakers that run together: ",
                                     Option("excitation", "shaker")))  # fmt: skip
    runs = []
    for path in paths:
        for record in read_records(path, records, reading):
            chosen = record.select(resolved(record, [*forces, *responses], where="--force and --response"))
            runs.append(chosen if between is None else chosen.window(*between))
    _require_one_step(runs)
    labels = runs[0].labels
    driven, heard = list(labels[: len(forces)]), list(labels[len(forces) :])
    if excitation == "hammer":
        made: MeasuredModel = structures.MeasuredModel.from_hits(runs, force=driven[0], responses=heard, **windows)
        return made
    if excitation == "random":
        found: MeasuredModel = structures.MeasuredModel.from_random(runs, forces=driven, responses=heard, **averaged)
        return found
    return _on_lines(runs, driven, heard, averaged, lines)


def _on_lines(
    runs: Sequence[Record], forces: list[str], responses: list[str], averaged: dict[str, Any], lines: dict[str, Any]
) -> FrfModel:
    """FRFs on the lines of a band that the forces excite coherently."""
    import numpy as np

    model: FrfModel = structures.FrfModel.from_records(
        runs, forces=forces, responses=responses, least_coherence=lines.get("coherence", 0.0), **averaged
    )
    if "band" in lines:
        low, high = lines["band"]
        inside = (model.frequencies >= low) & (model.frequencies <= high)
        if not inside.any():
            f = model.frequencies
            raise InputError("no calibrated line lies in the band", where="--band", found=f"{low:g} to {high:g} Hz",
                             expected=f"some of {len(f)} lines, {f[0]:g} to {f[-1]:g} Hz",
                             hint="widen the band, or take longer segments")  # fmt: skip
        model = model.at(inside)
    variance = model.variance
    if "frf_error" in lines:
        stated = (lines["frf_error"] * np.abs(model.H)) ** 2
        variance = stated if variance is None else variance + stated
    made: FrfModel = structures.FrfModel(
        model.frequencies, model.H, sensors=model.sensors, loads=model.loads, variance=variance,
        coherence=model.coherence, flags=model.flags, interpolate=bool(lines.get("interpolate")),
    )  # fmt: skip
    return made


def _given(some: Mapping[str, Any] | None) -> dict[str, Any]:
    return {k: v for k, v in (some or {}).items() if v is not None and v is not False}


def _require_one_step(hits: Sequence[Record]) -> None:
    first = hits[0]
    other = next((h for h in hits if abs(h.dt / first.dt - 1) > 1e-6), None)
    if other is not None:
        raise InputError(
            "the hits have different steps",
            where=other.source or other.name or "hits",
            found=f"{other.fs:.9g} Hz, but {first.fs:.9g} Hz in {first.source or first.name or 'the first'}",
            expected="one sampling frequency",
            hint="leave one of the files out, or resample it",
        )


def describe(model: MeasuredModel | FrfModel) -> dict[str, Any]:
    """Hits or runs, lines and coherence of a measured model, as plain values."""
    f = model.frequencies
    return {
        "force": [c.label for c in model.loads],
        "responses": [c.label for c in model.sensors],
        "lines": len(f),
        "band": [float(f[0]), float(f[-1])],
        "hits": [{"name": h.name, "used": h.used, "reason": h.reason, "peak": float(h.peak)}
                 for h in (model.hits if model.sampled else ())],
        "coherence": coherence(model),
    }  # fmt: skip


def coherence(model: MeasuredModel | FrfModel) -> list[dict[str, Any]]:
    """Per sensor: median coherence, and the share of the lines on which it exceeds 0.9; None with one hit."""
    import numpy as np

    rows = []
    for j, sensor in enumerate(model.sensors):
        known = np.empty(0) if model.coherence is None else np.asarray(model.coherence, float)[:, j]
        known = known[np.isfinite(known)]
        rows.append(
            {
                "sensor": sensor.label,
                "median": float(np.median(known)) if known.size else None,
                "above_0.9": float(np.mean(known > 0.9)) if known.size else None,
            }
        )
    return rows


def show(data: dict[str, Any]) -> str:
    """Answer of `describe` as text."""
    several = len(data["force"]) > 1
    named = f"force{'s' * several} {', '.join(data['force'])}; responses {', '.join(data['responses'])}"
    lines = [f"{named}; {data['lines']} lines, {data['band'][0]:.6g} to {data['band'][1]:.6g} Hz"]
    if data["hits"]:
        hits = [["hit", "peak", "used", "reason"]]
        hits += [[h["name"], f"{h['peak']:.4g}", "yes" if h["used"] else "no", h["reason"]] for h in data["hits"]]
        lines.append(table(hits))
    rows = [["sensor", "median coherence", "lines above 0.9"]]
    for c in data["coherence"]:
        known = c["median"] is not None
        rows.append([c["sensor"], f"{c['median']:.4f}" if known else "-", f"{c['above_0.9']:.0%}" if known else "-"])
    lines.append(table(rows))
    if all(c["median"] is None for c in data["coherence"]):
        lines.append("  coherence needs two hits or more")
    return "\n".join(lines)


# -- the command line --------------------------------------------------------------------------------------------------
def _share(text: str) -> float:
    return number(text, "share: 0 <= SHARE < 1", lambda value: 0 <= value < 1)


def _seconds(text: str) -> float:
    return number(text, "length in s above 0", lambda value: value > 0)


def _rate(text: str) -> float:
    return number(text, "rate in 1/s, not below 0", lambda value: value >= 0)


def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument(
        "hits", nargs="+", metavar="LOG", help="logs: every record is one hit, or one run of the shakers"
    )
    parser.add_argument(
        "--force", required=True, type=channels, metavar="CH,...", help="channel of the hammer, or of each shaker"
    )
    parser.add_argument("--response", required=True, type=channels, metavar="CH,...", help="channels of the sensors")
    parser.add_argument("-o", "--output", required=True, metavar="MODEL.h5", help="model file to write")
    parser.add_argument("--excitation", choices=EXCITATIONS, default="hammer",
                        help="hammer (default); random: shakers over the whole band; shaker: some lines")  # fmt: skip
    parser.add_argument("--between", type=band, metavar="T0:T1", help="seconds of every record that are used")
    group = parser.add_argument_group("records of hammers")
    group.add_argument("--gate", type=_seconds, metavar="S",
                       help="so much of the force is kept on each side of its peak: the rest is noise")  # fmt: skip
    group.add_argument("--decay", type=_rate, metavar="RATE",
                       help="exponential window exp(-RATE t) on what rings on; its damping is taken out")  # fmt: skip
    group = parser.add_argument_group("records of shakers")
    group.add_argument("--estimator", choices=ESTIMATORS,
                       help="H1 (default: noise in the responses), H2 (in the forces), Hv (in both), Hs (as the noise "
                       "of the channels says)")  # fmt: skip
    group.add_argument("--segment", type=count, metavar="SAMPLES", help="length of the averaged segments")
    group.add_argument("--overlap", type=_share, metavar="SHARE", help="of the segments; default 0.5")
    group.add_argument("--window", metavar="NAME", help="hann (default), boxcar for whole periods, flattop, ...")
    group.add_argument("--coherence", type=_share, metavar="LEAST",
                       help="lines on which no sensor has this coherence are left out")  # fmt: skip
    group.add_argument("--band", type=band, metavar="LOW:HIGH", help="lines that are kept, Hz")
    group.add_argument("--frf-error", type=_share, metavar="SHARE",
                       help="relative std of the FRF beside its noise, for a test at one level")  # fmt: skip
    group.add_argument("--interpolate", action="store_true", help="answer between the lines too, linearly")
    add_log_options(parser, several=True)


def _run(args: Namespace) -> int:
    require_outputs({"-o": args.output}, args.hits)
    averaging, lines, windows = (
        {name: getattr(args, name) for name in some} for some in (AVERAGING, ON_LINES, OF_HITS)
    )
    if args.excitation == "hammer" and (given := [*_given(averaging), *_given(lines)]):
        option = given[0].replace("_", "-")
        raise UsageError(f"--{option} is for shakers: say --excitation shaker or --excitation random, or leave it out")
    if args.excitation != "hammer" and (given := [*_given(windows)]):
        raise UsageError(
            f"--{given[0]} is for hits of a hammer: leave out --excitation {args.excitation}, or --{given[0]}"
        )
    model = calibrate(
        args.hits, force=args.force, responses=args.response, records=args.record, excitation=args.excitation,
        between=args.between, averaging=averaging, on_lines=lines, of_hits=windows, **settings(args),
    )  # fmt: skip
    model.save(args.output)
    data = describe(model)
    flags = [f for f in model.flags if f.level != "note"]
    remarks = [f"  {f.command}" for f in flags]
    answer = {**data, "excitation": args.excitation, "flags": [f.to_dict() for f in flags], "model": args.output}
    emit(args, answer, "\n".join([show(data), *remarks, f"model written to {args.output}"]))
    return 0


command = Command("calibrate", "make a forward model from hammer hits or shaker records", _configure, _run)
