"""A load prior of local variance over the lines of a padded spectrum, learned by evidence: for measured FRFs.

    Y(f) = H(f) G(f) + E(f),   g = F w,   w ~ N(0, v),   v = floor + Phi b

F is the memory of the load as in `local_prior`, E of variance ``R = r + var H |G|^2``: noise, and errors of the FRF.
Bumps b stand only where the load acts, on s samples. With ``S = R + floor H F F' H'`` on every line by itself, all else
is a matrix of s rows, Toeplitz by what the transform of ``F' H' S^-1 H F`` says (Woodbury's identity; lines and floor
cost transforms only):

    W = (diag(Phi b)^-1 + M)^-1,   M = [F' H' S^-1 H F],   z = F' H' S^-1 Y,   E[w] = W z + what the floor lets in

Score of the variances, memories and the judgement are those of `local_prior`; noise is white here by its measured
spectrum, and its correlation no question.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, linalg

from structures._testing.spectra import multiplicity, smooth_lines, without_error
from structures.errors import InputError

from ..local_prior import (
    FIRST,
    GAIN,
    HALF,
    LEAST,
    LONGEST,
    MEMORIES,
    NOISELESS,
    SETTLED,
    TINY,
    Judgement,
    best_of,
    bumps,
    input_variance,
    ratio,
    searched,
)
from ..nuisances import Marginal, marginal
from ..posterior import Posterior, SpectralPosterior, WidenedPosterior
from .gaps import unrecorded
from .path import Lines, SpectralPath

Array = NDArray[Any]

POWER = 0.8  # of the update of bumps
MOST, TRIED = 14, 10  # updates of bumps, and those after which memories are compared
AROUND = 3 * HALF  # samples on each side of a load that bumps are given to
WEAKEST = 1e-4  # energy, over the largest, of a load that bumps are given to, where so many can be
GROWN = 10.0  # that limit is raised by, where they cannot
WIDEST = 600  # samples times loads that bumps are learned on
NEIGHBOURS = 5  # lines on each side over which the power of the load is averaged
OVERLOOKED = 25.0  # square of a load beyond the bumps over what chance makes of it, at which it is given some
GUESSES = (0.1, 1e-3)  # share of the data that is noise, where nobody says
LOUDER = 25.0  # power of the noise of a record over that of the tests
ROUNDS = 3  # of looking for more loads
ROWS = 2048  # of the band at once
QUOTIENT = 1e8  # over the median response, of a line that was divided by nothing
ROUNDING = 1e-13  # variance over that of the response, below which noise is rounding


@dataclass(frozen=True, eq=False)
class Spectrum:
    """A whitened record and its model, line by line.

    Parameters
    ----------
    H : array, shape (lines, m, p)
        As `SpectralPath.H`: noise and data have been divided by sqrt(samples).
    Y : array, shape (lines, m)
    samples, padded : int
    variance : array, shape (lines, m, p), optional
        Of H, in the unit of the noise over that of the energy of a load spectrum.
    excess : array, shape (lines, m), optional
        Energy of noise beyond one.
    filled : array of bool, shape (samples, m), optional
        Samples that were not recorded, and for which something stands.
    weighing : array, shape (lines, m), optional
        What lines of data are multiplied by, where such samples are.
    """

    H: Lines
    Y: Lines
    samples: int
    padded: int
    variance: Array | None = None
    excess: Array | None = None
    filled: NDArray[np.bool_] | None = None
    weighing: Array | None = None

    @classmethod
    def of(cls, path: SpectralPath, filled: NDArray[np.bool_] | None = None) -> Spectrum:
        """That of a path; lines at which the force of the test was zero, and its quotient is none, say nothing.

        Nor do those whose FRF is no more than its error: see `structures._testing.spectra.without_error`.
        """
        largest = np.abs(path.H).max(axis=(1, 2), keepdims=True)
        told = largest < QUOTIENT * np.median(largest)
        H, Y = np.where(told, path.H, 0.0), np.where(told[..., 0], path.Y, 0.0)
        weighing, variance = None if filled is None else told[..., 0] / path.root, None
        if path.variance is not None:
            H, variance = without_error(H, np.where(told, path.samples * path.variance, 0.0))
            variance = variance / path.samples
        return cls(H, Y, path.samples, path.padded, variance, path.excess, filled, weighing)

    @cached_property
    def weight(self) -> Array:
        """Of every line in sums over samples."""
        return multiplicity(self.padded) * self.samples / self.padded

    def with_memory(self, memory: float) -> Spectrum:
        """Of the white input of a load with this memory."""
        return replace(self, H=self.H * self.filter(memory)[:, None, None])

    def filter(self, memory: float) -> Lines:
        """Frequency response from the white input to the load, (lines,)."""
        a = float(np.exp(-np.sqrt(3) / memory)) if memory else 0.0
        turn = np.exp(-2j * np.pi * np.arange(len(self.H)) / self.padded)
        return np.asarray(1 / (1 - a * turn) ** 2)

    def to_lines(self, load: Array) -> Lines:
        """Transform of loads (samples, p), (lines, p)."""
        return np.asarray(fft.rfft(load, self.padded, axis=0))

    def pull(self, lines: Lines) -> Array:
        """Samples (padded, ...) of what lines of data are weighed into: the adjoint of the response."""
        return np.asarray(np.sqrt(self.samples) * fft.irfft(lines, self.padded, axis=0))

    def respond(self, load: Array) -> Lines:
        """Lines (lines, m) that a load (samples, p) makes."""
        return np.asarray(np.einsum("ksl,kl->ks", self.H, self.to_lines(load)) / np.sqrt(self.samples))

    def energy(self, load: Array) -> Array:
        """What errors of the FRF add to the noise of every line under a load (samples, p), (lines, m)."""
        beside = np.zeros(self.Y.shape) if self.excess is None else self.excess
        if self.variance is None:
            return beside
        return beside + np.einsum(
            "ksl,kl->ks", self.variance, smooth_lines(np.abs(self.to_lines(load)) ** 2, NEIGHBOURS)
        )


@dataclass(frozen=True, eq=False)
class Weighed:
    """Everything that variances make of a spectrum, by one set of small matrices.

    Parameters
    ----------
    spectrum : Spectrum
        With the memory in it.
    act : array of int, shape (s,)
        Samples that have bumps.
    v : array, shape (s, p)
        Variance of the white input beyond the floor.
    floor : array, shape (p,)
    R : array, shape (lines, m)
        Variance of noise and errors.
    """

    spectrum: Spectrum
    act: Array
    v: Array
    floor: Array
    R: Array

    @cached_property
    def _inverse(self) -> tuple[Lines, Array]:
        """Inverse of S, (lines, m, m), and its ln det."""
        H, m = self.spectrum.H, self.R.shape[1]
        S = np.einsum("kil,l,kjl->kij", H, self.floor, H.conj())
        S[:, range(m), range(m)] += self.R + ROUNDING * np.einsum("kii->k", S).real[:, None]
        if m == 1:
            return 1 / S, np.log(S[:, 0, 0].real)
        L = np.linalg.cholesky(S)
        inverse = np.linalg.solve(S, np.broadcast_to(np.eye(m), S.shape))
        return inverse, 2 * np.sum(np.log(np.einsum("kii->ki", L).real), axis=1)

    @cached_property
    def _weighed(self) -> Lines:
        """S^-1 H, (lines, m, p)."""
        return np.asarray(self._inverse[0] @ self.spectrum.H)

    @cached_property
    def shared(self) -> Lines:
        """H' S^-1 H, (lines, p, p)."""
        return np.asarray(np.einsum("ksi,ksj->kij", self.spectrum.H.conj(), self._weighed))

    def _block(self, lines: Lines, rows: Array) -> Array:
        """Toeplitz matrix of lines (lines, p, p) at samples `rows` and those that have bumps, (rows * p, s * p)."""
        lags = fft.irfft(lines, self.spectrum.padded, axis=0)
        at = (rows[:, None] - self.act[None]) % self.spectrum.padded
        p = lines.shape[1]
        return np.asarray(lags[at].transpose(0, 2, 1, 3).reshape(len(rows) * p, len(self.act) * p))

    @cached_property
    def M(self) -> Array:
        """Information of the data on the loads that have bumps, (s * p, s * p)."""
        return self._block(self.shared, self.act)

    @cached_property
    def root(self) -> tuple[Array, Array]:
        """X with W = X X', and the diagonal of the Cholesky factor that it is made of."""
        q = np.sqrt(self.v).reshape(-1)
        told = q[:, None] * self.M * q
        L = linalg.cholesky(told + (1.0 + ROUNDING * np.trace(told)) * np.eye(len(q)), lower=True)
        return np.asarray(linalg.solve_triangular(L, np.diag(q), lower=True).T), np.diag(L)

    @cached_property
    def W(self) -> Array:
        """Covariance of the input under the bumps, (s * p, s * p)."""
        X = self.root[0]
        return np.asarray(X @ X.T)

    def estimate(self, Y: Lines) -> tuple[Array, Lines, Array]:
        """White input under the bumps (s * p,), Sigma^-1 Y (lines, m), and all of the white input (padded, p)."""
        one, inverse = self.spectrum, self._inverse[0]
        pulled = one.pull(np.einsum("ksl,ks->kl", self._weighed.conj(), Y))
        u = self.W @ pulled[self.act].reshape(-1)
        whole = np.zeros((one.samples, len(self.floor)))
        whole[self.act] = u.reshape(-1, len(self.floor))
        E = np.einsum("kst,kt->ks", inverse, Y - one.respond(whole))
        let_in = self.floor * one.pull(np.einsum("ksl,ks->kl", one.H.conj(), E))
        let_in[: one.samples] += whole
        return u, E, let_in

    @cached_property
    def of_data(self) -> tuple[Array, Lines, Array]:
        """The estimate from the data."""
        return self.estimate(self.spectrum.Y)

    @property
    def evidence(self) -> float:
        """Log likelihood of the whitened data."""
        Y, (inverse, logdet) = self.spectrum.Y, self._inverse
        each = logdet + np.einsum("ks,kst,kt->k", Y.conj(), inverse, Y).real
        z = self.spectrum.pull(np.einsum("ksl,ks->kl", self._weighed.conj(), Y))[self.act].reshape(-1)
        return float(-0.5 * self.spectrum.weight @ each - np.sum(np.log(self.root[1])) + 0.5 * z @ self.of_data[0])

    def scores(self) -> tuple[Array, Array]:
        """rho^2 and Q of every sample that has bumps, (s, p)."""
        p, (_, E, _) = len(self.floor), self.of_data
        rho = self.spectrum.pull(np.einsum("ksl,ks->kl", self.spectrum.H.conj(), E))[self.act]
        MX = self.M @ self.root[0]
        known = np.diag(self.M) - np.einsum("ij,ij->i", MX, MX)
        return rho**2, np.maximum(known.reshape(-1, p), 0.0)

    @cached_property
    def _bumps_on_lines(self) -> Lines:
        """Covariance of the transform of the input under the bumps over the samples, (lines, p, p)."""
        p, padded = len(self.floor), self.spectrum.padded
        W = self.W.reshape(len(self.act), p, len(self.act), p).transpose(0, 2, 1, 3)
        sums = np.zeros((padded, p, p))
        np.add.at(sums, (self.act[:, None] - self.act[None]) % padded, W)
        return np.asarray(fft.rfft(sums, axis=0) / self.spectrum.samples)

    def line_scores(self) -> tuple[Array, Array, Array, Array]:
        """Squares and expectations: of the pulled residual of every load (p,), and of every channel, (lines, m)."""
        one, E = self.spectrum, self.of_data[1]
        pulled = np.einsum("ksl,ks->kl", one.H.conj(), E)
        inside = self._bumps_on_lines
        known = self.shared - self.shared @ inside @ self.shared.conj().swapaxes(1, 2)
        A = self._weighed
        each = np.einsum("kss->ks", self._inverse[0]).real - np.einsum("ksi,kij,ksj->ks", A, inside, A.conj()).real
        diagonal = np.einsum("kll->kl", known).real
        return one.weight @ np.abs(pulled) ** 2, one.weight @ diagonal, np.abs(E) ** 2, each


class LinesFit:
    """The variances while they are learned.

    Parameters
    ----------
    whole : Spectrum
        Of the load itself.
    memory : float
    act : array of int
        Samples that bumps are given to; none for a constant variance.
    stated : bool
        The noise is.
    """

    def __init__(self, whole: Spectrum, memory: float, act: Array, stated: bool) -> None:
        self.whole, self.memory, self.act, self.stated = whole, memory, act, stated
        self.spectrum, self._filter = whole.with_memory(memory), whole.filter(memory)
        p, m = whole.H.shape[2], whole.H.shape[1]
        phi = bumps(whole.samples)[act]
        self.phi = phi[:, np.flatnonzero(np.asarray(phi.sum(axis=0)).reshape(-1) > 0)]
        self.b, self.floor, self.r = np.zeros((self.phi.shape[1], p)), np.ones(p), np.ones(m)
        self.square = whole.weight @ np.abs(whole.Y) ** 2 / whole.samples
        self.energy = np.zeros(whole.Y.shape)  # of errors of the FRF, beyond the noise
        self.evidence, self.updates = -np.inf, 0

    def like(self, memory: float, act: Array) -> LinesFit:
        """The same variances of the load with another memory, or on more samples."""
        new = LinesFit(self.whole, memory, act, self.stated)
        part = input_variance(memory) / input_variance(self.memory)
        new.floor, new.r, new.energy = self.floor * part, self.r.copy(), self.energy
        if np.array_equal(act, self.act):
            new.b = self.b * part
        elif len(act):
            new.b[:] = 0.45 * new.floor
        return new

    def weighed(self) -> Weighed:
        """As they are now."""
        return Weighed(self.spectrum, self.act, self.phi @ self.b, self.floor, self.r + self.energy)

    def load(self, white: Array) -> Array:
        """Load (samples, p) of a white input (padded, p)."""
        lines = fft.rfft(white, axis=0) * self._filter[:, None]
        return np.asarray(fft.irfft(lines, self.whole.padded, axis=0)[: self.whole.samples])

    def climb(self, most: int, power: float = POWER) -> Weighed:
        """Update until the evidence gains no more; the last pass, whose variances are kept."""
        before = -np.inf
        for step in range(most + 1):
            pass_ = self.weighed()
            self.evidence = pass_.evidence if np.isfinite(pass_.evidence) else -np.inf
            if step == most or (not self.evidence - before >= GAIN and step > 2):
                break
            before = self.evidence
            self._update(pass_, power)
            self.updates += 1
        return pass_

    def _update(self, pass_: Weighed, power: float) -> None:
        pulled, expected, square, known = pass_.line_scores()
        if len(self.act):
            up, down = pass_.scores()
            self.b *= ratio(self.phi.T @ up, self.phi.T @ down, power)
        self.floor *= ratio(pulled, expected, power)
        least = LEAST * (self.b.max(axis=0, initial=0.0) + self.floor)
        self.b[self.b < least] = 0.0
        self.floor = np.maximum(self.floor, least)
        if not self.stated:
            weight = self.whole.weight
            self.r *= ratio(weight @ square, weight @ known, power)
            self.r = np.maximum(self.r, np.maximum(NOISELESS * self.square, TINY))

    def overlooked(self) -> Array:
        """Samples without bumps at which the data ask for more load than the floor lets in."""
        pass_ = self.weighed()
        H, E = self.spectrum.H, pass_.of_data[1]
        pulled = self.spectrum.pull(np.einsum("ksl,ks->kl", H.conj(), E))[: self.whole.samples]
        expected = fft.irfft(np.einsum("kll->kl", pass_.shared), self.whole.padded, axis=0)[0]
        asked = np.any(pulled**2 > OVERLOOKED * np.maximum(expected, TINY), axis=1)
        asked[self.act] = False
        return np.flatnonzero(asked)


class LocalLinesPosterior:
    """Covariance of a load whose prior variance changes with time, by lines and a few columns.

    Parameters
    ----------
    lines : array, shape (lines, p, p)
        Covariance of the load spectrum under the floor alone, as that of `SpectralPosterior`.
    carried : array, shape (lines, p, p)
        From the input under the bumps to the load, beside what it keeps of the floor.
    root : array, shape (s * p, r)
        X of the covariance X X' of the input under the bumps.
    act : array of int, shape (s,)
    samples, padded : int
    """

    kind = "local variance, lines"

    def __init__(self, lines: Lines, carried: Lines, root: Array, act: Array, samples: int, padded: int) -> None:
        self._floor = SpectralPosterior(lines, samples, padded)
        self.carried, self.root, self.act = carried, root, act
        self.shape = (samples, lines.shape[1])

    @cached_property
    def std(self) -> Array:
        """Standard deviation, shape (samples, loads)."""
        samples, p = self.shape
        lags = fft.irfft(self.carried, self._floor.padded, axis=0)
        moved = np.empty((samples, p))
        for start in range(0, samples, ROWS):
            rows = np.arange(start, min(start + ROWS, samples))
            at = (rows[:, None] - self.act[None]) % self._floor.padded
            columns = lags[at].transpose(0, 2, 1, 3).reshape(len(rows) * p, -1) @ self.root
            moved[rows] = np.sum(columns**2, axis=1).reshape(-1, p)
        return np.sqrt(self._floor.std**2 + moved)

    def variance(self, w: Array) -> Array:
        """Variance of ``sum(w * load)``; `w` is (samples, loads) or (k, samples, loads)."""
        w = np.asarray(w, float)
        if w.shape[-2:] != self.shape or w.ndim > 3:
            raise InputError("the weights do not fit the load", where="w", found=f"shape {w.shape}",
                             expected=f"shape {self.shape}, or a stack of such")  # fmt: skip
        lines = np.einsum("kij,...ki->...kj", self.carried.conj(), fft.rfft(w, self._floor.padded, axis=-2))
        back = fft.irfft(lines, self._floor.padded, axis=-2)[..., self.act, :]
        columns = back.reshape(*w.shape[:-2], -1) @ self.root
        return np.asarray(self._floor.variance(w) + np.sum(columns**2, axis=-1))

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        samples, padded = self._floor.samples, self._floor.padded
        return {"kind": self.kind, "lines": self._floor.lines, "carried": self.carried, "root": self.root,
                "act": self.act, "samples": samples, "padded": padded}  # fmt: skip

    @classmethod
    def from_arrays(cls, tree: dict[str, Any]) -> LocalLinesPosterior:
        """From what `to_arrays` gave."""
        lines, carried = np.asarray(tree["lines"]), np.asarray(tree["carried"])
        return cls(lines, carried, np.asarray(tree["root"], float), np.asarray(tree["act"]).astype(int),
                   int(tree["samples"]), int(tree["padded"]))  # fmt: skip


@dataclass(frozen=True, eq=False)
class LocalLinesPrior(Judgement):
    """A load whose variance changes with time, learned from lines; attributes as of `local_prior.LocalPrior`."""

    fit: LinesFit
    gaps: Marginal | None = None

    @cached_property
    def pass_(self) -> Weighed:
        """What the variances make of the record."""
        return self.fit.weighed()

    @property
    def data(self) -> int:
        """Number of data."""
        return self.fit.whole.samples * self.fit.whole.H.shape[1]

    def posterior(self, errors: Marginal | None = None) -> tuple[Array, Posterior, None]:
        """Mean of the load (samples, p), its posterior with these errors of the model; no state that it starts from."""
        load, one, w = self.fit.load(self.pass_.of_data[2]), self.fit.spectrum, self.pass_
        filter_, floor = self.fit.spectrum.filter(self.memory), w.floor
        kept = np.eye(len(floor)) - floor[:, None] * w.shared
        lines = one.samples * np.abs(filter_[:, None, None]) ** 2 * kept * floor
        carried = filter_[:, None, None] * kept
        band: Posterior = LocalLinesPosterior(lines, carried, w.root[0], w.act, one.samples, one.padded)
        if self.gaps is not None:
            load, band = load - self.gaps.shift, WidenedPosterior(band, self.gaps.scatter)
        return load, band if errors is None else WidenedPosterior(band, errors.spread), None

    def resolved(self, load: Array) -> Array:
        """What would be estimated from the noise-free response of a load (samples, p)."""
        return self.fit.load(self.pass_.estimate(self.fit.whole.respond(load))[2])

    def freedom(self) -> float:
        """Effective degrees of freedom of the load."""
        _, known = self.pass_.scores()
        _, expected, _, _ = self.pass_.line_scores()
        return float(np.sum(self.pass_.v * known) + self.pass_.floor @ expected)

    def unexplained(self, excused: Array | float = 0.0, varying: Array | float = 1.0) -> float:
        """Sum of the squares of the whitened data that neither the load nor errors of the FRF explain.

        Noise that was learned is that of tests: a record may have `LOUDER` times its power. Of the energy of each
        response a share may be `excused`, and of that of its residual a share counts as `varying`, (m,).
        """
        rest, noise = np.abs(self.pass_.R * self.pass_.of_data[1]) ** 2, np.clip(self.fit.r, 1.0, LOUDER)
        left = (varying * rest - excused * np.abs(self.fit.whole.Y) ** 2) / (noise + self.fit.energy)
        return float(np.sum(np.maximum(self.fit.whole.weight @ left, 0.0)))

    def with_gaps(self) -> LocalLinesPrior:
        """The prior without what stands for samples that were not recorded: each is an unknown of its own."""
        one = self.fit.whole
        if one.filled is None or one.weighing is None:
            return self

        def solve(lines: Lines) -> tuple[Lines, Array]:
            _, E, white = self.pass_.estimate(lines)
            return E, self.fit.load(white)

        rest = self.pass_.of_data[1]
        return replace(self, gaps=unrecorded(one.filled, one.weighing, one.samples, one.padded, solve, rest))

    def with_gains(self, covariance: Array) -> LocalLinesPrior:
        """The prior with errors of the gains in its band, as far as the data do not rule them out, (m, m)."""
        one, rest = self.fit.whole, self.pass_.R * self.pass_.of_data[1]
        white = fft.rfft(self.pass_.of_data[2], axis=0) / np.sqrt(one.samples)  # also of what the padding holds
        each = [one.pull(response) for response in (self.fit.spectrum.H * white[:, None, :]).transpose(2, 0, 1)]
        columns = np.array([sum(each) * at for at in np.eye(one.H.shape[1])])

        def solve(data: Array) -> tuple[Array, Array]:
            lines = fft.rfft(data, axis=0) / np.sqrt(one.samples)
            _, E, white = self.pass_.estimate(lines)
            return one.pull(E), self.fit.load(white)

        at = np.zeros(len(columns))
        return replace(self, errors=marginal(columns, solve, one.pull(rest), covariance, at, np.array(each)))


def active(load: Array, most: int) -> Array:
    """Samples around those at which a load (samples, p) has energy, at most so many; none where there are more."""
    energy = np.array([np.convolve(g**2, np.ones(HALF) / HALF, "same") for g in load.T]).T
    share = np.max(energy / np.maximum(energy.max(axis=0), TINY), axis=1)
    least = WEAKEST
    while least < 1.0:
        act = widened(share > least)
        if len(act) <= most:
            return act
        least *= GROWN
    return np.zeros(0, int)


def widened(where: Array) -> Array:
    """Samples that are so near to one of those."""
    return np.flatnonzero(np.convolve(where, np.ones(2 * AROUND + 1), "same") > 0.5)


def local_lines(spectrum: Spectrum, load: Array, *, known: bool = False, stated: bool = False) -> LocalLinesPrior | str:
    """Learn both priors from a spectrum, or say why none was learned.

    Parameters
    ----------
    spectrum : Spectrum
    load : array, shape (samples, p)
        First estimate, which says where bumps may stand.
    known, stated : bool
        The whitened variance of the noise is about 1; it stays 1.
    """
    act = active(load, WIDEST // load.shape[1])
    if not len(act):
        return "the load acts over too many samples to learn it"
    if act[0] >= spectrum.samples - 2 * AROUND - 1:  # the padding folds what has not decayed back to there
        return "the load acts at the end of the record alone, where the response is cut off"
    still = searched(_constant(spectrum, load, known, stated), FIRST, SETTLED, 1.0, _moved)
    top = max(still, key=lambda i: still[i].evidence)
    seed = still[top].like(MEMORIES[top], act)
    seed.floor = 0.1 * seed.floor
    seed.climb(TRIED)
    local = searched(seed, top, TRIED, POWER, _moved)
    most = max(LONGEST, MEMORIES[top])  # bumps beside a longer memory are pulses cut out of a slow load
    best, slower = best_of(local, most)
    chosen = local[best]
    chosen.climb(MOST)
    chosen = _with_overlooked(chosen, WIDEST // load.shape[1])
    compared = np.tile(chosen.floor, (spectrum.samples, 1))
    compared[chosen.act] += chosen.phi @ chosen.b
    every = bumps(spectrum.samples).shape[1] * load.shape[1]
    evidence = chosen.evidence
    updates = sum(one.updates for one in (*still.values(), *local.values()))
    chosen.energy = spectrum.energy(chosen.load(chosen.weighed().of_data[2]))
    chosen.climb(MOST)
    return LocalLinesPrior(
        evidence=evidence, memory=chosen.memory, stationary=still[top], compared=compared, correlation=0.0,
        misfit=0.0, bumps=every, updates=updates, slower=slower, errors=None, fit=chosen,
    )  # fmt: skip


def _with_overlooked(fit: LinesFit, most: int) -> LinesFit:
    """The fit with bumps where the data ask for more, as long as there is room."""
    for _ in range(ROUNDS):
        more = fit.overlooked()
        where = np.zeros(fit.whole.samples, bool)
        where[more] = True
        act = np.union1d(fit.act, widened(where)) if len(more) else fit.act
        if len(act) == len(fit.act) or len(act) > most:
            return fit
        wider = fit.like(fit.memory, act)
        wider.climb(TRIED + MOST)
        if not wider.evidence > fit.evidence:
            return fit
        fit = wider
    return fit


def _moved(old: LinesFit, before: float, memory: float) -> LinesFit:
    return old.like(memory, old.act)


def _constant(spectrum: Spectrum, load: Array, known: bool, stated: bool) -> LinesFit:
    """Best constant variances of a load with the first memory, from guesses of the noise."""
    none = np.zeros(0, int)
    fits = []
    for share in (1.0,) if known else GUESSES:
        one = LinesFit(spectrum, MEMORIES[FIRST], none, stated)
        one.energy = spectrum.energy(load)
        one.floor = np.maximum(np.mean(load**2, axis=0) * input_variance(MEMORIES[FIRST]), TINY)
        one.r = np.ones(len(one.r)) if known else np.maximum(share * one.square, TINY)
        one.climb(SETTLED, 1.0)
        fits.append(one)
    best = max(fits, key=lambda one: one.evidence)
    best.climb(SETTLED, 1.0)
    return best
