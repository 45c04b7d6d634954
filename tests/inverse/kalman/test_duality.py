"""The information recursion of the deconvolution is the covariance recursion of the filter, transposed."""

from __future__ import annotations

import numpy as np
import pytest

from loadid._inverse.gaussian.gains import gains
from loadid._inverse.gaussian.model import FilterModel
from loadid._inverse.gaussian.passes import solve
from loadid._inverse.gaussian.record import augment, record
from loadid._inverse.gaussian.records import filter_record, smooth_record
from loadid._inverse.gaussian.roots import joined, lower, square

from .gaussian import building

LAM = 0.3


def system() -> tuple[np.ndarray, ...]:
    house = building(storeys=4, acc=(1, 3), disp=(3,))
    unit = np.array([0.3, 0.5, 1e-3])
    return house.A, house.B, house.G / unit[:, None], house.J / unit[:, None]


@pytest.mark.parametrize("penalty", ["identity", "first_difference"])
def test_gains_are_those_of_the_dual_filter(penalty: str) -> None:
    own = augment(*system(), penalty, from_zero=True, unknown_start=True)
    held = gains(record(own, np.zeros((40, own.m))), LAM)
    p, n = own.p, own.n
    noise = square(lower(np.block([[own.D.T, LAM * np.eye(p)], [own.C.T, np.zeros((n, p))]])))
    ahead, L = np.vstack([own.G.T, own.F.T]), np.zeros((n, n))
    for k in range(39, -1, -1):
        made = joined(noise, ahead @ L)
        Se, gain, L = made[:p, :p], made[p:, :p], np.ascontiguousarray(np.tril(made[p:, p:]))
        row = held.which[k]
        assert np.allclose(Se @ Se.T, held.R[row].T @ held.R[row], rtol=1e-12, atol=0)
        np.testing.assert_allclose(np.linalg.solve(Se.T, gain.T), held.K[row], rtol=0, atol=1e-11 * np.abs(gain).max())
    cost = held.start.T @ (L @ L.T)[np.ix_(own.free, own.free)] @ held.start
    np.testing.assert_allclose(cost, np.eye(len(own.free)), rtol=0, atol=1e-10)


def test_smoother_gives_the_inputs_of_the_record() -> None:
    """With the inputs as noise that its sensors feel, at a lambda that both forms bear."""
    own = augment(*system(), "identity")
    made = record(own, np.random.default_rng(0).standard_normal((60, own.m)))
    load = solve(made, gains(made, LAM)).load
    G, D, n = own.G / LAM, own.D / LAM, own.n
    model = FilterModel(
        F=own.F, LQ=G, H=own.C, LR=lower(np.hstack([D, np.eye(own.m)])), Cp=np.eye(n), x0=np.zeros(n),
        L0=np.zeros((n, 1)), nx=n, S=G @ D.T,
    )  # fmt: skip
    x = smooth_record(filter_record(model, made.y)).load
    moved = (x[1:] - x[:-1] @ own.F.T) @ np.linalg.pinv(own.G).T
    assert np.allclose(moved, load[:-1], rtol=0, atol=1e-8 * np.abs(load).max())
