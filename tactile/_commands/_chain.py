"""From an input and a pad file to the force maps of its frames; what they say on the terminal, and what is written."""

from __future__ import annotations

import hashlib
import itertools
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from loadid._families.frozen import Calibration
from loadid._plots import rendered
from loadid._results.summary import sort
from loadid.codes import GUARDS, collect
from structures._flags import Flag
from structures.errors import InputError
from structures.files._storage import replace as write

from .. import _guards as guards
from .._arrays import Array, UnusableFrame
from .._pad import padfile
from .._pad.pad import Pad
from .._pad.tolerances import Tolerances
from .._results.film import FPS, encoded, pictures, require_video
from .._results.forcemap import ForceMap, record
from .._results.pictures import sequence_figure
from .._results.report import HOW, numbers, page
from .._sensors.gelslim import GelSlim
from .._sensors.learned import LearnedSensor
from .._sensors.marked import FEWEST, ContactLaw
from .._sensors.multilayer import MultilayerPad
from .._sensors.posing import RULES, chosen
from .._sensors.prior import penalty
from ._sources import DepthMaps, MarkerSource, depth_maps, look

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


STRONGEST = 3  # frames on which lambda is chosen
HALF = 0.5  # of the largest motion, that a frame must show to be asked
SEARCHED = 30  # strongest frames among which whole ones are looked for
DEFAULT = ", by default,"


@dataclass(frozen=True)
class Reconstruction:
    """Force maps (frames, 3 P) of an input, and how they came about.

    Markers `lost` in each frame; lambda with its rule, and where the normal motion comes from, in words; frames a
    second from image (or motion) to map, the reading of files left out; frames, from 1, that were `skipped`, and why.
    """

    map: ForceMap
    pad: Pad
    source: MarkerSource
    lost: list[int]
    lam: str
    normal: str
    rate: float
    skipped: dict[int, str]

    @property
    def strongest(self) -> int:
        """Frame of the largest force, from 0."""
        return self.map.strongest


def reconstruct(
    source: str | Path,
    pad_file: str | Path,
    *,
    depth: str | Path | None = None,
    unloaded: str | None = None,
    sensor: str = "multilayer",
    friction: float | None = None,
    no_pull: bool = False,
    lam: float | str | None = None,
    learned: str | Path | None = None,
    frames: tuple[int, int] | None = None,
    rate: float | None = None,
    allow: Iterable[str] = (),
    progress: Callable[[float, str], None] | None = None,
) -> Reconstruction:
    """Force maps of images (folder, NPY or NPZ stack, video) or marker motions (CSV, NPY), by the command's options.

    `unloaded` is the number of frames that the source begins with, or a path, of the unloaded pad; `friction`,
    `no_pull` and `lam` override those of the pad file; a `learned` map answers where it knows frames like these; of
    `frames` (first, last), from 1 and both included, all are tracked up to the last; with a `rate` (Hz) the axis is
    time; ``progress(fraction, text)`` is called.
    """
    tell = progress or (lambda fraction, text: None)
    settings = padfile.read(pad_file)
    codes = tuple(c.upper().removeprefix("LID-") for c in allow)
    tell(0.02, "building the pad")
    pad = Pad.from_settings(settings, allow=[c for c in codes if c[1:2] == "1"])
    tell(0.05, "finding markers")
    seen = look(Path(source), settings, pad, unloaded, codes)
    maps = None if depth is None else depth_maps(Path(depth), settings.depth, settings.path).zeroed(seen.inside)
    contact = {**settings.contact, **({"no_pull": True} if no_pull else {})}
    contact |= {name: v for name, v in (("friction", friction), ("lam", lam)) if v is not None}
    if pad.surface.cells.shape[1] != 4:
        raise InputError("the surface of this mesh is of triangles", where=f"{settings.path}: [pad] mesh",
                         found=repr(pad), expected="quadrilaterals",
                         hint='pitch = "1 mm" rebuilds the body from bricks')  # fmt: skip
    built, fixed = _sensor(sensor, pad, seen, maps, contact, codes, settings.tolerances)
    tracked = _tracked(seen, maps, frames, tell)
    words = "no lambda: F = K U is a product"
    if sensor == "multilayer":
        tell(0.45, "choosing lambda")
        words = f"{fixed:g}, as stated" if fixed is not None else _choose(built, tracked, maps, seen.noise_source.text)
    if learned is not None:
        built = _taught(built, learned)
        words = f"none, by {built!r}; of the physics, where frames are strange: {words}"
    found = _inverted(built, pad, seen, tracked, maps, words, rate, tell)
    return _traced(found, [Path(p) for p in (settings.path, source, depth, learned) if p is not None])


# -- steps ------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Tracked:
    """Motion of the frames to invert, with their numbers from 0, and the flags of each; frames left out, and why."""

    numbers: list[int]
    motions: list[Array]
    flags: list[list[Flag | None]]
    seconds: float
    read: int
    skipped: dict[int, UnusableFrame]


def _sensor(
    name: str,
    pad: Pad,
    seen: MarkerSource,
    maps: DepthMaps | None,
    contact: dict[str, Any],
    codes: tuple[str, ...],
    tolerances: Tolerances,
) -> tuple[Any, float | None]:
    """The sensor, and lambda where it is stated as a number."""
    given: dict[str, Any] = {
        "markers": seen.markers, "contact": ContactLaw(contact.get("no_pull", False), contact.get("friction")),
        "depth": None if maps is None else maps[0], "allow": [c for c in codes if c in GUARDS],
    }  # fmt: skip
    if name == "gelslim":
        ignored = [key for key in ("lam", "penalty") if key in contact]
        if ignored:
            raise InputError("F = K U has no lambda and no penalty", where="--sensor gelslim", found=", ".join(ignored),
                             expected="neither", hint="leave them out, or take --sensor multilayer")  # fmt: skip
        return GelSlim(pad, **given), None
    choice = contact.get("lam")
    fixed = None if choice is None or isinstance(choice, str) else float(choice)
    built = MultilayerPad(
        pad, choice=choice if fixed is None else fixed, penalty=penalty(contact), tolerances=tolerances, **given,
    )  # fmt: skip
    return built, fixed


def _taught(built: Any, learned: str | Path) -> LearnedSensor:
    """The sensor with a learned map."""
    if not isinstance(built, MultilayerPad):
        raise InputError("a learned map goes with the multilayer sensor", where="--map", found=built.name,
                         expected="--sensor multilayer")  # fmt: skip
    return LearnedSensor.read(learned, built)


def _tracked(
    seen: MarkerSource, maps: DepthMaps | None, wanted: tuple[int, int] | None, tell: Callable[[float, str], None]
) -> _Tracked:
    """Motion of all frames that are asked for."""
    first, last = wanted or (1, seen.count or 10**9)
    numbers, motions, flags, seconds = [], [], [], 0.0
    read, skipped = 0, {}
    for k, frame in enumerate(seen.frames):
        if k + 1 > last:
            break
        read += 1
        if maps is not None and k >= len(maps):
            raise InputError("there are fewer depth maps than frames", where=maps.name, found=len(maps),
                             expected=f"one per frame, also of the unloaded ones: at least {k + 1}")  # fmt: skip
        depth = None if maps is None else maps[k]
        start = time.perf_counter()
        try:
            motion, found = _motion(seen, frame, depth)
        except UnusableFrame as error:
            skipped.update({k + 1: error} if k + 1 >= first else {})
            continue
        seconds += time.perf_counter() - start
        if k + 1 >= first:
            numbers.append(k)
            motions.append(motion)
            flags.append(list(found))
        tell(0.1 + 0.35 * min(1.0, (k + 1) / (seen.count or k + 2)), f"tracking frame {k + 1}")
    if maps is not None and seen.count is not None and len(maps) != seen.count:
        raise InputError("there is not one depth map per frame", where=maps.name, found=len(maps),
                         expected=f"{seen.count}, the unloaded frames included")  # fmt: skip
    if skipped and not numbers:
        raise next(iter(skipped.values()))
    if not numbers:
        raise InputError("there are no such frames", where="--frames", found=f"{first}:{last}",
                         expected=f"frames from 1 to {read}")  # fmt: skip
    return _Tracked(numbers, motions, flags, seconds, read, skipped)


def _motion(seen: MarkerSource, frame: Any, depth: Any) -> tuple[Array, list[Flag | None]]:
    """Motion of the markers in a frame that shows enough of them to make a map."""
    if isinstance(frame, UnusableFrame):
        raise frame
    motion, found = seen.read(frame, depth)
    left = int(np.isfinite(motion).all(axis=1).sum())
    if left < FEWEST:
        raise UnusableFrame(f"{left or 'no'} marker{'s' * (left != 1)} found")
    return motion, found


def _choose(built: Any, tracked: _Tracked, maps: DepthMaps | None, source: str) -> str:
    """Lambda on the strongest frames together, frozen, in words; where no rule is set, as the sensors choose it."""
    readings, used = _strongest(built, tracked, maps)
    family, ruled = built.family, built.family.choice
    if built.problem is not None:
        choice = built.choice_on(readings)
        rule, lam = choice.rule, float(choice.lam)
    else:
        family.choice = ruled or RULES[0]
        found = family.estimate(readings)
        family.choice = ruled
        choice = found.choice
        rule = choice.rule if ruled else chosen(choice, np.size(found.response))
        lam = float(choice.lam if ruled else next(r.lam for r in choice.rules if r.rule == rule))
    family.calibration = Calibration(
        lam=lam, rule=rule, records=(used,), alone=(lam,), spread=0.0, verdict=choice.verdict,
        sigma_source=source, date=datetime.now(UTC).isoformat(timespec="seconds"),
    )  # fmt: skip
    return f"{lam:.3g} by {rule}{'' if ruled else DEFAULT} on {used}; {choice.verdict}"


def _strongest(built: Any, tracked: _Tracked, maps: DepthMaps | None) -> tuple[Any, str]:
    """Readings of the strongest frames in which everything is seen, or of the strongest one; and which they are."""
    strength = [float(np.sqrt(np.nanmean(m**2))) if np.isfinite(m).any() else 0.0 for m in tracked.motions]
    order = [int(i) for i in np.argsort(strength)[::-1] if strength[i] >= HALF * max(strength)]
    read: Callable[[int], Array] = lambda i: built.readings(  # noqa: E731
        tracked.motions[i], None if maps is None else maps[tracked.numbers[i]]
    )
    whole = ((i, y) for i in order[:SEARCHED] for y in [read(i)] if np.all(np.isfinite(y)))
    chosen = list(itertools.islice(whole, STRONGEST))
    if chosen:
        names = ", ".join(str(k) for k in sorted(tracked.numbers[i] + 1 for i, _ in chosen))
        return np.array([y for _, y in chosen]), f"the strongest whole frames ({names})"
    labels = [s.label for s in built.model.sensors]  # in no frame is every marker seen: one speaks with what it has
    y = read(order[0])
    if built.problem is not None:
        return y, f"frame {tracked.numbers[order[0]] + 1}"
    seen = {name: float(v) for name, v in zip(labels, y, strict=True) if np.isfinite(v)}
    return seen, f"frame {tracked.numbers[order[0]] + 1}"


def _inverted(
    built: Any, pad: Pad, seen: MarkerSource, tracked: _Tracked, maps: DepthMaps | None, words: str, rate: float | None,
    tell: Callable[[float, str], None],
) -> Reconstruction:  # fmt: skip
    """Maps of all frames as one result."""
    found, seconds = _maps(built, tracked, maps, tell)
    times = None if rate is None else np.array(tracked.numbers) / rate
    whole = record(found, numbers=[k + 1 for k in tracked.numbers], times=times)
    largest = whole.frame(int(np.argmax(np.abs(whole.load).max(axis=1))))
    strained = pad.strained(largest.forces())  # solved for: that of the single frames is read off earlier ones
    others = [flag for flag in whole.flags if flag.code != "LID-W112"]
    whole = replace(whole, flags=collect([*others, strained, *seen.flags, _gap(tracked.skipped)]))
    lost = [int(np.isnan(m[:, 0]).sum()) for m in tracked.motions]
    each = tracked.seconds / tracked.read + seconds / len(found)
    return Reconstruction(whole, pad, seen, lost, words, whole.provided["z"], 1 / max(each, 1e-9),
                          {k: error.what for k, error in tracked.skipped.items()})  # fmt: skip


def _gap(skipped: dict[int, UnusableFrame]) -> Flag | None:
    """W604 of the frames left out."""
    return guards.skipped(list(skipped), next(iter(skipped.values())).what) if skipped else None


def _maps(
    built: Any, tracked: _Tracked, maps: DepthMaps | None, tell: Callable[[float, str], None]
) -> tuple[list[ForceMap], float]:
    """Map of every frame, and the seconds that they took; what the first of them prepares is left out."""
    found, seconds = [], 0.0
    for i, (k, motion) in enumerate(zip(tracked.numbers, tracked.motions, strict=True)):
        depth = None if maps is None else maps[k]
        if i == 0:
            built.estimate(motion, depth)
        start = time.perf_counter()
        one = built.estimate(motion, depth)
        seconds += time.perf_counter() - start
        flags = collect([*one.flags, *tracked.flags[i]])
        found.append(replace(one, flags=flags, posterior=None, diagnosis=None))
        tell(0.7 + 0.25 * (i + 1) / len(tracked.numbers), f"map of frame {k + 1}")
    return found, seconds


def _traced(found: Reconstruction, paths: list[Path]) -> Reconstruction:
    """The same with the digests of what was read and how the maps came about in their provenance."""
    inputs = {str(path): _digest(path) for path in paths}
    notes = [f"{name}: {said}" for name, said in about(found)]
    whole = replace(found.map, provenance={**found.map.provenance, "inputs": inputs, "notes": notes})
    return replace(found, map=whole)


def _digest(path: Path) -> str:
    """sha256 of a file, or of the files of a folder in the order of their names."""
    digest = hashlib.sha256()
    for file in sorted(p for p in path.iterdir() if p.is_file()) if path.is_dir() else [path]:
        with file.open("rb") as content:
            while block := content.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


# -- what it says, and what is written --------------------------------------------------------------------------------
def about(found: Reconstruction) -> list[tuple[str, str]]:
    """How the maps came about: names and texts."""
    seen = found.source
    return [
        ("pad", f"{str(found.pad)[4:-1]}, {found.pad.points} nodes"),
        ("reference", seen.reference),
        ("markers", markers(found)),
        *((("left out", left_out(found)),) if found.skipped else ()),
        ("noise of a marker", seen.noise_words),
        ("normal motion", HOW[found.normal]),
        ("lambda", found.lam),
        ("speed", f"{found.rate:.3g} frames a second, from image to map, on this machine"),
        *(("note", note) for note in seen.notes),
    ]


def markers(found: Reconstruction) -> str:
    """How many markers there are, and how many were lost."""
    total, most = len(found.source.markers), max(found.lost)
    if most == 0:
        return f"{total} found, none lost in {len(found.lost)} frames"
    assert found.map.axis is not None
    frame = found.lost.index(most)
    mean = sum(found.lost) / len(found.lost)
    return f"{total} found; lost: {mean:.3g} on average, {most} at most ({found.map.frame_name(frame)})"


def left_out(found: Reconstruction) -> str:
    """Frames that told nothing, each reason once."""
    reasons: dict[str, list[str]] = {}
    for number, why in found.skipped.items():
        reasons.setdefault(why, []).append(str(number))
    told = "; ".join(f"{', '.join(numbers)} ({why})" for why, numbers in reasons.items())
    return f"{len(found.skipped)} of {len(found.skipped) + len(found.lost)} frames: {told}"


def text(found: Reconstruction) -> str:
    """All that a user must know, as lines."""
    rows = about(found)
    strongest = found.map.frame(found.strongest)
    width = max(len(name) for name, _ in rows)
    lines = [f"{name:{width}s}  {said}" for name, said in rows]
    lines.append(f"strongest of {len(found.map.load)} frames ({found.map.frame_name(found.strongest)}):")
    lines += [f"  {name:{width - 2}s}  {value}  [{remark}]" for name, value, remark in numbers(strongest)]
    lines.append(f"flags: {len(found.map.flags) or 'none'}")
    lines += [f"  {flag.command}" for flag in sort(found.map.flags)]
    return "\n".join(lines)


def data(found: Reconstruction) -> dict[str, Any]:
    """The same as numbers, for JSON."""
    force, one = found.map, found.map.frame(found.strongest)
    assert force.axis is not None
    resultant, torque, contact = one.resultant(), one.torque(), one.contact()
    return {
        "pad": repr(found.pad),
        "nodes": found.pad.points,
        "frames": len(force.load),
        "axis": {"name": force.axis.name, "unit": force.axis.unit, "values": force.axis.values},
        "reference": found.source.reference,
        "markers": len(found.source.markers),
        "lost": found.lost,
        "skipped": [{"frame": k, "why": why} for k, why in found.skipped.items()],
        "noise": found.source.noise_words,
        "provided": dict(force.provided),
        "lambda": force.facts.lam,
        "lambda_words": found.lam,
        "frames_per_second": found.rate,
        "resultants": force.resultant().value,
        "strongest": {
            "frame": force.axis.values[found.strongest],
            "force": resultant.value, "force_std": resultant.std,
            "torque": torque.value, "torque_std": torque.std,
            "peak_pressure": contact.peak, "contact_radius": contact.radius, "contact_area": contact.area,
            "centre": contact.centre,
            "contacts": [
                {"force": c.force.value, "force_std": c.force.std, "centre": c.centre, "area": c.area}
                for c in one.contacts()
            ],
        },
        "flags": [flag.to_dict() for flag in sort(force.flags)],
        "notes": found.source.notes,
    }  # fmt: skip


def write_all(
    found: Reconstruction,
    result: str | Path,
    *,
    report: str | Path | None = None,
    plot: str | Path | None = None,
    video: str | Path | None = None,
    truth: ArrayLike | None = None,
    wrenches: ArrayLike | None = None,
    compared: Iterable[tuple[str, ...]] = (),
    fps: float | None = None,
    progress: Any = None,
) -> list[str]:
    """Write the result file and, where named, the report, the picture and the video; the paths written.

    Report, picture and video are made before the first file is written, so that a fault in them leaves nothing behind.
    Known tractions (frames, P, 3) in Pa and wrenches (frames, 6) are drawn with them.
    """
    ready = []
    if report is not None:
        text = page(found.map, truth=truth, wrenches=wrenches, about=about(found), compared=compared)
        ready.append((Path(report), text.encode()))
    if plot is not None:
        ready.append((Path(plot), rendered(sequence_figure(found.map, truth=truth, wrenches=wrenches), plot)))
    if video is not None:
        coming = pictures(found.map, truth=truth, progress=progress)
        ready.append((Path(video), encoded(coming, require_video(video), fps=fps or FPS, where=str(video))[0]))
    found.map.save(result)
    for path, content in ready:
        write(path, content)
    return [str(path) for path in (result, report, plot, video) if path is not None]
