"""Steps 7 and 8 of a job that tracks: not lambda is frozen but noise, prior and gain, found once by likelihood."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._commands._settings import load_family
from .._commands.identify import family_settings
from .inversions import at_frozen, require_explained, residual_share, unloaded
from .outcome import Asked, Outcome

if TYPE_CHECKING:
    from .._families.tracking.tracker import Tracker

NAME = "tracker.h5"


def tuned(asked: Asked) -> Outcome:
    """Step 7: the tracker of the job, tuned on its log, with what its innovations say of it."""
    job, noise = asked.job, unloaded(asked)
    chosen = load_family("tracker")
    settings = {name: value for name, value in {**job.options, **noise}.items() if name != "validation"}
    tracker: Tracker = chosen(job.model, **family_settings(settings, chosen, job.model)).fit(job.responses(job.log))
    path = asked.folder / f"{asked.stem}.{NAME}"
    made = {path: _bytes_of(tracker, path)}
    e = tracker.track(job.responses(job.log))
    require_explained(e)
    fitted, told = tracker.fitted, tracker.certificate
    figures: dict[str, Any] = {
        "family": job.family, "tracker": path.name, "prior": fitted.words, "numbers": dict(fitted.numbers),
        "noise_source": str(fitted.noise_source), "residual_share": residual_share(e),
    }  # fmt: skip
    said = f"prior, noise and gain by likelihood ({fitted.words})"
    if told is not None:
        each_sensor = zip(told.sensors, told.rms, told.mean, told.left_out, strict=True)
        figures |= {
            "verdict": told.verdict,
            "failing": list(told.failing),
            "nis": told.nis,
            "nis_by_chance": list(told.nis_bounds),
            "whiteness": told.whiteness,
            "whiteness_by_chance": told.whiteness_bound,
            "forgets_within_s": told.time_constant,
            "sensors": {
                name: {"innovation_rms": rms, "innovation_mean": mean, "inside_from_the_others": share}
                for name, rms, mean, share in each_sensor
            },
        }
        said += f"; {told.verdict}, NIS {told.nis:.3f}"
    if noise:
        figures["noise"] = noise["noise"]
    return Outcome(f"{said}; frozen", figures, [f for f in tracker.flags if f.code[5] in "45"], made=made)


def replayed(asked: Asked) -> Outcome:
    """Step 8: the frozen tracker on the log, sample by sample, held against the load of step 7, and what one costs."""
    from .._families.tracking.tracker import Tracker

    job, path = asked.job, at_frozen(asked)["tracker"]
    responses = job.responses(job.log)
    whole = np.asarray(job.estimate(responses, tracker=path).load)
    stepped, count = Tracker.load(path, job.model), min(len(responses), 2000)
    begun = time.process_time()
    loads = np.array([stepped.step(row)[0] for row in responses.values[:count]])
    each = (time.process_time() - begun) / count
    off = float(np.linalg.norm(loads - whole[:count]) / max(float(np.linalg.norm(whole[:count])), 1e-300))
    figures = {"tracker": path.name, "seconds_per_sample": each, "seconds_between_samples": responses.dt,
               "differs_by": off}  # fmt: skip
    said = (
        f"a sample takes {1e6 * each:.3g} us of the {1e6 * responses.dt:.5g} us between two; sample by sample the load "
        f"differs from that of step 7 by {off:.1e} of its size; loadid track --model {path.name} runs it"
    )
    return Outcome(said, figures, (), off < 1e-6)


def _bytes_of(tracker: Tracker, path: Path) -> bytes:
    """The file of a tracker before its first sample, made beside its place and taken away again."""
    with tempfile.TemporaryDirectory() as folder:
        tracker.save(Path(folder) / path.name)
        return (Path(folder) / path.name).read_bytes()
