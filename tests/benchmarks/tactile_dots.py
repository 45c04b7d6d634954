"""The printed dots of a measured gel, unloaded and pressed: found by every method, and shown.

Run ``python -m tests.benchmarks.tactile_dots [PICTURE]``. The gel of a GelSight Mini with 7 x 9 printed dots (images of
the FEATS project, MIT licence); no setting is given. Saves ``gelsight_dots.png``.
"""

from __future__ import annotations

import sys

from tactile._results.film import overlay
from tactile.vision import MarkerTracker, detect
from tactile.vision._frames import read_image, read_stack
from tactile.vision._images import installed

from ..data import data_folder

PRINTED = 63


def main(picture: str = "gelsight_dots.png") -> None:
    """Print the counts and save the picture."""
    folder = data_folder()
    if folder is None:
        print("measured records not found (set LOADID_DATA)")
        return
    from matplotlib.figure import Figure

    images = {
        "unloaded": read_stack(folder / "gelsight_dots" / "nocontact.npz", "gs_img"),
        "cuboid pressed": read_image(folder / "gelsight_dots" / "cuboid_10-2-284.png"),
    }
    figure = Figure(figsize=(15, 4), layout="constrained")
    axes = figure.subplots(1, 3)
    print(f"{'':16s}{'backend':>9s}{'method':>10s}{'dots':>6s}{'radius px':>11s}{'pitch px':>10s}")
    for ax, (name, image) in zip(axes, images.items(), strict=False):
        for backend in ("cv2", "scipy") if installed() else ("scipy",):
            for method in ("parabola", "centroid"):
                found = detect(image, backend=backend, method=method)
                dots, radius, pitch = len(found.points), found.radius, found.pitch
                print(f"{name:16s}{backend:>9s}{method:>10s}{dots:6d}{radius:11.2f}{pitch:10.2f}")
        overlay(image, detect(image), title=name, axes=ax)
    motion = MarkerTracker(images["unloaded"]).step(images["cuboid pressed"])
    print(f"{motion.tracked.sum()} of {PRINTED} followed from the unloaded image to the pressed one")
    overlay(images["cuboid pressed"], motion, axes=axes[2])
    figure.savefig(picture, dpi=110)
    print(f"saved {picture}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
