"""Long records: gains that settle are the gains, and the gradient vanishes, on systems that are hard on a recursion."""

import numpy as np
import pytest

from loadid._inverse.gaussian.path import StateSpacePath
from loadid._inverse.gaussian.record import WhitenedRecord

from .cases import Case, case, modal, off

SAMPLES = 20_000
HARD = {
    "lightly damped": modal([3, 11, 30], 1e-4, "d"),
    "accelerometer, lightly damped": modal([3, 11, 30], 1e-4, "a"),
    "stiff, near Nyquist": modal([5, 40, 420, 495], 0.01, "d"),
    "free body": modal([0, 20, 60], [0, 0.01, 0.01], "d"),
    "all but still": modal([0.001, 20], [0.05, 0.01], "d"),
    "two modes as one": modal([20, 20, 60], 0.01, "d"),
    "three kinds of sensor": modal([3, 11, 30, 100], 0.005, "dav"),
}
MATCHES = [(name, "identity", lam) for name in HARD for lam in (1e-1, 1e-4)] + [
    (name, penalty, lam)
    for name in HARD
    if "accelerometer" not in name
    for penalty, lam in (("first_difference", 1e-1), ("second_difference", 1e-1), ("second_difference", 1e-5))
]


def hard(name: str, samples: int = SAMPLES) -> Case:
    """A bump and a sine that push, with noise."""
    return case(HARD[name], samples)


def unsettled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every sample of a recursion is computed."""
    monkeypatch.setattr(WhitenedRecord, "settles", False)


@pytest.mark.parametrize(("name", "penalty", "lam"), MATCHES)
def test_settled_gains_are_the_gains(name: str, penalty: str, lam: float, monkeypatch: pytest.MonkeyPatch) -> None:
    given = hard(name)
    record: WhitenedRecord = given.record(penalty, given.y)
    scale = float(StateSpacePath(given.record(penalty, given.y[:1000])).scale)
    path = StateSpacePath(record, scale=scale)
    solution, edf = path.solution(lam, 1.0), float(path.scalars(lam).edf)
    assert path.gradient(lam) < 1e-12
    std = solution.posterior.std
    unsettled(monkeypatch)
    every = StateSpacePath(record, scale=scale)
    exact = every.solution(lam, 1.0)
    assert off(solution.load, exact.load) < 1e-9
    assert np.max(np.abs(std / exact.posterior.std - 1)) < 1e-9
    assert abs(edf / float(every.scalars(lam).edf) - 1) < 1e-9


def test_a_memory_of_many_samples_leaves_no_gradient() -> None:
    """A second difference at a large lambda on a free body: 24000 samples until the gains settle, 2e-10 unrefined."""
    given = case(HARD["free body"], 60_000)
    scale = float(StateSpacePath(given.record("second_difference", given.y[:5000])).scale)
    path = StateSpacePath(given.record("second_difference", given.y), scale=scale)
    path.solution(1.0, None)
    assert 20_000 < len(path._kept[1.0][0].K) < 40_000
    assert path.gradient(1.0) < 1e-13
