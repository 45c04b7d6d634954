"""Error and time of finding and following dots, beside what a user would take from OpenCV and scipy.

Run ``python -m tests.benchmarks.tactile_vision``. Rendered dark dots (blur 1 px, noise 2 or 4 grey levels) at known
places, eight frames of a growing press with shear; then the same through a tilted camera behind a window. Error: rms
per axis over all dots that were found. Time: CPU milliseconds per frame, median of the frames, one thread. Last, the
way of the motion onto 1849 nodes.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from tactile import Interpolation, View
from tactile.vision import Detector, MarkerTracker
from tactile.vision._images import Scene, grid, installed, opencv

Points = NDArray[np.float64]
FRAMES = 8
# name, size, rows, columns, pitch, radius, noise
CASES = (
    ("320 x 240, 63 dots", (240, 320), 7, 9, 28.0, 6.0, 2.0),
    ("640 x 480, 520 dots", (480, 640), 20, 26, 23.0, 5.0, 2.0),
    ("640 x 480, 520 dots, radius 3, noise 4", (480, 640), 20, 26, 23.0, 3.0, 4.0),
    ("1280 x 960, 1200 dots", (960, 1280), 30, 40, 31.0, 6.0, 2.0),
)


def main() -> None:
    """Print the tables."""
    if installed():
        opencv().setNumThreads(1)
    for name, size, rows, columns, pitch, radius, noise in CASES:
        places = clip(grid(rows, columns, pitch, centre=((size[1] - 1) / 2, (size[0] - 1) / 2)), pitch)
        scene = Scene(size=size, radius=radius, noise=noise)
        images = [scene.draw(p, seed=k) for k, p in enumerate(places)]
        table(name, images, places, Detector(radius, pitch))
    photographs()
    interpolation()


def clip(rest: Points, pitch: float) -> list[Points]:
    """Places of the dots at rest and in seven frames of a press with shear, up to a quarter of a pitch per frame."""
    rest = rest + np.random.default_rng(0).uniform(-0.04, 0.04, rest.shape) * pitch
    offset = (rest - rest.mean(axis=0)) / (3 * pitch)
    near = np.exp(-0.5 * (offset**2).sum(axis=1, keepdims=True))
    return [rest + k * pitch * (0.06 * offset * near + np.array([0.2, 0.1]) * near**0.25) for k in range(FRAMES)]


def photographs() -> None:
    """The second case through a tilted camera behind a refracting window, the dots lowered by up to 0.5 mm."""
    view = View.camera(
        focal=1000.0, centre=(319.5, 239.5), distance=0.03, depth=0.009, gamma=1.4, tilt=0.25, azimuth=0.6
    )
    rest = grid(20, 26, 0.8e-3)
    near = np.exp(-0.5 * (rest**2).sum(axis=1) / 2.5e-3**2)
    moved = [np.column_stack([rest + 2e-5 * k * near[:, None], -7e-5 * k * near]) for k in range(FRAMES)]
    scene = Scene(radius=0.19e-3)
    images = [scene.photograph(view, p, seed=k) for k, p in enumerate(moved)]
    table(
        "640 x 480, 520 dots, perspective, refraction", images, [view.to_pixels(p) for p in moved], Detector(5.0, 22.0)
    )


def table(name: str, images: list, places: list[Points], detector: Detector) -> None:
    """Error, share found, dots that are none, and time of every method on one clip."""
    print(f"\n{name}\n{'':44s}{'rms px':>8s}{'found':>8s}{'false':>7s}{'CPU ms':>8s}")
    for label, method in methods(detector).items():
        found, spent = [], []
        for image in [images[0], *images]:  # the first time warms up
            start = time.process_time()
            found.append(method(image))
            spent.append(1e3 * (time.process_time() - start))
        rms, share, false = judged(found[1:], places)
        print(f"{label:44s}{rms:8.3f}{share:8.1%}{false:7d}{statistics.median(spent[1:]):8.2f}")
    for backend in ("cv2", "scipy") if installed() else ("scipy",):
        followed(f"ours, {backend}: detect and match", images, places, settled(detector, backend))


def followed(label: str, images: list, places: list[Points], detector: Detector) -> None:
    """The tracker on a clip: its errors are those of the right dot."""
    tracker = MarkerTracker(images[0], detector=detector)
    order = cKDTree(places[0]).query(tracker.points)[1]
    spent, error, seen = [], [], 0
    for image, truth in zip(images, places, strict=True):
        start = time.process_time()
        motion = tracker.step(image)
        spent.append(1e3 * (time.process_time() - start))
        error.append((motion.places - truth[order])[motion.tracked])
        seen += int(motion.tracked.sum())
    rms = np.sqrt(np.mean(np.concatenate(error) ** 2))
    share = seen / sum(map(len, places))
    print(f"{label:44s}{rms:8.3f}{share:8.1%}{0:7d}{statistics.median(spent):8.2f}")


def judged(found: list[Points], places: list[Points]) -> tuple[float, float, int]:
    """Rms error per axis of the dots within 3 px of a true place, their share, and the number of the others."""
    errors, hits, false = [], 0, 0
    for dots, truth in zip(found, places, strict=True):
        if len(dots) == 0:
            continue
        distance, index = cKDTree(dots).query(truth)
        near = distance < 3
        errors.append((dots[index] - truth)[near])
        hits, false = hits + int(near.sum()), false + len(dots) - len(np.unique(index[near]))
    rms = np.sqrt(np.mean(np.concatenate(errors) ** 2)) if errors else np.nan
    return float(rms), hits / sum(map(len, places)), false


def methods(detector: Detector) -> dict[str, Callable[[NDArray[np.uint8]], Points]]:
    """Ours, and the alternatives."""
    listed: dict[str, Callable[[NDArray[np.uint8]], Points]] = {}
    for backend in ("cv2", "scipy") if installed() else ("scipy",):
        for method in ("parabola", "centroid"):
            ours = settled(detector, backend, method)
            listed[f"ours, {backend}: {method}"] = lambda image, ours=ours: ours(image).points
    if installed():
        listed["cv2.SimpleBlobDetector"] = simple_blob(detector)
        listed["cv2 adaptive threshold, contours, moments"] = contours(detector)
    listed["scipy label, centre of mass"] = lambda image: labelled(image, detector)
    return listed


def settled(detector: Detector, backend: str, method: str = "parabola") -> Detector:
    """The detector with another backend and method."""
    return Detector(detector.radius, detector.pitch, method=method, backend=backend)


def simple_blob(detector: Detector) -> Callable[[NDArray[np.uint8]], Points]:
    """OpenCV's blob detector, told the size of the dots."""
    cv2 = opencv()
    settings = cv2.SimpleBlobDetector_Params()
    settings.filterByArea, settings.filterByInertia, settings.filterByConvexity = True, False, False
    area = np.pi * detector.radius**2
    settings.minArea, settings.maxArea = 0.3 * area, 3 * area
    settings.minDistBetweenBlobs = 0.5 * detector.pitch
    blobs = cv2.SimpleBlobDetector_create(settings)
    return lambda image: np.array([point.pt for point in blobs.detect(image)]).reshape(-1, 2)


def contours(detector: Detector) -> Callable[[NDArray[np.uint8]], Points]:
    """Adaptive threshold and first moments of the outlines."""
    cv2, block = opencv(), 2 * round(detector.pitch / 2) + 1

    def found(image: NDArray[np.uint8]) -> Points:
        mask = cv2.adaptiveThreshold(image, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, block, 15)
        outlines = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
        moments = [cv2.moments(c) for c in outlines]
        large = [m for m in moments if m["m00"] > np.pi * detector.radius**2 / 4]
        return np.array([[m["m10"] / m["m00"], m["m01"] / m["m00"]] for m in large]).reshape(-1, 2)

    return found


def labelled(image: NDArray[np.uint8], detector: Detector) -> Points:
    """Threshold against the local mean, connected regions, their centres of mass."""
    grey = image.astype(np.float32)
    contrast = ndimage.uniform_filter(grey, 2 * round(detector.pitch / 2) + 1) - grey
    mask = contrast > 15
    regions, _ = ndimage.label(mask)
    sizes = np.bincount(regions.ravel())[1:]
    chosen = 1 + np.flatnonzero(sizes > np.pi * detector.radius**2 / 4)
    centres = np.array(ndimage.center_of_mass(np.where(mask, contrast, 0), regions, chosen))
    return centres.reshape(-1, 2)[:, ::-1]


def interpolation() -> None:
    """Time, error on a smooth field without noise, and std per unit of marker noise, onto 1849 nodes."""
    markers = grid(20, 26, 0.92e-3) + np.random.default_rng(0).uniform(-2e-5, 2e-5, (520, 2))
    nodes = grid(43, 43, 17e-3 / 42)
    fields = [
        np.column_stack([p[:, 0], p[:, 1]]) * np.exp(-0.5 * (p**2).sum(1, keepdims=True) / 1.6e-3**2)
        for p in (markers, nodes)
    ]
    print(f"\nonto {len(nodes)} nodes")
    print(f"{'':16s}{'build ms':>10s}{'apply ms':>10s}{'bias':>8s}{'std':>8s}{'effective':>11s}")
    for kind in ("linear", "local"):
        onto = Interpolation(markers, nodes, kind)
        build, apply = (
            clocked(task) for task in (lambda k=kind: Interpolation(markers, nodes, k), lambda o=onto: o(fields[0]))
        )
        found = onto(fields[0])
        inside = onto.inside
        bias = np.linalg.norm((found - fields[1])[inside]) / np.linalg.norm(fields[1][inside])
        std = np.sqrt(onto.covariance(1.0).diagonal()[inside].mean())
        print(f"{kind:16s}{build:10.2f}{apply:10.2f}{bias:8.3f}{std:8.2f}{onto.effective()[0]:11.0f}")


def clocked(task: Callable[[], object], repeats: int = 15) -> float:
    """Median CPU milliseconds."""
    spent = []
    for _ in range(repeats):
        start = time.process_time()
        task()
        spent.append(1e3 * (time.process_time() - start))
    return statistics.median(spent)


if __name__ == "__main__":
    main()
