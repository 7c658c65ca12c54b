"""The program: it can be interrupted from its first moment on, and imports what is heavy only after that."""

from __future__ import annotations

import io
import os
import signal
import sys
from typing import TYPE_CHECKING, NoReturn

from pipeline.engine.process_setup import spare_collections, spare_threads

if TYPE_CHECKING:
    from types import FrameType

INTERRUPTED = 130
FAREWELL = "trueroll: interrupted; nothing half-written is left\n"
AGAIN_S = 0.05
"""s after which an interrupt that was swallowed is raised again."""


def main() -> NoReturn:
    """The program: 0 all went well, 1 some of it failed, 2 wrong usage, 130 interrupted."""
    signal.signal(signal.SIGINT, _drop)
    spare_threads()
    spare_collections()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a file's name may be no text
    from pipeline.cli.execute import execute  # heavy: a second or more

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
