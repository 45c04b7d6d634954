"""FeModel: what was read from the files of a solver, in SI; and the structure or the modes that it makes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ..._channels import Dof
from ..._models.modal import ModalModel
from ..._models.reduction import ReducedModel
from ..._readonly import ReadOnly
from ..._system.damping import Damping, Modal, settled
from ..._system.structure import Structure
from ...errors import InputError
from ._parts import Shapes, keyed

if TYPE_CHECKING:
    from ._summary import FeSummary

Array = NDArray[np.float64]
ROUNDED = 1e-6  # asymmetry, over the largest entry, that a text of six digits leaves
BEYOND = 100.0  # times the highest frequency of the mesh, at which a massless degree of freedom is given its own
WHERE = "FeModel"


@dataclass(frozen=True, eq=False)
class FeModel(ReadOnly):
    """A finite-element model of another program, in SI: matrices, places of nodes, modes; whatever the files hold.

    Parameters
    ----------
    K, M, C : sparse (n, n) or None
        Stiffness, mass, damping; N/m, kg, N s/m and their like for rotations.
    labels : int array (n, 2)
        Node number of the file and direction (0 scalar, 1 to 3 translations, 4 to 6 rotations) of every row.
    nodes, places : array (nodes,), (nodes, 3)
        Numbers, ascending, and where they are (m).
    held : int array (held, 2)
        Degrees of freedom that the files hold.
    modes : Shapes or None
        Natural frequencies (Hz), shapes (m, rad), modal masses, damping ratios.
    source : str
        Names of the files.
    notes : tuple of str
        What was passed over or done while reading.
    """

    K: sparse.csr_array | None
    M: sparse.csr_array | None
    C: sparse.csr_array | None
    labels: NDArray[np.int64]
    nodes: NDArray[np.int64]
    places: Array
    held: NDArray[np.int64]
    modes: Shapes | None
    source: str
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        held = [f"{len(self.labels)} DOFs"] if self.K is not None else []
        held += [name for name in self.matrices if name != "K"]
        held += [f"{len(self.nodes)} nodes"] if len(self.nodes) else []
        held += [f"{len(self.modes.frequencies)} modes"] if self.modes is not None else []
        return f"FeModel({self.source}: {', '.join(held)})"

    @property
    def matrices(self) -> dict[str, sparse.csr_array]:
        """Those of K, M and C that there are."""
        return {name: A for name, A in (("K", self.K), ("M", self.M), ("C", self.C)) if A is not None}

    @cached_property
    def dofs(self) -> tuple[Dof, ...]:
        """Degree of freedom of every row."""
        return tuple(Dof(int(node), int(code)) for node, code in self.labels)

    @cached_property
    def coordinates(self) -> Array | None:
        """Places (m) of the nodes that have rows, ascending; None where one of them is not known."""
        wanted = np.unique(self.labels[:, 0])
        at = np.searchsorted(self.nodes, wanted)
        if not len(self.nodes) or np.any(at >= len(self.nodes)) or np.any(self.nodes[at] != wanted):
            return None
        return self.places[at]

    def summary(self, frequencies: int | Sequence[float] = 10) -> FeSummary:
        """Mass, centre of mass, first natural frequencies, rigid-body modes, and what does not fit.

        Parameters
        ----------
        frequencies : int, or sequence of float
            How many are computed; or those (Hz) that are known already, rigid-body modes as 0.
        """
        from ._summary import summary

        return summary(self, frequencies)

    # -- the structure ------------------------------------------------------------------------------------------------
    def structure(self, supports: Iterable[Any] = (), damping: Damping | float | None = None) -> Structure:
        """All degrees of freedom as a structure.

        Rows without stiffness and mass are held. A degree of freedom with stiffness and without mass (a rotation of a
        lumped mass) is given the inertia that puts its own frequency at a hundred times the highest of the mesh.

        Parameters
        ----------
        supports : iterable of DOFs
            Held beside those of the files.
        damping : Rayleigh, Modal, Structural or float, optional

        Raises
        ------
        InputError
            Without K; what `Structure` refuses: an asymmetric K, a negative mass, an unknown support.
        """
        if self.K is None:
            raise InputError(
                "the files hold no stiffness matrix", where=self.source, found=repr(self),
                expected="K, and M for dynamics", hint="modal() takes modes; for a mesh give material=",
            )  # fmt: skip
        K, M, C = (None if A is None else _even(A) for A in (self.K, self.M, self.C))
        assert K is not None
        empty = _empty(K, M)
        M = None if M is None else _massive(K, M, empty)
        held = {*map(Dof.parse, [supports] if isinstance(supports, str) else supports)}
        rows = [self.dofs[i] for i in np.flatnonzero(empty)]
        own = [Dof(int(node), int(code)) for node, code in self.held]
        return Structure(K, M, C, self.dofs, self.coordinates, tuple(sorted({*held, *rows, *own})), settled(damping))

    # -- modes --------------------------------------------------------------------------------------------------------
    def modal(self, sensors: Sequence[Any], loads: Sequence[Any], damping: Damping | float | None = None) -> ModalModel:
        """The modes of the files as a forward model.

        Nothing stands for the modes that the files leave out: keep modes to twice the band of interest at least.

        Parameters
        ----------
        sensors, loads : sequence
            At degrees of freedom that the shapes have.
        damping : Modal or float, optional
            Ratios, where the files state none.

        Raises
        ------
        InputError
            Without modes, without modal masses, or without damping ratios; a place that the shapes do not have.
        """
        shapes = self._normal()
        given = settled(damping)
        omega = 2 * np.pi * shapes.frequencies
        if given is not None and not isinstance(given, Modal):
            raise InputError("modes take modal damping ratios", where=WHERE, found=str(given), expected="a ratio")
        if given is None and shapes.damping is None:
            raise InputError(
                "the files state no damping ratios", where=self.source, found="none", expected="damping=, a ratio",
                hint="0.01 is common for welded metal; measure it where it matters",
            )  # fmt: skip
        c = given.coefficient(omega) if isinstance(given, Modal) else 2 * np.asarray(shapes.damping) * omega
        heard, driven, S, B = self._placed(shapes, sensors, loads)
        reduced = ReducedModel(
            lam=omega**2, damping=np.asarray(c, float), S=S, B=B, residual=None,
            derivative=np.array([int(getattr(s, "derivative", 0)) for s in heard]),
            corner=np.array([s.highpass or 0.0 for s in heard]),
        )  # fmt: skip
        return ModalModel(reduced, heard, driven, modes=len(omega), band=(0.0, float(shapes.frequencies[-1])))

    def _normal(self) -> Shapes:
        """Shapes of unit modal mass."""
        if self.modes is None:
            raise InputError("the files hold no modes", where=self.source, found=repr(self), expected="modes",
                             hint="structure() computes them of K and M")  # fmt: skip
        if self.modes.mass is None:
            raise InputError(
                "the modal masses are not known", where=self.source, found="shapes of unknown size",
                expected="modal masses in the file, or modal_mass=",
                hint="modal_mass=1 where the solver normalised the shapes to unit mass (in its own units)",
            )  # fmt: skip
        return replace(self.modes, shapes=self.modes.shapes / np.sqrt(self.modes.mass), mass=None)

    def _placed(self, shapes: Shapes, sensors: Any, loads: Any) -> tuple[Any, Any, Array, Array]:
        """Sensors and loads, and their rows and columns in modes, by a structure that has the DOFs of the shapes."""
        from ..._models import assembly

        n = len(shapes.labels)
        table = tuple(Dof(int(node), int(code)) for node, code in shapes.labels)
        bare = Structure(sparse.eye_array(n, format="csr"), sparse.eye_array(n, format="csr"), dofs=table)
        heard, driven = assembly.placed(sensors, "row", "sensors"), assembly.placed(loads, "column", "loads", "columns")
        S = assembly.rows(bare, heard) @ shapes.shapes
        B = np.asarray(assembly.columns(bare, driven).T @ shapes.shapes).T
        return heard, driven, np.asarray(S), B


def _even(A: sparse.csr_array) -> sparse.csr_array:
    """The matrix without the asymmetry that digits of a text leave; a larger one stays, and is refused later."""
    skew, largest = abs(A - A.T), float(np.abs(A.data).max(initial=0.0))
    return ((A + A.T) / 2).tocsr() if skew.nnz and 0 < skew.max() <= ROUNDED * largest else A


def _empty(K: sparse.csr_array, M: sparse.csr_array | None) -> NDArray[np.bool_]:
    """Rows without stiffness and mass."""
    size = np.asarray(abs(K).sum(axis=1)).ravel()
    if M is not None:
        size = size + np.asarray(abs(M).sum(axis=1)).ravel()
    return size == 0


def massless(K: sparse.csr_array, M: sparse.csr_array) -> NDArray[np.bool_]:
    """Rows with stiffness that have no mass."""
    return (K.diagonal() > 0) & (np.asarray(abs(M).sum(axis=1)).ravel() == 0)


def _massive(K: sparse.csr_array, M: sparse.csr_array, empty: NDArray[np.bool_]) -> sparse.csr_array:
    """The mass matrix with an inertia for rows that have none."""
    light, stiff, mass = massless(K, M), K.diagonal(), M.diagonal()
    if not light.any() or np.any(mass < 0) or not np.any(mass > 0):
        return M
    top = float(np.max(stiff[mass > 0] / mass[mass > 0]))
    return (M + sparse.diags_array(np.where(light & ~empty, stiff / (BEYOND**2 * top), 0.0))).tocsr()


def rows_of(labels: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.intp]:
    """Row of every wanted label; -1 where there is none."""
    keys, asked = keyed(labels), keyed(wanted)
    order = np.argsort(keys, kind="stable")
    at = np.minimum(np.searchsorted(keys[order], asked), len(keys) - 1)
    return np.where(keys[order][at] == asked, order[at], -1)
