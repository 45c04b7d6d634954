"""What the package computes for every step: figures, the flags of the guards, and the outcome in a sentence."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from structures._flags import Flag
from structures.errors import InputError

from .. import _guards as guards
from .._commands import _inputs as inputs
from .._commands._job import resolved
from .._commands._settings import CONSTRAINTS, known
from .._results.archive import plain
from .._results.summary import UNEXPLAINED
from .checks import certified, drift, of_rows, rows, watched, worst
from .context import MODELS, GuidedJob
from .ledger import Signature
from .recipe import FREEZE, VERIFY

if TYPE_CHECKING:
    from structures._certificate import Certificate

    from .._results.estimate import LoadEstimate

STAGES = {4: "2356", 5: "3", 6: "3", 7: "45"}  # first digits of the codes that a step of the inversion shows
ABOUT_CONSTRAINTS, ABOUT_PRIOR = ("LID-W308", "LID-E309", "LID-W316"), ("LID-W311", "LID-N303")
NOT_OURS = ("LID-W703",)  # what every estimate says, until its band is tested


@dataclass(frozen=True)
class Outcome:
    """What a step comes to.

    Parameters
    ----------
    said : str
    figures : mapping
        Numbers, texts, lists, and tables of them.
    flags : sequence of Flag
    holds : bool
        Whether it is as it must be.
    made : mapping of Path to bytes
        Files that the step makes, to be written with its signature.
    """

    said: str
    figures: Mapping[str, Any]
    flags: Sequence[Flag] = ()
    holds: bool = True
    made: Mapping[Path, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class Asked:
    """What a step is computed from.

    Parameters
    ----------
    job : GuidedJob
    evidence : sequence of Path
    latest : mapping of int to Signature
        Signatures of the steps before.
    folder, stem : Path, str
        Where files that a step makes are written, and how their names begin.
    """

    job: GuidedJob
    evidence: Sequence[Path]
    latest: Mapping[int, Signature]
    folder: Path
    stem: str

    @property
    def records(self) -> list[Path]:
        """Evidence that is a log: what a reader knows by its suffix; anything else is attached as it is."""
        from .._readers.source import known_suffixes

        return [path for path in self.evidence if path.suffix.lower() in known_suffixes()]

    def one_record(self, number: int, what: str) -> list[Path]:
        """The records, at least one.

        Raises
        ------
        InputError
            There is none.
        """
        if not self.records:
            raise InputError("evidence is missing", where=f"loadid guide sign {number}",
                             found=", ".join(path.name for path in self.evidence) or "no file", expected=what,
                             hint=f"loadid guide sign {number} --evidence RECORD")  # fmt: skip
        return self.records


def compute(number: int, asked: Asked) -> Outcome:
    """The outcome of a step.

    Raises
    ------
    InputError, NotIdentifiable
        From files, models and families; evidence that is missing.
    """
    return _OF[number](asked)


# -- 1, 2, 3: the model ------------------------------------------------------------------------------------------------
def _characterised(asked: Asked) -> Outcome:
    """Step 1: what the model states of its structure, and how far a model from another test agrees."""
    from .._commands import load_model

    if not asked.evidence:
        raise InputError("evidence is missing", where="loadid guide sign 1", found="no file",
                         expected="what the numbers of the model come from: a test report, a data sheet, a modal test",
                         hint="loadid guide sign 1 --evidence FILE...")  # fmt: skip
    model = asked.job.model
    figures: dict[str, Any] = {"model": type(model).__name__, "fingerprint": model.fingerprint}
    modes = model.natural_frequencies
    said = f"{type(model).__name__} of {_count(len(model.sensors), 'sensor')} and {_count(len(model.loads), 'load')}"
    if modes is not None and len(modes):
        figures |= {"natural_frequencies_hz": modes[:20], "modes": len(modes)}
        said += f", {len(modes)} modes from {modes[0]:.4g} Hz"
    if model.decay_rate is not None:
        figures["slowest_decay_per_s"] = model.decay_rate
    compared: dict[str, dict[str, float]] = {}
    for path in asked.evidence:
        if path.suffix.lower() in MODELS and modes is not None:
            test = load_model(path).natural_frequencies
            if test is not None and len(test) and len(modes):
                compared |= {
                    f"{path.name}, {f:.5g} Hz": {"model_hz": (own := float(modes[np.argmin(np.abs(modes - f))])),
                                                 "difference": own / f - 1}
                    for f in test.tolist() if f > 0
                }  # fmt: skip
    if compared:
        figures["against_a_test"] = compared
        said += f"; furthest from a test by {max(abs(row['difference']) for row in compared.values()):.2%} of a frequency"
    return Outcome(said, figures, model.flags)


def _count(many: int, word: str) -> str:
    return f"{many} {word}{'s' * (many != 1)}"


def _verified(asked: Asked) -> Outcome:
    """Step 2: the certificate of the model file, or of records with a known load."""
    job, found = asked.job, dict[str, Any]()
    if asked.records and not all(_is_model(path) for path in asked.records):
        found = {path.name: certified(job, job.record(path)) for path in asked.records if not _is_model(path)}
    elif job.model.certificate is not None:
        found = {Path(job.job["model"]).name: job.model.certificate}
    else:
        asked.one_record(VERIFY, "a record with a known load, or a model file that holds a certificate")
        raise InputError("the model file holds no certificate", where=str(job.job["model"]),
                         expected="a model that was verified, or a record with a known load as evidence",
                         hint="loadid guide sign 2 --evidence RECORD [--truth CH]")  # fmt: skip
    for name, one in found.items():
        if one.wrong:
            raise InputError(
                f"the model does not predict {', '.join(one.wrong)}: nothing can be built on it", where=name,
                found=worst(one), expected="a residual below half of the response, or within three times the noise",
                hint="look for the gain and the sign of the channel, its place, the supports and the modulus; "
                "the step stays open",
            )  # fmt: skip
    # of several records the one that the model explains least
    least = max(found.values(), key=lambda one: max(one.error))
    figures = {"source": least.source, "date": least.date, "sensors": rows(least)}
    if len(found) > 1:
        figures["records"] = {name: {"largest_residual": max(one.error)} for name, one in found.items()}
    flags = [guards.inverse_crime(record.simulated_by, job.model.fingerprint)
             for path in asked.records if not _is_model(path)
             for record in [job.record(path)] if record.simulated_by]  # fmt: skip
    return Outcome(f"verified against {least.source}; {worst(least)}", figures, guards.collect(flags))


def _is_model(path: Path) -> bool:
    """Whether a file of HDF5 is one that the package wrote: no log."""
    from structures.files import _storage as storage

    return path.suffix.lower() in MODELS and storage.kind_of(path) is not None


def certificate(signature: Signature) -> Certificate:
    """The certificate that a signature of step 2 holds."""
    figures = signature.figures
    return of_rows(figures["sensors"], str(figures["source"]), str(figures["date"]))


def _candidates(asked: Asked) -> Outcome:
    """Step 3: what the sensors see of the loads that may act, before any record."""
    from .._commands.check import Findings, check_model, layout

    model, findings = asked.job.model, Findings()
    check_model(findings, model)
    told = layout(model)
    figures: dict[str, Any] = {
        "sensors": {c.label: _channel(c) for c in model.sensors}, "loads": {c.label: _channel(c) for c in model.loads},
        "numbers": {name: told[name] for name in ("m", "n", "rank", "nullity", "kappa") if told.get(name) is not None},
    }  # fmt: skip
    said = f"{_count(len(model.sensors), 'sensor')}, {_count(len(model.loads), 'candidate load')}"
    if "rank" in told:
        said += f", rank {told['rank']}, nullity {told['nullity']} on a line"
    if (alike := told.get("alike")) is not None:
        figures["told_apart_least"] = {"loads": alike["loads"], "alike": alike["cosine"]}
    if told.get("unseen"):
        figures["without_a_trace"] = told["unseen"]
        said += f"; no sensor sees {', '.join(told['unseen'])}"
    flags = [flag for _, flag in findings.flags if flag.code != "LID-W114"]
    return Outcome(said, figures, flags)


def _channel(channel: Any) -> dict[str, Any]:
    noise = {} if getattr(channel, "noise", None) is None else {"noise_std": channel.noise}
    return {"quantity": channel.quantity, "unit": channel.unit, **noise}


# -- 4 to 7: one inversion, seen from four sides -----------------------------------------------------------------------
def found_by_rule(job: GuidedJob, **override: Any) -> LoadEstimate:
    """The load of the log at the lambda of the rule of the job; without one, of the discrepancy where noise is known.

    Raises
    ------
    InputError, NotIdentifiable
        From the family.
    """
    own = job.estimate(**override)
    if job.job.get("choice") is not None or own.choice is None or own.choice.source.kind in ("unknown", "residual"):
        return own
    return job.estimate(**{**override, "choice": "discrepancy"})


def _recoverable(asked: Asked) -> Outcome:
    """Step 4: rank, null space and the count of modes that the record tells above its noise."""
    e = found_by_rule(asked.job)
    figures: dict[str, Any] = {
        name: value for name in ("m", "n", "rank", "nullity", "kappa", "edf") if (value := e.facts.get(name)) is not None
    }  # fmt: skip
    if e.facts.resolution is not None:
        figures |= {"resolution": e.facts.resolution, "resolution_unit": e.facts.resolution_unit or ""}
    if e.diagnosis is not None:
        d = e.diagnosis
        figures |= {"recoverable_modes": d.plateau, "of_modes": d.seen, "noise_floor": d.floor, "decay": str(d.decay),
                    "cross_talk": e.facts.get("cross_talk")}  # fmt: skip
        seen = slice(0, d.seen)
        figures["picard"] = {"singular_values": _thinned((d.generalised / d.scale)[seen]),
                             "coefficients": _thinned(d.coefficients[seen])}  # fmt: skip
        said = f"{d.plateau} of {d.seen} modes are recoverable; rank {d.rank}, nullity {d.nullity}"
    elif e.spectrum is not None:
        trusted, condition = e.trust(), np.asarray(e.spectrum.condition, float)
        known_lines = int(np.sum(trusted.all(axis=1)))
        fine = condition[np.isfinite(condition)]
        figures |= {"recoverable_lines": known_lines, "of_lines": len(trusted), "largest_condition": fine.max(initial=1.0)}
        said = f"{known_lines} of {len(trusted)} lines tell every load to {e.spectrum.level:.0%}"
    else:
        said = _histories(asked.job, e, figures)
    return Outcome(said, figures, _shown(4, e))


def _histories(job: GuidedJob, e: LoadEstimate, figures: dict[str, Any]) -> str:
    """Modes of a record over time, by its lines."""
    from .._quality import noise_std
    from .modes import line_modes

    responses = job.responses(job.log)
    told = job.model.noise
    if told is None:
        found = noise_std(responses)
        told = None if found is None else found[0]
    std = told if told is None or told.ndim == 1 else np.sqrt(np.diagonal(told))
    modes = line_modes(job.model, responses.values, responses.dt, std, np.asarray(e.load))
    figures |= {
        "recoverable_modes": modes.recoverable, "of_modes": modes.unknowns, "rank_over_lines": modes.rank,
        "nullity_over_lines": modes.nullity, "condition_over_lines": modes.condition, "noise_floor": modes.floor,
        "counted": "data coefficients above a noise that is known" if std is not None else "by their plateau",
        "picard": {"singular_values": _thinned(modes.singular_values), "coefficients": _thinned(modes.coefficients)},
    }  # fmt: skip
    return (
        f"{modes.recoverable} of {modes.unknowns} modes of the record stand above its noise; rank {modes.rank}, nullity "
        f"{modes.nullity}; lambda uses {figures.get('edf', float('nan')):.3g} of them"
    )


def _thinned(values: Any, most: int = 100) -> list[float]:
    """What a picture needs of a curve: some of its points, five digits of each."""
    at = np.unique(np.linspace(0, len(values) - 1, min(most, len(values))).round().astype(int))
    return [float(f"{values[k]:.4e}") for k in at]


def _constrained(asked: Asked) -> Outcome:
    """Step 5: what the constraints are, and what they change."""
    job, settings = asked.job, asked.job.options
    given = {name: settings[name] for name in CONSTRAINTS if settings.get(name)}
    e = found_by_rule(job)
    figures: dict[str, Any] = {"constraints": given or "none", "residual_share": _residual(e)}
    if not given:
        load = np.real(np.asarray(e.load))
        figures["negative_share_of_the_load"] = float(np.sum(load[load < 0] ** 2) / max(float(np.sum(load**2)), 1e-300))
        return Outcome(f"no constraint; {figures['negative_share_of_the_load']:.2%} of the load, squared, pulls",
                       figures, _coded(e, ABOUT_CONSTRAINTS))  # fmt: skip
    free = found_by_rule(job, **dict.fromkeys(given))
    moved = float(np.linalg.norm(e.load - free.load) / max(float(np.linalg.norm(free.load)), 1e-300))
    figures |= {"residual_share_without": _residual(free), "load_moved_by": moved}
    if e.facts.held is not None:
        figures["held_at_zero"] = e.facts.held
    words = ", ".join(given)
    return Outcome(f"{words}: the load moves by {moved:.2%}, the residual from {figures['residual_share_without']:.2%} to "
                   f"{figures['residual_share']:.2%} of the response", figures, _coded(e, ABOUT_CONSTRAINTS))  # fmt: skip


def _residual(e: LoadEstimate) -> float:
    if e.residual is None or e.response is None:
        return float("nan")
    return float(np.linalg.norm(e.residual) / max(float(np.linalg.norm(e.response)), 1e-300))


def _penalised(asked: Asked) -> Outcome:
    """Step 6: the penalty, what it says of the load, and how wide a single load is shown under it."""
    job = asked.job
    e = found_by_rule(job)
    penalty = str(job.job.get("penalty", "identity" if "penalty" in known(job.family) else "that of the family"))
    figures: dict[str, Any] = {"penalty": penalty, "family": str(e.provenance.get("family", job.family)),
                               "prior": str(e.provenance.get("prior", "")), "grade": e.grade.letter,
                               "expected_error": e.grade.expected}  # fmt: skip
    for name in ("resolution", "resolution_unit", "peak_bias"):
        if e.facts.get(name) is not None:
            figures[name] = e.facts[name]
    return Outcome(f"penalty {penalty}; expected error of the load {e.grade.expected:.2g} of its size", figures,
                   _coded(e, ABOUT_PRIOR))  # fmt: skip


def _frozen(asked: Asked) -> Outcome:
    """Step 7: lambda by the discrepancy, or by the rule of the job, with the other rules as witnesses."""
    job = asked.job
    noise = _unloaded(asked)
    own = job.estimate(**noise)
    e = found_by_rule(job, **noise)
    if any(flag.code == UNEXPLAINED for flag in e.flags):
        flag = next(flag for flag in e.flags if flag.code == UNEXPLAINED)
        raise InputError("a lambda at which the load does not explain its data is not frozen", where="step 7 of the guide",
                         found=flag.message, expected="a residual of the size of the noise", hint=flag.advice)  # fmt: skip
    figures: dict[str, Any] = {"lam": _lam(e), "family": job.family}
    said = f"relative lambda {_lam(e):.4g}"
    if (c := e.choice) is not None:
        figures |= {"rule": c.rule, "verdict": c.verdict, "spread_decades": c.spread, "absolute_lambda": c.lam * c.scale,
                    "noise_level": c.sigma, "noise_source": c.sigma_source, "edf": c.edf, "odds": c.odds}  # fmt: skip
        figures["witnesses"] = {r.rule: {"lam": r.lam if r.lam is not None else "refused", "remark": r.note}
                                for r in c.rules}  # fmt: skip
        apart = f", {c.spread:.2f} decades apart" if np.isfinite(c.spread) else ""
        said += f" by {c.rule}; the rules: {c.verdict}{apart}"
    if own.choice is not None and e.choice is not None and own.choice.rule != e.choice.rule:
        moved = float(np.linalg.norm(e.load - own.load) / max(float(np.linalg.norm(own.load)), 1e-300))
        figures["own_choice"] = {"rule": own.choice.rule, "lam": own.choice.lam, "load_differs_by": moved}
    if noise:
        figures["noise"] = noise["noise"]
    figures["residual_share"] = _residual(e)
    return Outcome(f"{said}; frozen", figures, _shown(7, e))


def _lam(e: LoadEstimate) -> float:
    if e.choice is not None:
        return float(e.choice.lam)
    if e.facts.lam is not None:
        return float(e.facts.lam)
    raise InputError("this estimate has no lambda that could be frozen", where="step 7 of the guide",
                     found=str(e.provenance.get("family")), expected="a family with one relative lambda",
                     hint='name the family in the job: family = "deconvolution"')  # fmt: skip


def _unloaded(asked: Asked) -> dict[str, Any]:
    """Noise of every sensor, of a record without load; empty where none is named."""
    if not asked.records:
        return {}
    if len(asked.records) > 1:
        raise InputError("one record without load is needed", where="loadid guide sign 7",
                         found=", ".join(path.name for path in asked.records), expected="one")  # fmt: skip
    job = asked.job
    responses = job.responses(job.record(asked.records[0]))
    std = np.nanstd(responses.values, axis=0, ddof=1) if len(responses) > 1 else np.zeros(len(responses.labels))
    if len(responses) < 16 or not np.all(np.isfinite(std) & (std > 0)):
        raise InputError("this record tells no noise level", where=asked.records[0].name,
                         found=f"{len(responses)} samples, std {std.min(initial=np.inf):.3g} to {std.max(initial=0):.3g}",
                         expected="16 samples or more of every sensor without load",
                         hint="record the unloaded sensors for a minute")  # fmt: skip
    found: dict[str, Any] = {"noise": dict(zip(responses.labels, std.tolist(), strict=True))}
    return found | ({"noise_source": "quiet"} if "noise_source" in known(job.family) else {})


def _shown(number: int, e: LoadEstimate) -> list[Flag]:
    return [f for f in e.flags if f.code[5] in STAGES[number] and f.code not in NOT_OURS
            and not (f.code in ABOUT_CONSTRAINTS + ABOUT_PRIOR and number == 4)]  # fmt: skip


def _coded(e: LoadEstimate, codes: Sequence[str]) -> list[Flag]:
    return [flag for flag in e.flags if flag.code in codes]


# -- 8: the inverse ----------------------------------------------------------------------------------------------------
def at_frozen(asked: Asked) -> dict[str, Any]:
    """The settings that step 7 froze: lambda, and the noise level where a record told it."""
    figures = asked.latest[FREEZE].figures
    frozen: dict[str, Any] = {"choice": float(figures["lam"])}
    if "noise" in figures:
        frozen["noise"] = dict(figures["noise"])
        frozen |= {"noise_source": "quiet"} if "noise_source" in known(asked.job.family) else {}
    return frozen


def _precomputed(asked: Asked) -> Outcome:
    """Step 8: the inverse at the frozen lambda, held against the load of step 7, and what a reading costs."""
    job, frozen = asked.job, at_frozen(asked)
    begun = time.process_time()
    e = job.estimate(**frozen)
    spent = time.process_time() - begun
    text = resolved({**job.job, "output": None, "report": None, "plot": None, "family": job.family, **frozen},
                    asked.folder.resolve())  # fmt: skip
    made = {asked.folder / f"{asked.stem}.frozen.toml": text.encode()}
    figures: dict[str, Any] = {"lam": frozen["choice"], "frozen_job": f"{asked.stem}.frozen.toml"}
    if job.family == "static":
        from .inverse import frozen_inverse

        inverse = frozen_inverse(job, frozen)
        readings = np.atleast_2d(np.asarray(e.response, float))[:64]
        begun = time.perf_counter()
        loads = np.stack([inverse(row) for row in readings])
        each = (time.perf_counter() - begun) / len(readings)
        own = np.atleast_2d(np.asarray(e.load))[:64]
        off = float(np.linalg.norm(loads - own) / max(float(np.linalg.norm(own)), 1e-300))
        figures |= {"product": inverse.matrix is not None, "seconds_per_reading": each, "differs_by": off}
        said = ("one product per reading" if inverse.matrix is not None else "a warm-started solver per reading")
        if inverse.matrix is not None:
            name = f"{asked.stem}.inverse.h5"
            figures |= {"inverse": name, "shape": list(inverse.matrix.shape)}
            made[asked.folder / name] = _bytes_of(inverse, asked.folder / name)
        return Outcome(f"{said}, {1e6 * each:.3g} us; differs from the estimate by {off:.1e}", figures, (), off < 1e-6, made)
    duration = job.responses(job.log).duration if not isinstance(job.log, Mapping) else 0.0
    figures |= {"cpu_seconds": spent, "seconds_of_record": duration}
    said = f"no matrix stands for a history: {duration:.4g} s of record in {spent:.3g} s of CPU at the frozen lambda"
    return Outcome(said, figures, (), True, made)


def _bytes_of(inverse: Any, path: Path) -> bytes:
    """The file of an inverse, made beside its place and taken away again: it appears with the signature."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        inverse.save(Path(folder) / path.name)
        return (Path(folder) / path.name).read_bytes()


# -- 9, 10: against what is known --------------------------------------------------------------------------------------
def _validated(asked: Asked) -> Outcome:
    """Step 9: records of known loads, inverted at the frozen lambda, and the level that this reaches."""
    from .validation import validated

    found, kept = validated(asked.job, asked.one_record(9, "records with known loads or resultants"), at_frozen(asked))
    kinds = sorted({check.kind for check in found.checks})
    figures: dict[str, Any] = {
        "level": found.level, "partial": found.partial, "agrees": found.agrees, "kinds": kinds,
        "checks": {f"{k}, {check.source or check.kind}": {"kind": check.kind, "agrees": check.agrees, "found": str(check)}
                   for k, check in enumerate(found.checks, 1)},
    }  # fmt: skip
    partial = ", partial: the distribution is open" if found.partial else ""
    agrees = "" if found.agrees else "; it DISAGREES"
    return Outcome(f"level reached: {found.level}{partial}{agrees}", figures, [*found.flags, *kept], found.agrees)


def _monitored(asked: Asked) -> Outcome:
    """Step 10: gains of a later record against those of step 2; without a known load what its sensors say."""
    from .ledger import hashed

    job = asked.job
    path, *more = asked.one_record(10, "a later record, with its known load where there is one")
    if more:
        raise InputError("one later record at a time", where="loadid guide sign 10",
                         found=", ".join(one.name for one in asked.records), expected="one",
                         hint="sign the step once for each: all are kept")  # fmt: skip
    if hashed(path) in asked.latest[VERIFY].evidence.values() and job.reading.record is None:
        raise InputError("this record is the one of step 2: it shows no drift", where=path.name,
                         found="the same file", expected="a later record")  # fmt: skip
    record = job.record(path)
    flags = watched(job, record)
    if job.loads(record) is None:
        e = job.estimate(record, **at_frozen(asked))
        against = [f for f in e.flags if f.code in (UNEXPLAINED, "LID-W214", "LID-W215")]
        figures: dict[str, Any] = {"known_load": False, "residual_share": _residual(e),
                                   "residual_share_of_step_7": asked.latest[FREEZE].figures["residual_share"]}  # fmt: skip
        flags = list(guards.collect([*flags, *against]))
        off = [f for f in flags if f.code in (UNEXPLAINED, "LID-W214", "LID-W215")]
        said = "no known load: sensors that contradict each other are seen, a gain that all have lost is not"
        return Outcome(f"{said}; {'something has changed' if off else 'nothing has'}", figures, flags, not off)
    now = certified(job, record)
    table, beyond = drift(certificate(asked.latest[VERIFY]), now)
    ratios = {sensor: row["gain_over_step_2"] for sensor, row in table.items()}
    most = max(ratios, key=lambda sensor: abs(ratios[sensor] - 1))
    figures = {"known_load": True, "source": now.source, "largest_drift": ratios[most] - 1, "sensors": table}
    holds = not beyond and not now.wrong
    words = "" if holds else f"; recalibrate: {', '.join(dict.fromkeys([*beyond, *now.wrong]))}"
    return Outcome(f"gains have moved by {ratios[most] - 1:+.2%} at most ({most}) since step 2{words}", figures, flags, holds)


_OF: dict[int, Callable[[Asked], Outcome]] = {
    1: _characterised, 2: _verified, 3: _candidates, 4: _recoverable, 5: _constrained, 6: _penalised, 7: _frozen,
    8: _precomputed, 9: _validated, 10: _monitored,
}  # fmt: skip


def tidied(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Figures as a file holds them: numbers, texts, lists and tables; what is not known or not finite is left out."""
    found = {}
    for name, value in plain(figures).items():
        settled = tidied(value) if isinstance(value, dict) else value
        if settled is not None:
            found[name] = [one for one in settled if one is not None] if isinstance(settled, list) else settled
    return found
