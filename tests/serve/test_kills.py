"""A server behind a real broker, killed again and again: no sample lost, none doubled."""

from __future__ import annotations

from pathlib import Path

from .broker import tortured


def test_kills_behind_a_broker_lose_and_double_nothing(tmp_path: Path) -> None:
    found = tortured(tmp_path, 8)
    assert found["same"] == {"stamped": True, "bare": True}
    assert found["rows"] == dict.fromkeys(found["rows"], found["sent"])
