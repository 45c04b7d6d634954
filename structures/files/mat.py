"""MAT files as named arrays, whichever of the two formats they are in; axes as MATLAB indexes them."""

from __future__ import annotations

import os
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..storage import as_path
from .hdf5 import open_hdf5
from .mat_level5 import BUDGET, is_level5, read_level5

HDF5_MARKS = (b"\x00\x02IM", b"\x02\x00MI")


@dataclass(frozen=True, eq=False)
class MatFile:
    """Arrays of a MAT file.

    Parameters
    ----------
    path : str
    arrays : dict of str to array
        Numbers, real or complex, and texts.
    others : dict of str to str
        Variables that are no such arrays (cell, struct, ...) and what they are.
    """

    path: str
    arrays: dict[str, NDArray]
    others: dict[str, str] = field(default_factory=dict)

    def named(self, name: str, what: str) -> NDArray:
        """An array of numbers by its name.

        Raises
        ------
        InputError
            If there is none of this name, or it holds no numbers; the message lists those that there are.
        """
        found = self.arrays.get(name)
        if found is not None and found.dtype.kind in "fiuc":
            return found
        word = self.others.get(name, "text" if found is not None else "")
        listed = [f"{k} {'x'.join(map(str, v.shape))}" for k, v in self.arrays.items() if v.dtype.kind in "fiuc"]
        raise InputError(
            f"{name} is a {word}, no array of numbers" if word else f"there is no array {name}",
            where=self.path,
            found=", ".join(listed[:20]) or "no array of numbers",
            expected=f"the array of the {what}",
            hint="save plain arrays: H = FRF.H; save('x.mat', 'H', 'f')" if word else "name one of these",
        )


def is_mat73(head: bytes) -> bool:
    """Whether the first 128 bytes are those of a MAT file of version 7.3, which is an HDF5 file."""
    return len(head) >= 128 and head[124:128] in HDF5_MARKS


def read_mat(path: str | os.PathLike) -> MatFile:
    """Arrays of a MAT file (-v6, -v7, -v7.3).

    Raises
    ------
    InputError
        The file is missing, truncated or damaged, of level 4, or unpacks to more than may be read.
    """
    place = as_path(path)
    try:
        with place.open("rb") as file:
            head = file.read(128)
            size = place.stat().st_size
            data = head + file.read() if is_level5(head) and size <= BUDGET else b""
    except OSError as error:
        raise InputError(
            "the file cannot be read", where=str(place), found=error.strerror or error, hint="check the path"
        ) from None
    if data:
        return MatFile(str(place), *read_level5(data, str(place)))
    if not is_mat73(head):
        raise InputError(
            "no MAT file that is read",
            where=str(place),
            found=f"{size} bytes that begin with {head[:20]!r}",
            expected="a MAT file of version 6, 7 or 7.3",
            hint="save it again: save('x.mat', '-v7')",
        )
    container = open_hdf5(place)
    arrays: dict[str, NDArray] = {}
    others: dict[str, str] = {}
    for name, get in container.arrays.items():
        if "/" in name:
            others[name.partition("/")[0]] = "struct"
            continue
        try:
            arrays[name] = np.asarray(get()).T  # MATLAB writes its columns first
        except InputError as error:
            if "of a type that is not read" not in error.what:
                raise
            others[name] = "cell or object"
    return MatFile(str(place), arrays, others)
