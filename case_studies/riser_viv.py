"""A riser in sheared current: load and response from a few sensors, both exactly in equilibrium; where the flow excites.

After P. Mainçon, C. Barnardo, C. M. Larsen, "VIV force estimation using inverse FEM", OMAE 2008, 673-681 (abstract seen
only): load *and* response satisfy dynamic equilibrium exactly, loads are reasonably small, the response agrees with the
data; from the power of the load on the motion follow the excitation and the damping zones.

Two cases of our own, a riser of 9.63 m under 700 N with accelerometers and bending strains on it.

1. One frequency line, 1.03 times the third natural frequency, loss factor 0.01. The flow pushes with 6 N/m along the
   local velocity where x > 0.6 L (a phase that 200 steps with relaxation 0.5 settle: it leads to a constant phase
   between force and velocity, as no motion at this frequency is in phase everywhere) and damps the rest with
   6 N s/m^2. What is looked for is the whole fluid force on 59 nodes.
2. A time history in which the third mode dies away and the fourth takes over, as when the current rises: the forces of
   both lines, each with its slowly varying strength, the fourth mode excited on the upper quarter only. Load on hat
   functions with a spatial prior, zones over place and time.

Data and inversion share the model in (1), as do most published tests; in (2) the load of the data is not in the basis
of the inversion. Run ``python -m case_studies.riser_viv``: prints both tables and saves ``riser_viv.png``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid import HarmonicInversion, LoadEstimate
from loadid.zones import harmonic_power
from structures import ForwardModel, Structure, bases, risers, sensors
from structures.motion import harmonic_motion

RISER: dict[str, Any] = {"length": 9.63, "EI": 135.4, "mass_per_length": 0.85}
TENSION, ELEMENTS, LOSS = 700.0, 60, 0.01
PUSH, DRAG, ABOVE = 6.0, 6.0, 1.03  # N/m, N s/m^2, drive over natural frequency
FREQUENCIES = risers.frequencies(**RISER, tension=TENSION, count=6)
NODES = np.arange(1, ELEMENTS)
H = RISER["length"] / ELEMENTS
X = H * NODES
FIBRE = 0.01
FULL, FEW = (9, 15), (4, 8)
Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def structure(frequency: float) -> Structure:
    """The riser with its loss factor at one frequency."""
    damping = risers.loss_factor(LOSS, frequency)
    return risers.riser(**RISER, top_tension=TENSION, elements=ELEMENTS, damping=damping)


def layout(accelerometers: int, strains: int) -> list[Any]:
    """Accelerometers and bending strains (mean curvature over two elements, 10 mm out) along the riser."""
    return [
        *(sensors.Accelerometer(f"{k}+Z") for k in np.linspace(4, 56, accelerometers).astype(int)),
        *(
            sensors.StrainGauge(at=k * H, fibre=FIBRE, length=2 * H, label=f"strain {k}")
            for k in np.linspace(2, 58, strains).astype(int)
        ),
    ]


# -- one line ---------------------------------------------------------------------------------------------------------
def fluid_force(frequency: float, excited: float) -> Complex:
    """Nodal forces of the flow (59,) at one frequency: excitation above x = `excited` L, damping below it."""
    riser = structure(frequency)
    everywhere = ForwardModel(riser, [sensors.Displacement(f"{k}+Z") for k in NODES], bases.nodal(riser))
    stiffness = np.linalg.solve(everywhere.frf([frequency])[0], np.eye(len(NODES)))
    on, omega = excited * RISER["length"] < X, 2 * np.pi * frequency
    damped = stiffness + 1j * omega * np.diag(np.where(on, 0.0, DRAG * H))

    def pushed(u: Complex) -> Complex:
        return np.where(on, PUSH * H * 1j * u / np.abs(u), 0.0)

    u = np.linalg.solve(damped, on.astype(complex))
    for _ in range(200):
        u = 0.5 * np.linalg.solve(damped, pushed(u)) + 0.5 * u
    force = pushed(u)
    return force - 1j * omega * np.where(on, 0.0, DRAG * H) * np.linalg.solve(damped, force)


@dataclass(frozen=True)
class Line:
    """Figures of one inversion at one line: errors are relative, power where it is above a tenth of the largest."""

    field: float
    force: float
    sign: float
    correlation: float
    power_in: float
    imbalance: float


def compare(estimate: LoadEstimate, model: ForwardModel, truth: Complex) -> Line:
    """Estimated against true force, motion and power."""
    found, known = (harmonic_motion(model, g, float(estimate.axis.values[0])) for g in (estimate.load[0], truth))
    at = found.along()[1:-1]
    power = harmonic_power(estimate.load[0], found.velocity[at])
    exact = harmonic_power(truth, known.velocity[at])
    big = np.abs(exact) > 0.1 * np.abs(exact).max()
    return Line(
        relative(found.displacement[at], known.displacement[at]),
        relative(estimate.load[0], truth),
        float(np.mean(np.sign(power[big]) == np.sign(exact[big]))),
        float(np.corrcoef(power, exact)[0, 1]),
        abs(float(power[power > 0].sum() / exact[exact > 0].sum()) - 1),
        found.imbalance(),
    )


def line_table(
    counts: tuple[int, int] = FULL, choice: str | None = None, seeds: int = 20
) -> dict[float, tuple[Line, list[LoadEstimate]]]:
    """Medians over the seeds for noise of 0.1, 1 and 5 % of the largest amplitude of each kind, and the estimates."""
    frequency = ABOVE * float(FREQUENCIES[2])
    riser, truth = structure(frequency), fluid_force(frequency, 0.6)
    model = ForwardModel(riser, layout(*counts), bases.nodal(riser))
    clean = model.frf([frequency])[0] @ truth
    kinds = np.repeat([0, 1], counts)
    largest = np.array([np.abs(clean[kinds == k]).max() for k in kinds])
    out = {}
    for share in (0.001, 0.01, 0.05):
        family = HarmonicInversion(model, frequency, choice=choice, noise=share * largest, noise_source="known")
        rows, estimates = [], []
        for seed in range(seeds):
            rng = np.random.default_rng(seed)
            noise = (rng.standard_normal(len(clean)) + 1j * rng.standard_normal(len(clean))) / np.sqrt(2)
            estimates.append(family.estimate(clean + share * largest * noise))
            rows.append(compare(estimates[-1], model, truth))
        table = np.array([[getattr(r, n) for n in Line.__dataclass_fields__] for r in rows])
        out[share] = Line(*np.median(table, axis=0).tolist()), estimates
    return out


def relative(found: NDArray, known: NDArray) -> float:
    """Norm of the difference over that of the known."""
    return float(np.linalg.norm(found - known) / np.linalg.norm(known))
