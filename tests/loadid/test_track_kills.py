"""A tracked stream that is killed at random moments continues bit for bit: no sample is lost, none comes twice."""

import os

import pytest

from loadid._families.tracking import tracker as checkpoint
from loadid._stream import follow
from tests.killed import Nursery, fitted, leaves, tortured, troubled

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork and SIGKILL")


@pytest.fixture(scope="module")
def nursery():
    found = Nursery()
    yield found
    found.close()


def test_killed_and_undisturbed_runs_write_the_same_bytes(nursery, tmp_path):
    tracker, Y = fitted(lag=6, replay=12)
    tracker.save(tmp_path / "model.h5")
    data = troubled(tracker, Y)
    resumed, cut = tortured(nursery, tmp_path, data, 5)
    assert resumed >= 3, cut  # the kills met checkpoints
    (tmp_path / "whole.csv").write_bytes(data)
    straight = checkpoint.load(tmp_path / "model.h5")
    straight._engine.loop.compile()
    done = follow(straight, str(tmp_path / "whole.csv"), str(tmp_path / "straight.csv"), idle=0)
    assert {"filled", "duplicated", "late", "replayed", "wide", "unreadable", "missing"} <= set(done.counts)
    assert (tmp_path / "out.csv").read_bytes() == (tmp_path / "straight.csv").read_bytes()
    killed, stream = checkpoint.read(tmp_path / "state.h5")
    assert list(leaves(killed.to_tree())) == list(leaves(straight.to_tree()))
    counted = {**stream["lines"], **stream["clock"]["counts"]}
    assert {k: v for k, v in counted.items() if v} == {k: v for k, v in done.counts.items() if k in counted}
    assert not list(tmp_path.glob(".state.h5.*"))  # what the killed runs left is swept
