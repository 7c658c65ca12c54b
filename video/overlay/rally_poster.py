"""Poster of a rally: a frame with the last stroke as a stroboscope would show it, and where it landed."""

from __future__ import annotations

import numpy as np

from models.core.rally import Rally
from models.core.typing import ImageArray
from models.estimation.rally.landing_judgement import LandingCall, judge_landing
from models.estimation.rally.stroke_summary import summarize_strokes
from video.drawing.court_plan import SIDE_COLOURS, draw_court, draw_landing_mark
from video.drawing.label_layout import Rect, make_squares, place_panel
from video.drawing.masks import blend_colours, round_corner_mask
from video.io.clip import Clip
from video.io.video_options import RenderOptions
from video.overlay.annotation import DEFAULT_OPTIONS
from video.overlay.landing_close_up import draw_words
from video.overlay.rally_annotation import RallyAnnotation, find_panel_cost, prepare_rally_annotation
from video.synthesis.rally_synthesis import ObjectSprite, build_rally_timeline, draw_sprites, separate_frames

# Longer sides of the plan and of the side view, share of the height and of the width of the frame.
PLAN_SHARE, SIDE_VIEW_SHARE = 0.4, 0.3


def draw_rally_poster(clip: Clip, rally: Rally, options: RenderOptions = DEFAULT_OPTIONS) -> ImageArray:
    """Draw the frame at the end of the last stroke, with the object where every frame before showed it.

    Args:
        options: Options of the slow motion, for its slowdown.

    Returns:
        Image (H, W, 3).
    """
    timeline = build_rally_timeline(rally)
    call, strokes = judge_landing(rally), summarize_strokes(rally)
    begin, close = (strokes[-1].hit.t, strokes[-1].end) if strokes else (float(rally.t[-1]), float(rally.t[-1]))
    first, last = np.searchsorted(rally.t, [begin, close]).clip(0, len(rally.t) - 1).tolist()
    sprites = list[tuple[float, ObjectSprite]]()
    end, image = 0.0, np.empty(0, np.uint8)
    for frame in separate_frames(clip, timeline, first, last):
        end, image = frame.t, frame.background.copy()
        sprites += [(end, frame.sprite)] if frame.sprite is not None else []
    annotation, index = prepare_rally_annotation(timeline, call, image, options.slow, "coach"), len(strokes) - 1
    if index >= 0:
        annotation.draw_trail(image, index, end)
    for t, sprite in sprites:
        draw_sprites(image, [(sprite, 1.0)], timeline.find_places(np.array([t]), end)[0])
    panels = _draw_panels(image, annotation, call, index, end)
    shown = {k: 1.0 for k, mark in enumerate(annotation.marks) if mark.t >= begin}
    annotation.draw_labels(image, end, shown, panels)
    return image


def _draw_panels(
    image: ImageArray, annotation: RallyAnnotation, call: LandingCall, index: int, end: float
) -> list[Rect]:
    """Draw the verdict, a plan and a side view of the last stroke where they hide least; return their places."""
    sport, (height, width) = annotation.timeline.rally.scene.sport, image.shape[:2]
    drawings = (
        draw_court(sport, round(PLAN_SHARE * height)),
        draw_court(sport, round(SIDE_VIEW_SHARE * width), "side"),
    )
    path = annotation.path_of(index)[1] if index >= 0 else np.empty((0, 3))
    taken = [tuple(one) for one in make_squares(annotation.timeline.project(path[::8], end), 10 * annotation.scale)]
    taken.append(draw_words(image, call, annotation.scale))
    cost = find_panel_cost(annotation.timeline, image)
    for drawing in drawings:
        if len(path):
            stroke = annotation.strokes[index]
            colour = SIDE_COLOURS[stroke.hit.player]
            drawing.draw_path(path, colour, 2.5)
            drawing.draw_mark(stroke.hit.place, colour, 3.5)
        if call.landing is not None:
            draw_landing_mark(drawing, call.landing.place, call.landing.covariance)
        place = place_panel(drawing.size, (width, height), cost, taken)
        taken.append(place)
        corners = round_corner_mask(*drawing.size, round(6 * annotation.scale))
        blend_colours(image, drawing.render(), corners, round(place[0]), round(place[1]))
    return taken[len(taken) - 3 :]
