"""How a forward model is reduced: what it was asked for, the modes that this takes, and what they make of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from . import krylov
from .damping import loss_factor
from .errors import InputError
from .modes import DENSE, Modes, modal_damping, modes
from .reduction import ReducedModel, static_residual
from .structure import Structure
from .values import positive, shown

DEFAULT_MODES = 60  # of a large structure
BAND_FACTOR = 2.5  # modes up to this multiple of the band: with the residual, a per cent of error on the worst lines
BLIND = 1e-9  # share of a rigid mode in a row or column that is rounding
KINDS = ("modes", "krylov")


def settled(structure: Structure, count: Any, residual: Any, band: Any, reduction: Any) -> dict[str, Any]:
    """The settings of a reduction, checked: ``modes``, ``residual``, ``band`` (Hz) and ``reduction``.

    Raises
    ------
    InputError
        If one is none, or a Krylov basis lacks its band.
    """
    size = structure.free.size
    if count is not None and not (
        isinstance(count, int | np.integer) and not isinstance(count, bool) and 1 <= count <= size
    ):
        raise InputError(
            "no such number of modes",
            where="modes",
            found=repr(count),
            expected=f"1..{size}",
            hint="leave modes out: band= in Hz chooses them",
        )
    if reduction not in KINDS:
        raise InputError(
            "no such reduction",
            where="reduction",
            found=shown(reduction),
            expected="'modes' or 'krylov'",
            hint="leave it out: modes and their static residual",
        )
    if reduction == "krylov" and (band is None or count is not None):
        raise InputError(
            "a Krylov basis is made for a band, not for a number of modes",
            where="reduction='krylov'",
            found=f"band={band}, modes={count}",
            expected="band= in Hz, no modes=",
            hint="pass the highest frequency of interest as band=",
        )
    return {
        "modes": None if count is None else int(count),
        "residual": bool(residual),
        "band": None if band is None else positive("band", band, where="ForwardModel", unit="Hz"),
        "reduction": reduction,
    }


def needs(settings: Mapping[str, Any], reduction: str, what: str) -> None:
    """Refuse what only the other reduction has."""
    if settings["reduction"] != reduction:
        raise InputError(
            f"the model is reduced by {settings['reduction']}: it has no {what}",
            where="ForwardModel",
            found=f"reduction={settings['reduction']!r}",
            expected=f"reduction={reduction!r}",
            hint="build the model with it" + (", and with band=" if reduction == "krylov" else ""),
        )


def within(settings: Mapping[str, Any], f: NDArray) -> None:
    """Refuse lines above the band of a Krylov basis: nothing is known of its error there."""
    band = settings["band"]
    if settings["reduction"] == "krylov" and len(f) and f.max() > band * (1 + 1e-9):
        raise InputError(
            "a line lies above the band of the Krylov basis",
            where="frequencies",
            found=f"{f.max():.6g} Hz",
            expected=f"at most {band:g} Hz",
            hint="build the model with a higher band=",
        )


def wanted(size: int, settings: Mapping[str, Any]) -> int:
    """Number of modes, of `size`, to begin with."""
    return settings["modes"] or (size if size <= DENSE else min(DEFAULT_MODES, size))


def retained(structure: Structure, settings: Mapping[str, Any]) -> Modes:
    """As many modes as were asked for, or as the band needs."""
    n = structure.free.size
    k, band = wanted(n, settings), settings["band"]
    found = modes(structure, k)
    while band is not None and settings["modes"] is None and k < n:
        if found.frequencies[-1] >= BAND_FACTOR * band:
            k = int(np.searchsorted(found.frequencies, BAND_FACTOR * band)) + 1
            return Modes(found.lam[:k], found.phi[:, :k], min(found.rigid, k), found.shift, found.factor)
        k = min(2 * k, n)
        found = modes(structure, k)
    return found


def reduced(
    structure: Structure,
    shapes: Modes,
    S: Any,
    B: Any,
    readings: tuple[NDArray[np.int64], NDArray[np.float64]],
    static: Callable[[], NDArray] | None,
) -> ReducedModel:
    """The small model that modes, or the Ritz pairs in their place, make of a structure.

    Parameters
    ----------
    structure : Structure
    shapes : Modes
    S : sparse (sensors, n_free)
    B : sparse (n_free, loads), or array (samples, n_free, loads) where a load moves
    readings : derivative, corner
        As in `ReducedModel`.
    static : callable or None
        ``S K^-1 B`` of a supported structure under loads that stay; None where no residual is wanted.
    """
    moving = not sparse.issparse(B)
    modal_S = S @ shapes.phi
    modal_B = np.einsum("nk,tnp->tkp", shapes.phi, B, optimize=True) if moving else np.asarray(B.T @ shapes.phi).T
    # A strain gauge sees no rigid motion, a self-balanced load drives none: zero, not rounding.
    r = shapes.rigid
    modal_S[:, :r][np.abs(modal_S[:, :r]) < BLIND * np.abs(modal_S).max(axis=1, keepdims=True)] = 0.0
    modal_B[..., :r, :][np.abs(modal_B[..., :r, :]) < BLIND * np.abs(modal_B).max(axis=-2, keepdims=True)] = 0.0
    residual = None
    if static is not None and len(shapes.lam) < structure.free.size:
        if moving:
            full = shapes.factor.solve(S.T.toarray()).T
            residual = np.einsum("sn,tnp->tsp", full, B) - (modal_S / (shapes.lam - shapes.shift)) @ modal_B
        else:
            residual = static_residual(shapes, S, B, modal_S, modal_B, static() if shapes.shift == 0 else None)
    damping, loss = modal_damping(structure, shapes), loss_factor(structure.damping)
    return ReducedModel(shapes.lam, damping, modal_S, modal_B, residual, *readings, loss)


def described(settings: Mapping[str, Any], size: int, shapes: Modes | None, basis: krylov.Krylov | None) -> str:
    """What a model retains, in words; `shapes` and `basis` where they are known already."""
    band = settings["band"]
    if settings["reduction"] == "krylov":
        known = "" if basis is None else f", {basis.projection.theta.size} vectors, error {basis.estimate:.1e}"
        return f"Krylov basis to {band:g} Hz{known}"
    rest = " + static residual" if settings["residual"] else ""
    if settings["modes"] is None and band and size > DENSE and shapes is None:
        return f"modes up to {BAND_FACTOR:g} x {band:g} Hz{rest}"
    k = len(shapes.lam) if shapes is not None else wanted(size, settings)
    return f"all {size} modes" if k == size else f"{k} of {size} modes{rest}"
