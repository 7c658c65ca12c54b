"""Layout of the vector of physical parameters that the simulation engine reads, and its neutral values.

The layout follows from the effects in `models.physics.effects`: their `slot` gives the order. Compiled code addresses
an entry by one of the index constants below, or by an index that `parameter_index` returned when a module was imported.
"""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray
from models.physics.effects.billiards_catalogue import BILLIARDS_EFFECTS

# Effects whose parameters the engine reads, in the order of its vector.
ENGINE_EFFECTS = tuple(
    sorted(
        (effect for effect in BILLIARDS_EFFECTS if effect.is_in_engine), key=lambda effect: (effect.slot, effect.name)
    )
)
# Effect and parameter, such as `slope.slope_x`, in the order of the vector and in the units of the effects.
PARAMETER_NAMES: tuple[str, ...] = tuple(name for effect in ENGINE_EFFECTS for name in effect.parameter_names)
# Those of them that a table may be given; generic laws are left to the diagnosis.
TABLE_PARAMETERS = tuple(name for effect in ENGINE_EFFECTS if effect.kind != "probe" for name in effect.parameter_names)


def parameter_index(name: str) -> int:
    """Find the place of a parameter in the vector.

    Args:
        name: Effect and parameter, such as `slope.slope_x`.

    Returns:
        The index in `PARAMETER_NAMES`.
    """
    return PARAMETER_NAMES.index(name)


# Coefficient of friction of a sliding ball on the cloth.
SLIDING_MU = parameter_index("sliding_friction.mu")
# Deceleration of a rolling ball over gravity.
ROLLING_MU = parameter_index("rolling_resistance.mu")
# rad/s^2, deceleration of side spin.
SPIN_DECAY = parameter_index("spin_decay.rate")
# mm/m, positive where the surface falls towards +x.
SLOPE_X = parameter_index("slope.slope_x")
# mm/m, positive where the surface falls towards +y.
SLOPE_Y = parameter_index("slope.slope_y")
# 1/m, deceleration over the square of the speed.
AIR_DRAG = parameter_index("air_drag.k")
# 1/s, deceleration over the speed.
VISCOUS_DRAG = parameter_index("viscous_drag.k")
# Part of rolling resistance that changes sign with the direction of travel along x.
NAP_MU = parameter_index("nap.mu")
# Restitution of cushions at 1 m/s (for power 0: at speed 0).
CUSHION_E = parameter_index("cushion_restitution.e")
# s/m, fall of that restitution with the normal speed.
CUSHION_E_SLOPE = parameter_index("cushion_restitution_speed.slope")
# Power of the normal speed (m/s) with which that restitution falls.
CUSHION_E_POWER = parameter_index("cushion_restitution_power.power")
# Coefficient of friction between ball and cushion nose.
CUSHION_MU = parameter_index("cushion_friction.mu")
# Height of the contact with a nose above the cloth, over the radius; 0 stands for the height of the cushion model.
CUSHION_HEIGHT = parameter_index("cushion_height.ratio")
# Friction of the cloth under a ball that a nose presses down, over that of the free cloth.
CUSHION_CLOTH_FACTOR = parameter_index("cushion_cloth.factor")
# Restitution of two balls.
BALL_E = parameter_index("ball_restitution.e")
# Coefficient of friction between two balls.
BALL_MU = parameter_index("ball_friction.mu")


def list_parameters(effect: str) -> tuple[int, ...]:
    """List the places of the parameters of an effect in the vector.

    Args:
        effect: Name of an effect that the engine reads.

    Returns:
        The indices, in the order of the effect.
    """
    return tuple(k for k, name in enumerate(PARAMETER_NAMES) if name.partition(".")[0] == effect)


# Generic law of the cloth, see `models.physics.effects.cloth.cloth_force`.
BRAKE_1, BRAKE_2, BRAKE_3, TURN_0, TURN_1, PULL_X, PULL_Y = list_parameters("cloth_force")
# Generic law of cushions.
REBOUND_PARAMETERS = list_parameters("cushion_rebound")
# Generic law of two balls.
IMPULSE_PARAMETERS = list_parameters("ball_impulse")

# (P,) True where a parameter acts on a ball alone on the cloth.
IS_CLOTH_PARAMETER = np.array([effect.site == "cloth" for effect in ENGINE_EFFECTS for _ in effect.parameters])
# Indices of the parameters under which a path has no closed form; neither has its derivative by them where they are 0.
PATH_BENDING_PARAMETERS = tuple(
    parameter_index(name) for effect in ENGINE_EFFECTS if effect.bends_path for name in effect.parameter_names
)


def neutral_parameters() -> FloatArray:
    """Return the vector (P,) without any effect: no friction, elastic contacts, a level table.

    Returns:
        (P,) a new array, in the order of `PARAMETER_NAMES`.
    """
    return np.array([value for effect in ENGINE_EFFECTS for value in effect.neutral])
