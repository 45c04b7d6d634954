"""A million samples of one displacement sensor: impacts on top of a slow load, rebuilt exactly in a few seconds.

A simply supported steel beam (0.6 m, six modes from 64 to 2300 Hz, 1 % damping) carries a load that comes and goes
slowly, and is hit now and then by half sines of 4 ms; a laser beside the load reads the deflection at 10240 Hz with 1 %
noise. The last hit falls a few milliseconds before the end, so that the record ends in motion. Lambda is found by the
package. Beside the exact solution stand what a user would take at the same lambda: scipy's LSMR on an FFT operator,
conjugate gradients with a circulant preconditioner, and division of spectra. Data and inversion share the model.

Run ``python -m case_studies.long_record [samples] [--all]``: prints the table and saves ``long_record.png``. LSMR takes
minutes for a million samples, and runs there with ``--all`` only.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from loadid import Deconvolution, Lambda, LoadEstimate, Noise
from structures import ForwardModel, beams, damping, loads, sensors

FS, SAMPLES, NOISE = 10_240.0, 1_000_000, 0.01
PULSE, SPACING = 41, 4_000  # samples of a hit; mean distance between hits
TAPS = 1 << 17  # samples after which the response has been forgotten
END = 2_000  # samples at the end that are judged on their own
WAYS = ("LSMR + FFT", "circulant PCG", "spectral division")
PATIENT = 200_000  # samples up to which LSMR is waited for


def model() -> ForwardModel:
    """Beam with one load and one laser."""
    beam = beams.simply_supported(
        length=0.6,
        section=beams.Section.rectangle(width=0.04, height=0.01),
        material=beams.materials.steel,
        elements=40,
        damping=damping.Modal(0.01),
    )
    laser = sensors.Displacement(at=0.21, direction="Z", label="laser")
    return ForwardModel(beam, [laser], [loads.Point(at=0.255, direction="Z", label="load")], modes=6)


@dataclass(frozen=True)
class Truth:
    """Load and its parts (samples,), and the first sample and the height of every hit."""

    slow: NDArray[np.float64]
    hits: NDArray[np.float64]
    starts: NDArray[np.int_]
    heights: NDArray[np.float64]

    @property
    def load(self) -> NDArray[np.float64]:
        """All of it."""
        return self.slow + self.hits


def truth(samples: int) -> Truth:
    """Hits of 20 to 60 N at random times, and a load of some newtons that changes within seconds; from rest."""
    rng, t = np.random.default_rng(1), np.arange(samples) / FS
    slow = (
        6 * (1 - np.exp(-t / 0.05)) * (1 + 0.5 * np.sin(2 * np.pi * 0.31 * t) + 0.3 * np.sin(2 * np.pi * 1.7 * t + 1))
    )
    count = max(samples // SPACING, 2)
    starts = (np.arange(count) * (samples - 600) // count + rng.integers(300, SPACING // 2, count)).astype(int)
    starts = np.append(starts[starts < samples - 800], samples - 100)
    heights = rng.uniform(20, 60, len(starts))
    hits = np.zeros(samples)
    for k, height in zip(starts, heights, strict=True):
        hits[k : k + PULSE] += height * np.sin(np.pi * (np.arange(PULSE) + 0.5) / PULSE)
    return Truth(slow, hits, starts, heights)


@dataclass(frozen=True)
class Study:
    """Record (samples,), its noise level, the load behind it, the estimate, and the CPU seconds that it took."""

    beam: ForwardModel
    record: NDArray[np.float64]
    sigma: float
    true: Truth
    estimate: LoadEstimate
    seconds: float

    @property
    def error(self) -> float:
        """Relative error of the load."""
        return float(np.linalg.norm(self.estimate.load[:, 0] - self.true.load) / np.linalg.norm(self.true.load))

    @property
    def slow_error(self) -> float:
        """Relative error of the mean load in each 0.1 s without a hit."""
        width = 1024
        blocks = len(self.record) // width
        calm = ~self.true.hits[: blocks * width].reshape(blocks, width).any(axis=1)
        means = [x[: blocks * width].reshape(blocks, width).mean(axis=1)[calm] for x in (self.found, self.true.load)]
        return float(np.linalg.norm(means[0] - means[1]) / np.linalg.norm(means[1]))

    @property
    def peak_error(self) -> float:
        """Median relative error of the height of a hit."""
        above = np.array([self.found[k : k + PULSE].max() for k in self.true.starts])
        real = np.array([self.true.load[k : k + PULSE].max() for k in self.true.starts])
        return float(np.median(np.abs(above / real - 1)))

    @property
    def impulse_error(self) -> float:
        """Median relative error of the impulse of a hit, over its time and half of it to either side."""
        half = PULSE // 2
        found, real = (
            np.array([np.sum((x - self.true.slow)[max(k - half, 0) : k + PULSE + half]) for k in self.true.starts])
            for x in (self.found, self.true.load)
        )
        return float(np.median(np.abs(found / real - 1)))

    @property
    def covered(self) -> float:
        """Share of the true load inside the 95 % band."""
        low, high = self.estimate.band()
        return float(np.mean((low[:, 0] <= self.true.load) & (self.true.load <= high[:, 0])))

    @property
    def found(self) -> NDArray[np.float64]:
        """Estimated load (samples,)."""
        return self.estimate.load[:, 0]


def study(samples: int = SAMPLES) -> Study:
    """Make the record and rebuild the load; one seed."""
    beam, true, dt = model(), truth(samples), 1 / FS
    h = beam.impulse_response(dt, min(samples, TAPS))[:, 0, 0]
    padded = fft.next_fast_len(samples + len(h), real=True)
    clean = fft.irfft(fft.rfft(h, padded) * fft.rfft(true.load, padded), padded)[:samples]
    sigma = NOISE * float(np.std(clean))
    record = clean + sigma * np.random.default_rng(0).standard_normal(samples)
    start = time.process_time()
    family = Deconvolution(
        beam, choice=Lambda(path="statespace"), noise=Noise([sigma], source="quiet stretch of the laser")
    )
    estimate = family.estimate(record, dt=dt)
    assert estimate.std is not None
    return Study(beam, record, sigma, true, estimate, time.process_time() - start)


# -- what a user would take -------------------------------------------------------------------------------------------
class Fourier:
    """The whitened record and products with the convolution by zero-padded FFT, at the lambda of the estimate."""

    def __init__(self, s: Study) -> None:
        self.samples = len(s.record)
        self.padded = fft.next_fast_len(2 * self.samples, real=True)
        h = s.beam.impulse_response(1 / FS, min(self.samples, TAPS))[:, 0, 0]
        self.symbol, self.y = fft.rfft(h / s.sigma, self.padded), s.record / s.sigma
        self.lam = s.estimate.choice.lam * s.estimate.choice.scale

    def times(self, symbol: NDArray, x: NDArray) -> NDArray[np.float64]:
        """Filter by a symbol."""
        return fft.irfft(symbol * fft.rfft(np.ravel(x), self.padded), self.padded)[: self.samples]

    @property
    def power(self) -> NDArray[np.float64]:
        """|H|^2 + lam^2 of every line."""
        return np.abs(self.symbol) ** 2 + self.lam**2


def lsmr(f: Fourier) -> NDArray[np.float64]:
    """LSMR of scipy at tolerance 1e-8."""
    from scipy.sparse.linalg import LinearOperator
    from scipy.sparse.linalg import lsmr as solve

    operator = LinearOperator(
        (f.samples, f.samples),
        matvec=lambda x: f.times(f.symbol, x),
        rmatvec=lambda x: f.times(f.symbol.conj(), x),
        dtype=float,
    )
    return np.asarray(solve(operator, f.y, damp=f.lam, atol=1e-8, btol=1e-8, maxiter=2000)[0])


def pcg(f: Fourier) -> NDArray[np.float64]:
    """Conjugate gradients to 1e-8, preconditioned by the padded circulant."""
    symbol, r = 1 / f.power, f.times(f.symbol.conj(), f.y)
    x, stop = np.zeros_like(r), 1e-8 * float(np.linalg.norm(r))
    d = z = f.times(symbol, r)
    energy = float(r @ z)
    for _ in range(500):
        u = f.times(f.symbol.conj(), f.times(f.symbol, d)) + f.lam**2 * d
        step = energy / float(d @ u)
        x += step * d
        r -= step * u
        if np.linalg.norm(r) <= stop:
            break
        z = f.times(symbol, r)
        energy, before = float(r @ z), energy
        d = z + energy / before * d
    return x


def division(f: Fourier) -> NDArray[np.float64]:
    """Wiener division of zero-padded spectra: as if the response went on after the record, at zero."""
    return f.times(f.symbol.conj() / f.power, f.y)


@dataclass(frozen=True)
class Row:
    """An alternative at the same lambda: CPU seconds, and its relative distance to the exact solution."""

    name: str
    seconds: float
    distance: float
    at_end: float


def alternatives(s: Study, names: tuple[str, ...] = WAYS) -> list[Row]:
    """Everything a user would take, one lambda, no std."""
    ways: dict[str, Callable[[Fourier], NDArray]] = dict(zip(WAYS, (lsmr, pcg, division), strict=True))
    rows = []
    for name in names:
        start = time.process_time()
        load = ways[name](Fourier(s))
        seconds = time.process_time() - start
        away, exact = load - s.found, s.found
        rows.append(
            Row(
                name,
                seconds,
                float(np.linalg.norm(away) / np.linalg.norm(exact)),
                float(np.linalg.norm(away[-END:]) / np.linalg.norm(exact[-END:])),
            )
        )
    return rows


def show(s: Study, rows: list[Row]) -> str:
    """The study in text."""
    e = s.estimate
    lines = [
        f"{len(s.record)} samples ({len(s.record) / FS:.0f} s), {len(s.true.starts)} hits; path: {e.facts.path}",
        f"lambda {e.choice.lam:.3g} by {e.choice.rule}; agreement of the rules: {e.choice.verdict}",
        f"load error {s.error:.3f}; slow load {s.slow_error:.1%}",
        f"hits, median errors: peak {s.peak_error:.1%}, impulse {s.impulse_error:.1%}",
        f"inside the 95 % band: {s.covered:.1%}; flags: {', '.join(sorted(e.codes)) or 'none'}",
        "",
        f"{'':22s}{'CPU s':>8s}{'distance to exact':>20s}{'last 0.2 s':>13s}",
        f"{'loadid, everything':22s}{s.seconds:8.2f}{'':>20s}{'':>13s}  lambda, rules, load, std, flags",
    ]
    lines += [f"{r.name:22s}{r.seconds:8.2f}{r.distance:20.1e}{r.at_end:13.1e}  one lambda, no std" for r in rows]
    return "\n".join(lines)


def picture(s: Study, path: Path) -> None:
    """Whole record, and its start, middle and end with truth, estimate and band."""
    from matplotlib.figure import Figure

    t, (low, high) = np.arange(len(s.record)) / FS, s.estimate.band()
    figure = Figure(figsize=(10, 7.5), layout="constrained")
    axes = figure.subplot_mosaic([["record"] * 3, ["load"] * 3, ["start", "middle", "end"]], height_ratios=[1, 1, 1.4])
    axes["record"].plot(*_envelope(t, 1e6 * s.record), color="0.4", lw=0.5)
    axes["record"].set(ylabel="deflection in µm", title=f"{len(t)} samples of one laser", xlim=(0, t[-1]))
    axes["load"].plot(*_envelope(t, s.found), color="C0", lw=0.5, label="rebuilt")
    axes["load"].plot(*_envelope(t, s.true.slow), color="k", lw=1, ls="--", label="slow part of the true load")
    axes["load"].set(ylabel="load in N", xlabel="time in s", xlim=(0, t[-1]), ylim=(None, 1.3 * s.found.max()))
    axes["load"].legend(loc="upper right", ncols=2)
    one, middle = s.true.starts[0], s.true.starts[len(s.true.starts) // 2]
    zooms = {"start": (0, one + 400), "middle": (middle - 300, middle + 400), "end": (len(t) - 700, len(t))}
    for name, (first, end) in zooms.items():
        ax, part = axes[name], slice(first, end)
        ax.fill_between(t[part], low[part, 0], high[part, 0], color="C0", alpha=0.3, lw=0, label="95 % band")
        ax.plot(t[part], s.found[part], color="C0", lw=1, label="rebuilt")
        ax.plot(t[part], s.true.load[part], color="k", lw=1, ls="--", label="true")
        ax.set(title=name, xlabel="time in s", xlim=(t[part][0], t[part][-1]))
    axes["start"].set_ylabel("load in N")
    axes["start"].legend(loc="upper left")
    figure.savefig(path, dpi=130)


def _envelope(t: NDArray, x: NDArray, points: int = 2000) -> tuple[NDArray, NDArray]:
    """Smallest and largest value of each stretch: what a line of a million points looks like."""
    width = max(len(x) // points, 1)
    count = len(x) // width
    parts = x[: count * width].reshape(count, width)
    return np.repeat(t[: count * width : width], 2), np.stack([parts.min(axis=1), parts.max(axis=1)], axis=1).ravel()


def main(samples: int = SAMPLES, everything: bool = False) -> None:
    """Print the study and save the picture."""
    study(30_000)  # nothing below pays for compiling
    s = study(samples)
    names = WAYS if everything or samples <= PATIENT else WAYS[1:]
    sys.stdout.write(show(s, alternatives(s, names)) + "\n")
    target = Path("long_record.png")
    picture(s, target)
    sys.stdout.write(f"picture: {target}\n")


if __name__ == "__main__":
    sizes = [int(float(a)) for a in sys.argv[1:] if not a.startswith("-")]
    main(sizes[0] if sizes else SAMPLES, "--all" in sys.argv)
