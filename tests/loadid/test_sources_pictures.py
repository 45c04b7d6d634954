"""Pictures of sources and paths: what they show, in which unit, and that they are saved."""

import numpy as np
import pytest

from loadid._plots.sources import mac_figure
from loadid.sources import compare, contributions, mac, validate_on
from structures import InputError
from tests.loadid import sourced
from tests.loadid.sourced import LINES, densities, estimated, table

H = sourced.receiver()
F = sourced.spectra(len(LINES), 2) * [3.0, 1.0]
Y = np.einsum("lij,lj->li", H, F)
STD = np.full(F.shape, 0.1)
STD[30:50, 0] = 1e3


def estimate(**changes):
    return estimated(F, STD, labels=["engine $1$", "pump"], response=Y, residual=0 * Y,
                     sensors=["a0", "a1", "a2", "a3"], sensor_units=["m/s^2"] * 4, **changes)  # fmt: skip


MODEL = table(H, loads=["engine $1$", "pump"])


def words(figure):
    texts = [t.get_text() for ax in figure.axes for t in (*ax.texts, ax.title, ax.xaxis.label, ax.yaxis.label)]
    texts += [ax.get_title(loc="left") for ax in figure.axes]
    texts += [t.get_text() for ax in figure.axes if ax.get_legend() for t in ax.get_legend().get_texts()]
    return " | ".join([*texts, figure.get_suptitle()])


@pytest.mark.parametrize("kind", ["stacked", "map"])
@pytest.mark.parametrize("power", [False, True])
def test_contributions_are_drawn_with_names_and_units(tmp_path, kind, power):
    S = np.einsum("lj,lk->ljk", F, F.conj())
    e = densities(S, labels=["engine $1$", "pump"]) if power else estimate()
    path = tmp_path / "c.png"
    figure = contributions(MODEL, e, trust=None if power else 1.0).plot(kind, sensor="a2", path=path)
    assert path.stat().st_size > 10_000
    said = words(figure)
    assert "pump" in said
    assert "not verified" in said
    assert ("share [%]" if kind == "stacked" else "frequency [Hz]") in said
    assert "²" in said
    assert "dB re 1" in said
    assert ("measured" in said) == (kind == "map" and not power)
    assert ("not trusted" in said) == (kind == "map" and not power)


def test_stacked_shares_add_to_all():
    figure = contributions(MODEL, estimate()).plot(sensor=1)
    bars = [p for p in figure.axes[0].patches if p.get_height() > 0]
    tops = {}
    for p in bars:
        x = round(p.get_x(), 6)
        tops[x] = max(tops.get(x, 0), p.get_y() + p.get_height())
    np.testing.assert_allclose(list(tops.values()), 100, rtol=1e-9)


def test_a_prediction_is_drawn_with_its_band_and_its_errors(tmp_path):
    made = validate_on(estimate(), MODEL, 1.5 * Y, noise=0.1)
    figure = made.plot(path=tmp_path / "t.png")
    said = words(figure)
    for text in (
        "95% band",
        "measured",
        "synthesised",
        "FRAC 1.000",
        "error [dB]",
        "third octave band [Hz]",
        "-3.52 dB",
    ):
        assert text in said
    assert "first" not in said
    five = compare(np.tile(Y, 2), np.tile(Y, 2), frequencies=LINES).plot(fraction=1)
    assert five.get_supylabel() == "first 4 of 8 sensors"


def test_levels_over_time_are_drawn():
    x = np.random.default_rng(0).standard_normal((3000, 2))
    c = compare(x, 2 * x, dt=1e-3, sensors=["left", "right"], units=["m", "m"])
    said = words(c.plot("running", sensor="right", window="slow"))
    assert "right, slow time weighting" in said
    assert "rms 6.02 dB" in said
    assert "time [s]" in said
    assert "TRAC 1.000" in words(c.plot())


def test_a_mac_matrix_is_drawn_with_its_numbers(tmp_path):
    figure = mac_figure(mac(np.eye(3)), rows=["1", "2", "3"], path=tmp_path / "mac.svg")
    assert sum(t.get_text() == "1.00" for t in figure.axes[0].texts) == 3
    assert (tmp_path / "mac.svg").stat().st_size > 3000


@pytest.mark.parametrize(
    "call",
    [
        lambda: contributions(MODEL, estimate()).plot("pie"),
        lambda: contributions(MODEL, estimate()).plot(sensor="b"),
        lambda: compare(Y, Y, frequencies=LINES).plot("pie"),
        lambda: compare(Y, Y, frequencies=LINES).plot("running"),
        lambda: compare(Y, Y, frequencies=LINES).plot(sensor=9),
        lambda: mac_figure(2 * np.eye(2)),
        lambda: mac_figure(np.eye(2), rows=["1"]),
    ],
)
def test_pictures_that_do_not_exist_are_refused(call):
    with pytest.raises(InputError):
        call()
