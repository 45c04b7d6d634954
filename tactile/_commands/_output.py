"""What a reconstruction says on the terminal, and everything that it writes."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loadid._plots import rendered
from loadid._results.summary import sort
from structures.files._storage import replace

from .._results.report import HOW, numbers, page

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ._chain import Reconstruction


def about(found: Reconstruction) -> list[tuple[str, str]]:
    """How the maps came about: names and texts."""
    seen = found.source
    return [
        ("pad", f"{str(found.pad)[4:-1]}, {found.pad.points} nodes"),
        ("reference", seen.reference),
        ("markers", markers(found)),
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
        from .._results.pictures import sequence_figure

        ready.append((Path(plot), rendered(sequence_figure(found.map, truth=truth, wrenches=wrenches), plot)))
    if video is not None:
        from .._results.film import FPS, encoded, pictures, require_video

        coming = pictures(found.map, truth=truth, progress=progress)
        ready.append((Path(video), encoded(coming, require_video(video), fps=fps or FPS, where=str(video))[0]))
    found.map.save(result)
    for path, content in ready:
        replace(path, content)
    return [str(path) for path in (result, report, plot, video) if path is not None]
