"""``loadid track``: loads of a running structure, sample by sample, from a file that grows, a pipe or a socket."""

from __future__ import annotations

import signal
import sys
import threading
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.errors import InputError

from . import Command, emit
from ._arguments import UsageError, count

if TYPE_CHECKING:
    from loadid.families.tracking.tracker import Tracker
    from loadid.stream import Followed

WORDS = {
    "lines": "lines",
    "samples": "samples",
    "wide": "lines of another width, left out",
    "unreadable": "lines that cannot be read, left out",
    "endless": "lines without an end, left out",
    "infinite": "lines with infinite numbers, taken as missing",
    "filled": "samples without data put in",
    "gaps": "gaps",
    "duplicated": "samples sent twice, left out",
    "late": "samples that came late, left out",
    "again": "samples sent again after a new start, left out",
    "jitter": "time stamps off the grid by more than a tenth of a step",
    "jumps": "jumps of the clock",
    "waited": "times that the source was made to wait",
    "rotated": "times that another file began",
    "missing": "channel samples missing",
    "gated": "channel samples kept out",
    "steps": "steps of a load taken up",
}


def started(model: str | None, state: str | None) -> tuple[Tracker, dict[str, Any] | None]:
    """Tracker of the state where there is one, else of the model, and where its stream stood.

    Raises
    ------
    InputError
        No file, a damaged one, one without a tracker, a state of another tracker than the model's.
    """
    from loadid.families.tracking import checkpoint

    if state is None or not Path(state).exists():
        if model is None:
            raise InputError("there is no state to go on from", where=f"--state {state}", found="no such file",
                             expected="a file of a tracker", hint="name a fitted tracker with --model")  # fmt: skip
        return checkpoint.read(_tracker_file(model))[0], None
    tracker, stream = checkpoint.read(_tracker_file(state))
    if model is not None and checkpoint.fit_of(_tracker_file(model)) != checkpoint.fit_of(state):
        raise InputError("the state belongs to another tracker than the model", where=f"--state {state}",
                         expected=f"a state of {model}", hint="name a new file with --state")  # fmt: skip
    return tracker, stream


def _tracker_file(path: str) -> str:
    """The path, where it leads to a tracker."""
    from loadid.families.tracking.checkpoint import KIND
    from structures.storage import kind_of

    kind = kind_of(path)
    if kind is not None and kind != KIND:
        raise InputError("this file holds no tracker", where=path, found=kind, expected=KIND,
                         hint="in Python: LoadTracker(model).fit(record).save(file)")  # fmt: skip
    return path


@contextmanager
def _until_told() -> Iterator[threading.Event]:
    """An event that the signals of an end set: what was begun is finished and saved."""
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {s: signal.signal(s, lambda *_: stop.set()) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def show(tracker: Tracker, done: Followed) -> str:
    """What came of a stream, in words."""
    lines = [
        f"{done.samples} samples in {done.seconds:.3g} s: {done.ended}" + (", gone on from a state" * done.resumed),
        f"{tracker.fitted.words}; {done.phase}",
        *(f"  {value} {WORDS.get(name, name)}" for name, value in done.counts.items()),
        *(str(flag) for flag in tracker.flags if flag.level != "note"),
    ]
    return "\n".join(lines)


def _configure(parser: ArgumentParser) -> None:
    parser.add_argument("--model", metavar="TRACKER.h5", help="tracker as it was fitted (Tracker.save)")
    parser.add_argument(
        "--state", metavar="STATE.h5", help="checkpoints; gone on from where the file is there, else begun from --model"
    )
    parser.add_argument(
        "--in", dest="source", required=True, metavar="SOURCE", help="file, - (standard input) or tcp://HOST:PORT"
    )
    parser.add_argument("--out", required=True, metavar="OUT", help="table of loads and stds, or - (standard output)")
    parser.add_argument(
        "--plot", nargs="?", const="", metavar="PICTURE",
        help="draw load and band in the terminal while samples come, and write a picture at the end where one is named",
    )  # fmt: skip
    parser.add_argument("--every", type=count, default=5000, metavar="N", help="samples between checkpoints (5000)")
    parser.add_argument(
        "--idle", type=_seconds, metavar="S", help="end where a file has not grown for so long (default: never)"
    )


def _seconds(text: str) -> float:
    from argparse import ArgumentTypeError

    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value < 1e9:
        raise ArgumentTypeError(f"{text!r} is no number of seconds >= 0")
    return value


def _run(args: Namespace) -> int:
    from ._outputs import require_outputs

    if args.model is None and args.state is None:
        raise UsageError("nothing to track with: name a tracker with --model, or a state with --state")
    source = None if args.source == "-" or args.source.startswith("tcp://") else args.source
    outputs = {"--out": None if args.out == "-" else args.out, "--state": args.state, "--plot": args.plot or None}
    require_outputs(outputs, [source, args.model])

    from loadid.stream import follow
    from loadid.stream.history import History
    from loadid.stream.terminal import Screen

    tracker, stream = started(args.model, args.state)
    names = [c.label for c in tracker.fitted.loads], [c.unit for c in tracker.fitted.loads]
    screen, past = Screen(*names, sys.stderr), History(*names)

    def watch(times: Any, load: Any, std: Any) -> None:
        screen.add(times, load, std)
        past.add(times, load, std)

    out = sys.stdout.buffer if args.out == "-" else args.out
    with _until_told() as stop:
        done = follow(
            tracker, args.source, out, state=args.state, stream=stream, every=args.every, idle=args.idle,
            stop=stop, watch=None if args.plot is None else watch,
        )  # fmt: skip
    if args.plot is not None:
        screen.draw()
    if args.plot:
        _picture(args.plot, tracker, past, done)
    _told(args, tracker, done)
    return 0


def _picture(path: str, tracker: Tracker, past: Any, done: Followed) -> None:
    from loadid.plots.style import save
    from loadid.plots.tracking import tracked_figure

    flags = ", ".join(sorted(f.code.removeprefix("LID-") for f in tracker.flags if f.level != "note")) or "none"
    verdict = "" if tracker.certificate is None else f"{tracker.certificate.verdict}  |  "
    note = f"{verdict}flags: {flags}  |  {done.samples} samples, {done.phase}"
    save(tracked_figure(past.labels, past.units, past.times, past.bins, note), path)


def _told(args: Namespace, tracker: Tracker, done: Followed) -> None:
    data = {"samples": done.samples, "seconds": done.seconds, "resumed": done.resumed, "ended": done.ended,
            "phase": done.phase, "counts": done.counts, "flags": [f.to_dict() for f in tracker.flags]}  # fmt: skip
    if args.out != "-":
        emit(args, data, show(tracker, done))
        return
    from contextlib import redirect_stdout

    with redirect_stdout(sys.stderr):  # standard output is the table
        emit(args, data, show(tracker, done))


command = Command("track", "follow a stream of samples with the loads and their stds", _configure, _run)
