"""Static estimates with a diagnosis and a geometry, made by hand: a line, and a surface with forces or pressures."""

from functools import cache

import numpy as np

from loadid import LoadEstimate, NoiseSource
from loadid._inverse.diagnosis import diagnose
from loadid._results.estimate import Axis
from loadid.paths import Choice, LinearProblem, SVDPath, choose


@cache
def line(n=32, frames=0):
    """Two bumps on a compliant line: (estimate, truth)."""
    x = (np.arange(n) + 0.5) / n
    H = (0.1 / np.pi) / (0.1**2 + (x[:, None] - x) ** 2) / n
    truth = np.exp(-0.5 * ((x - 0.375) / 0.05) ** 2) + np.exp(-0.5 * ((x - 0.7) / 0.05) ** 2)
    geometry = {
        "coordinates": x[:, None], "cells": None, "components": ["+Z"], "kind": "hats", "measures": np.full(n, 1 / n),
        "traction": None,
    }  # fmt: skip
    return _solved(H, truth, geometry, ["N/m"] * n, frames), truth


@cache
def surface(kind="nodal", components=("+X", "+Z"), nx=7, ny=6):
    """One bump on a rectangle: (estimate, truth)."""
    X, Y = np.meshgrid(np.linspace(0, 0.04, nx), np.linspace(0, 0.03, ny), indexing="ij")
    places = np.column_stack([X.ravel(), Y.ravel(), np.full(X.size, 0.01)])
    count, points = len(components), X.size
    K = np.exp(-0.5 * np.sum((places[:, None] - places) ** 2, axis=2) / 0.006**2)
    truth = np.zeros((points, count))
    truth[:, -1] = 5 * np.exp(-0.5 * np.sum((places[:, :2] - [0.018, 0.014]) ** 2, axis=1) / 0.006**2)
    q = np.arange(points).reshape(nx, ny)
    cells = np.stack([q[:-1, :-1], q[1:, :-1], q[1:, 1:], q[:-1, 1:]], -1).reshape(-1, 4)
    area = np.full(points, 0.04 * 0.03 / points)
    nodal = kind == "nodal"
    geometry = {
        "coordinates": places, "cells": cells if nodal else None, "components": list(components), "kind": kind,
        "measures": area, "traction": np.diag(1 / np.repeat(area, count)) if nodal else None,
    }  # fmt: skip
    units = ["N" if nodal else "Pa"] * truth.size
    return _solved(np.kron(K, np.eye(count)), truth.ravel(), geometry, units), truth.ravel()


def _solved(H, truth, geometry, units, frames=0):
    rng = np.random.default_rng(0)
    y = H @ truth
    std = 3e-3 * np.abs(y).max()
    Y = (y * (1 + np.arange(frames)[:, None] / 10) if frames else y) + std * rng.standard_normal(
        (frames, len(y))[not frames :]
    )
    path = SVDPath(LinearProblem.whitened(H, Y, np.full(len(y), std)))
    found = choose(path, "discrepancy", sigma=1.0, source="repeatability")
    choice = Choice(
        found.lam,
        found.scale,
        found.rule,
        found.rules,
        sweep=found.sweep,
        sigma=1.0,
        source=NoiseSource("repeatability"),
    )
    solution = path.solution(choice.lam, 1.0)
    points, count = len(geometry["coordinates"]), len(geometry["components"])
    return LoadEstimate(
        load=solution.load, std=np.broadcast_to(solution.posterior.std, solution.load.shape), choice=choice,
        labels=[f"{p + 1}{c}" for p in range(points) for c in geometry["components"]][: points * count], units=units,
        axis=Axis("frame", "", np.arange(frames)) if frames else None,
        response=Y, residual=Y - solution.load @ H.T, sensors=[f"s{k}" for k in range(len(y))],
        sensor_units=["um"] * len(y), posterior=solution.posterior, geometry=geometry,
        diagnosis=diagnose.diagnose(path, choice.lam, 1.0, np.atleast_2d(solution.load)[-1], geometry=geometry),
        provenance={"family": "static inversion"},
    )  # fmt: skip
