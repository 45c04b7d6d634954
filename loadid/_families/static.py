"""Static inversion: loads from static strains or displacements, by the transfer matrix of a forward model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._advice import Advice, Option
from structures._flags import Flag
from structures._model import Model, as_model
from structures._models.arrays import MatrixModel
from structures.errors import InputError, NotIdentifiable

from .. import _guards as guards
from .._inverse.choice import Choice, checked, choose, given, moved, named
from .._inverse.diagnosis import diagnose, identifiability
from .._inverse.path import Solution
from .._results.again import Again
from .._results.estimate import LoadEstimate
from .._results.facts import STATIC, Facts
from .._spellings import Progress, takes
from ..settings import Absolute, ChoiceLike, Guards, Lambda, Noise, Penalty
from . import detection, smoothness
from .answer import answer, of_path, of_static, prior_of, undetermined
from .data import Readings, readings
from .frozen import Calibration, Frozen, at_rest, calibrate, each_frame, freeze
from .noise import noise_level
from .posing.steady import MEETING, StaticProblem, drawn, missing, pose, transfer
from .smoothness import geometry

MANY = 16  # loads from which their mesh can be called fine
IDENTITY = Option("penalty", "identity")
SMALLEST = 1e-100  # relative lambda: its inverse square, the variance of the prior, must stay a number


class StaticInversion:
    """Loads from static readings.

    Minimises ``|R^(-1/2) (H g - y)|^2 + lambda^2 |L g|^2`` with the static transfer matrix H (sensors x loads), by SVD
    or, for any penalty L, by the generalised one (Hansen, Rank-Deficient and Discrete Ill-Posed Problems, SIAM 1998).
    Several readings share one lambda.

    Parameters
    ----------
    model : Model, or array (sensors, loads)
        Anything that gives ``static()``. Loads may be a `structures.bases` basis: then results know their geometry.
    penalty : str, array or None
        ``identity``; ``gradient`` or ``laplacian`` of the load field (differences in the order of the loads where the
        model knows no places); ``first_difference``, ``second_difference`` in the order of the loads; a matrix
        (rows, loads); or None for plain least squares, refused where the data do not determine the load.
    choice : str, callable, float, Absolute, None or Lambda
        Rule by name or itself, or relative lambda; None chooses as `loadid.paths.choose` says.
        Truncation in place of Tikhonov: ``Lambda(method="tsvd")``.
    constraints : sequence
        From `loadid.constraints`: non-negativity, bounds, support, resultants, friction cones.
    noise : float, array, Cholesky or Noise, optional
        Noise std of the sensors, (sensors,), or their covariance (sensors, sensors), or its Cholesky factor; with where
        it comes from, or that of the markers which readings were interpolated from: `loadid.Noise`.
    sensors : sequence of str or int, optional
        Sensors of the model to use; default all.
    allow : sequence of str, or Guards
        Guard codes whose refusal is overridden; printed on everything made from the result. With what was checked:
        `loadid.Guards`.
    progress : callable, optional
        Called as ``progress(fraction, text)``.

    Raises
    ------
    InputError
        Unknown settings, a model without ``static()``, or a transfer matrix without any coupling (LID-E102).
    """

    name = STATIC

    @takes(
        penalty=(Penalty, ""),
        choice=(Lambda, "method"),
        noise=(Noise, "source interpolation"),
        allow=(Guards, "coverage"),
    )
    def __init__(
        self,
        model: Model | ArrayLike,
        *,
        penalty: str | ArrayLike | Penalty | None = "identity",
        choice: ChoiceLike = None,
        constraints: Sequence[Any] | Any = (),
        noise: Any = None,
        sensors: Sequence[str | int] | None = None,
        allow: Sequence[str] | Guards = (),
        progress: Callable[[float, str], None] | None = None,
    ) -> None:
        lam, told_of = Lambda.of(choice), Guards.of(allow)
        self.method, self.penalty, self.choice = lam.method, Penalty.of(penalty).L, lam.choice
        if not isinstance(self.choice, Absolute):
            self.choice = checked(self.choice, SMALLEST)
        if self.penalty is None:
            if self.choice not in (None, 0.0):
                raise InputError(
                    "without a penalty there is no lambda to choose", where="choice", found=self.choice, expected="None"
                )
            self.choice = 0.0
        self.model = as_model(MatrixModel.of(model), "StaticInversion", "static")
        self.constraints = tuple(constraints) if isinstance(constraints, list | tuple) else (constraints,)
        if self.constraints and self.method == "tsvd":
            raise InputError(
                "a truncated SVD takes no constraints", where="method", found="tsvd", expected="method='tikhonov'"
            )
        self.noise, self.sensors = Noise.of(noise), sensors
        self.allow, self.coverage = told_of.codes, told_of.coverage
        self._progress = Progress(progress)
        self.basis = self.model.basis
        self.geometry = None if self.basis is None else geometry(self.basis)
        self.H = transfer(self.model, self.allow)
        self.L = smoothness.matrix(self.penalty, self.H.shape[1], self.basis)
        self.calibration: Calibration | None = None
        self._prior: tuple[NDArray[np.float64], NDArray[np.float64] | None] | None = None

    # -- doing --------------------------------------------------------------------------------------------------------
    def estimate(self, found: Any, *, joint: bool = True) -> LoadEstimate:
        """Rebuild the loads behind static readings.

        Parameters
        ----------
        found : array (sensors,) or (frames, sensors), mapping of label to reading, or Record
            In the units of the sensors.
        joint : bool
            One lambda for all frames. False chooses anew in each, which makes frames hard to compare (flag W409).

        Returns
        -------
        LoadEstimate
            Loads (loads,) or (frames, loads).

        Raises
        ------
        InputError
            Readings that do not fit the model, NaN, a sensor that no load moves, constraints that contradict.
        NotIdentifiable
            Loads that neither the sensors nor the penalty determine (LID-E306), constraints that nothing meets
            (LID-E309).
        """
        given = readings(found, self.model, self.sensors)
        self._progress(0.1, "posing the problem")
        posed = self.pose(given)
        self.refuse_undetermined(posed)
        if not joint and len(given.values) > 1:
            return each_frame(self, given)
        self._progress(0.4, "choosing lambda")
        choice = self.choose(posed)
        self._progress(0.8, "estimating the load")
        return self.kept(given, posed, choice)

    def calibrate(self, records: Sequence[Any]) -> Calibration:
        """Choose one relative lambda for several readings, and keep it for `estimate` and `freeze`.

        Parameters
        ----------
        records : sequence of readings, as `estimate` takes them

        Returns
        -------
        Calibration
            The joint lambda, that of each record alone, and their spread.
        """
        self.calibration = None
        self.calibration = calibrate(self, records)
        return self.calibration

    def freeze(self) -> Frozen:
        """The inverse at a fixed lambda, with its date and the source of the noise level, for a stream of readings.

        Raises
        ------
        InputError
            If lambda is not fixed: neither calibrated nor given as a number.
        """
        return freeze(self)

    def sample(self, found: Any, draws: int = 200, *, seed: int = 0) -> NDArray[np.float64]:
        """Loads drawn from the posterior, (draws, loads) or (draws, frames, loads).

        Lambda, where a rule chose it, and a noise level that nobody stated are drawn too, by their evidence. Under
        constraints each draw is a solution for perturbed data and prior, which meets them (randomise-then-optimise, an
        approximation; see `ConstrainedPath.sample`): bands made of them are one-sided where they must be.
        """
        posed = self.pose(readings(found, self.model, self.sensors))
        self.refuse_undetermined(posed)
        choice = self.choose(posed)
        return drawn(posed, choice, noise_level(posed.path, choice, posed.noise), draws, seed, chosen=self.searching)

    # -- steps ----------------------------------------------------------------------------------------------------
    def pose(self, given: Readings, told: Any = None) -> StaticProblem:
        """Problem of these readings; `told` is the noise level of a calibration, where nobody stated one."""
        return pose(
            self.model,
            given,
            H=self.H,
            L=self.L,
            truncated=self.method == "tsvd",
            constraints=self.constraints,
            noise=self.noise if self.noise.stated else replace(self.noise, std=told),
        )

    def choose(self, posed: StaticProblem) -> Choice:
        """Lambda of a problem: of the calibration, of the user, or by the rules.

        One that is given is not judged by rules under constraints: each rule would ask for a solution at many others.
        """
        choice = self.choice
        if self.calibration is not None:
            choice = self.calibration.lam
        elif isinstance(choice, Absolute):
            choice = choice.relative(posed.path)
        judge = given if posed.constrained and isinstance(choice, float) else choose
        return judge(posed.path, choice, sigma=posed.noise.sigma, source=posed.noise.source)

    @property
    def free(self) -> bool:
        """Without regularisation."""
        return self.penalty is None or self.choice == 0

    @property
    def searching(self) -> bool:
        """Lambda is chosen from the readings themselves."""
        return self.calibration is None and not isinstance(self.choice, float | Absolute)

    def answer(self, given: Readings, posed: StaticProblem, choice: Choice) -> LoadEstimate:
        """Estimate of a problem at the lambda of a choice."""
        path = posed.path
        # a residual above the stated noise is model error: the band must not be narrower than what is seen
        sigma = noise_level(path, choice, posed.noise)
        chosen = self.searching
        solution = posed.solution(choice, sigma, chosen=chosen)
        response = given.values[0] if given.axis is None else given.values
        frame = np.atleast_2d(solution.load)[-1]
        diagnosis = diagnose.diagnose(posed.base, choice.lam, sigma, load=frame, geometry=self.geometry)
        found = of_path(
            path, choice, solution, sigma, posed.noise, layout=posed.layout, axis=given.axis, response=response,
            residual=response - solution.load @ posed.H.T, facts=posed.facts(solution, diagnosis, chosen=chosen),
            hidden_by=None if posed.constrained else posed.base, along=-1,
        )  # fmt: skip
        self._progress(1.0, "done")
        return answer(
            self, given,
            replace(found, geometry=self.geometry, diagnosis=diagnosis,
                    not_told=detection.of_readings(posed, choice.lam, self.model.loads)),
            choice, known=posed.noise.known,
            searched=path, solved=path, full=posed.full, free=self.free, judged=not self.free,
            settings=self._settings(posed), prior=smoothness.words(self.penalty, self.basis),
            flags=self._flags(posed, choice, found.facts, diagnosis, self._biased(posed, choice, solution, sigma)),
            spare=of_static(
                posed.H, given.values, posed.noise, given.channels, None if self.free else self._expected
            ),
        )  # fmt: skip

    def kept(self, given: Readings, posed: StaticProblem, choice: Choice) -> LoadEstimate:
        """The answer, with the problem that it can be asked of at another lambda; not without regularisation."""
        found = self.answer(given, posed, choice)
        if self.free:
            return found
        return replace(found, again=Again(posed.path, partial(self._at, given, posed, choice)))

    def _at(self, given: Readings, posed: StaticProblem, choice: Choice, lam: float) -> LoadEstimate:
        own = copy(self)
        own.choice, own.calibration, own._progress = lam, None, Progress(None)
        now = own.choose(posed) if posed.constrained else moved(choice, posed.path, lam)
        return own.kept(given, posed, now)

    def at_rest(self) -> StaticProblem:
        """The problem without readings: what a frozen inverse is made of."""
        return at_rest(self)

    def _expected(self) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """The prior of the loads; that of a penalty is the same for all readings, and is kept."""
        if self.L is None:
            return prior_of(None, self.H.shape[1])
        if self._prior is None:
            self._prior = prior_of(self.L, self.H.shape[1])
        return self._prior

    # -- saying ---------------------------------------------------------------------------------------------------
    def refuse_undetermined(self, posed: StaticProblem) -> None:
        """Refuse a load that neither the sensors nor the penalty nor the constraints determine (LID-E306)."""
        n, sensors = self.H.shape[1], f"{len(posed.H)} sensors"
        if "LID-E306" in self.allow:
            return
        if self.L is not None and posed.base.meeting < MEETING:
            raise NotIdentifiable(
                "the null spaces of the sensors and of the penalty nearly meet: the smallest singular value of "
                f"[H/|H|; L/|L|] is {posed.base.meeting:.2g}, below {MEETING:.2g}",
                advice=Advice("add another sensor, or use ", IDENTITY, " (with a resultant as a constraint, if known)"),
                code="LID-E306",
            )
        if not self.free or posed.rank == n:
            return
        if not posed.constrained:
            advice = Advice("add sensors, use a penalty (", IDENTITY, "), or fewer loads")
            raise undetermined(posed.rank, f"{n} unknowns", sensors, advice)
        if lacking := missing(posed):
            raise NotIdentifiable(
                f"without regularisation the load is not determined: rank {posed.rank} of {n} unknowns, and the "
                f"constraints leave {lacking} load pattern{'s' if lacking > 1 else ''} free to move",
                advice=Advice("add sensors or a resultant, use a penalty (", IDENTITY, "), or fewer loads"),
                code="LID-E306",
            )

    def _flags(
        self, posed: StaticProblem, choice: Choice, facts: Facts, diagnosis: diagnose.Diagnosis, bias: float | None
    ) -> list[Flag | None]:
        unseen = [c.label for c, column in zip(self.model.loads, posed.H.T, strict=True) if not np.any(column)]
        edf = None if choice.edf is None else choice.edf / diagnosis.frames
        coupled = "LID-E102" not in self.allow or guards.diagonal(self.H) is None
        return [
            None if coupled else guards.overridden("E102", "off-diagonal entries", 0, 1),
            guards.null_space(facts["m"], facts["n"], facts["rank"], unseen),
            posed.correlated,
            guards.over_smoothed(edf, diagnosis.plateau, bias),
            guards.recoverable(diagnosis.plateau, diagnosis.seen, edf),
            self._refined(posed, diagnosis),
            *posed.fought(choice, posed.noise.sigma or facts["noise_level"]),
            guards.absolute_lambda(self.choice.lam, choice.scale) if isinstance(self.choice, Absolute) else None,
            guards.resolution(
                facts["nullity"], smoothness.words(self.penalty, self.basis), facts["resolution"],
                facts["resolution_unit"], facts["peak_bias"],
            ),
        ]  # fmt: skip

    def _biased(self, posed: StaticProblem, choice: Choice, solution: Solution, sigma: float) -> float | None:
        """What lambda would take from the resultants of the estimated load, over their std, at most; of the last frame.

        None under constraints, and where nothing is known of the error. At a lambda that was given the std is that of
        the stated noise: what a lambda too large leaves in the residual is no noise.
        """
        if posed.constrained or solution.posterior is None or not choice.lam > 0:
            return None
        load = np.asarray(solution.load)
        lost = np.atleast_2d(posed.base.resolve(load, choice.lam) - load)[-1]
        totals = np.ones((1, len(lost))) if self.basis is None else np.asarray(self.basis.resultant())
        std = [np.sqrt(float(solution.posterior.variance(w))) for w in totals]
        own = 1.0 if self.searching or posed.noise.sigma is None or not sigma > 0 else sigma / posed.noise.sigma
        return max((own * abs(float(w @ lost)) / s for w, s in zip(totals, std, strict=True) if s > 0), default=None)

    def _refined(self, posed: StaticProblem, diagnosis: diagnose.Diagnosis) -> Flag | None:
        """W107, where no penalty ties neighbouring loads together."""
        basis = self.basis
        if self.L is not None or (basis is not None and basis.kind == "polynomials") or diagnosis.n < MANY:
            return None
        parts = {} if basis is None else {"components": len(basis.components), "edges": basis.edges}
        return guards.refined(identifiability.against_half(posed.base.problem.H, diagnosis.eta, **parts))

    def _settings(self, posed: StaticProblem) -> dict[str, Any]:
        return {
            "method": self.method,
            "penalty": self.penalty if isinstance(self.penalty, str | None) else "matrix",
            "choice": self.choice.lam if isinstance(self.choice, Absolute) else named(self.choice),
            "calibration": None if self.calibration is None else str(self.calibration),
            "constraints": [str(c) for c in self.constraints],
            "constraint_kinds": [type(c).__name__ for c in self.constraints],
            "path": posed.solved_by,
            "noise_source": posed.noise.source.text,
            "interpolated": self.noise.interpolation is not None,
            "sensors": None if self.sensors is None else [str(s) for s in self.sensors],
        }
