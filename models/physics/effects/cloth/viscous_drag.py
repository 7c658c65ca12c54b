"""Viscous drag decelerates a ball in proportion to its speed: a = -k v."""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="viscous_drag",
    site="cloth",
    phases=("free_roll", "after_strike", "ball_contact", "cushion_contact"),
    parameters=(Prior("k", "1/s", value=0.0, sigma=0.05, relative=False, bounds=(0.0, 2.0)),),
    neutral=(0.0,),
    partners=("air_drag", "rolling_resistance"),
    bends_path=True,
    reference="Rolling friction that grows with speed (Witters, Duymelinck 1986, doi:10.1119/1.14746): some 0.01 1/s",
    rank=5,
    slot=5,
)
