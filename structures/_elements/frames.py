"""Frames of straight members in a plane or in space, with Timoshenko or Euler-Bernoulli bending.

A plane frame lies in X-Z and its nodes have ``n+X, n+Z, n+RY``, as a beam along X that deflects along Z; a node of a
space frame has all six. The nodes that the user names are the joints; the nodes inside the members are numbered after
them, member by member, and then those that hold the own rotation of a hinged end. A place on a frame is
``frames.At(member, s)``, with s in m from the start of the member; ``structure.field.locate`` finds it from a point.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .._channels import Dof, direction_code
from .._system.damping import Damping, settled
from .._system.fields import Line, assembled
from .._system.structure import Structure
from ..errors import InputError, integer, number, one_of, plain, positive, real, shown
from .framefield import At, FrameField, Piece
from .lineloads import LineLoad
from .members import Element, Material, Section

__all__ = ["SUPPORTS", "At", "FrameField", "LineLoad", "Material", "Member", "Section", "frame", "portal"]

SUPPORTS = ("clamped", "pinned")
ELEMENTS = 10_000  # per member
HINGES = ("", "start", "end", "both")
PARALLEL = 1e-6  # sine of the angle to the reference below which a member has no second axis
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Member:
    """A straight member between two joints; what is not given is taken from `frame`.

    Parameters
    ----------
    start, end : int
        Joints. The local x axis runs from one to the other.
    section, material : Section and Material, optional
        Its properties.
    elements : int, optional
        Equal elements along it.
    reference : (x, y, z), optional
        In space: direction towards which the local z axis (the height of the section) leans; +Z, and +X for a
        vertical member, where not given. In a plane z is x turned by 90 degrees, from +X to +Z.
    hinge : {"", "start", "end", "both"}
        Ends that carry no moment: a pin in a plane, a ball joint in space.
    tension : float
        Axial force (N, positive in tension) whose stiffness against deflection is added.

    Raises
    ------
    InputError
        If hinge or tension is not possible; the rest is checked with the frame.
    """

    start: int
    end: int
    _: KW_ONLY
    section: Section | None = None
    material: Material | None = None
    elements: int | None = None
    reference: Sequence[float] | None = None
    hinge: str = ""
    tension: float = 0.0

    def __post_init__(self) -> None:
        number("tension", self.tension, where="frame member", unit="N")
        where, ways = f"frame, member {self.start}-{self.end}", '"", "start", "end" or "both"'
        one_of(
            "unknown hinge", self.hinge, HINGES, where=where, expected=ways,
            hint='hinge="end" lets the end turn freely on its joint',
        )  # fmt: skip

    @property
    def hinges(self) -> tuple[bool, bool]:
        """Whether the start and the end are hinged."""
        return self.hinge in ("start", "both"), self.hinge in ("end", "both")


class DofTable:
    """Nodes, their places and the DOF table: joints, then the insides of the members, then the hinged ends."""

    def __init__(self, joints: dict[int, Array], members: Sequence[Member], plane: bool) -> None:
        self.axes = (1, 3, 5) if plane else (1, 2, 3, 4, 5, 6)
        lift = [0, 2] if plane else [0, 1, 2]
        self.places = {n: np.zeros(3) for n in sorted(joints)}
        for n, place in self.places.items():
            place[lift] = joints[n]
        ends = [zip((m.start, m.end), m.hinges, strict=True) for m in members]
        turning = {joint for pairs in ends for joint, hinged in pairs if not hinged}
        self.dofs = [Dof(n, a) for n in self.places for a in self.axes if a <= 3 or n in turning]
        fresh = itertools.count(max(joints) + 1)
        self.nodes: list[NDArray[np.intp]] = []
        for m in members:
            start, end = self.places[m.start], self.places[m.end]
            inner = [next(fresh) for _ in range((m.elements or 1) - 1)]
            for step, n in enumerate(inner, 1):
                self.places[n] = start + (end - start) * (step / (len(inner) + 1))
                self.dofs += [Dof(n, a) for a in self.axes]
            self.nodes.append(np.array([m.start, *inner, m.end], np.intp))
        self.turns: dict[tuple[int, int], int] = {}  # (member, end) to the node that holds a hinged end's rotation
        for k, m in enumerate(members):
            for side, (joint, hinged) in enumerate(zip((m.start, m.end), m.hinges, strict=True)):
                if hinged:
                    node = self.turns[k, side] = next(fresh)
                    self.places[node] = self.places[joint]
                    self.dofs += [Dof(node, a) for a in self.axes if a > 3]
        self.index = {dof.key: i for i, dof in enumerate(self.dofs)}

    def rows(self, k: int) -> NDArray[np.intp]:
        """DOFs of each element of member k."""
        nodes, last = self.nodes[k], len(self.nodes[k]) - 1
        turns = nodes.copy()
        turns[0], turns[last] = self.turns.get((k, 0), nodes[0]), self.turns.get((k, 1), nodes[last])
        ends = [
            [self.index[int(n) if a <= 3 else int(t), a] for a in self.axes] for n, t in zip(nodes, turns, strict=True)
        ]
        return np.array([a + b for a, b in itertools.pairwise(ends)], np.intp)


def meshed(k: int, m: Member, lay: DofTable, plane: bool, shear: bool) -> Piece:
    """A member as it is meshed, its section checked against what the theory needs."""
    assert m.section is not None
    assert m.material is not None
    assert m.elements is not None
    where = f"frame, member {m.start}-{m.end}"
    along = lay.places[m.end] - lay.places[m.start]
    length = float(np.linalg.norm(along))
    needed = ([] if plane else ["I_z", "J"]) + (["shear"] if shear else [])
    if missing := [name for name in needed if getattr(m.section, name) is None]:
        raise InputError(
            f"the section lacks {', '.join(missing)}",
            where=where,
            found=repr(m.section),
            expected=", ".join(needed),
            hint="Section.rectangle, circle and tube know them; Section(A, I, c, I_z=, J=, shear=) takes them",
        )
    if not shear and 4 * m.section.c > length:
        raise InputError(
            "the section is too deep for a member of this length: it would shear, not bend",
            where=where,
            found=f"depth {2 * m.section.c:g} m, length {length:g} m",
            expected="a depth of at most half the length",
            hint="shear=True takes Timoshenko theory; check the units of the section (m)",
        )
    if not plane and m.hinge == "both":
        raise InputError(
            "a member with two ball joints would spin about its own axis",
            where=where,
            found='hinge="both" in space',
            expected="one hinged end in space",
            hint='hinge="end"; a slender member passes on next to no moment anyway',
        )
    line = Line(length, m.elements, name="s")
    return Piece(
        line, Element(line.h, m.section, m.material, shear), _axes(m, along / length, plane), lay.nodes[k], lay.rows(k)
    )


def _axes(m: Member, x: Array, plane: bool) -> Array:
    """Rows are the local axes: x along the member, z towards the reference, y = z x x."""
    where = f"frame, member {m.start}-{m.end}, reference"
    if plane:
        if m.reference is not None:
            raise InputError(
                "a plane frame takes no reference",
                where=where,
                found=shown(m.reference),
                expected="none",
                hint="its local y axis is +Y; give three coordinates at every node for a frame in space",
            )
        y = np.array([0.0, 1.0, 0.0])
        return np.array([x, y, np.cross(x, y)])
    if m.reference is None:
        candidates = [np.eye(3)[2], np.eye(3)[0]]
        leaning = next(v for v in candidates if np.linalg.norm(np.cross(v, x)) > PARALLEL)
    else:
        values = [real(v) for v in m.reference] if np.iterable(m.reference) else []
        leaning = np.array([0.0 if v is None else v for v in values])
        if len(values) != 3 or None in values or not np.any(leaning):
            raise InputError(
                "no reference vector",
                where=where,
                found=shown(m.reference),
                expected="three finite numbers, not all zero",
                hint="reference=(0, 0, 1)",
            )
        leaning = leaning / np.linalg.norm(leaning)
    y = np.cross(leaning, x)
    sine = np.linalg.norm(y)
    if sine < PARALLEL:
        raise InputError(
            "the reference is parallel to its member",
            where=where,
            found=f"{shown(m.reference)}, sine of the angle {sine:.1g}",
            expected=f"a vector across the member, sine above {PARALLEL:g}",
            hint="point it where the height of the section points",
        )
    y = y / sine
    return np.array([x, y, np.cross(x, y)])


def assemble(pieces: Sequence[Piece], local: Sequence[Array], size: int) -> sparse.csr_array:
    """Matrix of all DOFs from one element matrix in local axes per member."""
    blocks = [piece.matrix(A) for piece, A in zip(pieces, local, strict=True)]
    # the rotation leaves rounding, which is mirrored
    each = [np.broadcast_to((A + A.T) / 2, (len(p.dofs), *A.shape)) for A, p in zip(blocks, pieces, strict=True)]
    return assembled(np.concatenate(each), np.concatenate([piece.dofs for piece in pieces]), size)


def frame(
    nodes: Sequence[Sequence[float]] | Mapping[int, Sequence[float]],
    members: Sequence[Member | tuple[int, int]],
    *,
    supports: Mapping[int, str | Sequence[str]] | None = None,
    section: Section | None = None,
    material: Material | None = None,
    elements: int = 8,
    shear: bool = False,
    damping: Damping | float | None = None,
) -> Structure:
    """Frame of straight members: in the X-Z plane where the nodes are (x, z), in space where they are (x, y, z).

    Parameters
    ----------
    nodes : sequence or mapping of (x, z) or (x, y, z)
        Joints (m): numbered from 0, or by the keys of a mapping.
    members : sequence of Member or (start, end)
        What joins them.
    supports : mapping of joint to {"clamped", "pinned"} or directions, optional
        ``{0: "clamped", 3: "pinned", 5: ("Z", "RX")}``; pinned holds the translations.
    section, material : Section and Material, optional
        Those of every member that has none of its own.
    elements : int
        Elements per member. One is exact for static loads at the joints; frequencies take six per wavelength.
    shear : bool
        Timoshenko theory (shear and rotary inertia) instead of Euler-Bernoulli. Its frequencies converge with the
        second order of the element length only, those of Euler-Bernoulli with the fourth.
    damping : Rayleigh, Modal, Structural or float, optional
        Damping; a number is the ratio of every mode.

    Returns
    -------
    Structure
        DOFs ``n+X, n+Z, n+RY`` or ``n+X`` to ``n+RZ``; parameter "tension" where a member has one.

    Raises
    ------
    InputError
        If a value is not possible, a node is unknown or not used, a member is double or has no length, a reference is
        parallel to its member, a section lacks what the theory needs, or the frame falls into parts.

    Notes
    -----
    Elements of `structures._elements.members` (Przemieniecki 1968, Friedman & Kosmatka 1993), rotated. Static answers
    at the joints are exact for any number of elements, line loads included. A frame without enough supports or with too
    many hinges has no static response: the refusal names the motion.
    """
    joints = _joints(nodes)
    plane = len(next(iter(joints.values()))) == 2
    given = [_member(m, joints, section, material, elements) for m in _listed(members)]
    _connected(given, joints)
    lay = DofTable(joints, given, plane)
    pieces = tuple(meshed(k, m, lay, plane, shear) for k, m in enumerate(given))
    table = tuple(lay.dofs)
    places = np.array([lay.places[dof.node] for dof in table])
    middle = (places.min(axis=0) + places.max(axis=0)) / 2
    K, M = (
        assemble(pieces, [getattr(p.element, name)() for p in pieces], len(table)) for name in ("stiffness", "mass")
    )
    terms = {}
    if any(m.tension for m in given):
        local = [p.element.tension(m.tension) for p, m in zip(pieces, given, strict=True)]
        terms["tension"] = assemble(pieces, local, len(table))
        K = K + terms["tension"]
    shown_axes = [0, 2] if plane else [0, 1, 2]
    return Structure(
        K=K,
        M=M,
        dofs=table,
        coordinates=np.array([lay.places[node] for node in sorted({dof.node for dof in table})])[:, shown_axes],
        supports=tuple(_supports(supports or {}, joints, lay)),
        damping=settled(damping),
        field=FrameField(pieces, table, places - middle, middle, any(m.hinge for m in given)),
        terms=terms,
    )


def portal(
    *,
    width: float,
    height: float,
    section: Section,
    material: Material,
    beam: Section | None = None,
    bays: int = 1,
    storeys: int = 1,
    feet: str = "clamped",
    elements: int = 8,
    shear: bool = False,
    damping: Damping | float | None = None,
) -> Structure:
    """Plane portal frame, or a building of several bays and storeys.

    Joints are numbered from the left foot, floor by floor: joint i + (bays + 1) j is at x = i width, z = j height.
    Members are the columns, storey by storey from the left and upwards, and then the beams, floor by floor.

    Parameters
    ----------
    width, height : float
        Of one bay and one storey (m).
    section, material : Section and Material
        Of the columns, and of the beams where these have no own section.
    beam : Section, optional
        Of the beams.
    bays, storeys : int
        How many.
    feet : {"clamped", "pinned"}
        Supports of the columns.
    elements, shear, damping
        As in `frame`.

    Raises
    ------
    InputError
        As `frame`.
    """
    width = positive("width", width, where="portal", unit="m")
    height = positive("height", height, where="portal", unit="m")
    across = integer("bays", bays, where="portal", limit=1000) + 1
    floors = integer("storeys", storeys, where="portal", limit=1000) + 1
    nodes = [(i * width, j * height) for j in range(floors) for i in range(across)]
    columns = [Member(n, n + across) for n in range(across * (floors - 1))]
    beams = [
        Member(i + across * j, i + 1 + across * j, section=beam) for j in range(1, floors) for i in range(across - 1)
    ]
    supports = dict.fromkeys(range(across), feet)
    return frame(
        nodes,
        columns + beams,
        supports=supports,
        section=section,
        material=material,
        elements=elements,
        shear=shear,
        damping=damping,
    )


# -- what the user gives ----------------------------------------------------------------------------------------------
def _joints(nodes: Any) -> dict[int, Array]:
    """Joints by number, all of two or all of three coordinates."""
    items = dict(nodes) if isinstance(nodes, Mapping) else dict(enumerate(nodes)) if np.iterable(nodes) else {}
    out = {}
    for key, place in items.items():
        values = [real(v) for v in place] if np.iterable(place) and not isinstance(place, str) else []
        if len(values) not in (2, 3) or None in values:
            raise InputError(
                "a node has no place",
                where=f"frame, node {key}",
                found=shown(place),
                expected="finite (x, z) or (x, y, z) in m",
                hint="a plane frame lies in X-Z; a space frame has three coordinates at every node",
            )
        out[Dof(key, 0).node] = np.array(plain(values), float)
    if len({len(place) for place in out.values()}) != 1:
        raise InputError(
            "nodes must all have two or all have three coordinates",
            where="frame, nodes",
            found=f"{len(out)} nodes with {sorted({len(p) for p in out.values()})} coordinates",
            expected="(x, z) throughout, or (x, y, z) throughout",
            hint="nodes=[(0, 0), (0, 3), (4, 3), (4, 0)]",
        )
    return out


def _listed(members: Any) -> list[Member]:
    """Members, as such."""
    items = list(members) if np.iterable(members) else []
    out: list[Member] = []
    for item in items:
        ends = tuple(item) if isinstance(item, Sequence | np.ndarray) and len(item) == 2 else None
        if not isinstance(item, Member) and ends is None:
            raise InputError(
                "no member",
                where=f"frame, member {len(out)}",
                found=shown(item),
                expected="(start, end) or a frames.Member",
                hint="members=[(0, 1), frames.Member(1, 2, section=...)]",
            )
        out.append(item if ends is None else Member(*ends))
    if not out:
        raise InputError(
            "a frame needs a member",
            where="frame, members",
            found=shown(members),
            expected="(start, end) pairs",
            hint="members=[(0, 1), (1, 2)]",
        )
    return out


def _member(
    member: Member, joints: dict[int, Array], section: Section | None, material: Material | None, elements: int
) -> Member:
    """Member with everything that it takes from the frame, checked."""
    where = f"frame, member {member.start}-{member.end}"
    for joint in (member.start, member.end):
        if isinstance(joint, bool) or joint not in joints:
            some = ", ".join(map(str, list(joints)[:12])) + (", ..." if len(joints) > 12 else "")
            raise InputError(
                "unknown node", where=where, found=shown(joint), expected=some, hint="list the node in nodes first"
            )
    whole = replace(
        member,
        section=member.section if member.section is not None else section,
        material=member.material if member.material is not None else material,
        elements=integer(
            "elements", elements if member.elements is None else member.elements, where=where, limit=ELEMENTS
        ),
    )
    for name, kind in (("section", Section), ("material", Material)):
        if not isinstance(getattr(whole, name), kind):
            raise InputError(
                f"a member has no {name}",
                where=where,
                found=shown(getattr(whole, name)),
                expected=f"a frames.{kind.__name__}",
                hint=f"give {name}= to the frame, or to each Member",
            )
    return whole


def _connected(members: Sequence[Member], joints: dict[int, Array]) -> None:
    """Refuse double members, members without length, unused nodes and separate parts."""
    size = float(np.ptp(list(joints.values()), axis=0).max(initial=0.0))
    seen: set[frozenset[int]] = set()
    group = {joint: {joint} for joint in joints}
    for m in members:
        ends = frozenset((m.start, m.end))
        if not np.linalg.norm(joints[m.end] - joints[m.start]) > 1e-9 * size:
            raise InputError(
                "a member has no length",
                where=f"frame, member {m.start}-{m.end}",
                found=f"nodes at {joints[m.start]} m and {joints[m.end]} m",
                expected="two different places",
                hint="merge the two nodes, or correct a coordinate",
            )
        if ends in seen:
            raise InputError(
                "two members join the same nodes",
                where=f"frame, member {m.start}-{m.end}",
                found="a duplicate",
                expected="each pair of nodes once",
                hint="drop one of them, or give the one that stays the properties of both",
            )
        seen.add(ends)
        both = group[m.start] | group[m.end]
        group |= dict.fromkeys(both, both)
    parts = {frozenset(g) for g in group.values()}
    if len(parts) > 1:
        small = sorted(min((len(part), sorted(part)) for part in parts)[1])
        raise InputError(
            "the frame falls into parts that no member joins",
            where="frame",
            found=f"{len(parts)} parts, one of them nodes {', '.join(map(str, small[:8]))}",
            expected="one connected frame",
            hint="add the missing member, or drop the node; build separate frames separately",
        )


def _supports(supports: Mapping[int, Any], joints: dict[int, Array], lay: DofTable) -> list[Dof]:
    """Held DOFs of every supported joint."""
    held = []
    for joint, kind in supports.items():
        where = f"frame, support of node {joint}"
        if joint not in joints:
            raise InputError(
                "unknown node",
                where=where,
                found=shown(joint),
                expected="a node of the frame",
                hint="supports={0: ...}",
            )
        own = [dof for dof in lay.dofs if dof.node == joint]
        if isinstance(kind, str) and kind in SUPPORTS:
            held += [dof for dof in own if kind == "clamped" or not dof.is_rotation]
            continue
        labels = [kind] if isinstance(kind, str) else list(kind) if np.iterable(kind) else [kind]
        try:
            wanted = {abs(direction_code(label)) for label in labels}
        except InputError:
            wanted = set()
        if not wanted or not wanted <= {dof.axis for dof in own}:
            raise InputError(
                "unknown support",
                where=where,
                found=shown(kind),
                expected=f"clamped, pinned, or some of {', '.join(str(d)[len(str(joint)) + 1 :] for d in own)}",
                hint='supports={0: "clamped", 3: ("Z",)}; a joint whose members are all hinged has no rotation',
            )
        held += [dof for dof in own if dof.axis in wanted]
    return held
