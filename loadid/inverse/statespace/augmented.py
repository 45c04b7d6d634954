"""The state space that a penalty makes of a model: its input is ``L g``, and the load is part of its state.

With ``w = L g`` as input, ``min |H g - y|^2 + lambda^2 |L g|^2`` is a linear-quadratic problem over the record:

    xi_{k+1} = F xi_k + G w_k,    y_k = C xi_k + D w_k,    g_k = E xi_k + w_k.

=================  ===================  =======================  ==============  =============  ===========
penalty            state                F                        G               C              E
=================  ===================  =======================  ==============  =============  ===========
identity           x                    A                        B               C              0
first difference   x, g_{k-1}           [A B; 0 I]               [B; I]          [C D]          [0 I]
second difference  x, g_{k-1}, d_{k-1}  [A B B; 0 I I; 0 0 I]    [B; I; I]       [C D D]        [0 I I]
leaky difference   x, g_{k-1}           [A phi B; 0 phi I]       [B; I]          [C phi D]      [0 phi I]
=================  ===================  =======================  ==============  =============  ===========

A difference of any order adds as many states: the last load, its first difference, and so on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError
from structures.statespace import StateSpace

from ..penalties import order


@dataclass(frozen=True)
class Augmented:
    """A model with its penalty, sensors whitened: states n, inputs p, sensors m.

    Parameters
    ----------
    F, G, C, D, E : array, shapes (n, n), (n, p), (m, n), (m, p), (p, n)
    nx : int
        States of the model itself; the rest is the load's history.
    free : array of int
        States that start free: load states (unless the load starts at zero), and all of x where it is not known.
    """

    F: NDArray[np.float64]
    G: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    E: NDArray[np.float64]
    nx: int
    free: NDArray[np.int_]

    @property
    def n(self) -> int:
        """States."""
        return len(self.F)

    @property
    def p(self) -> int:
        """Loads."""
        return self.G.shape[1]

    @property
    def m(self) -> int:
        """Sensors."""
        return len(self.C)


def augment(
    A: NDArray, B: NDArray, C: NDArray, D: NDArray, penalty: str = "identity", *, leak: float | None = None,
    from_zero: bool = False, unknown_start: bool | int = False,
) -> Augmented:  # fmt: skip
    """State space of a penalty over a model; C and D whitened.

    Parameters
    ----------
    A, B, C, D : array
        Discrete model.
    penalty : str
        Named penalty, a difference of any order.
    leak : float, optional
        The first difference becomes ``g_k - leak g_{k-1}``, 0 < leak < 1.
    from_zero : bool
        The load is zero before the record, and its first difference counts; else its start is free.
    unknown_start : bool or int
        The state of the model at the first sample is an unknown of the data; a number: its first so many states.
    """
    degree, nx, p = order(penalty), len(A), B.shape[1]
    if leak is not None and (degree != 1 or not 0 < leak < 1):
        raise InputError("a leak belongs to the first difference", where="penalty", found=f"{penalty!r}, leak {leak!r}",
                         expected="penalty='first_difference' and a leak between 0 and 1")  # fmt: skip
    phi, one = 1.0 if leak is None else float(leak), np.eye(p)
    E = np.hstack([np.zeros((p, nx)), *([phi * one] * degree)])
    history = np.kron(np.triu(np.ones((degree, degree))), phi * one)
    F = np.block([[np.hstack([A, np.zeros((nx, degree * p))]) + B @ E], [np.zeros((degree * p, nx)), history]])
    G = np.vstack([B, *([one] * degree)])
    Caug = np.hstack([C, np.zeros((len(C), degree * p))]) + D @ E
    # a leaky load has a proper prior: it comes from zero, whatever was asked
    loose = np.arange(nx, nx + degree * p) if not from_zero and leak is None else np.arange(0)
    free = np.concatenate([np.arange(nx if unknown_start is True else int(unknown_start)), loose]).astype(int)
    return Augmented(F, G, Caug, np.array(D, float), E, nx, free)


def of_model(system: StateSpace, rows: NDArray, W: NDArray, penalty: str, **options: object) -> Augmented:
    """As `augment`, from some sensors of a model whitened by the matrix `W` (kept, rows)."""
    return augment(system.A, system.B, W @ system.C[rows], W @ system.D[rows], penalty, **options)  # type: ignore[arg-type]
