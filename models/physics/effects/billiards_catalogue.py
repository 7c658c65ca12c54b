"""The effects of billiards: it finds every file below `models.physics.effects` that defines `EFFECT`.

A diagnosis of billiards also tests the contact laws of `models.physics.billiards.contact_models`. Mechanisms have a
catalogue of their own, `models.physics.mechanisms.mechanism_catalogue`; `diagnosis.diagnose` lists where each scene has
its effects.
"""

from __future__ import annotations

from collections.abc import Iterable
from types import ModuleType

from models.core.module_discovery import discover_modules
from models.physics.effect import BilliardsEffect, Prior


def collect_effects(modules: Iterable[ModuleType]) -> tuple[BilliardsEffect, ...]:
    """Collect the effects that modules define.

    Args:
        modules: Modules of the catalogue; those without an `EFFECT` are skipped.

    Returns:
        The effects by rank and name.

    Raises:
        ValueError: Two effects have the same name.
    """
    entries = (getattr(module, "EFFECT", None) for module in modules)
    effects = [entry for entry in entries if isinstance(entry, BilliardsEffect)]
    effects.sort(key=lambda effect: (effect.rank, effect.name))
    names = [effect.name for effect in effects]
    if len(set(names)) < len(names):
        raise ValueError(f"the name of an effect is unique; got {', '.join(names)}")
    return tuple(effects)


# All effects that a fit or a diagnosis of billiards may contain.
BILLIARDS_EFFECTS = collect_effects(discover_modules("models.physics.effects"))


def find_prior(effect: str, parameter: str) -> Prior:
    """Find the prior of a parameter.

    Args:
        effect: Name of an effect of the catalogue.
        parameter: Name of one of its parameters.

    Returns:
        The prior, in the unit of the effect.

    Raises:
        ValueError: The catalogue has no such parameter.
    """
    for entry in BILLIARDS_EFFECTS:
        for prior in entry.parameters:
            if (entry.name, prior.name) == (effect, parameter):
                return prior
    names = ", ".join(entry.name for entry in BILLIARDS_EFFECTS)
    raise ValueError(f"the catalogue holds {names}; it has no {effect}.{parameter}")
