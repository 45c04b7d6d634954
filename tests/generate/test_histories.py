"""Load histories by kind, and what the sensors of another model read of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loadid import InputError
from loadid.generate import HistoryDeclaration, LoadRange, ModelRange, ReadingRange, histories
from loadid.generate._histories import HistoryMaker
from loadid.generate._work import drawn_as

from .made import chain

DT, SAMPLES = 5e-3, 400
LOADS = {
    "impact": LoadRange("impact", (2.0, 3.0), duration=(0.02, 0.05), count=(1, 3)),
    "slow": LoadRange("slow", (2.0, 3.0), frequency=(0.5, 1.0)),
    "harmonic": LoadRange("harmonic", (2.0, 3.0), frequency=(5.0, 10.0)),
    "random": LoadRange("random", (1.0, 1.0), frequency=(2.0, 20.0)),
    "switched": LoadRange("switched", (2.0, 3.0), duration=(0.1, 0.4)),
}


def made(kind: str, seed: int = 0) -> np.ndarray:
    return LOADS[kind].history(np.random.default_rng(seed), DT, SAMPLES)


def declared(**more: object) -> HistoryDeclaration:
    return HistoryDeclaration(tuple(LOADS.values()), DT, SAMPLES, **more)


# -- loads ------------------------------------------------------------------------------------------------------------
def test_impacts_are_half_sines() -> None:
    for seed in range(20):
        f = made("impact", seed)
        touched = np.flatnonzero(f)
        assert 0 < len(touched) <= 3 * 11
        assert 1.0 < np.abs(f).max() <= 9.0
    one = LoadRange("impact", 1.0, duration=0.1).history(np.random.default_rng(1), 1e-4, 20_000)
    assert np.abs(one).max() == pytest.approx(1.0, abs=1e-6)
    assert np.abs(one.sum()) * 1e-4 == pytest.approx(2 / np.pi * 0.1, rel=1e-4)  # impulse of a half sine


@pytest.mark.parametrize(("kind", "low", "high"), [("slow", 0.0, 2.0), ("harmonic", 4.0, 11.0), ("random", 2.0, 20.0)])
def test_loads_lie_in_their_band(kind: str, low: float, high: float) -> None:
    """Energy in the band, widened by the leakage of a window of Hann."""
    for seed in range(10):
        f = made(kind, seed)
        power = np.abs(np.fft.rfft(f * np.hanning(SAMPLES))) ** 2
        lines = np.fft.rfftfreq(SAMPLES, DT)
        inside = (lines >= low - 1.1) & (lines <= high + 1.1)
        assert power[inside].sum() > 0.99 * power.sum()


def test_levels_are_as_declared() -> None:
    assert made("random").std() == pytest.approx(1.0)
    for seed in range(10):
        assert 2.0 <= np.abs(made("slow", seed)).max() <= 3.0 + 1e-12
        f = made("switched", seed)
        assert np.abs(f).max() <= 3.0
        assert 4 <= 1 + np.count_nonzero(np.diff(f)) <= 21
    signs = [np.sign(f[np.argmax(np.abs(f))]) for f in (made("slow", k) for k in range(20))]
    assert {-1.0, 1.0} == set(signs)


# -- readings ---------------------------------------------------------------------------------------------------------
def test_readings_are_those_of_the_truth() -> None:
    truth = chain(1.05)
    maker = HistoryMaker(chain(), declared(sensors=ReadingRange(noise=0.0)), [truth])
    for k in range(5):
        one = drawn_as(maker, 1, k)
        exact = truth.predict(one.loads, DT)
        assert np.linalg.norm(one.data - exact) < 1e-9 * np.linalg.norm(exact)
        assert np.linalg.norm(one.data - chain().predict(one.loads, DT)) > 0.01 * np.linalg.norm(exact)


def test_what_is_declared_wrong_of_the_model_is_drawn() -> None:
    ranges = ModelRange(stiffness=(0.9, 1.1), damping=(0.5, 2.0), gain=(0.98, 1.02))
    maker = HistoryMaker(chain(), declared(model=ranges, sensors=ReadingRange(noise=0.0)))
    drawn = [drawn_as(maker, 1, k) for k in range(30)]
    stiffness = np.array([one.parameters["stiffness"] for one in drawn])
    assert 0.9 <= stiffness.min() < 0.95 < 1.05 < stiffness.max() <= 1.1
    one = drawn[3]
    exact = chain().perturbed("stiffness", stiffness[3]).perturbed("damping", one.parameters["damping"])
    clean = exact.predict(one.loads, DT)
    ratio = np.sum(one.data * clean, axis=0) / np.sum(clean**2, axis=0)
    assert np.allclose(one.data, ratio * clean, rtol=1e-9, atol=1e-9)
    assert np.all((ratio >= 0.98) & (ratio <= 1.02))


def test_noise_and_lost_channels_are_as_declared() -> None:
    maker = HistoryMaker(chain(), declared(sensors=ReadingRange(relative=0.1, lost=0.3)), [chain(1.02)])
    exact, lost = chain(1.02), []
    for k in range(20):
        one = drawn_as(maker, 2, k)
        gone = np.isnan(one.data).all(axis=0)
        lost.append(gone.mean())
        assert np.array_equal(np.isnan(one.data).any(axis=0), gone)
        clean = exact.predict(one.loads, DT)
        assert np.allclose(one.noise, 0.1 * np.sqrt(np.mean(clean**2, axis=0)))
        if not gone.all():
            assert np.std((one.data - clean)[:, ~gone] / one.noise[~gone]) == pytest.approx(1.0, abs=0.2)
    assert 0.1 < np.mean(lost) < 0.5


def test_a_set_of_histories(tmp_path: Path) -> None:
    found = histories(chain(), declared(), tmp_path / "set", draws=12, seed=1, truth=chain(1.05), workers=1)
    whole = found.read()
    assert whole.data.shape == (12, SAMPLES, 2)
    assert (found.dt, found.samples, found.kinds) == (DT, SAMPLES, tuple(LOADS))
    assert np.allclose(whole.noise, 0.01)


# -- declarations -----------------------------------------------------------------------------------------------------
TEXT = """\
dt = 0.005
samples = 400
acting = 1

[[load]]
kind = "impact"
level = [2.0, 3.0]
duration = [0.02, 0.05]
count = [1, 3]

[[load]]
kind = "random"
level = 1.0
frequency = [2.0, 20.0]

[model]
stiffness = [0.9, 1.1]

[sensors]
noise = [0.5, 2.0]
"""


def test_files_tables_and_python_say_the_same(tmp_path: Path) -> None:
    import tomllib

    path = tmp_path / "loads.toml"
    path.write_text(TEXT)
    stated = HistoryDeclaration(
        (LOADS["impact"], LOADS["random"]), DT, SAMPLES, acting=1, model=ModelRange(stiffness=(0.9, 1.1)),
        sensors=ReadingRange(noise=(0.5, 2.0)),
    )  # fmt: skip
    assert HistoryDeclaration.read(path) == stated == HistoryDeclaration.of(tomllib.loads(TEXT))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("stiffness", "stifness", "did you mean 'stiffness'"),
        ("[sensors]", "[sensor]", "did you mean 'sensors'"),
        ('"impact"', '"hammer"', "no kind of load history"),
        ("duration = [0.02, 0.05]\n", "", "duration is missing"),
        ("dt = 0.005\n", "", "key is missing"),
        ("frequency = [2.0, 20.0]", "frequency = [2.0, 200.0]", "half the sampling rate"),
        ("frequency = [2.0, 20.0]", "frequency = [2.01, 2.02]", "no line"),
        ("duration = [0.02, 0.05]", "duration = [0.02, 5.0]", "cannot hold"),
        ("stiffness = [0.9, 1.1]", "stiffness = [1.1, 0.9]", "not possible"),
        ("level = 1.0", "level = [0.0, nan]", "finite number"),
        ("samples = 400", "samples = 4", "too short"),
        ("noise = [0.5, 2.0]", "noise = 1.0\nrelative = 0.1", "two levels"),
        ("acting = 1", "acting = [", "TOML"),
    ],
)
def test_a_declaration_that_is_none_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "loads.toml"
    assert old in TEXT
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(InputError, match=said) as told:
        HistoryDeclaration.read(path)
    assert str(path) in str(told.value)


def test_what_does_not_go_together_is_refused() -> None:
    with pytest.raises(InputError, match="model of the inverse itself"):
        HistoryMaker(chain(), declared())
    with pytest.raises(InputError, match="model of the inverse itself"):
        HistoryMaker(chain(), declared(), [chain()])
    with pytest.raises(InputError, match="sensors of the truth"):
        HistoryMaker(chain(), declared(), [chain(1.1, renamed="b")])
    with pytest.raises(InputError, match="act"):
        HistoryMaker(chain(), declared(acting=2), [chain(1.1)])
