"""What the stated 95 % band holds. `python -m tests.benchmarks.coverage [DRAWS]`.

Loads drawn from the prior at the lambda that belongs to it, where the band must hold 94 to 96 %; then loads that the
prior does not describe (bumps, a flat punch, a Hertz contact on a compliant surface; half-sine impacts), with the
automatic lambda. Where a band fails, a user who passes the outcome as ``coverage=`` reads so in the summary (W703).
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

from case_studies import contact_inversion, impact_plate
from loadid import Deconvolution, Noise, StaticInversion
from loadid.validate import coverage


def from_the_prior(draws: int, m: int = 16, n: int = 24) -> tuple[str, float]:
    """White loads of unit variance through a smooth kernel, lambda = sigma over that variance."""
    x, s = contact_inversion.nodes(n), contact_inversion.nodes(m)
    H, sigma = contact_inversion.kernel(0.1, s, x), 1e-3
    family = StaticInversion(H, noise=Noise(sigma, source="repeatability"))
    scale = float(np.linalg.norm(H / sigma, 2))
    family = StaticInversion(H, noise=Noise(sigma, source="repeatability"), choice=1.0 / scale)
    found = coverage(family, lambda rng: rng.standard_normal(n), noise=sigma, draws=draws)
    return "white loads, lambda of their prior", found.share


def contact(profile: str, draws: int, constraints: tuple = ()) -> tuple[str, float, str]:
    """A pressure profile on a compliant surface; data from a grid ten times finer."""
    shape, t = contact_inversion.PROFILES[profile], 0.1
    p, inside = contact_inversion.truth(shape), 0
    for seed in range(draws):
        y, sigma = contact_inversion.readings(t, shape, "every node", seed)
        estimate = StaticInversion(
            contact_inversion.model(t), noise=Noise(sigma, source="repeatability"), constraints=constraints
        ).estimate(y)
        low, high = estimate.band()
        inside += np.sum((p >= low) & (p <= high))
    return f"{profile} on a compliant surface", inside / (draws * len(p)), estimate.facts["band"]


def impacts(draws: int) -> tuple[str, float]:
    """Half-sine hits on the clamped plate, seen by one strain gauge."""
    plate, g = impact_plate.model("strain", 0.5), impact_plate.force()
    clean: NDArray = plate.predict(g, impact_plate.DT)
    sigma = 0.01 * float(np.sqrt(np.mean(clean**2)))
    family = Deconvolution(plate, noise=Noise(sigma, source="unloaded record"))
    return "half-sine impacts", coverage(family, g, impact_plate.DT, noise=sigma, draws=draws).share


def failing(share: float) -> str:
    """What the summary of an estimate says when it knows this coverage."""
    from loadid._guards import no_coverage
    from loadid.validate import Coverage

    flag = no_coverage(Coverage(share, 0.95, 0, ""))
    return "" if flag is None else "summary says W703"


def main() -> None:
    """Print the table."""
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else 2000
    name, share = from_the_prior(draws)
    print(f"{name:48s} {share:7.2%}   ({draws} draws; to reach: 94 to 96 %)")
    few = max(draws // 20, 10)
    for profile in contact_inversion.PROFILES:
        name, share, band = contact(profile, few)
        print(f"{name:48s} {share:7.2%}   ({few} draws)  {failing(share)}")
    from loadid.constraints import NonNegative

    name, share, band = contact("hertz", few, (NonNegative(),))
    print(f"{name + ', p >= 0':48s} {share:7.2%}   ({few} draws)  {failing(share)}  band: {band}")
    name, share = impacts(max(few // 4, 5))
    print(f"{name:48s} {share:7.2%}   ({max(few // 4, 5)} draws)  {failing(share)}")


if __name__ == "__main__":
    main()
