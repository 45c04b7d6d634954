import json

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from loadid import Record, datasets, read
from loadid._quality import describe, health, noise_std, quiet_segment, require_finite
from loadid._tone import tone
from structures import Channel
from structures.errors import InputError
from tests.data import measured

DT = 1e-3


def kinds(values):
    return {f.evidence.name for f in Record(values, DT).health()}


def clean(rng, samples=2000):
    """A record that nothing is wrong with: one of many kinds, quantised or not."""
    t = np.arange(samples) * DT
    kind = rng.integers(9)
    if kind == 0:
        x = rng.normal(size=samples)
    elif kind == 1:
        x = lfilter(*butter(2, rng.uniform(0.005, 0.5)), rng.normal(size=samples))
    elif kind == 2:
        x = sum(rng.normal() * np.sin(2 * np.pi * rng.uniform(0.2, 400) * t + rng.uniform(0, 7)) for _ in range(3))
    elif kind == 3:  # free decay after a rest
        s = np.clip(t - rng.uniform(0.1, 0.5), 0, None)
        x = np.exp(-rng.uniform(2, 40) * s) * np.sin(2 * np.pi * rng.uniform(5, 200) * s)
    elif kind == 4:  # half sine
        s = (t - 0.3) / rng.uniform(0.004, 0.5)
        x = np.where((s > 0) & (s < 1), np.sin(np.pi * np.clip(s, 0, 1)), 0.0)
    elif kind == 5:  # boxcar or staircase
        x = np.floor(t * rng.uniform(1, 5)) % rng.integers(2, 6)
    elif kind == 6:  # triangle
        x = np.abs((t * rng.uniform(0.5, 20)) % 1 - 0.5)
    elif kind == 7:  # free decay from the first sample
        x = np.exp(-rng.uniform(2, 40) * t) * np.cos(2 * np.pi * rng.uniform(5, 200) * t)
    else:  # ramp and hold
        x = np.clip(t / rng.uniform(0.05, 0.5), 0, 1)
    x = x / np.abs(x).max()
    if rng.random() < 0.6:
        x = x + rng.choice([1e-4, 1e-3, 1e-2]) * rng.normal(size=samples)
    if rng.random() < 0.6:
        bits = rng.integers(7, 23)
        x = np.round(x * 2.0**bits) / 2.0**bits
    return x * 10.0 ** rng.uniform(-6, 6)


def test_clean_windows_raise_nothing():
    false = []
    for seed in range(1500):
        flags = Record(clean(np.random.default_rng(seed)), DT).health()
        false += [(seed, str(f)) for f in flags]
    assert not false, false


def test_clipping_of_three_samples_and_more_is_found():
    missed = tried = 0
    for seed in range(600):
        rng = np.random.default_rng(seed)
        t = np.arange(2000) * DT
        x = sum(rng.normal() * np.sin(2 * np.pi * rng.uniform(1, 120) * t + rng.uniform(0, 7)) for _ in range(3))
        x += 1e-3 * rng.normal(size=len(t))
        rail = np.quantile(np.abs(x), 1 - rng.choice([0.005, 0.01, 0.05, 0.2]))
        y = np.clip(x, -rail, rail)
        if rng.random() < 0.5:
            y = np.round(y / rail * 2**15) / 2**15 * rail
        over = np.abs(x) > rail
        runs = np.diff(np.flatnonzero(np.diff(np.r_[0, over & (x > 0), 0])))[::2]
        if not runs.size or runs.max() < 3:
            continue
        tried += 1
        missed += not {"clipped", "overload"} & kinds(y)
    assert tried > 200
    assert missed <= 0.01 * tried


def test_clipped_names_channel_samples_and_certainty():
    x = np.sin(2 * np.pi * 11 * np.arange(500) * DT) + 1e-3 * np.random.default_rng(0).normal(size=500)
    (flag,) = health(Record(np.column_stack([x, np.minimum(x, 0.99)]), DT, ["good", "cut"]))
    assert flag.code == "LID-W206"
    assert "channel cut" in flag.message
    assert "certain" in flag.message
    first = int(np.flatnonzero(x > 0.99)[0])
    assert f"samples {first}-" in flag.message
    assert flag.evidence.threshold == 3


def test_two_equal_samples_at_the_top_are_no_clip():
    x = np.random.default_rng(0).normal(size=500)
    i = int(np.argmax(x))
    x[i + 1] = x[i]
    assert kinds(x) == set()
    x[i + 2] = x[i]
    assert kinds(x) == {"clipped"}


def test_overload_and_saturation():
    t = np.arange(4000) * DT
    noise = np.random.default_rng(0).normal(size=len(t))
    assert kinds(np.clip(2 * np.sin(40 * t) + 0.01 * noise, -1, 1)) == {"overload"}
    pulse = np.zeros(4000)
    pulse[1000:1008] = 10 * np.hanning(10)[1:-1]
    assert kinds(pulse + 1e-3 * noise) == set()
    assert kinds(np.minimum(pulse, 6) + 1e-3 * noise) == {"saturated"}


def test_the_crest_of_a_response_is_not_saturated(tmp_path):
    """Hits on a beam as they are written for examples: three samples of one crest lie within 0.3 % of each other."""
    datasets.hammer_test(tmp_path)
    for path in tmp_path.glob("*.csv"):
        assert "saturated" not in {f.evidence.name for f in read(path).health()}


def test_flat_dead_held_missing():
    rng = np.random.default_rng(3)
    x = rng.normal(size=1000)
    assert kinds(np.full(1000, 2.5)) == {"flat"}
    assert kinds(np.zeros(1000)) == {"flat"}
    held, dead, gap, few = x.copy(), x.copy(), x.copy(), x.copy()
    held[300:312] = held[300]
    dead[700:] = 0.0
    gap[10:20] = np.nan
    few[50:54] = few[50]
    assert kinds(held) == {"held"}
    assert kinds(dead) == {"dead"}
    assert kinds(gap) == {"missing"}
    assert kinds(np.full(1000, np.nan)) == {"missing"}
    assert kinds(few) == set()
    flag = Record(held, DT, "F").health()[0]
    assert "channel F" in flag.message
    assert "300-311" in flag.message
    assert flag.evidence.value == 12


def test_samples_keep_their_number_behind_a_gap():
    x = np.random.default_rng(3).normal(size=1000)
    x[10:20] = np.nan
    x[300:312] = x[300]
    assert any("300-311" in f.message for f in Record(x, DT).health())


@pytest.mark.parametrize("samples", [1, 2, 3, 7, 8, 63, 72, 73])
def test_short_records_do_no_harm(samples):
    for seed in range(5):
        assert not kinds(np.random.default_rng(seed).normal(size=(samples, 2)) if samples > 1 else np.ones((1, 2)))


def blow(rest, *, offset=0.0, noise=0.01, seed=0, samples=1500):
    rng = np.random.default_rng(seed)
    s = np.clip(np.arange(samples) - rest, 0, None) * DT
    return offset + np.exp(-8 * s) * np.sin(2 * np.pi * 30 * s) + noise * rng.normal(size=samples)


def test_quiet_segment_ends_before_the_onset():
    for seed in range(50):
        rest = int(np.random.default_rng(seed).integers(120, 900))
        quiet = quiet_segment(blow(rest, seed=seed), DT)
        assert quiet is not None
        assert 0.75 * rest < quiet.stop <= rest
        std, source = noise_std(Record(blow(rest, seed=seed), DT))
        assert std[0] == pytest.approx(0.01, rel=0.3)
        assert source.kind == "pre_trigger"


def test_quiet_segment_is_common_to_all_channels():
    both = np.column_stack([blow(800), blow(300, seed=1)])
    assert quiet_segment(both, DT).stop <= 300


def test_no_quiet_segment_where_there_is_none():
    rng = np.random.default_rng(0)
    t = np.arange(3000) * DT
    assert quiet_segment(rng.normal(size=3000), DT) is None  # nothing starts
    assert quiet_segment(np.sin(70 * t) + 0.01 * rng.normal(size=3000), DT) is None  # never at rest
    assert quiet_segment(blow(40), DT) is None  # too short a rest
    assert quiet_segment(blow(0), DT) is None  # began in the response
    assert quiet_segment(np.zeros(3000), DT) is None
    assert quiet_segment(np.full(3000, np.nan), DT) is None
    assert noise_std(Record(blow(0), DT)) is None
    assert noise_std(Record(blow(500, noise=0.0), DT)) is None  # free of noise: no level
    with pytest.raises(InputError):
        quiet_segment(blow(500), 0.0)


def test_stated_noise_comes_first():
    std, source = noise_std(Record(blow(500), DT, Channel(label="a", noise=0.5)))
    assert (std.tolist(), source.kind) == ([0.5], "datasheet")


def test_offset_is_a_note():
    (flag,) = Record(blow(500, offset=0.2), DT, Channel(label="a", quantity="acceleration", unit="m/s^2")).health()
    assert flag.evidence.name == "offset"
    assert flag.message.startswith("channel a: note: offset 0.")
    assert "m/s^2" in flag.message
    assert kinds(blow(500, offset=0.0)) == set()


def test_hum_before_the_response_is_named():
    t = DT * np.arange(len(blow(500)))
    hum = 0.02 * np.sin(2 * np.pi * 50.3 * t + 1.0)
    (flag,) = Record(blow(500, offset=0.0) + hum, DT, ["a"]).health()
    assert flag.evidence.name == "tone"
    assert "a tone of 50." in flag.message
    assert "amplitude 0.02" in flag.message


def test_correlated_noise_is_no_hum():
    from scipy.signal import lfilter

    rng, false = np.random.default_rng(5), 0
    for phi in (0.0, 0.5, 0.9, 0.99):
        noise = lfilter([1.0], [1.0, -phi], rng.standard_normal((300, 300)), axis=1)
        false += sum(tone(one, DT) is not None for one in noise)
    assert false == 0


def test_findings_do_not_depend_on_the_unit():
    for factor in (1e-9, 1.0, 1e9):
        x = blow(500, offset=0.2)
        x[900:920] = x[900]
        assert kinds(x * factor) == {"offset", "held"}


def test_require_finite():
    require_finite(Record(blow(500), DT))
    x = np.zeros((20, 2))
    x[3:5, 0] = x[9, 1] = np.nan
    with pytest.raises(InputError, match=r"a: samples 3-4; b: samples 9"):
        require_finite(Record(x, DT, ["a", "b"]))


def test_describe_is_plain():
    r = Record(np.column_stack([blow(500, offset=0.2), np.full(1500, np.nan)]), DT, ["a", "b"])
    told = json.loads(json.dumps(describe(r), allow_nan=False))
    a, b = told["channels"]
    assert a["offset"] == pytest.approx(0.2, abs=0.01)
    assert a["noise"] == pytest.approx(0.01, rel=0.2)
    assert a["quiet"][0] == 0
    assert a["findings"][0]["code"] == "LID-W206"
    assert a["rms"] == pytest.approx(np.sqrt(np.mean(r["a"] ** 2)))
    assert (b["min"], b["missing"]) == (None, 1500)
    assert told["fs"] == 1000


@pytest.mark.parametrize("number", range(1, 6))
def test_measured_five_hits_are_healthy(number):
    x = np.load(measured("hammer_five_hits", f"measurements_{number}.npy"))
    assert kinds(x[1:].T) == set()


def test_measured_two_hits_have_an_offset_and_nothing_else():
    with np.load(measured("hammer_two_hits", "lvm_two_hits.npz")) as z:
        for name in ("hit1", "hit2"):
            assert kinds(z[name]) == {"offset"}


def test_measured_shaker_records_are_healthy():
    with np.load(measured("cantilever_shaker", "cantilever_shaker.npz")) as z:
        for name in ("test1", "test2", "test3"):
            assert kinds(z[name][:, 1:]) == set()
