"""Where a load of unknown history acted: every candidate place fitted alike, the smallest residual, refined between."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._flags import Flag
from structures._model import Model, as_model
from structures.errors import InputError, shown

from .. import _guards as guards
from .._guards import families as found_flags
from .._inverse.choice import is_rule
from .._inverse.convolved import fits, places
from .._inverse.problem import whiten
from .._results.estimate import LoadEstimate
from .._results.facts import provenance
from .._results.location import LocationFacts, LocationResult, Rival
from .._spellings import Progress, takes
from ..design._candidates import of_model
from ..settings import Guards, Lambda, Noise, Search
from . import noise as noises
from .data import Data, gather
from .deconvolution import Deconvolution
from .offsets import without_offsets
from .posing.locating import (
    DENSE,
    CandidateLoads,
    CandidateVerdict,
    FactoredCandidates,
    Grid,
    LocationProblem,
    Solution,
    basins,
    compared,
    grid_of,
    noise_level,
    rivals_of,
    shared,
)
from .posing.model_errors import ASSUMED
from .posing.placing import Placed, by_evidence

Array = NDArray[np.float64]
MEMORY = 1.5e9  # bytes of all factors together, up to which they are kept
RIVALS = 3  # other basins that are refined too, for each load
BESIDE = 2  # neighbours of the best from which the place is refined too: between candidates lie local minima
HOPELESS = 2.0  # times the least objective above which a rival is given up after some steps
LAM = 1e-3  # relative lambda of the search, where nobody says another
LEVEL = 0.95  # of the chi-square set of candidates


class LocationSearch:
    """Place and history of a load whose place is not known.

    Each load of the model is a candidate. Every one is fitted to the whole record by Tikhonov regularisation with the
    same lambda over the largest singular value of its own operator; the smallest residual wins. Between candidates the
    place is refined by Gauss-Newton steps, the history eliminated, with responses of the model at the very place where
    it can move its loads, else interpolated over the grid. Hits, which a model with states tells, are put where the
    evidence of loads that rest before and after is the largest; a single one whose record the model does not explain,
    by the part about its onset, where errors of frequencies tell least. A family then rebuilds the load there.

    Parameters
    ----------
    model : Model
        Its loads are the candidates; it must give ``impulse_response``.
    family : callable
        Family that rebuilds the load at the places found: ``family(model, **settings)``.
    choice : float or Lambda
        Relative lambda of the search, one for all candidates. From 1e-5 to 1e-2 it hardly matters; above 0.03 residuals
        measure bias. Rules and truncation differ from candidate to candidate and are refused (LID-E513).
    search : Search
        Loads that act, places of the candidates, whether places between them are sought, threads: `loadid.Search`.
    hold : {"foh", "zoh"}, optional
        How a load moves between samples; default the model's own.
    noise, sensors
        As for `Deconvolution`; errors of the model are in the band of the place of a hit, else gains of sensors alone.
    settings : mapping, optional
        Further settings of the family (``{"choice": "discrepancy"}``).
    allow : sequence of str
        Guard codes whose refusal is overridden: LID-E512, and those of the family.
    progress : callable, optional
        Called as ``progress(fraction, text)``; what it raises ends the search, and nothing is kept.

    Raises
    ------
    InputError
        Settings that are none, fewer than two candidates.
    NotIdentifiable
        LID-E513, as said.

    Notes
    -----
    19 candidates on a beam, three or two accelerometers, 1 to 30 % noise (``python -m tests.benchmarks.location``): all
    misses of 1520 searches had a runner-up within 1.045 of the best residual, hence the threshold of flag W511. The
    factors of all candidates are kept: further records of the same length cost products only.
    """

    name = "location"

    @takes(
        choice=(Lambda, "method"),
        search=(Search, "impacts refine places workers"),
        noise=(Noise, "source errors"),
        allow=(Guards, ""),
    )
    def __init__(
        self,
        model: Model,
        family: Callable[..., Any] = Deconvolution,
        *,
        choice: float | Lambda = LAM,
        search: Search = Search(),  # noqa: B008 -- immutable
        hold: str | None = None,
        noise: ArrayLike | Noise | None = None,
        sensors: Sequence[str | int] | None = None,
        settings: Mapping[str, Any] | None = None,
        allow: Sequence[str] | Guards = (),
        progress: Callable[[float, str], None] | None = None,
    ) -> None:
        _check_candidates(model)
        self.choice = _one_lambda(choice)
        asked = Search.of(search)
        self.impacts, self.refine, self.workers = asked.impacts, asked.refine, asked.workers
        if self.impacts >= len(model.loads):
            raise InputError("no number of loads", where="impacts", found=self.impacts,
                             expected=f"an integer from 1 to {len(model.loads) - 1}")  # fmt: skip
        self.allow = Guards.of(allow).codes
        if not callable(family):
            raise InputError("no family", where="family", found=repr(family), expected="a class such as Deconvolution",
                             hint="family=loadid.Deconvolution")  # fmt: skip
        self.model, self.family = model, family
        self.noise, self.sensors, self.hold = Noise.of(noise), sensors, hold
        self.settings = dict(settings or {})
        self.grid = grid_of(model, asked.places)
        self._progress = Progress(progress)
        self._kept: tuple[Any, FactoredCandidates] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_kept": None}  # the factors of a long record are large: they are made again

    def check(self, dt: float, samples: int) -> tuple[Flag, ...]:
        """Guards that need the model only: E512 where candidates at different places leave the same data.

        Parameters
        ----------
        dt : float
            Step (s) of the records to come.
        samples : int
        """
        h = self.model.impulse_response(dt, samples, self.hold or self.model.default_hold)
        groups = self._alike(h)
        found = [found_flags.alike_allowed(groups, fits.ALIKE)] if groups else []
        return guards.collect([*self.model.flags, *found])

    def estimate(self, record: Any, dt: float | None = None) -> LocationResult:
        """Places of the loads that caused a record, and the loads there.

        Parameters
        ----------
        record : Record, or array of shape (samples, sensors)
        dt : float, optional
            Step in s of a bare array.

        Raises
        ------
        InputError
            A record that does not fit the model, or candidates that no sensor sees.
        NotIdentifiable
            Candidates at different places that leave the same data (LID-E512), unless allowed; what the family refuses.
        """
        found, posed = self._locate(record, dt)
        self._progress(0.9, "estimating the load")
        if self.refine and posed.candidates.how and posed.at is not None:
            model = posed.candidates.at(posed.at)
        else:
            model = posed.candidates.chosen(found.best)
        load: LoadEstimate = self.family(model, **self._family_settings()).estimate(record, dt)
        self._progress(1.0, "done")
        return replace(found, estimate=replace(load, flags=(*load.flags, *_own(found.flags))))

    def locate(self, record: Any, dt: float | None = None) -> LocationResult:
        """As `estimate`, without the load: the places alone."""
        found = self._locate(record, dt)[0]
        self._progress(1.0, "done")
        return found

    # -- steps --------------------------------------------------------------------------------------------------------
    def _locate(self, record: Any, dt: float | None) -> tuple[LocationResult, LocationProblem]:
        data = without_offsets(gather(record, dt, self.model, self.sensors), self.model, at_rest=True, allow=self.allow)
        posed = self._pose(data)
        self._progress(0.6, "comparing candidates")
        chosen = self._choose(posed)
        verdict = compared(posed, chosen)
        self._progress(0.7, "refining the place")
        solutions = self._refine(posed, chosen) if self.refine and posed.candidates.how else []
        return self._result(posed, chosen, verdict, solutions)

    def _pose(self, data: Data) -> LocationProblem:
        noise = noises.resolve(self.noise, self.model, data)
        level = np.asarray(noise.level, float)
        size = float(np.sqrt(np.mean(level**2 if level.ndim == 1 else np.diagonal(level))))
        relative = level / (size if level.ndim == 1 else size**2)
        key = (data.dt, len(data.values), data.rows.tobytes(), relative.round(12).tobytes())
        last = self._kept  # read once: another thread may be at another record
        if last is None or last[0] != key:
            last = self._kept = None  # the old factors must not lie beside the new ones
            last = self._kept = key, self._factor(data, relative)
        kept = last[1]
        y = whiten(data.values, relative, axis=1)
        if not np.any(y):
            raise InputError("the record is zero throughout", where="record", expected="a response",
                             hint="record the event")  # fmt: skip
        return LocationProblem(data, noise, size if noise.known else None, y, relative, **vars(kept))

    def _factor(self, data: Data, relative: Array) -> FactoredCandidates:
        samples = len(data.values)
        candidates = CandidateLoads(self.model, self.grid, data.dt, samples, self.hold or self.model.default_hold)
        groups = self._alike(candidates.h[:, data.rows], relative)
        if groups and "LID-E512" not in self.allow:
            raise found_flags.alike(groups, fits.ALIKE)
        h = whiten(candidates.h[:, data.rows], relative, axis=1)
        size = 8 * samples * (h[:, :, 0].size + samples)
        kind = fits.DenseFit if samples <= DENSE and size * h.shape[2] <= MEMORY else fits.LongFit
        made = fits.over(
            lambda j: kind(h[:, :, j, None], relative=self.choice),
            range(h.shape[2]),
            workers=self.workers,
            progress=lambda fraction, text: self._progress(0.6 * fraction, text),
            text="factorising candidates",
        )
        return FactoredCandidates(candidates, h, tuple(made), groups)

    def _alike(self, h: Array, relative: Array | None = None) -> tuple[tuple[str, ...], ...]:
        white = h if relative is None else whiten(h, relative, axis=1)
        found = fits.groups(white, None if self.grid is None else self.grid.near)
        return tuple(tuple(self.model.loads[j].label for j in group) for group in found)

    def _choose(self, posed: LocationProblem) -> places.CandidateSet:
        """The best candidates, and the scores of all."""
        solved = fits.over(
            lambda fit: fit.solve(posed.y), posed.fits, workers=1 if posed.dense else self.workers,
            progress=lambda fraction, text: self._progress(0.6 + 0.1 * fraction, text), text="comparing candidates",
        )  # fmt: skip
        scores = np.array([s.residual2 for s in solved])
        if self.impacts == 1:
            best = int(np.argmin(scores))
            return places.CandidateSet((best,), solved[best], scores[None])
        lam = np.array([float(f.lam[0]) for f in posed.fits])
        problem = places.Joint(posed.y, posed.h / lam, posed.fits, posed.joint)
        return places.together(problem, self.impacts)

    def _refine(self, posed: LocationProblem, chosen: places.CandidateSet) -> list[Solution]:
        """The place from the best candidates and from rivals in other basins; each with its origin and its load."""
        grid = self.grid
        assert grid is not None
        lam = np.array([float(posed.fits[j].lam[0]) for j in chosen.indices])
        starts = [(chosen.indices, "", 0)]
        for k, best in enumerate(chosen.indices):
            beside, beyond = basins(chosen.scores[k], grid.near, best)
            for j in [*beside[:BESIDE], *beyond[:RIVALS]]:
                if j not in chosen.indices:
                    moved = tuple(j if i == k else b for i, b in enumerate(chosen.indices))
                    starts.append((moved, self.model.loads[j].label, k))

        def one(start: tuple[tuple[int, ...], str, int], enough: float | None = None) -> Solution:
            place = grid.places[np.array(start[0])][:, grid.used]
            found = places.refine(
                place, posed.y, lam, posed.whitened, posed.fit, grid.bounds, grid.spacing, hopeless=enough
            )
            return found, start[1] or self.model.loads[start[0][0]].label, start[2]

        first = one(starts[0])
        others = fits.over(
            lambda start: one(start, HOPELESS * first[0].objective), starts[1:], workers=self.workers,
            progress=lambda fraction, text: self._progress(0.75 + 0.15 * fraction, text), text="refining other places",
        )  # fmt: skip
        return [first, *others]

    def _hit(
        self, posed: LocationProblem, grid: Grid, winner: places.Refined, others: list[Solution], left: float | None
    ) -> Placed | None:
        """Where the evidence puts hits, from what the winner leaves over the noise; None where none are asked for."""
        self._progress(0.9, "places of hits by their evidence")
        rivals = [(load, one.place[load]) for one, _, load in others if one is not winner]
        return by_evidence(posed, grid, winner.place, left, rivals, self.noise.errors or {}, self.hold)

    # -- saying -------------------------------------------------------------------------------------------------------
    def _result(
        self, posed: LocationProblem, chosen: places.CandidateSet, verdict: CandidateVerdict, solutions: list[Solution]
    ) -> tuple[LocationResult, LocationProblem]:
        grid, norm = self.grid, float(np.linalg.norm(posed.y))
        residual2, best, at, covariance = chosen.fitted.residual2, chosen.indices, None, None
        rivals: tuple[Rival, ...] = ()
        found, hit = None if grid is None else grid.places[np.array(best)], None
        sigma = noise_level(posed, residual2, chosen)
        edge = False
        if solutions and grid is not None:
            winner = min((s[0] for s in solutions), key=lambda r: r.fitted.residual2)
            residual2, at, edge = winner.fitted.residual2, winner.place, winner.edge
            sigma = noise_level(posed, residual2, chosen)
            hit = self._hit(posed, grid, winner, solutions, _over_noise(residual2, posed))
            if hit is None:
                gain = {**ASSUMED, **(self.noise.errors or {})}["gain"]
                spread = winner.covariance(shared(sigma, posed.sigma), gain)
            else:
                at, spread, edge = hit.place, hit.covariance, hit.edge
                lam = np.array([float(posed.fits[j].lam[0]) for j in chosen.indices])
                residual2 = posed.fit(posed.whitened(at), lam).solve(posed.y).residual2
            found = grid.full(at)
            best = tuple(int(np.argmin(np.linalg.norm(grid.places - p, axis=1))) for p in found)
            covariance = np.zeros((len(found), *[found.shape[1]] * 2))
            covariance[np.ix_(np.arange(len(found)), grid.used, grid.used)] = spread
            told = None if hit is None else hit.rivals
            rivals = rivals_of(solutions, at, residual2, grid) if told is None else told
        posed = replace(posed, at=at)
        level = _over_noise(residual2, posed)
        exact = chosen.fitted.exact and all(s[0].fitted.exact for s in solutions)
        facts = LocationFacts(
            path=posed.fits[0].name, m=int(posed.y.size), n=len(posed.y) * len(best),
            edf=sum(posed.fits[j].edf for j in chosen.indices), lam=self.choice, residual_to_noise=level,
            noise_level=sigma, **posed.noise.source.facts, candidates=len(self.model.loads),
            sensors=len(posed.data.rows), exact=bool(exact), ratio=verdict.ratio,
            responses=posed.candidates.how if solutions else "candidates only",
            place_by="candidates" if not solutions else "residual" if hit is None else hit.by,
        )  # fmt: skip
        result = LocationResult(
            labels=[c.label for c in self.model.loads],
            places=None if grid is None else grid.places,
            spacing=None if grid is None else grid.spacing,
            scores=np.sqrt(chosen.scores) / norm,
            best=best,
            runner_up=verdict.runner_up,
            ratio=verdict.ratio,
            plausible=[self._plausible(scores, sigma) for scores in chosen.scores],
            alike=posed.groups,
            found=found,
            covariance=covariance,
            refined=bool(solutions),
            residual=float(np.sqrt(residual2)) / norm,
            rivals=rivals,
            allowed=self.allow,
            geometry=self._geometry(posed.data),
            facts=facts,
            provenance=self._provenance(posed),
        )
        return replace(result, flags=self._flags(posed, result, verdict, hit, edge)), posed

    def _plausible(self, scores: Array, sigma: float) -> list[str]:
        from scipy.stats import chi2

        dim = 1 if self.grid is None else len(self.grid.used)
        within = np.flatnonzero(scores <= scores.min() + sigma**2 * chi2.ppf(LEVEL, dim))
        return [self.model.loads[j].label for j in within[np.argsort(scores[within], kind="stable")]]

    def _flags(
        self, posed: LocationProblem, result: LocationResult, verdict: CandidateVerdict, hit: Placed | None, edge: bool
    ) -> tuple[Flag, ...]:
        where, names = result.where, result.labels
        found: list[Flag | None] = [found_flags.alike_allowed(posed.groups, fits.ALIKE)] if posed.groups else []
        if result.refined:
            assert result.std is not None
            assert result.spacing is not None
            found += [
                found_flags.ambiguous(r.ratio, where[r.load], f"a load near candidate {r.label}")
                for r in result.rivals[:1]
            ]
            found += [
                found_flags.blurred(float(np.max(s)), result.spacing, w) for s, w in zip(result.std, where, strict=True)
            ]
            found += [found_flags.at_the_rim(where[0])] if edge else []
        else:
            found.append(found_flags.ambiguous(verdict.ratio, names[verdict.best], names[verdict.runner_up]))
        data, model = posed.data, self.model
        return guards.collect(
            [
                found_flags.few_sensors(len(data.rows), len(result.best)),
                found_flags.biased(self.choice),
                found_flags.place_unexplained(
                    result.facts.residual_to_noise, result.residual, None if hit is None else hit.misfit
                ),
                *found,
                *model.flags,
                guards.not_verified(model.certificate),
                *data.findings,
                guards.mixed_kinds(data.channels, posed.noise.known),
                guards.aliased(model.natural_frequencies, data.dt),
                guards.inverse_crime(data.simulated_by, model.fingerprint),
            ]
        )

    def _geometry(self, data: Data) -> dict[str, Any]:
        sensors, _, outline = of_model(self.model)
        parts = {"sensors": None if sensors is None else sensors[data.rows], "outline": outline}
        return {name: np.asarray(value, float) for name, value in parts.items() if value is not None}

    def _family_settings(self) -> dict[str, Any]:
        common = {"noise": self.noise, "sensors": self.sensors, "hold": self.hold}
        given = {name: value for name, value in common.items() if value is not None}
        return given | ({"allow": self.allow} if self.allow else {}) | self.settings

    def _provenance(self, posed: LocationProblem) -> dict[str, Any]:
        return provenance(
            self.name,
            settings={
                "choice": self.choice, "impacts": self.impacts, "refine": self.refine, "hold": self.hold,
                "family": getattr(self.family, "name", getattr(self.family, "__name__", "a callable")),
            },
            inputs=posed.data.inputs,
            model=self.model.fingerprint,
            prior="a load of zero mean and constant variance, white in time; any candidate alike",
        )  # fmt: skip


def _over_noise(residual2: float, posed: LocationProblem) -> float | None:
    """Residual over the noise, where that is known."""
    return None if posed.sigma is None else float(np.sqrt(residual2 / posed.y.size)) / posed.sigma


def _own(flags: Sequence[Flag]) -> tuple[Flag, ...]:
    """Flags of the place, for the load estimate that has all others already."""
    return tuple(f for f in flags if f.code in ("LID-W511", "LID-E512"))


def _check_candidates(model: Model) -> None:
    if len(as_model(model, "LocationSearch", "impulse_response").loads) < 2:
        raise InputError(
            "no candidates", where="LocationSearch",
            found=f"a model with {len(model.loads)} load",
            expected="a model whose loads are at least two candidate places",
            hint="ForwardModel(structure, sensors, [loads.Point(at=x) for x in grid])",
        )  # fmt: skip
    kinds = {(c.quantity, c.unit) for c in model.loads}
    if len(kinds) > 1:
        raise InputError(
            "candidates of different kinds", where="LocationSearch", found=sorted(f"{q} ({u})" for q, u in kinds),
            expected="one kind of load", hint="search forces and moments in two searches",
        )  # fmt: skip


def _one_lambda(given: Any) -> float:
    choice: Any = given.choice if isinstance(given, Lambda) else given
    choice = LAM if choice is None else choice
    if np.ndim(choice) > 0 or isinstance(choice, Mapping):
        raise found_flags.not_comparable("a lambda for each", f"{len(choice)} values")
    if Lambda.of(given).method == "tsvd":
        raise found_flags.not_comparable("a truncation rank", "method='tsvd'")
    if is_rule(choice):
        raise found_flags.not_comparable("a rule, which chooses another lambda for each", shown(choice))
    if isinstance(choice, bool) or not isinstance(choice, int | float | np.number) or not 0 < choice < 1:
        raise InputError("no relative lambda", where="choice", found=repr(choice), expected="a number between 0 and 1",
                         hint="choice=1e-3")  # fmt: skip
    return float(choice)
