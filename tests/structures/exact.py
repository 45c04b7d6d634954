"""Closed forms to test beams and plates against: characteristic equations, solved here without any element."""

from collections.abc import Callable

import numpy as np
import scipy.linalg
from scipy import sparse
from scipy.optimize import brentq
from scipy.sparse.linalg import eigsh, spsolve

from structures import Structure


def frequencies(structure: Structure, modes: int) -> np.ndarray:
    """First natural frequencies (rad/s) that are not rigid, from SciPy alone."""
    K, M = structure.K_free, structure.M_free
    rigid = len(structure.rigid_body_motions())
    shift = -1e-3 * K.diagonal().min() / M.diagonal().max() if rigid else 0.0
    if K.shape[0] <= 250:  # of the inverse, whose largest eigenvalues keep their digits
        values = shift + 1 / scipy.linalg.eigh(M.toarray(), (K - shift * M).toarray(), eigvals_only=True)
    else:
        values = eigsh(K.tocsc(), modes + rigid, M.tocsc(), sigma=shift, which="LM", return_eigenvectors=False)
    return np.sqrt(np.sort(values)[rigid : rigid + modes])


def solve(structure: Structure, column: np.ndarray) -> np.ndarray:
    """Static displacement of all DOFs."""
    return structure.expand(spsolve(structure.K_free.tocsc(), column[structure.free]))


def assembled(structure: Structure) -> Structure:
    """The same structure as a user's own matrices."""
    s = structure
    return Structure.from_matrices(s.K, s.M, s.C, s.dofs, s.supports, s.coordinates, s.damping)


def roots(f: Callable[[float], float], start: float, count: int, step: float, stop: float = np.inf) -> np.ndarray:
    """First sign changes of f above `start`."""
    found, a, fa = [], start, f(start)
    while len(found) < count and a < stop:
        b = a + step
        fb = f(b)
        if fa * fb < 0:
            found.append(brentq(f, a, b, xtol=1e-13, rtol=1e-13))
        a, fa = b, fb
    return np.array(found)


def _decaying(p: float, length: float) -> np.ndarray:
    """Derivatives 0..3 at 0 and at `length` of exp(-p x) and exp(-p (length - x)): (function, derivative, end)."""
    e = np.exp(-p * length)
    powers = p ** np.arange(4)
    signs = (-1.0) ** np.arange(4)
    return np.array([np.stack([powers * signs, powers * signs * e], 1), np.stack([powers * e, powers], 1)])


def _waving(q2: float, length: float) -> np.ndarray:
    """The same for cos(q x) and sin(q x) / q, which stay real where q^2 is negative."""
    q = np.sqrt(complex(q2))
    c, s = np.cos(q * length).real, (np.sin(q * length) / q).real
    cos = np.array([[1, c], [0, -q2 * s], [-q2, -q2 * c], [0, q2 * q2 * s]])
    sin = np.array([[0, s], [1, c], [0, -q2 * s], [-q2, -q2 * c]])
    return np.array([cos, sin])


def _determinant(functions: np.ndarray, conditions: list[tuple[int, np.ndarray]]) -> float:
    """Determinant of the end conditions (end, weights of the derivatives), rows and columns normalised."""
    A = np.array([[f[:, end] @ weights for f in functions] for end, weights in conditions])
    A = A / np.abs(A).max(axis=1, keepdims=True)
    return float(np.linalg.det(A))


BEAM_ENDS = {
    "pinned": ("w", "moment"),
    "clamped": ("w", "slope"),
    "free": ("moment", "shear"),
    "guided": ("slope", "shear"),
}


def beam_roots(left: str, right: str, tension: float = 0.0, count: int = 10) -> np.ndarray:
    """First natural frequencies (rad/s) of a beam with EI = rho A = length = 1 and axial tension."""
    rows = {
        "w": np.array([1.0, 0, 0, 0]),
        "slope": np.array([0, 1.0, 0, 0]),
        "moment": np.array([0, 0, 1.0, 0]),
        "shear": np.array([0, -tension, 0, 1.0]),
    }
    conditions = [(end, rows[c]) for end, kind in ((0, left), (1, right)) for c in BEAM_ENDS[kind]]

    def f(b: float) -> float:  # b = sqrt(omega)
        root = np.sqrt(tension**2 / 4 + b**4)
        functions = np.concatenate([_decaying(np.sqrt(root + tension / 2), 1.0), _waving(root - tension / 2, 1.0)])
        return _determinant(functions, conditions)

    return roots(f, 0.3, count, 0.05) ** 2


def levy_roots(lower: str, upper: str, nu: float, count: int = 10, side: float = 1.0) -> np.ndarray:
    """First lambda = omega sqrt(rho h / D) of a plate 1 x `side`, edges x = 0 and x = 1 simply supported (Levy)."""
    found: list[float] = []
    limit = 250.0 if count > 1 else 30.0
    for m in range(1, 6):  # the smallest lambda of the sixth family is above 300
        k2 = (m * np.pi) ** 2
        rows = {
            "w": np.array([1.0, 0, 0, 0]),
            "slope": np.array([0, 1.0, 0, 0]),
            "moment": np.array([-nu * k2, 0, 1.0, 0]),
            "shear": np.array([0, -(2 - nu) * k2, 0, 1.0]),
        }
        kinds = {"S": ("w", "moment"), "C": ("w", "slope"), "F": ("moment", "shear")}
        conditions = [(end, rows[c]) for end, kind in ((0, lower), (1, upper)) for c in kinds[kind]]

        def f(lam: float, k2: float = k2, conditions: list = conditions) -> float:
            functions = np.concatenate([_decaying(np.sqrt(lam + k2), side), _waving(lam - k2, side)])
            return _determinant(functions, conditions)

        found += list(roots(f, 0.5 * k2 + 0.0123, 2 * count, 0.53, stop=limit))
    return np.sort(np.array(found))[:count]


def navier(load: Callable[[int, int], float], value: Callable[[int, int], float], terms: int) -> float:
    """Sum of the double sine series of a simply supported unit square with D = 1."""
    return sum(
        load(m, n) / (np.pi**4 * (m * m + n * n) ** 2) * value(m, n)
        for m in range(1, terms, 2)
        for n in range(1, terms, 2)
    )


def norm(A: sparse.csr_array) -> float:
    """Frobenius norm."""
    return float(np.linalg.norm(A.data))
