"""Loads on frequency lines, from spectra, cross spectra or records, with what every line can tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._flags import Flag
from structures._model import Model, as_model
from structures._testing.welch import CrossSpectra
from structures.errors import InputError, NotIdentifiable, positive

from .. import _guards as guards
from .._guards import families as told
from .._guards import vibration as spectral
from .._inverse.choice import named
from .._inverse.discrepancy import FLOOR, Discrepancy
from .._inverse.noise_level import CLEARLY
from .._inverse.posterior import SpectralPosterior
from .._results.estimate import Axis, LoadEstimate
from .._results.facts import Facts
from .._results.functionals import LEVEL, LoadSpectrum, nearest_zeros
from .._spellings import Progress, takes
from ..settings import ChoiceLike, Guards, Lambda, Noise, Signal
from . import detection
from .answer import SolvedLoad, answer, of_lines, over_time
from .data import rows_of
from .posing.fitting import LineFit, LineRule, fit, judged
from .posing.gathered import BandPart, LineData, LineSettings, lines_of, response

Array = NDArray[Any]

BESIDE = 16  # samples around a load that stands out, to which what is missing of it belongs
MINOR = 0.05  # share of the response's power below which a load is none of a line's
CLEAR = 5.0  # standard deviations by which a load stands out of a transient


class FrequencyInversion:
    """Loads line by line, ``Y = H(f) G``, each line with the variances that its neighbours show.

    The default regularisation is the evidence of neighbouring lines: loads and noise are as large as around each line
    (`loadid._inverse.spectral`), which is truncation-free, independent of units, and lets an inactive load
    vanish. Rules (GCV, L-curve, discrepancy ...) choose a lambda for each line, for neighbours or for all lines;
    truncated SVD goes by threshold, count or rule. Every line says what it can tell without any prior: an antiresonance
    is flagged (W507), never filled in silently.

    Parameters
    ----------
    model : Model
        Anything that gives ``frf``; a variance of its FRFs (``frf_variance``) enters the weights and the band. Where it
        states none, errors of the FRF are learned from the lines (`loadid._inverse.discrepancy`), unless
        ``noise=Noise(frf=...)`` states them; of transients the FRF is taken for exact.
    choice : str, callable, float, None or Lambda
        Rule by name or itself (`loadid.register_rule`), relative lambda (Tikhonov) or threshold (truncated SVD), 0 for
        least squares; None is the evidence of the neighbouring lines (truncated SVD: GCV over them). Who decides, the
        method, and how large the loads are expected to be: `loadid.Lambda`.
    level : float
        Predicted relative std above which a line is flagged.
    signal : {"stationary", "transient"} or Signal, optional
        What a time record is: averaged into cross spectra, or transformed once, zero-padded, into a load history; with
        the segments that are averaged: `loadid.Signal`.
    band : (float, float), optional
        Lines that are inverted (Hz). A transient behind a sampled model needs all of them; behind a table of FRFs
        (`structures.FrfModel`) its history comes out in the band of the table or in this part of it, tapered at the
        ends: ``facts.history_band`` and ``facts.history_ends`` say where, and what of the record lies outside.
    noise : float, array or Noise, optional
        Noise std of the sensors: of the amplitudes for spectra, of the samples for records, the root of the density
        (unit/sqrt(Hz)) for cross spectra. In the order of the model, or of `sensors` and then `validation`.
    sensors, validation : sequence of str or int, optional
        Sensors to invert, default all; sensors that are kept out and predicted.
    allow, progress
        As in `Deconvolution`.

    Raises
    ------
    InputError
        Settings that do not fit.

    Notes
    -----
    Thite & Thompson, J. Sound Vib. 264 (2003) 411, for inversion of FRF matrices and its errors.
    """

    name = "frequency inversion"

    @takes(
        choice=(Lambda, "method over neighbours count size"),
        signal=(Signal, "window segment overlap"),
        noise=(Noise, "source frf"),
        allow=(Guards, "coverage"),
    )
    def __init__(
        self,
        model: Model,
        *,
        choice: ChoiceLike = None,
        level: float = LEVEL,
        signal: str | Signal | None = None,
        band: tuple[float, float] | None = None,
        noise: ArrayLike | Noise | None = None,
        sensors: Sequence[str | int] | None = None,
        validation: Sequence[str | int] = (),
        allow: Sequence[str] | Guards = (),
        progress: Callable[[float, str], None] | None = None,
    ) -> None:
        self.model = as_model(model, "FrequencyInversion", "frf", "impulse_response")
        self.level = positive("level", level, where="level")
        self.rule = LineRule(**vars(Lambda.of(choice)))
        self.held = rows_of(validation, model) if len(validation) else np.zeros(0, int)
        chosen = rows_of(sensors, model)
        self.rows = chosen if sensors is not None else np.setdiff1d(chosen, self.held)
        if not len(self.rows) or set(self.rows) & set(self.held):
            raise InputError("a sensor cannot train and validate", where="validation",
                             found=[model.sensors[i].label for i in self.held], expected="other sensors for training",
                             hint="leave sensors= out: all others train")  # fmt: skip
        known = Noise.of(noise)
        if sensors is None:
            known = replace(known, std=_in_order(known.std, np.concatenate([self.rows, self.held])))
        self.settings = LineSettings(known, Signal.of(signal), band)
        told_of = Guards.of(allow)
        self.allow, self.coverage = told_of.codes, told_of.coverage
        self._progress = Progress(progress)

    def estimate(self, found: Any, dt: float | None = None) -> LoadEstimate:
        """Rebuild the loads behind spectra, cross spectra or a record.

        Parameters
        ----------
        found : Spectra, CrossSpectra, Record, list of Record, or array (samples, sensors)
            Several records are averaged.
        dt : float, optional
            Step in s of a bare array.

        Returns
        -------
        LoadEstimate
            Complex amplitudes (lines, loads) with std ``sqrt(E|error|^2)``; of cross spectra the autospectra of the
            loads (unit^2/Hz), their matrix in ``estimate.spectrum.cross``; of a transient the history (samples, loads).
            ``estimate.spectrum`` holds what each line tells, ``estimate.trust(level)`` the lines to believe.

        Raises
        ------
        InputError
            Spectra or records that do not fit the model.
        NotIdentifiable
            With choice 0, where a line does not determine the loads (LID-E306).
        """
        alone = self._autospectra_alone(found)
        self._progress(0.05, "making the lines")
        everything = lines_of(found, dt, self.model, np.concatenate([self.rows, self.held]), self.settings)
        count = len(self.rows)
        line, kept_out = everything.part(slice(None, count)), everything.part(slice(count, None))
        H = response(self.model, line)
        variance = _variance(self.model, line, H, self.settings.noise.frf)
        self._progress(0.2, "solving the lines")
        solved = fit(
            H[:, line.rows], line.X, line.power, known=line.known, rule=_spread(self.rule, line), variance=variance,
            frequencies=line.frequencies if self.settings.noise.frf is None and line.data is None else None,
            averages=line.averages * line.fullness,
            progress=lambda s: self._progress(0.2 + 0.6 * s, "solving the lines"),
        )  # fmt: skip
        self._refuse_undetermined(solved)
        self._progress(0.85, "asking other rules")
        choice = judged(solved, self.rule, line.known, line.source)
        spectrum = _spectrum(solved, line, self.level)
        answered = _ANSWERS[line.kind](solved, line, H, spectrum)
        excess = float(np.sqrt(solved.unexplained))
        held = _held_out(solved, answered.spectrum.cross, kept_out, H)
        found = replace(answered, facts=self._facts(solved, line, held, spectrum, H[:, line.rows]),
                        excess=excess if excess > CLEARLY else None,
                        not_told=detection.of_lines(H[:, line.rows], line, self.model.loads,
                                                            answered.unit))  # fmt: skip
        self._progress(1.0, "done")
        return answer(
            self, line, found, choice, known=line.known, settings=self._named_settings(line), prior=self._prior(),
            flags=[*self._flags(solved, line, H[:, line.rows], found), alone], spare=of_lines(line, H[:, line.rows]),
        )  # fmt: skip

    # -- saying -----------------------------------------------------------------------------------------------------
    def _autospectra_alone(self, found: Any) -> Flag | None:
        """E221: a matrix of cross spectra of which only the diagonal was given, and more than one sensor is used."""
        if not isinstance(found, CrossSpectra) or len(self.rows) == 1 or spectral.coupled(found.matrix):
            return None
        count = len(found.channels)
        if "LID-E221" in self.allow:
            return spectral.alone(count)
        raise InputError("autospectra alone are no matrix of cross spectra", where="estimate",
                         found=f"no cross spectrum between any two of {count} channels",
                         expected="how the channels move together",
                         hint="loadid.vibration.by_buzz or by_coherence fill the cross spectra; find_drives takes "
                         "autospectra alone", code="LID-E221")  # fmt: skip

    def _refuse_undetermined(self, solved: LineFit) -> None:
        lost = int(np.sum(np.any(solved.identifiable.gain == 0, axis=1)))
        if self.rule.free and lost and "LID-E306" not in self.allow:
            raise NotIdentifiable(
                f"without regularisation {lost} of {len(solved.lam)} lines do not determine the loads",
                advice="add sensors, leave these lines out (band=), or leave choice= out", code="LID-E306",
            )  # fmt: skip

    def _prior(self) -> str:
        rule = self.rule
        if rule.free:
            return "none"
        if rule.pooled:
            return f"loads as large as on the {rule.neighbours} lines to either side (complex normal, by evidence)"
        if rule.method == "tsvd":
            return "truncated SVD of each line"
        return "loads of equal expected size on a line (Tikhonov, L = I)"

    def _named_settings(self, line: LineData) -> dict[str, Any]:
        rule, s = self.rule, self.settings
        return {
            "method": rule.method, "choice": named(rule.choice), "over": rule.over, "neighbours": rule.neighbours,
            "count": rule.count, "level": self.level, "kind": line.kind, "signal": s.signal.kind,
            "band": None if s.band is None else list(s.band), "window": s.signal.window, "segment": s.signal.segment,
            "overlap": s.signal.overlap, "noise_source": line.source.text,
            "validation": [self.model.sensors[i].label for i in self.held],
        }  # fmt: skip

    def _facts(
        self, solved: LineFit, line: LineData, held: dict[str, float], spectrum: LoadSpectrum, H: NDArray[Any]
    ) -> Facts:
        unknowns = solved.identifiable.gain.size
        some = np.isfinite(solved.identifiable.condition)
        rank = int(np.sum(solved.path.c > 0))
        level = float(np.sqrt(np.median(solved.noise)))
        source = self._frf_source(solved, spectrum.load.shape[1])
        errors = "none stated"
        if solved.discrepancy is not None:
            errors = _learned(solved.discrepancy, solved.path.m - spectrum.load.shape[1])
        elif solved.errors is not None:
            errors = f"{float(np.sqrt(np.median(solved.errors / solved.total))):.2g} of the noise"
        more: dict[str, Any] = dict(line.facts or {})
        if held:
            more["held_out"] = tuple(f"{name} {error:.2%}" for name, error in held.items())
        return Facts(
            path=_PATHS[line.kind], m=int(solved.path.m * len(solved.lam)), n=unknowns, rank=rank,
            nullity=unknowns - rank, edf=float(np.sum(solved.edf)),
            kappa=float(np.median(solved.identifiable.condition[some])) if some.any() else float("inf"),
            residual_to_noise=level if line.known else None, noise_level=level,
            **line.source.facts, trusted_lines=_told(spectrum, H), trust_level=self.level,
            untold_power=spectrum.untold_power,
            frf_errors=errors, frf_source=source, **more,
        )  # fmt: skip

    def _frf_source(self, solved: LineFit, loads: int) -> str:
        """Where the size of the errors of the FRF comes from."""
        if solved.discrepancy is not None:
            if solved.discrepancy.by_floor:
                return "floor"
            return "spare sensors" if solved.path.m > loads else "loads of smooth size"
        if self.settings.noise.frf is not None:
            return "stated"
        if solved.errors is None:
            return "taken for exact"
        return "the model's variance"

    def _flags(self, solved: LineFit, line: LineData, H: NDArray[Any], found: SolvedLoad) -> list[Flag | None]:
        labels, facts, spectrum = tuple(c.label for c in self.model.loads), found.facts, found.spectrum
        allowed = "LID-E306" in self.allow and self.rule.free and np.any(solved.identifiable.gain == 0)
        size = np.sqrt(np.mean(np.abs(solved.path.beta) ** 2, axis=1) + solved.path.outside / solved.path.m)
        strength = size / np.sqrt(solved.noise)
        return [
            guards.overridden("E306", "rank", facts["rank"], facts["n"]) if allowed else None,
            guards.null_space(facts["m"], facts["n"], facts["rank"]),
            told.contradicted(solved.excess, line.source) if line.known else None,
            told.no_spare_data(line.known, solved.path.m - spectrum.load.shape[1]),
            told.frf_by_floor(facts["frf_source"] == "floor", solved.frf_part, spectrum),
            told.antiresonance(spectrum, labels),
            told.inseparable(spectrum, H / np.sqrt(solved.total)[..., None], strength, labels),
            None if line.data is None else told.leaking(line.data.values, np.asarray(found.residual)),
            told.too_coarse(line.facts["bandwidth"], self.model.decay_rate)
            if line.facts is not None and "bandwidth" in line.facts
            else None,
        ]


# -- answers of the three kinds of data -------------------------------------------------------------------------------
_PATHS = {
    "spectra": "frequency lines",
    "cross spectra": "cross-spectral lines",
    "transient": "lines of the zero-padded record",
}


def _of_spectra(solved: LineFit, line: LineData, H: NDArray[Any], spectrum: LoadSpectrum) -> SolvedLoad:
    load, X = solved.load[..., 0], line.X[..., 0]
    rest = X - np.einsum("ksl,kl->ks", H[:, line.rows], load)
    axis = Axis("frequency", "Hz", line.frequencies)
    return SolvedLoad(load=load, std=np.sqrt(solved.variance), axis=axis, response=X, residual=rest, facts=Facts(),
                          spectrum=spectrum)  # fmt: skip


def _of_cross(solved: LineFit, line: LineData, H: NDArray[Any], spectrum: LoadSpectrum) -> SolvedLoad:
    """Mean of the loads' spectra given the data: that of the estimates, and what the data leave open of each.

    Averages reduce the chance of loads and noise, not what errors of the FRF and the prior leave open.
    """
    g = solved.load
    S = g @ g.conj().swapaxes(1, 2) + solved.missing
    power = np.maximum(np.einsum("kjj->kj", S).real, 0.0)
    lost = np.minimum(solved.frf_part + solved.prior_part, solved.variance)
    chance = (power + solved.variance - lost) ** 2 / line.averages
    used = H[:, line.rows]
    X2 = np.einsum("ksn,ksn->ks", line.X.conj(), line.X).real
    made = np.einsum("ksi,kij,ksj->ks", used, S, used.conj()).real
    return SolvedLoad(
        load=power, std=np.sqrt(chance + 2 * power * lost + lost**2), axis=Axis("frequency", "Hz", line.frequencies),
        response=X2, residual=X2 - made, facts=Facts(), spectrum=replace(spectrum, cross=S), unit="({})^2/Hz",
    )  # fmt: skip


def _of_transient(solved: LineFit, line: LineData, H: NDArray[Any], spectrum: LoadSpectrum) -> SolvedLoad:
    assert line.data is not None
    samples = len(line.data.values)
    if line.part_of is not None:
        return _of_band(solved, line, line.part_of, H, spectrum)
    history = np.fft.irfft(solved.load[..., 0], line.padded, axis=0)[:samples]
    held = np.fft.rfft(history, line.padded, axis=0)
    made = np.fft.irfft(np.einsum("ksl,kl->ks", H[:, line.rows], held), line.padded, axis=0)[:samples]
    known = SpectralPosterior(solved.covariance, samples, line.padded)
    return SolvedLoad(
        load=history, std=known.std, bias=_hidden(solved.blind, history, known.std, line.padded), posterior=known,
        axis=over_time(samples, line.data.dt), response=line.data.values, residual=line.data.values - made,
        facts=Facts(), spectrum=spectrum,
    )  # fmt: skip


def _of_band(
    solved: LineFit, line: LineData, part: BandPart, H: NDArray[Any], spectrum: LoadSpectrum
) -> SolvedLoad:  # fmt: skip
    """A history of the band that a table of FRFs covers: load, band, response and residual are of these lines alone."""
    assert line.data is not None
    samples, padded, G = len(line.data.values), line.padded, solved.load[..., 0]
    history, seen = part.history(G, padded, samples), part.history(line.X[..., 0], padded, samples)
    made = part.history(np.einsum("ksl,kl->ks", H[:, line.rows], G), padded, samples)
    known = SpectralPosterior(part.whole(solved.covariance, padded, power=2), samples, padded)
    std = known.std
    return SolvedLoad(
        load=history, std=std, bias=_hidden(part.whole(solved.blind, padded), history, std, padded), posterior=known,
        axis=over_time(samples, line.data.dt), response=seen, residual=seen - made, facts=Facts(), spectrum=spectrum,
    )  # fmt: skip


_ANSWERS: dict[str, Callable[[LineFit, LineData, NDArray[Any], LoadSpectrum], SolvedLoad]] = {
    "spectra": _of_spectra,
    "cross spectra": _of_cross,
    "transient": _of_transient,
}


# -- helpers ----------------------------------------------------------------------------------------------------------
def _hidden(blind: NDArray[Any], history: Array, std: Array, padded: int) -> NDArray[np.float64]:
    """What is expected to be missing from a transient, (samples, loads).

    The posterior takes lines for independent and spreads what they do not tell evenly over the record. Of a pulse all
    lines agree in phase: the same is missing at the pulse. So regularisation is asked what it takes from the load that
    stands out.
    """
    from scipy.ndimage import maximum_filter1d, uniform_filter1d

    size = np.sqrt(uniform_filter1d(history**2, 5, axis=0))
    clear = np.where(size > CLEAR * std, history, 0.0)
    spectrum = np.fft.rfft(clear, padded, axis=0)
    missing = np.fft.irfft(np.einsum("kij,kj->ki", blind, spectrum), padded, axis=0)[: len(history)]
    # far from the pulses what rings on is no bias of this load
    beside = np.asarray(maximum_filter1d(clear != 0, 2 * BESIDE + 1, axis=0))
    return np.where(beside, missing, 0.0)


def _told(spectrum: LoadSpectrum, H: NDArray[Any]) -> float:
    """Share of the lines that tell every load which makes more than a small part of the response there."""
    made = np.sum(np.abs(H) ** 2, axis=1) * spectrum.expected**2
    matters = made > MINOR * np.sum(made, axis=1, keepdims=True)
    return float(np.mean(np.all(spectrum.trust() | ~matters, axis=1) & matters.any(axis=1)))


def _learned(found: Discrepancy, spare: float) -> str:
    """How large errors of the FRF are, and who says so."""
    source = f"learned from {spare:.0f} spare sensor{'s' * (spare > 1)}"
    if spare <= 0:
        source = f"no spare sensor shows them: {FLOOR:.0%} of an entry unless the lines speak against it"
    return f"{found.entry:.2g} of an entry, {np.sqrt(found.sizes[2]):.2g} of the frequencies ({source})"


def _in_order(noise: ArrayLike | None, rows: Array) -> ArrayLike | None:
    """Noise of all sensors of the model in the order in which they are used."""
    return np.asarray(noise)[rows] if noise is not None and np.shape(noise) == rows.shape else noise


def _spread(rule: LineRule, line: LineData) -> LineRule:
    """Neighbours are counted in lines of the record: a padded transform has more, which repeat each other."""
    return replace(rule, neighbours=round(rule.neighbours / line.fullness))


def _variance(model: Model, line: LineData, H: NDArray[Any], stated: float | None) -> NDArray[np.float64] | None:
    """Of the FRF, where the user or the model states one."""
    if stated is not None:
        return stated**2 * np.abs(H[:, line.rows]) ** 2 if stated else None
    found = model.frf_variance(line.frequencies)
    return None if found is None or not np.any(found) else found[:, line.rows]


def _spectrum(solved: LineFit, line: LineData, level: float) -> LoadSpectrum:
    g = solved.load
    mean = g[..., 0] if g.shape[2] == 1 else np.sqrt(np.einsum("kjn,kjn->kj", g.conj(), g).real + solved.variance)
    naive = solved.identifiable.naive
    plain = naive[..., 0] if naive.shape[2] == 1 else np.sqrt(np.einsum("kjn,kjn->kj", naive.conj(), naive).real)
    gain = solved.identifiable.gain
    return LoadSpectrum(
        frequencies=line.frequencies,
        load=mean,
        std=np.sqrt(solved.variance),
        covariance=solved.covariance,
        naive=plain,
        naive_std=solved.naive_std,
        expected=solved.expected,
        gain=gain,
        condition=solved.identifiable.condition,
        zeros=nearest_zeros(line.frequencies, gain),
        lam=solved.lam,
        noise=np.sqrt(solved.noise),
        level=level,
    )


def _held_out(solved: LineFit, cross: NDArray[Any] | None, line: LineData, H: NDArray[Any]) -> dict[str, float]:
    """Relative error of the predicted response of each sensor that was kept out."""
    if not len(line.rows):
        return {}
    used = H[:, line.rows]
    if cross is not None:
        made = np.einsum("ksi,kij,ksj->ks", used, cross, used.conj()).real
        measured = np.einsum("ksn,ksn->ks", line.X.conj(), line.X).real
        error = np.sum(np.abs(measured - made), axis=0) / np.sum(measured, axis=0)
    else:
        measured = line.X[..., 0]
        made = np.einsum("ksl,kl->ks", used, solved.load[..., 0])
        error = np.linalg.norm(measured - made, axis=0) / np.maximum(np.linalg.norm(measured, axis=0), 1e-300)
    return {c.label: float(e) for c, e in zip(line.channels, error, strict=True)}
