"""Rolling shutter: the camera exposes lower rows of the image later.

A row is exposed at t + readout (row - middle row) / rows, so the image centre keeps its time. readout is positive
where lower rows are later.
"""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="rolling_shutter",
    kind="observation",
    site="camera",
    phases=("free_roll", "after_strike", "ball_contact", "cushion_contact"),
    parameters=(Prior("readout", "s", value=0.0, sigma=0.005, relative=False, bounds=(-0.05, 0.05)),),
    neutral=(0.0,),
    partners=("nap",),
    reference="Liang, Chang, Chen 2008, doi:10.1109/TIP.2008.925384: 10 to 30 ms for a phone",
    rank=21,
)
