"""The contact prior, the motion of the image, and the bands: against dense formulas, and on a mesh that is finer."""

from __future__ import annotations

import pickle
from functools import cache

import numpy as np
import pytest

from structures.errors import InputError
from tactile import (
    ContactLaw,
    ContactPrior,
    ForceMap,
    ImageMotion,
    Markers,
    MultilayerPad,
    Pad,
    Press,
    Tolerances,
    Wrench,
)
from tactile._results.forcemap import record
from tactile._sensors import posing

from .padtruth import consistent
from .rigs import NO_PULL, NOISE, depth, markers, motion, nodal, pad


@cache
def made(choice: float | None = 0.03, axes: str = "XYZ", **settings: object) -> MultilayerPad:
    return MultilayerPad(pad(), Markers(markers(), NOISE, axes), choice=choice, **settings)  # type: ignore[arg-type]


def relative(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def codes(found: ForceMap) -> set[str]:
    return {f.code.removeprefix("LID-") for f in found.flags}


def rigid(shift: tuple[float, float], turn: float = 0.0) -> np.ndarray:
    x, y = markers().T
    return np.column_stack([shift[0] - turn * y, shift[1] + turn * x, np.zeros(len(x))])


def dense(s: MultilayerPad, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gain, whitened operator and prior of some readings, by dense matrices and nothing of the sensor's own algebra."""
    assert s.problem is not None
    P, x = s.problem, s.inverse.lam * s.inverse.scale
    C = np.kron(P.prior.matrix, np.diag(P.prior.share))
    H = P.H[rows] / P.noise[rows, None]
    S = H @ C @ H.T + x**2 * np.eye(len(H))
    for error in P.errors():
        change = error.weight * error.change[rows] / P.noise[rows, None]
        S = S + change @ C @ change.T
    return C @ H.T @ np.linalg.inv(S), H, C


# -- the prior --------------------------------------------------------------------------------------------------------
def test_the_correlation_is_that_of_presses_on_a_grid() -> None:
    """Autocorrelations of flat and of round presses by FFT, over the radii of the ensemble."""
    low, high, step = 0.5e-3, 2e-3, 0.02e-3
    n = 512
    x = (np.arange(n) - n // 2) * step
    r = np.hypot(*np.meshgrid(x, x))
    total = np.zeros(n)
    for a in np.geomspace(low, high, 12):
        flat = (r < a) * 1.0
        round_ = 1.5 * np.sqrt(np.clip(1 - (r / a) ** 2, 0, None))
        for p in (flat, round_):  # of one force, over its radius
            q = p / p.sum() * a
            total += np.fft.ifft2(np.abs(np.fft.fft2(q)) ** 2).real[0] / 1.0
    expected = total / total[0]
    found = ContactPrior((low, high)).correlation(np.arange(n // 2) * step, 3e-3)
    assert np.abs(found - expected[: n // 2]).max() < 0.02


def test_presses_are_more_likely_than_what_is_none() -> None:
    """Energy of tractions in the metric of the prior, for a press and for as much of single nodes."""
    s = made()
    assert s.problem is not None
    C = s.problem.prior.matrix + 0.0
    press = np.sqrt(np.clip(1 - np.sum(pad().nodes2d ** 2, axis=1) / 2.5e-3**2, 0, None))
    single = press[np.random.default_rng(0).permutation(len(press))]
    energy = [float(p @ np.linalg.solve(C, p)) for p in (press, single)]
    assert energy[0] < 0.25 * energy[1]


@pytest.mark.parametrize("make", [lambda: ContactPrior((2e-3, 1e-3)), lambda: ContactPrior((0.0, 1e-3)),
                                  lambda: ContactPrior(shear=0.0), lambda: ImageMotion(shift=-1e-6),
                                  lambda: ImageMotion(offset=0.0)])  # fmt: skip
def test_what_is_no_prior_is_one_clear_error(make: object) -> None:
    with pytest.raises(InputError):
        make()  # type: ignore[operator]


# -- the answer -------------------------------------------------------------------------------------------------------
def test_the_answer_is_that_of_dense_matrices() -> None:
    s, y = made(image=None), motion(1).ravel()
    G, H, C = dense(s, np.arange(len(y)))
    found = s.follow(motion(1))  # the product alone
    assert relative(found.load, G @ (y / NOISE)) < 1e-8
    left = np.eye(len(C)) - G @ H
    assert s.inverse.band is not None
    assert np.allclose(s.inverse.band.unseen * s.inverse.band.prior.variance, np.diag(left @ C @ left.T), rtol=1e-6)
    assert np.allclose(s.inverse.band.noise, np.sum(G**2, axis=1), rtol=1e-8)


def test_lost_markers_are_as_if_they_were_not_there() -> None:
    s, y = made(image=None), motion(1).copy()
    y[[40, 41, 97, 100]] = np.nan
    kept = np.flatnonzero(np.isfinite(y.ravel()))
    found = s.follow(y)
    assert relative(found.load, dense(s, kept)[0] @ (y.ravel()[kept] / NOISE)) < 1e-7
    assert np.all(found.std >= 0.999 * s.follow(motion(1)).std.min())


def test_frozen_and_chosen_agree_at_one_lambda() -> None:
    chosen = made(None).estimate(motion(1))
    assert chosen.choice is not None
    frozen = made(float(chosen.choice.lam)).estimate(motion(1))
    assert relative(frozen.load, chosen.load) < 1e-8
    assert relative(frozen.std, chosen.std) < 1e-6
    assert chosen.residual is not None
    assert np.sqrt(np.mean(chosen.residual**2)) < 0.1 * np.sqrt(np.mean(motion() ** 2))


def test_calibration_is_kept_and_of_all_presses() -> None:
    s = MultilayerPad(pad(), Markers(markers(), NOISE, "XYZ"))
    found = s.calibrate([motion(1), motion(2)])
    assert s.frozen
    assert s.estimate(motion(3)).facts["lambda"] == found.lam
    assert found.rule == "middle"


def test_a_force_sensor_tells_which_rule_is_right() -> None:
    s = MultilayerPad(pad(), Markers(markers(), NOISE, "XYZ"))
    force = nodal().sum(axis=0)
    told = s.calibrate([motion(1), motion(2)], wrenches=[Wrench(force), Wrench(force)])
    assert told.rule in ("upre", "gcv", "evidence")
    assert np.abs(s.estimate(motion(3)).resultant().value - force).max() < 0.03
    with pytest.raises(InputError, match="wrenches"):
        s.calibrate([motion(1), motion(2)], wrenches=[Wrench(force)])


def test_rules_that_lie_decades_apart_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    assert posing._apart([1e-6, 1e-3, 1.0]) == pytest.approx(3.0)
    assert posing._apart([1e-6, 2e-2, 1e-2]) == pytest.approx(np.log10(2))
    s = MultilayerPad(pad(), Markers(markers(), NOISE, "XYZ"))
    monkeypatch.setattr(posing, "APART", -1.0)  # as if no two of them agreed
    with pytest.raises(InputError, match=r"decades apart.*upre"):
        s.calibrate([motion(1)])
    assert not s.frozen


def test_the_force_does_not_depend_on_its_unit_or_size() -> None:
    small, large = (made(None).estimate(f * motion()).resultant().value / f for f in (1.0, 3.0))
    assert np.allclose(small, large, rtol=0.02, atol=2e-3)


def test_pulling_nodes_are_let_go_under_the_prior() -> None:
    """First-order conditions of the answer that only presses, in the metric of the prior."""
    s = made(contact=NO_PULL, image=None)
    found = s.estimate(motion(1))
    p = -found.load[2::3]
    assert p.min() >= -1e-9 * p.max()
    assert np.abs(found.resultant().value - nodal().sum(axis=0)).max() < 0.05
    assert np.all(np.abs(found.resultant().value - nodal().sum(axis=0)) < 3 * found.resultant().std)


def test_a_measured_force_narrows_the_band() -> None:
    s, told = made(), Wrench([0.25, 0.0, -1.0], std=[1e-3, 1e-3, 1e-3])
    plain, known = s.estimate(motion(1)), s.estimate(motion(1), wrench=told)
    assert np.all(known.resultant().std < plain.resultant().std)
    assert np.all(known.resultant().std < 1e-3)
    assert np.all(np.abs(known.resultant().value - told.force) < 3e-3)
    exact = s.estimate(motion(1), wrench=Wrench([0.25, 0.0, -1.0])).resultant()
    assert np.allclose(exact.value, (0.25, 0.0, -1.0), atol=1e-9)
    assert np.all(exact.std < 1e-6)


def test_a_support_carries_all_under_the_prior() -> None:
    near = np.hypot(*(pad().nodes2d - PRESS_AT).T) < 4e-3
    found = MultilayerPad(
        pad(), Markers(markers(), NOISE, "XYZ"), choice=0.03, contact=ContactLaw(support=near)
    ).estimate(motion(1))
    assert not np.any(found.traction()[~near])
    assert abs(found.resultant().value[2] + 1.0) < 0.05


PRESS_AT = np.array([0.4e-3, -0.3e-3])


# -- the image --------------------------------------------------------------------------------------------------------
@cache
def wide() -> tuple[Pad, np.ndarray, np.ndarray]:
    """A pad of 22 x 20 x 3 mm, its markers, and their motion under a press beside the middle: 0.2 N, 60 um at most."""
    here = Pad(size=(22e-3, 20e-3), thickness=3e-3, E=147e3, nu=0.3223, elements=(22, 20), layers=3)
    x, y = np.meshgrid(np.linspace(-10e-3, 10e-3, 21), np.linspace(-9e-3, 9e-3, 19))
    places = np.column_stack([x.ravel(), y.ravel()])
    press = Press(at=(1.1e-3, -0.7e-3), radius=2e-3, force=0.2, shear=(0.05, 0.0))
    u = press.displacement(here.layer, places)
    return here, places, u + NOISE * np.random.default_rng(1).standard_normal(u.shape)


@pytest.mark.parametrize("axes", ["XY", "XYZ"])
@pytest.mark.parametrize("shift", [18e-6, 71e-6])
def test_a_moved_image_is_found_and_taken_out(axes: str, shift: float) -> None:
    (here, places, y), k = wide(), len(axes)
    s = MultilayerPad(here, Markers(places, NOISE, axes), choice=0.03)
    x, z = places.T
    slip = np.column_stack([shift - 1e-3 * z, -shift / 2 + 1e-3 * x, 0 * x])
    still, moved = s.estimate(y[:, :k]), s.estimate((y + slip)[:, :k])
    assert "W611" in codes(moved)
    assert "W611" not in codes(still)
    away = np.abs(moved.resultant().value - still.resultant().value)
    assert np.all(away[:2] < 0.004)  # two hundredths of the normal force
    assert moved.facts.image is not None
    assert np.allclose(moved.facts.image[:2], (shift, -shift / 2), atol=3e-6)


@pytest.mark.parametrize("axes", ["XY", "XYZ"])
def test_an_untouched_pad_that_slips_carries_nothing(axes: str) -> None:
    s = made(axes=axes)
    noise = NOISE * np.random.default_rng(3).standard_normal((len(markers()), 3))
    for shift in (0.0, 17e-6, 71e-6):
        found = s.estimate((rigid((shift, 0.0)) + noise)[:, : len(axes)])
        assert ("W611" in codes(found)) == (shift > 0)
        force = found.resultant()
        assert np.all(np.abs(force.value[:2]) < 3 * force.std[:2] + 1e-4)
        assert np.all(np.abs(force.value[:2]) < 0.01)


def test_creep_of_all_markers_is_no_load() -> None:
    here, places, y = wide()
    s = MultilayerPad(here, Markers(places, NOISE, "XYZ"), choice=0.03, image=ImageMotion(offset=2e-5))
    still, crept = s.estimate(y), s.estimate(y + 5e-6)
    assert np.all(np.abs(crept.resultant().value - still.resultant().value) < 0.004)


def test_a_wrench_is_met_under_constraints_and_without_a_load() -> None:
    told = Wrench([0.2, 0.05, -0.9], std=[1e-3, 1e-3, 1e-3])
    for law in (NO_PULL, ContactLaw(friction=0.8)):
        found = made(contact=law).estimate(motion(1), wrench=told).resultant()
        assert np.all(np.abs(found.value - told.force) < 4 * found.std + 5e-3)
    nothing = made().estimate(0 * motion(), wrench=Wrench([0.2, 0.05, -0.9])).resultant()
    assert np.allclose(nothing.value, (0.2, 0.05, -0.9), atol=1e-9)


def test_what_a_contact_prior_cannot_do_is_said_and_costs_nothing() -> None:
    with pytest.raises(InputError, match="above zero"):
        made(0.0).estimate(motion(1))
    s = MultilayerPad(pad(), Markers(markers(), NOISE, "XYZ"))
    lam = s.calibrate([motion(1)]).lam
    with pytest.raises(InputError):
        s.calibrate([motion(1)], wrenches=[])
    assert s.estimate(motion(1)).facts["lambda"] == lam
    again = pickle.loads(pickle.dumps(s))
    assert np.array_equal(again.estimate(motion(2)).load, s.estimate(motion(2)).load)


def test_a_noise_that_is_stated_too_low_moves_no_image() -> None:
    s = made()
    noise = 4 * NOISE * np.random.default_rng(5).standard_normal((len(markers()), 3))
    found = s.estimate(noise)
    assert "W611" not in codes(found)
    assert np.all(np.abs(found.resultant().value) < 4 * found.resultant().std + 1e-3)


def test_frames_of_a_record_keep_their_noise() -> None:
    maps = [made().estimate(k * motion(k)) for k in (1, 2)]
    together = record(maps)
    for k, one in enumerate(maps):
        assert np.allclose(together.frame(k).pressure_noise(), one.pressure_noise())


def test_a_drifting_depth_map_is_no_press() -> None:
    s = MultilayerPad(pad(), Markers(markers(), NOISE), depth=depth(), choice=0.03, image=ImageMotion(offset=2e-5))
    clean, drifted = depth(), depth()
    object.__setattr__(drifted, "values", drifted.values + 1e-5)
    a, b = (s.estimate(motion(1)[:, :2], d).resultant().value for d in (clean, drifted))
    assert np.all(np.abs(a - b) < 0.02)


def test_what_cannot_be_told_from_a_load_is_in_the_band() -> None:
    """A press of half the pad's width: the shear may be a shift."""
    wide = Press(at=(0.0, 0.0), radius=5e-3, force=2.0, shear=(0.5, 0.0))
    y = wide.displacement(pad().layer, markers())
    found, fast = made().follow(y).resultant(), made(image=None).follow(y).resultant()
    assert found.std[0] > fast.std[0]
    about = made().estimate(y).resultant()
    assert abs(about.value[0] - 0.5) < 2 * about.std[0]


# -- bands ------------------------------------------------------------------------------------------------------------
@cache
def finer() -> Pad:
    return Pad(size=(14e-3, 12e-3), thickness=3e-3, E=147e3, nu=0.45, pitch=0.375e-3, layers=6)


@pytest.fixture(scope="module")
def foreign() -> list[tuple[Press, np.ndarray, np.ndarray]]:
    """Presses on a pad of half the pitch: motion of the markers, force."""
    rng, out = np.random.default_rng(7), []
    for _ in range(12):
        turn, share = rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.4)
        at, radius = rng.uniform(-1, 1, 2) * (2.5e-3, 1.5e-3), rng.uniform(0.9e-3, 2.5e-3)
        press = Press(at=tuple(at), radius=radius, force=1.0, shear=(share * np.cos(turn), share * np.sin(turn)))
        f = consistent(finer(), press, 4)
        U = finer().displacements(f)
        scale = rng.uniform(0.05e-3, 0.2e-3) / np.abs(U[:, 2]).max()
        u = scale * np.asarray(finer().from_surface(markers()) @ U.ravel()).reshape(-1, 3)
        out.append((press, u + NOISE * rng.standard_normal(u.shape), scale * f.sum(axis=0)))
    return out


@cache
def coarse(**settings: object) -> MultilayerPad:
    here = Pad(size=(14e-3, 12e-3), thickness=3e-3, E=147e3, nu=0.45)
    return MultilayerPad(here, Markers(markers(), NOISE, "XYZ"), **settings)  # type: ignore[arg-type]


def test_bands_hold_on_a_mesh_that_is_not_the_pad_s(foreign: list[tuple[Press, np.ndarray, np.ndarray]]) -> None:
    s, held, covered = coarse(), [], []
    for press, y, force in foreign:
        found = s.estimate(y)
        wrench = found.resultant()
        away = np.abs(wrench.value - force)
        held.append(away <= np.maximum(1.96 * wrench.std, 0.05 * np.linalg.norm(force)))
        true = press.traction(s.pad.nodes2d) * -force[2]
        under = true[:, 2] < 0.05 * true[:, 2].min()
        covered.append((np.abs(found.traction() - true) <= 1.96 * found.std.reshape(-1, 3))[under].mean())
    assert np.mean(held) > 0.9
    assert 0.85 < np.mean(covered) <= 1.0


def test_the_error_of_the_mesh_is_told_by_half_of_it() -> None:
    """Motion under nodal forces on a pad of half the elements and layers, each force shared by its cell."""
    s = coarse(choice=0.03)
    assert s.problem is not None
    (mesh,) = s.problem.errors()
    half = Pad(size=(14e-3, 12e-3), thickness=3e-3, E=147e3, nu=0.45, elements=(10, 8), layers=2, allow=("W115",))
    assert s.pad.elements is not None
    assert tuple(round(n / 2) for n in s.pad.elements) == (10, 8)
    press = Press(at=(0.0, 0.0), radius=2e-3, force=0.1).traction(s.pad.nodes2d)
    forces, shared = np.asarray(s.pad.surface.mass @ press), np.zeros((half.points, 3))
    for axis in range(3):
        shared[:, axis] = np.asarray(half.rows(s.pad.nodes2d)[axis::3, half.dofs[axis::3]].T @ forces[:, axis])
    assert np.allclose(shared.sum(axis=0), forces.sum(axis=0))
    u = np.asarray(half.from_surface(markers()) @ half.displacements(shared).ravel())
    assert relative(mesh.change @ press.ravel() / 0.4, u - s.model.H @ press.ravel()) < 1e-8
    exact = s.inverse.band
    assert exact is not None
    assert exact.errors[0].spread.max() > 0
    assert np.abs(exact.errors[0].rows @ press.ravel())[2] > 1e-5


def test_noise_scatters_forces_as_the_band_says() -> None:
    s = made(image=None)
    assert s.inverse.band is not None
    noise = NOISE * np.random.default_rng(11).standard_normal((400, 3 * len(markers())))
    scatter = (noise / NOISE) @ (s.resultant @ s.inverse.matrix).T
    stated = np.sqrt(np.diag(s.inverse.band.covariance(np.zeros(len(s.loads)), 1.0)))
    assert np.allclose(np.std(scatter, axis=0), stated, rtol=0.12)
    doubled = np.sqrt(np.diag(s.inverse.band.covariance(np.zeros(len(s.loads)), 2.0)))
    assert np.allclose(doubled, 2 * stated)


def test_declared_tolerances_widen_the_band(foreign: list[tuple[Press, np.ndarray, np.ndarray]]) -> None:
    _, y, force = foreign[0]
    plain = coarse(choice=0.03).estimate(y).resultant()
    stated = coarse(choice=0.03, tolerances=Tolerances(E=0.1, nu=0.02, thickness=0.05)).estimate(y).resultant()
    assert np.allclose(stated.value, plain.value, rtol=0.1, atol=0.1 * abs(force[2]))
    assert stated.std[2] > 0.1 * abs(stated.value[2])
    assert stated.std[2] > plain.std[2]


def test_in_plane_markers_say_that_pressure_is_hardly_seen(
    foreign: list[tuple[Press, np.ndarray, np.ndarray]],
) -> None:
    here = Pad(size=(14e-3, 12e-3), thickness=3e-3, E=147e3, nu=0.45)
    s = MultilayerPad(here, Markers(markers(), NOISE, "XY"))
    for _, y, force in foreign[:4]:
        found = s.estimate(y[:, :2])
        assert "W608" in codes(found)
        assert abs(found.resultant().value[2] - force[2]) < 2.5 * found.resultant().std[2]
