"""Dropped frames: frames are missing from the video while their timestamps show no gap.

From one frame of a shot on, every ball has moved on by this number of frame intervals.
"""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="dropped_frames",
    kind="observation",
    site="camera",
    phases=("time_jump",),
    parameters=(Prior("frames", "1", value=0.0, sigma=2.0, relative=False, bounds=(-20.0, 20.0)),),
    neutral=(0.0,),
    reference="Screen recorders and phones under load drop single frames",
    rank=22,
)
