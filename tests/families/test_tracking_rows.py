"""What a tracker tells of each sample beside the load: NIS, the settled gain, channels that were not used."""

from __future__ import annotations

import numpy as np

from loadid import LoadTracker
from loadid.priors import Matern32
from tests.tracked import bm2, reference


def test_nis_of_each_sample_is_that_of_a_filter_with_dense_covariances() -> None:
    case = bm2("matern", 3, samples=1200)
    tracker = LoadTracker(case.setup.space("zoh"), prior=Matern32(100.0, 0.1), noise=case.noise, gate=None)
    track = tracker.fit(case.y, case.dt)
    dense = reference(track.fitted.model, case.y)
    rows = track.rows(case.y)
    nis = track.nis(rows.e)
    assert not rows.settled[:5].any()
    assert rows.settled[300:].all()
    np.testing.assert_allclose(nis[300:], dense.nis[300:] / 4, rtol=2e-3)
    track.reset()
    gappy = case.y.copy()
    gappy[600, 1], gappy[700:702] = np.nan, np.nan
    rows, dense = track.rows(gappy), reference(track.fitted.model, gappy)
    nis = track.nis(rows.e)
    assert np.isnan(nis[700:702]).all()
    assert not rows.settled[700:703].any()
    np.testing.assert_allclose(nis[600], dense.nis[600] / 3, rtol=2e-3)  # the first after the settled gain


def test_rows_of_any_blocks_are_the_same() -> None:
    case = bm2("matern", 4, samples=800)
    track = LoadTracker(case.setup.space("zoh"), prior=Matern32(100.0, 0.1), noise=case.noise).fit(case.y, case.dt)
    case.y[500:510, 0] = np.nan
    case.y[600, 0] += 1e3
    whole = track.rows(case.y)
    track.reset()
    parts = [track.rows(part) for part in np.split(case.y, [1, 7, 300, 505, 601, 700])]
    for name in ("load", "std", "e", "settled"):
        np.testing.assert_array_equal(np.concatenate([getattr(part, name) for part in parts]), getattr(whole, name))
    assert np.isnan(whole.e[600, 0])  # kept out by the gate
