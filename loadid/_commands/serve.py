"""``loadid serve``: loads of many live structures, from files, sockets and brokers."""

from __future__ import annotations

import threading
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from contextlib import closing, nullcontext
from typing import TYPE_CHECKING, Any

from . import Bar, Command, emit, seconds
from .track import WORDS, until_told

if TYPE_CHECKING:
    from .._serve.server import Server

EXAMPLES = """\
examples:
  loadid serve plan.toml --check     # read plan and trackers, open tables, connect, and stop
  loadid serve plan.toml             # until Ctrl-C or SIGTERM; started again, it goes on where it was
  curl http://127.0.0.1:9464/health  # with http = 9464 under [run]

docs/serve.md says what a plan holds, and what each kind of source promises when the process is killed.
"""
CHECK = 3.0  # s that sources have to be there
SHOWN = 8  # structures that are halted or without a source, in words


def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument("plan", metavar="PLAN.toml", help="structures, their sources and sinks (docs/serve.md)")
    parser.add_argument("--check", action="store_true", help="begin, look which sources are there, and stop")
    parser.add_argument("--skip", metavar="NAME", action="append", default=[],
                        help="give up what waits in the journal for a halted structure; may repeat")  # fmt: skip
    parser.add_argument("--idle", type=seconds, metavar="S", help="end where nothing has come for so long")


def _run(args: Namespace) -> int:
    from .._serve import plan
    from .._serve.metrics import Endpoint, health
    from .._serve.server import Server

    asked = plan.read(args.plan)
    with Bar() as bar:
        server = Server(asked, bar, args.skip)
    with server, until_told() as stop:
        port = asked.run.http
        with nullcontext() if port is None else closing(Endpoint(server, port)) as endpoint:
            if not (args.json or args.hushed):
                where = "" if endpoint is None else f"; {endpoint.address}/metrics and /health"
                print(f"{len(server.lives)} structures{where}", flush=True)
            if args.check:
                over = threading.Timer(CHECK, stop.set)
                over.daemon = True
                over.start()
            server.go(stop, args.idle)
        state = health(server)
        emit(args, {**state, **_told(server)}, _said(server, state))
    return 0 if not state["halted"] and (state["status"] == "ok" or not args.check) else 3


def _told(server: Server) -> dict[str, Any]:
    total: dict[str, int] = {}
    for live in server.lives.values():
        for name, value in live.follows.counts.items():
            total[name] = total.get(name, 0) + value
    return {"rows": sum(live.rows for live in server.lives.values()), "rounds": server.rounds, "busy": server.busy,
            "counts": total, "messages": server.counts["messages"], "again": server.counts["again"],
            "skipped": server.counts["skipped"]}  # fmt: skip


def _said(server: Server, state: dict[str, Any]) -> str:
    told = _told(server)
    lines = [f"{told['rows']} rows of {len(server.lives)} structures in {state['uptime']:.3g} s"]
    counts = ", ".join(f"{WORDS.get(name, name)} {value}" for name, value in told["counts"].items())
    lines += [f"  with earlier runs: {counts}"] if counts else []
    for words, found in (("halted", state["halted"]), ("no source", state["disconnected"])):
        lines += [f"{words}: {name}: {why}" for name, why in list(found.items())[:SHOWN]]
        lines += [f"  and {len(found) - SHOWN} more"] if len(found) > SHOWN else []
    lines += [f"alarm: {name} (W{code})" for name, code in list(state["alarms"].items())[:SHOWN]]
    return "\n".join(lines)


command = Command("serve", "loads of many live structures, from files, sockets and brokers", _configure, _run)
