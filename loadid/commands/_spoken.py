"""Advice as it is given on the command line: what only Python has gets its option, or is said to be Python."""

from __future__ import annotations

import re

# "--fs HZ on the command line, fs=HZ in Python": here the first half is enough
_BOTH = re.compile(r" on the command line, [^;]*? in Python\b")
_PLAIN = {
    "--fs HZ, fs=HZ": "--fs HZ",
    "--columns (columns=)": "--columns",
    "(--fs, dt=)": "(--fs)",
    "--fs / dt= as recorded": "--fs as recorded",
    "(penalty='identity')": "(--penalty identity)",
    "choose penalty='identity'": "choose --penalty identity",
    "pass choice=<relative lambda>": "give a relative lambda with --choice",
    "repeat the hits, or pass reject=False where a rejected one is good enough": "repeat the hits",
    "; axis= states it)": "; --axis states it)",
    "leave the channel out (sensors=[...])": "calibrate a model without this channel",
    "leave the sensor out (sensors=[...])": "calibrate a model without this sensor",
    "select channels or a window without the gap": "record again, or cut the gap out of the file",
    "give noise= per channel, or record": "record",
    "name the source with noise_source=": "choose another rule with --choice",
    "run loadid.validate.coverage(...) with loads like yours and pass coverage=": (
        "test it in Python: loadid.validate.coverage(...) with loads like yours"
    ),
    "call model.verify(load, response)": "in Python call model.verify(load, response)",
}


def spoken(text: str) -> str:
    """The text with the command-line form of every advice."""
    text = _BOTH.sub("", text)
    for python, option in _PLAIN.items():
        text = text.replace(python, option)
    return text
