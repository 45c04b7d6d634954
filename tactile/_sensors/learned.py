"""Force maps by a map that was learned from presses, and by the sensor's own physics where readings are unlike these.

The band of the resultant is calibrated beside that of the nodes, on the draws that were kept apart: errors of nodes are
not independent, so that sums of them cannot be told from their stds.

Motion does not tell the modulus, so that no alarm and no calibration on a set of one gel sees another one. What the
gel's tolerances do to a load is known to first order: tractions of the same motion are as large as the modulus; with
another nu or thickness the readings of a load change, and with them what the map makes of these. All nodes share that.
Gels that the presses were drawn on are in the calibration already: only what the tolerances exceed them by is added.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from loadid._families.learned import PARTS, FittedMap, LearnedMap, load_map
from loadid._guards import outside_training
from loadid._learning.calibration import grown, quantile
from loadid._learning.outputs import words
from loadid._learning.training import parameter_names
from loadid._results.facts import provenance
from structures._flags import Flag
from structures.errors import InputError

from .._arrays import Array, Index, Mask
from .._pad.tolerances import Tolerances
from .._results.forcemap import ForceFacts, ForceMap
from .gaussian import ModelError
from .linear import LinearSensor
from .marked import MarkedSensor
from .observation import DepthMap, Wrench
from .posing import PadModel

MOST_LOST = 0.1  # share of the readings that neighbours stand in for
NEAR = 0.35  # of the distance of markers, within which a marker is the one that the map knows
AROUND = 4  # neighbours
Z95 = 1.959964
AXES = ("Fx", "Fy", "Fz")
GEL = ("E", "nu", "thickness")  # what no motion tells
GELS = 500  # presses that tell on which gels they were drawn
SAME = 1e-6  # what two numbers of one gel may differ by


class SeenModel(PadModel):
    """The transfer matrix of a sensor, known by what is pressed and what is read, not by its last digit.

    Markers are found anew in every reference image: a map holds for all that lie where its own do (`matched`).

    Parameters
    ----------
    sensor : LinearSensor
    rows : array of int, optional
        Its readings in the order of a map.
    """

    def __init__(self, sensor: LinearSensor, rows: Index | None = None) -> None:
        model = sensor.model
        H = model.H if rows is None else model.H[rows]
        super().__init__(H, model.sensors, model.loads, model.basis, model.flags, model.described)

    @property
    def fingerprint(self) -> str:
        """What is pressed and read, in words."""
        return self.described


class LearnedSensor(MarkedSensor):
    """A tactile sensor with a learned map: frames in, force maps out, by presses that physics wrote.

    Build it by `fit` or `read`. Readings unlike the examples are answered by the sensor itself, and said to be
    (LID-W609); ``facts.answered_by`` says who answered.

    Parameters
    ----------
    sensor : MultilayerPad or another linear sensor
    fitted : loadid.FittedMap
        Of the readings and loads of that sensor.

    Raises
    ------
    InputError
        A map without the places of its markers, or of others.
    """

    name = "learned map"

    def __init__(self, sensor: LinearSensor, fitted: FittedMap) -> None:
        super().__init__(sensor.markers, sensor.eye, sensor.depth, sensor.contact)
        if "markers" not in fitted.facts:
            raise InputError("this map was not learned for a tactile sensor", where="LearnedSensor",
                             expected="one that LearnedSensor.fit made", hint="fit it through this class")  # fmt: skip
        self._columns = columns_of(sensor, fitted.facts["markers"])
        self.sensor, self.fitted = sensor, replace(fitted, model=SeenModel(sensor, self._columns))
        self.offset = sensor.offset

    def __repr__(self) -> str:
        return f"<LearnedSensor: {self.fitted.engine.name}, {self.fitted.facts['draws']} presses, {self.sensor!r}>"

    @classmethod
    def fit(
        cls,
        sensor: LinearSensor,
        training: Any,
        *,
        engine: str = "torch",
        seed: int = 0,
        progress: Callable[[float, str], None] | None = None,
        **settings: Any,
    ) -> Self:
        """Learn the map of a sensor from presses.

        Parameters
        ----------
        sensor : MultilayerPad or another linear sensor
        training : loadid.generate.TrainingSet
            Readings and loads of this sensor.
        engine : ``"linear"`` or ``"torch"``
            As `loadid.LearnedMap`.
        seed : int
            Of the parts of the set, and of the network.
        progress : callable, optional
        **settings
            Of the engine; `unseen` as `loadid.LearnedMap.fit`, by default what was drawn of the gel.

        Raises
        ------
        InputError
            As `loadid.LearnedMap.fit`; presses drawn for another pad, or for markers that lie elsewhere.
        """
        markers = sensor.markers.points[:, :2] if training.places is None else training.places
        model = SeenModel(sensor, columns_of(sensor, markers))
        learning = LearnedMap(model, engine=engine, seed=seed, progress=progress)
        places = sensor.geometry["coordinates"][sensor.kept[::3] // 3]
        own = {"places": places, "seed": seed, "sums": sensor.resultant[: len(AXES)]} if engine == "torch" else {}
        unseen = [name for name in GEL if name in parameter_names(training)]
        fitted = learning.fit(training, **{"unseen": unseen, **own, **settings})
        band = ResultantBand.calibrated(fitted, training.split(PARTS, seed)[1:], sensor.resultant)
        facts = {**fitted.facts, "markers": markers, "resultant": band.tree(), "gels": drawn_gels(sensor, training)}
        return cls(sensor, replace(fitted, facts=facts))

    @classmethod
    def read(cls, path: str | os.PathLike[str], sensor: LinearSensor) -> Self:
        """A map from its file, for the sensor that it was learned for.

        Raises
        ------
        InputError
            A file that is missing or damaged; a sensor with another pad, other markers or another depth map.
        """
        return cls(sensor, load_map(path, model=SeenModel(sensor)))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the map to an HDF5 file, whole or not at all.

        Raises
        ------
        InputError
            If the file cannot be written.
        """
        self.fitted.save(path)

    def estimate(self, found: ArrayLike, depth: DepthMap | None = None, *, wrench: Wrench | None = None) -> ForceMap:
        """Force map of one frame.

        Parameters
        ----------
        found : array (N, 2 or 3), or an image (H, W[, 3])
            As `MultilayerPad.estimate`.
        depth : DepthMap, optional
        wrench : Wrench, optional
            Of a force/torque sensor: the physics meets it.

        Returns
        -------
        ForceMap
            ``facts.novelty`` above 1 is an alarm: the map is that of the sensor's physics then.

        Raises
        ------
        InputError, NotIdentifiable
            As `MultilayerPad.estimate`.
        """
        y, flags = self._of_frame(found, depth, wrench)
        return self.explained(y, flags, wrench)

    def explained(self, y: Array, flags: Sequence[Flag | None] = (), wrench: Wrench | None = None) -> ForceMap:
        """Force map of readings (m,), NaN where one is lost, with what was found on the way to them."""
        lost = ~np.isfinite(y)
        if wrench is not None or lost.mean() > MOST_LOST:
            return self._by_physics(y, flags, wrench, None)
        seen = self._whole(y, lost)[self._columns]
        told = self.fitted.predict(seen[None])
        verdict = told.verdicts[0]
        if verdict.alarm:
            return self._by_physics(y, flags, None, verdict)
        load, own = told.mean[0], told.own[0]
        shared = np.vstack([told.shared[0], *self._other_gels(seen, load)])
        std = np.hypot(own, np.linalg.norm(shared, axis=0))
        facts = ForceFacts.of({
            "m": int(np.sum(~lost)), "n": len(load), "lost": int(lost.sum()), "novelty": verdict.value,
            "novelty_by": words(verdict), "answered_by": self.name, "engine": self.fitted.engine.name,
            "provided": self.sensor.provided(self.depth is not None),
            "band": f"error of the map on draws kept apart, coverage {self.fitted.facts['coverage']:.0%}{self._known}",
        })  # fmt: skip
        felt = self.sensor.resultant @ shared.T
        covariance = self._band.covariance(load, own, self.sensor.resultant) + felt @ felt.T
        told_by_set = (*flags, *self.fitted.span_flags)
        return self.sensor.answered(load, std, covariance, facts, flags=told_by_set, provenance=self._about)

    def adapted(
        self, frames: Sequence[Any], depths: Sequence[DepthMap] | None = None, *, wrenches: Sequence[Wrench]
    ) -> LearnedSensor:
        """The sensor with a gain for each direction, told by presses of known force; its error is in the band.

        Parameters
        ----------
        frames, depths : sequence
            As `estimate` takes them.
        wrenches : sequence of Wrench
            Of each frame, by a force sensor or weights; taken as exact.

        Raises
        ------
        InputError
            Wrenches that do not go with the frames, or a sensor whose loads are a part of its surface.
        """
        listed = self._listed(frames, depths)
        if not frames or len(listed) != len(wrenches) or len(listed) != len(frames):
            raise InputError("the wrenches do not go with the frames", where="adapted, wrenches",
                             found=f"{len(wrenches)} of {len(listed)} frames", expected="one for each")  # fmt: skip
        return self.adapted_to(listed, wrenches)

    def adapted_to(self, readings: Sequence[Array], wrenches: Sequence[Wrench]) -> LearnedSensor:
        """As `adapted`, of readings (m,), NaN where one is lost."""
        more = [(self._whole(y, ~np.isfinite(y))[self._columns], dict(zip(AXES, map(float, w.force), strict=True)))
                for y, w in zip(readings, wrenches, strict=True)]  # fmt: skip
        R, band = self.sensor.resultant, self._band
        fitted = self.fitted.adapted(more, of_sums=lambda load, std: np.sqrt(np.diag(band.covariance(load, std, R))))
        return type(self)(self.sensor, fitted)

    def zero(self, frames: Sequence[Any], depths: Sequence[DepthMap] | None = None) -> Self:
        """Take the mean of unloaded frames as zero. Returns the sensor.

        Raises
        ------
        InputError
            Without frames.
        """
        super().zero(frames, depths)
        self.sensor.offset = self.offset
        return self

    # -- inside -------------------------------------------------------------------------------------------------------
    def _other_gels(self, seen: Array, load: Array) -> list[Array]:
        """What a gel that is one std of each tolerance off does to a load (n,) of readings of the map (m,)."""
        found = [error.change[self._columns] @ load for error in self._tolerated]
        moved = self.fitted.mean(seen - np.array(found)) if found else np.zeros((0, len(load)))
        by_E = [self._left.E * load] if self._left.E else []
        return [*by_E, *(load - moved)]

    @cached_property
    def _left(self) -> Tolerances:
        """Tolerances of the gel beyond those of the presses; that of the modulus is 0 where known forces told it."""
        left = self.sensor.pressed_body.tolerances.beyond(self.fitted.facts.get("gels", {}))
        return replace(left, E=0.0) if self.fitted.adaptation.records else left

    @cached_property
    def _tolerated(self) -> list[ModelError]:
        """Errors of the readings within what is left of the tolerances of nu and thickness."""
        told = vars(self.sensor.pressed_body.tolerances)
        share = {name: value / told[name] for name, value in vars(self._left).items() if name != "E" and value}
        if not share:
            return []
        errors = [error for error in self.sensor.model_errors() if error.name in share]
        return [replace(error, change=share[error.name] * error.change) for error in errors]

    @cached_property
    def _known(self) -> str:
        """How well the gel is known, in words."""
        drawn = self.fitted.facts.get("gels", {})
        told = {name: np.hypot(value, drawn.get(name, 0.0)) for name, value in vars(self._left).items()}
        said = [f"{name} {value:.3g}" for name, value in told.items() if value]
        std = [f"std of the gel, {', '.join(said)}"] if said else []
        forces = ["modulus by known forces"] if self.fitted.adaptation.records else []
        return "; " + ", ".join(std + forces or ["gel taken as exactly known"])

    def _by_physics(self, y: Array, flags: Sequence[Flag | None], wrench: Wrench | None, verdict: Any) -> ForceMap:
        """The sensor's own map, and why."""
        found = self.sensor.explained(y, flags, wrench)
        told = {"answered_by": "physics", "engine": self.fitted.engine.name}
        why: list[Flag] = []
        if verdict is not None:
            told |= {"novelty": verdict.value, "novelty_by": words(verdict)}
            worst = verdict.worst
            why = [outside_training(worst, words(verdict), verdict.scores[worst], verdict.limits[worst], 1, 1, False)]
        notes = {**found.provenance, "learned": dict(self._about)}
        return replace(found, flags=(*why, *found.flags), facts=ForceFacts.of({**found.facts, **told}),
                       provenance=notes)  # fmt: skip

    def _whole(self, y: Array, lost: Mask) -> Array:
        """Readings with those of the next markers in place of lost ones."""
        if not lost.any():
            return y
        from scipy.spatial import cKDTree

        filled, count, axes = y.copy(), self.markers.readings_count, len(self.markers.axes)
        groups = [(self.markers.points[:, :2], slice(k, count, axes)) for k in range(axes)]
        if self.depth is not None:
            groups.append((self.depth.points[:, :2], slice(count, None)))
        for places, rows in groups:
            values, gone = filled[rows], lost[rows]
            if gone.all():
                values[:] = 0.0
            elif gone.any():
                near = cKDTree(places[~gone]).query(places[gone], k=min(AROUND, int(np.sum(~gone))))[1]
                values[gone] = values[~gone][near].reshape(int(gone.sum()), -1).mean(axis=1)
        return filled

    @cached_property
    def _band(self) -> ResultantBand:
        return ResultantBand.of(self.fitted.facts["resultant"])

    @cached_property
    def _about(self) -> dict[str, Any]:
        facts = self.fitted.facts
        kept = {key: facts[key] for key in ("coverage", "draws", "training")}
        return provenance(
            self.name, settings={"engine": self.fitted.engine.name, "sensor": repr(self.sensor), **kept}, inputs={},
            model=self.fitted.model.fingerprint, prior=f"presses like those of {facts['draws']} examples",
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class ResultantBand:
    """How far resultants are off, beside what the stds of the nodes make of them: a factor each, and how they go along.

    Parameters
    ----------
    factors : array (6,)
    correlation : array (6, 6)
    share : array (6,)
        Of the resultant itself, which its error grows by.
    """

    factors: Array
    correlation: Array
    share: Array

    @classmethod
    def calibrated(cls, fitted: FittedMap, parts: Sequence[Any], resultant: Array) -> Self:
        """By the conformal quantile of the draws that were kept apart, the share by those that chose (two parts)."""
        coverage, own = fitted.facts["coverage"], np.arange(len(resultant))
        errors, stds, forces = _of_resultants(fitted, parts[0], resultant)
        share = grown(errors, stds, forces, own, coverage)
        errors, stds, forces = _of_resultants(fitted, parts[1], resultant)
        ratio = errors / np.hypot(stds, share * forces)
        factors = np.array([quantile(np.abs(column), coverage) for column in ratio.T]) / Z95
        return cls(factors, np.asarray(np.corrcoef(ratio.T)), share)

    def covariance(self, load: Array, std: Array, resultant: Array) -> Array:
        """Covariance (6, 6) of the resultant of loads (n,) with their std."""
        size = self.factors * np.hypot(_alone(std, resultant), self.share * (resultant @ load))
        return np.asarray(size[:, None] * self.correlation * size)

    def tree(self) -> dict[str, Array]:
        """What a file keeps."""
        return {"factors": self.factors, "correlation": self.correlation, "share": self.share}

    @classmethod
    def of(cls, tree: Mapping[str, Any]) -> Self:
        """Inverse of `tree`."""
        return cls(*(np.asarray(tree[name], float) for name in ("factors", "correlation", "share")))


def _of_resultants(fitted: FittedMap, kept: Any, resultant: Array) -> tuple[Array, Array, Array]:
    """Errors of the resultants (n, 6), their stds if all loads erred independently, and what the map says of them."""
    found = []
    for batch in kept.batches(256):
        told = fitted.predict(np.asarray(batch.data, float))
        found.append(((told.mean - batch.loads) @ resultant.T, _alone(told.std, resultant), told.mean @ resultant.T))
    errors, stds, forces = (np.concatenate(column) for column in zip(*found, strict=True))
    return errors, stds, forces


def _alone(std: Array, resultant: Array) -> Array:
    """Std of resultants (..., 6) if the loads (..., n) erred independently."""
    return np.sqrt(np.asarray(std) ** 2 @ (resultant**2).T)


def drawn_gels(sensor: LinearSensor, training: Any) -> dict[str, float]:
    """How far the gels that presses were drawn on lie from that of a sensor, by name, rms: E and thickness relative."""
    body, seen = sensor.pressed_body.body, training.read(slice(0, GELS)).parameters
    own = {"E": getattr(body, "E", 0.0), "nu": getattr(body, "nu", 0.0), "thickness": sensor.thickness or 0.0}
    off = {name: seen[name] - value for name, value in own.items() if value and name in seen}
    size = {name: 1.0 if name == "nu" else value for name, value in own.items()}
    found = {name: float(np.sqrt(np.mean(values**2))) / size[name] for name, values in off.items()}
    return {name: value for name, value in found.items() if value > SAME}


def columns_of(sensor: LinearSensor, markers: ArrayLike) -> Index:
    """Of the readings of a sensor, those of a map of `markers` (N, 2) in its order.

    Raises
    ------
    InputError
        The markers lie elsewhere.
    """
    axes, count = len(sensor.markers.axes), sensor.markers.readings_count
    order = matched(np.asarray(markers, float), sensor.markers.points[:, :2])
    marked = (axes * order[:, None] + np.arange(axes)).ravel()
    return np.concatenate([marked, np.arange(count, len(sensor.model.sensors))])


def matched(known: Array, places: Array) -> Index:
    """Which of `places` (N, 2) is each of the `known` ones (N, 2), in m.

    Raises
    ------
    InputError
        They are not the same markers.
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(places)
    away, order = tree.query(known)
    pitch = float(np.median(tree.query(places, k=2)[0][:, 1]))
    if len(known) != len(places) or away.max() > NEAR * pitch or len(set(order.tolist())) < len(known):
        raise InputError("the markers are not those that the map was learned for", where="markers",
                         found=f"{len(places)}, up to {1e3 * away.max():.3g} mm away",
                         expected=f"{len(known)}, within {1e3 * NEAR * pitch:.2g} mm of theirs",
                         hint="learn a map for this sensor")  # fmt: skip
    return np.asarray(order, np.intp)
