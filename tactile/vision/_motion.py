"""Motion of the markers: in one frame, as somebody else tracked it, and the noise of its places."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loadid._readers.rows import whole
from loadid._readers.source import truncated
from structures._advice import Advice, Spelling
from structures._flags import Flag
from structures.errors import InputError, reals

from .._arrays import Array, Mask, shaped
from .._guards import frozen, missing_frames, vanished
from ._frames import missing_numbers, read_stack


@dataclass(frozen=True)
class MarkerMotion:
    """Motion of the markers in one frame.

    Parameters
    ----------
    points : array, shape (N, 2)
        Places of the markers at rest, px, x to the right and y down; NaN where the last `zero` did not see one.
    moved : array, shape (N, 2)
        Motion from rest, px; NaN where it is not known.
    lost : array of bool, shape (N,)
        No dot near its prediction, or no place at rest.
    rejected : array of bool, shape (N,)
        A dot was there, but it moved too far, or unlike the neighbours.
    unmatched : int
        Dots of the frame that are no marker's.
    frame : int
        Number of the frame, from 1.
    flags : tuple of Flag
    """

    points: Array
    moved: Array
    lost: Mask
    rejected: Mask
    unmatched: int = 0
    frame: int = 0
    flags: tuple[Flag, ...] = ()

    @classmethod
    def of(cls, points: Array, places: Array, frame: int) -> MarkerMotion:
        """Motion of markers that come told apart, to places (N, 2) in px; NaN where one is lost."""
        moved = places - points
        lost = np.asarray(np.isnan(moved).any(axis=1))
        gone = vanished(len(lost), int(lost.sum()), 0, 0)
        return cls(points, moved, lost, np.zeros_like(lost), 0, frame, () if gone is None else (gone,))

    @property
    def tracked(self) -> Mask:
        """Markers whose motion is known, shape (N,)."""
        return ~(self.lost | self.rejected)

    @property
    def places(self) -> Array:
        """Where the markers are now, px, shape (N, 2); NaN where not seen."""
        return self.points + self.moved


GENERIC = (("frame", "id", "x", "y"), ("frame", "id", "x", "y", "z"))
GSROBOTICS = 7  # columns: frame, row, col, Ox, Oy, Cx, Cy
FEWEST = 3


@dataclass(frozen=True)
class MarkerMotions:
    """Places of markers over many frames.

    Parameters
    ----------
    points : array, shape (N, 2)
        Places at rest, px (or m, as the file has them); NaN where not known.
    places : array, shape (T, N, 2)
        Places in every frame; NaN = lost.
    heights : array, shape (T, N), optional
        Third coordinate, where the file has one.
    numbers : tuple of int
        Number of each frame in the file.
    flags : tuple of Flag
        Frames missing; a last row that may be cut.
    notes : tuple of str
        What was decided in reading.
    """

    points: Array
    places: Array
    heights: Array | None = None
    numbers: tuple[int, ...] = ()
    flags: tuple[Flag, ...] = ()
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.places)

    @property
    def moved(self) -> Array:
        """Motion from rest, shape (T, N, 2); NaN = lost."""
        return self.places - self.points

    def __getitem__(self, k: int) -> MarkerMotion:
        return MarkerMotion.of(self.points, self.places[k], self.numbers[k] if self.numbers else k + 1)


def read_motions(source: str | Path | ArrayLike, *, rest: int = 0) -> MarkerMotions:
    """Marker motion of a file, or of an array.

    Parameters
    ----------
    source : path or array, shape (T, N, 2 or 3)
        CSV file as gsrobotics writes it (no header; ``frame,row,col,Ox,Oy,Cx,Cy``), CSV file with the header
        ``frame,id,x,y`` or ``frame,id,x,y,z``, NPY file, or an array. NaN and rows that are not there are lost.
    rest : int
        Frame (from 0) in which the pad is unloaded; gsrobotics files say it themselves.

    Raises
    ------
    InputError
        Not readable, no numbers, fewer than three markers, a marker twice in one frame.
    """
    if not isinstance(source, str | Path):
        return _from_array(reals(source, where="marker motion"), rest, "marker motion")
    path = Path(source)
    if not path.is_file():
        raise InputError("there is no such file", where=str(path))
    if path.suffix.lower() == ".npy":
        return _from_array(reals(read_stack(path), where=str(path)), rest, str(path))
    header, table, flags = _table(path)
    found = None
    if header in GENERIC and len(header) == table.shape[1]:
        found = _generic(table, rest, str(path))
    elif not header and table.shape[1] == GSROBOTICS:
        found = _gsrobotics(table, str(path))
    if found is not None:
        return replace(found, flags=(*flags, *found.flags))
    raise InputError(
        "no marker motion", where=str(path), found=",".join(header) or f"{table.shape[1]} columns without a header",
        expected="the header frame,id,x,y[,z], or seven columns frame,row,col,Ox,Oy,Cx,Cy without one",
    )  # fmt: skip


def _from_array(x: Array, rest: int, where: str) -> MarkerMotions:
    x = shaped(x, (None, None, 2), (None, None, 3), where=where, what="no marker motion", fewest=1, lost=True)
    x = np.where(np.isnan(x).any(axis=2, keepdims=True), np.nan, x)
    if not 0 <= rest < len(x):
        raise InputError("there is no such frame", where=where, found=f"rest={rest}", expected=f"0 to {len(x) - 1}")
    _enough(int(np.isfinite(x[rest, :, 0]).sum()), where)
    heights = x[..., 2] if x.shape[2] == 3 else None
    return MarkerMotions(x[rest, :, :2], x[..., :2], heights, tuple(range(1, len(x) + 1)))


def _generic(table: Array, rest: int, where: str) -> MarkerMotions:
    frame, marker = _whole(table[:, 0], "frame", where), _whole(table[:, 1], "id", where)
    numbers, k = np.unique(frame, return_inverse=True)
    ids, i = np.unique(marker, return_inverse=True)
    found = _from_array(_spread(k, i, table[:, 2:], where), rest, where)
    flags = (*_gaps(numbers, where), *_cut(frame))
    return replace(found, numbers=tuple(map(int, numbers)), flags=flags, notes=(f"{len(ids)} ids",))


def _gsrobotics(table: Array, where: str) -> MarkerMotions:
    frame, row, column = (_whole(table[:, k], name, where) for k, name in enumerate(("frame", "row", "col")))
    numbers, k = np.unique(frame, return_inverse=True)
    pairs, i = np.unique(np.column_stack([row, column]), axis=0, return_inverse=True)
    places = _spread(k, i.reshape(-1), table[:, 5:7], where)
    outside = (places < 0).any(axis=2)
    places[outside] = np.nan
    points = np.full((len(pairs), 2), np.nan)
    points[i.reshape(-1)] = table[:, 3:5]
    _enough(int(np.isfinite(points[:, 0]).sum()), where)
    notes = [
        "whole pixels: rounding alone is a noise of 0.29 px per axis",
        "dots out of view are inferred by that tracker and cannot be told from those that were seen",
    ]
    notes += [f"{int(outside.sum())} places left of or above the image are taken as lost"] if outside.any() else []
    flags = (*_gaps(numbers, where), *_cut(frame))
    return MarkerMotions(points, places, None, tuple(map(int, numbers)), flags, tuple(notes))


def _cut(frame: NDArray[np.int64]) -> tuple[Flag, ...]:
    """W209 where every frame has as many rows and only that at the end of the file has fewer."""
    rows = np.unique(frame, return_counts=True)[1]
    last = int(np.sum(frame == frame[-1]))
    if len(rows) < 3 or frame[-1] != frame.max() or len(set(rows[:-1].tolist())) > 1 or last >= rows[0]:
        return ()
    return (truncated(last, int(rows[0]), "rows of the last frame"),)


def _gaps(numbers: NDArray[Any], where: str) -> tuple[Flag, ...]:
    flag = missing_frames(missing_numbers([str(n) for n in numbers]), Path(where).name)
    return () if flag is None else (flag,)


def _spread(k: NDArray[Any], i: NDArray[Any], values: Array, where: str) -> Array:
    """Rows of a table as (T, N, columns), NaN where there is none."""
    order = k * (int(i.max()) + 1) + i
    if len(np.unique(order)) != len(order):
        raise InputError("a marker stands twice in one frame", where=where, expected="one row per frame and marker")
    x = np.full((int(k.max()) + 1, int(i.max()) + 1, values.shape[1]), np.nan)
    x[k, i] = values
    return x


def _table(path: Path) -> tuple[tuple[str, ...], Array, tuple[Flag, ...]]:
    """Header, empty where there is none, and numbers of a CSV file; empty cells are NaN.

    The last row of a file that does not end with a line end is left out, and said, unless it is sure to be whole.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        rows = [row for row in csv.reader(text.splitlines()) if any(cell.strip() for cell in row)]
    except (UnicodeDecodeError, csv.Error, OSError) as error:
        raise InputError("the file cannot be read", where=str(path), found=str(error)[:200], expected="CSV") from None
    header = tuple(cell.strip().lower() for cell in rows[0]) if rows and not _is_number(rows[0][0]) else ()
    body = rows[1:] if header else rows
    flags: tuple[Flag, ...] = ()
    if len(body) > 1 and not text.endswith(("\n", "\r")):
        *others, last = body
        if len(last) < len(others[0]) or not whole(last[-1], [row[-1] for row in others[-1000:]]):
            body, flags = (
                others,
                (truncated(len(others), len(body), "rows are sure to be whole (the last has no end)"),),
            )
    widths = {len(row) for row in body}
    if not body or len(widths) != 1:
        raise InputError(
            "no table", where=str(path), found=f"rows of {sorted(widths)} columns", expected="rows of one length"
        )
    try:
        return header, np.array([[float(c) if c.strip() else np.nan for c in row] for row in body]), flags
    except ValueError as error:
        raise InputError("a cell is no number", where=str(path), found=str(error)[:100]) from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _whole(column: Array, name: str, where: str) -> NDArray[np.int64]:
    if not np.isfinite(column).all() or (column != np.round(column)).any() or np.abs(column).max() > 2**53:
        raise InputError(f"{name} must be whole numbers", where=where)
    return column.astype(np.int64)


def _enough(count: int, where: str) -> None:
    if count < FEWEST:
        raise InputError(
            "too few markers at rest", where=where, found=count, expected=f"at least {FEWEST}",
            hint=Advice(Spelling("rest= names the unloaded frame", "begin with a frame of the unloaded pad")),
        )  # fmt: skip


NORMAL = 1.4826  # standard deviation over median absolute deviation of a normal law


@dataclass(frozen=True)
class Jitter:
    """Noise floor of the places.

    Parameters
    ----------
    std : array, shape (axes,)
        Standard deviation of one place per axis, in the unit of the places.
    per_marker : array, shape (N, axes)
        The same of every marker; NaN for one seen in too few frames.
    drift : array, shape (axes,)
        Median motion of the pattern from the first to the last frame.
    frames : int
    flags : tuple of Flag
        W406 where the frames repeat themselves.
    """

    std: Array
    per_marker: Array
    drift: Array
    frames: int
    flags: tuple[Flag, ...] = ()


def jitter(positions: ArrayLike) -> Jitter:
    """Noise of places over frames in which nothing moves.

    Differences of successive frames, less their median, leave steady drift out; their median absolute value leaves out
    what jumps.

    Parameters
    ----------
    positions : array, shape (T, N, axes)
        Places of the markers in every frame; NaN = lost.

    Raises
    ------
    InputError
        Fewer than three frames, or none in which markers are seen twice running.
    """
    what = "too few frames for a noise level"
    x = shaped(positions, (None, None, None), where="jitter", what=what, fewest=FEWEST, lost=True)
    steps = np.diff(x, axis=0)
    known = np.isfinite(steps).all(axis=2)
    if not known.any():
        raise InputError("no marker is seen in two frames running", where="jitter")
    drifting = np.median(steps[known], axis=0)
    std = NORMAL / np.sqrt(2) * np.median(np.abs(steps[known] - drifting), axis=0)
    still = float(np.mean(~steps[known].any(axis=1)))
    flag = frozen(still)
    return Jitter(std, _each(steps - drifting), _drift(x), len(x), (flag,) if flag else ())


def _each(steps: Array) -> Array:
    """Root of half the mean square step of every marker, NaN below two steps."""
    seen = np.isfinite(steps)
    count = seen.sum(axis=0)
    total = np.where(seen, steps, 0.0) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(count >= 2, np.sqrt(0.5 * total.sum(axis=0) / count), np.nan)


def _drift(x: NDArray[Any]) -> Array:
    moved = x[-1] - x[0]
    both = np.isfinite(moved).all(axis=1)
    return np.median(moved[both], axis=0) if both.any() else np.full(x.shape[2], np.nan)
