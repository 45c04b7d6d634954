"""Where the measured records lie."""

import os
from pathlib import Path

import pytest


def data_folder() -> Path | None:
    """Folder of the measured records, or None where they are absent."""
    places = [os.environ.get("LOADID_DATA"), Path(__file__).resolve().parents[2] / "shared" / "data"]
    return next((Path(p) for p in places if p and Path(p).is_dir()), None)


def measured(*parts: str) -> Path:
    """Path of one measured file; skips the test where it is absent."""
    folder = data_folder()
    if folder is None or not folder.joinpath(*parts).exists():
        pytest.skip(f"measured records not found (set LOADID_DATA): {'/'.join(parts)}")
    return folder.joinpath(*parts)
