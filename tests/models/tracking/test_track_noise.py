"""Errors of tracks: an oblique view stretches a circle of pixels into an ellipse on the table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.detections import Detections
from models.core.scene import Camera, Scene, Table
from models.core.tracks import Tracks
from models.tracking.build_tracks import build_tracks
from models.tracking.track_noise import apply_noise, estimate_noise

PLACE = np.array([0.7, 0.4])
SIGMA_PX = 0.8
FRAMES = 600


def oblique_scene() -> Scene:
    """A camera that looks along a 9 ft table from a height of 1.3 m."""
    table = Table("pool-9ft", "pool", 2.54, 1.27, 0.028575, 0.17, False)
    eye, target = np.array([4.2, 0.6, 1.3]), np.array([1.0, 0.6, 0.0])
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.stack([right, np.cross(forward, right), forward])
    optics = np.array([[1000.0, 0, 512], [0, 1000.0, 288], [0, 0, 1]])
    matrix = optics @ np.column_stack([pose, -pose @ eye])
    camera = Camera(matrix, 1024, 576, np.zeros((4, 2)), np.eye(8), "cloth", 1.3, 0.1)
    return Scene(table, camera, np.array([40.0, -30.0, 0.0]), ())


def make_resting_tracks() -> tuple[Tracks, np.ndarray]:
    """Tracks of a ball that rests at `PLACE`, with isotropic errors of its centre in the image; errors, m."""
    rng, scene = np.random.default_rng(7), oblique_scene()
    centre = scene.camera.to_pixels(PLACE, scene.table.ball_radius) + rng.normal(0, SIGMA_PX, (FRAMES, 2))
    one, frame = np.ones(FRAMES), np.arange(FRAMES)
    colour = np.tile([80.0, 0.0, 10.0], (FRAMES, 1))
    detections = Detections(
        frame, centre, 8 * one, np.zeros((FRAMES, 2)), colour, one, one, one, one, SIGMA_PX * one, SIGMA_PX * one
    )  # fmt: skip
    tracks = build_tracks(detections, frame, frame / 30, scene)
    return tracks, tracks.xy[:, 0] - PLACE


def test_whitened_errors_of_an_oblique_view_are_one_in_every_direction() -> None:
    tracks, off = make_resting_tracks()
    white = np.einsum("tij,tj->ti", tracks.whitening[:, 0], off)
    np.testing.assert_allclose(np.cov(white.T), np.eye(2), atol=0.2)


def test_depth_is_less_certain_than_breadth_in_an_oblique_view() -> None:
    tracks, off = make_resting_tracks()
    assert off[:, 0].std() > 2 * off[:, 1].std()
    np.testing.assert_allclose(off.std(axis=0), np.median(tracks.sigma_xy[:, 0], axis=0), rtol=0.15)
    np.testing.assert_allclose(np.sqrt((off**2).mean()), np.median(tracks.sigma), rtol=0.15)


def test_a_ball_that_steps_between_two_places_keeps_its_stated_sigma() -> None:
    tracks, _ = make_resting_tracks()
    steps = np.repeat(np.random.default_rng(3).integers(0, 2, FRAMES // 10), 10)[:, None, None]
    stepping = replace(tracks, xy=PLACE + steps * np.array([0.015, 0.0]))
    noise = estimate_noise(stepping, 0.1, 0.028575)
    assert np.all(apply_noise(stepping, noise).sigma >= stepping.sigma)
