"""The answer of every family: a load with its uncertainty, and all that must be known before it is trusted."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from statistics import NormalDist
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._certificate import Certificate
from structures._flags import Flag, canonical, cautions, codes
from structures._readonly import ReadOnly
from structures.errors import InputError
from structures.files import _storage as storage

from .._inverse.choice import Choice
from . import tables
from .again import Again
from .facts import Facts, Grade, grade
from .faults import SensorFault
from .functionals import Functional, functional, resultants
from .report import fragment, write_report
from .summary import NOT_VERIFIED, summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .._lab.explore import Exploration

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Axis(ReadOnly):
    """The first axis of a load: its name, unit and values (ascending)."""

    name: str
    unit: str
    values: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", _frozen(self.values))

    @property
    def step(self) -> float:
        """Step of an even axis."""
        return float(self.values[-1] - self.values[0]) / (len(self.values) - 1)


@dataclass(frozen=True)
class Peak:
    """Largest magnitude of one load, with its sign: value, standard deviation, and where on the axis."""

    label: str
    value: float
    std: float
    unit: str
    at: float | None
    index: int


@dataclass(frozen=True, kw_only=True, eq=False)
class LoadEstimate:
    """A reconstructed load with its uncertainty and its history. Immutable.

    Parameters
    ----------
    load : array, shape (samples, loads) or (loads,)
        SI units, as named in `units`.
    std : array, the shape of `load`
        Standard deviation: noise, prior, errors of a measured model; not less than the modulus of `bias`.
    bias : array, the shape of `load`, optional
        What regularisation is expected to hide, at least: what it would take away from a load like the estimate.
    labels, units : sequence of str
        One of each per load.
    axis : Axis, optional
        Time or frequency; None for a static load of shape (loads,).
    choice : Choice, optional
        How lambda was chosen.
    response, residual : array, shape (samples, sensors) or (sensors,), optional
        Measured response, and measured minus predicted.
    sensors, sensor_units : sequence of str
        One of each per sensor.
    flags : sequence of Flag
        Findings of the guards.
    allowed : sequence of str
        Codes whose refusal was overridden.
    certificate : Certificate, optional
        Check of the forward model against a known load.
    provenance : mapping
        Versions, settings, sha256 of the inputs, fingerprint of the model, date, family, prior in words.
    posterior : object, optional
        ``variance(w)`` of weights of the shape of `load` (or stacked in front), and ``to_arrays()``.
    geometry : mapping, optional
        Plain arrays of a load basis: ``coordinates`` (P, dim), ``cells``, ``components``, ``kind``, ``measures``,
        ``resultant`` (R, loads) with ``resultant_labels``, ``traction`` (loads, loads) for nodal forces.
    diagnosis : Diagnosis, optional
        What the data can tell: `loadid._inverse.diagnosis.diagnose.diagnose`.
    validation : Validation, optional
        What was validated, and at which level.
    spectrum : LoadSpectrum, optional
        What every frequency line tells (`loadid._results.functionals`).
    faults : sequence of SensorFault
        Sensors that contradict the others: `SensorFault.correct` gives the readings without the fault.
    facts : Facts
        Numbers that are printed with every result (`loadid._results.facts`); a mapping of them is taken too.
    again : Again, optional
        The problem behind it, for `at`.

    Raises
    ------
    InputError
        If shapes or names do not fit together, or a number is not finite.
    """

    load: Array
    std: Array
    labels: Sequence[str]
    units: Sequence[str]
    axis: Axis | None = None
    choice: Choice | None = None
    response: Array | None = None
    residual: Array | None = None
    sensors: Sequence[str] = ()
    sensor_units: Sequence[str] = ()
    flags: Sequence[Flag] = ()
    allowed: Sequence[str] = ()
    certificate: Certificate | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    posterior: Any = field(default=None, repr=False)
    bias: Array | None = field(default=None, repr=False)
    geometry: Mapping[str, Any] | None = field(default=None, repr=False)
    diagnosis: Any = field(default=None, repr=False)
    validation: Any = None
    spectrum: Any = field(default=None, repr=False)
    faults: Sequence[SensorFault] = ()
    facts: Facts = field(default_factory=Facts)
    again: Again | None = field(default=None, repr=False, compare=False)

    kind_of_facts: ClassVar[type[Facts]] = Facts

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name in ("load", "std", "response", "residual", "bias"):
            if getattr(self, name) is not None:
                put(self, name, _frozen(getattr(self, name)))
        for name in ("labels", "units", "sensors", "sensor_units", "flags", "faults"):
            put(self, name, tuple(getattr(self, name)))
        put(self, "allowed", tuple(canonical(c) for c in self.allowed))
        put(self, "provenance", MappingProxyType(dict(self.provenance)))
        put(self, "facts", self.kind_of_facts.of(self.facts))
        if self.geometry is not None:
            put(self, "geometry", MappingProxyType(dict(self.geometry)))
        _check(self)

    def __repr__(self) -> str:
        peaks = ", ".join(f"{p.label}: peak {p.value:.4g} {p.unit}" for p in self.peaks[:3])
        return f"<LoadEstimate {self.load.shape}, {peaks}; {len(self.flags)} flags>"

    def __reduce__(self) -> tuple[Any, ...]:
        state = {f.name: getattr(self, f.name) for f in fields(self)}
        views = {k: v if v is None else dict(v) for k in ("provenance", "geometry") for v in [state[k]]}
        return rebuilt, (type(self), state | views | {"again": None})

    # -- numbers --------------------------------------------------------------------------------------------------
    @property
    def codes(self) -> set[str]:
        """Short codes of the flags, ``{"W114", ...}``."""
        return codes(self.flags)

    @property
    def grade(self) -> Grade:
        """How far the load can be trusted, with measured odds: ``str(estimate.grade)`` (`loadid._results.facts`)."""
        return grade(self)

    @property
    def cautions(self) -> tuple[Flag, ...]:
        """Flags that are no notes, by their expected effect on the load."""
        return tuple(cautions(self.flags))

    @property
    def verified(self) -> str:
        """The certificate in words, or ``"forward model not verified"``."""
        return NOT_VERIFIED if self.certificate is None else str(self.certificate)

    @property
    def predicted(self) -> Array | None:
        """Response that the model predicts for this load, the shape of `response`."""
        return None if self.response is None or self.residual is None else self.response - self.residual

    def band(self, level: float = 0.95) -> tuple[Array, Array]:
        """Lower and upper end of the central band of probability `level`, each of the shape of `load`.

        Of complex amplitudes the band of their moduli: errors are circular, ``std = sqrt(E|error|^2)``.
        """
        if isinstance(level, bool) or not isinstance(level, int | float | np.number) or not 0 < level < 1:
            raise InputError("no probability", where="level", found=repr(level), expected="between 0 and 1")
        if self.load.dtype.kind == "c":
            size, radius = np.abs(self.load), np.sqrt(-np.log1p(-level)) * self.std
            return np.maximum(size - radius, 0.0), size + radius
        width = NormalDist().inv_cdf(0.5 + level / 2) * self.std
        return self.load - width, self.load + width

    def trust(self, level: float | None = None) -> NDArray[np.bool_]:
        """Frequency lines whose predicted relative error is at most `level`, shape (lines, loads).

        Raises
        ------
        InputError
            An estimate without frequency lines, or a level that is not positive.
        """
        if self.spectrum is None:
            raise InputError("this estimate has no frequency lines", where="trust", found="no spectrum",
                             expected="an estimate of FrequencyInversion",
                             hint="its std says how far it goes")  # fmt: skip
        trusted: NDArray[np.bool_] = self.spectrum.trust(level)
        return trusted

    @property
    def peaks(self) -> tuple[Peak, ...]:
        """Largest magnitude of every load; over frequency on a line that is trusted, where one is."""
        load, std = self.load.reshape(-1, len(self.labels)), self.std.reshape(-1, len(self.labels))
        size = np.abs(load)
        if self.spectrum is not None and self.axis is not None and self.axis.name == "frequency":
            trusted = self.trust()
            size = np.where(trusted | ~trusted.any(axis=0), size, -1.0)
        found = []
        for j, (label, unit) in enumerate(zip(self.labels, self.units, strict=True)):
            i = int(np.argmax(size[:, j]))
            value = load[i, j].item() if self.load.dtype.kind != "c" else abs(load[i, j].item())
            at = None if self.axis is None else float(self.axis.values[i])
            found.append(Peak(label, value, float(std[i, j]), unit, at, i))
        return tuple(found)

    def functional(
        self,
        w: str | ArrayLike = "impulse",
        *,
        load: int | str | None = None,
        loads: Sequence[int | str] | None = None,
        window: tuple[float, float] | None = None,
        limit: float | None = None,
    ) -> Functional:
        """A weighted sum of the load with its standard deviation, correlations included.

        Parameters
        ----------
        w : ``"impulse"``, ``"mean"``, ``"sum"``, ``"peak"``, ``"resultant"`` or array
            Impulse (step times sum, in unit s), mean over the axis or over `loads` (pressures by area where a basis
            knows it), sum over `loads`, largest magnitude, resultant of a basis (``load="Fz"``), or weights of the
            shape of `load` or (samples,). Over loads, a sequence of frames gives its last one.
        load : int or str
            Which load, by index or label, or which resultant; default the first.
        loads : sequence of int or str, optional
            Which loads to sum or average.
        window : (float, float), optional
            Part of the axis, both ends included.
        limit : float, optional
            No load exceeds this: states the largest bias that regularisation can then have made.

        Raises
        ------
        InputError
            If there is no such load, no axis, or the window or the weights do not fit.
        """
        return functional(self, w, load=load, loads=loads, window=window, limit=limit)

    @property
    def resultants(self) -> tuple[Functional, ...]:
        """Resultant forces and moments, with std, where the loads are a basis that knows its geometry."""
        return resultants(self)

    def traction(self) -> NDArray[np.float64]:
        """Tractions (Pa, or N/m on a line) of a static load, the shape of `load`: nodal forces by the boundary mass.

        Raises
        ------
        InputError
            If the loads are not a basis that knows its geometry.
        """
        matrix = None if self.geometry is None else self.geometry.get("traction")
        if self.geometry is None or (matrix is None and self.geometry.get("kind") == "nodal"):
            raise InputError(
                "these loads have no geometry that would make them tractions", where="traction",
                found="loads without a basis", expected="a model whose loads are a Basis",
                hint="build the loads with structures.bases",
            )  # fmt: skip
        return self.load if matrix is None else np.asarray(self.load @ np.asarray(matrix).T)

    def at(self, lam: float) -> LoadEstimate:
        """The estimate at another relative lambda: what the family answers with ``choice=lam``, for much less work.

        The problem is that of this estimate: what was found with its own lambda (constants of channels that see none)
        stays, and a variance of the load that was learned from the record gives way to a constant one.

        Parameters
        ----------
        lam : float
            Relative to the scale of the problem, ``choice.scale``; above 0.

        Raises
        ------
        InputError
            No such lambda; an estimate that came from a file, a copy or another process, or of a family without one
            lambda: FrequencyInversion, SparseDeconvolution, LoadTracker.
        """
        from .._inverse.choice import positive_lambda

        if self.again is None:
            raise InputError(
                "this estimate holds no problem that could be solved at another lambda", where="at",
                found=str(self.provenance.get("family", "an estimate of unknown origin")),
                expected="what Deconvolution, FieldDeconvolution, StaticInversion or HarmonicInversion returned here",
                hint="ask the family again, with choice=",
            )  # fmt: skip
        found = self.again.full(positive_lambda(lam))
        notes = self.provenance.get("notes")
        return replace(found, provenance={**found.provenance, "notes": notes}) if notes else found

    def validated(self, validation: Any) -> LoadEstimate:
        """Copy that carries what was validated (`loadid.validate.validate`), in its summary, report and file."""
        return replace(self, validation=validation, flags=(*self.flags, *validation.flags))

    def index(self, load: int | str | None) -> int:
        """Column of a load, by index or label; None is the first.

        Raises
        ------
        InputError
            If there is none.
        """
        load = 0 if load is None else load
        if isinstance(load, str) and load in self.labels:
            return list(self.labels).index(load)
        if isinstance(load, int | np.integer) and -len(self.labels) <= load < len(self.labels):
            return int(load) % len(self.labels)
        raise InputError("no such load", where="load", found=repr(load), expected=f"an index or one of {self.labels}")

    def over(self, name: str) -> Axis:
        """The first axis, which must be this one and have a step.

        Raises
        ------
        InputError
            If it is another.
        """
        if self.axis is None or self.axis.name != name or len(self.axis.values) < 2:
            found = "a static load" if self.axis is None else f"{len(self.axis.values)} values of {self.axis.name}"
            raise InputError(f"a load over {name} is needed", where="axis", found=found)
        return self.axis

    def inside(self, window: tuple[float, float] | None) -> NDArray[np.bool_]:
        """Which samples of the axis lie in a window.

        Raises
        ------
        InputError
            If there is no axis, or none does.
        """
        if self.axis is None:
            raise InputError(
                "a static load has no axis to take it over", where="w", hint="give the weights as an array"
            )
        start, stop = _ends(window)
        inside = (self.axis.values >= start) & (self.axis.values <= stop)
        if not inside.any():
            ends = f"{self.axis.values[0]:.6g} to {self.axis.values[-1]:.6g} {self.axis.unit}"
            raise InputError("the window holds no sample", where="window", found=window, expected=f"inside {ends}")
        return inside

    # -- words, pictures, files -----------------------------------------------------------------------------------
    def summary(self, *, details: bool = False) -> str:
        """What a user must read first, in at most eight lines; `details`: also how it was found, and every flag."""
        return summary(self, details=details)

    def plot(
        self,
        kind: str = "load",
        *,
        truth: ArrayLike | None = None,
        ax: Axes | None = None,
        path: str | os.PathLike[str] | None = None,
        show: bool = False,
    ) -> Figure:
        """Picture of the load, or of what the data tell of it.

        Parameters
        ----------
        kind : str
            ``"load"``, ``"field"`` (over its places), ``"spacetime"`` (along a line over time), ``"response"``,
            ``"path"`` (how lambda was chosen), ``"lcurve"``, ``"gcv"``, ``"picard"``, ``"filter_factors"``,
            ``"resolution"``, ``"columns"``, or of frequency lines ``"lines"`` (what each can tell).
        truth : array, optional
            Known load of the shape of `load` (or (samples,) for one load), drawn beside it.
        ax : matplotlib Axes, optional
            Draw the first load into these axes instead of making a figure.
        path : path, optional
            File to save to, by its suffix.
        show : bool
            Open a window.
        """
        from .._plots import plot

        return plot(self, kind, truth=truth, ax=ax, path=path, show=show)

    def explore(self, *, browser: bool | None = None, port: int = 0) -> Exploration:
        """The estimate in the lab: a page with its L-curve, a slider for lambda, residuals and flags.

        The page is served on this machine alone until `Exploration.close`; nothing waits for it.

        Parameters
        ----------
        browser : bool, optional
            Open it in the browser; default yes, but not in a notebook, which shows the page where it stands.
        port : int
            0 for any that is free.

        Returns
        -------
        Exploration
            With the `address` of the page; its ``repr`` says it too.

        Raises
        ------
        InputError
            A port that cannot be had.
        """
        from .._lab.explore import explore

        return explore(self, browser=browser, port=port)

    def report(self, path: str | os.PathLike[str], *, truth: ArrayLike | None = None) -> None:
        """Write one self-contained HTML page."""
        write_report(self, path, truth=truth)

    def _repr_html_(self) -> str:
        return fragment(self)

    def to_dict(self, *, arrays: bool = True) -> dict[str, Any]:
        """Everything but the posterior as plain lists, text and numbers for strict JSON; not finite becomes None.

        Parameters
        ----------
        arrays : bool
            False leaves out what is as long as the record.
        """
        from . import archive

        tree = archive.to_tree(self)
        tree.pop("posterior")
        tree["peaks"] = [asdict(p) for p in self.peaks]
        tree["verified"] = self.verified
        tree["grade"] = {**asdict(self.grade), "meaning": self.grade.meaning, "said": str(self.grade)}
        tree = archive.plain(tree)
        return tree if arrays else archive.without_arrays(tree)

    def to_dataframe(self) -> Any:
        """DataFrame of pandas over time or frequency: each load and, as ``LABEL std``, its standard deviation, in SI.

        A static load has a row for each label, with ``load``, ``std`` and ``unit``. ``attrs["units"]`` holds the units.
        """
        return tables.to_dataframe(self)

    def to_xarray(self) -> Any:
        """Dataset of xarray with ``load``, ``std`` and, where it is known, ``bias``, in SI; units are a coordinate."""
        return tables.to_xarray(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an HDF5 file with checksums, whole or not at all."""
        from . import archive

        storage.write(path, archive.to_tree(self), archive.KIND)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> LoadEstimate:
        """Read what `save` wrote.

        Raises
        ------
        InputError
            If the file is missing, of another kind, or damaged.
        """
        from . import archive

        return archive.read(path, cls.from_tree)

    @classmethod
    def from_tree(cls, tree: dict[str, Any]) -> LoadEstimate:
        """Inverse of `loadid._results.archive.to_tree`."""
        from . import archive

        given = archive.arguments(tree)
        axis = given.pop("axis")
        return cls(axis=axis and Axis(**axis), **given)


load = LoadEstimate.read


# -- helpers ----------------------------------------------------------------------------------------------------------
def _frozen(value: ArrayLike) -> Array:
    array = np.array(value)  # a copy: the caller's array stays writable and apart
    array = array if array.dtype.kind in "fc" else array.astype(float)
    array.setflags(write=False)
    return array


def _ends(window: tuple[float, float] | None) -> tuple[float, float]:
    if window is None:
        return -np.inf, np.inf
    try:
        start, stop = (float(x) for x in window)
    except (TypeError, ValueError):
        start = stop = np.nan
    if np.isnan(start) or np.isnan(stop):
        raise InputError(
            "the window is no pair of numbers", where="window", found=repr(window)[:80], expected="(start, stop)"
        )
    return start, stop


def _check(e: LoadEstimate) -> None:
    def need(good: bool, what: str, found: object, expected: object) -> None:
        if not good:
            raise InputError(what, where="LoadEstimate", found=found, expected=expected)

    n, m = len(e.labels), len(e.sensors)
    need(e.load.ndim in (1, 2) and e.load.size > 0, "no load", e.load.shape, "(samples, loads) or (loads,)")
    need(e.load.shape[-1] == n == len(e.units), "labels or units do not fit", (n, len(e.units)), e.load.shape[-1])
    need(e.std.shape == e.load.shape, "the std does not fit the load", e.std.shape, e.load.shape)
    need(bool(np.all(np.isfinite(e.load))), "the load is not finite", "NaN or infinity", "finite numbers")
    need(bool(np.all(np.isfinite(e.std)) and np.all(e.std >= 0)), "the std is no std", "NaN, inf or < 0", ">= 0")
    if e.bias is not None:
        need(e.bias.shape == e.load.shape, "the bias does not fit the load", e.bias.shape, e.load.shape)
        need(bool(np.all(np.isfinite(e.bias))), "the bias is not finite", "NaN or infinity", "finite numbers")
    rows = e.load.shape[:-1]
    have = () if e.axis is None else e.axis.values.shape
    need(have == rows, "the axis does not fit the load", have, rows)
    for name in ("response", "residual"):
        array = getattr(e, name)
        if array is not None:
            need(array.shape[-1] == m == len(e.sensor_units), f"sensors do not fit the {name}", array.shape, m)
            need(bool(np.all(np.isfinite(array))), f"the {name} is not finite", "NaN or infinity", "finite numbers")
    if e.response is not None and e.residual is not None:
        need(e.response.shape == e.residual.shape, "residual and response differ", e.residual.shape, e.response.shape)


def rebuilt(kind: Callable[..., Any], state: dict[str, Any]) -> Any:
    """An immutable result of its fields: its views of mappings cannot be pickled, and its arrays arrive writable."""
    return kind(**state)
