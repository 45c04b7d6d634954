"""A force map in words: the numbers of one frame as a reader asks for them, for the terminal and the report."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from loadid.summary import plus_minus

if TYPE_CHECKING:
    from .forcemap import ForceMap

AXES = "xyz"
HOW = {
    "tracked": "tracked by the markers",
    "measured": "measured by a depth map",
    "completed": "completed, not measured",
    "unknown": "not known",
}


def numbers(one: ForceMap) -> list[tuple[str, str, str]]:
    """Name, value and remark of what one frame says: force, torque, pressure, contact.

    Parameters
    ----------
    one : ForceMap
        A single frame.
    """
    force, torque, contact = one.resultant(), one.torque(), one.contact()
    rows = [_vector("force on the pad", force.value, force.std, "N", "(x, y, z), the pad is pressed along -z")]
    rows.append(_vector("torque", 1e3 * torque.value, 1e3 * torque.std, "N mm", "about the centre of the surface"))
    spread = _peak_std(one)
    rows.append(("peak pressure", f"{plus_minus(1e-3 * contact.peak, 1e-3 * spread)} kPa", "largest at a node"))
    if not contact.mask.any():
        return [*rows, ("contact", "none", "no pressure stands clear of its noise")]
    x, y = 1e3 * contact.centre
    area, size = 1e6 * contact.area, 1e3 * contact.radius
    slip = float(np.nanmedian(contact.slip))
    rows.append(("contact radius", f"{size:.3g} mm", "of the Hertz pressure with the same second moment"))
    rows.append(("contact", f"{area:.3g} mm²", f"about ({x:.3g}, {y:.3g}) mm; shear over pressure {slip:.2g}"))
    return rows


def provided(force: ForceMap) -> str:
    """Where each component of the motion comes from, in words."""
    found = force.provided
    groups: dict[str, list[str]] = {}
    for axis, how in found.items():
        groups.setdefault(how, []).append(f"u_{axis}")
    return "; ".join(f"{', '.join(names)} {HOW.get(how, how)}" for how, names in groups.items())


def _vector(name: str, value: np.ndarray, std: np.ndarray, unit: str, remark: str) -> tuple[str, str, str]:
    parts = ", ".join(plus_minus(float(v), float(s)) for v, s in zip(value.ravel(), std.ravel(), strict=True))
    return name, f"({parts}) {unit}", remark


def _peak_std(one: ForceMap) -> float:
    spread = one.std.reshape(-1, 3)[:, 2]
    k = int(np.argmax(one.pressure()))
    nodal = one.geometry is not None and one.geometry["kind"] == "nodal"
    return float(spread[k] / one.areas[k] if nodal else spread[k])
