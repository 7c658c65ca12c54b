"""View, cloth and balls of a table profile: read as a start of the next calibration, and improved by every run."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    FiniteFloat,
    PositiveFloat,
    PositiveInt,
    ValidationError,
)

from models.core.constants import GRAVITY
from models.core.errors import OptionError
from models.core.fit_result import Parameter
from models.core.scene import BallSize
from models.core.typing import FloatArray
from models.estimation.table_learning.learned_table import CLOTH_SPREAD
from models.numerics.statistics import intersect_estimates
from models.physics.billiards.parameter_vector import TABLE_PARAMETERS
from pipeline.io.profile_export import SCHEMA
from pipeline.io.run_folder import list_files_beside, parse_camera, parse_table, read_scene_document
from pipeline.io.strict_json import write_json
from pipeline.io.table_profile import SIZE_TOLERANCE, ProfileEntry, read_profile_text
from video.calibration.view_prior import CLOTH_MISFIT, PROFILE_NOTE, ViewPrior

# Parameters of the cloth that every shot gives.
FRICTION = ("sliding_friction.mu", "rolling_resistance.mu")
# Standard deviations by which the friction of a shot differs from a profile of another cloth: by chance in 0.3 %.
MISFIT_SIGMAS = 3.0
# m/s, of the rolls from which a single shot gives rolling friction; a drag of the profile adds to it at this speed.
ROLLING_SPEED, ROLLING_SPEED_SIGMA = 1.0, 0.5


class ImageSizeEntry(BaseModel):
    """Size of an image, px."""

    width_px: PositiveInt
    height_px: PositiveInt


def _require_shape(shape: tuple[int, int], name: str, rows: list[list[float]]) -> list[list[float]]:
    if len(rows) != shape[0] or any(len(row) != shape[1] for row in rows):
        raise ValueError(f"{name} has {shape[0]} rows of {shape[1]} numbers")
    return rows


def _require_covariance(rows: list[list[float]]) -> list[list[float]]:
    values = np.array(_require_shape((8, 8), "corner_covariance_px2", rows))
    if not np.allclose(values, values.T) or np.linalg.eigvalsh(values)[0] <= 0:
        raise ValueError("corner_covariance_px2 must be symmetric with eigenvalues above 0")
    return rows


class ViewEntry(BaseModel):
    """Corners of the noses in the images of a camera that stands still."""

    model_config = ConfigDict(extra="allow")
    image: ImageSizeEntry
    corners_px: Annotated[list[list[FiniteFloat]], AfterValidator(partial(_require_shape, (4, 2), "corners_px"))]
    corner_covariance_px2: Annotated[list[list[FiniteFloat]], AfterValidator(_require_covariance)]
    shots: PositiveInt = 1


class ClothEntry(BaseModel):
    """Colour of the cloth, CIE L*a*b*."""

    lab: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    shots: PositiveInt = 1


class RadiusEntry(BaseModel):
    """Radius of the balls, m."""

    model_config = ConfigDict(extra="allow")
    value: PositiveFloat
    sigma: PositiveFloat


class BallSetEntry(BaseModel):
    """Ball classes that were seen, and the size of the balls."""

    kinds: list[str] = []
    radius: RadiusEntry


class ViewProfileEntry(BaseModel):
    """The parts of a profile that are no physics."""

    view: ViewEntry | None = None
    cloth: ClothEntry | None = None
    balls: BallSetEntry | None = None


def parse_view_prior(text: str) -> ViewPrior | None:
    """Build the start of a calibration from a profile.

    Args:
        text: Content of the profile, JSON.

    Returns:
        Table, ball size, view and colour; None for a profile without table or balls, as earlier versions wrote.

    Raises:
        OptionError: A part of the profile is malformed.
    """
    return _build_view_prior(json.loads(text))


def _build_view_prior(document: dict[str, Any]) -> ViewPrior | None:
    """Build the start of a calibration from the content of a profile."""
    try:
        entry = ViewProfileEntry.model_validate(document)
    except ValidationError as error:
        raise OptionError(f"--profile has a view that cannot be used: {error.errors()[0]['msg']}") from error
    if entry.balls is None or "table" not in document:
        return None
    radius = entry.balls.radius
    table = parse_table({**document, "ball_radius": radius.value})
    view = entry.view
    corners = None if view is None else np.array(view.corners_px)
    covariance = None if view is None else np.array(view.corner_covariance_px2)
    size = (0, 0) if view is None else (view.image.width_px, view.image.height_px)
    lab = None if entry.cloth is None else np.array(entry.cloth.lab)
    ball_size = BallSize(radius.value, radius.sigma, "preset")
    return ViewPrior(table, ball_size, corners, covariance, size, lab, 0 if view is None else view.shots)


def list_profile_misfits(text: str, cloth_lab: FloatArray, parameters: Iterable[Parameter]) -> tuple[str, ...]:
    """List why the physics of a profile does not fit a shot.

    Args:
        text: Content of the profile, JSON; empty for none.
        cloth_lab: (3,) colour of the cloth in the clip, CIE L*a*b*.
        parameters: Fitted parameters of the shot.

    Returns:
        Sentences; empty where the profile fits.
    """
    if not text:
        return ()
    profile = json.loads(text)
    prior, effects = _build_view_prior(profile), ProfileEntry.model_validate(profile).effects
    misfits = []
    if prior is not None and not prior.agrees_with_cloth(cloth_lab):
        misfits.append(CLOTH_MISFIT)
    for one in parameters:
        expected = _expect_friction(effects, one.name)
        if expected is None or one.prior_only:
            continue
        value, sigma = expected
        deviation = abs(one.value - value) / math.hypot(sigma, one.sigma)
        if deviation > MISFIT_SIGMAS:
            misfits.append(
                f"{PROFILE_NOTE} {one.name} is {one.value:.4f} ± {one.sigma:.4f} in this clip and {value:.4f} in it,"
                f" {deviation:.1f} standard deviations away: the cloth has changed; its friction is not used"
            )
    return tuple(misfits)


def _expect_friction(effects: dict[str, Any], name: str) -> tuple[float, float] | None:
    """Return friction and standard deviation that a profile makes a single shot expect; None if it holds none."""
    effect, _, parameter = name.partition(".")
    entry = effects.get(effect, {}).get(parameter)
    if name not in FRICTION or entry is None or entry.sigma is None:
        return None
    value, variance = entry.value, entry.sigma**2 + (CLOTH_SPREAD * entry.value) ** 2
    drag = effects.get("viscous_drag", {}).get("k")
    if effect == "rolling_resistance" and drag is not None:
        value += drag.value * ROLLING_SPEED / GRAVITY
        variance += (drag.value * ROLLING_SPEED_SIGMA / GRAVITY) ** 2
    return value, math.sqrt(variance)


def update_profile(path: Path, folder: Path) -> tuple[str, ...]:
    """Improve a profile by the results of a run, in one step; a missing file is started.

    Args:
        path: File of the profile.
        folder: Run folder.

    Returns:
        Sentences on what was begun anew, because it did not fit.

    Raises:
        OptionError: The profile cannot be used, or is that of another table.
    """
    profile = (
        json.loads(read_profile_text(path))
        if path.exists()
        else {"schema": SCHEMA, "scene": "billiards", "effects": {}}
    )
    scene = read_scene_document(folder / "scene.json")
    notes = [*add_view(profile, scene), *_add_effects(profile, scene)]
    write_json(profile, path)
    return tuple(notes)


def collect_views(sources: Iterable[Path]) -> dict[str, Any]:
    """Collect view, cloth and balls of run folders; track folders without a calibration add nothing.

    Args:
        sources: Run folders, track folders, or their tracks.csv.

    Returns:
        The entries `table`, `view`, `cloth`, `balls` and `ball_radius` of a profile, as far as they are known.
    """
    profile: dict[str, Any] = {}
    for file in list_files_beside(sources, "scene.json"):
        document = read_scene_document(file)
        if "calibration" in document and "ball_size" in document:
            add_view(profile, document)
    return profile


def add_view(profile: dict[str, Any], scene: dict[str, Any]) -> list[str]:
    """Add table, view, cloth and balls of a run to a profile, in place.

    Args:
        profile: Content of the profile.
        scene: Content of the scene.json of the run.

    Returns:
        Sentences on what was begun anew.

    Raises:
        OptionError: The profile is that of a table of another size.
    """
    table, own, notes = parse_table(scene), profile.get("table"), []
    if own is not None and any(
        abs(own[side] / getattr(table, side) - 1) > SIZE_TOLERANCE for side in ("length", "width")
    ):
        raise OptionError(
            f"--update-profile is of a table of {own['length']:g} x {own['width']:g} m; that of the clip is"
            f" {table.length:g} x {table.width:g} m: name another file"
        )
    prior = _build_view_prior(profile)
    described = {name: getattr(table, name) for name in ("name", "game", "length", "width", "pockets")}
    profile["table"] = described | (own or {})
    camera = parse_camera(scene)
    if camera is not None and not scene["calibration"].get("camera_moves"):
        corners, covariance, shots = camera.corners_px, camera.corner_covariance, 1
        if prior is not None and prior.corners is not None and prior.covariance is not None:
            is_same = prior.image_size == (camera.width_px, camera.height_px)
            if is_same and prior.agrees_with_corners(corners, covariance):
                flat, covariance = intersect_estimates(
                    (prior.corners.ravel(), prior.covariance), (corners.ravel(), covariance)
                )
                corners, shots = flat.reshape(4, 2), prior.shot_count + 1
            else:
                notes.append(f"{PROFILE_NOTE} the camera stands elsewhere; its view was begun anew")
        profile["view"] = {
            "image": {"width_px": camera.width_px, "height_px": camera.height_px},
            "corners_px": corners.tolist(),
            "corner_covariance_px2": covariance.tolist(),
            "matrix": camera.matrix.tolist(),
            "camera_height": {"value": camera.height, "sigma": camera.height_sigma, "unit": "m"},
            "shots": shots,
        }
    _add_cloth(profile, scene, prior, notes)
    _add_balls(profile, scene)
    return notes


def _add_cloth(profile: dict[str, Any], scene: dict[str, Any], prior: ViewPrior | None, notes: list[str]) -> None:
    """Average the colour of the cloth over the shots.

    Another colour is another cloth: a new average begins and the friction is dropped, except one of `fit-table`.
    """
    lab = scene["table"].get("cloth_lab")
    if lab is None:
        return
    earlier = profile.get("cloth")
    if earlier is None or prior is None or not prior.agrees_with_cloth(np.array(lab)):
        if earlier is not None and "learned_from" in profile:
            notes.append(
                f"{PROFILE_NOTE} the cloth has another colour; learn its friction anew with trueroll fit-table"
            )
        elif earlier is not None:
            notes.append(f"{PROFILE_NOTE} the cloth has another colour; colour and friction were begun anew")
            for name in FRICTION:
                profile.get("effects", {}).pop(name.partition(".")[0], None)
        profile["cloth"] = {"lab": [float(v) for v in lab], "shots": 1}
        return
    shots = int(earlier["shots"]) + 1
    mean = np.array(earlier["lab"]) + (np.array(lab) - earlier["lab"]) / shots
    profile["cloth"] = {"lab": mean.tolist(), "shots": shots}


def _add_balls(profile: dict[str, Any], scene: dict[str, Any]) -> None:
    """Add the ball classes that were seen, and the better estimate of the ball size."""
    size, earlier = scene.get("ball_size") or {}, profile.get("balls")
    kinds = {str(ball["kind"]) for ball in scene.get("balls", []) if "kind" in ball}
    radius = {"value": size.get("radius"), "sigma": size.get("sigma"), "unit": "m"}
    if earlier is not None:
        kinds |= set(earlier["kinds"])
        if not radius["sigma"] or earlier["radius"]["sigma"] <= radius["sigma"]:
            radius = earlier["radius"]
    if radius["value"] and radius["sigma"]:
        profile["balls"] = {"kinds": sorted(kinds), "radius": radius}
        profile["ball_radius"] = radius["value"]


def _add_effects(profile: dict[str, Any], scene: dict[str, Any]) -> list[str]:
    """Combine the friction of a shot with that of a profile; one that many shots taught is left as it is."""
    notes: list[str] = []
    if "learned_from" in profile:
        return notes
    effects = profile.setdefault("effects", {})
    for name in FRICTION:
        effect, _, parameter = name.partition(".")
        own = scene.get("effects", {}).get(effect, {}).get(parameter)
        if own is None or own.get("prior_only") or not own.get("sigma") or name not in TABLE_PARAMETERS:
            continue
        value, variance, shots = own["value"], own["sigma"] ** 2 + (CLOTH_SPREAD * own["value"]) ** 2, 1
        earlier = effects.get(effect, {}).get(parameter)
        if earlier is not None and earlier.get("sigma"):
            before = earlier["sigma"] ** 2
            spread = math.sqrt(variance + before)
            if abs(value - earlier["value"]) > MISFIT_SIGMAS * spread:
                notes.append(f"{PROFILE_NOTE} {name} is another one; it was begun anew")
            else:
                share = before / (before + variance)
                value = earlier["value"] + share * (value - earlier["value"])
                variance, shots = before * (1 - share), int(earlier.get("shots", 1)) + 1
        effects.setdefault(effect, {})[parameter] = {
            "value": value, "sigma": math.sqrt(variance), "unit": own.get("unit", ""), "shots": shots,
        }  # fmt: skip
    return notes
