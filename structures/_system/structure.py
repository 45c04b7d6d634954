"""Structure: K, M, C, the DOF table, the supports; reactions kept apart from loads."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .._channels import Dof
from .._readonly import ReadOnly
from ..errors import InputError, finite, one_of, plain, positive
from . import checks
from .damping import Damping, Rayleigh, settled
from .dissection import Elimination, elimination_of
from .fields import field_of, one_place

if TYPE_CHECKING:
    from .checks import RigidBodyMotion
    from .fields import Field


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Structure(ReadOnly):
    """A linear structure, M u'' + C u' + K u = f, held at its supports.

    Matrices cover all DOFs, supported ones included: supports are constraints, so that an applied load and a reaction
    are never mixed. Immutable; methods return a changed copy.

    Parameters
    ----------
    K, M, C : array or sparse array, shape (n, n)
        Stiffness, mass and damping; symmetric, finite. M and C may be None.
    dofs : sequence of Dof, str or (node, direction)
        One per row. A negative direction says that the unknown itself is positive against the axis.
    coordinates : array, shape (nodes, dim), optional
        Places of the nodes in ascending order of their numbers (m).
    supports : iterable of Dof, str or (node, direction)
        DOFs that are held; kept in the order of the table.
    damping : Rayleigh, Modal, Structural, float or None
        In addition to C (Rayleigh, Structural) or instead of it (Modal); a number is the Modal ratio of every mode.
    field : Field, optional
        What lies between the nodes; builders give it.
    parameters : mapping of str to float
        Factors applied so far, by name; `scaled` changes them.
    terms : mapping of str to sparse array
        Parts of K that `scaled` can change by name ("tension"); builders give them.

    Raises
    ------
    InputError
        Wrong shapes, NaN, asymmetry above 1e-10, duplicated DOFs, negative mass or stiffness, an indefinite mass or
        damping matrix, a free DOF without mass, an unknown support.
    """

    K: sparse.csr_array
    M: sparse.csr_array | None = None
    C: sparse.csr_array | None = None
    dofs: tuple[Dof, ...] = ()
    coordinates: Array | None = None
    supports: tuple[Dof, ...] = ()
    damping: Damping | None = None
    field: Field | None = None
    parameters: Mapping[str, float] = dataclasses.field(default_factory=dict)
    terms: Mapping[str, sparse.csr_array] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        fix = partial(object.__setattr__, self)  # a frozen dataclass needs it
        fix("K", checks.matrix("K", self.K))
        n = self.K.shape[0]
        for name in ("M", "C"):
            if getattr(self, name) is not None:
                fix(name, checks.matrix(name, getattr(self, name), size=n))
        fix("damping", settled(self.damping))
        fix("dofs", checks.table(self.dofs, n))
        fix("_index", {dof.key: i for i, dof in enumerate(self.dofs)})
        fix("supports", tuple(self.dofs[i] for i in sorted({self.index(d) for d in self.supports})))
        fix("coordinates", checks.places(self.coordinates, len({dof.node for dof in self.dofs})))
        fix("terms", {name: checks.matrix(name, term, size=n) for name, term in self.terms.items()})
        fix(
            "parameters",
            {"stiffness": 1.0, "mass": 1.0, "damping": 1.0, **dict.fromkeys(self.terms, 1.0), **self.parameters},
        )
        checks.positive(self)

    @classmethod
    def from_matrices(
        cls,
        K: Any,
        M: Any = None,
        C: Any = None,
        dofs: Sequence[Any] | None = None,
        supports: Iterable[Any] = (),
        coordinates: ArrayLike | None = None,
        damping: Damping | float | None = None,
    ) -> Structure:
        """Structure from a user's own matrices; without `dofs` they are the scalars ``0+S, 1+S, ...``.

        Parameters
        ----------
        K, M, C : array or sparse array, shape (n, n)
            Stiffness (N/m, N m/rad), mass (kg, kg m^2) and damping (N s/m), supported DOFs included.
        dofs, supports, coordinates, damping
            As in `Structure`.

        Raises
        ------
        InputError
            As `Structure`.
        """
        if dofs is None:
            dofs = [Dof(i, 0) for i in range(checks.matrix("K", K).shape[0])]
        table = tuple(Dof.parse(d) for d in dofs)
        held = tuple(Dof.parse(d) for d in supports)
        places: Any = coordinates  # checked with the rest
        return cls(K, M, C, table, places, held, settled(damping))

    def __repr__(self) -> str:
        held = ", ".join(str(d) for d in self.supports[:6]) + (", ..." if len(self.supports) > 6 else "")
        return f"Structure({self.n} DOFs, {len(self.supports)} supported ({held}), damping={self.damping})"

    # -- the DOF table --------------------------------------------------------------------------------------------
    @property
    def n(self) -> int:
        """Number of DOFs, supported ones included."""
        return int(self.K.shape[0])

    def index(self, dof: Any) -> int:
        """Row of a DOF, whatever its polarity.

        Raises
        ------
        InputError
            If the structure has no such DOF.
        """
        wanted = Dof.parse(dof)
        try:
            return int(self._index[wanted.key])  # type: ignore[attr-defined]
        except KeyError:
            raise InputError(
                "the structure has no such DOF",
                where="DOF table",
                found=str(wanted),
                expected=checks.describe(self.dofs, wanted),
                hint="structure.dofs lists them all; a place between nodes is given with at=",
            ) from None

    def unit_row(self, dof: Any) -> Array:
        """Row with ±1 at a DOF: +1 where its polarity is that of the table; shape (n,).

        Raises
        ------
        InputError
            If the structure has no such DOF.
        """
        wanted, row = Dof.parse(dof), np.zeros(self.n)
        i = self.index(wanted)
        row[i] = wanted.sign * self.dofs[i].sign
        return row

    @cached_property
    def supported(self) -> NDArray[np.intp]:
        """Rows of the supported DOFs, ascending."""
        return np.array([self.index(d) for d in self.supports], dtype=np.intp)

    @cached_property
    def free(self) -> NDArray[np.intp]:
        """Rows of the DOFs that are not supported, ascending."""
        return np.setdiff1d(np.arange(self.n), self.supported)

    @cached_property
    def elimination(self) -> Elimination | None:
        """Order in which the free DOFs of a large structure are eliminated; None where the solver finds one."""
        return elimination_of(self)

    # -- matrices of the free DOFs --------------------------------------------------------------------------------
    def _on_free(self, matrix: sparse.csr_array) -> sparse.csr_array:
        return matrix[self.free][:, self.free].tocsr()

    @cached_property
    def K_free(self) -> sparse.csr_array:
        """Stiffness of the free DOFs."""
        return self._on_free(self.K)

    @cached_property
    def M_free(self) -> sparse.csr_array | None:
        """Mass of the free DOFs; None without mass."""
        return None if self.M is None else self._on_free(self.M)

    @cached_property
    def C_free(self) -> sparse.csr_array | None:
        """Damping matrix of the free DOFs, Rayleigh part included; None where damping is modal or absent."""
        rayleigh = self.damping.matrix(self.K, self.M) if isinstance(self.damping, Rayleigh) else None
        parts = [part for part in (self.C, rayleigh) if part is not None]
        return self._on_free(sum(parts[1:], parts[0])) if parts else None

    def expand(self, u: ArrayLike) -> Array:
        """Motion of all DOFs, zero at the supports, from that of the free ones; (free, ...) -> (n, ...)."""
        u = np.asarray(plain(u))
        if u.shape[:1] != (self.free.size,):
            raise InputError(
                "wrong number of DOFs",
                where="expand",
                found=u.shape,
                expected=f"({self.free.size}, ...)",
                hint="one row per free DOF, in the order of structure.free",
            )
        full = np.zeros((self.n, *u.shape[1:]), u.dtype)
        full[self.free] = u
        return full

    def reactions(self, u: ArrayLike, load: ArrayLike | None = None) -> Array:
        """Static reactions K u - f at the supports, in the order of `supports`.

        Parameters
        ----------
        u : array, shape (n, ...) or (free DOFs, ...)
            Static displacement.
        load : array, shape (n, ...), optional
            The load that caused it; needed where a distributed load also acts on supported DOFs.

        Raises
        ------
        InputError
            If a shape is wrong or a value is not finite.
        """
        u = np.asarray(plain(u), float)
        u = self.expand(u) if u.shape[:1] == (self.free.size,) else u
        f = np.zeros_like(u) if load is None else np.asarray(plain(load), float)
        if u.shape[:1] != (self.n,) or f.shape != u.shape:
            raise InputError(
                "wrong shape",
                where="reactions",
                found=f"u {u.shape}, load {f.shape}",
                expected=f"({self.n}, ...)",
                hint="expand() completes the motion of the free DOFs",
            )
        for name, values in (("u", u), ("load", f)):
            hint = "look where the static response became so: an unsupported structure has none"
            finite(values, where=f"reactions, {name}", hint=hint)
        return np.asarray((self.K @ u - f)[self.supported])

    def rigid_body_motions(self) -> tuple[RigidBodyMotion, ...]:
        """Motions that the supports leave free and that cost no energy; empty for a structure that carries static load.

        From the geometry where a builder gave it, else from the null space of K. Each has a `name` in words and a
        `vector` (n,), largest entry 1.
        """
        return self._motions

    @cached_property
    def _motions(self) -> tuple[RigidBodyMotion, ...]:
        return checks.motions(self)

    # -- changed copies -------------------------------------------------------------------------------------------
    def with_damping(self, damping: Damping | float | None) -> Structure:
        """Copy with this damping instead of the present Rayleigh or modal one; C stays.

        Raises
        ------
        InputError
            If it is no damping, or a Modal one beside a matrix C.
        """
        return replace(self, damping=settled(damping))

    def with_supports(self, *dofs: Any) -> Structure:
        """Copy with more supports.

        Raises
        ------
        InputError
            If the structure has no such DOF.
        """
        return replace(self, supports=(*self.supports, *map(Dof.parse, dofs)))

    def with_mass(self, dof: Any = None, kg: float = 0.0, *, at: ArrayLike | None = None) -> Structure:
        """Copy that carries a point mass: a sensor, a hammer tip.

        Parameters
        ----------
        dof : Dof, str or (node, direction), optional
            Where: a translation. It adds inertia in this direction only.
        kg : float
            Mass (kg; kg m^2 at a rotation), positive.
        at : float or (x, y), optional
            Or where: a point inside an element, moving along Z.

        Raises
        ------
        InputError
            If the mass is not positive, the place is not exactly one, or the structure has no mass.
        """
        if self.M is None:
            raise InputError(
                "the structure has no mass matrix",
                where="with_mass",
                found="M = None",
                expected="a structure with M",
                hint="build it with M=",
            )
        kg = positive("a mass", kg, where="with_mass", unit="kg")
        one_place("with_mass", dof, at)
        row = self.unit_row(dof) if at is None else field_of(self, "with_mass").motion(at, 3)
        column = sparse.csr_array(row[:, None])
        return replace(self, M=self.M + kg * (column @ column.T))

    def scaled(self, parameter: str, factor: float) -> Structure:
        """Copy with one parameter multiplied: ``stiffness`` (all of K), ``mass``, ``damping``, or one of `terms`.

        Raises
        ------
        InputError
            If the parameter is unknown or the factor is not positive.
        """
        factor = positive("a factor", factor, where=f"scaled({parameter!r})")
        hint = "structure.parameters lists what can be scaled"
        one_of("no such parameter", parameter, self.parameters, where="scaled", hint=hint)
        changed: dict[str, Any] = {"parameters": {**self.parameters, parameter: self.parameters[parameter] * factor}}
        if parameter == "stiffness":
            changed |= {"K": factor * self.K, "terms": {name: factor * term for name, term in self.terms.items()}}
        elif parameter == "mass":
            changed["M"] = None if self.M is None else factor * self.M
        elif parameter == "damping":
            changed["C"] = None if self.C is None else factor * self.C
            changed["damping"] = None if self.damping is None else self.damping.scaled(factor)
        else:
            term = self.terms[parameter]
            changed |= {"K": self.K + (factor - 1.0) * term, "terms": {**self.terms, parameter: factor * term}}
        return replace(self, **changed)

    # -- identity -------------------------------------------------------------------------------------------------
    @cached_property
    def digest(self) -> str:
        """Sha256 (hex) of everything that the structure is made of."""
        h = hashlib.sha256()
        for name, matrix in (("K", self.K), ("M", self.M), ("C", self.C), *sorted(self.terms.items())):
            h.update(name.encode())
            if matrix is not None:
                for part in (matrix.indptr.astype(np.int64), matrix.indices.astype(np.int64), matrix.data):
                    h.update(np.ascontiguousarray(part).tobytes())
        table = [" ".join(map(str, dofs)) for dofs in (self.dofs, self.supports)]
        h.update(repr((table, self.damping, None if self.coordinates is None else self.coordinates.shape)).encode())
        if self.coordinates is not None:
            h.update(self.coordinates.tobytes())
        return h.hexdigest()
