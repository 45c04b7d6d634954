"""Images that slipped: how many are found, how many are said that did not, and what is left in the force.

``python -m tests.benchmarks.slips [presses] [frames] [seed]``. Presses on gels of other finite elements
(`tests.campaigns.gels`), and the gel at rest, each seen in so many frames with noise of their own: still, and shifted
by a quarter of a pixel (of 70 um) to one, any way, every second one turned and stretched too. A sensor reads them as a
stream does (`follow`), two of every ten as single frames (`estimate`).

Columns: frames; shifted ones that raise W611; still ones that do; single frames of presses, and of their force what the
shift leaves: the difference to the same frame without it, over full scale (the largest normal force of the presses),
share up to 2 %, 99 % and median; median of single frames at rest, where loads may be anywhere, and of a stream; median
where the sensor knows no motion of the image.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from structures._threads import one_thread
from tactile import ForceMap
from tests.campaigns.gels import GELS, IMAGE, Case, cases
from tests.campaigns.tactile import SETUPS, User, at_rest, pad_of

KINDS = ("in the plane", "and depth", "all axes")
LEFT = 0.02  # of full scale
CHOICE = 0.05  # lambda
SINGLE, AFTER = 2, 10  # frames that are read by themselves too, of so many


@dataclass(frozen=True)
class Slip:
    """One frame, still and shifted: whether W611 came of either, and what the shift leaves in the force (N).

    `single` is the latter of `estimate`, `without` of a sensor that knows no motion; None where they were not asked.
    """

    pressed: bool
    false: bool
    found: bool
    left: float
    single: float | None = None
    without: float | None = None


def said(found: ForceMap) -> bool:
    """Whether the image is said to have moved."""
    return any(f.code.endswith("W611") for f in found.flags)


def motion(rng: np.random.Generator, points: np.ndarray, also_turned: bool) -> np.ndarray:
    """Of all markers (N, 3) by a camera that slipped."""
    way, size = rng.uniform(0, 2 * np.pi), rng.uniform(0.25, 1) * IMAGE
    out = np.zeros((len(points), 3))
    out[:, :2] = size * np.array([np.cos(way), np.sin(way)])
    if also_turned:
        turn, stretch = rng.uniform(-1, 1, 2) * IMAGE / float(np.hypot(*points.T).max())
        out[:, :2] += turn * np.column_stack([-points[:, 1], points[:, 0]]) + stretch * points
    return out


def slips(user: User, presses: list[Case], frames: int, seed: int) -> Iterator[Slip]:
    """Frames of presses, and of the gel at rest, by one sensor."""
    rng = np.random.default_rng([seed, 611])
    sensor, fixed = user.sensor(choice=CHOICE), user.sensor(choice=CHOICE, image=None)
    rest = replace(at_rest(rng, presses[0]), exact=np.zeros_like(presses[0].exact))
    for case in [*presses, rest]:
        for k in range(frames):
            still = case.exact + case.noise * rng.standard_normal(case.exact.shape)
            moved = still + motion(rng, case.points, k % 2 == 1)
            seen = user.seen(case, still), user.seen(case, moved)
            a, b = (sensor.follow(*frame) for frame in seen)
            single = without = None
            if k % AFTER < SINGLE:
                single = apart(*(sensor.estimate(*frame) for frame in seen))
                without = apart(*(fixed.follow(*frame) for frame in seen))
            yield Slip(case is not rest, said(a), said(b), apart(a, b), single, without)


def apart(one: ForceMap, other: ForceMap) -> float:
    """Distance between two forces (N)."""
    return float(np.linalg.norm(one.resultant().value - other.resultant().value))


def line(name: str, found: list[Slip], full: float) -> str:
    """One row; `full` scale in N."""
    single, still = (
        np.array([s.single for s in found if s.single is not None and s.pressed is pressed]) / full
        for pressed in (True, False)
    )
    without = np.array([s.without for s in found if s.without is not None]) / full
    return (
        f"{name:28s} {len(found):6d} {np.mean([s.found for s in found]):6.1%} {np.mean([s.false for s in found]):6.1%} "
        f"{len(single):6d} {np.mean(single <= LEFT):6.1%} {np.quantile(single, 0.99):6.2%} {np.median(single):7.2%} "
        f"{np.median(still):7.1%} {np.median([s.left for s in found]) / full:7.1%} {np.median(without):7.0%}"
    )


@one_thread()
def main(presses: int = 5, frames: int = 20, seed: int = 1) -> None:
    """Print the table."""
    print(f"{'':28s} {'frames':>6s} {'found':>6s} {'false':>6s} {'single':>6s} {'<= 2 %':>6s} {'99 %':>6s} "
          f"{'median':>7s} {'at rest':>7s} {'stream':>7s} {'without':>7s}")  # fmt: skip
    every: dict[str, list[Slip]] = {kind: [] for kind in KINDS}
    for which, (nu, noise) in enumerate(SETUPS):
        drawn = list(cases(presses, 10 * seed + which, gel=GELS[0], nu=nu, noise=noise))
        full = max(abs(c.force[2]) for c in drawn)
        for kind in KINDS:
            found = list(slips(User(kind, pad_of(drawn[0], "none"), drawn[0], {}), drawn, frames, seed))
            print(line(f"{kind}, nu {nu}, {1e6 * noise:.0f} um", found, full), flush=True)
            every[kind] += [scaled(s, 1 / full) for s in found]
    for kind, found in every.items():
        print(line(kind, found, 1.0))


def scaled(slip: Slip, by: float) -> Slip:
    """The same with forces in another unit."""
    more = {name: value * by for name in ("single", "without") if (value := getattr(slip, name)) is not None}
    return replace(slip, left=slip.left * by, **more)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
