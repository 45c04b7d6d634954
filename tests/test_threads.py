"""How many threads the linear algebra takes, and that this is put back."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import pytest

from loadid import Deconvolution
from loadid._commands import demo
from structures._threads import LARGE, all_threads, one_thread, threads, threads_for

found = pytest.mark.skipif(not threads(), reason="the linear algebra is no OpenBLAS")


@found
def test_one_inside_and_what_was_before_outside() -> None:
    before = threads()
    with one_thread():
        assert set(threads()) == {1}
        with all_threads():
            assert threads() == before
        with one_thread():
            assert set(threads()) == {1}
        assert set(threads()) == {1}
    assert threads() == before
    with all_threads():
        assert threads() == before


@found
def test_a_small_factorisation_takes_one_thread_and_a_large_one_all() -> None:
    before = threads()
    with threads_for(LARGE - 1):
        assert set(threads()) == {1}
    with one_thread(), threads_for(LARGE):
        assert threads() == before
    assert threads() == before


@found
def test_an_error_puts_them_back() -> None:
    before = threads()
    with pytest.raises(ZeroDivisionError), one_thread():
        raise ZeroDivisionError
    assert threads() == before


@found
def test_blocks_of_several_threads_overlap() -> None:
    """The first that is left leaves the others at one; the last puts back what was before the first."""
    before, entered = threads(), Barrier(2)

    def short() -> list[int]:
        with one_thread():
            entered.wait(10)
        return threads()

    with one_thread(), ThreadPoolExecutor(1) as pool:
        told = pool.submit(short)
        entered.wait(10)
        assert set(told.result()) == {1}
    assert threads() == before


@found
def test_an_estimate_takes_one_and_puts_them_back() -> None:
    before, seen = threads(), []
    record = demo.simulate().record
    Deconvolution(demo.model(), progress=lambda share, text: seen.append(threads())).estimate(record)
    assert seen
    assert all(set(now) == {1} for now in seen)
    assert threads() == before
