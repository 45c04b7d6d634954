"""Pictures of a load estimate. Object interface of matplotlib only: no global state, no window unless asked for."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING

from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from structures.errors import InputError

from .choosing import gcv, lcurve, path_figure
from .diagnosis import columns, filter_factors, modes, picard, resolution
from .fields import field, spacetime, zones
from .loads import draw_load, lines_figure, load_figure, response_figure, spectrum_figure
from .style import finished, known_load, new_figure, picture_format, rendered

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .._results.estimate import LoadEstimate


__all__ = [
    "columns", "field", "filter_factors", "gcv", "lcurve", "lines_figure", "load_figure", "modes", "path_figure",
    "picard", "picture_format", "plot", "rendered", "resolution", "response_figure", "spacetime", "spectrum_figure",
    "zones",
]  # fmt: skip

# a known load can stand beside
_OF_LOADS: dict[str, Callable[..., Figure]] = {"load": load_figure, "field": field, "spacetime": spacetime}
_OTHERS: dict[str, Callable[..., Figure]] = {
    "response": response_figure,
    "path": path_figure,
    "lcurve": lcurve,
    "gcv": gcv,
    "picard": picard,
    "filter_factors": filter_factors,
    "resolution": resolution,
    "columns": columns,
    "lines": lines_figure,
}


def plot(
    estimate: LoadEstimate,
    kind: str = "load",
    *,
    truth: ArrayLike | None = None,
    ax: Axes | None = None,
    path: str | os.PathLike[str] | None = None,
    show: bool = False,
) -> Figure:
    """Figure of an estimate; see `LoadEstimate.plot`."""
    if ax is not None:
        if not hasattr(ax, "fill_between"):
            raise InputError(
                "these are no axes", where="ax", found=f"an object of type {type(ax).__name__}",
                expected="matplotlib Axes", hint="figure, ax = matplotlib.pyplot.subplots()",
            )  # fmt: skip
        draw_load(ax, estimate, 0, truth=known_load(estimate, truth))
        return ax.get_figure(root=True)  # type: ignore[return-value]
    if kind not in (*_OF_LOADS, *_OTHERS):
        expected = ", ".join((*_OF_LOADS, *_OTHERS))
        raise InputError("no such picture", where="plot", found=repr(kind), expected=f"one of {expected}")
    figure = new_figure(show)
    if kind in _OF_LOADS:
        _OF_LOADS[kind](estimate, truth=truth, figure=figure)
    else:
        _OTHERS[kind](estimate, figure=figure)
    return finished(figure, path, show)
