"""Learned maps of a tactile sensor: on presses of another route, on what they never saw, and as files."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest

from loadid import LearnedMap
from loadid._learning.network import Schedule
from loadid.cli import main
from loadid.generate import Examples, TrainingSet
from structures.errors import InputError
from tactile import ForceMap, Layer, LearnedSensor, Markers, MultilayerPad, Pad, Wrench
from tactile._sensors.learned import drawn_gels
from tactile.generate import ContactRange, IndenterRange, PressDeclaration
from tactile.generate import presses as drawn_presses

from .presses import NOISE, pad, places, presses, sensor, training

COUNT = 40


@pytest.fixture(scope="module")
def learned() -> LearnedSensor:
    return LearnedSensor.fit(sensor(), training(), engine="linear")


def away(found: ForceMap, truth: np.ndarray) -> float:
    """Relative error of a map."""
    return float(np.linalg.norm(found.load - truth) / np.linalg.norm(truth))


def judged(maps: list[ForceMap], truths: np.ndarray) -> tuple[float, float, np.ndarray]:
    """Median error of maps, of normal forces, and the share of forces within their 95 % band (3,)."""
    R = np.asarray(maps[0].geometry["resultant"])[:3]  # type: ignore[index]
    force, found = truths @ R.T, np.array([m.resultant().value for m in maps])
    within = np.abs(found - force) <= 1.96 * np.array([m.resultant().std for m in maps])
    error = [away(m, t) for m, t in zip(maps, truths, strict=True)]
    return float(np.median(error)), float(np.median(np.abs(found[:, 2] / force[:, 2] - 1))), within.mean(axis=0)


def test_maps_of_fresh_presses_are_better_than_those_of_the_physics_and_in_their_band(learned: LearnedSensor) -> None:
    motion, loads = presses(COUNT, 1)
    maps = [learned.estimate(u) for u in motion]
    own = [m for m, t in zip(maps, loads, strict=True) if m.facts.answered_by == "learned map"]
    assert len(own) >= 0.9 * COUNT
    assert all(isinstance(m, ForceMap) and m.units[0] == "Pa" for m in maps)
    kept = np.array([m.facts.answered_by == "learned map" for m in maps])
    error, normal, within = judged(own, loads[kept])
    before, unseen, _ = judged([sensor().estimate(u) for u in motion], loads)
    assert error < 0.75 * before
    assert normal < 0.25 < unseen  # in-plane markers tell hardly any normal force
    assert within.min() >= 0.85


def test_the_band_of_nodes_and_wrench_covers_what_it_says(learned: LearnedSensor) -> None:
    motion, loads = presses(COUNT, 1)
    maps = [learned.estimate(u) for u in motion]
    kept = [k for k, m in enumerate(maps) if m.facts.answered_by == "learned map"]
    inside = [np.abs(maps[k].load - loads[k]) <= 1.96 * maps[k].std for k in kept]
    acts = [np.abs(loads[k]) > 0.05 * np.abs(loads[k]).max() for k in kept]
    assert 0.92 <= np.mean(np.array(inside)[np.array(acts)]) <= 0.98  # the rest of the nodes carries nothing
    assert 0.94 <= np.mean(inside) <= 0.99
    assert maps[kept[0]].torque().std.shape == (3,)


def test_what_the_set_does_not_have_is_answered_by_the_physics(learned: LearnedSensor) -> None:
    motion, _ = presses(COUNT, 1)
    disorder = 1e-4 * np.random.default_rng(0).standard_normal(motion[0].shape)
    strange = {"pulled apart": 0.1 * places(), "disorder": disorder, "ten times as hard": 10 * motion[0]}
    for name, seen in strange.items():
        found = learned.estimate(seen)
        assert found.facts.answered_by == "physics", name
        assert found.facts.novelty is not None
        assert found.facts.novelty > 1
        assert found.flags[0].code == "LID-W609"
        alone = sensor().estimate(seen)
        assert np.array_equal(found.load, alone.load)
        assert np.array_equal(found.std, alone.std)
        assert np.array_equal(found.resultant().std, alone.resultant().std)


def test_a_wrench_and_many_lost_markers_are_for_the_physics(learned: LearnedSensor) -> None:
    motion, _ = presses(COUNT, 1)
    met = learned.estimate(motion[0], wrench=Wrench((0.0, 0.0, -0.2)))
    assert met.facts.answered_by == "physics"
    assert met.resultant().value == pytest.approx([0, 0, -0.2], abs=1e-9)
    few, many = motion[0].copy(), motion[0].copy()
    few[[3, 20]], many[:12] = np.nan, np.nan
    found = learned.estimate(few)
    assert (found.facts.answered_by, found.facts.lost) == ("learned map", 4)
    whole = learned.estimate(motion[0])
    assert away(found, whole.load) < 0.2
    assert learned.estimate(many).facts.answered_by == "physics"


def test_a_map_is_kept_in_a_file_and_holds_for_markers_found_again(learned: LearnedSensor, tmp_path: Path) -> None:
    motion, _ = presses(COUNT, 1)
    learned.save(tmp_path / "map.h5")
    again = LearnedSensor.read(tmp_path / "map.h5", sensor())
    want = learned.estimate(motion[0])
    found = again.estimate(motion[0])
    assert np.array_equal(found.load, want.load)
    assert np.array_equal(found.resultant().std, want.resultant().std)
    turned = LearnedSensor.read(tmp_path / "map.h5", sensor(places()[::-1] + 1e-5))
    assert turned.estimate(motion[0][::-1]).load == pytest.approx(want.load, rel=1e-9)
    with pytest.raises(InputError, match="the markers are not those"):
        LearnedSensor.read(tmp_path / "map.h5", sensor(places() + 4e-4))
    other = gel(E=150e3)
    with pytest.raises(InputError, match="learned for another model"):
        LearnedSensor.read(tmp_path / "map.h5", MultilayerPad(other, Markers(places(), NOISE), choice=0.01))


def test_a_map_is_reported_drawn_and_kept_as_any_other(learned: LearnedSensor, tmp_path: Path) -> None:
    found = learned.estimate(presses(COUNT, 1)[0][0])
    found.save(tmp_path / "force.h5")
    again = ForceMap.read(tmp_path / "force.h5")
    assert np.array_equal(again.load, found.load)
    assert again.facts.answered_by == "learned map"
    found.report(tmp_path / "force.html")
    found.plot(path=tmp_path / "force.png")
    assert (tmp_path / "force.png").stat().st_size > 10_000
    assert "learned map" in (tmp_path / "force.html").read_text("utf-8")


def test_the_command_takes_a_map(learned: LearnedSensor, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    motion, _ = presses(COUNT, 1)
    table = """[pad]
size = ["10 mm", "9 mm"]
thickness = "2 mm"
E = "0.147 MPa"
nu = 0.45
pitch = "1 mm"
layers = 2
[markers]
unit = "m"
noise = "2 um"
[contact]
penalty = "identity"
"""
    (tmp_path / "pad.toml").write_text(table, "utf-8")
    strange = 1e-4 * np.random.default_rng(0).standard_normal(motion[0].shape)
    shown = np.array([0 * motion[0], *motion[:3], strange]) + places()
    rows = [f"{k + 1},{i},{x:.9f},{y:.9f}" for k, frame in enumerate(shown) for i, (x, y) in enumerate(frame)]
    (tmp_path / "seen.csv").write_text("\n".join(["frame,id,x,y", *rows]), "utf-8")
    learned.save(tmp_path / "map.h5")
    words = ["tactile", str(tmp_path / "seen.csv"), "--pad", str(tmp_path / "pad.toml"), "--unloaded", "1",
             "--allow", "W115", "--map", str(tmp_path / "map.h5"), "-o", str(tmp_path / "force.h5")]  # fmt: skip
    assert main(words) == 0
    assert "LearnedSensor: linear, 300 presses" in capsys.readouterr().out
    found = ForceMap.read(tmp_path / "force.h5")
    assert list(found.facts.answered_by)[1:] == ["learned map"] * 3 + ["physics"]  # type: ignore[arg-type]
    assert away(found.frame(1), learned.estimate(motion[0]).load) < 0.01  # micrometres to nine digits
    assert main([*words, "--sensor", "gelslim"]) == 3


def test_zero_is_that_of_map_and_physics() -> None:
    motion, _ = presses(COUNT, 1)
    own = LearnedSensor.fit(sensor(), training(), engine="linear")
    drift = np.full((len(places()), 2), 3e-5)
    own.zero([drift])
    plain = LearnedSensor.fit(sensor(), training(), engine="linear")
    assert own.estimate(motion[0] + drift).load == pytest.approx(plain.estimate(motion[0]).load, rel=1e-9)
    assert np.array_equal(own.sensor.offset, own.offset)


def test_a_network_over_the_same_presses_beats_the_linear_map(learned: LearnedSensor) -> None:
    pytest.importorskip("torch")
    plan = Schedule(epochs=30, batch=16, rate=3e-3)  # at 15 the processor decides which map is better
    deep = LearnedSensor.fit(sensor(), training(), engine="torch", seed=1, schedule=plan)
    motion, loads = presses(COUNT, 1)
    values = motion.reshape(COUNT, -1)
    errors = [np.linalg.norm(s.fitted.predict(values).mean - loads, axis=1) / np.linalg.norm(loads, axis=1)
              for s in (deep, learned)]  # fmt: skip
    assert deep.fitted.engine.form.kind == "maps"
    assert np.median(errors[0]) < 0.9 * np.median(errors[1])


def test_a_pad_keeps_its_grid() -> None:
    from loadid._learning.network.forms import Grid

    grid = Grid.of(pad().nodes2d, 3)
    assert grid is not None
    assert (grid.order.shape, grid.padded) == ((10, 11), (12, 12))
    values = np.random.default_rng(0).standard_normal((2, 330)).astype(np.float32)
    assert np.array_equal(grid.flat(grid.image(values)), values)
    assert np.all(np.diff(pad().nodes2d[grid.order][..., 0], axis=1) > 0)
    assert Grid.of(np.random.default_rng(0).standard_normal((110, 2)), 3) is None


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> TrainingSet:
    """Presses that were drawn for the sensor: the set says for which."""
    pressed = PressDeclaration(
        [IndenterRange("sphere", radius=(2e-3, 4e-3))],
        ContactRange(x=(-1e-3, 1e-3), y=(-1e-3, 1e-3), depth=(0.05e-3, 0.1e-3), shear=(0, 0.05e-3)),
    )
    return drawn_presses(sensor(), pressed, tmp_path_factory.mktemp("drawn"), draws=100, seed=0, workers=1)


def test_presses_drawn_for_another_pad_or_for_other_markers_are_refused(drawn: TrainingSet) -> None:
    again = TrainingSet.open(drawn.source.folder)  # type: ignore[union-attr]
    assert again.model == sensor().model.described
    assert again.places == pytest.approx(places())
    one = LearnedSensor.fit(sensor(places()[::-1] + 1e-5), again, engine="linear")
    assert np.array_equal(one.fitted.facts["markers"], again.places)
    assert LearnedMap(sensor().model, output="resultant").fit(again).facts["draws"] == 100
    for other, words in ((gel(E=177e3), "drawn for another model"), (gel(nu=0.4), "drawn for another model")):
        elsewhere = MultilayerPad(other, Markers(places(), NOISE), choice=0.01)
        with pytest.raises(InputError, match=words):
            LearnedSensor.fit(elsewhere, again, engine="linear")
    with pytest.raises(InputError, match="the markers are not those"):
        LearnedSensor.fit(sensor(places() + 4e-4), again, engine="linear")


def gel(E: float = 147e3, nu: float = 0.45) -> Pad:
    """The pad of another gel."""
    return Pad(size=(10e-3, 9e-3), thickness=2e-3, E=E, nu=nu, elements=(10, 9), layers=2, allow=("W115",))


SKIN = """set = "presses"
draws = 100
seed = 3
workers = 1
[sensor]
pad = "pad.toml"
rows = 7
columns = 8
pitch = "1 mm"
[[declaration.indenter]]
kind = "sphere"
radius = ["2 mm", "4 mm"]
[declaration.contact]
x = ["-1 mm", "1 mm"]
y = ["-1 mm", "1 mm"]
depth = ["0.05 mm", "0.1 mm"]
[map]
engine = "linear"
"""
SKIN_PAD = """[pad]
size = ["10 mm", "9 mm"]
thickness = "2 mm"
E = "0.147 MPa"
nu = 0.45
pitch = "1 mm"
layers = 2
allow = ["W115"]
[markers]
noise = "2 um"
"""


@pytest.mark.skipif(not entry_points(group="loadid.generators"), reason="installed before generators were registered")
def test_a_job_of_a_gel_pad_is_drawn_and_learned(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From one file to the map that the sensor of the same pad file reads."""
    (tmp_path / "skin.toml").write_text(SKIN, "utf-8")
    (tmp_path / "pad.toml").write_text(SKIN_PAD, "utf-8")
    job, kept = str(tmp_path / "skin.toml"), str(tmp_path / "map.h5")
    assert main(["learn", "generate", job]) == 0
    assert main(["learn", "fit", job, "-o", kept]) == 0
    assert "linear map of 100 draws" in capsys.readouterr().out
    training = TrainingSet.open(tmp_path / "presses")
    of = MultilayerPad(Pad.from_toml(tmp_path / "pad.toml"), Markers(training.places, 2e-6), choice=0.01)
    one, seen = LearnedSensor.read(kept, of), training.read(slice(0, 10))
    off = [away(one.explained(y), load) for y, load in zip(seen.data, seen.loads, strict=True)]
    assert np.median(off) < 0.7
    (tmp_path / "other.toml").write_text(SKIN.replace("seed = 3", "seed = 4").replace('"presses"', '"other"'), "utf-8")
    assert main(["learn", "generate", str(tmp_path / "other.toml"), "--draws", "20"]) == 0
    capsys.readouterr()
    assert main(["learn", "check", kept, str(tmp_path / "other"), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert row["draws"] == 20
    assert row["error"] < 1  # of 100 presses
    assert 0.85 <= row["coverage"] <= 1
    assert main(["learn", "check", kept, str(tmp_path / "presses")]) == 3
    assert "learned from this set" in capsys.readouterr().err
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(SKIN + 'output = "resultant"\n', "utf-8")
    assert main(["learn", "fit", str(wrong), "-o", str(tmp_path / "x.h5")]) == 3
    assert "engine, seed" in capsys.readouterr().err


def test_markers_found_in_another_order_leave_the_same_residual(learned: LearnedSensor, tmp_path: Path) -> None:
    motion, _ = presses(COUNT, 1)
    learned.save(tmp_path / "map.h5")
    turned = LearnedSensor.read(tmp_path / "map.h5", sensor(places()[::-1]))
    found, want = turned.estimate(motion[0][::-1]), learned.estimate(motion[0])
    assert found.facts.novelty_by == want.facts.novelty_by


def test_nodes_that_no_press_loads_are_named(learned: LearnedSensor) -> None:
    motion, _ = presses(COUNT, 1)
    found = learned.estimate(motion[0])
    (flag,) = (f for f in found.flags if f.code == "LID-W616")
    assert f"never varying there, and answered by their mean: {found.labels[0]}" in str(flag)
    still = np.flatnonzero(np.all(training().read().loads == training().read().loads[0], axis=0))
    assert learned.fitted.facts["still"] == [found.labels[i] for i in still]
    assert np.all(found.std[still] == 0)


def test_presses_that_load_every_node_raise_no_flag() -> None:
    one, rng = training().read(), np.random.default_rng(1)
    spread = one.loads + 1e3 * rng.standard_normal(one.loads.shape)
    whole = TrainingSet.of(Examples.measured(one.data, spread, noise=NOISE), sensors=training().sensors,
                           loads=training().loads)  # fmt: skip
    found = LearnedSensor.fit(sensor(), whole, engine="linear").estimate(presses(COUNT, 1)[0][0])
    assert "LID-W616" not in [f.code for f in found.flags]


def in_band(one: LearnedSensor, known: dict[str, float]) -> float:
    """Share of the forces in their 95 % band, of presses on gels that are off by as much as is said."""
    rng, held = np.random.default_rng(3), []
    for k in range(12):
        E, nu = 147e3 * (1 + known["E"] * rng.standard_normal()), 0.45 + known["nu"] * rng.standard_normal()
        motion, loads = presses(6, 100 + k, Layer(2e-3, E, min(nu, 0.49)))
        for u, load in zip(motion, loads, strict=True):
            found = one.estimate(u)
            if found.facts.answered_by == "learned map":
                force = found.resultant()
                held.append(np.abs(force.value - one.sensor.resultant[:3] @ load) <= 1.96 * force.std)
    assert len(held) > 60
    return float(np.mean(held))


def test_the_band_holds_the_forces_on_gels_within_their_tolerances(learned: LearnedSensor) -> None:
    known = {"E": 0.12, "nu": 0.03}
    assert in_band(learned, known) < 0.8
    told = LearnedSensor(sensor(**known), learned.fitted)
    assert 0.91 < in_band(told, known) < 0.98
    assert "std of the gel, E 0.12, nu 0.03" in told.estimate(presses(COUNT, 2)[0][0]).facts.band


def test_gels_that_the_presses_were_drawn_on_are_not_counted_again(learned: LearnedSensor) -> None:
    """A set of gels within 10 % holds what a tolerance of 10 % says; of one of 20 % the rest is added."""
    facts = {**learned.fitted.facts, "gels": {"E": 0.1}}
    held = LearnedSensor(sensor(), replace(learned.fitted, facts=facts))
    u = presses(COUNT, 1)[0][0]
    want = learned.estimate(u)
    assert "gel taken as exactly known" in want.facts.band
    for tolerance, rest in ((0.05, 0.0), (0.1, 0.0), (0.2, 0.03**0.5)):
        told = LearnedSensor(sensor(E=tolerance), held.fitted)
        assert told.estimate(u).std == pytest.approx(np.hypot(want.std, rest * want.load))
    assert "std of the gel, E 0.1" in held.estimate(u).facts.band


def test_a_set_says_on_which_gels_it_was_drawn(drawn: TrainingSet) -> None:
    seen, own = drawn.read(), {"E": 147e3, "nu": 0.45, "thickness": 2e-3}
    assert drawn_gels(sensor(), drawn) == {}
    off = {name: value * np.resize([0.9, 1.1], len(drawn)) for name, value in own.items()}
    wide = TrainingSet.of(replace(seen, parameters=off), sensors=drawn.sensors, loads=drawn.loads)
    found = drawn_gels(sensor(), wide)
    assert found == pytest.approx({"E": 0.1, "nu": 0.045, "thickness": 0.1})


def test_a_tolerance_of_the_modulus_is_that_of_all_tractions(learned: LearnedSensor) -> None:
    u = presses(COUNT, 1)[0][0]
    want, found = learned.estimate(u), LearnedSensor(sensor(E=0.1), learned.fitted).estimate(u)
    assert np.array_equal(found.load, want.load)
    assert found.std == pytest.approx(np.hypot(want.std, 0.1 * want.load))
    force = want.resultant()
    assert found.resultant().std == pytest.approx(np.hypot(force.std, 0.1 * force.value))


def test_presses_of_known_force_tell_the_modulus(learned: LearnedSensor) -> None:
    motion, loads = presses(COUNT, 2, Layer(2e-3, 1.2 * 147e3, 0.45))
    one = LearnedSensor(sensor(E=0.12), learned.fitted)
    R = one.sensor.resultant[:3]
    wrenches = [Wrench(tuple(R @ load)) for load in loads[:5]]
    told = one.adapted(list(motion[:5]), wrenches=wrenches)
    assert told.fitted.adaptation.gain[2] == pytest.approx(1.2, abs=0.1)
    assert "std of the gel" not in told.estimate(motion[5]).facts.band
    assert "modulus by known forces" in told.estimate(motion[5]).facts.band
    held = [np.abs(m.resultant().value - R @ load) <= 1.96 * m.resultant().std
            for m, load in zip(map(told.estimate, motion[5:]), loads[5:], strict=True)]  # fmt: skip
    assert np.mean(held) > 0.9
    with pytest.raises(InputError, match="the wrenches do not go with the frames"):
        one.adapted(list(motion[:5]), wrenches=wrenches[:4])
