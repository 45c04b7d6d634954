"""Guards W601 and E602: half-space and Hertz formulas on a pad that is not thick against the contact."""

from __future__ import annotations

from collections.abc import Iterable

from structures.errors import NotIdentifiable
from structures.flags import Evidence, Flag, canonical
from structures.values import positive

from ..layer import Layer
from ..presses import Press

WARN, REFUSE = 0.1, 0.3  # contact radius over thickness
EDGE = 4.0  # thicknesses to the edge of the pad


def too_soft(ratio: float, nu: float) -> float:
    """Per cent of the depth of a half-space at the middle of a Hertz press that a bonded layer does not have.

    Parameters
    ----------
    ratio : float
        Contact radius over thickness.
    nu : float
        Poisson's ratio.
    """
    layer, press = Layer(h=1.0, E=1.0, nu=nu), Press(radius=positive("a/t", ratio, where="too_soft"))
    ours, theirs = (press.displacement(ground, [[0.0, 0.0]])[0, 2] for ground in (layer, layer.half_space))
    return float(100 * (1 - ours / theirs))


def thin_pad(
    radius: float, thickness: float, nu: float, *, what: str = "half-space", allow: Iterable[str] = ()
) -> Flag | None:
    """W601 above a contact of 0.1 thicknesses; E602 above 0.3.

    Parameters
    ----------
    radius : float
        Contact radius a (m).
    thickness : float
        Thickness t of the bonded pad (m).
    nu : float
        Poisson's ratio of the pad.
    what : str
        The formula, as the message names it.
    allow : iterable of str
        ``("E602",)`` turns the refusal into a flag.

    Raises
    ------
    NotIdentifiable
        Code LID-E602, with the number, unless it is allowed.
    """
    ratio = positive("radius", radius, where=what, unit="m") / positive("thickness", thickness, where=what, unit="m")
    if not ratio > WARN:
        return None
    message = (
        f"the {what} is {too_soft(ratio, nu):.0f} % too soft here: "
        f"contact radius / thickness = {ratio:.3g}, nu = {nu:g}"
    )
    advice = "use the bonded layer (tactile.layer.Layer) or a finite-element pad, for validation too"
    if ratio <= REFUSE:
        return Flag("W601", Evidence("contact radius / thickness", ratio, WARN), message, advice)
    if "LID-E602" not in {canonical(code) for code in ([allow] if isinstance(allow, str) else allow)}:
        raise NotIdentifiable(
            f"{message}, above {REFUSE:g}",
            advice=f'{advice}; allow=("E602",) uses it all the same',
            code="LID-E602",
        )
    return Flag(
        "E602", Evidence("contact radius / thickness", ratio, REFUSE), message + ", allowed by the user", advice
    )


def near_edge(distance: float, thickness: float) -> Flag | None:
    """W601 for an infinite layer or a half-space: a load nearer to the edge of the pad than four thicknesses.

    Parameters
    ----------
    distance : float
        From the rim of the contact to the edge of the pad (m).
    thickness : float
        Thickness of the pad (m).
    """
    ratio = distance / positive("thickness", thickness, where="near_edge", unit="m")
    if ratio >= EDGE:
        return None
    return Flag(
        "W601",
        Evidence("distance to the edge / thickness", ratio, EDGE),
        f"the load is {ratio:.2g} thicknesses from the edge of the pad: the formula knows no edge",
        "use a finite-element pad with its free edges, or press in the middle",
    )
