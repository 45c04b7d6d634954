"""From a target and limits to drives: what is asked for in one form, scaled, and handed to the cone solver."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from structures._channels import Channel
from structures._flags import Flag
from structures._model import Model, as_model
from structures._testing.welch import CrossSpectra
from structures.errors import InputError, positive

from .._guards import vibration as guards
from .._record import find
from .._spellings import Progress
from ..sources._levels import widths
from ._drives import Drives
from ._profiles import TOLERANCE, Limit, Target

if TYPE_CHECKING:
    from .._inverse.constrained.driven import Caps

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
FRF_ERROR = 0.02  # of an entry of an FRF, where nobody states one


def find_drives(
    model: Model,
    target: Target | CrossSpectra,
    *,
    limits: Sequence[Limit] = (),
    frf_error: float = FRF_ERROR,
    tolerance: float | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Drives:
    """Drives whose responses come nearest to a target, under limits of drives and of responses.

    Parameters
    ----------
    model : Model
        Sensors over drives: forces in N, or the voltages of shakers in V (FRFs per volt).
    target : Target or CrossSpectra
        Autospectra alone, amplitudes of a sine with or without phases, or cross spectra; of sensors of the model.
    limits : sequence of Limit
        Of loads and of any sensors of the model.
    frf_error : float
        Relative std of every entry of the FRFs, where the model does not state their variance.
    tolerance : float, optional
        dB; default that of the target, 3 dB for cross spectra.
    progress : callable, optional
        Called with the share that is done and what is being done.

    Returns
    -------
    Drives
        With W317 where no drives reach the target, and W316 where limits hold them back.

    Raises
    ------
    InputError
        Sensors or limits that are not of the model, units, lines or limits that do not fit, cross spectra of which only
        the diagonal is given (E221), a target that asks for no motion at all.
    NotIdentifiable
        The cone solver does not settle.

    Notes
    -----
    Of cross spectra the error of the whole matrix over the roots of the target is least; of autospectra alone the cross
    spectra of the drives are free, and the squared error in dB is. Errors of the FRFs count in both as they spread the
    response. MIL-STD-810H, method 527, for tests by several exciters; the programme and its sources:
    `loadid._inverse.constrained.driven`.
    """
    model = as_model(model, "find_drives", "frf")
    told = Progress(progress)
    error = positive("frf_error", frf_error, where="find_drives")
    wanted = _wanted(target, tolerance)
    f, levels, kind = wanted.frequencies, wanted.levels, wanted.kind
    labels = [s.label for s in model.sensors]
    rows = [find(c.label, labels, what="sensor", where="find_drives") for c in wanted.channels]
    _same_units(wanted.channels, [model.sensors[i] for i in rows])
    told(0.05, "FRFs")
    everything = np.asarray(model.frf(f), complex)
    known = model.frf_variance(f)
    spread = np.asarray(known, float) if known is not None else (error * np.abs(everything)) ** 2
    H, variance = everything[:, rows], spread[:, rows]
    names, caps = _limits(limits, model, everything, spread, f, kind)
    same: dict[str, Any] = {
        "kind": kind, "frequencies": f, "loads": tuple(model.loads), "sensors": tuple(model.sensors[i] for i in rows),
        "H": H, "variance": variance, "target": levels, "limits": names, "caps": caps.rows, "spread": caps.spread,
        "most": caps.most, "total": caps.total, "fingerprint": model.fingerprint, "flags": wanted.flags,
        "tolerance": wanted.tolerance,
    }  # fmt: skip
    free, held = (_random if kind == "random" else _sine)(
        same, wanted, lambda share: told(0.1 + 0.85 * share, "drives")
    )
    name = "matrix" if kind == "random" else "amplitudes"
    other = {"matrix": None, "amplitudes": None, "free": np.zeros(levels.shape)}
    best = Drives(**{**same, **other, name: free})
    told(1.0, "done")
    return Drives(**{**same, **other, name: held, "free": best.error, "passed": best.over}).judged()


# -- inside ------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class _Wanted:
    """Any target in one form; `matrix` and `phases` are None where they are free."""

    frequencies: Real
    levels: Real
    channels: tuple[Channel, ...]
    kind: str
    matrix: Complex | None
    phases: Real | None
    tolerance: float
    flags: tuple[Flag, ...]


def _wanted(target: Any, tolerance: float | None) -> _Wanted:
    within = None if tolerance is None else positive("tolerance", tolerance, where="find_drives", unit="dB")
    if isinstance(target, Target):
        found = _Wanted(target.frequencies, target.levels, target.channels, target.kind, None, target.phases,
                        within or target.tolerance, ())  # fmt: skip
    elif isinstance(target, CrossSpectra):
        if not guards.coupled(target.matrix):
            raise InputError(
                "autospectra alone are no matrix of cross spectra", where="find_drives",
                found=f"no cross spectrum between any two of {len(target.channels)} channels",
                expected="how the channels move together, or a Target, which leaves that free",
                hint="Target(frequencies, autospectra, channels), loadid.vibration.by_buzz or by_coherence",
                code="LID-E221",
            )  # fmt: skip
        levels = np.array(target.autospectra)
        found = _Wanted(target.frequencies, levels, target.channels, "random", target.matrix, None,
                        within or TOLERANCE, tuple(target.flags))  # fmt: skip
    else:
        raise InputError("no target", where="find_drives", found=type(target).__name__,
                         expected="loadid.vibration.Target or structures.CrossSpectra")  # fmt: skip
    _all_asked(found.levels, found.frequencies, [c.label for c in found.channels])
    return found


def _random(same: dict[str, Any], wanted: _Wanted, told: Callable[[float], None]) -> tuple[Complex, Complex]:
    from .._inverse.constrained.driven import Caps, Goal, densities

    root, wide, N = np.sqrt(wanted.levels), widths(wanted.frequencies), None
    if wanted.matrix is not None:
        N = np.asarray(wanted.matrix / (root[:, :, None] * root[:, None, :]))
    goal = Goal(same["H"] / root[..., None], same["variance"] / root[..., None] ** 2, N)
    return densities(goal, Caps(same["caps"], same["spread"], same["most"], wide, same["total"]), told)


def _sine(same: dict[str, Any], wanted: _Wanted, told: Callable[[float], None]) -> tuple[Complex, Complex]:
    from .._inverse.constrained.driven import Caps, Goal, amplitudes, densities

    size = wanted.levels[..., None]
    H, variance = same["H"] / size, same["variance"] / size**2
    lines, _, loads = H.shape
    start = np.zeros((lines, loads), complex)
    if wanted.phases is None:  # the random drives of the same levels, and of these what acts together most
        relaxed, _ = densities(Goal(H, variance, None), Caps.none(lines, loads), lambda share: told(0.8 * share))
        w, V = np.linalg.eigh(relaxed)
        start = V[..., -1] * np.sqrt(np.maximum(w[..., -1:], 0.0))
    caps = Caps(same["caps"], same["spread"], same["most"], np.ones(lines), same["total"])
    return amplitudes(H, variance, wanted.phases, caps, start)


def _limits(
    limits: Sequence[Limit], model: Model, H: Complex, variance: Real, f: Real, kind: str
) -> tuple[tuple[str, ...], Caps]:
    """Names of the limits, and the limits themselves."""
    from .._inverse.constrained.driven import Caps, allowing

    count, (lines, _, loads) = len(limits), H.shape
    rows, most, total = (
        np.zeros((count, lines, loads), complex),
        np.full((count, lines), np.inf),
        np.full(count, np.inf),
    )
    spread = np.zeros(rows.shape)
    drives, sensors = [c.label for c in model.loads], [c.label for c in model.sensors]
    told = []
    for n, limit in enumerate(limits):
        if (limit.kind == "amplitude") != (kind == "sine"):
            raise InputError("the limit is not of this kind of drive", where=f"Limit, {limit.channel}",
                             found=f"{limit.kind}= for {kind} drives",
                             expected="amplitude= for a sine, rms= or density= for random drives",
                             hint="a sine of amplitude a has the rms a / sqrt(2)")  # fmt: skip
        place = find(limit.channel, [*drives, *sensors], what="drive or sensor", where="Limit")
        channel = [*model.loads, *model.sensors][place]
        rows[n] = np.eye(loads)[place] if place < loads else H[:, place - loads]
        if place >= loads:
            rows[n], spread[n] = allowing(rows[n], variance[:, place - loads])
        value = limit.on(f, channel)
        told.append(limit.told(channel.unit))
        if not np.isfinite(value).any():
            raise InputError("the limit holds on no line", where=f"Limit, {limit.channel}",
                             found=f"lines from {f[0]:g} to {f[-1]:g} Hz",
                             expected="a profile with breakpoints around some of them")  # fmt: skip
        if limit.kind == "rms":
            total[n] = value[0] ** 2
        else:
            most[n] = value if limit.kind == "density" else value**2
    return _told_apart(told), Caps(rows, spread, most, widths(f), total)


def _told_apart(names: Sequence[str]) -> tuple[str, ...]:
    """Names, those that are the same numbered."""
    return tuple(f"{n} ({names[:k].count(n) + 1})" if names.count(n) > 1 else n for k, n in enumerate(names))


def _same_units(given: Sequence[Channel], own: Sequence[Channel]) -> None:
    for a, b in zip(given, own, strict=True):
        if a.unit != b.unit and "arbitrary" not in (a.unit, b.unit):
            raise InputError("the unit of a target is not that of the sensor", where=f"target, {a.label}", found=a.unit,
                             expected=b.unit)  # fmt: skip


def _all_asked(levels: Real, f: Real, names: Sequence[str]) -> None:
    if not np.all(levels > 0):
        k, i = np.argwhere(~(levels > 0))[0]
        raise InputError("a target of no motion at all has no dB", where=f"target, {names[i]}",
                         found=f"0 at {f[k]:g} Hz", expected="levels above 0 on every line",
                         hint="leave the sensor out and limit it: Limit(label, density=...)")  # fmt: skip
