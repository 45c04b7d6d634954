"""Loads in windows of time, every way to ask for them: the dense reference without the other columns, or a refusal."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from loadid import Deconvolution, InputError, LoadEstimate, SparseDeconvolution
from loadid._spellings import folded

from . import histories, reference
from .histories import DT, N

WINDOWS = {"one": (4 * DT, 19 * DT), "two": [(0.0, 5.4 * DT), (11 * DT, 20 * DT)], "all": (0.0, N * DT)}
PATHS = ("auto", "dense", "statespace", "toeplitz", "windows", "fft")
PENALTIES = ("identity", "first", "second", "matrix", "none")
OPTIONS = ((), ("gap",), ("covariance",), ("push",), ("unknown",), ("known",), ("some",), ("zoh",), ("size",),
           ("leak",), ("gap", "unknown", "push_one"))  # fmt: skip


def acting(name: str) -> np.ndarray:
    """Samples of a window, (N,)."""
    mask = np.zeros(N, bool)
    for begin, end in np.atleast_2d(WINDOWS[name]):
        mask[int(np.ceil(begin / DT - 1e-6)) : int(np.floor(end / DT + 1e-6)) + 1] = True
    return mask


def answered(kind: str, path: str, penalty: str, options: tuple[str, ...]) -> bool:
    """Whether a cell has an answer: by a matrix, or the identity over states."""
    has = set(options)
    by_matrix = not has & {"gap", "push", "push_one", "unknown", "known", "leak"}
    over_states = kind == "states" and penalty == "identity" and not has & {"size", "leak"}
    if kind == "measured":
        return path == "auto" and by_matrix and not has & {"covariance", "size"}
    if path == "dense":
        return by_matrix and not ("size" in has and penalty in ("matrix", "none"))
    if path == "statespace":
        return over_states
    return path == "auto" and ((by_matrix and not ("size" in has and penalty in ("matrix", "none"))) or over_states)


def cells() -> Any:
    """Paths and penalties in full, options with one of each kind of model."""
    yield from product(("states", "impulses", "measured"), PATHS, PENALTIES, ((),), ("one",))
    for cell in product(("states", "impulses"), ("auto",), ("identity", "first"), OPTIONS[1:], ("one",)):
        if cell[0] == "states" or cell[3] != ("zoh",):  # an impulse response has a hold of its own
            yield cell
    yield from product(("states",), ("auto", "statespace"), ("identity", "second"), ((), ("gap",)), ("two", "all"))


@pytest.mark.parametrize(("kind", "path", "penalty", "options", "window"), list(cells()), ids=str)
def test_histories(kind: str, path: str, penalty: str, options: tuple[str, ...], window: str) -> None:
    given, y = histories.settings(kind, penalty, options)
    choice = None if penalty == "none" else histories.LAM
    said = folded(Deconvolution, {**given, "path": path, "choice": choice, "support": WINDOWS[window]})
    if answered(kind, path, penalty, options):
        estimate = Deconvolution(histories.model(kind), **said).estimate(y, dt=DT)
        check(estimate, kind, penalty, options, window)
        return
    with pytest.raises(InputError) as caught:
        Deconvolution(histories.model(kind), **said).estimate(y, dt=DT)
    assert caught.value.where in ("support", "initial", "size", "leak", "penalty", "record", "lambda", "noise")


def check(estimate: LoadEstimate, kind: str, penalty: str, options: tuple[str, ...], window: str) -> None:
    """Load and std of a window are those of the columns that are left; outside there is nothing."""
    mask = acting(window)
    columns = np.repeat(mask, 2)
    assert np.all(estimate.load[~mask] == 0)
    assert np.all(estimate.posterior.std[~mask] == 0)
    whole = histories.problem(kind, False, penalty, options)
    spare = np.ones(whole.spare, bool)
    known = replace(whole, H=whole.H[:, np.r_[columns, spare]], L=whole.L[:, columns])
    lam = 0.0 if penalty == "none" else estimate.choice.lam * estimate.choice.scale
    found = estimate.load[mask]
    if {"push", "push_one"} & set(options):
        pushing = np.tile([True, "push" in options], int(mask.sum()))
        reference.assert_minimal(found, known, lam, pushing, slack=1e-6)
        return
    assert kind == "measured" or len(known.y) == estimate.facts.m
    if kind != "measured":  # whose noise and errors are made white in time first
        reference.assert_agrees(found, known, lam)
        A, _ = known.stacked(lam)
        covariance = np.linalg.inv(A.T @ A)
        std = estimate.facts.noise_level * np.sqrt(np.diag(covariance))[: columns.sum()]
        np.testing.assert_allclose(estimate.posterior.std[mask].ravel(), std, rtol=1e-6)
        w = np.random.default_rng(0).standard_normal(estimate.load.shape)
        inside = w[mask].ravel()
        variance = estimate.facts.noise_level**2 * inside @ covariance[: len(inside), : len(inside)] @ inside
        assert estimate.posterior.variance(w) == pytest.approx(variance, rel=1e-6)


def test_behind_measured_frfs_of_white_noise() -> None:
    """Where noise is stated and white the reference holds there too."""
    given, y = histories.settings("measured", "first", ())
    e = Deconvolution(histories.model("measured"), choice=histories.LAM, support=WINDOWS["one"], **given).estimate(
        y, DT
    )
    mask = acting("one")
    whole = histories.problem("measured", False, "first", ())
    columns = np.repeat(mask, 2)
    known = replace(whole, H=whole.H[:, columns], L=whole.L[:, columns])
    reference.assert_agrees(e.load[mask], known, e.choice.lam * e.choice.scale)


@pytest.mark.parametrize("dictionary", ["dirac", "bspline", "wavelet", "matrix"])
def test_waveforms_that_reach_beyond_are_left_out(dictionary: str) -> None:
    from . import test_sparse

    h, y, noise = test_sparse.data("")
    family = SparseDeconvolution(
        histories.model("impulses"), dictionary=test_sparse.DICTIONARIES[dictionary], choice=0.05, noise=noise,
        support=WINDOWS["two"],
    )  # fmt: skip
    if dictionary == "matrix":  # its waveforms have no end
        with pytest.raises(InputError) as caught:
            family.estimate(y, DT)
        assert caught.value.where == "support"
        return
    e = family.estimate(y, DT)
    mask = acting("two")
    assert np.any(e.load[mask])
    assert np.all(e.load[~mask] == 0)
    assert np.all(e.std[~mask] == 0)
    if dictionary == "dirac":  # what the l1 penalty says of every column that is left, amplitudes by least squares
        H, data = reference.whitened(reference.convolution(h), y, noise)
        A = H[:, np.repeat(mask, 2)]
        x = e.load[mask].ravel()
        used = x != 0
        np.testing.assert_allclose(x[used], reference.solved(A[:, used], data), rtol=1e-7)


@pytest.mark.parametrize(
    "given", [(0.2, 0.1), (0.1,), "soon", (0.1, np.nan), (50.0, 60.0), [[0.0, 0.1, 0.2]], (-2.0, -1.0)]
)
def test_what_is_no_window(given: Any) -> None:
    y, noise = histories.record("states")
    with pytest.raises(InputError) as caught:
        Deconvolution(histories.model("states"), support=given, noise=noise).estimate(y, DT)
    assert caught.value.where == "support"


def test_windows_that_overlap_are_one() -> None:
    y, noise = histories.record("states")
    one, two = (
        Deconvolution(histories.model("states"), choice=0.01, support=w, noise=noise).estimate(y, DT)
        for w in ((3 * DT, 12 * DT), [(8 * DT, 12 * DT), (3 * DT, 9 * DT)])
    )
    np.testing.assert_array_equal(one.load, two.load)
    assert two.provenance["settings"]["support"] == [[3 * DT, 12 * DT]]


def test_the_band_of_errors_of_the_model_stays_inside(tmp_path: Any) -> None:
    """With nothing asked for by name the band holds errors of the model; it travels through a file."""
    y, noise = histories.record("states")
    e = Deconvolution(histories.model("states"), support=WINDOWS["one"], noise=noise).estimate(y, DT)
    mask = acting("one")
    assert e.facts["variance"] == "constant"
    assert "model_errors" in e.facts
    assert np.all(e.posterior.std[~mask] == 0)
    assert np.all(e.posterior.std[mask] > 0)
    e.save(tmp_path / "r.h5")
    back = LoadEstimate.read(tmp_path / "r.h5")
    np.testing.assert_array_equal(back.posterior.std, e.posterior.std)
