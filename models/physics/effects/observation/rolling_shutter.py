"""Rolling shutter: lower rows of the picture are taken later.

A row is taken at t + readout (row - middle) / rows: the middle of the picture keeps its time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class RollingShutter:
    """Above 0 where lower rows are later."""

    name: str = "rolling_shutter"
    kind: EffectKind = "observation"
    phases: tuple[Phase, ...] = ("free_roll", "after_strike", "ball_contact", "cushion_contact")
    parameters: tuple[Prior, ...] = (Prior("readout", "s", 0.0, 0.005, False, (-0.05, 0.05)),)
    neutral: tuple[float, ...] = (0.0,)
    partners: tuple[str, ...] = ("nap",)
    reference: str = "Liang, Chang, Chen 2008, doi:10.1109/TIP.2008.925384: 10 to 30 ms for a phone"
