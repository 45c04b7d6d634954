"""Tracked loads as lines of text, redrawn in a terminal while samples come."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

WINDOW = 2000  # samples that are shown
INTERVAL = 0.25  # s between two drawings
HEIGHT, WIDTH = 9, 72  # characters of a load in a terminal
SHOWN = 3  # loads in a terminal


def live(
    labels: Sequence[str], units: Sequence[str], times: NDArray, load: NDArray, std: NDArray, note: str = ""
) -> str:
    """Loads and their 95 % bands as text, the newest sample at the right.

    Parameters
    ----------
    labels, units : sequence of str
        Of the loads.
    times : array, shape (samples,)
    load, std : array, shape (samples, loads)
    note : str
        Last line.
    """
    lines = []
    for j in range(min(len(labels), SHOWN)):
        lines += _panel(f"{labels[j]} [{units[j]}]", times, load[:, j], 1.96 * std[:, j])
    more = len(labels) - SHOWN
    if more > 0:
        lines.append(f"and {more} more loads")
    return "\n".join([*lines, note] if note else lines)


def _panel(name: str, times: NDArray, load: NDArray, half: NDArray) -> list[str]:
    parts = np.array_split(np.arange(len(load)), min(WIDTH, len(load)))
    low = np.array([np.min(load[p] - half[p]) for p in parts])
    high = np.array([np.max(load[p] + half[p]) for p in parts])
    middle = np.array([np.mean(load[p]) for p in parts])
    bottom, top = float(low.min()), float(high.max())
    if not top > bottom:
        bottom, top = bottom - 1.0, top + 1.0
    step = (top - bottom) / HEIGHT
    rows = [[" "] * len(parts) for _ in range(HEIGHT)]
    for k in range(len(parts)):
        a, b, c = (min(int((x - bottom) / step), HEIGHT - 1) for x in (low[k], high[k], middle[k]))
        for r in range(a, b + 1):
            rows[r][k] = "░"
        rows[c][k] = "█"
    lines = [f"{'':9} {name}  now {load[-1]:.4g} ± {half[-1]:.2g} (95 %)"]
    for r in reversed(range(HEIGHT)):
        label = f"{bottom + (r + 0.5) * step:9.3g}" if r in (0, HEIGHT // 2, HEIGHT - 1) else " " * 9
        lines.append(f"{label} │{''.join(rows[r])}")
    ends = f"{times[0]:.6g} s", f"{times[-1]:.6g} s"
    return [*lines, f"{'':9} └{ends[0]}{' ' * max(len(parts) - len(ends[0]) - len(ends[1]), 1)}{ends[1]}"]


class Screen:
    """Redraws the newest samples in place; silent where the stream is no terminal.

    Parameters
    ----------
    labels, units : sequence of str
        Of the loads.
    stream : text stream
    """

    def __init__(self, labels: Sequence[str], units: Sequence[str], stream: TextIO) -> None:
        self.labels, self.units, self.stream = labels, units, stream
        self.shown = bool(getattr(stream, "isatty", lambda: False)())
        self._recent: tuple[NDArray, ...] = ()
        self._last, self._height = 0.0, 0

    def add(self, times: NDArray, load: NDArray, std: NDArray) -> None:
        """More samples; drawn where the last drawing is old enough."""
        if not self.shown:
            return
        new = times, load, std
        both = new if not self._recent else tuple(np.concatenate(p) for p in zip(self._recent, new, strict=True))
        self._recent = tuple(np.array(p[-WINDOW:]) for p in both)
        now = time.monotonic()
        if now - self._last >= INTERVAL:
            self._last = now
            self.draw()

    def draw(self) -> None:
        """Over the last drawing."""
        if not self.shown or not self._recent:
            return
        times, load, std = self._recent
        lines = live(self.labels, self.units, times, load, std).split("\n")
        up = f"\x1b[{self._height}A" if self._height else ""
        self.stream.write(up + "".join(f"\x1b[2K{line}\n" for line in lines))
        self.stream.flush()
        self._height = len(lines)
