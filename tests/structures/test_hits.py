"""Hammer hits: every reason to reject triggered, and silent on clean and on measured hits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from structures import InputError, MeasuredModel
from structures._testing.impact import clipped, judge, last_bit, second_pulse, stretches
from tests.data import measured

from .impacts import DT, blow, hits, record, response

GOOD = hits(1)[0]


def model(*tables, **settings):
    return MeasuredModel.from_hits(tables, dt=DT, force=0, responses=[1], **settings)


def changed(column, samples, values):
    table = GOOD.copy()
    table[samples, column] = values
    return table


def half_sine(width, samples=2000, at=100):
    k = np.arange(samples) - at
    return np.where((k >= 0) & (k <= width), np.sin(np.pi * k / width), 0.0)


def quantised(x, bits=12):
    step = 2.0 ** (1 - bits) * np.abs(x).max()
    return np.round(x / step) * step


NOISE = np.random.default_rng(1).standard_normal(1024)
SECOND = record(blow() + blow(at=300, height=40.0), response())
BAD = {
    "double hit": SECOND,
    "double hit: a second pulse of 40% at sample 701": record(blow() + blow(at=700, height=40.0), response()),
    "double hit: a second pulse of 50% at sample 21": record(blow(at=400) + blow(height=50.0), response()),
    "clipped force: 3 consecutive": changed(0, [20, 21, 22], 80.0),
    "overload: channel 1 has 4 consecutive": changed(1, slice(24, 28), np.abs(GOOD[:, 1]).max() * 1.01),
    "overload: channel 1 has 5 consecutive": changed(1, slice(24, 29), -np.abs(GOOD[:, 1]).max() * 0.9),
    "no hit: peak": np.column_stack([NOISE, GOOD[:, 1]]),
    "no hit: the force is zero": changed(0, slice(None), 0.0),
    "NaN": changed(1, 500, np.nan),
    "NaN or inf": changed(0, 500, np.inf),
    "dead: channel 1 never moves": changed(1, slice(None), 0.3),
}


@pytest.mark.parametrize("reason", BAD)
def test_rejected_with_its_reason(reason):
    """The bad record is named, and the model is the one of the good record alone."""
    both = model(GOOD, BAD[reason])
    assert [h.used for h in both.hits] == [True, False]
    assert both.hits[1].reason.startswith(reason)
    assert both.hits[0].reason == ""
    assert np.isfinite(both.hits[1].peak)
    np.testing.assert_array_equal(both.H, model(GOOD).H)
    with pytest.raises(InputError, match="no usable hit.*hit 1: " + reason.split(":")[0]):
        model(BAD[reason])


def test_reject_false_keeps_what_can_be_kept():
    assert model(GOOD, SECOND, reject=False).hits[1].used
    for reason in ("NaN", "dead: channel 1 never moves", "no hit: the force is zero"):
        assert not model(GOOD, BAD[reason], reject=False).hits[1].used


def test_silent_on_measured_hits():
    for k in range(1, 6):
        _, force, acceleration = np.load(measured("hammer_five_hits", f"measurements_{k}.npy"))
        assert judge(force, acceleration[:, None], ["a"]) == ""
    with np.load(measured("hammer_two_hits", "lvm_two_hits.npz")) as file:
        for name in ("hit1", "hit2"):
            force, *responses = file[name].T
            assert judge(force, np.column_stack(responses), ["m_1", "m_2"]) == ""


@pytest.mark.parametrize("k", [1, 3])
def test_measured_hits_spoilt(k):
    """A measured hit, cut at three fifths of its peak, or hit again, is rejected."""
    _, force, a = np.load(measured("hammer_five_hits", f"measurements_{k}.npy"))
    cut = np.minimum(force, 0.6 * force.max())
    assert "clipped force" in judge(cut, a[:, None], ["a"])
    again = force + 0.3 * np.roll(force, 400)
    assert "double hit" in judge(again, a[:, None], ["a"])
    rail = np.clip(a, -0.4 * np.abs(a).max(), 0.4 * np.abs(a).max())
    assert "overload" in judge(force, rail[:, None], ["a"])


@given(st.floats(1e-12, 1e12), st.sampled_from([-1.0, 1.0]), st.sampled_from(["", *BAD]))
def test_units_and_sign_do_not_matter(scale, sign, reason):
    table = GOOD if not reason else BAD[reason]
    before, after = (
        (judge(t[:, 0], t[:, 1:], ["channel 1"]).split(":")[0] for t in (table, table * [sign * scale, sign / scale]))
        if np.all(np.isfinite(table)) and np.any(table[:, 0])
        else ("", "")
    )
    assert before == after


class TestFalseAlarms:
    """What looks like a fault and is none."""

    @pytest.mark.parametrize("width", [80, 300, 900])
    def test_crest_as_flat_as_the_last_bit(self, width):
        """A long pulse of a converter of 12 bits has equal samples at its crest."""
        force = quantised(half_sine(width))
        assert width < 100 or np.sum(force == force.max()) >= 3
        assert judge(force, GOOD[:1, 1:], ["a"]) == ""

    @pytest.mark.parametrize("share", [0.95, 0.8, 0.5])
    @pytest.mark.parametrize("width", [20, 300])
    def test_a_cut_crest_is_still_found(self, share, width):
        x = np.minimum(quantised(half_sine(width)), share)
        assert clipped(x, x.max()) >= 3

    def test_slow_response(self):
        t = np.arange(8000) / 25600
        slow = quantised(np.exp(-2 * t) * np.sin(2 * np.pi * 10 * t), 16)
        assert np.sum(slow == slow.max()) >= 3
        assert judge(blow(8000), slow[:, None], ["a"]) == ""

    def test_ringing_of_an_antialias_filter(self):
        k = np.arange(1024) - 100.3
        assert judge(np.sinc(k), GOOD[:, 1:], ["a"]) == ""

    def test_noise_of_the_force_is_no_second_pulse(self):
        """A peak of ten standard deviations: the noise itself reaches a fifth of it."""
        force = blow(height=10.0) + NOISE
        assert np.sum(force > 2.0) > 10
        assert judge(force, GOOD[:, 1:], ["a"]) == ""

    def test_rebound_within_the_pulse(self):
        force = blow(at=100) + blow(at=106, height=60.0)
        assert second_pulse(force, int(np.argmax(force))) is None


def test_stretches():
    assert stretches(np.array([0, 1, 1, 1, 0, 1], bool)).tolist() == [[1, 4], [5, 6]]
    assert stretches(np.ones(4, bool)).tolist() == [[0, 4]]
    assert len(stretches(np.zeros(4, bool))) == 0


@pytest.mark.parametrize("bits", [6, 12, 16])
@pytest.mark.parametrize("gain", [1.0, 3.7e-4])
def test_last_bit(bits, gain):
    x = gain * quantised(np.sin(np.linspace(0, 50, 4000)), bits)
    assert last_bit(x) == pytest.approx(gain * 2.0 ** (1 - bits), rel=1e-6)


# -- hits that contradict each other -----------------------------------------------------------------------------------
def scaled(table, *factors):
    return table * np.asarray(factors)


WRONG = {
    "the force is 1000 times (a factor of units)": (1000.0, 1.0, 1.0),
    "the force is 0.2248 times (a factor of units)": (0.22481, 1.0, 1.0),
    "the force has the wrong sign: it is minus": (-1.0, 1.0, 1.0),
    "channel 2 is 10 times (a factor of units)": (1.0, 1.0, 10.0),
    "the force is 1.7 times": (1.7, 1.0, 1.0),
}


@pytest.mark.parametrize("reason", WRONG)
@pytest.mark.parametrize("place", [0, 2])
def test_a_hit_of_another_unit_or_sign_is_left_out(reason, place):
    """By a third hit of the same structure, whichever of the three is wrong; the model is that of the other two."""
    tables = hits(3, sensors=2, noise=0.5)
    good = [t for i, t in enumerate(tables) if i != place]
    tables[place] = scaled(tables[place], *WRONG[reason])
    made = MeasuredModel.from_hits(tables, dt=DT, force=0, responses=[1, 2])
    assert [h.used for h in made.hits] == [i != place for i in range(3)]
    assert made.hits[place].reason == f"{reason} what the other hits say"
    alone = MeasuredModel.from_hits(good, dt=DT, force=0, responses=[1, 2])
    np.testing.assert_array_equal(made.H, alone.H)
    assert [f.code for f in made.flags] == ["LID-W223"]
    kept = MeasuredModel.from_hits(tables, dt=DT, force=0, responses=[1, 2], reject=False)
    assert all(h.used for h in kept.hits)
    assert "in the average" in kept.flags[0].message


def test_two_hits_that_contradict_each_other_are_refused():
    one, two = hits(2)
    with pytest.raises(InputError, match=r"LID-E223.*hit 1 is 1000 times .* that of hit 2"):
        model(one, scaled(two, 1000.0, 1.0))
    assert model(one, scaled(two, 1000.0, 1.0), reject=False).flags[0].code == "LID-W223"


@pytest.mark.parametrize("count", [2, 3, 5])
def test_hits_of_usual_scatter_contradict_nothing(count):
    """Gains that scatter by 10 %, louder hits that are softer by 10 %, a tenth of noise, offsets of each record."""
    rng = np.random.default_rng(count)
    for seed in range(20):
        tables = hits(count, sensors=2, noise=3.0, seed=seed)
        for i, t in enumerate(tables):
            t *= [rng.uniform(0.3, 3.0), *(1 + 0.1 * rng.standard_normal(2)) * (1 - 0.1 * i / count)]
            t[:, 1:] *= t[:, 0].max() / (100.0 + 20 * i)
            t[:, 1:] += rng.uniform(-5, 5, 2)
        made = MeasuredModel.from_hits(tables, dt=DT, force=0, responses=[1, 2])
        assert all(h.used for h in made.hits)
        assert not made.flags


def test_measured_hits_contradict_nothing():
    tables = [np.load(measured("hammer_five_hits", f"measurements_{k}.npy")).T[:, 1:] for k in range(1, 6)]
    made = MeasuredModel.from_hits(tables, dt=1 / 25600, force=0, responses=[1])
    assert "LID-W223" not in [f.code for f in made.flags]
