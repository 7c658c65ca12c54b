"""Balls that a person placed: measured in their frame, and followed to other frames as long as they look the same."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from detectors.measurement.circle_fit import fit_circles, smooth_image
from detectors.measurement.cloth_background import build_colour_basis
from detectors.measurement.frame_detections import FrameDetections, add_colours
from models.core.array_columns import concatenate_rows
from models.core.corrections import BallMark
from models.core.detections import Detections, MarkedDetections
from models.core.progress import Progress, ignore_progress
from models.core.scene import Scene
from models.core.typing import ByteArray, FloatArray
from video.io.clip import Clip, read_frames

# px, standard deviation of a place that a person chose in the magnifier.
HAND_SIGMA_PX = 1.0
# Ball radii: standard deviation of a place that the correlation with the chosen one gives. Guess: a tenth of the width
# of its peak.
FOLLOW_SIGMA_RADII = 0.05
# Least normalized correlation with the image of the placed ball. Noise and coding leave 0.9 and more of the same ball
# at rest; cloth and other balls give less than 0.6.
MIN_CORRELATION = 0.75
# Share of a fitted outline from which it replaces the chosen place, as for the detector, and the largest move of it in
# ball radii.
MIN_SUPPORT, MAX_REFINEMENT_RADII = 0.6, 0.5
# Ball radii: distance of the places from which the outline is fitted. How far the results differ is part of the error.
START_RADII, START_DIRECTIONS = 0.3, np.array([[0.0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
# Half width of the compared image, and reach of the search about the predicted place, ball radii.
PATCH_RADII, SEARCH_RADII = 1.3, 1.5
# Ball radii within which a detection of the detector is the same ball: it is not placed twice.
OTHER_RADII = 1.0
# Frames that are held in memory while a clip is read backward.
BLOCK_FRAMES = 64


@dataclass(frozen=True, slots=True)
class _Template:
    """The image of a placed ball."""

    patch: ByteArray
    radius: float
    """px."""
    sigma: float
    """px, standard deviation of its centre, an error that all followed places share."""


def add_placed_balls(
    detections: Detections, clip: Clip, scene: Scene, marks: Sequence[BallMark], progress: Progress = ignore_progress
) -> MarkedDetections:
    """Add the balls that a person placed to the detections.

    A placed ball is measured in its own frame. From there it is followed forward and backward, within the frames of its
    mark, until it no longer looks the same or the detector has it.

    Args:
        detections: Detections of all frames.
        scene: Table and camera.
        marks: The placed balls.
        progress: Called with the share that is done.

    Returns:
        All detections, sorted by frame.
    """
    frames = clip.distinct_frames
    starts = [int(np.searchsorted(frames, mark.ball.frame, side="right")) - 1 for mark in marks]
    images = dict(read_frames(clip, indices=np.unique(frames[starts])))
    seeds = [
        _measure_placed_ball(images[int(frames[start])], mark, scene, int(frames[start]))
        for mark, start in zip(marks, starts, strict=True)
    ]
    templates = [_cut_template(images[int(seed.frame[0])], seed) for seed in seeds]
    rows = list(enumerate(seeds))
    for is_forward in (True, False):
        spans = [_list_span(mark, frames, start, is_forward) for mark, start in zip(marks, starts, strict=True)]
        rows += _follow_balls(clip, detections, spans, seeds, templates, is_forward)
        progress(0.5 if is_forward else 1.0)
    return _merge_rows(detections, rows)


def _list_span(mark: BallMark, frames: NDArray[np.int64], start: int, is_forward: bool) -> NDArray[np.int64]:
    """List the frames after (or, going backward, before) the one of a mark in which its ball is followed."""
    part = frames[start + 1 :] if is_forward else frames[:start][::-1]
    first, last = mark.first or 0, frames[-1] if mark.last is None else mark.last
    return part[(part >= first) & (part <= last)]


def _measure_placed_ball(rgb: ByteArray, mark: BallMark, scene: Scene, frame: int) -> Detections:
    """Measure a placed ball by its outline if it has one near the chosen place; else the place counts."""
    place = np.array([mark.ball.x_px, mark.ball.y_px])
    expected = _expect_radius(scene, place, frame)
    cloth = _sample_surroundings(rgb, place, expected)
    starts = place + START_RADII * expected * START_DIRECTIONS
    count = len(starts)
    circles = fit_circles(
        rgb, smooth_image(rgb), starts, np.full(count, expected), np.tile(cloth, (count, 1)), build_colour_basis(cloth)
    )
    circles = circles.take(np.hypot(*(circles.centre - place).T) < MAX_REFINEMENT_RADII * expected)
    circles = circles.take(circles.support > MIN_SUPPORT)
    if len(circles.centre) > count / 2:
        centre, radius = circles.centre.mean(axis=0)[None], np.array([circles.radius.mean()])
        sigma = np.array([np.hypot(circles.sigma.mean(), circles.centre.std(axis=0).max())])
    else:
        centre, radius, sigma = place[None], np.array([expected]), np.array([HAND_SIGMA_PX])
    return _make_row(rgb, centre, radius, sigma, 1.0, frame)


def _expect_radius(scene: Scene, place: FloatArray, frame: int) -> float:
    """Return the radius (px) of a ball at a place of a frame."""
    xy = scene.camera.to_table(place, scene.table.ball_radius, frame)
    return float(scene.camera.radius_px(xy, scene.table.ball_radius))


def _sample_surroundings(rgb: ByteArray, place: FloatArray, radius: float) -> FloatArray:
    """Return the median colour (3,) RGB of a ring around a place: the cloth there."""
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    points = place + 1.8 * radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    x, y = np.clip(np.rint(points).astype(np.int64), 0, [rgb.shape[1] - 1, rgb.shape[0] - 1]).T
    return np.asarray(np.median(rgb[y, x], axis=0), np.float64)


def _make_row(
    rgb: ByteArray, centre: FloatArray, radius: FloatArray, sigma: FloatArray, score: float, frame: int
) -> Detections:
    ball = FrameDetections(centre, radius, np.zeros((1, 2)), np.array([score]), sigma, sigma)
    return add_colours(rgb, ball, frame)


def _cut_template(rgb: ByteArray, seed: Detections) -> _Template:
    """Cut the image of a ball out of its frame."""
    radius = float(seed.radius[0])
    return _Template(_cut_patch(rgb, seed.centre[0], PATCH_RADII * radius), radius, float(seed.sigma[0]))


def _cut_patch(rgb: ByteArray, centre: FloatArray, reach: float) -> ByteArray:
    """Cut a square of odd size about a centre, interpolated, so that its middle pixel is the centre."""
    size = 2 * round(reach) + 1
    return np.asarray(cv2.getRectSubPix(rgb, (size, size), (float(centre[0]), float(centre[1]))), np.uint8)


def _follow_balls(
    clip: Clip,
    detections: Detections,
    spans: Sequence[NDArray[np.int64]],
    seeds: Sequence[Detections],
    templates: Sequence[_Template],
    is_forward: bool,
) -> list[tuple[int, Detections]]:
    """Follow the balls in one direction; all frames are decoded once."""
    wanted = np.unique(np.concatenate([*spans, np.empty(0, np.int64)]))
    if not len(wanted):
        return []
    steps = [np.zeros(2) for _ in seeds]
    places = {number: seed.centre[0] for number, seed in enumerate(seeds)}
    rows: list[tuple[int, Detections]] = []
    for frame, rgb in _read_in_order(clip, wanted, is_forward):
        for number in [one for one in places if frame in spans[one]]:
            row = _find_ball(rgb, frame, places[number] + steps[number], templates[number])
            if row is None or len(_find_same_ball(detections, row)):
                del places[number]
                continue
            steps[number] = row.centre[0] - places[number]
            places[number] = row.centre[0]
            rows.append((number, row))
        if not places:
            break
    return rows


def _read_in_order(clip: Clip, wanted: NDArray[np.int64], is_forward: bool) -> Iterator[tuple[int, ByteArray]]:
    """Read frames forward, or backward in blocks: video can be decoded forward only."""
    if is_forward:
        yield from read_frames(clip, indices=wanted)
        return
    for end in range(len(wanted), 0, -BLOCK_FRAMES):
        yield from reversed(list(read_frames(clip, indices=wanted[max(end - BLOCK_FRAMES, 0) : end])))


def _find_ball(rgb: ByteArray, frame: int, predicted: FloatArray, template: _Template) -> Detections | None:
    """Find the place near the predicted one that looks most like the placed ball; None if none does."""
    search = _cut_patch(rgb, predicted, (PATCH_RADII + SEARCH_RADII) * template.radius)
    score = cv2.matchTemplate(search, template.patch, cv2.TM_CCOEFF_NORMED)
    _, best, _, (x, y) = cv2.minMaxLoc(score)
    if best < MIN_CORRELATION:
        return None
    middle = (score.shape[0] - 1) / 2
    offset = np.array([x + _find_vertex(score[y], x), y + _find_vertex(score[:, x], y)]) - middle
    sigma = np.array([np.hypot(template.sigma, FOLLOW_SIGMA_RADII * template.radius)])
    return _make_row(rgb, (predicted + offset)[None], np.array([template.radius]), sigma, float(best), frame)


def _find_vertex(score: NDArray[np.float32], at: int) -> float:
    """Return how far the vertex of the parabola through a maximum and its neighbours is from it, samples."""
    if not 0 < at < len(score) - 1:
        return 0.0
    left, middle, right = (float(score[at + k]) for k in (-1, 0, 1))
    curvature = left - 2 * middle + right
    return 0.0 if curvature >= 0 else float(np.clip((left - right) / (2 * curvature), -0.5, 0.5))


def _find_same_ball(detections: Detections, placed: Detections) -> NDArray[np.int64]:
    """Find the detections that are the same ball as the one detection of a placed ball; return their rows."""
    first, end = np.searchsorted(detections.frame, [placed.frame[0], placed.frame[0] + 1])
    distance = np.hypot(*(detections.centre[first:end] - placed.centre[0]).T)
    return np.asarray(first + np.flatnonzero(distance < OTHER_RADII * placed.radius[0]))


def _merge_rows(detections: Detections, rows: list[tuple[int, Detections]]) -> MarkedDetections:
    """Merge the detections of the detector with those of marks; a placed ball replaces detections at its place."""
    is_kept = np.ones(len(detections), bool)
    for _, row in rows:
        is_kept[_find_same_ball(detections, row)] = False
    rest = detections.select_rows(is_kept)
    parts = [rest, *(row for _, row in rows)]
    mark = np.concatenate([np.full(len(rest), -1, np.int64), np.array([number for number, _ in rows], np.int64)])
    order = np.argsort(np.concatenate([part.frame for part in parts]), kind="stable")
    return MarkedDetections(concatenate_rows(parts, order), mark[order])
