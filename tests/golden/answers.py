"""What is kept of an answer, the file that keeps it, and how far two answers lie apart.

Of every array at most `KEPT` entries are kept, spread evenly, beside its largest modulus, its rms and a weighted sum:
every entry counts. Words are the codes of the flags, the rule, the verdict, and which rules were refused.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FILE = Path(__file__).with_name("answers.npz")
KEPT = 60
Words = dict[str, list[str]]


@dataclass(frozen=True)
class Answer:
    """Arrays, each compared with its own largest entry, and words, which must be the same."""

    arrays: dict[str, NDArray[np.float64]]
    words: Words = field(default_factory=dict)


def answer(estimate: Any, **more: ArrayLike) -> Answer:
    """What is kept of an estimate, and further arrays."""
    arrays = {"load": kept(estimate.load), "std": kept(estimate.std)}
    if estimate.residual is not None:
        arrays["residual norm"] = np.array([np.linalg.norm(np.nan_to_num(estimate.residual))])
    words = {"codes": sorted(estimate.codes)}
    for name in ("edf", "noise_level", "support"):
        if isinstance(value := estimate.facts.get(name), int | float):
            arrays[name] = np.array([float(value)])
    for name in ("path", "verdict"):
        if name in estimate.facts:
            words[name] = [str(estimate.facts[name])]
    if (choice := estimate.choice) is not None:
        arrays["lambda"] = kept(choice.lam)
        arrays["scale"] = kept(choice.scale)
        words["choice"] = [choice.rule, choice.verdict]
        if choice.rule != "given":
            arrays |= {f"lambda of {r.rule}": kept(r.lam) for r in choice.rules if r.lam is not None}
            words["refused"] = [r.rule for r in choice.rules if r.lam is None]
    return Answer(arrays | {name: kept(value) for name, value in more.items()}, words)


def kept(values: ArrayLike) -> NDArray[np.float64]:
    """An array of any shape, flat: whole where it is short, else a part, largest modulus, rms and a weighted sum."""
    x = np.atleast_1d(np.asarray(values))
    x = np.ascontiguousarray(x, complex).view(float).ravel() if x.dtype.kind == "c" else x.astype(float).ravel()
    if len(x) <= KEPT:
        return x
    whole = np.nan_to_num(x)
    weights = (np.arange(len(x)) * 7919 % 1009) / 504.5 - 1  # no two neighbours alike
    sums = [np.abs(whole).max(), np.sqrt(np.mean(whole**2)), whole @ weights / np.linalg.norm(weights)]
    return np.concatenate([x[np.linspace(0, len(x) - 1, KEPT).round().astype(int)], sums])


def apart(new: NDArray, old: NDArray) -> float:
    """Largest difference over the largest entry; infinite between arrays of different length or other gaps."""
    if new.shape != old.shape or np.any(np.isfinite(new) != np.isfinite(old)):
        return np.inf
    there = np.isfinite(old)
    difference = np.max(np.abs(new[there] - old[there]), initial=0.0)
    largest = np.max(np.abs(old[: KEPT + 1][there[: KEPT + 1]]), initial=1e-300)  # behind it the sums of `kept`
    return 0.0 if difference == 0 else float(difference / largest)


def changes(new: Answer, old: Answer) -> tuple[dict[str, float], list[str]]:
    """Relative difference of each array, and words that changed, as sentences."""
    names = sorted(new.arrays.keys() | old.arrays.keys())
    none = np.empty(0)
    off = {n: apart(new.arrays.get(n, none), old.arrays.get(n, none)) for n in names}
    said = [
        f"{n}: {old.words.get(n)} -> {new.words.get(n)}"
        for n in sorted(new.words.keys() | old.words.keys())
        if new.words.get(n) != old.words.get(n)
    ]
    return off, said


# -- the file ---------------------------------------------------------------------------------------------------------
def save(answers: Mapping[str, Answer], path: Path = FILE) -> None:
    """One array of all numbers, and their layout with the words as JSON."""
    listed = {name: answers[name] for name in sorted(answers)}
    layout = {
        name: {"arrays": {n: len(x) for n, x in a.arrays.items()}, "words": a.words} for name, a in listed.items()
    }
    numbers = np.concatenate([x for a in listed.values() for x in a.arrays.values()])
    text = np.frombuffer(json.dumps(layout).encode(), np.uint8)
    np.savez_compressed(path, numbers=numbers, layout=text)


def load(path: Path = FILE) -> dict[str, Answer]:
    """The stored answers; none where the file is not there."""
    if not path.exists():
        return {}
    with np.load(path, allow_pickle=False) as file:
        numbers, layout = file["numbers"], json.loads(file["layout"].tobytes())
    found, start = {}, 0
    for name, entry in layout.items():
        arrays = {}
        for key, length in entry["arrays"].items():
            arrays[key], start = numbers[start : start + length], start + length
        found[name] = Answer(arrays, entry["words"])
    return found
