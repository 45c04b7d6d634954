"""Everything that a reconstruction writes: made first, written after, each file whole or not at all."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ._chain import Reconstruction


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

    Parameters
    ----------
    truth : array (frames, P, 3), optional
        Known tractions (Pa).
    wrenches : array (frames, 6), optional
        Known force and torque.
    """
    from structures.storage import replace

    ready = []
    if report is not None:
        from ..report import page
        from ._words import about

        text = page(found.map, truth=truth, wrenches=wrenches, about=about(found), compared=compared)
        ready.append((Path(report), text.encode()))
    if plot is not None:
        from loadid.plots import rendered

        from ..plots.maps import sequence_figure

        ready.append((Path(plot), rendered(sequence_figure(found.map, truth=truth, wrenches=wrenches), plot)))
    if video is not None:
        from ..plots.film import pictures
        from ..video import FPS, encoded, require_video

        coming = pictures(found.map, truth=truth, progress=progress)
        ready.append((Path(video), encoded(coming, require_video(video), fps=fps or FPS, where=str(video))[0]))
    found.map.save(result)
    for path, content in ready:
        replace(path, content)
    return [str(path) for path in (result, report, plot, video) if path is not None]
