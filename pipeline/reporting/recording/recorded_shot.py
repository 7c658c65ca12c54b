"""A shot as it is drawn in a recording: what was found, the motion sampled once, and colours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.fit_result import Fit
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.core.trajectory import State
from models.core.typing import ByteArray, FloatArray
from pipeline.reporting.figures.motion_samples import ever_moves, few_points, moments
from video.drawing.palette import INK, apart_from, ball_colour, on_any_ground
from video.io.clip import Clip

PATH_HZ = 100.0
"""Samples per second of the fitted paths and plots."""
WAY_OFF = 0.05
"""Ball radii that a drawn line may leave the path: no eye sees it, and few points make a light recording."""


@dataclass(frozen=True, slots=True)
class Shot:
    """N balls of one clip."""

    clip: Clip
    scene: Scene
    tracks: Tracks
    fit: Fit
    t: FloatArray
    """(K,) s, evenly over the motion."""
    state: State
    """of all balls at t."""
    moves: NDArray[np.bool_]
    """(N,) which balls get somewhere."""
    lines: ByteArray
    """(N, 3) of what is drawn over the picture."""
    plotted: ByteArray
    """(N, 3) of what is drawn on the viewer's own ground, which is dark or light as its user has it."""

    @property
    def ids(self) -> tuple[str, ...]:
        return self.fit.trajectory.ids

    def way(self, ball: int) -> tuple[FloatArray, FloatArray]:
        """Moments (n,) s and places (n, 2) m of a ball's path, as few as its line needs."""
        there = np.isfinite(self.state.xy[:, ball, 0])
        t, xy = self.t[there], self.state.xy[there, ball]
        kept = few_points(xy, WAY_OFF * self.scene.table.ball_radius)
        return t[kept], xy[kept]

    def in_pictures(self, xy: FloatArray) -> NDArray[np.float32]:
        """Places (n, 2) m in px: (F, n, 2) of every picture where the camera drifts, (1, n, 2) of all else."""
        radius, camera = self.scene.table.ball_radius, self.scene.camera
        if camera.motion is None:
            return camera.to_pixels(xy, radius)[None].astype(np.float32)
        return np.array([camera.to_pixels(xy, radius, k) for k in range(self.clip.frame_count)], dtype=np.float32)


def shot_of(clip: Clip, scene: Scene, tracks: Tracks, fit: Fit) -> Shot:
    """What the layers of a recording are drawn from."""
    seen = [ball_colour(*ball) for ball in zip(tracks.kinds, tracks.colour, strict=True)]
    lines = np.array([apart_from(colour, INK) for colour in seen], dtype=np.uint8).reshape(-1, 3)
    plotted = np.array([on_any_ground(colour) for colour in seen], dtype=np.uint8).reshape(-1, 3)
    t = moments(fit.trajectory, PATH_HZ)
    state = fit.trajectory.at(t)
    return Shot(clip, scene, tracks, fit, t, state, ever_moves(state.xy, scene.table.ball_radius), lines, plotted)
