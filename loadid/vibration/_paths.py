"""In-situ transfer path analysis: blocked forces at virtual points, held against sensors kept out, and ranked."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._flags import Flag
from structures._model import Model, as_model
from structures._models.mapped import MOTIONS, MappedModel, loads_of, mapped, point_loads, rigid_share
from structures._testing.welch import CrossSpectra
from structures.errors import InputError

from .. import _guards as guards
from .._families.frequency import FrequencyInversion
from .._guards.vibration import misplaced, not_rigid
from .._record import Record, Spectra, find
from .._results.estimate import LoadEstimate
from ..settings import ChoiceLike, Noise
from ..sources import Contributions, Transfer, contributions, validate_on
from ..sources._transfer import subset

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..sources import ResponseComparison

Real = NDArray[np.float64]
Place = tuple[Sequence[float], Sequence[float]]  # position (m) and direction


@dataclass(frozen=True, eq=False)
class VirtualPoint:
    """A part of the interface that moves as a rigid one: the forces and sensors around it become those of one point.

    Parameters
    ----------
    label : str
        Its loads are called ``label+X ... label+RZ``.
    loads : dict of label -> (position, direction)
        Loads of the model around it (hits), position in m.
    sensors : dict of label -> (position, direction)
        Sensors of the model around it, more than there are motions: they show whether the part is rigid.
    centre : array (3,)
        m.
    motions : sequence of str
        Of X, Y, Z, RX, RY, RZ; default all six. Of hits along Z alone: Z, RX, RY.
    """

    label: str
    loads: Mapping[str, Place]
    sensors: Mapping[str, Place] = field(default_factory=dict)
    centre: ArrayLike = (0.0, 0.0, 0.0)
    motions: Sequence[str] = MOTIONS

    def columns(self) -> NDArray[np.float64]:
        """Matrix (loads, motions) of the forces that make up each unit load of the point."""
        positions, directions = zip(*self.loads.values(), strict=True)
        return loads_of(positions, directions, self.centre, tuple(self.motions))

    def share(self, model: Model, frequencies: Real) -> Real | None:
        """Share of the power of its sensors, under its loads, that a rigid motion explains; None without sensors.

        Raises
        ------
        InputError
            A sensor that the model has not, or too few of them.
        """
        if not self.sensors:
            return None
        rows = [find(n, [s.label for s in model.sensors], what="sensor", where=self.label) for n in self.sensors]
        columns = [find(n, [c.label for c in model.loads], what="load", where=self.label) for n in self.loads]
        positions, directions = zip(*self.sensors.values(), strict=True)
        values = np.asarray(model.frf(frequencies), complex)[:, rows][:, :, columns]
        return rigid_share(values, positions, directions, self.centre, tuple(self.motions))

    def contradiction(self, model: Model, frequencies: Real) -> float | None:
        """Mean power of what its loads do as on no rigid part, as placed, over that of their noise.

        About 1 for loads that stand where they are said to. None with no more loads than motions, or FRFs without a
        variance.

        Raises
        ------
        InputError
            A load that the model has not.
        """
        T, known = self.columns(), model.frf_variance(frequencies)
        if known is None or len(T) <= T.shape[1]:
            return None
        columns = [find(n, [c.label for c in model.loads], what="load", where=self.label) for n in self.loads]
        none = np.linalg.svd(T)[0][:, T.shape[1] :]  # combinations of the loads without force and moment
        left = np.abs(np.asarray(model.frf(frequencies), complex)[:, :, columns] @ none) ** 2
        noise = np.asarray(known, float)[:, :, columns] @ none**2
        return float(np.mean(left[noise > 0] / noise[noise > 0])) if np.any(noise > 0) else None


@dataclass(frozen=True, eq=False, repr=False)
class TransferPaths:
    """Blocked forces of a source, what they are worth on sensors that were kept out, and which of them matter.

    Parameters
    ----------
    estimate : LoadEstimate
        Blocked forces with their band.
    held_out : Transfer or None
        Prediction of the sensors that were kept out, against what they measured.
    contributions : Contributions
        Of every blocked force to the receivers.
    rigid : dict of label -> array (lines,)
        Share of the power of the sensors around each virtual point that a rigid motion explains.
    flags : tuple of Flag
        W119, and what the validation found; those of the forces are in the estimate.
    """

    estimate: LoadEstimate
    held_out: Transfer | None
    contributions: Contributions
    rigid: Mapping[str, Real]
    flags: tuple[Flag, ...]

    def __repr__(self) -> str:
        return f"TransferPaths({len(self.estimate.labels)} blocked forces, {len(self.contributions.sensors)} receivers)"

    def ranking(self, receiver: int | str | None = None) -> tuple[tuple[str, float, float | None], ...]:
        """Blocked forces with their share in the power of a receiver and the std of that share, largest first.

        Parameters
        ----------
        receiver : int or str, optional
            Default the mean over all of them.

        Notes
        -----
        The std counts the errors of the lines as independent, and those of the other forces: of
        ``s_j = p_j / sum_i p_i`` it is, to first order, ``sqrt(((1 - s_j) dp_j)^2 + s_j^2 sum_i dp_i^2) / sum_i p_i``.
        """
        c = self.contributions
        share, spread = c.shares().share[0], _share_std(c)
        rows = list(range(len(c.sensors))) if receiver is None else [c.index(receiver)]
        mean = share[rows].mean(axis=0)
        std = None if spread is None else np.sqrt(np.mean(spread[rows] ** 2, axis=0))
        return tuple((c.loads[j].label, float(mean[j]), None if std is None else float(std[j]))
                     for j in np.argsort(-mean, kind="stable"))  # fmt: skip

    def summary(self) -> str:
        """Validation first, then the ranking with its std, the interface, and the flags."""
        lines = [f"blocked forces: {', '.join(self.estimate.labels)}"]
        if self.held_out is not None:
            c = self.held_out.comparison
            lines += [f"kept out: {n} predicted {rms:.2f} dB rms off{r}"
                      for n, rms, r in zip(c.sensors, c.rms_lines, _correlation(c), strict=True)]  # fmt: skip
        else:
            lines.append("kept out: no sensor, so nothing tells what these forces are worth (validation=)")
        for s in self.contributions.sensors:
            ranked = [
                f"{name} {share:.1%}" + ("" if std is None else f" ± {std:.1%}")
                for name, share, std in self.ranking(s.label)
                if share >= 1e-3
            ]
            lines.append(f"{s.label}: {', '.join(ranked)}")
        lines += [f"{name}: a rigid motion explains {np.median(x):.1%} of the power around it (least {x.min():.1%})"
                  for name, x in self.rigid.items()]  # fmt: skip
        return "\n".join([*lines, *(str(f) for f in (*self.flags, *self.estimate.cautions))])

    def __str__(self) -> str:
        return self.summary()

    def plot(self, *, path: str | os.PathLike[str] | None = None, show: bool = False) -> Figure:
        """Picture of the blocked forces with their band, the sensors kept out, and the ranking with its std.

        Parameters
        ----------
        path, show
            As in `LoadEstimate.plot`.
        """
        from .._plots.vibration import draw_paths

        return draw_paths(self, path=path, show=show)


def transfer_paths(
    model: Model,
    operation: Spectra | CrossSpectra,
    *,
    points: Sequence[VirtualPoint] = (),
    validation: Sequence[str] = (),
    receivers: Sequence[str] = (),
    choice: ChoiceLike = None,
    noise: ArrayLike | Noise | None = None,
    trust: float | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> TransferPaths:
    """Blocked forces of a source that stays in place, validated on sensors that were kept out, and ranked.

    Parameters
    ----------
    model : Model
        FRFs of the assembly, measured with the source in place and at rest: from forces at the interface to sensors on
        the receiver.
    operation : Spectra or CrossSpectra
        Responses while the source runs, of the sensors that identify and of those that are kept out.
    points : sequence of VirtualPoint
        Loads that become those of one point; all others stay as they are.
    validation : sequence of str
        Sensors that are kept out and predicted.
    receivers : sequence of str
        Sensors whose response is parted among the forces; they need no operating data. Default those kept out.
    choice, noise
        As of `loadid.FrequencyInversion`; the noise in the order of the sensors of the model.
    trust : float, optional
        As of `loadid.sources.contributions`.
    progress : callable, optional

    Returns
    -------
    TransferPaths
        With W119 where the sensors around a point do not move as a rigid part, or the loads around it do not act as on
        one at the places stated.

    Raises
    ------
    InputError
        Sensors, loads or points that the model has not, a record over time, neither validation nor receivers.
    NotIdentifiable
        Loads that cannot make up a motion of a virtual point.

    Notes
    -----
    A. T. Moorhouse, A. S. Elliott, T. A. Evans, J. Sound Vib. 325 (2009) 679-685; ISO 20270:2019; virtual points:
    M. V. van der Seijs et al. (2013), and M. V. van der Seijs, D. de Klerk, D. J. Rixen, "General framework for
    transfer path analysis", Mech. Syst. Signal Process. 68-69 (2016) 217-244.
    """
    model = as_model(model, "transfer_paths", "frf")
    if isinstance(operation, Record) or not isinstance(operation, Spectra | CrossSpectra):
        raise InputError("transfer paths are found over frequency", where="transfer_paths",
                         found=type(operation).__name__, expected="Spectra or CrossSpectra",
                         hint="structures.cross_spectra(record, segment=...) on the lines of the model")  # fmt: skip
    labels = [s.label for s in model.sensors]
    held = [find(n, labels, what="sensor", where="validation") for n in validation]
    asked = [find(n, labels, what="sensor", where="receivers") for n in receivers] or held
    if not asked:
        raise InputError("no receiver", where="transfer_paths", found="neither validation nor receivers",
                         expected="sensors whose response is explained, or predicted",
                         hint="keep two or three sensors out: validation=[...]")  # fmt: skip
    driven = at_points(model, points)
    measured = set(operation.labels)
    used = [n for i, n in enumerate(labels) if i not in {*held, *asked} and (n in measured or not measured)]
    family = FrequencyInversion(
        driven, sensors=used, validation=[labels[i] for i in held], choice=choice,
        noise=_chosen(noise, [labels.index(n) for n in used] + held, len(labels)), progress=progress,
    )  # fmt: skip
    estimate = family.estimate(operation)
    assert estimate.axis is not None
    f = estimate.axis.values
    rigid = {p.label: x for p in points if (x := p.share(model, f)) is not None}
    transfer = None
    if held:
        transfer = validate_on(estimate, subset(driven, np.array(held)), operation)
        estimate = estimate.validated(transfer.validation)
    ranked = contributions(driven, estimate, [labels[i] for i in asked], trust=trust)
    found = [*(transfer.flags if transfer is not None else ()), *(not_rigid(n, x, f) for n, x in rigid.items()),
             *(misplaced(p.label, p.contradiction(model, f)) for p in points)]  # fmt: skip
    return TransferPaths(estimate, transfer, ranked, rigid, guards.collect(found))


def at_points(model: Model, points: Sequence[VirtualPoint]) -> MappedModel:
    """The model under the loads of virtual points, in place of those around them; the others follow, as they are.

    Raises
    ------
    InputError
        A load that the model has not, or that belongs to two points.
    """
    have = [c.label for c in model.loads]
    members = [[find(n, have, what="load", where=p.label) for n in p.loads] for p in points]
    every = [i for one in members for i in one]
    if len(set(every)) < len(every) or any(not one for one in members):
        raise InputError("a load belongs to one virtual point", where="points",
                         found=[have[i] for i in every if every.count(i) > 1], expected="each load once")  # fmt: skip
    rest = [i for i in range(len(have)) if i not in every]
    blocks = [p.columns() for p in points]
    T = np.zeros((len(have), sum(b.shape[1] for b in blocks) + len(rest)))
    start = 0
    for one, block in zip(members, blocks, strict=True):
        T[one, start : start + block.shape[1]] = block
        start += block.shape[1]
    T[rest, np.arange(start, T.shape[1])] = 1.0
    named = [c for p in points for c in point_loads(p.label, p.motions)]
    return mapped(model, T, [*named, *(model.loads[i] for i in rest)])


# -- inside ------------------------------------------------------------------------------------------------------------
def _chosen(noise: Any, rows: Sequence[int], count: int) -> Any:
    """The noise of the sensors that are used, of what is given for all of the model."""
    if noise is None or isinstance(noise, Noise) or np.ndim(noise) == 0 or len(noise) != count:
        return noise
    return np.asarray(noise, float)[list(rows)]


def _correlation(c: ResponseComparison) -> list[str]:
    """In words, per sensor; densities have none."""
    known = c.correlation
    return [""] * len(c.sensors) if known is None else [f", correlation {r:.3f}" for r in known]


def _share_std(c: Contributions) -> Real | None:
    """Std of the share of every load in the power of each receiver, (sensors, loads)."""
    if c.std is None or c.kind == "histories":
        return None
    from ..sources._levels import widths

    amplitudes = c.kind == "spectra"
    power = np.abs(c.values) ** 2 if amplitudes else np.asarray(c.values, float)
    spread = 2 * np.abs(c.values) * c.std / np.sqrt(2) if amplitudes else c.std
    wide = np.ones(len(power)) if amplitudes else widths(c.axis.values)
    counted = np.ones(power.shape[:2]) if c.trusted is None else c.trusted.astype(float)
    p = np.einsum("k,ks,ksl->sl", wide, counted, power)
    d = np.sqrt(np.einsum("k,ks,ksl->sl", wide**2, counted, spread**2))
    whole = np.maximum(p.sum(axis=1, keepdims=True), 1e-300)
    s = p / whole
    others = np.sum(d**2, axis=1, keepdims=True) - d**2
    return np.asarray(np.sqrt(((1 - s) * d) ** 2 + s**2 * others) / whole)
