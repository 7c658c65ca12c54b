"""The extras of the package: what a command needs beyond the ordinary installation."""

from __future__ import annotations

import sys
from typing import Any

from models.core.errors import OptionError


def name_remedy(extra: str) -> str:
    """Name the command that installs an extra, as the end of a sentence."""
    return f"install trueroll with the extra {extra}: {sys.executable} -m pip install 'trueroll[{extra}]'"


def import_mcap() -> Any:
    """Import the package mcap with its reader and writer.

    Raises:
        OptionError: It is not installed.
    """
    try:
        import mcap.reader
        import mcap.writer
    except ImportError as error:
        raise OptionError(f"MCAP files need a package that is not installed; {name_remedy('simulators')}") from error
    return mcap
