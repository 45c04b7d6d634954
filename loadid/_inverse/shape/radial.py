"""Gaussian radial basis functions on a rectangle, held by its edges, with derivatives in closed form.

``exp(-e^2 r^2)`` is a product of one function of x and one of y, whose derivatives are Hermite polynomials times
itself. One shape parameter e alone expects a load in one octave of wavelengths: the fourth derivative of a Gaussian has
none that are long. Functions of every octave, from the plate down to 1 / e, with weights ``e_k^-4`` times the root of
the area that each stands for, make deflections whose load has a power that falls by the fourth power of its wavenumber
down to 1 / e, as that of a thin-plate spline does (the penalty of its second derivatives), and faster beyond. With
``e_k^-2`` the power is even down to 1 / e: a cliff that smooth loads do not have, and bands that are too narrow. Their
coefficients, independent and of unit variance, are what a ridge holds small.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from structures._readonly import ReadOnly

from .edged import EdgedLoads

Array = NDArray[np.float64]
FALL = 4  # of the weights: -2 of a deflection whose load is even, -2 of one whose second derivatives are
ROUGH = 2  # the former: a load as strong at every wavelength down to 1 / e
WIDEST = 0.35  # smallest shape parameter, times the longer side
OCTAVE = np.sqrt(2)  # from one shape parameter to the next
SPACING = 0.55  # of the centres, times the shape parameter
MARGIN = 0.8  # of the centres beyond the edges, over the shape parameter
RIM = 33  # points on an edge at which it is held
HELD = 1e-10  # of the deflection that the functions expect without edges: what an edge may move


def gaussian(x: Array, centres: Array, shape: float, order: int = 0) -> Array:
    """Derivative of `order` of ``exp(-shape^2 (x - centre)^2)``, (points, centres)."""
    t = shape * (np.asarray(x, float)[:, None] - centres)
    before, now = np.zeros_like(t), np.ones_like(t)
    for n in range(order):  # Hermite polynomials by their recursion
        before, now = now, 2 * t * now - 2 * n * before
    return np.asarray((-shape) ** order * now * np.exp(-t * t))


@dataclass(frozen=True, eq=False)
class _Scale:
    """Functions of one shape parameter."""

    shape: float
    x: Array
    y: Array
    weight: float

    def rows(self, x: Array, y: Array, dx: int, dy: int) -> Array:
        along = gaussian(x, self.x, self.shape, dx), gaussian(y, self.y, self.shape, dy)
        return np.asarray((self.weight * along[1][:, :, None] * along[0][:, None, :]).reshape(len(x), -1))


@dataclass(frozen=True, eq=False)
class RadialBasis(ReadOnly):
    """Radial basis functions of a rectangle. Coordinates are over the longer side, from the first corner.

    Parameters
    ----------
    sides : (a, b)
        Over the longer of them.
    edges : str
        S, C or F for x = 0, y = 0, x = a, y = b, as `plates.plate` has it.
    shape : float
        Largest shape parameter: the reciprocal of the narrowest function's width.
    ends : EdgedLoads, optional
        Pressures that do not vanish at the edges, as large as those of the functions, with their deflections.
    fall : float
        Of the weights: `FALL`, or `ROUGH`.
    """

    sides: tuple[float, float]
    edges: str
    shape: float
    ends: EdgedLoads | None = None
    fall: float = FALL

    @cached_property
    def scales(self) -> tuple[_Scale, ...]:
        """One for each shape parameter, the narrowest functions first."""
        count = 1 + int(np.floor(np.log(self.shape / WIDEST) / np.log(OCTAVE)))
        return tuple(self._scale(self.shape / OCTAVE**k) for k in range(max(count, 1)))

    def _scale(self, shape: float) -> _Scale:
        margin, step = MARGIN / shape, SPACING / shape
        lines, widths = [], []
        for side in self.sides:
            count = int(np.ceil((side + 2 * margin) / step)) + 1
            lines.append(np.linspace(-margin, side + margin, count))
            widths.append((side + 2 * margin) / (count - 1))
        return _Scale(shape, lines[0], lines[1], float(np.sqrt(widths[0] * widths[1]) / shape**self.fall))

    def bare(self, x: Array, y: Array, dx: int = 0, dy: int = 0) -> Array:
        """Rows (points, functions) of a derivative of the functions before the edges hold them."""
        return np.hstack([scale.rows(x, y, dx, dy) for scale in self.scales])

    @cached_property
    def held(self) -> tuple[Array, Array, float]:
        """Directions (functions, k) that the edges hold, the share that they take of each, and a deflection's size.

        Of coefficients c ~ N(0, 1) the edges read ``B c = 0`` to within `HELD`: with ``B = U S V^T`` their covariance
        is ``1 - V (1 - share)^2 V^T``, its root ``1 - V share V^T``, and ``share = 1 - (1 + S^2 / HELD^2)^-1/2``.
        """
        middle = self.bare(*self._inside())
        size = float(np.sqrt(np.mean(np.sum(middle**2, axis=1))))
        B = self._rim()
        if not len(B):
            return np.zeros((middle.shape[1], 0)), np.zeros(0), size
        _, s, V = np.linalg.svd(B / size, full_matrices=False)
        return np.asarray(V.T), 1 - 1 / np.hypot(1.0, s / HELD), size

    def rows(self, x: Array, y: Array, dx: int = 0, dy: int = 0) -> Array:
        """Rows (points, functions) of a derivative of deflections that the edges hold, of size one."""
        rows = self._obeying(self.bare(x, y, dx, dy))
        return rows if self.ends is None else np.hstack([rows, self._pressed * self.ends.rows(x, y, dx, dy)])

    def biharmonic(self, x: Array, y: Array) -> Array:
        """Rows of w_xxxx + 2 w_xxyy + w_yyyy."""
        rows = self._bent(x, y)
        return rows if self.ends is None else np.hstack([rows, self._pressed * self.ends.loads(x, y)])

    def _bent(self, x: Array, y: Array) -> Array:
        return self._obeying(self.bare(x, y, 4, 0) + 2 * self.bare(x, y, 2, 2) + self.bare(x, y, 0, 4))

    def sizes(self, edged: float, steep: float) -> Array:
        """Factors (functions,) of the columns, with pressures at the edges of this size, 0: none, and fall."""
        count = sum(scale.x.size * scale.y.size for scale in self.scales)
        return np.r_[np.ones(count), [] if self.ends is None else edged * self.ends.sizes(steep)]

    @cached_property
    def _pressed(self) -> float:
        """Std of the load that the radial functions expect, away from the edges."""
        return float(np.sqrt(np.mean(np.sum(self._bent(*self._inside()) ** 2, axis=1))))

    def _inside(self) -> tuple[Array, Array]:
        x, y = (np.linspace(0.1, 0.9, 5) * side for side in self.sides)
        return np.tile(x, 5), np.repeat(y, 5)

    def _obeying(self, rows: Array) -> Array:
        V, share, size = self.held
        return np.asarray((rows - (rows @ V * share) @ V.T) / size)

    def _rim(self) -> Array:
        """What the edges hold at zero: w, and across the edge w_nn (S) or w_n (C)."""
        a, b = self.sides
        parts = []
        for kind, (at, along) in zip(self.edges, ((0.0, 1), (0.0, 0), (a, 1), (b, 0)), strict=True):
            if kind == "F":
                continue
            line = np.linspace(0, (a, b)[along], RIM)
            other = np.full(RIM, at)
            x, y = (other, line) if along == 1 else (line, other)
            order = 2 if kind == "S" else 1
            across = (order, 0) if along == 1 else (0, order)
            parts += [self.bare(x, y), self.bare(x, y, *across)]
        return np.vstack(parts) if parts else np.zeros((0, 1))
