"""What stands in a gap until a load is known."""

import numpy as np

from loadid._families.gaps import bridged, near_gaps
from tests.campaigns import hammer

T = np.arange(900)


def ringing() -> np.ndarray:
    """Two channels of three modes each that were struck at sample 200."""
    t = np.maximum(T - 200, 0)
    modes = [np.exp(-d * t) * np.sin(w * t) for w, d in ((0.2, 0.004), (0.71, 0.006), (1.9, 0.01))]
    return np.column_stack([modes[0] + modes[1], modes[1] - 0.4 * modes[2]])


def test_what_rings_goes_on() -> None:
    y, missing = ringing(), np.zeros((900, 2), bool)
    missing[300:340, 0], missing[500:503], missing[880:, 1] = True, True, True
    found = bridged(np.where(missing, 0.0, y), missing)
    assert np.array_equal(found[~missing], y[~missing])
    np.testing.assert_allclose(found, y, atol=1e-5)


def test_the_same_in_any_unit_and_in_noise() -> None:
    rng = np.random.default_rng(0)
    y, missing = ringing() + 1e-3 * rng.standard_normal((900, 2)), np.zeros((900, 2), bool)
    missing[260:290] = True
    found = bridged(np.where(missing, 0.0, y), missing)
    assert np.sqrt(np.mean((found - y)[missing] ** 2)) < 0.02  # of an amplitude of .7
    np.testing.assert_allclose(bridged(1e9 * np.where(missing, 0.0, y), missing), 1e9 * found, rtol=1e-6, atol=1e3)


def test_what_is_too_short_is_a_straight_line() -> None:
    y, missing = np.arange(12.0)[:, None] ** 2, np.zeros((12, 1), bool)
    missing[4:6] = True
    found = bridged(np.where(missing, 0.0, y), missing)
    np.testing.assert_allclose(found[4:6, 0], [18, 27])
    missing[:] = False
    assert np.array_equal(bridged(y, missing), y)


def test_energy_beside_a_gap() -> None:
    load, missing = np.zeros((100, 2)), np.zeros((100, 1), bool)
    missing[50:56], load[43, 0], load[20, 0], load[20, 1] = True, 1.0, 3.0, 1.0
    assert near_gaps(load, missing) == 0.1
    assert near_gaps(0 * load, missing) == 0
    missing[52] = False  # two short ones
    assert near_gaps(load, missing) == 0


def test_a_load_that_goes_on_is_open_in_a_gap_and_as_before_elsewhere() -> None:
    for seed, kind in ((5015, "random"), (5028, "harmonic")):
        one = hammer.problem(seed, kind)
        record = one.record.copy()
        record[500:512] = np.nan
        whole, found = (one.inversion().estimate(y, one.dt) for y in (one.record, record))
        gap, far = slice(500, 512), np.abs(np.arange(len(record)) - 506) > 60
        assert found.facts["variance"] == whole.facts["variance"] == "constant"
        np.testing.assert_allclose(found.load[far], whole.load[far], atol=0.1 * np.abs(whole.load).max())
        np.testing.assert_allclose(found.std[far], whole.std[far], rtol=0.3)
        assert np.mean(np.abs(found.load - one.truth)[gap] < 1.96 * found.std[gap]) > 0.9
        assert found.std[gap].mean() > 1.2 * whole.std[gap].mean()
