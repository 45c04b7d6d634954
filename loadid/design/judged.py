"""One layout judged: what its sensors tell apart, how well, and where they are blind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Judged:
    """What one set of sensors promises.

    Parameters
    ----------
    name : str
    sensors : tuple of str
    rank, nullity : int
        Numerical rank of the transfer matrix, and loads minus rank: combinations without any trace.
    kappa : float
        Condition number over that rank, of rows in units of the noise and loads in units of their amplitude.
    snr : array, shape (min(sensors, loads),)
        Singular values of that matrix, descending: response to a load of the stated amplitude over the noise.
    std : array, shape (loads,)
        Posterior std, SI; at most the amplitude.
    amplitude : array, shape (loads,)
        Stated std of each load before any reading.
    loads, units : tuple of str
    logdet : float
        Log det of posterior over prior precision: the D-criterion, twice the information in nats.
    at : array, shape (sensors, dim), or None
        Places of the sensors (m).
    """

    name: str
    sensors: tuple[str, ...]
    rank: int
    nullity: int
    kappa: float
    snr: Array
    std: Array
    amplitude: Array
    loads: tuple[str, ...]
    units: tuple[str, ...]
    logdet: float
    at: Array | None = None

    def __post_init__(self) -> None:
        for name in ("snr", "std", "amplitude", "at"):
            value = getattr(self, name)
            if value is not None:
                frozen = np.array(value, float)
                frozen.setflags(write=False)
                object.__setattr__(self, name, frozen)

    @property
    def recoverable(self) -> int:
        """Modes whose response to the stated amplitude exceeds the noise."""
        return int(np.sum(self.snr > 1))

    @property
    def share(self) -> Array:
        """Posterior over prior std of each load: 1 is not seen at all."""
        return self.std / self.amplitude

    @property
    def worst(self) -> int:
        """Load of the largest share."""
        return int(np.argmax(np.round(self.share, 12)))

    @property
    def mean_share(self) -> float:
        """Geometric mean of posterior over prior std of all modes: the D-criterion as a std."""
        return float(np.exp(-self.logdet / (2 * len(self.std))))

    def row(self) -> tuple[str, ...]:
        """Its line of a table."""
        j = self.worst
        return (
            self.name,
            str(len(self.sensors)),
            f"{self.kappa:.3g}",
            str(self.rank),
            str(self.nullity),
            f"{self.recoverable} of {len(self.std)}",
            f"{self.std[j]:.3g} {self.units[j] if self.units[j] != 'arbitrary' else ''}".rstrip(),
            f"{self.share[j]:.1%}",
            self.loads[j],
            f"{self.logdet:.4g}",
            f"{self.mean_share:.1%}",
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain texts, numbers and lists."""
        return {
            "name": self.name,
            "sensors": list(self.sensors),
            "rank": self.rank,
            "nullity": self.nullity,
            "kappa": self.kappa if self.rank else None,
            "recoverable": self.recoverable,
            "snr": self.snr.tolist(),
            "std": self.std.tolist(),
            "amplitude": self.amplitude.tolist(),
            "loads": list(self.loads),
            "units": list(self.units),
            "worst": self.loads[self.worst],
            "worst_std": float(self.std[self.worst]),
            "worst_share": float(self.share[self.worst]),
            "logdet": self.logdet,
            "mean_share": self.mean_share,
            "at": None if self.at is None else self.at.tolist(),
        }


HEADS = (
    "layout", "sensors", "condition", "rank", "nullity", "modes above noise", "worst std", "of its amplitude",
    "at load", "log det", "mean std",
)  # fmt: skip


def judge(
    name: str,
    A: Array,
    amplitude: Array,
    sensors: tuple[str, ...],
    loads: tuple[str, ...],
    units: tuple[str, ...],
    at: Array | None = None,
) -> Judged:
    """Judge rows `A` in units of the noise, per load of the stated amplitude.

    The posterior is that of a Gaussian prior of std `amplitude` per load, loads independent:
    ``var = amplitude^2 diag((I + A^T A)^-1)``, from the SVD of A.
    """
    m, n = A.shape
    s, Vt = np.linalg.svd(A, full_matrices=False)[1:]
    rank = int(np.sum(s > max(m, n) * np.finfo(float).eps * s[0])) if s[0] > 0 else 0
    left = np.sum(Vt**2 / (1 + s[:, None] ** 2), axis=0)
    if m < n:  # what no row reaches keeps its prior
        left += np.maximum(1 - np.sum(Vt**2, axis=0), 0.0)
    return Judged(
        name=name,
        sensors=sensors,
        rank=rank,
        nullity=n - rank,
        kappa=float(s[0] / s[rank - 1]) if rank else float("inf"),
        snr=s,
        std=amplitude * np.sqrt(np.minimum(left, 1.0)),
        amplitude=amplitude,
        loads=loads,
        units=units,
        logdet=float(np.sum(np.log1p(s**2))),
        at=at,
    )


def table(rows: list[tuple[str, ...]]) -> str:
    """Lines of a table, columns aligned."""
    rows = [HEADS, *rows]
    wide = [max(len(r[i]) for r in rows) for i in range(len(HEADS))]
    return "\n".join(
        "  ".join(
            c.ljust(w) if i in (0, 8) else c.rjust(w) for i, (c, w) in enumerate(zip(r, wide, strict=True))
        ).rstrip()
        for r in rows
    )
