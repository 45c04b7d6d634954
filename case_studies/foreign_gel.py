"""Force maps on a gel that the sensor did not make: of other finite elements, under presses of other shapes.

Simulated sensors are mostly shown on data of their own mesh, which flatters them. Here the motion comes from
`case_studies.bodies`: exact near the press by the kernels of the bonded layer, with free edges by quadratic bricks, and
markers that lie on no node. A pad of 16 x 14 x 3 mm (147 kPa, nu 0.45), 5 um of noise in the motion of markers every
1 mm and 10 um in every pixel of a depth map, is pressed by a ball, a flat disc, a ring, a bar, and in two places.
`MultilayerPad` has its defaults, lambda from two presses before. Then the same pad is declared wrong: four balls of
known force tell its modulus, Poisson's ratio and thickness (`material.in_situ`).

Run ``python -m case_studies.foreign_gel``: prints both tables and saves ``foreign_gel.png``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tactile import ContactLaw, DepthMap, ForceMap, Markers, MultilayerPad, Pad, Tolerances, material

from .bodies import Array, Patch, surfaces

E, NU, SIZE, THICKNESS = 147e3, 0.45, (16e-3, 14e-3), 3e-3
NOISE, PIXEL, PIXEL_NOISE = 5e-6, 0.2e-3, 10e-6
DECLARED = {"E": 180e3, "nu": 0.43, "thickness": 3.2e-3}
PRIOR = Tolerances(E=0.2, nu=0.03, thickness=0.07)
Z95 = 1.96
SENSORS: dict[str, dict[str, Any]] = {
    "in the plane": {}, "and depth": {"deep": True}, "all axes": {"axes": "XYZ"},
    "and depth, no pull": {"deep": True, "contact": ContactLaw(no_pull=True)},
}  # fmt: skip


def ball(x: float, y: float, radius: float, force: float) -> tuple[Patch, ...]:
    """Pressure of a sphere with a fifth of shear; mm and N."""
    return (Patch("round", (1e-3 * x, 1e-3 * y), (1e-3 * radius, 1e-3 * radius), 0.0, (0.2 * force, 0.0, -force)),)


PRESSES = {
    "ball": ball(0.6, -0.4, 1.8, 0.2),
    "disc": (Patch("flat", (-1.1e-3, 0.7e-3), (1.5e-3, 0.0), 0.0, (0.0, 0.05, -0.2)),),
    "ring": (Patch("ring", (0.3e-3, 0.2e-3), (2e-3, 1.2e-3), 0.0, (0.04, 0.03, -0.2)),),
    "bar": (Patch("bar", (0.5e-3, 0.0), (2e-3, 0.7e-3), 0.6, (0.06, 0.0, -0.2)),),
    "two": ball(-2.2, 0.3, 1.1, 0.08) + ball(2.1, -0.5, 1.3, 0.12),
}
BEFORE = [ball(-0.7, 0.4, 1.5, 0.15), ball(1.3, 0.9, 2.0, 0.2)]  # lambda comes from these
KNOWN = [*BEFORE, ball(0.2, -1.0, 1.2, 0.08), ball(-1.4, -0.8, 2.3, 0.25)]  # and the material from these


@dataclass(frozen=True, eq=False)
class Seen:
    """One press as a camera sees it.

    Parameters
    ----------
    motion : array (N, 3)
        Of the markers (m).
    depth : DepthMap
    patches : tuple of Patch
    """

    motion: Array
    depth: DepthMap
    patches: tuple[Patch, ...]

    @cached_property
    def force(self) -> Array:
        """True resultant (3,) in N."""
        return np.sum([p.force for p in self.patches], axis=0)

    def traction(self, gel: Pad) -> Array:
        """True tractions (P, 3) in Pa: means over a cell about each node."""
        side = float(np.sqrt(np.median(gel.surface.areas)))
        steps = ((np.arange(12) + 0.5) / 12 - 0.5) * side
        places = (gel.nodes2d[:, None, None, :] + np.stack(np.meshgrid(steps, steps), axis=-1)).reshape(-1, 2)
        shares = [p.density(places).reshape(gel.points, -1).mean(axis=1) for p in self.patches]
        return np.asarray(sum(np.outer(s, p.force) for s, p in zip(shares, self.patches, strict=True)))


def markers() -> Array:
    """Places (N, 2) of the markers: a grid with some disorder."""
    x, y = (np.arange(-s / 2 + 1e-3, s / 2 - 0.5e-3, 1e-3) for s in SIZE)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return np.asarray(grid + np.random.default_rng(0).uniform(-1e-4, 1e-4, grid.shape))


def watched(presses: Sequence[tuple[Patch, ...]], seed: int) -> list[Seen]:
    """Presses on the true gel, with noise."""
    rng, points = np.random.default_rng(seed), markers()
    x, y = ((np.arange(round(s / PIXEL)) + 0.5) * PIXEL - s / 2 for s in SIZE)
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    out = []
    for press, surface in zip(presses, surfaces(presses, "fe", SIZE, THICKNESS, NU), strict=True):
        deep = surface(grid.reshape(-1, 2))[:, 2].reshape(grid.shape[:2]) / E
        motion = surface(points) / E
        out.append(Seen(
            motion + NOISE * rng.standard_normal(motion.shape),
            DepthMap(deep + PIXEL_NOISE * rng.standard_normal(deep.shape), PIXEL, PIXEL_NOISE), press,
        ))  # fmt: skip
    return out


def sensor(gel: Pad, template: DepthMap, *, axes: str = "XY", deep: bool = False, **settings: Any) -> MultilayerPad:
    """A sensor on the pad that a user believes in."""
    return MultilayerPad(gel, Markers(markers(), NOISE, axes), depth=template if deep else None, **settings)


def taken(of: MultilayerPad, seen: Seen) -> tuple[Array, DepthMap | None]:
    """What a sensor takes of a press."""
    return seen.motion[:, : len(of.markers.axes)], None if of.depth is None else seen.depth


def calibrated(of: MultilayerPad, presses: Sequence[Seen]) -> MultilayerPad:
    """Lambda from presses."""
    frames = [taken(of, s) for s in presses]
    of.calibrate([f for f, _ in frames], None if of.depth is None else [s.depth for s in presses])
    return of


@dataclass(frozen=True, eq=False)
class Row:
    """One map beside its truth.

    Parameters
    ----------
    sensor, press : str
    found : ForceMap
    truth : array (P, 3)
        Pa.
    force : array (3,)
        N.
    """

    sensor: str
    press: str
    found: ForceMap
    truth: Array
    force: Array

    @cached_property
    def away(self) -> Array:
        """Error of the force over the normal force (3,)."""
        return np.asarray((self.found.resultant().value - self.force) / abs(self.force[2]))

    @property
    def band(self) -> Array:
        """Half the 95 % band of the force over the normal force (3,)."""
        return np.asarray(Z95 * self.found.resultant().std / abs(self.force[2]))

    @cached_property
    def covered(self) -> Array:
        """Share of the tractions under the press in their 95 % band, by component (3,)."""
        under = np.any(self.truth != 0, axis=1)
        inside = np.abs(self.found.traction() - self.truth) <= Z95 * self.found.std.reshape(-1, 3)
        return np.asarray(inside[under].mean(axis=0))

    @cached_property
    def map(self) -> float:
        """Relative L2 error of the map."""
        return float(np.linalg.norm(self.found.traction() - self.truth) / np.linalg.norm(self.truth))


def maps(gel: Pad, names: Sequence[str] = tuple(SENSORS), seed: int = 1) -> list[Row]:
    """Every press through every sensor on a pad."""
    before, presses = watched(BEFORE, seed), watched(list(PRESSES.values()), seed + 1)
    out = []
    for name in names:
        built = calibrated(sensor(gel, before[0].depth, **SENSORS[name]), before)
        for press, seen in zip(PRESSES, presses, strict=True):
            out.append(Row(name, press, built.estimate(*taken(built, seen)), seen.traction(gel), seen.force))
    return out


def pad(**changed: float) -> Pad:
    """The pad by its true values, or by those that are declared."""
    return Pad(size=SIZE, **{"E": E, "nu": NU, "thickness": THICKNESS, **changed})


def in_situ(seed: int = 1) -> material.InSitu:
    """The declared pad, fitted to presses with a scale that is 1 % off."""
    presses = watched(KNOWN, seed)
    F = np.array([s.force for s in presses]) * (1 + 0.01 * np.random.default_rng(seed).standard_normal((4, 1)))
    return material.in_situ(
        lambda gel: sensor(gel, presses[0].depth, deep=True), pad(**DECLARED), [s.motion[:, :2] for s in presses], F,
        depths=[s.depth for s in presses], prior=PRIOR,
    )  # fmt: skip


def show(rows: Sequence[Row]) -> str:
    """The table in text."""
    lines = [
        f"{'':27s}force off, and its band      tractions in theirs",
        f"{'sensor':20s} press      Fz   band  shear   band     x    y    z  map error",
    ]
    for r in rows:
        shear, band = np.abs(r.away[:2]).max(), r.band[:2].max()
        lines.append(
            f"{r.sensor:20s} {r.press:5s}  {r.away[2]:+7.1%} {r.band[2]:6.1%} {shear:6.1%} {band:6.1%} "
            f"{r.covered[0]:5.0%}{r.covered[1]:5.0%}{r.covered[2]:5.0%}  {r.map:9.2f}"
        )
    return "\n".join(lines)


def show_material(found: material.InSitu) -> str:
    """What the presses told, beside truth and declaration."""
    lines = [f"{'':10s} {'true':>9s} {'declared':>9s} {'found':>9s} {'std':>8s}"]
    for name, true in (("E", E), ("nu", NU), ("thickness", THICKNESS)):
        value, spread = getattr(found.pad, name), getattr(found.std, name)
        spread = spread if name == "nu" else spread * value
        lines.append(f"{name:10s} {true:9.4g} {DECLARED[name]:9.4g} {value:9.4g} {spread:8.2g}")
    return "\n".join([*lines, f"motion within {found.misfit:.2f} std; told: {', '.join(found.told) or 'nothing'}"])


def picture(rows: Sequence[Row], path: Path) -> None:
    """Pressure, true and found, of every press."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(r.sensor for r in rows))
    fig = Figure(figsize=(2.6 * len(PRESSES), 2.3 * (1 + len(names))), layout="constrained")
    panels = fig.subplots(1 + len(names), len(PRESSES), sharex=True, sharey=True, squeeze=False)
    for column, press in enumerate(PRESSES):
        own = [r for r in rows if r.press == press]
        top = -1e-3 * float(own[0].truth[:, 2].min())
        for ax, (title, pressure, r) in zip(panels[:, column], [
            (f"{press}, true", -own[0].truth[:, 2], own[0]), *((r.sensor, r.found.pressure(), r) for r in own)
        ], strict=True):  # fmt: skip
            x, y = 1e3 * r.found.nodes[:, :2].T
            image = ax.tripcolor(x, y, 1e-3 * pressure, cmap="RdBu_r", vmin=-top, vmax=top, shading="gouraud",
                                 rasterized=True)  # fmt: skip
            ax.set_title(title, fontsize=9)
            ax.set_aspect("equal")
        fig.colorbar(image, ax=panels[:, column], shrink=0.4, location="bottom").set_label("pressure (kPa)")
    fig.supxlabel("x (mm)")
    fig.supylabel("y (mm)")
    fig.savefig(path, dpi=110)


def main() -> None:
    """Print both tables and save the picture."""
    rows = maps(pad())
    print(show(rows), end="\n\n")
    found = in_situ()
    print(show_material(found), end="\n\n")
    for name, gel in (("declared", pad(**DECLARED)), ("found", found.pad)):
        print(f"maps on the pad as {name}:", show(maps(gel, ("and depth",))), sep="\n")
    picture(rows, Path("foreign_gel.png"))
    print("\npicture: foreign_gel.png")


if __name__ == "__main__":
    main()
