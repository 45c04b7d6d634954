"""The side of the estimate in a comparison: which loads, in which unit, with which std; fields and resultants."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from ..estimate import LoadEstimate
from .references import Wrench, numbers

BATCH = 4_000_000  # entries of the weights that are handed to a posterior at once


def columns(e: LoadEstimate, loads: str | Sequence[str | int] | None) -> NDArray[np.intp]:
    """Columns of the loads that are compared."""
    if loads is None:
        return np.arange(len(e.labels))
    if isinstance(loads, str):
        components = [] if e.geometry is None else list(e.geometry.get("components", ()))
        bare = [c.lstrip("+") for c in components]
        if loads not in e.labels and loads.lstrip("+") in bare:
            return np.arange(bare.index(loads.lstrip("+")), len(e.labels), len(components))
        loads = [loads]
    return np.array([e.index(x) for x in loads], dtype=np.intp)


def loads(e: LoadEstimate) -> tuple[NDArray, NDArray | None, None]:
    """Loads and their std, (frames, loads); in their own unit."""
    return np.atleast_2d(e.load), np.atleast_2d(e.std) if np.any(e.std > 0) else None, None


def field(e: LoadEstimate) -> tuple[NDArray, NDArray | None, str | None]:
    """Loads as a field, (frames, loads), their std and their unit where that is another: nodal forces become tractions.

    Raises
    ------
    InputError
        If the result knows no matrix for that.
    """
    geometry = e.geometry or {}
    if geometry.get("kind") != "nodal":
        return loads(e)
    found = np.atleast_2d(e.traction())
    std = row_std(e, np.asarray(geometry["traction"], float))
    line = np.asarray(geometry["coordinates"]).reshape(len(geometry["coordinates"]), -1).shape[1] == 1
    return found, None if std is None else np.broadcast_to(std, found.shape), "N/m" if line else "Pa"


def areas(e: LoadEstimate, columns: NDArray, tractions: bool) -> NDArray[np.float64]:
    """Weights of the inner product: tributary areas where tractions of a basis are compared, else ones."""
    geometry = e.geometry or {}
    measures, kind = geometry.get("measures"), geometry.get("kind")
    if measures is None or kind == "polynomials" or (kind == "nodal" and not tractions):
        return np.ones(len(columns))
    weights = np.asarray(measures, float)[columns // len(geometry.get("components", ("",)))]
    return weights / weights.mean()


def resultants(e: LoadEstimate, wrench: Wrench) -> tuple[NDArray[np.float64], list[str], list[str]]:
    """Weights, labels and units of the resultants."""
    labels = [wrench.labels] if isinstance(wrench.labels, str) else [str(x) for x in wrench.labels]
    if wrench.C is not None:
        C = np.atleast_2d(numbers(wrench.C, "weights of the resultants"))
        labels = labels or [f"R{i + 1}" for i in range(len(C))]
        if C.shape != (len(labels), e.load.shape[-1]):
            raise InputError(
                "the weights of the resultants do not fit", where="Wrench", found=f"shape {C.shape}",
                expected=f"({len(labels)}, {e.load.shape[-1]})", hint="one row per resultant, one column per load",
            )  # fmt: skip
        return C, labels, [_resultant_unit(x, e) for x in labels]
    have = [] if e.geometry is None else [str(x) for x in e.geometry.get("resultant_labels", ())]
    labels = labels or have
    if not have or e.geometry is None or e.geometry.get("resultant") is None or set(labels) - set(have):
        raise InputError(
            "the estimate knows no such resultant", where="Wrench", found=labels or "loads without a basis",
            expected=f"some of {have}" if have else "a model whose loads are a Basis",
            hint="give C (resultants, loads): the weights of the loads in each resultant",
        )  # fmt: skip
    C = np.asarray(e.geometry["resultant"], float)[[have.index(x) for x in labels]]
    return C, labels, [_resultant_unit(x, e) for x in labels]


def _resultant_unit(label: str, e: LoadEstimate) -> str:
    if label.startswith("M"):
        return "N m"
    return "N" if label.startswith("F") or e.geometry is not None or set(e.units) == {"N"} else "arbitrary"


def row_std(e: LoadEstimate, rows: NDArray) -> NDArray[np.float64] | None:
    """Std of weighted sums of the loads, (sums,) or (frames, sums); not less than the bias that the estimate states."""
    if e.posterior is None:
        return None
    own = getattr(e.posterior, "std", None)
    if e.load.ndim == 1 or (own is not None and own.shape == e.load.shape[1:]):
        variance = np.asarray(e.posterior.variance(rows), float)[None]
    else:
        variance = np.empty((len(e.load), len(rows)))
        step = max(1, BATCH // e.load.size)
        for k in range(len(e.load)):
            for i in range(0, len(rows), step):
                weights = np.zeros((len(rows[i : i + step]), *e.load.shape))
                weights[:, k] = rows[i : i + step]
                variance[k, i : i + step] = e.posterior.variance(weights)
    std = np.sqrt(np.maximum(variance, 0.0))
    return std if e.bias is None else np.maximum(std, np.abs(np.atleast_2d(e.bias) @ rows.T))
