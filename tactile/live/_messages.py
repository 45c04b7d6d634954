"""What goes out of a frame: a line of JSON, and the fields of two ROS 2 messages, without ROS.

Forces act on the pad, in its frame: origin at the centre of the surface, z out of the pad.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from socketserver import StreamRequestHandler, ThreadingTCPServer
from threading import Condition, Thread
from typing import TYPE_CHECKING, Any

import numpy as np

from loadid._results.archive import plain
from structures.errors import InputError

from .._results.forcemap import ForceMap

if TYPE_CHECKING:
    from ._events import LiveEvent
    from ._frame import LiveFrame

FLOAT32 = 7  # sensor_msgs/PointField
FIELDS = ("x", "y", "z", "fx", "fy", "fz")
ROOM = 8  # lines that wait for a listener


def message(frame: LiveFrame) -> dict[str, Any]:
    """A frame as plain numbers: force and torque with std, contact, slip, codes of flags, events, latency; SI units."""
    found = frame.map
    force, torque, contact = found.resultant(), found.torque(), found.contact()
    touch = {"centre": contact.centre, "area": contact.area, "radius": contact.radius, "peak": contact.peak}
    slip = frame.slip
    told = None if slip is None else {
        "share": slip.share, "sure": slip.sure, "friction": slip.friction.value, "friction_std": slip.friction.std,
        "slid": slip.friction.sliding,
    }  # fmt: skip
    out: dict[str, Any] = plain({
        "number": frame.number, "time": frame.time, "force": force.value, "force_std": force.std,
        "torque": torque.value, "torque_std": torque.std, "touched": frame.touched,
        "contact": touch if contact.area > 0 else None, "slip": told, "flags": sorted(found.codes),
        "on": frame.on, "events": [event_message(event) for event in frame.events],
        "latency": {**vars(frame.latency), "total": frame.latency.total},
    })  # fmt: skip
    return out


def event_message(event: LiveEvent) -> dict[str, Any]:
    """An event as plain numbers and text."""
    out: dict[str, Any] = plain(vars(event))
    return out


def line(frame: LiveFrame) -> str:
    """One line of strict JSON, its end left out."""
    return json.dumps(message(frame), allow_nan=False, separators=(",", ":"))


# -- ROS 2 ------------------------------------------------------------------------------------------------------------
def wrench(force: ForceMap) -> dict[str, dict[str, float]]:
    """Fields of ``geometry_msgs/Wrench``: force (N) and torque (N m) on the pad, about the centre of its surface."""
    both = {"force": force.resultant().value, "torque": force.torque().value}
    return {name: dict(zip("xyz", map(float, value), strict=True)) for name, value in both.items()}


def point_cloud(force: ForceMap) -> dict[str, Any]:
    """Fields of ``sensor_msgs/PointCloud2``, header left out: one point for each node of the surface.

    Little-endian float32 x, y, z (m) and fx, fy, fz (N, the nodal force on the pad), one after another: 24 bytes for a
    point. ``fields`` are dictionaries of the fields of ``sensor_msgs/PointField``.
    """
    values = np.hstack([force.nodes, force.forces()]).astype("<f4")
    step = 4 * len(FIELDS)
    return {
        "height": 1,
        "width": len(values),
        "fields": [{"name": n, "offset": 4 * k, "datatype": FLOAT32, "count": 1} for k, n in enumerate(FIELDS)],
        "is_bigendian": False,
        "point_step": step,
        "row_step": step * len(values),
        "data": values.tobytes(),
        "is_dense": bool(np.isfinite(values).all()),
    }


# -- to many listeners ------------------------------------------------------------------------------------------------
class LineListeners:
    """Texts to any number of listeners, each in a thread of its own: one that is slow misses the oldest."""

    def __init__(self, room: int = ROOM) -> None:
        self._room, self._all, self._over = room, set[_Ear](), False
        self.missed = 0

    def say(self, text: str) -> None:
        """To all that listen now; nobody waits."""
        for ear in tuple(self._all):
            self.missed += ear.take(text)

    def heard(self) -> Iterator[str | None]:
        """Texts from now on; None where a second passes without one. Ends with `close`."""
        ear = _Ear(self._room)
        self._all.add(ear)
        try:
            while not self._over:
                yield ear.next()
        finally:
            self._all.discard(ear)

    def __len__(self) -> int:
        return len(self._all)

    def close(self) -> None:
        """End all that listen."""
        self._over = True
        for ear in tuple(self._all):
            ear.take("")


class _Ear:
    def __init__(self, room: int) -> None:
        self._texts: deque[str] = deque(maxlen=room)
        self._changed = Condition()

    def take(self, text: str) -> int:
        with self._changed:
            missed = len(self._texts) == self._texts.maxlen
            self._texts.append(text)
            self._changed.notify()
        return int(missed)

    def next(self) -> str | None:
        with self._changed:
            if not self._texts:
                self._changed.wait(1.0)
            return self._texts.popleft() if self._texts else None


class LineServer:
    """JSON lines for whoever connects to a port of the loopback.

    Parameters
    ----------
    port : int
        0 for any that is free; `port` says which.

    Raises
    ------
    InputError
        A port that is taken.
    """

    def __init__(self, port: int) -> None:
        self.listeners = LineListeners()
        handler = type("Handler", (_Lines,), {"listeners": self.listeners})
        try:
            self._server = _Server(("127.0.0.1", port), handler)
        except OSError as error:
            raise taken("--port", port, error) from None
        self.port = int(self._server.server_address[1])
        Thread(target=self._server.serve_forever, name="lines", daemon=True).start()

    def close(self) -> None:
        """Answer nobody any more."""
        self.listeners.close()
        self._server.shutdown()
        self._server.server_close()


def taken(option: str, port: int, error: OSError) -> InputError:
    """A port that cannot be had."""
    return InputError("the port cannot be had", where=f"{option} {port}", found=error.strerror,
                      hint="name another one, or 0 for any that is free")  # fmt: skip


class _Server(ThreadingTCPServer):
    allow_reuse_address, daemon_threads = True, True


class _Lines(StreamRequestHandler):
    listeners: LineListeners

    def handle(self) -> None:
        """Lines until the listener leaves."""
        self.request.settimeout(10)  # s, for a listener that does not read
        with suppress(OSError):
            for text in self.listeners.heard():
                if text:
                    self.wfile.write(text.encode() + b"\n")
