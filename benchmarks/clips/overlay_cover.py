"""Count the pixels of balls that the annotation of the slow motion hides.

    python -m benchmarks.clips.overlay_cover [CLIP|DIR...] [--slow 4] [--style coach]

A pixel of a ball is hidden where the annotation changes it: in a frame of the slow motion, within the circle of a ball
less one pixel, which encloses its edge. A clip is run first; of a run folder the saved fit and the clip that it notes
are used. Prints one row per clip; exits with 1 if a moving ball, or one that it touches, is hidden.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np

from benchmarks.support.run_folder import ROOT
from models.core.fit_result import Fit
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.core.typing import BoolArray, ImageArray
from pipeline.actions.answer_call import open_run_clip
from pipeline.api import load, run
from video.drawing.masks import disc_mask
from video.io.clip import Clip, open_clip, read_frames
from video.io.video_options import OverlayStyle, RenderOptions
from video.matting.ball_timeline import build_ball_timeline
from video.matting.hidden_background import estimate_hidden_background
from video.overlay.annotation import prepare_annotation
from video.overlay.frame_overlay import FrameBalls
from video.overlay.slow_motion import find_output_times, synthesize_frames
from video.synthesis.frame_synthesis import estimate_clip_appearance

# Time before and after a contact in which its balls count, also the one that still rests, s.
CONTACT_SECONDS = 0.05
# Edge of a ball that is mixed with the cloth, px.
EDGE_PX = 1.0


@dataclass(frozen=True)
class HiddenPixels:
    """Pixels of balls over all frames of a slow motion."""

    frames: int
    moving: int
    """Hidden pixels of moving balls, and of balls in contact."""
    resting: int
    """Hidden pixels of the others."""
    drawn: int
    """Pixels that the annotation changed."""
    named: int
    """Names that the annotation showed, added over the frames."""


def count_hidden_pixels(clip: Clip, scene: Scene, tracks: Tracks, fit: Fit, options: RenderOptions) -> HiddenPixels:
    """Count the hidden pixels of balls over the frames of a slow motion.

    Args:
        scene: Table and camera.
        tracks: Tracks of the balls.
        fit: Fitted motion and events.
        options: Slowdown and style.
    """
    timeline = build_ball_timeline(scene, tracks, fit)
    appearance = estimate_clip_appearance(estimate_hidden_background(timeline, clip), clip)
    counts = np.zeros(5, dtype=np.int64)
    (first,) = (image for _, image in read_frames(clip, indices=timeline.frame[:1]))
    annotation = prepare_annotation(timeline, tracks, fit, first, options.slow, options.style)
    for frame in synthesize_frames(clip, appearance, find_output_times(clip, timeline, options)):
        before = frame.image.copy()
        drawn = annotation.draw(frame.image, frame.t, frame.balls, frame.table_positions)[: clip.height]
        changed = (drawn != before).any(axis=2)
        active = frame.balls.moving | find_touching(fit, tracks, frame.t)
        hidden = [count_in_discs(changed, frame.balls, which) for which in (active, ~active)]
        counts += [1, *hidden, int(changed.sum()), len(annotation.name_rects)]
    return HiddenPixels(*counts.tolist())


def find_touching(fit: Fit, tracks: Tracks, t: float) -> BoolArray:
    """Return which balls (N,) are about to touch another, or have just done so."""
    near = np.abs(fit.events.t - t) < CONTACT_SECONDS
    bodies = {name for k in np.flatnonzero(near) for name in (fit.events.a[k], fit.events.b[k])}
    return np.array([name in bodies for name in tracks.ids])


def count_in_discs(changed: BoolArray, balls: FrameBalls, which: BoolArray) -> int:
    """Count the changed pixels (H, W) in the circles of some balls (N,)."""
    mask: ImageArray = np.zeros(changed.shape, np.uint8)
    for ball in balls.present[which[balls.present]]:
        disc, x, y = disc_mask(balls.centre[ball], max(float(balls.radius[ball]) - EDGE_PX, 1.0))
        rows, columns = np.nonzero(disc == 255)
        rows, columns = rows + y, columns + x
        inside = (rows >= 0) & (columns >= 0) & (rows < mask.shape[0]) & (columns < mask.shape[1])
        mask[rows[inside], columns[inside]] = 1
    return int((changed & (mask > 0)).sum())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="*", type=Path, default=sorted((ROOT / "sample_videos").glob("*.mp4")))
    parser.add_argument("--slow", type=float, default=4.0, help="Slow-down factor.")
    parser.add_argument("--style", choices=get_args(OverlayStyle), default="coach", help="Style of the overlay.")
    arguments = parser.parse_args()
    worst = 0
    print(f"{'clip':44}{'frames':>8}{'moving px':>12}{'resting px':>12}{'drawn px':>12}{'names':>8}")
    for path in arguments.clips:
        if path.is_dir():
            shot = load(path)
            clip, why_not = open_run_clip(path, None)
            if clip is None:
                print(f"{path.name:44}{why_not}", flush=True)
                continue
        else:
            with tempfile.TemporaryDirectory() as folder:
                shot, clip = run(path, folder, no_video=True), open_clip(path)
        options = RenderOptions(slow=arguments.slow, style=arguments.style)
        count = count_hidden_pixels(clip, shot.scene, shot.tracks, shot.fit, options)
        worst = max(worst, count.moving)
        row = f"{count.moving:12}{count.resting:12}{count.drawn:12}{count.named / count.frames:8.2f}"
        print(f"{path.stem:44}{count.frames:8}{row}", flush=True)
    return int(worst > 0)


if __name__ == "__main__":
    sys.exit(main())
