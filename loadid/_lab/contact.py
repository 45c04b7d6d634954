"""Page of the lab: contact on a compliant surface, inverted by every method, with the two errors that differ."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Any

import numpy as np

from .._inverse.choice import choose
from .._inverse.constrained.path import ConstrainedPath
from .._inverse.diagnosis.identifiability import layout
from .._inverse.diagnosis.picard import plateau
from .._inverse.sparse.atoms import DenseAtoms
from .._inverse.sparse.path import SparsePath
from ..constraints import NonNegative, Resultant, Support
from .contract import Call, OneOf, Page, Real, Switch, Whole, rounded
from .surface import CELLS, PROFILES, Array, Surface, kernel, x

PENALTY = {"gradient": "gradient", "laplacian": "laplacian"}
METHODS = ("naive", "identity", "gradient", "laplacian", "tsvd", "nonnegative", "support", "resultant", "l1")
LEVEL = 1.96  # of the band, in std
DRAWS = 200
GRID = np.geomspace(1e-6, 1.0, 151)  # absolute lambdas over which bumps are told apart
THICK = (0.05, 0.10, 0.15, 0.20, 0.25, 0.30)
TALL, VALLEY = 0.5, 0.55  # a peak counts above this share of the largest; the valley lies below this share of the lower


def picture(surface: Surface, method: str, lam: float, eta: float, seed: int) -> dict[str, Any]:
    """Everything that is drawn and read off at one lambda.

    Parameters
    ----------
    surface : Surface
    method : str
        One of `METHODS`.
    lam : float
        Absolute lambda; of l1 its share of the smallest one that leaves no load.
    eta : float
        Noise, as a share of the largest reading.
    seed : int
        Of its draw.
    """
    sigma = surface.sigma(eta)
    y = surface.readings(sigma, seed)
    path = surface.path(y, PENALTY.get(method, "identity"), truncated=method == "tsvd")
    load, std, edf = solved(surface, path, y, method, lam, sigma)
    kappa, rank, nullity = layout(path.singular_values, CELLS)
    resultant, map_error = surface.errors(load)
    modes, true = path.coefficients, surface.load
    H = kernel(surface.t)
    return rounded({
        "x": x, "truth": true, "load": load, "contact": x[surface.contact[[0, -1]]],
        "low": None if std is None else load - LEVEL * std, "high": None if std is None else load + LEVEL * std,
        "at": x[surface.markers], "readings": y, "fit": H @ load,
        "gamma": modes.gamma[: len(y)], "data": np.abs(modes.beta[: len(y)]), "sigma": sigma,
        "measurements": len(y), "unknowns": CELLS, "rank": rank, "nullity": nullity, "kappa": kappa, "edf": edf,
        "resultant": resultant, "map": map_error, "largest": np.abs(load).max() / true.max(),
        "peak": load.max() / true.max(),
    }, 6)  # fmt: skip


def solved(
    surface: Surface, path: Any, y: Array, method: str, lam: float, sigma: float
) -> tuple[Array, Array | None, float | None]:
    """Load (cells,), its std where there is noise, and the effective degrees of freedom."""
    if method == "l1":
        found = SparsePath(DenseAtoms(kernel(surface.t)[surface.markers]), y).solve(lam)
        return found.x, None, float(np.count_nonzero(found.x))
    constraints = {
        "nonnegative": [NonNegative()],
        "support": [NonNegative(), Support(surface.contact)],
        "resultant": [Resultant(np.ones((1, CELLS)), [surface.load.sum()], labels=("F",))],
    }.get(method)
    relative = 0.0 if method == "naive" else lam / float(path.scale)
    walked = path if constraints is None else ConstrainedPath(path, constraints, sigma=sigma or 1.0)
    solution = walked.solution(relative, sigma or None)
    edf = walked.at(relative).edf
    return (
        np.asarray(solution.load), None if solution.posterior is None else np.asarray(solution.posterior.std),
        None if edf is None else float(edf),
    )  # fmt: skip


@lru_cache(256)
def chosen(surface: Surface, method: str, eta: float, seed: int) -> dict[str, Any]:
    """What every rule says of the data, without constraints, and how many modes stand out of the noise."""
    sigma = surface.sigma(eta)
    path = surface.path(surface.readings(sigma, seed), PENALTY.get(method, "identity"), truncated=method == "tsvd")
    found = choose(path, sigma=sigma or None)
    scale, modes = float(path.scale), path.coefficients
    seen = modes.beta[modes.gamma > 0]
    return rounded({
        "rules": [{"rule": r.rule, "lam": None if r.lam is None else r.lam * scale, "edge": r.edge, "note": r.note}
                  for r in found.rules],
        "used": found.rule, "lam": found.lam * scale, "verdict": found.verdict,
        "modes": plateau(seen).start,
    }, 4)  # fmt: skip


# -- try this ----------------------------------------------------------------------------------------------------------
BASE = {"t": 0.1, "spacing": 0.25, "profile": "fingertips", "every": 1, "occluded": False, "eta": 0.01, "seed": 0,
        "method": "identity", "lam": 0.01}  # fmt: skip


def exact() -> dict[str, float]:
    """Exact data at every cell, naively inverted: largest error over the peak."""
    surface = Surface(0.1)
    path = surface.path(surface.readings(0.0, 0))
    return {"error": float(np.abs(path.solution(0.0, None).load - surface.load).max() / surface.load.max())}


@cache
def blown() -> dict[str, float]:
    """Medians over draws of 1 % noise: largest value over the peak naively, and the errors of the map by Tikhonov."""
    surface = Surface(0.1)
    path = surface.path(_draws(surface, 0.01))
    naive, tamed = (path.solution(lam / float(path.scale), None).load for lam in (0.0, 0.01))
    return {
        "naive": float(np.median(np.abs(naive).max(axis=1)) / surface.load.max()),
        "tikhonov": float(np.median(np.abs(tamed).max(axis=1)) / surface.load.max()),
        "map": float(np.median(surface.errors(tamed)[1])),
    }


@cache
def separable() -> dict[str, Any]:
    """Decades of lambda at which more than half of the draws of 1 % noise show two bumps, for each thickness.

    Two bumps: exactly two peaks above `TALL` of the largest, and between them a valley below `VALLEY` of the lower one.
    Without noise, at lambda = 1e-6 and t = 0.30: their height over the true one.
    """
    decades = []
    for t in THICK:
        surface = Surface(t)
        path = surface.path(_draws(surface, 0.01))
        told = [np.mean(two_bumps(path.solution(lam / float(path.scale), None).load)) > 0.5 for lam in GRID]
        decades.append(float((np.sum(told) - 1) * np.log10(GRID[1] / GRID[0])))
    thick = Surface(THICK[-1])
    path = thick.path(thick.readings(0.0, 0))
    clean = path.solution(1e-6 / float(path.scale), None).load
    return {"decades": decades, "height": float(clean.max() / thick.load.max()), "two": bool(two_bumps(clean[None])[0])}


def two_bumps(loads: Array) -> Any:
    """Whether each of some loads (draws, cells) shows two bumps, one on each half."""
    inner = np.pad(loads, ((0, 0), (1, 1)), constant_values=-np.inf)
    peaks = (loads > inner[:, :-2]) & (loads >= inner[:, 2:]) & (loads > TALL * loads.max(axis=1, keepdims=True))
    half = CELLS // 2
    lower = np.minimum(loads[:, :half].max(axis=1), loads[:, half:].max(axis=1))
    return (peaks.sum(axis=1) == 2) & (loads[:, half - 4 : half + 4].min(axis=1) < VALLEY * lower)


@cache
def hidden() -> dict[str, Any]:
    """Markers under the contact seen and not: medians over draws of the error of the resultant, and the conditioning."""
    found: dict[str, Any] = {}
    for name, surface in (("seen", Surface(0.1)), ("hidden", Surface(0.1, occluded=True))):
        path = surface.path(_draws(surface, 0.01))
        kappa, rank, nullity = layout(path.singular_values, CELLS)
        errors = surface.errors(path.solution(1e-3 / float(path.scale), None).load)
        found[name] = {"resultant": float(np.median(errors[0])), "map": float(np.median(errors[1])), "kappa": kappa,
                       "rank": rank, "nullity": nullity}  # fmt: skip
    return found


def partial() -> dict[str, Any]:
    """Errors (resultant, map) without noise: at moderate lambdas of t = 0.10, and at lambda = 1 of t = 0.30."""
    found = {}
    for t, lams in ((0.1, (0.003, 0.03, 0.1)), (0.3, (1.0,))):
        surface = Surface(t)
        path = surface.path(surface.readings(0.0, 0))
        for lam in lams:
            found[f"{t:g}, {lam:g}"] = [
                float(e) for e in surface.errors(path.solution(lam / float(path.scale), None).load)
            ]
    return found


def _draws(surface: Surface, eta: float) -> Array:
    """Readings of many draws, (markers, draws)."""
    sigma = surface.sigma(eta)
    return np.column_stack([surface.readings(sigma, seed) for seed in range(DRAWS)])


def tried(which: int) -> dict[str, Any]:
    """One of the five: what comes out, in words, and the settings that show it."""
    words, steps = _TRIED[which - 1]()
    return {"outcome": words, "steps": [{"label": label, "settings": {**BASE, **change}} for label, change in steps]}


def share(value: float, digits: int = 1) -> str:
    """A share in per cent, in words."""
    return f"{100 * value:.{digits}f} %"


def short(value: float) -> str:
    """A number of any size with two or three digits."""
    head, _, power = f"{value:.2e}".partition("e")
    return f"{value:.3g}" if 1e-3 <= abs(value) < 1e5 else f"{float(head):g}e{int(power)}"


Tried = tuple[str, list[tuple[str, dict[str, Any]]]]


def _exact() -> Tried:
    return (
        f"The load comes back exactly: the largest error is {short(exact()['error'])} of the peak. That proves nothing. "
        "Ill-posedness is a property of the operator and there before any noise: exact data in double precision merely "
        "give back the one load that they were made from, on the cells that they were made with.",
        [("no noise, every node, naive", {"eta": 0.0, "method": "naive"})],
    )


def _blown() -> Tried:
    f = blown()
    return (
        f"With 1 % of noise the naive inverse blows up: over {DRAWS} draws its largest value is {f['naive']:.0f} times the "
        f"peak in the median. Tikhonov at lambda = 0.01 keeps it at {f['tikhonov']:.2f} times the peak, with {share(f['map'], 0)} "
        "of error in the map: it declines to invent what the data do not hold.",
        [("1 % of noise, naive", {"method": "naive"}), ("then Tikhonov", {})],
    )


def _separable() -> Tried:
    f = separable()
    row = ", ".join(f"{d:.1f}" for d in f["decades"])
    return (
        "The range of lambda that still separates the two fingertips shrinks as the layer grows: "
        f"{row} decades at t = {', '.join(f'{t:.2f}' for t in THICK)} (half of {DRAWS} draws of 1 % noise show two peaks with "
        f"a valley below {share(VALLEY, 0)} between them). It is no floor: without noise, at lambda = 1e-6 and t = 0.30, two clean "
        f"peaks come back at {share(f['height'], 0)} of the true height. Detail becomes unaffordable, not impossible.",
        [(f"t = {t:.2f}", {"t": t, "lam": 0.01}) for t in THICK[1::2]]
        + [("t = 0.30 without noise, lambda = 1e-6", {"t": 0.3, "eta": 0.0, "lam": 1e-6})],
    )


def _hidden() -> Tried:
    a, b = hidden()["seen"], hidden()["hidden"]
    return (
        f"The markers under the contact are gone: the error of the resultant rises from {share(a['resultant'])} to "
        f"{share(b['resultant'], 0)} (medians of {DRAWS} draws, t = 0.1, lambda = 0.001), the rank falls from {a['rank']} to "
        f"{b['rank']}, the nullity rises from {a['nullity']} to {b['nullity']}, and yet sigma_1/sigma_r falls from "
        f"{short(a['kappa'])} to {short(b['kappa'])}. Leaving out sensors deletes modes and does not make the others harder to "
        "see: read the rank and the nullity, a smaller condition number is no good news here.",
        [("all markers", {"lam": 1e-3}), ("occluded", {"lam": 1e-3, "occluded": True})],
    )


def _partial() -> Tried:
    f = partial()
    low = "; ".join(
        f"{share(f[f'0.1, {lam:g}'][0], 2)} against {share(f[f'0.1, {lam:g}'][1])}" for lam in (0.003, 0.03, 0.1)
    )
    last = f["0.3, 1"]
    return (
        "At moderate lambda the resultant stays right while the map spreads and loses its peak: resultant against map "
        f"{low} at lambda = 0.003, 0.03, 0.1 (t = 0.1, no noise). A resultant that agrees is no proof of the map. At the top, "
        f"lambda = 1 and t = 0.30, the order flips: {share(last[0])} against {share(last[1])}; nothing survives that much "
        "smoothing. The two have different denominators: read their trends, not their difference.",
        [("lambda = 0.003", {"lam": 0.003, "eta": 0.0}), ("lambda = 0.1", {"lam": 0.1, "eta": 0.0}),
         ("t = 0.30, lambda = 1", {"t": 0.3, "lam": 1.0, "eta": 0.0})],
    )  # fmt: skip


_TRIED = (_exact, _blown, _separable, _hidden, _partial)

# -- the page ----------------------------------------------------------------------------------------------------------
SURFACE = {
    "t": Real(0.02, 0.4), "spacing": Real(0.05, 0.6), "profile": OneOf(tuple(PROFILES)), "every": Whole(1, 4),
    "occluded": Switch(),
}  # fmt: skip
DATA = {"method": OneOf(METHODS), "eta": Real(0.0, 0.2), "seed": Whole(0, 10**6)}


def _picture(method: str, lam: float, eta: float, seed: int, **surface: Any) -> dict[str, Any]:
    return picture(Surface(**surface), method, lam, eta, seed)


def _rules(method: str, eta: float, seed: int, **surface: Any) -> dict[str, Any]:
    return chosen(Surface(**surface), method, eta, seed)


page = Page(
    "contact", "Contact inversion",
    "Press a compliant surface, read markers on it, and invert: what each method, lambda and lost markers do to the map.",
    __package__, "files/contact.html",
    {
        "picture": Call(_picture, {**SURFACE, **DATA, "lam": Real(1e-8, 1.0)}),
        "rules": Call(_rules, {**SURFACE, **DATA}),
        "tried": Call(tried, {"which": Whole(1, 5)}),
    },
)  # fmt: skip
