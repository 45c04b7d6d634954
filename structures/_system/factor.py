"""One sparse factorisation, many right-hand sides; reciprocity; condensation onto chosen degrees of freedom."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from ..errors import InputError, NotIdentifiable, finite

BLOCK = 256  # right-hand sides per call: wide enough for the cache, small enough for the memory
REFINE_ABOVE = 1e-8  # relative residual above which one step of refinement is taken
REFUSE_ABOVE = 1e-6  # backward error that no refinement cured: the factor is useless
SINGULAR = 5e-16  # |K x| over |K||x| of a null vector: 1e-16 found, against 1e-15 for a cantilever of 4000 elements
DENSE_SHARE = 0.2  # of all DOFs: from here on condensing is quicker than solving for each
MANY = 200  # solves below which nothing is gained by condensing
MECHANISM = "LID-E116"
SCHUR_BLOCK = 128  # right-hand sides per call of the sparse solver
MIRROR = 512  # rows and columns mirrored at once
TRUST = 1e-9  # relative residual of a random combination of all solutions, above which each is checked and refined
Array = NDArray[np.float64]
Index = NDArray[np.intp]


class SparseLU:
    """SuperLU of a sparse matrix that can be copied and pickled: only the matrix travels, and is factorised again.

    The same matrix and options give the same factor, bit for bit.

    Parameters
    ----------
    A : sparse matrix (n, n)
    order : int array (n,), optional
        Order of elimination, in place of one that SuperLU finds.
    options
        As `scipy.sparse.linalg.splu` takes them.

    Raises
    ------
    RuntimeError
        If a pivot is exactly zero.
    """

    def __init__(self, A: Any, order: Index | None = None, **options: Any) -> None:
        self.A, self.order, self.options = A.tocsc(), order, options
        self._lu: Any = self._factorised()

    def _factorised(self) -> Any:
        if self.order is None:
            return splu(self.A, **self.options)
        return splu(self.A[self.order][:, self.order].tocsc(), **{**self.options, "permc_spec": "NATURAL"})

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_lu": None}

    def solve(self, B: NDArray[Any]) -> NDArray[Any]:
        """Solution of ``A X = B``, of the shape of `B`."""
        if self._lu is None:
            self._lu = self._factorised()
        if self.order is None:
            return np.asarray(self._lu.solve(B))
        X = np.empty_like(B, dtype=np.result_type(B, self.A))
        X[self.order] = self._lu.solve(np.ascontiguousarray(B[self.order]))
        return X


class Factor:
    """Unpivoted sparse LU of a symmetric matrix, real or complex (complex symmetric, not Hermitian).

    Parameters
    ----------
    K : sparse or dense matrix (n, n)
        Symmetric, finite.
    structure : Structure, optional
        Names the free rigid-body motion when `K`, its stiffness on the free DOFs, is singular; the places of its nodes
        order the elimination of a large one.
    check : bool
        Check symmetry and singularity (a sweep over many lines checks once and trusts the rest).

    Attributes
    ----------
    n : int
        Size.
    solves : int
        Right-hand sides solved so far: what reciprocity saves can be counted.

    Raises
    ------
    InputError
        If `K` is not square, not symmetric or not finite.
    NotIdentifiable
        If `K` is singular (a mechanism); the message names the motion that no stiffness resists.

    Notes
    -----
    SuperLU in symmetric mode: J. W. Demmel, S. C. Eisenstat, J. R. Gilbert, X. S. Li, J. W. H. Liu, "A supernodal
    approach to sparse partial pivoting", SIAM J. Matrix Anal. Appl. 20 (1999) 720-755.
    """

    def __init__(self, K: Any, *, structure: Any = None, check: bool = True) -> None:
        self.K = sparse.csc_matrix(K)
        self.n, self.solves = self.K.shape[0], 0
        if check:
            _check(self.K)
        try:
            symmetric = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
            found = None if structure is None else structure.elimination
            lu = SparseLU(self.K, None if found is None else found.order, **symmetric)
        except RuntimeError:  # an exactly zero pivot
            lu = None
        if lu is None or (check and not np.iscomplexobj(self.K)):
            motion = null_vector(self.K, lu)
            if motion is None and lu is None and structure is not None:
                motion = next((m.vector[structure.free] for m in structure.rigid_body_motions()), None)
            if motion is not None:
                raise mechanism(motion, structure)
            if lu is None:
                raise InputError(
                    "the matrix is indefinite: it cannot be factorised without pivoting",
                    where="Factor",
                    found="a zero pivot",
                    expected="a positive definite matrix",
                    hint="check the signs in K, and a compressive prestress beyond buckling",
                )
        self._lu: SparseLU = lu

    @classmethod
    def of(cls, structure: Any) -> Factor:
        """Factor of the stiffness of `structure` on its free DOFs.

        Raises
        ------
        NotIdentifiable
            If a motion meets no stiffness: named from the geometry where a builder gave it, else from the matrix.
        """
        if structure.field is not None:
            # Geometry knows the free motions for certain; rounding in a factor may hide them behind tiny pivots.
            for motion in structure.rigid_body_motions():
                raise mechanism(motion.vector[structure.free], structure)
        return cls(structure.K_free, structure=structure)

    def solve(self, B: Any) -> NDArray[Any]:
        """Solution of ``K X = B``, in blocks of columns.

        Parameters
        ----------
        B : array or sparse (n,) or (n, k)

        Returns
        -------
        array of the shape of `B`

        Raises
        ------
        InputError
            If `B` does not fit or is not finite, or the matrix is singular to working precision.
        """
        B = B.tocsc() if sparse.issparse(B) else np.asarray(B)
        columns = B if B.ndim == 2 else B[:, None]
        if columns.shape[0] != self.n:
            raise InputError(
                "the right-hand side does not fit",
                where="Factor.solve",
                found=f"shape {B.shape}",
                expected=f"{self.n} rows",
                hint="rows are the free DOFs",
            )
        X = np.empty(columns.shape, dtype=np.result_type(self.K.dtype, B.dtype, float))
        for start in range(0, columns.shape[1], BLOCK):
            X[:, start : start + BLOCK] = self._block(columns[:, start : start + BLOCK])
        return X.reshape(B.shape)

    def transfer(self, S: Any, B: Any) -> NDArray[Any]:
        """``S K^-1 B`` with the fewer solves: over the columns of `B`, or by reciprocity over the rows of `S`.

        Where both are many and touch the same few DOFs, such as a surface, these are condensed first (`compliance`).

        Parameters
        ----------
        S : array or sparse (sensors, n)
        B : array or sparse (n, loads)

        Returns
        -------
        array (sensors, loads)
        """
        S, B = sparse.csr_matrix(S), sparse.csc_matrix(B)
        condensed = self._condensed(S, B)
        if condensed is not None:
            return condensed
        if S.shape[0] < B.shape[1]:
            # K = K^T also when it is complex, so the plain transpose: no conjugate.
            return self.transfer(B.T, S.T).T
        H = np.empty((S.shape[0], B.shape[1]), dtype=np.result_type(self.K.dtype, float))
        for start in range(0, B.shape[1], BLOCK):
            H[:, start : start + BLOCK] = S @ self.solve(B[:, start : start + BLOCK])
        return H

    def _condensed(self, S: Any, B: Any) -> NDArray[Any] | None:
        """``S K^-1 B`` through the compliance of the DOFs that they touch; None where single solves are quicker."""
        fewer = min(S.shape[0], B.shape[1])
        if fewer < max(DENSE_SHARE * self.n, MANY) or np.iscomplexobj(self.K):
            return None
        touched = np.union1d(S.indices, B.indices)
        if len(touched) > 1.2 * fewer:
            return None
        try:
            A = self.compliance(touched)
        except InputError:  # not positive definite: only an unpivoted factor of the whole serves
            return None
        H = S[:, touched] @ A
        return np.asarray((B[touched].T @ H.T).T)

    def condense(self, dofs: ArrayLike) -> NDArray[Any]:
        """Schur complement of `K` on `dofs`: the stiffness that these DOFs see, all others unloaded.

        Parameters
        ----------
        dofs : int array (s,)
            Distinct indices.

        Returns
        -------
        array (s, s), symmetric

        Raises
        ------
        InputError
            If `dofs` are no distinct indices.

        Notes
        -----
        R. J. Guyan, "Reduction of stiffness and mass matrices", AIAA Journal 3 (1965) 380.
        """
        s = self._chosen(dofs, "condense")
        inner: list[Factor] = []

        def interior(K: Any) -> Factor:
            inner.append(Factor(K))
            return inner[0]

        out = schur(self.K, s, interior)
        self.solves += sum(factor.solves for factor in inner)
        return out

    def compliance(self, dofs: ArrayLike) -> NDArray[Any]:
        """Block of ``K^-1`` on `dofs`: their displacements under forces on them.

        Many DOFs are condensed first and the dense rest is inverted in place (LAPACK potrf and potri); few are solved
        for one by one.

        Parameters
        ----------
        dofs : int array (s,)
            Distinct indices.

        Returns
        -------
        array (s, s), symmetric

        Raises
        ------
        InputError
            If `dofs` are no distinct indices, or the matrix is not positive definite.
        """
        s = self._chosen(dofs, "compliance")
        if np.iscomplexobj(self.K) or len(s) < max(DENSE_SHARE * self.n, 2):
            units = sparse.csc_matrix((np.ones(len(s)), (s, np.arange(len(s)))), shape=(self.n, len(s)))
            return mirrored(self.transfer(units.T, units))
        return compliance(self.condense(s))

    def _chosen(self, dofs: ArrayLike, where: str) -> NDArray[np.intp]:
        """Distinct indices, checked."""
        s = np.atleast_1d(np.asarray(dofs))
        if s.ndim != 1 or s.dtype.kind not in "iu" or s.size == 0:
            raise InputError(
                "no list of DOF indices",
                where=where,
                found=repr(dofs),
                expected="distinct integers",
                hint="[structure.index(dof), ...]",
            )
        if len(np.unique(s)) != len(s) or s.min() < 0 or s.max() >= self.n:
            raise InputError(
                "DOF indices repeat or lie outside",
                where=where,
                found=f"{s[:8].tolist()}" + (", ..." if len(s) > 8 else ""),
                expected=f"distinct, 0..{self.n - 1}",
                hint="indices count the rows of the matrix",
            )
        return s.astype(np.intp)

    def raw(self, B: NDArray[Any]) -> NDArray[Any]:
        """Solution of ``K X = B`` for a dense block, neither checked nor refined; for who checks the whole."""
        self.solves += B.shape[1]
        return self._apply(B)

    def _block(self, B: Any) -> NDArray[Any]:
        B = B.toarray() if sparse.issparse(B) else np.ascontiguousarray(B)
        what, hint = "the right-hand side holds NaN or infinity", "look where the load became so"
        finite(B, what, where="Factor.solve", hint=hint)
        self.solves += B.shape[1]
        B = B.astype(np.result_type(self.K.dtype, B.dtype, float))
        X = self._apply(B)
        residual = B - self.K @ X
        size = np.linalg.norm(B, axis=0)
        if np.any(np.linalg.norm(residual, axis=0) > REFINE_ABOVE * size):
            X = X + self._apply(residual)
            residual = B - self.K @ X
        scale = sparse.linalg.norm(self.K) * np.linalg.norm(X, axis=0) + size
        backward = np.linalg.norm(residual, axis=0) > REFUSE_ABOVE * scale
        if np.any(backward) or not np.all(np.isfinite(X)):
            raise InputError(
                "the factorisation is useless: the matrix is singular to working precision",
                where="Factor.solve",
                found=f"backward error above {REFUSE_ABOVE:g}",
                expected="a regular matrix",
                hint="a shift on a natural frequency without damping, or stiffnesses that differ by more than 1e12",
            )
        return X

    def _apply(self, B: NDArray[Any]) -> NDArray[Any]:
        if np.iscomplexobj(B) and not np.iscomplexobj(self.K):
            return np.asarray(self._lu.solve(B.real) + 1j * self._lu.solve(B.imag))
        return self._lu.solve(B)


def null_vector(K: Any, lu: Any = None) -> NDArray[np.float64] | None:
    """A vector that `K` annihilates to rounding, or None: inverse iteration with the factor that is there.

    Parameters
    ----------
    K : sparse (n, n)
    lu : SparseLU, optional
        Factor of `K`; None when it has an exactly zero pivot.
    """
    size = abs(K)
    diagonal = size.diagonal()
    loose = np.flatnonzero(np.asarray(size.sum(axis=0)).ravel() == 0)
    if loose.size:
        return np.asarray(np.eye(1, K.shape[0], loose[0])[0])
    if lu is None:
        lu = _shifted(K, np.where(diagonal > 0, diagonal, diagonal.max()))
        if lu is None:
            return None
    x = np.random.default_rng(0).standard_normal(K.shape[0]).astype(K.dtype)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, diagonal.max() or 1.0))  # rows of mixed units made comparable
    for _ in range(3):
        # x must stay balanced in energy: m and rad, or stiff and soft parts, otherwise differ by decades
        x = lu.solve(x * scale)
        if not np.all(np.isfinite(x)) or not np.any(x):
            return None
        x = x / np.linalg.norm(x * scale)
        rest = np.linalg.norm((K @ x) / scale) / np.linalg.norm((size @ np.abs(x)) / scale)
        if rest < SINGULAR:
            return np.asarray(x)
        x = x * scale
    return None


def _shifted(K: Any, scale: NDArray[np.float64]) -> Any:
    """Pivoted factor of `K` with the smallest shift of its diagonal that gives it every pivot, or None."""
    for shift in (1e-15, 1e-14, 1e-12):
        try:
            return splu((K + sparse.diags(shift * scale)).tocsc(), permc_spec="COLAMD")
        except RuntimeError:
            continue
    return None


def mechanism(motion: NDArray[np.float64], structure: Any = None) -> NotIdentifiable:
    """The refusal of a singular stiffness; names the free motion.

    Parameters
    ----------
    motion : array (n_free,)
        A vector that the stiffness annihilates.
    structure : Structure, optional
    """
    return NotIdentifiable(
        f"the stiffness matrix is singular: {_describe(motion, structure)} meets no stiffness",
        advice="add supports that stop this motion, or ask for the dynamic response of the free structure",
        code=MECHANISM,
    )


def _describe(motion: NDArray[np.float64], structure: Any) -> str:
    """Words for a null vector: the rigid-body motions that are free, else the DOFs that move most."""
    if structure is None:
        worst = np.argsort(-np.abs(motion))[:4]
        return f"a motion of the DOFs with index {sorted(int(i) for i in worst)}"
    rigid = structure.rigid_body_motions()
    if rigid:
        return "the rigid-body motion left free (" + ", ".join(m.name for m in rigid) + ")"
    worst = np.flatnonzero(np.abs(motion) > 0.3 * np.abs(motion).max())[:6]
    return "the mechanism of " + ", ".join(str(structure.dofs[structure.free[i]]) for i in worst)


def _check(K: Any) -> None:
    if K.shape[0] != K.shape[1] or K.shape[0] == 0:
        raise InputError(
            "the matrix is not square",
            where="Factor",
            found=f"shape {K.shape}",
            expected="(n, n), n > 0",
            hint="a structure needs a free DOF",
        )
    finite(K.data, "the matrix holds NaN or infinity", where="Factor", hint="check how it was assembled")
    skew = abs(K - K.T).max() if K.nnz else 0.0
    if skew > 1e-9 * (abs(K).max() if K.nnz else 1.0):
        raise InputError(
            "the matrix is not symmetric",
            where="Factor",
            found=f"|K - K^T| = {skew:.3g}",
            expected="rounding",
            hint="(K + K.T) / 2 removes rounding",
        )


# -- condensation, dense and in place -------------------------------------------------------------------------------
def schur(K: Any, s: Index, interior: Any) -> NDArray[Any]:
    """Schur complement ``K_ss - K_si K_ii^-1 K_is``, exactly symmetric.

    Parameters
    ----------
    K : sparse (n, n)
    s : int array
        The DOFs that stay.
    interior : callable
        Takes the rows that go and returns a `Factor` of their block.

    Returns
    -------
    array (s, s), Fortran order
    """
    rows = sparse.csr_matrix(K)
    i = np.setdiff1d(np.arange(rows.shape[0]), s)
    out = rows[s][:, s].toarray(order="F")
    if i.size == 0:
        return np.asarray(out)
    Kis = rows[i][:, s].tocsc()
    Ksi, factor = Kis.T.tocsr(), interior(rows[i][:, i])
    _subtract(out, Ksi, Kis, factor)
    return mirrored(out)


def _subtract(out: NDArray[Any], Ksi: Any, Kis: Any, factor: Any) -> None:
    """Take ``K_si K_ii^-1 K_is`` off `out`, in blocks; one random combination of all columns checks the solutions."""
    weights = np.random.default_rng(0).standard_normal(Kis.shape[1])
    combined = np.zeros(Kis.shape[0], dtype=out.dtype)
    for start in range(0, Kis.shape[1], SCHUR_BLOCK):
        stop = min(start + SCHUR_BLOCK, Kis.shape[1])
        X = factor.raw(Kis[:, start:stop].toarray(order="F"))
        combined += X @ weights[start:stop]
        out[:, start:stop] -= Ksi @ X
    wanted = Kis @ weights
    rest = np.linalg.norm(factor.K @ combined - wanted)
    if not rest <= TRUST * np.linalg.norm(wanted):
        # a poor factor: what the first pass took is put back by its own residual, column by column
        for start in range(0, Kis.shape[1], SCHUR_BLOCK):
            stop = min(start + SCHUR_BLOCK, Kis.shape[1])
            B = Kis[:, start:stop].toarray(order="F")
            out[:, start:stop] -= Ksi @ (factor.solve(B) - factor.raw(B))


def mirrored(A: NDArray[Any]) -> NDArray[Any]:
    """`A` with its lower triangle copied to the upper one, in place and in blocks."""
    n = len(A)
    for a in range(0, n, MIRROR):
        b = min(a + MIRROR, n)
        corner = A[a:b, a:b]
        corner[...] = np.tril(corner) + np.tril(corner, -1).T
        for c in range(b, n, MIRROR):
            A[a:b, c : c + MIRROR] = A[c : c + MIRROR, a:b].T
    return A


def compliance(K: Array) -> Array:
    """Inverse of a symmetric positive definite dense matrix, in place of it where it is in Fortran order.

    Raises
    ------
    InputError
        If it is not positive definite to working precision.
    """
    from scipy.linalg import lapack

    check = np.random.default_rng(0).standard_normal(len(K))
    moved = K @ check
    factor, info = lapack.dpotrf(K, lower=1, clean=0, overwrite_a=1)
    if info == 0:
        A, info = lapack.dpotri(factor, lower=1, overwrite_c=1)
    if info != 0:
        raise InputError(
            "the condensed stiffness is not positive definite: it has no compliance",
            where="compliance",
            found=f"pivot {abs(info)} of {len(K)} is not positive",
            expected="a supported structure",
            hint="add supports, or check the signs in K and a compressive prestress",
        )
    A = mirrored(A)
    if not np.linalg.norm(A @ moved - check) <= 1e-3 * np.linalg.norm(check):
        raise InputError(
            "the condensed stiffness is singular to working precision",
            where="compliance",
            found="A K x differs from x in the third digit",
            expected="a supported structure",
            hint="add supports; stiffnesses that differ by more than 1e12 have no compliance",
        )
    return np.asarray(A, float)
