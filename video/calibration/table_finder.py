"""Table localisation and camera calibration of a clip or an image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.errors import OptionError, TableNotFound
from models.core.progress import Progress, ignore_progress
from models.core.scene import Camera, Scene, Table, combine_ball_sizes, find_contradictions
from models.core.typing import FloatArray, ImageArray
from models.numerics.statistics import intersect_estimates
from models.physics.billiards.tables import (
    TABLE_PRESETS,
    estimate_preset_ball_size,
    estimate_typed_ball_size,
    format_contradiction,
    parse_table,
    replace_ball_radius,
)
from video.calibration.ball_size import measure_ball_sizes
from video.calibration.camera_model import PerspectiveFit, build_camera, orient_corners
from video.calibration.camera_motion import (
    MAX_STILL_SHIFT_PX,
    detect_camera_motion,
    estimate_camera_motion,
    measure_shifts,
    select_reference_features,
)
from video.calibration.cloth_region import (
    ClothRegion,
    find_cloth_regions,
    intersect_lines,
    line_through,
    measure_median_colour,
)
from video.calibration.cushion_noses import CushionNoses, find_cushion_noses, find_noses_near
from video.calibration.table_classifier import (
    classify_table,
    count_painted_lines,
    has_snooker_d,
    measure_pocket_share,
)
from video.calibration.view_prior import CLOTH_MISFIT, MOTION_NOTE, PROFILE_NOTE, ViewPrior
from video.io.clip import Clip, read_frames
from video.io.video_options import CalibrateOptions

# Number of frames spread over the clip; their median shows the table without moving objects.
SAMPLED_FRAMES = 9
# Number of frames in which the image sways most; they show whether a camera on a stand was knocked.
SWAYING_FRAMES = 6
# Range of length over width of a billiard table, as measured; those above 2.1 are home tables.
ASPECT_RANGE = (1.9, 2.3)
# Relative difference from 2:1 from which the measured shape replaces that of the preset: three standard deviations of
# the shape of usual tables, where `fit_perspective` begins to prefer the other kind.
UNUSUAL_ASPECT_SHARE = 0.035
# Smallest share of the cloth's sides that must end in a straight line.
MIN_SIDE_SUPPORT = 0.6
# Squared standard deviations of shape, cushions and missing lines above which a table is rejected.
MAX_MISFIT = 40.0
# Misfit below which other regions need not be examined.
GOOD_MISFIT = 8.0
# Cost of a cloth without straight sides, in squared standard deviations.
UNSUPPORTED_COST = 20.0
# Smallest share of the six pocket positions that differ from the cloth on a table with pockets.
MIN_POCKET_SHARE = 0.3
# Largest share of frames that may fail to register when the camera moves.
MAX_LOST_SHARE = 0.1
# Noses at their expected places that show the table where it cannot be located without earlier clips: two pairs of
# parallel noses leave no room for another place, a single pair does.
MIN_EXPECTED_NOSES = 3
# px, standard deviation of corners given by the user.
USER_CORNER_SIGMA_PX = 2.0
# Painted lines in either direction that make a court: a table has a line across and none along at most.
MIN_COURT_LINES = 2
# Intersection over union of two quadrangles from which they are one table: a corner that is wrong by a tenth of the
# length leaves 0.9, and tables that stand side by side do not overlap.
SAME_TABLE_OVERLAP = 0.8
# Standardized distance between a given and a measured corner above which they contradict: twice the usual three,
# because the errors of either are not normal.
CORNER_CONTRADICTION_SIGMAS = 6.0


@dataclass(frozen=True, slots=True)
class TableLocation:
    """A table in an image: corners of the noses in the order of `Table.corners`, and intermediate results."""

    corners: FloatArray
    covariance: FloatArray
    perspective: PerspectiveFit
    cloth_colour: FloatArray
    outer_corners: FloatArray | None
    notes: tuple[str, ...]
    visible_count: int = 0
    """Number of noses that were detected; the others are inferred from them, or were given."""
    is_from_user: bool = False
    """Whether the user gave the corners."""
    automatic: TableLocation | None = None
    """The same table as located without the corners of the user, who says where it is, not which one; None where it is
    not located, or the corners are those of another table."""


def calibrate_clip(
    clip: Clip, options: CalibrateOptions, progress: Progress = ignore_progress, prior: ViewPrior | None = None
) -> Scene:
    """Locate the table in a clip and calibrate the camera; the first frame is the reference of a moving camera.

    Args:
        options: corners, table and ball radius if the user gave them.
        progress: is called with the share of the work done, 0 to 1.
        prior: table and view of earlier clips; what does not fit is named in the notes and not used.

    Returns:
        Table and camera, with notes and warnings for the user.

    Raises:
        TableNotFound: no table can be trusted; the message is one sentence for the user.
        OptionError: an option is not meaningful.
    """
    requested = parse_table(options.table) if options.table is not None else None
    frames, swaying = _sample_frame_indices(clip), _select_swaying_frames(clip)
    shown = dict(read_frames(clip, indices=np.union1d(frames, swaying)))
    images = [shown[frame] for frame in frames.tolist()]
    progress(0.3)
    location, background = _locate_in_clip(clip, images, options.corners, prior)
    motion, lost = _estimate_motion(clip, images, [shown[frame] for frame in swaying.tolist()], location)
    progress(0.7)
    if motion is not None:
        # After registration to the first frame, the median is sharp again.
        images = [
            _warp_to_reference(image, motion[k]) for image, k in zip(images, frames - clip.first_frame, strict=True)
        ]
        background = compute_median_image(images)
        if options.corners is None:
            location = locate_table(background, clip.path.name)
        else:
            location = _locate_from_option(options.corners, background, clip.stored_scale)
    scene = _build_scene(location, background, images, options, requested, prior)
    progress(1.0)
    notes = (*scene.notes, *_motion_notes(scene.camera, motion, lost))
    if prior is not None and not prior.agrees_with_cloth(scene.cloth_lab):
        notes += (CLOTH_MISFIT,)
    return replace(scene, camera=replace(scene.camera, motion=motion, first_frame=clip.first_frame), notes=notes)


def calibrate_image(image: ImageArray, options: CalibrateOptions, name: str = "the image") -> Scene:
    """Locate the table in a still image and calibrate the camera.

    Args:
        image: (H, W, 3) RGB.
        options: corners, table and ball radius if the user gave them.
        name: name of the image in messages.

    Returns:
        Table and camera, with notes and warnings for the user.

    Raises:
        TableNotFound: no table can be trusted; the message is one sentence for the user.
        OptionError: an option is not meaningful.
    """
    requested, corners = parse_table(options.table) if options.table is not None else None, options.corners
    location = locate_table(image, name) if corners is None else _locate_from_option(corners, image, (1.0, 1.0))
    return _build_scene(location, image, [image], options, requested)


def _locate_in_clip(
    clip: Clip, images: list[ImageArray], corners: str | None, prior: ViewPrior | None
) -> tuple[TableLocation, ImageArray]:
    """Locate the table in the median of the sampled frames, or in the first one where the camera moves too much."""
    background = compute_median_image(images)
    if corners is not None:
        return _locate_from_option(corners, background, clip.stored_scale), background
    if prior is not None and prior.corners is not None:
        return _locate_with_prior(background, clip.path.name, prior), background
    try:
        return locate_table(background, clip.path.name), background
    except TableNotFound:
        return locate_table(images[0], clip.path.name), images[0]


def _locate_with_prior(image: ImageArray, name: str, prior: ViewPrior) -> TableLocation:
    """Locate the table near the corners of earlier clips, or anew where the camera has moved."""
    height, width = image.shape[:2]
    assert prior.corners is not None
    assert prior.covariance is not None
    if (width, height) != prior.image_size:
        why = "the image has another size than in it; its view is not used"
        return _add_note(locate_table(image, name), why)
    noses = find_noses_near(image, prior.corners, prior.covariance)
    is_complete = noses is not None and all(noses.is_visible)
    location = None if is_complete else _locate_if_possible(image, name, noses)
    latest = noses if location is None else location
    assert latest is not None
    if prior.agrees_with_corners(latest.corners, latest.covariance):
        corners, covariance = intersect_estimates(
            (prior.corners.ravel(), prior.covariance), (latest.corners.ravel(), latest.covariance)
        )
        ordered, perspective = orient_corners(corners.reshape(4, 2), width, height, _mean_sigma(covariance))
        if np.allclose(ordered, corners.reshape(4, 2)):
            shots = f"{prior.shot_count} earlier shot{'s' if prior.shot_count > 1 else ''}"
            note = f"table located from the view of {shots}"
            colour = measure_median_colour(image, ordered)
            return TableLocation(ordered, covariance, perspective, colour, None, (note,))
    location = locate_table(image, name) if location is None else location
    shift = float(np.linalg.norm(location.corners - prior.corners, axis=1).max())
    why = f"the corners of the table are up to {shift:.1f} px away: the camera has moved; its view is not used"
    return _add_note(location, why)


def _locate_if_possible(image: ImageArray, name: str, noses: CushionNoses | None) -> TableLocation | None:
    """Locate the table in the image alone; None where that fails, but `noses` can be used instead.

    These are the noses near the places that earlier clips predict. Where too few of them are visible, the failure is
    raised.
    """
    try:
        return locate_table(image, name)
    except TableNotFound:
        if noses is None or sum(noses.is_visible) < MIN_EXPECTED_NOSES:
            raise
        return None


def _add_note(location: TableLocation, why: str) -> TableLocation:
    return replace(location, notes=(*location.notes, f"{PROFILE_NOTE} {why}"))


def _estimate_motion(
    clip: Clip, images: list[ImageArray], swaying: list[ImageArray], location: TableLocation
) -> tuple[FloatArray | None, int]:
    """Return the camera motion (T, 3, 3), or None for a fixed camera, and the number of interpolated frames.

    Frames in which the image sways show a knock between those that are spread over the clip.
    """
    greys, swaying_greys = (
        [np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8) for image in some] for some in (images, swaying)
    )
    reference = select_reference_features(greys[0], location.corners)
    moves = detect_camera_motion(reference, greys[1:])
    if moves is None:
        raise TableNotFound(
            f"{clip.path.name} does not show one view of the table throughout (a cut, a zoom or an occlusion); "
            "trim it to one shot from one camera"
        )
    if not moves and not detect_camera_motion(reference, swaying_greys):
        return None, 0
    if not location.is_from_user:
        reference = select_reference_features(greys[0], locate_table(images[0], clip.path.name).corners)
    all_images = (image for _, image in read_frames(clip, indices=clip.frames, grey=True))
    motion, lost = estimate_camera_motion(reference, enumerate(all_images), clip.frame_count)
    if lost > MAX_LOST_SHARE * clip.frame_count:
        raise TableNotFound(
            f"{clip.path.name} was filmed by a moving camera, whose motion could not be estimated in {lost} of "
            f"{clip.frame_count} frames; film from a fixed position, or trim it"
        )
    return motion, lost


def _warp_to_reference(image: ImageArray, motion: FloatArray) -> ImageArray:
    """Warp an image (H, W, 3) to the view of the reference camera."""
    height, width = image.shape[:2]
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpPerspective(image, motion, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


def _motion_notes(camera: Camera, motion: FloatArray | None, lost: int) -> tuple[str, ...]:
    if motion is None:
        return ()
    gaps = f"; {lost} frames were interpolated" if lost else ""
    shift = measure_shifts(camera.corners_px, motion)
    largest = f"by up to {shift.max():.1f} px" + (" for a moment" if np.median(shift) <= MAX_STILL_SHIFT_PX else "")
    return (f"{MOTION_NOTE} {largest}; its motion was estimated from the rails of the table{gaps}",)


def compute_median_image(images: list[ImageArray]) -> ImageArray:
    """Compute the median (H, W, 3) of images, which shows what stands still most of the time."""
    stack = np.stack(images)
    half = len(images) // 2
    return np.ascontiguousarray(np.partition(stack, half, axis=0)[half])


def _sample_frame_indices(clip: Clip) -> NDArray[np.int64]:
    positions = np.unique(np.linspace(0, len(clip.distinct_frames) - 1, SAMPLED_FRAMES).round().astype(int))
    return np.asarray(clip.distinct_frames[positions], np.int64)


def _select_swaying_frames(clip: Clip) -> NDArray[np.int64]:
    """Return the frames in which the image as a whole seems to move most."""
    sway = np.where(np.isin(clip.frames, clip.distinct_frames), clip.sway, 0.0) if len(clip.sway) else np.zeros(0)
    liveliest = np.argsort(-sway, kind="stable")[:SWAYING_FRAMES]
    return np.sort(clip.frames[liveliest[sway[liveliest] * clip.width > MAX_STILL_SHIFT_PX]])


def locate_table(image: ImageArray, name: str = "the image") -> TableLocation:
    """Locate the cushion noses of the table in an image.

    Args:
        image: (H, W, 3) RGB.
        name: name of the image in messages.

    Returns:
        The corners with covariance and perspective.

    Raises:
        TableNotFound: no table can be trusted; the message starts with `name`.
    """
    attempts = _list_attempts(image, is_cropped=False)
    if not attempts or attempts[0].misfit > MAX_MISFIT:
        # Where the image ends at the cloth, no rail tells the cloth from another surface: all four noses must.
        cropped = _list_attempts(image, is_cropped=True)
        attempts = (
            [one for one in cropped if one.noses is not None and all(one.noses.is_visible)] or attempts or cropped
        )
    best = attempts[0] if attempts else None
    if best is None or best.noses is None or best.misfit > MAX_MISFIT:
        raise TableNotFound(f"{name} {_explain_attempt(best)}", remedy="corners")
    noses, (height, width) = best.noses, image.shape[:2]
    corners, perspective = orient_corners(noses.corners, width, height, _mean_sigma(noses.covariance))
    if not ASPECT_RANGE[0] < perspective.aspect < ASPECT_RANGE[1]:
        shape = f"shows a cloth {perspective.aspect:.2f} times as long as wide, and tables are 2"
        raise TableNotFound(f"{name} {_explain_attempt(best) if best.is_cropped else shape}", remedy="corners")
    along, across = count_painted_lines(image, corners)
    if min(along, across) >= MIN_COURT_LINES:
        raise TableNotFound(
            f"{name} shows a court without cushions, with {along + across} painted lines; film a billiard table"
        )
    shifts = [-int(np.argmin(np.linalg.norm(one - corners[0], axis=1))) for one in (noses.corners, best.outer)]
    order = np.roll(np.arange(8).reshape(4, 2), shifts[0], axis=0).ravel()
    outer = np.roll(best.outer, shifts[1], axis=0)
    return TableLocation(
        corners, noses.covariance[np.ix_(order, order)], perspective, best.region.colour, outer, _edge_notes(noses),
        sum(noses.is_visible),
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Attempt:
    """Cushion noses in one region of cloth."""

    misfit: float
    """Squared standard deviations from four equal cushions and straight sides; infinite without noses."""
    outer: FloatArray
    """(4, 2) px, outer corners of the cloth."""
    noses: CushionNoses | None
    region: ClothRegion
    is_cropped: bool
    """Whether the border of the image counts as a side of the cloth."""


def _list_attempts(image: ImageArray, is_cropped: bool) -> list[_Attempt]:
    """Find the noses in the regions that may be a cloth, the best first."""
    height, width = image.shape[:2]
    attempts: list[_Attempt] = []
    for region in find_cloth_regions(image, is_cropped=is_cropped):
        if region.support <= MIN_SIDE_SUPPORT:
            continue
        outer, _ = orient_corners(region.corners, width, height, 3.0)
        noses = find_cushion_noses(image, outer)
        misfit = np.inf if noses is None else noses.misfit + UNSUPPORTED_COST * (1 - region.support)
        attempts.append(_Attempt(misfit, outer, noses, region, is_cropped))
        if misfit < GOOD_MISFIT:
            break
    return sorted(attempts, key=lambda one: one.misfit)


def _explain_attempt(attempt: _Attempt | None) -> str:
    """Say what was seen instead of a table, and what to do."""
    if attempt is None:
        return "shows no cloth with four straight sides; film the whole table from above"
    if attempt.is_cropped:
        return (
            "is filled by one surface up to its border, not by a table with four cushions in view; film from further"
            " away"
        )
    if attempt.noses is None:
        return "shows a cloth without visible cushion noses"
    return "shows a cloth whose sides do not look like four equal cushions"


def _mean_sigma(covariance: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.diag(covariance))))


def _edge_notes(noses: CushionNoses) -> tuple[str, ...]:
    notes = [f"table found by its cloth; corner uncertainty {_mean_sigma(noses.covariance):.1f} px"]
    hidden = 4 - sum(noses.is_visible)
    if hidden:
        notes.append(f"{hidden} of 4 cushion noses could not be detected and were inferred from the others")
    if noses.straightness > 1:
        notes.append(f"cushion noses bend by up to {noses.straightness:.1f} px: lens distortion is not modelled")
    return tuple(notes)


def _locate_from_option(option: str, background: ImageArray, stored_scale: tuple[float, float]) -> TableLocation:
    """Locate the table by corners in the upright image, or in the stored one where these are nearer to 2 : 1."""
    height, width = background.shape[:2]
    shown = parse_corners(option, width, height)
    stored = (shown + 0.5) / stored_scale - 0.5
    fits = [orient_corners(each, width, height, USER_CORNER_SIGMA_PX) for each in (shown, stored)]
    corners, perspective = min(fits, key=lambda fit: abs(np.log(fit[1].aspect / 2)))
    source = "corners were given by the user"
    if perspective is not fits[0][1]:
        source += ", in pixels of the stored image, which are not square"
    if not 1.5 < perspective.aspect < 2.6:
        raise OptionError(
            f"must be those of a table about twice as long as wide; these are {perspective.aspect:.2f} times; of a"
            " court, name its --sport, too",
            option="corners", remedy="pixels",
        )  # fmt: skip
    return TableLocation(
        corners,
        np.eye(8) * USER_CORNER_SIGMA_PX**2,
        perspective,
        measure_median_colour(background, corners),
        None,
        (source,),
        is_from_user=True,
        automatic=_locate_same_table(background, corners),
    )


def _locate_same_table(image: ImageArray, corners: FloatArray) -> TableLocation | None:
    """Locate the table of given corners (4, 2) without them; None where that fails or finds another table."""
    try:
        location = locate_table(image)
    except TableNotFound:
        return None
    given, measured = (np.asarray(one, np.float32) for one in (corners, location.corners))
    common, _ = cv2.intersectConvexConvex(given, measured)
    united = cv2.contourArea(given) + cv2.contourArea(measured) - common
    return location if common > SAME_TABLE_OVERLAP * united else None


def _warn_of_corners(location: TableLocation, image: ImageArray) -> tuple[str, ...]:
    """Warn where corners of the user contradict noses that are visible on all sides; empty where they do not.

    A clear line near each given side speaks for the user: the noses may be another line beside it.
    """
    automatic = location.automatic
    if automatic is None or automatic.visible_count < 4:
        return ()
    nearest = np.argmin(np.linalg.norm(location.corners[:, None] - automatic.corners, axis=2), axis=1)
    difference = location.corners - automatic.corners[nearest]
    order = (2 * nearest[:, None] + np.arange(2)).ravel()
    covariance = location.covariance + automatic.covariance[np.ix_(order, order)]
    blocks = np.stack([covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(4)])
    sigmas = np.sqrt(np.einsum("ki,kij,kj->k", difference, np.linalg.inv(blocks), difference))
    near = find_noses_near(image, location.corners, location.covariance)
    if sigmas.max() <= CORNER_CONTRADICTION_SIGMAS or (near is not None and all(near.is_visible)):
        return ()
    k = int(np.argmax(sigmas))
    x, y = location.corners[k]
    shift = float(np.linalg.norm(difference[k]))
    return (
        f"The given corner at {x:.0f}, {y:.0f} px is {shift:.0f} px from where the visible cushion noses meet:"
        " check the corners of the table.",
    )


def parse_corners(text: str, width: int, height: int) -> FloatArray:
    """Parse the option --corners.

    Args:
        text: eight numbers x,y,x,y,x,y,x,y in px; the corners may come in any order.
        width: width of the image, px.
        height: height of the image, px.

    Returns:
        Corners (4, 2) px, clockwise in the image.

    Raises:
        OptionError: the numbers are not the corners of a convex quadrangle in or near the image.
    """
    try:
        numbers = [float(number) for number in text.replace(";", ",").replace(" ", ",").split(",") if number]
    except ValueError:
        numbers = []
    if len(numbers) != 8 or not np.all(np.isfinite(numbers)):
        raise OptionError(f"are eight numbers x,y,x,y,x,y,x,y in px; got {text!r}", option="corners")
    points = np.array(numbers).reshape(4, 2)
    margin = 0.5 * np.array([width, height])
    if np.any(points < -margin) or np.any(points > np.array([width, height]) + margin):
        raise OptionError(f"must lie in or near the image of {width} x {height} px; got {text!r}", option="corners")
    offset = points - points.mean(axis=0)
    ordered = points[np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))]
    edges = np.roll(ordered, -1, axis=0) - ordered
    following = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    # Check the turns first: coincident corners have no line through them.
    if np.any(turns < 1.0) or intersect_lines(list(map(line_through, ordered, np.roll(ordered, -1, axis=0)))) is None:
        raise OptionError(f"must be the four corners of a convex quadrangle; got {text!r}", option="corners")
    return ordered


def _build_scene(
    location: TableLocation,
    background: ImageArray,
    images: list[ImageArray],
    options: CalibrateOptions,
    requested: Table | None,
    prior: ViewPrior | None = None,
) -> Scene:
    """Identify table and ball size, and build the camera.

    Args:
        background: the image, or what stands still in the clip.
        images: images in which balls are measured.
        options: ball radius if the user gave it.
        requested: table if the user gave it.
        prior: table of earlier clips.
    """
    height, width = background.shape[:2]
    corners, covariance, perspective = location.corners, location.covariance, location.perspective
    build = partial(build_camera, corners, covariance, perspective=perspective, width_px=width, height_px=height)
    if requested is None and prior is not None:
        requested = prior.table
    trial = TABLE_PRESETS["pool-9ft"] if requested is None else requested
    sizes = measure_ball_sizes(images, background, build(trial), trial)
    warnings: tuple[str, ...] = ()
    scale_sigma = 0.0
    if requested is not None:
        table, notes = requested, ("table size was given by the user",)
        nominal = estimate_preset_ball_size(table)
        if options.table is None and prior is not None:
            notes, nominal = ("table and ball size are those of the profile",), prior.ball_size
    else:
        own, pockets = location.automatic or location, None  # unknown where the outer edge of the cloth is not located
        if own.outer_corners is not None:
            share = measure_pocket_share(background, own.outer_corners, own.corners, own.cloth_colour)
            pockets = share > MIN_POCKET_SHARE
        classification = classify_table(sizes, pockets, has_snooker_d(background, own.corners))
        table, warnings, scale_sigma = classification.table, classification.warnings, classification.scale_sigma
        notes, nominal = (classification.note,), classification.estimate_ball_size()
        aspect = perspective.aspect
        if abs(aspect / (table.length / table.width) - 1) > UNUSUAL_ASPECT_SHARE:
            table = replace(table, width=table.length / aspect)
            warnings += (
                f"The table is {aspect:.2f} times as long as wide, where most are 2: so are some home tables, or any"
                " where pixels are not square. State its length and width in m.",
            )
    if options.ball_radius is not None:
        table = replace_ball_radius(table, options.ball_radius)
        nominal = estimate_typed_ball_size(options.ball_radius)
    apparent = sizes.estimate_ball_size(table)
    estimates = (nominal,) if apparent is None else (nominal, apparent)
    warnings += _warn_of_corners(location, background)
    warnings += tuple(format_contradiction(*pair, table.name) for pair in find_contradictions(estimates))
    radius = combine_ball_sizes(estimates).radius
    if radius != table.ball_radius:
        table = replace_ball_radius(table, radius)
    camera = replace(build(table), scale_sigma=scale_sigma)
    notes_of_all = (*location.notes, *notes, *warnings, _height_note(camera, perspective))
    return Scene(table, camera, _convert_rgb_to_lab(location.cloth_colour), notes_of_all, warnings, estimates)


def _height_note(camera: Camera, perspective: PerspectiveFit) -> str:
    source = (
        "from the perspective" if perspective.focal_sigma < 0.15 else "assumed, not identifiable from the perspective"
    )
    return f"camera {camera.height:.2f} ± {camera.height_sigma:.2f} m above the table ({source})"


def _convert_rgb_to_lab(rgb: FloatArray) -> FloatArray:
    pixel = (rgb / 255).astype(np.float32).reshape(1, 1, 3)
    lab: FloatArray = cv2.cvtColor(pixel, cv2.COLOR_RGB2LAB)[0, 0].astype(np.float64)
    return lab
