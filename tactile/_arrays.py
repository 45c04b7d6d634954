"""Numbers and arrays as users give them, settled or refused: what every room of this package asks for.

The ranges of gel pads are those outside which no pad was ever built, so that what lies there is another unit. They are
asked of pads, markers, depth maps and cameras; closed forms, which hold at any scale, do not ask.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._advice import Advice, Spelling
from structures.errors import InputError, positive, reals

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]
Shape = tuple[int | None, ...]
PLANE: Shape = (None, 2)
SPACE: Shape = (None, 3)


class UnusableFrame(InputError):
    """A frame that tells nothing (black, unreadable, of another size): a stream goes on without it."""


@dataclass(frozen=True)
class Range:
    """What a quantity of a gel pad can be at all, and what it usually is, both in its SI unit.

    `others` are units that it may have been typed in, with their factor to the SI unit; the one that would make it
    usual is named in the refusal.
    """

    unit: str
    possible: tuple[float, float]
    usual: tuple[float, float]
    others: tuple[tuple[str, float], ...]

    def positive(self, name: str, value: Any, *, where: str, hint: str = "") -> float:
        """A positive number that lies in the range; refused with the unit that it is likely in."""
        return self.inside(name, positive(name, value, where=where, unit=self.unit), where=where, hint=hint)

    def inside(self, name: str, value: float, *, where: str, hint: str = "") -> float:
        """A number (or the largest of many) whose size lies in the range, as it is."""
        low, high = self.possible
        if low <= abs(value) <= high:
            return value
        raise InputError(
            f"{name} is not of the scale of a gel pad", where=where, found=f"{value:.4g} {self.unit}",
            expected=f"{low:g} to {high:g} {self.unit}", hint="; ".join(x for x in (self.likely(value), hint) if x),
        )  # fmt: skip

    def likely(self, value: float) -> str:
        """Units in which a number would be a usual one, in words."""
        low, high = self.usual
        fits = [(name, f * value) for name, f in self.others if low <= abs(f * value) <= high]
        if not fits:
            return f"look at its unit and the decimal point: it is taken in {self.unit}"
        return " or ".join(f"if it was typed in {name} it is {v:.4g} {self.unit}" for name, v in fits)


LENGTHS = (("mm", 1e-3), ("um", 1e-6), ("cm", 1e-2))
# Gels of traction force microscopy are 30 um thick and 100 um wide, fingertips (GelSight, DIGIT, FEATS) 1 to 5 mm
# thick and 15 to 40 mm wide, air-backed ones up to 30 mm thick, patches of robot skin up to half a metre wide
THICKNESS = Range("m", (1e-5, 0.1), (3e-4, 0.02), LENGTHS)
SIDE = Range("m", (5e-5, 1.0), (3e-3, 0.1), LENGTHS)
PITCH = Range("m", (1e-6, 0.1), (1e-4, 5e-3), LENGTHS)
PLACE = Range("m", (0.0, 1.0), (1e-3, 0.05), LENGTHS)
CONTACT = Range("m", (1e-6, 0.1), (3e-4, 0.02), LENGTHS)
# A marker is located to 0.002 to 0.5 px of 1 to 100 um; a pixel of a depth map lies between that of a microscope and
# that of a time-of-flight camera (3 mm); its noise is at best interferometric, at worst a few mm
JITTER = Range("m", (1e-10, 1e-3), (5e-8, 1e-4), (("um", 1e-6), ("mm", 1e-3), ("px of 50 um", 5e-5)))
MOTION = Range("m", (0.0, 0.1), (1e-6, 5e-3), (("mm", 1e-3), ("um", 1e-6)))
PIXEL = Range("m", (1e-7, 5e-3), (5e-6, 8e-4), LENGTHS)
NOISE = Range("m", (1e-10, 5e-3), (5e-7, 5e-4), LENGTHS)
# From endoscopes to cameras beside the robot; the path in window and gel is no longer
DISTANCE = Range("m", (1e-4, 2.0), (5e-3, 0.2), LENGTHS)
BEHIND = Range("m", (0.0, 0.5), (5e-4, 0.05), LENGTHS)
# Hydrogels and the softest silicones have 1 kPa, rubbers at most 0.1 GPa; what lies between this and the range of W111
# is questioned, not refused
MODULUS = Range("Pa", (500.0, 1e9), (1e4, 1e7), (("kPa", 1e3), ("MPa", 1e6), ("mPa", 1e-3)))


def squashed(E: float, nu: float, size: tuple[float, float], thickness: float) -> float:
    """Force (N) that would press a whole bonded pad flat: its apparent stiffness at a strain of one, times its area.

    Apparent modulus of a bonded block, E (1 + 2 S^2) with S the loaded over the free area (Gent and Lindley 1959), no
    more than that of a layer without edges. The strain is no measured one: no pad survives it.
    """
    a, b = size
    shape = a * b / (2 * thickness * (a + b))
    confined = (1 - nu) / ((1 + nu) * (1 - 2 * nu)) if nu < 0.5 else math.inf
    return E * a * b * min(1 + 2 * shape**2, max(confined, 1.0))


PULLED, OVER = 0.1, 3.0  # of the thickness, and over the deepest place: how far out a surface may stand
IMAGE = 30.0  # of the thickness: grey levels, or numbers in another unit
SURE = 6.0  # stds of the noise beyond which no place of some thousands lies by chance


def settled_depth(lowest: float, highest: float, thickness: float, noise: float = 0.0) -> None:
    """Refuse normal motion (m) that goes through the base of a pad, or stands out of it as a press does.

    Beside a press the surface rises by a small part of its depth; what sticks to a gel lifts it by a few hundredths of
    the thickness before it lets go (10 kPa of tack on 100 kPa), and small strain ends at a tenth. `noise` is the std of
    the motion (m).
    """
    if lowest < -thickness - SURE * noise:
        raise InputError(
            "a depth below the base of the pad", where="depth", found=f"{lowest:.4g} m",
            expected=f"above {-thickness:g} m, the thickness",
            hint=THICKNESS.likely(lowest) + "; motion from the unloaded surface is meant, no distance",
        )  # fmt: skip
    if highest > IMAGE * thickness:
        raise InputError("these are no depths", where="depth", found=f"up to {highest:.4g} m outward",
                         expected=f"motion of the surface of a pad that is {thickness:g} m thick",
                         hint=Advice("name depth maps here, not images of the markers, and mind the unit of their "
                                     "numbers: ", Spelling("m", '[depth] unit = "mm" in the pad file')))  # fmt: skip
    if highest > PULLED * thickness + SURE * noise and highest > -OVER * lowest:
        raise InputError(
            "the depth map pulls the surface out", where="depth", found=f"up to {highest:.4g} m outward",
            expected=f"a press is negative; a pull of less than {PULLED * thickness:.2g} m",
            hint=Advice("turn the sign: ", Spelling("DepthMap(-values, ...)",
                        '[depth] pressed = "positive" in the pad file'),
                        "; or take off what the unloaded pad shows",
                        Spelling("", " ([depth] absolute = true)")),
        )  # fmt: skip


def shaped(
    values: Any, *shapes: Shape, where: str, what: str = "", fewest: int = 0, lost: bool = False, hint: str = ""
) -> Array:
    """Real numbers in one of some shapes, any if none is named, as a new array; None stands for any length.

    An empty list is an array of no rows. There must be `fewest` rows; NaN may be among them where some are `lost`,
    infinity never.
    """
    found = reals(values, where=where, hint=hint)
    if found.shape == (0,) and shapes and shapes[0][:1] == (None,):
        found = found.reshape(0, *(n or 0 for n in shapes[0][1:]))
    fits = not shapes or any(
        len(s) == found.ndim and all(n in (None, m) for n, m in zip(s, found.shape, strict=True)) for s in shapes
    )
    sound = not np.isinf(found).any() and (lost or not np.isnan(found).any())
    if fits and sound and (not fewest or len(found) >= fewest):
        return found
    words = " or ".join(f"({', '.join('n' if n is None else str(n) for n in s)}{',' * (len(s) == 1)})" for s in shapes)
    bad = "" if sound else ", infinity" if lost else ", NaN or infinity"
    raise InputError(
        what or "an array that does not fit", where=where, found=f"shape {found.shape}{bad}",
        expected=f"{'' if lost else 'finite '}{words}" + (f", n at least {fewest}" if fewest else ""), hint=hint,
    )  # fmt: skip
