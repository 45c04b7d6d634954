"""Load estimates made by hand: small, with a known truth, and with everything that an estimate can carry."""

from dataclasses import dataclass

import numpy as np

from loadid import LoadEstimate, NoiseSource
from loadid._inverse.choice import PathCurve
from loadid._results.estimate import Axis
from loadid.paths import Choice, RuleResult
from structures import Certificate, Flag
from structures._flags import Evidence


@dataclass
class Gaussian:
    """Posterior of full covariance over the raveled load."""

    covariance: np.ndarray

    def variance(self, w):
        w = np.asarray(w, float)
        w = w.reshape(*w.shape[: w.ndim - 2], -1)
        return np.einsum("...i,ij,...j->...", w, self.covariance, w)

    def to_arrays(self):
        return {"covariance": self.covariance}


def half_sine(samples=400, dt=1e-4, peak=1000.0, start=0.01, length=0.002):
    t = np.arange(samples) * dt
    inside = (t >= start) & (t <= start + length)
    return t, np.where(inside, peak * np.sin(np.pi * (t - start) / length), 0.0)


def impact(loads=1, rows=3, samples=400, seed=0, **changes):
    """A hit on the first load, nothing but noise on the others."""
    rng = np.random.default_rng(seed)
    t, pulse = half_sine(samples)
    truth = np.zeros((samples, loads))
    truth[:, 0] = pulse
    std = np.full((samples, loads), 15.0)
    response = np.cumsum(np.cumsum(truth[:, :1], 0), 0) * 1e-6 * np.sin(np.arange(1, rows + 1))
    residual = 0.01 * rng.standard_normal(response.shape)
    lam = np.logspace(-6, 0, 61)
    sweep = PathCurve(lam, np.sqrt(300 + (200 * lam) ** 2), 1e3 / (1 + 300 * lam), 300 / (1 + 100 * lam), None)
    sweep = PathCurve(
        lam, sweep.residual_norm, sweep.penalty_norm, sweep.edf, 1 / (1200 - sweep.edf) ** 2 * sweep.residual_norm**2
    )
    settings = {
        "load": truth + std * rng.standard_normal(truth.shape),
        "std": std,
        "labels": [f"{11 + 10 * j}+Z" for j in range(loads)],
        "units": ["N"] * loads,
        "axis": Axis("time", "s", t),
        "choice": Choice(
            lam=1.2e-3,
            scale=0.031,
            rule="robust_gcv",
            rules=(
                RuleResult("discrepancy", None, note="sigma is not known"),
                RuleResult("gcv", 9e-4),
                RuleResult("robust_gcv", 1.2e-3),
                RuleResult("l_curve", 1e-6, edge=True, note="no corner"),
            ),
            spread=0.12,
            verdict="determined",
            odds="9 of 10 such problems were within 1.3 of the best error",
            sigma=0.01,
            source=NoiseSource("pre_trigger"),
            edf=88.2,
            sweep=sweep,
        ),
        "response": response + residual,
        "residual": residual,
        "sensors": [f"{k}+Z" for k in range(1, rows + 1)],
        "sensor_units": ["m/s^2"] * rows,
        "flags": [
            Flag("N303", Evidence("nullity", 0, 0), "nothing is invisible", "claim nothing finer than 0.2 ms"),
            Flag("W114", Evidence("certificate", "none"), "forward model never verified", "hang a known mass"),
        ],
        "provenance": {
            "family": "Deconvolution",
            "prior": "white noise (Tikhonov, identity)",
            "created": "2026-11-02T10:00:00+00:00",
            "versions": {"loadid": "0.1.0", "numpy": "2.4"},
            "settings": {"method": "tikhonov", "allow": []},
            "inputs": {"log.csv": "ab" * 32},
        },
        "posterior": Gaussian(225.0 * np.eye(samples * loads)) if samples * loads <= 2000 else None,
        "facts": {
            "m": 3 * samples,
            "n": samples,
            "rank": samples,
            "nullity": 0,
            "kappa": 3.1e4,
            "edf": 88.2,
            "residual_to_noise": 1.02,
        },
    }
    return LoadEstimate(**{**settings, **changes})


def static(loads=4, **changes):
    """A static load of a few points."""
    settings = {
        "load": np.linspace(-20, 60, loads),
        "std": np.full(loads, 3.0),
        "labels": [f"P{j}" for j in range(loads)],
        "units": ["N"] * loads,
        "response": np.arange(6.0),
        "residual": np.full(6, 0.1),
        "sensors": list("abcdef"),
        "sensor_units": ["um/m"] * 6,
    }
    return LoadEstimate(**{**settings, **changes})


CERTIFICATE = Certificate((1.01,), (0.999,), (0.02,), None, ("1+Z",), "hanging mass 2 kg", "2026-11-02T10:00:00+00:00")
