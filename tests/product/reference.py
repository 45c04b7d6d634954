"""Dense references of every problem of the product, from its definition; nothing here comes from the solvers.

`Problem` is the stacked system ``[H; lam L] g = [y; 0]`` in whitened data, written out from impulse responses, a static
matrix or frequency responses that the model gives.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CLOSE = 1e-8  # relative: every answer, where the problem itself does not magnify rounding more than that
LOST = 1e-12  # relative response below which the data do not see a load
MEANT = 1e-5  # relative error by rounding from which a cell would show nothing


@dataclass(frozen=True)
class Problem:
    """Whitened operator (data, unknowns), data, penalty, and unknowns beyond the loads that nothing penalises."""

    H: Array
    y: Array
    L: Array
    spare: int = 0

    def stacked(self, lam: float) -> tuple[Array, Array]:
        """Operator and right side of the least-squares problem at an absolute lambda."""
        free = np.zeros((len(self.L), self.spare))
        return np.vstack([self.H, lam * np.hstack([self.L, free])]), np.r_[self.y, np.zeros(len(self.L))]

    def solution(self, lam: float) -> Array:
        """Loads (flat) at an absolute lambda."""
        A, b = self.stacked(lam)
        x = solved(A, b)
        return x[: len(x) - self.spare]

    def undetermined(self, free: bool) -> bool:
        """Whether the data leave open what the penalty does not hold; `free`: there is no penalty."""
        null = np.eye(self.H.shape[1]) if free else null_space(np.hstack([self.L, np.zeros((len(self.L), self.spare))]))
        seen = self.H @ null
        s = np.linalg.svd(seen / np.linalg.norm(seen, axis=0), compute_uv=False)
        return bool(len(s) < null.shape[1] or s[-1] <= LOST * s[0])

    def truncated(self, cut: float) -> Array:
        """Loads that keep what has a generalised singular value above `cut`, by the standard form of Elden.

        L. Elden, BIT 22 (1982) 487; Hansen, SIAM 1998, section 2.3: what L leaves free is fitted first.
        """
        free, weight = null_space(self.L), np.linalg.pinv(self.L, rcond=1e-12)
        if not len(self.L):
            return self.solution(0.0)
        seen = np.linalg.qr(self.H @ free)[0]
        H = self.H @ weight
        U, c, Vt = np.linalg.svd(H - seen @ (seen.T @ H), full_matrices=False)
        keep = c > cut
        x = weight @ (Vt[keep].T @ (U[:, keep].T @ self.y / c[keep]))
        return x + free @ np.linalg.lstsq(self.H @ free, self.y - self.H @ x, rcond=None)[0]


def null_space(L: Array) -> Array:
    """Orthonormal columns that L makes zero."""
    if not len(L):
        return np.eye(L.shape[1])
    _, s, vt = np.linalg.svd(L)
    return vt[int(np.sum(s > 1e-12 * s[0])) :].T


def solved(A: Array, b: Array) -> Array:
    """Least squares with one step of refinement, residuals in extended precision."""
    x = np.linalg.lstsq(A, b, rcond=None)[0]
    wide = np.longdouble
    rest = np.asarray(b.astype(wide) - A.astype(wide) @ x.astype(wide), float)
    return x + np.linalg.lstsq(A, rest, rcond=None)[0]


def attainable(A: Array, b: Array, x: Array) -> float:
    """Relative error in x that rounding of A and b alone may make: Wedin's bound (Bjorck, SIAM 1996, eq. 1.4.16)."""
    s = np.linalg.svd(A, compute_uv=False)
    kappa, size = s[0] / s[-1], s[0] * np.linalg.norm(x)
    u = np.finfo(float).eps * np.sqrt(len(x))
    return float(u * kappa * (1 + np.linalg.norm(b) / size + kappa * np.linalg.norm(b - A @ x) / size))


def convolution(h: Array) -> Array:
    """Operator (samples, sensors, samples * loads) of impulse responses (samples, sensors, loads), loads time first."""
    N, m, p = h.shape
    T = np.zeros((N, m, N, p))
    for k in range(N):
        for j in range(k + 1):
            T[k, :, j] = h[k - j]
    return T.reshape(N, m, N * p)


def wrapped(h: Array) -> Array:
    """The same with time that runs in a circle."""
    N, m, p = h.shape
    T = np.zeros((N, m, N, p))
    for k in range(N):
        for j in range(N):
            T[k, :, j] = h[(k - j) % N]
    return T.reshape(N, m, N * p)


def differences(order: int, samples: int, loads: int = 1, *, ends: str = "free", leak: float = 1.0) -> Array:
    """Difference penalty over histories, row by row from binomial coefficients.

    `ends`: ``free`` has full rows only, ``zero`` counts a load that is zero before the first sample, ``round`` lets
    time run in a circle.
    """
    row = np.array([1.0])
    for _ in range(order):
        row = np.convolve(row, [1.0, -leak])  # newest first
    rows = []
    for k in range(order if ends == "free" else 0, samples):
        line = np.zeros(samples)
        for j, value in enumerate(row):
            if k - j >= 0 or ends == "round":
                line[(k - j) % samples] += value
        rows.append(np.kron(line, np.eye(loads)))
    return np.concatenate(rows) if rows else np.zeros((0, samples * loads))


def whitened(T: Array, y: Array, noise: Array) -> tuple[Array, Array]:
    """Rows of T (samples, sensors, unknowns) and data (samples, sensors) that are there, in units of their noise."""
    R = np.diag(np.square(noise)) if noise.ndim == 1 else noise
    rows, data = [], []
    for row, value in zip(T, y, strict=True):
        there = ~np.isnan(value)
        if there.any():
            root = np.linalg.cholesky(R[np.ix_(there, there)])
            rows.append(np.linalg.solve(root, row[there]))
            data.append(np.linalg.solve(root, value[there]))
    return np.vstack(rows), np.hstack(data)


def with_start(problem: Problem, free: Array, y: Array, noise: Array) -> Problem:
    """The problem with an unknown start, whose response is `free` (samples, sensors, states)."""
    columns = whitened(free, y, noise)[0]
    return replace(problem, H=np.hstack([problem.H, columns]), spare=columns.shape[1])


def assert_agrees(found: Array, problem: Problem, lam: float) -> None:
    """The loads found are those of the problem at an absolute lambda."""
    expected = problem.solution(lam)
    A, b = problem.stacked(lam)
    full = solved(A, b)
    bound = max(CLOSE, attainable(A, b, full) * np.linalg.norm(full) / np.linalg.norm(expected))
    assert bound < MEANT, f"the cell shows nothing: rounding alone makes {bound:.2g}"
    error = np.linalg.norm(found.reshape(-1) - expected) / np.linalg.norm(expected)
    assert error <= bound, f"off the dense reference by {error:.2g} (bound {bound:.2g})"


def assert_minimal(found: Array, problem: Problem, lam: float, pushing: Array, slack: float = CLOSE) -> None:
    """The loads found are the minimum with ``g >= 0`` where `pushing` (flat mask): Karush, Kuhn, Tucker.

    Loads that are held at zero are columns taken out; what is left is least squares, and the gradient of a held load
    must not pull. A strictly convex problem has one such point.
    """
    g = found.reshape(-1)
    held = pushing & (g == 0)
    assert np.all(g[pushing] >= 0), "a load pulls"
    A, b = problem.stacked(lam)
    keep = np.r_[~held, np.ones(problem.spare, bool)]
    x = np.zeros(A.shape[1])
    x[keep] = solved(A[:, keep], b)
    bound = max(slack, attainable(A[:, keep], b, x[keep]))
    error = np.linalg.norm(g - x[: len(g)]) / np.linalg.norm(x[: len(g)])
    assert error <= bound, f"off the dense reference on its own active set by {error:.2g} (bound {bound:.2g})"
    pull = (A.T @ (b - A @ x))[: len(g)][held]
    scale = np.linalg.norm(A, axis=0).max() * np.linalg.norm(b)
    assert np.all(pull <= slack * scale), f"a held load would push: gradient {pull.max() / scale:.2g} of its scale"


def assert_constrained(
    found: Array, problem: Problem, lam: float, C: Array, value: Array, bounds: tuple[Array, Array]
) -> None:
    """The loads found are the minimum with ``C g = value`` and ``lower <= g <= upper``: Karush, Kuhn, Tucker.

    On the loads that no bound holds it is least squares on the null space of C; multipliers of bounds must not pull.
    """
    g, (lower, upper) = found.reshape(-1), bounds
    size = np.abs(g).max()
    assert np.all(g >= lower - CLOSE * size)
    assert np.all(g <= upper + CLOSE * size)
    low, high = g <= lower + CLOSE * size, g >= upper - CLOSE * size
    free = ~(low | high)
    A, b = problem.stacked(lam)
    x = np.where(low, lower, np.where(high, upper, 0.0))
    part = np.linalg.lstsq(C[:, free], value - C @ x, rcond=None)[0]
    Z = null_space(C[:, free]) if len(C) else np.eye(int(free.sum()))
    rest = b - A @ x - A[:, free] @ part
    x[free] = part + Z @ solved(A[:, free] @ Z, rest)
    assert np.linalg.norm(g - x) <= CLOSE * np.linalg.norm(x), f"off by {np.linalg.norm(g - x) / np.linalg.norm(x):.2g}"
    slope = A.T @ (A @ x - b)
    pull = slope - C.T @ np.linalg.lstsq(C[:, free].T, slope[free], rcond=None)[0]
    slack = CLOSE * np.linalg.norm(A, axis=0).max() * np.linalg.norm(b)
    assert np.all(pull[low & ~high] >= -slack)
    assert np.all(pull[high & ~low] <= slack)
