"""Sensors chosen for hits: all sets, the search, and what simulated records say; any dynamic model; the command."""

from __future__ import annotations

import json
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from loadid import InputError, design
from loadid.cli import main
from loadid.design._forecast import forecast
from loadid.design._hits import Pulse
from structures import ForwardModel, FrfModel, StateSpace, beams, damping, loads, sensors
from tests.loadid.test_forecast import scatter

PULSE = (4e-3, 100.0)
PLACES = (0.2, 0.4, 0.5, 0.6, 0.8, 1.0)


def cantilever(places: Any = PLACES, noise: float = 0.5) -> ForwardModel:
    beam = beams.cantilever(length=1.0, section=beams.Section.rectangle(0.04, 0.01), material=beams.materials.steel,
                            elements=20, damping=damping.Modal(0.02))  # fmt: skip
    seen = [sensors.Accelerometer(at=x, label=f"a{x:g}", noise=noise) for x in places]
    acting = [loads.Point(at=x, label=label) for x, label in ((0.45, "F1"), (0.95, "F2"))]
    return ForwardModel(beam, seen, acting, modes=6)


@pytest.fixture(scope="module")
def placed() -> design.Placement:
    return design.place_for_hits(cantilever(), 2, pulse=PULSE)


def test_the_best_of_all_sets_is_found_and_by_the_search_too(placed: design.Placement) -> None:
    """Each set as a model of its own, by the forecast of `loadid check`, which is twice as fine and longer."""
    told = {rows: forecast(cantilever([PLACES[i] for i in rows]), pulse=Pulse(*PULSE)).worst.error
            for rows in combinations(range(len(PLACES)), 2)}  # fmt: skip
    chosen = tuple(sorted(placed.chosen))
    assert placed.method == "all sets"
    assert placed.forecast.worst.error == pytest.approx(told[chosen], rel=1e-9)
    assert told[chosen] <= 1.1 * min(told.values())
    assert told[chosen] < 0.8 * np.median(list(told.values()))
    searched = design.place_for_hits(cantilever(), 2, pulse=PULSE, exhaustive=False)
    assert sorted(searched.chosen) == sorted(placed.chosen)
    assert searched.method != placed.method


def test_records_agree_that_the_choice_is_better_than_a_bad_one(placed: design.Placement) -> None:
    error = []
    for rows in (placed.chosen, (0, 1)):
        model = cantilever([PLACES[i] for i in rows])
        told = forecast(model, pulse=Pulse(*PULSE))
        error.append(max(scatter(model, told, j, 3) for j in range(2)))
    assert error[0] < 0.7 * error[1]


def test_what_is_told_beside_the_sensors(placed: design.Placement) -> None:
    assert (placed.layout.rank, placed.layout.nullity) == (2, 0)
    assert placed.everything.share.max() <= placed.layout.share.max()
    assert placed.random[0] >= 0.9 * placed.layout.share.max()
    assert placed.gains[-1][1] == pytest.approx(placed.layout.share.max())
    assert placed.gains[0][1] > placed.gains[1][1]
    assert "random layouts" in str(placed)
    json.dumps(placed.to_dict(), allow_nan=False)
    (panel,) = placed.plot().axes
    assert "error of a hit" in panel.get_ylabel()
    kept = design.place_for_hits(cantilever(), 2, pulse=PULSE, keep=["a0.2"], criterion="mean")
    assert "a0.2" in kept.sensors


def test_every_dynamic_model_is_taken() -> None:
    """FRFs, whose lines are all that is known, and a state space; the choice is that of the structure behind them."""
    whole = cantilever()
    table = FrfModel.of(whole, np.arange(4.0, 800.0, 4.0))
    by_lines = design.place_for_hits(table, 2, pulse=PULSE, noise=0.5)
    assert by_lines.forecast.dt is None
    assert by_lines.layout.share.max() <= 1.01 * by_lines.random[0]
    space = whole.state_space(5e-4, "zoh")
    own = StateSpace(space.A, space.B, space.C, space.D, 5e-4, sensors=whole.sensors, loads=whole.loads)
    by_state = design.place_for_hits(own, 2, pulse=PULSE)
    assert by_state.forecast.dt == 5e-4
    assert sorted(by_state.chosen) == sorted(design.place_for_hits(whole, 2, pulse=PULSE).chosen)


@pytest.mark.parametrize(
    ("given", "says"),
    [({"n": 7}, "no such number"), ({"criterion": "D"}, "no such criterion"), ({"keep": ["a9"]}, "no such sensors"),
     ({"noise": -1.0}, "noise does not fit"), ({"pulse": (1e-7, 1.0)}, None)],
)  # fmt: skip
def test_wrong_wishes(given: dict[str, Any], says: str | None) -> None:
    wishes = {"n": 2, "pulse": PULSE, **given}
    if says is None:  # a pulse far above the modes is short, and judged all the same
        assert design.place_for_hits(cantilever(), **wishes).layout.share.max() > 0
        return
    with pytest.raises(InputError, match=says):
        design.place_for_hits(cantilever(), **wishes)


def test_the_command_line_places_for_hits(tmp_path: Any, capsys: pytest.CaptureFixture[str], placed: Any) -> None:
    cantilever().save(tmp_path / "c.h5")
    pulse = ["--pulse", f"{PULSE[0]}:{PULSE[1]}"]
    assert main(["design", str(tmp_path / "c.h5"), "-n", "2", *pulse, "--plot", str(tmp_path / "p.png"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert sorted(told["chosen"]) == sorted(placed.chosen)
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
    assert main(["design", str(tmp_path / "c.h5"), "-n", "2"]) == 0  # accelerometers see no load that stands still
    assert "a hit of 1 ms and 100 N" in capsys.readouterr().out
    for wrong in (["--snr", "10"], ["--criterion", "D"], ["--pulse", "3"]):
        assert main(["design", str(tmp_path / "c.h5"), "-n", "2", *wrong]) == 2, wrong
        assert capsys.readouterr().err
