"""A page of documentation that has run: what its blocks left and printed, and what tests of several pages ask of it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from loadid import datasets
from tests import blocks
from tests.blocks import Block


@dataclass(frozen=True)
class Ran:
    """A page and the folder that it ran in; of every block the names that it left, what it printed, and CPU seconds."""

    folder: Path
    answers: tuple[tuple[Block, dict[str, Any], str, float], ...]

    @property
    def took(self) -> dict[str, float]:
        """CPU seconds by block."""
        return {str(block): round(seconds, 1) for block, *_, seconds in self.answers}

    def after(self, text: str) -> tuple[dict[str, Any], str]:
        """The names, and what was printed, after the block that holds a text."""
        ((_, scope, said, _),) = [answer for answer in self.answers if text in answer[0].text]
        return scope, said

    def size(self, name: str) -> int:
        """Bytes of a file that it wrote."""
        return (self.folder / name).stat().st_size

    def finds_the_unknown_hit(self, text: str) -> None:
        """The commands of the hammer test find the hit that was not used for the model."""
        import loadid

        _, said = self.after(text)
        truth = datasets.hammer_test().load
        found = loadid.load(self.folder / "result.h5")
        assert abs(found.peaks[0].value / truth.max() - 1) < 0.05
        assert np.linalg.norm(found.load - truth) < 0.1 * np.linalg.norm(truth)
        assert "grade" in said
        assert self.size("result.html") > 10_000

    def finds_the_hit_of_200_newtons(self) -> None:
        """A hit of 200 N, simulated with a finer mesh, comes back within its band."""
        scope, said = self.after("estimate.report")
        estimate, loud = scope["estimate"], datasets.impact().load[:, 0]
        peak = estimate.peaks[0]
        assert abs(peak.value - 200) < 0.1 * 200
        assert abs(peak.value - 200) < 3 * peak.std
        assert "model not verified" in said
        assert "grade A" in said
        assert np.linalg.norm(estimate.load[:, 0] - loud) < 0.1 * np.linalg.norm(loud)
        assert self.size("impact.html") > 10_000


def ran(page: str, folder: Path) -> Ran:
    """Run the blocks of a page in a folder."""
    scope: dict[str, Any] = {}
    with contextlib.chdir(folder):
        return Ran(folder, tuple(_answers(page, scope)))


def _answers(page: str, scope: dict[str, Any]) -> Iterator[tuple[Block, dict[str, Any], str, float]]:
    blocks.prepare(page)
    for block in blocks.blocks(page):
        if block.runs:
            said, seconds = blocks.run(block, scope)
            yield block, dict(scope), said, seconds
