"""Records of any length behind impulse responses: window by window with a bound on the error, and their path.

A window begins where the load is settled: the response to what lies before is subtracted, and the penalty ties the
window to it. Given the load before, this is the problem of the whole record, but for the data after the window: what
they would change decays over the overlap, which is given up. Then the gradient of the whole problem, which is zero at
its solution, says how far off the load is; windows solved for that gradient correct it (restricted additive Schwarz;
Cai & Sarkis, SIAM J. Sci. Comput. 21 (1999) 792).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from .. import penalties
from ..convolution import Convolution, PenalizedConvolution, differences, differences_adjoint, heard
from .path import ConvolvedPath, checked
from .pcg import Circulant, Reached, Sides, solve

Array = NDArray[np.float64]

SHORT = 4096  # samples of the first window that is tried
FADED = 3e-4  # relative height of what the end of a window still does beyond the overlap: sweeps make up for it
LARGEST = 12  # the overlap is at most this part of the record: where influences last longer, more sweeps are needed
POWER = 12  # steps of the power method for the smallest curvature
SAFE = 1.5
TOLERANCE, CORRECTED = 1e-11, 1e-5  # accuracy of the windows of the first sweep, and of corrections

Progress = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class Windowed:
    """Load of a record that was solved in windows.

    Parameters
    ----------
    load : array, shape (samples, loads)
    bound : float
        Norm by which the load can differ from that of the whole record in one piece: norm of the gradient over the
        smallest curvature of the objective. With the identity penalty that curvature is at least lambda^2, and the
        bound is rigorous; for differences it is estimated on one window, with a margin of 1.5.
    gradient : float
        Norm of half the gradient of the whole record's objective over that at load zero.
    changes : tuple of float
        Relative change of the load by each sweep after the first.
    window, overlap, count : int
        Samples in a window, samples given up at its end (in corrections at both), and number of windows.
    """

    load: Array
    bound: float
    gradient: float
    changes: tuple[float, ...]
    window: int
    overlap: int
    count: int


def solve_in_windows(
    h: Array, y: Array, lam: float, penalty: str = "identity", *, weight: Array | None = None,
    window: int | None = None, overlap: int | None = None, tolerance: float = 1e-4, sweeps: int = 4,
    progress: Progress | None = None,
) -> Windowed:  # fmt: skip
    """Solve ``min |H g - y|^2 + lam^2 |L g|^2`` window by window; the work space is that of some windows.

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
        Whitened impulse responses.
    y : array, shape (samples, sensors)
        Whitened data.
    lam : float
        Absolute lambda.
    penalty : str
        Named penalty.
    weight : array, shape (samples, sensors), optional
        0 where a datum is missing.
    window, overlap : int, optional
        Samples in a window and given up at its end. Default: the overlap over which the influence of a window's end
        falls to 3e-4, at most a twelfth of the record, and six times that.
    tolerance : float
        Sweeps end once the bound is below this times the norm of the load.
    sweeps : int
        Most sweeps.
    progress : callable, optional
        ``progress(fraction, text)``.

    Raises
    ------
    InputError
        Shapes that do not fit, NaN, no positive lambda, or an overlap of half a window and more.
    """
    h, y, used = checked(h, y, weight)
    if not (np.isfinite(lam) and lam > 0):
        raise InputError("no lambda", where="windows", found=lam, expected="a finite number above 0")
    w = np.ones(y.shape) if weight is None else np.asarray(weight, float)
    windows = Windows(h[: len(y)], len(y), lam, penalty, w.T.copy(), window=window, overlap=overlap)
    return windows.solve(np.where(used, y, 0.0).T.copy(), tolerance=tolerance, sweeps=sweeps, progress=progress)


class Windows:
    """Windows of a record that is solved at one lambda; arguments as in `solve_in_windows`, time on the last axis.

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
    samples : int
    weight : array, shape (sensors, samples)
    """

    def __init__(
        self, h: Array, samples: int, lam: float, penalty: str, weight: Array, *, window: int | None = None,
        overlap: int | None = None, accuracy: float = TOLERANCE,
    ) -> None:  # fmt: skip
        self.samples, self.lam, self.weight = samples, lam, weight
        self.width, self.overlap = _layout(h, samples, lam, penalty, window, overlap)
        self.order = penalties.order(penalty)
        self.all = Convolution(h, samples, block=self.width)
        self.locals = _Locals(h, self.width, penalty, lam, weight, accuracy)

    def solve(
        self, y: Array, *, tolerance: float = 1e-4, sweeps: int = 4, progress: Progress | None = None
    ) -> Windowed:
        """Load of data (sensors, samples), and the bound on its error."""
        ahead, pieces = self._ahead(), list(_pieces(self.samples, self.width, self.overlap))
        total = len(ahead) + len(pieces) * (max(sweeps, 1) - 1)

        def told(done: int, text: str) -> None:
            if progress is not None:
                progress(min(done / total, 1.0), text)

        load = self.first(y, progress=told)
        least = self.locals.curvature()
        first = float(np.linalg.norm(self.all.correlate(self.weight**2 * y)))
        slope = self.slope(load, y)
        changes: list[float] = []
        for sweep in range(1, sweeps):
            size, far = float(np.linalg.norm(load)), float(np.linalg.norm(slope)) / least
            if far <= tolerance * size:
                break
            change = np.zeros_like(load)
            for k, (start, keep) in enumerate(pieces):
                x = self.locals.solve(start, Sides(b=slope[None, :, start : start + self.width]), CORRECTED)
                change[:, keep] = x[0][:, keep.start - start : keep.stop - start]
                told(len(ahead) + (sweep - 1) * len(pieces) + k + 1, "corrections")
            after = self.slope(load + change, y)
            if np.linalg.norm(after) >= np.linalg.norm(slope):  # the overlap is too short for this, or rounding
                break
            load, slope = load + change, after
            changes.append(float(np.linalg.norm(change)) / size if size else 0.0)
        told(total, "done")
        height = float(np.linalg.norm(slope))
        return Windowed(
            np.ascontiguousarray(load.T), height / least, height / first if first else 0.0, tuple(changes), self.width,
            self.overlap, len(ahead),
        )  # fmt: skip

    def first(
        self, y: Array | None = None, c: Array | None = None, progress: Callable[[int, str], None] | None = None
    ) -> Array:
        """Load (loads, samples) by one sweep for data y (sensors, samples) and roughnesses c (loads, rows).

        It minimises ``|y - H g|^2 + |c - lam L g|^2``, of which None is zero.
        """
        load = np.zeros((self.all.loads, self.samples))
        for k, (start, stop) in enumerate(self._ahead()):
            end = min(start + self.width, self.samples)
            rest = -self.all.response(load, start, end, before=start)
            if y is not None:
                rest += y[:, start:end]
            own = None if c is None else c[:, max(start - self.order, 0) : end - self.order]
            load[:, start:stop] = self.locals.follow(start, rest, load, own)[:, : stop - start]
            if progress is not None:
                progress(k + 1, "windows")
        return load

    def slope(self, load: Array, y: Array) -> Array:
        """Half the negative gradient of the whole record's objective, (loads, samples)."""
        out = self.all.correlate(self.weight**2 * (y - self.all.convolve(load)))
        return out - self.lam**2 * differences_adjoint(differences(load, self.order), self.order)

    def _ahead(self) -> list[tuple[int, int]]:
        return list(_ahead(self.samples, self.width, self.overlap))


class _Tied(PenalizedConvolution):
    """Operator of a window whose penalty goes on from the load before it; differences with zeros in its place."""

    @property
    def rows(self) -> int:
        """Rows of the penalty for one load."""
        return self.samples

    def rough(self, g: Array) -> Array:
        """L g."""
        return super().rough(np.pad(g, ((0, 0), (0, 0), (self.order, 0))))

    def rough_adjoint(self, d: Array) -> Array:
        """L^T d."""
        return super().rough_adjoint(d)[..., self.order :]

    def from_before(self, load: Array) -> Array:
        """What the load before the window (loads, samples) adds to L g."""
        last = load[None, :, load.shape[1] - self.order :]
        return super().rough(np.pad(last, ((0, 0), (0, 0), (0, self.samples))))


class _Locals:
    """The windows' own problems; one preconditioner for all of them where no data are missing."""

    def __init__(
        self, h: Array, width: int, penalty: str, lam: float, weight: Array, accuracy: float = TOLERANCE
    ) -> None:
        self.h, self.width, self.penalty, self.lam, self.weight = h, width, penalty, lam, weight
        self.accuracy = accuracy
        self.operator = PenalizedConvolution(h, width, penalty)
        self.circulant = Circulant(self.operator, lam)
        self.kept: dict[tuple[int, bool], tuple[PenalizedConvolution, Circulant]] = {}

    def solve(self, start: int, sides: Sides, accuracy: float | None = None) -> Array:
        accuracy = self.accuracy if accuracy is None else accuracy
        weight = self.weight[:, start : start + self.width]
        if np.all(weight == 1.0):
            return solve(self.operator, self.circulant, sides, accuracy).x
        operator = PenalizedConvolution(self.h, self.width, self.penalty, weight.T)
        return solve(operator, Circulant(operator, self.lam), sides, accuracy).x

    def follow(self, start: int, rest: Array, load: Array, rough: Array | None = None) -> Array:
        """Load of the window at `start`, (loads, samples), given all load before it.

        `rest` is what that leaves of the data, `rough` (loads, rows) what ``lam L g`` is drawn to, if not to zero.
        """
        width = rest.shape[1]
        weight = self.weight[:, start : start + width]
        side = (rest * weight)[None]
        c = None if rough is None else rough[None]
        if start == 0 and width == self.width:
            return np.asarray(self.solve(0, Sides(y=side, c=c))[0])
        key = (width, start > 0)
        if not np.all(weight == 1.0) or key not in self.kept:
            kind = _Tied if start else PenalizedConvolution
            operator = kind(self.h, width, self.penalty, None if np.all(weight == 1.0) else weight.T)
            found = operator, Circulant(operator, self.lam)
            if np.all(weight == 1.0):
                self.kept[key] = found
        else:
            found = self.kept[key]
        operator, circulant = found
        if isinstance(operator, _Tied):
            c = (0.0 if c is None else c) - self.lam * operator.from_before(load[:, :start])
        return np.asarray(solve(operator, circulant, Sides(y=side, c=c), self.accuracy).x[0])

    def curvature(self) -> float:
        """Smallest curvature of the objective: lambda^2 with the identity, else by the power method on a window."""
        if self.operator.order == 0:
            return self.lam**2
        v = np.random.default_rng(0).standard_normal((1, self.operator.loads, self.width))
        size = 0.0
        for _ in range(POWER):
            v = solve(self.operator, self.circulant, Sides(b=v / np.linalg.norm(v)), 1e-6).x
            size = float(np.linalg.norm(v))
        return 1.0 / (SAFE * size)


def _ahead(samples: int, width: int, overlap: int) -> Iterator[tuple[int, int]]:
    """Start of each window of the first sweep, and where what is kept of it ends; the last one may be shorter."""
    start = 0
    while start < samples:
        stop = samples if start + width >= samples else start + width - overlap
        yield start, stop
        start = stop


def _pieces(samples: int, width: int, overlap: int) -> Iterator[tuple[int, slice]]:
    """Start of each window of a correction and the samples that are kept of it; all windows have one length."""
    done, start = 0, 0
    while done < samples:
        start = min(max(done - overlap, 0), samples - width)
        stop = samples if start == samples - width else start + width - overlap
        yield start, slice(done, stop)
        done = stop


def _layout(
    h: Array, samples: int, lam: float, penalty: str, window: int | None, overlap: int | None
) -> tuple[int, int]:
    """Window and overlap as asked for, or as the memory of the problem wants them."""
    if overlap is None:
        overlap = _faded(h, samples if window is None else min(window, samples), lam, penalty)
    width = min(samples, max(6 * overlap, SHORT) if window is None else int(window))
    if width < samples and not 0 <= 2 * overlap < width:
        raise InputError("the overlap leaves nothing of a window", where="windows", found=f"{overlap} of {width}",
                         expected="less than half the window", hint="a longer window")  # fmt: skip
    return width, int(overlap)


def _faded(h: Array, samples: int, lam: float, penalty: str) -> int:
    """Distance from the end of a window at which its last data and load no longer matter."""
    width, most = min(SHORT, samples), max(samples // LARGEST, 1)
    while True:
        operator = PenalizedConvolution(h, width, penalty)
        y = np.zeros((operator.sensors, operator.sensors, width))
        y[np.arange(operator.sensors), np.arange(operator.sensors), -1] = 1.0
        x = np.abs(solve(operator, Circulant(operator, lam), Sides(y=y), 1e-8).x)
        level = np.maximum.accumulate(np.max(x / x.max(axis=(1, 2), keepdims=True), axis=(0, 1)))  # from the far end
        reach = width - int(np.searchsorted(level, FADED))
        if 4 * reach <= width or width == samples or reach > most:
            return min(reach, most)
        width = min(2 * width, samples)


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
        self, h: Array, y: Array, penalty: str = "identity", weight: Array | None = None,
        *, scale: float | None = None,
    ) -> None:  # fmt: skip
        super().__init__(h, y, penalty, weight, scale=scale)
        if weight is not None and not np.all((np.asarray(weight) == 0) | (np.asarray(weight) == 1)):
            raise InputError("windows know data and missing data", where="weight", found="other weights",
                             expected="0 or 1", hint="whiten model and data instead")  # fmt: skip
        self._last: tuple[float, Windowed] | None = None

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

    def resolve(self, load: Array, lam: float) -> Array:
        """What would be estimated from the noise-free response of `load` (samples, loads)."""
        self._check(np.asarray(lam))
        g = np.ascontiguousarray(np.asarray(load, float).T)[None]
        return self._windows(lam).solve(self.operator.convolve(g)[0]).load

    # -- inside -------------------------------------------------------------------------------------------------------
    def _windows(self, lam: float, accuracy: float = TOLERANCE) -> Windows:
        o = self.operator
        ones = np.broadcast_to(1.0, self.y.shape[1:]) if o.weight is None else o.weight
        absolute = float(lam) * float(self.scale)
        return Windows(heard(o.responses), self.samples, absolute, o.penalty, ones, accuracy=accuracy)

    def _solved(self, lam: float) -> Reached:
        """Solution at a relative lambda, in the form of one in one piece."""
        found = self.solve(lam)
        x = np.ascontiguousarray(found.load.T)[None]
        q = -float(lam) * float(self.scale) * self.operator.rough(x)
        return Reached(x, self.y - self.operator.convolve(x), q, found.gradient, found.count)

    def _left(self, y: Array, lam: float) -> Array:
        return y - self.operator.convolve(self._windows(lam).first(y=y[0])[None])

    def _chain(self, lam: float, y: Array) -> tuple[list[Array], list[Array], list[Array]]:
        windows, absolute = self._windows(lam, PLAIN), float(lam) * float(self.scale)
        loads: list[Array] = []
        responses: list[Array] = []
        roughs: list[Array] = []
        for _ in range(3):
            side = {"c": roughs[-1][0]} if roughs else {"y": y[0]}
            loads.append(windows.first(**side)[None])
            responses.append(self.operator.convolve(loads[-1]))
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
            return ConvolvedPath(
                operator.responses[:length], y[:, :length].T, operator.penalty, scale=float(path.scale)
            )
        length *= 2
    return None
