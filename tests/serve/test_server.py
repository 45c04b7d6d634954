"""What a server does with streams that go wrong, with its tables, its checkpoints, and what it says of itself."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import h5py
import numpy as np
import pytest

from loadid._serve import plan
from loadid._serve.metrics import Endpoint, exposition, samples
from loadid._serve.server import Server
from loadid.cli import main as command
from structures.errors import InputError
from tests.killed import text

from .broker import Mosquitto, free_port, health, waited
from .served import fitted, lines, rounds, rows, server, undisturbed


def test_a_header_without_a_unit_halts_one_structure_alone_and_is_mended_by_the_plan(tmp_path: Path) -> None:
    log = lines()
    bare = [b"time,a0 [m/s^2],a1 [m/s^2],a2 [m/s^2],d0\n", *log[1:]]
    with Mosquitto(tmp_path) as broker:
        fitted()[0].save(tmp_path / "model.h5")
        text = (f'states = "states"\n[run]\nlatency = 0.005\n[every]\nmodel = "model.h5"\n'
                f'source = "mqtt://127.0.0.1:{broker.port}/{{name}}"\nsinks = ["{{name}}.csv"]\n'
                '[[asset]]\nname = "mast"\n[[asset]]\nname = "roof"\n')  # fmt: skip
        (tmp_path / "plan.toml").write_text(text)
        client = broker.client()
        with Server(plan.read(tmp_path / "plan.toml")) as one:
            rounds(one, lambda: not one.feeds["mast"].down(), "the subscription")
            for name, own in (("mast", bare), ("roof", log)):
                for k in range(0, 1501, 300):
                    client.publish(name, b"".join(own[k : k + 300]), qos=1)
            rounds(one, lambda: rows(tmp_path, "roof.csv") == 1500, "the rows")
            rounds(one, lambda: one.counts["messages"] == 12, "all messages")
            assert "unit" in one.lives["mast"].halted
            assert "d0" in one.lives["mast"].halted
            assert rows(tmp_path) <= 0
            stop = threading.Event()
            stop.set()
            one.go(stop)  # an orderly end keeps what the halted one needs
        assert list((tmp_path / "states").glob("*.bin"))
        (tmp_path / "plan.toml").write_text(text.replace('name = "mast"\n', 'name = "mast"\nunit = { d0 = "m" }\n'))
        with Server(plan.read(tmp_path / "plan.toml")) as one:
            assert not one.lives["mast"].halted
            assert rows(tmp_path) == 1500
        client.disconnect()
        client.loop_stop()
    assert (tmp_path / "mast.csv").read_bytes() == undisturbed(tmp_path, log)
    assert (tmp_path / "roof.csv").read_bytes() == (tmp_path / "mast.csv").read_bytes()


def test_what_can_never_be_read_is_given_up_for_one_structure_alone(tmp_path: Path) -> None:
    log = lines()
    fitted()[0].save(tmp_path / "model.h5")
    with Mosquitto(tmp_path) as broker:
        (tmp_path / "plan.toml").write_text(
            f'states = "states"\n[run]\nlatency = 0.005\n[every]\nmodel = "model.h5"\n'
            f'source = "mqtt://127.0.0.1:{broker.port}/{{name}}"\nsinks = ["{{name}}.csv"]\n'
            '[[asset]]\nname = "mast"\n[[asset]]\nname = "roof"\n'
        )
        asked, client = plan.read(tmp_path / "plan.toml"), broker.client()
        with Server(asked) as one:
            rounds(one, lambda: not one.feeds["mast"].down(), "the subscription")
            client.publish("mast", b"time,a0 [g]\n0,1\n", qos=1)
            client.publish("mast", b"".join(log[:300]), qos=1)
            client.publish("roof", b"".join(log[:500]), qos=1)
            rounds(one, lambda: one.counts["messages"] == 3 and rows(tmp_path, "roof.csv") == 499, "all messages")
            assert one.lives["mast"].halted
        with Server(asked) as one:
            assert one.lives["mast"].halted
        with pytest.raises(InputError, match="did you mean 'mast'"):
            Server(asked, skip=["masts"])
        with Server(asked, skip=["mast"]) as one:
            assert not one.lives["mast"].halted
            assert one.counts["skipped"] == 2
        with Server(asked) as one:
            assert not one.lives["mast"].halted
            assert one.counts["skipped"] == 0
            client.publish("mast", b"".join([log[0], *log[300:400]]), qos=1)
            rounds(one, lambda: rows(tmp_path) == 100, "the rows")
            assert one.lives["roof"].follows.counts["samples"] == 499
        client.disconnect()
        client.loop_stop()
    with pytest.raises(InputError, match="not in the journal"):
        server(tmp_path, "log.csv", skip=["mast"])


def test_segments_that_a_checkpoint_has_left_behind_go_at_the_next_start(tmp_path: Path) -> None:
    log = lines()
    with Mosquitto(tmp_path) as broker:
        source = f"mqtt://127.0.0.1:{broker.port}/mast"
        client = broker.client()
        with server(tmp_path, source) as one:
            rounds(one, lambda: not one.feeds["mast"].down(), "the subscription")
            client.publish("mast", b"".join(log[:300]), qos=1)
            rounds(one, lambda: rows(tmp_path) == 299, "the rows")
            one.lives["mast"].checkpoint()
            client.publish("mast", b"".join(log[300:400]), qos=1)
            rounds(one, lambda: rows(tmp_path) == 399, "the rows")
        assert list((tmp_path / "states").glob("*.bin"))
        with server(tmp_path, source) as one:  # what lies behind the checkpoint stays until the next
            assert one.journal.size > 0
            one.lives["mast"].checkpoint()
        with server(tmp_path, source) as one:
            assert one.journal.size == 0
        client.disconnect()
        client.loop_stop()


def test_pauses_late_and_doubled_messages_are_counted_and_do_no_harm(tmp_path: Path) -> None:
    log = lines()
    pieces = [b"".join(log[k : k + 20]) for k in range(1, 1501, 20)]
    order = [*range(10), 9, 8, *range(10, 30), *range(31, 35), 30, *range(35, 50), *range(52, 75)]
    with Mosquitto(tmp_path) as broker, server(tmp_path, f"mqtt://127.0.0.1:{broker.port}/mast") as one:
        rounds(one, lambda: not one.feeds["mast"].down(), "the subscription")
        client = broker.client()
        client.publish("mast", log[0] + log[1], qos=1)
        rounds(one, lambda: rows(tmp_path) == 1, "the first row")
        pieces[0] = pieces[0].removeprefix(log[1])
        for k in order:
            client.publish("mast", pieces[k], qos=1)
        rounds(one, lambda: rows(tmp_path) == 1500, "the rows")
        counts, again = one.lives["mast"].follows.counts, one.counts["again"]
        client.disconnect()
        client.loop_stop()
    assert again == 2  # messages 9 and 8
    assert counts["late"] == 20  # 30, which came too late
    assert counts["filled"] == 60  # for 30, and for 50 and 51, which never came
    assert "jumps" not in counts
    table = np.loadtxt(tmp_path / "mast.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, 0], np.arange(1500) * 0.01, atol=1e-9)
    assert np.isfinite(table[:, [0, 1, 3]]).all()
    assert set(table[500:620, 6]) == {1.0, 2.0}  # settled, then open loop where nothing came
    assert np.isnan(table[table[:, 6] == 2, 2]).all()
    whole = np.loadtxt(undisturbed(tmp_path, log).splitlines(), delimiter=",", skiprows=1)
    calm = slice(1300, None)  # long after
    np.testing.assert_allclose(table[calm, 1], whole[calm, 1], atol=0.2 * np.std(whole[:, 1]))


def test_a_long_message_that_is_overtaken_is_no_clock_that_was_put_back(tmp_path: Path) -> None:
    """A message of more rows than show a clock that was put back, where it is one message alone."""
    tracker, Y = fitted()
    log = text(tracker, np.tile(Y, (5, 1)))
    pieces = [b"".join(log[k : k + 1200]) for k in range(1, 7201, 1200)]
    with Mosquitto(tmp_path) as broker, server(tmp_path, f"mqtt://127.0.0.1:{broker.port}/mast") as one:
        rounds(one, lambda: not one.feeds["mast"].down(), "the subscription")
        client = broker.client()
        for k in (0, 2, 1, 3, 4, 5):
            client.publish("mast", log[0] * (k == 0) + pieces[k], qos=1)
            rounds(one, lambda k=k: one.counts["messages"] > {0: 0, 2: 1, 1: 2}.get(k, k), "the message")  # type: ignore[misc]
        counts = one.lives["mast"].follows.counts
        client.disconnect()
        client.loop_stop()
    assert counts["late"] == counts["filled"] == 1200
    assert "jumps" not in counts
    times = np.loadtxt(tmp_path / "mast.csv", delimiter=",", skiprows=1)[:, 0]
    np.testing.assert_allclose(times, np.arange(7200) * 0.01, atol=1e-6)


def test_all_kinds_of_sinks_hold_the_same_rows(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    from pyarrow import parquet

    zmq, log, ports = pytest.importorskip("zmq"), lines(), [free_port(), free_port()]
    fitted()[0].save(tmp_path / "model.h5")
    (tmp_path / "log.csv").write_bytes(b"".join(log[:1001]))
    with Mosquitto(tmp_path) as broker:
        client, heard = broker.client(), list[bytes]()
        client.on_message = lambda own, data, message: heard.append(message.payload)
        client.subscribe("loads/mast", qos=1)
        (tmp_path / "plan.toml").write_text(
            'states = "states"\n[run]\nlatency = 0.005\n[[asset]]\nname = "mast"\nmodel = "model.h5"\n'
            'source = "log.csv"\nsinks = ["mast.csv", "mast.h5", "mast.parquet", '
            f'"tcp://127.0.0.1:{ports[0]}", "zmq://127.0.0.1:{ports[1]}/loads", '
            f'"mqtt://127.0.0.1:{broker.port}/loads/mast"]\n'
        )
        context = zmq.Context()
        subscriber = context.socket(zmq.SUB)
        subscriber.subscribe("loads")
        with Server(plan.read(tmp_path / "plan.toml")) as one:
            subscriber.connect(f"tcp://127.0.0.1:{ports[1]}")
            rounds(one, lambda: rows(tmp_path) == 1000, "the rows")
            one.lives["mast"].checkpoint()
            time.sleep(0.5)  # a publisher does not say who has subscribed
            with socket.create_connection(("127.0.0.1", ports[0])) as listener:
                waited(lambda: one.lives["mast"].sinks.counts["undelivered"] == 0, "nothing")
                with (tmp_path / "log.csv").open("ab") as file:
                    file.write(b"".join(log[1001:]))
                rounds(one, lambda: rows(tmp_path) == 1500, "more rows")
                one.lives["mast"].checkpoint()
                listener.settimeout(5)
                told = b""
                while told.count(b"\n") < 501:
                    told += listener.recv(1 << 16)
            waited(lambda: sum(part.count(b"\n") - 1 for part in heard) == 1500, "messages of the broker")
            published = b""
            while not published.partition(b"\n")[2].startswith(b"10.0,"):
                assert subscriber.poll(5000)
                published = subscriber.recv_multipart()[1]
        context.destroy(linger=0)
        client.disconnect()
        client.loop_stop()
    table = (tmp_path / "mast.csv").read_bytes()
    head, _, body = table.partition(b"\n")
    assert b"".join(part.partition(b"\n")[2] for part in heard) == body
    assert told == head + b"\n" + b"".join(body.splitlines(keepends=True)[1000:])
    assert published == told
    numbers = np.loadtxt(tmp_path / "mast.csv", delimiter=",", skiprows=1)
    parts = sorted((tmp_path / "mast.parquet").glob("*.parquet"))
    assert [path.name for path in parts] == ["part-000000000000.parquet", "part-000000001000.parquet"]
    columns = [parquet.read_table(path) for path in parts]
    names = [name.strip('"') for name in head.decode().split(",")]
    for k, name in enumerate(names):
        np.testing.assert_array_equal(np.concatenate([c[name].to_numpy() for c in columns]), numbers[:, k])
    with h5py.File(tmp_path / "mast.h5" / "part-000000001000.h5") as file:
        np.testing.assert_array_equal(file[names[1]][:], numbers[1000:, 1])


def test_a_part_that_a_kill_left_before_its_checkpoint_is_made_again_and_not_doubled(tmp_path: Path) -> None:
    log = lines()
    fitted()[0].save(tmp_path / "model.h5")
    (tmp_path / "log.csv").write_bytes(b"".join(log[:601]))
    (tmp_path / "plan.toml").write_text(
        'states = "states"\n[[asset]]\nname = "mast"\nmodel = "model.h5"\nsource = "log.csv"\nsinks = ["mast.h5"]\n'
    )
    with Server(plan.read(tmp_path / "plan.toml")) as one:
        rounds(one, lambda: one.lives["mast"].rows == 600, "the rows")
        one.lives["mast"].sinks.sync()  # and no checkpoint
    (tmp_path / "log.csv").write_bytes(b"".join(log))
    with Server(plan.read(tmp_path / "plan.toml")) as one:
        rounds(one, lambda: one.lives["mast"].rows == 1500, "the rows")
        one.lives["mast"].checkpoint()
    (part,) = (tmp_path / "mast.h5").iterdir()
    with h5py.File(part) as file:
        assert len(file["time [s]"]) == 1500


def test_a_port_that_is_taken_and_a_sink_that_is_none_are_refused(tmp_path: Path) -> None:
    with server(tmp_path, "log.csv") as one, socket.create_server(("127.0.0.1", 0)) as other:
        with pytest.raises(InputError, match="port cannot be had"):
            Endpoint(one, other.getsockname()[1])
        with pytest.raises(InputError, match="another run goes on"):
            server(tmp_path, "log.csv")
    (tmp_path / "mast.csv").write_text("mine\n")
    with pytest.raises(InputError, match=r"mast\.csv"):
        server(tmp_path, "log.csv")


def test_a_state_of_another_tracker_is_refused(tmp_path: Path) -> None:
    with server(tmp_path, "log.csv"):
        pass
    from tests.killed import fitted as another

    another(600)[0].save(tmp_path / "model.h5")
    with pytest.raises(InputError, match="state belongs to another tracker"):
        server(tmp_path, "log.csv")


def asked(address: str, **headers: str) -> tuple[int, str]:
    """Code and text of an answer."""
    try:
        with urlopen(Request(address, headers=headers), timeout=10) as answer:
            return answer.status, answer.read().decode()
    except HTTPError as error:
        with error:
            return error.code, error.read().decode()


def test_metrics_and_health(tmp_path: Path) -> None:
    log = lines()
    (tmp_path / "log.csv").write_bytes(b"".join(log))
    with server(tmp_path, "log.csv") as one, closing(Endpoint(one, 0)) as endpoint:
        rounds(one, lambda: rows(tmp_path) == 1500, "the rows")
        stop = threading.Event()
        thread = threading.Thread(target=one.go, args=(stop,))
        thread.start()
        code, text = asked(f"{endpoint.address}/metrics")
        assert code == 200
        code, words = asked(f"{endpoint.address}/health")
        assert code == 200
        state = json.loads(words)
        one.lives["mast"].halted = "a stream that cannot be read"
        code, words = asked(f"{endpoint.address}/health")
        assert code == 503
        assert json.loads(words)["halted"] == {"mast": "a stream that cannot be read"}
        assert asked(f"{endpoint.address}/")[0] == 404
        assert asked(f"{endpoint.address}/metrics", Host="evil.example")[0] == 403
        stop.set()
        thread.join()
        assert one.ask(lambda server: 1, patience=0.05) is None  # nobody goes round any more
    assert state["status"] == "ok"
    last = np.loadtxt(tmp_path / "mast.csv", delimiter=",", skiprows=1)[-1]
    found = {line.rpartition(" ")[0]: float(line.rpartition(" ")[2]) for line in text.splitlines() if line[0] != "#"}
    assert found['loadid_rows_total{structure="mast"}'] == 1500
    assert found['loadid_load{structure="mast",load="p0"}'] == last[1]
    assert found['loadid_load_std{structure="mast",load="p0"}'] == last[3]
    assert found['loadid_phase{structure="mast",phase="steady"}'] == 1
    assert text.count("# TYPE loadid_load gauge") == 1


def test_the_text_of_metrics_escapes_labels_and_says_no_numbers() -> None:
    text = exposition([("loadid_load", {"load": 'a"b\\c\nd'}, float("nan")), ("loadid_load", {}, float("inf"))])
    assert text.splitlines()[2:] == ['loadid_load{load="a\\"b\\\\c\\nd"} NaN', "loadid_load +Inf"]


def test_metrics_of_a_server_that_has_seen_nothing(tmp_path: Path) -> None:
    with server(tmp_path, "log.csv") as one:
        names = {name for name, _, _ in samples(one)}
    assert "loadid_load" not in names
    assert "loadid_up" in names


def test_the_command_goes_until_it_is_told_and_goes_on(tmp_path: Path) -> None:
    log = lines()
    with server(tmp_path, "log.csv"):
        pass
    port = free_port()
    text = (tmp_path / "plan.toml").read_text()
    (tmp_path / "plan.toml").write_text(text.replace("[run]", f"[run]\nhttp = {port}"))
    words = [sys.executable, "-m", "loadid.cli", "serve", str(tmp_path / "plan.toml"), "--json"]
    for end in (701, 1501):
        (tmp_path / "log.csv").write_bytes(b"".join(log[:end]))
        process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        waited(lambda end=end: rows(tmp_path) == end - 1, "the rows")  # type: ignore[misc]
        assert health(port)["status"] == "ok"
        os.kill(process.pid, signal.SIGTERM)
        answer = json.loads(process.communicate(timeout=30)[0])
        assert process.returncode == 0
        assert answer["counts"]["samples"] == end - 1
    assert answer["rows"] == 800
    assert (tmp_path / "mast.csv").read_bytes() == undisturbed(tmp_path, log)


def test_the_command_says_what_it_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with server(tmp_path, "log.csv"):
        pass
    assert command(["serve", str(tmp_path / "plan.toml"), "--idle", "0"]) == 0
    assert "no source: mast: No such file or directory" in capsys.readouterr().out
    assert command(["serve", str(tmp_path / "plan.toml"), "--idle", "0", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    (tmp_path / "log.csv").write_bytes(b"time,a0\n1,2\n")
    assert command(["serve", str(tmp_path / "plan.toml"), "--idle", "0.1"]) == 3
    assert "halted: mast" in capsys.readouterr().out
    assert command(["serve", str(tmp_path / "absent.toml")]) == 3
