"""Compiled loops and the same loops as written: every loop of a solve, on the arguments that it meets there."""

from collections import Counter
from copy import deepcopy
from importlib import import_module

import numpy as np
import pytest

from loadid._inverse.gaussian.compiled import Compiled, settled

from .cases import beam, case, holes

MODULES = ("compiled", "gains", "passes", "posterior")


def loops() -> set[Compiled]:
    modules = [import_module(f"loadid._inverse.gaussian.{name}") for name in MODULES]
    return {loop for module in modules for loop in vars(module).values() if isinstance(loop, Compiled)}


def one_late(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """One channel of one sample, near the end."""
    gone = np.zeros(shape, bool)
    gone[-20, 0] = True
    return gone


@pytest.fixture
def compared(monkeypatch: pytest.MonkeyPatch) -> Counter[Compiled]:
    """Calls of each loop that gave what the loop as written gave: the first since it was cleared."""
    done, call = Counter[Compiled](), Compiled.__call__

    def both(loop: Compiled, *args: object) -> object:
        if done[loop] and loop is not settled:  # which calls others late
            return call(loop, *args)
        done[loop] += 1
        own = deepcopy(args)
        expected, found = loop.plain(*own), call(loop, *args)
        for a, b in zip((found, *args), (expected, *own), strict=True):
            for x, y in zip(*(one if isinstance(one, tuple) else (one,) for one in (a, b)), strict=True):
                assert (x is None) == (y is None)
                size = 0.0 if y is None or not np.size(y) else np.max(np.abs(np.nan_to_num(y)))
                if size:
                    np.testing.assert_allclose(x, y, rtol=0, atol=1e-12 * size, err_msg=loop.__qualname__)
        return found

    monkeypatch.setattr(Compiled, "__call__", both)
    return done


def test_compiled_loops_change_no_number(compared: Counter[Compiled]) -> None:
    """Records with gaps, loads that move and an unknown start; long enough to settle, all of one kind and not."""
    met = set[Compiled]()
    for samples, missing, count, lam in ((90, holes, 2, 1e-2), (400, None, 1, 1e-5), (400, one_late, 1, 1e-5)):
        record = case(beam("ds", "foh", count), samples, missing, moving=missing is holes)
        path = record.path("first_difference", unknown_start=missing is holes)
        compared.clear()
        posterior = path.solution(lam, 1.3).posterior
        assert posterior.bias_weights(np.ones(posterior.std.shape)).shape == posterior.std.shape
        assert missing is holes or len(path._gains(lam).K) < samples  # settled
        met |= set(compared)
    assert met == loops()
