"""What the package computes for every step: figures, the flags of the guards, and the outcome in a sentence."""

from __future__ import annotations

from collections.abc import Callable

from .inversions import constrained, froze, penalised, precomputed, recoverable
from .later import monitored, validates
from .models import candidates, characterised, verified
from .outcome import Asked, Outcome
from .trackers import replayed, tuned

_OF: dict[int, Callable[[Asked], Outcome]] = {
    1: characterised, 2: verified, 3: candidates, 4: recoverable, 5: constrained, 6: penalised, 7: froze,
    8: precomputed, 9: validates, 10: monitored,
}  # fmt: skip
_OF_TRACKERS: dict[int, Callable[[Asked], Outcome]] = {7: tuned, 8: replayed}


def compute(number: int, asked: Asked) -> Outcome:
    """The outcome of a step.

    Raises
    ------
    InputError, NotIdentifiable
        From files, models and families; evidence that is missing.
    """
    if number in _OF_TRACKERS and asked.job.family == "tracker":
        return _OF_TRACKERS[number](asked)
    return _OF[number](asked)
