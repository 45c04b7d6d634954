"""L-curve of the noise of a load: the classical way to tune a filter, with the choice of the likelihood beside it.

The std of every prior is multiplied by a factor, over many decades. A small one leaves innovations that a load would
explain, a large one gives loads that follow the noise of the sensors: in logarithms an L. Its corner is what is taken
where nobody trusts a likelihood; too small is the dangerous side, as the band is then narrow and wrong.

Source: E. Lourens et al., Mech. Syst. Signal Process. 27 (2012) 446-460, section 4 (L-curve for the covariance of a
load).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from structures._model import Model
from structures.errors import InputError, NotIdentifiable, positive

from ..._inverse.gaussian.records import run_settled
from ..._inverse.gaussian.roots import Array, solve_lower, solve_lower_transposed
from ..._inverse.gaussian.steady import SteadyFilter, steady
from ..._inverse.rules import curvature
from ..data import gather
from .tuning import complete, density, settled_samples

FEWEST = 9  # points of a curve
MOVING = 0.1  # of the largest speed along the curve, below which it stands still and its bends are rounding
ALIKE = 0.05  # of the residual, within which more variance changes nothing
EDGE = 2  # points at either end that are no corner: differences there are one-sided


@dataclass(frozen=True, eq=False)
class QSweep:
    """Filters of many variances of the loads on one record.

    Parameters
    ----------
    factors : array, shape (points,)
        On the std of every load, 1 at the choice of the likelihood; ascending.
    innovation : array, shape (points,)
        Rms of the innovations over the noise of their sensors.
    residual : array, shape (points,)
        Rms of what the filtered loads leave of the data, over the noise: the other arm of the L. (Innovations end at
        what a load may change in a sample, however large its variance.)
    roughness : array, shape (points,)
        Rms of the steps of the filtered loads, each over that of the likelihood's choice.
    nis : array, shape (points,)
        Mean normalised square of the innovations per channel.
    loglik : array, shape (points,)
    corner : int or None
        Point of the largest curvature of the L-curve; None where it has one arm only, as the sensors do not let the
        loads follow noise.
    plateau : int
        First point from which on the residual is within 5 % of its smallest.
    likely : int
        Point of the largest likelihood.
    priors : tuple
        Of the loads, at a factor of one.
    """

    factors: Array
    innovation: Array
    residual: Array
    roughness: Array
    nis: Array
    loglik: Array
    corner: int | None
    plateau: int
    likely: int
    priors: tuple[Any, ...]

    def at(self, point: int) -> tuple[Any, ...]:
        """Priors of a point, as `LoadTracker` takes them."""
        return tuple(prior.scaled(float(self.factors[point])) for prior in self.priors)

    def __str__(self) -> str:
        likely = "; ".join(p.words for p in self.at(self.likely))
        lines = [f"the likelihood takes {likely} (NIS per channel {self.nis[self.likely]:.3g})"]
        if self.corner is None:
            low = "; ".join(p.words for p in self.at(self.plateau))
            return (
                f"{lines[0]}\nthe L-curve has one arm only, as these sensors do not let the load follow noise: "
                f"anything from {low} on leaves as little of the data"
            )
        away = self.factors[self.corner] / self.factors[self.likely]
        cornered = "; ".join(p.words for p in self.at(self.corner))
        lines.append(
            f"the corner of the L-curve takes {cornered} (NIS {self.nis[self.corner]:.3g}): {away:.3g} times the std"
        )
        if away < 1:
            lines.append("a std that is too small makes a band that is too narrow: prefer the likelihood")
        return "\n".join(lines)


def q_sweep(
    model: Model,
    record: Any,
    dt: float | None = None,
    *,
    prior: Any = "random_walk",
    decades: float = 4.0,
    points: int = 33,
    progress: Callable[[float, str], None] | None = None,
    **settings: Any,
) -> QSweep:
    """Sweep the variance of all loads around the choice of the likelihood.

    Parameters
    ----------
    model, record, dt, prior
        As for `LoadTracker`.
    decades : float
        Of the variance, to either side.
    points : int
        At least nine.
    progress : callable, optional
    settings
        Further ones of `LoadTracker`: ``noise``, ``hold``, ``sensors`` ...

    Raises
    ------
    InputError
        A record that does not fit the model, settings of which a filter cannot be made again (ambient loads).
    NotIdentifiable
        As `LoadTracker.fit`.
    """
    from ..kalman import LoadTracker

    span = positive("the decades of a sweep", decades, where="q_sweep")
    if isinstance(points, bool) or not isinstance(points, int | np.integer) or points < FEWEST:
        raise InputError("too few points for a curve", where="q_sweep", found=repr(points)[:80],
                         expected=f"an integer of at least {FEWEST}")  # fmt: skip
    told = progress or (lambda fraction, text: None)
    family = LoadTracker(model, prior=prior, gate=None, progress=lambda f, t: told(0.5 * f, t), **settings)
    fitted = family.fit(record, dt).fitted
    if fitted.recipe is None or family.scales:
        raise InputError("the filter cannot be made again with another variance", where="q_sweep",
                         found="ambient loads, tuned scales of the model, or a prior of one's own",
                         expected="a model and priors that stay")  # fmt: skip
    data = gather(record, dt, model, family.sensors, allow_missing=True)
    Y = complete(data)
    factors = np.geomspace(10 ** (-span / 2), 10 ** (span / 2), points | 1)  # one among them
    recipe, judged, good = fitted.recipe, [], []
    for k, factor in enumerate(factors):
        told(0.5 + 0.5 * k / len(factors), "sweeping the variance of the loads")
        scaled = replace(recipe, priors=tuple(p.scaled(float(factor)) for p in recipe.priors))
        try:
            judged.append(_judged(steady(scaled.build(model, fitted.dt), fitted.dt), Y))
        except NotIdentifiable:  # so small a variance does not settle
            continue
        good.append(k)
    innovation, residual, steps, nis, loglik = (np.array(part) for part in zip(*judged, strict=True))
    likely = int(np.argmax(loglik))
    roughness = np.sqrt(np.mean((steps / np.maximum(steps[likely], 1e-300)) ** 2, axis=1))
    return QSweep(
        factors=factors[good],
        innovation=innovation,
        residual=residual,
        roughness=roughness,
        nis=nis,
        loglik=loglik,
        corner=_corner(factors[good], residual, roughness),
        plateau=int(np.argmax(residual <= (1 + ALIKE) * residual.min())),
        likely=likely,
        priors=tuple(p.scaled(float(np.sqrt(recipe.scale))) for p in recipe.priors),
    )


def _judged(filtered: SteadyFilter, Y: Array) -> tuple[float, float, Array, float, float]:
    """Innovations and residuals over noise, steps of each load, NIS per channel, log-likelihood."""
    model, use = filtered.model, settled_samples(len(Y))
    load, e = run_settled(filtered, Y)
    e, noise = e[use], np.linalg.norm(model.LR, axis=1)
    white = solve_lower(filtered.Se_root, e.T)
    left = model.LR @ (model.LR.T @ solve_lower_transposed(filtered.Se_root, white))  # R Se^-1 e
    steps = np.sqrt(np.mean(np.diff(load[use], axis=0) ** 2, axis=0))
    news, rest = (float(np.sqrt(np.mean(part**2))) for part in (e / noise, left.T / noise))
    return news, rest, steps, float(np.mean(white**2)), density(filtered.Se_root, e, False)[0]


def _corner(factors: Array, residual: Array, roughness: Array) -> int | None:
    """The largest positive curvature away from the ends; None where the curve comes to stand at its upper end."""
    t = np.log(factors)
    speed = np.hypot(np.gradient(np.log(residual), t), np.gradient(np.log(roughness), t))
    bend = curvature(1 / factors[::-1], residual[::-1] ** 2, roughness[::-1] ** 2)[::-1]
    inner = bend[EDGE:-EDGE]
    if speed[-EDGE:].max() < MOVING * speed.max() or not inner.max(initial=0.0) > 0:
        return None
    return int(np.argmax(inner)) + EDGE
