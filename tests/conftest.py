"""One thread for the linear algebra of the tests: their matrices are small, and waiting threads only cost time.

Bytecode is kept even where the environment says otherwise: every process that a test starts would compile the packages
again, and every run rewrite the assertions of all tests. What is there once the tests are collected (modules, and some
13 000 tests) stays to the end, and is no business of the garbage collector.
"""

import gc
import os
import sys

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


def pytest_collection() -> None:
    gc.disable()


def pytest_collection_finish() -> None:
    gc.enable()
    gc.freeze()
