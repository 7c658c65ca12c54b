"""The catalogue of effects of mechanisms: every file below `models.physics.mechanisms.laws` that defines `EFFECT`."""

from __future__ import annotations

from models.core.module_discovery import discover_modules
from models.physics.mechanisms.mechanism_effect import MechanismEffect

MECHANISM_EFFECTS: dict[str, MechanismEffect] = {
    module.EFFECT.name: module.EFFECT
    for module in discover_modules("models.physics.mechanisms.laws")
    if hasattr(module, "EFFECT")
}
