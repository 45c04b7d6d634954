"""One contact anywhere: discs on a coarse lattice, of any size, and what a load may be that readings do not show.

Readings of a disc are weighed as they stand out of noise and of every motion of the image. How large a contact is that
nobody found is not told by its evidence, which is alike for all that noise hides: a force counts by its cube, so that
what may be hidden is as large as readings allow.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .._arrays import Array, Index
from .discs import GROWING, SMALLEST, STEP, Disc, DiscWindows
from .evidence import SIZES, DiscModel

COARSE = 3  # steps between discs of the first look
LOOKED = 6  # modes of these
RADII = (0.4, 0.7)  # of these, in thicknesses
LARGE = 3  # power of its force by which a contact counts that is not found
SEVERAL = 2  # contacts that may be hidden at once, whose forces add up
NEVER = 1e-6  # weight of the likeliest, below which a disc is none of those


@dataclass(frozen=True, eq=False)
class Look:
    """Loads in a disc along directions of readings that are told apart, per unit of size.

    `loads` (k, 3, c) at `nodes` (k,), their resultant `felt` (6, c), and `variances` (c,) of their readings over noise.
    """

    disc: Disc
    nodes: Index
    loads: Array
    felt: Array
    variances: Array


@dataclass(frozen=True, eq=False)
class Undetected:
    """Load (n,) that readings do not show: its mean, and mean squares about it.

    Of the resultant `wrench` (6, 6), of several contacts; of every load, as there is one at its node, `variance` (n,).
    `cases` are weights (k,), means and std (k, 6) of the resultant of one.
    """

    load: Array
    variance: Array
    wrench: Array
    cases: tuple[Array, Array, Array]

    def times(self, wide: float) -> Undetected:
        """The same of readings over a noise that is as many times as large."""
        weights, means, stds = self.cases
        square = wide**2
        return Undetected(
            wide * self.load, square * self.variance, square * self.wrench, (weights, wide * means, wide * stds)
        )


@dataclass(eq=False)
class FirstLook(DiscWindows):
    """Discs all over a surface, held against readings one by one."""

    @cached_property
    def looks(self) -> list[Look]:
        """All of them, the widest last."""
        return [one for one, _ in self._made]

    @cached_property
    def _made(self) -> list[tuple[Look, Array]]:
        """Looks, and what gives their readings (m, c) of whitened ones: in single precision, as these are many."""
        h = STEP * self.thickness
        half = [int(r / h / COARSE) * COARSE for r in self.reach]
        radii = [round(np.log(r / SMALLEST) / np.log(GROWING)) for r in RADII]
        discs = [Disc(x, y, r) for r in radii for x in range(-half[0], half[0] + 1, COARSE)
                 for y in range(-half[1], half[1] + 1, COARSE)]  # fmt: skip
        return [self._look(d) for d in discs if self.allowed(d)]

    def _look(self, disc: Disc) -> tuple[Look, Array]:
        share = np.sqrt(self.problem.prior.share)
        nodes, modes, _ = self.modes(disc, LOOKED)
        k, q = modes.shape
        A = self.columns(nodes, modes)[:3].reshape(3 * q, -1).T * np.repeat(share, q)
        A = np.pad(A, ((0, 0), (0, 3 * (LOOKED - q))))
        _, s, V = np.linalg.svd(self._still(A), full_matrices=False)
        V = V[:, : 3 * q]
        loads = np.einsum("kq,caq->kac", modes, V.reshape(-1, 3, q)) * share[:, None]
        R = self.problem.resultant.reshape(6, -1, 3)[:, nodes].reshape(6, -1)
        turned = A[:, : 3 * q] @ V.T / np.maximum(s, np.finfo(float).tiny)
        return Look(disc, nodes, loads, R @ loads.reshape(3 * k, -1), s**2), turned.astype(np.float32)

    def _still(self, A: Array) -> Array:
        """Readings (m, c) over the root of their covariance where the image moves, in the directions of its motion."""
        u, s, _ = np.linalg.svd(self.moved, full_matrices=False)
        return np.asarray(A - u @ ((1 - 1 / np.sqrt(1 + s**2))[:, None] * (u.T @ A)))

    @cached_property
    def _variances(self) -> Array:
        """Of directions of all looks (discs, c)."""
        return np.array([one.variances for one in self.looks])

    @cached_property
    def _forces(self) -> Array:
        """Normal force (discs,) of a load of unit size: its std."""
        return np.array([np.linalg.norm(one.felt[2]) for one in self.looks])

    def gains(self, rest: Array) -> tuple[Array, Array, Array]:
        """Log evidence (sizes, discs) of one disc of a size beside none, in what is left of readings (m,).

        And the variances of directions over their noise (sizes, discs, c), and readings along these (discs, c).
        """
        seen = rest.astype(np.float32)
        on = np.array([turned.T @ seen for _, turned in self._made], float)
        v = SIZES[:, None, None] ** 2 * self._variances
        return 0.5 * np.sum(on**2 * v / (1 + v) - np.log1p(v), axis=2), v, on

    def nothing(self, z: Array) -> float:
        """Log evidence of readings (m,) where nothing presses and the image may have moved."""
        model = DiscModel(self, ())
        return model.evidence(float(z @ z), model.told(z), np.empty(0)).value

    def undetected(self, z: Array) -> Undetected:
        """A contact anywhere that readings (m,) do not show."""
        gain, v, on = self.gains(DiscModel(self, ()).left(z, np.empty((0, 3))))
        size = SIZES[:, None]
        weights = np.exp(gain - gain.max()) * (size * self._forces) ** LARGE
        kept = np.flatnonzero(weights.max(axis=0) > NEVER * weights.max())
        weights = weights[:, kept] / weights[:, kept].sum()
        first, second, there = (np.zeros((len(self.places), c)) for c in (3, 3, 1))
        (forces, spreads), wrench = np.zeros((2, len(kept), len(SIZES), 6)), np.zeros((6, 6))
        for k, (d, w) in enumerate(zip(kept, weights.T, strict=True)):
            one, faint = self.looks[d], 1 + v[:, d]
            mean, variance = size * np.sqrt(v[:, d]) / faint * on[d], size**2 / faint  # (sizes, c)
            loads = one.loads @ mean.T  # (k, 3, sizes)
            first[one.nodes] += loads @ w
            second[one.nodes] += loads**2 @ w + one.loads**2 @ (w @ variance)
            there[one.nodes] += w.sum()
            forces[k], spreads[k] = mean @ one.felt.T, variance @ (one.felt**2).T
            wrench += one.felt @ (np.diag(w @ variance) + (mean.T * w) @ mean) @ one.felt.T
        about = (second - 2 * first**2) / np.maximum(there, np.finfo(float).tiny) + first**2
        made = self.problem.resultant @ first.ravel()
        cases = weights.T.ravel(), forces.reshape(-1, 6), np.sqrt(spreads.reshape(-1, 6))
        wrench = SEVERAL * (wrench - np.outer(made, made))
        return Undetected(first.ravel(), np.maximum(about, 0.0).ravel(), wrench, cases)
