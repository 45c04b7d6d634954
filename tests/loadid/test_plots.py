"""Pictures hold what they must, need no window, and survive odd labels."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from loadid._results.estimate import Axis
from loadid._results.summary import pulse_window
from loadid.paths import Choice
from structures.errors import InputError
from tests.loadid.made import CERTIFICATE, half_sine, impact, static

KINDS = ["load", "response", "path"]


def words(figure: Figure) -> str:
    from matplotlib.text import Text

    return "\n".join(t.get_text() for t in figure.findobj(Text))


@pytest.mark.parametrize("kind", KINDS)
def test_every_picture_says_what_it_must_not_travel_without(kind):
    text = words(impact(allowed=["e110", "W407"]).plot(kind))
    assert "forward model not verified" in text
    assert "allowed: LID-E110, LID-W407" in text
    free = replace(impact(allowed=["E306"]).choice, lam=0.0)
    assert "OVERRIDDEN: LID-E306" in words(impact(allowed=["E306"], choice=free, facts={"rank": 3, "n": 9}).plot())
    assert "W114" in text
    verified = words(impact(certificate=CERTIFICATE).plot(kind))
    assert "not verified" not in verified
    assert "verified 2026-11-02" in verified
    assert "OVERRIDDEN" not in verified


def test_load_picture_shows_load_band_and_truth():
    e = impact()
    t, truth = half_sine()
    figure = e.plot(truth=truth)
    full, zoom = figure.axes
    lines = {line.get_label(): line for line in full.get_lines()}
    np.testing.assert_array_equal(lines["estimate"].get_ydata(), e.load[:, 0])
    np.testing.assert_array_equal(lines["truth"].get_ydata(), truth)
    np.testing.assert_allclose(lines["estimate"].get_xdata(), 1e3 * t)
    assert full.get_xlabel() == "time [ms]"
    assert full.get_ylabel() == "load [N]"
    corners = full.collections[0].get_paths()[0].vertices[:, 1]
    assert corners.max() == pytest.approx(e.band()[1].max())
    assert corners.min() == pytest.approx(e.band()[0].min())
    start, stop = zoom.get_xlim()
    assert start < 10 < 12 < stop < 25  # the pulse with a margin, in ms


def test_a_long_load_is_not_enlarged():
    e = impact(load=np.sin(np.arange(400) / 20)[:, None])
    assert pulse_window(e, 0) is None
    assert len(e.plot().axes) == 1


def test_many_loads_show_the_largest_and_say_so():
    e = impact(loads=20)
    figure = e.plot()
    assert "6 largest of 20 loads" in words(figure)
    assert "11+Z" in words(figure)  # the load that was hit


def test_residual_picture_states_its_share():
    e = impact()
    text = words(e.plot("response"))
    share = np.linalg.norm(e.residual[:, 2]) / np.linalg.norm(e.response[:, 2])
    assert f"residual, {share:.2%} of the signal" in text
    assert "[m/s²]" in text


def test_path_picture_marks_every_rule_on_the_curve():
    e = impact()
    left, right = e.plot("path").axes[:2]
    labels = [t.get_text() for t in left.get_legend().get_texts()]
    assert labels == ["robust_gcv: 0.0012 (used)", "gcv: 0.0009", "l_curve: 1e-06"]
    marked = [line.get_xdata()[0] for line in right.get_lines() if line.get_marker() not in ("None", "")]
    assert marked == [1.2e-3, 9e-4, 1e-6]


@pytest.mark.parametrize(
    "make",
    [
        static,
        lambda **k: static(60, **k),
        lambda **k: impact(2, 1, units=["N", "N m"], **k),
        lambda **k: impact(3, 9, **k),
    ],
)
def test_every_shape_of_load_has_a_picture(make, tmp_path):
    e = make()
    e.plot(path=tmp_path / "load.png", truth=e.load)
    e.plot("response", path=tmp_path / "response.svg")
    assert (tmp_path / "load.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "response.svg").stat().st_size > 1000


def test_odd_labels_and_constant_signals_are_drawn(tmp_path):
    e = impact(
        labels=["$x^{ <b>\n"], sensors=["$", "\\frac", "ü" * 200], load=np.zeros((400, 1)), std=np.zeros((400, 1)),
        response=np.zeros((400, 3)), residual=np.zeros((400, 3)),
    )  # fmt: skip
    for kind in ("load", "response"):
        e.plot(kind, path=tmp_path / f"{kind}.png")
    one = impact(
        load=[[1.0]],
        std=[[1.0]],
        axis=Axis("time", "s", [0.0]),
        response=[[0.0] * 3],
        residual=[[0.0] * 3],
        posterior=None,
    )
    one.plot(path=tmp_path / "one.png")


def test_own_axes_are_drawn_into():
    figure = Figure()
    ax = figure.subplots()
    assert impact().plot(ax=ax) is figure
    assert len(ax.get_lines()) == 2


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"kind": "pie"}, "no such picture"),
        ({"truth": np.ones(3)}, "known load does not fit"),
        ({"path": "x.xyz"}, "no picture format"),
        ({"path": "none/x.png"}, "cannot be written"),
    ],
)
def test_what_cannot_be_drawn_is_refused(arguments, word, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=word):
        impact().plot(**arguments)


def test_pictures_of_what_is_not_there_are_refused():
    with pytest.raises(InputError, match="no response"):
        impact(response=None).plot("response")
    with pytest.raises(InputError, match="no sweep"):
        impact(choice=Choice(1e-3, 1.0, "given")).plot("path")


def test_pictures_leave_the_global_state_alone(tmp_path):
    code = """
import sys
from tests.loadid.made import impact
impact().plot(path=sys.argv[1])
assert "matplotlib.pyplot" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code, f"{tmp_path}/x.png"], check=True)
