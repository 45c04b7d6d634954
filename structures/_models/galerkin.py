"""A structure projected on a few vectors, and a bound of what the projection costs at every entry of the response."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from .._system.damping import Damping, Modal, Rayleigh, loss_factor
from .._system.factor import Factor
from ..errors import InputError
from .reduction import FLOATS, anchor, needs_mass, unstable

APART = 1e-2  # relative distance of a group of natural frequencies (squared) from the next
EPS = float(np.finfo(float).eps)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pencil:
    """Dynamic stiffness ``D(omega) = a K_s - c M + i omega C`` of a structure, ``K_s = K - shift M`` positive definite.

    Parameters
    ----------
    K_s, M : sparse (n, n)
    C : sparse (n, n) or None
        The damping matrix that is no multiple of K and M.
    alpha, beta, loss : float
        Rayleigh damping (1/s, s) and structural loss factor.
    shift : float
        0 for a supported structure, negative for a free one (rad^2/s^2).
    rigid : int
        Number of rigid-body modes.
    factor : Factor
        Of ``K_s``.
    """

    K_s: Any
    M: Any
    C: Any
    alpha: float
    beta: float
    loss: float
    shift: float
    rigid: int
    factor: Factor

    @classmethod
    def of(cls, structure: Any) -> Pencil:
        """Pencil of a structure.

        Raises
        ------
        InputError
            Without mass, or with modal ratios: they are no matrix that a projection could be measured against.
        """
        needs_mass(structure, "reduction='krylov'")
        damping = structure.damping
        feasible(damping)
        alpha, beta = (damping.alpha, damping.beta) if isinstance(damping, Rayleigh) else (0.0, 0.0)
        loss = loss_factor(damping)
        free = structure.free
        C = None if structure.C is None else structure.C[free][:, free].tocsr()
        rigid, shift, factor = anchor(structure)
        K, M = structure.K_free, structure.M_free
        return cls(K - shift * M if shift else K, M, C, alpha, beta, loss, shift, rigid, factor)

    def coefficients(self, omega: Array) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """The factors ``a`` and ``c`` on each line (rad/s)."""
        a = 1 + 1j * (omega * self.beta + self.loss * (omega > 0))
        return a, omega**2 - 1j * omega * self.alpha - a * self.shift


def feasible(damping: Damping | None) -> None:
    """Refuse modal ratios: the matrix that they stand for is full, and no projection can be measured against it."""
    if isinstance(damping, Modal):
        raise InputError(
            "modal ratios are no damping matrix, and a Krylov reduction needs one",
            where="reduction='krylov'",
            found="damping.Modal",
            expected="damping.Rayleigh, damping.Structural, a matrix C, or no damping",
            hint="Rayleigh.from_ratios over the band; Structural(2 zeta) for frequency responses; "
            "or leave reduction= out: modes take their ratios",
        )


@dataclass(frozen=True)
class Projection:
    """A pencil on ``V``, ``V^T K_s V = 1`` and ``V^T M V = diag(theta)``, with what bounds its error.

    With the residuals of both sides, ``r_j = b_j - D V y_j`` of every load and ``rho_i`` of every sensor, the error of
    an entry is exactly ``rho_i^T D^-1 r_j``. Both residuals are orthogonal to ``V``; their norms in ``K_s^-1`` come
    from small matrices, and ``D^-1`` amplifies them by what resonates outside ``V``. Beside this truncation stands the
    rounding of a stiffness whose largest and smallest energies differ by decades, taken as random.

    Parameters
    ----------
    pencil : Pencil
    V : array (n, r)
    theta : array (r,)
        ``1 / (omega^2 - shift)`` of every Ritz pair, descending.
    C : array (r, r) or None
        Projected damping that is not proportional.
    S, B : array (sensors, r), (r, loads)
        Projected rows and columns.
    rest_M, rest_C : array (q, r), or None
        Factors whose products with coordinates have the norm of the part of ``K_s^-1 M V`` and ``K_s^-1 C V`` that
        ``V`` does not hold.
    rest_S, rest_B : array (sensors,), (loads,)
        The same norm of ``K_s^-1 S^T`` and ``K_s^-1 B``.
    rounding : array (r,)
        Relative rounding of the energy of every Ritz vector.
    cut : float or None
        Where all modes down to this ``theta`` lie in ``V``: what it lacks resonates beyond.

    Notes
    -----
    Dual-weighted residual of a Galerkin projection: A. T. Patera, G. Rozza, *Reduced Basis Approximation and A
    Posteriori Error Estimation* (2007), chapter 3; residual bounds of Ritz pairs: B. N. Parlett, *The Symmetric
    Eigenvalue Problem* (1998), chapter 11.
    """

    pencil: Pencil
    V: Array
    theta: Array
    C: Array | None
    S: Array
    B: Array
    rest_M: Array
    rest_C: Array | None
    rest_S: Array
    rest_B: Array
    rounding: Array
    cut: float | None = None

    @property
    def lam(self) -> Array:
        """Squared circular frequencies of the Ritz pairs (r,), ascending; exactly 0 for rigid-body modes."""
        lam = 1 / self.theta + self.pencil.shift
        lam[: self.pencil.rigid] = 0.0
        return lam

    @property
    def phi(self) -> Array:
        """Ritz vectors (n, r), ``phi^T M phi = 1``."""
        return self.V / np.sqrt(self.theta)

    def errors(self, omega: Array) -> tuple[NDArray[np.complex128], Array, Array]:
        """Displacement response, the bound of its truncation, and its rounding, on lines (rad/s).

        Each of shape (lines, sensors, loads).
        """
        shape = (len(omega), len(self.S), self.B.shape[1])
        H, truncation, rounding = np.empty(shape, complex), np.empty(shape), np.empty(shape)
        r = len(self.theta)
        step = max(1, FLOATS // (r * (shape[1] + shape[2] + (0 if self.C is None else r))))
        for start in range(0, len(omega), step):
            part = slice(start, start + step)
            H[part], truncation[part], rounding[part] = self._errors(omega[part])
        return H, truncation, rounding

    def _errors(self, omega: NDArray[Any]) -> tuple[NDArray[Any], Array, Array]:
        y, w = self._coordinates(omega)
        H = self.S @ y
        size = np.abs(self.pencil.coefficients(omega)[1])[:, None]
        primal = self.rest_B + size * np.linalg.norm(self.rest_M @ y, axis=1)
        dual = self.rest_S + size * np.linalg.norm(self.rest_M @ w, axis=1)
        if self.rest_C is not None:
            primal += omega[:, None] * np.linalg.norm(self.rest_C @ y, axis=1)
            dual += omega[:, None] * np.linalg.norm(self.rest_C @ w, axis=1)
        truncation = self._amplification(omega)[:, None, None] * dual[:, :, None] * primal[:, None, :]
        root = np.sqrt(self.rounding)[:, None]
        rounding = np.linalg.norm(root * w, axis=1)[:, :, None] * np.linalg.norm(root * y, axis=1)[:, None, :]
        return H, truncation, rounding

    def _coordinates(self, omega: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Response of ``V`` to the loads (lines, r, loads) and, transposed, to the sensors (lines, r, sensors)."""
        a, c = self.pencil.coefficients(omega)
        if self.C is None:
            flexible = 1 / (a[:, None] - c[:, None] * self.theta)[:, :, None]
            return self.B * flexible, self.S.T * flexible
        D = 1j * omega[:, None, None] * self.C
        i = np.arange(len(self.theta))
        D[:, i, i] += a[:, None] - c[:, None] * self.theta
        both = np.hstack([self.B, self.S.T])
        x = np.linalg.solve(D, np.broadcast_to(both, (len(D), *both.shape)))
        return x[:, :, : self.B.shape[1]], x[:, :, self.B.shape[1] :]

    def _amplification(self, omega: NDArray[Any]) -> Array:
        """Largest growth of a residual in ``D^-1`` (lines,): the nearest resonance that ``V`` does not hold yet.

        A natural frequency lies within ``distance`` of every Ritz value. A pair that has converged takes no part: both
        residuals are orthogonal to ``V``, and hold of its mode only what the Ritz vector misses. What no vector shows
        is taken to begin at the last Ritz value: a mode hides from a Krylov basis only where no load meets it, and is
        then no part of a residual.
        """
        a, c = (x[:, None] for x in self.pencil.coefficients(omega))
        if self.cut is not None:
            return np.asarray(1 / np.minimum(np.abs(a), np.abs(a - c * self.cut)))[:, 0]
        distance = np.linalg.norm(self.rest_M, axis=0)
        D = a - c * self.theta
        if self.C is not None:
            D = D + 1j * omega[:, None] * np.diagonal(self.C)
        size = np.maximum(np.abs(c), np.finfo(float).tiny)
        along = np.clip((D / size * np.conj(c / size)).real, -distance, distance)
        nearest = np.abs(D - c * along)
        missed = np.minimum(1.0, (distance / self.theta / APART) ** 2)
        missed[-1] = 1.0
        with np.errstate(divide="ignore"):
            grown = np.where(missed > 0, missed / nearest, 0.0)
        return np.asarray(np.maximum(grown.max(axis=1), 1 / np.abs(a[:, 0])))


@dataclass(frozen=True)
class Images:
    """What `project` needs of a basis and of the sensors and loads; solved for once, and extended as the basis grows.

    Parameters
    ----------
    W : array (n, r)
        Basis, M-orthonormal.
    KW, MW, ZM : array (n, r)
        ``K_s W``, ``M W`` and ``K_s^-1 M W``.
    ZC : array (n, r) or None
        ``K_s^-1 C W``.
    S, B : array (n, sensors), (n, loads)
    ZS, ZB : array
        ``K_s^-1`` of both.
    """

    W: Array
    KW: Array
    MW: Array
    ZM: Array
    ZC: Array | None
    S: Array
    B: Array
    ZS: Array
    ZB: Array


def project(pencil: Pencil, images: Images, cut: float | None = None) -> Projection:
    """Galerkin projection of a pencil on the span of a basis; `cut` as in `Projection`.

    Raises
    ------
    InputError
        If the stiffness has a negative eigenvalue (unstable).
    """
    stiff = images.W.T @ images.KW
    try:
        # the inverse problem: the lowest frequencies are its largest values, and keep their digits
        theta, q = linalg.eigh(images.W.T @ images.MW, 0.5 * (stiff + stiff.T))
    except linalg.LinAlgError:
        raise unstable(f"a negative energy among {len(stiff)} Krylov vectors") from None
    theta, q = theta[::-1], q[:, ::-1]
    V, KV = images.W @ q, images.KW @ q

    def rest(Z: NDArray[Any]) -> NDArray[Any]:
        for _ in range(2):
            Z = Z - V @ (KV.T @ Z)
        return Z

    def norms(Z: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(np.sqrt(np.maximum(np.einsum("ij,ij->j", Z, pencil.K_s @ Z), 0.0)))

    size = np.abs(V)
    return Projection(
        pencil=pencil,
        V=V,
        theta=theta,
        C=None if pencil.C is None else V.T @ (pencil.C @ V),
        S=images.S.T @ V,
        B=V.T @ images.B,
        rest_M=_root(pencil, rest(images.ZM @ q)),
        rest_C=None if images.ZC is None else _root(pencil, rest(images.ZC @ q)),
        rest_S=norms(rest(images.ZS)),
        rest_B=norms(rest(images.ZB)),
        rounding=EPS * (np.einsum("ij,ij->j", size, abs(pencil.K_s) @ size) + theta[0] / theta),
        cut=cut,
    )


def _root(pencil: Pencil, Z: NDArray[Any]) -> Array:
    """A small factor (q, r) whose products have the energy norm of those of `Z` (n, r)."""
    gram = Z.T @ (pencil.K_s @ Z)
    energy, u = linalg.eigh(0.5 * (gram + gram.T))
    kept = energy > EPS * max(energy[-1], 0.0)
    return np.asarray(np.sqrt(energy[kept])[:, None] * u[:, kept].T)
