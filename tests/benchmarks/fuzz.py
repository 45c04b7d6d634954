"""Damage small files of every kind and read them: only an InputError may leave a door, and nothing be lost in silence.

``python -m tests.benchmarks.fuzz [COUNT | FIRST-LAST] [NAME ...]`` prints what comes of the mutants of so many seeds of
each kind of file, or of those whose names begin so. Each mutant is a seeded truncation (35 %), an overwriting of bytes
(40 %) or of a block (15 %), or an insertion. Where a file has a hash ("signed"), the mutant gets the right one: damage
that somebody made on purpose. Seeds of what is shorter, and of other exceptions, are named. The files lie in memory
where the system has such a folder, and a child that hangs is given a second: 5000 mutants of all kinds take some 12
minutes of processor time.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from loadid import read_all
from structures._flags import codes
from structures.errors import InputError

STATED = {"fs": 1000.0, "units": {0: "N", 1: "g"}}


def mutant(data: bytes, seed: int) -> tuple[str, bytes]:
    """Kind and bytes of one damaged file."""
    rng = np.random.default_rng(seed)
    kind = rng.choice(["truncated", "bytes", "block", "inserted"], p=[0.35, 0.4, 0.15, 0.1])
    at = int(rng.integers(len(data)))
    if kind == "truncated":
        return kind, data[:at]
    if kind == "inserted":
        return kind, data[:at] + data[max(0, at - 50) : at] + data[at:]
    if kind == "block":
        return kind, data[:at] + rng.bytes(int(rng.integers(1, 64))) + data[at + 16 :]
    size = int(rng.choice([1, 2, 4, 16]))
    fill = rng.choice(["0", "255", "127", "128", "random", "digit"])
    new = rng.bytes(size) if fill == "random" else b"7" * size if fill == "digit" else bytes([int(fill)]) * size
    return str(kind), data[:at] + new + data[at + size :]


@dataclass(frozen=True)
class Door:
    """A valid file, and how it is read: `read` gives the arrays that were found, and whether they are flagged."""

    name: str
    path: Path
    read: Callable[[Path], tuple[list[Any], bool]]
    mend: Callable[[bytes], bytes] = bytes


def logs(path: Path) -> tuple[list[Any], bool]:
    """Channels of all records of a log."""
    found = read_all(path, **STATED)
    return [column for r in found for column in r.values.T], any("W209" in codes(r.flags) for r in found)


def outcomes(path: Path | Door, count: int, folder: Path) -> Iterator[tuple[str, str, float]]:
    """Kind of damage, what came of it and the seconds it took; an exception other than InputError passes through."""
    door = path if isinstance(path, Door) else Door(path.suffix, path, logs)
    data, whole = door.path.read_bytes(), door.read(door.path)[0]
    for seed in range(count):
        try:
            yield outcome(door, data, whole, seed, folder)
        except Exception as error:
            error.add_note(f"{door.name}, seed {seed}")
            raise


def outcome(door: Door, data: bytes, whole: list[Any], seed: int, folder: Path) -> tuple[str, str, float]:
    """What came of one mutant of a file whose bytes and arrays are `data` and `whole`; see `outcomes`."""
    kind, damaged = mutant(data, seed)
    place = folder / f"mutant{door.path.suffix}"
    place.write_bytes(door.mend(damaged))
    start = time.process_time()  # of this process: what runs beside it is not its fault
    try:
        found, flagged = door.read(place)
    except InputError:
        return kind, "refused", time.process_time() - start
    seconds = time.process_time() - start
    same = len(found) == len(whole) and all(map(equal, found, whole))
    fewer = len(found) < len(whole) or sum(map(np.size, found)) < sum(map(np.size, whole))
    return kind, "same" if same else "flagged" if flagged else "shorter" if fewer else "other values", seconds


def described(data: bytes, seed: int) -> str:
    """Damage of a mutant in words: its kind, and what lies around the first byte that is not as it was.

    Cuts between two lines are one kind: no text shows them.
    """
    kind, damaged = mutant(data, seed)
    same = np.frombuffer(data, np.uint8)[: len(damaged)] == np.frombuffer(damaged, np.uint8)[: len(data)]
    at = len(same) if same.all() else int(np.argmin(same))
    if kind == "truncated" and b"\n" in data[at - 1 : at + 1]:
        return "cut between two lines"
    return f"{kind} at {at} of {len(data)}: {data[max(0, at - 12) : at]!r} | {data[at : at + 12]!r}"


def equal(one: Any, other: Any) -> bool:
    """Whether two arrays or values are the same, NaN for NaN."""
    one, other = np.asarray(one), np.asarray(other)
    return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()


def log_doors(folder: Path) -> list[Door]:
    """Logs in further dialects of their formats."""
    from tests.loadid.readers import exports, files
    from tests.structures.test_curves import block, cell, mat, mat73, sdynpy

    (folder / "german.csv").write_text(files.csv(separator=";", decimal=","))
    (folder / "headings.lvm").write_text(files.lvm(columns="One", multi=True, samples=8))
    mat73(folder / "v73.mat", {"F": files.F, "a": files.A, "fs": 1000.0})
    mat(folder / "simcenter.mat", False, run=block(np.column_stack((files.F, files.A)), "N", name=cell("1:+Z", "2:-X")))
    sdynpy(folder / "sdynpy.npz", 1, files.T, np.array([files.F, files.A]), [[(1, 3)], [(2, -1)]])
    exports.mdf(folder / "v3.mdf", "3.30")
    exports.miniseed(folder / "v3.mseed", 3)
    return [Door(f"log {p.name}", p, logs) for p in sorted(folder.iterdir())]


def doors(folder: Path) -> list[Door]:
    """Files of every kind that is read and is no log."""
    return [
        *frf_doors(folder),
        *matrix_doors(folder),
        *own_doors(folder),
        *settings_doors(folder),
        *image_doors(folder),
    ]


def frf_doors(folder: Path) -> list[Door]:
    """FRFs: universal files, archives of SDynPy, structs of Simcenter, text tables."""
    from structures.files import read_frfs
    from tests.structures.test_curves import F, H, block, mat, sdynpy
    from tests.structures.uff_made import binary58, frfs, text58, units

    def read(path: Path) -> tuple[list[Any], bool]:
        stated = {} if path.suffix == ".unv" else {"response_unit": "g", "reference_unit": "N"}
        model = read_frfs(path, **stated)
        return [model.frequencies, *model.H.reshape(len(model.H), -1).T], "W209" in codes(model.flags)

    made = []
    for name, write in (("uff text", text58), ("uff binary", binary58)):
        path = folder / f"{name.replace(' ', '_')}.unv"
        path.write_bytes(units(code=1) + frfs(H[:, :, 0, None], [(1, 3), (2, -1)], [(5, 3)], write))
        made.append(Door(f"frf {name}", path, read))
    made.append(Door("frf sdynpy", sdynpy(folder / "f.npz", 4, F, H[:, :, 0].T, [[(1, 3), (5, 3)], [(2, -1), (5, 3)]]),
                     read))  # fmt: skip
    struct = block(H[:, 0], "g/N", x="Hz", kind="FRF", name="1:+Z/5:+Z")
    made.append(Door("frf simcenter", mat(folder / "f.mat", False, FRF=struct), read))
    rows = "".join(f"{f:.2f},{h.real:.6f},{h.imag:.6f}\n" for f, h in zip(F, H[:, 0, 0], strict=True))
    (folder / "f.csv").write_text("Frequency [Hz],Real 1+Z/5+Z [g/N],Imag 1+Z/5+Z [g/N]\n" + rows)
    return [*made, Door("frf text", folder / "f.csv", read)]


def matrix_doors(folder: Path) -> list[Door]:
    """Structures from K and M."""
    import h5py
    import scipy.io

    from structures import beams, chains, files
    from tests.structures.kinds import UNIT

    structure = chains.chain(masses=[1.0, 2.0, 3.0], springs=5.0)
    files.save(structure, folder / "m.npz")
    files.save(structure, folder / "own.h5")
    scipy.io.mmwrite(folder / "m.mtx", structure.K.tocoo())
    with h5py.File(folder / "m.hdf5", "w") as file:
        beam = beams.cantilever(elements=1, **UNIT)
        file["K"], file["M"] = beam.K.toarray(), beam.M.toarray()
        file["dofs"] = [str(d).encode() for d in beam.dofs]

    def read(path: Path) -> tuple[list[Any], bool]:
        found = files.load(path)
        return [A.toarray() for A in (found.K, found.M) if A is not None], False

    paths = [folder / name for name in ("m.npz", "own.h5", "m.mtx", "m.hdf5")]
    return [Door(f"matrices {p.name}", p, read) for p in paths] + [Door("matrices signed", paths[1], read, signed)]


def signed(data: bytes) -> bytes:
    """A damaged file of ours with the hash that is right for it."""
    from structures.files import _storage as storage

    lines = data[: storage.BLOCK].split(b"\n")
    kind = lines[2].removeprefix(b"kind ").decode("latin-1") if len(lines) > 3 else ""
    if not 0 < len(kind) <= 64 or not kind.isascii():
        return data
    body = data[storage.BLOCK :]
    return storage._block(kind, storage._digest(kind, body)) + body


def own_doors(folder: Path) -> list[Door]:
    """Models and results, damaged as they lie and with the right hash."""
    import loadid
    from structures import ForwardModel, beams, damping, loads, sensors
    from structures.files import _modelfile as modelfile
    from tests.structures.kinds import UNIT

    beam = beams.cantilever(elements=2, **UNIT).with_damping(damping.Modal(0.02))
    model = ForwardModel(beam, [sensors.Displacement("2+Z")], [loads.Point("2+Z", label="tip")])
    model.save(folder / "model.h5")
    model.state_space(1e-4).save(folder / "space.h5")
    history = np.hanning(40)[:, None]
    record = loadid.Record(model.predict(history, 1e-3), 1e-3, model.sensors)
    loadid.Deconvolution(model, noise=1e-3).estimate(record).save(folder / "result.h5")

    def read_model(path: Path) -> tuple[list[Any], bool]:
        found = modelfile.load_model(path)
        return [found.state_space(1e-4).A], False

    def read_result(path: Path) -> tuple[list[Any], bool]:
        found = loadid.load(path)
        return [found.load, found.std], False

    cases = [("model", read_model), ("space", read_model), ("result", read_result)]
    plain = [Door(name, folder / f"{name}.h5", read) for name, read in cases]
    return plain + [Door(f"{d.name} signed", d.path, d.read, signed) for d in plain]


def settings_doors(folder: Path) -> list[Door]:
    """The TOML files of pads and fleets."""
    from loadid._batch import plan
    from tactile._pad import padfile
    from tests.batch.fleet import fleet

    (folder / "pad.toml").write_text(padfile.EXAMPLE, encoding="utf-8")
    place = folder / "fleet"
    place.mkdir()
    many = fleet(place, assets=1, records=1)
    (folder / "plan.toml").write_text(many.read_text())

    def read_pad(path: Path) -> tuple[list[Any], bool]:
        return [repr(padfile.read(path))], False

    def read_plan(path: Path) -> tuple[list[Any], bool]:
        beside = many.with_name(f"read_{path.name}")
        beside.write_bytes(path.read_bytes())
        return [repr(plan.read(beside).assets)], False

    return [Door("pad.toml", folder / "pad.toml", read_pad), Door("plan.toml", folder / "plan.toml", read_plan)]


def image_doors(folder: Path) -> list[Door]:
    """Stacks of images and marker motions."""
    from PIL import Image

    from tactile.vision import frames, read_motions

    rng = np.random.default_rng(0)
    images = rng.integers(0, 255, (3, 12, 16), dtype=np.uint8)
    np.save(folder / "stack.npy", images)
    np.savez_compressed(folder / "stack.npz", images=images)
    Image.fromarray(images[0]).save(folder / "one.png")
    motion = np.round(rng.normal(size=(4, 3, 2)), 3)
    np.save(folder / "motion.npy", motion)
    lines = ["frame,id,x,y"]
    lines += [f"{t},{k},{x},{y}" for t, row in enumerate(motion) for k, (x, y) in enumerate(row)]
    (folder / "motion.csv").write_text("\n".join(lines) + "\n")

    def read_stack(path: Path) -> tuple[list[Any], bool]:
        if path.suffix == ".png":
            place = folder / "folder"
            place.mkdir(exist_ok=True)
            (place / "frame1.png").write_bytes(path.read_bytes())
            path = place
        return [np.array(image) for image in frames(path)], False

    def read_motion(path: Path) -> tuple[list[Any], bool]:
        found = read_motions(path)
        return [found.places], "W209" in codes(found.flags)

    stacks = [Door(f"images {n}", folder / n, read_stack) for n in ("stack.npy", "stack.npz", "one.png")]
    return stacks + [Door(f"markers {n}", folder / n, read_motion) for n in ("motion.npy", "motion.csv")]


def main(seeds: range, names: list[str]) -> None:
    """Print one line per kind of file."""
    from structures.files import _child
    from tests.loadid.readers.files import small_files

    _child.PATIENCE = 1.0  # these files are small
    memory = Path("/dev/shm")
    print(
        f"{'kind':20}{'mutants':>9}{'refused':>9}{'flagged':>9}{'same':>7}{'shorter':>9}{'other':>7}{'foreign':>9}"
        f"{'slowest s':>11}"
    )
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as name:
        folder = Path(name)
        every = [Door(f"log {s}", p, logs) for s, p in small_files(folder).items()]
        for made in (log_doors, doors):
            (folder / made.__name__).mkdir()
            every += made(folder / made.__name__)
        for door in every:
            if names and not door.name.startswith(tuple(names)):
                continue
            told: Counter[str] = Counter()
            less: Counter[str] = Counter()
            slowest, said = 0.0, []
            data, whole = door.path.read_bytes(), door.read(door.path)[0]
            for seed in seeds:
                try:
                    _, found, seconds = outcome(door, data, whole, seed, folder)
                except Exception as error:
                    found, seconds = "foreign", 0.0
                    said.append(f"seed {seed}: {type(error).__name__}: {error}"[:160])
                if found == "shorter":
                    less[described(data, seed)] += 1
                told[found] += 1
                slowest = max(slowest, seconds)
            counts = [told[k] for k in ("refused", "flagged", "same", "shorter", "other values", "foreign")]
            print(f"{door.name:20}{len(seeds):9}{counts[0]:9}{counts[1]:9}{counts[2]:7}{counts[3]:9}{counts[4]:7}"
                  f"{counts[5]:9}{slowest:11.3f}", *(f"\n    {one}" for one in said[:12]),
                  *(f"\n    shorter: {n} {one}" for one, n in less.most_common(24)), flush=True)  # fmt: skip


if __name__ == "__main__":
    first, _, last = (sys.argv[1] if len(sys.argv) > 1 else "1000").rpartition("-")
    main(range(int(first or 0), int(last)), sys.argv[2:])
