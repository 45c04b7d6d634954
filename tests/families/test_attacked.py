"""Histories behind a table of FRFs and static rows with a lost gauge, held against truths of another route.

The history is that of a fine step, taken through a filter without phase and sampled; its band is made by a transform of
its own, not by the family.
"""

from __future__ import annotations

import numpy as np
import pytest

from loadid import AutomaticInversion, FrequencyInversion, Record, StaticInversion, datasets
from structures import ForwardModel, FrfModel, beams, damping, loads, sensors
from structures.errors import InputError

DT, SAMPLES, FINER = 1 / 4096, 2048, 8
LOW, HIGH = 30.0, 900.0


def beam(elements: int, modes: int) -> ForwardModel:
    structure = beams.simply_supported(
        length=1.0, section=beams.Section.rectangle(0.04, 0.01), material=beams.materials.steel, elements=elements,
        damping=damping.Modal(0.15),
    )  # fmt: skip
    seen = [sensors.Accelerometer(at=x, label=f"a{k}") for k, x in enumerate((0.22, 0.41, 0.76))]
    return ForwardModel(structure, seen, [loads.Point(at=0.59, label="F")], modes=modes)


def in_band(g: np.ndarray) -> np.ndarray:
    """A history with half cosines over a tenth of the band at its ends, half a line beyond them; below an octave."""
    f = np.fft.rfftfreq(2 * SAMPLES, DT)
    kept = f[(f >= LOW) & (f <= HIGH)]
    width, half = 0.1 * (kept[-1] - kept[0]), 0.5 * f[1]
    rise, fall = (f - kept[0] + half) / min(width, kept[0]), (kept[-1] - f + half) / width
    weight = 0.5 - 0.5 * np.cos(np.pi * np.clip(np.minimum(rise, fall), 0, 1))
    return np.fft.irfft(np.fft.rfft(g, 2 * SAMPLES) * weight, 2 * SAMPLES)[:SAMPLES]


def test_the_band_of_a_transient_holds_the_history_of_a_fine_simulation() -> None:
    """95 % of all samples, and of those of the pulse nearly as many."""
    from scipy.signal import fftconvolve, firwin

    fine, taps = beam(80, 14), firwin(40 * FINER + 1, 0.85 / FINER)[:, None]
    f = np.fft.rfftfreq(2 * SAMPLES, DT)
    table = FrfModel.of(fine, f[(f >= LOW) & (f <= HIGH)])
    every, near = [], []
    for seed in (21, 22, 23):
        rng = np.random.default_rng(seed)
        start, width = int(rng.integers(100, 900)) * FINER, int(rng.integers(10, 24)) * FINER
        g = np.zeros((SAMPLES * FINER, 1))
        g[start : start + width, 0] = 200 * np.sin(np.pi * (np.arange(width) + 0.5) / width)
        load, y = (fftconvolve(x, taps, mode="same", axes=0)[::FINER] for x in (g, fine.predict(g, DT / FINER)))
        sigma = 0.01 * np.sqrt(np.mean(y**2, axis=0))
        record = Record(y + sigma * rng.standard_normal(y.shape), DT, table.sensors)
        found = FrequencyInversion(table, signal="transient", noise=sigma).estimate(record)
        truth, (low, high) = in_band(load[:, 0]), (edge[:, 0] for edge in found.band())
        inside = (low <= truth) & (truth <= high)
        pulse = np.abs(np.arange(SAMPLES) - (start + width / 2) / FINER) < 40
        every.append(inside.mean())
        near.append(inside[pulse].mean())
        assert np.linalg.norm(found.load[:, 0] - truth) < 0.01 * np.linalg.norm(truth)
    assert 0.93 < np.mean(every) < 0.97
    assert np.mean(near) > 0.8


@pytest.mark.parametrize("family", [StaticInversion, AutomaticInversion])
def test_a_lost_gauge_of_one_row_is_named_and_never_filled(family: type) -> None:
    """NaN, a mask or a missing name; left out by name the answer stays within its band."""
    made = datasets.wing_strains()
    labels, y = [s.label for s in made.model.sensors], np.asarray(made.record.values)[0]
    rows = np.tile(y, (3, 1))
    masked = np.ma.masked_array(rows.copy(), mask=np.zeros(rows.shape, bool))
    masked.data[1, 2], masked.mask[1, 2] = 999.0, True
    rows[1, 2] = np.nan
    for given in (rows, masked, dict(zip(labels, rows[1], strict=True))):
        with pytest.raises(InputError, match=labels[2]):
            family(made.model).estimate(given)
    rest = [x for x in labels if x != labels[2]]
    whole, part = (
        family(made.model, sensors=some).estimate({x: y[labels.index(x)] for x in some or labels})
        for some in (None, rest)
    )
    for a, b in zip(whole.resultants, part.resultants, strict=True):
        assert abs(a.value - b.value) < 2 * b.std
        assert b.std >= a.std
