"""The inverse of a static job at its frozen lambda."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from .._commands import _inputs as inputs
from .._commands._settings import load_family
from .._commands.identify import family_settings

if TYPE_CHECKING:
    from .context import GuidedJob

BESIDE = ("validation", "at", "mean", "noise")  # settings of a job that the family itself does not take


def frozen_inverse(job: GuidedJob, frozen: Mapping[str, Any]) -> Any:
    """`StaticInversion.freeze` of the settings of a job.

    Raises
    ------
    InputError
        From the family: sensors of several units without noise levels, say.
    """
    options = {**job.options, **frozen}
    labels = [s.label for s in job.model.sensors]
    out = [str(one) for one in options.get("validation") or ()]
    used = [str(one) for one in options.get("sensors") or labels if str(one) not in out]
    settings = {name: value for name, value in options.items() if name not in BESIDE}
    if out:
        settings["sensors"] = used
    if options.get("noise") is not None:
        settings["noise"] = inputs.noise(options["noise"], labels, used)
    chosen = load_family("static")
    return chosen(job.model, **family_settings(settings, chosen, job.model)).freeze()
