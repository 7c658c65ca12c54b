"""The catalogue of effects of mechanisms: every file below `models.physics.mechanisms.laws` that defines `EFFECT`.

`models.estimation.gap_scenes.simulator_scene` reads it and offers its effects to the diagnosis of a simulator from
outside; billiards has its own, `models.physics.effects.catalogue`. `diagnosis.diagnose` lists those of all scenes.
"""

from __future__ import annotations

from models.core.module_discovery import discover_modules
from models.physics.mechanisms.mechanism_effect import MechanismEffect

MECHANISM_EFFECTS: dict[str, MechanismEffect] = {
    module.EFFECT.name: module.EFFECT
    for module in discover_modules("models.physics.mechanisms.laws")
    if hasattr(module, "EFFECT")
}
