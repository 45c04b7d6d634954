"""Three ways from marker motion to a force map, on the same presses: point forces, inverse finite elements, ridge.

* GelForce (after Kamiyama et al. 2005): point forces at 1 mm, markers at two depths, kernels of a half-space as
  published, and of the bonded layer.
* GelSlim (after Ma et al. 2019): F = K U on one layer of standard bricks, in-plane markers, normal motion measured.
* Multilayer pad (in the style of Zhao, Liu & Ma 2025, whose formulas are not reproduced): four layers of B-bar bricks,
  ridge on the tractions; also without pulling.

Where there is a lambda it is chosen over calibration presses, by the rule that force maps take unless told otherwise.

None of the three papers reports these presses; everything here is rebuilt, and no figure of theirs is compared. The gel
is 28 x 28 x 3 mm, of which 20 x 20 mm are seen and may be loaded; E = 0.147 MPa, nu = 0.3223. The truth comes from the
kernels of the bonded layer, never from a mesh: Hertz presses of a/t = 0.1, 0.5 and 1 with one peak pressure (53 kPa;
0.01, 0.25 and 1 N) and a quarter of the force along x. 2 um of noise on every marker; a depth map with 10 um of noise
per pixel of 0.2 mm. What each route sees is what it was made for, and differs: GelSlim and the multilayer pad see 361
markers on the surface, in the plane, and the depth map; GelForce sees 722 markers in the body, 0.5 and 1 mm under the
surface, in the plane, and in a further line their normal motion to 10 um; no depth map. All maps are on a grid of 1 mm
and are held against the truth as such a grid can hold it: nodal force over area. Linear elasticity is the truth here;
at this pressure a real gel is strained by a quarter, beyond its range.

Measured here, at a/t = 0.5 and 1: one layer gets the resultant within 2 % (a resultant alone would pass it) and a map
that is wrong by more than half; four layers get both, the map within 5 % at a/t = 1 and 10 % at 0.5. The half-space
finds place and shape of the contact, and a tenth of its force. In-plane motion at two depths under a bonded layer tells
shear to a per cent, and loses two thirds of the normal force to the prior; with the normal motion of each marker to
10 um four fifths are found. At a/t = 0.1 the contact is smaller than a cell and presses with 10 mN: its place and,
within the band, its force are what remains. Forbidding to pull sharpens the map there, and adds to the force the noise
that it rectifies, of which its std does not know.

Run ``python -m case_studies.three_routes``: prints the table and saves ``three_routes.png``.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile import (
    ContactLaw,
    DepthMap,
    ForceMap,
    GelForce,
    GelSlim,
    HalfSpace,
    Layer,
    Markers,
    MultilayerPad,
    Pad,
    Press,
    metrics,
)
from tactile import halfspace as closed

H, E, NU = 3e-3, 0.147e6, 0.3223
SIDE, SEEN, PITCH, DEPTHS = 28e-3, 20e-3, 1e-3, (0.5e-3, 1e-3)
MARKER, DEEP, PIXEL = 2e-6, 10e-6, 0.2e-3  # noise of a marker and of a pixel of depth, and the pixel (m)
RATIOS = (0.1, 0.5, 1.0)
GROUND = Layer(h=H, E=E, nu=NU)
Array = NDArray[np.float64]


def press(ratio: float) -> Press:
    """1 N at a/t = 1, the same peak pressure at any other; off the nodes."""
    force = ratio**2
    return Press(at=(0.2e-3, -0.3e-3), radius=ratio * H, force=force, shear=(force / 4, 0.0))


@dataclass(frozen=True, eq=False)
class Frame:
    """Everything that can be seen of a press: motion on the surface (N, 3), in the body (2 N, 3), and depth."""

    press: Press
    surface: Array
    body: Array
    depth: DepthMap


@dataclass(frozen=True, eq=False)
class Rig:
    """Markers on a square grid, and the sensors that read them.

    Parameters
    ----------
    side, seen : float
        Of the pad, and of the part of it that is seen and may be loaded (m).
    """

    side: float = SIDE
    seen: float = SEEN

    @property
    def places(self) -> Array:
        """Markers and point forces (N, 2): every millimetre of what is seen."""
        half = round(self.seen / PITCH) // 2 - 1
        x = np.arange(-half, half + 1) * PITCH
        return np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)

    @property
    def body(self) -> Array:
        """Markers in the body (2 N, 3)."""
        return np.concatenate([np.column_stack([self.places, np.full(len(self.places), H - d)]) for d in DEPTHS])

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Which points (n, 2) lie in the part that is seen."""
        return np.all(np.abs(points) < self.seen / 2, axis=1)

    def frame(self, load: Press, seed: int | None) -> Frame:
        """What a press does, with noise unless `seed` is None."""
        rng = np.random.default_rng(seed)
        scale = 0.0 if seed is None else 1.0
        count = 2 * round(self.side / PIXEL / 2) - 1  # odd: a pixel over every node
        x = (np.arange(count) - (count - 1) / 2) * PIXEL
        pixels = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
        noisy = lambda u, std: u + scale * std * rng.standard_normal(u.shape)  # noqa: E731
        return Frame(
            load,
            noisy(load.displacement(GROUND, self.places), MARKER),
            noisy(load.displacement(GROUND, self.body), np.array([MARKER, MARKER, DEEP])),
            DepthMap(noisy(load.displacement(GROUND, pixels)[:, 2], DEEP).reshape(count, count), PIXEL, DEEP),
        )


Reader = Callable[[Frame], ForceMap]


def routes(rig: Rig, known: Sequence[Frame]) -> dict[str, Reader]:
    """The sensors, each as a function of a frame; those with a lambda choose it once over known presses."""
    pad, single = (
        Pad(size=(rig.side, rig.side), thickness=H, E=E, nu=NU, pitch=PITCH, layers=n, element=e)
        for n, e in ((4, "bbar"), (1, "standard"))
    )
    slim = GelSlim(single, Markers(rig.places, MARKER), depth=known[0].depth)
    settings: dict[str, Any] = {"markers": Markers(rig.places, MARKER), "depth": known[0].depth}
    inside = rig.inside(pad.nodes2d)
    ridge = MultilayerPad(pad, penalty="identity", **settings, contact=ContactLaw(support=inside))
    lam = ridge.calibrate([f.surface[:, :2] for f in known], [f.depth for f in known]).lam
    held = MultilayerPad(
        pad, penalty="identity", choice=lam, **settings, contact=ContactLaw(no_pull=True, support=inside)
    )
    found = {
        f"GelForce, {name}": _point_forces(rig, known, ground, axes)
        for name, ground, axes in (
            ("half-space", GROUND.half_space, "XY"), ("layer", GROUND, "XY"), ("layer, z to 10 um", GROUND, "XYZ"),
        )
    }  # fmt: skip
    return {
        **found,
        "GelSlim, one layer": lambda f: slim.estimate(f.surface[:, :2], f.depth),
        "multilayer, ridge": lambda f: ridge.estimate(f.surface[:, :2], f.depth),
        "multilayer, no pulling": lambda f: held.estimate(f.surface[:, :2], f.depth),
    }


def _point_forces(rig: Rig, known: Sequence[Frame], ground: Layer | HalfSpace, axes: str) -> Reader:
    """GelForce on a ground, with lambda by the discrepancy over the known presses."""
    under = rig.body - [0.0, 0.0, H - ground.top]
    noise = np.array([MARKER, MARKER, DEEP])[: len(axes)]
    sensor = GelForce(ground, rig.places, Markers(under, noise, axes), choice="discrepancy")
    sensor.calibrate([f.body[:, : len(axes)] for f in known])
    return lambda f: sensor.estimate(f.body[:, : len(axes)])


@dataclass(frozen=True, eq=False)
class Line:
    """One route on one press: medians over the draws of noise.

    Parameters
    ----------
    route : str
    ratio : float
        a/t.
    force, std : array (3,)
        Resultant found, and the std that the route claims (N).
    error, cosine, peak, iou : float
        Of the map against the truth on its own grid, see `tactile.metrics`.
    bias : float
        Error of the map without noise: that of the model and of lambda.
    radius : float
        Of the contact (m), NaN where none is clear of the noise.
    time : float
        CPU seconds for a frame.
    flags : tuple of str
    found, truth : array (P, 3)
        Nodal force over area (Pa) at `points`, of the first draw.
    points : array (P, 2)
    """

    route: str
    ratio: float
    force: Array
    std: Array
    error: float
    cosine: float
    peak: float
    iou: float
    bias: float
    radius: float
    time: float
    flags: tuple[str, ...]
    found: Array
    truth: Array
    points: Array


def line(name: str, read: Reader, rig: Rig, load: Press, draws: int) -> Line:
    """A route on a press: with noise, and without."""
    frames = [rig.frame(load, seed) for seed in (None, *range(draws))]
    still, *found = [read(f) for f in frames]
    spent = [_timed(read, f) for f in frames[1:]]
    here = rig.inside(still.nodes[:, :2])
    points, areas = still.nodes[here, :2], still.areas[here]
    truth = metrics.means(load, points, PITCH, shape="patch" if name.startswith("GelForce") else "hat")
    # nodal force over area on both sides: what a press and an estimate mean alike, whatever runs between the nodes
    maps = [e.forces()[here] / areas[:, None] for e in (still, *found)]
    clean, *held = [metrics.compare(t, truth, areas=areas, points=points) for t in maps]
    contacts = [e.contact() for e in found]
    values = [(m.error, m.cosine, m.peak_ratio, m.iou, c.radius) for m, c in zip(held, contacts, strict=True)]
    error, cosine, peak, iou, radius = (float(v) for v in np.median(np.array(values, float), axis=0))
    seen = sum(c.mask.any() for c in contacts) > draws / 2
    force, std = (np.median([getattr(e.resultant(), part) for e in found], axis=0) for part in ("value", "std"))
    assert clean.error is not None
    return Line(
        route=name, ratio=load.radius / H, force=force, std=std, error=error, cosine=cosine, peak=peak, iou=iou,
        bias=clean.error, radius=radius if seen else np.nan, time=float(np.median(spent)),
        flags=_codes(name, load, found), found=maps[1], truth=truth, points=points,
    )  # fmt: skip


def _timed(read: Reader, frame: Frame) -> float:
    start = time.process_time()
    read(frame)
    return time.process_time() - start


def _codes(name: str, load: Press, found: Sequence[ForceMap]) -> tuple[str, ...]:
    """Flags of most draws, and what the guard of the half-space says of this contact."""
    each = [{f.code.removeprefix("LID-") for f in e.flags} for e in found]
    own = {c for c in set().union(*each) if sum(c in codes for codes in each) > len(each) / 2}
    thin = closed.thin_pad(load.radius, H, NU, allow=("E602",)) if "half-space" in name else None
    return tuple(sorted(own if thin is None else own | {thin.code.removeprefix("LID-")}))


def table(rig: Rig | None = None, ratios: Sequence[float] = RATIOS, draws: int = 9) -> list[Line]:
    """All routes on all presses; lambda is chosen over the two larger presses, in frames of their own."""
    rig = Rig() if rig is None else rig
    known = [rig.frame(press(r), 100 + i) for i, r in enumerate(ratios) if r >= 0.5]
    found = routes(rig, known)
    return [line(name, read, rig, press(r), draws) for r in ratios for name, read in found.items()]


def show(lines: Sequence[Line]) -> str:
    """The table."""
    out = []
    for ratio in dict.fromkeys(round(x.ratio, 9) for x in lines):
        load = press(ratio)
        names = (8, "map err"), (8, "no noise"), (7, "cosine"), (6, "peak"), (7, "radius"), (5, "IoU"), (6, "ms")
        out += [
            f"a/t = {ratio:g}: radius {1e3 * load.radius:g} mm, Fx {load.vector[0]:.4g} N, Fz {load.vector[2]:.4g} N",
            f"  {'route':27s} {'Fx N':>14s} {'Fz N':>15s} " + " ".join(n.rjust(w) for w, n in names) + "  flags",
        ]
        for x in lines:
            if round(x.ratio, 9) != ratio:
                continue
            radius = "none" if np.isnan(x.radius) else f"{1e3 * x.radius:.2f}"
            out.append(
                f"  {x.route:27s} {x.force[0]:7.4f}±{x.std[0]:.4f} {x.force[2]:8.4f}±{x.std[2]:.4f} {x.error:8.3f} "
                f"{x.bias:8.3f} {x.cosine:7.3f} {x.peak:6.2f} {radius:>7s} {x.iou:5.2f} {1e3 * x.time:6.2f}  "
                + " ".join(x.flags)
            )
    return "\n".join(out)


def figure(lines: Sequence[Line], path: Path) -> None:
    """Pressure of the truth and of each route in the middle of the pad, one colour scale, shear as arrows."""
    from matplotlib.figure import Figure

    ratios = list(dict.fromkeys(round(x.ratio, 9) for x in lines))
    names = list(dict.fromkeys(x.route for x in lines))
    fig = Figure(figsize=(2.05 * (len(names) + 1) + 0.8, 2.25 * len(ratios) + 0.5), layout="constrained")
    panels = fig.subplots(len(ratios), len(names) + 1, sharex=True, sharey=True, squeeze=False)
    peak = 1e-3 * max(float(-x.truth[:, 2].min()) for x in lines)
    image: Any = None
    for row, ratio in zip(panels, ratios, strict=True):
        own = [x for x in lines if round(x.ratio, 9) == ratio]
        shown = [("truth", own[-1].truth, own[-1].points), *((x.route, x.found, x.points) for x in own)]
        for ax, (name, t, points) in zip(row, shown, strict=True):
            image = _map(ax, t, points, peak)
            if ratio == ratios[0]:
                ax.set_title(name.replace(", ", ",\n", 1), fontsize=9)
        for ax, x in zip(row[1:], own, strict=True):
            ax.text(-6.2, -6.2, f"map error {x.error:.2f}\nFz {x.force[2]:.3g} N", fontsize=7.5, va="bottom")
        row[0].text(-6.2, -6.2, f"Fz {press(ratio).vector[2]:.3g} N", fontsize=7.5, va="bottom")
        row[0].set_ylabel(f"a/t = {ratio:g}\ny (mm)", fontsize=9)
    fig.colorbar(image, ax=panels, shrink=0.8, label="pressure (kPa), positive where pressed", extend="both")
    fig.supxlabel("x (mm); arrows: shear, one scale", fontsize=9)
    fig.savefig(path, dpi=120)


def _map(ax: Any, t: Array, points: Array, peak: float) -> Any:
    order = np.lexsort((points[:, 0], points[:, 1]))
    count = round(np.sqrt(len(points)))
    x = 1e3 * points[order].reshape(count, count, 2)
    f = 1e-3 * t[order].reshape(count, count, 3)
    image = ax.pcolormesh(x[..., 0], x[..., 1], -f[..., 2], cmap="RdBu_r", vmin=-peak, vmax=peak, shading="nearest")
    ax.quiver(x[..., 0], x[..., 1], f[..., 0], f[..., 1], scale=8 * peak / 4, width=0.006, color="#222222")
    ax.set(xlim=(-6.5, 6.5), ylim=(-6.5, 6.5), aspect="equal")
    ax.tick_params(labelsize=7)
    return image


def main() -> None:
    """Print the table and save the picture."""
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else 9
    lines = table(draws=draws)
    print(f"medians of {draws} draws")
    print(show(lines))
    figure(lines, Path("three_routes.png"))
    print("\npicture: three_routes.png")


if __name__ == "__main__":
    main()
