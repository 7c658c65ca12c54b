"""Kinds of billiards cases: simulated tables with an effect that the user's simulator lacks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from models.estimation.gap_scenes.billiards_scene import DEFAULT_EFFECTS, BilliardsScene
from models.estimation.gap_scenes.gap_scene import GapScene
from models.physics.billiards.simulation.parametrised_shot import ContactModels
from pipeline.experiments.gapcheck.billiards_strengths import Effects, draw_strengths

PX_PER_M = 350.0
"""Resolution of the image, px/m."""
NOISE_M = 0.3 / PX_PER_M
"""Standard deviation of a coordinate, m."""
SECONDS = 2.0
"""Duration of a shot, s."""
FOREIGN_EFFECTS = frozenset({"sticky_patch", "curl", "ageing"})
"""Effects of the simulated world that have no counterpart in the library."""


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

    @property
    def name(self) -> str:
        """Name of the kind, with its scene."""
        words = self.case.replace("_", " ")
        return f"billiards, {'nothing missing' + words[4:] if not self.missing and words[:4] == 'none' else words}"

    @property
    def world(self) -> str:
        """The script in worlds/ that simulates it."""
        return "billiards_table"

    @property
    def engine(self) -> str:
        """Empty: the world needs no further package."""
        return ""

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
OPTIONAL_EFFECTS = SINGLE_EFFECTS[:13]
"""Effects that a table or a camera may lack entirely."""
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
