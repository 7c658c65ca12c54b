"""Do `check`, `run`, `detect` and `put-back` say the same of table, balls and view of clips?

    python -m benchmarks.clips.one_door FOLDER_OR_CLIP...
    python -m benchmarks.clips.one_door --rendered 300 [--seed 7] [--first 0]

Compares the door of a run alone (the shot, its table and the balls of a frame; no fit, no drawing) with the answer of
`check`, and with what `detect` finds in that frame as a still image and `put-back --live` in the calibrated view: the
refusal, the table, its corners, and the number of balls. Prints a row per clip, and where the answers differ. Takes
about 10 s a clip; `--rendered` draws clips of `varied_clips` itself, of the first frames alone.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from benchmarks.clips.varied_clips import render_clip
from benchmarks.stress_cases.stress_chain import SilentWatcher
from detectors.detect import detect_in_image, prepare_detector
from models.core.errors import TruerollError
from models.core.naming import Naming
from models.core.scene import Scene
from models.core.typing import ImageArray
from models.estimation.ball_places import BallPlaces
from pipeline.actions.check_clip import check_clip
from pipeline.actions.put_back import PlacementGuide, WantedPlaces
from pipeline.batch.clip_discovery import VIDEO_SUFFIXES
from pipeline.engine.result_cache import ResultCache
from pipeline.recording_shots import LONGEST_SHOT, find_recording_shots, order_shots
from pipeline.run_options import RunOptions
from video.calibration.table_finder import calibrate_clip, calibrate_image
from video.io.clip import open_clip, read_frames

# Frames of a rendered clip: `check` needs 12, and the strike is in the tenth at the latest.
RENDERED_FRAMES = 14
# Distance of a corner up to which a still image shows the table where the clip does: what covers a rail is gone in the
# median of a clip, and a corner of USER_CORNER_SIGMA_PX = 2 px is a good one.
SAME_CORNERS_PX = 3.0


@dataclass(frozen=True)
class DoorAnswer:
    """What is said of a clip before anything is fitted."""

    refusal: str
    table: str = ""
    corners: tuple[int, ...] = ()
    ball_count: int = 0


@dataclass(frozen=True)
class CalibratedFrame:
    """One frame of a clip, and the scene by which a run sees it."""

    image: ImageArray
    scene: Scene


def answer_as_run(path: Path, frame: int) -> tuple[DoorAnswer, CalibratedFrame | None]:
    """Read, choose the shot, calibrate and detect as a run does; the balls are those of one frame of the file."""
    options, refusals = RunOptions(), list[str]()
    try:
        with tempfile.TemporaryDirectory() as folder:
            recording = find_recording_shots(path, options, ResultCache(Path(folder)), SilentWatcher())
        parts = [shot.clip for shot in order_shots(recording, LONGEST_SHOT)] if recording.shots else [open_clip(path)]
    except TruerollError as error:
        return DoorAnswer(str(error)), None
    for clip in parts:
        try:
            scene = calibrate_clip(clip, options.calibrate)
        except TruerollError as error:
            refusals.append(str(error))
            continue
        number = frame if frame in clip.frames else clip.first_frame
        ((_, image),) = read_frames(clip, indices=[number])
        count = len(prepare_detector(clip, scene, options.detect).detect(image, number))
        return _answer_of_scene(scene, count), CalibratedFrame(image, scene)
    return DoorAnswer(refusals[0]), None


def answer_as_check(path: Path) -> tuple[DoorAnswer, int]:
    """Return what `check` says, and the frame whose balls it counts."""
    try:
        report = check_clip(path)
    except TruerollError as error:
        return DoorAnswer(str(error)), 0
    scene = report.view.scene
    if report.refusal or scene is None:
        return DoorAnswer(report.refusal), report.clip.first_frame
    frame = report.clip.first_frame + int(report.detections.frame.min()) if len(report.detections) else 0
    return _answer_of_scene(scene, report.ball_count), frame


def answer_as_detect(frame: CalibratedFrame) -> DoorAnswer:
    """Locate the table and the balls in a frame alone, as `detect` does."""
    options = RunOptions()
    try:
        scene = calibrate_image(frame.image, options.calibrate, "the frame")
    except TruerollError as error:
        return DoorAnswer(str(error))
    return _answer_of_scene(scene, len(detect_in_image(frame.image, scene, options.detect)))


def answer_as_put_back(frame: CalibratedFrame) -> DoorAnswer:
    """Look for balls in a frame of the calibrated view, as `put-back --live` does; no ball has a place."""
    scene, none = frame.scene, np.empty((0, 2))
    places = BallPlaces(0.0, (), (), none, none[:, 0], none[:, 0])
    wanted = WantedPlaces(places, none, scene.table, Naming(), scene.camera, 0.0, frame.image, "")
    try:
        state = PlacementGuide.prepare(wanted, np.asarray(scene.cloth_lab)).compare_image(frame.image)
    except TruerollError as error:
        return DoorAnswer(str(error))
    return _answer_of_scene(replace(scene, camera=state.camera), len(state.extra))


def list_differences(path: Path) -> tuple[DoorAnswer, dict[str, DoorAnswer]]:
    """Return what a run says of a clip, and the answers of the commands that say something else."""
    checked, number = answer_as_check(path)
    run, frame = answer_as_run(path, number)
    different = {} if checked == run else {"check": checked}
    if frame is not None:
        stills = {"detect": answer_as_detect(frame), "put-back": answer_as_put_back(frame)}
        different |= {name: answer for name, answer in stills.items() if not _is_same_still(answer, run)}
    return run, different


def main(arguments: list[str] | None = None) -> int:
    """Compare all on all clips; the exit status is 1 where they differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--rendered", type=int, default=0, help="number of rendered clips")
    parser.add_argument("--seed", type=int, default=7, help="seed of the rendered clips")
    parser.add_argument("--first", type=int, default=0, help="number of the first rendered clip")
    options = parser.parse_args(arguments)
    count, different = 0, Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        for clip in _iterate_clips(options, Path(folder)):
            run, others = list_differences(clip)
            count += 1
            print(f"{clip.parent.name}/{clip.name}: {_format_answer(run)}", flush=True)
            for name, answer in others.items():
                different[name] += 1
                print(f"  DIFFERS: {name} says {_format_answer(answer)}", flush=True)
    print(f"{count} clips; other answers than run: {dict(different) or 0}")
    return int(bool(different))


def _iterate_clips(options: argparse.Namespace, scratch: Path) -> Iterator[Path]:
    for path in options.paths:
        yield from (
            [path] if path.is_file() else sorted(one for one in path.rglob("*") if one.suffix.lower() in VIDEO_SUFFIXES)
        )
    with Progress(console=Console(quiet=True)) as bar:
        for number in range(options.first, options.first + options.rendered):
            clip = render_clip(options.seed, number, scratch, bar, RENDERED_FRAMES)
            yield clip
            clip.unlink()


def _answer_of_scene(scene: Scene, ball_count: int) -> DoorAnswer:
    corners = tuple(np.rint(scene.camera.corners_px).astype(int).ravel().tolist())
    return DoorAnswer("", scene.table.name, corners, ball_count)


def _is_same_still(still: DoorAnswer, run: DoorAnswer) -> bool:
    """Return whether a frame alone shows what the clip shows; neither command names a table."""
    if still.refusal or still.ball_count != run.ball_count:
        return False
    return bool(np.abs(np.subtract(still.corners, run.corners)).max() <= SAME_CORNERS_PX)


def _format_answer(answer: DoorAnswer) -> str:
    return answer.refusal or f"{answer.table}, corners {answer.corners}, {answer.ball_count} balls"


if __name__ == "__main__":
    sys.exit(main())
