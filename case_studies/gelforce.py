"""Two layers of markers under a grid of forces: what their depth costs, and what the half-space costs on a bonded pad.

After K. Kamiyama, K. Vlack, T. Mizota, H. Kajimoto, N. Kawakami & S. Tachi, "Vision-based sensor for real-time
measuring of surface traction fields", IEEE Computer Graphics and Applications 25 (2005) 68-75. What is known of it
here: a transparent elastic body, markers of two colours at two depths, one camera, forces by the kernels of Boussinesq
and Cerruti. Pitch, depths and errors of the published sensor are not, so no figure of theirs stands beside ours.

Rebuilt: E = 0.147 MPa, nu = 0.49; 11 x 11 forces at a pitch of 2 mm; markers under the same places at two depths; a
force of (0.3, 0, 1) N in the middle and of (0, 0, 0.5) N beside it, pressing; 5 um of noise on each component, and the
in-plane components alone beside. Data and inversion share the half-space, so this first table shows what depth does to
noise, and nothing else. The last one is what a bonded pad makes of the half-space: data from the kernels of the layer
under a Hertz press, which lies on no grid, inverted with the half-space and with the layer (nu = 0.3223, 15 x 15 forces
at 1 mm, markers 1 and 2 mm deep, 2 um). The pseudo-inverse is that of the publication; for the press lambda is chosen.

Measured here: depth over the pitch of the forces decides everything. On a bonded pad the half-space loses the resultant
long before it loses the map: its displacements reach further than those of the pad, and forces that pull at the rim of
the grid make up for it. No figure of a real sensor is among these.

Run ``python -m case_studies.gelforce``: prints the tables and saves ``gelforce.png``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import NotIdentifiable
from tactile import Extent, GelForce, HalfSpace, Layer, Markers, Press, metrics

E, NU, NOISE = 0.147e6, 0.49, 5e-6
COUNT, PITCH = 11, 2e-3
DEPTHS = ((0.5e-3, 1e-3), (1e-3, 2e-3), (2e-3, 4e-3), (3e-3, 6e-3))
CASES = (
    (55.3, 0.036, 0.035, 0.035),
    (400, 0.19, 0.132, 0.136),
    (5.9e3, 1.24, 0.304, 0.307),
    (5.3e4, 9.8, 0.504, 0.510),
)
RATIOS = (0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0)
GEL, FINER, SIDE, DEEP, QUIET = 0.3223, 1e-3, 15, (1e-3, 2e-3), 2e-6  # of the press on a bonded pad
PRESS = Press(at=(0.3e-3, -0.4e-3), radius=2e-3, force=1.0, shear=(0.25, 0.0))
THIN = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0)
Array = NDArray[np.float64]


def grid(count: int = COUNT, pitch: float = PITCH) -> Array:
    """Places of the forces (count^2, 2), one row along x after the other, the middle one at the origin."""
    x = (np.arange(count) - count // 2) * pitch
    return np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)


def sensor(
    ground: Any, places: Array, depths: Sequence[float], *, noise: float, axes: str = "XYZ", **settings: Any
) -> GelForce:
    """A sensor with markers under its forces, at two depths."""
    under = np.concatenate([np.column_stack([places, np.full(len(places), ground.top - d)]) for d in depths])
    return GelForce(ground, places, Markers(under, noise, axes), **settings)


# -- what depth costs -----------------------------------------------------------------------------------------------
def two_forces() -> Array:
    """The forces on the pad (121, 3): one presses and goes sideways, its neighbour presses."""
    f = np.zeros((COUNT**2, 3))
    middle = COUNT**2 // 2
    f[middle], f[middle + 1] = (0.3, 0.0, -1.0), (0.0, 0.0, -0.5)
    return f


@dataclass(frozen=True)
class Depth:
    """One pair of depths (m): relative errors of the forces, medians over draws of the noise.

    Parameters
    ----------
    kappa : float
        Condition number.
    clean, plain : float
        Pseudo-inverse without and with noise.
    expected : float
        The error that the sensor predicts for it.
    warned : bool
        W304: above 30 %.
    oracle, gcv, discrepancy : float
        Tikhonov with the best lambda of each draw, and with those of two rules.
    force : float
        Relative error of Fz with GCV.
    in_plane : (float, float)
        Condition number and expected error without the normal components.
    """

    depths: tuple[float, float]
    kappa: float
    clean: float
    plain: float
    expected: float
    warned: bool
    oracle: float
    gcv: float
    discrepancy: float
    force: float
    in_plane: tuple[float, float]


def depth(depths: tuple[float, float], seeds: int = 20) -> Depth:
    """All ways of inverting one pair of depths."""
    body, truth = HalfSpace(E=E, nu=NU), two_forces().ravel()
    fixed, free, flat = (
        sensor(body, grid(), depths, noise=NOISE, **s) for s in ({"choice": 0}, {"choice": "gcv"}, {"axes": "XY"})
    )
    u = fixed.model.H @ truth
    best = [fixed.at(lam) for lam in np.geomspace(3e-4, 0.03, 15)]
    found = []
    for seed in range(seeds):
        y = u + NOISE * np.random.default_rng(seed).standard_normal(u.shape)
        estimate = free.estimate(y.reshape(-1, 3))
        rules = {r.rule: r.lam for r in estimate.choice.rules}
        loads = fixed.estimate(y.reshape(-1, 3)).load, estimate.load, fixed.at(rules["discrepancy"])(y).load
        oracle = min(_error(inverse(y).load, truth) for inverse in best)
        force = abs(estimate.resultant().value[2] / truth[2::3].sum() - 1)
        found.append((*(_error(load, truth) for load in loads), oracle, force))
    plain, gcv, discrepancy, oracle, force = (float(v) for v in np.median(found, axis=0))
    return Depth(
        depths=depths, kappa=fixed.condition, clean=_error(fixed.estimate(u.reshape(-1, 3)).load, truth), plain=plain,
        expected=fixed.expected_error(truth), warned=fixed.flagged(truth) is not None, oracle=oracle, gcv=gcv,
        discrepancy=discrepancy, force=force, in_plane=(flat.condition, flat.expected_error(truth)),
    )  # fmt: skip


def _error(load: Array, truth: Array) -> float:
    return float(np.linalg.norm(load - truth) / np.linalg.norm(truth))


# -- what the half-space costs --------------------------------------------------------------------------------------
def softness(nu: float, ratios: Sequence[float] = RATIOS) -> Array:
    """Centre depth of a bonded layer over that of a half-space, under a Hertz press of each radius over thickness."""
    layer, middle = Layer(h=3e-3, E=E, nu=nu), [[0.0, 0.0]]
    both = [
        [Press(radius=r * layer.h).displacement(ground, middle)[0, 2] for ground in (layer, layer.half_space)]
        for r in ratios
    ]
    return np.array([a / b for a, b in both])


@dataclass(frozen=True)
class Reading:
    """What a sensor makes of a press on a bonded pad, over what it is: resultant, force in the contact, and the map."""

    ground: str
    ratio: float
    shear: float
    force: float
    inside: float
    error: float
    peak: float
    flags: tuple[str, ...]


def bonded(ratio: float, side: int = SIDE, seed: int = 0) -> tuple[Reading, Reading]:
    """The press on a pad of radius / `ratio` thickness, read with the half-space and with the layer."""
    layer, places = Layer(h=PRESS.radius / ratio, E=E, nu=GEL), grid(side, FINER)
    truth = metrics.means(PRESS, places, FINER, shape="patch")
    near = np.hypot(*(places - PRESS.at).T) < 1.5 * PRESS.radius
    found = []
    for name, ground in (("half-space", layer.half_space), ("layer", layer)):
        extent = Extent(layer.h, PRESS.radius)
        one = sensor(ground, places, DEEP, noise=QUIET, allow=("E602",), extent=extent)
        at = one.markers.points + np.array([0.0, 0.0, layer.h - ground.top])
        u = PRESS.displacement(layer, at)
        estimate = one.estimate(u + QUIET * np.random.default_rng(seed).standard_normal(u.shape))
        areas = estimate.areas
        m = metrics.compare(estimate.traction(), truth, areas=areas, points=places)
        x, _, z = estimate.resultant().value / np.where(PRESS.vector, PRESS.vector, 1.0)
        inside = float(estimate.forces()[near, 2].sum() / PRESS.vector[2])
        flags = tuple(sorted({f.code.removeprefix("LID-") for f in one.model.flags}))
        found.append(Reading(name, ratio, float(x), float(z), inside, m.error, m.peak_ratio, flags))  # type: ignore[arg-type]
    return found[0], found[1]


def refused(ratio: float, size: float | None = None) -> str:
    """What the sensor on a half-space says of a contact of that radius over thickness, in a pad of that size."""
    extent = Extent(1e-3 / ratio, 1e-3, None if size is None else (size, size))
    try:
        one = sensor(HalfSpace(E=E, nu=GEL), grid(5), DEPTHS[0], noise=NOISE, extent=extent)
    except NotIdentifiable as caught:
        return f"refused, {caught}"
    found = list(one.model.flags)
    if size is not None:  # how near an edge is, is a matter of the contact
        press = np.zeros(one.model.H.shape[1])
        press[-1] = -1.0  # at the corner of the grid
        found = [f for f in one.estimate((one.model.H @ press).reshape(-1, 3)).flags if f.code == "LID-W601"]
    return "; ".join(str(f) for f in found) or "nothing"


# -- showing ----------------------------------------------------------------------------------------------------------
def show(depths: Sequence[Depth], readings: Sequence[Reading]) -> str:
    """The tables."""
    names = (
        (10, "depths mm"),
        (16, "kappa"),
        (8, "no noise"),
        (13, "pinv"),
        (9, "expected"),
        (13, "oracle"),
        (13, "gcv"),
    )
    last = (11, "discrepancy"), (8, "Fz, gcv"), (26, "in-plane: kappa, expected")
    lines = [
        "relative error of the forces on a half-space, 5 um; in brackets the figures of the reference case",
        "  " + " ".join(name.rjust(width) for width, name in (*names, *last)),
    ]
    for d, known in zip(depths, CASES, strict=False):
        lines.append(
            f"  {1e3 * d.depths[0]:g}, {1e3 * d.depths[1]:g}".ljust(12)
            + f" {d.kappa:8.3g} ({known[0]:.3g})".ljust(18)
            + f" {d.clean:7.0e} {d.plain:6.3g} ({known[1]:g}) {d.expected:6.3g}{' !' if d.warned else '  '}"
            + f" {d.oracle:7.3f} ({known[2]:g}) {d.gcv:6.3f} ({known[3]:g}) {d.discrepancy:11.3f} {d.force:8.2%}"
            + f" {d.in_plane[0]:14.3g}, {d.in_plane[1]:.3g}"
        )
    lines += ["  !: W304, noise alone makes more than 30 %", "", "centre depth, bonded layer over half-space (Hertz)"]
    lines.append("  a/t   " + "".join(f"{r:8g}" for r in RATIOS))
    lines += [f"  nu {nu:<6g}" + "".join(f"{v:8.3f}" for v in softness(nu))[1:] for nu in (0.3223, 0.45, 0.49)]
    lines += ["", f"{1e3 * PRESS.radius:g} mm press on a bonded pad (nu = {GEL:g}), found over true; grid 14 mm wide"]
    lines.append(
        f"  {'a/t':>5s} {'read with':>11s} {'Fx':>6s} {'Fz':>6s} {'Fz inside':>9s} {'map err':>8s} {'peak':>6s}"
    )
    lines += [
        f"  {r.ratio:5g} {r.ground:>11s} {r.shear:6.2f} {r.force:6.2f} {r.inside:9.2f} {r.error:8.3f} {r.peak:6.2f}"
        f"  {' '.join(r.flags)}"
        for r in readings
    ]
    lines += ["", "guards: contact radius over thickness of a half-space, and a pad of 12 mm about a grid of 8 mm"]
    lines += [f"  a/t {r:g}: {refused(r)}" for r in (0.05, 0.2, 0.5)]
    return "\n".join([*lines, f"  edge: {refused(0.05, 24e-3)}"])


def figure(depths: Sequence[Depth], readings: Sequence[Reading], path: Path) -> None:
    """Error against depth, softness against a/t, and what becomes of a press on a bonded pad."""
    from matplotlib.figure import Figure

    blue, orange, green, purple, grey = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#8a8a8a"
    fig = Figure(figsize=(12.5, 4.2), layout="constrained")
    left, middle, right = fig.subplots(1, 3)
    x = [d.depths[0] / PITCH for d in depths]
    for name, color, style in (
        ("plain", orange, "o-"), ("expected", grey, "--"), ("oracle", green, "^-"), ("gcv", blue, "s:"),
    ):  # fmt: skip
        label = {"plain": "pseudo-inverse", "expected": "predicted for it", "gcv": "GCV"}.get(name, "best lambda")
        left.loglog(x, [getattr(d, name) for d in depths], style, color=color, label=label)
    left.set_xticks(x, [f"{v:g}" for v in x])
    left.minorticks_off()
    left.axhline(0.3, color=grey, lw=0.8)
    left.text(x[-1], 0.26, "W304 above", fontsize=8, color=grey, ha="right", va="top")
    left.set_xlabel("depth of the upper markers / pitch of the forces")
    left.set_title("relative error of the forces, 5 µm of noise", fontsize=10, loc="left")
    for nu, color in ((0.3223, blue), (0.45, green), (0.49, orange)):
        middle.plot(RATIOS, softness(nu), "o-", ms=4, color=color, label=f"ν = {nu:g}")
    for at, word in ((0.1, "W601"), (0.3, "E602")):
        middle.axvline(at, color=grey, lw=0.8)
        middle.text(at + 0.02, 0.03, word, fontsize=8, color=grey)
    middle.set(xlim=(0, 2.05), ylim=(0, 1), xlabel="contact radius / thickness")
    middle.set_title("centre depth: bonded layer / half-space", fontsize=10, loc="left")
    for ground, style in (("half-space", "-"), ("layer", "--")):
        own = [r for r in readings if r.ground == ground]
        for name, color, label in (
            ("force", orange, "Fz"),
            ("inside", blue, "Fz in the contact"),
            ("shear", purple, "Fx"),
        ):
            right.plot([r.ratio for r in own], [getattr(r, name) for r in own], style, marker="o", ms=4, color=color,
                       label=label if ground == "half-space" else None)  # fmt: skip
    right.plot([], [], "--", color=grey, label="read with the layer")
    right.set(xscale="log", xlabel="contact radius / thickness", ylim=(0, 1.1))
    right.set_xticks(THIN, [f"{t:g}" for t in THIN])
    right.minorticks_off()
    right.set_title("press on a bonded pad: found / true", fontsize=10, loc="left")
    for ax in (left, middle, right):
        ax.legend(fontsize=8, frameon=False)
        ax.grid(alpha=0.25)
    fig.savefig(path, dpi=130)


def main() -> None:
    """Print the tables and save the picture."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    depths = [depth(d, seeds) for d in DEPTHS]
    readings = [r for ratio in THIN for r in bonded(ratio)]
    print(show(depths, readings))
    figure(depths, readings, Path("gelforce.png"))
    print("\npicture: gelforce.png")


if __name__ == "__main__":
    main()
