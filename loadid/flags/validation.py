"""Guards of the validation."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

from structures.advice import Advice, Spelling
from structures.flags import Evidence, Flag

COVERED = 0.05  # how far the share inside a band may lie below its level
NECESSARY = "Necessary, not sufficient: infinitely many maps share this resultant"


def resultant_only(levels: Collection[str], numbers: int, loads: int) -> Flag | None:
    """N701: nothing but resultants was compared, and they are fewer independent numbers than loads."""
    if "resultant" not in levels or "distribution" in levels or numbers >= loads:
        return None
    return Flag(
        "N701",
        Evidence("independent numbers compared", numbers, loads),
        f"level: resultant. {NECESSARY}",
        "compare the distribution: a known indenter or load, an FE truth, or a pressure mat",
    )


def inverse_crime(simulated_by: str, fingerprint: str) -> Flag | None:
    """W702: the data were simulated with the model that inverts them."""
    if not simulated_by or simulated_by != fingerprint:
        return None
    return Flag(
        "W702",
        Evidence("model of the data", fingerprint[:12], "another mesh, other parameters"),
        f"same model {fingerprint[:12]} for data and inversion: the result is optimistic",
        "simulate with another mesh, 2-4 % of stiffness error and a finer step",
    )


def no_coverage(coverage: Any) -> Flag | None:
    """W703: a std is shown whose coverage nobody tested on this set-up, or whose band failed that test."""
    share, level = getattr(coverage, "share", None), getattr(coverage, "level", None)
    if share is None or level is None:
        return Flag(
            "W703",
            Evidence("coverage tests", 0, 1),
            "the std covers noise and prior as assumed; its coverage was not tested on this set-up",
            Advice(
                Spelling("run", "test it in Python:"),
                " loadid.validate.coverage(...) with loads like yours",
                Spelling(" and pass coverage=", ""),
            ),
        )
    if share >= level - COVERED:
        return None
    return Flag(
        "W703",
        Evidence("share of the true samples inside the band", float(share), float(level - COVERED)),
        f"{coverage}: the stated std is too small on this set-up",
        "widen the band by what the test shows, or look for model error and a prior that does not fit such loads",
    )


def used_for_training(name: str, overlap: Iterable[str]) -> Flag | None:
    """W704: validation data that were used in the inversion or in making the model."""
    overlap = sorted(overlap)
    if not overlap:
        return None
    return Flag(
        "W704",
        Evidence("shared", ", ".join(o[:16] for o in overlap), "none"),
        f"{name} is in both training and validation ({len(overlap)} shared): the agreement proves nothing",
        "keep a record, or a channel, out of the model and of the inversion",
    )
