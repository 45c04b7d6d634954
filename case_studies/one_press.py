"""One press: the surface moves where no force acts, and force near the edge of contact may oppose the motion there.

Ma et al., "Dense tactile force estimation using GelSlim and inverse FEM", IEEE ICRA (2019), arXiv:1810.04621, show
markers that move far outside the contact, forces that stay inside it, and tangential forces at its edge that oppose the
local motion; f = c u, force painted wherever there is motion, can show neither. Their picture was not measured here.
Rebuilt is one press of 1 N on a circle of 3.6 mm with 0.15 N of shear (Hertz pressure, exact bonded layer of 3 mm) and
what four models make of its surface motion, without noise and with 2 um of it: `GelSlim` on a single standard layer,
the same on four B-bar layers, `MultilayerPad`, and f = c u, whose c has seen the true normal force. Poisson's ratio is
0.45, as of a silicone gel: at the 0.3223 of the paper, pressure of this width hardly moves the surface sideways.

Run ``python -m case_studies.one_press``: prints the table and saves ``one_press.png``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile import GelSlim, Markers, MultilayerPad, Pad, Press, metrics

E, NU, SIZE, THICKNESS, PITCH = 147e3, 0.45, (20e-3, 16e-3), 3e-3, 1e-3
PRESS = Press(radius=3.6e-3, force=1.0, shear=(0.15, 0.0))
NOISE = 2e-6
Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Shown:
    """One model of the press.

    Parameters
    ----------
    model : str
    noise : float
        Std of the motion that it saw (m).
    forces : array (P, 3)
        Nodal forces (N).
    outside : float
        Share of the sum of their lengths outside the patch.
    opposed, shared : int
        Nodes at the edge of the patch whose tangential force opposes their tangential motion; and how many of them do
        so in truth.
    error, tangential : float
        Relative L2 error of the nodal forces, and of their tangential part.
    """

    model: str
    noise: float
    forces: Array
    outside: float
    opposed: int
    shared: int
    error: float
    tangential: float

    @property
    def resultant(self) -> Array:
        """Force on the pad (3,) in N."""
        return np.asarray(self.forces.sum(axis=0))


@dataclass(frozen=True, eq=False)
class OnePress:
    """The press, its motion without noise, and the models of it without noise and with it: the truth first.

    Parameters
    ----------
    moved_outside : float
        Share of the motion, by the sum of its lengths, outside the patch.
    far : float
        Largest motion beyond 4 mm, over the largest of all.
    edge : int
        Nodes at the edge.
    """

    nodes: Array
    motion: Array
    moved_outside: float
    far: float
    edge: int
    rows: tuple[Shown, ...]

    def __getitem__(self, key: tuple[str, float]) -> Shown:
        """The row of a model and a noise (m)."""
        return next(row for row in self.rows if (row.model, row.noise) == key)


def pad(layers: int = 4, element: str = "bbar") -> Pad:
    """The pad; a single layer on purpose (W115)."""
    return Pad(size=SIZE, thickness=THICKNESS, E=E, nu=NU, pitch=PITCH, layers=layers, element=element, allow="W115")


def share_outside(vectors: Array, patch: Mask) -> float:
    """Share of the sum of the lengths of vectors outside the patch."""
    size = np.linalg.norm(vectors, axis=1)
    return float(size[~patch].sum() / size.sum())


def opposing(forces: Array, motion: Array, edge: Mask) -> Mask:
    """Nodes at the edge whose tangential force and tangential motion point apart."""
    return edge & (np.sum(forces[:, :2] * motion[:, :2], axis=1) < 0)


def proportional(motion: Array, normal: float) -> Array:
    """The baseline f = c u: a stiffness for each node alone, c from the true normal force (N)."""
    return motion * (normal / motion[:, 2].sum())


def models(noise: float, seen: Array) -> dict[str, Callable[[Array], Array]]:
    """Nodal forces from motion; lambda of the multilayer pad is frozen on what was `seen`."""
    thick, thin = pad(), pad(1, "standard")
    single, several = (
        GelSlim(gel, Markers(gel.nodes2d, noise, "XYZ"), interpolation="linear") for gel in (thin, thick)
    )
    regularised = MultilayerPad(
        thick, several.markers, penalty="identity", choice="upre"
    )  # discrepancy takes 8 % more of Fz
    regularised.calibrate([seen])
    return {
        "GelSlim, 1 layer": lambda u: single.estimate(u).forces(),
        "GelSlim, 4 layers": lambda u: several.estimate(u).forces(),
        "MultilayerPad": lambda u: regularised.estimate(u).forces(),
        "f = c u": lambda u: proportional(u, -PRESS.force),
    }


def one_press(noise: float = NOISE, seed: int = 0) -> OnePress:
    """All models on the same motion, without noise and with it.

    The patch is where the truth has force; its edge lies within one pitch of the contact radius.
    """
    gel = pad()
    nodes, areas = gel.nodes2d, gel.surface.areas
    (case,) = metrics.cases([PRESS], gel.layer, nodes, nodes, pitch=PITCH)
    motion, truth = case.displacements, case.tractions * areas[:, None]
    patch = np.linalg.norm(truth, axis=1) > 0
    edge = patch & (np.abs(np.linalg.norm(nodes, axis=1) - PRESS.radius) < PITCH)
    true = opposing(truth, motion, edge)

    def shown(model: str, level: float, f: Array, u: Array) -> Shown:
        apart = opposing(f, u, edge)
        return Shown(
            model, level, f, share_outside(f, patch), int(apart.sum()), int(np.sum(apart & true)),
            metrics.relative_error(f, truth), metrics.relative_error(f[:, :2], truth[:, :2]),
        )  # fmt: skip

    seen = motion + noise * np.random.default_rng(seed).standard_normal(motion.shape)
    rows = [shown("truth", 0.0, truth, motion)]
    for name, model in models(noise, seen).items():
        rows += [shown(name, level, model(u), u) for level, u in ((0.0, motion), (noise, seen))]
    size = np.linalg.norm(motion, axis=1)
    far = float(size[np.linalg.norm(nodes, axis=1) > 4e-3].max() / size.max())
    return OnePress(nodes, motion, share_outside(motion, patch), far, int(edge.sum()), tuple(rows))


def show(found: OnePress) -> str:
    """The table in text."""
    lines = [
        f"1 N and 0.15 N of shear on a circle of 3.6 mm: {found.moved_outside:.1%} of the motion is outside the patch",
        " " * 21 + " noise force outside  opposed at the edge as in truth map error tangential      Fx      Fz",
    ]
    for r in found.rows:
        lines.append(
            f"{r.model:20s} {f'{1e6 * r.noise:.0f} um':>6s} {r.outside:13.1%} {f'{r.opposed} of {found.edge}':>20s} "
            f"{r.shared:11d} {r.error:9.3f} {r.tangential:10.3f} {r.resultant[0]:7.3f} {r.resultant[2]:7.3f}"
        )
    return "\n".join(lines)


def picture(found: OnePress, path: Path) -> None:
    """Motion, and the nodal forces of every model: colour normal, arrows tangential."""
    from matplotlib.figure import Figure

    fig = Figure(figsize=(12.5, 7.0), layout="constrained")
    panels = fig.subplots(2, 3, sharex=True, sharey=True).ravel()
    rows = [r for r in found.rows if r.model == "truth" or r.noise]
    top = 1e3 * np.abs(rows[0].forces[:, 2]).max()
    tangent = 1e3 * np.linalg.norm(rows[0].forces[:, :2], axis=1).max()
    drawn: list[tuple[Shown | None, Array]] = [(None, 1e3 * found.motion), *((r, 1e3 * r.forces) for r in rows)]
    for ax, (row, v) in zip(panels, drawn, strict=True):
        moved = row is None
        limit = float(np.abs(v[:, 2]).max()) if moved else top
        image = ax.pcolormesh(*_grid(found.nodes), _field(found.nodes, v[:, 2]), cmap="RdBu_r", vmin=-limit, vmax=limit,
                              shading="nearest", rasterized=True)  # fmt: skip
        scale = float(np.linalg.norm(v[:, :2], axis=1).max()) if moved else tangent
        ax.quiver(*(1e3 * found.nodes.T), v[:, 0], v[:, 1], scale=scale / 1.6, scale_units="x", width=0.0028)
        turn = np.linspace(0, 2 * np.pi, 181)
        ax.plot(1e3 * PRESS.radius * np.cos(turn), 1e3 * PRESS.radius * np.sin(turn), color="#222222", lw=1, ls="--")
        ax.set_title(_words(found, row), fontsize=9.5)
        ax.set_aspect("equal")
        ax.set_xlim(-8, 8)
        ax.set_ylim(-7, 7)
        fig.colorbar(image, ax=ax, shrink=0.7).set_label("normal motion (mm)" if moved else "normal force (mN)")
    fig.supxlabel("x (mm); the dashed circle is the contact")
    fig.supylabel("y (mm)")
    fig.savefig(path, dpi=130)


def _words(found: OnePress, row: Shown | None) -> str:
    """Title of a panel."""
    if row is None:
        return f"motion of the surface\n{found.moved_outside:.0%} outside the patch"
    wrong = f", map {row.error:.0%} off" if row.noise else ""
    return f"{row.model}{wrong}\n{row.outside:.0%} outside, {row.opposed} of {found.edge} opposed at the edge"


def _grid(nodes: Array) -> tuple[Array, Array]:
    """Columns and rows of the regular nodes (mm)."""
    return 1e3 * np.unique(nodes[:, 0].round(9)), 1e3 * np.unique(nodes[:, 1].round(9))


def _field(nodes: Array, values: Array) -> Array:
    """Values of the regular nodes as (rows, columns)."""
    x, y = (np.unique(nodes[:, k].round(9), return_inverse=True)[1] for k in range(2))
    out = np.full((y.max() + 1, x.max() + 1), np.nan)
    out[y, x] = values
    return out


def main() -> None:
    """Print the table and save the picture."""
    found = one_press()
    print(show(found))
    picture(found, Path("one_press.png"))
    print("\npicture: one_press.png")


if __name__ == "__main__":
    main()
