import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from structures import units
from structures.errors import InputError

KNOWN = {
    "m/s^2": (1.0, "acceleration"), "m/s2": (1.0, "acceleration"), "m/s²": (1.0, "acceleration"),
    "m/s**2": (1.0, "acceleration"), "m s^-2": (1.0, "acceleration"), "m*s-2": (1.0, "acceleration"),
    "mm/s^2": (1e-3, "acceleration"), "g": (9.80665, "acceleration"), "mg": (9.80665e-3, "acceleration"),
    "in/s^2": (0.0254, "acceleration"), "mm/s": (1e-3, "velocity"), "mm": (1e-3, "displacement"),
    "um": (1e-6, "displacement"), "µm": (1e-6, "displacement"), "microstrain": (1e-6, "strain"),
    "um/m": (1e-6, "strain"), "µm/m": (1e-6, "strain"), "m/m": (1.0, "strain"), "N": (1.0, "force"),
    "kN": (1e3, "force"), "lbf": (4.4482216152605, "force"), "Pa": (1.0, "pressure"), "MPa": (1e6, "pressure"),
    "N/mm^2": (1e6, "pressure"), "psi": (6894.757293168361, "pressure"), "lbf/in^2": (6894.757293168361, "pressure"),
    "N*m": (1.0, "moment"), "Nm": (1.0, "moment"), "N·m": (1.0, "moment"), "N-m": (1.0, "moment"),
    "kN*m": (1e3, "moment"), "N/m": (1.0, "line_load"), "kN/m": (1e3, "line_load"), "Hz": (1.0, "frequency"),
    "V": (1.0, "voltage"), "mV": (1e-3, "voltage"), "deg": (math.pi / 180, "angle"), "rad/s": (1.0, "angular_velocity"),
    "ms": (1e-3, "time"), "kg": (1.0, "mass"), "kg*m/s^2": (1.0, "force"), "m/(s^2)": (1.0, "acceleration"),
    "arbitrary": (1.0, "arbitrary"),
}  # fmt: skip


@pytest.mark.parametrize("text", KNOWN)
def test_factor_and_quantity(text):
    unit = units.parse(text)
    assert (unit.factor, unit.quantity) == (pytest.approx(KNOWN[text][0], rel=1e-12), KNOWN[text][1])
    assert units.parse(unit) is unit
    assert unit.si == units.si_symbol(unit.quantity)
    assert units.parse(unit.si).factor == 1.0


@pytest.mark.parametrize(
    "text", ["furlong", "MPA", "m//s", "m/s/s", "N^N", "1/0", "g*", "m^99999", "__class__", "%", "arbitrary/s"]
)
def test_unknown_says_how_to_state_it(text):
    with pytest.raises(InputError, match=r"--unit F=UNIT.*units=\{\"F\": \"UNIT\"\}.*arbitrary") as caught:
        units.parse(text, channel="F")
    assert "channel F" in str(caught.value)


def test_case_matters_and_the_nearest_is_named():
    with pytest.raises(InputError, match="did you mean kN"):
        units.parse("KN")


@pytest.mark.parametrize("text", [None, "", "  ", 3])
def test_missing(text):
    with pytest.raises(InputError, match="the unit is missing"):
        units.parse(text)


def test_check_compares_dimensions():
    assert units.check("g", "acceleration").factor == 9.80665
    assert units.check("um/m", "strain").factor == 1e-6
    with pytest.raises(InputError, match="no unit of force"):
        units.to_si([1.0], "g", quantity="force", channel="F")
    with pytest.raises(InputError, match="no unit of force"):
        units.check("arbitrary", "force")
    with pytest.raises(InputError, match="unknown quantity"):
        units.check("N", "weight")


def test_compound_without_a_name():
    unit = units.parse("N*s")
    assert (unit.quantity, unit.si) == ("other", "m*kg*s^-1")
    assert units.parse(unit.si).dimension == unit.dimension


@given(st.floats(-1e12, 1e12), st.sampled_from(sorted(KNOWN)))
def test_there_and_back(value, text):
    assert units.from_si(units.to_si([value], text), text) == pytest.approx([value], rel=1e-14)


@given(st.text(max_size=80))
def test_any_text_is_a_unit_or_an_input_error(text):
    try:
        assert units.parse(text).factor > 0
        assert units.known(text)
    except InputError:
        assert not units.known(text)


def test_to_si_makes_a_new_array():
    x = np.ones(3)
    assert units.to_si(x, "N") is not x


def test_assignments():
    assert units.assignments(["F=N", "a=b=m/s^2"]) == {"F": "N", "a=b": "m/s^2"}
    for bad in (["F"], ["=N"], ["F=N", "F=kN"], ["F=xyz"]):
        with pytest.raises(InputError):
            units.assignments(bad)
    with pytest.raises(InputError, match="no dictionary"):
        units.as_mapping(["F"])
