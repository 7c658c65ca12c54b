"""Replays of the contacts of a shot, magnified and slower still."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from models.core.typing import FloatArray, ImageArray
from video.drawing.circles import draw_ring, drawing_scale
from video.drawing.palette import MUTED_GREY, WHITE
from video.io.clip import Clip, read_frames
from video.matting.ball_timeline import BallTimeline
from video.overlay.frame_balls import balls_at_times
from video.overlay.frame_overlay import FrameBalls, Label
from video.overlay.motion_paths import ContactMark
from video.synthesis.frame_synthesis import ClipAppearance, FrameInterval, prepare_interval

REPLAY_SLOWDOWN = 4.0
"""Slowdown relative to the slow motion before."""
MAX_REPLAY_S = 2.5
"""s of the output video for each contact, at most."""
MAX_REPLAYS = 8
"""Contacts that are replayed: the strongest ones."""
AROUND_RADII = 7.0
"""Ball radii from the middle to the upper border of the view."""


def select_replay_marks(marks: tuple[ContactMark, ...]) -> list[ContactMark]:
    """Select the strongest marks, sure ones first, in order of time."""
    strongest = sorted(marks, key=lambda mark: (-mark.opacity, -mark.strength, mark.t))[:MAX_REPLAYS]
    return sorted(strongest, key=lambda mark: mark.t)


def replay_times(timeline: BallTimeline, mark: ContactMark, rate: float, slow: float) -> FloatArray:
    """Return times (K,) s around a contact, within the two frames that enclose it."""
    row, _ = timeline.locate_time(mark.t)
    first, last = float(timeline.t[row]), float(timeline.t[min(row + 1, len(timeline.t) - 1)])
    step = 1 / (rate * slow * REPLAY_SLOWDOWN)
    half = MAX_REPLAY_S / 2 * rate * step
    return np.arange(max(first, mark.t - half), min(last, mark.t + half), step)


def render_replays(
    clip: Clip, appearance: ClipAppearance, marks: list[ContactMark], rate: float, slow: float
) -> Iterator[ImageArray]:
    """Yield the close-ups (H, W, 3) of all marks; at most two decoded frames are held in memory."""
    timeline = appearance.timeline
    rows = [timeline.locate_time(mark.t)[0] for mark in marks]
    wanted = sorted({row + side for row in rows for side in (0, 1)})
    before: tuple[int, ImageArray] | None = None
    images = read_frames(clip, indices=timeline.frame[wanted])
    for row, (_, image) in zip(wanted, images, strict=True):
        if before is not None and before[0] == row - 1:
            here = [mark for mark, other in zip(marks, rows, strict=True) if other == row - 1]
            if here:
                interval = prepare_interval(
                    timeline, appearance.plate, row - 1, before[1], image, sharp_balls=appearance.sharp_balls
                )
                for mark in here:
                    yield from _render_replay(interval, mark, replay_times(timeline, mark, rate, slow), slow)
        before = (row, image)


def _render_replay(interval: FrameInterval, mark: ContactMark, times: FloatArray, slow: float) -> Iterator[ImageArray]:
    """Yield the close-ups of one contact."""
    timeline = interval.timeline
    state, streaks = timeline.state_at(times), timeline.streak_paths(times, timeline.shutter_time)
    for t, balls, streak in zip(times.tolist(), balls_at_times(timeline, state, times), streaks, strict=True):
        image = interval.synthesize(t, balls.centre, streak)
        yield _draw_replay_frame(image, timeline, mark, t, balls, slow)


def _draw_replay_frame(
    image: ImageArray, timeline: BallTimeline, mark: ContactMark, t: float, balls: FrameBalls, slow: float
) -> ImageArray:
    """Magnify the place of the contact, and draw the fitted outlines and the time relative to the contact."""
    height, width = image.shape[:2]
    scale = height / (2 * AROUND_RADII * balls.radius_of(mark.ball))
    middle = timeline.project(mark.xy, t)
    corner = middle - np.array([width, height]) / (2 * scale)
    to_view = np.array([[scale, 0, -scale * corner[0]], [0, scale, -scale * corner[1]]])
    interpolation = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    close = cv2.warpAffine(image, to_view, (width, height), flags=interpolation, borderMode=cv2.BORDER_REPLICATE)
    view: ImageArray = np.ascontiguousarray(close, dtype=np.uint8)
    stroke = drawing_scale(height)
    for ball in balls.present:
        centre, radius = scale * (balls.centre[ball] - corner), scale * balls.radius_of(int(ball))
        draw_ring(view, centre, radius, 1.4 * stroke, WHITE, 0.7)
    margin = 14 * stroke
    value = f"{1e3 * (t - mark.t):+.1f} ms   {slow * REPLAY_SLOWDOWN:g}× slower"
    Label(mark.label.name or "contact", value, MUTED_GREY).draw(view, np.array([margin, margin]), 1.25 * stroke)
    return view
