"""A channel says what it is: no unit that cannot be, none that is not SI, and no quantity against its class."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from structures import Channel, ForwardModel, InputError, MeasuredModel, chains, units
from structures._system.loads import Moment, MovingPoint, Patch, Point
from structures._system.sensors import Accelerometer, Displacement, StrainGauge, Velocity


@pytest.mark.parametrize("quantity", units.QUANTITIES)
def test_every_quantity_in_its_si_unit_or_arbitrary(quantity):
    assert Channel(label="a", quantity=quantity, unit=units.si_symbol(quantity)).quantity == quantity
    assert Channel(label="a", quantity=quantity).unit == "arbitrary"
    if quantity != "arbitrary":
        assert Channel(label="a", unit=units.si_symbol(quantity)).unit == units.si_symbol(quantity)


@pytest.mark.parametrize("unit", ["m/s2", "m s^-2", "m/s**2"])
def test_spellings_of_the_si_unit_pass(unit):
    assert Channel(label="a", quantity="acceleration", unit=unit).unit == unit


@pytest.mark.parametrize("text", ["m/N", "m/s^2/N".replace("/N", ""), "N*s", "kg*m", "V/N", "m^2*kg"])
def test_what_a_reader_writes_for_a_unit_of_its_own_passes(text):
    unit = units.parse(text)
    assert Channel(label="a", quantity=unit.quantity, unit=unit.si).unit == unit.si


@pytest.mark.parametrize(
    ("quantity", "unit", "words"),
    [
        ("force", "m/s^2", "m/s\\^2 is no unit of force"),
        ("acceleration", "N", "N is no unit of acceleration"),
        ("acceleration", "1", "unknown unit|no unit of acceleration"),
        ("arbitrary", "parsec", "unknown unit"),
        ("force", "parsec", "unknown unit"),
        ("force", "", "unit is missing"),
        ("colour", "m", "unknown quantity"),
        ("acceleration", "g", "speaks SI, and g is 9.80665 m/s\\^2"),
        ("force", "kN", "speaks SI, and kN is 1000 N"),
        ("strain", "um/m", "speaks SI, and um/m is 1e-06 m/m"),
        ("arbitrary", "mV", "speaks SI, and mV is 0.001 V"),
    ],
)
def test_refused(quantity, unit, words):
    with pytest.raises(InputError, match=words) as error:
        Channel(label="a7", quantity=quantity, unit=unit)
    assert "a7" in str(error.value)
    assert error.value.hint


def test_a_recorded_unit_belongs_to_the_record():
    """The same accelerometer in g had the response of m/s^2: a bare array in g then gave a load 9.8 times too small."""
    with pytest.raises(InputError, match=r'state it on the record.*units={"12\+Z": "g"}'):
        Accelerometer("12+Z", unit="g")


@pytest.mark.parametrize(
    "make",
    [
        lambda: Accelerometer("1+Z", unit="N"),
        lambda: Accelerometer("1+Z", unit="m"),
        lambda: Accelerometer("1+Z", quantity="force", unit="N"),
        lambda: Accelerometer("1+RY", unit="m/s^2"),
        lambda: Velocity("1+Z", quantity="displacement", unit="m"),
        lambda: Displacement("1+Z", unit="mm"),
        lambda: StrainGauge(at=0.1, fibre=1e-3, unit="Pa"),
        lambda: StrainGauge(at=0.1, fibre=1e-3, unit="um/m"),
        lambda: StrainGauge(at=0.1, fibre=1e-3, quantity="displacement", unit="m"),
        lambda: Point("1+Z", unit="kN"),
        lambda: Point("1+Z", quantity="moment", unit="N*m"),
        lambda: Point("1+Z", unit="m/s^2"),
        lambda: Moment("1+RY", unit="N"),
        lambda: Patch(x=(0, 1), unit="Pa"),
        lambda: Patch(x=(0, 1), y=(0, 1), unit="N/m"),
        lambda: Patch(x=(0, 1), quantity="pressure", unit="Pa"),
        lambda: MovingPoint([0.1], unit="kN"),
        lambda: MovingPoint([0.1], quantity="moment", unit="N*m"),
    ],
)
def test_sensors_and_loads_refuse_what_they_cannot_be(make):
    with pytest.raises(InputError):
        make()


@pytest.mark.parametrize(
    "made",
    [
        Accelerometer("1+Z"),
        StrainGauge(at=0.1, fibre=1e-3),
        Point("1+Z"),
        Moment("1+RY"),
        Patch(x=(0, 1)),
        Velocity("0+S"),
    ],
)
def test_arbitrary_is_always_allowed_and_a_copy_is_the_same(made):
    assert replace(made, unit="arbitrary").unit == "arbitrary"
    assert replace(made, label="x").quantity == made.quantity


@pytest.mark.parametrize("label", ["", None, 3])
def test_a_channel_needs_a_name(label):
    with pytest.raises(InputError, match="needs a name"):
        Channel(label=label)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf"), "0.1", True, np.array([0.1, 0.2])])
def test_noise_is_one_positive_number(value):
    with pytest.raises(InputError, match="noise must be positive"):
        Channel(label="a", noise=value)
    assert Channel(label="a", noise=np.float64(0.1)).noise == 0.1


def test_an_accelerometer_in_another_kind_is_a_plain_channel():
    m = ForwardModel(
        chains.chain(masses=[1.0, 2.0], springs=100.0, damping=None),
        [Accelerometer("2+X", highpass=0.5)],
        [Point("1+X")],
    )
    f = np.arange(20) * 0.05
    measured = MeasuredModel(f, m.frf(f), sensors=m.sensors, loads=m.loads)
    turned = measured.as_kind("receptance").sensors[0]
    assert (turned.quantity, turned.unit, turned.highpass) == ("displacement", "m", 0.5)


def test_the_table_of_units_is_not_read_for_usual_channels():
    code = (
        "import sys; from structures._channels import Channel; Channel(label='a', quantity='force', unit='N'); "
        "print('structures.units' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
