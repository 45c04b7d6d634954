"""One thread for the linear algebra of the tests: their matrices are small, and waiting threads only cost time.

Bytecode is kept even where the environment says otherwise: every process that a test starts would compile the packages
again, and every run rewrite the assertions of all tests. ``-n auto`` starts one process more than there are processors:
tests that wait for servers, pipes and kills leave theirs free.
"""

import os
import sys

import pytest

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Of ``-n auto``."""
    del config
    return (os.cpu_count() or 1) + 1
