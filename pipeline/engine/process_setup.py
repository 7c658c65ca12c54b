"""Settings of a computing process: cores, threads of the libraries, garbage collection; imports nothing heavy."""

from __future__ import annotations

import gc
import os
import sys

# Environment variables with the number of threads of the linear algebra libraries behind numpy.
THREAD_COUNT_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
# Environment variables with the number of iterations for which OpenCV's threads wait busily for each other.
ACTIVE_WAIT_VARIABLES = ("OPENCV_THREAD_POOL_ACTIVE_WAIT_WORKER", "OPENCV_THREAD_POOL_ACTIVE_WAIT_MAIN")
# File with the memory limit of the control group in bytes, or "max"; Linux, version 2 of control groups.
CGROUP_LIMIT = "/sys/fs/cgroup/memory.max"
# Net number of new objects that starts a garbage collection. Python's default is 700, which suits small programs.
COLLECTION_THRESHOLD = 20_000


def available_cores() -> int:
    """Count the processor cores that this process may use.

    Returns:
        The size of the CPU affinity mask where the system has one, which containers and job schedulers restrict; else
        the number of cores of the machine.
    """
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def available_memory() -> int:
    """Measure the memory that new data can take without swapping, bytes.

    Returns:
        What the system has available, at most the limit of the control group, which containers set.
    """
    import psutil  # this module is imported before anything else

    available = int(psutil.virtual_memory().available)
    try:
        with open(CGROUP_LIMIT, encoding="ascii") as file:
            limit = file.read().strip()
    except OSError:
        return available
    return min(available, int(limit)) if limit.isdigit() else available


def limit_library_threads() -> None:
    """Run linear algebra on one thread and let waiting threads of OpenCV sleep; call it before numpy is imported.

    The matrices here are small, and on a busy machine threads that wait for each other cost ten times what they save.
    Sleeping threads of OpenCV save a fourteenth of the CPU time of a clip (measured). Variables that the user has set
    are left as they are.
    """
    for name in THREAD_COUNT_VARIABLES:
        os.environ.setdefault(name, "1")
    for name in ACTIVE_WAIT_VARIABLES:
        os.environ.setdefault(name, "0")


def limit_garbage_collection() -> None:
    """Collect garbage rarely: arrays are freed without it, and each collection visits every object of every import.

    It saves a thirtieth of the CPU time of a clip (measured).
    """
    gc.set_threshold(COLLECTION_THRESHOLD)
