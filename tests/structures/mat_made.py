"""Small MAT files of both formats, by other writers than the readers."""

import struct

import numpy as np


def level5_big_endian(**arrays) -> bytes:
    """A MAT file of level 5 as a big-endian machine writes it: scipy writes none."""
    out = [b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI"]
    for name, x in arrays.items():
        x = np.asarray(x, float)
        parts = [
            _element(6, struct.pack(">II", 6, 0)),
            _element(5, struct.pack(f">{x.ndim}i", *x.shape)),
            _element(1, name.encode()),
            _element(9, x.astype(">f8").tobytes(order="F")),
        ]
        out.append(_element(14, b"".join(parts)))
    return b"".join(out)


def _element(kind: int, data: bytes) -> bytes:
    return struct.pack(">II", kind, len(data)) + data + b"\0" * (-len(data) % 8)


def mat73(path, **arrays):
    """A MAT file of version 7.3: a block of text, then HDF5 with the axes turned round and complex numbers as pairs."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, x in arrays.items():
            if isinstance(x, str):
                data, kind = np.array([[ord(c)] for c in x], np.uint16), b"char"
            else:
                data, kind = np.asarray(x).T, b"double"
            if np.iscomplexobj(data):
                pair = np.zeros(data.shape, [("real", "f8"), ("imag", "f8")])
                pair["real"], pair["imag"] = data.real, data.imag
                data = pair
            file.create_dataset(name, data=data).attrs["MATLAB_class"] = np.bytes_(kind)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return path
