"""Gels that no sensor modelled: motion of markers and depth maps of presses whose tractions are known.

Three truths, none of which shares code with `tactile`: quadratic bricks of 27 nodes with free edges and a bonded base
("fe"), an endless bonded layer by its Fourier kernels ("layer"), and the bricks under a spherical cap on a plinth, which
a user takes for a flat pad ("dome"). Motion of finite elements is kept in a folder for temporary files.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.ndimage import map_coordinates
from scipy.sparse.linalg import splu
from scipy.special import j1

Array = NDArray[np.float64]
E = 147e3
GELS = ((20e-3, 16e-3, 3e-3), (24e-3, 24e-3, 3e-3))  # sides and thickness (m)
RATIOS = (0.32, 0.45, 0.49)
SHAPES = ("round", "flat", "ring", "bar", "two")
NOISES = (2e-6, 5e-6, 20e-6)
NUISANCES = ("none", "shift", "rotation", "scale", "creep")
TRUTHS = ("fe", "layer", "dome")
IMAGE = 70e-6  # side of a pixel of the camera on the pad (m)
PIXEL, PIXEL_NOISE = 0.1e-3, 10e-6  # of a depth map
SPACING = 0.9e-3  # of the markers
CAP, CURVED = 8e-3, 35e-3  # radius of the cap's base, and of its sphere (m)


# -- what presses ------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Patch:
    """A patch of pressure: kind, centre, half sides (outer and inner radius of a ring), turn (rad), its force (N)."""

    kind: str
    centre: tuple[float, float]
    sides: tuple[float, float]
    turn: float
    force: tuple[float, float, float]

    def local(self, points: Array) -> Array:
        """Places (n, 2) in the frame of the patch."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        return (points - np.array(self.centre)) @ np.array([[c, -s], [s, c]])

    def density(self, points: Array) -> Array:
        """Share of the force per area (n,) in 1/m^2."""
        x, y = self.local(points).T
        (a, b), r2 = self.sides, x**2 + y**2
        if self.kind == "round":
            return 1.5 / (np.pi * a**2) * np.sqrt(np.maximum(1 - r2 / a**2, 0))
        if self.kind == "bar":
            return ((np.abs(x) <= a) & (np.abs(y) <= b)) / (4 * a * b)
        b = b if self.kind == "ring" else 0.0
        return ((r2 <= a**2) & (r2 >= b**2)) / (np.pi * (a**2 - b**2))

    def quadrature(self) -> tuple[Array, Array]:
        """Places (q, 2), and shares of the force that act there (q,)."""
        (a, b), (g, w) = self.sides, np.polynomial.legendre.leggauss(20)
        if self.kind == "bar":
            places = np.array([[a * u, b * v] for u in g for v in g])
            shares = np.outer(w, w).ravel() / 4
        else:
            low = b if self.kind == "ring" else 0.0
            t = (g + 1) / 2
            if self.kind == "round":  # 1 - r^2/a^2 = t^2, in which the profile is smooth
                r, share = a * np.sqrt(1 - t**2), 1.5 * w * t**2
            else:
                r = low + (a - low) * t
                share = w * r * (a - low) / (a**2 - low**2)
            turns = 2 * np.pi * (np.arange(40) + 0.5) / 40
            places = np.array([[p * np.cos(q), p * np.sin(q)] for p in r for q in turns])
            shares = np.repeat(share / 40, 40)
        c, s = np.cos(self.turn), np.sin(self.turn)
        return places @ np.array([[c, s], [-s, c]]) + np.array(self.centre), shares

    def transform(self, kx: Array, ky: Array) -> NDArray[np.complex128]:
        """Fourier transform of the density, ``integral exp(-i k x)``."""
        (a, b), k = self.sides, np.hypot(kx, ky)
        c, s = np.cos(self.turn), np.sin(self.turn)
        if self.kind == "bar":
            along, across = c * kx + s * ky, -s * kx + c * ky
            shape = np.sinc(along * a / np.pi) * np.sinc(across * b / np.pi)
        elif self.kind == "round":
            z = np.maximum(k * a, 1e-2)
            shape = np.where(k * a < 1e-2, 1 - (k * a) ** 2 / 10, 3 * (np.sin(z) - z * np.cos(z)) / z**3)
        else:
            low = b if self.kind == "ring" else 0.0
            shape = (a**2 * _disc(k * a) - low**2 * _disc(k * low)) / (a**2 - low**2)
        return shape * np.exp(-1j * (kx * self.centre[0] + ky * self.centre[1]))


def _disc(z: Array) -> Array:
    return np.where(z < 1e-4, 1 - z**2 / 8, 2 * j1(z) / np.maximum(z, 1e-4))


# -- finite elements ---------------------------------------------------------------------------------------------------
NODES = np.array([[i, j, k] for k in range(3) for j in range(3) for i in range(3)])  # of a brick, on its lattice


def lagrange(t: Array) -> tuple[Array, Array]:
    """Quadratic shape functions of -1, 0, 1 at t (n,), and their slopes: (n, 3) each."""
    return (
        np.stack([t * (t - 1) / 2, 1 - t**2, t * (t + 1) / 2], axis=-1),
        np.stack([t - 0.5, -2 * t, t + 0.5], axis=-1),
    )


def brick(corners: Array, nu: float) -> Array:
    """Stiffness (e, 81, 81) of bricks with nodes (e, 27, 3) at E = 1, by 3 x 3 x 3 Gauss points."""
    lame, mu = nu / ((1 + nu) * (1 - 2 * nu)), 0.5 / (1 + nu)
    D = np.diag([2 * mu] * 3 + [mu] * 3)
    D[:3, :3] += lame
    g, w = np.polynomial.legendre.leggauss(3)
    N, S = lagrange(g)
    K = np.zeros((len(corners), 81, 81))
    for c in range(3):
        for b in range(3):
            for a in range(3):
                i, j, k = NODES.T
                slopes = np.stack(
                    [S[a][i] * N[b][j] * N[c][k], N[a][i] * S[b][j] * N[c][k], N[a][i] * N[b][j] * S[c][k]]
                )
                J = np.einsum("dn,enx->edx", slopes, corners)
                d = np.linalg.solve(J, np.broadcast_to(slopes, (len(corners), 3, 27)))
                B = np.zeros((len(corners), 6, 27, 3))
                for row in range(3):
                    B[:, row, :, row] = d[:, row]
                for row, (p, q) in enumerate(((1, 2), (0, 2), (0, 1)), 3):
                    B[:, row, :, p], B[:, row, :, q] = d[:, q], d[:, p]
                B = B.reshape(len(corners), 6, 81)
                weight = w[a] * w[b] * w[c] * np.linalg.det(J)
                K += np.einsum("epi,pq,eqj,e->eij", B, D, B, weight, optimize=True)
    return K


@dataclass(frozen=True)
class Bricks:
    """A quarter of a gel, x and y positive; the others are its mirror images, even or odd, so that four solves are one.

    Sides and thickness (m), Poisson's ratio, bricks along x, y, z of the quarter, whether it bears a cap. E is 1.
    """

    size: tuple[float, float]
    thickness: float
    nu: float
    counts: tuple[int, int, int]
    cap: bool = False

    @classmethod
    def of(
        cls, size: tuple[float, float], thickness: float, nu: float, cap: bool = False, finer: float = 1.0
    ) -> Bricks:
        """Bricks of a fifth of the thickness in the plane and a quarter through it, nodes in their middles."""
        side = thickness / 5 / finer
        nx, ny = (max(1, round(s / 2 / side)) for s in size)
        return cls(size, thickness, nu, (nx, ny, round(4 * finer)), cap)

    @property
    def lattice(self) -> tuple[int, int, int]:
        """Nodes along x, y, z."""
        nx, ny, nz = self.counts
        return 2 * nx + 1, 2 * ny + 1, 2 * nz + 1

    def top(self, points: Array) -> Array:
        """Height of the surface (n,) in m over places (n, 2); that of the apex is the thickness."""
        if not self.cap:
            return np.full(len(points), self.thickness)
        r = np.minimum(np.hypot(*points.T), CAP)
        return self.thickness - CURVED + np.sqrt(CURVED**2 - r**2)

    def nodes(self) -> Array:
        """Places (n, 3), x fastest; levels closer under the surface."""
        mx, my, mz = self.lattice
        x, y = np.linspace(0, self.size[0] / 2, mx), np.linspace(0, self.size[1] / 2, my)
        ends = 1 - (1 - np.linspace(0, 1, self.counts[2] + 1)) ** 1.3
        z = np.sort(np.r_[ends, (ends[1:] + ends[:-1]) / 2])
        plane = np.column_stack([a.ravel() for a in np.meshgrid(x, y)])
        high = self.top(plane)
        return np.concatenate([np.column_stack([plane, high * level]) for level in z])

    def cells(self) -> NDArray[np.intp]:
        """Nodes of each brick (e, 27)."""
        mx, my, _ = self.lattice
        nx, ny, nz = self.counts
        first = [2 * i + mx * (2 * j + my * 2 * k) for k in range(nz) for j in range(ny) for i in range(nx)]
        i, j, k = NODES.T
        return np.array(first)[:, None] + (i + mx * (j + my * k))

    def stiffness(self) -> sparse.csc_array:
        """Of the quarter, nothing held."""
        nodes, cells = self.nodes(), self.cells()
        dofs = (3 * cells[:, :, None] + np.arange(3)).reshape(len(cells), 81)
        K = sparse.csc_array((3 * len(nodes), 3 * len(nodes)))
        for part in np.array_split(np.arange(len(cells)), max(1, len(cells) // 300)):
            rows, columns = (np.broadcast_to(dofs[part][s], (len(part), 81, 81)) for s in
                             ((slice(None), slice(None), None), (slice(None), None)))  # fmt: skip
            values = brick(nodes[cells[part]], self.nu)
            K = K + sparse.coo_array((values.ravel(), (rows.ravel(), columns.ravel())), shape=K.shape).tocsc()
        return K

    def rows(self, points: Array) -> sparse.csr_array:
        """Weights (n, surface nodes of the quarter) of places (n, 2) with x and y positive."""
        mx, my, _ = self.lattice
        parts = []
        for at, side, count in zip(points.T, self.size, self.counts, strict=False):
            t = np.clip(at / (side / 2 / count), 0, count)
            cell = np.minimum(t.astype(int), count - 1)
            parts.append((2 * cell, lagrange(2 * (t - cell) - 1)[0]))
        (ix, wx), (iy, wy) = parts
        columns = [(ix + a) + mx * (iy + b) for b in range(3) for a in range(3)]
        weights = [wx[:, a] * wy[:, b] for b in range(3) for a in range(3)]
        where = np.tile(np.arange(len(points)), 9)
        return sparse.csr_array(
            (np.concatenate(weights), (where, np.concatenate(columns))), shape=(len(points), mx * my)
        )

    def load(self, patches: Sequence[Patch], parity: tuple[int, int]) -> Array:
        """Consistent load (surface nodes, 3) of one parity."""
        total = np.zeros((self.lattice[0] * self.lattice[1], 3))
        for patch in patches:
            places, shares = patch.quadrature()
            forces = shares[:, None] * np.array(patch.force) * _turned(places, parity) / 4
            total += self.rows(np.abs(places)).T @ forces
        return total

    def solved(self, presses: Sequence[Sequence[Patch]]) -> list[Array]:
        """Motion of the surface under each press: (4, surface nodes, 3), one for each parity; kept in a folder."""
        folder = Path(tempfile.gettempdir()) / "foreign_gels"
        folder.mkdir(exist_ok=True)
        files = [folder / f"{hashlib.sha256(repr((2, self, tuple(p))).encode()).hexdigest()[:32]}.npy" for p in presses]
        missing = [i for i, file in enumerate(files) if not file.exists()]
        if missing:
            found = np.stack([self._parity([presses[i] for i in missing], p) for p in PARITIES], axis=1)
            for i, motion in zip(missing, found, strict=True):
                np.save(files[i], motion)
        return [np.load(file) for file in files]

    def _parity(self, presses: Sequence[Sequence[Patch]], parity: tuple[int, int]) -> Array:
        """Motion (presses, surface nodes, 3) of one parity."""
        nodes, K = self.nodes(), _stiffness(self)
        held = np.zeros((len(nodes), 3), bool)
        held[nodes[:, 2] == 0] = True
        for axis, sign in enumerate(parity):
            plane = nodes[:, axis] == 0
            held[np.ix_(plane, [axis] if sign > 0 else [a for a in range(3) if a != axis])] = True
        free = np.flatnonzero(~held.ravel())
        flat = self.lattice[0] * self.lattice[1]
        f = np.zeros((len(nodes), 3, len(presses)))
        f[-flat:] = np.stack([self.load(p, parity) for p in presses], axis=-1)
        lu = splu(K[free][:, free].tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
                  options={"SymmetricMode": True})  # fmt: skip
        u = np.zeros((3 * len(nodes), len(presses)))
        u[free] = lu.solve(f.reshape(len(u), -1)[free])
        return np.moveaxis(u.reshape(len(nodes), 3, -1)[-flat:], -1, 0)

    def motion(self, solved: Array, points: Array) -> Array:
        """Motion (n, 3) of places (n, 2)."""
        rows = self.rows(np.abs(points))
        return np.sum([(rows @ u) * _turned(points, p) for u, p in zip(solved, PARITIES, strict=True)], axis=0)


PARITIES = ((1, 1), (1, -1), (-1, 1), (-1, -1))


@lru_cache(maxsize=1)
def _stiffness(body: Bricks) -> sparse.csc_array:
    return body.stiffness()


def _turned(points: Array, parity: tuple[int, int]) -> Array:
    """Signs (n, 3) that a vector at places (n, 2) takes, mirrored into the quarter, in a field of that parity."""
    signs = np.ones((len(points), 3))
    for axis, sign in enumerate(parity):
        beyond = points[:, axis] < 0
        signs[beyond] *= sign
        signs[beyond, axis] *= -1
    return signs


# -- the endless layer -------------------------------------------------------------------------------------------------
GRID = 0.1e-3  # pitch (m) of 720 x 720 points, 24 thicknesses wide
COUNT = 720


@lru_cache(maxsize=3)
def kernels(thickness: float, nu: float) -> dict[str, Array]:
    """Motion per traction of wave vectors (COUNT, COUNT), at E = 1: a bonded layer, body below, z outward."""
    k1 = 2 * np.pi * np.fft.fftfreq(COUNT, GRID)
    kx, ky = np.meshgrid(k1, k1)
    k = np.hypot(kx, ky)
    k[0, 0] = 1.0
    mu, x, kappa = 0.5 / (1 + nu), k * thickness, 3 - 4 * nu
    e = np.exp(-2 * x)
    M = kappa * (1 + e**2) + (4 * x**2 + kappa**2 + 1) * e
    out = {
        "zz": (1 - nu) / (mu * k) * (kappa * (1 - e**2) - 4 * x * e) / M,
        "kk": (1 - nu) / (mu * k) * (kappa * (1 - e**2) + 4 * x * e) / M,
        "kz": (kappa * (1 - 2 * nu) * (1 - e) ** 2 - 4 * x**2 * e) / (2 * mu * k * M),
        "tt": np.tanh(x) / (mu * k),
    }
    out["zz"][0, 0] = thickness * (1 - 2 * nu) / (2 * mu * (1 - nu))
    out["kk"][0, 0] = out["tt"][0, 0] = thickness / mu
    out["kz"][0, 0] = 0.0
    cx, cy = kx / k, ky / k
    cx[0, 0] = 1.0  # any direction, as long as it is one
    return out | {"kx": kx, "ky": ky, "cx": cx, "cy": cy}


def of_layer(patches: Sequence[Patch], thickness: float, nu: float) -> Array:
    """Motion (COUNT, COUNT, 3) at E = 1 of the grid about the origin, rows along y."""
    g = kernels(thickness, nu)
    shift = np.exp(-1j * (g["kx"] + g["ky"]) * (COUNT // 2) * GRID)
    t = [sum(p.transform(g["kx"], g["ky"]) * p.force[a] for p in patches) * shift / GRID**2 for a in range(3)]
    along, across = g["cx"] * t[0] + g["cy"] * t[1], -g["cy"] * t[0] + g["cx"] * t[1]
    uk = g["kk"] * along - 1j * g["kz"] * t[2]
    uz, ut = g["zz"] * t[2] + 1j * g["kz"] * along, g["tt"] * across
    parts = (g["cx"] * uk - g["cy"] * ut, g["cy"] * uk + g["cx"] * ut, uz)
    return np.stack([np.fft.ifft2(p).real for p in parts], axis=-1)


def at_places(grid: Array, points: Array) -> Array:
    """Motion (n, 3) of places (n, 2)."""
    where = points[:, ::-1].T / GRID + COUNT // 2
    return np.stack([map_coordinates(grid[..., a], where, order=3, mode="grid-wrap") for a in range(3)], axis=-1)


# -- cases -------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Case:
    """One press on a gel, as a camera sees it, and what is true of it; SI.

    Parameters
    ----------
    truth, shape : str
    E, nu : float
    size : (a, b)
    thickness : float
    points : array (N, 2)
        Markers at rest, the same for every case of a gel.
    exact, motion : array (N, 3)
        Motion of the markers by the press; and as it is seen, with noise and nuisance.
    noise : float
        Std of each component of `motion`.
    depth : (values (H, W), pixel, noise) or None
        Normal motion as `tactile.DepthMap` takes it.
    patches : tuple of Patch
        What presses, forces in N.
    force, torque : array (3,)
        On the gel; about the middle of its surface.
    nuisance : dict
        What was added to the motion: kind, and shift (m), turn (rad), scale, creep (m).
    """

    truth: str
    shape: str
    E: float
    nu: float
    size: tuple[float, float]
    thickness: float
    points: Array
    exact: Array
    motion: Array
    noise: float
    depth: tuple[Array, float, float] | None
    patches: tuple[Patch, ...]
    force: Array
    torque: Array
    nuisance: dict[str, Any] = field(default_factory=dict)

    @property
    def gel(self) -> tuple[float, float, float]:
        """Sides and thickness (m)."""
        return (*self.size, self.thickness)

    def traction(self, points: Array, width: float = 0.0) -> Array:
        """Tractions (n, 3) in Pa at places (n, 2); with a width (m), their means over squares of that side."""
        steps = (np.arange(12) + 0.5) / 12 - 0.5 if width else np.zeros(1)
        places = points[:, None, None, :] + width * np.stack(np.meshgrid(steps, steps), axis=-1)
        flat = places.reshape(-1, 2)
        return sum(p.density(flat).reshape(len(points), -1).mean(axis=1)[:, None] * np.array(p.force)
                   for p in self.patches)  # type: ignore[return-value] # fmt: skip

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Which places (n, 2) are pressed."""
        return np.asarray(sum(p.density(points) for p in self.patches) > 0)


def markers(size: tuple[float, float]) -> Array:
    """Places (N, 2) of the markers of a gel: a grid with some disorder, half a spacing off the rim."""
    x, y = ((np.arange(int(s / SPACING)) - (int(s / SPACING) - 1) / 2) * SPACING for s in size)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return grid + np.random.default_rng(round(1e6 * sum(size))).uniform(-0.1, 0.1, grid.shape) * SPACING


def pixels(size: tuple[float, float]) -> Array:
    """Places (H, W, 2) of the pixels of a depth map over a gel."""
    x, y = ((np.arange(round(s / PIXEL)) - (round(s / PIXEL) - 1) / 2) * PIXEL for s in size)
    return np.stack(np.meshgrid(x, y), axis=-1)


@dataclass(frozen=True, eq=False)
class Surface:
    """Motion of a surface under presses of unit size: a function of places (n, 2)."""

    motion: Callable[[Array], Array]
    height: Callable[[Array], Array]


def surfaces(
    presses: Sequence[Sequence[Patch]], truth: str, size: tuple[float, float], thickness: float, nu: float
) -> list[Surface]:
    """Surface under each press, at E = 1."""
    if truth == "layer":
        level = Bricks.of(size, thickness, nu)
        return [Surface(_Of(at_places, of_layer(p, thickness, nu)), level.top) for p in presses]
    body = Bricks.of(size, thickness, nu, cap=truth == "dome")
    return [Surface(_Of(body.motion, u), body.top) for u in body.solved(presses)]


@dataclass(frozen=True, eq=False)
class _Of:
    """A function of two values with the first one given."""

    call: Callable[[Array, Array], Array]
    first: Array

    def __call__(self, points: Array) -> Array:
        return self.call(self.first, points)


def drawn(rng: np.random.Generator, shape: str, size: tuple[float, float], thickness: float) -> tuple[Patch, ...]:
    """Patches of one press, of unit force in all: mostly one and a half thicknesses from the rim."""
    near = (1.5 if rng.random() < 0.85 else 0.9) * thickness
    room = np.array(size) / 2 - near

    def patch(kind: str, largest: float, share: float) -> Patch:
        a = rng.uniform(1.2e-3 if kind == "ring" else 0.6e-3, largest)
        b = a * (rng.uniform(0.5, 0.75) if kind == "ring" else rng.uniform(0.25, 0.6))
        shear, way = rng.uniform(0, 0.5), rng.uniform(0, 2 * np.pi)
        force = share * np.array([shear * np.cos(way), shear * np.sin(way), -1.0])
        return Patch(kind, tuple(rng.uniform(-room, room)), (a, b), rng.uniform(0, np.pi), tuple(force))

    if shape != "two":
        return (patch(shape, 2.5e-3, 1.0),)
    share = rng.uniform(0.35, 0.65)
    while True:
        one, other = (patch(rng.choice(["round", "flat"]), 1.4e-3, s) for s in (share, 1 - share))
        if np.hypot(*np.subtract(one.centre, other.centre)) > one.sides[0] + other.sides[0] + 1e-3:
            return one, other


def cases(
    problems: int,
    seed: int,
    truth: str = "fe",
    *,
    gel: tuple[float, float, float] | None = None,
    nu: float | None = None,
    shape: str | None = None,
    noise: float | None = None,
    nuisance: str = "none",
    depth: bool = True,
) -> Iterator[Case]:
    """Presses on gels, each from a seed of its own; what is not given is drawn, or taken in turn (gel and nu).

    Parameters
    ----------
    truth : {"fe", "layer", "dome"}
    gel : (a, b, h), optional
        m; one of `GELS`.
    nu : float, optional
        One of `RATIOS`.
    shape : str, optional
        One of `SHAPES`.
    noise : float, optional
        m; one of `NOISES`.
    nuisance : str
        One of `NUISANCES`.
    depth : bool
        Whether depth maps are made.
    """
    rngs = [np.random.default_rng([seed, number, 7]) for number in range(problems)]
    known = [((g := gel or GELS[i % 2])[:2], g[2], nu or RATIOS[(i // 2) % 3]) for i in range(problems)]
    shapes = [shape or str(rng.choice(SHAPES)) for rng in rngs]
    presses = [drawn(r, s, k[0], k[1]) for r, s, k in zip(rngs, shapes, known, strict=True)]
    found: dict[int, Surface] = {}
    for k in dict.fromkeys(known):
        which = [i for i, other in enumerate(known) if other == k]
        found |= dict(zip(which, surfaces([presses[i] for i in which], truth, *k), strict=True))
    for i, (rng, (size, thickness, ratio)) in enumerate(zip(rngs, known, strict=True)):
        yield seen(rng, presses[i], found[i], truth, shapes[i], size, thickness, ratio, noise, nuisance, depth)


def seen(
    rng: np.random.Generator, unit: tuple[Patch, ...], surface: Surface, truth: str, shape: str,
    size: tuple[float, float], thickness: float, nu: float, noise: float | None, nuisance: str, depth: bool,
) -> Case:  # fmt: skip
    """A press scaled so that the surface moves 0.05 to 0.25 mm, and what is seen of it."""
    points, grid = markers(size), pixels(size)
    whole = surface.motion(grid.reshape(-1, 2))
    scale = rng.uniform(0.05e-3, 0.25e-3) / np.abs(whole[:, 2]).max()
    patches = tuple(Patch(p.kind, p.centre, p.sides, p.turn, tuple(E * scale * np.array(p.force))) for p in unit)
    arms = np.array([[*p.centre, 0.0] for p in patches])
    arms[:, 2] = surface.height(arms[:, :2]) - thickness
    forces = np.array([p.force for p in patches])
    exact = scale * surface.motion(points)
    level = noise or float(rng.choice(NOISES))
    moved, words = disturbed(rng, nuisance, points)
    image = None
    if depth:
        values = scale * whole[:, 2].reshape(grid.shape[:2])
        image = values + PIXEL_NOISE * rng.standard_normal(values.shape), PIXEL, PIXEL_NOISE
    motion = exact + moved + level * rng.standard_normal(exact.shape)
    return Case(truth, shape, E, nu, size, thickness, points, exact, motion, level, image, patches,
                forces.sum(axis=0), np.cross(arms, forces).sum(axis=0), words)  # fmt: skip


def disturbed(rng: np.random.Generator, kind: str, points: Array) -> tuple[Array, dict[str, Any]]:
    """Motion (N, 3) that no press made, and its size: camera shift 0.25 to 1 pixel, turn, scale, creep of the gel."""
    out, way = np.zeros((len(points), 3)), rng.uniform(0, 2 * np.pi)
    words: dict[str, Any] = {"kind": kind}
    reach = float(np.hypot(*points.T).max())
    if kind == "shift":
        words["shift"] = rng.uniform(0.25, 1) * IMAGE * np.array([np.cos(way), np.sin(way)])
        out[:, :2] = words["shift"]
    elif kind == "rotation":
        words["turn"] = float(rng.choice([-1, 1]) * rng.uniform(0.25, 1) * IMAGE / reach)
        out[:, :2] = words["turn"] * np.column_stack([-points[:, 1], points[:, 0]])
    elif kind == "scale":
        words["scale"] = float(rng.choice([-1, 1]) * rng.uniform(0.25, 1) * IMAGE / reach)
        out[:, :2] = words["scale"] * points
    elif kind == "creep":
        words["creep"] = 5e-6
        field_ = np.array([np.cos(way), np.sin(way)]) + 0.5 * points / reach @ rng.uniform(-1, 1, (2, 2))
        out[:, :2] = words["creep"] * field_ / np.sqrt(np.mean(np.sum(field_**2, axis=1)))
    return out, words
