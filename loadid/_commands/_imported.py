"""Finite-element files of a solver as a forward model, for ``loadid model import``: read, told, reduced."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.errors import InputError

if TYPE_CHECKING:
    from structures._model import Model
    from structures._models.substructure import ReducedStructure
    from structures._system.structure import Structure

SHARED = (".uff", ".unv", ".csv", ".txt", ".mm")  # FRFs and matrices come in these too
WHOLE = 3000  # free DOFs up to which a model is kept whole where no band is named
OF_MATRICES = ("band", "modes", "supports", "dofs", "names")
MODES = re.compile(rb"^ *-1 *\r?\n *55 *\r?$", re.MULTILINE)
STEPS = 6
Tell = Callable[[str], None]


def is_fe(files: Sequence[str | Path], settings: Mapping[str, Any]) -> bool:
    """Whether files are those of a solver: units are stated, or a suffix or a first line says so."""
    from structures.files.fe._read import FE_SUFFIXES

    if "units" in settings:
        return True
    placed = bool(settings.get("sensors") or settings.get("loads"))  # FRFs have their places themselves
    return any(
        (suffix in FE_SUFFIXES and suffix not in SHARED)
        or (suffix == ".mtx" and _bare(f))
        or (placed and suffix in (".uff", ".unv") and _modal(f))
        for f, suffix in ((f, Path(f).suffix.lower()) for f in files)
    )


def _bare(path: str | Path) -> bool:
    """A .mtx file without the banner of Matrix Market: one of Abaqus."""
    try:
        with open(path, "rb") as file:
            return file.read(14).lower() != b"%%matrixmarket"
    except OSError:
        return False


def _modal(path: str | Path) -> bool:
    """A universal file with a data set 55."""
    try:
        return MODES.search(Path(path).read_bytes()) is not None
    except OSError:
        return False


def imported(
    files: Sequence[str | Path],
    settings: Mapping[str, Any],
    sensors: Sequence[Any],
    loads: Sequence[Any],
    words: Mapping[str, Any],
    progress: Callable[[float, str], None],
    tell: Tell,
) -> Model:
    """Forward model of the files of a solver.

    Parameters
    ----------
    files : sequence of path
    settings : dict
        ``units``, ``dofs``, ``supports``, ``names``, ``modal_mass``, ``band``, ``modes``.
    sensors, loads : sequence
    words : dict
        ``damping`` and ``material``, made.
    progress : callable
        ``progress(fraction, text)``.
    tell : callable
        Takes what the user reads: the summary, and what a reduction costs.

    Raises
    ------
    InputError
        What `read_fe` or the reduction refuses, with what does not fit beside it; a large model without a band.
    """
    from structures import ForwardModel
    from structures.files import read_fe

    step = _Steps(progress)
    step("reading")
    held = settings.get("supports", ())
    fe = read_fe(
        list(files), units=settings.get("units"), dofs=settings.get("dofs"), material=words.get("material"),
        supports=held if isinstance(held, list) else [p.strip() for p in str(held).split(",")] if held else (),
        names=settings.get("names"), modal_mass=settings.get("modal_mass"),
    )  # fmt: skip
    damping = words.get("damping")
    if fe.K is None and fe.modes is not None:
        strange = [name for name in OF_MATRICES if settings.get(name) is not None]
        if strange:
            raise InputError("modes of a file have no such setting", where=fe.source, found=", ".join(strange),
                             expected="units, damping, modal_mass", hint="these belong to K and M")  # fmt: skip
        tell(str(fe.summary()))
        return fe.modal(sensors, loads, damping)
    try:
        structure = fe.structure(damping=damping)
        reduced = _reduced(structure, sensors, loads, settings, step)
    except InputError as error:
        fits = fe.summary([]).remarks
        raise InputError(
            error.what, where=f"{fe.source}: {error.where}" if error.where else fe.source, found=error.found,
            expected=error.expected, hint="; ".join([error.hint, *fits]) if fits else error.hint, code=error.code,
        ) from None  # fmt: skip
    small = structure if reduced is None else reduced.structure
    model = ForwardModel(small, sensors, loads, modes=settings.get("modes"))
    step("summary")
    tell(str(fe.summary(known(model, reduced))))
    if reduced is not None:
        tell(
            f"  reduced to {len(reduced.kept)} DOFs and {small.n - len(reduced.kept)} modal unknowns; error up to "
            f"{reduced.band:g} Hz at most {reduced.worst:.1e} of the response of a line"
        )
    return model


def known(model: Any, reduced: ReducedStructure | None) -> list[float]:
    """Natural frequencies (Hz) that are known without another solve."""
    found = model.natural_frequencies if reduced is None else reduced.frequencies
    return [] if found is None else [float(f) for f in found]


def _reduced(
    structure: Structure, sensors: Sequence[Any], loads: Sequence[Any], settings: Mapping[str, Any], step: Tell
) -> ReducedStructure | None:
    """The structure on the DOFs of sensors and loads; None where it is kept whole."""
    import numpy as np

    from structures._models.substructure import reduce

    band, free = settings.get("band"), structure.free.size
    if band is None and (structure.M is None or free <= WHOLE):
        return None
    if band is None:
        raise InputError(
            "a large model is reduced, and the band that matters is not stated", where="loadid model import",
            found=f"{free} free DOFs", expected="--band, the highest frequency of interest in Hz",
            hint="some 1.5 times the highest frequency that the records hold",
        )  # fmt: skip
    drawn = [*(s.row(structure) for s in sensors), *(p.shape(structure) for p in loads)]
    touched = np.any(np.array(drawn) != 0, axis=0)
    keep = [structure.dofs[i] for i in np.flatnonzero(touched)]
    return reduce(structure, keep, float(band), progress=step)


class _Steps:
    """Steps of one import on a bar."""

    def __init__(self, progress: Callable[[float, str], None]) -> None:
        self.progress, self.done = progress, 0

    def __call__(self, text: str) -> None:
        """Show what begins now."""
        self.progress(self.done / STEPS, text)
        self.done = min(self.done + 1, STEPS)
