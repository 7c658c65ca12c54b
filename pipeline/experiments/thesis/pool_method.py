"""The fit of billiards as a method on the balls of a clip: contacts, friction, cushions, from the visible pictures."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from models.core.tracks import Tracks
from models.core.typing import FloatArray, IntArray
from models.neural.common.method_interface import Budget, checked
from pipeline.experiments.thesis.assessed_motion import Judged
from pipeline.experiments.thesis.scenes.pool_scene import stretch_of
from pipeline.io.observed_shot import read_seen_shot


@dataclass(frozen=True, slots=True)
class BilliardsFit:
    """Told what the run knows beside places: the table, the camera, and the errors of what was seen."""

    run: Path
    shot: int
    name: str = "physics fit"

    def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: Budget) -> Judged:
        """Neither seed nor budget matter; the places in metres are those of the run at these times."""
        from models.estimation.reconstruction.fit_shot import fit_shot  # slow to import

        t, _ = checked(times, states)
        stretch = stretch_of(self.run, self.shot)
        tracks, scene, _ = read_seen_shot(self.run, self.shot)
        began = time.process_time()
        shown = part_of(tracks, nearest(tracks.t, t + stretch.t[0]), stretch.ids)
        fit = fit_shot(shown, scene)
        seconds = time.process_time() - began
        radius = scene.table.ball_radius

        def motion(t: FloatArray) -> FloatArray:
            frames = tracks.frame[nearest(tracks.t, t + stretch.t[0])]
            xy = fit.trajectory.at(t + stretch.t[0]).xy
            order = [fit.trajectory.ids.index(name) for name in stretch.ids]
            return scene.camera.to_pixels(xy[:, order], radius, frames[:, None])

        doubts = fit.trust.reasons if fit.trust.light == "red" else ()
        return Judged(motion, np.empty(0), len(fit.parameters), seconds, tuple(doubts))


def nearest(t: FloatArray, wanted: FloatArray) -> IntArray:
    """Row of t (T,) that is nearest to each wanted time (M,)."""
    return np.asarray(np.abs(t[:, None] - wanted).argmin(axis=0), np.int64)


def part_of(tracks: Tracks, rows: IntArray, ids: tuple[str, ...]) -> Tracks:
    """Some pictures and balls of tracks."""
    balls = np.array([tracks.ids.index(name) for name in ids])
    part = np.ix_(rows, balls)
    return replace(
        tracks, frame=tracks.frame[rows], t=tracks.t[rows], ids=ids, kinds=tuple(tracks.kinds[k] for k in balls),
        xy=tracks.xy[part], px=tracks.px[part], sigma=tracks.sigma[part], sigma_along=tracks.sigma_along[part],
        streak=tracks.streak[part], radius_px=tracks.radius_px[part], colour=tracks.colour[balls],
        lay=None if tracks.lay is None else tracks.lay[part],
    )  # fmt: skip
