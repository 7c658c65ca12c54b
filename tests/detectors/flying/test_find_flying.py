"""The detector of flying objects on pictures with truth: a dot that flies before a textured background."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

from detectors.flying.find_candidates import find_candidates
from models.core.court_camera import CourtCamera, CourtScene
from models.core.rally import BallCandidates
from models.core.typing import ByteArray, FloatArray
from models.sports.badminton import SPORT
from video.io.clip import open_clip
from video.io.video_writer import VideoWriter

SIZE, FRAMES, RADIUS, STREAK_SHARE = (512, 288), 14, 2.6, 0.5
# A camera behind a badminton court; a narrow picture, in which the court's middle has its usual size.
PARAMETERS = np.array([-12.81, 3.05, 6.86, 1.436, -1.443, 1.042, 7.402, 0.0])
START, VELOCITY, FALL = np.array([90.0, 190.0]), np.array([22.0, -13.0]), 1.1


@dataclass(frozen=True)
class StagedFlight:
    """What was found, and the truth (T, 2) of the places and streaks, px."""

    found: BallCandidates
    centre: FloatArray
    streak: FloatArray


def place_at(t: FloatArray) -> FloatArray:
    """Compute the places (..., 2) of the dot, px of the first frame, at times in frames."""
    return START + t[..., None] * VELOCITY + 0.5 * FALL * t[..., None] ** 2 * [0, 1]


def texture(width: int, height: int) -> ByteArray:
    """Make a background with edges, lettering and grain."""
    rng = np.random.default_rng(5)
    image = np.full((height, width), 90.0, np.float32)
    for scale in (3, 12, 50):
        grain = rng.normal(0, 7, (height // scale + 2, width // scale + 2)).astype(np.float32)
        image += cv2.resize(grain, (width, height), interpolation=cv2.INTER_CUBIC)
    picture = np.clip(image, 0, 255).astype(np.uint8)
    for k in range(5):
        cv2.putText(picture, "LOGO", (40 + 120 * k, 60 + 55 * k), 0, 1.0, 230, 2, cv2.LINE_AA)
        cv2.line(picture, (0, 40 + 60 * k), (width, 90 + 60 * k), 215, 2, cv2.LINE_AA)
    return picture


def draw_dot(image: FloatArray, k: int, shift: FloatArray) -> None:
    """Blend the dot of frame k into an image, averaged over its exposure."""
    t = k + STREAK_SHARE * (np.arange(60) + 0.5 - 30) / 60
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    share = np.zeros(image.shape)
    for x, y in place_at(t) + shift:
        share += np.clip(RADIUS + 0.5 - np.hypot(columns - x, rows - y), 0, 1) / len(t)
    image += share * (245 - image)


def film(folder: Path, pan: FloatArray, with_dot: bool, screen: int | None = None) -> StagedFlight:
    """Film the dot with a camera that turns by `pan` px a frame; a screen hides what is right of a column."""
    wide = texture(SIZE[0] + 120, SIZE[1] + 60)
    rng = np.random.default_rng(3)
    moves = np.repeat(np.eye(3)[None], FRAMES, axis=0)
    with VideoWriter(folder / "clip.mp4", *SIZE, Fraction(25), crf=20, threads=1) as writer:
        for k in range(FRAMES):
            moves[k, :2, 2] = pan * k
            shift = moves[k].copy()
            shift[:2, 2] -= [60, 30]
            image = cv2.warpPerspective(wide, shift, SIZE, flags=cv2.INTER_CUBIC).astype(np.float64)
            if with_dot:
                draw_dot(image, k, pan * k)
            if screen is not None:
                image[:, screen:] = wide[30 : 30 + SIZE[1], 60 + screen : 60 + SIZE[0]]
            image += rng.normal(0, 1.5, image.shape)
            writer.write(np.repeat(np.clip(image, 0, 255).astype(np.uint8)[..., None], 3, axis=2))
    camera = CourtCamera(PARAMETERS, np.eye(8) * 1e-6, *SIZE, is_left_handed=True)
    scene = CourtScene(SPORT, replace(camera, motion=moves) if pan.any() else camera, 0.5)
    t = np.arange(float(FRAMES))
    ends = [place_at(t + half) for half in (-STREAK_SHARE / 2, STREAK_SHARE / 2)]
    return StagedFlight(
        find_candidates(open_clip(folder / "clip.mp4"), scene), place_at(t) + moves[:, :2, 2], ends[1] - ends[0]
    )


def best_rows(found: BallCandidates) -> dict[int, int]:
    """Return the row of the best candidate of each frame."""
    rows: dict[int, int] = {}
    for row in np.argsort(-found.score, kind="stable"):
        rows.setdefault(int(found.frame[row]), int(row))
    return rows


@pytest.mark.parametrize("pan", [(0.0, 0.0), (3.3, 0.6)], ids=["still", "panning"])
def test_a_flying_dot_is_found_where_it_is(tmp_path: Path, pan: tuple[float, float]) -> None:
    staged = film(tmp_path, np.array(pan), with_dot=True)
    rows = best_rows(staged.found)
    errors, pulls, streaks = [], [], []
    for k in range(FRAMES):
        if k not in rows or staged.found.score[rows[k]] < 0.5:
            continue
        off = staged.found.centre[rows[k]] - staged.centre[k]
        streak = staged.streak[k] / np.linalg.norm(staged.streak[k])
        errors.append(np.linalg.norm(off))
        pulls.append(
            [
                off @ [-streak[1], streak[0]] / staged.found.sigma[rows[k]],
                off @ streak / staged.found.sigma_along[rows[k]],
            ]
        )
        streaks.append(abs(staged.found.streak[rows[k]] @ streak) / np.linalg.norm(staged.streak[k]))
    assert len(errors) >= 0.85 * FRAMES
    assert np.median(errors) < 1.0
    assert np.sqrt(np.mean(np.square(pulls))) < 2.5
    assert np.median(streaks) == pytest.approx(1.0, abs=0.3)


def test_a_still_picture_gives_no_candidate(tmp_path: Path) -> None:
    assert not np.any(film(tmp_path, np.zeros(2), with_dot=False).found.score > 0.3)


def test_lettering_before_a_panning_camera_gives_no_probable_candidate(tmp_path: Path) -> None:
    assert not np.any(film(tmp_path, np.array([3.3, 0.6]), with_dot=False).found.score > 0.5)


def test_a_hidden_dot_gives_no_candidate(tmp_path: Path) -> None:
    staged = film(tmp_path, np.zeros(2), with_dot=True, screen=250)
    hidden = np.flatnonzero(staged.centre[:, 0] > 250 + 15)
    assert len(hidden) >= 4
    assert not np.any(staged.found.score[np.isin(staged.found.frame, hidden)] > 0.3)


def test_the_same_clip_gives_the_same_candidates(tmp_path: Path) -> None:
    first, second = (film(tmp_path, np.zeros(2), with_dot=True).found for _ in range(2))
    assert np.array_equal(first.centre, second.centre)
    assert np.array_equal(first.score, second.score)
