"""Numbers that the texts of the lab state, each computed by the package when a text is read, and kept.

A text names one in braces, as ``{blown[naive]:.0f}``: a function of `FACTS`, an entry of what it returns, and how it is
written. Nothing is typed in by hand, so nothing can drift from the code.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from .._inverse.diagnosis.identifiability import layout
from .._inverse.rules import discrepancy
from . import lcurve
from .surface import CELLS, Array, PressedLayer, kernel, solved

DRAWS, ETA = 200, 0.01
GRID = np.geomspace(1e-6, 1.0, 301)  # absolute lambdas over which bumps are told apart
THICK = (0.05, 0.10, 0.15, 0.20, 0.25, 0.30)
HALF = 0.5  # of the largest value, above which a peak counts; of the lower peak, below which the valley lies


def exact() -> dict[str, float]:
    """Exact readings of every cell, naively inverted: largest error over the peak."""
    surface = PressedLayer(0.1)
    load = _solved(surface, surface.readings(0.0, 0), 0.0)
    return {"error": float(np.abs(load - surface.load).max() / surface.load.max())}


def blown() -> dict[str, float]:
    """Medians over draws of noise: largest value over the peak, naive and at lambda = 0.01; the map's error there."""
    surface = PressedLayer(0.1)
    data, peak = _draws(surface), surface.load.max()
    naive, tamed = (_solved(surface, data, lam) for lam in (0.0, 0.01))
    return {
        "naive": float(np.median(np.abs(naive).max(axis=1)) / peak),
        "tikhonov": float(np.median(np.abs(tamed).max(axis=1)) / peak),
        "map": float(np.median(surface.errors(tamed)[1])),
    }


def separable() -> dict[str, Any]:
    """Decades of lambda at which a draw shows two bumps, median over the draws, by thickness.

    Two bumps: exactly two peaks above half of the largest value, and a valley below half of the lower one. Without
    noise, at lambda = 1e-6 and t = 0.30: their height over the true one.
    """
    decades = {}
    for t in THICK:
        surface = PressedLayer(t)
        path = surface.path(_draws(surface))
        told = [two_bumps(path.solution(lam / float(path.scale), None).load) for lam in GRID]
        decades[f"{t:.2f}"] = float(np.median(np.sum(told, axis=0)) * np.log10(GRID[1] / GRID[0]))
    thick = PressedLayer(THICK[-1])
    clean = _solved(thick, thick.readings(0.0, 0), 1e-6)
    return {**decades, "height": float(clean.max() / thick.load.max()), "two": bool(two_bumps(clean[None])[0]),
}  # fmt: skip


def two_bumps(loads: Array) -> Any:
    """Whether each of some loads (draws, cells) shows two bumps, with a valley about the middle."""
    inner = np.pad(loads, ((0, 0), (1, 1)), constant_values=-np.inf)
    peaks = (loads > inner[:, :-2]) & (loads >= inner[:, 2:]) & (loads > HALF * loads.max(axis=1, keepdims=True))
    half = CELLS // 2
    lower = np.minimum(loads[:, :half].max(axis=1), loads[:, half:].max(axis=1))
    return (peaks.sum(axis=1) == 2) & (loads[:, half - 4 : half + 4].min(axis=1) < HALF * lower)


def seen() -> dict[str, Any]:
    """All markers: medians over draws of both errors at lambda = 1e-3, and what the readings hold."""
    return _judged(PressedLayer(0.1))


def hidden() -> dict[str, Any]:
    """The same without the markers under the contact."""
    return _judged(PressedLayer(0.1, occluded=True))


def partial() -> dict[str, Any]:
    """Errors without noise at t = 0.10, by lambda, and at t = 0.30 with lambda = 1: resultant R and map M."""
    found: dict[str, float] = {}
    for t, lam in ((0.1, 0.003), (0.1, 0.03), (0.1, 0.1), (0.3, 1.0)):
        surface = PressedLayer(t)
        errors = surface.errors(_solved(surface, surface.readings(0.0, 0), lam))
        found |= {f"R{lam:g}": float(errors[0]), f"M{lam:g}": float(errors[1])}
    return found


def sizes() -> dict[str, Any]:
    """Singular values of the kernel at t = 0.10: the largest, the smallest, condition numbers of it and its square."""
    s = PressedLayer(0.1).path(np.zeros(CELLS)).singular_values
    return {"first": s[0], "last": s[-1], "kappa": s[0] / s[-1], "squared": (s[0] / s[-1]) ** 2}


def thickness() -> dict[str, Any]:
    """Modes with a singular value above 1 % of the largest, by thickness; condition numbers at t = 0.05 and 0.10."""
    found: dict[str, Any] = {}
    for t in THICK:
        s = PressedLayer(t).path(np.zeros(CELLS)).singular_values
        found |= {f"modes{t:.2f}": int(np.sum(s > 0.01 * s[0])), f"kappa{t:.2f}": s[0] / s[-1]}
    return found


def stiffness() -> dict[str, Any]:
    """A gel half as stiff doubles the kernel: by how much its condition number, and the readings, change."""
    kappa, twice = (layout(np.linalg.svd(k * kernel(0.1), compute_uv=False), CELLS)[0] for k in (1, 2))
    load = PressedLayer(0.1).load
    gain = np.max(2 * kernel(0.1) @ load) / np.max(kernel(0.1) @ load)
    return {"kappa": abs(twice / kappa - 1), "gain": gain}


def filters() -> dict[str, Any]:
    """Filter factors of Tikhonov's solution where sigma is lambda, ten times it, and a tenth of it; modes at 0.01."""
    path = PressedLayer(0.1).path(np.zeros(CELLS))
    gamma, scale = path.singular_values, float(path.scale)
    k = 10
    equal, over, under = (float(path.filter_factors(gamma[k] * f / scale)[k]) for f in (1.0, 0.1, 10.0))
    return {"equal": equal, "over": over, "under": under, "edf": float(np.sum(path.filter_factors(0.01 / scale)))}


def shortcut() -> dict[str, Any]:
    """The shortcut f = K u: rms load that noise of 1 % of the largest reading makes, over the peak."""
    surface = PressedLayer(0.1)
    path = surface.path(np.zeros(CELLS))
    noise = surface.sigma(ETA) * np.sqrt(np.sum(1 / path.singular_values**2) / CELLS)
    return {"noise": float(noise / surface.load.max())}


def white() -> dict[str, Any]:
    """What draws of white noise let the rules choose: medians of lambda, and of error over the oracle's as ``x_``."""
    return _drawn(False)


def smooth() -> dict[str, Any]:
    """The same of correlated noise."""
    return _drawn(True)


def margin() -> dict[str, Any]:
    """Discrepancy with the noise level stated half and twice as large: median of the map's error over the oracle's."""
    found: dict[str, list[float]] = {"half": [], "once": [], "twice": []}
    for seed in range(20):
        sweep = lcurve.sweep(seed, False)
        best = lcurve.errors(sweep.path).min()
        for name, factor in (("half", 0.5), ("once", 1.0), ("twice", 2.0)):
            lam = discrepancy(sweep, factor).lam
            if lam is not None:
                found[name].append(float(lcurve.SURFACE.errors(sweep.path.solution(lam, None).load)[1] / best))
    return {name: float(np.median(values)) for name, values in found.items()}


def priors() -> dict[str, Any]:
    """Map errors on a flat punch and on a point by three priors, at the best lambda of each (truth known)."""
    found = {}
    for profile in ("punch", "point"):
        surface = PressedLayer(0.1, profile=profile)
        sigma = surface.sigma(ETA)
        y = surface.readings(sigma, 0)
        for method in ("identity", "laplacian", "nonnegative", "l1"):
            path = surface.path(y, "laplacian" if method == "laplacian" else "identity")
            loads = (solved(surface, path, y, method, lam, sigma)[0] for lam in np.geomspace(1e-4, 1.0, 25))
            found[f"{profile}_{method}"] = min(float(surface.errors(load)[1]) for load in loads)
    return found


FACTS: dict[str, Callable[[], Mapping[str, Any]]] = {
    f.__name__: cache(f)
    for f in (exact, blown, separable, seen, hidden, partial, sizes, thickness, stiffness, filters, shortcut, white,
              smooth, margin, priors)
}  # fmt: skip


class FigureInText(float):
    """A number that is written as people do: 1.36e6, 84 %."""

    def __format__(self, spec: str) -> str:
        """As `float`, with a short power and a space before the sign of per cent."""
        return re.sub(r"e([+-])0*(\d)", lambda m: f"e{m[1].strip('+')}{m[2]}", super().__format__(spec)).replace(
            "%", " %"
        )


class _Named(dict[str, Any]):
    def __missing__(self, name: str) -> dict[str, Any]:
        return {key: FigureInText(value) for key, value in FACTS[name]().items()}


def stated(text: str) -> str:
    """A text with the numbers that it names."""
    return " ".join(text.split()).format_map(_Named())


def _solved(surface: PressedLayer, data: Array, lam: float) -> Array:
    path = surface.path(data)
    return np.asarray(path.solution(lam / float(path.scale), None).load)


def _draws(surface: PressedLayer) -> Array:
    """Readings of many draws, (markers, draws)."""
    sigma = surface.sigma(ETA)
    return np.column_stack([surface.readings(sigma, seed) for seed in range(DRAWS)])


def _judged(surface: PressedLayer) -> dict[str, Any]:
    data = _draws(surface)
    kappa, rank, nullity = layout(surface.path(data).singular_values, CELLS)
    errors = surface.errors(_solved(surface, data, 1e-3))
    return {"resultant": float(np.median(errors[0])), "map": float(np.median(errors[1])), "kappa": kappa,
            "rank": rank, "nullity": nullity}  # fmt: skip


def _drawn(correlated: bool) -> dict[str, Any]:
    rows = lcurve.histogram(correlated=correlated)["rows"]
    return {row["rule"]: row["lam"] for row in rows} | {f"x_{row['rule']}": row["ratio"] for row in rows}
