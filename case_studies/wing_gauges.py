"""Lift of a wing from strain gauges: the resultants are right long before the distribution is.

A tapered cantilever box beam of 6 m (aluminium skin of 2 mm) carries an elliptic lift with a bump over the aileron. Ten
strain gauges on the upper skin, of 60 mm grid length and 1.5 microstrain noise, are inverted on several load bases:
patches and hats along the span with a smoothness penalty, and polynomials. The data come from a finer mesh with
a stiffened bay that the model does not know, so that the model is a little wrong, as models are. Two levels of
validation stand side by side: shear force and bending moment at the root, and the lift distribution itself.

Run ``python -m case_studies.wing_gauges``: prints the table and saves ``wing_gauges.png``.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid import LoadEstimate, Noise, StaticInversion
from loadid.constraints import NonNegative
from loadid.validate import PressureMat, ReferenceWrench, Validation, validate
from structures import ForwardModel, Structure, bases, beams, sensors

SPAN, SKIN, E, RHO = 6.0, 2e-3, 70e9, 2700.0
NOISE = 1.5e-6
GAUGES = (0.15, 0.5, 1.0, 1.6, 2.2, 2.8, 3.4, 4.0, 4.6, 5.2)  # m from the root
QUIET = ["W114", "W703"]
Array = NDArray[np.float64]


def width(x: Array | float) -> Array | float:
    """Width of the box (m)."""
    return 0.60 * (1 - 0.5 * x / SPAN)


def height(x: Array | float) -> Array | float:
    """Height of the box (m)."""
    return 0.16 * (1 - 0.5 * x / SPAN)


def stiffness(x: float) -> float:
    """Bending stiffness of the thin box, E I (N m^2)."""
    b, h = float(width(x)), float(height(x))
    return E * (2 * b * SKIN * (h / 2) ** 2 + 2 * SKIN * h**3 / 12)


def mass(x: float) -> float:
    """Mass per length (kg/m)."""
    return RHO * SKIN * 2 * float(width(x) + height(x))


def wing(elements: int, bay: float = 0.0) -> Structure:
    """The wing; between 1.2 and 1.9 m it is stiffer by the share `bay`."""
    return beams.cantilever(
        length=SPAN,
        EI=lambda x: stiffness(x) * (1 + bay * (1.2 < x < 1.9)),
        mass_per_length=mass,
        elements=elements,
    )


def gauges() -> list[sensors.StrainGauge]:
    """Gauges on the upper skin."""
    return [
        sensors.StrainGauge(at=x, fibre=float(height(x)) / 2, length=0.06, noise=NOISE, label=f"gauge {x:g} m")
        for x in GAUGES
    ]


def lift(x: Array) -> Array:
    """Lift per length (N/m): elliptic, with a smooth bump over the aileron."""
    y = np.asarray(x, float).reshape(-1)
    elliptic = 900 * np.sqrt(np.maximum(1 - (y / SPAN) ** 2, 0.0))
    return elliptic + 260 * np.exp(-(((y - 4.4) / 0.45) ** 2) / 2)


def root(q: Any = lift) -> tuple[float, float]:
    """Shear force (N) and bending moment (N m) of the lift at the root, by quadrature."""
    from scipy.integrate import quad

    def at(x: float) -> float:
        return float(q(np.array([x]))[0])

    return (
        float(quad(at, 0, SPAN, points=[4.4], epsabs=1e-6)[0]),
        float(quad(lambda x: x * at(x), 0, SPAN, points=[4.4], epsabs=1e-6)[0]),
    )


def measured(seed: int) -> Array:
    """Strains of the real wing: a fine mesh, a stiffened bay of 4 %, noise."""
    fine = wing(240, bay=0.04)
    places = np.linspace(0, SPAN, 241)
    model = ForwardModel(fine, gauges(), bases.hats(fine, [places]))
    return model.static() @ lift(places) + NOISE * np.random.default_rng(seed).standard_normal(len(GAUGES))


def methods() -> dict[str, tuple[Any, dict[str, Any]]]:
    """Load basis and settings of each method."""
    beam = wing(48)
    fine = bases.patches(beam, 24)
    return {
        "4 patches, least squares": (bases.patches(beam, 4), {"penalty": None}),
        "24 patches, L = I": (fine, {"penalty": "identity"}),
        "24 patches, gradient": (fine, {"penalty": "gradient"}),
        "24 patches, Laplacian": (fine, {"penalty": "laplacian"}),
        "24 patches, Laplacian, q >= 0": (fine, {"penalty": "laplacian", "constraints": [NonNegative()]}),
        "25 hats, Laplacian": (bases.hats(beam, 24), {"penalty": "laplacian"}),
        "polynomials to degree 4": (bases.polynomials(beam, 4), {"penalty": None}),
        "polynomials to degree 8, L = I": (bases.polynomials(beam, 8), {"penalty": "identity"}),
    }


@dataclass(frozen=True)
class Row:
    """One method: medians over the seeds, and the estimate of the first."""

    method: str
    shear: float
    moment: float
    distribution: float
    covered: float
    estimate: LoadEstimate
    validation: Validation


def field(estimate: LoadEstimate, basis: Any) -> tuple[Array, Array, Array]:
    """Places along the span, the lift there, and its std."""
    x = np.linspace(0.02, SPAN - 0.02, 150)
    rows = basis.evaluate(np.eye(len(basis)), x[:, None])
    values = np.asarray(rows).reshape(len(basis), len(x)).T
    std = np.sqrt(np.maximum(estimate.posterior.variance(values), 0.0))
    return x, values @ estimate.load, std


def table(seeds: int = 9) -> list[Row]:
    """All methods."""
    shear, moment = root()
    data, rows = [measured(seed) for seed in range(seeds)], []
    for name, (basis, settings) in methods().items():
        family = StaticInversion(
            ForwardModel(wing(48), gauges(), basis), noise=Noise(source="data sheet"), allow=QUIET, **settings
        )
        weights = basis.resultant(about=(0.0,))
        found = []
        for y in data:
            estimate = family.estimate(y)
            F, M = weights @ estimate.load
            x, q, std = field(estimate, basis)
            error = np.linalg.norm(q - lift(x)) / np.linalg.norm(lift(x))
            found.append(
                (abs(F / shear - 1), abs(abs(M) / moment - 1), error, np.mean(np.abs(q - lift(x)) < 1.96 * std))
            )
        first = family.estimate(data[0])
        checked = validate(
            first,
            ReferenceWrench(
                [shear, np.sign(weights[1] @ first.load) * moment], C=weights, labels=("F", "M"), source="balance"
            ),
            PressureMat(means(basis), strips(), source="12 strips of the span"),
        )
        middle = np.median(found, axis=0)
        rows.append(Row(name, *(float(v) for v in middle), first.validated(checked), checked))
    return rows


def strips(count: int = 12, points: int = 20) -> Array:
    """Mean lift on equal strips of the span."""
    x = (np.arange(count * points) + 0.5) * SPAN / (count * points)
    return lift(x).reshape(count, points).mean(axis=1)


def means(basis: Any, count: int = 12, points: int = 20) -> Array:
    """Weights of the loads of a basis in the mean on each strip, (strips, loads)."""
    x = (np.arange(count * points) + 0.5) * SPAN / (count * points)
    values = np.asarray(basis.evaluate(np.eye(len(basis)), x[:, None])).reshape(len(basis), count, points)
    return values.mean(axis=2).T


def figure(rows: list[Row], path: Path) -> None:
    """The lift of four methods with their bands, against the truth, and the gauges."""
    from matplotlib.figure import Figure

    bases_of = {name: basis for name, (basis, _) in methods().items()}
    chosen = [rows[i] for i in (0, 2, 3, 6)]
    fig = Figure(figsize=(10, 6.4), layout="constrained")
    for ax, row in zip(fig.subplots(2, 2, sharex=True, sharey=True).ravel(), chosen, strict=True):
        x, q, std = field(row.estimate, bases_of[row.method])
        ax.fill_between(x, q - 1.96 * std, q + 1.96 * std, color="#56B4E9", alpha=0.35, lw=0, label="95 % band")
        ax.plot(x, lift(x), color="#222222", lw=1.2, ls="--", label="truth")
        ax.plot(x, q, color="#0072B2", lw=1.6, label="estimate")
        ax.plot(GAUGES, np.full(len(GAUGES), -120.0), "v", color="#D55E00", ms=6, label="strain gauges")
        ax.set_title(
            f"{row.method}\nshear {row.shear:.1%}, moment {row.moment:.1%}, distribution {row.distribution:.1%} off",
            fontsize=10,
        )
        ax.set_ylim(-200, 1500)
    fig.axes[1].legend(loc="upper right", fontsize=8, ncols=2)
    fig.supxlabel("distance from the root (m)")
    fig.supylabel("lift per length (N/m)")
    fig.savefig(path, dpi=130)


def main() -> None:
    """Print the table and save the picture."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 9
    shear, moment = root()
    rows = table(seeds)
    print(f"root shear {shear:.1f} N, root bending moment {moment:.1f} N m; median of {seeds} draws")
    print(f"  {'method':34s} {'shear':>8s} {'moment':>8s} {'distribution':>13s} {'in 95 % band':>13s}  flags")
    for row in rows:
        codes = " ".join(sorted(c for c in row.estimate.codes if not c.startswith("N") and c not in QUIET))
        print(
            f"  {row.method:34s} {row.shear:8.2%} {row.moment:8.2%} {row.distribution:13.2%} {row.covered:13.0%}"
            f"  {codes}"
        )
    print(f"\n{rows[3].method}:\n{rows[3].validation.table()}")
    figure(rows, Path("wing_gauges.png"))
    print("\npicture: wing_gauges.png")


if __name__ == "__main__":
    main()
