"""Small networks with weights, values, and what torch makes of them: `python -m tests.learning.networks` writes it."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np

from loadid._learning.network import architectures
from loadid._learning.network.graph import Graph

FILE = Path(__file__).with_name("networks.npz")
SHAPES = {"residual": (3, 4), "unet": (2, 3, 4, 6), "temporal": (2, 2, 11)}


def drawn(name: str) -> Graph:
    """One of three small networks, its steps without weights."""
    match name:
        case "residual":
            return architectures.residual(4, 2, width=5, blocks=1)
        case "unet":
            return architectures.unet(3, 2, widths=(3, 4))
    return architectures.temporal(2, 2, width=3, blocks=2)


def weighed(name: str) -> Graph:
    """The network with weights by its name."""
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    graph = drawn(name)
    shapes = {key: value.shape for key, value in graph.started(0).items()}
    return Graph(graph.steps, {key: rng.standard_normal(shape).astype(np.float32) for key, shape in shapes.items()})


def values(name: str) -> np.ndarray:
    """What goes in."""
    return np.random.default_rng(1).standard_normal(SHAPES[name]).astype(np.float32)


def by_torch(graph: Graph, x: np.ndarray) -> np.ndarray:
    """What torch makes of it."""
    import torch

    from loadid._learning.network.training import carried

    weights = {key: torch.from_numpy(np.asarray(value)) for key, value in graph.weights.items()}
    return np.asarray(carried(torch, graph, weights, torch.from_numpy(x)).numpy())


if __name__ == "__main__":
    np.savez_compressed(FILE, **{name: by_torch(weighed(name), values(name)) for name in SHAPES})
