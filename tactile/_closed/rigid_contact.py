"""A rigid body pressed into a layer, dragged and turned on it: where it touches and where it slips is found.

Normal contact: pressures p >= 0 and gaps g >= 0 with p g = 0, by conjugate gradients on the contact as it is found
(Polonsky & Keer, Wear 231, 1999). Friction: shear within the disc |q| <= f p opposes what slips in a step, and points
that stick keep their place on the body; in each step it is the minimum of a quadratic over discs, sought by spectral
projected gradients (Birgin, Martinez & Raydan, SIAM J. Optim. 10, 2000). What shear lifts and pressure shifts, both
with nu < 1/2 or on a thin layer, joins the two by turns. The body takes no part in the elastic motion.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError, NotIdentifiable, integer, number, pair, positive

from .._arrays import Array, Mask
from .gridded import LayerGrid

STEPS, TURNS = 2000, 60
SETTLED = 1e-6  # of a gap over the depth, and of a shear over the limit of friction


@dataclass(frozen=True, eq=False)
class RigidBody:
    """A rigid shape over a layer on a grid, and the friction between them.

    Parameters
    ----------
    grid : LayerGrid
        The layer; its grid must reach beyond every contact.
    height : array_like, (ny, nx)
        Height (m) of the body over the plane that touches its lowest point; inf where there is no body.
    friction : float
        Coefficient f of Coulomb's law; 0 slips freely.
    settled : float
        What is left of a gap over the depth, and of a shear over the limit of friction, when the iterations end.

    Raises
    ------
    InputError
        If an argument is not possible.
    """

    grid: LayerGrid
    height: Array
    friction: float = field(default=0.0, kw_only=True)
    settled: float = field(default=SETTLED, kw_only=True)

    def __post_init__(self) -> None:
        if not isinstance(self.grid, LayerGrid):
            raise InputError("no grid", where="RigidBody", found=type(self.grid).__name__, expected="a LayerGrid")
        height = np.array(self.height, dtype=float)
        if height.shape != self.grid.shape or np.isnan(height).any() or not np.isfinite(height.min()):
            raise InputError(
                "heights do not fit the grid", where="RigidBody", found=f"shape {height.shape}",
                expected=f"{self.grid.shape}, numbers or inf, some of them finite",
            )  # fmt: skip
        height -= height.min()
        height.flags.writeable = False
        object.__setattr__(self, "height", height)
        if number("friction", self.friction, where="RigidBody") < 0:
            raise InputError("friction is negative", where="RigidBody", found=self.friction, expected="friction >= 0")
        positive("settled", self.settled, where="RigidBody")

    def press(self, *, depth: float | None = None, force: float | None = None) -> RigidContact:
        """The body pressed straight down to a depth (m) or with a force (N).

        Raises
        ------
        InputError
            If not exactly one of them is given, or it is not positive.
        NotIdentifiable
            If the contact reaches the edge of the grid, or does not settle.
        """
        if (depth is None) == (force is None):
            raise InputError("depth or force", where="press", found="both" if depth else "neither", expected="one")
        name, value, unit = ("depth", depth, "m") if force is None else ("force", force, "N")
        goal = positive(name, value, where="press", unit=unit)
        start = RigidContact(
            self, np.zeros((*self.grid.shape, 3)), np.zeros((*self.grid.shape, 3)), 0.0, (0.0, 0.0, 0.0)
        )
        return _step(start, {name: goal}, np.zeros(3))


@dataclass(frozen=True, eq=False)
class RigidContact:
    """A body in contact: what acts on the layer, and how its surface has moved.

    Parameters
    ----------
    body : RigidBody
    tractions : array (ny, nx, 3)
        On the layer (Pa).
    displacements : array (ny, nx, 3)
        Of its surface (m).
    depth : float
        Of the lowest point of the body under the surface at rest (m).
    moved : (x, y, turn)
        Of the body since it was set down (m, m, rad about the middle of the grid).
    """

    body: RigidBody
    tractions: Array
    displacements: Array
    depth: float
    moved: tuple[float, float, float]

    @property
    def force(self) -> Array:
        """Resultant (3,) in N."""
        return np.asarray(self.tractions.sum(axis=(0, 1)) * self.body.grid.pitch**2)

    @property
    def torque(self) -> float:
        """Moment about the normal through the middle of the grid (N m)."""
        x, y = np.moveaxis(self.body.grid.nodes, -1, 0)
        moment = x * self.tractions[..., 1] - y * self.tractions[..., 0]
        return float(moment.sum() * self.body.grid.pitch**2)

    @property
    def touches(self) -> Mask:
        """Nodes in contact (ny, nx)."""
        return np.asarray(self.tractions[..., 2] < 0)

    @property
    def slips(self) -> Mask:
        """Nodes in contact whose shear is at the limit of friction (ny, nx)."""
        limit = self.body.friction * -self.tractions[..., 2]
        shear = np.hypot(self.tractions[..., 0], self.tractions[..., 1])
        return np.asarray(self.touches & (shear >= (1 - 1e-4) * limit))

    def motion(self, points: ArrayLike, z: float | None = None) -> Array:
        """Motion (n, 3) in m of points (n, 2) of the layer, on its surface or at a height z (m), by cubic splines.

        Raises
        ------
        InputError
            If points lie outside the grid, or z outside the layer.
        """
        grid = self.body.grid
        return grid.between(self.displacements if z is None else grid.displacements(self.tractions, z), points)

    def drag(self, shift: tuple[float, float] = (0.0, 0.0), turn: float = 0.0, steps: int = 8) -> RigidContact:
        """The body moved along the surface by `shift` (m) and turned by `turn` (rad) at the depth that it has.

        Small motions: the shape over each node of the grid stays the same. The path is straight, in `steps` parts.

        Raises
        ------
        InputError
            If an argument is not possible, or the body has no friction.
        NotIdentifiable
            If the contact does not settle.
        """
        if not self.body.friction:
            raise InputError("a body without friction drags nothing", where="drag", found="friction 0",
                             expected="friction > 0", hint="give RigidBody(friction=...)")  # fmt: skip
        x, y = pair("shift", shift, where="drag")
        turn = number("turn", turn, where="drag", unit="rad")
        state = self
        for _ in range(integer("steps", steps, where="drag", limit=10_000)):
            state = _step(state, {"depth": self.depth}, np.array([x, y, turn]) / steps)
        return state


def _step(before: RigidContact, goal: dict[str, float], moved: Array) -> RigidContact:
    """From one state to the next: pressure and shear by turns, until neither changes the other."""
    body = before.body
    grid, nodes = body.grid, body.grid.nodes
    carried = np.stack([moved[0] - moved[2] * nodes[..., 1], moved[1] + moved[2] * nodes[..., 0]], axis=-1)
    held = before.displacements[..., :2] + carried
    t, depth = before.tractions.copy(), before.depth
    for _ in range(TURNS):
        lifted = grid.displacements(_only(t, slice(2)))[..., 2]
        p, depth = _pressed(grid, body.height - lifted, -t[..., 2], goal, body.settled)
        last, t = t, _only(t, slice(2))
        t[..., 2] = -p
        if body.friction:
            pushed = grid.displacements(_only(t, slice(2, 3)))[..., :2]
            t[..., :2] = _sheared(grid, held - pushed, body.friction * p, t[..., :2], body.settled)
        change = np.linalg.norm(t - last) / np.linalg.norm(t)
        if change <= body.settled * 10 or not body.friction:
            break
    else:
        raise _unsettled("pressure and friction")
    found = RigidContact(body, t, grid.displacements(t), depth, tuple(np.add(before.moved, moved).tolist()))
    edge = found.touches.copy()
    edge[1:-1, 1:-1] = False
    if np.any(edge & np.isfinite(body.height)):
        raise NotIdentifiable("the contact reaches the edge of the grid", advice="take a larger grid", code="LID-E306")
    return found


def _only(t: Array, part: slice) -> Array:
    """Tractions of which only some components act."""
    kept = np.zeros_like(t)
    kept[..., part] = t[..., part]
    return kept


def _pressed(
    grid: LayerGrid, height: Array, start: Array, goal: dict[str, float], settled: float
) -> tuple[Array, float]:
    """Pressure (ny, nx) and depth: conjugate gradients over the nodes that touch."""
    motion = grid.along(slice(2, 3))
    can = np.isfinite(height)
    height = np.where(can, height, 0.0)
    total = goal["force"] / grid.pitch**2 if "force" in goal else None
    p = np.where(can, start, 0.0)
    if not p.any():
        p = np.where(can & (height <= np.quantile(height[can], 0.05)), 1.0, 0.0)
    p *= 1.0 if total is None else total / p.sum()
    t, before, fresh = np.zeros_like(p), 1.0, True
    size = goal.get("depth", 0.0)
    for _ in range(STEPS):
        gap = motion(p[..., None])[..., 0] + height
        on = p > 0
        depth = goal["depth"] if total is None else float(gap[on].mean())
        gap = np.where(can, gap - depth, np.inf)
        under = (p == 0) & (gap < -settled * max(size, abs(depth)))
        if not under.any() and np.abs(gap[on]).max(initial=0.0) <= settled * max(size, abs(depth)):
            return p, depth
        squares = float((gap[on] ** 2).sum())
        t = np.where(on, np.where(on, gap, 0.0) + (0.0 if fresh else squares / before) * t, 0.0)
        r = motion(t[..., None])[..., 0]
        if total is not None:
            r = r - r[on].mean()
        length = (
            float((gap[on] * t[on]).sum()) / float((r[on] * t[on]).sum()) if on.any() else 1 / float(grid.compliance[2])
        )
        p = np.maximum(p - length * t, 0.0)
        under = (p == 0) & (gap < 0)
        p[under] -= length * gap[under]
        p *= 1.0 if total is None else total / p.sum()
        before, fresh = squares, bool(under.any())
    raise _unsettled("the pressure")


def _sheared(grid: LayerGrid, held: Array, limit: Array, start: Array, settled: float) -> Array:
    """Shear (ny, nx, 2): least of q A q / 2 - held q over the discs |q| <= limit."""
    motion = grid.along(slice(2))

    def within(q: Array) -> Array:
        size = np.hypot(q[..., 0], q[..., 1])
        return np.asarray(q * np.minimum(1.0, limit / np.maximum(size, 1e-300))[..., None])

    q = within(start)
    moved = motion(q)
    slope, values = moved - held, []
    length = 1 / float(grid.compliance[0])
    scale = length
    for _ in range(STEPS):
        values.append(float((q * (moved / 2 - held)).sum()))
        if np.abs(within(q - scale * slope) - q).max() <= settled * np.abs(q).max():
            return q
        step = within(q - length * slope) - q
        along = motion(step)
        down, bend = float((slope * step).sum()), float((step * along).sum())
        share = 1.0
        while values[-1] + share * down + share**2 * bend / 2 > max(values[-8:]) + 1e-4 * share * down:
            share = min(share / 2, max(-down / bend, share / 10)) if bend > 0 else share / 2
        q, moved, slope = q + share * step, moved + share * along, slope + share * along
        length = float((step**2).sum()) / bend if bend > 0 else scale
    raise _unsettled("the shear")


def _unsettled(what: str) -> NotIdentifiable:
    return NotIdentifiable(
        f"{what} of the contact did not settle", advice="take smaller steps, or a finer grid", code="LID-E306"
    )
