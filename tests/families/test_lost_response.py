"""Samples that are missing where a load acts: what its response would have told, and the grade without it."""

import numpy as np
import pytest

from loadid import Deconvolution
from loadid._families.histories import lost_response
from structures import MeasuredModel

from ..structures.impacts import DT, hits, record, response


def test_share_of_a_response_by_a_loop():
    rng = np.random.default_rng(0)
    h, std = rng.standard_normal((12, 2, 3)), np.array([0.5, 2.0])
    load, missing = rng.standard_normal((20, 3)), rng.random((20, 2)) < 0.3
    lost = whole = 0.0
    for k in range(20):
        for i in range(min(12, 20 - k)):
            power = np.sum((load[k] * h[i]) ** 2 / std[:, None] ** 2, axis=1)
            whole += power.sum()
            lost += power @ missing[k + i]
    assert lost_response(h, missing, std, load) == pytest.approx(lost / whole, rel=1e-10)
    assert lost_response(h, np.zeros((20, 2), bool), std, load) == 0
    assert lost_response(h, np.ones((20, 2), bool), std, load) == pytest.approx(1)
    assert lost_response(h, missing, std, 0 * load) == 0


@pytest.fixture(scope="module")
def struck():
    """A measured model, and the record of a hit of eight samples at sample 60."""
    model = MeasuredModel.from_hits(hits(4, noise=1.0, samples=256), dt=DT, force=0, responses=[1])
    t = np.arange(256)
    force = np.where((t >= 60) & (t < 68), 100 * np.sin(np.pi * (t - 59.5) / 8), 0.0)
    return model, record(force, response(), 1.0, np.random.default_rng(5))[:, 1:], force


@pytest.mark.parametrize("gap", [(60, 68), (57, 73), (50, 90)])
def test_a_gap_over_a_hit_is_no_fair_answer(struck, gap):
    model, y, force = struck
    y = y.copy()
    y[slice(*gap)] = np.nan
    e = Deconvolution(model).estimate(y, DT)
    off = np.linalg.norm(e.load[:, 0] - force) / np.linalg.norm(force)
    assert off > 0.4  # half the hit is gone
    assert "LID-W224" in [f.code for f in e.flags]
    assert e.grade.letter in "CD"
    assert e.grade.expected > 0.4


def test_a_gap_elsewhere_says_nothing_of_the_hit(struck):
    model, y, _ = struck
    y = y.copy()
    y[150:180] = np.nan
    e = Deconvolution(model).estimate(y, DT)
    assert "LID-W224" not in [f.code for f in e.flags]
    assert e.facts.expected_error is None or e.facts.expected_error < 0.3
