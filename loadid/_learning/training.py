"""What a map learns from: whitened readings and the outputs that belong to them, part by part of a training set."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from structures._channels import Channel

Array = NDArray[np.float64]

BATCH = 256  # examples that are read at once


class ExampleBatch(Protocol):
    """Some examples in memory, as a training set gives them; 0 where a reading is missing."""

    @property
    def data(self) -> Array: ...
    @property
    def missing(self) -> NDArray[np.bool_] | None: ...
    @property
    def loads(self) -> Array: ...


class Training(Protocol):
    """What is asked of a training set (`loadid.generate.TrainingSet`)."""

    @property
    def sensors(self) -> Sequence[Channel]: ...
    @property
    def loads(self) -> Sequence[Channel]: ...
    @property
    def dt(self) -> float | None: ...
    @property
    def samples(self) -> int | None: ...
    @property
    def fingerprint(self) -> str: ...
    def __len__(self) -> int: ...
    def batches(self, size: int) -> Iterator[Any]:
        """Examples, at most `size` at once, in the order of their draws."""

    def split(self, fractions: Sequence[float], seed: int) -> tuple[Any, ...]:
        """Parts of the set, by draw."""


@dataclass(frozen=True, eq=False)
class Lesson:
    """A training set as an engine sees it: whitened readings in, outputs in SI out.

    Parameters
    ----------
    fitting, choosing, calibrating : Training
        Parts by draw: for the parameters, for what is chosen beside them (length, ridge, when to stop), and for the
        std and the thresholds. An engine reads the first two alone.
    scale : array (sensors,)
        Std of each sensor's noise, by which readings are divided.
    resultant : array (outputs, loads) or None
        Outputs of loads; None where they are the loads.
    dt : float or None
        Step in s of histories; None of static readings.
    """

    fitting: Training
    choosing: Training
    calibrating: Training
    scale: Array
    resultant: Array | None = None
    dt: float | None = None

    @property
    def outputs(self) -> int:
        """How many."""
        return len(self.fitting.loads) if self.resultant is None else len(self.resultant)

    def batches(self, part: Training, size: int = BATCH) -> Iterator[tuple[Array, Array]]:
        """Whitened data (n, [samples,] sensors) and outputs (n, [samples,] outputs), batch by batch."""
        for batch in part.batches(size):
            yield np.asarray(batch.data, float) / self.scale, self.of(np.asarray(batch.loads, float))

    def of(self, loads: Array) -> Array:
        """Outputs of loads (..., loads)."""
        return loads if self.resultant is None else loads @ self.resultant.T


def share(part: Training) -> Mapping[str, Any]:
    """What a file keeps of a part."""
    return {"draws": len(part), "fingerprint": part.fingerprint}
