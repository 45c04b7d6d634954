import dataclasses
import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from structures import ForwardModel, NotIdentifiable, beams, frames, loads, sensors
from structures._elements.framefield import At
from structures._elements.frames import LineLoad, Member
from structures._elements.members import Element, Section
from structures._system.factor import Factor
from structures.errors import InputError

from .exact import assembled, beam_roots, frequencies, solve

STEEL = beams.materials.steel
BAR = Section.rectangle(0.02, 0.05)
E, G, RHO = STEEL.E, STEEL.E / 2.6, STEEL.rho
EA, EIY, EIZ, GJ = E * BAR.A, E * BAR.I, E * BAR.I_z, G * BAR.J
KGA = 5 / 6 * G * BAR.A
STIFF = Section(A=1.0, I=1e-6, c=0.02)  # bends without stretching, as in the closed forms of slope-deflection


def frame(nodes, members, **settings):
    return frames.frame(nodes, members, **({"section": BAR, "material": STEEL} | settings))


def cantilever(rng, length=1.7, **settings):
    """A member in a random direction with a random reference, and its local axes as rows."""
    x, reference, start = rng.standard_normal(3), rng.standard_normal(3), 5 * rng.standard_normal(3)
    x /= np.linalg.norm(x)
    y = np.cross(reference, x)
    y /= np.linalg.norm(y)
    s = frame([start, start + length * x], [Member(0, 1, reference=reference)], supports={0: "clamped"}, **settings)
    return s, np.array([x, y, np.cross(x, y)])


def nodal(s, node, vector, turning=False):
    """Force or couple (in global axes) at a node."""
    out = np.zeros(s.n)
    for k, v in enumerate(vector):
        out[s.index((node, k + (4 if turning else 1)))] = v
    return out


# -- the element ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("shear", [False, True])
def test_closed_forms_are_the_integrals_of_the_shape_functions(shear):
    """Energy, mass and geometric stiffness by Gauss points, the slopes by differences that are exact for cubics."""
    e = Element(0.13, BAR, STEEL, shear)
    x, w = np.polynomial.legendre.leggauss(6)
    K, M, T = np.zeros((3, 12, 12))
    for xi, weight in zip((x + 1) / 2, w / 2 * e.h, strict=True):
        u, v, w_, rx, ry, rz = e.motion(xi)
        slope = sum(
            c * (e.motion(xi + k * d) - e.motion(xi - k * d)) / (2 * k * d * e.h)
            for d in (0.1,)
            for k, c in ((1, 4 / 3), (2, -1 / 3))
        )
        du, dry, drz = e.gradient(xi)
        assert np.allclose([du, dry, drz], slope[[0, 4, 5]], rtol=1e-9, atol=1e-9 * np.abs(slope).max())
        bent = [(EA, du), (GJ, slope[3]), (EIY, dry), (EIZ, drz)]
        bent += [(KGA, slope[2] + ry), (KGA, slope[1] - rz)] if shear else []
        if not shear:
            assert np.allclose(slope[2], -ry)
            assert np.allclose(slope[1], rz)
        K += weight * sum(c * np.outer(r, r) for c, r in bent)
        T += weight * sum(np.outer(r, r) for r in slope[1:3])
        moved = [(RHO * BAR.A, r) for r in (u, v, w_)] + [(RHO * (BAR.I + BAR.I_z), rx)]
        M += weight * sum(c * np.outer(r, r) for c, r in moved)
        if shear:
            M += weight * (RHO * BAR.I * np.outer(ry, ry) + RHO * BAR.I_z * np.outer(rz, rz))
    for closed, integral in ((e.stiffness(), K), (e.mass(), M), (e.tension(1.0), T)):
        scale = np.sqrt(np.maximum(integral.diagonal(), 1e-3 * integral.diagonal().max()))
        assert np.abs((closed - integral) / scale / scale[:, None]).max() < 1e-9


def test_a_plane_frame_along_x_is_the_beam():
    s = frame([(0, 0), (1.2, 0)], [(0, 1)], elements=6, supports={0: "clamped"})
    beam = beams.cantilever(length=1.2, section=BAR, material=STEEL, elements=6)
    ours = [s.index((node, axis)) for node in (0, 2, 3, 4, 5, 6, 1) for axis in (3, 5)]
    sign = np.array([dof.sign for dof in beam.dofs])
    for A, B in ((s.K, beam.K), (s.M, beam.M)):
        want = sign[:, None] * B.toarray() * sign
        assert np.abs(A.toarray()[np.ix_(ours, ours)] - want).max() < 1e-9 * np.abs(want).max()


# -- statics against closed forms ----------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("shear", [False, True])
@pytest.mark.parametrize("elements", [1, 5])
def test_cantilever_in_any_direction(seed, shear, elements):
    length = 1.7
    s, axes = cantilever(np.random.default_rng(seed), length, shear=shear, elements=elements)
    tip = [s.index((1, a)) for a in range(1, 7)]
    soft = length / KGA if shear else 0.0
    for axis, load, want in (
        (0, False, length / EA),
        (1, False, length**3 / 3 / EIZ + soft),
        (2, False, length**3 / 3 / EIY + soft),
        (0, True, length / GJ),
        (1, True, length / EIY),
        (2, True, length / EIZ),
    ):
        u = solve(s, nodal(s, 1, axes[axis], load))[tip]
        moved, turned = axes @ u[:3], axes @ u[3:]
        assert (turned if load else moved)[axis] == pytest.approx(want, rel=1e-8)
        if not load and axis:  # right-handed: a force along z turns the tip about -y, one along y about +z
            slope = length**2 / 2 / (EIZ if axis == 1 else EIY)
            assert turned[3 - axis] == pytest.approx(slope if axis == 1 else -slope, rel=1e-8)


@pytest.mark.parametrize(("k", "feet"), [(0.1, "clamped"), (1.0, "clamped"), (20.0, "clamped"), (2.0, "pinned")])
def test_sway_of_a_portal(k, feet):
    """Slope-deflection, k = (I / l of the beam) over (I / h of a column): P h^3 / 12 E I times a factor of k."""
    h, width, load = 3.0, 4.0, 1000.0
    beam = dataclasses.replace(STIFF, I=k * STIFF.I * width / h)
    s = frames.portal(width=width, height=h, section=STIFF, material=STEEL, beam=beam, feet=feet, elements=2)
    u = solve(s, load * loads.Point("2+X").column(s))
    factor = (3 * k + 2) / (6 * k + 1) / 12 if feet == "clamped" else (2 * k + 1) / k / 12
    want = load * h**3 / E / STIFF.I * factor
    assert u[s.index("2+X")] == pytest.approx(want, rel=1e-3)
    assert u[s.index("3+X")] == pytest.approx(want, rel=1e-3)


def test_reactions_of_a_portal_balance_the_load():
    s = frames.portal(width=4.0, height=3.0, section=BAR, material=STEEL, bays=2, storeys=2)
    q, p = LineLoad(6, direction="-Z").column(s) * 700, loads.Point("6+X").column(s) * 90
    r = dict(zip(map(str, s.supports), s.reactions(solve(s, p + q), p + q), strict=True))
    assert sum(v for k, v in r.items() if k.endswith("+Z")) == pytest.approx(700 * 4.0)
    assert sum(v for k, v in r.items() if k.endswith("+X")) == pytest.approx(-90)
    # moments about the origin: -x Z of every foot, the couples, the beam from x = 0 to 4 and the force at z = 6
    turn = sum(v for k, v in r.items() if k.endswith("RY")) - sum(4.0 * i * r[f"{i}+Z"] for i in range(3))
    assert turn + 700 * 4.0 * 2.0 + 90 * 6.0 == pytest.approx(0, abs=1e-6)


def test_frame_with_an_arm_in_its_plane_and_across():
    h, a, load = 2.0, 1.2, 50.0
    s = frame([(0, 0), (0, h), (a, h)], [(0, 1), (1, 2)], supports={0: "clamped"}, elements=3)
    u = solve(s, -load * loads.Point("2+Z").column(s))
    assert u[s.index("2+Z")] == pytest.approx(-load * (a**3 / 3 / EIY + a**2 * h / EIY + h / EA), rel=1e-8)
    assert u[s.index("2+X")] == pytest.approx(load * a * h**2 / 2 / EIY, rel=1e-8)
    assert u[s.index("1+RY")] == pytest.approx(load * a * h / EIY, rel=1e-8)
    flat = frame([(0, 0, 0), (h, 0, 0), (h, a, 0)], [(0, 1), (1, 2)], supports={0: "clamped"}, elements=3)
    u = solve(flat, load * loads.Point("2+Z").column(flat))
    want = load * (h**3 / 3 / EIY + a**3 / 3 / EIY + a**2 * h / GJ)
    assert u[flat.index("2+Z")] == pytest.approx(want, rel=1e-8)


def test_a_truss_carries_axial_forces_only():
    base, rise, load = 3.0, 2.0, 1e4
    members = [Member(i, j, hinge="both") for i, j in ((0, 1), (1, 2), (2, 0))]
    s = frame([(0, 0), (base, 0), (base / 2, rise)], members, supports={0: "pinned", 1: "Z"}, elements=4)
    u = solve(s, -load * loads.Point("2+Z").column(s))
    leg = np.hypot(base / 2, rise)
    N = {0: load * base / 4 / rise, 1: -load * leg / 2 / rise, 2: -load * leg / 2 / rise}
    for member, force in N.items():
        for fibre in (0.02, -0.025):
            gauge = sensors.StrainGauge(at=At(member, 0.7), fibre=fibre)
            assert gauge.row(s) @ u == pytest.approx(force / EA, rel=1e-8)
    work = sum(n * n * length for n, length in ((N[0], base), (N[1], leg), (N[2], leg)))
    assert -u[s.index("2+Z")] * load == pytest.approx(work / EA, rel=1e-8)


# -- line loads, forces and couples inside a member -----------------------------------------------------------------
@pytest.mark.parametrize("shear", [False, True])
@pytest.mark.parametrize("elements", [1, 4])
def test_weight_of_an_inclined_cantilever(shear, elements):
    length, slope, q = 2.0, 0.6, 30.0
    tip = (length * np.cos(slope), length * np.sin(slope))
    s = frame([(0, 0), tip], [(0, 1)], supports={0: "clamped"}, shear=shear, elements=elements)
    u = solve(s, q * LineLoad(0, direction="-Z").column(s))
    across, along = -q * np.cos(slope), -q * np.sin(slope)
    v = along * length**2 / 2 / EA
    w = across * (length**4 / 8 / EIY + (length**2 / 2 / KGA if shear else 0.0))
    want = [v * np.cos(slope) - w * np.sin(slope), v * np.sin(slope) + w * np.cos(slope)]
    assert u[[s.index("1+X"), s.index("1+Z")]] == pytest.approx(want, rel=1e-8)
    inclined = LineLoad(0, direction=(-np.sin(slope), np.cos(slope))).column(s)
    assert solve(s, inclined)[s.index("1+RY")] == pytest.approx(-(length**3) / 6 / EIY, rel=1e-8)


def test_line_loads_on_a_part_of_a_member_integrate_the_field():
    """Against the motion at many places, elements shared partly; and the couple that a load makes about its start."""
    rng = np.random.default_rng(3)
    s, _ = cantilever(rng, elements=5, shear=True)
    u = rng.standard_normal(s.n)
    x, w = np.polynomial.legendre.leggauss(60)
    for span in ((0.0, 1.7), (0.2, 0.9), (0.35, 0.36)):
        for direction, vector in (("-Y", (0, -1, 0)), ((1.0, 2.0, -2.0), (1 / 3, 2 / 3, -2 / 3))):
            load = LineLoad(0, span, direction=direction)
            cuts = np.unique(np.clip([*span, *np.arange(6) * 0.34], *span))
            total = 0.0
            for a, b in itertools.pairwise(cuts):
                at = (a + b) / 2 + (b - a) / 2 * x
                rows = [sum(c * s.field.motion((0, p), k + 1) for k, c in enumerate(vector)) @ u for p in at]
                total += (b - a) / 2 * w @ rows
            assert load.column(s) @ u == pytest.approx(total, rel=1e-9)
            assert load.measure == pytest.approx(span[1] - span[0])
    assert LineLoad(0).label == "member=0 -Z"
    assert LineLoad(2, (0.5, 1), direction=(3, 4)).label == "member=2 s=0.5..1 (0.6, 0.8)"


def test_forces_and_couples_inside_a_member():
    s = frame([(0, 0, 0), (0, 0, 2.0)], [(0, 1)], supports={0: "clamped", 1: "clamped"}, elements=16)
    for at in (0.5, 0.83):  # at a node, and inside an element
        u = solve(s, loads.Point(at=At(0, at), direction="+Y").column(s))
        want = at**3 * (2 - at) ** 3 / (3 * EIZ * 2**3)
        assert sensors.Displacement(at=At(0, at), direction="+Y").row(s) @ u == pytest.approx(want, rel=1e-3)
    one = frame([(0, 0, 0), (0, 0, 2.0)], [(0, 1)], supports={0: "clamped"}, elements=4)
    for axis, stiffness in (("RZ", GJ), ("RY", EIY), ("RX", EIZ)):  # a vertical member: z is +X, y is +Y
        u = solve(one, loads.Moment(at=At(0, 0.7), direction=f"+{axis}").column(one))
        for s_, want in ((1.3, 0.7), (2.0, 0.7), (0.5, 0.5)):
            got = sensors.Displacement(at=At(0, s_), direction=f"-{axis}").row(one) @ u
            assert -got == pytest.approx(want / stiffness, rel=1e-3 if axis != "RZ" else 0.03)


def test_motion_between_the_nodes_is_exact_where_nothing_acts():
    s, axes = cantilever(np.random.default_rng(7), elements=2)
    u = solve(s, nodal(s, 1, axes[2]))
    for at in (0.0, 0.31, 0.85, 1.2, 1.7):
        rows = np.array([sensors.Displacement(at=At(0, at), direction=d).row(s) for d in ("X", "Y", "Z")])
        assert axes @ rows @ u == pytest.approx([0, 0, at**2 * (3 * 1.7 - at) / 6 / EIY], rel=1e-8, abs=1e-12)
        rows = np.array([sensors.Displacement(at=At(0, at), direction=d).row(s) for d in ("RX", "RY", "RZ")])
        assert axes @ rows @ u == pytest.approx([0, -at * (2 * 1.7 - at) / 2 / EIY, 0], rel=1e-8, abs=1e-12)


def test_gauges_read_axial_strain_and_both_bendings():
    length = 1.7
    for shear in (False, True):
        s, axes = cantilever(np.random.default_rng(11), length, elements=4, shear=shear)
        N, Py, Pz = 4000.0, 130.0, -90.0
        u = solve(s, nodal(s, 1, N * axes[0] + Py * axes[1] + Pz * axes[2]))
        for at in (0.1, 0.425, 0.6, 1.6):
            for y, z in ((0.01, 0.025), (-0.01, 0.01), (0.0, -0.025), (0.01, 0.0), (0.0, 0.0)):
                want = N / EA - (length - at) * (Py * y / EIZ + Pz * z / EIY)
                for grid in (None, 0.15):
                    gauge = sensors.StrainGauge(at=At(0, at), fibre=(y, z), length=grid)
                    assert gauge.row(s) @ u == pytest.approx(want, rel=1e-8)
            upper = sensors.StrainGauge(at=At(0, at), fibre=0.025)
            assert np.array_equal(upper.row(s), sensors.StrainGauge(at=(0, at), fibre=(0.0, 0.025)).row(s))
    assert upper.label == "strain member=0 s=1.6"


def test_gauges_under_a_line_load():
    s = frame([(0, 0), (0, 2.0)], [(0, 1)], supports={0: "pinned", 1: "pinned"}, elements=40)
    u = solve(s, LineLoad(0, direction="-X").column(s))  # along +z of the upright member
    for at in (0.5, 1.03):
        gauge = sensors.StrainGauge(at=At(0, at), fibre=0.025)
        assert gauge.row(s) @ u == pytest.approx(at * (2 - at) / 2 * 0.025 / EIY, rel=1e-3)


# -- dynamics ------------------------------------------------------------------------------------------------------
def test_every_mode_of_an_inclined_clamped_member_in_space():
    """Bending in both planes (cosh b cos b = 1), rod and shaft: all modes, sorted."""
    length = 2.0
    nodes = [(1, 2, 3), (1 + length * 2 / 3, 2 - length / 3, 3 + length * 2 / 3)]
    s = frame(nodes, [(0, 1)], supports={0: "clamped", 1: "clamped"}, elements=30)
    bending = beam_roots("clamped", "clamped", count=12) / length**2
    n = np.arange(1, 4) * np.pi / length
    want = np.concatenate([
        bending * np.sqrt(EIY / RHO / BAR.A),
        bending * np.sqrt(EIZ / RHO / BAR.A),
        n * np.sqrt(E / RHO),
        n * np.sqrt(GJ / RHO / (BAR.I + BAR.I_z)),
    ])  # fmt: skip
    assert frequencies(s, 14) == pytest.approx(np.sort(want)[:14], rel=2e-3)
    assert frequencies(s, 10) == pytest.approx(np.sort(want)[:10], rel=1e-3)


def timoshenko(section, length, count, tension=0.0):
    """Simply supported: the lower root of the quadratic in omega^2 of every half-wave."""
    k = np.arange(1, count + 1) * np.pi / length
    kga, bend = 5 / 6 * G * section.A, E * section.I * k**2
    a, b = RHO * section.A, RHO * section.I
    B = a * (bend + kga) + b * (kga + tension) * k**2
    C = (kga + tension) * k**2 * (bend + kga) - (kga * k) ** 2
    return np.sqrt((B - np.sqrt(B * B - 4 * a * b * C)) / (2 * a * b))


def test_timoshenko_roots_and_their_order():
    deep, length = Section.rectangle(0.1, 0.2), 2.0
    along = np.array([0.6, 0.8]) * length
    rods = np.arange(1, 4) * np.pi / length * np.sqrt(E / RHO)
    want = np.sort(np.concatenate([timoshenko(deep, length, 5), rods]))[:6]
    plain = (5 * np.pi / length) ** 2 * np.sqrt(E * deep.I / RHO / deep.A)
    assert timoshenko(deep, length, 5)[4] < 0.8 * plain  # shear matters here
    error = []
    for elements in (20, 40, 80):
        s = frame(
            [(0, 0), along], [(0, 1)], section=deep, shear=True, elements=elements, supports={0: "pinned", 1: "pinned"}
        )
        got = frequencies(s, 6)
        error.append(np.abs(got / want - 1).max())
    assert error[-1] < 1e-3
    assert np.log2(error[0] / error[1]) == pytest.approx(2, abs=0.2)
    assert np.log2(error[1] / error[2]) == pytest.approx(2, abs=0.2)


@pytest.mark.parametrize("shear", [False, True])
def test_tension_stiffens_an_inclined_member(shear):
    length, T, n = 2.0, 3e4, np.arange(1, 5)
    tip = (length * 0.8, -length * 0.6)
    s = frame([(0, 0), tip], [Member(0, 1, tension=T)], elements=60, shear=shear, supports={0: "pinned", 1: "pinned"})
    k = n * np.pi / length
    plain = k**2 * np.sqrt((EIY + T / k**2) / RHO / BAR.A)
    want = timoshenko(BAR, length, 4, T) if shear else plain
    assert frequencies(s, 4) == pytest.approx(want, rel=1e-3)
    assert s.scaled("tension", 2.0).parameters["tension"] == 2.0
    if not shear:
        load = -0.9 * np.pi**2 * EIY / length**2  # nine tenths of the buckling load
        s = s.scaled("tension", -load / T)
        pressed = frame([(0, 0), tip], [Member(0, 1, tension=load)], elements=60, supports={0: "pinned", 1: "pinned"})
        assert abs(pressed.terms["tension"] + s.terms["tension"]).max() < 1e-9 * abs(s.terms["tension"]).max()
        loose = k[0] ** 2 * np.sqrt(EIY / RHO / BAR.A)
        assert frequencies(pressed, 1)[0] == pytest.approx(np.sqrt(0.1) * loose, rel=1e-3)


def test_a_portal_vibrates_as_a_refined_mesh_does():
    one = frequencies(frames.portal(width=4.0, height=3.0, section=BAR, material=STEEL, elements=10), 6)
    two = frequencies(frames.portal(width=4.0, height=3.0, section=BAR, material=STEEL, elements=40), 6)
    assert one == pytest.approx(two, rel=1e-3)
    # sway of a heavy, stiff beam on two light columns: k = 24 E I / h^3
    girder = Section(A=4.0, I=1.0, c=0.5)
    s = frames.frame(
        [(0, 0), (0, 3), (4, 3), (4, 0)],
        [(0, 1), Member(1, 2, section=girder), (2, 3)],
        supports={0: "clamped", 3: "clamped"},
        section=BAR,
        material=STEEL,
    )
    assert frequencies(s, 1)[0] == pytest.approx(np.sqrt(24 * EIY / 27 / (RHO * 4.0 * 4)), rel=1e-3)


# -- what every structure must be ----------------------------------------------------------------------------------
NODES = [(0, 0, 0), (1, 0.2, 0), (1, 1.5, 0.3), (0.2, 0.4, 2.0)]
MEMBERS = [(0, 1), Member(1, 2, section=Section.tube(0.05, 0.004)), (2, 3), Member(0, 3, elements=3), (1, 3)]


def space(nodes=NODES, **settings):
    references = [(0.1, 0.3, 1.0), None, (0, 1, 1), (1, 1, 0), None]
    turn = settings.pop("turn", np.eye(3))
    members = [
        dataclasses.replace(m if isinstance(m, Member) else Member(*m), reference=turn @ np.array(r or (0.2, 0.3, 1.0)))
        for m, r in zip(MEMBERS, references, strict=True)
    ]
    return frame(nodes, members, **({"elements": 4} | settings))


@pytest.mark.parametrize("shear", [False, True])
def test_rank_six_and_rigid_motions_without_energy(shear):
    s = space(shear=shear)
    names = ["translation X", "translation Y", "translation Z", "rotation RX", "rotation RY", "rotation RZ"]
    assert [m.name for m in s.rigid_body_motions()] == names
    for u in s.field.rigid().values():
        assert u @ s.K @ u < 1e-12 * np.abs(u) @ abs(s.K) @ np.abs(u)
    K = s.K.toarray()
    scale = 1 / np.sqrt(K.diagonal())
    values = np.linalg.eigvalsh(scale[:, None] * K * scale)
    assert np.abs(values[:6]).max() < 1e-12 < 1e-7 < values[6]
    one = frame(NODES[:2], [(0, 1)], elements=1, shear=shear).K.toarray()
    scale = 1 / np.sqrt(one.diagonal())
    assert np.linalg.matrix_rank(scale[:, None] * one * scale, hermitian=True, tol=1e-12) == 6


@pytest.mark.parametrize("elements", [1, 300])
def test_slender_members_far_from_the_origin_keep_their_rigid_motions(elements):
    """Axial stiffness is 1e7 times that of bending: its rounding must not pass for the energy of a rotation."""
    thin = Section.rectangle(0.003, 0.004)
    nodes = [(100, 200, 30), (101, 203, 31), (104, 203, 31)]
    s = frame(nodes, [(0, 1), (1, 2)], section=thin, elements=elements)
    assert len(s.rigid_body_motions()) == 6
    grounded = dataclasses.replace(s, K=s.K + 1e-3 * np.diag(s.unit_row("2+Z")))
    assert len(grounded.rigid_body_motions()) == 5


def test_mass_and_inertia():
    s = space()
    masses = [
        RHO * (m.section or BAR).A * np.linalg.norm(np.subtract(NODES[m.start], NODES[m.end]))
        for m in (m if isinstance(m, Member) else Member(*m) for m in MEMBERS)
    ]
    for axis in "XYZ":
        u = s.field.rigid()[f"translation {axis}"]
        assert u @ s.M @ u == pytest.approx(sum(masses), rel=1e-12)
    bar = frame([(0, 0), (0.6 * 2, 0.8 * 2)], [(0, 1)])
    size = 1.6  # the larger side; unit amplitude over it
    turn = size * bar.field.rigid()["rotation RY"]
    assert turn @ bar.M @ turn == pytest.approx(RHO * BAR.A * 2 * 2**2 / 12, rel=1e-10)


def test_a_turned_and_moved_frame_is_the_same():
    turn = Rotation.from_rotvec([0.3, -1.2, 0.7]).as_matrix()
    held = {0: "clamped", 2: "pinned"}
    here = space(supports=held)
    there = space([turn @ p + [100.0, -60.0, 20.0] for p in np.array(NODES)], supports=held, turn=turn)
    assert frequencies(there, 10) == pytest.approx(frequencies(here, 10), rel=1e-9)
    gauges = [sensors.StrainGauge(at=At(m, 0.4), fibre=(0.005, 0.01)) for m in range(5)]
    force = np.array([30.0, -20.0, 50.0])
    u, v = solve(here, nodal(here, 3, force)), solve(there, nodal(there, 3, turn @ force))
    for gauge in gauges:
        assert gauge.row(there) @ v == pytest.approx(gauge.row(here) @ u, rel=1e-8)


def test_reciprocity_and_dynamics():
    s = space(supports={0: "clamped"}, damping=0.01)
    at = [(At(1, 0.3), "+X"), (At(4, 1.1), "-Y"), (At(2, 0.77), "+Z")]
    seen = [sensors.Displacement(at=p, direction=d) for p, d in at] + [
        sensors.Displacement(at=At(3, 1.0), direction="RY")
    ]
    acting = [loads.Point(at=p, direction=d) for p, d in at] + [loads.Moment(at=At(3, 1.0), direction="RY")]
    model = ForwardModel(s, sensors=seen, loads=acting)
    assert np.allclose(model.static(), model.static().T, rtol=1e-9)
    H = model.frf([10.0, 77.0])
    assert np.allclose(H, H.transpose(0, 2, 1), rtol=1e-8)
    assert model.sensors[0].label == "member=1 s=0.3 +X"


def test_places_on_joints_and_the_numbering():
    s = space(supports={0: "clamped"})
    for node, places in {1: [(0, None), (1, 0.0), (4, 0.0)], 3: [(2, None), (3, None), (4, None)]}.items():
        for member, at in places:
            where = At(member, s.field.pieces[member].line.length if at is None else at)
            for axis in range(1, 7):
                assert np.allclose(s.field.motion(where, axis), s.unit_row((node, axis)), atol=1e-12)
    first = s.field.pieces[0].nodes
    assert list(first) == [0, 4, 5, 6, 1]
    assert s.field.box(5) == ((0, 0), (pytest.approx(np.hypot(1, 0.2) / 2),) * 2)
    nodes = sorted({dof.node for dof in s.dofs})
    assert np.allclose(s.coordinates[nodes.index(5)], [0.5, 0.1, 0.0])
    numbered = frame({7: (0, 0), 3: (1, 0)}, [(7, 3)], elements=2, supports={7: "clamped"})
    assert sorted({dof.node for dof in numbered.dofs}) == [3, 7, 8]
    assert str(numbered.supports[0]) == "7+X"
    assert not s.field.inside((0, 1.3))
    assert s.field.inside(At(0, 1.0))
    assert not s.field.inside((9, 0.1))


def test_places_are_found_from_coordinates():
    s = space()
    for member, at in ((0, 0.0), (1, 0.7), (3, 1.9), (4, 0.01)):
        piece = s.field.pieces[member]
        start = np.array(NODES[piece.nodes[0]], float)
        found = s.field.locate(start + at * piece.axes[0])
        assert found == (member, pytest.approx(at, abs=1e-9))
    with pytest.raises(InputError, match=r"on no member.*0\.5 m from member 0 at s = 0\.25 m"):
        frame([(0, 0), (1, 0)], [(0, 1)]).field.locate((0.25, 0.5))
    portal = frames.portal(width=4.0, height=3.0, section=BAR, material=STEEL)
    assert portal.field.locate((1.5, 3.0)) == (2, 1.5)


def test_guard_of_loads_near_supports():
    s = frames.portal(width=4.0, height=3.0, section=BAR, material=STEEL, elements=4)
    for load, near in (  # members: left column, right column, beam
        (loads.Point("2+X"), False),
        (loads.Point(at=At(0, 0.3), direction="+X"), True),
        (loads.Point(at=At(0, 0.75), direction="+X"), True),
        (loads.Point(at=At(0, 1.0), direction="+X"), False),
        (LineLoad(1), True),
        (LineLoad(2), False),
        (LineLoad(0, (1.5, 2.0), direction="+X"), False),
    ):
        assert (loads.near_support(s, load) is not None) == near, load.label
    held = s.with_supports("2+X")  # a joint: all members that meet there share it
    assert loads.near_support(held, loads.Point(at=At(0, 2.9), direction="+X")) is not None
    assert loads.near_support(held, loads.Point(at=At(2, 0.5))) is not None
    assert loads.near_support(held, loads.Point("2+Z")) is not None
    coarse = frame([(0, 0), (1, 0), (2, 0)], [(0, 1), (1, 2)], supports={2: "clamped"}, elements=1)
    assert loads.near_support(coarse, loads.Point("1+Z")) is not None  # held at the far end of the second member
    assert loads.near_support(coarse, loads.Point(at=At(0, 0.9))) is None
    with pytest.raises(InputError, match="LID-E104"):
        loads.Point(at=At(1, 0.0), direction="+X").column(s)


def test_a_force_moves_along_a_member():
    s = frames.portal(width=4.0, height=3.0, section=BAR, material=STEEL)
    moving = loads.MovingPoint([(2, 0.0), (2, 1.7), (2, 4.5)], outside="zero")
    columns = moving.columns(s)
    assert np.allclose(columns[1], loads.Point(at=At(2, 1.7)).column(s))
    assert not np.any(columns[2])


# -- hinges and mechanisms -----------------------------------------------------------------------------------------
def test_hinges_carry_no_moment():
    # two cantilevers that meet in a hinge share the force
    s = frame([(0, 0), (1, 0), (2, 0)], [Member(0, 1, hinge="end"), (1, 2)], supports={0: "clamped", 2: "clamped"})
    u = solve(s, loads.Point("1+Z").column(s))
    assert u[s.index("1+Z")] == pytest.approx(1 / 6 / EIY, rel=1e-8)
    left, right = (s.field.motion(at, 5) @ u for at in (At(0, 1.0), At(1, 0.0)))
    assert left == pytest.approx(-1 / 4 / EIY, rel=1e-8)
    assert right == pytest.approx(1 / 4 / EIY, rel=1e-8)
    # pinned whatever the support holds, and the joint has no rotation of its own
    s = frame([(0, 0), (0, 2)], [Member(0, 1, hinge="both")], supports={0: "clamped", 1: "clamped"}, elements=12)
    want = (np.arange(1, 4) * np.pi / 2) ** 2 * np.sqrt(EIY / RHO / BAR.A)
    assert frequencies(s, 3) == pytest.approx(want, rel=1e-3)
    assert "0+RY" not in map(str, s.dofs)
    # a ball joint at the tip of a propped cantilever in space: 3 E I / L^3 on the prop, in both planes
    s = frame([(0, 0, 0), (0, 0, 2)], [Member(0, 1, hinge="end")], supports={0: "clamped", 1: "clamped"}, elements=2)
    u = solve(s, loads.Point(at=At(0, 1.0), direction="+Y").column(s))
    assert s.field.motion(At(0, 1.0), 2) @ u == pytest.approx(7 * 2**3 / 768 / EIZ, rel=1e-8)


def four_bar(**settings):
    return frame(
        [(0, 0), (0, 1), (1, 1), (1, 0)],
        [(0, 1), Member(1, 2, hinge="both"), (2, 3)],
        supports={0: "pinned", 3: "pinned"},
        elements=3,
        **settings,
    )


def test_mechanisms_are_named():
    for s, name in (
        (frame([(0, 0), (1, 0)], [(0, 1)], supports={0: "pinned"}), "rotation RY"),
        (frame([(0, 0), (1, 0)], [(0, 1)], supports={0: "Z", 1: "Z"}), "translation X"),
        (frame([(0, 0, 0), (1, 0, 0)], [(0, 1)], supports={0: "pinned", 1: "pinned"}), "rotation RX"),
        (four_bar(), "rotation about the hinges at nodes 1, 2"),
    ):
        (motion,) = s.rigid_body_motions()
        assert name in motion.name
        assert len(assembled(s).rigid_body_motions()) == 1
        with pytest.raises(NotIdentifiable, match=f"LID-E116.*{name}"):
            Factor.of(s)


def test_the_linkage_is_the_motion_without_energy():
    s = four_bar()
    (motion,) = s.rigid_body_motions()
    u = motion.vector
    assert np.linalg.norm(s.K_free @ u[s.free]) < 1e-10 * np.linalg.norm(s.K.data)
    # a parallelogram: the bar translates, the columns turn
    x = [u[s.index((n, 1))] for n in (1, 2)]
    assert x[0] == pytest.approx(x[1], rel=1e-9)
    assert u[s.index("0+RY")] == pytest.approx(x[0], rel=1e-9)
    assert s.field.motion(At(1, 0.5), 5) @ u == pytest.approx(0, abs=1e-9)
    modes = ForwardModel(
        four_bar(damping=0.01), sensors=[sensors.Accelerometer("1+X")], loads=[loads.Point("1+X")]
    ).natural_frequencies
    assert modes[0] == 0
    assert modes[1] > 1
    held = s.with_supports("2+X")
    assert held.rigid_body_motions() == ()


# -- sections ------------------------------------------------------------------------------------------------------
def test_sections_know_both_axes_torsion_and_shear():
    square = Section.rectangle(0.1, 0.1)
    assert pytest.approx(0.140577e-4, rel=1e-5) == square.J
    # Timoshenko & Goodier, article 109: 0.229 and 0.312 of long x short^3 for sides of 2 and 10 to 1
    assert pytest.approx(0.229 * 0.2 * 0.1**3, rel=2e-3) == Section.rectangle(0.2, 0.1).J
    assert pytest.approx(0.312 * 0.5 * 0.05**3, rel=2e-3) == Section.rectangle(0.05, 0.5).J
    strip = Section.rectangle(1.0, 1e-4)
    assert pytest.approx(1e-12 / 3, rel=1e-3) == strip.J
    assert (strip.I_z, strip.c_y) == pytest.approx((1e-4 / 12, 0.5))
    pipe, rod = Section.tube(0.1, 1e-4), Section.circle(0.1)
    assert pytest.approx((2 * pipe.I, np.pi * 0.1**4 / 32)) == (pipe.J, rod.J)
    assert pipe.shear == pytest.approx((0.5, 0.5), rel=1e-3)
    assert rod.shear == pytest.approx((6 / 7, 6 / 7))
    assert Section(A=1.0, I=1.0, c=1.0).J is None
    for wrong in ({"J": 0.0}, {"I_z": -1.0}, {"shear": (0.5, 0.0)}, {"shear": 0.8}, {"c_y": np.nan}):
        with pytest.raises(InputError, match="section"):
            Section(A=1.0, I=1.0, c=1.0, **wrong)


# -- bad input -----------------------------------------------------------------------------------------------------
PAIR = [(0, 0), (1, 0)]
SPACE = [(0, 0, 0), (1, 0, 0)]
BARE = Section(A=1e-3, I=1e-7, c=0.02)


@pytest.mark.parametrize(
    ("build", "match"),
    [
        (lambda: frame(SPACE, [Member(0, 1, reference=(2, 0, 0))]), "parallel"),
        (lambda: frame(SPACE, [Member(0, 1, reference=(-1, 1e-9, 0))]), "parallel"),
        (lambda: frame(SPACE, [Member(0, 1, reference=(0, 0, 0))]), "no reference vector"),
        (lambda: frame(SPACE, [Member(0, 1, reference=(0, np.nan, 1))]), "no reference vector"),
        (lambda: frame(PAIR, [Member(0, 1, reference=(0, 0, 1))]), "plane frame takes no reference"),
        (lambda: frame([(0, 0), (0, 0), (1, 0)], [(0, 1), (1, 2)]), "0-1: a member has no length"),
        (lambda: frame(PAIR, [(0, 0), (0, 1)]), "no length"),
        (lambda: frame(PAIR, [(0, 2)]), "unknown node"),
        (lambda: frame(PAIR, [(0, "1")]), "unknown node"),
        (lambda: frame(PAIR, [(0, 1), (1, 0)]), "two members join the same nodes"),
        (lambda: frame([*PAIR, (5, 5)], [(0, 1)]), "falls into parts.*nodes 2"),
        (lambda: frame([*PAIR, (5, 5), (6, 6)], [(0, 1), (2, 3)]), "falls into parts"),
        (lambda: frame([(0, 0), (1, 0, 0)], [(0, 1)]), "two or all have three"),
        (lambda: frame([(0, 0), (1, np.inf)], [(0, 1)]), "a node has no place"),
        (lambda: frame([0.0, 1.0], [(0, 1)]), "a node has no place"),
        (lambda: frame([], [(0, 1)]), "two or all have three"),
        (lambda: frame(PAIR, []), "needs a member"),
        (lambda: frame(PAIR, [0, 1]), "no member"),
        (lambda: frame(PAIR, [(0, 1)], section=None), "no section"),
        (lambda: frame(PAIR, [(0, 1)], material="steel"), "no material"),
        (lambda: frame(PAIR, [(0, 1)], elements=0), "elements"),
        (lambda: frame(PAIR, [Member(0, 1, elements=2.5)]), "elements"),
        (lambda: frame(PAIR, [(0, 1)], supports={4: "clamped"}), "unknown node"),
        (lambda: frame(PAIR, [(0, 1)], supports={0: "glued"}), "unknown support.*clamped, pinned"),
        (lambda: frame(PAIR, [(0, 1)], supports={0: ("Y",)}), "unknown support"),
        (lambda: frame(PAIR, [(0, 1)], supports={0: 3.5}), "unknown support"),
        (lambda: frame(PAIR, [Member(0, 1, hinge="start")], supports={0: ("RY",)}), "unknown support"),
        (lambda: frame(SPACE, [(0, 1)], section=BARE), "lacks I_z, J"),
        (lambda: frame(PAIR, [(0, 1)], section=BARE, shear=True), "lacks shear"),
        (lambda: frame([(0, 0), (0.05, 0)], [(0, 1)]), "too deep.*shear=True"),
        (lambda: frame(SPACE, [Member(0, 1, hinge="both")]), "spin about its own axis"),
        (lambda: Member(0, 1, hinge="middle"), "unknown hinge"),
        (lambda: Member(0, 1, tension="much"), "tension"),
        (lambda: frames.portal(width=0, height=1, section=BAR, material=STEEL), "width"),
        (lambda: frames.portal(width=2, height=1, section=BAR, material=STEEL, bays=0), "bays"),
        (lambda: LineLoad(-1), "no member"),
        (lambda: LineLoad(0, (1.0, 0.5)), "no span"),
        (lambda: LineLoad(0, direction="RY"), "no direction"),
        (lambda: LineLoad(0, direction=(0.0, 0.0)), "no direction"),
        (lambda: LineLoad(0, direction=None), "no direction"),
    ],
)
def test_bad_input(build, match):
    with pytest.raises(InputError, match=match):
        build()


def test_bad_sensors_and_loads():
    flat, deep = frame(PAIR, [(0, 1)]), frame(SPACE, [(0, 1)])
    beam = beams.cantilever(length=1.0, section=BAR, material=STEEL)
    for make, match in (
        (lambda: sensors.Displacement(at=At(1, 0.5)).row(flat), "no such member"),
        (lambda: sensors.Displacement(at=(0.5, 0.5)).row(flat), "no such member"),
        (lambda: sensors.Displacement(at=At(0, 1.5)).row(flat), "outside"),
        (lambda: sensors.Displacement(at=0.5).row(flat), "no point"),
        (lambda: sensors.Displacement(at=At(0, 0.5), direction="Y").row(flat), "plane frame has no such motion"),
        (lambda: sensors.StrainGauge(at=At(0, 0.5), fibre=0.1).row(flat), "outside the section"),
        (lambda: sensors.StrainGauge(at=At(0, 0.5), fibre=(0.02, 0.0)).row(deep), "outside the section"),
        (lambda: sensors.StrainGauge(at=At(0, 0.5), fibre=(0.01, 0.01)).row(flat), "in its plane only"),
        (lambda: sensors.StrainGauge(at=At(0, 0.5), fibre=(0.01, np.nan)), "fibre"),
        (lambda: sensors.StrainGauge(at=At(0, 0.5), fibre=0.01, angle=0.3).row(flat), "along its axis"),
        (lambda: sensors.StrainGauge(at=At(0, 0.01), fibre=0.01, length=0.1).row(flat), "outside"),
        (lambda: sensors.StrainGauge(at=0.5, fibre=(0.0, 0.01)).row(beam), "height only"),
        (lambda: loads.Patch(x=(0, 1)).column(flat), "LineLoad"),
        (lambda: LineLoad(0, direction="+Y").column(flat), "no motion along Y"),
        (lambda: LineLoad(3).column(flat), "no such member"),
        (lambda: LineLoad(0, (0.0, 2.0)).column(flat), "outside"),
        (lambda: LineLoad(0).column(beam), "member of a frame"),
    ):
        with pytest.raises(InputError, match=match):
            make()
