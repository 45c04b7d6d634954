"""`python -m tests.campaigns NAME [--problems N] [--seed S] [--error KIND]`: the table of one campaign."""

from __future__ import annotations

import argparse
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any

from loadid import Penalty

from . import demo, faults, frequency, grades, hammer, impacts, insitu, long, mistakes, static, tactile, tracking
from .scores import counts, table

CAMPAIGNS = {
    "static": static, "impacts": impacts, "hammer": hammer, "demo": demo, "long": long, "frequency": frequency,
    "tracking": tracking, "tactile": tactile, "insitu": insitu,
}  # fmt: skip
TABLES = {"frequency": frequency.table, "tracking": tracking.table, "tactile": tactile.table, "insitu": insitu.table}


def main() -> None:
    """Run one campaign and print its table."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns")
    parser.add_argument("campaign", choices=[*sorted(CAMPAIGNS), "faults", "grades", "mistakes"])
    parser.add_argument("--problems", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--error", default="none", help="one of those that the campaign knows")
    parser.add_argument("--variance", choices=["constant", "local", "auto"], help="of the load, for impacts")
    parser.add_argument("--write", action="store_true", help="of grades: what answers state is set to what is measured")
    parser.add_argument("--fault", choices=[*faults.FAULTS, "any"], default="any", help="for faults")
    parser.add_argument("--family", choices=faults.FAMILIES, default="static", help="for faults")
    parser.add_argument("--size", type=float, help="relative size of the error of an FRF, for frequency")
    parser.add_argument("--sensor", choices=list(tactile.KINDS), help="of tactile, the only one")
    parser.add_argument("--single", action="store_true", help="of tactile: no frames at rest or shifted, one lambda")
    parser.add_argument("--longest", type=int, help="samples that a record may have, for long")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    if given.campaign == "mistakes":
        with tempfile.TemporaryDirectory() as folder:
            mistakes.show(list(mistakes.outcomes(Path(folder))))
    elif given.campaign == "faults":
        faults.table(list(faults.run(given.problems, given.seed, given.error, fault=given.fault, family=given.family)))
    elif given.campaign == "grades":
        of = grades.drawn(given.problems, given.seed)
        grades.table(of)
        if given.write:
            other = grades.drawn(given.problems, given.seed + 1)
            grades.write(of, other, f"--problems {given.problems} --seed {given.seed}")
    else:
        settings: dict[str, Any] = {k: v for k in ("size", "longest", "sensor") if (v := vars(given)[k]) is not None}
        if given.single:
            settings["single"] = True
        if given.variance:
            settings["penalty"] = Penalty("identity", variance=given.variance)
        found = []
        for one in CAMPAIGNS[given.campaign].run(given.problems, given.seed, given.error, **settings):
            found.append(one)
            if isinstance(one, tactile.Mapped):  # an hour and more: what is done is said
                print(tactile.each(one), file=sys.stderr, flush=True)
        TABLES.get(given.campaign, table)([s for s in found if not isinstance(s, str)])
        print("refused:", counts(s for s in found if isinstance(s, str)))


if __name__ == "__main__":
    main()
