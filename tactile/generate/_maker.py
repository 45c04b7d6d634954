"""Presses drawn one by one: a gel, bodies, how they are pressed, and what the sensor reads of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from loadid.generate import Drawn
from loadid.generate._ranges import halton
from structures.errors import InputError, digest

from .._arrays import Array
from .._closed import shapes
from .._closed.layer import Layer
from .._pad.pad import Pad
from .._sensors.linear import LinearSensor
from ._declared import SIZES, TURNED, IndenterRange, PressDeclaration
from ._readings import Taken, measured, noisy, photographed, seen
from ._truth import CELLS, Edged, Ground, Move, spread_over

GELS = 16  # pairs of Poisson's ratio and thickness that are drawn from, evenly over their ranges
PADS = 6  # of them where pads move instead of the layer: each keeps its factor
DIGITS = 10  # of lengths in m that count for who a sensor is


class PressMaker:
    """Draws presses on the gel of a sensor.

    Parameters
    ----------
    sensor : MultilayerPad or GelForce
        On a flat rectangular pad, or on a layer.
    declared : PressDeclaration
    truth : sequence of Pad
        That move instead of the layer, one of them for each press; empty: the layer. Where nu or thickness are drawn,
        pads of their mesh with these.

    Raises
    ------
    InputError
        A sensor of another kind or shape; places beside the pad; images of a sensor without an eye; pads of another
        size.
    """

    def __init__(self, sensor: LinearSensor, declared: PressDeclaration, truth: Sequence[Pad] = ()) -> None:
        if not isinstance(sensor, LinearSensor):
            raise InputError("presses are drawn for a linear sensor", where="presses, sensor",
                             found=type(sensor).__name__, expected="MultilayerPad or GelForce")  # fmt: skip
        self.truth = tuple(truth)
        self.markers, self.eye, self.depth = sensor.markers, sensor.eye, sensor.depth
        body, self.name = sensor.pressed_body.body, sensor.name
        self.layer, self.size = _of(body, np.asarray(sensor.geometry["coordinates"]))
        gel = declared.gel.known_to(sensor.pressed_body.tolerances, self.layer.nu)
        self.declared = replace(declared, gel=gel)
        for pad in self.truth:
            _of(pad, None)
            if not np.allclose(pad.size, self.size, rtol=1e-6):
                raise InputError("a pad of another size", where="presses, truth", found=str(pad.size),
                                 expected=str(self.size))  # fmt: skip
        self.inverse, self.markers_at = sensor.model.described, sensor.markers.points[:, :2]
        self.sensors = (*self.markers.channels, *([] if self.depth is None else self.depth.channels))
        self.loads = tuple(sensor.loads)
        self._ranges(self.declared)
        ground = self._new_ground(self.layer)
        self._spread = spread_over(body, ground) if isinstance(body, Pad) else _on_grid(sensor.geometry, ground)
        hats = sensor.geometry["kind"] == "hats"
        self.places = np.asarray(sensor.geometry["coordinates"])
        self._areas = np.asarray(sensor.geometry["measures"]) if hats else np.ones(len(sensor.geometry["measures"]))
        self._grounds: dict[int, Ground] = {}
        self._edged: dict[int, Edged] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_grounds": {}, "_edged": {}}

    # -- who it is ----------------------------------------------------------------------------------------------------
    dt: float | None = None
    samples: int | None = None

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds that may be drawn; several bodies are one kind."""
        names = dict.fromkeys(one.kind for one in self.declared.indenter)
        return (*names, "several") if self.declared.contact.several else tuple(names)

    @property
    def declaration(self) -> dict[str, Any]:
        """What was declared, as plain data."""
        return {"presses": self.declared.plain}

    @property
    def models(self) -> tuple[str, ...]:
        """Who the sensor and its truth are."""
        places = np.round(self.markers.points, DIGITS) + 0.0
        slope = self.markers.slope
        told = [self.name, self.markers.axes, f"{self.layer.h:.9g} {self.layer.E:.9g} {self.layer.nu:.9g}",
                f"{self.size[0]:.9g} {self.size[1]:.9g}", len(self.loads), self.eye is not None,
                np.round(self.markers.noise, 13), None if slope is None else np.round(slope, 6) + 0.0]  # fmt: skip
        if self.depth is not None:
            told += [np.round(self.depth.points, DIGITS) + 0.0, f"{self.depth.noise:.9g}"]
        return (digest("sensor", places, *told), *(digest("truth", repr(pad)) for pad in self.truth))

    # -- one draw -----------------------------------------------------------------------------------------------------
    def draw(self, rng: np.random.Generator) -> Drawn:
        """One press.

        Raises
        ------
        NotIdentifiable
            It touches more than the pad, or its contact is not found.
        """
        return self._drawn(rng)[0]

    def picture(self, rng: np.random.Generator) -> Taken:
        """The image of the press that `draw` makes with these numbers.

        Raises
        ------
        InputError
            The sensor has no eye.
        """
        taken = self._drawn(rng)[1]
        if taken is None:
            raise InputError("there are no images", where="picture", found="a sensor without an eye",
                             expected="eye=")  # fmt: skip
        return taken

    def _drawn(self, rng: np.random.Generator) -> tuple[Drawn, Taken | None]:
        d = self.declared
        weights = np.array([one.weight for one in d.indenter], float)
        chosen = d.indenter[int(rng.choice(len(weights), p=weights / weights.sum()))]
        number = int(rng.integers(self._gels))
        ground, stiffness = self._ground(number), d.gel.draw(rng, "E")
        bodies = int(rng.integers(2, d.contact.bodies + 1)) if rng.random() < d.contact.several else 1
        move, told = self._move(chosen, rng, stiffness)
        heights = self._heights(chosen, move.at, bodies, rng)
        acting = ground.press(heights, move)
        forces = acting.tractions * stiffness * ground.grid.pitch**2
        nodal = self._spread @ forces.reshape(-1, 3)
        motion, deep = self._motion(number, ground, acting.tractions)
        data, noise, taken, camera = self._read(motion, deep, rng)
        total = forces.sum(axis=(0, 1))
        told |= {
            "depth": acting.depth, "E": ground.layer.E * stiffness, "nu": ground.layer.nu, "thickness": ground.layer.h,
            "bodies": float(bodies), "contact_area": float(np.sum(acting.tractions[..., 2] < 0)) * ground.grid.pitch**2,
            **dict(zip(("Fx", "Fy", "Fz"), map(float, total), strict=True)),
            **dict(zip(("shift_x", "shift_y", "turn", "scale"), map(float, camera), strict=True)),
        }  # fmt: skip
        loads = (nodal / self._areas[:, None]).ravel()
        return Drawn(data, loads, chosen.kind if bodies == 1 else "several", noise, told), taken

    def _move(self, chosen: IndenterRange, rng: np.random.Generator, stiffness: float) -> tuple[Move, dict[str, float]]:
        contact = self.declared.contact
        x, y = (float(rng.uniform(*self._places[k])) for k in range(2))
        owner: Any = contact if chosen.depth is None and chosen.force is None else chosen
        value = owner.draw(rng, "depth" if owner.depth is not None else "force")
        depth, force = (value, None) if owner.depth is not None else (None, value / stiffness)
        length, towards = contact.draw(rng, "shear"), float(rng.uniform(0, 2 * np.pi))
        shift = length * np.cos(towards), length * np.sin(towards)
        turn, friction = contact.draw(rng, "twist"), contact.draw(rng, "friction")
        told = {"x": x, "y": y, "shear_x": shift[0], "shear_y": shift[1], "twist": turn, "friction": friction}
        return Move((x, y), depth, force, (float(shift[0]), float(shift[1])), turn, friction), told

    def _heights(self, chosen: IndenterRange, at: tuple[float, float], bodies: int, rng: np.random.Generator) -> Any:
        """Heights of one body, or of several on one holder around the place."""
        if bodies == 1:
            return _shape(chosen, at, rng)
        apart, start = self.declared.contact.draw(rng, "apart"), float(rng.uniform(0, 2 * np.pi))
        radius = apart / (2 * np.sin(np.pi / bodies))
        angles = start + 2 * np.pi * np.arange(bodies) / bodies
        each = [_shape(chosen, (at[0] + radius * np.cos(a), at[1] + radius * np.sin(a)), rng) for a in angles]
        return partial(_lowest, each)

    def _motion(self, number: int, ground: Ground, tractions: Array) -> tuple[Array, Array | None]:
        """Motion of the markers (N, 3), and of the points in the windows of a depth map."""
        if self.truth:
            moved = self._pad(number, ground).motion(tractions * ground.grid.pitch**2)
            return moved[0], moved[1] if self.depth is not None else None
        points = self._points(ground)
        z = points[:, 2] if points.shape[1] == 3 else None
        deep = None if self.depth is None else ground.motion(tractions, self.depth.samples, None)
        return ground.motion(tractions, points[:, :2], z), deep

    def _read(
        self, motion: Array, deep: Array | None, rng: np.random.Generator
    ) -> tuple[Array, Array, Taken | None, Array]:
        taken, camera = None, np.array([0.0, 0.0, 0.0, 1.0])
        d = self.declared
        if self.eye is None:
            data, noise = noisy(self.markers, motion, d.markers, rng)
        else:
            places = self.markers.points[:, :2]
            taken = photographed(self.eye, places, motion, d.camera, d.image, d.markers, rng)
            data, noise = seen(self.eye, taken, places).ravel(), self.markers.noise.ravel()
            camera = taken.drawn
        if self.depth is not None and deep is not None:
            more, std = measured(self.depth, deep, rng)
            data, noise = np.concatenate([data, more]), np.concatenate([noise, std])
        return data, noise, taken, camera

    # -- gels ---------------------------------------------------------------------------------------------------------
    @property
    def _drawn_gels(self) -> bool:
        """Whether nu or thickness are declared, and not those of the sensor or of the pads of the truth."""
        return self.declared.gel.nu is not None or self.declared.gel.thickness != (1.0, 1.0)

    @property
    def _gels(self) -> int:
        gel, pads = self.declared.gel, len(self.truth)
        if any(r is not None and r[0] < r[1] for r in (gel.nu, gel.thickness)):
            return max(PADS, pads) if pads else GELS
        return max(pads, 1)

    def _ground(self, number: int) -> Ground:
        """The ground of a number: of one of the gels; kept."""
        if number not in self._grounds:
            self._grounds[number] = self._new_ground(self._gel(number))
        return self._grounds[number]

    def _gel(self, number: int) -> Layer:
        """The layer of a sensor or of a pad; where they are declared, nu and thickness fill their ranges (Halton)."""
        own, gel = self.truth[number % len(self.truth)].layer if self.truth else self.layer, self.declared.gel
        if not self._drawn_gels:
            return own
        nu, thick = gel.nu or (own.nu,) * 2, gel.thickness or (1.0, 1.0)
        share = halton(number + 1, 2), halton(number + 1, 3)
        return Layer(self.layer.h * (thick[0] + share[1] * (thick[1] - thick[0])), own.E,
                     nu[0] + share[0] * (nu[1] - nu[0]))  # fmt: skip

    def _new_ground(self, layer: Layer) -> Ground:
        points = [np.abs(self.markers.points[:, :2]).max()]
        points += [] if self.depth is None else [np.abs(self.depth.samples).max()]
        return Ground(layer, self.size, float(max(points)), self.layer.h / CELLS)

    def _pad(self, number: int, ground: Ground) -> Edged:
        if number not in self._edged:
            points = [self._points(ground)] + ([] if self.depth is None else [self.depth.samples])
            pad = self.truth[number % len(self.truth)]
            if self._drawn_gels:
                pad = replace(pad, nu=ground.layer.nu, thickness=ground.layer.h)
            self._edged[number] = Edged(pad, ground, points)
        return self._edged[number]

    def _points(self, ground: Ground) -> Array:
        """Places of the markers (N, 2 or 3), in a gel that may be thicker than that of the sensor."""
        points = self.markers.points
        return points if points.shape[1] == 2 else points * [1.0, 1.0, ground.layer.h / self.layer.h]

    def _ranges(self, declared: PressDeclaration) -> None:
        """Places of contacts, within the pad."""
        inner = [side / 2 - self.layer.h for side in self.size]
        places = []
        for name, side, most in zip("xy", self.size, inner, strict=True):
            given = getattr(declared.contact, name) or (-max(most, 0.0), max(most, 0.0))
            if max(map(abs, given)) > side / 2:
                raise InputError("places beside the pad", where=f"presses, {name}",
                                 found=f"{given[0]:g} to {given[1]:g} m",
                                 expected=f"within {side / 2:g} m of the middle")  # fmt: skip
            places.append(given)
        self._places = places


def _shape(chosen: IndenterRange, at: tuple[float, float], rng: np.random.Generator) -> Any:
    """Heights of one body."""
    size = {name: chosen.draw(rng, name) for name in SIZES[chosen.kind]}
    angle = float(rng.uniform(0, np.pi)) if chosen.kind in TURNED else 0.0
    where = float(at[0]), float(at[1])
    if chosen.kind == "bar":
        return partial(shapes.bar, sides=(size["length"], size["width"]), at=where, angle=angle)
    if chosen.kind == "polygon":
        count = round(size["corners"])
        turns = angle + 2 * np.pi * (np.arange(count) + 0.6 * (rng.random(count) - 0.5)) / count
        corners = size["radius"] * np.column_stack([np.cos(turns), np.sin(turns)]) + where
        return partial(shapes.polygon, corners=[(float(a), float(b)) for a, b in corners])
    more = {"angle": angle} if chosen.kind in TURNED else {}
    return partial(getattr(shapes, chosen.kind), **size, at=where, **more)


def _lowest(bodies: Sequence[Any], points: Array) -> Array:
    return np.asarray(np.minimum.reduce([one(points) for one in bodies]))


def _of(body: Any, places: Array | None) -> tuple[Layer, tuple[float, float]]:
    """The layer of a flat pad, or of a closed form under places of loads, and its sides."""
    if isinstance(body, Pad):
        if body.mesh is not None or body.curvature is not None or body.outline is not None:
            raise InputError("presses are drawn on flat rectangular pads", where="presses", found=repr(body),
                             expected="a pad of size, thickness and pitch")  # fmt: skip
        return body.layer, (float(body.size[0]), float(body.size[1]))
    if isinstance(body, Layer) and places is not None:
        a, b = 2 * np.abs(places[:, :2]).max(axis=0)
        return body, (float(a), float(b))
    raise InputError("presses need a gel of some thickness", where="presses", found=type(body).__name__,
                     expected="a pad or a layer", hint="GelForce(Layer(...), ...)")  # fmt: skip


def _on_grid(geometry: Any, ground: Ground) -> Any:
    """Forces at places on a regular grid (P, nodes of the ground) of unit forces there, bilinear, sparse."""
    from scipy import sparse

    places = np.round(np.asarray(geometry["coordinates"])[:, :2], 9)
    x, y = np.unique(places[:, 0]), np.unique(places[:, 1])
    order = np.lexsort((places[:, 0], places[:, 1]))
    if len(x) < 2 or len(y) < 2 or len(x) * len(y) != len(places):
        raise InputError("the forces of this sensor lie on no regular grid", where="presses",
                         found=f"{len(places)} places", expected="rows and columns")  # fmt: skip
    nodes = ground.grid.nodes.reshape(-1, 2)
    inside = np.flatnonzero(ground.inside.ravel())
    rows, columns, values = [], [], []
    cell = [np.clip(np.searchsorted(line, nodes[inside, k], side="right") - 1, 0, len(line) - 2)
            for k, line in enumerate((x, y))]  # fmt: skip
    share = [(nodes[inside, k] - line[c]) / (line[c + 1] - line[c]) for k, (line, c) in
             enumerate(zip((x, y), cell, strict=True))]  # fmt: skip
    for i in (0, 1):
        for j in (0, 1):
            rows.append(order[(cell[1] + j) * len(x) + cell[0] + i])
            columns.append(inside)
            values.append((share[0] if i else 1 - share[0]) * (share[1] if j else 1 - share[1]))
    found = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return sparse.csr_array(found, shape=(len(places), len(nodes)))
