"""GelForce: the block matrix of two layers of markers, half-space or layer, and what its depth costs."""

from __future__ import annotations

import numpy as np
import pytest

from structures.errors import InputError, NotIdentifiable
from tactile import Extent, GelForce, HalfSpace, Layer, Markers, Press
from tactile._sensors.gelforce import influence

GROUND = HalfSpace(E=0.147e6, nu=0.49)
# condition number, relative error of the pseudo-inverse at 5 um: 11 x 11 forces 2 mm apart, markers under them
PAGE = {(0.5, 1): (55.3, 0.036), (1, 2): (400, 0.19), (2, 4): (5.9e3, 1.24), (3, 6): (5.3e4, 9.8)}


def places(count: int = 11, pitch: float = 2e-3) -> np.ndarray:
    line = (np.arange(count) - (count - 1) / 2) * pitch
    return np.array([(x, y) for y in line for x in line])


def rig(
    depths: tuple[float, float], ground: HalfSpace | Layer = GROUND, count: int = 11, **settings: object
) -> GelForce:
    at = places(count)
    under = [np.column_stack([at, np.full(len(at), ground.top - 1e-3 * d)]) for d in depths]
    return GelForce(ground, at, Markers(np.vstack(under), 5e-6, "XYZ"), **{"choice": 0, "penalty": None, **settings})  # type: ignore[arg-type]


def truth(count: int = 11) -> np.ndarray:
    f = np.zeros((count**2, 3))
    f[count**2 // 2] = [0.3, 0.0, -1.0]
    f[count**2 // 2 + 1] = [0.0, 0.0, -0.5]
    return f


@pytest.mark.parametrize("depths", PAGE)
def test_depth_decides(depths: tuple[float, float]) -> None:
    s = rig(depths)
    kappa, error = PAGE[depths]
    assert s.condition == pytest.approx(kappa, rel=0.02)
    assert s.expected_error(truth()) == pytest.approx(error, rel=0.08)
    assert (s.flagged(truth()) is not None) == (error > 0.3)


def test_noise_free_motion_gives_the_forces_back() -> None:
    s = rig((1, 2))
    u = (s.model.H @ truth().ravel()).reshape(-1, 3)
    found = s.estimate(u)
    assert np.allclose(found.forces(), truth(), atol=1e-10)
    assert np.allclose(found.resultant().value, [0.3, 0.0, -1.5], atol=1e-10)


def test_the_expected_error_is_that_of_draws() -> None:
    s, rng = rig((0.5, 1), count=7), np.random.default_rng(0)
    u = (s.model.H @ truth(7).ravel()).reshape(-1, 3)
    errors = [np.sum((s.estimate(u + 5e-6 * rng.standard_normal(u.shape)).forces() - truth(7)) ** 2) for _ in range(60)]
    assert np.sqrt(np.mean(errors)) / np.linalg.norm(truth(7)) == pytest.approx(s.expected_error(truth(7)), rel=0.1)


def test_regularisation_helps_where_depth_hurts() -> None:
    plain, ridge = rig((2, 4), count=7), rig((2, 4), count=7, choice="discrepancy", penalty="identity")
    u = (plain.model.H @ truth(7).ravel()).reshape(-1, 3)
    y = u + 5e-6 * np.random.default_rng(0).standard_normal(u.shape)
    errors = [np.linalg.norm(s.estimate(y).forces() - truth(7)) for s in (plain, ridge)]
    assert errors[1] < 0.6 * errors[0]


@pytest.mark.parametrize("ground", [GROUND, Layer(4e-3, 0.147e6, 0.45)])
def test_columns_are_small_presses(ground: HalfSpace | Layer) -> None:
    at = np.array([[0.3e-3, -0.2e-3]])
    points = np.array([[1e-3, 2e-3, ground.top - 1e-3], [-2e-3, 0.5e-3, ground.top - 2e-3]])
    H = influence(ground, points, at)
    press = Press(at=tuple(at[0]), radius=2e-5, force=1.0, shear=(0.4, -0.3))
    assert np.allclose(H @ press.vector, press.displacement(ground, points).ravel(), rtol=1e-3, atol=1e-9)


def test_the_layer_knows_the_window_and_the_half_space_does_not() -> None:
    layer = Layer(3e-3, 0.147e6, 0.3223)
    at = places(9, 1.5e-3)
    markers = np.vstack([np.column_stack([at, np.full(len(at), 3e-3 - d)]) for d in (1.5e-3, 2.2e-3)])
    press = Press(radius=3e-3, force=1.0)
    u = press.displacement(layer, markers)
    inside = GelForce(layer, at, Markers(markers, 1e-6, "XYZ"), choice=1e-3).estimate(u)
    down = markers - [0.0, 0.0, 3e-3]
    half = GelForce(layer.half_space, at, Markers(down, 1e-6, "XYZ"), choice=1e-3).estimate(u)
    assert inside.resultant().value[2] == pytest.approx(-1.0, abs=0.03)
    assert abs(half.resultant().value[2] + 1) > 0.2


def test_a_thin_pad_is_flagged_then_refused() -> None:
    assert "W601" in rig((0.5, 1), extent=Extent(5e-3, 1e-3), count=5).codes
    assert not rig((0.5, 1), extent=Extent(20e-3, 1e-3), count=5).codes
    with pytest.raises(NotIdentifiable, match="half-space"):
        rig((0.5, 1), extent=Extent(3e-3, 1e-3), count=5)
    assert "E602" in rig((0.5, 1), extent=Extent(3e-3, 1e-3), count=5, allow=("E602",)).codes


def pressed(thickness: float, radius: float, axes: str = "XYZ", **settings: object) -> tuple[GelForce, np.ndarray]:
    """A half-space for a pad of this thickness, and the motion of its markers under 1 N; the truth is the layer's."""
    layer, at = Layer(thickness, 0.147e6, 0.3223), places(13, 1.25e-3)
    under = np.vstack([np.column_stack([at, np.full(len(at), -d)]) for d in (0.75e-3, 1.5e-3)])
    u = Press(radius=radius, force=1.0).displacement(layer, under + np.array([0.0, 0.0, thickness]))
    y = u + 2e-6 * np.random.default_rng(0).standard_normal(u.shape)
    s = GelForce(layer.half_space, at, Markers(under, 2e-6, axes), **settings)  # type: ignore[arg-type]
    return s, y[:, : len(axes)]


@pytest.mark.parametrize(("axes", "radius"), [("XYZ", 0.6e-3), ("XYZ", 2.5e-3), ("XY", 2.5e-3)])
def test_a_map_of_a_thin_pad_is_refused_by_its_thickness_alone(radius: float, axes: str) -> None:
    s, y = pressed(3e-3, radius, axes, extent=Extent(3e-3))
    with pytest.raises(NotIdentifiable, match=r"half-space.*above 0\.3"):
        s.estimate(y)
    allowed, _ = pressed(3e-3, radius, axes, extent=Extent(3e-3), allow=("E602",))
    found = allowed.estimate(y)
    assert "E602" in found.codes
    if axes == "XYZ":
        assert found.resultant().value[2] == pytest.approx(-0.06, abs=0.02)  # of -1 N


def test_a_thick_pad_is_flagged_where_its_base_is_seen_and_then_not() -> None:
    s, y = pressed(30e-3, 2.5e-3, extent=Extent(30e-3))
    found = s.estimate(y)
    print([str(f) for f in found.flags if f.code.endswith("W601")])
    assert "W601" in found.codes
    assert found.resultant().value[2] == pytest.approx(-0.72, abs=0.02)  # of -1 N: the markers spread over 15 mm
    far, y = pressed(100e-3, 2.5e-3, extent=Extent(100e-3))
    assert not {"W601", "E602"} & far.estimate(y).codes
    still = 2e-6 * np.random.default_rng(1).standard_normal(y.shape)
    assert not {"W601", "E602"} & pressed(3e-3, 1e-3, extent=Extent(3e-3))[0].estimate(still).codes


def test_motion_in_the_plane_about_a_small_contact_is_that_of_a_half_space_and_the_force_is_not() -> None:
    s, y = pressed(3e-3, 0.6e-3, "XY", extent=Extent(3e-3))
    found = s.estimate(y)
    assert abs(found.resultant().value[2] + 1) > 0.5
    assert "W601" in found.codes


def test_a_wide_contact_asks_for_the_thickness() -> None:
    s, y = pressed(3e-3, 2.5e-3)
    assert "W601" in s.estimate(y).codes
    s, y = pressed(100e-3, 0.6e-3)
    assert "W601" not in s.estimate(y).codes


def test_markers_under_the_base_are_refused() -> None:
    with pytest.raises(InputError, match="deeper than the pad"):
        pressed(3e-3, 1e-3, extent=Extent(1.2e-3))


def test_a_contact_near_an_edge_is_flagged() -> None:
    layer = Layer(3e-3, 0.147e6, 0.49)
    s = rig((0.5, 1), layer, extent=Extent(size=(20e-3, 20e-3)), count=7)
    wide = rig((0.5, 1), layer, extent=Extent(size=(60e-3, 60e-3)), count=7)
    u = (s.model.H @ truth(7).ravel()).reshape(-1, 3)
    assert "W601" in s.estimate(u).codes
    assert "W601" not in wide.estimate(u).codes
    with pytest.raises(InputError, match="thickness"):
        rig((0.5, 1), extent=Extent(size=(20e-3, 20e-3)), count=5)


@pytest.mark.parametrize("depth", [0.0, -1e-3])
def test_markers_on_the_surface_are_refused(depth: float) -> None:
    at = places(3)
    with pytest.raises(InputError, match="under the surface"):
        GelForce(GROUND, at, Markers(np.column_stack([at, np.full(9, -depth)]), 1e-6, "XYZ"))


@pytest.mark.parametrize("forces", [np.zeros((1, 2)), np.zeros((4, 3)), np.full((4, 2), np.nan)])
def test_places_of_forces(forces: np.ndarray) -> None:
    at = places(3)
    with pytest.raises(InputError):
        GelForce(GROUND, forces, Markers(np.column_stack([at, np.full(9, -1e-3)]), 1e-6, "XYZ"))


def test_the_keywords_of_the_first_version_go_on_working() -> None:
    now = rig((0.5, 1), count=5, extent=Extent(20e-3, 1e-3))
    with pytest.warns(DeprecationWarning, match=r"GelForce, noise=: spelled markers=Markers\(points, noise=\.\.\.\)"):
        before = GelForce(GROUND, places(5), now.markers.points, noise=5e-6, choice=0, penalty=None)
    assert before.markers.axes == "XYZ"
    assert np.array_equal(before.model.H, now.model.H)
    with pytest.warns(DeprecationWarning, match=r"extent=Extent\(thickness=\.\.\., contact_radius=\.\.\.\)"):
        thin = GelForce(GROUND, places(5), now.markers, thickness=5e-3, contact_radius=1e-3)
    assert "W601" in thin.codes
