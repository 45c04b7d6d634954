"""Guards of modal tests: complex shapes, and modes that a test tells poorly."""

from __future__ import annotations

import numpy as np

from structures import Flag, FrfModel, identify_modes

from .cases import Case

LINES = np.arange(10.0, 100.0, 0.25)
SHAPES = np.array([[1.0, 0.6], [0.7, -1.0], [0.2, 0.8]])


def two(first: float = 30.0, second: float = 60.0, turn: float = 0.0, echo: float = 0.0) -> tuple[Flag, ...]:
    """Flags of the modes of three sensors; one shape is turned by an angle that differs from sensor to sensor.

    What all sensors read comes again after half a second, `echo` times as large, as after a hit that was double.
    """
    s, H = 2j * np.pi * LINES, np.zeros((len(LINES), 3, 1), complex)
    for f, shape, angle in ((first, SHAPES[:, 0], turn), (second, SHAPES[:, 1], 0.0)):
        w = 2 * np.pi * f
        p = -0.02 * w + 1j * w
        psi = -1j * shape / (2 * w) * np.exp(1j * angle * np.arange(3)) * p
        H[:, :, 0] += s[:, None] * (psi / (s[:, None] - p) + psi.conj() / (s[:, None] - p.conjugate()))
    H *= (1 + echo * np.exp(-0.5 * s))[:, None, None]
    rng = np.random.default_rng(0)
    std = 0.003 * np.sqrt(np.mean(np.abs(H) ** 2))
    H = H + std * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    table = FrfModel.from_frf(
        LINES, H, kind="accelerance", sensors=["a", "b", "c"], loads=["F"], variance=np.full(H.shape, std**2)
    )
    return identify_modes(table, order=24).flags


CASES = [
    Case("W217", lambda: two(turn=0.6), two, r"phase collinearity 0\.\d+ at 30.*that real shapes leave = 0\.\d"),
    Case("W218", lambda: two(second=30.3), two, r"30.*on top of another.*tells poorly = 2", "close"),
    Case("W218", lambda: two(second=99.0), two, r"99.* Hz: at the end of the band", "edge"),
    Case("W219", lambda: two(echo=0.3), two, r"miss the measured FRFs by \d+%.*beyond their noise = 0\.\d"),
]
