"""Spoilt track folders of every scene: a diagnosis ends in a report or in one sentence, whatever the numbers are."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.degenerate_tracks import COORDINATES, SPOILERS, make_tracks, write_track_folder

from diagnosis.diagnose import diagnose
from diagnosis.verdicts.verdict import DiagnosisReport
from models.core.errors import OptionError
from pipeline.io.gap_files import build_gap_document
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import build_gap_scene

REFUSED = ("decreasing times", "no places")
"""A file with these is refused when it is read."""
IMPOSSIBLE = {
    "slide": ("places times 1e6", "times times 1e-6", "wild motion", "30000 frames per second"),
    "flight": ("places times 1e6", "times times 1e-6", "30000 frames per second"),
    "pendulum": ("wild motion", "equal times"),
    "billiards": ("places times 1e6",),
}
"""Nothing slides, falls or swings like that: the file is refused for the speed, the fall or the unit of its angles. Of
equal times, a shot is left out; the swings of this file are one shot.
"""
UNDECIDABLE = ("constant places", "noise alone", "one sample")
SLOW_WITH_CONTACTS = (
    "30000 frames per second", "an empty shot", "infinite places", "missing places", "rounded places", "wild motion",
)  # fmt: skip
"""In billiards, these take five to fifteen seconds each."""
ALTERNATING = {name: ("flight", "pendulum")[k % 2] for k, name in enumerate(SPOILERS)}
"""Flight and pendulum share their code with sliding: each spoiler is tried on one of them."""
CASES = [
    pytest.param(scene, name, marks=[pytest.mark.slow] * (scene == "billiards" and name in SLOW_WITH_CONTACTS))
    for scene in COORDINATES
    for name in SPOILERS
    if scene in ("slide", "billiards", ALTERNATING[name])
]


def diagnose_spoilt(scene: str, name: str, folder: Path) -> DiagnosisReport | str:
    """Return the report on a spoilt folder, or the sentence with which it is refused."""
    rng = np.random.default_rng(list(SPOILERS).index(name))
    columns = make_tracks(scene, rng)
    SPOILERS[name](scene, columns, rng)
    try:
        read = read_track_folders([write_track_folder(folder, scene, columns)])
    except OptionError as error:
        return str(error)
    return diagnose(build_gap_scene(read), read.recordings)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(("scene", "name"), CASES)
def test_a_spoilt_track_folder_gives_a_report_or_one_sentence(scene: str, name: str, tmp_path: Path) -> None:
    report = diagnose_spoilt(scene, name, tmp_path)
    if name in REFUSED or name in IMPOSSIBLE[scene]:
        assert isinstance(report, str)
        assert "\n" not in report
        return
    assert isinstance(report, DiagnosisReport)
    if name in UNDECIDABLE:
        assert report.verdict == "undecidable"
    assert report.verdict != "undecidable" or report.film_next
    json.dumps(build_gap_document(report), allow_nan=False)
