import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from structures import beams, loads, plates
from structures._system.loads import Moment, MovingPoint, Patch, Point, near_support
from structures.errors import InputError

from .kinds import EVERY, SQUARE, UNIT
from .test_sensors import BEAM, ORIGIN, PLATE, P, Q, beam_field, plate_field

spans = st.lists(st.floats(0, 1), min_size=2, max_size=2, unique=True).map(sorted).filter(lambda s: s[1] - s[0] > 1e-6)


# -- work of loads on polynomial fields ----------------------------------------------------------------------------
@settings(max_examples=60)
@given(spans)
def test_a_patch_on_a_beam_integrates_the_field(span):
    a, b = span
    patch = Patch(x=(ORIGIN + a, ORIGIN + b))
    exact = P.integ()(b) - P.integ()(a)
    assert patch.column(BEAM) @ beam_field() == pytest.approx(exact, abs=1e-12)
    rigid = BEAM.field.rigid()
    assert patch.column(BEAM) @ rigid["translation Z"] == pytest.approx(patch.measure, rel=1e-9)
    assert patch.column(BEAM) @ rigid["rotation RY"] == pytest.approx((b - a) * ((a + b) / 2 - 0.5), abs=1e-12)


@settings(max_examples=40)
@given(spans, spans)
def test_a_patch_on_a_plate_integrates_the_field(sx, sy):
    x, y = 0.8 * np.array(sx), 0.6 * np.array(sy)
    patch = Patch(x=tuple(x - 1.0), y=tuple(y + 2.0))
    exact = np.diff(P.integ()(x))[0] * np.diff(Q.integ()(y))[0]
    assert patch.column(PLATE) @ plate_field() == pytest.approx(exact, abs=1e-12)
    assert patch.column(PLATE) @ PLATE.field.rigid()["translation Z"] == pytest.approx(patch.measure, rel=1e-9)


def test_a_whole_element_has_the_textbook_loads():
    h = 0.2
    column = Patch(x=(ORIGIN + h, ORIGIN + 2 * h)).column(BEAM)
    assert column[2:6] == pytest.approx([h / 2, h**2 / 12, h / 2, -(h**2) / 12])
    assert np.abs(column).sum() == pytest.approx(h + h**2 / 6)


def test_patches_add_up():
    whole = Patch(x=(3.05, 3.95)).column(BEAM)
    parts = Patch(x=(3.05, 3.33)).column(BEAM) + Patch(x=(3.33, 3.95)).column(BEAM)
    assert parts == pytest.approx(whole, abs=1e-15)
    assert Patch(x=(3.05, 3.95), direction="-Z").column(BEAM) == pytest.approx(-whole)


@settings(max_examples=40)
@given(st.floats(0, 1))
def test_a_force_and_a_couple_do_the_work_of_the_field(x):
    u, at = beam_field(), ORIGIN + x
    assert Point(at=at).column(BEAM) @ u == pytest.approx(P(x), abs=1e-12)
    assert Point(at=at, direction="-Z").column(BEAM) @ u == pytest.approx(-P(x), abs=1e-12)
    assert Moment(at=at).column(BEAM) @ u == pytest.approx(-P.deriv()(x), abs=1e-11)


def test_a_couple_is_two_forces():
    """Right-handed about Y: force up at the smaller x, down at the larger x."""
    e = 1e-5
    pair = (Point(at=3.3 - e).column(BEAM) - Point(at=3.3 + e).column(BEAM)) / (2 * e)
    assert Moment(at=3.3).column(BEAM) == pytest.approx(pair, abs=1e-6)
    pair = (Point(at=(-0.5, 2.3 + e)).column(PLATE) - Point(at=(-0.5, 2.3 - e)).column(PLATE)) / (2 * e)
    assert Moment(at=(-0.5, 2.3), direction="RX").column(PLATE) == pytest.approx(pair, abs=1e-6)


def test_loads_and_sensors_are_reciprocal():
    from structures._system.sensors import Displacement

    for dof in ("3+Z", "3-Z"):
        assert np.array_equal(Point(dof).column(BEAM), Displacement(dof).row(BEAM))
    assert np.array_equal(Moment("3+RY").column(BEAM), Displacement("3+RY").row(BEAM))


def test_labels_units_and_measures():
    assert (Point("31Z+").label, Point("31+Z").unit, Point("31+Z").quantity, Point("31+Z").measure) == (
        "31+Z",
        "N",
        "force",
        None,
    )
    assert (Moment("3+RY").unit, Moment("3+RY").quantity) == ("N*m", "moment")
    line, pressure = Patch(x=(0.25, 0.75)), Patch(x=(0.0, 0.5), y=(0.25, 0.75), label="pad")
    assert (line.label, line.unit, line.quantity, line.measure) == ("x=0.25..0.75", "N/m", "line_load", 0.5)
    assert (pressure.label, pressure.unit, pressure.quantity, pressure.measure) == ("pad", "Pa", "pressure", 0.25)


# -- moving --------------------------------------------------------------------------------------------------------
def test_a_moving_force_is_a_point_force_at_each_sample():
    path = np.linspace(3.0, 4.0, 7)
    columns = MovingPoint(path, direction="-Z").columns(BEAM)
    assert columns.shape == (7, BEAM.n)
    for x, column in zip(path, columns, strict=True):
        assert np.array_equal(column, Point(at=x, direction="-Z").column(BEAM))
    places = np.column_stack([path - 4.0, path - 1.0])[:3]
    assert np.array_equal(MovingPoint(places).columns(PLATE)[1], Point(at=tuple(places[1])).column(PLATE))


def test_a_force_beside_the_structure():
    path = [2.0, 3.5, 4.5]
    with pytest.raises(InputError, match="3 <= x <= 4"):
        MovingPoint(path).columns(BEAM)
    columns = MovingPoint(path, outside="zero").columns(BEAM)
    assert not columns[[0, 2]].any()
    assert columns[1].any()
    with pytest.raises(InputError, match="columns"):
        MovingPoint(path).column(BEAM)


# -- supports ------------------------------------------------------------------------------------------------------
CANTILEVER = beams.cantilever(elements=10, **UNIT)
PINNED = beams.simply_supported(elements=10, **UNIT)
CLAMPED_PLATE = plates.plate(elements=(6, 6), edges="CCCC", **SQUARE)


@pytest.mark.parametrize(
    ("structure", "load"),
    [
        (CANTILEVER, Point("0+Z")),
        (CANTILEVER, Point("0-Z")),
        (CANTILEVER, Point(at=0.0)),
        (CANTILEVER, Moment("0+RY")),
        (PINNED, Point(at=1.0)),
        (CLAMPED_PLATE, Point(at=(0.0, 0.31))),
        (EVERY["chain fixed-free"](), Point("0+X")),
    ],
)
def test_E104_a_load_on_a_supported_dof_raises(structure, load):
    with pytest.raises(InputError, match=r"1 load acts on supported DOFs only.*reactions\(\)") as caught:
        load.column(structure)
    assert caught.value.code == "LID-E104"
    assert load.label in str(caught.value)


def test_E104_counts_all_candidates():
    with pytest.raises(InputError, match="2 loads act on supported") as caught:
        loads.matrix(CANTILEVER, [Point("0+Z"), Point("3+Z"), Moment("0+RY")])
    assert caught.value.code == "LID-E104"
    assert "3+Z" not in str(caught.value)


def test_E104_is_silent_beside_the_support():
    assert loads.matrix(PINNED, [Moment("0+RY"), Point("1+Z"), Patch(x=(0.0, 0.05))]).shape == (PINNED.n, 3)


@pytest.mark.parametrize(
    ("structure", "near", "far"),
    [
        (CANTILEVER, [Point("1+Z"), Point(at=0.05), Patch(x=(0.05, 0.5)), Moment("1+RY")],
         [Point("2+Z"), Point(at=0.15), Patch(x=(0.1, 0.3))]),
        (CLAMPED_PLATE, [Point((8, 3)), Point(at=(0.1, 0.5)), Patch(x=(0.1, 0.5), y=(0.4, 0.6))],
         [Point((16, 3)), Point(at=(0.25, 0.5)), Patch(x=(0.25, 0.75), y=(0.4, 0.6))]),
        (EVERY["user"]().with_supports("1+X"), [Point("2+X")], []),
        (EVERY["oscillator"](), [], [Point("1+X")]),
        (PINNED, [Patch(x=(0.5, 0.91)), Point("9+Z")], [Patch(x=(0.1, 0.9)), Point("8+Z")]),
        (BEAM, [], [Point("0+Z"), Point("1+Z")]),
    ],
)  # fmt: skip
def test_W105_loads_next_to_a_support(structure, near, far):
    for load in near:
        flag = near_support(structure, load)
        assert flag is not None
        assert flag.code == "LID-W105"
        assert flag.evidence.value == 1
        assert load.label in flag.message
        assert "1 of 1" in flag.message
    for load in far:
        assert near_support(structure, load) is None
    if near:
        assert near_support(structure, [*near, *far]).evidence.value == len(near)
    assert near_support(structure, far) is None


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (lambda: Point(), "one place"),
        (lambda: Point("1+RY"), "use loads.Moment"),
        (lambda: Moment("1+Z"), "use loads.Point"),
        (lambda: Point("1+XY"), "twist"),
        (lambda: Point(at=5.0).column(BEAM), "expected: 3 <= x <= 4"),
        (lambda: Patch(x=(0.5, 0.5)), "no span"),
        (lambda: Patch(x=(0.5, 0.2)), "no span"),
        (lambda: Patch(x=(0.0, np.nan)), "no span"),
        (lambda: Patch(x=(0.0, 1.0), y=(1.0, 0.0)), "Patch, y"),
        (lambda: Patch(x=(0.0, 1.0), direction="X"), "along Z"),
        (lambda: Patch(x=(3.5, 4.5)).column(BEAM), "outside"),
        (lambda: Patch(x=(3.5, 4.0), y=(0, 1)).column(BEAM), "line load"),
        (lambda: Patch(x=(-0.9, -0.5)).column(PLATE), "a plate takes a pressure"),
        (lambda: near_support(CLAMPED_PLATE, Patch(x=(0.1, 0.5))), "a plate takes a pressure"),
        (lambda: Patch(x=(0.0, 1.0)).column(EVERY["oscillator"]()), "lumped"),
        (lambda: Patch(x=(0.0, 1.0)).column(EVERY["user"]()), "no mesh"),
        (lambda: MovingPoint([]), "no path"),
        (lambda: MovingPoint(None), "no path"),
        (lambda: MovingPoint([0.0, np.nan]), "no path"),
        (lambda: MovingPoint([0.0], direction="X"), "along Z"),
        (lambda: MovingPoint([0.0], outside="skip"), "unknown setting"),
    ],
)
def test_bad_loads_raise(bad, words):
    with pytest.raises(InputError, match=words):
        bad()
