"""From autospectra to a matrix of cross spectra that responses can have: buzz, stated coherence, the nearest matrix.

Every way keeps the autospectra to the last digit and says what it did to the rest.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._flags import Evidence, Flag
from structures._model import Model
from structures._testing.welch import CrossSpectra
from structures.errors import InputError, as_array, integer, reals

from .._record import Record
from ..sources._transfer import common
from ._profiles import Target

Complex = NDArray[np.complex128]
ROUNDS = 300  # alternating projections: at most
SETTLED = 1e-10  # change of a normalised entry
MOVED = 0.02  # of a normalised entry, rms, from which on what was asked for is said to be of no responses


def buzz(model: Model, frequencies: ArrayLike, drives: CrossSpectra | None = None) -> CrossSpectra:
    """Cross spectra of the responses that a model predicts where its loads are driven by noise of equal level.

    Parameters
    ----------
    model : Model
    frequencies : array, shape (lines,)
        Hz.
    drives : CrossSpectra, optional
        Of the loads, on the same lines; default uncorrelated ones of density 1.

    Raises
    ------
    InputError
        As the model's ``frf``; drives of other lines or loads.
    """
    f = np.atleast_1d(reals(frequencies, where="buzz", what="these are no lines"))
    H = np.asarray(model.frf(f), complex)
    if drives is None:
        return CrossSpectra(f, H @ H.conj().swapaxes(1, 2), channels=model.sensors, averages=np.inf)
    if drives.matrix.shape != (len(f), H.shape[2], H.shape[2]) or not np.allclose(drives.frequencies, f, rtol=1e-9):
        raise InputError("the drives do not fit", where="buzz", found=f"matrix {drives.matrix.shape}",
                         expected=f"({len(f)}, {H.shape[2]}, {H.shape[2]}) on the same lines")  # fmt: skip
    return CrossSpectra(f, H @ drives.matrix @ H.conj().swapaxes(1, 2), channels=model.sensors,
                        averages=drives.averages)  # fmt: skip


def by_buzz(target: Target, measured: CrossSpectra) -> CrossSpectra:
    """Cross spectra with the autospectra of a target, and the coherences and phases of a buzz test.

    Parameters
    ----------
    target : Target
        Random.
    measured : CrossSpectra
        Responses where all drives run with uncorrelated noise, measured or predicted (`buzz`): all sensors of the
        target, and its lines among others.

    Returns
    -------
    CrossSpectra
        With a flag W222 where the buzz has no more averages than channels: its coherences are then those of chance.

    Raises
    ------
    InputError
        Lines or channels that are not in the buzz, a channel that it does not move, a target that is no random one.

    Notes
    -----
    ``S_ij = sqrt(S_ii S_jj) B_ij / sqrt(B_ii B_jj)``: P. M. Daborn, P. R. Ind, D. J. Ewins, "Enhanced ground-based
    vibration testing for aerodynamic environments", Mech. Syst. Signal Process. 49 (2014) 165-180.
    """
    _random(target, "by_buzz")
    found = measured.restricted(list(target.labels))
    rows, lines = common(np.asarray(found.frequencies, float), target.frequencies)
    if len(lines) < len(target.frequencies):
        raise InputError("the buzz lacks lines of the target", where="by_buzz", found=f"{len(lines)} lines in common",
                         expected=f"all {len(target.frequencies)}", hint="segments of the same length")  # fmt: skip
    N = normalised(found.matrix[rows], target)
    made = CrossSpectra(target.frequencies, _scaled(N, target), channels=target.channels, averages=np.inf)
    channels = len(target.channels)
    if measured.averages > channels:
        return made
    return replace(made, flags=(Flag(
        "W222", Evidence("averages of the buzz", measured.averages, float(channels)),
        f"{measured.averages:.3g} averages of {channels} channels: any {channels} signals look coherent over so few",
        "measure the buzz for longer, or predict it: loadid.vibration.buzz(model, frequencies)",
    ),))  # fmt: skip


def by_coherence(target: Target, coherence: ArrayLike, phase: ArrayLike = 0.0) -> CrossSpectra:
    """Cross spectra with the autospectra of a target, and coherences and phases as stated.

    Parameters
    ----------
    target : Target
        Random.
    coherence : float or array, shape (sensors, sensors) or (lines, sensors, sensors)
        Ordinary coherence between every two sensors, 0 to 1; the diagonal does not count.
    phase : float or array, alike
        rad, of ``S_ij``: minus that of ``S_ji``; of one number that of the upper triangle.

    Returns
    -------
    CrossSpectra
        The nearest that responses can have, with a flag W222 where that is another one than was asked for.

    Raises
    ------
    InputError
        Coherences outside 0 to 1, shapes that do not fit, phases that are not odd.
    """
    _random(target, "by_coherence")
    k, n = target.levels.shape
    size = _table(coherence, (k, n, n), "coherence")
    if np.any((size < 0) | (size > 1)) or not np.allclose(size, size.swapaxes(1, 2)):
        raise InputError("no coherences", where="by_coherence", found=f"{size.min():g} to {size.max():g}",
                         expected="0 to 1, alike for both orders of a pair")  # fmt: skip
    angle = _table(phase, (k, n, n), "phase")
    if np.ndim(phase) == 0:
        angle = angle * (np.triu(np.ones((n, n)), 1) - np.tril(np.ones((n, n)), -1))
    off = ~np.eye(n, dtype=bool)
    odd = np.abs(np.exp(1j * angle) * np.exp(1j * angle.swapaxes(1, 2)) - 1)[:, off]
    if odd.size and odd.max() > 1e-6:
        raise InputError("the phases are not odd", where="by_coherence", found="S_ij and S_ji",
                         expected="phase_ij = -phase_ji")  # fmt: skip
    N = np.sqrt(size) * np.exp(1j * angle)
    N[:, np.arange(n), np.arange(n)] = 1.0
    made = CrossSpectra(target.frequencies, _scaled(_psd(N), target), channels=target.channels, averages=np.inf)
    return _told(made, N, "the coherences and phases asked for")


def nearest(spectra: CrossSpectra) -> CrossSpectra:
    """The nearest cross spectra with the same autospectra that responses can have: no eigenvalue below zero.

    Parameters
    ----------
    spectra : CrossSpectra
        Put together by hand, or of entries from different segments.

    Returns
    -------
    CrossSpectra
        Nearest over the roots of the autospectra, in the Frobenius norm; with a flag W222 where it is another one.

    Notes
    -----
    N. J. Higham, "Computing the nearest correlation matrix", IMA J. Numer. Anal. 22 (2002) 329-343, of Hermitian ones.
    """
    N = _over_roots(spectra.matrix)
    root = np.sqrt(spectra.autospectra)
    made = replace(spectra, matrix=_psd(N) * root[:, :, None] * root[:, None, :])
    return _told(made, N, "these cross spectra")


def split_record(record: Record, parts: int = 2, **cut: Any) -> tuple[CrossSpectra, ...]:
    """Cross spectra of parts of a record: from one of them the target, on the others what was found is held.

    Parameters
    ----------
    record : Record
    parts : int
        Successive parts of equal length.
    **cut
        ``window``, ``segment``, ``overlap`` and ``detrend`` of `structures.cross_spectra`.

    Raises
    ------
    InputError
        Parts shorter than a segment.
    """
    from structures._testing.welch import cross_spectra

    count = integer("parts", parts, where="split_record", limit=max(len(record) // 8, 1))
    length = len(record) // count
    pieces = [record.values[i * length : (i + 1) * length] for i in range(count)]
    cut.setdefault("segment", 1 << max(int(np.log2(max(length / 8, 4))), 2))
    return tuple(cross_spectra(p, record.dt, channels=record.channels, **cut) for p in pieces)


# -- inside ------------------------------------------------------------------------------------------------------------
def normalised(matrix: Complex, target: Target) -> Complex:
    """Cross spectra over the roots of their autospectra.

    Raises
    ------
    InputError
        A channel without any power on a line on which the target asks for some.
    """
    power = np.einsum("kii->ki", matrix).real
    dead = (power <= 0) & (target.levels > 0)
    if np.any(dead):
        k, i = np.argwhere(dead)[0]
        raise InputError("the buzz does not move a sensor of the target", where=f"by_buzz, {target.labels[i]}",
                         found=f"no power at {target.frequencies[k]:g} Hz", expected="all sensors on all lines",
                         hint="drive this band too, or leave the sensor out of the target")  # fmt: skip
    return _over_roots(matrix)


def _over_roots(matrix: Complex) -> Complex:
    root = np.sqrt(np.einsum("kii->ki", matrix).real)
    size = root[:, :, None] * root[:, None, :]
    N = np.divide(matrix, size, out=np.zeros_like(matrix), where=size > 0)
    n = matrix.shape[1]
    N[:, np.arange(n), np.arange(n)] = 1.0
    return np.asarray(N)


def _scaled(N: Complex, target: Target) -> Complex:
    root = np.sqrt(target.levels)
    return np.asarray(N * root[:, :, None] * root[:, None, :])


def _psd(N: Complex) -> Complex:
    """Nearest positive semidefinite matrices of unit diagonal, by alternating projections with Dykstra's correction."""
    n = N.shape[1]
    w = np.linalg.eigvalsh(N)
    bad = np.flatnonzero(w[:, 0] < -1e-12 * n)
    found = N.copy()
    if not len(bad):
        return found
    Y, correction = N[bad].copy(), np.zeros_like(N[bad])
    for _ in range(ROUNDS):
        R = Y - correction
        w, V = np.linalg.eigh(R)
        X = V * np.maximum(w, 0.0)[:, None, :] @ V.conj().swapaxes(1, 2)
        correction = X - R
        last, Y = Y, X.copy()
        Y[:, np.arange(n), np.arange(n)] = 1.0
        if np.abs(Y - last).max() < SETTLED:
            break
    # what the rounds left: a semidefinite matrix whose diagonal is scaled to one
    root = np.sqrt(np.einsum("kii->ki", X).real)
    found[bad] = X / root[:, :, None] / root[:, None, :]
    return np.asarray(found)


def _told(made: CrossSpectra, wanted: Complex, what: str) -> CrossSpectra:
    n = wanted.shape[1]
    off = ~np.eye(n, dtype=bool)
    moved = np.sqrt(np.mean(np.abs(_over_roots(made.matrix) - wanted)[:, off] ** 2, axis=1)) if n > 1 else np.zeros(1)
    if not moved.max() > MOVED:
        return made
    worst, count = int(np.argmax(moved)), int(np.sum(moved > MOVED))
    flag = Flag(
        "W222", Evidence("change of a normalised cross spectrum, rms", float(moved.max()), MOVED),
        f"{what} are of no responses on {count} of {len(moved)} lines (an eigenvalue below zero), most at "
        f"{made.frequencies[worst]:g} Hz: the nearest ones that are differ by {moved.max():.2g}",
    )  # fmt: skip
    return replace(made, flags=(*made.flags, flag))


def _random(target: Target, where: str) -> None:
    if target.kind != "random":
        raise InputError("a sine has no cross spectra", where=where, found="kind='sine'", expected="a random target",
                         hint="phases of a sine: Target(..., phases=)")  # fmt: skip


def _table(given: ArrayLike, shape: tuple[int, int, int], name: str) -> NDArray[np.float64]:
    x = as_array(given, where=name, dtype=float)
    if x.shape not in ((), shape[1:], shape) or not np.all(np.isfinite(x)):
        raise InputError(f"no table of {name}", where=name, found=f"shape {x.shape}",
                         expected=f"a number, {shape[1:]} or {shape}")  # fmt: skip
    return np.broadcast_to(x, shape).copy()
