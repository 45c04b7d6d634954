"""Small files of every format, written by something other than the readers."""

import io
from pathlib import Path

import numpy as np

from tests.structures.uff_made import binary58, text58

N = 16
F = np.round(np.hanning(N + 2)[1:-1] * 40, 4)
A = np.round(np.sin(np.arange(N)) * 3, 4)
T = np.round(np.arange(N) * 0.001, 6)


def lvm(records=2, samples=8, decimal=".", columns="No", multi=False, newline="\n", start=0.0) -> str:
    """A LabVIEW file: `records` blocks of `samples` rows, with one header or a header each."""

    def num(x):
        return f"{x:.6f}".replace(".", decimal)

    wide = 2 if columns != "Multi" else 4
    segment = [
        "Channels\t2",
        "Samples\t" + "\t".join([str(samples)] * 2),
        "Date\t2020/01/01\t2020/01/01",
        "Y_Unit_Label\tN\tg",
        "X_Dimension\tTime\tTime",
        "X0\t0\t0",
        f"Delta_X\t{num(0.001)}\t{num(0.001)}",
        "***End_of_Header***",
        "X_Value\tF\tX_Value\ta\tComment" if wide == 4 else "X_Value\tF\ta\tComment",
    ]
    if columns == "Multi":
        segment[3] = "Y_Unit_Label\tN\t\tg"
    lines = [
        "LabVIEW Measurement",
        "Writer_Version\t2",
        "Separator\tTab",
        f"Multi_Headings\t{'Yes' if multi else 'No'}",
    ]
    lines += [
        f"X_Columns\t{columns}",
        *([f"Decimal_Separator\t{decimal}"] if decimal == "," else []),
        "Date\t2020/01/01",
    ]
    lines += ["***End_of_Header***", ""]
    for r in range(records):
        if r == 0 or multi:
            lines += segment
        for i in range(samples):
            k = (r * samples + i) % N
            x = num(start + T[k] if columns != "No" else 0)
            cells = {
                "No": ["", num(F[k]), num(A[k])],
                "One": [x, num(F[k]), num(A[k])],
                "Multi": [x, num(F[k]), x, num(A[k])],
            }
            lines.append("\t".join(cells[columns]))
        if multi:
            lines.append("")
    return newline.join(lines) + newline


def csv(separator=",", decimal=".", header=True) -> str:
    rows = [separator.join(("time [s]", "F [N]", "acc (g)"))] if header else []
    rows += [separator.join(f"{x:.4f}".replace(".", decimal) for x in row) for row in zip(T, F, A, strict=True)]
    return "\n".join(rows) + "\n"


def npy(x) -> bytes:
    file = io.BytesIO()
    np.save(file, x)
    return file.getvalue()


def npz(**arrays) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def hdf5(path: Path, compression=None) -> Path:
    import h5py

    with h5py.File(path, "w") as file:
        data = file.create_dataset(
            "run", data=np.column_stack((F, A)), chunks=(4, 2), compression=compression, fletcher32=True
        )
        data.attrs["fs"] = 1000.0
        data.attrs["channels"] = ["F", "a"]
        data.attrs["units"] = ["N", "g"]
    return path


def uff(write=text58) -> bytes:
    """Two time responses of a universal file, with their units in the text of the axis."""
    about = {"function": 1, "step": 0.001, "abscissa": ("time", "s"), "denominator": (0, "NONE")}
    force = write(F, response=("NONE", 1, 3), ordinate=(13, "N"), **about)
    return force + write(A, response=("NONE", 2, -1), ordinate=(12, "g"), **about)


def mat(compressed=True, **arrays) -> bytes:
    """A MAT file of level 5, written by scipy."""
    from scipy.io import savemat

    file = io.BytesIO()
    savemat(file, arrays, do_compression=compressed)
    return file.getvalue()


def small_files(folder: Path) -> dict[str, Path]:
    """One valid small file per format whose library is installed, by its suffix."""
    from .exports import exports  # which takes the numbers of this module

    exports(folder)
    (folder / "a.csv").write_text(csv())
    (folder / "a.lvm").write_text(lvm())
    (folder / "a.npy").write_bytes(npy(np.column_stack((T, F, A))))
    (folder / "a.npz").write_bytes(npz(x=np.column_stack((F, A)), fs=1000.0, channels=["F", "a"], units=["N", "g"]))
    hdf5(folder / "a.h5")
    (folder / "a.uff").write_bytes(uff())
    (folder / "a.ufb").write_bytes(uff(binary58))
    (folder / "a.mat").write_bytes(mat(F=F, a=A, fs=1000.0))
    return {p.suffix[1:]: p for p in sorted(folder.glob("a.*"))}
