"""The filters of a tracker with all that a sample changes in them: bare numbers in and out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from operator import le
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._flags import Flag
from structures.errors import InputError, plain, reals

from ..._guards.tracking import FAR, beyond_the_fit, blind, faulty, kept_out, louder, moved_off, unlike_the_fit
from ..._inverse.gaussian.exports import FilterpyEngine
from ..._inverse.gaussian.lag import fixed_lag
from ..._inverse.gaussian.roots import Array, lower, solve_lower
from .bank import HOP, lifted_of
from .beginning import HEAD, MovingStart, beginning
from .engine import Engine, Late
from .faults import ChannelFault
from .fit import TrackerFit
from .innovations import Loudness, Means, constant
from .samples import Replay, inside
from .watch import CONTRADICTING, FARTHEST, FAULT, HUGE, MISFIT, Watch


@dataclass(frozen=True)
class TrackedRows:
    """What is filled for a block: loads and std (samples, p), normalised innovations (samples, m), and `settled`.

    `settled` (samples,) is true where a settled gain answered. Innovations are NaN where no channel was used.
    """

    load: Array
    std: Array
    e: Array
    settled: NDArray[np.bool_]

    @classmethod
    def of(cls, samples: int, p: int, m: int) -> TrackedRows:
        """Nothing filled yet."""
        return cls(np.empty((samples, p)), np.empty((samples, p)), np.full((samples, m), np.nan),
                   np.zeros(samples, bool))  # fmt: skip

    def take(self, other: TrackedRows) -> None:
        """Fill with what another one holds."""
        self.load[:], self.std[:], self.e[:], self.settled[:] = other.load, other.std, other.e, other.settled

    def __getitem__(self, part: slice) -> TrackedRows:
        """Views."""
        return TrackedRows(self.load[part], self.std[part], self.e[part], self.settled[part])


ENGINE_COUNTS = ("samples", "missing", "gated", "believed", "steps", "lost")


class Running:
    """Engines of a fit, late answers, models that may be wrong, and the last samples.

    Parameters
    ----------
    fitted : TrackerFit
    gate : float or None
    lag : int
    replay : int, optional
    engine : {"own", "filterpy"}
        As `Tracker`.
    """

    def __init__(
        self, fitted: TrackerFit, gate: float | None = None, lag: int = 0, *, replay: int | None = None,
        engine: str = "own",
    ) -> None:  # fmt: skip
        self.fitted, self.gate, self.lag = fitted, gate, lag
        self.replay, self.engine = lag if replay is None else replay, engine
        self._p = fitted.model.p
        self._origin: Any = None  # the model of the structure, where it is at hand
        self.reset()

    def __reduce__(self) -> tuple[Any, ...]:
        own = self.fitted, self.gate, self.lag, self.replay, self.engine
        return _arrived, (type(self), own, self._origin, self.to_tree(), self.row_alarms)

    def made_of(self, model: Any) -> None:
        """The model of the structure behind the filter, for `update_model`: a file does not hold it."""
        self._origin = model

    @property
    def origin(self) -> Any:
        """The model of the structure, where it is at hand."""
        return self._origin

    @property
    def phase(self) -> str:
        """``"warm-up"``, ``"steady"``, ``"periodic"`` (channels of several rates) or ``"transient"``."""
        return str(self._engine.phase)

    @property
    def counts(self) -> dict[str, int]:
        """What has come, since the start.

        ``samples``; channel samples ``missing``, at the end of a range among them (``saturated``), or ``gated``;
        events of the load taken up (``steps``); times that the state was ``lost`` and found; late samples put in their
        place (``replayed``), or come too late (``expired``). Channel samples beyond the gate that were ``believed``,
        as it had been set aside.
        """
        found = {name: self._engine.counts[name] for name in ENGINE_COUNTS}
        if self._watch is not None:  # the engine takes them for missing
            found["missing"], found["gated"] = found["missing"] - self._watch.kept, found["gated"] + self._watch.kept
        return found | {name: self._tally[name] for name in ("saturated", "replayed", "expired")}

    @property
    def alarms(self) -> tuple[Flag, ...]:
        """What the guards found since the start: the gate, and means of the innovations of what came in blocks."""
        f, engine, counts = self.fitted, self._engine, self.counts
        labels = [c.label for c in f.sensors]
        beyond = getattr(engine, "beyond", np.zeros(len(labels), int))
        found = (
            kept_out(counts["gated"], counts["samples"] * len(labels), counts["steps"], counts["believed"],
                     dict(zip(labels, beyond.tolist(), strict=True))),
            beyond_the_fit(getattr(engine, "largest", 0.0), 0.0 if self._watch is None else self._watch.far),
            moved_off(self._means.errors(None if f.settled is None else constant(f.settled)), labels),
            louder(self._loudness.most, 1.0 if f.certificate is None else f.certificate.loudest),
            None if self._start is None else self._start.flag,
            None if self._watch is None else faulty([(labels[x.channel], None if x.other < 0 else labels[x.other],
                                                      x.kind, x.sample) for x in self._watch.named], self._watch.acts),
            None if self._watch is None else blind(self._watch.unseen, self._watch.count),
            None if self._watch is None else unlike_the_fit(
                self._watch.unlike, self._watch.usual.loudest,
                [labels[self._watch.order[i]] for i in np.flatnonzero(self._watch.suspects)],
            ),
        )  # fmt: skip
        return tuple(flag for flag in found if flag is not None)

    @property
    def faults(self) -> tuple[ChannelFault, ...]:
        """Channels that were found wrong since the start, in the order in which they were named."""
        return () if self._watch is None else tuple(self._watch.named)

    def reset(self) -> None:
        """Back before the first sample."""
        self._tally: Counter[str] = Counter()
        self._start: MovingStart | None = None
        self._head: Array | None = np.empty((0, self.fitted.model.m)) if self.engine == "own" else None
        self._means, self._loudness = Means(self.fitted.model.m), Loudness(self.fitted.model.m)
        self._ring = Replay(self.replay) if self.replay else None
        self._watch = self._watching()
        most = np.inf if self.fitted.most is None or self.gate is None else self.fitted.most
        self._limit = FARTHEST * np.broadcast_to(most, self._p)
        self._limits = self._limit.tolist()
        self.row_alarms = np.zeros((0, 2), int)
        self._made()

    def _opening(self, Y: Array) -> None:
        """Start anew where the first samples, with those that come now (samples, sensors), tell of another start."""
        if self._head is None or not len(Y):
            return
        before, tally = self._head, self._tally
        head = np.concatenate([before, Y])[:HEAD]
        start = beginning(self.fitted.model, self.fitted.settled, head)
        if start != self._start:
            self.reset()
            self._tally, self._start = tally, start
            if start is not None:
                for engine in (self._engine, *(engine for _, engine in self._bank)):
                    engine.ready = start.state(engine.model)
            self._filtered(before, TrackedRows.of(len(before), self._p, before.shape[1]), None)
        self._head = head if len(head) < HEAD else None

    def _watching(self) -> Watch | None:
        """Over the sensors, where the fit has told what is usual; what it finds is acted upon where there is a gate."""
        f = self.fitted
        bank = None if f.usual is None or self.engine != "own" else lifted_of(f.model)
        if f.usual is None or bank is None or len(bank.out) != len(f.usual.squares):
            return None
        always = CONTRADICTING if any(flag.code == f"LID-W{CONTRADICTING}" for flag in f.flags) else 0
        return Watch(f.model, bank, f.usual, self.gate is not None, always, f.most)

    def _made(self) -> None:
        """Engines of the fit, before their first sample."""
        f = self.fitted
        self._engine: Any = self._filter()
        prior = f.model.Cp @ f.model.x0, np.linalg.norm(f.model.Cp @ f.model.L0, axis=1)
        fixed = None if not self.lag or f.settled is None else fixed_lag(f.settled, self.lag)
        self._late = Late(self.lag, fixed, *prior) if self.lag else None
        self._bank = [(weight, Engine(model, settled, None)) for weight, model, settled in f.bank]

    def _filter(self) -> Any:
        f = self.fitted
        if self.engine == "own":
            return Engine(f.model, f.settled, self.gate, self._width())
        return FilterpyEngine(f.model)

    def compile(self) -> None:
        """Load the compiler of the filters now, so that no sample waits for it."""
        for engine in (self._engine, *(engine for _, engine in self._bank)):
            for loop in (engine.loop, engine.roots):
                if loop is not None:
                    loop.compile()
        if self._watch is not None:
            self._watch.bank.compile()
            if self._watch.light is not None:
                self._watch.light.loop.compile()

    def step(self, sample: ArrayLike) -> tuple[Array, Array]:
        """Loads and their std (loads,) after one sample (sensors,); NaN marks a channel that is missing.

        With a lag they are those of so many samples ago: before the first one, what the prior says. The first answers
        are from rest, until the samples so far tell of a start in motion (N532): the filter then begins anew in it.

        Raises
        ------
        InputError
            A sample of another width, or infinite.
        """
        if self.fitted.limits is not None:
            sample = self._believable(sample)
        if self._head is not None:
            row = reals(sample, where="sample", what="a sample that is no row of real numbers")
            self._opening(self._engine.core.sample(row)[None])
        load, std = self._watched(sample)
        return load, std if self.fitted.wider is None else std * self.fitted.wider

    def _watched(self, sample: ArrayLike) -> tuple[Array, Array]:
        if self._watch is None:
            return self._placed(sample)
        watch = self._watch
        if watch.idle:
            answer = self._placed(sample)
        else:
            row = self._engine.core.sample(sample)
            answer = self._placed(watch.taken(row))
            if (mixed := watch.loads(row[None])) is not None:
                answer = self._either(*answer, mixed[0][0], mixed[1][0])
        self.row_alarms = watch.row
        if not all(map(le, map(abs, answer[0].tolist()), self._limits)):  # quickest of so few
            load, std, self.row_alarms = self._bounded(answer[0][None], answer[1][None], watch.row)
            answer = load[0], std[0]
        watch.buffer[watch.filled] = sample if type(sample) is np.ndarray else plain(sample)
        watch.filled += 1
        if watch.filled == HOP:
            watch.full()
            if not watch.asleep:
                self._settled(watch)
        return answer

    def _either(self, load: Array, std: Array, mixed: Array, spread: Array) -> tuple[Array, Array]:
        """Loads and std where any of some channels may be wrong; late ones are the filter's, with that far a band."""
        if self._late is None:
            return mixed, spread
        return load, np.sqrt(spread**2 + (load - mixed) ** 2)

    def _bounded(self, load: Array, std: Array, alarms: NDArray[np.int_]) -> tuple[Array, Array, NDArray[np.int_]]:
        """Loads, std (samples, loads) and alarms, none of them far beyond what the fit saw.

        That is `FARTHEST` times its largest load where a sample has its alarm, `FAR` times where it has none before.
        """
        size = np.abs(load)
        if np.count_nonzero(size <= self._limit) == size.size:
            return load, std, alarms
        code = alarms[:, :1]
        wrong = (code == FAULT) | (code == MISFIT)
        most = np.where(wrong, 1.0, FAR / FARTHEST) * self._limit
        away = size > most
        load, std = np.where(away, np.clip(load, -most, most), load), np.where(away, np.maximum(std, most), std)
        return load, std, np.where(away.any(axis=1, keepdims=True) & ~wrong, (HUGE, 0), alarms)

    def _bounds(self) -> Array | None:
        """Largest loads (loads,) of a sample without an alarm; None where there is no watch."""
        return None if self._watch is None else FAR / FARTHEST * self._limit

    def _settled(self, watch: Watch) -> None:
        """Go on from the state that the watch knows, where it takes a channel out."""
        if watch.settling:
            watch.start(self._engine.prediction)
        ahead = watch.settle(self._engine.wrong > 0)
        if ahead is not None and self._ring is None:  # else late samples could not be put in their place
            self._engine.begin(ahead)
            if self._late is not None:
                self._late.succeed(self._late)

    def _placed(self, sample: ArrayLike) -> tuple[Array, Array]:
        if self._ring is None:
            return self._one(sample)
        if self._ring.count % self.replay == 0 or not self._ring.anchors:
            self._ring.anchor(self._changing())
        answer = self._one(sample)
        self._ring.push(np.asarray(plain(sample), float)[None])
        return answer

    def _one(self, sample: ArrayLike) -> tuple[Array, Array]:
        if self._late is not None:
            return self._lagged(sample, self._late)
        steady = self._engine.phase == "steady"
        load, std = self._engine.step(sample)
        if not self._bank:
            return load, std
        quick = steady and self._engine.phase == "steady"
        taken = sample if quick else self._engine.taken  # what was kept out is kept out of all models
        between = np.zeros(self._p)
        for weight, engine in self._bank:
            between += weight * (engine.step(taken)[0] - load) ** 2
        return load, np.sqrt(std**2 + between)

    def _lagged(self, sample: ArrayLike, late: Late) -> tuple[Array, Array]:
        engine = self._engine
        if engine.phase == "steady" and late.line is not None:
            try:
                found = engine.loop.step(sample)
            except (TypeError, ValueError):  # said below
                found = None
            if found is not None:
                engine.counts["samples"] += 1
                due = late.line.push(found, engine.loop.e)
                assert due is not None  # the line is full
                return due, late.line.std
        row = engine.core.sample(reals(sample, where="sample", what="a sample that is no row of real numbers"))
        load, std = np.empty((1, self._p)), np.empty((1, self._p))
        engine.block(row[None], load, std, late=late)
        return load[0], std[0]

    def run(self, Y: Array, progress: Callable[[float, str], None] | None = None) -> tuple[Array, Array, Array]:
        """Loads and std (samples, loads), normalised innovations (samples, sensors) of bare numbers."""
        rows = self.rows(Y, progress)
        return rows.load, rows.std, rows.e

    def rows(self, Y: Array, progress: Callable[[float, str], None] | None = None) -> TrackedRows:
        """All that is told of bare numbers (samples, sensors); `row_alarms` are theirs then."""
        out = TrackedRows.of(len(Y), self._p, Y.shape[1])
        if self.fitted.limits is not None:
            Y = self._believable(Y)
        self._opening(Y)
        self._filtered(Y, out, progress)
        if self.fitted.wider is not None:
            np.multiply(out.std, self.fitted.wider, out=out.std)
        return out

    def nis(self, e: Array) -> Array:
        """NIS (samples,) of normalised innovations (samples, sensors), over the number of channels that are there.

        One is expected. By the correlation of the innovations at the settled gain, of the channels that are there;
        NaN where none is.
        """
        root = np.eye(e.shape[1]) if self.fitted.settled is None else self._correlation
        there = np.isfinite(e)
        if there.all():
            return np.mean(solve_lower(root, e.T) ** 2, axis=0)
        out = np.full(len(e), np.nan)
        for pattern in np.unique(there, axis=0):
            if pattern.any():
                rows = (there == pattern).all(axis=1)
                out[rows] = np.mean(solve_lower(lower(root[pattern]), e[np.ix_(rows, pattern)].T) ** 2, axis=0)
        return out

    @property
    def _correlation(self) -> Array:
        """Root of the correlation of innovations at the settled gain (m, m)."""
        settled = self.fitted.settled
        assert settled is not None
        return np.asarray(settled.Se_root / settled.innovation_std[:, None])

    def _filtered(self, Y: Array, out: TrackedRows, progress: Callable[[float, str], None] | None) -> None:
        """Fill the rows of samples, without those of channels that the watch finds wrong."""
        self.row_alarms = np.zeros((len(Y), 2), int)
        if self._watch is None:
            self._placed_block(Y, out, progress)
        start = 0
        while self._watch is not None and start < len(Y):
            taken, alarms, mixed = self._watch.feed(Y[start:])
            part = slice(start, start + len(taken))
            self.row_alarms[part] = alarms
            self._placed_block(taken, out[part], progress)
            load, std = out.load, out.std
            if mixed is not None:
                load[part], std[part] = self._either(load[part], std[part], *mixed)
            load[part], std[part], self.row_alarms[part] = self._bounded(load[part], std[part], alarms)
            if self._watch.filled == 0:
                self._settled(self._watch)
            start = part.stop
        self._means.add(out.e)
        self._loudness.add(out.e)

    def _placed_block(self, Y: Array, out: TrackedRows, progress: Callable[[float, str], None] | None) -> None:
        """Fill the rows of samples, which are kept where late ones may come."""
        if self._ring is None:
            self._run(Y, out, progress)
            return
        cuts = self._ring.cuts(len(Y))
        for start, stop in zip([0, *cuts], cuts, strict=False):
            part = slice(start, stop)
            if start in cuts:
                self._ring.anchor(self._changing())
            self._run(Y[part], out[part], progress)
            self._ring.push(Y[part])

    def _run(self, Y: Array, out: TrackedRows, progress: Callable[[float, str], None] | None) -> None:
        """Fill the rows of a block."""
        told = progress or (lambda share, text: None)
        size = 65_536
        for k in range(0, len(Y), size):
            part = slice(k, k + size)
            taken = Y[part].copy() if self._bank else None
            late = {} if self._late is None else {"late": self._late}
            load, std = out.load, out.std
            self._engine.block(Y[part], load[part], std[part], out.e[part], taken, settled=out.settled[part], **late)
            if taken is not None:
                between = np.zeros(load[part].shape)
                other, unused = np.empty(load[part].shape), np.empty(load[part].shape)
                for weight, engine in self._bank:
                    engine.block(taken, other, unused)
                    between += weight * (other - load[part]) ** 2
                std[part] = np.sqrt(std[part] ** 2 + between)
            told(min((k + size) / len(Y), 1.0), "tracking")

    def insert(self, sample: ArrayLike, ago: int) -> tuple[Array, Array] | None:
        """Put a sample that comes late in its place, and run the filter again from there.

        What has already come of that time stays; the channels that were missing then are filled in.

        Parameters
        ----------
        sample : array (sensors,)
            NaN marks a channel that is still missing.
        ago : int
            Samples taken after it.

        Returns
        -------
        load, std : array, shape (ago + 1, loads), or None
            The answers from its time on, as if it had come in order (with a lag, of so many samples before); None
            where it comes too late (`replay`), which is counted.

        Raises
        ------
        InputError
            A sample of another width, or infinite; `ago` is no count.
        """
        if isinstance(ago, bool) or not isinstance(ago, int | np.integer) or ago < 0:
            raise InputError("no count of samples", where="ago", found=repr(ago), expected="0, 1, 2, ...")
        row = self._engine.core.sample(sample)
        place = None if self._ring is None else self._ring.place(int(ago))
        if self._ring is None or place is None:
            self._tally["expired"] += 1
            return None
        row = self._believable(row)
        row = row if self._watch is None else self._watch.taken(row)
        rows = self._ring.samples
        rows[place] = np.where(np.isfinite(rows[place]), rows[place], row)
        load, std = self._again(np.array(rows))
        self._tally["replayed"] += 1
        return load[place:], std[place:] if self.fitted.wider is None else std[place:] * self.fitted.wider

    def _again(self, Y: Array) -> tuple[Array, Array]:
        """The kept samples once more, from the older anchor on."""
        assert self._ring is not None
        out = TrackedRows.of(len(Y), self._p, Y.shape[1])
        marks = [k for k, _ in self._ring.anchors]
        self._restored(self._ring.anchors[0][1])
        anchors, ends = [], [*(k - marks[0] for k in marks), len(Y)]
        for k, start, stop in zip(marks, ends, ends[1:], strict=False):
            anchors.append((k, self._changing()))
            part = slice(start, stop)
            self._run(Y[part], out[part], None)
        self._ring.anchors = anchors
        return out.load, out.std

    def _believable(self, Y: Any) -> Any:
        """Samples without those at the end of the range of their sensor, which are counted."""
        try:
            given = np.asarray(plain(Y), float)
            found = inside(given, self.fitted.limits)
        except (TypeError, ValueError):
            return Y  # the engine says what is wrong with it
        self._tally["saturated"] += int(np.sum(np.isnan(found)) - np.sum(np.isnan(given)))
        return found

    def to_tree(self) -> dict[str, Any]:
        """Everything that changes from sample to sample, as plain arrays and numbers."""
        ring = None if self._ring is None else self._ring.to_tree()
        return self._changing() | {"ring": ring, "tally": dict(self._tally), "means": self._means.to_tree(),
                                   "loudness": self._loudness.to_tree(),
                                   "start": None if self._start is None else [self._start.wider, self._start.gain],
                                   "head": None if self._head is None else self._head.copy(),
                                   "watch": None if self._watch is None else self._watch.to_tree()}  # fmt: skip

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self._restored(tree)
        start = tree.get("start")
        self._start = None if start is None else MovingStart(*map(float, start))
        head = tree.get("head")  # files of before hold none, and are beyond it
        self._head = None if head is None else np.array(head, float).reshape(-1, self.fitted.model.m)
        self._tally = Counter({str(k): int(v) for k, v in tree["tally"].items()})
        if (means := tree.get("means")) is not None:  # files of 0.1 hold none
            self._means.restore(means)
        if (loud := tree.get("loudness")) is not None:  # nor this
            self._loudness.restore(loud)
        if self._watch is not None and (watch := tree.get("watch")) is not None:
            self._watch.restore(watch)
        if self._ring is not None:
            self._ring.restore(tree["ring"])

    def _changing(self) -> dict[str, Any]:
        """What a sample changes in the filters."""
        return {
            "engine": self._engine.to_tree(),
            "bank": [engine.to_tree() for _, engine in self._bank],
            "late": None if self._late is None else self._late.to_tree(),
        }

    def _restored(self, tree: dict[str, Any]) -> None:
        self._engine.restore(tree["engine"])
        for (_, engine), own in zip(self._bank, tree["bank"], strict=True):
            engine.restore(own)
        if self._late is not None:
            self._late.restore(tree["late"])

    def _width(self) -> Array | None:
        """Of the gate: a model that is not exact is no reason to throw its sensors away."""
        stds = () if self.fitted.certificate is None else self.fitted.certificate.robust_std
        return np.asarray(np.maximum(1.0, stds)) if stds else None

    def _spread(self) -> Array:
        settled = self.fitted.settled
        if settled is not None:
            return settled.innovation_std
        return np.asarray(np.linalg.norm(self.fitted.model.LR, axis=1))


def _arrived(
    kind: type[Running], own: tuple[Any, ...], origin: Any, tree: dict[str, Any], alarms: NDArray[np.int_]
) -> Running:
    """A copy or an unpickled one: it goes on from the same sample, bit for bit, as one from a file does."""
    fitted, gate, lag, replay, engine = own
    made = kind(fitted, gate, lag, replay=replay, engine=engine)
    made.made_of(origin)
    made.restore(tree)
    made.row_alarms = alarms
    return made
