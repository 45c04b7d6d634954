"""ForwardModel: structure x sensors x loads, in every form that an inverse method asks for."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .._model import Model
from .._system.damping import Modal, causal, loss_factor
from .._system.factor import Factor
from .._system.loads import Load, near_support
from .._system.structure import Structure
from ..bases._basis import Basis
from ..errors import InputError, NotIdentifiable, count, digest, lines, shown
from ..files import _storage as storage
from . import assembly as placing
from . import assembly as reducing
from . import krylov
from .discretise import check, discretise, markov
from .krylov import Krylov, ReductionError
from .reduction import Modes, ReducedModel, highpass, modal_damping, modes, needs_mass, on_resonance, unbounded
from .statespace import StateSpace

FILE = "forward model"  # what its file calls itself
DENSE_DIRECT = 2000  # largest structure whose modal damping is written out as a matrix


def direct(
    structure: Any, S: Any, B: Any, frequencies: NDArray[np.float64], shapes: Callable[[], Modes]
) -> NDArray[np.complex128]:
    """Displacement response ``S (K - omega^2 M + i omega C)^-1 B``, shape (lines, sensors, loads).

    Parameters
    ----------
    structure : Structure
    S, B : sparse (sensors, n_free), (n_free, loads)
    frequencies : array (lines,)
        Hz.
    shapes : callable
        Gives modes where they are needed: for modal ratios, and to name a line on which the response is unbounded.

    Raises
    ------
    NotIdentifiable
        If a line lies on a natural frequency without damping, or at 0 Hz where the structure is free (LID-E116).
    InputError
        Without mass, or for modal ratios on more than 2000 DOFs.
    """
    needs_mass(structure, "frf")
    K, M, C = structure.K_free, structure.M_free, damping_matrix(structure, shapes)
    loss = loss_factor(structure.damping)
    H = np.empty((len(frequencies), S.shape[0], B.shape[1]), dtype=complex)
    for i, omega in enumerate(2 * np.pi * frequencies):
        if C.nnz == 0 and loss == 0 and on_resonance(omega, shapes().lam):
            raise unbounded(frequencies[i], shapes().lam)
        D = K * (1 + 1j * loss * (omega > 0)) - omega**2 * M + 1j * omega * C
        try:
            H[i] = Factor(D, check=False).transfer(S, B)
        except (InputError, NotIdentifiable) as error:
            raise unbounded(frequencies[i], shapes().lam) from error
    return H


def damping_matrix(structure: Any, shapes: Callable[[], Modes]) -> Any:
    """Damping on the free DOFs; that of modal ratios, ``M Phi diag(c) Phi^T M``, is full: small structures only.

    Raises
    ------
    InputError
        For modal ratios on more than 2000 DOFs.
    """
    if not isinstance(structure.damping, Modal):
        return sparse.csr_array(structure.K_free.shape) if structure.C_free is None else structure.C_free
    if structure.free.size > DENSE_DIRECT:
        raise InputError(
            "modal damping has no sparse matrix: no direct sweep of a large structure",
            where="frf(method='direct')",
            found=f"{structure.free.size} free DOFs",
            expected=f"at most {DENSE_DIRECT}",
            hint="method='modal', or Rayleigh damping",
        )
    found = shapes()
    every = found if len(found.lam) == structure.free.size else modes(structure)
    MPhi = structure.M_free @ every.phi
    return sparse.csr_array((MPhi * modal_damping(structure, every)) @ MPhi.T)


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
        From `structures._system.sensors` and `structures._system.loads`.
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
        self.settings = reducing.settled(structure, modes, residual, band, reduction)
        self._S = placing.rows(structure, self.sensors)
        self._derivative = np.array([int(getattr(s, "derivative", 0)) for s in self.sensors])
        self._corner = np.array([s.highpass or 0.0 for s in self.sensors])
        self.columns = placing.columns(structure, self.loads if self.basis is None else self.basis)
        if reduction == "krylov":
            self._fixed("Krylov reduction")
            krylov.refuse(structure, len(self.sensors), len(self.loads))
        found = near_support(structure, [p for p in self.loads if isinstance(p, Load)])
        self.flags = (*getattr(structure.field, "flags", ()), *(() if found is None else (found,)))

    def __repr__(self) -> str:
        n, known = self.structure.free.size, self.__dict__
        kept = reducing.described(self.settings, n, known.get("modes"), known.get("krylov"))
        return f"ForwardModel({n} free DOFs, {len(self.sensors)} sensors, {len(self.loads)} loads, {kept})"

    # -- parts ----------------------------------------------------------------------------------------------------
    @property
    def moving(self) -> bool:
        """A load moves over the structure."""
        return not sparse.issparse(self.columns)

    @cached_property
    def factor(self) -> Factor:
        """Factor of the stiffness; ``factor.solves`` counts its right-hand sides."""
        return Factor.of(self.structure)

    @cached_property
    def modes(self) -> Modes:
        """The modes that the model retains.

        Raises
        ------
        InputError
            If it is reduced to a Krylov basis.
        """
        reducing.needs(self.settings, "modes", "modes")
        return reducing.retained(self.structure, self.settings)

    @cached_property
    def krylov(self) -> Krylov:
        """The Krylov basis of the model.

        Raises
        ------
        InputError
            If it is reduced to modes, or its tolerance is not reached.
        """
        reducing.needs(self.settings, "krylov", "Krylov basis")
        return krylov.krylov(self.structure, self._S, self.columns, self.settings["band"])

    @property
    def shapes(self) -> Modes:
        """Modes, or the Ritz pairs in their place."""
        return self.modes if self.settings["reduction"] == "modes" else self.krylov.shapes

    @cached_property
    def reduced(self) -> ReducedModel:
        """The model in modal coordinates."""
        left_out = self.settings["residual"] and self.settings["reduction"] == "modes"
        return reducing.reduced(
            self.structure,
            self.shapes,
            self._S,
            self.columns,
            (self._derivative, self._corner),
            (lambda: self._static_rows) if left_out else None,
        )

    @cached_property
    def _static_rows(self) -> NDArray[np.float64]:
        """``S K^-1 B`` of every row, before derivatives and filters."""
        return self.factor.transfer(self._S, self.columns)

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
            reducing.within(self.settings, f)
            return self.reduced.frf(f)
        if method == "direct":
            H = direct(self.structure, self._S, self.columns, f, lambda: self.shapes)
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
        NotIdentifiable
            If the displacement is unbounded on a line, as in `frf`.

        Notes
        -----
        Both residuals of the projection, that of the load and that of the sensor, times what resonates outside the
        basis, and the rounding of the matrices; see `structures._models.galerkin`.
        """
        f = lines(frequencies)
        basis = self.krylov
        reducing.within(self.settings, f)
        replace(self.reduced, derivative=np.zeros_like(self._derivative)).frf(f)  # a line without bound is named
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
        causal(self.structure.damping, "impulse_response")
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
        causal(self.structure.damping, "state_space")
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
        return ForwardModel(self.structure.scaled(parameter, factor), self.sensors, loads, **self.settings)

    def with_loads(self, loads: Sequence[Any]) -> ForwardModel:
        """The same structure and sensors under other loads; modes and factor are shared, so that moving one is cheap.

        A Krylov basis is that of its loads: it is made anew.

        Raises
        ------
        InputError
            As `ForwardModel`, for loads that do not fit the structure.
        """
        other = ForwardModel(self.structure, self.sensors, loads, **self.settings)
        other.__dict__.update({name: self.__dict__[name] for name in ("factor", "modes") if name in self.__dict__})
        other.certificate = self.certificate
        return other

    @property
    def natural_frequencies(self) -> NDArray[np.float64] | None:
        """Natural frequencies (Hz) that the model retains, ascending, 0 for rigid-body modes; None without mass."""
        if self.structure.M_free is None:
            return None
        return self.modes.frequencies if self.settings["reduction"] == "modes" else self.krylov.frequencies

    @property
    def decay_rate(self) -> float | None:
        """Slowest decay rate (1/s) that a sensor sees; None without mass."""
        return None if self.structure.M_free is None else self.reduced.decay_rate

    @property
    def fingerprint(self) -> str:
        """Sha256 of the structure, the rows and columns with their channels, and the settings."""
        settings = list(self.settings.values())
        settings = settings[: len(settings) - (settings[-1] == "modes")]  # modes are what models without a choice have
        parts = (*_arrays(self._S), self._derivative, *_arrays(self.columns))
        return digest("ForwardModel", self.structure.digest, *parts, self.sensors, self.loads, *settings)

    # -- inside ---------------------------------------------------------------------------------------------------
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model to HDF5, whole or not at all, with checksums; `modelfile.load` reads it.

        Raises
        ------
        InputError
            A load that moves, a file that cannot be written.
        """
        told = self._as_stored()  # refuses loads that move
        parts = placing.kept(self.structure, self.sensors, self.loads if self.basis is None else self.basis)
        flags = [f.to_dict() for f in self.flags]
        storage.write(path, {**parts, "settings": dict(self.settings), "flags": flags, **told}, FILE)

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

    def _reading(self, f: NDArray[Any]) -> NDArray[np.complex128]:
        """What every sensor makes of a displacement (lines, sensors): its derivative and its high-pass."""
        return np.asarray((2j * np.pi * f[:, None]) ** self._derivative * highpass(f, self._corner))


def _arrays(matrix: Any) -> tuple[NDArray[Any], ...]:
    """Arrays that a matrix is made of, in one form for equal matrices."""
    if not sparse.issparse(matrix):
        return (matrix,)
    coo = matrix.tocoo()
    order = np.lexsort(coo.coords)
    return tuple(np.asarray(part)[order] for part in (coo.data, *(c.astype(np.int64) for c in coo.coords)))
