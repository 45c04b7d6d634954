"""The forward-model contract: what every family may ask, and how a model refuses what it cannot give."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any, ClassVar, NoReturn, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._certificate import Certificate, bad_load, verified
from ._channels import CHANNEL, Channel
from ._flags import Flag
from ._readonly import ReadOnly
from .errors import InputError, digest, frozen, shown

ASKED = (1e-2, 1e-3, 1e-4, 1e-5)  # steps in s at which a model that has none of its own is asked who it is


class Model(ReadOnly):
    """A map from loads to responses. Subclasses override what they can give; the rest refuses by name.

    A model of one's own sets `sensors` and `loads` and overrides one of `static`, `frf`, `impulse_response` and
    `state_space`. Everything else that the families ask has an answer here. None means "not known", never "no".

    Shapes: time or frequency first, then sensors, then loads. Units are those of the channels.

    Attributes
    ----------
    sensors, loads : tuple of Channel
        Rows and columns.
    certificate : Certificate or None
        Outcome of the last `verify`.
    flags : tuple of Flag
        What the guards of the forward model found when it was built.
    dt : float or None
        The only step (s) at which it has histories; None: any.
    frequencies : array (lines,) or None
        Lines (Hz) of the table that it is; None where its `frf` is a formula.
    sampled : bool
        Its FRFs were estimated from sampled records up to half their rate: `frf` is the transform of
        `impulse_response`, knows no hold, and carries errors (`frf_variance`, `noise_spectrum`).
    samples : int or None
        Length that its impulse response is known to have.
    hits : tuple
        Tests that it was estimated from.
    gain_covariance : array (sensors, sensors) or None
        Of the relative gains of such tests, as their repeats show it.
    structure : Structure or None
        What carries the sensors and the loads, as they are; then `factor`, `reduced` and `shapes` are there too.
    basis : Basis or None
        The load basis that its loads are the coefficients of.
    """

    sensors: tuple[Channel, ...]
    loads: tuple[Channel, ...]
    certificate: Certificate | None = None
    flags: tuple[Flag, ...] = ()
    dt: float | None = None
    frequencies: NDArray[np.float64] | None = None
    sampled: bool = False
    samples: int | None = None
    hits: tuple[Any, ...] = ()
    gain_covariance: NDArray[np.float64] | None = None
    structure: Any = None
    basis: Any = None
    serves: ClassVar[dict[str, str]] = {
        "static": "StaticInversion",
        "frf": "FrequencyInversion",
        "impulse_response": "Deconvolution",
        "state_space": "LoadTracker",
    }

    # -- the contract ---------------------------------------------------------------------------------------------
    def static(self) -> NDArray[np.float64]:
        """Static transfer matrix, shape (sensors, loads).

        Units of the sensor over units of the load.

        Raises
        ------
        InputError
            If a model of this kind has none; it names the families that can run on it.
        """
        self.refuse("static")

    def frf(self, frequencies: ArrayLike) -> NDArray[np.complex128]:
        """Frequency response at `frequencies` (Hz), shape (lines, sensors, loads).

        Units of the sensor over units of the load; the sign of time is exp(+i omega t).

        Raises
        ------
        InputError
            If a model of this kind has none; it names the families that can run on it.
        """
        self.refuse("frf")

    def frf_variance(self, frequencies: ArrayLike) -> NDArray[np.float64] | None:
        """Variance E|error|^2 of `frf` at `frequencies` (Hz), shape (lines, sensors, loads); None where not known."""
        return None

    def noise_spectrum(self, frequencies: ArrayLike) -> NDArray[np.float64] | None:
        """Mean squared residual of the tests per sample of record (lines, sensors); None where not known."""
        return None

    def has_lines(self, frequencies: ArrayLike) -> NDArray[np.bool_]:
        """Which of some `frequencies` (Hz) it answers at, shape (lines,); a formula answers at all."""
        return np.ones(np.shape(frequencies), bool)

    def impulse_response(self, dt: float, samples: int, hold: str = "foh") -> NDArray[np.float64]:
        """Response to one unit held over one sample, shape (samples, sensors, loads).

        The Markov parameters of `state_space`, where a model gives that alone.

        Parameters
        ----------
        dt : float
            Step in s.
        samples : int
        hold : ``"foh"`` or ``"zoh"``
            The load is linear between its samples, or constant over each.

        Raises
        ------
        InputError
            If a model of this kind has none; it names the families that can run on it.
        """
        self.require("impulse_response")
        found: NDArray[np.float64] = self.state_space(dt, hold).impulse_response(dt, samples)
        return found

    def state_space(self, dt: float, hold: str = "foh") -> Any:
        """Discrete state space at step `dt` (s).

        Raises
        ------
        InputError
            If a model of this kind has none; it names the families that can run on it.
        """
        self.refuse("state_space")

    def perturbed(self, parameter: str, factor: float) -> Self:
        """A model of the same kind with one parameter multiplied by `factor`.

        Raises
        ------
        InputError
            If a model of this kind has none; it names the families that can run on it.
        """
        self.refuse("perturbed")

    def with_loads(self, loads: Sequence[Any]) -> Self:
        """The same structure and sensors under other loads.

        Raises
        ------
        InputError
            If a model of this kind has none.
        """
        self.refuse("with_loads")

    def with_sensors(self, rows: Sequence[int] | NDArray[np.intp]) -> Self:
        """A model of the same kind with some of its sensors, in the order given.

        Raises
        ------
        InputError
            If a model of this kind has none.
        """
        self.refuse("with_sensors")

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model to a file, whole or not at all.

        Raises
        ------
        InputError
            If a model of this kind is not kept in a file.
        """
        raise InputError(
            f"{type(self).__name__} is not kept in a file",
            where="save",
            found=type(self).__name__,
            expected="ForwardModel, StateSpace, MeasuredModel or FrfModel",
            hint="keep what it is made of, and build it from that",
        )

    # -- what it is -----------------------------------------------------------------------------------------------
    @property
    def moving(self) -> bool:
        """Whether a load moves: only `state_space` and `predict` carry that."""
        return False

    @property
    def radius(self) -> float:
        """Largest modulus of an eigenvalue of a discrete model: above 1 it is unstable; 0 where it is stable."""
        return 0.0

    @property
    def factor(self) -> Any:
        """Factor of the stiffness of its `structure`; None without one."""
        return None

    @property
    def reduced(self) -> Any:
        """The model in modal coordinates, a `ReducedModel`; None where it has none."""
        return None

    @property
    def shapes(self) -> Any:
        """Modes of its `structure` that `reduced` is made of, a `Modes`; None where it has none."""
        return None

    @property
    def described(self) -> str:
        """What training sets drawn for it name beside its fingerprint, where that tells more than they depend on."""
        return ""

    @property
    def training(self) -> frozenset[str]:
        """Digests (`structures.errors.digests`) of the responses that it was made from."""
        return frozenset()

    @property
    def noise(self) -> NDArray[np.float64] | None:
        """Noise std per sensor (sensors,) or covariance (sensors, sensors); None when not all are known."""
        stds = [s.noise for s in self.sensors]
        return None if any(s is None for s in stds) else np.array(stds, dtype=float)

    @property
    def natural_frequencies(self) -> NDArray[np.float64] | None:
        """Natural frequencies (Hz) that the model retains, ascending; None where a model has no modes."""
        return None

    @property
    def decay_rate(self) -> float | None:
        """Slowest decay rate zeta*omega (1/s) of the model; None when not known."""
        return None

    @property
    def fingerprint(self) -> str:
        """Sha256 (hex) of what the model is made of: two models with the same digest are the same model.

        Where a model does not say what it is made of, of its class, its channels and its answers to a few questions.
        """
        return digest(type(self).__qualname__, self.sensors, self.loads, self.dt, *self._answers())

    def gives(self, method: str) -> bool:
        """Whether a model of this kind has a method of the contract, by its name: ``model.gives("state_space")``."""
        own = getattr(type(self), method) is not getattr(Model, method)
        return own or (method == "impulse_response" and self.gives("state_space"))

    def require(self, *methods: str, family: str | None = None) -> None:
        """Nothing, where the model gives one of some methods.

        Parameters
        ----------
        *methods : str
            Names of methods of the contract; the refusal speaks of the first one.
        family : str, optional
            What asks, for the message.

        Raises
        ------
        InputError
            If it gives none of them; it names the families that can run on the model.
        """
        if not any(self.gives(method) for method in methods):
            self.refuse(methods[0], family)

    def refuse(self, method: str, family: str | None = None) -> NoReturn:
        """Refuse a method that a model of this kind does not have.

        Raises
        ------
        InputError
            Always; it names the families that can run on the model.
        """
        can = [served for name, served in self.serves.items() if self.gives(name)]
        family = family or self.serves.get(method)
        raise InputError(
            f"{type(self).__name__} has no {method}()" + (f": {family} cannot run on it" if family else ""),
            where="forward model",
            found=type(self).__name__,
            expected=f"a model that gives {method}()",
            hint=f"families that can run on this model: {', '.join(can) or 'none'}",
        )

    def _answers(self) -> Iterator[NDArray[Any]]:
        """What it says when it is asked who it is; a question that it does not answer is left out."""
        lines = np.array([1 / (20 * dt) for dt in ASKED]) if self.frequencies is None else self.frequencies[:8]
        steps = ASKED if self.dt is None else (self.dt,)
        questions: dict[str, list[Any]] = {
            "static": [()], "frf": [(lines,)], "impulse_response": [(dt, 8, self.default_hold) for dt in steps],
        }  # fmt: skip
        for method, given in questions.items():
            for arguments in given if self.gives(method) else ():
                try:
                    with np.errstate(all="ignore"):
                        yield np.asarray(getattr(self, method)(*arguments))
                except Exception:  # whatever a class of somebody else raises far from its own steps and lines
                    continue

    def verify(
        self, load: ArrayLike, response: ArrayLike, dt: float | None = None, *, source: str = "a known load"
    ) -> Certificate:
        """Check the model against a known load, and keep the certificate.

        Parameters
        ----------
        load : array, shape (loads,) for a static check, (samples, loads) or (samples,) with `dt`
        response : array, shape (sensors,), or (samples, sensors)
        dt : float, optional
            Step in s; without it the check is static.
        source : str
            What the load was: "hanging mass 2.0 kg", "hit 5".

        Returns
        -------
        Certificate
            Also kept as ``model.certificate``, so that it travels in every estimate.

        Raises
        ------
        InputError
            If load or response do not fit the model, hold NaN or are zero; or if the model has no `static`, or no
            `impulse_response`, at this step.
        NotIdentifiable
            From `static` of a structure that is not supported.
        """
        self.certificate = verified(self, load, response, dt, source)
        return self.certificate

    # -- shared ---------------------------------------------------------------------------------------------------
    @property
    def default_hold(self) -> str:
        """Hold that `predict` uses when none is named."""
        return "foh"

    def predict(self, load: ArrayLike, dt: float, hold: str | None = None) -> NDArray[np.float64]:
        """Response (samples, sensors) to a load history (samples, loads), at rest before its first sample.

        Parameters
        ----------
        load : array (samples, loads), or (samples,) for one load
        dt : float
            Step in s.
        hold : ``"foh"`` or ``"zoh"``, optional
            How the load runs between its samples; `default_hold` where not given.

        Raises
        ------
        InputError
            If the load does not fit the model or holds NaN, or the model has no `impulse_response` at this step.
        """
        load = frozen(load, "load")
        load = load[:, None] if load.ndim == 1 else load
        if load.ndim != 2 or load.shape[1] != len(self.loads) or len(load) == 0:
            raise bad_load(self, "predict", f"shape {load.shape}", "(samples, loads)")
        h = impulse_of(self, dt, len(load), hold or self.default_hold)
        return convolved(h, load)

    def _as_stored(self) -> dict[str, Any]:
        """Channels and certificate, as a file keeps them; refuses loads that move."""
        if self.moving:
            raise InputError(
                "a load that moves is not kept in a file",
                where="modelfile.save",
                found=type(self).__name__,
                expected="a ForwardModel or a StateSpace whose loads stay in place",
                hint="keep its path as a table, and build the model from it",
            )
        return {
            "sensors": [{k: getattr(c, k) for k in CHANNEL} for c in self.sensors],
            "loads": [{k: getattr(c, k) for k in CHANNEL} for c in self.loads],
            "certificate": None if self.certificate is None else asdict(self.certificate),
        }


def convolved(h: ArrayLike, load: ArrayLike) -> NDArray[np.float64]:
    """Response (samples, sensors) of pulses h (taps, sensors, loads) to a load (samples, loads), of its length."""
    from scipy import fft

    taps, force = np.asarray(h, float), np.asarray(load, float)
    length = fft.next_fast_len(len(taps) + len(force) - 1, real=True)
    each = (fft.rfft(taps[:, :, j], length, axis=0) * fft.rfft(force[:, j, None], length, axis=0)
            for j in range(force.shape[1]))  # fmt: skip
    lines = sum(each, start=np.zeros((length // 2 + 1, taps.shape[1]), complex))
    return np.ascontiguousarray(fft.irfft(lines, length, axis=0)[: len(force)])


def as_model(given: Any, where: str, *methods: str) -> Model:
    """What was given, where it is a forward model that gives one of some methods of the contract.

    Parameters
    ----------
    given : Model
    where : str
        What asks.
    *methods : str
        Names of methods; none: any model will do.

    Raises
    ------
    InputError
        If it derives from no `Model`, or gives none of the methods.
    """
    if isinstance(given, Model):
        for name in ("sensors", "loads"):
            channels = getattr(given, name, None)
            if not isinstance(channels, tuple | list) or not all(isinstance(c, Channel) for c in channels):
                raise InputError(
                    f"{type(given).__name__} does not say what its {name} are", where=where,
                    found=f"{name} = {shown(channels)}", expected="a tuple of structures.Channel",
                    hint=f'self.{name} = (Channel(label="a", quantity="arbitrary"),)',
                )  # fmt: skip
        if methods:
            given.require(*methods, family=where)
        return given
    raise InputError(
        "no forward model",
        where=where,
        found=shown(given),
        expected="a structures.Model, such as ForwardModel or StateSpace",
        hint="a class of your own derives from structures.Model and overrides what it can give",
    )


def impulse_of(model: Model, dt: float, samples: int, hold: str) -> NDArray[np.float64]:
    """Impulse response (samples, sensors, loads) of a model, held against its channels.

    Raises
    ------
    InputError
        If it is no such array.
    """
    h = np.asarray(model.impulse_response(dt, samples, hold))
    if h.ndim != 3 or h.shape[1:] != (len(model.sensors), len(model.loads)):
        raise InputError(
            f"impulse_response() of {type(model).__name__} does not fit its channels", where="forward model",
            found=f"shape {h.shape}", expected=f"shape {(samples, len(model.sensors), len(model.loads))}",
            hint="samples first, then sensors, then loads",
        )  # fmt: skip
    return h
