"""Rigid-body motions and mechanisms: which motions cost a supported structure no energy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

if TYPE_CHECKING:
    from .structure import Structure

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
    return X[:, w < ZERO]


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
