"""Health of recorded channels: clipped, saturated, dead, held, missing samples, offsets; the quiet part, its noise.

Every finding is one flag W206 that names the channel, the samples and how sure it is. False alarms are faults: a crest
of a smooth signal, a boxcar, a rest at zero, a decay below the last bit are not findings. Only numpy is used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._advice import Advice, Spelling
from structures._channels import Channel
from structures._flags import Evidence, Flag
from structures.errors import InputError, plain

from ._inverse.problem import NoiseSource
from ._tone import SHARE, tone

if TYPE_CHECKING:
    from ._record import Record

Runs = list[tuple[int, int]]  # half-open sample ranges
Vector = NDArray[np.float64]

WITHOUT_GAPS = Advice(
    Spelling("select channels or a window without the gap", "record again, or cut the gap out of the file")
)
RAIL_RUN = 3  # equal samples at the rail that make a clip
QUIET_MIN = 64  # samples below which a noise level is not worth stating
ONSET = 6.0  # threshold of the onset in robust standard deviations
CONTRAST = 20.0  # peak over noise below which nothing has started
LINEAR = 0.1  # strain beyond which no linear model holds
HUM = "find its source (ground, cable, a motor nearby) and record again; a load at this frequency is no load"
OFFSET = 3.0  # mean of the quiet part over its std


def health(record: Record) -> tuple[Flag, ...]:
    """Findings on every channel of a record, one flag W206 each.

    Parameters
    ----------
    record : Record

    Returns
    -------
    tuple of Flag
        Empty when nothing is wrong. The evidence names the kind: ``missing``, ``flat``, ``clipped``, ``overload``,
        ``saturated``, ``held``, ``dead``, ``offset``, ``tone``, ``strain``.
    """
    return tuple(f for i in range(len(record.channels)) for f in _findings(record, i))


def beyond_linear(channel: Channel, largest: float) -> tuple[Flag, ...]:
    """Flag W206 of a strain that no linear model describes; nothing for what is small, or is no strain."""
    if channel.quantity != "strain" or largest <= LINEAR:
        return ()
    text = f"a strain of {100 * largest:.4g} %, beyond what any linear model describes: is it microstrain (um/m)?"
    said = f"channel {channel.label}: {text}"
    return (Flag("W206", Evidence("strain", largest, LINEAR), said, "state the unit in which it was recorded: um/m"),)


def quiet_segment(values: ArrayLike, dt: float) -> slice | None:
    """Leading stretch before the response starts, common to all channels.

    The noise level is the median absolute deviation of the first 64 samples, then of the whole stretch found. The onset
    is the first sample beyond 6 of these standard deviations on any channel, stepped back by a tenth of the stretch (at
    least 8 samples), because ringing of anti-alias filters runs ahead of a blow.

    Parameters
    ----------
    values : array, shape (samples,) or (samples, channels)
    dt : float
        Step in s; only its sign is used, the search counts samples.

    Returns
    -------
    slice or None
        None when nothing starts within the record, when fewer than 64 samples lead, or when the leading part is not the
        quietest one (the record began after the response did).
    """
    table = np.asarray(plain(values), dtype=float)
    table = table[:, None] if table.ndim == 1 else table
    if table.ndim != 2 or not dt > 0:
        raise InputError("no record to search", where="quiet_segment", found=f"shape {table.shape}, dt {dt}")
    if len(table) < QUIET_MIN + 8:
        return None
    onsets = [onset for column in table.T if (onset := _onset(column)) is not None]
    if not onsets or min(onsets) == 0:
        return None
    stop = min(onsets)
    stop -= max(8, stop // 10)
    return slice(0, stop) if stop >= QUIET_MIN else None


def noise_std(record: Record) -> tuple[Vector, NoiseSource] | None:
    """Standard deviation of the noise of every channel, and where it comes from.

    Stated noise (``Channel.noise``) comes first, then the quiet part of each channel before its own response.

    Returns
    -------
    (std, source) or None
        std in SI, shape (channels,); None when neither is there, or when the quiet part is free of noise.
    """
    stated = [c.noise for c in record.channels]
    if all(s is not None for s in stated):
        return np.array(stated, dtype=float), NoiseSource("datasheet", "data sheet (stated with the channels)")
    parts = [quiet_part(record, i) for i in range(len(record.channels))]
    calm = [part for part in parts if part is not None]
    if len(calm) < len(parts):
        return None
    std = np.array([np.std(part, ddof=1) for part in calm])
    if np.any(std <= 1e-12 * np.nanmax(np.abs(record.values), axis=0)):
        return None
    shortest = min(len(part) for part in calm)
    said = f"quiet segment (quiet part before the response: {shortest} samples ({shortest * record.dt:.4g} s))"
    return std, NoiseSource("pre_trigger", said)


def require_finite(record: Record, *, hint: str = WITHOUT_GAPS) -> None:
    """Nothing, if the record has no gap; `hint` says what to do otherwise.

    Raises
    ------
    InputError
        Names the channels and the samples that are missing.
    """
    missing = np.isnan(record.values)
    if missing.any():
        where = [f"{label}: {_show(_runs(m))}" for label, m in zip(record.labels, missing.T, strict=True) if m.any()]
        raise InputError("samples are missing (NaN)", where=record.source or "record", found="; ".join(where),
                         expected="numbers", hint=hint)  # fmt: skip


def masked(record: Record) -> Record:
    """The record with gaps (NaN) where a channel is clipped, held or dead, for families that leave gaps out of the fit.

    What is only possible (``saturated``) stays, as do channels that are flat throughout; `health` lists all of them.

    Parameters
    ----------
    record : Record

    Returns
    -------
    Record
        The same record where nothing is found. A note says how many samples of which channel were taken out.
    """
    values, notes = np.array(record.values), []
    for i, label in enumerate(record.labels):
        number = np.flatnonzero(~np.isnan(record.values[:, i]))
        y = record.values[number, i]
        if len(y) < 8 or y.min() == y.max():
            continue
        step = _last_bit(y)
        clips = [runs for sign in (1.0, -1.0) for runs, sure in [_at_rail(sign * y, step)] if sure != "possible"]
        bad = [number[a:b] for runs in (*clips, _held(y, step)) for a, b in runs]
        if bad:
            lost = np.unique(np.concatenate(bad))
            values[lost, i] = np.nan
            notes.append(f"{len(lost)} clipped or held samples of {label} were taken out (NaN)")
    return replace(record, values=values, notes=(*record.notes, *notes)) if notes else record


def describe(record: Record) -> dict[str, Any]:
    """What `loadid info` and `loadid check` print: plain numbers and texts, ready for JSON.

    Returns
    -------
    dict
        ``name, source, samples, dt, fs, duration, sha256, notes, flags`` and ``channels``: per channel ``label``,
        ``unit`` (SI), ``recorded_unit, quantity, min, max, rms, mean, offset, noise, quiet`` ([first, stop] samples),
        ``missing`` and ``findings`` (dictionaries of flags). Numbers are in SI; None where not known.
    """
    rows = []
    for i, channel in enumerate(record.channels):
        x = record.values[:, i]
        x = x[~np.isnan(x)]
        calm, quiet = quiet_part(record, i), quiet_segment(record.values[:, i], record.dt)
        rows.append(
            {
                "label": channel.label,
                "unit": channel.unit,
                "recorded_unit": record.units[i],
                "quantity": channel.quantity,
                "min": float(x.min()) if x.size else None,
                "max": float(x.max()) if x.size else None,
                "rms": _rms(x) if x.size else None,
                "mean": float(x.mean()) if x.size else None,
                "offset": float(calm.mean()) if calm is not None else None,
                "noise": float(calm.std(ddof=1)) if calm is not None else None,
                "quiet": None if quiet is None else [0, quiet.stop],
                "missing": len(record) - x.size,
                "findings": [f.to_dict() for f in _findings(record, i)],
            }
        )
    return {
        "name": record.name,
        "source": record.source,
        "samples": len(record),
        "dt": record.dt,
        "fs": record.fs,
        "duration": record.duration,
        "sha256": record.sha256,
        "notes": list(record.notes),
        "flags": [f.to_dict() for f in record.flags],
        "channels": rows,
    }


# -- one channel ----------------------------------------------------------------------------------------------
def _findings(record: Record, column: int) -> list[Flag]:
    x, label = record.values[:, column], record.labels[column]

    def flag(kind: str, value: float, threshold: float | None, message: str, advice: str) -> Flag:
        return Flag("W206", Evidence(kind, value, threshold), f"channel {label}: {message}", advice)

    found: list[Flag] = []
    missing = np.isnan(x)
    if missing.any():
        runs = _runs(missing)
        text = f"{int(missing.sum())} of {len(x)} samples are missing (certain): {_show(runs)}"
        found.append(flag("missing", float(missing.sum()), 0, text, "use a window or channels without the gap"))
    found += beyond_linear(record.channels[column], 0.0 if missing.all() else float(np.nanmax(np.abs(x))))
    if len(x) < 2 or missing.all():
        return found
    # Missing samples are left out; what is said about samples is mapped back to their number in the record.
    number = np.flatnonzero(~missing)
    y = x[number]
    if len(y) > 1 and y.min() == y.max():
        text = f"flat: all {len(y)} samples equal {y[0]:.6g} (certain)"
        return [*found, flag("flat", float(len(y)), None, text, "check the cable and the channel, or leave it out")]
    if len(y) < 8:
        return found
    step = _last_bit(y)
    rails = [(side, *_at_rail(sign * y, step)) for side, sign in (("upper", 1.0), ("lower", -1.0))]
    at_rail: Runs = []
    for side, runs, sure in rails:
        if runs:
            at_rail += runs
            found.append(_rail_flag(flag, y, number, side, runs, sure))
    held = [r for r in _held(y, step) if r not in at_rail]
    tail = [r for r in held if r[1] == len(y)]
    inner = [r for r in held if r not in tail]
    if inner:
        longest = float(max(b - a for a, b in inner))
        text = f"{len(inner)} stretch(es) of held samples, the logger repeats a value (likely): {_show(inner, number)}"
        found.append(flag("held", longest, 8, text, "take them out (quality.masked), or use a window without them"))
    if tail:
        a, b = tail[0]
        text = f"dead from sample {number[a]} to the end, {b - a} equal samples (likely)"
        found.append(flag("dead", float(b - a), 8, text, "use the window before, or leave the channel out"))
    part = quiet_part(record, column)
    if part is not None:
        mean, std = float(part.mean()), float(part.std(ddof=1))
        if abs(mean) > OFFSET * std and abs(mean) > 1e-9 * np.abs(y).max():
            unit = record.channels[column].unit
            unit = "" if unit == "arbitrary" else f" {unit}"
            text = f"note: offset {mean:.4g}{unit} in the quiet part ({len(part)} samples, noise {std:.3g}; certain)"
            ratio = abs(mean) / std if std > 0 else float("inf")
            found.append(flag("offset", min(ratio, 1e300), OFFSET, text, "subtract it if the sensor cannot measure it"))
        hum = tone(part, record.dt)
        if hum is not None:
            text = (f"a tone of {hum.frequency:.4g} Hz and amplitude {hum.amplitude:.3g} is {hum.share:.0%} of what it "
                    "reads before the response: hum of the mains or a machine, or an older vibration")  # fmt: skip
            found.append(flag("tone", hum.share, SHARE, text, HUM))
    return found


def _rail_flag(flag: Callable[..., Flag], y: Vector, number: NDArray[Any], side: str, runs: Runs, sure: str) -> Flag:
    count = sum(b - a for a, b in runs)
    rail = float(y[runs[0][0]])
    text = f"{count} samples in {len(runs)} stretch(es) at the {side} rail {rail:.6g} ({sure}): {_show(runs, number)}"
    advice = "lower the gain and measure again, or take these samples out (quality.masked) and let the rest tell"
    if sure == "possible":
        return flag("saturated", float(count), RAIL_RUN, f"saturated: {text}", advice)
    if count > 0.05 * len(y):
        return flag("overload", count / len(y), 0.05, f"overload: clipped, {text}", advice)
    return flag("clipped", float(max(b - a for a, b in runs)), RAIL_RUN, f"clipped: {text}", advice)


def _at_rail(y: Vector, step: float) -> tuple[Runs, str]:
    """Stretches at the upper rail that cut a crest off, and how sure that is."""
    top, span = float(y.max()), float(np.ptp(y))
    exact = [(a, b) for a, b in _runs(y == top) if b - a >= RAIL_RUN]
    # At its top for half of the record: a plateau. Fewer than 16 levels: noise repeats the top one by chance.
    if exact and span >= 16 * step and sum(b - a for a, b in exact) < 0.5 * len(y):
        tolerance = max(2.0 * step, 1e-6 * span)
        if any(_cut(y, r, top, tolerance) for r in exact) or _leaps(y, exact, top, step):
            return exact, "certain" if sum(b - a for a, b in exact) >= 2 * RAIL_RUN else "likely"
    # An amplifier that saturates before the converter leaves a plateau with a little noise on it.
    near = [(a, b) for a, b in _runs(y >= top - 0.005 * span) if b - a >= RAIL_RUN and a > 1 and b < len(y) - 1]
    near = [(a, b) for a, b in near if b - a < 0.1 * len(y) and _entry(y, (a, b), top, both=True) > 0.05 * span]
    if len(near) == 1 and near[0][1] - near[0][0] <= RAIL_RUN:  # a crest of several modes is as flat once
        near = []
    return near, "possible"


def _cut(y: Vector, run: tuple[int, int], top: float, tolerance: float) -> bool:
    """Whether the signal was on its way beyond the rail when it met it.

    A crest that is only as flat as the last bit, or a boxcar, was not: neither the straight line through the two
    samples before (or after) the stretch, nor the parabola through samples a stretch apart, passes the rail.
    """
    a, b = run
    if a < 2 or b > len(y) - 2:  # at the end of the record a long stretch is a hold, not a clip
        return b - a < 0.1 * len(y) and _entry(y, run, top) > tolerance
    if _entry(y, run, top) > tolerance:
        return True
    half, reach = (b - a + 1) / 2, b - a
    if reach < 5 or a - 1 - reach < 0 or b + reach >= len(y):
        return False
    near, far = (min(y[a - 1 - k], y[b + k]) - top for k in (0, reach))
    return bool(near + (near - far) * half**2 / ((half + reach) ** 2 - half**2) > 1.5 * tolerance)


def _leaps(y: Vector, runs: Runs, top: float, step: float) -> bool:
    """Whether a signal that otherwise never repeats a value jumps onto the rail and off it: broadband and cut."""
    equal = int((y[1:] == y[:-1]).sum()) - sum(b - a - 1 for a, b in runs)
    inner = [(a, b) for a, b in runs if a > 0 and b < len(y)]
    jumps = any(top - max(y[a - 1], y[b]) > 16 * step for a, b in inner)
    return jumps and len(y) >= 32 and equal < 0.1 * len(y)


def _entry(y: Vector, run: tuple[int, int], top: float, both: bool = False) -> float:
    """How far the straight line through the two samples before (after) a stretch runs beyond the rail."""
    a, b = run
    excess = []
    if a >= 2:
        excess.append(2 * y[a - 1] - y[a - 2] - top)
    if b <= len(y) - 2:
        excess.append(2 * y[b] - y[b + 1] - top)
    return float((min if both else max)(excess)) if excess else 0.0


def _held(y: Vector, step: float) -> Runs:
    """Stretches in which a channel that otherwise moves repeats one value."""
    same = y[1:] == y[:-1]
    runs = [(a, b + 1) for a, b in _runs(same) if b + 1 - a >= 8]
    if not runs:
        return []
    equal = int(same.sum())
    total = len(same)
    found = []
    for a, b in runs:
        inside = b - a - 1
        # Ends of a rest: a noise-free signal starts from it, or returns to it.
        if a == 0 or y[a] == y[0]:
            continue
        chance = (equal - inside) / max(total - inside, 1)  # equal neighbours in the rest of the record
        if b < len(y):
            chance = _equal_outside(same, runs, equal, total) if len(runs) > 1 else chance
        if chance > 0.5 or total - inside < 32:
            continue
        longest = 0.0 if chance == 0 else 3 * np.log(total) / -np.log(chance)
        jump = abs(y[a] - y[a - 1]) if b == len(y) else max(abs(y[a] - y[a - 1]), abs(y[b] - y[b - 1]))
        if b - a > longest and jump > 2.5 * step:
            found.append((a, b))
    return found


def _equal_outside(same: NDArray[np.bool_], runs: Runs, equal: int, total: int) -> float:
    """Share of equal neighbours outside the long stretches; 1 when these make up most of the record (a staircase)."""
    inside = sum(b - a - 1 for a, b in runs)
    return 1.0 if inside > 0.5 * total else (equal - inside) / (total - inside)


def _onset(x: Vector) -> int | None:
    """First sample beyond the noise of the leading part; 0: that part is no rest; None: nothing starts."""
    finite = ~np.isnan(x)
    if finite[:QUIET_MIN].sum() < QUIET_MIN // 2:
        return 0
    z = np.where(finite, x, np.median(x[:QUIET_MIN][finite[:QUIET_MIN]]))
    stop, bit = QUIET_MIN, _last_bit(z)
    for _ in range(4):  # the level of 64 samples is rough; that of the stretch it finds is better
        centre, sigma = _level(z[:stop])
        deviation = np.abs(z - centre)
        limit = max(ONSET * sigma, 1.5 * bit, 1e-9 * float(deviation.max()))
        beyond = np.flatnonzero(deviation > limit)
        if not beyond.size:
            return None
        onset = int(beyond[0])
        if onset < QUIET_MIN or onset <= stop:
            break
        stop = onset
    if deviation.max() < CONTRAST * sigma:
        return None
    if onset < QUIET_MIN:
        return onset
    # The rest must be no louder than the quietest part of the record, else the record began in the response.
    blocks = z[: len(z) // QUIET_MIN * QUIET_MIN].reshape(-1, QUIET_MIN)
    spread = np.std(blocks - np.median(blocks, axis=1, keepdims=True), axis=1)
    return 0 if sigma > 3 * max(float(spread.min()), bit) else onset


def _level(z: Vector) -> tuple[float, float]:
    centre = float(np.median(z))
    return centre, 1.4826 * float(np.median(np.abs(z - centre)))


def _last_bit(y: Vector) -> float:
    """Smallest step between the values that occur; tiny for numbers that no converter has rounded."""
    levels = np.unique(y)
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-9 * (levels[-1] - levels[0])]
    return float(gaps.min()) if gaps.size else 0.0


def quiet_part(record: Record, column: int) -> Vector | None:
    """Samples of a channel before its own response, without gaps; None where fewer than 32 lead."""
    quiet = quiet_segment(record.values[:, column], record.dt)
    if quiet is None:
        return None
    part = record.values[quiet, column]
    part = part[~np.isnan(part)]
    return part if len(part) >= QUIET_MIN // 2 else None


def _rms(x: Vector) -> float:
    scale = float(np.abs(x).max())
    return 0.0 if scale == 0 else scale * float(np.sqrt(np.mean((x / scale) ** 2)))


def _runs(mask: NDArray[np.bool_]) -> Runs:
    """Stretches where a mask holds."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _show(runs: Runs, number: NDArray[Any] | None = None) -> str:
    def at(i: int) -> int:
        return i if number is None else int(number[i])

    texts = [f"{at(a)}" if b - a == 1 else f"{at(a)}-{at(b - 1)}" for a, b in runs[:5]]
    return "samples " + ", ".join(texts) + (f" and {len(runs) - 5} more" if len(runs) > 5 else "")
