"""The judge of the gate: the same filter without one, run beside it from the sample at which the gate opened.

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

from ...inverse.kalman.squareroot import Innovation, State

CALM = 20  # samples within the gate, after which the filter without one has found back; within which stories conflict
OVER = 10 * CALM  # samples without a new story, after which the gate was right
DOUBLINGS = 20  # at most, of the calm that a gate waits for which failed


@dataclass(frozen=True, eq=False)
class Plain:
    """A filter that believes every number, and how it compares with the one that has a gate.

    Parameters
    ----------
    state : State
        After the last sample.
    said : Innovation or None
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

    state: State
    said: Innovation | None = None
    behind: float = 0.0
    calm: int = 0
    whole: bool = True
    event: bool | None = None
    age: int = 0

    def after(
        self, state: State, said: Innovation, sizes: tuple[NDArray, NDArray], gate: float, *, out: NDArray[np.bool_],
        few: bool, decided: bool | None,
    ) -> Plain:  # fmt: skip
        """One sample later.

        Parameters
        ----------
        state : State
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
        s = self.state
        return {
            "x": s.x, "L": s.L, "y": s.y, "behind": self.behind, "calm": self.calm, "whole": self.whole,
            "event": self.event, "age": self.age,
        }  # fmt: skip


def plain_of(tree: dict[str, Any] | None) -> Plain | None:
    """Inverse of `Plain.to_tree`."""
    if tree is None:
        return None
    y = None if tree["y"] is None else np.asarray(tree["y"], float)
    state = State(np.asarray(tree["x"], float), np.asarray(tree["L"], float), y)
    event = None if tree["event"] is None else bool(tree["event"])
    return Plain(
        state, behind=float(tree["behind"]), calm=int(tree["calm"]), whole=bool(tree["whole"]), event=event,
        age=int(tree["age"]),
    )  # fmt: skip
