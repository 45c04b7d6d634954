"""F = K U: exact on its own data, completed by equilibrium, honest about noise, wrong about a thick pad."""

from __future__ import annotations

import numpy as np
import pytest

from structures.errors import InputError
from tactile import ContactLaw, Cylinder, GelSlim, Interpolation, Markers, Pad, Press, Sphere, Wrench
from tactile._pad.stiffness import Completion

from .padtruth import consistent
from .rigs import NOISE, depth, markers, motion, pad


def relative(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def bump(seed: int = 0) -> np.ndarray:
    """Nodal forces on a few nodes."""
    here, rng = pad(1, "standard"), np.random.default_rng(seed)
    f = np.zeros((here.points, 3))
    near = np.hypot(*here.nodes2d.T) < 3e-3
    f[near] = rng.standard_normal((near.sum(), 3)) * 0.02 - [0, 0, 0.05]
    return f


@pytest.mark.parametrize("layers", [1, 3])
def test_a_product_with_the_stiffness_is_exact_on_its_own_data(layers: int) -> None:
    here, f = pad(layers, "standard" if layers == 1 else "bbar"), bump()
    s = GelSlim(here, Markers(here.nodes2d, NOISE, "XYZ"), interpolation="linear")
    assert relative(s.estimate(here.displacements(f)).forces(), f) < 1e-11


def test_reactions_are_no_contact() -> None:
    here, f = pad(1, "standard"), bump()
    found = GelSlim(here, Markers(here.nodes2d, NOISE, "XYZ"), interpolation="linear").estimate(here.displacements(f))
    assert np.allclose(here.reactions(found.forces()).sum(axis=0), -f.sum(axis=0), atol=1e-12)
    assert np.allclose(found.resultant().value, f.sum(axis=0), atol=1e-12)


def test_what_the_markers_do_not_reach_carries_nothing() -> None:
    here, f = pad(1, "standard"), bump()
    inner = np.all(np.abs(here.nodes2d) < [5.1e-3, 4.1e-3], axis=1)
    s = GelSlim(here, Markers(here.nodes2d[inner], NOISE, "XYZ"), interpolation="linear")
    found = s.estimate(here.displacements(f)[inner])
    assert relative(found.forces(), f) < 1e-9
    assert found.facts["outside_hull"] == int(np.sum(~inner))


def test_a_support_carries_all_and_less_noise() -> None:
    here, f = pad(1, "standard"), bump()
    near = np.hypot(*here.nodes2d.T) < 4e-3
    free = GelSlim(here, Markers(here.nodes2d, NOISE, "XYZ"), interpolation="linear")
    s = GelSlim(here, Markers(here.nodes2d, NOISE, "XYZ"), interpolation="linear", contact=ContactLaw(support=near))
    u = here.displacements(f)
    assert relative(s.estimate(u).forces(), f) < 1e-9
    y = u + NOISE * np.random.default_rng(0).standard_normal(u.shape)
    assert not np.any(s.estimate(y).forces()[~near])
    assert relative(s.estimate(y).forces(), f) < 0.7 * relative(free.estimate(y).forces(), f)
    held = GelSlim(
        here,
        Markers(here.nodes2d, NOISE, "XYZ"),
        interpolation="linear",
        contact=ContactLaw(no_pull=True, support=near),
    )
    assert not np.any(held.estimate(y).forces()[~near])
    with pytest.raises(InputError, match="support"):
        GelSlim(here, Markers(here.nodes2d, NOISE, "XYZ"), contact=ContactLaw(support=[-1]))


def test_completion_is_condensation() -> None:
    here = pad(1, "standard")
    known = np.random.default_rng(0).random((here.points, 3)) < 0.5
    part = Completion.of(here, known)
    free = np.flatnonzero(~known.ravel())
    f = np.random.default_rng(1).standard_normal(3 * here.points)
    f[free] = 0.0
    U = here.compliance @ f
    assert relative(part.forces(U[known.ravel()]), f) < 1e-9
    assert relative(part.displacements(U[known.ravel()]), U) < 1e-9


def test_a_sphere_completes_the_normal_motion() -> None:
    here = pad(1, "standard")
    ball = Sphere(radius=8e-3, depth=0.4e-3)
    u = np.zeros((here.points, 2))
    found = GelSlim(here, Markers(here.nodes2d, NOISE), interpolation="linear").estimate(u, indenter=ball)
    force = found.forces()[:, 2]
    touched = force < -1e-9 * np.abs(force).max()
    z = here.displacements(found.forces())[:, 2]
    assert found.provided == {"x": "tracked", "y": "tracked", "z": "completed"}
    assert "N606" in found.codes
    assert np.allclose(z[touched], ball.normal(here.nodes2d)[0][touched], atol=1e-9)  # it lies on the sphere
    assert np.all(found.forces()[:, 2] <= 1e-9 * np.abs(found.forces()).max())  # and pulls nowhere
    rim = 8e-3 - np.sqrt(np.maximum(8e-3**2 - np.sum(here.nodes2d**2, axis=1), 0.0))
    assert np.all(z[~touched] <= -(0.4e-3 - rim[~touched]) + 2e-5)  # and goes through no more than a cell may


@pytest.mark.parametrize(("shape", "where"), [(Sphere, (0.3e-3, 0.0)), (Cylinder, (0.0, 2e-3))])
def test_indenters_are_what_they_are(shape: type, where: tuple[float, float]) -> None:
    z, inside = shape(radius=5e-3, depth=1e-3).normal(np.array([where, (4.9e-3, 4.9e-3)]))
    r = where[0] if shape is Sphere else where[1]
    r = np.hypot(*where) if shape is Sphere else r
    assert z[0] == pytest.approx(-(1e-3 - 5e-3 + np.sqrt(25e-6 - r**2)))
    assert inside.tolist() == [True, False]


def test_the_band_is_that_of_the_noise_and_the_correlation_counts() -> None:
    here = pad(1, "standard")
    m = markers(12, 10)  # coarser than the nodes: what is interpolated shares markers
    s = GelSlim(here, Markers(m, NOISE, "XYZ"))
    rng = np.random.default_rng(0)
    d = 1e-5 * rng.standard_normal((len(m), 3))
    truth = s.estimate(d).load
    draws = np.array([s.estimate(d + NOISE * rng.standard_normal(d.shape)).load for _ in range(200)])
    std = s.estimate(d).std
    seen = std > 0
    inside = np.abs(draws - truth)[:, seen] < 1.96 * std[seen]
    W = Interpolation(m, here.nodes2d, "local").W.toarray()
    alone = NOISE * np.linalg.norm(W, axis=1)  # correlation ignored: every node on its own
    ignored = np.sqrt((np.asarray(s.K.toarray()) ** 2) @ np.repeat(alone**2, 3))
    wrong = np.abs(draws - truth)[:, seen] < 1.96 * ignored[seen]
    print(f"coverage {inside.mean():.3f}, correlation ignored {wrong.mean():.3f}")
    assert 0.92 < inside.mean() < 0.98
    assert not 0.92 < wrong.mean() < 0.98
    assert "W605" in s.estimate(d).codes


def test_the_resultant_has_the_std_of_its_scatter() -> None:
    here, m = pad(1, "standard"), markers(12, 10)
    s, rng = GelSlim(here, Markers(m, NOISE, "XYZ")), np.random.default_rng(0)
    drawn = [s.estimate(NOISE * rng.standard_normal((len(m), 3))).resultant() for _ in range(200)]
    assert np.std([r.value for r in drawn], axis=0) == pytest.approx(drawn[0].std, rel=0.2)


@pytest.mark.parametrize(("nu", "error"), [(0.3223, 0.051), (0.475, 0.057), (0.49, 0.059)])
def test_markers_on_the_nodes_are_not_smoothed(nu: float, error: float) -> None:
    """The map of exact motion under a Hertz press is that of the pad's own stiffness."""
    here = Pad(size=(24e-3, 24e-3), thickness=3e-3, E=147e3, nu=nu, elements=(24, 24), layers=4)
    press = Press(radius=3e-3, force=1.0)
    s = GelSlim(here, Markers(here.nodes2d, NOISE, "XYZ"))
    F, f = s.estimate(press.displacement(here.layer, here.nodes2d)).forces(), consistent(here, press)
    inner = np.all(np.abs(here.nodes2d) < 10e-3 * (1 + 1e-6), axis=1)
    assert relative(F[inner], f[inner]) == pytest.approx(error, abs=2e-3)


def test_the_band_of_markers_on_the_nodes_is_that_of_draws() -> None:
    here, rng = pad(1, "standard"), np.random.default_rng(0)
    s = GelSlim(here, Markers(here.nodes2d, NOISE, "XYZ"))
    u = np.zeros((here.points, 3))
    draws = [s.estimate(NOISE * rng.standard_normal(u.shape)) for _ in range(300)]
    found = s.estimate(u)
    assert np.std([d.load for d in draws], axis=0) == pytest.approx(found.std, rel=0.2)
    assert np.std([d.resultant().value for d in draws], axis=0) == pytest.approx(found.resultant().std, rel=0.1)
    assert "W605" not in found.codes  # every node has a marker of its own


def test_measured_depth_counts_with_its_noise() -> None:
    here = pad()
    s = GelSlim(here, Markers(markers(), NOISE), depth=depth())
    found = s.estimate(motion(1)[:, :2], depth())
    assert found.provided["z"] == "measured"
    assert abs(found.resultant().value[2] + 1) < 0.08
    assert found.resultant().std[2] > 0


def test_measured_depth_brings_its_own_noise_whatever_the_markers_track() -> None:
    plane = GelSlim(pad(), Markers(markers(), NOISE), depth=depth())
    space = GelSlim(pad(), Markers(markers(), [NOISE, NOISE, 1e-4], "XYZ"), depth=depth())
    a, b = plane.estimate(motion(1)[:, :2], depth()), space.estimate(motion(1), depth())
    assert np.allclose(a.std, b.std, rtol=1e-9, atol=0)
    with pytest.raises(InputError, match="friction"):
        GelSlim(pad(), Markers(markers(), NOISE), contact=ContactLaw(friction=-1.0))


def test_projection_is_taken_off_with_the_normal_motion() -> None:
    here = pad()
    slope = np.tile([0.3, -0.2], (len(markers()), 1))
    apparent = motion()[:, :2] + slope * motion()[:, 2:]
    right = GelSlim(here, Markers(markers(), NOISE, slope=slope), depth=depth(noise=1e-8))
    blind = GelSlim(here, Markers(markers(), NOISE), depth=depth(noise=1e-8))
    plain = blind.estimate(motion()[:, :2], depth(noise=1e-8)).resultant().value
    assert np.allclose(right.estimate(apparent, depth(noise=1e-8)).resultant().value, plain, atol=0.02)
    assert abs(blind.estimate(apparent, depth(noise=1e-8)).resultant().value[0] - plain[0]) > 0.05


def test_constraints_and_a_force_sensor() -> None:
    s = GelSlim(pad(), Markers(markers(), NOISE, "XYZ"), contact=ContactLaw(friction=0.6))
    t = s.estimate(motion(1)).forces()
    assert np.all(np.hypot(t[:, 0], t[:, 1]) <= -0.6 * t[:, 2] + 1e-6 * np.abs(t).max())
    free = GelSlim(pad(), Markers(markers(), NOISE, "XYZ"))
    found = free.estimate(motion(1), wrench=Wrench([0.3, 0.0, -1.1]))
    assert np.allclose(found.resultant().value, [0.3, 0.0, -1.1], atol=1e-9)


def test_lost_markers_are_left_out() -> None:
    y = motion(1).copy()
    y[[40, 97]] = np.nan
    s = GelSlim(pad(), Markers(markers(), NOISE, "XYZ"))
    assert relative(s.estimate(y).forces(), s.estimate(motion(1)).forces()) < 0.2
    assert s.estimate(y).facts["lost"] == 6


def test_in_plane_markers_alone_are_not_enough() -> None:
    with pytest.raises(InputError, match="normal motion is not known"):
        GelSlim(pad(), Markers(markers(), NOISE)).estimate(motion()[:, :2])


@pytest.mark.parametrize("bad", [{"depth": 9e-3}, {"depth": -1e-3}, {"at": (np.nan, 0.0)}])
def test_impossible_spheres(bad: dict) -> None:
    with pytest.raises(InputError):
        Sphere(**{"radius": 5e-3, "depth": 1e-3, **bad})


def test_another_noise_leaves_the_forces_and_scales_their_std() -> None:
    here, f = pad(3, "bbar"), bump()
    slope = np.tile([0.1, -0.05], (here.points, 1))
    first = GelSlim(here, Markers(here.nodes2d, NOISE, slope=slope))
    other = first.with_noise(3 * NOISE)
    seen = here.displacements(f)[:, :2]
    ball = Sphere(radius=8e-3, depth=0.2e-3, at=(0.0, 0.0))
    a, b = first.estimate(seen, indenter=ball), other.estimate(seen, indenter=ball)
    fresh = GelSlim(here, Markers(here.nodes2d, 3 * NOISE, slope=slope)).estimate(seen, indenter=ball)
    assert np.array_equal(b.load, fresh.load)
    assert np.array_equal(b.std, fresh.std)
    assert np.array_equal(a.load, b.load)
    np.testing.assert_allclose(b.std, 3 * np.asarray(a.std), rtol=1e-12)
    assert np.array_equal(first.markers.noise, np.full((here.points, 2), NOISE))  # the first is as it was
    with pytest.raises(InputError, match="stds > 0"):
        first.with_noise(-NOISE)
