"""Rigid bodies on a layer against closed forms, and against a dense solution of the same contact."""

from __future__ import annotations

import numpy as np
import pytest

from structures.errors import InputError, NotIdentifiable
from tactile import Hertz, Layer, LayerGrid, Mindlin, RigidBody, shapes
from tactile._closed.contact import flat_stiffness, sphere_force

R, E = 5e-3, 1e5
DEEP = Layer(h=0.5, E=E, nu=0.4999)  # as a half-space
HERTZ = Hertz(R=R, force=0.02, E=E, nu=0.4999)


def grid(layer: Layer, n: int, side: float) -> LayerGrid:
    return LayerGrid(layer, (n, n), side / n)


def ball(of: LayerGrid) -> np.ndarray:
    """A parabola, as in the closed forms."""
    return (of.nodes**2).sum(axis=-1) / (2 * R)


def area(mask: np.ndarray, of: LayerGrid) -> float:
    """Radius of the disc of the same area."""
    return float(np.sqrt(mask.sum() * of.pitch**2 / np.pi))


@pytest.fixture(scope="module")
def hertz():
    of = grid(DEEP, 65, 2.4 * HERTZ.radius)
    return RigidBody(of, ball(of), friction=0.5).press(force=HERTZ.force)


class TestPressed:
    def test_hertz(self, hertz):
        r = np.hypot(*np.moveaxis(hertz.body.grid.nodes, -1, 0))
        assert hertz.force[2] == pytest.approx(-HERTZ.force, rel=1e-9)
        assert hertz.depth == pytest.approx(HERTZ.approach, rel=2e-3)
        assert area(hertz.touches, hertz.body.grid) == pytest.approx(HERTZ.radius, rel=5e-3)
        middle = r < 0.9 * HERTZ.radius
        assert -hertz.tractions[middle][:, 2] == pytest.approx(HERTZ.pressure(r[middle]), rel=0.01)

    @pytest.mark.parametrize("nu", [0.3, 0.45, 0.49])
    def test_a_sphere_on_a_thin_layer_comes_closer_as_the_grid_is_refined(self, nu):
        layer = Layer(h=3e-3, E=E, nu=nu)
        away = []
        for n in (24, 48):
            of = grid(layer, n, 5e-3)
            found = RigidBody(of, ball(of)).press(depth=0.4e-3)
            away.append(abs(-found.force[2] / sphere_force(layer, R, 0.4e-3) - 1))
        assert away[1] < 3e-3
        assert away[1] < away[0]

    def test_a_flat_end(self):
        layer = Layer(h=3e-3, E=E, nu=0.45)
        of = grid(layer, 80, 2.4e-3)
        found = RigidBody(of, shapes.flat(of.nodes, 1e-3)).press(depth=1e-4)
        assert -found.force[2] / 1e-4 == pytest.approx(flat_stiffness(layer, 1e-3), rel=0.02)

    def test_no_pull_and_no_overlap(self):
        layer = Layer(h=2e-3, E=E, nu=0.4)
        of = grid(layer, 40, 8e-3)
        roller = shapes.cylinder(of.nodes, 3e-3, (-1e-3, 0.0), 0.4, length=3e-3)
        height = np.minimum(roller, shapes.cone(of.nodes, 0.5, (2e-3, 1e-3)))
        found = RigidBody(of, height).press(depth=0.3e-3)
        gap = found.body.height - found.depth - found.displacements[..., 2]
        assert found.tractions[..., 2].max() == 0
        assert gap[~found.touches].min() > -1e-9
        assert np.abs(gap[found.touches]).max() < 1e-9
        assert 0.05 < found.touches.mean() < 0.6

    def test_modulus_is_a_gain_and_force_is_what_depth_needs(self):
        soft, hard = (grid(Layer(h=2e-3, E=e, nu=0.45), 32, 5e-3) for e in (E, 10 * E))
        one, ten = (RigidBody(g, ball(g), friction=0.3).press(depth=2e-4) for g in (soft, hard))
        assert ten.tractions == pytest.approx(10 * one.tractions, rel=1e-4, abs=1e-4 * E)
        back = RigidBody(soft, ball(soft), friction=0.3).press(force=-one.force[2])
        assert back.depth == pytest.approx(2e-4, rel=1e-4)


class TestDragged:
    def test_cattaneo_and_mindlin(self, hertz):
        closed = Mindlin(HERTZ, 0.005, 0.5)
        found = hertz.drag((closed.shift, 0.0), steps=3)
        of = found.body.grid
        assert found.force[0] == pytest.approx(closed.shear, rel=5e-3)
        assert area(found.touches & ~found.slips, of) == pytest.approx(closed.stick, rel=0.02)
        r = np.hypot(*np.moveaxis(of.nodes, -1, 0))
        middle = r < 0.95 * HERTZ.radius
        assert np.abs(found.tractions[middle][:, 0] - closed.traction(r[middle])).max() < 0.05 * 0.5 * HERTZ.peak

    def test_far_enough_it_slides(self, hertz):
        found = hertz.drag((0.0, 3 * Mindlin(HERTZ, 0.01, 0.5).shift), steps=2)
        assert found.force == pytest.approx([0.0, 0.5 * HERTZ.force, -HERTZ.force], abs=1e-3 * HERTZ.force)
        assert found.slips.sum() == found.touches.sum()

    def test_turned_until_it_slides(self, hertz):
        found = hertz.drag(turn=0.4, steps=2)
        limit = 3 * np.pi / 16 * 0.5 * HERTZ.force * HERTZ.radius  # of the pressure of Hertz, every point sliding
        assert found.torque == pytest.approx(limit, rel=0.01)
        assert np.abs(found.force[:2]).max() < 1e-3 * HERTZ.force

    def test_there_and_back_again_leaves_shear(self, hertz):
        closed = Mindlin(HERTZ, 0.006, 0.5)
        back = hertz.drag((closed.shift, 0.0), steps=2).drag((-closed.shift, 0.0), steps=2)
        # Mindlin & Deresiewicz 1953: unloading by a shift s slips as loading by s/2 with twice the limit of friction
        half = Mindlin(HERTZ, 0.01 * (1 - (1 - (1 - 0.4 ** (2 / 3)) / 2) ** 1.5), 0.5).shear
        assert back.force[0] == pytest.approx(0.006 - 2 * half, abs=0.02 * 0.006)
        assert back.moved == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)

    def test_what_sticks_everywhere_is_a_linear_system(self):
        """Pressure and shear act on each other with nu < 1/2: all components of the nodes that touch at once, dense."""
        of = grid(Layer(h=1e-3, E=E, nu=0.3), 13, 3e-3)
        found = RigidBody(of, ball(of), friction=50.0).press(depth=1e-4)
        touches = found.touches.ravel()
        at = (3 * np.flatnonzero(touches)[:, None] + np.arange(3)).ravel()
        H = of.influence(of.nodes.reshape(-1, 2))
        wanted = np.zeros((touches.sum(), 3))
        wanted[:, 2] = ball(of).ravel()[touches] - 1e-4
        dense = np.linalg.solve(H[np.ix_(at, at)], wanted.ravel()).reshape(-1, 3)
        assert dense[:, 2].max() < 0
        assert found.tractions.reshape(-1, 3)[touches] == pytest.approx(dense, abs=2e-4 * np.abs(dense).max())
        free = RigidBody(of, ball(of)).press(depth=1e-4)
        assert -found.force[2] > -1.002 * free.force[2]  # who holds the surface needs more force

    def test_shear_opposes_what_slips(self):
        of = grid(Layer(h=2e-3, E=E, nu=0.45), 32, 5e-3)
        before = RigidBody(of, ball(of), friction=0.4).press(depth=2e-4)
        after = before.drag((3e-5, 1e-5), turn=0.01, steps=1)
        x, y = np.moveaxis(of.nodes, -1, 0)
        body = np.stack([3e-5 - 0.01 * y, 1e-5 + 0.01 * x], axis=-1)
        slip = (after.displacements - before.displacements)[..., :2] - body
        q, p = after.tractions[..., :2], -after.tractions[..., 2]
        size = np.hypot(slip[..., 0], slip[..., 1])
        moved = after.touches & (size > 1e-2 * size[after.touches].max())
        assert 0.05 < moved.sum() / after.touches.sum() < 0.95
        against = (q * slip).sum(axis=-1)[moved] / (0.4 * p * size)[moved]
        assert against == pytest.approx(-1.0, abs=5e-3)
        assert (np.hypot(q[..., 0], q[..., 1]) <= 0.4 * p * (1 + 1e-9)).all()


class TestMotion:
    @pytest.mark.parametrize(("z", "within"), [(None, 0.015), (1.2e-3, 3e-3)])  # the surface has a kink at the contact
    def test_of_markers(self, z, within):
        of = grid(Layer(h=2e-3, E=E, nu=0.45), 48, 7e-3)
        found = RigidBody(of, ball(of), friction=0.4).press(depth=2e-4).drag((2e-5, 0.0), steps=1)
        points = np.random.default_rng(0).uniform(-3e-3, 3e-3, (40, 2))
        full = points if z is None else np.column_stack([points, np.full(40, z)])
        exact = (of.influence(full) @ found.tractions.ravel()).reshape(-1, 3)
        assert found.motion(points, z) == pytest.approx(exact, abs=within * np.abs(exact).max())
        with pytest.raises(InputError, match="outside the grid"):
            found.motion([[4e-3, 0.0]])


class TestShapes:
    def test_heights(self):
        x = np.stack(np.meshgrid(np.linspace(-2e-3, 2e-3, 81), np.linspace(-2e-3, 2e-3, 81)), axis=-1)
        for height, inside in (
            (shapes.flat(x, 1e-3), np.pi * 1e-6),
            (shapes.ring(x, 1.5e-3, 0.5e-3), np.pi * 2e-6),
            (shapes.bar(x, (3e-3, 1e-3), angle=0.3), 3e-6),
            (shapes.polygon(x, [(-1e-3, -1e-3), (1e-3, -1e-3), (0.0, 1e-3)]), 2e-6),
        ):
            assert np.isin(height, (0.0, np.inf)).all()
            assert np.isfinite(height).sum() * (5e-5) ** 2 == pytest.approx(inside, rel=0.05)
        assert shapes.edge(x, 0.5, angle=np.pi / 2) == pytest.approx(0.5 * np.abs(x[..., 0]), abs=1e-15)
        assert shapes.cylinder(x, 3e-3) == pytest.approx(shapes.sphere(x * [0.0, 1.0], 3e-3))
        assert shapes.cone(x, 0.2, (1e-3, 0.0)).min() == 0


class TestRefusals:
    @pytest.mark.parametrize("make", [
        lambda of: RigidBody(of, np.zeros((3, 3))),
        lambda of: RigidBody(of, np.full(of.shape, np.nan)),
        lambda of: RigidBody(of, np.full(of.shape, np.inf)),
        lambda of: RigidBody(of, ball(of), friction=-0.1),
        lambda of: RigidBody(DEEP, ball(of)),
        lambda of: RigidBody(of, ball(of)).press(),
        lambda of: RigidBody(of, ball(of)).press(depth=1e-4, force=1.0),
        lambda of: RigidBody(of, ball(of)).press(depth=-1e-4),
        lambda of: RigidBody(of, ball(of)).press(depth=1e-5).drag((1e-5, 0.0)),
        lambda of: shapes.ring(of.nodes, 1e-3, 2e-3),
        lambda of: shapes.polygon(of.nodes, [(0.0, 0.0), (1.0, 0.0)]),
        lambda of: shapes.sphere(of.nodes[..., :1], 1e-3),
    ])  # fmt: skip
    def test_what_cannot_be(self, make):
        with pytest.raises(InputError):
            make(grid(Layer(h=2e-3, E=E, nu=0.45), 16, 4e-3))

    def test_a_contact_that_the_grid_does_not_hold(self):
        of = grid(Layer(h=2e-3, E=E, nu=0.45), 16, 1e-3)
        with pytest.raises(NotIdentifiable, match="edge of the grid"):
            RigidBody(of, ball(of)).press(depth=2e-4)
