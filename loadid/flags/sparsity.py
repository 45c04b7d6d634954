"""Guards of the prior: impacts under a smooth prior, slow loads under a sparse one, spikes where there are pulses."""

from __future__ import annotations

from structures.flags import Evidence, Flag

PEAKED = 20.0  # kurtosis of a load above which it is made of impacts
IMPULSIVE = 8.0  # kurtosis above which impacts are looked for; a fifth of the time in pulses has 7.5
NARROW = 2.0  # width of the largest pulse over the resolution below which the pulse may be narrower than it looks
LOST = 0.5  # share of a single-sample peak that the prior takes away, above which that lowers the peak
DENSE = 0.3  # share of the dictionary in use above which a load is not sparse
CLEARLY = 10.0  # difference of the information criterion that counts as strong evidence
UNSURE = 0.25  # std of an amplitude over the amplitude above which it is not determined
MISFIT = 1.3  # residual over noise above which a dictionary does not hold the load
SOLVED = 1e-5  # relative duality gap above which an l1 solution is none
CLASSES = {"impact": ("sparse",), "service": ("tikhonov",)}


def impulsive(kurtosis: float, prior: str) -> Flag | None:
    """W311 under a smooth prior, of a load that was declared: what came out is made of impacts.

    It is asked only where a class of load was declared. A high kurtosis alone does not show that the prior is wrong: a
    pulse that the data resolve is as high and as wide as it should be, and has that kurtosis too. `smeared` is asked
    always.

    Parameters
    ----------
    kurtosis : float
        Fourth moment over the square of the second, of the load about zero (3 for a Gaussian one).
    prior : str
        In words.
    """
    if not kurtosis > PEAKED:
        return None
    return Flag(
        "W311",
        Evidence("kurtosis of the load", float(kurtosis), PEAKED),
        f"the load looks impulsive (kurtosis {kurtosis:.3g}); the prior used was {prior}: it smears and lowers peaks",
        "compare SparseDeconvolution(dictionary='bspline'), or let the load only push; recommend() says which fits",
    )


def smeared(kurtosis: float, pulse: float, resolution: float, lost: float, prior: str) -> Flag | None:
    """W311 under a smooth prior: the largest pulse is about as narrow as anything can be shown, and far too low.

    Three signs together: a load of impacts, its largest pulse hardly wider than the answer to a single sample, and a
    prior that takes more than half of the height of such an answer. Calibrated by ``python -m
    tests.benchmarks.smeared``: raised on 95 of 96 records whose pulses came out at a tenth to four fifths of their
    height; silent on 144 whose pulses were resolved (0.72 to 1.03 of their height) and on 24 of random loads.

    Parameters
    ----------
    kurtosis : float
        As in `impulsive`.
    pulse, resolution : float
        Width of the largest pulse at half its height, and of the answer to a single-sample load at its place, in
        samples.
    lost : float
        Share of the height of that load that the answer lacks.
    prior : str
        In words.
    """
    if not (kurtosis > IMPULSIVE and pulse < NARROW * resolution and lost > LOST):
        return None
    return Flag(
        "W311",
        Evidence("width of the largest pulse over the resolution", float(pulse / resolution), NARROW),
        f"the load looks impulsive (kurtosis {kurtosis:.3g}), and its largest pulse is no wider than what is resolved "
        f"({pulse:.3g} and {resolution:.3g} samples): the prior ({prior}) smears it, and a single-sample peak is shown "
        f"at {1 - lost:.0%} of its height",
        "compare SparseDeconvolution(dictionary='bspline'), or let the load only push; recommend() says which fits; an "
        "accelerometer near the load resolves more",
    )


def dense_support(count: int, atoms: int) -> Flag | None:
    """W311 under l1: so much of the dictionary is in use that nothing is sparse about the load."""
    share = count / max(atoms, 1)
    if share <= DENSE:
        return None
    return Flag(
        "W311",
        Evidence("share of the dictionary in use", float(share), DENSE),
        f"the load looks dense: {count} of {atoms} waveforms are in use; the prior used was a sparse one",
        "use Deconvolution (Tikhonov) for a load that acts all the time",
    )


def wide_pulses(gain: float, knots: int, spikes: int, used: str = "spikes of one sample") -> Flag | None:
    """W311 under l1 on a dictionary of too narrow or too wide waveforms: B-splines of another spacing fit far better.

    Parameters
    ----------
    gain : float
        By how much the extended information criterion of those is smaller.
    knots : int
        Their spacing, in samples.
    spikes : int
        Waveforms in use.
    used : str
        The waveforms, in words.
    """
    if not gain > CLEARLY:
        return None
    return Flag(
        "W311",
        Evidence("information criterion in favour of wider pulses", float(gain), CLEARLY),
        f"the pulses are not {used}: {spikes} of these stand for them, with peaks that mean nothing; cubic B-splines "
        f"with knots every {knots} samples explain the record by {gain:.3g} better",
        f"SparseDeconvolution(dictionary='bspline', knots={knots}) or knots='scan'; or Tikhonov with a load that only "
        "pushes",
    )


def unexplained(level: float, prior: str) -> Flag | None:
    """W311 under l1: no load of the dictionary explains the data to their noise; `level` is residual over noise."""
    if not level > MISFIT:
        return None
    return Flag(
        "W311",
        Evidence("residual over noise", float(level), MISFIT),
        f"the dictionary ({prior}) cannot explain the data: the residual is {level:.3g} times the stated noise",
        "narrower waveforms (knots='scan'), or another prior; then look for model error or a noise level too small",
    )


def unsure_amplitudes(share: float, label: str) -> Flag | None:
    """W304 of spikes: their places are told by the data, their heights are not.

    Parameters
    ----------
    share : float
        Std of the largest spike over its height, if its neighbours in time may act too.
    label : str
        Load that it belongs to.
    """
    if not share > UNSURE:
        return None
    return Flag(
        "W304",
        Evidence("std of the largest spike over its height, neighbours allowed", float(share), UNSURE),
        f"the spikes are well placed, their heights are not to be trusted: if the neighbouring samples act too, the "
        f"largest ({label}) is known to ± {share:.0%} only; under Tikhonov it would be smeared and too low instead",
        "read places and impulses (functional('impulse', window=...)), not peaks; an accelerometer near the load, or "
        "less noise, tells single samples apart",
    )


def declared_class(declared: str | None, prior: str) -> Flag | None:
    """W510: the load was declared as one that the prior does not fit, before any data.

    Parameters
    ----------
    declared : {"impact", "service"} or None
        Hammer blows and shocks; loads that act all the time.
    prior : {"sparse", "tikhonov"}
    """
    if declared is None or prior in CLASSES[declared]:
        return None
    other = "SparseDeconvolution, or a load that only pushes" if declared == "impact" else "Deconvolution (Tikhonov)"
    return Flag(
        "W510",
        Evidence("prior", prior, f"one that fits {declared} loads"),
        f"the prior is {prior}, the load class says {declared}",
        f"switch the family: {other}",
    )


def stopped_gap(gap: float, wanted: float) -> Flag | None:
    """W410 of an l1 problem: rounding ended it above the gap that was asked for, and below the one that is refused."""
    if gap <= wanted:
        return None
    return Flag(
        "W410",
        Evidence("relative duality gap", float(gap), wanted),
        f"the l1 problem was solved to a duality gap of {gap:.2g}, not to {wanted:.2g}: neighbouring responses are "
        "equal to rounding",
        "a larger mu, or a coarser dictionary (knots=)",
    )
