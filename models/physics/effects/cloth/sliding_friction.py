"""Sliding friction: Coulomb friction between ball and cloth until the ball rolls; it turns spin into motion.

The contact point slips with u; the centre accelerates by -mu g u/|u|, and u itself shrinks at 7/2 mu g.
"""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="sliding_friction",
    site="cloth",
    phases=("after_strike", "ball_contact", "cushion_contact"),
    parameters=(Prior("mu", "1", value=0.2, sigma=0.25, relative=True, bounds=(0.05, 0.5)),),
    neutral=(0.0,),
    reference="Alciatore, billiards.colostate.edu, physical properties of billiard equipment: 0.15 to 0.25",
    rank=1,
    slot=0,
)
