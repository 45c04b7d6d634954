"""A large structure made small: kept degrees of freedom, modes of a band, and what the step costs at every line."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from .._channels import Dof
from .._system.damping import Damping, Modal, Rayleigh, Structural
from .._system.factor import Factor
from .._system.structure import Structure
from ..errors import InputError, NotIdentifiable, one_of, positive
from .assembly import BAND_FACTOR
from .galerkin import Images, Pencil, Projection, project
from .krylov import ReductionError, orthonormal
from .reduction import needs_mass

METHODS = ("modes", "craig-bampton")
BLOCK = 16  # vectors that the factor solves at once: three times as quick for each as one alone
CONVERGED = 1e-6  # relative residual of a Ritz pair; the error of its frequency is of the order of its square
HELD = 2.0  # times as high: modes with the kept DOFs held, which static responses complete less well
SHIFT = 0.1  # of the band, downwards: the factor is that of a positive definite matrix, free structure or not
LINES = 100
ASSUMED = 0.02  # loss factor under which the error is stated where the damping is no matrix
MOST = 2000  # modes
PROBED = 1e-12
Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class ReducedStructure:
    """A small structure in place of a large one.

    Parameters
    ----------
    structure : Structure
        The kept degrees of freedom under their own labels, then modal coordinates as scalars of new nodes.
    kept : tuple of Dof
    band : float
        Hz, up to which it was made.
    frequencies : array (modes,)
        Natural frequencies (Hz) of the large structure up to 2.5 times the band, rigid-body modes as 0.
    method : str
    projection : Projection
        The large structure on the basis, with what bounds the error.
    """

    structure: Structure
    kept: tuple[Dof, ...]
    band: float
    frequencies: Array
    method: str
    projection: Projection

    def __repr__(self) -> str:
        return (f"ReducedStructure({len(self.kept)} DOFs kept of {self.projection.V.shape[0]}, {self.structure.n} in "
                f"all, to {self.band:g} Hz, error {self.worst:.1e})")  # fmt: skip

    def error(self, frequencies: Any = None) -> ReductionError:
        """Bound of the error of displacements per force between the kept DOFs.

        Parameters
        ----------
        frequencies : array (lines,), optional
            Hz, within the band; else a hundred lines over it. Where the damping is none or modal, it holds for a loss
            factor of 0.02.
        """
        f = self.band * (np.arange(LINES) + 0.5) / LINES if frequencies is None else np.asarray(frequencies, float)
        H, truncation, rounding = self.projection.errors(2 * np.pi * f)
        return ReductionError(f, truncation, rounding, np.abs(H))

    @cached_property
    def worst(self) -> float:
        """Largest bound of a line over the response on it, in the Frobenius norm, of the hundred lines."""
        return float(self.error().normwise.max())


def reduce(
    structure: Structure,
    keep: Iterable[Any],
    band: float,
    *,
    method: str = "modes",
    progress: Callable[[str], None] | None = None,
) -> ReducedStructure:
    """Reduce a structure to some of its degrees of freedom and the modes of a band.

    Parameters
    ----------
    structure : Structure
        With mass.
    keep : iterable of DOFs
        Those of sensors and loads.
    band : float
        Highest frequency of interest (Hz); modes are taken up to 2.5 times it.
    method : {"modes", "craig-bampton"}
        Modes of the structure as it stands with their residual flexibility, or constraint modes and modes with the kept
        degrees of freedom held.
    progress : callable, optional
        Told in words what is done.

    Raises
    ------
    InputError
        Without mass, an unknown or supported DOF, a band that is none or holds more than 2000 modes; kept degrees of
        freedom that do not hold the structure (Craig-Bampton); a structure whose factor would not fit the memory.

    Notes
    -----
    R. R. Craig, M. C. C. Bampton, "Coupling of substructures for dynamic analyses", AIAA Journal 6 (1968) 1313-1319;
    S. Rubin, "Improved component-mode representation for structural dynamic analysis", AIAA Journal 13 (1975) 995-1006.
    The bound of the error is that of `structures._models.galerkin`.
    """
    needs_mass(structure, "reduce")
    band = positive("band", band, where="reduce", unit="Hz")
    one_of("no such method", method, METHODS, where="reduce", hint="modes is the default")
    say = progress or _silent
    rows = _rows(structure, keep)
    _affordable(structure, say)
    pencil = _pencil(structure, band)
    B = np.zeros((structure.free.size, len(rows)))
    B[rows, np.arange(len(rows))] = 1.0
    top = (2 * np.pi * BAND_FACTOR * band) ** 2
    say(f"modes up to {BAND_FACTOR * band:g} Hz")
    lam, phi = lowest(pencil.factor, pencil.M, pencil.shift, top)
    rigid = int(np.sum(np.abs(lam) <= np.maximum(_rounding(pencil, phi), 1e-9 * abs(pencil.shift))))
    pencil = replace(pencil, rigid=rigid)
    say("residual flexibility" if method == "modes" else "constraint modes, and modes with the kept DOFs held")
    ZB = pencil.factor.solve(B)
    if method == "modes":
        W, ZM = _with_residual(pencil, lam, phi, ZB)
    else:
        W = _craig_bampton(structure, rows, HELD**2 * top)
        ZM = pencil.factor.solve(pencil.M @ W)
    C = pencil.C
    ZC = None if C is None else pencil.factor.solve(C @ W)
    say("projection, and its error")
    images = Images(W, pencil.K_s @ W, pencil.M @ W, ZM, ZC, B, B, ZB, ZB)
    cut = 1 / (lam[-1] - pencil.shift) if method == "modes" else None
    projection = project(pencil, images, cut)
    small = _physical(structure, rows, projection)
    frequencies = np.sqrt(np.maximum(lam, 0.0)) / (2 * np.pi)
    frequencies[:rigid] = 0.0
    return ReducedStructure(small, tuple(small.dofs[: len(rows)]), band, frequencies, method, projection)


def _affordable(structure: Structure, say: Callable[[str], None]) -> None:
    """Refuse a factor that the memory of the machine does not hold, before it is begun."""
    found = structure.elimination
    if found is None:
        say(f"factorising {structure.free.size} DOFs")
        return
    say(f"factorising {structure.free.size} DOFs, about {found.memory / 1e9:.1f} GB")
    there = machine_memory()
    if there is not None and found.memory > there:
        raise InputError(
            "the factor of this structure does not fit the memory",
            where="reduce",
            found=f"about {found.memory / 1e9:.1f} GB for {structure.free.size} DOFs",
            expected=f"at most the {there / 1e9:.1f} GB of this machine",
            hint="what is compact fills in most: export a reduced model (Craig-Bampton, or modes) from the solver that "
            "made it, coarsen the mesh, or use a larger machine",
        )


def machine_memory() -> float | None:
    """Bytes of memory of the machine; None where the system does not say."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES")) * float(os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, OSError, ValueError):
        return None


def _silent(_: str) -> None:
    """Say nothing."""


def _rows(structure: Structure, keep: Iterable[Any]) -> Index:
    """Rows of the free DOFs that stay, in the order in which they are named."""
    asked = [Dof.parse(d) for d in ([keep] if isinstance(keep, str | Dof) else keep)]
    whole = np.array(list(dict.fromkeys(structure.index(d) for d in asked)), np.intp)
    held = np.intersect1d(whole, structure.supported)
    if not whole.size or held.size:
        raise InputError(
            "a degree of freedom that is held cannot be kept" if held.size else "no degree of freedom is kept",
            where="reduce, keep", found=str(structure.dofs[held[0]]) if held.size else "none",
            expected="free degrees of freedom, those of sensors and loads",
        )  # fmt: skip
    return np.searchsorted(structure.free, whole)


def _pencil(structure: Structure, band: float) -> Pencil:
    """Stiffness shifted below zero, its factor, and the damping under which the error is measured."""
    damping = structure.damping
    alpha, beta = (damping.alpha, damping.beta) if isinstance(damping, Rayleigh) else (0.0, 0.0)
    loss = damping.eta if isinstance(damping, Structural) else 0.0
    free = structure.free
    C = None if structure.C is None else structure.C[free][:, free].tocsr()
    if C is None and (damping is None or isinstance(damping, Modal)):
        loss = ASSUMED
    shift = -((2 * np.pi * SHIFT * band) ** 2)
    K, M = structure.K_free, structure.M_free
    assert M is not None
    K_s = (K - shift * M).tocsr()
    return Pencil(K_s, M, C, alpha, beta, float(loss), shift, 0, Factor(K_s, structure=structure, check=False))


def lowest(factor: Factor, M: Any, shift: float, top: float) -> tuple[Array, Array]:
    """Modes up to ``lam = top``, and the next: (k,), (n, k), ``phi^T M phi = 1``.

    Parameters
    ----------
    factor : Factor
        Of ``K - shift M``, positive definite.
    M : sparse (n, n)
    shift, top : float
        rad^2/s^2.

    Raises
    ------
    InputError
        If there are more than 2000.

    Notes
    -----
    Block Lanczos of ``(K - shift M)^-1 M`` with whole reorthogonalisation: R. G. Grimes, J. G. Lewis, H. D. Simon, "A
    shifted block Lanczos algorithm for solving sparse symmetric generalized eigenproblems", SIAM J. Matrix Anal. Appl.
    15 (1994) 228-272.
    """
    n = factor.n
    none = np.empty((n, 0))
    start = np.random.default_rng(0).standard_normal((n, min(BLOCK, n)))  # fixed: two runs agree to the last bit
    X = orthonormal(factor.raw(np.ascontiguousarray(M @ start)), M, none, none)
    W, MW, T = none, none, np.empty((0, 0))
    while True:
        old, W, MW = W.shape[1], np.hstack([W, X]), np.hstack([MW, M @ X])
        Z = factor.raw(np.ascontiguousarray(MW[:, old:]))
        column = MW.T @ Z
        Z = Z - W @ column
        again = MW.T @ Z
        Z, column = Z - W @ again, column + again
        size = W.shape[1]
        T = np.block([[T, column[:old]], [column[:old].T, 0.5 * (column[old:] + column[old:].T)]])
        theta, s = linalg.eigh(T)
        theta, s = theta[::-1], s[:, ::-1]
        left = np.linalg.norm(_root(Z.T @ (M @ Z)) @ s[old:], axis=0)
        lam = 1 / np.maximum(theta, np.finfo(float).tiny) + shift
        good = left <= CONVERGED * theta
        count = int(np.argmin(good)) if not good.all() else size
        X = orthonormal(Z, M, W, MW)
        count = count if X.shape[1] and size < n else size  # all there are
        if (count and lam[count - 1] > top) or count == size:
            k = min(int(np.searchsorted(lam[:count], top)) + 1, count)
            return lam[:k], W @ s[:, :k]
        if size > MOST:
            raise InputError(
                "the band holds too many modes", where="reduce, band", found=f"more than {count} modes",
                expected=f"at most {MOST} vectors", hint="a lower band, or a part of the structure",
            )  # fmt: skip


def _root(gram: Array) -> Array:
    """A factor whose products have the norms that a Gram matrix tells."""
    energy, u = linalg.eigh(0.5 * (gram + gram.T))
    return np.asarray(np.sqrt(np.maximum(energy, 0.0))[:, None] * u.T)


def _rounding(pencil: Pencil, phi: Array) -> Array:
    """Rounding of the energy of shapes (k,), with a margin of ten."""
    size = np.abs(phi)
    return np.asarray(10 * np.finfo(float).eps * np.einsum("ij,ij->j", size, abs(pencil.K_s) @ size))


def _with_residual(pencil: Pencil, lam: Array, phi: Array, ZB: Array) -> tuple[Array, Array]:
    """Basis of modes and of what static responses add to them, and ``K_s^-1 M`` times it."""
    M_phi = pencil.M @ phi
    X = orthonormal(ZB, pencil.M, phi, M_phi)
    ZX = pencil.factor.solve(pencil.M @ X) if X.shape[1] else X
    return np.hstack([phi, X]), np.hstack([phi / (lam - pencil.shift), ZX])


def _craig_bampton(structure: Structure, rows: Index, top: float) -> Array:
    """M-orthonormal basis of constraint modes and of modes with the kept DOFs held."""
    K, M = structure.K_free, structure.M_free
    assert M is not None
    inner = np.setdiff1d(np.arange(K.shape[0]), rows)
    held = structure.with_supports(*(structure.dofs[structure.free[r]] for r in rows))
    try:
        factor = Factor(held.K_free, structure=held)
        lam, phi = lowest(factor, held.M_free, 0.0, top)
        constraint = -factor.solve(K[inner][:, rows].toarray())
    except NotIdentifiable as error:
        raise InputError(
            "the kept degrees of freedom do not hold the structure", where="reduce, method='craig-bampton'",
            found=str(error)[:160], expected="no motion that they leave free", hint='method="modes" serves it',
        ) from None  # fmt: skip
    basis = np.zeros((K.shape[0], len(rows) + len(lam)))
    basis[rows, np.arange(len(rows))] = 1.0
    basis[inner, : len(rows)] = constraint
    basis[inner, len(rows) :] = phi
    none = np.empty((K.shape[0], 0))
    return orthonormal(basis, M, none, none)


def _physical(structure: Structure, rows: Index, p: Projection) -> Structure:
    """The projection with the kept degrees of freedom as unknowns, and modal ones with these held beside them."""
    m = len(rows)
    U = p.phi[rows]
    Q, R = linalg.qr(U.T)
    size = np.abs(np.diagonal(R))
    if len(p.theta) < m or np.any(size < PROBED * np.abs(R).max()):
        raise InputError(
            "kept degrees of freedom that move as one", where="reduce, keep",
            found=f"{m} of them, {int(np.sum(size >= PROBED * np.abs(R).max()))} motions",
            expected="degrees of freedom that can move apart", hint="leave out what a rigid link ties to another",
        )  # fmt: skip
    fixed = linalg.solve_triangular(R[:m], Q[:, :m].T).T
    rest = Q[:, m:]
    _, mixed = linalg.eigh((rest.T * p.lam) @ rest)
    T = np.hstack([fixed, rest @ mixed])
    K, M = ((T.T * diagonal) @ T for diagonal in (p.lam, np.ones(len(p.lam))))  # of the Ritz vectors
    C = None if p.C is None else T.T @ ((p.C / np.sqrt(np.outer(p.theta, p.theta))) @ T)
    first = max(dof.node for dof in structure.dofs) + 1
    dofs = [structure.dofs[structure.free[r]] for r in rows] + [Dof(first + k, 0) for k in range(T.shape[1] - m)]
    damping: Damping | None = structure.damping
    even = [None if A is None else sparse.csr_array(0.5 * (A + A.T)) for A in (K, M, C)]
    return Structure(even[0], even[1], even[2], tuple(dofs), damping=damping)
