"""Dots of a marker pattern, found to a few hundredths of a pixel; their size and their distance.

The image is binned as far as the dots allow, smoothed to 0.8 of their radius and subtracted from its local mean over
about one pitch; every local maximum above a share of the usual one is a dot, and a parabola through the maximum and its
neighbours, or the weighted centroid of the peak, gives its place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._advice import Advice, Spelling
from structures.errors import InputError, one_of, positive

from .._arrays import Array, Index, Mask, UnusableFrame
from ._images import Backend, Grey, Image, backend, grey

BLUR = 0.8  # standard deviation of the smoothing over the radius of a dot
COARSEST = {"parabola": 2.5, "centroid": 3.0}  # px of a radius in the binned image
MARGIN = 1.2  # distance to the border over the radius, below which the border cuts a dot
THRESHOLD = 0.35  # of the usual maximum
NOISE = 5.0  # standard deviations of the noise of the smoothed image, below which nothing is a dot
HALF = 0.5  # of its maximum: where the peak of a dot ends for the weighted centroid


@dataclass(frozen=True)
class Detected:
    """Dots of one image.

    Parameters
    ----------
    points : array, shape (k, 2)
        Places in px, x to the right and y down; the centre of the first pixel is (0, 0).
    strength : array, shape (k,)
        How much darker (brighter) than its surroundings the smoothed image is there, in grey levels.
    radius : float
        Radius of a dot in px, as given or as estimated.
    """

    points: Array
    strength: Array
    radius: float

    @property
    def pitch(self) -> float:
        """Median distance of a dot to its nearest neighbour, px; NaN below two dots."""
        from scipy.spatial import cKDTree

        if len(self.points) < 2:
            return float("nan")
        return float(np.median(cKDTree(self.points).query(self.points, k=2)[0][:, 1]))


@dataclass(frozen=True)
class Detector:
    """Finds the dots of every image of one camera.

    Parameters
    ----------
    radius : float
        Radius of a dot in px.
    pitch : float
        Usual distance of neighbouring dots in px.
    dark : bool
        Whether the dots are darker than the gel.
    method : {"parabola", "centroid"}
        How the place of a maximum is refined.
    threshold : float
        Share of the usual strength above which a maximum is a dot.
    margin : float, optional
        Dots closer than this to the border, in px, are cut by it and left out; default 1.2 radii.
    backend : {"cv2", "scipy"}, optional
        Default: OpenCV where it is installed.

    Raises
    ------
    InputError
        Settings that are none.
    """

    radius: float
    pitch: float
    dark: bool = True
    method: str = "parabola"
    threshold: float = THRESHOLD
    margin: float | None = None
    backend: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius", positive("radius", self.radius, where="Detector", unit="px"))
        object.__setattr__(self, "pitch", positive("pitch", self.pitch, where="Detector", unit="px"))
        object.__setattr__(self, "threshold", positive("threshold", self.threshold, where="Detector"))
        if self.pitch < 2 * self.radius:
            raise InputError(
                "the dots overlap", where="Detector", found=f"radius {self.radius:g} px, pitch {self.pitch:g} px",
                expected="a pitch of at least two radii",
            )  # fmt: skip
        one_of("unknown method of detection", self.method, COARSEST, where="method")
        backend(self.backend)

    def __call__(self, image: Any) -> Detected:
        """Dots of one image, `Detected`."""
        response = self.response(grey(image))
        y, x, levels = self._peaks(response)
        place = _parabola if self.method == "parabola" else _centroid
        points = place(response.image, y, x, self._reach(response)) * response.bins + (response.bins - 1) / 2
        inside = self._inside(points, np.shape(image))
        return Detected(points[inside], levels[inside].astype(float), self.radius)

    def response(self, image: Grey) -> DotResponse:
        """The image in which every dot is one smooth maximum, and its noise."""
        tools: Backend = backend(self.backend)
        bins = max(1, int(self.radius / COARSEST[self.method]))
        coarse = binned(image, bins)
        sigma = BLUR * self.radius / bins
        width = 2 * round(0.5 * self.pitch / bins) + 1
        mean, smoothed = tools.box(coarse, width), tools.smooth(coarse, sigma)
        contrast = mean - smoothed if self.dark else smoothed - mean
        noise = pixel_noise(image) / (2 * np.sqrt(np.pi) * sigma * bins)
        return DotResponse(contrast, bins, sigma, float(noise))

    def _peaks(self, response: DotResponse) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Rows, columns and levels of the maxima that are dots."""
        y, x = maxima(response.image, NOISE * response.noise)
        levels = response.image[y, x]
        keep = levels > self.threshold * usual(levels)
        y, x = y[keep], x[keep]
        alone = levels[keep] >= _patches(response.image, y, x, self._reach(response)).max(axis=(1, 2))
        return y[alone], x[alone], levels[keep][alone]

    def _reach(self, response: DotResponse) -> int:
        """Half width in binned px of the square that holds one dot only."""
        return max(2, round(min(self.radius * 1.3, 0.45 * self.pitch) / response.bins))

    def _inside(self, points: NDArray[Any], shape: tuple[int, ...]) -> Mask:
        margin = MARGIN * self.radius if self.margin is None else self.margin
        x, y = points.T
        return np.asarray((x >= margin) & (y >= margin) & (x <= shape[1] - 1 - margin) & (y <= shape[0] - 1 - margin))


@dataclass(frozen=True)
class DotResponse:
    """The image in which every dot is one smooth maximum: grey levels above the local mean, binned by `bins` px.

    `sigma` is the std of the smoothing in its pixels, `noise` that of its noise in grey levels.
    """

    image: Image
    bins: int
    sigma: float
    noise: float


def detect(
    image: Any,
    *,
    radius: float | None = None,
    pitch: float | None = None,
    dark: bool = True,
    method: str = "parabola",
    threshold: float = THRESHOLD,
    margin: float | None = None,
    backend: str | None = None,
) -> Detected:
    """Dots of one image; radius and pitch of the pattern are estimated where they are not given.

    See `Detector` for the settings, and use one for many images of one camera.

    Raises
    ------
    InputError
        No image; settings that are none; no dots where the size of one is to be estimated.
    """
    sizes = size_of_dots(image, radius=radius, pitch=pitch, dark=dark, backend=backend)
    return Detector(*sizes, dark, method, threshold, margin, backend)(image)


def binned(image: Grey, bins: int) -> Image:
    """Mean over squares of bins x bins px, as float32; rows and columns that fill no square are left out."""
    if bins == 1:
        return image.astype(np.float32)
    h, w = (n // bins for n in image.shape)
    cut = image[: h * bins, : w * bins]
    rows: NDArray[Any] = cut[0::bins].astype(np.uint32 if bins > 16 else np.uint16)
    for k in range(1, bins):
        rows += cut[k::bins]
    total: Image = rows[:, 0::bins].astype(np.float32)
    for k in range(1, bins):
        total += rows[:, k::bins]
    total *= np.float32(1 / bins**2)
    return total


def pixel_noise(image: Grey) -> float:
    """Standard deviation of the noise of a pixel in grey levels, from second differences along some rows.

    Their median absolute value ignores the edges of dots. Rounding to grey levels is counted as noise.
    """
    rows = image[:: max(1, image.shape[0] // 24)].astype(np.int16)
    second = np.abs(rows[:, 2:] - 2 * rows[:, 1:-1] + rows[:, :-2])
    return float(max(float(np.median(second)) * 1.4826 / np.sqrt(6), 12**-0.5))


def maxima(image: Image, floor: float) -> tuple[Index, Index]:
    """Rows and columns of the pixels above a floor that are the largest among themselves and their four neighbours."""
    core = image[1:-1, 1:-1]
    top = core > floor
    top &= core > image[1:-1, :-2]
    top &= core >= image[1:-1, 2:]
    top &= core > image[:-2, 1:-1]
    top &= core >= image[2:, 1:-1]
    y, x = np.divmod(np.flatnonzero(top), core.shape[1])
    return y + 1, x + 1


def usual(levels: NDArray[Any]) -> float:
    """Usual strength of a dot: median of the maxima that are not far below the third largest; 0 without any."""
    if len(levels) == 0:
        return 0.0
    high = np.partition(levels, -3)[-3] if len(levels) >= 3 else levels.max()
    return float(np.median(levels[levels >= THRESHOLD * high]))


def _patches(image: Image, y: NDArray[Any], x: NDArray[Any], reach: int) -> NDArray[np.float32]:
    """Squares around some pixels, shape (k, 2 reach + 1, 2 reach + 1); beyond the border -inf."""
    padded = np.pad(image, reach, constant_values=-np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (2 * reach + 1, 2 * reach + 1))
    return np.asarray(windows[y, x])


def _parabola(image: Image, y: NDArray[Any], x: NDArray[Any], reach: int) -> Array:
    """Vertices (x, y) of the parabolas through the maxima and their neighbours along each axis."""
    centre, left, right, up, down = (
        image[y + dy, x + dx].astype(float) for dy, dx in ((0, 0), (0, -1), (0, 1), (-1, 0), (1, 0))
    )
    along_x = 0.5 * (right - left) / (2 * centre - left - right)
    along_y = 0.5 * (down - up) / (2 * centre - up - down)
    return np.column_stack([x + along_x, y + along_y])


def _centroid(image: Image, y: NDArray[Any], x: NDArray[Any], reach: int) -> Array:
    """Centroids (x, y) of what rises above half of each maximum, within the square that holds one dot."""
    heights = _patches(image, y, x, reach).astype(float)
    weights = np.maximum(heights - HALF * heights[:, reach : reach + 1, reach : reach + 1], 0)
    total, offset = weights.sum(axis=(1, 2)), np.arange(-reach, reach + 1)
    return np.column_stack([x + (weights.sum(axis=1) @ offset) / total, y + (weights.sum(axis=2) @ offset) / total])


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
        raise UnusableFrame(
            "no pattern of dots in the image", where=where,
            found=f"{len(found.points)} {'dark' if dark else 'bright'} dots", expected="at least three",
            hint=Advice(BRIGHT, SIZE),
        )  # fmt: skip
    return r, max(found.pitch, 2 * r)


def best_radius(image: Any, *, dark: bool = True, backend: str | None = None) -> float:
    """Radius in px of the dots that stand out most."""
    picture = grey(image)
    largest = max(LARGEST * min(picture.shape), 2 * SMALLEST)
    radii = SMALLEST * STEPS ** np.arange(np.ceil(np.log(largest / SMALLEST) / np.log(STEPS)) + 1)
    answers = np.array([_answer(picture, float(r), dark, backend) for r in radii])
    best = int(np.argmax(answers))
    if answers[best] <= 0:
        raise UnusableFrame("no dots stand out of the noise", where="image", hint=Advice(BRIGHT))
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
