"""What happens in a day of a sensor: said once when it begins, and once when it ends."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .._arrays import Array

log = logging.getLogger(__name__)
BEGIN, END = 3, 5  # frames in a row, after which something has begun, or ended
AROUND = 8  # neighbours of a marker
LOST = 0.03  # share of the markers that are lost, beyond those that always are
TOGETHER = 0.5  # share of the neighbours of lost markers that are lost too, from which on something lies over them
LIGHT, AGAIN = 0.2, 0.1  # change of the mean grey level that is told, and below which it is over
STEP = 8  # px between those of which the mean is taken
SETTLING = 0.05  # weight of a frame in the light that is usual


@dataclass(frozen=True)
class LiveEvent:
    """Something that began, ended, or happened once.

    Parameters
    ----------
    kind : str
        ``"no image"``, ``"light"``, ``"markers lost"``, ``"covered"``, ``"camera moved"``, ``"sliding"``, ``"zeroed"``.
    state : {"begins", "ends", "once"}
    number, time : int, float
        Frame at which it was said, and its time (s).
    text : str
        What was found, with its numbers.
    """

    kind: str
    state: str
    number: int
    time: float
    text: str

    def __str__(self) -> str:
        return f"frame {self.number}: {self.kind}{'' if self.state == 'once' else f' {self.state}'}: {self.text}"


class _Lamp:
    """One condition: on after some frames in a row that show it, off after some that do not."""

    def __init__(self, begin: int = BEGIN, end: int = END) -> None:
        self.on, self._needed, self._row, self._since = False, (begin, end), 0, 0

    def seen(self, there: bool, number: int) -> str | None:
        """``"begins"`` or ``"ends"``, where it does."""
        self._row = self._row + 1 if there != self.on else 0
        if self._row < self._needed[int(self.on)]:
            return None
        self.on, self._row = not self.on, 0
        return "begins" if self.on else "ends"


class EventWatch:
    """Says what begins and ends, of markers at places (N, 2) in m."""

    def __init__(self, places: Array) -> None:
        self._lamps: dict[str, _Lamp] = {"no image": _Lamp(1, 1)}
        self._near = cKDTree(places).query(places, k=min(AROUND + 1, len(places)))[1].reshape(len(places), -1)[:, 1:]
        self._always: float | None = None  # share of the markers that is lost anyhow
        self._light: float | None = None
        self._since: dict[str, int] = {}

    @property
    def on(self) -> tuple[str, ...]:
        """What has begun and not ended."""
        return tuple(kind for kind, lamp in self._lamps.items() if lamp.on)

    def dead(self, number: int, time: float, why: str) -> list[LiveEvent]:
        """A frame that tells nothing."""
        return self._said("no image", True, number, time, why)

    def once(self, kind: str, number: int, time: float, text: str) -> LiveEvent:
        """Something that happened."""
        return _logged(LiveEvent(kind, "once", number, time, text))

    def settled(self) -> None:
        """The light and the markers of the next frames are the usual ones: a zero was taken."""
        self._light = self._always = None

    def seen(
        self, number: int, time: float, image: Any, lost: NDArray[np.bool_], moved: str | None, sliding: bool
    ) -> list[LiveEvent]:
        """A frame that has a map: its image (None where there is none), lost markers (N,), W611 in words."""
        share, together = self._lost(lost)
        gone = share > LOST
        bright = None if image is None else float(np.mean(image[::STEP, ::STEP]))
        before = self._lamps["no image"].on
        found = self._said("no image", False, number, time, "frames are there again")
        self._since.pop("no image", None) if before else None
        for kind, there, text in (
            ("covered", gone and together >= TOGETHER, f"{share:.0%} of the markers are hidden, side by side"),
            ("markers lost", gone and together < TOGETHER, f"{share:.0%} of the markers are lost, here and there"),
            ("camera moved", moved is not None, moved or "the markers far from contact are where they were at zero"),
            ("sliding", sliding, "the contact moves along the pad, the way that the shear points"),
        ):
            found += self._said(kind, bool(there), number, time, text)
        return found + ([] if bright is None else self._lit(number, time, bright))

    def _lit(self, number: int, time: float, bright: float) -> list[LiveEvent]:
        usual = self._light = bright if self._light is None else self._light
        change = bright / max(usual, 1.0) - 1
        lamp = self._lamps.get("light")
        limit = AGAIN if lamp is not None and lamp.on else LIGHT
        if abs(change) < AGAIN:  # slow changes are followed
            self._light = usual + SETTLING * (bright - usual)
        word = "darker" if change < 0 else "brighter"
        return self._said("light", abs(change) > limit, number, time, f"{abs(change):.0%} {word} than usual")

    def _lost(self, lost: NDArray[np.bool_]) -> tuple[float, float]:
        """Share of the markers that are lost beyond the usual, and of their neighbours that are lost too."""
        share = float(lost.mean())
        self._always = share if self._always is None else min(self._always, share)
        together = float(lost[self._near[lost]].mean()) if lost.any() else 0.0
        return share - self._always, together

    def _said(self, kind: str, there: bool, number: int, time: float, text: str) -> list[LiveEvent]:
        turn = self._lamps.setdefault(kind, _Lamp()).seen(there, number)
        if turn is None:
            return []
        if turn == "begins":
            self._since[kind] = number
        else:
            text = f"over, after {number - self._since.pop(kind, number)} frames"
        return [_logged(LiveEvent(kind, turn, number, time, text))]


def _logged(event: LiveEvent) -> LiveEvent:
    log.warning("%s", event) if event.state == "begins" else log.info("%s", event)
    return event
