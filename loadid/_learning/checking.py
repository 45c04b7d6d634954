"""A learned map held against examples that it has not seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

from structures.errors import InputError

from .training import BATCH, require_fit, require_model


@dataclass(frozen=True)
class CheckRow:
    """Examples of one kind.

    Parameters
    ----------
    kind : str
        ``"all"`` of all together.
    draws : int
    error : float
        Median over draws of norm(error) / norm(load) of the map alone, alarm or not; NaN of no load.
    coverage : float
        Share of numbers inside the band that the map is calibrated for.
    alarms : float
        Share of draws that it leaves to the physics.
    novelty : float
        Median of the worst score over its limit.
    """

    kind: str
    draws: int
    error: float
    coverage: float
    alarms: float
    novelty: float


@dataclass(frozen=True)
class MapCheck:
    """What a map is worth on examples that were held out.

    Parameters
    ----------
    rows : tuple of CheckRow
        All together, then kind by kind.
    level : float
        Coverage that the band promises.
    """

    rows: tuple[CheckRow, ...]
    level: float

    def __str__(self) -> str:
        head = f"{'kind':24s} {'draws':>6s} {'error':>8s} {'coverage':>9s} {'alarms':>7s} {'novelty':>8s}"
        lines = [
            f"{r.kind:24s} {r.draws:6d} {r.error:8.4f} {r.coverage:9.3f} {r.alarms:7.3f} {r.novelty:8.3g}"
            for r in self.rows
        ]
        return "\n".join([head, *lines, f"coverage promised: {self.level:.3g}"])

    def to_dict(self) -> dict[str, Any]:
        """As plain data."""
        return {"level": self.level, "rows": [asdict(row) for row in self.rows]}


def checked(fitted: Any, held_out: Any, progress: Callable[[float, str], None], draws: int | None = None) -> MapCheck:
    """A `FittedMap` on a training set that it has not seen.

    Raises
    ------
    InputError
        Other sensors, loads, steps or model, or the set that it was learned from.
    """
    require_fit(held_out, fitted.model)
    require_model(held_out, fitted.model)
    if held_out.fingerprint == fitted.facts["training"]:
        raise InputError("the map was learned from this set", where="check", found=held_out.fingerprint[:12],
                         expected="a set of another seed", hint="generate one with another seed")  # fmt: skip
    if (held_out.dt is None) != (fitted.dt is None) or (fitted.dt and abs(held_out.dt / fitted.dt - 1) > 1e-6):
        raise InputError("the set and the map have different steps", where="check", found=held_out.dt,
                         expected=fitted.dt)  # fmt: skip
    level = float(fitted.facts["coverage"])
    wide = NormalDist().inv_cdf(0.5 + level / 2)
    kinds: list[str] = []
    found: list[tuple[float, float, bool, float]] = []
    for batch in held_out.batches(BATCH):
        if draws is not None and len(kinds) >= draws:
            break
        batch = batch if draws is None else batch[: draws - len(kinds)]
        told = fitted.predict(np.asarray(batch.data, float))
        matrix = fitted.outputs.matrix
        truth = np.asarray(batch.loads, float) if matrix is None else batch.loads @ matrix.T
        for i, verdict in enumerate(told.verdicts):
            off, size = np.abs(told.mean[i] - truth[i]), float(np.linalg.norm(truth[i]))
            error = float(np.linalg.norm(off)) / size if size > 0 else np.nan
            found.append((error, float(np.mean(off <= wide * told.std[i])), verdict.alarm, verdict.value))
        kinds += [str(kind) for kind in batch.kinds]
        progress(len(kinds) / len(held_out), "checking")
    names = dict.fromkeys(kinds)
    chosen = {"all": np.ones(len(kinds), bool)}
    if len(names) > 1:
        chosen |= {name: np.array([kind == name for kind in kinds]) for name in names}
    return MapCheck(tuple(_row(name, np.array(found, float)[at]) for name, at in chosen.items()), level)


def _row(kind: str, found: Any) -> CheckRow:
    loaded = found[np.isfinite(found[:, 0]), 0]
    error = float(np.median(loaded)) if len(loaded) else float("nan")
    return CheckRow(kind, len(found), error, float(np.mean(found[:, 1])), float(np.mean(found[:, 2])),
                    float(np.median(found[:, 3])))  # fmt: skip
