"""The flights of a rally as recordings of places in the image, with what a diagnosis needs to observe them there."""

from __future__ import annotations

import numpy as np

from models.core.rally import Rally
from models.core.recording import Recording, ReferenceFrame
from models.physics.flight.flight_motion import fly_flight

IMAGE_FRAME = ReferenceFrame(("x_px", "y_px"), "px", "in the image")
INPUT_COUNT = 18
# Least number of places of a flight, and lengths of turn-over after which nothing of it is left: 1 % of its drag.
LEAST_PLACES, TURN_LENGTHS = 8, 2.0
# px, least error of a place, and share of the length of a streak by which its middle may err.
LEAST_SIGMA_PX, STREAK_SHARE = 0.5, 0.05


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
