"""Page of the lab: contact on a compliant surface, inverted by every method, with the two errors that differ."""

from __future__ import annotations

import tomllib
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np

from .._inverse.choice import choose
from .._inverse.diagnosis.identifiability import layout
from .._inverse.diagnosis.picard import plateau
from .contract import Call, OneOf, OnOff, Page, Parameter, Real, Whole, rounded
from .facts import stated
from .surface import CELLS, METHODS, PENALTY, PROFILES, PressedLayer, kernel, solved, x

LEVEL = 1.96  # of the band, in std


def picture(surface: PressedLayer, method: str, lam: float, eta: float, seed: int) -> dict[str, Any]:
    """Everything that is drawn and read off at one lambda.

    Parameters
    ----------
    surface : PressedLayer
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


@lru_cache(256)
def chosen(surface: PressedLayer, method: str, eta: float, seed: int) -> dict[str, Any]:
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


def tried(which: int) -> dict[str, Any]:
    """One of the five things to try: what comes out, in words, and the settings that show it."""
    table = tomllib.loads(files(__package__).joinpath("files/contact.toml").read_text("utf-8"))
    told = table["try"][which - 1]
    steps = [{"label": step.pop("label"), "settings": {**table["base"], **step}} for step in told["steps"]]
    return {"outcome": stated(told["outcome"]), "steps": steps}


# -- the page ----------------------------------------------------------------------------------------------------------
SURFACE: dict[str, Parameter] = {
    "t": Real(0.02, 0.4), "spacing": Real(0.05, 0.6), "profile": OneOf(tuple(PROFILES)), "every": Whole(1, 4),
    "occluded": OnOff(),
}  # fmt: skip
DATA: dict[str, Parameter] = {"method": OneOf(METHODS), "eta": Real(0.0, 0.2), "seed": Whole(0, 10**6)}


def _picture(method: str, lam: float, eta: float, seed: int, **surface: Any) -> dict[str, Any]:
    return picture(PressedLayer(**surface), method, lam, eta, seed)


def _rules(method: str, eta: float, seed: int, **surface: Any) -> dict[str, Any]:
    return chosen(PressedLayer(**surface), method, eta, seed)


page = Page(
    "contact", "Contact inversion",
    "Press a compliant surface, read markers on it, invert: what methods, lambda and lost markers do to the map.",
    __package__, "files/contact.html",
    {
        "picture": Call(_picture, {**SURFACE, **DATA, "lam": Real(1e-8, 1.0)}),
        "rules": Call(_rules, {**SURFACE, **DATA}),
        "tried": Call(tried, {"which": Whole(1, 5)}),
    },
)  # fmt: skip
