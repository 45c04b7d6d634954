"""Messages of brokers, in and out: MQTT, ZeroMQ, Kafka. Each by its own client library, which is asked for by name.

A message is lines of a stream: rows, or a line of names with units and rows. What was confirmed is never lost, and
what a broker sends twice is known again:

    MQTT     quality of service 1 in a session that lasts; a message is confirmed when its answers are in their tables,
             and known again by its number and its content where the broker marks it as sent before
    Kafka    offsets are kept in the checkpoints, and committed after them; a run begins where its checkpoint stands
    ZeroMQ   nothing is confirmed and nothing is sent twice
"""

from __future__ import annotations

import hashlib
import importlib
import logging
import queue
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any

from structures.errors import InputError

from .inputs import Feed, Received
from .plan import Address, LiveAsset

RECENT = 1000  # messages by which one that is sent twice is known again
ROUND = 4 << 20  # bytes of a broker that are tracked in one round, or a message more
QUEUED = 10_000  # messages between the network and the tracker: then the network waits
FEW = 500  # messages of a cluster in one round
KEPT = 86_400 * 30  # s for which a broker keeps the session of a server that is away
WAIT = 5.0  # s for messages to leave at the end
EXTRAS = {"paho.mqtt.client": "paho-mqtt", "zmq": "pyzmq", "confluent_kafka": "confluent-kafka"}
log = logging.getLogger(__name__)


def required(module: str, address: Address) -> Any:
    """A client library.

    Raises
    ------
    InputError
        It is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(f"{address.scheme} needs {EXTRAS[module]}", where=str(address), found="it is not installed",
                         expected="the extra 'brokers'",
                         hint="pip install 'loadid[brokers]'") from None  # fmt: skip


def lines(data: bytes) -> bytes:
    """A message as whole lines."""
    return data if data.endswith(b"\n") or not data else data + b"\n"


def key_of(data: bytes, number: object = "") -> str:
    """By which a message is known again: the number that its broker gave it, and what it holds."""
    return f"{number}:{hashlib.blake2b(data, digest_size=12).hexdigest()}"


class _Topics(Feed):
    """Structures by the topics of their messages."""

    def __init__(self, assets: Sequence[LiveAsset]) -> None:
        super().__init__()
        self.by_topic: dict[str, list[str]] = defaultdict(list)
        for asset in assets:
            self.by_topic[asset.source.path].append(asset.name)
        self.names = [asset.name for asset in assets]
        self.address = assets[0].source


class Mqtt(_Topics):
    """One connection to a broker, for all topics of it, and a session that the broker keeps.

    Parameters
    ----------
    assets : sequence of LiveAsset
    client : str
        Name of the session: the same for every run of a plan.
    """

    def __init__(self, assets: Sequence[LiveAsset], client: str) -> None:
        super().__init__(assets)
        self._queue: queue.Queue[Any] = queue.Queue(QUEUED)
        self._stop, self._why = threading.Event(), "not connected yet"
        self._client = connected(self.address, client, session=True)
        self._client.on_connect, self._client.on_disconnect = self._came, self._went
        self._client.on_connect_fail = self._unheard
        self._client.on_message, self._client.on_subscribe = self._heard, self._granted
        self._asked: dict[int, str] = {}  # topics that are subscribed to, until the broker has answered
        self._refused: dict[str, str] = {}
        self._connection = 0  # number of the present one
        options = importlib.import_module("paho.mqtt.subscribeoptions").SubscribeOptions
        self._wanted = options(qos=1, retainHandling=options.RETAIN_SEND_IF_NEW_SUB)  # not with every connection
        begin(self._client, self.address)

    def take(self) -> list[Received]:
        """Messages that have come."""
        found, size = [], 0
        while size < ROUND:
            try:
                receipt = self._queue.get_nowait()
            except queue.Empty:
                break
            message = receipt[1]
            size += 1 + len(message.payload)
            names = self.by_topic.get(message.topic, [])
            if not names:  # of an earlier plan
                self._client.unsubscribe(message.topic)
                self.confirm([Received("", b"", receipt=receipt)])
            key = key_of(message.payload, message.mid)
            found += [Received(name, lines(message.payload), key, bool(message.dup), receipt) for name in names]
        return found

    def confirm(self, pieces: Sequence[Received]) -> None:
        """Their answers are in their tables. What came by an earlier connection comes again, and is confirmed then."""
        for connection, message in {id(piece.receipt): piece.receipt for piece in pieces}.values():
            if message.qos and connection == self._connection:  # else its number may be that of another message now
                self._client.ack(message.mid, message.qos)

    def full(self) -> bool:
        """Whether half of what a broker sends without a confirmation waits."""
        return self._queue.qsize() >= RECENT // 2

    def down(self) -> dict[str, str]:
        """All of them, where there is no connection; those whose topic is refused."""
        if self._why:
            return dict.fromkeys(self.names, f"{self._why}: {self.address}")
        return {name: f"topic {topic} refused: {why}: {self.address}"
                for topic, why in list(self._refused.items()) for name in self.by_topic[topic]}  # fmt: skip

    def close(self) -> None:
        """Leave; the broker keeps what comes."""
        self._stop.set()
        self._client.disconnect()
        self._client.loop_stop()

    def _came(self, client: Any, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        if reason.is_failure:
            self._why = str(reason)
            return
        self._connection += 1
        self._refused = {}
        self._asked = {client.subscribe(topic, options=self._wanted)[1]: topic for topic in self.by_topic}

    def _unheard(self, client: Any, data: Any) -> None:
        self._why = "nobody answers"

    def _granted(self, client: Any, data: Any, number: int, reasons: Any, properties: Any) -> None:
        topic = self._asked.pop(number, "")
        if any(reason.is_failure for reason in reasons):
            self._refused[topic] = str(reasons[0])
        if not self._asked:
            self._why = ""

    def _went(self, client: Any, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        self._why = str(reason)
        if not self._stop.is_set():
            self.counts["lost"] += 1
            log.warning("connection to %s lost: %s", self.address, reason)

    def _heard(self, client: Any, data: Any, message: Any) -> None:
        while not self._stop.is_set():
            try:
                self._queue.put((self._connection, message), timeout=0.1)
                return
            except queue.Full:
                self.counts["waited"] += 1


def connected(address: Address, client: str, session: bool) -> Any:
    """An MQTT client that is not connected yet.

    Parameters
    ----------
    address : Address
    client : str
    session : bool
        The broker keeps it while nobody is there.
    """
    mqtt = required("paho.mqtt.client", address)
    made = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id=client, protocol=mqtt.MQTTv5, manual_ack=session)
    if address.user:
        made.username_pw_set(address.user, address.password or None)
    if address.scheme == "mqtts":
        made.tls_set()
    made.max_queued_messages_set(QUEUED)
    made.reconnect_delay_set(1, 30)
    return made


def begin(client: Any, address: Address, session: bool = True) -> None:
    """Connect in a thread, again and again."""
    from paho.mqtt.packettypes import PacketTypes
    from paho.mqtt.properties import Properties

    wanted = Properties(PacketTypes.CONNECT)
    wanted.SessionExpiryInterval = KEPT if session else 0
    wanted.ReceiveMaximum = RECENT  # what is not confirmed yet is known again when it comes twice
    client.connect_async(address.host, address.port, keepalive=30, clean_start=not session, properties=wanted)
    client.loop_start()


class ZeroMq(_Topics):
    """Subscriptions to a publisher."""

    def __init__(self, assets: Sequence[LiveAsset]) -> None:
        super().__init__(assets)
        zmq = self._zmq = required("zmq", self.address)
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.set_hwm(QUEUED)
        self._monitor = self._socket.get_monitor_socket(zmq.EVENT_CONNECTED | zmq.EVENT_DISCONNECTED)
        self._there = False
        for topic in self.by_topic:
            self._socket.subscribe(topic)
        self._socket.connect(f"tcp://{self.address.host}:{self.address.port}")

    def take(self) -> list[Received]:
        """Messages that have come: a topic and lines, or lines alone where there is no topic."""
        found, size = [], 0
        while size < ROUND:
            try:
                parts = self._socket.recv_multipart(self._zmq.NOBLOCK)
            except self._zmq.Again:
                break
            size += 1 + len(parts[-1])
            topic = parts[0].decode("utf-8", "replace") if len(parts) > 1 else ""
            names = self.by_topic.get(topic, [])
            self.counts["refused"] += not names
            found += [Received(name, lines(parts[-1]), key_of(parts[-1])) for name in names]
        return found

    def down(self) -> dict[str, str]:
        """All of them, where there is no connection."""
        zmq_utils = importlib.import_module("zmq.utils.monitor")
        while self._monitor.poll(0):
            event = zmq_utils.recv_monitor_message(self._monitor)["event"]
            self._there = event == self._zmq.EVENT_CONNECTED
            self.counts["lost"] += not self._there
        return {} if self._there else dict.fromkeys(self.names, f"nobody publishes: {self.address}")

    def close(self) -> None:
        """Leave."""
        self._socket.disable_monitor()
        self._context.destroy(linger=0)


class Kafka(_Topics):
    """One consumer of all topics of a cluster, from the offsets of the checkpoints; else from the begin of a topic.

    Parameters
    ----------
    assets : sequence of LiveAsset
    places : dict of str to mapping of str to int
        Name of a structure -> the next offset of each partition of its topic.
    client : str
        Name of the consumer group under which offsets are committed.
    """

    lasting = True

    def __init__(self, assets: Sequence[LiveAsset], places: dict[str, Any], client: str) -> None:
        super().__init__(assets)
        self._kafka = required("confluent_kafka", self.address)
        self._why, self._next, self._begun = "not connected yet", 0.0, False
        self._at: dict[str, dict[str, int]] = {n: dict(places.get(n) or {}) for n in self.names}
        self._looking: threading.Thread | None = None
        self._known: Any = None
        self._saved = {name: dict(place) for name, place in self._at.items()}
        self._consumer = self._kafka.Consumer({
            "bootstrap.servers": f"{self.address.host}:{self.address.port}", "group.id": client,
            "enable.auto.commit": False, "auto.offset.reset": "earliest", "error_cb": self._failed,
            "log_level": 0,
        })  # fmt: skip

    def take(self) -> list[Received]:
        """Messages that have come, each to those of its structures that do not have it yet."""
        if not self._begun and not self._assigned():
            return []
        found = []
        for message in self._consumer.consume(FEW, timeout=0.0):
            if message.error() is not None:
                self._why = str(message.error())
                continue
            self._why = ""
            partition, offset = str(message.partition()), message.offset()
            for name in self.by_topic.get(message.topic(), []):
                if offset >= self._at[name].get(partition, 0):
                    self._at[name][partition] = offset + 1
                    data = message.value() or b""
                    found.append(Received(name, lines(data), key_of(data)))
        return found

    def place(self, name: str, unread: int) -> Any:
        """Next offset of each partition."""
        return dict(self._at[name])

    def saved(self, name: str, place: Any) -> None:
        """Commit how far the checkpoints of all structures of a topic have come: for those who watch the lag."""
        self._saved[name] = place
        for topic, names in self.by_topic.items():
            if name in names and self._begun:
                least = {p: min(self._saved[n].get(p, 0) for n in names) for p in place}
                offsets = [self._kafka.TopicPartition(topic, int(p), offset) for p, offset in least.items() if offset]
                if offsets:
                    self._consumer.commit(offsets=offsets, asynchronous=True)

    def down(self) -> dict[str, str]:
        """All of them, where there is no connection."""
        return dict.fromkeys(self.names, f"{self._why}: {self.address}") if self._why else {}

    def close(self) -> None:
        """Leave."""
        if self._looking is not None:
            self._looking.join()
        self._consumer.close()

    def _assigned(self) -> bool:
        """Ask for partitions once there is somebody who knows them."""
        if time.monotonic() < self._next:
            return False
        if self._looking is None:
            self._looking = threading.Thread(target=self._look, name="topics", daemon=True)
            self._looking.start()
        self._looking.join(0.01)
        if self._looking.is_alive():
            return False
        self._looking, self._next, known = None, time.monotonic() + 1.0, self._known
        if known is None:
            return False
        missing = [topic for topic in self.by_topic if topic not in known or not known[topic].partitions]
        if missing:
            self._why = f"no topic {missing[0]}"
            return False
        begin = self._kafka.OFFSET_BEGINNING
        self._consumer.assign([
            self._kafka.TopicPartition(topic, p, min((self._at[n].get(str(p), begin) for n in names), default=begin))
            for topic, names in self.by_topic.items() for p in known[topic].partitions
        ])  # fmt: skip
        self._begun, self._why = True, ""
        return True

    def _look(self) -> None:
        """Topics of the cluster: asked in a thread, as a cluster that is not there keeps who asks waiting."""
        try:
            self._known = self._consumer.list_topics(timeout=2.0).topics
        except self._kafka.KafkaException as error:
            self._known, self._why = None, str(error.args[0])

    def _failed(self, error: Any) -> None:
        self._why = str(error)


# -- out ---------------------------------------------------------------------------------------------------------------
class Publisher:
    """Messages of a structure to a broker: a line of names, and rows.

    A broker that is not there, or is too slow, holds nobody up: what it cannot take is counted as ``undelivered``.

    Parameters
    ----------
    address : Address
    """

    def __init__(self, address: Address) -> None:
        self.counts: Counter[str] = Counter()
        self.address = address

    def send(self, topic: str, data: bytes) -> None:
        """One message."""
        raise NotImplementedError

    def close(self) -> None:
        """After what has been sent has left, or `WAIT`."""


class MqttOut(Publisher):
    """Quality of service 1."""

    def __init__(self, address: Address) -> None:
        super().__init__(address)
        self._client = connected(address, "", session=False)
        begin(self._client, address, session=False)
        self._last: Any = None

    def send(self, topic: str, data: bytes) -> None:
        """One message."""
        self._last = self._client.publish(topic, data, qos=1)
        self.counts["undelivered"] += self._last.rc not in (0, 4)  # 4: no connection yet, it waits

    def close(self) -> None:
        """After the last message has arrived, or `WAIT`."""
        if self._last is not None and self._client.is_connected():
            self._last.wait_for_publish(WAIT)
        self._client.disconnect()
        self._client.loop_stop()


class ZeroMqOut(Publisher):
    """A publisher that listens on its address."""

    def __init__(self, address: Address) -> None:
        super().__init__(address)
        zmq = self._zmq = required("zmq", address)
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.PUB)
        self._socket.set_hwm(QUEUED)
        try:
            self._socket.bind(f"tcp://{address.host}:{address.port}")
        except zmq.ZMQError as error:
            raise InputError("nothing can be published there", where=str(address), found=str(error),
                             hint="name an address of this machine and a port that is free") from None  # fmt: skip

    def send(self, topic: str, data: bytes) -> None:
        """One message of two parts."""
        self._socket.send_multipart([topic.encode(), data], self._zmq.NOBLOCK)

    def close(self) -> None:
        """After what has been sent has left."""
        self._socket.close(linger=int(1000 * WAIT))
        self._context.term()


class KafkaOut(Publisher):
    """A producer that repeats itself where it must, and never doubles."""

    def __init__(self, address: Address) -> None:
        super().__init__(address)
        kafka = required("confluent_kafka", address)
        self._refused = kafka.KafkaException  # too large, say
        self._producer = kafka.Producer({
            "bootstrap.servers": f"{address.host}:{address.port}", "enable.idempotence": True, "log_level": 0,
        })  # fmt: skip

    def send(self, topic: str, data: bytes) -> None:
        """One message."""
        try:
            self._producer.produce(topic, data, on_delivery=self._arrived)
        except (BufferError, self._refused):
            self.counts["undelivered"] += 1
        self._producer.poll(0)

    def close(self) -> None:
        """After what has been sent has arrived, or `WAIT`."""
        self._producer.flush(WAIT)

    def _arrived(self, error: Any, message: Any) -> None:
        self.counts["undelivered"] += error is not None


PUBLISHERS: dict[str, type[Publisher]] = {
    "mqtt": MqttOut, "mqtts": MqttOut, "zmq": ZeroMqOut, "kafka": KafkaOut,
}  # fmt: skip
