"""A structure and its loads as one linear system that is driven by noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError
from structures.values import plain


@dataclass(frozen=True, eq=False)
class FilterModel:
    """``x_{k+1} = F x_k + w_k``, ``y_k = H x_k + v_k``, load ``p_k = Cp x_k``; covariances are kept as roots.

    Parameters
    ----------
    F : array, shape (n, n)
    LQ : array, shape (n, q)
        ``E[w w^T] = LQ LQ^T``.
    H : array, shape (m, n)
    LR : array, shape (m, m)
        ``E[v v^T] = LR LR^T``, lower triangular.
    Cp : array, shape (p, n)
        Reads the loads off the state.
    x0 : array, shape (n,)
        Mean before the first sample.
    L0 : array, shape (n, r)
        Root of its covariance.
    nx : int
        States of the structure; the rest belongs to the priors of the loads.
    S : array, shape (n, m), optional
        ``E[w_k v_k^T]``.
    held : bool
        Loads change with a sample, not between two.

    Raises
    ------
    InputError
        Shapes that do not fit, NaN.
    """

    F: NDArray[np.float64]
    LQ: NDArray[np.float64]
    H: NDArray[np.float64]
    LR: NDArray[np.float64]
    Cp: NDArray[np.float64]
    x0: NDArray[np.float64]
    L0: NDArray[np.float64]
    nx: int
    S: NDArray[np.float64] | None = None
    held: bool = True

    def __post_init__(self) -> None:
        n, m = len(self.F), len(self.H)
        shapes = {
            "F": (n, n), "H": (m, n), "LR": (m, m), "x0": (n,), "LQ": (n, self.LQ.shape[-1]),
            "L0": (n, self.L0.shape[-1]), "Cp": (len(self.Cp), n), "S": (n, m),
        }  # fmt: skip
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is None:
                continue
            array = np.array(plain(value), float)  # float32 is raised: filters lose their sign in it
            if array.shape != shape or not np.all(np.isfinite(array)):
                raise InputError("the filter's matrices do not fit", where=f"FilterModel.{name}",
                                 found=f"shape {array.shape}, or NaN in it", expected=f"finite, {shape}")  # fmt: skip
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def n(self) -> int:
        """States."""
        return len(self.F)

    @property
    def m(self) -> int:
        """Sensors."""
        return len(self.H)

    @property
    def p(self) -> int:
        """Loads."""
        return len(self.Cp)
