"""How a record and a model become a sparse problem, and which dictionary and mu are taken."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._advice import Advice, Spelling
from structures._model import Model
from structures.errors import InputError, NotIdentifiable

from ..._inverse import rules
from ..._inverse.choice import ChoiceLike, is_rule, relative
from ..._inverse.problem import whiten
from ..._inverse.sparse import path
from ..._inverse.sparse.atoms import KNOTS, MatrixAtoms, ShiftedAtoms, bspline, dirac, wavelet
from ..._inverse.sparse.groups import Groups
from ..._inverse.sparse.lasso import SparseSolution
from ..._inverse.sparse.path import SparsePath, SupportFit, fit
from ..._inverse.sweep import RuleResult, Sweep
from ...settings import Sparsity
from .. import noise as noises
from ..data import Data
from .paths import coloured
from .posed import PosingSettings, measured_response, shift
from .support import refuse

Array = NDArray[Any]

SEGMENT = 16384  # samples at the start of a longer record on which dictionaries and noise levels are compared
ONSET = 0.1  # share of the energy of the data that such a segment holds at least
SOLVED = 1e-5  # relative duality gap above which an iterate is not reported
WIDER = (4, 8, 16)  # knots with which spikes are compared
FEWEST = 3  # points of a sweep on which a rule is asked
CANDIDATES = 6  # loads between which groups leave the choice to the information criterion

Atoms = ShiftedAtoms | MatrixAtoms


@dataclass(frozen=True)
class Wanted:
    """What is asked of a sparse inversion; see `SparseDeconvolution`."""

    dictionary: str | NDArray[np.float64]
    knots: int | str | Sequence[int] | None
    penalty: Sparsity
    choice: ChoiceLike

    @property
    def small(self) -> float:
        """Share of the largest coefficient below which one is left out: spikes are apart, splines overlap."""
        return 0.0 if self.named == "bspline" else path.SMALL

    @property
    def named(self) -> str:
        """The dictionary in a word."""
        return self.dictionary if isinstance(self.dictionary, str) else "user"


@dataclass(frozen=True)
class Problem:
    """A record and a model, whitened.

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
        Whitened impulse responses.
    y : array, shape (samples, sensors)
        Whitened data, zero where missing.
    weight : array, shape (samples, sensors), or None
    raw : array, shape (taps, used sensors, loads)
        Impulse responses as they are.
    values : array, shape (samples, used sensors)
        The data, advanced where the impulse response begins late.
    missing : array of bool, the shape of `values`
    noise : NoiseLevel
    acting : array of bool, shape (samples,), optional
        Samples at which the loads act: waveforms that reach beyond them are left out.
    """

    h: NDArray[np.float64]
    y: NDArray[np.float64]
    weight: NDArray[np.float64] | None
    raw: NDArray[np.float64]
    values: NDArray[np.float64]
    missing: NDArray[np.bool_]
    noise: noises.NoiseLevel
    acting: NDArray[np.bool_] | None = None

    @property
    def samples(self) -> int:
        """Length of the record."""
        return len(self.y)

    @property
    def data(self) -> int:
        """Data that are there."""
        return self.y.size if self.weight is None else int(np.count_nonzero(self.weight))

    def atoms(self, dictionary: str | Array, knots: int | None = None) -> Atoms:
        """The dictionary of a name (and spacing) on this record."""
        if self.acting is not None:
            return MatrixAtoms(self.h, self._inside(dictionary, knots, self.acting), self.weight)
        if not isinstance(dictionary, str):
            if dictionary.ndim != 2 or len(dictionary) != self.samples or not np.all(np.isfinite(dictionary)):
                raise InputError("the dictionary does not fit the record", where="dictionary",
                                 found=f"shape {dictionary.shape}",
                                 expected=f"finite, ({self.samples}, atoms)")  # fmt: skip
            return MatrixAtoms(self.h, dictionary, self.weight)
        if dictionary == "bspline":
            assert knots is not None
            return ShiftedAtoms(self.h, bspline(self.samples, knots), self.weight)
        make = dirac if dictionary == "dirac" else wavelet
        return ShiftedAtoms(self.h, make(self.samples), self.weight)

    def _inside(self, dictionary: str | Array, knots: int | None, mask: NDArray[np.bool_]) -> Array:
        """Waveforms (samples, atoms) that lie in the windows of the loads."""
        if isinstance(dictionary, str):
            make = {"dirac": dirac, "wavelet": wavelet}.get(dictionary)
            kept = (bspline(self.samples, int(knots or 1)) if make is None else make(self.samples)).within(mask)
        else:
            kept = np.asarray(dictionary, float)
            kept = kept[:, ~np.any(kept[~mask] != 0, axis=0)] if len(kept) == self.samples else kept
        if not kept.shape[1] or not np.any(kept):
            refuse(f"no waveform of {dictionary if isinstance(dictionary, str) else 'the matrix'!r} within it",
                   "a longer window, or dictionary='dirac'")  # fmt: skip
        return np.asarray(kept)

    def holds(self, knots: int) -> bool:
        """Whether a B-spline of this spacing finds room."""
        mask = self.acting
        return mask is None or knots == 1 or bool(bspline(self.samples, knots).within(mask).shape[1])

    def path(self, atoms: Atoms, nonnegative: bool, groups: Groups | None = None) -> SparsePath:
        """The problem on a dictionary."""
        return SparsePath(atoms, self.y, nonnegative=nonnegative, groups=groups, data=self.data)

    def beginning(self) -> Problem:
        """The first part of a long record, with enough of its energy: the structure is at rest before it."""
        if self.samples <= SEGMENT or self.acting is not None:
            return self
        energy = np.cumsum(np.sum(self.y**2, axis=1))
        reached = int(np.searchsorted(energy, ONSET * energy[-1])) + SEGMENT // 4
        stop = min(max(SEGMENT, reached), self.samples)
        weight = None if self.weight is None else self.weight[:stop]
        return replace(
            self, h=self.h[:stop], y=self.y[:stop], weight=weight, raw=self.raw[:stop], values=self.values[:stop],
            missing=self.missing[:stop],
        )  # fmt: skip

    def of(self, loads: NDArray[np.int_]) -> Problem:
        """Some of the loads only."""
        return replace(self, h=self.h[:, :, loads], raw=self.raw[:, :, loads])


def pose(model: Model, data: Data, posing: PosingSettings) -> Problem:
    """Whitened problem of a record.

    Raises
    ------
    InputError
        No usable diagonal (LID-E506), missing samples beside a covariance, different steps.
    """
    if model.sampled:
        if not np.any(data.missing):
            white = coloured(model, data, posing)
            return Problem(white.h, white.y, None, white.raw[:, data.rows], data.values, data.missing, white.noise,
                           posing.acting(len(data.values), data.dt))  # fmt: skip
        h, lines = measured_response(model, data, posing)
        late, level = 0, np.sqrt(np.mean(lines.power, axis=0) / len(data.values))
        noise = noises.NoiseLevel(level, lines.known, lines.source)
        raw = h[:, data.rows]
    else:
        h = model.impulse_response(data.dt, len(data.values), posing.hold or model.default_hold)
        late = shift(h[:, data.rows], model, posing.allow)
        noise = noises.resolve(posing.noise, model, data)
        raw = h[late:, data.rows]
    values, mask = data.values[late:], posing.acting(len(data.values) - late, data.dt)
    missing: NDArray[np.bool_] = np.asarray(data.missing)[late:]
    if missing.any() and np.ndim(noise.level) == 2:
        missing = np.repeat(np.any(missing, axis=1)[:, None], missing.shape[1], axis=1)
    rows = whiten(raw, noise.level, 1)
    y = whiten(np.where(missing, 0.0, values), noise.level, 1)
    weight = None
    if missing.any():
        weight = (~missing).astype(float)
        weight = weight if weight.shape == y.shape else np.repeat(weight[:, :1], y.shape[1], axis=1)
        y = y * weight
    return Problem(rows, y, weight, raw, values, missing, noise, mask)


@dataclass(frozen=True)
class SparseChoice:
    """A sparse solution and how it was come by.

    Parameters
    ----------
    problem : Problem
        With the loads that are left, where groups chose between them.
    loads : array of int
        Those loads.
    atoms : ShiftedAtoms or MatrixAtoms
    knots : int or None
        Spacing of B-splines.
    solution : SparseSolution
    fit : SupportFit
        Least squares on its support.
    ratio, scale : float
        Relative mu, and the mu at which everything is zero.
    rule : str
    edge : bool
        The rule ended at the end of its range.
    ratios : dict
        Relative mu of every rule that was asked.
    sigma : float
        Noise level of the whitened data.
    shown : float or None
        Noise level that the data show, where it contradicts the stated one.
    sweep : Sweep or None
    scores : dict of int to float
        Information criterion of B-splines by spacing; spikes stand under 1.
    """

    problem: Problem
    loads: NDArray[np.int_]
    atoms: Atoms
    knots: int | None
    solution: SparseSolution
    fit: SupportFit
    ratio: float
    scale: float
    rule: str
    edge: bool
    ratios: dict[str, float]
    sigma: float
    shown: float | None
    sweep: Sweep | None
    scores: dict[int, float]

    @property
    def gain(self) -> tuple[float, int]:
        """By how much the criterion prefers another spacing to the one in use, and which."""
        used = 1 if self.knots is None else self.knots
        others = {k: v for k, v in self.scores.items() if k != used}
        if used not in self.scores or not others:
            return 0.0, used
        best = min(others, key=lambda k: others[k])
        return self.scores[used] - others[best], best


def choose(
    problem: Problem, wanted: Wanted, progress: Callable[[float, str], None], known: Mapping[int, Sweep] | None = None
) -> SparseChoice:
    """Dictionary, mu, solution and support; `known` holds sweeps of this problem by spacing (1: spikes), free of signs.

    Raises
    ------
    NotIdentifiable
        Where the data hold nothing beyond noise, or the gap stays above `SOLVED`.
    """
    first = problem.beginning()
    spacings, sweeps = _swept(first, wanted, progress, known or {})
    scores = {k: score(s) for k, s in sweeps.items()}
    best = min(spacings, key=lambda k: scores[k]) if len(spacings) > 1 else spacings[0]
    knots = best if wanted.named == "bspline" else None
    sweep = sweeps[best]
    sigma, shown = _level(first, sweep)
    loads, group_gap = np.arange(problem.h.shape[2]), None
    progress(0.6, "solving")
    if wanted.penalty.groups == "loads":
        loads, group_gap = _candidates(problem, wanted, knots, sigma)
        problem = problem.of(loads)
    atoms = problem.atoms(wanted.dictionary, knots)
    groups = Groups(atoms.slot) if wanted.penalty.groups == "slots" else None
    along = problem.path(atoms, wanted.penalty.nonnegative, groups)
    ratio, rule, edge, ratios = _ratio(along, wanted.choice, sigma, sweep, problem.samples == first.samples)
    solution = _solved(along, ratio, wanted.penalty.tol)
    for _ in range(wanted.penalty.reweighted):
        along = along.reweighted(solution.x)
        if rule == "discrepancy":
            met = _met(along, sigma)
            ratio, edge = rules.answered(met), met.edge
        solution = _solved(along, ratio, wanted.penalty.tol)
    progress(0.9, "amplitudes")
    # a support chosen by the criterion is the whole support of its solution
    small = 0.0 if rule == "ebic" else wanted.small
    found = along.fitted(solution.x, small, sigma)
    if group_gap is not None:
        solution = replace(solution, gap=max(solution.gap, group_gap))
    return SparseChoice(problem, loads, atoms, knots, solution, found, ratio, float(along.scale), rule, edge, ratios,
                        sigma, shown, sweep, scores)  # fmt: skip


def _swept(
    first: Problem, wanted: Wanted, progress: Callable[[float, str], None], known: Mapping[int, Sweep]
) -> tuple[list[int], dict[int, Sweep]]:
    """Spacings to choose from, and the path on them and on what they are compared with (1: the dictionary as it is)."""
    if wanted.named == "bspline":
        knots: Any = wanted.knots
        if knots is None or (isinstance(knots, str) and knots == "scan"):
            knots = [k for k in KNOTS if k <= max(first.samples // 8, 2) and first.holds(k)]
        spacings = [int(knots)] if isinstance(knots, int | np.integer) else [int(k) for k in knots]
        beside: list[int] = []
    else:
        spacings = [1]
        beside = (
            [k for k in WIDER if k <= first.samples // 8 and first.holds(k)]
            if wanted.named == "dirac" and wanted.penalty.groups is None
            else []
        )
    sweeps = {}
    for i, k in enumerate(spacings + beside):
        progress(
            0.1 + 0.5 * i / len(spacings + beside), f"path over mu{'' if k == 1 else f', knots every {k} samples'}"
        )
        name = wanted.dictionary if k in spacings else "bspline"
        along = first.path(first.atoms(name, k), wanted.penalty.nonnegative)
        if along.scale == 0:
            raise InputError(
                "no load moves the sensors the way of the data", where="record",
                found="data that are zero, or that a load of this sign cannot make", expected="a response",
                hint=Advice("check the record, and the sign that the load may have (",
                            Spelling("sparsity=Sparsity(nonnegative=False)", "without --nonnegative"), ")"),
            )  # fmt: skip
        sweeps[k] = known[k] if k in known else along.sweep(first.noise.sigma)
    return spacings, sweeps


def _level(first: Problem, sweep: Sweep) -> tuple[float, float | None]:
    """Noise level of the whitened data, and what the data show where that contradicts the stated level."""
    from scipy.special import gammaincinv

    if not len(sweep.lam):
        return first.noise.sigma or float(np.sqrt(np.mean(first.y**2))), None
    best = sweep.part(np.array([rules.best_support(sweep)])).point
    freedom = max(first.data - int(rules.need(best, "edf", "ebic")[0]), 1)
    seen = float(np.sqrt(rules.need(best, "fitted2", "ebic")[0] / freedom))
    if first.noise.sigma is None:
        return seen, None
    margin = max(1.3, float(np.sqrt(2 * gammaincinv(freedom / 2, 0.99) / freedom)))
    # a level a little too small would ask the penalty for a fit of noise: what the best criterion leaves is the floor
    return max(seen, first.noise.sigma), seen if seen > margin * first.noise.sigma else None


def _ratio(
    along: SparsePath, choice: ChoiceLike, sigma: float, sweep: Sweep, whole: bool
) -> tuple[float, str, bool, dict[str, float]]:
    """Relative mu, the rule that chose it, whether at the end of its range, and what every rule said."""
    ratios: dict[str, float] = {}
    best = rules.ebic(sweep) if len(sweep.lam) and whole else None
    if best is not None:
        ratios["ebic"] = rules.answered(best)
    if choice is not None and not is_rule(choice):
        return relative(choice), "given", False, ratios
    if choice == "ebic":
        if best is None:
            raise InputError(
                "the information criterion is asked on short records only", where="choice", found="'ebic'",
                expected="None, 'discrepancy' or a relative mu", hint=f"a window of up to {SEGMENT} samples",
            )  # fmt: skip
        return ratios["ebic"], "ebic", best.edge, ratios
    if choice not in (None, "discrepancy"):
        own = _asked(along, choice, sigma)
        return rules.answered(own), own.rule, own.edge, ratios | {own.rule: rules.answered(own)}
    met = _met(along, sigma)
    ratio = rules.answered(met)
    if ratio >= 1:
        raise NotIdentifiable(
            "the record holds nothing beyond its noise: no load is needed to explain it",
            advice="check the noise level (noise=), or take a record with a larger response",
            code="LID-E312",
        )
    return ratio, "discrepancy", met.edge, ratios | {"discrepancy": ratio}


def _met(along: SparsePath, sigma: float) -> RuleResult:
    """The discrepancy rule, which needs the path down to the noise alone."""
    return rules.run("discrepancy", along.to_noise(sigma))


def _asked(along: SparsePath, choice: str | rules.Rule, sigma: float) -> RuleResult:
    """Another rule, on the path as far as it is sparse."""
    sweep = along.sweep(sigma)
    if len(sweep.lam) < FEWEST:
        raise InputError("the solutions are sparse at no mu: no rule says anything", where="choice",
                         found=rules.name_of(choice), expected="a relative mu, or another dictionary")  # fmt: skip
    return rules.run(choice, sweep)


def score(sweep: Sweep) -> float:
    """Smallest information criterion; infinite where nothing is sparse."""
    return float(rules.criterion(sweep).min(initial=np.inf))


def _solved(along: SparsePath, ratio: float, tol: float) -> SparseSolution:
    found = along.solve(ratio, tol)
    if found.gap > max(SOLVED, tol):
        raise NotIdentifiable(
            f"the l1 problem could not be solved: relative duality gap {found.gap:.2g} after {found.steps} steps",
            advice="a larger mu, a coarser dictionary (knots=), or a window of the record", code="LID-E410",
        )  # fmt: skip
    if not len(found.support):
        raise InputError("everything is zero at this mu", where="choice", found=f"{ratio:.4g}", expected="a smaller mu",
                         hint="choice=None finds one")  # fmt: skip
    return found


def _candidates(problem: Problem, wanted: Wanted, knots: int | None, sigma: float) -> tuple[NDArray[np.int_], float]:
    """Which loads act: groups of whole histories, then the information criterion between the strongest of them."""
    atoms = problem.atoms(wanted.dictionary, knots)
    groups = Groups(atoms.load)
    along = problem.path(atoms, False, groups)
    found = along.solve(rules.answered(_met(along, sigma)), wanted.penalty.tol)
    norms = groups.norms(found.x)
    order = [int(j) for j in np.argsort(-norms) if norms[j] > 0][:CANDIDATES]
    scores = []
    for count in range(1, len(order) + 1):
        some = problem.of(np.sort(order[:count]))
        part = some.path(some.atoms(wanted.dictionary, knots), wanted.penalty.nonnegative)
        scores.append(score(part.sweep(sigma)))
    if not scores:
        raise NotIdentifiable("the record holds nothing beyond its noise: no candidate is needed to explain it",
                              advice="check the noise level (noise=)", code="LID-E312")  # fmt: skip
    return np.sort(order[: int(np.argmin(scores)) + 1]), found.gap


def amplitude_share(chosen: SparseChoice) -> tuple[float, int] | None:
    """Std of the largest spike over its height if its neighbours in time may act too, and its load; spikes only."""
    atoms = chosen.atoms
    if not isinstance(atoms, ShiftedAtoms) or atoms.dictionary.name != "dirac" or not len(chosen.fit.x):
        return None
    support = chosen.fit.support
    wide = np.concatenate([support, support - atoms.loads, support + atoms.loads])
    wide = np.unique(wide[(wide >= 0) & (wide < atoms.n)])
    if len(wide) > chosen.problem.data:
        return float("inf"), int(atoms.load[support[0]])
    k = int(np.argmax(np.abs(chosen.fit.x)))
    std = fit(atoms, chosen.problem.y.reshape(-1), wide).std[int(np.searchsorted(wide, support[k]))]
    return float(chosen.sigma * std / abs(chosen.fit.x[k])), int(atoms.load[support[k]])


__all__ = ["Problem", "SparseChoice", "Wanted", "amplitude_share", "choose", "pose", "score"]
