import numpy as np
import pytest
from scipy.special import iv, ivp, jv, jvp, kv, kvp, yv, yvp

from structures import ForwardModel, beams, circular, loads, plates, sensors
from structures._system.checks import motions
from structures._system.factor import Factor
from structures.errors import InputError

from .exact import assembled, frequencies, roots, solve

RADIUS, THICKNESS, NU = 0.25, 4e-3, 0.33
ALLOY = beams.Material(E=70e9, rho=2700.0, nu=NU)
D = ALLOY.E * THICKNESS**3 / 12 / (1 - NU**2)
MASS = ALLOY.rho * THICKNESS
SCALE = np.sqrt(D / MASS) / RADIUS**2  # omega = lambda SCALE


def plate(**settings):
    return circular.plate(radius=RADIUS, thickness=THICKNESS, material=ALLOY, **settings)


# -- natural frequencies against Bessel functions ------------------------------------------------------------------
def conditions(n, k, r, kind, nu, functions):
    """Edge conditions at r of f = c . (J, I[, Y, K])(k r) cos n theta, one row each; derivatives from SciPy."""
    rows = []
    for f, df, sign in functions:
        w, s = f(n, k * r), k * df(n, k * r)
        # f'' from Bessel's equation: the Laplacian of each function is sign k^2 times itself
        bend = sign * k * k * w - s / r + n * n * w / r**2
        moment = bend + nu * (s / r - n * n * w / r**2)
        # V = d/dr (Laplacian) + (1 - nu) / r^2 d^2/dtheta^2 (f' - f / r)
        shear = sign * k * k * s - (1 - nu) * n * n / r**2 * (s - w / r)
        rows.append({"w": w, "slope": s, "moment": moment, "shear": shear})
    held = {"clamped": ("w", "slope"), "supported": ("w", "moment"), "free": ("moment", "shear")}[kind]
    return [[row[name] for row in rows] for name in held]


FULL = ((jv, jvp, -1), (iv, ivp, 1))
RING = (*FULL, (yv, yvp, -1), (kv, kvp, 1))


def exact(edge, nu, count, *, inner=None, orders=9):
    """First lambda = (k a)^2 of a plate of radius 1, each with its order n; zeros of rigid motions left out."""
    found = []
    for n in range(orders):

        def f(k, n=n):
            A = conditions(n, k, 1.0, edge, nu, RING if inner else FULL)
            if inner:
                A += conditions(n, k, inner[0], inner[1], nu, RING)
            A = np.array(A)
            A = A / np.abs(A).max(axis=0)
            return float(np.linalg.det(A / np.abs(A).max(axis=1, keepdims=True)))

        start = 0.4 if n < 2 else 0.3 * n
        found += [(k * k, n) for k in roots(f, start, 8, 0.1, stop=16.0)]
    return sorted(found)[:count]


def computed(s, count):
    """First lambda of a model, those of a pair (cosine and sine) once."""
    lam = frequencies(s, 2 * count + 6) / SCALE
    kept = [lam[0]]
    for value in lam[1:]:
        if value > kept[-1] * (1 + 1e-6):
            kept.append(value)
    return np.array(kept[:count])


@pytest.mark.parametrize("nu", [0.0, 0.33])
@pytest.mark.parametrize("edge", ["clamped", "supported", "free"])
def test_ten_frequencies(edge, nu):
    alloy = beams.Material(E=ALLOY.E * (1 - nu**2) / (1 - NU**2), rho=ALLOY.rho, nu=nu)
    s = circular.plate(radius=RADIUS, thickness=THICKNESS, material=alloy, edge=edge)
    want = np.array([lam for lam, _ in exact(edge, nu, 10)])
    assert computed(s, 10) == pytest.approx(want, rel=2e-4)


def test_the_bessel_roots_are_those_of_the_tables():
    """Leissa, Vibration of Plates (1969), chapter 2 (clamped, free); Leissa & Narita, J. Sound Vib. 70 (1980) 221."""
    assert [lam for lam, _ in exact("clamped", 0.3, 6)] == pytest.approx(
        [10.2158, 21.26, 34.88, 39.771, 51.04, 60.82], rel=5e-4
    )
    assert [lam for lam, _ in exact("supported", 0.3, 4)] == pytest.approx([4.935, 13.898, 25.613, 29.720], rel=2e-4)
    assert [lam for lam, _ in exact("free", 0.33, 3)] == pytest.approx([5.253, 9.084, 12.23], rel=2e-3)


@pytest.mark.parametrize("hole", [0.02, 0.1, 0.5])
@pytest.mark.parametrize(
    ("edge", "inner"), [("clamped", "free"), ("free", "clamped"), ("supported", "supported"), ("clamped", "clamped")]
)
def test_annular_plates(edge, inner, hole):
    # the steep field round a small hole takes more rings than it costs accuracy elsewhere
    s = plate(edge=edge, inner=(hole * RADIUS, inner), elements=30 if hole > 0.1 else 60)
    want = [lam for lam, _ in exact(edge, NU, 4, inner=(hole, inner))]
    assert computed(s, 4) == pytest.approx(want, rel=1e-3)


def test_axisymmetric_modes_of_the_impact_case():
    """Clamped aluminium plate of radius 0.25 m and 4 mm: 162.0, 630.8, 1413.2 Hz."""
    s = plate(harmonics=1)
    first = s.field.kept < s.field.line.size
    f = frequencies(s.with_supports(*(dof for dof, own in zip(s.dofs, first, strict=True) if not own)), 12) / 2 / np.pi
    assert f[:3] == pytest.approx([162.0, 630.8, 1413.2], abs=0.06)
    fine = plate(harmonics=1, elements=60)
    first = fine.field.kept < fine.field.line.size
    others = (dof for dof, own in zip(fine.dofs, first, strict=True) if not own)
    assert frequencies(fine.with_supports(*others), 12)[-1] / 2 / np.pi == pytest.approx(22545, rel=1e-3)


def test_fourth_order_of_the_frequencies():
    want = np.array([lam for lam, _ in exact("clamped", NU, 6)])
    error = [computed(plate(elements=n), 6) / want - 1 for n in (6, 12, 24)]
    order = np.log2(np.array(error[:-1]) / np.array(error[1:]))
    assert np.all(np.array(error) > 0)  # the element conforms: from above
    assert np.all(np.abs(order - 4) < 0.5), order


# -- statics -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("edge", "factor"), [("clamped", 1.0), ("supported", (5 + NU) / (1 + NU))])
def test_deflection_and_strain_under_pressure(edge, factor):
    """Timoshenko & Woinowsky-Krieger, articles 16 and 17."""
    s = plate(edge=edge)
    u = solve(s, circular.Pressure().column(s))
    assert sensors.Displacement(at=(0, 0)).row(s) @ u == pytest.approx(factor * RADIUS**4 / 64 / D, rel=1e-5)
    linear = 2 if edge == "clamped" else 2 * (3 + NU) / (1 + NU)
    for r in (0.0, 0.06, 0.2):
        w = (RADIUS**4 * factor - linear * RADIUS**2 * r**2 + r**4) / 64 / D
        radial, hoop = (-2 * linear * RADIUS**2 + 12 * r**2) / 64 / D, (-2 * linear * RADIUS**2 + 4 * r**2) / 64 / D
        for theta in (0.0, 0.7, 2.0, -1.5):
            at = (r * np.cos(theta), r * np.sin(theta))
            assert sensors.Displacement(at=at).row(s) @ u == pytest.approx(w, rel=1e-4)
            for turn, bend in ((0.0, radial), (np.pi / 2, hoop), (np.pi / 4, (radial + hoop) / 2)):
                gauge = sensors.StrainGauge(at=at, fibre=THICKNESS / 2, angle=theta + turn)
                assert gauge.row(s) @ u == pytest.approx(
                    -THICKNESS / 2 * bend, rel=3e-3, abs=1e-3 * abs(radial) * THICKNESS
                )
    reactions = s.reactions(u, circular.Pressure().column(s))
    assert reactions[[d.axis == 3 for d in s.supports]][0] == pytest.approx(-np.pi * RADIUS**2, rel=1e-9)


def test_a_force_at_the_centre():
    s = plate()
    u = solve(s, loads.Point(at=(0, 0)).column(s))
    assert np.count_nonzero(u) == 2 * s.field.line.elements - 1  # the axisymmetric harmonic alone
    for elements, tolerance in ((20, 1e-3), (80, 3e-5)):
        s = plate(elements=elements)
        u = solve(s, loads.Point(at=(0, 0)).column(s))
        exact = RADIUS**2 / 16 / np.pi / D
        assert sensors.Displacement(at=(0, 0)).row(s) @ u == pytest.approx(exact, rel=tolerance)
    r = 0.1
    there = sensors.Displacement(at=(0, -r)).row(s) @ u
    assert there == pytest.approx((2 * r**2 * np.log(r / RADIUS) + RADIUS**2 - r**2) / 16 / np.pi / D, rel=1e-5)


def deflection(x, y):
    """Green's function of the clamped plate of radius 1 with D = 1 (Michell 1902)."""
    (r, s), (phi, psi) = np.hypot(*np.transpose([x, y])), np.arctan2(*np.transpose([x, y])[::-1])
    near = r * r + s * s - 2 * r * s * np.cos(phi - psi)
    far = 1 + r * r * s * s - 2 * r * s * np.cos(phi - psi)
    return ((1 - r * r) * (1 - s * s) + near * np.log(near / far)) / 16 / np.pi


def test_forces_off_the_centre_against_michell():
    x, y = (0.1, 0.05), (-0.08, 0.12)
    centre = (3.0, -2.0)
    s = plate(harmonics=24, elements=40, centre=centre)
    at = [tuple(np.add(p, centre)) for p in (x, y)]
    model = ForwardModel(s, sensors=[sensors.Displacement(at=p) for p in at], loads=[loads.Point(at=p) for p in at])
    H = model.static()
    scale = RADIUS**2 / D
    assert H[0, 1] == pytest.approx(scale * deflection(np.array(x) / RADIUS, np.array(y) / RADIUS), rel=1e-4)
    assert H[0, 1] == pytest.approx(H[1, 0], rel=1e-12)
    r = np.hypot(*x) / RADIUS
    assert H[0, 0] == pytest.approx(scale * (1 - r * r) ** 2 / 16 / np.pi, rel=2e-3)


def test_harmonics_of_a_force_converge_with_the_second_order():
    at, r = (0.1, 0.0), 0.1 / RADIUS
    exact = RADIUS**2 / D * (1 - r * r) ** 2 / 16 / np.pi
    missing = []
    for harmonics in (4, 8, 16):
        s = plate(harmonics=harmonics, elements=80)
        missing.append(1 - loads.Point(at=at).column(s) @ solve(s, loads.Point(at=at).column(s)) / exact)
    assert np.all(np.diff(missing) < 0)
    assert np.log2(missing[0] / missing[1]) == pytest.approx(2, abs=0.5)


# -- the field against polynomials ---------------------------------------------------------------------------------
def interpolated(s, f):
    """Amplitudes of the harmonics of a function (w, w_x, w_y) of (x, y) at the rings, from the DFT round each ring."""
    line, field, m = s.field.line, s.field, 64
    out = np.zeros((field.families, line.size))
    theta = 2 * np.pi * np.arange(m) / m
    for i, r in enumerate(line.nodes):
        w, wx, wy = f(r * np.cos(theta), r * np.sin(theta))
        for k, values in enumerate((w, wx * np.cos(theta) + wy * np.sin(theta))):
            c = np.fft.rfft(values + 0 * theta) / m
            out[0, 2 * i + k] = c[0].real
            n = field.harmonics
            out[1::2, 2 * i + k], out[2::2, 2 * i + k] = 2 * c[1 : n + 1].real, -2 * c[1 : n + 1].imag
    return out.ravel()[field.kept]


def quadratic(x, y):
    """Every harmonic of it is a quadratic or cubic of r that the elements hold exactly."""
    w = 0.3 + 0.2 * x - 0.5 * y + 1.1 * x * x - 0.7 * x * y + 0.4 * y * y + 2 * (x**3 - 3 * x * y * y)
    wx = 0.2 + 2.2 * x - 0.7 * y + 6 * (x * x - y * y)
    return w, wx, -0.5 - 0.7 * x + 0.8 * y - 12 * x * y


@pytest.mark.parametrize("inner", [None, (0.05, "free")])
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.1, 0.0), (-0.03, 0.06), (0.08, 0.2), (0.0, -0.25), (1e-11, 2e-11)])
def test_rows_give_a_polynomial(inner, place):
    x, y = place
    if inner is not None and np.hypot(x, y) < inner[0]:
        return
    s = plate(edge="free", inner=inner, elements=5, harmonics=4)
    u = interpolated(s, quadratic)
    w, wx, wy = quadratic(x, y)
    assert sensors.Displacement(at=place).row(s) @ u == pytest.approx(w, rel=1e-12)
    assert sensors.Displacement(at=place, direction="+RX").row(s) @ u == pytest.approx(wy, rel=1e-8)
    assert sensors.Displacement(at=place, direction="+RY").row(s) @ u == pytest.approx(-wx, rel=1e-8)
    for angle in (0.0, 0.4, np.pi / 2, 2.5):
        c, sn = np.cos(angle), np.sin(angle)
        bend = c * c * (2.2 + 12 * x) + sn * sn * (0.8 - 12 * x) + 2 * c * sn * (-0.7 - 12 * y)
        gauge = sensors.StrainGauge(at=place, fibre=0.002, angle=angle)
        assert gauge.row(s) @ u == pytest.approx(-0.002 * bend, rel=1e-8)
        if np.hypot(x, y) < 0.24 and inner is None:
            # the field is cubic along the gauge: the mean is the value in the middle
            gauge = sensors.StrainGauge(at=place, fibre=0.002, angle=angle, length=0.01)
            assert gauge.row(s) @ u == pytest.approx(-0.002 * bend, rel=1e-8)


@pytest.mark.parametrize("region", [None, (0.0, 0.13), (0.07, 0.25)])
@pytest.mark.parametrize("angle", [None, (0.3, 1.1), (-2.0, 3.0)])
def test_pressure_integrates_a_polynomial(region, angle):
    s = plate(edge="free", elements=5, harmonics=4)
    a, b = region or (0.0, RADIUS)
    start, stop = angle or (0.0, 2 * np.pi)
    x, w = np.polynomial.legendre.leggauss(40)
    r, t = (a + b) / 2 + (b - a) / 2 * x, (start + stop) / 2 + (stop - start) / 2 * x
    values = quadratic(np.outer(r, np.cos(t)), np.outer(r, np.sin(t)))[0]
    want = (b - a) / 2 * (stop - start) / 2 * (w * r) @ values @ w
    load = circular.Pressure(radius=region, angle=angle)
    assert load.column(s) @ interpolated(s, quadratic) == pytest.approx(want, rel=1e-10)
    assert load.area(s) == pytest.approx((stop - start) / 2 * (b * b - a * a))
    assert load.column(s) @ s.field.rigid()["translation Z"] == pytest.approx(load.area(s), rel=1e-12)
    assert load.measure is None if region is None else load.measure == pytest.approx(load.area(s))
    assert np.allclose(circular.Pressure(radius=region, angle=angle, direction="-Z").column(s), -load.column(s))


# -- what every structure must be ----------------------------------------------------------------------------------
@pytest.mark.parametrize("inner", [None, (0.003, "free"), (0.1, "free")])
def test_energy_mass_and_rigid_motions(inner):
    s = plate(edge="free", inner=inner, harmonics=5, elements=7)
    assert {m.name for m in motions(s)} == {"translation Z", "rotation RX", "rotation RY"}
    for u in s.field.rigid().values():
        assert np.linalg.norm(s.K @ u) < 1e-12 * np.linalg.norm(s.K.data) * np.linalg.norm(u)
    K = s.K.toarray()
    scale = 1 / np.sqrt(K.diagonal())
    assert np.linalg.matrix_rank(scale[:, None] * K * scale, hermitian=True, tol=1e-12) == s.n - 3
    hole = inner[0] if inner else 0.0
    lift, tilt = s.field.rigid()["translation Z"], 2 * RADIUS * s.field.rigid()["rotation RX"]
    assert lift @ s.M @ lift == pytest.approx(MASS * np.pi * (RADIUS**2 - hole**2), rel=1e-12)
    assert tilt @ s.M @ tilt == pytest.approx(MASS * np.pi * (RADIUS**4 - hole**4) / 4, rel=1e-12)
    # energy of quadratics and cubics in closed form: D / 2 of the integral of (lap w)^2 - 2 (1 - nu) det(grad grad w)
    u = interpolated(s, lambda x, y: (x * y, y, x))
    assert u @ s.K @ u == pytest.approx(D * 2 * (1 - NU) * np.pi * (RADIUS**2 - hole**2), rel=1e-10)
    u = interpolated(s, lambda x, y: (x * x + y * y, 2 * x, 2 * y))
    assert u @ s.K @ u == pytest.approx(D * (16 - 8 * (1 - NU)) * np.pi * (RADIUS**2 - hole**2), rel=1e-10)
    u = interpolated(s, lambda x, y: (x**3 - 3 * x * y * y, 3 * (x * x - y * y), -6 * x * y))
    assert u @ s.K @ u == pytest.approx(D * 2 * (1 - NU) * 36 * np.pi * (RADIUS**4 - hole**4) / 2, rel=1e-10)


def test_quadrature_is_exact():
    """More Gauss points change nothing, also where 1 / r^3 is steep."""
    from structures._elements.circular import _points, bending
    from structures._system.fields import Line

    for line in (Line(1.0, 8), Line(0.99, 8, 0.01), Line(0.5, 3, 0.5)):
        for n in (0, 1, 3, 7):
            K = bending(line, n, 0.3)
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(circular, "_points", lambda line: 2 * _points(line) + 1)
                assert abs(bending(line, n, 0.3) - K).max() < 1e-12 * abs(K).max()


def test_turned_and_moved_plates_are_the_same():
    here, there = plate(), plate(centre=(100.0, -50.0))
    assert np.array_equal(here.K.data, there.K.data)
    ring = 0.1 * np.exp(1j * np.array([0.3, 0.3 + 1.234]))
    for s, (x, y) in ((here, (0.0, 0.0)), (there, (100.0, -50.0))):
        rows = [loads.Point(at=(z.real + x, z.imag + y)).column(s) for z in ring]
        u = [solve(s, row) for row in rows]
        assert rows[0] @ u[0] == pytest.approx(rows[1] @ u[1], rel=1e-9)
    rim = sensors.Displacement(at=(100 + RADIUS * np.cos(1.0), -50 + RADIUS * np.sin(1.0))).row(there)
    assert not np.any(rim[there.free])


def test_guard_of_loads_near_the_rim():
    s = plate(harmonics=3)
    h = RADIUS / s.field.line.elements
    for load, near in (
        (loads.Point(at=(0.0, 0.0)), False),
        (loads.Point(at=(0.0, RADIUS - 2.5 * h)), False),
        (loads.Point(at=(0.0, RADIUS - 0.5 * h)), True),
        (loads.Point(at=(0.5 * h - RADIUS, 0.0)), True),
        (circular.Pressure(radius=(0.0, 0.1)), False),
        (circular.Pressure(), True),
    ):
        assert (loads.near_support(s, load) is not None) == near, load.label
    with pytest.raises(InputError, match="LID-E104"):
        loads.Point(at=(RADIUS, 0.0)).column(s)


def test_dofs_and_places_of_nodes():
    s = plate(harmonics=2, elements=4)
    assert [str(d) for d in s.dofs[:5]] == ["0+Z", "1+Z", "1-RY", "2+Z", "2-RY"]
    assert "5-RY" in map(str, s.dofs)  # centre of cos theta: the slope
    assert "5+Z" not in map(str, s.dofs)
    assert not any(d.node in (15, 20) for d in s.dofs)  # centre of the second harmonics
    nodes = sorted({d.node for d in s.dofs})
    for node, place in zip(nodes, s.coordinates, strict=True):
        assert s.field.box(node) == tuple((v, v) for v in place)
        if (node, 3) in {d.key for d in s.dofs}:
            assert sensors.Displacement(at=place).row(s)[s.index((node, 3))] == pytest.approx(1.0)
    unit = np.zeros(s.n)
    unit[s.index("12-RY")] = 1.0  # sin theta, ring 2: the slope along +Y where it is largest
    assert sensors.Displacement(at=s.coordinates[nodes.index(12)], direction="+RX").row(s) @ unit == pytest.approx(1.0)


def test_dynamics_run_and_reciprocity_holds():
    s = plate(harmonics=4, damping=0.01)
    at = [(0.1, 0.0), (0.0, 0.12)]
    model = ForwardModel(s, sensors=[sensors.Displacement(at=p) for p in at], loads=[loads.Point(at=p) for p in at])
    H = model.frf([100.0, 400.0])
    assert np.allclose(H, H.transpose(0, 2, 1), rtol=1e-9)
    assert s.with_mass(at=(0.0, 0.0), kg=0.1).M.sum() != s.M.sum()
    assert plates.circular is circular


def test_the_algebra_agrees_with_the_geometry():
    s = plate(edge="free", harmonics=3, elements=6)
    assert len(assembled(s).rigid_body_motions()) == len(s.rigid_body_motions()) == 3
    with pytest.raises(Exception, match="translation Z, rotation RX, rotation RY"):
        Factor.of(s)


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"edge": "S"}, "unknown edge"),
        ({"edge": ["clamped"]}, "unknown edge"),
        ({"radius": 0.0}, "radius must be positive"),
        ({"thickness": 0.2}, "too thick"),
        ({"thickness": np.nan}, "thickness"),
        ({"material": None}, "no material"),
        ({"elements": 0}, "elements"),
        ({"harmonics": 0}, "harmonics"),
        ({"harmonics": 2.5}, "harmonics"),
        ({"inner": 0.1}, "no hole"),
        ({"inner": (0.3, "free")}, "no hole"),
        ({"inner": (0.1, "loose")}, "unknown inner edge"),
        ({"centre": 1.0}, "centre"),
        ({"damping": "strong"}, "damping"),
    ],
)
def test_bad_input(settings, match):
    with pytest.raises(InputError, match=match):
        circular.plate(**({"radius": RADIUS, "thickness": THICKNESS, "material": ALLOY} | settings))


def test_bad_sensors_and_loads():
    s, ring = plate(), plate(inner=(0.1, "free"))
    for make, match in (
        (lambda: sensors.Displacement(at=(0.3, 0.0)).row(s), "outside"),
        (lambda: sensors.Displacement(at=(0.01, 0.0)).row(ring), "outside"),
        (lambda: sensors.Displacement(at=0.1).row(s), "no point"),
        (lambda: sensors.Displacement(at=(0.1, 0.0), direction="+X").row(s), "moves along Z"),
        (lambda: sensors.StrainGauge(at=(0.1, 0.0), fibre=0.1).row(s), "outside the section"),
        (lambda: sensors.StrainGauge(at=(0.1, 0.0), fibre=(0.0, 0.001)).row(s), "height only"),
        (lambda: sensors.StrainGauge(at=(0.249, 0.0), fibre=0.001, length=0.01).row(s), "outside"),
        (lambda: loads.Patch(x=(0, 0.1), y=(0, 0.1)).column(s), "sectors"),
        (lambda: circular.Pressure(radius=(0.0, 0.3)).column(s), "outside"),
        (lambda: circular.Pressure(radius=(0.2, 0.1)), "no span"),
        (lambda: circular.Pressure(radius=0.1), "two finite numbers"),
        (lambda: circular.Pressure(angle=(0.0, 7.0)), "full turn"),
        (lambda: circular.Pressure(direction="+X"), "acts along Z"),
        (
            lambda: circular.Pressure().column(beams.cantilever(length=1.0, EI=1.0, mass_per_length=1.0)),
            "circular plate",
        ),
    ):
        with pytest.raises(InputError, match=match):
            make()
    assert s.field.inside((0.1, 0.1))
    assert not s.field.inside((0.2, 0.2))
