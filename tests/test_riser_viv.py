"""The riser in sheared current, pinned: one line against the table of case D6, the history with its zones."""

import numpy as np
import pytest

from case_studies import riser_viv


@pytest.fixture(scope="module")
def lines():
    return riser_viv.line_table(seeds=4)


@pytest.fixture(scope="module")
def history():
    return riser_viv.history()


@pytest.mark.parametrize(
    ("noise", "field", "force", "sign", "correlation", "power_in"),
    [
        (0.001, 0.0018, 0.16, 1.0, 0.99, 0.02),
        (0.01, 0.0195, 0.20, 1.0, 0.98, 0.04),
        (0.05, 0.089, 0.34, 0.93, 0.9, 0.23),
    ],
)
def test_one_line(lines, noise, field, force, sign, correlation, power_in):
    """Nine accelerometers and fifteen strains; the zones are right long before the force is."""
    found, estimates = lines[noise]
    assert found.field <= field
    assert found.force <= force
    assert found.sign >= sign
    assert found.correlation >= correlation
    assert found.power_in <= power_in
    assert found.imbalance <= 1e-10
    assert all("W201" in e.codes for e in estimates)  # 24 amplitudes do not determine 59 forces, and it says so


def test_history(history):
    found = history.figures()
    assert found["displacement"] <= 0.02
    assert found["load"] <= 0.25
    assert found["sign of power"] >= 0.99
    assert found["correlation of power"] >= 0.98
    assert found["power in"] <= 0.05
    assert found["equation of motion"] <= 1e-10


def test_the_zones_move(history):
    """The third mode is fed above 0.6 L, the fourth above 0.75 L: within two elements."""
    length, near = riser_viv.RISER["length"], 2 * riser_viv.H
    assert history.begins(4) == pytest.approx(0.6 * length, abs=near)
    assert history.begins(14) == pytest.approx(0.75 * length, abs=near)


def test_the_band_holds_the_load_where_the_basis_can_follow(history):
    """Not at the step of the true load, which no hat follows."""
    estimate = history.estimate
    places = np.asarray(estimate.geometry["coordinates"])[1:-1, 0]
    known = np.array([np.interp(places, riser_viv.X, row) for row in history.truth])
    low, high = estimate.band()
    inside = (low[:, 1:-1] <= known) & (known <= high[:, 1:-1])
    steps = riser_viv.RISER["length"] * np.array([0.6, 0.75])
    calm = np.min(np.abs(places[:, None] - steps), axis=1) > places[1] - places[0]
    assert calm.sum() >= 12
    assert inside[:, calm].mean() >= 0.95
