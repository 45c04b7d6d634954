"""A structure and its loads as a linear system driven by noise, with the triangular roots of its covariances.

``P - F P F^T`` loses every digit of the noise of a short step (all of a Matern-5/2 load at a thousandth of its length),
and so does Van Loan's exponential. A quadrature adds only: its root is a triangular factor of weighted impulse
responses, with the relative accuracy of each of its columns.

A sample maps the predicted covariance P to ``L L^T + F P (I + M M^T P)^-1 F^T``; with ``M M^T = H^T R^-1 H`` and
``L L^T = Q``. Maps of this form are closed under composition, so that samples of any kind can be joined and a map
doubled. Chu, Fan, Lin & Wang, Int. J. Control 77 (2004) 767, for the doubling; here X and G are carried as roots, which
stay positive and feel no scale of the states.

Accelerometers alone let the mean of a load drift. A customary cure feeds the filter displacements of zero that nobody
measured, with a std. As data these would enter the innovations, their tests and the likelihood. Here they enter the
prior: the process of structure and loads, given that its displacements stay near zero at all times, is again a linear
one. With the cost-to-go ``x^T Lam x`` of leaving zero, which solves the Riccati equation dual to the filter's, its
step is ``(I + Q Lam)^-1 F`` and its noise ``(Q^-1 + Lam)^-1``: a smoother with it says what one says that is fed with
zeros before, during and after the record.

Sources: F. Naets, J. Cuadrado, W. Desmet, Mech. Syst. Signal Process. 50-51 (2015) 235-248, for the dummy measurements;
the conditioned process is Doob's transform of a Gauss-Markov chain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from structures.errors import InputError, plain, positive

NARROW, WIDE, LARGE = 4, 16, 100  # columns that `dtpqrt` reflects together, and the size from which it is the more


@lru_cache(maxsize=1)
def lapack() -> tuple[Any, Any, Any]:
    """``dgeqrf``, ``dtrtrs``, ``dtpqrt``, found once: numpy's QR copies and costs more than the work at these sizes.

    All are called by position, as names cost a microsecond: (a, lwork, overwrite), (a, b, lower, trans),
    (l, block, a, b, overwrite a, overwrite b).
    """
    from scipy.linalg.lapack import dgeqrf, dtpqrt, dtrtrs

    return dgeqrf, dtrtrs, dtpqrt


@lru_cache(maxsize=64)
def below(rows: int, columns: int) -> NDArray[np.float64]:
    """Ones on and below the diagonal."""
    ones = np.tril(np.ones((rows, columns)))
    ones.setflags(write=False)
    return ones


def reflected(wide: NDArray) -> NDArray[np.float64]:
    """``L`` with ``L L^T = wide wide^T`` in the lower triangle of what is returned; above it lie left-overs.

    Parameters
    ----------
    wide : array, shape (n, k), C-contiguous
        Overwritten.
    """
    made = lapack()[0](wide.T, 32 * max(len(wide), 1), 1)[0].T
    return made[:, : min(made.shape)]


def lower(*parts: NDArray) -> NDArray[np.float64]:
    """Lower triangular (trapezoidal) root of the sum of ``part part^T``; parts have shapes (n, any)."""
    wide = np.concatenate(parts, axis=1)
    if not wide.size:
        return np.zeros((len(wide), 0))
    made = reflected(np.ascontiguousarray(wide, float))
    return made * below(*made.shape)


def square(L: NDArray) -> NDArray[np.float64]:
    """The same root with columns of zeros up to a square."""
    out = np.zeros((len(L), len(L)))
    out[:, : L.shape[1]] = L
    return out


def joined(L: NDArray, wide: NDArray) -> NDArray[np.float64]:
    """Lower triangular root of ``L L^T + wide wide^T`` for a lower triangular L (n, n), which is half of the work.

    Parameters
    ----------
    L : array, shape (n, n), C-contiguous
    wide : array, shape (n, k), C-contiguous
        Overwritten.
    """
    if not wide.size:
        return L
    block = min(NARROW if len(L) < LARGE else WIDE, len(L))
    made: NDArray[np.float64] = lapack()[2](0, block, L.copy().T, wide.T, 1, 1)[0].T
    return made


def forward(L: NDArray, b: NDArray) -> NDArray[np.float64]:
    """``L^-1 b`` for a lower triangular L (k, k) and b (k,) or (k, columns)."""
    return lapack()[1](L, b, 1)[0] if len(L) else np.array(b, float)


def backward(L: NDArray, b: NDArray) -> NDArray[np.float64]:
    """``L^-T b`` for a lower triangular L (k, k) and b (k,) or (k, columns)."""
    return lapack()[1](L, b, 1, 1)[0] if len(L) else np.array(b, float)


NODES = 8  # exact to degree 15: 2e-15 of the noise at the step below
STEP = 0.5  # largest norm of F times the step that one rule covers; longer steps are doubled up to
TERMS = 24  # of the exponential series at that norm: the rest is below 1e-30


def step(F: NDArray, b: NDArray, dt: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transition and noise of ``dx = F x dt + b dW`` over a step.

    Parameters
    ----------
    F : array, shape (n, n)
        1/s.
    b : array, shape (n, q)
        Root of the density of the white noise.
    dt : float
        Step in s.

    Returns
    -------
    E : array, shape (n, n)
        ``exp(F dt)``.
    L : array, shape (n, n)
        Lower triangular, ``L L^T`` the integral of ``exp(F s) b b^T exp(F s)^T`` over the step; (n, k) where the
        noise has k < n directions.

    Notes
    -----
    Gauss-Legendre nodes over a part of the step that is short against F, then ``L(2h) = lower [E(h) L(h), L(h)]`` and
    ``E(2h) = E(h)^2`` as often as it takes. The series acts on `b` directly, so that entries of a high power of the
    step are as right as those of a low one.
    """
    F, b, unit = _balanced(F, b)
    size = float(np.abs(F).sum(axis=1).max(initial=0.0)) * dt
    doublings = max(0, int(np.ceil(np.log2(size / STEP)))) if size > 0 else 0
    h = dt / 2**doublings
    places, weights = leggauss(NODES)
    weighed = zip(places, weights, strict=True)
    pushes = [np.sqrt(0.5 * h * w) * _propagated(F, b, 0.5 * h * (1 + s)) for s, w in weighed]
    E, L = _propagated(F, np.eye(len(F)), h), lower(*pushes)
    for _ in range(doublings):
        L = lower(E @ L, L)
        E = E @ E
    return unit[:, None] * E / unit, unit[:, None] * L


def _balanced(F: NDArray, b: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """In units of the states (powers of two) in which no entry stands out: units of loads ask for no doublings."""
    from scipy.linalg import matrix_balance

    if len(F) == 0:
        return F, b, np.ones(0)
    even, (unit, _) = matrix_balance(F, permute=False, separate=True)
    return even, b / unit[:, None], unit


def _propagated(F: NDArray, b: NDArray, s: float) -> NDArray[np.float64]:
    """``exp(F s) b`` by its series, for a small ``F s``."""
    terms = [np.asarray(b, float)]
    for k in range(1, TERMS):
        terms.append(F @ terms[-1] * (s / k))
    return np.sum(terms[::-1], axis=0)  # the small ones first


DOUBLINGS = 40
SETTLED = 1e-14  # share of a variance that a doubling may still add


@dataclass(frozen=True, eq=False)
class Riccati:
    """``P -> L L^T + F P (I + M M^T P)^-1 F^T``; F (n, n), L (n, any), M (n, any)."""

    F: NDArray[np.float64]
    L: NDArray[np.float64]
    M: NDArray[np.float64]


def composed(first: Riccati, second: Riccati) -> tuple[Riccati, NDArray[np.float64]]:
    """`second` after `first`, and the root (n, any) of what `first` adds to the variance of `second`."""
    S = second.M.T @ first.L
    right = lower(np.eye(S.shape[1]), S.T)  # right right^T = I + S^T S
    left = lower(np.eye(S.shape[0]), S)
    carried = forward(right, first.L.T).T  # root of X (I + G X)^-1
    told = forward(left, second.M.T).T  # root of G (I + X G)^-1
    through = first.F - carried @ forward(right, S.T @ (second.M.T @ first.F))
    added = second.F @ carried
    return Riccati(second.F @ through, lower(added, second.L), lower(first.M, first.F.T @ told)), added


def fixed_point(step: Riccati, doublings: int = DOUBLINGS) -> tuple[NDArray[np.float64], int, bool]:
    """Root of the covariance that the map reaches from zero; doublings taken, and whether it settled.

    The root after k doublings is that after 2^k samples: a variance without bound shows itself by growing on.
    """
    for k in range(1, doublings + 1):
        with np.errstate(all="ignore"):  # what grows on without bound ends as inf
            step, added = composed(step, step)
        if not np.all(np.isfinite(step.L)):
            return step.L, k, False
        total = np.sum(step.L**2, axis=1)
        if np.all(np.sum(added**2, axis=1) <= SETTLED * total):
            return step.L, k, True
    return step.L, doublings, False


def joined_maps(first: Riccati, second: Riccati) -> Riccati:
    """`second` after `first`."""
    return composed(first, second)[0]


@dataclass(frozen=True, eq=False)
class FilterModel:
    """``x_{k+1} = F x_k + w_k``, ``y_k = H x_k + v_k``, load ``p_k = Cp x_k``; covariances are kept as roots.

    Parameters
    ----------
    F : array, shape (n, n)
    LQ : array, shape (n, q)
        ``E[w w^T] = LQ LQ^T``.
    H : array, shape (m, n)
    LR : array, shape (m, m)
        ``E[v v^T] = LR LR^T``, lower triangular.
    Cp : array, shape (p, n)
        Reads the loads off the state.
    x0 : array, shape (n,)
        Mean before the first sample.
    L0 : array, shape (n, r)
        Root of its covariance.
    nx : int
        States of the structure; the rest belongs to the priors of the loads.
    S : array, shape (n, m), optional
        ``E[w_k v_k^T]``.
    held : bool
        Loads change with a sample, not between two.

    Raises
    ------
    InputError
        Shapes that do not fit, NaN.
    """

    F: NDArray[np.float64]
    LQ: NDArray[np.float64]
    H: NDArray[np.float64]
    LR: NDArray[np.float64]
    Cp: NDArray[np.float64]
    x0: NDArray[np.float64]
    L0: NDArray[np.float64]
    nx: int
    S: NDArray[np.float64] | None = None
    held: bool = True

    def __post_init__(self) -> None:
        n, m = len(self.F), len(self.H)
        shapes = {
            "F": (n, n), "H": (m, n), "LR": (m, m), "x0": (n,), "LQ": (n, self.LQ.shape[-1]),
            "L0": (n, self.L0.shape[-1]), "Cp": (len(self.Cp), n), "S": (n, m),
        }  # fmt: skip
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is None:
                continue
            array = np.array(plain(value), float)  # float32 is raised: filters lose their sign in it
            if array.shape != shape or not np.all(np.isfinite(array)):
                raise InputError("the filter's matrices do not fit", where=f"FilterModel.{name}",
                                 found=f"shape {array.shape}, or NaN in it", expected=f"finite, {shape}")  # fmt: skip
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def n(self) -> int:
        """States."""
        return len(self.F)

    @property
    def m(self) -> int:
        """Sensors."""
        return len(self.H)

    @property
    def p(self) -> int:
        """Loads."""
        return len(self.Cp)


IMPOSSIBLE = 1e-7  # by which a correlation may exceed one, or leave the range of the process noise


@dataclass(frozen=True, eq=False)
class Present:
    """``x_{k+1} = F x_k + T y_k + w_k``, ``y_k = H x_k + v_k`` of the channels that are there, w and v uncorrelated.

    Parameters
    ----------
    mask : array of bool, shape (m,)
    F : array, shape (n, n)
    LQ : array, shape (n, q)
    H : array, shape (present, n)
    LR : array, shape (present, present)
    T : array, shape (n, present), or None
        What a sample tells of the process noise that moved it; None where the two are not correlated.
    """

    mask: NDArray[np.bool_]
    F: NDArray[np.float64]
    LQ: NDArray[np.float64]
    H: NDArray[np.float64]
    LR: NDArray[np.float64]
    T: NDArray[np.float64] | None

    def moved(self, x: NDArray, y: NDArray | None) -> NDArray[np.float64]:
        """Mean one sample later; y (m,) the data of this one."""
        ahead = self.F @ x
        return ahead if self.T is None or y is None else ahead + self.T @ y[self.mask]


def present(model: FilterModel, mask: NDArray[np.bool_]) -> Present:
    """The model for one set of channels.

    With ``S = E[w v^T]``: ``F - S R^-1 H``, ``Q - S R^-1 S^T`` and the known input ``S R^-1 y`` (Kailath, Sayed &
    Hassibi, Linear Estimation, 2000, ch. 9). The difference is taken inside the root: ``S = LQ C LR^T`` with C a matrix
    of correlations, and ``Q - S R^-1 S^T = LQ (I - C C^T) LQ^T``.

    Raises
    ------
    InputError
        S that no pair of noises has, or that belongs to a channel without noise.
    """
    H = np.ascontiguousarray(model.H[mask])
    LR = lower(model.LR[mask])
    if model.S is None or not mask.any():
        return Present(mask, model.F, model.LQ, H, LR, None)
    if not np.all(np.diag(LR)):
        raise InputError("a channel without noise cannot be correlated with the process noise", where="FilterModel.LR",
                         found="a singular root", expected="a positive definite covariance of the noise")  # fmt: skip
    white = forward(LR, model.S[:, mask].T)  # LR^-1 S^T
    size = np.linalg.norm(model.LQ, axis=1)
    size[size == 0] = 1.0
    C = np.linalg.lstsq(model.LQ / size[:, None], white.T / size[:, None], rcond=None)[0]
    U, s, _ = np.linalg.svd(C)
    miss = float(np.max(np.abs((model.LQ @ C - white.T) / size[:, None]), initial=0.0))
    if miss > IMPOSSIBLE or s.max(initial=0.0) > 1 + IMPOSSIBLE:
        raise InputError("S is the covariance of no pair of noises with these Q and R", where="FilterModel.S",
                         found=f"largest correlation {s.max(initial=0.0):.3g}, outside the range of Q by {miss:.1g}",
                         expected="correlations of at most 1, within the range of Q")  # fmt: skip
    left = np.ones(len(U))
    left[: len(s)] = np.sqrt(np.maximum((1 - s) * (1 + s), 0.0))
    T = backward(LR, white).T
    return Present(mask, model.F - T @ H, model.LQ @ (U * left), H, LR, np.ascontiguousarray(T))


def near_rest(model: FilterModel, rows: NDArray, std: float) -> FilterModel:
    """The same structure and sensors, with displacements that stay near zero.

    Parameters
    ----------
    model : FilterModel
    rows : array, shape (displacements, n)
        Displacements of the states.
    std : float
        Of each displacement at each sample, in the units of the rows: a thousand samples within it are a stronger
        belief than one.

    Raises
    ------
    InputError
        Correlated noises, no std, displacements that the loads do not settle.
    """
    std = positive("the std of a dummy displacement", std, where="dummy", unit="m")
    if model.S is not None:
        raise InputError("dummy displacements do not go with ambient loads", where="dummy", found="ambient given",
                         expected="one of them")  # fmt: skip
    cost, _, settled = fixed_point(Riccati(model.F.T, rows.T / std, model.LQ))
    if not settled:
        raise InputError("displacements near zero do not settle this load", where="dummy", found=f"std {std:.3g}",
                         expected="a model whose displacements are finite",
                         hint="a smaller std, or an OU prior")  # fmt: skip
    pull = cost.T @ model.LQ  # (any, noises)
    root = lower(np.eye(pull.shape[1]), pull.T)
    return replace(
        model,
        F=model.F - model.LQ @ backward(root, forward(root, pull.T @ (cost.T @ model.F))),
        LQ=forward(root, model.LQ.T).T,
        L0=forward(lower(np.eye(model.L0.shape[1]), (cost.T @ model.L0).T), model.L0.T).T,
    )


def words(std: float) -> str:
    """What is believed, for reports: a prior, and no data."""
    return f"displacements at the loads near zero within {std:.3g} m at every sample (a belief, not measured)"
