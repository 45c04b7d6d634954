"""Steps 4 to 8: one inversion of the log, seen from five sides, until its lambda is frozen and its inverse is kept."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from structures._flags import Flag
from structures.errors import InputError

from .._commands import _inputs as inputs
from .._commands._settings import CONSTRAINTS, known, load_family
from .._commands.identify import family_settings
from .._results.summary import UNEXPLAINED
from .context import AMPLITUDES, GuidedJob
from .outcome import Asked, Outcome
from .recipe import FREEZE

if TYPE_CHECKING:
    from .._results.estimate import LoadEstimate

STAGES = {4: "2356", 7: "45"}  # first digits of the codes that a step of the inversion shows
BESIDE = ("validation", "at", "mean", "noise")  # settings of a job that the family itself does not take
ABOUT_CONSTRAINTS, ABOUT_PRIOR = ("LID-W308", "LID-E309", "LID-W316"), ("LID-W311", "LID-N303")


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


def recoverable(asked: Asked) -> Outcome:
    """Step 4: rank, null space and the count of modes that the record tells above its noise."""
    e = found_by_rule(asked.job)
    figures: dict[str, Any] = {
        name: value
        for name in ("m", "n", "rank", "nullity", "kappa", "edf")
        if (value := e.facts.get(name)) is not None
    }
    if e.facts.resolution is not None:
        figures |= {"resolution": e.facts.resolution, "resolution_unit": e.facts.resolution_unit or ""}
    if e.diagnosis is not None:
        d = e.diagnosis
        figures |= {"recoverable_modes": d.plateau, "of_modes": d.seen, "noise_floor": d.floor, "decay": str(d.decay),
                    "cross_talk": e.facts.get("cross_talk")}  # fmt: skip
        seen = slice(0, d.seen)
        figures["picard"] = {"singular_values": _thinned(np.minimum(d.generalised / d.scale, 1.0)[seen]),
                             "coefficients": _thinned(d.coefficients[seen])}  # fmt: skip
        said = f"{d.plateau} of {d.seen} modes are recoverable; rank {d.rank}, nullity {d.nullity}"
    elif e.spectrum is not None:
        trusted, condition = e.trust(), np.asarray(e.spectrum.condition, float)
        known_lines = int(np.sum(trusted.all(axis=1)))
        fine = condition[np.isfinite(condition)]
        figures |= {
            "recoverable_lines": known_lines,
            "of_lines": len(trusted),
            "largest_condition": fine.max(initial=1.0),
        }
        said = f"{known_lines} of {len(trusted)} lines tell every load to {e.spectrum.level:.0%}"
    elif e.axis is not None and e.axis.name == "time":
        said = _histories(asked.job, e, figures)
    else:
        known_facts = [f"{name} {figures[name]:.4g}" for name in ("rank", "nullity", "edf") if name in figures]
        said = f"{', '.join(known_facts)}: no modes are counted of amplitudes on one line"
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
        f"{modes.recoverable} of {modes.unknowns} modes of the record stand above its noise; rank {modes.rank}, "
        f"nullity {modes.nullity}" + (f"; lambda uses {figures['edf']:.3g} of them" if "edf" in figures else "")
    )


def _thinned(values: Any, most: int = 100) -> list[float]:
    """What a picture needs of a curve: some of its points, five digits of each."""
    at = np.unique(np.linspace(0, len(values) - 1, min(most, len(values))).round().astype(int))
    return [float(f"{values[k]:.4e}") for k in at]


def constrained(asked: Asked) -> Outcome:
    """Step 5: what the constraints are, and what they change."""
    job, settings = asked.job, asked.job.options
    given = {name: settings[name] for name in CONSTRAINTS if settings.get(name)}
    e = found_by_rule(job)
    figures: dict[str, Any] = {"constraints": given or "none", "residual_share": residual_share(e)}
    if not given and job.family in AMPLITUDES:
        return Outcome("no constraint; amplitudes have a phase and no sign", figures)
    if not given:
        load = np.real(np.asarray(e.load))
        figures["negative_share_of_the_load"] = float(np.sum(load[load < 0] ** 2) / max(float(np.sum(load**2)), 1e-300))
        return Outcome(f"no constraint; {figures['negative_share_of_the_load']:.2%} of the load, squared, is negative",
                       figures, _coded(e, ABOUT_CONSTRAINTS))  # fmt: skip
    free = found_by_rule(job, **dict.fromkeys(given))
    moved = float(np.linalg.norm(e.load - free.load) / max(float(np.linalg.norm(free.load)), 1e-300))
    figures |= {"residual_share_without": residual_share(free), "load_moved_by": moved}
    if e.facts.held is not None:
        figures["held_at_zero"] = e.facts.held
    words = ", ".join(given)
    return Outcome(
        f"{words}: the load moves by {moved:.2%}, the residual from {figures['residual_share_without']:.2%} to "
        f"{figures['residual_share']:.2%} of the response",
        figures,
        _coded(e, ABOUT_CONSTRAINTS),
    )


def residual_share(e: LoadEstimate) -> float:
    if e.residual is None or e.response is None:
        return float("nan")
    return float(np.linalg.norm(e.residual) / max(float(np.linalg.norm(e.response)), 1e-300))


def penalised(asked: Asked) -> Outcome:
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


def froze(asked: Asked) -> Outcome:
    """Step 7: lambda by the discrepancy, or by the rule of the job, with the other rules as witnesses.

    Where no noise is known and the family learned from the record how the variance of its load changes, no lambda
    holds for the next record: that it is learned is frozen, each record learns its own.
    """
    job = asked.job
    noise = unloaded(asked)
    own = job.estimate(**noise)
    e = found_by_rule(job, **noise)
    require_explained(e)
    figures: dict[str, Any] = {"lam": _lam(e), "family": job.family}
    said = f"relative lambda {_lam(e):.4g}"
    if (c := e.choice) is not None:
        figures |= {
            "rule": c.rule,
            "verdict": c.verdict,
            "spread_decades": c.spread,
            "absolute_lambda": c.lam * c.scale,
            "noise_level": c.sigma,
            "noise_source": c.sigma_source,
            "edf": c.edf,
            "odds": c.odds,
        }
        figures["witnesses"] = {
            r.rule: {"lam": r.lam if r.lam is not None else "refused", "remark": r.note} for r in c.rules
        }
        apart = f", {c.spread:.2f} decades apart" if np.isfinite(c.spread) else ""
        said += f" by {c.rule}; verdict of the rules: {c.verdict}{apart}"
    if e.facts.get("variance") == "local":
        still = job.estimate(**noise, choice=_lam(e))
        moved = float(np.linalg.norm(still.load - e.load) / float(np.linalg.norm(e.load)))
        figures |= {"frozen": {"variance": "local"}, "one_lambda_differs_by": moved}
        said = (f"in place of a lambda every record tells how the variance of its load changes; a constant one, at "
                f"relative lambda {_lam(e):.4g}, gives a load {moved:.1%} away")  # fmt: skip
    if own.choice is not None and e.choice is not None and own.choice.rule != e.choice.rule:
        moved = float(np.linalg.norm(e.load - own.load) / max(float(np.linalg.norm(own.load)), 1e-300))
        figures["own_choice"] = {"rule": own.choice.rule, "lam": own.choice.lam, "load_differs_by": moved}
    if job.job.get("choice") is None and figures.get("rule") != "discrepancy":
        figures["discrepancy"] = (
            "not asked: no noise level but that of the residual; a record without load would tell one"
        )
    if noise:
        figures["noise"] = noise["noise"]
    figures["residual_share"] = residual_share(e)
    return Outcome(f"{said}; frozen", figures, _shown(7, e))


def require_explained(e: LoadEstimate) -> None:
    """Nothing, if a load explains its data.

    Raises
    ------
    InputError
    """
    for flag in e.flags:
        if flag.code == UNEXPLAINED:
            raise InputError("what does not explain its data is not frozen", where="step 7 of the guide",
                             found=flag.message, expected="a residual of the size of the noise",
                             hint=flag.advice)  # fmt: skip


def _lam(e: LoadEstimate) -> float:
    if e.choice is not None:
        return float(e.choice.lam)
    if e.facts.lam is not None:
        return float(e.facts.lam)
    raise InputError("this estimate has no lambda that could be frozen", where="step 7 of the guide",
                     found=str(e.provenance.get("family")), expected="a family with one relative lambda",
                     hint='name the family in the job: family = "deconvolution"')  # fmt: skip


def unloaded(asked: Asked) -> dict[str, Any]:
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
        raise InputError(
            "this record tells no noise level",
            where=asked.records[0].name,
            found=f"{len(responses)} samples, std {std.min(initial=np.inf):.3g} to {std.max(initial=0):.3g}",
            expected="16 samples or more of every sensor without load",
            hint="record the unloaded sensors for a minute",
        )
    found: dict[str, Any] = {"noise": dict(zip(responses.labels, std.tolist(), strict=True))}
    return found | ({"noise_source": "quiet"} if "noise_source" in known(job.family) else {})


def _shown(number: int, e: LoadEstimate) -> list[Flag]:
    """Flags of the stages that a step is about; what others show is left out, and that the band is not tested."""
    elsewhere = ABOUT_CONSTRAINTS + ABOUT_PRIOR if number == 4 else ()
    return [flag for flag in e.flags if flag.code[5] in STAGES[number] and flag.code not in elsewhere]


def _coded(e: LoadEstimate, codes: Sequence[str]) -> list[Flag]:
    return [flag for flag in e.flags if flag.code in codes]


# -- 8: the inverse ----------------------------------------------------------------------------------------------------
def at_frozen(asked: Asked) -> dict[str, Any]:
    """What step 7 froze: lambda or what stands in its place, and the noise level where a record told it."""
    figures = asked.latest[FREEZE].figures
    if "tracker" in figures:
        return {"tracker": asked.folder / str(figures["tracker"])}
    frozen: dict[str, Any] = dict(figures["frozen"]) if "frozen" in figures else {"choice": float(figures["lam"])}
    if "noise" in figures:
        frozen["noise"] = dict(figures["noise"])
        frozen |= {"noise_source": "quiet"} if "noise_source" in known(asked.job.family) else {}
    return frozen


def precomputed(asked: Asked) -> Outcome:
    """Step 8: the inverse at the frozen lambda, held against the load of step 7, and what a reading costs."""
    job, frozen = asked.job, at_frozen(asked)
    begun = time.process_time()
    e = job.estimate(**frozen)
    spent = time.process_time() - begun
    made = {asked.folder / f"{asked.stem}.frozen.toml": job.frozen_text(frozen, asked.folder.resolve()).encode()}
    figures: dict[str, Any] = {"frozen_job": f"{asked.stem}.frozen.toml"}
    figures |= {"lam": frozen["choice"]} if "choice" in frozen else {"variance": frozen["variance"]}
    if job.family == "static":
        inverse = _frozen_inverse(job, frozen)
        readings = np.atleast_2d(np.asarray(e.response, float))[:64]
        begun = time.perf_counter()
        loads = np.stack([inverse(row) for row in readings])
        each = (time.perf_counter() - begun) / len(readings)
        own = np.atleast_2d(np.asarray(e.load))[:64]
        off = float(np.linalg.norm(loads - own) / max(float(np.linalg.norm(own)), 1e-300))
        figures |= {"product": inverse.matrix is not None, "seconds_per_reading": each, "differs_by": off}
        said = "one product per reading" if inverse.matrix is not None else "a warm-started solver per reading"
        if inverse.matrix is not None:
            name = f"{asked.stem}.inverse.h5"
            figures |= {"inverse": name, "shape": list(inverse.matrix.shape)}
            made[asked.folder / name] = _bytes_of(inverse, asked.folder / name)
        return Outcome(
            f"{said}, {1e6 * each:.3g} us; differs from the estimate by {off:.1e} of its size",
            figures,
            (),
            off < 1e-6,
            made,
        )
    duration = job.responses(job.log).duration if not isinstance(job.log, Mapping) else 0.0
    unfrozen = found_by_rule(job, **{name: frozen[name] for name in ("noise", "noise_source") if name in frozen}).load
    off = float(np.linalg.norm(e.load - unfrozen) / max(float(np.linalg.norm(unfrozen)), 1e-300))
    figures |= {"cpu_seconds": spent, "seconds_of_record": duration, "differs_by": off}
    how = "at the frozen lambda" if "choice" in frozen else "with a variance that it learns"
    said = (f"no matrix stands for a history: {duration:.4g} s of record in {spent:.3g} s of CPU {how}; "
            f"differs from the load of step 7 by {100 * off:.2g} %")  # fmt: skip
    return Outcome(said, figures, (), True, made)


def _frozen_inverse(job: GuidedJob, frozen: Mapping[str, Any]) -> Any:
    """`StaticInversion.freeze` of the settings of a job.

    Raises
    ------
    InputError
        From the family: sensors of several units without noise levels, say.
    """
    options = {**job.options, **frozen}
    labels = [s.label for s in job.model.sensors]
    out = [str(one) for one in options.get("validation") or ()]
    used = [str(one) for one in options.get("sensors") or labels if str(one) not in out]
    settings = {name: value for name, value in options.items() if name not in BESIDE}
    if out:
        settings["sensors"] = used
    if options.get("noise") is not None:
        settings["noise"] = inputs.noise(options["noise"], labels, used)
    chosen = load_family("static")
    return chosen(job.model, **family_settings(settings, chosen, job.model)).freeze()


def _bytes_of(inverse: Any, path: Path) -> bytes:
    """The file of an inverse, made beside its place and taken away again: it appears with the signature."""
    with tempfile.TemporaryDirectory() as folder:
        inverse.save(Path(folder) / path.name)
        return (Path(folder) / path.name).read_bytes()
