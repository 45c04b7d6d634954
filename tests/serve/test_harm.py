"""What goes wrong with one structure, source or listener, and does the others no harm."""

from __future__ import annotations

import socket
import time
from pathlib import Path
from typing import Any

import pytest

from loadid._serve import plan
from loadid._serve.metrics import health
from loadid._serve.server import Server

from .broker import Mosquitto, free_port, waited
from .served import fitted, lines, rounds, rows, server


def two(folder: Path, sources: tuple[str, str], sinks: str = '"{name}.csv"') -> plan.Plan:
    """A plan of two structures, ``mast`` and ``roof``."""
    fitted()[0].save(folder / "model.h5")
    (folder / "plan.toml").write_text(
        f'states = "states"\n[run]\nlatency = 0.005\n[every]\nmodel = "model.h5"\nsinks = [{sinks}]\n'
        f'[[asset]]\nname = "mast"\nsource = "{sources[0]}"\n[[asset]]\nname = "roof"\nsource = "{sources[1]}"\n'
    )
    return plan.read(folder / "plan.toml")


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
