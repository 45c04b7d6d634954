"""Shaker on a cantilever: the force of two tests identified from one accelerometer, on the lines that a third excites.

Measured: a steel cantilever (759 x 50.7 x 5.1 mm) driven through a load cell, an accelerometer near its free end, 3200
Hz, three tests of 19.7 s (P. Chowdhury, Dataset-4, CC BY-SA 4.0). Test 1 holds 100, 120 and 150 Hz at one level: from
its settled part come the FRF on these lines and its variance. All other lines are flagged as not calibrated. In test 2
the level rises by half in the middle, in test 3 the 150 Hz fall silent at that moment; their force is identified frame
by frame from short-time lines of the acceleration, and compared with the load cell seen through the same frames
("line-filtered"), and raw, with the shaker's harmonics.

What is left is the structure and not the method: the accelerance on 100 Hz is a tenth lower at 40 % of the force, and
one test at one level cannot know that. Noise alone would give a band a hundred times too narrow: the FRF is stated to
5 % (std), our judgement of a test at one level, and its coverage is printed. The records are read from the folder that
LOADID_DATA names, or from ``../shared/data`` beside the project.

Run ``python -m case_studies.cantilever_shaker``: prints the table and saves ``cantilever_shaker.png``.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loadid import FrequencyInversion, Lambda, LoadEstimate, Noise, Record, Spectra
from structures import Channel, Flag, FrfModel, InputError, cross_spectra

RATE, POUND, GRAVITY = 3200.0, 4.4482216, 9.80665
SEGMENT = 320  # samples, 0.1 s: whole periods of every line that the shaker makes
FRAME, HOP = 1280, 640  # samples of the frames of a test (0.4 s, Hann), and from one to the next
DRIVEN = 0.01  # of the drive's strongest line, above which a line is driven
COHERENT = 0.99
REPEATED = 0.05  # relative std of an FRF that was measured at one level of force: a statement, no measurement
SETTLED = 0.02  # relative distance of a line's force from its later mean
CIRCLE = float(np.sqrt(-np.log(0.05)))  # std within which 95 % of a complex normal error lie
QUIET = ((107.5, 112.5), (130.0, 142.5))  # Hz: between the lines of all three tests, where a frame shows its noise
CHANNELS = (
    Channel(label="drive", quantity="voltage", unit="V"),
    Channel(label="force", quantity="force", unit="N"),
    Channel(label="tip", quantity="acceleration", unit="m/s^2"),
)
Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


# -- the records ------------------------------------------------------------------------------------------------------
def file() -> Path:
    """The measured records.

    Raises
    ------
    InputError
        If they are not there.
    """
    folder = Path(os.environ.get("LOADID_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")
    place = folder / "cantilever_shaker" / "cantilever_shaker.npz"
    if not place.is_file():
        raise InputError("the measured records are not there", where="cantilever_shaker", found=str(place),
                         expected="cantilever_shaker/cantilever_shaker.npz", hint="set LOADID_DATA")  # fmt: skip
    return place


def record(test: int) -> Record:
    """One test in SI, without the offsets of load cell and accelerometer."""
    with np.load(file(), allow_pickle=False) as data:
        values = data[f"test{test}"][:, 1:] * [1.0, POUND, GRAVITY]
    return Record(values - values.mean(axis=0), 1 / RATE, CHANNELS, name=f"test {test}", source=file().name)


# -- calibration ------------------------------------------------------------------------------------------------------
def driven(calibration: Record) -> Array:
    """Lines (Hz) of the drive."""
    spectra = cross_spectra(calibration.select("drive"), window="boxcar", segment=SEGMENT, overlap=0)
    power = spectra.autospectra[:, 0]
    return spectra.frequencies[power > DRIVEN * power.max()]


def short_time(values: Array, lines: Array, samples: int = FRAME, hop: int = HOP) -> tuple[Array, Complex]:
    """Middle of each Hann frame (frames,) in s, and complex amplitudes (frames, lines): phases count from time zero."""
    window = np.hanning(samples + 2)[1:-1]
    starts = np.arange(0, len(values) - samples + 1, hop)
    cut = np.lib.stride_tricks.sliding_window_view(values, samples)[starts]
    kernel = 2 / window.sum() * window[:, None] * np.exp(-2j * np.pi * np.outer(np.arange(samples) / RATE, lines))
    turned = np.exp(-2j * np.pi * np.outer(starts / RATE, lines))
    return np.asarray((starts + 0.5 * samples) / RATE, float), np.asarray(cut @ kernel * turned, complex)


def settled(calibration: Record, lines: Array) -> float:
    """Second from which the force on every line stays near its mean over the second half."""
    t, force = short_time(calibration["force"], lines)
    size = np.abs(force)
    off = np.any(np.abs(size / size[len(size) // 2 :].mean(axis=0) - 1) > SETTLED, axis=1)
    return float(t[np.flatnonzero(off).max() + 1]) if off.any() else 0.0


@dataclass(frozen=True)
class Calibration:
    """Driven lines, the second from which the test is stationary, and the FRF on the lines.

    `shown` is the relative std (lines,) of the FRF by the noise that the segments show.
    """

    lines: Array
    start: float
    model: FrfModel
    shown: Array


def calibrated() -> Calibration:
    """FRF of the driven lines from the settled part of test 1; the flag W211 tells of all other lines."""
    test = record(1)
    lines = driven(test)
    start = settled(test, lines)
    whole = FrfModel.from_records(
        test.window(start, test.duration), forces="force", responses="tip", window="boxcar", segment=SEGMENT,
        overlap=0, least_coherence=COHERENT,
    )  # fmt: skip
    shown = whole.at(lines)
    assert shown.variance is not None
    size = np.abs(shown.H)
    model = FrfModel(
        lines, shown.H, sensors=shown.sensors, loads=shown.loads, variance=shown.variance + (REPEATED * size) ** 2,
        coherence=shown.coherence, flags=shown.flags,
    )  # fmt: skip
    return Calibration(lines, start, model, (np.sqrt(shown.variance) / size)[:, 0, 0])


# -- identification ---------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Identified:
    """Force of one test on the driven lines; arrays are (frames, lines).

    Parameters
    ----------
    test : Record
    lines : array (lines,)
    time : array (frames,)
        Middle of each frame in s.
    force, std, trusted : array
        Complex amplitudes, their std, and whether the line tells the load to 10 %.
    measured : array
        The load cell through the same frames.
    gained : array
        What one constant gain, fitted to test 1, makes of the acceleration.
    flags : tuple of Flag
        Of the first frame.
    """

    test: Record
    lines: Array
    time: Array
    force: Complex
    std: Array
    trusted: NDArray[np.bool_]
    measured: Complex
    gained: Complex
    flags: tuple[Flag, ...]

    @cached_property
    def inside(self) -> slice:
        """Samples between the middles of the first and the last frame."""
        return slice(round(self.time[0] * RATE), round(self.time[-1] * RATE))

    def history(self, amplitudes: Complex) -> Array:
        """Sum of the lines over time (samples,), their amplitudes linear between the frames."""
        t = np.arange(len(self.test))[self.inside] / RATE
        total = np.zeros(len(t))
        for f, a in zip(self.lines, amplitudes.T, strict=True):
            turned = np.interp(t, self.time, a.real) + 1j * np.interp(t, self.time, a.imag)
            total += np.real(turned * np.exp(2j * np.pi * f * t))
        return total

    @property
    def error(self) -> float:
        """Relative error of the history against the line-filtered force."""
        return relative(self.history(self.force), self.history(self.measured))

    @property
    def raw_error(self) -> float:
        """The same against the load cell as it is."""
        return relative(self.history(self.force), self.test["force"][self.inside])

    @property
    def gain_error(self) -> float:
        """Error of a constant gain against the line-filtered force."""
        return relative(self.history(self.gained), self.history(self.measured))

    @property
    def peak_error(self) -> float:
        """Relative error of the largest force."""
        found, known = (float(np.abs(self.history(a)).max()) for a in (self.force, self.measured))
        return found / known - 1

    @property
    def covered(self) -> float:
        """Share of the trusted amplitudes in the 95 % circle of a complex normal error."""
        off = np.abs(self.force - self.measured) <= CIRCLE * self.std
        return float(off[self.trusted].mean())

    def ratio(self) -> Array:
        """Identified over measured amplitude on each line, the median of the trusted frames."""
        share = np.where(self.trusted, np.abs(self.force) / np.maximum(np.abs(self.measured), 1e-12), np.nan)
        return np.nanmedian(share, axis=0)


def identified(number: int, calibration: Calibration) -> Identified:
    """The force of a test, frame by frame; the noise of a frame is what it shows between the lines."""
    test, lines = record(number), calibration.lines
    t, seen = short_time(test["tip"], lines)
    between = np.concatenate([np.arange(a, b + 1e-9, 1.25) for a, b in QUIET])
    noise = float(np.sqrt(np.median(np.abs(short_time(test["tip"], between)[1]) ** 2) / np.log(2)))
    family = FrequencyInversion(
        calibration.model,
        choice=Lambda(neighbours=0),
        noise=Noise(noise, source="lines of the record that nothing drives"),
    )  # tones: what stands on a line tells nothing of the next
    frames = [family.estimate(Spectra(lines, row[:, None])) for row in seen]
    first = record(1)
    return Identified(
        test=test,
        lines=lines,
        time=t,
        force=np.stack([e.load[:, 0] for e in frames]),
        std=np.stack([_std(e) for e in frames]),
        trusted=np.stack([e.trust(0.1)[:, 0] for e in frames]),
        measured=short_time(test["force"], lines)[1],
        gained=seen * float(first["force"] @ first["tip"] / (first["tip"] @ first["tip"])),
        flags=frames[0].flags,
    )


def _std(estimate: LoadEstimate) -> Array:
    assert estimate.std is not None
    return estimate.std[:, 0]


def relative(found: NDArray, known: NDArray) -> float:
    """Norm of the difference over that of the known."""
    return float(np.linalg.norm(found - known) / np.linalg.norm(known))


# -- what is shown ----------------------------------------------------------------------------------------------------
def table(calibration: Calibration, tests: list[Identified]) -> str:
    """Everything in text."""
    model, lines = calibration.model, calibration.lines
    out = [f"calibrated on test 1 from {calibration.start:.1f} s on; std of H by noise, {REPEATED:.0%} is stated"]
    for f, h, s in zip(lines, model.H[:, 0, 0], calibration.shown, strict=True):
        out.append(f"  {f:5.0f} Hz   |H| = {abs(h):.4f} (m/s^2)/N   {s:.2%}")
    out += [
        "",
        "test   error, line-filtered     raw   constant gain     peak   identified / measured amplitude   in band",
    ]
    for number, found in zip((2, 3), tests, strict=True):
        shares = ", ".join(f"{r:.3f}" for r in found.ratio())
        out.append(f"{number:4d}{found.error:24.2%}{found.raw_error:8.1%}{found.gain_error:16.1%}{found.peak_error:+9.1%}"
                   f"   {shares:>31s}{found.covered:15.0%}")  # fmt: skip
    silent = (~tests[1].trusted).mean(axis=0)
    said = ", ".join(f"{f:.0f} Hz in {s:.0%}" for f, s in zip(lines, silent, strict=True) if s)
    out += ["", f"test 3, not trusted: {said} of the frames"]
    out += [f"{f.code} {f.message}" for f in tests[0].flags if f.code == "LID-W211"]
    return "\n".join(out)


def picture(path: Path, tests: list[Identified]) -> None:
    """Amplitudes of the lines over time, with the frames that are not trusted, and histories where the level jumps."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 6.5), layout="constrained")
    for row, (number, found) in zip(figure.subplots(2, 2, width_ratios=(1.2, 1)), zip((2, 3), tests, strict=True),
                                    strict=True):  # fmt: skip
        _amplitudes(row[0], number, found)
        _histories(row[1], found)
    figure.savefig(path, dpi=130)


def _amplitudes(ax, number: int, found: Identified) -> None:  # type: ignore[no-untyped-def]
    for k, f in enumerate(found.lines):
        size, colour = np.abs(found.force[:, k]), f"C{k}"
        half = CIRCLE * found.std[:, k]
        ax.fill_between(found.time, size - half, size + half, color=colour, alpha=0.3, lw=0)
        ax.plot(found.time, np.where(found.trusted[:, k], size, np.nan), colour, label=f"{f:.0f} Hz")
        ax.plot(found.time, np.where(found.trusted[:, k], np.nan, size), colour, lw=1, ls=":")
        ax.plot(found.time, np.abs(found.measured[:, k]), "k--", lw=0.8, label="load cell" if k == 2 else None)
    off = ~found.trusted.all(axis=1)
    if off.any():
        span = found.time[off]
        silent = ", ".join(f"{f:.0f} Hz" for f, t in zip(found.lines, found.trusted.T, strict=True) if not t.all())
        ax.axvspan(span[0], span[-1], color="0.92", zorder=0, label=f"{silent} not trusted")
    ax.set(xlabel="time in s", ylabel="force on the line in N", title=f"test {number}", ylim=(0, None))
    ax.legend(fontsize=8, ncols=2)


def _histories(ax, found: Identified) -> None:  # type: ignore[no-untyped-def]
    loud = np.abs(np.diff(np.abs(found.measured).sum(axis=1)))
    jump = int(np.argmax(loud))
    middle = 0.5 * (found.time[jump] + found.time[jump + 1])
    t = np.arange(len(found.test))[found.inside] / RATE
    near = np.abs(t - middle) < 0.1
    ax.plot(t[near], found.test["force"][found.inside][near], color="0.75", lw=0.8, label="load cell, raw")
    ax.plot(t[near], found.history(found.measured)[near], "k--", lw=1, label="load cell, driven lines")
    ax.plot(t[near], found.history(found.force)[near], "C3", lw=1, label="identified")
    top = 1.6 * float(np.abs(found.history(found.measured)[near]).max())
    ax.set(xlabel="time in s", ylabel="force in N", title="where the level changes", ylim=(-0.8 * top, top))
    ax.legend(fontsize=8, loc="upper center", ncols=3)


def main() -> None:
    """Print the table and save the picture."""
    calibration = calibrated()
    tests = [identified(number, calibration) for number in (2, 3)]
    sys.stdout.write(table(calibration, tests) + "\n")
    target = Path("cantilever_shaker.png")
    picture(target, tests)
    sys.stdout.write(f"picture: {target}\n")


if __name__ == "__main__":
    main()
