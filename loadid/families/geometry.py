"""What a load basis knows of its places, as plain arrays that travel with a result."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

DENSE = 2000  # points up to which the matrix that makes tractions of nodal forces is kept with the result


def geometry(basis: Any) -> dict[str, Any]:
    """Geometry of a `structures.bases.Basis`.

    Returns
    -------
    dict
        ``coordinates`` (P, dim), ``cells``, ``components``, ``kind``, ``measures`` (P,), ``extents`` of patches,
        ``resultant`` (R, loads), ``resultant_labels``, and for nodal forces ``traction`` (loads, loads).
    """
    cells = getattr(basis, "cells", None)
    return {
        "coordinates": np.asarray(basis.coordinates, float),
        "cells": None if cells is None or not len(cells) else np.asarray(cells, int),
        "components": list(basis.components),
        "kind": basis.kind,
        "extents": getattr(basis, "extents", None),
        "measures": None if basis.measures is None else np.asarray(basis.measures, float),
        "resultant": np.asarray(basis.resultant(), float),
        "resultant_labels": list(basis.resultant_labels),
        "traction": traction(basis),
    }


def traction(basis: Any) -> NDArray[np.float64] | None:
    """Matrix (loads, loads) from nodal forces to tractions; None where loads are tractions already, or too many."""
    if basis.kind != "nodal" or basis.mass is None or basis.points > DENSE:
        return None
    return np.asarray(basis.to_traction(np.eye(basis.points * len(basis.components))).T)
