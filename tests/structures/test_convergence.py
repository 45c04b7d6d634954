"""The elements converge at the order that theory gives them."""

import numpy as np
import pytest

from structures import beams, loads, plates, sensors

from .exact import beam_roots, frequencies, solve
from .kinds import SQUARE, UNIT


def orders(errors):
    """Observed order between meshes, each twice as fine."""
    errors = np.abs(np.array(errors))
    return np.log2(errors[:-1] / errors[1:])


@pytest.mark.parametrize("ends", [("clamped", "free"), ("pinned", "pinned"), ("clamped", "guided")])
def test_beam_frequencies_converge_with_order_four(ends):
    exact = beam_roots(*ends)[:3]
    meshes = (6, 12, 24)
    found = np.array([frequencies(beams.beam(left=ends[0], right=ends[1], elements=n, **UNIT), 3) for n in meshes])
    errors = found / exact - 1
    assert np.all(errors > 0)
    assert orders(errors) == pytest.approx(4.0, abs=0.25)
    # the constant too: (beta h)^4 / 1440
    assert errors[-1] == pytest.approx(exact**2 / 24.0**4 / 1440, rel=0.1)


def test_simply_supported_plate_converges_with_order_four():
    exact = np.pi**2 * np.array([2, 5, 5])
    found = np.array([frequencies(plates.plate(elements=(n, n), **SQUARE), 3) for n in (4, 8, 16)])
    assert orders(found / exact - 1) == pytest.approx(4.0, abs=0.2)
    assert (found / exact - 1)[1] == pytest.approx([8e-6, 1.7e-4, 1.7e-4], rel=0.1)


def test_clamped_plate_converges_with_order_four_to_the_known_values():
    known = np.array([35.98519, 73.39385, 73.39385, 108.2165, 131.5808, 132.2048])
    coarse, middle, fine = (frequencies(plates.plate(elements=(n, n), edges="CCCC", **SQUARE), 6) for n in (6, 12, 24))
    # the order shows without any known value
    assert np.log2((coarse - middle) / (middle - fine)) == pytest.approx(4.0, abs=0.35)
    assert middle == pytest.approx(known, rel=1e-3)
    assert fine == pytest.approx(known, rel=1e-4)
    assert fine + (fine - middle) / 15 == pytest.approx(known, rel=2e-6)


def test_strain_of_a_pressed_beam_converges_with_order_two():
    errors = []
    for n in (5, 10, 20):  # the gauge sits in the same place of its element on each mesh
        s = beams.simply_supported(elements=n, **UNIT)
        u = solve(s, loads.Patch(x=(0.0, 1.0)).column(s))
        x = 0.4
        errors.append(sensors.StrainGauge(at=x, fibre=1.0).row(s) @ u - x * (1 - x) / 2)
    assert orders(errors) == pytest.approx(2.0, abs=0.05)
