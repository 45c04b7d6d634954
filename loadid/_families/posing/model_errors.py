"""What a model may be wrong by: gains of its sensors; frequencies, damping and shapes of its modes; each with a prior.

An error of the shape of a mode at a sensor, of a place or of a boundary, grows with the slope of the mode, which is in
proportion to the root of its frequency (waves in bending); it is counted in the size of the mode at sensors of a kind.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from structures._model import Model
from structures._models.discretise import discretise
from structures._models.reduction import ReducedModel
from structures._models.statespace import StateSpace

from ..._inverse.gaussian.record import WhitenedRecord
from ..._inverse.nuisances import Nuisances

Array = NDArray[Any]

DOUBT = 2  # repeats that what is assumed of a gain counts for
ASSUMED = {"gain": 0.02, "frequency": 0.01, "damping": 0.2, "shape": 0.05}  # relative std, where nobody states another


@dataclass(frozen=True, eq=False)
class GainErrors:
    """Relative errors of the gains of sensors: their names and covariance (m, m); energy (m,) of the whitened data."""

    names: tuple[str, ...]
    covariance: Array
    energy: Array


def nuisances(
    model: Model, system: StateSpace, rows: Array, stated: Mapping[str, float], modal: bool,
    record: Callable[[StateSpace, Array], WhitenedRecord],
) -> Nuisances | None:  # fmt: skip
    """Parameters of the errors of a model; None where it has none.

    The error of a gain is one of the sensor and, as large, one that all sensors share: the scale of the model.

    Parameters
    ----------
    rows : array of int
        Sensors of the model that are used.
    stated : mapping of str to float
        Relative std of some of `ASSUMED`; 0 leaves them out.
    modal : bool
        Whether modes can be moved.
    record : callable
        State space and factors of the used sensors (sensors,) -> the problem with them.
    """
    size, m = {**ASSUMED, **stated}, len(rows)
    modes = _modes(model, system) if modal else 0
    count = m * modes
    std = np.r_[np.full(modes, size["frequency"]), np.full(modes, size["damping"]), np.full(count, size["shape"])]
    covariance = np.diag(np.r_[std**2, np.zeros(m)])
    covariance[-m:, -m:] = size["gain"] ** 2 * (np.eye(m) + 1.0)
    labels = [model.sensors[i].label for i in rows]
    names = [f"{what} of mode {i + 1}" for what in ("frequency", "damping") for i in range(modes)]
    names += [f"shape of mode {i + 1} at {label}" for label in labels for i in range(modes)]
    names += [f"gain of {label}" for label in labels]
    kept = np.flatnonzero(np.diag(covariance))
    if not len(kept):
        return None

    def of(at: Array) -> WhitenedRecord:
        theta = np.zeros(len(covariance))
        theta[kept] = at
        f, ratio, shapes, gains = np.split(theta, np.cumsum([modes, modes, count]))
        if not theta[:-m].any():
            return record(system, np.exp(gains))
        return record(_moved(model, system, rows, np.exp(f), np.exp(ratio), shapes.reshape(m, modes)), np.exp(gains))

    return Nuisances(tuple(names[i] for i in kept), covariance[np.ix_(kept, kept)], of)


def gains(model: Model, rows: Array, stated: Mapping[str, float], energy: Array) -> GainErrors | None:
    """Errors of the gains of a measured model: as stated, as its repeats show, or as assumed; None where none.

    What is assumed is the mean of an inverse gamma prior of their variance, of `DOUBT` degrees of freedom.

    Parameters
    ----------
    rows : array of int
        Sensors of the model that are used.
    stated : mapping of str to float
        Relative std; only that of ``gain`` counts.
    energy : array, shape (sensors,)
        Of the whitened data of each.
    """
    size, m = stated.get("gain"), len(rows)
    shown, hits = model.gain_covariance, sum(hit.used for hit in model.hits)
    covariance = (ASSUMED["gain"] if size is None else size) ** 2 * (np.eye(m) + 1.0)
    if size is None and shown is not None and hits > 1:
        degrees = hits + DOUBT
        covariance = (DOUBT * covariance / 2 + hits * np.asarray(shown)[np.ix_(rows, rows)]) / degrees
        covariance *= (stdtrit(degrees, 0.975) / ndtri(0.975)) ** 2  # few repeats: Student's tails, at 95 %
    if not np.any(covariance):
        return None
    return GainErrors(tuple(f"gain of {model.sensors[i].label}" for i in rows), covariance, energy)


def _modes(model: Model, system: StateSpace) -> int:
    """Modes whose frequency and damping the state space is made of; 0 where it is made of anything else."""
    reduced = model.reduced
    if reduced is None or reduced.moving or not reduced.proportional:
        return 0
    same = discretise(reduced, system.dt, system.hold)
    whole = all(np.array_equal(a, b) for a, b in zip(same, (system.A, system.B, system.C, system.D), strict=True))
    return len(reduced.lam) if whole else 0


def _moved(model: Model, system: StateSpace, rows: Array, f: Array, ratio: Array, shapes: Array) -> StateSpace:
    """The state space with factors on frequencies and damping ratios, modal masses kept, and shapes (rows, modes)."""
    reduced = model.reduced
    S = np.array(reduced.S)
    S[rows] += shapes * _sizes(reduced)[rows]
    other = replace(reduced, lam=reduced.lam * f**2, damping=reduced.damping * f * ratio, S=S)
    return StateSpace(*discretise(other, system.dt, system.hold), system.dt, system.hold,
                      sensors=system.sensors, loads=system.loads)  # fmt: skip


def _sizes(reduced: ReducedModel) -> Array:
    """Size of each mode at sensors of one kind, times its wave number over the lowest, (sensors, modes)."""
    size = np.empty(reduced.S.shape)
    for kind in np.unique(reduced.derivative):
        same = reduced.derivative == kind
        size[same] = np.sqrt(np.mean(reduced.S[same] ** 2, axis=0))
    lam = reduced.lam
    lowest = np.min(lam[lam > 0], initial=np.inf)
    return np.asarray(size * np.maximum(lam / lowest, 1.0) ** 0.25)
