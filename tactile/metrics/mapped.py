"""All numbers of one map against its truth, at the level that they reach."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from numpy.typing import ArrayLike

from loadid.flags.validation import resultant_only
from structures.errors import InputError
from structures.flags import Flag

from . import measures
from .resultants import LABELS, UNITS, resultant
from .settled import finite, pair, weights

COMPONENTS = "xyz"


@dataclass(frozen=True)
class MapMetrics:
    """One map against its truth.

    Parameters
    ----------
    level : {"distribution", "resultant"}
        What was compared. At level "resultant" there are no numbers of a map, and `flags` holds N701.
    error : float or None
        Relative L2 error; ideal 0.
    components : tuple of float
        The same for X, Y, Z, each against its own norm (against the whole one where the truth has none of it).
    cosine, iou, peak_ratio, spread : float or None
        Ideal 1. Same shape whatever the gain; overlap of the contact areas; largest magnitude; rms radius.
    dtma, dma, dtmb : float or None
        Ideal 0. Magnitude in the patches, largest magnitude there, leakage outside.
    snr : float or None
        Magnitude in the patches over the std outside, sqrt(var_x + var_y + var_z); large is good.
    centroid_error : float or None
        Distance of the centres (m).
    resultant, reference : tuple of float
        Fx, Fy, Fz (N), Mx, My, Mz (N m) of estimate and truth; empty where no places or areas are known.
    theta : float
        Share of the peak from which a point counts as contact, in `iou`.
    patches : int
        Loaded patches of the truth.
    flags : tuple of Flag
    """

    level: str
    error: float | None = None
    components: tuple[float, ...] = ()
    cosine: float | None = None
    iou: float | None = None
    peak_ratio: float | None = None
    spread: float | None = None
    dtma: float | None = None
    dma: float | None = None
    dtmb: float | None = None
    snr: float | None = None
    centroid_error: float | None = None
    resultant: tuple[float, ...] = ()
    reference: tuple[float, ...] = ()
    theta: float = measures.THETA
    patches: int = 0
    flags: tuple[Flag, ...] = ()

    @property
    def partial(self) -> bool:
        """Resultants alone were compared: the distribution is open."""
        return self.level == "resultant"

    def table(self) -> str:
        """One line for each number with its ideal, as text."""
        lines = [f"level: {self.level}{' (partial)' if self.partial else ''}"]
        for name, value, ideal in self._rows():
            if value is not None:
                lines.append(f"{name:34s} {value:10.4g}   ideal {ideal}")
        for label, unit, a, b in zip(LABELS, UNITS, self.resultant, self.reference, strict=False):
            lines.append(f"{label:34s} {a:10.4g}   truth {b:.4g} {unit}")
        return "\n".join([*lines, *(f"{f.code}: {f.message}" for f in self.flags)])

    def __str__(self) -> str:
        return self.table()

    def to_dict(self) -> dict[str, Any]:
        """Plain texts, numbers and lists."""
        tree = {f.name: getattr(self, f.name) for f in fields(self)}
        return {k: list(v) if isinstance(v, tuple) else v for k, v in tree.items() if k != "flags"} | {
            "flags": [f.to_dict() for f in self.flags]
        }

    def _rows(self) -> list[tuple[str, float | None, str]]:
        millimetres = None if self.centroid_error is None else 1e3 * self.centroid_error
        return [
            ("relative L2 error", self.error, "0"),
            *((f"relative L2 error, {c}", e, "0") for c, e in zip(COMPONENTS, self.components, strict=False)),
            ("cosine", self.cosine, "1"),
            (f"IoU of contact (theta = {self.theta:g})", self.iou, "1"),
            ("peak ratio", self.peak_ratio, "1"),
            ("spread (rms radius)", self.spread, "1"),
            ("DTMA (magnitude in the patches)", self.dtma, "0"),
            ("DMA (peak in the patches)", self.dma, "0"),
            ("DTMB (leakage outside)", self.dtmb, "0"),
            ("SNR", self.snr, "large"),
            ("centroid error (mm)", millimetres, "0"),
        ]


def compare(
    found: Any,
    truth: Any,
    *,
    areas: ArrayLike | None = None,
    points: ArrayLike | None = None,
    labels: ArrayLike | None = None,
    theta: float = measures.THETA,
    quantity: str = "tractions",
    about: ArrayLike | None = None,
) -> MapMetrics:
    """Hold a map against its truth, at level "distribution".

    Parameters
    ----------
    found, truth : array (points, 3)
        Tractions (Pa), or nodal forces (N) where `quantity` is "forces"; on the same points.
    areas : array (points,), optional
        Tributary areas (m^2): weights of all means and norms. Nodal forces need them: they are divided by them, so that
        a coarse node is no larger pressure.
    points : array (points, 2 or 3), optional
        Places (m): patches, centres, spread and moments need them.
    labels : int array (points,), optional
        Patches of the truth, 0 outside; default `measures.patches`.
    theta : float
        Share of the peak from which a point counts as contact.
    quantity : {"tractions", "forces"}
    about : array, optional
        Point of the moments (m).

    Raises
    ------
    InputError
        Shapes that do not fit, NaN, a truth without load, forces without areas.
    """
    a, b = pair(found, truth)
    if quantity not in ("tractions", "forces") or (quantity == "forces" and areas is None):
        raise InputError(
            "nodal forces need the areas of their nodes" if quantity == "forces" else "unknown quantity",
            where="metrics.compare", found=f"quantity={quantity!r}, areas={'none' if areas is None else 'given'}",
            expected='"tractions", or "forces" with areas=', hint="pass areas=surface.areas",
        )  # fmt: skip
    w = weights(areas, len(a))
    if quantity == "forces":
        a, b = (f / finite(areas, "areas")[:, None] for f in (a, b))
    own = measures.patches(b, points) if labels is None else labels
    totals: list[tuple[float, ...]] = [(), ()]
    if areas is not None and points is not None and a.shape[1] == 3:
        share = finite(areas, "areas")[:, None]
        totals = [tuple(resultant(t * share, points, about).tolist()) for t in (a, b)]
    return MapMetrics(
        level="distribution",
        error=measures.relative_error(a, b, w),
        components=tuple(measures.relative_error(a, b, w, i) for i in range(a.shape[1])),
        cosine=measures.cosine(a, b, w),
        iou=measures.iou(a, b, w, theta=theta),
        peak_ratio=measures.peak_ratio(a, b),
        spread=None if points is None else measures.spread(a, b, points, w),
        dtma=measures.dtma(a, b, own, w),
        dma=measures.dma(a, b, own),
        dtmb=measures.dtmb(a, b, own, w),
        snr=measures.snr(a, b, own, w),
        centroid_error=None if points is None else measures.centroid_error(a, b, points, w),
        resultant=totals[0],
        reference=totals[1],
        theta=theta,
        patches=len(set(finite(own, "labels").tolist()) - {0.0}),
    )


def compare_resultants(found: Any, truth: Any, *, loads: int = 10**9) -> MapMetrics:
    """Hold the resultant of a map against a force sensor: level "resultant", which validates no map (N701).

    Parameters
    ----------
    found, truth : array (R,)
        Fx, Fy, Fz (N), and Mx, My, Mz (N m).
    loads : int
        Unknowns of the map.

    Raises
    ------
    InputError
        Shapes that differ, NaN, more than six numbers.
    """
    a, b = finite(found, "found"), finite(truth, "truth")
    if a.shape != b.shape or a.ndim != 1 or not 1 <= len(a) <= len(LABELS):
        raise InputError("resultants do not fit", where="metrics.compare_resultants", found=f"{a.shape} and {b.shape}",
                         expected="both (6,), or fewer", hint="Fx, Fy, Fz, Mx, My, Mz")  # fmt: skip
    flag = resultant_only({"resultant"}, len(a), loads)
    return MapMetrics("resultant", resultant=tuple(a.tolist()), reference=tuple(b.tolist()),
                      flags=() if flag is None else (flag,))  # fmt: skip
