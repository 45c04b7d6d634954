"""``loadid check``: every guard that needs no inversion, on a log, on a model, or on both; what accuracy to expect."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.errors import InputError, NotIdentifiable, digests

from .._results.summary import number
from ..codes import GUARDS
from . import Command, UsageError, add_log_options, channels, emit, hit, load_model, read_records, settings, stds
from .identify import responses_of

if TYPE_CHECKING:
    from structures._flags import Flag
    from structures._model import Model

    from .._record import Record


NAMES = {
    code: GUARDS[code]
    for code in (
        *("W105", "W114", "W201", "W204", "W205", "W206", "W207", "W208", "W209", "W210", "W214", "W216", "W220"),
        *("W505", "W509", "W702", "W704"),
    )
}


EXAMPLES = """\
examples:
  is every channel sound, before anything is inverted:
    loadid check log.csv
  what can these sensors tell, and how well would a hit of 2 ms and 500 N be found, before anything is measured:
    loadid check --model model.h5 --pulse 0.002:500 --noise 0.05
  do log and model belong together, and does a sensor contradict the others:
    loadid check log.csv --model model.h5
"""


@dataclass
class Findings:
    """What was checked, what fired, and what is known of the layout."""

    checked: list[str] = field(default_factory=list)
    flags: list[tuple[str, Flag]] = field(default_factory=list)
    layout: dict[str, Any] = field(default_factory=dict)
    notes: list[tuple[str, str]] = field(default_factory=list)
    forecast: Any = None  # `loadid.design._forecast.Forecast` of a dynamic model
    static: Any = None  # `loadid.design._layout.Judged` where static loads are seen
    stated: str = ""  # what that takes for granted

    def run(self, code: str, where: str, guard: Callable[[], Any]) -> None:
        """Ask one guard, which answers with None, a flag or several of them."""
        if code not in self.checked:
            self.checked.append(code)
        answer = guard()
        found = [answer] if hasattr(answer, "code") else list(answer or ())
        self.flags += [(where, f) for f in found]

    @property
    def silent(self) -> list[str]:
        """Codes that were checked and did not fire."""
        fired = {f.code.removeprefix("LID-") for _, f in self.flags}
        return sorted(c for c in self.checked if c not in fired)

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        fired = [{"where": where, **f.to_dict()} for where, f in self.flags]
        notes = [{"where": where, "note": note} for where, note in self.notes]
        checked = sorted(self.checked)
        told = {"forecast": None if self.forecast is None else self.forecast.to_dict(),
                "static": None if self.static is None else self.static.to_dict()}  # fmt: skip
        return {
            "flags": fired,
            "checked": checked,
            "silent": self.silent,
            "layout": self.layout,
            **told,
            "notes": notes,
        }


def check(
    log: str | Path | Record | None = None,
    model: str | Path | Model | None = None,
    *,
    responses: list[str] | None = None,
    records: list[str] | None = None,
    pulse: tuple[float, float] | None = None,
    noise: list[float] | None = None,
    **reading: Any,
) -> Findings:
    """Ask every guard that needs no inversion, and what accuracy to expect.

    Parameters
    ----------
    log : path or Record, optional
    model : path or Model, optional
    responses : list of str, optional
        Channels of the log in the order of the sensors of the model; default those of the same names.
    records : list of str, optional
        Names of the records to check; default all.
    pulse : (float, float), optional
        Duration (s) and peak of the hit whose error is expected; default 1 ms and 100 units of the load.
    noise : list of float, optional
        Std of the sensors, SI: one, or one for each; default that of the model, else of the first record.
    **reading
        As for `loadid._readers.read`.

    Raises
    ------
    InputError
        If neither is given, or one cannot be read, or they do not fit together.
    """
    if log is None and model is None:
        raise InputError("nothing to check", where="check", expected="a log, --model, or both")
    findings = Findings()
    known = load_model(model) if isinstance(model, str | Path) else model
    if known is not None:
        check_model(findings, known)
    found = read_records(log, records, reading) if isinstance(log, str | Path) else [log] if log is not None else []
    for record in found:
        where = record.name or Path(record.source).name or "record"
        findings.notes += [(where, note) for note in record.notes]
        findings.run("W206", where, record.health)
        coarse = any(flag.code == "LID-W220" for flag in record.flags)
        for code in ("W209", *(["W220"] if coarse else [])):  # what was not resampled is not asked
            findings.run(code, where, partial(_of, record.flags, code))
        if known is not None:
            check_pair(findings, known, record, where, responses)
    if known is not None:
        expect(findings, known, found[0] if found else None, responses, pulse, noise)
    return findings


def expect(
    findings: Findings,
    model: Model,
    record: Record | None,
    responses: list[str] | None,
    pulse: tuple[float, float] | None,
    noise: list[float] | None,
) -> None:
    """What accuracy to expect: of a hit where the model is dynamic, of a static load where it gives that alone."""
    from .._quality import noise_std
    from ..design._forecast import Pulse, forecast

    hit = Pulse() if pulse is None else Pulse(*pulse)
    given: Any = None if noise is None else noise[0] if len(noise) == 1 else noise
    said, dt = "stated", None
    if record is not None:
        used = responses_of(record, model, responses)
        dt = used.dt
        told = noise_std(used) if given is None and model.noise is None else None
        given, said = (given, said) if told is None else (told[0], f"of the {told[1]}")
    if model.gives("impulse_response") or model.gives("frf"):
        try:
            findings.forecast = forecast(model, pulse=hit, noise=given, noise_source=said, dt=dt)
        except (InputError, NotIdentifiable) as error:
            findings.notes.append(("expected error of a hit", f"not known: {error.command}"))
    if model.gives("static") and not _blind(model):
        try:
            findings.static, findings.stated = _judged(model, given, hit.peak)
        except (InputError, NotIdentifiable) as error:
            findings.notes.append(("expected error of a static load", f"not known: {error.command}"))


def _judged(model: Model, noise: Any, size: float) -> tuple[Any, str]:
    """Std of every static load, of the size that is stated where the noise is, else of what stands out of it."""
    from ..design import compare

    known = noise is not None or model.noise is not None
    sizes: dict[str, Any] = {"amplitude": size} if known else {"snr": 100.0}
    words = (
        "noise as stated" if known else "the best sensor of a unit reads it at 100 times its noise, which is assumed"
    )
    return compare({"these sensors": model}, noise=noise, **sizes)["these sensors"], words


def check_model(findings: Findings, model: Model) -> None:
    """Guards that need the model alone."""
    from .. import _guards as flags

    findings.run("W114", "model", lambda: flags.not_verified(model.certificate))
    for code in ("W207", "W208") if model.frequencies is not None else ():
        findings.run(code, "model", partial(_of, model.flags, code))
    if model.frequencies is not None:
        from structures._testing.reciprocity import flags as reciprocal

        f = model.frequencies
        table = model.frf(f), model.sensors, model.loads, model.frf_variance(f)
        findings.run("W216", "model", lambda: reciprocal(f, *table))
    structure = model.structure
    if structure is not None:
        from structures._system.loads import near_support

        findings.run("W105", "model", lambda: near_support(structure, model.loads))  # type: ignore[arg-type]
    findings.layout = layout(model)
    if blind := _blind(model):
        findings.notes.append(("model", blind))
    if "rank" in findings.layout:
        size = [findings.layout[k] for k in ("m", "n", "rank")]
        findings.run("W201", "model", lambda: flags.null_space(*size))
    dt = model.dt
    if dt is not None and model.natural_frequencies is not None:
        findings.run("W509", "model", lambda: flags.aliased(model.natural_frequencies, dt))


def check_pair(findings: Findings, model: Model, record: Record, where: str, responses: list[str] | None) -> None:
    """Guards that need the model and a record of its sensors."""
    import numpy as np

    from .. import _guards as flags
    from .._quality import noise_std

    used = responses_of(record, model, responses)
    noisy = model.noise is not None or noise_std(used) is not None
    findings.run("W204", where, lambda: flags.mixed_kinds(used.channels, noisy))
    findings.run("W205", where, lambda: flags.high_pass(model.sensors, used.duration, used.channels))
    lost = np.isnan(used.values).mean(axis=0).tolist()
    findings.run("W210", where, lambda: flags.gaps(lost, used.labels))
    if model.gives("impulse_response"):
        h = model.impulse_response(used.dt, len(used))
        findings.run("W214", where, lambda: contradictions(model, used, h))
        findings.run("W505", where, lambda: flags.memory(model.decay_rate, used.duration, h, model.natural_frequencies))
    if model.natural_frequencies is not None:
        findings.run("W509", where, lambda: flags.aliased(model.natural_frequencies, used.dt))
    if record.simulated_by:
        findings.run("W702", where, lambda: flags.inverse_crime(record.simulated_by, model.fingerprint))
    training = model.training
    if training:
        findings.run("W704", where, lambda: flags.used_for_training(where, training.intersection(digests(used.values))))


def contradictions(model: Model, record: Record, h: Any) -> list[Flag]:
    """W214 and W215: sensors that contradict the others, where some are to spare and no sample is missing."""
    import numpy as np

    from .. import _guards as flags
    from .._families.answer import of_record, sought
    from .._families.noise import NoiseLevel
    from .._inverse.problem import STATED
    from .._quality import noise_std

    if np.isnan(record.values).any() or len(record.channels) <= h.shape[2]:
        return []
    found = model.noise if model.noise is not None else (noise_std(record) or (None,))[0]
    level = NoiseLevel(np.ones(len(record.channels)) if found is None else found, found is not None, STATED)
    told = sought(of_record(h, record.values, record.dt, level, record.channels))
    return [flags.contradicting(fault) for fault in told.faults]


def _of(flags: Iterable[Flag], code: str) -> list[Flag]:
    return [f for f in flags if f.code == f"LID-{code}"]


def layout(model: Model) -> dict[str, Any]:
    """Sensors, loads, and rank, nullity and median condition number over the lines."""
    import numpy as np

    from ..design._hitplacement import transfer

    facts: dict[str, Any] = {"m": len(model.sensors), "n": len(model.loads)}
    H = transfer(model)
    if H is None:
        return facts
    s = np.linalg.svd(H, compute_uv=False)
    tiny = max(H.shape[1:]) * np.finfo(float).eps
    rank = int(np.max(np.sum(s > tiny * s[:, :1], axis=1), initial=0))
    last = s[:, rank - 1] if rank else np.zeros(len(s))
    fine = last > 0
    kappa = float(np.median(s[fine, 0] / last[fine])) if np.any(fine) else None
    facts |= {"rank": rank, "nullity": facts["n"] - rank, "kappa": kappa}
    return facts if facts["n"] < 2 else {**facts, **_alike(H, [c.label for c in model.loads])}


def _alike(H: Any, labels: list[str]) -> dict[str, Any]:
    """The two loads that the sensors tell apart least, and loads without a trace; `H` is (lines, sensors, loads).

    Sensors of different units weigh the same: each row is divided by its largest response.
    """
    import numpy as np

    top = np.abs(H).max(axis=(0, 2))
    rows = (H / np.where(top > 0, top, 1.0)[:, None]).reshape(-1, H.shape[2])
    size = np.linalg.norm(rows, axis=0)
    seen = size > 1e-12 * size.max()
    unseen = [label for label, there in zip(labels, seen, strict=True) if not there]
    rows = rows / np.where(seen, size, 1.0)
    G = np.abs(np.einsum("li,lj->ij", rows.conj(), rows))
    np.fill_diagonal(G, -1.0)
    i, j = (int(k) for k in np.unravel_index(int(np.argmax(G)), G.shape))
    pair = {"loads": sorted((labels[i], labels[j]), key=labels.index), "cosine": float(min(G[i, j], 1.0))}
    return {"alike": pair, "unseen": unseen}


def _blind(model: Model) -> str:
    """Why no sensor sees a load that stands still; "" where one does, or may."""
    from .._guards.measurement import MOTION

    if all(c.quantity in MOTION for c in model.sensors):
        return "accelerations and velocities see no load that stands still: its mean is found from its start alone"
    if all(c.quantity in MOTION or c.highpass for c in model.sensors):
        corner = min(c.highpass for c in model.sensors if c.highpass)
        return f"no sensor sees a load that stands still: AC-coupled from {corner:.3g} Hz up"
    return ""


def show(findings: Findings) -> str:
    """Findings as text."""
    lines = []
    if findings.layout:
        words = {"m": "sensors", "n": "loads", "rank": "rank", "nullity": "nullity", "kappa": "condition number"}
        lines.append(
            "layout: "
            + ", ".join(f"{w} {number(findings.layout[k])}" for k, w in words.items() if k in findings.layout)
        )
    if alike := findings.layout.get("alike"):
        a, b = alike["loads"]
        lines.append(f"told apart least: {a} and {b}, alike to {alike['cosine']:.4g} (1: the same to these sensors)")
    if findings.layout.get("unseen"):
        lines.append(f"without a trace in any sensor: {', '.join(findings.layout['unseen'])}")
    lines += _expected(findings)
    lines.append(f"fired: {len(findings.flags) or 'none'}")
    lines += [f"  {where}: {flag.command}" for where, flag in findings.flags]
    lines += [f"note: {where}: {note}" for where, note in findings.notes]
    lines.append("checked and silent:" + ("" if findings.silent else " none"))
    lines += [f"  {code} {NAMES.get(code, '')}".rstrip() for code in findings.silent]
    return "\n".join(lines)


def _expected(findings: Findings) -> list[str]:
    lines = [] if findings.forecast is None else [f"expected: {findings.forecast}"]
    if findings.static is None:
        return lines
    one = findings.static
    j, unit = one.worst, one.units[one.worst]
    worst = f", the worst of {len(one.loads)} loads," if len(one.loads) > 1 else ""
    size = f"{one.amplitude[j]:.3g} {unit}".removesuffix(" arbitrary")
    found = f"expected: a static load of {size} on {one.loads[j]}{worst} would be found to +-{100 * one.share[j]:.3g} %"
    return [*lines, f"{found} with these sensors (std; {findings.stated})"]


def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument("log", nargs="?", metavar="LOG", help="log to check")
    parser.add_argument("--model", metavar="MODEL.h5", help="model file to check, alone or with the log")
    parser.add_argument(
        "--response", type=channels, metavar="CH,...", help="channels, in the order of the model's sensors"
    )
    parser.add_argument("--pulse", type=hit, metavar="S:PEAK",
                        help="hit whose error is expected, peak in the load's unit; default 0.001:100")  # fmt: skip
    parser.add_argument(
        "--noise", type=stds, metavar="STD,...", help="of the sensors in SI: one, or one for each of the model"
    )
    add_log_options(parser, several=True)


def _run(args: Namespace) -> int:
    if args.log is None and args.model is None:
        raise UsageError("nothing to check: name a log, --model, or both (see loadid check --help)")
    asked = {"responses": args.response, "records": args.record, "pulse": args.pulse, "noise": args.noise}
    findings = check(args.log, args.model, **asked, **settings(args))
    emit(args, findings.to_dict(), show(findings))
    return 0


command = Command("check", "ask every guard that needs no inversion", _configure, _run)
