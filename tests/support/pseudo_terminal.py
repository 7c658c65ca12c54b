"""The command-line program, run in this process with captured output."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from pipeline.cli.main import main


@dataclass(frozen=True, slots=True)
class ProgramOutput:
    """Exit status and output of the program."""

    status: int
    out: str
    err: str


Terminal = Callable[..., ProgramOutput]


def make_terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Terminal:
    """Return a function that runs `trueroll ARGUMENTS...`."""

    def trueroll(*arguments: object) -> ProgramOutput:
        monkeypatch.setattr(sys, "argv", ["trueroll", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as exit_info:
            main()
        out, err = capsys.readouterr()
        return ProgramOutput(int(exit_info.value.code or 0), out, err)

    return trueroll
