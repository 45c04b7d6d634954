"""Choices of a skin, one after the other: what each does to a force map, as a number, before any skin is made.

No paper stands behind this one: it asks `tactile.design` about the statements that one meets wherever soft skins are
designed (softer is more sensitive, thinner is sharper, more markers average more noise, put the markers where they are
safe). About one design, 3 mm of a gel of 0.147 MPa and nu = 0.3223 with markers every millimetre on its surface, 2.1 um
of noise in the plane (0.03 px at 14 px/mm) and 10 um in depth, each of six choices is varied alone: thickness, modulus,
compressibility, density of the markers, their depth, and the camera. Loads are independent on patches of 1 mm, 10 kPa
each; the pad is a bonded layer without edges; signals are those of the exact kernels.

Measured here: the conclusions under each table. Three go against the saying. A thinner skin is sharper in how far it
spreads a load, and hardly in what it tells of a patch of 1 mm; a softer one gains no conditioning and pays each gain of
signal with the load that it bears; and markers half a millimetre under the surface cost shear first, because there
is a wave of shear that does not move them in the plane.

Run ``python -m case_studies.skin_design``: prints tables and conclusions and saves ``skin_design.png``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from tactile import design
from tactile.design import SkinComparison, SkinDesign

BASE: dict[str, Any] = {"h": 3e-3, "E": 0.147e6, "nu": 0.3223}
KNOBS: dict[str, dict[str, dict[str, Any]]] = {
    "thickness": {f"{h} mm": {"h": h * 1e-3} for h in (1, 2, 3, 4)},
    "modulus": {f"{E:g} kPa": {"E": E * 1e3} for E in (50, 147, 300, 435)},
    "compressibility": {f"nu {nu:g}": {"nu": nu} for nu in (0.3223, 0.4, 0.45, 0.475, 0.49)},
    "markers": {
        **{f"every {p:g} mm": {"pitch": p * 1e-3} for p in (2, 1, 0.5)},
        **{
            f"{p:g} mm, shared": {"pitch": p * 1e-3, "correlated": 0.9, "correlation": 1e-3} for p in (1, 0.5)
        },
    },
    "depth": {f"{d:g} mm deep": {"depth": d * 1e-3} for d in (0, 0.25, 0.5, 1, 1.5)},
    "camera": {
        **{f"{s:g} um": {"noise": s * 1e-6} for s in (1, 2.1, 5)},
        "5 um in depth": {"noise_z": 5e-6},
        "20 um in depth": {"noise_z": 20e-6},
        "in plane only": {"noise_z": None},
    },
}  # fmt: skip
PICTURE: dict[str, dict[str, Any]] = {
    "as it is": {},
    "1 mm thick": {"h": 1e-3},
    "nu = 0.49": {"nu": 0.49},
    "markers every 0.5 mm": {"pitch": 0.5e-3},
    "markers 0.5 mm deep": {"depth": 0.5e-3},
    "in plane only": {"noise_z": None},
}


def judged(choices: Mapping[str, Mapping[str, Any]]) -> SkinComparison:
    """Designs that differ from the base by a choice each."""
    return design.compare(design.Skin(**{**BASE, **choice, "name": name}) for name, choice in choices.items())


@cache
def varied(knob: str, name: str) -> SkinDesign:
    """A design of one choice."""
    return judged({name: KNOBS[knob][name]})[name]


@dataclass(frozen=True)
class Conclusion:
    """What one choice does.

    Parameters
    ----------
    knob : str
    text : str
        In words, with its numbers.
    numbers : mapping of name to float
    """

    knob: str
    text: str
    numbers: Mapping[str, float]

    def __str__(self) -> str:
        return self.text


def thickness() -> Conclusion:
    """How far a load is spread, and what a patch is told."""
    thin, thick = varied("thickness", "1 mm"), varied("thickness", "4 mm")
    found = {
        "crossover over h": thin.crossover / thin.skin.h,
        "the same, thick": thick.crossover / thick.skin.h,
        "signal": thick.depth_signal / thin.depth_signal,
        "pressure std": thick.pressure_std / thin.pressure_std,
        "kappa": thick.kappa / thin.kappa,
    }
    return Conclusion(
        "thickness",
        f"from 1 to 4 mm the crossover of resolution stays {found['crossover over h']:.3f} of the thickness and the "
        f"condition number grows {found['kappa']:.2f} times, the depth of a press {found['signal']:.2f} times; a patch "
        f"of 1 mm is known {100 * (1 - found['pressure std']):.0f} % better",
        found,
    )


def modulus() -> Conclusion:
    """A gain, and nothing else."""
    soft, stiff = varied("modulus", "50 kPa"), varied("modulus", "435 kPa")
    ratio = stiff.skin.E / soft.skin.E
    found = {
        "kappa": stiff.kappa / soft.kappa,
        "pressure std over E": _over(stiff.pressure_raw, soft.pressure_raw) / ratio,
        "load over E": stiff.strain_load / soft.strain_load / ratio,
        "signal times E": stiff.depth_signal / soft.depth_signal * ratio,
    }
    return Conclusion(
        "modulus",
        f"{ratio:.1f} times stiffer: condition number x {found['kappa']:.9f}; noise of the map and load at 10 % strain "
        f"both x {ratio:.1f} (to {max(abs(v - 1) for v in found.values()):.0e}), so that their ratio is the same",
        found,
    )


def compressibility() -> Conclusion:
    """What a gel that keeps its volume hides, and what plain bricks make of it."""
    loose, tight = varied("compressibility", "nu 0.3223"), varied("compressibility", "nu 0.49")
    found = {
        "long wave": float(loose.spectrum.pressure[0]),
        "long wave, tight": float(tight.spectrum.pressure[0]),
        "kappa": tight.kappa / loose.kappa,
        "pressure std": tight.pressure_std / loose.pressure_std,
        "locking": design.locking(loose.skin.nu),
        "locking, tight": design.locking(tight.skin.nu),
    }
    return Conclusion(
        "compressibility",
        f"nu from {loose.skin.nu:g} to {tight.skin.nu:g}: of pressure as wide as the pad "
        f"{100 * found['long wave']:.1f} % is told, then {100 * found['long wave, tight']:.0f} %; condition number x "
        f"{found['kappa']:.1f}, std on a patch x {found['pressure std']:.2f}; and plain bricks, four layers of them, "
        f"yield {found['locking']:.2f} and {found['locking, tight']:.2f} of the depth",
        found,
    )


def density() -> Conclusion:
    """Markers average what they do not share."""
    names = "every 1 mm", "every 0.5 mm", "1 mm, shared", "0.5 mm, shared"
    coarse, fine, shared, denser = (varied("markers", name) for name in names)
    found = {
        "std": _over(fine.pressure_raw, coarse.pressure_raw),
        "effective": fine.effective / coarse.effective,
        "effective, shared": denser.effective / shared.effective,
        "counted": denser.effective,
    }
    return Conclusion(
        "markers",
        f"four times the markers: std on a patch x {found['std']:.2f} and effective markers x "
        f"{found['effective']:.2f}; where neighbours share 90 % of their noise over 1 mm, effective markers x "
        f"{found['effective, shared']:.2f}: {denser.skin.markers:.0f} count as {found['counted']:.0f}",
        found,
    )


def depth() -> Conclusion:
    """What the gel above the markers hides."""
    surface, half, deep = (varied("depth", f"{d:g} mm deep") for d in (0, 0.5, 1))
    nu, d = half.skin.nu, half.skin.depth
    found = {
        "kappa": half.kappa / surface.kappa,
        "shear std": half.shear_std / surface.shear_std,
        "pressure std": half.pressure_std / surface.pressure_std,
        "waves": half.recoverable / surface.recoverable,
        "waves, deep": deep.recoverable / surface.recoverable,
        "unseen wave": float(np.pi * d / (1 - nu)),  # k d = 2 (1 - nu), where u_k / t_k of a half-space vanishes
        "resolution over its half": _over(half.shear_resolution, np.pi * d / (1 - nu) / 2),
    }
    return Conclusion(
        "depth",
        f"markers {1e3 * d:g} mm under the surface: condition number x {found['kappa']:.0f}, std of shear on a patch x "
        f"{found['shear std']:.1f}, of pressure x {found['pressure std']:.1f}; {100 * found['waves']:.0f} % of the "
        f"waves are above noise, 1 mm deep {100 * found['waves, deep']:.0f} %. A wave of shear of "
        f"{1e3 * found['unseen wave']:.2f} mm leaves them where they are in the plane (half-space), and resolution of "
        f"shear ends at {found['resolution over its half']:.2f} times half of that",
        found,
    )


def camera() -> Conclusion:
    """Resolution against noise, and what in-plane motion alone leaves open."""
    names = "1 um", "5 um", "5 um in depth", "20 um in depth", "in plane only"
    quiet, loud, sharp, blunt, flat = (varied("camera", name) for name in names)
    found = {
        "shear slope": _slope(quiet.shear_resolution, loud.shear_resolution, loud.skin.noise / quiet.skin.noise),
        "pressure slope": _slope(sharp.pressure_resolution, blunt.pressure_resolution, 4.0),
        "pressure": _slope(quiet.pressure_resolution, loud.pressure_resolution, loud.skin.noise / quiet.skin.noise),
        "prior left": flat.pressure_std / flat.skin.load,
        "unseen": flat.nullity / flat.waves,
    }
    return Conclusion(
        "camera",
        f"resolution of shear goes with the in-plane noise to the power {found['shear slope']:.2f}, of pressure with "
        f"that of the depth to {found['pressure slope']:.2f} (and with the in-plane noise to {found['pressure']:.2f}); "
        f"without depth {100 * found['unseen']:.0f} % of the waves are not seen, and of the std of the pressure that "
        f"was expected {100 * found['prior left']:.0f} % is left",
        found,
    )


def _over(a: float | None, b: float | None) -> float:
    """Ratio of two numbers that these designs have."""
    assert a is not None
    assert b is not None
    return a / b


def _slope(a: float | None, b: float | None, ratio: float) -> float:
    return float(np.log(_over(b, a)) / np.log(ratio))


CONCLUSIONS = (thickness, modulus, compressibility, density, depth, camera)


def conclusions() -> tuple[Conclusion, ...]:
    """One for each choice."""
    return tuple(conclude() for conclude in CONCLUSIONS)


def show(found: Sequence[Conclusion]) -> str:
    """A table and a conclusion for each choice."""
    return "\n\n".join(
        f"== {c.knob}\n{design.compare(varied(c.knob, n) for n in KNOBS[c.knob]).table()}\n-> {c}" for c in found
    )


def figure(path: Path) -> None:
    """What six designs tell of each wave, and their numbers."""
    judged(PICTURE).plot(path)


def main() -> None:
    """Print tables and conclusions, and save the picture."""
    print(show(conclusions()))
    figure(Path("skin_design.png"))
    print("\npicture: skin_design.png")


if __name__ == "__main__":
    main()
