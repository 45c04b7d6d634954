"""Small problems of every family, solver, penalty, constraint and rule, for the net that shows that no answer moves.

All are deterministic and go through the public interface. The structures are chains of a few masses and beams of a few
elements, records have 100 to 600 samples (several windows take more). Lambda is given wherever the problem is not about
its choice: then an answer is one linear solve, the same on every processor to far less than 1e-10 of its largest entry
(`TIGHT`). A problem that asks for more is `Loose`, with the reason, which is what the solver states of itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

import structures
from loadid import (
    Absolute,
    AutomaticInversion,
    Deconvolution,
    FieldDeconvolution,
    FrequencyInversion,
    HarmonicInversion,
    LoadTracker,
    LocationSearch,
    Record,
    ShapeSensing,
    Signal,
    SparseDeconvolution,
    Spectra,
    StaticInversion,
    compare_domains,
    q_sweep,
    read,
    recommend,
)
from loadid._spellings import folded
from loadid.constraints import Bounds, FrictionCone, NonNegative, Resultant, Support
from loadid.fullfield import FieldFrames, virtual_fields
from loadid.priors import OU, Matern32, Matern52, Periodic, RandomWalk, White
from loadid.settings import Noise, Search
from structures import (
    Channel,
    ForwardModel,
    FrfModel,
    ImpulseModel,
    MatrixModel,
    MeasuredModel,
    bases,
    beams,
    chains,
    damping,
    loads,
    plates,
    sensors,
)
from tactile import ContactLaw, GelForce, GelSlim, HalfSpace, Layer, LayerSensor, Markers, MultilayerPad, Pad, Press
from tests.data import measured

from .answers import Answer, answer, kept

DT, N, LAM = 1e-3, 160, 3e-3
RULES = ("discrepancy", "dof_discrepancy", "upre", "gcv", "robust_gcv", "modified_gcv", "predicted_error", "l_curve",
         "quasi_optimality", "ncp", "evidence")  # fmt: skip
SAID = {"noise_source": "unloaded record"}
SOURCE = {"source": SAID["noise_source"]}
TIGHT = 1e-10


@dataclass(frozen=True)
class Loose:
    """A tolerance above `TIGHT`, and its reason."""

    tolerance: float
    why: str


@dataclass(frozen=True)
class Problem:
    """What makes an answer, and how far each array may lie from the stored one, relative to its largest entry."""

    solve: Callable[[], Answer]
    loose: Loose | None = None

    @property
    def tolerance(self) -> float:
        """`TIGHT` where nothing else is said."""
        return TIGHT if self.loose is None else self.loose.tolerance


PROBLEMS: dict[str, Problem] = {}


def add(name: str, solve: Callable[[], Answer], loose: Loose | None = None) -> None:
    """One more problem."""
    assert name not in PROBLEMS, name
    PROBLEMS[name] = Problem(solve, loose)


def noisy(clean: np.ndarray, share: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """With white noise of a share of each channel's rms, and its std (channels,)."""
    std = share * np.sqrt(np.mean(np.abs(clean) ** 2, axis=0))
    return clean + std * np.random.default_rng(seed).standard_normal(clean.shape), std


# -- load histories ---------------------------------------------------------------------------------------------------
@cache
def chain(at: tuple[str, ...] = ("3+X",), more: tuple[sensors.Sensor, ...] = ()) -> ForwardModel:
    """Six masses, an accelerometer and a displacement sensor, and more."""
    structure = chains.chain(
        masses=[1.0, 1.3, 0.9, 1.1, 1.2, 0.8], springs=[9e4, 8e4, 1e5, 7e4, 9e4, 8e4], damping=damping.Modal(0.04)
    )
    seen = [sensors.Accelerometer("2+X", label="a2"), sensors.Displacement("5+X", label="d5")]
    return ForwardModel(structure, [*seen, *more], [loads.Point(x, label=f"p{x[0]}") for x in at])


@cache
def table(at: tuple[str, ...] = ("3+X",), samples: int = N) -> ImpulseModel:
    """The same as an impulse response, which has no state space."""
    own = chain(at)
    return ImpulseModel(
        own.impulse_response(DT, samples), DT, kind="held", hold=own.default_hold, sensors=own.sensors, loads=own.loads
    )


@cache
def pushed(at: tuple[str, ...] = ("3+X",), samples: int = N, share: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """Record of one bump for each load, and its noise."""
    t = np.arange(samples)
    g = np.stack([50 * np.hanning(40)[(t - 40 - 30 * j).clip(0, 39)] for j in range(len(at))], axis=1)
    return noisy(chain(at).predict(g, DT), share)


def deconvolved(
    *, at: tuple[str, ...] = ("3+X",), bare: bool = False, samples: int = N, stated: bool = True, gaps: bool = False,
    **settings: Any,
) -> Answer:  # fmt: skip
    """Deconvolution of that record."""
    y, std = pushed(at, samples)
    if gaps:
        y = y.copy()
        y[50:58, 0] = y[90:93, 1] = np.nan
    if stated:
        settings = {"noise": std, **SAID, **settings}
    e = Deconvolution(
        (table if bare else chain)(at, *([samples] if bare else [])), **folded(Deconvolution, settings)
    ).estimate(y, DT)
    return answer(e, impulse=spread(e.functional("impulse")))


def spread(f: Any) -> list[float]:
    """Value and std of a functional."""
    return [f.value, f.std]


def deconvolution(name: str, loose: Loose | None = None, **settings: Any) -> None:
    """A problem of `deconvolved`."""
    add(f"deconvolution/{name}", lambda: deconvolved(**settings), loose)


TWO = ("3+X", "6+X")
GRADIENT = Loose(1e-8, "the iteration ends at a gradient of 1e-12, that for traces at 1e-9")
SOLVED = Loose(1e-7, "scalars and traces are solved to 1e-9, and the slope of a rule's function divides them")
PLAIN = Loose(1e-6, "windows are solved to 1e-7 where only sums are asked for")
PUSHED = Loose(1e-7, "each step of the active set is solved to 1e-9, times the condition number of the free loads")
CLIMBED = Loose(1e-6, "variances climb by updates until the evidence gains little")
SHARP = Loose(1e-8, "the rule takes a lambda of 2e-8, whose inverse multiplies rounding")
for path in ("dense", "statespace", "toeplitz", "windows", "fft"):
    bare = path in ("toeplitz", "windows")
    given = {"toeplitz": GRADIENT, "windows": GRADIENT}.get(path)
    solved = {"toeplitz": SOLVED, "windows": PLAIN}.get(path)
    for penalty in ("identity", "first_difference", "second_difference"):
        deconvolution(f"{path}/{penalty}/given", given, path=path, penalty=penalty, choice=LAM, bare=bare)
    deconvolution(f"{path}/two loads, noise not stated/given", solved, path=path, at=TWO, choice=0.03, bare=bare,
                  stated=False)  # fmt: skip
    deconvolution(f"{path}/identity/default", solved, path=path, bare=bare)
    deconvolution(f"{path}/identity/default, noise not stated", solved, path=path, bare=bare, stated=False)
deconvolution("dense/non-negative/given", PUSHED, path="dense", choice=LAM, constraints=[NonNegative()])
deconvolution("statespace/non-negative/given", path="statespace", choice=LAM, constraints=[NonNegative()])
deconvolution("toeplitz/non-negative/given", PUSHED, path="toeplitz", choice=LAM, constraints=[NonNegative()],
              bare=True)  # fmt: skip
deconvolution("statespace/gaps/given", path="statespace", choice=LAM, gaps=True)
deconvolution("toeplitz/gaps/given", GRADIENT, path="toeplitz", choice=LAM, gaps=True, bare=True)
deconvolution("statespace/non-negative/default", path="statespace", constraints=[NonNegative()])
deconvolution("statespace/gaps/default", path="statespace", gaps=True)
deconvolution("statespace/one load of two only pushes", path="statespace", at=TWO, choice=LAM,
              constraints=[NonNegative([0])])  # fmt: skip
for rule in RULES:
    deconvolution(f"dense/identity/{rule}", SHARP if rule == "ncp" else None, path="dense", choice=rule)
for rule in ("discrepancy", "gcv", "evidence"):
    deconvolution(f"statespace/first_difference/{rule}", path="statespace", penalty="first_difference", choice=rule)
deconvolution("dense/matrix/given", path="dense", choice=LAM,
              penalty=np.eye(N) - 0.9 * np.eye(N, k=-1) + 0.1 * np.eye(N, k=-2))  # fmt: skip
deconvolution("dense/size/given", path="dense", choice=LAM, penalty="first_difference", size=0.1)
deconvolution("statespace/size/given", path="statespace", choice=LAM, penalty="first_difference", size=0.1)
deconvolution("dense/truncated/given", path="dense", method="tsvd", choice=0.05)
deconvolution("dense/truncated/gcv", path="dense", method="tsvd", choice="gcv")
deconvolution("fft/truncated/given", path="fft", method="tsvd", choice=0.05)
deconvolution("dense/one sensor, held/given", path="dense", choice=LAM, hold="zoh", sensors=["a2"], noise=0.5)
deconvolution("dense/correlated noise/given", path="dense", choice=LAM,
              noise=np.array([[0.25, 2e-6], [2e-6, 1e-10]]))  # fmt: skip
deconvolution("statespace/unknown start/given", path="statespace", choice=LAM, initial="unknown")
deconvolution("statespace/leak/given", path="statespace", choice=LAM, penalty="first_difference", leak=0.98)
deconvolution("statespace/from zero/given", path="statespace", choice=LAM, penalty="first_difference", from_zero=True)
deconvolution("statespace/600 samples/given", path="statespace", choice=LAM, samples=600)
deconvolution("toeplitz/600 samples/given", GRADIENT, path="toeplitz", choice=LAM, samples=600, bare=True)
deconvolution("windows/6000 samples/given", PLAIN, path="windows", choice=0.03, samples=6000, bare=True)
deconvolution("auto/600 samples/default", samples=600)


def unpenalised() -> Answer:
    """Least squares, with an accelerometer at the load so that the data determine it."""
    model = chain(more=(sensors.Accelerometer("3+X", label="a3"),))
    y, std = noisy(model.predict(np.hanning(N)[:, None], DT), 0.02)
    return answer(Deconvolution(model, penalty=None, noise=Noise(std, **SOURCE)).estimate(y, DT))


def offset() -> Answer:
    """An accelerometer with an offset, which is taken off and stays an unknown."""
    y, std = pushed()
    return answer(
        Deconvolution(chain(), noise=Noise(std, **SOURCE), choice=LAM).estimate(y + np.array([np.ptp(y[:, 0]), 0]), DT)
    )


def crossing() -> Answer:
    """A load that moves along a beam."""
    beam = beams.simply_supported(length=2.0, section=beams.Section.rectangle(0.05, 0.01),
                                  material=beams.materials.steel, elements=8, damping=damping.Modal(0.03))  # fmt: skip
    gauge = [sensors.Displacement(at=x, direction="Z", label=f"d{x}") for x in (0.7, 1.2)]
    model = ForwardModel(beam, gauge, [loads.MovingPoint(np.linspace(0.3, 1.7, N), label="truck")], modes=3)
    y, std = noisy(model.predict(np.full((N, 1), 100.0), DT), 0.01)
    family = Deconvolution(model, penalty="first_difference", choice=LAM, noise=Noise(std, **SOURCE))
    return answer(family.estimate(y, DT))


@cache
def hammered() -> tuple[MeasuredModel, np.ndarray]:
    """A model from three noisy hammer hits on the chain, and the response to another load."""
    rng, t = np.random.default_rng(5), np.arange(512)
    hits = []
    for size in (80.0, 100.0, 120.0):
        force = size * np.sin(np.pi * (t - 8).clip(0, 6) / 6)
        y, _ = noisy(chain().predict(force[:, None], DT), 0.002, int(size))
        hits.append(np.column_stack([force + 0.02 * rng.standard_normal(512), y]))
    model = MeasuredModel.from_hits(hits, dt=DT, force=0, responses=[1, 2])
    y, _ = noisy(chain().predict(60 * np.sin(np.pi * (t - 20).clip(0, 9) / 9)[:, None], DT), 0.002, 7)
    return model, y


def from_hits(**settings: Any) -> Answer:
    """Deconvolution by that model."""
    model, y = hammered()
    return answer(Deconvolution(model, **folded(Deconvolution, settings)).estimate(y, DT))


PULSE = (0.035, 0.085)
for path in ("dense", "statespace"):
    deconvolution(f"{path}/window/given", path=path, choice=LAM, support=PULSE)
    deconvolution(f"{path}/window/default", path=path, support=PULSE)
deconvolution("dense/window, first_difference/given", path="dense", penalty="first_difference", choice=LAM,
              support=[(0.0, 0.02), PULSE])  # fmt: skip
deconvolution("statespace/window, non-negative/given", choice=LAM, support=PULSE, constraints=[NonNegative()])
deconvolution("statespace/smooth", CLIMBED, variance="smooth")


def automatic(**settings: Any) -> Answer:
    """What model and data ask for."""
    y, std = pushed()
    e = AutomaticInversion(chain(), noise=Noise(std, **SOURCE), **settings).estimate(y, DT)
    found = answer(e)
    return Answer(found.arrays, found.words | {"chosen": [e.facts.chosen.split(":")[0]]})


add("automatic/history", automatic, CLIMBED)
add("automatic/window", lambda: automatic(support=PULSE))
add("automatic/static", lambda: answer(AutomaticInversion(chain(), sensors=["d5"], noise=1e-6).estimate({"d5": 1e-3})))
add("deconvolution/dense/least squares", unpenalised)
add("deconvolution/offset", offset)
add("deconvolution/moving load", crossing)
add("deconvolution/hammer model/given", lambda: from_hits(choice=LAM))
add("deconvolution/hammer model/default", from_hits, CLIMBED)
add("deconvolution/hammer model/toeplitz", lambda: from_hits(path="toeplitz", choice=LAM), GRADIENT)


# -- few pulses -------------------------------------------------------------------------------------------------------
def sparse(*, at: tuple[str, ...] = ("3+X",), stated: bool = True, **settings: Any) -> Answer:
    """Three hits of one sample, or of a pulse under B-splines."""
    g = np.zeros((N, len(at)))
    if "dictionary" not in settings:
        g[[30, 31, 90], 0] = 30.0, 20.0, 40.0
    else:
        g[30:42, 0] = 30 * np.sin(np.pi * np.arange(12) / 12)
        g[90:102, 0] = 20 * np.sin(np.pi * np.arange(12) / 12)
    y, std = noisy(chain(at).predict(g, DT), 0.02)
    if stated:
        settings = {"noise": std, **SAID, **settings}
    return answer(SparseDeconvolution(chain(at), **folded(SparseDeconvolution, settings)).estimate(y, DT))


atoms = np.stack([np.roll(np.concatenate([np.hanning(14), np.zeros(N - 14)]), 4 * k) for k in range(36)], axis=1)
add("sparse/spikes/given", lambda: sparse(choice=0.1))
add("sparse/spikes/window", lambda: sparse(choice=0.1, support=(0.025, 0.1)))
add("sparse/spikes/default", sparse)
add("sparse/spikes/default, noise not stated", lambda: sparse(stated=False))
add("sparse/spikes/ebic", lambda: sparse(choice="ebic"))
add("sparse/spikes/not negative", lambda: sparse(choice=0.1, nonnegative=True))
add("sparse/spikes/reweighted", lambda: sparse(choice=0.1, reweighted=2))
add("sparse/spikes/shrunken", lambda: sparse(choice=0.1, debias=False, tol=1e-12))
add("sparse/splines/given", lambda: sparse(dictionary="bspline", knots=4, choice=0.1))
add("sparse/splines/scan", lambda: sparse(dictionary="bspline"))
add("sparse/wavelets/given", lambda: sparse(dictionary="wavelet", choice=0.1))
add("sparse/matrix/given", lambda: sparse(dictionary=atoms, choice=0.1))
add("sparse/groups of loads/given", lambda: sparse(at=TWO, groups="loads", choice=0.1))
add("sparse/groups of slots/given", lambda: sparse(at=TWO, groups="slots", choice=0.1))


# -- static -----------------------------------------------------------------------------------------------------------
@cache
def kernel() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A smooth transfer matrix (24, 30), readings of a bump (3, 24) and their noise."""
    s, x = np.linspace(0, 1, 24), np.linspace(0.02, 0.98, 30)
    H = np.exp(-(((s[:, None] - x) / 0.06) ** 2) / 2) * (1 + 0.3 * s[:, None])
    g = np.exp(-(((x - 0.4) / 0.12) ** 2) / 2) * np.array([[1.0], [2.0], [-0.5]]) + 0.1
    y = g @ H.T
    std = 0.02 * np.sqrt(np.mean(y**2))
    return H, y + std * np.random.default_rng(1).standard_normal(y.shape), np.full(24, std)


def inverted(
    *, stated: bool = True, frames: bool = False, joint: bool = True, onto: np.ndarray | None = None, **settings: Any
) -> Answer:
    """Static inversion of these readings, or of what every other one gives interpolated."""
    H, y, std = kernel()
    if onto is not None:
        y, settings = y[:, ::2] @ onto.T, {"interpolation": onto, **settings}
    if stated:
        settings = {"noise": std, **SAID, **settings}
    e = StaticInversion(MatrixModel(H), **folded(StaticInversion, settings)).estimate(
        y if frames else y[0], joint=joint
    )
    return answer(e) if frames else answer(e, sum=spread(e.functional("sum")))


def static(name: str, loose: Loose | None = None, **settings: Any) -> None:
    """A problem of `inverted`."""
    add(f"static/{name}", lambda: inverted(**settings), loose)


SUMS = np.stack([np.ones(30), np.linspace(0, 1, 30)])
CONTACTS = np.arange(30).reshape(10, 3)
for penalty in ("identity", "gradient", "laplacian", "second_difference"):
    static(f"{penalty}/given", penalty=penalty, choice=LAM)
    static(f"{penalty}/default", penalty=penalty)
    static(f"{penalty}/default, noise not stated", penalty=penalty, stated=False)
for rule in RULES:
    static(f"gradient/{rule}", penalty="gradient", choice=rule)
static("matrix/given", penalty=np.eye(30) - 0.5 * np.eye(30, k=1), choice=LAM)
static("truncated/given", method="tsvd", choice=0.05)
static("truncated/default", method="tsvd")
static("identity/absolute", choice=Absolute(0.5))
static("frames/given", frames=True, choice=LAM)
static("frames/default", frames=True)
static("frames/each its own", frames=True, joint=False, choice="gcv")
static("correlated noise/given", choice=LAM,
       noise=1e-4 * 0.5 ** np.abs(np.subtract.outer(np.arange(24), np.arange(24))))  # fmt: skip
static("interpolated/given", choice=LAM, noise=0.02,
       onto=np.kron(np.eye(12), [[1.0], [0.5]]) + np.kron(np.eye(12, k=1), [[0.0], [0.5]]))  # fmt: skip
static("non-negative/given", choice=LAM, constraints=[NonNegative()])
static("non-negative/default", constraints=[NonNegative()])
static("non-negative, laplacian/given", penalty="laplacian", choice=LAM, constraints=[NonNegative(np.arange(15))])
static("bounds/given", choice=LAM, constraints=[Bounds(0.0, 1.05)])
static("support/given", choice=LAM, constraints=[Support(np.arange(5, 25))])
static("resultants/given", penalty="gradient", choice=LAM, constraints=[Resultant(SUMS, [12.0, 5.0])])
static("resultants, soft/given", choice=LAM, constraints=[Resultant(SUMS, [12.0, 5.0], [0.04, 0.04])])
static("resultants, non-negative/default", constraints=[NonNegative(), Resultant(SUMS[:1], [12.0])])
static("cones/given", choice=LAM, constraints=[FrictionCone(0.5, CONTACTS)])
static("pyramids/given", choice=LAM, constraints=[FrictionCone(0.5, CONTACTS, facets=8)])


@cache
def wing() -> tuple[ForwardModel, np.ndarray]:
    """A tapered cantilever with strain gauges and patches, and its strains."""
    beam = beams.cantilever(length=6.0, EI=lambda x: 9e5 * (1 - x / 12) ** 3, mass_per_length=20.0, elements=12)
    places = (0.2, 1.0, 2.0, 3.0, 4.0, 5.0)
    gauges = [sensors.StrainGauge(at=x, fibre=0.08 * (1 - x / 12), noise=1.5e-6) for x in places]
    model = ForwardModel(beam, gauges, bases.patches(beam, 12))
    y = model.static() @ (500 * np.sqrt(1 - (np.linspace(0.25, 5.75, 12) / 6) ** 2))
    return model, y + 1.5e-6 * np.random.default_rng(2).standard_normal(6)


def lifted(**settings: Any) -> Answer:
    """Lift on the wing with its resultants."""
    model, y = wing()
    e = StaticInversion(model, **settings).estimate(y)
    return answer(e, resultants=[spread(f) for f in e.resultants])


def calibrated() -> Answer:
    """One lambda for several readings, then one product a reading."""
    H, y, std = kernel()
    family = StaticInversion(MatrixModel(H), penalty="gradient", noise=Noise(std, **SOURCE))
    found = family.calibrate(list(y))
    return answer(family.estimate(y[1]), frozen=family.freeze()(y[2]), joint=found.lam)


add("static/wing, gradient/given", lambda: lifted(penalty="gradient", choice=LAM))
add("static/wing, gradient, non-negative/default", lambda: lifted(penalty="gradient", constraints=[NonNegative()]))
add("static/calibrated", calibrated)


# -- distributed loads ------------------------------------------------------------------------------------------------
@cache
def span() -> tuple[ForwardModel, np.ndarray, np.ndarray]:
    """A beam under hats with gauges and accelerometers, a record, its noise."""
    beam = beams.simply_supported(length=2.0, section=beams.Section.rectangle(0.05, 0.01),
                                  material=beams.materials.steel, elements=10, damping=0.03)  # fmt: skip
    gauges = [sensors.StrainGauge(at=x, fibre=0.005) for x in (0.21, 0.53, 0.87, 1.18, 1.55, 1.83)]
    model = ForwardModel(beam, [*gauges, sensors.Accelerometer(at=0.71)], bases.hats(beam, 5), modes=4)
    g = np.sin(2 * np.pi * np.outer(np.arange(100) / 400, np.arange(10, 70, 10))) * 50
    return model, *noisy(model.predict(g, 1 / 400), 0.03)


def distributed(**settings: Any) -> Answer:
    """Field deconvolution of that record."""
    model, y, std = span()
    return answer(
        FieldDeconvolution(
            model, **folded(FieldDeconvolution, {"length": 0.4, "noise": std, **SAID, **settings})
        ).estimate(y, 1 / 400)
    )


def harmonic(**settings: Any) -> Answer:
    """Amplitudes on one line."""
    model = span()[0]
    H = model.frf([17.0])[0]
    Y = H @ (np.arange(1, H.shape[1] + 1) * np.exp(0.4j * np.arange(H.shape[1])))
    rng, std = np.random.default_rng(3), 0.01 * np.abs(Y)
    Y = Y + std * (rng.standard_normal(len(Y)) + 1j * rng.standard_normal(len(Y))) / np.sqrt(2)
    return answer(HarmonicInversion(model, 17.0, noise=Noise(std, **SOURCE), **settings).estimate(Y))


for path in ("dense", "statespace"):
    add(f"field/{path}/gradient/given", lambda path=path: distributed(path=path, space="gradient", choice=LAM))
    add(f"field/{path}/laplacian, first difference/given", lambda path=path: distributed(
        path=path, space="laplacian", time="first_difference", choice=LAM))  # fmt: skip
add("field/statespace/gradient/default", lambda: distributed(path="statespace", space="gradient"))
add("field/added penalties/given", lambda: distributed(
    space="gradient", time="first_difference", ratio=0.2, choice=LAM))  # fmt: skip
add("field/shapes/given", lambda: distributed(
    shapes=np.sin(np.pi * np.outer(np.arange(1, 7), [1, 2, 3]) / 7), length=None, choice=LAM))  # fmt: skip
add("harmonic/identity/given", lambda: harmonic(choice=LAM))
add("harmonic/gradient/given", lambda: harmonic(space="gradient", length=0.4, choice=LAM))
add("harmonic/gradient/default", lambda: harmonic(space="gradient", length=0.4))


# -- frequency lines --------------------------------------------------------------------------------------------------
@cache
def lines(error: float = 0.0) -> tuple[FrfModel, np.ndarray, float]:
    """An accelerance of eight modes on 60 lines, six sensors and three loads; a response and its noise."""
    rng, f = np.random.default_rng(4), np.linspace(20.0, 300.0, 60)
    natural = np.sort(rng.uniform(25, 320, 8))
    left, right = rng.standard_normal((6, 8)), rng.standard_normal((3, 8))
    q = -(f[:, None] ** 2) / (natural**2 - f[:, None] ** 2 + 0.04j * natural * f[:, None])
    H = np.einsum("sm,km,lm->ksl", left, q, right)

    def normals(*shape: int) -> np.ndarray:
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)

    Y = np.einsum("ksl,kl->ks", H, normals(60, 3))
    sigma = 0.03 * float(np.sqrt(np.mean(np.abs(Y) ** 2)))
    off = error * np.abs(H)
    seen = [Channel(label=f"s{i}", quantity="acceleration", unit="m/s^2") for i in range(6)]
    forces = [Channel(label=f"f{j}", quantity="force", unit="N") for j in range(3)]
    model = FrfModel(f, H + off * normals(*H.shape), sensors=seen, loads=forces, variance=off**2 if error else None)
    return model, Y + sigma * normals(60, 6), sigma


def on_lines(*, error: float = 0.0, stated: bool = True, **settings: Any) -> Answer:
    """Frequency inversion of that response."""
    model, Y, sigma = lines(error)
    given = Spectra(model.frequencies, Y, noise=sigma if stated else None, noise_source="unloaded record")
    e = FrequencyInversion(model, **folded(FrequencyInversion, settings)).estimate(given)
    return answer(e, naive=e.spectrum.naive, trusted=e.trust().sum(axis=0))


@cache
def running() -> tuple[np.ndarray, np.ndarray]:
    """600 samples of the chain under two random loads, and the noise."""
    g = np.random.default_rng(6).standard_normal((600, 2))
    return noisy(chain(TWO).predict(g, DT), 0.02)


def averaged(**settings: Any) -> Answer:
    """A stationary record, averaged into cross spectra."""
    y, std = running()
    family = FrequencyInversion(
        chain(TWO), signal=Signal("stationary", segment=100), noise=Noise(std, **SOURCE), **settings
    )
    return answer(family.estimate(y, DT))


def transient(**settings: Any) -> Answer:
    """A transient, line by line."""
    y, std = pushed(samples=400)
    return answer(
        FrequencyInversion(chain(), signal="transient", noise=Noise(std, **SOURCE), **settings).estimate(y, DT)
    )


def banded() -> Answer:
    """The same behind a table of a band of FRFs."""
    y, std = pushed(samples=400)
    f = np.arange(10, 90) / (400 * DT)
    table = FrfModel.of(chain(), f)
    return answer(FrequencyInversion(table, signal="transient", noise=Noise(std, **SOURCE)).estimate(y, DT))


def domains() -> Answer:
    """The same in both domains."""
    y, std = pushed(samples=400)
    found = compare_domains(chain(), y, DT, noise=Noise(std, **SOURCE), time={"choice": LAM})
    both = answer(found.time, difference=found.difference, stated=found.stated, apart=found.apart)
    more = answer(found.frequency)
    return Answer(
        both.arrays | {f"frequency, {n}": x for n, x in more.arrays.items()}, both.words | {"take": [found.take]}
    )


add("frequency/default", on_lines)
add("frequency/transient, table of a band", banded)
add("frequency/default, noise not stated", lambda: on_lines(stated=False))
add("frequency/errors of the FRF", lambda: on_lines(error=0.03))
add("frequency/validation sensor", lambda: on_lines(validation=["s2"]))
add("frequency/least squares", lambda: on_lines(choice=0))
for over in ("neighbours", "line", "band"):
    for choice in (LAM, "gcv", "discrepancy"):
        add(f"frequency/{over}/{choice}", lambda over=over, choice=choice: on_lines(over=over, choice=choice))
for rule in ("evidence", "upre", "quasi_optimality"):
    add(f"frequency/line/{rule}", lambda rule=rule: on_lines(over="line", choice=rule))
add("frequency/line/l_curve", lambda: on_lines(over="line", choice="l_curve"),
    Loose(1e-8, "the top of a curvature is found to the root of rounding"))  # fmt: skip
add("frequency/truncated/count", lambda: on_lines(method="tsvd", count=2))
add("frequency/truncated/given", lambda: on_lines(method="tsvd", choice=0.2))
add("frequency/truncated/default", lambda: on_lines(method="tsvd"))
add("frequency/stationary/default", averaged)
add("frequency/stationary/given", lambda: averaged(choice=LAM))
add("frequency/transient/default", transient)
add("frequency/transient/given", lambda: transient(choice=LAM))
add("compare_domains", domains)


# -- unknown places, priors -------------------------------------------------------------------------------------------
@cache
def candidates() -> tuple[ForwardModel, np.ndarray, np.ndarray]:
    """A beam with seven candidate places, a record of an impact between two of them, and its noise."""
    beam = beams.simply_supported(length=2.0, section=beams.Section.rectangle(0.05, 0.01),
                                  material=beams.materials.steel, elements=10, damping=damping.Modal(0.03))  # fmt: skip
    seen = [sensors.Accelerometer(at=x, direction="Z", label=f"a{x}") for x in (0.25, 0.85, 1.45)]
    model = ForwardModel(beam, seen, [loads.Point(at=x, direction="Z") for x in np.linspace(0.4, 1.6, 7)], modes=5)
    one = model.with_loads([loads.Point(at=0.7, direction="Z")])
    g = 100 * np.sin(np.pi * (np.arange(120) - 10).clip(0, 10) / 10)
    return model, *noisy(one.predict(g[:, None], DT), 0.02)


def located(**settings: Any) -> Answer:
    """The place of that impact."""
    model, y, std = candidates()
    found = LocationSearch(model, noise=Noise(std, **SOURCE), settings={"choice": LAM}, **settings).estimate(y, DT)
    assert found.estimate is not None
    e = answer(found.estimate, scores=found.scores, found=found.found, ratio=found.ratio, residual=found.residual)
    words = {"codes": sorted(f.code for f in found.flags), "best": [str(b) for b in found.best]}
    return Answer(e.arrays, e.words | words)


def recommended() -> Answer:
    """Which prior fits, and by how much."""
    y, std = pushed(samples=240)
    found = recommend(chain(), y, DT, noise=Noise(std, **SOURCE))
    numbers = {"scores": list(found.scores.values()), "evidence": list(found.evidence.values()),
               "kurtosis": [found.kurtosis], "width": [found.width]}  # fmt: skip
    words = {"prior": [found.prior], "knots": [str(found.knots)], "compared": sorted(found.evidence)}
    return Answer({n: np.asarray(v, float) for n, v in numbers.items() if len(v)}, words)


add("location/candidates", lambda: located(search=Search(refine=False), choice=0.01))
add("location/refined", lambda: located(choice=0.01))


# -- tracking ---------------------------------------------------------------------------------------------------------
STEADY = Loose(1e-8, "gains count as settled where a sample changes a variance by 1e-10, and many samples follow")
TUNED = Loose(1e-5, "the search ends where a step promises 1e-4 of a log-likelihood, a number 0.01 of its std")
WALK, MATERN, NOISE = RandomWalk(200.0), Matern32(20.0, 0.05), np.array([0.3, 2e-5, 2e-5])


@cache
def housed(at: tuple[str, ...] = TWO) -> ForwardModel:
    """The chain with a second displacement sensor, so that constants of two loads are seen."""
    return chain(at, (sensors.Displacement("3+X", label="d3"),))


@cache
def service() -> np.ndarray:
    """400 samples of the chain under two slow loads."""
    t = np.arange(400) * DT
    g = np.stack([20 * np.sin(2 * np.pi * 4 * t), 15 * np.sin(2 * np.pi * 7 * t + 1) + 5], axis=1)
    return housed().predict(g, DT) + NOISE * np.random.default_rng(8).standard_normal((400, 3))


def tracked(
    kind: str = "track", gaps: bool = False, spike: bool = False, at: tuple[str, ...] = TWO, **settings: Any
) -> Answer:
    """Fit to 250 samples, then the whole record by steps, as a block, or smoothed."""
    y = service().copy()
    if gaps:
        y[300:320, 0] = y[310:330, 1] = np.nan
    if spike:
        y[300, 1] += 0.01
    settings = {"noise": NOISE, **SAID, **settings}
    tracker = LoadTracker(housed(at), **folded(LoadTracker, settings)).fit(y[:250], DT)
    c = tracker.certificate
    said = {"certificate": [c.verdict], "flags": sorted({f.code for f in tracker.flags})}
    if kind == "step":
        rows = [tracker.step(row) for row in y]
        arrays = {"load": kept(np.array([load for load, _ in rows])), "std": kept(np.array([std for _, std in rows]))}
        found = Answer(arrays, {"flags after": sorted({f.code for f in tracker.flags})})
    else:
        found = answer(getattr(tracker, kind)(y, DT))
    numbers = {n: np.array([x]) for n, x in tracker.fitted.numbers.items()}
    return Answer(found.arrays | numbers, found.words | said)


def tracking(name: str, loose: Loose | None = STEADY, **settings: Any) -> None:
    """A problem of `tracked`."""
    add(f"tracking/{name}", lambda: tracked(**settings), loose)


def swept() -> Answer:
    """The sweep of the variance of the loads."""
    found = q_sweep(housed(), service()[:200], DT, prior=WALK, points=9, noise=NOISE)
    names = ("factors", "innovation", "residual", "roughness", "nis", "loglik")
    return Answer({n: np.asarray(getattr(found, n), float) for n in names},
                  {"points": [str(found.corner), str(found.plateau), str(found.likely)]})  # fmt: skip


add("recommend", recommended, TUNED)
for kind in ("step", "track", "smooth"):
    tracking(f"random walk/{kind}", kind=kind, prior=WALK)
    tracking(f"matern32/{kind}", kind=kind, prior=MATERN)
tracking("matern52", prior=Matern52(20.0, 0.05))
tracking("ou", prior=OU(20.0, 0.05))
tracking("white", prior=White(20.0))
tracking("periodic and walk", prior=[Periodic(20.0, 0.25, 1.0, decay=2.0), WALK])
tracking("gaps/step", kind="step", prior=WALK, gaps=True)
tracking("gaps/smooth", kind="smooth", prior=MATERN, gaps=True)
tracking("spike and gate/step", kind="step", prior=MATERN, spike=True)
tracking("spike and no gate", prior=MATERN, spike=True, gate=None)
tracking("late answers", prior=MATERN, lag=8)
tracking("error of the model", prior=MATERN, model_error={"stiffness": 0.02})
tracking("drifting offset", prior=MATERN, bias=[0.1, 0.0, 0.0])
tracking("by filterpy", prior=MATERN, engine="filterpy", gate=None)
tracking("tuned by likelihood", TUNED, prior="matern32", at=("3+X",))
tracking("tuned, noise not stated", TUNED, prior="random_walk", at=("3+X",), noise=None, noise_source=None)
add("tracking/sweep", swept)


# -- gel pads ---------------------------------------------------------------------------------------------------------
PRESS = Press(at=(0.4e-3, -0.3e-3), radius=2.5e-3, force=1.0, shear=(0.25, 0.0))


@cache
def pad(layers: int = 2, element: str = "bbar") -> Pad:
    """A pad of 10 x 9 x 3 mm."""
    return Pad(size=(10e-3, 9e-3), thickness=3e-3, E=147e3, nu=0.3223, elements=(8, 7), layers=layers,
               element=element, allow=("W115",))  # fmt: skip


@cache
def moved(layers: int = 2, element: str = "bbar") -> tuple[np.ndarray, np.ndarray]:
    """Places of markers, and their noisy motion under a press."""
    x, y = np.meshgrid(np.linspace(-4.5e-3, 4.5e-3, 10), np.linspace(-4e-3, 4e-3, 9))
    at, here = np.column_stack([x.ravel(), y.ravel()]), pad(layers, element)
    U = here.displacements(here.surface.forces(PRESS.traction(here.nodes2d)))
    u = np.asarray(here.from_surface(at) @ U.ravel()).reshape(-1, 3)
    return at, u + 2e-6 * np.random.default_rng(9).standard_normal(u.shape)


def mapped(e: Any) -> Answer:
    """A force map with its resultant."""
    r = e.resultant()
    return answer(e, resultant=r.value, resultant_std=r.std)


def pressed(axes: str = "XYZ", **settings: Any) -> Answer:
    """Force map of the multilayer pad."""
    at, u = moved()
    return mapped(
        MultilayerPad(pad(), Markers(at, 2e-6, axes), **SAID, **{"penalty": "identity", **settings}).estimate(
            u[:, : len(axes)]
        )
    )


def slim() -> Answer:
    """F = K U, the baseline of the field."""
    at, u = moved(1, "standard")
    return mapped(GelSlim(pad(1, "standard"), Markers(at, 2e-6, "XYZ"), interpolation="linear").estimate(u))


def gel(**settings: Any) -> Answer:
    """Point forces from two layers of markers."""
    line = np.arange(5) * 2e-3 - 4e-3
    at = np.array([(x, y) for y in line for x in line])
    under = np.vstack([np.column_stack([at, np.full(25, -1e-3 * d)]) for d in (0.5, 1)])
    s = GelForce(HalfSpace(E=0.147e6, nu=0.49), at, Markers(under, 5e-6, "XYZ"), **SAID, **settings)
    f = np.zeros((25, 3))
    f[12], f[13] = (0.3, 0.0, -1.0), (0.0, 0.0, -0.5)
    u = (s.model.static() @ f.ravel()).reshape(-1, 3) + 5e-6 * np.random.default_rng(10).standard_normal((50, 3))
    return mapped(s.estimate(u))


def layered(full: bool = True, axes: str = "XY", **settings: Any) -> Answer:
    """Tractions on a layer by its waves, from a full grid of places or from scattered markers."""
    gel, rng, line = Layer(3e-3, 147e3, 0.3223), np.random.default_rng(11), np.linspace(-6e-3, 6e-3, 9)
    at = np.array([(x, y) for y in line for x in line]) if full else rng.uniform(-6e-3, 6e-3, (60, 2))
    u = PRESS.displacement(gel, at)[:, : len(axes)]
    s = LayerSensor(gel, Markers(at, 5e-6, axes), **SAID, **settings)
    return mapped(s.estimate(u + 5e-6 * rng.standard_normal(u.shape)))


add("tactile/layer/default", layered)
add("tactile/layer, normal load/given", lambda: layered(axes="XYZ", choice=LAM))
add(
    "tactile/layer, scattered markers/given",
    lambda: layered(False, "XYZ", choice=LAM),
    Loose(1e-5, "conjugate gradients end at 1e-8 of their first residual, those of bands at 1e-4"),
)
add("tactile/pad/given", lambda: pressed(choice=LAM))
add("tactile/pad/default", pressed)
add("tactile/pad in the plane, laplacian/given", lambda: pressed("XY", penalty="laplacian", choice=LAM))
add("tactile/pad, no pull/given", lambda: pressed(choice=LAM, contact=ContactLaw(no_pull=True)))
add("tactile/pad, friction/given", lambda: pressed(choice=LAM, contact=ContactLaw(friction=0.5)))
add("tactile/stiffness product", slim)
add("tactile/point forces/least squares", lambda: gel(choice=0, penalty=None))
add("tactile/point forces/discrepancy", lambda: gel(choice="discrepancy"))


# -- plates by their shape, and from full fields ----------------------------------------------------------------------
HELD = Loose(1e-6, "edges hold the functions to 1e-10 of their size: four derivatives of what rounding leaves")


@cache
def plate() -> Any:
    """A simply supported plate, 1 x 0.8 m."""
    material = plates.Material(E=70e9, rho=2700, nu=0.33)
    return plates.plate(lengths=(1, 0.8), thickness=5e-3, material=material, elements=4, damping=0.01)


def sensed(*, samples: int = 0, **settings: Any) -> Answer:
    """Patches from 16 rosettes of two, static or over time."""
    placed = [sensors.StrainGauge(at=(x, y), fibre=2.5e-3, angle=a, label=f"{x} {y} {a:.1f}")
              for x in (0.1, 0.37, 0.63, 0.9) for y in (0.1, 0.3, 0.5, 0.7) for a in (0.0, np.pi / 2)]  # fmt: skip
    y = np.array([np.sin(np.pi * g.at[0]) * np.sin(np.pi * g.at[1] / 0.8) * (1.0 if g.angle else 0.6) for g in placed])
    if samples:
        y = np.cos(0.05 * np.arange(samples))[:, None] * y
    y = 1e-5 * (y + 0.01 * np.random.default_rng(9).standard_normal(y.shape))
    family = ShapeSensing(plate(), placed, loads=bases.patches(plate(), (5, 4)), noise=1e-7, **settings)
    return answer(family.estimate(y, 1e-3 if samples else None))


def full_field(**settings: Any) -> Answer:
    """Pressure in the windows of 31 x 41 points, twelve frames."""
    x, y, t = np.linspace(0, 1, 41), np.linspace(0, 0.8, 33), np.arange(12)
    w = np.sin(np.pi * x) * np.sin(np.pi * y / 0.8)[:, None] * np.cos(0.1 * t)[:, None, None]
    w = 1e-4 * (w + 1e-3 * np.random.default_rng(8).standard_normal(w.shape))
    found = virtual_fields(FieldFrames(w, "deflection", (x[1], y[1]), **settings), plate(), noise=1e-7)
    there = np.isfinite(found.pressure)
    return Answer({"pressure": kept(found.pressure[there]), "std": kept(found.std), "bias": kept(found.bias),
                   "window": np.array(found.window, float)})  # fmt: skip


add("shape/static/evidence", sensed, HELD)
add("shape/static/given", lambda: sensed(choice=1e-3), HELD)
add("shape/record/evidence", lambda: sensed(samples=30), Loose(1e-5, "a length is searched to 0.05 of its logarithm"))
add("full field/at rest", full_field, Loose(1e-8, "sums over windows cancel to 1e-4 of their terms"))
add("full field/acceleration of the frames", lambda: full_field(dt=1e-3),
    Loose(1e-5, "a length is searched to 0.05 of its logarithm"))  # fmt: skip


# -- measured records -------------------------------------------------------------------------------------------------
def five_hits(**settings: Any) -> Answer:
    """The fifth of five hammer hits from the other four: the first 2048 samples."""
    stated = {"columns": ("time", "force", "acceleration"), "units": {"force": "N", "acceleration": "m/s^2"}}
    records = [read(measured("hammer_five_hits", f"measurements_{k}.npy"), **stated) for k in range(1, 6)]
    model = MeasuredModel.from_hits(records[:4], force="force", responses=["acceleration"])
    return answer(Deconvolution(model, **folded(Deconvolution, settings)).estimate(records[4].select(["acceleration"])))


def two_hits(**settings: Any) -> Answer:
    """One hit from the other, two accelerometers."""
    with np.load(measured("hammer_two_hits", "lvm_two_hits.npz")) as file:
        hits = [np.asarray(file[name], float) for name in ("hit1", "hit2")]
    model = MeasuredModel.from_hits(hits[:1], dt=1 / 1024, force=0, responses=[1, 2])
    return answer(Deconvolution(model, **folded(Deconvolution, settings)).estimate(hits[1][:, 1:], 1 / 1024))


def shaken() -> Answer:
    """Force of a shaker on the lines of its drive."""
    names = (("drive", "voltage", "V"), ("force", "force", "N"), ("tip", "acceleration", "m/s^2"))
    channels = [Channel(label=a, quantity=b, unit=c) for a, b, c in names]
    with np.load(measured("cantilever_shaker", "cantilever_shaker.npz")) as file:
        tests = [Record(file[name][16000:32000, 1:] * [1.0, 4.4482216, 9.80665], 1 / 3200, channels, name=name)
                 for name in ("test1", "test2")]  # fmt: skip
    welch = {"window": "boxcar", "segment": 320, "overlap": 0}
    whole = FrfModel.from_records(tests[0], forces="force", responses="tip", **welch)
    spectra = structures.cross_spectra(tests[1].select(["tip"]), **welch)
    return answer(FrequencyInversion(whole.at([100.0, 120.0, 150.0]), band=(90.0, 160.0)).estimate(spectra))


add("measured/five hits/given", lambda: five_hits(choice=LAM))
add("measured/five hits/default", five_hits)
add("measured/two hits/given", lambda: two_hits(choice=LAM))
add("measured/two hits/default", two_hits)
add("measured/shaker", shaken)
