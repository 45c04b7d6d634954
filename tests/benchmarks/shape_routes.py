"""Routes from gauges to the load of a plate: error, coverage of the 95 % band, CPU time.

``python -m tests.benchmarks.shape_routes [field|elements|gauges|random|finer|record|points|clamped|shell]``. The plate
(but for the last two) is simply supported, 1 x 1 m, 5 mm of aluminium; the truth is its series, as means of 12 x 12
patches.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.linalg import eigh

from loadid import FieldDeconvolution, ShapeSensing, StaticInversion
from loadid._inverse.shape import choosing
from loadid._inverse.shape.plate import thin_plate
from loadid._inverse.shape.radial import RadialBasis
from loadid.fullfield import FieldFrames, blocks, virtual_fields
from structures import ForwardModel, bases, plates, sensors

THICK, E, NU, RHO = 5e-3, 70e9, 0.33, 2700.0
D, MASS = E * THICK**3 / 12 / (1 - NU**2), RHO * THICK
PLATE = plates.plate(lengths=(1, 1), thickness=THICK, material=plates.Material(E=E, rho=RHO, nu=NU), elements=12,
                     damping=0.001)  # fmt: skip
LOADS = bases.patches(PLATE, (12, 12))
CASE = np.zeros((12, 12))
CASE[0, 0], CASE[1, 0] = 100.0, 50.0
ORDERS = np.arange(1, 13)
FINE = (np.arange(240) + 0.5) / 240
K2 = np.pi**2 * (ORDERS[:, None] ** 2 + ORDERS**2)


def gauges(count):
    p = np.linspace(0.05, 0.95, count)
    return [sensors.StrainGauge(at=(x, y), fibre=THICK / 2, angle=t, label=f"{x:.3f} {y:.3f} {t:.1f}")
            for y in p for x in p for t in (0.0, np.pi / 2)]  # fmt: skip


def sines(at):
    x, y = np.asarray(at, float)[:, :2].T
    return np.sin(np.pi * np.outer(x, ORDERS)), np.sin(np.pi * np.outer(y, ORDERS))


def pressure(amplitudes, at):
    """Means over patches of 1/12 m about places."""
    mean = np.sinc(ORDERS / 24)
    sx, sy = sines(at)
    return np.einsum("pi,ij,pj->p", sx * mean, amplitudes, sy * mean)


def readings(w, placed):
    """Strains (or deflections) of amplitudes w of the deflection."""
    sx, sy = sines([g.at for g in placed])
    kx, ky = (np.einsum("pi,ij,pj->p", a, w, b) * np.pi**2 * THICK / 2
              for a, b in ((sx * ORDERS**2, sy), (sx, sy * ORDERS**2)))  # fmt: skip
    plain = np.einsum("pi,ij,pj->p", sx, w, sy)
    return np.array([plain[k] if g.quantity != "strain" else kx[k] if g.angle == 0 else ky[k]
                     for k, g in enumerate(placed)])  # fmt: skip


def vanishing(rng):
    """Smooth pressure, correlated over 0.3 to 0.7 m, zero at the edges: on FINE points, x first."""
    sines = np.sin(np.pi * np.outer(FINE, ORDERS))
    return sines @ (rng.standard_normal(K2.shape) * np.exp(-K2 * rng.uniform(0.3, 0.7) ** 2 / 8)) @ sines.T


def smooth(rng):
    """The same, free at the edges."""
    k = np.pi * np.arange(40)
    cosines = np.cos(np.outer(FINE, k))
    return cosines @ (rng.standard_normal((40, 40)) * np.exp(-(k[:, None] ** 2 + k**2) * rng.uniform(0.3, 0.7) ** 2 / 8)) @ cosines.T  # fmt: skip # noqa: E501


def humps(rng, low=0.12, high=0.25):
    """Three to five humps of pressure, pushing or pulling, 0.12 to 0.25 m wide."""
    q = np.zeros((FINE.size, FINE.size))
    for _ in range(rng.integers(3, 6)):
        a, b, width = *rng.uniform(0.2, 0.8, 2), rng.uniform(low, high)
        q += rng.standard_normal() * np.exp(-((FINE[:, None] - a) ** 2 + (FINE - b) ** 2) / 2 / width**2)
    return q


def narrow(rng):
    """Humps 0.04 to 0.07 m wide, which no gauge 0.1 m and more apart resolves."""
    return humps(rng, 0.04, 0.07)


def under(q, placed):
    """Strains under a pressure on FINE points by 80 x 80 sines, and its means on the patches."""
    m = np.arange(1, 81)
    s = np.sin(np.pi * np.outer(FINE, m))
    w = 4 * (s.T @ q @ s) / FINE.size**2 / (D * np.pi**4 * (m[:, None] ** 2 + m**2) ** 2)
    sx, sy = (np.sin(np.pi * np.outer([g.at[k] for g in placed], m)) for k in (0, 1))
    kx, ky = (np.einsum("pi,ij,pj->p", a, w, b) for a, b in ((sx * m**2, sy), (sx, sy * m**2)))
    i, j = (np.floor(np.asarray(LOADS.coordinates)[:, k] * 12).astype(int) for k in (0, 1))
    means = q.reshape(12, FINE.size // 12, 12, FINE.size // 12).mean(axis=(1, 3))
    return np.pi**2 * THICK / 2 * np.where([g.angle == 0 for g in placed], kx, ky), means[i, j]


def judged(name, family, cases, dt=None):
    """One row of a table: cases are (readings, truth)."""
    start, errors, inside, told = time.process_time(), [], [], []
    for y, q in cases:
        found = family.estimate(y) if dt is None else family.estimate(y, dt)
        errors.append(np.linalg.norm(found.load - q) / np.linalg.norm(q))
        inside.append(np.mean(np.abs(found.load - q) <= 1.96 * found.std))
        told.append("W320" in found.codes)
    cost = (time.process_time() - start) / len(cases)
    print(f"  {name:34s} error {np.median(errors):6.3f} (worst {max(errors):.3f})   in the band {np.mean(inside):.3f}"
          f"   detail told {np.mean(told):4.0%}   {cost:6.2f} CPU s", flush=True)  # fmt: skip


def routes(placed, level):
    model = ForwardModel(PLATE, placed, LOADS)
    return {
        "ShapeSensing": ShapeSensing(PLATE, placed, loads=LOADS, noise=level),
        "ShapeSensing, robust GCV": ShapeSensing(PLATE, placed, loads=LOADS, noise=level, choice="robust_gcv"),
        "ShapeSensing, discrepancy": ShapeSensing(PLATE, placed, loads=LOADS, noise=level, choice="discrepancy"),
        "StaticInversion, Laplacian": StaticInversion(model, penalty="laplacian", noise=level),
    }


def static(placed, level_of, amplitudes, rng, only=None):
    cases = []
    for A in amplitudes:
        y = readings(A / (D * K2**2), placed)
        scale = np.abs(y).max()
        cases.append((y / scale + level_of * rng.standard_normal(len(y)), pressure(A, LOADS.coordinates) / scale))
    for name, family in routes(placed, max(level_of, 1e-9)).items():
        if only in (None, name):
            judged(name, family, cases)


def by_elements(family, y, level):
    """Pressure (loads,) and its std by the fit to every DOF of `field` that carries their covariance.

    Of the whitened DOFs: ``gain = U s V^T``, and ``U s^-1`` turns DOFs to as many readings as there are gauges.
    """
    field = family.field(y)
    gain = field.gain
    U, s, _ = np.linalg.svd(gain, full_matrices=False)
    white = U.T / s[:, None] / level
    paths = choosing.paths([white @ (gain @ rows) for rows in family.posed.gauges], (white @ field.values)[None], None)
    chosen = choosing.chosen(paths, None, sigma=1.0, source="stated")
    found = choosing.spread(chosen, [rows[0] for rows in family.posed.loads], 1.0)
    return found.mean[0], np.sqrt(np.sum(found.root**2, axis=1) + found.apart[0] ** 2 + found.hidden[0] ** 2)


def elements():
    """The two waves through inverse finite elements, 12 x 12 of them."""
    for count, level, row in ((10, 0.01, 0.050), (10, 0.05, 0.250), (6, 0.01, 0.084), (6, 0.05, 0.419)):
        placed, rng, errors, inside = gauges(count), np.random.default_rng(500), [], []
        family = ShapeSensing(PLATE, placed, loads=LOADS, noise=level)
        y = readings(CASE / (D * K2**2), placed)
        y, q = y / np.abs(y).max(), pressure(CASE, LOADS.coordinates) / np.abs(y).max()
        for _ in range(10):
            load, std = by_elements(family, y + level * rng.standard_normal(len(y)), level)
            errors.append(np.linalg.norm(load - q) / np.linalg.norm(q))
            inside.append(np.mean(np.abs(load - q) <= 1.96 * std))
        print(f"through elements, {count} x {count} stations, noise {level:g}: error {np.median(errors):.3f}, "
              f"in the band {np.mean(inside):.3f}; 1.5 times the row of 4 x 4 true modes {1.5 * row:.3f}")  # fmt: skip


def field():
    """Deflections at 21 x 21 nodes, the edges among them, at 10 Hz; scored at 23 x 23 points."""
    p, at, omega = np.linspace(0, 1, 21), np.linspace(0.04, 0.96, 23), 2 * np.pi * 10
    thin = thin_plate(PLATE, moving=False)
    x, y = np.tile(p, 21), np.repeat(p, 21)
    points = np.column_stack([np.tile(at, 23), np.repeat(at, 23)])
    w, q = (np.einsum("pi,ij,pj->p", a, A, b) for A, (a, b) in (
        (CASE / (D * K2**2 - MASS * omega**2), sines(np.column_stack([x, y]))), (CASE, sines(points))))  # fmt: skip
    w, q = w / np.abs(w).max(), q / np.abs(w).max()
    functions = [RadialBasis((1.0, 1.0), "SSSS", 2 ** (k / 4)) for k in range(9)]
    rows = [f.rows(x, y) for f in functions]
    out = [r - omega**2 * a for r, _, a in (thin.load_rows(f, points) for f in functions)]
    for level, goal in ((0.0, 0.01), (1e-4, 0.02), (1e-3, 0.06), (1e-2, 0.15)):
        errors, inside = [], []
        for seed in range(3):
            noisy = w + level * np.random.default_rng(seed).standard_normal(len(w))
            chosen = choosing.chosen(choosing.paths(rows, noisy[None], None), None, sigma=max(level, 1e-9),
                                     source="stated")  # fmt: skip
            found = choosing.spread(chosen, out, max(level, 1e-9))
            std = np.sqrt(np.sum(found.root**2, axis=1) + found.apart[0] ** 2 + found.hidden[0] ** 2)
            errors.append(np.linalg.norm(found.mean[0] - q) / np.linalg.norm(q))
            inside.append(np.mean(np.abs(found.mean[0] - q) <= 1.96 * std))
        print(f"deflections at 10 Hz, noise {level:g}: error {np.median(errors):.4f} (worst {max(errors):.4f}), "
              f"in the band {np.mean(inside):.3f}; goal {goal}", flush=True)  # fmt: skip


def table():
    """Strains at 10 x 10 and 6 x 6 stations."""
    for count, level, row in ((10, 0.01, 0.050), (10, 0.05, 0.250), (6, 0.01, 0.084), (6, 0.05, 0.419)):
        print(f"{count} x {count} stations, noise {level:g}; least squares with 4 x 4 true modes {row}")
        static(gauges(count), level, [CASE] * 5, np.random.default_rng(100))


def random(seed=4000, draws=16):
    """Random loads of four kinds, and how many are told to have detail between the gauges (W320)."""
    for kind in (vanishing, smooth, humps, narrow):
        for count, level in ((6, 0.0), (6, 1e-4), (6, 1e-3), (6, 0.02), (10, 1e-3), (10, 0.02)):
            rng, placed, cases = np.random.default_rng(seed), gauges(count), []
            for _ in range(draws):
                y, q = under(kind(rng), placed)
                scale = np.abs(y).max()
                cases.append((y / scale + level * rng.standard_normal(len(y)), q / scale))
            family = ShapeSensing(PLATE, placed, loads=LOADS, noise=max(level, 1e-9))
            judged(f"{kind.__name__}, {count} x {count}, {level:g}", family, cases)


def finer(seed=6000, draws=8):
    """The same under strains of 32 x 32 elements, which err by some 0.1 to 0.5 % themselves."""
    mesh = plates.plate(lengths=(1, 1), thickness=THICK, material=plates.Material(E=E, rho=RHO, nu=NU), elements=32)
    fine, placed = bases.patches(mesh, (60, 60)), gauges(6)
    H = ForwardModel(mesh, placed, fine).static()
    i, j = (np.floor(np.asarray(fine.coordinates)[:, k] * 60).astype(int) for k in (0, 1))
    for kind in (vanishing, smooth, humps):
        for level in (1e-3, 0.02):
            rng, cases, apart = np.random.default_rng(seed), [], []
            for _ in range(draws):
                q = kind(rng)
                exact, means = under(q, placed)
                y = H @ q.reshape(60, 4, 60, 4).mean(axis=(1, 3))[i, j]
                apart.append(np.linalg.norm(y - exact) / np.linalg.norm(exact))
                scale = np.abs(y).max()
                cases.append((y / scale + level * rng.standard_normal(len(y)), means / scale))
            family = ShapeSensing(PLATE, placed, loads=LOADS, noise=level)
            judged(f"finer elements ({np.mean(apart):.2%} off), {kind.__name__}, {level:g}", family, cases)


def record(samples=150):
    """The load of the case at 10 Hz, sampled at 500 Hz."""
    placed, dt, omega = gauges(6), 2e-3, 2 * np.pi * 10
    t = dt * np.arange(samples)
    y = np.cos(omega * t)[:, None] * readings(CASE / (D * K2**2 - MASS * omega**2), placed)
    q = np.cos(omega * t)[:, None] * pressure(CASE, LOADS.coordinates)
    level = 0.05 * np.abs(y).max()
    y = y + level * np.random.default_rng(9).standard_normal(y.shape)
    print(f"record of {samples} samples, 6 x 6 stations, noise 0.05")
    model = ForwardModel(PLATE, placed, LOADS, modes=30)
    judged("ShapeSensing", ShapeSensing(PLATE, placed, loads=LOADS, noise=level), [(y, q)], dt)
    other = FieldDeconvolution(model, space="laplacian", time="identity", noise=level)
    judged("FieldDeconvolution, Laplacian", other, [(y, q)], dt)


def clamped():
    """A clamped plate, 0.3 x 0.3 m, under a uniform blow: 16 x 16 elements, all modes, exact between the corners."""
    side, count, peak = 0.3, 61, 1e5
    steel = plates.Material(E=210e9, rho=7700.0, nu=0.33)
    plate = plates.plate(lengths=(side, side), thickness=5e-3, material=steel, elements=16, edges="CCCC")
    K, M = (A.toarray()[np.ix_(plate.free, plate.free)] for A in (plate.K, plate.M))
    force = bases.patches(plate, (1, 1)).matrix.toarray()[plate.free, 0]
    square, shapes = eigh(K, M)
    omega = np.sqrt(square)
    x = np.linspace(0, side, count)
    rows = np.array([plate.field.motion((a, b), 3) for b in x for a in x])[:, plate.free] @ shapes
    corners, ramp, dt = np.array([0, 5e-5, 1e-4, 3e-4]), np.array([0, 0, peak, 0]), 4e-6
    bend = np.diff(np.r_[0, np.diff(ramp) / np.diff(corners), 0])
    t = dt * np.arange(1, 80)
    after = np.maximum(t[:, None, None] - corners, 0) * np.ones((len(omega), 1))
    u = np.sum(bend * (after - np.sin(omega[:, None] * after) / omega[:, None]), axis=2) / square * (shapes.T @ force)
    a = np.sum(bend * np.sin(omega[:, None] * after) / omega[:, None], axis=2) * (shapes.T @ force)
    w, pull = ((v @ rows.T).reshape(-1, count, count) for v in (u, a))
    truth = np.interp(t, corners, ramp)
    for share in (0.0, 0.01):
        rng = np.random.default_rng(8)
        data, rate = (v + share * np.abs(v).max() * rng.standard_normal(v.shape) for v in (w, pull))
        ways = {
            "acceleration given": FieldFrames(data, "deflection", (x[1], x[1]), rate),
            "acceleration of the frames": FieldFrames(data, "deflection", (x[1], x[1]), dt=dt),
        }
        for name, field in ways.items():
            found = virtual_fields(field, plate)
            wrong = np.abs(found.pressure[:, count // 2, count // 2] - truth)[4:-4] / peak
            rms = np.sqrt(np.mean(wrong**2))
            print(f"clamped, noise {share:g}, {name}: middle {rms:.4f} rms of the peak, "
                  f"{wrong.max():.4f} at most, std {np.median(found.std) / peak:.4f}, {found.window}")  # fmt: skip


def shell():
    """The same blow on the shell elements of CalculiX, 60 x 60 of them, read at their nodes, where `ccx` is there.

    By the trapezoidal rule, second differences of three deflections are the mean of three accelerations with weights
    1, 2, 1: with the same means of deflection and pressure they obey the equations of motion of the mesh.
    """
    ccx = shutil.which("ccx")
    if ccx is None:
        print("shell: no CalculiX on this machine")
        return
    n, side, peak, dt, steps = 60, 0.3, 1e5, 4e-6, 80
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "plate.inp").write_text(_deck(n, side, peak, dt, steps))
        subprocess.run([ccx, "plate"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        rows = [line.split() for line in Path(folder, "plate.dat").read_text().splitlines()]
    u = np.array([float(row[3]) for row in rows if len(row) == 4]).reshape(steps, n + 1, n + 1)
    u = np.concatenate([0 * u[:1], u]) * np.sign(u[-1, n // 2, n // 2])
    q = np.interp(dt * np.arange(steps + 1), [0, 5e-5, 1e-4, 3e-4], [0, 0, peak, 0])
    w, truth = ((v[2:] + 2 * v[1:-1] + v[:-2]) / 4 for v in (u, q))
    rate = (u[2:] - 2 * u[1:-1] + u[:-2]) / dt**2
    steel = plates.Material(E=210e9, rho=7700.0, nu=0.33)
    plate = plates.plate(lengths=(side, side), thickness=5e-3, material=steel, elements=8, edges="CCCC")
    for share in (0.0, 0.01):
        for given in (True, False):
            errors, inside = [], []
            for seed in range(5 if share else 1):
                rng = np.random.default_rng(20 + seed)
                data, pull = (v + share * np.abs(v).max() * rng.standard_normal(v.shape) for v in (w, rate))
                more = {"acceleration": pull} if given else {"dt": dt}
                found = virtual_fields(FieldFrames(data, "deflection", (side / n,) * 2, **more), plate)
                wrong = found.pressure[:, n // 2, n // 2] - truth
                errors.append(np.sqrt(np.mean(wrong[4:-4] ** 2)) / peak)
                inside.append(np.mean(np.abs(wrong) <= 1.96 * np.hypot(found.std, found.bias)))
            of = "given" if given else "of the frames"
            print(
                f"CalculiX, noise {share:g}, acceleration {of}: middle "
                f"{np.mean(errors):.4f} rms of the peak, in the band {np.mean(inside):.2f}, {found.window}"
            )


def _deck(n, side, peak, dt, steps):
    """Input of CalculiX: clamped shell, pressure that rises and falls."""
    node = lambda i, j: j * (n + 1) + i + 1  # noqa: E731
    places = [(i, j) for j in range(n + 1) for i in range(n + 1)]
    lines = ["*NODE, NSET=ALL", *(f"{node(i, j)},{side * i / n:.9g},{side * j / n:.9g},0." for i, j in places)]
    lines += ["*ELEMENT, TYPE=S4, ELSET=SHELL"]
    lines += [f"{j * n + i + 1},{node(i, j)},{node(i + 1, j)},{node(i + 1, j + 1)},{node(i, j + 1)}"
              for j in range(n) for i in range(n)]  # fmt: skip
    lines += ["*NSET, NSET=EDGE", *(f"{node(i, j)}," for i, j in places if {i, j} & {0, n})]
    lines += ["*MATERIAL, NAME=STEEL", "*ELASTIC", "210e9,0.33", "*DENSITY", "7700."]
    lines += ["*SHELL SECTION, ELSET=SHELL, MATERIAL=STEEL", "5e-3", "*BOUNDARY", "EDGE,1,6", "*AMPLITUDE, NAME=BLOW"]
    lines += ["0.,0.,5e-5,0.,1e-4,1.,3e-4,0.", "1e-3,0.", f"*STEP, INC={10 * steps}", "*DYNAMIC, DIRECT, ALPHA=0."]
    lines += [
        f"{dt},{dt * steps}",
        "*DLOAD, AMPLITUDE=BLOW",
        f"SHELL,P,{peak}",
        "*NODE PRINT, NSET=ALL",
        "U",
        "*END STEP",
    ]
    return "\n".join(lines) + "\n"


def points(count=1000):
    """CPU seconds of one frame of 10^6 points by virtual fields, and of all of them by their blocks."""
    x = np.linspace(0, 1, count)
    w = np.outer(np.sin(np.pi * x), np.sin(2 * np.pi * x))
    w = 1e-3 * (w + 0.01 * np.random.default_rng(0).standard_normal(w.shape))
    one, rate = (w[None], -(2e2**2) * w[None])
    ways = {
        "a frame": lambda: virtual_fields(FieldFrames(one, "deflection", (x[1], x[1])), PLATE),
        "with its acceleration": lambda: virtual_fields(FieldFrames(one, "deflection", (x[1], x[1]), rate), PLATE),
        "its blocks": lambda: blocks(FieldFrames(one, "deflection", (x[1], x[1]))),
    }
    for name, way in ways.items():
        way()
        took = []
        for _ in range(3):
            start = time.process_time()
            way()
            took.append(time.process_time() - start)
        print(f"{count**2} points, {name}: {min(took):.2f} CPU s")
    placed, means, level = blocks(FieldFrames(one, "deflection", (x[1], x[1])))
    start = time.process_time()
    family = ShapeSensing(PLATE, placed, noise=level)
    family.estimate(means[0])
    first = time.process_time() - start
    start = time.process_time()
    family.estimate(means[0])
    print(f"their shape: {first:.2f} CPU s the first time, {time.process_time() - start:.2f} after it")


PARTS = {"field": field, "elements": elements, "gauges": table, "random": random, "finer": finer, "record": record,
         "points": points, "clamped": clamped, "shell": shell}  # fmt: skip
if __name__ == "__main__":
    for part in sys.argv[1:] or PARTS:
        PARTS[part]()
