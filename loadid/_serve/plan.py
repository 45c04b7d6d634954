"""A plan of live structures: their trackers, where their samples come from and where their loads go."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from structures.errors import InputError

from .. import _toml
from .._toml import is_number

NAMES = {
    "plan": ("states", "run", "every", "asset"),
    "run": ("latency", "checkpoint", "http"),
    "asset": ("name", "model", "source", "sinks", "unit"),
}
BROKERS = {"mqtt": 1883, "mqtts": 8883, "zmq": None, "kafka": 9092}  # scheme -> port that is usual
TABLES = (".csv", ".parquet", ".h5")
SECRET = "LOADID_MQTT_PASSWORD"  # environment: the password of a user whom an address names without one


@dataclass(frozen=True)
class Address:
    """Where samples come from, or loads go.

    Parameters
    ----------
    scheme : {"file", "tcp", "mqtt", "mqtts", "zmq", "kafka"}
    path : str
        Path of a file, or topic.
    host : str
    port : int
    user, password : str
    """

    scheme: str
    path: str = ""
    host: str = ""
    port: int = 0
    user: str = ""
    password: str = field(default="", repr=False)

    @property
    def broker(self) -> tuple[str, str, int, str]:
        """What connections are shared by."""
        return self.scheme, self.host, self.port, self.user

    def __str__(self) -> str:
        """Without the password."""
        if self.scheme == "file":
            return self.path
        user, topic = f"{self.user}@" if self.user else "", f"/{self.path}" if self.path else ""
        return f"{self.scheme}://{user}{self.host}:{self.port}{topic}"


@dataclass(frozen=True)
class ServeSettings:
    """How the server goes.

    Parameters
    ----------
    latency : float
        Seconds for which samples are gathered before they are tracked together.
    checkpoint : float
        Seconds between two checkpoints of a structure.
    http : int or None
        Port on the loopback for metrics and health, 0 for any that is free; None for none.
    """

    latency: float = 0.1
    checkpoint: float = 60.0
    http: int | None = None


@dataclass(frozen=True)
class LiveAsset:
    """One structure.

    Parameters
    ----------
    name : str
    model : Path
        A fitted tracker.
    source : Address
    sinks : tuple of Address
        At least one of them a table on the disk.
    unit : mapping of str to str
        Units of channels whose header does not state them.
    """

    name: str
    model: Path
    source: Address
    sinks: tuple[Address, ...]
    unit: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ServePlan:
    """What a plan file asks for.

    Parameters
    ----------
    path, states : Path
        The file, and the folder of checkpoints and journal.
    assets : tuple of LiveAsset
    run : ServeSettings
    """

    path: Path
    states: Path
    assets: tuple[LiveAsset, ...]
    run: ServeSettings

    def state(self, asset: LiveAsset) -> Path:
        """File of the checkpoints of a structure."""
        return self.states / f"{asset.name}.h5"


def read(path: str | os.PathLike[str]) -> ServePlan:
    """The plan of a file.

    Parameters
    ----------
    path : path
        TOML; paths in it count from its folder.

    Raises
    ------
    InputError
        No such file, no TOML, a key that is none (with the nearest), a value that is none, a tracker that is not there,
        two assets of one name, two that write to one place.
    """
    file, tree = Path(path), _toml.read(path)
    said = ServePlanReader(str(path), NAMES)
    said.known(tree, "plan", str(path))
    states = file.parent / said.text(tree, "states", str(path))
    listed = said.assets(tree, "name, model, source and sinks")
    assets = tuple(said.asset(one, file.parent) for one in listed)
    said.apart(assets)
    return ServePlan(file, states, assets, said.running(said.table(tree, "run")))


class ServePlanReader(_toml.PlanReader):
    """The values of a plan, checked one by one."""

    def asset(self, tree: dict[str, Any], folder: Path) -> LiveAsset:
        """One asset."""
        name = tree["name"]
        place = f"[[asset]] {name}"
        if name in (".", "..") or name.startswith(".") or set(name) & set("/\\\0"):
            self.refused(f"{place}, name", name, "a name that a file can have")
        sinks = tree.get("sinks")
        sinks = [sinks] if isinstance(sinks, str) else sinks
        if not isinstance(sinks, list) or not sinks or not all(isinstance(s, str) and s for s in sinks):
            self.refused(f"{place}, sinks", sinks, "a list such as ['loads/{name}.csv', 'mqtt://127.0.0.1/loads']")
        source = self.address(self.text(tree, "source", place), f"{place}, source", folder)
        found = tuple(self.address(sink, f"{place}, sinks", folder) for sink in sinks)
        for sink in found:
            if sink.scheme == "file" and Path(sink.path).suffix not in TABLES:
                self.refused(f"{place}, sinks", sink.path, f"a table that ends in {', '.join(TABLES)}")
        if not any(sink.scheme == "file" for sink in found):
            raise InputError("no table on the disk", where=f"{self.where}, {place}, sinks", found=", ".join(sinks),
                             expected=f"at least one path that ends in {', '.join(TABLES)}",
                             hint="what was answered must be on the disk before it is confirmed")  # fmt: skip
        unit = self.table(tree, "unit")
        for channel, symbol in unit.items():
            if not isinstance(symbol, str):
                self.refused(f"{place}, unit, {channel}", symbol, "a unit such as 'g'")
        return LiveAsset(name, self.file(tree, "model", place, folder), source, found, unit)

    def address(self, text: str, place: str, folder: Path) -> Address:
        """A path, which counts from the plan, or the address of a socket or a broker."""
        scheme, there, _ = text.partition("://")
        if not there:
            return Address("file", str((folder / text).absolute()))
        if scheme not in ("tcp", *BROKERS):
            self.refused(place, _bare(text), f"a path, tcp://HOST:PORT, or {', '.join(f'{b}://' for b in BROKERS)}")
        try:
            parts = urlsplit(text)
            host, port = parts.hostname, parts.port or BROKERS.get(scheme)
        except ValueError:
            host = port = None
        topic = unquote(parts.path[1:]) if host else ""
        if not host or not port or (topic and scheme == "tcp"):
            self.refused(place, _bare(text), f"{scheme}://HOST:PORT" + ("" if scheme == "tcp" else "/TOPIC"))
        if set(topic) & set("#+") or "#" in text:
            self.refused(place, _bare(text), "a topic without wildcards: one of each asset")
        if not topic and scheme in ("mqtt", "mqtts", "kafka"):
            self.refused(place, _bare(text), f"{scheme}://HOST/TOPIC, with the topic of this asset")
        user = unquote(parts.username or "")
        password = unquote(parts.password or "") or (os.environ.get(SECRET, "") if user else "")
        return Address(scheme, topic, host, port, user, password)

    def apart(self, assets: tuple[LiveAsset, ...]) -> None:
        """Nothing, if no two sinks are one place and none is a source."""
        read = {str(asset.source): asset.name for asset in assets}
        written: dict[str, str] = {}
        for asset in assets:
            for sink in map(str, asset.sinks):
                if sink in written or sink in read:
                    both = "written" if sink in written else "read"
                    raise InputError("two assets share a place", where=f"{self.where}, [[asset]] {asset.name}",
                                     found=f"{sink}, {both} by {written.get(sink, read.get(sink))}",
                                     expected="a place for each", hint="put {name} into it")  # fmt: skip
                written[sink] = asset.name

    def running(self, given: dict[str, Any]) -> ServeSettings:
        """How the server goes."""
        self.known(given, "run", "[run]")
        for name, most in (("latency", 60.0), ("checkpoint", 3600.0)):
            if name in given and not (is_number(given[name]) and 0.001 <= given[name] <= most):
                self.refused(f"[run], {name}", given[name], f"seconds, from 0.001 to {most:g}")
        http = given.get("http")
        if http is not None and not (type(http) is int and 0 <= http < 65536):
            self.refused("[run], http", http, "a port of this machine below 65536, 0 for any that is free")
        return ServeSettings(**given)


def _bare(text: str) -> str:
    """An address without what stands before its host: that may be a password."""
    scheme, _, rest = text.partition("://")
    return f"{scheme}://{rest.rpartition('@')[2]}"
