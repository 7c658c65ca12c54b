"""Flights that one camera filmed, for the diagnosis: what is compared are places in the image.

Their places in space follow from the law of flight itself, and would confirm whatever that law is. A flight is
therefore simulated in space and observed through the camera of the run; how far away it is remains part of the fit. The
inputs of a row are the axis of a lift that acts upwards (3), the path that the run found (3), whose rates are its
velocity, and the rows of the camera matrix (12).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.gap_scenes.contact_free_scene import ContactFreeScene
from models.estimation.gap_scenes.flight_scene import build_flight_scene
from models.estimation.gap_scenes.motion_integrator import RealOrComplexArray
from models.estimation.rally.recorded_flights import INPUT_COUNT

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
