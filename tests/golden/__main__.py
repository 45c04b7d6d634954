"""`python -m tests.golden [names]` prints what would change, and with `--write` stores it.

Names are those of problems, or beginnings of them. Nothing is written without `--write`, and a stored answer within its
tolerance is kept as it is, so that a commit changes those answers only which it changes on purpose.
"""

from __future__ import annotations

import argparse
import time

import pytest

from . import answers
from .problems import PROBLEMS


def main(words: list[str] | None = None) -> int:
    """Print the differences, and write where asked."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument("names", nargs="*", help="problems, or beginnings of their names; default all")
    parser.add_argument("--write", action="store_true", help="store what changed")
    parser.add_argument("--all", action="store_true", help="print unchanged problems too, with their differences")
    given = parser.parse_args(words)
    names = [n for n in PROBLEMS if not given.names or any(n.startswith(g) for g in given.names)]
    if not names:
        parser.error(f"no problem is called {' or '.join(given.names)}")
    stored = answers.load()
    changed = 0
    for name in names:
        problem, start = PROBLEMS[name], time.process_time()
        try:
            new = problem.solve()
        except pytest.skip.Exception as absent:
            print(f"{name}: not run, {absent}")
            continue
        spent = time.process_time() - start
        off, said = answers.changes(new, stored.get(name, answers.Answer({})))
        beyond = {k: v for k, v in off.items() if not v <= problem.tolerance}
        if beyond or said or name not in stored:
            changed += 1
            stored[name] = new
        if beyond or said or given.all:
            print(f"{name} ({spent:.2f} s): largest difference {max(off.values()):.1e}")
            for key, value in (off if given.all else beyond).items():
                print(f"    {key}: {value:.1e}, tolerance {problem.tolerance:g}")
            for line in said:
                print(f"    {line}")
    gone = [] if given.names else sorted(stored.keys() - PROBLEMS.keys())
    for name in gone:
        print(f"{name}: no such problem any more")
        del stored[name]
    print(f"{changed} of {len(names)} answers differ from the stored ones, {len(gone)} are gone")
    if given.write and (changed or gone):
        answers.save(stored)
        print(f"written: {answers.FILE} ({answers.FILE.stat().st_size / 1000:.0f} kB)")
    elif changed or gone:
        print("nothing written: --write [names] stores what changed")
    return int(bool(changed or gone) and not given.write)


if __name__ == "__main__":
    raise SystemExit(main())
