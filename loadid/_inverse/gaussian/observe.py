"""What the sensors allow, from the matrices alone: modes and loads that they see, how late, and invariant zeros."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures._models.statespace import StateSpace
from structures.errors import InputError

from .model import FilterModel
from .roots import Array

Complex = NDArray[np.complex128]

ZERO = 1e-9  # singular value of the scaled system matrix below which a candidate is a zero
BLIND = 1e-12  # the same at a point drawn at random: below it, every point is a zero
FAR = 1e4  # modulus beyond which a candidate is one at infinity, smeared by rounding
SAME = 1e-5  # distance of two candidates that are one: rounding splits a double zero by the root of 1e-16 and more
OUTER, ALIKE_ZEROS = (
    1.2,
    5e-3,
)  # outside this modulus sensors share zeros of sampling nearly, not quite: relative distance
SHARED = 1e-3  # distance within which two mixtures may have the same zero
ITERATIONS, SETTLED = 100, 1e-4  # of the inverse iteration: at most, and until a step changes as little
RANK = 1e-9  # singular value over the largest that is rounding


def invariant_zeros(A: Array, B: Array, C: Array, D: Array) -> Complex | None:
    """Finite points z where ``[A - z I, B; C, D]`` loses column rank, ascending in modulus.

    A load that moves as ``z^k`` in the right direction, from the right state, is then unseen by all sensors. On or
    outside the unit circle it never dies out, and no filter without a prior of the load follows it.

    Parameters
    ----------
    A, B, C, D : arrays, shapes (n, n), (n, p), (m, n), (m, p)
        Rows of C and D in units of the noise, columns of B and D in units of the load.

    Returns
    -------
    array, complex, or None
        None where every z is a zero: fewer sensors than loads, or loads that no sensor tells apart.

    Notes
    -----
    With more sensors than loads the rows are squared down by two random mixtures; a zero of the system is a zero of
    each of them, found as a generalised eigenvalue, and each candidate is confirmed on the whole system matrix. Zeros
    and the system matrix: A. Emami-Naeini, P. Van Dooren, "Computation of zeros of linear multivariable systems",
    Automatica 18 (1982) 415-430.
    """
    from scipy.linalg import eigvals

    n, m, p = len(A), len(C), B.shape[1]
    B, C, D = _scaled(A, B, C, D)
    rng = np.random.default_rng(0)
    if m < p or _loses_rank(A, B, C, D, np.exp(2j * np.pi * rng.uniform(0.1, 0.4)), BLIND):
        return None
    ends = np.zeros((n + p, n + p))
    ends[:n, :n] = np.eye(n)

    def squared(mix: Array) -> Complex:
        alpha, beta = eigvals(np.block([[A, B], [mix @ C, mix @ D]]), ends, homogeneous_eigvals=True)
        finite = np.abs(beta) * FAR > np.abs(alpha)
        return np.asarray(np.sort_complex(alpha[finite] / beta[finite]))

    if m == p:
        candidates = squared(np.eye(m))
    else:
        one, two = (squared(np.linalg.qr(rng.standard_normal((m, p)))[0].T) for _ in range(2))
        near = np.abs(one[:, None] - two) < SHARED * np.maximum(1, np.abs(one))[:, None]
        candidates = one[near.any(axis=1)]
    found: list[complex] = []
    for z in candidates:
        if all(abs(z - w) > _apart(w) for w in found) and _loses_rank(A, B, C, D, z, ZERO):
            found.append(complex(z))
    zeros = np.array(found, complex)
    return zeros[np.argsort(np.abs(zeros), kind="stable")]


def delay(A: Array, B: Array, C: Array, D: Array, longest: int = 20) -> int | None:
    """Samples after which the sensors have heard of every load, by rank alone; None if not within the longest.

    The smallest L by which the block Toeplitz matrix of the Markov parameters gains a full set of columns. Necessary
    for a prior-free inversion with that lag, by no means enough: the sd of the load at a lag is what counts.

    Notes
    -----
    M. Sain, J. Massey, "Invertibility of linear time-invariant dynamical systems", IEEE Trans. Automatic Control 14
    (1969) 141-149.
    """
    B, C, D = _scaled(A, B, C, D)
    m, p = D.shape
    if m < p:
        return None
    markov, x = [D], B
    before = 0
    for late in range(longest + 1):
        if late:
            markov.append(C @ x)
            x = A @ x
        T = np.zeros(((late + 1) * m, (late + 1) * p))
        for i in range(late + 1):
            for j in range(i + 1):
                T[i * m : (i + 1) * m, j * p : (j + 1) * p] = markov[i - j]
        s = np.linalg.svd(T, compute_uv=False)
        rank = int(np.sum(s > RANK * max(s[0], np.finfo(float).tiny)))
        if rank - before == p:
            return late
        before = rank
    return None


def _scaled(A: Array, B: Array, C: Array, D: Array) -> tuple[Array, Array, Array]:
    """B with columns of norm one, states in its size, rows of [C, D] of norm one: zeros stay where they are."""
    tiny = np.finfo(float).tiny
    size = np.linalg.norm(B) / np.sqrt(B.shape[1]) or 1.0
    B, C = B / size, C * size
    columns = np.maximum(np.linalg.norm(np.vstack([B, D / max(np.abs(D).max(initial=0), 1.0)]), axis=0), tiny)
    B, D = B / columns, D / columns
    rows = np.linalg.norm(np.hstack([C, D]), axis=1)
    rows = np.where(rows > tiny, rows, 1.0)[:, None]
    return B, C / rows, D / rows


def _apart(z: complex) -> float:
    """How far from a zero another one begins."""
    return SAME if abs(z) < OUTER else ALIKE_ZEROS * abs(z)


def _loses_rank(A: Array, B: Array, C: Array, D: Array, z: complex, level: float) -> bool:
    """Whether the system matrix at z, states divided by the modulus of z outside the circle, is singular to a level.

    The smallest singular value is at most the smallest diagonal entry of a triangular factor: most zeros end there.
    """
    size = max(1.0, abs(z))
    R = _triangle(np.block([[(A - z * np.eye(len(A))) / size, B], [C / size, D]]))
    return bool(np.abs(np.diag(R)).min() < level) or _of_triangle(R)[0] < level


def smallest(M: Array) -> tuple[float, Array]:
    """Smallest singular value of a tall matrix and its right vector: one QR, then inverse iteration."""
    return _of_triangle(_triangle(M))


def _triangle(M: Array) -> Array:
    from scipy.linalg import qr

    return np.asarray(qr(M, mode="r", check_finite=False)[0][: M.shape[1]])


def _of_triangle(R: Array) -> tuple[float, Array]:
    from scipy.linalg import solve_triangular

    n = len(R)
    d = np.abs(np.diag(R))
    if d.min() <= 1e-14 * d.max():  # what is singular to rounding is no factor to iterate with
        s, V = np.linalg.svd(R)[1:]
        return float(s[-1]), V[-1].conj()
    v = np.random.default_rng(1).standard_normal(n) / np.sqrt(n)
    sigma = 0.0
    for _ in range(ITERATIONS):
        u = solve_triangular(R, solve_triangular(R, v, trans="C", check_finite=False), check_finite=False)
        size = float(np.linalg.norm(u))
        v, before, sigma = u / size, sigma, 1 / np.sqrt(size)
        if abs(sigma - before) < SETTLED * sigma:
            break
    return sigma, v


UNSEEN = 1e-9  # PBH singular value of the scaled pair that is rounding; seen pairs have 1e-5 and more
LASTING = 1e-7  # distance from the unit circle within which a state never dies out: rounding splits double ones
ROUNDING = 1e-10  # static gain over the largest dynamic gain of a sensor that is rounding
CIRCLE = 1e-6  # how far inside the unit circle a zero must lie for a load without a prior
AT_ONCE = 1.0  # noise sds by which one load sd must move the sensors within a sample
ALIKE = 1e-7  # distance of eigenvalues that are one: those of free bodies come in blocks
LINES = 48  # frequencies from which sizes are taken


@dataclass(frozen=True)
class EigenvalueTest:
    """One eigenvalue of the system, and whether the sensors see what belongs to it.

    Parameters
    ----------
    name : str
        ``"mode 2 (3.54 Hz)"``, ``"load p0"``, or both where they coincide.
    eigenvalue : complex
    sigma : float
        Smallest singular value of ``[F - lam I; H]`` on the scaled pair: zero is unseen.
    lost : int
        Directions that are unseen.
    load : float
        Share of the loads in the least seen direction: how much of it is a load.
    """

    name: str
    eigenvalue: complex
    sigma: float
    lost: int
    load: float

    @property
    def lasting(self) -> bool:
        """It never dies out by itself."""
        return abs(self.eigenvalue) >= 1 - LASTING


@dataclass(frozen=True, eq=False)
class Observability:
    """Everything that the matrices say of sensors and loads, before any sample.

    Parameters
    ----------
    eigenvalues : tuple of EigenvalueTest
        Popov-Belevitch-Hautus test of each eigenvalue, the least seen first.
    gain : array, shape (m, p), or None
        Static gain in noise sds per load sd, rounding set to zero; None where the structure moves freely.
    static : array, shape (p,), or None
        Its singular values: by how many noise sds one sd of a load moves the sensors for ever.
    at_once : array, shape (p,)
        The same of the feedthrough: within one sample.
    delay : int or None
        Samples after which every load has reached the sensors, by rank.
    zeros : array, complex, or None
        Invariant zeros; None where every z is one.
    sensors : int
    loads : tuple of str
    """

    eigenvalues: tuple[EigenvalueTest, ...]
    gain: Array | None
    static: Array | None
    at_once: Array
    delay: int | None
    zeros: NDArray[np.complex128] | None
    sensors: int
    loads: tuple[str, ...]

    @property
    def unseen(self) -> tuple[EigenvalueTest, ...]:
        """What no sensor sees and what never dies out: with any of it there is no steady gain."""
        return tuple(s for s in self.eigenvalues if s.lost and s.lasting)

    @property
    def detectable(self) -> bool:
        """Every lasting state is seen."""
        return not self.unseen

    @property
    def drifting(self) -> tuple[EigenvalueTest, ...]:
        """The unseen that is, in part, a load."""
        return tuple(s for s in self.unseen if s.load > ALIKE)

    @property
    def static_rank(self) -> int | None:
        """Loads whose constant part the sensors tell apart; None where the structure moves freely."""
        return None if self.static is None else _rank(self.static)

    @property
    def immediate(self) -> int:
        """Loads that move the sensors by a noise sd within one sample."""
        return int(np.sum(self.at_once >= AT_ONCE))

    @property
    def outside(self) -> NDArray[np.complex128] | None:
        """Zeros on or outside the unit circle: loads without a prior are not followed there."""
        return None if self.zeros is None else self.zeros[np.abs(self.zeros) >= 1 - CIRCLE]

    @property
    def invertible(self) -> bool:
        """A filter without a prior of the loads converges."""
        return self.outside is not None and not len(self.outside) and self.immediate == len(self.loads)

    def lacking(self) -> Array:
        """Directions of the loads that leave no static trace (p, r), orthonormal, in load sds."""
        if self.gain is None:
            return np.zeros((len(self.loads), 0))
        V = np.linalg.svd(self.gain)[2]
        return V[_rank(self.static) :].T

    def rows(self) -> tuple[tuple[str, str, str, bool], ...]:
        """The table: check, number, threshold, passed."""
        p, least = len(self.loads), (self.unseen or self.eigenvalues)[0]
        out = [
            ("sensors", f"{self.sensors}", f"at least {p}", self.sensors >= p),
            ("least seen (PBH)", f"{least.sigma:.1e}, {least.name}", f"{UNSEEN:.0e}", self.detectable),
        ]
        if self.static is not None:
            rank = self.static_rank
            text = f"{rank} of {p}; {_few(self.static)} noise sds per load sd"
            out.append(("static rank", text, f"{p}", rank == p))
        text = f"{self.immediate} of {p}; {_few(self.at_once)} noise sds per load sd"
        out.append(("within one sample", text, f"{p} by {AT_ONCE:g}", self.immediate == p))
        out.append(("delay by rank", "never" if self.delay is None else f"{self.delay}", "0", self.delay == 0))
        count = "every z" if self.outside is None else f"{len(self.outside)}"
        out.append(("zeros on or outside the circle", count, "0", count == "0"))
        return tuple(out)


def observability(
    model: FilterModel, space: StateSpace, scale: Array | Sequence[float], *, loads: Sequence[str] | None = None
) -> Observability:
    """Every check of sensors and loads that needs the matrices alone.

    Parameters
    ----------
    model : FilterModel
        The system that will be filtered.
    space : StateSpace
        Its structure: from the loads to the sensors.
    scale : array, shape (p,)
        Size of interest of each load (its sd; for a random walk what it reaches in a second or so).
    loads : sequence of str, optional
        Their names; those of the state space by default.

    Raises
    ------
    InputError
        If the three do not fit each other.

    Notes
    -----
    Test of M. L. J. Hautus, "Controllability and observability conditions of linear autonomous systems", Indagationes
    Mathematicae 31 (1969) 443-448, on the pair with channels in noise sds, loads in their scale and the structure's
    states in the size that the loads give them.
    """
    from scipy.linalg import solve_triangular

    sigma = _checked(model, space, scale)
    C, D = (solve_triangular(model.LR, M, lower=True) for M in (space.C, space.D))
    B, D = space.B * sigma, D * sigma
    states, gains = _responses(space.A, B, C, D)
    gain = _static(space.A, B, C, D, gains)
    static = None if gain is None else _padded(gain, len(sigma))
    size = float(max(np.linalg.norm(B) * 1e-12, np.sqrt(np.mean(np.abs(states) ** 2)))) or 1.0
    names = tuple(loads) if loads is not None else tuple(channel.label for channel in space.loads)
    return Observability(
        eigenvalues=_tested(model, sigma, size, names, space.dt),
        gain=gain,
        static=static,
        at_once=_padded(D, len(sigma)),
        delay=delay(space.A, B, C, D),
        zeros=invariant_zeros(space.A, B, C, D),
        sensors=model.m,
        loads=names,
    )


def _checked(model: FilterModel, space: StateSpace, scale: Array | Sequence[float]) -> Array:
    """Scale of the loads as an array, where everything fits."""
    sigma = np.asarray(scale, float)
    shapes = space.C.shape[0] == model.m and space.B.ndim == 2 and space.D.ndim == 2 and len(space.A) == model.nx
    if not shapes or sigma.shape != (model.p,) or space.B.shape[-1] != model.p:
        raise InputError(
            "the structure does not fit the filter's model", where="observability",
            found=f"{space!r}, a scale of shape {sigma.shape}",
            expected=f"{model.nx} states, {model.m} sensors, {model.p} loads that stay in place, one size for each",
        )  # fmt: skip
    if not np.all(np.isfinite(sigma) & (sigma > 0)):
        raise InputError("sizes of loads are positive", where="scale", found=f"{sigma}", expected="finite, > 0")
    return sigma


# -- sizes -------------------------------------------------------------------------------------------------------------
def _responses(A: Array, B: Array, C: Array, D: Array) -> tuple[Array, Array]:
    """States (lines, n, p) and sensors (lines, m, p) under harmonic loads, from slow ones to Nyquist."""
    from scipy.linalg import schur, solve_triangular

    T, Q = schur(A, output="complex")
    turned = Q.conj().T @ B
    z = np.exp(1j * np.pi * np.geomspace(1e-3, 1.0, LINES)) * (1 + 1e-6)  # off the circle: undamped poles lie on it
    states = np.array([Q @ solve_triangular(w * np.eye(len(A)) - T, turned) for w in z])
    return states, C @ states + D


def _static(A: Array, B: Array, C: Array, D: Array, gains: Array) -> Array | None:
    """Static gain (m, p) with rounding set to zero; None where a free motion never settles."""
    rest = np.eye(len(A)) - A
    if len(A) and np.linalg.cond(rest) > 1e13:
        return None
    gain = C @ np.linalg.solve(rest, B) + D if len(A) else D
    largest = np.abs(gains).max(axis=(0, 2))[:, None]
    return np.where(np.abs(gain) > ROUNDING * largest, gain, 0.0)


def _padded(M: Array, p: int) -> Array:
    """Singular values, as many as there are loads."""
    s = np.linalg.svd(M, compute_uv=False)
    return np.concatenate([s, np.zeros(max(0, p - len(s)))])[:p]


def _rank(s: Array | None) -> int:
    return 0 if s is None or not s[0] > 0 else int(np.sum(s > 1e-9 * s[0]))


def _few(s: Array) -> str:
    return ", ".join(f"{x:.3g}" for x in s[:4]) + (", ..." if len(s) > 4 else "")


# -- the test of each eigenvalue ---------------------------------------------------------------------------------------
def _tested(
    model: FilterModel, sigma: Array, size: float, names: tuple[str, ...], dt: float
) -> tuple[EigenvalueTest, ...]:
    """Popov-Belevitch-Hautus test on the scaled pair."""
    F, H, Cp = _scaled_pair(model, sigma, size)
    out = []
    for lam, name in _eigenvalues(model, Cp, H, names, dt):
        pencil = np.vstack([F - lam * np.eye(len(F)), H])
        sigma_least, v = smallest(pencil)
        lost = int(np.sum(np.linalg.svd(pencil, compute_uv=False) < UNSEEN)) if sigma_least < 10 * UNSEEN else 0
        out.append(EigenvalueTest(name, lam, sigma_least, lost, float(np.linalg.norm(Cp @ v))))
    return tuple(sorted(out, key=lambda seen: seen.sigma))


def _scaled_pair(model: FilterModel, sigma: Array, size: float) -> tuple[Array, Array, Array]:
    """F, H and Cp with states of order one and channels in noise sds, the strongest of order one."""
    from scipy.linalg import matrix_balance, solve_triangular
    from scipy.sparse.csgraph import connected_components

    nx, n = model.nx, model.n
    H = solve_triangular(model.LR, model.H, lower=True)
    d = np.ones(n)
    if nx:
        d[:nx] = matrix_balance(model.F[:nx, :nx], permute=False, separate=True)[1][0]
        d[:nx] *= size / np.sqrt(np.mean(d[:nx] ** 2))
    Cz = model.Cp[:, nx:]
    links = (np.abs(model.F[nx:, nx:]) + np.abs(Cz.T) @ np.abs(Cz)) != 0
    parts = connected_components(links, directed=False)[1] if n > nx else np.zeros(0, int)
    for part in np.unique(parts):
        own = np.flatnonzero(parts == part)
        read = np.abs(Cz[:, own]).max(axis=1, initial=0.0)
        j = int(np.argmax(read / sigma)) if len(sigma) else 0
        loud = np.abs(H[:, nx + own]).max(initial=0.0)
        # A state that no load reads is the bias of a sensor: its size is that of the noise.
        d[nx + own] = sigma[j] / read[j] if len(read) and read[j] > 0 else 1 / (loud or 1.0)
    H = H * d
    F = model.F * d / d[:, None]
    return F, H / (np.linalg.norm(H, 2) or 1.0), model.Cp * d / sigma[:, None]


def _eigenvalues(
    model: FilterModel, Cp: Array, H: Array, names: tuple[str, ...], dt: float
) -> list[tuple[complex, str]]:
    """Eigenvalues of the upper half plane with their names, each once."""
    nx = model.nx
    found: list[tuple[complex, list[str]]] = []

    def put(lam: complex, name: str) -> None:
        for other, known in found:
            if abs(other - lam) < ALIKE:
                known.extend([name] * (name not in known))
                return
        found.append((lam, [name]))

    w, V = np.linalg.eig(model.F[nx:, nx:])
    for lam, v in zip(w, V.T, strict=True):
        put(complex(lam), _owner(Cp[:, nx:] @ v, H[:, nx:] @ v, names))
    modes = np.linalg.eigvals(model.F[:nx, :nx])
    modes = modes[modes.imag >= 0]
    hertz = np.abs(np.log(np.where(modes == 0, 1e-300, modes))) / (2 * np.pi * dt)
    for k, i in enumerate(np.argsort(hertz), 1):
        put(complex(modes[i]), f"mode {k} ({hertz[i]:.3g} Hz)")
    return [(lam, " and ".join(known)) for lam, known in found if lam.imag >= 0]


def _owner(load: Array, sensor: Array, names: tuple[str, ...]) -> str:
    """Whose prior an eigenvector belongs to: a load's, or the bias of a sensor."""
    if np.abs(load).max(initial=0.0) > 0:
        return f"load {names[int(np.argmax(np.abs(load)))]}"
    return f"bias of sensor {int(np.argmax(np.abs(sensor)))}"
