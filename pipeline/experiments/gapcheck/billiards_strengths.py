"""How strong effects are on tables of billiards, and how far tables differ.

Natural strengths are drawn evenly between two values, either sign where an effect has one. Where they come from:

- slope: 0.2 mm/m is allowed (WPA equipment specifications, section 3), homes have 1 to 3;
- drag: a ball in air has 0.5 rho c_d A / m = 0.005 1/m, dusty and new cloths slow fast balls by several times that;
- nap: a tenth to a third of rolling resistance; snooker players allow for as much;
- cushions: friction 0.14 (Mathavan 2010) to 0.2 (Han 2005); restitution falls from 0.98 at 1 m/s to 0.8 at 4 m/s
  (Mathavan 2010, figure 8), which is 0.06 s/m;
- ball friction 0.03 to 0.08 (Marlow 1995, table 4); a cue ball is up to 6 % heavier or lighter, and 1 to 3 % larger
  or smaller (coin-operated tables);
- other forms: e = v^-0.2 of dropped and driven balls (Stronge 2000, section 5); a lens whose r^4 is what is left of it;
- lens: r (1 + k1 r^2), 1 to 3 % at the end of the table for the cameras of phones; a length wrong by 0.5 to 2 %; a
  readout of 5 to 15 ms for a phone (Liang, Chang, Chen 2008), and one to three pictures lost.
"""

from __future__ import annotations

from collections.abc import Set

import numpy as np

Effects = dict[str, dict[str, float]]

TABLES = {
    "sliding_friction.mu": (0.16, 0.24), "rolling_resistance.mu": (0.007, 0.013), "spin_decay.rate": (7.0, 13.0),
    "cushion_restitution.e": (0.75, 0.9), "ball_restitution.e": (0.92, 0.97),
}  # fmt: skip
"""What acts on every table."""
NATURAL = {
    "slope.slope_x": (1.0, 3.0), "slope.slope_y": (1.0, 3.0), "air_drag.k": (0.01, 0.04),
    "viscous_drag.k": (0.02, 0.06), "nap.mu": (0.001, 0.003), "cushion_restitution_speed.slope": (0.03, 0.08),
    "cushion_friction.mu": (0.12, 0.22), "ball_friction.mu": (0.03, 0.08), "unequal_mass.ratio": (0.03, 0.06),
    "unequal_radius.ratio": (0.01, 0.03), "lens_distortion.k1": (0.01, 0.03), "perspective.p_x": (0.005, 0.02),
    "perspective.p_y": (0.005, 0.02), "scale.seen": (0.005, 0.02), "rolling_shutter.readout": (0.005, 0.015),
    "dropped_frames.frames": (1.0, 3.0), "sticky_patch.mu": (0.005, 0.01), "curl.c": (0.1, 0.3),
    "ageing.mu": (0.0003, 0.0008),
}  # fmt: skip
"""Of ratios the difference from 1; of ageing the rolling resistance that every shot adds."""
OF_OTHER_FORM = {"cushion_restitution_power.power": (0.15, 0.25), "lens_fourth.k2": (0.01, 0.03)}
"""What no library holds, but one of its effects comes near."""
SIGNED = (
    "slope", "nap", "unequal_mass", "unequal_radius", "lens_distortion", "perspective", "scale", "rolling_shutter",
)  # fmt: skip
PATCH = {"x": (0.6, 1.9), "y": (0.4, 0.9)}
"""m, where a sticky patch may lie."""


def strengths(rng: np.random.Generator, names: Set[str]) -> Effects:
    """What acts on one table: what acts on all, and these effects. All are drawn, so that tables of one seed of `rng`
    differ in what acts alone."""
    found: Effects = {}
    for name, span in TABLES.items():
        effect, parameter = name.split(".")
        found.setdefault(effect, {})[parameter] = float(rng.uniform(*span))
    for name, span in NATURAL.items():
        effect, parameter = name.split(".")
        value = float(rng.uniform(*span) * (rng.choice([-1, 1]) if effect in SIGNED else 1))
        if effect in names:
            found.setdefault(effect, {})[parameter] = value
    for name, span in OF_OTHER_FORM.items():
        effect, parameter = name.split(".")
        if effect in names:
            found[effect] = {parameter: float(rng.uniform(*span))}
    if "sticky_patch" in found:
        found["sticky_patch"] |= {axis: float(rng.uniform(*span)) for axis, span in PATCH.items()}
    return found
