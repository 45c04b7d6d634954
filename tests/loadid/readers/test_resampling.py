"""Uneven stamps and several clocks on one even grid: held against closed forms, between and at the samples."""

import json
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import loadid
from loadid import cli
from loadid._readers.resampling import resampled
from structures._flags import codes
from structures.errors import InputError
from tests.guards.test_not_told import DT, beam

from .exports import BEGIN


def tones(seed, band, lines=30):
    """A function of time (s) with random lines up to a frequency (Hz)."""
    rng = np.random.default_rng(seed)
    f, a, p = rng.uniform(0, band, lines), rng.normal(size=lines), rng.uniform(0, 2 * np.pi, lines)
    return lambda t: (a * np.cos(2 * np.pi * np.multiply.outer(t, f) + p)).sum(-1)


def jittered(seed, samples, rate=100.0, jitter=0.3):
    """Times whose intervals vary about 1 / rate."""
    rng = np.random.default_rng(seed)
    return np.cumsum((1 + jitter * rng.uniform(-1, 1, samples)) / rate)


def table(path, t, *columns, names=("time [s]", "F [N]", "a [m/s^2]")):
    rows = [",".join(names[: len(columns) + 1])]
    rows += [",".join(f"{x:.12g}" for x in row) for row in zip(t, *columns, strict=True)]
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("band", [3.0, 8.0, 15.0, 25.0, 35.0, 45.0])  # of a Nyquist frequency of 50 Hz
def test_the_error_is_that_of_the_closed_form_within_its_estimate(band):
    for seed in range(12):
        jitter = (0.03, 0.15, 0.4)[seed % 3]
        truth, t = tones(seed, band), jittered(seed, 600, jitter=jitter)
        grid = np.arange(t[0], t[-1], 0.01)
        found = resampled(t, truth(t)[:, None], grid)
        error = np.sqrt(np.mean((found.values[:, 0] - truth(grid)) ** 2))
        assert error < 1.3 * found.error[0] < 60 * error
        assert found.gaps == 0


def test_the_error_of_the_interpolation_is_noise_of_the_channel(tmp_path):
    """Short hits on a beam of a finer mesh, sampled at uneven times: errors and bands with it and without it."""
    model, finer = beam("acc"), beam("acc", 80, 14)
    fine, samples, found = 8, 400, []
    t = np.arange(samples * fine) * DT / fine
    for seed in range(3):
        rng = np.random.default_rng(seed)
        force = np.zeros_like(t)
        for start in rng.uniform(0.1, 0.85, 3) * samples * DT:
            force += rng.uniform(50, 200) * np.sin(np.pi * np.clip((t - start) / 1e-3, 0, 1))
        clean = finer.predict(force[:, None], DT / fine)
        noise = 0.001 * clean.std(axis=0)
        times = jittered(seed, samples, 1 / DT, 0.6)
        times = times[times < t[-1]]
        seen = CubicSpline(t, clean)(times) + noise * rng.standard_normal((len(times), 2))
        names = ("time [s]", *(f"{c.label} [{c.unit}]" for c in model.sensors))
        record = loadid.read(table(tmp_path / "log.csv", times, *seen.T, names=names), fs=1 / DT)
        error = [c.interpolation for c in record.channels]
        assert all(e > 10 * s for e, s in zip(error, noise, strict=True))
        assert error == [c.interpolation for c in record.select([c.label for c in model.sensors]).channels]
        truth = np.interp(times[0] + record.time, t, force)
        bare = loadid.Record(record.values, DT, [replace(c, interpolation=None) for c in record.channels])
        for one in (record, bare):
            answer = loadid.Deconvolution(model, noise=noise).estimate(one)
            miss = np.abs(answer.load[:, 0] - truth)
            found.append([np.linalg.norm(miss), np.mean(miss < 1.96 * answer.std[:, 0]), answer.grade.letter == "D"])
            told = "interpolation" in answer.facts.noise_source
            assert told == (one is record)
    with_it, without = np.array(found[::2], float).mean(axis=0), np.array(found[1::2], float).mean(axis=0)
    assert with_it[0] < 0.9 * without[0]
    assert with_it[1] > 0.95
    assert (with_it[2], without[2]) == (0, 1)  # what is stated as noise alone contradicts the answer
    steady = loadid.Record(record.values, DT, [replace(c, interpolation=1e-9) for c in record.channels])
    quiet = loadid.Deconvolution(model, noise=noise).estimate(steady)  # far below the noise: not spoken of
    assert "interpolation" not in quiet.facts.noise_source


def test_a_log_of_uneven_stamps_is_resampled_by_name(tmp_path, capsys):
    t = jittered(0, 800)
    force, acc = tones(1, 4.0), tones(2, 30.0)
    path = table(tmp_path / "log.csv", t, force(t), acc(t))
    with pytest.raises(InputError, match=r"time is not uniform.* rate of (99|1[01]\d) Hz or more.*leave the time"):
        loadid.read(path)
    record = loadid.read(path, fs=200.0)
    at = t[0] + record.time
    assert (record.dt, record.file_dt) == (1 / 200, 1 / 200)
    assert abs(at[-1] - t[-1]) < 1 / 200
    np.testing.assert_allclose(record["F"], force(at), atol=2e-3 * np.std(force(t)))
    np.testing.assert_allclose(record["a"], acc(at), atol=0.3 * np.std(acc(t)))
    said = " | ".join(record.notes)
    assert "resampled to 200 Hz by cubic splines from time, whose steps are 0.007" in said
    assert "by leaving out every second sample: a 0." in said  # the worse one first
    assert codes(record.flags) == {"W220"}
    assert loadid.read(path, fs=200.0, columns=["F"]).labels == ("F",)
    assert cli.main(["info", str(path), "--fs", "200"]) == 0
    assert "resampled to 200 Hz by cubic splines" in capsys.readouterr().out
    assert cli.main(["check", str(path), "--fs", "200", "--json"]) in (0, 1)
    out = json.loads(capsys.readouterr().out)
    assert "resampled to 200 Hz" in str(out["notes"])
    assert "W220" in str(out)


def test_a_rate_below_that_of_the_samples_is_refused(tmp_path):
    t = jittered(3, 300)
    path = table(tmp_path / "log.csv", t, tones(1, 4.0)(t))
    with pytest.raises(InputError, match=r"lower rate.*fold.*found: 60 Hz, time at (9[789]|10[0-3]).*low-pass"):
        loadid.read(path, fs=60.0)


def test_gaps_are_gaps_and_lost_samples_too(tmp_path):
    t = jittered(4, 500)
    truth = tones(5, 6.0)
    keep = np.ones(500, bool)
    keep[200:207] = False
    y = truth(t)
    y[350] = np.nan
    path = table(tmp_path / "log.csv", t[keep], y[keep])
    path.write_text(path.read_text().replace("nan", ""))
    record = loadid.read(path, fs=100.0)
    at = t[0] + record.time
    missing = ((at > t[199]) & (at < t[207])) | ((at > t[349]) & (at < t[351]))
    np.testing.assert_array_equal(np.isnan(record["F"]), missing)
    np.testing.assert_allclose(record["F"][~missing], truth(at)[~missing], atol=0.02 * np.nanstd(y))
    said = f"2 gaps in time, the longest of {t[207] - t[199]:.4g} s after {t[199] - t[0]:.6g} s: {missing.sum()} "
    assert any(said in note for note in record.notes)
    keep[207:400] = False
    with pytest.raises(InputError, match="too many samples are missing"):
        loadid.read(table(tmp_path / "log.csv", t[keep], truth(t)[keep]), fs=100.0)


def test_what_cannot_be_a_grid_is_refused(tmp_path):
    t = jittered(6, 50)
    t[-1] = 1e9
    with pytest.raises(InputError, match="no grid to resample to"):
        loadid.read(table(tmp_path / "log.csv", t, t), fs=1e6)
    t = jittered(6, 50)
    t[20] = t[19]
    with pytest.raises(InputError, match="time does not rise"):
        loadid.read(table(tmp_path / "log.csv", t, t), fs=200.0)


def test_a_damaged_stamp_is_no_reason_to_resample(tmp_path):
    t = np.arange(300) / 100
    for k in (0, 150, 299):
        off = t.copy()
        off[k] += 0.003
        for stated in ({}, {"fs": 100.0}):
            with pytest.raises(
                InputError, match=rf"off the grid of all others; found: 1 of 300, the first .* sample {k},"
            ):
                loadid.read(table(tmp_path / "log.csv", off, t), **stated)


def test_even_stamps_are_what_they_were(tmp_path):
    t = np.arange(300) / 100
    path = table(tmp_path / "log.csv", t, tones(1, 4.0)(t))
    record = loadid.read(path, fs=99.0)
    np.testing.assert_array_equal(record["F"], loadid.read(path)["F"])
    assert any("replaces the step 0.01 s" in note for note in record.notes)


def test_a_dataframe_of_uneven_stamps(tmp_path):
    pd = pytest.importorskip("pandas")
    t, truth = jittered(7, 400), tones(7, 5.0)
    index = pd.DatetimeIndex(pd.Timestamp("2026-11-24", tz="UTC") + pd.to_timedelta(t, unit="s"), name="time")
    record = loadid.Record.from_dataframe(pd.DataFrame({"a [m/s^2]": truth(t)}, index=index), fs=150.0)
    np.testing.assert_allclose(record["a"], truth(t[0] + record.time), atol=5e-3 * np.std(truth(t)))
    assert record.start == pytest.approx(index[0].timestamp(), abs=1e-6)


def groups(path, fast, slow, late=0.02):
    """A TDMS file with one group at 1 kHz and one at 100 Hz that begins later."""
    nptdms = pytest.importorskip("nptdms")
    begin = np.datetime64(BEGIN.replace(tzinfo=None))
    with nptdms.TdmsWriter(path) as file:
        for group, values, step, start, unit in (("fast", fast, 0.001, 0.0, "m/s^2"), ("slow", slow, 0.01, late, "N")):
            about = {"wf_increment": step, "wf_start_offset": 0.0, "unit_string": unit,
                     "wf_start_time": begin + np.timedelta64(round(start * 1e6), "us")}  # fmt: skip
            file.write_segment([nptdms.GroupObject(group), nptdms.ChannelObject(group, "x", values, about)])
    return path


def test_groups_of_a_tdms_file_go_onto_one_clock(tmp_path, capsys):
    truth, late = tones(8, 10.0), 0.023
    t, s = np.arange(4000) / 1000, late + np.arange(390) / 100
    path = groups(tmp_path / "log.tdms", truth(t), truth(s), late)
    record = loadid.read(path, record=["fast", "slow"], fs=1000.0)
    assert record.labels == ("x (fast)", "x (slow)")
    assert [c.unit for c in record.channels] == ["m/s^2", "N"]
    at = late + record.time
    assert len(record) == 3891
    np.testing.assert_allclose(record["x (fast)"], truth(at), atol=1e-4 * np.std(truth(t)))
    np.testing.assert_allclose(record["x (slow)"], truth(at), atol=0.02 * np.std(truth(t)))
    assert record.start == pytest.approx(BEGIN.timestamp() + late)
    assert any("0.023 s at the start and 0.086 s at the end of fast are left out" in note for note in record.notes)
    with pytest.raises(InputError, match=r"rate is not stated; found: fast: 1000 Hz, slow: 100 Hz"):
        loadid.read(path, record=["fast", "slow"])
    with pytest.raises(InputError, match=r"lower rate.*fast at 1000 Hz"):
        loadid.read(path, record=["slow", "fast"], fs=100.0)
    out = tmp_path / "one.csv"
    assert cli.main(["convert", str(path), "-o", str(out), "--record", "fast", "--record", "slow", "--fs", "1000"]) == 0
    np.testing.assert_allclose(loadid.read(out)["x (slow)"], record["x (slow)"], rtol=1e-12)


def test_groups_of_an_mdf_file_with_uneven_masters(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    truth = tones(9, 8.0)
    t, s = jittered(9, 1500, 500.0), 0.1 + jittered(10, 300)
    file = asammdf.MDF(version="4.10")
    file.start_time = BEGIN
    for times, name in ((t, "a"), (s, "b")):
        file.append([asammdf.Signal(truth(times), times, name=name, unit="g")], comment=name)
    file.save(tmp_path / "log.mf4", overwrite=True)
    file.close()
    record = loadid.read(tmp_path / "log.mf4", record=["a", "b"], fs=600.0)
    at = max(t[0], s[0]) + record.time
    for name, tol in (("a", 1e-4), ("b", 0.02)):
        np.testing.assert_allclose(record[name] / 9.80665, truth(at), atol=tol * np.std(truth(t)))


def test_a_stamp_hours_later_is_refused_before_a_grid_is_made(tmp_path):
    t = np.arange(100) / 1000.0
    path = table(tmp_path / "late.csv", np.append(t, 70150.0), np.sin(np.append(t, 0.1)), names=("time [s]", "F [N]"))
    tracemalloc.start()
    with pytest.raises(InputError, match="too many samples are missing"):
        loadid.read(path, fs=1000.0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5e6  # 70 million samples were made before they were counted


@pytest.mark.parametrize("end", ["first", "last"])
def test_a_gap_before_a_lone_sample_at_an_end_is_no_sample(end):
    t = np.append(jittered(11, 300), 4.0)
    t = t if end == "last" else 4.0 - t[::-1]
    grid = np.arange(t[0], t[-1], 0.01)
    found = resampled(t, np.sin(t)[:, None], grid)
    assert found.gaps == 1
    gone = np.isnan(found.values[:, 0])
    assert gone[-95:-1].all() if end == "last" else gone[1:95].all()
    assert gone.sum() < 105
