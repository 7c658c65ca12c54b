"""Kinds of billiards cases: simulated tables with an effect that the user's simulator lacks.

Natural strengths of effects on billiards tables, and their spread between tables.

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

from collections.abc import Mapping, Set
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from models.estimation.gap_scenes.billiards_scene import DEFAULT_EFFECTS, BilliardsScene
from models.estimation.gap_scenes.gap_scene import GapScene
from models.physics.billiards.simulation.parametrised_shot import ContactModels
from pipeline.experiments.gapcheck.body_cases import BODY_KINDS, DRIVEN_KINDS, MUJOCO_KINDS, WALL_KINDS, BodyKind

Effects = dict[str, dict[str, float]]

# Effects that act on every table.
TABLE_STRENGTHS = {
    "sliding_friction.mu": (0.16, 0.24), "rolling_resistance.mu": (0.007, 0.013), "spin_decay.rate": (7.0, 13.0),
    "cushion_restitution.e": (0.75, 0.9), "ball_restitution.e": (0.92, 0.97),
}  # fmt: skip
# Effects that may be missing.
#
# A ratio is given as its difference from 1, ageing as the rolling resistance that every shot adds.
NATURAL_STRENGTHS = {
    "slope.slope_x": (1.0, 3.0), "slope.slope_y": (1.0, 3.0), "air_drag.k": (0.01, 0.04),
    "viscous_drag.k": (0.02, 0.06), "nap.mu": (0.001, 0.003), "cushion_restitution_speed.slope": (0.03, 0.08),
    "cushion_friction.mu": (0.12, 0.22), "ball_friction.mu": (0.03, 0.08), "unequal_mass.ratio": (0.03, 0.06),
    "unequal_radius.ratio": (0.01, 0.03), "lens_distortion.k1": (0.01, 0.03), "perspective.p_x": (0.005, 0.02),
    "perspective.p_y": (0.005, 0.02), "scale.seen": (0.005, 0.02), "rolling_shutter.readout": (0.005, 0.015),
    "dropped_frames.frames": (1.0, 3.0), "sticky_patch.mu": (0.005, 0.01), "curl.c": (0.1, 0.3),
    "ageing.mu": (0.0003, 0.0008),
}  # fmt: skip
# Effects that no library holds, although one of its effects is similar.
OTHER_FORM_STRENGTHS = {"cushion_restitution_power.power": (0.15, 0.25), "lens_fourth.k2": (0.01, 0.03)}
# Effects of either sign.
SIGNED_EFFECTS = (
    "slope", "nap", "unequal_mass", "unequal_radius", "lens_distortion", "perspective", "scale", "rolling_shutter",
)  # fmt: skip
# Heights of a nose over the radius that differ from the usual 1.27: carom tables have 1.20, Mathavan 2010 took 1.4.
CUSHION_HEIGHTS = ((1.13, 1.19), (1.35, 1.41))
# Region of a sticky patch, m.
PATCH_REGION = {"x": (0.6, 1.9), "y": (0.4, 0.9)}


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


# Resolution of the image, px/m.
PX_PER_M = 350.0
# Standard deviation of a coordinate, m.
NOISE_M = 0.3 / PX_PER_M
# Duration of a shot, s.
SECONDS = 2.0
# Effects of the simulated world that have no counterpart in the library.
FOREIGN_EFFECTS = frozenset({"sticky_patch", "curl", "ageing"})


@dataclass(frozen=True, slots=True)
class BilliardsKind:
    """A kind of case: the effects that the simulator lacks, and how the table is filmed."""

    case: str
    """Name; with a seed, it determines all random values."""
    missing: tuple[str, ...] = ()
    """Effects that act and that the simulator lacks."""
    extra_effects: tuple[str, ...] = ()
    """Effects that act and that the simulator has beyond the default ones."""
    cushion: str = "mirror"
    ball: str = "inelastic"
    """Contact models of the world; those of the simulator are `simulator_cushion` and `inelastic`."""
    simulator_cushion: str = "mirror"
    """Contact model of cushions in the simulator."""
    removed: frozenset[str] = frozenset()
    """Effects removed from the library: `unknown` is right."""
    synonyms: frozenset[str] = frozenset()
    """Further right names: other words for the same effect."""
    family: frozenset[str] = frozenset()
    """Effects of the library that are nearest to a law of another form, and right."""
    camera: Mapping[str, float] = field(default_factory=dict)
    """correlation, outliers, missing."""
    clock_ratio: float = 1.0
    """Stated over true frame rate."""
    one_direction: bool = False
    """Whether every shot has the same direction and speed."""
    world: str = "billiards_table"
    """The script in worlds/ that simulates it."""
    engine: str = ""
    """Empty: the world needs no further package."""

    @property
    def name(self) -> str:
        """Name of the kind, with its scene."""
        words = self.case.replace("_", " ")
        return f"billiards, {'nothing missing' + words[4:] if not self.missing and words[:4] == 'none' else words}"

    @property
    def withheld(self) -> frozenset[str]:
        """Effects that the simulator lacks."""
        return frozenset(self.missing)

    @property
    def foreign(self) -> bool:
        """Whether the missing effect is in no library."""
        return bool(self.removed or self.withheld & FOREIGN_EFFECTS)

    @property
    def trap(self) -> bool:
        """Whether the shots cannot show the missing effect."""
        return self.one_direction or self.clock_ratio != 1.0

    @property
    def model(self) -> tuple[str, ...]:
        """Effects that the simulator has."""
        return tuple(name for name in (*DEFAULT_EFFECTS, *self.extra_effects) if name not in self.missing)

    @property
    def forms(self) -> tuple[str, ...]:
        """Contact models of the world; empty where the simulator has them."""
        return (self.cushion, self.ball) if self.withheld & {"cushion_law", "ball_law"} else ()

    def simulator(self, scene: GapScene) -> GapScene:
        """Return the scene with the simulator's contact model and without the removed effects."""
        if not isinstance(scene, BilliardsScene):
            raise TypeError(f"{self.name} is a kind of billiards; its track folder holds {scene.name}")
        library = tuple(one for one in scene.effects if one.name not in self.removed)
        return replace(scene, effects=library, laws=ContactModels(self.simulator_cushion))

    def is_named_by(self, names: frozenset[str]) -> bool:
        """Return whether these names, and no others, are a right answer."""
        if self.family:
            return names == self.family
        return names == self.withheld or (len(names) == 1 and names <= self.synonyms)

    def make_generator(self, seed: int) -> np.random.Generator:
        """Make the random generator of a case."""
        return np.random.default_rng([1877, seed, *self.case.encode()])

    def draw_effects(self, rng: np.random.Generator) -> Effects:
        """Draw the strengths of the effects that act."""
        rubbing = {"cushion_friction"} if self.cushion != "mirror" else set()
        return draw_strengths(rng, {*self.missing, *self.extra_effects, *rubbing})

    def draw_experiment(self, seed: int, shots: int, fps: float) -> dict[str, Any]:
        """Draw an experiment of this kind in the format of its world."""
        rng = self.make_generator(seed)
        return {
            "effects": self.draw_effects(rng), "laws": {"cushion": self.cushion, "ball": self.ball},
            "model": list(self.model), "chance": rng.bit_generator.state, "shots": shots, "fps": fps,
            "said": fps * self.clock_ratio, "seconds": SECONDS, "noise": NOISE_M, "along": self.one_direction,
            **self.camera,
        }  # fmt: skip


SINGLE_EFFECTS = (
    "slope", "air_drag", "viscous_drag", "nap", "cushion_restitution_speed", "cushion_friction", "ball_friction",
    "unequal_mass", "unequal_radius", "lens_distortion", "perspective", "scale", "rolling_shutter", "dropped_frames",
    "rolling_resistance", "sliding_friction", "cushion_restitution", "ball_restitution",
)  # fmt: skip
_CUSHION = ("cushion_friction",)
BILLIARDS_KINDS = (
    BilliardsKind("none"),
    BilliardsKind("none, correlated noise", camera={"correlation": 0.6}),
    BilliardsKind("none, outliers and gaps", camera={"outliers": 0.01, "missing": 0.03}),
    *(BilliardsKind(name, (name,)) for name in SINGLE_EFFECTS),
    BilliardsKind("spin_decay", ("spin_decay",), _CUSHION),
    BilliardsKind("cushion_law", ("cushion_law",), _CUSHION, cushion="mathavan_2010"),
    BilliardsKind("ball_law", ("ball_law",), ball="alciatore", synonyms=frozenset({"ball_friction"})),
    BilliardsKind("slope and cushion_friction", ("slope", "cushion_friction")),
    BilliardsKind("air_drag and lens_distortion", ("air_drag", "lens_distortion")),
    BilliardsKind("nap and ball_friction", ("nap", "ball_friction")),
    BilliardsKind("slope and lens_distortion", ("slope", "lens_distortion")),
    BilliardsKind("rolling_resistance and cushion_restitution", ("rolling_resistance", "cushion_restitution")),
    BilliardsKind("slope, not in the library", ("slope",), removed=frozenset({"slope"})),
    BilliardsKind("cushion_friction, not in the library", _CUSHION, removed=frozenset(_CUSHION)),
    BilliardsKind("sticky patch", ("sticky_patch",)),
    BilliardsKind("curl", ("curl",)),
    BilliardsKind("ageing cloth", ("ageing",)),
    BilliardsKind("slope, shots in one direction", ("slope",), one_direction=True),
    BilliardsKind("wrong frame rate", clock_ratio=0.96),
    BilliardsKind(
        "restitution with a power of speed", ("cushion_restitution_power",),
        family=frozenset({"cushion_restitution_speed"}),
    ),
    BilliardsKind("lens of the fourth order", ("lens_fourth",), family=frozenset({"lens_distortion"})),
    BilliardsKind(
        "cushion law, from another", ("cushion_law",), _CUSHION, cushion="mathavan_2010", simulator_cushion="han_2005",
    ),
    BilliardsKind(
        "none, a nose above the centre", extra_effects=_CUSHION, cushion="han_2005", simulator_cushion="han_2005"
    ),
    BilliardsKind(
        "cushion_height", ("cushion_height",), _CUSHION, cushion="han_2005", simulator_cushion="han_2005"
    ),
)  # fmt: skip


# A simulated world, the effects that act there, and those that the user's simulator has.
CaseKind = BodyKind | BilliardsKind
KINDS: tuple[CaseKind, ...] = (*BODY_KINDS, *MUJOCO_KINDS, *WALL_KINDS, *DRIVEN_KINDS, *BILLIARDS_KINDS)

_RARE_KINDS = (*WALL_KINDS, *DRIVEN_KINDS, *BILLIARDS_KINDS)
_DEFAULT_TABLES = ("nothing missing", "slope", "cushion law", "slope and lens distortion", "sticky patch")
# Kinds that are checked by default: no walls and no inputs, and one table for each kind of question, as a table takes a
# minute.
DEFAULT_KINDS: tuple[CaseKind, ...] = tuple(
    kind for kind in KINDS if kind not in _RARE_KINDS or kind.name in [f"billiards, {one}" for one in _DEFAULT_TABLES]
)
