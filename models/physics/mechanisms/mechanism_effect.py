"""Effects of any mechanism, and their parameters for the joints and actuators of one.

An effect needs little of a simulator: a force on the joints, another input, or another observation. Strengths are in
SI units of the simulator. The usual size of a force follows from the motion itself: it changes the acceleration of a
joint by a tenth of what it typically is. Delays, gains, gravity and payload have usual sizes of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, final

from models.core.typing import FloatArray
from models.physics.effect import Effect, EffectKind, Prior

# What an effect has one set of parameters for: each joint or free body, each joint of one coordinate, each input, each
# observed joint, each observed joint or free body, or the whole mechanism.
MechanismSite = Literal["joint", "line", "actuator", "sensor", "sensor_body", "mechanism"]
# Places and velocities (N,) of the joints, and one array (N,) per parameter, to a value (N,) for each joint.
JointLaw = Callable[[FloatArray, FloatArray, tuple[FloatArray, ...]], FloatArray]
# Share of the typical acceleration of a joint that an effect of usual strength changes.
USUAL_SHARE = 0.1
PHASES = ("motion", "reversal")


@dataclass(frozen=True, slots=True)
class Scale:
    """Typical sizes of the motion of a joint, or of an input (its position and its largest value)."""

    unit: str
    """rad or m; of an input, that of its values."""
    position: float = 1.0
    """Standard deviation."""
    speed: float = 1.0
    """Root mean square, per s; of an input, that of its joint."""
    largest: float = 1.0
    """Largest size of a value, of an input."""
    inertia: float = 1.0
    """kg m2 or kg; 1 where a simulator takes accelerations instead of forces."""
    has_forces: bool = False
    """Whether a simulator takes forces (N or N m) rather than accelerations."""
    joint_unit: str = ""
    """rad or m, of the joint that an input acts on; its speed is `speed`."""
    middle: float = 0.0
    """Middle of the recorded range, rad or m."""
    reach: float = 1.0
    """Half of that range."""
    drive: float = 0.0
    """Typical force of the actuators on the joint: where a strong one moves a light joint, friction may be as large."""

    @property
    def force(self) -> float:
        """Typical force or torque: that of the typical acceleration, or of the actuators where it is larger."""
        return max(self.inertia * self.speed**2 / self.position, self.drive)

    @property
    def force_unit(self) -> str:
        """Unit of a force on the joint."""
        if not self.has_forces:
            return f"{self.unit}/s2"
        return "N m" if self.unit == "rad" else "N"


@dataclass(frozen=True, slots=True)
class MechanismStrength:
    """A parameter of an effect for one joint or actuator."""

    name: str
    unit: Callable[[Scale], str]
    usual: Callable[[Scale], float]
    """Strength of a large effect, such as one that changes the typical acceleration by all of it; the usual strength is
    `USUAL_SHARE` of it."""
    neutral: Callable[[Scale], float] = field(default=lambda scale: 0.0)
    lower: float = 0.0
    """Lower bound in multiples of `usual`."""
    upper: float = 30.0
    """Upper bound in multiples of `usual`."""
    needs_simulator: bool = False
    """Whether only a simulator that has the effect itself has this parameter."""

    def build_prior(self, scale: Scale, suffix: str) -> Prior:
        """Build the prior for a joint or actuator."""
        usual, neutral = self.usual(scale), self.neutral(scale)
        bounds = (neutral + self.lower * usual, neutral + self.upper * usual)
        return Prior(self.name + suffix, self.unit(scale), neutral, USUAL_SHARE * usual, relative=False, bounds=bounds)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class MechanismEffect:
    """An effect of mechanisms; every file in `models.physics.mechanisms.laws` defines one as `EFFECT`."""

    name: str
    site: MechanismSite
    strengths: tuple[MechanismStrength, ...]
    reference: str
    partners: tuple[str, ...] = ()
    kind: EffectKind = "physics"
    brake: JointLaw | None = None
    """Force against the motion over the velocity."""
    dry: JointLaw | None = None
    """Size of a force against the motion that does not vanish with the speed; it holds a joint that it stops."""
    force: JointLaw | None = None
    """Force on each joint; a generic law (a probe) takes (position - `middle`) / `reach` and speed / typical speed."""
    needs_simulator: bool = False
    """Whether only a simulator that has the quantity itself can apply it."""
    needs_small_inputs: bool = False
    """Whether an input that is never near 0 does not tell it from an offset of the input."""

    def list_strengths(self, is_own: bool) -> tuple[MechanismStrength, ...]:
        """List the parameters, also those that only a simulator has that has the effect itself (`is_own`)."""
        return tuple(one for one in self.strengths if is_own or not one.needs_simulator)

    def split_parameter(self, name: str) -> tuple[str, str]:
        """Split the name of a parameter into strength and joint; the joint is empty where there is only one."""
        strength = next(one.name for one in self.strengths if f"{name}_".startswith(f"{one.name}_"))
        return strength, name.removeprefix(strength).removeprefix("_")

    def for_mechanism(self, scales: Mapping[str, Scale], is_own: bool = False) -> Effect:
        """Return the effect with parameters for every joint or actuator.

        Args:
            scales: Typical sizes by name; an effect of the whole mechanism takes the first one.
            is_own: Whether the simulator has the effect itself.

        Returns:
            The effect; parameters are named `strength_joint` where there are several joints.
        """
        own = dict(list(scales.items())[:1]) if self.site == "mechanism" else scales
        priors = tuple(
            one.build_prior(scale, f"_{name}" if len(own) > 1 else "")
            for one in self.list_strengths(is_own)
            for name, scale in own.items()
        )
        return Effect(
            self.name, priors, tuple(one.value for one in priors), PHASES, self.reference, self.partners, self.kind
        )


def in_force(scale: Scale) -> str:
    """Return the unit of a force on a joint."""
    return scale.force_unit


def per(power: int, quantity: Literal["speed", "position"]) -> tuple[Callable[[Scale], str], Callable[[Scale], float]]:
    """Return unit and usual size of a force per power of a speed or a position."""

    def unit(scale: Scale) -> str:
        one = scale.unit if quantity == "position" else f"({scale.unit}/s)"
        return f"{scale.force_unit}/{one}{power if power > 1 else ''}"

    return unit, lambda scale: float(scale.force / getattr(scale, quantity) ** power)
