"""Impact tests made by hand: a known discrete response, hits on it, noise."""

import numpy as np

DT = 1 / 1000
POLES = ((60.0, 0.15, 1.0), (170.0, 0.06, -0.7), (310.0, 0.03, 0.4))  # Hz, damping ratio, amplitude


def response(samples=400, sensors=1):
    """Impulse response (samples, sensors): sums of decaying sines, 1e-9 of it left after 400 samples."""
    t = np.arange(samples) * DT
    modes = np.array([np.exp(-z * 2 * np.pi * f * t) * np.cos(2 * np.pi * f * t) for f, z, _ in POLES])
    shapes = np.array([[a * np.cos(i * (i + 1)) for _, _, a in POLES] for i in range(sensors)])
    return modes.T @ shapes.T


def transfer(frequencies, sensors=1):
    """Fourier transform (lines, sensors) of `response` without end, in closed form."""
    z = np.exp(-2j * np.pi * np.asarray(frequencies, float) * DT)[:, None]
    columns = []
    for i in range(sensors):
        total = 0
        for f, zeta, a in POLES:
            p = np.exp((-zeta + 1j) * 2 * np.pi * f * DT)
            total = total + a * np.cos(i * (i + 1)) * 0.5 * (1 / (1 - p * z) + 1 / (1 - p.conj() * z))
        columns.append(total)
    return np.concatenate(columns, axis=1)


def blow(samples=1024, at=20, height=100.0, shape=(0.3, 1.0, 0.5)):
    """Force (samples,): a few samples wide, with energy on every line."""
    f = np.zeros(samples)
    f[at : at + len(shape)] = height * np.asarray(shape)
    return f


def record(force, h, noise=0.0, rng=None):
    """Table (samples, 1 + sensors) of a force and its response."""
    y = np.column_stack([np.convolve(force, column)[: len(force)] for column in h.T])
    return np.column_stack([force, y + (noise * rng.standard_normal(y.shape) if noise else 0.0)])


def hits(count=3, sensors=1, noise=0.0, seed=0, samples=1024):
    """Tables of some hits of different height and place."""
    rng = np.random.default_rng(seed)
    h = response(sensors=sensors)
    return [
        record(blow(samples, 20 + 3 * i, 100.0 + 20 * i, (0.3, 1.0, 0.5 + 0.05 * i)), h, noise, rng)
        for i in range(count)
    ]
