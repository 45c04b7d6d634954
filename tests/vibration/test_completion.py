"""Filled cross spectra: autospectra kept, coherences as said, and never a matrix that no responses have."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from loadid import Record
from loadid.vibration import Target, buzz, by_buzz, by_coherence, nearest, split_record
from structures import CrossSpectra
from structures.errors import InputError

from .. import lab

LINES = np.array([10.0, 20.0, 30.0])


def target(n: int = 3) -> Target:
    return Target(LINES, 0.5 + np.random.default_rng(0).random((3, n)), [f"s{i}" for i in range(n)])


def test_buzz_gives_its_coherence_and_phase_and_keeps_the_autospectra() -> None:
    f = lab.field().frequencies
    part = lab.part(lab.shaken(), lab.TARGET)
    wanted = Target(f, lab.field().restricted(lab.TARGET).autospectra, part.sensors)
    made, own = by_buzz(wanted, buzz(part, f)), buzz(part, f)
    assert np.allclose(made.autospectra, wanted.levels, rtol=1e-12)
    assert np.allclose(made.coherence, own.coherence, atol=1e-9)
    assert np.allclose(np.angle(made.matrix * own.matrix.conj()), 0, atol=1e-6)
    assert not made.flags


def test_stated_coherence_that_responses_can_have_comes_as_it_was_stated() -> None:
    made = by_coherence(target(), 0.3)
    off = ~np.eye(3, dtype=bool)
    assert np.allclose(made.coherence[:, off], 0.3)
    assert not made.flags
    turned = by_coherence(target(2), 0.5, phase=0.7)
    assert np.allclose(np.angle(turned.matrix[:, 0, 1]), 0.7)


def test_the_nearest_matrix_is_the_nearest() -> None:
    """Against a search over factors of unit rows, which is another way to write a matrix that responses have."""
    N = np.array([[1, 0.95, -0.3j], [0.95, 1, -0.8], [0.3j, -0.8, 1]])
    root = np.sqrt(target().levels)
    found = nearest(CrossSpectra(LINES, N * root[:, :, None] * root[:, None, :], channels=["a", "b", "c"], averages=9))
    got = found.matrix[0] / np.outer(root[0], root[0])
    assert np.linalg.eigvalsh(got)[0] > -1e-9
    assert np.allclose(found.autospectra, root**2, rtol=1e-9)

    def off(x: np.ndarray) -> float:
        L = x[:9].reshape(3, 3) + 1j * x[9:].reshape(3, 3)
        L = L / np.linalg.norm(L, axis=1, keepdims=True)
        return float(np.linalg.norm(L @ L.conj().T - N) ** 2)

    rng = np.random.default_rng(1)
    best = min(minimize(off, rng.standard_normal(18), options={"gtol": 1e-9}).fun for _ in range(4))
    assert np.linalg.norm(got - N) ** 2 == pytest.approx(best, rel=1e-4)
    assert [f.code for f in found.flags] == ["LID-W222"]


def test_a_matrix_that_responses_have_stays() -> None:
    own = lab.field().restricted(lab.TARGET)
    assert np.allclose(nearest(own).matrix, own.matrix, rtol=1e-9)
    assert not nearest(own).flags


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: by_coherence(target(), 1.2), "0 to 1"),
        (lambda: by_coherence(target(), np.zeros((2, 2))), r"\(3, 3, 3\)"),
        (lambda: by_coherence(target(), 0.2, np.ones((3, 3))), "odd"),
        (lambda: by_coherence(Target(LINES, np.ones((3, 1)), ["a"], kind="sine"), 0.2), "a sine has no cross"),
        (lambda: by_buzz(target(), buzz(lab.shaken(), lab.field().frequencies)), "no such channel"),
        (
            lambda: by_buzz(target(2), CrossSpectra(LINES, np.tile(np.diag([1.0, 0]), (3, 1, 1)).astype(complex),
                                                    channels=["s0", "s1"], averages=9)),
            "does not move a sensor",
        ),
        (
            lambda: by_buzz(target(1), CrossSpectra(LINES[:2], np.ones((2, 1, 1)), channels=["s0"], averages=9)),
            "lacks lines",
        ),
        (lambda: split_record(Record(np.ones((16, 1)), 0.1), 9), "parts"),
    ],
)  # fmt: skip
def test_what_cannot_be_filled_is_refused(make, says: str) -> None:
    with pytest.raises(InputError, match=says):
        make()


def test_parts_of_a_record_are_independent_and_alike() -> None:
    rng = np.random.default_rng(5)
    record = Record(rng.standard_normal((40_000, 2)) @ np.array([[1.0, 0.4], [0, 0.5]]), 1e-3, ["a", "b"])
    one, two = split_record(record, 2, segment=256)
    assert abs(np.mean(one.autospectra) / np.mean(two.autospectra) - 1) < 0.05
    spread = np.std(one.autospectra[2:-2] / two.autospectra[2:-2])
    assert spread == pytest.approx(np.sqrt(2 / one.averages), rel=0.3)
