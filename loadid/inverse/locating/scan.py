"""The same work for every candidate, in threads: the linear algebra leaves the interpreter free."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")
Progress = Callable[[float, str], None]


def over(
    work: Callable[[T], R],
    items: Sequence[T],
    *,
    workers: int | None = None,
    progress: Progress | None = None,
    text: str,
) -> list[R]:
    """Results of `work` for every item, in their order.

    Parameters
    ----------
    work : callable
    items : sequence
    workers : int, optional
        Threads; default the number of processors.
    progress : callable, optional
        Called from this thread as ``progress(fraction, text)`` after each item. What it raises stops the work: nothing
        that has not begun is begun, and nothing is returned.
    text : str
    """
    tell = progress or (lambda fraction, text: None)
    if not items:
        return []
    threads = min(workers or os.cpu_count() or 1, len(items))
    if threads == 1:
        found = []
        for k, item in enumerate(items, 1):
            found.append(work(item))
            tell(k / len(items), text)
        return found
    with ThreadPoolExecutor(threads) as pool:
        futures = [pool.submit(work, item) for item in items]
        try:
            for k, done in enumerate(as_completed(futures), 1):
                done.result()
                tell(k / len(items), text)
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
        return [future.result() for future in futures]
