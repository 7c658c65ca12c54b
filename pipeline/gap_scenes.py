"""The scene of a track folder, as the diagnosis asks for it."""

from __future__ import annotations

from models.errors import OptionError
from models.flight.gap import flight_scene
from models.gap_scene import GapScene
from models.pendulum.gap import pendulum_scene
from models.slide.gap import slide_scene
from pipeline.track_folder import TrackFolder


def open_scene(folder: TrackFolder) -> GapScene:
    """OptionError for a scene that cannot be diagnosed, or for effects that it does not hold."""
    entry = folder.entry
    assumed = tuple(name for name in entry.model or () if name != "gravity")
    scene = _scene(folder, assumed)
    held = [effect.name for effect in scene.effects]
    foreign = [name for name in assumed if name not in held]
    if foreign:
        raise OptionError(f"{entry.scene} has the effects {', '.join(held)}; its model names {', '.join(foreign)}")
    return scene


def _scene(folder: TrackFolder, assumed: tuple[str, ...]) -> GapScene:
    count = len(folder.coordinates)
    if folder.entry.scene == "slide":
        return slide_scene(assumed)
    if folder.entry.scene == "flight":
        return flight_scene(count, folder.entry.gravity, assumed)
    if folder.entry.scene == "pendulum":
        return pendulum_scene(count, assumed)
    raise OptionError(f"{folder.entry.scene} cannot be diagnosed yet; flight, pendulum and slide can")
