"""Loads about the contacts of a frame: their evidence against dense covariances, and presses on another mesh."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from case_studies.bodies import Patch, surfaces
from structures._threads import threads
from tactile import ContactLaw, Markers, MultilayerPad, Pad, Tolerances
from tactile._sensors.discs import OWN, Disc
from tactile._sensors.evidence import SIZES, Fitted
from tactile._sensors.local import CELL, SPREAD, TEMPERED, ContactFit, LocalLoad, _reach
from tactile._sensors.looks import LARGE, LOOKED, SEVERAL, FirstLook
from tactile._sensors.search import score

E, NU, SIZE, THICK, NOISE = 147e3, 0.45, (14e-3, 12e-3), 3e-3, 3e-6


def markers() -> np.ndarray:
    x, y = (np.arange(-s / 2 + 0.7e-3, s / 2 - 0.5e-3, 1e-3) for s in SIZE)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


@lru_cache(maxsize=1)
def sensor() -> MultilayerPad:
    return MultilayerPad(Pad(size=SIZE, thickness=THICK, E=E, nu=NU), Markers(markers(), NOISE, "XY"), choice=0.03)


@lru_cache(maxsize=1)
def fit() -> ContactFit:
    found = sensor()._contacts(with_depth=True)
    assert found is not None
    return found


def pressed() -> tuple[np.ndarray, np.ndarray]:
    """Motion (N, 2) under a flat press with shear on another mesh, and its force."""
    patch = Patch("flat", (0.9e-3, -0.6e-3), (1.4e-3, 0.0), 0.0, (0.03, -0.02, -0.15))
    moved = surfaces([(patch,)], "fe", SIZE, THICK, NU)[0](markers())[:, :2] / E
    return moved + NOISE * np.random.default_rng(5).standard_normal(moved.shape), np.array(patch.force)


def test_a_sensor_that_is_prepared_builds_nothing_in_its_first_frame() -> None:
    s = sensor()
    s._quick.clear()
    s.prepare()
    band = s.inverse.band
    built = set(vars(band))
    s.follow(NOISE * np.random.default_rng(3).standard_normal((len(markers()), 2)))
    assert set(vars(band)) == built
    assert {"_alike", "_rows", "_noisy"} <= built


def test_the_evidence_is_that_of_a_dense_covariance() -> None:
    f, discs = fit(), (Disc(1, -1, 3), Disc(-4, 2, 1))
    at = np.array([8.0, 0.2, -0.1, 7.0, -0.3, 0.05])
    z = np.random.default_rng(0).standard_normal(len(f.moved))
    S = np.eye(len(z)) + f.moved @ f.moved.T
    for disc, (size, u, v) in zip(discs, at.reshape(2, 3), strict=True):
        w = f.window(disc)
        q, share = w.modes.shape[1], np.exp(2 * size) * (np.outer((u, v, 1), (u, v, 1)) + OWN**2 * np.diag((1, 1, 0)))
        for first in range(0, w.columns.shape[1], 3 * q):
            A = w.columns[:, first : first + 3 * q]
            S += A @ np.kron(share, np.eye(q)) @ A.T
    dense = -0.5 * z @ np.linalg.solve(S, z) - 0.5 * np.linalg.slogdet(S)[1]
    ratios = at.reshape(2, 3)[:, 1:]
    model, square = f.model(discs), float(z @ z)
    told = model.told(z)
    here = model.evidence(square, told, at)
    slope, curved = model.curved(here, exactly=True)
    assert np.isclose(here.value, dense - 0.5 * np.sum(ratios**2) / 0.35**2, rtol=1e-9)
    for k, step in enumerate(1e-4 * np.eye(6)):
        up, down = (model.evidence(square, told, at + sign * step) for sign in (1, -1))
        assert np.isclose(slope[k], (up.value - down.value) / 2e-4, rtol=1e-4, atol=1e-4)
        change = model.curved(up)[0] - model.curved(down)[0]
        assert np.allclose(curved[k], change / 2e-4, rtol=1e-4, atol=1e-4)


def test_average_information_is_that_of_observed_and_expected_curvature() -> None:
    f, at, rng = fit(), np.array([8.0, 0.2, -0.1]), np.random.default_rng(3)
    model = f.model((Disc(1, -1, 3),))
    S = _spread(f, model, at[None])
    draws = rng.multivariate_normal(np.zeros(len(S)), S + np.eye(len(S)), size=400)
    here = [model.evidence(float(z @ z), model.told(z), at) for z in draws]
    found = [model.curved(one, exactly)[1] for one in here for exactly in (False, True)]
    average, exact = np.mean(found[::2], axis=0), np.mean(found[1::2], axis=0)
    assert np.allclose(average, exact, rtol=0.1, atol=0.05 * np.abs(exact).max())


def test_sizes_and_ratios_are_the_likeliest() -> None:
    f, z = fit(), pressed()[0].ravel() / NOISE
    model = f.model((Disc(2, -1, 4),))
    found = model.fitted(z, np.array([[9.0, -0.1, 0.1]]), turns=40)
    square, told = float(z @ z), model.told(z)
    other = minimize(lambda at: -model.evidence(square, told, at).value, [9.0, -0.1, 0.1], method="Nelder-Mead",
                     options={"xatol": 1e-6, "fatol": 1e-9, "maxiter": 2000})  # fmt: skip
    assert np.isclose(found.evidence, -other.fun, atol=1e-3)
    assert np.allclose(found.at.ravel(), other.x, atol=5e-3)
    assert np.allclose(model.left(z, found.at), z - _signal(f, model, z, found.at), atol=1e-6 * np.abs(z).max())


def _signal(f: ContactFit, model: Any, z: np.ndarray, at: np.ndarray) -> np.ndarray:
    """What the discs and the image explain of readings, by a dense covariance."""
    S = _spread(f, model, at)
    return np.asarray(S @ np.linalg.solve(S + np.eye(len(z)), z))


def _spread(f: ContactFit, model: Any, at: np.ndarray) -> np.ndarray:
    """Dense covariance of readings by the discs and the image, without noise."""
    S = f.moved @ f.moved.T
    for w, (size, u, v) in zip(model.windows, at, strict=True):
        share = np.exp(2 * size) * (np.outer((u, v, 1), (u, v, 1)) + OWN**2 * np.diag((1, 1, 0)))
        for A in np.split(w.columns, len(w.made), axis=1):
            S += A @ np.kron(share, np.eye(w.modes.shape[1])) @ A.T
    return S


def test_modes_of_a_disc_hold_the_pressures_of_the_prior_in_it() -> None:
    f, disc = fit(), Disc(2, -3, 3)
    window, (x, y) = f.window(disc), f.middle + THICK / 6 * np.array([2, -3])
    r = np.hypot(*(f.places[:, :2] - (x, y)).T)
    w = np.clip((0.25 * 1.25**3 * THICK + f.pitch / 2 - r) / f.pitch, 0, 1)
    C = w[:, None] * (f.problem.prior.matrix + 1.0) * w
    C = C[np.ix_(window.nodes, window.nodes)]
    assert np.array_equal(window.nodes, np.flatnonzero(w))
    assert np.allclose(np.sum(window.modes**2, axis=1) + window.finer, np.diag(C), rtol=1e-9)
    assert np.linalg.norm(window.modes @ window.modes.T - C) < 0.02 * np.linalg.norm(C)


def test_the_posterior_is_that_of_a_dense_covariance_with_the_tolerances_of_the_pad() -> None:
    pad = Pad(size=SIZE, thickness=THICK, E=E, nu=NU)
    loose = MultilayerPad(pad, Markers(markers(), NOISE, "XY"), tolerances=Tolerances(E=0.1, nu=0.02), choice=0.03)
    f, disc, at = loose._contacts(with_depth=True), Disc(1, -1, 3), np.array([[8.0, 0.2, -0.1]])
    assert f is not None
    w, (size, u, v) = f.window(disc), at[0]
    q, share = w.modes.shape[1], np.exp(2 * size) * (np.outer((u, v, 1), (u, v, 1)) + OWN**2 * np.diag((1, 1, 0)))
    spread = np.kron(share, np.eye(q))
    S = np.eye(2 * len(markers())) + f.moved @ f.moved.T
    for first in range(0, w.columns.shape[1], 3 * q):
        A = w.columns[:, first : first + 3 * q]
        S += A @ spread @ A.T
    L = np.zeros((len(f.places), 3, 3 * q))
    for a in range(3):
        L[w.nodes, a, a * q : (a + 1) * q] = w.modes
    L = L.reshape(-1, 3 * q)
    reach = L @ spread @ w.columns[:, : 3 * q].T
    errors = [e.change / f.problem.noise[:, None] for e in f.problem.errors() if not e.of_mesh]
    assert len(errors) == 2
    beside = (np.linalg.norm(f.places[:, None] - f.places, axis=2) <= 1.6 * f.pitch).astype(float)
    wider = np.kron(beside / beside.sum(axis=0) - np.eye(len(beside)), np.eye(3))  # nor what lies between nodes
    blurred, R, model, parts = SPREAD * f.problem.whitened @ wider, f.problem.resultant, f.model((disc,)), []
    rng = np.random.default_rng(5)
    right = w.columns[:, : 3 * q] @ np.linalg.cholesky(spread) @ rng.standard_normal(3 * q)
    right += rng.standard_normal(len(S))
    for z in (pressed()[0].ravel() / NOISE, right):
        plain = reach @ np.linalg.solve(S, z)
        made = [reach @ np.linalg.solve(S, change @ plain) for change in errors]  # one frame tells none of them
        first = blurred @ plain  # but how much there is of this
        own = 1 + first @ np.linalg.solve(S, first)
        parts.append(1 / own + (first @ np.linalg.solve(S, z) / own) ** 2)
        made.append(np.sqrt(min(1.0, parts[-1])) * reach @ np.linalg.solve(S, first))
        mean, _, wrench, _ = f._posterior(z, model.evidence(z @ z, model.told(z), at), model, f._laid(model))
        assert np.allclose(mean, plain, rtol=1e-7, atol=1e-7 * np.abs(plain).max())
        dense = R @ (L @ spread @ L.T - reach @ np.linalg.solve(S, reach.T) + sum(np.outer(m, m) for m in made)) @ R.T
        assert np.allclose(wrench, dense, rtol=1e-6, atol=1e-7 * np.abs(dense).max())
    assert parts[0] > 1 > 0.8 > parts[1]  # as much as was supposed at most


def test_in_plane_markers_tell_the_normal_force_of_a_press() -> None:
    y, force = pressed()
    found, quick = sensor().estimate(y), sensor().follow(y)
    told = found.resultant()
    assert np.all(np.abs(told.value - force) < 0.15 * 0.15)
    assert np.all(np.abs(told.value - force) < 3 * told.std)
    assert 2 * 1.96 * told.std[2] < 0.6 * 0.15 < quick.resultant().std[2] * 2 * 1.96
    assert "LID-W608" in {f.code for f in found.flags}


def test_a_map_in_the_plane_is_of_means_over_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    patch = Patch("round", (0.9e-3, -0.6e-3), (1.8e-3, 0.0), 0.0, (0.03, -0.02, -0.15))
    moved = surfaces([(patch,)], "fe", SIZE, THICK, NU)[0](markers())[:, :2] / E
    y = moved + NOISE * np.random.default_rng(5).standard_normal(moved.shape)
    found = sensor().estimate(y)
    with monkeypatch.context() as m:
        m.setattr(ContactFit, "cell_means", lambda self, load: load)
        values = sensor().estimate(y)
    assert np.allclose(found.load, fit().cell_means(values.load))
    assert np.allclose(found.resultant().value[:3], values.resultant().value[:3])
    assert np.array_equal(found.std, values.std)
    within = fit().pitch * (np.arange(-5.5, 6) / 12)
    cells = fit().places[:, None, :2] + np.stack(np.meshgrid(within, within), axis=-1).reshape(1, -1, 2)
    density = patch.density(cells.reshape(-1, 2)).reshape(len(cells), -1).mean(axis=1)
    true = density[:, None] * np.array(patch.force)
    off, before = (np.linalg.norm(a.load.reshape(-1, 3) - true) for a in (found, values))
    assert off < 0.9 * before


def test_readings_are_trusted_no_further_than_the_model() -> None:
    """A press five times as strong, on another mesh: what the model errs by is not read as loads."""
    f, (y, force) = fit(), pressed()
    strong = 5 * (y - NOISE * np.random.default_rng(5).standard_normal(y.shape))
    z = (strong + NOISE * np.random.default_rng(8).standard_normal(y.shape)).ravel() / NOISE
    wide = f.erring(z, 1.0)
    assert np.isclose(wide, np.hypot(1.0, 0.03 * np.abs(z).max()))
    assert f.erring(np.r_[z, np.nan], 1.0) == wide > 2
    patch = Patch("flat", (0.9e-3, -0.6e-3), (1.4e-3, 0.0), 0.0, tuple(force))
    true = 5 * np.outer(patch.density(f.places[:, :2]), force)
    plain, found = f(z), f(z, wide)
    assert plain is not None
    assert found is not None
    errors = [np.linalg.norm(a.load - true.ravel()) / np.linalg.norm(true) for a in (plain, found)]
    assert errors[1] < 0.85 * errors[0], errors
    assert found.wide == wide


def test_what_strays_would_change_is_in_the_band_where_they_may_be_a_small_contact(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    y, kept = pressed()[0].ravel(), pressed()[0].ravel()
    kept[8:10] = np.nan
    maps, local = sensor()._quick_map(True), fit()(y / NOISE)
    assert local is not None
    asked: list[float] = []

    def likelier(z: np.ndarray, wide: float, level: float) -> Any:
        asked.append(level)
        return replace(local, load=1.1 * local.load)

    made = 0.1 * (maps.inverse.resultant @ local.load)
    monkeypatch.setattr(maps, "contacts", likelier)
    assert np.allclose(maps._doubted(y, kept, local).wrench, local.wrench + np.outer(made, made))
    spike = y.copy()
    spike[8] = 10 * np.abs(y).max()
    maps._doubted(spike, kept, local)
    assert np.isclose(asked[0] - asked[1], 2 * np.log(10))  # a stray of so large a range is less likely to be there
    monkeypatch.setattr(maps, "contacts", lambda *_: None)
    assert maps._doubted(y, kept, local) is local


def test_discs_that_overlap_are_one_contact() -> None:
    f, at = fit(), np.zeros((2, 3))
    known = [Fitted((Disc(0, 0, 2),), at[:1], 10.0), Fitted((Disc(-2, 0, 2), Disc(2, 0, 2)), at, 18.0),
             Fitted((Disc(-6, 0, 1), Disc(6, 0, 1)), at, 17.0)]  # fmt: skip
    found = f._regions(known)
    weights = np.exp([2.0, 2.0, 1.0])
    assert found == pytest.approx({1: weights[:2].sum() / weights.sum(), 2: weights[2] / weights.sum()})


def test_a_contact_that_another_makes_needless_is_left_out() -> None:
    """The likeliest disc and a small one in it, as a search that began with the small one may end."""
    f, z = fit(), pressed()[0].ravel() / NOISE
    one = max(f.contacts(z), key=score)
    assert len(one.discs) == 1
    small = Disc(one.discs[0].x + 1, one.discs[0].y, 0)
    pair = f.model((small, *one.discs), z).fitted(z, np.vstack([[7.0, 0.1, 0.1], one.at]))
    assert score(pair) < score(one)
    left = f._fewer(z, pair, {})
    assert left.discs == one.discs
    assert score(left) >= score(one) - 1e-6
    assert f._fewer(z, one, {}) is one


def test_what_is_found_is_counted_once() -> None:
    found = fit().contacts(pressed()[0].ravel() / NOISE)
    assert len({f.discs for f in found}) == len(found)


def test_a_frame_at_rest_has_no_contact() -> None:
    rest = NOISE * np.random.default_rng(7).standard_normal((len(markers()), 2))
    assert fit()(rest.ravel() / NOISE) is None


def test_a_sensor_whose_image_is_known_to_be_fast_finds_contacts_too() -> None:
    y, force = pressed()
    pad = Pad(size=SIZE, thickness=THICK, E=E, nu=NU)
    found = MultilayerPad(pad, Markers(markers(), NOISE, "XY"), image=None, choice=0.03).estimate(y)
    assert np.all(np.abs(found.resultant().value - force) < 0.15 * 0.15)


def test_the_force_of_noisy_markers_is_that_of_a_grid_of_sizes_and_ratios() -> None:
    """A hundred markers at five times the noise: what size and ratios leave open is no small normal error."""
    f, (y, _) = fit(), pressed()
    z = y.ravel() / NOISE / 5 + 0.98 * np.random.default_rng(2).standard_normal(y.size)
    model = f.model((Disc(2, -1, 4),))
    best = model.fitted(z, np.array([[9.0, -0.1, 0.1]]), turns=40)
    square, told, R = float(z @ z), model.told(z), f.problem.resultant
    w, V = np.linalg.eigh(-model.curved(model.evidence(square, told, best.at), exactly=True)[1])
    line, logs, forces, spreads = np.linspace(-5, 5, 11), [], [], []
    for by in np.stack(np.meshgrid(line, line, line), axis=-1).reshape(-1, 3):
        at = best.at.ravel() + V @ (by / np.sqrt(w))
        here = model.evidence(square, told, at)
        if here.value < best.evidence - 12:
            continue
        mean, _, wrench, pull = f._posterior(z, here, model, f._laid(model))
        logs.append(here.value + pull)
        forces.append((R @ mean)[2])
        spreads.append(wrench[2, 2])
    p = np.exp(np.array(logs) - max(logs))
    p /= p.sum()
    middle = p @ np.array(forces)
    std = np.sqrt(p @ (np.array(spreads) + np.array(forces) ** 2) - middle**2)
    cases = f._cases(z, [best])
    weights, found = np.array([c[0] for c in cases]), np.array([(R @ c[1])[2] for c in cases])
    spread = np.sqrt(weights @ (found**2 + [c[3][2, 2] for c in cases]) - (weights @ found) ** 2)
    assert abs(weights @ found - middle) < 0.2 * std
    assert np.isclose(spread, std, rtol=0.2)
    means, stds = np.array([R @ c[1] for c in cases]), np.array([np.sqrt(np.diag(c[3])) for c in cases])
    assert 0.95 * spread < _reach(weights, means, stds)[2] < 2 * spread


def hidden_press() -> tuple[np.ndarray, np.ndarray]:
    """Motion (N, 2) under a press that is too light to be found, and its force."""
    y, force = pressed()
    light = 0.02 * (y - NOISE * np.random.default_rng(5).standard_normal(y.shape))
    return light + NOISE * np.random.default_rng(6).standard_normal(y.shape), 0.02 * force


def test_a_force_that_readings_hide_is_in_the_band_of_a_frame_without_contacts() -> None:
    """Where the press is too light to be found, the band holds forces of that order and the true one."""
    f, (frame, force) = fit(), hidden_press()
    z = frame.ravel() / NOISE
    unseen = f.undetected(z)
    assert f(z) is None
    std = np.sqrt(unseen.wrench[2, 2])
    assert abs(force[2]) < 2 * std < 0.2 * abs(pressed()[1][2])
    lost = f.undetected(np.where(np.arange(len(z)) < 6, np.nan, z))
    assert np.isclose(np.sqrt(lost.wrench[2, 2]), std, rtol=0.5)
    pad, law = sensor().pad, ContactLaw(no_pull=True)
    answer = sensor().estimate(frame)
    free = answer.resultant()
    assert answer.facts.path.endswith("no contact found")
    assert answer.contacts() == ()
    assert np.all(np.abs(free.value - force) < 2 * free.std)
    held = MultilayerPad(pad, Markers(markers(), NOISE, "XY"), contact=law, choice=0.03).estimate(frame).resultant()
    assert not held.value.any()
    assert np.all(held.std >= free.std)  # that a contact only presses tells nothing of one that is not seen
    assert np.all(held.std <= free.std + np.abs(free.value))


def test_a_press_that_nothing_shows_is_the_same_wherever_the_image_has_moved_to() -> None:
    """A shift and a turn of the image, which is an unknown, change no load that is not found."""
    frame = hidden_press()[0]
    turned = frame + np.array([40e-6, -25e-6]) + 2e-3 * np.column_stack([-markers()[:, 1], markers()[:, 0]])
    one, other = (sensor().estimate(seen) for seen in (frame, turned))
    assert any(f.code == "LID-W611" for f in other.flags)
    assert np.allclose(one.load, other.load, atol=1e-3 * one.std.max())
    assert np.allclose(one.std, other.std, rtol=1e-3)


def test_what_readings_do_not_show_is_the_average_over_discs_and_sizes_by_dense_covariances() -> None:
    """Weights, means and mean squares of loads in some discs of the first look, of every size."""
    f, z = fit(), hidden_press()[0].ravel() / NOISE
    R, P = f.problem.resultant, len(f.places)
    share, still = np.sqrt(f.problem.prior.share), np.eye(len(z)) + f.moved @ f.moved.T
    logs, means, seconds, forces, spreads, there = ([] for _ in range(6))  # type: ignore[var-annotated]
    for one in f.looks[:: len(f.looks) // 7]:
        nodes, modes, _ = f.modes(one.disc, LOOKED)
        columns = (3 * nodes[:, None] + np.arange(3)).ravel()
        B = np.einsum("kq,ab->kaqb", modes, np.diag(share)).reshape(3 * len(nodes), -1)
        A = f.problem.whitened[:, columns] @ B
        down = np.linalg.norm(R[2, columns] @ B)
        for size in SIZES:
            S = still + size**2 * A @ A.T
            mean = size**2 * A.T @ np.linalg.solve(S, z)
            spread = size**2 * np.eye(A.shape[1]) - size**4 * A.T @ np.linalg.solve(S, A)
            logs.append(-0.5 * z @ np.linalg.solve(S, z) - 0.5 * np.linalg.slogdet(S)[1] + LARGE * np.log(size * down))
            load, second, near = np.zeros(3 * P), np.zeros(3 * P), np.zeros(3 * P)
            load[columns], near[columns] = B @ mean, 1.0
            second[columns] = np.diag(B @ spread @ B.T) + (B @ mean) ** 2
            means.append(load)
            seconds.append(second)
            there.append(near)
            forces.append(R @ load)
            spreads.append(R[:, columns] @ B @ spread @ B.T @ R[:, columns].T)
    w = np.exp(np.array(logs) - max(logs))
    w /= w.sum()
    f = replace(f)
    f._made = fit()._made[:: len(fit().looks) // 7]
    found = FirstLook.undetected(f, z)
    mean, force, near = w @ np.array(means), w @ np.array(forces), w @ np.array(there)
    assert np.allclose(found.load, mean, atol=1e-6 * np.abs(mean).max())
    wrench = np.einsum("k,kij->ij", w, np.array(spreads) + np.einsum("ki,kj->kij", forces, forces))
    size = np.sqrt(np.diag(found.wrench))
    both = SEVERAL * (wrench - np.outer(force, force))
    assert np.allclose(found.wrench / np.outer(size, size), both / np.outer(size, size), atol=1e-6)
    own = near > 0
    about = (w @ np.array(seconds) - 2 * mean * (w @ np.array(means)))[own] / near[own] + mean[own] ** 2
    assert np.allclose(found.variance[own], about, rtol=1e-5, atol=1e-9 * about.max())


def test_loads_all_over_the_surface_are_no_contact_that_is_hidden() -> None:
    """An even push of the whole pad is read as it was: by loads anywhere."""
    s, nodes = sensor(), len(sensor().geometry["coordinates"])
    push = np.zeros((nodes, 3))
    push[:, 0] = 400.0 * np.cos(2 * np.pi * s.geometry["coordinates"][:, 0] / SIZE[0])
    y = s.model.H @ push.ravel() + NOISE * np.random.default_rng(2).standard_normal(len(s.model.H))
    assert s._quick_map(True)._everywhere(y, 1.0)
    assert not s._quick_map(True)._everywhere(hidden_press()[0].ravel(), 1.0)


def test_a_contact_that_only_presses_is_the_average_over_discs() -> None:
    f, z = fit(), pressed()[0].ravel() / NOISE
    local = f(z)
    assert local is not None
    assert len(local.likely) > 1
    assert np.isclose(sum(w for w, _ in local.likely), 1.0)
    assert local.likely[0][1].discs == local.best.discs
    one, other = (f.within_cone(z, replace(local, likely=((1.0, g),)), 0.8) for _, g in local.likely[:2])
    both = replace(local, likely=tuple((w, g) for w, (_, g) in zip((0.25, 0.75), local.likely, strict=False)))
    found = f.within_cone(z, both, 0.8)
    assert np.allclose(found.load, 0.25 * one.load + 0.75 * other.load)
    assert found.steps == one.steps + other.steps
    x, y, down = found.load.reshape(-1, 3).T
    assert np.all(np.hypot(x, y) <= -0.8 * down + 1e-6 * np.abs(down).max())


def test_a_contact_that_only_presses_is_the_average_over_tempered_likelihoods(monkeypatch: pytest.MonkeyPatch) -> None:
    f, z, asked, wide = fit(), pressed()[0].ravel() / NOISE, [], 1.5
    fits = [Fitted((Disc(2, -1, r),), np.array([[9.0, -0.2, 0.13]]), 0.0) for r in (2, 3, 4)]
    local = LocalLoad(np.zeros(1), np.ones(1), np.eye(6), fits[0], 1.0, ((1.0, fits[0]),), wide, {1: 1.0})

    def contacts(_: ContactFit, told: np.ndarray) -> list[Fitted]:
        asked.append(told)
        return [fits[len(asked)]] if len(asked) < 3 else []

    monkeypatch.setattr(ContactFit, "contacts", contacts)
    found = f.pressed(z, local, 0.8)
    assert np.allclose(asked, [z / wide / times for times in TEMPERED])
    assert min(TEMPERED) > 1.0
    tempered = [replace(local, likely=((1.0, g),), wide=wide * t) for g, t in zip(fits, (1.0, *TEMPERED), strict=True)]
    parts = [f.within_cone(z, one, 0.8) for one in tempered]
    assert np.allclose(found.load, f.cell_means(np.mean([p.load for p in parts], axis=0)))
    assert found.std is local.std  # the band is not tempered
    assert found.wrench is local.wrench
    assert found.steps == sum(p.steps for p in parts)
    again = f.pressed(z, local, 0.8)  # where none is found any more
    assert np.allclose(again.load, f.cell_means(f.within_cone(z, local, 0.8).load))


def test_means_over_cells_keep_constants_and_forces_and_lie_between_those_of_smooth_and_of_linear_loads() -> None:
    f, rng = fit(), np.random.default_rng(4)
    any_load = rng.standard_normal(f.problem.H.shape[1])
    assert np.allclose(f.cell_means(np.ones_like(any_load)), 1.0)
    force = f.problem.resultant[:3]
    assert np.allclose(force @ f.cell_means(any_load), force @ any_load)
    x, y = f.places[:, :2].T
    inner = (np.abs(x) < SIZE[0] / 2 - 1.5 * f.pitch) & (np.abs(y) < SIZE[1] / 2 - 1.5 * f.pitch)
    bent = f.cell_means(np.repeat(x**2 + y**2, 3))[::3] - (x**2 + y**2)
    steps = np.array([np.diff(np.unique(v.round(9)))[0] for v in (x, y)])
    assert np.allclose(bent[inner], 2 * CELL * np.sum(steps**2), rtol=1e-6)
    assert 1 / 24 < CELL < 1 / 8  # int (x + s)^2 ds over a cell, and with straight lines between nodes


def test_contacts_are_found_by_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []

    def contacts(self: ContactFit, z: np.ndarray) -> list[Fitted]:
        seen.extend(threads())
        return []

    monkeypatch.setattr(ContactFit, "contacts", contacts)
    assert fit()(np.zeros(len(fit().moved))) is None
    assert set(seen) <= {1}


def test_a_map_of_markers_along_all_axes_is_nearer_than_either_of_its_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Loads about the contact and loads anywhere, weighed: of a press on another mesh."""
    parts: list[Any] = []
    whole = LocalLoad.beside
    monkeypatch.setattr(LocalLoad, "beside", lambda self, *other: parts.extend((self, *other)) or whole(self, *other))
    patch = Patch("round", (0.9e-3, -0.6e-3), (2.2e-3, 0.0), 0.0, (0.03, -0.02, -0.15))
    moved = surfaces([(patch,)], "fe", SIZE, THICK, NU)[0](markers()) / E
    seen = moved + NOISE * np.random.default_rng(6).standard_normal(moved.shape)
    pad = Pad(size=SIZE, thickness=THICK, E=E, nu=NU)
    s = MultilayerPad(pad, Markers(markers(), NOISE, "XYZ"), choice=0.03)
    found, (about, anywhere, *_) = s.estimate(seen), parts
    assert np.allclose(found.resultant().value[:3], s.resultant[:3] @ about.load, rtol=1e-6)
    true = patch.density(pad.nodes2d)[:, None] * np.array(patch.force)
    mean, nearest, open_ = (load.reshape(-1, 3) - true for load in (found.load, about.load, anywhere))
    assert np.linalg.norm(mean) < 0.85 * min(np.linalg.norm(nearest), np.linalg.norm(open_))
    under = true[:, 2] != 0
    assert np.mean(np.abs(mean)[under] <= 1.96 * found.std.reshape(-1, 3)[under]) > 0.85
    far = np.hypot(*(markers() - (4e-3, -3e-3)).T) > 7e-3  # a press may be where no marker is seen
    still = NOISE * np.random.default_rng(7).standard_normal(moved.shape)
    lost = np.where(far[:, None], still, np.nan)
    added = [s.estimate(m).resultant().std[2] ** 2 - s.follow(m).resultant().std[2] ** 2 for m in (lost, still)]
    assert added[0] > 4 * added[1] > 0


def test_two_loads_of_the_same_readings_are_weighed_by_their_variances() -> None:
    load, std = np.array([1.0, 3.0, 0.0]), np.array([1.0, 1.0, 0.0])
    local = LocalLoad(load, std, np.eye(6), Fitted((), np.empty((0, 3)), 0.0), 1.0, (), 1.0, {1: 1.0})
    none = np.zeros(3)
    mean, variance = local.beside(np.array([1.0, 1.0, 1.1]), np.array([1.0, 3.0, 1.0]), none)
    assert np.allclose(mean, (1.0, 2.5, 0.1))
    agreed = (1 + (0 + 4 + 1.21) / (2 + 4 + 1.1)) / 2  # less apart than both lead to expect
    # two that lie apart are wider; a place without a contact keeps a tenth of what is open there
    assert np.allclose(variance, agreed * np.array([0.5, 0.75, 0.1 / 1.1]) + (0, 0.1875 * 4, 0.1))
    other = np.array([4.0, 1.0, 1.1]), np.array([1.0, 3.0, 1.0])
    apart = local.beside(*other, none)[1]  # no less than the variance of a mean
    assert np.allclose(apart, (0.5 + 0.25 * 9, 0.75 + 0.1875 * 4, 0.1 / 1.1 + 0.1))
    mean, wider = local.beside(*other, np.array([5.0, 1.0, 1.0]))  # noise hides how large the other may be at the first
    assert np.allclose(mean, local.beside(*other, none)[0])
    assert np.allclose(wider - apart, (0.25 * 4, 0.0, 0.0))


def test_loads_leave_open_what_readings_do_not_show_of_loads_as_large_as_these() -> None:
    band, load = sensor().inverse.band, np.zeros((len(fit().places), 3))
    assert band is not None
    assert np.allclose(band.left_open(load.ravel(), 2.0), 4 * band.noise)
    node = len(load) // 2
    load[node, 2] = -1e4
    more = (band.left_open(load.ravel(), 1.0) - band.noise).reshape(-1, 3)
    assert not more[:, :2].any()
    assert np.array_equal(np.flatnonzero(more[:, 2]), np.sort(band.near[[node]].indices))
    assert np.isclose(more[node, 2], 1e8 * band.unseen[3 * node + 2], rtol=0.5)  # and what the mesh errs by
    assert more[node, 2] >= 1e8 * band.unseen[3 * node + 2]
