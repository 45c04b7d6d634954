"""What the path says between its nodes, against what it says at them, over five decades."""

import numpy as np
import pytest

from .cases import PENALTIES, beam, case, holes

LIMITS = {  # largest relative difference; the sensitivity has dips that are sharper than the nodes are close
    "residual2": 1e-3, "penalty2": 1e-3, "edf": 1e-5, "left": 2e-5, "edf2": 2e-4, "rest2": 1e-3, "rest4": 2e-2,
    "log_ratio": 2e-6, "bend": 2e-2, "sensitivity": 0.5,
}  # fmt: skip
COUNTS = (("d", None), ("da", holes))


@pytest.mark.parametrize("mix", range(2))
@pytest.mark.parametrize("penalty", ["identity", "second", "second from zero"])
def test_between_the_nodes(penalty: str, mix: int) -> None:
    (kinds, missing), (name, options) = COUNTS[mix], PENALTIES[penalty]
    path = case(beam(kinds, "foh", len(kinds)), 150, missing).path(name, **options)
    lams = np.geomspace(1e-5, 1, 12)[:-1]
    swept, each = path.at(lams), [path.exact(float(lam)) for lam in lams]
    worst = {
        key: float(np.max(np.abs(getattr(swept, key) / np.array([getattr(one, key) for one in each]) - 1)))
        for key in LIMITS
    }
    assert {key: error for key, error in worst.items() if error > LIMITS[key]} == {}


def test_a_quick_path_says_the_same_of_what_it_says() -> None:
    from loadid._inverse.gaussian.path import StateSpacePath

    whole = case(beam("d", "foh", 1), 150).path("first_difference")
    quick, lams = StateSpacePath(whole.record, quick=True), np.geomspace(1e-4, 1, 9)
    for key in ("residual2", "edf", "left", "log_ratio"):
        assert np.allclose(getattr(quick.at(lams), key), getattr(whole.at(lams), key), rtol=1e-2)
    assert quick.at(lams).sensitivity is None
    assert quick.at(lams).bend is None
