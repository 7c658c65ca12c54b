"""The program: it can be interrupted from its first moment on, and imports what is heavy only after that."""

from __future__ import annotations

import gc
import io
import os
import signal
import sys
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from types import FrameType

INTERRUPTED = 130
FAREWELL = "trueroll: interrupted; nothing half-written is left\n"
ALGEBRA = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""What numpy's libraries ask for their number of threads."""
WAITING = ("OPENCV_THREAD_POOL_ACTIVE_WAIT_WORKER", "OPENCV_THREAD_POOL_ACTIVE_WAIT_MAIN")
"""For how many turns OpenCV's threads wait for each other without letting anybody else run."""
COLLECT_EVERY = 20_000
"""Objects made beyond those freed, between two looks for garbage in cycles: Python's own 700 are for small programs."""
AGAIN_S = 0.05
"""s after which an interrupt that was swallowed is raised again."""


def main() -> NoReturn:
    """The program: 0 all went well, 1 some of it failed, 2 wrong usage, 130 interrupted."""
    signal.signal(signal.SIGINT, _drop)
    spare_threads()
    spare_collections()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a file's name may be no text
    from pipeline.execute import execute  # heavy: a second or more

    signal.signal(signal.SIGTERM, _leave)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    hook, sys.unraisablehook = sys.unraisablehook, _insist
    try:
        status = execute(sys.argv[1:])
    except KeyboardInterrupt:
        status = INTERRUPTED
    finally:
        sys.unraisablehook = hook
        signal.signal(signal.SIGINT, _drop)
    if status == INTERRUPTED:
        sys.stderr.write(FAREWELL)
    sys.exit(status)


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


def _drop(number: int, frame: FrameType | None) -> NoReturn:
    """Interrupted while importing or while leaving: nothing needs cleaning up, and the interpreter would swallow or
    dress up an exception."""
    os.write(2, FAREWELL.encode())
    os._exit(INTERRUPTED)


def _leave(number: int, frame: FrameType | None) -> NoReturn:
    """Asked to stop: leave by way of every clean-up."""
    sys.exit(128 + number)


def _insist(unraisable: sys.UnraisableHookArgs) -> None:
    """An interrupt that came within a finaliser is lost to Python: raise it once more, where it counts."""
    if unraisable.exc_type is KeyboardInterrupt and hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, signal.default_int_handler)
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
    else:
        sys.__unraisablehook__(unraisable)


if __name__ == "__main__":
    main()
