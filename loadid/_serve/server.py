"""The rounds of a server: gather what has come, put it on the disk, track it, confirm it; checkpoints in between."""

from __future__ import annotations

import difflib
import hashlib
import logging
import os
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import ExitStack, suppress
from typing import Any

from structures.errors import InputError

from .._stream.framing import compile_parser
from .._stream.output import StateLock
from .brokers import Kafka, Mqtt, Publisher, ZeroMq
from .inputs import Feed, Files, Received, Sockets
from .journal import Journal, JournalEntry
from .live import LiveStructure
from .plan import Address, LiveAsset, ServePlan
from .sinks import Sinks

LOOK = 0.1  # s between two looks whether to stop
HELD = 16 << 20  # bytes of the journal that are tracked at once
SHARE = 0.25  # of the time, at most, for checkpoints
TURN = 4  # checkpoints of a structure, in time, after which a segment of the journal is closed
FORGET = 5.0  # s between two looks which segments of the journal all have left behind
log = logging.getLogger(__name__)


class Server:
    """Trackers of a plan, until they are told to stop.

    Parameters
    ----------
    plan : ServePlan
    progress : callable, optional
        ``progress(share, text)`` while trackers are read and the journal is tracked again.
    skip : collection of str
        Structures of which what waits in the journal is given up.

    Attributes
    ----------
    rounds, seconds, busy : int, float, float
        Rounds of this run, since when it runs, and seconds of work in them.
    counts : Counter
        ``messages`` that came, ``again``: of them, those that had come before.

    Raises
    ------
    InputError
        A folder of states that another server holds, a tracker or a state that cannot be used, sinks that cannot be
        written, a client library that is not installed, a damaged journal.
    """

    def __init__(
        self, plan: ServePlan, progress: Callable[[float, str], None] | None = None, skip: Collection[str] = ()
    ) -> None:
        _require_skipped(plan, skip)
        self.plan, told = plan, progress or (lambda share, text: None)
        self.counts: Counter[str] = Counter()
        self.rounds, self.busy, self.begun = 0, 0.0, time.monotonic()
        self._publishers: dict[tuple[str, str, int, str], Publisher] = {}
        self._wanted = threading.Event()
        self._answers: list[tuple[Callable[[Server], Any], list[Any], threading.Event]] = []
        _many_files(4 * len(plan.assets) + 256)
        with ExitStack() as held:
            try:
                plan.states.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError("the folder cannot be made", where=str(plan.states),
                                 found=error.strerror or str(error), hint="check states") from None  # fmt: skip
            held.enter_context(StateLock(plan.states / "server"))
            held.callback(self._published)
            compile_parser()
            self.lives: dict[str, LiveStructure] = {}
            for k, asset in enumerate(plan.assets):
                told(k / len(plan.assets), f"reading tracker {asset.name}")
                live = LiveStructure(asset, plan.state(asset), self._sinks)
                held.callback(live.close)
                live.follows.tracker.compile()
                self.lives[asset.name] = live
            self.journal = Journal(plan.states)
            held.callback(self.journal.close)
            self._again(told, skip)
            self._forget()
            self.feeds: dict[str, Feed] = {}
            self._each: list[Feed] = []
            for feed, names in _feeds(plan, self.lives):
                held.callback(feed.close)
                self._each.append(feed)
                for name in names:
                    self.feeds[name] = self.lives[name].feed = feed
            self._turned = self._forgot = time.monotonic()
            self._held = held.pop_all()

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *exc: object) -> None:
        self._held.close()

    def go(self, stop: threading.Event, idle: float | None = None) -> None:
        """Round after round, until `stop`; or, where `idle` is given, until nothing has come for so many seconds.

        Raises
        ------
        InputError
            Something cannot be written. What came is in the journal, not confirmed, or still where it came from.
        """
        heard = time.monotonic()
        while not stop.is_set():
            start = time.monotonic()
            heard = start if self.round() else heard
            self._answer()
            self.busy += time.monotonic() - start
            if idle is not None and start - heard >= idle:
                break
            while not stop.is_set() and (left := start + self.plan.run.latency - time.monotonic()) > 0:
                if self._wanted.wait(min(left, LOOK)):
                    self._answer()
                if any(feed.full() for feed in self._each):
                    break
        for live in self.lives.values():
            if live.dirty:
                live.checkpoint()
        self.journal.turn()
        self._forget()

    def round(self) -> int:
        """Once through all sources; how many pieces came."""
        taken = [(feed, feed.take()) for feed in self._each]
        entries, kept = self._numbered(taken)
        self.journal.append(kept)
        self._taken(entries)
        for feed, pieces in taken:
            feed.confirm(pieces)
        self.rounds += 1
        self._checkpoints()
        return sum(len(pieces) for _, pieces in taken)

    def ask(self, question: Callable[[Server], Any], patience: float = 5.0) -> Any:
        """What a question finds between two rounds, for another thread; None where no round ends in time."""
        found: list[Any] = []
        done = threading.Event()
        self._answers.append((question, found, done))
        self._wanted.set()
        return found[0] if done.wait(patience) and found else None

    # -- inside -----------------------------------------------------------------------------------------------------
    def _numbered(
        self, taken: Sequence[tuple[Feed, list[Received]]]
    ) -> tuple[dict[str, list[JournalEntry]], list[JournalEntry]]:
        """What is new of pieces, by structure, and what of it goes into the journal."""
        entries: dict[str, list[JournalEntry]] = {}
        kept = []
        for feed, pieces in taken:
            self.counts["messages"] += len(pieces)
            for piece in pieces:
                live = self.lives[piece.to]
                if live.knows(piece):
                    self.counts["again"] += 1
                    continue
                entry = live.entry(piece)
                entries.setdefault(piece.to, []).append(entry)
                if not feed.lasting:
                    kept.append(entry)
        return entries, kept

    def _again(self, told: Callable[[float, str], None], skip: Collection[str]) -> None:
        """Track what the journal holds and the checkpoints do not."""
        waiting: dict[str, list[JournalEntry]] = {}
        held = passed = 0
        for entry in self.journal.entries():
            live = self.lives.get(entry.to)
            passed += len(entry.data)
            if live is not None and entry.serial >= live.serial and entry.to in skip:
                live.serial, live.dirty = entry.serial + 1, True
                self.counts["skipped"] += 1
            elif live is not None and entry.serial >= live.serial:
                waiting.setdefault(entry.to, []).append(entry)
                live.serial = entry.serial + 1
                held += len(entry.data)
            if held >= HELD:  # a journal of days does not fit into the memory
                told(min(passed / max(self.journal.size, 1), 1.0), "what came before")
                self._taken(waiting)
                waiting, held = {}, 0
        self._taken(waiting)
        for name in skip:
            if self.lives[name].dirty:
                self.lives[name].checkpoint()  # else it would wait for another start

    def _taken(self, entries: dict[str, list[JournalEntry]]) -> None:
        for name, own in entries.items():
            self.lives[name].take(own)

    def _checkpoints(self) -> None:
        """Of the structures whose time has come, the oldest first, for a share of the time; then a shorter journal."""
        now, run = time.monotonic(), self.plan.run
        due = [live for live in self.lives.values()
               if live.dirty and not live.halted and now - live.checked >= run.checkpoint]  # fmt: skip
        until = now + SHARE * max(run.latency, 0.04)
        for live in sorted(due, key=lambda live: live.checked):
            live.checkpoint()
            if time.monotonic() > until:
                break
        if now - self._turned >= TURN * run.checkpoint:
            self._turned = now
            self.journal.turn()
        if now - self._forgot >= FORGET:
            self._forget()

    def _forget(self) -> None:
        self._forgot = time.monotonic()
        self.journal.forget({name: live.reached for name, live in self.lives.items()})

    def _answer(self) -> None:
        self._wanted.clear()
        while self._answers:
            question, found, done = self._answers.pop(0)
            with suppress(Exception):
                found.append(question(self))
            done.set()

    def _sinks(self, asset: LiveAsset, head: Sequence[str], before: dict[str, Any] | None) -> Sinks:
        return Sinks(asset, head, before, self._publishers)

    def _published(self) -> None:
        for publisher in self._publishers.values():
            publisher.close()

    @property
    def publishers(self) -> Iterable[Publisher]:
        """Connections by which rows go out."""
        return self._publishers.values()


def _require_skipped(plan: ServePlan, skip: Collection[str]) -> None:
    """Nothing, where what waits for these structures can be given up."""
    known = {asset.name: asset.source for asset in plan.assets}
    for name in skip:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            raise InputError("no such structure", where="--skip", found=name, expected=", ".join(list(known)[:20]),
                             hint=f"did you mean {near[0]!r}?" if near else "")  # fmt: skip
        if known[name].scheme in ("file", "kafka"):
            raise InputError("what waits for this structure is not in the journal", where=f"--skip {name}",
                             found=str(known[name]), expected="a source that cannot be asked again",
                             hint="mend the file or the topic, or begin under another name")  # fmt: skip


def _feeds(plan: ServePlan, lives: dict[str, LiveStructure]) -> list[tuple[Feed, list[str]]]:
    """Sources of a plan, those of one kind and broker together, and whose they are."""
    groups: dict[Any, list[LiveAsset]] = {}
    for asset in plan.assets:
        source = asset.source
        groups.setdefault(source.scheme if source.scheme in ("file", "tcp") else source.broker, []).append(asset)
    made = []
    try:
        for assets in groups.values():
            made.append((_feed(plan, assets, lives), [asset.name for asset in assets]))
    except BaseException:
        for feed, _ in made:
            feed.close()
        raise
    return made


def _feed(plan: ServePlan, assets: list[LiveAsset], lives: dict[str, LiveStructure]) -> Feed:
    source: Address = assets[0].source
    places = {asset.name: lives[asset.name].place for asset in assets}
    if source.scheme == "file":
        return Files(assets, places)
    if source.scheme == "tcp":
        return Sockets(assets)
    if source.scheme == "zmq":
        return ZeroMq(assets)
    if source.scheme == "kafka":
        return Kafka(assets, places, session(plan))
    return Mqtt(assets, session(plan))


def session(plan: ServePlan) -> str:
    """Name by which brokers know the server of a plan again."""
    digest = hashlib.sha256(f"{socket.gethostname()}:{plan.states.resolve()}".encode()).hexdigest()
    return f"loadid-{digest[:16]}"


def _many_files(count: int) -> None:
    """Let the process have so many files open, where the system allows it."""
    if os.name == "posix":
        import resource

        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        wanted = count if hard == resource.RLIM_INFINITY else min(count, hard)
        if soft != resource.RLIM_INFINITY and soft < wanted:
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
