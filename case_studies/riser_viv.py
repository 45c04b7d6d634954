"""A riser in sheared current: load and response from a few sensors, exactly in equilibrium, and where the flow excites.

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

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid import FieldDeconvolution, HarmonicInversion, LoadEstimate, Noise
from loadid._families.field import harmonic_power, mean_power
from loadid._families.harmonic import complex_load
from structures import ForwardModel, Structure, bases, sensors
from structures import beams as risers
from structures import motion as motions

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
    load, frequency = complex_load(estimate), estimate.facts.frequency
    found, known = (motions.harmonic_motion(model, g, frequency) for g in (load, truth))
    at = found.along()[1:-1]
    power = harmonic_power(load, found.velocity[at])
    exact = harmonic_power(truth, known.velocity[at])
    big = np.abs(exact) > 0.1 * np.abs(exact).max()
    return Line(
        relative(found.displacement[at], known.displacement[at]),
        relative(load, truth),
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
        family = HarmonicInversion(model, frequency, choice=choice, noise=Noise(share * largest, source="known"))
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


# -- a history --------------------------------------------------------------------------------------------------------
DT, SAMPLES, PLACES, MODES, WINDOW = 1 / 50, 800, 20, 10, 1.5
EXCITED = {2: 0.6, 3: 0.75}  # mode (from 0) and where its excitation begins, over L
LEVEL = 0.02  # noise over the rms of each kind of sensor


def strengths() -> dict[int, Array]:
    """Strength of each mode's excitation over time: the third dies away while the fourth grows."""
    t = np.arange(SAMPLES) * DT
    start = 0.5 - 0.5 * np.cos(np.pi * np.clip(t / 2, 0, 1))
    change = 0.5 - 0.5 * np.cos(np.pi * np.clip((t - 5) / 6, 0, 1))
    return {2: start * (1 - change), 3: start * change}


def flow() -> tuple[Array, Structure]:
    """Nodal forces of the flow over time (samples, 59), excitation less drag, and the riser."""
    riser, t = structure(ABOVE * float(FREQUENCIES[2])), np.arange(SAMPLES) * DT
    push = np.zeros((SAMPLES, len(NODES)))
    for mode, strength in strengths().items():
        frequency = ABOVE * float(FREQUENCIES[mode])
        force = np.where(EXCITED[mode] * RISER["length"] < X, fluid_force(frequency, EXCITED[mode]), 0.0)
        push += strength[:, None] * np.real(force * np.exp(2j * np.pi * frequency * t)[:, None])
    on = min(EXCITED.values()) * RISER["length"] < X
    drag = np.zeros(riser.n)
    drag[[riser.index(f"{k}+Z") for k in NODES]] = np.where(on, 0.0, DRAG * H)
    from scipy import sparse

    wet = replace(riser, C=sparse.csr_array(sparse.diags_array(drag)))
    speeds = ForwardModel(wet, [sensors.Velocity(f"{k}+Z") for k in NODES], bases.nodal(wet), modes=40)
    velocity = speeds.state_space(DT).simulate(push)
    return push - np.where(on, 0.0, DRAG * H) * velocity, riser


@dataclass(frozen=True, eq=False)
class History:
    """Estimate, its motion and the truth at the inner nodes: loads in N/m, power in W/m, both (samples, 59)."""

    estimate: LoadEstimate
    motion: motions.Motion
    known: motions.Motion
    load: Array
    truth: Array
    power: Array
    exact: Array

    def figures(self) -> dict[str, float]:
        """Relative errors, agreement of the zones, and the residual of the equation of motion."""
        at = self.motion.along()[1:-1]
        inside = slice(round(WINDOW / DT), -round(WINDOW / DT))
        p, e = self.power[inside], self.exact[inside]
        big = np.abs(e) > 0.1 * np.abs(e).max()
        fed = [np.where(x > 0, x, 0).sum() for x in (p, e)]
        return {
            "displacement": relative(self.motion.displacement[:, at], self.known.displacement[:, at]),
            "load": relative(self.load, self.truth),
            "sign of power": float(np.mean(np.sign(p[big]) == np.sign(e[big]))),
            "correlation of power": float(np.corrcoef(p.ravel(), e.ravel())[0, 1]),
            "power in": abs(float(fed[0] / fed[1]) - 1),
            "equation of motion": self.motion.imbalance(),
        }

    def begins(self, second: float) -> float:
        """Lowest place of the upper excitation zone (m) at a time, from the estimate."""
        row = self.power[round(second / DT)]
        damping = np.flatnonzero(row < 0.1 * row.max())
        return float(X[damping.max() + 1]) if len(damping) and damping.max() + 1 < len(X) else float(X[0])


def history(seed: int = 0, counts: tuple[int, int] = FULL) -> History:
    """The load over place and time from noisy records, and the zones."""
    forces, riser = flow()
    nodal = ForwardModel(riser, layout(*counts), bases.nodal(riser))
    clean = nodal.predict(forces, DT)
    kinds = np.repeat([0, 1], counts)
    noise = LEVEL * np.sqrt([np.mean(clean[:, kinds == k] ** 2) for k in kinds])
    record = clean + noise * np.random.default_rng(seed).standard_normal(clean.shape)
    hats = bases.hats(riser, PLACES)
    few = ForwardModel(riser, nodal.sensors, hats, modes=MODES)
    family = FieldDeconvolution(few, space="gradient", noise=Noise(noise, source="known"))
    estimate = family.estimate(record, DT)
    whole = ForwardModel(riser, nodal.sensors, hats)
    found, known = motions.motion(whole, estimate.load, DT), motions.motion(nodal, forces, DT)
    load, at = hats.evaluate(estimate.load, X)[..., 0], found.along()[1:-1]
    return History(
        estimate, found, known, load, forces / H,
        mean_power(load, found.velocity[:, at], DT, WINDOW),
        mean_power(forces / H, known.velocity[:, at], DT, WINDOW),
    )  # fmt: skip


# -- what is shown ----------------------------------------------------------------------------------------------------
def show(table: dict[float, tuple[Line, list[LoadEstimate]]], counts: tuple[int, int]) -> str:
    """The table of one layout as text."""
    head = "noise   displacement   force   sign of power   corr(power)   power in   equation of motion"
    rows = [
        f"{share:5.1%} {r.field:14.4f} {r.force:7.2f} {r.sign:15.2f} {r.correlation:13.2f} {r.power_in:10.2f}"
        f" {r.imbalance:20.1e}"
        for share, (r, _) in table.items()
    ]
    return "\n".join([f"{counts[0]} accelerometers, {counts[1]} strains: relative errors", head, *rows])


def picture(found: History, lines: LoadEstimate, path: Path) -> None:
    """Zones over place and time, estimated and true, and the power on one line."""
    from matplotlib.figure import Figure

    from loadid._plots.fields import draw_map, signed

    figure = Figure(figsize=(9.5, 8.5), layout="constrained")
    axes = figure.subplots(4, 1, height_ratios=(1, 1, 1, 0.9))
    t = np.arange(SAMPLES) * DT
    top, force = float(np.abs(found.exact).max()), float(np.abs(found.truth).max())
    for ax, values, title, word, most in (
        (axes[0], found.load, "load, estimated", "load [N/m]", force),
        (axes[1], found.power, "zones, estimated: red excites, blue damps", "mean power [W/m]", top),
        (axes[2], found.exact, "zones, true", "mean power [W/m]", top),
    ):
        draw_map(ax, t, X, values, word, signed(most))
        ax.set_title(title, loc="left", fontsize=9)
        ax.set(ylabel="x [m]")
    axes[2].set_xlabel("time [s]")
    riser, truth = structure(ABOVE * float(FREQUENCIES[2])), fluid_force(ABOVE * float(FREQUENCIES[2]), 0.6)
    model = ForwardModel(riser, layout(*FULL), bases.nodal(riser))
    for force_on, style, name in ((truth, "k--", "true"), (complex_load(lines), "C0", "rebuilt")):
        moved = motions.harmonic_motion(model, force_on, ABOVE * float(FREQUENCIES[2]))
        axes[3].plot(X, harmonic_power(force_on, moved.velocity[moved.along()[1:-1]]) / H, style, label=name)
    axes[3].axhline(0, color="0.6", lw=0.6)
    axes[3].set(xlabel="x [m]", ylabel="mean power [W/m]")
    axes[3].set_title("one line at 5.01 Hz, 1 % noise", loc="left", fontsize=9)
    axes[3].legend()
    figure.savefig(path, dpi=130)


def main() -> None:
    """Print the tables and save the picture."""
    tables = {counts: line_table(counts) for counts in (FULL, FEW)}
    for counts, table in tables.items():
        sys.stdout.write(show(table, counts) + "\n\n")
    found = history()
    sys.stdout.write(f"history, {LEVEL:.0%} noise, {found.estimate.facts.path}:\n")
    for name, value in found.figures().items():
        sys.stdout.write(f"  {name:22s}{value:10.3g}\n")
    for second in (4, 14):
        sys.stdout.write(f"  excited above x = {found.begins(second) / RISER['length']:.2f} L at {second} s\n")
    target = Path("riser_viv.png")
    picture(found, tables[FULL][0.01][1][0], target)
    found.estimate.plot("spacetime", path=target.with_name("riser_load.png"))
    sys.stdout.write(f"pictures: {target}, riser_load.png\n")


if __name__ == "__main__":
    main()
