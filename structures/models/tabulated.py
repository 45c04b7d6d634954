"""Forward model from a table: FRFs on any set of lines, a band of a sweep or the lines that a shaker excites."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NoReturn, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..advice import Advice
from ..channels import Channel
from ..errors import InputError, as_array, digest, lines, plain
from ..files import storage
from ..flags import Evidence, Flag
from ..model import Certificate, Model
from ..testing import kinds
from ..testing import kinds as causality
from ..testing.runs import of_spectra, tabulated
from .measured import tuples

if TYPE_CHECKING:
    from ..testing.welch import CrossSpectra


FILE = "table of FRFs"
ON_A_LINE = 1e-6  # of the spacing: how near a frequency must be to a line to be that line
ADVICE = {
    "static": "MatrixModel takes a measured static matrix; ForwardModel computes one",
    "impulse_response": "MeasuredModel.from_frf takes an FRF on a uniform grid from 0 Hz to the Nyquist frequency",
    "state_space": "fit modes to the FRF and give ForwardModel the structure",
}
PARTS = ("frequencies", "H", "sensors", "loads", "variance", "coherence", "certificate", "flags", "interpolate")


class FrfModel(Model):
    """Frequency responses (lines, sensors, loads) on any ascending lines, and nothing between them.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz, ascending, each once: a band (20 to 1000 Hz), or three lines.
    H : array, shape (lines, sensors, loads), complex
        Response over load, unit of the sensor over unit of the load; the sign of time is exp(+i omega t).
    sensors, loads : sequence of Channel
        More loads than sensors are taken: whether the loads can be told apart is a question to the inversion.
    variance : array like H, optional
        Variance E|error|^2 of H.
    coherence : array, shape (lines, sensors), optional
        Multiple coherence, which is the ordinary one for one load.
    certificate : Certificate, optional
    flags : sequence of Flag
    interpolate : bool
        Whether lines between its own are interpolated, linearly in real and imaginary part; a flag W211 says so.

    Raises
    ------
    InputError
        Shapes that do not fit, NaN, lines that do not ascend, doubled labels, a table of zeros.
    """

    frequencies: NDArray[np.float64]

    def __init__(
        self,
        frequencies: ArrayLike,
        H: ArrayLike,
        *,
        sensors: Sequence[Channel],
        loads: Sequence[Channel],
        variance: ArrayLike | None = None,
        coherence: ArrayLike | None = None,
        certificate: Certificate | None = None,
        flags: Sequence[Flag] = (),
        interpolate: bool = False,
    ) -> None:
        self.sensors, self.loads = tuple(sensors), tuple(loads)
        self.frequencies = _ascending(frequencies)
        rows = (len(self.frequencies), len(self.sensors))
        self.H = _table("H", H, (*rows, len(self.loads)), complex)
        self.variance = None if variance is None else _table("variance", variance, self.H.shape)
        self.coherence = None if coherence is None else _table("coherence", coherence, rows)
        self.certificate, self.interpolate = certificate, bool(interpolate)
        _check_labels(self)
        if not np.any(self.H):
            raise InputError(
                "no load moves any sensor", where="FrfModel", found="zeros on every line", expected="an FRF"
            )
        known = [f for f in flags if f.evidence.name != _BETWEEN]
        self.flags = (*known, *([_between_lines(self.frequencies)] if interpolate else []))

    # -- construction -----------------------------------------------------------------------------------------------
    @classmethod
    def from_frf(
        cls,
        frequencies: ArrayLike,
        H: ArrayLike,
        *,
        kind: str | None = None,
        sensors: Sequence[str | Channel] | None = None,
        loads: Sequence[str | Channel] | None = None,
        variance: ArrayLike | None = None,
        coherence: ArrayLike | None = None,
        interpolate: bool = False,
    ) -> Self:
        """Model from an FRF of somebody else, with a flag W207 where it answers before it is asked.

        Parameters
        ----------
        frequencies : array, shape (lines,)
            Hz, ascending.
        H : array, shape (lines,), (lines, sensors) or (lines, sensors, loads), complex
        kind : {"accelerance", "mobility", "receptance"}
            What the response is; required, and never guessed.
        sensors, loads : sequence of str or Channel, optional
        variance, coherence, interpolate
            As for the class; a variance has the shape of H.

        Raises
        ------
        InputError
            Kind missing (LID-W208), shapes that do not fit, NaN, lines that do not ascend.
        """
        kind = kinds.check(kind, "from_frf")
        H = _cube(as_array(H, where="from_frf, H"))
        rows, flags = kinds.rows(sensors, H.shape[1], kind)
        columns = [
            c if isinstance(c, Channel) else Channel(label=str(c), quantity="force", unit="N")
            for c in (loads or [f"load {j + 1}" for j in range(H.shape[2])])
        ]
        model = cls(
            frequencies,
            H,
            sensors=rows,
            loads=columns,
            variance=None if variance is None else _cube(as_array(variance, where="from_frf, variance")),
            coherence=coherence,
            flags=flags,
            interpolate=interpolate,
        )
        return model.judged()

    @classmethod
    def from_records(
        cls,
        records: Any,
        *,
        forces: str | int | Sequence[str | int],
        responses: str | int | Sequence[str | int],
        dt: float | None = None,
        channels: Sequence[Channel | str] | None = None,
        kind: str | None = None,
        estimator: str = "H1",
        window: str | tuple = "hann",
        segment: int | None = None,
        overlap: float = 0.5,
        detrend: str | None = "constant",
        least_coherence: float = 0.0,
        interpolate: bool = False,
    ) -> Self:
        """FRFs, their variance and multiple coherence from records with measured forces.

        Parameters
        ----------
        records : array (samples, channels), a record, or a list of either
        forces, responses : label or index, or several
            Channels; several forces may act at once, correlated or not.
        dt, channels, window, segment, overlap, detrend
            As for `structures.cross_spectra`.
        kind : {"accelerance", "mobility", "receptance"}, optional
            What the responses are, where their channels do not say.
        estimator : ``"H1"``, ``"H2"``, ``"Hv"`` or ``"Hs"``
            As `structures.testing.frfs.estimate` describes them.
        least_coherence : float
            Lines on which no sensor has this multiple coherence are left out, with a flag W211.
        interpolate : bool
            As for the class.

        Raises
        ------
        InputError
            As for `structures.cross_spectra`; a force that is no force, a response that is one.
        NotIdentifiable
            Code LID-E212: forces that are one.

        Notes
        -----
        A line that no force excites is left out, as is 0 Hz where the mean was taken off. The variance knows the noise
        that the segments show, and not the bias by leakage: W508 speaks of that.
        """
        cut = {"dt": dt, "channels": channels, "window": window, "segment": segment, "overlap": overlap}
        cut["detrend"] = detrend
        made = tabulated(records, forces, responses, kind, least_coherence, estimator, cut)
        return cls(**made, interpolate=interpolate).judged()

    @classmethod
    def from_spectra(
        cls,
        spectra: CrossSpectra,
        *,
        forces: str | int | Sequence[str | int],
        responses: str | int | Sequence[str | int],
        kind: str | None = None,
        estimator: str = "H1",
        least_coherence: float = 0.0,
        interpolate: bool = False,
    ) -> Self:
        """FRFs from cross spectra of forces and responses; parameters and errors as for `from_records`."""
        made = of_spectra(spectra, forces, responses, kind, least_coherence, estimator)
        return cls(**made, interpolate=interpolate).judged()

    @classmethod
    def of(cls, model: Model, frequencies: ArrayLike) -> Self:
        """Table of another model's FRFs at some lines (Hz), with their variance where it has one.

        Raises
        ------
        InputError
            Where the model has no `frf`, or none at these lines.
        """
        f = _ascending(frequencies)
        return cls(
            f,
            model.frf(f),
            sensors=model.sensors,
            loads=model.loads,
            variance=model.frf_variance(f),
            certificate=model.certificate,
            flags=model.flags,
        )

    @classmethod
    def joined(cls, models: Sequence[FrfModel]) -> Self:
        """One model of all loads of several: the same sensors on the same lines, each time driven elsewhere.

        The variance is known where that of every model is; a coherence belongs to one test, and is left out.

        Raises
        ------
        InputError
            No model, other sensors or lines, a load that two of them have.
        """
        models = list(models)
        if not models:
            raise InputError("no models", where="joined", found="an empty list", expected="at least one FrfModel")
        first = models[0]
        rows = [[(s.label, s.quantity, s.unit) for s in m.sensors] for m in models]
        for other, own in zip(models, rows, strict=True):
            same = np.array_equal(other.frequencies, first.frequencies)
            if not same or own != rows[0]:
                what = "sensors" if same else "lines"
                raise InputError(
                    f"models of different {what}",
                    where="joined",
                    found=f"{other!r} beside {first!r}",
                    expected="the same sensors, in the same order, on the same lines",
                    hint="model.at(lines) takes those that all of them have",
                )
        spreads = [m.variance for m in models]
        return cls(
            first.frequencies,
            np.concatenate([m.H for m in models], axis=2),
            sensors=first.sensors,
            loads=[c for m in models for c in m.loads],
            variance=None if any(v is None for v in spreads) else np.concatenate(spreads, axis=2),  # type: ignore[arg-type]
            flags=tuple(dict.fromkeys(f for m in models for f in m.flags)),
            interpolate=all(m.interpolate for m in models),
        )

    def judged(self) -> Self:
        """The same model with what its phases tell: W207 where it is turned, N207 where that cannot be told."""
        found = causality.lines(self.frequencies, self.H, self.sensors, self.loads)
        known = [f for f in self.flags if f.code not in ("LID-W207", "LID-N207")]
        return self._like(flags=(*known, *found))

    def at(self, lines: ArrayLike) -> Self:
        """The model on some of its lines: a mask (lines,) of truth values, or frequencies in Hz, ascending.

        Raises
        ------
        InputError
            A mask of another length, no line at all, or a frequency that is no line.
        """
        wanted = np.asarray(plain(lines))
        if wanted.dtype == bool:
            if wanted.shape != self.frequencies.shape:
                raise InputError(
                    "the mask does not fit the lines",
                    where="at",
                    found=f"shape {wanted.shape}",
                    expected=f"shape {self.frequencies.shape}",
                )
            index = np.flatnonzero(wanted)
        else:
            index = self._index(_ascending(wanted))
        spread, coherence = self.variance, self.coherence
        return self._like(
            frequencies=self.frequencies[index],
            H=self.H[index],
            variance=None if spread is None else spread[index],
            coherence=None if coherence is None else coherence[index],
        )

    def as_kind(self, kind: str) -> Self:
        """The same model with its motion sensors as accelerance, mobility or receptance.

        A line at 0 Hz that an integration would divide by zero tells nothing: it becomes 0, as uncertain as the line
        beside it, and a flag W211 says so.

        Raises
        ------
        InputError
            An unknown kind (LID-W208).
        """
        kind = kinds.check(kind, "as_kind")
        factor, size, lost = kinds.conversion(self.sensors, self.frequencies, kind)
        known = self.certificate
        return self._like(
            H=self.H * factor[..., None],
            sensors=[kinds.convert(s, kind) for s in self.sensors],
            variance=None if self.variance is None else self.variance * size[..., None],
            certificate=known and replace(known, source=f"{known.source} (before it was converted to {kind})"),
            flags=tuple(dict.fromkeys([*self.flags, *lost])),
        )

    def perturbed(self, parameter: str, factor: float) -> Self:
        """The same model with its gain multiplied by `factor`; nothing else of a table has a name."""
        if parameter != "gain":
            raise InputError(
                "a table of FRFs has no such parameter", where="perturbed", found=repr(parameter), expected="'gain'"
            )
        return self._like(H=self.H * factor, variance=None if self.variance is None else self.variance * factor**2)

    def with_sensors(self, rows: Sequence[int] | NDArray[np.intp]) -> Self:
        """The same model with some of its sensors, in the order given, and not yet verified."""
        rows = np.asarray(rows, np.intp)
        return self._like(
            sensors=[self.sensors[i] for i in rows],
            H=self.H[:, rows],
            variance=None if self.variance is None else self.variance[:, rows],
            coherence=None if self.coherence is None else self.coherence[:, rows],
            certificate=None,
        )

    def _like(self, **changes: Any) -> Self:
        return type(self)(**{**{name: getattr(self, name) for name in PARTS}, **changes})

    # -- the contract -----------------------------------------------------------------------------------------------
    def frf(self, frequencies: ArrayLike) -> NDArray[np.complex128]:
        """FRF at `frequencies` (Hz), its own lines, shape (lines, sensors, loads).

        Raises
        ------
        InputError
            A frequency that is none of its lines, unless the model interpolates; one outside them in any case.
        """
        return self._read(self.H, frequencies)

    def frf_variance(self, frequencies: ArrayLike) -> NDArray[np.float64] | None:
        """Variance of the FRF at `frequencies`, shape (lines, sensors, loads), or None where nothing is known of it.

        Raises
        ------
        InputError
            As for `frf`.
        """
        return None if self.variance is None else self._read(self.variance, frequencies)

    @property
    def fingerprint(self) -> str:
        """Sha256 of lines, FRF, its variance and the channels."""
        return digest("FrfModel", self.frequencies, self.H, self.variance, self.sensors, self.loads)

    # -- files ------------------------------------------------------------------------------------------------------
    def save(self, path: str | os.PathLike) -> None:
        """Write the model to HDF5, whole or not at all, with checksums."""
        tree: dict[str, Any] = {
            **{name: getattr(self, name) for name in ("frequencies", "H", "variance", "coherence", "interpolate")},
            "flags": [f.to_dict() for f in self.flags],
            **self._told(),
        }
        storage.write(path, tree, FILE)

    @classmethod
    def load(cls, path: str | os.PathLike) -> Self:
        """Read a model that `save` wrote.

        Raises
        ------
        InputError
            A damaged file, or one of another kind.
        """
        tree = storage.read(path, FILE)
        known = tree.pop("certificate")
        return cls(
            sensors=[Channel(**c) for c in tree.pop("sensors")],
            loads=[Channel(**c) for c in tree.pop("loads")],
            flags=[Flag.from_dict(f) for f in tree.pop("flags")],
            certificate=None if known is None else Certificate(**tuples(known)),
            **tree,
        )

    def __repr__(self) -> str:
        f = self.frequencies
        band = f"{f[0]:.6g} to {f[-1]:.6g} Hz" if len(f) > 1 else f"{f[0]:.6g} Hz"
        return f"FrfModel({len(self.sensors)} sensors, {len(self.loads)} loads, {len(f)} lines, {band})"

    # -- lines ------------------------------------------------------------------------------------------------------
    def _read(self, table: NDArray, frequencies: ArrayLike) -> NDArray:
        f = lines(frequencies)
        if self.interpolate and len(self.frequencies) > 1:
            return _between(f, self.frequencies, table, ON_A_LINE * _spacing(self.frequencies).min())
        return table[self._index(f)]

    def has_lines(self, frequencies: ArrayLike) -> NDArray[np.bool_]:
        """Which of some `frequencies` (Hz) are its own lines, shape (lines,); all of them where it interpolates."""
        f = lines(frequencies)
        return np.ones(len(f), bool) if self.interpolate else self._nearest(f)[1]

    def _nearest(self, f: NDArray) -> tuple[NDArray[np.int_], NDArray[np.bool_]]:
        """The line next to each frequency, and whether that is the frequency."""
        own = self.frequencies
        nearest = np.clip(np.searchsorted(own, f), 1, len(own) - 1) if len(own) > 1 else np.zeros(len(f), int)
        if len(own) > 1:
            nearest = nearest - (f - own[nearest - 1] < own[nearest] - f)
        return nearest, np.abs(f - own[nearest]) <= ON_A_LINE * _spacing(own)[nearest]

    def _index(self, f: NDArray) -> NDArray[np.int_]:
        own, (nearest, there) = self.frequencies, self._nearest(f)
        off = ~there
        if np.any(off):
            k = int(np.argmax(off))
            raise InputError(
                "a frequency that is no line of the table",
                where="FrfModel",
                found=f"{f[k]:.9g} Hz" + (f" and {int(off.sum()) - 1} others" if off.sum() > 1 else ""),
                expected=f"one of its {len(own)} lines; the nearest is {own[nearest[k]]:.9g} Hz",
                hint="ask at model.frequencies, or build it with interpolate=True where the lines are dense enough",
            )
        return nearest

    def refuse(self, method: str, family: str | None = None) -> NoReturn:
        """Refuse a method that a table does not have, and say what does."""
        try:
            super().refuse(method, family)
        except InputError as error:
            raise InputError(
                error.what,
                where=error.where,
                found=error.found,
                expected=error.expected,
                hint=Advice(error.hint, "; " if error.hint and ADVICE.get(method) else "", ADVICE.get(method, "")),
            ) from None


# -- checks -----------------------------------------------------------------------------------------------------------
_BETWEEN = "spacing of the lines, Hz"


def _between_lines(own: NDArray) -> Flag:
    step = float(_spacing(own).max())
    return Flag(
        "W211",
        Evidence(_BETWEEN, step),
        f"between its lines, up to {step:.4g} Hz apart, the FRF is interpolated linearly",
        "trust it where many lines lie on each peak and each antiresonance; measure the lines that you need otherwise",
    )


def _ascending(frequencies: ArrayLike) -> NDArray[np.float64]:
    f = lines(frequencies)
    if len(f) == 0 or np.any(np.diff(f) <= 0):
        k = int(np.argmax(np.diff(f) <= 0)) if len(f) else 0
        raise InputError(
            "the lines do not ascend" if len(f) else "no lines",
            where="frequencies",
            found=f"{f[k]:.9g} Hz before {f[k + 1]:.9g} Hz" if len(f) else "an empty list",
            expected="Hz, ascending, each line once",
            hint="sort the lines together with the FRF" if len(f) else "",
        )
    return f


def _table(name: str, values: ArrayLike, shape: tuple[int, ...], kind: type = float) -> Any:
    """Read-only finite copy of this shape; powers are not negative."""
    where = f"FrfModel, {name}"
    try:
        raw = np.asarray(plain(values))
        if kind is float and np.iscomplexobj(raw):
            raise TypeError("complex numbers")
        found: NDArray[Any] = np.array(raw, kind)
    except (TypeError, ValueError) as error:
        raise InputError("no numbers", where=where, found=str(error)[:200], expected="an array of numbers") from None
    if found.shape != shape or not found.size:
        axes = "(lines, sensors, loads)" if len(shape) == 3 else "(lines, sensors)"
        raise InputError(
            "lines, channels and table do not fit",
            where=where,
            found=f"shape {found.shape}",
            expected=f"{axes} = {shape}",
            hint="lines come first, then sensors, then loads",
        )
    if not np.all(np.isfinite(found)):
        raise InputError(
            "NaN or infinity",
            where=where,
            found=f"{int(np.sum(~np.isfinite(found)))} of {found.size}",
            expected="finite numbers",
            hint="leave out the lines that are not known",
        )
    if kind is float and (np.any(found < 0) or (name == "coherence" and np.any(found > 1 + 1e-9))):
        raise InputError(
            "a coherence outside 0 to 1" if name == "coherence" else "a negative power",
            where=where,
            found=f"{found.min():.6g} to {found.max():.6g}",
            expected="0 to 1" if name == "coherence" else ">= 0",
        )
    found.flags.writeable = False
    return found


def _check_labels(model: FrfModel) -> None:
    for name, own in (("sensors", model.sensors), ("loads", model.loads)):
        labels = [c.label for c in own]
        if len(set(labels)) != len(labels):
            raise InputError(
                f"labels of {name} are not unique", where="FrfModel", found=labels, expected="one name each"
            )


def _spacing(own: NDArray) -> NDArray[np.float64]:
    """Distance of each line to its nearer neighbour; a single line is measured by itself."""
    if len(own) == 1:
        return np.maximum(own, 1.0)
    step = np.diff(own)
    return np.minimum(np.concatenate([step[:1], step]), np.concatenate([step, step[-1:]]))


def _between(f: NDArray, own: NDArray, table: NDArray, slack: float) -> NDArray:
    if np.any((f < own[0] - slack) | (f > own[-1] + slack)):
        raise InputError(
            "a frequency outside the lines of the table",
            where="FrfModel",
            found=f"{f.min():.6g} to {f.max():.6g} Hz",
            expected=f"{own[0]:.6g} to {own[-1]:.6g} Hz",
            hint="nothing is extrapolated",
        )
    right = np.clip(np.searchsorted(own, f), 1, len(own) - 1)
    weight = np.clip((f - own[right - 1]) / (own[right] - own[right - 1]), 0.0, 1.0)[:, None, None]
    return (1 - weight) * table[right - 1] + weight * table[right]


def _cube(H: NDArray) -> NDArray:
    return H.reshape(H.shape + (1,) * (3 - H.ndim))
