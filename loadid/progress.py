"""A progress bar of one line, on a terminal only."""

from __future__ import annotations

import sys
import time
from typing import Self, TextIO


class Bar:
    """Callable ``bar(fraction, text)`` that redraws one line; silent where the stream is no terminal.

    It is what the command line passes as ``progress=``: any callable with these two arguments will do.

    Parameters
    ----------
    stream : text stream, optional
        Default standard error.
    interval : float
        Seconds between two drawings.
    """

    def __init__(self, stream: TextIO | None = None, *, interval: float = 0.1) -> None:
        self.stream = sys.stderr if stream is None else stream
        self.interval = interval
        self.shown = bool(getattr(self.stream, "isatty", lambda: False)())
        self._last = 0.0
        self._width = 0

    def __call__(self, fraction: float, text: str) -> None:
        """Show that `fraction` (0 to 1) of the work is done, and what is done now."""
        now = time.monotonic()
        if not self.shown or (now - self._last < self.interval and fraction < 1):
            return
        self._last = now
        full = round(20 * min(max(fraction, 0.0), 1.0))
        self._draw(f"{text} [{'#' * full}{'.' * (20 - full)}] {fraction:4.0%}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        if self._width:
            self._draw("")

    def _draw(self, text: str) -> None:
        print(f"\r{text.ljust(self._width)}" + ("" if text else "\r"), end="", file=self.stream, flush=True)
        self._width = len(text)
