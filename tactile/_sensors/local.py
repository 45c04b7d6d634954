"""Loads about the contacts of one frame, in which shear goes with pressure: what presses anywhere leave open.

A press is in one place. Once that is known, loads act about it alone, and its shear is mostly one ratio times its
pressure, however that is distributed. Both together tell pressure where no normal motion is seen (shear in one
direction moves markers evenly, pressure moves them outward), and tie the sum of a pressure to its shape where a gel
near to incompressible hardly shows its sum. Unknown of every contact are a disc that holds it, its size (std of the
pressure) and the two ratios; of these the evidence of the readings is maximised,

    y = A T x + e,   x ~ 1, e ~ 1,   log p(y) = -(y'y - b'T P T'b) / 2 - log|P^-1| / 2,  P = (1 + T'G T)^-1,

with G = A'A and b = A'y, so that a frame costs products of the size of its contacts (D. J. C. MacKay, Neural Comput. 4
(1992) 415; C. E. Rasmussen & C. K. I. Williams, Gaussian Processes for Machine Learning, MIT Press 2006, ch. 5). Motion
of the image and the error of the mesh are among the unknowns. Discs that the readings do not tell apart are averaged by
their evidence. Contacts are added as long as the readings ask for one more.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import cho_solve, solve_triangular
from scipy.optimize import minimize

from .._arrays import Array, Index, Mask
from .gaussian import GaussianProblem, around
from .inversion import FLIP, Answer, Inverse, Pressed, RegionSolver

OWN = 0.1  # of the pressure: std of shear that does not go with it
MODES = 16  # of the pressure in a disc
FEW = 1e-4  # of the strongest variance, below which a mode is none
EVEN = 1.0  # variance of an even pressure in a disc, over that of the prior
STEP = 1 / 6  # thicknesses between the middles of discs
SMALLEST, LARGEST, GROWING = 0.25, 1.5, 1.25  # radii of discs, in thicknesses, and from one to the next
COARSE = 3  # steps between discs of the first look
LOOKED, LOOKS = 6, 2  # modes of these; places that are followed
SIZES = np.geomspace(1e2, 1e8, 19)  # Pa, tried in the first look
STEEPEST = 3.0  # ratio
GRAIN, BESIDE = 0.2, 1.6  # of the load within so many pitches: std of what a mesh cannot tell of one node
SIDEWAYS = 0.1  # of the pressure: shear that any node may have
WHOLE = 0.015  # of a force: std of what nodes do not show of it
FLOOR = 1e-4  # of the variance of a pressure, that any node may have of its own
MOST = 3  # contacts
WORTH = 8.0  # log evidence that a contact must bring: what its place, radius, size and ratios are worth by chance
KEPT, PRODUCTS, PARTS = 100, 1000, 4  # discs, their products, sets of readings
TURN, OPEN = 0.02, 1.0  # step of a derivative by log size and ratios; the largest std of these
TURNS, QUICK = 8, 3  # steps to sizes and ratios; where discs are compared
NEARLY = 2.0  # of log evidence, that better sizes and ratios may bring
SETTLED = 2  # starts that are followed
WAYS, APART, HALF = 4, 0.7, 3  # of splitting a disc: directions, radii to either side, steps of radius
WEIGHT = 0.02  # of the likeliest disc, below which one is left out of the average


@dataclass(frozen=True)
class Disc:
    """Place and radius in steps of the lattice."""

    x: int
    y: int
    radius: int


@dataclass(frozen=True, eq=False)
class Window:
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


@dataclass(frozen=True, eq=False)
class LocalLoad:
    """Load (n,), its std (n,), covariance of its resultant (6, 6), number of contacts, and the fit that weighs most."""

    load: Array
    std: Array
    wrench: Array
    best: Fitted


@dataclass(eq=False)
class ContactFit:
    """Contacts of a frame; `places` (P, 3) of the nodes and thickness in m.

    `moved` (m, q) are whitened readings of a std of each motion of the image.
    """

    problem: GaussianProblem
    places: Array
    thickness: float
    moved: Array
    _known: dict[Disc, Window] = field(default_factory=dict, init=False)
    _products: dict[tuple[Disc | None, Disc | None], Array] = field(default_factory=dict, init=False)
    _parts: dict[bytes, ContactFit] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self.middle = (self.places[:, :2].min(axis=0) + self.places[:, :2].max(axis=0)) / 2
        self.reach = np.ptp(self.places[:, :2], axis=0) / 2
        self.pitch = float(np.sqrt(np.prod(2 * self.reach) / max(len(self.places), 1)))
        noise = self.problem.noise[:, None]
        self.mesh = [e.change * (e.weight / noise) for e in self.problem.errors() if e.of_mesh]
        self.tolerances = [e.change / noise for e in self.problem.errors() if not e.of_mesh]
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

    def _made(self, disc: Disc, count: int) -> Window:
        nodes = np.flatnonzero(self.inside(disc))
        C = self._covariance(disc, nodes)
        values, vectors = np.linalg.eigh(C)
        kept = np.flatnonzero(values > FEW * values[-1])[-count:]
        modes = vectors[:, kept] * np.sqrt(values[kept])
        parts = [self.problem.whitened, *self.mesh]
        columns = [part[:, 3 * nodes + a] @ modes for part in parts for a in range(3)]
        finer = np.maximum(np.diag(C) - np.sum(modes**2, axis=1), 0.0)
        return Window(nodes, modes, np.hstack(columns), finer)

    def _covariance(self, disc: Disc, nodes: Index) -> Array:
        """Of a pressure of unit size at nodes (k,) of a disc."""
        w = self.inside(disc)[nodes]
        return np.asarray(w[:, None] * (self.problem.prior.matrix[np.ix_(nodes, nodes)] + EVEN) * w)

    def window(self, disc: Disc) -> Window:
        """Loads in a disc, made once."""
        found = self._known.get(disc)
        if found is None:
            found = self._made(disc, MODES)
            _kept(self._known, disc, found, KEPT)
        return found

    # -- evidence -----------------------------------------------------------------------------------------------------
    def _cross(self, one: Disc | None, other: Disc | None) -> Array:
        """Products of the columns of two discs, or of the image (None); made once."""
        found = self._products.get((one, other))
        if found is None:
            found = self._columns(one).T @ self._columns(other)
            _kept(self._products, (one, other), found, PRODUCTS)
            _kept(self._products, (other, one), found.T, PRODUCTS)
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

    def _turned(self, discs: tuple[Disc, ...], at: Array) -> list[Array]:
        """T (3, 3) of each disc: what x, y, z are of the pressure and of the shears of their own."""
        out = []
        for size, u, v in at.reshape(-1, 3):
            out.append(np.exp(size) * np.array([[u, OWN, 0.0], [v, 0.0, OWN], [1.0, 0.0, 0.0]]))
        return out

    def _spread(self, discs: tuple[Disc, ...], at: Array) -> Array:
        """T (N, N) of all columns."""
        blocks = []
        for disc, small in zip(discs, self._turned(discs, at), strict=True):
            window = self.window(disc)
            q = window.modes.shape[1]
            blocks += [np.kron(small, np.eye(q))] * (window.columns.shape[1] // (3 * q))
        N = sum(len(b) for b in blocks) + self.moved.shape[1]
        T, k = np.eye(N), 0
        for b in blocks:
            T[k : k + len(b), k : k + len(b)] = b
            k += len(b)
        return T

    def _slopes(self, discs: tuple[Disc, ...], at: Array, D: Array) -> Array:
        """Derivative of the evidence by size and ratios of each disc, D (N, N) being that by T."""
        out, k = np.zeros((len(discs), 3)), 0
        for j, (disc, small) in enumerate(zip(discs, self._turned(discs, at), strict=True)):
            window = self.window(disc)
            q = window.modes.shape[1]
            for _ in range(window.columns.shape[1] // (3 * q)):
                block = D[k : k + 3 * q, k : k + 3 * q].reshape(3, q, 3, q)
                small_D = np.einsum("aibi->ab", block)
                out[j, 0] += np.sum(small_D * small)
                out[j, 1:] += np.exp(at[3 * j]) * small_D[:2, 0]
                k += 3 * q
        return out.ravel()

    def _value(self, z: Array, discs: tuple[Disc, ...], at: Array, sloping: bool = True) -> tuple[float, Array]:
        """Evidence at sizes and ratios (3 J,), and its derivative where it is asked for."""
        G = self._gram(discs)
        b, T = np.concatenate([self._columns(d).T @ z for d in (*discs, None)]), self._spread(discs, at)
        GT = G @ T
        factor = np.linalg.cholesky(T.T @ GT + np.eye(len(G)))
        half = solve_triangular(factor, T.T @ b, lower=True, check_finite=False)
        ratios = at.reshape(-1, 3)[:, 1:]
        value = -0.5 * (z @ z - half @ half) - np.sum(np.log(np.diag(factor))) - 0.5 * np.sum(ratios**2) / self.shear**2
        if not sloping:
            return float(value), np.empty(0)
        m = solve_triangular(factor, half, lower=True, trans="T", check_finite=False)
        slope = self._slopes(discs, at, np.outer(b - GT @ m, m) - cho_solve((factor, True), GT.T, check_finite=False).T)
        slope.reshape(-1, 3)[:, 1:] -= ratios / self.shear**2
        return float(value), slope

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

    # -- search -------------------------------------------------------------------------------------------------------
    @cached_property
    def _looks(self) -> tuple[list[Disc], Array, Array]:
        """Discs of the first look, their columns (m, discs * c) turned to their own axes, and variances (discs, c)."""
        h = STEP * self.thickness
        half = [int(r / h / COARSE) * COARSE for r in self.reach]
        radius = round(np.log(0.7 / SMALLEST) / np.log(GROWING))
        discs = [Disc(x, y, radius) for x in range(-half[0], half[0] + 1, COARSE)
                 for y in range(-half[1], half[1] + 1, COARSE)]  # fmt: skip
        discs = [d for d in discs if self.allowed(d)]
        share = np.sqrt(self.problem.prior.share)
        turned, values = [], []
        for disc in discs:
            w = self._made(disc, LOOKED)
            q = w.modes.shape[1]
            A = w.columns[:, : 3 * q] * np.repeat(share, q)
            A = np.pad(A, ((0, 0), (0, 3 * (LOOKED - q))))
            U, s, _ = np.linalg.svd(A, full_matrices=False)
            turned.append(U)
            values.append(s**2)
        return discs, np.hstack(turned), np.array(values)

    def look(self, z: Array, known: Fitted) -> list[tuple[Disc, float]]:
        """Discs that explain most of readings (m,) beside known contacts, and log of their size; one of each place."""
        discs, columns, values = self._looks
        on = (columns.T @ self._left(z, known)).reshape(len(discs), values.shape[1])
        v = SIZES[:, None, None] ** 2 * values
        gain = 0.5 * np.sum(on**2 * v / (1 + v) - np.log1p(v), axis=2)
        best, size = gain.max(axis=0), np.log(SIZES[np.argmax(gain, axis=0)])
        out: list[tuple[Disc, float]] = []
        for k in np.argsort(-best):
            if best[k] < best.max() - WORTH or len(out) == LOOKS:
                break
            if all(np.hypot(discs[k].x - d.x, discs[k].y - d.y) > 2 * COARSE for d, _ in out):
                out.append((discs[k], float(size[k])))
        return out

    def _left(self, z: Array, known: Fitted) -> Array:
        """What known contacts and the image do not explain of readings."""
        columns, G, T = self._all(known.discs), self._gram(known.discs), self._spread(known.discs, known.at)
        m = np.linalg.solve(T.T @ G @ T + np.eye(len(G)), T.T @ (columns.T @ z))
        return np.asarray(z - columns @ (T @ m))

    def settled(self, z: Array, found: Fitted, seen: dict[tuple[Disc, ...], Fitted]) -> Fitted:
        """The likeliest discs near some, by steps in place and radius."""

        def at(discs: tuple[Disc, ...]) -> Fitted:
            if discs not in seen:
                seen[discs] = self.fitted(z, discs, found.at, found.evidence - NEARLY, QUICK)
            return seen[discs]

        for step in (2, 1):
            while True:
                before = found
                for j in range(len(found.discs)):
                    for move in ((step, 0, 0), (0, step, 0), (0, 0, step)):
                        for sign in (1, -1):
                            d = found.discs[j]
                            other = Disc(d.x + sign * move[0], d.y + sign * move[1], d.radius + sign * move[2])
                            if not self.allowed(other):
                                continue
                            tried = at((*found.discs[:j], other, *found.discs[j + 1 :]))
                            if tried.evidence > found.evidence:
                                found = tried
                                break
                if found is before:
                    break
        seen[found.discs] = found = self.fitted(z, found.discs, found.at)
        return found

    def contacts(self, z: Array) -> list[Fitted]:
        """Contacts of whitened readings (m,), and others of nearly their evidence; none where nothing is found."""
        nothing = np.empty((0, 3))
        known = Fitted((), nothing, self._value(z, (), nothing.ravel())[0])
        best: list[Fitted] = []
        while len(known.discs) < MOST:
            seen: dict[tuple[Disc, ...], Fitted] = {}
            starts = [*self._one_more(z, known), *self._split(z, known)]
            starts.sort(key=lambda f: -f.evidence)
            starts = starts[: SETTLED if len(known.discs) < 2 else 1]
            found = max((self.settled(z, f, seen) for f in starts), key=lambda f: f.evidence)
            best += seen.values()
            if found.evidence < known.evidence + WORTH:
                break
            known = found
        if not known.discs:
            return []
        level = _score(known) + np.log(WEIGHT)
        return [f for f in best if _score(f) > level]

    def _one_more(self, z: Array, known: Fitted) -> list[Fitted]:
        """Known contacts and one that explains most of what they leave."""
        return [self.fitted(z, (*known.discs, disc), np.vstack([known.at, [size, 0.0, 0.0]]))
                for disc, size in self.look(z, known)[: 1 if known.discs else LOOKS]]  # fmt: skip

    def _split(self, z: Array, known: Fitted) -> list[Fitted]:
        """Known contacts with one of them split along several ways."""
        out = []
        for j, disc in enumerate(known.discs):
            radius = max(0, disc.radius - HALF)
            off = APART * SMALLEST * GROWING**disc.radius / STEP
            for turn in np.arange(WAYS) * np.pi / WAYS:
                x, y = (round(off * np.cos(turn)), round(off * np.sin(turn)))
                pair = Disc(disc.x + x, disc.y + y, radius), Disc(disc.x - x, disc.y - y, radius)
                if all(map(self.allowed, pair)):
                    discs = (*known.discs[:j], *known.discs[j + 1 :], *pair)
                    start = np.vstack([np.delete(known.at, j, axis=0), known.at[j], known.at[j]])
                    out.append(self.fitted(z, discs, start))
        return out

    # -- answer -------------------------------------------------------------------------------------------------------
    def on(self, seen: Mask) -> ContactFit:
        """The fit by some readings, kept for the next frame."""
        key = seen.tobytes()
        if key not in self._parts:
            part = ContactFit(self.problem.on(seen), self.places, self.thickness, self.moved[seen])
            _kept(self._parts, key, part, PARTS)
        return self._parts[key]

    def __call__(self, z: Array, wide: float = 1.0, level: float = -np.inf) -> LocalLoad | None:
        """Load of whitened readings (m,), NaN where lost, whose noise is `wide` times as large as stated.

        None where nothing presses, or where loads all over the surface, of log evidence `level`, are likelier.
        """
        seen = np.isfinite(z)
        if not seen.all():
            return self.on(seen)(z[seen], wide)
        z = z / wide
        found = self.contacts(z)
        if not found or max(map(_score, found)) < level:
            return None
        scores = np.array([_score(f) for f in found])
        weights = np.exp(scores - scores.max())
        weights = weights / weights.sum()
        best = found[int(np.argmax(weights))]
        R, n = self.problem.resultant, self.problem.H.shape[1]
        load, square, wrench = np.zeros(n), np.zeros(n), np.zeros((6, 6))
        for f, weight in zip(found, weights, strict=True):
            mean, variance, spread = self._posterior(z, f)
            made = R @ mean
            load += weight * mean
            square += weight * (variance + mean**2)
            wrench += weight * (spread + np.outer(made, made))
        made, apart = R @ load, self._apart(z, best)
        variance = square - load**2 + np.sum(apart**2, axis=1) + self._grain(load)
        felt = R @ apart
        wrench = wrench - np.outer(made, made) + felt @ felt.T + WHOLE**2 * np.outer(made, made)
        wrench[:3, :3] += (WHOLE * float(np.linalg.norm(made[:3]))) ** 2 * np.eye(3)
        return LocalLoad(wide * load, wide * np.sqrt(np.maximum(variance, 0.0)), wide**2 * wrench, best)

    def pressed(self, z: Array, local: LocalLoad, wide: float, friction: float | None) -> Pressed:
        """The load of readings (m,), NaN where lost, about the likeliest contacts that only presses, in its cone."""
        seen = np.isfinite(z)
        if not seen.all():
            return self.on(seen).pressed(z[seen], local, wide, friction)
        f, problem = local.best, self.problem
        held = np.zeros(len(self.places), bool)
        spread: Array = np.zeros((len(self.places),) * 2 + (3, 3))
        inner = [np.flatnonzero(self.inside(d)) for d in f.discs]
        for disc, nodes, small in zip(f.discs, inner, self._turned(f.discs, f.at), strict=True):
            held[nodes] = True
            C = self._covariance(disc, nodes) + FLOOR * np.eye(len(nodes))
            spread[np.ix_(nodes, nodes)] += C[:, :, None, None] * (small @ small.T)
        nodes = np.flatnonzero(held)
        n = 3 * len(nodes)
        C = spread[np.ix_(nodes, nodes)].transpose(0, 2, 1, 3).reshape(n, n)
        L = solve_triangular(np.linalg.cholesky(C), np.eye(n), lower=True)
        noise = np.eye(len(z)) + self.moved @ self.moved.T
        for disc, small in zip(f.discs, self._turned(f.discs, f.at), strict=True):
            w = self.window(disc)
            q = w.modes.shape[1]
            for k in range(3 * q, w.columns.shape[1], 3 * q):
                made = w.columns[:, k : k + 3 * q] @ np.kron(small, np.eye(q))
                noise += made @ made.T
        factor = np.linalg.cholesky(noise)
        columns = (3 * nodes[:, None] + np.arange(3)).ravel()
        H = solve_triangular(factor, problem.whitened[:, columns], lower=True)
        R = problem.resultant[:, columns]
        solver = RegionSolver(H, lambda _: L * np.tile(FLIP, len(nodes)), R, sparse.eye_array(len(nodes)), friction)
        nothing = Answer(np.zeros(n), np.zeros(n), np.zeros((6, 6)), np.zeros((n, 6)))
        found = solver.solve(solve_triangular(factor, z / wide, lower=True), np.ones(len(nodes), bool), None, nothing)
        load = np.zeros(problem.H.shape[1])
        load[columns] = wide * found.load
        return replace(found, load=load, std=local.std, wrench=local.wrench)

    def _grain(self, load: Array) -> Array:
        """Variance of each load (n,) by what the mesh cannot tell of one node."""
        near, size = self._near, np.abs(load).reshape(-1, 3)
        size = np.maximum.reduceat(size[near.indices], near.indptr[:-1], axis=0)
        size[:, :2] = np.maximum(size[:, :2], SIDEWAYS * size[:, 2:])
        return np.asarray((GRAIN * size).ravel() ** 2)

    @cached_property
    def _near(self) -> sparse.csr_array:
        return around(self.places, BESIDE * self.pitch)

    def _apart(self, z: Array, f: Fitted) -> Array:
        """What a std of each of the sizes and ratios, which the readings leave open, changes of the load (n, 3 J)."""
        at = f.at.ravel()
        curved, slopes = np.empty((len(at), len(at))), []
        for k in range(len(at)):
            step = np.zeros(len(at))
            step[k] = TURN
            up, down = at + step, at - step
            curved[k] = (self._value(z, f.discs, down)[1] - self._value(z, f.discs, up)[1]) / (2 * TURN)
            slopes.append((self._mean(z, f.discs, up) - self._mean(z, f.discs, down)) / (2 * TURN))
        w, V = np.linalg.eigh((curved + curved.T) / 2)
        return np.array(slopes).T @ (V / np.sqrt(np.maximum(w, 1.0 / OPEN**2)))

    def _mean(self, z: Array, discs: tuple[Disc, ...], at: Array) -> Array:
        """Load (n,) at sizes and ratios."""
        columns, G, T = self._all(discs), self._gram(discs), self._spread(discs, at)
        m = T @ np.linalg.solve(T.T @ G @ T + np.eye(len(G)), T.T @ (columns.T @ z))
        load, k = np.zeros((len(self.places), 3)), 0
        for disc in discs:
            w = self.window(disc)
            q = w.modes.shape[1]
            load[w.nodes] += w.modes @ m[k : k + 3 * q].reshape(3, q).T
            k += w.columns.shape[1]
        return load.ravel()

    def _posterior(self, z: Array, f: Fitted) -> tuple[Array, Array, Array]:
        """Mean and variance of the load (n,), covariance of its resultant (6, 6)."""
        columns = self._all(f.discs)
        T, n = self._spread(f.discs, f.at), self.problem.H.shape[1]
        L, finer = np.zeros((n, len(T))), np.zeros((len(self.places), 3))
        k = 0
        for disc, small in zip(f.discs, self._turned(f.discs, f.at), strict=True):
            w = self.window(disc)
            q = w.modes.shape[1]
            for a in range(3):
                L[3 * w.nodes + a, k + a * q : k + (a + 1) * q] = w.modes
            finer[w.nodes] += np.outer(w.finer, np.sum(small**2, axis=1))
            k += w.columns.shape[1]
        X, back = columns @ T, L @ T
        half, mean = _solved(X, back, z)
        for change in self.tolerances:  # of the load that is found without them
            X, back = np.column_stack([X, change @ mean]), np.column_stack([back, np.zeros(len(back))])
        if self.tolerances:
            half, mean = _solved(X, back, z)
        felt = self.problem.resultant @ half
        return mean, np.sum(half**2, axis=1) + finer.ravel(), felt @ felt.T


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


def _solved(X: Array, back: Array, z: Array) -> tuple[Array, Array]:
    """Load `back` x (n,) of readings z = X x + e, x and e white: half its covariance, half half', and its mean."""
    Q, R = np.linalg.qr(np.vstack([X, np.eye(X.shape[1])]))
    half = solve_triangular(R, back.T, trans="T").T
    return half, half @ (Q[: len(z)].T @ z)


def _score(found: Fitted) -> float:
    """Log evidence less what as many contacts are worth by chance."""
    return found.evidence - WORTH * len(found.discs)


def _kept(store: dict[Any, Any], key: Any, value: Any, most: int) -> None:
    """Keep a value beside at most so many others, the newest."""
    while len(store) >= most:
        store.pop(next(iter(store)), None)
    store[key] = value
