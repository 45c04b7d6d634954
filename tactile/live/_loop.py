"""A sensor that goes on running: frames in, maps out, every stage in a thread of its own.

Between two stages a few frames wait. Where the source is a camera, which does not wait, the oldest of them makes room
for the newest and is counted; a file or a pipe waits, and loses nothing.
"""

from __future__ import annotations

import logging
import threading
import time as clock
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from loadid.codes import collect
from structures._flags import Flag
from structures.errors import InputError, positive

from .. import _guards as guards
from .._arrays import UnusableFrame
from .._sensors.linear import LinearSensor
from .._sensors.marked import MarkedSensor, is_image
from .._sensors.observation import DepthMap
from ..vision._frames import Frames, each, frames
from ..vision._images import grey
from ._events import EventWatch, LiveEvent
from ._frame import Latency, LiveFrame
from ._recordings import Recording
from ._slip import SlipMap, SlipWatch
from ._state import kept, state_of
from ._zero import Rest

log = logging.getLogger(__name__)
QUIET = 3.0  # s without a touch, after which the zero is taken anew
ROOM = {"capture": 2, "track": 2, "map": 2, "keep": 64}  # frames that wait after each stage
NEWEST = {"capture": 1, "track": 1}  # of a camera: what waits grows old
KEPT = 2000  # frames over which the latency is told
CHECKPOINT = 5.0  # s between two files of the state
PATIENCE = 2.0  # s for a source that gives nothing, when it is to end
AGAIN = 1.0  # s between two attempts to open a camera that is gone
T = TypeVar("T")


class Waiting(Generic[T]):
    """What waits between two stages, at most `room`: full, the oldest is dropped and counted, or its giver waits."""

    def __init__(self, room: int, *, drop: bool) -> None:
        self.dropped, self._room, self._drop, self._over = 0, room, drop, False
        self._items: deque[T] = deque()
        self._changed = threading.Condition()

    def put(self, item: T) -> bool:
        """Whether somebody may still take it."""
        with self._changed:
            while len(self._items) >= self._room and not self._drop and not self._over:
                self._changed.wait()
            if self._over:
                return False
            if len(self._items) >= self._room:
                self._items.popleft()
                self.dropped += 1
            self._items.append(item)
            self._changed.notify_all()
            return True

    def take(self) -> T | None:
        """The oldest; None once it is at its end."""
        with self._changed:
            while not self._items and not self._over:
                self._changed.wait()
            item = self._items.popleft() if self._items else None
            self._changed.notify_all()
            return item

    def end(self) -> None:
        """Nothing more comes."""
        with self._changed:
            self._over = True
            self._changed.notify_all()


@dataclass(eq=False)
class _Item:
    """A frame on its way: what was seen of it so far, and the times (s) at which its stages ended."""

    number: int
    time: float
    frame: Any
    depth: DepthMap | None
    marks: list[float]
    motion: Any = None
    flags: list[Flag | None] = field(default_factory=list)
    done: LiveFrame | None = None


class Live:
    """A tactile sensor on a camera: an iterator of `LiveFrame`, that can be kept running.

    Frames that tell nothing (black, unreadable, of another size, no markers) have no map; they are counted, said as an
    event, and end nothing. A camera that was opened here by its number or device and is gone is opened again.

    Parameters
    ----------
    sensor : MarkedSensor
        With an eye, for images; lambda fixed, or a map takes long. Its zero is set while it runs.
    camera : number, path, cv2.VideoCapture or iterable
        As `tactile.frames` takes it; an iterable gives images or motions of markers, None where there is none.
    depths : iterable of DepthMap, optional
        One for each frame.
    rate : float, optional
        Frames a second of a source without stamps (folder, iterable); default the clock of this machine.
    drop : bool, optional
        Whether the oldest waiting frame makes room where a stage is slow; default for cameras only.
    quiet : float or None
        Seconds without a touch, after which the mean of their frames becomes the zero; None for never.
    state : path, optional
        File of what was learned: taken up at the start where it is there, written every five seconds and at the end.
    record : path or sequence of paths
        Recordings, .h5 or .mcap.
    images : bool
        Whether frames and recordings keep their image.
    told : callable, optional
        Gets every `LiveEvent` at once, from a thread of the loop.

    Attributes
    ----------
    counts : Counter
        ``frames`` that came, ``maps``, ``dead`` frames without a map, ``dropped`` ones, ``unrecorded`` ones, ``zeros``.

    Raises
    ------
    InputError
        No such source, a state of another pad, settings that do not fit.
    """

    def __init__(
        self,
        sensor: MarkedSensor,
        camera: Any,
        *,
        depths: Iterable[DepthMap] | None = None,
        rate: float | None = None,
        drop: bool | None = None,
        quiet: float | None = QUIET,
        state: str | Path | None = None,
        record: str | Path | Sequence[str | Path] = (),
        images: bool = False,
        told: Callable[[LiveEvent], None] | None = None,
    ) -> None:
        before = kept(state)
        if before is not None:
            assert state is not None
            before.require(sensor, state)
        self.sensor, self.state, self.counts, self.images = sensor, state, Counter[str](), images
        self._rate = None if rate is None else positive("the rate", rate, where="Live", unit="Hz")
        seconds = None if quiet is None else positive("quiet", quiet, where="Live", unit="s")
        self._told, self._depths = told, None if depths is None else iter(depths)
        self._camera = camera
        self._source: Iterable[Any] = _opened(camera)
        self._live = isinstance(self._source, Frames) and self._source.camera
        self._start = 0
        if before is not None:
            sensor.offset, self._start = before.offset, before.number
            self.counts.update({name: int(value) for name, value in before.counts.items()})
        self._rest = Rest(sensor, seconds)
        if before is not None:
            self._rest.anchor = before.anchor.copy()
        self._slip = SlipWatch(None if before is None else before.friction)
        self._watch = EventWatch(sensor.markers.points[:, :2])
        dropping = self._live if drop is None else bool(drop)
        rooms = {**ROOM, **(NEWEST if dropping else {})}
        self._queues = {name: Waiting[_Item](room, drop=dropping) for name, room in rooms.items()}
        self._records: list[Recording] = [Recording(p) for p in _listed(record)]
        self._said: list[LiveEvent] = []
        self._lost: list[int] = []
        self._why, self._number, self._answered = "", self._start, 0
        self._first: InputError | None = None
        self._error: BaseException | None = None
        self._latencies: deque[Latency] = deque(maxlen=KEPT)
        self._asked, self._stopped = threading.Event(), threading.Event()
        self._threads: list[threading.Thread] = []
        self._unkept = False
        self._checked = clock.monotonic()
        self._dropped_before = self.counts["dropped"], self.counts["unrecorded"]

    # -- doing --------------------------------------------------------------------------------------------------------
    def __iter__(self) -> Live:
        return self

    def __next__(self) -> LiveFrame:
        if not self._threads:
            self._run()
        item = self._queues["map"].take()
        if item is None:
            self.close()
            if self._error is not None:
                raise self._error
            if self._first is not None and not self._answered:
                raise self._first
            raise StopIteration
        assert item.done is not None
        latency = _latency([*item.marks, clock.perf_counter()])
        self._latencies.append(latency)
        return replace(item.done, latency=latency)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def stop(self) -> None:
        """End the frames, as if the source had ended; may be called from a signal."""
        self._stopped.set()
        self._queues["capture"].end()

    def close(self) -> None:
        """Stop, write the state, end the recordings. May be called from anywhere, and twice."""
        self._stopped.set()
        for queue in self._queues.values():
            queue.end()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(PATIENCE if thread.name.endswith("capture") else None)
        if isinstance(self._source, Frames) and self._source is not self._camera:
            self._source.close()
        self._counted()
        if self._threads and self.state is not None:
            self._state().write(self.state)
        for one in self._records:
            one.close()
        self._records = []

    def zero(self) -> None:
        """Take the next frame for the rest, whatever it shows: nothing touches. Quiet times make it better."""
        self._asked.set()

    def latency(self, share: float = 0.5) -> Latency:
        """Quantile of the latency of every stage over the last frames (s)."""
        values = np.array([[one.capture, one.track, one.map, one.out] for one in self._latencies])
        return Latency(*map(float, np.quantile(values, share, axis=0))) if len(values) else Latency()

    def ages(self, share: float = 0.5) -> float:
        """Quantile of the age of the map when it was taken, over the last frames (s)."""
        return float(np.quantile([one.total for one in self._latencies], share)) if self._latencies else 0.0

    @property
    def friction(self) -> Any:
        """Friction coefficient as it was learned so far, `Friction`, or None."""
        return self._slip.friction

    # -- stages -------------------------------------------------------------------------------------------------------
    def _run(self) -> None:
        if isinstance(self.sensor, LinearSensor) and self.sensor.frozen:
            self.sensor.prepare()  # before frames wait for it
        stages = (("capture", self._captured), ("track", self._tracking), ("map", self._mapping), ("keep", self._keep))
        for name, work in stages:
            thread = threading.Thread(target=self._guarded, args=(name, work), name=f"tactile {name}", daemon=True)
            self._threads.append(thread)
        for thread in self._threads:
            thread.start()

    def _guarded(self, name: str, work: Callable[[], None]) -> None:
        """A stage that fails ends the loop with its error, after what was done before it."""
        try:
            work()
        except BaseException as error:  # whatever it is, the consumer gets it
            self._error = self._error or error
            if name in ("map", "keep"):
                self._queues["map"].end()
            self._queues["capture"].end()
        finally:
            if name != "keep":
                self._queues[name].end()
            if name == "map":
                self._queues["keep"].end()

    def _captured(self) -> None:
        for number, (frame, depth) in enumerate(self._pairs(), self._start + 1):
            if self._stopped.is_set():
                return
            arrived = clock.perf_counter()
            self.counts["frames"] += 1
            stamp = self._stamp(number)
            if not isinstance(frame, UnusableFrame) and self._pictured(frame):
                try:
                    frame = grey(frame, where=f"frame {number}")
                except UnusableFrame as error:
                    frame = error
            item = _Item(number, stamp, frame, depth, [arrived, clock.perf_counter()])
            if not self._queues["capture"].put(item):
                return

    def _tracking(self) -> None:
        while (item := self._queues["capture"].take()) is not None:
            item.motion = item.frame
            if not isinstance(item.frame, UnusableFrame) and self._pictured(item.frame):
                try:
                    eye = self.sensor.eye
                    if eye is None:
                        raise InputError("this sensor has no eye: it cannot read images", where="Live",
                                         expected="motions of markers, or eye= in the sensor")  # fmt: skip
                    item.motion, item.flags = eye.read(item.frame, item.depth)
                except UnusableFrame as error:
                    item.motion = error
            item.marks.append(clock.perf_counter())
            if not self._queues["track"].put(item):
                return

    def _mapping(self) -> None:
        while (item := self._queues["track"].take()) is not None:
            self._number = item.number
            try:
                item.done = self._mapped(item)
            except UnusableFrame as error:
                self.counts["dead"] += 1
                self._first, self._why = self._first or error, self._why or error.what
                self._lost.append(item.number)
                self._say(self._watch.dead(item.number, item.time, error.what))
                continue
            item.marks.append(clock.perf_counter())
            self._queues["keep"].put(item)
            if not self._queues["map"].put(item):
                return

    def _mapped(self, item: _Item) -> LiveFrame:
        if isinstance(item.motion, UnusableFrame):
            raise item.motion
        if item.motion is None:
            raise UnusableFrame("no image", where=f"frame {item.number}", found="nothing")
        y = self.sensor.markers.readings(item.motion)
        self._zeroed(item, y)
        found = self.sensor.follow(item.motion, item.depth)
        gap = guards.skipped(self._lost, self._why)
        self._lost, self._why = [], ""
        found = replace(found, flags=collect([*found.flags, *item.flags, gap]))
        slipped = next((flag.message for flag in found.flags if flag.code == "LID-W611"), None)
        if self._rest.touched and "camera moved" in self._watch.on:
            slipped = slipped or "a load hides whether the camera is back"
        slip: SlipMap | None = None
        self._slip.sliding = False
        if self._rest.touched and np.isfinite(self._rest.score) and slipped is None:
            slip = self._slip.update(item.time, found, found.contact())
        image = item.frame if self._pictured(item.frame) else None
        lost = np.asarray(np.isnan(y.reshape(len(self.sensor.markers), -1)).any(axis=1))
        self._say(self._watch.seen(item.number, item.time, image, lost, slipped, self._slip.sliding))
        said, self._said = tuple(self._said), []
        self.counts["maps"] += 1
        self._answered += 1
        motion = np.asarray(item.motion, float)[:, : len(self.sensor.markers.axes)]
        return LiveFrame(item.number, item.time, found, motion, self._rest.touched, slip, said, self._watch.on,
                         image=image if self.images else None)  # fmt: skip

    def _keep(self) -> None:
        while (item := self._queues["keep"].take()) is not None:
            assert item.done is not None
            for one in tuple(self._records):
                self._recorded(one, item)
            if self.state is not None and clock.monotonic() - self._checked >= CHECKPOINT:
                self._checked = clock.monotonic()
                self._checkpoint(item)

    # -- inside -------------------------------------------------------------------------------------------------------
    def _recorded(self, one: Recording, item: _Item) -> None:
        """A disk that is full ends a recording, and nothing else."""
        assert item.done is not None
        try:
            one.append(item.done)
        except OSError as error:
            self._records.remove(one)
            text = f"{one.path}: {error.strerror or error}"
            self._say([self._watch.once("not recorded", item.number, item.time, text)])

    def _checkpoint(self, item: _Item) -> None:
        """Write the state; where that fails it is said once, and tried again."""
        assert self.state is not None
        self._counted()
        try:
            self._state().write(self.state)
            self._unkept = False
        except InputError as error:
            if not self._unkept:
                self._say([self._watch.once("state not written", item.number, item.time, str(error))])
            self._unkept = True

    def _pairs(self) -> Iterator[tuple[Any, DepthMap | None]]:
        """Frames with their depth maps; a camera that is gone is opened again."""
        while not self._stopped.is_set():
            try:
                for frame in each(self._source):
                    yield frame, None if self._depths is None else next(self._depths)
                return
            except InputError as error:
                origin = self._source.origin if isinstance(self._source, Frames) else None
                if origin is None:
                    raise
                yield UnusableFrame(error.what, where=error.where, hint=error.hint), None
            while not self._stopped.wait(AGAIN):
                try:
                    self._source = frames(origin)
                    break
                except InputError as error:
                    log.debug("still gone: %s", error)

    def _stamp(self, number: int) -> float:
        if self._rate is not None:
            return (number - 1) / self._rate
        stamp = None if self._live or not isinstance(self._source, Frames) else self._source.time
        return clock.time() if stamp is None else stamp

    def _pictured(self, frame: Any) -> bool:
        return frame is not None and is_image(np.asarray(frame), len(self.sensor.markers))

    def _zeroed(self, item: _Item, y: ArrayLike) -> None:
        """Follow the rest of the pad."""
        if self._asked.is_set():
            self._asked.clear()
            now, offset = np.asarray(y), self.sensor.offset
            offset[: len(now)] = np.where(np.isfinite(now), now, offset[: len(now)])
            self.sensor.offset = offset
            self._rest.anchored()
            self._watch.settled()
        step = self._rest.update(item.number, item.time, np.asarray(y), hidden="covered" in self._watch.on)
        if step is None:
            return
        self.counts["zeros"] += 1
        self._watch.settled()
        if step.told:
            text = f"zero moved by {1e6 * step.size:.3g} um rms, where noise explains {1e6 * step.expected:.2g} um"
            self._say([self._watch.once("zeroed", step.number, step.time, text)])

    def _say(self, events: list[LiveEvent]) -> None:
        self._said += events
        if self._told is not None:
            for event in events:
                self._told(event)

    def _counted(self) -> None:
        dropped, unrecorded = self._dropped_before
        self.counts["dropped"] = dropped + sum(self._queues[n].dropped for n in ("capture", "track", "map"))
        self.counts["unrecorded"] = unrecorded + self._queues["keep"].dropped

    def _state(self) -> Any:
        return state_of(self.sensor, self._number, self.counts, self._rest.anchor, self._slip.kept())


def _opened(camera: Any) -> Iterable[Any]:
    """Frames of a source; an iterable of images or motions as it is."""
    if isinstance(camera, Frames):
        return camera
    plain = isinstance(camera, Iterable) and not isinstance(camera, str | Path | np.ndarray)
    return camera if plain and type(camera).__module__.partition(".")[0] != "cv2" else frames(camera)


def _listed(record: str | Path | Sequence[str | Path]) -> Sequence[str | Path]:
    return [record] if isinstance(record, str | Path) else record


def _latency(marks: Sequence[float]) -> Latency:
    return Latency(*map(float, np.diff(marks)))
