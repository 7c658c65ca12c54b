"""A synthetic clip of two discs on cloth with the exact tracks and fit of its motion."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from models.core.detections import Detections
from models.core.events import Events
from models.core.fit_result import CauseHypothesis, Fit, Moment, Parameter, ShotExplanation, Trust
from models.core.scene import Camera, Scene, Table
from models.core.shot import Shot
from models.core.tracks import Tracks
from models.core.trajectory import CaptureClock, Trajectory
from pipeline.io.saved_shot import publish_shot, write_shot
from video.io.clip import Clip, open_clip
from video.io.video_writer import VideoWriter

RATE = 30
FRAMES = 24
PX_PER_M = 100.0
SPEED = 1.0
"""m/s of the white ball along x; the red ball is at rest."""


def make_scene() -> Scene:
    table = Table("carom-small", "carom", 2.0, 1.0, 0.03, 0.21, False)
    matrix = np.array([[PX_PER_M, 0, 0, 20.0], [0, PX_PER_M, 0, 20.0], [0, 0, 0, 1.0]])
    corners = PX_PER_M * table.corners + 20.0
    camera = Camera(matrix, 240, 140, corners, np.eye(8), "noses", 3.0, 1.0)
    return Scene(table, camera, np.array([40.0, -20.0, 10.0]), ("The table is made up.",))


def make_paths(t: np.ndarray) -> np.ndarray:
    """(T, 2, 2) m of white and red."""
    white = np.stack([0.2 + SPEED * t, np.full_like(t, 0.5)], axis=-1)
    return np.stack([white, np.broadcast_to([1.5, 0.3], white.shape)], axis=1)


def write_clip(path: Path) -> Clip:
    t = np.arange(FRAMES) / RATE
    with VideoWriter(path, 240, 140, Fraction(RATE)) as writer:
        for places in make_paths(t):
            image = np.full((140, 240, 3), (30, 110, 70), np.uint8)
            for (x, y), colour in zip(20 + PX_PER_M * places, ((240, 240, 235), (200, 30, 30)), strict=True):
                cv2.circle(image, (round(16 * x), round(16 * y)), 48, colour, -1, cv2.LINE_AA, 4)
            writer.write(image)
    return open_clip(path)


def make_fit(t: np.ndarray) -> Fit:
    end = float(t[-1])
    trajectory = Trajectory(
        ids=("white", "red"),
        ball=np.array([0, 1]),
        start=np.zeros(2),
        end=np.full(2, end),
        position=np.array([[[0.2, 0.5], [SPEED, 0], [0, 0], [0, 0]], [[1.5, 0.3], [0, 0], [0, 0], [0, 0]]]),
        spin=np.zeros((2, 2, 3)),
        phase=("roll", "rest"),
        covariance=np.tile(1e-6 * np.eye(4), (2, 1, 1)),
    )
    events = Events(
        kind=("strike", "cushion"), t=np.array([0.1, 0.5]),
        t_sigma=np.array([0.002, 0.001]), frame=np.array([3.0, 15.0]),
        a=("white", "white"), b=("", "right"), xy=np.array([[0.3, 0.5], [0.7, 0.5]]), probability=np.array([1.0, 0.9]),
        gap=np.array([np.nan, -0.01]), gap_sigma=np.array([np.nan, 0.001]), speed=np.array([1.0, 0.5]),
    )  # fmt: skip
    everywhere = np.ones((len(t), 2), bool)
    return Fit(
        events=events,
        trajectory=trajectory,
        parameters=(Parameter("rolling_resistance.mu", 0.01, 0.001, "1", False),),
        noise=0.001,
        chi2_per_dof=1.1,
        residual=np.zeros((len(t), 2, 2)),
        moving=everywhere & [True, False],
        accepted=everywhere,
        trust=Trust("green", ("everything is made up",)),
    )


def make_unexplained_shot(tracks: Tracks, scene: Scene) -> Shot:
    """Make a shot that nothing explains."""
    clock = CaptureClock(tracks.t, tracks.t, np.zeros(len(tracks.t)))
    return Shot(scene, tracks, clock, np.full((*tracks.xy.shape, 2), np.nan), None)


def save_shot(shot: Shot, folder: Path, options: dict[str, object] | None = None, version: str = "1") -> None:
    """Save a shot in a run folder as a run does."""
    with TemporaryDirectory() as fresh:
        write_shot(shot, options or {}, version, Path(fresh))
        publish_shot(Path(fresh), folder)


def make_unsure_fit(t: np.ndarray) -> Fit:
    """The cushion of `make_fit` is undecided, and so is whether white touched red at 0.6 s."""
    fit = make_fit(t)
    moments = (
        Moment("white", 0.1, 0.002, np.array([0.3, 0.5]), (CauseHypothesis("strike", "", 0.97),)),
        Moment(
            "white", 0.5, 0.001, np.array([0.7, 0.5]),
            (CauseHypothesis("cushion", "right", 0.61), CauseHypothesis("unexplained", "", 0.39)), ("few_samples",),
        ),
        Moment(
            "white", 0.7, 0.001, np.array([0.9, 0.5]),
            (CauseHypothesis("none", "", 0.8), CauseHypothesis("ball", "red", 0.2)), ("close_pass",),
        ),
    )  # fmt: skip
    events = replace(fit.events, probability=np.array([0.97, 0.61]))
    return replace(fit, events=events, explanation=ShotExplanation(moments))


def make_tracks(clip: Clip, scene: Scene) -> Tracks:
    t = clip.t[clip.distinct_frames]
    xy = make_paths(t)
    px = scene.camera.to_pixels(xy, scene.table.ball_radius)
    one = np.ones(xy.shape[:2])
    colour = np.array([[95.0, 0.0, 3.0], [45.0, 60.0, 40.0]])
    names = ("white", "red")
    return Tracks(
        clip.distinct_frames, t, names, names, xy, px, 0.002 * one, 0.002 * one, np.zeros_like(xy), 3 * one, colour
    )


def make_detections(tracks: Tracks) -> Detections:
    times, balls = tracks.px.shape[:2]
    one = np.ones(times * balls)
    return Detections(
        frame=np.repeat(tracks.frame, balls), centre=tracks.px.reshape(-1, 2), radius=3 * one,
        streak=np.zeros((len(one), 2)), colour=np.tile(tracks.colour, (times, 1)), white=0 * one,
        white_rim=0 * one, value=0.5 * one,
        score=one, sigma=0.2 * one, sigma_along=0.2 * one,
    )  # fmt: skip
