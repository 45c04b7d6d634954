"""Skin design as conditioning: what a pad, its markers and its camera can tell, before any of them is made.

One design of a skin, judged (what it can tell, what it costs, how hard it may be pressed), and designs side by side.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from structures._flags import Flag
from structures.errors import InputError

from .._closed.presses import Press
from .._guards import LINEAR, modulus
from ._modes import Skin, SkinSpectrum, effective_markers, modes, resolution, spectrum
from ._resolution import cutoff, largest_strain, locking, strains  # noqa: F401

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Skin", "compare", "largest_strain", "locking", "skin"]


@dataclass(frozen=True, eq=False)
class SkinDesign:
    """Numbers of one skin. Immutable.

    Parameters
    ----------
    skin : Skin
    depth_signal, side_signal : float
        Largest normal and in-plane motion of the markers under the reference press (m).
    depth_snr, side_snr : float or None
        The same over the noise of one marker; None where nothing measures the normal motion.
    waves, recoverable, rank, nullity : int
        Components of traction of all waves on the grid of patches; those whose expected signal exceeds their noise;
        those seen at all, and those not.
    kappa : float
        Condition number of what is seen.
    pressure_resolution, shear_resolution : float or None
        Half the shortest wave of which the reading tells half the variance (m), by mechanics and noise alone: markers
        at some pitch tell no wave whose half is shorter than that.
    crossover : float
        Half the wave at which the compliance to pressure has fallen to half of its largest (m): a constant share of the
        thickness. Finer features cost more signal; it is no limit.
    effective : float
        Independent markers that would know the mean over the pad as well.
    pressure_std, shear_std : float
        Std of the mean pressure and shear on one patch (Pa), with the expected load as prior.
    pressure_raw, shear_raw : float or None
        The same without a prior; None where a wave is not seen.
    strain_load : float
        Force of the reference press at 10 % of principal strain (N): beyond it linear elasticity ends.
    spectrum : SkinSpectrum
        What is known of waves of growing wave number.
    flags : tuple of Flag
        W111.
    """

    skin: Skin
    depth_signal: float
    side_signal: float
    depth_snr: float | None
    side_snr: float
    waves: int
    recoverable: int
    rank: int
    nullity: int
    kappa: float
    pressure_resolution: float | None
    shear_resolution: float | None
    crossover: float
    effective: float
    pressure_std: float
    shear_std: float
    pressure_raw: float | None
    shear_raw: float | None
    strain_load: float
    spectrum: SkinSpectrum
    flags: tuple[Flag, ...] = ()

    @property
    def name(self) -> str:
        """Name of the skin, or its thickness and modulus."""
        return self.skin.name or f"h {1e3 * self.skin.h:g} mm, E {1e-3 * self.skin.E:g} kPa"

    def rows(self) -> list[tuple[str, str]]:
        """Name and value of each number, as text."""
        s = self.skin
        patch = f"{1e3 * s.patch:g} mm patch"
        return [
            ("thickness mm, E kPa, nu", f"{1e3 * s.h:g}, {1e-3 * s.E:g}, {s.nu:g}"),
            ("marker pitch mm, depth mm", f"{1e3 * s.pitch:g}, {1e3 * s.depth:g}"),
            ("noise um in plane, normal", f"{1e6 * s.noise:.3g}, "
             + ("none" if s.noise_z is None else f"{1e6 * s.noise_z:.3g}")),
            (f"depth under {s.force:g} N, um (over noise)", _signal(self.depth_signal, self.depth_snr)),
            ("sideways motion, um (over noise)", _signal(self.side_signal, self.side_snr)),
            ("waves above noise, of", f"{self.recoverable} of {self.waves}"),
            ("rank, nullity", f"{self.rank}, {self.nullity}"),
            ("condition number", f"{self.kappa:.4g}"),
            ("resolution mm, pressure (markers)", _length(self.pressure_resolution, s.pitch)),
            ("resolution mm, shear (markers)", _length(self.shear_resolution, s.pitch)),
            ("crossover mm", f"{1e3 * self.crossover:.3g}"),
            ("markers, effective", f"{s.markers:.0f}, {self.effective:.0f}"),
            (f"std of pressure on a {patch}, Pa", f"{self.pressure_std:.0f}"),
            (f"std of shear on a {patch}, Pa", f"{self.shear_std:.0f}"),
            ("the same without prior, Pa", _raw(self.pressure_raw, self.shear_raw)),
            ("N at 10 % strain", f"{self.strain_load:.3g}"),
        ]  # fmt: skip

    def table(self) -> str:
        """All numbers, as text."""
        return side_by_side([self])

    def __str__(self) -> str:
        return self.table()

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Picture of what is known of each wave; see `tactile._results.pictures`."""
        from .._results.pictures import draw_design

        return draw_design([self], path)


def skin(parameters: Skin | None = None, **settings: Any) -> SkinDesign:
    """Judge a design of a skin.

    Parameters
    ----------
    parameters : Skin, optional
    **settings
        Or the parameters of `Skin`, one by one.

    Raises
    ------
    InputError
        Parameters that are not possible, or both forms at once.

    Notes
    -----
    A bonded layer without edges, periodic over the sensing area, and a load whose means on patches are independent, of
    std `load`: waves separate, and each is a 3 x 3 problem. Signals are those of the exact layer under a Hertz press.
    """
    if (parameters is None) == (not settings) or not isinstance(parameters, Skin | None):
        raise InputError("a Skin, or its parameters", where="design.skin", found=f"{parameters!r} and {settings}"[:80],
                         expected="one of the two", hint="design.skin(h=3e-3, E=0.147e6, nu=0.3223)")  # fmt: skip
    s = Skin(**settings) if parameters is None else parameters
    layer = s.layer
    line = np.stack([np.linspace(0, 3 * s.radius, 60), np.zeros(60), np.full(60, s.height)], axis=1)
    u = Press(radius=s.radius, force=s.force).displacement(layer, line)
    deep, side = float(np.abs(u[:, 2]).max()), float(np.hypot(u[:, 0], u[:, 1]).max())
    found, lines = modes(s), spectrum(s)
    patch = found.posterior, found.unregularised
    flag = modulus(s.E)
    return SkinDesign(
        skin=s,
        depth_signal=deep,
        side_signal=side,
        depth_snr=None if s.noise_z is None else deep / s.noise_z,
        side_snr=side / s.noise,
        waves=found.signal.size,
        recoverable=found.recoverable,
        rank=found.rank,
        nullity=found.nullity,
        kappa=found.kappa,
        pressure_resolution=resolution(lines, lines.pressure),
        shear_resolution=resolution(lines, lines.shear),
        crossover=cutoff(layer, "zz", 0.5) / 2,
        effective=float(effective_markers(s)),
        pressure_std=float(patch[0][2]),
        shear_std=float(patch[0][:2].max()),
        pressure_raw=None if patch[1] is None else float(patch[1][2]),
        shear_raw=None if patch[1] is None else float(patch[1][:2].max()),
        strain_load=LINEAR / largest_strain(layer, s.radius),
        spectrum=lines,
        flags=() if flag is None else (flag,),
    )


def side_by_side(designs: list[SkinDesign] | tuple[SkinDesign, ...]) -> str:
    """One column for each design, as text."""
    columns = [d.rows() for d in designs]
    wide = max(len(name) for c in columns for name, _ in c)
    widths = [max(len(d.name), *(len(v) for _, v in c)) for d, c in zip(designs, columns, strict=True)]
    head = " " * wide + "  " + "  ".join(d.name.rjust(w) for d, w in zip(designs, widths, strict=True))
    lines = [head]
    for i, (name, _) in enumerate(columns[0]):
        lines.append(
            name.ljust(wide) + "  " + "  ".join(c[i][1].rjust(w) for c, w in zip(columns, widths, strict=True))
        )
    return "\n".join([*lines, *(f"{d.name}: {f}" for d in designs for f in d.flags)])


def _length(value: float | None, pitch: float) -> str:
    return f"{'none' if value is None else f'{1e3 * value:.3g}'} ({1e3 * pitch:.3g})"


def _signal(value: float, snr: float | None) -> str:
    return f"{1e6 * value:.4g} ({'not measured' if snr is None else f'{snr:.3g}'})"


def _raw(pressure: float | None, shear: float | None) -> str:
    return "not determined" if pressure is None or shear is None else f"{pressure:.4g}, {shear:.4g}"


@dataclass(frozen=True, eq=False)
class SkinComparison:
    """Designs judged for the same loads.

    Parameters
    ----------
    designs : tuple of SkinDesign
    """

    designs: tuple[SkinDesign, ...]

    def __getitem__(self, name: str) -> SkinDesign:
        """Design of a name."""
        for one in self.designs:
            if one.name == name:
                return one
        raise KeyError(name)

    def table(self) -> str:
        """One column for each design, as text. A condition number says nothing without rank and nullity."""
        return side_by_side(self.designs)

    def __str__(self) -> str:
        return self.table()

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Picture: what is known of each wave, and the numbers of each design."""
        from .._results.pictures import draw_design

        return draw_design(list(self.designs), path)


def compare(skins: Iterable[Skin | SkinDesign]) -> SkinComparison:
    """Judge several designs.

    Parameters
    ----------
    skins : iterable of Skin or SkinDesign
        Of different names.

    Raises
    ------
    InputError
        No design, two of one name, or designs for different loads or patches.
    """
    designs = tuple(s if isinstance(s, SkinDesign) else skin(s) for s in skins)
    names = [d.name for d in designs]
    loads = {(d.skin.patch, d.skin.load) for d in designs}
    if not designs or len(set(names)) < len(names) or len(loads) > 1:
        raise InputError(
            "designs that do not compare", where="design.compare",
            found=f"names {names[:6]}, {len(loads)} pairs of patch and load",
            expected="different names, the same patch and load", hint="Skin(..., name='thin')",
        )  # fmt: skip
    return SkinComparison(designs)
