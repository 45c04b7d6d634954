"""Loads in discs of a surface, in which shear goes with pressure, and the evidence of readings for them.

Unknown of every disc are the size of its pressure (std) and two ratios of shear to it. Readings over their noise are

    y = A T x + e,   x ~ 1, e ~ 1,   log p(y) = -(y'y - b'T P T'b) / 2 - log|P^-1| / 2,  P = (1 + T'G T)^-1,

with G = A'A and b = A'y, so that evidence costs products of the size of the discs (D. J. C. MacKay, Neural Comput. 4
(1992) 415; C. E. Rasmussen & C. K. I. Williams, Gaussian Processes for Machine Learning, MIT Press 2006, ch. 5). T is
a matrix of 3 x 3 on the modes of each disc. Motion of the image and the error of the mesh are among the unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from .._arrays import Array, Index
from .gaussian import GaussianProblem
from .inversion import Inverse

OWN = 0.1  # of the pressure: std of shear that does not go with it
MODES = 16  # of the pressure in a disc
FEW = 1e-4  # of the strongest variance, below which a mode is none
EVEN = 1.0  # variance of an even pressure in a disc, over that of the prior
STEP = 1 / 6  # thicknesses between the middles of discs
SMALLEST, LARGEST, GROWING = 0.25, 1.5, 1.25  # radii of discs, in thicknesses, and from one to the next
SIZES = np.geomspace(1e2, 1e8, 19)  # Pa, between which sizes are
STEEPEST = 3.0  # ratio
KEPT, PRODUCTS = 100, 1000  # discs, and their products
TURNS = 8  # steps to sizes and ratios


@dataclass(frozen=True)
class Disc:
    """Place and radius in steps of the lattice."""

    x: int
    y: int
    radius: int


@dataclass(frozen=True, eq=False)
class DiscWindow:
    """Loads in a disc: `nodes` (k,), `modes` (k, q) of a pressure of unit size, `columns` (m, 3 q or 6 q) of readings.

    Columns are those of modes along x, y, z, and of the error of the mesh; `finer` (k,) is the variance of what is
    finer than the modes.
    """

    nodes: Index
    modes: Array
    columns: Array
    finer: Array


@dataclass(frozen=True, eq=False)
class Fitted:
    """Discs with size (log of Pa) and ratios (J, 3), and their log evidence."""

    discs: tuple[Disc, ...]
    at: Array
    evidence: float


@dataclass(eq=False)
class DiscFit:
    """Loads in discs; `places` (P, 3) of the nodes and thickness in m.

    `moved` (m, q) are whitened readings of a std of each motion of the image. `parts` (P, 3, m) are those of a load at
    each node, and of the errors of the mesh, `tolerances` (n, m) of what else the model may be off by.
    """

    problem: GaussianProblem
    places: Array
    thickness: float
    moved: Array
    _known: dict[Disc, DiscWindow] = field(default_factory=dict, init=False)
    _products: dict[tuple[Disc | None, Disc | None], Array] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self.middle = (self.places[:, :2].min(axis=0) + self.places[:, :2].max(axis=0)) / 2
        self.reach = np.ptp(self.places[:, :2], axis=0) / 2
        self.pitch = float(np.sqrt(np.prod(2 * self.reach) / max(len(self.places), 1)))
        noise = self.problem.noise
        made = [
            self.problem.whitened,
            *(e.change * (e.weight / noise[:, None]) for e in self.problem.errors() if e.of_mesh),
        ]
        self.parts = [np.ascontiguousarray(rows.T).reshape(len(self.places), 3, -1) for rows in made]
        self.tolerances = [np.ascontiguousarray(e.change.T) / noise for e in self.problem.errors() if not e.of_mesh]
        self.shear = float(np.sqrt(self.problem.prior.share[0] / self.problem.prior.share[2]))
        self.radii = int(np.log(LARGEST / SMALLEST) / np.log(GROWING)) + 1

    # -- discs --------------------------------------------------------------------------------------------------------
    def centre(self, disc: Disc) -> Array:
        """Middle of a disc (2,) in m."""
        return np.asarray(self.middle + STEP * self.thickness * np.array([disc.x, disc.y]))

    def inside(self, disc: Disc) -> Array:
        """Which share of the pressure may act at each node (P,): 1 in the disc, none a pitch from its rim."""
        radius = SMALLEST * self.thickness * GROWING**disc.radius
        r = np.hypot(*(self.places[:, :2] - self.centre(disc)).T)
        return np.clip((radius + self.pitch / 2 - r) / self.pitch, 0.0, 1.0)

    def allowed(self, disc: Disc) -> bool:
        """Whether a disc lies on the surface."""
        off = np.abs(STEP * self.thickness * np.array([disc.x, disc.y]))
        return 0 <= disc.radius < self.radii and bool(np.all(off <= self.reach)) and bool(np.any(self.inside(disc)))

    def _made(self, disc: Disc, count: int) -> DiscWindow:
        nodes = np.flatnonzero(self.inside(disc))
        C = self._covariance(disc, nodes)
        values, vectors = np.linalg.eigh(C)
        kept = np.flatnonzero(values > FEW * values[-1])[-count:]
        modes = vectors[:, kept] * np.sqrt(values[kept])
        columns = [(modes.T @ part[nodes, a]).T for part in self.parts for a in range(3)]
        finer = np.maximum(np.diag(C) - np.sum(modes**2, axis=1), 0.0)
        return DiscWindow(nodes, modes, np.hstack(columns), finer)

    def _covariance(self, disc: Disc, nodes: Index) -> Array:
        """Of a pressure of unit size at nodes (k,) of a disc."""
        w = self.inside(disc)[nodes]
        return np.asarray(w[:, None] * (self.problem.prior.matrix[np.ix_(nodes, nodes)] + EVEN) * w)

    def window(self, disc: Disc) -> DiscWindow:
        """Loads in a disc, made once."""
        found = self._known.get(disc)
        if found is None:
            found = self._made(disc, MODES)
            keep(self._known, disc, found, KEPT)
        return found

    # -- evidence -----------------------------------------------------------------------------------------------------
    def _cross(self, one: Disc | None, other: Disc | None) -> Array:
        """Products of the columns of two discs, or of the image (None); made once."""
        found = self._products.get((one, other))
        if found is None:
            found = self._columns(one).T @ self._columns(other)
            keep(self._products, (one, other), found, PRODUCTS)
            keep(self._products, (other, one), found.T, PRODUCTS)
        return found

    def _columns(self, disc: Disc | None) -> Array:
        return self.moved if disc is None else self.window(disc).columns

    def _gram(self, discs: tuple[Disc, ...]) -> Array:
        """Products (N, N) of the columns of discs and of the image."""
        parts = (*discs, None)
        return np.block([[self._cross(one, other) for other in parts] for one in parts])

    def _all(self, discs: tuple[Disc, ...]) -> Array:
        """Columns (m, N) of discs and of the image."""
        return np.hstack([self._columns(d) for d in (*discs, None)])

    def _small(self, discs: tuple[Disc, ...], at: Array) -> list[Array]:
        """T (3, 3) of each disc: what x, y, z are of the pressure and of the shears of their own."""
        out = []
        for size, u, v in at.reshape(-1, 3):
            out.append(np.exp(size) * np.array([[u, OWN, 0.0], [v, 0.0, OWN], [1.0, 0.0, 0.0]]))
        return out

    def _blocks(self, discs: tuple[Disc, ...], at: Array) -> list[tuple[int, slice, Array]]:
        """Number of the disc, its columns of one kind, and T (3, 3) of these."""
        out, k = [], 0
        for j, (disc, small) in enumerate(zip(discs, self._small(discs, at), strict=True)):
            window = self.window(disc)
            wide = 3 * window.modes.shape[1]
            for first in range(k, k + window.columns.shape[1], wide):
                out.append((j, slice(first, first + wide), small))
            k += window.columns.shape[1]
        return out

    def _turned(self, discs: tuple[Disc, ...], at: Array, rows: Array, back: bool = False) -> Array:
        """T times rows (N, ...), or T' times them."""
        out = rows.copy()
        for _, own, small in self._blocks(discs, at):
            out[own] = ((small.T if back else small) @ rows[own].reshape(3, -1)).reshape(rows[own].shape)
        return out

    def _within(self, discs: tuple[Disc, ...], at: Array) -> Array:
        """1 + T'G T (N, N)."""
        half = self._turned(discs, at, self._gram(discs), back=True)
        return np.asarray(self._turned(discs, at, half.T, back=True) + np.eye(len(half)))

    def _value(self, z: Array, discs: tuple[Disc, ...], at: Array, sloping: bool = True) -> tuple[float, Array]:
        """Evidence at sizes and ratios (3 J,), and its derivative where it is asked for."""
        b = np.concatenate([self._columns(d).T @ z for d in (*discs, None)])
        factor = np.asarray(np.linalg.cholesky(self._within(discs, at)))
        half = solve_triangular(factor, self._turned(discs, at, b, back=True), lower=True, check_finite=False)
        ratios = at.reshape(-1, 3)[:, 1:]
        value = -0.5 * (z @ z - half @ half) - np.sum(np.log(np.diag(factor))) - 0.5 * np.sum(ratios**2) / self.shear**2
        if not sloping:
            return float(value), np.empty(0)
        slope = self._slopes(discs, at, b, factor, half)
        slope[:, 1:] -= ratios / self.shear**2
        return float(value), slope.ravel()

    def _slopes(self, discs: tuple[Disc, ...], at: Array, b: Array, factor: Any, half: Any) -> Array:
        """Derivative (J, 3) of the evidence by size and ratios, through that by T: (b - G T m) m' - T'^-1 (1 - P)."""
        m = solve_triangular(factor, half, lower=True, trans="T", check_finite=False)
        left = b - self._gram(discs) @ self._turned(discs, at, m)
        roots = solve_triangular(factor, np.eye(len(m)), lower=True, check_finite=False)  # P = roots' roots
        out = np.zeros((len(discs), 3))
        for j, own, small in self._blocks(discs, at):
            q = (own.stop - own.start) // 3
            root = roots[:, own].T.reshape(3, -1)
            by = left[own].reshape(3, q) @ m[own].reshape(3, q).T
            by -= np.linalg.solve(small.T, q * np.eye(3) - root @ root.T)
            out[j, 0] += np.sum(by * small)
            out[j, 1:] += np.exp(at[3 * j]) * by[:2, 0]
        return out

    def fitted(
        self, z: Array, discs: tuple[Disc, ...], start: Array, least: float = -np.inf, turns: int = TURNS
    ) -> Fitted:
        """Sizes and ratios of discs of the largest evidence, from a start (J, 3) where they are at least so likely."""
        low = np.tile([np.log(SIZES[0]), -STEEPEST, -STEEPEST], len(discs))
        high = np.tile([np.log(SIZES[-1]), STEEPEST, STEEPEST], len(discs))
        first = np.clip(start.ravel(), low, high)
        value = self._value(z, discs, first, sloping=False)[0]
        if value < least:
            return Fitted(discs, first.reshape(-1, 3), value)

        def cost(at: Array) -> tuple[float, Array]:
            value, slope = self._value(z, discs, at)
            return -value, -slope

        found = minimize(cost, first, jac=True, method="L-BFGS-B", bounds=list(zip(low, high, strict=True)),
                         options={"maxiter": turns, "ftol": 1e-5})  # fmt: skip
        return Fitted(discs, found.x.reshape(-1, 3), -float(found.fun))


@dataclass(frozen=True, eq=False)
class EvenEvidence:
    """Log evidence of readings under loads all over the surface, by their frozen inverse, beside motion of the image.

    `left` (m, m) is what no other reading predicts, its inverse the covariance of the whitened readings.
    """

    left: Array
    moved: Array
    size: float

    @classmethod
    def of(cls, inverse: Inverse, moved: Array) -> EvenEvidence:
        """Made once for an inverse."""
        left = np.eye(len(inverse.noise)) - inverse.influence
        within = np.eye(moved.shape[1]) + moved.T @ (left @ moved)
        factor = np.linalg.cholesky(within)
        gained = solve_triangular(factor, moved.T @ left, lower=True)
        size = float(np.linalg.slogdet(left)[1] - 2 * np.sum(np.log(np.diag(factor))))
        return cls(left, gained, size / 2)

    def __call__(self, z: Array) -> float:
        """Of whitened readings (m,)."""
        told = self.moved @ z
        return self.size - 0.5 * float(z @ (self.left @ z) - told @ told)


def keep(store: dict[Any, Any], key: Any, value: Any, most: int) -> None:
    """Keep a value beside at most so many others, the newest."""
    while len(store) >= most:
        store.pop(next(iter(store)), None)
    store[key] = value
