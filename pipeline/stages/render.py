"""Render: the annotated slow motion and the poster."""

from __future__ import annotations

from pathlib import Path

from models.progress import Progress
from pipeline.stage import Inputs, Stage
from video.poster import render_poster
from video.slowmotion import RenderOptions, render_slow_motion


def render_stage(options: RenderOptions) -> Stage:
    return Stage("render", __name__, ("read", "calibrate", "track", "fit"), None, _run, options)


def _run(inputs: Inputs, options: RenderOptions, folder: Path, progress: Progress) -> None:
    shot = (inputs["read"], inputs["calibrate"], inputs["track"], inputs["fit"])
    render_poster(*shot, folder / "poster.png", options)
    render_slow_motion(*shot, folder / "slow.mp4", options, progress)
