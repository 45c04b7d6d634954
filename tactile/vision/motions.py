"""Marker motion that somebody else tracked: CSV and NPY files."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loadid.readers.numbers import whole
from loadid.readers.source import truncated
from structures.advice import Advice, Spelling
from structures.errors import InputError
from structures.flags import Flag
from structures.values import reals

from ..guards.vision import missing_frames, vanished
from .frames import missing_numbers
from .motion import Motion

GENERIC = (("frame", "id", "x", "y"), ("frame", "id", "x", "y", "z"))
GSROBOTICS = 7  # columns: frame, row, col, Ox, Oy, Cx, Cy
FEWEST = 3


@dataclass(frozen=True)
class Motions:
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

    points: NDArray[np.float64]
    places: NDArray[np.float64]
    heights: NDArray[np.float64] | None = None
    numbers: tuple[int, ...] = ()
    flags: tuple[Flag, ...] = ()
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.places)

    @property
    def moved(self) -> NDArray[np.float64]:
        """Motion from rest, shape (T, N, 2); NaN = lost."""
        return self.places - self.points

    def __getitem__(self, k: int) -> Motion:
        moved = self.places[k] - self.points
        lost = np.isnan(moved).any(axis=1)
        gone = vanished(len(lost), int(lost.sum()), 0, 0)
        number = self.numbers[k] if self.numbers else k + 1
        return Motion(self.points, moved, lost, np.zeros_like(lost), 0, number, (gone,) if gone else ())


def read_motions(source: str | Path | ArrayLike, *, rest: int = 0) -> Motions:
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
        from .stacks import read_stack

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
        "no marker motion",
        where=str(path),
        found=",".join(header) or f"{table.shape[1]} columns without a header",
        expected="the header frame,id,x,y[,z], or seven columns frame,row,col,Ox,Oy,Cx,Cy without one",
    )


def _from_array(x: NDArray[np.float64], rest: int, where: str) -> Motions:
    if x.ndim != 3 or x.shape[2] not in (2, 3) or x.shape[0] == 0:
        raise InputError("no marker motion", where=where, found=f"shape {x.shape}", expected="(T, N, 2) or (T, N, 3)")
    if np.isinf(x).any():
        raise InputError("places hold infinity", where=where, expected="finite numbers, or NaN for a lost marker")
    x = np.where(np.isnan(x).any(axis=2, keepdims=True), np.nan, x)
    if not 0 <= rest < len(x):
        raise InputError("there is no such frame", where=where, found=f"rest={rest}", expected=f"0 to {len(x) - 1}")
    _enough(int(np.isfinite(x[rest, :, 0]).sum()), where)
    heights = x[..., 2] if x.shape[2] == 3 else None
    return Motions(x[rest, :, :2], x[..., :2], heights, tuple(range(1, len(x) + 1)))


def _generic(table: NDArray[np.float64], rest: int, where: str) -> Motions:
    frame, marker = _whole(table[:, 0], "frame", where), _whole(table[:, 1], "id", where)
    numbers, k = np.unique(frame, return_inverse=True)
    ids, i = np.unique(marker, return_inverse=True)
    found = _from_array(_spread(k, i, table[:, 2:], where), rest, where)
    flag = missing_frames(missing_numbers([str(n) for n in numbers]), Path(where).name)
    return Motions(
        found.points,
        found.places,
        found.heights,
        tuple(map(int, numbers)),
        (flag,) if flag else (),
        (f"{len(ids)} ids",),
    )


def _gsrobotics(table: NDArray[np.float64], where: str) -> Motions:
    frame, row, column = (_whole(table[:, k], name, where) for k, name in enumerate(("frame", "row", "col")))
    numbers, k = np.unique(frame, return_inverse=True)
    pairs, i = np.unique(np.column_stack([row, column]), axis=0, return_inverse=True)
    places = _spread(k, i.reshape(-1), table[:, 5:7], where)
    outside = (places < 0).any(axis=2)
    places[outside] = np.nan
    points = np.full((len(pairs), 2), np.nan)
    points[i.reshape(-1)] = table[:, 3:5]
    _enough(int(np.isfinite(points[:, 0]).sum()), where)
    flag = missing_frames(missing_numbers([str(n) for n in numbers]), Path(where).name)
    notes = [
        "whole pixels: rounding alone is a noise of 0.29 px per axis",
        "dots out of view are inferred by that tracker and cannot be told from those that were seen",
    ]
    notes += [f"{int(outside.sum())} places left of or above the image are taken as lost"] if outside.any() else []
    return Motions(points, places, None, tuple(map(int, numbers)), (flag,) if flag else (), tuple(notes))


def _spread(k: NDArray, i: NDArray, values: NDArray[np.float64], where: str) -> NDArray[np.float64]:
    """Rows of a table as (T, N, columns), NaN where there is none."""
    order = k * (int(i.max()) + 1) + i
    if len(np.unique(order)) != len(order):
        raise InputError("a marker stands twice in one frame", where=where, expected="one row per frame and marker")
    x = np.full((int(k.max()) + 1, int(i.max()) + 1, values.shape[1]), np.nan)
    x[k, i] = values
    return x


def _table(path: Path) -> tuple[tuple[str, ...], NDArray[np.float64], tuple[Flag, ...]]:
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


def _whole(column: NDArray[np.float64], name: str, where: str) -> NDArray[np.int64]:
    if not np.isfinite(column).all() or (column != np.round(column)).any() or np.abs(column).max() > 2**53:
        raise InputError(f"{name} must be whole numbers", where=where)
    return column.astype(np.int64)


def _enough(count: int, where: str) -> None:
    if count < FEWEST:
        raise InputError(
            "too few markers at rest",
            where=where,
            found=count,
            expected=f"at least {FEWEST}",
            hint=Advice(Spelling("rest= names the unloaded frame", "begin with a frame of the unloaded pad")),
        )
