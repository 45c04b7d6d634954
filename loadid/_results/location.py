"""The answer of a search for the place of a load: where, how sure, what else could be, and the load there."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._flags import Flag, canonical, codes
from structures.files import _storage as storage

from .estimate import LoadEstimate, rebuilt
from .facts import Facts, fact
from .summary import Z95

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[Any]


KIND = "location"
LISTED = 8  # candidates that a summary lists


@dataclass(frozen=True)
class Rival:
    """Another place, beyond the neighbours of the best, that explains the data.

    Parameters
    ----------
    place : tuple of float
        m; empty where candidates have no known places.
    label : str
        Candidate from which it was refined.
    ratio : float
        Its residual norm over that of the best place.
    load : int
        Which of the loads it would move.
    """

    place: tuple[float, ...]
    label: str
    ratio: float
    load: int = 0


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LocationFacts(Facts):
    """Facts of a search for a place.

    Parameters
    ----------
    candidates, sensors : int
    exact : bool
        Every fit was solved to the end.
    responses : str
        How responses between candidates were come by, in words.
    ratio : float
        Residual norm of the runner-up over that of the best.
    place_by : str
        What told the place between candidates: the residual, the evidence of hits, or the first part of the response.
    """

    candidates: int | None = fact()
    sensors: int | None = fact()
    exact: bool | None = fact()
    responses: str | None = fact()
    ratio: float | None = fact()
    place_by: str | None = fact()


@dataclass(frozen=True, kw_only=True, eq=False)
class LocationResult:
    """Where a load acted. Immutable.

    Parameters
    ----------
    labels : sequence of str
        Candidates.
    places : array, shape (candidates, dim), or None
        Their places (m).
    spacing : float or None
        Median distance of neighbouring candidates (m).
    scores : array, shape (loads, candidates)
        Residual norm over the norm of the data, whitened, with each candidate in turn as the place of a load. With
        several loads, the responses of the others are taken off first.
    best : sequence of int
        The candidate of each load.
    runner_up : int
        Candidate of the next smallest score, of the load for which it comes closest.
    ratio : float
        Its score over the best.
    plausible : sequence of sequences of str
        For each load, the candidates whose misfit lies within the 95 % chi-square of the best candidate's.
    alike : sequence of sequences of str
        Groups of candidates that leave the same data, from the model alone.
    found : array, shape (loads, dim), or None
        Refined places (m); those of the best candidates where nothing was refined.
    covariance : array, shape (loads, dim, dim), or None
        Of the refined places (m^2); zero in coordinates that all candidates share.
    refined : bool
    residual : float
        Residual norm over the norm of the data at the places found.
    rivals : sequence of Rival
        Best places outside the neighbourhood of those found, refined alike.
    estimate : LoadEstimate or None
        The load histories at the places found.
    flags : sequence of Flag
        Of the search; `estimate` has its own and these.
    allowed : sequence of str
        Codes whose refusal was overridden.
    geometry : mapping
        ``sensors`` (sensors, dim) and ``outline`` (nodes, dim) where known, for pictures.
    facts : LocationFacts
        Numbers of the search; a mapping of them is taken too.
    provenance : mapping
        Its history.
    """

    labels: Sequence[str]
    places: Array | None
    spacing: float | None
    scores: Array
    best: Sequence[int]
    runner_up: int
    ratio: float
    plausible: Sequence[Sequence[str]]
    alike: Sequence[Sequence[str]]
    found: Array | None
    covariance: Array | None
    refined: bool
    residual: float
    rivals: Sequence[Rival] = ()
    estimate: LoadEstimate | None = None
    flags: Sequence[Flag] = ()
    allowed: Sequence[str] = ()
    geometry: Mapping[str, Any] = field(default_factory=dict, repr=False)
    facts: LocationFacts = field(default_factory=LocationFacts)
    provenance: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name in ("places", "scores", "found", "covariance"):
            if (value := getattr(self, name)) is not None:
                array = np.array(value, float)
                array.setflags(write=False)
                put(self, name, array)
        put(self, "labels", tuple(self.labels))
        put(self, "best", tuple(int(j) for j in self.best))
        for name in ("plausible", "alike"):
            put(self, name, tuple(tuple(group) for group in getattr(self, name)))
        put(self, "rivals", tuple(self.rivals))
        put(self, "flags", tuple(self.flags))
        put(self, "allowed", tuple(canonical(c) for c in self.allowed))
        put(self, "facts", LocationFacts.of(self.facts))
        for name in ("geometry", "provenance"):
            put(self, name, MappingProxyType(dict(getattr(self, name))))

    def __reduce__(self) -> tuple[Any, ...]:
        state = {f.name: getattr(self, f.name) for f in fields(self)}
        return rebuilt, (type(self), state | {name: dict(state[name]) for name in ("geometry", "provenance")})

    def __repr__(self) -> str:
        return f"<LocationResult {'; '.join(self.where)}; {'ambiguous' if self.ambiguous else 'not ambiguous'}>"

    @property
    def codes(self) -> set[str]:
        """Short codes of the flags of the search, ``{"W511", ...}``."""
        return codes(self.flags)

    @property
    def ambiguous(self) -> bool:
        """Whether another place explains the data as well (W511, E512)."""
        return bool(self.codes & {"W511", "E512"})

    @property
    def std(self) -> NDArray[np.float64] | None:
        """Standard deviation of the refined places (loads, dim) in m."""
        return None if self.covariance is None else np.sqrt(np.einsum("kdd->kd", self.covariance))

    @property
    def where(self) -> tuple[str, ...]:
        """Place of each load in words."""
        said = []
        for k, j in enumerate(self.best):
            if self.found is None:
                said.append(f"candidate {self.labels[j]}")
                continue
            spread = None if self.std is None else self.std[k]
            parts = [
                f"{v:.4g}" if spread is None else f"{v:.4g} ± {Z95 * spread[d]:.1g}"
                for d, v in enumerate(self.found[k])
            ]
            band = "" if spread is None else " (95 % band)"
            said.append(f"({', '.join(parts)}) m{band}, nearest candidate {self.labels[j]}")
        return tuple(said)

    @property
    def ranking(self) -> tuple[tuple[str, float], ...]:
        """Candidates with their scores, best first; with several loads, the best score of each candidate."""
        score = self.scores.min(axis=0)
        return tuple((self.labels[j], float(score[j])) for j in np.argsort(score, kind="stable"))

    def summary(self, *, command: bool = False) -> str:
        """What a user must read, as text; `command`: advice in the words of the command line."""
        lines = [f"load {k + 1} of {len(self.best)}: {w}" for k, w in enumerate(self.where)]
        noise = self.facts.residual_to_noise
        lines.append(
            f"residual at the place: {self.residual:.4g} of the data"
            + ("" if noise is None else f", {noise:.3g} times the noise")
        )
        lines.append(
            f"best candidate {self.labels[self.best[0]]}; runner-up {self.labels[self.runner_up]}, "
            f"residual ratio {self.ratio:.4f} (ambiguous below 1.05)"
        )
        lines += [f"candidates within chi-square of the best: {', '.join(p[:LISTED])}" for p in self.plausible]
        lines += [f"other place: {r.label} {_coordinates(r.place)}, residual ratio {r.ratio:.4f}" for r in self.rivals]
        lines += [f"same data at: {', '.join(g)}" for g in self.alike[:LISTED]]
        lines += [f.command if command else str(f) for f in self.flags]
        return "\n".join(lines)

    def plot(
        self,
        kind: str = "map",
        *,
        truth: ArrayLike | None = None,
        path: str | os.PathLike[str] | None = None,
        show: bool = False,
    ) -> Figure:
        """Picture of the search.

        Parameters
        ----------
        kind : ``"map"`` or ``"residual"``
            Residual over the places of the candidates, or over the candidates in their order.
        truth : array, shape (loads, dim), optional
            Known places, drawn beside those found.
        path : path, optional
            File to save to, by its suffix.
        show : bool
            Open a window.
        """
        from .._plots.choosing import draw

        return draw(self, kind, truth=truth, path=path, show=show)

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, texts and numbers for strict JSON, without the load history."""
        from . import archive

        tree = archive.plain(_tree(self) | {"estimate": None})
        return {**tree, "where": list(self.where), "ambiguous": self.ambiguous}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an HDF5 file with checksums, whole or not at all."""
        from . import archive

        estimate = None if self.estimate is None else archive.to_tree(self.estimate)
        storage.write(path, _tree(self) | {"estimate": estimate}, KIND)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> LocationResult:
        """Read what `save` wrote.

        Raises
        ------
        InputError
            If the file is missing, of another kind, or damaged.
        """
        from . import archive

        return archive.read(path, cls._of_tree, KIND)

    @classmethod
    def _of_tree(cls, tree: dict[str, Any]) -> LocationResult:
        if tree["estimate"] is not None:
            tree["estimate"] = LoadEstimate.from_tree(tree["estimate"])
        tree["flags"] = [Flag.from_dict(f) for f in tree["flags"]]
        tree["rivals"] = [Rival(**(r | {"place": tuple(r["place"])})) for r in tree["rivals"]]
        return cls(**tree)


def _tree(r: LocationResult) -> dict[str, Any]:
    """Nested dictionary of everything but the load history."""
    tree: dict[str, Any] = {f.name: getattr(r, f.name) for f in fields(r) if f.name != "estimate"}
    for name in ("geometry", "facts", "provenance"):
        tree[name] = dict(tree[name])
    tree["flags"] = [f.to_dict() for f in r.flags]
    tree["rivals"] = [asdict(x) for x in r.rivals]
    for name in ("labels", "best", "allowed"):
        tree[name] = list(tree[name])
    for name in ("plausible", "alike"):
        tree[name] = [list(group) for group in tree[name]]
    return tree


def _coordinates(place: Sequence[float]) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in place) + ") m" if place else ""
