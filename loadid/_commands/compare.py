"""``loadid compare``: what the rules for lambda and the families make of one record, in one table."""

from __future__ import annotations

import time
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.errors import InputError, NotIdentifiable
from structures.files import _storage as storage

from .._results.summary import NOT_TOLD, Z95
from . import (
    NOT_USABLE,
    Bar,
    Command,
    add_log_options,
    channels,
    emit,
    load_model,
    one_record,
    require_outputs,
    settings,
    table,
)
from ._inputs import noise, predicted
from ._settings import level
from .identify import responses_of

if TYPE_CHECKING:
    from structures._model import Model

    from .._page.chart import Chart
    from .._record import Record
    from .._results.estimate import LoadEstimate

EXAMPLES = """\
examples:
  every family on one record, the last sensor kept out and predicted, with a page:
    loadid compare log.csv --model model.h5 -o comparison.html
  three of them, with another sensor kept out:
    loadid compare log.csv --model model.h5 --families deconvolution,pushing,spikes --validation acc2 --plot loads.png
"""
KIND = "comparison"
Told = Callable[[float, str], None]  # as ``progress=``
OUTPUTS = (".html", ".htm", ".h5")
LOOKS, FEW = 6, 60  # curves that one chart tells apart; points below which they are dots
HISTORIES: dict[str, tuple[str, dict[str, Any], str]] = {  # name -> family, settings, prior of `recommend`
    "deconvolution": ("deconvolution", {}, "tikhonov"),
    "smooth": ("deconvolution", {"variance": "smooth"}, ""),
    "first difference": ("deconvolution", {"penalty": "first_difference"}, ""),
    "second difference": ("deconvolution", {"penalty": "second_difference"}, ""),
    "pushing": ("deconvolution", {"nonnegative": True}, ""),
    "spikes": ("sparse", {"dictionary": "dirac"}, "spikes"),
    "B-splines": ("sparse", {"dictionary": "bspline"}, "pulses"),
    "tracker": ("tracker", {"prior": "matern32"}, "matern32"),
    "frequency lines": ("frequency", {"signal": "transient"}, ""),
}
NEEDY = ("smooth", "tracker")  # families that need a state space
SLOW, LARGE = ("spikes", "B-splines", "tracker"), 2000  # families that a record with more unknowns leaves out
STATICS: dict[str, tuple[str, dict[str, Any], str]] = {
    name: ("static", {"penalty": name}, "") for name in ("identity", "gradient", "laplacian", "second_difference")
}


@dataclass(frozen=True)
class FamilyRow:
    """What one family makes of a record; numbers are None where it was refused, or does not give them.

    Parameters
    ----------
    name : str
    grade : str
        Letter of the estimate's grade; "" where there is none.
    peak, std : float
        Largest load and its std, in the unit of the load.
    impulse : float
        Integral of the load with the largest peak over the record (unit s); None of static loads.
    band : float
        Rms std over the rms of the load.
    fit : float
        Rms of the residual over that of the response.
    held_out : float
        Prediction error of the sensors that were kept out, relative, the largest.
    criterion : float
        Information criterion of its prior above the best (`loadid.recommend`).
    cost : float
        CPU seconds.
    refused : str
        Why, in words; "" where it answered.
    """

    name: str
    grade: str = ""
    peak: float | None = None
    std: float | None = None
    impulse: float | None = None
    band: float | None = None
    fit: float | None = None
    held_out: float | None = None
    criterion: float | None = None
    cost: float | None = None
    refused: str = ""


@dataclass(frozen=True)
class RuleRow:
    """Lambda of one rule, and the largest load there."""

    rule: str
    lam: float | None
    edge: bool
    edf: float | None
    residual: float | None
    peak: float | None
    note: str


@dataclass(frozen=True)
class RecordComparison:
    """Families and rules beside each other.

    Parameters
    ----------
    load : str
        Label and unit of the load whose peak is listed.
    kept_out : tuple of str
        Sensors that were predicted.
    families : tuple of FamilyRow
    rules : tuple of RuleRow
        On the path of the plain family.
    verdict : str
        How far the rules agree.
    estimates : dict of str to LoadEstimate
        Of those that answered.
    left_out : tuple of str
        What was not asked, as it takes long on so many unknowns.
    not_for : tuple of str
        Families that need a state space, where the model has none.
    """

    load: str
    kept_out: tuple[str, ...]
    families: tuple[FamilyRow, ...]
    rules: tuple[RuleRow, ...]
    verdict: str
    estimates: dict[str, LoadEstimate]
    left_out: tuple[str, ...] = ()
    not_for: tuple[str, ...] = ()

    def __str__(self) -> str:
        return "\n".join([*self._tables()])

    def _tables(self) -> list[str]:
        kept = f", kept out: {', '.join(self.kept_out)}" if self.kept_out else ""
        said = [f"families, {self.load}{kept}", table([list(FAMILY_HEAD), *map(_family_cells, self.families)]), LEGEND]
        said += [self.warning] if self.warning else []
        said += [self.omitted] if self.left_out else []
        said += [self.lacking] if self.not_for else []
        said += [f"refused: {r.name}: {r.refused}" for r in self.families if r.refused]
        if self.rules:
            said += [
                f"rules of the plain family: {self.verdict}",
                table([list(RULE_HEAD), *map(_rule_cells, self.rules)]),
            ]
        return said

    @property
    def lacking(self) -> str:
        """Which families were not asked, as the model does not carry them, in words; "" where all were."""
        if not self.not_for:
            return ""
        names = ", ".join(self.not_for)
        return f"not asked, as they need a state space and this model has none: {names}; loadid modes makes one of FRFs"

    @property
    def usable(self) -> bool:
        """Whether one family answered with a number that may be used, and none found nothing but noise."""
        return not self.noise and any(e.grade.usable for e in self.estimates.values())

    @property
    def noise(self) -> tuple[str, ...]:
        """Families that tell no load from noise; those without such a test are not asked."""
        return tuple(n for n, e in self.estimates.items() if any(flag.code == NOT_TOLD for flag in e.flags))

    @property
    def warning(self) -> str:
        """That no number of the table is to be used, in words; "" where one is."""
        if self.usable:
            return ""
        if self.noise:
            first = f"no load is told from noise ({', '.join(self.noise)})"
            return f"{first}: the other rows show what their priors make of noise"
        why = "every grade is D" if self.estimates else "every family refused"
        return f"no number of this table may be used: {why}"

    @property
    def omitted(self) -> str:
        """What was left out, and how it is asked for, in words; "" where nothing was."""
        if not self.left_out:
            return ""
        return f"left out, as they take long beyond {LARGE} unknowns: {', '.join(self.left_out)}; --all asks them"

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, texts and numbers."""
        return {
            "load": self.load, "kept_out": list(self.kept_out), "verdict": self.verdict,
            "families": [asdict(row) for row in self.families], "rules": [asdict(row) for row in self.rules],
            "left_out": list(self.left_out), "not_for": list(self.not_for), "usable": self.usable,
        }  # fmt: skip


FAMILY_HEAD = ("family", "grade", "peak", "± 95 %", "impulse", "band", "fit", "held out", "criterion", "CPU s")
LEGEND = (
    "  grade: how far it may be trusted, D: not at all; ± 95 %: half the 95 % band at the peak;\n"
    "  band: rms std over the rms of the load; fit: rms residual over the rms of the response; held out: largest\n"
    "  relative error of the sensors that were kept out and predicted; criterion: that of the prior above the best"
)
RULE_HEAD = ("rule", "lambda", "edf", "residual", "peak", "note")


def _family_cells(row: FamilyRow) -> list[str]:
    half = None if row.std is None else Z95 * row.std
    return [row.name, row.grade or "-", _short(row.peak), _short(half), _short(row.impulse), _share(row.band),
            _share(row.fit), _share(row.held_out), _short(row.criterion), _short(row.cost)]  # fmt: skip


def _rule_cells(row: RuleRow) -> list[str]:
    note = ("at an end of the sweep; " if row.edge else "") + row.note
    return [row.rule, _short(row.lam), _short(row.edf), _short(row.residual), _short(row.peak), note.rstrip("; ")]


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.1%}"


def compare(
    log: str | Path | Record,
    model: str | Path | Model,
    *,
    families: Sequence[str] | None = None,
    validation: Sequence[str] | None = None,
    noise: Any = None,
    everything: bool = False,
    progress: Callable[[float, str], None] | None = None,
    **reading: Any,
) -> RecordComparison:
    """Every family and every rule on one record.

    Parameters
    ----------
    log : path or Record
    model : path or Model
    families : sequence of str, optional
        Names of `HISTORIES` or `STATICS`; default all that are of the kind of the data.
    validation : sequence of str, optional
        Sensors that are kept out and predicted; default the last one, where there are more sensors than loads.
    noise : float, list or mapping of sensor to std, optional
    everything : bool
        Ask `SLOW` families and the criteria of the priors however many unknowns there are; without it, and without
        `families`, a record of more than `LARGE` unknowns leaves them out.
    progress : callable, optional
    **reading
        As for `loadid.read`.

    Raises
    ------
    InputError
        From the reader or the model, a family that is none. What a family refuses is a row of the table.
    """
    from .._families.automatic import kind_of
    from .._readers import read

    known = load_model(model) if isinstance(model, str | Path) else model
    record = read(log, **reading) if isinstance(log, str | Path) else log
    kind = kind_of(known, record)
    kind = "static" if families and set(families) <= set(STATICS) else kind
    every = STATICS if kind == "static" else HISTORIES
    if kind == "lines":
        every = {"frequency lines": HISTORIES["frequency lines"]}
    for name in families or ():
        if name not in every:
            raise InputError("no such family for these data", where="families", found=repr(name)[:80],
                             expected=", ".join(every))  # fmt: skip
    chosen = {name: every[name] for name in families or every}
    needy = [name for name in chosen if name in NEEDY] if not families and not known.gives("state_space") else []
    chosen = {name: one for name, one in chosen.items() if name not in needy}
    long = kind == "history" and len(record.values) * len(known.loads) > LARGE and not everything
    slow = [name for name in chosen if name in SLOW] if long and not families else []
    chosen = {name: one for name, one in chosen.items() if name not in slow}
    labels = [s.label for s in known.sensors]
    kept = list(validation) if validation is not None else labels[-1:] if len(labels) > len(known.loads) else []
    record = responses_of(record, known, None)
    told = progress or (lambda fraction, text: None)
    part = 1 / (len(chosen) + 2)  # of the work: the criteria, each family, the rules
    criteria = {}
    if kind == "history" and not long:
        criteria = _criteria(known, record, noise, labels, _part(told, 0.0, part, "priors (slow)"))
    rows, found = [], {}
    for k, (name, (family, own, prior)) in enumerate(chosen.items()):
        said = _part(told, (k + 1) * part, part, f"{name} (slow)" if name in SLOW else name)
        row, estimate = _row(name, family, own, known, record, kept, noise, said)
        if prior in criteria and not row.refused:
            row = FamilyRow(**{**asdict(row), "criterion": criteria[prior]})
        rows.append(row)
        if estimate is not None:
            found[name] = estimate
    told(1 - part, "rules")
    rules, verdict = _rules(known, record, noise, labels, kind)
    first = next(iter(found.values()), None)
    load = "no family answered" if first is None else f"largest load ({first.units[0]})"
    told(1.0, "done")
    out = (*slow, *(["criteria of the priors"] if long else []))
    return RecordComparison(load, tuple(kept), tuple(rows), rules, verdict, found, out, tuple(needy))


def _part(told: Told, begin: float, share: float, name: str) -> Told:
    """Progress of one part of the work, which names it."""
    told(begin, name)
    return lambda fraction, text: told(begin + share * fraction, f"{name}: {text}")


def _row(
    name: str, family: str, own: dict[str, Any], model: Model, record: Record, kept: list[str], level: Any, told: Told
) -> tuple[FamilyRow, LoadEstimate | None]:  # fmt: skip
    """One family on all sensors, and once more without those that are predicted."""
    import numpy as np

    from .identify import identify

    begun = time.process_time()
    try:
        e = identify(record, model, family=family, noise=level, progress=lambda f, text: told(f / 2, text), **own)
    except (InputError, NotIdentifiable) as error:
        return FamilyRow(name, refused=str(error.what), cost=time.process_time() - begun), None
    cost = time.process_time() - begun
    at = np.unravel_index(int(np.argmax(np.abs(e.load))), e.load.shape)
    size, response = np.sqrt(np.mean(np.abs(e.load) ** 2)), np.asarray(e.response)
    impulse = None
    if family != "static" and e.axis is not None and e.axis.name == "time":
        impulse = float(np.sum(e.load[:, at[-1]]) * e.over("time").step)
    return FamilyRow(
        name, e.grade.letter, float(np.real(e.load[at])), float(e.std[at]), impulse,
        float(np.sqrt(np.mean(e.std**2)) / size) if size > 0 else None,
        float(np.linalg.norm(np.asarray(e.residual)) / max(float(np.linalg.norm(response)), 1e-300)),
        _predicted(family, own, model, record, kept, level, lambda f, text: told(0.5 + f / 2, f"held out, {text}")),
        None, cost,
    ), e  # fmt: skip


def _predicted(
    family: str, own: dict[str, Any], model: Model, record: Record, kept: list[str], level: Any, told: Told
) -> float | None:
    """Largest relative error of the sensors that are kept out; None where there are none, or the rest is refused."""
    from .identify import identify

    if not kept:
        return None
    rest = [s.label for s in model.sensors if s.label not in kept]
    try:
        e = identify(record, model, family=family, sensors=rest, noise=level, progress=told, **own)
        return max(predicted(e, model, record, kept).values())
    except (InputError, NotIdentifiable):
        return None


def _criteria(model: Model, record: Record, level: Any, labels: list[str], told: Told) -> dict[str, float]:
    """Criterion of each prior above the best; empty where the model carries no process."""
    from .._families.recommend import recommend

    try:
        return recommend(model, record, noise=noise(level, labels, labels), progress=told).evidence
    except (InputError, NotIdentifiable):
        return {}


def _rules(model: Model, record: Record, level: Any, labels: list[str], kind: str) -> tuple[tuple[RuleRow, ...], str]:
    """What each rule says on the path of the plain family, and the largest load there."""
    import numpy as np

    from .. import paths
    from .._families.data import gather, readings
    from .._families.deconvolution import Deconvolution
    from .._families.posing import pose
    from .._families.static import StaticInversion

    stated = noise(level, labels, labels)
    try:
        if kind == "static":
            posed: Any = StaticInversion(model, noise=stated).pose(readings(record, model, None))
        elif kind == "history":
            family = Deconvolution(model, noise=stated)
            posed = pose(model, gather(record, None, model, None, allow_missing=True), family.settings)
        else:
            return (), ""
        found = paths.compare(posed.path, posed.noise.sigma, posed.noise.source)
    except (InputError, NotIdentifiable) as error:
        return (), f"none: {error.what}"

    def peak(lam: float | None) -> float | None:
        if lam is None:
            return None
        load = np.asarray(posed.path.solution(lam, None).load)
        return float(load.reshape(-1)[int(np.argmax(np.abs(load)))])

    rows = tuple(RuleRow(r.rule, r.lam, r.edge, r.edf, r.residual, peak(r.lam), r.note) for r in found.rows)
    return rows, f"{found.verdict}, {found.spread:.2f} decades apart"


# -- the command -------------------------------------------------------------------------------------------------------
def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument("log", metavar="LOG", help="log with the responses")
    parser.add_argument("--model", required=True, metavar="MODEL.h5", help="model file")
    parser.add_argument("-o", "--output", metavar="PAGE.html|TABLE.h5", help="also write a page, or the numbers")
    parser.add_argument("--families", type=channels, metavar="NAME,...",
                        help=f"default all of the kind of the data: {', '.join(HISTORIES)}")  # fmt: skip
    parser.add_argument("--all", action="store_true", dest="everything",
                        help=f"ask the slow ones too ({', '.join(SLOW)}, and the criterion of each prior), which more "
                        f"than {LARGE} unknowns (samples times loads) leave out")  # fmt: skip
    parser.add_argument("--validation", type=channels, metavar="CH,...",
                        help="sensors that are kept out and predicted; default the last, if one is spare")  # fmt: skip
    parser.add_argument("--noise", type=level, metavar="STD|CH=STD,...", help="noise std of the sensors in SI")
    parser.add_argument("--plot", metavar="PICTURE", help="also write a picture of the loads (png, svg, pdf)")
    add_log_options(parser)


def _run(args: Namespace) -> int:
    suffix = None if args.output is None else Path(args.output).suffix.lower()
    require_outputs({"-o": args.output, "--plot": args.plot}, [args.log, args.model], suffixes={"-o": OUTPUTS})
    with Bar() as bar:
        found = compare(args.log, args.model, families=args.families, validation=args.validation, noise=args.noise,
                        everything=args.everything, progress=bar, record=one_record(args),
                        **settings(args))  # fmt: skip
    ready: list[tuple[str, bytes]] = []
    if args.plot is not None:
        ready.append((args.plot, _picture(found, args.plot)))
    if suffix in (".html", ".htm"):
        ready.append((args.output, _page(found, str(args.log)).encode()))
    if suffix == ".h5":
        storage.write(args.output, found.to_dict(), KIND)
    for path, data in ready:
        storage.replace(Path(path), data)
    written = [path for path in (args.output, args.plot) if path is not None]
    said = [str(found), *([f"written: {', '.join(map(str, written))}"] if written else [])]
    emit(args, {**found.to_dict(), "written": [str(path) for path in written]}, "\n".join(said))
    return 0 if found.usable else NOT_USABLE


def _picture(found: RecordComparison, path: str | Path) -> bytes:
    """The loads of all families over each other, the load with the largest peak."""
    import numpy as np
    from matplotlib.figure import Figure

    from .._plots import rendered

    figure = Figure(figsize=(8, 4), layout="constrained")
    axes = figure.subplots()
    for name, e in found.estimates.items():
        load = np.real(np.atleast_2d(e.load))
        j = int(np.argmax(np.max(np.abs(load), axis=0))) if e.axis is not None else 0
        if e.axis is not None and len(load) > 1:
            axes.plot(e.axis.values, load[:, j], label=name, lw=1)
        else:
            axes.plot(np.arange(load.shape[1]), load[0], ".-", label=name, lw=1)
    axes.set_xlabel("time (s)" if any(e.axis is not None for e in found.estimates.values()) else "load")
    axes.set_ylabel(found.load)
    if found.estimates:
        axes.legend(fontsize=8)
    return bytes(rendered(figure, path))


def _page(found: RecordComparison, log: str) -> str:
    """A page of its own: the loads of all families, what each makes of the record, and what the rules say."""
    from .. import _page as page

    kept = f"; kept out: {', '.join(found.kept_out)}" if found.kept_out else ""
    refused = [f"{row.name}: {row.refused}" for row in found.families if row.refused]
    sections = [
        page.PageSection("Families", page.joined(
            page.table([_family_cells(row) for row in found.families], FAMILY_HEAD),
            page.paragraphs(*filter(None, [found.warning, " ".join(LEGEND.split()), found.omitted, found.lacking])))),
        page.PageSection("Loads", page.joined(*[page.drawn(chart) for chart in _charts(found)])),
        page.PageSection("Refused", page.paragraphs(*refused) if refused else ""),
        page.PageSection("Rules for lambda", page.joined(
            page.paragraphs(found.verdict), page.table([_rule_cells(row) for row in found.rules], RULE_HEAD))),
    ]  # fmt: skip
    return page.document("Families and rules", sections, about=f"{log}; {found.load}{kept}")


def _charts(found: RecordComparison) -> list[Chart]:
    """The load with the largest peak, of at most so many families each as there are looks of a curve."""
    import numpy as np

    from .._page.chart import Chart, Curve

    curves: list[Curve] = []
    for name, e in found.estimates.items():
        load = np.real(np.atleast_2d(e.load))
        if e.axis is not None and len(load) > 1:
            y, x = load[:, int(np.argmax(np.max(np.abs(load), axis=0)))], np.asarray(e.axis.values, float)
        else:
            y, x = load[0], np.arange(load.shape[1], dtype=float)
        curves.append(Curve(name, y, f"other{len(curves) % LOOKS}", dots=len(y) < FEW, x=x))
    over = "time [s]" if any(e.axis is not None for e in found.estimates.values()) else "load"
    return [
        Chart(
            title=found.load, x_name=over, y_name=found.load, x=some[0].x, curves=some,
            said=f"{found.load} as found by {', '.join(c.name for c in some)}",
        )
        for some in (curves[k : k + LOOKS] for k in range(0, len(curves), LOOKS))
        if some[0].x is not None
    ]  # fmt: skip


command = Command("compare", "families and rules on one record, in one table", _configure, _run)
