"""The gels of `case_studies.bodies` against closed forms and finite elements alone, and the cases that they make."""

import numpy as np
import pytest

from case_studies import bodies
from case_studies.bodies import Bricks, Patch, pressed, surfaces
from tactile import Layer, Press
from tests.campaigns.gels import cases

SIZE, THICKNESS = (12e-3, 10e-3), 3e-3
POINTS = np.random.default_rng(0).uniform(-4.5e-3, 4.5e-3, (60, 2))


@pytest.mark.parametrize(("kind", "profile"), [("round", "hertz"), ("flat", "uniform")])
def test_the_endless_layer_is_that_of_the_closed_form(kind, profile):
    patch = Patch(kind, (0.0, 0.0), (1.2e-3, 0.0), 0.0, (0.3, 0.1, -1.0))
    (found,) = surfaces([(patch,)], "layer", SIZE, THICKNESS, 0.45)
    press = Press(radius=1.2e-3, force=1.0, shear=(0.3, 0.1), profile=profile)
    true = np.reshape(press.displacement(Layer(THICKNESS, 1.0, 0.45), POINTS), (-1, 3))
    assert np.linalg.norm(found(POINTS) - true) < 3e-3 * np.linalg.norm(true)


def test_stresses_in_the_layer_are_the_tractions_at_its_surface():
    stress = bodies.inside_layer(np.array([50.0, 500.0, 5000.0]), THICKNESS, 0.45, THICKNESS)
    assert stress[:, 2:] == pytest.approx(np.broadcast_to(np.eye(2), (3, 2, 2)), abs=1e-9)


def test_edges_are_those_of_finite_elements_alone():
    """Away from the press, where bricks alone are right too."""
    patch = Patch("round", (1e-3, -0.5e-3), (2e-3, 0.0), 0.0, (0.3, 0.1, -1.0))
    (found,) = surfaces([(patch,)], "fe", SIZE, THICKNESS, 0.45)
    alone = Bricks.of(SIZE, THICKNESS, 0.45, 4.0)
    true = alone.motion(alone.solved([pressed((patch,))])[0], POINTS)
    far = np.hypot(*(POINTS - patch.centre).T) > 3.2e-3
    endless = bodies.at_places(found.layer, POINTS)
    assert np.linalg.norm((found(POINTS) - true)[far]) < 0.02 * np.linalg.norm(true[far])
    assert np.linalg.norm((endless - true)[far]) > 0.1 * np.linalg.norm(true[far])


@pytest.mark.parametrize(("kind", "turn"), [("round", 0.0), ("flat", 0.0), ("ring", 0.0), ("bar", 0.7)])
def test_density_quadrature_and_transform_are_one_patch(kind, turn):
    patch = Patch(kind, (0.4e-3, -0.3e-3), (1.5e-3, 0.8e-3), turn, (0.0, 0.0, -1.0))
    places, shares = patch.quadrature()
    assert shares.sum() == pytest.approx(1, abs=1e-6)
    k = np.array([300.0, 800.0]), np.array([-200.0, 500.0])
    sums = [np.sum(shares * np.exp(-1j * (x * places[:, 0] + y * places[:, 1]))) for x, y in zip(*k, strict=True)]
    assert patch.transform(*k) == pytest.approx(np.array(sums), abs=2e-3)
    grid = np.stack(np.meshgrid(*[np.arange(-2.5e-3, 2.5e-3, 2e-5)] * 2), axis=-1).reshape(-1, 2)
    assert patch.density(grid).sum() * 4e-10 == pytest.approx(1, rel=0.01)


def test_cases_are_the_same_for_the_same_seed():
    first, again = (next(iter(cases(1, 5, "layer"))) for _ in "ab")
    assert np.array_equal(first.motion, again.motion)
    assert np.abs(first.motion - first.exact).max() < 6 * first.noise
    assert first.depth is not None
    assert 0.04e-3 < -first.depth[0].min() < 0.3e-3
    area = np.stack(np.meshgrid(*(np.linspace(-s / 2, s / 2, 400) for s in first.size)), axis=-1).reshape(-1, 2)
    total = first.traction(area).sum(axis=0) * np.prod(first.size) / 399**2
    assert total == pytest.approx(first.force, rel=0.05, abs=0.02 * abs(first.force[2]))
