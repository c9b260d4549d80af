"""What all tests share, those of the plugins too: BLAS keeps to one thread.

Matrices are small here, and the tests run in several processes. Threads of BLAS beyond the first
wait for each other in busy loops, which on busy cores took twenty times the processor time of the
test itself. It is set before anything imports numpy, and what tests start inherits it.
"""

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
