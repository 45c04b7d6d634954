"""The three networks: residual for numbers, U-shaped for maps on grids, temporal convolution for histories."""

from __future__ import annotations

from .graph import Graph, Step

WIDTHS = (24, 48, 64)  # channels of the levels of a U-shaped network
TAPS = 3


class Drawing:
    """Steps as they are written down, each taking what the one before has made."""

    def __init__(self) -> None:
        self.steps: list[Step] = []
        self.last = "in"

    def put(self, kind: str, *takes: str, shape: tuple[int, ...] = (), wide: int = 1, name: str = "") -> str:
        """One step more, of the last value where nothing else is named; returns the name of what it makes."""
        self.last, before = name or f"v{len(self.steps)}", self.last
        self.steps.append(Step(kind, takes or (before,), self.last, shape, wide))
        return self.last


def residual(inputs: int, outputs: int, width: int = 256, blocks: int = 2) -> Graph:
    """Dense layers with bridges (K. He et al., CVPR 2016): (n, inputs) to (n, outputs)."""
    draw = Drawing()
    draw.put("dense", shape=(width, inputs))
    draw.put("rectify")
    for _ in range(blocks):
        bridge = draw.last
        draw.put("dense", shape=(width, width))
        draw.put("rectify")
        deep = draw.put("dense", shape=(width, width))
        draw.put("add", bridge, deep)
        draw.put("rectify")
    draw.put("dense", shape=(outputs, width), name="out")
    return Graph(tuple(draw.steps))


def unet(inputs: int, outputs: int, widths: tuple[int, ...] = WIDTHS) -> Graph:
    """Convolutions that halve the grid and double it again (O. Ronneberger et al., MICCAI 2015).

    (n, inputs, rows, columns) to (n, outputs, rows, columns), sides multiples of 2 to the number of halvings.
    """
    draw, bridges, channels = Drawing(), [], inputs
    for level, width in enumerate(widths):
        if level:
            bridges.append((draw.last, channels))
            draw.put("pool")
        channels = _two(draw, channels, width, 2)
    for (bridge, kept), width in zip(reversed(bridges), reversed(widths[:-1]), strict=True):
        up = draw.put("double")
        draw.put("join", bridge, up)
        channels = _two(draw, kept + channels, width, 2)
    draw.put("convolve", shape=(outputs, channels, 1, 1), name="out")
    return Graph(tuple(draw.steps))


def temporal(inputs: int, outputs: int, width: int = 32, blocks: int = 5) -> Graph:
    """Convolutions over time, each twice as wide as the one before (S. Bai et al., arXiv 1803.01271), both ways.

    (n, inputs, samples) to (n, outputs, samples); a sample is told by ``2 ** (blocks + 2)`` of its neighbours.
    """
    draw = Drawing()
    draw.put("convolve", shape=(width, inputs, 1))
    for level in range(blocks):
        bridge = draw.last
        draw.put("convolve", shape=(width, width, TAPS), wide=2**level)
        draw.put("rectify")
        deep = draw.put("convolve", shape=(width, width, TAPS), wide=2**level)
        draw.put("add", bridge, deep)
        draw.put("rectify")
    draw.put("convolve", shape=(outputs, width, 1), name="out")
    return Graph(tuple(draw.steps))


def _two(draw: Drawing, channels: int, width: int, axes: int) -> int:
    """Two convolutions, each rectified; returns the channels."""
    for before in (channels, width):
        draw.put("convolve", shape=(width, before, *(TAPS,) * axes))
        draw.put("rectify")
    return width
