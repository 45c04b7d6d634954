"""Page of the lab: one problem, every rule: L-curve, GCV and what 200 draws of noise let each rule choose."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Any

import numpy as np

from .._inverse.path import RegularizationPath
from .._inverse.rules import RULES, gcv_function, run
from .._inverse.sweep import Sweep
from .contract import Call, OnOff, Page, Parameter, Real, Whole, rounded
from .surface import CELLS, Array, PressedLayer

SURFACE, ETA = PressedLayer(0.1), 0.01
GRID = np.geomspace(1e-6, 1.0, 150)  # absolute lambdas: about from the smallest singular value to the largest
SMOOTH = 1.5  # nodes: std of the window behind correlated noise
DRAWS = 200
ASKED = ("l_curve", "gcv", "robust_gcv", "discrepancy", "upre", "quasi_optimality")  # of every draw
BINS = np.linspace(-6, 0, 31)  # of log10 lambda


def noise(seed: int, correlated: bool) -> Array:
    """Noise of the markers, (cells,), of std 1: white, or smoothed along them and scaled to that rms."""
    white = np.random.default_rng(seed).standard_normal(CELLS)
    if not correlated:
        return white
    apart = np.subtract.outer(np.arange(CELLS), np.arange(CELLS))
    smooth = np.exp(-((apart / SMOOTH) ** 2) / 2) @ white
    return np.asarray(smooth / np.sqrt(np.mean(smooth**2)))


def readings(seed: int, correlated: bool) -> Array:
    """What the markers read, (cells,)."""
    return SURFACE.readings(0.0, 0) + SURFACE.sigma(ETA) * noise(seed, correlated)


@lru_cache(32)
def sweep(seed: int, correlated: bool) -> Sweep:
    """The 150 lambdas of one draw, from the one factorisation."""
    return swept(SURFACE.path(readings(seed, correlated)))


def swept(path: RegularizationPath) -> Sweep:
    """A path over the grid, with the noise level that was put in."""
    lam = GRID / float(path.scale)
    return Sweep(path, lam, path.at(lam), SURFACE.sigma(ETA))


def errors(path: RegularizationPath) -> Array:
    """Rms error over the peak at every lambda of the grid, (lambdas,) or (lambdas, draws)."""
    scale = float(path.scale)
    return np.array([SURFACE.errors(path.solution(lam / scale, None).load)[1] for lam in GRID])


@lru_cache(32)
def curves(seed: int, correlated: bool) -> dict[str, Any]:
    """What is drawn of one draw: norms, GCV and error over lambda, each in its own range, and every rule's choice."""
    found = sweep(seed, correlated)
    path, point, scale = found.path, found.point, float(found.path.scale)
    wrong = errors(path)
    told = [run(name, found) for name in RULES]
    asked = [r for r in told if r.lam is not None]
    return rounded({
        "lam": GRID, "residual": np.sqrt(point.residual2), "norm": np.sqrt(point.penalty2),
        "gcv": _own_range(np.log(gcv_function(path, point))), "error": _own_range(np.log(wrong)),
        "truth": SURFACE.load, "x": (np.arange(CELLS) + 0.5) / CELLS,
        "oracle": GRID[int(np.argmin(wrong))], "best": wrong.min(),
        "rules": [{"rule": r.rule, "lam": (r.lam or 0.0) * scale, "edge": r.edge,
                   "error": at(seed, correlated, (r.lam or 0.0) * scale)["map"], "note": r.note} for r in asked],
        "refused": {r.rule: r.note for r in told if r.lam is None},
        "singular": [path.coefficients.gamma[k] for k in (0, -1)] if path.coefficients else [],
    }, 5)  # fmt: skip


@lru_cache(256)
def at(seed: int, correlated: bool, lam: float) -> dict[str, Any]:
    """The reconstruction at one lambda: load, its norm, that of the residual, and its errors."""
    path = sweep(seed, correlated).path
    relative = lam / float(path.scale)
    load, point = path.solution(relative, None).load, path.at(relative)
    resultant, map_error = SURFACE.errors(load)
    return rounded({
        "load": load, "residual": np.sqrt(point.residual2), "norm": np.sqrt(point.penalty2), "edf": point.edf,
        "resultant": resultant, "map": map_error, "largest": np.abs(load).max(),
    }, 6)  # fmt: skip


@cache
def histogram(correlated: bool) -> dict[str, Any]:
    """What `DRAWS` draws let rules choose: counts over `BINS`, medians of lambda, and of error over the oracle's."""
    draws = np.column_stack([readings(seed, correlated) for seed in range(DRAWS)])
    wrong = errors(SURFACE.path(draws))
    best, oracle = wrong.min(axis=0), GRID[np.argmin(wrong, axis=0)]
    lams: dict[str, list[float]] = {name: [] for name in ASKED}
    ratios: dict[str, list[float]] = {name: [] for name in ASKED}
    for k in range(DRAWS):
        found = swept(SURFACE.path(draws[:, k]))
        for name in ASKED:
            lam = run(name, found).lam
            if lam is None:  # a curve without a corner: nothing is chosen
                continue
            load = found.path.solution(lam, None).load
            lams[name].append(lam * float(found.path.scale))
            ratios[name].append(float(SURFACE.errors(load)[1]) / float(best[k]))
    rows = [{"rule": "oracle", **_row(oracle), "ratio": 1.0}]
    rows += [{"rule": name, **_row(np.array(lams[name])), "ratio": float(np.median(ratios[name]))} for name in ASKED]
    return rounded({"bins": 10 ** ((BINS[1:] + BINS[:-1]) / 2), "rows": rows, "draws": DRAWS}, 4)


def _row(lams: Array) -> dict[str, Any]:
    counts = np.histogram(np.clip(np.log10(lams), BINS[0], BINS[-1]), BINS)[0]
    return {"counts": counts, "lam": np.median(lams)}


def _own_range(values: Array) -> Array:
    low, high = np.nanmin(values), np.nanmax(values)
    return np.asarray((values - low) / (high - low))


DRAW: dict[str, Parameter] = {"seed": Whole(0, 10**6), "correlated": OnOff()}
page = Page(
    "lcurve", "L-curve and GCV",
    "Two bumps under a layer, one per cent of noise, 150 lambdas from one SVD: where each rule lands, draw after draw.",
    __package__, "files/lcurve.html",
    {
        "curves": Call(curves, DRAW),
        "at": Call(at, {**DRAW, "lam": Real(1e-6, 1.0)}),
        "histogram": Call(histogram, {"correlated": OnOff()}),
    },
)  # fmt: skip
