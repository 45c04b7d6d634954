"""How a filter is made of a model: kept with a fit, so that a running tracker can go on with another model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError
from structures.model import Model, as_model

from ... import flags as guards
from ...flags.tracking import other_model
from ...inverse.kalman import priors
from ...inverse.kalman.augment import augment
from ...inverse.kalman.model import FilterModel
from ...inverse.kalman.steady import steady
from .posed import SPREAD, WEIGHT, rescaled, restricted

if TYPE_CHECKING:
    from .fitted import Fitted

PRIORS = (
    priors.RandomWalk, priors.White, priors.OU, priors.Matern32, priors.Matern52, priors.Periodic, priors.Sum,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Recipe:
    """Priors, noises and the rest of what a filter is made of beside the model.

    Parameters
    ----------
    priors : tuple
    noise : array (sensors of the model,)
        Std; those of sensors that are not used do not matter.
    rows : array of int
        Sensors that are used.
    hold : str or None
    state_noise : float
    bias, start : float, array or str
    scale : float
        Variance that multiplies all noises (`posed.rescaled`).
    errors : mapping of str to float
        Relative std of parameters of the model.
    dummy : float, optional
        Std of displacements at the loads that are believed to stay near zero.
    """

    priors: tuple[Any, ...]
    noise: NDArray[np.float64]
    rows: NDArray[np.int_]
    hold: str | None
    state_noise: float
    bias: Any
    start: Any
    scale: float
    errors: Mapping[str, float]
    dummy: float | None = None

    def build(self, model: Any, dt: float) -> FilterModel:
        """Filter of a model."""
        made = augment(
            model, dt, list(self.priors), noise=self.noise, hold=self.hold, state_noise=self.state_noise,
            bias=self.bias, start=self.start, dummy=self.dummy,
        )  # fmt: skip
        return rescaled(restricted(made, self.rows), self.scale)

    def bank(self, model: Any, dt: float) -> list[tuple[float, FilterModel]]:
        """Filters of models that are wrong by what was declared, with their weights."""
        return [
            (WEIGHT, self.build(model.perturbed(name, 1 + sign * SPREAD * std), dt))
            for (name, std), sign in product(self.errors.items(), (-1, 1))
        ]


def storable(parts: Sequence[Any]) -> bool:
    """Whether priors can stand in a recipe, and in a file."""
    return all(isinstance(p, PRIORS) and (not isinstance(p, priors.Sum) or storable(p.parts)) for p in parts)


def renewed(f: Fitted, model: Any) -> Fitted:
    """A fit with the filters of another model; its certificate is stale.

    Raises
    ------
    InputError
        Another number of states.
    NotIdentifiable
        No settled gain.
    """
    assert f.recipe is not None
    made = f.recipe.build(model, f.dt)
    if (made.n, made.nx) != (f.model.n, f.model.nx):
        raise InputError("a model with other states", where="update_model", found=f"{made.nx} states",
                         expected=f"{f.model.nx}", hint="keep as many modes, or fit a tracker to it")  # fmt: skip
    return replace(
        f,
        model=made,
        settled=None if f.settled is None else steady(made, f.dt),
        bank=tuple((w, m, None if f.settled is None else steady(m, f.dt)) for w, m in f.recipe.bank(model, f.dt)),
        fingerprint=model.fingerprint,
        flags=guards.collect([*f.flags, other_model(f.fingerprint, model.fingerprint)]),
        stale=True,
    )


def same_channels(f: Any, model: Any) -> None:
    """Refuse a model with other sensors or loads than those of a fit, or without a state space.

    Raises
    ------
    InputError
    """
    as_model(model, "update_model", "state_space")
    if max(f.recipe.rows) >= len(model.sensors) or len(f.recipe.noise) != len(model.sensors):
        raise InputError("a model with other sensors", where="update_model", found=f"{len(model.sensors)} sensors",
                         expected=f"{len(f.recipe.noise)}")  # fmt: skip
    for what, own, other in (
        ("sensors", f.sensors, [model.sensors[i] for i in f.recipe.rows]), ("loads", f.loads, list(model.loads)),
    ):  # fmt: skip
        mine, theirs = ([(c.label, c.unit) for c in part] for part in (own, other))
        if mine != theirs:
            raise InputError(f"a model with other {what}", where="update_model",
                             found=", ".join(label for label, _ in theirs), expected=", ".join(
                                 label for label, _ in mine), hint="fit a tracker to it")  # fmt: skip


def carried(before: Model | None, after: Model, nx: int) -> NDArray[np.float64] | None:
    """States (nx, nx) of a model from those of another of the same structure, through its degrees of freedom.

    None where the two do not share any: then nothing is known of the states but their number.
    """
    if before is None or before.structure is None or after.structure is None:
        return None
    one, two = before.reduced, after.reduced
    if one is None or two is None:
        return None
    k = len(one.lam)
    filtered = bool(np.any(one.corner > 0) or np.any(two.corner > 0))
    mass = after.structure.M_free
    if len(two.lam) != k or 2 * k != nx or filtered or mass is None:
        return None
    old, new = before.shapes.phi, after.shapes.phi
    if old.shape != new.shape:
        return None
    shapes = new.T @ (mass @ old)
    unit = [np.where(lam > 0, np.sqrt(lam), 1.0) for lam in (one.lam, two.lam)]
    T = np.zeros((nx, nx))
    T[0::2, 0::2] = unit[1][:, None] * shapes / unit[0]
    T[1::2, 1::2] = shapes
    return T
