"""Random bodies for the calls of the lab: strict JSON, nearly so, and rubbish."""

from __future__ import annotations

import http.client
import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from loadid._lab.contract import OneOf, OnOff, Real, Reals, Text, Whole
from loadid._lab.server import Lab

from .client import known

ODD: tuple[Any, ...] = (
    math.nan, math.inf, -math.inf, 1e308, -1e308, 1e-320, 0, -0.0, 10**30, True, False, None, "", "NaN", "1", "é",
    "\ud800", "\x00", [], {}, [1], {"t": 1}, "a" * 300, [[[[]]]],
)  # fmt: skip
SLOW = ("histogram", "tried", "answer")  # calls that compute for a second at first


def right(parameter: Any, rng: np.random.Generator) -> Any:
    """A value that the parameter takes."""
    match parameter:
        case Real(low, high):
            return float(rng.uniform(low, high))
        case Whole(low, high):
            return int(rng.integers(low, min(high, low + 5), endpoint=True))
        case OneOf(names):
            return str(rng.choice(names))
        case OnOff():
            return bool(rng.integers(2))
        case Reals(low, high, most, least):
            return rng.uniform(low, high, rng.integers(least, most, endpoint=True)).tolist()
        case Text():
            return "text"
    raise AssertionError(parameter)


def bodies(lab: Lab, count: int, seed: int, leave: tuple[str, ...] = SLOW) -> Iterator[tuple[str, bytes, bool]]:
    """Call, body, and whether it is right; of all calls but those that are named."""
    rng = np.random.default_rng(seed)
    alone = [page for page in lab.pages.values() if not any(call.upload for call in page.calls.values())]
    calls = [(page.name, name, call) for page in alone for name, call in page.calls.items() if name not in leave]
    for _ in range(count):
        page, name, call = calls[rng.integers(len(calls))]
        given = {key: right(one, rng) for key, one in call.parameters.items()}
        kind, changed = rng.integers(8), True
        if kind == 0:
            changed = False
        elif kind < 4 and given:
            key = str(rng.choice(list(given)))
            given[key] = ODD[rng.integers(len(ODD))]
            try:
                call.read(given)
                changed = False  # odd, but within the range
            except Exception:
                pass
        elif kind == 4:
            given[str(rng.choice(["x", "__class__", "t ", "T"]))] = 1
        elif kind == 5 and given:
            del given[str(rng.choice(list(given)))]
        else:
            text = bytearray(json.dumps(given).encode() or b"{}")
            for _ in range(rng.integers(1, 6)):
                text[rng.integers(len(text))] = rng.integers(256)
            yield f"/{page}/{name}", bytes(text), _is_right(call, bytes(text))
            continue
        body = json.dumps(given).encode()
        yield f"/{page}/{name}", body, not changed or _is_right(call, body)


def _is_right(call: Any, body: bytes) -> bool:
    """By the standard library and the ranges, written out again."""

    def number(text: str) -> float:
        value = float(text)
        if not math.isfinite(value):
            raise ValueError(text)
        return value

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len({k for k, _ in pairs}) < len(pairs):
            raise ValueError("twice")
        return dict(pairs)

    try:
        given = json.loads(body.decode("utf-8"), parse_float=number, parse_constant=number, object_pairs_hook=once)
    except (ValueError, RecursionError):
        return False
    if not isinstance(given, dict) or set(given) != set(call.parameters):
        return False
    return all(_within(one, given[key]) for key, one in call.parameters.items())


def _within(parameter: Any, value: Any) -> bool:
    plain = isinstance(value, int | float) and not isinstance(value, bool)
    match parameter:
        case Real(low, high):
            return plain and low <= value <= high
        case Whole(low, high):
            return plain and isinstance(value, int) and low <= value <= high
        case OneOf(names):
            return isinstance(value, str) and value in names
        case OnOff():
            return value is True or value is False
        case Reals(low, high, most, least):
            return (
                isinstance(value, list)
                and least <= len(value) <= most
                and all(_within(Real(low, high), v) for v in value)
            )
        case Text(longest):
            return isinstance(value, str) and len(value) <= longest and value.isprintable()
    raise AssertionError(parameter)


def accepted(lab: Lab, connection: http.client.HTTPConnection, path: str, body: bytes, right: bool) -> int:
    """Status of one of them: what is right is answered in strict JSON, all else is refused in a sentence."""
    connection.request("POST", path, body, known(lab))
    found = connection.getresponse()
    answer = json.loads(found.read().decode("utf-8"), parse_constant=lambda text: 1 / 0)
    assert (found.status == 400) == (not right), (path, body, found.status, answer)
    if found.status != 200:
        assert len(answer["error"]) < 1000
        assert "Traceback" not in answer["error"]
    return found.status
