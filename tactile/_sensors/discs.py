"""Loads in discs of a surface: where they lie, and the patterns of pressure in them that readings can tell apart.

A pressure in a disc is a sum of modes of the contact prior there. Readings answer each mode along x, y and z, and so
does the error of the mesh; both span few directions, of which `basis` is one orthonormal set. The number of steps of
the lattice counts in sixths of the thickness.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import lapack, solve_triangular

from .._arrays import Array, Index
from .gaussian import GaussianProblem

MODES = 16  # of the pressure in a disc
FEW = 1e-4  # of the strongest variance, below which a mode is none
EVEN = 1.0  # variance of an even pressure in a disc, over that of the prior
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # components of a covariance
OWN = 0.1  # of the pressure: std of shear that does not go with it
ROUNDING = 1e-13  # of the largest variance, that any direction has at least
STEP = 1 / 6  # thicknesses between the middles of discs
SMALLEST, LARGEST, GROWING = 0.25, 1.5, 1.25  # radii of discs, in thicknesses, and from one to the next
FAINT = 1e-9  # of the largest square, below which a direction of a disc is none
KEPT, PRODUCTS = 160, 1000  # discs, and their products


@dataclass(frozen=True)
class Disc:
    """Place and radius in steps of the lattice."""

    x: int
    y: int
    radius: int


@dataclass(frozen=True, eq=False)
class DiscWindow:
    """Loads in a disc: `nodes` (k,), `modes` (k, q) of a pressure of unit size, and the readings that they make.

    Those are `basis` (m, r) times `made` (parts, 3, q, r): of modes along x, y, z, of the model and of the error of the
    mesh. `finer` (k,) is the variance of what is finer than the modes.
    """

    nodes: Index
    modes: Array
    basis: Array
    made: Array
    finer: Array
    _cuts: dict[int, DiscWindow] = field(default_factory=dict)
    _last: list[tuple[Array, Array]] = field(default_factory=list)

    @cached_property
    def strength(self) -> Array:
        """Square of every direction, over that of the first (r,), largest first."""
        return np.asarray(np.max(self.made**2, axis=(0, 1, 2)) / np.max(self.made[..., 0] ** 2))

    def above(self, faint: float) -> DiscWindow:
        """The same by its directions of such a strength alone."""
        r = int(np.sum(self.strength > faint))
        if r == len(self.strength):
            return self
        if r not in self._cuts:
            self._cuts[r] = replace(self, basis=self.basis[:, :r], made=self.made[..., :r], _cuts={}, _last=[])
        return self._cuts[r]

    @cached_property
    def products(self) -> Array:
        """Covariance (6, r, r) of the readings along the directions, by components x, y, z of the load and their pairs.

        Those of a pair hold both ways.
        """
        r = self.made.shape[-1]
        by = self.made.transpose(1, 0, 2, 3).reshape(3, -1, r)
        out = np.array([by[a].T @ by[b] for a, b in PAIRS])
        out[3:] += out[3:].transpose(0, 2, 1)
        return out

    def factor(self, at: Array) -> Array:
        """Cholesky factor (r, r) of the covariance of the readings along the directions, at size and ratios (3,)."""
        for before, found in self._last:  # of the disc that stays where others are tried
            if np.array_equal(before, at):
                return found
        size, u, v = at.tolist()
        own = self._mixed(size, [u * u + OWN**2, v * v + OWN**2, 1.0, u * v, u, v])
        own.flat[:: len(own) + 1] += ROUNDING * np.max(np.diag(own))
        found = cholesky(own)
        self._last[:] = [(at.copy(), found)]
        return found

    def slopes(self, at: Array, f: Array) -> Array:
        """Derivatives (3, r, r) of that covariance by size and ratios, over its factor f on both sides."""
        size, u, v = at.tolist()
        by = self._mixed(size, [2 * u, 0.0, 0.0, v, 1.0, 0.0]), self._mixed(size, [0.0, 2 * v, 0.0, u, 0.0, 1.0])
        return np.array([2 * np.eye(len(f)), *_over(f, *by)])

    def second(self, at: Array, f: Array, M: Array) -> Array:
        """Second derivatives (3, 3, r, r) of the same, by the first, M (3, r, r)."""
        uu, vv, uv = _over(f, *(np.exp(2 * at[0]) * self.products[[0, 1, 3]]))
        return np.array([2 * M, [2 * M[1], 2 * uu, uv], [2 * M[2], uv, 2 * vv]])

    def _mixed(self, size: float, parts: list[float]) -> Array:
        """Sum of the products, each times its part."""
        r = self.products.shape[1]
        return np.asarray((np.exp(2 * size) * np.array(parts) @ self.products.reshape(len(PAIRS), -1)).reshape(r, r))

    @property
    def columns(self) -> Array:
        """Readings (m, parts * 3 * q) of the modes."""
        return np.asarray(self.basis @ self.made.reshape(-1, self.made.shape[-1]).T)


@dataclass(eq=False)
class DiscWindows:
    """Discs of one sensor; `places` (P, 3) of the nodes and thickness in m.

    `moved` (m, q) are whitened readings of a std of each motion of the image. `parts` (P, 3 parts, m) are those of a
    load at each node, and of the errors of the mesh, `tolerances` (n, m) of what else the model may be off by.
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
        self.parts = np.concatenate([rows.T.reshape(len(self.places), 3, -1) for rows in made], axis=1)
        self.tolerances = [np.ascontiguousarray(e.change.T) / noise for e in self.problem.errors() if not e.of_mesh]
        self.shear = float(np.sqrt(self.problem.prior.share[0] / self.problem.prior.share[2]))
        self.image = np.linalg.qr(self.moved)
        self.radii = int(np.log(LARGEST / SMALLEST) / np.log(GROWING)) + 1

    def centre(self, disc: Disc) -> Array:
        """Middle of a disc (2,) in m."""
        return np.asarray(self.middle + STEP * self.thickness * np.array([disc.x, disc.y]))

    def radius(self, disc: Disc) -> float:
        """Radius of a disc in m."""
        return SMALLEST * self.thickness * GROWING**disc.radius

    def inside(self, disc: Disc) -> Array:
        """Which share of the pressure may act at each node (P,): 1 in the disc, none a pitch from its rim."""
        r = np.hypot(*(self.places[:, :2] - self.centre(disc)).T)
        return np.clip((self.radius(disc) + self.pitch / 2 - r) / self.pitch, 0.0, 1.0)

    def allowed(self, disc: Disc) -> bool:
        """Whether a disc lies on the surface."""
        off = np.abs(STEP * self.thickness * np.array([disc.x, disc.y]))
        return 0 <= disc.radius < self.radii and bool(np.all(off <= self.reach)) and bool(np.any(self.inside(disc)))

    def covariance(self, disc: Disc, nodes: Index) -> Array:
        """Of a pressure of unit size at nodes (k,) of a disc."""
        w = self.inside(disc)[nodes]
        return np.asarray(w[:, None] * (self.problem.prior.matrix[np.ix_(nodes, nodes)] + EVEN) * w)

    def modes(self, disc: Disc, count: int) -> tuple[Index, Array, Array]:
        """Nodes (k,) of a disc, its strongest modes (k, q), and the variance (k,) of what is finer."""
        nodes = np.flatnonzero(self.inside(disc))
        C = self.covariance(disc, nodes)
        values, vectors = np.linalg.eigh(C)
        kept = np.flatnonzero(values > FEW * values[-1])[-count:]
        modes = vectors[:, kept] * np.sqrt(values[kept])
        return nodes, modes, np.maximum(np.diag(C) - np.sum(modes**2, axis=1), 0.0)

    def columns(self, nodes: Index, modes: Array) -> Array:
        """Readings (3 parts, q, m) of modes (k, q) at nodes (k,)."""
        k, q = modes.shape
        return (modes.T @ self.parts[nodes].reshape(k, -1)).reshape(q, self.parts.shape[1], -1).transpose(1, 0, 2)

    def window(self, disc: Disc) -> DiscWindow:
        """Loads in a disc, made once."""
        found = self._known.get(disc)
        if found is None:
            nodes, modes, finer = self.modes(disc, MODES)
            rows = self.columns(nodes, modes).reshape(-1, self.parts.shape[2])
            own, on = pivoted(rows @ rows.T, FAINT)
            basis = solve_triangular(on[own], rows[own], lower=True, check_finite=False).T
            made = on.reshape(-1, 3, modes.shape[1], len(own))
            found = DiscWindow(nodes, modes, np.ascontiguousarray(basis), made, finer)
            keep(self._known, disc, found, KEPT)
        return found

    def basis(self, disc: Disc | None) -> Array:
        """Directions of readings (m, r) of a disc, or of the image (None)."""
        return self.image[0] if disc is None else self.window(disc).basis

    def cross(self, one: Disc | None, other: Disc | None) -> Array:
        """Products of the directions of two discs, or of the image (None); made once."""
        found = self._products.get((one, other))
        if found is None:
            found = self.basis(one).T @ self.basis(other)
            keep(self._products, (one, other), found, PRODUCTS)
            keep(self._products, (other, one), found.T, PRODUCTS)
        return found


def shares(size: float, u: float, v: float) -> Array:
    """T T' (3, 3) of a disc."""
    return np.asarray(np.exp(2 * size) * (np.outer((u, v, 1.0), (u, v, 1.0)) + OWN**2 * np.diag((1.0, 1.0, 0.0))))


def cholesky(S: Array) -> Array:
    """Lower factor of a matrix that is certain to have one."""
    return np.asarray(lapack.dpotrf(S, lower=1, clean=1)[0]) if len(S) else S


def solved(factor: Array, b: Array) -> Array:
    """``S^-1 b`` by the Cholesky factor of S."""
    return np.asarray(lapack.dpotrs(factor, b, lower=1)[0]) if len(factor) else b


def lower(f: Array, b: Array) -> Array:
    """``f^-1 b`` of a lower factor."""
    return np.asarray(lapack.dtrtrs(f, b, lower=1)[0])


def _over(f: Array, *parts: Array) -> Array:
    """``f^-1 S f^-T`` of every symmetric S (r, r)."""
    r = len(f)
    half = lower(f, np.hstack(parts)).reshape(r, -1, r).transpose(2, 1, 0).reshape(r, -1)
    return lower(f, half).reshape(r, -1, r).transpose(1, 0, 2)


def pivoted(G: Array, cut: float) -> tuple[Index, Array]:
    """Which of N directions are enough (r,), and all of them (N, r) in coordinates of these, by products G (N, N)."""
    if not len(G):
        return np.empty(0, int), np.empty((0, 0))
    factor, pivots, rank, _ = lapack.dpstrf(G, tol=cut * np.max(np.diag(G)), lower=1)
    on = np.empty((len(G), rank))
    on[pivots - 1] = np.tril(factor)[:, :rank]
    return pivots[:rank] - 1, on


def keep(store: dict[Any, Any], key: Any, value: Any, most: int) -> None:
    """Keep a value beside at most so many others, the newest."""
    while len(store) >= most:
        store.pop(next(iter(store)), None)
    store[key] = value
