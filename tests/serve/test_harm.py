"""What goes wrong with one structure, source or listener, and does the others no harm."""

from __future__ import annotations

import os
import socket
import threading
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import h5py
import pytest

from loadid._serve import plan
from loadid._serve.live import LiveStructure
from loadid._serve.metrics import Endpoint, health
from loadid._serve.server import Server
from loadid._stream.following import Following
from loadid.cli import main as command
from structures.errors import InputError

from .broker import Mosquitto, free_port, waited
from .served import fitted, lines, rounds, rows, server, undisturbed


def two(folder: Path, sources: tuple[str, str], sinks: str = '"{name}.csv"') -> plan.ServePlan:
    """A plan of two structures, ``mast`` and ``roof``."""
    fitted()[0].save(folder / "model.h5")
    (folder / "plan.toml").write_text(
        f'states = "states"\n[run]\nlatency = 0.005\n[every]\nmodel = "model.h5"\nsinks = [{sinks}]\n'
        f'[[asset]]\nname = "mast"\nsource = "{sources[0]}"\n[[asset]]\nname = "roof"\nsource = "{sources[1]}"\n'
    )
    return plan.read(folder / "plan.toml")


def test_an_error_that_nobody_expected_halts_one_structure_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, asked = lines(), two(tmp_path, ("mast.log", "roof.log"))
    for name in ("mast", "roof"):
        (tmp_path / f"{name}.log").write_bytes(b"".join(log))
    with Server(asked) as one, monkeypatch.context() as patch:
        broken, real = one.lives["mast"].follows, Following.take

        def take(self: Following, *words: Any) -> int:
            if self is broken:
                raise ZeroDivisionError("float division by zero")
            return real(self, *words)

        patch.setattr(Following, "take", take)
        rounds(one, lambda: rows(tmp_path, "roof.csv") == 1500, "the rows")
        assert health(one)["halted"] == {"mast": "ZeroDivisionError: float division by zero"}
        assert rows(tmp_path) <= 0
    with Server(asked) as one:
        rounds(one, lambda: rows(tmp_path) == 1500, "the rows")
    assert (tmp_path / "mast.csv").read_bytes() == undisturbed(tmp_path, log)


def test_a_file_that_fails_is_down_alone_and_comes_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log, asked = lines(), two(tmp_path, ("mast.log", "roof.log"))
    for name in ("mast", "roof"):
        (tmp_path / f"{name}.log").write_bytes(b"".join(log))
    with Server(asked) as one:
        feed: Any = one.feeds["mast"]
        one.round()
        with monkeypatch.context() as patch:
            real = Path.open

            def opened(self: Path, *words: Any, **settings: Any) -> Any:
                if self.name == "mast.log":
                    raise PermissionError(13, "Permission denied")
                return real(self, *words, **settings)

            (tmp_path / "next").write_bytes(b"")
            os.replace(tmp_path / "next", tmp_path / "mast.log")
            patch.setattr(Path, "open", opened)
            rounds(one, lambda: rows(tmp_path, "roof.csv") == 1500, "the rows of the other")
            assert "Permission denied" in health(one)["disconnected"]["mast"]
        rounds(one, lambda: not feed.down(), "the file")
        (tmp_path / "mast.log").unlink()
        one.round()
        assert "mast" in health(one)["disconnected"]
    assert rows(tmp_path) == 1500


def test_a_new_file_behind_one_that_was_broken_off_is_gone_on_with(tmp_path: Path) -> None:
    log = lines()
    (tmp_path / "log.csv").write_bytes(b"".join(log[:601]) + log[601][:20])
    with server(tmp_path, "log.csv") as one:
        rounds(one, lambda: rows(tmp_path) == 600, "the rows")
        os.replace(tmp_path / "log.csv", tmp_path / "log.csv.1")
        (tmp_path / "log.csv").write_bytes(b"")
        one.round()
        one.lives["mast"].checkpoint()
    with server(tmp_path, "log.csv") as one:
        one.round()
        (tmp_path / "log.csv").write_bytes(b"".join([log[0], *log[601:]]))
        rounds(one, lambda: rows(tmp_path) == 1500, "the rows")
    assert (tmp_path / "mast.csv").read_bytes() == undisturbed(tmp_path, log)


def test_a_new_file_whose_time_begins_again_is_tracked_as_by_track(tmp_path: Path) -> None:
    log = lines()
    (tmp_path / "log.csv").write_bytes(b"".join(log[:801]))
    with server(tmp_path, "log.csv") as one:
        rounds(one, lambda: rows(tmp_path) == 800, "the rows")
        os.replace(tmp_path / "log.csv", tmp_path / "log.csv.1")
        (tmp_path / "log.csv").write_bytes(b"".join(log[:501]))
        rounds(one, lambda: not one.round(), "the second file")
        assert "again" not in one.lives["mast"].follows.counts
        assert one.lives["mast"].rows >= 1300 - 1


def test_a_kill_between_the_first_table_and_the_first_state_locks_nobody_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = lines()
    (tmp_path / "log.csv").write_bytes(b"".join(log))
    fitted()[0].save(tmp_path / "model.h5")
    with monkeypatch.context() as patch:

        def killed(*words: Any) -> None:
            raise SystemExit

        patch.setattr("loadid._serve.live.checkpoint.save", killed)
        with pytest.raises(SystemExit):
            server(tmp_path, "log.csv")
    with server(tmp_path, "log.csv") as one:
        rounds(one, lambda: rows(tmp_path) == 1500, "the rows")
    assert (tmp_path / "mast.csv").read_bytes() == undisturbed(tmp_path, log)


def test_parts_that_no_state_knows_are_not_written_over(tmp_path: Path) -> None:
    asked = two(tmp_path, ("mast.log", "roof.log"), '"{name}.h5"')
    (tmp_path / "mast.log").write_bytes(b"".join(lines()))
    with Server(asked) as one:
        rounds(one, lambda: one.lives["mast"].rows == 1500, "the rows")
        one.lives["mast"].checkpoint()
    (tmp_path / "states" / "mast.h5").unlink()
    with pytest.raises(InputError, match="no state says"):
        Server(asked)
    (part,) = (tmp_path / "mast.h5").iterdir()
    with h5py.File(part) as file:
        assert len(file["time [s]"]) == 1500


def test_a_message_that_is_too_large_for_a_cluster_is_counted(tmp_path: Path) -> None:
    kafka = pytest.importorskip("confluent_kafka")
    from loadid._serve.brokers import KafkaOut
    from loadid._serve.plan import Address

    producer = kafka.Producer({"bootstrap.servers": "127.0.0.1:1", "test.mock.num.brokers": 1, "log_level": 0})
    broker = next(iter(producer.list_topics(timeout=10).brokers.values()))
    out = KafkaOut(Address("kafka", "loads", broker.host, broker.port))
    out.send("loads", bytes(4 << 20))
    assert out.counts["undelivered"] == 1
    out.close()


def test_a_cluster_that_is_not_there_holds_nobody_up(tmp_path: Path) -> None:
    pytest.importorskip("confluent_kafka")
    asked = two(tmp_path, (f"kafka://127.0.0.1:{free_port()}/mast", "roof.log"))
    with Server(asked) as one:
        begun = time.monotonic()
        for _ in range(3):
            one.round()
        assert time.monotonic() - begun < 1.0
        assert "mast" in health(one)["disconnected"]


def test_many_messages_that_were_not_confirmed_are_known_again(tmp_path: Path) -> None:
    log = lines(stamps=False)
    with Mosquitto(tmp_path) as broker:
        source = f"mqtt://127.0.0.1:{broker.port}/mast"
        client = broker.client()
        with server(tmp_path, source) as one:
            waited(lambda: not one.feeds["mast"].down(), "the subscription")
        sent = [client.publish("mast", line, qos=1) for line in log for _ in range(3)][-1]
        sent.wait_for_publish(20)
        with server(tmp_path, source) as one:
            feed: Any = one.feeds["mast"]
            feed.confirm = lambda pieces: None  # killed before
            until = time.monotonic() + 2
            while time.monotonic() < until:
                one.round()
        with server(tmp_path, source) as one:
            rounds(one, lambda: one.lives["mast"].serial >= 3 * len(log), "all messages")
            for _ in range(100):
                one.round()
                time.sleep(0.005)
            assert one.lives["mast"].serial == 3 * len(log)
        client.disconnect()
        client.loop_stop()


def test_what_came_by_a_lost_connection_is_not_confirmed_to_the_next(tmp_path: Path) -> None:
    with Mosquitto(tmp_path) as broker, server(tmp_path, f"mqtt://127.0.0.1:{broker.port}/mast") as one:
        feed: Any = one.feeds["mast"]
        confirmed: list[int] = []
        real = feed._client.ack
        feed._client.ack = lambda mid, qos: (confirmed.append(mid), real(mid, qos))
        waited(lambda: not feed.down(), "the subscription")
        client = broker.client()
        client.publish("mast", lines()[0], qos=1).wait_for_publish(10)
        waited(lambda: feed._queue.qsize() == 1, "the message")
        feed._client.socket().shutdown(socket.SHUT_RDWR)
        waited(lambda: feed._queue.qsize() == 2, "the same again")
        one.round()
        assert len(confirmed) == 1
        client.disconnect()
        client.loop_stop()


def test_a_message_that_a_broker_retains_comes_once(tmp_path: Path) -> None:
    log = lines(stamps=False)
    with Mosquitto(tmp_path) as broker, server(tmp_path, f"mqtt://127.0.0.1:{broker.port}/mast") as one:
        feed: Any = one.feeds["mast"]
        client = broker.client()
        client.publish("mast", b"".join(log[:11]), qos=1, retain=True).wait_for_publish(10)
        rounds(one, lambda: rows(tmp_path) == 10, "the rows")
        feed._client.socket().shutdown(socket.SHUT_RDWR)
        rounds(one, lambda: bool(feed.down()), "the loss")
        rounds(one, lambda: not feed.down(), "the connection")
        client.publish("mast", log[11], qos=1).wait_for_publish(10)
        rounds(one, lambda: rows(tmp_path) >= 11, "a row more")
        assert rows(tmp_path) == 11
        client.disconnect()
        client.loop_stop()


def test_a_topic_that_was_refused_stays_so(tmp_path: Path) -> None:
    address = f"mqtt://127.0.0.1:{free_port()}"
    with Server(two(tmp_path, (f"{address}/mast", f"{address}/roof"))) as one:
        feed: Any = one.feeds["mast"]

        class Reason:
            def __init__(self, is_failure: bool) -> None:
                self.is_failure = is_failure

            def __str__(self) -> str:
                return "Not authorized"

        feed._asked = {1: "mast", 2: "roof"}
        feed._granted(None, None, 1, [Reason(True)], None)
        feed._granted(None, None, 2, [Reason(False)], None)
        assert set(feed.down()) == {"mast"}
        assert "Not authorized" in feed.down()["mast"]


def test_a_check_ends_though_the_stream_goes_on(tmp_path: Path) -> None:
    log = lines()
    (tmp_path / "log.csv").write_bytes(log[0])
    with server(tmp_path, "log.csv"):
        pass
    over = threading.Event()

    def grow() -> None:
        with (tmp_path / "log.csv").open("ab") as file:
            for line in log[1:]:
                file.write(line)
                file.flush()
                if over.wait(0.02):
                    return

    thread = threading.Thread(target=grow)
    thread.start()
    begun = time.monotonic()
    assert command(["serve", str(tmp_path / "plan.toml"), "--check"]) == 0
    over.set()
    thread.join()
    assert time.monotonic() - begun < 15


def test_a_port_takes_no_more_listeners_than_it_can_serve(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("loadid._serve.sinks.LISTENERS", 3, raising=False)
    port, log = free_port(), lines()
    (tmp_path / "mast.log").write_bytes(b"".join(log))
    asked = two(tmp_path, ("mast.log", "roof.log"), '"{name}.csv"')
    text = (tmp_path / "plan.toml").read_text()
    (tmp_path / "plan.toml").write_text(text.replace(
        'source = "mast.log"', f'source = "mast.log"\nsinks = ["mast.csv", "tcp://127.0.0.1:{port}"]'))  # fmt: skip
    asked = plan.read(tmp_path / "plan.toml")
    with Server(asked) as one:
        there = [socket.create_connection(("127.0.0.1", port)) for _ in range(8)]
        rounds(one, lambda: rows(tmp_path) == 1500, "the rows")
        assert one.lives["mast"].sinks.counts["undelivered"] == 5
        for made in there:
            made.close()


def test_who_leaves_before_the_answer_leaves_no_traceback(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with server(tmp_path, "log.csv") as one, closing(Endpoint(one, 0)) as endpoint:
        where = endpoint.address.removeprefix("http://").split(":")
        for _ in range(3):
            with socket.create_connection((where[0], int(where[1]))) as made:
                made.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")
                made.sendall(b"GET /health HTTP/1.0\r\nHost: localhost\r\n\r\n")
                waited(lambda: one._answers, "the question")
            one._answer()
        time.sleep(0.3)
    assert "Traceback" not in capfd.readouterr().err


def test_what_came_for_a_halted_structure_is_heard(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_bytes(b"time,a0\n1,2\n")
    with server(tmp_path, "log.csv") as one:
        rounds(one, lambda: bool(one.lives["mast"].halted), "the halt")
        before = one.lives["mast"].last.heard
        with (tmp_path / "log.csv").open("ab") as file:
            file.write(b"1,2\n")
        one.round()
        assert one.lives["mast"].last.heard > before


def test_what_a_kill_left_of_a_checkpoint_is_swept(tmp_path: Path) -> None:
    with server(tmp_path, "log.csv"):
        pass
    left = tmp_path / "states" / ".mast.h5.0123456789ab.tmp"
    left.touch()
    with server(tmp_path, "log.csv"):
        assert not left.exists()


def test_a_table_that_cannot_be_synced_is_an_error_in_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "log.csv").write_bytes(b"".join(lines()))

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    with server(tmp_path, "log.csv") as one:
        one.round()
        live: LiveStructure = one.lives["mast"]
        with monkeypatch.context() as patch:
            patch.setattr("loadid._stream.output.os.fsync", full)
            with pytest.raises(InputError, match="output cannot be written"):
                live.checkpoint()


def test_a_long_journal_is_tracked_a_piece_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("loadid._serve.server.HELD", 20_000, raising=False)
    log = lines()
    with Mosquitto(tmp_path) as broker:
        source = f"mqtt://127.0.0.1:{broker.port}/mast"
        with server(tmp_path, source) as one:  # killed at its end
            waited(lambda: not one.feeds["mast"].down(), "the subscription")
            client = broker.client()
            for begin in range(0, 1501, 50):
                client.publish("mast", b"".join(log[begin : begin + 50]), qos=1)
            rounds(one, lambda: rows(tmp_path) == 1500, "the rows")
            client.disconnect()
            client.loop_stop()
        most, real = [], LiveStructure.take
        monkeypatch.setattr(
            LiveStructure, "take", lambda self, own: (most.append(sum(len(e.data) for e in own)), real(self, own))[1]
        )
        with server(tmp_path, source) as one:
            assert one.lives["mast"].rows == 1500
    assert len(most) > 3
    assert max(most) < 30_000
    assert (tmp_path / "mast.csv").read_bytes() == undisturbed(tmp_path, log)


def test_a_pipe_is_no_file_that_grows_and_holds_nobody_up(tmp_path: Path) -> None:
    asked = two(tmp_path, ("mast.log", "roof.log"))
    os.mkfifo(tmp_path / "mast.log")
    (tmp_path / "roof.log").write_bytes(b"".join(lines()))
    held = threading.Timer(10, lambda: os.close(os.open(tmp_path / "mast.log", os.O_WRONLY | os.O_NONBLOCK)))
    held.daemon = True
    held.start()
    with Server(asked) as one:
        begun = time.monotonic()
        rounds(one, lambda: rows(tmp_path, "roof.csv") == 1500, "the rows of the other")
        held.cancel()
        assert time.monotonic() - begun < 8
        assert "no file that grows" in health(one)["disconnected"]["mast"]


def test_a_source_of_another_name_may_repeat_itself_and_a_table_that_was_moved_is_known(tmp_path: Path) -> None:
    log = lines()
    (tmp_path / "log.csv").write_bytes(b"".join(log[:801]))
    with server(tmp_path, "log.csv") as one:
        rounds(one, lambda: rows(tmp_path) == 800, "the rows")
        one.lives["mast"].checkpoint()
    (tmp_path / "other.csv").write_bytes(b"".join(log))
    (tmp_path / "mast.csv").rename(tmp_path / "moved.csv")
    text = (tmp_path / "plan.toml").read_text().replace('"mast.csv"', '"moved.csv"').replace("log.csv", "other.csv")
    (tmp_path / "plan.toml").write_text(text)
    with Server(plan.read(tmp_path / "plan.toml")) as one:
        rounds(one, lambda: rows(tmp_path, "moved.csv") >= 1500, "the rows")
        assert one.lives["mast"].follows.counts["again"] == 800
    assert (tmp_path / "moved.csv").read_bytes() == undisturbed(tmp_path, log)


def test_a_port_of_a_name_with_two_addresses_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("loadid._serve.inputs.SOONEST", 0.01)
    real = socket.getaddrinfo
    monkeypatch.setattr(
        "loadid._serve.inputs.socket.getaddrinfo",
        lambda host, port, **own: real("127.0.0.2", port, **own) + real("127.0.0.1", port, **own),
    )
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
        with server(tmp_path, f"tcp://somewhere:{port}") as one:
            rounds(one, lambda: not one.feeds["mast"].down(), "the connection")


def test_more_messages_than_a_broker_sends_at_once_do_not_wait_for_the_latency(tmp_path: Path) -> None:
    log, stop = lines(), threading.Event()
    with Mosquitto(tmp_path) as broker, server(tmp_path, f"mqtt://127.0.0.1:{broker.port}/mast", latency=30) as one:
        waited(lambda: not one.feeds["mast"].down(), "the subscription")
        thread = threading.Thread(target=one.go, args=(stop,))
        thread.start()
        client = broker.client()
        for line in log:
            client.publish("mast", line, qos=1)
        try:
            waited(lambda: rows(tmp_path) >= 1000, "the rows", 15)
        finally:
            stop.set()
            thread.join()
            client.disconnect()
            client.loop_stop()
