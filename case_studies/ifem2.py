"""iFEM2.0-style force maps: several layers of elements and a ridge, against the single layer, under noise, calibrated.

In the style of Y. Zhao, S. Liu & D. Ma, IEEE Trans. Robotics (2025), "iFEM2.0".

*What the paper reports, as far as it is known here* (its abstract): multilayer mesh constraints with a ridge,
parameters by simulation and in-situ calibration, a benchmark of "accuracy, fidelity and noise resistance". Its formulas
and figures were not available: nothing here is compared with them, and `tactile.metrics` defines those words.

*What was rebuilt*: pads of 20 x 16 mm and 24 x 24 mm with E = 0.147 MPa and nu = 0.3223, `MultilayerPad` with its ridge
on tractions, and the plain ridge on nodal forces.

*What is measured here*: (1) several layers on their own data under noise (the same mesh on both sides: optimistic);
(2) exact motion of a bonded layer under a Hertz patch, read by several meshes without noise, and what the edges of the
pad take from resultants; (3) the same under noise, where a strong ridge also hides the fault of a single layer; (4) E
and nu from presses with a known force, on data of a mesh twice as fine; (5) accuracy, fidelity and noise resistance of
the sensors on the same presses of the exact layer.

Run ``python -m case_studies.ifem2``: prints the tables and saves ``ifem2.png``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tactile import ContactLaw, GelSlim, Markers, MultilayerPad, Pad, Press, metrics
from tactile.material import Gain, Shape, gain, poisson

from .pads import NU, PITCH, SIZE, THICKNESS, E, Rule, off, pad, patch, rules

PRESS = Press(radius=3e-3, force=1.0)  # a Hertz patch as wide as the pad is thick
LEVELS = (5e-6, 10e-6, 20e-6, 40e-6)
Array = NDArray[np.float64]


# -- several layers on their own data ----------------------------------------------------------------------------------
@dataclass(frozen=True)
class Own:
    """One mesh on its own data: condition number of the compliance, rules at each level of noise."""

    mesh: str
    kappa: float
    noise: tuple[float, ...]
    rules: tuple[dict[str, Rule], ...]


OWN = ((3, "standard", 3e-3), (4, "standard", 4e-3), (3, "bbar", 3e-3))


def own_data(
    noise: Sequence[float] = (5e-6, 20e-6), draws: int = 20, meshes: Sequence[tuple[int, str, float]] = OWN
) -> list[Own]:
    """Ridge on nodal forces, of standard bricks and of B-bar."""
    found = []
    for layers, element, thickness in meshes:
        gel = pad(layers, element, thickness)
        f = patch(gel)
        table = rules(gel.compliance, gel.displacements(f).ravel(), f.ravel(), noise, draws)
        name = f"{layers} {element}, {1e3 * thickness:.0f} mm"
        found.append(Own(name, float(np.linalg.cond(gel.compliance)), tuple(noise), tuple(table)))
    return found


# -- a Hertz patch of the exact layer ----------------------------------------------------------------------------------
@dataclass(frozen=True)
class Read:
    """Exact motion read by one mesh, F = K U: force on the inner 20 mm (N), map error, peak ratio."""

    mesh: str
    nu: float
    force: float
    error: float
    peak: float


MESHES = ((1, "standard", 1e-3), (4, "standard", 1e-3), (4, "bbar", 1e-3), (8, "bbar", 0.5e-3))


@cache
def square(layers: int, element: str, pitch: float = PITCH, nu: float = NU, side: float = 24e-3) -> Pad:
    """Square pad of 3 mm; few layers, and plain bricks near nu = 0.5, on purpose."""
    allow = ("W115", "W108", "E109")
    return Pad(
        size=(side, side), thickness=THICKNESS, E=E, nu=nu, pitch=pitch, layers=layers, element=element, allow=allow
    )


def truth(gel: Pad, press: Press = PRESS) -> tuple[Array, Array]:
    """Exact motion of the surface nodes (P, 3), and nodal forces (P, 3)."""
    assert gel.elements is not None
    pitch = gel.size[0] / gel.elements[0], gel.size[1] / gel.elements[1]
    (case,) = metrics.cases([press], gel.layer, gel.nodes2d, gel.nodes2d, pitch=pitch)
    return case.displacements, case.tractions * gel.surface.areas[:, None]


def hertz(
    nus: Sequence[float] = (0.3223, 0.475, 0.49), meshes: Sequence[tuple[int, str, float]] = MESHES
) -> list[Read]:
    """Noise-free rows."""
    rows = []
    for nu in nus:
        for layers, element, pitch in meshes:
            gel = square(layers, element, pitch, nu)
            motion, f = truth(gel)
            found = gel.forces(motion)
            inner = np.all(np.abs(gel.nodes2d) < 10e-3 * (1 + 1e-6), axis=1)
            rows.append(
                Read(
                    f"{layers} {element}, {1e3 * pitch:g} mm", nu, -float(found[inner, 2].sum()),
                    off(found[inner], f[inner]), float(found[inner, 2].min() / f[:, 2].min()),
                )
            )  # fmt: skip
    return rows


def edges(
    sides: Sequence[float] = (16e-3, 24e-3, 32e-3, 40e-3), nus: Sequence[float] = (0.3223, 0.45)
) -> list[tuple[float, float, float, float]]:
    """Poisson's ratio, side of the pad, and shares of Fx and Fz read from the motion of a layer without edges."""
    press, rows = Press(radius=3e-3, force=1.0, shear=(0.4, 0.0)), []
    for nu in nus:
        for side in sides:
            gel = square(4, "bbar", PITCH, nu, side)
            force = gel.forces(press.displacement(gel.layer, gel.nodes2d)).sum(axis=0)
            rows.append((nu, side, float(force[0] / 0.4), -float(force[2])))
    return rows


def noisy_patch(
    noise: Sequence[float] = LEVELS, draws: int = 5, side: float = 24e-3
) -> dict[str, list[dict[str, Rule]]]:
    """The Hertz patch under noise: one standard layer, and four B-bar layers with the ridge of `MultilayerPad`."""
    found = {}
    for name, gel in (("1 layer", square(1, "standard", side=side)), ("4 layers", square(4, "bbar", side=side))):
        sensor = MultilayerPad(gel, Markers(gel.nodes2d, noise[0], "XYZ"), penalty="identity")
        mass = sparse.csr_array(sparse.kron(gel.surface.mass, sparse.eye_array(3)))
        motion, f = truth(gel)
        found[name] = rules(sensor.model.H, motion.ravel(), f.ravel(), noise, draws, forces=mass)
    return found


# -- E and nu in the sensor --------------------------------------------------------------------------------------------
CONTACTS = ((1.5e-3, 0.1, (0.0, 0.0)), (2e-3, 0.2, (0.0, 0.0)), (2.5e-3, 0.3, (0.05, 0.05)), (3e-3, 0.4, (0.0, 0.0)))
TRUE_E, TRUE_NU, WITHIN, CALM = 120e3, 0.45, 3.6e-3, 2e-6


@cache
def known_presses(pitch: float = 0.5e-3, layers: int = 8) -> tuple[Array, list[Array], Array]:
    """Markers (m), their motion under presses at the centre of a finer pad, and the forces (N)."""
    real = Pad(size=SIZE, thickness=THICKNESS, E=TRUE_E, nu=TRUE_NU, pitch=pitch, layers=layers)
    x, y = np.meshgrid(np.linspace(-9e-3, 9e-3, 19), np.linspace(-7e-3, 7e-3, 15))
    places = np.column_stack([x.ravel(), y.ravel()])
    rows, motion, forces = real.from_surface(places), [], []
    for i, (radius, normal, shear) in enumerate(CONTACTS):
        press = Press(radius=radius, force=normal, shear=shear)
        u = np.asarray(rows @ real.displacements(truth(real, press)[1]).ravel()).reshape(-1, 3)
        motion.append(u + CALM * np.random.default_rng(i).standard_normal(u.shape))
        forces.append(press.vector)
    return places, motion, np.array(forces)


def calibrated(where: float | None = WITHIN, **fine: Any) -> tuple[Gain, Shape]:
    """Modulus at the true nu, and nu with its modulus, by a sensor that was built with 147 kPa.

    With the contact known to lie within `where` of the centre (m) the motion elsewhere tells nu; without that (None) a
    load anywhere may explain it.
    """
    places, motion, forces = known_presses(**fine)

    def build(nu: float) -> MultilayerPad:
        gel = guessed(nu)
        support = None if where is None else np.linalg.norm(gel.nodes2d, axis=1) < where
        return MultilayerPad(
            gel, Markers(places, CALM, "XYZ"), penalty="identity", choice=0.003, contact=ContactLaw(support=support)
        )

    there = build(TRUE_NU)
    estimated = [there.estimate(u).resultant().value for u in motion]
    tried = TRUE_NU + np.array([-0.06, -0.03, 0.0, 0.03])
    return gain(there.E, estimated, forces), poisson(build, tried, motion, forces)


@cache
def guessed(nu: float) -> Pad:
    """The sensor's pad at a Poisson's ratio; its modulus is a guess."""
    return Pad(size=SIZE, thickness=THICKNESS, E=E, nu=nu, pitch=PITCH, layers=4)


# -- the sensors on the same presses -----------------------------------------------------------------------------------
BENCH = (
    Press(at=(0.0, 0.0), radius=3e-3, force=1.0, shear=(0.25, 0.0)),
    Press(at=(2e-3, -1e-3), radius=2e-3, force=0.5, shear=(0.0, 0.15)),
    Press(at=(-1.5e-3, 1e-3), radius=2.5e-3, force=0.8),
)


def benchmark(
    draws: int = 10,
    noise: Sequence[float] = (2e-6, 5e-6, 10e-6, 20e-6),
    chosen: Sequence[str] = ("discrepancy", "upre"),
    frozen: float = 10e-6,
) -> metrics.BenchmarkTable:
    """Accuracy, fidelity and noise resistance; lambda of `MultilayerPad` is frozen on one press of 10 um noise."""
    single, several = pad(), pad(4, "bbar")
    nodes, areas = several.nodes2d, several.surface.areas
    cases = metrics.cases(BENCH, several.layer, nodes, nodes, pitch=PITCH)
    first = cases[0].displacements
    first = first + frozen * np.random.default_rng(99).standard_normal(first.shape)
    markers = Markers(nodes, frozen, "XYZ")
    sensors = {
        "GelSlim, 1 layer": GelSlim(single, markers, interpolation="linear"),
        "GelSlim, 4 layers": GelSlim(several, markers, interpolation="linear"),
    }
    for rule in chosen:
        sensors[f"MultilayerPad, {rule}"] = ridge = MultilayerPad(several, markers, penalty="identity", choice=rule)
        ridge.calibrate([first])
    called = {name: lambda u, s=s: s.estimate(u).forces() for name, s in sensors.items()}
    return metrics.benchmark(called, cases, areas=areas, points=nodes, noise=noise, draws=draws)


# -- words and picture -------------------------------------------------------------------------------------------------
def show_own(rows: Sequence[Own]) -> str:
    """Several layers on their own data."""
    lines = ["several layers on their own data, ridge on nodal forces: map error (error of Fz, peak ratio)"]
    for r in rows:
        lines.append(f"  {r.mesh}: condition number {r.kappa:.1f}")
        for level, table in zip(r.noise, r.rules, strict=True):
            lines.append(f"    {1e6 * level:2.0f} um: " + ", ".join(f"{k} {v}" for k, v in table.items()))
    return "\n".join(lines)


def show_patch(rows: Sequence[Read], wide: Sequence[tuple[float, ...]]) -> str:
    """The Hertz patch without noise, and the edges."""
    lines = ["1 N on a Hertz patch of 3 mm, exact motion of the layer, F = K U: Fz, map error, peak ratio"]
    lines += [f"  nu {r.nu:<6g} {r.mesh:18s} {r.force:6.3f} N  {r.error:6.3f}  {r.peak:6.3f}" for r in rows]
    lines.append("four B-bar layers, share of the resultant of a layer without edges: nu, side of the pad, Fx, Fz")
    return "\n".join(lines + [f"  nu {nu:<6g} {1e3 * a:.0f} mm  {x:.3f}  {z:.3f}" for nu, a, x, z in wide])


def show_noise(found: Mapping[str, Sequence[Mapping[str, Rule]]], noise: Sequence[float] = LEVELS) -> str:
    """The Hertz patch under noise."""
    lines = ["the same patch under noise: map error (error of Fz, peak ratio); naive F = K U, else ridge on tractions"]
    for name, tables in found.items():
        for level, table in zip(noise, tables, strict=True):
            lines.append(f"  {name:8s} {1e6 * level:2.0f} um: " + ", ".join(f"{k} {v}" for k, v in table.items()))
    return "\n".join(lines)


def show_calibrated(known: tuple[Gain, Shape], free: tuple[Gain, Shape]) -> str:
    """E and nu."""
    lines = [
        f"calibration in the sensor: built with E = {E:.4g} Pa; truth {TRUE_E:.4g} Pa, nu = {TRUE_NU}, on a finer mesh",
        f"  nu known: {known[0]}",
        f"  contact known to lie within {1e3 * WITHIN:g} mm: {known[1]}",
        f"  contact not known: {free[1]}",
    ]
    return "\n".join(lines)


LINES = (
    ("1 layer", "naive", "#D55E00", "-"),
    ("1 layer", "upre", "#D55E00", "--"),
    ("4 layers", "naive", "#56B4E9", "-"),
    ("4 layers", "upre", "#0072B2", "-"),
    ("4 layers", "discrepancy", "#0072B2", ":"),
    ("4 layers", "oracle", "#222222", "--"),
)


def picture(
    found: Mapping[str, Sequence[Mapping[str, Rule]]],
    shapes: Sequence[Shape],
    table: metrics.BenchmarkTable,
    path: Path,
) -> None:
    """Error against noise of the Hertz patch and of the benchmark, and the misfit over nu."""
    from matplotlib.figure import Figure

    fig = Figure(figsize=(12.5, 4.2), layout="constrained")
    patch_, bench, misfit = fig.subplots(1, 3)
    for name, rule, colour, style in LINES:
        errors = [t[rule].map for t in found[name]]
        patch_.loglog(1e6 * np.array(LEVELS), errors, color=colour, ls=style, marker="o", ms=3, label=f"{name}, {rule}")
    patch_.set_title("Hertz patch, 24 x 24 mm", fontsize=10)
    colours = ("#D55E00", "#56B4E9", "#0072B2", "#009E73")
    for name, colour in zip(table.sensors, colours, strict=True):
        slope = table.slopes[name]
        assert slope is not None
        bench.loglog(1e6 * np.array(slope.levels), slope.errors, color=colour, marker="o", ms=3, label=name)
    bench.set_title("three presses, 20 x 16 mm, lambda frozen", fontsize=10)
    for ax, levels in ((patch_, LEVELS), (bench, sorted({row.noise for row in table.rows}))):
        ax.set_xticks([1e6 * x for x in levels], [f"{1e6 * x:g}" for x in levels])
        ax.minorticks_off()
        ax.set_xlabel("noise of the motion (um)")
        ax.set_ylabel("relative error of the map")
        ax.legend(fontsize=7.5)
    for shape, label, colour in zip(
        shapes, ("contact known", "contact not known"), ("#0072B2", "#D55E00"), strict=True
    ):
        misfit.semilogy(shape.tried, shape.misfit, color=colour, marker="o", ms=4, label=label)
    misfit.axvline(TRUE_NU, color="#222222", lw=1, ls="--", label="truth")
    misfit.set_title("calibration in the sensor", fontsize=10)
    misfit.set_xlabel("Poisson's ratio tried")
    misfit.set_ylabel("misfit")
    misfit.legend(fontsize=8)
    fig.savefig(path, dpi=130)


def main() -> None:
    """Print the tables and save the picture."""
    print(show_own(own_data()))
    print("\n" + show_patch(hertz(), edges()))
    found = noisy_patch()
    print("\n" + show_noise(found))
    known, free = calibrated(), calibrated(None)
    print("\n" + show_calibrated(known, free))
    table = benchmark()
    print(f"\n{table}")
    picture(found, (known[1], free[1]), table, Path("ifem2.png"))
    print("\npicture: ifem2.png")


if __name__ == "__main__":
    main()
