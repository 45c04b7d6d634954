"""Structures from files: every format gives the same matrices back, and what is damaged is refused in words."""

import contextlib
import io
import os
import re
import struct
import zipfile

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import sparse

from structures import ForwardModel, InputError, Structure, beams, chains, damping, files, plates
from structures._system.loads import Moment, Point
from structures._system.sensors import Displacement
from structures.files import _child as child
from structures.files import _hdf5 as hdf5
from structures.files._container import split

from .kinds import EVERY, UNIT

BEAM = beams.cantilever(elements=4, **UNIT)
K, M = BEAM.K.toarray(), BEAM.M.toarray()
LABELS = np.array([str(d) for d in BEAM.dofs])


def same(a, b):
    """Two structures with the same matrices, table, supports, coordinates and damping."""
    assert a.dofs == b.dofs
    assert a.supports == b.supports
    assert a.damping == b.damping
    for name in ("K", "M", "C"):
        one, two = getattr(a, name), getattr(b, name)
        assert (one is None) == (two is None)
        if one is not None:
            assert (one != two).nnz == 0
    if a.coordinates is not None:
        np.testing.assert_array_equal(a.coordinates, b.coordinates)


# -- there and back ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("suffix", [".npz", ".h5"])
@pytest.mark.parametrize("name", sorted(EVERY))
def test_a_structure_comes_back_bit_for_bit(tmp_path, name, suffix):
    structure = EVERY[name]()
    files.save(structure, tmp_path / f"model{suffix}")
    same(files.load(tmp_path / f"model{suffix}"), structure)


@pytest.mark.parametrize("suffix", [".npz", ".hdf5"])
@pytest.mark.parametrize("kind", [damping.Rayleigh(0.1, 1e-5), damping.Modal(0.02), damping.Modal([0.01, 0.03])])
def test_damping_comes_back(tmp_path, suffix, kind):
    files.save(BEAM.with_damping(kind), tmp_path / f"m{suffix}")
    assert files.load(tmp_path / f"m{suffix}").damping == kind
    assert files.load(tmp_path / f"m{suffix}", damping=0.05).damping == damping.Modal(0.05)


def test_a_loaded_structure_answers_like_the_one_that_was_saved(tmp_path):
    files.save(BEAM, tmp_path / "m.npz")
    back = files.load(tmp_path / "m.npz")
    read, push = [Displacement("4+Z"), Displacement("2+RY")], [Point("3-Z"), Moment("4+RY")]
    one, two = ForwardModel(back, read, push), ForwardModel(BEAM, read, push)
    np.testing.assert_allclose(one.static(), two.static(), rtol=1e-12)


# -- what others write ------------------------------------------------------------------------------------------------
def dense_npz(path):
    np.savez(path, K=K, M=M, dofs=LABELS)


def sparse_npz(path):
    A, B = sparse.csc_array(K), sparse.coo_array(M)
    np.savez(
        path, K_data=A.data, K_indices=A.indices, K_indptr=A.indptr, K_format="csc", **{"M.data": B.data},
        **{"M.row": B.coords[0], "M.col": B.coords[1], "M.shape": B.shape}, dofs=LABELS,
    )  # fmt: skip


def spelled_npz(path):
    np.savez_compressed(path, stiffness=K, mass=M, nodes=np.repeat(np.arange(5), 2), directions=np.tile([3, -5], 5))


def dense_h5(path):
    with h5py.File(path, "w") as f:
        f["K"], f["M"] = K, M
        f["dofs"] = [label.encode() for label in LABELS]


def sparse_h5(path):
    with h5py.File(path, "w", userblock_size=512) as f:
        for name, A in (("model/K", sparse.csr_array(K)), ("model/M", sparse.csr_array(M))):
            for part in ("data", "indices", "indptr"):
                f.create_dataset(f"{name}/{part}", data=getattr(A, part), compression="gzip")
        f["dofs"] = np.column_stack([np.repeat(np.arange(5), 2), np.tile([3, -5], 5)])


def matlab_h5(path):
    """As MATLAB 7.3 stores a sparse matrix: columns, and the number of rows as an attribute."""
    with h5py.File(path, "w", userblock_size=512) as f:
        for name, A in (("K", sparse.csc_array(K)), ("M", sparse.csc_array(M))):
            group = f.create_group(name)
            group["data"], group["ir"], group["jc"] = A.data, A.indices.astype("u8"), A.indptr.astype("u8")
            group.attrs["MATLAB_sparse"] = np.uint64(10)
        f["nodes"], f["directions"] = np.repeat(np.arange(5.0), 2)[None], np.tile([3.0, -5.0], 5)[None]


def dense_level5(path):
    scipy.io.savemat(path, {"K": K, "M": M, "dofs": np.array(LABELS)}, do_compression=True)


def sparse_level5(path):
    nodes, directions = np.repeat(np.arange(5.0), 2), np.tile([3.0, -5.0], 5)
    scipy.io.savemat(
        path, {"K": sparse.csc_matrix(K), "M": sparse.csc_matrix(M), "nodes": nodes, "directions": directions}
    )


WRITERS = {
    "dense.npz": dense_npz, "sparse.npz": sparse_npz, "spelled.npz": spelled_npz, "dense.h5": dense_h5,
    "matlab.mat": matlab_h5, "dense.mat": dense_level5, "sparse.mat": sparse_level5,
}  # fmt: skip


@pytest.mark.parametrize("name", WRITERS)
def test_what_others_write_is_read(tmp_path, name):
    WRITERS[name](tmp_path / name)
    same(files.load(tmp_path / name, supports=BEAM.supports, coordinates=BEAM.coordinates), BEAM)


def test_a_mat_file_without_matrices_says_what_it_holds(tmp_path):
    scipy.io.savemat(tmp_path / "m.mat", {"model": {"K": K, "M": M}})
    with pytest.raises(InputError, match=r"without matrices; found: model \(struct\).*save\('model.mat', 'K', 'M'\)"):
        files.load(tmp_path / "m.mat")
    (tmp_path / "old.mat").write_bytes(bytes(400))
    with pytest.raises(InputError, match=r"with -v7 or -v7\.3"):
        files.load(tmp_path / "old.mat")


def test_a_member_of_an_archive_that_was_renamed_or_swallowed_is_damage(tmp_path):
    files.save(BEAM, tmp_path / "m.npz")
    data = (tmp_path / "m.npz").read_bytes()
    renamed = [data[:at] + b"X" + data[at + 1 :] for at in (m.start() for m in re.finditer(b"M_data", data))]
    at = data.rindex(b"K_indptr") - 14  # length of the comment in its entry of the directory: it takes the next ones
    size = len(data) - data.rindex(b"K_indptr") - len("K_indptr.npy") - 22
    swallowed = data[:at] + size.to_bytes(2, "little") + data[at + 2 :]
    for damaged in (*renamed, swallowed):
        (tmp_path / "m.npz").write_bytes(damaged)
        with pytest.raises(InputError, match="no NumPy archive, or a damaged one"):
            files.load(tmp_path / "m.npz")


def test_groups_in_hdf5_are_named(tmp_path):
    sparse_h5(tmp_path / "m.h5")
    with pytest.raises(InputError, match=r"no stiffness matrix K.*model/K, model/M"):
        files.load(tmp_path / "m.h5")
    found = files.load(tmp_path / "m.h5", names={"K": "model/K", "M": "model/M"}, supports=["0+Z", "0-RY"])
    same(found, Structure.from_matrices(K, M, dofs=BEAM.dofs, supports=BEAM.supports))


@pytest.mark.parametrize("kind", ["general", "symmetric"])
@pytest.mark.parametrize("dense", [False, True])
def test_matrix_market_is_read(tmp_path, kind, dense):
    for name, A in (("wing_K", K), ("wing-mass", M)):
        scipy.io.mmwrite(tmp_path / f"{name}.mtx", A if dense else sparse.coo_array(A), symmetry=kind, precision=17)
    (tmp_path / "dofs.csv").write_text(
        "node,direction,x\n" + "".join(f"{n},{d},{n / 4}\n" for n in range(5) for d in ("+Z", "-RY"))
    )
    paths = [tmp_path / "wing_K.mtx", tmp_path / "wing-mass.mtx"]
    same(files.load(paths, dofs=tmp_path / "dofs.csv", supports=BEAM.supports), BEAM)
    named = {"K": paths[0], "M": paths[1]}
    same(files.load(named, dofs=BEAM.dofs, supports=BEAM.supports, coordinates=BEAM.coordinates), BEAM)
    assert files.load(paths[0]).M is None


def test_scipys_own_sparse_files_are_read(tmp_path):
    sparse.save_npz(tmp_path / "K.npz", sparse.csc_matrix(K))
    sparse.save_npz(tmp_path / "M.npz", sparse.coo_matrix(M))
    found = files.load([tmp_path / "K.npz", tmp_path / "M.npz"])
    np.testing.assert_array_equal(found.K.toarray(), K)
    np.testing.assert_array_equal(found.M.toarray(), M)
    assert str(found.dofs[3]) == "3+S"
    np.testing.assert_array_equal(files.load(tmp_path / "K.npz").K.toarray(), K)


def test_fortran_exponents_and_comments(tmp_path):
    body = "% written by a solver\n\n 2 2 3\n1 1 2.0D+00\n2 1 -1.0d0\n2 2 1\n"
    (tmp_path / "K.mtx").write_text("%%MatrixMarket matrix coordinate real symmetric\n" + body)
    np.testing.assert_array_equal(files.load(tmp_path / "K.mtx").K.toarray(), [[2.0, -1.0], [-1.0, 1.0]])


# -- the DOF table ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "text",
    [
        "1 1\n1 3\n2 1\n2 3\n",
        "node;direction\n1;X\n1;Z\n2;X\n2;Z\n",
        "# export\n1\tUX\n1\tuz\n\n2\t+X\n2\tZ+\n",
        "1+X\n1:+Z\n2X+\n2+Z",
        "\ufeffNode, Dir, x, y\n1, 1, 0, 0.5\n1, 3, 0, 0.5\n2, 1, 1e0, 0.5  # end\n2, 3, 1, .5\n",
    ],
)
def test_dof_tables(tmp_path, text):
    (tmp_path / "dofs.txt").write_text(text, "utf-8")
    np.savez(tmp_path / "m.npz", K=np.diag([1.0, 2.0, 3.0, 4.0]))
    found = files.load(tmp_path / "m.npz", dofs=tmp_path / "dofs.txt")
    assert [str(d) for d in found.dofs] == ["1+X", "1+Z", "2+X", "2+Z"]
    if "Dir, x" in text:
        np.testing.assert_array_equal(found.coordinates, [[0, 0.5], [1, 0.5]])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 X\n1 Q\n", "line 2: no line of a DOF table"),
        ("1 X\n1 9\n", "line 2: no line of a DOF table"),
        ("1 X\n7\n", "line 2: no line of a DOF table"),
        ("1 X 0\n1 Z 0 1\n2 X 1\n2 Z 1", "line 2: two places for one node"),
        ("1 X 0\n1 Z 0\n2 X\n2 Z", "some nodes have coordinates"),
        ("1 X nan\n1 Z 0\n2 X\n2 Z", "line 1: no coordinates"),
        ("1 X\n1 Z\n2 X\n", "found: 3 DOFs; expected: 4, one per row of K"),
        ("1 X\n1 Z\n2 X\n1 -X\n", "duplicated DOF"),
        ("nothing here\n", "the DOF table is empty"),
        ("1 X\n" + "2" * 1000, "line 2: no line of a DOF table"),
        ("1 X\n\x00\x01\x02 \x03\n", "line 2: no line of a DOF table"),
    ],
)
def test_bad_tables(tmp_path, text, words):
    (tmp_path / "dofs.txt").write_text(text)
    np.savez(tmp_path / "m.npz", K=np.diag([1.0, 2.0, 3.0, 4.0]))
    with pytest.raises(InputError, match=words) as caught:
        files.load(tmp_path / "m.npz", dofs=tmp_path / "dofs.txt")
    assert "dofs.txt" in str(caught.value) or "m.npz" in str(caught.value)


# -- units ------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "structure",
    [BEAM, plates.plate(lengths=(0.5, 0.4), thickness=3e-3, material=beams.materials.steel, elements=(2, 2))],
)
@pytest.mark.parametrize(("length", "force"), [("mm", "N"), ("in", "lbf"), ("m", "kN")])
def test_units_of_length_and_force(tmp_path, structure, length, force):
    """The same beam and plate, built in mm, N and t, or in inch and pound-force, by scaling every length and force."""
    L = {"mm": 1e-3, "in": 0.0254, "m": 1.0}[length]
    F = {"N": 1.0, "lbf": 0.45359237 * 9.80665, "kN": 1e3}[force]
    if structure is BEAM:  # EI in F L^2, mass per length in F s^2 / L^2
        own = beams.cantilever(length=1 / L, EI=1 / (F * L**2), mass_per_length=L**2 / F, elements=4)
    else:
        steel = beams.materials.steel
        material = beams.Material(E=steel.E * L**2 / F, rho=steel.rho * L**4 / F, nu=steel.nu)
        own = plates.plate(lengths=(0.5 / L, 0.4 / L), thickness=3e-3 / L, material=material, elements=(2, 2))
    files.save(own, tmp_path / "m.npz")
    found = files.load(tmp_path / "m.npz", length_unit=length, force_unit=force)
    for A, B in ((found.K, structure.K), (found.M, structure.M)):
        d = np.sqrt(B.diagonal())
        np.testing.assert_allclose(A.toarray() / np.outer(d, d), B.toarray() / np.outer(d, d), atol=1e-9)
    np.testing.assert_allclose(found.coordinates, structure.coordinates, rtol=1e-12)


def test_units_need_directions(tmp_path):
    np.savez(tmp_path / "m.npz", K=K)
    with pytest.raises(InputError, match="units need a DOF table"):
        files.load(tmp_path / "m.npz", length_unit="mm")
    with pytest.raises(InputError, match="N is no unit of displacement"):
        files.load(tmp_path / "m.npz", length_unit="N")


# -- triangles --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("half", [np.tril, np.triu])
def test_one_triangle_is_explained_and_completed_on_request(tmp_path, half):
    np.savez(tmp_path / "m.npz", K=half(K), M=half(M))
    side = "lower" if half is np.tril else "upper"
    with pytest.raises(InputError, match=f"only the {side} triangle of K is stored.*expand=True"):
        files.load(tmp_path / "m.npz")
    found = files.load(tmp_path / "m.npz", expand=True)
    np.testing.assert_array_equal(found.K.toarray(), K)
    np.testing.assert_array_equal(found.M.toarray(), M)
    np.savez(tmp_path / "whole.npz", K=K, M=np.diag(np.diag(M)))
    np.testing.assert_array_equal(files.load(tmp_path / "whole.npz", expand=True).K.toarray(), K)


# -- what is wrong ----------------------------------------------------------------------------------------------------
def npz(**arrays):
    def write(folder):
        np.savez(folder / "m.npz", **arrays)
        return folder / "m.npz"

    return write


def text(content, name="K.mtx"):
    def write(folder):
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        return folder / name

    return write


def h5(fill):
    def write(folder):
        with h5py.File(folder / "m.h5", "w") as f:
            fill(f)
        return folder / "m.h5"

    return write


def bomb(folder):
    """A header that claims a matrix of a terabyte."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (400_000, 400_000)})
    with zipfile.ZipFile(folder / "m.npz", "w") as archive:
        archive.writestr("K.npy", stream.getvalue() + b"\0" * 64)
    return folder / "m.npz"


def claims(folder):
    """An archive whose directory claims eight gigabytes."""
    np.savez(folder / "m.npz", K=K, M=M)
    data = bytearray((folder / "m.npz").read_bytes())
    at = 0
    while (at := data.find(b"PK\x01\x02", at + 1)) > 0:
        data[at + 24 : at + 28] = struct.pack("<I", 2**32 - 2)
    (folder / "m.npz").write_bytes(data)
    return folder / "m.npz"


def cut(writer, share):
    def write(folder):
        path = writer(folder)
        data = path.read_bytes()
        path.write_bytes(data[: int(share * len(data))])
        return path

    return write


def flipped_own(folder):
    files.save(BEAM, folder / "m.h5")
    data = bytearray((folder / "m.h5").read_bytes())
    data[len(data) // 2] ^= 1
    (folder / "m.h5").write_bytes(data)
    return folder / "m.h5"


def outside(f):
    f["K"] = h5py.ExternalLink("other.h5", "/K")


def external(f):
    f.create_dataset("K", (2, 2), "f8", external=[("/etc/passwd", 0, 32)])


def long_text(chunks=None):
    """A text that says of itself to be of 2 GB."""

    def write(folder):
        path = folder / "m.h5"
        with h5py.File(path, "w") as f:
            f["K"], f["M"] = K, M
            f.create_dataset(
                "dofs", data=[label.encode() for label in LABELS], dtype=h5py.string_dtype(), chunks=chunks
            )
            item = f["dofs"].id
            at = item.get_offset() if chunks is None else item.get_chunk_info(1).byte_offset
        data = bytearray(path.read_bytes())
        data[at : at + 4] = (2**31).to_bytes(4, "little")
        path.write_bytes(data)
        return path

    return write


def huge(f):
    f.create_dataset("K", (10**6, 10**6), "f8")


HEAD = "%%MatrixMarket matrix coordinate real "
CSR = {"K_data": np.ones(2), "K_indices": np.array([0, 1]), "K_indptr": np.array([0, 1, 2])}
WRONG = {
    "missing file": (lambda folder: folder / "none.npz", "no such file"),
    "folder": (lambda folder: folder, "this is no file"),
    "suffix": (text("x", "m.op4"), "kind that is not read.*.npz, .mtx"),
    "no path": (lambda folder: 3, "this is no path"),
    "no K": (npz(M=M, A=K), "no stiffness matrix K.*found: M, A.*names="),
    "two K": (npz(stiffness=K, k=K), "two matrices may be K"),
    "nothing": (npz(), "no stiffness matrix K.*found: nothing"),
    "K vector": (npz(K=np.ones(4)), r"not a square matrix.*shape \(4,\)"),
    "K wide": (npz(K=np.ones((2, 3))), "not a square matrix"),
    "K text": (npz(K=np.array([["a", "b"], ["c", "d"]])), "no real numbers"),
    "K complex": (npz(K=K * (1 + 0.1j)), "no real numbers.*damping=0.02"),
    "K nan": (npz(K=np.where(K.max() == K, np.nan, K)), "NaN or infinity.*3 of 100 entries"),
    "K asymmetric": (npz(K=K + np.triu(K, 1) * 0.1), "m.npz: matrix K: not symmetric"),
    "K negative": (npz(K=-K), r"m.npz: matrix K, 2\+S: negative stiffness"),
    "M size": (npz(K=K, M=np.eye(3)), "wrong size"),
    "pickled": (npz(K=np.array(sparse.csr_array(K), dtype=object)), "a pickled object, which is never read"),
    "dofs length": (npz(K=K, dofs=LABELS[:-1]), r"m.npz, dofs.*found: 9 DOFs; expected: 10, one per row"),
    "dofs label": (npz(K=K, dofs=np.array(["0+Z", "what"] * 5)), "m.npz, dofs, row 1: no DOF.*what"),
    "dofs numbers": (npz(K=K, dofs=np.full((10, 2), np.nan)), "row 0: no DOF"),
    "dofs lengths": (npz(K=K, nodes=np.arange(3), directions=np.arange(2)), "differ in length"),
    "supports": (npz(K=K, dofs=LABELS, supports=np.array(["9+Z"])), "the structure has no such DOF"),
    "coordinates": (npz(K=K, dofs=LABELS, coordinates=np.ones((3, 2))), "coordinates do not fit"),
    "sparse parts": (npz(K_data=np.ones(2), K_indices=np.arange(2)), "parts of a sparse matrix are missing"),
    "sparse range": (npz(**{**CSR, "K_indices": np.array([1, 2])}), "counted from one"),
    "sparse lengths": (npz(**{**CSR, "K_indices": np.arange(3)}), "2 entries and 3 indices"),
    "sparse falling": (npz(**{**CSR, "K_indptr": np.array([0, 3, 2])}), "do not rise"),
    "sparse negative": (npz(**{**CSR, "K_indices": np.array([0, -1])}), "contradict"),
    "sparse shape": (npz(**CSR, K_shape=np.array([2, 3])), "not a square matrix"),
    "sparse huge": (npz(**CSR, K_shape=np.array([10**12, 10**12])), "not a square matrix"),
    "sparse kind": (npz(**CSR, K_format="bsr"), "a sparse format that is not read"),
    "sparse fraction": (npz(**{**CSR, "K_indices": np.array([0.0, 0.5])}), "no indices"),
    "header bomb": (bomb, "not as long as its header says"),
    "directory bomb": (claims, "the archive is too large"),
    "npz cut": (cut(npz(K=K), 0.6), "no NumPy archive, or a damaged one"),
    "npz text": (text("hello", "m.npz"), "no NumPy archive"),
    "mtx empty": (text(""), "no Matrix Market file"),
    "mtx banner": (text("1 1 1\n"), "no Matrix Market file"),
    "mtx complex": (text("%%MatrixMarket matrix coordinate complex general\n1 1 1\n1 1 1 0\n"), "of another kind"),
    "mtx pattern": (text("%%MatrixMarket matrix coordinate pattern general\n1 1 1\n1 1\n"), "of another kind"),
    "mtx sizes": (text(HEAD + "general\n2 3 1\n1 1 1\n"), "line 2: no size of a square matrix"),
    "mtx no sizes": (text(HEAD + "general\n% nothing\n"), "no size of a square matrix"),
    "mtx count": (text(HEAD + "general\n2 2 3\n1 1 1\n2 2 1\n"), "found: 2 entries; expected: 3 entries"),
    "mtx range": (text(HEAD + "general\n2 2 2\n1 1 1\n3 2 1\n"), r"entry 2: an entry lies outside.*\(3, 2\)"),
    "mtx zero": (text(HEAD + "general\n2 2 2\n1 1 1\n0 1 1\n"), r"entry 2: an entry lies outside.*\(0, 1\)"),
    "mtx fraction": (text(HEAD + "general\n2 2 1\n1.5 1 1\n"), "outside the matrix"),
    "mtx words": (text(HEAD + "general\n2 2 1\n1 1 one\n"), "an entry is no number"),
    "mtx ragged": (text(HEAD + "general\n2 2 2\n1 1 1\n2 2\n"), "an entry is no number"),
    "mtx columns": (text(HEAD + "general\n2 2 1\n1 1 1 1\n"), "4 numbers per line"),
    "mtx nan": (text(HEAD + "general\n1 1 1\n1 1 nan\n"), "NaN or infinity"),
    "mtx triangles": (text(HEAD + "symmetric\n2 2 4\n1 1 2\n2 2 2\n1 2 -1\n2 1 -1\n"), "holds both"),
    "mtx half": (text(HEAD + "general\n2 2 3\n1 1 2\n2 2 2\n2 1 -1\n"), "only the lower triangle of K"),
    "mtx huge": (text("%%MatrixMarket matrix array real general\n9000000 9000000\n1\n"), "the file is cut"),
    "mtx array": (text("%%MatrixMarket matrix array real symmetric\n2 2\n1\n2\n3\n4\n"), "4 numbers"),
    "mtx binary": (text(b"%%MatrixMarket matrix coordinate real general\n1 1 1\n\xff\xfe\x00"), "no number|found: 0"),
    "h5 text": (text("hello", "m.h5"), "no HDF5 file"),
    "h5 cut": (cut(h5(lambda f: f.create_dataset("K", data=K)), 0.7), "the file is cut"),
    "h5 bit": (flipped_own, "damaged"),
    "h5 link": (h5(outside), "no stiffness matrix K"),
    "h5 external": (h5(external), "data that lie elsewhere"),
    "h5 huge": (h5(huge), "claims more data than it holds"),
    "h5 long text": (long_text(), "its texts claim more than the file holds"),
    "h5 long text in chunks": (long_text((4,)), "its texts claim more than the file holds"),
    "h5 group": (h5(lambda f: f.create_group("K")), "no stiffness matrix K"),
    "h5 compound": (h5(lambda f: f.create_dataset("K", data=np.zeros(3, "i4,f8"))), "a type that is not read"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_refused_in_words(tmp_path, name):
    write, words = WRONG[name]
    path = write(tmp_path)
    with pytest.raises(InputError, match=words) as caught:
        files.load(path)
    assert caught.value.hint or name in ("missing file", "h5 bit", "no path")
    if not isinstance(path, int):
        assert path.name in str(caught.value)


LISTS = {
    "no K": (["M.mtx", "C.mtx"], "no stiffness matrix K"),
    "unclear": (["a.mtx", "K.mtx"], "does not say which matrix"),
    "twice": (["K.mtx", "stiffness.mtx"], "two files of K"),
    "empty": ([], "no stiffness matrix K"),
    "dict": ({"M": "M.mtx"}, "no stiffness matrix K"),
    "key": ({"K": "K.mtx", "S": "M.mtx"}, "no such matrix.*found: K, S"),
}


@pytest.mark.parametrize("name", LISTS)
def test_lists_of_files_that_do_not_fit(tmp_path, name):
    given, words = LISTS[name]
    for stem in ("K", "M", "C", "a", "stiffness"):
        (tmp_path / f"{stem}.mtx").write_text(HEAD + "general\n1 1 1\n1 1 1\n")
    paths = {k: tmp_path / v for k, v in given.items()} if isinstance(given, dict) else [tmp_path / v for v in given]
    with pytest.raises(InputError, match=words):
        files.load(paths)


def test_settings_that_do_not_fit(tmp_path):
    np.savez(tmp_path / "m.npz", K=K)
    with pytest.raises(InputError, match="names of no matrices"):
        files.load(tmp_path / "m.npz", names={"stiffness": "K"})
    with pytest.raises(InputError, match="no stiffness matrix KAAX"):
        files.load(tmp_path / "m.npz", names={"K": "KAAX"})
    with pytest.raises(InputError, match="a suffix that is not written"):
        files.save(BEAM, tmp_path / "m.csv")
    with pytest.raises(InputError, match="no structure"):
        files.save(K, tmp_path / "m.npz")
    with pytest.raises(InputError, match="cannot be written"):
        files.save(BEAM, tmp_path / "no" / "m.npz")


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(["npz", "mtx"]), st.integers(0, 10_000), st.binary(min_size=1, max_size=4))
def test_damaged_files_never_raise_anything_else(tmp_path, kind, place, noise):
    path = tmp_path / f"K.{kind}"
    structure = chains.chain(masses=[1.0, 2.0, 3.0], springs=5.0)
    if kind == "npz":
        files.save(structure, path)
    else:
        scipy.io.mmwrite(path, structure.K.tocoo())
    data = bytearray(path.read_bytes())
    at = place % len(data)
    data[at : at + len(noise)] = noise
    path.write_bytes(data)
    with contextlib.suppress(InputError):
        assert np.all(np.isfinite(files.load(path).K.data))


def hangs(request):
    while True:
        pass


def crashes(request):
    os.kill(os.getpid(), 11)


@pytest.mark.parametrize(("task", "words"), [(hangs, "hangs on this file"), (crashes, "crashed on this file")])
def test_a_library_that_hangs_or_crashes_takes_a_child_with_it(tmp_path, monkeypatch, task, words):
    monkeypatch.setattr(hdf5, "TRIAL", f"{__name__}:{task.__name__}")
    monkeypatch.setattr(child, "PATIENCE", 0.3)
    dense_h5(tmp_path / "m.h5")
    with pytest.raises(InputError, match=words):
        files.load(tmp_path / "m.h5")
    monkeypatch.undo()
    np.testing.assert_array_equal(files.load(tmp_path / "m.h5").K.toarray(), K)  # the next one finds a new child


def test_names_of_sparse_parts():
    assert [split(n) for n in ("K_data", "K/indptr", "a.b.row", "data", "K", "K_rows")] == [
        ("K", "data"), ("K", "indptr"), ("a.b", "row"), ("", "data"), ("K", None), ("K_rows", None),
    ]  # fmt: skip
