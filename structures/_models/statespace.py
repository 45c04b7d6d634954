"""Discrete state space: matrices at one step and one hold, and everything that they answer."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._channels import named
from .._model import Model
from .._system.factor import MECHANISM
from ..errors import InputError, NotIdentifiable, count, digest, frozen, lines
from ..files import _storage as storage
from .discretise import check, own

FILE = "state space"  # what its file calls itself
BLOCK = 64  # Markov parameters per matrix product
ON_POLE = 1e-13  # distance of a line from an eigenvalue, on the unit circle, that is rounding
STABLE = 1 + 1e-6  # largest |eigenvalue|: rounding moves the double pole of a free body by the root of 1e-16
SINGULAR = 1e13  # condition of I - A above which there is no static response


class StateSpace(Model):
    """``x_{k+1} = A x_k + B u_k``, ``y_k = C x_k + D u_k``.

    Parameters
    ----------
    A : array (nx, nx)
    B : array (nx, loads), or (samples, nx, loads) for loads that move
    C : array (sensors, nx)
    D : array (sensors, loads), or (samples, sensors, loads)
    dt : float
        Step in s.
    hold : ``"zoh"`` or ``"foh"``
        How the load runs between its samples: what B and D were made for.
    sensors, loads : sequence of Channel or str, optional
        What the rows and columns are; ``y0, y1, ...`` and ``u0, ...`` by default.

    Raises
    ------
    InputError
        If shapes do not fit, a number is not finite, or the step or the hold is none.
    """

    dt: float

    def __init__(
        self,
        A: ArrayLike,
        B: ArrayLike,
        C: ArrayLike,
        D: ArrayLike,
        dt: float,
        hold: str = "zoh",
        *,
        sensors: Sequence[Any] | None = None,
        loads: Sequence[Any] | None = None,
    ) -> None:
        check(dt, hold)
        self.A, self.B, self.C, self.D = (frozen(x, name) for x, name in ((A, "A"), (B, "B"), (C, "C"), (D, "D")))
        self.dt, self.hold = float(dt), hold
        self._check_shapes()
        self.sensors = named(sensors, self.C.shape[0], "y", "sensors")
        self.loads = named(loads, self.B.shape[-1], "u", "loads")

    def _check_shapes(self) -> None:
        shapes = {name: getattr(self, name).shape for name in "ABCD"}
        A, B, C, D = shapes.values()
        fits = (
            len(A) == len(C) == 2
            and len(B) in (2, 3)
            and len(D) in (2, 3)
            and A[0] == A[1] == B[-2] == C[1]
            and D[-2:] == (C[0], B[-1])
            and (len(B) == 2 or len(D) == 2 or B[0] == D[0])
            and min(C[0], B[-1]) > 0
        )
        if not fits:
            raise InputError(
                "the matrices do not fit each other",
                where="StateSpace",
                found=", ".join(f"{name} {shape}" for name, shape in shapes.items()),
                expected="A (nx, nx), B (nx, loads), C (sensors, nx), D (sensors, loads); B and D may be led by time",
                hint="D of zeros where no load passes straight through",
            )

    def __repr__(self) -> str:
        moving = ", moving loads" if self.moving else ""
        return (
            f"StateSpace({len(self.A)} states, {len(self.sensors)} sensors, {len(self.loads)} loads, "
            f"dt={self.dt:g} s, hold={self.hold!r}{moving})"
        )

    @property
    def moving(self) -> bool:
        """B or D change with time."""
        return self.B.ndim == 3 or self.D.ndim == 3

    @property
    def default_hold(self) -> str:
        """The hold that the matrices were made for."""
        return self.hold

    def static(self) -> NDArray[np.float64]:
        """Static gain ``C (I - A)^-1 B + D`` (sensors, loads).

        Raises
        ------
        NotIdentifiable
            If a rigid-body motion or an integrator never settles.
        InputError
            If the model is unstable or its loads move.
        """
        self._refuse_moving("static")
        self._refuse_unstable("static")
        rest = np.eye(len(self.A)) - self.A
        if len(rest) and np.linalg.cond(rest) > SINGULAR:
            raise NotIdentifiable(
                f"a constant load never settles: I - A is singular (condition {np.linalg.cond(rest):.2g})",
                advice="support the structure, or use the dynamic response",
                code=MECHANISM,
            )
        return self.C @ np.linalg.solve(rest, self.B) + self.D

    def frf(self, frequencies: ArrayLike) -> NDArray[np.complex128]:
        """Frequency response of the sampled system, shape (lines, sensors, loads).

        Parameters
        ----------
        frequencies : array (lines,)
            Hz, up to Nyquist.

        Raises
        ------
        InputError
            If the model is unstable, its loads move, or a frequency lies above Nyquist.
        NotIdentifiable
            If an undamped pole lies on a line.

        Notes
        -----
        Schur form once, back substitution on every line: A. J. Laub, "Efficient multivariable frequency response
        computations", IEEE Trans. Automatic Control 26 (1981) 407-408.
        """
        from scipy.linalg import schur

        self._refuse_moving("frf")
        f = lines(frequencies, nyquist=0.5 / self.dt)
        z = np.exp(2j * np.pi * f * self.dt)
        self._refuse_unstable("frf")
        T, Q = schur(self.A, output="complex")
        B, C = Q.conj().T @ self.B, self.C @ Q
        H = np.broadcast_to(self.D.astype(complex), (len(f), *self.D.shape)).copy()
        step = max(1, 4_000_000 // max(1, len(T) * B.shape[1]))
        for a in range(0, len(f), step):
            # Back substitution on z I - T for many lines at once.
            zz = z[a : a + step, None]
            x = np.empty((len(T), len(zz), B.shape[1]), dtype=complex)
            for i in range(len(T) - 1, -1, -1):
                known = np.tensordot(T[i, i + 1 :], x[i + 1 :], axes=1)
                pivot = zz - T[i, i]
                if np.any(np.abs(pivot) <= ON_POLE):
                    line = f[a : a + step][int(np.argmin(np.abs(pivot[:, 0])))]
                    raise NotIdentifiable(
                        f"the response at {line:.6g} Hz is unbounded: an undamped pole lies there",
                        advice="leave the line out, or add damping",
                        code=MECHANISM,
                    )
                x[i] = (B[i] + known) / pivot
            H[a : a + step] += np.einsum("si,ilp->lsp", C, x, optimize=True)
        return H

    def impulse_response(self, dt: float, samples: int, hold: str | None = None) -> NDArray[np.float64]:
        """Markov parameters ``D, CB, CAB, ...`` (samples, sensors, loads); only at its own step and hold.

        Raises
        ------
        InputError
            At another step or hold, where loads move, or where an unstable model outgrows the numbers.
        """
        self._own(dt, hold, "impulse_response")
        self._refuse_moving("impulse_response")
        h = np.empty((count(samples), *self.D.shape))
        h[0] = self.D
        with np.errstate(over="ignore", invalid="ignore"):  # judged below
            # Rows C A^j of one block, then one product per block with the state that starts it.
            block = max(1, min(BLOCK, samples - 1))
            rows = np.empty((block, *self.C.shape))
            rows[0], power, known = self.C, self.A, 1
            while known < block:
                more = min(known, block - known)
                rows[known : known + more] = rows[:more] @ power
                power, known = power @ power, known + more
            jump = np.linalg.matrix_power(self.A, block)
            rows, x = rows.reshape(-1, len(self.A)), self.B
            for a in range(1, samples, block):
                part = (rows @ x).reshape(block, *self.D.shape)
                h[a : a + block] = part[: samples - a]
                x = jump @ x
        self._refuse_overflow(h, "impulse_response")
        return h

    def state_space(self, dt: float, hold: str | None = None) -> StateSpace:
        """Itself.

        Raises
        ------
        InputError
            At another step or hold.
        """
        self._own(dt, hold, "state_space")
        return self

    def simulate(self, load: ArrayLike, x0: ArrayLike | None = None) -> NDArray[np.float64]:
        """Response (samples, sensors) to a load history (samples, loads).

        Parameters
        ----------
        load : array (samples, loads), or (samples,) for one load
        x0 : array (nx,), optional
            State at the first sample; at rest by default.

        Raises
        ------
        InputError
            If a shape does not fit, a number is not finite, or an unstable model outgrows the numbers.
        """
        u = frozen(load, "load")
        u = u[:, None] if u.ndim == 1 and len(self.loads) == 1 else u
        length = next((len(M) for M in (self.B, self.D) if M.ndim == 3), None)
        if u.ndim != 2 or u.shape[1] != len(self.loads) or (length is not None and len(u) != length):
            raise InputError(
                "the load does not fit the model",
                where="simulate",
                found=f"shape {u.shape}",
                expected=f"({'samples' if length is None else length}, {len(self.loads)})",
                hint="one column per load, in the order of model.loads",
            )
        x = np.zeros(len(self.A)) if x0 is None else np.array(frozen(x0, "x0"))
        if x.shape != (len(self.A),):
            raise InputError(
                "the state does not fit",
                where="simulate",
                found=f"shape {x.shape}",
                expected=f"({len(self.A)},)",
                hint="leave x0 out to start at rest",
            )
        driven, direct = (np.einsum("...ij,...j->...i", M, u) for M in (self.B, self.D))
        states = np.empty((len(u), len(x)))
        with np.errstate(over="ignore", invalid="ignore"):  # judged below
            for k, push in enumerate(driven):
                states[k] = x
                x = self.A @ x + push
            response = states @ self.C.T + direct
        self._refuse_overflow(response, "simulate")
        return np.asarray(response)

    def predict(self, load: ArrayLike, dt: float, hold: str | None = None) -> NDArray[np.float64]:
        """Response (samples, sensors) to a load history (samples, loads), at rest before its first sample.

        Raises
        ------
        InputError
            At another step or hold, or as `simulate`.
        """
        self._own(dt, hold, "predict")
        return self.simulate(load)

    @cached_property
    def radius(self) -> float:
        """Largest modulus of an eigenvalue of A: above 1 the model is unstable; 0 without states."""
        return float(np.abs(np.linalg.eigvals(self.A)).max(initial=0.0))

    @property
    def decay_rate(self) -> float:
        """Slowest decay rate (1/s), from the eigenvalues; 0 where something never decays."""
        size = self.radius
        return float("inf") if size == 0 else max(0.0, -float(np.log(size)) / self.dt)

    @property
    def fingerprint(self) -> str:
        """Sha256 of the matrices, the step, the hold and the channels."""
        return digest("StateSpace", self.A, self.B, self.C, self.D, self.dt, self.hold, self.sensors, self.loads)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model to HDF5, whole or not at all, with checksums; `modelfile.load` reads it.

        Raises
        ------
        InputError
            A load that moves, a file that cannot be written.
        """
        matrices = {"A": self.A, "B": self.B, "C": self.C, "D": self.D}
        storage.write(path, {**matrices, "dt": self.dt, "hold": self.hold, **self._as_stored()}, FILE)

    def _own(self, dt: float, hold: str | None, method: str) -> None:
        what = f"a state space exists at one step and one hold only: {method}() cannot change them"
        own(self, dt, hold, what, "resample the record, or discretise the model again")

    def _refuse_unstable(self, method: str) -> None:
        if self.radius > STABLE:
            raise InputError(
                f"the model is unstable: it has no {method}(), because its response never settles",
                where="StateSpace",
                found=f"an eigenvalue of A of modulus {self.radius:.6g}",
                expected="at most 1",
                hint="check A, its step dt, and that it is discrete, not continuous; simulate() runs it all the same",
            )

    def _refuse_overflow(self, response: NDArray[Any], method: str) -> None:
        bad = ~np.isfinite(response).reshape(len(response), -1).all(axis=1)
        if np.any(bad):
            raise InputError(
                "the response outgrows the numbers",
                where=f"StateSpace.{method}",
                found=f"overflow at sample {int(np.argmax(bad))}, an eigenvalue of A of modulus {self.radius:.6g}",
                expected="a modulus of at most 1, or fewer samples",
                hint="check A, its step dt, and that it is discrete, not continuous",
            )

    def _refuse_moving(self, method: str) -> None:
        if self.moving:
            raise InputError(
                f"loads that move have no {method}(): B or D change with time",
                where="StateSpace",
                found="a time axis in B or D",
                expected="fixed loads",
                hint="simulate(), or a family that uses state_space()",
            )
