"""Damaged files of every kind that is no log (`tests/loadid/readers/test_registry.py` has those): seeded mutants."""

import re

import pytest

from tests.benchmarks.fuzz import doors, outcomes

COUNT = 40


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    for library in ("PIL", "h5py"):
        pytest.importorskip(library)
    folder = tmp_path_factory.mktemp("doors")
    return {d.name: d for d in doors(folder)}, folder


NAMES = (
    "frf uff text", "frf uff binary", "frf sdynpy", "frf simcenter", "frf text", "matrices m.npz", "matrices own.h5",
    "matrices m.mtx", "matrices m.hdf5", "matrices signed", "model", "space", "result", "model signed",
    "space signed", "result signed", "pad.toml", "plan.toml", "images stack.npy", "images stack.npz", "images one.png",
    "markers motion.npy", "markers motion.csv",
)  # fmt: skip


def test_every_door_is_here(made):
    assert set(made[0]) == set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_only_an_input_error_leaves_a_door(made, name):
    seen = list(outcomes(made[0][name], COUNT, made[1]))
    said = [outcome for _, outcome, _ in seen if outcome in ("refused", "flagged")]
    assert len(said) > 0.25 * COUNT
    assert max(seconds for _, _, seconds in seen) < 8.0
    cut = [outcome for kind, outcome, _ in seen if kind == "truncated"]
    if name not in ("frf text", "markers motion.csv"):  # a table cut at the end of a row is whole
        assert "shorter" not in [outcome for _, outcome, _ in seen]
    if not re.search("toml|csv|text", name):
        assert set(cut) <= {"refused", "same"}
    if name in ("model", "space", "result"):  # a hash stands over every byte
        assert {outcome for _, outcome, _ in seen} <= {"refused", "same"}
