"""Undamped modes, rigid-body modes exact, and the damping of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.sparse.linalg import LinearOperator, eigsh

from .damping import Modal, Rayleigh
from .errors import InputError, NotIdentifiable
from .factor import Factor

DENSE = 400  # free DOFs up to which the dense eigensolver is quicker and gives every mode
DIAGONAL = 1e-10  # off-diagonal modal damping, over its diagonal, that counts as none


@dataclass(frozen=True)
class Modes:
    """Undamped modes ``K phi = lam M phi``, ``phi^T M phi = 1``.

    Parameters
    ----------
    lam : array (k,)
        Squared circular frequencies, ascending; exactly 0 for rigid-body modes.
    phi : array (n_free, k)
        Shapes on the free DOFs.
    rigid : int
        Number of rigid-body modes.
    shift : float
        ``factor`` is that of ``K - shift M``: 0 for a supported structure, negative for a free one.
    factor : Factor
    """

    lam: NDArray[np.float64]
    phi: NDArray[np.float64]
    rigid: int
    shift: float
    factor: Factor

    @property
    def frequencies(self) -> NDArray[np.float64]:
        """Natural frequencies in Hz (k,)."""
        return np.sqrt(self.lam) / (2 * np.pi)


def modes(structure: Any, count: int | None = None) -> Modes:
    """The lowest `count` modes of a structure (all of them by default).

    Sparse shift-invert Lanczos with the one factor of the stiffness; a dense solve for a small structure or when most
    modes are asked. A free structure is shifted by a tenth of its first elastic ``omega^2``, downwards.

    Parameters
    ----------
    structure : Structure
        With a mass matrix.
    count : int, optional

    Raises
    ------
    InputError
        Without a mass matrix, with a negative mass, or with a stiffness that has a negative eigenvalue (unstable).

    Notes
    -----
    Shift-invert Lanczos: R. B. Lehoucq, D. C. Sorensen, C. Yang, *ARPACK Users' Guide* (1998).
    """
    needs_mass(structure, "modes")
    n = structure.K_free.shape[0]
    if count is not None and not 1 <= int(count) <= n:
        raise InputError(
            "no such number of modes",
            where="modes",
            found=count,
            expected=f"1..{n}",
            hint="a structure has as many modes as free DOFs",
        )
    k = n if count is None else int(count)
    dense = n <= DENSE or 2 * k > n
    rigid, shift, factor = anchor(structure)
    lam, phi = _dense(structure, k, shift, rigid, factor) if dense else _lanczos(structure, k, shift, factor)
    lam, phi = lam[:k].copy(), phi[:, :k]
    lam[: min(rigid, k)] = 0.0
    if np.any(lam < 0):
        raise unstable(f"omega^2 = {lam.min():.4g}")
    return Modes(lam, phi, min(rigid, k), shift, factor)


def needs_mass(structure: Any, where: str) -> None:
    """Refuse a structure without a mass matrix."""
    if structure.M_free is None:
        raise InputError(
            "the structure has no mass matrix",
            where=where,
            found="M = None",
            expected="a structure with M",
            hint="give M, or ask for static() only",
        )


def unstable(found: str) -> InputError:
    """The refusal of a stiffness that is not positive."""
    return InputError(
        "the structure is unstable: its stiffness has a negative eigenvalue",
        where="modes",
        found=found,
        expected="omega^2 >= 0",
        hint="a compressive prestress beyond buckling, or a wrong sign in K",
    )


def anchor(structure: Any) -> tuple[int, float, Factor]:
    """Number of rigid-body modes, the shift, and the factor of ``K - shift M``."""
    try:
        return 0, 0.0, Factor.of(structure)
    except NotIdentifiable:
        K, M = structure.K_free, structure.M_free
        if M is None:
            raise
    n = K.shape[0]
    stiffness, mass = K.diagonal(), M.diagonal()
    if np.any(mass < 0):
        raise InputError(
            "a mass is negative", where="modes", found=f"{mass.min():.4g}", expected=">= 0", hint="check M"
        )
    top = float(np.max(stiffness[mass > 0] / mass[mass > 0], initial=0.0))
    if top == 0.0:  # no stiffness at all
        return n, -1.0, Factor(K + M, structure=structure)
    if n <= DENSE:
        lam = _dense_direct(K.toarray(), M.toarray())[0]
        rigid = int(np.sum(np.abs(lam) <= 10 * n * np.finfo(float).eps * lam[-1]))
    else:
        # A shift far below the top of the spectrum separates the rigid modes; its exact value does not matter yet.
        trial = -1e-8 * top
        lam = _lanczos(structure, 12, trial, Factor(K - trial * M, structure=structure))[0]
        rigid = int(np.sum(np.abs(lam) <= 1e-5 * abs(trial)))
    shift = -0.1 * float(lam[rigid]) if rigid < len(lam) else -1e-4 * top
    return rigid, shift, Factor(K - shift * M, structure=structure)


def _lanczos(structure: Any, k: int, shift: float, factor: Factor) -> tuple[NDArray, NDArray]:
    n = factor.n
    start = np.random.default_rng(0).standard_normal(n)  # fixed, so that two runs agree to the last bit
    inverse = LinearOperator((n, n), matvec=factor.solve, dtype=float)
    lam, phi = eigsh(structure.K_free.tocsc(), k, structure.M_free.tocsc(), sigma=shift, OPinv=inverse, v0=start)
    order = np.argsort(lam)
    return lam[order], phi[:, order]


def _dense(structure: Any, k: int, shift: float, rigid: int, factor: Factor) -> tuple[NDArray, NDArray]:
    """All modes: the eigensolver's error is absolute, so the low ones come from ``K^-1`` and the high ones from `K`."""
    K, M = structure.K_free.toarray(), structure.M_free.toarray()
    lam, phi = _dense_inverse(M, shift, factor)
    high, phi_high = _dense_direct(K, M)
    first = max(high[min(rigid, len(high) - 1)], np.finfo(float).tiny)
    middle = int(np.searchsorted(high, np.sqrt(first * high[-1])))
    low, top = max(rigid + 1, middle // 2), min(len(high) - 1, middle + middle // 2 + 1)
    if k > low and low < top:
        # Cut at the widest gap near the middle: never through a pair of equal frequencies.
        cut = low + int(np.argmax(high[low:top] / high[low - 1 : top - 1]))
        lam, phi = np.concatenate([lam[:cut], high[cut:]]), np.hstack([phi[:, :cut], phi_high[:, cut:]])
    # The solve brings traces of low modes into higher ones: take them out again, the lowest mode first.
    R = linalg.cholesky(phi[:, :k].T @ (M @ phi[:, :k]))
    return lam[:k], linalg.solve_triangular(R, phi[:, :k].T, trans="T").T


def _dense_direct(K: NDArray, M: NDArray) -> tuple[NDArray, NDArray]:
    scale = 1 / np.sqrt(_positive(M))  # displacements and rotations made comparable
    try:
        lam, phi = linalg.eigh(scale[:, None] * K * scale, scale[:, None] * M * scale)
    except linalg.LinAlgError:
        raise _bad_mass(M) from None
    return lam, scale[:, None] * phi


def _dense_inverse(M: NDArray, shift: float, factor: Factor) -> tuple[NDArray, NDArray]:
    """Modes from ``L^T (K - shift M)^-1 L``, ``M = L L^T``: the low ones with full relative accuracy."""
    scale = np.sqrt(_positive(M))
    try:
        L = scale[:, None] * linalg.cholesky(M / scale[:, None] / scale, lower=True)
    except linalg.LinAlgError:
        raise _bad_mass(M) from None
    X = factor.solve(L)
    A = L.T @ X
    theta, y = linalg.eigh(0.5 * (A + A.T))
    theta, y = theta[::-1], y[:, ::-1]
    lam, phi = 1 / theta + shift, X @ y / theta
    order = np.argsort(lam)
    return lam[order], phi[:, order]


def _positive(M: NDArray) -> NDArray[np.float64]:
    mass = M.diagonal()
    if np.any(mass <= 0):
        raise _bad_mass(M)
    return mass


def _bad_mass(M: NDArray) -> InputError:
    low = float(linalg.eigvalsh(0.5 * (M + M.T))[0])
    return InputError(
        "the mass matrix is not positive definite",
        where="modes",
        found=f"smallest eigenvalue {low:.4g}",
        expected="> 0",
        hint="a negative mass, or a DOF without mass: condense it first",
    )


def modal_damping(structure: Any, shapes: Modes) -> NDArray[np.float64]:
    """Modal damping ``c_k`` = 2 zeta omega (k,), or ``Phi^T C Phi`` (k, k) where that is not diagonal; 1/s."""
    damping, omega = structure.damping, np.sqrt(shapes.lam)
    if isinstance(damping, Modal) or (isinstance(damping, Rayleigh) and structure.C is None):
        # Ratios are counted from the first elastic mode: a rigid-body mode has none.
        return np.concatenate([damping.coefficient(part) for part in np.split(omega, [shapes.rigid])])
    if structure.C_free is None:
        return np.zeros(len(omega))
    C = shapes.phi.T @ (structure.C_free @ shapes.phi)
    diagonal = C.diagonal()
    off = np.abs(C - np.diag(diagonal)).max()
    return diagonal.copy() if off <= DIAGONAL * np.abs(diagonal).max(initial=0.0) else 0.5 * (C + C.T)
