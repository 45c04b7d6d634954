"""Convolution as an operator: block Toeplitz matrix, FFT products whole or in blocks, and the zero-padded FFT path.

Time last keeps each transform contiguous. Everything here is linear algebra: no data, no lambda.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from structures.advice import Advice, Option
from structures.errors import InputError, NotIdentifiable
from structures.testing.spectra import multiplicity, padded_length, smooth_lines

from . import penalties
from .arrays import Array, Numbers
from .path import FactoredPath, Solution
from .penalties import symbol
from .posterior import SpectralPosterior
from .svd import Factors, paired, plain


class Convolution:
    """``(H g)_k = sum_j h_j g_{k-j}`` for k = 0 .. samples - 1, and its transpose, without the Toeplitz matrix.

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
        Impulse responses, whitened; cut or taken as zero beyond `samples`.
    samples : int, optional
        Length of the record; default the number of taps.
    weight : array, shape (samples, sensors), optional
        What each datum is multiplied by (0 for a missing one): rows of H are scaled by it.
    """

    def __init__(self, h: Numbers, samples: int | None = None, weight: Numbers | None = None) -> None:
        from scipy import fft

        self.samples = len(h) if samples is None else int(samples)
        self.sensors, self.loads = h.shape[1:]
        self.weight = weight
        if weight is not None and weight.shape != (self.samples, self.sensors):
            raise InputError("the weights do not fit the record", where="convolution", found=f"shape {weight.shape}",
                             expected=f"({self.samples}, {self.sensors})")  # fmt: skip
        self.padded = padded_length(self.samples)
        self.lines = fft.rfft(h[: self.samples], self.padded, axis=0)

    @property
    def shape(self) -> tuple[int, int]:
        """Data and unknowns."""
        return self.samples * self.sensors, self.samples * self.loads

    def apply(self, g: Numbers) -> Array:
        """H g: loads (samples, loads) to responses (samples, sensors)."""
        from scipy import fft

        G = fft.rfft(g, self.padded, axis=0)
        y = fft.irfft(np.einsum("ksl,kl->ks", self.lines, G), self.padded, axis=0)[: self.samples]
        return np.asarray(y if self.weight is None else y * self.weight)

    def adjoint(self, r: Numbers) -> Array:
        """H^T r: responses (samples, sensors) to loads (samples, loads)."""
        from scipy import fft

        R = fft.rfft(r if self.weight is None else r * self.weight, self.padded, axis=0)
        return np.asarray(fft.irfft(np.einsum("ksl,ks->kl", self.lines.conj(), R), self.padded, axis=0)[: self.samples])


BLOCK = 1 << 14  # samples of a block, unless the responses are longer
EMPTY = 1e-15  # share of its norm that an impulse response may lose at its end


def heard(h: Numbers) -> Array:
    """Impulse responses (taps, sensors, loads) without an end that is zero to rounding."""
    left = np.sqrt(np.cumsum(np.sum(h**2, axis=(1, 2))[::-1])[::-1])
    return h[: max(int(np.sum(left > EMPTY * left[0])), 1)]


class Stream:
    """``H g`` and ``H^T r`` over a part of a record; time is on the last axis, but for h.

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
    block : int, optional
        Samples that `response` and `adjoint` are asked for, at most.
    """

    def __init__(self, h: Numbers, block: int | None = None) -> None:
        from scipy import fft

        self.taps, self.block = len(h), max(BLOCK, len(h)) if block is None else int(block)
        self.length = int(fft.next_fast_len(self.taps + self.block, real=True))
        self.lines = fft.rfft(np.moveaxis(h, 0, -1), self.length)

    def response(self, g: Numbers, start: int, stop: int, before: int | None = None) -> Array:
        """Responses (sensors, stop - start) to a load (loads, samples), or to what of it comes before a sample."""
        from scipy import fft

        first = max(start - self.taps + 1, 0)
        G = fft.rfft(g[:, first : stop if before is None else before], self.length)
        full = fft.irfft(np.einsum("slk,lk->sk", self.lines, G), self.length)
        return np.asarray(full[:, start - first : stop - first])

    def adjoint(self, r: Numbers, start: int, stop: int) -> Array:
        """Loads (loads, stop - start) of H^T r."""
        from scipy import fft

        R = fft.rfft(r[:, start : stop + self.taps - 1], self.length)
        return np.asarray(fft.irfft(np.einsum("slk,sk->lk", self.lines.conj(), R), self.length)[:, : stop - start])

    def whole(self, g: Numbers) -> Array:
        """Responses (sensors, samples) to a load (loads, samples) over its whole length."""
        out = np.empty((self.lines.shape[0], g.shape[1]))
        for a in range(0, g.shape[1], self.block):
            out[:, a : a + self.block] = self.response(g, a, min(a + self.block, g.shape[1]))
        return out

    def whole_adjoint(self, r: Numbers) -> Array:
        """Loads (loads, samples) of H^T r over the whole length."""
        out = np.empty((self.lines.shape[1], r.shape[1]))
        for a in range(0, r.shape[1], self.block):
            out[:, a : a + self.block] = self.adjoint(r, a, min(a + self.block, r.shape[1]))
        return out


def toeplitz(h: Numbers) -> Array:
    """Lower block triangular Toeplitz operator of impulse responses (samples, sensors, loads).

    Returns
    -------
    array, shape (samples, sensors, samples * loads)
    """
    N, m, p = h.shape
    padded = np.concatenate([np.zeros((N - 1, m, p)), h])
    # row t holds h[t], h[t-1], ... h[t-N+1]: windows of the padded history, read backwards
    windows = np.lib.stride_tricks.sliding_window_view(padded, N, axis=0)[..., ::-1]  # (N, m, p, N)
    return np.ascontiguousarray(windows.transpose(0, 1, 3, 2)).reshape(N, m, N * p)


def decomposed(H: Numbers, Y: Numbers) -> tuple[Numbers, Numbers, Numbers, Numbers, Numbers]:
    """Batched SVD of whitened lines.

    Parameters
    ----------
    H : array, shape (lines, sensors, loads)
    Y : array, shape (lines, sensors)

    Returns
    -------
    U (lines, sensors, r), c (lines, r), zero below rounding, V (lines, loads, r), beta (lines, r), outside (lines,)
    """
    U, c, Vh = np.linalg.svd(H, full_matrices=False)
    # what rounding leaves of a silent direction carries no information: sums run over the rank of each line
    c = np.where(c > max(H.shape[1:]) * np.finfo(float).eps * c[:, :1], c, 0.0)
    beta = np.einsum("ksr,ks->kr", U.conj(), Y)
    outside = np.sum(np.abs(Y - np.einsum("ksr,kr->ks", U, beta)) ** 2, axis=1)
    return U, c, Vh.conj().swapaxes(1, 2), beta, outside


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
    """

    zero_padded = True

    def __init__(
        self,
        H: Numbers,
        y: Numbers,
        power: Numbers,
        *,
        penalty: str = "identity",
        variance: Numbers | None = None,
        excess: Numbers | None = None,
        truncated: bool = False,
    ) -> None:
        from scipy import fft

        self.samples, sensors = y.shape
        self.padded = padded_length(self.samples)
        lines, loads = self.padded // 2 + 1, H.shape[2]
        if H.shape[:2] != (lines, sensors) or power.shape != (lines, sensors) or np.any(power <= 0):
            raise InputError("lines do not fit the record", where="spectral path",
                             found=f"H {H.shape}, noise power {power.shape}",
                             expected=f"({lines}, {sensors}, loads) and positive ({lines}, {sensors})")  # fmt: skip
        if not all(np.all(np.isfinite(x)) for x in (H, y, power, *(v for v in (variance, excess) if v is not None))):
            raise InputError("NaN or inf in the model, the record or its noise", where="spectral path",
                             expected="finite numbers", hint="leave out or repair the samples")  # fmt: skip
        # spectra are divided by sqrt(samples): noise has unit energy on each line, and lambda keeps its meaning in time
        root = np.sqrt(power)
        self.H = H * (np.sqrt(self.samples) / root)[..., None]
        self.Y = fft.rfft(y, self.padded, axis=0) / root
        self.U, c, self.V, beta, outside = decomposed(self.H, self.Y)
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

    def _refuse_unseen_constant(self, c: Numbers) -> None:
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

    def spectrum(self, lam: float) -> NDArray[np.complex128]:
        """Load spectrum (lines, loads) of the padded transform."""
        return np.asarray(np.sqrt(self.samples) * np.einsum("klr,kr->kl", self.V, self.gains(lam).reshape(self.shape)))

    def residual(self, lam: float) -> Array:
        """Whitened residual (samples, sensors), unit variance where the noise level is right."""
        from scipy import fft

        lines = self.Y - np.einsum("ksl,kl->ks", self.H, self.spectrum(lam) / np.sqrt(self.samples))
        return np.asarray(fft.irfft(lines, self.padded, axis=0)[: self.samples] * np.sqrt(self.samples))

    def solution(self, lam: float, sigma: float | None) -> Solution:
        """Load history (samples, loads) and its posterior, FRF variance included."""
        from scipy import fft

        G = self.spectrum(lam)
        load = fft.irfft(G, self.padded, axis=0)[: self.samples]
        if sigma is None:
            return Solution(load, None)
        return Solution(load, SpectralPosterior(self._covariance(lam, sigma, G), self.samples, self.padded))

    def resolve(self, load: Numbers, lam: float) -> Array:
        """What would be estimated from the noise-free response of `load` (samples, loads)."""
        from scipy import fft

        f = self._filter(np.array([lam]))[0].reshape(self.shape)
        modal = np.einsum("klr,kl->kr", self.V.conj(), fft.rfft(load, self.padded, axis=0))
        return np.asarray(fft.irfft(np.einsum("klr,kr->kl", self.V, f * modal), self.padded, axis=0)[: self.samples])

    def _covariance(self, lam: float, sigma: float, G: Numbers) -> Numbers:
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

    def _model_error(self, G: Numbers, C: Numbers) -> Numbers | None:
        """Whitened energy (lines, sensors) that the noise level does not hold: FRF variance and excess."""
        spread = self.excess
        if self.variance is not None:
            # the power of the load itself: its estimate carries noise that must not be counted twice
            power = np.maximum(np.abs(G) ** 2 - np.einsum("kii->ki", C).real, 0.0)
            frf = np.einsum("ksl,kl->ks", self.variance, smooth_lines(power, 5))
            spread = frf if spread is None else spread + frf
        return spread


class Operator:
    """``(H g)_k = sum_j h_j g_{k-j}``, weighted, and the difference penalty L, with their transposes.

    Loads are arrays (k, loads, samples), responses (k, sensors, samples), differences (k, loads, samples - order).

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
        Impulse responses of the whitened data; cut, or zero beyond their end.
    samples : int
        Length of the record.
    penalty : str
        Named penalty, a difference of any order, ends free.
    weight : array, shape (samples, sensors), optional
        What each datum is multiplied by; 0 for a missing one.
    """

    def __init__(self, h: Numbers, samples: int, penalty: str = "identity", weight: Numbers | None = None) -> None:
        self.samples, (self.sensors, self.loads) = int(samples), h.shape[1:]
        self.penalty, self.order = penalty, penalties.order(penalty)
        if self.samples <= self.order:
            raise InputError("too few samples for this penalty", where="penalty", found=self.samples,
                             expected=f"more than {self.order} for {penalty}")  # fmt: skip
        self.h = np.ascontiguousarray(np.moveaxis(h[: self.samples], 0, -1), float)  # (sensors, loads, taps)
        self.padded = padded_length(self.samples)
        self.weight = None if weight is None else np.ascontiguousarray(weight.T, float)

    @cached_property
    def lines(self) -> NDArray[np.complex128]:
        """Transform of the impulse responses, (sensors, loads, lines); made when first asked for."""
        return self.transform(self.h)

    @property
    def rows(self) -> int:
        """Rows of the penalty for one load."""
        return self.samples - self.order

    @cached_property
    def modes(self) -> Factors:
        """Factorisation of the pair (H, L) written out, unknowns flattened as (samples, loads)."""
        h = np.zeros((self.samples, self.sensors, self.loads))
        h[: self.h.shape[-1]] = np.moveaxis(self.h, -1, 0)
        H = toeplitz(h)
        if self.weight is not None:
            H *= self.weight.T[:, :, None]
        R = np.asarray(np.linalg.qr(H.reshape(-1, H.shape[-1]), mode="r"))
        L = penalties.matrix(self.penalty, self.samples, self.loads)
        return plain(R) if L is None else paired(R, L)

    def cut(self, samples: int) -> Operator:
        """The same for the first samples alone."""
        weight = None if self.weight is None else self.weight[:, :samples].T
        return Operator(np.moveaxis(self.h, -1, 0), samples, self.penalty, weight)

    def with_penalty(self, penalty: str) -> Operator:
        """The same with another penalty."""
        return Operator(
            np.moveaxis(self.h, -1, 0), self.samples, penalty, None if self.weight is None else self.weight.T
        )

    def transform(self, x: Numbers) -> NDArray[np.complex128]:
        """Lines of the padded transform."""
        from scipy import fft

        return np.asarray(fft.rfft(x, self.padded))

    def record(self, lines: Numbers) -> Array:
        """The samples of the record from lines of the padded transform."""
        from scipy import fft

        return np.asarray(fft.irfft(lines, self.padded, overwrite_x=True)[..., : self.samples])

    def apply(self, g: Numbers) -> Array:
        """H g."""
        y = self.record(_mix(self.lines, self.transform(g)))
        return y if self.weight is None else y * self.weight

    def adjoint(self, r: Numbers) -> Array:
        """H^T r."""
        R = self.transform(r if self.weight is None else r * self.weight)
        return self.record(np.conj(_mix(self.lines.swapaxes(0, 1), np.conj(R, out=R))))

    def rough(self, g: Numbers) -> Array:
        """L g."""
        for _ in range(self.order):
            g = g[..., 1:] - g[..., :-1]
        return g

    def rough_adjoint(self, d: Numbers) -> Array:
        """L^T d."""
        for _ in range(self.order):
            wider = np.empty((*d.shape[:-1], d.shape[-1] + 1))
            wider[..., 0], wider[..., -1] = -d[..., 0], d[..., -1]
            np.subtract(d[..., :-1], d[..., 1:], out=wider[..., 1:-1])
            d = wider
        return d


def _mix(matrix: Numbers, x: Numbers) -> NDArray[np.complex128]:
    """Product line by line: (rows, columns, lines) with (k, columns, lines)."""
    rows, columns = matrix.shape[:2]
    out = np.empty((len(x), rows, x.shape[-1]), complex)
    for k in range(len(x)):
        for i in range(rows):
            np.multiply(matrix[i, 0], x[k, 0], out=out[k, i])
            for j in range(1, columns):
                out[k, i] += matrix[i, j] * x[k, j]
    return out
