"""``loadid track``: loads of a running structure, sample by sample, from a file that grows, a pipe or a socket."""

from __future__ import annotations

import signal
import sys
import threading
import time
from argparse import ArgumentParser, ArgumentTypeError, Namespace, RawDescriptionHelpFormatter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np
from numpy.typing import NDArray

from . import (
    FIT_OPTIONS,
    NONE,
    Bar,
    Command,
    UsageError,
    add_log_options,
    count,
    emit,
    names,
    positive,
    require_outputs,
    say,
    seconds,
    units,
)

if TYPE_CHECKING:
    from .._families.tracking.tracker import Tracker
    from .._stream import StreamSummary
    from .._stream.output import StateLock

Array = NDArray[np.float64]


BINS = 1024


class History:
    """Mean, extremes and band of every load over time.

    Parameters
    ----------
    labels, units : sequence of str
        Of the loads.
    width : float
        Of the band, in std.
    """

    def __init__(self, labels: list[str], units: list[str], width: float = 1.96) -> None:
        self.labels, self.units, self.width = labels, units, width
        self.size = 1  # samples of a bin
        self._bins: list[Array] = []  # (4, loads): mean, lowest, highest of the band, std
        self._times: list[float] = []
        self._open: list[tuple[Array, Array, Array]] = []
        self._count = 0

    def add(self, times: Array, load: Array, std: Array) -> None:
        """More samples: times (samples,), loads and stds (samples, loads)."""
        self._open.append((times, load, std))
        self._count += len(times)
        if self._count < self.size:
            return
        times, load, std = (np.concatenate(parts) for parts in zip(*self._open, strict=True))
        whole = len(times) // self.size * self.size
        self._open, self._count = [(times[whole:], load[whole:], std[whole:])], len(times) - whole
        shape = (-1, self.size, load.shape[1])
        p, s = load[:whole].reshape(shape), std[:whole].reshape(shape)
        low, high = (p - self.width * s).min(axis=1), (p + self.width * s).max(axis=1)
        self._bins.extend(np.stack([p.mean(axis=1), low, high, s.mean(axis=1)], axis=1))
        self._times.extend(times[:whole].reshape(-1, self.size).mean(axis=1).tolist())
        while len(self._bins) > BINS:
            self._join()

    def __len__(self) -> int:
        return len(self._bins)

    @property
    def times(self) -> Array:
        """Middle of every bin (bins,)."""
        return np.array(self._times)

    @property
    def bins(self) -> Array:
        """Mean, lower and upper end of the band, mean std (bins, 4, loads)."""
        return np.array(self._bins).reshape(-1, 4, len(self.labels))

    def _join(self) -> None:
        """Bins of twice the size; an odd last one goes on as samples of its mean."""
        bins, times = self.bins, self.times
        even = len(bins) // 2 * 2
        if even < len(bins):
            p, s = bins[even, 0], bins[even, 3]
            self._open.insert(0, tuple(np.repeat(a, self.size, axis=0) for a in (times[even:], p[None], s[None])))  # type: ignore[arg-type]
            self._count += self.size
        pairs = bins[:even].reshape(-1, 2, *bins.shape[1:])
        mean = pairs.mean(axis=1)
        mean[:, 1], mean[:, 2] = pairs[:, :, 1].min(axis=1), pairs[:, :, 2].max(axis=1)
        self._bins, self._times = list(mean), times[:even].reshape(-1, 2).mean(axis=1).tolist()
        self.size *= 2


WINDOW = 2000  # samples that are shown
INTERVAL = 0.25  # s between two drawings
HEIGHT, WIDTH = 9, 72  # characters of a load in a terminal
SHOWN = 3  # loads in a terminal


def live(
    labels: Sequence[str],
    units: Sequence[str],
    times: Array,
    load: Array,
    std: Array,
    note: str = "",
) -> str:
    """Loads and their 95 % bands as text, the newest sample at the right.

    Parameters
    ----------
    labels, units : sequence of str
        Of the loads.
    times : array, shape (samples,)
    load, std : array, shape (samples, loads)
    note : str
        Last line.
    """
    lines = []
    for j in range(min(len(labels), SHOWN)):
        lines += _panel(f"{labels[j]} [{units[j]}]", times, load[:, j], 1.96 * std[:, j])
    more = len(labels) - SHOWN
    if more > 0:
        lines.append(f"and {more} more loads")
    return "\n".join([*lines, note] if note else lines)


def _panel(name: str, times: Array, load: Array, half: Array) -> list[str]:
    parts = np.array_split(np.arange(len(load)), min(WIDTH, len(load)))
    low = np.array([np.min(load[p] - half[p]) for p in parts])
    high = np.array([np.max(load[p] + half[p]) for p in parts])
    middle = np.array([np.mean(load[p]) for p in parts])
    bottom, top = float(low.min()), float(high.max())
    if not top > bottom:
        bottom, top = bottom - 1.0, top + 1.0
    step = (top - bottom) / HEIGHT
    rows = [[" "] * len(parts) for _ in range(HEIGHT)]
    for k in range(len(parts)):
        a, b, c = (min(int((x - bottom) / step), HEIGHT - 1) for x in (low[k], high[k], middle[k]))
        for r in range(a, b + 1):
            rows[r][k] = "░"
        rows[c][k] = "█"
    lines = [f"{'':9} {name}  now {load[-1]:.4g} ± {half[-1]:.2g} (95 %)"]
    for r in reversed(range(HEIGHT)):
        label = f"{bottom + (r + 0.5) * step:9.3g}" if r in (0, HEIGHT // 2, HEIGHT - 1) else " " * 9
        lines.append(f"{label} │{''.join(rows[r])}")
    ends = f"{times[0]:.6g} s", f"{times[-1]:.6g} s"
    return [*lines, f"{'':9} └{ends[0]}{' ' * max(len(parts) - len(ends[0]) - len(ends[1]), 1)}{ends[1]}"]


class Screen:
    """Redraws the newest samples in place; silent where the stream is no terminal.

    Parameters
    ----------
    labels, units : sequence of str
        Of the loads.
    stream : text stream
    """

    def __init__(self, labels: Sequence[str], units: Sequence[str], stream: TextIO) -> None:
        self.labels, self.units, self.stream = labels, units, stream
        self.shown = bool(getattr(stream, "isatty", lambda: False)())
        self._recent: tuple[Array, ...] = ()
        self._last, self._height = 0.0, 0

    def add(self, times: Array, load: Array, std: Array) -> None:
        """More samples; drawn where the last drawing is old enough."""
        if not self.shown:
            return
        new = times, load, std
        both = new if not self._recent else tuple(np.concatenate(p) for p in zip(self._recent, new, strict=True))
        self._recent = tuple(np.array(p[-WINDOW:]) for p in both)
        now = time.monotonic()
        if now - self._last >= INTERVAL:
            self._last = now
            self.draw()

    def draw(self) -> None:
        """Over the last drawing."""
        if not self.shown or not self._recent:
            return
        times, load, std = self._recent
        lines = live(self.labels, self.units, times, load, std).split("\n")
        up = f"\x1b[{self._height}A" if self._height else ""
        self.stream.write(up + "".join(f"\x1b[2K{line}\n" for line in lines))
        self.stream.flush()
        self._height = len(lines)


EXAMPLES = """\
examples:
  tune a model on a record, then follow the log of today; started again, it goes on where it was:
    loadid track --model mast.h5 --fit commissioning.csv --state state.h5 --in today.csv --out loads.csv
  the same from a socket, with the load in the terminal and a picture at the end:
    loadid track --model mast.h5 --fit commissioning.csv --state state.h5 \\
        --in tcp://127.0.0.1:5000 --out loads.csv --plot loads.png
  over a log that is finished, from end to end:
    loadid track --model tracker.h5 --in today.csv --out loads.csv --idle 0
  in a pipe:
    acquire | loadid track --model tracker.h5 --in - --out - | alarm

A stream is lines of comma-separated numbers under a line of names with their units, "time [s],top [g]", which are
those of the sensors in any order; a unit that it does not state is stated with --unit. Without that line the
numbers come in the order of the sensors and in their SI units, with a time stamp first or without: seconds, or ISO
8601 as 2026-03-01T10:00:00.25Z, UTC where it says nothing. Empty cells are lost channels. The line of names may
come again, as a logger that was restarted writes it: with other columns or units the stream is read by it, with a
sensor or a unit missing it ends there (exit 3).

A state belongs to one run at a time and to one output, and no answer is ever taken away. Started again after it was
killed, a run makes the last answers again from a file, byte for byte. Where it cannot, as their samples do not come
again (socket, pipe, another log), the answers stay, and a row follows them whose loads and stds are all nan: its time
is that from which the run went on, without the samples of the rows before it that are later.
"""
WORDS = {
    "lines": "lines",
    "samples": "samples",
    "wide": "lines of another width, left out",
    "unreadable": "lines that cannot be read, left out",
    "endless": "lines without an end, left out",
    "unfinished": "line whose end has not come",
    "headers": "lines of names that came again",
    "infinite": "lines with infinite numbers, taken as missing",
    "filled": "samples without data put in",
    "gaps": "gaps",
    "duplicated": "samples sent twice, left out",
    "late": "samples that came late for their place, left out",
    "again": "samples sent again after a new start, left out",
    "jitter": "time stamps off the grid by more than a tenth of a step",
    "jumps": "jumps of the clock",
    "waited": "times that the source was made to wait",
    "rotated": "times that another file began",
    "missing": "channel samples missing",
    "saturated": "channel samples at the end of their range, taken as missing",
    "replayed": "late samples put in their place",
    "expired": "samples that came too late to be put in their place",
    "gated": "channel samples kept out",
    "believed": "channel samples beyond the gate, believed as it was set aside",
    "steps": "steps of a load taken up",
    "lost": "times that the state was lost, and found again",
}


@contextmanager
def until_told() -> Iterator[threading.Event]:
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


def show(tracker: Tracker, done: StreamSummary) -> str:
    """What came of a stream, in words."""
    lines = [
        f"{done.samples} samples in {done.seconds:.3g} s: {done.ended}" + (", gone on from a state" * done.resumed),
        f"{tracker.fitted.words}; {done.phase}",
        *(f"  {WORDS.get(name, name)}: {value}" for name, value in done.counts.items()),
        *(flag.command for flag in tracker.flags if flag.level != "note"),
    ]
    return "\n".join(lines)


ALARMS = {
    526: "the load is far beyond that of the fit: look whether it can be, or a sensor that sees it alone is wrong",
    528: "is wrong and kept out, or taken the other way round: look at the sensor and its cable",
    529: "the samples do not fit, and no one channel is known to be the cause: look at the sensors that W529 lists, or "
    "at all, and whether the structure has changed; the band holds what any of the listed ones may say, no other cause",
    530: "the sensors contradict each other by this model since the fit: check the model",
}


def show_alarm(tracker: Tracker, since: float, code: int, channel: int) -> str:
    """The alarm in which a stream ended, in a line."""
    named = f" channel {tracker.fitted.sensors[channel - 1].label}" if channel else ""
    return f"alarm since {since:.6g} s (W{code}):{named} {ALARMS.get(code, '')}"


def show_fit(record: str, tracker: Tracker) -> str:
    """What a fit has found, in words."""
    f = tracker.fitted
    tuned = ", ".join(f"{name} {value:.4g}" for name, value in f.numbers.items())
    lines = [f"tuned on {record}: {f.words}", f"{tuned}; noise: {f.noise_source}", str(f.certificate)]
    return "\n".join(lines)


def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument(
        "--model", metavar="MODEL.h5",
        help="a tracker as it was fitted (Tracker.save); or, with --fit, a model of a structure (model.save)",
    )  # fmt: skip
    parser.add_argument(
        "--fit", metavar="RECORD", help="log to tune the model on: noise, prior and gain are found, and tested"
    )
    parser.add_argument(
        "--state", metavar="STATE.h5", help="checkpoints; gone on from where the file is there, else begun from --model"
    )
    parser.add_argument(
        "--in",
        dest="source",
        required=True,
        metavar="SOURCE",
        help="file, folder of files, - (standard input) or tcp://HOST:PORT",
    )
    parser.add_argument(
        "--out", required=True, metavar="OUT",
        help="table of loads and stds, new or that of the state; or - (standard output)",
    )  # fmt: skip
    parser.add_argument(
        "--plot", nargs="?", const="", metavar="PICTURE",
        help="draw load and band in the terminal while samples come, and write a picture at the end where one is named",
    )  # fmt: skip
    parser.add_argument("--every", type=count, default=20_000, metavar="N", help="samples between checkpoints (20000)")
    parser.add_argument(
        "--idle",
        type=seconds,
        metavar="S",
        help="end where a file has not grown for so long; 0 for a log that is finished (default: wait for ever)",
    )
    add_fit_options(parser)


def add_fit_options(parser: ArgumentParser) -> None:
    """Options that say how a model is tuned."""
    group = parser.add_argument_group("tuning a model", "with --fit only; all of it is found where nothing is given")
    group.add_argument(
        "--prior", type=names, metavar="NAME,...",
        help="matern32 (default), matern52, ou, random_walk, white: one for all loads, or one for each",
    )  # fmt: skip
    group.add_argument(
        "--noise",
        metavar="STD,...",
        help="noise std of each sensor, in its SI unit: numbers in the order of the model, or CH=STD",
    )
    group.add_argument("--lag", type=_lag, metavar="N", help="answer N samples late, with what came meanwhile; or auto")
    group.add_argument("--replay", type=_samples, metavar="N",
                       help="rows up to N samples late are put in their place (as --lag)")  # fmt: skip
    group.add_argument("--scales", type=names, metavar="NAME,...", help="tune the model too: stiffness, mass, damping")
    group.add_argument("--model-error", type=_errors, metavar="NAME=STD,...",
                       help="relative std of parameters, as stiffness=0.02: widens the band")  # fmt: skip
    group.add_argument("--start", choices=("rest", "static"), help="the structure before the first sample")
    group.add_argument(
        "--gate", type=_gate, metavar="STDS", help="innovation beyond which a sample is doubted; or none"
    )
    group.add_argument("--allow-drift", action="store_true", default=None, help="track although the load will drift")
    add_log_options(parser)


def require_fit_options(args: Namespace) -> None:
    """Nothing, where the options say one thing.

    Raises
    ------
    UsageError
        Neither model nor state; settings of a fit without one.
    """
    if args.model is None and args.state is None:
        raise UsageError("nothing to track with: name a tracker with --model, a model with --model and its record with "
                         "--fit, or a state with --state")  # fmt: skip
    if args.fit is not None and args.model is None:
        raise UsageError("--fit tunes a model: name its file with --model")
    given = [f"--{name.replace('_', '-')}" for name in (*FIT_OPTIONS, "fs", "columns", "axis", "record")
             if getattr(args, name) not in (None, [])]  # fmt: skip
    if args.fit is None and given:
        raise UsageError(f"{given[0]} is a setting of a fit: name its record with --fit, or leave it out")


def _lag(text: str) -> int | str:
    return text if text == "auto" else _samples(text, ", nor auto")


def _samples(text: str, more: str = "") -> int:
    if not (text.isascii() and text.isdecimal()):
        raise ArgumentTypeError(f"{text!r} is no number of samples >= 0{more}")
    return int(text)


def _gate(text: str) -> float:
    """Stds; 0 stands for no gate."""
    return 0.0 if text == NONE else positive(text)


def _errors(text: str) -> dict[str, float]:
    found = {}
    for part in names(text):
        name, sign, value = part.partition("=")
        if not sign:
            raise ArgumentTypeError(f"{part!r} is not NAME=STD, as stiffness=0.02")
        found[name.strip()] = positive(value)
    return found


def _run(args: Namespace) -> int:
    require_fit_options(args)
    source = None if args.source == "-" or args.source.startswith("tcp://") else args.source
    outputs = {"--out": None if args.out == "-" else args.out, "--state": args.state, "--plot": args.plot or None}
    require_outputs(outputs, [source, args.model, args.fit], streams=("--out",))

    from .._stream.output import StateLock
    from .._stream.sources import require_source

    require_source(args.source)
    stated = units(args.unit)
    with nullcontext() if args.state is None else StateLock(args.state) as state:  # from before it is read
        return _tracked(args, state, stated)


def _tracked(args: Namespace, state: StateLock | None, stated: dict[str, str]) -> int:
    from .._stream import follow
    from .._stream.header import TIME
    from ._tracker import started

    with Bar() as bar:
        tracker, stream, fitted = started(args, bar)
    if args.fit is not None:  # its record may have other channels
        known = {c.label for c in tracker.fitted.sensors}
        stated = {name: unit for name, unit in stated.items() if name in known or name.lower() in TIME}
    if fitted and not args.json:
        say(show_fit(args.fit, tracker), aside=True)
    names = [c.label for c in tracker.fitted.loads], [c.unit for c in tracker.fitted.loads]
    screen, past = Screen(*names, sys.stderr), History(*names)

    def watch(times: Any, load: Any, std: Any) -> None:
        screen.add(times, load, std)
        past.add(times, load, std)

    out = sys.stdout.buffer if args.out == "-" else args.out
    with until_told() as stop, Bar() as bar:
        done = follow(
            tracker, args.source, out, state=state, stream=stream, every=args.every, idle=args.idle, stop=stop,
            watch=None if args.plot is None else watch, units=stated, progress=bar if args.plot is None else None,
        )  # fmt: skip
    if args.plot is not None:
        screen.draw()
    if args.plot:
        _picture(args.plot, tracker, past, done)
    _told(args, tracker, done)
    return 0


def _picture(path: str, tracker: Tracker, past: Any, done: StreamSummary) -> None:
    from .._plots.choosing import tracked_figure
    from .._plots.style import save

    flags = ", ".join(sorted(f.code.removeprefix("LID-") for f in tracker.flags if f.level != "note")) or "none"
    verdict = "" if tracker.certificate is None else f"{tracker.certificate.verdict}  |  "
    note = f"{verdict}flags: {flags}  |  {done.samples} samples, {done.phase}"
    save(tracked_figure(past.labels, past.units, past.times, past.bins, note), path)


def _told(args: Namespace, tracker: Tracker, done: StreamSummary) -> None:
    data = {"samples": done.samples, "seconds": done.seconds, "resumed": done.resumed, "ended": done.ended,
            "phase": done.phase, "counts": done.counts, "flags": [f.to_dict() for f in tracker.flags],
            "prior": tracker.fitted.words, "tuned": dict(tracker.fitted.numbers),
            "verdict": None if tracker.certificate is None else tracker.certificate.verdict}  # fmt: skip
    if done.alarm is not None:
        data["alarm"] = dict(zip(("since", "code", "channel"), done.alarm, strict=True))
    if args.out != "-":
        emit(args, data, show(tracker, done))
    else:
        from contextlib import redirect_stdout

        with redirect_stdout(sys.stderr):  # standard output is the table
            emit(args, data, show(tracker, done))
    if done.alarm is not None:
        say(show_alarm(tracker, *done.alarm), aside=True)


command = Command("track", "follow a stream of samples with the loads and their stds", _configure, _run)
