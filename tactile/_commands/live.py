"""``loadid tactile live``: a sensor that goes on running, with lines of JSON, a page, recordings and a state."""

from __future__ import annotations

import contextlib
import json
import signal
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from loadid._commands import UsageError, number, positive, require_outputs, say

if TYPE_CHECKING:
    from ..live import Live, LiveEvent, LiveFrame

WORD = "live"
OPTIONS = ("camera", "state", "record", "images", "quiet", "port", "view", "replay", "speed", "lines")


def port(text: str) -> int:
    """A port from 0 to 65535."""
    return int(number(text, "port, 0 to 65535", lambda value: value == int(value) and 0 <= value < 65536))


def never(text: str) -> float:
    """Seconds, 0 for never."""
    return number(text, "number of seconds >= 0", lambda value: 0 <= value < 1e6)


def configure(parser: ArgumentParser) -> None:
    """Options of the live sensor, beside those of a map."""
    group = parser.add_argument_group("live", "loadid tactile live --pad PAD.toml --camera 0: until it is interrupted")
    group.add_argument("--camera", metavar="0|FILE|-", help="number or device of a camera, frames as INPUT, or - for "
                       "images through a pipe")  # fmt: skip
    group.add_argument("--state", metavar="STATE.h5", help="zero, eye, friction and counters, kept through a kill")
    group.add_argument("--record", metavar="FILE", action="append", help="recording to write, .h5 or .mcap; may repeat")
    group.add_argument("--images", action="store_true", help="also record the images")
    group.add_argument("--quiet", type=never, metavar="S", help="seconds without a touch, after which the zero is "
                       "taken anew; default 3, 0 for never")  # fmt: skip
    group.add_argument("--port", type=port, metavar="PORT", help="also send the lines to who connects to this port of "
                       "127.0.0.1; 0 for any that is free")  # fmt: skip
    group.add_argument("--view", type=port, metavar="PORT", help="show a page at this port of 127.0.0.1; 0 for any")
    group.add_argument("--replay", metavar="FILE", help="play a recording instead of a camera")
    group.add_argument("--speed", type=positive, metavar="X", help="of the recording; default 1")
    group.add_argument("--lines", choices=("all", "events", "none"), help="what to print; default all")


def run(args: Namespace) -> int:
    """Run until the frames end, or somebody interrupts."""
    if (args.replay is None) == (args.camera is None):
        raise UsageError("live takes --camera (with --pad), or --replay")
    if args.camera is not None and args.pad is None:
        raise UsageError("needed too: --pad PAD.toml (see loadid tactile --help)")
    if args.replay is not None:
        extra = [n for n in ("pad", "state", "record", "quiet") if getattr(args, n) is not None]
        extra += ["images"] if args.images else []
        if extra:
            raise UsageError(f"--replay plays what was recorded: {', '.join(f'--{n}' for n in extra)} is for a camera")
    elif args.speed is not None:
        raise UsageError("--speed is for --replay")
    for record in args.record or (None,):
        require_outputs({"--state": args.state, "--record": record}, [args.pad])
    with _Out(args) as out:
        out.played() if args.replay is not None else out.lived()
    return 0


class _Out:
    """Where frames go: standard output, a port, a page."""

    def __init__(self, args: Namespace) -> None:
        self._args, self._lines = args, args.lines or "all"
        self._open: list[Any] = []

    def __enter__(self) -> _Out:
        from ..live import LineServer, Viewer

        args = self._args
        self._server = None if args.port is None else LineServer(args.port)
        self._viewer = None if args.view is None else Viewer(args.view)
        for name, one in (("lines", self._server), ("page", self._viewer)):
            if one is not None:
                self._open.append(one)
                where = f"127.0.0.1:{one.port}" if isinstance(one, LineServer) else one.address
                say(f"loadid: {name} at {where}", aside=True)
        return self

    def __exit__(self, *exc: object) -> None:
        for one in self._open:
            one.close()

    def played(self) -> None:
        """Frames of a recording."""
        from ..live import replay

        for frame in replay(self._args.replay, speed=self._args.speed or 1.0):
            self._frame(frame)

    def lived(self) -> None:
        """Frames of a camera, until it ends or a signal says so."""
        from structures._flags import known_codes

        from ..live import start

        args = self._args
        settings: dict[str, Any] = {} if args.quiet is None else {"quiet": args.quiet or None}
        settings |= {} if args.unloaded is None else {"unloaded": _count(args.unloaded)}
        camera = int(args.camera) if args.camera.isdecimal() else args.camera
        live = start(args.pad, camera, state=args.state, lam=args.lam, friction=args.friction, no_pull=args.no_pull,
                     allow=known_codes(args.allow, where="--allow"), rate=args.rate, record=args.record or (),
                     images=args.images, told=self._event, **settings)  # fmt: skip
        with _until(live), live:
            for frame in live:
                self._frame(frame)
        counts = ", ".join(f"{value} {name}" for name, value in live.counts.items())
        say(f"loadid: {counts}", aside=True)

    def _event(self, event: LiveEvent) -> None:
        from ..live._messages import event_message

        if self._lines == "events":
            say(json.dumps(event_message(event), allow_nan=False))

    def _frame(self, frame: LiveFrame) -> None:
        from ..live._messages import line

        text = line(frame) if self._lines == "all" or self._server is not None else ""
        if self._lines == "all":
            say(text)
        elif self._lines == "events" and self._args.replay is not None:
            for event in frame.events:
                self._event(event)
        if self._server is not None:
            self._server.listeners.say(text)
        if self._viewer is not None:
            self._viewer.show(frame)


def _count(text: str) -> int:
    if not (text.isdecimal() and int(text) > 0):
        raise UsageError(f"live takes --unloaded N, the frames that it begins with, not {text!r}")
    return int(text)


@contextlib.contextmanager
def _until(live: Live) -> Iterator[None]:
    """SIGINT and SIGTERM end the loop as the end of its frames would: the state is written."""
    import threading

    def stop(*_: Any) -> None:
        live.stop()

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
