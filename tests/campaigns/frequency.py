"""Loads on frequency lines, where the FRF is wrong and nobody says so.

Beams and plates, 1 to 4 loads, none to 4 spare sensors of displacement, velocity, acceleration or all of them; 16 to 60
lines of a multi-sine or 150 to 500 lines of a broadband load, of random phase and smooth size or complex normal. The
spectra come from a finer mesh with twice the modes; noise of 0.5 to 5 % of each channel, stated in every second
problem. `error` is what the FRF table of the user has wrong: every entry of every line by itself ("entry", relative to
the entry; "level", relative to the rms of its line) or smoothly over the lines ("smooth"), frequencies (a quarter of
the size), damping (three times) and shapes of the modes ("modal"), a gain, or gain and phase, of each sensor ("gain",
"phase").
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from loadid import FrequencyInversion, LoadEstimate, Noise, Spectra
from structures import ForwardModel, FrfModel, beams, damping, loads, plates, sensors
from structures.errors import InputError, NotIdentifiable

from .scores import Z95, Array, counts

Complex = NDArray[np.complex128]
ERRORS = ("none", "entry", "level", "smooth", "modal", "gain", "phase")
KINDS = (sensors.Displacement, sensors.Velocity, sensors.Accelerometer)
BAD = 0.3  # relative error of a line that nobody should trust


@dataclass(frozen=True, eq=False)
class Problem:
    """Spectra as a user has them, with their truth.

    Parameters
    ----------
    model : FrfModel
        With its errors.
    spectra : Spectra
    truth : array (lines, loads)
    spare : int
        Sensors beyond the loads.
    groups : tuple of str
    """

    model: FrfModel
    spectra: Spectra
    truth: Complex
    spare: int
    groups: tuple[str, ...]


def normals(rng: np.random.Generator, *shape: int) -> Complex:
    """Complex normals of unit variance."""
    return np.asarray((rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2))


def _structure(rng: np.random.Generator, fine: bool, ratio: float) -> tuple[Any, tuple[float, ...]]:
    """A structure on a coarse or a fine mesh and its extents; draws the same from any generator."""
    steel, turn = beams.materials.steel, rng.random(4)
    length, settled = 0.6 + 1.4 * turn[0], damping.Modal(ratio)
    if turn[1] < 0.6:
        ends = (("clamped", "free"), ("pinned", "pinned"), ("clamped", "clamped"))[int(3 * turn[2])]
        section = beams.Section.rectangle(0.04, 0.012)
        return beams.beam(length=length, section=section, material=steel, left=ends[0], right=ends[1],
                          elements=120 if fine else 40, damping=settled), (length,)  # fmt: skip
    extents = (0.5 * length, 0.5 * length * (0.6 + 0.4 * turn[3]))
    edges = ("SSSS", "CCCC", "CFFF")[int(3 * turn[2])]
    return plates.plate(lengths=extents, thickness=0.006, material=steel, edges=edges,
                        elements=(20, 16) if fine else (10, 8), damping=settled), extents  # fmt: skip


def _wrong(rng: np.random.Generator, model: ForwardModel, f: Array, error: str, size: float) -> Complex:
    """What the user takes for the FRF."""
    if error == "modal":
        r, modes = model.reduced, len(model.reduced.lam)
        natural, more = np.exp(size / 4 * rng.standard_normal(modes)), np.exp(3 * size * rng.standard_normal(modes))
        made = replace(
            r, lam=r.lam * natural**2, damping=r.damping * natural * more,
            S=r.S + size * np.sqrt(np.mean(r.S**2, axis=0)) * rng.standard_normal(r.S.shape),
            B=r.B + size * np.sqrt(np.mean(r.B**2, axis=1, keepdims=True)) * rng.standard_normal(r.B.shape),
        )  # fmt: skip
        return np.asarray(made.frf(f), complex)
    H = model.frf(f)
    if error in ("entry", "smooth"):
        E = normals(rng, *H.shape)
        if error == "smooth":
            E = gaussian_filter1d(E.real, 8, axis=0) + 1j * gaussian_filter1d(E.imag, 8, axis=0)
            E /= np.sqrt(np.mean(np.abs(E) ** 2))
        return np.asarray(H * (1 + size * E))
    if error == "level":
        return np.asarray(
            H + size * normals(rng, *H.shape) * np.sqrt(np.mean(np.abs(H) ** 2, axis=(1, 2)))[:, None, None]
        )
    if error in ("gain", "phase"):
        turn = size * rng.standard_normal(H.shape[1]) * (error == "phase")
        return np.asarray(H * ((1 + size * rng.standard_normal(H.shape[1])) * np.exp(1j * turn))[:, None])
    return np.asarray(H, complex)


def _load(rng: np.random.Generator, lines: int, count: int) -> Complex:
    """Random phase and smooth size, or complex normal; the loads of sizes within a factor of 3."""
    colour = np.exp(0.7 * np.array([np.interp(np.linspace(0, 4, lines), np.arange(5), rng.standard_normal(5))
                                    for _ in range(count)]).T)  # fmt: skip
    g = normals(rng, lines, count)
    g = g if rng.random() < 0.5 else g / np.abs(g)
    return np.asarray(colour * 3 ** rng.uniform(-0.5, 0.5, count) * g)


def problem(seed: int, error: str = "none", size: float = 0.1) -> Problem:
    """Problem number `seed` with an error of the FRF of relative std `size`."""
    rng = np.random.default_rng([seed, ERRORS.index(error)])
    ratio, draw, modes = float(10 ** rng.uniform(-2.3, -1.5)), int(rng.integers(1 << 30)), int(rng.integers(8, 15))
    coarse, extents = _structure(np.random.default_rng(draw), False, ratio)
    fine, _ = _structure(np.random.default_rng(draw), True, ratio)
    count, spare = int(rng.integers(1, 5)), int(rng.integers(5))
    while count + spare < 2:
        count = int(rng.integers(1, 5))
    kind = int(rng.integers(4))

    def at(share: Array) -> Any:
        place = tuple(float(x * e) for x, e in zip(share, extents, strict=True))
        return place[0] if len(place) == 1 else place

    seen = [KINDS[kind if kind < 3 else rng.integers(3)](at=at(p), direction="+Z", label=f"s{i}")
            for i, p in enumerate(rng.uniform(0.1, 0.9, (count + spare, len(extents))))]  # fmt: skip
    points = [loads.Point(at=at(p), direction="+Z", label=f"F{j}")
              for j, p in enumerate(rng.uniform(0.15, 0.85, (count, len(extents))))]  # fmt: skip
    model, true = ForwardModel(coarse, seen, points, modes=modes), ForwardModel(fine, seen, points, modes=2 * modes)
    own = np.asarray(model.natural_frequencies)
    broad = bool(rng.random() < 0.6)
    lines = int(rng.integers(150, 500)) if broad else int(rng.integers(16, 60))
    top = own[rng.integers(3, modes // 2 + 1)]  # well below the modes that the user leaves out
    f = np.linspace(0.5 * own[0], top, lines)
    truth = _load(rng, lines, count)
    clean = np.einsum("ksl,kl->ks", true.frf(f), truth)
    sigma = 10 ** rng.uniform(np.log10(0.005), np.log10(0.05)) * np.sqrt(np.mean(np.abs(clean) ** 2, axis=0))
    Y, stated = clean + sigma * normals(rng, *clean.shape), bool(rng.random() < 0.5)
    table = FrfModel(f, _wrong(rng, model, f, error, size), sensors=model.sensors, loads=model.loads)
    groups = (
        f"{spare} spare", f"{count} loads", "broadband" if broad else "multi-sine", f"error {error}",
        f"sigma {'stated' if stated else 'not known'}", f"error {error} {size:.0%}",
        f"{'no' if not spare else 'some'} spare, error {error} {size:.0%}",
    )  # fmt: skip
    return Problem(table, Spectra(f, Y, noise=sigma if stated else None, noise_source="known"), truth, spare, groups)


# -- scores ----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class LineScored:
    """An answer beside its truth; arrays are (lines, loads) raveled.

    Parameters
    ----------
    groups : tuple of str
    codes : frozenset of str
    z : array (2, values)
        Error over std of the real and of the imaginary parts.
    off, own : array
        Error relative to the load around the line, and to that of the line itself.
    trusted : array of bool
    before, off_before : array
        Trusted if the FRF is taken for exact, at a predicted std of 10 %, and the errors of that answer.
    width : float
        Root mean square of the std over that of the error, on trusted lines; NaN where none is.
    """

    groups: tuple[str, ...]
    codes: frozenset[str]
    z: Array
    off: Array
    own: Array
    trusted: NDArray[np.bool_]
    before: NDArray[np.bool_]
    off_before: Array
    width: float


def scored(given: Problem, estimate: LoadEstimate, plain: LoadEstimate) -> LineScored:
    """An estimate beside the truth, and beside the one that takes the FRF for exact."""
    std, error = np.asarray(estimate.std), np.asarray(estimate.load) - given.truth
    around = np.sqrt(gaussian_filter1d(np.abs(given.truth) ** 2, 10, axis=0, mode="nearest"))
    trusted = estimate.trust().ravel()
    parts = np.sqrt(2) * np.array([error.real.ravel(), error.imag.ravel()]) / std.ravel()
    square = np.abs(error).ravel()[trusted] ** 2
    return LineScored(
        given.groups, frozenset(estimate.codes), parts, (np.abs(error) / around).ravel(),
        (np.abs(error) / np.abs(given.truth)).ravel(), trusted, plain.trust(0.1).ravel(),
        (np.abs(plain.load - given.truth) / around).ravel(),
        float(np.median(std.ravel()[trusted]) / np.sqrt(np.mean(square))) if trusted.any() else float("nan"),
    )  # fmt: skip


HEADING = (f"{'':34s} {'n':>4s}   {'trust':>6s} {'before':>6s}  {'band':>5s} {'all':>5s}   {'bad':>5s} {'own':>5s}"
           f" {'before':>6s}   {'kept':>5s}  {'width':>5s}")  # fmt: skip


def row(name: str, found: Sequence[LineScored]) -> str:
    """One row of the table."""
    z = np.concatenate([np.abs(s.z) <= Z95 for s in found], axis=1)
    names = ("off", "own", "trusted", "before", "off_before")
    off, own, trusted, before, was = (np.concatenate([getattr(s, a) for s in found]) for a in names)

    def share(of: Any, among: Any) -> float:
        return float(np.mean(of[..., among])) if np.any(among) else float("nan")

    width = [s.width for s in found if np.isfinite(s.width)]
    return (
        f"{name:34s} {len(found):4d}   {np.mean(trusted):6.1%} {np.mean(before):6.1%}  {share(z, trusted):5.1%}"
        f" {np.mean(z):5.1%}   {share(off > BAD, trusted):5.1%} {share(own > BAD, trusted):5.1%}"
        f" {share(was > BAD, before):6.1%}   {share(trusted, before & (was < BAD)):5.0%}"
        f"  {np.median(width) if width else np.nan:5.2f}"
    )


def table(found: Sequence[LineScored], told: Callable[[str], None] = print) -> None:
    """Print all and each group.

    Columns: values trusted, and if the FRF were exact; real and imaginary parts in their 95 % band, of the trusted and
    of all; trusted values more than 30 % off, relative to the load around the line and to that of the line, and of
    those trusted if the FRF were exact; kept of these where they are right; median std over the rms error of trusted
    values.
    """
    told(HEADING)
    told(row("all", found))
    for group in sorted({g for s in found for g in s.groups}):
        told(row(group, [s for s in found if group in s.groups]))
    silent = [s for s in found if s.trusted.any() and np.mean(s.off[s.trusted] > BAD) > 0.1]
    told(f"answers with more than a tenth of the trusted lines bad: {len(silent)} of {len(found)}")
    told(f"flags: {counts(code for s in found for code in s.codes)}")


def run(
    problems: int, seed: int, error: str = "none", size: float = 0.1, **settings: Any
) -> Iterator[LineScored | str]:
    """Score of each problem, or why it was refused."""
    for number in range(problems):
        given = problem(seed * 100_000 + number, error, size)
        try:
            plain = FrequencyInversion(given.model, noise=Noise(frf=0.0)).estimate(given.spectra)
            yield scored(given, FrequencyInversion(given.model, **settings).estimate(given.spectra), plain)
        except (InputError, NotIdentifiable) as refused:
            yield f"{getattr(refused, 'code', '')} {refused}".splitlines()[0]
