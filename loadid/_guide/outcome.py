"""What a step comes to, and what it is computed from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from structures._flags import Flag
from structures.errors import InputError

from .._results.archive import plain
from .context import GuidedJob
from .ledger import Signature


@dataclass(frozen=True)
class Outcome:
    """What a step comes to.

    Parameters
    ----------
    said : str
    figures : mapping
        Numbers, texts, lists, and tables of them.
    flags : sequence of Flag
    holds : bool
        Whether it is as it must be.
    made : mapping of Path to bytes
        Files that the step makes, to be written with its signature.
    """

    said: str
    figures: Mapping[str, Any]
    flags: Sequence[Flag] = ()
    holds: bool = True
    made: Mapping[Path, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class Asked:
    """What a step is computed from.

    Parameters
    ----------
    job : GuidedJob
    evidence : sequence of Path
    latest : mapping of int to Signature
        Signatures of the steps before.
    folder, stem : Path, str
        Where files that a step makes are written, and how their names begin.
    """

    job: GuidedJob
    evidence: Sequence[Path]
    latest: Mapping[int, Signature]
    folder: Path
    stem: str

    @property
    def records(self) -> list[Path]:
        """Evidence that is a log."""
        return self.job.records(self.evidence)

    def one_record(self, number: int, what: str) -> list[Path]:
        """The records, at least one.

        Raises
        ------
        InputError
            There is none.
        """
        if not self.records:
            raise InputError("evidence is missing", where=f"loadid guide sign {number}",
                             found=", ".join(path.name for path in self.evidence) or "no file", expected=what,
                             hint=f"loadid guide sign {number} --evidence RECORD")  # fmt: skip
        return self.records


def tidied(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Figures as a file holds them: numbers, texts, lists and tables; what is not known or not finite is left out."""
    found = {}
    for name, value in plain(figures).items():
        settled = tidied(value) if isinstance(value, dict) else value
        if settled is not None:
            found[name] = [one for one in settled if one is not None] if isinstance(settled, list) else settled
    return found
