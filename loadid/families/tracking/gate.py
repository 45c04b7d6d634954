"""What lies beyond the gate of a filter: a load that its prior did not expect, or channels that are wrong.

Two hypotheses on the innovations e of one sample, each with its most likely size:

    an event      e ~ N(0, S + c^2 (H G)(H G)^T + rough),  once as rare as one wrong channel
    wrong ones    the rest ~ N(0, S), each wrong channel as large as it is and as rare as an event

G is the root of what a sample adds to the states, and of when within it the event began (`onset`); an event that shows
late, as far from the load, may have begun some samples ago (`recent`): a source of its own for each of them, as in the
generalised likelihood ratio of A. S. Willsky & H. L. Jones (IEEE Trans. Automatic Control 21 (1976) 108-112). Taken for
one that has just begun, it would have to be as many times larger as it shows less. `rough` is what a model that is a
tenth off leaves of an event of this size. One sample seldom decides (an event of one sample and a wrong
channel beside the load look alike): the odds only say which of two filters speaks until later samples have decided
(`loadid.families.tracking.engine`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...inverse.kalman.model import FilterModel
from ...inverse.kalman.roots import forward, lower
from ...inverse.kalman.steady import Steady

RARE = float(np.log(1000.0))  # a channel that is wrong, and an event: one sample of a thousand
ROUGH = 0.1  # of an event, that the model may get wrong
UNEVEN = float(1 / np.sqrt(12.0))  # of what a load does to a structure in a step: std of a start at any time within
SCALES = 80  # sizes of an event that are tried
HORIZON = 12  # doublings: samples after which a structure has forgotten its start, or a walk gone far enough
LOG2PI = float(np.log(2 * np.pi))


def weighed(e: NDArray, root: NDArray, ways: NDArray, wrong: NDArray) -> tuple[float, float]:
    """Logarithm of the odds that channels are wrong against an event, and the size c of that event.

    Parameters
    ----------
    e : array (m,)
        Innovations; NaN where a channel is missing or known to be wrong.
    root : array (m, any)
        Of their covariance.
    ways : array (m, any)
        What an event of size 1 does to them.
    wrong : array of bool (m,)
        Channels that are wrong if there is no event.
    """
    seen = np.isfinite(e)
    own, size = _event(e[seen], root[seen], ways[seen])
    return missed(e, wrong) + _normal(e, root, seen & ~wrong) - own, size


def missed(e: NDArray, wrong: NDArray) -> float:
    """Log density of channels that are wrong, each with the variance that makes it most likely."""
    there = np.abs(e[wrong & np.isfinite(e)])
    return float(-np.sum(np.log(np.maximum(there, np.finfo(float).tiny)) + 0.5 * (LOG2PI + 1) + RARE))


def onset(model: FilterModel) -> NDArray[np.float64]:
    """What an event of size 1 does to the states (n, any): as what a sample adds, with a load that sets in at any time.

    A load that is not held may step at any time between two samples: the structure has felt all of it or nothing, which
    no straight line or smooth process expects.
    """
    nx, LQ = model.nx, model.LQ
    if model.held:
        return LQ
    kick = UNEVEN * (model.F[:nx, nx:] @ LQ[nx:, np.any(LQ[nx:] != 0, axis=0)])
    return np.hstack([LQ, np.vstack([kick, np.zeros((len(LQ) - nx, kick.shape[1]))])])


def recent(settled: Steady, most: int) -> NDArray[np.float64]:
    """What events of size 1 do to a prediction (n, any), this sample's first, then those of samples before it.

    As many as it takes until an event shows most in the innovations, at most so many before.
    """
    model = settled.model
    closed = model.F @ (np.eye(model.n) - settled.K @ model.H)
    ways = [onset(model)]
    for _ in range(most):
        ways.append(closed @ ways[-1])
    shown = [float(np.linalg.norm(forward(settled.Se_root, model.H @ way))) for way in ways]
    return np.hstack(ways[: 1 + int(np.argmax(shown))])


def usual(model: FilterModel) -> float:
    """Size of an event after which the loads are as large as they are in the long run, by their prior."""
    F, Cp, new = model.F[model.nx :, model.nx :], model.Cp[:, model.nx :], model.LQ[model.nx :]
    L, size = new, np.linalg.norm(Cp @ new, axis=1)
    for _ in range(HORIZON):
        size = np.maximum(size, np.linalg.norm(Cp @ F @ new, axis=1))
        F, L = F @ F, lower(L, F @ L)
    there = size > 0
    return float(np.max(np.linalg.norm(Cp @ L, axis=1)[there] / size[there], initial=1.0))


def reach(model: FilterModel) -> NDArray[np.float64]:
    """Root of the covariance of the states of a structure that has been under its loads for long."""
    F, L = model.F, model.LQ
    for _ in range(HORIZON):
        F, L = F @ F, lower(L, F @ L)
    return L


def _event(e: NDArray, root: NDArray, ways: NDArray) -> tuple[float, float]:
    """Log density of innovations under an event of the most likely size, and that size."""
    S = lower(root)
    white, toward = forward(S, e), forward(S, ways)
    U, s, _ = np.linalg.svd(toward)
    s2 = np.zeros(len(e))
    s2[: len(s)] = s**2
    z2 = (U.T @ white) ** 2
    levels = np.array([1.0, 1 + ROUGH**2 * float(np.mean(z2))])  # a model that is right, and one that is rough
    largest = float(s2.max(initial=0.0))
    c2 = np.zeros(1)
    if largest > 0:
        strong = s2 > 1e-12 * largest
        c2 = np.geomspace(1.0, max(float(np.max(z2[strong] / s2[strong])), 2.0), SCALES)
    var = levels[:, None, None] + c2[:, None] * s2
    found = -0.5 * np.sum(np.log(var) + z2 / var + LOG2PI, axis=2) - _half_det(S) - RARE
    best = int(np.argmax(found))
    return float(found.flat[best]), float(np.sqrt(c2[best % len(c2)]))


def _normal(e: NDArray, root: NDArray, of: NDArray) -> float:
    """Log density of some of the innovations."""
    if not of.any():
        return 0.0
    S = lower(root[of])
    white = forward(S, e[of])
    return -0.5 * float(white @ white + len(white) * LOG2PI) - _half_det(S)


def _half_det(S: NDArray) -> float:
    return float(np.sum(np.log(np.abs(np.diag(S)))))
