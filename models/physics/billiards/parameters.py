"""Layout of the vector of physical parameters, the values of effects that are absent, and the laws of contact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray

GRAVITY = 9.81
"""m/s^2."""

NAMES: tuple[str, ...] = (
    "sliding_friction.mu",
    "rolling_resistance.mu",
    "spin_decay.rate",
    "slope.slope_x",
    "slope.slope_y",
    "air_drag.k",
    "viscous_drag.k",
    "cushion_restitution.e",
    "cushion_restitution_speed.slope",
    "cushion_friction.mu",
    "ball_restitution.e",
    "ball_friction.mu",
    "nap.mu",
    "cushion_cloth.factor",
    "cushion_restitution_power.power",
)
"""Effect and parameter, in the order of the vector, in the units of the effect."""

SLIDING_MU, ROLLING_MU, SPIN_DECAY, SLOPE_X, SLOPE_Y, AIR_DRAG, VISCOUS_DRAG = range(7)
CUSHION_E, CUSHION_E_SLOPE, CUSHION_MU, BALL_E, BALL_MU, NAP, PRESSED_CLOTH, CUSHION_E_POWER = range(7, 15)

CUSHION_LAWS = ("mirror", "han_2005", "mathavan_2010", "stronge")
BALL_LAWS = ("elastic", "inelastic", "alciatore", "mass_spring")
"""Their places are the codes by which compiled code knows them."""

_CUSHION = (
    "cushion_restitution.e", "cushion_restitution_speed.slope", "cushion_restitution_power.power",
    "cushion_friction.mu",
)  # fmt: skip
USES: dict[str, tuple[str, ...]] = {
    "mirror": _CUSHION,
    "han_2005": _CUSHION,
    "mathavan_2010": (*_CUSHION, "sliding_friction.mu", "cushion_cloth.factor"),
    "stronge": _CUSHION,
    "elastic": (),
    "inelastic": ("ball_restitution.e", "ball_friction.mu"),
    "alciatore": ("ball_restitution.e",),
    "mass_spring": ("ball_restitution.e", "ball_friction.mu"),
}
"""What each law of contact looks at; the same as its own `USES`."""
_CLOTH = tuple(name for name in NAMES if not name.startswith(("cushion", "ball")))


def neutral() -> FloatArray:
    """The vector (P,) of a world without effects: no friction, elastic, flat."""
    values = np.zeros(len(NAMES))
    values[[CUSHION_E, BALL_E, PRESSED_CLOTH]] = 1.0
    return values


@dataclass(frozen=True, slots=True)
class Physics:
    """Which effects act, how strongly, and by which laws balls and cushions touch."""

    values: FloatArray
    """(P,) in the order of `NAMES`; SI, but slope in mm/m."""
    present: tuple[str, ...]
    """Names among `NAMES` that were given; the rest is neutral."""
    cushion: str = "mirror"
    ball: str = "inelastic"

    def __post_init__(self) -> None:
        for law, laws in ((self.cushion, CUSHION_LAWS), (self.ball, BALL_LAWS)):
            if law not in laws:
                raise ValueError(f"a law is one of {', '.join(laws)}; got {law!r}")
        if self.values.shape != (len(NAMES),) or not np.isfinite(self.values).all():
            raise ValueError(f"{len(NAMES)} finite numbers are wanted, in the order of NAMES; got {self.values}")

    @property
    def codes(self) -> tuple[int, int]:
        """Of the cushion law and the ball law."""
        return CUSHION_LAWS.index(self.cushion), BALL_LAWS.index(self.ball)

    @classmethod
    def of(
        cls, effects: Mapping[str, Mapping[str, float]], cushion: str = "mirror", ball: str = "inelastic"
    ) -> Physics:
        """From `{"sliding_friction": {"mu": 0.2}, ...}`; an effect that is not listed is absent.

        ValueError for an unknown effect, parameter or law, a parameter that the law does not use, an impossible value.
        """
        values, present = neutral(), []
        for effect, strengths in effects.items():
            known = [name.split(".")[1] for name in NAMES if name.split(".")[0] == effect]
            if not known:
                raise ValueError(f"effects are {', '.join(sorted({n.split('.')[0] for n in NAMES}))}; got {effect!r}")
            for parameter, value in strengths.items():
                if parameter not in known:
                    raise ValueError(f"{effect} has {', '.join(known)}; it has no {parameter!r}")
                present.append(f"{effect}.{parameter}")
                values[NAMES.index(present[-1])] = value
        made = cls(values, tuple(present), cushion, ball)
        _refuse_unused(made)
        _refuse_impossible(made)
        return made


def _refuse_unused(physics: Physics) -> None:
    used = {*_CLOTH, *USES[physics.cushion], *USES[physics.ball]}
    for name in physics.present:
        if name not in used:
            laws, own = ("ball", BALL_LAWS) if name.startswith("ball") else ("cushion", CUSHION_LAWS)
            able = [law for law in own if name in USES[law]]
            law = physics.ball if laws == "ball" else physics.cushion
            raise ValueError(f"{name} is not used by the {laws} law {law}; leave it out, or take {' or '.join(able)}")


def _refuse_impossible(physics: Physics) -> None:
    bent = ("cushion_restitution_speed.slope", "cushion_restitution_power.power")
    signed = ("slope.slope_x", "slope.slope_y", "nap.mu", *bent)
    for name in physics.present:
        value = float(physics.values[NAMES.index(name)])
        if name not in signed and value < 0:
            raise ValueError(f"{name} is at least 0; got {value:g}")
        if name in ("cushion_restitution.e", "ball_restitution.e") and value > 1:
            raise ValueError(f"{name} is between 0 and 1; got {value:g}")
    nap, rolling = abs(float(physics.values[NAP])), float(physics.values[ROLLING_MU])
    if nap > rolling:
        raise ValueError(f"nap.mu may be as large as rolling_resistance.mu, or it would drive balls; got {nap:g}")
