"""A page that shows a running sensor, for browsers on this machine: the map, arrows of shear, force over time, lamps.

Served on the loopback alone, and to a browser that asks for it by that name: another page that lets its own name point
here (DNS rebinding) is refused by the ``Host`` it asks for. Pictures are server-sent events: what is drawn, in bytes.
"""

from __future__ import annotations

import base64
import json
import threading
import time as clock
from contextlib import suppress
from importlib.resources import files
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from loadid._loopback import LOCAL, LoopbackHandler, LoopbackServer

from .._arrays import Array
from .._results.forcemap import ForceMap
from ._frame import LiveFrame
from ._messages import LineListeners, message

RATE = 30.0  # pictures a second, at most
CELLS, ARROWS = 64, 16  # places along the longer side that are drawn, of the pressure and of the arrows
DEEP = 127  # of a byte, for the largest value of a picture


class Viewer:
    """A page at `address`, which shows the frames that it is given.

    Parameters
    ----------
    port : int
        0 for any that is free.
    rate : float
        Pictures a second, at most.

    Raises
    ------
    InputError
        A port that is taken.
    """

    def __init__(self, port: int = 0, *, rate: float = RATE) -> None:
        self.listeners = LineListeners(room=2)
        self._least, self._last = 1 / rate, -np.inf
        self._drawn: _Drawn | None = None
        self._http = LoopbackServer(port, type("PageOf", (_PageHandler,), {"viewer": self}), where="--view")
        self.address = f"{self._http.address}/"
        threading.Thread(target=self._http.serve_forever, name="viewer", daemon=True).start()

    def show(self, frame: LiveFrame) -> None:
        """Draw a frame, where somebody looks and the last one is old enough."""
        now = clock.monotonic()
        if self._drawn is None:
            self._drawn = _Drawn(frame.map)
        if not len(self.listeners) or (now - self._last < self._least * 0.98 and not frame.events):
            return
        self._last = now
        self.listeners.say(json.dumps({**message(frame), **self._drawn.picture(frame)}, separators=(",", ":")))

    def layout(self) -> dict[str, Any]:
        """Where the places are that are drawn; nothing before the first frame."""
        return {} if self._drawn is None else self._drawn.layout

    def close(self) -> None:
        """Answer nobody any more."""
        self.listeners.close()
        self._http.shutdown()
        self._http.server_close()


class _Drawn:
    """Which nodes are drawn: means over cells of a grid where there are more of them than a picture shows."""

    def __init__(self, found: ForceMap) -> None:
        xy = found.nodes[:, :2]
        self._cells, self._arrows = _Thinned(xy, CELLS), _Thinned(xy, ARROWS)
        self.layout = {
            "cells": _bytes(self._cells.places.astype("<f4")), "side": self._cells.side,
            "arrows": _bytes(self._arrows.places.astype("<f4")), "step": self._arrows.side,
            "low": xy.min(axis=0).tolist(), "high": xy.max(axis=0).tolist(),
        }  # fmt: skip

    def picture(self, frame: LiveFrame) -> dict[str, Any]:
        """Pressure and shear as bytes, with the values (Pa) of their largest."""
        t = frame.map.traction()
        pressure, shear = self._cells.mean(-t[:, 2]), self._arrows.mean(t[:, :2])
        top, most = (max(float(np.abs(a).max()), 1e-9) for a in (pressure, shear))
        out = {"pressure": _bytes(np.round(pressure / top * DEEP).astype(np.int8)), "top": top,
               "shear": _bytes(np.round(shear / most * DEEP).astype(np.int8)), "most": most}  # fmt: skip
        if frame.slip is not None:
            ratio = self._cells.mean(np.nan_to_num(frame.slip.ratio))
            out["near"] = _bytes(np.clip(np.round(ratio * DEEP / 2), 0, DEEP).astype(np.int8))
        return out


class _Thinned:
    """Means of values at places (P, 2) over squares, as many as `count` along the longer side of their extent."""

    def __init__(self, places: Array, count: int) -> None:
        low, span = places.min(axis=0), float(np.ptp(places, axis=0).max())
        pitch = float(np.sqrt(np.prod(np.maximum(np.ptp(places, axis=0), 1e-9)) / max(len(places) - 1, 1)))
        self.side = max(span / count, pitch)
        cell = np.round((places - low) / self.side).astype(int) if self.side > pitch else np.arange(len(places))
        rows = cell if cell.ndim == 1 else cell[:, 0] * (count + 2) + cell[:, 1]
        self._which = np.unique(rows, return_inverse=True)[1]
        self._size = np.bincount(self._which)
        self.places = self.mean(places)

    def mean(self, values: Array) -> Array:
        """Of values (P,) or (P, k) over each square."""
        flat = values.reshape(len(values), -1)
        sums = [np.bincount(self._which, column, len(self._size)) for column in flat.T]
        return np.asarray((np.array(sums) / self._size).T.reshape(-1, *values.shape[1:]))


def _bytes(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


class _PageHandler(LoopbackHandler):
    viewer: Viewer
    headers_of_all: ClassVar[dict[str, str]] = {"Content-Security-Policy": "default-src 'self' 'unsafe-inline'"}

    def do_GET(self) -> None:
        """``/``, ``/layout`` and ``/pictures``."""
        if (self.headers.get("Host") or "").partition(":")[0] not in LOCAL:  # of any port: it may be forwarded
            self.say(403, "text/plain", "this page is for its own machine\n")
        elif self.path == "/":
            self.say(200, "text/html; charset=utf-8", files(__package__).joinpath("page.html").read_text("utf-8"))
        elif self.path == "/layout":
            self.say(200, "application/json", json.dumps(self.viewer.layout()))
        elif self.path == "/pictures":
            self._pictures()
        else:
            self.say(404, "text/plain", "/, /layout or /pictures\n")

    def _pictures(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.flush()
        with suppress(OSError):
            for text in self.viewer.listeners.heard():
                self.wfile.write(b": here\n\n" if text is None else f"data: {text}\n\n".encode() if text else b"")
                self.wfile.flush()
