from itertools import product

import numpy as np
import pytest

from structures import loads, plates, sensors
from structures._elements.members import Material
from structures.errors import InputError

from .exact import frequencies, levy_roots, navier, solve
from .kinds import PLAIN, SQUARE

CLAMPED = [35.98519, 73.39385, 73.39385, 108.2165, 131.5808, 132.2048]


def square(n, edges="SSSS", **settings):
    return plates.plate(elements=(n, n), edges=edges, **{**SQUARE, **settings})


def test_simply_supported_square():
    exact = np.sort([np.pi**2 * (m * m + n * n) for m, n in product(range(1, 8), repeat=2)])[:10]
    assert frequencies(square(14), 10) == pytest.approx(exact, rel=1e-3)


def test_simply_supported_rectangle_with_prestress():
    a, b, Nx, Ny = 1.0, 0.7, 40.0, -15.0
    s = plates.plate(
        lengths=(a, b), thickness=SQUARE["thickness"], material=PLAIN, elements=(16, 12), prestress=(Nx, Ny)
    )
    kx, ky = (np.array([(np.pi * m / side) ** 2 for m in range(1, 9)]) for side in (a, b))
    exact = np.sqrt((kx[:, None] + ky) ** 2 + Nx * kx[:, None] + Ny * ky).ravel()
    assert frequencies(s, 10) == pytest.approx(np.sort(exact)[:10], rel=1e-3)


def test_steel_plate_in_hertz():
    steel = Material(E=210e9, rho=7850.0, nu=0.3)
    s = plates.plate(lengths=(0.5, 0.4), thickness=3e-3, material=steel, elements=(8, 8))
    D = 210e9 * 3e-3**3 / 12 / 0.91
    exact = (np.pi / 0.5) ** 2 + (np.pi / 0.4) ** 2
    assert frequencies(s, 1)[0] == pytest.approx(exact * np.sqrt(D / (7850 * 3e-3)), rel=1e-4)


@pytest.mark.parametrize(("lower", "upper"), ["SS", "SC", "SF", "CC", "CF", "FF"])
def test_plates_with_two_simple_edges_have_the_levy_frequencies(lower, upper):
    s = square(14, f"S{lower}S{upper}")
    exact = levy_roots(lower, upper, 0.3)
    assert frequencies(s, 10) == pytest.approx(exact, rel=1e-3)
    turned = square(14, f"{lower}S{upper}S")
    assert frequencies(turned, 10) == pytest.approx(frequencies(s, 10), rel=1e-6)


def test_the_levy_roots_are_those_of_the_literature():
    """Leissa (1973), square plates, nu = 0.3."""
    known = {"CC": 28.9509, "SC": 23.6463, "CF": 12.6874, "SF": 11.6845, "FF": 9.6314}
    for ends, value in known.items():
        assert levy_roots(*ends, 0.3, count=1)[0] == pytest.approx(value, rel=1e-5)


def test_clamped_square():
    assert frequencies(square(16, "CCCC"), 6) == pytest.approx(CLAMPED, rel=2e-4)


def test_cantilever_square():
    known = [3.4710, 8.5062, 21.284, 27.199, 30.954, 54.184]
    assert frequencies(square(12, "CFFF"), 6) == pytest.approx(known, rel=1e-3)


def test_free_square():
    """Known values of the completely free square plate (Ritz solutions of the literature)."""
    assert frequencies(square(12, "FFFF"), 5) == pytest.approx([13.468, 19.596, 24.270, 34.801, 34.801], rel=1e-3)


@pytest.mark.parametrize("edges", ["CSFF", "CCSF", "SCCF", "FCSC"])
def test_a_turned_plate_is_the_same_plate(edges):
    turned = edges[-1] + edges[:-1]
    assert frequencies(square(6, turned), 6) == pytest.approx(frequencies(square(6, edges), 6), rel=1e-6)


# -- statics -------------------------------------------------------------------------------------------------------
def centre(s, load, sensor):
    return sensor.row(s) @ solve(s, load.column(s))


MIDDLE = sensors.Displacement(at=(0.5, 0.5))
PRESSURE, FORCE = loads.Patch(x=(0, 1), y=(0, 1)), loads.Point(at=(0.5, 0.5))


@pytest.mark.parametrize(
    ("edges", "load", "exact"),
    [
        ("SSSS", PRESSURE, 0.00406235),
        ("CCCC", PRESSURE, 0.00126532),
        ("SSSS", FORCE, 0.0116008),
        ("CCCC", FORCE, 0.005612),
    ],
)
def test_static_deflections(edges, load, exact):
    assert centre(square(20, edges), load, MIDDLE) == pytest.approx(exact, rel=1e-3)


def test_gauge_on_a_pressed_plate():
    """Strain at the centre of the upper face of a simply supported plate, along 0, 30 and 90 degrees (Navier)."""

    def series(bend):
        return navier(lambda m, n: 16 / (np.pi**2 * m * n), lambda m, n: bend(m, n) * (-1) ** ((m + n) // 2 - 1), 161)

    k = series(lambda m, n: (m * np.pi) ** 2)  # -w_xx at the centre
    s = square(24)
    for angle in (0.0, np.pi / 6, np.pi / 2):
        gauge = sensors.StrainGauge(at=(0.5, 0.5), fibre=0.05, angle=angle)
        assert centre(s, PRESSURE, gauge) == pytest.approx(0.05 * k, rel=1e-3)
        averaged = sensors.StrainGauge(at=(0.5, 0.5), fibre=0.05, angle=angle, length=1e-3)
        assert centre(s, PRESSURE, averaged) == pytest.approx(0.05 * k, rel=1e-3)


def test_a_strip_bends_like_a_beam_when_poisson_is_zero():
    material = Material(E=12.0 / 0.05**3, rho=1.0, nu=0.0)
    s = plates.plate(lengths=(1.0, 0.2), thickness=0.05, material=material, elements=(6, 2), edges="CFFF")
    u = solve(s, loads.Patch(x=(0, 1), y=(0, 0.2)).column(s))
    assert sensors.Displacement(at=(1.0, 0.1)).row(s) @ u == pytest.approx(1 / 8, rel=1e-8)
    # rotation about Y is -w_x, about X it is w_y
    assert sensors.Displacement(at=(1.0, 0.1), direction="RY").row(s) @ u == pytest.approx(-1 / 6, rel=1e-8)
    assert sensors.Displacement(at=(1.0, 0.1), direction="RX").row(s) @ u == pytest.approx(0, abs=1e-10)


@pytest.mark.parametrize(
    "settings",
    [{"edges": "SSS"}, {"edges": "SSSX"}, {"edges": "ssss"}, {"edges": None}, {"thickness": 0.0}, {"elements": (0, 3)},
     {"lengths": (1.0, -1.0)}, {"prestress": (np.nan, 0.0)}, {"elements": (2.5, 3)}, {"thickness": np.nan}],
)  # fmt: skip
def test_bad_plates_raise(settings):
    with pytest.raises(InputError):
        plates.plate(**{**SQUARE, "elements": (3, 3), **settings})
