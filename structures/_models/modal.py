"""Forward model from a modal test: measured modes in place of a structure that nobody has modelled."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from .._certificate import Certificate
from .._channels import Channel
from .._flags import Flag
from .._model import Model
from .._system.factor import MECHANISM
from .._testing.modalshapes import ComplexFit, NormalFit, ShapeFit
from ..errors import InputError, NotIdentifiable, count, digest, lines
from ..files import _storage as storage
from .discretise import check, discretise, markov
from .reduction import ReducedModel, highpass
from .statespace import StateSpace
from .viscous import ComplexModes

FILE = "modal model"  # what its file calls itself
REDUCED = ("lam", "damping", "S", "B", "derivative", "corner")
VISCOUS = ("poles", "shapes", "participation", "derivative", "corner")
ERRORS = tuple(ShapeFit.__dataclass_fields__)


class ModalModel(Model):
    """Modes of a test as a forward model: natural frequencies, damping, shapes at its sensors and loads.

    Shapes are real, as those of a structure with proportional damping, or complex, as those of any other.
    What modes outside the band give inside it is carried by a few resonators beyond its ends, so that frequency
    responses, impulse responses and state space are those of one system. Outside the band nothing was measured.

    Parameters
    ----------
    reduced : ReducedModel
        Modes, then the resonators that stand for those outside the band; these alone where shapes are complex.
    sensors, loads : sequence of Channel
    modes : int
        How many of `reduced`, or of `viscous`, are modes of the structure: the first ones.
    band : tuple of float
        First and last line (Hz) of the test.
    viscous : ComplexModes, optional
        Modes with complex shapes.
    errors : ShapeFit, optional
        Errors of the fit, as `structures._testing.modalshapes` knows them; None for a model that was changed.
    rows, columns : array of int, optional
        Which outputs and references of the fit its sensors and loads are.
    turned : bool
        The fit took loads for outputs.
    kind : int
        Of the FRFs that were fitted: 0 receptance, 1 mobility, 2 accelerance.
    flags : sequence of Flag
    training : sequence of str
        Digests of the responses that it was made from.

    Raises
    ------
    InputError
        Sensors or loads that do not fit the modes.
    """

    def __init__(
        self,
        reduced: ReducedModel,
        sensors: Sequence[Channel],
        loads: Sequence[Channel],
        *,
        modes: int,
        band: tuple[float, float],
        viscous: ComplexModes | None = None,
        errors: ShapeFit | None = None,
        rows: Sequence[int] | NDArray[np.intp] | None = None,
        columns: Sequence[int] | NDArray[np.intp] | None = None,
        turned: bool = False,
        kind: int = 0,
        flags: Sequence[Flag] = (),
        training: Sequence[str] = (),
    ) -> None:
        self.sensors, self.loads = tuple(sensors), tuple(loads)
        if reduced.S.shape[0] != len(self.sensors) or reduced.B.shape[1] != len(self.loads):
            raise InputError("channels do not fit the modes", where="ModalModel",
                             found=f"{len(self.sensors)} sensors, {len(self.loads)} loads",
                             expected=f"{reduced.S.shape[0]} and {reduced.B.shape[1]}")  # fmt: skip
        self._reduced, self._modes, self.band = reduced, int(modes), (float(band[0]), float(band[1]))
        self.viscous = viscous
        self._errors, self._turned, self._kind = errors, bool(turned), int(kind)
        self._rows = np.arange(len(self.sensors)) if rows is None else np.asarray(rows, np.intp)
        self._columns = np.arange(len(self.loads)) if columns is None else np.asarray(columns, np.intp)
        self.flags, self._training = tuple(flags), tuple(training)

    def __repr__(self) -> str:
        f = self.natural_frequencies
        span = f", {f[0]:.5g} to {f[-1]:.5g} Hz" if len(f) else ""
        return f"ModalModel({len(f)} modes{span}, {len(self.sensors)} sensors, {len(self.loads)} loads)"

    # -- the contract -----------------------------------------------------------------------------------------------
    @property
    def reduced(self) -> ReducedModel | None:
        """The modes and the resonators outside the band, in modal coordinates; None where shapes are complex."""
        return self._reduced if self.viscous is None else None

    @property
    def natural_frequencies(self) -> NDArray[np.float64]:
        """Natural frequencies (Hz) of the modes, ascending; the resonators outside the band are none."""
        w = np.sqrt(self._reduced.lam) if self.viscous is None else np.abs(self.viscous.poles)
        return np.sort(w[: self._modes]) / (2 * np.pi)

    @property
    def decay_rate(self) -> float:
        """Slowest decay rate (1/s) of its free motion."""
        own = self._reduced.decay_rate if len(self._reduced.lam) else np.inf
        return own if self.viscous is None else float(min(own, np.min(-self.viscous.poles.real)))

    def static(self) -> NDArray[np.float64]:
        """Response to a load at rest (sensors, loads): 0 of velocity, acceleration and AC-coupled sensors.

        It lies below the band of the test, and rests on the resonators that stand for the modes above it.

        Raises
        ------
        NotIdentifiable
            If a displacement or strain was measured on a structure that moves as a whole (LID-E116).
        """
        r = self._reduced
        blind = (r.derivative > 0) | (r.corner > 0)
        first = self._modes if self.viscous is None else 0
        free = (r.lam[first:] < (2 * np.pi * self.band[0]) ** 2) & np.any(r.B[first:] != 0, axis=1)
        if free.any() and not blind.all():
            raise NotIdentifiable(
                "the modes below the band are not known: no response at rest",
                advice="lower the first line of the test, or use the dynamic response", code=MECHANISM,
            )  # fmt: skip
        own = 0.0 if self.viscous is None else self.viscous.static()
        return np.where(blind[:, None], 0.0, (r.S / r.lam) @ r.B + own)

    def frf(self, frequencies: ArrayLike) -> NDArray[np.complex128]:
        """Frequency response at `frequencies` (Hz), shape (lines, sensors, loads); measured inside `band` alone."""
        f = lines(frequencies)
        own = self._reduced.frf(f)
        return own if self.viscous is None else own + self.viscous.frf(f)

    def frf_variance(self, frequencies: ArrayLike) -> NDArray[np.float64] | None:
        """Variance of the FRF by the errors of poles, shapes and residuals, shape (lines, sensors, loads)."""
        if self._errors is None:
            return None
        f, r = lines(frequencies), self._reduced
        out = self._sized(self._errors, f)
        integrated = r.derivative < self._kind
        if integrated.any():  # no displacement is known from accelerations at 0 Hz: its error is held below the band
            out[:, integrated] = self._sized(self._errors, np.maximum(f, self.band[0]))[:, integrated]
        return np.asarray(out * np.abs(highpass(f, r.corner))[:, :, None] ** 2)

    def _sized(self, errors: ShapeFit, f: NDArray[np.float64]) -> NDArray[np.float64]:
        """Variance of the FRF at f (Hz) in the kind of each sensor, before high-passes; inf where that has none."""
        whole = errors.variance(f, self._kind)
        whole = whole.transpose(0, 2, 1) if self._turned else whole
        order = self._reduced.derivative - self._kind
        with np.errstate(divide="ignore", invalid="ignore"):
            size = (2 * np.pi * f[:, None]) ** (2.0 * order)
            return np.asarray(whole[:, self._rows][:, :, self._columns] * size[:, :, None])

    def impulse_response(self, dt: float, samples: int, hold: str = "foh") -> NDArray[np.float64]:
        """Response to one unit held over one sample (samples, sensors, loads).

        Raises
        ------
        InputError
            If the step, the hold or the number of samples is none.
        """
        if self.viscous is not None:
            return self.state_space(dt, hold).impulse_response(dt, samples)
        check(dt, hold)
        return markov(self._reduced, float(dt), hold, count(samples))

    def state_space(self, dt: float, hold: str = "foh") -> StateSpace:
        """Discrete state space at step `dt` (s), exact under the hold.

        Raises
        ------
        InputError
            If the step or the hold is none.
        """
        check(dt, hold)
        made = discretise(self._reduced, float(dt), hold)
        if self.viscous is not None:
            A, B, C, D = self.viscous.discrete(float(dt), hold)
            made = linalg.block_diag(made[0], A), np.vstack([made[1], B]), np.hstack([made[2], C]), made[3] + D
        return StateSpace(*made, dt, hold, sensors=self.sensors, loads=self.loads)

    def perturbed(self, parameter: str, factor: float) -> ModalModel:
        """The same modes with ``stiffness``, ``mass``, ``damping`` or ``gain`` multiplied by `factor`.

        Raises
        ------
        InputError
            A parameter that it does not have, or a factor that is not positive.
        """
        r = self._reduced
        moved = {
            "stiffness": lambda: replace(r, lam=r.lam * factor),
            "mass": lambda: replace(r, lam=r.lam / factor, damping=r.damping / factor, B=r.B / factor),
            "damping": lambda: replace(r, damping=r.damping * factor),
            "gain": lambda: replace(r, S=r.S * factor),
        }
        if parameter not in moved or not np.isfinite(factor) or factor <= 0:
            raise InputError("no such change of a modal model", where="perturbed",
                             found=f"{parameter!r} times {factor!r}",
                             expected=f"{', '.join(moved)}, times a positive number")  # fmt: skip
        viscous = None if self.viscous is None else self.viscous.perturbed(parameter, factor)
        return self._like(moved[parameter](), viscous=viscous, errors=None)

    def with_sensors(self, rows: Sequence[int] | NDArray[np.intp]) -> ModalModel:
        """The same model with some of its sensors, in the order given."""
        kept, r = np.asarray(rows, np.intp), self._reduced
        some = replace(r, S=r.S[kept], derivative=r.derivative[kept], corner=r.corner[kept])
        v = self.viscous
        if v is not None:
            v = replace(v, shapes=v.shapes[kept], derivative=v.derivative[kept], corner=v.corner[kept])
        return self._like(some, sensors=[self.sensors[i] for i in kept], rows=self._rows[kept], viscous=v)

    def under(
        self,
        loads: Sequence[Channel],
        tested: Sequence[int | None],
        normal: NDArray[np.float64],
        viscous: NDArray[np.complex128],
    ) -> ModalModel:
        """The same sensors under other loads.

        Parameters
        ----------
        loads : sequence of Channel
        tested : sequence of int or None
            Which load of the test each is; None for one that was not driven: the resonators outside the band do not
            know it.
        normal, viscous : array (modes, loads)
            Participations of loads that were not driven, in real and in complex modes; the others are not read.
        """
        r, v = self._reduced, self.viscous
        B = np.zeros((len(r.lam), len(loads)))
        L = np.zeros((0 if v is None else len(v.poles), len(loads)), complex)
        for j, i in enumerate(tested):
            if v is not None:
                L[:, j] = v.participation[:, i] if i is not None else 0
                L[: self._modes, j] = viscous[:, j] if i is None else L[: self._modes, j]
            if i is not None:
                B[:, j] = r.B[:, i]
            elif v is None:
                B[: self._modes, j] = normal[:, j]
        known = all(i is not None for i in tested)
        columns = self._columns[[i for i in tested if i is not None]] if known else range(len(loads))
        return self._like(
            replace(r, B=B), loads=loads, columns=columns, viscous=None if v is None else replace(v, participation=L),
            errors=self._errors if known else None,
        )  # fmt: skip

    def with_flags(self, flags: Sequence[Flag]) -> ModalModel:
        """The same model with these flags."""
        return self._like(self._reduced, flags=flags)

    def _like(self, reduced: ReducedModel, **changes: Any) -> ModalModel:
        same: dict[str, Any] = {
            "sensors": self.sensors, "loads": self.loads, "modes": self._modes, "band": self.band,
            "viscous": self.viscous, "errors": self._errors, "rows": self._rows, "columns": self._columns,
            "turned": self._turned, "kind": self._kind, "flags": self.flags, "training": self._training,
        }  # fmt: skip
        return ModalModel(reduced, **{**same, **changes})

    @property
    def training(self) -> frozenset[str]:
        """Digests of the responses that it was made from."""
        return frozenset(self._training)

    @property
    def fingerprint(self) -> str:
        """Sha256 of modes, resonators and channels."""
        own = [] if self.viscous is None else [getattr(self.viscous, name) for name in VISCOUS[:3]]
        return digest("ModalModel", *(getattr(self._reduced, name) for name in REDUCED), *own, self.sensors, self.loads)

    # -- files ------------------------------------------------------------------------------------------------------
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model to HDF5, whole or not at all, with checksums; `modelfile.load_model` reads it."""
        errors = None if self._errors is None else {name: getattr(self._errors, name) for name in ERRORS}
        settings = {
            "modes": self._modes, "band": list(self.band), "rows": self._rows, "columns": self._columns,
            "turned": self._turned, "kind": self._kind, "training": list(self._training),
        }  # fmt: skip
        reduced = {name: getattr(self._reduced, name) for name in REDUCED}
        viscous = None if self.viscous is None else {name: getattr(self.viscous, name) for name in VISCOUS}
        flags = [f.to_dict() for f in self.flags]
        content = {"reduced": reduced, "viscous": viscous, "errors": errors, **settings, "flags": flags}
        storage.write(path, {**content, **self._as_stored()}, FILE)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> ModalModel:
        """Read a model that `save` wrote.

        Raises
        ------
        InputError
            A damaged file, or one of another kind.
        """
        tree = storage.read(path, FILE)
        try:
            sensors, loads = ([Channel(**c) for c in tree[name]] for name in ("sensors", "loads"))
            viscous = None if tree["viscous"] is None else ComplexModes(**tree["viscous"])
            fit = NormalFit if viscous is None else ComplexFit
            errors = None if tree["errors"] is None else fit(**tree["errors"])
            settings = {k: tree[k] for k in ("modes", "rows", "columns", "turned", "kind", "training")}
            made = cls(
                ReducedModel(**tree["reduced"], residual=None), sensors, loads, band=tuple(tree["band"]),
                viscous=viscous, errors=errors, flags=[Flag.from_dict(f) for f in tree["flags"]], **settings,
            )  # fmt: skip
        except (KeyError, TypeError, ValueError) as error:
            raise InputError("its content is not what this release expects", where=str(path),
                             found=f"{type(error).__name__}: {error}",
                             hint="read it with the release that wrote it") from error  # fmt: skip
        made.certificate = Certificate.stored(tree["certificate"])
        return made
