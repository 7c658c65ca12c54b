"""The court in a clip and the camera that looks at it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.court import Sport
from models.core.court_camera import CourtCamera, CourtScene
from models.core.errors import ClipError, OptionError
from models.core.progress import Progress
from models.core.typing import ByteArray, FloatArray, ImageArray
from models.sports.sport_catalogue import find_sports
from video.calibration.court_camera_fit import REFERENCE_WIDTH_PX, CourtFit, build_court_camera, fit_court_camera
from video.calibration.court_hypotheses import propose_courts
from video.calibration.court_lines import SEARCH_SIDE_PX, convert_to_brightness
from video.calibration.court_motion import estimate_court_motion, stands_still
from video.io.clip import Clip, read_frames

# Frames spread over the clip, whose median shows a court without players.
SAMPLED_FRAMES = 15
# Proposals of each sport that are fitted.
FITTED_PROPOSALS = 5
# px of seen line that one px of missing line outweighs in a fit.
MISS_COST = 2.0
# Least share of the lines' length that is seen, and of a line or of the net that counts as seen: players, posts and the
# net hide some, the rest of a wrong court lies where no paint is.
MIN_SHARE, MIN_LINE_SHARE, MIN_NET_SHARE = 0.6, 0.35, 0.35
# Least number of lines, the net included, that show a court; a table has four wide ones and its net.
MIN_SEEN_LINES = 6
# px in an image of `REFERENCE_WIDTH_PX`: lines of a right court agree better.
MAX_LINE_ERROR_PX = 1.2
# m, height of the camera above the floor, and its distance from the court's middle in lengths of the court.
HEIGHT_RANGE, MAX_DISTANCE = (0.3, 60.0), 8.0
# px, standard deviation of corners given by the user.
USER_CORNER_SIGMA_PX = 2.0
GIVE_COURT_CORNERS = "film it with its lines in view, or give the corners of the court with --corners x,y,x,y,x,y,x,y"


@dataclass(frozen=True, slots=True)
class LocatedCourt:
    """A court in an image."""

    sport: Sport
    fit: CourtFit


def locate_court(clip: Clip, sport: str | None, corners: str | None, progress: Progress) -> CourtScene:
    """Find the court in a clip, and the place, direction, focal length and lens of the camera with their covariance.

    Args:
        clip: a clip of one view.
        sport: name of the sport; None to find it by its lines.
        corners: eight numbers x,y,x,y,x,y,x,y, px: the outer corners of the court in any order, instead of a search.
        progress: is called with the share of the work done, 0 to 1.

    Returns:
        The court with a camera, which carries its motion where it turns or zooms.

    Raises:
        ClipError: no known court is seen.
        OptionError: the sport is unknown, or the corners are not those of a court.
    """
    sports = _choose_sports(sport)
    frames = _sample_frames(clip)
    images = [_to_grey(image) for _, image in read_frames(clip, indices=frames)]
    progress(0.4)
    is_still = stands_still(images)
    notes: tuple[str, ...] = ()
    reference, image = 0, _compute_median(images) if is_still else images[0]
    located = _locate(image, sports, corners)
    if located is None and not is_still and corners is None:
        # Players may hide lines in one image, or the camera shows the court only later.
        for reference in range(len(images) // 2, len(images), len(images) // 3 or 1):
            located = _locate(images[reference], sports, None)
            if located is not None:
                break
    if located is None:
        known = f"no {sport} court" if sport is not None else f"no court of a known sport ({', '.join(find_sports())})"
        raise ClipError(f"{clip.path.name} shows {known}; {GIVE_COURT_CORNERS}")
    progress(0.6)
    camera, error = replace(located.fit.camera, first_frame=clip.first_frame), located.fit.line_error
    if not is_still:
        camera, error, notes = _follow_camera(clip, located, int(frames[reference]))
    progress(1.0)
    return CourtScene(located.sport, camera, error, notes)


def find_court(image: ImageArray, sports: Sequence[Sport] | None = None) -> LocatedCourt | None:
    """Find a court in an image (H, W, 3) RGB; None where none of the sports fits: a quick decision about a clip."""
    return _locate(_to_grey(image), list(find_sports().values()) if sports is None else sports, None)


def _follow_camera(clip: Clip, located: LocatedCourt, reference: int) -> tuple[CourtCamera, float, tuple[str, ...]]:
    """Add its motion to a camera that moves; also the error of the lines over the clip, px, and notes."""
    camera = located.fit.camera
    images = ((n - clip.first_frame, _to_grey(image)) for n, image in read_frames(clip, indices=clip.frames))
    motion, is_measured, errors = estimate_court_motion(
        located.sport, camera, reference - clip.first_frame, images, clip.frame_count
    )
    lost = int((~is_measured).sum())
    error = float(np.sqrt(np.nanmean(errors**2))) if np.isfinite(errors).any() else located.fit.line_error
    notes = ("camera-moves", *(("camera-motion-interpolated",) if lost else ()))
    return replace(camera, motion=motion, first_frame=clip.first_frame), error, notes


def _choose_sports(name: str | None) -> list[Sport]:
    sports = find_sports()
    if name is None:
        return list(sports.values())
    if name not in sports:
        raise OptionError(f"--sport is one of {', '.join(sports)}; got {name!r}")
    return [sports[name]]


def _sample_frames(clip: Clip) -> NDArray[np.int64]:
    places = np.unique(np.linspace(0, len(clip.distinct_frames) - 1, SAMPLED_FRAMES).round().astype(int))
    return np.asarray(clip.distinct_frames[places], np.int64)


def _to_grey(image: ImageArray) -> ByteArray:
    return np.asarray(np.rint(convert_to_brightness(image)), np.uint8)


def _compute_median(images: list[ByteArray]) -> ByteArray:
    half = len(images) // 2
    return np.ascontiguousarray(np.partition(np.stack(images), half, axis=0)[half])


def _locate(image: ByteArray, sports: Sequence[Sport], corners: str | None) -> LocatedCourt | None:
    """Locate the court that fits an image (H, W) best; None where none fits."""
    height, width = image.shape
    brightness = image.astype(np.float32)
    if corners is not None:
        return _locate_by_corners(brightness, sports, corners)
    scale = min(1.0, SEARCH_SIDE_PX / max(height, width))
    small = brightness
    if scale < 1:
        small = np.asarray(cv2.resize(brightness, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    enlarge = np.array([[1 / scale, 0, 0.5 / scale - 0.5], [0, 1 / scale, 0.5 / scale - 0.5], [0, 0, 1]])
    best, best_evidence = None, 0.0
    for proposal in propose_courts(small, sports, FITTED_PROPOSALS):
        if scale * best_evidence > proposal.seen_px:
            continue
        camera = build_court_camera(enlarge @ proposal.homography, proposal.sport, width, height)
        fit = fit_court_camera(brightness, proposal.sport, camera)
        evidence = _weigh(fit)
        if evidence > best_evidence and _is_court(proposal.sport, fit):
            best, best_evidence = LocatedCourt(proposal.sport, fit), evidence
    return best


def _weigh(fit: CourtFit) -> float:
    """Weigh a fit by px of lines that are seen, less those that should be and are not."""
    missing = fit.seen_px * (1 / fit.share - 1) if fit.share > 0 else np.inf
    return fit.seen_px - MISS_COST * missing


def _is_court(sport: Sport, fit: CourtFit) -> bool:
    """Judge whether a fit shows a court, not a few lines that happen to agree."""
    camera = fit.camera
    height = camera.centre[2] - sport.floor
    middle = np.array([sport.length / 2, sport.width / 2, 0])
    is_possible = (
        HEIGHT_RANGE[0] < height < HEIGHT_RANGE[1]
        and np.linalg.norm(camera.centre - middle) < MAX_DISTANCE * sport.length
    )
    widest = max(line.width for line in sport.lines)
    is_wide = np.array([line.width > widest / 3 for line in sport.lines])
    seen = int((fit.line_shares[is_wide] > MIN_LINE_SHARE).sum()) + int(fit.net_share > MIN_NET_SHARE)
    scale = max(1.0, camera.width_px / REFERENCE_WIDTH_PX)
    return bool(
        is_possible
        and fit.share > MIN_SHARE
        and seen >= min(MIN_SEEN_LINES, int(is_wide.sum()) + 1)
        and fit.line_error < MAX_LINE_ERROR_PX * scale
    )


def _locate_by_corners(
    brightness: NDArray[np.float32], sports: Sequence[Sport], corners: str
) -> LocatedCourt | None:
    """Locate the court by corners of the user; lines and net, where they are seen, refine it."""
    from video.calibration.table_finder import parse_corners  # takes half a second to import

    height, width = brightness.shape
    given = parse_corners(corners, width, height)
    fits: list[LocatedCourt] = []
    for sport in sports:
        for shift in (0, 1):
            homography = cv2.findHomography(sport.corners, np.roll(given, shift, axis=0))[0]
            camera = build_court_camera(np.asarray(homography, np.float64), sport, width, height)
            fit = fit_court_camera(brightness, sport, camera)
            fits.append(LocatedCourt(sport, fit))
    best = max(fits, key=lambda one: _weigh(one.fit))
    return best
