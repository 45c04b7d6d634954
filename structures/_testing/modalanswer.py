"""What fitted modes tell: their scale by driven points, the forward model made of them, and the flags they raise."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._flags import Evidence, Flag
from .._models.modal import ModalModel
from .._models.reduction import ReducedModel
from .._models.tabulated import FrfModel
from .._models.viscous import ComplexModes
from ..errors import InputError
from . import kinds
from .modaldata import orders
from .modalfit import FrfBand
from .modalshapes import ComplexFit, NormalFit

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Pairs = tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]  # sensors, loads, signs

VAGUE = 0.2  # relative std of a damping ratio
NARROW = 4.0  # lines within the half-power bandwidth, below which a Hann window makes damping too large
LEFT = 0.01  # share of the power of the FRFs that real shapes may leave
TURNED = 1e-4  # and from which on complex ones are taken
MISSED = 0.05  # of the rms of the FRFs that the model may miss, beyond their noise


def driven_points(table: FrfModel, driven: tuple[str, str] | None) -> Pairs | None:
    """Sensors and loads at one place along one axis, and whether along it or against it; None without any.

    Raises
    ------
    InputError
        If `driven` names no sensor and load of the table.
    """
    pairs = [(i, j, kinds.drive_point(s, c)) for i, s in enumerate(table.sensors) for j, c in enumerate(table.loads)]
    pairs = [one for one in pairs if one[2] and table.sensors[one[0]].quantity in kinds.ORDER]
    if driven is not None:
        names = [s.label for s in table.sensors], [c.label for c in table.loads]
        if len(driven) != 2 or driven[0] not in names[0] or driven[1] not in names[1]:
            raise InputError("no such driven point", where="driven", found=repr(driven),
                             expected=f"(sensor, load) of {names[0]} and {names[1]}")  # fmt: skip
        pairs.append((names[0].index(driven[0]), names[1].index(driven[1]), 1))
    return (*np.array(pairs).T,) if pairs else None


def masses(S: Real, B: Real, real: NormalFit, turned: bool, pairs: Pairs | None) -> tuple[Real, Real, Real]:
    """Factor on the shapes that makes their modal mass one, modal mass of shapes whose largest entry is 1, its std.

    Of the shapes S (modes, sensors) and participations B (modes, loads), the first ones of the fit.
    """
    n = len(S)
    scale, relative = np.full(n, np.nan), np.full(n, np.nan)
    if pairs is not None:
        i, j, sign = pairs
        product = sign * S[:, i] * B[:, j]  # square of the shape of unit mass at the driven points
        square = product.sum(axis=1) / np.maximum(np.sum(S[:, i] ** 2, axis=1), np.finfo(float).tiny)
        scale = np.where(square > 0, np.sqrt(np.maximum(square, 0)), np.nan)
        at = zip(j, i, strict=True) if turned else zip(i, j, strict=True)
        std = np.sqrt([real.residue_variance(o, r)[:n] for o, r in at])
        relative = np.min(std / np.maximum(np.abs(S[:, i] * B[:, j]).T, np.finfo(float).tiny), axis=0)
    top = np.maximum(np.max(np.abs(S), axis=1, initial=0) * scale, np.max(np.abs(B), axis=1, initial=0) / scale)
    mass = 1 / np.where(top > 0, top, np.nan) ** 2
    return scale, mass, mass * relative


def reciprocal(S: Complex, B: Complex, pairs: Pairs | None) -> Complex:
    """Participation over shape (modes,), the same at every place: complex shapes (modes, sensors) and loads."""
    if pairs is None:
        return np.full(len(S), np.nan, complex)
    i, j, sign = pairs
    power = np.sum(np.abs(S[:, i]) ** 2, axis=1)
    return np.asarray(np.sum(S[:, i].conj() * sign * B[:, j], axis=1) / np.where(power > 0, power, np.nan))


def truer(real: NormalFit, complex_: ComplexFit, band: FrfBand) -> tuple[NormalFit | ComplexFit, float]:
    """The fit that the model is made of, and the share of the power of the FRFs that real shapes leave to complex ones.

    Complex shapes are taken where they explain more than their unknowns would (Schwarz), and 1 % of the FRFs.
    """
    whole = float(np.sum(np.abs(band.H / band.std) ** 2))
    gain = real.power - complex_.power
    more = real.shapes.size + len(complex_.common) - len(real.common)
    misfit = complex_.power / band.H.size
    share = max(0.0, gain / whole)
    worth = 2 * gain > more * np.log(2 * band.H.size) * misfit and share > TURNED
    return complex_ if worth else real, share


def modelled(
    table: FrfModel, band: FrfBand, fit: NormalFit | ComplexFit, scale: Real, n: int, turned: bool
) -> ModalModel:
    """Forward model of the modes and of resonators for what lies outside the band, one for each rank of their share."""
    S, B, rest = fit.shapes, fit.participation, fit.rest
    if turned:
        S, B, rest = B, S, rest.transpose(0, 2, 1)
    own: dict[str, Any] = {
        "derivative": orders(table.sensors),
        "corner": np.array([s.highpass or 0.0 for s in table.sensors]),
    }
    lam: list[float] = []
    damping: list[float] = []
    rows, columns = [np.zeros((0, S.shape[1]))], [np.zeros((0, B.shape[1]))]
    viscous = None
    if isinstance(fit, ComplexFit):
        viscous = ComplexModes(poles=fit.poles, shapes=S.T, participation=B, **own)
    else:
        factor = np.ones(len(S))
        factor[:n] = np.where(np.isfinite(scale), scale, 1.0)
        lam, damping = [*(np.abs(fit.poles) ** 2)], [*(-2 * fit.poles.real)]
        rows.append(S * factor[:, None])
        columns.append(B / factor[:, None])
    for matrix, p in zip(rest, fit.rest_poles, strict=True):
        U, sizes, V = np.linalg.svd(matrix, full_matrices=False)
        for u, size, v in zip(U.T, sizes, V, strict=True):
            if size > 1e-9 * sizes[0]:
                lam.append(abs(p) ** 2)
                damping.append(-2 * p.real)
                rows.append(u[None] * np.sqrt(size))
                columns.append(v[None] * np.sqrt(size))
    reduced = ReducedModel(
        lam=np.array(lam), damping=np.array(damping), S=np.concatenate(rows).T, B=np.concatenate(columns),
        residual=None, **own,
    )  # fmt: skip
    return ModalModel(
        reduced, table.sensors, table.loads, modes=n, band=fit.ends, viscous=viscous, errors=fit, turned=turned,
        kind=band.derivative,
    )  # fmt: skip


# -- flags ------------------------------------------------------------------------------------------------------------
def complex_flag(share: float, mpc: Real, frequencies: Real) -> Flag | None:
    """W217 where real shapes leave more of the FRFs than complex ones."""
    if share <= LEFT or not len(mpc):
        return None
    k = int(np.argmin(mpc))
    return Flag(
        "W217",
        Evidence("share of the power of the FRFs that real shapes leave", share, LEFT),
        f"the shapes are complex: lowest modal phase collinearity {mpc[k]:.2f} at {frequencies[k]:.5g} Hz",
    )


def poor_flag(f: Real, z: Real, z_std: Real, band: FrfBand) -> Flag | None:
    """W218 for modes at the ends of the band, too narrow for its lines, on top of each other, or vague."""
    width = 2 * z * f
    step = np.gradient(band.f)[np.clip(np.searchsorted(band.f, f), 0, len(band.f) - 1)]
    gap = np.abs(f[:, None] - f) + np.where(np.eye(len(f)), np.inf, 0.0)
    reasons = [
        ("at the end of the band", (f - band.f[0] < width) | (band.f[-1] - f < width)),
        ("narrower than the lines", width < NARROW * step),
        ("on top of another", np.any(gap < 0.5 * (width[:, None] + width), axis=1)),
        (f"damping known to {VAGUE:.0%} at most", z_std > VAGUE * z),
    ]
    bad = np.any([mask for _, mask in reasons], axis=0)
    if not bad.any():
        return None
    said = [f"{', '.join(f'{x:.5g}' for x in f[mask][:8])} Hz: {why}" for why, mask in reasons if mask.any()]
    return Flag("W218", Evidence("modes that the test tells poorly", float(bad.sum()), 0.0), "; ".join(said))


def missed_flag(fit: NormalFit | ComplexFit, table: FrfModel, turned: bool) -> Flag | None:
    """W219 where the model does not answer as the structure was measured to, whatever the std of its modes."""
    each = fit.missed.T if turned else fit.missed
    all_of_it = float(np.sqrt(np.mean(each**2)))
    if all_of_it <= MISSED:
        return None
    i, j = np.unravel_index(int(np.argmax(each)), each.shape)
    bias = np.sum(fit.bias / np.maximum(np.mean(fit.bias, axis=0), np.finfo(float).tiny), axis=(1, 2))
    most = f", most at {fit.f[int(np.argmax(bias))]:.5g} Hz" if np.any(bias) else ""
    return Flag(
        "W219",
        Evidence("rms of the measured FRFs that the model misses beyond their noise", all_of_it, MISSED),
        f"the modes miss the measured FRFs by {all_of_it:.0%}, {table.sensors[i].label} over {table.loads[j].label} by "
        f"{each[i, j]:.0%}{most}",
    )
