"""Guards of measuring FRFs: causality on bands and few lines, lines not measured, forces that move together."""

from __future__ import annotations

import numpy as np

from structures import Flag, FrfModel, MeasuredModel, cross_spectra
from structures._testing.frfs import estimate

from ..structures.impacts import hits
from ..structures.test_reciprocity import LINES, channels, frf
from .cases import Case, refused

DT = 1e-3


def oscillator(lines: np.ndarray, sign: int = 1, sensor: str = "a", **settings) -> tuple[Flag, ...]:
    """Flags of the accelerance of one oscillator at 60 Hz on some lines; a sign of -1 conjugates it."""
    w = 2 * np.pi * lines
    H = -(w**2) / ((2 * np.pi * 60) ** 2 - w**2 + 2j * 0.03 * 2 * np.pi * 60 * w)
    H = H if sign > 0 else H.conj()
    return FrfModel.from_frf(lines, H, kind="accelerance", sensors=[sensor], loads=["3+Z"], **settings).flags


def lost(first: float) -> tuple[Flag, ...]:
    """Flags of a mobility that is integrated."""
    return FrfModel.from_frf(np.array([first, 1.0, 2.0]), np.ones(3), kind="mobility").as_kind("receptance").flags


def shakers(mix: float) -> tuple[Flag, ...]:
    """Flags of an FRF of two forces, the second of which has this share of its own."""
    rng = np.random.default_rng(0)
    f = rng.standard_normal((20_000, 2))
    f[:, 1] = f[:, 0] + mix * f[:, 1]
    spectra = cross_spectra(np.column_stack([f, f.sum(axis=1) + rng.standard_normal(20_000)]), DT, segment=256)
    return estimate(spectra, [0, 1], [2]).flags


def transient(height: float) -> tuple[Flag, ...]:
    """Flags of the spectra of noise with a ringing in its middle."""
    t = np.arange(1000) * DT
    x = np.random.default_rng(0).standard_normal(20_000)
    x[9000:10_000] += height * np.exp(-20 * t) * np.sin(2 * np.pi * 60 * t)
    return cross_spectra(x, DT, segment=512).flags


def places(gain: float) -> tuple[Flag, ...]:
    """Flags of a table of three places that are all struck and read, one of them read times `gain`."""
    H = frf()
    H[:, 1] *= gain
    names = [[c.label for c in some] for some in channels()]
    return FrfModel.from_frf(LINES, H, kind="accelerance", sensors=names[0], loads=names[1]).flags


def hit_by(factor: float, count: int = 3) -> tuple[Flag, ...]:
    """Flags of hits of which the last one has its force in another unit."""
    tables = hits(count, noise=0.2)
    tables[-1][:, 0] *= factor
    return MeasuredModel.from_hits(tables, dt=DT, force=0, responses=[1]).flags


BAND, FEW = np.linspace(20, 100, 200), np.array([20.0, 50.0, 70.0])
CASES = [
    Case(
        "W223",
        lambda: hit_by(1000.0),
        lambda: hit_by(1.1),
        r"hit 3: the force is 1000 times \(a factor of units\) what the other hits say.*of hits = 99\d",
    ),
    Case(
        "E223",
        lambda: refused(lambda: hit_by(1000.0, 2)),
        lambda: refused(lambda: hit_by(1.1, 2)),
        r"hit 1 is 1000 times .* that of hit 2",
    ),
    Case("W207", lambda: oscillator(BAND, -1), lambda: oscillator(BAND), r"a / 3\+Z.*negative times = \d", "band"),
    Case(
        "W207",
        lambda: oscillator(FEW, -1, "3+Z"),
        lambda: oscillator(FEW, 1, "3+Z"),
        r"3\+Z / 3\+Z has the wrong sign or is conjugated.*= 1 \(threshold 0.75\)",
        "drive point",
    ),
    Case("N207", lambda: oscillator(FEW), lambda: oscillator(BAND), r"evenly spaced lines = 2 \(threshold 64\)"),
    Case("W211", lambda: lost(0.0), lambda: lost(0.5), r"0 Hz is lost.*set to 0 for sensor 1"),
    Case(
        "W211",
        lambda: oscillator(BAND, interpolate=True),
        lambda: oscillator(BAND),
        r"up to 0.402 Hz apart",
        "interpolated",
    ),
    Case("W212", lambda: shakers(0.05), lambda: shakers(1.0), r"100% of the lines.*threshold 0.05"),
    Case(
        "E212",
        lambda: refused(lambda: shakers(0.0)),
        lambda: refused(lambda: shakers(0.05)),
        r"force.* are one: .*threshold 1e-08",
    ),
    Case(
        "W216",
        lambda: places(9.80665),
        lambda: places(1.0),
        r"not reciprocal: 11\+Z reads 9.807 times what reciprocity says: a factor of units.*threshold",
    ),
    Case("W508", lambda: transient(200.0), lambda: transient(1.0), r"a transient is cut.*threshold 30"),
]
