"""Modal test: poles, shapes and modal masses from FRFs or from records with known force, and a model made of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._channels import Channel
from .._flags import Flag, collect
from .._models.modal import ModalModel
from .._models.tabulated import FrfModel
from ..errors import InputError, whole
from . import kinds
from .modalanswer import complex_flag, driven_points, masses, missed_flag, modelled, poor_flag, reciprocal, truer
from .modaldata import of_own_length, picked, prepared, table_of
from .modalfit import FrfBand, ModalFit
from .modalorder import reweighted, selected
from .modalshapes import complex_shapes, normal
from .polyreference import ORDERS, REFERENCES, Stabilisation, stabilisation

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

MISFIT = 1.5  # mean squared residual over the stated variance, above which an added mode is not taken for one
SURE, BROAD = 0.05, 0.1  # relative std of its decay, and damping ratio, up to which an added pole is a mode


@dataclass(frozen=True, eq=False)
class MeasuredModes:
    """Modes of a structure, from a test.

    Parameters
    ----------
    frequencies, damping : array (modes,)
        Natural frequencies in Hz, ascending, and damping ratios.
    frequency_std, damping_std : array (modes,)
        Their standard deviations.
    shapes : array (sensors, modes), complex
        The largest entry of each is 1; of displacement, also where acceleration was measured.
    participation : array (loads, modes), complex
        How much each load drives each mode; the largest entry of each is 1.
    normal_shapes : array (sensors, modes)
        Real shapes of the same poles. Of unit modal mass (1/sqrt(kg)) where `modal_mass` is known, else the largest
        entry of each is 1.
    mpc : array (modes,)
        Modal phase collinearity of the shape over its sensors, or over its loads where there are more: 1 for a real
        shape.
    modal_mass, modal_mass_std : array (modes,)
        In kg, for shapes whose largest entry over all places, read or driven, is 1; NaN without a driven point, or
        where it gives no positive mass.
    lower, upper : array (sensors, loads)
        What modes below the band give far above them, 1/kg for a displacement, and what those above it give far below
        them, m/N.
    band : tuple of float
        First and last line in Hz.
    misfit : float
        Mean squared residual over the variance of the FRFs, as stated or as smoothed residuals show it.
    dropped : int
        Stable poles that explain no more than chance would.
    stabilisation : Stabilisation
    frf : FrfModel
        What they were fitted to, on the lines of the band.
    flags : tuple of Flag

    Notes
    -----
    Poles by the poly-reference least-squares complex frequency estimator (pLSCF) over all orders, those chosen that
    stay, then all modes by maximum likelihood; the std are those of the maximum likelihood, with the correlation of
    the errors of neighbouring lines. Sources in `structures._testing.polyreference` and `structures._testing.modalfit`.
    Leakage of the window is no noise: where a flag W218 names narrow peaks, their damping is too large.
    """

    frequencies: Real
    damping: Real
    frequency_std: Real
    damping_std: Real
    shapes: Complex
    participation: Complex
    normal_shapes: Real
    mpc: Real
    modal_mass: Real
    modal_mass_std: Real
    lower: Real
    upper: Real
    band: tuple[float, float]
    misfit: float
    dropped: int
    stabilisation: Stabilisation
    frf: FrfModel
    flags: tuple[Flag, ...]
    _model: ModalModel
    _reciprocal: Complex

    def __len__(self) -> int:
        return len(self.frequencies)

    def __repr__(self) -> str:
        lines = [f"MeasuredModes({len(self)} modes, {self.band[0]:.5g} to {self.band[1]:.5g} Hz)"]
        rows = zip(self.frequencies, self.frequency_std, self.damping, self.damping_std, strict=True)
        lines += [f"  {f:10.4f} +- {sf:.2g} Hz   {100 * z:8.4f} +- {100 * sz:.2g} %" for f, sf, z, sz in rows]
        return "\n".join(lines)

    @property
    def scaled(self) -> bool:
        """Whether every mode has a modal mass: forces at any sensor can then be modelled."""
        return bool(len(self) and np.all(np.isfinite(self.modal_mass)))

    @property
    def mac(self) -> Real:
        """Modal assurance criterion of the shapes among each other (modes, modes): near 0 where sensors part them."""
        size = np.linalg.norm(self.shapes, axis=0)
        return np.asarray(
            np.abs(np.einsum("si,sj->ij", self.shapes.conj(), self.shapes)) ** 2 / np.outer(size, size) ** 2
        )

    def model(self, loads: Sequence[str] | None = None) -> ModalModel:
        """Forward model of the modes, for every family that a `ForwardModel` serves.

        Parameters
        ----------
        loads : sequence of str, optional
            Where forces act: driven places, or sensors of motion, whose label is then that of the force at their place
            and along them. Default the loads of the test.

        Raises
        ------
        InputError
            A place that is neither, or, for one that was not driven, a test without a driven point: shapes alone do
            not say how heavy the structure is.

        Notes
        -----
        FRFs per newton scale what the driven forces do; reciprocity scales what others do, once response and force of
        one place are known. What modes outside the band add is not known for forces that were not driven.
        """
        own = self._model
        if loads is None:
            return own
        tested = {c.label: j for j, c in enumerate(own.loads)}
        seen = {c.label: i for i, c in enumerate(own.sensors)}
        places: list[int | None] = []
        normal, viscous = np.zeros((len(self), len(loads))), np.zeros((len(self), len(loads)), complex)
        channels = []
        for column, label in enumerate(loads):
            places.append(tested.get(label))
            if label in tested:
                channels.append(own.loads[tested[label]])
                continue
            if label not in seen or own.sensors[seen[label]].quantity not in kinds.ORDER:
                raise InputError("no such place", where="MeasuredModes.model", found=repr(label),
                                 expected=f"a load ({', '.join(tested)}) or a sensor of motion",
                                 hint="a force that the test never saw needs a sensor at its place")  # fmt: skip
            if not self.scaled:
                raise InputError(
                    "the test has no driven point: shapes without scale say nothing of a force that was not driven",
                    where="MeasuredModes.model", found=f"no modal mass for a force at {label}",
                    expected="response and force at one place, for every mode",
                    hint='label both with their DOF (12+Z), or name them: identify_modes(..., driven=("a1", "F1"))',
                )  # fmt: skip
            normal[:, column] = self.normal_shapes[seen[label]]
            if own.viscous is not None:
                viscous[:, column] = own.viscous.shapes[seen[label], : len(self)] * self._reciprocal
            channels.append(Channel(label=label, quantity="force", unit="N"))
        return own.under(channels, places, normal, viscous)


def identify_modes(
    source: Any,
    *,
    forces: str | int | Sequence[str | int] | None = None,
    responses: str | int | Sequence[str | int] | None = None,
    dt: float | None = None,
    band: tuple[float, float] | None = None,
    order: int | None = None,
    kind: str | None = None,
    driven: tuple[str, str] | None = None,
    segment: int | None = None,
) -> MeasuredModes:
    """Natural frequencies, damping ratios, shapes and modal masses of a structure, from a test with known forces.

    Parameters
    ----------
    source : FrfModel, MeasuredModel, record, or list of records
        FRFs, with their variance where it is known; or records (samples, channels), with `forces` and `responses`.
    forces, responses : label or index, or several
        Channels of records. One force that hits once in every record is a hammer; any other is a shaker.
    dt : float, optional
        Step (s) of bare arrays.
    band : tuple of float, optional
        First and last frequency in Hz; all lines above 0 Hz where not given.
    order : int, optional
        Highest order of the polynomials; by default so many that they have 100 poles.
    kind : {"accelerance", "mobility", "receptance"}, optional
        What responses of unknown quantity are.
    driven : (sensor, load), optional
        Labels of a response and a force at one place, along one axis. Labels that name one DOF (``12+Z``) say so
        themselves.
    segment : int, optional
        Samples of the segments of shaker records; their resolution must part the peaks.

    Returns
    -------
    MeasuredModes

    Raises
    ------
    InputError
        Too few lines, responses of unknown kind (LID-W208), no such channel, or no pole that stays.

    Notes
    -----
    With more loads than sensors (a roving hammer) loads and sensors change their roles.
    """
    table, length = of_own_length(table_of(source, forces, responses, dt, kind, segment), band)
    taken = picked(table, band)
    fitted_band, turned, known = prepared(taken, length)
    stated = fitted_band.std if known else None
    poles, participation, found = _start(fitted_band, order)
    if not len(poles):
        raise _nothing(found)
    fit, dropped = selected(fitted_band, poles, participation)
    if not known:  # weak modes stay where the weights are right
        fitted_band = reweighted(fitted_band, fit)
        poles, participation, again = _start(fitted_band, order)
        if len(poles) >= np.sum(fit.stayed):
            found, (fit, dropped) = again, selected(fitted_band, poles, participation)
        else:
            fit, more = selected(fitted_band, fit.poles, fit.participation, fit.stayed)
            dropped += more
    fit, inside = _sorted(fit, fitted_band)
    if not inside:
        raise _nothing(found)
    return _result(taken, fitted_band, fit, inside, stated, turned, found, dropped, driven)


def _nothing(found: Stabilisation) -> InputError:
    return InputError(
        "no mode stays from one order to the next and explains more than noise", where="identify_modes",
        found=f"{len(found.poles)} poles over all orders, {found.unstable} unstable ones left out",
        expected="a mode in the band", hint="another band, a higher order, or FRFs with more coherence",
    )  # fmt: skip


def _start(band: FrfBand, order: int | None) -> tuple[Complex, Complex, Stabilisation]:
    """Poles and participations of pLSCF."""
    H, references = band.H, band.H.shape[2]
    V = np.eye(references)
    if references > REFERENCES:
        rows = (H / band.std.mean(axis=2, keepdims=True)).reshape(-1, references)
        V = np.linalg.svd(np.vstack([rows.real, rows.imag]), full_matrices=False)[2][:REFERENCES].T
    few = V.shape[1]
    most = max(2, len(band.f) // 3)
    n = min(max(20, ORDERS // few), most) if order is None else whole(order)
    if n is None or not 2 <= n <= most:
        raise InputError("no order of a polynomial", where="identify_modes", found=repr(order), expected=f"2 to {most}")
    found = stabilisation(H @ V, 1 / np.sqrt(np.mean(band.std**2, axis=2)), band.f, n)
    poles, v = found.chosen
    return poles, v @ V.T, found


def _sorted(fit: ModalFit, band: FrfBand) -> tuple[ModalFit, int]:
    """Modes of the band first, by frequency, and how many they are.

    Those that stay over the orders, and those that the residual added and that are known well, where noise explains
    the rest.
    """
    f = np.abs(fit.poles) / (2 * np.pi)
    std = np.sqrt(np.diag(fit.covariance))[: len(f)]
    known = (std < SURE * np.abs(fit.poles.real)) & (-fit.poles.real < BROAD * np.abs(fit.poles))
    within = (fit.stayed | (known & (fit.misfit < MISFIT))) & (f >= band.f[0]) & (f <= band.f[-1])
    return fit.ranked(np.lexsort((f, ~within))), int(within.sum())


# -- what is told -----------------------------------------------------------------------------------------------------
def _result(
    table: FrfModel, band: FrfBand, fit: ModalFit, n: int, stated: Real | None, turned: bool, found: Stabilisation,
    dropped: int, driven: tuple[str, str] | None,
) -> MeasuredModes:  # fmt: skip
    """What `n` modes and those that only make the FRFs right tell together."""
    p, size = fit.poles[:n], np.abs(fit.poles[:n])
    f_std, z_std = _spread(p, fit.covariance, len(fit.poles))
    outputs, references = fit.shapes[:n], fit.participation[:n]
    shapes, driving = (references, outputs) if turned else (outputs, references)
    real, full = normal(band, fit, stated), complex_shapes(band, fit, stated)
    best, share = truer(real, full, band)
    S, B, rest = real.shapes[:n], real.participation[:n], real.rest
    if turned:
        S, B, rest = B, S, rest.transpose(0, 2, 1)
    pairs = driven_points(table, driven)
    scale, mass, spread = masses(S, B, real, turned, pairs)
    top = np.max(np.abs(S), axis=1, initial=0)
    shown = S * np.where(np.isfinite(scale), scale, 1 / np.where(top > 0, top, 1))[:, None]
    far, w = real.low, np.abs(real.rest_poles)
    told = outputs if outputs.shape[1] > 1 else references
    model = modelled(table, band, best, scale, n, turned)
    frequencies, damping, mpc = size / (2 * np.pi), -p.real / size, _mpc(told)
    flags = collect([
        *table.flags, complex_flag(share, mpc, frequencies), poor_flag(frequencies, damping, z_std, band),
        missed_flag(best, table, turned),
    ])  # fmt: skip
    return MeasuredModes(
        frequencies=frequencies, damping=damping, frequency_std=f_std, damping_std=z_std,
        shapes=_unit(shapes).T, participation=_unit(driving).T, normal_shapes=shown.T, mpc=mpc,
        modal_mass=mass, modal_mass_std=spread, lower=rest[far].sum(axis=0),
        upper=np.einsum("i,isl->sl", 1 / w[~far] ** 2, rest[~far]), band=real.ends, misfit=fit.misfit,
        dropped=dropped, stabilisation=found, frf=table, flags=flags, _model=model.with_flags(flags),
        _reciprocal=reciprocal(shapes, driving, pairs),
    )  # fmt: skip


def _spread(p: Complex, covariance: Real, modes: int) -> tuple[Real, Real]:
    """Std of natural frequencies (Hz) and of damping ratios of the first poles of so many."""
    n, size = len(p), np.abs(p)
    power = np.diag(covariance)
    xx, yy, xy = power[:n], power[modes : modes + n], np.diag(covariance[:n, modes : modes + n])
    a, b = p.real / size, p.imag / size
    f_std = np.sqrt(np.maximum(a * a * xx + b * b * yy + 2 * a * b * xy, 0)) / (2 * np.pi)
    c, d = -(p.imag**2) / size**3, p.real * p.imag / size**3
    return f_std, np.sqrt(np.maximum(c * c * xx + d * d * yy + 2 * c * d * xy, 0))


def _unit(v: Complex) -> Complex:
    """Vectors (modes, entries), each with its largest entry 1."""
    top = v[np.arange(len(v)), np.argmax(np.abs(v), axis=1)] if len(v) else np.ones(0)
    return v / np.where(top == 0, 1, top)[:, None]


def _mpc(v: Complex) -> Real:
    """Modal phase collinearity of vectors (modes, entries): R. S. Pappa et al., NASA TM 107612 (1992)."""
    xx, yy, xy = np.sum(v.real**2, axis=1), np.sum(v.imag**2, axis=1), np.sum(v.real * v.imag, axis=1)
    whole = np.where(xx + yy > 0, xx + yy, 1.0)
    return np.asarray(((xx - yy) ** 2 + 4 * xy**2) / whole**2)
