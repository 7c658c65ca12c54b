"""Natural strengths of effects on billiards tables, and their spread between tables.

Strengths are drawn uniformly from a range, with either sign where an effect has one. Sources of the ranges:

- slope: 0.2 mm/m is allowed (WPA equipment specifications, section 3), tables at home have 1 to 3;
- drag: a ball in air has 0.5 rho c_d A / m = 0.005 1/m; dusty and new cloths slow fast balls by several times that;
- nap: a tenth to a third of rolling resistance, for which snooker players allow;
- cushions: friction 0.14 (Mathavan 2010) to 0.2 (Han 2005); restitution falls from 0.98 at 1 m/s to 0.8 at 4 m/s
  (Mathavan 2010, figure 8), which is 0.06 s/m;
- ball friction 0.03 to 0.08 (Marlow 1995, table 4); a cue ball is up to 6 % heavier or lighter, and 1 to 3 % larger
  or smaller (coin-operated tables);
- other forms: e = v^-0.2 of dropped and driven balls (Stronge 2000, section 5); a lens with an r^4 term instead of r^2;
- noses: 1.25 to 1.29 R are allowed (WPA equipment specifications);
- lens: r (1 + k1 r^2), 1 to 3 % at the end of the table for the cameras of phones; a length wrong by 0.5 to 2 %; a
  readout of 5 to 15 ms for a phone (Liang, Chang, Chen 2008), and one to three dropped frames.
"""

from __future__ import annotations

from collections.abc import Set

import numpy as np

Effects = dict[str, dict[str, float]]

TABLE_STRENGTHS = {
    "sliding_friction.mu": (0.16, 0.24), "rolling_resistance.mu": (0.007, 0.013), "spin_decay.rate": (7.0, 13.0),
    "cushion_restitution.e": (0.75, 0.9), "ball_restitution.e": (0.92, 0.97),
}  # fmt: skip
"""Effects that act on every table."""
NATURAL_STRENGTHS = {
    "slope.slope_x": (1.0, 3.0), "slope.slope_y": (1.0, 3.0), "air_drag.k": (0.01, 0.04),
    "viscous_drag.k": (0.02, 0.06), "nap.mu": (0.001, 0.003), "cushion_restitution_speed.slope": (0.03, 0.08),
    "cushion_friction.mu": (0.12, 0.22), "ball_friction.mu": (0.03, 0.08), "unequal_mass.ratio": (0.03, 0.06),
    "unequal_radius.ratio": (0.01, 0.03), "lens_distortion.k1": (0.01, 0.03), "perspective.p_x": (0.005, 0.02),
    "perspective.p_y": (0.005, 0.02), "scale.seen": (0.005, 0.02), "rolling_shutter.readout": (0.005, 0.015),
    "dropped_frames.frames": (1.0, 3.0), "sticky_patch.mu": (0.005, 0.01), "curl.c": (0.1, 0.3),
    "ageing.mu": (0.0003, 0.0008),
}  # fmt: skip
"""Effects that may be missing.

A ratio is given as its difference from 1, ageing as the rolling resistance that every shot adds.
"""
OTHER_FORM_STRENGTHS = {"cushion_restitution_power.power": (0.15, 0.25), "lens_fourth.k2": (0.01, 0.03)}
"""Effects that no library holds, although one of its effects is similar."""
SIGNED_EFFECTS = (
    "slope", "nap", "unequal_mass", "unequal_radius", "lens_distortion", "perspective", "scale", "rolling_shutter",
)  # fmt: skip
"""Effects of either sign."""
CUSHION_HEIGHTS = ((1.13, 1.19), (1.35, 1.41))
"""Heights of a nose over the radius that differ from the usual 1.27: carom tables have 1.20, Mathavan 2010 took 1.4."""
PATCH_REGION = {"x": (0.6, 1.9), "y": (0.4, 0.9)}
"""Region of a sticky patch, m."""


def draw_strengths(rng: np.random.Generator, names: Set[str]) -> Effects:
    """Draw the strengths of effects on one table: those of every table and the named ones.

    All strengths are drawn, so that tables of one state of `rng` differ only in which effects act.
    """
    effects: Effects = {}
    for name, span in TABLE_STRENGTHS.items():
        effect, parameter = name.split(".")
        effects.setdefault(effect, {})[parameter] = float(rng.uniform(*span))
    for name, span in NATURAL_STRENGTHS.items():
        effect, parameter = name.split(".")
        value = float(rng.uniform(*span) * (rng.choice([-1, 1]) if effect in SIGNED_EFFECTS else 1))
        if effect in names:
            effects.setdefault(effect, {})[parameter] = value
    for name, span in OTHER_FORM_STRENGTHS.items():
        effect, parameter = name.split(".")
        if effect in names:
            effects[effect] = {parameter: float(rng.uniform(*span))}
    if "sticky_patch" in effects:
        effects["sticky_patch"] |= {axis: float(rng.uniform(*span)) for axis, span in PATCH_REGION.items()}
    if "cushion_height" in names:
        effects["cushion_height"] = {"ratio": float(rng.uniform(*CUSHION_HEIGHTS[rng.integers(2)]))}
    return effects
