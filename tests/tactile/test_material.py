"""Material tests: rigid indenters on a layer, E and nu with honest std, two separate verdicts."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.special import j0

from structures._flags import codes
from structures.errors import InputError, NotIdentifiable
from tactile import Layer, material
from tactile._closed.contact import _excess, _gauss, _solved
from tactile.material._fits import pool

E, H = 0.147e6, 3e-3
SLOW, MID, FAST = 1e-4, 1e-3, 1e-2


def tension(
    speed: float,
    rng: np.random.Generator,
    *,
    E: float = E,
    nu: float | None = None,
    strain: float = 0.08,
    bend: float = 0.0,
    noise: float = 0.004,
    slack: float = 0.001,
) -> material.Tensile:
    """40 points of a strip of 10 x 2 mm, 20 mm long; noise as share of the largest force."""
    x = np.linspace(0, strain, 40)
    stress = E * (x + slack) * (1 + bend * x / strain)
    force = 20e-6 * (stress + noise * E * strain * rng.standard_normal(40))
    lateral = None if nu is None else 10e-3 * (nu * x + 0.002 * strain * rng.standard_normal(40))
    width = None if nu is None else 10e-3
    return material.Tensile(20e-3 * x, force, length=20e-3, area=20e-6, speed=speed, contraction=lateral, width=width)


def press(
    radius: float, nu: float, rng: np.random.Generator, *, speed: float = MID, E: float = E, noise: float = 0.004
) -> material.Indentation:
    """60 points of a sphere pressed 0.3 mm deep, touching 0.02 mm after the start of the record."""
    depth = np.linspace(-0.02e-3, 0.3e-3, 60)
    force = material.sphere_force(Layer(h=H, E=E, nu=nu), radius, depth)
    force = force + noise * force.max() * rng.standard_normal(60)
    return material.Indentation(depth + 0.5e-3, force, radius=radius, thickness=H, speed=speed)


@pytest.mark.parametrize(("ratio", "nu"), [(0.3, 0.3223), (1.0, 0.49), (2.0, 0.5)])
def test_under_a_sphere_the_layer_takes_the_shape_of_the_sphere(ratio: float, nu: float) -> None:
    """The motion, from the layer's kernel and the transform of the pressure, is the depth minus r^2 / 2 R."""
    layer, a, R = Layer(h=H, E=E, nu=nu), ratio * H, 5e-3
    depth, force = (float(v) for v in material.sphere_contact(layer, R, a))
    t, w = np.polynomial.legendre.leggauss(400)
    t, w = (t + 1) / 2, w / 2
    x, v = _gauss(240, 30.0)
    waves = np.cos(ratio * np.outer(t, x))
    kernel = 2 / np.pi * ratio * (waves * (v * _excess(nu))) @ waves.T * w
    phi = E / (np.pi * (1 - nu**2)) * np.linalg.solve(np.eye(400) - kernel, depth - (a * t) ** 2 / R)
    assert 2 * np.pi * a * w @ phi == pytest.approx(force, rel=1e-9)
    assert phi[-1] == pytest.approx(0, abs=1e-4 * phi[0])  # pressure vanishes at the rim
    k = (np.arange(20_000) + 0.5) * 0.01 / a
    transform = a * (np.cos(np.outer(k, a * t)) @ (w * phi))
    for r in (0.0, 0.4 * a, 0.9 * a):
        motion = np.sum(layer.components(k).zz * transform * j0(k * r) * k) * 0.01 / a
        assert motion == pytest.approx(depth - r**2 / (2 * R), rel=2e-3)


def test_a_small_sphere_is_hertz() -> None:
    layer = Layer(h=H, E=E, nu=0.4)
    R, a = 4e-3, 1e-3 * H * np.array([1.0, 2.0])
    depth, force = material.sphere_contact(layer, R, a)
    assert force == pytest.approx(4 * E * a**3 / (3 * R * (1 - 0.4**2)), rel=5e-3)
    assert depth == pytest.approx(a**2 / R, rel=5e-3)
    assert material.sphere_force(layer, R, [-1e-4, 0.0, depth[0]]) == pytest.approx([0, 0, force[0]], rel=1e-2)


def test_a_sphere_on_a_thin_bonded_layer_is_as_published() -> None:
    """Garcia and Garcia 2018, incompressible bonded layer: a series in sqrt(R depth)/h."""
    R = 5e-3
    layer = Layer(h=H, E=E, nu=0.5)
    depth = np.array([0.005, 0.02, 0.08]) * H * H / R
    chi = np.sqrt(R * depth) / H
    series = 1 + 1.133 * chi + 1.497 * chi**2 + 1.469 * chi**3 + 0.755 * chi**4
    published = 16 / 9 * E * np.sqrt(R) * depth**1.5 * series
    assert material.sphere_force(layer, R, depth) == pytest.approx(published, rel=3e-3)


def test_the_law_of_spheres_meets_the_solved_contact_and_energy() -> None:
    """Interpolated is solved; and dF/d(depth) of a sphere is the stiffness of a flat punch of that radius."""
    layer, R = Layer(h=H, E=E, nu=0.47), 6e-3
    a = np.array([0.011, 0.137, 0.8, 1.9]) * H
    depth, force = material.sphere_contact(layer, R, a)
    assert material.sphere_force(layer, R, depth) == pytest.approx(force, rel=1e-5)
    step = 1e-4
    for radius in a:
        (d0, d1), (f0, f1) = material.sphere_contact(layer, R, radius * np.array([1 - step, 1 + step]))
        assert (f1 - f0) / (d1 - d0) == pytest.approx(material.flat_stiffness(layer, radius), rel=1e-6)


def test_quadrature_of_the_indenter_has_converged() -> None:
    values = _solved((0.5, 1.0, 2.0, 4.0), 0.49)[:, 0]
    assert all(b > a for a, b in pairwise(values))  # a wider punch feels the base more
    # uniform compression under a wide punch: F -> pi a^2 times the confined modulus over h, plus the rim
    nu, a = 0.3, 4.0
    confined = (1 - nu) / ((1 + nu) * (1 - 2 * nu)) * np.pi * a**2
    stiffness = material.flat_stiffness(Layer(h=1.0, E=1.0, nu=nu), a)
    assert 1.0 < stiffness / confined < 1.35
    assert material.flat_stiffness(Layer(h=1.0, E=1.0, nu=nu), 2.0) / (confined / 4) > stiffness / confined


def test_tension_gives_modulus_ratio_and_both_verdicts() -> None:
    rng = np.random.default_rng(0)
    tests = [tension(v, rng, nu=0.3223) for v in (SLOW, MID, FAST) for _ in range(2)]
    found = material.from_tests(tests)
    assert pytest.approx(E, abs=4 * found.E_std) == found.E
    assert found.E_std < 0.01 * E
    assert found.nu == pytest.approx(0.3223, abs=4 * found.nu_std)
    assert found.nu_source == "lateral strain"
    assert found.rate.verdict == "shown"
    assert found.linear.verdict == "shown"
    assert not found.flags
    for words in ("rate independence: shown", "linearity: shown", "lateral strain"):
        assert words in found.table()


def test_a_viscous_gel_is_linear_and_not_rate_independent() -> None:
    rng = np.random.default_rng(1)
    tests = [tension(v, rng, E=E * (v / SLOW) ** 0.08) for v in (SLOW, MID, FAST) for _ in range(2)]
    found = material.from_tests(tests)
    assert found.rate.verdict == "violated"
    assert found.rate.effect == pytest.approx(100**0.08 - 1, abs=0.03)
    assert found.rate.low < found.rate.effect < found.rate.high
    assert found.linear.verdict == "shown"
    assert not found.flags  # both were tested: what they show is in the verdicts


def test_a_softening_gel_is_rate_independent_and_not_linear() -> None:
    rng = np.random.default_rng(2)
    tests = [tension(v, rng, bend=-0.25, strain=0.3, slack=0.0) for v in (SLOW, MID, FAST) for _ in range(2)]
    found = material.from_tests(tests)
    assert found.rate.verdict == "shown"
    assert found.linear.verdict == "violated"
    assert found.linear.effect == pytest.approx(-0.25, abs=0.03)


def test_scatter_between_runs_leaves_the_verdict_open() -> None:
    """A p-value alone would call 20 % of scatter 'no significant difference', that is independence."""
    rng = np.random.default_rng(3)
    tests = [tension(v, rng, E=E * (1 + 0.2 * rng.standard_normal())) for v in (SLOW, MID, FAST)]
    found = material.from_tests(tests)
    assert found.rate.p > 0.05
    assert found.rate.verdict == "undecided"


@pytest.mark.parametrize(
    ("speeds", "strain", "missing"), [((MID, MID), 0.08, "rate independence"), ((SLOW, FAST), 0.01, "linearity")]
)
def test_one_of_two_is_said(speeds: tuple[float, ...], strain: float, missing: str) -> None:
    rng = np.random.default_rng(4)
    found = material.from_tests([tension(v, rng, strain=strain, slack=0.0) for v in speeds])
    assert codes(found.flags) == {"W113"}
    assert f"{missing} was not" in found.flags[0].message
    assert found.nu is None
    assert found.nu_source == "not determined"


def test_an_implausible_modulus_is_questioned_and_kept() -> None:
    rng = np.random.default_rng(5)
    found = material.from_tests([tension(v, rng, E=1000 * E) for v in (SLOW, FAST)])
    assert codes(found.flags) == {"W111"}
    assert pytest.approx(1000 * E, rel=0.02) == found.E


def test_two_spheres_tell_modulus_and_ratio() -> None:
    rng = np.random.default_rng(6)
    tests = [press(R, 0.47, rng) for R in (2e-3, 20e-3) for _ in range(3)]
    found = material.from_tests(tests)
    assert found.nu_source == "indenter sizes"
    assert found.nu == pytest.approx(0.47, abs=4 * found.nu_std)
    assert pytest.approx(E, abs=4 * found.E_std) == found.E
    assert found.nu_std < 0.02
    assert codes(found.flags) == {"W113"}  # one speed


def test_one_sphere_does_not_tell_modulus_from_ratio() -> None:
    rng = np.random.default_rng(7)
    tests = [press(4e-3, 0.47, rng) for _ in range(4)]
    with pytest.raises(NotIdentifiable, match="one size"):
        material.from_tests(tests)
    found = material.from_tests(tests, nu=0.47)
    assert pytest.approx(E, abs=4 * found.E_std) == found.E
    vague = material.from_tests(tests, nu=(0.47, 0.02))
    assert vague.E_std > 3 * found.E_std  # what nu leaves open goes into E


def test_tension_and_a_sphere_together_tell_the_ratio() -> None:
    rng = np.random.default_rng(8)
    tests = [tension(SLOW, rng), tension(FAST, rng), press(8e-3, 0.45, rng), press(8e-3, 0.45, rng)]
    found = material.from_tests(tests)
    assert found.nu == pytest.approx(0.45, abs=4 * found.nu_std + 0.005)


def test_no_unit_matters() -> None:
    rng = np.random.default_rng(9)
    tests = [press(R, 0.4, rng) for R in (2e-3, 20e-3) for _ in range(2)]
    scaled = [
        material.Indentation(
            1e3 * c.depth, 1e-6 * c.force, radius=1e3 * c.radius, thickness=1e3 * c.thickness, speed=1e3 * c.speed
        )
        for c in tests
    ]
    a, b = material.from_tests(tests), material.from_tests(scaled)
    assert pytest.approx(1e-12 * a.E, rel=1e-6) == b.E
    assert b.nu == pytest.approx(a.nu, rel=1e-5)


def test_the_intervals_cover() -> None:
    """300 simulated campaigns: with run-to-run scatter of 2 % beyond the noise, and without."""
    for scatter in (0.0, 0.02):
        rng = np.random.default_rng(10)
        inside = 0
        for _ in range(300):
            runs = E * (1 + scatter * rng.standard_normal(6))
            stress = np.linspace(0, 0.08, 40) * runs[:, None] + 0.01 * 0.08 * E * rng.standard_normal((6, 40))
            values, stds = [], []
            x = np.linspace(0, 0.08, 40)
            for y in stress:  # the law of a curve by its normal line, so that 1800 fits stay cheap
                p, cov = np.polyfit(x, y, 1, cov=True)
                values.append(np.log(p[0]))
                stds.append(np.sqrt(cov[0, 0]) / p[0])
            found = pool(values, stds, np.ones((6, 1)))
            inside += abs(found.value[0] - np.log(E)) <= found.half_width()
        assert inside / 300 > 0.92
        assert scatter == 0 or inside / 300 < 0.98  # Student's t with the scatter seen; without any it is too wide


def test_the_std_of_one_curve_covers() -> None:
    rng = np.random.default_rng(11)
    z = []
    for _ in range(40):
        found = material.from_tests([tension(MID, rng)])
        z.append((found.E - E) / found.E_std)
        bend = found.curves[0]
        z.append(bend.bend / bend.bend_std)
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.25


def test_two_flat_punches_tell_modulus_and_ratio() -> None:
    rng = np.random.default_rng(12)
    tests = []
    for radius in (1e-3, 1e-3, 4e-3, 4e-3):
        depth = np.linspace(0, 0.2e-3, 50)
        force = material.flat_stiffness(Layer(h=H, E=E, nu=0.45), radius) * depth
        force += 0.004 * force.max() * rng.standard_normal(50)
        tests.append(material.Indentation(depth, force, radius=radius, thickness=H, speed=MID, indenter="flat"))
    found = material.from_tests(tests)
    assert found.nu == pytest.approx(0.45, abs=4 * found.nu_std)
    assert found.interval(0.999)[0] < E < found.interval(0.999)[1]


def test_the_point_of_contact_is_found() -> None:
    """Half of the record lies before the contact, whose place is not where the depth is zero."""
    rng = np.random.default_rng(13)
    depth = np.linspace(-0.3e-3, 0.3e-3, 200)
    force = material.sphere_force(Layer(h=H, E=E, nu=0.47), 4e-3, depth)
    force += 0.004 * force.max() * rng.standard_normal(200)
    test = material.Indentation(depth + 2e-3, force, radius=4e-3, thickness=H, speed=MID)
    found = material.from_tests([test], nu=0.47)
    assert pytest.approx(E, abs=4 * found.E_std) == found.E
    assert found.linear.verdict == "shown"


def test_intervals_of_modulus_and_ratio_cover_where_both_are_found() -> None:
    """Runs scatter by 2 %: z of six curves and two unknowns goes as Student's t of four, of std 1.41."""
    z = []
    for seed in range(10):
        rng = np.random.default_rng(1000 + seed)
        runs = E * (1 + 0.02 * rng.standard_normal(6))
        found = material.from_tests([press(R, 0.47, rng, E=e) for R, e in zip([2e-3, 20e-3] * 3, runs, strict=True)])
        z += [(found.E - E) / found.E_std, (found.nu - 0.47) / found.nu_std]
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 2.0
    assert np.mean(np.abs(z) < 2.78) > 0.85  # 95 % of Student's t of four


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"elongation": np.zeros(40)}, "does not move"),
        ({"force": np.full(40, np.nan)}, "no curve"),
        ({"force": np.zeros(39)}, "no curve"),
        ({"area": 0.0}, "area must be positive"),
        ({"contraction": np.zeros(40)}, "width"),
    ],
)
def test_curves_that_are_none_are_refused(change: dict, words: str) -> None:
    x = np.linspace(0, 1e-3, 40)
    settings = {"elongation": x, "force": 5 * x, "length": 20e-3, "area": 1e-6, "speed": 1e-3} | change
    with pytest.raises(InputError, match=words):
        material.Tensile(**settings)


def test_a_sphere_far_too_large_for_the_layer_is_refused_and_a_large_one_is_not() -> None:
    rng = np.random.default_rng(14)
    large = press(0.15, 0.499, rng)
    assert large.radius * np.ptp(large.depth) / H**2 > 5.3
    found = material.from_tests([large], nu=0.499)
    assert pytest.approx(E, rel=0.05) == found.E
    with pytest.raises(InputError, match="too wide"):
        material.Indentation(large.depth, large.force, radius=0.2, thickness=H, speed=MID)
    with pytest.raises(InputError, match="too wide"):
        material.Indentation(large.depth, large.force, radius=5 * H, thickness=H, speed=MID, indenter="flat")


def test_a_curve_without_stiffness_and_no_curves_are_refused() -> None:
    x = np.linspace(0, 1e-3, 40)
    flat = material.Tensile(x, np.zeros(40), length=20e-3, area=1e-6, speed=1e-3)
    falling = material.Tensile(x, -5 * x, length=20e-3, area=1e-6, speed=1e-3)
    for bad in (flat, falling):
        with pytest.raises(InputError, match="does not grow"):
            material.from_tests([bad])
    with pytest.raises(InputError, match="no tests"):
        material.from_tests([])
    with pytest.raises(InputError, match="ratio"):
        material.from_tests([falling], nu=0.6)
