"""Published models of a contact, and one compiled function that contains all of them.

A model is one file in `ball_cushion` or `ball_ball` that defines `MODEL`, a `ContactModel`. The registry of the folder
(`cushion_models`, `ball_models`) finds the file and derives everything else from it: names, checks of parameters,
compiled dispatch and derivatives, and the models that a diagnosis compares.
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
from models.physics.billiards.parameter_vector import PARAMETER_NAMES

# Energy after a contact over that before it that rounding explains.
MAX_ENERGY_RATIO = 1.0 + 1e-9
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
    """Compiled; the signature is that of the folder, see `cushion_models.rebound` and `ball_models.collide`."""
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


def compose_dispatch(
    models: Sequence[ContactModel],
    prepend_model: Callable[[int, Callable[..., Any], Any], Any],
    ignore_code: Callable[[Callable[..., Any]], Any],
) -> Any:
    """Compose one compiled function that resolves a contact by any of several models.

    Numba binds calls when it compiles, so the choice is a chain of closures, each of which compares the code with its
    own and otherwise calls the next one. They are inlined and become plain conditions.

    Args:
        models: Models of one folder, by code.
        prepend_model: Makes a closure of a code, `ContactModel.resolve` and the closure of all models behind it.
        ignore_code: Makes a closure that calls `ContactModel.resolve` whatever the code.

    Returns:
        A compiled function of a model's code and the arguments of `ContactModel.resolve`. A code beyond the last model
        stands for the last one.
    """
    *others, last = models
    dispatch = ignore_code(last.resolve)
    for code, model in reversed(tuple(enumerate(others))):
        dispatch = prepend_model(code, model.resolve, dispatch)
    return dispatch
