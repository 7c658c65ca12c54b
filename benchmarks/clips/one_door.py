"""Do `check` and `run` say the same of table, balls and view of clips?

    python -m benchmarks.clips.one_door FOLDER_OR_CLIP...

Compares the door of a run alone (the shot, its table and the balls of a frame; no fit, no drawing) with the answer of
`check`: the refusal, the table, its corners, and the number of balls. Prints a row per clip, and where the answers
differ. Takes about 10 s a clip; `varied_clips` renders a folder of clips.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.stress_cases.stress_chain import SilentWatcher
from detectors.detect import prepare_detector
from models.core.errors import TruerollError
from pipeline.actions.check_clip import check_clip
from pipeline.batch.clip_discovery import VIDEO_SUFFIXES
from pipeline.engine.result_cache import ResultCache
from pipeline.recording_shots import LONGEST_SHOT, find_recording_shots, order_shots
from pipeline.run_options import RunOptions
from video.calibration.table_finder import calibrate_clip
from video.io.clip import open_clip, read_frames


@dataclass(frozen=True)
class DoorAnswer:
    """What is said of a clip before anything is fitted."""

    refusal: str
    table: str = ""
    corners: tuple[int, ...] = ()
    ball_count: int = 0


def answer_as_run(path: Path, frame: int) -> DoorAnswer:
    """Read, choose the shot, calibrate and detect as a run does; the balls are those of one frame of the file."""
    options, refusals = RunOptions(), list[str]()
    try:
        with tempfile.TemporaryDirectory() as folder:
            recording = find_recording_shots(path, options, ResultCache(Path(folder)), SilentWatcher())
        parts = [shot.clip for shot in order_shots(recording, LONGEST_SHOT)] if recording.shots else [open_clip(path)]
    except TruerollError as error:
        return DoorAnswer(str(error))
    for clip in parts:
        try:
            scene = calibrate_clip(clip, options.calibrate)
        except TruerollError as error:
            refusals.append(str(error))
            continue
        number = frame if frame in clip.frames else clip.first_frame
        ((_, image),) = read_frames(clip, indices=[number])
        count = len(prepare_detector(clip, scene, options.detect).detect(image, number))
        corners = tuple(np.rint(scene.camera.corners_px).astype(int).ravel().tolist())
        return DoorAnswer("", scene.table.name, corners, count)
    return DoorAnswer(refusals[0])


def answer_as_check(path: Path) -> tuple[DoorAnswer, int]:
    """Return what `check` says, and the frame whose balls it counts."""
    try:
        report = check_clip(path)
    except TruerollError as error:
        return DoorAnswer(str(error)), 0
    scene = report.view.scene
    if report.refusal or scene is None:
        return DoorAnswer(report.refusal), report.clip.first_frame
    corners = tuple(np.rint(report.view.corners).astype(int).ravel().tolist())
    frame = report.clip.first_frame + int(report.detections.frame.min()) if len(report.detections) else 0
    return DoorAnswer("", scene.table.name, corners, report.ball_count), frame


def main(arguments: list[str] | None = None) -> int:
    """Compare both on all clips; the exit status is 1 where they differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="+", type=Path)
    clips = [clip for path in parser.parse_args(arguments).paths for clip in _list_clips(path)]
    different = 0
    for clip in clips:
        checked, frame = answer_as_check(clip)
        run = answer_as_run(clip, frame)
        print(f"{clip.parent.name}/{clip.name}: {_format_answer(run)}", flush=True)
        if checked != run:
            different += 1
            print(f"  DIFFERS: check says {_format_answer(checked)}", flush=True)
    print(f"{len(clips) - different} of {len(clips)} clips: the same answer")
    return int(different > 0)


def _list_clips(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    return sorted(one for one in path.rglob("*") if one.suffix.lower() in VIDEO_SUFFIXES)


def _format_answer(answer: DoorAnswer) -> str:
    return answer.refusal or f"{answer.table}, corners {answer.corners}, {answer.ball_count} balls"


if __name__ == "__main__":
    sys.exit(main())
