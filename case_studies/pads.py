"""What the case studies of the tactile sensors share: the pad, its patch of forces, and tables of rules under noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid.paths import LinearProblem, SVDPath, choose
from tactile import Pad

E, NU, SIZE, THICKNESS, PITCH = 147e3, 0.3223, (20e-3, 16e-3), 3e-3, 1e-3
Array = NDArray[np.float64]


def pad(layers: int = 1, element: str = "standard", thickness: float = THICKNESS) -> Pad:
    """The pad; few layers on purpose (W115)."""
    return Pad(size=SIZE, thickness=thickness, E=E, nu=NU, pitch=PITCH, layers=layers, element=element, allow="W115")


def patch(gel: Pad) -> Array:
    """Nodal forces (P, 3): 2 N of pressure and 0.5 N of shear on the 25 nodes within 3 mm, as a half ellipsoid."""
    r = np.linalg.norm(gel.nodes2d, axis=1)
    weight = np.sqrt(np.maximum(1 - (r / 3e-3) ** 2, 0.0)) * (r < 3e-3 * (1 - 1e-9))
    return np.outer(weight / weight.sum(), [0.5, 0.0, -2.0])


def off(found: Array, truth: Array) -> float:
    """Relative L2 error."""
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


@dataclass(frozen=True)
class Rule:
    """One rule for lambda under noise, medians over draws; shares of the truth."""

    map: float
    normal: float
    peak: float
    edge: float

    def __str__(self) -> str:
        return f"{self.map:.3f} ({100 * self.normal:.1f} %, peak {self.peak:.2f})"


RULES = ("naive", "oracle", "gcv", "discrepancy", "upre")


def rules(
    H: Array, clean: Array, truth: Array, noise: Sequence[float], draws: int = 20, forces: Any = None
) -> list[dict[str, Rule]]:
    """Maps of nodal forces under noise, by each rule for lambda, for each level of noise (m).

    Parameters
    ----------
    H : array (3 P, 3 P)
        Motion under unit loads, whose squares are the penalty: nodal forces, or what `forces` says.
    clean, truth : array (3 P,)
        Motion without noise (m), nodal forces (N).
    forces : sparse array (3 P, 3 P), optional
        Nodal forces of unit loads.

    Notes
    -----
    One factorisation serves all. The naive map is lambda = 0, the oracle the best of 100 lambdas from 1e-3 of the
    smallest singular value to the largest.
    """
    unit = min(noise)
    path = SVDPath(LinearProblem.whitened(H, clean, noise=np.full(len(clean), unit)))
    s = path.singular_values
    sweep = np.geomspace(1e-3 * s[-1] / s[0], 1.0, 100)
    shapes = path.X if forces is None else np.asarray(forces @ path.X)  # nodal forces of each mode
    tables = []
    for level in noise:
        found: dict[str, list[tuple[float, ...]]] = {name: [] for name in RULES}
        for draw in range(draws):
            y = clean + level * np.random.default_rng(draw).standard_normal(len(clean))
            one = path.with_data(y / unit)
            chosen = choose(one, "gcv", sigma=level / unit, source="given")
            said = {r.rule: r for r in chosen.rules}
            tried = shapes @ np.transpose([one.gains(x) for x in sweep])
            best = np.argmin(np.linalg.norm(tried - truth[:, None], axis=0))
            for name in RULES:
                rule = said.get(name)
                lam = {"naive": 0.0, "oracle": float(sweep[best])}.get(name) if rule is None else rule.lam
                assert lam is not None
                edge = float(rule is not None and rule.edge)
                found[name].append((*_judged(shapes @ one.gains(lam), truth), edge))
        tables.append({name: Rule(*np.median(rows, axis=0).tolist()) for name, rows in found.items()})
    return tables


def _judged(load: Array, truth: Array) -> tuple[float, float, float]:
    """Error of the map, error of Fz, and the largest vector over the true one."""
    g, t = load.reshape(-1, 3), truth.reshape(-1, 3)
    normal = abs(g[:, 2].sum() / t[:, 2].sum() - 1)
    return off(g, t), float(normal), float(np.linalg.norm(g, axis=1).max() / np.linalg.norm(t, axis=1).max())
