"""Loads that are contacts, and a model that errs: one linear Gaussian problem.

    y = (H + dH) t + e,   t ~ s^2 C,   e ~ R,   lambda = 1 / s

With ``S = H C H' + dH C dH' + lambda^2 R`` the load is ``t = C H' S^-1 y``, one product, and ``I - lambda^2 R S^-1``
predicts every reading from all (A. Tarantola, Inverse Problem Theory, SIAM 2005, ch. 3; errors of a model beside noise:
J. Kaipio & E. Somersalo, J. Comput. Appl. Math. 198 (2007) 493).

The std of a Gaussian posterior would be that of the average over a pad most of which carries nothing. But errors are
where the load is: of a unit of prior variance at a node the readings leave a known share unseen (``(I - G H) C (I - G
H)'``), and errors of the model a known share misread (``G dH C dH' G'``). Both are multiplied by the size of the load
around the node, as it was found and over the share of it that could be found. The mesh's error is told by the same pad
with half the mesh (L. F. Richardson, Phil. Trans. R. Soc. A 210 (1911) 307), errors of E, nu and thickness by its
derivatives.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from loadid._families.static import StaticInversion
from loadid._inverse.problem import NoiseSourceLike
from loadid.settings import Noise
from structures._channels import Channel
from structures._models.arrays import MatrixModel
from structures.errors import InputError

from .._arrays import Array, Index, Mask
from .inversion import LARGE, Inverse
from .prior import PosedPrior

if TYPE_CHECKING:
    from scipy import sparse

    from .image import PosedMotion

SEEN = 0.02  # least share of the variance of a component from which its size is told
SHARE, CLEAR = 0.25, 5.0  # of the largest load, and of the noise, above which a node is loaded
MESH = "mesh"
ROUNDING = 1e-14  # over the trace: what keeps a Cholesky factor of the data real
FEW = 12  # readings
FAINT = 1e-3  # of the variance of the largest load, below which one tells nothing of the resultant's band
SIDEWAYS = 0.1  # shear over pressure that any contact may have, unseen


@dataclass(frozen=True, eq=False)
class ModelError:
    """What one std of an error of the model adds to the transfer matrix (m, n), by name.

    `weight` is by how much it counts more where a load is found than in its band.
    """

    name: str
    change: Array
    weight: float = 1.0

    @property
    def of_mesh(self) -> bool:
        """Whether it is another error for every load, as that of a mesh; not one for all, as that of a modulus."""
        return self.name == MESH


@dataclass(eq=False)
class Errors:
    """Errors of a model, found when they are first asked for; of some readings (`rows`) and loads (`columns`)."""

    find: Callable[[], Sequence[ModelError]]
    rows: Any = None
    columns: Any = None
    _found: list[ModelError] | None = None

    def __call__(self) -> list[ModelError]:
        """All of them."""
        if self._found is None:
            self._found = [replace(e, change=self._cut(e.change)) for e in self.find()]
        return self._found

    def _cut(self, change: Array) -> Array:
        cut = change if self.rows is None else change[self.rows]
        return np.asarray(cut if self.columns is None else cut[:, self.columns])


@dataclass(frozen=True, eq=False)
class ErrorRows:
    """Of one error of the model: changes of the resultant (6, n) of a load, and variances (n,) of a prior unit."""

    rows: Array
    spread: Array


@dataclass(frozen=True, eq=False)
class ForceBand:
    """How far loads may be off that were found by one product: variances by noise, by what is unseen, by the model.

    `resultant` (6, n) is that of unit loads. `noise` (n,) is the variance by noise, `unseen` (n,) that of a unit of
    prior variance, `found` (n,) the share of such a unit that is found. `asked` (6, m) are resultants of whitened
    readings; `missed` (6, n) is what they lack of a load, `errors` what errors of the model make of it. `near` gives,
    for the nodes of the surface, those around them.
    """

    prior: PosedPrior
    resultant: Array
    noise: Array
    unseen: Array
    found: Array
    asked: Array
    missed: Array
    errors: Sequence[ErrorRows]
    near: Any

    def sizes(self, load: Array) -> Array:
        """Variance around each load (n,) over that of the prior, as a load (n,) that was found tells."""
        beyond = np.maximum(load**2 - self.noise, 0.0).reshape(-1, 3)
        unit = (self.found * self.prior.variance).reshape(-1, 3)
        least = SEEN * self.prior.variance.reshape(-1, 3)
        normal = beyond[:, 2] / np.maximum(unit[:, 2], least[:, 2])
        shear = beyond[:, :2].sum(axis=1) / np.maximum(unit[:, :2], least[:, :2]).sum(axis=1)
        normal, shear = (_largest(self.near, v) for v in (normal, shear))
        normal = np.maximum(normal, shear)  # what shears must press, seen or not
        shear = np.maximum(shear, SIDEWAYS**2 * self.prior.share[2] / self.prior.share[0] * normal)
        return np.column_stack([shear, shear, normal]).ravel()

    @cached_property
    def _rows(self) -> Array:
        """What resultants lack of a load, and what errors of the model make of them, under each other."""
        return np.vstack([self.missed, *(e.rows for e in self.errors)])

    @cached_property
    def _alike(self) -> Array:
        """What loads of one size everywhere add to the covariance of the resultant, by component (3, 6, 6)."""
        out = np.zeros((3, 6, 6))
        for c in range(3):
            rows = np.zeros_like(self._rows)
            rows[:, c::3] = self._rows[:, c::3]
            made = self.prior.times(rows)
            for k in range(0, len(rows), 6):
                out[c] += made[k : k + 6] @ rows[k : k + 6].T
        return out

    @cached_property
    def _noisy(self) -> Array:
        return np.asarray(self.asked @ self.asked.T)

    def loaded(self, load: Array, wide: float = 1.0) -> Mask:
        """Nodes (P,) that carry a load (n,): clear of noise, and no small share of the largest."""
        size = (load**2 / (np.maximum(self.found, SEEN) * self.prior.variance)).reshape(-1, 3).sum(axis=1)
        chance = (load**2 / (wide**2 * self.noise)).reshape(-1, 3).max(axis=1)
        return np.asarray((size > SHARE**2 * size.max(initial=0.0)) & (chance > CLEAR**2))

    def std(self, load: Array, wide: float) -> Array:
        """Std of each load (n,), where noise is `wide` times as large as stated."""
        return np.sqrt(wide**2 * self.noise + self.sizes(load) * self.prior.variance * self._shares)

    def left_open(self, load: Array, wide: float) -> Array:
        """Variance (n,) of what is found where there are loads of this size (n,), known otherwise, on and about it."""
        size = np.column_stack([_largest(self.near, part**2) for part in load.reshape(-1, 3).T]).ravel()
        return np.asarray(wide**2 * self.noise + size * self._shares)

    @cached_property
    def _shares(self) -> Array:
        """Variance (n,) of what is found of a unit of variance."""
        return sum((e.spread for e in self.errors), self.unseen)

    def covariance(self, load: Array, wide: float) -> Array:
        """Covariance (6, 6) of the resultant."""
        sizes = self.sizes(load)
        large = (sizes.reshape(-1, 3) > FAINT * sizes.max(initial=0.0)).any(axis=1)  # the others make no difference
        nodes = np.flatnonzero(large)
        out = wide**2 * self._noisy
        if 2 * len(nodes) > len(large):  # no contact: all of the surface is alike
            out = out + np.einsum("c,cij->ij", sizes.reshape(-1, 3).mean(axis=0), self._alike)
        else:
            columns = (3 * nodes[:, None] + np.arange(3)).ravel()
            local = self._rows[:, columns] * np.sqrt(sizes[columns])
            made = self.prior.among(nodes).times(local)
            for k in range(0, len(local), 6):
                out = out + made[k : k + 6] @ local[k : k + 6].T
        for error in self.errors:
            one = error.rows @ load
            out = out + np.outer(one, one)
        return np.asarray(out)

    def corrected(self, load: Array, force: Array) -> Array:
        """The load (n,) whose resultant is `force` (6,), changed where there is a load, as much as it is large."""
        R, sizes = self.resultant, self.sizes(load)
        root = np.sqrt(sizes) if np.any(sizes) else np.ones(len(load))
        local = root[:, None] * self.prior.times(R * root).T
        S = R @ local
        size = np.sqrt(np.maximum(np.diag(S), np.finfo(float).tiny))
        step = np.linalg.lstsq(S / size[:, None] / size, (force - R @ load) / size, rcond=1e-12)[0]
        return np.asarray(load + local @ (step / size))


def _largest(near: sparse.csr_array, values: Array) -> Array:
    """Largest of values (P,) around each node; every node is around itself."""
    return np.asarray(np.maximum.reduceat(values[near.indices], near.indptr[:-1]))


@dataclass(frozen=True, eq=False)
class GaussianProblem:
    """Readings of a sensor under a contact prior.

    Parameters
    ----------
    H : array (m, n)
        Readings per unit of each load.
    sensors : sequence of Channel
    noise : array (m,)
        Std of the readings.
    prior : PosedPrior
    motion : PosedMotion or None
        Of the whole image.
    errors : callable
        Gives those of the model, once.
    resultant : array (6, n)
    near : sparse (P, P)
        Nodes around each node.
    """

    H: Array
    sensors: Sequence[Channel]
    noise: Array
    prior: PosedPrior
    motion: PosedMotion | None
    errors: Callable[[], Sequence[ModelError]]
    resultant: Array
    near: Any

    def on(self, rows: Any) -> GaussianProblem:
        """The problem of some readings, a mask or a slice."""
        kept = np.arange(len(self.noise))[rows]
        if len(kept) == len(self.noise):
            return self
        return GaussianProblem(
            self.H[kept], [self.sensors[i] for i in kept], self.noise[kept], self.prior,
            None if self.motion is None else self.motion.of(kept),
            Errors(self.errors, rows=kept), self.resultant, self.near,
        )  # fmt: skip

    @cached_property
    def whitened(self) -> Array:
        """H of readings over their noise (m, n)."""
        return self.H / self.noise[:, None]

    @cached_property
    def _spread(self) -> tuple[Array, Array, Array]:
        """H C (m, n), H C H' (m, m), and the latter with the errors of the model, of readings over their noise."""
        HC = self.prior.times(self.whitened)
        K = HC @ self.whitened.T
        K = (K + K.T) / 2
        made = K
        for error in self.errors():
            change = error.change * (error.weight / self.noise[:, None])
            made = made + self.prior.times(change) @ change.T
        return HC, K, (made + made.T) / 2

    @property
    def covariance(self) -> Array:
        """Of readings over their noise (m, m), by loads of unit prior variance and the errors of the model."""
        return self._spread[2]

    @cached_property
    def scale(self) -> float:
        """Largest singular value of the whitened operator of all that a load and its errors make: lambda's unit."""
        from scipy.sparse.linalg import eigsh

        made = self._spread[2]
        if len(made) < FEW:
            return float(np.sqrt(np.linalg.eigvalsh(made)[-1]))
        return float(np.sqrt(eigsh(made, 1, v0=np.ones(len(made)), return_eigenvectors=False)[0]))

    def family(self, choice: Any, source: NoiseSourceLike, allow: Sequence[str]) -> StaticInversion:
        """The family whose rules choose lambda: the same data, in as many white coefficients as there are readings."""
        made = self._spread[2]
        roots = self.noise[:, None] * np.linalg.cholesky(made + ROUNDING * np.trace(made) * np.eye(len(made)))
        loads = [Channel(label=f"c{i}", quantity="arbitrary") for i in range(len(made))]
        return StaticInversion(
            MatrixModel(roots, sensors=list(self.sensors), loads=loads), penalty="identity", choice=choice,
            noise=Noise(source=source), allow=list(allow),
        )  # fmt: skip

    def erring(self, x: float) -> Array:
        """Lower factor (m, m) of the covariance of whitened readings by noise and model, for loads of a size 1 / x."""
        _, K, made = self._spread
        return np.asarray(np.linalg.cholesky(np.eye(len(K)) + (made - K) / x**2))

    def weights(self, x: float, nodes: Index) -> Array:
        """L (3 k, 3 k) of the tractions at some nodes, times an absolute lambda."""
        return x * self.prior.penalty(nodes)

    def inverse(self, lam: float, rule: str) -> Inverse:
        """One product from readings to loads, at a relative lambda, and its band.

        Raises
        ------
        InputError
            A lambda that is not positive: the prior would be without bound.
        """
        if not lam > 0:
            raise InputError("a contact prior takes a lambda above zero", where="choice", found=lam,
                             expected="> 0, or None", hint='penalty="identity" takes any')  # fmt: skip
        H, x = self.whitened, lam * self.scale
        HC, K, made = self._spread
        S = made + x**2 * np.eye(len(K))
        factor = cho_factor(S, lower=True, overwrite_a=True, check_finite=False)
        matrix = cho_solve(factor, HC, check_finite=False).T
        left = x**2 * cho_solve(factor, np.eye(len(K)), check_finite=False)  # of every reading, what no other predicts
        R = self.resultant
        RG = R @ matrix
        GK, C = matrix @ K, self.prior.variance
        both = np.einsum("nm,mn->n", matrix, HC)
        unseen = np.maximum(C - 2 * both + np.einsum("nm,nm->n", GK, matrix), 0.0)
        kept = np.ascontiguousarray(matrix, np.float32 if matrix.size > LARGE else float)
        band = ForceBand(
            prior=self.prior,
            resultant=R,
            noise=np.einsum("nm,nm->n", matrix, matrix),
            unseen=unseen / C,
            found=np.einsum("nm,nm->n", GK, matrix) / C,
            asked=RG,
            missed=RG @ H - R,
            errors=[self._error(e, RG, matrix, C) for e in self.errors()],
            near=self.near,
        )
        return Inverse(
            matrix=kept,
            influence=np.eye(len(K)) - left,
            noise=self.noise,
            std=np.sqrt(np.maximum(C - both, 0.0)) / x,
            resultant=R,
            reach=self._reach(factor, HC, x),
            loss=RG @ H - R,
            lam=float(lam),
            scale=self.scale,
            rule=rule,
            band=band,
        )

    def _reach(self, factor: Any, HC: Array, x: float) -> Array:
        """Posterior covariance of the load with its resultant (n, 6), of a load of average size."""
        R = self.resultant
        HCR = self.whitened @ self.prior.times(R).T
        return np.asarray(self.prior.times(R).T - HC.T @ cho_solve(factor, HCR, check_finite=False)) / x**2

    def _error(self, error: ModelError, asked: Array, matrix: Array, C: Array) -> ErrorRows:
        change = error.change / self.noise[:, None]
        made = self.prior.times(change) @ change.T
        return ErrorRows(asked @ change, np.einsum("nm,nm->n", matrix @ made, matrix) / C)


def around(places: Array, radius: float) -> sparse.csr_array:
    """Which of places (P, 3) lie within a radius of each, themselves included."""
    from scipy import sparse
    from scipy.spatial import cKDTree

    tree = cKDTree(places)
    pairs = tree.query_pairs(radius, output_type="ndarray")
    own = np.arange(len(places))
    i, j = np.concatenate([pairs[:, 0], pairs[:, 1], own]), np.concatenate([pairs[:, 1], pairs[:, 0], own])
    return sparse.csr_array((np.ones(len(i)), (i, j)), shape=(len(places), len(places)))
