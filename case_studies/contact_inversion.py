"""Contact on a one-dimensional compliant surface: what lambda, constraints and lost markers do to a pressure map.

A layer of thickness t smooths the pressure p(x) on its surface, x in [0, 1], with a Lorentzian kernel:
``u(x) = integral of (t / pi) / (t^2 + (x - s)^2) p(s) ds``, a surrogate of the thin layer's response. Markers read u
at 48 nodes; the data come from a grid ten times finer, with white noise. Two validation numbers stand side by side,
because they tell different things: the error of the resultant over the true resultant, and the rms error of the map
over the true peak.

Run ``python -m case_studies.contact_inversion``: prints the tables and saves ``contact_inversion.png``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid import Lambda, LoadEstimate, Noise, StaticInversion
from loadid.constraints import Bounds, NonNegative, Resultant, Support
from structures import Channel, MatrixModel

NODES, FINER, NOISE = 48, 10, 0.01
QUIET = ["W114", "W703"]  # a study of the method: no rig to verify, coverage is tested elsewhere
Array = NDArray[np.float64]


def nodes(count: int = NODES) -> Array:
    """Midpoints of `count` cells on [0, 1]."""
    return (np.arange(count) + 0.5) / count


def kernel(t: float, at: Array, sources: Array) -> Array:
    """Displacement at `at` per unit pressure on the cells around `sources`, shape (markers, cells)."""
    return (t / np.pi) / (t**2 + (at[:, None] - sources) ** 2) / len(sources)


def bumps(x: Array) -> Array:
    """Two fingertips: Gaussians of standard deviation 0.03 at 0.375 and 0.625."""
    return np.exp(-(((x - 0.375) / 0.03) ** 2) / 2) + np.exp(-(((x - 0.625) / 0.03) ** 2) / 2)


def mound(x: Array) -> Array:
    """One soft fingertip."""
    return np.exp(-(((x - 0.5) / 0.08) ** 2) / 2)


def punch(x: Array) -> Array:
    """A flat punch: uniform pressure with edges."""
    return np.where(np.abs(x - 0.45) < 0.15, 1.0, 0.0)


def hertz(x: Array) -> Array:
    """The half ellipse of a Hertz line contact."""
    return np.sqrt(np.maximum(1 - ((x - 0.5) / 0.12) ** 2, 0.0))


PROFILES: dict[str, Callable[[Array], Array]] = {f.__name__: f for f in (bumps, mound, punch, hertz)}
LAYOUTS: dict[str, Array] = {
    "every node": np.arange(NODES),
    "every third": np.arange(1, NODES, 3),
    "occluded under the contact": np.flatnonzero(np.abs(nodes() - 0.5) > 0.2),
}


def model(t: float, layout: str = "every node") -> MatrixModel:
    """Markers of a layout against the pressure on 48 cells."""
    x = nodes()
    keep = LAYOUTS[layout]
    return MatrixModel(
        kernel(t, x[keep], x),
        sensors=[Channel(label=f"u{i}", quantity="displacement", unit="m") for i in keep],
        loads=[Channel(label=f"p{i}", quantity="pressure", unit="Pa") for i in range(NODES)],
    )


def readings(t: float, profile: Callable[[Array], Array], layout: str, seed: int, noise: float = NOISE) -> tuple:
    """Noisy markers and the std of their noise."""
    fine = nodes(NODES * FINER)
    full = kernel(t, nodes(), fine) @ profile(fine)
    sigma = noise * float(np.sqrt(np.mean(full**2)))
    rng = np.random.default_rng(seed)
    return (full + sigma * rng.standard_normal(NODES))[LAYOUTS[layout]], sigma


def truth(profile: Callable[[Array], Array]) -> Array:
    """Mean pressure on each of the 48 cells."""
    return profile(nodes(NODES * FINER)).reshape(NODES, FINER).mean(axis=1)


def methods(p: Array) -> dict[str, dict[str, Any]]:
    """Settings of every method; a force plate knows the resultant of the load `p`, to 1 %, and where contact may be."""
    total = float(p.mean())
    ones = np.full((1, NODES), 1 / NODES)
    plate = Resultant(ones, [total], covariance=[[(0.01 * total) ** 2]], labels=("F",))
    exact = Resultant(ones, [total], labels=("F",))
    where = Support(np.flatnonzero(p > 1e-3 * p.max()))
    return {
        "least squares": {"penalty": None, "allow": ["E306", *QUIET]},
        "truncated SVD": {"choice": Lambda("gcv", method="tsvd")},
        "Tikhonov, L = I": {},
        "first difference": {"penalty": "first_difference"},
        "second difference": {"penalty": "second_difference"},
        "L = I, p >= 0": {"constraints": [NonNegative()]},
        "L = I, 0 <= p <= 1.2 peak": {"constraints": [Bounds(0.0, 1.2 * float(p.max()))]},
        "L = I, support": {"constraints": [where]},
        "L = I, resultant": {"constraints": [exact]},
        "L = I, force plate": {"constraints": [plate]},
        "L = I, p >= 0 and resultant": {"constraints": [NonNegative(), exact]},
        "first difference, p >= 0, force plate": {"penalty": "first_difference", "constraints": [NonNegative(), plate]},
    }


@dataclass(frozen=True)
class Row:
    """One method on one case: medians over the seeds."""

    method: str
    resultant: float
    map: float
    edf: float | None
    estimate: LoadEstimate


def errors(load: Array, p: Array) -> tuple[float, float]:
    """Error of the resultant over the resultant, and rms error of the map over its peak."""
    return abs(load.sum() - p.sum()) / p.sum(), float(np.sqrt(np.mean((load - p) ** 2)) / p.max())


def table(t: float, profile: str = "bumps", layout: str = "every node", seeds: int = 5) -> list[Row]:
    """All methods on one profile and layout."""
    shape, forward = PROFILES[profile], model(t, layout)
    p, rows = truth(shape), []
    for name, settings in methods(p).items():
        found = []
        for seed in range(seeds):
            y, sigma = readings(t, shape, layout, seed)
            family = StaticInversion(
                forward, **{"noise": Noise(sigma, source="repeatability"), "allow": QUIET, **settings}
            )
            estimate = family.estimate(y)
            found.append((*errors(estimate.load, p), estimate))
        middle = np.median([f[:2] for f in found], axis=0)
        rows.append(Row(name, float(middle[0]), float(middle[1]), found[0][2].facts.edf, found[0][2]))
    return rows


def conditioning(t: float) -> dict[str, tuple[float, int, int]]:
    """Condition number of the visible part, rank and nullity of each layout."""
    from loadid._inverse.diagnosis.identifiability import layout as judged

    return {name: judged(np.linalg.svd(model(t, name).H, compute_uv=False), NODES) for name in LAYOUTS}


def figure(rows: list[Row], p: Array, path: Path) -> None:
    """Truth and four methods, each with its band and its two numbers."""
    from matplotlib.figure import Figure

    chosen = ["truncated SVD", "Tikhonov, L = I", "L = I, p >= 0", "first difference, p >= 0, force plate"]
    fig = Figure(figsize=(10, 6.5), layout="constrained")
    x = nodes()
    panels = fig.subplots(2, 2, sharex=True, sharey=True).ravel()
    for ax, row in zip(panels, [r for r in rows if r.method in chosen], strict=True):
        low, high = row.estimate.band()
        ax.fill_between(x, low, high, color="#56B4E9", alpha=0.35, lw=0, label="95 % band")
        ax.plot(x, p, color="#222222", lw=1.2, ls="--", label="truth")
        ax.plot(x, row.estimate.load, color="#0072B2", lw=1.6, label="estimate")
        ax.set_title(f"{row.method}\nresultant {row.resultant:.1%}, map {row.map:.1%} off", fontsize=10)
        ax.set_ylim(-0.4, 1.3)
    fig.supxlabel("place on the surface x (length of the surface)")
    fig.supylabel("pressure (Pa)")
    fig.axes[0].legend(loc="lower left", fontsize=8)
    fig.savefig(path, dpi=130)


def main() -> None:
    """Print the tables and save the picture."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    for t in (0.1, 0.3):
        print(f"\nlayer thickness t = {t:g}")
        for name, (kappa, rank, nullity) in conditioning(t).items():
            print(f"  {name:28s} condition number {kappa:8.2g}, rank {rank}, nullity {nullity}")
    for t, profile, layout in [
        (0.1, "bumps", "every node"),
        (0.1, "bumps", "every third"),
        (0.1, "bumps", "occluded under the contact"),
        (0.3, "bumps", "every node"),
        (0.1, "punch", "every node"),
        (0.1, "hertz", "every node"),
    ]:
        rows = table(t, profile, layout, seeds)
        print(f"\n{profile}, t = {t:g}, {layout}, noise {NOISE:.0%}, median of {seeds} draws")
        print(f"  {'method':40s} {'resultant':>10s} {'map':>8s} {'edf':>6s}  flags")
        for row in rows:
            edf = "" if row.edf is None else f"{row.edf:6.1f}"
            codes = " ".join(sorted(c for c in row.estimate.codes if not c.startswith("N") and c not in QUIET))
            print(f"  {row.method:40s} {row.resultant:10.2%} {row.map:8.2%} {edf:>6s}  {codes}")
        if (t, profile, layout) == (0.1, "bumps", "every node"):
            figure(rows, truth(PROFILES[profile]), Path("contact_inversion.png"))
    print("\npicture: contact_inversion.png")


if __name__ == "__main__":
    main()
