"""A sensor in one TOML file: pad, camera, markers, depth map and contact.

Numbers are written with their unit, ``"24 mm"``; px may be left out where nothing else can be meant. What is not there
has its default; what is not known is refused with its name. `EXAMPLE` holds all of it, with a comment on each line.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from loadid._inverse.rules import RULES
from structures import _toml
from structures.errors import InputError, plain

from .._arrays import Array
from .._guards import counts
from .._sensors.observation import DepthMap
from ..vision._eye import View
from ..vision._rays import Window
from . import body as outline
from .table import TomlTable
from .tolerances import Tolerances

if TYPE_CHECKING:
    from .._sensors.observation import DepthMap
    from ..vision._eye import View


EXAMPLE = """\
# A marked gel pad, its camera and its depth map. Lengths in the frame of the pad: origin at its centre, z out of it.

[pad]
size = ["24 mm", "24 mm"]       # along x and y; or mesh = "pad.inp", mesh_unit = "mm"
thickness = "3 mm"
E = "0.147 MPa"
nu = 0.3223
pitch = "1 mm"                  # of the nodes of the map; a quarter of the thickness if left out
layers = 4                      # of elements through the thickness
# rounded = "3 mm"              # radius of the corners; or polygon = [["-12 mm", "-12 mm"], ...]
# rim = "bonded"                # the sides are held by a ring or box; free if left out
# curvature = "40 mm"           # radius of curvature of a domed surface, the thickness at its apex;
# shape = "dome"                # or a cap on a round plinth: radius, height and plinth for size and thickness

# [tolerances]                  # std of what the pad is built with, where the band should hold it
# E = 0.1                       # of its value
# nu = 0.03                     # of nu itself
# thickness = 0.05              # of its value

[camera]                        # a lens under the pad ...
focal = 640                     # px
centre = [320, 240]             # px, where the optical axis meets the image
distance = "25 mm"              # from the lens to the window
depth = "3 mm"                  # from the face of the window to the markers
gamma = 1.4                     # index of gel and window over that of air
tilt = "12 deg"
azimuth = "17 deg"
# homography = [[...], [...], [...]]   # ... or a matrix from the pad to the image, with
# homography_unit = "mm"               # its unit of length and the rays: alpha, gamma, azimuth,
# points, pixels                       # or a table [camera.lens]: at, distance, depth, gamma

[markers]
dark = true                     # dots on a brighter gel
# radius = 5.0                  # px; found in the image if left out, as is the pitch
# noise = "0.02 px"             # std of a place; measured on unloaded frames if left out
# unit = "px"                   # of a file of marker motions: px, or a length

[depth]                         # a depth map beside the camera
pixel = "0.1 mm"
noise = "10 um"                 # std of one pixel
unit = "m"                      # of the numbers in the files
pressed = "negative"            # sign of a pressed place
# absolute = true               # the unloaded maps are not zero: take them off
# centre = ["0 mm", "0 mm"]     # of the map on the pad

[contact]
no_pull = false
# friction = 0.8
# lam = 0.007                   # relative lambda, or its rule; chosen on the strongest frames if left out
# penalty = "identity"          # a ridge; "gradient", "laplacian"; without it loads are taken to be contacts
"""
TABLES = ("pad", "tolerances", "camera", "markers", "depth", "contact")
METHODS = ("parabola", "centroid")
PENALTIES = ("contact", "identity", "gradient", "laplacian")
SHAPES, RIMS = ("block", "dome"), outline.RIMS
ELEMENTS = ("bbar", "standard", "incompatible")


@dataclass(frozen=True)
class DepthKind:
    """What the depth maps of a sensor are: size of a pixel and std of one (m), centre on the pad (m).

    A number in a file times `factor` is motion in m, outward positive; `absolute` maps of the unloaded pad are not
    zero.
    """

    pixel: float
    noise: float
    centre: tuple[float, float] = (0.0, 0.0)
    factor: float = 1.0
    absolute: bool = False

    def map(self, values: Any, zero: Array | float = 0.0) -> DepthMap:
        """Depth map of the numbers of a file, less `zero` (m)."""
        return DepthMap(self.factor * np.asarray(plain(values), float) - zero, self.pixel, self.noise, self.centre)


@dataclass(frozen=True, kw_only=True)
class SensorFile:
    """A sensor as its file describes it.

    `body` are settings of `Pad`, for `Pad.from_settings`, `tracking` those of `tactile.vision.MarkerTracker`, `contact`
    those of the inversion (``no_pull, friction, lam, penalty``), `tolerances` say how well the pad is known; `noise` is
    the std of the place of a marker with its unit, ``"px"`` or ``"m"``; `unit` that of marker motions in a file:
    ``"px"``, or metres of one unit.
    """

    path: Path
    body: Mapping[str, Any]
    view: View | None = None
    tracking: Mapping[str, Any] = field(default_factory=dict)
    noise: tuple[float, str] | None = None
    unit: str | float = "px"
    depth: DepthKind | None = None
    contact: Mapping[str, Any] = field(default_factory=dict)
    tolerances: Tolerances = Tolerances()  # noqa: RUF009  (frozen)


def read(path: str | os.PathLike[str]) -> SensorFile:
    """Sensor of a TOML file; what is not known, missing or without its unit is refused with file, table and key."""
    place = Path(os.fspath(path))
    tables = _tables(place)
    markers = TomlTable(place, "markers", tables.get("markers", {}))
    found = SensorFile(
        path=place,
        body=_body(TomlTable(place, "pad", tables["pad"])),
        view=_view(TomlTable(place, "camera", tables["camera"])) if "camera" in tables else None,
        noise=markers.noise("noise"),
        unit=markers.unit("unit", default="px"),
        tracking=_tracking(markers),
        depth=_depth(TomlTable(place, "depth", tables["depth"])) if "depth" in tables else None,
        contact=_contact(TomlTable(place, "contact", tables.get("contact", {}))),
        tolerances=_tolerances(TomlTable(place, "tolerances", tables.get("tolerances", {}))),
    )
    markers.end()
    return found


def _tables(place: Path) -> dict[str, Any]:
    try:
        tables = _toml.load(place, "the pad file cannot be read", 'texts stand in quotes: thickness = "3 mm"')
    except FileNotFoundError:
        raise InputError("there is no such file", where=str(place), expected="a pad file (TOML)",
                         hint="loadid tactile demo writes one to start from") from None  # fmt: skip
    except OSError as error:
        raise InputError("the pad file cannot be read", where=str(place), found=error.strerror or str(error),
                         expected="TOML", hint="check the path") from None  # fmt: skip
    top = TomlTable(place, "", tables)
    for name in TABLES:
        top.table(name)
    top.end()
    if "pad" not in tables:
        raise InputError("the table [pad] is missing", where=str(place), found=", ".join(tables) or "an empty file",
                         expected="[pad] with size, thickness, E and nu")  # fmt: skip
    return tables


def _body(t: TomlTable) -> dict[str, Any]:
    """Settings of the pad; those that the file leaves out are left out."""
    t.bare_numbers(t.word("length_unit", ("m", "cm", "mm", "um"), None), t.word("E_unit", ("Pa", "kPa", "MPa"), None))
    found: dict[str, Any] = {"E": t.positive("E", "pressure"), "nu": t.number("nu")}
    mesh = t.text("mesh", None)
    shape = t.word("shape", SHAPES, None)
    if shape == "dome":
        lengths = [t.positive(name, "displacement") for name in ("radius", "height", "plinth")]
        with t.named():
            found["curvature"], found["outline"] = outline.cap(*lengths)
        found |= {"size": (2 * lengths[0], 2 * lengths[0]), "thickness": lengths[1], "rim": t.word("rim", RIMS, None)}
    elif mesh is None:
        found |= {"size": t.quantities("size", "displacement", 2), "thickness": t.positive("thickness", "displacement")}
        found["elements"] = t.counts("elements", 2, None)
        found["outline"] = _outline(t)
        found |= {"curvature": t.positive("curvature", "displacement", None), "rim": t.word("rim", RIMS, None)}
    else:
        found |= {"mesh": t.beside(mesh), "unit": t.text("mesh_unit", None)}
        found |= {name: t.text(name, None) for name in ("axis", "base", "top")}
    found |= {
        "pitch": t.positive("pitch", "displacement", None),
        "layers": t.count("layers", None),
        "element": t.word("element", ELEMENTS, None),
        "density": t.number("density", None),
        "material": t.text("material", None),
        "allow": t.words("allow", None),
    }
    _counted(t, found["layers"] or 1)
    t.end()
    return {name: value for name, value in found.items() if value is not None}


def _counted(t: TomlTable, layers: int) -> None:
    """Counts of a mesh that somebody published: held against Euler's formula, never built from."""
    cells, nodes = t.count("cells", None), t.count("nodes", None)
    if cells is None and nodes is None:
        return
    if cells is None or nodes is None:
        raise t.refused("cells" if cells is None else "nodes", "counts belong together", "one", "cells and nodes")
    counts(cells, nodes, layers=layers, where=f"{t.file}: [pad]")


def _outline(t: TomlTable) -> Any:
    radius, corners = t.quantity("rounded", "displacement", None), t.places("polygon", "displacement", None)
    if radius is not None and corners is not None:
        raise t.refused("polygon", "two outlines of one pad", "rounded and polygon", "one of them")
    if radius is not None:
        return outline.rounded(radius)
    return None if corners is None else outline.polygon(corners)


def _view(t: TomlTable) -> View:
    """The camera: a lens, a matrix, or points and their pixels."""
    ways = [name for name in ("focal", "homography", "points") if name in t]
    if len(ways) != 1:
        raise t.refused("", "the camera is not stated", " and ".join(ways) or "none of the ways",
                        "focal (a lens), homography (a matrix), or points with their pixels")  # fmt: skip
    with t.named():
        if "focal" in t:
            view = View.camera(
                focal=t.pixels("focal"),
                centre=t.pixel_pair("centre"),
                distance=t.positive("distance", "displacement"),
                depth=t.quantity("depth", "displacement", 0.0),
                gamma=t.number("gamma", 1.0),
                **{name: t.quantity(name, "angle", 0.0) for name in ("tilt", "azimuth", "roll")},
            )
        elif "homography" in t:
            view = View.homography(t.matrix("homography"), unit=t.scale("homography_unit"), **_rays(t))
        else:
            view = View.fit(t.places("points", "displacement"), t.places("pixels", "px"), **_rays(t))
    t.end()
    return view


def _rays(t: TomlTable) -> dict[str, Any]:
    """Directions of the rays beside a homography, as far as the file states them."""
    found = {name: t.quantity(name, "angle", None) for name in ("alpha", "azimuth")}
    found |= {"gamma": t.number("gamma", None), "window": _lens(t)}
    return {name: value for name, value in found.items() if value is not None}


def _lens(t: TomlTable) -> Any:
    lens = t.table("lens")
    if lens is None:
        return None
    with lens.named():
        found = Window(
            lens.quantities("at", "displacement", 2),
            lens.quantity("distance", "displacement"),
            lens.quantity("depth", "displacement"),
            lens.number("gamma", 1.0),
        )
    lens.end()
    return found


def _tracking(t: TomlTable) -> dict[str, Any]:
    found = {
        "radius": t.pixels("radius", None),
        "pitch": t.pixels("pitch", None),
        "dark": t.flag("dark", None),
        "method": t.word("method", METHODS, None),
        "threshold": t.number("threshold", None),
        "margin": t.pixels("margin", None),
        "gate": t.number("gate", None),
    }
    return {name: value for name, value in found.items() if value is not None}


def _lam(t: TomlTable) -> float | str | None:
    """A relative lambda, or the rule that chooses it."""
    if not isinstance(t.values.get("lam"), str):
        found: float | None = t.number("lam", None)
        return found
    rule: str = t.word("lam", tuple(RULES))
    return rule


def _depth(t: TomlTable) -> DepthKind:
    sign = {"negative": 1.0, "positive": -1.0}[t.word("pressed", ("negative", "positive"), "negative")]
    found = DepthKind(
        pixel=t.positive("pixel", "displacement"),
        noise=t.positive("noise", "displacement"),
        centre=t.quantities("centre", "displacement", 2, (0.0, 0.0)),
        factor=sign * t.scale("unit", 1.0),
        absolute=t.flag("absolute", False),
    )
    t.end()
    return found


def _tolerances(t: TomlTable) -> Tolerances:
    with t.named():
        found = Tolerances(*(t.number(name, 0.0) for name in ("E", "nu", "thickness")))
    t.end()
    return found


def _contact(t: TomlTable) -> dict[str, Any]:
    found = {
        "no_pull": t.flag("no_pull", None),
        "friction": t.number("friction", None),
        "lam": _lam(t),
        "penalty": t.word("penalty", PENALTIES, None),
    }
    t.end()
    return {name: value for name, value in found.items() if value is not None}
