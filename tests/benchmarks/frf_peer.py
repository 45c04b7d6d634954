"""Runs forcefinder on problems of lines, in the environment where it is installed: a child of `tests.benchmarks.frf`.

``python frf_peer.py problems.npz loads.npz [--quick]``. Imports nothing of this project, uses forcefinder's public
calls only, and writes the loads, (lines, loads) for each problem and method, with CPU and wall seconds.
"""

import os
import sys
import time

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")  # aborts without a display otherwise

import numpy as np

METHODS = {
    "pinv": ("manual_inverse", {"method": "standard"}),
    "L-curve (default)": ("auto_tikhonov_by_l_curve", {}),
    "TSVD by L-curve": ("auto_truncation_by_l_curve", {}),
    "LOO cross-validation": ("auto_tikhonov_by_cv_rse", {}),
}
SLOW = "LOO cross-validation"


def problem(frequencies, H, Y):
    """Its object of FRFs (lines, sensors, loads) and responses (lines, sensors)."""
    import forcefinder
    import sdynpy as sdpy
    from sdynpy.core.sdynpy_data import FunctionTypes

    sensors = sdpy.coordinate_array(np.arange(H.shape[1]) + 1, "Z+")
    loads = sdpy.coordinate_array(np.arange(H.shape[2]) + 101, "Z+")
    pairs = sdpy.coordinate.outer_product(sensors, loads)
    frf = FunctionTypes.FREQUENCY_RESPONSE_FUNCTION
    frfs = sdpy.data_array(frf, frequencies, np.moveaxis(H, 0, -1), pairs)
    response = sdpy.data_array(FunctionTypes.SPECTRUM, frequencies, Y.T, sensors[:, None])
    return forcefinder.LinearSourcePathReceiver(frfs, response), loads


def measured(run, repeat):
    """Median CPU and wall seconds of some runs."""
    spent = []
    for _ in range(repeat):
        cpu, wall = time.process_time(), time.perf_counter()
        run()
        spent.append((time.process_time() - cpu, time.perf_counter() - wall))
    return np.median(spent, axis=0)


def main(source, target, quick):
    """All methods on all problems."""
    data, out = np.load(source), {}
    for name in data["names"]:
        for method, (call, settings) in METHODS.items():
            if quick and method == SLOW:
                continue
            spr, loads = problem(data["frequencies"], data[f"{name}:H"], data[f"{name}:Y"])

            def run(spr=spr, call=call, settings=settings):
                getattr(spr, call)(**settings)

            first = measured(run, 1)
            timed = first if first[0] > 2 else measured(run, 3)
            out[f"{name}:{method}:load"] = np.asarray(spr.force[loads[:, None]].ordinate).T
            out[f"{name}:{method}:seconds"] = timed
    np.savez(target, **out)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], "--quick" in sys.argv)
