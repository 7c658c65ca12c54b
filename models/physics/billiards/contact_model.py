"""Published models of a contact, the steps that they share, and one compiled function that contains all of them.

A model is one file in `ball_cushion` or `ball_ball` that defines `MODEL`, a `ContactModel`. The registry
(`contact_models`) finds the file and derives everything else from it: names, checks of parameters,
compiled dispatch and derivatives, and the models that a diagnosis compares.

Every ball model is a compiled function
`collide(van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p)` that returns the first ten of its
arguments after the contact:

    van, vat, vbn, vbt               velocities of balls a and b along n, from the centre of a to that of b, and along
                                     t = z x n, m/s
    wan, wat, waz, wbn, wbt, wbz     spins about the axes n, t, z, rad/s; z points up
    ra, rb                           radii, m
    ma, mb                           masses, kg
    p                                (P,) physical parameters in the order of `parameters.PARAMETER_NAMES`

All arguments are float64, or all are complex128 where a derivative is carried. The balls touch at the height of their
centres. Impulses are in kg m/s.

Every cushion model is a compiled function `rebound(vn, vt, wn, wt, wz, radius, mass, p)` that returns
(vn, vt, wn, wt, wz) after the contact:

    vn, vt       velocity of the centre along n, the unit normal into the cushion, and along t = z x n, m/s; vn > 0
                 before the contact
    wn, wt, wz   spin about the axes n, t, z, rad/s; z points up
    radius       of the ball, m
    mass         of the ball, kg
    p            (P,) physical parameters in the order of `parameters.PARAMETER_NAMES`

All arguments are float64, or all are complex128 where a derivative is carried.

The nose touches the ball h R above the cloth, where h is `cushion_height.ratio` or, where that is 0, the height of the
model: 1.27 in the published ones. So the unit normal of the contact N leans up by theta out of n, sin(theta) = h - 1:
N = cos(theta) n + sin(theta) z, and the contact plane is spanned by t and k = -sin(theta) n + cos(theta) z. Impulses
are per mass of the ball, m/s.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, final

import numpy as np

from models.core.typing import BoolArray
from models.numerics.jit import compile_kernel
from models.physics.billiards import parameter_vector
from models.physics.billiards.parameter_vector import PARAMETER_NAMES

# Energy after a contact over that before it that rounding explains.
MAX_ENERGY_RATIO = 1.0 + 1e-9
# Branches of a compiled choice between models.
MOST_MODELS = 8
# Rank of a model behind all that have a number.
LAST = sys.maxsize


@final
@dataclass(frozen=True, slots=True)
class ContactModel:
    """A published model of a ball that meets a cushion, or of two balls that meet."""

    name: str
    """Named after the paper, as users write it."""
    parameters: tuple[str, ...]
    """Names among `PARAMETER_NAMES` that the model reads."""
    summary: str
    """One sentence for help and documentation."""
    reference: str
    """Author, year, title and DOI."""
    resolve: Callable[..., Any]
    """Compiled; the signature is that of the folder, see above."""
    is_candidate: bool = True
    """Whether a diagnosis tries the model where a simulator has another one."""
    standard_values: tuple[tuple[str, float], ...] = ()
    """Parameters among `parameters` whose value is that of the model where none is given, and those values."""
    rank: int = LAST
    """Position among the models of the folder; models of equal rank are sorted by name."""

    def __post_init__(self) -> None:
        if unknown := set(self.parameters) - set(PARAMETER_NAMES):
            raise ValueError(
                f"contact model {self.name} reads {', '.join(sorted(unknown))}; "
                f"the parameters are {', '.join(PARAMETER_NAMES)}"
            )


@compile_kernel
def sphere_energy(vn, vt, wn, wt, wz, radius):  # type: ignore[no-untyped-def]
    """Return twice the energy over the mass of a solid sphere.

    Args:
        vn: Velocity along the normal of a contact, m/s.
        vt: Velocity along the tangent, m/s.
        wn: Spin about the normal, rad/s.
        wt: Spin about the tangent, rad/s.
        wz: Side spin, rad/s.
        radius: m.

    Returns:
        m^2/s^2, of the real parts of the arguments.
    """
    spin = wn.real * wn.real + wt.real * wt.real + wz.real * wz.real
    return vn.real * vn.real + vt.real * vt.real + 0.4 * radius.real * radius.real * spin


def collect_models(modules: Iterable[ModuleType]) -> tuple[ContactModel, ...]:
    """Collect the models that modules define.

    Args:
        modules: Modules of a folder; those without a `MODEL` are skipped.

    Returns:
        The models by rank and name. The position of a model is its code in compiled functions.

    Raises:
        ValueError: Two models have the same name.
    """
    entries = (getattr(module, "MODEL", None) for module in modules)
    models = sorted((one for one in entries if isinstance(one, ContactModel)), key=lambda one: (one.rank, one.name))
    names = [model.name for model in models]
    if len(set(names)) < len(names):
        raise ValueError(f"the name of a contact model is unique; got {', '.join(names)}")
    return tuple(models)


def find_model(models: Iterable[ContactModel], name: str) -> ContactModel:
    """Find a model by its name.

    Args:
        models: Models of one folder.
        name: As users write it.

    Returns:
        The model.

    Raises:
        ValueError: No model has this name; the message lists the names.
    """
    by_name = {model.name: model for model in models}
    if name not in by_name:
        raise ValueError(f"a law is one of {', '.join(by_name)}; got {name!r}")
    return by_name[name]


def tabulate_parameters(models: Sequence[ContactModel], generic_law: tuple[int, ...]) -> BoolArray:
    """Tabulate which parameters act in a contact by which model.

    Args:
        models: Models of one folder, by code.
        generic_law: Indices of the parameters that act beside every model.

    Returns:
        (len(models), P) True where the parameter of `PARAMETER_NAMES` acts.
    """
    return np.array(
        [[name in model.parameters or k in generic_law for k, name in enumerate(PARAMETER_NAMES)] for model in models]
    )


def compose_dispatch(models: Sequence[ContactModel]) -> Any:
    """Compose one compiled function that resolves a contact by any of several models.

    Numba binds calls when it compiles, so the choice is a branch per model.

    Args:
        models: At most `MOST_MODELS` models of one folder, by code.

    Returns:
        A compiled function of a model's code and the arguments of `ContactModel.resolve`. A code beyond the last model
        stands for the last one.

    Raises:
        ValueError: There are more models than branches.
    """
    if len(models) > MOST_MODELS:
        raise ValueError(
            f"{len(models)} contact models need as many branches in `compose_dispatch`; it has {MOST_MODELS}"
        )
    laws = [model.resolve for model in models]
    law_0, law_1, law_2, law_3, law_4, law_5, law_6, law_7 = (*laws, *[laws[-1]] * (MOST_MODELS - len(laws)))

    @compile_kernel
    def dispatch(code, *arguments):  # type: ignore[no-untyped-def]
        if code == 0:
            return law_0(*arguments)
        if code == 1:
            return law_1(*arguments)
        if code == 2:
            return law_2(*arguments)
        if code == 3:
            return law_3(*arguments)
        if code == 4:
            return law_4(*arguments)
        if code == 5:
            return law_5(*arguments)
        if code == 6:
            return law_6(*arguments)
        return law_7(*arguments)

    return dispatch


# Impulse per reduced mass and slip that stops the slip between two solid spheres, which then turn as gears.
STICKING_SHARE = 2.0 / 7.0


@compile_kernel
def surface_slip(vat, wat, waz, vbt, wbt, wbz, ra, rb):  # type: ignore[no-untyped-def]
    """Return the velocity of the surface of ball a relative to that of ball b along t and z, m/s."""
    return vat - vbt + ra * waz + rb * wbz, -(ra * wat + rb * wbt)


@compile_kernel
def apply_ball_impulse(  # type: ignore[no-untyped-def]
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, normal, along, up
):
    """Return both balls after impulses of b on a (kg m/s): `normal` against n, `along` along t, `up` along z.

    The balls stay on the table.
    """
    spin_a, spin_b = 2.5 / (ma * ra), 2.5 / (mb * rb)
    return (
        van - normal / ma,
        vat + along / ma,
        wan,
        wat - spin_a * up,
        waz + spin_a * along,
        vbn + normal / mb,
        vbt - along / mb,
        wbn,
        wbt - spin_b * up,
        wbz + spin_b * along,
    )


@compile_kernel
def rub_balls(  # type: ignore[no-untyped-def]
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, normal, friction
):
    """Return both balls after a normal impulse, and friction of at most this impulse, which never reverses the slip."""
    st, sz = surface_slip(vat, wat, waz, vbt, wbt, wbz, ra, rb)
    slip = np.sqrt(st * st + sz * sz + 1e-300)
    stick = STICKING_SHARE * ma * mb / (ma + mb)
    share = friction / slip if friction.real < stick.real * slip.real else stick
    return apply_ball_impulse(
        van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, normal, -share * st, -share * sz
    )


# Height of the nose above the cloth over the ball's radius: 62.5 to 64.5 % of the diameter (WPA equipment
# specifications).
NOSE_HEIGHT = 1.27
NOSE_HEIGHT_PARAMETER = "cushion_height.ratio"
# Least height of a contact over the radius, see `models.physics.effects.contacts.cushion_height`.
LEAST_HEIGHT = 0.5

# Parameters that every cushion model reads.
CUSHION_PARAMETERS = (
    "cushion_restitution.e",
    "cushion_restitution_speed.slope",
    "cushion_restitution_power.power",
    "cushion_friction.mu",
    NOSE_HEIGHT_PARAMETER,
)

_E = parameter_vector.CUSHION_E
_SLOPE, _POWER = parameter_vector.CUSHION_E_SLOPE, parameter_vector.CUSHION_E_POWER
_HEIGHT = parameter_vector.CUSHION_HEIGHT


@compile_kernel
def contact_inclination(p, standard_height):  # type: ignore[no-untyped-def]
    """Evaluate the sine and cosine of the angle theta by which the normal of the contact leans up.

    Args:
        p: (P,) physical parameters.
        standard_height: Height of the contact over the radius where `cushion_height.ratio` is 0. Ratios near 0, below
            any real height, are deviations from it, so that the height has a derivative by the ratio there.

    Returns:
        sin(theta) and cos(theta).
    """
    height = p[_HEIGHT]
    if height.real < LEAST_HEIGHT:
        height = height + standard_height
    sine = height - 1.0
    return sine, np.sqrt(1.0 - sine * sine)


@compile_kernel
def restitution_at_speed(vn, p):  # type: ignore[no-untyped-def]
    """Evaluate the restitution e0 vn^-power - slope vn, clipped to 0 to 1.

    Args:
        vn: Normal speed before the contact, m/s.
        p: (P,) physical parameters.

    Returns:
        The restitution.
    """
    e = p[_E] * np.exp(-p[_POWER] * np.log(vn)) - p[_SLOPE] * vn
    if e.real > 1.0:
        return 0.0 * e + 1.0
    if e.real < 0.0:
        return 0.0 * e
    return e


@compile_kernel
def contact_velocities(vn, vt, wn, wt, wz, radius, sine, cosine):  # type: ignore[no-untyped-def]
    """Return the closing speed along N, and the slip of the ball's surface along t and k, m/s."""
    return cosine * vn, vt + radius * (cosine * wz - sine * wn), -sine * vn - radius * wt


@compile_kernel
def apply_cushion_impulse(vn, vt, wn, wt, wz, radius, normal, along, up, sine, cosine):  # type: ignore[no-untyped-def]
    """Return velocity and spin after impulses per mass (m/s): `normal` against N, `along` along t, `up` along k.

    The vertical velocity is dropped. A weak push on a ball with heavy spin can leave it moving into the cushion; the
    cloth stops that motion.
    """
    spin = 2.5 / radius
    vn = vn - cosine * normal - sine * up
    if vn.real > 0.0:
        vn = 0.0 * vn
    return vn, vt + along, wn - sine * spin * along, wt - spin * up, wz + cosine * spin * along
