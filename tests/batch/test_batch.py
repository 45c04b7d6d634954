"""The command on small fleets: killed, gone on, refused in part, and the same whoever works and in which order."""

from __future__ import annotations

import csv
import importlib.util
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest

from loadid import cli
from loadid._batch import run as running
from loadid._batch.records import Chunk, Order
from loadid._batch.work import Done, work
from tests.batch.fleet import fleet, record, written

JOB = "[job]\nchoice = 0.003\n[run]\npiece = 6000\nworkers = 2\n"


class Here:
    """A crew of this process alone, in order."""

    size = room = 1

    def submit(self, chunk: Chunk, order: Order) -> Future[Done]:
        future: Future[Done] = Future()
        try:
            future.set_result(work(chunk, order))
        except Exception as error:
            future.set_exception(error)
        return future

    def lost(self, future: Future[Done]) -> bool:
        return False

    def close(self) -> None:
        pass


@pytest.fixture
def serial(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running, "Processes", lambda size, memory: Here())


def ledger(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "out" / "ledger.jsonl").read_text().splitlines()]


def rows(folder: Path, table: str) -> list[dict[str, str]]:
    found = []
    for path in sorted((folder / "out" / "results" / table).rglob("part.*")):
        if path.suffix == ".csv":
            found += list(csv.DictReader(path.read_text().splitlines()))
        else:
            from pyarrow import parquet

            found += parquet.ParquetFile(path).read().to_pylist()
    return found


def mixed(folder: Path) -> Path:
    """Two assets with short records, and one of them with a long one."""
    plan = fleet(folder, assets=2, records=2, samples=1500, more=JOB)
    record(folder / "b0" / "20260301_0100.npz", 36_000, 7)
    return plan


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fleet that was worked on here, one chunk after the other."""
    folder = tmp_path_factory.mktemp("serial") / "fleet"
    before = running.Processes
    running.Processes = lambda size, memory: Here()  # type: ignore[assignment,misc]
    try:
        assert cli.main(["batch", str(mixed(folder))]) == 0
    finally:
        running.Processes = before  # type: ignore[misc]
    return folder


def copy(of: Path, to: Path) -> Path:
    """The same fleet (files, not their names, make the keys), nothing done."""
    shutil.copytree(of, to, ignore=shutil.ignore_patterns("out"))
    return to / "plan.toml"


def test_what_is_written(undisturbed: Path) -> None:
    done = Counter(line["event"] for line in ledger(undisturbed))
    assert done == {"done": 4 + 1 + 6}  # short records, a long one and its pieces
    records = rows(undisturbed, "records")
    assert [row["status"] for row in records] == ["done"] * 5
    assert sorted(int(row["pieces"]) for row in records) == [1, 1, 1, 1, 6]
    assert {row["grade"] for row in records} <= set("ABCD")
    long = next(row for row in rows(undisturbed, "loads") if int(row["samples"]) == 36_000)
    assert float(long["peak_low"]) < float(long["peak"]) < float(long["peak_high"])
    assert len(rows(undisturbed, "peaks")) == 4 + 6
    assert len(rows(undisturbed, "sensors")) == 5
    assert not list((undisturbed / "out").rglob("*.tmp"))
    assert not (undisturbed / "out" / "scratch").exists()


def test_the_page_asks_nobody(undisturbed: Path) -> None:
    page = (undisturbed / "out" / "fleet.html").read_text()
    assert not re.search(r"https?:|src=|href=|@import|url\(", page)
    assert "default-src 'none'" in page
    assert page.count("<tr>") >= 2 + 2 + 2


def test_workers_that_are_killed(undisturbed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SIGKILL of a random worker, three times: the same parts, tables and page, nothing twice."""
    plan, crews = copy(undisturbed, tmp_path / "fleet"), []
    made = running.Processes

    def watched(size: int, memory: float | None) -> running.Processes:
        crews.append(made(size, memory))
        return crews[0]

    monkeypatch.setattr(running, "Processes", watched)
    killed: list[int] = []

    def kill() -> None:
        rng = random.Random(5)
        while len(killed) < 3:
            time.sleep(rng.uniform(0.05, 0.3))
            busy = [w.result() for w in list(crews[0]._who.values()) if w.done()] if crews else []
            busy = [pid for pid in busy if pid not in killed]
            if busy:
                killed.append(rng.choice(busy))
                os.kill(killed[-1], signal.SIGKILL)

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    assert cli.main(["batch", str(plan)]) == 0
    thread.join(timeout=10)
    assert len(killed) == 3
    lines = ledger(tmp_path / "fleet")
    assert Counter(line["event"] for line in lines)["lost"] >= 1
    done = [line["key"] for line in lines if line["event"] == "done"]
    assert len(done) == len(set(done)) == 11
    assert written(tmp_path / "fleet" / "out") == written(undisturbed / "out")


def test_a_run_that_is_killed_goes_on(
    undisturbed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = copy(undisturbed, tmp_path / "fleet")
    command = [sys.executable, "-m", "loadid.cli", "batch", str(plan)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, cwd=Path(__file__).parents[2]) as process:
        at = tmp_path / "fleet" / "out" / "ledger.jsonl"
        while process.poll() is None and (not at.exists() or at.read_bytes().count(b"\n") < 3):
            time.sleep(0.01)
        process.kill()
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "fleet" / "out" / "parts").rglob("*.json")}
    assert 0 < len(before) < 11
    with at.open("ab") as file:
        file.write(b'{"event": "do')  # what a kill leaves of a line
    assert cli.main(["batch", str(plan)]) == 3  # not without --resume
    monkeypatch.setattr(running, "Processes", lambda size, memory: Here())
    assert cli.main(["batch", str(plan), "--resume", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert written(tmp_path / "fleet" / "out") == written(undisturbed / "out")


@pytest.mark.usefixtures("serial")
class TestRecords:
    def test_one_bad_record_stops_nothing(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        plan = fleet(tmp_path, assets=2, records=2, more=JOB)
        (tmp_path / "b0" / "20260301_0200.npz").write_bytes(b"no NPZ")
        (tmp_path / "b0" / "20260301_0201.npz").write_bytes(b"")
        shutil.copy(tmp_path / "b0" / "20260301_0000.npz", tmp_path / "b0" / "20260301_0300.npz")
        shutil.copy(tmp_path / "b1" / "20260301_0000.npz", tmp_path / "b0" / "march.npz")
        record(tmp_path / "b1" / "20260301_0002.npz", 1_000_000, 0)  # 98 s
        record(tmp_path / "b1" / "20260301_0003.npz", 1500, 9)
        (tmp_path / "plan.toml").write_text(plan.read_text().replace("piece = 6000", "piece = 400_000"))
        assert cli.main(["batch", str(plan), "--json"]) == 3
        answer = json.loads(capsys.readouterr().out)
        assert (answer["done"], answer["refused"], answer["failed"]) == (5, 5, 0)
        said = {row["record"].rpartition("_")[2]: row["said"] for row in answer["without_answer"]}
        assert "overlaps an earlier record" in said["0003.npz"]
        assert "the same bytes as" in said["0300.npz"]
        assert "does not tell when the record begins" in said["b0/march.npz"]
        assert said["0200.npz"]
        assert said["0201.npz"]

    def test_limits(self, tmp_path: Path) -> None:
        plan = fleet(tmp_path, assets=1, records=1, more=JOB)
        peak = float(self.peak(plan, tmp_path, "")["peak"])
        self.peak(plan, tmp_path, f"u0 = {peak / 3}")
        alarms = [row for row in rows(tmp_path, "alarms") if float(row["limit"]) > 0]
        assert [str(row["certain"]) for row in alarms] == ["True"]
        assert "need eyes" in (tmp_path / "out" / "fleet.html").read_text()
        self.peak(plan, tmp_path, f"u0 = {peak * 1.02}")
        assert [str(row["certain"]) for row in rows(tmp_path, "alarms")] == ["False"]
        self.peak(plan, tmp_path, f"u0 = {peak * 50}")
        assert rows(tmp_path, "alarms") == []
        assert cli.main(["batch", str(self.limited(plan, "u1 = 2"))]) == 3

    def limited(self, plan: Path, limits: str) -> Path:
        text = re.sub(r"\nlimits = .*", "", plan.read_text()) + f"limits = {{ {limits} }}\n"
        plan.write_text(text)
        return plan

    def peak(self, plan: Path, folder: Path, limits: str) -> dict[str, str]:
        assert cli.main(["batch", str(self.limited(plan, limits)), "--resume"]) == 0
        return rows(folder, "loads")[0]

    def test_only_what_changed_is_done_again(self, tmp_path: Path) -> None:
        plan = fleet(tmp_path, assets=1, records=3, more=JOB)
        assert cli.main(["batch", str(plan)]) == 0
        assert len(ledger(tmp_path)) == 3
        record(tmp_path / "b0" / "20260301_0001.npz", 1500, 77)
        assert cli.main(["batch", str(plan), "--resume"]) == 0
        assert [Path(line["record"]).name for line in ledger(tmp_path)[3:]] == ["20260301_0001.npz"]
        plan.write_text(plan.read_text().replace("choice = 0.003", "choice = 0.004"))
        assert cli.main(["batch", str(plan), "--resume"]) == 0
        assert len(ledger(tmp_path)) == 7

    def test_an_error_of_ours_is_listed(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        plan = fleet(tmp_path, assets=1, records=2, more=JOB)
        own = Here.submit

        def failing(self: Here, chunk: Chunk, order: Order) -> Future[Done]:
            if "0001" not in chunk.record:
                return own(self, chunk, order)
            future: Future[Done] = Future()
            future.set_exception(ZeroDivisionError("oh"))
            return future

        monkeypatch.setattr(Here, "submit", failing)
        assert cli.main(["batch", str(plan)]) == 3
        assert [row["status"] for row in rows(tmp_path, "records")] == ["done", "failed"]
        monkeypatch.setattr(Here, "submit", own)
        assert cli.main(["batch", str(plan), "--resume"]) == 0

    def test_a_worker_that_is_lost_for_ever(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        plan = fleet(tmp_path, assets=1, records=2, more=JOB + "retries = 1\n")
        monkeypatch.setattr(Here, "lost", lambda self, future: future.result().pieces == () and self.count())
        counted: list[int] = []
        monkeypatch.setattr(Here, "count", lambda self: counted.append(1) or len(counted) <= 2, raising=False)
        assert cli.main(["batch", str(plan)]) == 3
        assert "lost 2 times" in next(row["said"] for row in rows(tmp_path, "records") if row["status"] == "failed")

    def test_dates(self, tmp_path: Path) -> None:
        plan = fleet(tmp_path, assets=1, records=3, more=JOB)
        with plan.open("a") as file:
            file.write("from = 2026-03-01T00:01:00\nto = 2026-03-01T00:02:00\n")
        assert cli.main(["batch", str(plan)]) == 0
        assert [Path(row["record"]).name for row in rows(tmp_path, "records")] == ["20260301_0001.npz"]

    def test_histories_and_csv(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "pyarrow", None)
        plan = fleet(tmp_path, assets=1, records=1, samples=12_000, more=JOB + "history = true\n")
        assert cli.main(["batch", str(plan)]) == 0
        kept = [np.load(path) for path in (tmp_path / "out" / "histories").rglob("*.npy")]
        assert [one.shape for one in kept] == [(2, 6000, 1)] * 2
        assert float(rows(tmp_path, "loads")[0]["max"]) == max(one[0].max() for one in kept)

    def test_the_cost_alone(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        plan = fleet(tmp_path, assets=1, records=4, more=JOB)
        assert cli.main(["batch", str(plan), "--estimate"]) == 0
        assert "4 records of 1 assets" in capsys.readouterr().out
        assert len(ledger(tmp_path)) == 2
        assert not (tmp_path / "out" / "results").exists()

    def test_a_folder_is_one_record(self, tmp_path: Path) -> None:
        """Against the same samples in one file; a gap between two files is missing samples."""
        plan = fleet(tmp_path, assets=2, records=0, more=JOB)
        record(tmp_path / "whole.npz", 12_000, 3)
        with np.load(tmp_path / "whole.npz") as held:
            y, rate = np.array(held["y0"]), float(held["fs"])
        for k, (first, last) in enumerate([(0, 4000), (4000, 9000), (9040, 12_000)]):
            start = np.datetime64("2026-03-01", "ns") + np.timedelta64(round(first * 1e9 / rate), "ns")
            (tmp_path / "b0" / "day").mkdir(parents=True, exist_ok=True)
            np.savez(tmp_path / "b0" / "day" / f"{k}.npz", y0=y[first:last], fs=rate, start=str(start))
        y[9000:9040] = np.nan
        (tmp_path / "b1").mkdir()
        np.savez(tmp_path / "b1" / "day.npz", y0=y, fs=rate)
        text = plan.read_text().replace("{name}/*.npz", "{name}/day*").replace('start = "%Y%m%d_%H%M.npz"', "")
        plan.write_text(text.replace('name = "b0"', 'name = "b0"\nrecords = "b0/*/"'))
        assert cli.main(["batch", str(plan)]) == 0
        found = {row["record"]: row for row in rows(tmp_path, "records")}
        assert {Path(name).name for name in found} == {"day", "day.npz"}
        for table, keys in (("loads", ("peak", "rms", "samples")), ("sensors", ("missing", "rms"))):
            one, two = sorted(rows(tmp_path, table), key=lambda row: row["record"])
            assert [float(one[k]) for k in keys] == pytest.approx([float(two[k]) for k in keys], rel=1e-9)
        assert float(one["missing"]) == pytest.approx(40 / 12_000)
        before = len(ledger(tmp_path))
        (tmp_path / "b0" / "day" / "2.npz").write_bytes(b"no archive")  # its bytes are part of the key
        assert cli.main(["batch", str(plan), "--resume"]) != 0
        assert len(ledger(tmp_path)) > before
        assert "2.npz" in next(row["said"] for row in rows(tmp_path, "records") if row["status"] != "done")

    def test_parquet_records(self, tmp_path: Path) -> None:
        pa = pytest.importorskip("pyarrow")
        from pyarrow import parquet

        plan = fleet(tmp_path, assets=1, records=1, more=JOB)
        held = np.load(tmp_path / "b0" / "20260301_0000.npz")
        times = (np.arange(len(held["y0"])) * 1e9 / float(held["fs"])).astype("int64").astype("datetime64[ns]")
        parquet.write_table(pa.table({"time": times, "y0": held["y0"]}), tmp_path / "b0" / "20260301_0000.parquet")
        assert cli.main(["batch", str(plan)]) == 0
        before = rows(tmp_path, "loads")
        plan.write_text(plan.read_text().replace(".npz", ".parquet"))
        assert cli.main(["batch", str(plan), "--resume"]) == 0
        after = rows(tmp_path, "loads")
        assert after[0]["peak"] == pytest.approx(before[0]["peak"], rel=1e-6)


@pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="dask.distributed is not installed")
def test_a_cluster(undisturbed: Path, tmp_path: Path) -> None:
    """Two workers of a scheduler, one of them killed."""
    plan = copy(undisturbed, tmp_path / "fleet")
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    own = [sys.executable, "-m", "distributed.cli.dask_worker"]
    boss = subprocess.Popen([sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port",
                             "18786", "--no-dashboard"], env=env, stderr=subprocess.DEVNULL)  # fmt: skip
    address = "tcp://127.0.0.1:18786"
    hands = [subprocess.Popen([*own, address, "--nthreads", "1", "--no-dashboard", "--no-nanny", "--local-directory",
                               str(tmp_path)], env=env, stderr=subprocess.DEVNULL) for _ in range(2)]  # fmt: skip
    try:
        at = tmp_path / "fleet" / "out" / "ledger.jsonl"

        def kill() -> None:
            while not at.exists() or at.read_bytes().count(b"\n") < 3:
                time.sleep(0.01)
            hands[0].kill()

        threading.Thread(target=kill, daemon=True).start()
        assert cli.main(["batch", str(plan), "--scheduler", address]) == 0
    finally:
        for process in (*hands, boss):
            process.kill()
            process.wait()
    assert written(tmp_path / "fleet" / "out") == written(undisturbed / "out")


def test_nobody_answers(undisturbed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if importlib.util.find_spec("distributed") is None:
        assert cli.main(["batch", str(copy(undisturbed, tmp_path / "f")), "--scheduler", "tcp://x:1"]) == 3
        assert "loadid[cluster]" in capsys.readouterr().err
    else:
        assert cli.main(["batch", str(copy(undisturbed, tmp_path / "f")), "--scheduler", "nonsense"]) == 3
        assert "scheduler does not answer" in capsys.readouterr().err
