"""Lambda of long records with few hits: the default stays near the best lambda, wherever the hits are."""

import pytest

from tests.benchmarks.long_lambda import judged

NEAR = 1.2  # error over the smallest of all lambdas


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("layout", ["one early", "one late", "pair"])
@pytest.mark.parametrize("kind", ["displacement", "acceleration"])
def test_few_hits_in_a_long_quiet_record(kind: str, layout: str, stated: bool) -> None:
    """One or two hits of 41 samples in 10 000: most windows of the record hold no load at all."""
    found = judged(f"six {kind}", layout, 10_000, 3, stated)
    assert found.error < NEAR * found.best
    assert found.expected < NEAR


@pytest.mark.parametrize(("samples", "seed"), [(8000, 3), (10_000, 1)])
def test_one_hit_that_fourteen_modes_answer(samples: int, seed: int) -> None:
    """A cantilever with three accelerometers: the response fills a good part of the record, the load twenty samples.

    The second one needs lambdas below those where its windows sent the search.
    """
    found = judged("cantilever", "one early", samples, seed, True)
    assert found.expected < NEAR
    assert found.error < 0.2
