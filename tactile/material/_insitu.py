"""E, nu and thickness of a gel in its sensor, from presses whose force is known.

A press is a bump of known force (the pressure of a sphere) whose place and radius are found with the material; under
it the tractions may differ from the bump by a third of its mean, without force. So the shape of the motion around the
press tells the material, and what goes on under the indenter tells little. All of it is one least-squares problem with
the declared tolerances as its prior, solved by Gauss-Newton with sensitivities by differences of the forward model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cholesky, solve_triangular

from structures._flags import Flag
from structures._threads import one_thread
from structures.errors import InputError, reals

from .. import _guards as guards
from .._arrays import Array
from .._pad.tolerances import Tolerances

if TYPE_CHECKING:
    from .._pad.pad import Pad
    from .._sensors.multilayer import MultilayerPad
    from .._sensors.observation import DepthMap

NAMES = ("E", "nu", "thickness")
UNKNOWN = Tolerances(E=0.5, nu=0.1, thickness=0.2)
STEPS = np.array([-0.004, 0.01])  # of nu, of which there is always a smaller one, and log thickness; E is a gain
BESIDE = (2e-5, 2e-5, 0.05)  # of place (m) and log radius of a press
FURTHEST = np.array([0.4, 0.04, 0.12])  # steps of log E, nu, log thickness
BEGIN, RADIUS = 0.4, 0.7  # radius of a press over the thickness to begin with, and the std of its logarithm
HIGHEST = 0.4995
LOOSE = 0.35  # std of the tractions under a press about the bump, over their mean
BEYOND = 1.4  # radii of the bump within which they may: how large a press is is hardly told
LEAST, MOST = 0.12, 1.2  # radius of a press over the thickness
TURNS, ROUNDS = 3, 6  # weights and mesh errors are found anew; steps of Gauss-Newton by each of them
ENOUGH = 0.1  # step over std at which they end
REFINED = 1.5  # times as fine is the mesh whose answers tell the error of the mesh
WHOLE, FINER = 1.2, 0.4  # of what both differ by, that the error of the mesh is, and the std of this share
SHARING = 4  # readings that share an error of the model
TOLD = 0.7  # of the std declared: what is left of it where presses tell something


@dataclass(frozen=True, eq=False)
class InSitu:
    """What presses in the sensor tell of its gel.

    Parameters
    ----------
    pad : Pad
        The pad with the modulus, Poisson's ratio and thickness that were found.
    std, prior : Tolerances
        Of E and thickness relative, of nu itself: what is left of those that were declared. In it are noise, contacts
        that are not known, misfit and mesh; what the presses do not tell keeps the std that was declared.
    covariance : array (3, 3)
        Of log E, nu, log thickness.
    misfit : float
        Rms of what is left of the motion over its std: about 1 where the model is right.
    contacts : array (presses, 3)
        Place and radius (m) of each press.
    errors : array (held-out presses, 3)
        Resultant of the sensor less the known force, over the std of both.
    flags : tuple of Flag
        W111; W117 where presses that were held out, or the motion, disagree with the model.
    """

    pad: Pad
    std: Tolerances
    prior: Tolerances
    covariance: Array
    misfit: float
    contacts: Array
    errors: Array
    flags: tuple[Flag, ...] = ()

    @property
    def told(self) -> tuple[str, ...]:
        """Which of E, nu and thickness the presses told; the others are as they were declared."""
        return tuple(n for n in NAMES if getattr(self.std, n) < TOLD * getattr(self.prior, n))

    def __str__(self) -> str:
        lines = []
        for name, unit in zip(NAMES, (" Pa", "", " m"), strict=True):
            value, spread = getattr(self.pad, name), getattr(self.std, name)
            known = "" if name in self.told else " (as declared: these presses do not tell it)"
            lines.append(f"{name} = {value:.4g} +- {spread if name == 'nu' else spread * value:.2g}{unit}{known}")
        held = f", {len(self.errors)} presses held out within {_rms(self.errors):.2g} std" if len(self.errors) else ""
        return "\n".join([*lines, f"motion within {self.misfit:.2f} std{held}", *map(str, self.flags)])


@one_thread()
def in_situ(
    build: Callable[[Pad], MultilayerPad],
    pad: Pad,
    frames: Sequence[Any],
    forces: ArrayLike,
    *,
    depths: Sequence[DepthMap] | None = None,
    prior: Tolerances = UNKNOWN,
    force_std: float = 0.01,
    held: int | None = None,
) -> InSitu:
    """Modulus, Poisson's ratio and thickness from presses of known force in the sensor, each with its std.

    Each press is one contact, of a ball or another blunt body, at least its own diameter off the rim; where and how
    large it is need not be known. Balls of several sizes tell more, and normal motion (a depth map, markers tracked
    along all axes) tells several times more than motion in the plane.

    Parameters
    ----------
    build : callable
        Takes a pad and gives the sensor.
    pad : Pad
        As declared. Of a pad whose mesh is from a file the thickness is not fitted.
    frames : sequence
        As `MultilayerPad.estimate` takes them.
    forces : array (presses, 3)
        On the pad, from a balance, weights or an F/T sensor (N): a press has Fz < 0.
    depths : sequence of DepthMap, optional
        One for each frame.
    prior : Tolerances
        How well the declared values are known; what is 0 is kept.
    force_std : float
        Std of the known forces over the largest of them.
    held : int, optional
        Presses at the end that are not fitted but foretold; a quarter of them.

    Returns
    -------
    InSitu
        Its `pad` is the one to build the sensor with.

    Raises
    ------
    InputError
        Forces that do not fit or are none, no press left to fit.

    Notes
    -----
    What the mesh is wrong by is told by one that is 1.5 times as fine: 1.2 +- 0.4 times what both differ by is taken
    off, and what the material answers to that difference is added to the std, which so is that of the gel and not only
    of the noise. Not for pads whose mesh is from a file. What the weights of the readings, which go with
    the contacts that were found, still change is in it too. E and thickness usually hang together: ``covariance`` holds
    it.
    """
    F = _forces(forces, len(frames))
    kept = len(F) - (len(F) // 4 if held is None else int(held))
    if not 0 < kept <= len(F):
        raise InputError("no press is left to fit", where="in_situ, held", found=held, expected=f"0 to {len(F) - 1}")
    sensor = build(pad)
    seen = [(f, None if depths is None else depths[i]) for i, f in enumerate(frames)]
    y = np.array([sensor.readings(*pair) for pair in seen])
    noise = np.array([float(s.noise or 0.0) for s in sensor.model.sensors])
    spread = force_std * float(np.abs(F).max())
    fit = _Fit(sensor, prior, _Presses(y[:kept], noise, F[:kept], spread))
    found, misfit = fit.run()
    # what is left of an error of the model is shared by neighbours: it counts as fewer data
    scale = float(np.sqrt(1 + SHARING * max(misfit**2 - 1, 0.0)))
    mesh = fit.of_mesh(found, scale)
    covariance = fit.solved(found, scale)[1][:3, :3] + np.outer(mesh, mesh) + np.outer(fit.unsteady, fit.unsteady)
    most = fit.std / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    covariance *= np.outer(np.minimum(most, 1.0), np.minimum(most, 1.0))
    std = Tolerances(*np.sqrt(np.diag(covariance))[[0, 1, 2]])
    there = changed(pad, fit.at)
    errors = _foretold(build(there), seen, F, kept, np.hypot(spread, std.E * np.abs(F[kept:])))
    flags = (guards.modulus(there.E), guards.unlike(_rms(errors), len(errors), misfit))
    return InSitu(there, std, prior, covariance, misfit, fit.contacts, errors, tuple(f for f in flags if f is not None))


def _forces(forces: ArrayLike, count: int) -> Array:
    F = reals(forces, where="in_situ, forces")
    if F.shape != (count, 3) or not np.isfinite(F).all() or not np.any(F, axis=1).all():
        raise InputError(
            "the forces do not fit the presses", where="in_situ, forces", found=f"shape {F.shape}",
            expected=f"({count}, 3): a force that is not zero for each frame, in N", hint="a press has Fz < 0",
        )  # fmt: skip
    return F


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _foretold(sensor: MultilayerPad, seen: Sequence[Any], F: Array, kept: int, spread: Array) -> Array:
    """Resultants of presses from `kept` on less the known forces, over the std of both; `spread` is that of these."""
    if kept == len(F):
        return np.empty((0, 3))
    if not sensor.frozen:
        depths = [d for _, d in seen[:kept] if d is not None]
        sensor.calibrate([f for f, _ in seen[:kept]], depths or None)
    found = [sensor.estimate(*pair).resultant() for pair in seen[kept:]]
    away = np.array([v.value for v in found]) - F[kept:]
    return np.asarray(away / np.hypot(np.array([v.std for v in found]), spread))


@dataclass(frozen=True, eq=False)
class _Forward:
    """Readings of a sensor under presses, on its own pad or another one."""

    sensor: MultilayerPad
    pad: Pad

    @cached_property
    def transfer(self) -> Array:
        """Readings (m, 3 P) of unit nodal forces: of markers, and of windows of depth."""
        markers, depth = self.sensor.markers, self.sensor.depth
        rows = [markers.rows(self.pad.from_surface(markers.points))]
        if depth is not None:
            rows.append(depth.rows(self.pad.from_surface(depth.samples)))
        return np.vstack([np.asarray(r @ self.pad.compliance) for r in rows])

    def forces(self, contact: Array, force: Array) -> Array:
        """Nodal forces (P, 3) of the bump of a force (3,)."""
        places, shares = _bump(contact)
        reach = np.array(self.pad.size) / 2 * (1 - 1e-9)
        places = np.clip(places, -reach, reach)
        return np.outer(self.pad.from_surface(places)[::3, ::3].T @ shares, force)

    def readings(self, forces: Array) -> Array:
        """Readings (m, n) under nodal forces (3 P, n)."""
        return np.asarray(self.transfer @ forces)

    def moved(self, contact: Array, force: Array) -> Array:
        """Readings (m,) under the bump of a force, by one solve: the pad is not condensed."""
        markers, depth, U = self.sensor.markers, self.sensor.depth, self.pad.displacements(self.forces(contact, force))
        rows = [markers.rows(self.pad.from_surface(markers.points) @ U.reshape(-1, 1))]
        if depth is not None:
            rows.append(depth.rows(self.pad.from_surface(depth.samples) @ U.reshape(-1, 1)))
        return np.concatenate(rows)[:, 0]

    def press(self, contact: Array) -> Array:
        """Readings (m, 3) under the bump of unit forces along X, Y, Z."""
        unit = np.stack([self.forces(contact, e).ravel() for e in np.eye(3)], axis=1)
        return self.readings(unit)

    def loose(self, contact: Array, force: Array) -> Array:
        """Readings (m, n) per std of what is free under a press of a force (3,): tractions without a resultant."""
        nodes, areas = self.pad.nodes2d, self.pad.surface.areas
        near = np.flatnonzero(np.hypot(*(nodes - contact[:2]).T) <= contact[2] + 0.5 * float(np.sqrt(np.median(areas))))
        own, (x, y) = areas[near], (nodes[near] - contact[:2]).T / contact[2]
        # every node by itself, and what all of them share: a slope, another profile
        kinds = np.column_stack([np.eye(near.size), x, y, 2 * (x**2 + y**2) - 1])
        parts = own[:, None] * (kinds - own @ kinds / own.sum())  # nodal forces, their sum taken off
        unit = np.zeros((3 * len(nodes), 3 * parts.shape[1]))
        for axis in range(3):
            unit[np.ix_(3 * near + axis, np.arange(parts.shape[1]) + axis * parts.shape[1])] = parts
        return LOOSE * float(np.linalg.norm(force)) / (np.pi * contact[2] ** 2) * self.readings(unit)


def _bump(contact: Array) -> tuple[Array, Array]:
    """Places and shares of a quadrature of the pressure of a sphere."""
    g, w = np.polynomial.legendre.leggauss(8)
    t = (g + 1) / 2  # 1 - r^2 / a^2 = t^2
    turns = 2 * np.pi * (np.arange(16) + 0.5) / 16
    r = contact[2] * np.sqrt(1 - t**2)
    places = contact[:2] + np.array([[p * np.cos(q), p * np.sin(q)] for p in r for q in turns])
    return places, np.repeat(1.5 * w * t**2 / 16, 16)


@dataclass(frozen=True, eq=False)
class _Presses:
    """Readings (presses, m), NaN where lost, their std (m,), forces (presses, 3) and the std of these."""

    y: Array
    noise: Array
    forces: Array
    spread: float

    def whitener(self, forward: _Forward, k: int, contact: Array) -> tuple[Array, Array]:
        """Readings that are there, and the lower factor of the covariance of what the bump does not explain."""
        seen = np.isfinite(self.y[k])
        known = self.spread * forward.press(contact)[seen]
        loose = forward.loose(contact * (1, 1, BEYOND), self.forces[k])[seen]
        C = np.diag(self.noise[seen] ** 2) + known @ known.T + loose @ loose.T
        return seen, cholesky(C, lower=True, check_finite=False)

    def placed(self, forward: _Forward, thickness: float) -> Array:
        """Where each press is, (presses, 3): the node at which its force explains the readings best, up to a gain."""
        pad = forward.pad
        inner = np.flatnonzero(~pad.edge)
        out = []
        for y, force in zip(self.y, self.forces, strict=True):
            unit = np.zeros((3 * pad.points, len(inner)))
            for axis in range(3):
                unit[3 * inner + axis, np.arange(len(inner))] = force[axis]
            seen = np.isfinite(y)
            known = forward.readings(unit)[seen] / self.noise[seen, None]
            fit = (known.T @ (y[seen] / self.noise[seen])) / np.linalg.norm(known, axis=0)
            out.append([*pad.nodes2d[inner[int(np.argmax(fit))]], BEGIN * thickness])
        return np.array(out)


@dataclass(frozen=True, eq=False)
class _Step:
    """Whitened residuals (n,) and sensitivities (n, 4 + 3 presses) at a material and contacts, prior rows apart."""

    rest: Array
    slopes: Array


@dataclass(frozen=True, eq=False)
class _Weights:
    """Of one press: readings that are there, factor of the covariance of their residuals, and error of the mesh."""

    seen: Array
    factor: Array
    mesh: Array


class _Fit:
    """Gauss-Newton over log E, nu, log thickness, place and log radius of every press, and the error of the mesh.

    Weights, the error of the mesh, and the pads whose differences are the sensitivities to nu and thickness are held
    while it settles, and then found anew: a pad is dear to condense.
    """

    def __init__(self, sensor: MultilayerPad, prior: Tolerances, presses: _Presses) -> None:
        self.sensor, self.presses, pad = sensor, presses, sensor.pad
        self.start = np.array([np.log(pad.E), pad.nu, np.log(pad.thickness)])
        self.std = np.array([prior.E, prior.nu, prior.thickness])
        self.free = np.r_[self.std > 0, np.ones(3 * len(presses.y), bool), finer(pad) is not None]
        self.at, self.share = self.start.copy(), WHOLE
        self.unsteady = np.zeros(3)  # what other weights made of the material
        self.contacts = presses.placed(_Forward(sensor, pad), pad.thickness)
        self.first_radius = np.log(self.contacts[:, 2])

    def forward(self, at: Array) -> _Forward:
        """The model at log E, nu, log thickness, on a mesh of the same topology."""
        return _Forward(self.sensor, changed(self.sensor.pad, at))

    def weights(self, base: _Forward) -> list[_Weights]:
        """Of every press, on the pad as it is here."""
        other = finer(base.pad)
        fine = None if other is None else _Forward(self.sensor, other)
        out = []
        for k, (contact, force) in enumerate(zip(self.contacts, self.presses.forces, strict=True)):
            here = base.press(contact) @ force
            mesh = np.zeros(len(here)) if fine is None else fine.moved(contact, force) - here
            out.append(_Weights(*self.presses.whitener(base, k, contact), mesh))
        return out

    def step(self, base: _Forward, weights: Sequence[_Weights], pads: Sequence[_Forward]) -> _Step:
        """Residuals and sensitivities here; `pads` is one, and it with another nu and another thickness."""
        count = len(self.presses.y)
        rests, slopes = [], []
        for k, (contact, force, w) in enumerate(zip(self.contacts, self.presses.forces, weights, strict=True)):
            here, *varied = (pad.press(contact) @ force for pad in (base, *pads))
            columns = np.zeros((len(here), 4 + 3 * count))
            columns[:, 0] = -here
            columns[:, 1:3] = (np.stack(varied[1:], axis=1) - varied[0][:, None]) / STEPS
            for j, moved in enumerate(_beside(contact)):
                columns[:, 3 + 3 * k + j] = (base.press(moved) @ force - here) / BESIDE[j]
            columns[:, -1] = w.mesh
            rest = self.presses.y[k] - here - self.share * w.mesh
            white = solve_triangular(w.factor, np.column_stack([rest, columns])[w.seen], lower=True)
            rests.append(white[:, 0])
            slopes.append(white[:, 1:])
        return _Step(np.concatenate(rests), np.concatenate(slopes))

    def varied(self, base: _Forward) -> list[_Forward]:
        """The pad as it is here, and with another nu and another thickness."""
        nu, thickness = np.diag(STEPS)
        return [base, self.forward(self.at + np.r_[0.0, nu]), self.forward(self.at + np.r_[0.0, thickness])]

    def prior(self) -> tuple[Array, Array]:
        """Rows of what was declared, and of radii."""
        count = len(self.contacts)
        std = np.r_[np.where(self.std > 0, self.std, 1.0), np.tile([np.inf, np.inf, RADIUS], count), FINER]
        grown = np.column_stack([np.zeros((count, 2)), np.log(self.contacts[:, 2]) - self.first_radius])
        now = np.r_[self.at - self.start, grown.ravel(), self.share - WHOLE]
        return -now / std, np.diag(1 / std)

    def solved(self, found: _Step, scale: float) -> tuple[Array, Array]:
        """Step (3 + 3 presses,) and its covariance, where residuals count for a `scale` of their std."""
        rest, rows = self.prior()
        A = np.concatenate([found.slopes / scale, rows])[:, self.free]
        b = np.concatenate([found.rest / scale, rest])
        size = np.linalg.norm(A, axis=0)
        U, s, Vt = np.linalg.svd(A / size, full_matrices=False)
        step, covariance = np.zeros(len(self.free)), np.zeros((len(self.free),) * 2)
        step[self.free] = (Vt.T @ ((U.T @ b) / s)) / size
        half = (Vt.T / s) / size[:, None]
        covariance[np.ix_(self.free, self.free)] = half @ half.T
        return step, covariance

    def run(self) -> tuple[_Step, float]:
        """To the minimum: residuals and sensitivities there, and the rms of what is left."""
        for _ in range(TURNS):
            before, base = self.at, self.forward(self.at)
            weights, pads = self.weights(base), self.varied(base)
            for _ in range(ROUNDS):
                found = self.step(base, weights, pads)
                step, covariance = self.solved(found, 1.0)
                small = ENOUGH * np.sqrt(np.diag(covariance)[:3])
                if np.all(np.abs(step[:3]) <= small):
                    break
                self._go(step)
                base = self.forward(self.at)
            self.unsteady = self.at - before
            if np.all(np.abs(self.unsteady) <= small):
                break
        spare = max(len(found.rest) - int(self.free.sum()), 1)
        return found, float(np.sqrt(np.sum(found.rest**2) / spare))

    def _go(self, step: Array) -> None:
        """A step, cut where it goes farther than the linear model is to be believed."""
        self.at = self.at + step[:3] / max(1.0, float(np.abs(step[:3] / FURTHEST).max()))
        self.at[1] = np.clip(self.at[1], 0.01, HIGHEST)
        moved = step[3:-1].reshape(-1, 3)
        self.share += float(step[-1])
        thickness = float(np.exp(self.at[2]))
        self.contacts[:, :2] += np.clip(moved[:, :2], -0.2 * thickness, 0.2 * thickness)
        grown = np.exp(np.clip(moved[:, 2], -0.4, 0.4))
        self.contacts[:, 2] = np.clip(self.contacts[:, 2] * grown, LEAST * thickness, MOST * thickness)

    def of_mesh(self, found: _Step, scale: float) -> Array:
        """By how much log E, nu, log thickness answer to what both meshes differ by (3,)."""
        own = self.free.copy()
        own[-1] = False
        A = np.concatenate([found.slopes / scale, self.prior()[1]])[:, own]
        b = np.concatenate([found.slopes[:, -1] / scale, np.zeros(len(own))])
        size, out = np.linalg.norm(A, axis=0), np.zeros(len(own))
        out[own] = np.linalg.lstsq(A / size, b, rcond=None)[0] / size
        return out[:3]


def _beside(contact: Array) -> list[Array]:
    """Contacts moved along x and y, and grown."""
    x, y, a = contact
    dx, dy, da = BESIDE
    return [np.array([x + dx, y, a]), np.array([x, y + dy, a]), np.array([x, y, a * np.exp(da)])]


def changed(pad: Pad, at: Array) -> Pad:
    """The same pad with another log E, nu and log thickness; a mesh from a file keeps its thickness."""
    E, nu = pad.E * float(np.exp(at[0] - np.log(pad.E))), float(at[1])  # to the last digit what it was, where it is
    if pad.mesh is not None:
        return replace(pad, E=E, nu=nu)
    return replace(pad, E=E, nu=nu, thickness=pad.thickness * float(np.exp(at[2] - np.log(pad.thickness))))


def finer(pad: Pad) -> Pad | None:
    """The same pad with a finer mesh; None where the mesh is from a file, or its cells are named one by one."""
    if pad.mesh is not None or pad.elements is None or getattr(pad.outline, "cells", None) is not None:
        return None
    nx, ny = (round(n * REFINED) for n in pad.elements)
    return replace(pad, elements=(nx, ny), layers=max(pad.layers + 1, round(pad.layers * REFINED)), counts=None)
