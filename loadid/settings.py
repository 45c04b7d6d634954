"""Settings that belong together: a family takes the first of them alone, or all of them as one small class.

``noise=0.1`` and ``noise=Noise(0.1, source="datasheet")`` are the same argument; the second says more. The classes are
immutable, check what they hold where they are made, and print as they can be pasted.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from structures._flags import allowed
from structures.errors import InputError, number, positive, real, reals, shown

from ._inverse.penalties import order
from ._inverse.problem import Cholesky, NoiseSource, NoiseSourceLike
from ._inverse.sparse import TOLERANCE

if TYPE_CHECKING:
    from ._inverse.path import RegularizationPath

__all__ = [
    "Absolute",
    "Guards",
    "Lambda",
    "ModelErrors",
    "Noise",
    "Online",
    "Penalty",
    "Priors",
    "Search",
    "Signal",
    "Sparsity",
]

VARIANCES = ("constant", "local", "smooth", "auto")
METHODS = ("tikhonov", "tsvd")
PATHS = ("auto", "dense", "statespace", "toeplitz", "windows", "fft")
OVER = ("neighbours", "line", "band")
SIGNALS = ("stationary", "transient")
CLASSES = ("impact", "service")
GROUPS = ("loads", "slots")
ENGINES = ("own", "filterpy")
PARAMETERS = ("stiffness", "mass", "damping")
ERRORS = ("gain", "frequency", "damping", "shape")
MOST = 1000  # samples of a lag


def one_of(name: str, value: object, known: Sequence[object], *, what: str = "") -> None:
    """Nothing, where a setting has one of the values that it may have.

    Raises
    ------
    InputError
        If it has another.
    """
    if not isinstance(value, str | bool | None) or value not in known:
        raise InputError(what or f"unknown {name}", where=name, found=repr(value)[:80],
                         expected=f"one of {', '.join(map(repr, known))}")  # fmt: skip


def whole(name: str, value: object, least: int, most: float = np.inf, *, what: str = "") -> None:
    """Nothing, where a setting is an integer from `least` to `most`.

    Raises
    ------
    InputError
        If it is none.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not least <= value <= most:
        span = f"an integer >= {least}" if np.isinf(most) else f"an integer from {least} to {most:g}"
        raise InputError(what or f"no number of {name}", where=name, found=repr(value)[:80], expected=span)


@dataclass(frozen=True)
class Absolute:
    """A lambda in the units of the problem, kept only where it must be (flag W307).

    Parameters
    ----------
    lam : float
        Absolute lambda of the whitened problem.
    """

    lam: float

    def relative(self, path: RegularizationPath) -> float:
        """The relative lambda that it is on this path."""
        if isinstance(self.lam, bool) or not (np.isfinite(self.lam) and self.lam >= 0):
            raise InputError("no lambda", where="choice", found=self.lam, expected="a finite number >= 0")
        return float(self.lam / path.scale)


@dataclass(frozen=True, repr=False, eq=False)
class Setting:
    """A setting with what belongs to it: its first field is what is taken in its place."""

    @classmethod
    def of(cls, given: Any) -> Self:
        """What a caller gave: one of these, or the first field alone."""
        return given if isinstance(given, cls) else cls(given)  # type: ignore[call-arg]

    def said(self) -> Iterator[tuple[str, Any]]:
        """Name and value of the fields that are not left at their default."""
        for f in fields(self):
            if not _same(vars(self)[f.name], f.default):
                yield f.name, vars(self)[f.name]

    def __repr__(self) -> str:
        first = fields(self)[0].name
        parts = (pasted(value) if name == first else f"{name}={pasted(value)}" for name, value in self.said())
        return f"{type(self).__name__}({', '.join(parts)})"

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(_same(value, vars(other)[name]) for name, value in vars(self).items())

    def __hash__(self) -> int:
        return hash(repr(self))

    def __reduce__(self) -> tuple[Any, ...]:
        return _made, (type(self), {n: dict(v) if isinstance(v, Mapping) else v for n, v in self.said()})

    def _put(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _hold(self, name: str, what: str) -> None:
        """A field as a number or a read-only array; None and texts stay."""
        value = vars(self)[name]
        if value is not None:
            array = reals(value, what=what, where=name)
            array.flags.writeable = False
            self._put(name, array if array.ndim else float(array))


def _made(kind: type[Setting], values: dict[str, Any]) -> Setting:
    return kind(**values)


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return type(a) is type(b) and np.array_equal(a, b)
    return a is b or bool(np.all(a == b))


def pasted(value: Any) -> str:
    """A value as it is written in Python."""
    if isinstance(value, np.ndarray | np.generic):
        return repr(value.tolist())
    if isinstance(value, Mapping):
        return repr(dict(value))
    if isinstance(value, NoiseSource) and not value.white:
        return repr(value.kind if value == NoiseSource(value.kind) else (value.kind, value.text))
    return value.__name__ if inspect.isroutine(value) else repr(value)


@dataclass(frozen=True, repr=False, eq=False)
class Noise(Setting):
    """The noise of the sensors, and who says so.

    Parameters
    ----------
    std : float, array or Cholesky, optional
        Std of the sensors, (sensors,), or their covariance (sensors, sensors), or its Cholesky factor, as the family
        says; where nobody states it, the data tell.
    source : NoiseSource, str or (str, str), optional
        Where that level comes from: a kind (``"datasheet"``, ``"repeatability"``, ``"quiet"``, ...), a kind and a text,
        or a `loadid.NoiseSource`; a text of another wording states no origin. Without an origin flag W406 is raised
        when the level decides.
    interpolation : array (sensors, markers), optional
        The readings were interpolated from raw markers, y = W z; `std` is then that of the markers. `StaticInversion`.
    bias : float or array (sensors of the model,)
        Std that a second adds to the offset of a sensor; 0: it does not drift. `LoadTracker`.
    frf : float, optional
        Relative std of the entries of the FRF, 0 where it is exact; None: what the model states, else learned from the
        lines. `FrequencyInversion`.
    errors : mapping of str to float, optional
        Relative std of what the model is wrong by: ``"gain"`` of each sensor and, as large, of all together,
        ``"frequency"`` and ``"damping"`` of each mode, ``"shape"`` of the lowest at each sensor (of others more, with
        their wave number); default .02, .01, .2 and .05; 0 leaves one out. `Deconvolution`, in the band of the default
        and of ``Penalty(variance="local")``.

    Raises
    ------
    InputError
        What is no real number, NaN, an unknown kind of source.
    """

    std: Any = None
    source: NoiseSourceLike = None
    interpolation: ArrayLike | None = None
    bias: ArrayLike = 0.0
    frf: float | None = None
    errors: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        if self.frf is not None:
            share = real(self.frf)
            if share is None or not 0 <= share < 1:
                raise InputError("no relative error of an FRF", where="frf", found=repr(self.frf)[:80],
                                 expected="a number from 0 to 1, such as 0.05")  # fmt: skip
            self._put("frf", share)
        if self.std is not None and not isinstance(self.std, Cholesky):
            level = reals(self.std, what="the noise is no real number", where="noise")
            if not np.all(np.isfinite(level)):
                raise InputError("the noise does not fit the sensors", where="noise", found="NaN or infinity in it",
                                 expected="finite numbers")  # fmt: skip
            level.flags.writeable = False
            self._put("std", level if level.ndim else float(level))
        self._put("source", NoiseSource.of(self.source))
        self._hold("interpolation", "the interpolation is no matrix of real numbers")
        self._hold("bias", "no drift of the sensors")
        if self.errors is not None:
            self._hold_errors()

    def _hold_errors(self) -> None:
        given: Any = self.errors
        stds = {k: real(v) for k, v in given.items()} if isinstance(given, Mapping) else {}
        for name, std in stds.items():
            if name not in ERRORS or std is None or not 0 <= std < 1:
                stds = {}
        if not stds:
            raise InputError("no errors of a model", where="errors", found=repr(given)[:80],
                             expected=f"relative std, 0 to below 1, of some of {', '.join(ERRORS)}")  # fmt: skip
        self._put("errors", MappingProxyType(stds))

    @property
    def stated(self) -> bool:
        """Whether a level was given."""
        return self.std is not None

    @property
    def origin(self) -> NoiseSource | None:
        """The source, as it was settled."""
        return NoiseSource.of(self.source)


@dataclass(frozen=True, repr=False, eq=False)
class Lambda(Setting):
    """How much regularisation: who chooses it, and along which path of solutions.

    Parameters
    ----------
    choice : str, callable, float, Absolute or None
        Rule, or relative lambda; None chooses as `loadid.paths.choose` says.
    method : {"tikhonov", "tsvd"}
    path : {"auto", "dense", "statespace", "toeplitz", "windows", "fft"}
        Solver of `Deconvolution`; ``auto`` takes what fits the length, the model and the other settings
        (`loadid._families.posing.pose`).
    over : {"neighbours", "line", "band"}
        Who decides in `FrequencyInversion`: each line with its neighbours, each alone, or all together.
    neighbours : int
        Lines to either side that inform a line (Hann weights). `FrequencyInversion`.
    count : int, optional
        Singular values that truncated SVD keeps on each line. `FrequencyInversion`.
    size : array (loads,), optional
        Expected relative size of the loads of `FrequencyInversion`, for rules and given lambdas; by default each load
        counts by how much it moves the sensors, so that forces and moments do not mix their units.

    Raises
    ------
    InputError
        Unknown names, numbers that are none.
    """

    choice: Any = None
    method: str = "tikhonov"
    path: str = "auto"
    over: str = "neighbours"
    neighbours: int = 40
    count: int | None = None
    size: ArrayLike | None = None

    def __post_init__(self) -> None:
        named = isinstance(self.choice, str | Absolute | None) or callable(self.choice)
        if not named and real(self.choice) is None:
            raise InputError("no relative lambda", where="choice", found=repr(self.choice)[:80],
                             expected="a number >= 0, the name of a rule, or None")  # fmt: skip
        one_of("method", self.method, METHODS)
        one_of("path", self.path, PATHS)
        one_of("over", self.over, OVER)
        whole("neighbours", self.neighbours, 0, what="no number of lines")
        if self.count is not None:
            whole("count", self.count, 1, what="no number of singular values")
        self._hold("size", "no sizes of the loads")

    @property
    def free(self) -> bool:
        """Least squares, without regularisation."""
        return self.count is None and not isinstance(self.choice, str | None) and bool(self.choice == 0)


ChoiceLike: TypeAlias = str | float | Callable[..., Any] | Absolute | Lambda | None


@dataclass(frozen=True, repr=False, eq=False)
class Penalty(Setting):
    """What is held small beside the residual.

    Parameters
    ----------
    L : str, array or None
        ``identity, first_difference, second_difference`` (``gradient``, ``laplacian``) or another name, a matrix, or
        None for plain least squares, as the family says.
    size : float or array (loads,), optional
        The penalty becomes ``|L g|^2 + |size g|^2``: differences from sample to sample and the load itself are held
        small together, a load that is correlated over 1 / size samples and returns to zero. Dense and state-space path.
    leak : float, optional
        The first difference becomes ``g_k - leak g_{k-1}``: a load that returns to zero by itself, for sensors that do
        not see a constant. State-space path only.
    from_zero : bool
        The load is zero before the record, and a difference penalty counts its first step. State-space path only.
    variance : {"auto", "constant", "local", "smooth"}
        Of the load over the record, for `Deconvolution` with the identity: constant or local, whichever the data ask
        for, where the model has states or measured FRFs and no lambda or rule is stated; the same at every sample, as a
        penalty has it; learned from the data at every sample, for impacts; or the same at every sample of a load that
        is smooth over as many samples as the data ask for (up to 30), for loads that act throughout.

    Raises
    ------
    InputError
        An unknown name, numbers that are none.
    """

    L: Any = "identity"
    size: ArrayLike | None = None
    leak: float | None = None
    from_zero: bool = False
    variance: str = "auto"

    def __post_init__(self) -> None:
        if isinstance(self.L, str):
            order(self.L)
        one_of("variance", self.variance, VARIANCES)
        one_of("from_zero", self.from_zero, (False, True))
        if self.leak is not None:
            self._put("leak", number("leak", self.leak, where="leak"))
        self._hold("size", "no weights of the size")
        size = np.asarray(1.0 if self.size is None else self.size, float)
        if size.ndim > 1 or not np.all(np.isfinite(size)) or np.any(size <= 0):
            raise InputError("no weights of the size of the loads", where="size", expected="positive, for each load",
                             found=f"shape {size.shape}, or not > 0")  # fmt: skip


@dataclass(frozen=True, repr=False, eq=False)
class Guards(Setting):
    """What the guards are told.

    Parameters
    ----------
    allow : sequence of str
        Guard codes whose refusal is overridden; printed on everything made from the result.
    coverage : Coverage, optional
        Outcome of `loadid.validate._checks` on a set-up like this one.
    load_class : {"impact", "service"}, optional
        Hammer blows and shocks, or a load that acts all the time: says when the prior does not fit it (W510, W311).
        Impacts that the prior smears are said in any case. `Deconvolution`, `SparseDeconvolution`.

    Raises
    ------
    InputError
        What is no guard code, an unknown class.
    """

    allow: Sequence[str] = ()
    coverage: Any = None
    load_class: str | None = None

    def __post_init__(self) -> None:
        self._put("allow", allowed(self.allow))
        one_of("load_class", self.load_class, (*CLASSES, None), what="unknown class of load")

    @property
    def codes(self) -> tuple[str, ...]:
        """The codes in full form."""
        return tuple(self.allow)

    def allowing(self, codes: Sequence[str]) -> Guards:
        """The same with further codes."""
        return replace(self, allow=allowed([*self.allow, *codes]))


@dataclass(frozen=True, repr=False, eq=False)
class Signal(Setting):
    """What a time record is, and how it becomes spectra (`FrequencyInversion`).

    Parameters
    ----------
    kind : {"stationary", "transient"}, optional
        Averaged into cross spectra, or transformed once, zero-padded, into a load history.
    window, segment, overlap
        Of averaged records, as in `structures.cross_spectra`.

    Raises
    ------
    InputError
        An unknown kind.
    """

    kind: str | None = None
    window: str = "hann"
    segment: int | None = None
    overlap: float = 0.5

    def __post_init__(self) -> None:
        one_of("signal", self.kind, (*SIGNALS, None), what="no such kind of record")


@dataclass(frozen=True, repr=False, eq=False)
class Sparsity(Setting):
    """The l1 penalty of `SparseDeconvolution`.

    Parameters
    ----------
    groups : {"loads", "slots"} or None
        ``"loads"``: which of the candidates acted: the history of a load is zero as a whole, or not.
        ``"slots"``: the loads act at the same times.
    nonnegative : bool
        Coefficients are not negative: the load only pushes (spikes, B-splines, matrices without negative entries).
    reweighted : int
        Rounds of reweighting, which hold small coefficients down and leave large ones.
    debias : bool
        Least squares on the support; without it the shrunken amplitudes of the penalty are returned.
    tol : float
        Relative duality gap, over ``1/2 |y|^2``.

    Raises
    ------
    InputError
        Settings that mean nothing.
    """

    groups: str | None = None
    nonnegative: bool = False
    reweighted: int = 0
    debias: bool = True
    tol: float = TOLERANCE

    def __post_init__(self) -> None:
        one_of("groups", self.groups, (*GROUPS, None))
        if self.groups == "slots" and self.nonnegative:
            raise InputError("groups of loads at one time have no sign", where="nonnegative",
                             found="with groups='slots'", expected="groups='loads' or None")  # fmt: skip
        whole("reweighted", self.reweighted, 0, 20, what="no number of rounds")
        if not (isinstance(self.tol, float) and 1e-14 <= self.tol <= 1e-5):
            raise InputError("no tolerance", where="tol", found=repr(self.tol)[:80],
                             expected="a duality gap of 1e-14 to 1e-5")  # fmt: skip


@dataclass(frozen=True, repr=False, eq=False)
class Search(Setting):
    """How `LocationSearch` goes through its candidates.

    Parameters
    ----------
    impacts : int
        Loads that act in the record, each at its own place.
    refine : bool
        Refine places between the candidates.
    places : array, shape (candidates, dim), optional
        Places of the candidates (m), where the model does not know them.
    workers : int, optional
        Threads; default the number of processors.

    Raises
    ------
    InputError
        Numbers that are none.
    """

    impacts: int = 1
    refine: bool = True
    places: ArrayLike | None = None
    workers: int | None = None

    def __post_init__(self) -> None:
        whole("impacts", self.impacts, 1, what="no number of loads")
        if self.workers is not None:
            whole("workers", self.workers, 1, what="no number of threads")
        self._put("refine", bool(self.refine))
        self._hold("places", "the places are no real numbers")


@dataclass(frozen=True, repr=False, eq=False)
class Priors(Setting):
    """What `LoadTracker` believes before the first sample.

    Parameters
    ----------
    load : str, prior, or one of them per load
        ``"matern32"`` (default), ``"matern52"``, ``"ou"``, ``"random_walk"``, ``"white"``: their numbers are found by
        likelihood. A prior of `loadid.priors` is taken as it is.
    start : float, array or ``"static"``
        Std of the states before the first sample: at rest by default, or carrying the first load in equilibrium.
    dummy : float, optional
        Std in m within which displacements at the loads are believed to stay near zero, at every sample: a prior that
        holds the mean of loads which accelerometers alone let drift, and no measurement (flag W525).

    Raises
    ------
    InputError
        Numbers that are none.
    """

    load: Any = "matern32"
    start: ArrayLike | str = 0.0
    dummy: float | None = None

    def __post_init__(self) -> None:
        if isinstance(self.load, list | tuple):
            self._put("load", tuple(self.load))
        if not isinstance(self.start, str):
            self._hold("start", "no stds of the states")
        elif self.start != "static":
            raise InputError("no such start", where="start", found=shown(self.start),
                             expected="stds, a root, or 'static'")  # fmt: skip
        if self.dummy is not None:
            self._put("dummy", positive("the std of a dummy displacement", self.dummy, where="dummy", unit="m"))


@dataclass(frozen=True, repr=False, eq=False)
class ModelErrors(Setting):
    """What `LoadTracker` takes the model to be wrong by.

    Parameters
    ----------
    relative : mapping of str to float, optional
        Relative std of parameters of the model (``"stiffness"``, ``"mass"``, ``"damping"``): the variance between the
        models is added to the band.
    scales : sequence of str
        Parameters of the model that are tuned too.
    state_noise : float
        Std that a sample adds to each state of the structure.
    ambient : Ambient, optional
        Other loads, unknown and white, that disturb structure and sensors alike: the noises are then correlated
        (`loadid.Ambient`).

    Raises
    ------
    InputError
        Other parameters, numbers that are none.
    """

    relative: Mapping[str, float] | None = None
    scales: Sequence[str] = ()
    state_noise: float = 0.0
    ambient: Any = None

    def __post_init__(self) -> None:
        if self.relative is not None and not isinstance(self.relative, Mapping):
            raise InputError("no declared error of the model", where="model_error", found=repr(self.relative)[:80],
                             expected="a mapping, such as {'stiffness': 0.02}")  # fmt: skip
        for name, std in (self.relative or {}).items():
            if name not in PARAMETERS or not 0 < (real(std) or 0.0) < 0.5:
                raise InputError("no declared error of the model", where="model_error", found=f"{name!r}: {std!r}",
                                 expected=f"a relative std between 0 and 0.5 of {', '.join(PARAMETERS)}")  # fmt: skip
        listed = isinstance(self.scales, list | tuple) and all(isinstance(s, str) for s in self.scales)
        if not listed or not set(self.scales) <= set(PARAMETERS) or len(set(self.scales)) != len(self.scales):
            raise InputError("no parameter of the model", where="scales", found=repr(self.scales)[:80],
                             expected=f"a list of some of {', '.join(PARAMETERS)}, each once")  # fmt: skip
        self._put("relative", MappingProxyType(dict(self.relative)) if self.relative else None)
        self._put("scales", tuple(self.scales))
        self._put("state_noise", number("state_noise", self.state_noise, where="LoadTracker"))


@dataclass(frozen=True, repr=False, eq=False)
class Online(Setting):
    """How a fitted tracker takes its samples.

    Parameters
    ----------
    lag : int or "auto"
        Samples by which the answers come late, with what was measured meanwhile. ``"auto"``: as few as bring the std
        within 5 % of that at 50.
    replay : int, optional
        Samples by which a sample may come late and still be put in its place (`Tracker.insert`); the lag if left out.
    limits : number, sequence (sensors,) or mapping of label to one, optional
        Ends of the range of the sensors that are used, L for -L to L or (low, high): a sample at them counts as
        missing, in the fit and after it.
    engine : {"own", "filterpy"}
        What runs the fitted filter. filterpy is slower, believes every number and answers at once: a gate is without
        effect, a lag and errors of the model are refused.

    Raises
    ------
    InputError
        Numbers that are none, an unknown engine.
    """

    lag: int | str = 0
    replay: int | None = None
    limits: Any = None
    engine: str = "own"

    def __post_init__(self) -> None:
        if self.lag != "auto":
            counted = isinstance(self.lag, int | np.integer) and not isinstance(self.lag, bool)
            if not counted or not 0 <= int(self.lag) <= MOST:
                raise InputError("no lag", where="lag", found=repr(self.lag)[:80],
                                 expected=f"0 to {MOST} samples, or 'auto'")  # fmt: skip
        if self.replay is not None:
            whole("replay", self.replay, 0, MOST, what="no count of samples")
        one_of("engine", self.engine, ENGINES)
