"""The corrections file: what is written is read back; whatever else is there gets one sentence."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from models.core.corrections import (
    BallMark,
    BallPlace,
    ContactCorrection,
    Corrections,
    RallyCorrection,
    TrackEdit,
)
from models.core.errors import OptionError
from models.core.naming import Naming
from pipeline.io.corrections_file import (
    SCHEMA,
    CorrectionsFile,
    corrections_path,
    format_corrections_file,
    parse_corrections,
    read_corrections,
    write_corrections,
)
from pipeline.reporting.text.fit_sentences import format_corrections

CUE, RED = BallPlace(12, 100.5, 80.25, "cue"), BallPlace(12, 140.0, 81.0)
EVERYTHING = Corrections(
    corners=((10.0, 10.5), (200.0, 11.0), (201.0, 110.0), (9.0, 111.0)),
    sport="badminton",
    table="2.54x1.27",
    ball_radius=0.028575,
    fps="30000/1001",
    balls=(BallMark("placed", CUE, last=40), BallMark("false", RED)),
    tracks=(
        TrackEdit("rename", CUE, name="white-1"),
        TrackEdit("class", RED, name="red"),
        TrackEdit("merge", CUE, RED),
        TrackEdit("split", CUE, first=20),
        TrackEdit("swap", CUE, RED, first=5, last=9),
    ),
    contacts=(
        ContactCorrection("mark", "ball", 12.5, CUE, RED),
        ContactCorrection("move", "cushion", 20.0, CUE, cushion="left", to_frame=21.25),
        ContactCorrection("delete", "strike", 3.0, CUE),
    ),
    events=(
        RallyCorrection("mark", "landing", 153.0),
        RallyCorrection("move", "hit", 47.5, 49.0),
        RallyCorrection("delete", "net", 88.0),
    ),
)


def test_every_correction_is_read_as_it_was_written(tmp_path: Path) -> None:
    clip = tmp_path / "shot.mp4"
    content = CorrectionsFile(7, "ab" * 32, EVERYTHING)
    write_corrections(clip, content)
    assert corrections_path(clip).name == "shot.mp4.corrections.json"
    assert read_corrections(clip, "ab" * 32) == content
    assert [path.name for path in tmp_path.iterdir()] == ["shot.mp4.corrections.json"]


def test_a_person_can_read_the_file_one_line_per_correction() -> None:
    lines = format_corrections_file(CorrectionsFile(1, "", EVERYTHING)).splitlines()
    assert sum('"kind"' in line for line in lines) == 13
    assert max(map(len, lines)) < 200


def test_no_file_means_no_corrections(tmp_path: Path) -> None:
    assert read_corrections(tmp_path / "shot.mp4") == CorrectionsFile()


def test_the_corrections_of_another_clip_are_refused(tmp_path: Path) -> None:
    clip = tmp_path / "shot.mp4"
    write_corrections(clip, CorrectionsFile(1, "ab" * 32, EVERYTHING))
    with pytest.raises(OptionError, match=r"belongs to another clip than shot\.mp4"):
        read_corrections(clip, "cd" * 32)


BALL = {"frame": 1, "x_px": 5.0, "y_px": 6.0}
HOSTILE = {
    "no JSON": "{",
    "another value": "[]",
    "no schema": "{}",
    "unknown key": {"colour": "red"},
    "text for a list": {"balls": "none"},
    "number for an object": {"balls": [3]},
    "missing ball": {"balls": [{"kind": "false"}]},
    "unknown kind": {"balls": [{"kind": "maybe", "ball": BALL}]},
    "fractional frame": {"balls": [{"kind": "false", "ball": BALL | {"frame": 1.5}}]},
    "negative frame": {"balls": [{"kind": "false", "ball": BALL | {"frame": -1}}]},
    "truth for a number": {"balls": [{"kind": "false", "ball": BALL | {"x_px": True}}]},
    "not a number": f'{{"schema": "{SCHEMA}", "ball_radius": NaN}}',
    "huge number": f'{{"schema": "{SCHEMA}", "ball_radius": 1{"0" * 400}}}',
    "three corners": {"corners": [[0, 0], [1, 0], [1, 1]]},
    "a path for a name": {"tracks": [{"kind": "rename", "ball": BALL, "name": "../../etc/passwd"}]},
    "markup for a name": {"tracks": [{"kind": "rename", "ball": BALL, "name": "<b>"}]},
    "cushion for a name": {"tracks": [{"kind": "rename", "ball": BALL, "name": "left"}]},
    "unknown class": {"tracks": [{"kind": "class", "ball": BALL, "name": "purple"}]},
    "merge with nothing": {"tracks": [{"kind": "merge", "ball": BALL}]},
    "backward span": {"tracks": [{"kind": "swap", "ball": BALL, "other": BALL, "first": 9, "last": 2}]},
    "contact with nothing": {"contacts": [{"kind": "mark", "cause": "ball", "frame": 1, "ball": BALL}]},
    "unknown cushion": {"contacts": [{"kind": "mark", "cause": "cushion", "frame": 1, "ball": BALL, "cushion": "up"}]},
    "move to nowhere": {"contacts": [{"kind": "move", "cause": "strike", "frame": 1, "ball": BALL}]},
    "ball of no size": {"ball_radius": 0},
    "deep nesting": "[" * 100_000,
    "binary": b"\xff\xfe\x00",
    "too large": " " * 2_100_000,
}


@pytest.mark.parametrize("content", HOSTILE.values(), ids=HOSTILE)
def test_a_malformed_file_gets_one_sentence(content: object, tmp_path: Path) -> None:
    clip = tmp_path / "shot.mp4"
    text = json.dumps({"schema": SCHEMA, **content}) if isinstance(content, dict) else content
    corrections_path(clip).write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(OptionError) as caught:
        read_corrections(clip)
    sentence = str(caught.value)
    assert sentence.startswith(f"{corrections_path(clip)} is no corrections file: ")
    assert sentence.endswith("; mend it, or move it away")
    assert "\n" not in sentence
    assert len(sentence) < len(str(tmp_path)) + 400


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"zzz": 1}, "zzz: there is no such key"),
        ({"balls": [{"kind": "false", "ball": BALL | {"q": 2}}]}, "balls.0.ball.q: there is no such key"),
        ({"ball_radius": -1}, "balls have a diameter of more than 0 mm; got -2000 mm (ball_radius -1 m)"),
    ],
)
def test_a_mistake_is_named_as_it_was_written(content: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(words)}$"):
        parse_corrections({"schema": SCHEMA, **content})


def test_a_file_that_cannot_be_written_gets_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OptionError, match="Corrections are saved beside the clip"):
        write_corrections(tmp_path / "file" / "shot.mp4", CorrectionsFile())


def test_a_shot_of_a_recording_gets_its_part() -> None:
    part = EVERYTHING.select_span(10, 30)
    assert part.corners == EVERYTHING.corners
    assert part.balls == EVERYTHING.balls
    assert [edit.first for edit in part.tracks] == [None, None, None, 20, 5]
    assert [mark.at for mark in part.contacts] == [12.5, 21.25]
    assert EVERYTHING.select_span(13, 30).tracks == ()


def test_a_file_without_its_head_is_accepted() -> None:
    content = parse_corrections({"schema": SCHEMA, "fps": "25"})
    assert content == CorrectionsFile(corrections=Corrections(fps="25"))


@pytest.mark.parametrize(("sport", "surface"), [(None, "table"), ("billiards", "table"), ("tennis", "court")])
def test_corrections_are_said_in_phrases(sport: str | None, surface: str) -> None:
    corners, *others = format_corrections(replace(EVERYTHING, sport=sport), Naming())
    assert corners == f"the corners of the {surface}"
    assert ("the sport, tennis" in others) == (sport == "tennis")
    assert others[-3:] == ["landing at frame 153.0", "hit at frame 49.0, not 47.5", "no touch of the net at frame 88.0"]


def test_a_move_across_the_border_of_a_part_says_in_each_what_it_says_there() -> None:
    marks = Corrections(events=(RallyCorrection("move", "hit", 30, 15), RallyCorrection("move", "net", 12, 14)))
    first, second = marks.select_span(10, 20).events, marks.select_span(20, 40).events
    assert first == (RallyCorrection("mark", "hit", 15), marks.events[1])
    assert second == (RallyCorrection("delete", "hit", 30),)
