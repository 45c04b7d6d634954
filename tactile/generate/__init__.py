"""Presses drawn from a declared distribution, their contact solved, and what a sensor reads of them: training sets.

The truth is never that of the inverse's own mesh: contacts are those of rigid bodies on the exact layer, motion that of
the layer, or of a finer pad with its edges.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from ._declared import CameraRange as CameraRange
from ._declared import ContactRange as ContactRange
from ._declared import GelRange as GelRange
from ._declared import ImageRange as ImageRange
from ._declared import IndenterRange as IndenterRange
from ._declared import MarkerRange as MarkerRange
from ._declared import PressDeclaration as PressDeclaration
from ._maker import PressMaker as PressMaker

if TYPE_CHECKING:
    from loadid.generate import TrainingSet

    from .._pad.pad import Pad
    from .._sensors.linear import LinearSensor

__all__ = [
    "CameraRange", "ContactRange", "GelRange", "ImageRange", "IndenterRange", "MarkerRange", "PressDeclaration",
    "presses",
]  # fmt: skip


def presses(
    sensor: LinearSensor,
    declaration: PressDeclaration | str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    draws: int,
    seed: int,
    truth: Pad | Sequence[Pad] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> TrainingSet:
    """Presses on the gel of a sensor, and what it reads of them, as a training set in a folder.

    Bodies are pressed, dragged and turned on the exact layer until the contact is found; the motion of the markers is
    that of the layer, or of `truth`. A sensor with an eye is shown images; one without reads the motion with noise.
    Loads are those of the sensor, equal to the tractions in force and moment. Called again, it makes what is missing.

    Parameters
    ----------
    sensor : MultilayerPad or GelForce
        On a flat rectangular pad or on a layer.
    declaration : PressDeclaration or path
        What is drawn, or a TOML file that says so. What it does not say of the gel lies within the tolerances of the
        sensor.
    folder : path
    draws, seed : int
        How many, and what they follow from: the same draw is the same press, whatever else is asked.
    truth : Pad or sequence of Pad, optional
        Finer pads of the same size, with their free edges, that move instead of the layer; where the declaration draws
        nu or thickness of the gel, six pads of their mesh that fill these ranges.
    workers : int, optional
        Processes of this machine; all its cores where nothing is said.
    scheduler : str, optional
        Address of a dask scheduler instead.
    progress : callable, optional
        Called as ``progress(fraction, text)``.

    Returns
    -------
    TrainingSet

    Raises
    ------
    InputError
        A sensor, a declaration or pads that do not go together; a folder that holds another set, or a damaged shard.
    """
    from loadid.generate import generate

    from .._pad.pad import Pad as _Pad

    told = declaration if isinstance(declaration, PressDeclaration) else PressDeclaration.read(declaration)
    pads = () if truth is None else (truth,) if isinstance(truth, _Pad) else tuple(truth)
    return generate(
        PressMaker(sensor, told, pads), folder, draws=draws, seed=seed, workers=workers, scheduler=scheduler,
        progress=progress,
    )  # fmt: skip
