"""``loadid check``: every guard that needs no inversion, on a log, on a model, or on both."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.errors import InputError, NotIdentifiable, digests

from .._results.summary import number
from ..codes import GUARDS
from . import Command, UsageError, add_log_options, channels, emit, load_model, read_records, settings
from .identify import responses_of

if TYPE_CHECKING:
    from structures._flags import Flag
    from structures._model import Model

    from .._record import Record


NAMES = {
    code: GUARDS[code]
    for code in (
        *("W105", "W114", "W201", "W204", "W205", "W206", "W207", "W208", "W209", "W210", "W214", "W216"),
        *("W505", "W509", "W702", "W704"),
    )
}


@dataclass
class Findings:
    """What was checked, what fired, and what is known of the layout."""

    checked: list[str] = field(default_factory=list)
    flags: list[tuple[str, Flag]] = field(default_factory=list)
    layout: dict[str, Any] = field(default_factory=dict)
    notes: list[tuple[str, str]] = field(default_factory=list)

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
        return {"flags": fired, "checked": checked, "silent": self.silent, "layout": self.layout, "notes": notes}


def check(
    log: str | Path | Record | None = None,
    model: str | Path | Model | None = None,
    *,
    responses: list[str] | None = None,
    records: list[str] | None = None,
    **reading: Any,
) -> Findings:
    """Ask every guard that needs no inversion.

    Parameters
    ----------
    log : path or Record, optional
    model : path or Model, optional
    responses : list of str, optional
        Channels of the log in the order of the sensors of the model; default those of the same names.
    records : list of str, optional
        Names of the records to check; default all.
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
        findings.run("W209", where, partial(_of, record.flags, "W209"))
        if known is not None:
            check_pair(findings, known, record, where, responses)
    return findings


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

    facts: dict[str, Any] = {"m": len(model.sensors), "n": len(model.loads)}
    H = _transfer(model)
    if H is None:
        return facts
    s = np.linalg.svd(H, compute_uv=False)
    tiny = max(H.shape[1:]) * np.finfo(float).eps
    rank = int(np.max(np.sum(s > tiny * s[:, :1], axis=1), initial=0))
    last = s[:, rank - 1] if rank else np.zeros(len(s))
    fine = last > 0
    kappa = float(np.median(s[fine, 0] / last[fine])) if np.any(fine) else None
    return {**facts, "rank": rank, "nullity": facts["n"] - rank, "kappa": kappa}


def _transfer(model: Model) -> Any:
    """Transfer matrices (lines, sensors, loads): measured, between the resonances, or static; else None."""
    import numpy as np

    if model.frequencies is not None:
        return model.frf(model.frequencies)[model.frequencies > 0]
    modes = model.natural_frequencies
    try:
        if modes is not None and np.any(modes > 0):
            modes = modes[modes > 0][:40]
            return model.frf(
                np.sort(np.concatenate([0.7 * modes[:1], np.sqrt(modes[1:] * modes[:-1]), 1.2 * modes[-1:]]))
            )
        return model.static()[None]
    except (InputError, NotIdentifiable):  # a model that gives neither: the layout stays unknown
        return None


def show(findings: Findings) -> str:
    """Findings as text."""
    lines = []
    if findings.layout:
        words = {"m": "sensors", "n": "loads", "rank": "rank", "nullity": "nullity", "kappa": "condition number"}
        lines.append(
            "layout: "
            + ", ".join(f"{w} {number(findings.layout[k])}" for k, w in words.items() if k in findings.layout)
        )
    lines.append(f"fired: {len(findings.flags) or 'none'}")
    lines += [f"  {where}: {flag.command}" for where, flag in findings.flags]
    lines += [f"note: {where}: {note}" for where, note in findings.notes]
    lines.append("checked and silent:" + ("" if findings.silent else " none"))
    lines += [f"  {code} {NAMES.get(code, '')}".rstrip() for code in findings.silent]
    return "\n".join(lines)


def _configure(parser: ArgumentParser) -> None:
    parser.add_argument("log", nargs="?", metavar="LOG", help="log to check")
    parser.add_argument("--model", metavar="MODEL.h5", help="model file to check, alone or with the log")
    parser.add_argument(
        "--response", type=channels, metavar="CH,...", help="channels, in the order of the model's sensors"
    )
    add_log_options(parser, several=True)


def _run(args: Namespace) -> int:
    if args.log is None and args.model is None:
        raise UsageError("nothing to check: name a log, --model, or both (see loadid check --help)")
    findings = check(args.log, args.model, responses=args.response, records=args.record, **settings(args))
    emit(args, findings.to_dict(), show(findings))
    return 0


command = Command("check", "ask every guard that needs no inversion", _configure, _run)
