"""LayerSensor: CPU time and accuracy beside what a user would take instead.

Run ``python -m tests.benchmarks.layer``. First a field of 1e5 places on an endless gel (h = 3 mm, E = 0.147 MPa, nu =
0.3223) under a shear of 2.5 mm radius, exact from Hankel integrals: cosine and slope of found over true tractions, the
resultant with its std, CPU seconds of ``estimate`` with lambda chosen (minimum of five). Beside it Fourier transform
traction cytometry as it is written by hand: the half-space or the layer, one lambda, no std. Then fewer places of both
sensors that read in-plane motion, the finite-element pad with its own choice of lambda first; and the waves at work on
gaps, a frame and scattered markers, all components seen.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from tactile import Layer, LayerSensor, Markers, MultilayerPad, Pad, Press

GEL = Layer(3e-3, 147e3, 0.3223)
SHEAR = Press(radius=2.5e-3, force=0.0, shear=(0.25, 0.1))
PRESS = Press(radius=2.5e-3, force=1.0, shear=(0.25, 0.1))
SIDE = 24e-3
NOISE = (0.0, 0.01, 0.02, 0.05)


def grid(count: int) -> np.ndarray:
    """Places (count^2, 2) over the window."""
    line = np.linspace(-SIDE / 2, SIDE / 2, count)
    return np.array(np.meshgrid(line, line)).reshape(2, -1).T


def seconds(run: Callable[[], Any], repeat: int = 5) -> tuple[float, Any]:
    """Least CPU seconds of some runs after a first one, and the answer."""
    found, spent = run(), []
    for _ in range(repeat):
        start = time.process_time()
        found = run()
        spent.append(time.process_time() - start)
    return min(spent), found


def by_hand(u: np.ndarray, pitch: float, lam: float, ground: Any) -> np.ndarray:
    """In-plane tractions (n, n, 2) of motion (n, n, 2), by a kernel and Tikhonov's filter, as in papers."""
    n = len(u)
    k = 2 * np.pi * np.fft.fftfreq(n, pitch)
    kx, ky = np.meshgrid(k, k)
    kx[0, 0] = kx[0, 1] if ground is not GEL else 0.0
    G = ground.kernel(kx, ky)[..., :2, :2]
    A = np.swapaxes(G.conj(), -1, -2) @ G + lam**2 * np.abs(G).max() ** 2 * np.eye(2)
    U = np.fft.fft2(u, axes=(0, 1))[..., None]
    t = np.linalg.solve(A, np.swapaxes(G.conj(), -1, -2) @ U)[..., 0]
    return np.fft.ifft2(t, axes=(0, 1)).real


def judged(t: np.ndarray, truth: np.ndarray) -> str:
    """Cosine and slope."""
    a, b = t.ravel(), truth.ravel()
    return f"cosine {a @ b / np.linalg.norm(a) / np.linalg.norm(b):.4f}  slope {a @ b / (b @ b):.3f}"


def large(count: int = 316) -> None:
    """1e5 places, in the plane."""
    points = grid(count)
    u, truth = SHEAR.displacement(GEL, points)[:, :2], SHEAR.traction(points)
    print(f"{len(points)} places, in-plane motion, t_z = 0; noise as a share of the largest motion")
    for share in NOISE:
        sigma = max(share * float(np.abs(u).max()), 1e-9)
        y = u + (share > 0) * sigma * np.random.default_rng(0).standard_normal(u.shape)
        s = LayerSensor(GEL, Markers(points, sigma))
        spent, found = seconds(lambda s=s, y=y: s.estimate(y))
        force = found.resultant()
        print(f"  {share:4.0%}  LayerSensor         {spent:.3f} s  {judged(found.traction(), truth)}  "
              f"Fx {force.value[0]:.4f} +- {force.std[0]:.4f}  {found.choice.rule}")  # fmt: skip
        ridge = LayerSensor(GEL, Markers(points, sigma), penalty="identity").estimate(y)
        print(f"        its ridge, |t|^2             {judged(ridge.traction(), truth)}")
        for name, ground in (("half-space", GEL.half_space), ("layer", GEL)):

            def one(y: np.ndarray = y, lam: float = ridge.choice.lam, ground: Any = ground) -> np.ndarray:
                return by_hand(y.reshape(count, count, 2), SIDE / (count - 1), lam, ground)

            spent, t = seconds(one, 2)
            area = (SIDE / (count - 1)) ** 2
            print(f"        by hand, {name:10s} {spent:.3f} s  {judged(t, truth[:, :2])}  "
                  f"Fx {t[..., 0].sum() * area:.4f}   (no std, lambda of that ridge)")  # fmt: skip


def small() -> None:
    """Both sensors on few places."""
    for h in (3e-3, 1e-3):
        gel = Layer(h, GEL.E, GEL.nu)
        pad = Pad(size=(SIDE, SIDE), thickness=h, E=gel.E, nu=gel.nu, pitch=1e-3, layers=4)
        points = pad.nodes2d[~pad.edge]
        u = SHEAR.displacement(gel, points)[:, :2]
        print(f"{len(points)} places, h = {1e3 * h:g} mm, in-plane motion")
        for share in NOISE:
            sigma = max(share * float(np.abs(u).max()), 1e-9)
            y = u + (share > 0) * sigma * np.random.default_rng(0).standard_normal(u.shape)
            for s in (MultilayerPad(pad, Markers(points, sigma)), LayerSensor(gel, Markers(points, sigma))):
                start = time.process_time()
                found = s.estimate(y)
                spent = time.process_time() - start
                told = judged(found.traction(), SHEAR.traction(found.nodes))
                print(f"  {share:4.0%}  {type(s).__name__:14s} {spent:6.2f} s  {told}  lambda {found.choice.lam:.2g}")


def iterated() -> None:
    """Gaps, a frame and scattered markers, with all components."""
    rng = np.random.default_rng(0)
    points, sigma = grid(81), 3e-6
    lost = rng.random(len(points)) < 0.05
    inside = (-4e-3, -4e-3, 4e-3, 4e-3)
    cases = (
        ("full grid", points, None, None), ("5 % lost", points, lost, None), ("frame", points, None, inside),
        ("scattered", rng.uniform(-SIDE / 2, SIDE / 2, (2000, 2)), None, None),
    )  # fmt: skip
    print(f"motion along X, Y and Z, noise of {1e6 * sigma:g} um, a press of 1 N")
    for name, at, gone, frame in cases:
        y = PRESS.displacement(GEL, at) + sigma * rng.standard_normal((len(at), 3))
        if gone is not None:
            y[gone] = np.nan
        s = LayerSensor(GEL, Markers(at, sigma, "XYZ"), frame=frame)
        spent, found = seconds(lambda s=s, y=y: s.estimate(y), 2)
        force = found.resultant()
        print(f"  {name:10s} {len(at)} places {spent:6.2f} s  {judged(found.traction(), PRESS.traction(found.nodes))}  "
              f"Fz {force.value[2]:.3f} +- {force.std[2]:.3f}")  # fmt: skip


if __name__ == "__main__":
    large()
    small()
    iterated()
