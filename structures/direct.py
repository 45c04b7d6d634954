"""Frequency response by one factorisation of the dynamic stiffness per line: exact, slow, the check of every other."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .damping import Modal, loss_factor
from .errors import InputError, NotIdentifiable
from .factor import Factor
from .modes import Modes, modal_damping, modes, needs_mass
from .reduction import on_resonance, unbounded

DENSE_DIRECT = 2000  # largest structure whose modal damping is written out as a matrix


def direct(
    structure: Any, S: Any, B: Any, frequencies: NDArray[np.float64], shapes: Callable[[], Modes]
) -> NDArray[np.complex128]:
    """Displacement response ``S (K - omega^2 M + i omega C)^-1 B``, shape (lines, sensors, loads).

    Parameters
    ----------
    structure : Structure
    S, B : sparse (sensors, n_free), (n_free, loads)
    frequencies : array (lines,)
        Hz.
    shapes : callable
        Gives modes where they are needed: for modal ratios, and to name a line on which the response is unbounded.

    Raises
    ------
    NotIdentifiable
        If a line lies on a natural frequency without damping, or at 0 Hz where the structure is free (LID-E116).
    InputError
        Without mass, or for modal ratios on more than 2000 DOFs.
    """
    needs_mass(structure, "frf")
    K, M, C = structure.K_free, structure.M_free, damping_matrix(structure, shapes)
    loss = loss_factor(structure.damping)
    H = np.empty((len(frequencies), S.shape[0], B.shape[1]), dtype=complex)
    for i, omega in enumerate(2 * np.pi * frequencies):
        if C.nnz == 0 and loss == 0 and on_resonance(omega, shapes().lam):
            raise unbounded(frequencies[i], shapes().lam)
        D = K * (1 + 1j * loss * (omega > 0)) - omega**2 * M + 1j * omega * C
        try:
            H[i] = Factor(D, check=False).transfer(S, B)
        except (InputError, NotIdentifiable) as error:
            raise unbounded(frequencies[i], shapes().lam) from error
    return H


def damping_matrix(structure: Any, shapes: Callable[[], Modes]) -> Any:
    """Damping on the free DOFs; that of modal ratios, ``M Phi diag(c) Phi^T M``, is full: small structures only.

    Raises
    ------
    InputError
        For modal ratios on more than 2000 DOFs.
    """
    if not isinstance(structure.damping, Modal):
        return sparse.csr_array(structure.K_free.shape) if structure.C_free is None else structure.C_free
    if structure.free.size > DENSE_DIRECT:
        raise InputError(
            "modal damping has no sparse matrix: no direct sweep of a large structure",
            where="frf(method='direct')",
            found=f"{structure.free.size} free DOFs",
            expected=f"at most {DENSE_DIRECT}",
            hint="method='modal', or Rayleigh damping",
        )
    found = shapes()
    every = found if len(found.lam) == structure.free.size else modes(structure)
    MPhi = structure.M_free @ every.phi
    return sparse.csr_array((MPhi * modal_damping(structure, every)) @ MPhi.T)
