"""What a structure must satisfy before anybody computes with it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .damping import Modal, Rayleigh
from .dofs import Dof, direction_label
from .errors import InputError
from .values import plain

if TYPE_CHECKING:
    from .structure import Structure

SYMMETRY = 1e-10
DEFINITE = 1e-9  # negative eigenvalue, on a unit diagonal, that rounding may leave
EIGENVALUES = 500  # DOFs up to which definiteness is judged by eigenvalues


def matrix(name: str, value: Any, size: int | None = None) -> sparse.csr_array:
    """Read-only, canonical, exactly symmetric csr array of `value`.

    Raises
    ------
    InputError
        If it is not square, of another size than `size`, not real, not finite, or not symmetric to 1e-10 of its
        largest entry.
    """
    where = f"matrix {name}"
    if not sparse.issparse(value):
        try:
            value = np.asarray(plain(value), None if np.iscomplexobj(value) else float)
        except (TypeError, ValueError):
            raise InputError(
                "not a matrix of numbers",
                where=where,
                found=type(value).__name__,
                expected="(n, n)",
                hint="pass an array or a scipy sparse array",
            ) from None
    if value.ndim != 2 or value.shape[0] != value.shape[1] or value.shape[0] == 0:
        raise InputError(
            "not a square matrix",
            where=where,
            found=f"shape {value.shape}",
            expected="(n, n)",
            hint="supports stay in the matrices; name them with supports=",
        )
    if size is not None and value.shape[0] != size:
        raise InputError(
            "wrong size",
            where=where,
            found=f"shape {value.shape}",
            expected=f"({size}, {size}), as K",
            hint="give all matrices in the same numbering, supported DOFs included",
        )
    if np.iscomplexobj(value.data if sparse.issparse(value) else value):
        raise InputError(
            "complex entries",
            where=where,
            found="complex numbers",
            expected="real numbers",
            hint="give damping as C, Rayleigh or Modal",
        )
    A = sparse.csr_array(value, dtype=float, copy=True)
    A.sum_duplicates()
    if not np.all(np.isfinite(A.data)):
        raise InputError(
            "NaN or infinity",
            where=where,
            found=f"{np.sum(~np.isfinite(A.data))} entries",
            expected="finite numbers",
            hint="check how it was assembled or read",
        )
    skew, largest = abs(A - A.T), np.abs(A.data).max(initial=0.0)
    if skew.nnz and skew.max() > SYMMETRY * largest:
        coo = skew.tocoo()
        i, j = (int(k[np.argmax(coo.data)]) for k in coo.coords)
        raise InputError(
            "not symmetric",
            where=where,
            found=f"entries ({i}, {j}) and ({j}, {i}) differ by {skew.max() / largest:.2g} of the largest entry",
            expected=f"at most {SYMMETRY:g}",
            hint="symmetrise rounding with (K + K.T) / 2; a matrix that is unsymmetric by physics does not fit",
        )
    if skew.nnz and skew.max() > 0:
        A = sparse.csr_array((A + A.T) / 2)
    A.eliminate_zeros()
    A.sort_indices()
    for part in (A.data, A.indices, A.indptr):
        part.flags.writeable = False
    return A


def table(dofs: Sequence[Any], n: int) -> tuple[Dof, ...]:
    """The DOF table, checked: one DOF per row, none twice."""
    parsed = tuple(Dof.parse(d) for d in dofs)
    if len(parsed) != n:
        raise InputError(
            "one DOF per row of K is needed",
            where="DOF table",
            found=f"{len(parsed)} DOFs",
            expected=n,
            hint="dofs lists the DOF of every row, supported ones included",
        )
    seen: set[tuple[int, int]] = set()
    for dof in parsed:
        if dof.key in seen:
            raise InputError(
                "duplicated DOF",
                where="DOF table",
                found=str(dof),
                expected="each DOF once, whatever its sign",
                hint="renumber the nodes, or merge the rows",
            )
        seen.add(dof.key)
    return parsed


def places(coordinates: Any, nodes: int) -> NDArray[np.float64] | None:
    """Read-only coordinates (nodes, dim), checked; one-dimensional ones become a column."""
    if coordinates is None:
        return None
    try:
        x = np.array(plain(coordinates), float)
    except (TypeError, ValueError):
        x = np.empty(0)
    x = x[:, None] if x.ndim == 1 else x
    if x.ndim != 2 or len(x) != nodes or not 1 <= x.shape[1] <= 3:
        raise InputError(
            "coordinates do not fit",
            where="coordinates",
            found=f"shape {x.shape}",
            expected=f"({nodes}, 1 to 3)",
            hint="one row per node, in ascending order of the node numbers",
        )
    if not np.all(np.isfinite(x)):
        raise InputError(
            "NaN or infinity",
            where="coordinates",
            found=f"{np.sum(~np.isfinite(x))} entries",
            expected="finite numbers in m",
            hint="leave coordinates out where they are not known",
        )
    x.flags.writeable = False
    return x


def positive(structure: Structure) -> None:
    """Refuse negative stiffness or mass on a diagonal, a free DOF without mass, and damping that contradicts itself."""
    for name in ("K", "M", "C"):
        A = getattr(structure, name)
        if A is not None and A.diagonal().min() < 0:
            i = int(np.argmin(A.diagonal()))
            what = {"K": "negative stiffness", "M": "negative mass", "C": "negative damping"}[name]
            raise InputError(
                what,
                where=f"matrix {name}, {structure.dofs[i]}",
                found=f"{A.diagonal()[i]:.6g}",
                expected=">= 0",
                hint="check the sign of the matrix, or a compressive prestress beyond buckling",
            )
    if structure.M is not None:
        massless = structure.free[structure.M.diagonal()[structure.free] <= 0]
        if massless.size:
            names = ", ".join(str(structure.dofs[i]) for i in massless[:5])
            raise InputError(
                "a free DOF has no mass",
                where="matrix M",
                found=f"{massless.size} DOFs: {names}" + (", ..." if massless.size > 5 else ""),
                expected="a positive mass on every DOF that is not supported",
                hint="condense it out, support it, or give it its mass",
            )
    elif isinstance(structure.damping, Rayleigh):
        raise InputError(
            "Rayleigh damping needs a mass matrix",
            where="damping",
            found="M = None",
            expected="M, or no damping",
            hint="give M=, or damping=None for static work",
        )
    _definite(structure)
    if isinstance(structure.damping, Modal) and structure.C is not None:
        raise InputError(
            "a damping matrix and modal ratios at once",
            where="damping",
            found="C and Modal",
            expected="one of them",
            hint="leave C out, or damping=None",
        )


def _definite(structure: Structure) -> None:
    """Refuse a user's mass or damping that gives some motion negative energy; a builder's own are definite."""
    if structure.field is not None:
        return
    for name in ("M", "C"):
        A = getattr(structure, name)
        if A is None:
            continue
        diagonal = A.diagonal()
        scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, np.max(diagonal, initial=0.0) or 1.0))
        unit = sparse.diags_array(scale) @ A @ sparse.diags_array(scale)  # kg and kg m^2 made comparable
        lowest = _lowest(unit, diagonal > 0)
        if lowest < -DEFINITE:
            what, why = ("mass", "kinetic energy") if name == "M" else ("damping", "dissipation")
            raise InputError(
                f"the {what} matrix is indefinite: some motion has negative {why}",
                where=f"matrix {name}",
                found=f"smallest eigenvalue {lowest:.3g} of the matrix with unit diagonal",
                expected=">= 0",
                hint="check the signs off the diagonal, and how it was condensed or updated",
            )


def _lowest(unit: sparse.csr_array, weighted: NDArray[np.bool_]) -> float:
    """Smallest eigenvalue of a scaled matrix; of a large one, the lowest bound that pairs of DOFs give."""
    if unit.shape[0] <= EIGENVALUES:
        return float(np.linalg.eigvalsh(unit.toarray())[0])
    coo = unit.tocoo()
    i, j = coo.coords
    pairs = (i != j) & (coo.data != 0)
    # [[1, a], [a, 1]] has 1 - |a|, and [[0, a], [a, 0]] has -|a|
    both = weighted[i] & weighted[j]
    return float(np.min((both - np.abs(coo.data))[pairs], initial=0.0))


def describe(dofs: Sequence[Dof], wanted: Dof) -> str:
    """What a DOF table holds, in words, as far as it helps who asked for `wanted`."""
    here = [str(d) for d in dofs if d.node == wanted.node]
    if here:
        return f"node {wanted.node} has {', '.join(here)}"
    nodes = sorted({d.node for d in dofs})
    axes = ", ".join(direction_label(axis)[1:] for axis in sorted({d.axis for d in dofs}))
    return f"nodes {nodes[0]} to {nodes[-1]} ({len(nodes)} nodes), directions {axes}"
