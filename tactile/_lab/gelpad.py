"""The page of the gel pad: its calls, and what they may be given."""

from __future__ import annotations

from typing import Any

from loadid._lab.contract import Call, OnOff, Page, Real, rounded

MOST = 60.0  # times the noise of the camera
DIGITS = 4
SWITCHES = {name: OnOff() for name in ("vanish", "naive", "ignored", "uncorrected", "wrong")}


def _steps(**given: bool) -> dict[str, Any]:
    """Steps 1 to 5, and the map after each: the later ones done rightly, at the noise of the camera."""
    from .walk import Steps, shown

    answer: dict[str, Any] = rounded(shown(Steps(**given)), DIGITS)
    return answer


def _solve(**given: Any) -> dict[str, Any]:
    """Step 6, behind the others as they are done."""
    from .walk import Steps, solved

    answer: dict[str, Any] = rounded(solved(Steps(**given)), DIGITS)
    return answer


def _picture(vanish: bool, rest: bool) -> dict[str, str]:
    from .walk import picture

    return {"image": picture(vanish, rest)}


page = Page(
    "gelpad",
    "Gel pad walkthrough",
    "A ball presses a gel pad, a camera sees dots move, and six steps make a force map: each rightly, or wrongly.",
    "tactile._lab",
    "files/gelpad.html",
    {
        "steps": Call(_steps, SWITCHES),
        "solve": Call(_solve, {**SWITCHES, "ridge": OnOff(), "noise": Real(1.0, MOST)}),
        "picture": Call(_picture, {"vanish": OnOff(), "rest": OnOff()}),
    },
)
