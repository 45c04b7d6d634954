"""A gel pad as a static job of the guide: its readings are the motion of markers, its loads tractions at the nodes.

Evidence with a known load is a small TOML file that names frames and says what pressed in them (`presses`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from loadid import Record, _toml
from loadid._commands._job import resolved
from loadid._guide.context import GuidedJob, Job
from loadid._inverse.rules import RULES
from structures import Channel
from structures._certificate import Certificate
from structures.errors import InputError, real, shown

from .._arrays import Array
from .._commands._sources import DepthMaps, MarkerSource, depth_maps, look
from .._pad import padfile
from .._pad.pad import Pad
from .._pad.table import TomlTable
from .._sensors.multilayer import MultilayerPad
from .._sensors.posing import PadModel
from .presses import FORCES, KnownPress, presses

PENALTIES = ("identity", "gradient", "laplacian")
NAMED = ("log", "depth", "model")
PARTS = ("markers x", "markers y", "markers z", "depth")  # of the readings, each checked as a whole
ONE_READING = 1.0  # s, that nobody asks for


class PadJob(GuidedJob):
    """A job whose model is a pad file and whose log are frames; see `GuidedJob`."""

    over_time = False  # one reading tells of no channel whether it is sound

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Job:
        """What a job says, its paths from the folder of the job on, its values checked.

        Raises
        ------
        InputError
            No TOML, a key that is none, a value that fits none.
        """
        place = Path(path)
        table = TomlTable(place, "", _toml.read(path, "job"))
        found: dict[str, Any] = {
            "log": table.text("log"), "model": table.text("model"), "depth": table.text("depth", None),
            "frames": table.counts("frames", 2, None), "unloaded": table.count("unloaded", 5),
            "penalty": table.word("penalty", PENALTIES, "identity"), "allow": table.words("allow", None),
        }  # fmt: skip
        if "choice" in table:
            choice = table.values["choice"]
            table.number("choice") if real(choice) is not None else table.word("choice", tuple(RULES))
            found["choice"] = choice
        table.end()
        found = {name: value for name, value in found.items() if value is not None}
        return {name: os.fspath(place.parent / value) if name in NAMED else value for name, value in found.items()} | {
            "family": "static"
        }

    # -- the pad and its log ------------------------------------------------------------------------------------------
    @cached_property
    def settings(self) -> padfile.SensorFile:
        """The pad file."""
        return padfile.read(self.job["model"])

    @cached_property
    def pad(self) -> Pad:
        """The pad as finite elements."""
        return Pad.from_settings(self.settings, allow=[c for c in self._allowed if c[1:2] == "1"])

    @property
    def _allowed(self) -> tuple[str, ...]:
        return tuple(str(code).upper().removeprefix("LID-") for code in self.job.get("allow", ()))

    def _seen(self, log: str | os.PathLike[str], depth: Any, unloaded: int) -> tuple[MarkerSource, DepthMaps | None]:
        seen = look(Path(log), self.settings, self.pad, str(unloaded), self._allowed)
        if depth is None:
            return seen, None
        return seen, depth_maps(Path(depth), self.settings.depth, self.settings.path).zeroed(seen.inside)

    @cached_property
    def _own(self) -> tuple[MarkerSource, DepthMaps | None]:
        return self._seen(self.job["log"], self.job.get("depth"), int(self.job["unloaded"]))

    @cached_property
    def sensor(self) -> MultilayerPad:
        """The sensor on the pad, with the markers of the log."""
        seen, maps = self._own
        return MultilayerPad(self.pad, seen.markers, depth=None if maps is None else maps[0], penalty="identity")

    @cached_property
    def readings(self) -> Array:
        """Readings (m,) of the log: the mean of its frames that are named, else its strongest one; NaN where lost."""
        seen, maps = self._own
        return self._reading(seen, maps, self.job.get("frames"), None)

    def _reading(
        self, seen: MarkerSource, maps: DepthMaps | None, span: Sequence[int] | None, order: Array | None
    ) -> Array:
        """Readings of frames of a source, its markers in an order, -1 where one is not there."""
        found: list[Array] = []
        for k, frame in enumerate(seen.frames):
            if span is not None and not span[0] <= k + 1 <= span[1]:
                continue
            depth = None if maps is None else maps[k]
            motion = seen.read(frame, depth)[0]
            if order is not None:
                motion = np.where((order >= 0)[:, None], motion[order], np.nan)
            found.append(self.sensor.readings(motion, depth))
        if not found:
            raise InputError("there are no such frames", where="frames", found=shown(span), expected="frames from 1 on")
        if span is not None:
            return np.asarray(np.mean(found, axis=0))
        size = [float(np.sqrt(np.nanmean(y**2))) if np.isfinite(y).any() else 0.0 for y in found]
        return found[int(np.argmax(size))]

    @cached_property
    def model(self) -> PadModel:
        """Readings that the log has over tractions, with the certificate of step 2."""
        whole, seen = self.sensor.model, np.flatnonzero(np.isfinite(self.readings))
        sensors = [whole.sensors[i] for i in seen]
        model = PadModel(whole.H[seen], sensors, whole.loads, whole.basis, whole.flags)
        if self._certificate is not None:
            model.certificate = self._certificate
        return model

    @cached_property
    def log(self) -> Mapping[str, float]:
        """Readings by sensor."""
        return dict(zip([c.label for c in self.sensor.model.sensors], self.readings.tolist(), strict=True))

    @property
    def family(self) -> str:
        """Static inversion."""
        return "static"

    @property
    def static(self) -> bool:
        """It is."""
        return True

    @property
    def options(self) -> dict[str, Any]:
        """Settings of the family; noise is what step 2 left of a known press: the camera's, and errors of the mesh."""
        found: dict[str, Any] = {name: self.job[name] for name in ("penalty", "choice", "allow") if name in self.job}
        one = self._certificate
        if one is not None and one.noise_ratio is not None:
            left = dict(zip(one.sensors, one.noise_ratio, strict=True))
            found["noise"] = {
                c.label: float(c.noise or 0.0) * max(1.0, left.get(_part(c.label), 1.0)) for c in self.model.sensors
            }
            found["noise_source"] = "left of a known press in step 2"
        return found

    def described(self) -> dict[str, Any]:
        """What the pad is made of."""
        pad, markers = self.pad, self.sensor.markers
        return {
            "E_Pa": pad.E, "nu": pad.nu, "thickness_m": pad.thickness, "size_m": list(pad.size), "nodes": pad.points,
            "markers": len(markers), "noise_of_a_marker_m": float(np.median(markers.noise)),
            "noise_source": self._own[0].noise_source.text,
        }  # fmt: skip

    def estimate(self, found: Any = None, **override: Any) -> Any:
        """As `GuidedJob.estimate`, of the readings that are there."""
        table = self.log if found is None else dict(zip(found.labels, found.values[0].tolist(), strict=True))
        known = {c.label for c in self.model.sensors}
        there = {name: value for name, value in table.items() if name in known and np.isfinite(value)}
        if len(there) < len(known):
            override = {**override, "sensors": list(there)}
        options = {**self.options, **override}
        if isinstance(options.get("noise"), Mapping):
            options["noise"] = {name: std for name, std in options["noise"].items() if name in there}
        return self._identified(there, options)

    # -- evidence -----------------------------------------------------------------------------------------------------
    def records(self, evidence: Sequence[Path]) -> list[Path]:
        """Files of known presses.

        Raises
        ------
        InputError
            One names frames that are not among the evidence: what is not hashed proves nothing.
        """
        named = {path.resolve() for path in evidence}
        found = [path for path in evidence if path.suffix.lower() == ".toml"]
        for path in found:
            one = presses(path)
            missing = [other for other in (one.log, one.depth) if other is not None and other.resolve() not in named]
            if missing:
                names = " ".join(other.name for other in missing)
                raise InputError("the frames of a press are evidence too", where=path.name, found="the file alone",
                                 expected=names, hint=f"--evidence {path.name} {names}")  # fmt: skip
        return found

    def record(self, path: Path) -> Record:
        """A press of known force as one reading: that of its markers, and its load or its resultant.

        Raises
        ------
        InputError
            A file that says none, or frames of other markers.
        """
        one = presses(path)
        seen, maps = self._seen(one.log, one.depth, one.unloaded)
        if (maps is None) != (self.sensor.depth is None):
            raise InputError("the press and the log are not seen alike", where=path.name,
                             found="a depth map" if maps is not None else "no depth map",
                             expected="as in the log of the job")  # fmt: skip
        order = self._order(seen, path)
        reading = self._reading(seen, maps, one.frames, order)
        channels = [*self.sensor.model.sensors, *self._known_channels(one)]
        values = np.concatenate([reading, self._known(one)])
        there = np.isfinite(values)
        return Record(values[None, there], ONE_READING, [c for c, ok in zip(channels, there, strict=True) if ok],
                      name=path.name, source=path.name)  # fmt: skip

    def _order(self, seen: MarkerSource, path: Path) -> Array:
        """Which marker of a source is which of the log; -1 where it is not there."""
        from scipy.spatial import cKDTree

        places = self.sensor.markers.points[:, :2]
        pitch = float(np.median(cKDTree(places).query(places, k=2)[0][:, 1]))
        away, order = cKDTree(seen.markers.points[:, :2]).query(places)
        order = np.where(away < 0.5 * pitch, order, -1)
        if np.mean(order >= 0) < 0.5:
            raise InputError("the markers are not those of the log", where=path.name,
                             found=f"{int(np.sum(order >= 0))} of {len(order)} at the same places",
                             expected="frames of the same pad before the same camera")  # fmt: skip
        return np.asarray(order)

    def _known_channels(self, one: KnownPress) -> list[Channel]:
        return list(self.sensor.loads) if one.press is not None else [Channel(label=name, unit="N") for name in FORCES]

    def _known(self, one: KnownPress) -> Array:
        """Tractions at the nodes (3 P,), or the force (3,)."""
        from ..metrics import means

        if one.press is None:
            return np.array(one.force)
        pitch = float(np.sqrt(np.median(self.pad.surface.areas[~self.pad.edge])))
        return np.asarray(means(one.press, self.pad.nodes2d, pitch)).ravel()

    def responses(self, record: Record) -> Record:
        """The readings of a record; a marker that is lost in it has none."""
        known = {c.label for c in self.model.sensors}
        there = [k for k, label in enumerate(record.labels) if label in known]
        return Record(record.values[:, there], record.dt, [record.channels[k] for k in there], name=record.name)

    def resultants(self) -> dict[str, Array]:
        """Force of tractions."""
        rows = self.sensor.geometry["resultant"][:3]
        return dict(zip(FORCES, np.asarray(rows, float), strict=True))

    def certified(self, record: Record) -> Certificate:
        """Markers along x and y, and the depth map, as the known press moves them.

        Raises
        ------
        InputError
            Only the resultant is known.
        """
        load = self.loads(record)
        if load is None:
            raise InputError("the record holds no known load", where=record.name, found="a resultant",
                             expected="a press of known place and radius: at, radius and force")  # fmt: skip
        whole = self.sensor.model
        predicted = dict(zip([c.label for c in whole.sensors], whole.H @ load[0], strict=True))
        noise = {c.label: float(c.noise or 0.0) for c in whole.sensors}
        parts: list[Certificate] = []
        for name in PARTS:
            labels = [label for label in record.labels if label in predicted and _part(label) == name]
            if labels:
                std = np.array([noise[label] for label in labels])
                model = np.array([predicted[label] for label in labels]) / std
                seen = np.array([record[label][0] for label in labels]) / std
                parts.append(Certificate.compare(model[:, None], seen[:, None], [name], noise=np.ones(1),
                                                 source=record.name))  # fmt: skip
        return Certificate(
            tuple(one.gain[0] for one in parts), tuple(one.shape[0] for one in parts),
            tuple(one.error[0] for one in parts), tuple((one.noise_ratio or (1.0,))[0] for one in parts),
            tuple(one.sensors[0] for one in parts), record.name, parts[0].date,
        )  # fmt: skip

    def frozen_text(self, frozen: Mapping[str, Any], folder: Path) -> str:
        """The job with what was frozen."""
        job = {name: value for name, value in self.job.items() if name != "family"}
        if "depth" in job:
            job["depth"] = Path(os.path.relpath(job["depth"], folder)).as_posix()
        return resolved({**job, **frozen}, folder)


def _part(label: str) -> str:
    """Which of `PARTS` a reading belongs to."""
    return {"+X": PARTS[0], "+Y": PARTS[1], "+Z": PARTS[2]}.get(label[-2:], PARTS[3])
