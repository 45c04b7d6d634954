"""Sensors with one face: frozen and thorough agree, lost markers cost themselves, what a force sensor says is met."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loadid import StaticInversion
from structures.errors import InputError
from tactile import ContactLaw, DepthMap, ForceMap, GelSlim, Markers, MultilayerPad, Press, Wrench
from tactile._sensors.observation import Depths

from .rigs import NO_PULL, NOISE, PRESS, depth, markers, motion, nodal, pad, sensor


def relative(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def dense(s: MultilayerPad, y: np.ndarray, keep: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Load and std of the readings that are kept, by stacked least squares."""
    spread = np.array([c.noise for c in s.model.sensors])
    lam = s.inverse.lam * s.inverse.scale
    A = np.vstack([s.model.H[keep] / spread[keep, None], lam * np.eye(s.model.H.shape[1])])
    b = np.concatenate([y[keep] / spread[keep], np.zeros(s.model.H.shape[1])])
    load = np.linalg.lstsq(A, b, rcond=None)[0]
    R = np.linalg.qr(A, mode="r")
    return load, np.linalg.norm(np.linalg.solve(R, np.eye(len(R))), axis=1)


def test_a_noise_free_motion_gives_the_forces_back() -> None:
    found = sensor(1e-7).estimate(motion())
    assert relative(found.forces(), nodal()) < 1e-6
    assert np.allclose(found.resultant().value, nodal().sum(axis=0), rtol=1e-8)


def test_the_quick_answer_is_that_of_dense_least_squares() -> None:
    s, y = sensor(), motion(1).ravel()
    found = s.estimate(motion(1))
    load, std = dense(s, y, np.ones(len(y), bool))
    assert relative(found.load, load) < 1e-9
    assert relative(found.std, std) < 1e-9


def test_quick_and_thorough_agree() -> None:
    s = sensor()
    quick = s.estimate(motion(1))
    whole = StaticInversion(s.model, choice=s.inverse.lam).estimate(motion(1).ravel())
    assert relative(quick.load, whole.load) < 1e-9
    assert (
        relative(s.inverse.hidden(quick.load)[:3], s.resultant[:3] @ np.zeros(len(quick.load)) + _bias(s, quick)) < 1e-6
    )


def _bias(s: MultilayerPad, found: ForceMap) -> np.ndarray:
    """What the inverse makes of the response of its own answer, less that answer: its resultant."""
    again = s.estimate((s.model.H @ found.load).reshape(-1, 3))
    return s.resultant[:3] @ (again.load - found.load)


def test_lost_markers_cost_themselves_and_nothing_else() -> None:
    s, y = sensor(), motion(1).copy()
    y[[40, 41, 97, 100]] = np.nan
    found = s.estimate(y)
    keep = np.isfinite(y.ravel())
    load, std = dense(s, y.ravel(), keep)
    assert relative(found.load, load) < 1e-8
    assert relative(found.std, std) < 1e-8
    assert np.all(found.std >= s.estimate(motion(1)).std - 1e-9 * found.std.max())
    assert found.facts["lost"] == 12


def test_lost_markers_where_lambda_is_chosen_on_the_frame() -> None:
    y = motion(1).copy()
    y[[40, 41, 97, 100]] = np.nan
    s = MultilayerPad(pad(), Markers(markers(), NOISE, "XYZ"), penalty="identity")
    found = s.estimate(y)
    assert found.choice is not None
    keep = np.isfinite(y.ravel())
    lam = found.choice.lam * found.choice.scale
    A = np.vstack([s.model.H[keep] / NOISE, lam * np.eye(s.model.H.shape[1])])
    b = np.concatenate([y.ravel()[keep] / NOISE, np.zeros(s.model.H.shape[1])])
    assert relative(found.load, np.linalg.lstsq(A, b, rcond=None)[0]) < 1e-7
    assert found.facts["lost"] == 12


def test_calibration_that_is_refused_changes_nothing() -> None:
    s = MultilayerPad(pad(), Markers(markers(), NOISE, "XYZ"), choice=0.02, penalty="identity")
    with pytest.raises(InputError):
        s.calibrate([np.full((195, 3), np.nan)])
    assert s.inverse.lam == 0.02
    assert s.calibrate([motion(1)]).lam != 0.02


def test_a_lost_axis_loses_the_marker() -> None:
    y = motion(1).copy()
    y[7, 1] = np.nan
    assert sensor().estimate(y).facts["lost"] == 3


@pytest.mark.parametrize("radius", [1e-3, 1.5e-3, 3e-3])
def test_the_markers_of_a_real_contact_are_no_strays(radius: float) -> None:
    press = Press(at=PRESS.at, radius=radius, force=1.0, shear=(0.25, 0.0))
    u = press.displacement(pad().layer, markers())
    u *= 0.3e-3 / np.abs(u).max()
    y = u + NOISE * np.random.default_rng(0).standard_normal(u.shape)
    for lam in (0.003, 0.03):
        assert sensor(lam).estimate(y).facts["strays"] <= (1 if radius < 1.5e-3 else 0)


def test_two_dots_that_were_swapped_are_both_left_out() -> None:
    y = motion(1).copy()
    places = markers()
    apart = np.append(places[101] - places[100], 0.0)
    y[100], y[101] = y[101] + apart, y[100] - apart  # each is where the other is
    assert sensor().estimate(y).facts["strays"] == 2


def test_rows_in_another_order_are_said_and_widen_the_band() -> None:
    y = motion(1)[np.random.default_rng(0).permutation(195)]
    found = sensor().estimate(y)
    assert "W406" in found.codes
    assert found.std.mean() > 3 * sensor().estimate(motion(1)).std.mean()
    assert "W406" not in sensor().estimate(motion(1)).codes


def test_a_dot_taken_for_its_neighbour_is_left_out() -> None:
    y = motion(1).copy()
    y[100] += [0.9e-3, 0.0, 0.0]
    found, clean = sensor().estimate(y), sensor().estimate(motion(1))
    assert found.facts["strays"] == 1
    assert "W604" in found.codes
    assert relative(found.forces(), nodal()) < 1.2 * relative(clean.forces(), nodal())
    assert clean.facts["strays"] == 0


def test_units_of_force_do_not_matter() -> None:
    stiff = MultilayerPad(
        replace(pad(), E=147e9, material="any"), Markers(markers(), NOISE, "XYZ"), choice=0.01, penalty="identity"
    )
    soft = sensor().estimate(motion(1))
    assert relative(stiff.estimate(motion(1)).load, 1e6 * soft.load) < 1e-9


@pytest.mark.parametrize("count", [3, 6])
def test_a_resultant_is_met_exactly(count: int) -> None:
    s = sensor()
    truth = s.geometry["resultant"] @ s.estimate(motion()).load
    given = Wrench(1.1 * truth[:3], None if count == 3 else truth[3:] + 1e-5)
    found = s.estimate(motion(1), wrench=given)
    assert np.allclose(found.resultant().value, given.force, atol=1e-9)
    assert np.all(found.resultant().std < 1e-6 * s.estimate(motion(1)).resultant().std)
    if given.torque is not None:
        assert np.allclose(found.torque().value, given.torque, atol=1e-12)


def test_a_measured_resultant_weighs_like_rows_of_data() -> None:
    s, spread = sensor(), np.array([0.02, 0.03, 0.01])
    given = Wrench([0.3, 0.05, -1.2], std=spread)
    found = s.estimate(motion(1), wrench=given)
    noise = np.array([c.noise for c in s.model.sensors])
    n, lam = s.model.H.shape[1], s.inverse.lam * s.inverse.scale
    A = np.vstack([s.model.H / noise[:, None], s.resultant[:3] / spread[:, None], lam * np.eye(n)])
    b = np.concatenate([motion(1).ravel() / noise, given.force / spread, np.zeros(n)])
    assert relative(found.load, np.linalg.lstsq(A, b, rcond=None)[0]) < 1e-7


def test_a_measured_resultant_counts_when_markers_are_lost() -> None:
    s, y = sensor(), motion(1).copy()
    y[[40, 41, 97, 100]] = np.nan
    found = s.estimate(y, wrench=Wrench([0.25, 0.0, -1.0]))
    assert np.allclose(found.resultant().value, [0.25, 0.0, -1.0], atol=1e-9)


def test_no_pull_and_friction_hold() -> None:
    free = sensor().estimate(motion(1))
    pressed = sensor(contact=NO_PULL).estimate(motion(1))
    held = sensor(contact=ContactLaw(friction=0.3)).estimate(motion(1))
    assert free.pressure().min() < -1e-3 * free.pressure().max()
    assert pressed.pressure().min() >= -1e-9 * pressed.pressure().max()
    t = held.traction()
    assert np.all(np.hypot(t[:, 0], t[:, 1]) <= 0.3 * -t[:, 2] + 1e-6 * np.abs(t).max())
    assert relative(pressed.forces(), nodal()) < relative(free.forces(), nodal())


def test_the_constrained_answer_is_that_of_an_interior_point_solver() -> None:
    from scipy.optimize import lsq_linear

    s = sensor(contact=NO_PULL)
    found = s.estimate(motion(1))
    region = s._quick[True]._region._state[0]
    assert region is not None
    noise, lam = NOISE, s.inverse.lam * s.inverse.scale
    A = np.vstack([s.model.H[:, region.columns] / noise, lam * np.eye(len(region.columns))])
    b = np.concatenate([motion(1).ravel() / noise, np.zeros(len(region.columns))])
    upper = np.tile([np.inf, np.inf, 0.0], len(region.nodes))
    other = lsq_linear(A, b, bounds=(-np.inf, upper), tol=1e-12).x
    assert relative(found.load[region.columns], other) < 1e-5


def test_a_resultant_is_met_under_friction() -> None:
    found = sensor(contact=ContactLaw(friction=0.6)).estimate(motion(1), wrench=Wrench([0.2, 0.0, -1.05]))
    assert np.allclose(found.resultant().value, [0.2, 0.0, -1.05], atol=1e-7)


def test_what_is_not_touched_carries_nothing() -> None:
    rng = np.random.default_rng(0)
    found = sensor(contact=NO_PULL).estimate(NOISE * rng.standard_normal((len(markers()), 3)))
    assert np.count_nonzero(found.load) < 0.1 * found.load.size


def test_frames_start_warm_and_give_the_same() -> None:
    s = MultilayerPad(
        pad(), Markers(markers(), NOISE, "XYZ"), choice=0.01, contact=ContactLaw(friction=0.5), penalty="identity"
    )
    cold = s.estimate(motion(1)).load
    s.estimate(1.3 * motion(2))
    assert relative(s.estimate(motion(1)).load, cold) < 1e-8


def test_a_support_carries_all() -> None:
    here = pad()
    near = np.hypot(*(here.nodes2d - np.array(PRESS.at)).T) < 4e-3
    s = MultilayerPad(
        here, Markers(markers(), NOISE, "XYZ"), choice=0.01, contact=ContactLaw(support=near), penalty="identity"
    )
    found = s.estimate(motion(1))
    assert np.all(found.forces()[~_touching(near)] == 0)
    assert relative(found.forces(), nodal()) < relative(sensor().estimate(motion(1)).forces(), nodal())
    assert found.traction().shape == (here.points, 3)


def _touching(nodes: np.ndarray) -> np.ndarray:
    """Nodes that share a cell with some."""
    cells = pad().surface.cells
    out = nodes.copy()
    out[cells[nodes[cells].any(axis=1)].ravel()] = True
    return out


def test_depth_is_measured_and_its_absence_is_said() -> None:
    s = MultilayerPad(pad(), Markers(markers(), NOISE), depth=depth(), choice=0.01, penalty="identity")
    y = motion(1)[:, :2]
    both, alone = s.estimate(y, depth()), s.estimate(y)
    assert both.provided["z"] == "measured"
    assert alone.provided["z"] == "completed"
    assert "N606" in alone.codes
    assert "N606" not in both.codes
    assert abs(both.resultant().value[2] + 1) < 0.06
    assert abs(alone.resultant().value[2] + 1) > 0.5
    assert alone.resultant().std[2] > 5 * both.resultant().std[2]


def test_depth_windows_average_what_the_pad_does() -> None:
    here, noise = pad(), 1e-5
    window = Depths(depth(noise=noise), here.nodes2d[~here.edge], 1e-3)
    U = np.random.default_rng(0).standard_normal(3 * here.points) * 1e-5
    rows = window.rows(here.from_surface(window.samples))
    fine = 1e-3 * (np.arange(20) + 0.5) / 20 - 0.5e-3
    x, y = np.meshgrid(fine, fine)
    for k in (10, 77):
        places = window.points[k] + np.column_stack([x.ravel(), y.ravel()])
        assert rows[k] @ U == pytest.approx(np.mean((here.from_surface(places) @ U)[2::3]), rel=1e-3)
    assert window.averaging.std(noise)[50] == pytest.approx(noise / 5, rel=0.1)


@pytest.mark.parametrize("count", [60, 61, 71])
def test_windows_lie_on_their_nodes_whatever_the_pixels(count: int) -> None:
    pixel = 12e-3 / count
    line = (np.arange(count) - (count - 1) / 2) * pixel
    x, y = np.meshgrid(line, line)
    tilted = DepthMap(1e-2 * x - 3e-2 * y + 1e-4, pixel, 1e-6)
    at = np.array([[0.0, 0.0], [1e-3, -2e-3], [3.3e-3, 1.1e-3], [5.9e-3, 0.0]])
    window = Depths(tilted, at, 1e-3)
    assert window.inside.tolist() == [True, True, True, False]  # the last reaches beyond the map
    assert np.allclose(window.readings(tilted), at[:3] @ [1e-2, -3e-2] + 1e-4, rtol=0, atol=1e-7)
    noisy = np.random.default_rng(0).standard_normal((400, count, count)) * 1e-6
    drawn = [window.readings(DepthMap(z, pixel, 1e-6)) for z in noisy]
    assert np.std(drawn, axis=0) == pytest.approx(window.averaging.std(1e-6), rel=0.15)


def test_missing_pixels_cost_themselves() -> None:
    full, rng = depth(), np.random.default_rng(0)
    y = motion(1)[:, :2]
    s = MultilayerPad(pad(), Markers(markers(), NOISE), depth=full, choice=0.003, penalty="identity")
    z = full.values.copy()
    z[rng.random(z.shape) < 0.03] = np.nan
    holed = s.estimate(y, DepthMap(z, full.pixel, full.noise))
    whole = s.estimate(y, full)
    assert holed.facts["lost"] == 0
    assert holed.resultant().value == pytest.approx(whole.resultant().value, abs=0.03)
    z[20:40, 20:40] = np.nan
    assert s.estimate(y, DepthMap(z, full.pixel, full.noise)).facts["lost"] > 5


def test_a_dot_that_is_broken_for_good_costs_that_dot() -> None:
    y = [motion(k).copy() for k in (1, 2)]
    for frame in y:
        frame[3] = np.nan
    s = MultilayerPad(pad(), Markers(markers(), NOISE, "XYZ"), penalty="identity")
    lam = s.calibrate(y).lam
    whole = (
        MultilayerPad(pad(), Markers(markers(), NOISE, "XYZ"), penalty="identity").calibrate([motion(1), motion(2)]).lam
    )
    assert lam == pytest.approx(whole, rel=0.1)
    assert s.estimate(y[0]).facts["lost"] == 3


def test_what_a_contact_cannot_carry_is_refused() -> None:
    with pytest.raises(InputError, match="cannot carry"):
        sensor(contact=ContactLaw(friction=0.5)).estimate(motion(1), wrench=Wrench([1.0, 0.0, -1.0]))
    with pytest.raises(InputError, match="cannot carry"):
        sensor(contact=NO_PULL).estimate(motion(1), wrench=Wrench([0.0, 0.0, 1.0]))


def test_no_contact_is_not_known_to_be_none() -> None:
    found = sensor(contact=NO_PULL).estimate(0 * motion())
    assert not np.any(found.load)
    assert np.all(found.resultant().std > 0)


def test_a_constrained_band_knows_the_force_sensor() -> None:
    s = sensor(contact=NO_PULL)
    given = Wrench([0.25, 0.0, -1.0])
    assert np.all(s.estimate(motion(1), wrench=given).resultant().std < 1e-6)
    assert np.all(s.estimate(motion(1)).resultant().std > 1e-4)


def test_zero_takes_a_constant_off() -> None:
    s = MultilayerPad(pad(), Markers(markers(), NOISE, "XYZ"), choice=0.01, penalty="identity")
    offset = 1e-5 * np.random.default_rng(3).standard_normal((len(markers()), 3))
    before = s.estimate(motion(1)).load
    s.zero([offset, offset])
    assert relative(s.estimate(motion(1) + offset).load, before) < 1e-9


def test_apparent_motion_is_told_apart_by_its_slopes() -> None:
    slope = np.tile([0.3, -0.2], (len(markers()), 1))
    u = motion()
    apparent = u[:, :2] + slope * u[:, 2:]
    s = MultilayerPad(pad(), Markers(markers(), NOISE, slope=slope), depth=depth(), choice=1e-3, penalty="identity")
    blind = MultilayerPad(pad(), Markers(markers(), NOISE), depth=depth(), choice=1e-3, penalty="identity")
    truth = nodal().sum(axis=0)
    assert np.linalg.norm(s.estimate(apparent, depth()).resultant().value - truth) < 0.03
    assert abs(blind.estimate(apparent, depth()).resultant().value[0] - truth[0]) > 0.05


def test_lambda_is_chosen_over_presses_and_kept() -> None:
    s = MultilayerPad(pad(), Markers(markers(), NOISE, "XYZ"), penalty="identity")
    assert not s.frozen
    first = s.estimate(motion(1))
    assert first.choice is not None
    assert first.choice.rule == "upre"  # noise is all there is here
    found = s.calibrate([motion(1), motion(2)])
    assert s.frozen
    assert s.estimate(motion(3)).facts["lambda"] == found.lam


def test_smoothness_and_constraints_refuse_each_other_at_frame_rate() -> None:
    s = MultilayerPad(
        pad(), Markers(markers(), NOISE, "XYZ"), choice=0.01, penalty="gradient", contact=ContactLaw(no_pull=True)
    )
    with pytest.raises(InputError, match="identity"):
        s.estimate(motion(1))


def test_the_band_of_the_resultant_holds() -> None:
    s, truth = sensor(1e-3), nodal().sum(axis=0)
    pulls = [
        (r := s.estimate(motion(None) + NOISE * np.random.default_rng(k).standard_normal((195, 3))).resultant()).value
        for k in range(200)
    ]
    assert np.std(pulls, axis=0) == pytest.approx(r.std, rel=0.15)
    assert np.all(np.abs(np.mean(pulls, axis=0) - truth) < 4 * r.std / np.sqrt(200) + 2e-3)


BAD = {
    "two markers": lambda: Markers(np.zeros((2, 2)), NOISE),
    "NaN": lambda: Markers(np.full((5, 2), np.nan), NOISE),
    "no noise": lambda: MultilayerPad(pad(), markers(), penalty="identity"),
    "noise of zero": lambda: Markers(markers(), 0.0),
    "axes": lambda: Markers(markers(), NOISE, "ZYX"),
    "slopes": lambda: Markers(markers(), NOISE, "XY", np.zeros((3, 2))),
    "shape": lambda: sensor().estimate(motion()[:-1]),
    "infinity": lambda: sensor().estimate(np.full((195, 3), np.inf)),
    "all lost": lambda: sensor().estimate(np.full((195, 3), np.nan)),
    "no eye": lambda: sensor().estimate(np.zeros((48, 64), np.uint8)),
    "no depth": lambda: sensor().estimate(motion(), depth()),
    "another depth": lambda: MultilayerPad(
        pad(), Markers(markers(), NOISE), depth=depth(), choice=0.1, penalty="identity"
    ).estimate(motion(), depth(pixel=2.5e-4)),
    "depth elsewhere": lambda: MultilayerPad(
        pad(), Markers(markers(), NOISE), depth=DepthMap(np.zeros((9, 9)), 1e-4, 1e-5, (1.0, 1.0)), penalty="identity"
    ),
    "friction": lambda: MultilayerPad(
        pad(), Markers(markers(), NOISE), contact=ContactLaw(friction=-1.0), penalty="identity"
    ),
    "support": lambda: MultilayerPad(
        pad(), Markers(markers(), NOISE), contact=ContactLaw(support=np.zeros(7, bool)), penalty="identity"
    ),
    "wrench": lambda: Wrench([1.0, 2.0]),
    "wrench std": lambda: Wrench([1.0, 2.0, 3.0], std=[1.0] * 6),
    "no frames": lambda: sensor().zero([]),
    "many frames": lambda: sensor().estimate(np.stack([motion()] * 4)),
    "turned": lambda: sensor().estimate(motion().T),
    "too few left": lambda: sensor(1e-8).estimate(np.where((np.arange(195) % 90 == 0)[:, None], motion(1), np.nan)),
    "depth maps end": lambda: list(sensor().stream([motion()] * 2, [depth()])),
    "negative node": lambda: MultilayerPad(
        pad(), Markers(markers(), NOISE), contact=ContactLaw(support=[-1, 3]), penalty="identity"
    ),
    "nothing to calibrate": lambda: sensor().calibrate([]),
    "no point": lambda: sensor().estimate(motion()).torque((0.0, 0.0)),
    "depth map": lambda: DepthMap(np.zeros(5), 1e-4, 1e-5),
    "pixel": lambda: DepthMap(np.zeros((5, 5)), 0.0, 1e-5),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_clear_error(case: str) -> None:
    with pytest.raises(InputError) as caught:
        BAD[case]()
    assert caught.value.args


def test_what_the_penalty_takes_is_in_the_band_of_the_resultant() -> None:
    truth = nodal().sum(axis=0)
    for lam in (0.01, 0.03, 0.05):
        found = sensor(lam).estimate(motion(1)).resultant()
        assert np.all(np.abs(found.value - truth) < 3 * found.std)


def test_a_benchmark_takes_sensors_as_they_stand() -> None:
    from tactile import metrics

    here = pad()
    presses = metrics.cases([PRESS], here.layer, markers(), here.nodes2d, pitch=1e-3)
    s = sensor(0.003)
    ways = {"as it stands": s.estimate, "forces": lambda u: s.estimate(u).forces()}
    table = metrics.benchmark(ways, presses, areas=here.surface.areas, points=here.nodes2d, noise=(2e-6,), draws=2)
    rows = {row.sensor: row for row in table.rows}
    assert rows["as it stands"].metrics.error == pytest.approx(rows["forces"].metrics.error, rel=1e-9)
    assert rows["as it stands"].metrics.error < 0.3


@pytest.mark.parametrize("kind", [MultilayerPad, GelSlim], ids=lambda k: k.__name__)
def test_the_keywords_of_the_first_version_go_on_working(kind: type) -> None:
    slope = np.full((len(markers()), 2), 0.1)
    with pytest.warns(DeprecationWarning, match=r"markers=Markers\(points, noise=\.\.\., axes=\.\.\., slope=\.\.\.\)"):
        seen = kind(pad(), markers(), noise=NOISE, axes="XYZ", slope=slope).markers
    assert (seen.axes, seen.noise[0, 0]) == ("XYZ", NOISE)
    assert np.array_equal(seen.slope, slope)
    with pytest.warns(DeprecationWarning, match=r"contact=ContactLaw\(no_pull=\.\.\., friction=\.\.\.\)"):
        law = kind(pad(), markers=Markers(markers(), NOISE), no_pull=True, friction=0.4).contact
    assert (law.no_pull, law.friction, law.support) == (True, 0.4, None)
