"""Impact tests: which hits may enter an FRF, and from records to FRF (H1), variance, coherence, certificate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._advice import Advice, Spelling
from .._certificate import Certificate
from .._channels import Channel
from ..errors import InputError, as_array, digests, own_step
from .contradicting import contradicting
from .spectra import checked_decay, exponential, gate, padded_length, smooth_lines, taken_out

SECOND_HIT = 0.2  # share of the main peak that a separate later pulse must reach
RAIL = 3  # consecutive equal samples at the extreme that count as clipped
QUIET = 8  # peak over scatter of the second half, below which there is no hit


@dataclass(frozen=True)
class Hit:
    """One record of an impact test.

    Parameters
    ----------
    name : str
    used : bool
    reason : str
        Why it was rejected; "" when used.
    peak : float
        Force of largest modulus, signed.
    digests : tuple of str
        Digest of each response as recorded, so that a later test can tell whether it was used for training.
    after : int, optional
        Samples of the record from the peak on.
    """

    name: str
    used: bool
    reason: str
    peak: float
    digests: tuple[str, ...] = ()
    after: int | None = None


@dataclass(frozen=True, eq=False)
class TrainingRecords:
    """The records that an FRF was estimated from, and what it leaves of them.

    Parameters
    ----------
    hits : tuple of Hit
        Each record: used, or why not.
    samples : int, optional
        Their length.
    noise_power : array, shape (lines, sensors), optional
        Mean squared residual per sample of record: what one more test will miss by.
    gains : array, shape (sensors, sensors), optional
        Covariance of the relative gains of the hits, each against the FRF of the others: what one more test is
        louder or softer by.
    """

    hits: tuple[Hit, ...] = ()
    samples: int | None = None
    noise_power: ArrayLike | None = None
    gains: ArrayLike | None = None


def unusable(force: NDArray[Any], responses: NDArray[Any], labels: Sequence[str]) -> str:
    """Why no FRF at all can be made of a record: numbers that are missing, or a channel that never moves; else ""."""
    if not (np.all(np.isfinite(force)) and np.all(np.isfinite(responses))):
        return "NaN or inf in the record"
    if not np.any(force):
        return "no hit: the force is zero throughout"
    dead = [label for label, x in zip(labels, responses.T, strict=True) if np.ptp(x) == 0]
    return f"dead: {', '.join(dead)} never moves" if dead else ""


def judge(force: NDArray[Any], responses: NDArray[Any], labels: Sequence[str]) -> str:
    """Reason to reject a usable record, or "".

    Parameters
    ----------
    force : array, shape (samples,)
    responses : array, shape (samples, sensors)
    labels : sequence of str
        Names of the sensors.
    """
    k = int(np.argmax(np.abs(force)))
    peak, noise = abs(force[k]), scatter(force[len(force) // 2 :])
    if peak < QUIET * noise:
        return f"no hit: peak {peak:.3g} is less than {QUIET} times the scatter {noise:.3g} of the second half"
    run = clipped(force, force[k])
    if run:
        return f"clipped force: {run} consecutive samples at the peak {force[k]:.4g}"
    second = second_pulse(force, k, noise)
    if second is not None:
        return f"double hit: a second pulse of {abs(force[second]) / peak:.0%} at sample {second}"
    for label, x in zip(labels, responses.T, strict=True):
        for top in (x.max(), x.min()):
            run = clipped(x, top)
            if run:
                return f"overload: {label} has {run} consecutive samples at {top:.4g}"
    return ""


def scatter(x: NDArray[Any]) -> float:
    """Standard deviation of the noise in `x` from its inner nine tenths: a second hit in there does not count."""
    return float(np.quantile(np.abs(x - np.median(x)), 0.9) / 1.645)


def clipped(x: NDArray[Any], top: float) -> int:
    """Length of the longest stretch of samples at the extreme `top`, 0 where it is no rail.

    The parabola of a crest whose `n` samples in the middle are hidden falls by 8 times the hidden height over the next
    `n` samples. A crest that is only as flat as the last bit hides one or two bits; a cut one hides more.
    """
    start, stop = max(stretches(x == top), key=np.ptp)
    n = stop - start
    if n < RAIL or n == len(x):
        return 0
    fall = max(abs(top - x[max(start - n, 0)]), abs(top - x[min(stop - 1 + n, len(x) - 1)]))
    return int(n) if fall / 8 > 2.5 * last_bit(x) else 0


def last_bit(x: NDArray[Any]) -> float:
    """Smallest step between the levels of a recorded signal, from above; 0 where two levels or one do not tell."""
    tiny = 1e-6 * float(np.ptp(x))
    steps = np.diff(np.unique(x))
    steps = np.unique(steps[steps > tiny])
    finer = np.diff(steps)  # on a grid of levels, steps and their differences are multiples of the last bit
    finer = finer[finer > tiny]
    return (
        float(min(steps[0], *finer)) if len(steps) and len(finer) else float(steps[0]) if len(np.unique(x)) > 2 else 0.0
    )


def stretches(mask: NDArray[Any]) -> NDArray[np.int_]:
    """First sample and end of every stretch of a mask, shape (stretches, 2)."""
    return np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]))).reshape(-1, 2)


def second_pulse(force: NDArray[Any], k: int, noise: float = 0.0) -> int | None:
    """Sample of a later or earlier pulse of the same sign that is separate from the one at k, or None.

    Separate: more than three widths away (at least 8 samples, so that the ringing of an anti-alias filter is not taken
    for a hit). A pulse: a fifth of the peak, and above the noise.
    """
    x = np.sign(force[k]) * force
    width = next(stop - start for start, stop in stretches(x > 0.5 * x[k]) if start <= k < stop)
    far = np.abs(np.arange(len(x)) - k) > max(8, 3 * width)
    candidates = np.flatnonzero(far & (x > max(SECOND_HIT * x[k], 6 * noise)))
    return None if len(candidates) == 0 else int(candidates[np.argmax(x[candidates])])


FORCES = ("force", "moment", "pressure", "line_load", "arbitrary")
DRIVES = (*FORCES, "voltage")  # of a shaker: an FRF per volt
SILENT = 0.01  # share of the lines on which a force may have no energy
NEIGHBOURS = 5  # lines on each side over which residual power is averaged


@dataclass(frozen=True)
class Impact:
    """One record of an impact test: ``values`` (samples, 1 + sensors) with the force first."""

    values: NDArray[np.float64]
    dt: float
    channels: tuple[Channel, ...]
    name: str


def from_hits(
    records: Sequence[Any],
    dt: float | None,
    force: str | int,
    responses: Sequence[str | int],
    reject: bool,
    width: float | None = None,
    decay: float = 0.0,
) -> dict[str, Any]:
    """Arguments of a measured model; parameters and errors as for `MeasuredModel.from_hits`."""
    tests = _gather(records, dt, force, responses)
    check_quantities(tests[0].channels)
    labels = [c.label for c in tests[0].channels[1:]]
    hits: list[Hit] = []
    for t in tests:
        f, y = t.values[:, 0], t.values[:, 1:]
        reason = unusable(f, y, labels) or (judge(f, y, labels) if reject else "") or _repeated(y, hits)
        k = int(np.argmax(np.nan_to_num(np.abs(f), posinf=0.0)))
        peak = float(f[k])
        hits.append(Hit(t.name, not reason, reason, peak if np.isfinite(peak) else 0.0, digests(y), len(f) - k))
    used = [t for t, h in zip(tests, hits, strict=True) if h.used]
    if not used:
        raise InputError(
            "no usable hit",
            where="from_hits",
            found="; ".join(f"{h.name}: {h.reason}" for h in hits),
            expected="at least one clean hit",
            hint=Advice("repeat the hits", Spelling(", or pass reject=False where a rejected one is good enough", "")),
        )
    longest = max(len(t.values) for t in used)
    stack = np.zeros((len(used), longest, used[0].values.shape[1]))
    for row, t in zip(stack, used, strict=True):
        row[: len(t.values)] = t.values
    odd, flags = contradicting(stack[..., 0], stack[..., 1:], [t.name for t in used], labels, reject=reject)
    stack = np.delete(stack, list(odd), axis=0)
    hits = _left_out(hits, odd)
    first = tests[0]
    if width is not None:
        stack[..., 0] *= [gate(f, first.dt, width) for f in stack[..., 0]]
    decay = checked_decay(decay, longest * first.dt, "from_hits")
    peaks = np.argmax(np.abs(stack[..., 0]), axis=1)
    w = np.stack([exponential(longest, first.dt, decay, int(k)) for k in peaks])
    found = estimate(stack[..., 0] * w, stack[..., 1:] * w[..., None], first.dt, labels)
    if decay:
        found = _undamped(found, decay * first.dt, longest, float(np.mean(w**2)))
    return {
        "loads": first.channels[:1],
        "sensors": first.channels[1:],
        "records": TrainingRecords(tuple(hits), longest, found.pop("noise_power", None), found.pop("gains", None)),
        "flags": flags,
        **found,
    }


def _left_out(hits: list[Hit], odd: Mapping[int, str]) -> list[Hit]:
    """The hits without those that contradict the others, counted among the used ones."""
    used = [k for k, hit in enumerate(hits) if hit.used]
    wrong = {used[i]: reason for i, reason in odd.items()}
    return [replace(hit, used=False, reason=wrong[k]) if k in wrong else hit for k, hit in enumerate(hits)]


def _undamped(found: dict[str, Any], decay: float, samples: int, power: float) -> dict[str, Any]:
    """What was estimated under exponential windows of this mean square, without their damping; `decay` per sample.

    Noise was recorded before it was windowed, at one level along the record: it has that level again.
    """
    found = {**found, "H": taken_out(found["H"], decay, samples)}
    if "variance" in found:
        found["variance"] = found["variance"] / power
        found["noise_power"] = found["noise_power"] / power
        known = found["certificate"]
        found["certificate"] = replace(known, source=f"{known.source} (under an exponential window)")
    return found


def _repeated(responses: NDArray[Any], hits: Sequence[Hit]) -> str:
    """Why a record is no hit of its own: it is one of those before it. Twice the same would look like perfect data."""
    same = [h.name for h in hits if h.digests == digests(responses)]
    return f"the same record as {same[0]}" if same else ""


def check_quantities(channels: Sequence[Channel], drives: Sequence[str] = FORCES) -> None:
    """Refuse a force that is no force (none of `drives`), and a response that is one."""
    force, *responses = channels
    if force.quantity not in drives:
        raise InputError(
            "the unit of the force channel is no unit of a force",
            where=f"channel {force.label}",
            found=f"{force.unit} ({force.quantity})",
            expected="N, or arbitrary",
            hint=f"choose another channel, or state its unit (--unit {force.label}=N, or {force.label}=arbitrary)",
        )
    wrong = [c for c in responses if c.quantity in FORCES and c.quantity != "arbitrary"]
    if wrong:
        raise InputError(
            "a response channel is a force",
            where=f"channel {wrong[0].label}",
            found=wrong[0].unit,
            expected="a unit of motion or strain",
            hint="are force and response swapped?",
        )


def estimate(force: NDArray[Any], responses: NDArray[Any], dt: float, labels: Sequence[str]) -> dict[str, Any]:
    """H1 and what several hits tell of its errors.

    Parameters
    ----------
    force : array, shape (hits, samples)
    responses : array, shape (hits, samples, sensors)
    dt : float
    labels : sequence of str
        Names of the sensors.

    Returns
    -------
    dict
        ``frequencies, H`` and, from two hits on, ``noise_power, variance, coherence, gains, certificate``.

    Notes
    -----
    Bendat & Piersol, Random Data, ch. 6 and 9, over records padded to twice their length. H takes one degree of
    freedom per line, so residual power is divided by hits - 1; the variance of H1 is that power over the summed force.
    """
    from scipy import fft

    n, samples, _ = responses.shape
    padded = padded_length(samples)
    F, Y = fft.rfft(force, padded, axis=1), fft.rfft(responses, padded, axis=1)
    Sff = np.sum(np.abs(F) ** 2, axis=0)
    silent = Sff <= (np.finfo(float).eps ** 2) * Sff.max()
    if np.mean(silent) > SILENT:
        raise InputError(
            "the force has no energy on many lines",
            where="from_hits",
            found=f"{int(np.sum(silent))} of {len(Sff)} lines",
            expected="a broadband force",
            hint="hit with a harder tip, or use a random force",
        )
    Sff = np.where(silent, np.inf, Sff)  # a zero of a symmetric pulse: nothing is known there, H = 0
    Sfy = np.sum(F.conj()[..., None] * Y, axis=0)
    H = Sfy / Sff[:, None]
    found: dict[str, Any] = {"frequencies": np.fft.rfftfreq(padded, dt), "H": H[..., None]}
    if n == 1:
        return found
    residual = np.sum(np.abs(Y - H * F[..., None]) ** 2, axis=0) / (n - 1)
    floor = np.finfo(float).eps ** 2 * np.mean(np.abs(Y) ** 2, axis=(0, 1))  # what rounding leaves of exact hits
    certificate, gains = leave_one_out(F, Y, responses, labels, padded)
    power = np.maximum(smooth_lines(residual, NEIGHBOURS), np.maximum(floor, np.finfo(float).tiny))
    Syy = np.sum(np.abs(Y) ** 2, axis=0)
    return {
        **found,
        "noise_power": power / samples,
        "variance": (power / Sff[:, None])[..., None],
        "coherence": np.minimum(np.abs(Sfy) ** 2 / (Sff[:, None] * np.where(Syy > 0, Syy, 1.0)), 1.0),
        "gains": gains,
        "certificate": certificate,
    }


def leave_one_out(
    F: NDArray[Any], Y: NDArray[Any], responses: NDArray[Any], labels: Sequence[str], padded: int
) -> tuple[Certificate, NDArray[Any]]:
    """Each hit predicted from the others, from spectra F (hits, lines) and Y (hits, lines, sensors).

    A certificate, and the covariance (sensors, sensors) of the relative gains that the hits have to it.
    """
    from scipy import fft

    Sff, Sfy = np.sum(np.abs(F) ** 2, axis=0), np.sum(F.conj()[..., None] * Y, axis=0)
    predicted, gains = [], []
    for f, y in zip(F, Y, strict=True):
        rest = Sff - np.abs(f) ** 2  # zero where only this hit has energy
        H = (Sfy - f.conj()[:, None] * y) / np.where(rest > 0, rest, 1.0)[:, None]
        response = H * f[:, None]
        energy = np.sum(np.abs(response) ** 2, axis=0)
        gains.append(np.sum((response.conj() * y).real, axis=0) / np.where(energy > 0, energy, 1.0) - 1)
        predicted.append(fft.irfft(response, padded, axis=0)[: responses.shape[1]])
    certificate = Certificate.compare(
        np.concatenate(predicted),
        np.concatenate(list(responses)),
        labels,
        source=f"{len(F)} hits, each predicted from the others",
    )
    return certificate, np.einsum("hi,hj->ij", gains, gains) / len(F)


# -- records ----------------------------------------------------------------------------------------------------------
def _gather(
    records: Sequence[Any], dt: float | None, force: str | int, responses: Sequence[str | int]
) -> tuple[Impact, ...]:
    if not len(records):
        raise InputError("no records", where="from_hits", found="an empty list", expected="at least one hit")
    if isinstance(responses, str | int):
        responses = [responses]
    if not len(responses):
        raise InputError("no responses", where="from_hits", found=responses, expected="at least one channel")
    tests = tuple(_test(r, dt, [force, *responses], i) for i, r in enumerate(records))
    steps = sorted({t.dt for t in tests})
    if steps[-1] / steps[0] - 1 > 1e-6:
        raise InputError(
            "the records have different steps", where="from_hits", found=f"dt = {steps} s", expected="one dt"
        )
    units = {tuple(c.unit for c in t.channels) for t in tests}
    if len(units) > 1:
        raise InputError(
            "the records have different units", where="from_hits", found=sorted(units), expected="one unit per channel"
        )
    return tests


def _test(record: Any, dt: float | None, wanted: list[str | int], i: int) -> Impact:
    values = as_array(getattr(record, "values", record), where=f"hit {i + 1}", dtype=float)
    name = str(getattr(record, "name", "") or f"hit {i + 1}")
    if values.ndim != 2 or len(values) < 4:
        raise InputError(
            "a record is a table", where=name, found=f"shape {values.shape}", expected="(samples, channels)"
        )
    given = getattr(record, "channels", None) or getattr(record, "labels", None)
    given = [f"channel {j}" for j in range(values.shape[1])] if given is None else given
    described = [c if isinstance(c, Channel) else Channel(label=str(c)) for c in given]
    if len(described) != values.shape[1]:
        raise InputError(
            "channels and columns do not fit", where=name, found=f"{len(described)}", expected=f"{values.shape[1]}"
        )
    index = [_index(w, [c.label for c in described], name) for w in wanted]
    if len(set(index)) < len(index):
        raise InputError("a channel is named twice", where=name, found=wanted, expected="a force and other channels")
    load, *sensors = (described[j] for j in index)
    return Impact(values[:, index], own_step(getattr(record, "dt", None), dt, name), (load, *sensors), name)


def _index(wanted: str | int, labels: Sequence[str], where: str) -> int:
    if wanted in labels:
        return list(labels).index(str(wanted))
    j = int(wanted) if str(wanted).lstrip("-").isdecimal() else None
    if j is None or not -len(labels) <= j < len(labels):
        raise InputError(
            "no such channel", where=where, found=repr(wanted), expected=f"one of {list(labels)} or an index"
        )
    return j % len(labels)
