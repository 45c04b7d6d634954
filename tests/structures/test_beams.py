import numpy as np
import pytest
from scipy.optimize import brentq

from structures import ForwardModel, beams, loads, sensors
from structures._elements.members import Material, Section
from structures.errors import InputError

from .exact import beam_roots, frequencies, solve
from .kinds import MIXES, UNIT


@pytest.mark.parametrize("tension", [0.0, 25.0, 2000.0])
@pytest.mark.parametrize(("left", "right"), MIXES)
def test_ten_frequencies_of_every_mix(left, right, tension):
    exact = beam_roots(left, right, tension)
    s = beams.beam(left=left, right=right, elements=40, tension=tension, **UNIT)
    assert frequencies(s, 10) == pytest.approx(exact, rel=1e-3)
    mirrored = beams.beam(left=right, right=left, elements=40, tension=tension, **UNIT)
    assert frequencies(mirrored, 10) == pytest.approx(frequencies(s, 10), rel=1e-7)


def test_the_closed_forms_are_those_of_the_tables():
    """The characteristic equations solved here against the published roots beta L."""
    for ends, roots in (
        (("clamped", "free"), [1.87510407, 4.69409113, 7.85475744, 10.99554073, 14.13716839]),
        (("clamped", "clamped"), [4.73004074, 7.85320462, 10.99560784, 14.13716549]),
        (("free", "free"), [4.73004074, 7.85320462, 10.99560784, 14.13716549]),
        (("clamped", "pinned"), [3.92660231, 7.06858275, 10.21017612, 13.35176878]),
        (("pinned", "pinned"), np.arange(1, 6) * np.pi),
    ):
        assert np.sqrt(beam_roots(*ends, count=len(roots))) == pytest.approx(roots, rel=1e-8)
    n = np.arange(1, 6)
    assert beam_roots("pinned", "pinned", 50.0, 5) == pytest.approx(
        (n * np.pi) ** 2 * np.sqrt(1 + 50 / (n * np.pi) ** 2)
    )


def test_compression_lowers_the_frequency_to_zero_at_the_buckling_load():
    n = np.arange(1, 11)
    s = beams.simply_supported(elements=40, tension=-0.9 * np.pi**2, **UNIT)
    assert frequencies(s, 10) == pytest.approx((n * np.pi) ** 2 * np.sqrt(1 - 0.9 / n**2), rel=1e-3)
    assert s.rigid_body_motions() == ()
    assert np.linalg.eigvalsh(s.scaled("tension", 1.0001 / 0.9).K_free.toarray()).min() < 0


def test_varying_tension_converges_fast():
    """Tension rising tenfold, fourth order; one mid-point value per element would give 2e-3 with 10 elements."""

    def first(elements):
        return frequencies(beams.simply_supported(elements=elements, tension=lambda x: 100 * (1 + 9 * x), **UNIT), 1)[0]

    assert first(10) == pytest.approx(first(80), rel=1e-4)
    assert first(20) == pytest.approx(first(80), rel=5e-6)
    moved = beams.simply_supported(elements=10, tension=lambda x: 100 * (1 + 9 * (x - 50)), origin=50.0, **UNIT)
    assert frequencies(moved, 1)[0] == pytest.approx(first(10), rel=1e-9)
    constant = beams.simply_supported(elements=10, tension=lambda x: 7.0, **UNIT)
    assert abs(constant.K - beams.simply_supported(elements=10, tension=7.0, **UNIT).K).max() < 1e-10


@pytest.mark.parametrize("mu", [0.1, 1.0, 5.0])
def test_tip_mass(mu):
    def f(b):
        return 1 + np.cos(b) * np.cosh(b) + mu * b * (np.cos(b) * np.sinh(b) - np.sin(b) * np.cosh(b))

    exact = [brentq(f, 0.5, 1.87), brentq(f, 3.5, 4.6)]
    assert exact[0] == pytest.approx({0.1: 1.722742, 1.0: 1.247917, 5.0: 0.870021}[mu], rel=1e-5)
    s = beams.cantilever(elements=20, **UNIT).with_mass("20+Z", mu)
    assert np.sqrt(frequencies(s, 2)) == pytest.approx(exact, rel=1e-4)


def test_a_held_tip_has_the_clamped_pinned_roots():
    """Antiresonances of the tip's own response are the frequencies with the tip held."""
    s = beams.cantilever(elements=40, **UNIT).with_supports("40+Z")
    assert np.sqrt(frequencies(s, 3)) == pytest.approx([3.926602, 7.068583, 10.210176], rel=1e-5)


# -- statics -------------------------------------------------------------------------------------------------------
LENGTH, SECTION, STEEL = 1.2, Section.rectangle(0.05, 0.01), beams.materials.steel
BENDING = STEEL.E * SECTION.I


def steel(kind, elements=40):
    return getattr(beams, kind)(length=LENGTH, section=SECTION, material=STEEL, elements=elements)


@pytest.mark.parametrize(
    ("kind", "load", "at", "exact"),
    [
        ("cantilever", loads.Point(at=LENGTH), LENGTH, LENGTH**3 / 3),
        ("cantilever", loads.Patch(x=(0, LENGTH)), LENGTH, LENGTH**4 / 8),
        ("simply_supported", loads.Point(at=LENGTH / 2), LENGTH / 2, LENGTH**3 / 48),
        ("simply_supported", loads.Patch(x=(0, LENGTH)), LENGTH / 2, 5 * LENGTH**4 / 384),
        ("clamped", loads.Point(at=LENGTH / 2), LENGTH / 2, LENGTH**3 / 192),
        ("clamped", loads.Patch(x=(0, LENGTH)), LENGTH / 2, LENGTH**4 / 384),
    ],
)
@pytest.mark.parametrize("elements", [2, 16, 40])
def test_static_deflections_are_exact_at_nodes(kind, load, at, exact, elements):
    s = steel(kind, elements)
    u = solve(s, load.column(s))
    assert sensors.Displacement(at=at).row(s) @ u == pytest.approx(exact / BENDING, rel=1e-8)


def test_cantilever_slope_is_a_right_handed_rotation():
    s = steel("cantilever")
    u = solve(s, loads.Point("40+Z").column(s))
    slope = LENGTH**2 / 2 / BENDING
    assert u[s.index("40+RY")] == pytest.approx(slope)
    assert sensors.Displacement("40+RY").row(s) @ u == pytest.approx(-slope)
    assert sensors.Displacement("40-RY").row(s) @ u == pytest.approx(slope)


def test_a_couple_bends_a_cantilever():
    """A positive couple about Y presses the tip down: w = -M x^2 / 2 EI."""
    s = steel("cantilever")
    for couple in (loads.Moment("40+RY"), loads.Moment(at=LENGTH, direction="+RY")):
        u = solve(s, couple.column(s))
        assert sensors.Displacement("40+Z").row(s) @ u == pytest.approx(-(LENGTH**2) / 2 / BENDING, rel=1e-8)


@pytest.mark.parametrize("x", [0.0, 0.0123, 0.3, 0.61, 1.0])
def test_gauge_on_a_cantilever_reads_the_bending_strain(x):
    """A tip force along +Z compresses the upper face: strain -P (L - x) c / EI, at the root P L c / EI in size."""
    s = steel("cantilever")
    u = solve(s, loads.Point("40+Z").column(s))
    exact = -(LENGTH - x) * SECTION.c / BENDING
    assert sensors.StrainGauge(at=x, fibre=SECTION.c).row(s) @ u == pytest.approx(exact, rel=1e-6)
    assert sensors.StrainGauge(at=x, fibre=-SECTION.c).row(s) @ u == pytest.approx(-exact, rel=1e-6)
    if x > 0.01:
        assert sensors.StrainGauge(at=x, fibre=SECTION.c, length=0.02).row(s) @ u == pytest.approx(exact, rel=1e-6)


def test_gauge_under_a_distributed_load():
    s = steel("simply_supported")
    u = solve(s, loads.Patch(x=(0, LENGTH)).column(s))
    for x in (0.31, 0.6):
        exact = x * (LENGTH - x) / 2 / BENDING * SECTION.c
        assert sensors.StrainGauge(at=x, fibre=SECTION.c).row(s) @ u == pytest.approx(exact, rel=1e-3)


# -- sections and bad input ----------------------------------------------------------------------------------------
def test_sections():
    bar = Section.rectangle(0.05, 0.01)
    assert (bar.A, bar.I, bar.c) == (5e-4, 0.05 * 0.01**3 / 12, 0.005)
    full, tube = Section.circle(0.04), Section.tube(0.04, 0.02)
    assert (tube.A, tube.I, tube.c) == pytest.approx((full.A, full.I, full.c))
    thin = Section.tube(0.04, 0.003)
    hole = Section.circle(0.034)
    assert pytest.approx((full.A - hole.A, full.I - hole.I)) == (thin.A, thin.I)


@pytest.mark.parametrize(
    "bad",
    [lambda: Section.rectangle(0, 1), lambda: Section.circle(-1), lambda: Section.tube(0.04, 0.03),
     lambda: Material(-1, 1), lambda: Material(1, 1, 0.5), lambda: Material(1, np.nan),
     lambda: beams.beam(left="fixed", right="free", **UNIT),
     lambda: beams.free(**{**UNIT, "EI": -1.0}), lambda: beams.free(**{**UNIT, "length": 0.0}),
     lambda: beams.free(length=1.0), lambda: beams.free(length=1.0, EI=1.0), lambda: beams.free(elements=0, **UNIT),
     lambda: beams.free(elements=2.5, **UNIT), lambda: beams.free(section=Section.circle(0.1), **UNIT),
     lambda: beams.free(length=1.0, section=Section.circle(0.1)), lambda: beams.free(tension=np.nan, **UNIT)],
)  # fmt: skip
def test_bad_beams_raise(bad):
    with pytest.raises(InputError):
        bad()


# -- tapered beams ----------------------------------------------------------------------------------------------------
def test_a_constant_function_is_a_constant():
    same = beams.cantilever(length=1.0, EI=lambda x: 7.0, mass_per_length=lambda x: 2.0, elements=6)
    plain = beams.cantilever(length=1.0, EI=7.0, mass_per_length=2.0, elements=6)
    rounded = 10 * np.finfo(float).eps * abs(plain.K).max()  # sums over the integration points that end at zero
    np.testing.assert_allclose(same.K.toarray(), plain.K.toarray(), rtol=1e-13, atol=rounded)
    np.testing.assert_allclose(same.M.toarray(), plain.M.toarray(), rtol=1e-13, atol=1e-13)


def test_tip_deflection_of_a_linear_taper():
    """EI = EI0 (1 - x / 2 L), against the integral of P (L - x)^2 / EI(x) by quadrature; fourth order."""
    from scipy.integrate import quad

    EI0, P = 5.0, 3.0
    exact = quad(lambda x: P * (1 - x) ** 2 / (EI0 * (1 - x / 2)), 0, 1)[0]
    found = []
    for elements in (4, 8):
        beam = beams.cantilever(length=1.0, EI=lambda x: EI0 * (1 - x / 2), mass_per_length=1.0, elements=elements)
        model = ForwardModel(beam, [sensors.Displacement(f"{elements}+Z")], [loads.Point(f"{elements}+Z")])
        found.append(abs(P * model.static()[0, 0] / exact - 1))
    assert found[1] < 1e-5
    assert found[0] / found[1] > 10


@pytest.mark.parametrize("bad", [lambda x: -1.0, lambda x: float("nan"), lambda x: "soft", lambda x: 1 / 0])
def test_a_taper_that_is_none_is_refused(bad):
    with pytest.raises(InputError, match="no function of x"):
        beams.cantilever(length=1.0, EI=bad, mass_per_length=1.0)
