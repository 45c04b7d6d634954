"""Tractions on an elastic layer by its waves, without a mesh: traction force microscopy, and thin gels of fingertips.

Fourier transform traction cytometry (J. Butler, I. Tolić-Nørrelykke, B. Fabry & J. Fredberg, Am. J. Physiol. Cell
Physiol. 282 (2002) C595) on a bonded layer of finite thickness (X. Trepat et al., Nature Physics 5 (2009) 426), with
Tikhonov's penalty on the tractions (B. Sabass, M. Gardel, C. Waterman & U. Schwarz, Biophys. J. 94 (2008) 207). On a
full grid every wave is solved by itself; lost places, scattered markers and frames ask for conjugate gradients, with
the waves as preconditioner.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loadid._guards import collect
from loadid._guards import parameter as of_lambda
from loadid._inverse.choice import Choice, ChoiceLike, checked, choose
from loadid._inverse.noise_level import unexplained
from loadid._inverse.path import RegularizationPath
from loadid._inverse.problem import NoiseSource, NoiseSourceLike
from loadid._results.facts import provenance
from structures._flags import Flag
from structures.errors import InputError, digest, one_of

from .. import _guards as guards
from .._arrays import Array, Mask
from .._closed.layer import Layer
from .._closed.presses import Press
from .._closed.waves import ON_NODES, Lattice
from .._results.forcemap import ForceFacts, ForceMap
from ..vision._interpolation import fitted_weights
from .marked import ContactLaw, MarkedSensor, not_built_for_depth
from .observation import DepthMap, Markers
from .posing import AXES, of_points
from .spectrum import Gathered, WaveSpectrum

PENALTIES = ("gradient", "identity")
NORMALS = ("free", "unknown")
OUTSIDE = 0.5  # of the motion beyond a window: std of what is missed of it (measured: .33 to .4)


class LayerSensor(MarkedSensor):
    """Tractions on an endless bonded layer from the motion of a grid of places, or of scattered markers.

    Minimises ``|R^(-1/2) (G t - u)|^2 + lambda^2 |L t|^2`` over band-limited tractions t on the nodes of a grid, G by
    the kernels of the layer. The layer goes on beyond the places seen: where these fill a rectangle, their motion is
    let down to zero there; where they are scattered, leave gaps, or a frame is stated, nothing acts beyond it.

    Parameters
    ----------
    layer : Layer
        Thickness, modulus and Poisson's ratio of the gel; z = 0 is its bonded base.
    markers : Markers
        Places (N, 2) on the surface, or (N, 3) at one height inside (m), with the std of their motion; ``"XY"`` or
        ``"XYZ"``. Places that fill a rectangle of even pitch, in any order, are a grid: fields of image correlation.
        Their tractions are sought on the same nodes.
    pitch : float, optional
        Distance of the nodes (m) for scattered markers; the mean distance of these where not given.
    normal : {"free", "unknown"}, optional
        Whether the surface carries no normal load (t_z = 0, as traction force microscopy takes it), or one that is to
        be found. Free for in-plane motion, unknown where motion along Z is seen. Where it is taken to be free, pressure
        is read as shear, the more so the nearer nu is to 0.5: up to a third of it (W612 says how much). Where it is
        unknown, in-plane motion alone shows next to nothing of it (W608).
    frame : (x0, y0, x1, y1), optional
        A rectangle (m) outside which nothing acts: the edge of a cell, of a contact, or of a small window.
    penalty : {"gradient", "identity"}
        Of the tractions: size and slope over a thickness of the layer, ``|t|^2 + h^2 |grad t|^2``, or their size alone,
        as traction force microscopy takes it. Under noise the first is better for contacts and adhesions alike, and by
        far for scattered markers, between which tractions of a white prior vanish.
    choice : str, float or None
        Rule for lambda, or a relative lambda; None as `loadid.paths.choose`. `calibrate` freezes it.
    noise_source : NoiseSource or str, optional
        Where the noise level of the markers comes from.
    allow : sequence of str
        Guard codes whose refusal was overridden on the way here.

    Raises
    ------
    InputError
        Markers at several heights or outside the layer, a frame without nodes, settings that do not fit.

    Notes
    -----
    Of a grid without a gap one frame is a few transforms. With gaps, scattered markers or a frame the std of a node is
    that of markers of the same mean density everywhere; that of the resultant is that of these markers. Scattered
    markers are read by gridding, to 1e-6 of the largest motion. Maps repeat themselves beyond four thicknesses of gel.
    """

    name = "layer by its waves"

    def __init__(
        self,
        layer: Layer,
        markers: Markers,
        *,
        pitch: float | None = None,
        normal: str | None = None,
        frame: Sequence[float] | None = None,
        penalty: str = "gradient",
        choice: ChoiceLike = None,
        noise_source: NoiseSourceLike = None,
        allow: Sequence[str] = (),
    ) -> None:
        super().__init__(markers, None, None, ContactLaw())
        if not isinstance(layer, Layer):
            raise InputError("no layer", where="LayerSensor", found=type(layer).__name__, expected="a tactile Layer")
        if self.markers.slope is not None:
            raise InputError("the motion of markers themselves is meant", where="LayerSensor, markers", found="a slope",
                             expected="none", hint="MultilayerPad takes apparent motion")  # fmt: skip
        axes = self.markers.axes
        self.layer, self.choice, self.allow = layer, checked(choice), tuple(allow)
        self.noise_source = NoiseSource.of(noise_source)
        self.normal = normal or ("unknown" if "Z" in axes else "free")
        one_of("nothing of the normal load", self.normal, NORMALS, where="normal")
        self.frame = None if frame is None else tuple(float(x) for x in frame)
        self._lattice = Lattice.of(self.markers.points[:, :2], pitch, frame)
        noise = np.sqrt(np.median(self.markers.noise**2, axis=0))
        waves = self._lattice.waves(layer, self._height)
        self.penalty = one_of("no penalty of tractions", penalty, PENALTIES, where="penalty")
        smooth = layer.h if self.penalty == "gradient" else 0.0
        self._spectrum = WaveSpectrum(waves, noise, 3 if self.normal == "unknown" else 2, smooth)
        self._last: tuple[Mask, WaveSpectrum | Gathered] | None = None  # of the last frame: one value, for threads
        self._last_told: tuple[tuple[bytes, float], tuple[Array, Flag | None]] | None = None

    def __repr__(self) -> str:
        ny, nx = self._lattice.shape
        return f"<LayerSensor: {len(self.markers)} markers, {nx} x {ny} nodes, normal load {self.normal}>"

    # -- doing --------------------------------------------------------------------------------------------------------
    def estimate(self, found: ArrayLike, depth: DepthMap | None = None) -> ForceMap:
        """Tractions of one frame.

        Parameters
        ----------
        found : array (N, 2 or 3)
            Motion of the markers (m) in their order, NaN where one is lost.
        depth : None
            A layer sensor takes no depth map: ``Markers(..., axes="XYZ")`` holds what is seen along Z.

        Returns
        -------
        ForceMap
            Tractions (Pa) at the nodes, row by row from the smallest y.

        Raises
        ------
        InputError
            Readings that do not fit; fewer than three markers left.
        NotIdentifiable
            An iteration that does not settle, at next to no regularisation.
        """
        if depth is not None:
            raise not_built_for_depth()
        y, flags = self._of_frame(found, None, None)
        motion = y.reshape(len(self.markers), -1).T
        seen = _seen(motion)
        posed = self._posed(seen)
        data = self._data(motion, posed)
        choice, path = self._chosen(motion, seen, posed)
        alpha = choice.lam * choice.scale
        load, bias = posed.filtered(data, alpha)
        sigma = self._misfit(posed.residual(data, load), seen)
        std = np.maximum(sigma * posed.spread(alpha)[:, None, None], np.abs(bias))
        taken = self._resultant @ self._flat(bias)
        sums, unseen = self._told(posed, seen, alpha)
        beyond = self._beyond(motion, seen)
        covariance = sigma**2 * sums + np.outer(beyond, beyond)
        lost = int(np.sum(~seen)) * len(motion)
        facts = ForceFacts.of({
            "path": "waves" if posed is self._spectrum else "waves, conjugate gradients", "m": motion.size - lost,
            "n": load.size, "edf": choice.edf, "noise_level": sigma, "misfit": sigma, "lambda_rule": choice.rule,
            "lost": lost, "provided": self._provided,
        })  # fmt: skip
        whole = self._flat(load)
        own = [
            *of_lambda(choice, path), *flags, self._leaning, guards.completed(self._provided),
            self._at_edge(motion, seen), unseen, guards.misfit(sigma), guards.lost(lost, self.markers.readings_count),
            guards.taken(taken, self._resultant @ whole, covariance),
        ]  # fmt: skip
        return ForceMap(
            load=whole, std=self._flat(std), bias=self._flat(bias), labels=self._labels, units=self._units,
            flags=collect(own), allowed=self.allow, choice=choice, facts=facts, provenance=self._provenance,
            geometry={**self._geometry, "resultant_covariance": covariance + np.outer(taken, taken)},
        )  # fmt: skip

    def calibrate(self, frames: Sequence[Any]) -> Choice:
        """Choose one lambda over calibration presses, and freeze it.

        Raises
        ------
        InputError
            Without frames, or where they have not lost the same markers.
        """
        motions = [self._of_frame(f, None, None)[0].reshape(len(self.markers), -1).T for f in frames]
        seen = [_seen(motion) for motion in motions]
        if not motions or any(not np.array_equal(s, seen[0]) for s in seen):
            raise InputError("no frames to calibrate with", where="calibrate", found=f"{len(motions)} frames",
                             expected="presses in which the same markers are seen")  # fmt: skip
        rule = None if isinstance(self.choice, float) else self.choice
        found = choose(self._path(motions, seen[0]), rule, sigma=1.0, source=self.noise_source)
        self.choice = found.lam
        return found

    # -- what it is ---------------------------------------------------------------------------------------------------
    @property
    def E(self) -> float:
        """Young's modulus that the sensor was built with (Pa)."""
        return self.layer.E

    @property
    def thickness(self) -> float:
        """Thickness of the layer (m)."""
        return self.layer.h

    @property
    def frozen(self) -> bool:
        """Whether lambda is fixed."""
        return isinstance(self.choice, float)

    @property
    def nodes(self) -> Array:
        """Places of the nodes of the map (P, 3) in m, row by row from the smallest y."""
        return np.asarray(self._geometry["coordinates"])

    # -- steps --------------------------------------------------------------------------------------------------------
    @cached_property
    def _height(self) -> float:
        points = self.markers.points
        z = points[:, 2] if points.shape[1] == 3 else np.array([self.layer.h])
        if np.ptp(z) > ON_NODES * self.layer.h or not 0 < z.max() <= self.layer.h * (1 + ON_NODES):
            raise InputError(
                "markers must lie at one height of the layer", where="LayerSensor, markers",
                found=f"z from {z.min():.4g} to {z.max():.4g} m",
                expected=f"one z above 0 and up to {self.layer.h:g} m",
                hint="z is counted from the bonded base; GelForce takes markers at several depths",
            )  # fmt: skip
        return min(float(z.mean()), self.layer.h)

    def _posed(self, seen: Mask) -> WaveSpectrum | Gathered:
        """The problem of the markers that are seen; kept while the same ones are."""
        last = self._last
        if last is None or not np.array_equal(last[0], seen):
            last = self._last = seen, self._gathered(seen)
        return last[1]

    def _gathered(self, seen: Mask) -> WaveSpectrum | Gathered:
        lattice, spectrum, noise = self._lattice, self._spectrum, self.markers.noise
        precision = np.where(seen[:, None], spectrum.noise / noise, 0.0).T
        if lattice.full and np.all(precision == 1):
            return spectrum
        density = np.sum(precision > 0) / len(precision) / np.prod(lattice.box)
        if lattice.order is None:
            at = spectrum.waves.gridding(lattice.places)
            return Gathered(spectrum, at, precision, lattice.loaded, density)
        ring = float(lattice.full)  # beyond a full window nothing moves
        whole = np.full((len(precision), *spectrum.waves.shape), ring)
        whole[:, : lattice.box[0], : lattice.box[1]] = self._on_nodes(precision)
        loaded = (slice(None), slice(None)) if lattice.full else lattice.loaded
        return Gathered(spectrum, None, whole, loaded, 1.0 if lattice.full else density)

    def _on_nodes(self, values: Array) -> Array:
        """Values of the markers (axes, N) on the box of nodes, 0 where there is none."""
        found = np.zeros((len(values), int(np.prod(self._lattice.box))))
        found[:, self._lattice.order] = values
        return found.reshape(-1, *self._lattice.box)

    def _data(self, motion: Array, posed: WaveSpectrum | Gathered) -> Array:
        """Whitened data of motion (axes, N), lost markers at zero."""
        filled = self._filled(motion, _seen(motion)) if self._lattice.full else np.nan_to_num(motion)
        values = filled / self._spectrum.noise[:, None]
        field = values if self._lattice.order is None else self._on_nodes(values)
        return field if isinstance(posed, WaveSpectrum) else posed.data(field)

    def _path(self, motions: Sequence[Array], seen: Mask) -> RegularizationPath:
        posed = self._posed(seen)
        if not self._lattice.full:
            assert isinstance(posed, Gathered)
            return posed.path([self._data(motion, posed) for motion in motions])
        return self._spectrum.path([self._data(motion, self._spectrum) for motion in motions])

    def _filled(self, motion: Array, seen: Mask) -> Array:
        """Motion of a grid with what a local fit makes of the lost places: for lambda, and for what lies beyond."""
        if seen.all():
            return motion
        points = self.markers.points[:, :2]
        index, weights = fitted_weights(points[seen], points[~seen])
        motion = motion.copy()
        motion[:, ~seen] = np.sum(weights * motion[:, seen][:, index], axis=-1)
        return motion

    def _chosen(
        self, motion: Array, seen: Mask, posed: WaveSpectrum | Gathered
    ) -> tuple[Choice, RegularizationPath | None]:
        """Lambda of one frame, and the path on which it was sought."""
        if isinstance(self.choice, float):
            odds = "lambda was given: no rule asked"
            return Choice(self.choice, posed.scale, "given", verdict="not asked", odds=odds, sigma=1.0), None
        path = self._path([motion], seen)
        return choose(path, self.choice, sigma=1.0, source=self.noise_source), path

    def _misfit(self, residual: Array, seen: Mask) -> float:
        """Level of the noise, over the stated one: that of a residual which noise alone would hardly leave."""
        if self._lattice.full:
            residual = residual[:, : self._lattice.box[0], : self._lattice.box[1]]
        return unexplained(float(np.sum(residual**2)), int(seen.sum()) * len(residual), 1.0) or 1.0

    def _told(self, posed: WaveSpectrum | Gathered, seen: Mask, alpha: float) -> tuple[Array, Flag | None]:
        """Covariance (6, 6) of the resultant in units of the noise, and whether a normal force is seen; kept."""
        key = seen.tobytes(), alpha
        if self._last_told is None or self._last_told[0] != key:
            sums = posed.covariance(self._gram if isinstance(posed, WaveSpectrum) else self._rows, alpha)
            self._last_told = key, (sums, self._unseen(posed, alpha))
        return self._last_told[1]

    def _flat(self, field: Array) -> Array:
        """Tractions (3 P,) of the map, node by node, of a field (loads, ...); no normal ones where they are none."""
        ny, nx = self._lattice.shape
        out = np.zeros((ny, nx, 3))
        out[..., : len(field)] = np.moveaxis(field, 0, -1)[:ny, :nx]
        return out.ravel()

    # -- saying -------------------------------------------------------------------------------------------------------
    @cached_property
    def _geometry(self) -> dict[str, Any]:
        ny, nx = self._lattice.shape
        places, area = self._lattice.nodes(self.layer.h), float(np.prod(self._lattice.pitch))
        about = (places[0] + places[-1]) / 2
        found = of_points(places, area, about)
        first = (np.arange(nx - 1) + nx * np.arange(ny - 1)[:, None]).ravel()
        count = np.arange(len(places))
        return found | {
            "kind": "hats", "cells": first[:, None] + np.array([0, 1, nx + 1, nx]),
            "resultant": found["resultant"] * area, "mass_data": found["measures"], "mass_indices": count,
            "mass_indptr": np.append(count, len(count)),
        }  # fmt: skip

    @property
    def _resultant(self) -> Array:
        return np.asarray(self._geometry["resultant"])

    @cached_property
    def _rows(self) -> Array:
        """The rows of the resultant as fields (6, loads, ny, nx) on the nodes of the map."""
        rows = self._resultant.reshape(6, *self._lattice.shape, 3)
        return np.moveaxis(rows, -1, 1)[:, : self._spectrum.loads]

    @cached_property
    def _gram(self) -> Array:
        return self._spectrum.gram(list(self._rows))

    @cached_property
    def _labels(self) -> tuple[str, ...]:
        return tuple(f"n{i}+{a}" for i in range(len(self.nodes)) for a in AXES)

    @cached_property
    def _units(self) -> tuple[str, ...]:
        return ("Pa",) * len(self._labels)

    @cached_property
    def _provided(self) -> dict[str, str]:
        return {a.lower(): "tracked" if a in self.markers.axes else "completed" for a in AXES}

    @cached_property
    def _leaning(self) -> Flag | None:
        """W612 where the normal load is left out and pressure would be read as shear."""
        if self.normal == "unknown":
            return None
        found = self.layer.components(1 / self.layer.h)
        return guards.read_as_shear(float(np.abs(found.kz) / found.kk), self.layer.nu)

    def _unseen(self, posed: WaveSpectrum | Gathered, alpha: float) -> Flag | None:
        """W608 where of a press as wide as the layer is thick little of the normal force would be found."""
        if self.normal == "free":
            return None
        press = Press(at=tuple(self._geometry["about"][:2]), radius=self.layer.h).traction(self.nodes)
        shape = self._lattice.shape
        load = np.moveaxis(press.reshape(*shape, 3), -1, 0)
        found = posed.found(load, alpha)[2, : shape[0], : shape[1]]
        return guards.unseen(float(found.sum() / load[2].sum()))

    @cached_property
    def _edge(self) -> Mask:
        """Which places lie at the edge of a full window."""
        y, x = self._lattice.places.T
        return np.asarray((x < 0.5) | (y < 0.5) | (x > x.max() - 0.5) | (y > y.max() - 0.5))

    def _beyond(self, motion: Array, seen: Mask) -> Array:
        """Std (6,) of the resultant by what moves beyond a full window, along X and Y.

        A layer falls to rest there over ``2 h / pi`` of its edge, and its sum of motion is ``h / mu`` times a force;
        some of it is in what the motion is let down to zero by.
        """
        out = np.zeros(6)
        if self._lattice.full:
            whole = self._filled(motion, seen)
            mu, pitch = self.layer.E / 2 / (1 + self.layer.nu), float(np.mean(self._lattice.pitch))
            out[:2] = OUTSIDE * mu * 2 / np.pi * pitch * whole[:2, self._edge].sum(axis=1)
        return out

    def _at_edge(self, motion: Array, seen: Mask) -> Flag | None:
        """W613 where places at the edge of a full window move, beyond which the layer is taken to stand still."""
        if not self._lattice.full:
            return None
        edge = seen & self._edge
        size = np.linalg.norm(motion / self._spectrum.noise[:, None], axis=0)
        rest = np.sqrt(len(motion))
        still = float(np.sqrt(np.mean(size[edge] ** 2))) / rest if edge.any() else 0.0
        return guards.cut_off(still, still * rest / float(np.nanmax(size)))

    @cached_property
    def _provenance(self) -> dict[str, Any]:
        return provenance(
            self.name,
            settings={
                "layer": repr(self.layer), "markers": len(self.markers), "normal": self.normal, "frame": self.frame,
                "penalty": self.penalty,
                "noise_source": None if self.noise_source is None else self.noise_source.text,
            },
            inputs={},
            model=digest("layer", self.markers.points, np.array([self.layer.h, self.layer.E, self.layer.nu])),
            prior="white prior on the traction of every node" if self._spectrum.white else "tractions smooth over h",
        )  # fmt: skip


def _seen(motion: Array) -> Mask:
    """Which markers have their motion (axes, N)."""
    return np.asarray(np.isfinite(motion).all(axis=0))
