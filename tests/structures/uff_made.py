"""A small writer of universal files, by the letter of the format, to damage and to read."""

import numpy as np

END = f"{-1:6d}\n"
WIDTH = {"time": 17, "frequency": 18, "displacement": 8, "velocity": 11, "acceleration": 12, "force": 13, "strain": 3}


def block(number, *lines) -> bytes:
    """A data set of text."""
    return (END + f"{number:6d}\n" + "".join(f"{line}\n" for line in lines) + END).encode()


def units(length=1.0, force=1.0, code=9, name="USER_DEFINED") -> bytes:
    """Data set 164: factors by which a file divides into SI."""
    first = f"{code:10d}{name:20s}{2:10d}"
    return block(164, first, f"{length:25.17E}{force:25.17E}{1:25.17E}".replace("E", "D"), f"{273.15:25.17E}")


def head(
    function=4,
    response=("NONE", 1, 3),
    reference=("NONE", 1, 3),
    precision=6,
    count=4,
    even=1,
    start=0.0,
    step=1.0,
    abscissa=("frequency", "Hz"),
    ordinate=(12, "m/s^2"),
    denominator=(13, "N"),
    version=0,
    label="NONE",
    ids=("NONE",) * 5,
) -> str:
    """The eleven records of a data set 58."""
    name, node, way = response
    name2, node2, way2 = reference
    lines = [f"{i:80s}" for i in ids]
    lines.append(
        f"{function:5d}{0:10d}{version:5d}{0:10d} {name:10s}{node:10d}{way:4d} {name2:10s}{node2:10d}{way2:4d}"
    )
    lines.append(f"{precision:10d}{count:10d}{even:10d}{start:13.5E}{step if even else 0:13.5E}{0:13.5E}")
    rows = [(WIDTH[abscissa[0]], "NONE", abscissa[1]), (ordinate[0], label, ordinate[1])]
    rows += [(denominator[0], "NONE", denominator[1]), (0, "NONE", "NONE")]
    lines += [f"{kind:10d}{0:5d}{0:5d}{0:5d} {text:20s} {unit:20s}" for kind, text, unit in rows]
    return "".join(f"{line}\n" for line in lines)


def table(values, x=None):
    """Numbers of a function in the order of the format, shape (count, parts)."""
    parts = [] if x is None else [np.asarray(x, float)]
    parts += [np.real(values), np.imag(values)] if np.iscomplexobj(values) else [np.asarray(values, float)]
    return np.column_stack(parts)


def text58(values, x=None, *, double=True, **records) -> bytes:
    """A data set 58 in the formats 6E13.5, 4E20.12, 2(E13.5,E20.12) and E13.5,2E20.12."""
    numbers = table(values, x)
    precision = {(0, 0): 2, (0, 1): 4, (1, 0): 5, (1, 1): 6}[bool(np.iscomplexobj(values)), double]
    widths = ["{:13.5E}"] * (x is not None) + ["{:20.12E}" if double else "{:13.5E}"] * (1 + np.iscomplexobj(values))
    words = [form.format(v) for row in numbers for form, v in zip(widths, row, strict=True)]
    per_line = {(True, False): 4, (True, True): 3 if precision == 6 else 4}.get((double, x is not None), 6)
    lines = ["".join(words[i : i + per_line]) for i in range(0, len(words), per_line)]
    first = head(precision=precision, count=len(numbers), even=int(x is None), **records)
    return (END + f"{58:6d}\n{first}" + "".join(f"{line}\n" for line in lines) + END).encode("latin-1")


def binary58(values, x=None, *, double=True, order="<", wide=False, newline=b"", declared=None, **records) -> bytes:
    """A data set 58b; `wide` stores the abscissa in the precision of the ordinate, as some writers do."""
    kind = f"{order}f{8 if double else 4}"
    fields = [] if x is None else [kind if wide else f"{order}f4"]
    fields += [kind] * (2 if np.iscomplexobj(values) else 1)
    rows = np.array(
        [tuple(r) for r in table(values, x)], np.dtype(",".join(fields) if len(fields) > 1 else [("v", fields[0])])
    )
    data = rows.tobytes()
    precision = {(0, 0): 2, (0, 1): 4, (1, 0): 5, (1, 1): 6}[bool(np.iscomplexobj(values)), double]
    first = head(precision=precision, count=len(rows), even=int(x is None), **records)
    size = len(data) if declared is None else declared
    line = f"{58:6d}b{1 if order == '<' else 2:6d}{2:6d}{11:12d}{size:12d}{0:6d}{0:6d}{0:12d}{0:12d}\n"
    return (END + line + first).encode("latin-1") + data + newline + END.encode()


def frfs(H, responses, references, write=text58, **records) -> bytes:
    """Data sets of a matrix of FRFs (lines, responses, references); DOFs as (node, direction)."""
    return b"".join(
        write(H[:, i, j], response=("NONE", *r), reference=("NONE", *c), **records)
        for i, r in enumerate(responses)
        for j, c in enumerate(references)
    )
