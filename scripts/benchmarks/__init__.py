"""The parts of ``scripts/benchmark.py``: each module measures one part and returns its figures."""

import os

# One thread for BLAS: long sums are no quicker with more, and where other work keeps the cores busy
# threads that wait for each other make the one large optimisation ten times slower than it is.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
