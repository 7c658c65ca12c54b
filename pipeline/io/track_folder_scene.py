"""Construction of the scene of a diagnosis from a track folder."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from models.core.errors import OptionError
from models.core.recording import Recording
from models.core.scene import Table
from models.estimation.gap_scenes.billiards_scene import (
    DEFAULT_EFFECTS,
    BilliardsScene,
    ImageGeometry,
    build_billiards_scene,
)
from models.estimation.gap_scenes.filmed_flight_scene import build_filmed_flight_scene
from models.estimation.gap_scenes.flight_scene import build_flight_scene
from models.estimation.gap_scenes.gap_scene import GapScene
from models.estimation.gap_scenes.pendulum_scene import build_pendulum_scene
from models.estimation.gap_scenes.sliding_scene import WALL_EFFECTS, build_sliding_scene
from models.estimation.rally.recorded_flights import IMAGE_FRAME
from models.physics.billiards.contact_models import BALL_MODEL_CHOICE, CUSHION_MODEL_CHOICE
from models.physics.billiards.simulation.parametrised_shot import ContactModels
from models.physics.billiards.tables import find_nearest_preset, scale_ball_mass
from pipeline.io.surroundings import WALL_SPELLINGS, Limits
from pipeline.io.track_folder import SceneEntry, TrackFolder


def build_gap_scene(folder: TrackFolder) -> GapScene:
    """Build the scene of a diagnosis.

    Args:
        folder: Recordings with their scene.json.

    Returns:
        The scene with its candidate effects.

    Raises:
        OptionError: The scene cannot be diagnosed, or its model names an unknown effect.
    """
    entry = folder.entry
    if entry.walls is not None and entry.scene != "slide":
        raise OptionError(f"walls belong to the scene slide, and scene.json has {entry.scene}; remove them")
    assumed = tuple(name for name in entry.model or () if name != "gravity")
    scene = _build_scene(folder, assumed)
    available = [effect.name for effect in scene.effects if effect.kind != "probe"]
    foreign = [name for name in assumed if name not in available]
    if foreign:
        raise OptionError(f"{entry.scene} has the effects {', '.join(available)}; its model names {', '.join(foreign)}")
    return scene


def billiards_table(scene: GapScene) -> Table | None:
    """Return the table of a billiards scene.

    Args:
        scene: Any scene of a diagnosis.

    Returns:
        The table; None for other scenes.
    """
    return scene.table if isinstance(scene, BilliardsScene) else None


def _build_scene(folder: TrackFolder, assumed: tuple[str, ...]) -> GapScene:
    count = len(folder.reference.coordinates)
    if folder.entry.scene == "slide":
        return _build_slide(folder, assumed)
    if folder.reference == IMAGE_FRAME:
        return build_filmed_flight_scene(assumed)
    if folder.entry.scene == "flight":
        return build_flight_scene(count, folder.entry.gravity, assumed, bool(folder.inputs))
    if folder.entry.scene == "pendulum":
        return build_pendulum_scene(count, assumed)
    return _build_billiards(folder)


def _build_slide(folder: TrackFolder, assumed: tuple[str, ...]) -> GapScene:
    """Build a slide, with walls where scene.json states them."""
    entry = folder.entry
    needing = [effect.name for effect in WALL_EFFECTS if effect.name in assumed]
    if entry.walls is None:
        if needing:
            raise OptionError(f"{needing[0]} needs walls in scene.json; state them as {WALL_SPELLINGS}")
        return build_sliding_scene(assumed, (), folder.recordings)
    limits = _find_centre_limits(entry, entry.walls, folder.recordings)
    return build_sliding_scene(assumed, limits, folder.recordings)


def _build_billiards(folder: TrackFolder) -> GapScene:
    """Build a billiards scene; balls without a radius are those of the preset of the most similar length."""
    entry = folder.entry
    if entry.table is None or entry.table.length < entry.table.width:
        raise OptionError("billiards needs table.length and table.width in scene.json, the length being the longer")
    length, width = entry.table.length, entry.table.width
    preset = find_nearest_preset(length)
    radius = entry.ball_radius or preset.ball_radius
    mass = scale_ball_mass(preset, radius)
    table = Table(f"{length:g}x{width:g}", preset.game, length, width, radius, mass, False)
    effects, laws = _list_assumed_effects(entry), _read_contact_models(entry)
    return build_billiards_scene(table, folder.recordings, _image_geometry(entry), effects, laws)


def _read_contact_models(entry: SceneEntry) -> ContactModels:
    """Read the contact models of the user's simulator; those of a run folder explain its shot, and are not assumed."""
    laws = {} if entry.laws is None or _is_run_folder(entry) else entry.laws
    forms = {"cushion": CUSHION_MODEL_CHOICE.forms, "ball": BALL_MODEL_CHOICE.forms}
    for kind, name in laws.items():
        if name not in forms.get(kind, ()):
            raise OptionError(
                f"laws in scene.json are cushion ({', '.join(forms['cushion'])}) and ball ({', '.join(forms['ball'])});"
                f" got {kind}: {name}"
            )
    return ContactModels(**laws)


def _is_run_folder(entry: SceneEntry) -> bool:
    return "calibration" in (entry.model_extra or {})


def _list_assumed_effects(entry: SceneEntry) -> tuple[str, ...]:
    """List the effects of the user's simulator, for a run folder together with the default ones.

    A run folder states the effects that its fit estimated; those of contacts are lacking where it had none.
    """
    if entry.model is None:
        return DEFAULT_EFFECTS
    return tuple(dict.fromkeys((*DEFAULT_EFFECTS, *entry.model) if _is_run_folder(entry) else entry.model))


def _image_geometry(entry: SceneEntry) -> ImageGeometry | None:
    """Return position and scale of the table in the image; None if they are unknown."""
    image = entry.image
    if image is None:
        return None
    size, origin = np.array([image.width_px, image.height_px]), np.array(image.origin_px)
    return ImageGeometry((size / 2 - origin) / image.px_per_m, image.height_px / image.px_per_m, image.px_per_m)


# Tolerated distance beyond a wall, in sides of the rectangle: wrong units give more.
_MAX_OVERSHOOT = 0.1
# Largest tolerated share of positions further outside.
_MAX_SHARE_OUTSIDE = 0.25


def _find_centre_limits(entry: SceneEntry, walls: Limits, recordings: Sequence[Recording]) -> Limits:
    """Find the limits of the centre of a body between walls; it must fit there, and most positions be between them."""
    (x, y), radius = walls, entry.radius
    limits = (x[0] + radius, x[1] - radius), (y[0] + radius, y[1] - radius)
    if any(low >= high for low, high in limits):
        raise OptionError(
            f"scene.json: a body of radius {radius:g} m does not fit between the walls; correct one of them"
        )
    places = np.concatenate([one.positions[one.is_observed] for one in recordings])
    for axis, (low, high) in enumerate(limits):
        margin = _MAX_OVERSHOOT * (high - low)
        outside = (places[:, axis] < low - margin) | (places[:, axis] > high + margin)
        if outside.mean() > _MAX_SHARE_OUTSIDE:
            name = "xy"[axis]
            raise OptionError(
                f"scene.json: {name} goes from {places[:, axis].min():.3g} to {places[:, axis].max():.3g} m, but the"
                f" walls keep it between {low:.3g} and {high:.3g} m; correct walls, radius or units"
            )
    return limits
