"""How a sensor poses its problem to the static family: who may be loaded, constraints, fewer readings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loadid.families.static import StaticInversion
from structures.arrays import MatrixModel
from structures.errors import InputError
from structures.flags import Flag
from structures.values import plain

from .reading import Wrench

Array = NDArray[np.float64]


class PadModel(MatrixModel):
    """A transfer matrix on the surface of a pad, with the basis of its loads where there is one."""

    def __init__(
        self, H: Array, sensors: Sequence[Any], loads: Sequence[Any], basis: Any, flags: Sequence[Flag]
    ) -> None:
        super().__init__(H, sensors=sensors, loads=loads)
        self.basis, self.flags = basis, tuple(flags)


def supported(support: ArrayLike | None, points: int) -> NDArray[np.intp] | None:
    """Loads (3 k,) at the nodes of a support: a mask (P,) or node numbers; None is all.

    Raises
    ------
    InputError
        If it does not fit, or is empty.
    """
    if support is None:
        return None
    given = np.asarray(plain(support))
    mask = given.dtype == bool
    nodes = np.flatnonzero(given) if mask else np.unique(given)
    fits = given.shape == (points,) if mask else given.dtype.kind in "iu" and np.all((nodes >= 0) & (nodes < points))
    if not fits or nodes.size == 0:
        raise InputError(
            "the support does not fit the surface", where="support", found=f"{given.dtype} {given.shape}",
            expected=f"a mask ({points},) or numbers of nodes, not empty",
        )  # fmt: skip
    return (3 * nodes[:, None] + np.arange(3)).ravel()


def cut(penalty: Any, basis: Any, kept: NDArray[np.intp]) -> Any:
    """A penalty on the loads that may act."""
    from loadid.families import smoothness

    if penalty is None or (isinstance(penalty, str) and penalty == "identity"):
        return penalty
    if basis is None and isinstance(penalty, str):
        raise InputError(
            "this penalty needs to know which loads are neighbours", where="penalty", found=penalty,
            expected="'identity', or a matrix",
        )  # fmt: skip
    L: Any = smoothness.matrix(penalty, np.shape(penalty)[-1] if basis is None else len(basis), basis)
    dense = np.asarray(L.toarray() if hasattr(L, "toarray") else L)[:, kept]
    return dense[np.any(dense != 0, axis=1)]


def constraints(loads: int, no_pull: bool, friction: float | None, resultant: Array, wrench: Wrench | None) -> list:
    """Constraints of the static family: friction cones or pressures that are not negative, and a resultant."""
    from loadid.inverse.constraints import Bounds, FrictionCone, Resultant

    triples = np.arange(loads).reshape(-1, 3)
    out: list[Any] = []
    if friction is not None:
        out.append(FrictionCone(friction, triples, normals=np.tile([0.0, 0.0, -1.0], (len(triples), 1))))
    elif no_pull:
        out.append(Bounds(upper=0.0, loads=triples[:, 2]))
    if wrench is not None:
        spread = None if wrench.std is None else wrench.std**2
        out.append(Resultant(resultant[: len(wrench.value)], wrench.value, covariance=spread))
    return out


def constrained(family: StaticInversion, found: list[Any]) -> StaticInversion:
    """The same family under constraints."""
    return family if not found else StaticInversion(family.model, constraints=found, **_settings(family))


def fewer(family: StaticInversion, sensors: list[str]) -> StaticInversion:
    """The same family on fewer sensors, at the same relative lambda."""
    other = StaticInversion(family.model, **{**_settings(family), "sensors": sensors})
    other.calibration = family.calibration
    return other


def resultant_covariance(posterior: Any, R: Array) -> Array:
    """Covariance (6, 6) of the resultant from variances of sums of its rows; zero where nothing is known."""
    if posterior is None:
        return np.zeros((6, 6))
    alone = np.array([float(posterior.variance(r)) for r in R])
    # rows of forces and moments differ in size: scaled, so that neither drowns the other
    size = np.sqrt(np.maximum(alone, 0.0))
    rows = R / np.where(size > 0, size, 1.0)[:, None]
    out = np.diag(alone)
    for i in range(6):
        for j in range(i):
            a, b = (float(posterior.variance(rows[i] + s * rows[j])) for s in (1, -1))
            out[i, j] = out[j, i] = (a - b) / 4 * size[i] * size[j]
    return out


def _settings(family: StaticInversion) -> dict[str, Any]:
    return {
        "penalty": family.penalty,
        "choice": family.choice,
        "noise": family.noise,
        "noise_source": None if family.noise_source is None else family.noise_source.text,
        "allow": list(family.allow),
        "sensors": family.sensors,
    }
