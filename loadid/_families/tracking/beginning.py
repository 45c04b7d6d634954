"""How a record begins: at rest, as a filter says by default, or in motion, as its first samples say.

Filters with three starts in motion are weighed against the one at rest by the likelihood of the first samples, so few
that no load makes of rest in them what a motion is from the first one on. The ratio of two likelihoods exceeds c at
rest in less than one of c records (Markov's inequality, as in the sequential test of A. Wald, Ann. Math. Stat. 16
(1945) 117-186): a record at rest keeps its numbers to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from structures._flags import Flag

from ..._guards.tracking import started_in_motion
from ..._inverse.gaussian.model import FilterModel, FilterState
from ..._inverse.gaussian.records import filter_record, log_density
from ..._inverse.gaussian.roots import Array, lower
from ..._inverse.gaussian.steady import SteadyFilter

HEAD = 5  # samples that are looked at
WIDER = (1.0, 10.0, 100.0)  # times the motion that the loads of the prior make: what moved the structure may have gone
DECISIVE = 7.0  # logarithm of a ratio of likelihoods: a thousand
PAST = 12  # doublings of a sample: the loads have acted for so long before the record


@dataclass(frozen=True)
class MovingStart:
    """A start in motion.

    Parameters
    ----------
    wider : float
        Std of the states of the structure over what the loads make them in the long run.
    gain : float
        Logarithm of the likelihood of the first samples over that at rest.
    """

    wider: float
    gain: float

    @property
    def flag(self) -> Flag:
        """N532."""
        return started_in_motion(self.gain, DECISIVE)

    def of(self, model: FilterModel) -> FilterModel:
        """A filter that starts in it."""
        return replace(model, L0=moving(model, self.wider))

    def state(self, model: FilterModel) -> FilterState:
        """Its first state."""
        return FilterState(model.x0, moving(model, self.wider))


def beginning(model: FilterModel, settled: SteadyFilter | None, Y: Array) -> MovingStart | None:
    """The start in motion that the first samples of a record (samples, m) tell of.

    Returns
    -------
    MovingStart or None
        None where they may start at rest, or the filter has been told how it starts.
    """
    head = Y[:HEAD]
    if model.L0[: model.nx].any() or not np.isfinite(head).any():
        return None
    rest = _weight(model, settled, head)
    found = [MovingStart(wider, _weight(MovingStart(wider, 0.0).of(model), settled, head) - rest) for wider in WIDER]
    best = max(found, key=lambda start: start.gain)
    return best if best.gain > DECISIVE else None


def moving(model: FilterModel, wider: float) -> Array:
    """Root (n, n) of the first states after the loads have acted for long, the motion they made `wider` times so.

    What a load that never returns makes of the structure stays in equilibrium with it: the rest alone is made wider.
    """
    F, made = model.F, model.LQ
    for _ in range(PAST):  # twice as many samples each time
        F, made = F @ F, lower(F @ made, made)
    more = np.zeros_like(made)
    more[: model.nx] = np.sqrt(wider**2 - 1) * made[: model.nx]
    return lower(F @ model.L0, made, more)


def _weight(model: FilterModel, settled: SteadyFilter | None, Y: Array) -> float:
    """Log-likelihood of samples."""
    each = filter_record(model, Y).loglik if settled is None else log_density(model, Y, settled)
    return float(np.sum(each))
