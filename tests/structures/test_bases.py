"""Load bases against closed forms, exact integrals of polynomial fields, and the same loads one by one."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from structures import Dof, ForwardModel, Structure, Surface, bases, beams, chains, plates, solids
from structures._system.loads import Patch, Point, matrix, near_support
from structures._system.sensors import Displacement
from structures.errors import InputError

from .kinds import SQUARE, UNIT
from .test_sensors import BEAM, ORIGIN, PLATE, P, Q, beam_field, plate_field

XYZ = ("+X", "+Y", "+Z")
RUBBER = beams.Material(E=1e5, rho=1000.0, nu=0.45)
BLOCK = solids.block(lengths=(0.06, 0.04, 0.01), elements=(6, 5, 2), material=RUBBER, origin=(0.1, -0.2, 0.3))
TOP = BLOCK.field.surface("top")
WINDOW = ((0.113, 0.145), (-0.19, -0.171))
EVERY = {
    "beam patches": lambda: bases.patches(BEAM, 7),
    "beam elements": lambda: bases.patches(BEAM),
    "beam list": lambda: bases.patches(BEAM, rectangles=[(3.05, 3.5), (3.4, 3.95)]),
    "beam hats": lambda: bases.hats(BEAM, 4, components="-Z"),
    "beam mesh hats": lambda: bases.hats(BEAM, region=(3.13, 3.77)),
    "beam polynomials": lambda: bases.polynomials(BEAM, 5, region=(3.2, 3.9)),
    "plate patches": lambda: bases.patches(PLATE, (3, 5)),
    "plate list": lambda: bases.patches(PLATE, rectangles=[((-0.9, -0.5), (2.1, 2.3)), ((-0.6, -0.3), (2.2, 2.5))]),
    "plate hats": lambda: bases.hats(PLATE, ([-0.9, -0.7, -0.3], [2.05, 2.55])),
    "plate mesh hats": lambda: bases.hats(PLATE),
    "plate polynomials": lambda: bases.polynomials(PLATE, 4),
    "face patches": lambda: bases.patches(BLOCK, (4, 3), region="top", components=XYZ),
    "face cells": lambda: bases.patches(BLOCK, region="left", components=("-N", "+T1", "+T2")),
    "face hats": lambda: bases.hats(BLOCK, 3, region=("top", WINDOW), components="-N"),
    "face mesh hats": lambda: bases.hats(BLOCK, region=TOP, components=XYZ),
    "face polynomials": lambda: bases.polynomials(BLOCK, 3, region=("top", WINDOW), components=("+Z", "+X")),
    "beam nodal": lambda: bases.nodal(BEAM),
    "plate nodal": lambda: bases.nodal(PLATE),
    "face nodal": lambda: bases.nodal(BLOCK, "top", components=XYZ),
    "face nodal frame": lambda: bases.nodal(BLOCK, "left", components=("-N", "+T1", "-T2")),
}
DISTRIBUTED = [name for name in EVERY if "nodal" not in name]


@pytest.fixture(scope="module")
def built():
    return {name: build() for name, build in EVERY.items()}


def rigid_motions(structure, about):
    """Virtual rigid motions with the rows of `resultant`, from the DOF table alone."""
    nodes = sorted({dof.node for dof in structure.dofs})
    x = np.zeros((len(nodes), 3))
    x[:, : structure.coordinates.shape[1]] = structure.coordinates
    about = np.resize(np.r_[np.atleast_1d(about), 0, 0, 0], 3) if np.ndim(about) == 0 else np.r_[about, 0, 0][:3]
    arm = dict(zip(nodes, x - about, strict=True))
    out = []
    for k in range(6):
        turn = np.eye(3)[k - 3] if k >= 3 else np.zeros(3)
        row = []
        for dof in structure.dofs:
            move = np.eye(3)[k] if k < 3 else np.cross(turn, arm[dof.node])
            value = {7: 0.0}.get(dof.axis)
            if value is None:
                value = move[dof.axis - 1] if dof.axis <= 3 else turn[dof.axis - 4]
            row.append(dof.sign * value)
        out.append(row)
    return np.array(out)


# -- the loads themselves ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", EVERY)
def test_resultants_are_the_work_on_rigid_motions(built, name):
    basis = built[name]
    structure = basis.own_structure
    about = basis.coordinates.mean(axis=0) + 0.1
    work = rigid_motions(structure, about) @ basis.matrix.toarray()
    found = basis.resultant(about if len(about) > 1 else float(about[0]))
    labels = basis.resultant_labels
    wanted = {"Fx": 0, "Fy": 1, "Fz": 2, "F": 2, "Mx": 3, "My": 4, "Mz": 5, "M": 4}
    signs = [-1.0 if label == "M" else 1.0 for label in labels]  # on a beam M is positive about -Y
    expected = np.array([s * work[wanted[label]] for s, label in zip(signs, labels, strict=True)])
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())
    moved = basis.resultant()
    np.testing.assert_allclose(moved[: len(labels) // 2], found[: len(labels) // 2], rtol=1e-12)


@pytest.mark.parametrize("name", DISTRIBUTED)
def test_measures_and_mass_are_integrals_of_the_functions(built, name):
    basis = built[name]
    size, count = basis.measures, len(basis.components)
    along = np.abs(np.sum(basis.force.T.reshape(basis.points, count, 3) * basis.directions, axis=-1))
    if "polynomials" not in name:
        np.testing.assert_allclose(along, np.tile(size[:, None], (1, count)), rtol=1e-9)
    gram = basis.mass.toarray()
    np.testing.assert_allclose(gram, gram.T, rtol=1e-12, atol=1e-18)
    assert np.linalg.eigvalsh(gram).min() > 0
    if "hats" in name:  # they sum to one
        np.testing.assert_allclose(gram.sum(axis=1), size, rtol=1e-10)
    elif name.endswith(("patches", "elements", "cells")):
        np.testing.assert_allclose(gram, np.diag(size), rtol=1e-10, atol=1e-15 * size.max())


spans = st.lists(st.floats(0, 1), min_size=2, max_size=2, unique=True).map(sorted).filter(lambda s: s[1] - s[0] > 1e-3)


@settings(max_examples=25, deadline=None)
@given(spans, st.integers(1, 9), st.floats(-3, 3), st.floats(-3, 3))
def test_hats_carry_a_linear_load_exactly(span, grid, a, b):
    """The work of a linear line load on a cubic deflection, whatever the grid cuts."""
    start, stop = ORIGIN + span[0], ORIGIN + span[1]
    basis = bases.hats(BEAM, grid, region=(start, stop))
    x = basis.coordinates[:, 0] - ORIGIN
    load = Polynomial([a, b])
    exact = (load * P).integ()
    assert (basis.matrix @ load(x)) @ beam_field() == pytest.approx(exact(span[1]) - exact(span[0]), abs=1e-11)


@pytest.mark.parametrize("grid", [None, 1, (3, 2), ([-1.0, -0.77, -0.2], [2.0, 2.1, 2.6])])
def test_hats_carry_a_bilinear_pressure_exactly(grid):
    basis = bases.hats(PLATE, grid)
    x, y = basis.coordinates.T + np.array([[1.0], [-2.0]])
    u, v = Polynomial([0.3, -1.0]), Polynomial([1.0, 2.0])
    exact = [f.integ()(side) for f, side in ((u * P, 0.8), (v * Q, 0.6))]
    assert (basis.matrix @ (u(x) * v(y))) @ plate_field() == pytest.approx(exact[0] * exact[1], rel=1e-11)


@settings(max_examples=15, deadline=None)
@given(spans, spans, st.integers(0, 5))
def test_polynomials_are_orthonormal_and_exact(sx, sy, degree):
    window = np.array([[-1 + 0.8 * sx[0], -1 + 0.8 * sx[1]], [2 + 0.6 * sy[0], 2 + 0.6 * sy[1]]])
    basis = bases.polynomials(PLATE, degree, region=window)
    x, w = np.polynomial.legendre.leggauss(8)
    places = window.mean(axis=1)[:, None] + np.ptp(window, axis=1)[:, None] / 2 * x
    grid = np.column_stack([g.ravel() for g in np.meshgrid(*places)])
    weights = np.outer(w, w).ravel() / 4
    psi = np.column_stack([basis.evaluate(unit, grid)[:, 0] for unit in np.eye(len(basis))])
    np.testing.assert_allclose(psi.T @ (weights[:, None] * psi), np.eye(len(basis)), atol=1e-11)
    area = np.prod(np.ptp(window, axis=1))
    deflection = P(grid[:, 0] + 1) * Q(grid[:, 1] - 2)
    np.testing.assert_allclose(basis.matrix.T @ plate_field(), area * psi.T @ (weights * deflection), atol=1e-11 * area)
    assert basis.resultant()[0, 0] == pytest.approx(area, rel=1e-12)
    assert len(basis) == (degree + 1) * (degree + 2) // 2


def test_a_uniform_load_bends_a_beam_and_a_plate_by_the_textbook():
    span = beams.simply_supported(elements=8, **UNIT)
    basis = bases.patches(span, 5)
    middle = ForwardModel(span, [Displacement(at=0.5)], basis).static() @ np.ones(5)
    assert middle[0] == pytest.approx(5 / 384, rel=1e-10)
    tip = beams.cantilever(elements=3, **UNIT)
    ramp = bases.hats(tip, 1)
    end = ForwardModel(tip, [Displacement(at=1.0)], ramp).static()[0]
    assert end == pytest.approx([1 / 30, 11 / 120], rel=1e-10)  # largest at the root, largest at the tip
    sheet = plates.plate(elements=(8, 8), edges="SSSS", **SQUARE)
    for uniform in (bases.patches(sheet, (3, 2)), bases.hats(sheet, 2), bases.polynomials(sheet, 0)):
        model = ForwardModel(sheet, [Displacement(at=(0.5, 0.5))], uniform)
        m = np.arange(1, 200, 2)
        signs = np.where(m % 4 == 1, 1.0, -1.0)
        navier = 16 / np.pi**6 * np.sum(np.outer(signs / m, signs / m) / np.add.outer(m**2, m**2) ** 2)
        assert (model.static() @ np.ones(len(uniform)))[0] == pytest.approx(navier, rel=1e-4)


HELD = PLATE.with_supports("0+Z", "1+Z", "3+Z", "19+Z", "19+RX")


# -- one by one -------------------------------------------------------------------------------------------------------
def pairs():
    plate = bases.patches(PLATE, (3, 4))
    beam = bases.patches(BEAM, 6)
    face = bases.patches(BLOCK, (3, 2), region="top", components=("+X", "+Z"))
    return {
        "plate": (plate, [Patch(x=tuple(e[0]), y=tuple(e[1])) for e in plate.extents]),
        "beam": (beam, [Patch(x=tuple(e[0])) for e in beam.extents]),
        "plate nodal": (
            bases.nodal(HELD),
            [Point(f"{n}+Z") for n in range(20) if Dof(n, 3) not in HELD.supports],
        ),
        "face nodal": (
            bases.nodal(BLOCK, "left", components=XYZ),
            [Point(f"{n}{c}") for n in BLOCK.field.surface("left").nodes if n >= 42 for c in XYZ],
        ),
        "face": (
            face,
            [
                solids.FacePatch("top", (tuple(e[0]), tuple(e[1])), direction=c)
                for e in face.extents
                for c in ("+X", "+Z")
            ],
        ),
    }


@pytest.mark.parametrize("name", ["plate", "beam", "plate nodal", "face nodal", "face"])
def test_a_basis_is_its_loads_one_by_one(name):
    basis, alone = pairs()[name]
    structure = basis.own_structure
    if structure.supports == ():
        structure = structure.with_supports(*[d for d in structure.dofs if d.node in (0, 3)])
    at = {"plate": (-0.6, 2.2), "beam": 3.41, "face": (0.12, -0.18, 0.31)}[name.split()[0]]
    read = [Displacement(at=at)]
    one, other = ForwardModel(structure, read, basis), ForwardModel(structure, read, alone)
    np.testing.assert_allclose(one.static(), other.static(), rtol=1e-9, atol=1e-12 * np.abs(other.static()).max())
    assert one.basis is basis
    assert other.basis is None
    assert one.perturbed("stiffness", 2.0).basis is basis
    assert [f.evidence for f in one.flags] == [f.evidence for f in other.flags]
    each = ForwardModel(structure, read, list(basis))
    np.testing.assert_allclose(each.static(), one.static(), rtol=1e-12)
    assert each.fingerprint == one.fingerprint
    np.testing.assert_allclose(matrix(structure, list(basis)), basis.columns(structure).toarray())


def test_a_basis_is_a_sequence():
    basis = bases.patches(PLATE, (2, 2))
    assert len(basis) == 4 == basis.points
    assert [load.label for load in basis] == [load.label for load in basis[:]]
    assert basis[-1] is basis[3]
    assert basis[0].measure == pytest.approx(0.4 * 0.3)
    assert (basis[0].unit, basis[0].quantity) == ("Pa", "pressure")
    assert bases.nodal(BEAM)[2].unit == "N"
    assert basis.shape == (2, 2)


def test_neighbours_and_cells():
    basis = bases.hats(PLATE, (4, 3))
    assert basis.shape == (4, 5)
    assert len(basis.edges) == 4 * 4 + 5 * 3
    steps = np.abs(np.diff(basis.coordinates[basis.edges], axis=1)[:, 0])
    assert np.all(np.isclose(steps, [0.2, 0]).all(axis=1) | np.isclose(steps, [0, 0.2]).all(axis=1))
    corners = basis.coordinates[basis.cells]
    x, y = corners[..., 0], corners[..., 1]
    areas = 0.5 * np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)
    assert areas == pytest.approx(np.full(12, 0.04))  # cyclic order
    face = bases.nodal(BLOCK, "top")
    assert len(face.edges) == 6 * 6 + 7 * 5
    assert np.array_equal(np.sort(face.cells), np.sort(TOP.cells))
    cells = bases.patches(BLOCK, region="top")
    assert len(cells.edges) == 5 * 5 + 6 * 4
    listed = bases.patches(
        PLATE, rectangles=[((-1, -0.8), (2, 2.2)), ((-0.8, -0.6), (2.1, 2.4)), ((-1, -0.8), (2.3, 2.5))]
    )
    assert listed.edges.tolist() == [[0, 1], [1, 2]]
    assert bases.patches(BEAM, 4).edges.tolist() == [[0, 1], [1, 2], [2, 3]]


# -- nodal forces against tractions -----------------------------------------------------------------------------------
def pressure(s, t):
    """A smooth pressure on the unit square, of degree four."""
    return 1.0 + 4 * s * (1 - s) + 3 * s * t - 5 * (t * (1 - t)) ** 2


@pytest.mark.parametrize("lumped", [False, True])
def test_refined_twice_the_traction_stays_and_the_nodal_force_falls_by_the_area(lumped):
    errors, forces = [], []
    for n in (4, 8, 16):
        block = solids.block(lengths=(1.0, 1.0, 0.5), elements=(n, n, 1), material=RUBBER)
        smooth, nodal = bases.polynomials(block, 4, region="top"), bases.nodal(block, "top")
        s, t = np.random.default_rng(0).random((2, 60))
        table = np.column_stack([smooth.evaluate(e, np.column_stack([s, t, s]))[:, 0] for e in np.eye(len(smooth))])
        c = np.linalg.lstsq(table, pressure(s, t), rcond=None)[0]
        f = nodal.matrix.T @ (smooth.matrix @ c)  # the integral of N p, exact
        traction = nodal.to_traction(f, lumped=lumped)
        x, y, _ = nodal.coordinates.T
        errors.append(np.abs(traction - pressure(x, y)).max())
        forces.append(f[np.argmin((x - 0.5) ** 2 + (y - 0.5) ** 2)])
        middle = nodal.evaluate(f, [[0.5, 0.5, 0.5]])[0, 0]
        assert middle == pytest.approx(pressure(0.5, 0.5), rel=0.04)
    assert forces[0] / forces[1] == pytest.approx(4, rel=0.03)
    assert forces[1] / forces[2] == pytest.approx(4, rel=0.01)
    assert errors[2] < (0.4 if lumped else 0.012)  # beside an edge, a tributary area sees the mean over half a cell
    assert lumped or errors[0] / errors[2] > 10


def test_tractions_of_vectors_and_frames():
    nodal = bases.nodal(BLOCK, "top", components=("-N", "+X"))
    t = np.random.default_rng(1).random((3, nodal.points, 2))
    f = np.einsum("pq,fqc->fpc", nodal.mass.toarray(), t).reshape(3, -1)
    np.testing.assert_allclose(nodal.to_traction(f), t.reshape(3, -1), rtol=1e-9)
    np.testing.assert_allclose(nodal.evaluate(f), t, rtol=1e-9)
    np.testing.assert_allclose(nodal.evaluate(f, nodal.coordinates), t, rtol=1e-9)
    assert np.all(nodal.evaluate(f, [[0.0, 0.0, 0.0]]) == 0)
    patches = bases.patches(PLATE, 2)
    np.testing.assert_array_equal(patches.to_traction(np.arange(4.0)), np.arange(4.0))
    assert (nodal.unit, nodal.traction_unit) == ("N", "Pa")


def test_the_mesh_of_a_face_is_that_of_its_surface():
    nodal = bases.nodal(BLOCK, "top")
    np.testing.assert_allclose(nodal.mass.toarray(), TOP.mass.toarray(), rtol=1e-10, atol=1e-18)
    np.testing.assert_allclose(nodal.measures, TOP.areas, rtol=1e-10)
    np.testing.assert_array_equal(nodal.normals, TOP.normals)


def test_part_of_a_face_is_loaded_over_its_own_cells():
    """A uniform traction on some cells: their nodes carry all of it, and give it back."""
    window = ((0.11, 0.15), (-0.192, -0.168))
    nodal, patch = bases.nodal(BLOCK, ("top", window)), bases.patches(BLOCK, 1, region=("top", window))
    f = nodal.matrix.T @ patch.matrix.toarray()[:, 0]
    assert nodal.measures.sum() == pytest.approx(0.04 * 0.024)
    assert f.sum() == pytest.approx(0.04 * 0.024)
    np.testing.assert_allclose(nodal.to_traction(f), 1.0, rtol=1e-9)
    lone = bases.nodal(BLOCK, "top", nodes=TOP.nodes[[8, 20]])
    np.testing.assert_allclose(lone.measures, TOP.areas[[8, 20]])


@pytest.mark.parametrize("name", DISTRIBUTED)
def test_the_field_at_points_is_the_load(built, name):
    """The integral of the field over many points is the resultant."""
    basis = built[name]
    if basis.values is None:
        return
    load = np.random.default_rng(0).random(len(basis))
    window = {"be": [[3, 4]], "pl": [[-1, -0.2], [2, 2.6]], "fa": [[0.1, 0.16], [-0.2, -0.16], [0.31, 0.31]]}[name[:2]]
    if name == "face cells":
        window = [[0.1, 0.1], [-0.2, -0.16], [0.3, 0.31]]
    window = np.array(window, float)
    places = window[:, 0] + np.ptp(window, axis=1) * np.random.default_rng(1).random((20000, len(window)))
    size = np.prod(np.ptp(window, axis=1)[np.ptp(window, axis=1) > 0])
    total = size * basis.evaluate(load, places).mean(axis=0)
    exact = basis.force.T.reshape(basis.points, -1, 3)
    exact = np.einsum("pc,pcd,pcd->c", load.reshape(basis.points, -1), exact, basis.directions)
    np.testing.assert_allclose(total, exact, rtol=0.05, atol=0.01 * size)


# -- curved faces -----------------------------------------------------------------------------------------------------
def bent(n=6):
    """60 degrees of a cylinder of radius 1 and width 0.5, as a surface and a structure that only holds its nodes."""
    angle, width = np.linspace(0, np.pi / 3, n + 1), np.linspace(0, 0.5, 4)
    a, b = (m.ravel() for m in np.meshgrid(angle, width, indexing="ij"))
    x = np.column_stack([np.cos(a), b, np.sin(a)])
    normals = np.column_stack([np.cos(a), 0 * a, np.sin(a)])
    i = (np.arange(n)[:, None] * 4 + np.arange(3)).ravel()
    cells = np.column_stack([i, i + 1, i + 5, i + 4])
    surface = Surface("bent", np.arange(len(x)), x, cells, normals, np.ones(len(x)), None)
    dofs = [(k, d) for k in range(len(x)) for d in (1, 2, 3)]
    return surface, Structure.from_matrices(np.eye(3 * len(x)), dofs=dofs, coordinates=x)


def test_pressure_on_a_bent_face_has_the_resultant_of_its_outline():
    surface, structure = bent()
    chord = 2 * np.sin(np.pi / 36)
    area = 6 * chord * 0.5
    projected = 0.5 * np.array([np.sin(np.pi / 3), 0, 1 - np.cos(np.pi / 3)])
    for basis in (
        bases.hats(structure, region=surface, components="+N"),
        bases.patches(structure, region=surface, components="+N"),
    ):
        total = basis.resultant().sum(axis=1)
        assert basis.measures.sum() == pytest.approx(area, rel=1e-12)
        assert total[:3] == pytest.approx(projected, abs=1e-12)
        with pytest.raises(InputError, match="at=None"):
            basis.evaluate(np.ones(len(basis)), [[1.0, 0, 0]])
        assert basis.evaluate(np.ones(len(basis))).shape == (basis.points, 1)
    smooth = bases.polynomials(structure, 2, region=surface, components=("+N", "+T1", "+T2"))
    along = (
        -0.5 * (1 - np.cos(np.pi / 3)),
        0.5 * np.sin(np.pi / 3),
    )  # T1 is Y; T2 follows the arc, to the end of its chord
    expected = np.column_stack([projected, [0, area, 0], [along[0], 0, along[1]]])
    np.testing.assert_allclose(smooth.resultant()[:3, :3], expected, atol=1e-12)
    nodal = bases.nodal(structure, surface, components=("-N", "+T1", "+T2"))
    frames = np.einsum("pcd,ped->pce", nodal.directions, nodal.directions)
    np.testing.assert_allclose(frames, np.tile(np.eye(3), (nodal.points, 1, 1)), atol=1e-12)
    push = (nodal.mass @ np.outer(np.ones(nodal.points), [2.0, 0.0, -1.0])).ravel()
    np.testing.assert_allclose(nodal.to_traction(push), np.tile([2.0, 0.0, -1.0], nodal.points), atol=1e-12)
    with pytest.raises(InputError, match="curved or distorted"):
        bases.patches(structure, 4, region=surface)
    with pytest.raises(InputError, match="curved or distorted"):
        bases.hats(structure, region=(surface, ((0, 0.2), (0, 0.2))))


def test_crossed_cells_are_refused():
    surface, structure = bent()
    crossed = Surface(**{**vars(surface), "cells": surface.cells[:, [0, 2, 1, 3]]})
    with pytest.raises(InputError, match="convex quadrilateral"):
        bases.hats(structure, region=crossed)


# -- supports ---------------------------------------------------------------------------------------------------------
CANTILEVER = beams.cantilever(elements=10, **UNIT)


def test_a_load_on_supports_only_is_refused_by_name():
    basis = bases.nodal(CANTILEVER, nodes=[0, 4])
    with pytest.raises(InputError, match=r"1 load acts on supported DOFs.*0\+Z") as caught:
        ForwardModel(CANTILEVER, [Displacement("4+Z")], basis)
    assert caught.value.code == "LID-E104"
    bottom = bases.hats(BLOCK, region="bottom")
    with pytest.raises(InputError, match="LID-E104"):
        bottom.columns(BLOCK)
    assert 0 not in [int(label[:-2]) for label in bases.nodal(CANTILEVER).labels]  # all of a beam: its free nodes


def test_loads_near_a_support_are_flagged_at_once():
    model = ForwardModel(CANTILEVER, [Displacement("4+Z")], bases.nodal(CANTILEVER))
    (flag,) = model.flags
    assert flag.code == "LID-W105"
    assert flag.evidence.value == 1
    assert "1+Z beside 0-RY, 0+Z" in flag.message
    assert near_support(CANTILEVER, list(model.loads)[3:]) is None
    away = bases.patches(CANTILEVER, 4, region=(0.1, 1.0))
    assert ForwardModel(CANTILEVER, [Displacement("4+Z")], away).flags == ()
    assert near_support(BLOCK, bases.nodal(BLOCK, "top", components=XYZ)) is None  # the base lies below, not beside
    held = CANTILEVER.with_supports("10+Z")
    assert near_support(held, away).evidence.value == 1


def test_a_structure_without_a_mesh():
    line = chains.chain(masses=[1.0, 2.0, 1.0], springs=5.0)
    basis = bases.nodal(line, components="+X")
    assert basis.labels == ("1+X", "2+X", "3+X")
    assert basis.mass is None
    assert basis.resultant_labels[:3] == ("Fx", "Fy", "Fz")
    np.testing.assert_allclose(basis.resultant()[0], 1.0)
    with pytest.raises(InputError, match="no tractions"):
        basis.to_traction(np.ones(3))
    user = Structure.from_matrices(CANTILEVER.K, CANTILEVER.M, dofs=CANTILEVER.dofs, supports=["0+Z", "0-RY"])
    two, same = bases.nodal(user), bases.nodal(CANTILEVER)
    assert (two.matrix != same.matrix).nnz == 0
    assert near_support(user, two).evidence == near_support(CANTILEVER, same).evidence
    if basis.moment is None:
        with pytest.raises(InputError, match="no moment"):
            basis.resultant(0.0)


# -- size -------------------------------------------------------------------------------------------------------------
def test_thousands_of_candidates_stay_sparse():
    block = solids.block(lengths=(0.02, 0.02, 0.002), elements=(40, 40, 2), material=RUBBER)
    tracemalloc.start()
    basis = bases.nodal(block, "top", components=XYZ)
    model = ForwardModel(block, [Displacement(at=(0.01, 0.01, 0.002))], basis)
    assert len(model.fingerprint) == 64
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(basis) == 5043
    assert model.columns.nnz == 5043
    assert peak < 60e6  # one dense array of these columns has 407 MB


# -- what is refused --------------------------------------------------------------------------------------------------
WRONG = {
    "no structure": (lambda: bases.patches(None, 3), "no structure"),
    "grid text": (lambda: bases.patches(PLATE, "3"), "no grid"),
    "grid zero": (lambda: bases.patches(PLATE, 0), "no grid"),
    "grid three": (lambda: bases.patches(PLATE, (1, 2, 3)), "no grid"),
    "grid float": (lambda: bases.hats(BEAM, 2.5), "no grid"),
    "breaks": (lambda: bases.hats(BEAM, [3.1, 3.05]), "no breaks along x.*rising"),
    "breaks outside": (lambda: bases.hats(BEAM, [3.1, 4.05]), "no breaks along x.*from 3 to 4"),
    "both": (lambda: bases.patches(BEAM, 3, rectangles=[(3.1, 3.2)]), "stated twice"),
    "rectangles": (lambda: bases.patches(PLATE, rectangles=[(0, 1)]), "no list of patches"),
    "rectangle outside": (lambda: bases.patches(BEAM, rectangles=[(3.1, 3.2), (3.9, 4.2)]), r"\[1\].*3 <= x <= 4"),
    "rectangle nan": (lambda: bases.patches(BEAM, rectangles=[(3.1, np.nan)]), "a patch is empty"),
    "region": (lambda: bases.hats(PLATE, region=(0, 1)), "no region of a plate.*-1 <= x <= -0.2"),
    "region empty": (lambda: bases.hats(BEAM, region=(3.5, 3.5)), "no region of a beam"),
    "face missing": (lambda: bases.hats(BLOCK), 'a face, such as region="top"'),
    "face unknown": (lambda: bases.hats(BLOCK, region="roof"), "roof"),
    "chain": (lambda: bases.patches(chains.chain(masses=[1.0, 1.0], springs=1.0), 2), "no region"),
    "component": (lambda: bases.patches(BEAM, 3, components="+X"), "no components of a load on a beam"),
    "component twice": (lambda: bases.hats(BLOCK, region="top", components=("+Z", "-Z")), "each once"),
    "component rotation": (lambda: bases.nodal(BEAM, components="+RY"), "loads.Moment"),
    "component normal": (lambda: bases.nodal(PLATE, components="+N"), "no components"),
    "component none": (lambda: bases.nodal(PLATE, components=()), "no components"),
    "degree": (lambda: bases.polynomials(BEAM, -1), "degree"),
    "degree bool": (lambda: bases.polynomials(BEAM, False), "degree"),
    "degree high": (lambda: bases.polynomials(BEAM, 100), "0 to 40"),
    "nodes": (lambda: bases.nodal(BEAM, nodes=[1, 99]), r"\[99\], not in the region"),
    "nodes twice": (lambda: bases.nodal(BEAM, nodes=[1, 1]), "different node numbers"),
    "nodes text": (lambda: bases.nodal(BEAM, nodes="1+Z"), "no list of nodes"),
    "no node": (lambda: bases.nodal(BEAM, (3.01, 3.02)), "no node is left"),
    "no such face nodes": (lambda: bases.nodal(BLOCK, "top", nodes=[0]), r"\[0\], not in the region"),
    "loads shape": (lambda: bases.nodal(BEAM).to_traction(np.ones(3)), "do not fit the basis"),
    "loads nan": (lambda: bases.patches(BEAM, 1).to_traction([np.nan]), "do not fit the basis"),
    "at": (lambda: bases.patches(BEAM, 1).evaluate([1.0], [[1.0, 2.0]]), "no places"),
    "about": (lambda: bases.patches(PLATE, 1).resultant(0.0), "no point"),
    "another structure": (lambda: bases.patches(BEAM, 1).columns(CANTILEVER), "another structure"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_does_not_fit_is_refused_in_words(name):
    act, words = WRONG[name]
    with pytest.raises(InputError, match=words) as caught:
        act()
    assert caught.value.hint
    assert caught.value.expected
