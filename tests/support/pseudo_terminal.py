"""The program as someone at a terminal meets it, in this process."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from pipeline.cli.main import main


@dataclass(frozen=True, slots=True)
class Said:
    """What the program printed and how it left."""

    status: int
    out: str
    err: str


Terminal = Callable[..., Said]


def terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Terminal:
    """A function that runs `trueroll ARGUMENTS...`."""

    def trueroll(*arguments: object) -> Said:
        monkeypatch.setattr(sys, "argv", ["trueroll", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            main()
        out, err = capsys.readouterr()
        return Said(int(left.value.code or 0), out, err)

    return trueroll
