"""The scene of a track folder, as the diagnosis asks for it."""

from __future__ import annotations

import numpy as np

from models.core.errors import OptionError
from models.core.scene import Table
from models.estimation.gap_scenes.billiards_scene import USUAL_MODEL, BilliardsScene, Picture, billiards_scene
from models.estimation.gap_scenes.flight_scene import flight_scene
from models.estimation.gap_scenes.gap_scene import GapScene
from models.estimation.gap_scenes.pendulum_scene import pendulum_scene
from models.estimation.gap_scenes.sliding_scene import slide_scene
from models.physics.billiards.tables import nearest_preset
from pipeline.io.track_folder import SceneEntry, TrackFolder


def open_scene(folder: TrackFolder) -> GapScene:
    """OptionError for a scene that cannot be diagnosed, or for effects that it does not hold."""
    entry = folder.entry
    assumed = tuple(name for name in entry.model or () if name != "gravity")
    scene = _scene(folder, assumed)
    held = [effect.name for effect in scene.effects if effect.kind != "probe"]
    foreign = [name for name in assumed if name not in held]
    if foreign:
        raise OptionError(f"{entry.scene} has the effects {', '.join(held)}; its model names {', '.join(foreign)}")
    return scene


def table_of(scene: GapScene) -> Table | None:
    """The table that is played on; None elsewhere."""
    return scene.table if isinstance(scene, BilliardsScene) else None


def _scene(folder: TrackFolder, assumed: tuple[str, ...]) -> GapScene:
    count = len(folder.coordinates)
    if folder.entry.scene == "slide":
        return slide_scene(assumed)
    if folder.entry.scene == "flight":
        return flight_scene(count, folder.entry.gravity, assumed)
    if folder.entry.scene == "pendulum":
        return pendulum_scene(count, assumed)
    return _billiards(folder)


def _billiards(folder: TrackFolder) -> GapScene:
    """Whole shots; the table from scene.json, the balls of the nearest table that is sold where it does not say."""
    entry = folder.entry
    if entry.table is None or entry.table.length < entry.table.width:
        raise OptionError("billiards needs table.length and table.width in scene.json, the length being the longer")
    length, width = entry.table.length, entry.table.width
    sold = nearest_preset(length)
    radius = entry.ball_radius or sold.ball_radius
    mass = sold.ball_mass * (radius / sold.ball_radius) ** 3
    table = Table(f"{length:g}x{width:g}", sold.game, length, width, radius, mass, False)
    return billiards_scene(table, folder.recordings, _picture(entry), _assumed(entry))


def _assumed(entry: SceneEntry) -> tuple[str, ...]:
    """What the simulator has: of a run, whose fit of single paths asks for no law of contacts, the usual at least."""
    if entry.model is None:
        return USUAL_MODEL
    ran = "calibration" in (entry.model_extra or {})
    return tuple(dict.fromkeys((*USUAL_MODEL, *entry.model) if ran else entry.model))


def _picture(entry: SceneEntry) -> Picture | None:
    """How the table lies in the picture; None where nothing is said."""
    image = entry.image
    if image is None:
        return None
    size, origin = np.array([image.width_px, image.height_px]), np.array(image.origin_px)
    return Picture((size / 2 - origin) / image.px_per_m, image.height_px / image.px_per_m, image.px_per_m)
