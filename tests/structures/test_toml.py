"""TOML that would cost far more than its size, at every door that takes one."""

import time

import pytest

from loadid._toml import read
from structures import _toml
from structures.errors import InputError
from tactile._pad import padfile

BOMBS = {
    "a key of 50 000 parts": ".".join("a" * 50_000) + " = 1\n",
    "quoted parts that hold commas": ".".join(['"a,"'] * 20_000) + " = 1\n",
    "a table of 50 000 parts": "[" + ".".join("a" * 50_000) + "]\n",
    "an inline table": "x = {" + ".".join("a" * 50_000) + " = 1}\n",
    "deep arrays": "x = " + "[" * 100_000 + "]" * 100_000 + "\n",
    "deep tables": "x = " + "{a = " * 20_000 + "1" + "}" * 20_000 + "\n",
    "a number of 200 000 digits": "x = " + "9" * 200_000 + "\n",
    "no text": b"\xff\xfe\x00",
    "no end": 'x = "' + "a" * 1000,
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_what_is_larger_than_people_write_is_refused_at_once(tmp_path, bomb):
    path = tmp_path / "pad.toml"
    data = BOMBS[bomb]
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    begin = time.process_time()
    for door in (read, padfile._tables):
        with pytest.raises(InputError, match=r"pad\.toml"):
            door(path)
    assert time.process_time() - begin < 2.0  # a tenth of it here; the parser alone takes minutes


def test_a_file_without_end_is_not_read_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(_toml, "LARGEST", 1000)
    path = tmp_path / "plan.toml"
    path.write_text("# " + "x" * 2000)
    with pytest.raises(InputError, match="more than 1000 characters"):
        read(path)


def test_ordinary_files_are_read_as_before(tmp_path):
    import tomllib

    text = 'a.b."c.d".e = 1.5\nwords = "Dots. Dots. ' + "Dots. " * 50 + '"\n[x.y]\nz = [' + "1.25, " * 500 + "]\n"
    path = tmp_path / "plan.toml"
    path.write_text(text)
    assert read(path) == tomllib.loads(text)
