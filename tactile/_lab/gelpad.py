"""The page of the gel pad: its calls, and what they may be given."""

from __future__ import annotations

from typing import Any

from loadid._lab.contract import Call, OnOff, Page, Real, rounded

MOST = 60.0  # times the noise of the camera


def _walk(**given: Any) -> dict[str, Any]:
    from .walk import Steps, walk

    found: dict[str, Any] = rounded(walk(Steps(**given)), 5)
    return found


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
        "walk": Call(
            _walk,
            {
                **{name: OnOff() for name in ("vanish", "naive", "ignored", "uncorrected", "wrong", "ridge")},
                "noise": Real(1.0, MOST),
            },
        ),
        "picture": Call(_picture, {"vanish": OnOff(), "rest": OnOff()}),
    },
)
