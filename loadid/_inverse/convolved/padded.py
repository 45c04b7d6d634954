"""The zero-padded frequency-domain path of a record: right where the response has decayed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from structures._advice import Advice, Option
from structures._testing.spectra import multiplicity, padded_length, smooth_lines
from structures.errors import InputError, NotIdentifiable

from ..path import FactoredPath, Solution
from ..penalties import symbol
from ..posterior import SpectralPosterior

Array = NDArray[np.float64]
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
    """

    zero_padded = True

    def __init__(
        self, H: Array, y: Array, power: Array, *, penalty: str = "identity", variance: Array | None = None,
        excess: Array | None = None, truncated: bool = False,
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
        root = np.sqrt(power)
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
        if sigma is None:
            return Solution(load, None)
        return Solution(load, SpectralPosterior(self._covariance(lam, sigma, G), self.samples, self.padded))

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
