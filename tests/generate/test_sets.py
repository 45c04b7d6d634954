"""Training sets: what is written comes back, whoever wrote it and however often; what is wrong with one is refused."""

from __future__ import annotations

import pickle
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from loadid import InputError, Record
from loadid.generate import Examples, TrainingSet, generate
from loadid.generate._shards import shard_of

from ..sources import ROOT
from .made import Coins

DRAWS = 230  # three shards


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("coins") / "set"
    generate(Coins(), path, draws=DRAWS, seed=3, workers=1)
    return path


def shards(folder: Path) -> list[bytes]:
    return [shard_of(folder, k).read_bytes() for k in range(3)]


def shards_held(folder: Path) -> list[dict[str, tuple[str, tuple[int, ...], bytes]]]:
    """Of each shard: dtype, shape and bytes of every dataset."""
    import h5py

    found: list[dict[str, tuple[str, tuple[int, ...], bytes]]] = []
    for k in range(3):
        held: dict[str, tuple[str, tuple[int, ...], bytes]] = {}

        def keep(name: str, item: object, held: dict[str, tuple[str, tuple[int, ...], bytes]] = held) -> None:
            if isinstance(item, h5py.Dataset):
                value = np.asarray(item[()])
                data = repr(value.tolist()).encode() if value.dtype.hasobject else value.tobytes()
                held[name] = (str(value.dtype), value.shape, data)

        with h5py.File(shard_of(folder, k)) as file:
            file.visititems(keep)
        found.append(held)
    assert all({"data", "loads"} <= {name.rpartition("/")[2] for name in held} for held in found)
    return found


# -- numbers ----------------------------------------------------------------------------------------------------------
def test_what_was_drawn_comes_back(folder: Path) -> None:
    found = TrainingSet.open(folder)
    whole = found.read()
    assert len(found) == len(whole) == DRAWS
    assert (found.sensors, found.loads, found.kinds) == (Coins.sensors, Coins.loads, Coins.kinds)
    assert whole.missing is not None
    clean = np.column_stack([whole.loads, whole.loads.sum(axis=1)])
    assert np.allclose(whole.data[~whole.missing], clean[~whole.missing], rtol=1e-6, atol=1e-6)
    assert np.all(whole.data[whole.missing] == 0)
    assert np.allclose(whole.parameters["first"], whole.loads[:, 0], rtol=1e-6)
    assert np.array_equal(whole.kinds == "head", whole.loads[:, 0] > 0)
    assert 0.1 < np.mean(whole.parameters["redrawn"] > 0) < 0.3


def test_a_draw_depends_on_seed_and_number_alone(folder: Path, tmp_path: Path) -> None:
    few = generate(Coins(), tmp_path / "few", draws=7, seed=3, workers=1).read()
    many = TrainingSet.open(folder).read(slice(0, 7))
    assert np.array_equal(few.data, many.data)
    assert np.array_equal(few.loads, many.loads)
    other = generate(Coins(), tmp_path / "other", draws=7, seed=4, workers=1)
    assert not np.array_equal(other.read().loads, few.loads)
    assert other.fingerprint != TrainingSet.open(folder).fingerprint


def test_places_batches_and_splits(folder: Path) -> None:
    found = TrainingSet.open(folder)
    whole = found.read()
    some = found.read([229, 3, 150])
    assert list(some.draws) == [229, 3, 150]
    assert np.array_equal(some.loads, whole.loads[[229, 3, 150]])
    assert sum(len(one) for one in found.batches(60)) == DRAWS
    parts = found.split((0.5, 0.3, 0.2), seed=1)
    taken = np.concatenate([part.read().draws for part in parts])
    assert [len(part) for part in parts] == [115, 69, 46]
    assert np.array_equal(np.sort(taken), np.arange(DRAWS))
    assert parts[1].fingerprint == found.fingerprint
    again = pickle.loads(pickle.dumps(parts[1]))
    assert np.array_equal(again.read().data, parts[1].read().data)


@pytest.mark.parametrize("ask", [[230], 1.5, slice(0, 0)])
def test_draws_that_are_not_there_are_refused(folder: Path, ask: object) -> None:
    with pytest.raises(InputError, match="draws"):
        TrainingSet.open(folder).read(ask)  # type: ignore[arg-type]


@pytest.mark.parametrize("shares", [(), (0.9, 0.2), (-0.1, 0.5), (0.999, 0.001)])
def test_shares_that_are_none_are_refused(folder: Path, shares: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match=r"share|empty"):
        TrainingSet.open(folder).split(shares)


def test_measured_pairs_are_a_set_too() -> None:
    rng = np.random.default_rng(0)
    y, g = rng.standard_normal((5, 20, 2)), rng.standard_normal((5, 20, 1))
    y[1, 4, 0] = np.nan
    records = [Record(one, 0.01) for one in y]
    found = TrainingSet.of(Examples.measured(records, g, noise=0.1), sensors=["a", "b"], loads=["f"], dt=0.01)
    assert (found.samples, found.dt, found.kinds) == (20, 0.01, ("measured",))
    assert [c.label for c in found.sensors] == ["a", "b"]
    whole = found.read()
    assert whole.missing is not None
    assert np.argwhere(whole.missing).tolist() == [[1, 4, 0]]
    twice = TrainingSet.of(Examples.measured(y, g, noise=0.1), Examples.measured(y[:2], g[:2], noise=0.2), dt=0.01)
    assert len(twice) == 7
    assert twice.read().noise.shape == (7, 2)
    with pytest.raises(InputError, match="histories have a step"):
        TrainingSet.of(Examples.measured(y, g))
    with pytest.raises(InputError, match="finite"):
        Examples.measured(y, np.full_like(g, np.nan))
    with pytest.raises(InputError, match="do not fit"):
        Examples.measured(y, g[:3])


# -- workers and kills ------------------------------------------------------------------------------------------------
def test_workers_write_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    generate(Coins(), tmp_path / "shared", draws=DRAWS, seed=3, workers=2)
    assert shards(tmp_path / "shared") == shards(folder)


@pytest.mark.filterwarnings("ignore")  # of the cluster's own making
def test_a_cluster_writes_the_same_numbers(folder: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=True, dashboard_address=None
    ) as cluster:  # fmt: skip
        address = cluster.scheduler_address
        generate(Coins(), tmp_path / "cluster", draws=DRAWS, seed=3, scheduler=address)
    # HDF5 may lay out the same datasets otherwise there: what is in them is compared, bit for bit
    assert shards_held(tmp_path / "cluster") == shards_held(folder)


KILLED = """
import sys
from loadid.generate import generate
from tests.generate.made import Coins
generate(Coins(pause=0.004), sys.argv[1], draws=230, seed=3, workers=1)
"""


def test_a_killed_run_goes_on(folder: Path, tmp_path: Path) -> None:
    """Killed in its second shard: the first stays, and what is made then is what would have been made."""
    path = tmp_path / "killed"
    run = subprocess.Popen([sys.executable, "-c", KILLED, str(path)], cwd=ROOT)
    try:
        deadline = time.monotonic() + 120
        while not shard_of(path, 0).exists() and run.poll() is None and time.monotonic() < deadline:
            time.sleep(0.02)
        time.sleep(0.1)
    finally:
        run.send_signal(signal.SIGKILL)
        run.wait()
    there = sorted(one.name for one in (path / "shards").glob("*.h5"))
    assert there[0] == "00000.h5"
    assert len(there) < 3
    first = shard_of(path, 0).stat().st_mtime_ns
    with pytest.raises(InputError, match="shard of the training set is missing"):
        TrainingSet.open(path).read()
    generate(Coins(), path, draws=DRAWS, seed=3, workers=1)
    assert shards(path) == shards(folder)
    assert shard_of(path, 0).stat().st_mtime_ns == first


# -- what is refused --------------------------------------------------------------------------------------------------
def test_a_damaged_shard_is_refused(folder: Path, tmp_path: Path) -> None:
    generate(Coins(), tmp_path / "set", draws=DRAWS, seed=3, workers=1)
    path = shard_of(tmp_path / "set", 1)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    found = TrainingSet.open(tmp_path / "set")
    assert len(found.read(slice(0, 100))) == 100
    with pytest.raises(InputError, match="damaged"):
        found.read()
    with pytest.raises(InputError, match="damaged"):
        generate(Coins(), tmp_path / "set", draws=DRAWS, seed=3, workers=1)
    path.write_bytes(shard_of(folder, 0).read_bytes())
    with pytest.raises(InputError, match="not its own"):
        found.read()


def test_a_shard_of_another_set_or_version_is_refused(folder: Path, tmp_path: Path,
                                                      monkeypatch: pytest.MonkeyPatch) -> None:  # fmt: skip
    generate(Coins("others"), tmp_path / "set", draws=DRAWS, seed=3, workers=1)
    shard_of(tmp_path / "set", 2).write_bytes(shard_of(folder, 2).read_bytes())
    with pytest.raises(InputError, match="shard of another training set"):
        TrainingSet.open(tmp_path / "set").read()
    with pytest.raises(InputError, match="holds another training set"):
        generate(Coins(), tmp_path / "set", draws=DRAWS, seed=3, workers=1)
    monkeypatch.setattr("loadid.generate._shards.VERSION", 99)
    with pytest.raises(InputError, match="another version"):
        TrainingSet.open(folder)
    with pytest.raises(InputError, match="no training set"):
        TrainingSet.open(tmp_path)
    assert not (tmp_path / "set.h5").exists()


@pytest.mark.parametrize("given", [{"draws": 0}, {"seed": -1}, {"seed": 1.5}, {"workers": -2}])
def test_numbers_that_are_none_are_refused(tmp_path: Path, given: dict) -> None:
    with pytest.raises(InputError):
        generate(Coins(), tmp_path / "set", **{"draws": 5, "seed": 0, "workers": 1, **given})


class Edge(Coins):
    """Never has an answer."""

    def draw(self, rng: np.random.Generator) -> object:  # type: ignore[override]
        from structures import NotIdentifiable

        raise NotIdentifiable("on its edge", advice="throw again", code="LID-E306")


def test_what_never_has_an_answer_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="hardly ever an answer"):
        generate(Edge(), tmp_path / "set", draws=5, seed=0, workers=1)
    assert not list((tmp_path / "set" / "shards").iterdir())
