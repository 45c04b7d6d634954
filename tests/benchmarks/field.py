"""Plate pressure q(x, y, t) from 16 gauges: error against the best lambda, CPU time against alternatives.

`python -m tests.benchmarks.field [samples]` (10000; a few minutes). An aluminium plate of 1.0 x 0.8 m, 16 strain gauges
of two directions, 5 % noise. The pressure is a field that the basis does not contain: three bumps that travel over the
plate, their strengths random with a band of some 40 Hz. Basis: bilinear hats on 4 x 4 points. Errors are relative L2
over all nodes and samples; "oracle" is the best lambda of the same family with the truth known, on a grid of eight per
decade; the floor is the best that the basis can do. Beside it scipy's LSMR on the same operator by FFT, which is given
the lambda that was chosen and finds no std, and the full grid, which is refused.
"""

from __future__ import annotations

import sys
import time
from functools import cache

import numpy as np
from numpy.typing import NDArray

from loadid import FieldDeconvolution, Noise, NotIdentifiable
from loadid._inverse.convolution import Convolution
from structures import ForwardModel, bases, plates, sensors
from structures._elements.beams import materials

DT, NOISE, SEEDS = 1 / 500, 0.05, 2
SMOOTH = {"space": "gradient", "time": "first_difference"}
PRIORS = {
    "none": {},
    "space": {"space": "gradient"},
    "space x steps in time": SMOOTH,
    "space 0.3 + steps in time": {**SMOOTH, "ratio": 0.3},
}
STEPS = tuple(np.arange(-6, 7) / 8)  # decades from the chosen lambda at which the oracle is sought


@cache
def plate():
    """Clamped plate."""
    return plates.plate(lengths=(1.0, 0.8), thickness=0.004, material=materials.aluminium, elements=(12, 12),
                        edges="CCCC", damping=0.02)  # fmt: skip


def gauges() -> list[sensors.StrainGauge]:
    """Sixteen gauges, off any symmetry."""
    return [
        sensors.StrainGauge(
            at=(x + 0.03 * (j % 2 - 0.5), y + 0.02 * (i % 2 - 0.5)), fibre=0.002, angle=(0, np.pi / 2)[(i + j) % 2],
            label=f"g{i}{j}",
        )
        for i, x in enumerate((0.11, 0.37, 0.62, 0.88))
        for j, y in enumerate((0.09, 0.3, 0.5, 0.71))
    ]  # fmt: skip


def model(basis, modes: int = 10) -> ForwardModel:
    """Model under a basis: some modes and the static residual."""
    return ForwardModel(plate(), gauges(), basis, modes=modes)


def pressure(samples: int, places: NDArray, seed: int) -> NDArray:
    """Three bumps that travel, (samples, places) in Pa."""
    from scipy.ndimage import gaussian_filter1d

    rng, t = np.random.default_rng(100 + seed), np.arange(samples) * DT
    q = np.zeros((samples, len(places)))
    for k in range(3):
        x = 0.5 + 0.3 * np.sin(2 * np.pi * (0.15 + 0.1 * k) * t + k)
        y = 0.4 + 0.25 * np.cos(2 * np.pi * (0.11 + 0.07 * k) * t + 2 * k)
        strength = gaussian_filter1d(rng.standard_normal(samples), 2.0)
        near = ((places[:, 0] - x[:, None]) / 0.3) ** 2 + ((places[:, 1] - y[:, None]) / 0.25) ** 2
        q += 100 * (strength / strength.std())[:, None] * np.exp(-near)
    return q


def record(samples: int, seed: int):
    """Fine places, pressure there, noisy record and its noise level."""
    fine = bases.hats(plate())
    q = pressure(samples, fine.coordinates, seed)
    clean = model(fine).predict(q, DT)
    noise = NOISE * clean.std(axis=0)
    return fine.coordinates, q, clean + noise * np.random.default_rng(seed).standard_normal(clean.shape), noise


def error(basis, load: NDArray, q: NDArray, places: NDArray) -> float:
    """Relative error of the field at all nodes and samples."""
    return float(np.linalg.norm(basis.evaluate(load, places)[..., 0] - q) / np.linalg.norm(q))


def errors(y, noise, q, places, steps=STEPS, **settings) -> tuple[float, float]:
    """Error at the chosen lambda, and the smallest at lambdas so many decades from it."""
    basis = bases.hats(plate(), (3, 3))
    under = model(basis)
    asked = {"noise": Noise(noise, source="known"), **settings}
    found = FieldDeconvolution(under, **asked).estimate(y, DT)
    at = [float(found.choice.lam * 10**s) for s in steps if s]
    others = [FieldDeconvolution(under, choice=lam, **asked).estimate(y, DT).load for lam in at]
    all_errors = [error(basis, load, q, places) for load in (found.load, *others)]
    return all_errors[0], min(all_errors)


def full_grid(y, noise) -> None:
    """The pressure at every node from the same gauges."""
    FieldDeconvolution(model(bases.hats(plate())), noise=noise).estimate(y, DT)


def lsmr(under: ForwardModel, y: NDArray, noise: NDArray, lam: float) -> tuple[NDArray, int]:
    """The same minimiser by scipy with products by FFT: load and iterations."""
    from scipy.sparse.linalg import lsmr as solve

    H = Convolution(under.impulse_response(DT, len(y)) / noise[:, None])
    out = solve(H, (y / noise).ravel(), damp=lam, atol=1e-8, btol=1e-8, maxiter=2000)
    return out[0].reshape(len(y), H.loads), out[2]


def main(samples: int) -> None:
    """Print the table."""
    basis = bases.hats(plate(), (3, 3))
    under = model(basis)
    print(f"plate, 16 gauges, 4 x 4 hats, {samples} samples, {NOISE:.0%} noise: relative error of q(x, y, t)")
    print("  seed  prior                       error   oracle   ratio   basis floor   CPU s   path")
    for seed in range(SEEDS):
        places, q, y, noise = record(samples, seed)
        B = basis.evaluate(np.eye(len(basis)), places)[..., 0]
        floor = error(basis, np.linalg.lstsq(B.T, q.T, rcond=None)[0].T, q, places)
        for name, settings in PRIORS.items():
            start = time.process_time()
            found = FieldDeconvolution(under, noise=Noise(noise, source="known"), **settings).estimate(y, DT)
            spent = time.process_time() - start
            ours, best = errors(y, noise, q, places, **settings)
            print(f"  {seed:4d}  {name:26s}{ours:7.4f}{best:9.4f}{ours / best:8.3f}{floor:14.4f}{spent:8.2f}"
                  f"   {found.facts['path']}")  # fmt: skip
        if seed == 0:
            plain = FieldDeconvolution(under, noise=Noise(noise, source="known")).estimate(y, DT)
            start = time.process_time()
            load, iterations = lsmr(under, y, noise, plain.choice.lam * plain.choice.scale)
            apart = np.linalg.norm(load - plain.load) / np.linalg.norm(plain.load)
            print(f"        LSMR, one lambda given: {time.process_time() - start:.2f} CPU s, {iterations} iterations, "
                  f"{apart:.1e} from ours, no std")  # fmt: skip
            try:
                full_grid(y, noise)
            except NotIdentifiable as refusal:
                print(f"        full grid: {refusal}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)
