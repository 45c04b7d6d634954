"""Path of a record convolved with impulse responses of any length: exact finite-record Tikhonov by FFT products.

And the zero-padded path in the frequency domain: right where the response has decayed.
"""

from __future__ import annotations

from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from structures._advice import Advice, Option
from structures._testing.spectra import multiplicity, padded_length, smooth_lines
from structures.errors import InputError, NotIdentifiable

from ..convolution import PenalizedConvolution
from ..interpolation import STEP, HermiteTable, Traces, logs
from ..nuisances import Marginal
from ..path import FactoredPath, PathPoint, RegularizationPath, Solution
from ..penalties import symbol
from ..posterior import Posterior, SpectralPosterior, WidenedPosterior
from . import posterior as probes
from .gaps import unrecorded
from .pcg import Circulant, Reached, Sides, largest, refined, solve
from .posterior import SWEPT, ConvolvedPosterior, Moments, chain, columns, moments, profile, slopes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SCALARS, TIGHT = 1e-9, 1e-11  # tolerance of solves whose answers are only sums; the second one below `WEAK`
WEAK = 100.0  # times the smallest lambda
TRACES = 1e-9
KEPT = 200_000  # data up to which the residuals of all nodes are kept
TRIED, TRY_TO = 1 << 15, 0.1  # samples on which a lambda is tried, and the largest one that is
LOWEST = 1e-5  # lambda times the largest penalty over the norm of H: below, too many digits are lost


def checked(h: Array, y: Array, weight: Array | None) -> tuple[Array, Array, Mask]:
    """Impulse responses, data and which of them are there, of shapes that fit.

    Raises
    ------
    InputError
        Shapes that do not fit, no data, NaN.
    """
    h, y = np.asarray(h, float), np.asarray(y, float)
    if h.ndim != 3 or y.ndim != 2 or y.shape[1] != h.shape[1] or 0 in h.shape + y.shape:
        raise InputError("impulse responses and data do not fit", where="convolved path",
                         found=f"h {h.shape}, y {y.shape}",
                         expected="(taps, sensors, loads) and (samples, sensors)")  # fmt: skip
    used = np.ones(y.shape, bool) if weight is None else np.asarray(weight) != 0
    if used.shape != y.shape or (weight is not None and not np.all(np.isfinite(weight))):
        raise InputError("the weights do not fit the data", where="convolved path", found=f"shape {used.shape}",
                         expected=f"{y.shape}, finite")  # fmt: skip
    if not np.any(used):
        raise InputError("no data", where="convolved path", found="every sample is missing",
                         expected="some measured samples")  # fmt: skip
    if not (np.all(np.isfinite(h)) and np.all(np.isfinite(y[used]))):
        raise InputError("NaN or inf in the model or the data", where="convolved path", expected="finite numbers",
                         hint="weight 0 where a sample is missing")  # fmt: skip
    return h, y, used


class ConvolvedPath(RegularizationPath):
    """``min |H g - y|^2 + lambda^2 |L g|^2`` with H the causal block Toeplitz operator of h, right at both ends.

    Nothing is assumed of what comes after the record; before it the load is zero. The penalty acts in time with free
    ends, as the dense one does. A lambda costs some solves by conjugate gradients (`pcg`), of six transforms for one
    load and one sensor in each step. Exact to the tolerance of these: loads, residuals, `exact`, degrees of freedom and
    the variance of every sample (`posterior.diagonals`). Interpolated between half decades of lambda (a quarter for
    traces): what `at` says. Estimated by fixed probes: traces where sensors, loads and gaps in the data ask for more
    than `posterior.SWEPT` columns, and variances where they ask for more than `posterior.MANY`.

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
        Impulse responses, whitened: row s over the noise level of sensor s. Zero beyond their end.
    y : array, shape (samples, sensors)
        Whitened data.
    penalty : str
        Named penalty.
    weight : array, shape (samples, sensors), optional
        What rows of H and data are multiplied by; 0 where a datum is missing (its value is then not used).
    scale : float, optional
        Largest generalised singular value, where it is known.

    Raises
    ------
    InputError
        Shapes that do not fit, NaN, a model that is zero.
    NotIdentifiable
        A constant (or linear) load that neither the sensors nor the penalty see (LID-E306).
    """

    def __init__(
        self, h: Array, y: Array, penalty: str = "identity", weight: Array | None = None,
        *, scale: float | None = None,
    ) -> None:  # fmt: skip
        h, y, used = checked(h, y, weight)
        if np.all(used) and weight is not None and np.all(np.asarray(weight) == 1.0):
            weight = None
        self.operator = PenalizedConvolution(h, len(y), penalty, weight)
        kept = np.where(used, y, 0.0) * (1.0 if weight is None else np.asarray(weight, float))
        self.y = np.ascontiguousarray(kept.T)[None]  # (1, sensors, samples)
        self.m, self.null = int(np.sum(used)), self.operator.order * self.operator.loads
        self.energy = float(np.sum(self.y**2))
        self.scale = np.asarray(largest(self.operator) if scale is None else float(scale))
        if not 1e-140 < float(self.scale) < 1e140:
            raise InputError("the forward model is beyond the range of numbers", where="inverse problem",
                             found=f"largest generalised singular value {float(self.scale):.2g}",
                             expected="between 1e-140 and 1e140", hint="check the units")  # fmt: skip
        self._table = HermiteTable(self._node, self.lowest)
        self._residuals: dict[float, tuple[Array, Array]] = {}
        self._errors: dict[float, HermiteTable] = {}
        self._kept: tuple[float, Reached] | None = None
        self._told: tuple[float, tuple[Array, Array, float], tuple[float, float, float]] | None = None

    # -- the contract -------------------------------------------------------------------------------------------------
    @property
    def samples(self) -> int:
        """Length of the record."""
        return self.operator.samples

    @property
    def unknowns(self) -> int:
        """Loads times samples."""
        return int(self.operator.samples * self.operator.loads)

    @cached_property
    def range(self) -> tuple[float, float]:
        """Relative lambda from below the smallest singular value of the lines, as far as digits allow, up to 1.

        Where the beginning of the record shows that the iteration does not settle there (measured responses that end in
        noise), from the first half decade at which it does: below, such responses say nothing that a rule could use.
        """
        low = float(max(self.lowest, min(1e-3 * self.seen, 0.1)))
        tried = low
        while tried < TRY_TO and not self._settles(tried):
            tried *= 10**STEP
        return low if tried == low else tried * 10**STEP, 1.0  # the node below the first lambda is one that settles

    def _settles(self, lam: float) -> bool:
        """Whether the iteration solves what the scalars of a node ask for, on the beginning of the record."""
        part = self.operator if self.samples <= TRIED else self.operator.cut(TRIED)
        circulant, y = Circulant(part, lam * float(self.scale)), self.y[..., : part.samples]
        try:
            chain(part, circulant, y, self._tolerance(lam), takeover=False)
        except NotIdentifiable:
            return False
        return True

    @cached_property
    def lowest(self) -> float:
        """Smallest relative lambda that is solved for: `LOWEST` times the norm of H over that of the penalty."""
        o = self.operator
        norm = float(self.scale)
        if o.order:
            norm = largest(PenalizedConvolution(o.responses, o.samples, "identity", o.weights))
        return float(LOWEST * norm / 2**o.order / float(self.scale))

    @cached_property
    def seen(self) -> float:
        """Smallest relative generalised singular value of the lines of a padded transform of the impulse responses."""
        lines = self.operator.cut(min(self.samples, 4096)).spectrum
        values = np.linalg.svd(np.moveaxis(lines, -1, 0)[1:], compute_uv=False).min(axis=1)
        theta = np.pi * np.arange(1, lines.shape[-1]) / (lines.shape[-1] - 1)
        return float(np.min(values / (2 * np.sin(theta / 2)) ** self.operator.order) / float(self.scale))

    def at(self, lam: ArrayLike) -> PathPoint:
        """Scalars of the path at relative `lam`, from nodes half a decade apart (a quarter for traces)."""
        lam = np.asarray(lam, float)
        self._check(lam)
        if lam.size == 1 and not self._table.holds(lam.reshape(-1)):
            return self._alone(lam)
        values = self._between(np.atleast_1d(lam))
        return PathPoint(**{name: x if lam.ndim else x[0] for name, x in values.items()})

    def exact(self, lam: float) -> PathPoint:
        """Scalars at one relative lambda without interpolation; traces of powers are left out."""
        return self._alone(np.asarray(float(lam)))

    def predicted_error(self, lam: ArrayLike, pilot: float, sigma: float) -> Array:
        """Squared load error at each `lam` (k,) that would be made if the load were the estimate at `pilot`."""
        lam = np.atleast_1d(np.asarray(lam, float))
        self._check(lam)
        if pilot not in self._errors:
            load = self._solved(pilot).x
            response = self.operator.convolve(load)
            self._errors = {pilot: HermiteTable(partial(self._bias2, load, response), self.lowest)}
        noise = self._noise2(lam) if sigma > 0 else 0.0
        return np.asarray(self._errors[pilot].at(lam)[0] + sigma**2 * noise)

    def residual(self, lam: float) -> Array:
        """Whitened residual (samples, sensors), 0 where data are missing."""
        return self._beside(self._solved(lam).r)

    def left_of(self, data: Array, lam: float) -> Array:
        """Residual of other whitened data (samples, sensors), 0 where data are missing."""
        self._check(np.asarray(lam))
        weight = 1.0 if self.operator.weight is None else self.operator.weight
        return self._beside(self._left(np.ascontiguousarray(data.T)[None] * weight, lam))

    def residuals(self, lams: Array) -> list[Array]:
        """Residuals for the tests of whiteness: exact for one lambda, from cubics between nodes for many."""
        if len(lams) == 1 or self.y.size > KEPT:
            return [self.residual(float(lam)) for lam in lams]
        self._table.at(np.asarray(lams, float))
        nodes = np.sort(list(self._residuals))
        return [self._residual_between(nodes, float(lam)) for lam in lams]

    def solution(self, lam: float, sigma: float | None) -> Solution:
        """Load history (samples, loads) and its posterior."""
        load = np.ascontiguousarray(self._solved(lam).x[0].T)
        if sigma is None:
            return Solution(load, None)
        return Solution(load, ConvolvedPosterior(self.operator, float(lam) * float(self.scale), sigma))

    def resolve(self, load: Array, lam: float) -> Array:
        """What would be estimated from the noise-free response of `load` (samples, loads)."""
        self._check(np.asarray(lam))
        g = np.ascontiguousarray(np.asarray(load, float).T)[None]
        found = refined(self.operator, self._circulant(float(lam)), self.operator.convolve(g))
        return np.ascontiguousarray(found.x[0].T)

    def gradient(self, lam: float) -> float:
        """Norm of half the gradient of the objective at the solution over that of H^T y: a certificate."""
        return self._solved(lam).gradient

    def _residual_between(self, nodes: Array, lam: float) -> Array:
        """Cubic through the residuals and their slopes at the nodes on both sides."""
        k = int(np.clip(np.searchsorted(nodes, lam), 1, len(nodes) - 1))
        width = 2 * np.log(nodes[k] / nodes[k - 1])
        x = 2 * np.log(lam / nodes[k - 1]) / width
        (r, dr), (s, ds) = (self._residuals[float(node)] for node in nodes[k - 1 : k + 1])
        ahead = x * x * (3 - 2 * x)
        return np.asarray((1 - ahead) * r + ahead * s + width * x * (1 - x) * ((1 - x) * dr - x * ds))

    # -- inside -------------------------------------------------------------------------------------------------------
    def _circulant(self, lam: float) -> Circulant:
        return Circulant(self.operator, lam * float(self.scale))

    def _solved(self, lam: float) -> Reached:
        """Solution at a relative lambda; the last one is kept."""
        self._check(np.asarray(lam))
        if self._kept is None or self._kept[0] != float(lam):
            self._kept = float(lam), refined(self.operator, self._circulant(lam), self.y)
        return self._kept[1]

    def _left(self, y: Array, lam: float) -> Array:
        return solve(self.operator, self._circulant(lam), Sides(y=y), SCALARS).r

    def _moments(self, lam: float) -> Moments:
        return moments(self.y, *self._chain(lam, self.y))

    def _chain(self, lam: float, y: Array) -> tuple[list[Array], list[Array], list[Array]]:
        """Three solves, each of what the one before leaves of the penalty."""
        return chain(self.operator, self._circulant(lam), y, self._tolerance(lam))

    @staticmethod
    def _beside(x: Array) -> Array:
        """Responses (1, sensors, samples) as (samples, sensors)."""
        return np.ascontiguousarray(x[0].T)

    def _tolerance(self, lam: float) -> float:
        return SCALARS if lam >= WEAK * self.lowest else TIGHT

    def _node(self, lam: float) -> tuple[Array, ...]:
        """Objective, residual, roughness and its bend (both times lambda^2); change of the load: logarithms, slopes."""
        found = self._moments(lam)
        if self.y.size <= KEPT:
            self._residuals[lam] = self._beside(found.residual), self._beside(found.residual_slope)
        p, d = found.rest.sum(axis=1), found.drop.sum(axis=1)
        falls = slopes(d)
        objective, residual2 = np.append(p[0], falls[1][:4]), np.append(p[1], 2 * falls[2][:4])
        groups = logs(np.array([objective, residual2, falls[1][:5]])), logs(np.array([falls[2][:4]]))
        if self.operator.order == 0:  # f / c^2 = (1 - f) / lambda^2
            return *groups, logs(np.array([falls[3][:3]]))
        return *groups, logs(np.array([[np.sum(found.change2), np.sum(found.change_slope)]]))

    def _between(self, lam: Array) -> dict[str, Array]:
        """Every scalar at relative lambdas (k,)."""
        objective, residual2, rough, bend, change2 = self._table.at(lam)
        powers, x2 = self._traces.powers(lam), (lam * float(self.scale)) ** 2
        if self.operator.order == 0:
            change2 = change2 / x2
        left = (self.m - self.unknowns) + powers.rest
        edf = self.null + powers.part
        rest2 = np.clip(left + powers.first, left**2 / self.m, left)
        rest4 = left + 11 / 6 * powers.first - powers.second + powers.third / 6
        return {
            "residual2": residual2,
            "penalty2": rough / x2,
            "edf": edf,
            "edf2": np.clip(edf + powers.first, edf**2 / self.unknowns, edf),
            "left": left,
            "rest2": rest2,
            "rest4": np.clip(rest4, rest2**2 / self.m, rest2),
            "sensitivity": 2 * np.sqrt(change2),
            "objective": objective,
            "log_ratio": self._traces.log_ratio(lam),
            "bend": -4 * bend / x2,
        }

    def _alone(self, lam: Array) -> PathPoint:
        """Exact scalars at one lambda, without those that need its neighbours."""
        relative = float(lam.reshape(-1)[0])
        if self._told is None or self._told[0] != relative:
            found = self._moments(relative)
            sums = found.rest.sum(axis=1), found.drop.sum(axis=1), float(np.sum(found.change2))
            self._told = relative, sums, self._trace(relative)
        _, (remains, falls, change2), (part, rest, _) = self._told
        x2 = (relative * float(self.scale)) ** 2

        def shaped(x: float) -> Array:
            return np.full(lam.shape, x)

        return PathPoint(
            shaped(remains[1]), shaped(falls[1] / x2),
            edf=shaped(self.null + part), left=shaped(self.m - self.unknowns + rest),
            sensitivity=shaped(2 * np.sqrt(change2)), objective=shaped(remains[0]),
            bend=shaped(-4 * falls[2] / x2),
        )  # fmt: skip

    @cached_property
    def _traces(self) -> Traces:
        return Traces(self._trace, self.range[0])

    def _trace(self, lam: float) -> tuple[float, float, float]:
        """Degrees of freedom that the penalty governs, those that are left of them, and the trace of B."""
        x = lam * float(self.scale)
        if columns(self.operator) > SWEPT:
            return probes.traces(self.operator, x, TRACES)
        found = profile(self.operator, x, TRACES)
        return float(np.sum(1.0 - found.rough)), float(np.sum(found.rough)), float(np.sum(found.variance))

    def _noise2(self, lam: Array) -> Array:
        """Squared load error that noise of unit level makes, tr B H^T H B."""
        grid, values = self._noise_table
        return np.exp(np.interp(np.log(lam), np.log(grid), np.log(values)))

    @cached_property
    def _noise_table(self) -> tuple[Array, Array]:
        grid = self._traces.grid
        if self.operator.order == 0:  # sum of f^2 / c^2 = sum of f (1 - f) / lambda^2
            value = -self._traces.powers(grid).first / (grid * float(self.scale)) ** 2
        else:
            value = np.add(*self._traces.trace(grid))  # dB/dt = -B lambda^2 L^T L B
        # it falls with lambda: where rounding has eaten the difference, at a very small one, that is what is kept
        falling = np.maximum.accumulate(value[::-1])[::-1]
        return grid, np.maximum(falling, np.finfo(float).tiny)

    def _bias2(self, load: Array, response: Array, lam: float) -> tuple[Array, ...]:
        """Squared distance of a load from what would be made of its response: logarithm with two slopes."""
        one, two, three = self._chain(lam, response)[0]
        lost = load - one
        value, first = float(np.sum(lost**2)), 2 * float(np.sum(lost * two))
        second = 2 * float(np.sum(two**2)) + 2 * float(np.sum(lost * (two - 2 * three)))
        return (logs(np.array([[value, first, second]])),)

    def _check(self, lam: Array) -> None:
        if not np.all(np.isfinite(lam)) or np.any(lam < 0.99 * self.lowest):
            raise InputError("lambda is too small for this path", where="lambda", found=float(np.min(lam)),
                             expected=f"a relative lambda of at least {self.lowest:.2g}",
                             hint=Advice("use the dense path (", Option("path", "dense", within="choice=Lambda"),
                                         ") on a window"))  # fmt: skip


# -- the zero-padded path in the frequency domain ----------------------------------------------------------------------
Lines = NDArray[np.complex128]


class SpectralPath(FactoredPath):
    """Zero-padded frequency-domain Tikhonov of a whole record with one lambda; right where the response has decayed.

    Each line is a small problem (sensors x loads) solved by SVD; all lines share lambda and every rule sees them as one
    problem. The record is padded to twice its length, so that the convolution is linear and what the solution puts
    after the record is dropped.

    Parameters
    ----------
    H : array, shape (lines, sensors, loads)
        Frequency response at the lines of the padded transform.
    y : array, shape (samples, sensors)
        Data.
    power : array, shape (lines, sensors)
        Expected energy of the noise in the transform of each channel.
    penalty : str
        Named penalty.
    variance : array, shape (lines, sensors, loads), optional
        Variance of H; widens the posterior.
    excess : array, shape (lines, sensors), optional
        Noise energy beyond `power` on single lines: it does not enter the weights, but widens the posterior.
    filled : array of bool, shape (samples, sensors), optional
        Samples that were not recorded, and for which something stands: a solution takes them for unknown.
    """

    zero_padded = True

    def __init__(
        self, H: Array, y: Array, power: Array, *, penalty: str = "identity", variance: Array | None = None,
        excess: Array | None = None, truncated: bool = False, filled: Mask | None = None,
    ) -> None:  # fmt: skip
        self.samples, sensors = y.shape
        self.padded = padded_length(self.samples)
        lines, loads = self.padded // 2 + 1, H.shape[2]
        if H.shape[:2] != (lines, sensors) or power.shape != (lines, sensors) or np.any(power <= 0):
            raise InputError(
                "lines do not fit the record",
                where="spectral path",
                found=f"H {H.shape}, noise power {power.shape}",
                expected=f"({lines}, {sensors}, loads) and positive ({lines}, {sensors})",
            )
        if not all(np.all(np.isfinite(x)) for x in (H, y, power, *(v for v in (variance, excess) if v is not None))):
            raise InputError("NaN or inf in the model, the record or its noise", where="spectral path",
                             expected="finite numbers", hint="leave out or repair the samples")  # fmt: skip
        # spectra are divided by sqrt(samples): noise has unit energy on each line, and lambda keeps its meaning in time
        self.root = root = np.sqrt(power)
        self.H = H * (np.sqrt(self.samples) / root)[..., None]
        self.Y = fft.rfft(y, self.padded, axis=0) / root
        self.U, c, Vh = np.linalg.svd(self.H, full_matrices=False)
        self.V = Vh.conj().swapaxes(1, 2)
        # what rounding leaves of a silent direction carries no information: sums run over the rank of each line
        c = np.where(c > max(H.shape[1:]) * np.finfo(float).eps * c[:, :1], c, 0.0)
        beta = np.einsum("ksr,ks->kr", self.U.conj(), self.Y)
        outside = np.sum(np.abs(self.Y - np.einsum("ksr,kr->ks", self.U, beta)) ** 2, axis=1)
        self.penalty_lines = symbol(penalty, 2 * np.pi * np.arange(lines) / self.padded)
        self.variance = None if variance is None else variance / power[..., None]
        self.excess = None if excess is None else excess / power
        if self.penalty_lines[0] == 0:
            self._refuse_unseen_constant(c)
        weight = multiplicity(self.padded) * self.samples / self.padded
        modes = c.shape[1]
        super().__init__(
            c.reshape(-1),
            np.repeat(self.penalty_lines, modes),
            beta.reshape(-1),
            float(weight @ outside),
            self.samples * sensors,
            weight=np.repeat(weight, modes),
            null=loads if self.penalty_lines[0] == 0 else 0,
            truncated=truncated,
        )
        self.shape = (lines, modes)
        self.unknowns = self.samples * loads
        self.filled = filled

    def _refuse_unseen_constant(self, c: Array) -> None:
        least = float(c[0].min() / c.max()) if c.shape[1] == self.H.shape[2] and c.max() > 0 else 0.0
        if least <= c.size * np.finfo(float).eps:
            raise NotIdentifiable(
                "a constant load is seen neither by the sensors nor by the penalty "
                f"(relative singular value {least:.2g} at zero frequency)",
                advice=Advice("add a sensor that sees a constant load, or choose ", Option("penalty", "identity")),
                code="LID-E306",
            )

    @property
    def rank(self) -> int:
        """Modes (of lines times loads) above rounding."""
        seen = self.c > self.c.size * np.finfo(float).eps * self.c.max()
        return round(float(np.sum(self.weight[seen])))

    def spectrum(self, lam: float) -> Lines:
        """Load spectrum (lines, loads) of the padded transform."""
        return np.asarray(np.sqrt(self.samples) * np.einsum("klr,kr->kl", self.V, self.gains(lam).reshape(self.shape)))

    def residual(self, lam: float) -> Array:
        """Whitened residual (samples, sensors), unit variance where the noise level is right."""
        lines = self.Y - np.einsum("ksl,kl->ks", self.H, self.spectrum(lam) / np.sqrt(self.samples))
        return np.asarray(fft.irfft(lines, self.padded, axis=0)[: self.samples] * np.sqrt(self.samples))

    def solution(self, lam: float, sigma: float | None) -> Solution:
        """Load history (samples, loads) and its posterior, FRF variance included."""
        G = self.spectrum(lam)
        load = fft.irfft(G, self.padded, axis=0)[: self.samples]
        gaps = None if self.filled is None or not self.smooth else self._gaps(lam, self.filled)
        load = load if gaps is None else load - gaps.shift
        if sigma is None:
            return Solution(load, None)
        band: Posterior = SpectralPosterior(self._covariance(lam, sigma, G), self.samples, self.padded)
        return Solution(load, band if gaps is None else WidenedPosterior(band, sigma * gaps.scatter))

    def _gaps(self, lam: float, filled: Mask) -> Marginal:
        """What samples that were not recorded may be wrong by, for noise of unit level."""
        c = self.c.reshape(self.shape)
        gain = c / (c**2 + (lam * float(self.scale) * self.penalty_lines[:, None]) ** 2)

        def solve(Y: Lines) -> tuple[Lines, Array]:
            G = np.einsum("klr,kr->kl", self.V, gain * np.einsum("ksr,ks->kr", self.U.conj(), Y))
            left = Y - np.einsum("ksl,kl->ks", self.H, G)
            return left, fft.irfft(np.sqrt(self.samples) * G, self.padded, axis=0)[: self.samples]

        return unrecorded(filled, 1 / self.root, self.samples, self.padded, solve, solve(self.Y)[0])

    def resolve(self, load: Array, lam: float) -> Array:
        """What would be estimated from the noise-free response of `load` (samples, loads)."""
        f = self._filter(np.array([lam]))[0].reshape(self.shape)
        modal = np.einsum("klr,kl->kr", self.V.conj(), fft.rfft(load, self.padded, axis=0))
        return np.asarray(fft.irfft(np.einsum("klr,kr->kl", self.V, f * modal), self.padded, axis=0)[: self.samples])

    def _covariance(self, lam: float, sigma: float, G: Lines) -> Lines:
        """Covariance (lines, loads, loads) of the load spectrum: noise, prior and FRF variance."""
        c = self.c.reshape(self.shape)
        if self.smooth:
            prior = (lam * float(self.scale) * self.penalty_lines[:, None]) ** 2
            inside = 1.0 / (c**2 + prior)
            gain = c * inside
        else:
            keep = self._filter(np.array([lam]))[0].reshape(self.shape) > 0
            gain = np.where(keep, 1.0 / np.where(keep, c, 1.0), 0.0)
            inside = gain**2
        C = self.samples * sigma**2 * np.einsum("kir,kr,kjr->kij", self.V, inside, self.V.conj())
        loads = G.shape[1]
        if self.smooth and c.shape[1] < loads:  # what no sensor sees keeps the variance of the prior
            rest = np.eye(loads) - np.einsum("kir,kjr->kij", self.V, self.V.conj())
            C = C + self.samples * sigma**2 * rest / np.maximum(prior, np.finfo(float).tiny)[..., None]
        spread = self._model_error(G, C)
        if spread is None:
            return np.asarray(C)
        Q = np.sqrt(self.samples) * np.einsum("kir,kr,ksr->kis", self.V, gain, self.U.conj())
        return np.asarray(C + np.einsum("kis,ks,kjs->kij", Q, spread, Q.conj()))

    def _model_error(self, G: Lines, C: Lines) -> Array | None:
        """Whitened energy (lines, sensors) that the noise level does not hold: FRF variance and excess."""
        spread = self.excess
        if self.variance is not None:
            # the power of the load itself: its estimate carries noise that must not be counted twice
            power = np.maximum(np.abs(G) ** 2 - np.einsum("kii->ki", C).real, 0.0)
            frf = np.einsum("ksl,kl->ks", self.variance, smooth_lines(power, 5))
            spread = frf if spread is None else spread + frf
        return spread
