"""The billiards fit as a method on the balls of a clip: contacts, friction and cushions, from the visible frames."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from models.core.tracks import Tracks
from models.core.typing import FloatArray, IntArray
from models.neural.common.method_interface import TrainingBudget, validate_samples
from pipeline.experiments.thesis.assessed_motion import AssessedMotion
from pipeline.experiments.thesis.scenes.pool_scene import read_complete_segment
from pipeline.io.observed_shot import read_observed_shot


@dataclass(frozen=True, slots=True)
class BilliardsFit:
    """The fit of a shot, given the table, the camera and the measurement errors of the run."""

    run: Path
    shot: int
    name: str = "physics fit"

    def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: TrainingBudget) -> AssessedMotion:
        """Fit the shot; seed and budget have no effect. Positions in metres are those of the run at these times."""
        from models.estimation.reconstruction.explain_shot import explain
        from models.estimation.reconstruction.shot_views import view_shot  # slow to import

        t, _ = validate_samples(times, states)
        segment = read_complete_segment(self.run, self.shot)
        tracks, scene, _ = read_observed_shot(self.run, self.shot)
        began = time.process_time()
        visible = select_tracks(tracks, find_nearest_rows(tracks.t, t + segment.t[0]), segment.ids)
        fit = view_shot(explain(visible, scene))
        seconds = time.process_time() - began
        radius = scene.table.ball_radius

        def motion(t: FloatArray) -> FloatArray:
            frames = tracks.frame[find_nearest_rows(tracks.t, t + segment.t[0])]
            xy = fit.trajectory.at(t + segment.t[0]).xy
            order = [fit.trajectory.ids.index(name) for name in segment.ids]
            return scene.camera.to_pixels(xy[:, order], radius, frames[:, None])

        doubts = fit.trust.reasons if fit.trust.level == "red" else ()
        return AssessedMotion(motion, np.empty(0), len(fit.parameters), seconds, tuple(doubts))


def find_nearest_rows(t: FloatArray, wanted: FloatArray) -> IntArray:
    """Find the row of t (T,) that is nearest to each of the times `wanted` (M,)."""
    return np.asarray(np.abs(t[:, None] - wanted).argmin(axis=0), np.int64)


def select_tracks(tracks: Tracks, rows: IntArray, ids: tuple[str, ...]) -> Tracks:
    """Select frames and balls of tracks."""
    balls = np.array([tracks.ids.index(name) for name in ids])
    part = np.ix_(rows, balls)
    return replace(
        tracks, frame=tracks.frame[rows], t=tracks.t[rows], ids=ids, kinds=tuple(tracks.kinds[k] for k in balls),
        xy=tracks.xy[part], px=tracks.px[part], sigma=tracks.sigma[part], sigma_along=tracks.sigma_along[part],
        streak=tracks.streak[part], radius_px=tracks.radius_px[part], colour=tracks.colour[balls],
        image_jacobian=None if tracks.image_jacobian is None else tracks.image_jacobian[part],
    )  # fmt: skip
