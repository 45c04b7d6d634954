"""Sparse deconvolution: impacts as a few waveforms of a dictionary, by an l1 or a group penalty."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._flags import Flag
from structures._model import Model, as_model
from structures._threads import one_thread
from structures.errors import InputError, as_array, real

from .._guards import families as told
from .._guards.choice import declared_class
from .._inverse.choice import Choice, PathCurve, is_rule, named
from .._inverse.convolution import Convolution
from .._inverse.problem import NoiseSource
from .._inverse.rules import name_of
from .._inverse.sparse import TOLERANCE
from .._inverse.sparse.path import SupportPosterior
from .._inverse.sweep import RuleResult
from .._results.estimate import LoadEstimate
from .._results.facts import Facts
from .._spellings import Progress, takes
from ..settings import ChoiceLike, Guards, Lambda, Noise, Penalty, Sparsity
from . import detection, histories
from .answer import SolvedLoad, answer, beyond_noise, over_time
from .data import Data, gather
from .offsets import without_offsets
from .posing import PosingSettings
from .posing.sparsity import SparseChoice, Wanted, amplitude_share, choose, pose

DICTIONARIES = ("dirac", "bspline", "wavelet")
RULES = ("discrepancy", "ebic")
AGREED = (0.1, 0.3)  # relative distance of the loads of two rules up to which mu is determined, usable
LEFT = NoiseSource("residual", "what the fit of the best criterion leaves")
BAND = (
    "the noise on the chosen support; not in it: the choice of the support, and what the dictionary cannot represent. "
    "Where no waveform was chosen it is zero"
)


class SparseDeconvolution:
    """Load histories that are a few waveforms of a dictionary.

    Minimises ``1/2 |R^(-1/2) (h * D x - y)|^2 + mu |x|_1`` over whole records of any length, to a duality gap that is
    part of the answer, and then fits the amplitudes on the support by least squares, which the penalty had shrunk
    (Jacquelin, Bennani & Hamelin, J. Sound Vib. 265 (2003) 81, for the problem; Qiao et al., J. Sound Vib. 2016, for
    sparse dictionaries). Spikes fit hits of one or two samples; for longer pulses they are wrong (flag W311), B-splines
    are right. A load that acts all the time asks for `Deconvolution`; `recommend` tells which prior fits.

    Parameters
    ----------
    model : Model
        Anything that gives ``impulse_response``.
    dictionary : {"dirac", "bspline", "wavelet"} or array
        Waveforms: spikes of one sample, cubic B-splines, Daubechies wavelets, or a matrix (samples, atoms) whose
        columns every load may have.
    knots : int, sequence of int, "scan" or None
        Spacing of the B-splines in samples; several, or "scan" (2, 4, 8, 16; the same as None), are compared by the
        extended information criterion. The best is a third to a fifth of the width of a pulse.
    sparsity : Sparsity
        Groups of loads, signs, rounds of reweighting, the duality gap: `loadid.Sparsity`.
    choice : str, callable, float, None or Lambda
        Rule for mu (``"discrepancy"``, ``"ebic"``, or any that the size of the support serves as degrees of freedom,
        such as ``"gcv"``), or mu over the smallest at which everything is zero. None: discrepancy, with the stated
        noise level, or with that which the least squares of the best extended information criterion leaves.
    support : (float, float) or sequence of such, optional
        Windows in s, from the first sample of the record, outside which the loads are zero: waveforms that reach
        beyond them are left out.
    hold : {"foh", "zoh"}, optional
        How a load moves between samples; default the model's own.
    noise : float, array or Noise, optional
        Noise std of the sensors, (sensors,) or a covariance (sensors, sensors); with where it comes from:
        `loadid.Noise`.
    sensors : sequence of str or int, optional
        Sensors of the model to use; default all.
    allow : sequence of str, or Guards
        Guard codes whose refusal is overridden. What else guards ask: `loadid.Guards`.
    progress : callable, optional
        Called as ``progress(fraction, text)``.
    """

    name = "sparse deconvolution"

    @takes(
        sparsity=(Sparsity, "groups nonnegative reweighted debias tol"),
        choice=(Lambda, ""),
        noise=(Noise, "source"),
        allow=(Guards, "coverage load_class"),
    )
    def __init__(
        self,
        model: Model,
        *,
        dictionary: str | ArrayLike = "dirac",
        knots: int | str | Sequence[int] | None = None,
        sparsity: Sparsity = Sparsity(),  # noqa: B008 -- immutable
        choice: ChoiceLike = None,
        support: ArrayLike | None = None,
        hold: str | None = None,
        noise: ArrayLike | Noise | None = None,
        sensors: Sequence[str | int] | None = None,
        allow: Sequence[str] | Guards = (),
        progress: Callable[[float, str], None] | None = None,
    ) -> None:
        if not isinstance(dictionary, str):
            dictionary = as_array(dictionary, where="dictionary", dtype=float)
        told_of = Guards.of(allow)
        self.wanted = Wanted(dictionary, knots, Sparsity.of(sparsity), Lambda.of(choice).choice)
        _check(self.wanted)
        self.posing = PosingSettings(Noise.of(noise), Lambda(), Penalty(), told_of.codes, hold, support=support)
        self.model = as_model(model, "SparseDeconvolution", "impulse_response")
        self.sensors, self.coverage, self.load_class = sensors, told_of.coverage, told_of.load_class
        self._progress = Progress(progress)

    @one_thread()
    def estimate(self, record: Any, dt: float | None = None) -> LoadEstimate:
        """Rebuild the loads that caused a record.

        Parameters
        ----------
        record : Record, or array of shape (samples, sensors)
            NaN marks a missing sample.
        dt : float, optional
            Step in s of a bare array.

        Returns
        -------
        LoadEstimate
            Loads (samples, loads); `facts` hold the duality gap, the size of the support, mu and the knots.

        Raises
        ------
        InputError
            A record that does not fit the model, or an impulse response without a usable diagonal (LID-E506).
        NotIdentifiable
            Where nothing but noise is in the record, or the problem cannot be solved to a gap of 1e-5.
        """
        data = gather(record, dt, self.model, self.sensors, allow_missing=True)
        data = without_offsets(data, self.model, at_rest=True, allow=self.posing.allow)
        problem = pose(self.model, data, self.posing)
        chosen = choose(problem, self.wanted, self._progress)
        load, posterior = self._load(chosen, problem.samples)
        predicted = Convolution(problem.raw, problem.samples).apply(load)
        response = np.where(problem.missing, predicted, problem.values)
        share = amplitude_share(chosen)
        facts, choice = self._facts(chosen, share), self._choice(chosen)
        self._progress(1.0, "done")
        found = SolvedLoad(
            load=load, std=posterior.std, posterior=posterior, axis=over_time(len(load), data.dt), response=response,
            residual=response - predicted, facts=facts,
            excess=beyond_noise(chosen.fit.residual2, problem.data, problem.noise),
            not_told=detection.of_support(chosen, self.model.loads),
        )  # fmt: skip
        return answer(
            self, data, found, choice, known=problem.noise.known, settings=self._settings(chosen),
            prior=self._prior(chosen), flags=self._flags(chosen, data, facts, share),
        )  # fmt: skip

    @property
    def allow(self) -> tuple[str, ...]:
        """Guard codes whose refusal is overridden."""
        return self.posing.allow

    # -- numbers ----------------------------------------------------------------------------------------------------
    def _load(self, chosen: SparseChoice, samples: int) -> tuple[NDArray[np.float64], SupportPosterior]:
        """Loads (samples, loads of the model), zero for those that groups left out, and their covariance."""
        found, atoms = chosen.fit, chosen.atoms
        x = found.full(atoms.n) if self.wanted.penalty.debias else chosen.solution.x
        count = len(self.model.loads)
        load = np.zeros((samples, count))
        load[:, chosen.loads] = atoms.history(x)
        return load, SupportPosterior.of(
            atoms.histories(found.support), chosen.loads, count, chosen.sigma * found.spread, load.shape
        )

    def _facts(self, chosen: SparseChoice, share: tuple[float, int] | None) -> Facts:
        problem, found = chosen.problem, chosen.fit
        freedom = max(problem.data - len(found.x), 1)
        others = len(self.model.loads) // len(chosen.loads) if self.wanted.penalty.groups == "loads" else 1
        more: dict[str, Any] = {}
        if chosen.knots is not None:
            more["knots"] = chosen.knots
        if self.wanted.penalty.groups == "loads":
            more["acting_loads"] = tuple(self.model.loads[j].label for j in chosen.loads)
        if share is not None:
            more["amplitude_std_with_neighbours"] = share[0]
        if len(chosen.scores) > 1:
            more["criterion_by_knots"] = ", ".join(f"{k}: {v:.1f}" for k, v in sorted(chosen.scores.items()))
        slots = self.wanted.penalty.groups == "slots"
        return Facts(
            path="groups, active set" if slots else "l1, active set on shifted responses",
            m=problem.data, n=chosen.atoms.n * others, edf=float(len(found.x)), noise_level=float(chosen.sigma),
            residual_to_noise=float(np.sqrt(found.residual2 / freedom)) if problem.noise.known else None,
            **(problem.noise.source if problem.noise.known else LEFT).facts, gap=float(chosen.solution.gap),
            support=len(found.x), mu=float(chosen.solution.mu), support_kappa=found.kappa, band=BAND, **more,
        )  # fmt: skip

    def _choice(self, chosen: SparseChoice) -> Choice:
        rules = tuple(
            RuleResult(name, chosen.ratios.get(name), edge=chosen.edge and name == chosen.rule,
                       note="" if name in chosen.ratios else "not asked")
            for name in dict.fromkeys((*RULES, *chosen.ratios))
        )  # fmt: skip
        verdict, spread, odds = self._verdict(chosen)
        s = chosen.sweep
        sweep = None if s is None or len(s.lam) < 2 else replace(PathCurve.of(s), gcv=None)
        return Choice(
            lam=chosen.ratio, scale=chosen.scale, rule=chosen.rule, rules=rules, spread=spread, verdict=verdict,
            odds=odds, sigma=chosen.problem.noise.sigma, source=chosen.problem.noise.source,
            edf=float(len(chosen.fit.x)), sweep=sweep, shown=chosen.shown,
        )  # fmt: skip

    def _verdict(self, chosen: SparseChoice) -> tuple[str, float, str]:
        """How far the loads of the two rules agree: once amplitudes are fitted, mu matters by the support alone."""
        other = chosen.ratios.get("ebic" if chosen.rule != "ebic" else "discrepancy")
        if other is None or other == chosen.ratio:
            return "usable", 0.0, "mu of one rule alone"
        along = chosen.problem.path(chosen.atoms, self.wanted.penalty.nonnegative)
        second = along.fitted(along.solve(other).x, self.wanted.small, chosen.sigma)
        first = chosen.atoms.history(chosen.fit.full(chosen.atoms.n))
        distance = np.linalg.norm(chosen.atoms.history(second.full(chosen.atoms.n)) - first) / np.linalg.norm(first)
        grade = int(np.searchsorted(AGREED, distance))
        spread = float(abs(np.log10(other / chosen.ratio)))
        text = f"the loads at the mu of both rules, amplitudes fitted, are {distance:.1%} apart"
        return ("determined", "usable", "rules disagree")[grade], spread, text

    # -- words ------------------------------------------------------------------------------------------------------
    def _prior(self, chosen: SparseChoice) -> str:
        what = {
            "dirac": "few spikes of one sample",
            "bspline": f"few cubic B-splines with knots every {chosen.knots} samples",
            "wavelet": "few Daubechies wavelets",
            "user": "few columns of a matrix of the user",
        }[self.wanted.named]
        sign = ", none negative" if self.wanted.penalty.nonnegative else ""
        group = {None: "", "loads": "; few of the loads act", "slots": "; the loads act at the same times"}
        return f"{what}{sign}{group[self.wanted.penalty.groups]} (Laplace, l1)"

    def _flags(
        self, chosen: SparseChoice, data: Data, facts: Facts, share: tuple[float, int] | None
    ) -> list[Flag | None]:
        model, (gain, knots), residual = self.model, chosen.gain, facts.residual_to_noise
        wrong = told.wide_pulses(gain, knots, len(chosen.fit.x)) if self.wanted.named == "dirac" else None
        label = "" if share is None else model.loads[chosen.loads[share[1]]].label
        return [
            *histories.layout(model, data, chosen.problem.raw, None),
            declared_class(self.load_class, "sparse"),
            told.dense_support(len(chosen.fit.x), chosen.atoms.n),
            wrong,
            None if residual is None or wrong is not None else told.unexplained(residual, self._prior(chosen)),
            None if share is None else told.unsure_amplitudes(share[0], label),
            told.stopped_gap(chosen.solution.gap, max(self.wanted.penalty.tol, TOLERANCE)),
        ]

    def _settings(self, chosen: SparseChoice) -> dict[str, Any]:
        w = self.wanted
        return {
            "dictionary": w.named,
            "knots": chosen.knots,
            "scan": not isinstance(w.knots, int) and w.named == "bspline",
            "nonnegative": w.penalty.nonnegative,
            "groups": w.penalty.groups,
            "reweighted": w.penalty.reweighted,
            "debias": w.penalty.debias,
            "choice": named(w.choice),
            "hold": self.posing.hold,
            "noise_source": chosen.problem.noise.source.text,
            "sensors": None if self.sensors is None else [str(s) for s in self.sensors],
            **({} if self.posing.support is None else {"support": [list(one) for one in self.posing.support]}),
        }


def _check(w: Wanted) -> None:
    """Refuse settings that mean nothing.

    Raises
    ------
    InputError
        Unknown names, a mu that is no ratio, signs of what has no sign.
    """
    if isinstance(w.dictionary, str) and w.dictionary not in DICTIONARIES:
        raise InputError("unknown dictionary", where="dictionary", found=repr(w.dictionary),
                         expected=f"one of {', '.join(DICTIONARIES)}, or a matrix (samples, atoms)")  # fmt: skip
    if w.knots is not None and w.named != "bspline":
        raise InputError("only B-splines have knots", where="knots", found=repr(w.knots),
                         expected="dictionary='bspline'")  # fmt: skip
    spacings = [w.knots] if isinstance(w.knots, int | np.integer) else w.knots
    if spacings is not None and not (isinstance(spacings, str) and spacings == "scan"):
        whole = not isinstance(spacings, str) and len(spacings) and all(
            isinstance(k, int | np.integer) and not isinstance(k, bool) and k >= 1 for k in spacings
        )  # fmt: skip
        if not whole:
            raise InputError("no spacing of knots", where="knots", found=repr(w.knots),
                             expected="a positive integer, some of them, or 'scan'")  # fmt: skip
    signed = w.named == "wavelet" or (not isinstance(w.dictionary, str) and np.any(w.dictionary < 0))
    if w.penalty.nonnegative and signed:
        raise InputError("these waveforms have both signs: coefficients that are not negative say nothing of the load",
                         where="nonnegative", found=w.named, expected="dictionary='dirac' or 'bspline'")  # fmt: skip
    if is_rule(w.choice):
        name_of(w.choice)
    elif w.choice is not None and not 0 < (real(w.choice) or 0) < 1:
        raise InputError("no rule and no relative mu", where="choice", found=repr(w.choice),
                         expected="a rule ('discrepancy', 'ebic', ...), or a number between 0 and 1")  # fmt: skip
