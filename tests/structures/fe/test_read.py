"""Models of other programs: each format gives the model that CalculiX made, and what is damaged is one refusal."""

from __future__ import annotations

import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from scipy import io, sparse
from scipy.linalg import eigh

from structures import InputError
from structures.files import read_fe

FIXTURES = Path(__file__).parent / "fixtures"
HZ = np.loadtxt(FIXTURES / "frequencies.txt")
CCX = ("plate.sti", "plate.mas", "plate.inp")


def held(*names: str) -> list[Path]:
    """Paths of fixtures."""
    return [FIXTURES / name for name in names]


@pytest.fixture(scope="module")
def plate():
    """The plate of CalculiX, mm and N."""
    return read_fe(held(*CCX), units="mm, N")


def same(model, plate, tolerance=0.0):
    """Hold K, M, labels and places against those of the plate of CalculiX."""
    order = [model.dofs.index(d) for d in plate.dofs]
    for name in ("K", "M"):
        A, B = getattr(model, name).toarray()[np.ix_(order, order)], getattr(plate, name).toarray()
        assert np.abs(A - B).max() <= tolerance * np.abs(B).max(), name


def test_frequencies_are_those_of_calculix(plate):
    told = plate.summary()
    assert told.frequencies[:4] == pytest.approx(HZ, rel=1e-6)
    assert told.rigid == 0
    assert told.parts == 1
    assert told.remarks == ()


def test_mass_and_centre_are_in_si(plate):
    """Lumps of the four held nodes are left out by the solver: what remains is rho V (1 - 1/6) with linear shapes."""
    told = plate.summary([])
    assert told.mass == pytest.approx(7850 * 0.1 * 0.05 * 0.01 * (0.5 + 1 / 6), rel=1e-9)
    assert told.size == pytest.approx((0.1, 0.05, 0.01))
    assert told.centre[1:] == pytest.approx((0.025, 0.005))


@pytest.mark.parametrize("name", ["text.op4", "little.op4", "big.op4", "short.op4"])
def test_output4(plate, name):
    same(read_fe(held(name, "plate.dof", "nodes.bdf"), units="mm,N"), plate)


def test_punched_matrices_name_their_rows(plate):
    model = read_fe(held("plate.pch", "nodes.bdf"), units="mm,N")
    same(model, plate, 1e-9)
    assert model.coordinates == pytest.approx(plate.coordinates)


def abaqus(folder, form):
    """K and M of the plate as Abaqus writes them: lower triangles."""
    from .make_fixtures import matrices

    K, M, labels = matrices()
    files = []
    for name, A in (("STIF", K), ("MASS", M)):
        lines = []
        for i, j in zip(*np.nonzero(np.tril(A)), strict=True):
            at = (i + 1, j + 1) if form == "COORDINATE" else (*labels[i], *labels[j])
            mark = "," if form == "MATRIX INPUT" else " "
            lines.append(mark.join(str(int(a)) for a in at) + f"{mark} {A[i, j]:.15e}")
        files.append(folder / f"job_{name}2.mtx")
        files[-1].write_text("** a comment\n" + "\n".join(lines) + "\n")
    return files


@pytest.mark.parametrize("form", ["MATRIX INPUT", "LABELS", "COORDINATE"])
def test_abaqus_matrices(plate, tmp_path, form):
    files = abaqus(tmp_path, form)
    rows = held("plate.dof") if form == "COORDINATE" else []
    same(read_fe([*files, *rows, *held("plate.inp")], units="mm,N"), plate, 1e-14)


def test_abaqus_marks_supports_by_huge_entries(tmp_path):
    path = tmp_path / "job_STIF1.mtx"
    path.write_text("1,1,1,1, 1.e36\n2,1,2,1, 5.0\n2,1,1,1, -5.0\n")
    model = read_fe(path, units="m,N")
    assert model.held.tolist() == [[1, 1]]
    assert model.structure().K_free.toarray().tolist() == [[5.0]]


def test_harwell_boeing_symmetric_and_of_scipy(plate, tmp_path):
    from .make_fixtures import matrices

    K, M, labels = matrices()
    io.hb_write(tmp_path / "K.rua", sparse.csc_matrix(K))
    symmetric(tmp_path / "M.rsa", M)
    names = {1: "UX", 2: "UY", 3: "UZ"}
    (tmp_path / "plate.mapping").write_text(
        "Matrix Eqn   Node   DOF\n" + "".join(f"{k:10d} {n:10d} {names[a]:>4}\n" for k, (n, a) in enumerate(labels, 1))
    )
    files = [tmp_path / name for name in ("K.rua", "M.rsa", "plate.mapping")]
    same(read_fe([*files, *held("plate.inp")], units="mm,N"), plate, 1e-12)


def symmetric(path, A):
    """A matrix in the form that HBMAT writes: RSA, lower triangle, fixed fields that touch."""
    low = sparse.csc_matrix(np.tril(A))
    low.sort_indices()

    def fields(values, form, each):
        return ["".join(form % v for v in values[k : k + each]) for k in range(0, len(values), each)]

    parts = [fields(low.indptr + 1, "%8d", 10), fields(low.indices + 1, "%8d", 10), fields(low.data, "%25.16E", 3)]
    count = [len(p) for p in parts]
    head = ["mass".ljust(72) + "KEY".ljust(8), "".join(f"{n:14d}" for n in (sum(count), *count, 0)),
            "RSA" + " " * 11 + "".join(f"{n:14d}" for n in (*A.shape, low.nnz, 0)),
            "(10I8)".ljust(16) + "(10I8)".ljust(16) + "(3E25.16)".ljust(20)]  # fmt: skip
    path.write_text("\n".join([*head, *parts[0], *parts[1], *parts[2]]) + "\n")


def test_matrix_market_with_a_table_of_rows(plate, tmp_path):
    from .make_fixtures import matrices

    K, M, labels = matrices()
    io.mmwrite(tmp_path / "K.mtx", sparse.coo_matrix(K), precision=16)
    io.mmwrite(tmp_path / "M.mtx", sparse.coo_matrix(M), precision=16)
    same(read_fe([tmp_path / "K.mtx", tmp_path / "M.mtx"], units="mm,N", dofs=labels), plate, 1e-12)


# -- modes -------------------------------------------------------------------------------------------------------------
def test_output2_modes(plate):
    model = read_fe(held("modes.op2", "nodes.bdf"), units="mm,N")
    assert model.modes.frequencies[:4] == pytest.approx(HZ, rel=1e-6)
    agreeing(model, plate)


def test_output2_matrices(plate):
    model = read_fe(held("matrix.op2", "plate.dof"), units="mm,N")
    assert np.array_equal(model.K.toarray(), plate.K.toarray())


def test_universal_modes_of_pyuff(plate, tmp_path):
    pyuff = pytest.importorskip("pyuff")
    lam, phi = eigh(plate.K.toarray(), plate.M.toarray())
    nodes = np.unique(plate.labels[:, 0])
    file = pyuff.UFF(str(tmp_path / "modes.unv"))
    for k in range(6):
        shape = phi[:, k].reshape(-1, 3)
        file.write_sets(pyuff.prepare_55(
            id1="a", id2="b", id3="c", id4="d", id5="e", model_type=1, analysis_type=2, data_ch=2, spec_data_type=8,
            data_type=2, load_case=1, mode_n=k + 1, freq=np.sqrt(lam[k]) / 2 / np.pi, modal_m=4.0, modal_damp_vis=0.01,
            modal_damp_his=0.0, n_data_per_node=3, node_nums=nodes, r1=2 * shape[:, 0], r2=2 * shape[:, 1],
            r3=2 * shape[:, 2]), "add")  # fmt: skip
    model = read_fe(tmp_path / "modes.unv", units="m,N")
    assert model.modes.damping == pytest.approx(np.full(6, 0.01))
    agreeing(model, plate)


def test_a_table_of_modes(plate, tmp_path):
    lam, phi = eigh(plate.K.toarray(), plate.M.toarray())
    f = np.sqrt(lam[:6]) / 2 / np.pi
    lines = ["frequency,," + ",".join(map(repr, f.tolist())), "damping,," + ",".join(["0.01"] * 6)]
    for (node, axis), row in zip(plate.labels, phi[:, :6], strict=True):
        lines.append(f"{node},U{'XYZ'[axis - 1]}," + ",".join(map(repr, row.tolist())))
    (tmp_path / "modes.csv").write_text("\n".join(lines) + "\n")
    agreeing(read_fe(tmp_path / "modes.csv", units="m,N", modal_mass=1.0), plate)
    with pytest.raises(InputError, match="modal masses are not known"):
        read_fe(tmp_path / "modes.csv", units="m,N").modal([], [])


def agreeing(model, plate):
    """Six modes of a file answer as six modes of K and M do."""
    from structures import ForwardModel, damping, loads, sensors

    heard, driven = [sensors.Accelerometer("123+Z"), sensors.Displacement("33+Y")], [loads.Point("63+Z")]
    f = np.linspace(100.0, 5000.0, 9)
    whole = ForwardModel(plate.structure(damping=damping.Modal(0.01)), heard, driven, modes=6, residual=False)
    H = whole.frf(f)
    made = model.modal(heard, driven, None if model.modes.damping is not None else 0.01)
    assert np.abs(made.frf(f) - H).max(axis=0) == pytest.approx(0.0, abs=1e-5 * np.abs(H).max())
    assert made.state_space(1e-5).A.shape[0] >= 12


# -- meshes ------------------------------------------------------------------------------------------------------------
def bricks(path, turned=False):
    """A bar of two bricks by meshio; `turned` gives the second a negative volume."""
    meshio = pytest.importorskip("meshio")
    points = np.array([(x, y, z) for x in (0, 10, 20) for y in (0, 5) for z in (0, 2)], float)
    cells = [[0, 4, 6, 2, 1, 5, 7, 3], [4, 8, 10, 6, 5, 9, 11, 7]]
    if turned:
        cells[1] = cells[1][4:] + cells[1][:4]
    meshio.write(path, meshio.Mesh(points, [("hexahedron", np.array(cells))]))
    return path


def test_a_mesh_becomes_a_solid(tmp_path):
    from structures import beams

    model = read_fe(bricks(tmp_path / "bar.vtk"), units="mm,N", material=beams.materials.steel)
    told = model.summary()
    assert told.mass == pytest.approx(beams.materials.steel.rho * 20e-3 * 5e-3 * 2e-3)
    assert told.centre == pytest.approx((0.01, 0.0025, 0.001))
    assert told.rigid == 6
    with pytest.raises(InputError, match=r"invert|volume"):
        read_fe(bricks(tmp_path / "bad.vtk", turned=True), units="mm,N", material=beams.materials.steel)


# -- what does not fit, and what is refused ---------------------------------------------------------------------------
def test_units_are_asked(plate):
    with pytest.raises(InputError, match="units of the files are not stated"):
        read_fe(held(*CCX))
    with pytest.raises(InputError, match="no units of a model"):
        read_fe(held(*CCX), units="mm")
    told = read_fe(held(*CCX), units="m, N").summary([])
    assert any("no structural material" in r for r in told.remarks)


def test_the_summary_names_what_does_not_fit(tmp_path):
    K = np.array([[2.0, -1, 0, 0], [-1.5, 2, 0, 0], [0, 0, 1, -1], [0, 0, -1, 1]])
    lines = [f"{i + 1} 1 {j + 1} 1 {K[i, j]}" for i in range(4) for j in range(4) if K[i, j]]
    (tmp_path / "a_STIF1.mtx").write_text("\n".join(lines) + "\n")
    (tmp_path / "a_MASS1.mtx").write_text("1 1 1 1 1.0\n2 1 2 1 -1.0\n3 1 3 1 1.0\n4 1 4 1 1.0\n")
    told = read_fe([tmp_path / "a_STIF1.mtx", tmp_path / "a_MASS1.mtx"], units="m,N").summary()
    text = "\n".join(told.remarks)
    for word in ("K is not symmetric", "negative mass", "2 parts", "no frequencies"):
        assert word in text
    with pytest.raises(InputError, match="not symmetric"):
        read_fe(tmp_path / "a_STIF1.mtx", units="m,N").structure()


def test_matrices_of_other_sizes_or_orders_are_refused(tmp_path):
    n = 24
    K = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    M, labels = 4.0 * np.eye(n) + np.eye(n, k=1) + np.eye(n, k=-1), [(k + 1, 1) for k in range(n)]
    mixed = np.random.default_rng(0).permutation(n)
    for name, A in (("K", K), ("cut_M", M[:-3, :-3]), ("mixed_M", M[np.ix_(mixed, mixed)])):
        io.mmwrite(tmp_path / f"{name}.mtx", sparse.coo_matrix(A))
    with pytest.raises(InputError, match="labels do not fit"):
        read_fe([tmp_path / "K.mtx", tmp_path / "cut_M.mtx"], units="mm,N", dofs=labels)
    with pytest.raises(InputError, match="nodes in other orders"):
        read_fe([tmp_path / "K.mtx", tmp_path / "mixed_M.mtx"], units="mm,N", dofs=labels)
    (tmp_path / "a_STIF1.mtx").write_text("1,1,1,1,5.0\n")
    (tmp_path / "a_MASS1.mtx").write_text("7,1,7,1,5.0\n")
    with pytest.raises(InputError, match="other degrees of freedom"):
        read_fe([tmp_path / "a_STIF1.mtx", tmp_path / "a_MASS1.mtx"], units="mm,N")


def test_massless_rotations_get_an_inertia_that_no_mode_feels(tmp_path):
    from structures import beams
    from structures._models.reduction import modes

    beam = beams.cantilever(length=1.0, section=beams.Section.rectangle(0.04, 0.01), material=beams.materials.steel,
                            elements=8)  # fmt: skip
    keys = [(d.node + 1, d.axis) for d in beam.dofs]
    lumped = np.where([axis < 4 for _, axis in keys], beam.M.diagonal(), 0.0)
    for name, A in (("STIF", beam.K.toarray()), ("MASS", np.diag(lumped))):
        rows = [f"{keys[i][0]},{keys[i][1]},{keys[j][0]},{keys[j][1]},{A[i, j]:.17g}\n"
                for i, j in zip(*np.nonzero(A), strict=True)]  # fmt: skip
        (tmp_path / f"b_{name}1.mtx").write_text("".join(rows))
    model = read_fe([tmp_path / "b_STIF1.mtx", tmp_path / "b_MASS1.mtx"], units="m,N",
                    supports=[(d.node + 1, d.axis) for d in beam.supports])  # fmt: skip
    found = modes(model.structure(), 3).frequencies
    free = beam.free
    K, m = beam.K.toarray()[np.ix_(free, free)], lumped[free]
    light = m == 0
    schur = K[np.ix_(~light, ~light)] - K[np.ix_(~light, light)] @ np.linalg.solve(
        K[np.ix_(light, light)], K[np.ix_(light, ~light)]
    )
    exact = np.sqrt(eigh(schur, np.diag(m[~light]), eigvals_only=True)[:3]) / 2 / np.pi
    assert found == pytest.approx(exact, rel=1e-4)


@pytest.mark.parametrize(("name", "word"), [("a.full", "HBMAT"), ("a.odb", r"\*MATRIX OUTPUT"), ("a.rst", "universal"),
                                            ("a.xyz", "kind that is not read")])  # fmt: skip
def test_files_of_other_kinds_are_refused(tmp_path, name, word):
    (tmp_path / name).write_bytes(b"\0\1\2\3" * 50)
    with pytest.raises(InputError, match=word):
        read_fe(tmp_path / name, units="m,N")


@pytest.mark.parametrize(("name", "text", "word"), [
    ("a.op4", "       1       1       1       9KAA     2P,3E24.16\n", r"type \(1 to 4\)"),
    ("a.mtx", "%%MatrixMarket2 matrix coordinate real general\n1 1 1\n1 1 1.0\n", "no Matrix Market file"),
    ("a.msh", "$MeshFormat\n9.9 0 8\n$EndMeshFormat\n$Nodes\n1\n1 0 0 0\n$EndNodes\n", "as Gmsh 4.1"),
    ("b.msh", "$NOD\n1\n1 0 0 0\n$ENDNOD\n$ELM\n0\n$ENDELM\n", "as Gmsh 4.1"),
])  # fmt: skip
def test_files_of_another_version_are_refused(tmp_path, name, text, word):
    if name.endswith("msh"):
        pytest.importorskip("meshio")
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=word) as said:
        read_fe(tmp_path / name, units="m,N")
    assert "SystemExit" not in str(said.value)


# -- nodes in systems of their own ------------------------------------------------------------------------------------
@pytest.mark.parametrize(("old", "new", "told"), [
    ("*NODE,NSET=ALL", "*NODE, NSET=ALL, SYSTEM=C", "coordinate system of their own"),
    ("*NODE,NSET=ALL", "*SYSTEM\n10,10,0,10,20,0\n*NODE,NSET=ALL", "coordinate system of their own"),
    ("*MATERIAL", "*INSTANCE,NAME=A,PART=P\n5,0,0\n*END INSTANCE\n*MATERIAL", "coordinate system of their own"),
    ("*MATERIAL", "*TRANSFORM,NSET=ALL,TYPE=R\n0,1,0,-1,0,0\n*MATERIAL", "labels follow"),
])  # fmt: skip
def test_input_files_with_systems_of_their_own(plate, tmp_path, old, new, told):
    text = (FIXTURES / "plate.inp").read_text()
    (tmp_path / "own.inp").write_text(text.replace(old, new, 1))
    model = read_fe([*held("plate.sti", "plate.mas"), tmp_path / "own.inp"], units="mm,N")
    assert any(told in note for note in model.notes)
    assert (model.coordinates is None) == ("coordinate" in told)
    (tmp_path / "own.inp").write_text(text.replace("*NODE", "*SYSTEM\n1,0,0\n*SYSTEM\n*NODE", 1))  # ended again
    model = read_fe([*held("plate.sti", "plate.mas"), tmp_path / "own.inp"], units="mm,N")
    assert model.coordinates == pytest.approx(plate.coordinates)


def test_a_node_has_one_place(tmp_path):
    text = (FIXTURES / "plate.inp").read_text()
    (tmp_path / "two.inp").write_text("*NODE\n13,5,5,5\n" + text)
    (tmp_path / "more.inp").write_text("*NODE\n13,5,5,5\n")
    (tmp_path / "far.inp").write_text(text.replace("*NODE,NSET=ALL", "*NODE,INPUT=nodes.txt\n*NODE,NSET=ALL"))
    for names, told in (([tmp_path / "two.inp"], "two places"), ([tmp_path / "far.inp"], "in another file"),
                        ([tmp_path / "more.inp", FIXTURES / "plate.inp"], "two places")):  # fmt: skip
        with pytest.raises(InputError, match=told):
            read_fe([*held("plate.sti", "plate.mas"), *names], units="mm,N")


def two_grids(folder, system=0, constraint=""):
    """K and M of the g-set of two GRID points without names of the rows, and their bulk data."""
    io.mmwrite(folder / "KGG.mtx", sparse.eye_array(12).tocoo())
    io.mmwrite(folder / "MGG.mtx", sparse.eye_array(12).tocoo())
    (folder / "g.bdf").write_text(f"GRID,1,0,0.,0.,0.,0,{constraint}\nGRID,2,{system},5.,0.,0.\n")
    return [folder / name for name in ("KGG.mtx", "MGG.mtx", "g.bdf")]


def test_grid_points_in_a_system_of_their_own_still_name_the_rows(tmp_path):
    model = read_fe(two_grids(tmp_path, system=3), units="mm,N")
    assert model.labels.tolist() == [[n, d] for n in (1, 2) for d in range(1, 7)]
    assert model.coordinates is None


def test_supports_of_bulk_data_are_said(tmp_path):
    files = two_grids(tmp_path, constraint="123")
    assert "1 supports" in " ".join(read_fe(files, units="m,N").notes)
    files[-1].write_text("SPC1,1,123456,2\n" + files[-1].read_text())
    assert "2 supports" in " ".join(read_fe(files, units="m,N").notes)
    assert not read_fe(two_grids(tmp_path), units="m,N").notes


def test_a_static_model_claims_no_free_motions(tmp_path):
    files = two_grids(tmp_path)
    told = read_fe([files[0], files[2]], units="m,N")
    assert told.notes == ("no mass matrix: a model for static loads alone",)
    assert told.summary([]).rigid is None


UNIVERSAL = """    -1
   164
         1          SI: Metre         2
  1.0000000000000000D+00  1.0000000000000000D+00  1.0000000000000000D+00
  2.7314999999999998D+02
    -1
    -1
    15
         7         {cs}         0         1  0.00000E+00  0.00000E+00  0.00000E+00
         8         0         {cs}         1  1.00000E+01  0.00000E+00  0.00000E+00
    -1
    -1
    55
a
b
c
d
e
         1         2         2         8         2         3
         2         4         1         1
  1.00000e+01  1.00000e+00  1.00000e-02  0.00000e+00
         7
  0.00000e+00  0.00000e+00  1.00000e+00
         8
  0.00000e+00  0.00000e+00  2.00000e+00
    -1
"""


def test_universal_files_with_systems_and_units_of_their_own(tmp_path):
    path = tmp_path / "m.unv"
    path.write_text(UNIVERSAL.format(cs=1))
    assert read_fe(path).notes == ()
    assert read_fe(path).nodes.tolist() == [7, 8]
    (note,) = read_fe(path, units="mm,N").notes
    assert "states units of 1 m and 1 N" in note
    path.write_text(UNIVERSAL.format(cs=5))
    model = read_fe(path)
    assert not len(model.nodes)
    assert ["coordinate system" in n or "directions" in n for n in model.notes] == [True, True]


def test_single_precision_of_scipy(tmp_path):
    """SciPy writes single numbers narrower than the format that it states: negative ones touch."""
    K = np.array([[2.0, -1.25], [-1.25, 2.0]], np.float32)
    io.hb_write(tmp_path / "K.hb", sparse.csc_matrix(np.kron(np.eye(3, dtype=np.float32), K)))
    model = read_fe(tmp_path / "K.hb", units="m,N", dofs=[f"{k}+X" for k in range(1, 7)])
    assert np.array_equal(model.K.toarray(), np.kron(np.eye(3), K))


def test_matrix_market_cut_inside_its_last_number(tmp_path):
    path = tmp_path / "K.mtx"
    io.mmwrite(path, sparse.coo_matrix(np.diag([1.0, 12.375])))
    data = path.read_bytes()
    for size in range(len(data) - 4, len(data)):
        path.write_bytes(data[:size])
        with pytest.raises(InputError, match="cut"):
            read_fe(path, units="m,N", dofs=["1+X", "2+X"])


COUNTED = {"text.op4", "little.op4", "big.op4", "short.op4", "modes.op2", "matrix.op2"}  # these declare what they hold


@pytest.mark.parametrize("name", sorted({*COUNTED, "plate.pch", "plate.sti", "plate.dof", "nodes.bdf", "plate.inp"}))
def test_cut_files_are_refused(tmp_path, name):
    """At many bytes: only an InputError; what declares its size is never read short, but between two of its blocks."""
    data = (FIXTURES / name).read_bytes()
    path = tmp_path / name
    survived = 0
    for size in np.unique(np.linspace(1, len(data) - 1, 60).astype(int)):
        path.write_bytes(data[:size])
        try:
            read_fe([path, *(held("plate.dof") if name != "plate.dof" else [])], units="mm,N")
        except InputError:
            continue
        survived += 1
    assert survived <= (0 if name in COUNTED else 4)


@pytest.mark.parametrize("name", ["text.op4", "little.op4", "modes.op2", "plate.pch", "plate.sti"])
def test_damaged_files_raise_nothing_else(tmp_path, name):
    data, rng = (FIXTURES / name).read_bytes(), np.random.default_rng(3)
    for _ in range(40):
        changed = bytearray(data)
        for at in rng.integers(0, len(data), 4):
            changed[at] = int(rng.integers(0, 256))
        (tmp_path / name).write_bytes(changed)
        with suppress(InputError):
            read_fe([tmp_path / name, *held("plate.dof", "nodes.bdf")], units="mm,N").summary([])


# -- CalculiX, run here -----------------------------------------------------------------------------------------------
@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
def test_the_fixtures_are_what_calculix_writes(tmp_path):
    from . import make_fixtures

    make_fixtures.run("plate", make_fixtures.deck("*FREQUENCY,SOLVER=MATRIXSTORAGE\n4"), tmp_path)
    fresh = read_fe([tmp_path / name for name in CCX], units="mm,N")
    same(fresh, read_fe(held(*CCX), units="mm,N"), 1e-12)
