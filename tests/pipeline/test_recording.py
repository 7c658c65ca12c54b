"""The recording holds what the run found, on the source's own time."""

from __future__ import annotations

from pathlib import Path

import made_up_shot as shot
import numpy as np
import pytest
from rerun.chunk import Chunk, RrdReader

from pipeline.recording import _finish, write_recording


@pytest.fixture(scope="module")
def chunks(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Chunk]]:
    folder = tmp_path_factory.mktemp("recording")
    clip = shot.made_up_clip(folder / "clip.mp4")
    scene = shot.made_up_scene()
    tracks = shot.made_up_tracks(clip, scene)
    fit = shot.made_up_fit(tracks.t)
    write_recording(clip, scene, shot.made_up_detections(tracks), tracks, fit, folder / "recording.rrd", "made up")
    assert not list(folder.glob("*.part*")), "nothing half-written is left"
    by_entity: dict[str, list[Chunk]] = {}
    for chunk in RrdReader(folder / "recording.rrd").stream():
        by_entity.setdefault(chunk.entity_path, []).append(chunk)
    return by_entity


class Full:
    """A stream whose disk is full."""

    disconnected = False

    def flush(self) -> None:
        raise RuntimeError("File-writer thread shut down prematurely")

    def disconnect(self) -> None:
        self.disconnected = True


def test_a_recording_that_cannot_be_written_is_an_error_of_its_file() -> None:
    full = Full()
    with pytest.raises(OSError, match="is the disk full") as raised:
        _finish(full, Path("recording.rrd"))  # type: ignore[arg-type]
    assert raised.value.filename == "recording.rrd"
    assert full.disconnected


def rows(chunks: list[Chunk]) -> int:
    return sum(chunk.num_rows for chunk in chunks if not chunk.is_static)


def times(chunks: list[Chunk]) -> np.ndarray:
    columns = [c.to_record_batch().column("video_time") for c in chunks if not c.is_static]
    return np.concatenate([column.to_numpy(zero_copy_only=False) for column in columns]).astype(float) / 1e9


def test_every_picture_of_the_clip_is_shown_once(chunks: dict[str, list[Chunk]]) -> None:
    assert rows(chunks["/picture/video"]) == shot.FRAMES
    assert times(chunks["/picture/video"]) == pytest.approx(np.arange(shot.FRAMES) / shot.RATE, abs=1e-3)


def test_each_ball_has_a_track_in_the_picture_and_a_place_on_the_plan(chunks: dict[str, list[Chunk]]) -> None:
    for ball in ("white", "red"):
        assert rows(chunks[f"/picture/tracks/{ball}"]) == shot.FRAMES
        assert rows(chunks[f"/plan/balls/{ball}"]) == shot.FRAMES


def test_only_balls_that_move_have_a_path_and_a_speed(chunks: dict[str, list[Chunk]]) -> None:
    assert "/picture/paths/white" in chunks
    assert "/plots/speed/white" in chunks
    assert "/picture/paths/red" not in chunks
    assert "/plots/speed/red" not in chunks


def test_events_stand_at_their_moments(chunks: dict[str, list[Chunk]]) -> None:
    assert times(chunks["/log/events"]) == pytest.approx([0.1, 0.5])
