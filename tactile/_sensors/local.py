"""Loads about the contacts of one frame, in which shear goes with pressure: what presses anywhere leave open.

A press is in one place. Once that is known, loads act about it alone, and its shear is mostly one ratio times its
pressure, however that is distributed. Both together tell pressure where no normal motion is seen (shear in one
direction moves markers evenly, pressure moves them outward), and tie the sum of a pressure to its shape where a gel
near to incompressible hardly shows its sum. Unknown of every contact are a disc that holds it, its size and the two
ratios (`tactile._sensors.discs`); of these the evidence of the readings is maximised. Discs that the readings do not
tell apart are averaged by their evidence. Contacts are added as long as the readings ask for one more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.linalg import solve_triangular
from scipy.sparse.csgraph import connected_components
from scipy.special import ndtr

from structures._threads import one_thread

from .._arrays import Array, Index, Mask
from .discs import keep, shares
from .evidence import DiscModel, Fitted, Local
from .gaussian import around
from .inversion import Answer, Pressed, RegionSolver
from .looks import SEVERAL, Undetected
from .search import ContactSearch, score

GRAIN, BESIDE = 0.2, 1.6  # of the load within so many pitches: std of what a mesh cannot tell of one node
SIDEWAYS = 0.1  # of the pressure: shear that any node may have
WHOLE = 0.015  # of a force: std of what nodes do not show of it
SPREAD = 0.5  # of what changes when a load is spread over the nodes beside it: largest std of what no mesh tells of it
ERRING = 0.03  # of the largest reading: what errors of a model make of the others, in which no load is to be read
FLOOR = 1e-4  # of the variance of a pressure, that any node may have of its own
LEAST = 0.1  # of the variance of loads that may lie anywhere: what one about a contact has at least
PARTS = 4  # sets of readings that are kept
MANY = 8  # discs, of which loads that only press are averaged
TEMPERED = (1.4, 2.0)  # times the noise, of which they are averaged too
CELL = 1 / 16  # of the pitch squared times the Laplacian of a load: its mean over a cell less its value at the node
INNER = (
    4.0  # log evidence of what a contact must bring that is for its size and ratios, where these count by themselves
)
OPEN = 1.0  # the largest std of log size and ratios
TRUSTED = 2.0  # log of what a normal law at the maximum may be wrong by, where it stands for the evidence
NEGLIGIBLE = 1e-4  # weight of all that is left out
PULLING = 1e-3  # chance of a contact that pulls
ONE_SIDE, Z95, HALVINGS = 0.975, 1.96, 30  # of a normal law; steps to where a force is so likely to lie


@dataclass(frozen=True, eq=False)
class LocalLoad:
    """Load (n,), its std (n,), covariance of its resultant (6, 6), the fit that weighs most, and how well it fits.

    `rest` is the rms of the readings over what noise, contacts and the error of the mesh let expect; `likely` are the
    fits of largest weight, and these. The noise was taken for `wide` times as large as stated. `regions` are numbers of
    contacts that lie apart, and the chance of each.
    """

    load: Array
    std: Array
    wrench: Array
    best: Fitted
    rest: float
    likely: tuple[tuple[float, Fitted], ...]
    wide: float
    regions: Mapping[int, float]

    def beside(self, load: Array, variance: Array, least: Array) -> tuple[Array, Array]:
        """Mean and variance (n,) of this load and another (n,) of the same readings, that may lie anywhere.

        Each is smooth, or rough, where the other is not: their errors are hardly correlated (.1 on average), so that
        they are weighed by their variances. How far they lie apart is in the band, as that of two models; where that
        is less than both lead to expect, the variance of their mean is as much too large, and is taken half way there.
        Of a contact that noise hides loads anywhere tell no size: their variance is at `least` (n,) what this load has
        them be, where not their weight but the band is asked for.
        """
        own = np.maximum(self.std**2, LEAST * variance)
        weight = own / np.maximum(own + variance, np.finfo(float).tiny)  # of the other
        mean, apart = weight * load + (1 - weight) * self.load, (load - self.load) ** 2
        agreed = min(1.0, (1.0 + np.sum(apart) / max(np.sum(own + variance), np.finfo(float).tiny)) / 2)
        both = (1 - weight) ** 2 * own + weight**2 * np.maximum(variance, least)
        return mean, agreed * both + weight * (1 - weight) * apart


@dataclass(frozen=True, eq=False)
class Laid:
    """Where modes lie: `nodes` (k,), `shapes` of every disc (k, q), and what each mode does to the resultant `felt`.

    That is (6, modes); `axis` (modes,) is the direction of the load. Between its nodes a mesh knows no shape of a load:
    `wider` (m, modes) is what spreading them over the nodes beside changes of the readings.
    """

    nodes: Index
    shapes: list[Array]
    felt: Array
    axis: Index
    wider: Array

    def loads(self, modes: Array) -> Array:
        """Loads (k, 3) of modes (modes,), those of each disc along x, y and z."""
        ends = np.cumsum([3 * one.shape[1] for one in self.shapes])[:-1]
        each = zip(self.shapes, np.split(modes, ends), strict=True)
        return np.asarray(sum(one @ part.reshape(3, -1).T for one, part in each))


@dataclass(eq=False)
class ContactFit(ContactSearch):
    """Loads about the contacts of a frame."""

    _parts: dict[bytes, ContactFit] = field(default_factory=dict, init=False)

    def on(self, seen: Mask) -> ContactFit:
        """The fit by some readings, kept for the next frame."""
        key = seen.tobytes()
        if key not in self._parts:
            part = ContactFit(self.problem.on(seen), self.places, self.thickness, self.moved[seen])
            keep(self._parts, key, part, PARTS)
        return self._parts[key]

    @one_thread()
    def undetected(self, z: Array) -> Undetected:
        """A contact anywhere that readings (m,), NaN where lost, do not show, the resultant by its long tail."""
        seen = np.isfinite(z)
        if not seen.all():
            return self.on(seen).undetected(z[seen])
        found = super().undetected(z)
        return replace(found, wrench=_stretched(found.wrench, np.sqrt(SEVERAL) * _reach(*found.cases)))

    @one_thread()  # its matrices are too small to be shared
    def __call__(self, z: Array, wide: float = 1.0, level: float = -np.inf) -> LocalLoad | None:
        """Load of whitened readings (m,), NaN where lost, whose noise is `wide` times as large as stated.

        None where nothing presses, or where loads all over the surface, of log evidence `level`, are likelier.
        """
        seen = np.isfinite(z)
        if not seen.all():
            return self.on(seen)(z[seen], wide, level)
        z = z / wide
        found = self.contacts(z)
        if not found or max(map(score, found)) < level:
            return None
        cases = self._cases(z, found)
        R, n = self.problem.resultant, self.problem.H.shape[1]
        load, square, wrench = np.zeros(n), np.zeros(n), np.zeros((6, 6))
        for weight, mean, variance, spread in cases:
            made = R @ mean
            load += weight * mean
            square += weight * (variance + mean**2)
            wrench += weight * (spread + np.outer(made, made))
        made = R @ load
        variance = square - load**2 + self._grain(load)
        wrench = wrench - np.outer(made, made)
        weights, means = np.array([c[0] for c in cases]), np.array([R @ c[1] for c in cases])
        stds = np.sqrt(np.maximum([np.diag(c[3]) for c in cases], np.finfo(float).tiny))
        wrench = _stretched(wrench, _reach(weights, means, stds)) + WHOLE**2 * np.outer(made, made)
        F = made[:3]  # in size by the line before, in direction by this one
        wrench[:3, :3] += WHOLE**2 * (float(F @ F) * np.eye(3) - np.outer(F, F))
        best = max(found, key=score)
        by_noise = best.at + np.array([np.log(wide), 0.0, 0.0])  # of what is stated, not of what the model may err by
        rest = float(np.sqrt(self.model(best.discs).unlike(wide * z, by_noise) / len(z)))
        spread = wide * np.sqrt(np.maximum(variance, 0.0))
        return LocalLoad(wide * load, spread, wide**2 * wrench, best, rest, _likely(found), wide,
                         self._regions(found))  # fmt: skip

    @staticmethod
    def erring(z: Array, wide: float) -> float:
        """How many times as large as stated the noise of whitened readings (m,) is, for all that a model errs by."""
        return float(np.hypot(wide, ERRING * np.nanmax(np.abs(z), initial=0.0)))

    def _regions(self, found: list[Fitted]) -> dict[int, float]:
        """Chances of numbers of contacts: discs that overlap, or leave less than a pitch between them, are one."""
        weights = np.exp(np.array([score(f) for f in found]) - max(map(score, found)))
        out: dict[int, float] = {}
        for f, weight in zip(found, weights / weights.sum(), strict=True):
            centres = np.array([self.centre(d) for d in f.discs])
            radii = np.array([self.radius(d) for d in f.discs])
            apart = np.linalg.norm(centres[:, None] - centres, axis=2)
            count = int(connected_components(apart < radii[:, None] + radii + self.pitch)[0])
            out[count] = out.get(count, 0.0) + float(weight)
        return out

    def _cases(self, z: Array, found: list[Fitted]) -> list[tuple[float, Array, Array, Array]]:
        """Weights (sum 1), and mean and variance of the load (n,), covariance of its resultant (6, 6), of what may be.

        Discs by their evidence; of each, places about its sizes and ratios by theirs (a spherical rule of third degree
        of the normal law at the maximum, I. Arasaratnam & S. Haykin, IEEE Trans. Autom. Control 54 (2009) 1254).
        """
        asked = []
        for f in found:
            model = self.model(f.discs, z)
            laid, worth = self._laid(model), score(f) + INNER * len(f.discs)
            asked += [(worth + weight, here, model, laid) for here, weight in self._about(z, f, model)]
        asked.sort(key=lambda one: -one[0])
        behind = np.cumsum(np.exp([one[0] - asked[0][0] for one in asked[::-1]]))[::-1]  # at most, and all after it
        most, out = 0.0, []
        for (weight, here, model, laid), rest in zip(asked, behind, strict=True):
            if rest < NEGLIGIBLE * most:
                break
            mean, variance, spread, pull = self._posterior(z, here, model, laid)
            weight = float(np.exp(weight - asked[0][0] + pull))
            most += weight
            out.append((weight, mean, variance, spread))
        return [(weight / most, a, b, c) for weight, a, b, c in out]

    def _about(self, z: Array, f: Fitted, model: DiscModel) -> list[tuple[Local, float]]:
        """Sizes and ratios about the likeliest of discs, and the log of what they weigh beside its evidence."""
        at, square = f.at.ravel(), float(z @ z)
        told, count = model.told(z), f.at.size
        w, V = np.linalg.eigh(-model.curved(model.evidence(square, told, at), exactly=True)[1])
        w = np.maximum(w, 1.0 / OPEN**2)
        room = -float(np.sum(np.log(w))) / 2 - np.log(2 * count)
        out = []
        for step in np.sqrt(count) * (V / np.sqrt(w)).T:
            for here in (model.evidence(square, told, at + step), model.evidence(square, told, at - step)):
                worth = here.value - f.evidence + count / 2
                out.append((here, room + float(np.clip(worth, -TRUSTED, TRUSTED))))
        return out

    @one_thread()
    def pressed(self, z: Array, local: LocalLoad, friction: float | None, normals: Array | None = None) -> Pressed:
        """The load of readings (m,), NaN where lost, about the likeliest contacts that only presses, in its cone.

        What a model errs by under a contact no far marker shows, and a load in its cone fits it: the likelihood is
        tempered (P. Grünwald & T. van Ommen, Bayesian Anal. 12 (2017) 1069), as long as contacts are found. As the best
        temper is not known, loads of several are averaged; the band is that of `local`. `normals` (P, 3) are those of a
        curved surface.
        """
        seen = np.isfinite(z)
        if not seen.all():
            return self.on(seen).pressed(z[seen], local, friction, normals)
        here, parts = local, [self.within_cone(z, local, friction, normals)]
        for times in TEMPERED:
            found = self.contacts(z / (times * local.wide))
            if found:
                here = replace(local, likely=_likely(found), wide=times * local.wide)
            parts.append(self.within_cone(z, here, friction, normals))
        load, converged = np.mean([p.load for p in parts], axis=0), all(p.converged for p in parts)
        return replace(parts[0], load=self.cell_means(load), steps=sum(p.steps for p in parts), converged=converged)

    def cell_means(self, load: Array) -> Array:
        """Means of a load (n,) over the cell about each node; constants and forces stay.

        They differ from its values by the pitch squared times its Laplacian: by a 24th of it where the load is smooth,
        by an eighth where it is linear between nodes, as the mesh takes it. `CELL` lies between.
        """
        return np.asarray((self._cells @ load.reshape(-1, 3)).ravel())

    @cached_property
    def _cells(self) -> sparse.csr_array:
        near, area = self._near.tocoo(), self.problem.resultant[2, 2::3]
        share = CELL / 3 * np.minimum(area[near.row], area[near.col])  # of each of eight nodes beside
        flow = sparse.csr_array((share, (near.row, near.col)), shape=near.shape)
        out = flow - sparse.diags_array(flow.sum(axis=1))
        return sparse.csr_array(sparse.eye_array(len(area)) + sparse.diags_array(1 / area) @ out)

    def within_cone(self, z: Array, local: LocalLoad, friction: float | None, normals: Array | None = None) -> Pressed:
        """The load about contacts as they are: what presses, or lies in a cone, does on the average of `likely`."""
        found = [self._pressed(z, f, local.wide, friction, normals) for _, f in local.likely]
        load = np.asarray(sum(w * p.load for (w, _), p in zip(local.likely, found, strict=True)))
        return Pressed(load, local.std, local.wrench, sum(p.steps for p in found), all(p.converged for p in found))

    def _pressed(self, z: Array, f: Fitted, wide: float, friction: float | None, normals: Array | None) -> Pressed:
        """The same of the discs of one fit."""
        problem = self.problem
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
        own = None if normals is None else normals[nodes]
        solver = RegionSolver(H, lambda _: L, R, sparse.eye_array(len(nodes)), friction, own)
        nothing = Answer(np.zeros(n), np.zeros(n), np.zeros((6, 6)), np.zeros((n, 6)))
        found = solver.solve(solve_triangular(factor, z / wide, lower=True), np.ones(len(nodes), bool), None, nothing)
        load = np.zeros(problem.H.shape[1])
        load[columns] = wide * found.load
        return replace(found, load=load)

    def _grain(self, load: Array) -> Array:
        """Variance of each load (n,) by what the mesh cannot tell of one node."""
        near, size = self._near, np.abs(load).reshape(-1, 3)
        size = np.maximum.reduceat(size[near.indices], near.indptr[:-1], axis=0)
        size[:, :2] = np.maximum(size[:, :2], SIDEWAYS * size[:, 2:])
        return np.asarray((GRAIN * size).ravel() ** 2)

    @cached_property
    def _near(self) -> sparse.csr_array:
        return around(self.places, BESIDE * self.pitch)

    @cached_property
    def _beside(self) -> sparse.csc_array:
        """Every load spread over its node and those beside it, its sum kept (P, P)."""
        return sparse.csc_array(self._near / self._near.sum(axis=0))

    def _laid(self, model: DiscModel) -> Laid:
        """Where the modes of discs lie, and what spreading them changes."""
        nodes = np.unique(np.concatenate([w.nodes for w in model.windows]))
        shapes = []
        for w in model.windows:
            modes = np.zeros((len(nodes), w.modes.shape[1]))
            modes[np.searchsorted(nodes, w.nodes)] = w.modes
            shapes.append(modes)
        axis = np.concatenate([np.repeat(np.arange(3), modes.shape[1]) for modes in shapes])
        R = self.problem.resultant.reshape(6, -1, 3)[:, nodes].transpose(0, 2, 1)
        felt = np.hstack([(R @ modes).reshape(6, -1) for modes in shapes])
        wider = [self._beside[:, nodes] @ modes for modes in shapes]
        for more, modes in zip(wider, shapes, strict=True):
            more[nodes] -= modes
        there = np.flatnonzero(np.any(np.hstack(wider), axis=1))
        H = self.problem.whitened.reshape(len(self.problem.noise), -1, 3)[:, there].transpose(0, 2, 1)
        moved = np.hstack([(H @ more[there]).reshape(len(H), -1) for more in wider])
        return Laid(nodes, shapes, felt, axis, SPREAD * moved)

    def _posterior(self, z: Array, here: Local, model: DiscModel, laid: Laid) -> tuple[Array, Array, Array, float]:
        """Mean and variance of the load (n,), covariance of its resultant (6, 6), log chance that all discs press."""

        def changes(mean: Array) -> Array:  # of the load that is found without them
            found, columns = laid.loads(mean).ravel(), (3 * laid.nodes[:, None] + np.arange(3)).ravel()
            return np.column_stack([laid.wider @ mean, *(found @ c[columns] for c in self.tolerances)])

        mean, spread = model.posterior(here, z, changes)
        load, variance = np.zeros((2, len(self.places), 3))
        load[laid.nodes] = laid.loads(mean)
        all_shapes = np.hstack(laid.shapes)
        for a in range(3):
            own = np.flatnonzero(laid.axis == a)
            variance[laid.nodes, a] = np.einsum("ij,ij->i", all_shapes @ spread[np.ix_(own, own)], all_shapes)
        variance = np.maximum(variance, 0.0)
        for w, at in zip(model.windows, here.at.reshape(-1, 3), strict=True):
            variance[w.nodes] += np.outer(w.finer, np.diag(shares(*at)))
        pull = _pressing(laid.felt[2], mean, spread, model.modes)
        return load.ravel(), variance.ravel(), laid.felt @ spread @ laid.felt.T, pull


def _likely(found: list[Fitted]) -> tuple[tuple[float, Fitted], ...]:
    """The fits of largest evidence, and their weights, of sum 1."""
    best = sorted(found, key=score)[: -MANY - 1 : -1]
    weights = np.exp(np.array([score(f) for f in best]) - score(best[0]))
    return tuple(zip((weights / weights.sum()).tolist(), best, strict=True))


def _reach(weights: Array, means: Array, stds: Array) -> Array:
    """Std (q,) of a normal law about the mean of cases, (k,) and (k, q), that holds 95 % of them to either side.

    A force that is told by its shear has a long tail: it is a small shear over a ratio that is hardly known.
    """
    middle, out = weights @ means / np.sum(weights), np.zeros(means.shape[1])
    for sign in (1.0, -1.0):
        low, high = np.zeros_like(out), np.max(np.abs(means - middle) + 10 * stds, axis=0)
        for _ in range(HALVINGS):
            half = (low + high) / 2
            inside = weights @ ndtr((half - sign * (means - middle)) / stds)
            low, high = np.where(inside < ONE_SIDE, half, low), np.where(inside < ONE_SIDE, high, half)
        out = np.maximum(out, high / Z95)
    return out


def _stretched(covariance: Array, std: Array) -> Array:
    """A covariance (q, q) whose std are at least these (q,), correlations kept."""
    longer = np.maximum(std / np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny)), 1.0)
    return np.asarray(np.outer(longer, longer) * covariance)


def _pressing(felt: Array, mean: Array, spread: Array, counts: list[int]) -> float:
    """Log chance that each disc presses, of so many modes each, their mean and covariance; `felt` (modes,) gives Fz."""
    own = np.repeat(np.eye(len(counts)), counts, axis=1) * felt
    force, std = own @ mean, np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", own, spread, own), np.finfo(float).tiny))
    return float(np.sum(np.log(np.maximum(ndtr(-force / std), PULLING))))
