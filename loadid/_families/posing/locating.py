"""The search for the place of a load as posed: candidates, their grid, their models, and what the residuals say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._channels import Channel, direction_label
from structures._model import Model
from structures._models.arrays import ImpulseModel
from structures._models.statespace import StateSpace
from structures._system.loads import Moment, Point
from structures.errors import InputError, reals

from ..._inverse.convolved.fits import DenseFit, HistoryFit, JointFit, LongFit
from ..._inverse.convolved.places import CandidateSet, Refined
from ..._inverse.problem import whiten
from ..._results.location import Rival
from ...design._candidates import of_model
from ..data import Data
from ..noise import NoiseLevel

Array = NDArray[np.float64]
NEIGHBOUR = 1.5  # spacings within which candidates are neighbours: the diagonal of a square grid is one
FLAT = 1e-6  # extent over the largest below which all candidates agree in a coordinate
RIM = 0.05  # spacings that a place keeps from the end of the structure, where it may be held


@dataclass(frozen=True, eq=False)
class Grid:
    """Places of the candidates.

    Parameters
    ----------
    places : array, shape (candidates, dim)
        m.
    spacing : float
        Median distance to the nearest neighbour (m).
    used : array of int
        Coordinates in which the candidates differ.
    outline : array, shape (nodes, dim), or None
        Nodes of the structure.
    """

    places: Array
    spacing: float
    used: NDArray[np.intp]
    outline: Array | None

    @property
    def distance(self) -> Array:
        """Distances of the candidates in spacings, (candidates, candidates)."""
        return np.asarray(np.linalg.norm(self.places[:, None] - self.places, axis=2) / self.spacing)

    @property
    def near(self) -> NDArray[np.bool_]:
        """Which candidates are neighbours; each is its own."""
        return self.distance <= NEIGHBOUR

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Box over the used coordinates: half a spacing beyond the candidates, but on the structure."""
        x = self.places[:, self.used]
        low, high = x.min(axis=0) - self.spacing / 2, x.max(axis=0) + self.spacing / 2
        if self.outline is not None:
            ends, rim = self.outline[:, self.used], RIM * self.spacing
            low = np.minimum(np.maximum(low, ends.min(axis=0) + rim), x.min(axis=0))
            high = np.maximum(np.minimum(high, ends.max(axis=0) - rim), x.max(axis=0))
        return low, high

    def full(self, used: Array) -> Array:
        """Places with all coordinates, from the used ones (n, used)."""
        out = np.tile(self.places[0], (len(used), 1))
        out[:, self.used] = used
        return out


def grid_of(model: Model, places: ArrayLike | None) -> Grid | None:
    """Places that the user or the model gives; None where neither knows them.

    Raises
    ------
    InputError
        Places that do not fit the candidates, or two candidates at one place.
    """
    _, own, outline = of_model(model)
    found = own if places is None else _given(places, len(model.loads))
    if found is None or len(found) < 2:
        return None
    distance = np.linalg.norm(found[:, None] - found, axis=2)
    np.fill_diagonal(distance, np.inf)
    extent = np.ptp(found, axis=0)
    if distance.min() <= FLAT * extent.max():
        i, j = np.unravel_index(int(np.argmin(distance)), distance.shape)
        if places is None:
            return None  # loads in several directions at one node: candidates without a distance
        raise InputError(
            "two candidates at one place", where="places", found=f"{model.loads[i].label} and {model.loads[j].label}",
            expected="distinct places", hint="one candidate for each place",
        )  # fmt: skip
    used = np.flatnonzero(extent > FLAT * extent.max())
    fits = outline is not None and outline.shape[1] == found.shape[1]
    return Grid(found, float(np.median(distance.min(axis=1))), used, outline if fits else None)


def _given(places: Any, count: int) -> Array:
    x = reals(places, what="the places are no real numbers", where="places")
    x = x[:, None] if x.ndim == 1 else x
    if x.ndim != 2 or len(x) != count or not 1 <= x.shape[1] <= 3 or not np.all(np.isfinite(x)):
        raise InputError(
            "the places do not fit the candidates", where="places", found=f"shape {x.shape}",
            expected=f"finite, ({count},) to ({count}, 3), in m", hint="one place for each load of the model",
        )  # fmt: skip
    return x


SAME = 1e-6  # difference of the responses of a candidate and of a load moved to its place that is rounding
FEWEST = 4  # candidates on a line, below which nothing is interpolated; twice as many on a surface


class CandidateLoads:
    """Impulse responses of the candidates and of the places between them.

    Parameters
    ----------
    model : Model
        Its loads are the candidates.
    grid : Grid or None
    dt : float
    samples : int
    hold : str
    """

    def __init__(self, model: Model, grid: Grid | None, dt: float, samples: int, hold: str) -> None:
        self.model, self.grid, self.dt, self.samples, self.hold = model, grid, dt, samples, hold
        self.h = model.impulse_response(dt, samples, hold)
        silent = [c.label for c, level in zip(model.loads, np.abs(self.h).max(axis=(0, 1)), strict=True) if level == 0]
        if silent:
            raise InputError(
                f"{len(silent)} candidates move no sensor", where="LocationSearch", found=", ".join(silent[:8]),
                expected="candidates that the sensors see", hint="drop them, or add sensors",
            )  # fmt: skip

    @cached_property
    def how(self) -> str:
        """How the responses between candidates are found: ``moved``, ``interpolated`` or ``""``."""
        if self.grid is None:
            return ""
        if self._movable():
            return "moved"
        dim = len(self.grid.used)
        return "interpolated" if len(self.h[0, 0]) >= FEWEST * dim and dim <= 2 else ""

    def _movable(self) -> bool:
        """Whether the model can place loads anywhere in the box, and says the same of its candidates there."""
        model, grid = self.model, self.grid
        if grid is None or model.structure is None or model.structure.field is None or not model.gives("with_loads"):
            return False
        kinds = {(type(c), _direction(c)) for c in model.loads}
        if len(kinds) > 1 or not isinstance(model.loads[0], Point | Moment):
            return False
        try:
            low, high = grid.bounds
            corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(len(low), -1).T
            self._moved(corners)
            own = self._moved(grid.places[:1, grid.used])
        except InputError:  # a box that is not on the structure, or a structure without places between its nodes
            return False
        return bool(np.abs(own[..., 0] - self.h[..., 0]).max() <= SAME * np.abs(self.h[..., 0]).max())

    def responses(self, places: Array, samples: int | None = None) -> Array:
        """Impulse responses (samples, sensors, n) of loads at places (n, used coordinates), or the first of them."""
        if self.how == "moved":
            return self._moved(places, samples)
        return np.asarray(np.einsum("ksc,nc->ksn", self.h[:samples], self._weights(places)))

    def at(self, places: Array) -> Model:
        """The model under loads at places (n, used coordinates)."""
        if self.how == "moved":
            return self.model.with_loads(self._loads(places))
        first = self.model.loads[0]
        channels = [Channel(label=f"load at {_words(p)}", quantity=first.quantity, unit=first.unit) for p in places]
        if (own := self._discrete) is not None:
            mix = self._weights(places).T
            return _columns(own, own.B @ mix, own.D @ mix, channels)
        return self._impulses(self.responses(places), channels)

    def chosen(self, indices: Sequence[int]) -> Model:
        """The model under some of its candidates."""
        picked = [self.model.loads[j] for j in indices]
        if self.model.gives("with_loads") and self.model.basis is None:
            return self.model.with_loads(picked)
        if (own := self._discrete) is not None:
            columns = list(indices)
            return _columns(own, own.B[:, columns], own.D[:, columns], picked)
        return self._impulses(self.h[..., list(indices)], picked)

    @cached_property
    def _discrete(self) -> StateSpace | None:
        """The model, where it exists as a state space at its own step only."""
        model = self.model
        return None if model.dt is None or not model.gives("state_space") else model.state_space(self.dt, self.hold)

    # -- inside -------------------------------------------------------------------------------------------------------
    def _impulses(self, h: Array, loads: Sequence[Any]) -> ImpulseModel:
        plain = [Channel(label=c.label, quantity=c.quantity, unit=c.unit) for c in loads]
        model = ImpulseModel(h, self.dt, kind="held", hold=self.hold, sensors=self.model.sensors, loads=plain)
        model.certificate = self.model.certificate
        return model

    def _loads(self, places: Array) -> list[Any]:
        assert self.grid is not None
        first, direction = self.model.loads[0], _direction(self.model.loads[0])
        made = []
        for p in self.grid.full(places):
            at = float(p[0]) if len(p) == 1 else tuple(float(v) for v in p)
            made.append(replace(first, dof=None, at=at, direction=direction, label=f"load at {_words(p)}"))  # type: ignore[call-arg]
        if len({c.label for c in made}) < len(made):
            made = [replace(c, label=f"{c.label} #{i}") for i, c in enumerate(made)]
        return made

    def _moved(self, places: Array, samples: int | None = None) -> Array:
        moved = self.model.with_loads(self._loads(places))
        return moved.impulse_response(self.dt, samples or self.samples, self.hold)

    def _weights(self, places: Array) -> Array:
        """Weights (n, candidates) of a radial basis interpolation over the candidates."""
        from scipy.interpolate import RBFInterpolator

        assert self.grid is not None
        x, scale = self.grid.places[:, self.grid.used], self.grid.spacing
        kernel = "cubic" if x.shape[1] == 1 else "thin_plate_spline"
        return np.asarray(RBFInterpolator(x / scale, np.eye(len(x)), kernel=kernel)(places / scale))


def _columns(model: StateSpace, B: Array, D: Array, loads: Sequence[Channel]) -> StateSpace:
    """A state space under other loads."""
    one = StateSpace(model.A, B, model.C, D, model.dt, model.hold, sensors=model.sensors, loads=loads)
    one.certificate = model.certificate
    return one


def _direction(load: Channel) -> str:
    dof = getattr(load, "dof", None)
    return direction_label(dof.direction) if dof is not None else str(getattr(load, "direction", ""))


def _words(place: Array) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in place) + ") m"


DENSE = 600  # unknowns up to which a fit is one factorisation


@dataclass(frozen=True)
class FactoredCandidates:
    """What is made once for all records of a length: responses (whitened), a fit per candidate, groups alike."""

    candidates: CandidateLoads
    h: Array
    fits: tuple[HistoryFit, ...]
    groups: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class LocationProblem:
    """One record, whitened by relative noise levels, with the fits that it is shown to.

    `sigma` is the noise level of the whitened data where it is known; `at` holds the refined places.
    """

    data: Data
    noise: NoiseLevel
    sigma: float | None
    y: Array
    relative: Array
    candidates: CandidateLoads
    h: Array
    fits: tuple[HistoryFit, ...]
    groups: tuple[tuple[str, ...], ...]
    at: Array | None = None

    @property
    def dense(self) -> bool:
        """Every candidate has its factors: a fit costs less than handing it to a thread."""
        return isinstance(self.fits[0], DenseFit)

    def fit(self, h: Array, lam: Array) -> HistoryFit:
        """A fit of its own for some responses."""
        return JointFit(h, lam) if len(h) * h.shape[2] <= DENSE else LongFit(h, lam)

    def joint(self, indices: Sequence[int]) -> HistoryFit:
        """Some candidates together."""
        lam = np.array([float(self.fits[j].lam[0]) for j in indices])
        return self.fit(self.h[:, :, list(indices)], lam)

    def whitened(self, places: Array, samples: int | None = None) -> Array:
        """Whitened responses (samples, sensors, n) of loads at places, or the first samples of them."""
        return whiten(self.candidates.responses(places, samples)[:, self.data.rows], self.relative, axis=1)


Solution = tuple[Refined, str, int]  # refined place, candidate from which it started, load that was moved


@dataclass(frozen=True)
class CandidateVerdict:
    """The best candidate, the runner-up, and the ratio of their residual norms."""

    best: int
    runner_up: int
    ratio: float


def compared(posed: LocationProblem, chosen: CandidateSet) -> CandidateVerdict:
    """Of the load for which the runner-up comes closest."""
    found = []
    for best, scores in zip(chosen.indices, chosen.scores, strict=True):
        taken = [j for j in chosen.indices if j != best]
        others = np.array([np.inf if j in {best, *taken} else s for j, s in enumerate(scores)])
        second = int(np.argmin(others))
        floor = np.finfo(float).eps * float(np.linalg.norm(posed.y))  # data without noise may leave nothing
        ratio = max(np.sqrt(others[second]), floor) / max(np.sqrt(scores[best]), floor)
        found.append(CandidateVerdict(best, second, float(ratio)))
    return min(found, key=lambda s: s.ratio)


def noise_level(posed: LocationProblem, residual2: float, chosen: CandidateSet) -> float:
    """Noise level of the whitened data: as stated, or what the fit leaves where that is more or nothing is stated."""
    spent = sum(posed.fits[j].edf for j in chosen.indices)
    left = float(np.sqrt(residual2 / max(posed.y.size - spent, 1.0)))
    return left if posed.sigma is None else max(left, posed.sigma)


SHARING, NEAR = 4, 1.15  # readings that share an error of the model; residual over the noise that is no such error


def shared(level: float, sigma: float | None) -> float:
    """Noise level that counts for a place: what is far beyond the noise is shared by neighbours."""
    if sigma is None or level < NEAR * sigma:
        return level
    return float(np.sqrt(sigma**2 + SHARING * (level**2 - sigma**2)))


def basins(scores: Array, near: NDArray[Any], best: int) -> tuple[list[int], list[int]]:
    """Neighbours of the best, and local minima of the scores outside its neighbourhood; both best first."""
    lowest = np.array([np.min(scores[near[j]]) for j in range(len(scores))])
    order = [int(j) for j in np.argsort(scores, kind="stable") if j != best]
    return [j for j in order if near[best, j]], [j for j in order if not near[best, j] and scores[j] <= lowest[j]]


def rivals_of(solutions: list[Solution], place: Array, residual2: float, grid: Grid) -> tuple[Rival, ...]:
    """Solutions elsewhere than the places found (loads, dim) of this squared residual, closest in residual first."""
    found = []
    for one, label, load in solutions:
        if float(np.linalg.norm(one.place - place, axis=1).max()) > grid.spacing:
            ratio = np.sqrt(one.fitted.residual2 / max(residual2, np.finfo(float).tiny))
            at = tuple(float(v) for v in grid.full(one.place)[load])
            found.append(Rival(at, label, float(ratio), load))
    return tuple(sorted(found, key=lambda r: r.ratio))
