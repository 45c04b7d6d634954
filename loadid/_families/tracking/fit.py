"""How a filter is made of a model, what a fit has settled, and its values as text and numbers for files.

The order of an array in memory is kept: the products of BLAS differ in their last bit with it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._advice import Advice, from_plain, to_plain
from structures._channels import Channel
from structures._flags import Evidence, Flag
from structures._model import Model, as_model
from structures.errors import InputError

from ... import _guards as guards
from ... import priors
from ..._guards.tracking import other_model
from ..._inverse.gaussian.augment import augment
from ..._inverse.gaussian.model import FilterModel, Present
from ..._inverse.gaussian.roots import Array
from ..._inverse.gaussian.steady import SteadyFilter, steady
from ..._inverse.problem import NOT_KNOWN, NoiseSource
from .certificate import TrackCertificate
from .filters import SPREAD, WEIGHT, rescaled, restricted
from .windows import Usual

PRIORS = (
    priors.RandomWalk, priors.White, priors.OU, priors.Matern32, priors.Matern52, priors.Periodic, priors.Sum,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Recipe:
    """Priors, noises and the rest of what a filter is made of beside the model.

    Parameters
    ----------
    priors : tuple
    noise : array (sensors of the model,)
        Std; those of sensors that are not used do not matter.
    rows : array of int
        Sensors that are used.
    hold : str or None
    state_noise : float
    bias, start : float, array or str
    scale : float
        Variance that multiplies all noises (`filters.rescaled`).
    errors : mapping of str to float
        Relative std of parameters of the model.
    dummy : float, optional
        Std of displacements at the loads that are believed to stay near zero.
    """

    priors: tuple[Any, ...]
    noise: Array
    rows: NDArray[np.int_]
    hold: str | None
    state_noise: float
    bias: Any
    start: Any
    scale: float
    errors: Mapping[str, float]
    dummy: float | None = None

    def build(self, model: Any, dt: float) -> FilterModel:
        """Filter of a model."""
        made = augment(
            model, dt, list(self.priors), noise=self.noise, hold=self.hold, state_noise=self.state_noise,
            bias=self.bias, start=self.start, dummy=self.dummy,
        )  # fmt: skip
        return rescaled(restricted(made, self.rows), self.scale)

    def bank(self, model: Any, dt: float) -> list[tuple[float, FilterModel]]:
        """Filters of models that are wrong by what was declared, with their weights."""
        return [
            (WEIGHT, self.build(model.perturbed(name, 1 + sign * SPREAD * std), dt))
            for (name, std), sign in product(self.errors.items(), (-1, 1))
        ]


def storable(parts: Sequence[Any]) -> bool:
    """Whether priors can stand in a recipe, and in a file."""
    return all(isinstance(p, PRIORS) and (not isinstance(p, priors.Sum) or storable(p.parts)) for p in parts)


def renewed(f: TrackerFit, model: Any) -> TrackerFit:
    """A fit with the filters of another model; its certificate is stale.

    Raises
    ------
    InputError
        Another number of states.
    NotIdentifiable
        No settled gain.
    """
    assert f.recipe is not None
    made = f.recipe.build(model, f.dt)
    if (made.n, made.nx) != (f.model.n, f.model.nx):
        raise InputError("a model with other states", where="update_model", found=f"{made.nx} states",
                         expected=f"{f.model.nx}", hint="keep as many modes, or fit a tracker to it")  # fmt: skip
    return replace(
        f,
        model=made,
        settled=None if f.settled is None else steady(made, f.dt),
        bank=tuple((w, m, None if f.settled is None else steady(m, f.dt)) for w, m in f.recipe.bank(model, f.dt)),
        fingerprint=model.fingerprint,
        flags=guards.collect([*f.flags, other_model(f.fingerprint, model.fingerprint)]),
        stale=True,
    )


def same_channels(f: Any, model: Any) -> None:
    """Refuse a model with other sensors or loads than those of a fit, or without a state space.

    Raises
    ------
    InputError
    """
    as_model(model, "update_model", "state_space")
    if max(f.recipe.rows) >= len(model.sensors) or len(f.recipe.noise) != len(model.sensors):
        raise InputError("a model with other sensors", where="update_model", found=f"{len(model.sensors)} sensors",
                         expected=f"{len(f.recipe.noise)}")  # fmt: skip
    for what, own, other in (
        ("sensors", f.sensors, [model.sensors[i] for i in f.recipe.rows]), ("loads", f.loads, list(model.loads)),
    ):  # fmt: skip
        mine, theirs = ([(c.label, c.unit) for c in part] for part in (own, other))
        if mine != theirs:
            raise InputError(f"a model with other {what}", where="update_model",
                             found=", ".join(label for label, _ in theirs), expected=", ".join(
                                 label for label, _ in mine), hint="fit a tracker to it")  # fmt: skip


def carried(before: Model | None, after: Model, nx: int) -> Array | None:
    """States (nx, nx) of a model from those of another of the same structure, through its degrees of freedom.

    None where the two do not share any: then nothing is known of the states but their number.
    """
    if before is None or before.structure is None or after.structure is None:
        return None
    one, two = before.reduced, after.reduced
    if one is None or two is None:
        return None
    k = len(one.lam)
    filtered = bool(np.any(one.corner > 0) or np.any(two.corner > 0))
    mass = after.structure.M_free
    if len(two.lam) != k or 2 * k != nx or filtered or mass is None:
        return None
    old, new = before.shapes.phi, after.shapes.phi
    if old.shape != new.shape:
        return None
    shapes = new.T @ (mass @ old)
    unit = [np.where(lam > 0, np.sqrt(lam), 1.0) for lam in (one.lam, two.lam)]
    T = np.zeros((nx, nx))
    T[0::2, 0::2] = unit[1][:, None] * shapes / unit[0]
    T[1::2, 1::2] = shapes
    return T


@dataclass(frozen=True, eq=False)
class TrackerFit:
    """What a fit has settled; everything that a tracker needs to run.

    Parameters
    ----------
    model : FilterModel
    settled : SteadyFilter or None
    bank : tuple of (weight, FilterModel, SteadyFilter or None)
        Models that are wrong by what was declared.
    dt : float
    sensors, loads : tuple of Channel
    words : str
        The priors of the loads.
    numbers : mapping
        What was tuned.
    noise_source : NoiseSource
        Or its text, as files of release 0.1 have it.
    certificate : TrackCertificate or None
    flags : tuple of Flag
    fingerprint : str
        Of the model of the structure.
    settings : mapping
    inputs : mapping
        Digest of the record of the fit.
    limits : array (sensors, 2), optional
        Ends of the range of each sensor, infinite where it has none: a sample at them is not believed.
    recipe : Recipe, optional
        How the filter was made of the model, for another one.
    stale : bool
        The certificate is that of another model.
    usual : Usual, optional
        What the record of the fit gave the watch over the sensors; without it there is none.
    wider : array (loads,), optional
        By which the std of each load is wider than that of the filter, as its sensors leave more between them.
    most : array (loads,), optional
        Largest size of each load in the record of the fit.
    """

    model: FilterModel
    settled: SteadyFilter | None
    bank: tuple[tuple[float, FilterModel, SteadyFilter | None], ...]
    dt: float
    sensors: tuple[Channel, ...]
    loads: tuple[Channel, ...]
    words: str
    numbers: Mapping[str, float]
    noise_source: NoiseSource
    certificate: TrackCertificate | None
    flags: tuple[Flag, ...]
    fingerprint: str
    settings: Mapping[str, Any]
    inputs: Mapping[str, str]
    limits: Array | None = None
    recipe: Recipe | None = None
    stale: bool = False
    usual: Usual | None = None
    wider: Array | None = None
    most: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "noise_source", NoiseSource.of(self.noise_source) or NOT_KNOWN)


TYPES: dict[str, type] = {
    **{kind.__name__: kind for kind in (Channel, Evidence, Flag, FilterModel, NoiseSource, Present, Recipe, *PRIORS)},
    "Certificate": TrackCertificate, "Fitted": TrackerFit, "Steady": SteadyFilter,
    "Usual": Usual,
}  # fmt: skip
NAMES = {kind: name for name, kind in TYPES.items()}  # in files, as release 0.1 has them
FIELDS = {"Certificate": {"robust_std": "spread"}}  # the same of their fields


def pack(value: Any) -> dict[str, Any]:
    """Numbers, text, None, arrays, mappings, sequences and the frozen values of a tracker.

    Returns
    -------
    dict
        ``text``: JSON of everything but the real numbers of arrays; ``numbers``: these, one after the other.

    Raises
    ------
    InputError
        A value of another type.
    """
    packer = _Packer()
    text = json.dumps(packer.pack(value), ensure_ascii=False)
    return {"text": text, "numbers": np.concatenate([np.zeros(0), *packer.parts])}


def unpack(tree: Mapping[str, Any]) -> Any:
    """Inverse of `pack`.

    Raises
    ------
    InputError
        A tree that `pack` did not make.
    """
    return _Unpacker(tree["numbers"]).unpack(json.loads(tree["text"]))


class _Packer:
    """What is met twice is written once: the matrices of a filter stand in its settled gain too."""

    def __init__(self) -> None:
        self.parts: list[Array] = []
        self.seen: dict[int, int] = {}
        self.kept: list[Any] = []  # alive, so that no two of them share an id

    def pack(self, value: Any) -> Any:
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, Advice):
            return {"is": "advice", "of": to_plain(value)}
        if value is None or isinstance(value, bool | int | float | str):
            return value
        if isinstance(value, Mapping):
            return {"is": "mapping", "of": {str(k): self.pack(v) for k, v in value.items()}}
        if isinstance(value, list | tuple):
            return {"is": "tuple" if isinstance(value, tuple) else "list", "of": [self.pack(v) for v in value]}
        if id(value) in self.seen:
            return {"is": "same", "of": self.seen[id(value)]}
        self.seen[id(value)] = len(self.kept)
        self.kept.append(value)
        if isinstance(value, np.ndarray):
            return self._array(value)
        kind = Channel if isinstance(value, Channel) else type(value)  # of a sensor only what a channel says is needed
        name = NAMES.get(kind)
        if not is_dataclass(value) or name is None:
            raise InputError("a value that the file of a tracker does not hold", where="checkpoint",
                             found=kind.__name__, expected="numbers, text, arrays, " + ", ".join(TYPES))  # fmt: skip
        other = FIELDS.get(name, {})
        own = {other.get(f.name, f.name): self.pack(getattr(value, f.name)) for f in fields(kind) if f.init}
        return {"is": name, "of": own}

    def _array(self, value: Array) -> dict[str, Any]:
        if value.dtype != np.float64:
            return {"is": "small", "type": value.dtype.str, "of": value.tolist()}
        turned = value.flags.f_contiguous and not value.flags.c_contiguous
        self.parts.append((value.T if turned else value).ravel())
        return {"is": "turned" if turned else "array", "of": list(value.shape)}


class _Unpacker:
    def __init__(self, numbers: Array) -> None:
        self.numbers, self.at = numbers, 0
        self.seen: list[Any] = []

    def unpack(self, tree: Any) -> Any:
        if not isinstance(tree, dict):
            return tree
        kind, inner = tree["is"], tree["of"]
        if kind == "advice":
            return from_plain(inner)
        if kind == "mapping":
            return {k: self.unpack(v) for k, v in inner.items()}
        if kind in ("list", "tuple"):
            found = [self.unpack(v) for v in inner]
            return found if kind == "list" else tuple(found)
        if kind == "same":
            return self.seen[inner]
        place = len(self.seen)
        self.seen.append(None)
        self.seen[place] = value = self._made(kind, tree, inner)
        return value

    def _made(self, kind: str, tree: dict[str, Any], inner: Any) -> Any:
        if kind == "small":
            return np.array(inner, np.dtype(tree["type"]))
        if kind in ("array", "turned"):
            size = int(np.prod(inner))
            part = self.numbers[self.at : self.at + size].copy()
            self.at += size
            return part.reshape(inner) if kind == "array" else part.reshape(inner[::-1]).T
        if kind not in TYPES:
            raise InputError("not a value of a tracker", where="checkpoint", found=repr(kind),
                             expected=", ".join(TYPES))  # fmt: skip
        own = {theirs: ours for ours, theirs in FIELDS.get(kind, {}).items()}
        return TYPES[kind](**{own.get(k, k): self.unpack(v) for k, v in inner.items()})
