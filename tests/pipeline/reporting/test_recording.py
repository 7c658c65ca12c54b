"""The recording of a run has its results on the timelines of the source clip."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import Chunk, RrdReader
from support import synthetic_run as shot

from pipeline.reporting.figures.motion_samples import kinetic_energy, simplify_line
from pipeline.reporting.recording.recorded_shot import build_recorded_shot, finish_stream
from pipeline.reporting.recording.stage_layers import format_mark, residual_magnification, write_recording


def record_shot(folder: Path, motion: np.ndarray | None = None) -> dict[str, list[Chunk]]:
    """Record the synthetic shot with a camera motion (T, 3, 3); return the chunks by entity."""
    clip = shot.write_clip(folder / "clip.mp4")
    scene = shot.make_scene()
    scene = replace(scene, camera=replace(scene.camera, motion=motion))
    tracks = shot.make_tracks(clip, scene)
    fit = shot.make_fit(tracks.t)
    detections = shot.make_detections(tracks)
    write_recording(clip, scene, detections, tracks, fit, folder / "recording.rrd", "made up")
    assert not list(folder.glob("*.part*")), "nothing half-written is left"
    by_entity: dict[str, list[Chunk]] = {}
    for chunk in RrdReader(folder / "recording.rrd").stream():
        by_entity.setdefault(chunk.entity_path, []).append(chunk)
    return by_entity


@pytest.fixture(scope="module")
def chunks(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Chunk]]:
    return record_shot(tmp_path_factory.mktemp("recording"))


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
        finish_stream(full, Path("recording.rrd"))  # type: ignore[arg-type]
    assert raised.value.filename == "recording.rrd"
    assert full.disconnected


def rows(chunks: list[Chunk]) -> int:
    return sum(chunk.num_rows for chunk in chunks if not chunk.is_static)


def times(chunks: list[Chunk]) -> np.ndarray:
    columns = [c.to_record_batch().column("video_time") for c in chunks if not c.is_static]
    return np.concatenate([column.to_numpy(zero_copy_only=False) for column in columns]).astype(float) / 1e9


def test_every_frame_of_the_clip_is_shown_once(chunks: dict[str, list[Chunk]]) -> None:
    assert rows(chunks["/picture/video"]) == shot.FRAMES
    assert times(chunks["/picture/video"]) == pytest.approx(np.arange(shot.FRAMES) / shot.RATE, abs=1e-3)


def test_each_ball_has_a_track_in_the_video_and_a_place_on_the_plan(chunks: dict[str, list[Chunk]]) -> None:
    for ball in ("white", "red"):
        assert rows(chunks[f"/picture/tracks/{ball}"]) == shot.FRAMES
        assert rows(chunks[f"/plan/balls/{ball}"]) == shot.FRAMES


def test_only_balls_that_move_have_a_path_and_a_speed(chunks: dict[str, list[Chunk]]) -> None:
    assert "/picture/paths/white" in chunks
    assert "/plots/speed/white" in chunks
    assert "/picture/paths/red" not in chunks
    assert "/plots/speed/red" not in chunks


def test_events_are_logged_at_their_times(chunks: dict[str, list[Chunk]]) -> None:
    assert times(chunks["/log/events"]) == pytest.approx([0.1, 0.5])


def places(chunks: list[Chunk], column: str) -> np.ndarray:
    """(rows, n, 2) px of what was drawn at its times, in their order."""
    tables = [c.to_record_batch() for c in chunks if not c.is_static]
    drawn = [np.array(row, dtype=float).reshape(-1, 2) for t in tables for row in t.column(column).to_pylist() if row]
    order = np.argsort(times(chunks), kind="stable")
    return np.array(drawn)[order]


def test_paths_and_events_go_with_the_table_where_the_camera_drifts(tmp_path: Path) -> None:
    motion = np.tile(np.eye(3), (shot.FRAMES, 1, 1))
    motion[:, :2, 2] = np.arange(shot.FRAMES)[:, None] * [0.5, -0.25]
    chunks = record_shot(tmp_path, motion)
    path = places(chunks["/picture/paths/white"], "LineStrips2D:strips")
    assert path - path[0] == pytest.approx(np.broadcast_to(motion[:, None, :2, 2], path.shape), abs=1e-3)
    mark = places(chunks["/picture/events/01-cushion"], "Points2D:positions")
    assert len(mark) > 2, "it is there from the event on, again in every frame"
    assert np.diff(mark[1:], axis=0) == pytest.approx(np.broadcast_to([0.5, -0.25], (len(mark) - 2, 1, 2)), abs=1e-3)


def test_paths_are_logged_once_if_the_camera_is_static(chunks: dict[str, list[Chunk]]) -> None:
    assert places(chunks["/picture/paths/white"], "LineStrips2D:strips").shape[0] == 1


def test_what_is_past_grows_along_the_path_up_to_the_ball(chunks: dict[str, list[Chunk]]) -> None:
    plan = chunks["/plan/past/white"]
    ways = [np.array(row[0]) for c in plan if not c.is_static
            for row in c.to_record_batch().column("LineStrips2D:strips").to_pylist()]  # fmt: skip
    t = times(plan)
    assert len(ways) == shot.FRAMES - 1, "the first frame has no past"
    ends = np.array([way[-1] for way in ways])
    assert ends[:, 0] == pytest.approx(0.2 + shot.SPEED * t, abs=1e-5)
    assert all(way[0] == pytest.approx([0.2, 0.5], abs=1e-6) for way in ways)


def test_a_mark_is_shown_from_its_event_on_with_balls_time_speed_and_gap(
    chunks: dict[str, list[Chunk]],
) -> None:
    assert times(chunks["/plan/events/01-cushion"]) == pytest.approx([0.5])
    labels = [c.to_record_batch().column("Points2D:labels").to_pylist() for c in chunks["/plan/events/01-cushion"]
              if c.is_static]  # fmt: skip
    assert labels == [[["0.5000 s ± 1.0 ms · White hits the right short rail, 0.50 m/s (1.8 km/h) straight into it"]]]


def test_the_mark_of_an_undecided_event_has_its_probability() -> None:
    fit = shot.make_unsure_fit(np.linspace(0, 0.8, 25))
    assert format_mark(fit, 1).endswith(" · undecided: 61 %, or something else 39 %")
    assert "undecided" not in format_mark(fit, 0)


def test_detections_carry_their_sigma(chunks: dict[str, list[Chunk]]) -> None:
    sigmas = [value for c in chunks["/picture/detections"] if not c.is_static
            for row in c.to_record_batch().column("sigma_px").to_pylist() for value in row]  # fmt: skip
    assert sigmas == pytest.approx([0.2] * (2 * shot.FRAMES))


def test_parameters_are_logged_with_their_errors(chunks: dict[str, list[Chunk]]) -> None:
    facts = chunks["/parameters/rolling_resistance.mu"][0].to_record_batch()
    assert [facts.column(name).to_pylist() for name in ("value", "sigma", "prior_only")] == [
        [[0.01]],
        [[0.001]],
        [[False]],
    ]


def test_the_log_has_lines_of_every_stage(chunks: dict[str, list[Chunk]]) -> None:
    assert {f"/log/chain/{stage}" for stage in ("read", "calibrate", "detect", "track", "fit")} <= set(chunks)


def test_no_time_is_outside_the_clip(chunks: dict[str, list[Chunk]]) -> None:
    last = (shot.FRAMES - 1) / shot.RATE
    all_times = [times(some) for some in chunks.values()
                 if any("video_time" in str(c.to_record_batch().schema.names) and
            not c.is_static for c in some)]  # fmt: skip
    assert all_times
    assert all(t.min() >= 0 and t.max() <= last + 1e-6 for t in all_times)


def test_residuals_are_magnified_by_a_round_number_until_they_are_seen(tmp_path: Path) -> None:
    clip = shot.write_clip(tmp_path / "clip.mp4")
    scene, tracks = shot.make_scene(), shot.make_tracks(clip, shot.make_scene())
    fit = shot.make_fit(tracks.t)
    noisy = replace(fit, residual=np.full_like(fit.residual, 0.0003))
    assert residual_magnification(build_recorded_shot(clip, scene, tracks, noisy)) == 50.0
    assert residual_magnification(build_recorded_shot(clip, scene, tracks, fit)) == 1.0


def test_a_ball_that_rolls_has_seven_fifths_of_the_energy_of_its_centre() -> None:
    fit, table = shot.make_fit(np.linspace(0, 0.5, 5)), shot.make_scene().table
    state = fit.trajectory.at(np.array([0.1, 0.2]))
    centre = 0.5 * table.ball_mass * shot.SPEED**2
    assert kinetic_energy(state, table)[:, 0] == pytest.approx(centre), "its spin is known to be nil"
    unknown = replace(state, w=np.full_like(state.w, np.nan))
    rolling = replace(state, w=np.broadcast_to([0.0, shot.SPEED / table.ball_radius, np.nan], state.w.shape))
    for spinning in (unknown, rolling):
        assert kinetic_energy(spinning, table)[:, 0] == pytest.approx(1.4 * centre)
    assert kinetic_energy(unknown, table)[:, 1] == pytest.approx(0.0)


def test_simplified_lines_keep_a_line_within_the_tolerance() -> None:
    angle = np.linspace(0, np.pi, 400)
    arc = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    indices = simplify_line(arc, 1e-3)
    drawn = np.stack([np.interp(angle, angle[indices], arc[indices, axis]) for axis in (0, 1)], axis=-1)
    assert 20 < len(indices) < 80
    assert 1 - np.linalg.norm(drawn, axis=1).min() < 1.01e-3
    assert simplify_line(np.zeros((5, 2)), 1e-3).tolist() == [0, 4]
    assert simplify_line(np.empty((0, 2)), 1e-3).tolist() == []
