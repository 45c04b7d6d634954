"""A record over a state space: what every recursion reads."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from .augmented import Augmented
from .settling import STRIDE


@dataclass(frozen=True)
class Record:
    """Whitened data over an augmented system whose matrices may change from sample to sample.

    Parameters
    ----------
    F, G, C, D : array, shapes (kinds, n, n), (kinds, n, p), (kinds, m, n), (kinds, m, p)
        Matrices of each kind of sample: without and with missing channels, or of each place of a moving load.
    E : array (p, n)
    kind : array of int, shape (samples,)
        Which matrices each sample has.
    y : array, shape (samples, m)
        Whitened data; 0 where nothing was measured, with a row of zeros in C and D.
    free : array of int
        States that start free.
    data : int
        Number of data.
    """

    F: NDArray[np.float64]
    G: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    E: NDArray[np.float64]
    kind: NDArray[np.int32]
    y: NDArray[np.float64]
    free: NDArray[np.int_]
    data: int

    @property
    def samples(self) -> int:
        """Samples."""
        return len(self.kind)

    @property
    def n(self) -> int:
        """States."""
        return self.F.shape[1]

    @property
    def p(self) -> int:
        """Loads."""
        return self.G.shape[2]

    @property
    def m(self) -> int:
        """Sensors."""
        return self.C.shape[1]

    @property
    def unknowns(self) -> int:
        """Inputs of all samples and free states."""
        return self.samples * self.p

    @cached_property
    def settles(self) -> bool:
        """No free state stays for ever whatever the inputs are: of such a one every sample tells more."""
        one = np.eye(self.n)
        return not any(np.all(self.F[:, i] == one[i]) and not self.G[:, i].any() for i in self.free)

    @property
    def stride(self) -> int:
        """Samples between two looks at whether a recursion has settled; beyond the record where it does not."""
        return STRIDE if self.settles else self.samples + 1

    @cached_property
    def entries(self) -> tuple[NDArray[np.int_], NDArray[np.float64]]:
        """Places (2, entries) at which any F is not zero, and its values there (kinds, entries): few in modal form."""
        at = np.array(np.nonzero(np.any(self.F != 0, axis=0)))
        return at, np.ascontiguousarray(self.F[:, at[0], at[1]])

    def with_data(self, y: NDArray) -> Record:
        """The same record with other whitened data."""
        return Record(self.F, self.G, self.C, self.D, self.E, self.kind, y, self.free, self.data)


def record(system: Augmented, y: NDArray, missing: NDArray | None = None) -> Record:
    """Record of a system that does not change, of whitened data (samples, m); `missing` data are left out.

    Raises
    ------
    InputError
        Data that do not fit, or NaN that is not declared as missing.
    """
    y = np.array(y, float)
    if y.ndim != 2 or y.shape[1] != system.m:
        raise InputError("the data do not fit the system", where="state-space path", found=f"shape {y.shape}",
                         expected=f"(samples, {system.m})")  # fmt: skip
    kind: NDArray[np.int32] = np.zeros(len(y), np.int32)
    shown = np.ones((1, system.m), bool)
    if missing is not None and np.any(missing):
        y[missing] = 0.0
        shown, places = np.unique(~missing, axis=0, return_inverse=True)
        kind = places.reshape(-1).astype(np.int32)
    if not np.all(np.isfinite(y)):
        raise InputError("NaN or inf in the data", where="state-space path", expected="finite numbers",
                         hint="declare what is missing")  # fmt: skip
    count = len(shown)
    return Record(
        np.repeat(system.F[None], count, 0), np.repeat(system.G[None], count, 0),
        np.ascontiguousarray(system.C * shown[:, :, None]), np.ascontiguousarray(system.D * shown[:, :, None]),
        np.ascontiguousarray(system.E), kind, y, system.free, int(np.sum(shown.sum(axis=1)[kind])),
    )  # fmt: skip
