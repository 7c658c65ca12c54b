"""The kinds of case of billiards: tables of their own, of which the simulator lacks something."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from models.estimation.gap_scenes.billiards_scene import USUAL_MODEL, BilliardsScene
from models.estimation.gap_scenes.gap_scene import GapScene
from models.physics.billiards.simulation.parametrised_shot import Laws
from pipeline.experiments.gapcheck.billiards_strengths import Effects, strengths

PX_PER_M = 350.0
NOISE = 0.3 / PX_PER_M
"""m, one standard deviation."""
SECONDS = 2.0
NOT_HELD = frozenset({"sticky_patch", "curl", "ageing"})
"""What acts in the world and has nothing like it in the library."""


@dataclass(frozen=True, slots=True)
class BilliardsKind:
    """What the simulator lacks, and how the table is filmed."""

    case: str
    """from which, with a seed, all is drawn."""
    lacks: tuple[str, ...] = ()
    """effects that act and that the simulator has not."""
    has: tuple[str, ...] = ()
    """effects that act and that the simulator has beyond the usual ones."""
    cushion: str = "mirror"
    ball: str = "inelastic"
    """laws of the world; those of the simulator are `base` and `inelastic`."""
    base: str = "mirror"
    without: frozenset[str] = frozenset()
    """effects taken out of the library: `unknown` is right."""
    twins: frozenset[str] = frozenset()
    """names that are right too: other words for the same."""
    family: frozenset[str] = frozenset()
    """of the library, what comes nearest to a law of another form, and is right."""
    camera: Mapping[str, float] = field(default_factory=dict)
    """correlation, outliers, missing."""
    clock: float = 1.0
    """pictures a second that are said, over those that are taken."""
    along: bool = False
    """every shot in one direction and at one speed."""

    @property
    def name(self) -> str:
        words = self.case.replace("_", " ")
        return f"billiards, {'nothing missing' + words[4:] if not self.lacks and words[:4] == 'none' else words}"

    @property
    def world(self) -> str:
        return "billiards_table"

    @property
    def engine(self) -> str:
        return ""

    @property
    def withheld(self) -> frozenset[str]:
        """What the simulator lacks."""
        return frozenset(self.lacks)

    @property
    def foreign(self) -> bool:
        return bool(self.without or self.withheld & NOT_HELD)

    @property
    def trap(self) -> bool:
        return self.along or self.clock != 1.0

    @property
    def model(self) -> tuple[str, ...]:
        """What the simulator has."""
        return tuple(name for name in (*USUAL_MODEL, *self.has) if name not in self.lacks)

    @property
    def forms(self) -> tuple[str, ...]:
        return (self.cushion, self.ball) if self.withheld & {"cushion_law", "ball_law"} else ()

    def simulator(self, scene: GapScene) -> GapScene:
        if not isinstance(scene, BilliardsScene):
            raise TypeError(f"{self.name} is a kind of billiards; its track folder holds {scene.name}")
        held = tuple(one for one in scene.effects if one.name not in self.without)
        return replace(scene, effects=held, laws=Laws(self.base))

    def is_named_by(self, names: frozenset[str]) -> bool:
        """Whether these names, and no others, are a right answer."""
        if self.family:
            return names == self.family
        return names == self.withheld or (len(names) == 1 and names <= self.twins)

    def chance(self, seed: int) -> np.random.Generator:
        """What all of a case is drawn from, its effects first."""
        return np.random.default_rng([1877, seed, *self.case.encode()])

    def acting(self, rng: np.random.Generator) -> Effects:
        """What acts, of natural strength."""
        rubbing = {"cushion_friction"} if self.cushion != "mirror" else set()
        return strengths(rng, {*self.lacks, *self.has, *rubbing})

    def drawn(self, seed: int, shots: int, fps: float) -> dict[str, Any]:
        """An experiment of this kind, as its world reads it."""
        rng = self.chance(seed)
        return {
            "effects": self.acting(rng), "laws": {"cushion": self.cushion, "ball": self.ball},
            "model": list(self.model), "chance": rng.bit_generator.state, "shots": shots, "fps": fps,
            "said": fps * self.clock, "seconds": SECONDS, "noise": NOISE, "along": self.along, **self.camera,
        }  # fmt: skip


SINGLE = (
    "slope", "air_drag", "viscous_drag", "nap", "cushion_restitution_speed", "cushion_friction", "ball_friction",
    "unequal_mass", "unequal_radius", "lens_distortion", "perspective", "scale", "rolling_shutter", "dropped_frames",
    "rolling_resistance", "sliding_friction", "cushion_restitution", "ball_restitution",
)  # fmt: skip
FROM_NOTHING = SINGLE[:13]
"""effects that a table or a camera need not have at all."""
_CUSHION = ("cushion_friction",)
BILLIARDS = (
    BilliardsKind("none"),
    BilliardsKind("none, correlated noise", camera={"correlation": 0.6}),
    BilliardsKind("none, outliers and gaps", camera={"outliers": 0.01, "missing": 0.03}),
    *(BilliardsKind(name, (name,)) for name in SINGLE),
    BilliardsKind("spin_decay", ("spin_decay",), _CUSHION),
    BilliardsKind("cushion_law", ("cushion_law",), _CUSHION, cushion="mathavan_2010"),
    BilliardsKind("ball_law", ("ball_law",), ball="alciatore", twins=frozenset({"ball_friction"})),
    BilliardsKind("slope and cushion_friction", ("slope", "cushion_friction")),
    BilliardsKind("air_drag and lens_distortion", ("air_drag", "lens_distortion")),
    BilliardsKind("nap and ball_friction", ("nap", "ball_friction")),
    BilliardsKind("slope and lens_distortion", ("slope", "lens_distortion")),
    BilliardsKind("rolling_resistance and cushion_restitution", ("rolling_resistance", "cushion_restitution")),
    BilliardsKind("slope, not in the library", ("slope",), without=frozenset({"slope"})),
    BilliardsKind("cushion_friction, not in the library", _CUSHION, without=frozenset(_CUSHION)),
    BilliardsKind("sticky patch", ("sticky_patch",)),
    BilliardsKind("curl", ("curl",)),
    BilliardsKind("ageing cloth", ("ageing",)),
    BilliardsKind("slope, shots in one direction", ("slope",), along=True),
    BilliardsKind("wrong frame rate", clock=0.96),
    BilliardsKind(
        "restitution with a power of speed", ("cushion_restitution_power",),
        family=frozenset({"cushion_restitution_speed"}),
    ),
    BilliardsKind("lens of the fourth order", ("lens_fourth",), family=frozenset({"lens_distortion"})),
    BilliardsKind("cushion law, from another", ("cushion_law",), _CUSHION, cushion="mathavan_2010", base="han_2005"),
)  # fmt: skip
