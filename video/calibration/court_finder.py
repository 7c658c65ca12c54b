"""The court in a clip and the camera that looks at it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.court import Sport
from models.core.court_camera import CourtCamera, CourtScene
from models.core.errors import ClipError, OptionError
from models.core.progress import Progress
from models.core.scene import apply_homography
from models.core.typing import ByteArray, FloatArray, ImageArray
from models.sports.sport_catalogue import find_sports
from video.calibration.court_camera_fit import (
    REFERENCE_WIDTH_PX,
    CourtFit,
    build_court_camera,
    fit_court_camera,
    fit_to_corners,
)
from video.calibration.court_hypotheses import propose_courts
from video.calibration.court_lines import SEARCH_SIDE_PX, convert_to_brightness
from video.calibration.court_motion import (
    combine_places,
    compute_motion,
    estimate_court_motion,
    stands_still,
    turn_camera,
)
from video.io.clip import Clip, read_frames

# Frames spread over the clip, whose median shows a court without players.
SAMPLED_FRAMES = 15
# Proposals of each sport that are fitted.
FITTED_PROPOSALS = 5
# px by which the corners of a proposal may be wrong.
PROPOSED_CORNER_SIGMA_PX = 1.5
# px of seen line that one px of missing line outweighs in a fit.
MISS_COST = 2.0
# Least share of the lines' length that is seen, and of a line or of the net that counts as seen: players, posts and the
# net hide some, the rest of a wrong court lies where no paint is.
MIN_SHARE, MIN_LINE_SHARE, MIN_NET_SHARE = 0.6, 0.35, 0.35
# The same share where no net is seen: a court with some lines elsewhere keeps three quarters.
MIN_SHARE_WITHOUT_NET = 0.85
# Least number of lines, the net included, that show a court (a table has four wide ones and its net), and least part of
# those inside the image: the lines across of another court may coincide with half of them.
MIN_SEEN_LINES, MIN_SEEN_PART = 6, 0.7
# px in an image of `REFERENCE_WIDTH_PX`: lines of a right court agree better.
MAX_LINE_ERROR_PX = 1.2
# m, height of the camera above the floor, and its distance from the court's middle in lengths of the court.
HEIGHT_RANGE, MAX_DISTANCE = (0.3, 60.0), 8.0
# Further frames of a moving camera that measure its place, and the squared standardized difference of places, per
# number, of a camera that travels: one in a thousand that stand has more.
PLACE_FRAMES, MAX_PLACE_MISFIT = 6, 4.0
# px, standard deviation of corners given by the user, and px in an image of `REFERENCE_WIDTH_PX` from them up to which
# lines are those of their court; share of its lines that must be seen to be more exact than the user's eye.
USER_CORNER_SIGMA_PX, GIVEN_REACH_PX, MIN_GIVEN_SHARE = 2.0, 12.0, 0.4
# px in an image of `REFERENCE_WIDTH_PX` between lines of two courts that are one line; share of a court's lines that
# are those of another from which it is no court; number of places on a line that are compared.
SAME_LINE_PX, SAME_LINE_SHARE, LINE_PLACES = 5.0, 0.7, 400


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
        ClipError: no known court is seen, or the lines of the named sport are those of another.
        OptionError: the sport is unknown, or the corners are not those of a court.
    """
    sports = _choose_sports(sport)
    frames = _sample_frames(clip)
    images = [_to_grey(image) for _, image in read_frames(clip, indices=frames)]
    progress(0.4)
    is_still = stands_still(images)
    notes: tuple[str, ...] = ()
    reference, image = 0, _compute_median(images) if is_still else images[0]
    located = find_court(image, sports, corners)
    if located is None and not is_still and corners is None:
        # Players may hide lines in one image, or the camera shows the court only later.
        for reference in range(len(images) // 2, len(images), len(images) // 3 or 1):
            image = images[reference]
            located = find_court(image, sports)
            if located is not None:
                break
    if located is None:
        subject = (
            f"no {sport} court" if sport is not None else f"no court of a known sport ({', '.join(find_sports())})"
        )
        sentence = f"{clip.path.name} shows {subject}; film it with its lines in view"
        raise ClipError(sentence, remedy="court corners")
    if sport is not None and corners is None:
        larger = find_court(image, [one for one in find_sports().values() if one.name != sport])
        if larger is not None and _is_part(located, larger):
            raise ClipError(
                f"{clip.path.name} shows a court of {larger.sport.name}: the lines that would be those of {sport} are"
                f" its own; leave --sport out, or name {larger.sport.name}"
            )
    progress(0.6)
    camera, error = replace(located.fit.camera, first_frame=clip.first_frame), located.fit.line_error
    if not is_still:
        camera, error, notes = _follow_camera(clip, located, int(frames[reference]))
    progress(1.0)
    return CourtScene(located.sport, camera, error, notes)


def _follow_camera(clip: Clip, located: LocatedCourt, reference: int) -> tuple[CourtCamera, float, tuple[str, ...]]:
    """Add its motion to a camera that moves; also the error of the lines over the clip, px, and notes."""
    camera = located.fit.camera

    def read_images(first: int, stop: int) -> Iterator[tuple[int, ByteArray]]:
        indices = clip.frames[(clip.frames >= first + clip.first_frame) & (clip.frames < stop + clip.first_frame)]
        return ((n - clip.first_frame, image) for n, image in read_frames(clip, indices=indices, grey=True))

    turns, is_measured, errors = estimate_court_motion(
        located.sport, camera, reference - clip.first_frame, read_images, clip.frame_count
    )
    lost = int((~is_measured).sum())
    error = float(np.sqrt(np.nanmean(errors**2))) if np.isfinite(errors).any() else located.fit.line_error
    notes = ("camera-moves", *(("camera-motion-interpolated",) if lost else ()))
    measured = np.flatnonzero(is_measured & (clip.frames != reference))
    chosen = np.linspace(0, max(len(measured) - 1, 0), min(PLACE_FRAMES, len(measured))).round().astype(int)
    others = []
    for n, image in read_frames(clip, indices=clip.frames[measured[chosen]]):
        guess = turn_camera(camera, turns[n - clip.first_frame])
        fit = fit_court_camera(convert_to_brightness(image), located.sport, guess)
        if _is_court(located.sport, fit):
            others.append(fit.camera)
    motion = compute_motion(camera, turns)
    if others:
        camera, misfit = combine_places(camera, others)
        notes += ("camera-travels",) * (misfit > MAX_PLACE_MISFIT)
    return replace(camera, motion=motion, first_frame=clip.first_frame), error, notes


def _choose_sports(name: str | None) -> list[Sport]:
    sports = find_sports()
    if name is None:
        return list(sports.values())
    if name not in sports:
        raise OptionError(f"--sport is one of {', '.join(sports)}; got {name!r}")
    return [sports[name]]


def _sample_frames(clip: Clip) -> NDArray[np.int64]:
    if not len(clip.distinct_frames):
        raise ClipError(f"{clip.path.name} has no frame that can be used")
    last = len(clip.distinct_frames) - 1
    # Two frames at the end: one frame that differs may be misread, two show a camera that moves only there.
    places = np.unique([*np.linspace(0, last, SAMPLED_FRAMES).round().astype(int), max(last - 1, 0)])
    return np.asarray(clip.distinct_frames[places], np.int64)


def _to_grey(image: ImageArray) -> ByteArray:
    return np.asarray(np.rint(convert_to_brightness(image)), np.uint8)


def _compute_median(images: list[ByteArray]) -> ByteArray:
    half = len(images) // 2
    return np.ascontiguousarray(np.partition(np.stack(images), half, axis=0)[half])


def find_court(image: ByteArray, sports: Sequence[Sport], corners: str | None = None) -> LocatedCourt | None:
    """Find the court that fits the brightness of an image (H, W) best; None where none of the sports fits."""
    height, width = image.shape
    brightness = image.astype(np.float32)
    if corners is not None:
        return _locate_by_corners(brightness, sports, corners)
    scale = min(1.0, SEARCH_SIDE_PX / max(height, width))
    small = brightness
    if scale < 1:
        small = np.asarray(cv2.resize(brightness, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    enlarge = np.array([[1 / scale, 0, 0.5 / scale - 0.5], [0, 1 / scale, 0.5 / scale - 0.5], [0, 0, 1]])
    best, best_evidence = None, -np.inf
    for proposal in propose_courts(small, sports, FITTED_PROPOSALS):
        if scale * best_evidence > proposal.seen_px:
            continue
        homography = enlarge @ proposal.homography
        camera = build_court_camera(homography, proposal.sport, width, height)
        # lines that are some px off make no camera; the nearest one shows the corners where they are
        corners_px = apply_homography(homography, proposal.sport.corners)
        nearest = fit_to_corners(proposal.sport, camera, corners_px, PROPOSED_CORNER_SIGMA_PX).camera
        camera = nearest if np.isfinite(nearest.parameters).all() else camera
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
    shares = np.append(fit.line_shares[is_wide] / MIN_LINE_SHARE, fit.net_share / MIN_NET_SHARE)
    visible, possible = int((shares > 1).sum()), int(np.isfinite(shares).sum())
    scale = max(1.0, camera.width_px / REFERENCE_WIDTH_PX)
    return bool(
        is_possible
        and fit.share > (MIN_SHARE if shares[-1] > 1 else MIN_SHARE_WITHOUT_NET)
        and visible >= min(MIN_SEEN_LINES, len(shares))
        and visible >= MIN_SEEN_PART * possible
        and fit.line_error < MAX_LINE_ERROR_PX * scale
    )


def _is_part(court: LocatedCourt, other: LocatedCourt) -> bool:
    """Judge whether the lines of a court are some of the lines of another that explains more."""
    if _weigh(other.fit) <= _weigh(court.fit):
        return False
    (own, width), (theirs, _) = _project_lines(court), _project_lines(other)
    scale = max(1.0, court.fit.camera.width_px / REFERENCE_WIDTH_PX)
    gaps = np.linalg.norm(own[:, None] - theirs, axis=-1).min(axis=1)
    return bool(np.average(gaps < SAME_LINE_PX * scale, weights=width) > SAME_LINE_SHARE)


def _project_lines(court: LocatedCourt) -> tuple[FloatArray, FloatArray]:
    """Project places on the lines of a court that are inside the image: px (K, 2), and widths (K,) of the lines, m."""
    camera, share = court.fit.camera, np.linspace(0, 1, LINE_PLACES)[:, None]
    ends = np.array([(line.start, line.end) for line in court.sport.lines])
    xy = (ends[:, 0, None] + share * (ends[:, 1] - ends[:, 0])[:, None]).reshape(-1, 2)
    px = camera.to_pixels(np.column_stack([xy, np.zeros(len(xy))]))
    widths = np.repeat([line.width for line in court.sport.lines], LINE_PLACES)
    inside = np.all((px > 0) & (px < [camera.width_px, camera.height_px]), axis=1)
    return px[inside], widths[inside]


def _locate_by_corners(brightness: NDArray[np.float32], sports: Sequence[Sport], corners: str) -> LocatedCourt:
    """Locate the court by corners of the user; lines and net refine it where they are seen.

    Raises:
        OptionError: no lines are seen near the corners, and they leave open of which sport the court is.
    """
    from video.calibration.table_finder import parse_corners  # slow to import

    height, width = brightness.shape
    given = parse_corners(corners, width, height)
    reach = GIVEN_REACH_PX * max(1.0, width / REFERENCE_WIDTH_PX)
    fits, plain = [], []
    for sport in sports:
        for shift in (0, 1):
            homography = cv2.getPerspectiveTransform(
                sport.corners.astype(np.float32), np.roll(given, shift, axis=0).astype(np.float32)
            )
            camera = build_court_camera(homography, sport, width, height)
            fit = fit_court_camera(brightness, sport, camera)
            where = fit.camera.to_pixels(np.column_stack([sport.corners, np.zeros(4)]))
            gap = np.linalg.norm(where[:, None] - given, axis=-1).min(1).max()
            if fit.share > MIN_GIVEN_SHARE and gap < reach:
                fits.append(LocatedCourt(sport, fit))
            plain.append(LocatedCourt(sport, fit_to_corners(sport, camera, given, USER_CORNER_SIGMA_PX)))
    if fits:
        return max(fits, key=lambda one: _weigh(one.fit))
    if len(sports) > 1:
        raise OptionError("no lines of a known court are seen near --corners; state --sport too, or other corners")
    best = min(plain, key=lambda one: one.fit.line_error)
    if not best.fit.line_error < reach:
        raise OptionError(f"are not those of a {best.sport.name} court; give its four outer corners", option="corners")
    return best
