"""ForwardModel: structure x sensors x loads, in every form that an inverse method asks for."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .bases.basis import Basis
from .channels import Channel
from .damping import Modal
from .discretise import check, discretise, markov
from .errors import InputError, NotIdentifiable
from .factor import Factor
from .loads import Load, near_support, sparse_matrix
from .model import Model
from .modes import DENSE, Modes, modal_damping, modes
from .reduction import ReducedModel, highpass, on_resonance, static_residual, unbounded
from .statespace import StateSpace, channels, count, digest, lines
from .structure import Structure
from .values import positive, shown

DEFAULT_MODES = 60  # of a large structure
BAND_FACTOR = 2.5  # modes up to this multiple of the band: with the residual, a per cent of error on the worst lines
BLIND = 1e-9  # share of a rigid mode in a row or column that is rounding
DENSE_DIRECT = 2000  # largest structure whose modal damping is written out as a matrix


class ForwardModel(Model):
    """Everything that maps the loads on a structure to what its sensors read.

    Static responses come from one factorisation of the stiffness; dynamic ones from its modes with the static residual
    of the modes left out. The residual counts in every row of `frf`; in the time domain it is a feedthrough of
    displacement and strain, while velocity and acceleration take the retained modes alone (a feedthrough has no finite
    derivative).

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
        Highest frequency of interest (Hz): modes are kept up to 2.5 times it.

    Raises
    ------
    InputError
        If a sensor or a load is none, has no place on the structure, or shares its label.
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
        self.sensors = _placed(sensors, "row", "sensors")
        self.basis = loads if isinstance(loads, Basis) else None
        self.loads = _placed(loads, "column", "loads", "columns")
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
        }
        free = structure.free
        self._S = _rows(structure, self.sensors)[:, free].tocsr()
        self._derivative = np.array([int(getattr(s, "derivative", 0)) for s in self.sensors])
        self._corner = np.array([s.highpass or 0.0 for s in self.sensors])
        given = self.basis if self.basis is not None else self.loads
        self._columns = _columns(structure, given, free)
        _finite_parts(self)
        found = near_support(structure, [p for p in self.loads if isinstance(p, Load)])
        self.flags = (*getattr(structure.field, "flags", ()), *(() if found is None else (found,)))

    def __repr__(self) -> str:
        n = self.structure.free.size
        s = self._settings
        if s["modes"] is None and s["band"] and n > DENSE and "modes" not in self.__dict__:
            kept = f"modes up to {BAND_FACTOR:g} x {s['band']:g} Hz"
        else:
            k = len(self.modes.lam) if "modes" in self.__dict__ else self._wanted()
            kept = f"all {n} modes" if k == n else f"{k} of {n} modes"
        rest = " + static residual" if s["residual"] and not kept.startswith("all") else ""
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
        """The modes that the model retains."""
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
    def reduced(self) -> ReducedModel:
        """The model in modal coordinates."""
        shapes = self.modes
        S, B = self._S @ shapes.phi, self._project(shapes.phi)
        # A strain gauge sees no rigid motion, a self-balanced load drives none: zero, not rounding.
        r = shapes.rigid
        S[:, :r][np.abs(S[:, :r]) < BLIND * np.abs(S).max(axis=1, keepdims=True)] = 0.0
        B[..., :r, :][np.abs(B[..., :r, :]) < BLIND * np.abs(B).max(axis=-2, keepdims=True)] = 0.0
        residual = None
        if self._settings["residual"] and len(shapes.lam) < self.structure.free.size:
            if not self.moving:
                static = self._static_rows if shapes.shift == 0 else None
                residual = static_residual(shapes, self._S, self._columns, S, B, static)
            else:
                full = shapes.factor.solve(self._S.T.toarray()).T
                residual = np.einsum("sn,tnp->tsp", full, self._columns) - (S / (shapes.lam - shapes.shift)) @ B
        return ReducedModel(
            shapes.lam, modal_damping(self.structure, shapes), S, B, residual, self._derivative, self._corner
        )

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
            Direct: one factorisation of ``K - omega^2 M + i omega C`` per line, exact and slow.

        Raises
        ------
        NotIdentifiable
            If a line lies on a natural frequency without damping, or at 0 Hz where the structure is free (LID-E116).
        InputError
            If a load moves, a frequency is negative, or the structure has no mass or is unstable.

        Notes
        -----
        Mode displacement with residual flexibility: R. R. Craig, A. J. Kurdila, *Fundamentals of Structural Dynamics*,
        2nd ed. (2006), chapters 11 and 17.
        """
        self._fixed("frf")
        f = lines(frequencies)
        if method == "modal":
            return self.reduced.frf(f)
        if method == "direct":
            return self._direct(f)
        raise InputError(
            "no such method",
            where="frf",
            found=repr(method),
            expected="'modal' or 'direct'",
            hint="modal is the quick one",
        )

    def impulse_response(self, dt: float, samples: int, hold: str = "foh") -> NDArray[np.float64]:
        """Response to one unit held over one sample (samples, sensors, loads): the Markov parameters of `state_space`.

        The unit is a hat over two samples under the first-order hold, a step of one sample under the zero-order hold.

        Raises
        ------
        InputError
            If the step, the hold or the number of samples is none, a load moves, or the structure has no mass.
        """
        check(dt, hold)
        self._fixed("impulse_response")
        if self.reduced.proportional:
            return markov(self.reduced, float(dt), hold, count(samples))
        return self.state_space(dt, hold).impulse_response(dt, samples)

    def state_space(self, dt: float, hold: str = "foh") -> StateSpace:
        """Discrete state space at step `dt` (s), exact under the hold; a load that moves gives B(t) and D(t).

        Raises
        ------
        InputError
            If the step or the hold is none, a load moves at another step, or the structure has no mass.

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
        return None if self.structure.M_free is None else self.modes.frequencies

    @property
    def decay_rate(self) -> float | None:
        """Slowest decay rate (1/s) that a sensor sees; None without mass."""
        return None if self.structure.M_free is None else self.reduced.decay_rate

    @property
    def fingerprint(self) -> str:
        """Sha256 of the structure, the rows and columns with their channels, and the settings."""
        s = self._settings
        parts = (*_parts(self._S), self._derivative, *_parts(self._columns))
        return digest("ForwardModel", self.structure.digest, *parts, self.sensors, self.loads, *s.values())

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

    def _direct(self, f: NDArray) -> NDArray[np.complex128]:
        K, M = self.structure.K_free, self.structure.M_free
        if M is None:
            raise InputError(
                "the structure has no mass matrix",
                where="frf",
                found="M = None",
                expected="a structure with M",
                hint="give M, or ask for static() only",
            )
        C = self._damping_matrix()
        H = np.empty((len(f), len(self.sensors), len(self.loads)), dtype=complex)
        for i, omega in enumerate(2 * np.pi * f):
            D = K - omega**2 * M + 1j * omega * C
            if C.nnz == 0 and on_resonance(omega, self.modes.lam):
                raise unbounded(f[i], self.modes.lam)
            try:
                H[i] = Factor(D, check=False).transfer(self._S, self._columns)
            except (InputError, NotIdentifiable) as error:
                raise unbounded(f[i], self.modes.lam) from error
            H[i] *= ((1j * omega) ** self._derivative)[:, None]
        return H * highpass(f, self._corner)[:, :, None]

    def _damping_matrix(self) -> Any:
        """Damping on the free DOFs; that of modal ratios, ``M Phi diag(c) Phi^T M``, is full: small structures only."""
        s = self.structure
        if not isinstance(s.damping, Modal):
            return sparse.csr_array(s.K_free.shape) if s.C_free is None else s.C_free
        if s.free.size > DENSE_DIRECT:
            raise InputError(
                "modal damping has no sparse matrix: no direct sweep of a large structure",
                where="frf(method='direct')",
                found=f"{s.free.size} free DOFs",
                expected=f"at most {DENSE_DIRECT}",
                hint="method='modal', or Rayleigh damping",
            )
        every = self.modes if len(self.modes.lam) == s.free.size else modes(s)
        assert s.M_free is not None  # its modes exist
        MPhi = s.M_free @ every.phi
        return sparse.csr_array((MPhi * modal_damping(s, every)) @ MPhi.T)


def _placed(given: Sequence[Any], method: str, where: str, other: str = "") -> tuple[Channel, ...]:
    if isinstance(given, Channel | str) or not hasattr(given, "__iter__"):
        given = [given]
    items = list(given)
    wrong = [x for x in items if not (isinstance(x, Channel) and (hasattr(x, method) or (other and hasattr(x, other))))]
    if wrong or not items:
        raise InputError(
            f"no {where[:-1]}" if items else f"no {where}",
            where=where,
            found=repr(wrong[0]) if wrong else "an empty list",
            expected=f"objects of structures.{where}",
            hint='[sensors.Accelerometer("12+Z")]' if where == "sensors" else '[loads.Point("12+Z")]',
        )
    return channels(items, len(items), "", where)


def _ask(items: Sequence[Any], *methods: str) -> list[Any]:
    """The first of these methods that each item has."""
    return [next(getattr(x, name) for name in methods if hasattr(x, name)) for x in items]


def _rows(structure: Structure, sensors: Sequence[Any]) -> sparse.csr_array:
    """Rows of the sensors over all DOFs, sparse (sensors, n), one dense row at a time."""
    parts = [(np.flatnonzero(values), values) for values in (s.row(structure) for s in sensors)]
    starts = np.cumsum([0, *(len(at) for at, _ in parts)])
    entries = np.concatenate([values[at] for at, values in parts])
    return sparse.csr_array((entries, np.concatenate([at for at, _ in parts]), starts), shape=(len(parts), structure.n))


def _parts(matrix: Any) -> tuple[NDArray, ...]:
    """Arrays that a matrix is made of, in one form for equal matrices."""
    if not sparse.issparse(matrix):
        return (matrix,)
    coo = matrix.tocoo()
    order = np.lexsort(coo.coords)
    return tuple(np.asarray(part)[order] for part in (coo.data, *(c.astype(np.int64) for c in coo.coords)))


def _columns(structure: Any, loads: Sequence[Any], free: NDArray) -> Any:
    """Load columns: sparse (n_free, loads), or dense (samples, n_free, loads) where one moves."""
    if isinstance(loads, Basis):
        return loads.columns(structure)[free].tocsc()
    fixed = [x for x in loads if isinstance(x, Load) and not hasattr(x, "columns")]
    columns = sparse_matrix(structure, fixed)  # names every load on a supported DOF at once
    if len(fixed) == len(loads):
        return columns[free].tocsc()
    parts = [column(structure)[..., free] for column in _ask(loads, "columns", "column")]
    lengths = {len(part) for part in parts if part.ndim == 2}
    if not lengths:
        return sparse.csc_array(np.array(parts).T)
    if len(lengths) > 1:
        raise InputError(
            "loads that move differ in length",
            where="loads",
            found=sorted(lengths),
            expected="one length",
            hint="give every path the samples of the record",
        )
    length = lengths.pop()
    return np.stack([np.broadcast_to(part, (length, free.size)) for part in parts], axis=-1)


def _finite_parts(model: ForwardModel) -> None:
    """A row or a column that holds NaN or nothing at all: named at once, not found in a result."""
    S, B = model._S, model._columns
    values = B.data if sparse.issparse(B) else B
    if not (np.all(np.isfinite(S.data)) and np.all(np.isfinite(values))):
        raise InputError(
            "a sensor row or a load column holds NaN or infinity",
            where="ForwardModel",
            found="NaN or infinity",
            expected="finite numbers",
            hint="check the places and the fibres of sensors and loads",
        )
