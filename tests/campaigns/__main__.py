"""`python -m tests.campaigns static|impacts|frequency [--problems N] [--seed S] [--error KIND]`: one table."""

from __future__ import annotations

import argparse
import warnings
from typing import Any

from loadid import Penalty

from . import frequency, impacts, static
from .scores import counts, table

CAMPAIGNS = {"static": static, "impacts": impacts, "frequency": frequency}


def main() -> None:
    """Run one campaign and print its table."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns")
    parser.add_argument("campaign", choices=sorted(CAMPAIGNS))
    parser.add_argument("--problems", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--error", default="none", help="one of those that the campaign knows")
    parser.add_argument("--variance", choices=["constant", "local", "auto"], help="of the load, for impacts")
    parser.add_argument("--size", type=float, help="relative size of the error of an FRF, for frequency")
    given = parser.parse_args()
    if given.size is not None and given.campaign != "frequency":
        parser.error("--size is for the campaign of frequency lines")
    settings: dict[str, Any] = {} if given.size is None else {"size": given.size}
    settings |= {"penalty": Penalty("identity", variance=given.variance)} if given.variance else {}
    warnings.simplefilter("ignore")
    found = list(CAMPAIGNS[given.campaign].run(given.problems, given.seed, given.error, **settings))
    scored = [s for s in found if not isinstance(s, str)]
    frequency.table(scored) if given.campaign == "frequency" else table(scored)
    print("refused:", counts(s for s in found if isinstance(s, str)))


if __name__ == "__main__":
    main()
