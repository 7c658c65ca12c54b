"""Corrections by hand in a run: what they beat, what they make anew; test_repairs_in_browser.py makes them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from support.planted_mistakes import OPTIONS, SilentWatcher
from support.sample_clips import SAMPLES

from models.core.corrections import BallMark, BallPlace, ContactCorrection, Corrections, TrackEdit
from models.core.errors import COMMAND_REMEDIES, OptionError
from pipeline.batch.clip_job import ClipJob
from pipeline.batch.clip_run import run_job
from pipeline.chain import build_shot_graph, honour_corrections
from pipeline.engine.result_cache import ResultCache
from pipeline.io.corrections_file import CorrectionsFile, corrections_path, write_corrections
from pipeline.reporting.text.text_formatting import format_error
from pipeline.run_options import apply_corrections, build_options, list_overridden_flags, list_setting_values


def test_the_command_line_beats_the_file_and_the_file_beats_the_defaults(tmp_path: Path) -> None:
    clip = tmp_path / "shot.mp4"
    write_corrections(clip, CorrectionsFile(1, "", Corrections(fps="25", table="pool-8ft", ball_radius=0.0286)))
    typed = build_options({"fps": "50", "ball_radius": None})
    honoured = honour_corrections(clip, "ab", typed)
    assert (honoured.read.fps, honoured.calibrate.table, honoured.calibrate.ball_radius) == ("50", "pool-8ft", 0.0286)
    assert honour_corrections(tmp_path / "other.mp4", "ab", typed) == typed


def test_what_the_command_line_beats_is_named_and_is_no_correction_of_the_run(tmp_path: Path) -> None:
    corners = ((10.0, 10.0), (200.0, 10.0), (200.0, 100.0), (10.0, 100.0))
    by_hand = Corrections(fps="25", table="pool-8ft", corners=corners)
    typed = build_options({"table": "pool-9ft", "corners": "10,10, 200,10.0, 200,100, 10,100", "ball_radius": 0.03})
    assert list_overridden_flags(typed, by_hand) == ("--table",)
    assert apply_corrections(typed, by_hand).corrections == Corrections(fps="25")


def test_a_correction_that_cannot_be_used_is_refused_in_the_words_of_each_front_end() -> None:
    with pytest.raises(OptionError) as caught:
        apply_corrections(build_options({}), Corrections(ball_radius=3.0))
    command, page = (format_error(caught.value, for_page=for_page) for for_page in (False, True))
    assert command == f"{page}; {COMMAND_REMEDIES['radius']}"
    assert page.startswith("The corrections of the clip set ball_radius to 3.0: balls are ")
    assert "--" not in page


PLACE = BallPlace(3, 100.0, 50.0)
FIRST_STAGES: dict[str, tuple[Corrections, str]] = {
    "fps": (Corrections(fps="25"), "read"),
    "corners": (Corrections(corners=((10, 10), (200, 10), (200, 100), (10, 100))), "calibrate"),
    "table": (Corrections(table="pool-8ft"), "calibrate"),
    "ball radius": (Corrections(ball_radius=0.02), "calibrate"),
    "placed ball": (Corrections(balls=(BallMark("placed", PLACE),)), "place"),
    "false ball": (Corrections(balls=(BallMark("false", PLACE),)), "track"),
    "track": (Corrections(tracks=(TrackEdit("rename", PLACE, name="nine"),)), "track"),
    "contact": (Corrections(contacts=(ContactCorrection("delete", "strike", 3.0, PLACE),)), "explain"),
}


@pytest.mark.parametrize(("corrections", "first"), FIRST_STAGES.values(), ids=FIRST_STAGES)
def test_a_correction_changes_the_key_of_its_stage_and_of_none_before(
    corrections: Corrections, first: str, tmp_path: Path
) -> None:
    clip = Path(shutil.copy(SAMPLES / "overhead_pool.mp4", tmp_path))

    def keys() -> dict[str, tuple[object, ...]]:
        stages = build_shot_graph(clip, OPTIONS).stages
        return {one.name: (json.dumps([one.json_options, one.facts], sort_keys=True), one.needs) for one in stages}

    before = keys()
    write_corrections(clip, CorrectionsFile(1, "", corrections))
    after = keys()
    changed = [name for name in after if after[name] != before.get(name)]
    assert changed[0] == first


def test_a_hostile_corrections_file_fails_one_clip_of_a_batch_with_a_sentence(tmp_path: Path) -> None:
    clip = Path(shutil.copy(SAMPLES / "overhead_pool.mp4", tmp_path))
    corrections_path(clip).write_text('{"schema": "trueroll.corrections/1", "balls": 3}')
    cache = ResultCache(tmp_path / "cache")
    job = ClipJob(str(clip), "shot", str(tmp_path / "out"), str(cache.root), cache.mark, list_setting_values(OPTIONS))
    result = run_job(job, SilentWatcher())
    assert result.status == "failed"
    assert (
        "is no corrections file: balls: input should be a valid array; got 3; mend it, or move it away"
        in result.sentence
    )
    assert not (tmp_path / "out").exists()
