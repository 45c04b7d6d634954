"""Reciprocity of a table of FRFs: which channel, force or entry breaks it, by how much, and the table without that.

Where sensors and loads share places, a linear structure at rest answers at a to a force at b as it answers at b to the
same force at a (Maxwell, Betti). A channel of the wrong gain breaks that with every place that has both, an entry with
one. The driving forces at a place are as good an explanation as its channel; what sets them right is the same.

Which of two entries that differ is the wrong one is told where peaks are those of single modes: there the table is of
rank one, ``H_ab H_cd = H_ad H_cb``, whatever gains its rows and columns have.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._channels import Channel, Dof
from .._flags import Evidence, Flag
from ..errors import InputError
from .kinds import ORDER, WRONG_SIGN, factors, feeds_back

Array = NDArray[Any]
Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

ERROR = 0.07  # relative error that every entry is taken to have ...
BELIEF = 8.0  # ... and the pairs of entries that this is worth beside those of the table
CHANCE = 0.005  # that a sound table is accused
CENTRE = 0.455  # median of the square of a standard normal
LINES = 256  # lines that are asked
AROUND = 9  # lines over which the size of a response is taken
QUIET = 0.03  # of the mean power, below which lines count less
PEAK = 3.0  # power of a peak over the median
PEAKS = 12
HALF = 0.5  # of the difference, that a factor leaves where it explains a pair
ROUGH = 0.15  # distance from rank one of sound peaks
CLEAR = 2.0  # times by which one entry must be further from rank one than its twin
FACTORS = (9.80665, 1e3, 1e6, 1e2, 10.0, np.sqrt(2.0), 0.0254, 4.4482216, 2 * np.pi)
NEAR = 0.05  # relative distance within which a gain is one of these factors
ALIKE = 1.5  # times the difference that the best explanation leaves, up to which another is as good
FEW = 16  # lines from which on noise is seen
CALM = 0.25  # share of the lines that are quiet
MOST = 24  # shared places beyond which exchanges are not tried


@dataclass(frozen=True)
class FrfFault:
    """What explains that a table of FRFs is not reciprocal.

    Parameters
    ----------
    kind : str
        ``gain, unit`` (a gain that is a factor between units), ``polarity, exchanged`` or ``other``.
    sensors, loads : tuple of str
        Entries at fault: all of these sensors, or, where there are loads, their entries for these loads. Of
        ``exchanged`` the two that changed places.
    factor : float
        Of a gain; 1 otherwise.
    mismatch : float
        Largest relative difference of two entries that should be equal.
    limit : float
        What errors of the FRF leave of such a difference.
    without : float
        The largest one over its limit with this explanation; 0 where an entry is left out.
    alternatives : tuple of str
        What explains it as well, in words.
    """

    kind: str
    sensors: tuple[str, ...]
    loads: tuple[str, ...]
    factor: float
    mismatch: float
    limit: float
    without: float
    alternatives: tuple[str, ...] = ()

    def __str__(self) -> str:
        what = _WORDS[self.kind].format(factor=self.factor)
        who = " and ".join(self.sensors) if not self.loads else " and ".join(
            f"{s} / {load}" for s in self.sensors for load in self.loads)  # fmt: skip
        some = f"; or {', or '.join(self.alternatives[:3])}" if self.alternatives else ""
        return f"{who} {what}{some}"

    @property
    def certain(self) -> bool:
        """Whether nothing else explains it as well."""
        return not self.alternatives

    @property
    def correctable(self) -> bool:
        """Whether a table can be freed of it."""
        return self.kind in ("gain", "unit", "polarity", "exchanged") and bool(self.sensors)

    def corrected(self, H: Array, sensors: Sequence[str], loads: Sequence[str], *, power: int = 1) -> Array:
        """The table (lines, sensors, loads) without the fault; of a variance the `power` of a gain is 2.

        Raises
        ------
        InputError
            A fault that no factor and no exchange mends, or a table that has no such sensor or load.
        """
        if not self.correctable:
            raise InputError("no correction mends this", where="corrected", found=str(self),
                             expected="a gain, a polarity or an exchange",
                             hint="leave the sensor out, or measure the entry again")  # fmt: skip
        missing = [*(s for s in self.sensors if s not in sensors), *(k for k in self.loads if k not in loads)]
        if missing:
            raise InputError("the table has no such channel", where="corrected", found=[*sensors, *loads],
                             expected=missing)  # fmt: skip
        rows = np.array([list(sensors).index(s) for s in self.sensors])
        columns = np.array([list(loads).index(k) for k in self.loads] or range(H.shape[2]))
        at = np.ix_(np.arange(len(H)), rows, columns)
        out = np.array(H)
        if self.kind == "exchanged":
            along = 1 if len(rows) == 2 else 2
            out[at] = np.flip(H[at], axis=along)
        else:
            out[at] /= self.factor**power
        return out


_WORDS = {
    "gain": "reads {factor:.3g} times what reciprocity says",
    "unit": "reads {factor:.4g} times what reciprocity says: a factor of units",
    "polarity": "has the wrong sign",
    "exchanged": "are exchanged",
    "other": "is not reciprocal, whatever its gain",
}


@dataclass(frozen=True, eq=False)
class ReciprocalPairs:
    """FRFs as mobilities, on lines of which some are asked, and where sensors and loads share places.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz, above zero.
    H : array, shape (lines, sensors, loads), complex
    turn : array, shape (lines, sensors), complex
        What makes mobilities of H.
    noise : array like H
        Variance of H that is known of.
    sensors, loads : tuple of Channel
    pairs : tuple of ((row, column), (row, column))
        Entries that should be equal, but for `sign`.
    sign : array, shape (pairs,)
    drive : tuple of (row, column)
        Drive points.
    places : dict
        Of the rows.
    """

    frequencies: Real
    H: Complex
    turn: Complex
    noise: Real
    sensors: tuple[Channel, ...]
    loads: tuple[Channel, ...]
    pairs: tuple[tuple[tuple[int, int], tuple[int, int]], ...]
    sign: Real
    drive: tuple[tuple[int, int], ...]
    places: dict[int, tuple[int, int]]

    @property
    def mobility(self) -> Complex:
        """The entries, as mobilities."""
        return np.asarray(self.H * self.turn[..., None])

    def entries(self) -> tuple[Complex, Complex]:
        """Both entries of each pair, (lines, pairs)."""
        M, (first, second) = self.mobility, (np.array([p[k] for p in self.pairs]).T for k in (0, 1))
        return M[:, first[0], first[1]], self.sign * M[:, second[0], second[1]]

    def signs(self) -> float:
        """Largest share of a drive point that feeds energy back, over what is taken for a wrong sign."""
        back = feeds_back(self.frequencies, self.H, self.sensors, self.loads)
        return float(np.max(np.nan_to_num([back[i, j] for i, j in self.drive]))) / WRONG_SIGN

    def mismatch(self) -> tuple[Real, Real]:
        """Relative difference of the entries of each pair, root mean square over the lines: 2 at most; and its std.

        Over their own size and that of the drive points of their places, so that neither antiresonances nor a weak
        entry of a strong place count; what is known as noise is taken off. The std is that of errors of one, half of
        an entry, half of its place.
        """
        a, b = self.entries()
        M = self.mobility
        power = np.stack([_around(np.abs(M[:, i, j]) ** 2) for i, j in self.drive], axis=1)
        of = {self.places[i]: k for k, (i, _) in enumerate(self.drive)}
        level = np.stack([np.sqrt(power[:, of[self.places[p[0]]]] * power[:, of[self.places[q[0]]]])
                          for p, q in self.pairs], axis=1)  # fmt: skip
        known = np.abs(self.turn[..., None]) ** 2 * self.noise
        noise = np.stack([known[:, p[0], p[1]] + known[:, q[0], q[1]] for p, q in self.pairs], axis=1)
        size = 0.5 * (np.abs(a) ** 2 + np.abs(b) ** 2)
        scale = size + 0.5 * level + QUIET * np.mean(size + level, axis=0) + noise
        off = np.sqrt(np.maximum(np.mean((np.abs(a - b) ** 2 - noise) / scale, axis=0), 0.0))
        return np.asarray(off), np.sqrt(np.mean((size + level) / scale, axis=0))


def _around(power: Real) -> Real:
    from scipy.ndimage import uniform_filter1d

    return np.asarray(uniform_filter1d(power, min(AROUND, len(power)), mode="nearest"))


def check(
    frequencies: Real, H: Complex, sensors: Sequence[Channel], loads: Sequence[Channel], variance: Real | None = None
) -> FrfFault | None:
    """What breaks the reciprocity of a table; None where all pairs of entries agree, or where there are none.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz.
    H : array, shape (lines, sensors, loads), complex
    sensors, loads : sequence of Channel
        Places are known by labels that name a DOF (``12+Z``).
    variance : array like H, optional
        Variance of H.
    """
    table = _table(np.asarray(frequencies), H, tuple(sensors), tuple(loads), variance)
    if table is None:
        return None
    off, std = table.mismatch()
    if np.all(off <= _limits(0 * off, std)):
        return None
    found, limit = _explained(table, off, std)
    worst = int(np.argmax(off / limit))
    return None if found is None else replace(found, mismatch=float(off[worst]), limit=float(limit[worst]))


def flags(
    frequencies: Real, H: Complex, sensors: Sequence[Channel], loads: Sequence[Channel], variance: Real | None = None
) -> tuple[Flag, ...]:
    """W216 where a table is not reciprocal; the arguments are those of `check`."""
    fault = check(frequencies, H, sensors, loads, variance)
    if fault is None or (fault.kind == "polarity" and _fed_back(fault, frequencies, H, sensors, loads)):
        return ()
    evidence = Evidence("relative difference of entries that should be equal", fault.mismatch, fault.limit)
    mend = "model.corrected() is the model without it" if fault.correctable and fault.certain else ""
    return (Flag("W216", evidence, f"the FRFs are not reciprocal: {fault}", mend),)


def _fed_back(
    fault: FrfFault, frequencies: Real, H: Complex, sensors: Sequence[Channel], loads: Sequence[Channel]
) -> bool:
    """Whether the drive point of a turned sensor says so already (W207)."""
    if fault.loads:
        return False
    back = feeds_back(frequencies, H, sensors, loads)
    return bool(np.any(back[[s.label in fault.sensors for s in sensors]] > WRONG_SIGN))


# -- the table ---------------------------------------------------------------------------------------------------------
def _table(
    f: Real, H: Complex, sensors: tuple[Channel, ...], loads: tuple[Channel, ...], variance: Real | None
) -> ReciprocalPairs | None:
    rows = {i: d for i, c in enumerate(sensors) if c.quantity in ORDER and (d := _dof(c)) is not None}
    columns = {j: d for j, c in enumerate(loads) if c.quantity != "voltage" and (d := _dof(c)) is not None}
    drive = tuple((i, j) for i, d in rows.items() for j, e in columns.items() if d.key == e.key)
    pairs = tuple(
        ((i, k), (j, m)) for (i, m), (j, k) in combinations(drive, 2) if rows[i].key != rows[j].key
    )  # fmt: skip
    if not pairs or not np.any(f > 0):
        return None
    sign = [rows[i].sign * columns[k].sign * rows[j].sign * columns[m].sign for (i, k), (j, m) in pairs]
    step = max(1, -(-len(f) // LINES))
    pick = np.flatnonzero(f > 0)[::step]
    turn = factors(sensors, f[pick], "mobility")
    noise = _floor(H[pick], sensors) if variance is None else variance[pick]
    return ReciprocalPairs(f[pick], H[pick], turn, noise, sensors, loads, pairs, np.array(sign, float), drive,
                 {i: rows[i].key for i in rows})  # fmt: skip


def _floor(H: Complex, sensors: Sequence[Channel]) -> Real:
    """Variance of noise that is the same on all lines and all entries of a kind: what quiet lines do not share."""
    noise = np.zeros(H.shape)
    if len(H) < FEW:
        return noise
    rough = np.abs(np.diff(H, 2, axis=0)) ** 2 / 6
    level = np.quantile(rough, CALM, axis=0) / -np.log1p(-CALM)
    for unit in {c.unit for c in sensors}:
        rows = [i for i, c in enumerate(sensors) if c.unit == unit]
        noise[:, rows] = np.median(level[rows])
    return noise


def _dof(channel: Channel) -> Dof | None:
    try:
        return Dof.parse(channel.label)
    except InputError:
        return None


def _limits(off: Real, std: Real) -> Real:
    """Difference that each pair shows by chance once in `CHANCE`, over all pairs, with errors as those of the others.

    Errors of entries are taken as gains, which no average over lines reduces.
    """
    from scipy.special import stdtrit

    n, square = len(off), (off / std) ** 2
    others = np.array([np.sort(np.delete(square, p))[(n - 2) // 2] if n > 1 else 0.0 for p in range(n)])
    variance = (BELIEF * ERROR**2 + (n - 1) * others / CENTRE) / (BELIEF + n - 1)
    return np.asarray(std * np.sqrt(variance) * stdtrit(BELIEF + n - 1, 1 - 0.5 * CHANCE / n))


# -- what explains it --------------------------------------------------------------------------------------------------
def _explained(table: ReciprocalPairs, off: Real, std: Real) -> tuple[FrfFault | None, Real]:
    """The fault after which all pairs agree as well as chance has it, and what chance leaves of each pair.

    A single pair is as well explained by one of its entries, and is looked at more closely.
    """
    good, limits = [], _limits(off, std)
    for fault in _hypotheses(table, np.flatnonzero(off > _limits(0 * off, std))):
        after = _without(table, fault)
        rest, limit = (known := after.mismatch())[0], _limits(*known)
        over = max(float(np.max(rest / limit)), after.signs())
        if over <= (HALF if fault.kind == "exchanged" else 1.0) and np.any(off > limit):
            good.append((float(np.sqrt(np.mean(rest**2))), replace(fault, without=over), limit))
    good.sort(key=lambda g: g[0])
    out = np.flatnonzero(off > (good[0][2] if good else limits))
    if len(out) == 1:
        others = float(np.sqrt(np.mean(np.delete(off, out) ** 2))) if len(off) > 1 else np.inf
        likely = [g[1] for g in good if g[0] <= max(ALIKE * others, ERROR)]
        return _of_one_pair(table, int(out[0]), likely), good[0][2] if good else limits
    if good:
        also = tuple(str(g[1]) for g in good[1:] if g[0] <= max(ALIKE * good[0][0], ERROR))
        return replace(good[0][1], alternatives=also), good[0][2]
    if not len(out):
        return None, limits
    names = sorted({table.sensors[i].label for p in out for i, _ in table.pairs[p]})
    alone = [s for s in names if all(s in _names(table, p) for p in out)]
    return FrfFault("other", tuple(alone or names), (), 1.0, 0.0, 0.0, 0.0), limits


def _names(table: ReciprocalPairs, pair: np.intp) -> list[str]:
    return [table.sensors[i].label for i, _ in table.pairs[pair]]


def _hypotheses(table: ReciprocalPairs, out: NDArray[np.intp]) -> Iterator[FrfFault]:
    """Gains of sensors and exchanges of those that some pair accuses."""
    told = sorted({i for p in out for i, _ in table.pairs[p]})
    for i in told:
        yield _named(_gain(table, i), (table.sensors[i].label,), ())
    if len(table.places) > MOST:
        return
    movable = [i for i in range(len(table.sensors)) if table.sensors[i].quantity in ORDER]
    for i, k in combinations(movable, 2):
        if i in told or k in told:
            yield FrfFault("exchanged", (table.sensors[i].label, table.sensors[k].label), (), 1.0, 0.0, 0.0, 0.0)
    if len(out) > 2:  # one record of a test exchanged: two entries of a row or of a column
        return
    entries = sorted({e for p in out for e in table.pairs[p]})
    drawn = [(e, (i, e[1])) for e in entries for i in movable if i != e[0]]
    drawn += [(e, (e[0], j)) for e in entries for j in range(len(table.loads)) if j != e[1]]
    for (i, j), (k, m) in {tuple(sorted(two)) for two in drawn}:
        rows, columns = (tuple(dict.fromkeys(c.label for c in some)) for some in (
            (table.sensors[i], table.sensors[k]), (table.loads[j], table.loads[m])))  # fmt: skip
        yield FrfFault("exchanged", rows, columns, 1.0, 0.0, 0.0, 0.0)


def _without(table: ReciprocalPairs, fault: FrfFault) -> ReciprocalPairs:
    labels = [c.label for c in table.sensors], [c.label for c in table.loads]
    return replace(table, H=fault.corrected(table.H, *labels))


def _gain(table: ReciprocalPairs, row: int) -> float:
    """Factor of the entries of a row over their twins."""
    of = [p for p, pair in enumerate(table.pairs) if row in (i for i, _ in pair)]
    first = np.array([table.pairs[p][0][0] == row for p in of])
    a, b = (x[:, of] for x in table.entries())
    return _ratio(np.where(first, a, b), np.where(first, b, a))


def _named(gain: float, sensors: tuple[str, ...], loads: tuple[str, ...]) -> FrfFault:
    """A gain as polarity, as a factor of units, or as what it is."""
    if abs(gain + 1) < 0.25:
        return FrfFault("polarity", sensors, loads, -1.0, 0.0, 0.0, 0.0)
    near = [u for v in FACTORS for u in (v, 1 / v, -v, -1 / v) if abs(gain / u - 1) < NEAR]
    factor = min(near, key=lambda u: abs(gain / u - 1)) if near else gain
    return FrfFault("unit" if near else "gain", sensors, loads, factor, 0.0, 0.0, 0.0)


def _of_one_pair(table: ReciprocalPairs, p: int, good: list[FrfFault]) -> FrfFault:
    """One pair differs: one of its entries is wrong, or, where its sensors have no other pair, one of these.

    A wrong sensor leaves the product of both entries over that of their drive points as it is, a wrong entry does not.
    """
    twins = table.pairs[p]
    sensors = [f for f in good if not f.loads and f.kind != "exchanged"]
    exchanges = [f for f in good if f.kind == "exchanged"]
    a, b = (x[:, [p]] for x in table.entries())
    entries = [_of_entry(table, twins[0], a, b), _of_entry(table, twins[1], b, a)]
    if exchanges and entries[0].kind == "other":
        return replace(exchanges[0], alternatives=tuple(map(str, exchanges[1:])))
    factor = entries[0].factor
    due = 1.0 if entries[0].kind == "other" else abs(factor - 1) / (abs(factor) + 1)
    if sensors and (both := _far(table, twins, [_minor(twins)])) < HALF * due:
        unsure = entries if both + ROUGH > HALF * due else []
        return replace(sensors[0], alternatives=tuple(map(str, (*sensors[1:], *unsure))))
    far = [_from_rank_one(table, e, t) for e, t in (twins, twins[::-1])]
    first = int(far[1] > far[0])
    also = [] if far[first] >= CLEAR * far[1 - first] else [entries[1 - first]]
    rest = sensors if due < 2 * ROUGH else []
    return replace(entries[first], alternatives=tuple(map(str, (*also, *rest))))


def _of_entry(table: ReciprocalPairs, entry: tuple[int, int], x: Complex, y: Complex) -> FrfFault:
    """What is wrong with an entry x that should be y."""
    gain = _ratio(x, y)
    found = _named(gain, (table.sensors[entry[0]].label,), (table.loads[entry[1]].label,))
    weight = 1 / (np.abs(x) ** 2 + np.abs(gain * y) ** 2 + 1e-300)
    left = float(np.sqrt(2 * np.mean(weight * np.abs(x - gain * y) ** 2)))
    return found if left < HALF else replace(found, kind="other", factor=1.0)


def _ratio(x: Complex, y: Complex) -> float:
    """Real factor of x over y: median over the lines, which peaks do not decide."""
    along = np.sum((x * y.conj()).real / np.maximum(np.abs(x * y), 1e-300))
    return float(np.copysign(np.median(np.abs(x) / np.maximum(np.abs(y), 1e-300)), along))


def _peaks(table: ReciprocalPairs, twins: Sequence[tuple[int, int]]) -> NDArray[np.intp]:
    """Lines on which the sound entries peak together: those of single modes."""
    M = np.abs(table.mobility) ** 2
    keep = np.ones(M.shape[1:], bool)
    for i, j in twins:
        keep[i, j] = False
    keep &= np.all(M > 0, axis=0)
    power = np.mean(np.log(M[:, keep]), axis=1)
    inner = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])) + 1
    high = inner[power[inner] > np.median(power) + np.log(PEAK)]
    return np.asarray(high[np.argsort(-power[high])][:PEAKS], np.intp)


Minor = tuple[tuple[int, int], tuple[int, int], tuple[int, int], tuple[int, int]]


def _minor(twins: tuple[tuple[int, int], tuple[int, int]]) -> Minor:
    """Both entries of a pair, over the drive points of their places."""
    (i, j), (k, m) = twins
    return (i, j), (k, m), (i, m), (k, j)


def _from_rank_one(table: ReciprocalPairs, entry: tuple[int, int], twin: tuple[int, int]) -> float:
    """How far an entry is from what all but its twin make of it."""
    (i, j), (_, sensors, loads) = entry, table.H.shape
    minors = [(entry, (k, m), (k, j), (i, m)) for k in range(sensors) for m in range(loads)
              if k != i and m != j and twin not in ((k, m), (k, j), (i, m))]  # fmt: skip
    if not minors:  # two places alone: the square of an entry over the drive points
        minors = [(entry, entry, *_minor((entry, twin))[2:])]
    return _far(table, (entry, twin), minors)


def _far(table: ReciprocalPairs, twins: Sequence[tuple[int, int]], minors: Sequence[Minor]) -> float:
    """How far minors are from zero at peaks of single modes: 0 for rank one, 1 for a wrong sign; in the median."""
    at, M = _peaks(table, twins), table.mobility
    if not len(at):
        return 0.0
    a, b, c, d = (M[at][:, *np.array(e).T] for e in zip(*minors, strict=True))
    ratio = a * b / np.where(c * d == 0, np.inf, c * d)
    return float(np.median(np.abs(ratio - 1) / (np.abs(ratio) + 1)))
