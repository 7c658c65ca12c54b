"""The start of a sample clip, and its quick run, which the tests of a session share."""

from __future__ import annotations

import csv
import json
import shutil
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from support.pseudo_terminal import ProgramOutput
from support.sample_clips import SAMPLES

from pipeline.cli.main import main
from pipeline.terminal.progress_display import COMPILING_NOTE

SAMPLE = SAMPLES / "carom_match.mp4"
SECONDS = 1.5
"""Used part of the sample, s: a strike, a contact of two balls and one with a cushion."""
SLOW = 4


def run_program(*words: object) -> ProgramOutput:
    """Run `trueroll WORDS...` in this process."""
    out, err = StringIO(), StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr("sys.argv", ["trueroll", *map(str, words)])
        patch.setenv("COLUMNS", "200")
        with pytest.raises(SystemExit) as exit_info:
            main()
    return ProgramOutput(int(exit_info.value.code or 0), out.getvalue(), err.getvalue())


@dataclass(frozen=True)
class Home:
    """A folder with a clip, a cache, and the results of a run."""

    folder: Path

    @property
    def clip(self) -> Path:
        return self.folder / "clips" / "start.mp4"

    @property
    def out(self) -> Path:
        return self.folder / "out"

    @property
    def cache(self) -> Path:
        return self.folder / "cache"

    def copy_to(self, folder: Path) -> Home:
        """Copy the clip and the cache, without the results."""
        for place in (self.clip.parent, self.cache):
            shutil.copytree(place, folder / place.name)
        return Home(folder)

    def trueroll(self, command: str, *arguments: object) -> ProgramOutput:
        """Run `trueroll COMMAND ARGUMENTS...` in this process."""
        return run_program(command, *arguments, "--cache", self.cache)

    def rows(self, name: str) -> list[dict[str, str]]:
        with (self.out / name).open(newline="") as file:
            return list(csv.DictReader(file))

    def column(self, name: str, column: str) -> np.ndarray:
        return np.array([float(row[column] or "nan") for row in self.rows(name)])

    @property
    def scene(self) -> Any:
        return json.loads((self.out / "scene.json").read_text(), parse_constant=lambda word: pytest.fail(word))


def copy_start(source: Path, target: Path) -> None:
    """Copy the first `SECONDS` of a video without decoding it."""
    with av.open(str(source)) as film, av.open(str(target), "w") as start:
        stream = film.streams.video[0]
        copy = start.add_stream_from_template(stream)
        for packet in film.demux(stream):
            if packet.dts is not None and float(packet.dts * stream.time_base) < SECONDS:
                packet.stream = copy
                start.mux(packet)


def run_start(folder: Path) -> None:
    """Run the start of the sample with `--quick`."""
    home = Home(folder)
    home.clip.parent.mkdir()
    copy_start(SAMPLE, home.clip)
    done = home.trueroll("run", home.clip, "-o", home.out, "--quick", "--slow", SLOW)
    assert done.status == 0, done.err
    assert done.err in ("", f"{COMPILING_NOTE}\n"), f"no progress is printed unless on a terminal: {done.err}"
    assert "slow.mp4" in done.out
