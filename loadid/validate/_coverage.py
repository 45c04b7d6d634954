"""Coverage of the stated bands: readings of known loads are simulated with fresh noise and rebuilt."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._model import Model
from structures.errors import InputError, plain

from ._references import numbers

Array = NDArray[np.float64]
HISTORIES, READINGS = 50, 2000  # draws where none are asked for: records in time, static readings
Draw = Callable[[np.random.Generator], ArrayLike]


@dataclass(frozen=True)
class Coverage:
    """Share of the true load values inside the stated band.

    Parameters
    ----------
    share : float
        Over all draws, samples and loads.
    level : float
        Stated level of the band.
    draws : int
    date : str
    """

    share: float
    level: float
    draws: int
    date: str

    def __str__(self) -> str:
        return f"the {self.level:.0%} band held {self.share:.1%} of the true values in {self.draws} simulated records"


def coverage(
    family: Any,
    loads: ArrayLike | Sequence[ArrayLike] | Draw,
    dt: float | None = None,
    *,
    noise: ArrayLike,
    truth: Model | None = None,
    draws: int | None = None,
    level: float = 0.95,
    seed: int = 0,
    progress: Callable[[float, str], None] | None = None,
) -> Coverage:
    """Simulate readings of known loads with fresh noise, rebuild them, and count the values inside the band.

    Parameters
    ----------
    family : Deconvolution, StaticInversion or another family
        Set up as it will be used.
    loads : array, sequence of arrays, or callable
        Loads like the ones to be expected; draws go through them in turn. In time, ``(samples, loads)`` or a sequence
        of such histories; static, ``(loads,)`` or ``(draws, loads)``. A callable takes a random generator and returns
        one of them: a prior to draw from.
    dt : float, optional
        Step in s; None is static.
    noise : float, array (sensors,) or array (sensors, sensors)
        Noise std to add, or its covariance.
    truth : Model, optional
        Model that makes the data; default the family's own, which is optimistic (an inverse crime).
    draws : int, optional
        Number of records; default 50 histories or 2000 static readings.
    level, seed
        Level of the band, seed of the noise.
    progress : callable, optional
        Called as ``progress(fraction, text)``.

    Returns
    -------
    Coverage
        Pass it as ``coverage=`` to the family.

    Raises
    ------
    InputError
        No draw, no load or a level outside (0, 1); loads or noise that do not fit the model.
    """
    if not (hasattr(family, "estimate") and hasattr(family, "model")):
        raise InputError(
            "no family", where="coverage", found=type(family).__name__, expected="StaticInversion, Deconvolution, ...",
            hint="coverage(StaticInversion(model), loads, noise=...)",
        )  # fmt: skip
    draws = (READINGS if dt is None else HISTORIES) if draws is None else draws
    shapes = _static(loads) if dt is None else _histories(loads)
    if draws < 1 or not 0 < level < 1 or not (callable(shapes) or shapes):
        raise InputError("nothing to draw", where="coverage",
                         found=f"{draws} draws, {'a' if callable(shapes) else len(shapes)} loads, level {level}",
                         expected="at least one draw of one load, and a level in (0, 1)",
                         hint="give loads like the ones to be expected")  # fmt: skip
    rng, z = np.random.default_rng(seed), NormalDist().inv_cdf(0.5 + level / 2)
    model = truth or family.model
    add = _noise(noise, rng)
    static = None if dt is not None else _transfer(model)
    inside = total = 0
    for i, g in enumerate(_draws(shapes, draws, rng, dt)):
        if static is not None:
            _fits(g, static)
            estimate = family.estimate(add(static @ g))
        else:
            assert dt is not None
            estimate = family.estimate(add(model.predict(g, dt)), dt)
        hit = np.abs(estimate.load - g[: len(estimate.load)]) <= z * estimate.std
        inside, total = inside + int(hit.sum()), total + hit.size
        if progress is not None:
            progress((i + 1) / draws, "coverage")
    return Coverage(inside / total, level, draws, datetime.now(UTC).isoformat(timespec="seconds"))


Shapes = Draw | list[Array]


def _draws(shapes: Shapes, draws: int, rng: np.random.Generator, dt: float | None) -> Iterator[Array]:
    for i in range(draws):
        if callable(shapes):
            (g,) = _static([shapes(rng)]) if dt is None else _histories([shapes(rng)])  # type: ignore[misc]
            yield g
        else:
            yield shapes[i % len(shapes)]


def _histories(loads: ArrayLike | Sequence[ArrayLike] | Draw) -> Shapes:
    if callable(loads):
        return loads
    several = isinstance(loads, list | tuple) and any(np.ndim(g) > 0 for g in loads)
    arrays = [np.asarray(plain(g), float) for g in loads] if several else [np.asarray(plain(loads), float)]  # type: ignore[union-attr]
    for g in arrays:
        if g.ndim not in (1, 2) or not g.size:
            raise InputError("no load history", where="coverage", found=f"shape {g.shape}",
                             expected="(samples,) or (samples, loads)",
                             hint="leave dt out where the loads are static")  # fmt: skip
    return [g.reshape(len(g), -1) for g in arrays]


def _static(loads: ArrayLike | Sequence[ArrayLike] | Draw) -> Shapes:
    if callable(loads):
        return loads
    table = numbers(loads, "static loads", "give dt= where the loads are histories", where="coverage")
    if table.ndim not in (1, 2):
        raise InputError("no static loads", where="coverage", found=f"shape {table.shape}",
                         expected="(loads,) or (draws, loads)",
                         hint="give dt= where the loads are histories")  # fmt: skip
    return list(np.atleast_2d(table))


def _transfer(model: Model) -> Array:
    return np.asarray(model.static(), float)


def _fits(g: Array, H: Array) -> None:
    if g.shape != H.shape[1:]:
        raise InputError("the loads do not fit the model", where="coverage", found=f"{g.size} loads",
                         expected=f"{H.shape[1]} loads",
                         hint="one number per load, in the order of model.loads")  # fmt: skip


def _noise(noise: ArrayLike, rng: np.random.Generator) -> Callable[[Array], Array]:
    """What adds noise to clean readings, sensors last."""
    level = numbers(noise, "noise", where="coverage")
    if level.ndim > 2 or (level.ndim < 2 and np.any(level < 0)):
        raise InputError("no noise level", where="coverage", found=f"shape {level.shape}",
                         expected="std >= 0, a number or (sensors,), or a covariance (sensors, sensors)",
                         hint="give the std of each sensor")  # fmt: skip
    if level.ndim < 2:
        return lambda y: y + level * rng.standard_normal(y.shape)
    try:
        root = np.linalg.cholesky(level)
    except np.linalg.LinAlgError:
        raise InputError("the noise covariance is not positive definite", where="coverage",
                         found=f"shape {level.shape}", expected="a symmetric positive definite matrix",
                         hint="give the std of each sensor where the covariance is singular") from None  # fmt: skip
    return lambda y: y + rng.standard_normal(y.shape) @ root.T
