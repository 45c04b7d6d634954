"""A map brought to its real sensor by a few records with known force: gain, bias and noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TRUST = 0.5  # std of a gain before any record is seen
BEFORE = 5.0  # squared errors, as large as stated, that count beside those of the records


@dataclass(frozen=True, eq=False)
class Adaptation:
    """What records with known force told.

    Parameters
    ----------
    gain : array (outputs,)
        What outputs are multiplied with.
    bias : array (sensors,)
        Readings without load, SI.
    spread : float
        What the std is multiplied with.
    records : int
    """

    gain: Array
    bias: Array
    spread: float
    records: int

    @classmethod
    def none(cls, outputs: int, sensors: int) -> Self:
        """Nothing was told."""
        return cls(np.ones(outputs), np.zeros(sensors), 1.0, 0)

    @classmethod
    def from_arrays(cls, tree: Mapping[str, Any]) -> Self:
        """Inverse of `vars`."""
        return cls(tree["gain"], tree["bias"], float(tree["spread"]), int(tree["records"]))


def adapted(
    found: Sequence[tuple[Array, Array, Array]], groups: Sequence[NDArray[np.int_]], bias: Array, outputs: int,
    rows: Sequence[NDArray[np.int_]],
) -> Adaptation:  # fmt: skip
    """Gains and noise by records with known force.

    Parameters
    ----------
    found : sequence of (predicted, std, known)
        Of each record, flat and alike.
    rows : sequence of array of int
        Group of each of these numbers.
    groups : sequence of array of int
        Outputs of each group: one gain each.
    bias : array (sensors,)
    outputs : int
    """
    mean, std, known = (np.concatenate([np.ravel(x[i]) for x in found]) for i in range(3))
    which = np.concatenate([np.ravel(r) for r in rows])
    std = np.maximum(std, np.finfo(float).tiny)
    gain, own = np.ones(outputs), np.ones(len(groups))
    for g, members in enumerate(groups):
        at = which == g
        w2 = np.full(int(np.count_nonzero(at)), 1.0) / max(float(np.mean(std[at] ** 2)) if at.any() else 1.0, 1e-300)
        above = float(np.sum(w2 * known[at] * mean[at])) + TRUST**-2
        own[g] = above / (float(np.sum(w2 * mean[at] ** 2)) + TRUST**-2)
        gain[members] = own[g]
    error = (known - own[which] * mean) / (np.abs(own[which]) * std)
    # samples of one record err together: each record counts once
    sizes = [float(np.mean(part**2)) for part in np.split(error, np.cumsum([np.size(x[0]) for x in found])[:-1])]
    spread = float(np.sqrt((BEFORE + float(np.sum(sizes))) / (BEFORE + len(sizes))))
    return Adaptation(gain, bias, spread, len(found))
