"""ForwardModel: structure x sensors x loads, in every form that an inverse method asks for."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from . import krylov, placing
from .bases.basis import Basis
from .damping import loss_factor
from .direct import direct
from .discretise import check, discretise, markov
from .errors import InputError
from .factor import Factor
from .krylov import Krylov, ReductionError
from .loads import Load, near_support
from .model import Model
from .modes import DENSE, Modes, modal_damping, modes
from .reduction import ReducedModel, highpass, static_residual
from .statespace import StateSpace, count, digest, lines
from .structure import Structure
from .values import positive, shown

DEFAULT_MODES = 60  # of a large structure
BAND_FACTOR = 2.5  # modes up to this multiple of the band: with the residual, a per cent of error on the worst lines
BLIND = 1e-9  # share of a rigid mode in a row or column that is rounding
REDUCTIONS = ("modes", "krylov")


class ForwardModel(Model):
    """Everything that maps the loads on a structure to what its sensors read.

    Static responses come from one factorisation of the stiffness; dynamic ones from its modes with the static residual
    of the modes left out. The residual counts in every row of `frf`; in the time domain it is a feedthrough of
    displacement and strain, while velocity and acceleration take the retained modes alone (a feedthrough has no finite
    derivative). With ``reduction="krylov"`` a rational Krylov basis takes the place of the modes: a few vectors that
    hold the response of the whole `band` to the loads that the model has, to a stated error (`reduction_error`).

    Parameters
    ----------
    structure : Structure
    sensors, loads : sequence
        From `structures.sensors` and `structures.loads`.
    modes : int, optional
        Number of modes; by default all of a structure with at most 400 free DOFs, else as many as `band` needs, or 60.
    residual : bool
        Add the static residual of the modes left out.
    band : float, optional
        Highest frequency of interest (Hz): modes are kept up to 2.5 times it, a Krylov basis is made for it.
    reduction : ``"modes"`` or ``"krylov"``
        Modes serve any number of loads and any damping, with per cents of error near antiresonances. Krylov: every
        entry to a millionth up to `band` (or to the rounding of a very fine mesh), for at most 40 loads or sensors,
        whichever are fewer, that stay in place, and for damping that is a matrix or structural. Time responses hold
        for loads within the band.

    Raises
    ------
    InputError
        If a sensor or a load is none, has no place on the structure, or shares its label; or if a Krylov reduction
        lacks its band or does not serve the structure.
    NotIdentifiable
        From `static()` of a structure that is not supported: it names the free rigid-body motion.
    """

    def __init__(
        self,
        structure: Structure,
        sensors: Sequence[Any],
        loads: Sequence[Any],
        *,
        modes: int | None = None,
        residual: bool = True,
        band: float | None = None,
        reduction: str = "modes",
    ) -> None:
        if not isinstance(structure, Structure):
            raise InputError(
                "no structure",
                where="ForwardModel",
                found=shown(structure),
                expected="a Structure",
                hint="build one with beams, plates, chains or Structure.from_matrices",
            )
        self.structure = structure
        self.sensors = placing.placed(sensors, "row", "sensors")
        self.basis = loads if isinstance(loads, Basis) else None
        self.loads = placing.placed(loads, "column", "loads", "columns")
        size = structure.free.size
        if modes is not None and not (
            isinstance(modes, int | np.integer) and not isinstance(modes, bool) and 1 <= modes <= size
        ):
            raise InputError(
                "no such number of modes",
                where="modes",
                found=repr(modes),
                expected=f"1..{size}",
                hint="leave modes out: band= in Hz chooses them",
            )
        if band is not None:
            band = positive("band", band, where="ForwardModel", unit="Hz")
        self._settings: dict[str, Any] = {
            "modes": None if modes is None else int(modes),
            "residual": bool(residual),
            "band": band,
            "reduction": reduction,
        }
        self._S = placing.rows(structure, self.sensors)
        self._derivative = np.array([int(getattr(s, "derivative", 0)) for s in self.sensors])
        self._corner = np.array([s.highpass or 0.0 for s in self.sensors])
        self._columns = placing.columns(structure, self.loads if self.basis is None else self.basis)
        self._check_reduction()
        found = near_support(structure, [p for p in self.loads if isinstance(p, Load)])
        self.flags = (*getattr(structure.field, "flags", ()), *(() if found is None else (found,)))

    def __repr__(self) -> str:
        n = self.structure.free.size
        s = self._settings
        if s["reduction"] == "krylov":
            kept = f"Krylov basis to {s['band']:g} Hz"
            if "krylov" in self.__dict__:
                kept += f", {self.krylov.projection.theta.size} vectors, error {self.krylov.estimate:.1e}"
        elif s["modes"] is None and s["band"] and n > DENSE and "modes" not in self.__dict__:
            kept = f"modes up to {BAND_FACTOR:g} x {s['band']:g} Hz"
        else:
            k = len(self.modes.lam) if "modes" in self.__dict__ else self._wanted()
            kept = f"all {n} modes" if k == n else f"{k} of {n} modes"
        whole = s["reduction"] == "krylov" or kept.startswith("all")
        rest = " + static residual" if s["residual"] and not whole else ""
        return f"ForwardModel({n} free DOFs, {len(self.sensors)} sensors, {len(self.loads)} loads, {kept}{rest})"

    # -- parts ----------------------------------------------------------------------------------------------------
    @property
    def moving(self) -> bool:
        """A load moves over the structure."""
        return not sparse.issparse(self._columns)

    @cached_property
    def factor(self) -> Factor:
        """Factor of the stiffness; ``factor.solves`` counts its right-hand sides."""
        return Factor.of(self.structure)

    def _wanted(self) -> int:
        n = self.structure.free.size
        if self._settings["modes"] is not None:
            return self._settings["modes"]
        return n if n <= DENSE else min(DEFAULT_MODES, n)

    @cached_property
    def modes(self) -> Modes:
        """The modes that the model retains.

        Raises
        ------
        InputError
            If it is reduced to a Krylov basis.
        """
        self._reduced_to("modes", "modes")
        n, k, band = self.structure.free.size, self._wanted(), self._settings["band"]
        found = modes(self.structure, k)
        while band is not None and self._settings["modes"] is None and k < n:
            if found.frequencies[-1] >= BAND_FACTOR * band:
                k = int(np.searchsorted(found.frequencies, BAND_FACTOR * band)) + 1
                return Modes(found.lam[:k], found.phi[:, :k], min(found.rigid, k), found.shift, found.factor)
            k = min(2 * k, n)
            found = modes(self.structure, k)
        return found

    @cached_property
    def krylov(self) -> Krylov:
        """The Krylov basis of the model.

        Raises
        ------
        InputError
            If it is reduced to modes, or its tolerance is not reached.
        """
        self._reduced_to("krylov", "Krylov basis")
        return krylov.krylov(self.structure, self._S, self._columns, self._settings["band"])

    @property
    def _shapes(self) -> Modes:
        """Modes, or the Ritz pairs in their place."""
        return self.modes if self._settings["reduction"] == "modes" else self.krylov.shapes

    @cached_property
    def reduced(self) -> ReducedModel:
        """The model in modal coordinates."""
        shapes = self._shapes
        S, B = self._S @ shapes.phi, self._project(shapes.phi)
        # A strain gauge sees no rigid motion, a self-balanced load drives none: zero, not rounding.
        r = shapes.rigid
        S[:, :r][np.abs(S[:, :r]) < BLIND * np.abs(S).max(axis=1, keepdims=True)] = 0.0
        B[..., :r, :][np.abs(B[..., :r, :]) < BLIND * np.abs(B).max(axis=-2, keepdims=True)] = 0.0
        residual = None
        left_out = len(shapes.lam) < self.structure.free.size
        if left_out and self._settings["residual"] and self._settings["reduction"] == "modes":
            if not self.moving:
                static = self._static_rows if shapes.shift == 0 else None
                residual = static_residual(shapes, self._S, self._columns, S, B, static)
            else:
                full = shapes.factor.solve(self._S.T.toarray()).T
                residual = np.einsum("sn,tnp->tsp", full, self._columns) - (S / (shapes.lam - shapes.shift)) @ B
        damping, loss = modal_damping(self.structure, shapes), loss_factor(self.structure.damping)
        return ReducedModel(shapes.lam, damping, S, B, residual, self._derivative, self._corner, loss)

    def _project(self, phi: NDArray) -> NDArray[np.float64]:
        if not self.moving:
            return np.asarray(self._columns.T @ phi).T
        return np.einsum("nk,tnp->tkp", phi, self._columns, optimize=True)

    @cached_property
    def _static_rows(self) -> NDArray[np.float64]:
        """``S K^-1 B`` of every row, before derivatives and filters."""
        return self.factor.transfer(self._S, self._columns)

    # -- the contract ---------------------------------------------------------------------------------------------
    def static(self) -> NDArray[np.float64]:
        """Static transfer matrix (sensors, loads), by min(sensors, loads) solves.

        Zero for velocity, acceleration and AC-coupled sensors: they see no constant load.

        Raises
        ------
        NotIdentifiable
            If the structure is not supported (LID-E116): it names the motion left free.
        InputError
            If a load moves.
        """
        self._fixed("static")
        blind = (self._derivative > 0) | (self._corner > 0)
        return np.where(blind[:, None], 0.0, self._static_rows)

    def frf(self, frequencies: ArrayLike, method: str = "modal") -> NDArray[np.complex128]:
        """Frequency response at `frequencies` (Hz), shape (lines, sensors, loads).

        Parameters
        ----------
        frequencies : array (lines,)
        method : ``"modal"`` or ``"direct"``
            Modal: from the reduced model. Direct: one factorisation of ``K - omega^2 M + i omega C`` per line, exact
            and slow. A structural loss factor counts in ``K (1 + i eta)`` above 0 Hz.

        Raises
        ------
        NotIdentifiable
            If a line lies on a natural frequency without damping, or at 0 Hz where the structure is free (LID-E116).
        InputError
            If a load moves, a frequency is negative or above the band of a Krylov basis, or the structure has no mass
            or is unstable.

        Notes
        -----
        Mode displacement with residual flexibility: R. R. Craig, A. J. Kurdila, *Fundamentals of Structural Dynamics*,
        2nd ed. (2006), chapters 11 and 17.
        """
        self._fixed("frf")
        f = lines(frequencies)
        if method == "modal":
            self._within(f)
            return self.reduced.frf(f)
        if method == "direct":
            H = direct(self.structure, self._S, self._columns, f, lambda: self._shapes)
            return H * self._reading(f)[:, :, None]
        raise InputError(
            "no such method",
            where="frf",
            found=repr(method),
            expected="'modal' or 'direct'",
            hint="modal is the quick one",
        )

    def reduction_error(self, frequencies: ArrayLike) -> ReductionError:
        """Bound of the error that the Krylov reduction makes in `frf`, for every line and entry.

        Parameters
        ----------
        frequencies : array (lines,)
            Hz, within the band.

        Returns
        -------
        ReductionError
            Absolute and relative, entry by entry (antiresonances included) and line by line.

        Raises
        ------
        InputError
            If the model is reduced to modes, or a line lies above the band.

        Notes
        -----
        Both residuals of the projection, that of the load and that of the sensor, times what resonates outside the
        basis, and the rounding of the matrices; see `structures.galerkin`.
        """
        f = lines(frequencies)
        basis = self.krylov
        self._within(f)
        H, *parts = basis.projection.errors(2 * np.pi * f)
        truncation, rounding, size = (np.abs(self._reading(f))[:, :, None] * x for x in (*parts, np.abs(H)))
        return ReductionError(f, truncation, rounding, size)

    def impulse_response(self, dt: float, samples: int, hold: str = "foh") -> NDArray[np.float64]:
        """Response to one unit held over one sample (samples, sensors, loads): the Markov parameters of `state_space`.

        The unit is a hat over two samples under the first-order hold, a step of one sample under the zero-order hold.

        Raises
        ------
        InputError
            If the step, the hold or the number of samples is none, a load moves, the damping is structural, or the
            structure has no mass.
        """
        check(dt, hold)
        self._fixed("impulse_response")
        self.reduced.refuse_time("impulse_response")
        if self.reduced.proportional:
            return markov(self.reduced, float(dt), hold, count(samples))
        return self.state_space(dt, hold).impulse_response(dt, samples)

    def state_space(self, dt: float, hold: str = "foh") -> StateSpace:
        """Discrete state space at step `dt` (s), exact under the hold; a load that moves gives B(t) and D(t).

        Raises
        ------
        InputError
            If the step or the hold is none, a load moves at another step, the damping is structural, or the structure
            has no mass.

        Notes
        -----
        Exponential of the augmented matrix: C. F. Van Loan, "Computing integrals involving the matrix exponential",
        IEEE Trans. Automatic Control 23 (1978) 395-404.
        """
        check(dt, hold)
        for load in self.loads:
            own = getattr(load, "dt", None)
            if self.moving and own is not None and abs(own - dt) > 1e-9 * dt:
                raise InputError(
                    "the load moves at another step",
                    where=f"load {load.label}",
                    found=dt,
                    expected=f"dt={own:g}",
                    hint="resample its path",
                )
        self.reduced.refuse_time("state_space")
        return StateSpace(*discretise(self.reduced, float(dt), hold), dt, hold, sensors=self.sensors, loads=self.loads)

    def predict(self, load: ArrayLike, dt: float, hold: str | None = None) -> NDArray[np.float64]:
        """Response (samples, sensors) to a load history (samples, loads), at rest before its first sample.

        Raises
        ------
        InputError
            If the load does not fit the model, or as `state_space`.
        """
        if self.moving:
            return self.state_space(dt, hold or self.default_hold).simulate(load)
        return super().predict(load, dt, hold)

    def perturbed(self, parameter: str, factor: float) -> ForwardModel:
        """The same model with one parameter multiplied: ``stiffness``, ``mass``, ``damping`` or its own.

        Raises
        ------
        InputError
            If the structure has no such parameter or the factor is not positive.
        """
        loads = self.loads if self.basis is None else self.basis
        return ForwardModel(self.structure.scaled(parameter, factor), self.sensors, loads, **self._settings)

    def with_loads(self, loads: Sequence[Any]) -> ForwardModel:
        """The same structure and sensors under other loads; modes and factor are shared, so that moving one is cheap.

        A Krylov basis is that of its loads: it is made anew.

        Raises
        ------
        InputError
            As `ForwardModel`, for loads that do not fit the structure.
        """
        other = ForwardModel(self.structure, self.sensors, loads, **self._settings)
        other.__dict__.update({name: self.__dict__[name] for name in ("factor", "modes") if name in self.__dict__})
        other.certificate = self.certificate
        return other

    @property
    def natural_frequencies(self) -> NDArray[np.float64] | None:
        """Natural frequencies (Hz) that the model retains, ascending, 0 for rigid-body modes; None without mass."""
        if self.structure.M_free is None:
            return None
        return self.modes.frequencies if self._settings["reduction"] == "modes" else self.krylov.frequencies

    @property
    def decay_rate(self) -> float | None:
        """Slowest decay rate (1/s) that a sensor sees; None without mass."""
        return None if self.structure.M_free is None else self.reduced.decay_rate

    @property
    def fingerprint(self) -> str:
        """Sha256 of the structure, the rows and columns with their channels, and the settings."""
        settings = list(self._settings.values())
        settings = settings[: len(settings) - (settings[-1] == "modes")]  # modes are what models without a choice have
        parts = (*placing.arrays(self._S), self._derivative, *placing.arrays(self._columns))
        return digest("ForwardModel", self.structure.digest, *parts, self.sensors, self.loads, *settings)

    # -- inside ---------------------------------------------------------------------------------------------------
    def _fixed(self, method: str) -> None:
        if self.moving:
            names = [load.label for load in self.loads if hasattr(load, "columns")]
            raise InputError(
                f"a load that moves has no {method}()",
                where="ForwardModel",
                found=f"moving loads {names}",
                expected="loads that stay in place",
                hint="state_space() carries B(t); predict() simulates",
            )

    def _check_reduction(self) -> None:
        """Refuse a reduction that is none, or that cannot serve this model."""
        s = self._settings
        if s["reduction"] not in REDUCTIONS:
            raise InputError(
                "no such reduction",
                where="reduction",
                found=shown(s["reduction"]),
                expected="'modes' or 'krylov'",
                hint="leave it out: modes and their static residual",
            )
        if s["reduction"] == "modes":
            return
        if s["band"] is None or s["modes"] is not None:
            raise InputError(
                "a Krylov basis is made for a band, not for a number of modes",
                where="reduction='krylov'",
                found=f"band={s['band']}, modes={s['modes']}",
                expected="band= in Hz, no modes=",
                hint="pass the highest frequency of interest as band=",
            )
        self._fixed("Krylov reduction")
        krylov.refuse(self.structure, len(self.sensors), len(self.loads))

    def _reduced_to(self, reduction: str, what: str) -> None:
        if self._settings["reduction"] != reduction:
            raise InputError(
                f"the model is reduced by {self._settings['reduction']}: it has no {what}",
                where="ForwardModel",
                found=f"reduction={self._settings['reduction']!r}",
                expected=f"reduction={reduction!r}",
                hint="build the model with it" + (", and with band=" if reduction == "krylov" else ""),
            )

    def _within(self, f: NDArray) -> None:
        """Refuse lines above the band of a Krylov basis: nothing is known of its error there."""
        band = self._settings["band"]
        if self._settings["reduction"] == "krylov" and len(f) and f.max() > band * (1 + 1e-9):
            raise InputError(
                "a line lies above the band of the Krylov basis",
                where="frequencies",
                found=f"{f.max():.6g} Hz",
                expected=f"at most {band:g} Hz",
                hint="build the model with a higher band=",
            )

    def _reading(self, f: NDArray) -> NDArray[np.complex128]:
        """What every sensor makes of a displacement (lines, sensors): its derivative and its high-pass."""
        return (2j * np.pi * f[:, None]) ** self._derivative * highpass(f, self._corner)
