import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from structures import Dof
from structures._channels import TWIST, direction_code
from structures.errors import InputError

NAMES = {1: "X", 2: "Y", 3: "Z", 4: "RX", 5: "RY", 6: "RZ"}


@given(st.integers(0, 10**9), st.sampled_from(sorted(NAMES)), st.sampled_from("+-"))
def test_every_spelling_is_the_same_dof_and_prints_one_way(node, axis, sign):
    name, code = NAMES[axis], axis if sign == "+" else -axis
    want = Dof(node, code)
    spellings = [
        f"{node}{sign}{name}",
        f"{node}{name}{sign}",
        f"{node}:{sign}{name}",
        (node, code),
        (node, sign + name),
        want,
    ]
    assert {Dof.parse(s) for s in spellings} == {want}
    assert str(want) == f"{node}{sign}{name}"
    assert Dof.parse(str(want)) == want
    assert (want.node, want.axis, want.sign) == (node, axis, 1 if sign == "+" else -1)


def test_scalar_and_twist_are_representable():
    assert str(Dof(4, 0)) == "4+S"
    assert Dof.parse("4+S") == Dof(4, 0)
    assert str(Dof(4, TWIST)) == "4+XY"
    assert Dof.parse("4+XY").unit == "1/m"
    assert [Dof(0, k).unit for k in (0, 3, -5)] == ["arbitrary", "m", "rad"]


@pytest.mark.parametrize(
    "bad",
    ["12", "12Z", "Z12", "12+z", " 12+Z", "12+Z ", "12+W", "+12+Z", "-1+Z", "12.0+Z", "12+-Z", "12+Z+", "12-S", "١+Z",
     "", None, 12, 3.5, (12, 8), (12, "Q"), (12,), (-1, 3), (True, 3),
     (12, True), (1.0, 3), (12, 3.0), [12, 3], b"12+Z"],
)  # fmt: skip
def test_anything_else_raises(bad):
    with pytest.raises(InputError, match="found"):
        Dof.parse(bad)


def test_numpy_integers_become_integers():
    dof = Dof(np.int64(3), np.int32(-3))
    assert type(dof.node) is int
    assert type(dof.direction) is int
    assert dof == Dof(3, "-Z")


def test_polarity_is_another_dof_with_the_same_key():
    assert Dof(3, 3) != Dof(3, -3)
    assert Dof(3, 3).key == Dof(3, -3).key
    assert direction_code("-RY") == -5
