"""The stages of images: the poster, and the annotated slow motion."""

from __future__ import annotations

import json
from pathlib import Path

from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage
from pipeline.io.run_views import view_run
from video.io.video_options import RenderOptions

SLOW_FILE, START_FILE = "slow.mp4", "start.json"
"""The slow motion; and the file with the time in the clip of its first frame, s."""


def poster_stage(options: RenderOptions) -> Stage:
    """Build the stage that draws the poster.

    Args:
        options: Options of the slow motion.

    Returns:
        The stage `poster`, whose output is a folder with poster.png and start.json.
    """
    own = RenderOptions(slow=options.slow, trim_still=options.trim_still)  # the others do not change it
    return Stage("poster", __name__, ("read", "explain"), None, _draw_poster, own)


def render_stage(options: RenderOptions) -> Stage:
    """Build the stage that renders the slow motion.

    Args:
        options: Options of the stage.

    Returns:
        The stage `render`, whose output is a folder with slow.mp4.
    """
    return Stage("render", __name__, ("read", "explain"), None, _render_slow_motion, options)


def _draw_poster(inputs: Inputs, options: RenderOptions, folder: Path, progress: Progress) -> None:
    """Draw the poster, and note when the slow motion begins."""
    from video.matting.ball_timeline import build_ball_timeline
    from video.matting.frame_store import FrameStore
    from video.matting.hidden_background import estimate_hidden_background
    from video.overlay.poster import Poster, find_poster_rows
    from video.overlay.slow_motion import find_output_times  # slow to import

    clip, shot = inputs["read"], inputs["explain"]
    tracks, fit = shot.tracks, view_run(shot)
    timeline = build_ball_timeline(shot.scene, tracks, fit)
    frames = FrameStore(timeline, clip, find_poster_rows(timeline))
    poster = Poster.for_timeline(timeline, estimate_hidden_background(timeline, frames))
    for row, image in frames.read_rows(poster.rows):
        poster.add_frame(row, image)
    poster.write(tracks, fit, folder / "poster.png", options)
    start = float(find_output_times(clip, timeline, options)[0])
    (folder / START_FILE).write_text(json.dumps(start), encoding="utf-8")


def _render_slow_motion(inputs: Inputs, options: RenderOptions, folder: Path, progress: Progress) -> None:
    """Render the slow motion."""
    from video.matting.ball_timeline import build_ball_timeline
    from video.overlay.slow_motion import render_slow_motion
    from video.synthesis.frame_synthesis import estimate_clip_appearance  # slow to import

    clip, shot = inputs["read"], inputs["explain"]
    tracks, fit = shot.tracks, view_run(shot)
    appearance = estimate_clip_appearance(build_ball_timeline(shot.scene, tracks, fit), clip)
    render_slow_motion(clip, appearance, tracks, fit, folder / SLOW_FILE, options, progress)
