"""GelSlim after Ma et al.: contact forces by one product F = K U, their resultants, and what those do not show.

After D. Ma, E. Donlon, S. Dong & A. Rodriguez, "Dense tactile force estimation using GelSlim and inverse FEM", IEEE
ICRA (2019), arXiv:1810.04621.

*What the paper reports, as far as it is known here* (abstract and second-hand): a single layer of eight-node bricks,
E = 147 MPa (read as 0.147), nu = 0.3223; push and slide on a sphere against an ATI Gamma sensor; standard deviations of
the resultant force of (0.244, 0.201, 0.322) N, about 15 %, which its authors call a partial validation.

*What was rebuilt*: a pad of 20 x 16 x 3 mm with the paper's material and elements of 1 mm, 520 markers with 5 um of
noise. The motion is that of an exact bonded layer under Hertz pressures, each of which leaves the shape of one sphere
of 8 mm radius to within some micrometres; the sphere completes the normal motion, as in the paper. Optics, large
strain, rate and the noise of a real force sensor are left out: the paper's numbers stand beside as a scale, not as a
contest. The exact layer has no edges and the pad has, which takes some 9 % of Fx (`ifem2` prints it over the width).

*What is measured here*: (1) the single layer on its own data, with and without noise, the same mesh on both sides;
(2) the model trap: several layers inverted with one give the resultant within 1 % and a map that is wrong by half;
(3) push and slide, force and torque against the simulated force/torque truth: with a measured normal motion the single
layer agrees in every frame while its map is off by half, so that a resultant alone is a partial validation. Where the
force of one press is, `one_press` shows.

Run ``python -m case_studies.gelslim``: prints the tables and saves ``gelslim.png``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loadid.validate import ReferenceWrench, Validation, validate
from tactile import DepthMap, ForceMap, GelSlim, Layer, Markers, Press, Sphere, metrics

from .pads import NU, PITCH, SIZE, THICKNESS, E, Rule, off, pad, patch, rules

PAPER = (0.244, 0.201, 0.322)  # N, std of Fx, Fy, Fz against an ATI Gamma
SPHERE = 8e-3
NOISE, DEPTH_NOISE = 5e-6, 10e-6
F_T = (0.02, 0.02, 0.02, 1e-4, 1e-4, 1e-4)  # N and N m: what a small force/torque sensor resolves
Array = NDArray[np.float64]


# -- the single layer on its own data ----------------------------------------------------------------------------------
@dataclass(frozen=True)
class Exact:
    """The single layer without noise: mm, mm/N, N."""

    deepest: float
    largest: float
    smallest: float
    error: float
    reactions: Array
    moved_outside: float

    @property
    def kappa(self) -> float:
        """Condition number of the compliance."""
        return self.largest / self.smallest


def single_layer() -> Exact:
    """Compliance, F = K U by the sensor, reactions apart, and the motion where there is no force."""
    gel = pad()
    f = patch(gel)
    u = gel.displacements(f)
    s = np.linalg.svd(gel.compliance, compute_uv=False)
    force = GelSlim(gel, Markers(gel.nodes2d, NOISE, "XYZ"), interpolation="linear").estimate(u)
    size, r = np.linalg.norm(u, axis=1), np.linalg.norm(gel.nodes2d, axis=1)
    return Exact(
        float(1e3 * np.abs(u[:, 2]).max()), float(1e3 * s[0]), float(1e3 * s[-1]),
        off(force.load, f.ravel()), gel.reactions(f).sum(axis=0), float(size[r > 4e-3].max() / size.max()),
    )  # fmt: skip


def noisy_layer(noise: Sequence[float] = (5e-6, 20e-6), draws: int = 20) -> list[dict[str, Rule]]:
    """The single layer on its own data with noise."""
    gel = pad()
    f = patch(gel)
    return rules(gel.compliance, gel.displacements(f).ravel(), f.ravel(), noise, draws)


# -- the model trap ----------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Trap:
    """Data of several layers inverted with one; N, share of the truth."""

    layers: int
    force: Array
    map: float
    validation: Validation


def trap(layers: Sequence[int] = (2, 4, 6)) -> list[Trap]:
    """F = K U of one layer on the motion of several; held against the resultant alone, as a force sensor would."""
    one, rows = pad(), []
    sensor = GelSlim(one, Markers(one.nodes2d, NOISE, "XYZ"), interpolation="linear")
    for n in layers:
        several = pad(n)
        f = patch(several)
        force = sensor.estimate(several.displacements(f))
        known = ReferenceWrench(
            several.resultant(f)[:3], std=F_T[:3], labels=("Fx", "Fy", "Fz"), source="simulated force sensor"
        )
        checked = validate(force, known)
        rows.append(Trap(n, force.resultant().value, off(force.load, f.ravel()), checked))
    return rows


# -- push and slide on a sphere ----------------------------------------------------------------------------------------
LAYER = Layer(THICKNESS, E, NU)


def on_sphere(radius: float, at: tuple[float, float], friction: tuple[float, float]) -> tuple[Press, Sphere, float]:
    """A press that leaves the shape of the sphere on the layer: its contact radius gives force and depth.

    Returns
    -------
    Press, Sphere, float
        And by how much (m) the surface in contact differs from the sphere.
    """
    r = np.linspace(0.0, radius, 31)
    per_newton = -Press(radius=radius, force=1.0).displacement(LAYER, np.column_stack([r, 0 * r]))[:, 2]
    cap = SPHERE - np.sqrt(SPHERE**2 - r**2)
    force = cap[-1] / (per_newton[0] - per_newton[-1])
    depth = float(force * per_newton[0])
    press = Press(at=at, radius=radius, force=float(force), shear=(friction[0] * force, friction[1] * force))
    return press, Sphere(radius=SPHERE, depth=depth, at=at), float(np.abs(depth - cap - force * per_newton).max())


def protocol(push: int = 10, slide: int = 14) -> list[tuple[Press, Sphere, float]]:
    """Contact radius from 1 to 3 mm, then shear up to 0.45 of the force while the contact travels 1.1 mm."""
    frames = [on_sphere(a, (1.5e-3, -1e-3), (0.0, 0.0)) for a in np.linspace(1e-3, 3e-3, push)]
    for s in np.linspace(0, 1, slide + 1)[1:]:
        frames.append(on_sphere(3e-3, (1.5e-3 + s * 1e-3, -1e-3 + s * 5e-4), (0.4 * s, 0.2 * s)))
    return frames


def markers(seed: int = 0) -> Array:
    """520 markers, not quite on a grid (m)."""
    x, y = np.meshgrid(np.linspace(-9.7e-3, 9.7e-3, 26), np.linspace(-7.7e-3, 7.7e-3, 20))
    jitter = np.random.default_rng(seed).uniform(-0.15e-3, 0.15e-3, (x.size, 2))
    return np.column_stack([x.ravel(), y.ravel()]) + jitter


def depth_map(press: Press, seed: int) -> DepthMap:
    """Normal motion measured by a second source, 0.1 mm pixels."""
    y, x = ((np.arange(round(side / 1e-4)) - (round(side / 1e-4) - 1) / 2) * 1e-4 for side in SIZE[::-1])
    places = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    z = press.displacement(LAYER, places)[:, 2].reshape(len(y), len(x))
    return DepthMap(z + DEPTH_NOISE * np.random.default_rng(seed).standard_normal(z.shape), 1e-4, DEPTH_NOISE)


@dataclass(frozen=True, eq=False)
class Slide:
    """One sensor over all frames.

    Parameters
    ----------
    sensor : str
    found : array (frames, 6)
        Force (N) and torque about the centre of the surface (N m).
    errors : ResultantErrors
        Against the truth.
    map, cosine : float
        Relative L2 error and cosine of the tractions, medians over the slide.
    validations : tuple of Validation
        Of every frame, by its resultant.
    last : ForceMap
    """

    sensor: str
    found: Array
    errors: metrics.ResultantErrors
    map: float
    cosine: float
    validations: tuple[Validation, ...]
    last: ForceMap


@dataclass(frozen=True, eq=False)
class Run:
    """Push and slide: true force and torque (frames, 6), true tractions of the last frame, the sensors."""

    true: Array
    tractions: Array
    misfit: float
    push: int
    rows: tuple[Slide, ...]


def push_and_slide(push: int = 10, slide: int = 14) -> Run:
    """Force and torque of every frame against the simulated truth, for one layer and four, sphere and depth map."""
    frames, places = protocol(push, slide), markers()
    presses = [p for p, _, _ in frames]
    motion = [
        p.displacement(LAYER, places)[:, :2] + NOISE * np.random.default_rng(i).standard_normal((len(places), 2))
        for i, p in enumerate(presses)
    ]
    depths = [depth_map(p, 1000 + i) for i, p in enumerate(presses)]
    true, rows = np.array([[*p.vector, *p.resultant()[3:]] for p in presses]), []
    for name, gel in (("1 standard layer", pad()), ("4 B-bar layers", pad(4, "bbar"))):
        cases = metrics.cases(presses, LAYER, places[:1], gel.nodes2d, pitch=PITCH)
        for source in ("sphere", "depth map"):
            measured = source == "depth map"
            sensor = GelSlim(gel, Markers(places, NOISE), depth=depths[0] if measured else None)
            maps = [
                sensor.estimate(u, depth) if measured else sensor.estimate(u, indenter=ball)
                for u, (_, ball, _), depth in zip(motion, frames, depths, strict=True)
            ]
            rows.append(_judge(f"{name}, {source}", maps, true, [c.tractions for c in cases], push))
    return Run(true, cases[-1].tractions, max(m for _, _, m in frames), push, tuple(rows))


def _judge(name: str, maps: list[ForceMap], true: Array, tractions: list[Array], push: int) -> Slide:
    """Resultants of all frames, maps of the slide."""
    found = np.array([np.r_[m.resultant().value, m.torque().value] for m in maps])
    held = [
        validate(m, ReferenceWrench(w, std=F_T, source="simulated force/torque"))
        for m, w in zip(maps, true, strict=True)
    ]
    areas = maps[0].areas
    judged = [
        metrics.compare(m.forces() / areas[:, None], t, areas=areas)
        for m, t in zip(maps[push:], tractions[push:], strict=True)
    ]
    middle = np.median([(j.error, j.cosine) for j in judged], axis=0)
    errors = metrics.resultant_errors(found, true)
    return Slide(name, found, errors, float(middle[0]), float(middle[1]), tuple(held), maps[-1])


# -- words and picture -------------------------------------------------------------------------------------------------
def show_layer(exact: Exact, noisy: list[dict[str, Rule]], noise: Sequence[float] = (5e-6, 20e-6)) -> str:
    """The single layer on its own data."""
    x, _, z = exact.reactions
    lines = [
        "single standard layer on its own data (the same mesh on both sides: optimistic)",
        f"  deepest {exact.deepest:.3f} mm; singular values {exact.largest:.1f} to {exact.smallest:.2f} mm/N",
        f"  condition number {exact.kappa:.1f}",
        f"  F = K U without noise: error {exact.error:.0e}; reactions of the base: {x:+.4f} N in x, {z:+.4f} N in z",
        f"  motion beyond 4 mm, where there is no force: {exact.moved_outside:.2f} of the largest",
        "  with noise: map error (error of Fz, peak ratio), medians of 20 draws",
    ]
    for level, row in zip(noise, noisy, strict=True):
        edge = "; gcv at the edge of its sweep" if row["gcv"].edge else ""
        lines.append(f"  {1e6 * level:.0f} um: " + ", ".join(f"{k} {v}" for k, v in row.items()) + edge)
    return "\n".join(lines)


def show_trap(rows: list[Trap]) -> str:
    """Data of several layers inverted with one."""
    lines = ["model trap: data of several layers inverted with one, no noise"]
    for r in rows:
        lines += [
            f"  {r.layers} layers: Fx {r.force[0]:.3f} of 0.5 N, Fz {r.force[2]:.3f} of -2 N, map error {r.map:.2f}",
            f"    {r.validation}",
        ]
    return "\n".join(lines)


def show_run(run: Run) -> str:
    """Std per axis beside the paper's, and what the maps are worth."""
    size, misfit = np.abs(run.true[:, 2]).max(), 1e6 * run.misfit
    lines = [
        f"push and slide on a sphere, {len(run.true)} frames to {size:.2f} N, simulated (a sphere to {misfit:.0f} um)",
        f"  {'std about the bias':28s}      Fx      Fy      Fz N       Mx      My      Mz N mm  bias Fz    map  cosine",
    ]
    for r in run.rows:
        s, partial = r.errors.std, ", partial" if all(v.partial for v in r.validations) else ""
        force, torque = (" ".join(f"{v:7.3f}" for v in part) for part in (s[:3], [1e3 * v for v in s[3:]]))
        lines += [
            f"  {r.sensor:28s} {force}    {torque}       {r.errors.bias[2]:+6.3f}  {r.map:5.3f}   {r.cosine:5.3f}",
            f"    level: {r.validations[-1].level}{partial}; agrees in {sum(v.agrees for v in r.validations)} frames",
        ]
    paper = " ".join(f"{v:7.3f}" for v in PAPER)
    lines.append(
        f"  {'Ma et al., real, ATI Gamma':28s} {paper}    resultants alone, by its authors a partial validation"
    )
    return "\n".join(lines)


def picture(run: Run, path: Path) -> None:
    """Resultants over the frames, and pressure along x through the contact of the last frame."""
    from matplotlib.figure import Figure

    fig = Figure(figsize=(12, 4.2), layout="constrained")
    force, torque, cut = fig.subplots(1, 3)
    k = np.arange(1, len(run.true) + 1)
    shown = ((run.rows[0], "#D55E00"), (run.rows[3], "#0072B2"))
    for ax, axes, scale, label in ((force, (0, 1, 2), 1.0, "force (N)"), (torque, (3, 4, 5), 1e3, "torque (N mm)")):
        for i in axes:
            ax.plot(
                k, scale * run.true[:, i], color="#222222", lw=1.2, ls="--", label="truth" if i == axes[0] else None
            )
            for row, colour in shown:
                ax.plot(k, scale * row.found[:, i], color=colour, lw=1.4, label=row.sensor if i == axes[0] else None)
            ax.annotate(run.rows[0].errors.labels[i], (k[-1], scale * run.true[-1, i]), (4, -3),
                        textcoords="offset points", fontsize=9)  # fmt: skip
        ax.set_xlim(right=k[-1] + 3)
        ax.set_xlabel("frame: push, then slide")
        ax.set_ylabel(label)
    nodes, areas = run.rows[0].last.nodes, run.rows[0].last.areas
    line = np.abs(nodes[:, 1] - nodes[np.argmax(-run.tractions[:, 2]), 1]) < 1e-6
    x = 1e3 * nodes[line, 0]
    cut.plot(x, -1e-3 * run.tractions[line, 2], color="#222222", lw=1.2, ls="--", label="truth")
    for row, colour in shown:
        pressure = -row.last.forces()[line, 2] / areas[line]
        cut.plot(x, 1e-3 * pressure, color=colour, lw=1.4, label=f"{row.sensor}: map {row.map:.0%} off")
    cut.set_xlabel("x through the contact, last frame (mm)")
    cut.set_ylabel("mean pressure about a node (kPa)")
    cut.set_ylim(top=1.35 * cut.get_ylim()[1])
    force.legend(fontsize=8, loc="center right")
    cut.legend(fontsize=8, loc="upper left")
    fig.savefig(path, dpi=130)


def main() -> None:
    """Print the tables and save the picture."""
    print(show_layer(single_layer(), noisy_layer()))
    print("\n" + show_trap(trap()))
    run = push_and_slide()
    print("\n" + show_run(run))
    picture(run, Path("gelslim.png"))
    print("\npicture: gelslim.png")


if __name__ == "__main__":
    main()
