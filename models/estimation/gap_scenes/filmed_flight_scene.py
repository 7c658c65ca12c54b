"""Flights that one camera filmed, for the diagnosis: what is compared are places in the image.

Their places in space follow from the law of flight itself, and would confirm whatever that law is. A flight is
therefore simulated in space and observed through the camera of the run; how far away it is remains part of the fit. The
inputs of a row are the axis of a lift that acts upwards (3), the path that the run found (3), whose rates are its
velocity, and the rows of the camera matrix (12).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from models.core.rally import Rally
from models.core.recording import Recording, ReferenceFrame
from models.core.typing import FloatArray
from models.estimation.gap_scenes.contact_free_scene import ContactFreeScene
from models.estimation.gap_scenes.flight_scene import build_flight_scene
from models.estimation.gap_scenes.motion_integrator import RealOrComplexArray
from models.physics.flight.flight_motion import fly_flight

IMAGE_FRAME = ReferenceFrame(("x_px", "y_px"), "px", "in the image")
INPUT_COUNT = 18
# Least number of places of a flight, and lengths of turn-over after which nothing of it is left: 1 % of its drag.
LEAST_PLACES, TURN_LENGTHS = 8, 2.0
# px, least error of a place, and share of the length of a streak by which its middle may err.
LEAST_SIGMA_PX, STREAK_SHARE = 0.5, 0.05
# m and m/s about the path that the run found within which a flight is sought: without it, a short one has no depth.
START_SIGMA = np.array([2.0, 2.0, 2.0, 5.0, 5.0, 5.0])


@dataclass(frozen=True)
class FilmedFlightScene(ContactFreeScene):
    """Flights in space that are observed in an image."""

    def guess_starts(self, segment: Recording, count: int) -> tuple[FloatArray, FloatArray]:
        """Return place and velocity (6 N,) of the bodies on the path that the run found, and their errors."""
        assert segment.inputs is not None
        start = np.moveaxis(segment.inputs[0, :, 3:6], 2, 1).ravel()
        return start, np.tile(START_SIGMA, len(segment.bodies))

    def observe(self, segment: Recording, places: RealOrComplexArray) -> RealOrComplexArray:
        """Project places (T, 3, N, ...), m, into the image (T, 2, N, ...), px."""
        assert segment.inputs is not None
        matrix = segment.inputs[:, :, 6:, 0].reshape(len(segment.t), -1, 3, 4)
        spare = (1,) * (places.ndim - 3)
        shift = np.moveaxis(matrix[..., 3], 1, 2).reshape(len(matrix), 3, -1, *spare)
        ahead = np.einsum("tnij,tjn...->tin...", matrix[..., :3], places) + shift
        projected: RealOrComplexArray = ahead[:, :2] / ahead[:, 2:]
        return projected


def build_filmed_flight_scene(simulator_effects: tuple[str, ...]) -> FilmedFlightScene:
    """Build the scene of a simulator that has gravity and further effects."""
    scene = build_flight_scene(3, simulator_effects=simulator_effects, has_spin_axis=True)
    own = {one.name: getattr(scene, one.name) for one in fields(scene)}
    return replace(FilmedFlightScene(**own), input_count=INPUT_COUNT)


def record_flights(rally: Rally) -> tuple[Recording, ...]:
    """Record the flights of a rally as they were seen, each as a shot; the turn-over of a shuttle is left out."""
    camera, item = rally.scene.camera, rally.scene.sport.object
    recordings: list[Recording] = []
    for flight in rally.flights:
        rows = np.flatnonzero(rally.is_used & (rally.t >= flight.start) & (rally.t <= flight.end))
        states = fly_flight(flight, rally.t[rows], item).states
        if flight.begins_with_hit and item.turn_length > 0:
            steps = np.diff(states[:, :3], axis=0, prepend=flight.parameters[None, :3])
            turned = np.cumsum(np.linalg.norm(steps, axis=1)) > TURN_LENGTHS * item.turn_length
            rows, states = rows[turned], states[turned]
        if len(rows) < LEAST_PLACES:
            continue
        frame = rally.frame[rows]
        level = np.linalg.norm(states[:, 3:5], axis=1)
        inputs = np.zeros((len(rows), 1, INPUT_COUNT, 2))
        inputs[:, 0, 0, 0], inputs[:, 0, 1, 0] = states[:, 4] / level, -states[:, 3] / level
        inputs[:, 0, 3:6] = np.stack([states[:, :3], states[:, 3:]], axis=2)
        inputs[:, 0, 6:, 0] = np.broadcast_to(camera.matrix_of(frame), (len(rows), 3, 4)).reshape(-1, 12)
        claimed = np.maximum(rally.px_sigma[rows].mean(axis=1), LEAST_SIGMA_PX)
        sigma = np.hypot(claimed, STREAK_SHARE * np.linalg.norm(rally.streak[rows], axis=1))
        recordings.append(
            Recording(
                len(recordings), frame, rally.t[rows], (item.name,), camera.undistort(rally.px[rows])[:, None],
                sigma[:, None], IMAGE_FRAME, False, inputs,
            )
        )  # fmt: skip
    return tuple(recordings)
