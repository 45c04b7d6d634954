"""Digits at small lambda, beside the routes of a user. `python -m tests.benchmarks.accuracy [DRAWS [SAMPLES]]`.

Operators of 150 x 120 with condition number 1e10 and noisy data, L = first difference: largest relative error of the
solution over the draws, against a Householder QR in extended precision. The normal equations and the eigenvalues of
their pencils square the condition number; Elden's standard form solves with the penalty first.

Then records over a state space, whose operator has a condition number beyond 1e18, at four relative lambdas.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from loadid._inverse import penalties
from loadid.paths import LinearProblem, SVDPath
from tests.inverse.reference import attainable, rounding

LAMBDAS = (1e-2, 1e-5, 1e-8)  # absolute
KAPPA, SHAPE = 1e10, (150, 120)
RELATIVE = (1e-2, 1e-4, 1e-6, 1e-8)  # of records over a state space
SQUARE_ROOT = (2e-14, 6e-13, 1e-11, 1e-8)  # what the square-root recursion is known to reach there, L = I, 600 samples
BOUND, SQUARED = "bound", "condition squared"
Route = Callable[[NDArray, NDArray, NDArray, float], NDArray]


def extended(H: NDArray, y: NDArray, L: NDArray, lam: float) -> NDArray[np.longdouble]:
    """Reference: QR of [H; lam L] by Householder reflections in extended precision."""
    A = np.vstack([H.astype(np.longdouble), np.longdouble(lam) * L.astype(np.longdouble)])
    b = np.concatenate([y.astype(np.longdouble), np.zeros(len(L), np.longdouble)])
    n = A.shape[1]
    for k in range(n):
        v = A[k:, k].copy()
        v[0] += np.copysign(np.sqrt(np.sum(v * v)), v[0])
        v /= np.sqrt(np.sum(v * v))
        A[k:, k:] -= 2 * np.outer(v, v @ A[k:, k:])
        b[k:] -= 2 * v * (v @ b[k:])
    g = np.zeros(n, np.longdouble)
    for k in range(n - 1, -1, -1):
        g[k] = (b[k] - A[k, k + 1 :] @ g[k + 1 :]) / A[k, k]
    return g


def bounds(H: NDArray, y: NDArray, L: NDArray, lam: float, exact: NDArray) -> tuple[float, float]:
    """Relative error that a backward stable method may make, and the one that normal equations may."""
    A = np.vstack([H, lam * L])
    stable = attainable(A, np.concatenate([y, np.zeros(len(L))]), exact.astype(float))
    return stable, rounding(A.shape[1]) * float(np.linalg.cond(A)) ** 2


def ours(H: NDArray, y: NDArray, L: NDArray, lam: float) -> NDArray:
    """`SVDPath.solution`."""
    path = SVDPath(LinearProblem.whitened(H, y, L=L))
    return path.solution(lam / float(path.scale), None).load


def modes(H: NDArray, y: NDArray, L: NDArray, lam: float) -> NDArray:
    """The modes of `SVDPath` alone, as `inverse` has them."""
    path = SVDPath(LinearProblem.whitened(H, y, L=L))
    return path.inverse(lam / float(path.scale)) @ y


def stacked(H: NDArray, y: NDArray, L: NDArray, lam: float) -> NDArray:
    """Least squares of [H; lam L]."""
    return np.linalg.lstsq(np.vstack([H, lam * L]), np.concatenate([y, np.zeros(len(L))]))[0]


def elden(H: NDArray, y: NDArray, L: NDArray, lam: float) -> NDArray:
    """Standard form by QR of L^T and of H on its null space (Elden, BIT 17 (1977) 134), then an SVD."""
    p, n = L.shape
    K, R = np.linalg.qr(L.T, mode="complete")
    T, Kp, Ko = R[:p], K[:, :p], K[:, p:]
    Q, S = np.linalg.qr(H @ Ko, mode="complete")
    q = n - p
    Lplus = scipy.linalg.solve_triangular(T, Kp.T).T  # Kp T^-T
    U, s, Vt = np.linalg.svd(Q[:, q:].T @ H @ Lplus, full_matrices=False)
    z = Vt.T @ (s / (s**2 + lam**2) * (U.T @ (Q[:, q:].T @ y)))
    g = Lplus @ z
    return g + Ko @ scipy.linalg.solve_triangular(S[:q], Q[:, :q].T @ (y - H @ g))


def normal(H: NDArray, y: NDArray, L: NDArray, lam: float) -> NDArray:
    """Normal equations by Gaussian elimination (Cholesky breaks down)."""
    return np.linalg.solve(H.T @ H + lam**2 * (L.T @ L), H.T @ y)


def pencil(H: NDArray, y: NDArray, L: NDArray, lam: float) -> NDArray:
    """Eigenvalues of the pencil (H^T H, H^T H + L^T L)."""
    mu, Z = scipy.linalg.eigh(H.T @ H, H.T @ H + L.T @ L)
    mu = np.clip(mu, 0, 1)
    d = mu + lam**2 * (1 - mu)
    return Z @ ((Z.T @ (H.T @ y)) / d)


ROUTES: dict[str, Route] = {
    "loadid, solution": ours,
    "loadid, modes (QR + SVD)": modes,
    "augmented least squares": stacked,
    "Elden standard form + SVD": elden,
    "normal equations": normal,
    "eigenpencil": pencil,
}


def case(seed: int) -> tuple[NDArray, NDArray, NDArray]:
    """Operator with singular values in geometric progression, noisy data, first difference."""
    rng = np.random.default_rng(seed)
    m, n = SHAPE
    U, V = (np.linalg.qr(rng.standard_normal((k, k)))[0][:, :n] for k in (m, n))
    H = (U * np.geomspace(1, 1 / KAPPA, n)) @ V.T
    y = H @ np.sin(np.arange(n) / 9) + 1e-3 * rng.standard_normal(m)
    return H, y, np.asarray(penalties.matrix("first_difference", n))


def errors(routes: dict[str, Route], seeds: int) -> dict[str, NDArray[np.float64]]:
    """Largest relative error of each route at each lambda over the draws, and the `BOUND` of `bounds`."""
    worst = {name: np.zeros(len(LAMBDAS)) for name in (*routes, BOUND)}
    for seed in range(seeds):
        H, y, L = case(seed)
        for k, lam in enumerate(LAMBDAS):
            exact = extended(H, y, L, lam)
            for name, route in routes.items():
                error = float(np.linalg.norm(route(H, y, L, lam) - exact) / np.linalg.norm(exact))
                worst[name][k] = max(worst[name][k], error)
            worst[BOUND][k] = max(worst[BOUND][k], bounds(H, y, L, lam, exact)[0])
    return worst


def long_errors(samples: int) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Relative errors of a record over a state space, for each penalty, route and relative lambda of `RELATIVE`.

    With both figures of `bounds`, `BOUND` and `SQUARED`.

    Displacement of the half-sine benchmark in advance form (the data of the next sample beside the load of this one).
    """
    from loadid._inverse.gaussian.path import StateSpacePath
    from loadid._inverse.gaussian.record import augment, record
    from tests import halfsine

    s = halfsine.system("zoh")
    C, D = s.C @ s.A, s.C @ s.B
    h = np.concatenate([D[None], s.impulse_response(s.dt, samples + 1)[2:]])[:, 0, 0]
    H = scipy.linalg.toeplitz(h, np.zeros(samples))
    clean = H @ halfsine.pulses(41, samples + 150)[150:]
    y = clean + halfsine.level(clean, 0.01) * np.random.default_rng(0).standard_normal(samples)
    found: dict[str, dict[str, NDArray[np.float64]]] = {}
    for penalty in ("identity", "first_difference", "second_difference"):
        L = penalties.matrix(penalty, samples)
        L = np.eye(samples) if L is None else L
        path = StateSpacePath(record(augment(s.A, s.B, C, D, penalty), y[:, None]))
        names = ("state space", "augmented QR", "normal equations", BOUND, SQUARED)
        found[penalty] = {name: np.zeros(len(RELATIVE)) for name in names}
        for k, relative in enumerate(RELATIVE):
            lam = relative * float(path.scale)
            exact = extended(H, y, L, lam)
            routes = {
                "state space": path.solution(relative, None).load[:, 0],
                "augmented QR": stacked(H, y, L, lam),
                "normal equations": normal(H, y, L, lam),
            }
            for name, load in routes.items():
                found[penalty][name][k] = float(np.linalg.norm(load - exact) / np.linalg.norm(exact))
            found[penalty][BOUND][k], found[penalty][SQUARED][k] = bounds(H, y, L, lam, exact)
    return found


def main() -> None:
    """Print the tables."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    print(f"relative error, largest of {seeds} draws, {SHAPE[0]} x {SHAPE[1]}, condition {KAPPA:g}, first difference")
    print(f"{'lambda':28}" + "".join(f"{lam:>10.0e}" for lam in LAMBDAS))
    for name, row in errors(ROUTES, seeds).items():
        print(f"{name:28}" + "".join(f"{x:>10.1e}" for x in row))
    samples = int(sys.argv[2]) if len(sys.argv) > 2 else 600
    print(f"\nrelative error over a state space, displacement in advance form, {samples} samples")
    print(f"{'relative lambda':28}" + "".join(f"{lam:>10.0e}" for lam in RELATIVE))
    print(f"{'square-root recursion, L = I':28}" + "".join(f"{x:>10.0e}" for x in SQUARE_ROOT) + "   (to reach)")
    for penalty, routes in long_errors(samples).items():
        for name, row in routes.items():
            print(f"{penalty[:8] + ', ' + name:28}" + "".join(f"{x:>10.1e}" for x in row))


if __name__ == "__main__":
    main()
