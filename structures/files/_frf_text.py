"""FRFs in text tables: a column of frequencies, and for each FRF its real and imaginary part or magnitude and phase.

The headings say it, in English, German or French, as analysers export them: ``Frequency [Hz], Real [(m/s^2)/N], Imag``,
``f (Hz); Betrag 1+Z/5+Z (g/N); Phase 1+Z/5+Z (deg)``. A column of coherence is read past.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .. import units
from ._curves import FRF, OPEN, Trace, label_of
from ._recorded import StatedUnit, refuse
from ._uff import ratio

TEXT = (".csv", ".txt", ".tsv", ".dat", ".asc", ".tab", ".frf")
BUDGET = 2**28  # bytes of a file
DELIMITERS = (("\t", "."), ("\t", ","), (";", "."), (";", ","), (",", "."), (None, "."), (None, ","))
_FREQUENCY = re.compile(r"(?:freq\w*|fr[eé]quence|f|hz|linie|line)\b.*|.*\bfrequen(?:cy|z)\b.*", re.IGNORECASE)
_PARTS = {
    "real": r"re|real|realteil|r[eé]el(?:le)?", "imag": r"im|imag|imaginary|imagin[aä]rteil|imaginaire",
    "magnitude": r"mag|magnitude|abs|amp|amplitude|betrag|modulus?|module", "phase": r"phase?|phi|ph|arg|angle|winkel",
    "coherence": r"coh|coherence|koh[aä]renz|coh[eé]rence",
}  # fmt: skip
_WORDS = {part: re.compile(rf"(?<![^\W_])(?:{words})(?![^\W_])(?:[\s_]*part)?", re.IGNORECASE)
          for part, words in _PARTS.items()}  # fmt: skip
_WITH_UNIT = re.compile(r"(?P<name>[^\[\]]*?)\s*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>.*)\))?\s*", re.DOTALL)
_FORM = re.compile(r"[+-]?\d*(?:[.,](?P<decimals>\d*))?(?:[eEdD][+-]?(?P<exponent>\d+))?", re.ASCII)
NAME, LONGEST = 200, 100_000  # characters of the name of a column, and of all of them
_FORMS = {"real": ("real", "imag"), "magnitude": ("magnitude", "phase")}
_SHOWN = {"real": "real and imaginary part", "magnitude": "magnitude and phase"}


@dataclass(frozen=True)
class Pair:
    """Two columns that are one FRF: its name, how it is written ("real" or "magnitude"), their places."""

    name: str
    form: str
    first: int
    second: int


def pairs_of(names: Sequence[str]) -> list[Pair] | None:
    """FRFs among the columns of a table, by their headings without units; None where it is no table of FRFs.

    The first column is the frequency; every other one is half of a pair, or a coherence. Of an FRF in both forms its
    real and imaginary part are taken; headings that come again belong to the next FRF.
    """
    if len(names) < 3 or any(len(n) > NAME for n in names) or not _FREQUENCY.fullmatch(names[0].strip()):
        return None
    parts: dict[str, dict[str, list[int]]] = {}
    for column, name in enumerate(names[1:], 1):
        part = next((p for p, word in _WORDS.items() if word.search(name)), None)
        if part is None:
            return None
        rest = _WORDS[part].sub(" ", name, count=1).strip(" _:,.()|")
        base = re.sub(r"\s+", " ", re.sub(r"^-\s|\s-$", "", rest)).strip()
        if part != "coherence":
            parts.setdefault(base, {}).setdefault(part, []).append(column)
    found = []
    for base, columns in parts.items():
        form = next((f for f, both in _FORMS.items() if set(both) <= set(columns)), None)
        if form is None or len({len(c) for c in columns.values()}) > 1:
            return None
        both = list(zip(*(columns[p] for p in _FORMS[form]), strict=True))
        again = [base] if len(both) == 1 else [f"{base} {k + 1}".strip() for k in range(len(both))]
        found += [Pair(name, form, *places) for name, places in zip(again, both, strict=True)]
    return found or None


def described(pairs: Sequence[Pair]) -> str:
    """What a table of FRFs holds, for messages."""
    names = [p.name for p in pairs if p.name]
    listed = f" of {', '.join(names[:6])}{', ...' if len(names) > 6 else ''}" if names else ""
    return f"a column of frequencies, {_SHOWN[pairs[0].form]}{listed}"


def read_text(path: Path, frequency_unit: str) -> list[Trace]:
    """FRFs of a text table.

    Raises
    ------
    InputError
        Headings that do not say what the columns are, phases without a unit, magnitudes in dB, cells that are no
        numbers, a file that is cut.
    """
    where = str(path)
    names, texts, values = _table(path, where)
    pairs = pairs_of(names)
    if pairs is None:
        refuse(where, "the headings name no FRFs", ", ".join(names)[:300] or "none",
               "Frequency, and for each FRF Real and Imag, or Magnitude and Phase",
               "name the columns: Frequency [Hz], Real 1+Z/5+Z [(m/s^2)/N], Imag 1+Z/5+Z; loadid.read reads records "
               "over time, and loadid calibrate makes a model of them")  # fmt: skip
    f = values[:, 0] * _hertz(texts[0] or frequency_unit, where)
    if not np.all(np.diff(f) > 0) or f[0] < 0:
        refuse(where, "the frequencies do not rise", f"{f[0]:g} to {f[-1]:g} Hz", "rising frequencies, not negative")
    return [_curve(p, f, values, texts, where) for p in pairs]


def _curve(pair: Pair, f: NDArray[np.float64], values: NDArray[np.float64], texts: list[str], where: str) -> Trace:
    first, second = values[:, pair.first], values[:, pair.second]
    text = texts[pair.first]
    if re.match(r"dB\b", text):
        refuse(where, "magnitudes in dB", f"{pair.name or 'Magnitude'} [{text}]", "linear magnitudes",
               "export them linear, as the reference of the decibels is not known")  # fmt: skip
    if pair.form == "real":
        H = first + 1j * second
    else:
        turned = texts[pair.second].strip("° ").lower() or ("deg" if "°" in texts[pair.second] else "")
        if not units.known(turned) or units.parse(turned).quantity != "angle":
            refuse(where, "the unit of the phase is not known", texts[pair.second] or "nothing", "deg or rad",
                   "write it into the heading: Phase [deg]")  # fmt: skip
        H = first * np.exp(1j * second * units.parse(turned).factor)
    response, slash, reference = pair.name.partition("/")
    over, under = _units(text)
    label = label_of(re.sub(r"^(?:FRF|H\d?)\b[\s:]*", "", response) or response)
    return Trace(FRF, f, H, label, label_of(reference) if slash else "", over, under)


def _units(text: str) -> tuple[StatedUnit, StatedUnit]:
    """Units of response and reference; of a text that is not known, none."""
    if not text:
        return OPEN, OPEN
    both = ratio(text)
    if both is None:
        unknown = StatedUnit(None, None, f"its unit reads {text!r}, no unit of a response over one of a force")
        return unknown, unknown
    left, right = (units.parse(t) for t in both)
    return StatedUnit(left, left.quantity), StatedUnit(right, right.quantity)


def _hertz(text: str, where: str) -> float:
    unit = units.parse(text, channel="frequency", where=where)
    scale = {"frequency": 1.0, "angular_velocity": 1 / (2 * np.pi)}.get(unit.quantity)
    if scale is None:
        refuse(where, "the first column is no frequency", f"its unit is {text}", "Hz or rad/s")
    return unit.factor * scale


def _table(path: Path, where: str) -> tuple[list[str], list[str], NDArray[np.float64]]:
    """Names, units ("" where there are none) and numbers of the columns."""
    try:
        if path.stat().st_size > BUDGET:
            refuse(where, "the file is too large", f"{path.stat().st_size} bytes", f"at most {BUDGET}")
        data = path.read_bytes()
    except OSError as error:
        refuse(where, "the file cannot be read", error.strerror or error, "a file that may be read", "check the path")
    text = _decoded(data, where)
    lines = [(k + 1, line) for k, line in enumerate(text.splitlines()) if line.strip()]
    for separator, decimal in DELIMITERS:
        rows = [_numbers(line, separator, decimal) for _, line in lines]
        width = next((len(r) for r in reversed(rows) if r), 0)
        first = next((k for k, r in enumerate(rows) if r and len(r) == width), 0)
        if width < 3 or first == 0:
            continue
        body = rows[first:]
        wrong = next((k for k, r in enumerate(body) if not r or len(r) != width), None)
        if wrong is not None:
            refuse(f"{where}, line {lines[first + wrong][0]}", "a line is no row of the table",
                   repr(lines[first + wrong][1][:60]), f"{width} numbers", "correct or delete that line")  # fmt: skip
        if not text.endswith(("\n", "\r")):
            _refuse_cut([line for _, line in lines[first:]], separator, where)
        names, texts = _headings([line for _, line in lines[:first]], separator, width)
        return names, texts, np.array(body, float)
    return refuse(where, "no table of FRFs", repr(lines[-1][1][:60]) if lines else "nothing",
                  "a heading, then rows of three numbers or more", "export the FRFs with their headings")  # fmt: skip


def _decoded(data: bytes, where: str) -> str:
    for encoding in ("utf-16",) if data[:2] in (b"\xff\xfe", b"\xfe\xff") else ("utf-8-sig", "cp1252", "latin-1"):
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    return refuse(where, "the file holds binary data", f"first bytes {data[:16]!r}", "text")


def _cells(line: str, separator: str | None) -> list[str]:
    cells = [c.strip().strip('"').strip() for c in line.split(separator)]
    return cells[:-1] if separator and len(cells) > 1 and not cells[-1] else cells


def _numbers(line: str, separator: str | None, decimal: str) -> list[float] | None:
    """Numbers of a row; None where it is none."""
    if decimal == ",":
        if "." in line:
            return None
        line = line.replace(",", ".")
    try:
        found = [float(c) for c in _cells(line, separator) if "_" not in c]
    except ValueError:
        return None
    return found if np.all(np.isfinite(found)) and len(found) == len(_cells(line, separator)) else None


def _refuse_cut(rows: list[str], separator: str | None, where: str) -> None:
    """Nothing, if the last number of a file without a final line end has as many digits as those above it."""
    forms = []
    for row in rows[-20:]:
        match = _FORM.fullmatch(_cells(row, separator)[-1])
        forms.append((len(match["decimals"] or ""), len(match["exponent"] or "")) if match else None)
    if len(forms) < 3 or len(set(forms)) > 1 or forms[0] in (None, (0, 0)):
        refuse(where, "the last number may be cut", repr(rows[-1][-40:]), "a line break at the end of the file",
               "transfer it again, or add a line break if nothing of it is lost")  # fmt: skip


def _headings(lines: list[str], separator: str | None, width: int) -> tuple[list[str], list[str]]:
    """Names and units of the columns, from the last lines above the numbers."""
    rows = []
    for line in reversed(lines):
        bare = line.strip().lstrip("#%! ").strip()
        if len(bare) > LONGEST:
            break
        cells = _cells(bare, separator) if separator else _words(bare, width)
        if len(cells) != width:
            break
        rows.append(cells)
        if len(rows) == 2:
            break
    if not rows:
        return [""] * width, [""] * width
    if len(rows) == 2 and pairs_of([parted(c)[0] for c in rows[0]]) is None:
        return [parted(c)[0] for c in rows[1]], [c.strip("[]() ") if c.strip("[]()- ") else "" for c in rows[0]]
    named = [parted(c) for c in rows[0]]
    return [n for n, _ in named], [u for _, u in named]


def _words(line: str, width: int) -> list[str]:
    """Cells of a heading that blanks separate; "f [Hz]" and "Real part" are one cell where the count tells it."""
    for split in (r"\s{2,}|\t", r"\s+(?![\[(])", r"\s+"):
        cells = [c for c in re.split(split, line) if c]
        if len(cells) == width:
            return cells
    return []


def parted(cell: str) -> tuple[str, str]:
    """Name and unit of a heading; round brackets may hold a name, Re(S11), as well as a unit."""
    match = _WITH_UNIT.fullmatch(cell.strip()) if len(cell) <= NAME else None
    if match is None:
        return cell.strip(), ""
    if match["square"] is not None:
        return match["name"], match["square"].strip()
    text = (match["round"] or "").strip()
    unit = units.known(text) or ratio(text) is not None or text.lower().startswith(("db", "°", "deg", "rad"))
    return (match["name"], text) if unit else (cell.strip(), "")
