"""A model under combinations of its loads: other unknowns, the same sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .channels import Channel
from .errors import InputError
from .model import Model
from .statespace import StateSpace, channels
from .values import digest, reals


class MappedModel(Model):
    """A model whose loads are ``g = T u``: its unknowns u are combinations of the loads.

    Fewer columns than loads make a low-order basis of them (mode shapes, say); a square T changes the variables, as a
    spatial prior does.

    Parameters
    ----------
    model : Model
        What it gives, this one gives too.
    T : array (loads, unknowns)
    labels : sequence of str or Channel, optional
        Names of the unknowns; those of the loads where T is square, else ``u0, u1, ...``.

    Raises
    ------
    InputError
        If T does not fit, or holds NaN.
    """

    def __init__(self, model: Model, T: ArrayLike, labels: Sequence[str | Channel] | None = None) -> None:
        self.model, self.T = model, reals(T, where="MappedModel", what="the combinations are no matrix of real numbers")
        loads = len(model.loads)
        if self.T.ndim != 2 or self.T.shape[0] != loads or 0 in self.T.shape or not np.all(np.isfinite(self.T)):
            raise InputError("the combinations do not fit the loads", where="MappedModel",
                             found=f"shape {self.T.shape}", expected=f"finite, ({loads}, unknowns)",
                             hint="one row per load")  # fmt: skip
        self.T.flags.writeable = False
        self.sensors, self.certificate, self.flags = model.sensors, model.certificate, model.flags
        self.dt, self.frequencies = model.dt, model.frequencies
        square = self.T.shape[1] == loads and labels is None
        self.loads = model.loads if square else channels(labels, self.T.shape[1], "u", "unknowns")

    def __repr__(self) -> str:
        return f"MappedModel({self.T.shape[1]} unknowns of {self.model!r})"

    def static(self) -> NDArray[np.float64]:
        """As that of the model, (sensors, unknowns)."""
        return self.model.static() @ self.T

    def frf(self, frequencies: ArrayLike) -> NDArray[np.complex128]:
        """As that of the model, (lines, sensors, unknowns)."""
        return self.model.frf(frequencies) @ self.T

    def frf_variance(self, frequencies: ArrayLike) -> NDArray[np.float64] | None:
        """As that of the model, errors of its FRFs taken as independent; None where it states none."""
        found = self.model.frf_variance(frequencies)
        return None if found is None else found @ self.T**2

    def noise_spectrum(self, frequencies: ArrayLike) -> NDArray[np.float64] | None:
        """That of the model."""
        return self.model.noise_spectrum(frequencies)

    def has_lines(self, frequencies: ArrayLike) -> NDArray[np.bool_]:
        """As the model."""
        return self.model.has_lines(frequencies)

    def impulse_response(self, dt: float, samples: int, hold: str | None = None) -> NDArray[np.float64]:
        """As that of the model, (samples, sensors, unknowns)."""
        return self.model.impulse_response(dt, samples, hold or self.default_hold) @ self.T

    def state_space(self, dt: float, hold: str | None = None) -> StateSpace:
        """As that of the model, driven by the unknowns."""
        s: Any = self.model.state_space(dt, hold or self.default_hold)
        return StateSpace(s.A, s.B @ self.T, s.C, s.D @ self.T, dt, s.hold, sensors=self.sensors, loads=self.loads)

    def gives(self, method: str) -> bool:
        """As the model, where combinations of its loads have the method."""
        return super().gives(method) and self.model.gives(method)

    def refuse(self, method: str, family: str | None = None) -> NoReturn:
        """Refuse a method in the name of the model, where it is the model that has none."""
        if not self.model.gives(method):
            self.model.refuse(method, family)
        super().refuse(method, family)

    @cached_property
    def reduced(self) -> Any:
        """As that of the model, driven by the unknowns."""
        own = self.model.reduced
        if own is None:
            return None
        return replace(own, B=own.B @ self.T, residual=None if own.residual is None else own.residual @ self.T)

    @property
    def moving(self) -> bool:
        """As the model."""
        return self.model.moving

    @property
    def radius(self) -> float:
        """That of the model."""
        return self.model.radius

    @property
    def training(self) -> frozenset[str]:
        """As the model."""
        return self.model.training

    @property
    def default_hold(self) -> str:
        """That of the model."""
        return self.model.default_hold

    @property
    def noise(self) -> NDArray[np.float64] | None:
        """That of the model."""
        return self.model.noise

    @property
    def natural_frequencies(self) -> NDArray[np.float64] | None:
        """Those of the model."""
        return self.model.natural_frequencies

    @property
    def decay_rate(self) -> float | None:
        """That of the model."""
        return self.model.decay_rate

    @property
    def fingerprint(self) -> str:
        """Sha256 of the model and the combinations."""
        return digest("MappedModel", self.model.fingerprint, self.T, self.loads)


def mapped(model: Model, T: ArrayLike, labels: Sequence[str | Channel] | None = None) -> MappedModel:
    """A model under the combinations T of its loads.

    Raises
    ------
    InputError
        As `MappedModel`.
    """
    return MappedModel(model, T, labels)
