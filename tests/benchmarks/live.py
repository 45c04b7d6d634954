"""A live sensor: maps a second, latency of every stage, and a long run. ``python -m tests.benchmarks.live``.

    --frames 1200        640 x 480 images of 520 markers, a pad with 42 x 42 cells (1849 nodes, 5547 unknowns): as fast
                         as they go, then at 60 a second as a camera gives them, which does not wait
    --rate 60            of that camera
    --long 216000        an hour at 60 a second, 1 % of them black, as fast as they go (--real: at the rate): maps lost,
                         growth of memory after the first tenth
    --record             into an HDF5 file too
    --only cost|speed|long

Printed beside it: the same images one after another through `MultilayerPad.stream`, which is what one would write
without it. BLAS threads as they are set: OPENBLAS_NUM_THREADS=1 suits a machine with two cores.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactile import MultilayerPad
from tactile.live import Live

from .tactile_rate import rig

PRESSES, QUIET = 24, 8  # images of presses, and of the unloaded pad between them
BLACK = 100  # every so many frames is black, in the long run


def resident() -> float:
    """MB of this process in memory."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


def built(elements: int) -> tuple[MultilayerPad, list[Any]]:
    """A sensor, and the images that its camera repeats: the unloaded pad, a press that slides, and back again."""
    from tactile.vision._images import Scene, grid

    r = rig(elements, PRESSES)
    sensor = MultilayerPad(r.pad, eye=r.eye, choice=0.02)
    sensor.inverse  # noqa: B018  (built before it is timed)
    markers, scene = grid(20, 26, 0.9e-3), Scene(radius=0.22e-3, blur=1.0, noise=2.0)
    flat = np.column_stack([markers, np.zeros(len(markers))])
    still = [scene.photograph(r.eye.view, flat, seed=500 + k) for k in range(QUIET)]
    return sensor, [*still, *r.images, *r.images[::-1]]


def camera(images: Sequence[Any], count: int, rate: float | None, black: int | None = None) -> Iterator[Any]:
    """Frames again and again, at a rate, or as fast as they are taken; every so many of them black."""
    begun = time.perf_counter()
    dark = np.zeros_like(images[0])
    for k, image in enumerate(itertools.islice(itertools.cycle(images), count)):
        if rate is not None:
            time.sleep(max(begun + k / rate - time.perf_counter(), 0.0))
        yield dark if black is not None and k % black == black - 1 else image


def shown(live: Live, frames: int, wall: float, cpu: float, word: str) -> None:
    """Rates, and what the stages took."""
    print(f"{word}: {frames / wall:.1f} maps/s, {1e3 * cpu / frames:.1f} CPU ms a map; {dict(live.counts)}")
    for share in (0.5, 0.99):
        found = live.latency(share)
        parts = ", ".join(f"{name} {1e3 * value:.1f}" for name, value in vars(found).items())
        ages = live.ages(share)
        print(f"  p{100 * share:.0f} ms: {parts}; whole {1e3 * ages:.1f}", flush=True)


def cost(elements: int) -> None:
    """CPU milliseconds of every part of a frame, at rest and touched: the least of five rounds of twelve."""
    from tactile.live import Recording, message, point_cloud
    from tactile.live._events import EventWatch
    from tactile.live._frame import LiveFrame
    from tactile.live._messages import line
    from tactile.live._slip import SlipWatch
    from tactile.live._state import state_of
    from tactile.live._viewer import _Drawn
    from tactile.live._zero import Rest

    sensor, images = built(elements)
    eye = sensor.eye
    assert eye is not None
    detector = eye.tracker.detector
    assert detector is not None
    for word, many in (("at rest", QUIET), ("touched", QUIET + PRESSES)):
        motions = [eye.read(image)[0] for image in images[:many]]
        image, motion = images[many - 1], motions[-1]
        y, none = sensor.markers.readings(motion), np.zeros(len(motion), bool)
        rest, watch, slip, found = (
            Rest(sensor, 3.0),
            EventWatch(sensor.markers.points),
            SlipWatch(),
            sensor.follow(motion),
        )
        frame = LiveFrame(1, 0.0, found, motion, True)
        drawn, number = _Drawn(found), itertools.count()
        with tempfile.TemporaryDirectory() as folder:
            hdf5, mcap = (Recording(Path(folder) / f"a{kind}") for kind in (".h5", ".mcap"))
            state = state_of(sensor, 1, {}, rest.anchor, slip.kept())
            parts = {
                "dots found": lambda: detector(image),  # noqa: B023
                "dots found and followed": lambda: eye.tracker.step(image),  # noqa: B023
                "image to motion": lambda: eye.read(image),  # noqa: B023
                "motion to map": lambda: sensor.follow(motion),  # noqa: B023
                "zero": lambda: rest.update(0, next(number) / 60, y),  # noqa: B023
                "slip": lambda: slip.update(next(number) / 60, found, found.contact()),  # noqa: B023
                "events": lambda: watch.seen(1, 0.0, image, none, None, False),  # noqa: B023
                "line of JSON": lambda: line(frame),  # noqa: B023
                "picture of the page": lambda: {**message(frame), **drawn.picture(frame)},  # noqa: B023
                "point cloud": lambda: point_cloud(found),  # noqa: B023
                "HDF5": lambda: hdf5.append(frame),  # noqa: B023
                "MCAP": lambda: mcap.append(frame),  # noqa: B023
                "state, every 5 s": lambda: state.write(Path(folder) / "s.h5"),  # noqa: B023
            }
            print(f"CPU ms {word}: " + ", ".join(f"{name} {_least(work):.2f}" for name, work in parts.items()))
            hdf5.close()
            mcap.close()


def _least(work: Callable[[], Any], rounds: int = 5, calls: int = 12) -> float:
    work()
    found = []
    for _ in range(rounds):
        start = time.process_time()
        for _ in range(calls):
            work()
        found.append(1e3 * (time.process_time() - start) / calls)
    return min(found)


def speed(elements: int, frames: int, rate: float, record: bool) -> None:
    """As fast as it goes, at a rate, and one after another."""
    sensor, images = built(elements)
    for _ in sensor.stream(camera(images, len(images), None)):
        pass
    start, cpu, count = time.perf_counter(), time.process_time(), 0
    for count, _ in enumerate(sensor.stream(camera(images, frames // 3, None)), 1):  # noqa: B007
        pass
    wall = time.perf_counter() - start
    print(f"one after another: {count / wall:.1f} maps/s, {1e3 * (time.process_time() - cpu) / count:.1f} CPU ms a map")
    with tempfile.TemporaryDirectory() as folder:
        where = [Path(folder) / "run.h5"] if record else []
        for word, given in (("as fast as it goes", None), (f"a camera at {rate:g}/s", rate)):
            live = Live(sensor, camera(images, frames, given), rate=rate, drop=given is not None, record=where)
            start, cpu, count = time.perf_counter(), time.process_time(), 0
            for count, _ in enumerate(live, 1):  # noqa: B007
                pass
            shown(live, count, time.perf_counter() - start, time.process_time() - cpu, word)


def long(elements: int, frames: int, rate: float, real: bool, record: bool) -> None:
    """Maps that were lost of an hour, and how the memory grows."""
    sensor, images = built(elements)
    with tempfile.TemporaryDirectory() as folder:
        where = [Path(folder) / "run.h5"] if record else []
        source = camera(images, frames, rate if real else None, BLACK)
        live = Live(sensor, source, rate=rate, drop=False, state=Path(folder) / "state.h5", record=where)
        start, cpu, count, first = time.perf_counter(), time.process_time(), 0, 0.0
        most = 0.0
        for count, _ in enumerate(live, 1):
            if count == frames // 10:
                first = resident()
            elif count > frames // 10 and count % 1000 == 0:
                most = max(most, resident() - first)
            if count % (frames // 10) == 0:
                print(f"  {count} maps, {resident():.1f} MB, {time.perf_counter() - start:.0f} s", flush=True)
        shown(live, count, time.perf_counter() - start, time.process_time() - cpu, f"{frames} frames")
    black = frames // BLACK
    print(f"  {black} black, {frames - black - count} maps lost; memory {first:.1f} MB, at most {most:+.1f} MB later, "
          f"{resident() - first:+.1f} MB at the end")  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--elements", type=int, default=42)
    parser.add_argument("--frames", type=int, default=1200)
    parser.add_argument("--rate", type=float, default=60.0)
    parser.add_argument("--long", type=int, default=216000)
    parser.add_argument("--real", action="store_true")
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--only", choices=("cost", "speed", "long"))
    given = parser.parse_args(arguments)
    if given.only in (None, "cost"):
        cost(given.elements)
    if given.only in (None, "speed"):
        speed(given.elements, given.frames, given.rate, given.record)
    if given.only in (None, "long"):
        long(given.elements, given.long, given.rate, given.real, given.record)


if __name__ == "__main__":
    main()
