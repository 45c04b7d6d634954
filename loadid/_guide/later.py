"""Steps 9 and 10: records that come later, held against what is known of them."""

from __future__ import annotations

from typing import Any

from structures.errors import InputError

from .. import _guards as guards
from .._results.summary import UNEXPLAINED
from .checks import certified, drift, watched
from .inversions import at_frozen, residual_share
from .ledger import hashed
from .models import certificate
from .outcome import Asked, Outcome
from .recipe import FREEZE, VERIFY
from .validation import validated

CONTRADICTED = (UNEXPLAINED, "LID-W214", "LID-W215")  # what says that a sensor or the model has changed


def validates(asked: Asked) -> Outcome:
    """Step 9: records of known loads, inverted at the frozen lambda, and the level that this reaches."""
    found, kept = validated(asked.job, asked.one_record(9, "records with known loads or resultants"), at_frozen(asked))
    kinds = sorted({check.kind for check in found.checks})
    figures: dict[str, Any] = {
        "level": found.level,
        "partial": found.partial,
        "agrees": found.agrees,
        "kinds": kinds,
        "checks": {
            f"{k}, {check.source or check.kind}": {"kind": check.kind, "agrees": check.agrees, "found": str(check)}
            for k, check in enumerate(found.checks, 1)
        },
    }
    partial = ", partial: the distribution is open" if found.partial else ""
    agrees = "" if found.agrees else "; it DISAGREES"
    return Outcome(f"level reached: {found.level}{partial}{agrees}", figures, [*found.flags, *kept], found.agrees)


def monitored(asked: Asked) -> Outcome:
    """Step 10: gains of a later record against those of step 2; without a known load what its sensors say."""
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
        against = [flag for flag in e.flags if flag.code in CONTRADICTED]
        figures: dict[str, Any] = {
            "known_load": False,
            "residual_share": residual_share(e),
            "residual_share_of_step_7": asked.latest[FREEZE].figures["residual_share"],
        }
        flags = list(guards.collect([*flags, *against]))
        off = [flag for flag in flags if flag.code in CONTRADICTED]
        seen = "sensors contradict each other or the model" if off else "the sensors do not contradict each other"
        said = f"no known load: {seen}; a gain that all of them have lost would not show"
        return Outcome(said, figures, flags, not off)
    now = certified(job, record)
    then = asked.latest[VERIFY]
    found = drift(certificate(then), int(then.figures["samples"]), now, len(record))
    figures = {"known_load": True, "source": now.source, "sensors": found.table,
               "largest_drift": found.table[found.most]["gain_over_step_2"] - 1}  # fmt: skip
    wrong = list(dict.fromkeys([*found.moved, *now.wrong]))
    words = f"; recalibrate: {', '.join(wrong)}" if wrong else ""
    return Outcome(f"gains have moved by {found.said} at most since step 2{words}", figures, flags, not wrong)
