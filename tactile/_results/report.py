"""A force map in words for the terminal, and as one self-contained HTML page."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from loadid import _page
from loadid._page import Html, PageSection
from loadid._results import report as parts
from loadid._results.summary import plus_minus

if TYPE_CHECKING:
    from .contacts import Contact
    from .forcemap import ForceMap


AXES = "xyz"
HOW = {
    "tracked": "tracked by the markers",
    "measured": "measured by a depth map",
    "completed": "completed, not measured",
    "unknown": "not known",
}


def numbers(one: ForceMap) -> list[tuple[str, str, str]]:
    """Name, value and remark of what a single frame says: force, torque, pressure, contact."""
    force, torque, contact = one.resultant(), one.torque(), one.contact()
    rows = [_vector("force on the pad", force.value, force.std, "N", "(x, y, z), the pad is pressed along -z")]
    rows.append(_vector("torque", 1e3 * torque.value, 1e3 * torque.std, "N mm", "about the centre of the surface"))
    spread = float(one.pressure_std()[int(np.argmax(one.pressure()))])
    rows.append(("peak pressure", f"{plus_minus(1e-3 * contact.peak, 1e-3 * spread)} kPa", "largest at a node"))
    if not contact.mask.any():
        return [*rows, ("contact", "none", "no pressure stands clear of its noise")]
    x, y = 1e3 * contact.centre
    area, size = 1e6 * contact.area, 1e3 * contact.radius
    slip = float(np.nanmedian(contact.slip))
    rows.append(("contact radius", f"{size:.3g} mm", "of the Hertz pressure with the same second moment"))
    rows.append(("contact", f"{area:.3g} mm²", f"about ({x:.3g}, {y:.3g}) mm; shear over pressure {slip:.2g}"))
    several = one.contacts()
    return rows if len(several) < 2 else [*rows, *map(_of_several, range(1, len(several) + 1), several)]


def _of_several(number: int, contact: Contact) -> tuple[str, str, str]:
    """One of several contacts: its force, and where it is."""
    x, y = 1e3 * contact.centre
    remark = f"{1e6 * contact.area:.3g} mm² about ({x:.3g}, {y:.3g}) mm"
    return _vector(f"contact {number}", contact.force.value, contact.force.std, "N", remark)


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


def write_report(
    force: ForceMap,
    path: str | os.PathLike[str],
    *,
    truth: ArrayLike | None = None,
    wrenches: ArrayLike | None = None,
    frame: int | None = None,
    about: Iterable[tuple[str, str]] = (),
    compared: Iterable[tuple[str, ...]] = (),
) -> None:
    """Write the page, whole or not at all; the settings are those of `page`."""
    _page.write_page(
        path, lambda: page(force, truth=truth, wrenches=wrenches, frame=frame, about=about, compared=compared)
    )


def page(
    force: ForceMap,
    *,
    truth: ArrayLike | None = None,
    wrenches: ArrayLike | None = None,
    frame: int | None = None,
    about: Iterable[tuple[str, str]] = (),
    compared: Iterable[tuple[str, ...]] = (),
) -> str:
    """The page as text, of one frame or of a sequence, pictured as `tactile._results.pictures.sequence_figure`.

    `about` tells how the map came about, names and texts; `compared` name, estimate and truth of what was compared.
    """
    k = force.chosen(frame)
    one = force if force.single else force.frame(k)
    name = "" if force.single else f", {force.frame_name(k)}"
    sections = [
        PageSection(f"Result{name}", _picture(force, one, truth, wrenches, frame)),
        PageSection("Against the truth", _compared(compared)),
        PageSection("Cautions", parts.cautions(force)),
        PageSection("How it came about", _about(force, about), folded=True),
        PageSection("Flags", parts.flag_list(force.flags), folded=True),
        PageSection("Verification", parts.verification(force), folded=True),
        PageSection("Provenance", parts.provenance_table(force), folded=True),
    ]
    return _page.document("Contact force map", sections, about=parts.about(force), answer=_answer(force, one))


def _answer(force: ForceMap, one: ForceMap) -> Html:
    """The force with its grade, then torque, pressure and contact."""
    (name, value, remark), *others = numbers(one)
    return _page.joined(
        parts.refused(force),
        _page.part("answer", name, value, "± one standard deviation", force.grade.letter, str(force.grade)),
        _page.part("quiet", remark),
        _page.part("cards", others),
        parts.checked(force),
    )


def _picture(
    force: ForceMap, one: ForceMap, truth: ArrayLike | None, wrenches: ArrayLike | None, frame: int | None
) -> Html:
    from loadid._plots.style import drawn

    from .pictures import sequence_figure

    name, value, _ = numbers(one)[0]
    wide, narrow = (
        drawn(sequence_figure(force, truth=truth, wrenches=wrenches, frame=frame, narrow=narrow), "png")
        for narrow in (False, True)
    )
    return _page.image(wide, f"map of pressure and shear with its std: {name} {value}", narrow)


def _compared(rows: Iterable[tuple[str, ...]]) -> Html | str:
    listed = list(rows)
    return _page.table(listed, ("", "estimate", "truth")) if listed else ""


def _about(force: ForceMap, about: Iterable[tuple[str, str]]) -> Html:
    facts = force.facts
    rows = [*about]
    said = {name for name, _ in rows}
    own = [
        ("motion", provided(force)),
        ("frames", "1" if force.single else str(len(force.load))),
        ("lambda", "" if facts.lam is None else f"{facts.lam:.3g} by {facts.lambda_rule}"),
        ("readings and loads", f"{facts.get('m', '?')} and {facts.n}" if "n" in facts else ""),
        ("solved by", _path(facts.get("path"))),
    ]
    rows += [(name, text) for name, text in own if text and name not in said]
    prior = force.provenance.get("prior")
    filled = f"What the data do not determine is filled by the prior: {prior}." if prior else ""
    return _page.joined(_page.table(rows), _page.paragraphs(filled))


def _path(path: object) -> str:
    """How the frames were solved; what counts the steps of each is cut."""
    if isinstance(path, list):
        return "; ".join(dict.fromkeys(str(p).rpartition(", ")[0] or str(p) for p in path))
    return "" if path is None else str(path)
