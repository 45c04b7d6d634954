"""Path of a record behind impulse responses that is too long for one piece: solved window by window, with a bound."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from .convolved.path import ConvolvedPath
from .convolved.pcg import Reached
from .streamed import Stream, heard
from .windows import TOLERANCE, Progress, Windowed, Windows

CLOSE, SWEEPS = 5e-4, 6  # bound over the norm of the load at which sweeps end; most sweeps
PLAIN = 1e-7  # accuracy of the windows where only sums are asked for
FIRST, LIVELY = 8192, 0.25  # samples of the beginning; its power over that of the record, at least


class WindowedPath(ConvolvedPath):
    """As `ConvolvedPath`, with every solution of the record made of windows (`windows`): memory of a few records.

    Loads come with a bound on what they differ by from the solution in one piece (`solve`). The scalars of `at` come
    from one sweep of windows, which leaves the load off by some 1e-4, more where influences last long. Traces and
    variances are those of `ConvolvedPath`: they need windows only, unless data are missing.

    Raises
    ------
    InputError
        As `ConvolvedPath`, and for weights other than 0 and 1.
    """

    def __init__(
        self, h: NDArray, y: NDArray, penalty: str = "identity", weight: NDArray | None = None,
        *, scale: float | None = None,
    ) -> None:  # fmt: skip
        super().__init__(h, y, penalty, weight, scale=scale)
        if weight is not None and not np.all((np.asarray(weight) == 0) | (np.asarray(weight) == 1)):
            raise InputError("windows know data and missing data", where="weight", found="other weights",
                             expected="0 or 1", hint="whiten model and data instead")  # fmt: skip
        self._last: tuple[float, Windowed] | None = None

    @cached_property
    def _stream(self) -> Stream:
        return Stream(heard(np.moveaxis(self.operator.h, -1, 0)))

    def solve(self, lam: float, progress: Progress | None = None) -> Windowed:
        """Windows at a relative lambda; the last ones are kept."""
        self._check(np.asarray(lam))
        if self._last is None or self._last[0] != float(lam):
            self._last = (
                float(lam),
                self._windows(lam).solve(self.y[0], tolerance=CLOSE, sweeps=SWEEPS, progress=progress),
            )
        return self._last[1]

    def precompute(self, lam: float, progress: Progress) -> None:
        """Solve the windows at a relative lambda, and say how far it is."""
        self.solve(lam, progress)

    def bound(self, lam: float) -> float | None:
        """Largest norm of what the windows at a relative lambda may differ by from the solution in one piece."""
        return self.solve(lam).bound

    def resolve(self, load: NDArray, lam: float) -> NDArray[np.float64]:
        """What would be estimated from the noise-free response of `load` (samples, loads)."""
        self._check(np.asarray(lam))
        g = np.ascontiguousarray(np.asarray(load, float).T)[None]
        return self._windows(lam).solve(self._response(g)[0]).load

    # -- inside -------------------------------------------------------------------------------------------------------
    def _windows(self, lam: float, accuracy: float = TOLERANCE) -> Windows:
        weight = self.operator.weight
        ones = np.broadcast_to(1.0, self.y.shape[1:]) if weight is None else weight
        h = np.moveaxis(self.operator.h[..., : self._stream.taps], -1, 0)
        absolute = float(lam) * float(self.scale)
        return Windows(h, self.samples, absolute, self.operator.penalty, ones, accuracy=accuracy)

    def _response(self, load: NDArray) -> NDArray[np.float64]:
        out = np.stack([self._stream.whole(g) for g in load])
        return out if self.operator.weight is None else out * self.operator.weight

    def _solved(self, lam: float) -> Reached:
        """Solution at a relative lambda, in the form of one in one piece."""
        found = self.solve(lam)
        x = np.ascontiguousarray(found.load.T)[None]
        q = -float(lam) * float(self.scale) * self.operator.rough(x)
        return Reached(x, self.y - self._response(x), q, found.gradient, found.count)

    def _chain(self, lam: float, y: NDArray) -> tuple[list[NDArray], list[NDArray], list[NDArray]]:
        windows, absolute = self._windows(lam, PLAIN), float(lam) * float(self.scale)
        loads: list[NDArray] = []
        responses: list[NDArray] = []
        roughs: list[NDArray] = []
        for _ in range(3):
            side = {"c": roughs[-1][0]} if roughs else {"y": y[0]}
            loads.append(windows.first(**side)[None])
            responses.append(self._response(loads[-1]))
            roughs.append(absolute * self.operator.rough(loads[-1]))
        return loads, responses, roughs


def beginning_of(path: ConvolvedPath) -> ConvolvedPath | None:
    """Path of the beginning of a long record, on which lambda is sought before the whole is asked.

    It is at rest before its first sample as the whole is, so that nothing has to be guessed, and its lambda is that of
    the whole. It is lengthened until it is about as lively as the record is on average; None where most of the record
    would be needed, or data are missing.
    """
    operator, y = path.operator, path.y[0]
    power, length = np.mean(y**2), FIRST
    while operator.weight is None and 2 * length <= y.shape[1]:
        if np.mean(y[:, :length] ** 2) >= LIVELY * power:
            h = np.moveaxis(operator.h[..., :length], -1, 0)
            return ConvolvedPath(h, y[:, :length].T, operator.penalty, scale=float(path.scale))
        length *= 2
    return None
