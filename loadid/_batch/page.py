"""The fleet as one page: which asset needs eyes, and how its sensors have been; nothing is fetched."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import Any

from .plan import Plan
from .results import MISFIT, UNKNOWN, Results

Row = Mapping[str, Any]
SHOWN = 200  # alarms, and records without an answer, that are listed; the tables hold all
DAYS = 60  # columns of the picture of the sensors, the last ones
GRADES = "ABCD"
STYLE = """
.eyes { font-weight: 600; color: var(--warn); } th[data-sort] { cursor: pointer; }
th[data-sort]::after { content: " \\2195"; color: var(--quiet); }
.day { display: inline-block; width: .7rem; height: 1rem; margin-right: 1px; vertical-align: middle; }
.good { background: #7fbf9f; } .some { background: #f0c36d; } .bad { background: #b34700; } .none { background: #eee; }
.wide { max-width: 90rem; } td { min-width: 0; }
"""
SCRIPT = """
for (const head of document.querySelectorAll('th[data-sort]')) head.addEventListener('click', () => {
  const body = head.closest('table').tBodies[0], at = head.cellIndex, up = head.dataset.up !== 'yes';
  head.dataset.up = up ? 'yes' : 'no';
  const key = row => row.cells[at].dataset.v ?? row.cells[at].textContent;
  const order = (a, b) => { const x = key(a), y = key(b), d = x - y;
    return (Number.isNaN(d) ? x.localeCompare(y) : d) * (up ? 1 : -1); };
  body.append(...[...body.rows].sort(order));
});
"""


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
        Sensor -> day -> ``good``, ``some`` or ``bad``.
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
        ("Assets", _assets(lines)),
        ("Sensors over time", _sensors(lines)),
        ("Alarms", _listed(alarms, ("asset", "day", "record", "said", "certain"))),
        ("Records without an answer", _listed(missing, ("asset", "record", "status", "said"))),
    ]
    body = "\n".join(f"<section>\n<h2>{name}</h2>\n{text}\n</section>" for name, text in sections if text)
    policy = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
    css = files("loadid").joinpath("report.css").read_text(encoding="utf-8")
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<title>Loads of a fleet: {escape(plan.path.stem)}</title>
<style>
{css}{STYLE}</style>
</head>
<body class="wide">
<header>
<h1>Loads of a fleet: {escape(plan.path.stem)}</h1>
<p class="{"notice" if eyes else "notice good"}">{eyes} of {len(lines)} assets need eyes; {done} of {len(records)}
records have an answer; {len(alarms)} alarms, {sum(1 for row in alarms if row["certain"])} of them certain.</p>
</header>
<main>
{body}
</main>
<script>{SCRIPT}</script>
</body>
</html>
"""


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
        state = "bad" if row["found"] else "some" if (row["sensor"], row["record"]) in odd or row["missing"] else "good"
        own = days.setdefault(row["sensor"], {})
        own[row["day"]] = max(own.get(row["day"], "good"), state, key=("good", "some", "bad").index)
    return days


def _by_asset(rows: Iterable[Row]) -> dict[str, list[Row]]:
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row["asset"], []).append(row)
    return found


def _assets(lines: Sequence[AssetLine]) -> str:
    heads = ("needs eyes", "asset", "why", "records", "worst grade", "peak / limit", "largest peak (95 %)",
             "equivalent load")  # fmt: skip
    rows = []
    for line in lines:
        use = "" if line.use is None else f"{100 * line.use:.0f} %"
        eyes = '<span class="eyes">look</span>' if line.attention else "no"
        cells = (
            (f"{line.attention:.4f}", eyes), (None, escape(line.asset)), (None, escape(line.why)),
            (line.done, f"{line.done} of {line.records}"), (None, line.grade), (line.use or 0, use),
            (None, escape(line.peak)), (None, escape(line.equivalent)),
        )  # fmt: skip
        rows.append("".join(_cell(value, text) for value, text in cells))
    return _table(heads, rows, sortable=True)


def _cell(value: Any, text: str) -> str:
    return f"<td>{text}</td>" if value is None else f'<td data-v="{value}">{text}</td>'


def _sensors(lines: Sequence[AssetLine]) -> str:
    days = sorted({day for line in lines for own in line.days.values() for day in own} - {UNKNOWN})[-DAYS:]
    days = days or [UNKNOWN]
    rows = []
    for line in lines:
        for sensor, own in line.days.items():
            marks = "".join(
                f'<span class="day {own.get(day, "none")}" title="{escape(day)}: {own.get(day, "no record")}"></span>'
                for day in days
            )
            rows.append(f"<td>{escape(line.asset)}</td><td>{escape(sensor)}</td><td>{marks}</td>")
    words = (f'<p class="quiet">A mark is a day, {escape(days[0])} to {escape(days[-1])}: green is sound, yellow has '
             f"gaps or a misfit {MISFIT:g} times its usual one, red has findings (clipped, flat, held, ...), grey has "
             "no record.</p>")  # fmt: skip
    return words + _table(("asset", "sensor", "days"), rows, sortable=True) if rows else ""


def _listed(rows: Sequence[Row], names: Sequence[str]) -> str:
    if not rows:
        return ""
    shown = ["".join(f"<td>{escape(_word(row[name]))}</td>" for name in names) for row in rows[:SHOWN]]
    more = len(rows) - SHOWN
    rest = f'<p class="quiet">and {more} more, in the tables</p>' if more > 0 else ""
    return _table([name.replace("said", "what") for name in names], shown, sortable=True) + rest


def _word(value: Any) -> str:
    return ("yes" if value else "no") if isinstance(value, bool) else str(value)


def _table(heads: Sequence[str], rows: Sequence[str], *, sortable: bool) -> str:
    mark = ' data-sort="yes"' if sortable else ""
    top = "".join(f"<th{mark}>{escape(head)}</th>" for head in heads)
    body = "\n".join(f"<tr>{row}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{top}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>'
