"""Forward model from a table: FRFs on any set of lines, a band of a sweep or the lines that a shaker excites."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._advice import Advice
from .._certificate import Certificate
from .._channels import Channel
from .._flags import Flag
from .._model import Model
from .._testing import kinds, reciprocity
from .._testing.frfs import of_spectra, tabulated
from ..errors import InputError, as_array, digest, lines, plain
from ..files import _storage as storage
from .lines import BETWEEN, ascending, checked, cube, index_of, interpolated, interpolation_flag, nearest, one_name_each

if TYPE_CHECKING:
    from .._testing.reciprocity import FrfFault
    from .._testing.welch import CrossSpectra


Table = NDArray[Any]
FILE = "table of FRFs"
ADVICE = {
    "static": "MatrixModel takes a measured static matrix; ForwardModel computes one",
    "impulse_response": "MeasuredModel.from_frf takes an FRF on a uniform grid from 0 Hz to the Nyquist frequency",
    "state_space": "fit modes to the FRF and give ForwardModel the structure",
}


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
    file: ClassVar[str] = FILE  # the kind of file that `save` writes
    tables: ClassVar[tuple[str, ...]] = ("H", "variance", "coherence")  # lines first, then sensors
    powers: ClassVar[tuple[str, ...]] = ("variance",)  # those that go with the square of the response
    others: ClassVar[tuple[str, ...]] = ("frequencies", "sensors", "loads", "certificate", "interpolate")
    interpolate: bool = False

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
        where = type(self).__name__
        self.sensors, self.loads = tuple(sensors), tuple(loads)
        self.frequencies = self._lines(frequencies)
        rows = (len(self.frequencies), len(self.sensors))
        self.H = checked("H", H, (*rows, len(self.loads)), where=where, kind=complex)
        self.variance = None if variance is None else checked("variance", variance, self.H.shape, where=where)
        self.coherence = None if coherence is None else checked("coherence", coherence, rows, where=where)
        self.certificate, self.interpolate = certificate, bool(interpolate)
        one_name_each(self.sensors, self.loads, where)
        if not np.any(self.H):
            raise InputError("no load moves any sensor", where=where, found="zeros on every line", expected="an FRF")
        known = [f for f in flags if f.evidence.name != BETWEEN]
        self.flags = (*known, *([interpolation_flag(self.frequencies)] if interpolate else []))

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
        table = cube(as_array(H, where="from_frf, H"))
        rows, flags = kinds.rows(sensors, table.shape[1], kind)
        columns = [
            c if isinstance(c, Channel) else Channel(label=str(c), quantity="force", unit="N")
            for c in (loads or [f"load {j + 1}" for j in range(table.shape[2])])
        ]
        spread = None if variance is None else cube(as_array(variance, where="from_frf, variance"))
        made = cls(frequencies, table, sensors=rows, loads=columns, variance=spread, coherence=coherence, flags=flags)
        return made._between(interpolate).judged()

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
        window: str | tuple[Any, ...] = "hann",
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
            As `structures._testing.frfs.estimate` describes them.
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
        made = cls(**tabulated(records, forces, responses, kind, least_coherence, estimator, cut))
        return made._between(interpolate).judged()

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
        made = cls(**of_spectra(spectra, forces, responses, kind, least_coherence, estimator))
        return made._between(interpolate).judged()

    @classmethod
    def of(cls, model: Model, frequencies: ArrayLike) -> Self:
        """Table of another model's FRFs at some lines (Hz), with their variance where it has one.

        Raises
        ------
        InputError
            Where the model has no `frf`, or none at these lines.
        """
        f = ascending(frequencies)
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
        variances = [m.variance for m in models if m.variance is not None]
        made = cls(
            first.frequencies,
            np.concatenate([m.H for m in models], axis=2),
            sensors=first.sensors,
            loads=[c for m in models for c in m.loads],
            variance=np.concatenate(variances, axis=2) if len(variances) == len(models) else None,
            flags=tuple(dict.fromkeys(f for m in models for f in m.flags)),
        )
        made = made._between(all(m.interpolate for m in models))
        return made if made.sampled else made._like(flags=(*made._given_flags, *made._reciprocal()))

    @classmethod
    def _lines(cls, frequencies: ArrayLike) -> NDArray[np.float64]:
        """The lines of a model of this kind, checked."""
        return ascending(frequencies)

    def judged(self) -> Self:
        """The same model with what its phases tell, W207 or N207, and W216 where it is not reciprocal."""
        found = kinds.lines(self.frequencies, self.H, self.sensors, self.loads)
        known = [f for f in self.flags if f.code not in ("LID-W207", "LID-N207", "LID-W216")]
        return self._like(flags=(*known, *found, *self._reciprocal()))

    def _reciprocal(self) -> tuple[Flag, ...]:
        return reciprocity.flags(self.frequencies, self.H, self.sensors, self.loads, self.variance)

    @property
    def fault(self) -> FrfFault | None:
        """What explains that the table is not reciprocal; None where it is, or where no two places have both.

        Sensors and loads share a place where their labels name the same DOF (``12+Z``).
        """
        return reciprocity.check(self.frequencies, self.H, self.sensors, self.loads, self.variance)

    def corrected(self, fault: FrfFault | None = None) -> Self:
        """The same model without a fault, default the one that it shows; not yet verified.

        Raises
        ------
        InputError
            No fault, one that no factor and no exchange mends, or one of several that explain it as well, where it
            is not given.
        """
        found = fault or self.fault
        if found is None or (fault is None and not found.certain):
            raise InputError(
                "no fault is known" if found is None else "several faults explain it", where="corrected",
                found="reciprocal FRFs, or no place that has both sensor and load" if found is None else str(found),
                expected="one fault", hint="nothing to correct" if found is None else "corrected(model.fault) takes "
                "the first; or mend what is known to be wrong",
            )  # fmt: skip
        labels = [s.label for s in self.sensors], [c.label for c in self.loads]
        spread = None if self.variance is None else found.corrected(self.variance, *labels, power=2)
        again = [f for f in self._given_flags if f.code != "LID-W216"]
        made = self._like(H=found.corrected(self.H, *labels), variance=spread, certificate=None, flags=again)
        return made.judged()

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
            index = index_of(ascending(wanted), self.frequencies)
        return self._like(frequencies=self.frequencies[index], **self._each(lambda x: x[index]))

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
        return self._like(
            H=self.H * factor[..., None],
            **self._each(lambda x: x * (size if x.ndim == 2 else size[..., None]), self.powers),
            sensors=[kinds.convert(s, kind) for s in self.sensors],
            certificate=self._certified(f"it was converted to {kind}"),
            flags=tuple(dict.fromkeys([*self._given_flags, *([] if self.sampled else lost)])),
        )

    def perturbed(self, parameter: str, factor: float) -> Self:
        """The same model with its gain multiplied by `factor`; nothing else of a table has a name."""
        if parameter != "gain":
            raise InputError(
                "a model of measured FRFs has no such parameter",
                where="perturbed",
                found=repr(parameter),
                expected="'gain'",
            )
        return self._like(H=self.H * factor, variance=None if self.variance is None else self.variance * factor**2)

    def with_sensors(self, rows: Sequence[int] | NDArray[np.intp]) -> Self:
        """The same model with some of its sensors, in the order given, and not yet verified."""
        rows = np.asarray(rows, np.intp)
        kept = [self.sensors[i] for i in rows]
        return self._like(sensors=kept, certificate=None, **self._each(lambda x: x[:, rows]))

    def _each(self, change: Callable[[Table], Table], names: Sequence[str] = ()) -> dict[str, Table | None]:
        """Its tables, or some, each changed; None where one is not known."""
        own = {name: getattr(self, name) for name in names or self.tables}
        return {name: None if x is None else change(x) for name, x in own.items()}

    def _like(self, **changes: Any) -> Self:
        """The same model with other arguments."""
        same = {name: getattr(self, name) for name in (*self.tables, *self.others)}
        return type(self)(**{**same, "flags": self._given_flags, **changes})

    def _between(self, interpolate: bool) -> Self:
        return self._like(interpolate=True) if interpolate else self

    def _certified(self, change: str) -> Certificate | None:
        """Its certificate, which speaks of the model before a change."""
        known = self.certificate
        return known and replace(known, source=f"{known.source} (before {change})")

    @property
    def _given_flags(self) -> tuple[Flag, ...]:
        """Flags that no constructor finds again."""
        return tuple(f for f in self.flags if not (self.sampled and f.code in ("LID-W207", "LID-W216")))

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
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model to HDF5, whole or not at all, with checksums."""
        flags = [f.to_dict() for f in self._given_flags]
        storage.write(path, {**self._arguments(), "flags": flags, **self._as_stored()}, self.file)

    def _arguments(self) -> dict[str, Any]:
        """What a file keeps of its arguments, beside channels, certificate and flags."""
        return {name: getattr(self, name) for name in ("frequencies", *self.tables, "interpolate")}

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a model that `save` wrote.

        Raises
        ------
        InputError
            A damaged file, or one of another kind.
        """
        tree = storage.read(path, cls.file)
        return cls(
            sensors=[Channel(**c) for c in tree.pop("sensors")],
            loads=[Channel(**c) for c in tree.pop("loads")],
            flags=[Flag.from_dict(f) for f in tree.pop("flags")],
            certificate=Certificate.stored(tree.pop("certificate")),
            **cls._restored(tree),
        )

    @classmethod
    def _restored(cls, tree: dict[str, Any]) -> dict[str, Any]:
        """Arguments of what `_arguments` gave."""
        return tree

    def __repr__(self) -> str:
        f = self.frequencies
        band = f"{f[0]:.6g} to {f[-1]:.6g} Hz" if len(f) > 1 else f"{f[0]:.6g} Hz"
        return f"FrfModel({len(self.sensors)} sensors, {len(self.loads)} loads, {len(f)} lines, {band})"

    # -- lines ------------------------------------------------------------------------------------------------------
    def _read(self, table: Table, frequencies: ArrayLike) -> Table:
        f = lines(frequencies)
        if self.interpolate and len(self.frequencies) > 1:
            return interpolated(f, self.frequencies, table)
        return table[index_of(f, self.frequencies)]

    def has_lines(self, frequencies: ArrayLike) -> NDArray[np.bool_]:
        """Which of some `frequencies` (Hz) are its own lines, shape (lines,); all of them where it interpolates."""
        f = lines(frequencies)
        return np.ones(len(f), bool) if self.interpolate else nearest(f, self.frequencies)[1]

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
