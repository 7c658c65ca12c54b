"""Entry point of the program: it handles interrupts first, and imports slow modules only after that."""

from __future__ import annotations

import io
import os
import signal
import sys
from typing import TYPE_CHECKING, NoReturn

from pipeline.engine.process_setup import limit_garbage_collection, limit_library_threads

if TYPE_CHECKING:
    from types import FrameType

INTERRUPTED = 130
INTERRUPT_MESSAGE = "trueroll: interrupted; nothing half-written is left\n"
# Delay after which a lost interrupt is raised again, s.
RERAISE_S = 0.05


def main() -> NoReturn:
    """Run the program and exit: 0 success, 1 some of it failed, 2 wrong usage, 130 interrupted."""
    signal.signal(signal.SIGINT, _exit_at_once)
    limit_library_threads()
    limit_garbage_collection()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a file name may not be valid text
    from pipeline.cli.execute import execute_command_line  # slow to import: a second or more

    signal.signal(signal.SIGTERM, _exit_cleanly)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    hook, sys.unraisablehook = sys.unraisablehook, _raise_interrupt_again
    try:
        status = execute_command_line(sys.argv[1:])
    except KeyboardInterrupt:
        status = INTERRUPTED
    finally:
        sys.unraisablehook = hook
        signal.signal(signal.SIGINT, _exit_at_once)
    if status == INTERRUPTED:
        sys.stderr.write(INTERRUPT_MESSAGE)
    sys.exit(status)


def _exit_at_once(number: int, frame: FrameType | None) -> NoReturn:
    """Exit on an interrupt during the imports or the exit, without an exception.

    Nothing needs a clean-up then, and the interpreter would lose the exception or print a traceback.
    """
    os.write(2, INTERRUPT_MESSAGE.encode())
    os._exit(INTERRUPTED)


def _exit_cleanly(number: int, frame: FrameType | None) -> NoReturn:
    """Exit with all clean-up after SIGTERM, `number` being that signal or the alarm that repeats it."""
    sys.exit(128 + signal.SIGTERM)


def _raise_interrupt_again(unraisable: sys.UnraisableHookArgs) -> None:
    """Raise an interrupt, or the exit of SIGTERM, again that came within a finaliser, where Python ignores it."""
    handlers = {KeyboardInterrupt: signal.default_int_handler, SystemExit: _exit_cleanly}
    if unraisable.exc_type in handlers and hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, handlers[unraisable.exc_type])
        signal.setitimer(signal.ITIMER_REAL, RERAISE_S)
    else:
        sys.__unraisablehook__(unraisable)


if __name__ == "__main__":
    main()
