"""Impact on a clamped circular plate: where the sensor is decides what can be rebuilt, and lambda is the delicate step.

After Jacquelin, Bennani & Hamelin, J. Sound Vib. 265 (2003) 81-107, of whose statements it makes two testable: the
reconstruction depends on the location of the measurement point, and the choice of the parameter is the hard part.
Plate, sensors and sampling are ours: aluminium, radius 0.25 m, 4 mm, a half-sine force of 1 kN and 1 ms at the centre,
seen by the deflection or the radial surface strain at one radius, 400 samples at 20 kHz. Data and inversion share
the model, so the figures are optimistic for the field.

Run ``python -m case_studies.impact_plate``: prints the table and saves ``impact_plate.png``.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loadid import Deconvolution
from loadid.paths import LinearProblem, SVDPath, toeplitz
from structures import Channel, ImpulseModel

RADIUS, THICKNESS, E, RHO, NU, DAMPING = 0.25, 4e-3, 70e9, 2700.0, 0.33, 0.005
MODES, SAMPLES, DT = 12, 400, 1 / 20e3
SENSORS = (
    ("displacement", 0.0),
    ("displacement", 0.5),
    ("strain", 0.0),
    ("strain", 0.5),
    ("strain", 0.76),
    ("strain", 0.80),
)
RULES = ("predicted_error", "robust_gcv", "gcv", "l_curve", "ncp", "quasi_optimality", "evidence")


def wave_numbers() -> NDArray[np.float64]:
    """Roots x = beta a of J0(x) I1(x) + I0(x) J1(x) = 0: axisymmetric modes of a clamped circular plate."""
    from scipy.optimize import brentq
    from scipy.special import i0e, i1e, j0, j1

    def f(x: float) -> float:
        return float(j0(x) * i1e(x) + i0e(x) * j1(x))

    grid = np.arange(1.0, 45.0, 0.1)
    return np.array([brentq(f, a, b) for a, b in pairwise(grid) if f(a) * f(b) < 0][:MODES])


def shape(r: NDArray | float, beta: float, derivative: int = 0) -> NDArray[np.float64]:
    """Mode phi = J0(beta r) - J0(beta a) / I0(beta a) I0(beta r), or its second derivative in r."""
    from scipy.special import i0, ivp, j0, jvp

    ratio = j0(beta * RADIUS) / i0(beta * RADIUS)
    if derivative == 0:
        return j0(beta * r) - ratio * i0(beta * r)
    return beta**2 * (jvp(0, beta * r, 2) - ratio * ivp(0, beta * r, 2))


def model(kind: str, place: float) -> ImpulseModel:
    """Impulse response at one sensor, sampled at dt, 2 dt, ...: the first sample is on the diagonal."""
    D = E * THICKNESS**3 / 12 / (1 - NU**2)
    t, r = DT * np.arange(1, SAMPLES + 1), np.linspace(0, RADIUS, 4001)
    h = np.zeros(SAMPLES)
    for x in wave_numbers():
        beta = x / RADIUS
        omega = beta**2 * np.sqrt(D / (RHO * THICKNESS))
        mass = np.trapezoid(2 * np.pi * r * RHO * THICKNESS * shape(r, beta) ** 2, r)
        at = np.float64(place * RADIUS)
        seen = shape(at, beta) if kind == "displacement" else -THICKNESS / 2 * shape(at, beta, 2)
        damped = omega * np.sqrt(1 - DAMPING**2)
        h += seen * shape(0.0, beta) / (mass * damped) * np.exp(-DAMPING * omega * t) * np.sin(damped * t)
    unit = "m" if kind == "displacement" else "1"
    sensor = Channel(label=f"{kind} r/a={place:g}", quantity=kind, unit=unit)
    return ImpulseModel(
        h, DT, kind="continuous", sensors=[sensor], loads=[Channel(label="impact", quantity="force", unit="N")]
    )


def force() -> NDArray[np.float64]:
    """Half sine of 1 kN and 1 ms from sample 20."""
    k = np.arange(SAMPLES)
    return np.where((k >= 20) & (k <= 40), 1000 * np.sin(np.pi * (k - 20) / 20), 0.0)


@dataclass(frozen=True)
class Row:
    """Medians over the seeds for one sensor: load error of the best lambda, and every rule's error over it."""

    sensor: str
    kappa: float
    best: float
    ratio: dict[str, float]
    spread: float
    flagged: float
    peak_error: float


def measure(kind: str, place: float, noise: float, seeds: int = 20) -> Row:
    """Rebuild the force `seeds` times with fresh noise of exactly `noise` times the response."""
    plate, g = model(kind, place), force()
    clean = plate.predict(g, DT)
    H = toeplitz(plate.impulse_response(DT, SAMPLES))
    factored = SVDPath(LinearProblem.whitened(H, clean, noise=[1.0]))
    best, spread, flagged, peak, ratio = [], [], [], [], {"default": [], **{r: [] for r in RULES}}
    for seed in range(seeds):
        e = np.random.default_rng(seed).standard_normal(clean.shape)
        y = clean + e * noise * np.linalg.norm(clean) / np.linalg.norm(e)
        path = factored.with_data(y.ravel())

        def error(lam: float, path: SVDPath = path) -> float:
            return float(np.linalg.norm(path.solution(lam, None).load - g) / np.linalg.norm(g))

        oracle = min(error(lam) for lam in np.geomspace(*path.range, 200))
        estimate = Deconvolution(plate, allow=["W114", "W702", "W703"]).estimate(y, dt=DT)
        best.append(oracle)
        ratio["default"].append(np.linalg.norm(estimate.load[:, 0] - g) / np.linalg.norm(g) / oracle)
        for said in estimate.choice.rules:
            if said.rule in ratio and said.lam is not None:
                ratio[said.rule].append(error(said.lam) / oracle)
        spread.append(estimate.choice.spread)
        flagged.append("W407" in estimate.codes)
        peak.append(abs(estimate.load.max() / g.max() - 1))
    medians = {rule: float(np.median(values)) if values else float("nan") for rule, values in ratio.items()}
    return Row(
        plate.sensors[0].label,
        float(path.singular_values[0] / path.singular_values[-1]),
        float(np.median(best)),
        medians,
        float(np.median(spread)),
        float(np.mean(flagged)),
        float(np.median(peak)),
    )


def table(noise: float, seeds: int = 20) -> list[Row]:
    """One row for each sensor."""
    return [measure(kind, place, noise, seeds) for kind, place in SENSORS]


def show(rows: list[Row], noise: float) -> str:
    """The table in text: error of the best lambda, then every rule's error over it."""
    names = ["default", *RULES]
    lines = [
        f"{noise:.0%} noise: load error at the best lambda, then the error of each rule over it (medians)",
        f"{'sensor':24s} {'kappa':>8s} {'best':>6s} "
        + " ".join(f"{n[:15]:>15s}" for n in names)
        + "  W407  peak error",
    ]
    for r in rows:
        ratios = " ".join(f"{r.ratio[n]:15.2f}" for n in names)
        lines.append(f"{r.sensor:24s} {r.kappa:8.1e} {r.best:6.3f} {ratios}  {r.flagged:4.0%}  {r.peak_error:.1%}")
    return "\n".join(lines)


def picture(path: Path, noise: float = 0.01) -> None:
    """Rebuilt force with its band for a poor and for a good sensor."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True)
    for ax, (kind, place) in zip(axes, (SENSORS[1], SENSORS[2]), strict=True):
        plate, g = model(kind, place), force()
        clean = plate.predict(g, DT)
        e = np.random.default_rng(0).standard_normal(clean.shape)
        estimate = Deconvolution(plate).estimate(clean + e * noise * np.linalg.norm(clean) / np.linalg.norm(e), dt=DT)
        low, high = estimate.band()
        t = 1e3 * estimate.axis.values
        ax.fill_between(t, low[:, 0], high[:, 0], alpha=0.3, color="C0", label="95 % band")
        ax.plot(t, estimate.load[:, 0], color="C0", label="rebuilt")
        ax.plot(t, g, color="k", lw=1, ls="--", label="true")
        ax.set(ylabel="force in N", title=f"{plate.sensors[0].label}, {noise:.0%} noise ({estimate.choice.rule})")
        ax.legend()
    axes[1].set(xlabel="time in ms", xlim=(0, 8))
    figure.savefig(path, dpi=130)


def main() -> None:
    """Print both tables and save the picture."""
    for noise in (0.01, 0.05):
        sys.stdout.write(show(table(noise), noise) + "\n\n")
    target = Path("impact_plate.png")
    picture(target)
    sys.stdout.write(f"picture: {target}\n")


if __name__ == "__main__":
    main()
