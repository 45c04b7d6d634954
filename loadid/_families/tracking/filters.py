"""Priors by name, and from a model of a structure and the numbers of its priors to the filters that run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._model import Model
from structures.errors import InputError

from ... import priors
from ..._inverse.gaussian.augment import augment
from ..._inverse.gaussian.model import FilterModel
from ..._inverse.gaussian.roots import Array, lower

LONGEST = 0.1  # of the record: a correlation length beyond is not seen in it
SHORTEST = 2.0  # samples
FORGETS = 1e4  # samples in which a stand-in for a walk forgets


@dataclass(frozen=True)
class Named:
    """A prior whose numbers are found by likelihood.

    Parameters
    ----------
    name : str
    parameters : tuple of str
        ``"sd"`` (N) or ``"rate"`` (N per root of a second), ``"length"`` (s).
    make : callable
        Prior of the parameters.
    """

    name: str
    parameters: tuple[str, ...]
    make: Callable[..., Any]

    def starts(self, size: float, dt: float, samples: int) -> list[Array]:
        """Logarithms of the parameters from which the search begins, for a load of about this size (std, if white).

        A slow load moves the sensors less than a white one of its std: what a Matern-3/2 process has at high
        frequencies stays the same where its std grows with its length to the power of 3/2.
        """
        lengths = np.geomspace(SHORTEST * 2 * dt, LONGEST * samples * dt, 4)
        if self.parameters == ("sd", "length"):
            slow = (lengths / lengths[0]) ** 1.5
            return [
                np.log([size * s, length])
                for length, most in zip(lengths, slow, strict=True)
                for s in np.geomspace(0.3, 3.0 * most, 3)
            ]
        if self.parameters == ("rate",):
            return [np.log([size * s / np.sqrt(length)]) for length in lengths for s in (0.3, 3.0)]
        return [np.log([size * s]) for s in (0.1, 0.3, 1.0, 3.0)]


NAMES: dict[str, Named] = {
    found.name: found
    for found in (
        Named("random_walk", ("rate",), priors.RandomWalk),
        Named("white", ("sd",), priors.White),
        Named("ou", ("sd", "length"), priors.OU),
        Named("matern32", ("sd", "length"), priors.Matern32),
        Named("matern52", ("sd", "length"), priors.Matern52),
    )
}


def named(given: Any) -> Named | Any:
    """A prior by its name, or the prior itself.

    Raises
    ------
    InputError
        An unknown name, or no prior.
    """
    if isinstance(given, str):
        if given not in NAMES:
            raise InputError("unknown prior of a load", where="prior", found=repr(given), expected=", ".join(NAMES),
                             hint="or a prior of loadid.priors")  # fmt: skip
        return NAMES[given]
    if not isinstance(given, priors.Prior):
        raise InputError("no prior of a load", where="prior", found=type(given).__name__,
                         expected=f"{', '.join(NAMES)}, or a prior such as Matern32(100, 0.1)")  # fmt: skip
    return given


def leaky(given: Any, dt: float) -> Any:
    """A walk that forgets in `FORGETS` samples, for the walk; other priors as they are."""
    length = FORGETS * dt

    def process(rate: float) -> priors.OU:
        return priors.OU(rate * float(np.sqrt(length / 2)), length)

    if isinstance(given, Named) and given.name == "random_walk":
        return Named(given.name, given.parameters, process)
    return process(given.rate) if isinstance(given, priors.RandomWalk) else given


SPREAD = float(np.sqrt(3.0))  # of the nodes of the rule of Gauss and Hermite with three points
WEIGHT = 1 / 6  # of each outer node


@dataclass(frozen=True, eq=False)
class Posing:
    """What stays the same while numbers are tried.

    Parameters
    ----------
    model : Model
    dt : float
    rows : array of int
        Sensors of the model that are used.
    noise : array (sensors,)
        Std of the used sensors, or a scale of each.
    given : tuple
        One prior, or `Named`, for each load.
    hold : str or None
    scales : tuple of str
        Parameters of the model that are tuned (`Model.perturbed`).
    state_noise : float
    around : mapping
        What else `augment` takes: ``ambient``, ``bias``, ``start``.
    free_noise : bool
        `noise` is a scale of each, and one factor on all of them is tuned beside priors that are given: these stay as
        they are. (Where all priors are tuned, a common factor on them and the noise has its optimum in closed form.)
    """

    model: Model
    dt: float
    rows: NDArray[np.int_]
    noise: Array
    given: tuple[Any, ...]
    hold: str | None = None
    scales: tuple[str, ...] = ()
    state_noise: float = 0.0
    around: Mapping[str, Any] = field(default_factory=dict)
    free_noise: bool = False
    models: dict[tuple[float, ...], Model] = field(default_factory=dict, repr=False)

    @property
    def shared(self) -> Named | None:
        """The prior whose numbers all loads share in the search; None where every prior is given."""
        found = [g for g in self.given if isinstance(g, Named)]
        return found[0] if found else None

    @property
    def names(self) -> tuple[str, ...]:
        """What the search moves."""
        own = [(j, g) for j, g in enumerate(self.given) if isinstance(g, Named)]
        noise = ("noise scale",) if self.free_noise else ()
        return (*(f"{name} of load {j + 1}" for j, g in own for name in g.parameters), *self.scales, *noise)

    def build(self, x: Array, scale: float = 1.0) -> FilterModel:
        """Filter of logarithms of the numbers; `scale` multiplies process and measurement noise."""
        return self.filter(self.scaled(x), self.priors(x), scale, self.factor(x))

    def priors(self, x: Array, scale: float = 1.0) -> tuple[Any, ...]:
        """The priors of these numbers."""
        found, at = [], 0
        for prior in self.given:
            if isinstance(prior, Named):
                values = np.exp(np.clip(x[at : at + len(prior.parameters)], -80, 80))
                found.append(prior.make(*values).scaled(np.sqrt(scale)))
                at += len(prior.parameters)
            else:
                found.append(prior)
        return tuple(found)

    def filter(self, model: Model, priors: Sequence[Any], scale: float = 1.0, factor: float = 1.0) -> FilterModel:
        """Filter of a model under priors, the used sensors only; `factor` on the noise std of the sensors."""
        noise = np.ones(len(model.sensors))
        noise[self.rows] = factor * self.noise
        made = augment(
            model, self.dt, list(priors), noise=noise, hold=self.hold, state_noise=self.state_noise, **self.around
        )
        return rescaled(restricted(made, self.rows), scale)

    def factor(self, x: Array) -> float:
        """On the noise of the sensors."""
        return float(np.exp(np.clip(x[-1], -80, 80))) if self.free_noise and len(x) else 1.0

    def scaled(self, x: Array) -> Model:
        """The model with its tuned parameters."""
        if not self.scales:
            return self.model
        stop = len(x) - self.free_noise
        factors = np.exp(x[stop - len(self.scales) : stop]).tolist()
        key = tuple(round(f, 12) for f in factors)
        if key not in self.models:
            if len(self.models) > 64:
                self.models.clear()
            self.models[key] = perturbed(self.model, dict(zip(self.scales, factors, strict=True)))
        return self.models[key]

    def bank(self, x: Array, errors: Mapping[str, float], scale: float = 1.0) -> list[tuple[float, FilterModel]]:
        """Filters of models that are wrong by what is declared, with their weights in the variance between models.

        Gauss-Hermite with three points for each parameter: one at the nominal value, two at 1 +- sqrt(3) std.
        """
        base, priors, noise = self.scaled(x), self.priors(x), self.factor(x)
        found = []
        for (name, std), sign in product(errors.items(), (-1, 1)):
            factor = 1 + sign * SPREAD * std
            if factor <= 0:
                raise InputError("the declared error of the model is too large", where=f"model_error[{name!r}]",
                                 found=std, expected=f"below {1 / SPREAD:.2f}")  # fmt: skip
            found.append((WEIGHT, self.filter(perturbed(base, {name: factor}), priors, scale, noise)))
        return found


def perturbed(model: Model, factors: Mapping[str, float]) -> Model:
    """A model with some of its parameters multiplied."""
    for name, factor in factors.items():
        model = model.perturbed(name, factor)
    return model


def restricted(model: FilterModel, rows: NDArray[np.int_]) -> FilterModel:
    """The filter of some of its sensors."""
    if len(rows) == model.m and np.array_equal(rows, np.arange(model.m)):
        return model
    S = None if model.S is None else model.S[:, rows]
    return replace(model, H=model.H[rows], LR=lower(model.LR[rows]), S=S)


def rescaled(model: FilterModel, scale: float) -> FilterModel:
    """The same gains with all noises multiplied by a variance."""
    if scale == 1.0:
        return model
    root = np.sqrt(scale)
    S = None if model.S is None else scale * model.S
    return replace(model, LQ=root * model.LQ, LR=root * model.LR, L0=root * model.L0, S=S)
