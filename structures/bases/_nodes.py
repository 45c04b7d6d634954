"""Nodal forces as a basis: one force per node and component, with the mesh that turns them into tractions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .._system.fields import Lumped
from ..errors import InputError, plain, shown
from ._basis import Basis
from ._builders import Components, _sides, interleaved, labelled, parsed
from ._domains import Domain, FaceDomain, domain_of, selector
from ._grids import SNAP
from ._regions import Region, region_of, split

if TYPE_CHECKING:
    from .._system.structure import Structure


Array = NDArray[np.float64]
Index = NDArray[np.intp]
AXES = ("X", "Y", "Z")


def nodal(structure: Structure, region: Any = None, *, nodes: Any = None, components: Components = "+Z") -> Basis:
    """Forces on nodes, one per node and component.

    Parameters
    ----------
    structure : Structure
        Any; tractions, areas and neighbours are known on beams, rectangular plates and faces of solids.
    region : optional
        Whose nodes: as in `hats`. Without it, and without `nodes`, all nodes of a beam or plate that are free to move
        along the components; likewise a face of a solid that is named without a rectangle.
    nodes : sequence of int, optional
        Only these node numbers.
    components : str or sequence of str
        ``"+X"``, ``"+Y"``, ``"+Z"``, with either sign; on a face also N (outward), T1 and T2.

    Returns
    -------
    Basis
        Coefficients in N. `mass`, `measures` and `to_traction` belong to tractions that vary linearly between the
        nodes, over the cells all of whose nodes carry a force (or were left out as supported); a node without such a
        cell keeps all cells around it.

    Raises
    ------
    InputError
        If region, nodes or components do not fit. Nodes named on supported DOFs are refused (LID-E104) by
        `Basis.columns`, when a model is built.
    """
    where = "bases.nodal"
    surface, window = split(structure, region)
    part = region_of(structure, region, where) if region is not None or _meshed(structure, surface) else None
    domain = None if part is None else part.domain
    if part is not None and window is not None and isinstance(domain, FaceDomain):
        part.flat(where)
    allowed: tuple[str, ...] = AXES if domain is None or not isinstance(domain, FaceDomain) else domain.directions
    allowed = tuple(d for d in allowed if d not in AXES or _has(structure, d))
    chosen = parsed(components, allowed, domain, where)
    places = _places(structure, domain)
    kept = _kept(structure, part, places, nodes, chosen, window is None, where)
    numbers = places.numbers[kept]
    count = len(chosen)
    normals = None if domain is None or domain.normals is None else domain.normals[kept]
    directions = (
        Region(domain, domain.bounds, True).directions_at(chosen, len(kept), normals)
        if domain is not None
        else np.stack([s * np.tile(np.eye(3)[AXES.index(n)], (len(kept), 1)) for s, n in chosen], axis=1)
    )
    columns = []
    for k in range(count):
        vectors = directions[:, k]
        used = [a for a in range(3) if np.any(vectors[:, a])]
        parts = [selector(structure, numbers, a + 1).T @ sparse.diags_array(vectors[:, a]) for a in used]
        columns.append(sparse.csc_array(sum(parts[1:], parts[0])))
    B = interleaved(columns)
    B.eliminate_zeros()
    force = directions.reshape(-1, 3).T.copy()
    arms = places.padded()[kept] if places.coordinates is not None else None
    moment = None if arms is None else np.cross(np.repeat(arms, count, axis=0), force.T).T
    mesh = _Mesh.of(domain, kept, _dropped(domain, kept, places, structure, nodes))
    unit = "N" if domain is None else domain.unit
    return Basis(
        kind="nodal",
        components=tuple(labelled(*c) for c in chosen),
        coordinates=places.of(kept),
        unit="N",
        traction_unit=unit,
        quantity="force",
        labels=tuple(f"{node}{labelled(*c)}" for node in numbers.tolist() for c in chosen),
        directions=directions,
        normals=None if normals is None else normals.copy(),
        cells=mesh.cells,
        edges=mesh.edges,
        measures=mesh.measures,
        mass=mesh.mass,
        shape=None,
        extents=None,
        own_structure=structure,
        matrix=B,
        reach=_reach(structure, domain, numbers, kept, B, count),
        force=force,
        moment=moment,
        values=mesh.values,
    )


# -- which nodes ------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class _NodePlaces:
    numbers: Index
    coordinates: Array | None

    def of(self, kept: Index) -> Array:
        return np.zeros((len(kept), 0)) if self.coordinates is None else self.coordinates[kept].copy()

    def padded(self) -> Array:
        assert self.coordinates is not None
        out = np.zeros((len(self.numbers), 3))
        out[:, : self.coordinates.shape[1]] = self.coordinates
        return out


def _meshed(structure: Structure, surface: Any) -> bool:
    return hasattr(structure, "field") and domain_of(structure, surface) is not None


def _places(structure: Structure, domain: Domain | None) -> _NodePlaces:
    if domain is not None:
        return _NodePlaces(domain.nodes, domain.coordinates)
    return _NodePlaces(np.array(sorted({dof.node for dof in structure.dofs}), np.intp), structure.coordinates)


def _has(structure: Structure, name: str) -> bool:
    axis = AXES.index(name) + 1
    return any(dof.axis == axis for dof in structure.dofs)


def _kept(
    structure: Structure,
    part: Region | None,
    places: _NodePlaces,
    nodes: Any,
    chosen: Sequence[tuple[float, str]],
    whole: bool,
    where: str,
) -> Index:
    """Positions, among the places, of the nodes that carry a force."""
    kept = np.arange(len(places.numbers))
    if part is not None and not whole:
        along, slack = part.domain.project(part.domain.coordinates), SNAP * np.ptp(part.window, axis=1)
        on = (along >= part.window[:, 0] - slack) & (along <= part.window[:, 1] + slack)
        kept = np.flatnonzero(np.all(on, axis=1))
    if nodes is not None:
        return _named(nodes, places.numbers, kept, where)
    if whole:
        held = _held(structure, chosen)
        kept = np.array([k for k in kept if int(places.numbers[k]) not in held], np.intp)
    if len(kept) == 0:
        raise InputError(
            "no node is left",
            where=where,
            found="no free node in the region",
            expected="at least one",
            hint="a region between nodes has none; nodes on supports carry no load",
        )
    return kept


def _named(nodes: Any, numbers: Index, kept: Index, where: str) -> Index:
    try:
        wanted = np.atleast_1d(np.asarray(plain(nodes)))
    except ValueError:
        wanted = np.empty(0)
    known = {int(numbers[k]): int(k) for k in kept}
    integers = wanted.ndim == 1 and wanted.dtype.kind in "iu" and wanted.size > 0
    unknown = [n for n in wanted.tolist() if n not in known] if integers else []
    if not integers or unknown or len(set(wanted.tolist())) != wanted.size:
        raise InputError(
            "no list of nodes",
            where=f"{where}, nodes",
            found=f"{unknown[:8]}, not in the region" if unknown else shown(nodes),
            expected=f"different node numbers, from {min(known, default=0)} to {max(known, default=0)}",
            hint="structure.dofs lists the nodes; field.surface(name).nodes those of a face",
        )
    return np.array([known[n] for n in wanted.tolist()], np.intp)


def _held(structure: Structure, chosen: Sequence[tuple[float, str]]) -> set[int]:
    """Nodes that are supported along one of the components; any support counts for N, T1, T2."""
    axes = {AXES.index(name) + 1 for _, name in chosen if name in AXES}
    if len(axes) < len(chosen):
        axes = {1, 2, 3}
    return {dof.node for dof in structure.supports if dof.axis in axes}


def _dropped(domain: Domain | None, kept: Index, places: _NodePlaces, structure: Structure, nodes: Any) -> Index:
    """Supported nodes beside the kept ones: cells that reach them still count as loaded."""
    if domain is None:
        return np.empty(0, np.intp)
    held = {dof.node for dof in structure.supports if dof.axis <= 3}
    return np.array(
        [k for k, node in enumerate(places.numbers.tolist()) if node in held and k not in set(kept)], np.intp
    )


def _reach(
    structure: Structure, domain: Domain | None, numbers: Index, kept: Index, B: sparse.csc_array, count: int
) -> sparse.csr_array:
    """DOFs that share an element with each node, sparse (n, P)."""
    P = len(numbers)
    if domain is None:
        if isinstance(structure.field, Lumped):
            return sparse.csr_array((structure.n, P))
        coo = B.tocoo()
        own = sparse.coo_array((np.ones(coo.nnz), (coo.coords[0], coo.coords[1] // count)), shape=(structure.n, P))
        return sparse.csr_array(abs(structure.K) @ own.tocsr())
    corners = domain.cells.shape[1]
    row = np.repeat(np.arange(len(domain.cells)), corners)
    member = sparse.coo_array(
        (np.ones(row.size), (row, domain.cells.ravel())), shape=(len(domain.cells), len(domain.nodes))
    ).tocsr()
    beside = (member.T @ member[:, kept]).tocoo()
    position = {int(node): k for k, node in enumerate(domain.nodes)}
    of_dof = np.array([position.get(dof.node, -1) for dof in structure.dofs])
    rows = np.flatnonzero(of_dof >= 0)
    spread = sparse.coo_array((np.ones(rows.size), (rows, of_dof[rows])), shape=(structure.n, len(domain.nodes)))
    return sparse.csr_array(spread.tocsr() @ beside.tocsr())


def _hats_at(at: Array, domain: Domain, cells: Index, kept: Index) -> sparse.csr_array:
    """Functions of some of the nodes at places, zero beside the cells."""
    return domain.node_hats_at(at, cells)[:, kept]


# -- the mesh over the nodes ------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class _Mesh:
    cells: Index | None
    edges: Index
    measures: Array | None
    mass: sparse.csr_array | None
    values: Any

    @classmethod
    def of(cls, domain: Domain | None, kept: Index, dropped: Index) -> _Mesh:
        """Geometry of tractions between the kept nodes."""
        if domain is None:
            return cls(None, np.empty((0, 2), np.intp), None, None, None)
        carries, counted = np.zeros(len(domain.nodes), bool), np.zeros(len(domain.nodes), bool)
        carries[kept] = counted[kept] = True
        counted[dropped] = True
        used = np.all(counted[domain.cells], axis=1) & np.any(carries[domain.cells], axis=1)
        lonely = carries.copy()
        lonely[domain.cells[used]] = False
        used |= np.any(lonely[domain.cells], axis=1)
        rule = domain.cell_rule(np.flatnonzero(used), 1)
        hats = domain.node_hats(rule)[:, kept].tocsr()
        local = np.full(len(domain.nodes), -1)
        local[kept] = np.arange(len(kept))
        sides = local[_sides(domain.cells)] if domain.cells.shape[1] > 2 else local[domain.cells]
        cells = local[domain.cells[np.all(carries[domain.cells], axis=1)]]
        every = np.flatnonzero(used)
        return cls(
            cells if len(cells) else None,
            sides[np.all(sides >= 0, axis=1)],
            np.asarray(hats.T @ rule.weights, float),
            (hats.T @ sparse.diags_array(rule.weights) @ hats).tocsr(),
            partial(_hats_at, domain=domain, cells=every, kept=kept) if domain.boxed else None,
        )
