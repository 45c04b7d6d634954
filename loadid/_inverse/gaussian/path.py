"""The regularization path of a record over a state space: everything that the rules ask, in O(N) for each lambda."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._advice import Advice, Option
from structures.errors import InputError, NotIdentifiable

from ..interpolation import SplineTable, Values, powers_of_rest
from ..path import PathPoint, RegularizationPath, Solution
from .gains import Gains, feedback, gains
from .passes import Solved, backward, forward, gradient, refined, solve
from .posterior import LoadVariances, StateSpacePosterior, variances
from .record import WhitenedRecord
from .roots import Array

LONG = 1 << 14  # samples beyond which the largest value is extrapolated
LINES = 512


def unforced(record: WhitenedRecord) -> Array:
    """Responses (samples * m, free) to each free state alone."""
    still, none = feedback(record), np.zeros((record.samples, record.p))
    columns = [forward(record, still, none, start)[2].reshape(-1) for start in np.eye(record.n)[record.free]]
    return np.array(columns).T.reshape(-1, len(record.free))


def largest(record: WhitenedRecord) -> float:
    """Largest generalised singular value of (H, L): of ``L g`` to the data, free states fitted.

    That of a record beyond `LONG` samples is extrapolated by its growth over the last doubling: flat where the response
    has been forgotten by then, a power of the length where a difference of a static load is asked for. A moving load is
    followed over its whole way.
    """
    if record.samples <= LONG or np.ptp(record.F, axis=0).any() or np.ptp(record.G, axis=0).any():
        return _largest(record)
    half, whole = _largest(beginning(record, LONG // 2)), _largest(beginning(record, LONG))
    if half <= 0:
        return whole
    return float(whole * (record.samples / LONG) ** max(np.log2(whole / half), 0.0))


def _largest(record: WhitenedRecord) -> float:
    still, start = feedback(record), np.zeros(record.n)
    count = record.samples * record.p
    Q = np.linalg.qr(unforced(record))[0] if len(record.free) else np.zeros((record.samples * record.m, 0))

    def normal(w: Array) -> Array:
        y = forward(record, still, np.ascontiguousarray(w.reshape(-1, record.p)), start)[2].reshape(-1)
        rest = (y - Q @ (Q.T @ y)).reshape(-1, record.m)
        return backward(record, still, rest, None)[0].reshape(-1)

    return root_of_largest(normal, count)


def root_of_largest(normal: Callable[[Array], Array], count: int) -> float:
    """Root of the largest eigenvalue of a symmetric operator on `count` numbers, none of its eigenvalues below 0."""
    from scipy.sparse.linalg import LinearOperator, eigsh

    if count <= 2:
        matrix = np.array([normal(e) for e in np.eye(count)])
        return float(np.sqrt(np.abs(np.linalg.eigvalsh(matrix)).max()))
    first = np.random.default_rng(0).standard_normal(count)
    reach = normal(first)
    size = float(np.linalg.norm(reach))
    if not np.isfinite(size) or size == 0.0:
        return size
    # the operator is scaled to order one: the solver's own tolerances know no units
    operator = LinearOperator((count, count), matvec=lambda w: normal(w) / size, dtype=float)
    top = eigsh(operator, k=1, v0=reach / size, tol=1e-6, return_eigenvectors=False)
    return float(np.sqrt(size * max(float(top[0]), 0.0)))


def smallest(record: WhitenedRecord) -> float:
    """Smallest singular value of the steady system from ``L g`` to the data, over all frequencies."""
    return float(lines(record).min())


def layout(record: WhitenedRecord) -> tuple[float, int, int]:
    """Condition number of the part that the data see, rank and nullity, by the lines of the steady system."""
    values, unknowns = lines(record), record.samples * record.p
    seen = values > record.samples * record.p * np.finfo(float).eps * values.max()
    rank = min(round(unknowns * float(np.sum(seen)) / (LINES * record.p)), record.data)
    return float(values.max() / values[seen].min()), rank, max(unknowns - rank, 0)


def lines(record: WhitenedRecord) -> Array:
    """Singular values of the steady system from ``L g`` to the data, (lines, min(m, p)), up to Nyquist."""
    return np.asarray(np.linalg.svd(transfer(record)[0], compute_uv=False), float)


def transfer(record: WhitenedRecord) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Steady transfer of ``L g`` to the data (lines, m, p) and to the loads (lines, p, p), up to Nyquist."""
    z = np.exp(1j * np.pi * np.arange(1, LINES + 1) / LINES)
    kind = fullest(record)
    F, G, C, D = record.F[kind], record.G[kind], record.C[kind], record.D[kind]
    states = np.linalg.solve(z[:, None, None] * np.eye(record.n) - F, np.broadcast_to(G, (LINES, *G.shape)))
    return np.asarray(C @ states + D, complex), np.asarray(record.E @ states + np.eye(record.p), complex)


def beginning(record: WhitenedRecord, samples: int) -> WhitenedRecord:
    """So many samples with the most complete of the sets of sensors."""
    return replace(record, kind=np.full(samples, fullest(record), np.int32), y=record.y[:samples])


def fullest(record: WhitenedRecord) -> int:
    """Kind of sample with the most sensors."""
    return int(np.argmax(np.abs(record.C).sum(axis=(1, 2)) + np.abs(record.D).sum(axis=(1, 2))))


LOWEST = 1e-8  # relative lambda below which the square-root recursion loses its digits
SMALL = 1e-3  # relative lambda below which the solution of a long record, too, is worth a step of refinement
TINY = np.finfo(float).tiny
MEMORY = 8192  # samples of tail that cost digits as a small lambda does: gradient 3e-10 for 24000, refined 1e-15
KEPT = 20_000  # samples up to which residuals of all nodes are used
STORED = 3 << 26  # bytes of gains and solutions of nodes that are kept
WIDE = 0.25  # decades between the nodes of a quick path
FIELDS = ("residual2", "penalty2", "edf", "left", "ratio", "trace", "change2", "bend")


@dataclass(frozen=True)
class Scalars:
    """What one lambda gives, all positive: see `PathPoint`; `ratio` is the evidence term, `trace` tr of the covariance.

    `change2` is the squared norm of the estimate from the residual as data, and `bend` the product of its L g with that
    of the estimate: zero on a path that leaves them out.
    """

    residual2: float
    penalty2: float
    edf: float
    left: float
    ratio: float
    trace: float
    change2: float
    bend: float

    def array(self) -> Array:
        """In the order of `FIELDS`."""
        return np.array([getattr(self, name) for name in FIELDS])


class StateSpacePath(RegularizationPath):
    """Exact Tikhonov of a finite record over a state space, ``min |H g - y|^2 + lam^2 |L g|^2``, in O(N).

    A lambda costs one Riccati recursion over the memory of the record (`gains`), one covariance recursion for the
    traces, and two passes over the data. The rules see a spline through a fifth of a decade of such nodes;
    `exact`, `solution`, `residual` and `resolve` are exact at any lambda.

    Parameters
    ----------
    record : WhitenedRecord
    quick : bool
        Leave out what needs a second solve (sensitivity for quasi-optimality, bend of the L-curve), and space the nodes
        more widely: for rules that only confirm what shorter windows chose.
    scale : float, optional
        Of the problem that this is part of.
    """

    def __init__(self, record: WhitenedRecord, *, quick: bool = False, scale: float | None = None) -> None:
        self.record, self.quick = record, quick
        self.m, self.null, self.energy = record.data, len(record.free), float(np.sum(record.y**2))
        if self.m == 0:
            raise InputError("no data", where="state-space path", found="every sample is missing",
                             expected="some measured samples")  # fmt: skip
        self._limit = self._unforced()
        self.scale = np.asarray(largest(record) if scale is None else scale)
        if not 1e-140 < float(self.scale) < 1e140:
            raise InputError("the forward model is zero, or beyond the range of numbers", where="inverse problem",
                             found=f"largest generalised singular value {float(self.scale):.2g}",
                             expected="between 1e-140 and 1e140",
                             hint="check the sensors, the loads and the units")  # fmt: skip
        self._own: dict[float, Scalars] = {}
        self._table = self._new_table(self._row)
        self._kept: dict[float, tuple[Gains, Solved]] = {}
        self._errors: dict[float, SplineTable] = {}
        self._pilot: tuple[float, Solved] | None = None
        self._known: tuple[Gains, LoadVariances] | None = None  # of the last lambda that was asked alone

    def _unforced(self) -> float:
        """Log det of what the data tell of the free states alone; refused where that is nothing."""
        if not self.null:
            return 0.0
        columns = unforced(self.record)
        size = np.linalg.norm(columns, axis=0)  # a load and a state have units of their own
        R = np.abs(np.diag(np.linalg.qr(columns / np.where(size > 0, size, 1.0), mode="r")))
        if len(R) < self.null or R.min() <= self.m * np.finfo(float).eps * R.max():
            raise NotIdentifiable(
                "a load that the penalty leaves free, or an unknown start, is not seen by the sensors "
                f"(relative response {R.min() / max(R.max(), TINY):.2g})",
                advice=Advice(
                    "add a sensor that sees a constant load, choose ",
                    Option("penalty", "identity"),
                    " or a leaky difference, or start from rest",
                ),
                code="LID-E306",
            )
        return 2 * float(np.sum(np.log(R * size)))

    # -- the contract -------------------------------------------------------------------------------------------------
    @property
    def range(self) -> tuple[float, float]:
        """Relative lambda from below the smallest singular value of the lines, but not below 1e-8, up to 1."""
        return float(np.clip(1e-3 * self.seen, LOWEST, 0.1)), 1.0

    @property
    def seen(self) -> float:
        """Smallest relative generalised singular value that counts, from the lines of the steady system."""
        if not hasattr(self, "_smallest"):
            self._smallest = float(np.clip(smallest(self.record) / float(self.scale), LOWEST, 1.0))
        return self._smallest

    @property
    def unknowns(self) -> int:
        """Loads times samples."""
        return self.record.samples * self.record.p

    def at(self, lam: ArrayLike) -> PathPoint:
        """Scalars of the path at relative `lam`, from a spline between nodes; lambda 0 is not on this path."""
        lam = np.asarray(lam, float)
        self._check(lam)
        if lam.size == 1 and not self._table.holds(lam.reshape(-1)):
            return self._alone(lam)
        point = self._point(np.atleast_1d(lam), self._table.at(np.atleast_1d(lam)))
        if lam.ndim:
            return point
        one: Any = {k: None if v is None else v[0] for k, v in vars(point).items()}
        return PathPoint(**one)

    def _alone(self, lam: Array) -> PathPoint:
        """Exact scalars at one lambda, without those that need its neighbours."""
        at = float(lam.reshape(-1)[0])
        if at not in self._own:
            self._own[at] = self.scalars(at)
        own = self._own[at]

        def shaped(x: float) -> Array:
            return np.full(lam.shape, x)

        objective = own.residual2 + (float(lam.reshape(-1)[0]) * float(self.scale)) ** 2 * own.penalty2
        return PathPoint(
            shaped(own.residual2), shaped(own.penalty2), edf=shaped(own.edf), left=shaped(own.left),
            objective=shaped(objective), log_ratio=shaped(own.ratio),
            sensitivity=None if self.quick else shaped(2 * np.sqrt(own.change2)),
            bend=None if self.quick else shaped(-4 * own.bend),
        )  # fmt: skip

    def exact(self, lam: float) -> PathPoint:
        """Scalars at one relative lambda without interpolation; traces of powers from a fine stencil in ln lambda."""
        table = SplineTable(lambda x: self._row(x * lam), step=0.02)
        point = self._point(np.array([lam]), table.at(np.ones(1)))
        own = self.scalars(lam)
        values: Any = {k: None if v is None else v[0] for k, v in vars(point).items()}
        return replace(PathPoint(**values), residual2=np.asarray(own.residual2), penalty2=np.asarray(own.penalty2),
                       edf=np.asarray(own.edf), left=np.asarray(own.left), log_ratio=np.asarray(own.ratio))  # fmt: skip

    def predicted_error(self, lam: ArrayLike, pilot: float, sigma: float) -> Array:
        """Squared load error at each `lam` (k,) that would be made if the load were the estimate at `pilot`."""
        lam = np.atleast_1d(np.asarray(lam, float))
        self._check(lam)
        if pilot not in self._errors:
            self._errors[pilot] = self._new_table(partial(self._bias2, pilot))
        # noise: tr of P H^T H P, with P = (H^T H + lam^2 L^T L)^-1 and dP/dt = -lam^2 P L^T L P
        trace, slope, *_ = self._table.at(lam).slopes(FIELDS.index("trace"))
        return np.asarray(self._errors[pilot].at(lam).value(0) + sigma**2 * np.maximum(trace + slope, 0.0))

    def residual(self, lam: float) -> Array:
        """Whitened residual (samples, sensors), 0 where data are missing."""
        self._check(np.array([lam]))
        return self.record.y - self._heard(self._solved(lam)[1])

    def left_of(self, data: Array, lam: float) -> Array:
        """Residual of other whitened data (samples, sensors), 0 where data are missing."""
        return self.of_data(data, lam)[0]

    def of_data(self, data: Array, lam: float) -> tuple[Array, Array]:
        """Residual (samples, sensors) and load (samples, loads) of other whitened data."""
        again = self._again(lam, self._solved(lam)[0], data)
        return data - self._heard(again), again.load

    def residuals(self, lams: Array) -> list[Array]:
        """Residuals for the tests of whiteness: exact for one lambda, of the nearest node for many."""
        if len(lams) == 1 or self.record.samples > KEPT:
            return [self.residual(float(lam)) for lam in lams]
        nodes = self._table.nodes(lams)
        return [self.residual(float(nodes[np.argmin(np.abs(np.log(nodes / lam)))])) for lam in lams]

    def solution(self, lam: float, sigma: float | None) -> Solution:
        """Load history (samples, loads) and its posterior."""
        self._check(np.array([lam]))
        held, solved = self._solved(lam)
        if lam <= SMALL or self.record.samples <= KEPT or len(held.K) > MEMORY:
            solved = refined(self._system(lam), held, solved)
            self._kept[float(lam)] = held, solved
        if sigma is None:
            return Solution(solved.load, None)
        return Solution(solved.load, self._posterior(held, sigma))

    def resolve(self, load: Array, lam: float) -> Array:
        """What would be estimated from the noise-free response of `load` (samples, loads)."""
        return self._again(lam, self._solved(lam)[0], self.response(load)).load

    def start(self, lam: float) -> Array:
        """State of the augmented system at the first sample."""
        return self._solved(lam)[1].start

    def response(self, load: Array) -> Array:
        """Whitened response (samples, sensors) to a load (samples, loads) on a system at rest."""
        # with the feedback E the input is g - E xi: the load is what is put in
        held = feedback(self.record, self.record.E)
        return forward(self.record, held, np.ascontiguousarray(load, float), np.zeros(self.record.n))[2]

    def gradient(self, lam: float) -> float:
        """Norm of half the gradient of the objective at the solution over that of H^T y: a certificate."""
        held, solved = self._solved(lam)
        return gradient(self._system(lam), held.lam, solved)

    # -- inside -------------------------------------------------------------------------------------------------------
    def _system(self, lam: float) -> WhitenedRecord:
        """What is solved at a relative lambda."""
        return self.record

    def _heard(self, solved: Solved) -> Array:
        """Whitened response (samples, sensors) of a solve."""
        return solved.response

    def _again(self, lam: float, held: Gains, y: Array) -> Solved:
        """Solve for other data (samples, sensors)."""
        return solve(self.record, held, y)

    def _posterior(self, held: Gains, sigma: float) -> StateSpacePosterior:
        known = self._known
        of_each = known[1].variance if known is not None and known[0] is held else None
        return StateSpacePosterior(self.record, held.lam, sigma, held, of_each)

    def scalars(self, lam: float) -> Scalars:
        """Everything at one relative lambda."""
        held, solved = self._solved(lam)
        known = variances(self.record, held, every_sample=self.record.samples <= KEPT)
        self._known = held, known
        rest = self.record.y - solved.response
        count = self.unknowns + self.null
        change2 = bend = 0.0
        if not self.quick:
            again = solve(self.record, held, rest)
            change2, bend = float(np.sum(again.load**2)), float(np.sum(again.inputs * solved.inputs))
        return Scalars(
            residual2=float(np.sum(rest**2)),
            penalty2=float(np.sum(solved.inputs**2)),
            edf=count - known.penalty,
            left=(self.m - count) + known.penalty,
            ratio=held.logdet - 2 * self.unknowns * np.log(held.lam) - self._limit,
            trace=known.trace,
            change2=change2,
            bend=bend,
        )

    def _row(self, lam: float) -> Array:
        return self.scalars(lam).array()

    def _bias2(self, pilot: float, at: float) -> Array:
        """Squared distance of the estimate at `pilot` from what would be made of its response."""
        if self._pilot is None or self._pilot[0] != pilot:
            self._pilot = pilot, self._solved(pilot)[1]
        first = self._pilot[1]
        return np.array([np.sum((self._again(at, self._gains(at), self._heard(first)).load - first.load) ** 2)])

    def _new_table(self, compute: Callable[[float], Array]) -> SplineTable:
        return SplineTable(compute, step=WIDE, around=1, degree=5) if self.quick else SplineTable(compute)

    def _point(self, lam: Array, values: Values) -> PathPoint:
        found = dict(zip(FIELDS, np.exp(values.log), strict=True))
        rest2, rest4 = powers_of_rest(values.slopes(FIELDS.index("left")))
        edf, slope, *_ = values.slopes(FIELDS.index("edf"))
        return PathPoint(
            residual2=found["residual2"],
            penalty2=found["penalty2"],
            edf=edf,
            edf2=np.clip(edf + slope, 0.0, edf),
            left=found["left"],
            rest2=rest2,
            rest4=rest4,
            sensitivity=None if self.quick else 2 * np.sqrt(found["change2"]),
            objective=found["residual2"] + (lam * float(self.scale)) ** 2 * found["penalty2"],
            log_ratio=found["ratio"],
            bend=None if self.quick else -4 * found["bend"],
        )

    def _gains(self, lam: float) -> Gains:
        return self._kept[lam][0] if lam in self._kept else gains(self._system(lam), lam * float(self.scale))

    def _solved(self, lam: float) -> tuple[Gains, Solved]:
        """Gains and solution at a relative lambda; those that were asked for are kept as far as memory allows."""
        lam = float(lam)
        if lam not in self._kept:
            held = gains(self._system(lam), lam * float(self.scale))
            solved = self._again(lam, held, self.record.y)
            if sum(_bytes(*kept) for kept in self._kept.values()) + _bytes(held, solved) > STORED:
                self._kept.clear()
            self._kept[lam] = held, solved
        return self._kept[lam]

    @staticmethod
    def _check(lam: Array) -> None:
        if not np.all(np.isfinite(lam)) or np.any(lam < 0.9 * LOWEST):
            raise InputError(
                "lambda is too small for the state-space path", where="lambda", found=float(np.min(lam)),
                expected=f"a relative lambda of at least {LOWEST:g}",
                hint=Advice("below that the recursion loses all digits: use the dense path (",
                            Option("path", "dense", within="choice=Lambda"), ") on a window"),
            )  # fmt: skip


def _bytes(held: Gains, solved: Solved) -> int:
    """Memory of gains and a solution."""
    return sum(a.nbytes for a in (held.K, held.R, held.which, solved.inputs, solved.load, solved.response))
