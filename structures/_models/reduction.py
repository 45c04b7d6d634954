"""Undamped modes with their damping, and the reduced model: a few modes and a static residual."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.sparse.linalg import LinearOperator, eigsh

from .._system.damping import Modal, Rayleigh
from .._system.factor import MECHANISM, Factor
from ..errors import InputError, NotIdentifiable

DENSE = 400  # free DOFs up to which the dense eigensolver is quicker and gives every mode
EXACT = 1e-9  # relative rounding of a Rayleigh quotient up to which it is the better frequency
DIAGONAL = 1e-10  # off-diagonal modal damping, over its diagonal, that counts as none


@dataclass(frozen=True)
class Modes:
    """Undamped modes ``K phi = lam M phi``, ``phi^T M phi = 1``.

    Parameters
    ----------
    lam : array (k,)
        Squared circular frequencies, ascending; exactly 0 for rigid-body modes.
    phi : array (n_free, k)
        Shapes on the free DOFs.
    rigid : int
        Number of rigid-body modes.
    shift : float
        ``factor`` is that of ``K - shift M``: 0 for a supported structure, negative for a free one.
    factor : Factor
    """

    lam: NDArray[np.float64]
    phi: NDArray[np.float64]
    rigid: int
    shift: float
    factor: Factor

    @property
    def frequencies(self) -> NDArray[np.float64]:
        """Natural frequencies in Hz (k,)."""
        return np.sqrt(self.lam) / (2 * np.pi)


def modes(structure: Any, count: int | None = None) -> Modes:
    """The lowest `count` modes of a structure (all of them by default).

    Sparse shift-invert Lanczos with the one factor of the stiffness; a dense solve for a small structure or when most
    modes are asked. A free structure is shifted by a tenth of its first elastic ``omega^2``, downwards.

    Parameters
    ----------
    structure : Structure
        With a mass matrix.
    count : int, optional

    Raises
    ------
    InputError
        Without a mass matrix, with a negative mass, or with a stiffness that has a negative eigenvalue (unstable).

    Notes
    -----
    Shift-invert Lanczos: R. B. Lehoucq, D. C. Sorensen, C. Yang, *ARPACK Users' Guide* (1998).
    """
    needs_mass(structure, "modes")
    n = structure.K_free.shape[0]
    if count is not None and not 1 <= int(count) <= n:
        raise InputError(
            "no such number of modes",
            where="modes",
            found=count,
            expected=f"1..{n}",
            hint="a structure has as many modes as free DOFs",
        )
    k = n if count is None else int(count)
    dense = n <= DENSE or 2 * k > n
    rigid, shift, factor = anchor(structure)
    lam, phi = _dense(structure, k, shift, rigid, factor) if dense else _lanczos(structure, k, shift, factor)
    lam, phi = lam[:k].copy(), phi[:, :k]
    lam[: min(rigid, k)] = 0.0
    if np.any(lam < 0):
        raise unstable(f"omega^2 = {lam.min():.4g}")
    return Modes(lam, phi, min(rigid, k), shift, factor)


def needs_mass(structure: Any, where: str) -> None:
    """Refuse a structure without a mass matrix."""
    if structure.M_free is None:
        raise InputError(
            "the structure has no mass matrix",
            where=where,
            found="M = None",
            expected="a structure with M",
            hint="give M, or ask for static() only",
        )


def unstable(found: str) -> InputError:
    """The refusal of a stiffness that is not positive."""
    return InputError(
        "the structure is unstable: its stiffness has a negative eigenvalue",
        where="modes",
        found=found,
        expected="omega^2 >= 0",
        hint="a compressive prestress beyond buckling, or a wrong sign in K",
    )


def anchor(structure: Any) -> tuple[int, float, Factor]:
    """Number of rigid-body modes, the shift, and the factor of ``K - shift M``."""
    try:
        return 0, 0.0, Factor.of(structure)
    except NotIdentifiable:
        K, M = structure.K_free, structure.M_free
        if M is None:
            raise
    n = K.shape[0]
    stiffness, mass = K.diagonal(), M.diagonal()
    if np.any(mass < 0):
        raise InputError(
            "a mass is negative", where="modes", found=f"{mass.min():.4g}", expected=">= 0", hint="check M"
        )
    top = float(np.max(stiffness[mass > 0] / mass[mass > 0], initial=0.0))
    if top == 0.0:  # no stiffness at all
        return n, -1.0, Factor(K + M, structure=structure)
    if n <= DENSE:
        lam = _dense_direct(K.toarray(), M.toarray())[0]
        rigid = int(np.sum(np.abs(lam) <= 10 * n * np.finfo(float).eps * lam[-1]))
    else:
        # A shift far below the top of the spectrum separates the rigid modes; its exact value does not matter yet.
        trial = -1e-8 * top
        lam = _lanczos(structure, 12, trial, Factor(K - trial * M, structure=structure))[0]
        rigid = int(np.sum(np.abs(lam) <= 1e-5 * abs(trial)))
    shift = -0.1 * float(lam[rigid]) if rigid < len(lam) else -1e-4 * top
    return rigid, shift, Factor(K - shift * M, structure=structure)


def _lanczos(structure: Any, k: int, shift: float, factor: Factor) -> tuple[NDArray[Any], NDArray[Any]]:
    n = factor.n
    start = np.random.default_rng(0).standard_normal(n)  # fixed, so that two runs agree to the last bit
    inverse = LinearOperator((n, n), matvec=factor.solve, dtype=float)
    lam, phi = eigsh(structure.K_free.tocsc(), k, structure.M_free.tocsc(), sigma=shift, OPinv=inverse, v0=start)
    lam, phi = _ritz(structure.K_free, structure.M_free, lam, phi)
    order = np.argsort(lam)
    return lam[order], phi[:, order]


def _ritz(K: Any, M: Any, lam: NDArray[Any], phi: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Rayleigh and Ritz's values in place of those that K's own rounding lets be better.

    What shift and invert gives loses a digit for every decade of a frequency's square above the shift; the error of
    Ritz's values is the square of that of the shapes.
    """
    rounding = np.finfo(float).eps * np.einsum("ij,ij->j", np.abs(phi), abs(K) @ np.abs(phi))
    good = rounding < EXACT * np.abs(lam)
    if not good.any():
        return lam, phi
    shapes = phi[:, good]
    values, mixed = linalg.eigh(shapes.T @ (K @ shapes), shapes.T @ (M @ shapes))
    lam, phi = np.array(lam), np.array(phi)
    lam[good], phi[:, good] = values, shapes @ mixed
    return lam, phi


def _dense(structure: Any, k: int, shift: float, rigid: int, factor: Factor) -> tuple[NDArray[Any], NDArray[Any]]:
    """All modes: the eigensolver's error is absolute, so the low ones come from ``K^-1`` and the high ones from `K`."""
    K, M = structure.K_free.toarray(), structure.M_free.toarray()
    lam, phi = _dense_inverse(M, shift, factor)
    high, phi_high = _dense_direct(K, M)
    first = max(high[min(rigid, len(high) - 1)], np.finfo(float).tiny)
    middle = int(np.searchsorted(high, np.sqrt(first * high[-1])))
    low, top = max(rigid + 1, middle // 2), min(len(high) - 1, middle + middle // 2 + 1)
    if k > low and low < top:
        # Cut at the widest gap near the middle: never through a pair of equal frequencies.
        cut = low + int(np.argmax(high[low:top] / high[low - 1 : top - 1]))
        lam, phi = np.concatenate([lam[:cut], high[cut:]]), np.hstack([phi[:, :cut], phi_high[:, cut:]])
    # The solve brings traces of low modes into higher ones: take them out again, the lowest mode first.
    R = linalg.cholesky(phi[:, :k].T @ (M @ phi[:, :k]))
    return lam[:k], linalg.solve_triangular(R, phi[:, :k].T, trans="T").T


def _dense_direct(K: NDArray[Any], M: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    scale = 1 / np.sqrt(_positive(M))  # displacements and rotations made comparable
    try:
        lam, phi = linalg.eigh(scale[:, None] * K * scale, scale[:, None] * M * scale)
    except linalg.LinAlgError:
        raise _bad_mass(M) from None
    return lam, scale[:, None] * phi


def _dense_inverse(M: NDArray[Any], shift: float, factor: Factor) -> tuple[NDArray[Any], NDArray[Any]]:
    """Modes from ``L^T (K - shift M)^-1 L``, ``M = L L^T``: the low ones with full relative accuracy."""
    scale = np.sqrt(_positive(M))
    try:
        L = scale[:, None] * linalg.cholesky(M / scale[:, None] / scale, lower=True)
    except linalg.LinAlgError:
        raise _bad_mass(M) from None
    X = factor.solve(L)
    A = L.T @ X
    theta, y = linalg.eigh(0.5 * (A + A.T))
    theta, y = theta[::-1], y[:, ::-1]
    lam, phi = 1 / theta + shift, X @ y / theta
    order = np.argsort(lam)
    return lam[order], phi[:, order]


def _positive(M: NDArray[Any]) -> NDArray[np.float64]:
    mass = M.diagonal()
    if np.any(mass <= 0):
        raise _bad_mass(M)
    return mass


def _bad_mass(M: NDArray[Any]) -> InputError:
    low = float(linalg.eigvalsh(0.5 * (M + M.T))[0])
    return InputError(
        "the mass matrix is not positive definite",
        where="modes",
        found=f"smallest eigenvalue {low:.4g}",
        expected="> 0",
        hint="a negative mass, or a DOF without mass: condense it first",
    )


def modal_damping(structure: Any, shapes: Modes) -> NDArray[np.float64]:
    """Modal damping ``c_k`` = 2 zeta omega (k,), or ``Phi^T C Phi`` (k, k) where that is not diagonal; 1/s."""
    damping, omega = structure.damping, np.sqrt(shapes.lam)
    if isinstance(damping, Modal) or (isinstance(damping, Rayleigh) and structure.C is None):
        # Ratios are counted from the first elastic mode: a rigid-body mode has none.
        return np.concatenate([damping.coefficient(part) for part in np.split(omega, [shapes.rigid])])
    if structure.C_free is None:
        return np.zeros(len(omega))
    C = shapes.phi.T @ (structure.C_free @ shapes.phi)
    diagonal = C.diagonal()
    off = np.abs(C - np.diag(diagonal)).max()
    return np.asarray(diagonal.copy() if off <= DIAGONAL * np.abs(diagonal).max(initial=0.0) else 0.5 * (C + C.T))


ON_RESONANCE = 1e-12  # share of omega^2 that an eigenvalue and its square root keep: nearer is on the resonance
FLOATS = 4_000_000  # largest scratch array of a sweep


@dataclass(frozen=True)
class ReducedModel:
    """A structure seen from its sensors and loads through a few modes.

    Parameters
    ----------
    lam : array (k,)
        Squared circular frequencies; 0 marks a rigid-body mode.
    damping : array (k,) or (k, k)
        Modal damping 2 zeta omega, or the full projected matrix.
    S : array (sensors, k)
        Modal sensor rows, before any time derivative.
    B : array (k, loads) or (samples, k, loads)
        Modal load columns; a leading time axis where a load moves.
    residual : array (sensors, loads) or (samples, sensors, loads), or None
        Static response of the modes left out, before any derivative.
    derivative : int array (sensors,)
        0 displacement and strain, 1 velocity, 2 acceleration.
    corner : array (sensors,)
        Corner of the first-order high-pass in Hz; 0 = none.
    loss : float
        Structural loss factor; where it is not 0 the model has frequency responses only.
    """

    lam: NDArray[np.float64]
    damping: NDArray[np.float64]
    S: NDArray[np.float64]
    B: NDArray[np.float64]
    residual: NDArray[np.float64] | None
    derivative: NDArray[np.int64]
    corner: NDArray[np.float64]
    loss: float = 0.0

    @property
    def moving(self) -> bool:
        """A load moves."""
        return self.B.ndim == 3

    @property
    def proportional(self) -> bool:
        """The damping is diagonal in the modes."""
        return self.damping.ndim == 1

    @property
    def decay_rate(self) -> float:
        """Slowest decay rate (1/s) that a sensor sees; 0 where something never decays. Loss as at resonance."""
        rates = [2 * np.pi * fc for fc in self.corner if fc > 0]
        elastic = self.lam > 0
        if not self.proportional:
            k = len(self.lam)
            damping = self.damping + np.diag(self.loss * np.sqrt(self.lam))
            A = np.block([[np.zeros((k, k)), np.eye(k)], [-np.diag(self.lam), -damping]])
            s = np.linalg.eigvals(A)
            rates.append(float(np.min(-s.real)) if np.all(elastic) else 0.0)
            return float(max(min(rates), 0.0))
        lam = self.lam[elastic]
        c = self.damping[elastic] + self.loss * np.sqrt(lam)
        root = np.sqrt(np.maximum(c**2 / 4 - lam, 0.0))
        # overdamped: the slow root lam / (c/2 + root) without cancellation; undamped: exactly 0
        slow = root > 0
        rates.extend(np.where(slow, lam / np.where(slow, c / 2 + root, 1.0), c / 2))
        for k in np.flatnonzero(~elastic).tolist():
            # A free body keeps its place and, undamped, its velocity; an accelerometer sees the load alone.
            for d in self.derivative[self.S[:, k] != 0]:
                if d < 2 or self.damping[k] > 0:
                    rates.append(0.0 if d == 0 else float(self.damping[k]))
        return float(min(rates, default=0.0))

    def frf(self, frequencies: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Frequency response (lines, sensors, loads), high-pass included; the residual counts in every row.

        Raises
        ------
        NotIdentifiable
            If a line (Hz) lies on a natural frequency without damping.
        """
        omega = 2 * np.pi * frequencies
        H = self._proportional(omega) if self.proportional else self._coupled(omega)
        if not np.all(np.isfinite(H)):
            line = int(np.flatnonzero(~np.isfinite(H).all(axis=(1, 2)))[0])
            raise unbounded(frequencies[line], self.lam)
        return H * highpass(frequencies, self.corner)[:, :, None]

    def _proportional(self, omega: NDArray[Any]) -> NDArray[np.complex128]:
        lines, (m, k), p = len(omega), self.S.shape, self.B.shape[1]
        H = np.empty((lines, m, p), dtype=complex)
        elastic = self.lam > 0
        rows = max(1, FLOATS // max(1, k * p))
        step = max(1, FLOATS // max(1, k))
        flexible = 1 / self._stiffening(omega)
        for d in (int(x) for x in np.unique(self.derivative)):
            sensors = np.flatnonzero(self.derivative == d)
            for a in range(0, lines, step):
                w = modal_weights(omega[a : a + step], self.lam, self.damping, elastic, d, self.loss)
                unbounded = np.argwhere(np.isnan(w))
                w[np.isnan(w)] = 0.0
                for b in range(0, len(sensors), rows):
                    s = sensors[b : b + rows]
                    outer = (self.S[s].T[:, :, None] * self.B[:, None, :]).reshape(k, -1)
                    part = w.real @ outer + 1j * (w.imag @ outer)
                    for i, mode in unbounded:
                        part[i, outer[mode] != 0] = np.nan
                    part = part.reshape(len(w), len(s), p)
                    if self.residual is not None:
                        rest = (1j * omega[a : a + step]) ** d * flexible[a : a + step]
                        part += rest[:, None, None] * self.residual[s]
                    H[a : a + step, s] = part
        return H

    def _coupled(self, omega: NDArray[Any]) -> NDArray[np.complex128]:
        k = len(self.lam)
        H = np.empty((len(omega), len(self.S), self.B.shape[1]), dtype=complex)
        step = max(1, FLOATS // k**2)
        for a in range(0, len(omega), step):
            w = omega[a : a + step, None, None]
            stiff = self._stiffening(w) * np.diag(self.lam)
            D = stiff - w**2 * np.eye(k) + 1j * w * self.damping
            lost = np.array([self._unbounded(d, w0) for d, w0 in zip(D, omega[a : a + step], strict=True)])
            D[lost] = np.eye(k)
            H[a : a + step] = self.S @ np.linalg.solve(D, np.broadcast_to(self.B, (len(D), *self.B.shape)))
            H[a : a + step][lost] = np.nan
        if self.residual is not None:
            H += self.residual / self._stiffening(omega)[:, None, None]
        return H * (1j * omega[:, None, None]) ** self.derivative[:, None]

    def _stiffening(self, omega: NDArray[Any]) -> NDArray[np.complex128]:
        """What structural damping makes of a stiffness of one: ``1 + i loss``, and 1 at rest."""
        return np.asarray(1 + 1j * self.loss * (omega > 0), complex)

    def _unbounded(self, D: NDArray[Any], omega: float) -> bool:
        """Whether the dynamic stiffness is singular to rounding; only near an undamped frequency can it be."""
        if np.abs(self.lam - omega**2).min() > 1e-6 * omega**2:
            return False
        if omega == 0:  # the static limit: a rigid-body mode is among them
            return True
        scale = 1 / np.maximum(np.sqrt(self.lam), omega)
        return bool(np.linalg.svd(scale[:, None] * D * scale, compute_uv=False)[-1] <= ON_RESONANCE)


def on_resonance(omega: float, lam: NDArray[Any]) -> bool:
    """Whether a line (rad/s) lies on an undamped natural frequency, to rounding."""
    return bool(np.any(np.abs(lam - omega**2) <= ON_RESONANCE * lam))


def unbounded(frequency: float, lam: NDArray[Any]) -> NotIdentifiable:
    """The refusal of a line (Hz) at which the response is unbounded; names the mode that has it."""
    k = int(np.argmin(np.abs(lam - (2 * np.pi * frequency) ** 2)))
    natural = float(np.sqrt(lam[k]) / (2 * np.pi))
    why = f"it is the natural frequency of mode {k + 1} ({natural:.9g} Hz), which has no damping"
    return NotIdentifiable(
        f"the response at {frequency:.6g} Hz is unbounded: "
        + (why if natural > 0 else "nothing resists the rigid-body motion there"),
        advice="leave this line out, add damping (damping=0.01), or support the structure",
        code=MECHANISM,
    )


def modal_weights(
    omega: NDArray[Any],
    lam: NDArray[Any],
    c: NDArray[Any],
    elastic: NDArray[np.bool_],
    derivative: int,
    loss: float = 0.0,
) -> NDArray[np.complex128]:
    """Frequency response of every mode (lines, k) to a unit modal force, differentiated; its limit for rigid modes."""
    jw = 1j * omega[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        stiffness = lam * (1 + 1j * loss * (omega[:, None] > 0)) + jw**2 + jw * c
        w = jw**derivative / np.where(np.abs(stiffness) <= ON_RESONANCE * lam, np.nan, stiffness)
        for k in np.flatnonzero(~elastic).tolist():
            # One factor j omega cancels, so that the acceleration of a free body is right down to 0 Hz.
            u = jw[:, 0]
            if derivative == 0:
                w[:, k] = 1 / (u * (u + c[k]))
            else:
                w[:, k] = np.ones_like(u) if derivative == 2 and c[k] == 0 else u ** (derivative - 1) / (u + c[k])
    w[~np.isfinite(w)] = np.nan
    return w


def highpass(frequencies: NDArray[Any], corner: NDArray[Any]) -> NDArray[np.complex128]:
    """First-order high-pass ``j f / (fc + j f)`` of every sensor (lines, sensors); 1 where there is no corner."""
    f = frequencies[:, None]
    return np.where(corner > 0, 1j * f / np.where(corner > 0, corner + 1j * f, 1.0), 1.0)


def static_residual(
    shapes: Modes, S: Any, B: Any, modal_S: NDArray[Any], modal_B: NDArray[Any], static: NDArray[Any] | None = None
) -> NDArray[np.float64]:
    """Static response of the modes left out (sensors, loads).

    Parameters
    ----------
    S, B : sparse (sensors, n_free), (n_free, loads)
    modal_S, modal_B : array (sensors, k), (k, loads)
    static : array (sensors, loads), optional
        ``S K^-1 B`` where it is known already (supported structure).
    """
    full = shapes.factor.transfer(S, B) if static is None else static
    return np.asarray(full - (modal_S / (shapes.lam - shapes.shift)) @ modal_B)
