"""Which charts a report has: the load with its band, what lines tell, the choice of lambda, diagnosis, responses."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._page.chart import Chart, Curve, Range, written
from .shown import PANELS, axis_label, has_field, known_load, largest, places, readable, titled
from .summary import pulse_window

if TYPE_CHECKING:
    from .estimate import LoadEstimate, Peak

Array = NDArray[Any]
BAND = "95 % band"
DECADES = 1e3  # of amplitude below the largest that a chart over frequency shows
MARKED = 6  # rules that a curve over lambda names


def squared(unit: str) -> str:
    """``m/s^2`` as ``m/s²``."""
    return unit.replace("^2", "²").replace("^3", "³").replace("um/", "µm/")


def of_load(e: LoadEstimate, truth: ArrayLike | None = None) -> list[Chart] | None:
    """The load with its band, a chart for each of the largest; None where it is a map over a surface."""
    known = known_load(e, truth)
    if e.spectrum is not None and e.axis is not None and e.axis.name == "frequency":
        return [_spectrum(e, j, known) for j in largest(e)]
    if e.axis is not None:
        return _histories(e, known)
    if has_field(e):
        return _along(e, known)
    return [_points(e, known)]


# -- over time, frequency, frames -------------------------------------------------------------------------------------
def _histories(e: LoadEstimate, known: Array | None) -> list[Chart]:
    assert e.axis is not None
    scale, x_name = readable(e)[0], axis_label(e)
    load, (low, high) = e.load, e.band()
    if e.load.dtype.kind == "c":
        load, known = np.abs(load), None if known is None else np.abs(known)
    found = []
    for j in largest(e):
        window, peak = pulse_window(e, j), e.peaks[j]
        curves = [Curve(f"estimate with {BAND}", load[:, j], low=low[:, j], high=high[:, j])]
        curves += [] if known is None else [Curve("truth", known[:, j], "truth")]
        found.append(Chart(
            title=e.labels[j], x_name=x_name, y_name=f"load [{squared(e.units[j])}]", x=scale * e.axis.values,
            curves=curves, window=None if window is None else (scale * window[0], scale * window[1]),
            said=_said(peak, x_name, None if peak.at is None else scale * peak.at),
        ))  # fmt: skip
    return _alike(found, e) if len(found) > 1 else found


def _said(peak: Peak, x_name: str, at: float | None) -> str:
    where = "" if at is None else f" at {x_name} {written(at)}"
    return f"Load {peak.label} with its {BAND}: peak {peak.value:.4g} {peak.unit}{where}"


def _alike(charts: list[Chart], e: LoadEstimate) -> list[Chart]:
    """Loads of one unit on one scale, so that noise on a quiet load does not look like a load."""
    if len(set(e.units)) > 1:
        return charts
    lower, upper = e.band()
    low, high = float(lower.min()), float(upper.max())
    room = 0.05 * (high - low) or 1.0
    return [replace(chart, y_range=(low - room, high + room)) for chart in charts]


def _spectrum(e: LoadEstimate, j: int, known: Array | None) -> Chart:
    """Amplitude over frequency; lines that are not trusted are shaded and their estimate is left out."""
    s, trusted = e.spectrum, e.trust()[:, j]
    size, std = np.abs(e.load[:, j]), e.std[:, j]
    low, high = (np.where(trusted, edge[:, j], np.nan) for edge in e.band())
    top = float(np.max(np.where(trusted, size + std, 0.0), initial=0.0)) or float(size.max()) or 1.0
    curves = [
        Curve(f"estimate on trusted lines with {BAND}", np.where(trusted, size, np.nan), low=low, high=high),
        Curve("least squares", np.abs(s.naive[:, j]) ** (2 if s.cross is not None else 1), "naive"),
    ]
    curves += [] if known is None else [Curve("truth", np.abs(known[:, j]), "truth")]
    return Chart(
        title=e.labels[j], x_name="frequency [Hz]", x=s.frequencies, curves=curves, y_log=True,
        y_name=f"{'autospectrum' if s.cross is not None else 'amplitude'} [{squared(e.units[j])}]",
        y_range=(top / DECADES, 20 * top), shades=_stretches(s.frequencies, ~trusted),
        shaded=f"predicted error above {s.level:.0%}", said=_said(e.peaks[j], "frequency [Hz]", e.peaks[j].at),
    )  # fmt: skip


def _stretches(x: Array, flagged: Array) -> list[Range]:
    """First and last place of every stretch that is flagged, half a step more on each side."""
    half = 0.5 * float(np.median(np.diff(x))) if len(x) > 1 else 0.5
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flagged, [False]]).astype(int))).reshape(-1, 2)
    return [(float(x[a]) - half, float(x[b - 1]) + half) for a, b in edges]


def of_lines(e: LoadEstimate) -> list[Chart]:
    """What every line can tell: predicted error and gain of each load, condition of the line."""
    s, shown = e.spectrum, largest(e)
    f = s.frequencies

    def over(title: str, y_name: str, columns: Array, *more: Curve, y_range: Range | None = None) -> Chart:
        curves = [Curve(e.labels[j], np.where(columns[:, k] > 0, columns[:, k], np.nan), f"other{k % 6}")
                  for k, j in enumerate(shown)]  # fmt: skip
        return Chart(title=title, x_name="frequency [Hz]", y_name=y_name, x=f, curves=[*curves, *more], y_log=True,
                     y_range=y_range, said=f"{title}, over frequency")  # fmt: skip

    predicted = s.predicted[:, shown]
    floor = max(float(np.nanmin(np.where(predicted > 0, predicted, 1.0), initial=1.0)) / 2, 1e-6)
    level = Curve(f"level {s.level:.0%}", np.full(len(f), s.level), "level")
    charts = [
        over("predicted relative error of least squares", "std / load [-]", predicted, level, y_range=(floor, 20.0)),
        over("response that no other load can imitate", "gain [noise std per unit load]", s.gain[:, shown]),
    ]
    if len(e.labels) > 1:
        seen = np.where(np.isfinite(s.condition), s.condition, np.nan)
        charts.append(Chart(
            title="condition of the line, loads of expected size", x_name="frequency [Hz]", y_name="condition [-]", x=f,
            curves=[Curve("condition", seen, "estimate")], y_log=True, said="condition of every line, over frequency",
        ))  # fmt: skip
    return charts


# -- static loads -----------------------------------------------------------------------------------------------------
def _points(e: LoadEstimate, known: Array | None) -> Chart:
    low, high = e.band()
    load = np.abs(e.load) if e.load.dtype.kind == "c" else e.load
    curves = [Curve(f"estimate with {BAND}", load, low=low, high=high, dots=True)]
    curves += [] if known is None else [Curve("truth", np.abs(known) if load is not e.load else known, "truth", True)]
    units = ", ".join(squared(u) for u in sorted(set(e.units)))
    return Chart(
        title="loads", x_name="load", y_name=f"load [{units}]", x=np.arange(len(load), dtype=float), curves=curves,
        names=e.labels, said="; ".join(_said(peak, "", None) for peak in e.peaks[:3]),
    )  # fmt: skip


def _along(e: LoadEstimate, known: Array | None) -> list[Chart] | None:
    """Static loads over their places on a line, a chart for each direction."""
    g = e.geometry
    assert g is not None
    found = places(g)
    if found is None or found[0].shape[1] > 1:
        return None
    x, order = found[0][:, 0], np.argsort(found[0][:, 0], kind="stable")
    count = len(e.labels) // len(x)
    names = [str(c) for c in (g.get("components") or [""] * count)]
    word = "force" if g.get("kind") == "nodal" else "traction"
    low, high = e.band()
    charts = []
    for k in range(count):
        load, lower, upper = (part[k::count][order] for part in (e.load, low, high))
        curves = [Curve(f"estimate with {BAND}", load, low=lower, high=upper)]
        curves += [] if known is None else [Curve("truth", known[k::count][order], "truth")]
        at = int(np.argmax(np.abs(load)))
        charts.append(Chart(
            title=names[k] or word, x_name=f"{found[1][0]} [m]", y_name=f"{word} [{squared(e.units[k])}]", x=x[order],
            curves=curves,
            said=f"{word} {names[k]} along the line with its {BAND}: largest {load[at]:.4g} {e.units[k]} "
            f"at {x[order][at]:.4g} m",
        ))  # fmt: skip
    return charts


# -- how it was found -------------------------------------------------------------------------------------------------
def of_choice(e: LoadEstimate) -> list[Chart]:
    """L-curve, residual and GCV over lambda, with what every rule said."""
    if e.choice is None or e.choice.sweep is None:
        return []
    choice, sweep = e.choice, e.choice.sweep
    used = [(choice.rule, choice.lam)]
    asked = used + [(r.rule, r.lam) for r in choice.rules if r.lam is not None and r.rule != choice.rule]
    lam = np.array([min(max(value, float(sweep.lam[0])), float(sweep.lam[-1])) for _, value in asked])
    order = np.argsort(lam[1:], kind="stable") + 1

    def on(y: Array) -> Array:
        with np.errstate(divide="ignore"):
            return np.asarray(np.exp(np.interp(np.log(lam), np.log(sweep.lam), np.log(np.maximum(y, 1e-300)))))

    def dots(x: Array, y: Array) -> list[Curve]:
        said = Curve("other rules", y[order], "other4", True, x=x[order])
        return [Curve(f"used: {choice.rule}", y[:1], "used", True, x=x[:1]), *([said] if len(order) else [])]

    lines = [(float(lam[k]), asked[k][0]) for k in range(min(len(asked), MARKED))]
    norms, sizes = np.maximum(sweep.residual_norm, 1e-300), np.maximum(sweep.penalty_norm, 1e-300)
    corner = np.argsort(norms, kind="stable")
    charts = [
        Chart(title="L-curve", x_name="residual norm (whitened)", y_name="penalty norm", x=norms[corner], x_log=True,
              y_log=True, curves=[Curve("all lambdas", sizes[corner], "estimate"), *dots(on(norms), on(sizes))],
              said=f"L-curve; verdict {choice.verdict}"),
        Chart(title="residual over lambda", x_name="relative lambda", y_name="residual norm (whitened)", x=sweep.lam,
              x_log=True, y_log=True, curves=[Curve("residual", norms, "estimate"), *dots(lam, on(norms))],
              lines=lines, said=f"residual over lambda with the lambda of {len(asked)} rules"),
    ]  # fmt: skip
    if sweep.gcv is not None:
        gcv = np.where(sweep.gcv > 0, sweep.gcv, np.nan)
        charts.append(Chart(
            title="GCV function", x_name="relative lambda", y_name="GCV (whitened data, squared)", x=sweep.lam,
            x_log=True, y_log=True, curves=[Curve("GCV", gcv, "other3")], lines=lines, said="GCV function over lambda",
        ))  # fmt: skip
    return charts


def of_diagnosis(e: LoadEstimate) -> list[Chart]:
    """Data coefficients and singular values of every mode, filter factors, point spreads, what is left of a load."""
    d = e.diagnosis
    if d is None:
        return []
    i = np.arange(1, len(d.coefficients) + 1, dtype=float)
    plateau = [(d.plateau + 0.5, f"i* = {d.plateau}")]
    seen = [Curve("data coefficient |u·y|", _above_rounding(d.coefficients), "other4", True)]
    seen += [Curve("plateau: noise", np.where(i > d.plateau, d.floor, np.nan), "level")] if d.floor > 0 else []
    gamma = _above_rounding(d.generalised / d.scale)
    used = [] if e.choice is None or not e.choice.lam > 0 else [
        Curve("lambda that was used", np.full(len(i), e.choice.lam), "level")
    ]  # fmt: skip
    known = places(e.geometry)
    line = known if known is not None and known[0].shape == (d.n, 1) else None
    x = np.arange(1, d.n + 1, dtype=float) if line is None else line[0][:, 0]
    order = np.argsort(x, kind="stable")
    names = list(e.labels) if len(e.labels) == d.n else [f"load {j + 1}" for j in range(d.n)]
    spreads = [Curve(names[int(j)], d.point_spreads[order, k], f"other{k % 6}") for k, j in enumerate(d.shown)]
    return [
        Chart(title=f"i* = {d.plateau} recoverable modes of {d.seen}", x_name="mode", y_name="|u·y| (whitened data)",
              x=i, curves=seen, y_log=True, lines=plateau, said=f"Picard plot, i* = {d.plateau} of {d.seen}"),
        Chart(title="singular values", x_name="mode", y_name="generalised singular value / largest", x=i, y_log=True,
              curves=[Curve("singular value", gamma, "estimate"), *used], lines=plateau,
              said="generalised singular values of the modes and lambda"),
        Chart(title=f"filter factors; their sum is {np.sum(d.filter_factors):.3g} per frame", x_name="mode",
              y_name="share that comes from the data", x=i, lines=plateau, y_range=(-0.02, 1.05),
              curves=[Curve("filter factor", d.filter_factors, "estimate")], said="share of every mode from the data"),
        Chart(title="point spreads: what is shown of one load", x_name="load" if line is None else f"{line[1][0]} [m]",
              y_name="shown per unit load", x=x[order], curves=spreads, said=f"point spreads of {len(d.shown)} loads"),
        Chart(title="height left of a single load", x_name="load", y_name="share", x=np.arange(1, d.n + 1, dtype=float),
              curves=[Curve("height in place", d.heights, "estimate"),
                      Curve("cross-talk / height", np.minimum(d.cross_talk, 10.0), "other1", x=d.columns + 1.0)],
              lines=[(d.worst + 1.0, "worst")], said=f"what is left of each of {d.n} loads"),
    ]  # fmt: skip


def _above_rounding(y: Array) -> Array:
    """Values of a log axis; NaN where only rounding is left."""
    top = float(np.max(y, initial=0.0, where=np.isfinite(y)))
    return np.where(np.isfinite(y) & (y > 1e-17 * top), y, np.nan)


def of_response(e: LoadEstimate) -> list[Chart]:
    """Measured against predicted response, and what is left, per sensor."""
    if e.response is None or e.residual is None or e.predicted is None:
        return []
    if e.response.ndim == 1 or e.axis is None or len(e.axis.values) != len(e.response):
        return [_static_response(e)]
    x, lines, charts = readable(e)[0] * e.axis.values, e.axis.name == "frequency", []
    for j in range(min(len(e.sensors), PANELS)):
        measured, residual, predicted = (part[:, j] for part in (e.response, e.residual, e.predicted))
        if lines or e.response.dtype.kind == "c":  # of amplitudes the moduli
            measured, residual, predicted = (np.abs(part) for part in (measured, residual, predicted))
        size = float(np.linalg.norm(measured))
        share = f"{np.linalg.norm(residual) / size:.2%} of the signal" if size > 0 else "the signal is zero"
        charts.append(Chart(
            title=e.sensors[j], x_name=axis_label(e), y_name=titled("response", squared(e.sensor_units[j])), x=x,
            y_log=lines, said=f"measured and predicted response of {e.sensors[j]}; residual {share}",
            curves=[Curve("measured", measured, "measured"), Curve("predicted", predicted, "predicted"),
                    Curve(f"residual, {share}", residual, "residual")],
        ))  # fmt: skip
    return charts


def _static_response(e: LoadEstimate) -> Chart:
    assert e.response is not None
    assert e.predicted is not None
    measured, predicted = (
        np.abs(p) if np.iscomplexobj(p) else p for p in (np.ravel(e.response), np.ravel(e.predicted))
    )
    order = np.argsort(measured, kind="stable")
    units = ", ".join(squared(u) for u in sorted(set(e.sensor_units)))
    ends = np.array([min(measured.min(), predicted.min()), max(measured.max(), predicted.max())])
    return Chart(
        title="sensors", x_name=f"measured [{units}]", y_name=f"predicted [{units}]", x=measured[order],
        curves=[Curve("sensors", predicted[order], "other1", True),
                Curve("measured = predicted", ends, "level", x=ends)],
        said=f"measured against predicted of {', '.join(e.sensors[:8])}",
    )  # fmt: skip
