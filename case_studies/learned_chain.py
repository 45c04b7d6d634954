"""A chain whose load a learned map gives within one per cent, and loads of which it says that they are not its own.

In place of Yang et al., Mech. Syst. Signal Process. 185 (2023) 109757 (load identification by a deep network), of which
no figure is compared; the case is ours. Five masses of 1 kg on springs of 2e4 N/m, fixed at one end, damping 0.002 K;
one force on the third mass; accelerometers on masses 1, 3 and 5, displacement sensors on 3 and 5, with noise of 1 % of
what they read; 200 Hz, 4000 samples. A map learns from records of random loads between 0.2 and 20 Hz. Then come loads
that it knows and loads that it does not: in the band, a sine and a constant; outside, a sine of 40 Hz and an impact of
two samples, and the chain with stiffness 10 % up or down. Errors are taken without the first and last 100 samples, and
are medians over records that no map has seen.

Two columns show what the map alone would say and what is answered: where the alarm is raised, by Tikhonov on the same
record, so that no answer is worse than that. With a network (extra ``learn``) its row is printed too.

Run ``python -m case_studies.learned_chain``: prints the table and saves ``learned_chain.png``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loadid import Deconvolution, FittedMap, LearnedMap, Record
from loadid.generate import Examples, TrainingSet
from structures import ForwardModel, chains, damping, loads, sensors

Array = NDArray[np.float64]

FS, SAMPLES, EDGE = 200.0, 4000, 100
NOISE, STIFFNESS, BAND = 0.01, 2e4, (0.2, 20.0)
DRAWS = 500  # records of the training set
NETWORK = 0.24  # share of them that a network learns from
KINDS = ("in distribution", "sine 5 Hz", "constant", "sine 40 Hz", "impact", "stiffness + 10 %", "stiffness - 10 %")
OUTSIDE = KINDS[3:]


@dataclass(frozen=True)
class Trial:
    """One record of one kind.

    Parameters
    ----------
    kind : str
    map_error, answered_error : float
        Of the map alone, and of what is answered.
    tikhonov_error : float
        Of `Deconvolution` on the same record; NaN where it was not asked.
    coverage : float
        Of the map's 95 % band.
    novelty : float
        Above 1 is an alarm.
    """

    kind: str
    map_error: float
    answered_error: float
    tikhonov_error: float
    coverage: float
    novelty: float


class Study:
    """A chain, its training set, and the maps that were learned from it.

    Parameters
    ----------
    draws : int
        Of the training set.
    """

    def __init__(self, draws: int = DRAWS) -> None:
        rng = np.random.default_rng(1)
        histories = np.stack([random_load(rng) for _ in range(draws)])[:, :, None]
        clean = np.stack([chain().predict(load, 1 / FS, hold="zoh") for load in histories])
        self.noise = NOISE * clean[:3].reshape(-1, clean.shape[-1]).std(axis=0)
        data = clean + self.noise * rng.standard_normal(clean.shape)
        self.training = TrainingSet.of(
            Examples.measured(data, histories, noise=self.noise, kinds="random"),
            sensors=chain().sensors, loads=chain().loads, dt=1 / FS,
        )  # fmt: skip
        self.tikhonov = Deconvolution(chain(), hold="zoh", noise=self.noise)

    @cached_property
    def linear(self) -> FittedMap:
        """The linear map."""
        return LearnedMap(chain(), hold="zoh", physics=self.tikhonov).fit(self.training)

    @cached_property
    def network(self) -> FittedMap | None:
        """The network, where its library is installed."""
        if find_spec("torch") is None:
            return None
        (some,) = self.training.split((NETWORK,))
        return LearnedMap(chain(), engine="torch", hold="zoh", physics=self.tikhonov).fit(some)

    def record(self, kind: str, seed: int) -> tuple[Array, Array]:
        """A load (samples,) of a kind and what the sensors read of it (samples, sensors)."""
        rng = np.random.default_rng([2, KINDS.index(kind), seed])
        load = load_of(kind, rng)
        factor = {"stiffness + 10 %": 1.1, "stiffness - 10 %": 0.9}.get(kind, 1.0)
        clean = chain(factor).predict(load, 1 / FS, hold="zoh")
        return load, clean + self.noise * rng.standard_normal(clean.shape)

    def trials(self, learned: FittedMap, kind: str, seeds: Sequence[int], asked: int) -> list[Trial]:
        """Records of one kind through a map; the first `asked` of them through Tikhonov too."""
        found = []
        for seed in seeds:
            load, y = self.record(kind, seed)
            told = learned.predict(y[None])
            inside = np.abs(told.mean[0, :, 0] - load) <= 1.96 * told.std[0, :, 0]
            answered = plain = np.nan
            if seed < asked:
                record = Record(y, 1 / FS, chain().sensors)
                plain = error_of(self.tikhonov.estimate(record).load[:, 0], load)
                answered = error_of(learned.estimate(record).load[:, 0], load)
            found.append(Trial(kind, error_of(told.mean[0, :, 0], load), answered, plain, float(np.mean(inside)),
                               told.verdicts[0].value))  # fmt: skip
        return found


def error_of(found: Array, load: Array) -> float:
    """Relative error without the ends."""
    inside = slice(EDGE, -EDGE)
    return float(np.linalg.norm(found[inside] - load[inside]) / np.linalg.norm(load[inside]))


def auc(inside: Sequence[float], outside: Sequence[float]) -> float:
    """Probability that a record from outside scores above one from inside."""
    a, b = np.asarray(inside)[:, None], np.asarray(outside)
    return float(np.mean((b > a) + 0.5 * (b == a)))


def chain(factor: float = 1.0) -> ForwardModel:
    """The chain, its stiffness multiplied; the displacements are read in units in which the first spring gives 1 N."""
    structure = chains.chain(masses=np.ones(5), springs=factor * STIFFNESS, damping=damping.Rayleigh(0.0, 0.002))
    places = [sensors.Accelerometer(f"{n}+X", label=f"a{n}") for n in (1, 3, 5)]
    places += [sensors.Displacement(f"{n}+X", label=f"u{n}") for n in (3, 5)]
    return ForwardModel(structure, sensors=places, loads=[loads.Point("3+X")])


def random_load(rng: np.random.Generator) -> Array:
    """Lines of random amplitude and phase in the band, unit std."""
    lines = np.fft.rfftfreq(SAMPLES, 1 / FS)
    inside = (lines >= BAND[0]) & (lines <= BAND[1])
    spectrum = inside * (rng.standard_normal(len(lines)) + 1j * rng.standard_normal(len(lines)))
    load = np.fft.irfft(spectrum, SAMPLES)
    return load / np.std(load)


def load_of(kind: str, rng: np.random.Generator) -> Array:
    """One load of a kind, unit std or unit size."""
    t = np.arange(SAMPLES) / FS
    if kind.startswith("sine"):
        return np.sqrt(2) * np.sin(2 * np.pi * float(kind.split()[1]) * t + rng.uniform(0, 2 * np.pi))
    if kind == "constant":
        return np.ones(SAMPLES)
    if kind == "impact":
        load, at = np.zeros(SAMPLES), int(rng.integers(1000, 3000))
        load[at : at + 2] = 10.0
        return load
    return random_load(rng)


def show(name: str, trials: Sequence[Trial]) -> str:
    """The table of one map in text."""
    inside = [t.novelty for t in trials if t.kind not in OUTSIDE]
    lines = [
        (
            f"{name}: errors relative, of the map medians over all records, of what is answered and of Tikhonov over "
            "the first; alarm is the share of records answered by Tikhonov"
        ),
        f"{'load':18s} {'map alone':>9s} {'answered':>9s} {'Tikhonov':>9s} {'coverage':>9s} {'alarm':>6s} {'AUC':>6s}",
    ]
    for kind in KINDS:
        own = [t for t in trials if t.kind == kind]
        if not own:
            continue
        one = auc(inside, [t.novelty for t in own]) if kind in OUTSIDE and inside else float("nan")
        answered, plain = (
            float(np.nanmedian([getattr(t, part) for t in own])) for part in ("answered_error", "tikhonov_error")
        )
        lines.append(
            f"{kind:18s} {np.median([t.map_error for t in own]):9.4f} {answered:9.4f} {plain:9.4f} "
            f"{np.mean([t.coverage for t in own]):9.3f} {np.mean([t.novelty > 1 for t in own]):6.3f} "
            + (f"{one:6.3f}" if np.isfinite(one) else f"{'':6s}")
        )
    return "\n".join(lines)


def all_trials(study: Study, learned: FittedMap, *, known: int = 200, other: int = 20, asked: int = 1) -> list[Trial]:
    """Records of every kind: so many in distribution, so many of each other kind."""
    return [
        trial
        for kind in KINDS
        for trial in study.trials(learned, kind, range(known if kind == KINDS[0] else other), asked)
    ]


def picture(study: Study, path: Path) -> None:
    """A load of the set and an impact: truth, the map alone, and what is answered."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 6), layout="constrained")
    for ax, kind in zip(figure.subplots(2, 1), (KINDS[0], "impact"), strict=True):
        load, y = study.record(kind, 0)
        told = study.linear.predict(y[None])
        answer = study.linear.estimate(Record(y, 1 / FS, chain().sensors))
        middle = int(np.argmax(np.abs(load[1000:3000]))) + 1000
        shown = slice(middle - 60, middle + 60)
        t = np.arange(SAMPLES)[shown] / FS
        ax.plot(t, load[shown], color="k", lw=1.2, label="true")
        ax.plot(t, told.mean[0, shown, 0], color="C1", lw=1.2, ls="--", label="map alone")
        ax.plot(t, answer.load[shown, 0], color="C0", lw=1.2, label=f"answered by {answer.facts.answered_by}")
        ax.set(ylabel="force in N", title=f"{kind}: novelty {answer.facts.novelty:.3g}, alarm above 1")
        ax.legend()
    ax.set(xlabel="time in s")
    figure.savefig(path, dpi=130)


def main() -> None:
    """Print the table of each map and save the picture."""
    study = Study()
    sys.stdout.write(show("linear map", all_trials(study, study.linear)) + "\n\n")
    network = study.network
    if network is None:
        sys.stdout.write("network: not run, torch is not installed (extra learn)\n\n")
    else:
        sys.stdout.write(show("network", all_trials(study, network)) + "\n\n")
    target = Path("learned_chain.png")
    picture(study, target)
    sys.stdout.write(f"picture: {target}\n")


if __name__ == "__main__":
    main()
