"""The walk through the gel pad: six steps done right, and what each does to the map when it is done wrongly."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loadid._lab.server import Lab
from tactile import Layer
from tactile._lab.gelpad import page
from tactile._lab.walk import AT, SWITCHES, Steps, apparent, completed, eye, ridged, rig, shown, solved

from .client import asked, called


def told(**given: Any) -> tuple[float, float, set[str], dict[str, Any]]:
    """The two errors, the codes, and all that is shown."""
    steps = Steps(**given)
    found = shown(steps) | {"solve": solved(steps)}
    last = found["solve"]
    return last["resultant_error"], last["map_error"], {f["code"] for f in last["flags"]}, found


def test_done_right_the_map_is_that_of_the_press() -> None:
    resultant, field, codes, found = told()
    assert resultant == pytest.approx(0.091, abs=0.01)
    assert field == pytest.approx(0.018, abs=0.003)
    assert codes == {"W605", "N606"}
    assert found["match"]["lost"] == 2
    assert found["detect"]["found"] == found["detect"]["markers"] - 2
    truth, areas = rig().truth, rig().pad.surface.areas
    np.testing.assert_allclose(truth.T @ areas, rig().press.vector, rtol=1e-6)  # the map it is held against
    middle = (truth[:, 2] * areas) @ rig().pad.nodes2d / (truth[:, 2] @ areas)
    np.testing.assert_allclose(middle, AT, atol=1e-7)


def test_the_ball_is_the_one_whose_dent_the_press_makes() -> None:
    normal = told()[3]["normal"]
    there = np.isfinite(normal["indenter"]) & (np.abs(normal["fine"] - 1e3 * AT[0]) < 1.8)
    assert np.abs(normal["indenter"] - normal["truth"])[there].max() < 0.05 * np.abs(normal["truth"]).max()


def test_markers_that_vanish_are_counted_and_cost_the_map() -> None:
    resultant, field, codes, found = told(vanish=True)
    assert "W604" in codes
    assert found["match"]["lost"] > 8
    assert field > 2 * told()[1]
    assert resultant > 1.4 * told()[0]


def test_the_nearest_dot_is_no_match() -> None:
    resultant, field, codes, found = told(naive=True)
    assert found["match"]["lost"] == 0
    assert found["match"]["largest"] > 0.9 * found["match"]["pitch"]  # a neighbour's dot
    assert field > 20 * told()[1]
    assert resultant > 4 * told()[0]
    assert "W112" in codes  # no press strains a pad so


def test_motion_that_is_not_corrected_is_read_as_shear_and_refused_unless_allowed() -> None:
    _, field, codes, found = told(uncorrected=True)
    right = told()
    assert field > 2 * right[1]
    assert "E603" in codes
    assert right[3]["correct"]["off_after"] < 0.2 * right[3]["correct"]["off_before"]
    assert found["correct"]["off_after"] == found["correct"]["off_before"]
    shear = np.array(found["solve"]["force"][:2]) - np.array(right[3]["solve"]["force"][:2])
    assert abs(shear[0]) > 3 * abs(shear[1])  # along the tilt of the camera


def test_the_apparent_motion_is_what_the_optics_make_of_the_truth() -> None:
    sight = eye(False)
    moved = rig().press.displacement(Layer(3e-3, 147e3, 0.3223), sight.markers)
    seen = apparent(False, False, 1.0)
    off = seen - (moved[:, :2] + sight.slope * moved[:, 2:])
    assert np.nanmax(np.abs(off)) < 0.04 * np.abs(moved).max()


def test_a_wrong_indenter_halves_the_force_and_is_flagged_for_the_strain_that_it_makes() -> None:
    resultant, field, codes, _ = told(wrong=True)
    assert resultant > 4 * told()[0]
    assert field > 4 * told()[1]
    assert codes == told()[2] | {"W112"}  # nothing says that the ball is wrong
    assert {"W406", "W412"} <= told(wrong=True, ridge=True)[2]  # an inversion sees that its data contradict the model


def test_noise_makes_the_product_useless_and_a_ridge_does_not() -> None:
    product, ridge = told(noise=30.0), told(noise=30.0, ridge=True)
    assert product[1] > 4 * told()[1]
    assert ridge[1] < 0.75 * product[1]
    assert product[0] < 0.12  # the resultant shows nothing of it


def test_correlation_that_is_ignored_gives_another_band_and_a_lambda_too_small() -> None:
    told_of, ignored = told(noise=30.0, ridge=True), told(noise=30.0, ridge=True, ignored=True)
    assert ignored[3]["solve"]["rule"] == "gcv"
    assert ignored[3]["solve"]["lam"] < 0.01 * told_of[3]["solve"]["lam"]
    assert ignored[1] > 1.4 * told_of[1]
    assert {"W402", "W605"} <= ignored[2]
    assert told()[3]["interpolate"]["held"] == 0.95
    assert told(ignored=True)[3]["interpolate"]["held"] > 0.96
    assert told()[3]["interpolate"]["effective"] < 0.6 * told()[3]["interpolate"]["inside"]


def test_the_table_of_the_documentation_is_what_comes_out() -> None:
    noisy = {"noise": 30.0}
    steps = [{"vanish": True}, {"naive": True}, {"uncorrected": True}, {"wrong": True}, noisy, {**noisy, "ridge": True},
             {**noisy, "ridge": True, "ignored": True}]  # fmt: skip
    text = (
        (Path(__file__).parents[2] / "docs" / "lab.md").read_text("utf-8").split("## The gel pad")[1].split("\n## ")[0]
    )
    rows = [line.split("|")[1:-1] for line in text.splitlines() if line.startswith("| ") and "%" in line]
    assert len(rows) == len(steps)
    for given, (_, resultant, field, said) in zip(steps, rows, strict=True):
        found = told(**given)
        assert float(resultant.replace("%", "")) == pytest.approx(100 * found[0], abs=0.8)
        assert float(field.replace("%", "")) == pytest.approx(100 * found[1], abs=0.8)
        for code in re.findall(r"[EW]\d{3}", said):
            assert code in found[2] or ("inversion" in said and code in told(**given, ridge=True)[2])


def test_nothing_is_made_twice() -> None:
    given = (False, False, 7.0, False, True)
    assert completed(*given) is completed(*given)
    assert ridged(*given, False) is ridged(*given, False)


def test_the_map_after_each_step_is_that_of_the_steps_so_far() -> None:
    """The switches up to a step, all later ones right, in a whole walk of its own."""
    wrong = dict.fromkeys(SWITCHES, True)
    after, codes = shown(Steps(**wrong, noise=9.0, ridge=True))["after"], []
    assert len(after) == len(SWITCHES)
    for k, one in enumerate(after, 1):
        resultant, field, raised, _ = told(**{name: wrong[name] for name in SWITCHES[:k]})
        assert (one["resultant_error"], one["map_error"]) == (resultant, field)
        codes.append({flag["code"] for flag in one["flags"]})
        assert codes[-1] == raised
    assert "W604" in codes[0]  # under the ball
    assert "W604" not in codes[1]  # each got a dot
    assert "E603" in codes[3] - codes[2]
    assert after[4]["map_error"] != after[3]["map_error"]


def test_what_is_said_does_not_hang_on_what_was_asked_before() -> None:
    """Another watch over strains for each, so that no map is taken for the next frame of another."""
    first = told(naive=True)[2]
    completed.cache_clear()
    told(vanish=True, noise=2.0)
    assert told(naive=True)[2] == first
    assert "W112" in first


def test_the_page_answers_what_it_declares_and_refuses_the_rest() -> None:
    right = dict.fromkeys(SWITCHES, False)
    with Lab([page]) as lab:
        found, last = called(lab, "gelpad/steps", **right), called(lab, "gelpad/solve", **right, ridge=False, noise=1.0)
        assert last["map_error"] == pytest.approx(told()[1], rel=1e-3)
        assert last["pressure"] == found["after"][-1]["pressure"]  # nothing is wrong
        assert found["match"]["motion"].count([None, None]) == 2
        assert called(lab, "gelpad/picture", vanish=False, rest=True)["image"].startswith("data:image/png;base64,")
        for wrong in ({"noise": 0.5}, {"noise": 61}, {"noise": None}, {"noise": "1"}, {"vanish": 1}, {"wrong": "true"}):
            status, refused = asked(lab, "gelpad/solve", **{**right, "ridge": False, "noise": 1.0, **wrong})
            assert status == 400
            assert next(iter(wrong)) in refused["error"]
        assert asked(lab, "gelpad/steps", **right, noise=1.0)[0] == 400
        assert asked(lab, "gelpad/picture", vanish=False)[0] == 400
