"""Second pass of the ball network on enlarged crops where balls crowd.

On the maps of a small image two balls that cover each other are one peak, and a ball beside another may have none. So
the network processes crops again, enlarged, where peaks are close together or where there is unexplained foreground
beside one.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from detectors.measurement.cloth_background import ClothBackground, build_disc_kernel
from detectors.measurement.frame_change import dilate_places, find_windows
from detectors.measurement.working_view import WorkingView, nearest_pixels, values_at
from detectors.network.ball_model import BallModel
from detectors.network.peak_decoding import CandidateDetections, concatenate_candidates
from models.core.typing import BoolArray, ByteArray

# Distance of two centres, radii, below which balls crowd: they touch, or one covers the other.
CROWDED_RADII = 2.4
# Least confidence score of a candidate that counts.
MIN_CROWDING_SCORE = 0.2
# Radius of a ball in an enlarged crop, within the range of the network, and largest enlargement over the first pass.
ENLARGED_RADIUS_PX, MAX_ENLARGEMENT = 10.5, 2.0
# Least enlargement of a second pass over the first. One at the same size is useful too: the balls are at other places
# of the network's grid, and without the rest of the image.
MIN_ENLARGEMENT = 0.9
# Distance from crowded balls, ball radii, within which the second pass replaces the first.
REPLACED_RADII = 1.3
# Distance from a ball, ball radii, up to which foreground may be another ball, and up to which it is explained by it.
SUSPECT_RADII, EXPLAINED_RADII = 2.0, 1.2
# Least difference from the cloth, over that of the detected balls, of another ball: most shadows differ less.
MIN_DIFFERENCE_SHARE = 0.35
# Least half width, ball radii, and area, in balls, of such foreground.
MIN_HALF_WIDTH_RADII, MIN_AREA_BALLS = 0.3, 0.2
# px of the enlarged crop around a part that the network receives with it.
CONTEXT_PX = 16


@dataclass(frozen=True, slots=True)
class SearchedFrame:
    """A frame that the network searched."""

    rgb: ByteArray
    """(H, W, 3) full image."""
    working_image: ByteArray
    """(h, w, 3) image of the first pass."""
    touched: BoolArray
    """(h, w) where the first pass searched."""
    frame: int


def run_second_pass(
    searched: SearchedFrame,
    view: WorkingView,
    cloth: ClothBackground,
    model: BallModel,
    candidates: CandidateDetections,
) -> CandidateDetections:
    """Replace the candidates, working px, at crowded places by those of a second pass on enlarged crops."""
    clear_candidates = candidates.take(
        (candidates.score > MIN_CROWDING_SCORE) & values_at(view.centre_area, candidates.centre)
    )
    again = _draw_discs(clear_candidates.take(_is_crowded(clear_candidates)), REPLACED_RADII, view)
    unexplained = _find_unexplained(searched, view, cloth, clear_candidates)
    if unexplained.any():
        again |= dilate_places(unexplained, view.median_radius)
    if not again.any():
        return candidates
    parts, covered = [], np.zeros_like(again)
    for part in find_windows(again, view):
        largest = MAX_ENLARGEMENT * view.enlargement
        factor = min(ENLARGED_RADIUS_PX / float(view.radius[part][again[part]].max()), largest)
        if factor >= MIN_ENLARGEMENT * view.enlargement:
            parts.append(_search_enlarged(searched, view, model, part, factor))
            covered[part] |= again[part]
    enlarged_candidates = concatenate_candidates(parts)
    return concatenate_candidates(
        [
            candidates.take(~values_at(covered, candidates.centre)),
            enlarged_candidates.take(values_at(covered, enlarged_candidates.centre)),
        ]
    )


def _is_crowded(candidates: CandidateDetections) -> BoolArray:
    """Which candidates (K,) have another so near that there may be more balls, or at other positions."""
    apart = np.linalg.norm(candidates.centre[:, None] - candidates.centre[None], axis=-1)
    near = apart < CROWDED_RADII * candidates.radius
    np.fill_diagonal(near, False)
    return np.asarray(near.any(axis=1))


def _find_unexplained(
    searched: SearchedFrame, view: WorkingView, cloth: ClothBackground, candidates: CandidateDetections
) -> BoolArray:
    """Find foreground (h, w) beside balls that differs from the cloth as they do and is as large as part of one."""
    beside = (
        view.centre_area
        & searched.touched
        & _draw_discs(candidates, SUSPECT_RADII, view)
        & ~_draw_discs(candidates, EXPLAINED_RADII, view)
    )
    row, column = np.nonzero(beside)
    is_unexplained = np.zeros(beside.shape, dtype=bool)
    if not len(row):
        return is_unexplained
    balls = cloth.measure_difference(searched.working_image, *nearest_pixels(beside.shape, candidates.centre))
    unlike = cloth.measure_difference(searched.working_image, row, column) > max(
        cloth.threshold, MIN_DIFFERENCE_SHARE * float(np.median(balls))
    )
    if np.count_nonzero(unlike) < MIN_AREA_BALLS * np.pi * view.median_radius**2:
        return is_unexplained
    is_unexplained[row[unlike], column[unlike]] = True
    # Only the part of the image with any foreground: it is small.
    x, y, w, h = cv2.boundingRect(is_unexplained.view(np.uint8))
    part = slice(y, y + h), slice(x, x + w)
    kernel = build_disc_kernel(MIN_HALF_WIDTH_RADII * view.median_radius)
    thick = cv2.morphologyEx(is_unexplained[part].view(np.uint8), cv2.MORPH_OPEN, kernel)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(thick)
    large = stats[:, cv2.CC_STAT_AREA] > MIN_AREA_BALLS * np.pi * view.median_radius**2
    large[0] = False
    is_unexplained[part] = large[labels]
    return is_unexplained


def _search_enlarged(
    searched: SearchedFrame, view: WorkingView, model: BallModel, part: tuple[slice, slice], factor: float
) -> CandidateDetections:
    """Find balls in a part of the working image, enlarged about `factor` times; working px."""
    context = int(np.ceil(CONTEXT_PX / factor))
    h, w = view.radius.shape
    top, left = max(part[0].start - context, 0), max(part[1].start - context, 0)
    bottom, right = min(part[0].stop + context, h), min(part[1].stop + context, w)
    enlarged = view.enlarge_part(searched.rgb, searched.frame, (slice(top, bottom), slice(left, right)), factor)
    grown = np.array(enlarged.shape[1::-1]) / (right - left, bottom - top)
    candidates = model.find_candidates(enlarged, view.median_radius * factor)
    return candidates.transform(lambda px: (px + 0.5) / grown - 0.5 + (left, top), 1 / factor)


def _draw_discs(candidates: CandidateDetections, radii: float, view: WorkingView) -> BoolArray:
    """Draw a mask (h, w) of the places within some radii of balls."""
    drawn = np.zeros(view.radius.shape, np.uint8)
    for (x, y), radius in zip(np.rint(candidates.centre).astype(int).tolist(), candidates.radius.tolist(), strict=True):
        cv2.circle(drawn, (x, y), int(np.ceil(radii * radius)), 1, -1)
    return drawn.view(np.bool_)
