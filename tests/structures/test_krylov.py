"""Rational Krylov reduction: against direct solves and closed forms, and its error bound against the true error."""

import dataclasses

import numpy as np
import pytest

from structures import ForwardModel, InputError, NotIdentifiable, Structure, beams, chains, loads, plates, sensors
from structures._elements.members import steel
from structures._models import krylov as reduction
from structures._models.galerkin import Images, Pencil, project
from structures._models.krylov import krylov
from structures._system.damping import Modal, Rayleigh, Structural

L, EI, MASS = 1.2, 800.0, 3.0
BEAM = {"length": L, "EI": EI, "mass_per_length": MASS, "elements": 30}
PLATE = {"lengths": (0.5, 0.4), "thickness": 3e-3, "material": steel, "elements": (12, 12)}
LIGHT = Rayleigh(2.0, 2e-6)


def every_sensor():
    return [
        sensors.Displacement("3+Z"),
        sensors.Velocity("5-Z"),
        sensors.Accelerometer(at=0.41, label="a"),
        sensors.StrainGauge(at=0.37, fibre=0.01, length=0.02),
        sensors.Displacement("7+RY", highpass=2.0),
        sensors.Accelerometer("8+Z", highpass=0.7),
    ]


def every_load():
    return [loads.Point("6+Z"), loads.Point(at=0.77), loads.Moment("4+RY"), loads.Patch(x=(0.2, 0.5))]


def on_plate(rows=6, columns=3):
    places = np.random.default_rng(0).uniform(0.03, 0.37, (rows + columns, 2))
    kinds = (sensors.Displacement, sensors.Accelerometer, sensors.Velocity)
    found = [kinds[i % 3](at=tuple(x), label=f"y{i}") for i, x in enumerate(places[:rows])]
    gauge = sensors.StrainGauge(at=(0.2, 0.2), fibre=1.5e-3, angle=0.3)
    return [*found, gauge], [loads.Point(at=tuple(x), label=f"f{i}") for i, x in enumerate(places[rows:])]


def with_dashpots(structure, value, *dofs):
    C = np.zeros((structure.n, structure.n))
    for i in map(structure.index, dofs):
        C[i, i] = value
    return dataclasses.replace(structure, C=C)


CASES = {
    "cantilever": lambda: (beams.cantilever(damping=LIGHT, **BEAM), every_sensor(), every_load(), 800.0),
    "undamped": lambda: (beams.cantilever(**BEAM), every_sensor(), every_load(), 800.0),
    "loss factor": lambda: (beams.cantilever(damping=Structural(0.02), **BEAM), every_sensor(), every_load(), 800.0),
    "free": lambda: (beams.free(damping=LIGHT, **BEAM), every_sensor(), every_load(), 800.0),
    "free, loss factor": lambda: (beams.free(damping=Structural(0.05), **BEAM), every_sensor(), every_load(), 800.0),
    "dashpots": lambda: (
        with_dashpots(beams.cantilever(damping=LIGHT, **BEAM), 30.0, "20+Z", "11+Z"),
        every_sensor(),
        every_load(),
        800.0,
    ),
    "heavy dashpot": lambda: (
        with_dashpots(beams.cantilever(damping=Structural(0.03), **BEAM), 3000.0, "20+Z"),
        every_sensor(),
        every_load(),
        800.0,
    ),
    "free, dashpot": lambda: (with_dashpots(beams.free(**BEAM), 30.0, "20+Z"), every_sensor(), every_load(), 800.0),
    "coarse": lambda: (
        beams.cantilever(damping=LIGHT, **{**BEAM, "elements": 9}),
        every_sensor(),
        every_load(),
        3000.0,
    ),
    "plate": lambda: (plates.plate(edges="CFFF", damping=LIGHT, **PLATE), *on_plate(), 1000.0),
    "free plate": lambda: (plates.plate(edges="FFFF", damping=LIGHT, **PLATE), *on_plate(), 1000.0),
    "square plate": lambda: (
        plates.plate(edges="SSSS", damping=LIGHT, **{**PLATE, "lengths": (0.4, 0.4)}),
        *on_plate(),
        1500.0,
    ),
    "plate, dashpots": lambda: (
        with_dashpots(plates.plate(edges="CFFF", **PLATE), 20.0, "60+Z", "131+Z"),
        *on_plate(),
        1000.0,
    ),
    "more loads than sensors": lambda: (
        plates.plate(edges="CFFF", damping=LIGHT, **PLATE),
        *on_plate(1, 9),
        1000.0,
    ),
}


def reduced(case):
    structure, rows, columns, band = CASES[case]()
    return ForwardModel(structure, rows, columns, reduction="krylov", band=band), band


def deep_lines(model, band, count=25):
    """Random lines of the band, and the deepest antiresonance of every entry."""
    random = np.random.default_rng(3).uniform(band / 300, band, count)
    fine = np.linspace(band / 300, band, 1500)
    return np.unique(np.concatenate([random, fine[np.abs(model.frf(fine)).argmin(axis=0).ravel()]]))


@pytest.mark.parametrize("case", CASES)
def test_every_entry_agrees_with_a_direct_solve_and_the_bound_holds(case):
    model, band = reduced(case)
    f = deep_lines(model, band)
    H, exact, stated = model.frf(f), model.frf(f, method="direct"), model.reduction_error(f)
    true = np.abs(H - exact)
    assert np.all(true <= 1e-6 * np.abs(exact))
    assert np.all(true <= stated.bound)
    assert np.median(stated.bound / np.maximum(true, 1e-300)) < 1e4  # a bound, not a shrug
    assert np.allclose(stated.size, np.abs(exact), rtol=1e-6)
    error = np.linalg.norm(true, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
    assert np.all(error <= stated.normwise)
    assert np.all(stated.normwise <= stated.entrywise.max(axis=(1, 2)))


@pytest.mark.parametrize("first", [1, 2, 3])
@pytest.mark.parametrize(
    "case", ["cantilever", "free", "heavy dashpot", "plate, dashpots", "square plate", "free, loss factor"]
)
def test_the_bound_holds_where_the_basis_is_far_too_small(case, first, monkeypatch):
    monkeypatch.setattr(reduction, "FIRST", first)
    structure, rows, columns, band = CASES[case]()
    model = ForwardModel(structure, rows, columns, reduction="krylov", band=band)
    found = krylov(structure, model._S, model.columns, band, tolerance=1e12)
    f = np.random.default_rng(4).uniform(band / 300, band, 15)
    H, truncation, rounding = found.projection.errors(2 * np.pi * f)
    true = np.abs(H - model.frf(f, method="direct") / model._reading(f)[:, :, None])
    assert np.mean(true <= truncation + rounding) > 0.99
    assert found.depth == first


@pytest.mark.parametrize("case", ["heavy dashpot", "plate, dashpots", "plate", "free, dashpot"])
def test_the_bound_holds_for_any_basis_that_covers_the_band(case):
    """Modes: what the masses leave out is nothing then, and what the dashpots leave out is all."""
    structure, rows, columns, band = CASES[case]()
    count = int(np.searchsorted(ForwardModel(structure, rows, columns, modes=40).natural_frequencies, 1.2 * band)) + 1
    model, pencil = ForwardModel(structure, rows, columns, modes=count), Pencil.of(structure)
    W, S, B = model.modes.phi, model._S.toarray().T, model.columns.toarray()
    solve = pencil.factor.solve
    ZC = None if pencil.C is None else solve(pencil.C @ W)
    found = project(pencil, Images(W, pencil.K_s @ W, pencil.M @ W, solve(pencil.M @ W), ZC, S, B, solve(S), solve(B)))
    f = np.random.default_rng(6).uniform(band / 300, band, 20)
    H, truncation, rounding = found.errors(2 * np.pi * f)
    true = np.abs(H - model.frf(f, method="direct") / model._reading(f)[:, :, None])
    assert np.mean(true <= truncation + rounding) > 0.99


def test_depth_is_added_until_the_tolerance_is_met():
    structure, rows, columns, band = CASES["plate"]()
    model = ForwardModel(structure, rows, columns, reduction="krylov", band=band)
    loose, tight = (krylov(structure, model._S, model.columns, band, tolerance=t) for t in (1e-1, 1e-7))
    assert loose.depth < tight.depth
    assert tight.estimate < 1e-7 < loose.estimate < 1e-1
    assert len(tight.projection.theta) < structure.free.size / 5
    never = krylov(structure, model._S, model.columns, band, tolerance=0.0)  # ends at its rounding
    assert len(never.projection.theta) < structure.free.size / 3


def test_cantilever_tip_in_closed_form():
    """Receptance of the tip and its antiresonances, the frequencies of the clamped-pinned beam."""
    tip = ForwardModel(
        beams.cantilever(length=L, EI=EI, mass_per_length=MASS, elements=40),
        [sensors.Displacement("40+Z")],
        [loads.Point("40+Z")],
        reduction="krylov",
        band=1200.0,
    )
    b = np.array([0.7, 1.5, 3.0, 5.5, 9.0])
    f = (b / L) ** 2 * np.sqrt(EI / MASS) / (2 * np.pi)
    exact = L**3 / EI * (np.cosh(b) * np.sin(b) - np.sinh(b) * np.cos(b)) / (b**3 * (1 + np.cos(b) * np.cosh(b)))
    assert np.allclose(tip.frf(f)[:, 0, 0], exact, rtol=1e-4)
    zeros = (np.array([3.92660231, 7.06858275, 10.21017612]) / L) ** 2 * np.sqrt(EI / MASS) / (2 * np.pi)
    below, above = (tip.frf(factor * zeros)[:, 0, 0].real for factor in (0.9999, 1.0001))
    assert np.all(below * above < 0)
    beta = np.array([1.87510407, 4.69409113, 7.85475744, 10.99554073])
    assert np.allclose(tip.natural_frequencies[:4], (beta / L) ** 2 * np.sqrt(EI / MASS) / (2 * np.pi), rtol=1e-5)


def test_a_free_body_keeps_its_rigid_modes_exactly():
    model, _ = reduced("free plate")
    assert np.all(model.reduced.lam[:3] == 0)
    assert np.all(model.reduced.lam[3:] > 0)
    shapes = model.krylov.shapes.phi[:, :3]
    energy = np.einsum("ij,ij->j", shapes, model.structure.K_free @ shapes)
    assert np.all(energy < 1e-9 * model.reduced.lam[3])
    centre = ForwardModel(
        plates.plate(edges="FFFF", **PLATE),
        [sensors.Accelerometer(at=(0.25, 0.2))],
        [loads.Point(at=(0.25, 0.2))],
        reduction="krylov",
        band=200.0,
    )
    assert centre.frf([0.0, 0.01])[:, 0, 0] == pytest.approx(1 / (steel.rho * 3e-3 * 0.2), rel=1e-6)


def test_dashpots_ask_for_few_more_vectors():
    """Each dashpot costs what a load costs: its column is followed, not a second basis."""
    (damped, _), (plain, _) = reduced("plate, dashpots"), reduced("plate")
    assert not damped.reduced.proportional
    assert len(damped.reduced.lam) < 2 * len(plain.reduced.lam)


def test_more_loads_than_sensors_is_the_transposed_problem():
    structure = plates.plate(edges="CFFF", damping=LIGHT, **PLATE)
    places = [(0.1, 0.1), (0.4, 0.3), (0.3, 0.1), (0.2, 0.35), (0.45, 0.05)]

    def model(rows, columns):
        return ForwardModel(
            structure,
            [sensors.Displacement(at=x, label=f"y{x}") for x in rows],
            [loads.Point(at=x, label=f"f{x}") for x in columns],
            reduction="krylov",
            band=500.0,
        )

    wide, tall = model(places[:2], places), model(places, places[:2])
    assert len(wide.reduced.lam) == len(tall.reduced.lam)
    f = np.linspace(5, 500, 7)
    assert np.allclose(wide.frf(f), np.swapaxes(tall.frf(f), 1, 2), rtol=1e-7)


def test_static_response_and_time_domain():
    """At rest the basis is exact; a smooth pulse within the band moves the sensors as all modes do."""
    structure = beams.cantilever(damping=Rayleigh(20.0, 2e-5), **BEAM)
    small = ForwardModel(structure, every_sensor(), every_load(), reduction="krylov", band=1500.0)
    full = ForwardModel(structure, every_sensor(), every_load(), modes=structure.free.size)
    assert np.allclose(small.frf([0.0])[0].real, small.static(), rtol=1e-9, atol=1e-9 * np.abs(small.static()).max())
    dt, n = 1e-4, 400
    t = dt * np.arange(n)
    push = np.outer(np.exp(-(((t - 0.008) / 0.0015) ** 2)), [1.0, -0.4, 0.2, 3.0])
    y, exact = small.predict(push, dt), full.predict(push, dt)
    assert np.all(np.abs(y - exact).max(axis=0) < 1e-5 * np.abs(exact).max(axis=0))
    system = small.state_space(dt)
    assert len(system.A) == 2 * len(small.reduced.lam) + 2
    assert np.allclose(system.simulate(push), y, atol=1e-9 * np.abs(y).max(axis=0))
    assert small.decay_rate == pytest.approx(full.decay_rate, rel=1e-6)


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_units_change_nothing(factor):
    structure, *_, band = CASES["dashpots"]()
    other = Structure.from_matrices(
        factor * structure.K_free, factor * structure.M_free, factor * structure.C_free, None, (), None
    )
    names = [f"{i}+S" for i in (4, 17, 30)]
    f = np.linspace(5, band, 9)

    def model(s):
        free = Structure.from_matrices(s.K, s.M, s.C)
        return ForwardModel(
            free, [sensors.Displacement(n) for n in names], [loads.Point(names[1])], reduction="krylov", band=band
        )

    plain = Structure.from_matrices(structure.K_free, structure.M_free, structure.C_free)
    assert model(other).krylov.depth == model(plain).krylov.depth
    assert np.allclose(factor * model(other).frf(f), model(plain).frf(f), rtol=1e-8)


def test_loads_that_repeat_and_entries_that_are_zero():
    beam = beams.simply_supported(damping=LIGHT, **BEAM)
    model = ForwardModel(
        beam,
        [sensors.Displacement("15+RY"), sensors.Displacement("10+Z")],
        [loads.Point("15+Z", label="a"), loads.Point("15+Z", label="b"), loads.Point("4+Z")],
        reduction="krylov",
        band=500.0,
    )
    f = np.linspace(3, 500, 20)
    H, exact = model.frf(f), model.frf(f, method="direct")
    assert np.array_equal(H[:, :, 0], H[:, :, 1])
    assert np.allclose(H[:, 1], exact[:, 1], rtol=1e-6)
    assert model.krylov.estimate < 1e-5


def test_an_entry_that_is_rounding_is_a_zero_whatever_it_rounds_to():
    """A symmetric structure has entries that are zero; what comes in their place differs between processors."""
    H, truncation = np.array([[[1.0, 0.0], [0.1, 1.0]]] * 2), np.full((2, 2, 2), 1e-9)
    rounding = np.full(H.shape, 1e-10)
    for noise in (1e-14, 1e-12, 5e-12, 9e-11):
        H[:, 0, 1] = noise
        assert reduction.worst(H, truncation, rounding) == pytest.approx(1e-8)
    H[1, 0, 1] = 1e-9  # seen on a line: an entry
    assert reduction.worst(H, truncation, rounding) == pytest.approx(1e-9 / 9e-11)


def test_a_shift_on_a_natural_frequency_gives_way():
    f = 4.0
    structure = chains.oscillator(mass=1.0, stiffness=(2 * np.pi * f) ** 2)
    model = ForwardModel(
        structure,
        [sensors.Displacement("1+X")],
        [loads.Point("1+X")],
        reduction="krylov",
        band=f / reduction.OFF,
    )
    assert model.frf([1.0])[0, 0, 0] == pytest.approx(1 / ((2 * np.pi) ** 2 * (f**2 - 1)), rel=1e-12)
    loose = Structure.from_matrices([[0.0]], [[2.0]])
    mass = ForwardModel(loose, [sensors.Accelerometer("0+S")], [loads.Point("0+S")], reduction="krylov", band=9.0)
    assert mass.frf([3.0])[0, 0, 0] == pytest.approx(0.5)


def test_loads_and_parameters_can_change():
    model, band = reduced("cantilever")
    moved = model.with_loads([loads.Point("9+Z")])
    f = np.linspace(5, band, 6)
    assert np.allclose(moved.frf(f), moved.frf(f, method="direct"), rtol=1e-6)
    softer = model.perturbed("stiffness", 0.9)
    assert np.allclose(softer.frf(f), softer.frf(f, method="direct"), rtol=1e-6)
    modal = ForwardModel(model.structure, model.sensors, model.loads, band=band)
    assert len({model.fingerprint, moved.fingerprint, softer.fingerprint, modal.fingerprint}) == 4
    assert "Krylov basis to 800 Hz" in repr(model)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"band": None}, "band, not for a number of modes"),
        ({"modes": 5}, "band, not for a number of modes"),
        ({"reduction": "lanczos"}, "no such reduction"),
        ({"damping": Modal(0.01)}, r"modal ratios are no damping matrix.*Structural\(2 zeta\)"),
        ({"loads": [loads.MovingPoint([0.1, 0.2, 0.3])]}, "no Krylov reduction"),
        (
            {
                "loads": [loads.Point(at=x, label=str(x)) for x in np.linspace(0.1, 1.1, 41)],
                "sensors": [sensors.Displacement(at=x, label=str(x)) for x in np.linspace(0.1, 1.1, 41)],
            },
            "grows with the loads.*41 loads",
        ),
    ],
)
def test_what_a_krylov_basis_does_not_serve_is_refused_at_once(change, words):
    settings = {
        "damping": LIGHT,
        "sensors": [sensors.Displacement("3+Z")],
        "loads": [loads.Point("5+Z")],
        "band": 100.0,
        "reduction": "krylov",
        **change,
    }
    beam = beams.cantilever(damping=settings.pop("damping"), **BEAM)
    with pytest.raises(InputError, match=words):
        ForwardModel(beam, settings.pop("sensors"), settings.pop("loads"), **settings)


def test_lines_without_a_bound_are_named():
    undamped, _ = reduced("undamped")
    at = undamped.natural_frequencies[1]
    for ask in (undamped.frf, undamped.reduction_error):
        with pytest.raises(NotIdentifiable, match="natural frequency of mode 2"):
            ask([1.0, at])
    with pytest.raises(NotIdentifiable, match="rigid-body motion"):
        reduced("free")[0].reduction_error([0.0, 1.0])
    stated = undamped.reduction_error([0.0, at * (1 + 1e-6)])
    assert np.all(np.isfinite(stated.bound))
    assert np.all(stated.bound[0, 2] == 0)  # an accelerometer at rest: nothing, and no error


def test_bad_questions_are_refused():
    model, band = reduced("cantilever")
    modal = ForwardModel(model.structure, model.sensors, model.loads)
    buckled = beams.simply_supported(tension=-1.2 * np.pi**2 * EI / L**2, **BEAM)
    row, column = [sensors.Displacement("3+Z")], [loads.Point("5+Z")]
    massless = Structure.from_matrices(np.eye(3))
    for ask, words in (
        (lambda: model.frf([1.01 * band]), "above the band"),
        (lambda: model.reduction_error([1.01 * band]), "above the band"),
        (lambda: model.modes, "it has no modes"),
        (lambda: modal.reduction_error([1.0]), "no Krylov basis"),
        (lambda: modal.krylov, "no Krylov basis"),
        (lambda: ForwardModel(buckled, row, column, reduction="krylov", band=50.0).reduced, "unstable"),
        (
            lambda: ForwardModel(
                massless, [sensors.Displacement("0+S")], [loads.Point("1+S")], reduction="krylov", band=1.0
            ).frf([0.5]),
            "no mass matrix",
        ),
    ):
        with pytest.raises(InputError, match=words):
            ask()
