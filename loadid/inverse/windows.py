"""Records of any length behind impulse responses: overlapping windows one after another, with a bound on the error.

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

from .convolved.circulant import Circulant
from .convolved.operator import Operator
from .convolved.pcg import Sides, solve

SHORT = 4096  # samples of the first window that is tried
FADED = 3e-4  # relative height of what the end of a window still does beyond the overlap: sweeps make up for it
POWER = 12  # steps of the power method for the smallest curvature
SAFE = 1.5
TOLERANCE = 1e-11

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

    load: NDArray[np.float64]
    bound: float
    gradient: float
    changes: tuple[float, ...]
    window: int
    overlap: int
    count: int


def solve_in_windows(
    h: NDArray,
    y: NDArray,
    lam: float,
    penalty: str = "identity",
    *,
    weight: NDArray | None = None,
    window: int | None = None,
    overlap: int | None = None,
    memory: int | None = None,
    tolerance: float = 1e-4,
    sweeps: int = 4,
    progress: Progress | None = None,
) -> Windowed:
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
        falls to 3e-4, and six times that.
    memory : int, optional
        Taps that the windows use of `h`; the gradient and the bound use all, and further sweeps make up for it.
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
    h, y, w = _checked(h, y, weight, lam)
    used = h if memory is None else h[: max(int(memory), 1)]
    samples = y.shape[1]
    width, over = _layout(used, samples, lam, penalty, window, overlap)
    ahead, pieces = list(_ahead(samples, width, over)), list(_pieces(samples, width, over))
    whole, near = _Stream(h, width), _Stream(used, width)
    total = len(ahead) + len(pieces) * (max(sweeps, 1) - 1)

    def told(done: int, text: str) -> None:
        if progress is not None:
            progress(min(done / total, 1.0), text)

    load = np.zeros((h.shape[2], samples))
    locals_ = _Locals(used, width, penalty, lam, w)
    for k, (start, stop) in enumerate(ahead):
        end = min(start + width, samples)
        rest = y[:, start:end] - near.response(load, start, end, before=start)
        x = locals_.follow(start, rest, load)
        load[:, start:stop] = x[:, : stop - start]
        told(k + 1, "windows")
    least = locals_.curvature()
    first = float(np.linalg.norm(_gradient(whole, np.zeros_like(load), y, w, lam, penalty)))
    slope = _gradient(whole, load, y, w, lam, penalty)
    changes: list[float] = []
    for sweep in range(1, sweeps):
        size, far = float(np.linalg.norm(load)), float(np.linalg.norm(slope)) / least
        if far <= tolerance * size:
            break
        change = np.zeros_like(load)
        for k, (start, keep) in enumerate(pieces):
            x = locals_.solve(start, Sides(b=slope[None, :, start : start + width]))
            change[:, keep] = x[0][:, keep.start - start : keep.stop - start]
            told(len(ahead) + (sweep - 1) * len(pieces) + k + 1, "corrections")
        after = _gradient(whole, load + change, y, w, lam, penalty)
        if np.linalg.norm(after) >= np.linalg.norm(slope):  # the overlap is too short for this, or rounding is reached
            break
        load, slope = load + change, after
        changes.append(float(np.linalg.norm(change)) / size if size else 0.0)
    told(total, "done")
    height = float(np.linalg.norm(slope))
    return Windowed(
        np.ascontiguousarray(load.T), height / least, height / first if first else 0.0, tuple(changes), width, over,
        len(ahead),
    )  # fmt: skip


class _Tied(Operator):
    """Operator of a window whose penalty goes on from the load before it; differences with zeros in its place."""

    @property
    def rows(self) -> int:
        """Rows of the penalty for one load."""
        return self.samples

    def rough(self, g: NDArray) -> NDArray[np.float64]:
        """L g."""
        return super().rough(np.pad(g, ((0, 0), (0, 0), (self.order, 0))))

    def rough_adjoint(self, d: NDArray) -> NDArray[np.float64]:
        """L^T d."""
        return super().rough_adjoint(d)[..., self.order :]

    def from_before(self, load: NDArray) -> NDArray[np.float64]:
        """What the load before the window (loads, samples) adds to L g."""
        last = load[None, :, load.shape[1] - self.order :]
        return super().rough(np.pad(last, ((0, 0), (0, 0), (0, self.samples))))


class _Locals:
    """The windows' own problems; one preconditioner for all of them where no data are missing."""

    def __init__(self, h: NDArray, width: int, penalty: str, lam: float, weight: NDArray) -> None:
        self.h, self.width, self.penalty, self.lam, self.weight = h, width, penalty, lam, weight
        self.operator = Operator(h, width, penalty)
        self.circulant = Circulant(self.operator, lam)
        self.kept: dict[tuple[int, bool], tuple[Operator, Circulant]] = {}

    def solve(self, start: int, sides: Sides) -> NDArray[np.float64]:
        weight = self.weight[:, start : start + self.width]
        if np.all(weight == 1.0):
            return solve(self.operator, self.circulant, sides, TOLERANCE).x
        operator = Operator(self.h, self.width, self.penalty, weight.T)
        return solve(operator, Circulant(operator, self.lam), sides, TOLERANCE).x

    def follow(self, start: int, rest: NDArray, load: NDArray) -> NDArray[np.float64]:
        """Load of the window at `start`, (loads, samples), given all load before it; `rest` is what that leaves."""
        width = rest.shape[1]
        weight = self.weight[:, start : start + width]
        side = (rest * weight)[None]
        if start == 0 and width == self.width:
            return self.solve(0, Sides(y=side))[0]
        key = (width, start > 0)
        if not np.all(weight == 1.0) or key not in self.kept:
            kind = _Tied if start else Operator
            operator = kind(self.h, width, self.penalty, None if np.all(weight == 1.0) else weight.T)
            found = operator, Circulant(operator, self.lam)
            if np.all(weight == 1.0):
                self.kept[key] = found
        else:
            found = self.kept[key]
        operator, circulant = found
        c = -self.lam * operator.from_before(load[:, :start]) if isinstance(operator, _Tied) else None
        return solve(operator, circulant, Sides(y=side, c=c), TOLERANCE).x[0]

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


class _Stream:
    """Products with a convolution a block at a time."""

    def __init__(self, h: NDArray, block: int) -> None:
        from scipy import fft

        self.taps, self.h = len(h), np.moveaxis(h, 0, -1)
        self.length = int(fft.next_fast_len(self.taps + block, real=True))
        self.lines = fft.rfft(self.h, self.length)

    def response(self, g: NDArray, start: int, stop: int, before: int | None = None) -> NDArray[np.float64]:
        """Responses (sensors, stop - start) to a load (loads, samples), or to what of it comes before a sample."""
        from scipy import fft

        first = max(start - self.taps + 1, 0)
        G = fft.rfft(g[:, first : stop if before is None else before], self.length)
        full = fft.irfft(np.einsum("slk,lk->sk", self.lines, G), self.length)
        return full[:, start - first : stop - first]

    def adjoint(self, r: NDArray, start: int, stop: int) -> NDArray[np.float64]:
        """Loads (loads, stop - start) of H^T r."""
        from scipy import fft

        R = fft.rfft(r[:, start : stop + self.taps - 1], self.length)
        return fft.irfft(np.einsum("slk,sk->lk", self.lines.conj(), R), self.length)[:, : stop - start]


def _gradient(
    stream: _Stream, load: NDArray, y: NDArray, weight: NDArray, lam: float, penalty: str
) -> NDArray[np.float64]:
    """Half the negative gradient of the whole record's objective, (loads, samples)."""
    N, block = y.shape[1], max(stream.length - stream.taps, 1)
    rest, out = np.empty_like(y), np.empty_like(load)
    for a in range(0, N, block):
        b = min(a + block, N)
        rest[:, a:b] = weight[:, a:b] ** 2 * (y[:, a:b] - stream.response(load, a, b))
    for a in range(0, N, block):
        out[:, a : min(a + block, N)] = stream.adjoint(rest, a, min(a + block, N))
    rules = Operator(np.zeros((1, 1, 1)), min(N, 8), penalty)  # for its differences alone
    return out - lam**2 * rules.rough_adjoint(rules.rough(load))


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
    h: NDArray, samples: int, lam: float, penalty: str, window: int | None, overlap: int | None
) -> tuple[int, int]:
    """Window and overlap as asked for, or as the memory of the problem wants them."""
    if overlap is None:
        overlap = _faded(h, samples if window is None else min(window, samples), lam, penalty)
    width = min(samples, max(6 * overlap, SHORT) if window is None else int(window))
    if width < samples and not 0 <= 2 * overlap < width:
        raise InputError("the overlap leaves nothing of a window", where="windows", found=f"{overlap} of {width}",
                         expected="less than half the window", hint="a longer window")  # fmt: skip
    return width, int(overlap)


def _faded(h: NDArray, samples: int, lam: float, penalty: str) -> int:
    """Distance from the end of a window at which its last data and load no longer matter."""
    width = min(SHORT, samples)
    while True:
        operator = Operator(h, width, penalty)
        y = np.zeros((operator.sensors, operator.sensors, width))
        y[np.arange(operator.sensors), np.arange(operator.sensors), -1] = 1.0
        x = np.abs(solve(operator, Circulant(operator, lam), Sides(y=y), 1e-8).x)
        level = np.maximum.accumulate(np.max(x / x.max(axis=(1, 2), keepdims=True), axis=(0, 1)))  # from the far end
        reach = width - int(np.searchsorted(level, FADED))
        if 4 * reach <= width or width == samples:
            return min(reach, max((samples - 1) // 2, 0))
        width = min(2 * width, samples)


def _checked(h: NDArray, y: NDArray, weight: NDArray | None, lam: float) -> tuple[NDArray, NDArray, NDArray]:
    h, y = np.asarray(h, float), np.asarray(y, float)
    if h.ndim != 3 or y.ndim != 2 or y.shape[1] != h.shape[1] or 0 in h.shape + y.shape:
        raise InputError("impulse responses and data do not fit", where="windows", found=f"h {h.shape}, y {y.shape}",
                         expected="(taps, sensors, loads) and (samples, sensors)")  # fmt: skip
    if not (np.isfinite(lam) and lam > 0):
        raise InputError("no lambda", where="windows", found=lam, expected="a finite number above 0")
    w = np.ones(y.shape) if weight is None else np.asarray(weight, float)
    if w.shape != y.shape:
        raise InputError("the weights do not fit the data", where="windows", found=f"shape {w.shape}",
                         expected=f"{y.shape}")  # fmt: skip
    if not (np.all(np.isfinite(h)) and np.all(np.isfinite(w)) and np.all(np.isfinite(y[w != 0]))):
        raise InputError("NaN or inf in the model or the data", where="windows", expected="finite numbers",
                         hint="weight 0 where a sample is missing")  # fmt: skip
    return h[: len(y)], np.where(w != 0, y, 0.0).T.copy(), w.T.copy()
