"""Advice as it is given on the command line: settings of Python get their option, or their key in the pad file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from structures.errors import InputError

PLAIN = {
    "allow=['E603'] overrides": "--allow E603 overrides",
    "depth= a measured map, indenter= a known shape, or markers tracked along X, Y and Z": (
        "depth maps (--depth), or markers tracked along x, y and z"
    ),
    "MultilayerPad inverts in-plane markers alone": "--sensor multilayer inverts in-plane markers alone",
    "dark=False looks for bright dots; radius= and pitch= state their size in px": (
        "in the pad file, [markers] dark = false looks for bright dots; radius and pitch state their size in px"
    ),
    "dark=False looks for bright dots": "in the pad file, [markers] dark = false looks for bright dots",
    "unloaded=[frame, frame, frame, ...] or noise= in px": (
        'unloaded frames (--unloaded), or [markers] noise = "0.02 px" in the pad file'
    ),
    "a lossy video freezes still areas; state noise= in px": (
        'a lossy video freezes still areas; state [markers] noise = "0.02 px" in the pad file'
    ),
    "key= names it": "save the images alone in a file",
    "rest= names the unloaded frame": "begin with a frame of the unloaded pad",
    "centre= places it": "in the pad file, [depth] centre places it",
    "(wrench=), or take a smaller lambda": "(in Python: wrench=), or take a smaller lambda (--lam)",
    "layers=4 with B-bar elements": "in the pad file, [pad] layers = 4",
}


def spoken(text: str) -> str:
    """The text with options and keys instead of settings of Python."""
    for python, said in PLAIN.items():
        text = text.replace(python, said)
    return text


@contextmanager
def plainly() -> Iterator[None]:
    """Errors in the words of the command line."""
    try:
        yield
    except InputError as error:
        parts = {
            name: spoken(value) if isinstance(value, str) else value
            for name in ("where", "found", "expected", "hint", "code")
            for value in [getattr(error, name)]
        }
        raise InputError(spoken(error.what), **parts) from error
