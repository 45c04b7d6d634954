"""Stationary loads on a plate: which machine makes which sensor shake, and on which lines that can be said.

An aluminium plate (1 x 0.7 m, 4 mm, simply supported, 1 % of damping) carries a machine on two feet, 0.18 m apart, that
shake together and share a tone at 145 Hz; a fan, independent and broadband; and a mount that is suspected and does
nothing. Seven accelerometers identify, three are kept out. As in a test: the FRFs come, with their variance, from 40 s
of four independent shakers; the operating record lasts 32 s; 3 % of noise in both, and nobody tells its level.

The table compares what users take, line by line, with the package's default: rms error in dB of the autospectra of the
three forces that act, on the lines that the default trusts to 10 % and on all others, and the largest; error of their
cross-spectral matrix; what leaks into the mount; error of the autospectra of the sensors that were kept out. Then come
the bands that are not trusted, and what each load contributes to the sensors that were kept out.

The same again with feet that rock, their forces opposite. On lines that do not tell the feet apart, every regularised
answer is then too small, by up to 16 dB, as no prior here knows of loads that work against each other; all of these are
flagged, and on trusted lines nothing changes. The truth judges only.

Run ``python -m case_studies.source_identification``: prints the tables and saves ``source_identification.png``.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid import FrequencyInversion, Lambda, LoadEstimate, Record
from loadid._results.functionals import in_words
from loadid.sources import Contributions, Split, Transfer, contributions, decibels, split, validate_on
from structures import Channel, CrossSpectra, ForwardModel, FrfModel, beams, cross_spectra, loads, plates, sensors

RATE, SEGMENT = 1024.0, 1024  # Hz, samples: lines every hertz
BAND = (20.0, 400.0)
TESTED, OPERATED = 40, 32  # s
NOISE = 0.03  # of the rms over all sensors
TONE = 145.0
LOADS = {"foot 1": (0.24, 0.20), "foot 2": (0.42, 0.20), "fan": (0.75, 0.48), "mount": (0.62, 0.16)}
SEEN = {
    "a1": (0.13, 0.11), "a2": (0.36, 0.33), "a3": (0.55, 0.56), "a4": (0.68, 0.27), "a5": (0.87, 0.40),
    "a6": (0.21, 0.52), "a7": (0.47, 0.13), "desk": (0.90, 0.13), "wall": (0.10, 0.36), "lamp": (0.60, 0.41),
}  # fmt: skip
HELD = ("desk", "wall", "lamp")
PLAIN, DEFAULT = "default, FRFs taken as exact", "default"
METHODS: dict[str, dict[str, Any]] = {
    "pseudo-inverse": {"choice": 0},
    "truncated SVD, GCV": {"choice": Lambda(method="tsvd")},
    "Tikhonov, L-curve per line": {"choice": Lambda("l_curve", over="line")},
    "Tikhonov, GCV per line": {"choice": Lambda("gcv", over="line")},
    "Tikhonov, one lambda, GCV": {"choice": Lambda("gcv", over="band")},
    PLAIN: {},
    DEFAULT: {},
}
Array = NDArray[np.float64]


# -- the test and the operation ---------------------------------------------------------------------------------------
@lru_cache(maxsize=1)
def plate() -> ForwardModel:
    """The structure that makes the data."""
    aluminium = beams.materials.aluminium
    structure = plates.plate(lengths=(1.0, 0.7), thickness=4e-3, material=aluminium, elements=(12, 9), damping=0.01)
    seen = [sensors.Accelerometer(at=p, direction="Z", label=name) for name, p in SEEN.items()]
    pushed = [loads.Point(at=p, direction="Z", label=name) for name, p in LOADS.items()]
    return ForwardModel(structure, seen, pushed, modes=40)


def respond(force: Array, rng: np.random.Generator) -> Array:
    """Noisy stationary response (samples, sensors) to forces (samples, loads) that repeat with the record."""
    samples = len(force)
    frequencies = np.fft.rfftfreq(samples, 1 / RATE)
    H = np.concatenate([np.zeros((1, len(SEEN), len(LOADS))), plate().frf(frequencies[1:])])
    clean = np.fft.irfft(np.einsum("ksl,kl->ks", H, np.fft.rfft(force, axis=0)), samples, axis=0)
    return clean + NOISE * np.sqrt(np.mean(clean**2)) * rng.standard_normal(clean.shape)


def channels() -> tuple[tuple[Channel, ...], tuple[Channel, ...]]:
    """Of the forces and of the accelerations."""
    forces = tuple(Channel(label=name, quantity="force", unit="N") for name in LOADS)
    return forces, tuple(Channel(label=name, quantity="acceleration", unit="m/s^2") for name in SEEN)


def shaped(white: Array, low: float, high: float, slope: float) -> Array:
    """Noise of unit rms between two frequencies (Hz), its density falling as f^-slope."""
    f = np.fft.rfftfreq(len(white), 1 / RATE)
    gain = np.where((f >= low) & (f <= high), np.maximum(f, 1.0) ** (-slope / 2), 0.0)
    made = np.fft.irfft(np.fft.rfft(white) * gain, len(white))
    return made / np.std(made)


def operation(rng: np.random.Generator, rocking: bool) -> Array:
    """Forces (samples, loads) in N: two feet that share most of their force and a tone, a fan, and nothing."""
    samples = int(OPERATED * RATE)
    own = rng.standard_normal((4, samples))
    common, first, second = (shaped(w, 15, 450, s) for w, s in zip(own[:3], (0.7, 0.3, 0.3), strict=True))
    tone = np.sqrt(2) * np.sin(2 * np.pi * TONE * np.arange(samples) / RATE + 0.3)
    shared = 4 * common + 2 * tone
    feet = [shared + 1.2 * first, (-0.65 if rocking else 0.65) * shared + 1.2 * second]
    return np.stack([*feet, 3 * shaped(own[3], 15, 450, 0.0), np.zeros(samples)], axis=1)


@dataclass(frozen=True, eq=False)
class Campaign:
    """What a test engineer has, and the truth.

    Parameters
    ----------
    model : FrfModel
        Measured FRFs of all sensors, with their variance.
    record : Record
        Operating accelerations of all sensors.
    spectra : CrossSpectra
        Of that record.
    parted : Split
        Models of the sensors that identify and of those that are kept out.
    truth : array (lines, loads, loads)
        Cross spectra of the forces, by the same windows.
    frequencies : array (lines,)
    """

    model: FrfModel
    record: Record
    spectra: CrossSpectra
    parted: Split
    truth: NDArray[np.complex128]
    frequencies: Array

    @cached_property
    def exact(self) -> FrfModel:
        """The FRFs without their variance, as most tools take them."""
        m = self.model
        return FrfModel(m.frequencies, m.H, sensors=m.sensors, loads=m.loads, flags=m.flags)


@lru_cache(maxsize=2)
def campaign(rocking: bool = False, seed: int = 0) -> Campaign:
    """FRF test and operating record; the feet bounce together, or rock."""
    rng = np.random.default_rng(seed)
    forces, seen = channels()
    shaken = rng.standard_normal((int(TESTED * RATE), len(LOADS)))
    test = Record(np.hstack([shaken, respond(shaken, rng)]), 1 / RATE, (*forces, *seen), name="FRF test")
    table = FrfModel.from_records(
        test, forces=list(LOADS), responses=list(SEEN), segment=SEGMENT, overlap=0.5, window="hann"
    )
    model = table.at((table.frequencies >= BAND[0]) & (table.frequencies <= BAND[1]))
    force = operation(rng, rocking)
    record = Record(respond(force, rng), 1 / RATE, seen, name="operation")
    inside = _in_band(cross_spectra(record, segment=SEGMENT))
    truth = _in_band(cross_spectra(Record(force, 1 / RATE, forces), segment=SEGMENT))
    return Campaign(model, record, inside, split(model, HELD), truth.matrix, truth.frequencies)


def _in_band(spectra: CrossSpectra) -> CrossSpectra:
    return spectra.lines((spectra.frequencies >= BAND[0]) & (spectra.frequencies <= BAND[1]))


# -- what each method makes of it -------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Row:
    """One method. Errors of autospectra in dB, (lines, 3) for the loads that act; ratios; CPU seconds."""

    name: str
    off: Array
    matrix: float
    leak: float
    held: float
    seconds: float
    estimate: LoadEstimate
    transfer: Transfer

    def over(self, mask: NDArray[np.bool_]) -> float:
        """Rms of the errors on some lines and loads."""
        return float(np.sqrt(np.mean(self.off[mask] ** 2))) if mask.any() else float("nan")

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """Lines and acting loads that the estimate trusts."""
        return self.estimate.trust()[:, :3]


def identified(name: str, case: Campaign) -> Row:
    """Loads by one method, from the seven sensors."""
    model = case.model if name == DEFAULT else case.exact
    family = FrequencyInversion(model, validation=HELD, **METHODS[name])
    start = time.process_time()
    estimate = family.estimate(case.spectra)
    spent = time.process_time() - start
    spectrum = estimate.spectrum
    assert spectrum is not None
    assert spectrum.cross is not None
    active = np.einsum("kjj->kj", case.truth).real[:, :3]
    wrong = np.linalg.norm(spectrum.cross - case.truth, axis=(1, 2)) / np.linalg.norm(case.truth, axis=(1, 2))
    held = validate_on(estimate, case.parted.validation, case.spectra.restricted(HELD))
    return Row(
        name=name,
        off=decibels(estimate.load[:, :3], active),
        matrix=float(np.median(wrong)),
        leak=float(np.sqrt(estimate.load[:, 3].sum() / active.sum())),
        held=float(np.sqrt(np.mean(np.asarray(held.comparison.rms_lines) ** 2))),
        seconds=spent,
        estimate=estimate,
        transfer=held,
    )


def ranked(row: Row, case: Campaign) -> Contributions:
    """Response of the sensors that were kept out to each load alone."""
    return contributions(case.parted.validation, row.estimate)


# -- what is shown ----------------------------------------------------------------------------------------------------
def table(rows: list[Row]) -> str:
    """Methods in text; the lines are parted by what the last of them trusts."""
    told = rows[-1].trusted
    out = [
        f"{'':30s}{'error of the force spectra, dB':>32s}{'matrix':>9s}{'idle':>8s}{'kept out':>10s}{'CPU s':>8s}",
        f"{'':30s}{'trusted':>12s}{'others':>10s}{'worst':>10s}{'median':>9s}{'mount':>8s}{'dB':>10s}",
    ]
    for r in rows:
        worst = float(np.abs(r.off).max())
        out.append(f"{r.name:30s}{r.over(told):12.2f}{r.over(~told):10.2f}{worst:10.1f}{r.matrix:9.1%}{r.leak:8.1%}"
                   f"{r.held:10.2f}{r.seconds:8.3f}")  # fmt: skip
    return "\n".join(out)


def trusted(row: Row) -> str:
    """Bands of each load that are not to be believed at 10 %."""
    spectrum = row.estimate.spectrum
    assert spectrum is not None
    lines = [f"not trusted to {spectrum.level:.0%} (share of the lines; widest bands):"]
    for j, name in enumerate(row.estimate.labels):
        share = float(np.mean(~spectrum.trust()[:, j]))
        lines.append(f"  {name:8s}{share:6.0%}  {in_words(spectrum.bands(j))}")
    return "\n".join(lines)


def picture(path: Path, case: Campaign, rows: list[Row]) -> None:
    """Forces with the bands that are not trusted, the idle mount, a kept-out sensor, and who makes it shake."""
    from matplotlib.figure import Figure

    by_name = {r.name: r for r in rows}
    figure = Figure(figsize=(12, 8), layout="constrained")
    axes = figure.subplots(2, 2)
    _force(axes[0, 0], case, by_name, 1, "foot 2")
    _force(axes[0, 1], case, by_name, 3, "mount, which does nothing")
    _kept_out(axes[1, 0], case, by_name[DEFAULT])
    _shares(axes[1, 1], ranked(by_name[DEFAULT], case))
    figure.savefig(path, dpi=130)


def _force(ax, case: Campaign, rows: dict[str, Row], load: int, title: str) -> None:  # type: ignore[no-untyped-def]
    estimate, f = rows[DEFAULT].estimate, case.frequencies
    assert estimate.spectrum is not None
    low, high = estimate.band(0.95)
    ax.semilogy(f, rows["pseudo-inverse"].estimate.load[:, load], "0.6", lw=0.8, label="pseudo-inverse")
    ax.fill_between(f, np.maximum(low[:, load], 1e-9), high[:, load], color="C0", alpha=0.3, lw=0, label="95 % band")
    ax.semilogy(f, estimate.load[:, load], "C0", lw=1.2, label="default")
    if case.truth[:, load, load].real.any():
        ax.semilogy(f, case.truth[:, load, load].real, "k--", lw=0.8, label="true")
    for k, (a, b) in enumerate(estimate.spectrum.bands(load)):
        ax.axvspan(a - 0.5, b + 0.5, color="0.9", zorder=0, lw=0, label="not trusted" if k == 0 else None)
    ax.set(xlabel="frequency in Hz", ylabel="force density in N$^2$/Hz", title=title, xlim=BAND, ylim=(1e-6, 3e1))
    ax.legend(fontsize=8, ncols=2, loc="upper right")


def _kept_out(ax, case: Campaign, row: Row) -> None:  # type: ignore[no-untyped-def]
    comparison, place = row.transfer.comparison, HELD.index("desk")
    f = comparison.frequencies
    ax.semilogy(f, np.asarray(comparison.measured)[:, place], "k", lw=0.9, label="measured")
    ax.semilogy(f, np.asarray(comparison.synthesised)[:, place], "C3", lw=0.9, ls="--", label="from the loads")
    ax.set(xlabel="frequency in Hz", ylabel="density in (m/s$^2$)$^2$/Hz", title="desk: kept out, predicted", xlim=BAND)
    ax.legend(fontsize=8, loc="lower right")


def _shares(ax, found: Contributions) -> None:  # type: ignore[no-untyped-def]
    shares = found.shares(3)
    assert shares.bands is not None
    place = found.index("desk")
    x, bottom = np.arange(len(shares.bands)), np.zeros(len(shares.bands))
    for j, load in enumerate(found.loads):
        part = 100 * np.nan_to_num(shares.share[:, place, j])
        ax.bar(x, part, bottom=bottom, label=load.label, color=f"C{j}")
        bottom += part
    ax.set_xticks(x, shares.bands.names, rotation=60, fontsize=8)
    ax.set(xlabel="third octave, Hz", ylabel="share of the power in %", title="desk: who makes it shake", ylim=(0, 112))
    ax.legend(fontsize=8, loc="upper center", ncols=4, bbox_to_anchor=(0.5, 1.0), framealpha=0.95)


def main() -> None:
    """Print the tables and save the picture."""
    case, other = campaign(), campaign(rocking=True)
    rows = [identified(name, case) for name in METHODS]
    best = rows[-1]
    sys.stdout.write("feet that bounce together; seven accelerometers, 381 lines\n" + table(rows) + "\n\n")
    sys.stdout.write(trusted(best) + "\n\n" + ranked(best, case).table() + "\n\n")
    sys.stdout.write("feet that rock\n" + table([identified(name, other) for name in METHODS]) + "\n\n")
    for flag in best.estimate.flags:
        sys.stdout.write(f"{flag.code} {flag.message}\n")
    target = Path("source_identification.png")
    picture(target, case, rows)
    sys.stdout.write(f"picture: {target}\n")


if __name__ == "__main__":
    main()
