"""The recording holds what the run found, on the source's own time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import made_up_shot as shot
import numpy as np
import pytest
from rerun.chunk import Chunk, RrdReader

from pipeline.recording import _finish, write_recording


def recorded(folder: Path, motion: np.ndarray | None = None) -> dict[str, list[Chunk]]:
    """The recording of the made-up shot, seen by a camera that moves so (F, 3, 3), by entity."""
    clip = shot.made_up_clip(folder / "clip.mp4")
    scene = shot.made_up_scene()
    scene = replace(scene, camera=replace(scene.camera, motion=motion))
    tracks = shot.made_up_tracks(clip, scene)
    fit = shot.made_up_fit(tracks.t)
    write_recording(clip, scene, shot.made_up_detections(tracks), tracks, fit, folder / "recording.rrd", "made up")
    assert not list(folder.glob("*.part*")), "nothing half-written is left"
    by_entity: dict[str, list[Chunk]] = {}
    for chunk in RrdReader(folder / "recording.rrd").stream():
        by_entity.setdefault(chunk.entity_path, []).append(chunk)
    return by_entity


@pytest.fixture(scope="module")
def chunks(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Chunk]]:
    return recorded(tmp_path_factory.mktemp("recording"))


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


def places(chunks: list[Chunk], column: str) -> np.ndarray:
    """(rows, n, 2) px of what was drawn at its times, in their order."""
    tables = [c.to_record_batch() for c in chunks if not c.is_static]
    found = [np.array(row, dtype=float).reshape(-1, 2) for t in tables for row in t.column(column).to_pylist() if row]
    order = np.argsort(times(chunks), kind="stable")
    return np.array(found)[order]


def test_paths_and_events_go_with_the_table_where_the_camera_drifts(tmp_path: Path) -> None:
    motion = np.tile(np.eye(3), (shot.FRAMES, 1, 1))
    motion[:, :2, 2] = np.arange(shot.FRAMES)[:, None] * [0.5, -0.25]
    chunks = recorded(tmp_path, motion)
    for entity, column in (("paths/white", "LineStrips2D:strips"), ("events", "Points2D:positions")):
        px = places(chunks[f"/picture/{entity}"], column)
        assert len(px) == shot.FRAMES
        assert px - px[0] == pytest.approx(np.broadcast_to(motion[:, None, :2, 2], px.shape), abs=1e-3)


def test_paths_are_told_once_where_the_camera_stands(chunks: dict[str, list[Chunk]]) -> None:
    assert places(chunks["/picture/paths/white"], "LineStrips2D:strips").shape[0] == 1
