"""The fleet as one page: which asset needs eyes, and how its sensors have been; nothing is fetched."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .. import _page
from .._page import Html, PageSection, SortedCell
from .plan import Plan
from .results import MISFIT, UNKNOWN, Results

Row = Mapping[str, Any]
SHOWN = 200  # alarms, and records without an answer, that are listed; the tables hold all
DAYS = 60  # columns of the picture of the sensors, the last ones
GRADES = "ABCD"
SIGNS = {"some": "~", "bad": "!"}  # of days, for who does not see colours


@dataclass(frozen=True)
class AssetLine:
    """What the page says of one asset.

    Parameters
    ----------
    asset : str
    attention : float
        The larger, the sooner somebody should look.
    why : str
    done, records : int
    grade : str
        The worst of its records, "" where none has one.
    use : float or None
        Largest peak over its limit, where one is stated.
    peak, equivalent : str
        Largest peak with its band; largest damage-equivalent load.
    days : dict of str to dict of str to str
        Sensor -> day -> ``sound``, ``some`` or ``bad``.
    """

    asset: str
    attention: float
    why: str
    done: int
    records: int
    grade: str
    use: float | None
    peak: str
    equivalent: str
    days: Mapping[str, Mapping[str, str]]


def fleet(plan: Plan, found: Results) -> str:
    """The page as text."""
    by = {name: _by_asset(rows) for name, rows in found.rows.items()}
    lines = [_line(plan, asset.name, asset.limits, {n: rows.get(asset.name, []) for n, rows in by.items()})
             for asset in plan.assets]  # fmt: skip
    lines.sort(key=lambda line: (-line.attention, line.asset))
    eyes = sum(1 for line in lines if line.attention > 0)
    records = found.rows["records"]
    done = sum(1 for row in records if row["status"] == "done")
    missing = [row for row in records if row["status"] != "done"]
    alarms = sorted(found.rows["alarms"], key=lambda row: not row["certain"])
    sections = [
        PageSection("Assets", _assets(lines)),
        PageSection("Sensors over time", _sensors(lines)),
        PageSection("Alarms", _listed(alarms, ("asset", "day", "record", "said", "certain"))),
        PageSection("Records without an answer", _listed(missing, ("asset", "record", "status", "said"))),
    ]
    said = (f"{eyes} of {len(lines)} assets need eyes; {done} of {len(records)} records have an answer; "
            f"{len(alarms)} alarms, {sum(1 for row in alarms if row['certain'])} of them certain.")  # fmt: skip
    answer = _page.part("notice", said, "" if eyes else "good")
    return _page.document(
        f"Loads of a fleet: {plan.path.stem}", sections, answer=answer, script=_page.TABLES, wide=True
    )


def _line(
    plan: Plan, name: str, limits: Mapping[str, tuple[float, float]], own: Mapping[str, Sequence[Row]]
) -> AssetLine:
    records, loads, alarms = own["records"], own["loads"], own["alarms"]
    failed = [row for row in records if row["status"] != "done"]
    certain = sum(1 for row in alarms if row["kind"] == "limit" and row["certain"])
    perhaps = sum(1 for row in alarms if row["kind"] == "limit" and not row["certain"])
    ill = len({(row["about"], row["day"]) for row in alarms if row["kind"] == "sensor"})
    poor = sum(1 for row in records if row["status"] == "done" and row["grade"] == GRADES[-1])
    counted = (
        (certain, 1000, "beyond a limit"), (perhaps, 100, "perhaps beyond a limit"),
        (len(failed), 50, "without an answer"), (ill, 10, "findings on sensors"), (poor, 1, f"of grade {GRADES[-1]}"),
    )  # fmt: skip
    attention = sum(weight * (1 + count / (len(records) + count)) for count, weight, _ in counted if count)
    grades = [row["grade"] for row in records if row["status"] == "done"]
    uses = [max(row["max"] / limits[row["load"]][1], row["min"] / limits[row["load"]][0])
            for row in loads if row["load"] in limits and 0 not in limits[row["load"]]]  # fmt: skip
    top = max(loads, key=lambda row: abs(row["peak"]), default=None)
    worn = ""
    if plan.fatigue is not None and loads:
        m = f"equivalent_m{plan.fatigue.exponents[-1]:g}"
        most = max(loads, key=lambda row: row[m])
        worn = f"{most[m]:.4g} {most['unit']}"
    peak = "" if top is None else f"{top['peak']:.4g} ± {1.96 * top['peak_std']:.2g} {top['unit']} ({top['load']})"
    why = ", ".join(f"{count} {words}" for count, _, words in counted if count)
    return AssetLine(name, attention, why, len(records) - len(failed), len(records), max(grades, default=""),
                max(uses, default=None), peak, worn, _days(own["sensors"], alarms))  # fmt: skip


def _days(sensors: Iterable[Row], alarms: Iterable[Row]) -> dict[str, dict[str, str]]:
    """Every day of every sensor: bad where something was found, some where its misfit or its gaps stand out."""
    days: dict[str, dict[str, str]] = {}
    odd = {(row["about"], row["record"]) for row in alarms if row["kind"] == "sensor"}
    for row in sensors:
        state = (
            "bad" if row["found"] else "some" if (row["sensor"], row["record"]) in odd or row["missing"] else "sound"
        )
        own = days.setdefault(row["sensor"], {})
        own[row["day"]] = max(own.get(row["day"], "sound"), state, key=("sound", "some", "bad").index)
    return days


def _by_asset(rows: Iterable[Row]) -> dict[str, list[Row]]:
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row["asset"], []).append(row)
    return found


def _assets(lines: Sequence[AssetLine]) -> Html:
    heads = ("needs eyes", "asset", "why", "records", "worst grade", "peak / limit", "largest peak (95 %)",
             "equivalent load")  # fmt: skip
    rows = [
        (
            SortedCell(_page.part("eyes", line.attention > 0), round(line.attention, 4)), line.asset, line.why,
            SortedCell(f"{line.done} of {line.records}", line.done), line.grade,
            SortedCell("" if line.use is None else f"{100 * line.use:.0f} %", line.use or 0),
            line.peak, line.equivalent,
        )
        for line in lines
    ]  # fmt: skip
    return _page.table(rows, heads, sortable=True)


def _sensors(lines: Sequence[AssetLine]) -> Html | str:
    days = sorted({day for line in lines for own in line.days.values() for day in own} - {UNKNOWN})[-DAYS:]
    days = days or [UNKNOWN]
    rows = []
    for line in lines:
        for sensor, own in line.days.items():
            states = [(day, own.get(day, "none")) for day in days]
            marks = [(day, state, SIGNS.get(state, "")) for day, state in states]
            rows.append((line.asset, sensor, _page.part("days", marks)))
    words = (f"A mark is a day, {days[0]} to {days[-1]}: green is sound, yellow (~) has gaps or a misfit {MISFIT:g} "
             "times its usual one, red (!) has findings (clipped, flat, held, ...), grey has no record.")  # fmt: skip
    if not rows:
        return ""
    return _page.joined(_page.part("quiet", words), _page.table(rows, ("asset", "sensor", "days"), sortable=True))


def _listed(rows: Sequence[Row], names: Sequence[str]) -> Html | str:
    if not rows:
        return ""
    more = len(rows) - SHOWN
    shown = _page.table(
        [[_word(row[name]) for name in names] for row in rows[:SHOWN]],
        [name.replace("said", "what") for name in names], sortable=True,
    )  # fmt: skip
    return _page.joined(shown, _page.part("quiet", f"and {more} more, in the tables") if more > 0 else "")


def _word(value: Any) -> str:
    return ("yes" if value else "no") if isinstance(value, bool) else str(value)
