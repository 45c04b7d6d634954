"""What a network sees of readings, and what its numbers mean: maps on grids, histories, or numbers in no order.

A load twice as large moves every marker twice as far. So what goes into the network of static readings is divided by
the size of the readings, and what comes out is multiplied by it; the size itself, over the noise, goes in beside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from . import architectures
from .graph import Graph

Array = NDArray[Any]
MOST = 64  # numbers that the readings are condensed to
BLUNT = 0.1  # ridge of the blunt view of a map, over the largest singular value
HALVED = 2 ** (len(architectures.WIDTHS) - 1)  # sides of a grid are multiples of it
TINY = 1e-30


class Form(Protocol):
    """What goes in and what comes out of one kind of network."""

    kind: ClassVar[str]

    def inputs(self, data: Array, mean: Array) -> tuple[Array, Array]:
        """Values (n, channels, ...) of whitened data and of the linear estimate, and the size of each example."""

    def targets(self, rest: Array, size: Array) -> Array:
        """Values (n, outputs, ...) that what the linear estimate lacks is in the units of the network."""

    def told(self, out: Array, size: Array) -> tuple[Array, Array]:
        """Correction and std in SI of what came out; inverse of `targets`."""

    def graph(self) -> Graph:
        """The network without weights."""

    def arrays(self) -> dict[str, Any]:
        """What a file keeps."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Nodes on a rectangular grid: which node is at each row and column, and how many loads each has."""

    order: Array
    components: int

    @classmethod
    def of(cls, places: Array, components: int) -> Self | None:
        """The grid of places (P, 2 or 3); None where they are on none."""
        xy = np.asarray(places, float)[:, :2]
        step = 1e-6 * max(float(np.ptp(xy, axis=0).max()), TINY)
        (x, column), (y, row) = (np.unique(np.round(c / step), return_inverse=True) for c in xy.T)
        if len(x) * len(y) != len(xy) or min(len(x), len(y)) < 2 * HALVED:
            return None
        order = np.full((len(y), len(x)), -1)
        order[row, column] = np.arange(len(xy))
        return cls(order, components) if (order >= 0).all() else None

    @cached_property
    def padded(self) -> tuple[int, int]:
        """Rows and columns, filled up for a network that halves them."""
        rows, columns = (int(HALVED * -(-side // HALVED)) for side in self.order.shape)
        return rows, columns

    def image(self, flat: Array) -> Array:
        """Values (n, P components) as (n, components, rows, columns), zero where the grid is filled up."""
        rows, columns = self.order.shape
        out = np.zeros((len(flat), self.components, *self.padded), np.float32)
        out[:, :, :rows, :columns] = flat.reshape(len(flat), -1, self.components)[:, self.order].transpose(0, 3, 1, 2)
        return out

    def flat(self, image: Array) -> Array:
        """Inverse of `image`."""
        rows, columns = self.order.shape
        out = np.empty((len(image), self.order.size, self.components))
        out[:, self.order] = image[:, :, :rows, :columns].transpose(0, 2, 3, 1)
        return out.reshape(len(image), -1)


@dataclass(frozen=True, eq=False)
class Maps:
    """Loads on a grid: the linear estimate and a blunter one go in as images, a U-shaped network corrects the first.

    `blunt` (sensors, loads) makes the blunter estimate of whitened data; `unit` (3, components) are typical sizes of
    both estimates and of what the first lacks, over the size of the readings.
    """

    grid: Grid
    blunt: Array
    unit: Array
    kind: ClassVar[str] = "maps"

    @classmethod
    def of(cls, grid: Grid, data: Array, mean: Array, truth: Array) -> Self:
        """The form of examples: whitened data (n, sensors), linear estimates and outputs (n, loads)."""
        blunt = ridge(data, truth, BLUNT)
        size = _size(data)[:, None]
        parts = (mean, data @ blunt, truth - mean)
        return cls(grid, blunt, np.array([_each(part / size, grid.components) for part in parts]))

    def inputs(self, data: Array, mean: Array) -> tuple[Array, Array]:
        """Both estimates over their units, and the size of the readings."""
        size = _size(data)
        sharp, blunt = (
            self.grid.image(part / size[:, None]) / unit[:, None, None]
            for part, unit in zip((mean, data @ self.blunt), self.unit[:2].astype(np.float32), strict=True)
        )
        rows, columns = self.grid.order.shape
        strength = np.zeros((len(data), 2, *self.grid.padded), np.float32)
        strength[:, 0, :rows, :columns] = np.log(size)[:, None, None]
        strength[:, 1, :rows, :columns] = 1.0  # where the grid is
        return np.concatenate([sharp, blunt, strength], axis=1), size

    def targets(self, rest: Array, size: Array) -> Array:
        """What the linear estimate lacks, as images."""
        return np.asarray(self.grid.image(rest / size[:, None]) / self.unit[2].astype(np.float32)[:, None, None])

    def sums(self, rows: Array) -> Array:
        """Sums ``rows (k, loads) @ loads`` as images (k, components, rows, columns) over targets of the network."""
        return np.asarray(self.grid.image(rows) * self.unit[2].astype(np.float32)[:, None, None])

    def told(self, out: Array, size: Array) -> tuple[Array, Array]:
        """Correction and std of what came out."""
        k = self.grid.components
        unit = self.unit[2][:, None, None]
        mean, std = self.grid.flat(out[:, :k] * unit), self.grid.flat(np.exp(out[:, k:]) * unit)
        return size[:, None] * mean, size[:, None] * std

    def graph(self) -> Graph:
        """A U-shaped network."""
        k = self.grid.components
        return architectures.unet(2 * k + 2, 2 * k)

    def mirrors(self, x: Any, y: Any, dice: Any) -> tuple[Any, Any]:
        """Images of vectors turned over, along x and along y: as true on a body that is the same either way."""
        import torch

        k = self.grid.components
        for axis, back in ((0, 3), (1, 2)):
            if torch.rand(1, generator=dice).item() < 0.5:
                rows, columns = self.grid.order.shape
                side = columns if back == 3 else rows
                index = torch.arange(x.shape[back])
                index[:side] = index[:side].flip(0)
                x, y = x.index_select(back, index).clone(), y.index_select(back, index).clone()
                for values, at in ((x, axis), (x, k + axis), (y, axis)):
                    values[:, at] *= -1
        return x, y

    def arrays(self) -> dict[str, Any]:
        """What a file keeps."""
        return {"order": self.grid.order, "components": self.grid.components, "blunt": self.blunt, "unit": self.unit}

    @classmethod
    def from_arrays(cls, tree: Mapping[str, Any]) -> Self:
        """Inverse of `arrays`."""
        return cls(Grid(np.asarray(tree["order"]), int(tree["components"])), tree["blunt"], tree["unit"])


@dataclass(frozen=True, eq=False)
class Numbers:
    """Loads or resultants in no order: condensed readings and the linear estimate go in, a residual network corrects.

    `basis` (sensors, k) condenses whitened data; `unit` (outputs, 2) are typical sizes of the linear estimate and of
    what it lacks, over the size of the readings.
    """

    basis: Array
    unit: Array
    kind: ClassVar[str] = "numbers"

    @classmethod
    def of(cls, data: Array, mean: Array, truth: Array) -> Self:
        """The form of examples: whitened data (n, sensors), linear estimates and outputs (n, outputs)."""
        size = _size(data)[:, None]
        _, _, Vt = np.linalg.svd(data / size, full_matrices=False)
        basis = Vt[:MOST].T
        spread = np.sqrt(np.mean((data / size @ basis) ** 2, axis=0))
        unit = np.stack([_rms(mean / size), _rms((truth - mean) / size)], axis=1)
        return cls(basis / np.maximum(spread, 1e-3 * spread.max(initial=TINY)), unit)

    def inputs(self, data: Array, mean: Array) -> tuple[Array, Array]:
        """Condensed readings, the linear estimate, and the size of the readings."""
        size = _size(data)
        parts = [data / size[:, None] @ self.basis, mean / size[:, None] / self.unit[:, 0], np.log(size)[:, None]]
        return np.concatenate(parts, axis=1).astype(np.float32), size

    def targets(self, rest: Array, size: Array) -> Array:
        """What the linear estimate lacks."""
        return np.asarray(rest / size[:, None] / self.unit[:, 1])

    def told(self, out: Array, size: Array) -> tuple[Array, Array]:
        """Correction and std of what came out."""
        count = len(self.unit)
        scale = size[:, None] * self.unit[:, 1]
        return out[:, :count] * scale, np.exp(out[:, count:].astype(float)) * scale

    def graph(self) -> Graph:
        """A residual network."""
        return architectures.residual(self.basis.shape[1] + len(self.unit) + 1, 2 * len(self.unit))

    def arrays(self) -> dict[str, Any]:
        """What a file keeps."""
        return {"basis": self.basis, "unit": self.unit}

    @classmethod
    def from_arrays(cls, tree: Mapping[str, Any]) -> Self:
        """Inverse of `arrays`."""
        return cls(tree["basis"], tree["unit"])


@dataclass(frozen=True, eq=False)
class Histories:
    """Histories: readings and the linear estimate go in sample by sample, a temporal convolution corrects.

    `seen` (sensors + outputs,) and `unit` (outputs,) are the sizes of what goes in and of what the estimate lacks.
    """

    seen: Array
    unit: Array
    kind: ClassVar[str] = "histories"

    @classmethod
    def of(cls, data: Array, mean: Array, truth: Array) -> Self:
        """The form of examples: whitened data (n, samples, sensors), linear estimates and outputs."""
        both = np.concatenate([data, mean], axis=2)
        return cls(_rms(both.reshape(-1, both.shape[2])), _rms((truth - mean).reshape(-1, truth.shape[2])))

    def inputs(self, data: Array, mean: Array) -> tuple[Array, Array]:
        """Readings and the linear estimate over their sizes."""
        both = np.concatenate([data, mean], axis=2) / self.seen
        return both.transpose(0, 2, 1).astype(np.float32), np.ones(len(data))

    def targets(self, rest: Array, size: Array) -> Array:
        """What the linear estimate lacks."""
        return np.asarray((rest / self.unit).transpose(0, 2, 1))

    def told(self, out: Array, size: Array) -> tuple[Array, Array]:
        """Correction and std of what came out."""
        count, back = len(self.unit), out.transpose(0, 2, 1).astype(float)
        return back[..., :count] * self.unit, np.exp(back[..., count:]) * self.unit

    def graph(self) -> Graph:
        """A temporal convolution."""
        return architectures.temporal(len(self.seen), 2 * len(self.unit))

    def arrays(self) -> dict[str, Any]:
        """What a file keeps."""
        return {"seen": self.seen, "unit": self.unit}

    @classmethod
    def from_arrays(cls, tree: Mapping[str, Any]) -> Self:
        """Inverse of `arrays`."""
        return cls(tree["seen"], tree["unit"])


FORMS: dict[str, Any] = {form.kind: form for form in (Maps, Numbers, Histories)}


def form_of(tree: Mapping[str, Any]) -> Any:
    """The form that a file has kept.

    Raises
    ------
    InputError
        Of another kind than this release has.
    """
    kind = str(tree.get("kind"))
    if kind not in FORMS:
        raise InputError("a network of another kind", where="map", found=kind, expected=", ".join(FORMS),
                         hint="read it with the release that wrote it")  # fmt: skip
    return FORMS[kind].from_arrays(tree)


def ridge(data: Array, truth: Array, share: float) -> Array:
    """Linear map (sensors, outputs) of examples, without an offset, at a ridge over the largest singular value."""
    U, s, Vt = np.linalg.svd(data, full_matrices=False)
    return np.asarray(Vt.T @ ((s / (s**2 + (share * s[0]) ** 2))[:, None] * (U.T @ truth)))


def _size(data: Array) -> Array:
    """Root mean square of whitened data (n, sensors), not below that of noise."""
    return np.sqrt(1.0 + np.mean(data**2, axis=1))


def _rms(values: Array) -> Array:
    return np.maximum(np.sqrt(np.mean(values**2, axis=0)), TINY)


def _each(flat: Array, components: int) -> Array:
    """Root mean square of each component of (n, P components)."""
    return _rms(flat.reshape(-1, components))
