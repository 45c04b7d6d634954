"""A real MQTT broker on the loopback, and servers that are killed while it goes on."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import threading
import time
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest

from loadid._families.tracking import tracker as checkpoint
from loadid._stream.following import Following
from loadid._stream.output import Output
from tests.killed import Nursery, fitted, text

BROKER = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/usr/local/sbin")


PAUSE, ROWS = 0.02, 4  # s between messages, rows of each


def free_port() -> int:
    """A port of the loopback that nobody has."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


class Mosquitto:
    """The broker, which keeps its sessions in its memory."""

    def __init__(self, folder: Path) -> None:
        if BROKER is None:
            pytest.skip("no mosquitto on this machine")
        self.port = free_port()
        (folder / "mosquitto.conf").write_text(
            f"listener {self.port} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 0\n"
        )
        self.process = subprocess.Popen([BROKER, "-c", str(folder / "mosquitto.conf")], stderr=subprocess.DEVNULL)
        waited(lambda: _answers(self.port), "the broker")

    def __enter__(self) -> Mosquitto:
        return self

    def __exit__(self, *exc: object) -> None:
        self.process.kill()
        self.process.wait(10)

    def client(self) -> Any:
        """Somebody who publishes, or listens."""
        mqtt = pytest.importorskip("paho.mqtt.client")
        made = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
        made.connect("127.0.0.1", self.port)
        made.loop_start()
        return made


def _answers(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), 1).close()
    except OSError:
        return False
    return True


def waited(done: Any, what: str, seconds: float = 60.0) -> None:
    """Until something is so."""
    until = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < until, f"waited in vain for {what}"
        time.sleep(0.002)


def tortured(folder: Path, kills: int, *, seed: int = 0) -> dict[str, Any]:
    """Two structures behind a broker, one with time stamps and one without, their server killed at random.

    Returns
    -------
    dict
        ``same``: for each structure whether its table is that of an undisturbed run over the same rows, byte for byte;
        ``rows`` of each; ``sent`` to each.
    """
    tracker, Y = fitted(1500)
    Y = np.resize(Y, (400 * (kills + 2), Y.shape[1]))
    tracker.save(folder / "model.h5")
    lines = {"stamped": text(tracker, Y), "bare": text(tracker, Y, stamps=False)}
    nursery, rng = (
        Nursery("loadid._serve.server", "loadid._serve.metrics", "paho.mqtt.client"),
        np.random.default_rng(seed),
    )
    with Mosquitto(folder) as broker:
        plan, port = folder / "plan.toml", free_port()
        plan.write_text(
            f'states = "states"\n[run]\nlatency = 0.005\ncheckpoint = 0.2\nhttp = {port}\n[every]\nmodel = "model.h5"\n'
            f'source = "mqtt://127.0.0.1:{broker.port}/{{name}}"\nsinks = ["{{name}}.csv"]\n'
            '[[asset]]\nname = "stamped"\n[[asset]]\nname = "bare"\n'
        )
        client, sent, over = broker.client(), [], threading.Event()

        def publish() -> None:
            """Messages of a few rows of both, whatever happens to the server."""
            for a in range(0, len(Y), ROWS):
                for name, own in lines.items():
                    sent.append(client.publish(name, own[0] * (a == 0) + b"".join(own[1 + a : 1 + a + ROWS]), qos=1))
                time.sleep(PAUSE)
                if over.is_set():
                    return

        nursery.run("serve", str(plan))
        waited(lambda: health(port).get("status") == "ok", "the subscriptions")
        thread = threading.Thread(target=publish)
        thread.start()
        for _ in range(kills):
            size = _size(folder)
            waited(lambda size=size: _size(folder) > size, "a row")  # type: ignore[misc]
            time.sleep(float(rng.uniform(0, 0.05)))
            os.kill(nursery.process_id, signal.SIGKILL)
            assert nursery.ended() == -signal.SIGKILL
            nursery.run("serve", str(plan))
        over.set()
        thread.join()
        for message in sent:
            message.wait_for_publish(20)
        total = len(sent) // 2 * ROWS
        waited(lambda: all(_rows(folder / f"{name}.csv") >= total for name in lines), "the last row", 120)
        waited(lambda: health(port).get("status") == "ok", "the last start")  # who starts does not hear a signal yet
        time.sleep(0.3)  # nothing more
        os.kill(nursery.process_id, signal.SIGTERM)
        assert (code := nursery.ended()) == 0, f"ended with {code}"
        client.disconnect()
        client.loop_stop()
    nursery.close()
    same = {}
    for name, own in lines.items():
        whole = straight(folder / "model.h5", b"".join(own[: 1 + total]), folder / f"{name}.straight")
        same[name] = whole == (folder / f"{name}.csv").read_bytes()
    return {"same": same, "rows": {name: _rows(folder / f"{name}.csv") for name in lines}, "sent": total}


def straight(model: Path, data: bytes, table: Path) -> bytes:
    """Table of an undisturbed run over a log, written to a new file."""
    tracker = checkpoint.load(model)
    follows = Following(tracker, told=True)
    output = Output(str(table), follows.head)
    follows.take(*follows.lines.push(data), output)
    output.close()
    return table.read_bytes()


def health(port: int) -> dict[str, Any]:
    """What a server says of itself; nothing where there is none."""
    try:
        with urlopen(f"http://127.0.0.1:{port}/health", timeout=5) as answer:
            return dict(json.load(answer))
    except HTTPError as error:
        with error:
            return dict(json.load(error))
    except OSError:
        return {}


def _rows(path: Path) -> int:
    return path.read_bytes().count(b"\n") - 1 if path.exists() else 0


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.glob("*.csv"))
