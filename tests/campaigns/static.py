"""Static loads on beams and plates.

Cantilevers, simply supported and clamped beams of 1 to 30 m, plates with five edge conditions; 4 to 20 displacement or
strain sensors at random places; 10 to 60 patches; ten shapes of load. The truth has patches four to six times finer on
a finer mesh; noise of 0.5 to 5 % of the rms, stated in every second problem; four penalties; a sign constraint or a
known resultant on two fifths of the loads that only push. `error` adds what the model does not know: gains of the
sensors, their places, the stiffness along the structure, each by some per cent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from loadid import LoadEstimate, StaticInversion
from loadid.constraints import NonNegative, Resultant
from structures import ForwardModel, bases, beams, plates, sensors
from structures.errors import InputError, NotIdentifiable

from .scores import Array, Scored, deviations

PENALTIES = ("identity", "gradient", "laplacian", "second_difference")
EDGES = ("SSSS", "CCCC", "CFFF", "CSCS", "SFSF")
ERRORS = ("none", "gain", "place", "stiffness")


@dataclass(frozen=True, eq=False)
class Problem:
    """One problem as a user has it, with its truth.

    Parameters
    ----------
    model : ForwardModel
    readings : array (sensors,)
    sigma : array (sensors,)
        True noise std.
    stated : bool
    penalty : str
    constraints : tuple
    truth : array (loads,)
        Mean of the true load over each patch.
    groups : tuple of str
    """

    model: ForwardModel
    readings: Array
    sigma: Array
    stated: bool
    penalty: str
    constraints: tuple[Any, ...]
    truth: Array
    groups: tuple[str, ...]

    def inversion(self, **settings: Any) -> StaticInversion:
        """As the user poses it."""
        noise = self.sigma if self.stated else None
        given = {"penalty": self.penalty, "constraints": self.constraints, "noise": noise}
        return StaticInversion(self.model, **given | settings)


# -- loads -----------------------------------------------------------------------------------------------------------
def _smooth(rng: np.random.Generator) -> Callable[[Array], Array]:
    order = np.arange(6)
    weights = rng.standard_normal(6) / (1 + order)
    return lambda s: np.asarray(weights @ np.cos(np.pi * order[:, None] * s))


def shape(kind: int, rng: np.random.Generator) -> tuple[Callable[[Array], Array], bool]:
    """A load over [0, 1], and whether it only pushes."""
    c, d, w = rng.uniform(0.2, 0.8), rng.uniform(0.2, 0.8), rng.uniform(0.3, 1.0)

    def bump(centre: float, width: float) -> Callable[[Array], Array]:
        return lambda s: np.exp(-0.5 * ((s - centre) / width) ** 2)

    many: list[tuple[Callable[[Array], Array], bool]] = [
        (lambda s: np.ones_like(s), True),
        (lambda s: s if c > 0.5 else 1 - s, True),
        (lambda s: np.sin(np.pi * s), True),
        (bump(c, 0.15), True),
        (bump(c, 0.05), True),
        (lambda s: bump(c, 0.06)(s) + w * bump(d, 0.1)(s), True),
        (lambda s: (np.abs(s - c) < 0.04).astype(float), True),
        (lambda s: (s > c).astype(float), True),
        (lambda s: np.sin(2 * np.pi * s + 6 * w), False),
        (_smooth(rng), False),
    ]
    return many[kind]


# -- structures ------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class _Built:
    """A structure coarse and fine, its extents, and how a gauge is glued on."""

    coarse: Any
    fine: Any
    lengths: tuple[float, ...]
    fibre: float
    kind: str


def _beam(rng: np.random.Generator, waviness: float) -> _Built:
    length = float(np.exp(rng.uniform(0, np.log(30))))
    ends = [("clamped", "free"), ("pinned", "pinned"), ("clamped", "clamped")][rng.integers(3)]
    EI, turn = 10 ** rng.uniform(3, 8), rng.uniform(0, 2 * np.pi)

    def wavy(x: Array) -> Array:
        return EI * (1 + waviness * np.sqrt(2) * np.cos(2 * np.pi * np.asarray(x) / length + turn))

    given: dict[str, Any] = {"length": length, "left": ends[0], "right": ends[1], "mass_per_length": 10.0}
    return _Built(
        beams.beam(EI=EI, elements=60, **given), beams.beam(EI=wavy, elements=240, **given), (length,), length / 40,
        f"beam, {ends[0]}-{ends[1]}",
    )  # fmt: skip


def _plate(rng: np.random.Generator, waviness: float) -> _Built:
    a = float(np.exp(rng.uniform(np.log(0.5), np.log(5))))
    b, thick = a * rng.uniform(0.6, 1.0), a / rng.uniform(60, 200)
    edges = EDGES[rng.integers(len(EDGES))]
    steel = beams.materials.steel
    stiffer = beams.materials.Material(E=steel.E * (1 + waviness * rng.standard_normal()), rho=steel.rho, nu=steel.nu)
    given: dict[str, Any] = {"lengths": (a, b), "thickness": thick, "edges": edges}
    coarse = plates.plate(material=steel, elements=(12, 10), **given)
    fine = plates.plate(material=stiffer, elements=(30, 25), **given)
    return _Built(coarse, fine, (a, b), thick / 2, f"plate, {edges}")


# -- problems --------------------------------------------------------------------------------------------------------
def _patches(built: _Built, grid: tuple[int, ...], structure: Any) -> Any:
    return bases.patches(structure, grid[0] if len(grid) == 1 else grid)


def _cells(grid: tuple[int, ...]) -> list[Array]:
    """Centres of cells over [0, 1], each (cells,), the first axis running fastest."""
    axes = [(np.arange(n) + 0.5) / n for n in grid]
    return [axes[0]] if len(grid) == 1 else [x.ravel() for x in np.meshgrid(*axes)]


def _coarse(fine: Array, grid: tuple[int, ...], ratio: int) -> Array:
    """Mean over the fine cells of each coarse one."""
    split = [n for size in grid[::-1] for n in (size, ratio)]
    return np.asarray(fine.reshape(split).mean(axis=tuple(range(1, 2 * len(grid), 2))).ravel())


def _sensors(
    built: _Built, rng: np.random.Generator, count: int, strains: bool, shift: float
) -> tuple[list[Any], list[Any]]:
    """Sensors where the user believes them, and where they are."""
    places = rng.uniform(0.06, 0.94, (count, len(built.lengths))) * built.lengths
    moved = np.clip(places + shift * np.array(built.lengths) * rng.standard_normal(places.shape), 0.0, built.lengths)
    angles = rng.uniform(0, np.pi, count)

    def one(i: int, at: Array) -> Any:
        spot = float(at[0]) if len(at) == 1 else tuple(map(float, at))
        if not strains:
            return sensors.Displacement(at=spot, direction="+Z", label=f"s{i}")
        turned = {"angle": float(angles[i])} if len(at) == 2 else {}
        return sensors.StrainGauge(at=spot, fibre=built.fibre, label=f"s{i}", **turned)

    return [one(i, at) for i, at in enumerate(places)], [one(i, at) for i, at in enumerate(moved)]


def problem(seed: int, error: str = "none", size: float = 0.03) -> Problem:
    """Problem number `seed`; `error` is one of `ERRORS`, `size` its standard deviation."""
    rng = np.random.default_rng([seed, ERRORS.index(error)])
    waviness = size if error == "stiffness" else 0.0
    built = (_beam if rng.random() < 0.6 else _plate)(rng, waviness)
    grid = (
        (int(rng.integers(10, 61)),) if len(built.lengths) == 1 else (int(rng.integers(4, 9)), int(rng.integers(3, 8)))
    )
    ratio = int(rng.integers(4, 7)) if len(grid) == 1 else 4
    strains, count = bool(rng.random() < 0.5), int(rng.integers(4, 21))
    believed, true = _sensors(built, rng, count, strains, size if error == "place" else 0.0)
    kind = int(rng.integers(10))
    pieces = [shape(kind, rng) for _ in grid]
    finer = tuple(ratio * n for n in grid)
    amplitude = 10 ** rng.uniform(1, 4)
    load = amplitude * np.prod([np.ravel(f(s)) for (f, _), s in zip(pieces, _cells(finer), strict=True)], axis=0)
    if not np.any(load):  # a patch between the centres of the cells
        load[len(load) // 2] = amplitude
    pushes = all(push for _, push in pieces)
    clean = ForwardModel(built.fine, true, _patches(built, finer, built.fine)).static() @ load
    if error == "gain":
        clean = clean * (1 + size * rng.standard_normal(count))
    sigma = np.full(count, 10 ** rng.uniform(np.log10(0.005), np.log10(0.05)) * float(np.sqrt(np.mean(clean**2))))
    readings = clean + sigma * rng.standard_normal(count)
    basis = _patches(built, grid, built.coarse)
    truth = _coarse(load, grid, ratio)
    penalty, stated = PENALTIES[rng.integers(4)], bool(rng.random() < 0.5)
    constraints, named = _constraints(rng, basis, truth, pushes)
    groups = (
        built.kind.split(",")[0], f"penalty {penalty}", f"sigma {'stated' if stated else 'not known'}", named,
        "strains" if strains else "displacements", f"error {error}",
    )  # fmt: skip
    return Problem(
        ForwardModel(built.coarse, believed, basis), readings, sigma, stated, penalty, constraints, truth, groups
    )


def _constraints(rng: np.random.Generator, basis: Any, truth: Array, pushes: bool) -> tuple[tuple[Any, ...], str]:
    drawn = rng.random()
    if not pushes or drawn > 0.4:
        return (), "no constraint"
    if drawn < 0.2:
        return (NonNegative(),), "non-negative"
    C = basis.resultant()[:1]
    return (Resultant(C, C @ truth),), "resultant given"


# -- scores ----------------------------------------------------------------------------------------------------------
def best(given: Problem) -> float:
    """Load error at the best lambda, by dense least squares; NaN under constraints."""
    if given.constraints:
        return float("nan")
    family = given.inversion()
    H, y = family.H / given.sigma[:, None], given.readings / given.sigma
    L = np.eye(H.shape[1]) if family.L is None or np.ndim(family.L) == 0 else np.asarray(family.L)
    scale = np.linalg.norm(H, 2) / np.linalg.norm(L, 2)

    def error(lam: float) -> float:
        stacked = np.vstack([H, lam * L])
        load = np.linalg.lstsq(stacked, np.r_[y, np.zeros(len(L))], rcond=None)[0]
        return float(np.linalg.norm(load - given.truth) / np.linalg.norm(given.truth))

    return min(error(scale * lam) for lam in np.geomspace(1e-6, 1e3, 60))


def scored(given: Problem, estimate: LoadEstimate, oracle: float) -> Scored:
    """An estimate beside the truth."""
    load, std = np.asarray(estimate.load), np.asarray(estimate.std)
    off = load - given.truth
    weights = np.asarray(given.model.basis.resultant())
    weights = weights[1:] if "resultant given" in given.groups else weights  # what is known is no finding
    totals = [estimate.functional(w) for w in weights]
    sums = np.array([f.value for f in totals]) - weights @ given.truth
    there = np.abs(given.truth) > 0.05 * np.abs(given.truth).max()
    z = deviations(off, std)
    return Scored(
        given.groups, estimate.choice.verdict, frozenset(estimate.codes),
        float(np.linalg.norm(off) / np.linalg.norm(given.truth)), oracle, z[there], z,
        deviations(sums, np.array([f.std for f in totals])),
        float(np.median(std[there]) / np.sqrt(np.mean(off[there] ** 2))), estimate.grade.letter, len(estimate.cautions),
    )  # fmt: skip


def run(problems: int, seed: int, error: str = "none", oracle: bool = True, **settings: Any) -> Iterator[Scored | str]:
    """Score of each problem, or why it was refused; `oracle`: the best lambda is searched too."""
    for number in range(problems):
        given = problem(seed * 100_000 + number, error)
        try:
            known = best(given) if oracle else float("nan")
            yield scored(given, given.inversion(**settings).estimate(given.readings), known)
        except (InputError, NotIdentifiable) as refused:
            yield f"{getattr(refused, 'code', '')} {refused}".splitlines()[0]
