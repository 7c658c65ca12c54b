"""The render stage: the annotated slow motion and the poster."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage
from pipeline.reporting.text.run_trust import assess_run_trust
from video.io.video_options import RenderOptions

START_FILE = "start.json"
"""File with the time in the clip of the first frame of the slow motion, s."""


def render_stage(options: RenderOptions) -> Stage:
    """Build the stage that renders the slow motion.

    Args:
        options: Options of the stage.

    Returns:
        The stage `render`, whose output is a folder with slow.mp4, poster.png and start.json.
    """
    return Stage("render", __name__, ("read", "calibrate", "track", "fit"), None, _render_slow_motion, options)


def _render_slow_motion(inputs: Inputs, options: RenderOptions, folder: Path, progress: Progress) -> None:
    """Render the slow motion and the poster."""
    from video.matting.ball_timeline import build_ball_timeline
    from video.overlay.poster import Poster
    from video.overlay.slow_motion import render_slow_motion
    from video.synthesis.frame_synthesis import estimate_clip_appearance  # slow to import

    clip, tracks, fit = (inputs[name] for name in ("read", "track", "fit"))
    fit = replace(fit, trust=assess_run_trust(clip, fit))
    scenery = estimate_clip_appearance(build_ball_timeline(inputs["calibrate"], tracks, fit), clip)
    poster = Poster.for_clip(scenery)
    start = render_slow_motion(clip, scenery, tracks, fit, folder / "slow.mp4", options, progress, poster.add_frame)
    poster.write(tracks, fit, folder / "poster.png", options)
    (folder / START_FILE).write_text(json.dumps(start), encoding="utf-8")
