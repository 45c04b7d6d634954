"""What presses are drawn from: ranges by name, the same in Python and in TOML.

A range is one number, which is then always the same, or two, between which all values are equally likely. In Python
they are SI; in TOML they carry their units: ``depth = ["0.1 mm", "0.4 mm"]``.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from loadid.generate._ranges import Range, Ranges, within
from structures import _toml
from structures.errors import InputError, number, one_of, positive, shown

from .._pad.table import TomlTable
from .._pad.tolerances import Tolerances

SIZES = {  # kind of body -> what it is measured by
    "sphere": ("radius",), "cylinder": ("radius", "length"), "flat": ("radius",), "ring": ("outer", "inner"),
    "bar": ("length", "width"), "edge": ("slope", "length"), "cone": ("slope",), "polygon": ("radius", "corners"),
}  # fmt: skip
EVEN = 3**0.5  # half the width of an even distribution of unit std
LEAST, SOFTEST = 0.1, 0.495  # share of modulus or thickness, and nu, that no tolerance reaches beyond
TURNED = ("cylinder", "bar", "edge", "polygon")  # kinds that look different when turned


@dataclass(frozen=True)
class IndenterRange(Ranges):
    """A kind of body, and how large it may be.

    Parameters
    ----------
    kind : {"sphere", "cylinder", "flat", "ring", "bar", "edge", "cone", "polygon"}
    weight : float
        How often it is drawn, beside the others.
    radius, length, width, outer, inner : range, optional
        m: those that its kind has. That of a polygon is the radius on which its corners lie.
    slope : range, optional
        Of the sides of an edge or a cone: rise over run.
    corners : range, optional
        Of a polygon: 3 to 12.
    depth, force : range, optional
        Instead of those of the contact (m, N).

    Raises
    ------
    InputError
        Another kind, a size that it has not or that is missing, a ring whose inner radius may reach the outer one.
    """

    kind: str
    weight: float = 1.0
    radius: Range | None = field(default=None, metadata=within("displacement", 1e-5))
    length: Range | None = field(default=None, metadata=within("displacement", 1e-5))
    width: Range | None = field(default=None, metadata=within("displacement", 1e-5))
    outer: Range | None = field(default=None, metadata=within("displacement", 1e-5))
    inner: Range | None = field(default=None, metadata=within("displacement", 1e-5))
    slope: Range | None = field(default=None, metadata=within("", 1e-3, 100.0))
    corners: Range | None = field(default=None, metadata=within("", 3, 12))
    depth: Range | None = field(default=None, metadata=within("displacement", 1e-7))
    force: Range | None = field(default=None, metadata=within("force", 1e-6))

    def __post_init__(self) -> None:
        one_of("no kind of indenter", self.kind, SIZES, where="IndenterRange, kind")
        positive("weight", self.weight, where="IndenterRange")
        super().__post_init__()
        place = f"IndenterRange, {self.kind}"
        for name in ("radius", "length", "width", "outer", "inner", "slope", "corners"):
            stated, needed = getattr(self, name) is not None, name in SIZES[self.kind]
            if stated != needed:
                raise InputError(f"the size {name} is {'missing' if needed else 'none of this kind'}", where=place,
                                 found=name if stated else "nothing",
                                 expected=", ".join(SIZES[self.kind]))  # fmt: skip
        if self.outer is not None and self.inner is not None and self.inner[1] >= self.outer[0]:
            raise InputError("the hole of a ring may be as wide as the ring", where=place,
                             found=f"inner up to {self.inner[1]:g} m, outer from {self.outer[0]:g} m",
                             expected="inner radii below all outer ones")  # fmt: skip
        if self.depth is not None and self.force is not None:
            raise InputError("depth or force", where=place, found="both", expected="one of them")


@dataclass(frozen=True)
class ContactRange(Ranges):
    """Where and how bodies are pressed.

    Parameters
    ----------
    x, y : range, optional
        Place of the contact on the pad (m); all places that are a thickness from its edge where not stated.
    depth, force : range, optional
        How deep (m), or with how much force (N) a body is pressed: one of them.
    shear : range
        How far it is then dragged (m), in any direction.
    twist : range
        By how much it is turned meanwhile (rad).
    friction : range
        Coefficient of Coulomb's law.
    bodies : int
        Most bodies on one holder.
    several : float
        Share of the presses by more than one.
    apart : range
        Distance of their places (m).

    Raises
    ------
    InputError
        A range that is not possible, depth and force, bodies without a distance.
    """

    x: Range | None = field(default=None, metadata=within("displacement", -1.0, 1.0))
    y: Range | None = field(default=None, metadata=within("displacement", -1.0, 1.0))
    depth: Range | None = field(default=None, metadata=within("displacement", 1e-7))
    force: Range | None = field(default=None, metadata=within("force", 1e-6))
    shear: Range = field(default=(0.0, 0.0), metadata=within("displacement", 0.0))
    twist: Range = field(default=(0.0, 0.0), metadata=within("angle", -np.pi, np.pi))
    friction: Range = field(default=(0.5, 0.5), metadata=within("", 0.01, 10.0))
    bodies: int = 1
    several: float = 0.0
    apart: Range | None = field(default=None, metadata=within("displacement", 1e-5))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.depth is not None and self.force is not None:
            raise InputError("depth or force", where="ContactRange", found="both", expected="one of them")
        if not (isinstance(self.bodies, int) and 1 <= self.bodies <= 8):
            raise InputError("no number of bodies", where="ContactRange", found=shown(self.bodies), expected="1 to 8")
        if not 0 <= number("several", self.several, where="ContactRange") <= 1:
            raise InputError("no share", where="ContactRange, several", found=self.several, expected="0 to 1")
        if self.several and (self.bodies < 2 or self.apart is None):
            raise InputError("several bodies need their number and their distance", where="ContactRange",
                             found=f"bodies {self.bodies}, apart {self.apart}",
                             expected="bodies from 2 on, and apart")  # fmt: skip


@dataclass(frozen=True)
class GelRange(Ranges):
    """The gel of a sensor as it may be; what is not stated lies within the tolerances of the sensor.

    Parameters
    ----------
    E, thickness : range, optional
        Over those that the sensor was built with.
    nu : range, optional
        Poisson's ratio.
    """

    E: Range | None = field(default=None, metadata=within("", 0.01, 100.0))
    nu: Range | None = field(default=None, metadata=within("", 0.0, 0.4999))
    thickness: Range | None = field(default=None, metadata=within("", 0.1, 10.0))

    def known_to(self, tolerances: Tolerances, nu: float) -> GelRange:
        """With the range of what is not stated: that of an even distribution about the gel whose stds are these."""
        E, thickness = (
            given or (max(1 - EVEN * std, LEAST), 1 + EVEN * std)
            for given, std in ((self.E, tolerances.E), (self.thickness, tolerances.thickness))
        )
        off = EVEN * tolerances.nu
        around = (max(nu - off, 0.0), max(nu, min(nu + off, SOFTEST))) if off else None
        return GelRange(E, self.nu or around, thickness)


@dataclass(frozen=True)
class CameraRange(Ranges):
    """How the camera may sit after it was mounted again; zero is taken there.

    Parameters
    ----------
    shift : range
        Of the image along each of its axes (px).
    turn, tilt : range
        About the axis of the camera, and of the axis about each axis of the image (rad).
    scale : range
        Of the image.
    """

    shift: Range = field(default=(0.0, 0.0), metadata=within("px", -1e4, 1e4))
    turn: Range = field(default=(0.0, 0.0), metadata=within("angle", -np.pi, np.pi))
    tilt: Range = field(default=(0.0, 0.0), metadata=within("angle", -0.5, 0.5))
    scale: Range = field(default=(1.0, 1.0), metadata=within("", 0.1, 10.0))


@dataclass(frozen=True)
class ImageRange(Ranges):
    """How the images look.

    Parameters
    ----------
    size : (rows, columns)
    radius : range
        Of the dots (m).
    blur : range
        Std of the optical blur (px).
    noise, background, dot, shading : range
        Grey levels: noise, the gel, a dot, and by how many the gel is darker at the corners.
    """

    size: tuple[int, int] = (480, 640)
    radius: Range = field(default=(0.22e-3, 0.22e-3), metadata=within("displacement", 1e-6))
    blur: Range = field(default=(1.0, 1.0), metadata=within("px", 0.1, 20.0))
    noise: Range = field(default=(2.0, 2.0), metadata=within("", 0.0, 100.0))
    background: Range = field(default=(160.0, 160.0), metadata=within("", 1.0, 254.0))
    dot: Range = field(default=(60.0, 60.0), metadata=within("", 0.0, 254.0))
    shading: Range = field(default=(30.0, 30.0), metadata=within("", 0.0, 200.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        size = tuple(self.size) if isinstance(self.size, Sequence) else ()
        if len(size) != 2 or not all(isinstance(n, int) and 16 <= n <= 10_000 for n in size):
            raise InputError("no size of images", where="ImageRange, size", found=shown(self.size),
                             expected="rows and columns, 16 to 10000")  # fmt: skip
        object.__setattr__(self, "size", size)


@dataclass(frozen=True)
class MarkerRange(Ranges):
    """What befalls the markers.

    Parameters
    ----------
    lost : range
        Share of them that is not seen.
    noise : range
        Of their motion, over that of the sensor; rendered images bring their own.
    """

    lost: Range = field(default=(0.0, 0.0), metadata=within("", 0.0, 0.9))
    noise: Range = field(default=(1.0, 1.0), metadata=within("", 0.0, 100.0))


TABLES: dict[str, Any] = {
    "contact": ContactRange, "gel": GelRange, "camera": CameraRange, "image": ImageRange, "markers": MarkerRange,
}  # fmt: skip


@dataclass(frozen=True)
class PressDeclaration:
    """A distribution of presses.

    Parameters
    ----------
    indenter : sequence of IndenterRange
    contact : ContactRange
    gel : GelRange
    camera : CameraRange
    image : ImageRange
    markers : MarkerRange

    Raises
    ------
    InputError
        No indenter, or one that is pressed neither by depth nor by force.
    """

    indenter: Sequence[IndenterRange]
    contact: ContactRange = ContactRange()
    gel: GelRange = GelRange()
    camera: CameraRange = CameraRange()
    image: ImageRange = ImageRange()
    markers: MarkerRange = MarkerRange()

    def __post_init__(self) -> None:
        bodies = (self.indenter,) if isinstance(self.indenter, IndenterRange) else tuple(self.indenter)
        object.__setattr__(self, "indenter", bodies)
        if not bodies or not all(isinstance(one, IndenterRange) for one in bodies):
            raise InputError("no indenters", where="PressDeclaration", found=shown(self.indenter),
                             expected="one IndenterRange at least")  # fmt: skip
        for name, kind in TABLES.items():
            if not isinstance(getattr(self, name), kind):
                raise InputError(f"no ranges of {name}", where="PressDeclaration", found=shown(getattr(self, name)),
                                 expected=kind.__name__)  # fmt: skip
        if self.contact.depth is None and self.contact.force is None:
            for one in bodies:
                if one.depth is None and one.force is None:
                    raise InputError("how deep, or with how much force?", where=f"PressDeclaration, {one.kind}",
                                     found="neither depth nor force",
                                     expected="depth or force, of the contact or of each indenter")  # fmt: skip

    @property
    def plain(self) -> dict[str, Any]:
        """As plain data, in SI."""
        tables = {name: getattr(self, name).plain for name in TABLES}
        return {"indenter": [one.plain for one in self.indenter], **tables}

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> PressDeclaration:
        """The declaration of a TOML file: tables ``[[indenter]]``, ``[contact]``, ``[gel]``, ``[camera]``, ...

        Raises
        ------
        InputError
            No such file; a key that is none, with the nearest; a range that is not possible.
        """
        file = Path(os.fspath(path))
        try:
            tree = _toml.load(file, "the declaration is no TOML", 'texts stand in quotes: depth = "0.3 mm"')
        except OSError as error:
            raise InputError("the declaration cannot be read", where=str(file), found=error.strerror or error,
                             hint="check the path") from None  # fmt: skip
        return cls.of_tables(file, tree)

    @classmethod
    def of_tables(cls, file: Path, tree: Mapping[str, Any]) -> PressDeclaration:
        """The declaration of the tables of a file.

        Raises
        ------
        InputError
            As `read`.
        """
        top = TomlTable(file, "", tree)
        given: dict[str, Any] = {}
        for name, kind in TABLES.items():
            table = top.table(name)
            if table is not None:
                given[name] = _made(table, kind)
        listed = tree.get("indenter", [])
        if not isinstance(listed, list) or not all(isinstance(one, Mapping) for one in listed):
            raise top.refused("indenter", "no indenters", shown(listed), "[[indenter]] tables")
        top.known("indenter")
        bodies = [_made(TomlTable(file, "[indenter]", one), IndenterRange) for one in listed]
        top.end()
        with top.named():
            return cls(bodies, **given)


def _made(table: TomlTable, kind: Any) -> Any:
    """A table of ranges of a table of TOML."""
    given = {}
    for one in fields(kind):
        if one.name not in table:
            if one.default is MISSING:
                table.text(one.name)  # refuses
            table.known(one.name)
            continue
        value = table.values[one.name]
        unit = one.metadata.get("unit")
        table.known(one.name)
        if unit:
            given[one.name] = (
                table.quantities(one.name, unit, 2) if isinstance(value, list) else table.quantity(one.name, unit)
            )
        else:
            given[one.name] = value
    table.end()
    with table.named():
        return kind(**given)
