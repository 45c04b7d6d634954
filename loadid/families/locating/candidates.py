"""A model under one of its candidate loads, or under a load anywhere between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.arrays import ImpulseModel
from structures.channels import Channel
from structures.dofs import direction_label
from structures.errors import InputError
from structures.loads import Moment, Point
from structures.model import Model
from structures.statespace import StateSpace

from .grid import Grid

Array = NDArray[np.float64]
SAME = 1e-6  # difference of the responses of a candidate and of a load moved to its place that is rounding
FEWEST = 4  # candidates on a line, below which nothing is interpolated; twice as many on a surface


class Candidates:
    """Impulse responses of the candidates and of the places between them.

    Parameters
    ----------
    model : Model
        Its loads are the candidates.
    grid : Grid or None
    dt : float
    samples : int
    hold : str
    """

    def __init__(self, model: Model, grid: Grid | None, dt: float, samples: int, hold: str) -> None:
        self.model, self.grid, self.dt, self.samples, self.hold = model, grid, dt, samples, hold
        self.h = model.impulse_response(dt, samples, hold)
        silent = [c.label for c, level in zip(model.loads, np.abs(self.h).max(axis=(0, 1)), strict=True) if level == 0]
        if silent:
            raise InputError(
                f"{len(silent)} candidates move no sensor", where="LocationSearch", found=", ".join(silent[:8]),
                expected="candidates that the sensors see", hint="drop them, or add sensors",
            )  # fmt: skip

    @cached_property
    def how(self) -> str:
        """How the responses between candidates are found: ``moved``, ``interpolated`` or ``""``."""
        if self.grid is None:
            return ""
        if self._movable():
            return "moved"
        dim = len(self.grid.used)
        return "interpolated" if len(self.h[0, 0]) >= FEWEST * dim and dim <= 2 else ""

    def _movable(self) -> bool:
        """Whether the model can place loads anywhere in the box, and says the same of its candidates there."""
        model, grid = self.model, self.grid
        if grid is None or model.structure is None or model.structure.field is None or not model.gives("with_loads"):
            return False
        kinds = {(type(c), _direction(c)) for c in model.loads}
        if len(kinds) > 1 or not isinstance(model.loads[0], Point | Moment):
            return False
        try:
            low, high = grid.bounds
            corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(len(low), -1).T
            self._moved(corners)
            own = self._moved(grid.places[:1, grid.used])
        except InputError:  # a box that is not on the structure, or a structure without places between its nodes
            return False
        return bool(np.abs(own[..., 0] - self.h[..., 0]).max() <= SAME * np.abs(self.h[..., 0]).max())

    def responses(self, places: Array) -> Array:
        """Impulse responses (samples, sensors, n) of loads at places (n, used coordinates)."""
        if self.how == "moved":
            return self._moved(places)
        return np.einsum("ksc,nc->ksn", self.h, self._weights(places))

    def at(self, places: Array) -> Model:
        """The model under loads at places (n, used coordinates)."""
        if self.how == "moved":
            return self.model.with_loads(self._loads(places))
        first = self.model.loads[0]
        channels = [Channel(label=f"load at {_words(p)}", quantity=first.quantity, unit=first.unit) for p in places]
        if (own := self._discrete) is not None:
            mix = self._weights(places).T
            return _columns(own, own.B @ mix, own.D @ mix, channels)
        return self._impulses(self.responses(places), channels)

    def chosen(self, indices: Sequence[int]) -> Model:
        """The model under some of its candidates."""
        picked = [self.model.loads[j] for j in indices]
        if self.model.gives("with_loads") and self.model.basis is None:
            return self.model.with_loads(picked)
        if (own := self._discrete) is not None:
            columns = list(indices)
            return _columns(own, own.B[:, columns], own.D[:, columns], picked)
        return self._impulses(self.h[..., list(indices)], picked)

    @cached_property
    def _discrete(self) -> StateSpace | None:
        """The model, where it exists as a state space at its own step only."""
        model = self.model
        return None if model.dt is None or not model.gives("state_space") else model.state_space(self.dt, self.hold)

    # -- inside -------------------------------------------------------------------------------------------------------
    def _impulses(self, h: Array, loads: Sequence[Any]) -> ImpulseModel:
        plain = [Channel(label=c.label, quantity=c.quantity, unit=c.unit) for c in loads]
        model = ImpulseModel(h, self.dt, kind="held", hold=self.hold, sensors=self.model.sensors, loads=plain)
        model.certificate = self.model.certificate
        return model

    def _loads(self, places: Array) -> list[Any]:
        assert self.grid is not None
        first, direction = self.model.loads[0], _direction(self.model.loads[0])
        made = []
        for p in self.grid.full(places):
            at = float(p[0]) if len(p) == 1 else tuple(float(v) for v in p)
            made.append(replace(first, dof=None, at=at, direction=direction, label=f"load at {_words(p)}"))  # type: ignore[call-arg]
        if len({c.label for c in made}) < len(made):
            made = [replace(c, label=f"{c.label} #{i}") for i, c in enumerate(made)]
        return made

    def _moved(self, places: Array) -> Array:
        return self.model.with_loads(self._loads(places)).impulse_response(self.dt, self.samples, self.hold)

    def _weights(self, places: Array) -> Array:
        """Weights (n, candidates) of a radial basis interpolation over the candidates."""
        from scipy.interpolate import RBFInterpolator

        assert self.grid is not None
        x, scale = self.grid.places[:, self.grid.used], self.grid.spacing
        kernel = "cubic" if x.shape[1] == 1 else "thin_plate_spline"
        return np.asarray(RBFInterpolator(x / scale, np.eye(len(x)), kernel=kernel)(places / scale))


def _columns(model: StateSpace, B: Array, D: Array, loads: Sequence[Channel]) -> StateSpace:
    """A state space under other loads."""
    one = StateSpace(model.A, B, model.C, D, model.dt, model.hold, sensors=model.sensors, loads=loads)
    one.certificate = model.certificate
    return one


def _direction(load: Channel) -> str:
    dof = getattr(load, "dof", None)
    return direction_label(dof.direction) if dof is not None else str(getattr(load, "direction", ""))


def _words(place: Array) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in place) + ") m"
