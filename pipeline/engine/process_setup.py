"""Settings of a process that computes: threads of the libraries, and garbage collection. Imports nothing heavy."""

from __future__ import annotations

import gc
import os

ALGEBRA = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""What numpy's libraries ask for their number of threads."""
WAITING = ("OPENCV_THREAD_POOL_ACTIVE_WAIT_WORKER", "OPENCV_THREAD_POOL_ACTIVE_WAIT_MAIN")
"""For how many turns OpenCV's threads wait for each other without letting anybody else run."""
COLLECT_EVERY = 20_000
"""Objects made beyond those freed, between two looks for garbage in cycles: Python's own 700 are for small programs."""


def spare_threads() -> None:
    """Let linear algebra run on one thread, unless the user says otherwise, before numpy is imported: its matrices are
    small here, and threads that wait for each other on a busy machine cost ten times what they bring. Those of OpenCV
    sleep where they would wait: a fourteenth of what a clip costs."""
    for name in ALGEBRA:
        os.environ.setdefault(name, "1")
    for name in WAITING:
        os.environ.setdefault(name, "0")


def spare_collections() -> None:
    """Look for garbage seldom: pictures and arrays are freed without it, and each look goes over all that imports left
    behind. A thirtieth of what a clip costs."""
    gc.set_threshold(COLLECT_EVERY)
