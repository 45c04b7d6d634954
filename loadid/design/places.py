"""Where sensors and loads of a model are, for pictures; None where that is not known."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.model import Model

Places = NDArray[np.float64] | None


def of_model(model: Model) -> tuple[Places, Places, Places]:
    """Places of the sensors (sensors, dim), of the loads (loads, dim), and of the nodes of the structure."""
    structure = model.structure
    if structure is None:
        return None, None, None
    outline = structure.coordinates
    nodes = {}
    if outline is not None:
        numbers = sorted({dof.node for dof in structure.dofs})
        nodes = dict(zip(numbers, np.asarray(outline, float), strict=True))
    sensors = _stack([_place(s, nodes) for s in model.sensors])
    return sensors, _of_loads(model, nodes), outline


def _of_loads(model: Model, nodes: dict[int, NDArray]) -> Places:
    basis = model.basis
    if basis is not None and getattr(basis, "kind", "") != "polynomials":
        x = np.asarray(basis.coordinates, float)
        x = x[:, None] if x.ndim == 1 else x
        return (
            np.repeat(x, len(basis.components), axis=0) if len(x) * len(basis.components) == len(model.loads) else None
        )
    return _stack([_place(c, nodes) for c in model.loads])


def _place(channel: Any, nodes: dict[int, NDArray]) -> NDArray[np.float64] | None:
    """Its own place, the middle of its patch, or its node."""
    at, dof = getattr(channel, "at", None), getattr(channel, "dof", None)
    if at is not None:
        return np.atleast_1d(np.asarray(at, float))
    if dof is not None:
        return nodes.get(dof.node)
    spans = [getattr(channel, name, None) for name in "xy"]
    middle = [float(np.mean(s)) for s in spans if s is not None and np.shape(s) == (2,)]
    return np.array(middle) if middle else None


def _stack(found: list[NDArray | None]) -> Places:
    """One table, dimensions that only some have filled with zeros; None where a place is not known."""
    if not found or any(x is None for x in found):
        return None
    dim = max(len(x) for x in found if x is not None)
    return np.array([np.r_[x, np.zeros(dim - len(x))] for x in found if x is not None])
