"""An estimate as the lab shows it: at the lambda that it was found with, and at any other."""

from __future__ import annotations

import tempfile
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .contract import Download, rounded

if TYPE_CHECKING:
    from .._results.estimate import LoadEstimate

Array = NDArray[Any]

BINS = 320  # of a long curve, each drawn as its lowest and its highest value
DIGITS = 5  # of what is only drawn, but for the axis
MODES = 400  # of a Picard plot
KEPT = 128  # lambdas
Z95 = 1.959963984540054


class Shown:
    """An estimate, and what was asked of it already; `number` tells it from others that one lab has shown."""

    def __init__(self, estimate: LoadEstimate, number: int = 0) -> None:
        self.estimate, self.number = estimate, number
        self._at = lru_cache(KEPT)(estimate.at)
        self._drawn = lru_cache(KEPT)(self._picture)

    def found(self) -> dict[str, Any]:
        """All that is shown of the estimate itself."""
        e = self.estimate
        choice = e.choice
        return {
            **_answer(e), "of": self.number, "loads": list(e.labels), "units": list(e.units),
            "family": str(e.provenance.get("family", "")),
            "path": str(e.facts.get("path") or ""), "sweep": None if choice is None else _sweep(e),
            "picard": _picard(e), "range": _range(e), "lacks": lacks(e),
            "lam": None if choice is None else choice.lam, "single": e.axis is None,
            "axis": None if e.axis is None else f"{e.axis.name} {e.axis.unit}".strip(), "x": self._drawn(0.0, 0)["x"],
        }  # fmt: skip

    def at(self, lam: float) -> dict[str, Any]:
        """All that is said of the estimate at another lambda: flags, verdict, residuals.

        Raises
        ------
        InputError
            No such lambda, or an estimate that cannot be asked.
        """
        return _answer(self._at(lam))

    def picture(self, lam: float, load: int) -> dict[str, Any]:
        """A load with its band at a lambda, 0 for the estimate as it was found, and where it lies on the L-curve.

        Over the axis that `found` gives: no lambda changes it.

        Raises
        ------
        InputError
            No such lambda or load.
        """
        return {name: one for name, one in self._drawn(lam, load).items() if name != "x"}

    def ahead(self, lams: list[float], load: int) -> dict[str, Any]:
        """Make pictures that may be asked for next; says nothing.

        Raises
        ------
        InputError
            No such lambda or load.
        """
        for lam in lams:
            self._drawn(lam, load)
        return {}

    def save(self, lam: float) -> Download:
        """The result file at a lambda, 0 for the estimate as it was found."""
        e = self._at(lam) if lam else self.estimate
        with tempfile.TemporaryDirectory(prefix="loadid-lab-") as folder:
            path = Path(folder) / "load.h5"
            e.save(path)
            return Download("load.h5", path.read_bytes(), "application/x-hdf5")

    def _picture(self, lam: float, load: int) -> dict[str, Any]:
        e = self.estimate
        j = e.index(load)
        if lam and e.again is not None and e.again.quick is not None:
            quick = e.again.quick(lam)
            values, std = quick.load[:, j], quick.std[:, j]
            low, high = values - Z95 * std, values + Z95 * std
        else:
            one = self._at(lam) if lam else e
            values, (low, high) = _column(one.load, j), (_column(x, j) for x in one.band())
            std = _column(one.std, j)
        i = int(np.argmax(np.abs(values)))
        x = np.arange(float(len(values))) if e.axis is None else e.axis.values
        point = None if not lam or e.again is None else _point(e, lam)
        peak = {"value": _plain(values[i]), "std": float(std[i]), "at": None if e.axis is None else float(x[i]),
                "index": i}  # fmt: skip
        told: dict[str, Any] = rounded({"lam": lam, "peak": peak, "point": point}, 8)
        return told | curve(x, values, low, high)


# -- what is said -----------------------------------------------------------------------------------------------------
def flags_of(flags: Any) -> list[dict[str, str]]:
    """Flags in the words of the command line, those that matter most first."""
    from structures._advice import on_command_line

    from .._results.summary import sort

    return [
        {"code": flag.code.removeprefix("LID-"), "level": flag.level, "message": on_command_line(flag.message),
         "advice": on_command_line(flag.advice)} for flag in sort(flags)
    ]  # fmt: skip


def _answer(e: LoadEstimate) -> dict[str, Any]:
    """What changes with lambda, but for the curves."""
    from .._results.summary import headline, summary

    return {
        "summary": summary(e, command=True).splitlines()[:-1],  # the last says where more is to be had
        "peaks": [asdict(p) for p in e.peaks],
        "grade": str(e.grade), "flags": flags_of(e.flags),
        "lambda": "" if e.choice is None else headline(e.choice),
        "verdict": "" if e.choice is None else e.choice.verdict,
        "edf": e.facts.get("edf"), "residuals": _residuals(e), "resolved": e.facts.get("residual_to_noise"),
    }  # fmt: skip


def _residuals(e: LoadEstimate) -> list[dict[str, Any]]:
    """Residual of every sensor over its response, rms."""
    if e.residual is None or e.response is None:
        return []
    rest, response = (np.sqrt(np.mean(np.abs(np.atleast_2d(x)) ** 2, axis=0)) for x in (e.residual, e.response))
    share = rest / np.where(response > 0, response, np.inf)
    return [{"sensor": s, "rms": float(r), "share": float(q), "unit": u}
            for s, r, q, u in zip(e.sensors, rest, share, e.sensor_units, strict=True)]  # fmt: skip


def lacks(e: LoadEstimate) -> str:
    """What the page cannot show of an estimate, and why; "" where it shows everything."""
    if e.choice is None:
        return "This family has no lambda: there is no L-curve, no Picard plot and no slider."
    if e.again is None:
        return (
            "This estimate holds no problem that could be solved at another lambda (it came from a file, or its family "
            "has a lambda for each line, atom or sample): the slider and the Picard plot are not there."
        )
    if e.again.path.coefficients is None:
        return (
            "The path of this estimate has no factorisation into modes (long records go over states or by products): "
            "there is no Picard plot. The slider answers all the same."
        )
    return ""


def _range(e: LoadEstimate) -> list[float] | None:
    if e.again is None or e.choice is None:
        return None
    low, high = e.again.path.range
    return [min(low, 0.5 * e.choice.lam or low), max(high, 2 * e.choice.lam)]


def _point(e: LoadEstimate, lam: float) -> dict[str, Any] | None:
    assert e.again is not None
    at = e.again.path.at(lam)
    edf = None if at.edf is None else float(at.edf)
    return {"residual": float(np.sqrt(at.residual2)), "penalty": float(np.sqrt(at.penalty2)), "edf": edf}


def _sweep(e: LoadEstimate) -> dict[str, Any] | None:
    """The L-curve, and the lambda of every rule that ran, with its place on the curve where the path tells it."""
    choice = e.choice
    if choice is None or choice.sweep is None:
        return None
    s = choice.sweep
    rules = [
        {"rule": r.rule, "lam": r.lam, "used": r.rule == choice.rule, "edge": r.edge, "note": str(r.note),
         "point": None if r.lam is None or r.lam <= 0 or e.again is None else _point(e, r.lam)}
        for r in choice.rules
    ]  # fmt: skip
    found: dict[str, Any] = rounded(
        {
            "lam": s.lam,
            "residual": s.residual_norm,
            "penalty": s.penalty_norm,
            "edf": s.edf,
            "gcv": s.gcv,
            "rules": rules,
        },
        6,
    )
    return found


def _picard(e: LoadEstimate) -> dict[str, Any] | None:
    """Data coefficients and generalised singular values over their number, thinned out where they are many."""
    c = None if e.again is None else e.again.path.coefficients
    if c is None or np.ndim(c.gamma) > 1:
        return None
    beta, gamma = np.abs(np.asarray(c.beta)), np.asarray(c.gamma, float)
    at = np.unique(np.round(np.geomspace(1, len(gamma), MODES)).astype(int)) - 1 if len(gamma) > MODES else slice(None)
    number = np.arange(1.0, len(gamma) + 1)
    found: dict[str, Any] = rounded({"mode": number[at], "beta": beta[at], "gamma": gamma[at] / gamma.max()}, 5)
    return found


def _column(values: Any, j: int) -> Array:
    """Load j over the axis; of a static load all of them: their number is the axis. Moduli of complex amplitudes."""
    found = np.asarray(values)
    found = found if found.ndim == 1 else found[:, j]
    return np.abs(found) if np.iscomplexobj(found) else found


def _plain(value: Any) -> float:
    return float(np.abs(value) if np.iscomplexobj(value) else value)


def curve(x: Array, y: Array, *ends: Array) -> dict[str, Array]:
    """A curve, with its band where it has one; of a long one the lowest and the highest value of every bin."""
    names = ("x", "y", "low", "high")
    if len(y) <= 2 * BINS:
        return _brief(dict(zip(names, (x, y, *ends), strict=False)))
    width = -(-len(y) // BINS)

    def binned(values: Array, nothing: float) -> Array:
        """Rows of a bin each, the last filled up."""
        filled = np.full(-(-len(values) // width) * width, nothing)
        filled[: len(values)] = np.where(np.isnan(values), nothing, values)
        return filled.reshape(-1, width)

    low, high = binned(y, np.inf), binned(y, -np.inf)
    first, last = low.argmin(axis=1), high.argmax(axis=1)
    both = np.column_stack([low.min(axis=1), high.max(axis=1)])
    both = np.where((first <= last)[:, None], both, both[:, ::-1]).ravel()
    starts = np.arange(0, len(y), width)
    at = np.column_stack([starts, np.minimum(starts + width // 2, len(y) - 1)]).ravel()
    apart = np.r_[True, np.diff(at) > 0]  # not where the last bin holds one value
    found = {"x": x[at], "y": np.where(np.isfinite(both), both, np.nan)}
    if ends:
        found["low"] = np.repeat(binned(ends[0], np.inf).min(axis=1), 2)
        found["high"] = np.repeat(binned(ends[1], -np.inf).max(axis=1), 2)
    return _brief({name: one[apart] for name, one in found.items()})


def _brief(curves: dict[str, Array]) -> dict[str, Array]:
    return {name: shortened(one, 6 if name == "x" else DIGITS) for name, one in curves.items()}


def shortened(values: Array, digits: int) -> Array:
    """Values to some significant digits: a third of the bytes, in a thousandth of the time that texts take."""
    values = np.asarray(values, float)
    size = np.abs(values)
    some = np.isfinite(values) & (size > 0)
    power = digits - 1 - np.floor(np.log10(size, where=some, out=np.zeros(values.shape)))
    up, down = (10.0 ** np.clip(sign * power, 0, 300) for sign in (1, -1))
    return np.where(some, np.rint(values * up / down) / up * down, values)
