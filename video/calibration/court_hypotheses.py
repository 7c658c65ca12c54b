"""Which court fits painted lines: homographies from pairs of lines, weighed by all lines that should be seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.court import Sport
from models.core.scene import apply_homography
from models.core.typing import BoolArray, FloatArray
from video.calibration.court_lines import (
    MAP_DIRECTIONS,
    PaintedLines,
    RidgePoints,
    find_painted_lines,
    find_ridge_points,
    map_ridge_directions,
)

# Least painted share of the sides of a quadrangle of lines: players and the net hide parts.
MIN_SIDE_COVER = 0.3
# Shortest side of a quadrangle, px, and shares of the image by which its corners may lie outside.
MIN_SIDE_PX, CORNER_MARGIN = 20.0, 0.35
# Focal lengths in widths of the image that cameras of courts have: wide phones to tele lenses of broadcasts.
FOCAL_RANGE = (0.35, 12.0)
FOCAL_STEPS = 24
# Largest cosine between directions that should be perpendicular, and logarithm of the ratio of lengths to their right
# ratio, for some focal length; and px by which a corner may be wrong, since a dark edge beside thin paint moves its
# crest. The first two limits grow with what this error does to a quadrangle, which is much for a table that is seen at
# a small angle, up to the last number times themselves: beyond it, nearly every quadrangle would pass.
MAX_COSINE, MAX_LOG_RATIO, CORNER_ERROR_PX, MOST_LOOSENED = 0.06, 0.08, 1.5, 3.0
# Number of quadrangles, and of hypotheses that are weighed with all points.
MAX_QUADS, MAX_WEIGHED = 6000, 1500
# Points on all lines of a court at which a hypothesis is weighed; coarse ones are every eighth.
POINTS_PER_LINE = 24
COARSE_STEP = 8
# Probability that a piece of a line is seen: players, the net and the light hide the others. The probability that a
# ridge is there by chance is measured over windows of px, and lies in a range: letters and stands are full of ridges.
# A window holds some lines of the court, too, so that about half of them must be seen: with fewer, nothing is a court.
SEEN_PROBABILITY = 0.85
CHANCE_WINDOW_PX, CHANCE_RANGE = 41, (0.02, 0.6)
# Orders of its corners in which a court looks the same; its sides do not change places.
SAME_COURT = ([0, 1, 2, 3], [2, 3, 0, 1], [1, 0, 3, 2], [3, 2, 1, 0])
# Share of the length of a court below which its paint is not always seen.
THIN_SHARE = 0.002


@dataclass(frozen=True, slots=True)
class CourtHypothesis:
    """A court at a place in the image."""

    sport: Sport
    homography: FloatArray
    """(3, 3) from metres on the court to px of the search image."""
    score: float
    """Logarithm of the likelihood of the ridges along its lines, less that of ridges by chance, times px per ridge."""
    seen_px: float
    """px of its lines that are seen."""


@dataclass(frozen=True, slots=True)
class _LinePoints:
    """Points on the lines of a sport: starts and ends of P short pieces."""

    start: FloatArray
    end: FloatArray
    line: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class _RidgeMaps:
    """Where ridges are, and what it says of a line that it is seen there or not."""

    directions: NDArray[np.bool_]
    """(MAP_DIRECTIONS, H, W) whether a ridge of each direction is near."""
    chance: NDArray[np.float32]
    """(MAP_DIRECTIONS, H, W) probability that a ridge of a direction is there by chance: rows of a stand are full of
    ridges of one direction."""


@dataclass(frozen=True, slots=True)
class _Quads:
    """Q quadrangles of two lines a and two lines b."""

    corners: FloatArray
    """(Q, 2, 2, 2) px about the image centre: first or second line a, first or second line b, x and y."""
    matrix: FloatArray
    """(Q, 3, 3) from the unit square (u by a, v by b)."""


def propose_courts(brightness: NDArray[np.float32], sports: Sequence[Sport], count: int) -> list[CourtHypothesis]:
    """Propose courts in an image, the best first.

    Args:
        brightness: (H, W) grey levels.
        sports: the sports to try.
        count: largest number of proposals of each sport.
    """
    height, width = brightness.shape
    points = find_ridge_points(brightness)
    lines = find_painted_lines(points, (height, width))
    quads = _find_quads(lines, (height, width))
    if len(quads.corners) == 0:
        return []
    ridges = _map_ridges(points, (height, width))
    proposals: list[CourtHypothesis] = []
    middle = np.array([[1, 0, (width - 1) / 2], [0, 1, (height - 1) / 2], [0, 0, 1.0]])
    ratios, errors = _possible_ratios(quads, width)
    for sport in sports:
        matrices = middle @ _match_lines(quads, ratios, errors, sport)
        coarse = _weigh_homographies(matrices, sport, ridges, COARSE_STEP)[0]
        matrices = matrices[np.argsort(-coarse, kind="stable")[:MAX_WEIGHED]]
        proposals += _select_distinct(sport, matrices, *_weigh_homographies(matrices, sport, ridges, 1), count)
    return sorted(proposals, key=lambda one: -one.score)


def _map_ridges(points: RidgePoints, shape: tuple[int, int]) -> _RidgeMaps:
    maps = map_ridge_directions(points, shape)
    chance = np.empty(maps.shape, np.float32)
    for one, directed in zip(maps, chance, strict=True):
        cv2.blur(one.astype(np.float32), (CHANCE_WINDOW_PX,) * 2, dst=directed)
    return _RidgeMaps(maps, np.clip(chance, *CHANCE_RANGE, out=chance))


def _weigh_homographies(
    matrices: FloatArray, sport: Sport, ridges: _RidgeMaps, step: int
) -> tuple[FloatArray, FloatArray]:
    """Weigh homographies (N, 3, 3) by the ridges along all lines of a court: scores and px seen (N,)."""
    pieces = _cut_lines(sport)
    widths = np.array([one.width for one in sport.lines])[pieces.line]
    visibility = np.minimum(1.0, widths / (THIN_SHARE * sport.length))
    _, height, width = ridges.directions.shape
    ends = np.stack([pieces.start, pieces.end])[:, step // 2 :: step]
    homogeneous = np.concatenate([ends, np.ones((*ends.shape[:2], 1))], axis=-1).reshape(-1, 3).T.astype(np.float32)
    matrices = matrices.astype(np.float32)
    scores, lengths = np.zeros((2, len(matrices)))
    for first in range(0, len(matrices), 2000):
        part = slice(first, first + 2000)
        # Coordinates first: (3, N, both ends of all pieces).
        u, v, depth = np.moveaxis(
            (matrices[part].reshape(-1, 3) @ homogeneous).reshape(-1, 3, homogeneous.shape[1]), 1, 0
        )
        side = np.sign(depth.mean(1, keepdims=True))
        # The court's middle is before the camera; pieces that are not, are outside the image.
        is_front = depth * side > 1e-3 * np.abs(depth).max(1, keepdims=True)
        depth = np.where(is_front, depth, 1e9)
        half = depth.shape[1] // 2
        x, y = u / depth, v / depth
        dx, dy = x[:, half:] - x[:, :half], y[:, half:] - y[:, :half]
        column, row = (x[:, half:] + x[:, :half]) / 2, (y[:, half:] + y[:, :half]) / 2
        is_inside = (column > 0) & (column < width - 1) & (row > 0) & (row < height - 1)
        is_inside &= is_front[:, :half] & is_front[:, half:]
        n, p = np.nonzero(is_inside)
        dx, dy = dx[n, p], dy[n, p]
        direction = np.rint(np.arctan2(dx, -dy) * (MAP_DIRECTIONS / np.pi)).astype(np.int64) % MAP_DIRECTIONS
        i, j = (row[n, p] + 0.5).astype(np.int64), (column[n, p] + 0.5).astype(np.int64)
        is_hit = ridges.directions[direction, i, j]
        chance = ridges.chance[direction, i, j]
        ratio = np.where(is_hit, SEEN_PROBABILITY / chance, (1 - SEEN_PROBABILITY) / (1 - chance))
        weight = np.hypot(dx, dy) * visibility[step // 2 :: step][p]
        scores[part] = np.bincount(n, weight * np.log(ratio), len(depth))
        lengths[part] = np.bincount(n, weight * is_hit, len(depth))
    return scores, lengths


def _cut_lines(sport: Sport) -> _LinePoints:
    """Cut the lines of a sport into short pieces."""
    share = np.linspace(0, 1, POINTS_PER_LINE + 1)[:, None]
    starts, ends, line = [], [], []
    for k, one in enumerate(sport.lines):
        places = np.array(one.start) + share * (np.array(one.end) - np.array(one.start))
        starts.append(places[:-1])
        ends.append(places[1:])
        line += [k] * POINTS_PER_LINE
    return _LinePoints(np.concatenate(starts), np.concatenate(ends), np.array(line))


def _find_quads(lines: PaintedLines, shape: tuple[int, int]) -> _Quads:
    """Find quadrangles of lines whose four sides are painted, the longest first."""
    n, c = lines.normal, lines.offset
    count = len(c)
    if count < 4:
        return _Quads(np.empty((0, 2, 2, 2)), np.empty((0, 3, 3)))
    cross = n[:, None, 0] * n[None, :, 1] - n[:, None, 1] * n[None, :, 0]
    safe = np.where(np.abs(cross) > 0.05, cross, np.nan)
    # (L, L) places where lines meet, and where that is along the first of them.
    meet = np.stack([c[:, None] * n[None, :, 1] - c[None] * n[:, None, 1],
                     n[:, None, 0] * c[None] - n[None, :, 0] * c[:, None]], axis=-1) / safe[..., None]  # fmt: skip
    along = np.nan_to_num(-meet[..., 0] * n[:, None, 1] + meet[..., 1] * n[:, None, 0])
    limit = np.array([shape[1], shape[0]]) * (0.5 + CORNER_MARGIN)
    possible = np.all(np.isfinite(meet) & (np.abs(meet) < limit), axis=-1)
    index = np.broadcast_to(np.arange(count)[:, None, None], (count,) * 3)
    low, high = _clip_to_image(n, c, shape)
    ends = [np.clip(along, low[:, None], high[:, None])]
    painted = lines.lengths_between(index, ends[0][:, :, None], ends[0][:, None, :])
    inside = np.abs(ends[0][:, :, None] - ends[0][:, None, :])
    is_side: BoolArray = (painted > MIN_SIDE_COVER * inside) & (inside > MIN_SIDE_PX)
    is_side &= possible[:, :, None] & possible[:, None, :]
    parts = []
    for b1, b2 in combinations(range(count), 2):
        members = np.flatnonzero(is_side[:, b1, b2])
        is_closed = is_side[b1][np.ix_(members, members)] & is_side[b2][np.ix_(members, members)]
        first, second = np.nonzero(np.triu(is_closed, 1))
        # Each quadrangle once: the first line of all is a line a.
        first, second = first[members[first] < b1], second[members[first] < b1]
        a1, a2 = members[first], members[second]
        size = painted[a1, b1, b2] + painted[a2, b1, b2] + painted[b1, a1, a2] + painted[b2, a1, a2]
        parts.append(np.column_stack([a1, a2, np.full_like(a1, b1), np.full_like(a1, b2), size]))
    quads = np.concatenate(parts)
    quads = quads[np.argsort(-quads[:, 4], kind="stable")[:MAX_QUADS]]
    a, b = quads[:, :2].astype(np.int64), quads[:, 2:4].astype(np.int64)
    corners = meet[a[:, :, None], b[:, None, :]]
    matrix = _unit_square_to(corners)
    is_good = np.isfinite(matrix).all((1, 2)) & _is_convex(corners)
    return _Quads(corners[is_good], matrix[is_good])


def _clip_to_image(n: FloatArray, c: FloatArray, shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Find where lines (L,) enter and leave the image, along them."""
    low, high = np.full(len(c), -np.inf), np.full(len(c), np.inf)
    foot, along = n * c[:, None], np.column_stack([-n[:, 1], n[:, 0]])
    for k, half in ((0, shape[1] / 2), (1, shape[0] / 2)):
        rate = np.where(np.abs(along[:, k]) > 1e-9, along[:, k], 1e-9)
        ends = np.sort((np.array([-half, half]) - foot[:, k : k + 1]) / rate[:, None], axis=1)
        low, high = np.maximum(low, ends[:, 0]), np.minimum(high, ends[:, 1])
    return low, np.maximum(high, low)


def _unit_square_to(corners: FloatArray) -> FloatArray:
    """Compute homographies (Q, 3, 3) from the unit square to corners (Q, 2, 2, 2) (Heckbert 1989)."""
    p00, p10, p01, p11 = corners[:, 0, 0], corners[:, 1, 0], corners[:, 0, 1], corners[:, 1, 1]
    d1, d2, d3 = p10 - p11, p01 - p11, p00 - p10 + p11 - p01
    det = d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1]
    det = np.where(np.abs(det) > 1e-6, det, np.nan)
    g = (d3[:, 0] * d2[:, 1] - d2[:, 0] * d3[:, 1]) / det
    h = (d1[:, 0] * d3[:, 1] - d3[:, 0] * d1[:, 1]) / det
    matrix = np.ones((len(corners), 3, 3))
    matrix[:, :2, 0] = p10 - p00 + g[:, None] * p10
    matrix[:, :2, 1] = p01 - p00 + h[:, None] * p01
    matrix[:, :2, 2] = p00
    matrix[:, 2, 0], matrix[:, 2, 1] = g, h
    return matrix


def _is_convex(corners: FloatArray) -> NDArray[np.bool_]:
    ring = corners[:, [0, 1, 1, 0], [0, 0, 1, 1]]
    edges = np.roll(ring, -1, axis=1) - ring
    after = np.roll(edges, -1, axis=1)
    turns = edges[..., 0] * after[..., 1] - edges[..., 1] * after[..., 0]
    return np.asarray((turns > 100).all(1) | (turns < -100).all(1))


def _possible_ratios(quads: _Quads, width: int) -> tuple[FloatArray, FloatArray]:
    """Find the logarithms (Q, F) of the ratios of u to v, in metres, that each focal length allows, and their errors.

    NaN where u and v are not square.
    """
    focal = width * np.geomspace(*FOCAL_RANGE, FOCAL_STEPS)
    cosine, ratio = _measure_shapes(quads.matrix, focal)
    variances = np.zeros((2, *cosine.shape))
    for k in range(8):
        moved = quads.corners.copy()
        moved.reshape(-1, 8)[:, k] += CORNER_ERROR_PX
        others = _measure_shapes(_unit_square_to(moved), focal)
        variances += np.square(np.stack(others) - np.stack([cosine, ratio]))
    least = np.array([MAX_COSINE, MAX_LOG_RATIO])[:, None, None]
    limits = np.minimum(np.hypot(least, np.sqrt(np.nan_to_num(variances))), MOST_LOOSENED * least)
    return np.where(np.abs(cosine) < limits[0], ratio, np.nan), limits[1]


def _measure_shapes(matrix: FloatArray, focal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Measure the cosines (Q, F) between the sides u and v of squares, and the logarithms of their ratios."""
    u, v = (matrix[:, None, :, k] / np.stack([focal, focal, np.ones_like(focal)], -1) for k in (0, 1))
    length_u, length_v = np.linalg.norm(u, axis=-1), np.linalg.norm(v, axis=-1)
    return (u * v).sum(-1) / (length_u * length_v), np.log(length_u / length_v)


def _match_lines(quads: _Quads, ratios: FloatArray, errors: FloatArray, sport: Sport) -> FloatArray:
    """Build homographies (N, 3, 3) from metres for all pairs of lines of a sport that a quadrangle may show."""
    x = sorted({one.start[0] for one in sport.lines if one.start[0] == one.end[0]})
    y = sorted({one.start[1] for one in sport.lines if one.start[1] == one.end[1]})
    matrices = []
    for x1, x2 in combinations(x, 2):
        for y1, y2 in combinations(y, 2):
            wanted = np.log((x2 - x1) / (y2 - y1))
            for is_swapped in (False, True):
                error = np.abs(ratios - (-wanted if is_swapped else wanted))
                chosen = quads.matrix[(error < errors).any(1)]
                to_square = np.array([[1 / (x2 - x1), 0, -x1 / (x2 - x1)], [0, 1 / (y2 - y1), -y1 / (y2 - y1)],
                                      [0, 0, 1]])  # fmt: skip
                if is_swapped:
                    to_square = to_square[[1, 0, 2]]
                matrices.append(chosen @ to_square)
    return np.concatenate(matrices) if matrices else np.empty((0, 3, 3))


def _select_distinct(
    sport: Sport, matrices: FloatArray, scores: FloatArray, lengths: FloatArray, count: int
) -> list[CourtHypothesis]:
    """Select the best hypotheses whose courts differ by more than a few px somewhere."""
    chosen: list[CourtHypothesis] = []
    places: list[FloatArray] = []
    for k in np.argsort(-scores, kind="stable").tolist():
        if len(chosen) == count or scores[k] <= 0:
            break
        corners = apply_homography(matrices[k], sport.corners)
        size = np.linalg.norm(np.ptp(corners, axis=0))
        if any(np.abs(corners[turn] - other).max() < 0.02 * size for other in places for turn in SAME_COURT):
            continue
        chosen.append(CourtHypothesis(sport, matrices[k], float(scores[k]), float(lengths[k])))
        places.append(corners)
    return chosen
