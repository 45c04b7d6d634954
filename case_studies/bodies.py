"""Motion of gels under known tractions, by routes of their own: endless layers, edges, caps.

Near a press the surface moves as that of the endless bonded layer, exact by its Fourier kernels. What free edges change
is smooth where the press is not at the edge: quadratic bricks of 27 nodes under the tractions that the endless layer
has at the faces, turned round. What a cap changes is the difference of two solutions on bricks of the same plan.
Bricks are kept in a folder for temporary files. Nothing here is shared with `tactile`; E is 1.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.interpolate import make_interp_spline
from scipy.ndimage import map_coordinates
from scipy.sparse.linalg import splu
from scipy.special import j1

Array = NDArray[np.float64]
Points = tuple[Array, Array]  # places (n, 3), the last one the share of the height, and forces (n, 3)
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


# -- the endless layer -------------------------------------------------------------------------------------------------
GRID, COUNT = 0.1e-3, 720  # pitch (m) and points along a side: 24 thicknesses
COARSE, SMOOTH = 0.25e-3, 0.3e-3  # the same of the faces, and a std over which the load is smoothed there


@dataclass(frozen=True)
class Waves:
    """Wave vectors of a periodic grid, and the directions along them."""

    pitch: float
    count: int

    @property
    def vectors(self) -> tuple[Array, Array, Array, Array, Array]:
        """kx, ky, their length, and the direction along them (count, count)."""
        k1 = 2 * np.pi * np.fft.fftfreq(self.count, self.pitch)
        kx, ky = np.meshgrid(k1, k1)
        k = np.hypot(kx, ky)
        k[0, 0] = 1.0
        cx, cy = kx / k, ky / k
        cx[0, 0], k[0, 0] = 1.0, 0.0  # any direction, as long as it is one
        return kx, ky, k, cx, cy

    def tractions(self, patches: Sequence[Patch]) -> list[NDArray[np.complex128]]:
        """Transforms of the tractions of patches, along x, y, z, for a grid about the origin."""
        kx, ky, *_ = self.vectors
        shift = np.exp(-1j * (kx + ky) * (self.count // 2) * self.pitch) / self.pitch**2
        parts = [p.transform(kx, ky) * shift for p in patches]
        return [sum(f * p.force[a] for f, p in zip(parts, patches, strict=True)) for a in range(3)]

    def at(self, grid: Array, points: Array) -> Array:
        """Values (n,) of a grid (count, count), rows along y, at places (n, 2)."""
        return np.asarray(
            map_coordinates(grid, points[:, ::-1].T / self.pitch + self.count // 2, order=3, mode="grid-wrap")
        )


FACES = Waves(COARSE, round(COUNT * GRID / COARSE))


@lru_cache(maxsize=3)
def kernels(thickness: float, nu: float) -> dict[str, Array]:
    """Motion of the surface per traction of wave vectors (COUNT, COUNT): a bonded layer, z outward."""
    _, _, k, cx, cy = Waves(GRID, COUNT).vectors
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
    return out | {"cx": cx, "cy": cy}


def of_layer(patches: Sequence[Patch], thickness: float, nu: float) -> Array:
    """Motion (COUNT, COUNT, 3) of the grid about the origin, rows along y."""
    g, t = kernels(thickness, nu), Waves(GRID, COUNT).tractions(patches)
    along, across = g["cx"] * t[0] + g["cy"] * t[1], -g["cy"] * t[0] + g["cx"] * t[1]
    uk = g["kk"] * along - 1j * g["kz"] * t[2]
    uz, ut = g["zz"] * t[2] + 1j * g["kz"] * along, g["tt"] * across
    parts = (g["cx"] * uk - g["cy"] * ut, g["cy"] * uk + g["cx"] * ut, uz)
    return np.stack([np.fft.ifft2(p).real for p in parts], axis=-1)


def at_places(grid: Array, points: Array) -> Array:
    """Motion (n, 3) of places (n, 2)."""
    return np.stack([Waves(GRID, COUNT).at(grid[..., a], points) for a in range(3)], axis=-1)


def inside_layer(k: Array, thickness: float, nu: float, z: float) -> NDArray[np.complex128]:
    """Stresses (n, 4, 2) at a height under tractions along k and normal: kk, tt, kz, zz of waves k (n,) > 0.

    Four solutions of equilibrium, (i, s) exp(s k z) and (i z, s z - (3 - 4 nu) / k) exp(s k z), s = 1 and -1, are
    fitted to the bonded base and to the surface; those that grow are scaled by exp(-k h).
    """
    lame, mu, kappa = nu / ((1 + nu) * (1 - 2 * nu)), 0.5 / (1 + nu), 3 - 4 * nu

    def modes(height: float) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        motion, stress = np.zeros((2, len(k), 4, 4), complex)
        for column, (s, second) in enumerate(((1, False), (1, True), (-1, False), (-1, True))):
            e = np.exp(s * k * height - (k * thickness if s > 0 else 0.0))
            a, da = (1j * height, 1j) if second else (1j, 0.0)
            b, db = (s * height - kappa / k, s) if second else (s, 0.0)
            uk, uz = a * e, b * e
            duk, duz = (da + s * k * a) * e, (db + s * k * b) * e
            kk, volume = 1j * k * uk, 1j * k * uk + duz
            motion[:, 0, column], motion[:, 1, column] = uk, uz
            for row, part in enumerate((lame * volume + 2 * mu * kk, lame * volume, mu * (duk + 1j * k * uz),
                                        lame * volume + 2 * mu * duz)):  # fmt: skip
                stress[:, row, column] = part
        return motion, stress

    base, surface, here = modes(0.0)[0], modes(thickness)[1], modes(z)[1]
    A = np.concatenate([base[:, :2], surface[:, 2:]], axis=1)
    size = np.abs(A).max(axis=1, keepdims=True)  # of each mode
    given = np.zeros((len(k), 4, 2), complex)
    given[:, 2, 0] = given[:, 3, 1] = 1.0
    return np.asarray((here / size) @ np.linalg.solve(A / size, given))


@lru_cache(maxsize=12)
def _stresses(thickness: float, nu: float, z: float) -> NDArray[np.complex128]:
    """`inside_layer` of the wave vectors of the faces (n, n, 4, 2)."""
    k = FACES.vectors[2]
    table = np.linspace(1e-2 / thickness, k.max(), 3000)
    return np.asarray(make_interp_spline(table, inside_layer(table, thickness, nu, z))(np.maximum(k, table[0])))


def face_tractions(patches: Sequence[Patch], thickness: float, nu: float, z: float, points: Array, axis: int) -> Array:
    """Tractions (n, 3) of the endless layer at height z and places (n, 2), on faces whose normal is +x or +y."""
    _, _, k, cx, cy = FACES.vectors
    t = [f * np.exp(-0.5 * (k * SMOOTH) ** 2) for f in FACES.tractions(patches)]
    along, across = cx * t[0] + cy * t[1], -cy * t[0] + cx * t[1]
    stress = _stresses(thickness, nu, z)
    kk, tt, kz = (stress[..., row, 0] * along + stress[..., row, 1] * t[2] for row in range(3))
    up, down = np.exp(-k * (thickness - z)), np.exp(-k * (thickness + z))
    even = 1 + np.exp(-2 * k * thickness)
    kt, tz = 1j * (up - down) / even * across, (up + down) / even * across
    n, m = (cx, -cy) if axis == 0 else (cy, cx)  # the normal along k and across
    fk, ft = kk * n + kt * m, kt * n + tt * m
    parts = (cx * fk - cy * ft, cy * fk + cx * ft, kz * n + tz * m)
    return np.stack([FACES.at(np.fft.ifft2(p).real, points) for p in parts], axis=-1)


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

    Sides and thickness (m), Poisson's ratio, bricks along x, y, z of the quarter, whether it bears a cap. Places in it
    have the share of the height as their last coordinate.
    """

    size: tuple[float, float]
    thickness: float
    nu: float
    counts: tuple[int, int, int]
    cap: bool = False

    @classmethod
    def of(cls, size: tuple[float, float], thickness: float, nu: float, finer: float, cap: bool = False) -> Bricks:
        """Bricks of the thickness over `finer`, with nodes in their middles too."""
        nx, ny = (max(1, round(finer * s / 2 / thickness)) for s in size)
        return cls(size, thickness, nu, (nx, ny, round(finer)), cap)

    @property
    def lattice(self) -> tuple[int, int, int]:
        """Nodes along x, y, z."""
        nx, ny, nz = self.counts
        return 2 * nx + 1, 2 * ny + 1, 2 * nz + 1

    @property
    def sides(self) -> tuple[float, float, float]:
        """Of the quarter, in the coordinates of places."""
        return self.size[0] / 2, self.size[1] / 2, 1.0

    def top(self, points: Array) -> Array:
        """Height of the surface (n,) in m over places (n, 2); that of the apex is the thickness."""
        if not self.cap:
            return np.full(len(points), self.thickness)
        r = np.minimum(np.hypot(*points.T), CAP)
        return np.asarray(self.thickness - CURVED + np.sqrt(CURVED**2 - r**2))

    def nodes(self) -> Array:
        """Places (n, 3) in m, x fastest."""
        x, y, z = (np.linspace(0, side, count) for side, count in zip(self.sides, self.lattice, strict=True))
        plane = np.column_stack([a.ravel() for a in np.meshgrid(x, y)])
        high = self.top(plane)
        return np.concatenate([np.column_stack([plane, high * level]) for level in z])

    def cells(self) -> NDArray[np.intp]:
        """Nodes of each brick (e, 27)."""
        mx, my, _ = self.lattice
        nx, ny, nz = self.counts
        first = [2 * i + mx * (2 * j + my * 2 * k) for k in range(nz) for j in range(ny) for i in range(nx)]
        i, j, k = NODES.T
        return np.asarray(np.array(first)[:, None] + (i + mx * (j + my * k)))

    def stiffness(self) -> sparse.csc_array:
        """Of the quarter, nothing held."""
        nodes, cells = self.nodes(), self.cells()
        dofs = (3 * cells[:, :, None] + np.arange(3)).reshape(len(cells), 81)
        K = sparse.csc_array((3 * len(nodes), 3 * len(nodes)))
        for part in np.array_split(np.arange(len(cells)), max(1, len(cells) // 300)):
            rows = np.broadcast_to(dofs[part][:, :, None], (len(part), 81, 81))
            values = brick(nodes[cells[part]], self.nu).ravel()
            columns = np.swapaxes(rows, 1, 2)
            K = K + sparse.coo_array((values, (rows.ravel(), columns.ravel())), shape=K.shape).tocsc()
        return K

    def rows(self, places: Array) -> sparse.csr_array:
        """Weights (n, nodes) of places (n, 3) in the quarter."""
        mx, my, mz = self.lattice
        parts = []
        for at, side, count in zip(places.T, self.sides, self.counts, strict=True):
            t = np.clip(at / (side / count), 0, count)
            cell = np.minimum(t.astype(int), count - 1)
            parts.append((2 * cell, lagrange(2 * (t - cell) - 1)[0]))
        (ix, wx), (iy, wy), (iz, wz) = parts
        columns = [ix + a + mx * (iy + b + my * (iz + c)) for a, b, c in NODES]
        weights = [wx[:, a] * wy[:, b] * wz[:, c] for a, b, c in NODES]
        where = np.tile(np.arange(len(places)), 27)
        shape = (len(places), mx * my * mz)
        return sparse.csr_array((np.concatenate(weights), (where, np.concatenate(columns))), shape=shape)

    def solved(self, loads: Sequence[Points]) -> list[Array]:
        """Motion of the surface under loads: (4, surface nodes, 3) each, one for each parity."""
        return list(np.stack([self._parity(loads, parity) for parity in PARITIES], axis=1))

    def _parity(self, loads: Sequence[Points], parity: tuple[int, int]) -> Array:
        nodes, K = self.nodes(), _stiffness(self)
        held = np.zeros((len(nodes), 3), bool)
        held[nodes[:, 2] == 0] = True
        for axis, sign in enumerate(parity):
            plane = nodes[:, axis] == 0
            held[np.ix_(plane, [axis] if sign > 0 else [a for a in range(3) if a != axis])] = True
        free = np.flatnonzero(~held.ravel())
        f = [self.rows(np.abs(at)).T @ (forces * _turned(at, parity) / 4) for at, forces in loads]
        lu = splu(K[free][:, free].tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
                  options={"SymmetricMode": True})  # fmt: skip
        u = np.zeros((K.shape[0], len(loads)))
        u[free] = lu.solve(np.stack([a.ravel() for a in f], axis=-1)[free])
        flat = self.lattice[0] * self.lattice[1]
        return np.moveaxis(u.reshape(len(nodes), 3, -1)[-flat:], -1, 0)

    def motion(self, solved: Array, points: Array) -> Array:
        """Motion (n, 3) of places (n, 2) on the surface."""
        at = np.column_stack([points, np.ones(len(points))])
        rows = self.rows(np.abs(at))[:, -solved.shape[1] :]
        return np.asarray(sum((rows @ u) * _turned(at, p) for u, p in zip(solved, PARITIES, strict=True)))

    def faces(self, patches: Sequence[Patch]) -> Points:
        """What the endless layer does to the free faces, turned round: places and forces of a quadrature."""
        g, w = np.polynomial.legendre.leggauss(3)
        places, forces = [], []
        levels = [((c + (t + 1) / 2) / self.counts[2], v / 2 / self.counts[2] * self.thickness)
                  for c in range(self.counts[2]) for t, v in zip(g, w, strict=True)]  # fmt: skip
        for axis in (0, 1):
            cells, side = 2 * self.counts[1 - axis], self.size[1 - axis]
            along = ((np.arange(cells)[:, None] + (g + 1) / 2).ravel() / cells - 0.5) * side
            sign = np.repeat([-1.0, 1.0], len(along))
            at = np.empty((len(sign), 2))
            at[:, 1 - axis], at[:, axis] = np.tile(along, 2), sign * self.size[axis] / 2
            widths = sign * np.tile(w / 2 * side / cells, 2 * cells)
            for level, height in levels:
                t = face_tractions(patches, self.thickness, self.nu, level * self.thickness, at, axis)
                places.append(np.column_stack([at, np.full(len(at), level)]))
                forces.append(-t * (widths * height)[:, None])
        return np.concatenate(places), np.concatenate(forces)


PARITIES = ((1, 1), (1, -1), (-1, 1), (-1, -1))


@lru_cache(maxsize=1)
def _stiffness(body: Bricks) -> sparse.csc_array:
    return body.stiffness()


def _turned(places: Array, parity: tuple[int, int]) -> Array:
    """Signs (n, 3) that a vector at places (n, 2 or 3) takes, mirrored into the quarter, in a field of that parity."""
    signs = np.ones((len(places), 3))
    for axis, sign in enumerate(parity):
        beyond = places[:, axis] < 0
        signs[beyond] *= sign
        signs[beyond, axis] *= -1
    return signs


# -- gels --------------------------------------------------------------------------------------------------------------
TRUTHS = ("fe", "layer", "dome")
EDGES, CAPS = 3.0, 3.0  # bricks through the thickness for what edges and caps change


@dataclass(frozen=True, eq=False)
class Surface:
    """Motion of a surface under one press, as a function of places (n, 2): of the endless layer, and what is added."""

    layer: Array
    added: tuple[tuple[Bricks, Array, float], ...] = ()

    def __call__(self, points: Array) -> Array:
        """Motion (n, 3) in m."""
        return at_places(self.layer, points) + sum(sign * body.motion(u, points) for body, u, sign in self.added)


def surfaces(
    presses: Sequence[Sequence[Patch]], truth: str, size: tuple[float, float], thickness: float, nu: float
) -> list[Surface]:
    """Surface under each press of a pad with free edges ("fe"), without ("layer"), or that bears a cap ("dome")."""
    layers = [of_layer(p, thickness, nu) for p in presses]
    if truth == "layer":
        return [Surface(u) for u in layers]
    flat = Bricks.of(size, thickness, nu, EDGES)
    parts = [[(flat, u, 1.0) for u in kept(flat, presses, "edges")]]
    if truth == "dome":
        for cap, sign in ((True, 1.0), (False, -1.0)):
            body = Bricks.of(size, thickness, nu, CAPS, cap)
            parts.append([(body, u, sign) for u in kept(body, presses, "top")])
    return [Surface(u, tuple(added)) for u, *added in zip(layers, *parts, strict=True)]


def kept(body: Bricks, presses: Sequence[Sequence[Patch]], kind: str) -> list[Array]:
    """Motion of bricks under presses on the top, or as the faces feel them; what was solved before is read."""
    folder = Path(tempfile.gettempdir()) / "foreign_gels"
    folder.mkdir(exist_ok=True)
    names = [hashlib.sha256(repr((3, body, kind, tuple(p))).encode()).hexdigest()[:32] for p in presses]
    missing = [i for i, name in enumerate(names) if not (folder / f"{name}.npy").exists()]
    if missing:
        load = body.faces if kind == "edges" else pressed
        for i, motion in zip(missing, body.solved([load(presses[i]) for i in missing]), strict=True):
            np.save(folder / f"{names[i]}.npy", motion)
    return [np.load(folder / f"{name}.npy") for name in names]


def pressed(patches: Iterable[Patch]) -> Points:
    """Places and forces of a quadrature of patches on the top."""
    found = [(p.quadrature(), p.force) for p in patches]
    places = np.concatenate([np.column_stack([at, np.ones(len(at))]) for (at, _), _ in found])
    return places, np.concatenate([shares[:, None] * np.array(force) for (_, shares), force in found])
