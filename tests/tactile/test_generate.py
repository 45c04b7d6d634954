"""Presses that are drawn: their contact, motion and loads held against closed forms, and what declarations refuse."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loadid import InputError
from loadid.generate import TrainingSet
from loadid.generate._work import drawn_as
from tactile import Layer, Markers, MultilayerPad, Press, RigidBody, Tolerances, metrics, shapes
from tactile.generate import ContactRange, GelRange, IndenterRange, PressDeclaration, PressMaker, presses
from tactile.generate._readings import seen
from tactile.generate._truth import Ground, Move, spread_over

from . import generated as g

SPHERE = IndenterRange("sphere", radius=3e-3)


@pytest.fixture(scope="module")
def maker() -> PressMaker:
    return PressMaker(g.marked(), g.DECLARED)


@pytest.fixture(scope="module")
def drawn(maker: PressMaker) -> list:
    return [drawn_as(maker, 5, k) for k in range(30)]


# -- the truth --------------------------------------------------------------------------------------------------------
def ground(h: float = g.THICKNESS, pitch: float = g.THICKNESS / 12) -> Ground:
    return Ground(Layer(h, g.E, g.NU), g.SIZE, 5.5e-3, pitch)


def test_motion_of_a_known_press_is_that_of_the_closed_form() -> None:
    here = ground()
    press = Press(at=(0.4e-3, -0.3e-3), radius=1.5e-3, force=0.2, shear=(0.06, -0.02))
    tractions = metrics.means(press, here.grid.nodes.reshape(-1, 2), here.grid.pitch, "patch").reshape(
        *here.grid.shape, 3
    )
    points = g.dots()
    exact = press.displacement(here.layer, points)
    found = here.motion(tractions, points, None)
    assert np.linalg.norm(found - exact) < 0.01 * np.linalg.norm(exact)


def test_the_quick_contact_is_that_of_the_settled_one_on_a_finer_grid() -> None:
    quick = ground()
    move = Move((0.2e-3, 0.1e-3), 0.1e-3, None, (40e-6, 20e-6), 0.01, 0.5)
    found = quick.press(lambda points: shapes.sphere(points, 3e-3, move.at), move)
    fine = Ground(quick.layer, (6e-3, 6e-3), 3e-3, g.THICKNESS / 20)
    body = RigidBody(fine.grid, shapes.sphere(fine.grid.nodes, 3e-3, move.at), friction=0.5)
    shift = np.array(move.shift) + move.turn * np.array([move.at[1], -move.at[0]])
    exact = body.press(depth=0.1e-3).drag(tuple(shift), 0.01, 5)
    force = found.tractions.sum(axis=(0, 1)) * quick.grid.pitch**2
    assert np.linalg.norm(force - exact.force) < 0.02 * np.linalg.norm(exact.force)
    near = g.dots()[np.abs(g.dots()).max(axis=1) < 3e-3]
    a, b = quick.motion(found.tractions, near, None), exact.motion(near)
    assert np.linalg.norm(a - b) < 0.02 * np.linalg.norm(b)


def test_forces_on_the_nodes_keep_sum_and_moment(drawn: list) -> None:
    sensor = g.marked()
    resultant = sensor.geometry["resultant"]
    for one in drawn:
        total = [one.parameters[name] for name in ("Fx", "Fy", "Fz")]
        assert resultant[:3] @ one.loads == pytest.approx(total, rel=1e-9, abs=1e-12)
    here, body = ground(), g.pad()
    weights = spread_over(body, here)
    inside = here.inside.ravel()
    nodes = here.grid.nodes.reshape(-1, 2)
    assert np.allclose(np.asarray(weights.sum(axis=0)).ravel()[inside], 1.0)
    assert np.allclose((weights.T @ body.nodes2d)[inside], nodes[inside], atol=1e-12)


def test_another_mesh_moves_as_the_layer_does_far_from_its_edges() -> None:
    declared = g.only(SPHERE, x=0.0, y=0.0, depth=0.15e-3, shear=0.05e-3)
    layer = PressMaker(g.marked(), declared)
    edged = PressMaker(g.marked(), declared, [g.pad(0.5e-3, 5)])
    a, b = (drawn_as(one, 1, 0) for one in (layer, edged))
    assert np.array_equal(a.loads, b.loads)
    assert np.linalg.norm(a.data - b.data) < 0.2 * np.linalg.norm(a.data)
    assert not np.array_equal(a.data, b.data)


def test_pads_move_with_the_poissons_ratio_and_thickness_that_are_declared() -> None:
    press = g.only(IndenterRange("sphere", radius=4e-3), x=0.0, y=0.0, depth=0.1e-3)
    gels = GelRange(nu=(0.36, 0.44), thickness=(0.9, 1.1))
    maker = PressMaker(g.marked(), replace(press, gel=gels), [g.pad()])
    found = [drawn_as(maker, 3, k) for k in range(8)]
    nu, thickness = (np.array([one.parameters[name] for one in found]) for name in ("nu", "thickness"))
    assert 0.36 <= nu.min() < nu.max() <= 0.44
    assert 0.9 * g.THICKNESS <= thickness.min() < thickness.max() <= 1.1 * g.THICKNESS
    assert len(set(nu)) >= 4
    own = replace(g.pad(), nu=float(nu[0]), thickness=float(thickness[0]))
    alone = drawn_as(PressMaker(g.marked(), press, [own]), 3, 0)
    assert found[0].data == pytest.approx(alone.data, abs=1e-9)
    assert found[0].loads == pytest.approx(alone.loads, abs=1e-6 * np.abs(alone.loads).max())


def test_gels_lie_within_the_tolerances_of_the_sensor_where_nothing_is_declared() -> None:
    """Evenly with that std; what is declared is as declared, and a gel that is exactly known stays so."""
    press = g.only(IndenterRange("sphere", radius=4e-3), x=0.0, y=0.0, depth=0.1e-3)
    known = MultilayerPad(g.pad(), Markers(g.dots(), g.NOISE), penalty="identity",
                          tolerances=Tolerances(E=0.1, nu=0.02, thickness=0.05))  # fmt: skip
    gel = PressMaker(known, press).declared.gel
    assert pytest.approx((1 - 0.1 * 3**0.5, 1 + 0.1 * 3**0.5)) == gel.E
    assert gel.nu == pytest.approx((g.NU - 0.02 * 3**0.5, g.NU + 0.02 * 3**0.5))
    assert gel.thickness == pytest.approx((1 - 0.05 * 3**0.5, 1 + 0.05 * 3**0.5))
    assert PressMaker(known, replace(press, gel=GelRange(E=1.0, nu=(0.3, 0.4)))).declared.gel.nu == (0.3, 0.4)
    assert PressMaker(g.marked(), press).declared.gel == GelRange(E=1.0, thickness=1.0)
    soft = GelRange().known_to(Tolerances(E=0.9, nu=0.2), 0.45)
    assert soft == GelRange(E=(0.1, 1 + 0.9 * 3**0.5), nu=(0.45 - 0.2 * 3**0.5, 0.495), thickness=1.0)


# -- draws ------------------------------------------------------------------------------------------------------------
def test_every_kind_is_drawn_and_lies_in_its_ranges(drawn: list, maker: PressMaker) -> None:
    more = [drawn_as(maker, 6, k) for k in range(30)]
    assert {one.kind for one in [*drawn, *more]} == set(maker.kinds)
    for one in drawn:
        p = one.parameters
        assert 0.9 * g.E <= p["E"] <= 1.1 * g.E
        assert 0.38 <= p["nu"] <= 0.42
        assert 0.95 * g.THICKNESS <= p["thickness"] <= 1.05 * g.THICKNESS
        assert p["Fz"] < 0
        assert np.hypot(p["Fx"], p["Fy"]) <= 1.01 * p["friction"] * -p["Fz"]
    lost = np.mean([np.isnan(one.data).mean() for one in drawn])
    assert 0.005 < lost < 0.05


def test_a_draw_is_the_same_in_any_copy_of_what_draws(maker: PressMaker, drawn: list) -> None:
    other = pickle.loads(pickle.dumps(maker))
    for one in (other, copy.deepcopy(maker)):
        again = drawn_as(one, 5, 3)
        assert np.array_equal(again.data, drawn[3].data, equal_nan=True)
        assert np.array_equal(again.loads, drawn[3].loads)


def test_a_picture_is_the_image_of_its_draw() -> None:
    maker = PressMaker(g.seeing(), g.DECLARED)
    taken = maker.picture(np.random.default_rng(np.random.SeedSequence(2, spawn_key=(0, 0))))
    one = drawn_as(maker, 2, 0)
    assert taken.image.shape == g.FRAME
    assert np.array_equal(seen(g.seeing().eye, taken, g.seeing().markers.points[:, :2]).ravel(), one.data,
                          equal_nan=True)  # fmt: skip
    assert 0 < max(map(abs, (one.parameters["shift_x"], one.parameters["shift_y"]))) <= 1
    with pytest.raises(InputError, match="no images"):
        PressMaker(g.marked(), g.DECLARED).picture(np.random.default_rng(0))


def test_the_eye_finds_what_the_markers_do() -> None:
    """Images and motion of one press: the same numbers are drawn up to the reading. The camera sits a pixel aside."""
    declared = g.only(SPHERE, x=0.0, y=0.0, depth=0.2e-3, shear=0.1e-3)
    declared = PressDeclaration(declared.indenter, declared.contact, camera=g.DECLARED.camera, image=g.DECLARED.image)
    sensor = g.seeing()
    blind = type(sensor)(sensor.pad, sensor.markers, penalty="identity")
    image = drawn_as(PressMaker(sensor, declared), 4, 0)
    motion = drawn_as(PressMaker(blind, g.only(SPHERE, x=0.0, y=0.0, depth=0.2e-3, shear=0.1e-3)), 4, 0)
    assert np.array_equal(image.loads, motion.loads)
    there = np.isfinite(image.data)
    assert there.mean() > 0.95
    pixel = sensor.eye.pixel
    assert np.sqrt(np.mean((image.data - motion.data)[there] ** 2)) < 0.12 * pixel


def test_a_set_is_pinned_and_is_the_same_whatever_the_workers(tmp_path: Path) -> None:
    alone = presses(g.marked(), g.DECLARED, tmp_path / "a", draws=4, seed=9, workers=1)
    assert alone.fingerprint.startswith(PINNED)
    whole = alone.read()
    again = [drawn_as(PressMaker(g.marked(), g.DECLARED), 9, k) for k in range(4)]
    assert np.allclose(whole.loads, [one.loads for one in again], rtol=1e-6)
    assert alone.sensors == tuple(g.marked().markers.channels)
    assert TrainingSet.open(tmp_path / "a").fingerprint == alone.fingerprint


PINNED = "0a6d55ff3a4fa6bf"


# -- declarations -----------------------------------------------------------------------------------------------------
TEXT = """\
[[indenter]]
kind = "sphere"
radius = ["2 mm", "5 mm"]

[[indenter]]
kind = "ring"
weight = 0.5
outer = "2 mm"
inner = ["0.5 mm", "1 mm"]
depth = ["20 um", "80 um"]

[contact]
depth = ["0.05 mm", "0.2 mm"]
shear = ["0 mm", "0.1 mm"]
twist = ["-2 deg", "2 deg"]
friction = [0.3, 0.9]

[gel]
E = [0.9, 1.1]
nu = [0.38, 0.42]

[camera]
shift = ["-1 px", "1 px"]

[image]
size = [240, 320]
blur = 1.0

[markers]
lost = [0.0, 0.05]
"""


def test_files_and_python_say_the_same(tmp_path: Path) -> None:
    path = tmp_path / "presses.toml"
    path.write_text(TEXT)
    found = PressDeclaration.read(path)
    assert found.indenter[1] == IndenterRange(
        "ring", 0.5, outer=(2e-3, 2e-3), inner=(0.5e-3, 1e-3), depth=(20e-6, 80e-6)
    )
    assert found.contact == ContactRange(
        depth=(0.05e-3, 0.2e-3), shear=(0, 0.1e-3), twist=(-np.radians(2), np.radians(2)), friction=(0.3, 0.9)
    )
    assert found.image.size == (240, 320)
    assert found.image.blur == (1.0, 1.0)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("friction = ", "fricton = ", "did you mean friction"),
        ("[gel]", "[gell]", "did you mean gel"),
        ('"sphere"', '"ball"', "no kind of indenter"),
        ('outer = "2 mm"\n', "", "outer is missing"),
        ('radius = ["2 mm", "5 mm"]', 'radius = ["5 mm", "2 mm"]', "not possible"),
        ('radius = ["2 mm", "5 mm"]', "radius = [2, 5]", "without its unit"),
        ('inner = ["0.5 mm", "1 mm"]', 'inner = ["0.5 mm", "3 mm"]', "as wide as the ring"),
        ("lost = [0.0, 0.05]", "lost = [0.0, 1.5]", "not possible"),
        ("friction = [0.3, 0.9]", "friction = [0.3, nan]", "finite number"),
        ('depth = ["0.05 mm", "0.2 mm"]\n', "", "how deep"),
        ("size = [240, 320]", "size = [240]", "no size of images"),
        ("[contact]", "[contact", "TOML"),
    ],
)
def test_a_declaration_that_is_none_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "presses.toml"
    assert old in TEXT
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(InputError, match=said) as told:
        PressDeclaration.read(path)
    assert str(path) in str(told.value) or "IndenterRange" in str(told.value)


def test_what_does_not_go_together_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="beside the pad"):
        PressMaker(g.marked(), g.only(SPHERE, x=(0.0, 9e-3), depth=1e-4))
    pad = type(g.pad())(E=g.E, nu=g.NU, size=(10e-3, 10e-3), thickness=g.THICKNESS, pitch=1e-3, layers=2)
    with pytest.raises(InputError, match="another size"):
        PressMaker(g.marked(), g.only(SPHERE, depth=1e-4), [pad])
    with pytest.raises(InputError, match="linear sensor"):
        PressMaker(object(), g.DECLARED)  # type: ignore[arg-type]
    deep = g.only(IndenterRange("flat", radius=0.5e-3), x=5.9e-3, y=0.0, depth=1e-4)
    with pytest.raises(InputError, match="hardly ever"):
        presses(g.marked(), deep, tmp_path / "none", draws=1, seed=0, workers=1)
    assert not list((tmp_path / "none").glob("shards/*"))
