"""Deconvolution: load histories from response histories, Tikhonov or truncated SVD, any length of record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, NotIdentifiable
from structures.flags import Flag
from structures.model import Model
from structures.spectra import padded_length

from .. import flags as guards
from ..estimate import Axis, LoadEstimate
from ..inverse import diagnose, penalties
from ..inverse.choice import Choice, choose, residual_level
from ..inverse.problem import LinearProblem
from ..inverse.svd import SVDPath
from ..inverse.toeplitz import SpectralPath, toeplitz
from ..inverse.weights import roughness
from ..provenance import provenance
from . import noise as noises
from .data import Data, gather, health

DENSE = 2000  # unknowns up to which the exact dense path is taken
UNUSABLE = 1e-12  # |h(0)| over max |h| below which the diagonal is zero
PRIOR = {
    "identity": "a load of zero mean and constant variance, white in time",
    "first_difference": "a random walk in time",
    "gradient": "a random walk in time",
    "second_difference": "an integrated random walk in time",
    "laplacian": "an integrated random walk in time",
}


@dataclass(frozen=True)
class Posed:
    """A problem as posed: its path, and what maps a load back to responses."""

    path: SVDPath | SpectralPath
    noise: noises.Noise
    predict: Callable[[NDArray], NDArray]
    values: NDArray[np.float64]
    name: str
    h: NDArray[np.float64] | None
    full: tuple[float, int, int] | None


class Deconvolution:
    """Load histories from response histories.

    Minimises ``|R^(-1/2) (h * g - y)|^2 + lambda^2 |L g|^2`` over whole records (Jacquelin, Bennani & Hamelin, J. Sound
    Vib. 265 (2003) 81, for the problem; Hansen, SIAM 1998, for the method). Records of up to 2000 unknowns are solved
    exactly by SVD; longer ones, and measured models, line by line over the zero-padded spectrum with one lambda, which
    is right where the response decays within the record (flag W505 says when it does not).

    Parameters
    ----------
    model : Model
        Anything that gives ``impulse_response`` (and ``frf`` for measured models).
    method : {"tikhonov", "tsvd"}
    penalty : str, array or None
        ``identity, first_difference, second_difference`` (``gradient``, ``laplacian``), a matrix of shape
        (rows, samples * loads), or None for plain least squares, refused where the data do not determine the load.
    choice : str, float or None
        Rule, or relative lambda; None chooses as `loadid.inverse.choice.choose` says.
    hold : {"foh", "zoh"}, optional
        How a load moves between samples; default the model's own, which is first order where it has a choice.
    noise : float or array, optional
        Noise std of the sensors, (sensors,) or a covariance (sensors, sensors).
    noise_source : str, optional
        Where that level comes from; without it flag W406 is raised when the level decides.
    sensors : sequence of str or int, optional
        Sensors of the model to use; default all.
    allow : sequence of str
        Guard codes whose refusal is overridden; printed on everything made from the result.
    coverage : Coverage, optional
        Outcome of `loadid.validate.coverage` on a set-up like this one.
    progress : callable, optional
        Called as ``progress(fraction, text)``.
    """

    name = "deconvolution"

    def __init__(
        self,
        model: Model,
        *,
        method: str = "tikhonov",
        penalty: str | ArrayLike | None = "identity",
        choice: str | float | None = None,
        hold: str | None = None,
        noise: ArrayLike | None = None,
        noise_source: str | None = None,
        sensors: Sequence[str | int] | None = None,
        allow: Sequence[str] = (),
        coverage: Any = None,
        progress: Callable[[float, str], None] | None = None,
    ) -> None:
        if method not in ("tikhonov", "tsvd"):
            raise InputError("unknown method", where="method", found=repr(method), expected="'tikhonov' or 'tsvd'")
        if isinstance(penalty, str):
            penalties.order(penalty)
        if penalty is None:
            if choice not in (None, 0, 0.0):
                raise InputError(
                    "without a penalty there is no lambda to choose", where="choice", found=choice, expected="None"
                )
            choice = 0.0
        self.model, self.method, self.penalty, self.choice, self.hold = model, method, penalty, choice, hold
        self.noise, self.noise_source, self.sensors = noise, noise_source, sensors
        self.allow, self.coverage = guards.allowed(allow), coverage
        self._progress = progress or (lambda fraction, text: None)

    def estimate(self, record: Any, dt: float | None = None) -> LoadEstimate:
        """Rebuild the loads that caused a record.

        Parameters
        ----------
        record : Record, or array of shape (samples, sensors)
        dt : float, optional
            Step in s of a bare array.

        Returns
        -------
        LoadEstimate
            Loads (samples, loads) with std, flags, and what every rule said.

        Raises
        ------
        InputError
            A record that does not fit the model, or an impulse response without a usable diagonal (LID-E506).
        NotIdentifiable
            Without regularisation, where the data do not determine the load (LID-E306).
        """
        data = gather(record, dt, self.model, self.sensors)
        self._progress(0.1, "posing the problem")
        posed = self._pose(data)
        self._refuse_undetermined(posed)
        self._progress(0.5, "choosing lambda")
        choice = choose(posed.path, self.choice, sigma=posed.noise.sigma, source=posed.noise.source)
        self._progress(0.9, "estimating the load")
        # a residual above the stated noise is model error: the band must not be narrower than what is seen
        seen = residual_level(posed.path, choice.lam)
        sigma = max(posed.noise.sigma or 0.0, seen or 0.0) or _last_resort(posed.path, choice)
        solution = posed.path.solution(choice.lam, sigma)
        residual = posed.values - posed.predict(solution.load)
        facts = self._facts(posed, choice, sigma, data.dt, solution.load)
        self._progress(1.0, "done")
        assert solution.posterior is not None
        std = solution.posterior.std
        bias = diagnose.hidden(posed.path, choice.lam, solution.load, std)
        return LoadEstimate(
            load=solution.load,
            # the posterior holds the bias of an average sample; where more is expected to be hidden, that counts
            std=np.maximum(std, np.abs(bias)),
            bias=bias,
            labels=[c.label for c in self.model.loads],
            units=[c.unit for c in self.model.loads],
            axis=Axis(name="time", unit="s", values=np.asarray(np.arange(len(solution.load)) * data.dt, float)),
            choice=choice,
            response=posed.values,
            residual=residual,
            sensors=[c.label for c in data.channels],
            sensor_units=[c.unit for c in data.channels],
            flags=self._flags(posed, choice, data, facts),
            allowed=self.allow,
            certificate=self.model.certificate,
            posterior=solution.posterior,
            facts=facts,
            provenance=provenance(
                self.name,
                settings=self._settings(posed),
                inputs={data.record.source or data.record.name or "record": data.record.sha256},
                model=self.model.fingerprint,
                prior=PRIOR[self.penalty]
                if isinstance(self.penalty, str)
                else "a penalty of the user"
                if self.penalty is not None
                else "none",
            ),
        )

    # -- posing -----------------------------------------------------------------------------------------------------
    def _pose(self, data: Data) -> Posed:
        if getattr(self.model, "noise_spectrum", None) is not None:
            return self._pose_measured(data)
        samples = len(data.values)
        h = self.model.impulse_response(data.dt, samples, self.hold or self.model.default_hold)
        shift = self._shift(h[:, data.rows])
        h, values = h[shift:], data.values[shift:]
        level = noises.resolve(self.noise, self.noise_source, self.model, data)
        if values.shape[0] * h.shape[2] <= DENSE or not isinstance(self.penalty, str | None):
            return self._pose_dense(h, values, level, data)
        H = np.fft.rfft(h, padded_length(len(values)), axis=0)
        return self._pose_spectral(H, values, level, data, h)

    def _pose_dense(self, h: NDArray, values: NDArray, level: noises.Noise, data: Data) -> Posed:
        samples, loads = len(values), h.shape[2]
        if samples * loads > 2 * DENSE:
            raise InputError(
                "a penalty matrix needs the dense path, and the record is too long for it",
                where="penalty",
                found=f"{samples * loads} unknowns",
                expected=f"at most {2 * DENSE}",
                hint="use a named penalty, or a window",
            )
        used = h[:, data.rows]
        T = toeplitz(used)
        L = None if self.penalty is None else penalties.matrix(self.penalty, samples, loads)
        problem = LinearProblem.whitened(T, values, level.level, L, (samples, loads))
        path = SVDPath(problem, truncated=self.method == "tsvd")
        full = None
        if len(data.rows) < h.shape[1]:
            scale = np.sqrt(np.mean(h**2, axis=(0, 2)))
            full = diagnose.layout(
                np.linalg.svd(toeplitz(h / scale[:, None]).reshape(-1, samples * loads), compute_uv=False),
                samples * loads,
            )
        return Posed(
            path,
            level,
            lambda g: (T.reshape(-1, samples * loads) @ g.reshape(-1)).reshape(values.shape),
            values,
            "dense SVD",
            used,
            full,
        )

    def _pose_spectral(
        self,
        H: NDArray,
        values: NDArray,
        level: noises.Noise,
        data: Data,
        h: NDArray | None,
        power: NDArray | None = None,
        variance: NDArray | None = None,
        excess: NDArray | None = None,
    ) -> Posed:
        used = H[:, data.rows]
        if power is None:
            if level.level.ndim == 2:
                raise InputError(
                    "a long record takes a noise std per sensor, not a covariance",
                    where="noise",
                    found=f"covariance {level.level.shape}",
                    expected="(sensors,)",
                    hint="use a window of the record",
                )
            power = np.tile(len(values) * level.level**2, (len(used), 1))
        penalty = "identity" if self.penalty is None else self.penalty
        if not isinstance(penalty, str):
            raise InputError(
                "a measured model takes a named penalty",
                where="penalty",
                found="a matrix",
                expected=", ".join(penalties.ORDER),
            )
        path = SpectralPath(
            used, values, power, penalty=penalty, variance=variance, excess=excess, truncated=self.method == "tsvd"
        )
        full = None
        if len(data.rows) < H.shape[1]:
            scale = np.sqrt(np.mean(np.abs(H) ** 2, axis=(0, 2)))
            full = diagnose.layout(np.linalg.svd(H / scale[:, None], compute_uv=False).ravel(), len(H) * H.shape[2])
        padded, count = path.padded, len(values)

        def predict(g: NDArray) -> NDArray:
            G = np.fft.rfft(g, padded, axis=0)
            return np.fft.irfft(np.einsum("ksl,kl->ks", used, G), padded, axis=0)[:count]

        return Posed(path, level, predict, values, "zero-padded FFT", None if h is None else h[:, data.rows], full)

    def _pose_measured(self, data: Data) -> Posed:
        model, samples = self.model, len(data.values)
        own = model.dt  # type: ignore[attr-defined]
        if abs(data.dt / own - 1) > 1e-6:
            raise InputError(
                "the record and the model have different steps",
                where="estimate",
                found=f"dt = {data.dt:.9g} s",
                expected=f"dt = {own:.9g} s",
                hint="give the sampling rate as recorded (--fs, dt=), or resample",
            )
        f = np.linspace(0, 0.5 / own, padded_length(samples) // 2 + 1)
        H = model.frf(f)
        self._shift(np.fft.irfft(H[:, data.rows], axis=0)[:samples])
        spectrum = model.noise_spectrum(f)  # type: ignore[attr-defined]
        variance = model.frf_variance(f)  # type: ignore[attr-defined]
        variance = None if variance is None else variance[:, data.rows]
        h = np.fft.irfft(H, axis=0)[: min(samples, model.samples)]  # type: ignore[attr-defined]
        if self.noise is not None:
            return self._pose_spectral(
                H, data.values, noises.resolve(self.noise, self.noise_source, model, data), data, h, variance=variance
            )
        if spectrum is not None:
            hits = len(model.training)  # type: ignore[attr-defined]
            level = noises.Noise(
                np.ones(len(data.rows)),
                True,
                f"residual power of {hits} training hits, averaged over neighbouring lines",
            )
            return self._pose_spectral(H, data.values, level, data, h, samples * spectrum[:, data.rows], variance)
        told = self._roughness(H[:, data.rows], data.values) if model.training else None  # type: ignore[attr-defined]
        if told is not None:
            power, excess = told
            level = noises.Noise(
                np.ones(len(data.rows)), True, "roughness of the load spectrum that each sensor gives alone"
            )
            return self._pose_spectral(H, data.values, level, data, h, power, variance, excess)
        return self._pose_spectral(H, data.values, noises.resolve(None, None, model, data), data, h, variance=variance)

    def _roughness(self, H: NDArray, values: NDArray) -> tuple[NDArray, NDArray] | None:
        """Noise energy and its excess on single lines (lines, sensors), told by one short load, else None."""
        if H.shape[2] != 1 or np.any(H == 0):
            return None
        size = np.abs(H[..., 0]) ** 2
        told = roughness(np.fft.rfft(values, 2 * (len(H) - 1), axis=0) / H[..., 0])
        if np.median(np.min(told.relative, axis=1)) > 0.5:  # rough everywhere: the load fills the record
            return None
        return told.typical * size, np.maximum(told.local - told.typical, 0.0) * size

    def _shift(self, h: NDArray) -> int:
        """Samples by which data are advanced so that every load has a diagonal (0 with a first-order hold)."""
        level = np.max(np.abs(h), axis=1)  # (samples, loads)
        largest = level.max(axis=0)
        for j in np.flatnonzero(largest == 0):
            raise guards.index_offset(0.0, self.model.loads[j].label, None)
        usable = level > UNUSABLE * largest
        if "LID-E506" in self.allow or usable[0].all():
            return 0
        first = np.argmax(usable.all(axis=1))
        if not usable.all(axis=1).any() or first > len(h) // 2:
            worst = int(np.argmin(usable[0]))
            raise guards.index_offset(
                float(level[0, worst] / largest[worst]), self.model.loads[worst].label, int(np.argmax(usable[:, worst]))
            )
        return int(first)

    # -- saying -----------------------------------------------------------------------------------------------------
    def _refuse_undetermined(self, posed: Posed) -> None:
        free = self.penalty is None or (isinstance(self.choice, int | float) and self.choice == 0)
        n = _unknowns(posed.path)
        if free and posed.path.rank < n and "LID-E306" not in self.allow:
            raise NotIdentifiable(
                f"without regularisation the load is not determined: rank {posed.path.rank} of {n} unknowns "
                f"from {posed.path.m} data",
                advice="add sensors, use a penalty (penalty='identity'), or give lambda > 0",
                code="LID-E306",
            )

    def _facts(self, posed: Posed, choice: Choice, sigma: float, dt: float, load: NDArray) -> dict[str, Any]:
        path, n = posed.path, _unknowns(posed.path)
        kappa, _rank, _nullity = diagnose.layout(_singular(path), n)
        width, bias = diagnose.resolution(path, choice.lam, load)
        point = path.at(choice.lam)
        return {
            "path": posed.name,
            "m": int(path.m),
            "n": n,
            "rank": path.rank,
            "nullity": max(n - path.rank, 0),
            "kappa": kappa,
            "edf": None if point.edf is None else float(point.edf),
            "residual_to_noise": residual_level(path, choice.lam) if posed.noise.known else None,
            "noise_level": float(sigma),
            "noise_source": posed.noise.source,
            "resolution": width * dt,
            "resolution_unit": "s",
            "peak_bias": bias,
        }

    def _flags(self, posed: Posed, choice: Choice, data: Data, facts: dict[str, Any]) -> tuple[Flag, ...]:
        model, lost = self.model, [s.label for i, s in enumerate(self.model.sensors) if i not in data.rows]
        rows = [model.sensors[i] for i in data.rows]
        after = (facts["kappa"], facts["rank"], facts["nullity"])
        deltas = self._deltas(posed, choice)
        prior = self.penalty if isinstance(self.penalty, str) else "user matrix"
        return guards.collect(
            [
                *model.flags,
                guards.not_verified(model.certificate),
                *health(data),
                guards.null_space(facts["m"], facts["n"], facts["rank"]),
                None if posed.full is None else guards.lost_channels(posed.full, after, lost),
                guards.mixed_kinds(data.channels, posed.noise.known),
                guards.high_pass(rows, data.duration),
                guards.memory(model.decay_rate, data.duration, posed.h),
                guards.aliased(model.natural_frequencies, data.dt),
                *guards.parameter(choice, deltas),
                guards.inverse_crime(data.record.simulated_by, model.fingerprint),
                guards.no_coverage(self.coverage),
                guards.used_for_training("the record", data.fingerprints & getattr(model, "training", frozenset())),
                guards.resolution(facts["nullity"], prior, facts["resolution"], "s", facts["peak_bias"]),
            ]
        )

    def _deltas(self, posed: Posed, choice: Choice) -> list[float | None]:
        """Discrepancy lambdas at half, once and twice the noise level."""
        if posed.noise.sigma is None:
            return []
        from ..inverse import rules

        sweep = rules.Sweep.over(posed.path, posed.noise.sigma)
        return [rules.discrepancy(sweep, factor).lam for factor in (0.5, 1.0, 2.0)]

    def _settings(self, posed: Posed) -> dict[str, Any]:
        penalty = self.penalty if isinstance(self.penalty, str | None) else "matrix"
        return {
            "method": self.method,
            "penalty": penalty,
            "choice": self.choice,
            "hold": self.hold,
            "path": posed.name,
            "noise_source": posed.noise.source,
            "sensors": None if self.sensors is None else [str(s) for s in self.sensors],
        }


def _last_resort(path: SVDPath | SpectralPath, choice: Choice) -> float:
    """Noise level from what little the fit leaves, where nothing else tells."""
    point = path.at(choice.lam)
    left = 0.0 if point.left is None else float(point.left)
    return float(np.sqrt(point.residual2 / left)) if left > 0 else 1.0


def _unknowns(path: SVDPath | SpectralPath) -> int:
    return path.problem.H.shape[1] if isinstance(path, SVDPath) else path.unknowns


def _singular(path: SVDPath | SpectralPath) -> NDArray:
    return path.singular_values if isinstance(path, SVDPath) else path.c
