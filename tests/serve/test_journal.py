"""The journal: what is in it after kills, torn writes and damage, and what is dropped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loadid._serve import journal as journals
from loadid._serve.journal import Journal, JournalEntry
from structures.errors import InputError


def some(count: int, seed: int = 0) -> list[JournalEntry]:
    """Entries of two structures, of any bytes."""
    rng = np.random.default_rng(seed)
    serial = {"a": 0, "b": 0}
    found = []
    for _ in range(count):
        name = "ab"[int(rng.integers(2))]
        data = rng.integers(0, 256, int(rng.integers(0, 60))).astype(np.uint8).tobytes()
        found.append(JournalEntry(name, serial[name], f"{serial[name]}:ü", data, bool(rng.integers(2))))
        serial[name] += 1
    return found


def reopened(folder: Path) -> list[JournalEntry]:
    found = Journal(folder)
    entries = list(found.entries())
    found.close()
    return entries


def test_what_was_appended_comes_back_in_order(tmp_path: Path) -> None:
    entries, journal = some(50), Journal(tmp_path)
    for k in range(0, 50, 7):
        journal.append(entries[k : k + 7])
        if k == 21:
            journal.turn()
    journal.close()
    assert reopened(tmp_path) == entries


def test_cut_at_every_byte_gives_the_whole_frames_before_it(tmp_path: Path) -> None:
    entries, journal = some(6), Journal(tmp_path)
    ends = []
    for entry in entries:
        journal.append([entry])
        ends.append(journal.size)
    journal.close()
    (path,) = tmp_path.glob("*.bin")
    data = path.read_bytes()
    for size in range(len(data)):
        path.write_bytes(data[:size])
        assert reopened(tmp_path) == entries[: sum(end <= size for end in ends)]


def test_a_changed_byte_before_the_end_is_refused_or_ends_the_segment(tmp_path: Path) -> None:
    entries, journal = some(6), Journal(tmp_path)
    for entry in entries:
        journal.append([entry])
    journal.close()
    (path,) = tmp_path.glob("*.bin")
    data = path.read_bytes()
    refused = 0
    for k in range(len(data)):
        path.write_bytes(data[:k] + bytes([data[k] ^ 0x10]) + data[k + 1 :])
        try:
            found = reopened(tmp_path)
        except InputError:
            refused += 1
        else:
            assert found == entries[: len(found)]
            assert len(found) < len(entries)
    assert refused > len(data) // 2


def test_a_round_that_is_torn_anywhere_was_never_confirmed(tmp_path: Path) -> None:
    """As a machine without power leaves it: pages of the last write are missing, not the last ones alone."""
    entries, journal = some(12), Journal(tmp_path)
    journal.append(entries[:5])
    begin = journal.size
    journal.append(entries[5:])
    journal.close()
    (path,) = tmp_path.glob("*.bin")
    data = path.read_bytes()
    for k in range(begin + 8, len(data), 7):
        gone = data[k : k + 20]
        if any(gone):
            path.write_bytes(data[:k] + bytes(len(gone)) + data[k + 20 :])
            assert reopened(tmp_path) == entries[:5]


def test_segments_that_all_have_left_behind_are_dropped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journals, "SEGMENT", 400)
    entries, journal = some(60), Journal(tmp_path)
    for entry in entries:
        journal.append([entry])
    assert len(list(tmp_path.glob("*.bin"))) > 4
    reached = {"a": 10, "b": 12}
    journal.forget(reached)
    left = list(journal.entries())
    assert [e for e in entries if e.serial >= reached[e.to]] == [e for e in left if e.serial >= reached[e.to]]
    assert len(left) < len(entries)
    journal.turn()
    journal.forget({"a": 60, "b": 60})
    journal.close()
    assert not list(tmp_path.glob("*.bin"))


def test_of_a_halted_structure_alone_its_entries_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journals, "SEGMENT", 2000)
    halted = [JournalEntry("a", k, "", b"x" * 10) for k in range(40)]
    others = [JournalEntry("b", k, "", b"y" * 100) for k in range(40)]
    journal = Journal(tmp_path)
    for one, other in zip(halted, others, strict=True):
        journal.append([one, other])
    journal.turn()
    before = journal.size
    journal.forget({"a": 0, "b": 40})
    assert journal.size < 0.5 * before
    assert list(journal.entries()) == halted
    journal.close()
    assert reopened(tmp_path) == halted


def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="journal cannot be written"):
        Journal(tmp_path / "absent")


def test_an_empty_segment_is_not_turned_and_a_copy_is_none(tmp_path: Path) -> None:
    journal = Journal(tmp_path)
    for _ in range(3):
        journal.turn()
        journal.forget({})
    assert [path.name for path in tmp_path.glob("*.bin")] == ["journal-00000001.bin"]
    journal.append(some(5))
    journal.close()
    (tmp_path / "journal-00000001-copy.bin").write_bytes((tmp_path / "journal-00000001.bin").read_bytes())
    assert reopened(tmp_path) == some(5)


def test_segments_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    entries, journal = some(4), Journal(tmp_path)
    journal._number = 99_999_998
    for entry in entries:
        journal.turn()
        journal.append([entry])
    journal.close()
    assert reopened(tmp_path) == entries


def test_what_only_a_halted_structure_needs_is_not_read_again_and_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = Journal(tmp_path)
    journal.append([JournalEntry("a", k, "", b"x" * 100) for k in range(9)] + [JournalEntry("b", 0, "", b"y")])
    journal.turn()
    read: list[Path] = []
    real = journals._frames
    monkeypatch.setattr(journals, "_frames", lambda path: (read.append(path), real(path))[1])
    for _ in range(5):
        journal.forget({"a": 0, "b": 1})
    assert len(read) == 1
    journal.forget({"a": 9, "b": 1})
    journal.close()
    assert not list(tmp_path.glob("*.bin"))
