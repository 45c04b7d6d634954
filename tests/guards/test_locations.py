"""Guards of the search for the place of a load, reached through the search."""

from __future__ import annotations

from functools import cache

import numpy as np

from case_studies.impact_location import DT, NODES, SAMPLES, beam, half_sine, noisy, plate, plate_grid, recorded
from loadid import Lambda, LocationSearch, Search
from loadid._spellings import folded
from structures import Flag, ForwardModel, sensors

from .cases import Case, refused

CLEAR = (5, 17, 29)


@cache
def struck(seen: tuple[int, ...], node: int, level: float, seed: int = 0):
    """Record of one impact on the beam."""
    model = beam(seen)
    h = model.impulse_response(DT, SAMPLES, "zoh")[:, :, NODES.index(node)]
    force = half_sine(SAMPLES, DT, 0.010, 0.005)
    clean = np.column_stack([np.convolve(h[:, s], force)[:SAMPLES] for s in range(len(seen))])
    values, std = noisy(clean, level, seed)
    return recorded(model, values, DT, std)


def flags(seen: tuple[int, ...] = CLEAR, node: int = 12, level: float = 0.01, **settings) -> tuple[Flag, ...]:
    """Flags of a search on the beam."""
    settings = {"refine": False, "hold": "zoh", "workers": 1, **settings}
    return LocationSearch(beam(seen), **folded(LocationSearch, settings)).locate(struck(seen, node, level)).flags


def rim(beyond: bool) -> tuple[Flag, ...]:
    """Flags where the grid stops before the true place, or reaches beyond it."""
    grid = range(13 if beyond else 7, 30)
    return LocationSearch(beam(CLEAR, grid), hold="zoh", search=Search(workers=1)).locate(struck(CLEAR, 12, 0.01)).flags


def gone(beyond: bool) -> tuple[Flag, ...]:
    """Flags where the load acts far outside the grid, or inside."""
    grid = NODES[9:] if beyond else NODES[:10]
    return (
        LocationSearch(beam(CLEAR, grid), hold="zoh", search=Search(refine=False, workers=1))
        .locate(struck(CLEAR, 6, 0.01))
        .flags
    )


def layout(seen: tuple[int, ...]) -> tuple[Flag, ...]:
    """Flags of the model alone."""
    return LocationSearch(beam(seen)).check(DT, SAMPLES)


def on_a_plate(y: float) -> tuple[Flag, ...]:
    """Flags of a plate with two accelerometers at one height, in the middle or beside it."""
    model = plate(plate_grid(), (10, 8), 40)
    seen = [sensors.Accelerometer(at=(x, y), direction="+Z") for x in (0.23, 0.71)]
    return LocationSearch(ForwardModel(model.structure, seen, model.loads, modes=40)).check(1 / 4000, 100)


CASES = [
    Case(
        "W511",
        lambda: flags((5, 17), level=1.0),
        lambda: flags((5, 17)),
        r"explains the data as well.*ratio 1\.0\d\d\d.*threshold 1\.05",
        "between candidates",
    ),
    Case(
        "W511",
        lambda: flags((18, 22), level=0.3, refine=True),
        lambda: flags((5, 17), refine=True),
        r"ambiguous.*(threshold 1\.05|known to ±0\.\d+ m only)",
        "between refined places",
    ),
    Case("W511", lambda: rim(True), lambda: rim(False), r"on the rim of the candidates", "at the end of the grid"),
    Case(
        "W511",
        lambda: gone(True),
        lambda: gone(False),
        r"leaves \d+% of them, \d\d(\.\d)? times the noise.*threshold 3",
        "beyond the grid",
    ),
    Case("W511", lambda: flags((17,)), lambda: flags((5, 17)), r"with 1 sensor and 1 unknown", "one sensor"),
    Case("W511", lambda: flags(choice=0.1), lambda: flags(choice=0.01), r"relative lambda of 0\.1", "underfitted"),
    Case("E512", lambda: layout((20,)), lambda: layout((17,)), r"4\+Z and 36\+Z.*give the same data.*0\.001"),
    Case(
        "E512",
        lambda: refused(lambda: flags((20,))),
        lambda: refused(lambda: flags((20, 17))),
        r"2\+Z and 38\+Z.*give the same data.*off the symmetry axis",
        "before any data",
    ),
    Case(
        "E512",
        lambda: on_a_plate(0.4),
        lambda: on_a_plate(0.37),
        r"\(0\.1, 0\.1\) and \(0\.1, 0\.7\).*give the same data",
        "on a plate",
    ),
    Case(
        "E513",
        lambda: refused(lambda: LocationSearch(beam(CLEAR), choice="gcv")),
        lambda: refused(lambda: LocationSearch(beam(CLEAR), choice=1e-4)),
        r"a rule, which chooses another lambda for each: 'gcv'",
        "a rule",
    ),
    Case(
        "E513",
        lambda: refused(lambda: LocationSearch(beam(CLEAR), choice=Lambda(method="tsvd"))),
        lambda: refused(lambda: LocationSearch(beam(CLEAR), choice=Lambda(method="tikhonov"))),
        r"a truncation rank",
        "truncation",
    ),
    Case(
        "E513",
        lambda: refused(lambda: LocationSearch(beam(CLEAR), choice=[1e-3] * 19)),
        lambda: refused(lambda: LocationSearch(beam(CLEAR), choice=np.float64(1e-3))),
        r"a lambda for each: 19 values",
        "one lambda each",
    ),
]
