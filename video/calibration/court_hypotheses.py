"""Which court fits painted lines: homographies from pairs of lines, weighed by all lines that should be seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from models.core.court import Sport
from models.core.scene import apply_homography
from models.core.typing import FloatArray
from video.calibration.court_lines import (
    MAP_DIRECTIONS,
    PaintedLines,
    find_painted_lines,
    find_ridge_points,
    map_ridge_directions,
)

# Least painted share of the sides of a quadrangle of lines: players and the net hide parts.
MIN_SIDE_COVER = 0.45
# Shortest side of a quadrangle, px, and shares of the image by which its corners may lie outside.
MIN_SIDE_PX, CORNER_MARGIN = 24.0, 0.35
# Focal lengths in widths of the image that cameras of courts have: wide phones to tele lenses of broadcasts.
FOCAL_RANGE = (0.35, 12.0)
FOCAL_STEPS = 24
# Largest cosine between directions that should be perpendicular, and logarithm of the ratio of lengths to their right
# ratio, for some focal length: lines that were fitted to a few px of a side of 50 px.
MAX_COSINE, MAX_LOG_RATIO = 0.06, 0.08
# Number of quadrangles, and of hypotheses that are weighed with all points.
MAX_QUADS, MAX_WEIGHED = 6000, 1500
# Points on all lines of a court at which a hypothesis is weighed; coarse ones are every fourth.
POINTS_PER_LINE = 24
COARSE_STEP = 4
# px of seen line that one px of missing line outweighs: lines that players and nets do not hide are seen, and clutter
# confirms up to two thirds of lines that are not there.
MISS_COST = 2.0
# Share of the length of a court below which its paint is not always seen.
THIN_SHARE = 0.002


@dataclass(frozen=True, slots=True)
class CourtHypothesis:
    """A court at a place in the image."""

    sport: Sport
    homography: FloatArray
    """(3, 3) from metres on the court to px of the search image."""
    score: float
    """px of court lines that are seen, less those that should be and are not."""
    share: float
    """Share of the lines' length inside the image that is seen."""


@dataclass(frozen=True, slots=True)
class _LinePoints:
    """Points on the lines of a sport: starts and ends of P short pieces."""

    start: FloatArray
    end: FloatArray
    line: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class _Quads:
    """Q quadrangles of two lines a and two lines b."""

    corners: FloatArray
    """(Q, 2, 2, 2) px about the image centre: first or second line a, first or second line b, x and y."""
    matrix: FloatArray
    """(Q, 3, 3) from the unit square (u by a, v by b)."""


def propose_courts(brightness: NDArray[np.float32], sports: Sequence[Sport], count: int = 12) -> list[CourtHypothesis]:
    """Propose courts in an image, the best first.

    Args:
        brightness: (H, W) grey levels.
        sports: the sports to try.
        count: largest number of proposals.
    """
    height, width = brightness.shape
    points = find_ridge_points(brightness)
    lines = find_painted_lines(points, (height, width))
    quads = _find_quads(lines, (height, width))
    if len(quads.corners) == 0:
        return []
    maps = map_ridge_directions(points, (height, width))
    proposals: list[CourtHypothesis] = []
    middle = np.array([[1, 0, (width - 1) / 2], [0, 1, (height - 1) / 2], [0, 0, 1.0]])
    ratios = _possible_ratios(quads, width)
    for sport in sports:
        matrices = middle @ _match_lines(quads, ratios, sport)
        coarse = weigh_homographies(matrices, sport, maps, COARSE_STEP)[0]
        matrices = matrices[np.argsort(-coarse, kind="stable")[:MAX_WEIGHED]]
        scores, shares = weigh_homographies(matrices, sport, maps, 1)
        proposals += _select_distinct(sport, matrices, scores, shares, count)
    return sorted(proposals, key=lambda one: -one.score)[:count]


def weigh_homographies(
    matrices: FloatArray, sport: Sport, maps: NDArray[np.bool_], step: int = 1
) -> tuple[FloatArray, FloatArray]:
    """Weigh homographies (N, 3, 3) by the ridges along all lines of a court.

    Returns:
        (N,) px of lines that are seen less those that are not, and (N,) share that is seen of what is in the image.
    """
    pieces = _cut_lines(sport)
    widths = np.array([one.width for one in sport.lines])[pieces.line]
    visibility = np.minimum(1.0, widths / (THIN_SHARE * sport.length))
    _, height, width = maps.shape
    ends = np.stack([pieces.start, pieces.end])[:, ::step]
    homogeneous = np.concatenate([ends, np.ones((*ends.shape[:2], 1))], axis=-1)
    scores, shares = np.full(len(matrices), -np.inf), np.zeros(len(matrices))
    for first in range(0, len(matrices), 2000):
        part = slice(first, first + 2000)
        rays = np.einsum("nij,epj->enpi", matrices[part], homogeneous)
        # Points behind the camera make a homography impossible that puts the court's middle before it.
        is_front = (rays[..., 2] > 1e-9).all((0, 2)) | (rays[..., 2] < -1e-9).all((0, 2))
        px = rays[..., :2] / np.where(np.abs(rays[..., 2:]) > 1e-9, rays[..., 2:], 1e-9)
        along, middle = px[1] - px[0], (px[0] + px[1]) / 2
        length = np.linalg.norm(along, axis=-1)
        with np.errstate(invalid="ignore"):
            x, y = (np.nan_to_num(np.rint(middle[..., k]), nan=-1.0, posinf=-1, neginf=-1) for k in (0, 1))
        is_inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        across = np.mod(np.arctan2(along[..., 0], -along[..., 1]), np.pi)
        direction = np.rint(across / np.pi * MAP_DIRECTIONS).astype(np.int64) % MAP_DIRECTIONS
        rows, columns = (np.where(is_inside, place, 0).astype(np.int64) for place in (y, x))
        weight = np.where(is_inside, length, 0.0) * visibility[::step]
        is_hit = maps[direction, rows, columns]
        total, hit = weight.sum(1), (weight * is_hit).sum(1)
        scores[part] = np.where(is_front, hit - MISS_COST * (total - hit), -np.inf) * step
        shares[part] = hit / np.maximum(total, 1e-9)
    return scores, shares


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
    possible = np.isfinite(meet).all(-1) & (np.abs(meet) < limit).all(-1)
    index = np.broadcast_to(np.arange(count)[:, None, None], (count,) * 3)
    low, high = _clip_to_image(n, c, shape)
    ends = [np.clip(along, low[:, None], high[:, None])]
    painted = lines.lengths_between(index, ends[0][:, :, None], ends[0][:, None, :])
    inside = np.abs(ends[0][:, :, None] - ends[0][:, None, :])
    is_side = (painted > MIN_SIDE_COVER * inside) & (inside > MIN_SIDE_PX)
    is_side &= possible[:, :, None] & possible[:, None, :]
    quads, sizes = [], []
    for b1, b2 in combinations(range(count), 2):
        members = np.flatnonzero(is_side[:, b1, b2])
        for a1, a2 in combinations(members.tolist(), 2):
            if a1 < b1 and is_side[b1, a1, a2] and is_side[b2, a1, a2]:
                quads.append((a1, a2, b1, b2))
                sizes.append(painted[a1, b1, b2] + painted[a2, b1, b2] + painted[b1, a1, a2] + painted[b2, a1, a2])
    if not quads:
        return _Quads(np.empty((0, 2, 2, 2)), np.empty((0, 3, 3)))
    chosen = np.array(quads)[np.argsort(-np.array(sizes), kind="stable")[:MAX_QUADS]]
    a, b = chosen[:, :2], chosen[:, 2:]
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


def _possible_ratios(quads: _Quads, width: int) -> FloatArray:
    """Find the ratios (Q, F) of u to v, in metres, that each focal length allows; NaN where u and v are not square."""
    focal = width * np.geomspace(*FOCAL_RANGE, FOCAL_STEPS)
    u, v = (quads.matrix[:, None, :, k] / np.stack([focal, focal, np.ones_like(focal)], -1) for k in (0, 1))
    length_u, length_v = np.linalg.norm(u, axis=-1), np.linalg.norm(v, axis=-1)
    cosine = (u * v).sum(-1) / (length_u * length_v)
    return np.where(np.abs(cosine) < MAX_COSINE, length_u / length_v, np.nan)


def _match_lines(quads: _Quads, ratios: FloatArray, sport: Sport) -> FloatArray:
    """Build homographies (N, 3, 3) from metres for all pairs of lines of a sport that a quadrangle may show."""
    x = sorted({one.start[0] for one in sport.lines if one.start[0] == one.end[0]})
    y = sorted({one.start[1] for one in sport.lines if one.start[1] == one.end[1]})
    log_ratio = np.log(ratios)
    matrices = []
    for x1, x2 in combinations(x, 2):
        for y1, y2 in combinations(y, 2):
            wanted = np.log((x2 - x1) / (y2 - y1))
            for is_swapped in (False, True):
                error = np.abs(log_ratio - (-wanted if is_swapped else wanted))
                chosen = quads.matrix[(error < MAX_LOG_RATIO).any(1)]
                to_square = np.array([[1 / (x2 - x1), 0, -x1 / (x2 - x1)], [0, 1 / (y2 - y1), -y1 / (y2 - y1)],
                                      [0, 0, 1]])  # fmt: skip
                if is_swapped:
                    to_square = to_square[[1, 0, 2]]
                matrices.append(chosen @ to_square)
    return np.concatenate(matrices) if matrices else np.empty((0, 3, 3))


def _select_distinct(
    sport: Sport, matrices: FloatArray, scores: FloatArray, shares: FloatArray, count: int
) -> list[CourtHypothesis]:
    """Select the best hypotheses whose courts differ by more than a few px somewhere."""
    chosen: list[CourtHypothesis] = []
    places: list[FloatArray] = []
    for k in np.argsort(-scores, kind="stable").tolist():
        if len(chosen) == count or scores[k] <= 0:
            break
        corners = apply_homography(matrices[k], sport.corners)
        # The same court is seen whichever of its corners comes first.
        ring = corners[np.argsort(np.arctan2(*(corners - corners.mean(0)).T))]
        size = np.linalg.norm(np.ptp(ring, axis=0))
        if any(np.abs(np.roll(ring, r, axis=0) - other).max() < 0.02 * size for other in places for r in range(4)):
            continue
        chosen.append(CourtHypothesis(sport, matrices[k], float(scores[k]), float(shares[k])))
        places.append(ring)
    return chosen
