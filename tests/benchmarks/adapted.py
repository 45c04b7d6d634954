"""Coverage of a learned map that a few records with known force brought to a sensor with a gain and a bias of its own.

Each trial draws a true gain between 0.7 and 1.4 and a bias of every sensor of up to ten times its noise, adapts the map
by so many unloaded and loaded records, and counts the loads of others inside their 95 % band.

Run ``python -m tests.benchmarks.adapted [TRIALS]``.
"""

from __future__ import annotations

import sys

import numpy as np

from tests.learning import made

CASES = ((1, 0), (1, 3), (1, 5), (1, 20), (3, 3), (5, 5), (10, 20))


def real(rng, gain, bias, count):
    """Readings of a plate, and loads."""
    model, spread = made.plate()
    truth = rng.standard_normal((count, 4)) @ spread + 1.0
    return gain * truth @ model.static().T + bias + made.NOISE * rng.standard_normal((count, 8)), truth


def chain(rng, gain, bias, count):
    """Records of a chain, and loads."""
    loads = np.stack([made.slow(rng) for _ in range(count)])
    return gain * np.stack([made.seen(one, rng) for one in loads]) + bias, loads[:, :, None]


def trial(draw, fitted, noise, quiet, pressed, seed, judged, known=None):
    """Coverage of an adapted map, and that of its band without what gain and bias are off by."""
    rng = np.random.default_rng([7, quiet, pressed, seed])
    gain, bias = (rng.uniform(0.7, 1.4) if pressed else 1.0), noise * rng.uniform(-10, 10, len(noise))
    y, x = draw(rng, gain, bias, pressed + judged)
    more = [(one, load if known is None else known(load)) for one, load in zip(y[:pressed], x[:pressed], strict=True)]
    still = bias + noise * rng.standard_normal((quiet, *y.shape[1:]))
    more += [(one, np.zeros(x.shape[1:])) for one in still]
    found = fitted.adapted(more).predict(y[pressed:])
    off = np.abs(found.mean - x[pressed:])
    return np.mean(off <= 1.96 * found.std), np.mean(off <= 1.96 * found.own)


def table(name, trials, judged, *args, **more):
    print(f"{name}, {trials} sensors: share of loads in the 95 % band, mean and lowest 5 %; mean without shared errors")
    for quiet, pressed in CASES:
        x = np.array([trial(*args[:3], quiet, pressed, k, judged, **more) for k in range(trials)])
        held, least, alone = x[:, 0].mean(), np.quantile(x[:, 0], 0.05), x[:, 1].mean()
        print(f"{quiet:3d} unloaded {pressed:3d} loaded {held:7.3f} {least:7.3f} {alone:7.3f}")


def main(trials=300):
    static, history = made.static_map(), made.history_map()
    plain = np.full(8, made.NOISE)
    table("plate, loads known", trials, 200, real, static, plain)
    table("plate, sum known", trials, 200, real, static, plain, known=lambda load: {"sum": load.sum()})
    table("chain, loads known", trials // 5, 10, chain, history, made.LEVEL)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
