"""What a server says of itself on the loopback: ``/metrics`` as Prometheus reads it, ``/health`` as JSON."""

from __future__ import annotations

import json
import math
import threading
import time
from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any

from .._loopback import LoopbackHandler, LoopbackServer
from .server import Server

PHASES = ("warm-up", "transient", "periodic", "steady")
HELP = {
    "loadid_up": ("gauge", "1 while a structure is tracked, 0 while it is halted"),
    "loadid_connected": ("gauge", "1 while the source of a structure is there"),
    "loadid_rows_total": ("counter", "rows that this run has answered"),
    "loadid_samples_total": ("counter", "samples of a structure, of earlier runs too"),
    "loadid_events_total": ("counter", "what was counted of a structure, by kind"),
    "loadid_alarm": ("gauge", "code of the alarm of the last row, 0 for none"),
    "loadid_phase": ("gauge", "1 for the phase of the tracker"),
    "loadid_silence_seconds": ("gauge", "since something came"),
    "loadid_load": ("gauge", "last load, in its unit"),
    "loadid_load_std": ("gauge", "its std"),
    "loadid_sources_total": ("counter", "what was counted of connections, by kind"),
    "loadid_messages_total": ("counter", "pieces that came"),
    "loadid_messages_again_total": ("counter", "of them, those that had come before"),
    "loadid_undelivered_total": ("counter", "messages that a broker or a listener did not take"),
    "loadid_journal_bytes": ("gauge", "what came and is not in a checkpoint"),
    "loadid_rounds_total": ("counter", "rounds"),
    "loadid_busy_seconds_total": ("counter", "spent in rounds"),
    "loadid_uptime_seconds": ("gauge", "since the start"),
}


def samples(server: Server) -> list[tuple[str, dict[str, str], float]]:
    """Name, labels and value of every metric."""
    found: list[tuple[str, dict[str, str], float]] = []
    down = _down(server)
    now = time.monotonic()
    for name, live in server.lives.items():
        own, tracker = {"structure": name}, live.follows.tracker
        counts = live.follows.counts
        found += [
            ("loadid_up", own, float(not live.halted)), ("loadid_connected", own, float(name not in down)),
            ("loadid_rows_total", own, live.rows), ("loadid_samples_total", own, counts.get("samples", 0)),
            ("loadid_alarm", own, 0 if live.follows.alarm is None else live.follows.alarm[1]),
            ("loadid_silence_seconds", own, now - live.last.heard),
        ]  # fmt: skip
        found += [("loadid_phase", {**own, "phase": phase}, float(tracker.phase == phase)) for phase in PHASES]
        found += [("loadid_events_total", {**own, "kind": kind}, value) for kind, value in counts.items()]
        for label, load, std in zip((c.label for c in tracker.fitted.loads), live.last.load, live.last.std,
                                    strict=False):  # fmt: skip
            found += [("loadid_load", {**own, "load": label}, float(load)),
                      ("loadid_load_std", {**own, "load": label}, float(std))]  # fmt: skip
    kinds: dict[str, int] = defaultdict(int)
    for feed in set(server.feeds.values()):
        for kind, value in feed.counts.items():
            kinds[kind] += value
    found += [("loadid_sources_total", {"kind": kind}, value) for kind, value in kinds.items()]
    undelivered = sum(p.counts["undelivered"] for p in server.publishers)
    undelivered += sum(live.sinks.counts["undelivered"] for live in server.lives.values())
    return [
        *found,
        ("loadid_messages_total", {}, server.counts["messages"]),
        ("loadid_messages_again_total", {}, server.counts["again"]),
        ("loadid_undelivered_total", {}, undelivered),
        ("loadid_journal_bytes", {}, server.journal.size),
        ("loadid_rounds_total", {}, server.rounds),
        ("loadid_busy_seconds_total", {}, server.busy),
        ("loadid_uptime_seconds", {}, now - server.begun),
    ]


def exposition(found: Iterable[tuple[str, Mapping[str, str], float]]) -> str:
    """Metrics in the text format of Prometheus, version 0.0.4."""
    by_name: dict[str, list[str]] = defaultdict(list)
    for name, labels, value in found:
        inner = ",".join(f'{key}="{_escaped(text)}"' for key, text in labels.items())
        number = repr(float(value)) if math.isfinite(value) else {math.inf: "+Inf", -math.inf: "-Inf"}.get(value, "NaN")
        by_name[name].append(f"{name}{{{inner}}} {number}" if inner else f"{name} {number}")
    lines = []
    for name, rows in by_name.items():
        kind, words = HELP[name]
        lines += [f"# HELP {name} {words}", f"# TYPE {name} {kind}", *rows]
    return "\n".join(lines) + "\n"


def health(server: Server) -> dict[str, Any]:
    """Whether all structures are tracked and all sources are there; alarms are no matter of health."""
    halted = {name: live.halted for name, live in server.lives.items() if live.halted}
    down = _down(server)
    return {
        "status": "ok" if not halted and not down else "degraded",
        "structures": len(server.lives),
        "halted": halted,
        "disconnected": down,
        "alarms": {n: live.follows.alarm[1] for n, live in server.lives.items() if live.follows.alarm is not None},
        "uptime": time.monotonic() - server.begun,
    }


def _down(server: Server) -> dict[str, str]:
    found: dict[str, str] = {}
    for feed in set(server.feeds.values()):
        found |= feed.down()
    return found


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")


class Endpoint:
    """Answers on 127.0.0.1, in threads of its own; the numbers are read between two rounds.

    Parameters
    ----------
    server : Server
    port : int
        0 for any that is free.

    Raises
    ------
    InputError
        A port that is taken.
    """

    def __init__(self, server: Server, port: int) -> None:
        handler = type("MetricsOf", (_Metrics,), {"asked": server})
        self._http = LoopbackServer(port, handler, where="[run], http =")
        self.address = self._http.address
        self._thread = threading.Thread(target=self._http.serve_forever, name="metrics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Answer nobody any more."""
        self._http.shutdown()
        self._http.server_close()


class _Metrics(LoopbackHandler):
    asked: Server

    def do_GET(self) -> None:
        """``/metrics`` and ``/health``."""
        if not self.local:
            self.say(403, "text/plain", "this server speaks to its own machine\n")
        elif self.path == "/metrics":
            found = self.asked.ask(samples)
            self.say(*((503, "text/plain", "no round has ended in time\n") if found is None else
                         (200, "text/plain; version=0.0.4; charset=utf-8", exposition(found))))  # fmt: skip
        elif self.path == "/health":
            state = self.asked.ask(health) or {"status": "no round has ended in time"}
            self.say(200 if state["status"] == "ok" else 503, "application/json", json.dumps(state) + "\n")
        else:
            self.say(404, "text/plain", "/metrics or /health\n")
