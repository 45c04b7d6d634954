"""Numbers of a load add up over pieces, and its cycles are those of the standard."""

from __future__ import annotations

import json
from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from loadid._batch.loads import WIDTH, Cycles, Kept, cycles_of, equivalent, joined, kept, turning_points

RNG = np.random.default_rng(4)


def pieces(x: np.ndarray, std: np.ndarray, cuts: list[int], exponents: tuple[float, ...] | None) -> list[Kept]:
    ends = pairwise([0, *cuts, len(x)])
    return [kept(x[a:b], std[a:b], 0.1, a, exponents) for a, b in ends]


@pytest.mark.parametrize(
    ("x", "turns"),
    [([0, 1, 2, 1], [0, 2, 1]), ([1, 1, 1], [1]), ([0, 1, 1, 0, 0, -1, 3], [0, 1, -1, 3]), ([2], [2]), ([1, 2], [1, 2]),
     ([3, 2, 2, 1, 1], [3, 1])],
)  # fmt: skip
def test_turning_points(x: list[float], turns: list[float]) -> None:
    assert turning_points(np.array(x, float)).tolist() == turns


def test_numbers_of_a_history() -> None:
    x, std = np.array([1.0, -4.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.3, 0.4])
    numbers = kept(x, std, 0.5, 10).numbers
    assert numbers["mean"] == pytest.approx(0.5)
    assert numbers["rms"] == pytest.approx(np.sqrt(7.5))
    assert numbers["std"] == pytest.approx(np.sqrt(0.3 / 4))
    assert (numbers["peak"], numbers["peak_std"], numbers["peak_at"]) == (-4.0, 0.2, 5.5)
    assert numbers["peak_low"] == pytest.approx(-4 - WIDTH * 0.2)
    own = kept(x, std, 0.5)
    assert own.sure == pytest.approx(((x + WIDTH * std).min(), (x - WIDTH * std).max()))
    assert own.perhaps == pytest.approx(((x - WIDTH * std).min(), (x + WIDTH * std).max()))


def test_pieces_add_up_without_cycles() -> None:
    x, std = RNG.standard_normal(999), RNG.random(999)
    one, many = kept(x, std, 0.1), joined(pieces(x, std, [1, 2, 400, 998], None))
    assert many.numbers == pytest.approx(one.numbers, rel=1e-13, abs=1e-13)
    assert (many.sure, many.perhaps, many.peak.at) == (one.sure, one.perhaps, one.peak.at)


def test_cycles_are_counted_by_a_package_that_may_be_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    from structures.errors import InputError

    monkeypatch.setitem(__import__("sys").modules, "fatpack", None)
    with pytest.raises(InputError, match=r"no fatpack.*loadid\[cluster\]"):
        cycles_of(np.array([0.0, 1.0, 0.0]), (3.0,))


class TestCycles:
    @pytest.fixture(autouse=True)
    def _there(self) -> None:
        pytest.importorskip("fatpack")

    def test_the_example_of_the_standard(self) -> None:
        """ASTM E1049-85, figure 6: ranges 3, 4, 6, 8, 9 with .5, 1.5, .5, 1, .5 cycles."""
        x = np.array([-2, 1, -3, 5, -1, 3, -4, 4, -2], float)
        found = cycles_of(x, (1.0,)).whole
        expected = {3: 0.5, 4: 1.5, 6: 0.5, 8: 1.0, 9: 0.5}
        assert found.power[1.0] == pytest.approx(sum(r * n for r, n in expected.items()))
        classes = Counter({int(np.floor(20 * np.log10(r))): n for r, n in expected.items()})
        assert found.classes == pytest.approx(dict(sorted(classes.items())))

    def test_a_sine_is_its_own_equivalent(self) -> None:
        x = np.sin(2 * np.pi * (np.arange(20_000) + 0.5) / 200)  # 100 cycles of range 2
        found = cycles_of(x, (3.0, 10.0))
        for m in (3.0, 10.0):
            assert equivalent(found, m, 100) == pytest.approx(2.0, rel=2e-3)
        assert equivalent(found, 3.0, 800) == pytest.approx(1.0, rel=2e-3)

    @pytest.mark.parametrize("cuts", [[500], [1, 2, 3, 700], list(range(10, 1000, 10))])
    def test_seams_make_no_cycles(self, cuts: list[int]) -> None:
        x = np.cumsum(RNG.standard_normal(1000)).round(1)  # level stretches too
        std = np.ones(1000)
        one, many = kept(x, std, 0.1, 0, (3.0,)).cycles, joined(pieces(x, std, cuts, (3.0,))).cycles
        assert one is not None
        assert many is not None
        assert many.classes == one.classes
        assert (many.closed, many.residue) == (one.closed, one.residue)
        assert many.power[3.0] == pytest.approx(one.power[3.0], rel=1e-12)

    def test_an_independent_count(self) -> None:
        rainflow = pytest.importorskip("rainflow")
        x = np.cumsum(RNG.standard_normal(5000))
        own = cycles_of(x, (4.0,)).whole
        other = rainflow.count_cycles(x.tolist())
        assert own.power[4.0] == pytest.approx(sum(n * r**4 for r, n in other), rel=1e-9)
        assert sum(own.classes.values()) == pytest.approx(sum(n for r, n in other if r > 0))

    def test_through_json(self) -> None:
        one = kept(RNG.standard_normal(300), np.ones(300), 0.1, 7, (3.0, 4.5))
        assert Kept.of(json.loads(json.dumps(one.to_dict()))) == one
        assert isinstance(one.cycles, Cycles)
