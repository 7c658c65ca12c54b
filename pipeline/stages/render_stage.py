"""Render: the annotated slow motion and the poster."""

from __future__ import annotations

import json
from pathlib import Path

from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage
from video.io.options import RenderOptions

START = "start.json"
"""Where the slow motion begins: the time of the clip, s, that its first picture shows."""


def render_stage(options: RenderOptions) -> Stage:
    return Stage("render", __name__, ("read", "calibrate", "track", "fit"), None, _run, options)


def _run(inputs: Inputs, options: RenderOptions, folder: Path, progress: Progress) -> None:
    from video.matting.ball_timeline import sight
    from video.overlay.poster import Poster
    from video.overlay.slow_motion import render_slow_motion
    from video.synthesis.frame_synthesis import scenery_of  # slow to import, and not needed while cached

    clip, tracks, fit = (inputs[name] for name in ("read", "track", "fit"))
    scenery = scenery_of(sight(inputs["calibrate"], tracks, fit), clip)
    poster = Poster.of(scenery)
    start = render_slow_motion(clip, scenery, tracks, fit, folder / "slow.mp4", options, progress, poster.see)
    poster.write(tracks, fit, folder / "poster.png", options)
    (folder / START).write_text(json.dumps(start), encoding="utf-8")
