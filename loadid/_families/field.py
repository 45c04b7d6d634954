"""Distributed loads over space and time, a basis times its histories; and the power that they feed into a motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._model import Model, as_model
from structures._models.mapped import mapped
from structures._models.motion import Motion, motion
from structures.errors import InputError, as_array, positive

from .. import _guards as guards
from .._guards.inversion import undetermined_field
from .._inverse.gaussian.posterior import MappedPosterior
from .._inverse.penalties import names
from .._results.again import Again
from .._results.estimate import LoadEstimate
from .._results.facts import Facts
from .._spellings import takes
from ..settings import ChoiceLike, Guards, Lambda, Noise, Penalty
from . import smoothness as spatial
from .data import Data, gather
from .deconvolution import Deconvolution
from .smoothness import geometry

LINES = 24  # on which the sensors are asked how many loads they tell apart
APART = 1e-9  # singular value over the largest, rows and columns scaled, below which a combination leaves no trace
Array = NDArray[np.float64]


class FieldDeconvolution:
    """Distributed load ``q(x, t) = sum_j phi_j(x) g_j(t)`` from response histories.

    Minimises ``|R^(-1/2) (h * g - y)|^2 + lambda^2 |(L_t x W) g|^2`` over whole records: L_t the penalty in time, W the
    root of the spatial precision, ``|W g|^2 = integral of q^2 + length^2 |grad q|^2`` (without a spatial prior
    ``|g|^2``). With the identity in time these are the two separate penalties ``lambda_t^2 |g|^2 + lambda_x^2
    |L_x g|^2``. In the variables ``u = W g`` it is a deconvolution without a spatial prior, which `Deconvolution`
    solves by what suits the length of the record; nothing of the size of (places x samples)^2 is formed.

    The load, put on the structure again, gives a motion that obeys the equation of motion exactly (`motion`): after P.
    Mainçon, C. Barnardo, C. M. Larsen, "VIV force estimation using inverse FEM", OMAE 2008, 673-681.

    Parameters
    ----------
    model : Model
        Whose loads are a `structures.bases` basis (any loads do).
    space : {"gradient", "laplacian"}, array or None
        Spatial prior; see `spatial.root`. None: no prior in space, refused where the sensors do not tell the loads
        apart (LID-E514).
    length : float, optional
        Length of the spatial prior (m).
    ratio : float, optional
        The two penalties are added, not multiplied: ``lambda^2 (|(L_t x S) g|^2 + ratio^2 |W g|^2)``, S the root of the
        size of a field. Under first differences a smooth field is correlated over some ``1 / ratio`` samples, under
        second ones over the root of that.
    shapes : array (loads, unknowns), optional
        Instead of a prior: the load is a combination of these columns (mode shapes at the places of the basis, say).
    time : str or Penalty
        Penalty in time: ``identity``, ``first_difference``, ``second_difference``; no `size`, for which `ratio` stands.
    choice, sensors, allow, **settings
        As in `Deconvolution`, with all its other settings: noise, hold, initial, progress, ...
        Constraints only without a spatial prior and without shapes.

    Raises
    ------
    InputError
        Settings that do not fit.
    """

    name = "field deconvolution"

    @takes(
        time=(Penalty, "leak from_zero"),
        choice=(Lambda, "method path"),
        noise=(Noise, "source"),
        allow=(Guards, "coverage load_class"),
    )
    def __init__(
        self,
        model: Model,
        *,
        space: str | ArrayLike | None = None,
        length: float | None = None,
        ratio: float | None = None,
        shapes: ArrayLike | None = None,
        time: str | Penalty = "identity",
        choice: ChoiceLike = None,
        sensors: Sequence[str | int] | None = None,
        allow: Sequence[str] | Guards = (),
        **settings: Any,
    ) -> None:
        held = Penalty.of(time)
        if held.variance == "auto":  # a variance for each load says nothing of a field between them
            held = replace(held, variance="constant")
        if not isinstance(held.L, str):
            raise InputError("the penalty in time is a name", where="time", found=type(time).__name__,
                             expected=f"one of {names()}")  # fmt: skip
        if space is not None and shapes is not None:
            raise InputError("shapes are a spatial prior of their own", where="space", found="space and shapes",
                             expected="one of the two")  # fmt: skip
        if ratio is not None:
            if space is None:
                raise InputError("a ratio stands between a penalty in time and one in space", where="ratio",
                                 found="no spatial prior", expected="space='gradient' or another with it")  # fmt: skip
            ratio = positive("ratio", ratio, where="ratio", unit="1")
        self.model = as_model(model, "FieldDeconvolution", "impulse_response")
        self.space, self.length, self.time, self.ratio = space, length, held, ratio
        self.shapes = None if shapes is None else mapped(model, shapes)
        self.basis = model.basis
        self.sensors, self.allow = sensors, Guards.of(allow).codes
        spatial.root(space, length, len(model.loads), self.basis, 1)  # refuses before any data
        for name, instead in (("penalty", "time= and space="), ("size", "ratio=")):
            if name in settings:
                raise InputError("a field has two penalties", where=name, found=repr(settings[name])[:60],
                                 expected=instead)  # fmt: skip
        signs = settings.get("constraints", ())
        if (space is not None or shapes is not None) and not (isinstance(signs, list | tuple) and not signs):
            raise InputError("signs hold loads, and here combinations of loads are solved for", where="constraints",
                             found="a spatial prior" if shapes is None else "shapes",
                             expected="space=None and no shapes with it")  # fmt: skip
        self._settings = {"choice": choice, "sensors": sensors, "allow": allow, **settings}
        Deconvolution(model, penalty=held, **self._settings)  # refuses the others

    def estimate(self, record: Any, dt: float | None = None) -> LoadEstimate:
        """Rebuild the distributed load that caused a record.

        Parameters
        ----------
        record, dt
            As for `Deconvolution.estimate`.

        Returns
        -------
        LoadEstimate
            Coefficients of the basis over time (samples, loads), with its geometry.

        Raises
        ------
        InputError
            As `Deconvolution.estimate`.
        NotIdentifiable
            Where the sensors do not tell the loads apart and nothing is said of the field between them (LID-E514).
        """
        data = gather(record, dt, self.model, self.sensors, allow_missing=True)
        told = self._told_apart(data)
        T, size = self._combinations(told)
        model = self.model if T is None else self.shapes or mapped(self.model, T)
        found = Deconvolution(model, penalty=replace(self.time, size=size), **self._settings).estimate(record, dt)
        return self._kept(found, T, told, data)

    def motion(self, estimate: LoadEstimate) -> Motion:
        """Motion of the whole structure under an estimate: displacement, velocity and acceleration of every DOF.

        Raises
        ------
        InputError
            If the model is no ForwardModel, or the estimate is none of its loads over time.
        """
        return motion(self.model, estimate.load, estimate.over("time").step, self._hold)  # type: ignore[arg-type]

    # -- inside -----------------------------------------------------------------------------------------------------
    @property
    def _hold(self) -> str:
        return str(self._settings.get("hold") or self.model.default_hold)

    def _combinations(self, told: int) -> tuple[Array | None, Array | None]:
        """Matrix T (loads, unknowns) that makes loads of what is solved for (None: the identity), and its sizes."""
        if self.shapes is not None:
            return self.shapes.T, None
        if self.ratio is not None and self.space is not None:
            return spatial.additive(self.space, self.length, self.ratio, len(self.model.loads), self.basis, told)
        W = spatial.root(self.space, self.length, len(self.model.loads), self.basis, told)
        if W is None:
            return None, None
        from scipy.linalg import solve_triangular

        return np.asarray(solve_triangular(W, np.eye(len(W))), float), None

    def _told_apart(self, data: Data) -> int:
        """Combinations of the unknowns of one sample that the sensors tell apart, at the best frequency.

        Raises
        ------
        NotIdentifiable
            If these are fewer than the unknowns, nothing is said of the field, and `allow` does not hold E514.
        """
        H = _lines(self.shapes or self.model, data, self._hold)
        told, unknowns = told_apart(H[:, data.rows]), H.shape[2]
        if told < unknowns and self.space is None and "LID-E514" not in self.allow:
            raise undetermined_field(told, unknowns, len(data.rows), len(data.values))
        return told

    def _kept(self, found: LoadEstimate, T: Array | None, told: int, data: Data) -> LoadEstimate:
        """The estimate over places, with the problem that it can be asked of at another lambda."""
        placed = self._over_places(found, T, told, data)
        if found.again is None:
            return placed
        return replace(placed, again=Again(found.again.path, partial(self._at, found, T, told, data)))

    def _at(self, found: LoadEstimate, T: Array | None, told: int, data: Data, lam: float) -> LoadEstimate:
        return self._kept(found.at(lam), T, told, data)

    def _over_places(self, found: LoadEstimate, T: Array | None, told: int, data: Data) -> LoadEstimate:
        """The estimate in the loads of the model, with their places and all that is said of them."""
        loads = [c.label for c in self.model.loads]
        places = None if self.basis is None else geometry(self.basis)
        length = self.length
        if length is None and self.space is not None:
            length = spatial.spacing(self.basis, told)
        facts = Facts.of({**found.facts, "places": len(loads), "told_apart": told, "length": length})
        extra = [guards.inverse_crime(data.record.simulated_by, self.model.fingerprint)]
        if told < (T.shape[1] if self.shapes is not None and T is not None else len(loads)) and self.space is None:
            extra.append(guards.overridden("E514", "combinations told apart", told, len(loads)))
        history = {
            **found.provenance, "family": self.name, "model": self.model.fingerprint,
            "prior": f"in time {found.provenance['prior']}; in space {spatial.spatial_words(self.space, length)}"
            + ("" if self.ratio is None else f"; the two added, in space {self.ratio:.3g} of that in time"),
        }  # fmt: skip
        told_of: dict[str, Any] = {
            "labels": loads, "units": [c.unit for c in self.model.loads], "geometry": places, "facts": facts,
            "flags": guards.collect([*extra, *found.flags]), "provenance": history,
        }  # fmt: skip
        if T is None:
            return replace(found, **told_of)
        posterior = None if found.posterior is None else MappedPosterior(found.posterior, T)
        std = found.std @ np.abs(T).T if posterior is None else posterior.std
        bias = None if found.bias is None else found.bias @ T.T
        std = std if bias is None else np.maximum(std, np.abs(bias))
        return replace(found, load=found.load @ T.T, std=std, bias=bias, posterior=posterior, **told_of)


def told_apart(H: NDArray[Any]) -> int:
    """Largest rank of the lines (lines, sensors, loads), units taken out: combinations of loads that leave a trace."""
    rows = np.sqrt(np.mean(np.abs(H) ** 2, axis=(0, 2)))
    tiny = np.finfo(float).tiny
    # rows first: their units; then columns, which may be a load that hardly acts
    scaled = H / np.where(rows > 0, rows, 1.0)[:, None]
    columns = np.sqrt(np.mean(np.abs(scaled) ** 2, axis=(0, 1)))
    singular = np.linalg.svd(scaled / np.where(columns > 0, columns, 1.0), compute_uv=False)
    return int(np.max(np.sum(singular > APART * np.maximum(singular[:, :1], tiny), axis=1)))


def _lines(model: Model, data: Data, hold: str) -> NDArray[np.complex128]:
    """Frequency response (lines, sensors, loads) between zero and the Nyquist frequency."""
    nyquist = 0.5 / data.dt
    f = np.geomspace(max(1 / data.duration, 1e-4 * nyquist), 0.9 * nyquist, LINES)
    try:
        return model.frf(f)
    except InputError:  # a model of impulse responses only
        h = model.impulse_response(data.dt, len(data.values), hold)
        return np.fft.rfft(h, axis=0)[:: max(1, len(h) // (2 * LINES))]


def harmonic_power(load: ArrayLike, velocity: ArrayLike) -> Array:
    """Mean power ``Re(q conj(v)) / 2`` of complex amplitudes of load and velocity, of one shape: above zero it excites.

    W/m of a load in N/m, W/m^2 of a pressure.

    Raises
    ------
    InputError
        If the two do not fit each other.
    """
    q, v = (as_array(x, where="harmonic_power", dtype=complex) for x in (load, velocity))
    _fit(q, v)
    return np.asarray(0.5 * np.real(q * np.conj(v)), float)


def mean_power(load: ArrayLike, velocity: ArrayLike, dt: float, window: float) -> Array:
    """Power of a load history on the velocity under it, averaged over a sliding window.

    Parameters
    ----------
    load, velocity : array (samples, places)
        N/m and m/s at the same places and times.
    dt : float
        Step in s.
    window : float
        Length in s of the Hann window that slides over the record: some periods of the motion.

    Returns
    -------
    array (samples, places)
        W/m: above zero the load excites, below zero it damps. Near the ends of the record the window is cut, and its
        weights still sum to one.

    Raises
    ------
    InputError
        If the two do not fit each other, or the window is shorter than four samples or longer than the record.
    """
    from scipy.signal import fftconvolve

    q, v = (as_array(x, where="mean_power", dtype=float) for x in (load, velocity))
    _fit(q, v)
    step = positive("dt", dt, where="mean_power", unit="s")
    half = round(positive("window", window, where="mean_power", unit="s") / step / 2)
    if half < 2 or 2 * half + 1 > len(q):
        raise InputError("the window does not fit the record", where="mean_power", found=f"{2 * half + 1} samples",
                         expected=f"5 to {len(q)}", hint="some periods of the motion")  # fmt: skip
    weights = np.hanning(2 * half + 3)[1:-1]
    shape = (len(weights),) + (1,) * (q.ndim - 1)
    share = fftconvolve(np.ones(len(q)), weights, mode="same").reshape(-1, *shape[1:])
    return np.asarray(fftconvolve(q * v, weights.reshape(shape), mode="same", axes=0) / share, float)


def _fit(q: NDArray[Any], v: NDArray[Any]) -> None:
    if q.shape != v.shape or q.size == 0 or not (np.all(np.isfinite(q)) and np.all(np.isfinite(v))):
        raise InputError("load and velocity do not fit each other", where="power", found=f"{q.shape} and {v.shape}",
                         expected="finite, of one shape: the same places and times")  # fmt: skip
