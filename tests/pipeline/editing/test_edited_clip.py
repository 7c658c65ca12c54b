"""What is edited: the clip of a run folder, a clip, or one shot of a recording; else one sentence."""

from __future__ import annotations

import json
import re
import weakref
from pathlib import Path

import pytest
from support import synthetic_run

from models.core.errors import ClipError, OptionError
from pipeline.chain import hash_clip, write_source
from pipeline.editing.edited_clip import EditedClip, FrameImages, continue_run_options, find_edited_clip
from pipeline.run_options import RunOptions, build_options


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    path = tmp_path / "shot.mp4"
    path.write_bytes(b"\x00\x00\x00\x18ftypmp42 not really a video")
    return path


def make_run_folder(folder: Path, source: object, **scene: object) -> Path:
    folder.mkdir()
    (folder / "source.json").write_text(json.dumps(source))
    (folder / "scene.json").write_text(json.dumps({"scene": "billiards", **scene}))
    return folder


def test_a_run_folder_names_its_clip(clip: Path, tmp_path: Path) -> None:
    digest = hash_clip(clip)
    folder = make_run_folder(tmp_path / "out", {"path": str(clip)}, clip={"sha256": digest})
    assert find_edited_clip(folder) == EditedClip(clip, folder, digest)


def test_the_settings_of_the_run_need_not_be_given_again(clip: Path, tmp_path: Path) -> None:
    ran = build_options({"corners": "1,2,30,4,30,20,3,19", "detector": "hough", "slow": 4, "no_video": True})
    (tmp_path / "out").mkdir()
    write_source(clip, tmp_path / "out", ran)
    (tmp_path / "out" / "scene.json").write_text(json.dumps({"scene": "billiards"}))
    edited = find_edited_clip(tmp_path / "out")
    assert dict(edited.settings) == {"corners": "1,2,30,4,30,20,3,19", "detector": "hough", "slow": 4}
    options = continue_run_options(edited, build_options({"detector": "onnx"}))
    assert (options.detect.detector, options.calibrate.corners) == ("onnx", "1,2,30,4,30,20,3,19")


@pytest.mark.parametrize("settings", [{"slow": 0.1}, {"fps": [3]}, {"slow": "fast"}])
def test_settings_that_cannot_be_used_get_a_sentence(settings: object, clip: Path, tmp_path: Path) -> None:
    folder = make_run_folder(tmp_path / "out", {"path": str(clip), "settings": settings})
    with pytest.raises(OptionError, match=r"source\.json notes settings that cannot be used: "):
        continue_run_options(find_edited_clip(folder), RunOptions())


def test_a_clip_gets_the_folder_of_a_run(clip: Path, tmp_path: Path) -> None:
    assert find_edited_clip(clip).folder == Path("out/shot")


def test_a_shot_of_a_recording_is_edited_by_itself(clip: Path, tmp_path: Path) -> None:
    folder = make_run_folder(tmp_path / "shot-002", {"path": str(clip), "first": 30, "stop": 90, "begins": 1.0})
    edited = find_edited_clip(folder)
    assert (edited.first, edited.stop, edited.name) == (30, 90, "shot.mp4, shot-002")


def test_a_clip_that_was_moved_or_changed_gets_a_sentence(clip: Path, tmp_path: Path) -> None:
    folder = make_run_folder(tmp_path / "out", {"path": str(clip)}, clip={"sha256": "0" * 64})
    with pytest.raises(OptionError, match=f"{re.escape(str(clip))} has changed since .* was computed; run it again"):
        find_edited_clip(folder)
    clip.unlink()
    with pytest.raises(OptionError, match=r"The clip of this run is no longer at .*shot\.mp4; move it back"):
        find_edited_clip(folder)


@pytest.mark.parametrize(
    "source", ["no object", {}, {"path": 3}, {"path": "x", "settings": 3}, {"path": "x", "first": "soon", "stop": 2}]
)
def test_a_malformed_source_gets_a_sentence(source: object, tmp_path: Path) -> None:
    folder = make_run_folder(tmp_path / "out", source)
    with pytest.raises(OptionError, match=r"source\.json does not name the clip of the run; run it again"):
        find_edited_clip(folder)


def test_whatever_else_is_no_run(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match=r"A run folder or a clip was expected; .* is neither: first do trueroll run"):
        find_edited_clip(tmp_path)
    with pytest.raises(ClipError, match="does not exist"):
        find_edited_clip(tmp_path / "missing.mp4")


def test_images_of_frames_are_freed_with_the_shot_that_they_belong_to(tmp_path: Path) -> None:
    images = FrameImages(synthetic_run.write_clip(tmp_path / "shot.mp4"))
    assert [content is not None for content in map(images.read, (-1, 0, 23, 24))] == [False, True, True, False]
    last = weakref.ref(images)
    del images
    assert last() is None, "a cycle would keep megabytes until a rare garbage collection"
