"""Images that slipped, on a gel of other finite elements: a slice of `tests.benchmarks.slips`."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tactile import Markers, MultilayerPad, Pad
from tests.benchmarks.slips import LEFT, said, slips
from tests.campaigns.gels import GELS, Case, E, cases, markers
from tests.campaigns.tactile import User, pad_of


@cache
def press() -> Case:
    """A flat punch on a small gel."""
    (case,) = cases(1, 55, gel=(14e-3, 12e-3, 3e-3), nu=0.45, noise=2e-6, shape="flat", depth=False)
    return case


def user(kind: str) -> User:
    return User(kind, pad_of(press(), "none"), press(), {})


@pytest.mark.parametrize("kind", ["in the plane", "all axes"])
def test_a_slip_of_a_quarter_pixel_is_found_and_leaves_nothing_in_the_force(kind: str) -> None:
    found = list(slips(user(kind), [press()], 8, 2))
    full = abs(press().force[2])
    single, without = ([v for s in found if (v := getattr(s, a)) is not None] for a in ("single", "without"))
    assert len(found) == 16  # a press and a gel at rest
    assert all(s.found for s in found)
    assert not any(s.false for s in found)
    assert len(single) == 4
    assert max(single) <= LEFT * full
    assert np.median(without) > full  # which is what it is worth


def test_a_turned_and_stretched_image_is_no_load() -> None:
    """Medians of the readings show neither, and loads all over the surface would explain both."""
    places = markers(GELS[0][:2])
    s = MultilayerPad(Pad(size=GELS[0][:2], thickness=GELS[0][2], E=E, nu=0.45), Markers(places, 2e-6), choice=0.05)
    rng, (x, y) = np.random.default_rng(4), places.T
    for turn, stretch in ((3e-3, -1e-3), (-4e-3, 4e-3), (1e-3, 4e-3), (5e-3, 2e-3)):
        moved = np.column_stack([30e-6 + stretch * x - turn * y, 4e-6 + stretch * y + turn * x])
        found = s.follow(moved + 2e-6 * rng.standard_normal(moved.shape))
        assert said(found)
        assert found.facts.image is not None
        assert np.allclose(found.facts.image[:2], (30e-6, 4e-6), atol=1e-6)
        assert np.allclose(found.facts.image[2:4], (turn, stretch), atol=1e-4)
        assert np.all(np.abs(found.resultant().value) < 3 * found.resultant().std + 1e-3)
