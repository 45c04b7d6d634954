"""Modes from a test beside sdypy-EMA, on structures whose modes are known: errors of each, and what it costs.

Run ``python -m tests.benchmarks.modes``: a line for each case, the mean over noises.

Truth comes from elsewhere: closed forms of modes written out (close, damped, local), and a cantilever of 40 elements
with dashpots whose complex modes are those of its full K, M, C. Both tools get the same noisy accelerance. sdypy-EMA
wants
its poles picked from a stabilisation chart; here it picks the pole nearest to each true frequency, at its highest order
or as its own search among stable ones does: that is the help that a user with good eyes gives, and more than ours gets.
"""

from __future__ import annotations

import contextlib
import io
import logging
import sys
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures import FrfModel, identify_modes

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Case:
    """A structure: lines (Hz), accelerance (lines, sensors), frequencies and damping in the band, shapes, noise."""

    name: str
    f: Real
    H: Complex
    frequencies: Real
    damping: Real
    shapes: Complex
    noise: float


def written(name: str, f: Real, own: list[float], z: list[float], noise: float, *, local: bool = False) -> Case:
    """Modes written out, with random shapes at six sensors, driven at the first; two more lie above the band."""
    rng = np.random.default_rng(7)
    F, Z = np.array([*own, 1.3 * f[-1], 2.4 * f[-1]]), np.array([*z, 0.01, 0.01])
    shapes = rng.standard_normal((6, len(F)))
    shapes[0] = np.sign(shapes[0]) * np.maximum(np.abs(shapes[0]), 0.4)
    if local:  # one that a single sensor sees
        shapes[:, 1] *= 0.02
        shapes[3, 1] = 1.0
        shapes[0, 1] = 0.2
    s, w = 2j * np.pi * f[:, None], 2 * np.pi * F
    H = np.einsum("lk,mk,k->lm", s**2 / (s**2 + 2 * Z * w * s + w**2), shapes, shapes[0])
    n = len(own)
    return Case(name, f, H, F[:n], Z[:n], shapes[:, :n].astype(complex), noise)


def dashpots(noise: float, elements: int = 40) -> Case:
    """A clamped beam with two dashpots: its full K, M, C line by line, and the modes of their first-order system."""
    K, M, C = beam(elements)
    places = [2 * round(elements * x) - 2 for x in (1.0, 0.8, 0.6, 0.45, 0.3)]
    f = np.arange(5.0, 400.0, 0.25)
    H = np.empty((len(f), len(places)), complex)
    push = np.zeros(len(K))
    push[places[0]] = 1.0
    for i, w in enumerate(2 * np.pi * f):
        H[i] = -(w**2) * np.linalg.solve(K - w**2 * M + 1j * w * C, push)[places]
    n = len(K)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    p, v = np.linalg.eig(A)
    rank = np.argsort(np.abs(p))
    size = np.abs(p[rank]) / (2 * np.pi)
    own = rank[(p.imag[rank] > 0) & (size > 6) & (size < 395)]
    size = np.abs(p[own])
    return Case("dashpots (complex)", f, H, size / (2 * np.pi), -p[own].real / size, v[:n][places][:, own], noise)


def beam(elements: int) -> tuple[Real, Real, Real]:
    """K, M, C of a clamped steel beam of 1.5 m (EI 1500 N m^2, 4 kg/m), 0.5 % stiffness damping, two dashpots."""
    L, EI, m = 1.5 / elements, 1500.0, 4.0
    k = EI / L**3 * np.array([[12, 6 * L, -12, 6 * L], [6 * L, 4 * L**2, -6 * L, 2 * L**2],
                              [-12, -6 * L, 12, -6 * L], [6 * L, 2 * L**2, -6 * L, 4 * L**2]])  # fmt: skip
    q = m * L / 420 * np.array([[156, 22 * L, 54, -13 * L], [22 * L, 4 * L**2, 13 * L, -3 * L**2],
                                [54, 13 * L, 156, -22 * L], [-13 * L, -3 * L**2, -22 * L, 4 * L**2]])  # fmt: skip
    K, M = np.zeros((2 * elements + 2,) * 2), np.zeros((2 * elements + 2,) * 2)
    for e in range(elements):
        own = slice(2 * e, 2 * e + 4)
        K[own, own] += k
        M[own, own] += q
    K, M = K[2:, 2:], M[2:, 2:]
    C = 2e-5 * K + 0.5 * M
    for place, c in ((0.7, 25.0), (0.35, 12.0)):
        i = 2 * round(elements * place) - 2
        C[i, i] += c
    return K, M, C


def cases() -> list[Case]:
    """All of them."""
    f = np.arange(10.0, 201.0, 0.25)
    five, usual = [31.0, 60.0, 95.0, 130.0, 170.0], [0.01] * 5
    return [
        written("plain, 0.2 % noise", f, five, usual, 0.002),
        written("plain, 3 % noise", f, five, usual, 0.03),
        written("close modes (0.6 %)", f, [31.0, 80.0, 80.5, 130.0, 170.0], [0.01, 0.006, 0.005, 0.01, 0.01], 0.01),
        written("heavy damping (3 to 8 %)", f, five, [0.03, 0.08, 0.06, 0.05, 0.04], 0.01),
        written("a local mode", f, five, usual, 0.01, local=True),
        dashpots(0.005),
    ]


def noisy(case: Case, seed: int) -> tuple[Complex, float]:
    """Accelerance with white noise of a share of its rms, and its std."""
    rng = np.random.default_rng(seed)
    std = case.noise * float(np.sqrt(np.mean(np.abs(case.H) ** 2)))
    return case.H + std * (rng.standard_normal(case.H.shape) + 1j * rng.standard_normal(case.H.shape)) / 2**0.5, std


def ours(case: Case, H: Complex, std: float) -> tuple[Real, Real, Complex, Complex, float]:
    """Frequencies, damping, shapes, FRFs of the model and CPU seconds."""
    t = time.process_time()
    table = FrfModel.from_frf(case.f, H[..., None], kind="accelerance", variance=np.full((*H.shape, 1), std**2))
    found = identify_modes(table)
    model = found.model().frf(case.f)[..., 0]
    return found.frequencies, found.damping, found.shapes, model, time.process_time() - t


def peer(case: Case, H: Complex, std: float) -> tuple[Real, Real, Complex, Complex, float]:
    """The same by sdypy-EMA (LSCF of order 60, poles nearest to the truth, LSFD with residuals)."""
    from sdypy import EMA

    t = time.process_time()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        job = EMA.Model(H.T, case.f, lower=case.f[0], upper=case.f[-1], pol_order_high=60, frf_type="accelerance")
        job.get_poles(show_progress=False)
        job.select_closest_poles(list(case.frequencies))
        _, shapes = job.get_constants()
    seconds = time.process_time() - t
    unknown = np.full(case.H.shape, np.nan)  # its reconstructed FRFs stand on lines of its own
    return np.asarray(job.nat_freq), np.asarray(job.nat_xi), np.asarray(shapes), unknown, seconds


def errors(case: Case, found: tuple[Real, Real, Complex, Complex, float]) -> Real:
    """Modes missed and added, worst relative errors of frequency and damping, 1 - MAC, error of the FRFs, CPU s."""
    f, z, shapes, H, seconds = found
    width = np.maximum(2 * case.damping * case.frequencies, 0.02 * case.frequencies)
    cost = np.abs(case.frequencies[:, None] - f) / width[:, None]
    from scipy.optimize import linear_sum_assignment

    i, j = linear_sum_assignment(np.minimum(cost, 1e3))
    good = cost[i, j] < 1
    i, j = i[good], j[good]
    mac = np.abs(np.sum(case.shapes[:, i].conj() * shapes[:, j], axis=0)) ** 2
    mac = mac / np.sum(np.abs(case.shapes[:, i]) ** 2, axis=0) / np.sum(np.abs(shapes[:, j]) ** 2, axis=0)
    return np.array([
        len(case.frequencies) - len(i), len(f) - len(j), np.max(np.abs(f[j] / case.frequencies[i] - 1), initial=0),
        np.max(np.abs(z[j] / case.damping[i] - 1), initial=0), np.max(1 - mac, initial=0),
        np.linalg.norm(H - case.H) / np.linalg.norm(case.H), seconds,
    ])  # fmt: skip


def main(noises: int = 5) -> None:
    """Print the table."""
    logging.disable(logging.INFO)
    print(f"mean over {noises} noises of the worst mode; missed and added modes, CPU s of the whole job")
    heads = "".join(f"{x:>10s}" for x in ("f", "damping", "1 - MAC", "FRFs"))
    print(f"{'':38s}{'missed':>7s}{'added':>7s}{heads}{'CPU s':>8s}")
    for case in cases():
        for name, tool in (("loadid", ours), ("sdypy-EMA", peer)):
            try:
                rows = np.array([errors(case, tool(case, *noisy(case, seed))) for seed in range(noises)])
            except ImportError:
                print(f"{case.name:26s}{name:12s} not installed (extra bench)")
                continue
            m = rows.mean(axis=0)
            said = "".join(f"{x:10.1e}" for x in m[2:6])
            print(f"{case.name:26s}{name:12s}{m[0]:7.1f}{m[1]:7.1f}{said}{m[6]:8.2f}")


if __name__ == "__main__":
    main(*(int(x) for x in sys.argv[1:2]))
