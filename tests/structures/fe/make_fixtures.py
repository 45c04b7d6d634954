"""Files of one small cantilever, written by other programs; the tests read what this leaves in ``fixtures``.

CalculiX (``ccx``) makes K, M and frequencies; pyyeti writes OUTPUT4, pyNastran DMIG cards, GRID points and OUTPUT2.
pyNastran needs another numpy than this package: both run in an environment of their own,

    python -m venv /somewhere/env && /somewhere/env/bin/pip install pyNastran "numpy<2" scipy
    /somewhere/env/bin/python tests/structures/fe/make_fixtures.py nastran
    python -m venv /somewhere/env4 && /somewhere/env4/bin/pip install pyyeti
    /somewhere/env4/bin/python tests/structures/fe/make_fixtures.py output4

after ``python tests/structures/fe/make_fixtures.py calculix``, which needs ``ccx`` alone.
"""

from __future__ import annotations

import struct
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent / "fixtures"
NODES = [(i, j, k) for k in (0, 1) for j in (0, 1) for i in (0, 1, 2)]  # node 10 n + 3, from 1 on
SIZE = (100.0, 50.0, 10.0)  # mm, along X over two cells
MATERIAL = (210000.0, 0.3, 7.85e-9)  # N/mm^2, t/mm^3


def number(node: int) -> int:
    """Number of a node in the files: with gaps, as users have them."""
    return 10 * node + 13


def places() -> list[tuple[float, float, float]]:
    """Places of the nodes (mm)."""
    return [(SIZE[0] * i / 2, SIZE[1] * j, SIZE[2] * k) for i, j, k in NODES]


def deck(step: str) -> str:
    """Input of CalculiX for a plate of two bricks, clamped at x = 0."""
    nodes = "\n".join(f"{number(n)},{x:g},{y:g},{z:g}" for n, (x, y, z) in enumerate(places()))
    index = {spot: number(n) for n, spot in enumerate(NODES)}
    ring = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    cells = "\n".join(f"{e + 1}," + ",".join(str(index[e + a, b, c]) for a, b, c in ring) for e in (0, 1))
    held = "\n".join(f"{index[0, j, k]},1,3" for j in (0, 1) for k in (0, 1))
    E, nu, rho = MATERIAL
    return (f"*NODE,NSET=ALL\n{nodes}\n*ELEMENT,TYPE=C3D8,ELSET=E\n{cells}\n*BOUNDARY\n{held}\n*MATERIAL,NAME=S\n"
            f"*ELASTIC\n{E},{nu}\n*DENSITY\n{rho}\n*SOLID SECTION,ELSET=E,MATERIAL=S\n*STEP\n{step}\n"
            "*END STEP\n")  # fmt: skip


def run(name: str, text: str, folder: Path) -> None:
    """Solve an input with CalculiX."""
    (folder / f"{name}.inp").write_text(text)
    subprocess.run(["ccx", name], cwd=folder, check=True, stdout=subprocess.DEVNULL, timeout=60)


def calculix() -> None:
    """K, M, DOFs and frequencies."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        run("plate", deck("*FREQUENCY,SOLVER=MATRIXSTORAGE\n6"), folder)
        run("modes", deck("*FREQUENCY\n4"), folder)
        for suffix in (".sti", ".mas", ".dof", ".inp"):
            (HERE / f"plate{suffix}").write_bytes((folder / f"plate{suffix}").read_bytes())
        lines = (folder / "modes.dat").read_text().split("P A R T")[0].splitlines()
        rows = [line.split() for line in lines if line.strip()[:1].isdigit()]
        (HERE / "frequencies.txt").write_text("\n".join(row[3] for row in rows) + "\n")


def matrices():  # type: ignore[no-untyped-def]
    """K, M and labels of the files of CalculiX, read here in the plainest way."""
    import numpy as np

    labels = [tuple(map(int, line.split("."))) for line in (HERE / "plate.dof").read_text().split()]
    out = []
    for suffix in (".sti", ".mas"):
        A = np.zeros((len(labels), len(labels)))
        for line in (HERE / f"plate{suffix}").read_text().splitlines():
            i, j, x = line.split()
            A[int(i) - 1, int(j) - 1] = A[int(j) - 1, int(i) - 1] = float(x)
        out.append(A)
    return out[0], out[1], labels


def output4() -> None:
    """OUTPUT4 in four forms."""
    from pyyeti.nastran import op4

    K, M, _ = matrices()
    for name, binary, sparse, order in (("text", False, "nonbigmat", "="), ("little", True, "bigmat", "<"),
                                        ("big", True, "dense", ">"), ("short", True, "nonbigmat", "<")):  # fmt: skip
        op4.write(str(HERE / f"{name}.op4"), ["KAAX", "MAAX"], [K, M], binary=binary, sparse=sparse, endian=order)


def nastran() -> None:
    """DMIG cards, GRID points, and OUTPUT2 with modes."""
    import numpy as np
    from pyNastran.bdf.bdf import BDF
    from pyNastran.op2.op2 import OP2
    from pyNastran.op2.tables.oug.oug_eigenvectors import RealEigenvectorArray
    from scipy.linalg import eigh

    K, M, labels = matrices()
    model = BDF(debug=False)
    for n, place in enumerate(places()):
        model.add_grid(number(n), place)
    model.punch = True
    model.write_bdf(str(HERE / "nodes.bdf"), write_header=False)
    cards = BDF(debug=False)
    for name, A in (("KAAX", K), ("MAAX", M)):
        i, j = np.nonzero(np.triu(np.abs(A) > 1e-12 * np.abs(A).max()))
        cards.add_dmig(name, 6, 2, 0, 0, len(labels), [labels[b] for b in j], [labels[a] for a in i],
                       A[i, j].tolist())  # fmt: skip
    with open(HERE / "plate.pch", "w") as file:
        for name in ("KAAX", "MAAX"):
            file.write(cards.dmig[name].write_card(size=16, is_double=True))
    lam, phi = eigh(K, M)
    nodes = sorted({node for node, _ in labels})
    data = np.zeros((6, len(nodes), 6), "float32")
    for row, (node, axis) in enumerate(labels):
        data[:, nodes.index(node), axis - 1] = phi[row, :6]
    kinds = np.column_stack([nodes, np.ones(len(nodes))]).astype("int32")
    f = np.sqrt(lam[:6]) / (2 * np.pi)
    op2 = OP2(debug=False)
    op2.set_as_msc()
    op2.eigenvectors[1] = RealEigenvectorArray.add_modal_case("OUGV1", kinds, data, 1, np.arange(1, 7), lam[:6], f)
    op2.write_op2(str(HERE / "modes.op2"), post=-1, nastran_format="msc")
    with_lama(HERE / "modes.op2", lam[:6])
    again = OP2(debug=False)
    again.read_op2(str(HERE / "modes.op2"), build_dataframe=False)
    output2_matrix()
    told = next(iter(again.eigenvalues.values()))
    assert np.allclose(told.cycles, f, rtol=1e-6), told.cycles  # pyNastran reads the table as it is meant
    assert np.allclose(told.generalized_mass, 1.0)


def with_lama(path: Path, lam) -> None:  # type: ignore[no-untyped-def]
    """Put a table LAMA in front of the others: pyNastran writes none."""
    import numpy as np

    def record(body: bytes) -> bytes:
        return struct.pack("<i", len(body)) + body + struct.pack("<i", len(body))

    def keys(*values: int) -> bytes:
        return b"".join(record(struct.pack("<i", v)) for v in values)

    head = np.zeros(146, "<i4")
    head[50:] = int.from_bytes(b"    ", "little")  # title, subtitle and label: blanks
    head[:3], head[9] = (20 + 1, 6, 0), 7
    rows = b"".join(struct.pack("<2i5f", k + 1, k + 1, v, v**0.5, v**0.5 / (2 * np.pi), 1.0, v)
                    for k, v in enumerate(lam.tolist()))  # fmt: skip
    table = keys(2) + record(b"LAMA    ") + keys(-1, 7) + record(struct.pack("<7i", 101, 0, 0, 0, 0, 0, 0))
    table += keys(-2, 1, 0, 2) + record(b"LAMA    ") + keys(-3, 1, 0)
    table += keys(146) + record(head.tobytes()) + keys(-4, 1, 0)
    table += keys(len(rows) // 4) + record(rows) + keys(-5, 1, 0, 0)
    data = path.read_bytes()
    label = data.index(struct.pack("<i", 8) + b"OUGV1   ") - 12  # the key in front of the first block
    path.write_bytes(data[:label] + table + data[label:])


def output2_matrix() -> None:
    """K of the plate as a matrix of an OUTPUT2 file, made word by word and read back by pyNastran."""
    import numpy as np
    from pyNastran.op2.op2 import OP2

    def record(body: bytes) -> bytes:
        return struct.pack("<i", len(body)) + body + struct.pack("<i", len(body))

    def keys(*values: int) -> bytes:
        return b"".join(record(struct.pack("<i", v)) for v in values)

    K = matrices()[0]
    n = len(K)
    label = record(struct.pack("<3i", 11, 28, 26)) + keys(7) + record(b"NASTRAN FORT TAPE ID CODE - ")
    data = keys(3) + label + keys(2) + record(b"XXXXXXXX") + keys(-1, 0)
    data += keys(2) + record(b"KGG     ") + keys(-1, 7) + record(struct.pack("<7i", 101, n, n, 6, 2, n, 5000))
    data += keys(-2, 1, 0, 2) + record(b"KGG     ") + keys(-3, 1, 1)
    for j in range(n):
        rows = np.flatnonzero(K[:, j])
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            body = struct.pack("<i", run[0] + 1) + K[run, j].tobytes()
            data += keys(len(body) // 4) + record(body)
        data += keys(-4 - j, 1, int(j < n - 1))
    (HERE / "matrix.op2").write_bytes(data + keys(0, 0))
    told = OP2(debug=False)
    told.read_op2(str(HERE / "matrix.op2"), build_dataframe=False, skip_undefined_matrices=False)
    assert np.array_equal(told.matrices["KGG"].data.toarray(), K)


if __name__ == "__main__":
    HERE.mkdir(exist_ok=True)
    {"calculix": calculix, "output4": output4, "nastran": nastran}[sys.argv[1]]()
