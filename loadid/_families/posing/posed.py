"""What is asked of a problem, the problem as posed, and its path by lines of the zero-padded spectrum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._advice import Advice, Option
from structures._model import Model
from structures._models.discretise import HOLDS
from structures._testing.spectra import padded_length, smooth_lines
from structures.errors import InputError, reals

from ... import _guards as guards
from ..._inverse import penalties
from ..._inverse.constrained.nonnegative import NonNegativeRecord
from ..._inverse.convolved.local_lines import Spectrum
from ..._inverse.convolved.path import SpectralPath
from ..._inverse.diagnosis import identifiability
from ..._inverse.gaussian.record import WhitenedRecord
from ..._inverse.nuisances import Nuisances
from ..._inverse.path import RegularizationPath
from ..._inverse.problem import NoiseSource
from ...settings import Lambda, Noise, Penalty, one_of
from .. import noise as noises
from ..data import AS_RECORDED, Data
from .model_errors import GainErrors, gains
from .support import acting, refuse, windows

Array = NDArray[Any]

PADDED = "zero-padded FFT"  # name of the path that goes line by line
AUTO = Option("path", "auto", within="choice=Lambda")
BY_MATRIX = Option("path", "dense", within="choice=Lambda")
WHOLE = 50_000  # samples up to which a record is convolved in one piece: `python -m tests.benchmarks.windows`
UNUSABLE = 1e-12  # |h(0)| over max |h| below which the diagonal is zero


@dataclass(frozen=True)
class PosingSettings:
    """What decides how a problem is posed; see `Deconvolution`."""

    noise: Noise
    lam: Lambda
    penalty: Penalty
    allow: tuple[str, ...]
    hold: str | None = None
    initial: str | ArrayLike = "rest"
    signed: ArrayLike | bool | None = False
    support: Any = None

    def __post_init__(self) -> None:
        one_of("hold", self.hold, (None, *HOLDS))
        object.__setattr__(self, "support", windows(self.support))
        if self.truncated:
            self._check_truncated()
        sized = isinstance(self.penalty.L, str) and not self.truncated and self.signed is False
        if self.penalty.size is not None and not sized:
            raise InputError(
                "a weight of the size stands beside a named penalty", where="size",
                found="'tsvd'" if self.truncated else "signs" if self.signed is not False else "a matrix or None",
                expected="penalty=Penalty('first_difference', size=...) or another name, Tikhonov, no constraints",
            )  # fmt: skip
        if self.local and not self._plain:
            self._refuse_local()
        if self.local and self.support is not None:
            refuse(
                f"variance={self.penalty.variance!r}",
                "variance='auto' or 'constant': the window says when",
            )
        if isinstance(self.initial, str):
            one_of("initial", self.initial, ("rest", "unknown"))
        else:
            object.__setattr__(self, "initial", reals(self.initial, what="no initial state", where="initial"))

    def _check_truncated(self) -> None:
        if self.lam.path in ("statespace", "toeplitz", "windows"):
            raise InputError("this path has no singular values to truncate", where="method",
                             found=repr(self.lam),
                             expected=Advice(AUTO, ", 'dense' or 'fft', or Tikhonov"))  # fmt: skip
        if self.signed is not False:
            raise InputError("a truncated SVD takes no constraints", where="method", found="'tsvd'",
                             expected="method='tikhonov'")  # fmt: skip

    def acting(self, samples: int, dt: float) -> NDArray[np.bool_] | None:
        """Samples at which the loads act; None where no window was given: at all of them."""
        return None if self.support is None else acting(self.support, samples, dt)

    def _refuse_local(self) -> None:
        raise InputError("a variance that is learned stands for the penalty", where="variance",
                         found="another penalty, truncation or signs beside it", hint="leave one of them out",
                         expected=f"Penalty('identity', variance={self.penalty.variance!r}), Tikhonov, no constraints",
                         )  # fmt: skip

    @property
    def _plain(self) -> bool:
        """Nothing is held small but the load, at every sample as much as at others."""
        return self.single and not (self.truncated or self.signed is not False)

    @property
    def single(self) -> bool:
        """The penalty holds each sample by itself."""
        plain = self.penalty.L == "identity" if isinstance(self.penalty.L, str) else False
        return plain and not (self.penalty.size is not None or self.penalty.leak is not None or self.penalty.from_zero)

    @property
    def unasked(self) -> bool:
        """No lambda, no rule was asked for by name: the data may ask for a variance that changes with time."""
        return self.penalty.variance == "auto" and self._plain and self.lam.choice is None

    @property
    def free(self) -> bool:
        """Without regularisation."""
        return self.penalty.L is None or self.lam.free

    @property
    def truncated(self) -> bool:
        """Truncated SVD in place of Tikhonov."""
        return self.lam.method == "tsvd"

    @property
    def named(self) -> bool:
        """A penalty that every path knows."""
        return isinstance(self.penalty.L, str)

    @property
    def resting(self) -> bool:
        """The structure is at rest at the first sample."""
        return isinstance(self.initial, str) and self.initial == "rest"

    @property
    def special(self) -> bool:
        """Asks for what only the state-space path gives."""
        return self._special or self.local

    @property
    def local(self) -> bool:
        """Variances of the load that are learned from the record were asked for."""
        return self.penalty.variance in ("local", "smooth")

    @property
    def _special(self) -> bool:
        return not self.resting or self.penalty.leak is not None or self.penalty.from_zero

    def sizes(self, loads: int) -> NDArray[np.float64] | None:
        """Weight of the size of each load beside its differences.

        Raises
        ------
        InputError
            Another number of weights than loads.
        """
        if self.penalty.size is None:
            return None
        size = np.asarray(self.penalty.size, float)
        if size.ndim and size.shape != (loads,):
            raise InputError("the weights of the size do not fit the loads", where="size", found=f"shape {size.shape}",
                             expected=f"a number, or ({loads},)")  # fmt: skip
        return np.array(np.broadcast_to(size, loads), float)

    def refuse_special(self, path: str, *, local: bool = True) -> None:
        """Refuse a start, a leak, a size or (`local`) a variance that changes on a path that does not know them.

        Raises
        ------
        InputError
            If one was asked for.
        """
        special = self.special if local else self._special
        if special or (self.penalty.size is not None and path != "dense"):
            name = "leak" if self.penalty.leak is not None else "from_zero" if self.penalty.from_zero else "size"
            name = "variance" if self.local else name if self.resting else "initial"
            raise InputError(
                f"the {path} path does not know this setting", where=name,
                found=repr(self.penalty if self.resting else self.initial)[:60],
                expected=Advice("a named penalty, Tikhonov with lambda > 0, a model with state_space(), and ", AUTO,
                                " or 'statespace'"),
            )  # fmt: skip


@dataclass(frozen=True)
class Posed:
    """A problem as posed.

    Parameters
    ----------
    path : RegularizationPath
    noise : NoiseLevel
    compare : callable
        (load, relative lambda, start or None) -> response and residual (samples, sensors); what is missing in the
        response is filled by the prediction. `start` is the state at the first sample, where that is an unknown and
        not that of the path.
    values : array, shape (samples, sensors)
        The data, advanced where the impulse response begins late.
    name : str
        Which path it is.
    h : array, shape (taps, sensors, loads)
        Impulse response of the used sensors; of a long record its beginning.
    layout : (kappa, rank, nullity)
        Conditioning of the visible part.
    full : (kappa, rank, nullity) or None
        The same with all sensors of the model, where only some are used.
    unknowns : int
    judged : RegularizationPath
        What the rules are asked on: the path itself, or the windows of a long record.
    pushing : callable, optional
        Numbers of the loads that only push (None: all) -> the same problem under signs.
    record : WhitenedRecord, optional
        The data over the states of the model, where the problem is posed on them.
    nuisances : Nuisances, optional
        What the model may be wrong by, where the problem is posed on its states.
    gains : GainErrors, optional
        The same of a measured model: the gains of its sensors.
    spectrum : Spectrum, optional
        The data over lines of measured FRFs, where the problem is posed on them.
    white : callable, optional
        Raw data (samples, sensors) -> data of the path; None where they cannot be made one by one.
    floats : bool
        Offsets of the data (`Data.offsets`) are unknowns of the path.
    """

    path: RegularizationPath
    noise: noises.NoiseLevel
    compare: Callable[[Array, float, Array | None], tuple[Array, Array]]
    values: NDArray[np.float64]
    name: str
    h: NDArray[np.float64]
    layout: tuple[float, int, int]
    full: tuple[float, int, int] | None
    unknowns: int
    judged: RegularizationPath
    pushing: Callable[[ArrayLike | None], NonNegativeRecord] | None = None
    record: WhitenedRecord | None = None
    nuisances: Nuisances | None = None
    gains: GainErrors | None = None
    spectrum: Spectrum | None = None
    white: Callable[[Array], Array] | None = None
    floats: bool = False

    @property
    def rank(self) -> int:
        """Unknowns that the data see."""
        return self.layout[1]


def by_prediction(
    values: Array, predict: Callable[[Array], Array]
) -> Callable[[Array, float, Array | None], tuple[Array, Array]]:
    """Comparison of complete data with the prediction of a load."""

    def compare(load: Array, lam: float, start: Array | None) -> tuple[Array, Array]:
        return values, values - predict(load)

    return compare


def diagonal(h: Array) -> float:
    """First sample of the impulse responses (samples, sensors, loads) over their maximum, for the worst load."""
    level = np.max(np.abs(h), axis=1)
    return float(np.min(level[0] / level.max(axis=0)))


def shift(h: Array, model: Model, allow: tuple[str, ...]) -> int:
    """Samples by which data are advanced so that the first load to arrive has a diagonal (0 with a first-order hold).

    No more than that: what a load that arrives earlier does in between must stay in the operator. The last samples of
    a load that arrives later are not seen, and are left to the prior.
    """
    level = np.max(np.abs(h), axis=1)  # (samples, loads)
    largest = level.max(axis=0)
    for j in np.flatnonzero(largest == 0):
        raise guards.index_offset(0.0, model.loads[j].label, None)
    usable = level > UNUSABLE * largest
    if "LID-E506" in allow or usable[0].all():
        return 0
    first = np.argmax(usable, axis=0)
    worst = int(np.argmax(first))
    if first[worst] > len(h) // 2:
        raise guards.index_offset(float(level[0, worst] / largest[worst]), model.loads[worst].label, int(first[worst]))
    return int(first.min())


LOCAL = 5  # lines on each side
EXPECTED_LOG = np.exp(np.euler_gamma)  # mean over geometric mean of an exponential variable: the periodogram's scatter


@dataclass(frozen=True)
class Roughness:
    """Error energy (lines, sensors) of the load spectrum that each sensor gives alone.

    Parameters
    ----------
    typical : array
        Geometric mean over a wide band: for weights, where a single antiresonance must not speak for its neighbours.
    local : array
        Arithmetic mean over a few lines: for the band of uncertainty, where every line counts.
    relative : array
        `typical` over the power of the load.
    """

    typical: NDArray[np.float64]
    local: NDArray[np.float64]
    relative: NDArray[np.float64]


def roughness(G: Array, band: float = 1 / 16) -> Roughness:
    """Error of the load spectrum that each sensor gives alone, from its roughness over the lines.

    A load that lasts a small part of the record has a spectrum that is smooth from line to line once it is shifted to
    its own time; what is rough is error. The second difference over lines keeps the noise that fills the record, by
    a known factor, and removes the load.

    Parameters
    ----------
    G : array, shape (lines, sensors)
        Load spectrum of each sensor alone, padded to twice the record.
    band : float
        Share of all lines on each side over which the typical error is averaged.
    """
    padded = 2 * (len(G) - 1)
    g = np.fft.irfft(G, axis=0)[: padded // 2]
    best = int(np.argmax(np.max(np.abs(g), axis=0) / np.maximum(np.median(np.abs(g), axis=0), np.finfo(float).tiny)))
    start = int(np.argmax(np.abs(g[:, best])))
    shift = np.exp(2j * np.pi * np.arange(len(G)) * start / padded)
    # the second difference multiplies sample t by 4 sin^2(pi t / padded): what is left of noise that fills the record
    kept = np.mean((2 * np.sin(np.pi * (np.arange(padded // 2) - start) / padded)) ** 4)
    rough = np.abs(np.diff(G * shift[:, None], n=2, axis=0)) ** 2 / kept
    rough = np.concatenate([rough[:1], rough, rough[-1:]])
    half = max(1, round(band * len(G)))
    tiny = np.finfo(float).tiny
    typical = np.exp(smooth_lines(np.log(np.maximum(rough, tiny)), half)) * EXPECTED_LOG
    power = np.exp(smooth_lines(np.log(np.maximum(np.abs(G[:, best]) ** 2, tiny)), half))
    return Roughness(typical, smooth_lines(rough, LOCAL), typical / power[:, None])


SILENT = 0.01  # share of the lines on which an FRF may be zero
ROUGH = 0.5  # relative error of the best sensor above which the load fills the record and roughness tells nothing


def lines(h: Array, values: Array, noise: noises.NoiseLevel, data: Data, settings: PosingSettings) -> Posed:
    """Problem of impulse responses (samples, sensors, loads) with the same noise on every line.

    Right where the response has decayed within the record.

    Raises
    ------
    InputError
        Missing samples, a covariance, or a penalty without a name.
    """
    settings.refuse_special("line by line")
    H = np.fft.rfft(h, padded_length(len(values)), axis=0)
    return replace(_lines(H, h, values, noises.white(noise, len(values), len(H)), data, settings), spectrum=None)


def measured_lines(model: Model, data: Data, settings: PosingSettings) -> Posed:
    """Problem of a measured model, with the variance of its FRFs and the noise that its training left on each line.

    Raises
    ------
    InputError
        A record of another step, an FRF that is not causal, missing samples, or a penalty without a name.
    """
    H, f = _measured_lines(model, data)
    h = np.fft.irfft(H, axis=0)
    samples = len(data.values)
    shift(h[:samples, data.rows], model, settings.allow)  # lines hold what comes before zero: only a refusal counts
    variance = model.frf_variance(f)
    variance = None if variance is None else variance[:, data.rows]
    noise = _measured_noise(model, data, settings, H[:, data.rows], model.noise_spectrum(f))
    h = h[: min(samples, model.samples or samples)]
    posed = _lines(H, h, data.values, noise, data, settings, variance)
    assert posed.spectrum is not None
    energy = posed.spectrum.weight @ np.abs(posed.spectrum.Y) ** 2
    return replace(posed, gains=gains(model, np.asarray(data.rows), settings.noise.errors or {}, energy))


def measured_response(
    model: Model, data: Data, settings: PosingSettings
) -> tuple[NDArray[np.float64], noises.LineNoise]:
    """Impulse responses (taps, sensors, loads) of a measured model, and its noise line by line."""
    H, f = _measured_lines(model, data)
    h = np.fft.irfft(H, axis=0)[: min(len(data.values), model.samples or len(data.values))]
    shift(h[:, data.rows], model, settings.allow)
    return h, _measured_noise(model, data, settings, H[:, data.rows], model.noise_spectrum(f))


def _measured_lines(model: Model, data: Data) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """FRFs at the lines of the padded transform of a record, and their frequencies."""
    own = float(model.dt or data.dt)
    if abs(data.dt / own - 1) > 1e-6:
        raise InputError(
            "the record and the model have different steps", where="estimate", found=f"dt = {data.dt:.9g} s",
            expected=f"dt = {own:.9g} s", hint=Advice(AS_RECORDED, ", or resample"),
        )  # fmt: skip
    f = np.linspace(0, 0.5 / own, padded_length(len(data.values)) // 2 + 1)
    return model.frf(f), f


def _lines(
    H: Array,
    h: Array,
    values: Array,
    noise: noises.LineNoise,
    data: Data,
    settings: PosingSettings,
    variance: Array | None = None,
) -> Posed:
    if data.missing.any():
        raise InputError("the path by lines takes no missing samples", where="record", found=data.gaps,
                         expected="complete channels", hint=Advice(AUTO, " and Tikhonov"))  # fmt: skip
    penalty = "identity" if settings.penalty.L is None else settings.penalty.L
    if not isinstance(penalty, str):
        raise InputError(
            "the path by lines takes a named penalty", where="penalty", found="a matrix",
            expected=f"one of {penalties.names()}",
        )  # fmt: skip
    used = H[:, data.rows]
    path = SpectralPath(
        used,
        values,
        noise.power,
        penalty=penalty,
        variance=variance,
        excess=noise.excess,
        truncated=settings.truncated,
        filled=data.filled,
    )
    full = None
    if len(data.rows) < H.shape[1]:
        scale = np.sqrt(np.mean(np.abs(H) ** 2, axis=(0, 2)))
        full = identifiability.layout(np.linalg.svd(H / scale[:, None], compute_uv=False).ravel(), len(H) * H.shape[2])

    def predict(g: Array) -> Array:
        G = np.fft.rfft(g, path.padded, axis=0)
        return np.fft.irfft(np.einsum("ksl,kl->ks", used, G), path.padded, axis=0)[: len(values)]

    kappa, _, _ = identifiability.layout(path.c, path.unknowns)
    layout = kappa, path.rank, max(path.unknowns - path.rank, 0)
    compare = by_prediction(values, predict)
    return Posed(path, noise.noise, compare, values, PADDED, h[:, data.rows], layout, full, path.unknowns, path,
                 spectrum=Spectrum.of(path, data.filled))  # fmt: skip


def _measured_noise(
    model: Model, data: Data, settings: PosingSettings, H: Array, spectrum: Array | None
) -> noises.LineNoise:
    """Noise of each line: of the user, of the training hits, of the roughness of one short load, or of the record."""
    samples = len(data.values)
    if not settings.noise.stated and spectrum is not None:
        hits = sum(h.used for h in model.hits)
        said = f"residual power of {hits} training hits, averaged over neighbouring lines"
        return noises.LineNoise(samples * spectrum[:, data.rows], None, NoiseSource("residual", said))
    if not settings.noise.stated and model.training and H.shape[2] == 1 and np.mean(H == 0) < SILENT:
        own = np.where(H[..., 0] == 0, np.max(np.abs(H)), H[..., 0])  # a silent line tells nothing: no roughness there
        size = np.abs(own) ** 2
        told = roughness(np.fft.rfft(data.values, 2 * (len(H) - 1), axis=0) / own)
        if np.median(np.min(told.relative, axis=1)) <= ROUGH:
            excess = np.maximum(told.local - told.typical, 0.0) * size
            source = NoiseSource("residual", "roughness of the load spectrum that each sensor gives alone")
            return noises.LineNoise(told.typical * size, excess, source)
    noise = noises.resolve(settings.noise, model, data)
    return noises.white(noise, samples, len(H))
