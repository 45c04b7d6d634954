"""No normal equations: what is computed at condition number 1e10 keeps the digits that the data hold.

A backward stable solution is wrong by the condition number times rounding, one that goes through the Gram matrix A^T A
by its square: of 1e10 nothing is left. The reference is a Householder QR in extended precision.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import scipy.linalg
from numpy.typing import NDArray

from loadid import Deconvolution, Lambda, StaticInversion
from loadid._inverse.constrained.nonnegative import NonNegativeRecord
from loadid._inverse.gaussian.path import StateSpacePath
from loadid._inverse.gaussian.record import augment, record
from loadid._inverse.sparse import path as sparse
from loadid._inverse.sparse.atoms import DenseAtoms
from loadid._inverse.spectral import compress, factor, posterior
from loadid.constraints import NonNegative
from structures import InputError
from structures._models.arrays import ImpulseModel, MatrixModel
from tests import halfsine
from tests.benchmarks.accuracy import bounds, extended, normal

from .reference import ill_conditioned

Array = NDArray[np.float64]
LEAST = 1e-12  # relative lambda: below the smallest singular value, 1e-10
UNKNOWNS = 20


def matrix(kappa: float = 1e10) -> Array:
    """Singular values in geometric progression."""
    return ill_conditioned(30, UNKNOWNS, kappa)


def smoothing() -> Array:
    """Impulse response whose Toeplitz matrix of 40 samples has a condition number of 1.4e10."""
    taps = np.poly1d([1.0, 0.97]) ** 8
    return np.concatenate([taps.coeffs / taps.coeffs.max(), np.zeros(31)])


def toeplitz() -> Array:
    """The matrix of `smoothing`."""
    return np.asarray(scipy.linalg.toeplitz(smoothing(), np.zeros(40)))


def static(H: Array, y: Array) -> Array:
    return StaticInversion(MatrixModel(H), choice=LEAST, noise=1.0).estimate(y).load


def nonnegative(H: Array, y: Array) -> Array:
    return StaticInversion(MatrixModel(H), choice=LEAST, noise=1.0, constraints=[NonNegative()]).estimate(y).load


def dense(H: Array, y: Array) -> Array:
    model = ImpulseModel(H[:, 0], 1.0, "held")
    return Deconvolution(model, choice=LEAST, noise=1.0).estimate(y[:, None], dt=1.0).load


def supported(H: Array, y: Array) -> Array:
    return sparse.fit(DenseAtoms(H), y, np.arange(H.shape[1])).x


def lines(H: Array, y: Array) -> Array:
    """One frequency line, its columns and rows turned by phases that the answer does not show."""
    rows, columns = (np.exp(1j * np.arange(k)) for k in H.shape)
    line = factor(compress((rows[:, None] * H / columns)[None], (rows * y)[None]), np.ones((1, H.shape[1])))
    return np.real(posterior(line, np.array([LEAST**2])).load[0, :, 0] / columns)


def error(load: Array, exact: NDArray[np.longdouble]) -> float:
    """Relative."""
    return float(np.linalg.norm(np.ravel(load) - exact) / np.linalg.norm(exact))


@pytest.mark.parametrize("route", [static, nonnegative, supported, lines, dense])
def test_an_answer_has_the_digits_of_the_condition_number_and_not_of_its_square(
    route: Callable[[Array, Array], Array],
) -> None:
    H = toeplitz() if route is dense else matrix()
    n = H.shape[1]
    y = H @ (1 + np.random.default_rng(1).random(n))
    lam = LEAST * float(np.linalg.norm(H, 2)) if route is not supported else 0.0
    exact = extended(H, y, np.eye(n), lam)
    assert 0.9e10 < np.linalg.cond(H) < 2e10
    assert error(normal(H, y, np.eye(n), lam), exact) > 0.1
    assert error(route(H, y), exact) < bounds(H, y, np.eye(n), lam, exact)[0] < 3e-5


def of_states(relative: float) -> tuple[NonNegativeRecord, StateSpacePath, NDArray[np.longdouble], float, float]:
    """A record of displacements: problem under signs, path, load in extended precision, its bound, error by H^T H."""
    s, n = halfsine.system("zoh"), 80
    C, D = s.C @ s.A, s.C @ s.B
    h = np.concatenate([D[None], s.impulse_response(s.dt, n + 1)[2:]])[:, 0, 0]
    H = scipy.linalg.toeplitz(h, np.zeros(n))
    y = H @ (2 + np.sin(np.arange(n) / 9))
    held = record(augment(s.A, s.B, C, D, "identity"), y[:, None])
    path = StateSpacePath(held)
    lam = relative * float(path.scale)
    exact = extended(H, y, np.eye(n), lam)
    squared = error(normal(H, y, np.eye(n), lam), exact)
    return NonNegativeRecord(held), path, exact, bounds(H, y, np.eye(n), lam, exact)[0], squared


@pytest.mark.parametrize("relative", [1e-4, 1e-6, 1e-8])
def test_a_state_space_keeps_them_at_every_lambda(relative: float) -> None:
    _, path, exact, bound, squared = of_states(relative)
    assert error(path.solution(relative, None).load, exact) < bound
    assert squared > 50 * bound


# -- where a Gram matrix is right, and what it costs -------------------------------------------------------------------
def test_blocks_of_a_record_under_signs_keep_them_to_a_lambda_of_1e_5() -> None:
    for relative, lost in ((1e-4, 1.0), (1e-5, 10.0), (1e-6, 1e3)):  # refined by residuals; then lambda^2 is rounding
        problem, path, exact, bound, _ = of_states(relative)
        found = problem.solve(relative * float(path.scale))
        assert found.converged
        assert error(found.load, exact) < lost * bound


@pytest.mark.parametrize(("kappa", "kept"), [(1e3, True), (1e5, True), (1e8, False)])
def test_more_columns_than_fit_keep_them_to_a_condition_of_1e5(
    kappa: float, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sparse, "FACTORISED", 0)
    H, y = matrix(kappa), matrix(kappa) @ (1 + np.random.default_rng(1).random(UNKNOWNS))
    exact = extended(H, y, np.eye(UNKNOWNS), 0.0)
    wrong = error(supported(H, y), exact)
    assert wrong < bounds(H, y, np.eye(UNKNOWNS), 0.0, exact)[0] if kept else wrong > 1e-3


@pytest.mark.parametrize("relative", [1e-1, 1e-4, 1e-6, 1e-9])
def test_signs_of_static_loads_keep_them_with_and_without_the_gram_matrix_that_directs(relative: float) -> None:
    H, g = matrix(), 1 + np.random.default_rng(1).random(UNKNOWNS)
    exact = extended(H, H @ g, np.eye(UNKNOWNS), relative)
    family = StaticInversion(MatrixModel(H), choice=relative, noise=1.0, constraints=[NonNegative()])
    load = family.estimate(H @ g).load
    free = load > 0
    exact = extended(H[:, free], H @ g, np.eye(UNKNOWNS)[:, free], relative)  # on its face
    assert error(load[free], exact) < bounds(H[:, free], H @ g, np.eye(UNKNOWNS)[:, free], relative, exact)[0]
    assert np.all(H[:, ~free].T @ (H @ load - H @ g) + relative**2 * load[~free] > -1e-12)


def test_a_path_that_cannot_keep_them_refuses() -> None:
    model = ImpulseModel(smoothing(), 1.0, "held")
    with pytest.raises(InputError, match="too small"):
        Deconvolution(model, choice=Lambda(LEAST, path="toeplitz"), noise=1.0).estimate(np.ones((40, 1)), dt=1.0)
