"""What K, M and C must satisfy, and the rigid-body motions and mechanisms that the supports leave."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from .._channels import Dof, direction_label
from ..errors import InputError, finite, numbers, plain
from .damping import Modal, Rayleigh

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
    finite(A.data, where=where, hint="check how it was assembled or read")
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
    x = np.array(numbers(coordinates))
    x = x[:, None] if x.ndim == 1 else x
    if x.ndim != 2 or len(x) != nodes or not 1 <= x.shape[1] <= 3:
        raise InputError(
            "coordinates do not fit",
            where="coordinates",
            found=f"shape {x.shape}",
            expected=f"({nodes}, 1 to 3)",
            hint="one row per node, in ascending order of the node numbers",
        )
    hint = "leave coordinates out where they are not known"
    finite(x, where="coordinates", expected="finite numbers in m", hint=hint)
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


Array = NDArray[np.float64]
ZERO = 1e-14  # strain energy over the energy with all other DOFs held: 1e-16 is rounding, a 3000-element beam has 1e-14
DENSE = 600
CANDIDATES = 8
ROUNDING = 1e-13  # force of a geometric motion, over the sum of its parts, that is rounding


@dataclass(frozen=True, eq=False)
class RigidBodyMotion:
    """A motion that costs no strain energy.

    Parameters
    ----------
    name : str
        In words: ``"translation Z"``, ``"rotation RY"``, or the DOFs that move most.
    vector : array, shape (n,)
        The motion of all DOFs, largest entry 1, zero at the supports.
    """

    name: str
    vector: Array

    def __str__(self) -> str:
        return self.name


def motions(structure: Structure) -> tuple[RigidBodyMotion, ...]:
    """All motions that cost no energy: from the geometry where it is known, else from the stiffness matrix."""
    if structure.free.size == 0:
        return ()
    candidates = _geometric(structure) if structure.field is not None else _algebraic(structure)
    return tuple(RigidBodyMotion(name, vector / vector[np.argmax(np.abs(vector))]) for name, vector in candidates)


def _energy_free(structure: Structure, V: Array, rounding: float = 0.0) -> Array:
    """Combinations (columns) of the columns of `V` that cost no energy, judged against the energy of single DOFs.

    Forces below `rounding` of the sum of their parts count as none: a motion that bends a slender member would else be
    judged by the rounding of its axial stiffness.
    """
    D = _scale(structure)[:, None]
    V = V / np.sqrt(np.sum(V**2 * D, axis=0))
    force = structure.K @ V
    force[np.abs(force) < rounding * (abs(structure.K) @ np.abs(V))] = 0.0
    w, X = linalg.eigh(V.T @ force, V.T @ (D * V))
    return np.asarray(X[:, w < ZERO])


def _scale(structure: Structure) -> Array:
    """Energy of each DOF alone; one that nothing holds counts like a middling one."""
    D = np.abs(structure.K.diagonal())
    return np.where(D > 0, D, np.mean(D) or 1.0)


def _geometric(structure: Structure) -> list[tuple[str, Array]]:
    """The rigid motions that the supports leave free and that no prestress resists."""
    assert structure.field is not None
    rigid = structure.field.rigid()
    names, R = list(rigid), np.column_stack(list(rigid.values()))
    held = R[structure.supported]
    sizes = np.linalg.norm(held, axis=1)
    held = held[sizes > 0] / sizes[sizes > 0, None]  # rows of different units count alike
    # the triangle has the null space of all the rows, and costs no (rows, rows) factor
    combos = linalg.null_space(np.linalg.qr(held, mode="r"), rcond=1e-9) if len(held) else np.eye(len(names))
    if combos.shape[1] == 0:
        return []
    V = R @ combos
    V[structure.supported] = 0.0
    free = _plain(combos @ _energy_free(structure, V, ROUNDING))
    out = []
    for mix in free.T:
        mix = np.where(np.abs(mix) < 1e-9 * np.abs(mix).max(), 0.0, mix)
        vector = R @ mix
        vector[structure.supported] = 0.0
        out.append((_words(names, mix), vector))
    return out


def _plain(mixes: Array) -> Array:
    """The same span with every motion that lies in it alone as a column of its own, mixtures after them."""
    U, sizes, _ = np.linalg.svd(mixes, full_matrices=False)
    U = U[:, sizes > 1e-9 * np.max(sizes, initial=0.0)]
    alone = np.flatnonzero(np.sum(U**2, axis=1) > 1 - 1e-9)
    U[alone] = 0.0
    rest, sizes, _ = np.linalg.svd(U, full_matrices=False)
    return np.column_stack([np.eye(len(mixes))[:, alone], rest[:, sizes > 1e-3]])


def _words(names: Sequence[str], mix: Array) -> str:
    """Name of a combination; a rotation about a distant axis also translates, and is called a rotation."""
    parts = [name for name, share in zip(names, mix, strict=True) if share]
    turns = [name for name in parts if name.startswith("rotation")]
    return " and ".join(turns or parts)


def _algebraic(structure: Structure) -> list[tuple[str, Array]]:
    """Null vectors of the supported stiffness matrix, each named by the DOFs that move most."""
    K, free = structure.K_free, structure.free
    scale = 1 / np.sqrt(_scale(structure)[free])
    A = sparse.diags_array(scale) @ K @ sparse.diags_array(scale)
    if free.size <= DENSE:
        _, X = linalg.eigh(A.toarray(), subset_by_index=[0, min(CANDIDATES, free.size) - 1])
    else:
        from scipy.sparse.linalg import eigsh

        # a shift just below zero keeps the factor regular; a fixed start vector keeps the answer the same every time
        start = np.random.default_rng(0).standard_normal(free.size)
        _, X = eigsh(A.tocsc(), k=CANDIDATES, sigma=-1e-9, which="LM", v0=start)
    V = np.zeros((structure.n, X.shape[1]))
    V[free] = scale[:, None] * X
    return _named(structure, V @ _energy_free(structure, V))


def _named(structure: Structure, N: Array) -> list[tuple[str, Array]]:
    """Null vectors sorted into rigid motions, where these are among them, and motions of a few DOFs."""
    if N.shape[1] == 0:
        return []
    root = np.sqrt(_scale(structure))[:, None]
    Q, _ = np.linalg.qr(root * N)
    found: list[tuple[str, Array]] = []
    whole = dict(_candidates(structure))
    for name, vector in whole.items():
        vector = np.where(np.isin(np.arange(structure.n), structure.supported), 0.0, vector)
        if not np.any(vector):
            continue
        unit = root[:, 0] * vector
        unit = unit / np.linalg.norm(unit)
        # new only if it lies in the null space and not in the span of those already found
        taken = np.linalg.qr(np.column_stack([root[:, 0] * v for _, v in found]))[0] if found else Q[:, :0]
        if np.linalg.norm(unit - Q @ (Q.T @ unit)) < 1e-6 < np.linalg.norm(unit - taken @ (taken.T @ unit)):
            found.append((name, vector))
    if found:
        taken, _ = np.linalg.qr(np.column_stack([root[:, 0] * v for _, v in found]))
        U, s, _ = np.linalg.svd(Q - taken @ (taken.T @ Q), full_matrices=False)
        Q = U[:, s > 1e-3]
    return found + [
        (_combined(whole, vector, root) or _most_moving(structure, vector), vector) for vector in (Q / root).T
    ]


def _combined(rigid: dict[str, Array], vector: Array, root: Array) -> str:
    """Name of a null vector that is a mixture of rigid motions, such as a rotation about a pin; "" where it is not."""
    if not rigid:
        return ""
    R, q = root * np.column_stack(list(rigid.values())), root[:, 0] * vector
    sizes = np.linalg.norm(R, axis=0)
    mix = np.linalg.lstsq(R / sizes, q, rcond=None)[0]
    if np.linalg.norm(R / sizes @ mix - q) > 1e-6 * np.linalg.norm(q):
        return ""
    return _words(list(rigid), np.where(np.abs(mix) < 1e-6 * np.abs(mix).max(), 0.0, mix))


def _candidates(structure: Structure) -> Iterator[tuple[str, Array]]:
    """Rigid motions that the DOF table and the coordinates suggest, supports not yet regarded."""
    dofs = structure.dofs
    places = np.zeros((structure.n, 3))
    if structure.coordinates is not None:
        row = {node: i for i, node in enumerate(sorted({dof.node for dof in dofs}))}
        x = structure.coordinates - structure.coordinates.mean(axis=0)
        places[:, : x.shape[1]] = x[[row[dof.node] for dof in dofs]]
    axes, signs = np.array([dof.axis for dof in dofs]), np.array([dof.sign for dof in dofs])
    for k, name in enumerate(
        ("translation X", "translation Y", "translation Z", "rotation RX", "rotation RY", "rotation RZ")
    ):
        moved = np.cross(np.eye(3)[k - 3], places) if k >= 3 else np.tile(np.eye(3)[k], (structure.n, 1))
        vector = np.where(axes == k + 1, 1.0, 0.0)
        for axis in range(1, 4):
            vector = np.where(axes == axis, moved[:, axis - 1], vector)
        vector = signs * vector
        if np.any(vector) and (k < 3 or structure.coordinates is not None):
            yield name, vector


def _most_moving(structure: Structure, vector: Array, count: int = 4) -> str:
    size = np.abs(vector)
    order = [i for i in np.argsort(-size, kind="stable")[:count] if size[i] > 0.1 * size.max()]
    return "motion of " + ", ".join(str(structure.dofs[i]) for i in order)
