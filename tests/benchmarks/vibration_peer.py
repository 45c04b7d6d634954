"""Runs forcefinder and sdynpy, or pyFBS, on the cases of `tests.benchmarks.vibration`, where they are installed.

``python vibration_peer.py {forcefinder,pyfbs} cases.npz answers.npz``. Imports nothing of this project, uses public
calls only, and writes cross spectra of drives (lines, loads, loads) or complex forces (lines, loads), and CPU seconds.
"""

import os
import sys
import time

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")  # aborts without a display otherwise

import numpy as np


def timed(run):
    """What a call returns, and the least of three CPU times."""
    spent, found = [], None
    for _ in range(3):
        start = time.process_time()
        found = run()
        spent.append(time.process_time() - start)
    return found, min(spent)


# -- forcefinder and sdynpy -------------------------------------------------------------------------------------------
def of_forcefinder(data):
    """Answers of both, which share an environment."""
    import forcefinder
    import sdynpy as sdpy
    from sdynpy.core.sdynpy_data import FunctionTypes
    from sdynpy.signal_processing import sdynpy_cpsd as cpsd
    from sdynpy.signal_processing.sdynpy_frf_inverse import frf_inverse

    f, H, S, count = data["f"], data["H"], data["S"], int(data["training"])
    sensors = sdpy.coordinate_array(np.arange(H.shape[1]) + 1, "Z+")
    loads = sdpy.coordinate_array(np.arange(H.shape[2]) + 101, "Z+")
    density, transfer = FunctionTypes.POWER_SPECTRAL_DENSITY, FunctionTypes.FREQUENCY_RESPONSE_FUNCTION
    pairs = sdpy.coordinate.outer_product(sensors, loads)
    frfs = sdpy.data_array(transfer, f, np.moveaxis(H, 0, -1), pairs)
    auto = np.einsum("kii->ik", S).real
    asd = sdpy.data_array(density, f, auto, np.column_stack((sensors, sensors)))
    whole = sdpy.data_array(density, f, np.moveaxis(S, 0, -1), sdpy.coordinate.outer_product(sensors, sensors))

    def power(target=asd):
        made = forcefinder.PowerSourcePathReceiver(
            frfs=frfs, target_response=target, training_response_coordinate=sensors[:count]
        )
        return made.make_buzz_cpsd_from_frf()

    def drives(made):
        return np.moveaxis(made.force[sdpy.coordinate.outer_product(loads, loads)].ordinate, -1, 0)

    def limited():
        limit = forcefinder.core.response_limit.ResponseLimit(
            str(sensors.string_array()[count]), f[[0, -1]], np.full(2, float(data["most"]))
        )
        made = power().manual_inverse(use_buzz=True)
        return drives(made.apply_response_limit(limit))

    def transposed(G, T):
        return G @ T @ G.conj().transpose(0, 2, 1)

    head, target = H[:, :count], S[:, :count, :count]
    alone = np.einsum("ki,ij->kij", np.einsum("kii->ki", target).real, np.eye(count))
    buzz = cpsd.match_coherence_phase(target, head @ head.conj().transpose(0, 2, 1))
    yield "asd", "forcefinder, buzz, pinv", lambda: drives(power().manual_inverse(use_buzz=True))
    yield (
        "asd",
        "forcefinder, buzz, match trace",
        lambda: drives(power().manual_inverse(use_buzz=True).match_trace_update()),
    )
    yield "asd", "forcefinder, buzz, L-curve", lambda: drives(power().auto_tikhonov_by_l_curve(use_buzz=True))
    yield "asd", "sdynpy, diagonal, pinv", lambda: transposed(frf_inverse(head), alone)
    yield "asd", "sdynpy, buzz, pinv", lambda: transposed(frf_inverse(head), buzz)
    yield "cpsd", "forcefinder, pinv", lambda: drives(power(whole).manual_inverse())
    yield "cpsd", "forcefinder, L-curve", lambda: drives(power(whole).auto_tikhonov_by_l_curve())
    yield "cpsd", "sdynpy, pinv", lambda: transposed(frf_inverse(head), target)
    yield "limit", "forcefinder, buzz, scaled", limited

    g, T = data["tpa_H"] @ data["tpa_T"], int(data["tpa_training"])
    names = sdpy.coordinate_array(np.arange(g.shape[2]) + 101, "Z+")
    seen = sdpy.coordinate_array(np.arange(T) + 1, "Z+")
    paths = sdpy.data_array(
        transfer, data["tpa_f"], np.moveaxis(g[:, :T], 0, -1), sdpy.coordinate.outer_product(seen, names)
    )
    spectrum = sdpy.data_array(FunctionTypes.SPECTRUM, data["tpa_f"], data["tpa_Y"][:, :T].T, seen[:, None])

    def forces(call):
        made = forcefinder.LinearSourcePathReceiver(paths, spectrum)
        getattr(made, call)()
        return np.asarray(made.force[names[:, None]].ordinate).T

    yield "tpa", "forcefinder, pinv", lambda: forces("manual_inverse")
    yield "tpa", "forcefinder, L-curve", lambda: forces("auto_tikhonov_by_l_curve")
    yield "tpa", "sdynpy, pinv", lambda: np.einsum("knm,km->kn", frf_inverse(g[:, :T]), data["tpa_Y"][:, :T])


# -- pyFBS ------------------------------------------------------------------------------------------------------------
def of_pyfbs(data):
    """Virtual point by its own transformation, forces by its pseudo-inverse, truncated or not."""
    import pandas as pd
    import pyfbs

    def table(positions, names, groups):
        return pd.DataFrame(
            [{"Description": n, "Grouping": g, **{f"Position_{i + 1}": p[i] for i in range(3)}, "Direction_1": 0.0,
              "Direction_2": 0.0, "Direction_3": 1.0, "Quantity": "Force", "Name": n}
             for n, p, g in zip(names, positions, groups, strict=True)]
        )  # fmt: skip

    hits = data["tpa_hits"]
    count = data["tpa_H"].shape[2]
    places = [*hits, *np.zeros((count - len(hits), 3))]
    impacts = table(places, [f"h{i}" for i in range(count)], [1] * len(hits) + [2] * (count - len(hits)))
    point = table(np.zeros((3, 3)), ["fz", "mx", "my"], [1, 1, 1])
    training = int(data["tpa_training"])

    def forces(removed):
        made = pyfbs.interface.VPT(df_imp=impacts, df_vp_imp=point, df_chn=None, df_vp_chn=point)
        mapped = data["tpa_H"] @ made.tf
        return np.einsum("knm,km->kn", pyfbs.tpinv(mapped[:, :training], trunc=removed), data["tpa_Y"][:, :training])

    yield "tpa", "pyFBS, virtual point, pinv", lambda: forces(0)
    yield "tpa", "pyFBS, virtual point, one value off", lambda: forces(1)


def main(package, source, target):
    """All methods of one package."""
    data, out = np.load(source), {}
    for case, name, run in {"forcefinder": of_forcefinder, "pyfbs": of_pyfbs}[package](data):
        try:
            found, seconds = timed(run)
        except Exception as error:  # of the package: its row says so
            sys.stderr.write(f"{name}: {type(error).__name__}: {error}\n")
            continue
        out[f"{case}|{name}"] = found
        out[f"{case}|{name}|s"] = seconds
    np.savez(target, **out)


if __name__ == "__main__":
    main(*sys.argv[1:])
