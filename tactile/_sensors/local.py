"""Loads about the contacts of one frame, in which shear goes with pressure: what presses anywhere leave open.

A press is in one place. Once that is known, loads act about it alone, and its shear is mostly one ratio times its
pressure, however that is distributed. Both together tell pressure where no normal motion is seen (shear in one
direction moves markers evenly, pressure moves them outward), and tie the sum of a pressure to its shape where a gel
near to incompressible hardly shows its sum. Unknown of every contact are a disc that holds it, its size and the two
ratios (`tactile._sensors.discs`); of these the evidence of the readings is maximised. Discs that the readings do not
tell apart are averaged by their evidence. Contacts are added as long as the readings ask for one more.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.linalg import solve_triangular

from .._arrays import Array, Mask
from .discs import GROWING, SMALLEST, STEP, Disc, DiscWindows, keep
from .evidence import SIZES, DiscModel, Fitted, shares
from .gaussian import around
from .inversion import FLIP, Answer, Pressed, RegionSolver

COARSE = 3  # steps between discs of the first look
LOOKED, LOOKS = 6, 2  # modes of these; places that are followed
GRAIN, BESIDE = 0.2, 1.6  # of the load within so many pitches: std of what a mesh cannot tell of one node
SIDEWAYS = 0.1  # of the pressure: shear that any node may have
WHOLE = 0.015  # of a force: std of what nodes do not show of it
FLOOR = 1e-4  # of the variance of a pressure, that any node may have of its own
MOST = 3  # contacts
MODELS = 128  # of discs, that are kept
WORTH = 8.0  # log evidence that a contact must bring: what its place, radius, size and ratios are worth by chance
PARTS = 4  # sets of readings that are kept
TURN, OPEN = 0.02, 1.0  # step of a derivative by log size and ratios; the largest std of these
QUICK = 3  # steps to sizes and ratios where discs are compared
NEARLY = 2.0  # of log evidence, that better sizes and ratios may bring
SETTLED = 2  # starts that are followed
HOPEFUL, BEHIND = 3.0, 25.0  # of log evidence: what one more contact must bring where it starts, a split may cost there
WAYS, APART, HALF = 4, 0.7, 3  # of splitting a disc: directions, radii to either side, steps of radius
WEIGHT = 0.02  # of the likeliest disc, below which one is left out of the average


@dataclass(frozen=True, eq=False)
class LocalLoad:
    """Load (n,), its std (n,), covariance of its resultant (6, 6), number of contacts, and the fit that weighs most."""

    load: Array
    std: Array
    wrench: Array
    best: Fitted


@dataclass(eq=False)
class ContactFit(DiscWindows):
    """Contacts of a frame."""

    _parts: dict[bytes, ContactFit] = field(default_factory=dict, init=False)
    _models: dict[tuple[Disc, ...], DiscModel] = field(default_factory=dict, init=False)

    def model(self, discs: tuple[Disc, ...]) -> DiscModel:
        """What readings tell of some discs, made once."""
        found = self._models.get(discs)
        if found is None:
            found = DiscModel(self, discs)
            keep(self._models, discs, found, MODELS)
        return found

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
            nodes, modes, _ = self.modes(disc, LOOKED)
            q = modes.shape[1]
            A = self.columns(nodes, modes)[:3].reshape(3 * q, -1).T * np.repeat(share, q)
            A = np.pad(A, ((0, 0), (0, 3 * (LOOKED - q))))
            U, s, _ = np.linalg.svd(A, full_matrices=False)
            turned.append(U)
            values.append(s**2)
        return discs, np.hstack(turned), np.array(values)

    def look(self, z: Array, known: Fitted) -> list[tuple[Disc, float]]:
        """Discs that explain most of readings (m,) beside known contacts, and log of their size; one of each place."""
        discs, columns, values = self._looks
        left = self.model(known.discs).left(z, known.at)
        on = (columns.T @ left).reshape(len(discs), values.shape[1])
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

    def settled(self, z: Array, found: Fitted, seen: dict[tuple[Disc, ...], Fitted]) -> Fitted:
        """The likeliest discs near some, by steps in place and radius."""

        def at(discs: tuple[Disc, ...]) -> Fitted:
            if discs not in seen:
                seen[discs] = self.model(discs).fitted(z, found.at, found.evidence - NEARLY, QUICK)
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
        seen[found.discs] = found = self.model(found.discs).fitted(z, found.at)
        return found

    def contacts(self, z: Array) -> list[Fitted]:
        """Contacts of whitened readings (m,), and others of nearly their evidence; none where nothing is found."""
        known = self.model(()).fitted(z, np.empty((0, 3)))
        best: list[Fitted] = []
        while len(known.discs) < MOST:
            seen: dict[tuple[Disc, ...], Fitted] = {}
            starts = [f for f in self._one_more(z, known) if f.evidence > known.evidence + HOPEFUL]
            starts += [f for f in self._split(z, known) if f.evidence > known.evidence - BEHIND]
            starts.sort(key=lambda f: -f.evidence)
            starts = starts[: SETTLED if len(known.discs) < 2 else 1]
            if not starts:
                break
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
        return [self.model((*known.discs, disc)).fitted(z, np.vstack([known.at, [size, 0.0, 0.0]]))
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
                    out.append(self.model(discs).fitted(z, start))
        return out

    # -- answer -------------------------------------------------------------------------------------------------------
    def on(self, seen: Mask) -> ContactFit:
        """The fit by some readings, kept for the next frame."""
        key = seen.tobytes()
        if key not in self._parts:
            part = ContactFit(self.problem.on(seen), self.places, self.thickness, self.moved[seen])
            keep(self._parts, key, part, PARTS)
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
        for disc, nodes, at in zip(f.discs, inner, f.at, strict=True):
            held[nodes] = True
            C = self.covariance(disc, nodes) + FLOOR * np.eye(len(nodes))
            spread[np.ix_(nodes, nodes)] += C[:, :, None, None] * shares(*at)
        nodes = np.flatnonzero(held)
        n = 3 * len(nodes)
        C = spread[np.ix_(nodes, nodes)].transpose(0, 2, 1, 3).reshape(n, n)
        L = solve_triangular(np.linalg.cholesky(C), np.eye(n), lower=True)
        noise = np.eye(len(z)) + self.moved @ self.moved.T
        for disc, at in zip(f.discs, f.at, strict=True):
            w = self.window(disc)
            small = np.linalg.cholesky(shares(*at))
            for part in w.made[1:]:
                made = w.basis @ np.einsum("ab,aqr->rbq", small, part).reshape(w.basis.shape[1], -1)
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
        at, model = f.at.ravel(), self.model(f.discs)
        told, slopes = model.told(z), []
        curved = -model.evidence(float(z @ z), told, at, order=2).curved
        for step in TURN * np.eye(len(at)):
            up, down = (self._spread(model, model.mean(told, at + sign * step)) for sign in (1, -1))
            slopes.append((up - down) / (2 * TURN))
        w, V = np.linalg.eigh(curved)
        return np.array(slopes).T @ (V / np.sqrt(np.maximum(w, 1.0 / OPEN**2)))

    def _spread(self, model: DiscModel, modes: list[Array]) -> Array:
        """Load (n,) of modes of every disc (3, q)."""
        load = np.zeros((len(self.places), 3))
        for w, m in zip(model.windows, modes, strict=True):
            load[w.nodes] += w.modes @ m.T
        return load.ravel()

    def _posterior(self, z: Array, f: Fitted) -> tuple[Array, Array, Array]:
        """Mean and variance of the load (n,), covariance of its resultant (6, 6)."""
        model = self.model(f.discs)
        nodes = np.unique(np.concatenate([w.nodes for w in model.windows]))
        L, finer = [], np.zeros((len(nodes), 3))
        for w, at in zip(model.windows, f.at, strict=True):
            here = np.searchsorted(nodes, w.nodes)
            modes = np.zeros((len(nodes), w.modes.shape[1]))
            modes[here] = w.modes
            L += [np.kron(modes, axis[:, None]) for axis in np.eye(3)]
            finer[here] += np.outer(w.finer, np.diag(shares(*at)))
        back, n = np.hstack(L), self.problem.H.shape[1]
        own = (3 * nodes[:, None] + np.arange(3)).ravel()
        mean, spread = model.posterior(z, f.at, np.empty((len(z), 0)))
        if self.tolerances:  # of the load that is found without them
            found = back @ mean
            changes = np.column_stack([found @ change[own] for change in self.tolerances])
            mean, spread = model.posterior(z, f.at, changes)
        felt = self.problem.resultant[:, own] @ back
        load, variance = np.zeros((2, n))
        load[own] = back @ mean
        variance[own] = np.maximum(np.einsum("ij,ij->i", back @ spread, back), 0.0) + finer.ravel()
        return load, variance, felt @ spread @ felt.T


def _score(found: Fitted) -> float:
    """Log evidence less what as many contacts are worth by chance."""
    return found.evidence - WORTH * len(found.discs)
