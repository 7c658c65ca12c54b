"""Where the balls of a shot lay, and what is missing in the present image to have them there again."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from models.core.detections import Detections
from models.core.errors import OptionError, TableNotFound
from models.core.naming import Naming
from models.core.scene import Camera, Scene, Table
from models.core.typing import FloatArray, ImageArray
from models.estimation.ball_places import BallPlaces, locate_balls, match_places, select_moment_before_strike
from models.estimation.contact_test.shot_record import ShotRecord
from pipeline.actions.answer_call import estimate_drift, open_run_clip
from video.calibration.camera_model import build_camera, estimate_place_sigma
from video.calibration.camera_motion import (
    MAX_STILL_SHIFT_PX,
    MIN_INLIER_SHARE,
    ReferenceFeatures,
    register_image,
    select_reference_features,
    shift_camera,
    warp_camera,
)
from video.calibration.table_finder import locate_table
from video.io.clip import read_frames

if TYPE_CHECKING:
    from detectors.detect import BallDetector

# m, distance up to which a ball counts as put back. Centres in single images are accurate to about 1 mm
# (`benchmarks/detection/put_back_accuracy.py`), so a smaller distance cannot be told from none.
PLACED_M = 2e-3
# Standard deviations by which a located corner differs from the calibrated one if the camera moved.
CORNER_SIGMAS = 3.0
# Images of a camera after which the empty cloth is learnt anew, because the light changes: less than a minute.
CLOTH_IMAGES = 100
# Largest relative difference of the aspect ratios of two images of one camera.
SAME_ASPECT = 0.01


@dataclass(frozen=True, slots=True)
class WantedPlaces:
    """Places of the balls of a shot at one time, and how they were filmed."""

    places: BallPlaces
    place_sigma: FloatArray
    """(N, 2) m, of x and y relative to the noses, calibration included."""
    table: Table
    naming: Naming
    camera: Camera | None
    """The camera at that time; None for a folder without calibration."""
    frame: float
    """Number of the frame of that time; just before a strike, of the last one before it."""
    image: ImageArray | None = None
    """(H, W, 3) that frame of the clip; None if it was not or cannot be read."""
    no_image: str = ""
    """Why it cannot be read; else empty."""
    stored_scale: tuple[float, float] = (1.0, 1.0)
    """Pixels of the clip's file per pixel of the image, along x and y."""


def locate_wanted_places(record: ShotRecord, at: float | None) -> WantedPlaces:
    """Locate the balls of a shot at one time.

    Args:
        record: The shot.
        at: Time, s; None for just before the strike.

    Returns:
        The places, without the frame of the clip.

    Raises:
        OptionError: The time is outside the shot.
    """
    first, last = float(record.shown[0]), float(record.shown[-1])
    if at is not None and not first <= at <= last:
        raise OptionError(f"lies within the shot, {first:.3f} to {last:.3f} s; got {at:g}", option="at")
    t = select_moment_before_strike(record) if at is None else at
    places = locate_balls(record, t)
    allowed = (record.shown <= t + 1e-9) | (at is not None)  # at the strike, the nearest frame may show it already
    nearest = int(np.argmin(np.where(allowed, np.abs(record.shown - t), np.inf)))
    camera, sigma = record.camera, np.repeat(places.sigma[:, None], 2, axis=1)
    if camera is not None:
        sigma = np.hypot(sigma, estimate_place_sigma(camera, record.table, places.xy))
        camera = shift_camera(camera, estimate_drift(record, camera, float(record.shown[nearest])))
    why_not = "the folder has no calibration" if camera is None else ""
    return WantedPlaces(
        places, sigma, record.table, record.naming, camera, float(record.frame[nearest]), no_image=why_not
    )


def read_wanted_frame(wanted: WantedPlaces, folder: Path, clip: Path | None) -> WantedPlaces:
    """Read the frame of the wanted places.

    Args:
        folder: Run folder of the shot.
        clip: Video of the shot; None for the one that the run noted.

    Returns:
        The places with the frame, or with the reason why it cannot be read.

    Raises:
        TruerollError: The given clip cannot be read.
    """
    if wanted.camera is None:
        return wanted
    footage, why_not = open_run_clip(folder, clip)
    if footage is None:
        return replace(wanted, no_image=why_not)
    ((_, image),) = read_frames(footage, indices=[int(wanted.frame)])
    return replace(wanted, image=image, stored_scale=footage.stored_scale)


@dataclass(frozen=True, slots=True)
class PlacementState:
    """The present balls beside N wanted places."""

    image: ImageArray
    """(H, W, 3) the present image, at the size of the calibration."""
    camera: Camera
    """Camera of the present image."""
    shift_px: float
    """px, motion of the table's edges since the calibration; 0 if the camera stands still."""
    note: str
    """Sentence about the camera; empty if it stands still."""
    present: FloatArray
    """(N, 2) m, where each ball lies; NaN if it was not found."""
    extra: tuple[str, ...]
    """Kinds of the present balls without a wanted place."""

    def list_missing_moves(self, places: BallPlaces) -> FloatArray:
        """List the moves (N, 2), m, that bring each ball to its place; NaN for a ball that was not found."""
        return np.asarray(places.xy - self.present)


@dataclass(slots=True)
class PlacementGuide:
    """Compares present images with wanted places; the first image takes longer, because models are loaded."""

    wanted: WantedPlaces
    camera: Camera
    cloth_lab: FloatArray
    reference: ReferenceFeatures | None
    """The table's edges in the clip."""
    colours: FloatArray
    """(N, 3) CIE L*a*b* of the wanted balls; NaN if unknown."""
    detector: BallDetector | None = field(default=None, init=False)
    """Detector of the present light; None before the first image, and after a motion of the camera."""
    image_count: int = field(default=0, init=False)

    @classmethod
    def prepare(cls, wanted: WantedPlaces, cloth_lab: FloatArray) -> PlacementGuide:
        """Prepare for present images: load the models, and measure edges and colours in the frame of the clip.

        Args:
            wanted: The wanted places.
            cloth_lab: Colour (3,) of the cloth, CIE L*a*b*.

        Returns:
            The guide.

        Raises:
            OptionError: The folder has no calibration.
        """
        if wanted.camera is None:
            raise OptionError("--live needs the calibration of the camera; this folder has none: run the clip again")
        camera = wanted.camera
        colours = np.full((len(wanted.places.ids), 3), np.nan)
        guide = cls(wanted, camera, cloth_lab, None, colours)
        image = wanted.image
        if image is None:  # load the models all the same
            guide._detect(np.zeros((camera.height_px, camera.width_px, 3), np.uint8), camera)
        else:
            grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
            guide.reference = select_reference_features(grey, camera.corners_px)
            guide.colours = _match_colours(guide._detect(image, camera), camera, wanted)
        guide.detector = None  # its light is that of the clip
        return guide

    def compare_image(self, image: ImageArray) -> PlacementState:
        """Find the balls of a present image, and match them with the wanted places.

        Args:
            image: (H, W, 3) RGB of the same camera.

        Returns:
            The state.

        Raises:
            OptionError: The image is of another shape.
            TableNotFound: The camera moved, and the table is not found again.
        """
        from detectors.still_images import classify_detections  # slow to import

        image = self._fit_size(image)
        camera, shift, note = self._check_camera(image)
        places, table = self.wanted.places, self.wanted.table
        balls = self._detect(image, camera)
        xy = camera.to_table(balls.centre, table.ball_radius)
        kinds = classify_detections(balls, table.game)
        matches = match_places(
            (places.kinds, places.xy, self.colours), (kinds, xy, balls.colour), 2 * table.ball_radius
        )
        present = np.full_like(places.xy, np.nan)
        present[matches.wanted] = xy[matches.present]
        extra = tuple(kind for k, kind in enumerate(kinds) if k not in set(matches.present.tolist()))
        return PlacementState(image, camera, shift, note, present, extra)

    def _detect(self, image: ImageArray, camera: Camera) -> Detections:
        """Detect the balls of a present image."""
        from detectors.detect import build_detector  # slow to import, and needed by --live alone
        from detectors.detect_options import DetectOptions

        is_still = camera is self.camera
        if self.detector is None or not is_still or self.image_count % CLOTH_IMAGES == 0:
            scene = Scene(self.wanted.table, camera, self.cloth_lab, ())
            self.detector = build_detector(scene, [(0, image)], DetectOptions(), is_still=True)
        balls = self.detector.detect(image)
        self.detector = self.detector if is_still else None
        self.image_count += 1
        return balls

    def _fit_size(self, image: ImageArray) -> ImageArray:
        """Return the image at the size of the calibration; its pixels are square, or those of the clip's file."""
        height, width = image.shape[:2]
        wanted = (self.camera.width_px, self.camera.height_px)
        if (width, height) == wanted:
            return image
        shape, scale = width / height / (wanted[0] / wanted[1]), self.wanted.stored_scale
        if min(abs(shape - 1), abs(shape * scale[1] / scale[0] - 1)) > SAME_ASPECT:
            raise OptionError(
                f"--live needs images of the camera of the clip, {wanted[0]} x {wanted[1]} px;"
                f" got {width} x {height} px"
            )
        return np.asarray(cv2.resize(image, wanted, interpolation=cv2.INTER_AREA), np.uint8)

    def _check_camera(self, image: ImageArray) -> tuple[Camera, float, str]:
        """Return the camera of an image, the motion of the table's edges (px), and a sentence if it moved."""
        camera = self.camera
        grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
        aligned = None if self.reference is None else register_image(self.reference, grey)
        if aligned is not None and aligned.share > MIN_INLIER_SHARE:
            if aligned.shift <= MAX_STILL_SHIFT_PX:
                return camera, 0.0, ""
            note = (
                f"The camera has moved: the edges of the table are {aligned.shift:.1f} px away; calibrated again by"
                " them"
            )
            return warp_camera(camera, aligned.homography), aligned.shift, note
        return self._locate_again(image)

    def _locate_again(self, image: ImageArray) -> tuple[Camera, float, str]:
        """Locate the table anew where its edges are not recognised."""
        camera, table = self.camera, self.wanted.table
        try:
            location = locate_table(image, "the present image")
        except TableNotFound as error:
            raise TableNotFound(f"The camera has moved or is covered: {error}") from error
        gap = location.corners - camera.corners_px
        sigma = np.sqrt(np.diag(camera.corner_covariance) + np.diag(location.covariance)).reshape(4, 2)
        if np.all(np.abs(gap) <= CORNER_SIGMAS * sigma):
            return camera, 0.0, ""
        shift = float(np.median(np.linalg.norm(gap, axis=1)))
        moved = build_camera(
            location.corners, location.covariance, table, location.perspective, camera.width_px, camera.height_px
        )
        sigma_of_middle = estimate_place_sigma(moved, table, np.array([[table.length / 2, table.width / 2]]))
        note = (
            f"The camera has moved: the corners of the table are {shift:.0f} px away; calibrated anew, to"
            f" {1e3 * np.hypot(*sigma_of_middle[0]):.1f} mm"
        )
        return moved, shift, note


def _match_colours(balls: Detections, camera: Camera, wanted: WantedPlaces) -> FloatArray:
    """Return the colours (N, 3) of the wanted balls by the detections at their places; NaN where there is none."""
    places, radius = wanted.places, wanted.table.ball_radius
    colours = np.full((len(places.ids), 3), np.nan)
    if not len(balls):
        return colours
    distance = np.linalg.norm(places.xy[:, None] - camera.to_table(balls.centre, radius)[None], axis=2)
    nearest = distance.argmin(axis=1)
    is_near = distance[np.arange(len(nearest)), nearest] < radius
    colours[is_near] = balls.colour[nearest[is_near]]
    return colours
