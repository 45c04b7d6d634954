"""Which prior fits a record: Tikhonov for loads that act all the time, spikes or pulses for impacts, or none."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.model import Model

from ..flags import sparsity as told
from ..inverse.sparse import dictionaries
from .data import gather
from .deconvolution import Deconvolution
from .shapes import half_width, kurtosis
from .sparse import SparseDeconvolution
from .sparsity import Problem, pose, posing

HALF_SINE = 1.5  # width of a half-sine pulse over its width at half height
PER_PULSE = 4  # knots per pulse width: the best spacing is a third to a fifth of it


@dataclass(frozen=True)
class Recommendation:
    """Which prior fits a record, and why.

    Parameters
    ----------
    prior : {"tikhonov", "spikes", "pulses"}
    family : str
        The call that uses it.
    reason : str
        With the numbers that decided.
    trusted : bool
        False where neither prior tells the heights: places are good, amplitudes are not.
    kurtosis : float
        Of the Tikhonov load, about zero; the largest of all loads.
    width : float
        Width of the largest pulse of the Tikhonov load, in samples: what the pulse has at most.
    knots : int or None
        Spacing of B-splines, by the information criterion; None where none was asked.
    scores : dict of int to float
        Information criterion of spikes (1) and of B-splines by spacing.
    """

    prior: str
    family: str
    reason: str
    trusted: bool
    kurtosis: float
    width: float
    knots: int | None
    scores: dict[int, float]

    def __str__(self) -> str:
        return f"{self.family}: {self.reason}"


def recommend(
    model: Model,
    record: Any,
    dt: float | None = None,
    *,
    hold: str | None = None,
    noise: ArrayLike | None = None,
    noise_source: str | None = None,
    sensors: Sequence[str | int] | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Recommendation:
    """Compare the priors on a record.

    The Tikhonov load tells by its kurtosis whether it is made of impacts. Then spikes of one sample and B-splines of
    several spacings are compared by the extended information criterion of their least squares, on the first part of a
    long record; a best one that uses much of its dictionary speaks for Tikhonov after all.

    Parameters
    ----------
    model, record, dt, hold, noise, noise_source, sensors, progress
        As for `SparseDeconvolution`.

    Raises
    ------
    InputError
        A record that does not fit the model.
    """
    say = progress or (lambda fraction, text: None)
    settings: dict[str, Any] = {"hold": hold, "noise": noise, "noise_source": noise_source, "sensors": sensors}
    say(0.0, "Tikhonov")
    smooth = Deconvolution(model, **settings).estimate(record, dt)
    peaked = [kurtosis(g) for g in smooth.load.T]
    worst = int(np.argmax(peaked))
    width = pulse_width(smooth.load[:, worst])
    if peaked[worst] < told.IMPULSIVE:
        return Recommendation(
            "tikhonov", "Deconvolution", f"the load acts all the time (kurtosis {peaked[worst]:.3g}, impacts have more "
            f"than {told.IMPULSIVE:g})", True, peaked[worst], width, None, {},
        )  # fmt: skip
    data = gather(record, dt, model, sensors, allow_missing=True)
    scores, shares = _compared(pose(model, data, posing(hold, noise, noise_source, ())), say)
    best = min(scores, key=lambda k: scores[k])
    impulsive = f"the load looks impulsive (kurtosis {peaked[worst]:.3g})"
    knots = min((k for k in scores if k > 1), key=lambda k: scores[k], default=None)
    if shares[best] > told.DENSE:
        return Recommendation(
            "tikhonov", "Deconvolution", f"{impulsive}, but {shares[best]:.0%} of the best dictionary would be in use",
            True, peaked[worst], width, knots, scores,
        )  # fmt: skip
    ahead = min((scores[k] for k in scores if (k == 1) != (best == 1)), default=np.inf) - scores[best]
    if best > 1 and ahead > told.CLEARLY:
        reason = (
            f"{impulsive}, and B-splines with knots every {best} samples explain it best (criterion {ahead:.3g} below "
            f"that of spikes); the pulses are at most {width:.0f} samples wide, which asks for {knots_for(width)}"
        )
        family = f"SparseDeconvolution(dictionary='bspline', knots={best}), or Tikhonov with a load that only pushes"
        return Recommendation("pulses", family, reason, True, peaked[worst], width, best, scores)
    say(0.8, "spikes")
    spikes = SparseDeconvolution(model, **settings).estimate(record, dt)
    share = float(spikes.facts.get("amplitude_std_with_neighbours", 0.0))
    reason = f"{impulsive}, and {spikes.facts['support']} spikes of one sample explain it best"
    trusted = share <= told.UNSURE and ahead > told.CLEARLY
    if not trusted:
        shown = 1 - (smooth.facts.get("peak_bias") or 0.0)
        alike = "" if ahead > told.CLEARLY else f" or as well as pulses (criterion {ahead:.2g} apart)"
        reason += (
            f"{alike}; neither prior is to be trusted with heights: the places are good, the amplitudes are not "
            f"(± {share:.0%} if neighbouring samples act too; Tikhonov shows a single-sample peak at {shown:.0%} of "
            "its height)"
        )
    return Recommendation("spikes", "SparseDeconvolution", reason, trusted, peaked[worst], width, knots, scores)


def _compared(problem: Problem, say: Callable[[float, str], None]) -> tuple[dict[int, float], dict[int, float]]:
    """Information criterion and share in use, of spikes (1) and of B-splines by spacing."""
    first = problem.beginning()
    spacings = [k for k in dictionaries.KNOTS if k == 1 or k <= first.samples // 8]
    scores, shares = {}, {}
    for i, k in enumerate(spacings):
        say(0.3 + 0.5 * i / len(spacings), f"knots every {k} samples" if k > 1 else "spikes")
        atoms = first.atoms("dirac" if k == 1 else "bspline", k)
        sweep = first.path(atoms, False).sweep(first.noise.sigma)
        if len(sweep.ebic):
            scores[k] = float(sweep.ebic[sweep.best])
            shares[k] = float(sweep.count[sweep.best]) / atoms.n
    return scores or {1: 0.0}, shares or {1: 1.0}


def pulse_width(g: NDArray) -> float:
    """Width in samples of the largest pulse of a history, as that of a half-sine of the same width at half height."""
    return HALF_SINE * half_width(g)


def knots_for(width: float) -> int:
    """Spacing of B-splines for pulses of a width in samples: a quarter of it, as a power of two from 2 to 16."""
    return int(2 ** np.clip(np.round(np.log2(max(width / PER_PULSE, 1.0))), 1, 4))
