"""Cost of one frame of a slowly moving sequence under constraints, beside what a user would take instead.

Run as ``python -m tests.benchmarks.constrained``. CPU seconds of the process, one thread; medians over the frames.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from loadid._inverse.constrained.path import ConstrainedPath
from loadid._inverse.constrained.solver import ConstrainedSolver
from loadid.constraints import FrictionCone, NonNegative, Resultant
from loadid.paths import LinearProblem, SVDPath

FRAMES = 30


def line(n: int, frames: int, noise: float = 0.01) -> tuple[NDArray, NDArray]:
    """Compliant surface (Lorentzian kernel) with n nodes and two bumps that creep to the right; H and data by frame."""
    x, t = (np.arange(n) + 0.5) / n, 0.05
    H = t / np.pi / (t**2 + (x[:, None] - x) ** 2) / n
    rng = np.random.default_rng(0)
    shift = 0.0005 * np.arange(frames)[:, None]
    g = np.maximum(0, 1 - ((x - 0.3 - shift) / 0.12) ** 2) + 0.6 * np.maximum(0, 1 - ((x - 0.7 - shift) / 0.08) ** 2)
    y = g @ H.T
    return H, y + noise * np.sqrt(np.mean(y**2)) * rng.standard_normal(y.shape)


def patch(contacts: int, frames: int, noise: float = 0.01, mu: float = 0.5) -> tuple[NDArray, NDArray]:
    """A patch of contact nodes on an elastic body (Kelvin's solution), markers inside; a sliding punch that creeps."""
    rows = contacts // 20
    u, v = np.meshgrid((np.arange(20) + 0.5) / 20, (np.arange(rows) + 0.5) / rows, indexing="ij")
    P = np.column_stack([u.ravel(), v.ravel(), np.zeros(u.size)])
    rng = np.random.default_rng(0)
    M = np.column_stack([rng.random((contacts, 2)), np.full(contacts, -0.15)])
    d = M[:, None] - P[None]
    r = np.linalg.norm(d, axis=-1)[..., None, None]
    K = 1.1 * np.eye(3) / r + d[..., :, None] * d[..., None, :] / r**3
    H = K.transpose(0, 2, 1, 3).reshape(3 * contacts, -1) / 25
    out = []
    for k in range(frames):
        q = 1 - ((P[:, 0] - 0.45 - 0.002 * k) / 0.25) ** 2 - ((P[:, 1] - 0.5) / 0.35) ** 2
        p = np.sqrt(np.maximum(q, 0))
        t, angle = np.minimum(mu * p, 0.25 * (p > 0)), 0.3 + 0.5 * P[:, 1] + 0.004 * k
        out.append(H @ np.column_stack([t * np.cos(angle), t * np.sin(angle), p]).ravel())
    y = np.array(out)
    return H, y + noise * np.sqrt(np.mean(y**2)) * rng.standard_normal(y.shape)


def rule(H: NDArray, y: NDArray, sigma: float, constraints: list) -> float:
    """Relative lambda at which the residual of the constrained solution is that of the noise, to 10 %."""
    path = ConstrainedPath(SVDPath(LinearProblem.whitened(H, y)), constraints)
    lam = np.geomspace(1.0, 1e-4, 41)
    return float(next((x for x in lam if path.solve(x).residual2 < sigma**2 * len(y)), lam[-1]))


def timed(run: Callable[[], object]) -> tuple[float, object]:
    """CPU milliseconds and result."""
    start = time.process_time()
    found = run()
    return 1e3 * (time.process_time() - start), found


def sequence(prepared: ConstrainedSolver, y: NDArray) -> tuple[list[float], list[float], list]:
    """Cold and warm milliseconds of each frame, and the warm solutions."""
    cold, warm, found = [], [], []
    last = prepared.solve(y[0])
    for each in y:
        cold.append(timed(lambda each=each: prepared.solve(each))[0])
        ms, last = timed(lambda each=each, last=last: prepared.solve(each, warm=last))
        warm.append(ms)
        found.append(last)
    return cold, warm, found


def by_clarabel(prepared: ConstrainedSolver, y: NDArray) -> NDArray:
    """The same problem by clarabel at its tightest."""
    from loadid._inverse.constrained.activeset import interior_point

    inner = interior_point(prepared.quadratic, prepared.compress(y)[0], prepared.feasible)
    return np.zeros(0) if inner is None else prepared.feasible.to_global(inner.h)


def by_daqp(prepared: ConstrainedSolver) -> Callable[[NDArray], NDArray]:
    """The same bounds by casadi's daqp."""
    import casadi

    n, G = prepared.quadratic.n, prepared.quadratic.G
    solver = casadi.conic("s", "daqp", {"h": casadi.Sparsity.dense(n, n), "a": casadi.Sparsity(0, n)})

    def solve(y: NDArray) -> NDArray:
        b = prepared.compress(y)[0]
        found = solver(h=casadi.DM(G), g=casadi.DM(-(b @ prepared.quadratic.A)), lbx=np.zeros(n), ubx=np.full(n, 1e20))
        return np.asarray(found["x"]).ravel()

    return solve


def rows(name: str, found: list, cold: list[float], warm: list[float]) -> Iterator[str]:
    """Table rows of our own solver."""
    for label, ms in ((f"{name}, cold", cold), (f"{name}, warm", warm)):
        yield f"{label:<46}{np.median(ms):>10.2f}{np.max(ms):>10.2f}"
    yield (
        f"    violation {max(s.violation for s in found):.1e}, relative gap {max(s.gap for s in found):.1e}, "
        f"steps {np.median([s.iterations for s in found]):.0f}, {found[-1].solver}"
    )


def other(name: str, solve: Callable[[NDArray], NDArray], y: NDArray, ours: list) -> str:
    """Table row of another solver, with its distance to ours."""
    ms, apart = [], []
    for each, own in zip(y, ours[: len(y)], strict=True):
        t, load = timed(lambda each=each: solve(each))
        ms.append(t)
        apart.append(np.linalg.norm(load - own.load) / np.linalg.norm(own.load))
    return f"{name:<46}{np.median(ms):>10.2f}{np.max(ms):>10.2f}   apart {max(apart):.1e}"


def main() -> None:
    """Print the tables."""
    from scipy.optimize import nnls

    few = 3
    print(f"{'milliseconds of CPU a frame':<46}{'median':>10}{'most':>10}")
    n = 500
    for noise in (1e-2, 1e-3):
        H, y = line(n, FRAMES, noise)
        sigma = noise * float(np.sqrt(np.mean(y[0] ** 2)))
        for lam in (rule(H, y[0], sigma, [NonNegative()]), 3e-2):
            prepared = ConstrainedPath(SVDPath(LinearProblem.whitened(H, y[0])), [NonNegative()]).prepare(lam)
            cold, warm, found = sequence(prepared, y)
            positive = np.sum(found[-1].load > 0)
            print(
                f"\n{n} non-negative, new noise of {noise:.1%} a frame, relative lambda {lam:.2g}, {positive} positive"
            )
            print("\n".join(rows("active set", found, cold, warm)))
            S = np.vstack([H, prepared.lam * np.eye(n)])
            by_nnls = other(
                "scipy nnls on [H; lam L]", lambda v, S=S: nnls(S, np.r_[v, np.zeros(n)])[0], y[:few], found
            )
            print(by_nnls)
            print(other("clarabel", lambda v, p=prepared: by_clarabel(p, v), y[:few], found))
            print(other("casadi daqp", by_daqp(prepared), y[:few], found))

    H, y = patch(200, FRAMES)
    contacts = np.arange(600).reshape(-1, 3)
    total = np.kron(np.ones((1, 200)), np.eye(3))
    sigma = 0.01 * float(np.sqrt(np.mean(y[0] ** 2)))
    for lam in (rule(H, y[0], sigma, [FrictionCone(0.5, contacts)]), 1e-1, 1e-3):
        path = SVDPath(LinearProblem.whitened(H, y[0]))
        prepared = ConstrainedPath(path, [FrictionCone(0.5, contacts)]).prepare(lam)
        cold, warm, found = sequence(prepared, y)
        counts = np.bincount(found[-1].active[0], minlength=3)
        print(f"\n200 friction cones, relative lambda {lam:g}; open, sliding, sticking: {counts.tolist()}")
        print("\n".join(rows("active set", found, cold, warm)))
        print(other("clarabel", lambda v, p=prepared: by_clarabel(p, v), y[:few], found[:few]))
        exact = [FrictionCone(0.5, contacts), Resultant(total, total @ found[0].load)]
        both = ConstrainedPath(path, exact).prepare(lam)
        print("\n".join(rows("active set, exact resultant too", *reversed(_order(sequence(both, y))))))
        pyramid = ConstrainedPath(path, [FrictionCone(0.5, contacts, facets=8)]).prepare(lam)
        print("\n".join(rows("pyramids of 8 facets", *reversed(_order(sequence(pyramid, y[:few]))))))


def _order(found: tuple[list, list, list]) -> tuple[list, list, list]:
    cold, warm, solutions = found
    return warm, cold, solutions


if __name__ == "__main__":
    main()
