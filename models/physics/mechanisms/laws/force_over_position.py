"""A probe for an unnamed force over the position of a joint: a sum of cosine waves over its range."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray
from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength, in_force

# Half waves of the shortest cosine: teeth that are narrower than an eighth of the motion are not followed.
_HALF_WAVES = 8


def _sum_waves(q: FloatArray, v: FloatArray, p: tuple[FloatArray, ...]) -> FloatArray:
    """Sum cosine waves, which are constant beyond the range; a cosine series follows any smooth curve in it."""
    angle = np.pi * np.clip((q + 1) / 2, 0.0, 1.0)
    return np.asarray(np.sum([size * np.cos(n * angle) for n, size in enumerate(p)], axis=0))


EFFECT = MechanismEffect(
    name="force_over_position",
    site="line",
    strengths=tuple(
        MechanismStrength(f"c{n}", in_force, lambda scale: scale.force, lower=-30.0) for n in range(_HALF_WAVES + 1)
    ),
    force=_sum_waves,
    reference="a cosine series in position",
    kind="probe",
)
