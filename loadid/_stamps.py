"""Time stamps as people and loggers write them: dates and times of day in their local order, time zones, epochs."""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._advice import Advice, either
from structures.errors import InputError

SECOND = 10**9  # in ns, in which stamps are counted
DAY = 86_400 * SECOND
FIRST_DAY = dt.date(1970, 1, 1)
HOUR = 3_600 * SECOND
LONGEST = 64  # characters of a stamp
EPOCHS = (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
BETWEEN = (946_684_800.0, 4_102_444_800.0)  # years 2000 to 2100, in s since 1970
ZONES = {"Z": 0, "UTC": 0, "GMT": 0, "CET": 60, "MEZ": 60, "CEST": 120, "MESZ": 120, "EST": -300, "EDT": -240,
         "PST": -480, "PDT": -420}  # fmt: skip
MONTHS = {
    name: k + 1
    for k, names in enumerate(("jan", "feb", "mar mär mrz", "apr", "may mai", "jun", "jul", "aug", "sep", "oct okt",
                               "nov", "dec dez"))
    for name in names.split()
}  # fmt: skip
ORDERS = {"DMY": "day first", "MDY": "month first"}

_CLOCK = re.compile(
    r"(?:(?P<date>[^T:]*?[\d.])(?:[T_]|,?\s+))?(?P<hour>\d{1,2}):(?P<minute>\d\d)"
    r"(?::(?P<second>\d\d)(?:[.,:](?P<part>\d{1,12}))?)?(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?\s*(?P<zone>\S.*)?",
    re.ASCII,
)
_COMPACT, _COLONS = re.compile(r"(\d{8}T\d\d)(\d\d)(\d\d)(?=\D|$)"), r"\1:\2:\3"
_YEAR_FIRST = re.compile(r"(?P<y>\d{4})(?:(?P<s>[-/.])(?P<m>\d{1,2})(?P=s)(?P<d>\d{1,2})|(?P<mm>\d\d)(?P<dd>\d\d))")
_YEAR_LAST = re.compile(r"(?P<a>\d{1,2})(?P<s>[-/.])(?P<b>\d{1,2})(?P=s)(?P<y>\d{4}|\d\d)")
_NAMED = re.compile(
    r"(?:(?P<d>\d{1,2})\.?[- ]?(?P<m>[^\W\d]{3,9})|(?P<m2>[^\W\d]{3,9})\.?[- ](?P<d2>\d{1,2}),?)\.?[- ]?"
    r"(?P<y>\d{4}|\d\d)"
)
_OFFSET = re.compile(r"(?:UTC|GMT)?(?P<sign>[+-])(?P<hour>\d\d?)(?::?(?P<minute>\d\d))?")


@dataclass(frozen=True)
class Stamps:
    """When the samples of a column were taken.

    Parameters
    ----------
    seconds : array, shape (samples,)
        After the first one.
    start : float or None
        Of the first one, in s since 1970 (UTC); None where only the time of day is known.
    notes : tuple of str
        What was decided.
    """

    seconds: NDArray[np.float64]
    start: float | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Date:
    """Two numbers whose order may be open, and the year."""

    a: int
    b: int
    year: int
    open: bool = False

    def on(self, order: str) -> dt.date:
        """The day; ValueError where there is none."""
        day, month = (self.a, self.b) if order == "DMY" or not self.open else (self.b, self.a)
        return dt.date(self.year, month, day)


def is_stamp(text: str) -> bool:
    """Whether a text has the form of a date, of a time of day, or of both."""
    return form(text) != ""


def form(text: str) -> str:
    """What a text is by its form: ``"stamp"`` (date and time), ``"date"``, ``"time"``, or ``""``."""
    if not 5 <= len(text) <= LONGEST or not any(c.isdigit() for c in text):
        return ""
    text = text.strip()
    found = _matched(text)
    if found is None:
        return "date" if not text.isdigit() and _date(text) else ""
    if found["zone"] and _minutes(found["zone"]) is None:
        return ""
    return "time" if found["date"] is None else "stamp" if _date(found["date"]) else ""


def epoch(seconds: NDArray[Any], unit: str | None = None) -> tuple[str, float] | None:
    """Unit of numbers that count from 1970, by their size: name and seconds; None where they are no such numbers.

    Parameters
    ----------
    seconds : array
        As recorded.
    unit : str, optional
        The unit that the file states: the only one that they may have.
    """
    middle = float(np.median(seconds)) if len(seconds) else 0.0
    for name, size in EPOCHS:
        if (unit is None or unit == name) and BETWEEN[0] <= middle * size <= BETWEEN[1]:
            return name, size
    return None


def utc(when: float | str | dt.datetime | np.datetime64 | None, where: str = "start") -> float | None:
    """Seconds since 1970 of a moment; one without a zone is in UTC.

    Raises
    ------
    InputError
        A text that is no date with a time, a number that is not finite.
    """
    if when is None:
        return None
    if isinstance(when, str):
        if (found := seconds(when)) is not None:
            return found
    elif isinstance(when, np.datetime64):
        if not np.isnat(when):
            return int(when.astype("datetime64[ns]").astype(np.int64)) / SECOND
    elif isinstance(when, dt.datetime):
        return (when if when.tzinfo else when.replace(tzinfo=dt.UTC)).timestamp()
    else:
        try:
            if np.isfinite(float(when)):
                return float(when)
        except (TypeError, ValueError):
            pass
    raise InputError("this is no moment", where=where, found=repr(when)[:80],
                     expected="seconds since 1970 (UTC), or a text such as 2026-11-24T15:38:01Z")  # fmt: skip


def nanoseconds(moment: float) -> int:
    """Nanoseconds of a moment in s, of the decimals that tell the number from its neighbours."""
    return round(Decimal(repr(float(moment))) * SECOND)


def iso(moment: float) -> str:
    """ISO 8601 text in UTC of a moment in s since 1970, with as many decimals as it needs, nine at most."""
    whole, part = divmod(nanoseconds(moment), SECOND)
    text = dt.datetime.fromtimestamp(whole, dt.UTC).strftime("%Y-%m-%dT%H:%M:%S")
    return text + (f".{part:09d}".rstrip("0") if part else "") + "Z"


def seconds(text: str) -> float | None:
    """Seconds since 1970 of one stamp, in UTC where it names no zone; None where it is none, or has two readings."""
    found = _matched(text)
    date = _date(text.strip() if found is None else found["date"] or "")
    minutes = _minutes(found["zone"]) if found is not None and found["zone"] else 0
    if date is None or minutes is None or (date.open and date.a != date.b and max(date.a, date.b) <= 12):
        return None
    try:
        days = (date.on("MDY" if date.b > 12 else "DMY") - FIRST_DAY).days
        clock = 0 if found is None else _of_day(found, text, "")
    except ValueError:  # no such day, no such time of day
        return None
    return (days * DAY + clock - 60 * SECOND * minutes) / SECOND


def of_texts(texts: Sequence[str], where: str, stated: str | None = None) -> Stamps:
    """Stamps of a column of texts.

    Parameters
    ----------
    texts : sequence of str
        Dates with times, dates alone, or times of day, which run on past midnight.
    where : str
        For messages.
    stated : str, optional
        What the caller says of them: the order of a date (``"DD/MM/YYYY"``, ``"MDY"``), a time zone
        (``"Europe/Berlin"``, ``"UTC+1"``), or both, parted by a blank.

    Raises
    ------
    InputError
        A text that is no stamp, a day that does not exist, an order of day and month that cannot be told, an unknown
        zone, a time that its zone passes over.
    """
    order, zone = _said(stated, where)
    dates, clocks, offsets = [], np.empty(len(texts), np.int64), []
    for k, text in enumerate(texts):
        found = _matched(text)
        if found is None:
            dates.append(text.strip())
            offsets.append("")
            clocks[k] = 0
            continue
        dates.append(found["date"] or "")
        offsets.append(found["zone"] or "")
        clocks[k] = _of_day(found, text, where)
    days, notes = _days(dates, order, where)
    local = clocks if days is None else days * DAY + clocks
    if days is None:
        return Stamps(_past_midnight(local) / SECOND, None, ("stamps are times of day: the date is not known",))
    return _placed(local, offsets, zone, where, notes)


def of_datetimes(stamps: NDArray[np.datetime64], where: str, stated: str | None = None, aware: bool = False) -> Stamps:
    """Stamps of an array ``datetime64``; `aware` says that they are in UTC.

    Raises
    ------
    InputError
        NaT; otherwise as for `of_texts`.
    """
    _, zone = _said(stated, where)
    if np.isnat(stamps).any():
        raise InputError("a time stamp is missing", where=where, found=f"row {int(np.argmax(np.isnat(stamps))) + 1}",
                         expected="a stamp for every sample", hint="delete that row")  # fmt: skip
    local = stamps.astype("datetime64[ns]").astype(np.int64)
    return _placed(local, ["Z" if aware else ""] * len(local), None if aware else zone, where, [])


# -- parts of a stamp --------------------------------------------------------------------------------------------------
@lru_cache(1024)
def _date(text: str) -> _Date | None:
    """Day, month and year of a text; None where it is no date."""
    text = text.strip()
    if found := _YEAR_FIRST.fullmatch(text):
        return _possible(_Date(int(found["d"] or found["dd"]), int(found["m"] or found["mm"]), int(found["y"])))
    if found := _YEAR_LAST.fullmatch(text):
        return _possible(_Date(int(found["a"]), int(found["b"]), _year(found["y"]), found["s"] != "."))
    if found := _NAMED.fullmatch(text):
        month = MONTHS.get((found["m"] or found["m2"])[:3].casefold())
        return None if month is None else _possible(_Date(int(found["d"] or found["d2"]), month, _year(found["y"])))
    return None


def _year(text: str) -> int:
    return int(text) + (2000 if len(text) == 2 else 0)


def _possible(date: _Date) -> _Date | None:
    low, high = sorted((date.a, date.b)) if date.open else (date.b, date.a)
    return date if 1 <= low <= 12 and 1 <= high <= 31 and 1900 <= date.year <= 2200 else None


def _matched(text: str) -> re.Match[str] | None:
    if len(text) > LONGEST:
        return None
    return _CLOCK.fullmatch((text if ":" in text else _COMPACT.sub(_COLONS, text)).strip())


def _minutes(zone: str) -> int | None:
    """Offset of a zone from UTC in minutes; None where it is not known."""
    zone = zone.strip()
    if zone.upper() in ZONES:
        return ZONES[zone.upper()]
    found = _OFFSET.fullmatch(zone)
    if found is None or int(found["hour"]) > 14 or int(found["minute"] or 0) > 59:
        return None
    return (1 if found["sign"] == "+" else -1) * (60 * int(found["hour"]) + int(found["minute"] or 0))


def _of_day(found: re.Match[str], text: str, where: str) -> int:
    """Time of day in ns."""
    hour, minute, second = int(found["hour"]), int(found["minute"]), int(found["second"] or 0)
    if found["half"]:
        if not 1 <= hour <= 12:
            hour = 99
        hour = hour % 12 + (12 if found["half"] in "Pp" else 0) if hour < 99 else hour
    if hour > 23 or minute > 59 or second > 60:
        raise InputError("there is no such time of day", where=where, found=repr(text[:LONGEST]),
                         expected="0:00:00 to 23:59:59")  # fmt: skip
    return (hour * 3600 + minute * 60 + second) * SECOND + int((found["part"] or "0")[:9].ljust(9, "0"))


def _said(stated: str | None, where: str) -> tuple[str | None, Any]:
    """Order of a date and zone that the caller states."""
    order = zone = None
    for word in (stated or "").split():
        letters = re.sub(r"(.)\1*", r"\1", re.sub(r"[^A-Z]", "", word.upper()))
        if letters in (*ORDERS, "YMD"):
            order = letters
        elif (minutes := _minutes(word)) is not None:
            zone = dt.timezone(dt.timedelta(minutes=minutes))
        else:
            zone = _named_zone(word, where)
    return order, zone


def _named_zone(name: str, where: str) -> Any:
    import zoneinfo

    try:
        return zoneinfo.ZoneInfo(name)
    except (zoneinfo.ZoneInfoNotFoundError, ValueError, OSError):
        raise InputError(
            "a column of time stamps has no such unit",
            where=where,
            found=repr(name[:LONGEST]),
            expected="the order of its dates (DD/MM/YYYY or MM/DD/YYYY), its zone (Europe/Berlin, UTC+1), or both",
            hint="names of zones are those of the IANA time zone database",
        ) from None


def _days(dates: list[str], order: str | None, where: str) -> tuple[NDArray[np.int64] | None, list[str]]:
    """Days since 1970 of the dates of a column; None where it has none."""
    texts = dict.fromkeys(dates)
    if list(texts) == [""]:
        return None, []
    known: dict[str, _Date] = {}
    for text in texts:
        date = _date(text)
        if date is None:
            raise InputError("a cell is no time stamp", where=where, found=f"row {dates.index(text) + 1}: {text!r}",
                             expected="a date and a time in every row, as 2026-11-24 15:38:01.5 or "
                             "24.11.2026 15:38:01,5")  # fmt: skip
        known[text] = date
    chosen, notes = _order(known, order, where)
    number = {}
    for text, date in known.items():
        try:
            number[text] = (date.on(chosen) - FIRST_DAY).days
        except ValueError:
            raise InputError("there is no such day", where=where, found=repr(text), expected="a day of the calendar",
                             hint="" if not date.open else f"dates are read {ORDERS[chosen]}") from None  # fmt: skip
    return np.array([number[text] for text in dates], np.int64), notes


def _order(known: dict[str, _Date], order: str | None, where: str) -> tuple[str, list[str]]:
    """Whether the day or the month comes first, where the dates leave it open."""
    open_ = {text: date for text, date in known.items() if date.open and date.a != date.b}
    if not open_:
        return "DMY", []
    if order in ORDERS:
        return order, [f"dates are read {ORDERS[order]}, as stated"]
    day, month = any(d.a > 12 for d in open_.values()), any(d.b > 12 for d in open_.values())
    if day and month:
        raise InputError("dates in two orders", where=where, found=", ".join(list(known)[:3]),
                         expected="the day first in all of them, or the month",
                         hint="write dates as 2026-11-24")  # fmt: skip
    if not (day or month):
        text, date = next(iter(open_.items()))
        both = [date.on(o) for o in ORDERS]
        raise InputError("the day or the month may come first in these dates", where=where,
                         found=f"{text!r}: {both[0].isoformat()} (day first) or {both[1].isoformat()} (month first)",
                         expected="dates that can be read in one way",
                         hint=_stating("DD/MM/YYYY", "or MM/DD/YYYY"))  # fmt: skip
    chosen = "DMY" if day else "MDY"
    return chosen, [f"dates are read {ORDERS[chosen]}: no other order fits all of them"]


def _past_midnight(clock: NDArray[np.int64]) -> NDArray[np.int64]:
    """Times of day that run on: one that falls by more than half a day is of the next one."""
    back = np.diff(clock, prepend=clock[:1]) < -DAY // 2
    return np.asarray(clock + np.cumsum(back) * DAY - clock[:1], np.int64)


# -- zones -------------------------------------------------------------------------------------------------------------
def _placed(local: NDArray[np.int64], offsets: list[str], zone: Any, where: str, notes: list[str]) -> Stamps:
    """Local times in UTC."""
    shift = {text: _minutes(text) if text else None for text in dict.fromkeys(offsets)}
    unknown = [text for text, minutes in shift.items() if text and minutes is None]
    if unknown or ("" in shift and len(shift) > 1):
        raise InputError("unknown time zone" if unknown else "only some stamps have a time zone", where=where,
                         found=repr(unknown[0][:LONGEST]) if unknown else ", ".join(map(repr, list(shift)[:4])),
                         expected="Z or an offset such as +01:00 in every stamp, or in none")  # fmt: skip
    if "" not in shift:
        times = local - np.array([60 * SECOND * (shift[text] or 0) for text in offsets], np.int64)
        if len(set(shift.values())) > 1:
            notes.append(f"the offset from UTC changes ({', '.join(shift)}): the samples are placed in UTC")
    elif zone is None:
        times = local
        notes += ["stamps name no time zone: taken as UTC", *_summer(local, where)]
    else:
        times, more = _in_zone(local, zone, where)
        notes += [f"stamps are read in the time zone {zone}", *more]
    if not len(times):
        return Stamps(np.zeros(0), None, tuple(notes))
    return Stamps((times - times[0]) / SECOND, int(times[0]) / SECOND, tuple(notes))


def _summer(local: NDArray[np.int64], where: str) -> list[str]:
    """What a clock that names no zone does where summer time begins; refused where it ends."""
    steps = np.diff(local)
    if not len(steps):
        return []
    usual = int(np.median(steps))
    near = max(2 * usual, 2 * SECOND)
    back = np.flatnonzero(np.abs(steps + HOUR - usual) <= near)
    if usual < HOUR // 2 and len(back):
        raise InputError("the clock goes back by an hour, as where summer time ends", where=where,
                         found=f"after sample {int(back[0])}, {_shown(local[back[0]])}", expected="rising stamps",
                         hint=_stating("Europe/Berlin", "or the zone of the clock"))  # fmt: skip
    ahead = np.flatnonzero((np.abs(steps - HOUR - usual) <= near) & (local[1:] % HOUR <= near))
    if usual < HOUR // 2 and len(ahead):
        at = f"after sample {int(ahead[0])}, {_shown(local[ahead[0]])}"
        return [f"the clock goes on by an hour {at}: where summer time begins there, state the zone of that column"]
    return []


def _in_zone(local: NDArray[np.int64], zone: Any, where: str) -> tuple[NDArray[np.int64], list[str]]:
    """Times of a zone in UTC; an hour that comes twice is told apart by the stamps around it."""
    quarter = 900 * SECOND
    blocks, of = np.unique(local // quarter, return_inverse=True)
    both = np.array([_offsets(int(b) * quarter, zone) for b in blocks], np.int64).reshape(-1, 2) * SECOND
    first, second = local - both[of, 0], local - both[of, 1]
    skipped = np.flatnonzero(first > second)
    if len(skipped):
        raise InputError("the zone has no such time: summer time begins there", where=where,
                         found=f"{_shown(local[skipped[0]])} in {zone}", expected=f"stamps of {zone}",
                         hint="state the zone in which the stamps were written, for example UTC")  # fmt: skip
    times, notes = first.copy(), []
    twice = np.flatnonzero(first < second)
    for run in np.split(twice, np.flatnonzero(np.diff(twice) > 1) + 1) if len(twice) else ():
        begin, end = int(run[0]), int(run[-1]) + 1
        back = begin + 1 + np.flatnonzero(np.diff(local[begin:end]) < 0)
        alone = begin == 0 and end == len(local)
        turn = int(back[0]) if len(back) else begin if begin == 0 and not alone else end
        times[turn:end] = second[turn:end]
        notes.append(f"the hour of {_shown(local[begin])} comes twice where summer time ends: "
                     + ("taken as the first, in summer time" if alone and not len(back) else
                        "told apart by the stamps around it"))  # fmt: skip
    return times, notes


def _offsets(local: int, zone: Any) -> tuple[int, int]:
    """Offsets in s of a local time (ns) from UTC, as the first and as the second of two alike."""
    when = dt.datetime(1970, 1, 1) + dt.timedelta(seconds=local // SECOND)
    first, second = (when.replace(tzinfo=zone, fold=fold).utcoffset() or dt.timedelta() for fold in (0, 1))
    return int(first.total_seconds()), int(second.total_seconds())


def _stating(unit: str, also: str) -> Advice:
    """How a unit of the stamps is stated."""
    return Advice("state it: ", either(f'units={{"time": "{unit}"}}', f"--unit time={unit}"), f", {also}")


def _shown(local: int) -> str:
    return str(np.datetime64(int(local) // 10**6, "ms")).replace("T", " ")
