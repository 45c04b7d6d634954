"""Guards of the vibration laboratory: targets, limits, interfaces."""

from __future__ import annotations

import numpy as np

from loadid import FrequencyInversion, Spectra
from loadid.vibration import Limit, Target, VirtualPoint, buzz, by_buzz, by_coherence, find_drives, transfer_paths
from structures import CrossSpectra, Flag

from .. import lab, mounted
from .cases import Case, refused

UP = (0.0, 0.0, 1.0)


def target(sensors: tuple[str, ...] = lab.TARGET) -> Target:
    field = lab.field().restricted(list(sensors))
    return Target(field.frequencies, field.autospectra, field.channels)


def matrix(coupled: bool) -> tuple[Flag, ...]:
    S = lab.field().restricted(list(lab.TARGET))
    if not coupled:
        S = CrossSpectra(S.frequencies, S.matrix * np.eye(8), channels=S.channels, averages=np.inf)
    return refused(lambda: FrequencyInversion(lab.shaken(), sensors=list(lab.TARGET)).estimate(S))


def averaged(averages: float) -> tuple[Flag, ...]:
    part, wanted = lab.part(lab.shaken(), lab.TARGET), target()
    own = buzz(part, wanted.frequencies)
    return by_buzz(wanted, CrossSpectra(own.frequencies, own.matrix, channels=own.channels, averages=averages)).flags


def limited(share: float) -> tuple[Flag, ...]:
    """Flags where the first shaker may have a share of what it would take, and the others no more than they take."""
    free = find_drives(lab.shaken(), target())
    limits = [Limit(c.label, rms=share * float(r)) for c, r in zip(free.loads, free.rms, strict=True)]
    return find_drives(lab.shaken(), target(), limits=limits).flags


def reached(shakers: int) -> tuple[Flag, ...]:
    """Flags where so many of the shakers are to make the whole field."""
    m = lab.shaken()
    few = type(m)(m.frequencies, m.H[..., :shakers], sensors=m.sensors, loads=m.loads[:shakers])
    return find_drives(few, target()).flags


def interface(bent: float) -> tuple[Flag, ...]:
    case = mounted.made(bent=bent)
    foot = VirtualPoint("foot", {n: (p, UP) for n, p in mounted.HITS.items()},
                        {n: (p, UP) for n, p in mounted.AROUND.items()}, motions=("Z", "RX", "RY"))  # fmt: skip
    data = Spectra(case.model.frequencies, case.operation, case.model.sensors, noise=case.noise)
    return transfer_paths(case.model, data, points=[foot], validation=["k1"]).flags


CASES = [
    Case("E221", lambda: matrix(False), lambda: matrix(True), r"8 channels"),
    Case("W222", lambda: by_coherence(target(), 1.0, phase=2.0).flags, lambda: by_coherence(target(), 0.2).flags,
         r"120 of 120 lines", "coherence"),
    Case("W222", lambda: averaged(8.0), lambda: averaged(100.0), r"8 averages of 8 channels", "buzz"),
    Case("W316", lambda: limited(0.4), lambda: limited(0.95), r"\d\.\d* dB rms off the target"),
    Case("W317", lambda: reached(1), lambda: reached(4), r"\d+% of the"),
    Case("W119", lambda: interface(1.0), lambda: interface(0.0), r"less than 90%"),
]  # fmt: skip
