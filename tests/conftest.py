"""One thread for the linear algebra of the tests: their matrices are small, and waiting threads only cost time."""

import os

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")
