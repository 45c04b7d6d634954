"""`python -m tests.campaigns NAME [--problems N] [--seed S] [--error KIND]`: the table of one campaign."""

from __future__ import annotations

import argparse
import warnings

from loadid import Penalty

from . import faults, impacts, static
from .scores import Scored, counts, table

CAMPAIGNS = {"static": static, "impacts": impacts, "faults": faults}


def main() -> None:
    """Run one campaign and print its table."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns")
    parser.add_argument("campaign", choices=sorted(CAMPAIGNS))
    parser.add_argument("--problems", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--error", default="none", help="one of those that the campaign knows")
    parser.add_argument("--variance", choices=["constant", "local", "auto"], help="of the load, for impacts")
    parser.add_argument("--fault", choices=[*faults.FAULTS, "any"], default="any", help="for faults")
    parser.add_argument("--family", choices=faults.FAMILIES, default="static", help="for faults")
    given = parser.parse_args()
    if given.campaign == "faults":
        faults.table(list(faults.run(given.problems, given.seed, given.error, fault=given.fault, family=given.family)))
        return
    settings = {"penalty": Penalty("identity", variance=given.variance)} if given.variance else {}
    warnings.simplefilter("ignore")
    found = list(CAMPAIGNS[given.campaign].run(given.problems, given.seed, given.error, **settings))
    table([s for s in found if isinstance(s, Scored)])
    print("refused:", counts(s for s in found if isinstance(s, str)))


if __name__ == "__main__":
    main()
