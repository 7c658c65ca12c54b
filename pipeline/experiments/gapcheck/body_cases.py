"""Kinds of cases with sliding, flying and swinging bodies.

Strengths are natural ones, drawn uniformly from a range: mu of plastic, wood and metal on smooth floors 0.1 to 0.4;
drag of balls and shuttlecocks in air by g / (terminal speed)^2, 0.22 1/m for a shuttlecock, 0.02 for a tennis ball;
bearings of swinging rods as in recorded pendulums, 0.02 to 0.2 1/s; floors and walls that are off by 2 to 10 mm/m; a
draught of 1 to 4 m/s; lift by spin of sliced balls; pucks on smooth floors with mu 0.02 to 0.1, between walls that
return 0.5 to 0.9 of the normal speed, with mu 0.05 to 0.3. Noise is 0.3 px of a camera that shows the whole scene.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from models.estimation.gap_scenes.gap_scene import GapScene

Ranges = Mapping[str, Mapping[str, tuple[float, float]]]

# Standard deviation of a coordinate, m or rad.
NOISE = {"slide": 0.9e-3, "flight": 3e-3, "pendulum": 2e-3}
# Duration of a shot, s.
SECONDS = {"slide": 1.5, "flight": 1.3, "pendulum": 2.5}
# Parameters of either sign.
SIGNED_PARAMETERS = ("slope_x", "slope_y", "wind_x", "s", "angle", "c")


@dataclass(frozen=True, slots=True)
class BodyKind:
    """A simulated body, the effects that act on it, and those that the simulator has."""

    name: str
    scene: str
    acts: Ranges
    """Effects that act, with the range of each parameter."""
    model: tuple[str, ...] = ()
    """Those of them that the simulator has."""
    foreign: bool = False
    """Whether the missing effect is in no library: the right answer is `unknown`."""
    camera: Mapping[str, float] = field(default_factory=dict)
    """correlation, outliers, missing, tails, resolution, smoothing."""
    throw: Mapping[str, float] = field(default_factory=dict)
    """speed, angle: equal in all shots."""
    engine: str = ""
    """The package that simulates it; empty for integrators of this project."""
    facts: Mapping[str, object] = field(default_factory=dict)
    """Further entries of scene.json, such as walls."""
    drive: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Known inputs by column: amplitude and frequency (Hz)."""
    stated: bool = True
    """Whether the known inputs are stated."""
    family: frozenset[str] = frozenset()
    """Effects of the library, any of which alone is a right name for an effect of another form."""
    forms: tuple[str, ...] = ()
    """Empty: bodies have no choice of contact models."""

    @property
    def withheld(self) -> frozenset[str]:
        """Effects that the simulator lacks."""
        return frozenset(self.acts) - set(self.model)

    @property
    def world(self) -> str:
        """The script in worlds/ that simulates it."""
        return f"{self.scene}_{self.engine}" if self.engine else self.scene

    @property
    def trap(self) -> bool:
        """Whether all shots have the same throw."""
        return bool(self.throw)

    def simulator(self, scene: GapScene) -> GapScene:
        """Return the scene unchanged: track folders of bodies state it completely."""
        return scene

    def is_named_by(self, names: frozenset[str]) -> bool:
        """Return whether these names, and no others, are a right answer."""
        return names <= self.family if self.family else names == self.withheld

    def draw_experiment(self, seed: int, shots: int, fps: float) -> dict[str, Any]:
        """Draw an experiment of this kind in the format of its world."""
        rng = np.random.default_rng([seed, *self.name.encode()])
        effects = {
            name: {p: _draw_value(rng, p, span) for p, span in ranges.items()} for name, ranges in self.acts.items()
        }
        return {
            "effects": effects, "model": list(self.model), "seed": int(rng.integers(2**31)), "shots": shots, "fps": fps,
            "seconds": SECONDS[self.scene], "noise": NOISE[self.scene], "throw": dict(self.throw), **self.camera,
            "facts": dict(self.facts), "drive": dict(self.drive), "stated": self.stated,
        }  # fmt: skip


def _draw_value(rng: np.random.Generator, name: str, span: tuple[float, float]) -> float:
    """Draw a parameter from its range."""
    sign = rng.choice([-1.0, 1.0]) if name in SIGNED_PARAMETERS else 1.0
    return float(sign * rng.uniform(*span))


FRICTION = {"sliding_friction": {"mu": (0.1, 0.4)}}
SLOPE = {"slope": {"slope_x": (2.0, 10.0), "slope_y": (2.0, 10.0)}}
DRAG = {"air_drag": {"k": (0.02, 0.2)}}
SPIN = {"magnus": {"s": (0.2, 1.0)}}
JOINT = {"joint_friction": {"viscous": (0.02, 0.2), "dry": (0.05, 0.4)}}
CROOKED = {"gravity_tilt": {"angle": (0.01, 0.05)}}
DRAGS = frozenset({"air_drag", "viscous_drag"})
ROUGH = {"correlation": 0.5}
SLOPPY = {"outliers": 0.01, "missing": 0.03}
HEAVY, COARSE, SMOOTH = {"tails": 3.0}, {"resolution": 3.0}, {"smoothing": 9}

CAMERAS: Mapping[str, Mapping[str, float]] = {
    "": {}, ", correlated noise": ROUGH, ", outliers and gaps": SLOPPY, ", heavy tails": HEAVY, ", quantised": COARSE,
    ", filtered": SMOOTH,
}  # fmt: skip


def _build_clean_kinds(scene: str, acts: Ranges) -> tuple[BodyKind, ...]:
    """Build the kinds in which the simulator has all effects, one for each camera."""
    kinds = ((f"{scene}, nothing missing{words}", camera) for words, camera in CAMERAS.items())
    return tuple(BodyKind(name, scene, acts, tuple(acts), camera=camera) for name, camera in kinds)


# Kinds with the cameras and effects of everyday recordings.
BODY_KINDS = (
    *_build_clean_kinds("slide", FRICTION),
    BodyKind("slide, friction", "slide", FRICTION),
    BodyKind("slide, viscous drag", "slide", {"viscous_drag": {"k": (0.2, 1.0)}}),
    BodyKind("slide, air drag", "slide", {**FRICTION, "air_drag": {"k": (0.3, 1.0)}}, ("sliding_friction",)),
    BodyKind("slide, slope", "slide", {**FRICTION, **SLOPE}, ("sliding_friction",)),
    BodyKind("slide, friction and slope", "slide", {**FRICTION, **SLOPE}),
    BodyKind(
        "slide, sticky patch", "slide",
        {**FRICTION, "sticky_patch": {"mu": (0.2, 0.5), "x": (-0.2, 0.2), "y": (-0.2, 0.2)}},
        ("sliding_friction",), foreign=True,
    ),
    BodyKind("slide, curl", "slide", {**FRICTION, "curl": {"c": (0.1, 0.4)}}, ("sliding_friction",), foreign=True),
    BodyKind("slide, friction and air drag", "slide", {**FRICTION, "air_drag": {"k": (0.3, 1.0)}}),
    BodyKind("slide, drag with speed^1.5", "slide", {**FRICTION, "drag_power": {"k": (0.3, 1.0), "power": (1.5, 1.5)}},
         ("sliding_friction",), family=DRAGS),
    *_build_clean_kinds("flight", DRAG),
    BodyKind("flight, air drag", "flight", DRAG),
    BodyKind("flight, viscous drag", "flight", {"viscous_drag": {"k": (0.1, 0.6)}}),
    BodyKind("flight, wind", "flight", {**DRAG, "wind": {"wind_x": (1.0, 4.0)}}, ("air_drag",)),
    BodyKind("flight, lift by spin", "flight", {**DRAG, **SPIN}, ("air_drag",)),
    BodyKind("flight, air drag and lift by spin", "flight", {**DRAG, **SPIN}),
    BodyKind("flight, air drag and wind", "flight", {**DRAG, "wind": {"wind_x": (1.0, 4.0)}}),
    BodyKind("flight, drag with speed^1.5", "flight", {"drag_power": {"k": (0.03, 0.3), "power": (1.5, 1.5)}},
         family=DRAGS),
    BodyKind("flight, gusts", "flight", {**DRAG, "gust": {"speed": (4.0, 8.0), "period": (0.4, 0.8)}}, ("air_drag",),
         foreign=True),
    *_build_clean_kinds("pendulum", JOINT),
    BodyKind("pendulum, joint friction", "pendulum", JOINT),
    BodyKind("pendulum, air drag", "pendulum", {"air_drag": {"k": (0.02, 0.1)}}),
    BodyKind("pendulum, crooked camera", "pendulum", {**JOINT, **CROOKED}, ("joint_friction",)),
    BodyKind("pendulum, joint friction and crooked camera", "pendulum", {**JOINT, **CROOKED}),
    BodyKind("pendulum, drag with speed^1.5", "pendulum", {"drag_power": {"k": (0.03, 0.15), "power": (1.5, 1.5)}},
         family=frozenset({"joint_friction", "air_drag"})),
    BodyKind("pendulum, spiral spring", "pendulum", {**JOINT, "spiral_spring": {"k": (2.0, 10.0)}}, ("joint_friction",),
         foreign=True),
    BodyKind("pendulum, magnet", "pendulum", {**JOINT, "magnet": {"m": (1.0, 4.0)}}, ("joint_friction",), foreign=True),
)  # fmt: skip

# The same pendulum, simulated by an independent engine.
MUJOCO_KINDS = (
    BodyKind("pendulum by MuJoCo, nothing missing", "pendulum", JOINT, ("joint_friction",), engine="mujoco"),
    BodyKind("pendulum by MuJoCo, joint friction", "pendulum", JOINT, engine="mujoco"),
    BodyKind(
        "pendulum by MuJoCo, crooked camera", "pendulum", {**JOINT, **CROOKED}, ("joint_friction",), engine="mujoco"
    ),
)

GLIDE = {"sliding_friction": {"mu": (0.02, 0.1)}}
BOUNCE = {"wall_restitution": {"e": (0.5, 0.9)}}
RUB = {"wall_friction": {"mu": (0.05, 0.3)}}
BOX = {"walls": [-0.5, -0.35, 0.5, 0.35], "radius": 0.03}
# Kinds between walls.
WALL_KINDS = tuple(
    BodyKind(f"slide between walls, {name}", "slide", acts, tuple(model),
             foreign=name in ("sticky patch", "fading walls"), facts=BOX)
    for name, acts, model in (
        ("nothing missing", {**GLIDE, **BOUNCE, **RUB}, [*GLIDE, *BOUNCE, *RUB]),
        ("elastic walls, nothing missing", GLIDE, GLIDE),
        ("wall restitution", {**GLIDE, **BOUNCE}, GLIDE),
        ("wall friction", {**GLIDE, **BOUNCE, **RUB}, [*GLIDE, *BOUNCE]),
        ("wall restitution and wall friction", {**GLIDE, **BOUNCE, **RUB}, GLIDE),
        ("friction", {**GLIDE, **BOUNCE, **RUB}, [*BOUNCE, *RUB]),
        ("viscous drag", {**BOUNCE, **RUB, "viscous_drag": {"k": (0.2, 1.0)}}, [*BOUNCE, *RUB]),
        ("slope", {**GLIDE, **SLOPE, **BOUNCE}, [*GLIDE, *BOUNCE]),
        ("sticky patch", {**GLIDE, **BOUNCE, "sticky_patch": {"mu": (0.2, 0.5), "x": (-0.2, 0.2), "y": (-0.2, 0.2)}},
         [*GLIDE, *BOUNCE]),
        ("fading walls", {**GLIDE, "fading_restitution": {"e0": (0.9, 0.95), "slope": (0.2, 0.35)}},
         [*GLIDE, "wall_restitution"]),
    )
)  # fmt: skip

PIVOT = {"pivot_x": {"amplitude": 0.02, "frequency": 1.5}}
MOTOR = {"torque": {"amplitude": 5.0, "frequency": 0.8}}
PLATFORM = {"platform_x": {"amplitude": 0.02, "frequency": 2.0}, "platform_y": {"amplitude": 0.01, "frequency": 3.0}}
FAN = {"force_x": {"amplitude": 2.0, "frequency": 1.5}}
AXIS = {f"axis_{name}": {"amplitude": 1.0, "frequency": 0.0} for name in "xyz"}
# Kinds with known inputs.
DRIVEN_KINDS = (
    BodyKind("pendulum with a moving pivot, nothing missing", "pendulum", JOINT, ("joint_friction",), drive=PIVOT),
    BodyKind("pendulum with a moving pivot, joint friction", "pendulum", JOINT, drive=PIVOT),
    BodyKind("pendulum with a motor, joint friction", "pendulum", JOINT, drive=MOTOR),
    BodyKind("pendulum with a moving pivot that is not stated", "pendulum", JOINT, ("joint_friction",), foreign=True,
             drive=PIVOT, stated=False),
    BodyKind("pendulum with a motor that is not stated", "pendulum", JOINT, ("joint_friction",), foreign=True,
             drive=MOTOR, stated=False),
    BodyKind("slide on a moving platform, nothing missing", "slide", FRICTION, ("sliding_friction",), drive=PLATFORM),
    BodyKind("slide on a moving platform, friction", "slide", FRICTION, drive=PLATFORM),
    BodyKind("slide with a force, friction", "slide", FRICTION, drive=FAN),
    BodyKind("slide on a moving platform that is not stated", "slide", FRICTION, ("sliding_friction",), foreign=True,
             drive=PLATFORM, stated=False),
    BodyKind("flight about a stated axis, lift by spin", "flight", {**DRAG, **SPIN}, ("air_drag",), drive=AXIS),
    BodyKind("flight about an axis that is not stated", "flight", {**DRAG, **SPIN}, ("air_drag",), foreign=True,
             drive=AXIS, stated=False),
)  # fmt: skip
