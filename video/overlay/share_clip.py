"""A clip to share, upright for phones: a moment of a shot at normal speed, then slowly and close, with its answer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain, repeat
from pathlib import Path

import numpy as np

from models.core.fit_result import Fit
from models.core.naming import Naming
from models.core.typing import FloatArray, ImageArray
from video.drawing.label_layout import Rect, make_squares
from video.drawing.masks import LINE_SPACING, draw_paragraph, wrap_text
from video.drawing.palette import FLASH, INK, MUTED_GREY, WHITE, Colour
from video.io.clip import Clip
from video.io.video_writer import VideoWriter
from video.matting.ball_timeline import BallTimeline
from video.overlay.annotation import NAME_MARGIN_RADII, GlidingLabels
from video.overlay.close_up import PLACE_RADII, Window, draw_polyline, find_window, magnify_image
from video.overlay.frame_overlay import FrameBalls, Label, keep_balls_on_top
from video.overlay.slow_motion import (
    PREFETCHED_FRAMES,
    SynthesizedFrame,
    balls_at_times,
    prefetch_items,
    synthesize_frames,
)
from video.synthesis.frame_synthesis import ClipAppearance

# px, and frames per second.
WIDTH, HEIGHT, RATE = 720, 1280, Fraction(30)
# px: place of the film between the question and the answer, and margin of the text.
VIEW_TOP, VIEW_HEIGHT, MARGIN = 212, 760, 24
# s of the output: all; at normal speed, at most; of these, while the view comes closer; slowly before and after the
# moment.
LENGTH_S, RUN_UP_S, ZOOM_S, BEFORE_S, AFTER_S = 10.0, 2.5, 0.6, 1.6, 2.4
# Of these, the one is taken with which a ball takes at least `BEFORE_S` from the border of the view to the moment.
SLOWDOWNS = (4, 8, 16, 32)
# Font sizes, px, and scale of the names: a phone shows the 720 px at half of that in its own units.
QUESTION_PX, VERDICT_PX, SENTENCE_PX, NOTE_PX, NAME_SCALE = 42, 48, 36, 28, 2.0
# x264 parameters: with at most 3500 kbit/s, ten seconds have less than 4.5 MB.
SIZE_LIMIT = "vbv-maxrate=3500:vbv-bufsize=3500"


@dataclass(frozen=True, slots=True)
class SharedMoment:
    """What a clip to share shows."""

    t: float
    """s"""
    balls: tuple[str, ...]
    """Ids of the balls that take part."""
    mark: FloatArray
    """(n, 2) m, the line in question or the outline of the pocket; empty for none."""
    question: str
    headline: str
    """Verdict and probability."""
    margin: str
    sentence: str
    """The whole answer."""


def render_share_clip(
    clip: Clip, appearance: ClipAppearance, fit: Fit, naming: Naming, moment: SharedMoment, plan: ImageArray, path: Path
) -> None:
    """Write a clip of 9:16: run-up, the moment from near and slowly, and a card with the plan and the whole answer.

    Args:
        appearance: Its estimated appearance.
        fit: Fitted motion.
        naming: Names and looks of the balls.
        moment: What to show.
        plan: The shot on the table (h, w, 3), at most as large as the view.
        path: File to write.
    """
    timeline = appearance.timeline
    slowdown = _select_slowdown(fit, moment, timeline.scene.table.ball_radius)
    normal, slow = _schedule_times(timeline, moment.t, slowdown)
    view = _MomentView.prepare(timeline, fit.trajectory.ids, naming, moment, normal, slowdown)
    frames = map(view.draw, prefetch_items(
        synthesize_frames(clip, appearance, np.concatenate([normal, slow])),
        PREFETCHED_FRAMES,
    ))  # fmt: skip
    card = _draw_card(moment, plan)
    rest = round(LENGTH_S * RATE) - len(normal) - len(slow)
    with VideoWriter(path, WIDTH, HEIGHT, RATE, tuning=SIZE_LIMIT, threads=1) as writer:
        for image in chain(frames, repeat(card, rest)):
            writer.write(image)


def _select_slowdown(fit: Fit, moment: SharedMoment, ball_radius: float) -> int:
    """Select how much slower the moment is shown, by the speed of its balls."""
    around, step = [fit.trajectory.ids.index(one) for one in moment.balls], 5e-3
    velocity = fit.trajectory.at(moment.t + np.array([-step, step])).v[:, around]
    needed = BEFORE_S * np.nanmax(np.linalg.norm(velocity, axis=2), initial=0.0) / (PLACE_RADII * ball_radius)
    return next((one for one in SLOWDOWNS if one >= needed), SLOWDOWNS[-1])


def _schedule_times(timeline: BallTimeline, t: float, slowdown: int) -> tuple[FloatArray, FloatArray]:
    """Return the times in the clip (s) of the frames at normal speed, and of those that are slowed down."""
    first, last, step = float(timeline.t[0]), float(timeline.t[-1]), 1 / float(RATE)
    start = max(first, t - BEFORE_S / slowdown)
    normal = start - step * np.arange(int(min(RUN_UP_S, start - first) / step), 0, -1, dtype=np.float64)
    return normal, np.arange(start, min(last, t + AFTER_S / slowdown), step / slowdown, dtype=np.float64)


@dataclass(slots=True)
class _MomentView:
    """Draws the frames around a moment; it tracks the positions of names, so draw in the order of time."""

    timeline: BallTimeline
    moment: SharedMoment
    shown: dict[int, Label]
    """Names of the balls that take part, by index."""
    near: Window
    far: Window
    slowdown: int
    labels: GlidingLabels

    @classmethod
    def prepare(
        cls, timeline: BallTimeline, ids: tuple[str, ...], naming: Naming, moment: SharedMoment, normal: FloatArray,
        slowdown: int,
    ) -> _MomentView:  # fmt: skip
        """Find the windows that show the moment, and the way of its balls before."""
        shown = {ids.index(one): Label(naming.name_ball(one), "", naming.find_look(one).colour) for one in moment.balls}
        times = np.append(normal, moment.t)
        balls = balls_at_times(timeline, timeline.state_at(times), times)
        places = np.stack([one.centre[list(shown)] for one in balls])
        reach = PLACE_RADII * max(balls[-1].radius_of(one) for one in shown)
        mark = timeline.project(moment.mark, moment.t)
        nearest = np.argsort(np.linalg.norm(mark - places[-1, 0], axis=1))[:1]
        near, far = (
            find_window(np.concatenate([some.reshape(-1, 2), mark[nearest]]), reach) for some in (places[-1], places)
        )
        return cls(timeline, moment, shown, near, far, slowdown, GlidingLabels())

    def draw(self, frame: SynthesizedFrame) -> ImageArray:
        """Draw a frame with the question, and from the moment on with the answer."""
        moment = self.moment
        start = moment.t - BEFORE_S / self.slowdown
        is_slow = frame.t >= start
        answer = ((moment.headline, VERDICT_PX, FLASH), (moment.margin, SENTENCE_PX, WHITE))
        note = f"{self.slowdown}× slower" if is_slow else "at normal speed"
        page = _draw_page(moment.question, (note, NOTE_PX, MUTED_GREY), *(answer if frame.t >= moment.t else ()))
        share = float(np.clip(1 + (frame.t - start) / ZOOM_S, 0, 1))
        share *= share * (3 - 2 * share)
        window = (1 - share) * self.far + share * self.near
        view, scale, corner = magnify_image(frame.image, (WIDTH, VIEW_HEIGHT), window, keeps_inside=True)
        balls = frame.balls
        balls = replace(balls, centre=scale * (balls.centre - corner), radius=scale * balls.radius)
        mark = scale * (self.timeline.project(moment.mark, frame.t) - corner)
        with keep_balls_on_top(view, balls):
            if is_slow:
                self._draw_names(view, balls, make_squares(mark, MARGIN / 2).tolist())
        draw_polyline(view, mark, 4)
        page[VIEW_TOP : VIEW_TOP + VIEW_HEIGHT] = view
        return page

    def _draw_names(self, view: ImageArray, balls: FrameBalls, obstacles: list[Rect]) -> None:
        """Draw the names of the balls that take part where neither a ball nor an obstacle is."""
        obstacles += balls.boxes(NAME_MARGIN_RADII).tolist()
        for ball, label in self.shown.items():
            if np.all((balls.centre[ball] > 0) & (balls.centre[ball] < (WIDTH, VIEW_HEIGHT))):  # false for NaN
                self.labels.draw(view, label, ball, balls, NAME_SCALE, obstacles)


def _draw_page(question: str, *lines: tuple[str, int, Colour]) -> ImageArray:
    """Draw the question above, and lines of a size and colour below the view, on an empty frame."""
    page = np.full((HEIGHT, WIDTH, 3), INK, np.uint8)
    draw_paragraph(page, question, MARGIN, MARGIN, QUESTION_PX, WHITE, bold=True)
    y = VIEW_TOP + VIEW_HEIGHT + MARGIN // 2
    for text, size, colour in lines:
        y = draw_paragraph(page, text, MARGIN, y, size, colour, bold=size == VERDICT_PX)
    return page


def _draw_card(moment: SharedMoment, plan: ImageArray) -> ImageArray:
    """Draw the question, the plan, and the whole answer in the largest letters that fit."""
    page, left, end = _draw_page(moment.question), (WIDTH - plan.shape[1]) // 2, VIEW_TOP + len(plan)
    page[VIEW_TOP:end, left : left + plan.shape[1]] = plan
    size = next(
        size for size in range(SENTENCE_PX, 0, -2)
        if len(wrap_text(moment.sentence, size, WIDTH - 2 * MARGIN)) * LINE_SPACING * size < HEIGHT - end - 2 * MARGIN
    )  # fmt: skip
    draw_paragraph(page, moment.sentence, MARGIN, end + MARGIN, size, WHITE)
    return page
