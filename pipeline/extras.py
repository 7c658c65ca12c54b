"""The extras of the package: what a command needs beyond the ordinary installation."""

from __future__ import annotations

import sys


def name_remedy(extra: str) -> str:
    """Name the command that installs an extra, as the end of a sentence."""
    return f"install trueroll with the extra {extra}: {sys.executable} -m pip install 'trueroll[{extra}]'"
