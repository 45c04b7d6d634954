"""What a running sensor gives: a frame with its map, and how old it is."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from .._arrays import Array
from .._results.forcemap import ForceMap
from ._events import LiveEvent
from ._slip import SlipMap


@dataclass(frozen=True)
class Latency:
    """How a frame has spent its time (s), from when the camera gave it to when it was taken: each with the wait before.

    Parameters
    ----------
    capture : float
        Made grey, and put into the queue.
    track : float
        Dots found and followed.
    map : float
        Zero, map, slip and events.
    out : float
        Until somebody took it.
    """

    capture: float = 0.0
    track: float = 0.0
    map: float = 0.0
    out: float = 0.0

    @property
    def total(self) -> float:
        """Age of the map (s)."""
        return self.capture + self.track + self.map + self.out


@dataclass(frozen=True, eq=False)
class LiveFrame:
    """One frame of a running sensor.

    Parameters
    ----------
    number : int
        Of the frame, from 1, over all runs of a state.
    time : float
        Its time (s): of a file its stamp, of a camera that of the clock of this machine (since 1970) when it came.
    map : ForceMap
    motion : array (N, 2 or 3)
        Motion of the markers from the rest of the eye (m), no zero taken off; NaN where one is lost.
    touched : bool
        Whether the markers show more than a pad at rest.
    slip : SlipMap or None
        Where something touches and its friction is known.
    events : tuple of LiveEvent
        What was said since the frame before.
    on : tuple of str
        What has begun and not ended.
    latency : Latency
    image : array or None
        The grey image, where images are kept.
    """

    number: int
    time: float
    map: ForceMap
    motion: Array
    touched: bool = False
    slip: SlipMap | None = None
    events: tuple[LiveEvent, ...] = ()
    on: tuple[str, ...] = ()
    latency: Latency = field(default_factory=Latency)
    image: Any = None
