"""Static inversion: loads from static strains or displacements, by the transfer matrix of a forward model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, real
from structures.model import Model, as_model
from structures.models.arrays import MatrixModel

from ..inverse.choice import Choice, choose
from ..inverse.diagnosis import diagnose
from ..inverse.sweep import LARGEST
from ..results.archive import STATIC, provenance
from ..results.estimate import LoadEstimate
from ..settings import Absolute, ChoiceLike, Guards, Lambda, Noise, Penalty, takes
from . import smoothness
from .data import Readings, readings, rows_of
from .frozen import Calibration, Frozen, calibrate, freeze, refuse_undetermined
from .noise import graded, noise_level, unexplained_by
from .posing import steady as telling
from .posing.steady import Steady, drawn, pose, transfer
from .smoothness import geometry

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
        Rule, or relative lambda; None chooses as `loadid.inverse.choice.choose` says. Truncation in place of Tikhonov:
        ``Lambda(method="tsvd")``.
    constraints : sequence
        From `loadid.inverse.constraints`: non-negativity, bounds, support, resultants, friction cones.
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
        if real(self.choice) is not None:
            self.choice = _relative(self.choice)
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
        self._progress = progress or (lambda fraction, text: None)
        self.basis = self.model.basis
        self.geometry = None if self.basis is None else geometry(self.basis)
        self.H = transfer(self.model, self.allow)
        self.L = smoothness.matrix(self.penalty, self.H.shape[1], self.basis)
        self.calibration: Calibration | None = None

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
        refuse_undetermined(self, posed)
        if not joint and len(given.values) > 1:
            from .frozen import each_frame

            return each_frame(self, given)
        self._progress(0.4, "choosing lambda")
        choice = self.choose(posed)
        self._progress(0.8, "estimating the load")
        return self.answer(given, posed, choice)

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

        Without constraints these are draws of the Gaussian posterior; under constraints each draw is a solution for
        perturbed data and prior, which meets them (randomise-then-optimise, an approximation; see
        `ConstrainedPath.sample`): bands made of them are one-sided where they must be.
        """
        posed = self.pose(readings(found, self.model, self.sensors))
        refuse_undetermined(self, posed)
        choice = self.choose(posed)
        return drawn(posed, choice, noise_level(posed.path, choice, posed.noise), draws, seed)

    # -- steps ----------------------------------------------------------------------------------------------------
    def pose(self, given: Readings, told: Any = None) -> Steady:
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

    def choose(self, posed: Steady) -> Choice:
        """Lambda of a problem: of the calibration, of the user, or by the rules."""
        choice = self.choice
        if self.calibration is not None:
            choice = self.calibration.lam
        elif isinstance(choice, Absolute):
            choice = choice.relative(posed.path)
        return choose(posed.path, choice, sigma=posed.noise.sigma, source=posed.noise.source)

    @property
    def free(self) -> bool:
        """Without regularisation."""
        return self.penalty is None or (isinstance(self.choice, int | float) and self.choice == 0)

    def answer(self, given: Readings, posed: Steady, choice: Choice) -> LoadEstimate:
        """Estimate of a problem at the lambda of a choice."""
        path = posed.path
        # a residual above the stated noise is model error: the band must not be narrower than what is seen
        sigma = noise_level(path, choice, posed.noise)
        solution = path.solution(choice.lam, sigma)
        load = solution.load
        assert solution.posterior is not None
        std = np.broadcast_to(solution.posterior.std, load.shape)
        single = given.axis is None
        bias = None if posed.constrained else diagnose.hidden(posed.base, choice.lam, load, std, axis=-1)
        response = given.values[0] if single else given.values
        diagnosis = diagnose.diagnose(
            posed.base, choice.lam, sigma, load=np.atleast_2d(load)[-1], geometry=self.geometry
        )
        facts = telling.facts(posed, choice, sigma, solution, diagnosis)
        self._progress(1.0, "done")
        estimate = LoadEstimate(
            load=load,
            std=std if bias is None else np.maximum(std, np.abs(bias)),
            bias=bias,
            labels=[c.label for c in self.model.loads],
            units=[c.unit for c in self.model.loads],
            axis=given.axis,
            choice=choice,
            response=response,
            residual=response - load @ posed.H.T,
            sensors=[c.label for c in given.channels],
            sensor_units=[c.unit for c in given.channels],
            flags=telling.flags(self, given, posed, choice, facts, diagnosis),
            allowed=self.allow,
            certificate=self.model.certificate,
            posterior=solution.posterior,
            geometry=self.geometry,
            diagnosis=diagnosis,
            facts=facts,
            provenance=provenance(
                self.name,
                settings=telling.settings(self, posed),
                inputs={given.name: given.sha256},
                model=self.model.fingerprint,
                prior=smoothness.words(self.penalty, self.basis),
            ),
        )
        return graded(estimate, unexplained_by(path, choice.lam, posed.noise))

    def at_rest(self) -> Steady:
        """The problem without readings: what a frozen inverse is made of.

        Raises
        ------
        InputError
            If sensors of several units, or sensors and measured resultants, have no noise levels: nothing says how
            they weigh.
        """
        rows = rows_of(self.sensors, self.model)
        channels = tuple(self.model.sensors[i] for i in rows)
        told = None if self.calibration is None else self.calibration.level
        stated = self.noise.stated or told is not None or self.model.noise is not None
        # readings of zero are in the range of any noise; without a noise level they would have no scale
        values = np.zeros((1, len(rows))) if stated else np.ones((1, len(rows)))
        posed = self.pose(Readings(values, rows, channels, None, "none", ""), told)
        if not posed.noise.known and posed.soft:
            raise InputError(
                "measured resultants weigh against the noise of the sensors, which is not known",
                where="freeze",
                found="no noise level",
                expected="noise= per sensor",
                hint="state the noise in the model (noise= of each sensor) or here",
            )
        if not posed.noise.known and len({c.unit for c in channels}) > 1:
            raise InputError(
                "sensors of several units have no noise levels: nothing says how they weigh",
                where="freeze",
                found=sorted({c.unit for c in channels}),
                expected="noise= per sensor",
                hint="state the noise in the model (noise= of each sensor) or here",
            )
        return posed


def _relative(choice: Any) -> float:
    """A lambda that a user gave, as a number."""
    lam = real(choice)
    if lam is None or not (lam == 0 or SMALLEST <= lam <= LARGEST):
        raise InputError(
            "no relative lambda", where="choice", found=repr(choice)[:80],
            expected=f"0, a number from {SMALLEST:g} to {LARGEST:g}, or the name of a rule",
        )  # fmt: skip
    return lam
