"""Files appear under their final name in one step, or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def aside(target: Path) -> Iterator[Path]:
    """A hidden path beside `target` to write to; it takes the target's name at the end, or is gone after an error."""
    path = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        yield path
        os.replace(path, target)
    finally:
        path.unlink(missing_ok=True)
