"""Ordinary mistakes of the command line: what each must lead to, and what it led to.

Every mistake is a line of `MISTAKES`: what is done, how its files are made, and the outcome that is right, written down
before anything is run. A mistake leads to the right answer (exit code 0, and the peak of the load within a tenth of the
true one), or to a refusal that names what is wrong and the remedy: `says` are words that must stand in the error (each
may give alternatives, parted by ``|``), `never` words that would mislead. Where both are right, the line says so. The
command line runs in this process, on files that are made by seed.
"""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

RATE, SAMPLES, PEAKS = 2000.0, 512, (90.0, 97.0, 104.0, 111.0)
NEAR = 0.1  # of the true peak
HEAD = "time [s],F [N],a1 [m/s^2],a2 [m/s^2]"
Argv = list[Any]
Edit = Callable[[list[str]], list[str]]


@dataclass(frozen=True)
class Mistake:
    """One mistake, and what is right.

    Parameters
    ----------
    name : str
    argv : callable
        Makes the files in a `Folder` and answers with the words of the command line.
    codes : tuple of int
        Exit codes that are right; with 0 the answer must be right too.
    says : tuple of str
        Words of the error; where it goes through, of the answer.
    never : tuple of str
        Words that would mislead.
    patch : callable, optional
        A context in which it is run.
    """

    name: str
    argv: Callable[[Folder], Argv]
    codes: tuple[int, ...] = (3,)
    says: tuple[str, ...] = ()
    never: tuple[str, ...] = ()
    patch: Callable[[], Any] = contextlib.nullcontext


@dataclass(frozen=True)
class Outcome:
    """What came of one: "right", "wrong answer", "misleading hint", "no hint", or another exit code."""

    mistake: Mistake
    code: int
    judged: str
    said: str


class Folder:
    """The files of a newcomer: three hits of a hammer, a model of them, and the log of a fourth."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.model, self.result = path / "model.h5", path / "r.h5"
        for k, peak in enumerate(PEAKS):
            self.csv(f"hit{k}.csv", table(k, peak))
        self.log = path / "hit3.csv"

    def csv(self, name: str, values: Any, head: str = HEAD, sep: str = ",", point: str = ".", coding: str = "utf-8",
            before: str = "", digits: str = ".9g") -> Path:  # fmt: skip
        """A table of text."""
        rows = [sep.join(format(x, digits).replace(".", point) for x in row) for row in values]
        text = before + "\n".join([*([head.replace(",", sep)] if head else []), *rows, ""])
        (self.path / name).write_bytes(text.encode(coding))
        return self.path / name

    def identify(self, log: Any = None, *more: Any, model: Any = None, output: Any = None) -> Argv:
        """Words of ``loadid identify``."""
        return ["identify", log or self.log, "--model", model or self.model, "-o", output or self.result, *more]

    def calibrate(self, *more: Any, logs: Any = None, force: str = "F", response: str = "a1,a2") -> Argv:
        """Words of ``loadid calibrate``."""
        hits = logs or [self.path / f"hit{k}.csv" for k in range(3)]
        return ["calibrate", *hits, "--force", force, "--response", response, "-o", self.path / "new.h5", *more]


def table(seed: int, peak: float, rate: float = RATE) -> Any:
    """Time, force and two accelerations of a hit on a structure of two modes, shape (samples, 4)."""
    rng, count = np.random.default_rng(seed), round(SAMPLES * rate / RATE)
    t = np.arange(count) / rate
    pulse = np.array([39, 40, 41, 42, 43]) / RATE, [0.0, 0.4, 1.0, 0.3, 0.0]  # no zero below the Nyquist frequency
    force = peak * np.interp(t, *pulse)
    found = [t, force]
    for shape in ([1.0, 0.5], [0.6, -0.8]):
        h = sum(a * np.exp(-40 * t) * np.sin(w * t) for a, w in zip(shape, (180.0, 900.0), strict=True))
        y = np.convolve(force, h)[:count] * RATE / rate
        found.append(y + 0.002 * y.std() * rng.standard_normal(count))
    return np.column_stack(found)


LAST = (3, PEAKS[3])


def spelled(**settings: Any) -> Callable[[Folder], Argv]:
    """The last hit as another program writes it."""
    return lambda at: at.identify(at.csv(**{"name": "other.csv", "values": table(*LAST), **settings}))


def edited(
    edit: Callable[[list[str]], list[str]], command: str = "identify", **settings: Any
) -> Callable[[Folder], Argv]:
    """The last hit with its lines changed."""

    def made(at: Folder) -> Argv:
        path = at.csv("other.csv", table(*LAST), **settings)
        path.write_text("\n".join(edit(path.read_text("utf-8").splitlines())) + "\n", "utf-8")
        return at.identify(path) if command == "identify" else [command, path]

    return made


def stamped(form: str) -> Callable[[Folder], Argv]:
    """Dates in place of the seconds."""
    import datetime as dt

    def edit(lines: list[str]) -> list[str]:
        start = dt.datetime(2026, 3, 1, 10)
        cells = [line.partition(",") for line in lines[1:]]
        at = [(start + dt.timedelta(seconds=float(t))).strftime(form) for t, _, _ in cells]
        return [
            lines[0].replace("time [s]", "time"),
            *(f"{a},{rest}" for a, (_, _, rest) in zip(at, cells, strict=True)),
        ]

    return edited(edit)


def units(a1: str) -> Callable[[Folder], Argv]:
    """Another unit in the heading of the first accelerometer, the numbers as they are."""
    return spelled(head=HEAD.replace("a1 [m/s^2]", f"a1 [{a1}]"))


def scaled(column: int, factor: float, head: str) -> Callable[[Folder], Argv]:
    """A column in another unit, heading and numbers."""

    def made(at: Folder) -> Argv:
        values = table(*LAST)
        values[:, column] *= factor
        return at.identify(at.csv("other.csv", values, head=head))

    return made


def cut(keep: Callable[[Any], Any]) -> Callable[[Folder], Argv]:
    """Some rows of the last hit."""
    return lambda at: at.identify(at.csv("other.csv", keep(table(*LAST))))


def backwards(values: Any) -> Any:
    """The time of one row before that of the row above it."""
    values[300, 0] = values[298, 0]
    return values


def jumped(values: Any) -> Any:
    """The clock set forward by a tenth of a second."""
    values[300:, 0] += 0.1
    return values


def content(name: str, data: bytes | str) -> Callable[[Folder], Argv]:
    """A file of another kind."""

    def made(at: Folder) -> Argv:
        (at.path / name).write_bytes(data if isinstance(data, bytes) else data.encode())
        return at.identify(at.path / name)

    return made


# -- formats of other programs, by the libraries that write them -------------------------------------------------------
def xlsx(at: Folder) -> Argv:
    """A sheet."""
    import openpyxl

    book = openpyxl.Workbook()
    for row in [HEAD.split(","), *table(*LAST).tolist()]:
        book.active.append(row)
    book.save(at.path / "log.xlsx")
    return at.identify(at.path / "log.xlsx")


def tdms(at: Folder) -> Argv:
    """Channels with unit and increment."""
    from nptdms import ChannelObject, TdmsWriter

    values = table(*LAST)
    names = [("F", "N"), ("a1", "m/s^2"), ("a2", "m/s^2")]
    timed = {"wf_increment": 1 / RATE, "wf_start_offset": 0.0}
    with TdmsWriter(at.path / "log.tdms") as writer:
        writer.write_segment([
            ChannelObject("hit", name, values[:, k + 1], {"unit_string": unit, **timed})
            for k, (name, unit) in enumerate(names)
        ])  # fmt: skip
    return at.identify(at.path / "log.tdms")


def mf4(at: Folder) -> Argv:
    """Signals of one group."""
    from asammdf import MDF, Signal

    values = table(*LAST)
    names = [("F", "N"), ("a1", "m/s^2"), ("a2", "m/s^2")]
    signals = [Signal(values[:, k + 1], values[:, 0], unit=u, name=n) for k, (n, u) in enumerate(names)]
    with MDF(version="4.10") as file:
        file.append(signals)
        file.save(at.path / "log.mf4")
    return at.identify(at.path / "log.mf4")


def parquet(at: Folder) -> Argv:
    """Columns with their units in the names."""
    import pyarrow
    from pyarrow.parquet import write_table

    write_table(pyarrow.table(dict(zip(HEAD.split(","), table(*LAST).T, strict=True))), at.path / "log.parquet")
    return at.identify(at.path / "log.parquet")


def wav(at: Folder) -> Argv:
    """Sound without a calibration: no unit can be known."""
    from scipy.io import wavfile

    values = table(*LAST)[:, 2:]
    wavfile.write(at.path / "log.wav", int(RATE), (values / np.abs(values).max() * 32000).astype(np.int16))
    return at.identify(at.path / "log.wav")


def folder(at: Folder) -> Argv:
    """A folder that holds no log."""
    (at.path / "measured").mkdir()
    return at.identify(at.path / "measured")


def at_home(at: Folder) -> Argv:
    """A path that no shell has expanded."""
    return at.identify("~/hit3.csv", model="~/model.h5")


def home() -> Any:
    """A home that is the folder of the campaign, which is where it runs."""
    return mock.patch.dict(os.environ, {"HOME": os.getcwd(), "USERPROFILE": os.getcwd()})


def a_result(at: Folder) -> Argv:
    """The file of a result in place of the model."""
    run(at.identify())
    kept = at.result.rename(at.path / "old.h5")
    return at.identify(model=kept)


def full() -> Any:
    """A device without space, at the moment when what was written is to last."""
    return mock.patch("os.fsync", side_effect=OSError(28, "No space left on device"))


def typed(*words: Any) -> Callable[[Folder], Argv]:
    """``loadid identify`` with more words."""
    return lambda at: at.identify(None, *words)


def hits(**settings: Any) -> Callable[[Folder], Argv]:
    """``loadid calibrate`` otherwise."""
    return lambda at: at.calibrate(**settings)


def other_force(factor: float, count: int = 3) -> Callable[[Folder], Argv]:
    """``loadid calibrate`` on hits of which the last one has its force in another unit or of the other sign."""

    def made(at: Folder) -> Argv:
        wrong = at.csv("wrong.csv", table(count - 1, PEAKS[count - 1]) * [1, factor, 1, 1])
        return at.calibrate(logs=[*(at.path / f"hit{k}.csv" for k in range(count - 1)), wrong])

    return made


def other_rate(at: Folder) -> Argv:
    """A logger at twice the frequency."""
    return at.identify(at.csv("other.csv", table(*LAST, rate=2 * RATE)))


def no_header(command: str) -> Callable[[Folder], Argv]:
    """Numbers alone."""

    def made(at: Folder) -> Argv:
        path = at.csv("other.csv", table(*LAST), head="")
        return at.identify(path) if command == "identify" else at.calibrate(logs=[path])

    return made


def doubled(command: str) -> Callable[[Folder], Argv]:
    """Two columns of one name, of which the first was the hammer."""

    def made(at: Folder) -> Argv:
        path = at.csv("other.csv", table(*LAST), head="time [s],a1 [m/s^2],a1 [m/s^2],a2 [m/s^2]")
        return at.identify(path) if command == "identify" else at.calibrate(logs=[path], force="a1", response="a2")

    return made


def indexed(lines: list[str]) -> list[str]:
    """As pandas writes its index."""
    return ["," + lines[0], *(f"{k},{line}" for k, line in enumerate(lines[1:]))]


def with_cell(row: int, column: int, text: str) -> Callable[[list[str]], list[str]]:
    """One cell replaced."""

    def edit(lines: list[str]) -> list[str]:
        cells = lines[row].split(",")
        cells[column] = text
        return [*lines[:row], ",".join(cells), *lines[row + 1 :]]

    return edit


def named(head: str, row: str) -> Callable[[list[str]], list[str]]:
    """Names and units in rows of their own."""
    return lambda lines: [head, row, *lines[1:]]


def changed(column: int, change: Callable[[Any], Any]) -> Callable[[Folder], Argv]:
    """A column of the last hit that is not what its heading says."""

    def made(at: Folder) -> Argv:
        values = table(*LAST)
        values[:, column] = change(values[:, column])
        return at.identify(at.csv("other.csv", values))

    return made


def beam(*words: str) -> Callable[[Folder], Argv]:
    """``loadid model beam``."""
    placed = ["--sensor", "displacement:x=0.3", "--load", "point:x=0.2"]
    return lambda at: ["model", "beam", "--length", "0.5", *placed, "-o", at.path / "new.h5", *words]


def without(column: int) -> Edit:
    """Lines without one of their columns."""
    return lambda lines: [",".join(c for k, c in enumerate(line.split(",")) if k != column) for line in lines]


def on_its_side(lines: list[str]) -> list[str]:
    """Rows and columns exchanged."""
    return [",".join(cells) for cells in zip(*(line.split(",") for line in lines), strict=True)]


NAMES = "time,F,a1,a2"
SECTION, STEEL = ("--section", "rectangle:0.04,0.01"), ("--material", "steel")
GERMAN = {"head": HEAD.replace(",", ";").replace("time [s]", "Zeit [s]")}
UNIT = ("--unit a1=m/s^2", "--unit a1=m/s²")  # advice that would call anything an acceleration

MISTAKES = (
    # which channels
    Mistake("wrong column", typed("--response", "F,a2"), says=("'F' is in another unit",)),
    Mistake("wrong --response", typed("--response", "acc1,a2"), says=("'acc1'", "a1")),
    # how text is written
    Mistake("German: ; and ,", spelled(sep=";", point=","), (0,)),
    Mistake("; and .", spelled(sep=";"), (0,)),
    Mistake("decimal comma, comma separator", spelled(point=","), says=("comma", "decimal"), never=("--fs",)),
    Mistake("tabs", spelled(sep="\t"), (0,)),
    Mistake("cp1252", spelled(head=HEAD.replace("m/s^2", "m/s²"), coding="cp1252"), (0,)),
    Mistake("BOM", spelled(coding="utf-8-sig"), (0,)),
    Mistake("UTF-16", spelled(coding="utf-16"), (0,)),
    Mistake("sep=;", spelled(sep=";", before="sep=;\n"), (0,)),
    Mistake("ISO stamps", stamped("%Y-%m-%dT%H:%M:%S.%f"), (0,)),
    Mistake("German dates", stamped("%d.%m.%Y %H:%M:%S.%f"), (0,)),
    Mistake("no header: identify", no_header("identify"), says=("--columns|header|names|ch1",)),
    Mistake("no header: calibrate", no_header("calibrate"), says=("--columns|header|names|ch1",)),
    Mistake("repeated names: identify", doubled("identify"), says=("a1", "columns 2 and 3|twice|doubled|repeated")),
    Mistake("repeated names: calibrate", doubled("calibrate"), says=("a1", "columns 2 and 3|twice|doubled|repeated")),
    # units
    Mistake("degrees", units("deg"), says=("a1", "deg|angle"), never=UNIT),
    Mistake("mm for acceleration", units("mm"), says=("a1", "mm|displacement"), never=UNIT),
    Mistake("g", scaled(2, 1 / 9.80665, HEAD.replace("a1 [m/s^2]", "a1 [g]")), (0,)),
    Mistake("G", units("G"), says=("did you mean|'g'|gauss| g ",), never=UNIT),
    Mistake("no units: identify", spelled(head=NAMES), says=("--unit a1=UNIT",)),
    Mistake("no units: info", edited(lambda x: x, "info", head=NAMES), (0,), says=("--unit a1=UNIT",)),
    Mistake("ms", scaled(0, 1e3, HEAD.replace("time [s]", "time [ms]")), (0,)),
    Mistake("unicode labels", typed("--truth", "Kraft größte"), says=("Kraft größte", "F")),
    Mistake("quoted header", spelled(head=",".join(f'"{x}"' for x in HEAD.split(","))), (0,)),
    Mistake("pandas index column", edited(indexed), (0, 3), says=("ch1|index|peak",)),
    # what is in the rows
    Mistake("NaN gap", edited(with_cell(400, 2, "NaN")), (0,)),
    Mistake("text OVERLOAD", edited(with_cell(400, 2, "OVERLOAD")), (0, 3), says=("OVERLOAD|missing",)),
    Mistake("units row", edited(named(NAMES, "s,N,m/s^2,m/s^2")), (0,)),
    Mistake("comment lines", spelled(before="# logger 7\n# hall 3\n"), (0,)),
    Mistake("jump in time", cut(jumped), (0, 3), says=("missing|gap|jump",)),
    Mistake("time backwards", cut(backwards), says=("does not rise",)),
    Mistake("other sampling rate", other_rate, says=("step|rate|Hz",)),
    Mistake("three samples", cut(lambda v: v[:3]), says=("too few|short",)),
    Mistake("empty", content("other.csv", b""), says=("empty",)),
    # which file
    Mistake("spaces in path", lambda at: at.identify(at.csv("my last hit.csv", table(*LAST))), (0,)),
    Mistake("unknown suffix", content("log.xyz", "1,2\n3,4\n"), says=("suffix|format", "csv|CSV")),
    Mistake("CSV named xlsx", spelled(name="log.xlsx"), (0, 3), says=("csv|plain text",)),
    Mistake("real xlsx", xlsx, (0,)),
    Mistake("TDMS", tdms, (0,)),
    Mistake("MF4", mf4, (0,)),
    Mistake("WAV", wav, says=("unit|calibration|scale",)),
    Mistake("Parquet", parquet, (0,)),
    Mistake("JSON", content("log.json", '{"a": [1, 2]}'), says=("json|JSON", "CSV|csv")),
    Mistake("pickle", content("log.pkl", b"\x80\x04K\x01."), says=("pickle|pkl", "CSV|csv")),
    Mistake("folder", folder, says=("folder",)),
    Mistake("URL", lambda at: at.identify("https://example.org/hit.csv"), says=("download|save", "https://example.org")),
    Mistake("~", at_home, (0,), patch=home),
    Mistake("missing file", lambda at: at.identify(at.path / "hit9.csv"), says=("no such file", "hit9.csv")),
    Mistake("model is a result", a_result, says=("result", "not a model")),
    Mistake("model is a CSV", lambda at: at.identify(model=at.log), says=("hit3.csv", "calibrate")),
    Mistake("log is a model", lambda at: at.identify(at.model), says=("model", "not a log")),
    # what is written
    Mistake("output folder missing", lambda at: at.identify(output=at.path / "no" / "r.h5"), says=("folder", "exist")),
    Mistake("output suffix", lambda at: at.identify(output=at.path / "o.txt"), says=(".txt", ".h5")),
    Mistake("output is a folder", lambda at: at.identify(output=at.path), says=("this is a folder",)),
    Mistake("report suffix pdf", typed("--report", "r.pdf"), says=(".pdf", ".html")),
    Mistake("plot suffix", typed("--plot", "p.xyz"), says=("xyz", "png")),
    # typos
    Mistake("typo: rule", typed("--choice", "lcurve"), (2,), says=("did you mean l_curve",)),
    Mistake("typo: penalty", typed("--penalty", "first_diference"), (2,), says=("did you mean first_difference",)),
    Mistake("typo: command", lambda at: ["identfy", *at.identify()[1:]], (2,), says=("did you mean identify",)),
    Mistake("typo: option", typed("--chioce", "gcv"), (2,), says=("did you mean --choice",)),
    Mistake("typo: unit", typed("--unit", "a1=m/s^^2"), says=("m/s^^2", "did you mean|such as m/s^2|m/s^2")),
    Mistake("typo: unit channel", typed("--unit", "acc1=m/s^2"), says=("acc1", "a1")),
    Mistake("unit of a wrong kind", typed("--unit", "a1=N"), says=("a1", "N|force"), never=UNIT),
    # calibration
    Mistake("calibrate: wrong force", hits(force="a2", response="a1"), says=("a2", "force")),
    Mistake("calibrate: one hit", lambda at: at.calibrate(logs=[at.log]), (0,), says=("two hits",)),
    Mistake("calibrate: force = response", hits(response="F,a1"), says=("F", "twice")),
    Mistake("calibrate: swapped", hits(force="a1", response="F"), says=("a1", "force")),
    # settings
    Mistake("wrong band", typed("--family", "frequency", "--signal", "stationary", "--band", "5000:6000"),
            says=("band|lines", "Hz")),
    Mistake("wrong --fs", typed("--fs", "3000"), says=("contradict",)),
    Mistake("negative lambda", typed("--choice", "-1"), (2,), says=(">= 0",)),
    Mistake("noise in per cent", typed("--noise", "5%"), (2,), says=("5%", "no number")),
    Mistake("support in ms", typed("--support", "18:24"), says=("seconds", "0.2555")),
    Mistake("support beside the hit", typed("--support", "0.15:0.2"), (1,), says=("NOT TO BE USED",)),
    # what a channel or a table holds
    Mistake("g under m/s^2: a1", changed(2, lambda x: x / 9.80665), (1,), says=("NOT TO BE USED",)),
    Mistake("g under m/s^2: a2", changed(3, lambda x: x / 9.80665), (1,), says=("NOT TO BE USED",)),
    Mistake("a sign", changed(3, lambda x: -x), (1,), says=("NOT TO BE USED",)),
    Mistake("clipped channel", changed(2, lambda x: x.clip(-0.5 * x.max(), 0.5 * x.max())), (1,), says=("clip",)),
    Mistake("dead channel", changed(3, lambda x: 0 * x), (1, 3), says=("a2",)),
    Mistake("offset", changed(3, lambda x: x + 5 * x.std()), (0,)),
    Mistake("labels swapped", spelled(head="time [s],F [N],a2 [m/s^2],a1 [m/s^2]"), (1,), says=("NOT TO BE USED",)),
    Mistake("ms under s", changed(0, lambda x: 1e3 * x), says=("step", "0.0005")),
    Mistake("time of three digits", changed(0, lambda x: x.round(3)), says=("does not rise", "--fs")),
    Mistake("on its side", edited(on_its_side), says=("transpose",)),
    Mistake("empty columns behind", edited(lambda lines: [f"{line},," for line in lines]), (0,)),
    Mistake("a footer", edited(lambda lines: [*lines, "End of file"]), says=("line 514",)),
    Mistake("one sensor lacks", edited(without(3)), says=("'a2'", "a1")),
    Mistake("one force of three in mN", other_force(1000.0), (0,), says=("1000 times", "W223")),
    Mistake("one force of three turned", other_force(-1.0), (0,), says=("wrong sign", "W223")),
    Mistake("one force of two in mN", other_force(1000.0, 2), says=("contradict", "1000 times", "units")),
    # models
    Mistake("section in mm", beam("--section", "rectangle:40,10", *STEEL), says=("40mm,10mm",)),
    Mistake("E in GPa", beam(*SECTION, "--material", "E=210,rho=7850"), says=("E=210GPa",)),
    Mistake("density in g/cm^3", beam(*SECTION, "--material", "E=210e9,rho=7.85"), says=("kg/m^3",)),
    Mistake("damping in per cent", beam(*SECTION, *STEEL, "--damping", "2"), says=("0.02 for 2 %",)),
    Mistake("each end named", beam(*SECTION, *STEEL, "--ends", "clamped-free"), says=("did you mean cantilever",)),
    Mistake("place without y", beam(*SECTION, *STEEL, "--sensor", "displacement:x=0.1,0.3"), says=("x=0.1,y=0.3",),
            never=("decimal point",)),
    Mistake("place in mm", beam(*SECTION, *STEEL, "--sensor", "displacement:x=300"), says=("outside", "metres")),
    Mistake("full device", typed(), says=("No space left", "space"), patch=full),
    Mistake("read-only folder", lambda at: at.identify(output="/proc/r.h5"), says=("cannot be written",)),
)  # fmt: skip


def run(argv: Argv) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of one command line, in this process."""
    from loadid import cli

    out, err = io.StringIO(), io.StringIO()
    own = EntryPoints([EntryPoint("info", "loadid._commands.info:command", cli.GROUP)])  # the others are its own too
    known = mock.patch.object(cli, "entry_points", return_value=own)
    with known, contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = cli.main([str(a) for a in argv])
    return code, out.getvalue(), err.getvalue()


def made(path: Path) -> Folder:
    """The folder with its model."""
    at = Folder(path)
    code, _, err = run([*at.calibrate()[:-1], at.model])
    assert code == 0, err
    return at


def judged(one: Mistake, at: Folder) -> Outcome:
    """Make one mistake, and hold what comes of it against what is right."""
    for name in ("r.h5", "new.h5"):
        (at.path / name).unlink(missing_ok=True)
    argv = one.argv(at)
    with contextlib.chdir(at.path), one.patch():
        try:
            code, out, err = run(argv)
        except Exception as error:  # what a user would see as a traceback
            return Outcome(one, 1, f"a traceback: {type(error).__name__}", str(error))
    said = " ".join((err if code > 1 else out).split())
    return Outcome(one, code, verdict(one, code, said, at), said)


def verdict(one: Mistake, code: int, said: str, at: Folder) -> str:
    """In a word."""
    if code == 0 and 0 not in one.codes:
        return "wrong answer"
    if code == 0 and at.result.exists() and abs(peak(at.result) / PEAKS[3] - 1) > NEAR:
        return "wrong answer"
    if code not in one.codes:
        return f"exit code {code}"
    if code > 1 and (at.result.exists() or (at.path / "new.h5").exists()):
        return "a file is left"
    if code and any(word in said for word in one.never):
        return "misleading hint"
    low = said.lower()
    lost = [words for words in one.says if not any(w.lower() in low for w in words.split("|"))]
    return f"not said: {lost[0]}" if lost else "right"


def peak(path: Path) -> float:
    """Largest load of a result."""
    from loadid import LoadEstimate

    return float(np.abs(LoadEstimate.read(path).load).max())


def outcomes(path: Path) -> Iterator[Outcome]:
    """All of them, in their order; those whose library is not installed are left out."""
    at = made(path)
    for one in MISTAKES:
        try:
            yield judged(one, at)
        except ModuleNotFoundError as error:
            yield Outcome(one, -1, f"left out: {error.name} is not installed", "")


def show(found: list[Outcome]) -> None:
    """Print the table."""
    wide = max(len(o.mistake.name) for o in found)
    for o in found:
        print(f"{o.mistake.name:{wide}s}  {o.code:2d}  {o.judged:18s}  {o.said[:120]}")
    wrong = sum(o.judged == "wrong answer" for o in found)
    misled = sum(o.judged == "misleading hint" for o in found)
    right = sum(o.judged == "right" for o in found)
    print(f"\n{len(found)} mistakes: {right} right, {wrong} wrong answers with exit code 0, {misled} misleading hints")
