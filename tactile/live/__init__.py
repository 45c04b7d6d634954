"""A tactile sensor that a robot keeps running: frames in, force maps out, with what happened in between.

`Live` runs a sensor on a camera (`start`: that of a pad file) and gives `LiveFrame`; it takes its zero anew in quiet
times (`ZeroStep`), learns the friction of the contact (`Friction`, `SlipMap`), says what begins and ends (`LiveEvent`),
keeps what it learned through a kill (`State`) and records what it saw (`Recording`, `replay`). `point_cloud` and
`wrench` are the fields of ROS 2 messages, `message` those of a line of JSON; `LineServer` and `Viewer` give them to
others on this machine.
"""

from __future__ import annotations

from ._events import LiveEvent
from ._frame import Latency, LiveFrame
from ._loop import Live
from ._messages import LineServer, message, point_cloud, wrench
from ._recordings import Recording, replay
from ._slip import Friction, SlipMap
from ._start import start
from ._state import State
from ._viewer import Viewer
from ._zero import ZeroStep

__all__ = [
    "Friction", "Latency", "LineServer", "Live", "LiveEvent", "LiveFrame", "Recording", "SlipMap", "State", "Viewer",
    "ZeroStep", "message", "point_cloud", "replay", "start", "wrench",
]  # fmt: skip
