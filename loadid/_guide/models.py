"""Steps 1 to 3: what the model is made of, whether it is right, and what its sensors see of its loads."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from structures.errors import InputError, digests

from .. import _guards as guards
from .checks import certified, of_rows, rows, worst
from .context import MODELS, GuidedJob
from .ledger import Signature, hashed
from .outcome import Asked, Outcome
from .recipe import VERIFY

if TYPE_CHECKING:
    from structures._certificate import Certificate


def characterised(asked: Asked) -> Outcome:
    """Step 1: what the model states of its structure, and how far a model from another test agrees."""
    from .._commands import load_model

    if not asked.evidence:
        raise InputError("evidence is missing", where="loadid guide sign 1", found="no file",
                         expected="what the numbers of the model come from: a test report, a data sheet, a modal test",
                         hint="loadid guide sign 1 --evidence FILE...")  # fmt: skip
    model = asked.job.model
    figures: dict[str, Any] = {"model": type(model).__name__, "fingerprint": model.fingerprint, **asked.job.described()}
    modes = model.natural_frequencies
    said = f"{type(model).__name__} of {_count(len(model.sensors), 'sensor')} and {_count(len(model.loads), 'load')}"
    if modes is not None and len(modes):
        figures |= {"natural_frequencies_hz": modes[:20], "modes": len(modes)}
        said += f", {len(modes)} modes from {modes[0]:.4g} Hz"
    if model.decay_rate is not None:
        figures["slowest_decay_per_s"] = model.decay_rate
    compared: dict[str, dict[str, float]] = {}
    own_file = hashed(asked.job.job["model"])
    for path in asked.evidence:
        if path.suffix.lower() in MODELS and modes is not None and hashed(path) != own_file:
            test = load_model(path).natural_frequencies
            if test is not None and len(test) and len(modes):
                compared |= {
                    f"{path.name}, {f:.5g} Hz": {"model_hz": (own := float(modes[np.argmin(np.abs(modes - f))])),
                                                 "difference": own / f - 1}
                    for f in test.tolist() if f > 0
                }  # fmt: skip
    if compared:
        figures["against_a_test"] = compared
        said += (
            f"; furthest from a test by {max(abs(row['difference']) for row in compared.values()):.2%} of a frequency"
        )
    made_from = {path.name: {"in_the_model": found} for path in asked.records
                 if (found := _made_from(asked.job, path)) is not None}  # fmt: skip
    if made_from:
        figures["made_from"] = made_from
    return Outcome(said, figures, model.flags)


def _made_from(job: GuidedJob, path: Path) -> bool | None:
    """Whether the model was made from a record; None where that cannot be told: no log of its sensors."""
    if not job.model.training or _is_model(path):
        return None
    try:
        responses = job.responses(job.record(path))
    except InputError:  # a tensile test, say
        return None
    return bool(job.model.training & set(digests(responses.values)))


def _count(many: int, word: str) -> str:
    return f"{many} {word}{'s' * (many != 1)}"


def verified(asked: Asked) -> Outcome:
    """Step 2: the certificate of the model file, or of records with a known load."""
    job, found = asked.job, dict[str, Any]()
    logs = [path for path in asked.records if not _is_model(path)]
    records = [job.record(path) for path in logs]
    if records:
        found = {path.as_posix(): certified(job, record) for path, record in zip(logs, records, strict=True)}
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
    samples = [len(record) for one, record in zip(found.values(), records, strict=False) if one is least]
    figures = {"source": least.source, "date": least.date, "samples": max(samples, default=1), "sensors": rows(least)}
    if len(found) > 1:
        figures["records"] = {name: {"largest_residual": max(one.error)} for name, one in found.items()}
    flags = [guards.inverse_crime(one.simulated_by, job.model.fingerprint) for one in records if one.simulated_by]
    return Outcome(f"verified against {least.source}; {worst(least)}", figures, guards.collect(flags))


def _is_model(path: Path) -> bool:
    """Whether a file of HDF5 is one that the package wrote: no log."""
    from structures.files import _storage as storage

    return path.suffix.lower() in MODELS and storage.kind_of(path) is not None


def certificate(signature: Signature) -> Certificate:
    """The certificate that a signature of step 2 holds."""
    figures = signature.figures
    return of_rows(figures["sensors"], str(figures["source"]), str(figures["date"]))


def candidates(asked: Asked) -> Outcome:
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
        where = "" if asked.job.family == "static" else " at a frequency line"
        said += f", rank {told['rank']}, nullity {told['nullity']}{where}"
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
