"""Modal test: poles, shapes and modal masses from FRFs or from records with known force, and a model made of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._channels import Channel
from .._flags import Evidence, Flag, collect
from .._model import Model
from .._models.measured import MeasuredModel
from .._models.modal import ModalModel
from .._models.reduction import ReducedModel, highpass
from .._models.tabulated import FrfModel
from ..errors import InputError, whole
from . import kinds
from .impact import judge, unusable
from .modalfit import FrfBand, ModalFit
from .modalorder import reweighted, selected
from .normalmodes import NormalFit, normal
from .polyreference import ORDERS, REFERENCES, Stabilisation, stabilisation
from .spectra import smooth_lines
from .welch import gather

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

LEAST = 16  # lines of a band
SMALL = 1e-6  # of the rms of an entry, below which its std is not believed
MISFIT = 1.5  # mean squared residual over the stated variance, above which the residuals say what the std is
VAGUE = 0.2  # relative std of a damping ratio
SURE, BROAD = 0.05, 0.1  # relative std of its decay, and damping ratio, up to which an added pole is a mode
NARROW = 4.0  # lines within the half-power bandwidth, below which a Hann window makes damping too large
LEFT = 0.01  # share of the power of the FRFs that real shapes may leave
MISSED = 0.05  # of the rms of the FRFs that the model may miss, beyond their noise
ORDER = {**kinds.ORDER, "strain": 0, "angle": 0}


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
        columns, channels, kept = [], [], []
        n = len(own.reduced.lam)
        for label in loads:
            if label in tested:
                columns.append(own.reduced.B[:, tested[label]])
                channels.append(own.loads[tested[label]])
                kept.append(tested[label])
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
            column = np.zeros(n)
            column[: len(self)] = self.normal_shapes[seen[label]]
            columns.append(column)
            channels.append(Channel(label=label, quantity="force", unit="N"))
        reduced = replace(own.reduced, B=np.column_stack(columns))
        whole_test = len(kept) == len(loads)
        return own.with_columns(reduced, channels, kept if whole_test else None)


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
    table = _table(source, forces, responses, dt, kind, segment)
    picked = _picked(table, band)
    fitted_band, turned, weights_known = _prepared(picked)
    stated = fitted_band.std if weights_known else None
    poles, participation, found = _start(fitted_band, order)
    if not len(poles):
        raise _nothing(found)
    fit, dropped = selected(fitted_band, poles, participation)
    if not weights_known or fit.misfit > MISFIT:
        fitted_band = reweighted(fitted_band, fit.residual, known=weights_known)
        poles, participation, again = _start(fitted_band, order)  # weak modes stay where the weights are right
        if len(poles) >= np.sum(fit.stayed):
            found, (fit, dropped) = again, selected(fitted_band, poles, participation)
        else:
            fit, more = selected(fitted_band, fit.poles, fit.participation, fit.stayed)
            dropped += more
    fit, inside = _sorted(fit, fitted_band)
    if not inside:
        raise _nothing(found)
    real = normal(fitted_band, fit, stated)
    return _result(picked, fitted_band, fit, real, inside, turned, found, dropped, driven)


def _nothing(found: Stabilisation) -> InputError:
    return InputError(
        "no mode stays from one order to the next and explains more than noise", where="identify_modes",
        found=f"{len(found.poles)} poles over all orders, {found.unstable} unstable ones left out",
        expected="a mode in the band", hint="another band, a higher order, or FRFs with more coherence",
    )  # fmt: skip


# -- what is fitted ---------------------------------------------------------------------------------------------------
def _table(source: Any, forces: Any, responses: Any, dt: float | None, kind: str | None, segment: int | None) -> Model:
    """FRFs of a source: a model as it is, records estimated."""
    if isinstance(source, Model):
        if source.frequencies is None:
            raise InputError("a model that has no lines of its own", where="identify_modes", found=repr(source)[:200],
                             expected="measured FRFs or records",
                             hint="FrfModel.of(model, lines) is its table")  # fmt: skip
        return source
    if forces is None or responses is None:
        raise InputError("which channels are forces?", where="identify_modes", found=f"{forces=}, {responses=}",
                         expected="forces= and responses= of records, or an FrfModel",
                         hint="FrfModel.from_frf(f, H, kind=...) takes arrays of FRFs")  # fmt: skip
    records = source if isinstance(source, list | tuple) else [source]
    several = isinstance(forces, list | tuple) and len(forces) > 1
    force = forces[0] if isinstance(forces, list | tuple) else forces
    if not several and _hammered(records, force, dt):
        heard = list(responses) if isinstance(responses, list | tuple) else [responses]
        made: Model = MeasuredModel.from_hits(list(records), dt=dt, force=force, responses=heard)
        return made
    return FrfModel.from_records(source, forces=forces, responses=responses, dt=dt, kind=kind, segment=segment)


def _hammered(records: Sequence[Any], force: str | int, dt: float | None) -> bool:
    """Whether the force of every record is one hit, and rest besides."""
    tables, _, channels = gather(list(records), dt, None)
    labels = [c.label for c in channels]
    column = labels.index(force) if force in labels else int(force) if isinstance(force, int) else None
    if column is None:
        raise InputError("no such channel", where="forces", found=repr(force), expected=f"one of {labels}")
    for t in tables:
        f = t[:, column] - np.median(t[:, column])
        quiet = np.zeros((len(f), 0))
        if unusable(f, quiet, []) or judge(f, quiet, []):
            return False
    return True


def _picked(table: Model, band: tuple[float, float] | None) -> FrfModel:
    """The lines of a band, as a table with their variance."""
    f = np.asarray(table.frequencies, float)
    low, high = (0.0, np.inf) if band is None else (float(band[0]), float(band[1]))
    within = (f > 0) & (f >= low) & (f <= high)
    if table.sampled:
        within &= f < f[-1]  # the last line of a transform is real
    if np.sum(within) < LEAST:
        raise InputError("too few lines in the band", where="identify_modes", found=f"{int(np.sum(within))} lines",
                         expected=f"at least {LEAST}",
                         hint=f"the FRFs run from {f[0]:.5g} to {f[-1]:.5g} Hz")  # fmt: skip
    f = f[within]
    return FrfModel(
        f, table.frf(f), sensors=table.sensors, loads=table.loads, variance=table.frf_variance(f), flags=table.flags
    )


def _orders(sensors: Sequence[Channel]) -> NDArray[np.int64]:
    """How often each sensor's reading is derived from a displacement."""
    unknown = next((s for s in sensors if s.quantity not in ORDER), None)
    if unknown is not None:
        raise InputError(
            "receptance, mobility or accelerance?", where=f"channel {unknown.label}", found=unknown.quantity,
            expected="displacement, velocity, acceleration or strain", code="LID-W208",
            hint="state the quantity of the channel, or FrfModel.from_frf(f, H, kind=...)",
        )  # fmt: skip
    return np.array([ORDER[s.quantity] for s in sensors])


def _prepared(table: FrfModel) -> tuple[FrfBand, bool, bool]:
    """FRFs of one kind with their std, whether loads were taken for outputs, and whether the std was known."""
    own, f = _orders(table.sensors), table.frequencies
    common = int(np.bincount(own).argmax())
    corner = np.array([s.highpass or 0.0 for s in table.sensors])
    factor = (2j * np.pi * f[:, None]) ** (common - own) / highpass(f, corner)
    H = table.H * factor[:, :, None]
    rms = np.sqrt(np.mean(np.abs(H) ** 2, axis=0))
    rms = np.where(rms > 0, rms, rms.max())
    known = table.variance is not None and bool(np.any(table.variance > 0))
    if known:
        power = smooth_lines(np.asarray(table.variance), 3) * np.abs(factor[:, :, None]) ** 2
        std = np.sqrt(np.maximum(power, (SMALL * rms) ** 2))
    else:
        std = np.broadcast_to(rms, H.shape)
    turned = H.shape[2] > H.shape[1]
    if turned:
        H, std = H.transpose(0, 2, 1), std.transpose(0, 2, 1)
    return FrfBand(f, H, np.array(std), common), turned, known


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
    table: FrfModel, band: FrfBand, fit: ModalFit, real: NormalFit, n: int, turned: bool, found: Stabilisation,
    dropped: int, driven: tuple[str, str] | None,
) -> MeasuredModes:  # fmt: skip
    p, size = fit.poles[:n], np.abs(fit.poles[:n])
    x, y = p.real, p.imag
    own = np.concatenate([np.arange(n), len(fit.poles) + np.arange(n)])
    cov = fit.covariance[np.ix_(own, own)]
    xx, yy, xy = np.diag(cov)[:n], np.diag(cov)[n:], np.diag(cov[:n, n:])
    a, b = x / size, y / size
    f_std = np.sqrt(np.maximum(a * a * xx + b * b * yy + 2 * a * b * xy, 0)) / (2 * np.pi)
    c, d = -(y**2) / size**3, x * y / size**3
    z_std = np.sqrt(np.maximum(c * c * xx + d * d * yy + 2 * c * d * xy, 0))
    outputs, references = fit.shapes[:n], fit.participation[:n]
    shapes, driving = (references, outputs) if turned else (outputs, references)
    S, B, rest = real.shapes, real.participation, real.rest
    if turned:
        S, B, rest = B, S, rest.transpose(0, 2, 1)
    scale, mass, spread = _masses(table, S[:n], B[:n], real, n, turned, driven)
    known = np.isfinite(scale)
    S, B = np.array(S), np.array(B)
    S[:n][known] *= scale[known, None]
    B[:n][known] /= scale[known, None]
    top = np.max(np.abs(S[:n]), axis=1, initial=0)
    shown = np.where(known[:, None], S[:n], S[:n] / np.where(top > 0, top, 1)[:, None])
    far = real.low
    w = np.abs(real.rest_poles)
    model = _modelled(table, band, real, S, B, rest, n, turned)
    told = outputs if outputs.shape[1] > 1 else references
    result = MeasuredModes(
        frequencies=size / (2 * np.pi), damping=-x / size, frequency_std=f_std, damping_std=z_std,
        shapes=_unit(shapes).T, participation=_unit(driving).T, normal_shapes=shown.T, mpc=_mpc(told),
        modal_mass=mass, modal_mass_std=spread, lower=rest[far].sum(axis=0),
        upper=np.einsum("i,isl->sl", 1 / w[~far] ** 2, rest[~far]), band=(float(band.f[0]), float(band.f[-1])),
        misfit=fit.misfit, dropped=dropped, stabilisation=found, frf=table, flags=(), _model=model,
    )  # fmt: skip
    flags = collect([*table.flags, _complex(result, real), _poor(result, band), _missed(table, model)])
    return replace(result, flags=flags, _model=model.with_flags(flags))


def _unit(v: Complex) -> Complex:
    """Vectors (modes, entries), each with its largest entry 1."""
    top = v[np.arange(len(v)), np.argmax(np.abs(v), axis=1)] if len(v) else np.ones(0)
    return v / np.where(top == 0, 1, top)[:, None]


def _mpc(v: Complex) -> Real:
    """Modal phase collinearity of vectors (modes, entries): R. S. Pappa et al., NASA TM 107612 (1992)."""
    xx, yy, xy = np.sum(v.real**2, axis=1), np.sum(v.imag**2, axis=1), np.sum(v.real * v.imag, axis=1)
    whole = np.where(xx + yy > 0, xx + yy, 1.0)
    return np.asarray(((xx - yy) ** 2 + 4 * xy**2) / whole**2)


def _masses(
    table: FrfModel, S: Real, B: Real, real: NormalFit, n: int, turned: bool, driven: tuple[str, str] | None
) -> tuple[Real, Real, Real]:
    """Factor on the shapes that makes their modal mass one, modal mass of shapes whose largest entry is 1, its std."""
    pairs = [(i, j, kinds.drive_point(s, c)) for i, s in enumerate(table.sensors) for j, c in enumerate(table.loads)]
    pairs = [one for one in pairs if one[2] and table.sensors[one[0]].quantity in kinds.ORDER]
    if driven is not None:
        names = [s.label for s in table.sensors], [c.label for c in table.loads]
        if len(driven) != 2 or driven[0] not in names[0] or driven[1] not in names[1]:
            raise InputError("no such driven point", where="driven", found=repr(driven),
                             expected=f"(sensor, load) of {names[0]} and {names[1]}")  # fmt: skip
        pairs.append((names[0].index(driven[0]), names[1].index(driven[1]), 1))
    scale = np.full(n, np.nan)
    relative = np.full(n, np.nan)
    if pairs:
        i, j, sign = np.array(pairs).T
        product = sign * S[:, i] * B[:, j]  # square of the shape of unit mass at the driven points
        square = product.sum(axis=1) / np.maximum(np.sum(S[:, i] ** 2, axis=1), np.finfo(float).tiny)
        scale = np.where(square > 0, np.sqrt(np.maximum(square, 0)), np.nan)
        at = zip(j, i, strict=True) if turned else zip(i, j, strict=True)
        std = np.sqrt([real.residue_variance(o, r)[:n] for o, r in at])
        relative = np.min(std / np.maximum(np.abs(S[:, i] * B[:, j]).T, np.finfo(float).tiny), axis=0)
    top = np.maximum(np.max(np.abs(S), axis=1, initial=0) * scale, np.max(np.abs(B), axis=1, initial=0) / scale)
    mass = 1 / np.where(top > 0, top, np.nan) ** 2
    return scale, mass, mass * relative


def _modelled(
    table: FrfModel, band: FrfBand, real: NormalFit, S: Real, B: Real, rest: Real, n: int, turned: bool
) -> ModalModel:
    """Forward model of the modes and of resonators for what lies outside the band, one for each rank of their share."""
    lam, damping = [*(np.abs(real.poles) ** 2)], [*(-2 * real.poles.real)]
    rows, columns = [*S], [*B]
    for matrix, p in zip(rest, real.rest_poles, strict=True):
        U, sizes, V = np.linalg.svd(matrix, full_matrices=False)
        for u, size, v in zip(U.T, sizes, V, strict=True):
            if size > 1e-9 * sizes[0]:
                lam.append(abs(p) ** 2)
                damping.append(-2 * p.real)
                rows.append(u * np.sqrt(size))
                columns.append(v * np.sqrt(size))
    reduced = ReducedModel(
        lam=np.array(lam), damping=np.array(damping), S=np.array(rows).T, B=np.array(columns), residual=None,
        derivative=_orders(table.sensors), corner=np.array([s.highpass or 0.0 for s in table.sensors]),
    )  # fmt: skip
    ends = (float(band.f[0]), float(band.f[-1]))
    return ModalModel(
        reduced, table.sensors, table.loads, modes=n, band=ends, errors=real, turned=turned, kind=band.derivative
    )


def _complex(found: MeasuredModes, real: NormalFit) -> Flag | None:
    """W217 where real shapes leave more of the FRFs than complex ones."""
    if real.share <= LEFT or not len(found):
        return None
    k = int(np.argmin(found.mpc))
    return Flag(
        "W217",
        Evidence("share of the power of the FRFs that real shapes leave", real.share, LEFT),
        f"the shapes are complex: lowest modal phase collinearity {found.mpc[k]:.2f} at {found.frequencies[k]:.5g} Hz",
    )


def _poor(found: MeasuredModes, band: FrfBand) -> Flag | None:
    """W218 for modes at the ends of the band, too narrow for its lines, on top of each other, or vague."""
    f, z = found.frequencies, found.damping
    width = 2 * z * f
    step = np.gradient(band.f)[np.clip(np.searchsorted(band.f, f), 0, len(band.f) - 1)]
    gap = np.abs(f[:, None] - f) + np.where(np.eye(len(f)), np.inf, 0.0)
    reasons = [
        ("at the end of the band", (f - band.f[0] < width) | (band.f[-1] - f < width)),
        ("narrower than the lines", width < NARROW * step),
        ("on top of another", np.any(gap < 0.5 * (width[:, None] + width), axis=1)),
        (f"damping known to {VAGUE:.0%} at most", found.damping_std > VAGUE * z),
    ]
    bad = np.any([mask for _, mask in reasons], axis=0)
    if not bad.any():
        return None
    said = [f"{', '.join(f'{x:.5g}' for x in f[mask][:8])} Hz: {why}" for why, mask in reasons if mask.any()]
    return Flag("W218", Evidence("modes that the test tells poorly", float(bad.sum()), 0.0), "; ".join(said))


def _missed(table: FrfModel, model: ModalModel) -> Flag | None:
    """W219 where the model does not answer as the structure was measured to, whatever the std of its modes."""
    off = np.abs(model.frf(table.frequencies) - table.H) ** 2
    noise = np.zeros(off.shape) if table.variance is None else np.asarray(table.variance)
    power = np.mean(np.abs(table.H) ** 2, axis=0)
    power = np.where(power > 0, power, 1.0)
    each = np.sqrt(np.maximum(np.mean(off - noise, axis=0), 0) / power)
    all_of_it = float(np.sqrt(np.mean(each**2)))
    if all_of_it <= MISSED:
        return None
    i, j = np.unravel_index(int(np.argmax(each)), each.shape)
    line = int(np.argmax(np.sum(off / power, axis=(1, 2))))
    return Flag(
        "W219",
        Evidence("rms of the measured FRFs that the model misses beyond their noise", all_of_it, MISSED),
        f"the modes miss the measured FRFs by {all_of_it:.0%}, {table.sensors[i].label} over {table.loads[j].label} by "
        f"{each[i, j]:.0%}, most at {table.frequencies[line]:.5g} Hz",
    )
