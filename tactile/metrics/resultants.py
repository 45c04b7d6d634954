"""Resultants of force maps, and their errors over frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError

from .settled import Array, finite, places

LABELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
UNITS = ("N", "N", "N", "N m", "N m", "N m")


def resultant(forces: Any, points: ArrayLike, about: ArrayLike | None = None) -> Array:
    """Force and moment (..., 6) of nodal forces: Fx, Fy, Fz, Mx, My, Mz.

    Parameters
    ----------
    forces : array (..., points, 3)
        Nodal forces (N); of tractions, multiply with the areas first.
    points : array (points, 2 or 3)
        Places (m); two columns lie in the plane through `about`.
    about : array (2 or 3,), optional
        Point of the moments (m), default the origin.
    """
    f = finite(forces, "forces")
    if f.ndim < 2 or f.shape[-1] != 3:
        raise InputError("no nodal forces", where="metrics.resultant", found=f"shape {f.shape}",
                         expected="(..., points, 3)", hint="reshape a flat vector with .reshape(-1, 3)")  # fmt: skip
    x = places(points, f.shape[-2])
    o = np.zeros(x.shape[1]) if about is None else finite(about, "about")
    if o.shape != (x.shape[1],):
        raise InputError("no point for the moments", where="metrics.resultant, about", found=f"shape {o.shape}",
                         expected=f"({x.shape[1]},)", hint="as many coordinates as the points have")  # fmt: skip
    arm = np.zeros((len(x), 3))
    arm[:, : x.shape[1]] = x - o
    return np.concatenate([f.sum(axis=-2), np.cross(arm, f).sum(axis=-2)], axis=-1)


@dataclass(frozen=True)
class ResultantErrors:
    """Errors of the resultants over frames, per axis.

    Parameters
    ----------
    labels, units : tuple of str
    std, mae, bias : tuple of float
        Of found minus reference over the frames; std about the bias, as papers print it.
    share : tuple of float or None
        Root mean square error over the range of the reference; None where the reference does not move.
    frames : int
    """

    labels: tuple[str, ...]
    units: tuple[str, ...]
    std: tuple[float, ...]
    mae: tuple[float, ...]
    bias: tuple[float, ...]
    share: tuple[float | None, ...]
    frames: int

    def table(self) -> str:
        """One line for each axis, as text."""
        lines = [f"resultants over {self.frames} frames (level resultant: a map is not validated by them)",
                 f"{'':4s} {'std':>10s} {'MAE':>10s} {'bias':>10s}  {'unit':4s} {'rms, % of range':>16s}"]  # fmt: skip
        for i, label in enumerate(self.labels):
            share = self.share[i]
            shown = "-" if share is None else f"{100 * share:.2f}"
            lines.append(f"{label:4s} {self.std[i]:10.4g} {self.mae[i]:10.4g} {self.bias[i]:10.3g}  {self.units[i]:4s} "
                         f"{shown:>16s}")  # fmt: skip
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.table()


def resultant_errors(found: Any, truth: Any, labels: tuple[str, ...] = LABELS) -> ResultantErrors:
    """Compare resultants over frames.

    Parameters
    ----------
    found, truth : array (frames, R)
        R = 6 (forces in N and moments in N m), 3 (forces), or as many as there are labels.
    labels : tuple of str

    Raises
    ------
    InputError
        Shapes that differ, fewer than two frames, more columns than labels.
    """
    a, b = finite(found, "found"), finite(truth, "truth")
    if a.shape != b.shape or a.ndim != 2 or len(a) < 2 or not 1 <= a.shape[1] <= len(labels):
        raise InputError(
            "resultants over frames do not fit",
            where="metrics.resultant_errors",
            found=f"{a.shape} and {b.shape}",
            expected=f"both (frames, {len(labels)}) or fewer columns, at least two frames",
            hint="metrics.resultant(forces, points) gives one row for each frame",
        )
    e = a - b
    reach = np.ptp(b, axis=0)
    rms = np.sqrt(np.mean(e**2, axis=0))
    count = a.shape[1]
    known = dict(zip(LABELS, UNITS, strict=True))
    return ResultantErrors(
        tuple(labels[:count]),
        tuple(known.get(label, "") for label in labels[:count]),
        tuple(e.std(axis=0, ddof=1).tolist()),
        tuple(np.abs(e).mean(axis=0).tolist()),
        tuple(e.mean(axis=0).tolist()),
        tuple(float(r / w) if w > 0 else None for r, w in zip(rms, reach, strict=True)),
        len(a),
    )
