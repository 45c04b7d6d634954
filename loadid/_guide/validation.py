"""Records of known loads, inverted at the frozen lambda and held against what is known, at both levels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from structures._flags import Flag
from structures.errors import InputError, digests

from .. import _guards as guards
from ..validate import Known, ReferenceWrench, Validation, held_out, validate
from .context import AMPLITUDES, GuidedJob

if TYPE_CHECKING:
    from .._record import Record
    from .._results.estimate import LoadEstimate


def validated(job: GuidedJob, paths: Sequence[Path], frozen: Mapping[str, Any]) -> tuple[Validation, list[Flag]]:
    """What the records come to together, and what was found of the records themselves.

    Raises
    ------
    InputError
        A record that holds nothing known of its load.
    """
    if job.family in AMPLITUDES:
        raise InputError("amplitudes have no level of validation", where="step 9 of the guide", found=job.family,
                         expected="loads over time, or static ones",
                         hint="validate a job over time, or leave step 9 open")  # fmt: skip
    checks, raised, beside = list[Any](), list[Flag](), list[Flag | None]()
    for path in paths:
        record = job.record(path)
        e = job.estimate(record, **frozen)
        references = [*_references(job, record, e)]
        if not references:
            raise InputError(
                "the record holds nothing that is known of its load",
                where=path.name,
                found=f"channels {', '.join(record.labels)}",
                expected=f"channels named as loads ({', '.join(c.label for c in job.model.loads[:6])}) or as "
                f"resultants ({', '.join(job.resultants())})",
                hint="name the channels with --truth CH,..., or keep sensors out with validation in the job",
            )
        found = validate(e, *references)
        checks += found.checks
        raised += found.flags
        responses = job.responses(record)
        if record.simulated_by:
            beside.append(guards.inverse_crime(record.simulated_by, job.model.fingerprint))
        seen = {*job.model.training, *job.inverted}
        beside.append(guards.used_for_training(path.name, set(digests(responses.values)) & seen))
    return (
        Validation(tuple(checks), _open(raised, checks), datetime.now(UTC).isoformat(timespec="seconds")),
        list(guards.collect(beside)),
    )


def _open(flags: Sequence[Flag], checks: Sequence[Any]) -> tuple[Flag, ...]:
    """The flags; N701, that resultants alone were compared, goes where another record knew the distribution."""
    whole = any(check.kind == "distribution" for check in checks)
    return guards.collect(f for f in flags if not (whole and f.code == "LID-N701"))


def _references(job: GuidedJob, record: Record, e: LoadEstimate) -> Sequence[Any]:
    source, found = record.name or record.source, list[Any]()
    load, weights = job.loads(record), job.resultants()
    rows = len(np.atleast_2d(e.load)) if e.load.ndim == 2 else 1
    if load is not None:
        known = load[:rows] if e.load.ndim == 2 else load.mean(axis=0)
        found.append(Known(known, source=source))
        if len(job.model.loads) > 1 and weights:  # its resultants are known too
            C = np.stack([*weights.values()])
            value = known @ C.T
            keep = np.any(np.abs(np.atleast_2d(value)) > 0, axis=0)
            if keep.any():
                labels = [name for name, one in zip(weights, keep, strict=True) if one]
                found.append(ReferenceWrench(value[..., keep], labels=labels, C=C[keep], source=source))
    named = [name for name in weights if name in record.labels]
    if named and load is None:
        value = np.column_stack([record[name] for name in named])
        value = value[:rows] if e.load.ndim == 2 else value.mean(axis=0)
        found.append(ReferenceWrench(value, labels=named, C=np.stack([weights[n] for n in named]), source=source))
    if kept := [str(one) for one in job.job.get("validation", ())]:
        labels = [s.label for s in job.model.sensors]
        model = job.model.with_sensors([labels.index(one) for one in kept])
        found.append(held_out(e, model, job.responses(record)))
    return found
