"""Small sets of data to try things with: simulated by a seed, from finer models than those that invert them.

Each function returns a `Dataset`: the model that an engineer would have, the record, and the load behind it. With a
folder it writes the files that the documentation reads.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from structures._model import Model

    from ._record import Record

__all__ = ["Dataset", "beam_sources", "fleet", "hammer_test", "impact", "mast_wind", "modal_test", "wing_strains"]

FINER = 4  # steps of a simulation per sample of its record


@dataclass(frozen=True, eq=False)
class Dataset:
    """A simulated test.

    Parameters
    ----------
    model : Model
        What an engineer would invert with: a coarser mesh and fewer modes than the data come from.
    record : Record
        What was measured, with noise. SI units.
    load : array, shape (samples, loads), or (places,) of a static load
        The load behind it, on the grid of the record; SI units.
    files : tuple of Path
        What was written.
    """

    model: Model
    record: Record
    load: NDArray[Any]
    files: tuple[Path, ...] = ()

    def __repr__(self) -> str:
        written = f", files {', '.join(map(str, self.files))}" if self.files else ""
        return f"Dataset({self.record!r}, load {self.load.shape}{written})"


def impact(folder: str | os.PathLike[str] | None = None, *, seed: int = 0) -> Dataset:
    """A hit of 200 N on a steel cantilever of 0.3 m, one accelerometer, 20 ms at 20 kHz.

    Parameters
    ----------
    folder : path, optional
        Where ``log.csv`` is written, with the columns ``time [s]`` and ``12+Z [m/s^2]``.
    seed : int
        Of the noise, 0.5 % of the signal.

    Raises
    ------
    InputError
        If the folder cannot be written.
    """
    from structures import ForwardModel, beams, damping, loads, sensors

    def beam(sensor: str, load: str, elements: int, modes: int) -> ForwardModel:
        structure = beams.cantilever(
            length=0.3, section=beams.Section.rectangle(0.04, 0.01), material=beams.materials.steel,
            damping=damping.Modal(0.02), elements=elements,
        )  # fmt: skip
        return ForwardModel(structure, sensors=[sensors.Accelerometer(sensor)], loads=[loads.Point(load)], modes=modes)

    dt, samples = 1 / 20e3, 400
    force = _half_sine(samples, dt, peak=200.0, start=0.005, length=0.0015)
    record = _measured(beam("24+Z", "62+Z", 80, 20), force, dt, 0.005, seed, ["12+Z"], "hit on a cantilever")
    files = [] if folder is None else [_csv(folder, "log.csv", record)]
    return Dataset(beam("12+Z", "31+Z", 40, 6), record, force[::FINER], tuple(files))


def hammer_test(folder: str | os.PathLike[str] | None = None, *, seed: int = 0) -> Dataset:
    """Three hits with a hammer that is measured, and one that is to be found; two accelerometers on a beam.

    Parameters
    ----------
    folder : path, optional
        Where ``hit1.csv``, ``hit2.csv``, ``hit3.csv`` and ``unknown.csv`` are written, with the columns ``time [s]``,
        ``hammer [N]``, ``acc1 [m/s^2]``, ``acc2 [m/s^2]``; the last has its hammer too, to compare with.
    seed : int
        Of the noise, 0.5 % of each signal.

    Returns
    -------
    Dataset
        Record and load of the unknown hit.
    """
    import numpy as np

    from structures import Channel, ForwardModel, beams, damping, loads, sensors

    from ._record import Record

    beam = beams.simply_supported(
        length=1.0, section=beams.Section.rectangle(0.04, 0.01), material=beams.materials.steel, elements=40,
        damping=damping.Modal(0.06),
    )  # fmt: skip
    seen = [sensors.Accelerometer(at=x, label=f"acc{k}") for k, x in ((1, 0.41), (2, 0.76))]
    model = ForwardModel(beam, seen, [loads.Point(at=0.59, label="hammer")], modes=10)
    dt, samples, records = 1 / 8192, 4096, []
    for k, (peak, length) in enumerate(((700.0, 0.0022), (900.0, 0.0018), (1100.0, 0.002), (820.0, 0.0021))):
        force = _half_sine(samples, dt, peak=peak, start=0.02, length=length)
        answer = _measured(model, force, dt, 0.005, seed + k, ["acc1", "acc2"], "")
        hammer = force[::FINER] + 0.5 * np.random.default_rng(seed + 10 + k).standard_normal((samples, 1))
        channels = [Channel(label="hammer", quantity="force", unit="N"), *answer.channels]
        records.append(Record(np.hstack([hammer, answer.values]), dt, channels, name="hit with a hammer",
                              simulated_by=answer.simulated_by))  # fmt: skip
    names = ("hit1.csv", "hit2.csv", "hit3.csv", "unknown.csv")
    files = [] if folder is None else [_csv(folder, *pair) for pair in zip(names, records, strict=True)]
    return Dataset(model, records[-1], force[::FINER], tuple(files))


def beam_sources(folder: str | os.PathLike[str] | None = None, *, seed: int = 0) -> Dataset:
    """A random force on a beam, four accelerometers, 20 s at 1024 Hz, and the FRFs of the beam.

    Parameters
    ----------
    folder : path, optional
        Where ``frfs.uff`` (four accelerances) and ``operating.uff`` (four records) are written, universal files.
    seed : int
        Of the force and of the noise, 1 % of the signals.
    """
    import numpy as np
    from scipy.signal import butter, lfilter

    from structures import ForwardModel, beams, damping, loads, sensors

    nodes, dt, samples = (5, 12, 14, 31), 1 / 1024, 20_000
    beam = beams.simply_supported(
        length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=40,
        damping=damping.Modal(0.03),
    )  # fmt: skip
    seen = [sensors.Accelerometer(f"{n}+Z") for n in nodes]
    model = ForwardModel(beam, seen, [loads.Point("13+Z")], modes=6, residual=False)
    rng = np.random.default_rng(seed)
    band = butter(2, [8 * 2 * dt / FINER, 250 * 2 * dt / FINER], "band")
    force = 20 * lfilter(*band, rng.standard_normal((samples * FINER, 1)), axis=0)
    record = _measured(model, force, dt, 0.01, seed + 1, [f"{n}+Z" for n in nodes], "beam in operation")
    if folder is None:
        return Dataset(model, record, force[::FINER])
    H = model.frf(np.arange(1, 512) * 0.5)
    frfs = [_universal(H[:, i, 0], n, 13, step=0.5) for i, n in enumerate(nodes)]
    logs = [_universal(record.values[:, i], n, 0, step=dt) for i, n in enumerate(nodes)]
    files = (_written(folder, "frfs.uff", SI + "".join(frfs)), _written(folder, "operating.uff", SI + "".join(logs)))
    return Dataset(model, record, force[::FINER], files)


def mast_wind(folder: str | os.PathLike[str] | None = None, *, seed: int = 0) -> Dataset:
    """A gusty load at the top of a mast of 12 m: two accelerometers and a strain gauge, 25 s at 200 Hz.

    Parameters
    ----------
    folder : path, optional
        Where ``commissioning.csv`` (the first 15 s) and ``today.csv`` (the rest) are written, with the columns
        ``time [s]``, ``20+Z [m/s^2]``, ``11+Z [m/s^2]``, ``root [m/m]``.
    seed : int
        Of the load and of the noise, 1 % of each signal.
    """
    import numpy as np

    from structures import ForwardModel, beams, damping, loads, sensors

    from .priors import Matern32

    mast = beams.cantilever(length=12.0, EI=4e6, mass_per_length=60.0, damping=damping.Modal(0.02))
    seen = [
        sensors.Accelerometer("20+Z"), sensors.Accelerometer("11+Z"),
        sensors.StrainGauge(at=0.5, fibre=0.1, label="root"),
    ]  # fmt: skip
    model = ForwardModel(mast, seen, [loads.Point("20+Z", label="wind")], modes=6)
    dt, samples, first = 0.005, 5000, 3000
    step = Matern32(500.0, 0.3).discrete(dt / FINER)
    state, force = np.zeros(2), np.empty((samples * FINER, 1))
    for k, noise in enumerate(np.random.default_rng(seed).standard_normal((len(force), 2))):
        force[k] = step.H @ state
        state = step.F @ state + step.LQ @ noise
    record = _measured(model, force, dt, 0.01, seed + 1, [c.label for c in model.sensors], "mast in the wind")
    files = [] if folder is None else [
        _csv(folder, name, record, part)
        for name, part in (("commissioning.csv", slice(0, first)), ("today.csv", slice(first, None)))
    ]  # fmt: skip
    return Dataset(model, record, force[::FINER], tuple(files))


def modal_test(folder: str | os.PathLike[str] | None = None, *, seed: int = 0) -> Dataset:
    """A beam shaken with a random force that is measured, 16 s at 4096 Hz, and hit twice; one sensor at the force.

    Parameters
    ----------
    folder : path, optional
        Where ``test.uff`` (accelerances of ``30+Z`` and ``14+Z`` over ``30+Z``), ``tap1.csv`` and ``tap2.csv`` (columns
        ``time [s]``, ``F [N]``, ``a1 [m/s^2]``, ``a2 [m/s^2]``) are written.
    seed : int
        Of the force and of the noise, 1 % of the signals (of the hits 0.2 %).

    Returns
    -------
    Dataset
        Record of the shaken beam with the channels ``F``, ``30+Z``, ``14+Z``. Of five modes below 700 Hz the fourth has
        a node at the force: the test shows four.
    """
    import numpy as np

    from structures import Channel, ForwardModel, beams, damping, loads, sensors

    from ._record import Record

    beam = beams.simply_supported(
        length=1.0, section=beams.Section.rectangle(0.04, 0.01), material=beams.materials.steel, elements=40,
        damping=damping.Modal(0.01),
    )  # fmt: skip
    model = ForwardModel(beam, [sensors.Accelerometer(f"{n}+Z") for n in (30, 14)], [loads.Point("30+Z", label="F")],
                         modes=9)  # fmt: skip
    dt, force_channel = 1 / 4096, Channel(label="F", quantity="force", unit="N")

    def test(force: NDArray[Any], labels: Sequence[str], noise: float, seed: int, name: str) -> Record:
        answer = _measured(model, force, dt, noise, seed, labels, name)
        return Record(np.hstack([force[::FINER], answer.values]), dt, [force_channel, *answer.channels], name=name,
                      simulated_by=answer.simulated_by)  # fmt: skip

    samples = 65_536
    force = np.repeat(10 * np.random.default_rng(seed).standard_normal((samples, 1)), FINER, axis=0)
    record = test(force, ["30+Z", "14+Z"], 0.01, seed + 1, "shaken beam")
    if folder is None:
        return Dataset(model, record, force[::FINER])
    H = model.frf(np.arange(1, 1601) * 0.5)
    frfs = "".join(_universal(H[:, i, 0], n, 30, step=0.5) for i, n in enumerate((30, 14)))
    files = [_written(folder, "test.uff", SI + frfs)]
    for k, length in enumerate((0.0015, 0.002), 1):
        pulse = _half_sine(8192, dt, peak=300.0, start=0.05, length=length)
        files.append(_csv(folder, f"tap{k}.csv", test(pulse, ["a1", "a2"], 0.002, seed + 1 + k, "hit beam")))
    return Dataset(model, record, force[::FINER], tuple(files))


def wing_strains(folder: str | os.PathLike[str] | None = None, *, seed: int = 0) -> Dataset:
    """The elliptic lift of a wing of 6 m, read by six strain gauges: 100 readings of one load.

    Parameters
    ----------
    folder : path, optional
        Where ``strains.csv`` is written: ``time [s]`` and six columns in m/m. The mean of a column has a noise of 1.5
        microstrain.
    seed : int
        Of the noise.

    Returns
    -------
    Dataset
        Its `model` has 24 patches, its `load` (24,) the lift at their middles in N/m.
    """
    import numpy as np

    from structures import Channel, ForwardModel, bases, beams, sensors

    from ._record import Record

    places, noise, readings = (0.2, 1.0, 2.0, 3.0, 4.0, 5.0), 1.5e-6, 100

    def stiffness(x: Any) -> Any:
        return 9e5 * (1 - x / 12) ** 3

    def wing(elements: int) -> tuple[Any, list[Any]]:
        body = beams.cantilever(length=6.0, EI=stiffness, mass_per_length=20.0, elements=elements)
        gauges = [
            sensors.StrainGauge(at=x, fibre=0.08 * (1 - x / 12), noise=noise, label=f"g{k}")
            for k, x in enumerate(places, 1)
        ]
        return body, gauges

    def lift(x: Any) -> Any:
        return 900 * np.sqrt(np.maximum(1 - (x / 6) ** 2, 0.0))

    fine, gauges = wing(120)
    at = np.linspace(0, 6, 121)
    truth = ForwardModel(fine, gauges, bases.hats(fine, [at]))
    clean = truth.static() @ lift(at)
    values = clean + noise * readings**0.5 * np.random.default_rng(seed).standard_normal((readings, len(places)))
    channels = [Channel(label=f"g{k}", quantity="strain", unit="m/m") for k in range(1, len(places) + 1)]
    record = Record(values, 0.1, channels, name="wing under lift", simulated_by=truth.fingerprint)
    body, gauges = wing(40)
    files = [] if folder is None else [_csv(folder, "strains.csv", record)]
    return Dataset(ForwardModel(body, gauges, bases.patches(body, 24)), record, lift(np.arange(0.125, 6, 0.25)),
                   tuple(files))  # fmt: skip


PLAN = """output = "march"                    # folder of all that is written

[run]
workers = 2

[every]
model = "models/{name}.h5"
records = ["{name}/2026-03-*.csv"]
start = "%Y-%m-%dT%H%M.csv"

[[asset]]
name = "beam-1"

[[asset]]
name = "beam-2"
limits = { "31+Z" = 150 }            # N: the hits on this one are beyond it
"""


def fleet(folder: str | os.PathLike[str], *, seed: int = 0) -> tuple[Dataset, ...]:
    """Two cantilevers, two records of each, and the plan of ``loadid batch`` that finds their loads.

    Parameters
    ----------
    folder : path
        Where ``plan.toml``, ``models/beam-1.h5``, ``beam-1/2026-03-01T0000.csv`` and so on are written.
    seed : int
        Of the noise of the first record; the next one has the next.

    Returns
    -------
    tuple of Dataset
        One of each record, asset by asset.
    """
    found = []
    _written(folder, "plan.toml", PLAN)
    for k, asset in enumerate(("beam-1", "beam-2")):
        for day in (1, 2):
            one = impact(seed=seed + 2 * k + day - 1)
            file = _csv(Path(folder) / asset, f"2026-03-{day:02d}T0000.csv", one.record)
            found.append(Dataset(one.model, one.record, one.load, (file,)))
        model = Path(folder) / "models" / f"{asset}.h5"
        model.parent.mkdir(exist_ok=True)
        one.model.save(model)
    return tuple(found)


# -- what they share --------------------------------------------------------------------------------------------------
def _half_sine(samples: int, dt: float, *, peak: float, start: float, length: float) -> NDArray[Any]:
    """A pulse on the fine grid, shape (samples * FINER, 1)."""
    import numpy as np

    phase = (np.arange(samples * FINER) * dt / FINER - start) / length
    return np.where((phase >= 0) & (phase <= 1), peak * np.sin(np.pi * phase), 0.0)[:, None]


def _measured(
    truth: Any, force: NDArray[Any], dt: float, noise: float, seed: int, labels: Sequence[str], name: str
) -> Record:
    """The response of a model at every sample of a record, with noise of a share of each signal."""
    import numpy as np

    from structures import Channel

    from ._record import Record

    clean = truth.predict(force, dt / FINER)[::FINER]
    values = clean + noise * clean.std(axis=0) * np.random.default_rng(seed).standard_normal(clean.shape)
    channels = [
        Channel(label=label, quantity=sensor.quantity, unit=sensor.unit)
        for label, sensor in zip(labels, truth.sensors, strict=True)
    ]
    return Record(values, dt, channels, name=name, simulated_by=truth.fingerprint)


def _written(folder: str | os.PathLike[str], name: str, content: str) -> Path:
    from structures.files._storage import as_path, replace

    target = as_path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("the folder cannot be made", where=str(target), found=error.strerror or error) from error
    replace(target / name, content.encode())
    return target / name


def _csv(folder: str | os.PathLike[str], name: str, record: Record, part: slice = slice(None)) -> Path:
    """A record as a table whose heading states names and units; ten digits."""
    values = record.values[part]
    head = ["time [s]", *(f"{c.label} [{c.unit}]" for c in record.channels)]
    rows = (",".join(f"{v:.10g}" for v in (k * record.dt, *row)) for k, row in enumerate(values.tolist()))
    return _written(folder, name, "\n".join([",".join(head), *rows, ""]))


END = f"{-1:6d}\n"
# data set 164 of universal files: numbers are in SI
SI = END + f"{164:6d}\n{9:10d}{'SI':20s}{2:10d}\n" + f"{1:25.17E}{1:25.17E}{1:25.17E}\n{273.15:25.17E}\n" + END


def _universal(values: NDArray[Any], node: int, reference: int, *, step: float) -> str:
    """A data set 58 of universal files: an accelerance from the first step on, or an acceleration over time."""
    import numpy as np

    frf = np.iscomplexobj(values)
    way = 3 if reference else 0
    lines = [f"{'NONE':80s}"] * 5
    lines.append(
        f"{4 if frf else 1:5d}{0:10d}{0:5d}{0:10d} {'NONE':10s}{node:10d}{3:4d} {'NONE':10s}{reference:10d}{way:4d}"
    )
    lines.append(f"{6 if frf else 4:10d}{len(values):10d}{1:10d}{step if frf else 0:13.5E}{step:13.5E}{0:13.5E}")
    axes = ((18, "frequency", "Hz") if frf else (17, "time", "s"), (12, "acceleration", "m/s^2"),
            (13, "force", "N") if frf else (0, "NONE", "NONE"), (0, "NONE", "NONE"))  # fmt: skip
    lines += [f"{kind:10d}{0:5d}{0:5d}{0:5d} {text:20s} {unit:20s}" for kind, text, unit in axes]
    numbers = (np.ascontiguousarray(values).view(float) if frf else values).tolist()
    lines += ["".join(f"{v:20.12E}" for v in numbers[k : k + 4]) for k in range(0, len(numbers), 4)]
    return END + f"{58:6d}\n" + "\n".join(lines) + "\n" + END
