"""Files, sockets and brokers as sources of a server: every row once, whatever happens to either side."""

from __future__ import annotations

import socket
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from loadid._serve.server import Server

from .broker import Mosquitto, free_port, waited
from .served import fitted, lines, rounds, rows, server, undisturbed


def accepted(one: Server, listening: socket.socket) -> socket.socket:
    """The connection that a server makes."""
    found: list[socket.socket] = []
    listening.setblocking(False)

    def tried() -> bool:
        with suppress(BlockingIOError):
            found.append(listening.accept()[0])
        return bool(found)

    rounds(one, tried, "the connection")
    return found[0]


def test_a_file_that_comes_later_and_grows(tmp_path: Path) -> None:
    log = lines()
    with server(tmp_path, "log.csv") as one:
        one.round()
        assert "mast" in one.feeds["mast"].down()
        (tmp_path / "log.csv").write_bytes(b"".join(log[:600]))
        rounds(one, lambda: rows(tmp_path) == 599, "the rows")
        assert not one.feeds["mast"].down()
        one.lives["mast"].checkpoint()
        with (tmp_path / "log.csv").open("ab") as file:
            file.write(b"".join(log[600:800]) + log[800][:9])
        rounds(one, lambda: rows(tmp_path) == 799, "more rows")
    with server(tmp_path, "log.csv") as one:  # as after a kill: behind the table by 200 rows
        with (tmp_path / "log.csv").open("ab") as file:
            file.write(log[800][9:] + b"".join(log[801:]))
        rounds(one, lambda: rows(tmp_path) == 1500, "the rest")
    assert (tmp_path / "mast.csv").read_bytes() == undisturbed(tmp_path, log)


def test_what_came_by_a_socket_before_a_kill_is_made_again_from_the_journal(tmp_path: Path) -> None:
    log = lines()
    with socket.create_server(("127.0.0.1", 0)) as listening:
        address = f"tcp://127.0.0.1:{listening.getsockname()[1]}"
        for begin, end in ((0, 501), (501, 1001), (1001, 1501)):
            with server(tmp_path, address) as one:  # nothing but the first state is saved: killed at the end
                with accepted(one, listening) as made:
                    made.sendall(b"".join(([] if begin == 0 else log[:1]) + log[begin:end]))
                    rounds(one, lambda end=end: rows(tmp_path) == end - 1, "the rows")  # type: ignore[misc]
                assert one.lives["mast"].reached == 0
    assert (tmp_path / "mast.csv").read_bytes() == undisturbed(tmp_path, log)


def test_a_lost_connection_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("loadid._serve.inputs.SOONEST", 0.01)
    log = lines()
    with (
        socket.create_server(("127.0.0.1", 0)) as listening,
        server(tmp_path, f"tcp://127.0.0.1:{listening.getsockname()[1]}") as one,
    ):
        for begin, end in ((0, 501), (301, 1501)):  # repeats itself, as senders do
            with accepted(one, listening) as made:
                made.sendall(b"".join((log[:1] if begin else []) + log[begin:end]))
                rounds(one, lambda end=end: rows(tmp_path) == end - 1, "the rows")  # type: ignore[misc]
            rounds(one, lambda: bool(one.feeds["mast"].down()), "the end of the connection")
        assert one.lives["mast"].follows.counts["again"] == 200
        assert one.feeds["mast"].counts["lost"] == 2
    assert (tmp_path / "mast.csv").read_bytes() == undisturbed(tmp_path, log)


def test_messages_of_a_publisher(tmp_path: Path) -> None:
    zmq, log, port = pytest.importorskip("zmq"), lines(), free_port()
    context = zmq.Context()
    publisher = context.socket(zmq.XPUB)  # which hears of subscriptions
    publisher.bind(f"tcp://127.0.0.1:{port}")
    with server(tmp_path, f"zmq://127.0.0.1:{port}/shm/mast") as one:
        rounds(one, lambda: not one.feeds["mast"].down(), "the connection")
        assert publisher.poll(10_000)
        assert publisher.recv() == b"\x01shm/mast"
        for begin in range(0, len(log), 100):
            publisher.send_multipart([b"shm/mast", b"".join(log[begin : begin + 100])])
            publisher.send_multipart([b"shm/mast2", b"1,2,3"])  # of another structure, with a topic that begins alike
        rounds(one, lambda: rows(tmp_path) == 1500, "the rows")
        assert one.feeds["mast"].counts["refused"] > 0
    context.destroy(linger=0)
    assert (tmp_path / "mast.csv").read_bytes() == undisturbed(tmp_path, log)


def test_offsets_of_a_cluster_stand_in_the_checkpoint(tmp_path: Path) -> None:
    kafka, log = pytest.importorskip("confluent_kafka"), lines()
    producer = kafka.Producer({"bootstrap.servers": "127.0.0.1:1", "test.mock.num.brokers": 1, "log_level": 0})
    broker = next(iter(producer.list_topics(timeout=10).brokers.values()))
    address = f"kafka://{broker.host}:{broker.port}/mast"

    def produce(begin: int, end: int) -> None:
        for k in range(begin, end, 50):
            producer.produce("mast", b"".join(log[k : min(k + 50, end)]), partition=0)
        assert producer.flush(10) == 0

    produce(0, 601)
    with server(tmp_path, address) as one:
        rounds(one, lambda: rows(tmp_path) == 600, "the rows")
        one.lives["mast"].checkpoint()
        produce(601, 901)
        rounds(one, lambda: rows(tmp_path) == 900, "more rows")
        assert one.journal.size == 0  # the cluster keeps it
    produce(901, 1501)
    with server(tmp_path, address) as one:
        rounds(one, lambda: rows(tmp_path) == 1500, "the rest")
    assert (tmp_path / "mast.csv").read_bytes() == undisturbed(tmp_path, log)


def test_a_message_is_confirmed_after_its_rows_are_in_the_table(tmp_path: Path) -> None:
    log = lines()
    with Mosquitto(tmp_path) as broker, server(tmp_path, f"mqtt://127.0.0.1:{broker.port}/mast") as one:
        feed: Any = one.feeds["mast"]
        confirmed: list[int] = []
        real = feed._client.ack
        feed._client.ack = lambda mid, qos: (confirmed.append(rows(tmp_path)), real(mid, qos))
        waited(lambda: not feed.down(), "the subscription")
        client = broker.client()
        for begin in range(0, 501, 100):
            client.publish("mast", b"".join(log[begin : begin + 100]), qos=1)
        client.publish("nobody", b"x", qos=1)
        rounds(one, lambda: rows(tmp_path) == 599, "the rows")
        client.disconnect()
        client.loop_stop()
        assert len(confirmed) == 6
        assert confirmed == sorted(confirmed)
        assert confirmed[-1] == 599
        assert min(confirmed) >= 99


def test_a_lost_broker_is_found_again_and_nothing_is_doubled(tmp_path: Path) -> None:
    log = lines()
    with Mosquitto(tmp_path) as broker, server(tmp_path, f"mqtt://127.0.0.1:{broker.port}/mast") as one:
        feed: Any = one.feeds["mast"]
        waited(lambda: not feed.down(), "the subscription")
        client = broker.client()
        for begin in range(0, 1501, 20):
            client.publish("mast", b"".join(log[begin : begin + 20]), qos=1)
            one.round()
            if begin % 200 == 100 and (there := feed._client.socket()) is not None:
                with suppress(OSError):  # it is broken already
                    there.shutdown(socket.SHUT_RDWR)  # what was not confirmed comes again
        rounds(one, lambda: rows(tmp_path) >= 1500, "the rows")
        client.disconnect()
        client.loop_stop()
        assert feed.counts["lost"] > 0
    assert (tmp_path / "mast.csv").read_bytes() == undisturbed(tmp_path, log)


@pytest.mark.parametrize("scheme", ["mqtt", "zmq", "kafka"])
def test_a_client_library_that_is_not_there_is_asked_for(
    tmp_path: Path, scheme: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from loadid._serve import brokers
    from structures.errors import InputError

    whole = brokers.importlib.import_module

    def missing(module: str) -> Any:
        if not module.startswith("loadid"):  # compiled loops are read by the same function
            raise ImportError(module)
        return whole(module)

    fitted()
    monkeypatch.setattr(brokers.importlib, "import_module", missing)
    with pytest.raises(InputError, match=r"pip install 'loadid\[brokers\]'"):
        server(tmp_path, f"{scheme}://127.0.0.1:1/mast")


def test_a_broker_that_is_not_there_is_said(tmp_path: Path) -> None:
    pytest.importorskip("paho.mqtt.client")
    with server(tmp_path, f"mqtt://127.0.0.1:{free_port()}/mast") as one:
        feed = one.feeds["mast"]
        waited(lambda: "nobody answers" in feed.down()["mast"], "the word")


def test_a_sender_that_is_not_there_is_said_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("loadid._serve.inputs.SOONEST", 0.01)
    fitted()
    with server(tmp_path, f"tcp://127.0.0.1:{free_port()}") as one:
        feed = one.feeds["mast"]
        waited(lambda: feed.take() == [] and "refused; tried again" in caplog.text, "the word")
        waited(lambda: feed.take() == [] and one.feeds["mast"]._lines["mast"].wait >= 0.08, "more tries")
        assert "connection refused" in feed.down()["mast"]
        assert caplog.text.count("no connection to") == 1
