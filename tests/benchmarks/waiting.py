"""What users wait for: whole jobs, by the public call or the command line, beside what they would take instead.

Run as ``python -m tests.benchmarks.waiting [JOB ...]``; without names all of them, in about a quarter of an hour;
``growth`` prints how the time of a deconvolution grows with samples, sensors and loads. CPU seconds of the process
and its children, the BLAS threads as the environment has them, on the default install. Every job runs in a process of
its own, once on a record of its own to have its loops compiled, then on another record (*first*) and a third one
(*again*: what is kept of a model counts). The alternative has the same data and, where it knows none, the lambda that
the job chose; it gives a load without std (filterpy has one), rules or verdict.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid import (
    Deconvolution,
    LoadTracker,
    LocationSearch,
    Noise,
    Penalty,
    SparseDeconvolution,
    StaticInversion,
    recommend,
)
from loadid._commands import demo
from loadid.cli import main as command
from loadid.constraints import FrictionCone, NonNegative, Resultant
from structures import ForwardModel, ImpulseModel, MatrixModel, beams, damping, loads, sensors
from tests.benchmarks.constrained import patch
from tests.tracked import bm2

Array = NDArray[Any]
Job = Callable[[int], Any]
Other = Callable[[int, Any], object]


def spent() -> float:
    """CPU seconds of this process and its children."""
    own, other = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + other.ru_utime + other.ru_stime


def noisy(clean: Array, seed: int, share: float = 0.02) -> Array:
    """With white noise on each channel."""
    rng = np.random.default_rng(seed)
    return clean + share * np.sqrt(np.mean(clean**2, axis=0)) * rng.standard_normal(clean.shape)


def by_fft(h: Array, y: Array, lam: float) -> object:
    """LSQR over FFT products with an impulse response (samples, sensors) and one load, at one absolute lambda."""
    from scipy.fft import irfft, rfft
    from scipy.sparse.linalg import LinearOperator, lsqr

    n, m = y.shape
    H = rfft(h, 2 * n, axis=0)

    def out(g: Array) -> Array:
        return irfft(H * rfft(g, 2 * n)[:, None], axis=0)[:n].ravel()

    def back(r: Array) -> Array:
        return irfft((H.conj() * rfft(r.reshape(n, m), 2 * n, axis=0)).sum(axis=1))[:n]

    return lsqr(LinearOperator((n * m, n), matvec=out, rmatvec=back), y.ravel(), damp=lam, atol=1e-8, btol=1e-8)


# -- jobs --------------------------------------------------------------------------------------------------------------
def demonstration() -> tuple[Job, None]:
    """`loadid demo`: three accelerometers x 6000 samples, one hit, to report and pictures."""

    def job(k: int) -> None:
        with tempfile.TemporaryDirectory() as folder, redirect_stdout(StringIO()):
            assert command(["demo", "--out", folder]) == 0

    return job, None


@cache
def long_beam() -> ForwardModel:
    """A cantilever of 14 modes with three accelerometers."""
    structure = beams.cantilever(elements=30, damping=damping.Modal(0.01), length=1.5, EI=800.0, mass_per_length=3.0)
    seen = [sensors.Accelerometer(f"{node}+Z") for node in (9, 17, 26)]
    return ForwardModel(structure, seen, [loads.Point("21+Z", label="hit")], modes=14)


def hits(samples: int, seed: int) -> Array:
    """A half sine of 41 samples every 4000, (samples, 1)."""
    g = np.zeros((samples, 1))
    for start in range(500 + 37 * seed, samples - 50, 4000):
        g[start : start + 41, 0] = 100 * np.sin(np.pi * np.arange(41) / 40)
    return g


def many_samples() -> tuple[Job, Other]:
    """A beam of 14 modes, three accelerometers, 30 000 samples, rules and std."""
    model, dt, n = long_beam(), 1e-4, 30_000
    inversion = Deconvolution(model)

    def record(k: int) -> Array:
        return noisy(model.predict(hits(n, k), dt), k, 0.05)

    def other(k: int, found: Any) -> object:
        h = model.impulse_response(dt, n, model.default_hold)[:, :, 0]
        return by_fft(h, record(k), 0.01 * float(np.abs(np.fft.rfft(h, axis=0)).max()))

    return (lambda k: inversion.estimate(record(k), dt)), other


def simulated_demo() -> tuple[Job, Other]:
    """The estimate of the demo alone: three accelerometers x 6000 samples, the default prior of local variance."""
    model = demo.model()
    inversion = Deconvolution(model)

    def other(k: int, found: Any) -> object:
        record = demo.simulate(k).record
        h = model.impulse_response(record.dt, len(record.values), model.default_hold)[:, :, 0]
        return by_fft(h, record.values, 0.01 * float(np.abs(np.fft.rfft(h, axis=0)).max()))

    return (lambda k: inversion.estimate(demo.simulate(k).record)), other


def missing() -> tuple[Job, Other]:
    """20 of 1024 samples missing; the alternative is the same record without gaps, by ours."""
    model, dt = long_beam(), 1e-4
    inversion = Deconvolution(model)

    def job(k: int, gaps: bool = True) -> Any:
        y = noisy(model.predict(hits(1024, k), dt), k, 0.05)
        if gaps:
            y[300:320] = np.nan
        return inversion.estimate(y, dt)

    return job, lambda k, found: job(k, False)


def identified() -> tuple[Job, None]:
    """`loadid identify` with a report: CSV of 10 s at 10 kHz, three channels."""
    model, dt, n = long_beam(), 1e-4, 100_000

    def job(k: int) -> None:
        with tempfile.TemporaryDirectory() as place, redirect_stdout(StringIO()):
            folder = Path(place)
            model.save(folder / "model.h5")
            y = noisy(model.predict(hits(n, k), dt), k, 0.05)
            head = ",".join(["time [s]", *(f"{channel.label} [m/s^2]" for channel in model.sensors)])
            np.savetxt(folder / "log.csv", np.column_stack([np.arange(n) * dt, y]), delimiter=",", header=head,
                       comments="")  # fmt: skip
            words = ["identify", str(folder / "log.csv"), "--model", str(folder / "model.h5"), "-o",
                     str(folder / "out.h5"), "--report", str(folder / "out.html")]  # fmt: skip
            assert command(words) == 0

    return job, None


def surface(sensors_: int, patches: int, seed: int) -> tuple[Array, Array]:
    """A compliant surface and what its sensors read under two fingertips."""
    x, at, t = (np.arange(patches) + 0.5) / patches, (np.arange(sensors_) + 0.5) / sensors_, 0.05
    H = t / np.pi / (t**2 + (at[:, None] - x) ** 2) / patches
    g = sum(np.exp(-((x - c - 0.01 * seed) ** 2) / 0.002) for c in (0.35, 0.65))
    return H, noisy((H @ g)[:, None], seed, 0.01)[:, 0]


def pressing(sensors_: int, patches: int, given: bool) -> tuple[Job, Other]:
    """A static load that only presses."""
    H = surface(sensors_, patches, 0)[0]
    choice: Any = 1e-2 if given else None
    inversion = StaticInversion(MatrixModel(H), constraints=[NonNegative()], choice=choice)

    def other(k: int, found: Any) -> object:
        from scipy.optimize import nnls

        lam = found.choice.lam * found.choice.scale
        whole = np.vstack([H, lam * np.eye(patches)])
        return nnls(whole, np.r_[surface(sensors_, patches, k)[1], np.zeros(patches)], maxiter=100 * patches)

    return (lambda k: inversion.estimate(surface(sensors_, patches, k)[1])), other


def constrained(
    H: Array, y: Callable[[int], Array], constraints: list[Any], penalty: str = "identity"
) -> tuple[Job, Other]:
    """Static inversion under constraints, beside the same program handed to clarabel as it stands."""
    inversion = StaticInversion(MatrixModel(H), penalty=penalty, constraints=constraints)

    def other(k: int, found: Any) -> object:
        n = H.shape[1]
        L = np.eye(n) if penalty == "identity" else np.diff(np.eye(n), axis=0)
        return by_clarabel(H, y(k), found.choice.lam * found.choice.scale * L, constraints)

    return (lambda k: inversion.estimate(y(k))), other


def by_clarabel(H: Array, y: Array, L: Array, constraints: list[Any]) -> object:
    """``min |H g - y|^2 + |L g|^2`` under signs, resultants or cones, residuals and differences as unknowns."""
    import clarabel
    import scipy.sparse as sp

    rows, n = sp.csc_matrix(np.vstack([H, L])), H.shape[1]
    m = rows.shape[0]
    A, b, kinds = [sp.hstack([rows, -sp.identity(m)])], [np.r_[y, np.zeros(len(L))]], [clarabel.ZeroConeT(m)]
    for c in constraints:
        if isinstance(c, NonNegative):
            part, value, kind = -sp.identity(n), np.zeros(n), [clarabel.NonnegativeConeT(n)]
        elif isinstance(c, Resultant):
            part, value, kind = sp.csc_matrix(c.C), np.asarray(c.value), [clarabel.ZeroConeT(len(c.C))]
        else:
            order = np.asarray(c.contacts)[:, [2, 0, 1]].ravel()
            size = np.tile([float(np.ravel(c.mu)[0]), 1.0, 1.0], n // 3)
            part, value = -(sp.diags(size) @ sp.identity(n, format="csr")[order]), np.zeros(n)
            kind = [clarabel.SecondOrderConeT(3)] * (n // 3)
        A.append(sp.hstack([part, sp.csc_matrix((part.shape[0], m))]))
        b.append(value)
        kinds += kind
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    P = sp.block_diag([sp.csc_matrix((n, n)), sp.identity(m)], format="csc")
    stack = sp.vstack(A, format="csc")
    return clarabel.DefaultSolver(P, np.zeros(n + m), stack, np.concatenate(b), kinds, settings).solve()


def pressed(what: str) -> tuple[Job, Other]:
    """60 readings of 1000 loads: a sign and a smooth prior, or one resultant that is known."""
    H = surface(60, 1000, 0)[0]
    if what == "smooth":
        return constrained(H, lambda k: surface(60, 1000, k)[1], [NonNegative()], "gradient")
    return constrained(H, lambda k: surface(60, 1000, k)[1], [Resultant(np.ones((1, 1000)), [159.0])])


def cones() -> tuple[Job, Other]:
    """1000 contacts with friction under 40 markers."""
    H, y = patch(1000, 3)
    return constrained(H[:120], lambda k: y[k, :120], [FrictionCone(0.5, np.arange(3000).reshape(-1, 3))])


def pushes() -> tuple[Job, Other]:
    """README's record of 4000 samples, loads that only push."""
    h, dt = impulse()
    inversion = Deconvolution(ImpulseModel(h, dt, kind="held"), constraints=[NonNegative()])

    def other(k: int, found: Any) -> object:
        return by_fft(h[:, 0], pushed(k), found.choice.lam * found.choice.scale)

    return (lambda k: inversion.estimate(pushed(k), dt)), other


def spikes() -> tuple[Job, None]:
    """The same record, sparse."""
    h, dt = impulse()
    inversion = SparseDeconvolution(ImpulseModel(h, dt, kind="held"))
    return (lambda k: inversion.estimate(pushed(k), dt)), None


@cache
def impulse() -> tuple[Array, float]:
    """A decaying oscillation, (samples, 1, 1), and its step."""
    t = np.arange(4000) * 1e-3
    return (np.exp(-8 * t) * np.sin(2 * np.pi * 30 * t) * 1e-3)[:, None, None], 1e-3


def pushed(seed: int) -> Array:
    """Three pushes, 2 % noise, (samples, 1)."""
    h, g = impulse()[0][:, 0, 0], np.zeros(4000)
    for start in (400, 1700, 2900):
        g[start + seed : start + seed + 60] = 50 * np.sin(np.pi * np.arange(60) / 59)
    return noisy(np.convolve(h, g)[:4000, None], seed)


def million() -> tuple[Job, Other]:
    """1e6 samples, one sensor, one load, 12 states, rules and std, sigma stated."""
    structure = beams.cantilever(elements=12, damping=damping.Modal(0.02), length=1.5, EI=800.0, mass_per_length=3.0)
    model = ForwardModel(structure, [sensors.Displacement("9+Z")], [loads.Point("12+Z")], modes=6)
    dt, n = 1e-3, 1_000_000

    def record(k: int) -> tuple[Array, float]:
        rng = np.random.default_rng(k)
        clean = model.predict(np.cumsum(rng.standard_normal((n, 1)), axis=0), dt)
        sigma = 0.02 * float(np.std(clean))
        return clean + sigma * rng.standard_normal(clean.shape), sigma

    def job(k: int) -> Any:
        y, sigma = record(k)
        return Deconvolution(model, noise=Noise(sigma)).estimate(y, dt)

    def other(k: int, found: Any) -> object:
        h = model.impulse_response(dt, n, model.default_hold)[:, :, 0]
        return by_fft(h, record(k)[0], found.choice.lam * found.choice.scale)

    return job, other


@cache
def struck() -> tuple[ForwardModel, float]:
    """A cantilever with one accelerometer, and the step of its records."""
    structure = beams.cantilever(elements=12, damping=damping.Modal(0.01), length=1.5, EI=800.0, mass_per_length=3.0)
    return ForwardModel(structure, [sensors.Accelerometer("12+Z")], [loads.Point("12+Z", label="hit")], modes=8), 1e-4


def hit(k: int) -> Array:
    """Its record of 4000 samples, one hit, 2 % noise."""
    model, dt = struck()
    return noisy(model.predict(hits(4000, k), dt), k)


def located() -> tuple[Job, Other]:
    """README's search for the place, beside one estimate at one place."""
    model, dt = struck()
    search = LocationSearch(model.with_loads([loads.Point(at=x) for x in (0.6, 0.9, 1.2, 1.5)]))
    return (lambda k: search.estimate(hit(k), dt)), lambda k, found: Deconvolution(model).estimate(hit(k), dt)


def recommended() -> tuple[Job, Other]:
    """Which of the priors fits, beside one of the fits that it compares."""
    model, dt = struck()
    one = SparseDeconvolution(model, dictionary="bspline")
    return (lambda k: recommend(model, hit(k), dt)), lambda k, found: one.estimate(hit(k), dt)


def million_by_three() -> tuple[Job, None]:
    """1e6 samples, three accelerometers, 14 modes, rules and std, sigma stated; LSQR takes over ten minutes."""
    model, dt, n = long_beam(), 1e-4, 1_000_000
    clean = model.predict(hits(n, 0), dt)
    sigma = 0.05 * np.std(clean, axis=0)
    inversion = Deconvolution(model, noise=Noise(sigma))
    return (
        lambda k: inversion.estimate(clean + sigma * np.random.default_rng(k).standard_normal(clean.shape), dt)
    ), None


@cache
def followed(samples: int) -> tuple[Any, list[Array]]:
    """A tracker of a building, fitted with its gate and its watch, and what its four sensors read afterwards."""
    case = bm2("matern", 0, samples=samples + 4000, fine=4)
    tracker = LoadTracker(case.setup.space("foh"), noise=case.noise).fit(case.y[:4000], case.dt)
    rng = np.random.default_rng(0)
    return tracker, [case.y[4000:] + 0.1 * case.noise * rng.standard_normal((samples, 4)) for _ in range(3)]


def by_filterpy(tracker: Any, y: Array) -> tuple[Array, Array]:
    """Load and std of samples (samples, sensors), rows of missing channels left out."""
    f = tracker.to_filterpy()
    Cp, H, R = tracker.fitted.model.Cp, np.array(f.H), np.array(f.R)
    load, std = np.empty(len(y)), np.empty(len(y))
    for k, (row, there) in enumerate(zip(y, np.isfinite(y), strict=True)):
        if k:
            f.predict()
        if there.any():
            f.update(row[there], R=R[np.ix_(there, there)], H=H[there])
        load[k], std[k] = (Cp @ f.x)[0], np.sqrt((Cp @ f.P @ Cp.T)[0, 0])
    return load, std


def streamed() -> tuple[Job, Other]:
    """`loadid track` from CSV to CSV, 100 000 rows with time stamps: ten times the CPU s are microseconds a row."""
    n, place = 100_000, tempfile.TemporaryDirectory()
    tracker, records = followed(n)
    folder = Path(place.name)
    tracker.reset()
    tracker.save(folder / "tracker.h5")
    for k, y in enumerate(records):
        head = ",".join(["time [s]", *(f"{c.label} [{c.unit}]" for c in tracker.fitted.sensors)])
        np.savetxt(folder / f"{k}.csv", np.column_stack([np.arange(n) * tracker.fitted.dt, y]), delimiter=",",
                   fmt="%.9g", header=head, comments="")  # fmt: skip

    def job(k: int) -> None:
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            words = {"--model": "tracker.h5", "--in": f"{k}.csv", "--out": f"{k}.out", "--state": f"{k}.h5"}
            named = [word for name, file in words.items() for word in (name, str(Path(place.name) / file))]
            assert command(["track", *named, "--idle", "0"]) == 0

    def other(k: int, found: Any) -> None:
        t, y = np.split(np.loadtxt(folder / f"{k}.csv", delimiter=",", skiprows=1), [1], axis=1)
        np.savetxt(folder / "other", np.column_stack([t, *by_filterpy(tracker, y)]), delimiter=",", fmt="%.17g")

    return job, other


def holed(share: float) -> tuple[Job, Other]:
    """20 000 samples, some cells missing at random: fifty times the CPU s are microseconds a sample."""
    tracker, records = followed(20_000)
    rng = np.random.default_rng(0)
    records = [np.where(rng.random(y.shape) < share, np.nan, y) for y in records]

    def job(k: int) -> Any:
        tracker.reset()
        return tracker.run(records[k])

    return job, lambda k, found: by_filterpy(tracker, records[k])


JOBS: dict[str, tuple[Callable[[], tuple[Job, Other | None]], str, str]] = {
    "demo": (demonstration, "loadid demo", ""),
    "demo estimate": (simulated_demo, "its estimate, 3 x 6000", "LSQR over FFTs, one lambda"),
    "30 000": (many_samples, "beam of 14 modes, 3 x 30 000", "LSQR over FFTs, one lambda"),
    "identify": (identified, "identify with report, 3 x 100 000", ""),
    "missing": (missing, "20 of 1024 samples missing", "the same without gaps"),
    "pressing": (lambda: pressing(60, 1000, False), "static, only presses, 60 x 1000", "SciPy nnls, that lambda"),
    "pressing, given": (lambda: pressing(60, 1000, True), "the same, lambda given", "SciPy nnls, that lambda"),
    "pressing, small": (lambda: pressing(6, 3, False), "the same, 6 x 3", "SciPy nnls, that lambda"),
    "pressing, large": (lambda: pressing(120, 3000, False), "the same, 120 x 3000", "SciPy nnls, that lambda"),
    "pressing, smooth": (lambda: pressed("smooth"), "the same, 60 x 1000, gradient", "clarabel, that lambda"),
    "resultant": (lambda: pressed("resultant"), "static, one resultant, 60 x 1000", "clarabel, that lambda"),
    "cones": (cones, "static, 1000 cones, 120 x 3000", "clarabel, that lambda"),
    "pushes": (pushes, "4000 samples, only pushes", "LSQR over FFTs, that lambda, no sign"),
    "spikes": (spikes, "4000 samples, sparse", ""),
    "location": (located, "4000 samples, place of one hit", "one estimate at one place"),
    "recommend": (recommended, "4000 samples, which prior", "one sparse estimate"),
    "million": (million, "1e6 samples, 12 states", "LSQR over FFTs, that lambda"),
    "million, three": (million_by_three, "3 x 1e6 samples, 28 states", ""),
    "track": (streamed, "track, CSV to CSV, 4 x 100 000", "loadtxt, filterpy, savetxt"),
    "track, 1 %": (lambda: holed(0.01), "track, 1 % missing, 4 x 20 000", "filterpy"),
    "track, 10 %": (lambda: holed(0.1), "track, 10 % missing, 4 x 20 000", "filterpy"),
    "track, 30 %": (lambda: holed(0.3), "track, 30 % missing, 4 x 20 000", "filterpy"),
}


def measured(name: str) -> dict[str, float]:
    """CPU seconds of one job: first, again, alternative."""
    made, _, _ = JOBS[name]
    job, other = made()
    job(0)
    times = {}
    for k, what in ((1, "first"), (2, "again")):
        before = spent()
        found = job(k)
        times[what] = spent() - before
    if other is not None:
        before = spent()
        other(2, found)
        times["other"] = spent() - before
    return times


def growing(samples: int, seen: int, loaded: int) -> float:
    """CPU seconds of a second estimate: a beam of 8 modes, sensors and loads at its nodes, constant variance."""
    structure = beams.cantilever(elements=30, damping=damping.Modal(0.01), length=1.5, EI=800.0, mass_per_length=3.0)
    rows = [sensors.Accelerometer(f"{node}+Z") for node in (9, 17, 26, 29, 13, 21, 5, 24)[:seen]]
    model = ForwardModel(structure, rows, [loads.Point(f"{node}+Z") for node in (30, 20, 10, 15)[:loaded]], modes=8)
    inversion, dt = Deconvolution(model, penalty=Penalty("identity", variance="constant")), 1e-4
    for k in range(3):
        g = np.repeat(hits(samples, k), loaded, axis=1) * np.linspace(1, 2, loaded)
        y, before = noisy(model.predict(g, dt), k, 0.05), spent()
        inversion.estimate(y, dt)
        last = spent() - before
    return last


def growth() -> None:
    """Exponents of the time over samples, sensors and loads, each from its least to its most."""
    base = {"samples": 20_000, "sensors": 4, "loads": 1}
    for name, (few, many) in {"samples": (10_000, 80_000), "sensors": (2, 8), "loads": (1, 4)}.items():
        times = [growing(*{**base, "sensors": 8 if name == "loads" else 4, name: n}.values()) for n in (few, many)]
        exponent = np.log(times[1] / times[0]) / np.log(many / few)
        print(f"{name:8s} {few} to {many}: {times[0]:.2f} to {times[1]:.2f} CPU s, exponent {exponent:.2f}", flush=True)


def main(names: list[str]) -> int:
    """Print the table."""
    if names == ["growth"]:
        growth()
        return 0
    print(f"{'CPU s':34s} {'first':>8s} {'again':>8s} {'other':>8s}  alternative")
    for name in names or list(JOBS):
        if name not in JOBS:
            print(f"no job {name!r}: {', '.join(JOBS)}", file=sys.stderr)
            return 2
        code = f"import json; from tests.benchmarks.waiting import measured; print(json.dumps(measured({name!r})))"
        done = subprocess.run([sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True, check=False)
        _, title, alternative = JOBS[name]
        if done.returncode:
            print(f"{title:34s} failed: {done.stderr.strip().splitlines()[-1]}", flush=True)
            continue
        times = json.loads(done.stdout.strip().splitlines()[-1])
        other = f"{times['other']:8.2f}" if "other" in times else " " * 8
        print(f"{title:34s} {times['first']:8.2f} {times['again']:8.2f} {other}  {alternative}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
