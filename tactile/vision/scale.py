"""Size of the dots of a pattern and their distance, from one image."""

from __future__ import annotations

from typing import Any

import numpy as np

from structures.advice import Advice, Spelling
from structures.errors import InputError
from structures.values import positive

from .backend import Backend, Image, backend
from .detect import NOISE, Detector, binned, maxima, pixel_noise, usual
from .grey import grey

SMALLEST, LARGEST = 1.5, 0.08  # radius in px, and as a share of the shorter side of the image
STEPS = 1.15  # ratio of neighbouring radii that are tried
WIDER = 1.6  # ratio of the two Gaussians whose difference is a blob detector
WINDOW = 5.0  # pitch over radius that is taken until the pitch is known
FINE = 6.0  # px of radius above which the image is binned before it is searched

BRIGHT = Spelling("dark=False looks for bright dots", "in the pad file, [markers] dark = false looks for bright dots")
SIZE = Spelling("; radius= and pitch= state their size in px", "; radius and pitch state their size in px")


def size_of_dots(
    image: Any,
    *,
    radius: float | None = None,
    pitch: float | None = None,
    dark: bool = True,
    backend: str | None = None,
) -> tuple[float, float]:
    """Radius and pitch of the dots in px; what is given stays as it is.

    The radius is that of the scale at which the difference of two Gaussians, normalised by scale, answers most strongly
    (Lindeberg 1998: a disc of radius r answers at sigma = r / sqrt 2); the pitch is the median distance of the dots
    found with it to their nearest neighbours.

    Raises
    ------
    InputError
        Fewer than three dots.
    """
    where = "size of the dots"
    picture = grey(image)
    r = best_radius(picture, dark=dark, backend=backend) if radius is None else positive("radius", radius, where=where)
    if pitch is not None:
        return r, positive("pitch", pitch, where=where)
    found = Detector(r, WINDOW * r, dark, backend=backend)(picture)
    if len(found.points) < 3:
        raise InputError(
            "no pattern of dots in the image",
            where=where,
            found=f"{len(found.points)} {'dark' if dark else 'bright'} dots",
            expected="at least three",
            hint=Advice(BRIGHT, SIZE),
        )
    return r, max(found.pitch, 2 * r)


def best_radius(image: Any, *, dark: bool = True, backend: str | None = None) -> float:
    """Radius in px of the dots that stand out most.

    Raises
    ------
    InputError
        If nothing stands out of the noise.
    """
    picture = grey(image)
    largest = max(LARGEST * min(picture.shape), 2 * SMALLEST)
    radii = SMALLEST * STEPS ** np.arange(np.ceil(np.log(largest / SMALLEST) / np.log(STEPS)) + 1)
    answers = np.array([_answer(picture, float(r), dark, backend) for r in radii])
    best = int(np.argmax(answers))
    if answers[best] <= 0:
        raise InputError("no dots stand out of the noise", where="image", hint=Advice(BRIGHT))
    if 0 < best < len(radii) - 1:  # parabola over log r
        a, b, c = answers[best - 1 : best + 2]
        return float(radii[best] * STEPS ** (0.5 * (c - a) / (2 * b - a - c)))
    return float(radii[best])


def _answer(picture: Any, radius: float, dark: bool, name: str | None) -> float:
    """Usual height of the maxima of the blob detector of one radius; 0 where nothing exceeds the noise."""
    tools: Backend = backend(name)
    bins = max(1, int(radius / FINE))
    coarse, sigma = binned(picture, bins), radius / bins / np.sqrt(2 * WIDER)  # the pair's mean scale is r / sqrt 2
    narrow, wide = tools.smooth(coarse, sigma), tools.smooth(coarse, WIDER * sigma)
    blobs: Image = wide - narrow if dark else narrow - wide
    floor = NOISE * pixel_noise(picture) / (2 * np.sqrt(np.pi) * sigma * bins)
    y, x = maxima(blobs, floor)
    return usual(blobs[y, x]) if len(y) >= 3 else 0.0
