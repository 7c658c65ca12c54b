"""The stages of images: the background behind the balls, the poster, and the annotated slow motion."""

from __future__ import annotations

import json
from pathlib import Path

from models.core.progress import Progress
from pipeline.engine.stage import Inputs, NoOptions, Stage
from pipeline.io.run_views import view_run
from video.io.video_options import RenderOptions

# The slow motion; and the file with the time in the clip of its first frame, s.
SLOW_FILE, START_FILE = "slow.mp4", "start.json"


def background_stage() -> Stage:
    """Build the stage that places the balls in all frames and estimates the background behind them.

    Returns:
        The stage `background`, whose output is a `HiddenBackground`.
    """
    from video.matting.hidden_background import HiddenBackground  # slow to import

    return Stage("background", __name__, ("read", "explain"), HiddenBackground, _estimate_background, NoOptions())


def poster_stage(options: RenderOptions) -> Stage:
    """Build the stage that draws the poster.

    Args:
        options: Options of the slow motion.

    Returns:
        The stage `poster`, whose output is a folder with poster.png and start.json.
    """
    own = RenderOptions(slow=options.slow, trim_still=options.trim_still)  # the others do not change it
    return Stage("poster", __name__, ("read", "explain", "background"), None, _draw_poster, own)


def render_stage(options: RenderOptions) -> Stage:
    """Build the stage that renders the slow motion.

    Args:
        options: Options of the stage.

    Returns:
        The stage `render`, whose output is a folder with slow.mp4.
    """
    return Stage("render", __name__, ("read", "explain", "background"), None, _render_slow_motion, options)


def _estimate_background(inputs: Inputs, options: NoOptions, folder: Path, progress: Progress) -> object:
    """Estimate the background."""
    from models.estimation.reconstruction.shot_views import view_shot
    from video.matting.ball_timeline import build_ball_timeline
    from video.matting.hidden_background import estimate_hidden_background

    shot = inputs["explain"]
    timeline = build_ball_timeline(shot.scene, shot.tracks, view_shot(shot))
    return estimate_hidden_background(timeline, inputs["read"])


def _draw_poster(inputs: Inputs, options: RenderOptions, folder: Path, progress: Progress) -> None:
    """Draw the poster, and note when the slow motion begins."""
    from pipeline.io.image_file import write_image
    from video.overlay.poster import draw_poster
    from video.overlay.slow_motion import find_output_times  # slow to import

    clip, shot, background = inputs["read"], inputs["explain"], inputs["background"]
    tracks, fit = shot.tracks, view_run(shot)
    write_image(draw_poster(clip, background, tracks, fit, options), folder / "poster.png")
    start = float(find_output_times(clip, background.timeline, options)[0])
    (folder / START_FILE).write_text(json.dumps(start), encoding="utf-8")


def _render_slow_motion(inputs: Inputs, options: RenderOptions, folder: Path, progress: Progress) -> None:
    """Render the slow motion."""
    from video.overlay.slow_motion import render_slow_motion
    from video.synthesis.frame_synthesis import estimate_clip_appearance  # slow to import

    clip, shot = inputs["read"], inputs["explain"]
    tracks, fit = shot.tracks, view_run(shot)
    appearance = estimate_clip_appearance(inputs["background"], clip)
    render_slow_motion(clip, appearance, tracks, fit, folder / SLOW_FILE, options, progress)
