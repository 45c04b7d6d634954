"""Estimates as tables of other libraries: a DataFrame of pandas, a Dataset of xarray."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._objects import needed, to_frame, units_of

if TYPE_CHECKING:
    from .estimate import LoadEstimate


def to_dataframe(e: LoadEstimate) -> Any:
    """See `LoadEstimate.to_dataframe`."""
    about = {"units": units_of(e.labels, e.units)}
    if e.axis is None:
        columns = {"load": np.asarray(e.load), "std": np.asarray(e.std), "unit": np.array(e.units, object)}
        return to_frame(columns, np.array(e.labels, object), "label", about)
    columns = {}
    for i, label in enumerate(e.labels):
        columns[label], columns[f"{label} std"] = e.load[..., i], e.std[..., i]
    return to_frame(columns, np.array(e.axis.values), f"{e.axis.name} [{e.axis.unit}]", about)


def to_xarray(e: LoadEstimate) -> Any:
    """See `LoadEstimate.to_xarray`."""
    xarray = needed("xarray", "a Dataset")
    dims = ("label",) if e.axis is None else (e.axis.name, "label")
    coords: dict[str, Any] = {"label": list(e.labels), "unit": ("label", list(e.units))}
    if e.axis is not None:
        coords[e.axis.name] = (e.axis.name, np.array(e.axis.values), {"units": e.axis.unit})
    parts = {"load": (dims, np.array(e.load)), "std": (dims, np.array(e.std))}
    if e.bias is not None:
        parts["bias"] = (dims, np.array(e.bias))
    attrs = {k: str(v) for k, v in e.provenance.items() if isinstance(v, str)}
    return xarray.Dataset(parts, coords, attrs)
