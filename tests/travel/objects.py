"""One of every kind of object that users hold: how it is made, and what it is asked.

`KINDS` names them. Asking is a function of a module, so that a process of a pool can be asked too; what it returns is
compared by its bits (`bits`). What has a state (a tracker, a pad under a contact law) is asked for its next frames.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from datetime import UTC, datetime
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from loadid import (
    AutomaticInversion,
    Deconvolution,
    FieldDeconvolution,
    FrequencyInversion,
    Guards,
    HarmonicInversion,
    Lambda,
    LoadTracker,
    LocationSearch,
    ModelErrors,
    Noise,
    Online,
    Penalty,
    Priors,
    Record,
    Search,
    ShapeSensing,
    Signal,
    SparseDeconvolution,
    Sparsity,
    Spectra,
    StaticInversion,
    compare_domains,
    design,
    fullfield,
    paths,
    q_sweep,
    recommend,
    sources,
    validate,
    vibration,
)
from loadid._inverse.convolved.path import ConvolvedPath
from loadid._inverse.problem import LinearProblem
from loadid._inverse.svd import SVDPath
from loadid.constraints import Bounds, FrictionCone, NonNegative, Resultant, Support
from loadid.priors import OU, Matern32, Matern52, Periodic, RandomWalk, Sum, White
from structures import (
    Dof,
    ForwardModel,
    FrfModel,
    MeasuredModes,
    TrainingRecords,
    bases,
    beams,
    cross_spectra,
    damping,
    files,
    frames,
    identify_modes,
    loads,
    motion,
    plates,
    sensors,
    shape_sensing,
    solids,
)
from structures._elements import circular
from structures._elements.members import Material
from structures._models.mapped import mapped
from structures._system.factor import Factor
from tactile import (
    ContactLaw,
    ContactPrior,
    Eye,
    GelForce,
    GelMonitor,
    GelSlim,
    HalfSpace,
    ImageMotion,
    Interpolation,
    Layer,
    LayerGrid,
    LayerSensor,
    LearnedSensor,
    Markers,
    MarkerTracker,
    MultilayerPad,
    Pad,
    Press,
    RigidBody,
    Sphere,
    Tolerances,
    Wrench,
)
from tactile import design as skins
from tests import lab, mounted
from tests.benchmarks.assembly import hexahedra, skewed, tetrahedra
from tests.golden import problems as p
from tests.inverse.statespace.cases import case
from tests.learning import made as learned
from tests.learning import presses as taught
from tests.tactile import test_eye as seen

DT = p.DT
GEL = Material(E=2e5, rho=1e3, nu=0.45)
SIDES = (6e-3, 4e-3, 3e-3)


# -- what an answer is ------------------------------------------------------------------------------------------------
def bits(value: Any) -> Any:
    """A value as nested tuples of text and bytes: equal for equal bits."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if sparse.issparse(value):
        csc = value.tocsc()
        return tuple(bits(x) for x in (csc.data, csc.indices, csc.indptr))
    if isinstance(value, Mapping):
        return tuple((str(k), bits(v)) for k, v in value.items())
    if isinstance(value, list | tuple):
        return tuple(bits(v) for v in value)
    if isinstance(value, float | np.floating | complex):
        return np.asarray(value).tobytes()
    if is_dataclass(value) and not isinstance(value, type):
        return type(value).__name__, tuple((f.name, bits(getattr(value, f.name))) for f in fields(value) if f.compare)
    return str(value)


def said(e: Any) -> Any:
    """What an estimate says: load, band, residual, sums with their std, flags, facts, choice of lambda."""
    facts = {k: v for k, v in e.facts.items() if isinstance(v, int | float | str | bool)}
    flags = [(f.code, f.message, f.evidence.value) for f in e.flags]
    choice = None if e.choice is None else (e.choice.lam, e.choice.rule, e.choice.verdict)
    return bits((e.load, e.std, e.bias, e.residual, *summed(e), facts, flags, choice))


def summed(e: Any) -> tuple[Any, Any]:
    """Std of a weighted sum of the loads, correlations included, and what the penalty hides of it."""
    if e.posterior is None or e.load.dtype.kind == "c":
        return None, None
    w = np.cos(np.arange(e.load.size)).reshape(e.load.shape)
    return e.posterior.variance(w), e.functional(w).std


# -- questions --------------------------------------------------------------------------------------------------------
def shown(value: Any) -> Any:
    """An object by its text, and by its fields where it has some."""
    return repr(value), bits(value)


def model_says(model: Any, *, lines: bool = True, history: bool = True, still: bool = True) -> Any:
    """Static, over lines, in time; fingerprint."""
    given: list[Any] = [model.fingerprint, [c.label for c in (*model.sensors, *model.loads)]]
    if still:
        given.append(model.static())
    if lines:
        given.append(model.frf(np.array([3.0, 17.0])))
    if history:
        space = model.state_space(DT, "zoh")
        given += [space.A, space.B, space.C, space.D]
        given.append(model.predict(np.ones((20, len(model.loads))), DT))
    return bits(given)


def on_its_lines(model: Any) -> Any:
    """Of a model that is a table of frequency lines."""
    f = model.frequencies[3:5]
    return bits((model.frf(f), model.frf_variance(f), model.fingerprint))


def basis_says(basis: Any) -> Any:
    """Columns, resultants, tractions, and values between the points."""
    x = np.linspace(1.0, 2.0, len(basis))
    own = basis.own_structure
    places = basis.coordinates[: min(4, len(basis))]
    return bits((basis.columns(own), basis.resultant(), basis.to_traction(x), basis.evaluate(x, places),
                 [load.label for load in basis]))  # fmt: skip


def solved(factor: Factor) -> Any:
    """A right-hand side."""
    return bits(factor.solve(np.linspace(0, 1, factor.n)))


def estimated(family: Any, *given: Any, **more: Any) -> Any:
    """Its estimate of a record."""
    return said(family.estimate(*given, **more))


def placed(family: LocationSearch) -> Any:
    """Where the load of the record was."""
    _, y, _ = p.candidates()
    return located(family.estimate(y, DT))


def located(found: Any) -> Any:
    """Places, rivals and the load."""
    return bits((found.scores, found.found, found.covariance, found.where, found.summary())), said(found.estimate)


def drawn(family: StaticInversion) -> Any:
    """Loads of its posterior."""
    y = p.kernel()[1]
    return bits(family.sample(y[0], draws=5)), estimated(family, y[1])


def fitted(family: LoadTracker) -> Any:
    """The loads of the record that it is fitted to."""
    return estimated(family, p.service()[:200], DT)


def goes_on(tracker: Any) -> Any:
    """Its answers to the next samples, one by one and as a block: gaps, a spike and a step among them."""
    start, y = tracker.counts["samples"] % 400, p.service().copy()
    y[60:70, 0], y[95, 1], y[140:, 2] = np.nan, y[95, 1] + 0.02, y[140:, 2] + 1e-4
    rows = np.roll(y, -start, axis=0)
    one = [tracker.step(row) for row in rows[:37]]
    block = tracker.track(rows[37:90], DT)
    flags = [(f.code, f.message) for f in tracker.flags]
    return bits((one, block.load, block.std, tracker.counts, flags, tracker.phase, tracker.row_alarms))


def tells(e: Any) -> Any:
    """What an estimate says, its pages and its pictures."""
    figure = e.plot()
    sizes = [len(axes.lines) for axes in figure.axes]
    page = {k: v for k, v in e.to_dict().items() if k != "provenance"}
    return said(e), e.summary(details=True), json.dumps(page), sizes, bits(e.band()), bits(dict(e.provenance))


def mapped_says(e: Any) -> Any:
    """A force map."""
    r = e.resultant()
    return bits((e.load, e.std, e.traction(), r.value, r.std, e.summary(), [f.message for f in e.flags]))


def frame(sensor: Any, u: np.ndarray) -> Any:
    """The map of a frame."""
    return mapped_says(sensor.estimate(u))


def pressed_pad(pad: Pad) -> Any:
    """Its stiffness, and how it moves under a press."""
    f = pad.surface.forces(p.PRESS.traction(pad.nodes2d))
    return bits((pad.stiffness, pad.displacements(f), pad.strain(f), repr(pad)))


def watched(eye: Eye) -> Any:
    """The motion in the next frame."""
    apparent, flags = eye.read(seen.picture(seen.PRESS, 3))
    return bits((apparent, eye.noise, [f.message for f in flags if f is not None]))


def followed(tracker: MarkerTracker) -> Any:
    """The dots of the next frame."""
    found = tracker.step(seen.picture(seen.PRESS, 4))
    return bits((found.points, found.places, found.lost))


def frozen_says(frozen: Any) -> Any:
    """The loads of two readings."""
    y = p.kernel()[1]
    return bits((frozen(y[0]), frozen(y[1])))


def checked(monitor: GelMonitor) -> Any:
    """Whether the gel has changed."""
    found = monitor.check(0.9 * monitor.reference, now=datetime(2026, 3, 4, tzinfo=UTC))
    return bits((found.verdict, found.gain, found.gain_std, found.significance))


def again(found: Any) -> Any:
    """A recommendation, and the estimate by the prior that it took."""
    return bits((found.scores, found.evidence, found.reason)), said(found.estimate(p.pushed(samples=240)[0], DT))


def moved(layer: Any) -> Any:
    """Motion of points under a press, and the press of a sphere."""
    return bits(p.PRESS.displacement(layer, np.array([[1e-3, 0.0], [0.0, 2e-3]])))


# -- how they are made ------------------------------------------------------------------------------------------------
def bent() -> ForwardModel:
    """A tapered beam, its stiffness a function."""
    beam = beams.cantilever(length=2.0, EI=lambda x: 900 * (1 - x / 4) ** 3, mass_per_length=2.0, elements=8,
                            damping=damping.Rayleigh(0.5, 1e-5))  # fmt: skip
    seen_at = [sensors.StrainGauge(at=0.3, fibre=0.01), sensors.Accelerometer(at=1.6), sensors.Velocity(at=1.1)]
    return ForwardModel(beam, seen_at, [loads.Point(at=1.0), loads.Patch(x=(0.4, 0.9)), loads.Moment(at=1.5)], modes=4)


def sheet(damped: Any = 0.02) -> Any:
    """A rectangular plate."""
    return plates.plate(lengths=(0.4, 0.3), thickness=2e-3, material=beams.materials.steel, elements=(4, 3),
                        damping=damped)  # fmt: skip


def on_a_plate(damped: Any = 0.02, **settings: Any) -> ForwardModel:
    """A plate under patches."""
    plate = sheet(damped)
    return ForwardModel(plate, [sensors.Accelerometer(at=(0.1, 0.1)), sensors.Displacement(at=(0.3, 0.2))],
                        bases.patches(plate, (2, 2)), **settings)  # fmt: skip


def round_plate() -> ForwardModel:
    """A clamped disc under pressure."""
    disc = circular.plate(radius=0.1, thickness=1e-3, material=beams.materials.steel, elements=6, harmonics=2)
    return ForwardModel(disc, [sensors.Displacement(at=(0.02, 0.01))], [circular.Pressure()])


def house() -> ForwardModel:
    """A portal frame."""
    portal = frames.portal(width=4.0, height=3.0, section=beams.Section.rectangle(0.1, 0.1),
                          material=beams.materials.steel, damping=0.02)  # fmt: skip
    free = [d for d in portal.dofs if d not in portal.supports and d.axis == 1]
    return ForwardModel(portal, [sensors.Displacement(free[0])], [loads.Point(free[-1])])


@cache
def block() -> Any:
    """A block of rubber."""
    return solids.block(lengths=SIDES, elements=(3, 2, 2), material=GEL, element="bbar")


def solid(kind: str = "C3D8") -> ForwardModel:
    """A solid of skewed hexahedra, or of tetrahedra with ten nodes."""
    cells = (skewed(block().coordinates, 1e-4), hexahedra(block())) if kind == "C3D8" else tetrahedra((2, 2, 2), SIDES)
    body = solids.mesh(*cells, material=GEL, kind=kind, fixed="bottom")
    top = int(np.argmax(np.linalg.norm(body.coordinates, axis=1)))
    return ForwardModel(body, [sensors.Displacement(Dof(top, 1))], [loads.Point(Dof(top, 3))])


def crossing() -> ForwardModel:
    """A load that moves along a beam."""
    beam = beams.simply_supported(length=2.0, section=beams.Section.rectangle(0.05, 0.01),
                                  material=beams.materials.steel, elements=8, damping=damping.Modal(0.03))  # fmt: skip
    gauge = [sensors.Displacement(at=x, direction="Z", label=f"d{x}") for x in (0.7, 1.2)]
    return ForwardModel(beam, gauge, [loads.MovingPoint(np.linspace(0.3, 1.7, 60), label="truck")], modes=3)


def crossed(family: Deconvolution) -> Any:
    """The load that moved."""
    return estimated(family, crossing().predict(np.full((60, 1), 100.0), DT) + 1e-7, DT)


def sound(model: Any = None) -> tuple[Any, np.ndarray, np.ndarray]:
    """The chain, made anew, with its record and noise."""
    y, std = p.pushed()
    return (p.chain.__wrapped__() if model is None else model), y, std


def histories(family: type = Deconvolution, model: Any = None, **settings: Any) -> Any:
    """A family for that record."""
    known, _, std = sound(model)
    return family(known, noise=Noise(std, **p.SOURCE), **settings)


def deconvolution(**settings: Any) -> tuple[Callable[[], Any], Callable[[Any], Any]]:
    """Deconvolution of that record."""
    return partial(histories, **settings), partial(estimated, record=p.pushed()[0], dt=DT)


def static(**settings: Any) -> Callable[[], StaticInversion]:
    """Static inversion of readings under a smooth kernel."""
    H, _, std = p.kernel()
    return lambda: StaticInversion(H, noise=Noise(std, **p.SOURCE), **settings)


def few_contacts(constraint: Any) -> StaticInversion:
    """Nine loads under a constraint."""
    return StaticInversion(p.kernel()[0][:, :9], noise=0.02, choice=0.1, constraints=[constraint])


def calibrated(**settings: Any) -> StaticInversion:
    """With lambda from several readings."""
    family = static(penalty="gradient", **settings)()
    family.calibrate(list(p.kernel()[1]))
    return family


def tracker_of(seconds: int = 0, **settings: Any) -> Any:
    """A tracker after so many samples."""
    made = LoadTracker(p.housed.__wrapped__(), noise=Noise(p.NOISE, **p.SOURCE), **settings)
    found = made.fit(p.service()[:250], DT)
    for row in p.service()[:seconds]:
        found.step(row)
    return found


def padded(**settings: Any) -> MultilayerPad:
    """A multilayer pad."""
    at, _ = p.moved()
    return MultilayerPad(p.pad.__wrapped__(), Markers(at, 2e-6, "XYZ"), **p.SAID, **settings)


def slim(**settings: Any) -> GelSlim:
    """A pad by its stiffness."""
    at, _ = p.moved(1, "standard")
    return GelSlim(p.pad.__wrapped__(1, "standard"), Markers(at, 2e-6, "XYZ"), interpolation="linear", **settings)


def gel() -> GelForce:
    """Point forces over two layers of markers."""
    line = np.arange(5) * 2e-3 - 4e-3
    at = np.array([(x, y) for y in line for x in line])
    under = np.vstack([np.column_stack([at, np.full(25, -1e-3 * d)]) for d in (0.5, 1)])
    return GelForce(HalfSpace(E=0.147e6, nu=0.49), at, Markers(under, 5e-6, "XYZ"), **p.SAID, choice="discrepancy")


def layered(scattered: bool = False) -> LayerSensor:
    """A layer by its waves."""
    at, _ = p.moved()
    at = at + 1e-4 * np.random.default_rng(3).standard_normal(at.shape) if scattered else at
    return LayerSensor(Layer(h=3e-3, E=0.147e6, nu=0.3223), Markers(at, 2e-6, "XYZ"), **p.SAID)


@cache
def gel_motion() -> np.ndarray:
    """Motion of its markers."""
    f = np.zeros((25, 3))
    f[12] = (0.3, 0.0, -1.0)
    clean = (gel().model.static() @ f.ravel()).reshape(-1, 3)
    return clean + 5e-6 * np.random.default_rng(10).standard_normal((50, 3))


def monitor() -> GelMonitor:
    """A gel in use."""
    layer, points = Layer(h=3e-3, E=0.147e6, nu=0.45), p.moved()[0]
    maps = np.array([Press(at=(0.0, 0.0), radius=r, force=1.0).displacement(layer, points) for r in (1e-3, 2e-3)])
    return GelMonitor(maps, noise=1e-7, calibrated=datetime(2026, 3, 1, tzinfo=UTC))


def lines() -> tuple[FrequencyInversion, Spectra]:
    """Frequency inversion and its spectra."""
    model, Y, sigma = p.lines.__wrapped__(0.03)
    return FrequencyInversion(model), Spectra(model.frequencies, Y, noise=sigma, noise_source="unloaded record")


def field() -> FieldDeconvolution:
    """Distributed loads over time."""
    model, _, std = p.span.__wrapped__()
    return FieldDeconvolution(model, space="gradient", length=0.4, choice=p.LAM, noise=Noise(std, **p.SOURCE))


def gauged() -> tuple[Any, Any]:
    """A plate and its gauges."""
    places = [(0.1, 0.07), (0.2, 0.15), (0.3, 0.22), (0.12, 0.2), (0.28, 0.09)]
    return sheet(), [sensors.StrainGauge(at=at, fibre=1e-3, noise=1e-7, angle=0.3) for at in places]


def frames_of_a_field() -> Any:
    """Deflections on a grid."""
    x = np.linspace(0, 1, 40)
    return fullfield.FieldFrames(np.sin(3 * x)[None, :, None] * np.cos(x), "deflection", (0.01, 0.01))


def sensed(family: Any) -> Any:
    """Displacements of a plate."""
    found = family.estimate(np.linspace(1e-5, 3e-5, 5))
    return bits((found.values, found.std, found.covariance(np.eye(3, len(found.gain)))))


def searching(**settings: Any) -> LocationSearch:
    """Candidates for the place of an impact."""
    model, _, std = p.candidates.__wrapped__()
    return LocationSearch(model, noise=Noise(std, **p.SOURCE), settings={"choice": p.LAM}, choice=0.01, **settings)


def one_line() -> tuple[HarmonicInversion, np.ndarray]:
    """Amplitudes on one line."""
    model = p.span.__wrapped__()[0]
    return HarmonicInversion(model, 17.0, noise=0.01, space="gradient", length=0.4), model.frf([17.0])[0] @ np.ones(6)


def path_of_ones_own() -> SVDPath:
    """A path of one's own."""
    H, y, std = p.kernel()
    return SVDPath(LinearProblem.whitened(H / std[:, None], y[0] / std))


def errors_of(path: Any) -> Any:
    """Its solution, its scalars, and the error that it predicts."""
    return bits((path.solution(0.01, 1.0).load, vars(path.at(0.02)), path.predicted_error([0.01, 0.02], 0.01, 1.0)))


def swept(path: SVDPath) -> Any:
    """What the rules say of it."""
    return str(paths.compare(path, 1.0, "repeatability")), bits(path.solution(0.01, 1.0).load)


# -- all of them ------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Kind:
    """How an object is made anew, and what it is asked."""

    make: Callable[[], Any]
    ask: Callable[[Any], Any]


def aimed() -> vibration.Target:
    """Autospectra of a field on nine lines."""
    field = lab.field(9).restricted(list(lab.TARGET))
    return vibration.Target(field.frequencies, field.autospectra, field.channels)


def imported() -> files.FeModel:
    """A plate of CalculiX."""
    folder = Path(__file__).parents[1] / "structures" / "fe" / "fixtures"
    return files.read_fe([folder / f"plate{suffix}" for suffix in (".sti", ".mas", ".inp")], units="mm, N")


@cache
def tested() -> MeasuredModes:
    """Modes of a beam, from FRFs on 61 lines."""
    f = np.arange(20.0, 81.0)
    return identify_modes(FrfModel.of(bent(), f), order=12)


KINDS: dict[str, Kind] = {}


def add(name: str, make: Callable[[], Any], ask: Callable[[Any], Any] = shown) -> None:
    """One more."""
    assert name not in KINDS, name
    KINDS[name] = Kind(make, ask)


still = partial(model_says, history=False)
add("model/chain", p.chain.__wrapped__, model_says)
add("model/beam", bent, model_says)
add("model/plate", on_a_plate, still)
add("model/plate, Krylov", partial(on_a_plate, damping.Structural(0.02), reduction="krylov", band=200.0), still)
add("model/round plate", round_plate, still)
add("model/portal", house, still)
add("model/hexahedra", solid, still)
add("model/tetrahedra", partial(solid, "C3D10"), still)
add("model/moving load", crossing, lambda m: bits(m.state_space(DT).B))
add("model/reduced", lambda: bent().reduced)
add("model/state space", lambda: bent().state_space(DT), lambda m: bits((m.impulse_response(DT, 9), m.fingerprint)))
add("model/matrix", lambda: p.MatrixModel(p.kernel()[0]), partial(model_says, lines=False, history=False))
add("model/impulse", p.table.__wrapped__, lambda m: bits((m.impulse_response(DT, 9), m.fingerprint)))
add("model/FRF", lambda: p.lines.__wrapped__(0.03)[0], on_its_lines)
add("model/measured", lambda: p.hammered.__wrapped__()[0], lambda m: bits((m.impulse_response(DT, 50), m.fingerprint)))
add("model/other unknowns", lambda: mapped(p.chain.__wrapped__(p.TWO), np.array([[1.0], [0.5]])),
    partial(model_says, history=False))  # fmt: skip
add("modes", tested)
add("model/modal", lambda: tested().model(), partial(model_says, still=False))
add("model/imported", imported, lambda m: bits((m.K, m.M, m.places, m.structure().digest)))
add("model/perturbed", lambda: bent().perturbed("stiffness", 1.1), model_says)
add("structure", sheet, lambda s: bits((s.K_free, s.M_free, s.dofs, s.digest)))
add("structure/riser", lambda: beams.riser(length=100.0, EI=1e6, mass_per_length=100.0, top_tension=2e5, elements=8),
    lambda s: bits((s.K_free, s.M_free, s.digest)))  # fmt: skip
add("factor", lambda: Factor.of(sheet()), solved)
add("motion", lambda: motion.motion(on_a_plate(), np.ones((9, 4)), DT), lambda m: bits((m.velocity, m.imbalance())))
BASES = {"hats": bases.hats, "patches": bases.patches, "polynomials": partial(bases.polynomials, degree=2),
         "nodal": bases.nodal}  # fmt: skip
for kind, made in BASES.items():
    add(f"basis/{kind} on a beam", lambda made=made: made(bent().structure), basis_says)
    add(f"basis/{kind} on a plate", lambda made=made: made(sheet()), basis_says)
    add(f"basis/{kind} on a face", lambda made=made: made(block(), region="top", components=("+X", "-N")), basis_says)
add("basis/hats of a grid", lambda: bases.hats(sheet(), (3, 2)), basis_says)
add("surface", lambda: block().field.surface("top"), lambda s: bits((s.nodes, s.coordinates, s.areas)))
for part in (damping.Rayleigh(0.5, 1e-5), damping.Modal(0.02), damping.Structural(0.01), sensors.Accelerometer("2+X"),
             sensors.StrainGauge(at=0.2, fibre=0.01), sensors.Velocity(at=0.1), sensors.Displacement("2+X", noise=0.1),
             loads.Point(at=0.3), loads.Patch(x=(0.1, 0.2)), loads.Moment(at=0.3), Dof(3, 2), beams.materials.steel,
             beams.Section.rectangle(0.1, 0.2)):  # fmt: skip
    add(f"part/{type(part).__name__}", lambda part=part: part)

for path in ("dense", "statespace", "toeplitz", "windows", "fft"):
    bare = path in ("toeplitz", "windows")
    given = {"model": p.table.__wrapped__()} if bare else {}
    add(f"family/Deconvolution, {path}", *deconvolution(choice=Lambda(p.LAM if bare else "gcv", path=path), **given))
add(
    "family/AutomaticInversion", partial(histories, AutomaticInversion), partial(estimated, record=p.pushed()[0], dt=DT)
)
add("family/Deconvolution, window", *deconvolution(choice=p.LAM, support=p.PULSE))
add("family/Deconvolution, pushes", *deconvolution(choice=p.LAM, constraints=[NonNegative()]))
add("family/Deconvolution, truncated", *deconvolution(choice=Lambda("gcv", method="tsvd", path="dense")))
add("family/Deconvolution, moving", lambda: Deconvolution(crossing(), noise=1e-6), crossed)
add("family/Deconvolution, measured", lambda: Deconvolution(p.hammered.__wrapped__()[0], choice=p.LAM),
    partial(estimated, record=p.hammered()[1], dt=DT))  # fmt: skip
few = partial(estimated, record=p.pushed()[0], dt=DT)
add("family/SparseDeconvolution", partial(histories, SparseDeconvolution), few)
add("family/SparseDeconvolution, splines", partial(histories, SparseDeconvolution, dictionary="bspline", choice=0.1),
    few)  # fmt: skip
statics = partial(estimated, found=p.kernel()[1][0])
add("family/StaticInversion", static(penalty="gradient"), drawn)
add("family/StaticInversion, bounds", partial(few_contacts, Bounds(-1.0, 1.0)), statics)
add("family/StaticInversion, wing", lambda: StaticInversion(p.wing.__wrapped__()[0], penalty="gradient"),
    partial(estimated, found=p.wing()[1]))  # fmt: skip
add("family/StaticInversion, calibrated", calibrated, partial(estimated, found=p.kernel()[1][1]))
add("family/StaticInversion, frozen", lambda: calibrated().freeze(), frozen_says)
add(
    "family/StaticInversion, frozen, pushes",
    lambda: static(choice=p.LAM, constraints=[NonNegative()])().freeze(),
    frozen_says,
)
add("family/calibration", lambda: calibrated().calibration)
add("family/FieldDeconvolution", field, partial(estimated, record=p.span()[1], dt=1 / 400))
add("family/ShapeSensing", lambda: ShapeSensing(*gauged()), partial(estimated, found=np.linspace(1e-5, 3e-5, 5)))
add("full field/FieldFrames", lambda: frames_of_a_field(), shown)
add("full field/PressureFrames", lambda: fullfield.virtual_fields(frames_of_a_field(), sheet(), window=15), shown)
add("shape sensing/InverseFEM", lambda: shape_sensing.InverseFEM(*gauged()), sensed)
add("shape sensing/QuadPlate", lambda: shape_sensing.QuadPlate.rectangle((0.4, 0.3), (4, 3), 2e-3),
    lambda plate: sensed(shape_sensing.InverseFEM(plate, gauged()[1])))  # fmt: skip
add("shape sensing/SensedField", lambda: shape_sensing.InverseFEM(*gauged()).estimate(np.linspace(1e-5, 3e-5, 5)),
    lambda found: bits((found.values, found.std)))  # fmt: skip
add("family/HarmonicInversion", lambda: one_line()[0], partial(estimated, found=one_line()[1]))
add("family/FrequencyInversion", lambda: lines()[0], partial(estimated, found=lines()[1]))
add("family/FrequencyInversion, transient", lambda: FrequencyInversion(p.chain.__wrapped__(), signal="transient"),
    partial(estimated, found=p.pushed(samples=400)[0], dt=DT))  # fmt: skip
add("family/LocationSearch", searching, placed)
add("family/LoadTracker", lambda: LoadTracker(p.housed.__wrapped__(), prior=p.WALK, noise=Noise(p.NOISE)), fitted)
for kind, own in {"": {}, ", late": {"online": Online(lag=8)}, ", filterpy": {"online": Online(engine="filterpy")},
                  ", errors": {"model_error": {"stiffness": 0.02}}}.items():  # fmt: skip
    prior = p.MATERN if kind else p.WALK
    gate = {"gate": None} if "filterpy" in kind else {}
    add(f"tracker/fresh{kind}", partial(tracker_of, 0, prior=prior, **own, **gate), goes_on)
    add(f"tracker/in mid-stream{kind}", partial(tracker_of, 77, prior=prior, **own, **gate), goes_on)

add("answer/deconvolution", lambda: histories().estimate(p.pushed()[0], DT), tells)
add("answer/dense", lambda: histories(choice=Lambda("gcv", path="dense")).estimate(p.pushed()[0], DT), tells)
add("answer/sparse", lambda: histories(SparseDeconvolution).estimate(p.pushed()[0], DT), tells)
add("answer/static", lambda: static(penalty="gradient")().estimate(p.kernel()[1]), tells)
add("answer/pushes", lambda: static(constraints=[NonNegative()])().estimate(p.kernel()[1][0]), tells)
add("answer/field", lambda: field().estimate(p.span()[1], 1 / 400), tells)
add("answer/lines", lambda: lines()[0].estimate(lines()[1]), said)
add("answer/place", lambda: searching().estimate(p.candidates()[1], DT), located)
add("answer/track", lambda: tracker_of(prior=p.WALK).track(p.service(), DT), tells)
add("answer/smooth", lambda: tracker_of(prior=p.WALK).smooth(p.service(), DT), tells)
add("answer/recommendation", lambda: recommend(p.chain.__wrapped__(), p.pushed(samples=240)[0], DT,
                                               noise=p.pushed(samples=240)[1]), again)  # fmt: skip
add("answer/domains", lambda: compare_domains(p.chain.__wrapped__(), p.pushed(samples=400)[0], DT),
    lambda d: bits((d.difference, d.stated, d.take)))  # fmt: skip
add("answer/sweep of Q", lambda: q_sweep(p.housed(), p.service()[:200], DT, prior=p.WALK, points=9, noise=p.NOISE),
    lambda s: bits((s.factors, s.loglik, s.corner)))  # fmt: skip
add("answer/contributions", lambda: sources.contributions(lines()[0].model, lines()[0].estimate(lines()[1])),
    lambda c: bits(repr(c)))  # fmt: skip
add("answer/drives", lambda: vibration.find_drives(lab.shaken(9), aimed()),
    lambda d: bits((d.matrix, d.summary())))  # fmt: skip
add("answer/transfer paths", lambda: vibration.transfer_paths(
    (case := mounted.made(12)).model, Spectra(case.model.frequencies, case.operation, case.model.sensors),
    validation=["k1"]), str)  # fmt: skip
add("vibration/profile", lambda: vibration.Profile([20.0, 80.0], [0.01, 0.04], "g^2/Hz"),
    lambda x: bits(x.at([40.0])))  # fmt: skip
add("vibration/target", lambda: aimed(), lambda t: bits((t.frequencies, t.levels, t.kind)))
add("vibration/limit", lambda: vibration.Limit("shaker 1", rms=2.0, unit="kN"), str)
add("vibration/point", lambda: vibration.VirtualPoint("foot", {n: (x, (0, 0, 1)) for n, x in mounted.HITS.items()},
    motions=("Z", "RX", "RY")), lambda v: bits(v.columns()))  # fmt: skip
add("answer/bands", lambda: sources.octave_bands(3, 20.0, 2000.0))
add("answer/validation", lambda: validate.validate(histories().estimate(p.pushed()[0], DT),
                                                   validate.Known(np.ones((p.N, 1)))), str)  # fmt: skip
add("answer/design", lambda: design.compare({"a": p.kernel()[0]}, noise=np.ones(24)), str)
add("answer/placement for hits", lambda: design.place_for_hits(p.chain(p.TWO), 1, pulse=(0.5, 1.0)),
    lambda f: str(f.table()))  # fmt: skip
add("answer/placement", lambda: design.place(p.kernel()[0][:, ::6], 8, noise=0.1), lambda f: str(f.table()))
add("path", path_of_ones_own, swept)
add("path/statespace", lambda: case(p.chain(p.TWO).state_space(DT), 80).path("identity"), errors_of)
add("path/convolved", lambda: ConvolvedPath(p.table().impulse_response(DT, p.N), p.pushed()[0], "identity"), errors_of)

for setting in (
    Noise(np.array([0.1, 0.2]), **p.SOURCE), Lambda("gcv", path="dense"), Guards(["E501"]), Online(lag=3),
    Penalty("first_difference", leak=0.9), ModelErrors({"stiffness": 0.02}), Priors(RandomWalk(2.0)), NonNegative(),
    Search(impacts=2), Signal("stationary", segment=100), Sparsity(groups="loads"), Bounds(0.0, np.ones(3)),
    Support([1, 2]), Resultant(np.ones((1, 3)), [1.0]), FrictionCone(0.5, p.CONTACTS), OU(1.0, 0.1), White(1.0),
    Matern32(1.0, 0.1), Matern52(1.0, 0.1), Periodic(20.0, 0.25, 1.0, decay=2.0), Sum([White(1.0), OU(1.0, 0.1)]),
):  # fmt: skip
    add(f"setting/{type(setting).__name__}", lambda setting=setting: setting)
add("record", lambda: Record(p.pushed()[0], DT, ["a2", "d5"], name="hit"), lambda r: bits((r.values, r.sha256)))
add("record/spectra", lambda: lines()[1], lambda s: bits(s.values))
add("record/cross spectra", lambda: cross_spectra(Record(p.running()[0], DT, ["a", "b"]), segment=100), shown)
add("record/training", lambda: TrainingRecords(p.hammered()[0].hits, 512))

add("tactile/pad", p.pad.__wrapped__, pressed_pad)
add("tactile/MultilayerPad", padded, partial(frame, u=p.moved()[1]))
add("tactile/MultilayerPad, frozen", partial(padded, choice=p.LAM), partial(frame, u=p.moved()[1]))
add("tactile/MultilayerPad, no pull", partial(padded, choice=p.LAM, contact=ContactLaw(no_pull=True)),
    partial(frame, u=p.moved()[1]))  # fmt: skip
add("tactile/GelSlim", slim, partial(frame, u=p.moved(1, "standard")[1]))
add("tactile/GelSlim, friction", partial(slim, contact=ContactLaw(friction=0.6)),
    partial(frame, u=p.moved(1, "standard")[1]))  # fmt: skip
add("tactile/GelForce", gel, partial(frame, u=gel_motion()))
add("tactile/LayerSensor", layered, partial(frame, u=p.moved()[1]))
add("tactile/LayerSensor, scattered", partial(layered, True), partial(frame, u=p.moved()[1]))
add("tactile/LearnedSensor", lambda: LearnedSensor.fit(taught.sensor(), taught.training(), engine="linear"),
    partial(frame, u=taught.presses(1, 1)[0][0]))  # fmt: skip


def pressing() -> RigidBody:
    """A ball over a layer."""
    grid = LayerGrid(Layer(h=3e-3, E=0.147e6, nu=0.45), (12, 12), 0.3e-3)
    return RigidBody(grid, (grid.nodes**2).sum(axis=-1) / 1e-2, friction=0.5)


add("tactile/map", lambda: padded().estimate(p.moved()[1]), mapped_says)
add("tactile/map of a frozen pad", lambda: padded(choice=p.LAM).estimate(p.moved()[1]), mapped_says)
add("tactile/eye", lambda: seen.eye(), watched)
add("tactile/marker tracker", lambda: MarkerTracker(seen.unloaded()[0]), followed)
add("tactile/monitor", monitor, checked)
add("tactile/layer", lambda: Layer(h=3e-3, E=0.147e6, nu=0.45), moved)
add("tactile/half-space", lambda: HalfSpace(E=0.147e6, nu=0.49), moved)
add("tactile/grid", lambda: LayerGrid(Layer(h=3e-3, E=0.147e6, nu=0.45), (8, 8), 1e-3), repr)
add("tactile/rigid body", lambda: pressing(), lambda b: bits((b.press(depth=2e-4).tractions,)))
add(
    "tactile/rigid contact",
    lambda: pressing().press(depth=2e-4),
    lambda c: bits((c.drag((1e-5, 0.0), steps=1).tractions,)),
)
add("tactile/markers", lambda: Markers(p.moved()[0], 2e-6, "XYZ"), lambda m: bits((m.points, m.noise)))
add("tactile/interpolation", lambda: Interpolation(*([p.moved()[0]] * 2)), lambda i: bits((i.W, i.flag())))
add("tactile/press", lambda: p.PRESS)
add("tactile/sphere", lambda: Sphere(radius=5e-3, depth=1e-4))
add("tactile/wrench", lambda: Wrench([0.0, 0.0, -1.0]))
add("tactile/contact law", lambda: ContactLaw(friction=0.5))
add("tactile/contact prior", lambda: ContactPrior(shear=0.3))
add("tactile/image motion", lambda: ImageMotion(shift=1e-4))
add("tactile/tolerances", lambda: Tolerances(E=0.1, nu=0.01))
add("tactile/skin", lambda: skins.skin(h=3e-3, E=0.147e6, nu=0.3223), str)


# -- one family, several records --------------------------------------------------------------------------------------
def spectra(values: np.ndarray) -> Spectra:
    """Responses over the lines of the model."""
    return Spectra(lines()[0].model.frequencies, values, noise=lines()[1].noise, noise_source="unloaded record")


def mapped_numbers(e: Any) -> Any:
    """Load, band and codes of a force map; the strain in a message is that of the last frames of its shape."""
    return bits((e.load, e.std, sorted(e.codes)))


@dataclass(frozen=True)
class Shared:
    """A family, made anew, and a record: the k-th is larger by some tenths; what of an answer is compared."""

    make: Callable[[], Any]
    record: np.ndarray
    dt: tuple[float, ...] = ()
    said: Callable[[Any], Any] = said
    wrap: Callable[[np.ndarray], Any] = np.array

    def estimate(self, family: Any, k: int) -> Any:
        """Estimate of the k-th record."""
        found = family.estimate(self.wrap(self.record * (1 + k / 10)), *self.dt)
        return found.estimate if isinstance(family, LocationSearch) else found


class SharedStream(Shared):
    """A sensor with one lambda, asked as a stream asks it: by its product alone."""

    def estimate(self, family: Any, k: int) -> Any:
        return family.follow(self.wrap(self.record * (1 + k / 10)))


HIT, TIMED = p.pushed()[0], (DT,)
SHARED: dict[str, Shared] = {
    **{f"Deconvolution, {path}": Shared(partial(histories, choice=Lambda("gcv", path=path)), HIT, TIMED)
       for path in ("dense", "statespace", "fft")},
    "Deconvolution, toeplitz": Shared(partial(histories, model=p.table(), choice=Lambda(p.LAM, path="toeplitz")), HIT,
                                      TIMED),
    "SparseDeconvolution": Shared(partial(histories, SparseDeconvolution, choice=0.1), HIT, TIMED),
    "StaticInversion": Shared(static(penalty="gradient"), p.kernel()[1][0]),
    "StaticInversion, pushes": Shared(partial(few_contacts, NonNegative()), p.kernel()[1][0]),
    "FieldDeconvolution": Shared(field, p.span()[1], (1 / 400,)),
    "HarmonicInversion": Shared(lambda: one_line()[0], one_line()[1]),
    "FrequencyInversion": Shared(lambda: lines()[0], lines()[1].values, wrap=spectra),
    "FrequencyInversion, transient": Shared(partial(histories, FrequencyInversion, signal="transient"),
                                            p.pushed(samples=400)[0], TIMED),
    "LocationSearch": Shared(searching, p.candidates()[1], TIMED),
    "LoadTracker": Shared(lambda: LoadTracker(p.housed.__wrapped__(), prior=p.WALK, noise=Noise(p.NOISE)),
                          p.service()[:200], TIMED),
    "MultilayerPad": Shared(padded, p.moved()[1], said=mapped_numbers),
    "MultilayerPad, frozen": SharedStream(partial(padded, choice=p.LAM), p.moved()[1], said=mapped_numbers),
    "GelSlim": Shared(slim, p.moved(1, "standard")[1], said=mapped_numbers),
    "GelForce": Shared(gel, gel_motion(), said=mapped_numbers),
    "LayerSensor": Shared(layered, p.moved()[1], said=mapped_numbers),
    "LayerSensor, scattered": Shared(partial(layered, True), p.moved()[1], said=mapped_numbers),
}  # fmt: skip

add("family/LearnedMap", lambda: learned.LearnedMap(learned.plate()[0]), lambda m: bits((m.coverage, m.model.static())))
add("learned map/static", learned.static_map.__wrapped__, lambda m: bits(m.predict(learned.presses(3, 1)[0]).mean))
add("learned map/history", learned.history_map, lambda m: bits(m.predict(learned.records(2, 1)[0]).std))
