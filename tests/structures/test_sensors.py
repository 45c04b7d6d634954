import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from structures import Dof, beams, plates, sensors
from structures._system.sensors import Accelerometer, Displacement, StrainGauge, Velocity
from structures.errors import InputError

from .kinds import EVERY, SQUARE, UNIT

ORIGIN = 3.0
BEAM = beams.free(elements=5, origin=ORIGIN, **UNIT)
PLATE = plates.plate(elements=(4, 3), edges="FFFF", origin=(-1.0, 2.0), **{**SQUARE, "lengths": (0.8, 0.6)})
P, Q = np.polynomial.Polynomial([0.3, -1.2, 0.7, 2.0]), np.polynomial.Polynomial([-0.4, 0.9, 1.1, -0.6])
fractions = st.floats(0, 1)


def beam_field():
    x = BEAM.coordinates[:, 0] - ORIGIN
    return np.column_stack([P(x), P.deriv()(x)]).ravel()


def plate_field():
    """w = P(x) Q(y), any bicubic: the element holds it exactly."""
    x, y = (PLATE.coordinates - [-1.0, 2.0]).T
    return np.column_stack([P(x) * Q(y), P.deriv()(x) * Q(y), P(x) * Q.deriv()(y), P.deriv()(x) * Q.deriv()(y)]).ravel()


@settings(max_examples=60)
@given(fractions)
def test_a_cubic_is_read_exactly_on_a_beam(x):
    u, at = beam_field(), ORIGIN + x
    assert Displacement(at=at).row(BEAM) @ u == pytest.approx(P(x), abs=1e-12)
    assert Displacement(at=at, direction="+RY").row(BEAM) @ u == pytest.approx(-P.deriv()(x), abs=1e-11)
    assert StrainGauge(at=at, fibre=0.02).row(BEAM) @ u == pytest.approx(-0.02 * P.deriv(2)(x), abs=1e-11)


@settings(max_examples=60)
@given(fractions, fractions, st.floats(-4, 4))
def test_a_bicubic_is_read_exactly_on_a_plate(sx, sy, angle):
    u, x, y = plate_field(), 0.8 * sx, 0.6 * sy
    at = (x - 1.0, y + 2.0)
    assert Displacement(at=at).row(PLATE) @ u == pytest.approx(P(x) * Q(y), abs=1e-12)
    assert Displacement(at=at, direction="RX").row(PLATE) @ u == pytest.approx(P(x) * Q.deriv()(y), abs=1e-11)
    assert Displacement(at=at, direction="-RY").row(PLATE) @ u == pytest.approx(P.deriv()(x) * Q(y), abs=1e-11)
    c, s = np.cos(angle), np.sin(angle)
    bend = c * c * P.deriv(2)(x) * Q(y) + 2 * c * s * P.deriv()(x) * Q.deriv()(y) + s * s * P(x) * Q.deriv(2)(y)
    gauge = StrainGauge(at=at, fibre=-0.01, angle=angle)
    assert gauge.row(PLATE) @ u == pytest.approx(0.01 * bend, abs=1e-10)


@settings(max_examples=40)
@given(st.floats(0.2, 0.8), st.floats(1e-4, 0.39))
def test_a_long_gauge_reads_the_mean_even_across_elements(x, length):
    mean = (P.deriv()(x + length / 2) - P.deriv()(x - length / 2)) / length
    gauge = StrainGauge(at=ORIGIN + x, fibre=0.02, length=length)
    assert gauge.row(BEAM) @ beam_field() == pytest.approx(-0.02 * mean, rel=1e-7, abs=1e-9)


@settings(max_examples=12, deadline=None)
@given(st.floats(0.3, 0.5), st.floats(0.25, 0.35), st.floats(0.01, 0.4), st.floats(-3, 3))
def test_a_long_gauge_on_a_plate_is_the_mean_of_point_gauges(x, y, length, angle):
    u, at = np.random.default_rng(3).standard_normal(PLATE.n), np.array([x - 1.0, y + 2.0])
    d = np.array([np.cos(angle), np.sin(angle)])
    t = (np.arange(100) + 0.5) / 100 - 0.5
    points = [StrainGauge(at=tuple(at + length * s * d), fibre=0.05, angle=angle).row(PLATE) @ u for s in t]
    got = StrainGauge(at=tuple(at), fibre=0.05, angle=angle, length=length).row(PLATE) @ u
    assert got == pytest.approx(np.mean(points), abs=2e-2 * np.abs(points).max())


def test_a_point_at_a_node_is_the_node():
    for k, x in enumerate(BEAM.coordinates[:, 0]):
        assert np.array_equal(Displacement(at=x).row(BEAM), Displacement(f"{k}+Z").row(BEAM))
        assert np.array_equal(Accelerometer(at=x, direction="-RY").row(BEAM), Accelerometer(f"{k}-RY").row(BEAM))
    for k, (x, y) in enumerate(PLATE.coordinates):
        for axis in ("+Z", "-RX", "+RY"):
            want = Displacement((k, axis)).row(PLATE)
            assert Displacement(at=(x, y), direction=axis).row(PLATE) == pytest.approx(want, abs=1e-14)


def test_a_gauge_at_a_node_reads_the_mean_of_both_sides():
    u = np.random.default_rng(2).standard_normal(BEAM.n)
    left, node, right = (StrainGauge(at=3.4 + d, fibre=1.0).row(BEAM) @ u for d in (-1e-7, 0.0, 1e-7))
    assert abs(left - right) > 1.0
    assert node == pytest.approx((left + right) / 2, rel=1e-4)


@pytest.mark.parametrize("name", sorted(EVERY))
def test_polarity_flips_the_row_of_every_structure(name):
    s = EVERY[name]()
    for dof in s.dofs[:4]:
        if 0 < dof.axis <= 6:
            plus, minus = Velocity(Dof(dof.node, dof.axis)), Velocity(Dof(dof.node, -dof.axis))
            assert np.array_equal(plus.row(s), -minus.row(s))
            assert np.abs(plus.row(s)).sum() == 1


def test_labels_units_and_derivatives():
    a = Accelerometer("12Z+", noise=0.01, highpass=0.5)
    assert (a.label, a.quantity, a.unit, a.derivative, a.noise, a.highpass) == (
        "12+Z",
        "acceleration",
        "m/s^2",
        2,
        0.01,
        0.5,
    )
    assert (Velocity("1-X").label, Velocity("1-X").unit, Velocity("1-X").derivative) == ("1-X", "m/s", 1)
    assert (Displacement("1+RY").unit, Displacement("1+RY").quantity, Displacement("1+S").unit) == (
        "rad",
        "angle",
        "arbitrary",
    )
    assert Displacement(at=0.31).label == "x=0.31 +Z"
    assert Displacement(at=(0.1, 0.2), direction="-Z").label == "x=0.1 y=0.2 -Z"
    gauge = StrainGauge(at=0.02, fibre=0.005)
    assert (gauge.label, gauge.unit, gauge.derivative) == ("strain x=0.02", "m/m", 0)
    assert Displacement("1+Z", label="tip", unit="arbitrary").label == "tip"
    assert len({Displacement("1+Z"), Displacement("1Z+"), Displacement("1-Z"), Velocity("1+Z")}) == 3


def test_rows_of_several_sensors():
    both = sensors.matrix(BEAM, [Displacement("0+Z"), Accelerometer("5-Z")])
    assert both.shape == (2, BEAM.n)
    assert both[1].min() == -1
    assert sensors.matrix(BEAM, []).shape == (0, BEAM.n)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (lambda: Displacement(), "one place"),
        (lambda: Displacement("1+Z", at=0.1), "one place"),
        (lambda: Displacement("1+XY"), "twist"),
        (lambda: Displacement("1Z"), "no DOF"),
        (lambda: Displacement(at=np.nan), "no place"),
        (lambda: Displacement(at="here"), "no place"),
        (lambda: Displacement("1+Z", noise=-1.0), "noise"),
        (lambda: Displacement(at=4.2).row(BEAM), "expected: 3 <= x <= 4"),
        (lambda: Displacement(at=2.9).row(BEAM), "outside"),
        (lambda: Displacement(at=(-0.5, 2.7)).row(PLATE), "expected: 2 <= y <= 2.6"),
        (lambda: Displacement(at=(0.1, 0.2)).row(BEAM), "finite x in m"),
        (lambda: Displacement(at=0.1).row(PLATE), "finite x, y in m"),
        (lambda: Displacement(at=3.1, direction="X").row(BEAM), "a beam moves along Z"),
        (lambda: Displacement(at=(-0.5, 2.1), direction="X").row(PLATE), "a plate moves along Z"),
        (lambda: Displacement("9+Z").row(BEAM), "nodes 0 to 5"),
        (lambda: Displacement(at=0.1).row(EVERY["oscillator"]()), "lumped masses"),
        (lambda: Displacement(at=0.1).row(EVERY["user"]()), "no mesh"),
        (lambda: StrainGauge(at=3.1, fibre=0.0), "fibre"),
        (lambda: StrainGauge(at=3.1, fibre=1.0, length=0.0), "gauge length"),
        (lambda: StrainGauge(at=3.1, fibre=1.0, angle=np.inf), "angle"),
        (lambda: StrainGauge(at=3.1, fibre=1.0, angle=1.0).row(BEAM), "axial strain only"),
        (lambda: StrainGauge(at=3.1, fibre=1.0, length=0.3).row(BEAM), "outside"),
        (lambda: StrainGauge(at=0.1, fibre=1.0).row(EVERY["oscillator"]()), "lumped masses"),
    ],
)
def test_bad_sensors_raise(bad, words):
    with pytest.raises(InputError, match=words):
        bad()
