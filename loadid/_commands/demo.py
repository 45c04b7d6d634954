"""``loadid demo``: a hit on a beam, simulated, rebuilt and written down. Needs no file."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import structures
from structures._channels import Channel
from structures.errors import InputError

from .._results.summary import against, comparison, summary
from . import Bar, Command, add_details, emit, require_outputs
from . import seed as _seed
from .identify import identify, write_all

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from structures._models.forward import ForwardModel

    from .._record import Record
    from .._results.estimate import LoadEstimate


EXAMPLES = """\
examples:
  a hit, rebuilt; result, picture and report in the folder loadid-demo:
    loadid demo
  other noise, elsewhere, with all that is known of the answer:
    loadid demo --seed 7 --out other --details
"""
LENGTH, WIDTH, HEIGHT = 1.0, 0.04, 0.01  # m, steel, simply supported
DAMPING = 0.06
SENSORS = {"A1": 0.19, "A2": 0.41, "A3": 0.76}  # m from the left end
HIT_AT, PEAK, START, DURATION = 0.59, 1000.0, 0.05, 0.002  # m, N, s, s
RATE, SAMPLES = 10000.0, 6000  # the first mode rings down to 0.5 % within the record
FINER = 8  # steps of the simulation per sample of the record
NOISE = 0.015  # std over the rms of each channel


@dataclass(frozen=True, eq=False)
class Simulated:
    """A simulated record and the force behind it, shape (samples,)."""

    record: Record
    force: NDArray[Any]


def model(elements: int = 30, modes: int = 14) -> ForwardModel:
    """Steel beam with three accelerometers and one force: what the inversion knows."""
    beams, sensors = structures.beams, structures.sensors
    beam = beams.simply_supported(
        length=LENGTH,
        elements=elements,
        section=beams.Section.rectangle(WIDTH, HEIGHT),
        material=beams.Material(E=210e9, rho=7850.0),
        damping=structures.damping.Modal(DAMPING),
    )
    places = [sensors.Accelerometer(at=x, direction="+Z", label=name) for name, x in SENSORS.items()]
    hit = structures.loads.Point(at=HIT_AT, direction="+Z", label="hit")
    made: ForwardModel = structures.ForwardModel(beam, places, [hit], modes=modes)
    return made


def simulate(seed: int = 0) -> Simulated:
    """Log of a half-sine hit, from a finer mesh, more modes and a finer step than `model` has."""
    import numpy as np

    from .._record import Record

    truth = model(elements=80, modes=28)
    step = 1 / (RATE * FINER)
    phase = (np.arange(SAMPLES * FINER) * step - START) / DURATION
    force = np.where((phase >= 0) & (phase <= 1), PEAK * np.sin(np.pi * phase), 0.0)
    clean = truth.predict(force, step)[::FINER]
    noise = NOISE * np.sqrt(np.mean(clean**2, axis=0))
    noisy = clean + noise * np.random.default_rng(seed).standard_normal(clean.shape)
    channels = [_channel(name) for name in SENSORS]
    record = Record(noisy, 1 / RATE, channels, name="simulated hit", simulated_by=truth.fingerprint)
    return Simulated(record, force[::FINER])


def demo(
    folder: str | Path = "loadid-demo", *, seed: int = 0, progress: Any = None
) -> tuple[LoadEstimate, Simulated, list[str]]:
    """Simulate a hit, rebuild it, and write ``impact.h5``, ``impact.png`` and ``impact.html``.

    Returns
    -------
    estimate, simulated, paths written

    Raises
    ------
    InputError
        If the folder cannot be made or written.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("the folder cannot be made", where=str(folder), found=error.strerror or error) from error
    files = {kind: folder / f"impact.{kind}" for kind in ("h5", "html", "png")}
    require_outputs(files)
    simulated = simulate(seed)
    estimate = identify(simulated.record, model(), progress=progress)
    written = write_all(
        estimate,
        files["h5"],
        report=files["html"],
        plot=files["png"],
        truth=simulated.force[:, None],
    )
    return estimate, simulated, written


def _channel(label: str) -> Any:
    return Channel(label=label, quantity="acceleration", unit="m/s^2")


def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument("--out", metavar="DIR", default="loadid-demo", help="folder to write to (default: %(default)s)")
    parser.add_argument("--seed", type=_seed, default=0, help="of the noise (default: %(default)s)")
    add_details(parser)


def _run(args: Namespace) -> int:
    with Bar() as bar:
        estimate, simulated, written = demo(args.out, seed=args.seed, progress=bar)
    error = against(estimate, simulated.force)
    lines = [
        f"A simulated hit of {PEAK:g} N on a steel beam, three accelerometers, {NOISE:.1%} noise.",
        summary(estimate, details=args.details, command=True),
        comparison(error),
        f"written: {', '.join(written)}",
    ]
    answer = {
        "against_known": error,
        "flags": sorted(estimate.codes),
        "summary": summary(estimate, details=args.details, command=True),
        "written": written,
    }
    emit(args, answer, "\n".join(lines))
    return 0


command = Command("demo", "simulate a hit on a beam, rebuild it, write result, picture and report", _configure, _run)
