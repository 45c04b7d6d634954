"""``loadid batch``: the loads of many records of many structures."""

from __future__ import annotations

import shutil
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from typing import TYPE_CHECKING, Any

from structures.errors import InputError

from . import Bar, Command, count, emit

if TYPE_CHECKING:
    from .._batch.results import Results
    from .._batch.run import Run

EXAMPLES = """\
examples:
  what all records of a plan will cost, from its first ones:
    loadid batch plan.toml --estimate
  all of them; where it was interrupted, the same again with --resume:
    loadid batch plan.toml --workers 4
    loadid batch plan.toml --resume

docs/batch.md says what a plan holds. The exit code is 3 where a record has no answer.
"""
SHOWN = 8  # records without an answer that are listed here; the tables list all


def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument("plan", metavar="PLAN.toml", help="assets, their records, and what is asked (docs/batch.md)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="dask scheduler, tcp://host:8786; default: this machine")
    parser.add_argument("--resume", action="store_true", help="go on in an output folder that is there")
    parser.add_argument("--workers", type=count, metavar="N", help="processes here; default run.workers, or all cores")
    parser.add_argument("--estimate", action="store_true", help="do the first records, say what all cost, and stop")


def _run(args: Namespace) -> int:
    from .._batch import page, plan, records, results
    from .._batch.run import Cluster, Ledger, Processes, Run

    asked = plan.read(args.plan, workers=args.workers)
    results.known_loads(asked)
    parts = asked.output / "parts"
    if parts.is_dir() and not args.resume:
        raise InputError("the output folder holds parts of another run", where=str(asked.output),
                         expected="a new folder", hint="go on there with --resume, or name another output")  # fmt: skip
    crew = Cluster(args.scheduler) if args.scheduler else Processes(asked.run.workers, asked.run.memory)
    ledger = Ledger(asked.output / "ledger.jsonl")
    with Bar() as bar:
        bar(0.0, "reading the manifest")
        listed = records.manifest(asked)
        run = Run(asked, listed, crew, ledger, bar)
        try:
            if args.estimate:
                run.go(most=1)
                run.go(most=1)  # by the same worker, which has loaded and compiled
                emit(args, _cost(run), _said_cost(run))
                return 0
            run.go(known=None if args.json or args.hushed else lambda: print(_said_cost(run), flush=True))
        finally:
            run.close()
    found = results.gathered(asked, listed, run.failed)
    form = results.write(found, asked.output / "results")
    results.page_to(asked.output, page.fleet(asked, found))
    shutil.rmtree(asked.output / "scratch", ignore_errors=True)
    answer = _answer(found)
    emit(args, {**answer, "format": form, "output": str(asked.output)}, _said(answer, found, str(asked.output)))
    return 0 if answer["done"] == answer["records"] else 3


def _cost(run: Run) -> dict[str, Any]:
    from .._batch.run import seconds_left

    return {
        "records": len(run.manifest.entries), "bytes": run.total, "bytes_left": run.left, "workers": run.crew.size,
        "seconds": seconds_left(run),
    }  # fmt: skip


def _said_cost(run: Run) -> str:
    known = _cost(run)
    done = f"; the first chunks took {', '.join(f'{s:.2g}' for _, s in run.times[:3])} s" if run.times else ""
    ready = f", {run.ready / 1e6:.4g} MB of them done" if run.ready else ""
    crew = f"{known['workers']} worker{'s' * (known['workers'] != 1)}"
    what = f"{known['records']} records of {len(run.plan.assets)} assets, {run.total / 1e6:.4g} MB{ready}{done}"
    return f"{what}; about {duration(known['seconds'])} to go on {crew}"


def duration(seconds: float) -> str:
    """A time in words, as ``2 h 10 min``."""
    if seconds < 100:
        return f"{seconds:.2g} s"
    minutes = round(seconds / 60)
    if minutes < 60:
        return f"{minutes} min"
    hours = f"{minutes // 60 % 24} h {minutes % 60} min"
    return hours if minutes < 1440 else f"{minutes // 1440} d {minutes // 60 % 24} h"


def _answer(found: Results) -> dict[str, Any]:
    status = [row["status"] for row in found.rows["records"]]
    alarms = found.rows["alarms"]
    return {
        "records": len(status), **{name: status.count(name) for name in ("done", "refused", "failed")},
        "alarms": len(alarms), "certain": sum(1 for row in alarms if row["certain"]),
        "without_answer": [{k: row[k] for k in ("asset", "record", "status", "said")}
                           for row in found.rows["records"] if row["status"] != "done"],
    }  # fmt: skip


def _said(answer: dict[str, Any], found: Results, output: str) -> str:
    alarms = f"{answer['alarms']} alarms, {answer['certain']} of them certain"
    lines = [f"{answer['done']} of {answer['records']} records done; {alarms}"]
    for row in answer["without_answer"][:SHOWN]:
        lines.append(f"  {row['status']}: {row['asset']}, {row['record']}: {row['said']}")
    more = len(answer["without_answer"]) - SHOWN
    lines += [f"  and {more} more, in the table of records"] if more > 0 else []
    return "\n".join([*lines, f"written: {output}/results, {output}/fleet.html"])


command = Command("batch", "loads of many records of many structures, from a plan", _configure, _run)
