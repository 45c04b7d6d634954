"""What lies beyond the gate of a filter, a load or wrong channels; and the same filter without a gate as its judge.

Two hypotheses on the innovations e of one sample, each with its most likely size:

    an event      e ~ N(0, S + c^2 (H G)(H G)^T + rough),  once as rare as one wrong channel
    wrong ones    the rest ~ N(0, S), each wrong channel as large as it is and as rare as an event

G is the root of what a sample adds to the states, and of when within it the event began (`onset`); an event that shows
late, as far from the load, may have begun some samples ago (`recent`): a source of its own for each of them, as in the
generalised likelihood ratio of A. S. Willsky & H. L. Jones (IEEE Trans. Automatic Control 21 (1976) 108-112). Taken for
one that has just begun, it would have to be as many times larger as it shows less. `rough` is what a model that is a
tenth off leaves of an event of this size. One sample seldom decides (an event of one sample and a wrong
channel beside the load look alike): the odds only say which of two filters speaks until later samples have decided
(`loadid._families.tracking.engine`).

A gate that takes up an event or keeps a channel out supposes more than the filter without one, and where it supposes
the wrong thing each mistake asks for the next: a sensor with an offset is explained by a load, the load by another one.
So it has to be right by the data. It is set aside, and the filter without a gate goes on in its place, where that one
has come to predict the samples better, or where events and wrong channels contradict each other within a few samples;
and where nothing was kept out, also as soon as it predicts them as well. What is still beyond the gate then is
believed, until the samples have been calm for a while, twice as long each time the gate has failed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._inverse.gaussian.model import FilterModel, FilterState, Innovation
from ..._inverse.gaussian.roots import Array, lower, solve_lower
from ..._inverse.gaussian.steady import SteadyFilter

RARE = float(np.log(1000.0))  # a channel that is wrong, and an event: one sample of a thousand
ROUGH = 0.1  # of an event, that the model may get wrong
UNEVEN = float(1 / np.sqrt(12.0))  # of what a load does to a structure in a step: std of a start at any time within
SCALES = 80  # sizes of an event that are tried
HORIZON = 12  # doublings: samples after which a structure has forgotten its start, or a walk gone far enough
LOG2PI = float(np.log(2 * np.pi))


def weighed(e: Array, root: Array, ways: Array, wrong: NDArray[np.bool_]) -> tuple[float, float]:
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


def missed(e: Array, wrong: NDArray[np.bool_]) -> float:
    """Log density of channels that are wrong, each with the variance that makes it most likely."""
    there = np.abs(e[wrong & np.isfinite(e)])
    return float(-np.sum(np.log(np.maximum(there, np.finfo(float).tiny)) + 0.5 * (LOG2PI + 1) + RARE))


def onset(model: FilterModel) -> Array:
    """What an event of size 1 does to the states (n, any): as what a sample adds, with a load that sets in at any time.

    A load that is not held may step at any time between two samples: the structure has felt all of it or nothing, which
    no straight line or smooth process expects.
    """
    nx, LQ = model.nx, model.LQ
    if model.held:
        return LQ
    kick = UNEVEN * (model.F[:nx, nx:] @ LQ[nx:, np.any(LQ[nx:] != 0, axis=0)])
    return np.hstack([LQ, np.vstack([kick, np.zeros((len(LQ) - nx, kick.shape[1]))])])


def recent(settled: SteadyFilter, most: int) -> Array:
    """What events of size 1 do to a prediction (n, any), this sample's first, then those of samples before it.

    As many as it takes until an event shows most in the innovations, at most so many before.
    """
    model = settled.model
    closed = model.F @ (np.eye(model.n) - settled.K @ model.H)
    ways = [onset(model)]
    for _ in range(most):
        ways.append(closed @ ways[-1])
    white = solve_lower(settled.Se_root, model.H @ np.hstack(ways)).reshape(model.m, len(ways), -1)
    return np.hstack(ways[: 1 + int(np.argmax(np.linalg.norm(white, axis=(0, 2))))])


def usual(model: FilterModel) -> float:
    """Size of an event after which the loads are as large as they are in the long run, by their prior."""
    F, Cp, new = model.F[model.nx :, model.nx :], model.Cp[:, model.nx :], model.LQ[model.nx :]
    L, size = new, np.linalg.norm(Cp @ new, axis=1)
    for _ in range(HORIZON):
        size = np.maximum(size, np.linalg.norm(Cp @ F @ new, axis=1))
        F, L = F @ F, lower(L, F @ L)
    there = size > 0
    return float(np.max(np.linalg.norm(Cp @ L, axis=1)[there] / size[there], initial=1.0))


def reach(model: FilterModel) -> Array:
    """Root of the covariance of the states of a structure that has been under its loads for long."""
    F, L = model.F, model.LQ
    for _ in range(HORIZON):
        F, L = F @ F, lower(L, F @ L)
    return L


def _event(e: Array, root: Array, ways: Array) -> tuple[float, float]:
    """Log density of innovations under an event of the most likely size, and that size."""
    S = lower(root)
    white, toward = solve_lower(S, e), solve_lower(S, ways)
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


def _normal(e: Array, root: Array, of: NDArray[np.bool_]) -> float:
    """Log density of some of the innovations."""
    if not of.any():
        return 0.0
    S = lower(root[of])
    white = solve_lower(S, e[of])
    return -0.5 * float(white @ white + len(white) * LOG2PI) - _half_det(S)


def _half_det(S: Array) -> float:
    return float(np.sum(np.log(np.abs(np.diag(S)))))


CALM = 20  # samples within the gate, after which the filter without one has found back; within which stories conflict
OVER = 10 * CALM  # samples without a new story, after which the gate was right
DOUBLINGS = 20  # at most, of the calm that a gate waits for which failed


@dataclass(frozen=True, eq=False)
class Plain:
    """A filter that believes every number, and how it compares with the one that has a gate.

    Parameters
    ----------
    state : FilterState
        After the last sample.
    innovation : Innovation or None
        Of the last sample; None from a file.
    behind : float
        By how much the filter with the gate has predicted worse since it last was the better one: squares of
        normalised innovations, each at most the square of the gate.
    calm : int
        Samples in a row of which every channel was within the gate of this filter.
    whole : bool
        Nothing was kept out of the other filter.
    event : bool or None
        What the gate decided last, an event or a wrong channel.
    age : int
        Samples since.
    """

    state: FilterState
    innovation: Innovation | None = None
    behind: float = 0.0
    calm: int = 0
    whole: bool = True
    event: bool | None = None
    age: int = 0

    def after(
        self, state: FilterState, said: Innovation, sizes: tuple[Array, Array], gate: float, *, out: NDArray[np.bool_],
        few: bool, decided: bool | None,
    ) -> Plain:  # fmt: skip
        """One sample later.

        Parameters
        ----------
        state : FilterState
        said : Innovation
        sizes : (array (m,), array (m,))
            Of the innovations of this filter and of that with the gate, both over the std that this one expects; NaN
            where a channel is missing.
        gate : float
        out : array of bool (m,)
            Channels that the gate has kept out.
        few : bool
            So few that those that are left are to judge: this filter bends the load to a broken sensor.
        decided : bool or None
            What the gate has decided now, if anything: an event, or wrong channels.
        """
        own, other = (np.minimum(np.where(np.isfinite(size), size, 0.0), gate) ** 2 for size in sizes)
        calm = self.calm + 1 if np.all(own < gate**2) else 0
        behind = max(0.0, self.behind + float(np.sum((other - own)[~out if few else slice(None)])))
        last = (self.event, self.age + 1) if decided is None else (decided, 0)
        return Plain(state, said, behind, calm, self.whole and not out.any(), *last)

    def contradicts(self, decided: bool | None) -> bool:
        """Whether the gate decides otherwise than it did a few samples ago."""
        return decided is not None and self.event is not None and decided != self.event and self.age < CALM

    def to_tree(self) -> dict[str, Any]:
        """All but what the last sample said, as plain arrays and numbers."""
        own = {"behind": self.behind, "calm": self.calm, "whole": self.whole, "event": self.event, "age": self.age}
        return {**self.state.to_tree(), **own}


def plain_of(tree: dict[str, Any] | None) -> Plain | None:
    """Inverse of `Plain.to_tree`."""
    if tree is None:
        return None
    event = None if tree["event"] is None else bool(tree["event"])
    return Plain(
        FilterState.from_tree(tree), behind=float(tree["behind"]), calm=int(tree["calm"]), whole=bool(tree["whole"]),
        event=event, age=int(tree["age"]),
    )  # fmt: skip
