"""The page of the gel pad: its calls, and what they may be given."""

from __future__ import annotations

from typing import Any

from loadid._lab.contract import Call, OnOff, Page, Real, rounded

MOST = 60.0  # times the noise of the camera
STILL = {
    "detect": ("dots", "found", "markers"), "match": ("rest", "motion", "lost", "largest", "pitch"),
    "interpolate": ("nodes",), "correct": ("points",), "normal": ("x", "fine", "truth"),
    "map": ("x", "y", "nodes", "true_pressure", "true_shear", "true_force"),
}  # fmt: skip


def _walk(known: bool, **given: Any) -> dict[str, Any]:
    """All six steps; where the page holds an answer to the same dots and eye, without what is `STILL` so."""
    from .walk import Steps, walk

    found = walk(Steps(**given))
    for step, names in STILL.items() if known else ():
        found[step] = {name: value for name, value in found[step].items() if name not in names}
    answer: dict[str, Any] = rounded(found, 5)
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
        "walk": Call(
            _walk,
            {
                **{name: OnOff() for name in ("vanish", "naive", "ignored", "uncorrected", "wrong", "ridge")},
                "noise": Real(1.0, MOST),
                "known": OnOff(),
            },
        ),
        "picture": Call(_picture, {"vanish": OnOff(), "rest": OnOff()}),
    },
)
