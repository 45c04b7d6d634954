"""Families in the pools that users have: joblib, dask and its cluster; the answers are those of one process."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from loadid import Lambda
from tests.golden import problems as p

from .objects import DT, SHARED, histories, padded, said, static, tracker_of


def estimate(family: Any, k: int) -> Any:
    """The answer to the k-th record."""
    return family.estimate(p.pushed()[0] * (1 + k / 10), DT)


def tracked(tracker: Any, part: slice) -> np.ndarray:
    """Loads of a part of the record, going on from where the tracker stands."""
    return np.asarray(tracker.track(p.service()[part], DT).load)


def test_joblib() -> None:
    """Two processes of loky, families of several kinds and a tracker in mid-stream."""
    joblib = pytest.importorskip("joblib")
    families = [histories(choice=Lambda("gcv", path=path)) for path in ("dense", "statespace")]
    tracker = tracker_of(50, prior=p.WALK)
    with joblib.Parallel(n_jobs=2) as parallel:
        found = parallel(joblib.delayed(estimate)(f, k) for f in families for k in range(3))
        parts = parallel(joblib.delayed(tracked)(tracker, slice(50, 50 + n)) for n in (40, 80))
        maps = parallel([joblib.delayed(padded(choice=p.LAM).estimate)(p.moved()[1])])
    assert [said(e) for e in found] == [said(estimate(f, k)) for f in families for k in range(3)]
    assert maps[0].load.tobytes() == padded(choice=p.LAM).estimate(p.moved()[1]).load.tobytes()
    assert parts[1][:40].tobytes() == parts[0].tobytes() == tracked(tracker, slice(50, 90)).tobytes()


@pytest.mark.parametrize("scheduler", ["threads", "processes"])
def test_dask(scheduler: str) -> None:
    dask = pytest.importorskip("dask")
    shared = SHARED["StaticInversion"]
    family = shared.make()
    later = [dask.delayed(shared.estimate)(family, k) for k in range(4)]
    found = dask.compute(*later, scheduler=scheduler, num_workers=2)
    assert [said(e) for e in found] == [said(shared.estimate(shared.make(), k)) for k in range(4)]


@pytest.mark.filterwarnings("ignore")  # of the cluster's own making
def test_a_cluster_of_dask() -> None:
    distributed = pytest.importorskip("distributed")
    family, y = static(penalty="gradient")(), p.kernel()[1]
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=True, dashboard_address=None
    ) as cluster, distributed.Client(cluster) as client:  # fmt: skip
        sent = client.scatter(family)
        found = client.gather([client.submit(type(family).estimate, sent, row) for row in y])
    assert [said(e) for e in found] == [said(family.estimate(row)) for row in y]
