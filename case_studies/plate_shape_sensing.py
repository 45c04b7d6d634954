"""Pressure on a plate by three routes: through its shape, through a transfer matrix, and from a full field (two ways).

After Li et al. (2025), of which the abstract's route is known: strains, shape-sensing inverse finite elements, Gaussian
radial basis functions, plate equation. A simply supported plate, 1 x 1 m and 5 mm thick, carries a pressure of two sine
waves, 100 and 50 Pa; its strains are those of the series solution, at 10 x 10 stations, with 1 % noise. What it makes
testable: with no transfer matrix inverted, the regularisation is still there, in the smoothing of the shape.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loadid import LoadEstimate, ShapeSensing, StaticInversion
from loadid.fullfield import FieldFrames, blocks, virtual_fields
from structures import ForwardModel, Structure, bases, plates, sensors

Array = NDArray[np.float64]
THICK, E, NU, RHO = 5e-3, 70e9, 0.33, 2700.0
D = E * THICK**3 / 12 / (1 - NU**2)
WAVES = {(1, 1): 100.0, (2, 1): 50.0}
NOISE, STATIONS, PIXELS = 0.01, 10, 201
PATCHES = 12
ROUTES = ("shape sensing", "transfer matrix, Laplacian", "full field, virtual fields", "full field, its shape")


@dataclass(frozen=True)
class Row:
    """What one route makes of one draw of the noise: a map (ny, nx), its relative error, share in the 95 % band."""

    route: str
    pressure: Array
    truth: Array
    error: float
    covered: float


def plate() -> Structure:
    """The plate."""
    return plates.plate(lengths=(1, 1), thickness=THICK, material=plates.Material(E=E, rho=RHO, nu=NU), elements=12)


def wave(m: int, n: int, x: Array, y: Array) -> Array:
    """Product of two sines."""
    return np.asarray(np.sin(m * np.pi * x) * np.sin(n * np.pi * y))


def pressure(x: Array, y: Array, side: float = 0.0) -> Array:
    """The truth in Pa, as means over squares of this side."""
    return np.asarray(
        sum(a * np.sinc(m * side / 2) * np.sinc(n * side / 2) * wave(m, n, x, y) for (m, n), a in WAVES.items())
    )


def deflections() -> dict[tuple[int, int], float]:
    """Amplitudes of the deflection (m): q / (D pi^4 (m^2 + n^2)^2)."""
    return {(m, n): a / (D * np.pi**4 * (m * m + n * n) ** 2) for (m, n), a in WAVES.items()}


def gauges() -> list[sensors.StrainGauge]:
    """Two gauges, along x and along y, at each station on the upper face."""
    p = np.linspace(0.05, 0.95, STATIONS)
    return [
        sensors.StrainGauge(at=(x, y), fibre=THICK / 2, angle=angle, label=f"{'xy'[angle > 0]} {x:.2f} {y:.2f}")
        for y in p for x in p for angle in (0.0, np.pi / 2)
    ]  # fmt: skip


def strains() -> Array:
    """Of the series solution."""
    placed = gauges()
    x, y = np.array([g.at for g in placed]).T
    along = np.array([g.angle == 0 for g in placed])
    parts = [w * np.pi**2 * np.where(along, m * m, n * n) * wave(m, n, x, y) for (m, n), w in deflections().items()]
    return np.asarray(THICK / 2 * sum(parts))


def gauged(seed: int) -> list[Row]:
    """Shape sensing and static inversion on the same noisy strains."""
    sheet, placed, rng = plate(), gauges(), np.random.default_rng(seed)
    clean = strains()
    level = NOISE * float(np.abs(clean).max())
    y = clean + level * rng.standard_normal(len(clean))
    loads = bases.patches(sheet, (PATCHES, PATCHES))
    truth = patched(loads)
    model = ForwardModel(sheet, placed, loads)
    families = (
        ShapeSensing(sheet, placed, loads=loads, noise=level),
        StaticInversion(model, penalty="laplacian", noise=level),
    )
    return [_on_patches(route, family.estimate(y), truth) for route, family in zip(ROUTES, families, strict=False)]


def patched(loads: bases.Basis) -> Array:
    """The truth as means of the patches."""
    return pressure(*np.asarray(loads.coordinates, float)[:, :2].T, 1 / PATCHES)


def full_field(seed: int) -> list[Row]:
    """Deflections of a camera, 201 x 201 points with the same relative noise, two ways."""
    x = np.linspace(0, 1, PIXELS)
    X, Y = np.meshgrid(x, x)
    w = sum(a * wave(m, n, X, Y) for (m, n), a in deflections().items())
    noisy = w + NOISE * np.abs(w).max() * np.random.default_rng(seed).standard_normal(w.shape)
    field, sheet = FieldFrames(noisy[None], "deflection", (x[1], x[1])), plate()
    found = virtual_fields(field, sheet)
    truth = pressure(X, Y)
    there = np.isfinite(found.pressure[0])
    half = 1.96 * float(np.hypot(found.std[0], found.bias[0]))
    inside = float(np.mean(np.abs(found.pressure[0] - truth)[there] <= half))
    placed, means, level = blocks(field)
    loads = bases.patches(sheet, (PATCHES, PATCHES))
    shape = ShapeSensing(sheet, placed, loads=loads, noise=level).estimate(means[0])
    return [_row(ROUTES[2], found.pressure[0], truth, inside), _on_patches(ROUTES[3], shape, patched(loads))]


def _on_patches(route: str, found: LoadEstimate, truth: Array) -> Row:
    inside = float(np.mean(np.abs(found.load - truth) <= 1.96 * found.std))
    return _row(route, found.load.reshape(PATCHES, PATCHES), truth.reshape(PATCHES, PATCHES), inside)


def _row(route: str, found: Array, truth: Array, inside: float) -> Row:
    there = np.isfinite(found)
    error = float(np.linalg.norm((found - truth)[there]) / np.linalg.norm(truth[there]))
    return Row(route, found, truth, error, inside)


def table(seeds: int = 3) -> list[list[Row]]:
    """Every route, one list for each draw of the noise."""
    return [[*gauged(seed), *full_field(seed)] for seed in range(seeds)]


def figure(rows: list[Row], path: Path) -> None:
    """The truth and the maps on one scale."""
    from matplotlib.figure import Figure

    fig = Figure(figsize=(14, 3.4), layout="constrained")
    maps = [("truth", rows[2].truth), *((f"{r.route}\n{r.error:.1%} off", r.pressure) for r in rows)]
    axes = fig.subplots(1, 1 + len(rows))
    for ax, (name, values) in zip(axes, maps, strict=True):
        image = ax.imshow(values, origin="lower", extent=(0, 1, 0, 1), vmin=-30, vmax=140, cmap="viridis")
        ax.set_title(name, fontsize=10)
        ax.set_xlabel("x (m)")
    axes[0].set_ylabel("y (m)")
    fig.colorbar(image, ax=axes, label="pressure (Pa)")
    fig.savefig(path, dpi=130)


def main() -> None:
    """Print the table and save the picture."""
    draws = table()
    print(f"pressure of {len(WAVES)} waves, {NOISE:.0%} noise, median of {len(draws)} draws")
    for k, route in enumerate(ROUTES):
        error, inside = (np.median([getattr(rows[k], name) for rows in draws]) for name in ("error", "covered"))
        print(f"  {route:28s} error {error:6.1%}   in the 95 % band {inside:4.0%}")
    figure(draws[0], Path("plate_shape_sensing.png"))
    print("picture: plate_shape_sensing.png")


if __name__ == "__main__":
    main()
