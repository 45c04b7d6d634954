"""Measured hammer hits: the model from some hits, the force of another rebuilt, by the command line's functions.

Two public records. Five hits with one accelerometer (ladisk/pyFRF, MIT): the model from four hits, the fifth rebuilt,
all five in turn. Two hits with two accelerometers in the instrument's own LabVIEW file (ladisk/lvm_read, MIT): each hit
rebuilt from the other. The five hits are rebuilt under two more priors: a force that only pushes, and few cubic
B-splines (l1). Lambda is automatic and nothing is tuned for one hit. The records are read from the folder that the
environment variable LOADID_DATA names, or from ``../shared/data`` beside the project.

Run ``python -m case_studies.hammer_log``: prints the tables and saves ``hammer_log.png``.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from loadid import Deconvolution, LoadEstimate, Record, SparseDeconvolution, calibrate, identify, read, read_all
from loadid.constraints import NonNegative
from structures import InputError

HEAD = 6144  # samples of the response, 0.24 s, from which the other priors rebuild a hit
FIVE = {"columns": ("time", "force", "acceleration"), "units": {"force": "N", "acceleration": "m/s^2"}}
TWO = {"fs": 1024.0, "units": {"F": "arbitrary"}}  # the file's own unit of F is wrong, its step is rounded


def folder() -> Path:
    """Folder of the measured records.

    Raises
    ------
    InputError
        If they are not there.
    """
    place = Path(os.environ.get("LOADID_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")
    if not place.is_dir():
        raise InputError(
            "the measured records are not there",
            where="hammer_log",
            found=str(place),
            expected="a folder with hammer_five_hits and hammer_two_hits",
            hint="set LOADID_DATA",
        )
    return place


@dataclass(frozen=True)
class Rebuilt:
    """One hit, rebuilt by a model that has not seen it."""

    name: str
    sensors: tuple[str, ...]
    force: Record
    estimate: LoadEstimate

    def error(self, window: slice = slice(None), offset: float = 0.0) -> float:
        """Relative L2 error of the force, less an offset of its amplifier, in a window of samples."""
        truth, load = self.force.values[window, 0] - offset, self.load[window]
        return float(np.linalg.norm(load - truth) / np.linalg.norm(truth))

    @property
    def offset(self) -> float:
        """What the amplifier of the force shows at rest: its median."""
        return float(np.median(self.force.values[:, 0]))

    @property
    def load(self) -> np.ndarray:
        """Rebuilt force of the whole record, zero where none was rebuilt."""
        load = np.zeros(len(self.force.values))
        load[: len(self.estimate.load)] = self.estimate.load[:, 0]
        return load

    @property
    def peak(self) -> int:
        """Sample of the measured peak."""
        return int(np.argmax(np.abs(self.force.values[:, 0])))

    @property
    def peak_error(self) -> float:
        """Relative error of the largest force."""
        return float(np.abs(self.estimate.load[self.around(), 0]).max() / abs(self.force.values[self.peak, 0]) - 1)

    def around(self, before: int = 8, after: int = 30) -> slice:
        """Samples around the measured peak."""
        return slice(max(self.peak - before, 0), self.peak + after + 1)

    @property
    def covered(self) -> float:
        """Share of the samples of the pulse, above 5 % of its peak, inside the stated 95 % band."""
        low, high = (edge[:, 0] for edge in self.estimate.band(0.95))
        truth = self.force.values[: len(low), 0] - self.offset
        pulse = np.abs(truth) > 0.05 * np.abs(truth).max()
        return float(np.mean((truth >= low)[pulse] & (truth <= high)[pulse]))


def five_hits() -> list[Rebuilt]:
    """Each of five hits, rebuilt from the other four."""
    paths = [folder() / "hammer_five_hits" / f"measurements_{i}.npy" for i in range(1, 6)]
    rebuilt = []
    for path in paths:
        others = [p for p in paths if p != path]
        model = calibrate(others, force="force", responses=["acceleration"], **FIVE)
        record = read(path, **FIVE)
        rebuilt.append(Rebuilt(path.stem, ("acceleration",), record.select(["force"]), identify(record, model)))
    return rebuilt


def under_other_priors(
    which: Sequence[int] = (1, 2, 3, 4, 5), signs: bool = True
) -> list[tuple[Rebuilt, Rebuilt | None]]:
    """Hits rebuilt as few B-splines, and as a force that only pushes (None without `signs`).

    From the first `HEAD` samples of the response: both paths are right where a record ends in motion. After them the
    force is taken as zero, and errors are those of the whole record.
    """
    paths = [folder() / "hammer_five_hits" / f"measurements_{i}.npy" for i in range(1, 6)]
    rebuilt = []
    for path in (paths[i - 1] for i in which):
        model = calibrate([p for p in paths if p != path], force="force", responses=["acceleration"], **FIVE)
        record = read(path, **FIVE)
        head, force = record.window(0.0, (HEAD - 0.5) * record.dt), record.select(["force"])
        few = SparseDeconvolution(model, dictionary="bspline").estimate(head)
        push = Deconvolution(model, constraints=[NonNegative()]).estimate(head) if signs else None
        made = [None if e is None else Rebuilt(path.stem, ("acceleration",), force, e) for e in (few, push)]
        assert made[0] is not None
        rebuilt.append((made[0], made[1]))
    return rebuilt


def two_hits(sensors: tuple[str, ...] = ("m_1", "m_2")) -> list[Rebuilt]:
    """Hit 2 from hit 1, and hit 1 from hit 2, out of one LabVIEW file."""
    path = folder() / "hammer_two_hits" / "long_single_header_multi_ch.lvm"
    records = read_all(path, **TWO)
    rebuilt = []
    for train, test in ((0, 1), (1, 0)):
        model = calibrate([path], force="F", responses=list(sensors), records=[records[train].name], **TWO)
        estimate = identify(records[test], model)
        rebuilt.append(Rebuilt(f"hit {test + 1} from hit {train + 1}", sensors, records[test].select(["F"]), estimate))
    return rebuilt


def priors(five: list[Rebuilt], others: list[tuple[Rebuilt, Rebuilt | None]]) -> str:
    """Whole-record errors of the five hits under three priors, in text."""
    lines = [
        "five hits under three priors: error of the whole record (of the first 80 samples)",
        f"{'hit':16s} {'local variance':>16s} {'only pushes':>16s} {'few B-splines':>16s}  measured tail",
    ]

    def both(hit: Rebuilt | None) -> str:
        return "-" if hit is None else f"{hit.error():.1%} ({hit.error(slice(80)):.1%})"

    for plain, (few, push) in zip(five, others, strict=True):
        truth = plain.force.values[:, 0]
        tail = float(np.linalg.norm(truth[80:]) / np.linalg.norm(truth))
        lines.append(f"{plain.name:16s} {both(plain):>16s} {both(push):>16s} {both(few):>16s} {tail:10.1%}")
    columns = {
        "a variance that changes with time, the default": five,
        "a force that only pushes": [push for _, push in others],
        "few B-splines": [few for few, _ in others],
    }
    means = {name: float(np.mean([np.inf if h is None else h.error() for h in hits])) for name, hits in columns.items()}
    lines.append(f"{'mean':16s}" + "".join(f" {'-' if np.isinf(m) else f'{m:.1%}':>16s}" for m in means.values()))
    best = min(means, key=lambda name: means[name])
    lines.append(f"the prior that wins here: {best}; what is left is mostly the tail that the hammer itself records")
    return "\n".join(lines)


def table(five: list[Rebuilt], two: list[list[Rebuilt]]) -> str:
    """Both tables in text."""
    lines = [
        "five hits, one accelerometer: model from four hits, the other one rebuilt",
        f"{'hit':16s} {'error':>7s} {'first 80':>9s} {'peak':>7s} {'pulse in band':>13s}  variance",
    ]
    for hit in five:
        lines.append(
            f"{hit.name:16s} {hit.error():7.2%} {hit.error(slice(80)):9.2%} {hit.peak_error:+7.2%} {hit.covered:13.1%}"
            f"  {hit.estimate.facts['variance']}"
        )
    mean = [float(np.mean(x)) for x in ([h.error() for h in five], [h.error(slice(80)) for h in five])]
    lines += [
        f"{'mean':16s} {mean[0]:7.2%} {mean[1]:9.2%}",
        "",
        "two hits, two accelerometers: one rebuilt from the other, error from 8 samples before to 30 after the peak,",
        "and of the whole record, less the offset that the force shows at rest",
        f"{'sensors':12s} {'hit':18s} {'error':>7s} {'whole':>7s} {'peak':>7s} {'pulse in band':>13s}  variance",
    ]
    for hits in two:
        for hit in hits:
            lines.append(
                f"{'+'.join(hit.sensors):12s} {hit.name:18s} {hit.error(hit.around()):7.2%}"
                f" {hit.error(offset=hit.offset):7.2%} {hit.peak_error:+7.2%} {hit.covered:13.1%}"
                f"  {hit.estimate.facts['variance']}"
            )
    both = two[0][0].estimate
    lines.append(f"weights of the sensors: {both.choice.sigma_source}")
    lines.append(f"flags: {', '.join(sorted(five[0].estimate.codes))}; {', '.join(sorted(both.codes))}")
    return "\n".join(lines)


def picture(path: Path, five: list[Rebuilt], two: list[Rebuilt], few: Rebuilt | None = None) -> None:
    """Measured and rebuilt force with the band, one hit of each record; the B-spline answer beside the first."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4), layout="constrained")
    for ax, hit, title in zip(
        figure.subplots(1, 2),
        (five[0], two[0]),
        ("hit 1 of 5 from the other four", "hit 2 from hit 1, two sensors"),
        strict=True,
    ):
        span = hit.around(20, 60)
        low, high = hit.estimate.band()
        t = 1e3 * hit.estimate.axis.values[span]
        unit = hit.estimate.units[0]
        ax.fill_between(t, low[span, 0], high[span, 0], alpha=0.3, color="C0", label="95 % band")
        ax.plot(t, hit.estimate.load[span, 0], color="C0", label="rebuilt")
        ax.plot(t, hit.force.values[span, 0], "k--", lw=1, label="measured")
        if few is not None and hit is five[0]:
            ax.plot(t, few.load[span], color="C1", lw=1, label="few B-splines")
        ax.set(xlabel="time in ms", ylabel=f"force in {unit}" if unit == "N" else f"force ({unit} unit)", title=title)
        ax.legend()
    figure.savefig(path, dpi=130)


def main() -> None:
    """Print the tables and save the picture."""
    five = five_hits()
    two = [two_hits(sensors) for sensors in (("m_1", "m_2"), ("m_2",), ("m_1",))]
    sys.stdout.write(table(five, two) + "\n\n")
    others = under_other_priors()
    sys.stdout.write(priors(five, others) + "\n")
    target = Path("hammer_log.png")
    picture(target, five, two[0], others[0][0])
    sys.stdout.write(f"picture: {target}\n")


if __name__ == "__main__":
    main()
