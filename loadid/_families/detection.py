"""Whether an answer tells a load from noise at all, in every kind of problem; if not, which loads it rules out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from structures._channels import Channel
from structures._flags import Flag

from .. import _guards as guards
from .._inverse.diagnosis.detection import (
    CHANCE,
    FEWEST,
    LOWEST,
    TRIED,
    EnergyTest,
    SupportTest,
    largest,
    noise_alone,
)
from .._inverse.path import FactoredPath, RegularizationPath
from .._inverse.problem import whiten

if TYPE_CHECKING:
    from .._inverse.gaussian.model import FilterModel
    from .._inverse.svd import SVDPath
    from .._learning.linear import LinearEngine
    from .posing import Posed
    from .posing.gathered import LineData
    from .posing.sparsity import SparseChoice
    from .posing.steady import StaticProblem

Array = NDArray[Any]

PULSE = 10  # samples of a hit
FINEST, WORK = 2048, 2e8  # lines of a track, and the operations that they may cost
COARSEST = 16  # lines below which a track is not asked
ROUNDED = 1e-12  # of the power of a channel, left by the difference of two that are nearly equal
SEEN = 0.95  # of all cases
THERE = 0.5  # share of the samples of a channel that must be there


@dataclass(frozen=True)
class NotTold:
    """No load is told from noise.

    Parameters
    ----------
    chance : float
        That noise alone explains as much.
    flag : Flag
        With the loads that would have been told.
    facts : dict
        ``told_from``: size of each load from which it would have been told in 95 % of all cases, in its unit: peak of a
        hit in a record, of one load alone at one reading, or of one size on all lines. ``told_from_throughout``: rms of
        a wide-band load in a record. Of a track ``told_from`` is the rms of a load that moves as its prior says.
    """

    chance: float
    flag: Flag
    facts: dict[str, Any]


def of_history(
    posed: Posed, lam: float, loads: Sequence[Channel], dt: float, acting: NDArray[np.bool_] | None
) -> NotTold | None:
    """Of a record: a hit in the middle of the time at which loads act, and a wide-band load throughout."""
    test = noise_alone(posed.path, lam, posed.noise.sigma)
    if test is None:
        return None
    samples, when = len(posed.values), np.flatnonzero(acting) if acting is not None else np.arange(len(posed.values))
    hit, wide = np.zeros(samples), np.zeros(samples)
    pulse = when[len(when) // 2 :][:PULSE]
    hit[pulse] = half_sine(len(pulse))
    wide[when] = np.random.default_rng(0).standard_normal(len(when))

    def explained(history: Array, j: int) -> Callable[[float], float]:
        load = np.zeros((samples, len(loads)))
        load[:, j] = history
        response = _response(posed, load, lam)
        return lambda at: float(np.sum(response * _response(posed, posed.path.resolve(load, at), lam)))

    return _not_told(test.chance, loads, f"a hit (half sine of {1e3 * len(pulse) * dt:.3g} ms) of {{}}",
                      _sizes(test, [explained(hit, j) for j in range(len(loads))]),
                      "a wide-band load throughout of {} rms",
                      _sizes(test, [explained(wide / _rms(wide[when]), j) for j in range(len(loads))]))  # fmt: skip


def of_readings(posed: StaticProblem, lam: float, loads: Sequence[Channel]) -> NotTold | None:
    """Of static readings: one load alone, in one reading."""
    test = noise_alone(posed.base, lam, posed.noise.sigma)
    if test is None:
        return None
    return _not_told(test.chance, loads, "a load of {} alone", _in_columns(test, posed.base, posed.whitening @ posed.H))


def of_line(path: RegularizationPath, lam: float, sigma: float | None, H: Array, level: Array,
            loads: Sequence[Channel]) -> NotTold | None:  # fmt: skip
    """Of complex amplitudes on one line, in a path of real parts before imaginary ones."""
    test = noise_alone(path, lam, sigma)
    if test is None:
        return None
    seen = H / level[:, None]
    both = np.block([[seen.real, -seen.imag], [seen.imag, seen.real]])
    return _not_told(test.chance, loads, "an amplitude of {} alone", _in_columns(test, path, both)[: len(loads)])


def of_lines(H: Array, line: LineData, loads: Sequence[Channel], unit: str) -> NotTold | None:
    """Of spectra: one load alone, of one size on all lines."""
    if line.part_of is not None or not np.isfinite(line.averages):
        return None
    whitened, X = H / np.sqrt(line.power)[..., None], line.X / np.sqrt(line.power)[..., None]
    U, s, _ = np.linalg.svd(whitened, full_matrices=False)
    beta2 = np.sum(np.abs(U.conj().swapaxes(1, 2) @ X) ** 2, axis=-1)
    # an average of n squares of unit complex numbers is a chi-square of 2 n degrees over 2 n
    many = 2 * max(float(line.averages * line.fullness), 1.0) if line.kind == "cross spectra" else 2.0
    many /= 1 if line.kind == "cross spectra" else X.shape[-1]
    outside = max(float(np.sum(np.abs(X) ** 2) - np.sum(beta2)), 0.0)
    path = FactoredPath(s.ravel(), np.ones(s.size), np.sqrt(beta2).ravel(), many * outside, round(many * H.shape[0] *
                        H.shape[1]), weight=np.full(s.size, many))  # fmt: skip
    test = noise_alone(path, 1.0, 1.0 if line.known else None)
    if test is None:
        return None
    energies = _on_lines(path, many, s, np.abs(U.conj().swapaxes(1, 2) @ whitened) ** 2)
    lam = test.told_by(lambda at: float(energies(at)[:, 0].sum()))
    sizes = tuple(test.sizes(energies(lam).sum(axis=0), lam).tolist())
    if line.kind == "cross spectra":
        sizes = tuple(size**2 for size in sizes)
    return _not_told(test.chance, loads, "a load of {} on every line", sizes, unit=unit)


def of_track(model: FilterModel, Y: Array, known: bool, loads: Sequence[Channel]) -> NotTold | None:
    """Of samples (samples, sensors; NaN is missing) behind a filter: a load that moves as its prior says, throughout.

    On each line of the spectra the operator is what the filter believes: the cross spectrum of sensors and load over
    the root of the load's own, whitened by what else moves the sensors. Blocks of a record are averaged. A constant
    part is not asked. ``known``: the level of the noise is stated.
    """
    there = np.isfinite(Y)
    share = there.mean(axis=0)
    lines = int(np.clip(WORK / model.n**3, 4 * COARSEST, FINEST))
    blocks = -(-len(Y) // (2 * lines))
    length = len(Y) // blocks
    if length < 2 * COARSEST or np.min(share) < THERE:
        return None
    whole = (np.where(there, Y, 0.0) / np.sqrt(share))[: blocks * length].reshape(blocks, length, -1)
    turns = 2 * np.pi * np.arange(1, (length - 1) // 2 + 1) / length
    try:
        columns, root, spread = _by_prior(model, turns)
    except np.linalg.LinAlgError:  # a line on which the load goes on for ever
        return None
    if not (np.isfinite(columns).all() and np.isfinite(root).all() and np.any(columns)):
        return None
    X = np.fft.rfft(whole, axis=1)[:, 1 : len(turns) + 1].transpose(1, 2, 0) / np.sqrt(length)
    seen, X = np.linalg.solve(root, columns), np.linalg.solve(root, X)
    U, s, _ = np.linalg.svd(seen, full_matrices=False)
    beta2 = np.sum(np.abs(U.conj().swapaxes(1, 2) @ X) ** 2, axis=-1) / blocks
    many = 2.0 * blocks
    outside = max(float(np.sum(np.abs(X) ** 2)) / blocks - float(np.sum(beta2)), 0.0)
    path = FactoredPath(s.ravel(), np.ones(s.size), np.sqrt(beta2).ravel(), many * outside,
                        round(many * X.shape[0] * X.shape[1]), weight=np.full(s.size, many))  # fmt: skip
    test = noise_alone(path, 1.0, 1.0 if known else None)
    if test is None:
        return None
    energies = _on_lines(path, many, s, np.abs(U.conj().swapaxes(1, 2) @ seen) ** 2)
    lam = test.told_by(lambda at: float(energies(at)[:, 0].sum()))
    each = energies(lam)
    rms = np.sqrt(2 / length * np.sum(spread, axis=0)) / np.sqrt(_unlucky(each, many))
    return _not_told(test.chance, loads, "a load of {} rms that moves as its prior says",
                      tuple((test.sizes(each.sum(axis=0), lam) * rms).tolist()))  # fmt: skip


def of_fields(paths: Sequence[SVDPath], sigma: float | None, seen: Array, unit: str) -> NotTold | None:
    """Of frames of readings that smooth fields explain: a load all over, the same in every frame.

    Parameters
    ----------
    paths : sequence of SVDPath
        Of each shape of the functions, whitened, with one lambda for all frames.
    sigma : float or None
        Noise level of the whitened readings.
    seen : array, shape (sensors,)
        Whitened readings under a unit load all over.
    unit : str
    """
    told: list[tuple[EnergyTest, float]] = []
    for path in paths:
        y, s = np.atleast_2d(path.problem.y.T), path.singular_values
        U, frames, lam = path.U[:, : len(s)], len(y), np.geomspace(LOWEST, 1.0, TRIED)
        if sigma is None and y.size < FEWEST:
            return None
        passed = s**2 / (s**2 + (lam[:, None] * float(path.scale)) ** 2)
        test = EnergyTest(lam, passed @ np.sum((y @ U) ** 2, axis=0), frames * passed.sum(axis=1),
                          frames * np.sum(passed**2, axis=1), y.size, float(np.sum(y**2)), sigma)  # fmt: skip
        if len(paths) * test.chance < CHANCE:
            return None
        energy = frames * (passed @ (U.T @ seen) ** 2)
        told.append((test, min(float(test.sizes(e[None], x)[0]) for e, x in zip(energy, lam, strict=True))))
    chance = min(1.0, len(paths) * min(test.chance for test, _ in told))
    size = min(size for _, size in told)
    flag = guards.not_told(chance, f"{size:.3g} {unit} all over")
    return NotTold(chance, flag, {"told_from": (size,)})


def of_map(linear: LinearEngine, white: Array, seen: Array, loads: Sequence[Channel], what: str) -> NotTold | None:
    """Of readings behind a learned map: the energy of its outputs, and the largest of them.

    Parameters
    ----------
    linear : LinearEngine
    white : array (n, [samples,] sensors)
        Readings in units of their noise.
    seen : array (loads, [samples,] sensors)
        Response to a unit load of the size that is named, in the same units.
    loads : sequence of Channel
    what : str
        That load in words.
    """
    if not (np.isfinite(white).all() and np.any(linear.noise_std > 0)):
        return None
    weights, lags = linear.weights, linear.together
    found, one = linear.over_noise(white), linear.over_noise(seen)
    samples = white.shape[1] if white.ndim == 3 else 1
    count = len(white) * samples
    left = np.maximum(samples - np.arange(len(lags)), 0)
    edf2 = len(white) * float(left @ lags + left[1:] @ lags[1:])
    # asked twice: with the largest output
    energy, twice = float(np.sum((found * weights) ** 2)), np.ones(2)
    test = EnergyTest(twice, energy * twice, count * float(np.sum(weights**2)) * twice, edf2 * twice, white.size,
                      float(np.sum(white**2)), 1.0)  # fmt: skip
    chance, least = largest(float(np.max(np.abs(found))), count * int(np.count_nonzero(linear.noise_std)))
    chance = min(test.chance, len(twice) * chance)
    if chance < CHANCE:
        return None
    each = tuple(range(1, one.ndim))
    over = np.max(np.abs(one), axis=each)
    by_largest = np.divide(least, over, out=np.full(len(over), np.inf), where=over > 0)
    sizes = np.minimum(test.sizes(np.sum((one * weights) ** 2, axis=each), 1.0), by_largest)
    return _not_told(chance, loads, what, tuple(sizes.tolist()))


def of_support(chosen: SparseChoice, loads: Sequence[Channel]) -> NotTold | None:
    """Of few waveforms of a dictionary: one alone, in the middle of the record."""
    problem, atoms, fit = chosen.problem, chosen.atoms, chosen.fit
    y, best = problem.y.reshape(-1), fit.support[[int(np.argmax(np.abs(fit.x)))]]
    whole, column = float(y @ y), atoms.columns(best)[:, 0]
    energies = {len(fit.x): whole - fit.residual2, 1: float(column @ y) ** 2 / float(column @ column)}
    test = SupportTest(energies, atoms.n, problem.data, whole, problem.noise.sigma)
    if test.chance < CHANCE:
        return None
    sizes = np.full(len(loads), np.inf)
    for i, j in enumerate(chosen.loads):
        mine = np.flatnonzero(atoms.load == i)
        middle = mine[[len(mine) // 2]]
        response = float(np.linalg.norm(atoms.columns(middle)))
        if response > 0:
            sizes[j] = test.least * float(abs(atoms.histories(middle)).max()) / response
    return _not_told(test.chance, loads, "one waveform alone of {}", tuple(sizes.tolist()))


def half_sine(samples: int = PULSE) -> Array:
    """Samples of a hit of unit peak, or its beginning."""
    return np.asarray(np.sin(np.pi * (np.arange(samples) + 0.5) / PULSE))


# -- inside ------------------------------------------------------------------------------------------------------------
def _response(posed: Posed, load: Array, lam: float) -> Array:
    """Whitened response (samples, sensors) of a load, beyond that of none: a start or an offset may make some."""
    with_it, without = (np.subtract(*posed.compare(g, lam, None)) for g in (load, np.zeros_like(load)))
    return whiten(with_it - without, posed.noise.level, axis=1)


def _in_columns(test: EnergyTest, path: RegularizationPath, columns: Array) -> tuple[float, ...]:
    """Sizes of single unknowns, by the matrix (data, unknowns) of one frame."""
    each = np.eye(columns.shape[1])
    lam = test.told_by(lambda at: float(columns[:, 0] @ (columns @ path.resolve(each[0], at))))
    energy = np.sum(columns * (columns @ path.resolve(each, lam).T), axis=0)
    return tuple(test.sizes(energy, lam).tolist())


def _sizes(test: EnergyTest, explained: Sequence[Callable[[float], float]]) -> tuple[float, ...]:
    """Size of each load; all are asked at the lambda that tells the first."""
    lam = test.told_by(explained[0])
    return tuple(test.sizes(np.array([one(lam) for one in explained]), lam).tolist())


def _on_lines(path: RegularizationPath, many: float, s: Array, parts: Array) -> Callable[[float], Array]:
    """Energy (lines, loads) that one load alone explains, by lambda; s (lines, modes), parts (lines, modes, loads)."""

    def at(lam: float) -> Array:
        passed = s**2 / (s**2 + (lam * float(path.scale)) ** 2)
        return np.asarray(many * np.sum(passed[..., None] * parts, axis=1))

    return at


def _unlucky(energy: Array, many: float) -> Array:
    """Share of their mean energy (lines, loads) that 95 % of random loads have, each line a chi-square of `many`."""
    from scipy.special import chdtri

    mean = np.maximum(energy.sum(axis=0), np.finfo(float).tiny)
    free = many * mean**2 / np.maximum(np.sum(energy**2, axis=0), np.finfo(float).tiny)
    return np.asarray(chdtri(free, SEEN) / free)


def _by_prior(model: FilterModel, turns: Array) -> tuple[Array, Array, Array]:
    """Sensors per root of each load's own spectrum, the root of what else moves them, and the loads' own spectra.

    (lines, sensors, loads), (lines, sensors, sensors) and (lines, loads) at `turns` radians a sample.
    """
    m, shift = model.m, np.exp(-1j * turns)[:, None, None]
    both = np.vstack([model.H, model.Cp])
    read = np.linalg.solve(np.eye(model.n) - model.F.T * shift, np.broadcast_to(both.T.astype(complex), (
        len(turns), *both.T.shape))).swapaxes(1, 2) * shift  # fmt: skip
    pushed = read @ model.LQ
    power = pushed @ pushed.conj().swapaxes(1, 2)
    if model.S is not None:
        with_noise = read @ model.S
        power[:, :, :m] += with_noise
        power[:, :m, :] += with_noise.conj().swapaxes(1, 2)
    spread = np.maximum(np.diagonal(power, axis1=1, axis2=2).real[:, m:], np.finfo(float).tiny)
    columns = power[:, :m, m:] / np.sqrt(spread)[:, None, :]
    noise = model.LR @ model.LR.T
    rest = power[:, :m, :m] + noise - columns @ columns.conj().swapaxes(1, 2)
    large = ROUNDED * np.diagonal(power, axis1=1, axis2=2).real[:, :m]
    return columns, np.linalg.cholesky(rest + large[:, :, None] * np.eye(m)), spread


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _not_told(
    chance: float, loads: Sequence[Channel], what: str, sizes: tuple[float, ...], other: str = "",
    others: tuple[float, ...] = (), unit: str = "{}",
) -> NotTold:  # fmt: skip
    """The flag with the loads that are seen best and least, one kind or two."""
    kinds = [(what, sizes), *([(other, others)] if others else [])]

    def said(j: int) -> str:
        return " or ".join(words.format(f"{size[j]:.3g} {unit.format(loads[j].unit)}") for words, size in kinds)

    seen = np.flatnonzero(np.isfinite(sizes))
    best, least = (int(seen[pick(np.asarray(sizes)[seen])]) for pick in (np.argmin, np.argmax))
    text = said(best) if len(loads) == 1 else (
        f"at {loads[best].label} {said(best)}" if best == least
        else f"at {loads[best].label} {said(best)}, at {loads[least].label}, which is seen least, {said(least)}"
    )  # fmt: skip
    return NotTold(chance, guards.not_told(chance, text),
                   {"told_from": sizes, **({"told_from_throughout": others} if others else {})})  # fmt: skip
