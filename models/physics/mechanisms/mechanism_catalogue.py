"""The effects of mechanisms: it finds every file below `models.physics.mechanisms.laws` that defines `EFFECT`.

`models.estimation.gap_scenes.simulator_scene` reads it and offers its effects to the diagnosis of a simulator from
outside. Billiards has a catalogue of its own, `models.physics.effects.billiards_catalogue`; `diagnosis.diagnose` lists
where each scene has its effects.
"""

from __future__ import annotations

from models.core.module_discovery import discover_modules
from models.physics.mechanisms.mechanism_effect import MechanismEffect

MECHANISM_EFFECTS: dict[str, MechanismEffect] = {
    module.EFFECT.name: module.EFFECT
    for module in discover_modules("models.physics.mechanisms.laws")
    if hasattr(module, "EFFECT")
}
