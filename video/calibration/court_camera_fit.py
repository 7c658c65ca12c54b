"""The camera that puts a court's lines and net where they are seen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.court import CourtLine, Sport
from models.core.court_camera import CAMERA_PARAMETERS, CourtCamera
from models.core.typing import BoolArray, FloatArray
from video.calibration.court_lines import measure_crests, measure_steps

# px in an image of `REFERENCE_WIDTH_PX`: how far paint is searched, step by step.
REACHES = (8.0, 5.0, 3.0, 3.0)
REFERENCE_WIDTH_PX = 1280
# Largest number of places on one line; px between places along it, and px to another line where its paint disturbs.
PLACES_PER_LINE, PLACE_STEP_PX, CROSSING_PX = 80, 4.0, 5.0
# Least error of a place of a line, px: aliasing, coding.
LEAST_ERROR_PX = 0.1
# Least error of all places of a line together, px: paint is a few mm from where the rules want it, and what lies beside
# it shifts its middle.
LINE_ERROR_PX = 0.1
# Before lines are seen: k1 of lenses of phones and broadcasts; logarithm of focal lengths in widths of the image.
LENS_SIGMA, FOCAL_MEAN, FOCAL_SIGMA = 0.03, np.log(1.5), 1.0
# Share of a net's height by which it is hung wrong or its tape is of another width, and width of the tape by it.
NET_SIGMA_SHARE, TAPE_SHARE = 0.02, 0.055
# px: thinner paint is not always seen.
THIN_PX = 0.8
# px: thinner paint at the edge of a table merges with a bright floor behind it, and is seen as a step.
MERGED_PX = 1.5
# Share of the lines that must be seen as paint before steps count as lines: the edges of a mat on a bright floor are
# steps all around.
MIN_PAINT_SHARE = 0.4
# m to a place beside another, by which directions in the image are measured.
PROBE_M = 0.01
# Share of the lines' length that is seen below which further steps do not make a court of it.
GIVE_UP_SHARE = 0.4
# Least number of places that a camera is fitted to.
MIN_PLACES = 12
GAUSS_NEWTON_STEPS = 6


@dataclass(frozen=True, slots=True)
class CourtFit:
    """A camera fitted to an image, and how well the image agrees."""

    camera: CourtCamera
    line_error: float
    """px, root mean square distance of paint from the predicted lines."""
    share: float
    """Share of the length of the lines, inside the image and away from crossings, where paint was found."""
    line_shares: FloatArray
    """(lines,) the same of each line; NaN where less than `PLACE_STEP_PX` places are inside the image."""
    net_share: float
    """Share of the net's upper edge that is seen; NaN outside the image."""
    seen_px: float
    """px, length of the lines that is seen."""


@dataclass(frozen=True, slots=True)
class _Places:
    """K places on lines and net, and where paint is seen."""

    xyz: FloatArray
    """(K, 3) m."""
    line: NDArray[np.int64]
    """(K,) number of the line; that of the net follows them."""
    normal: FloatArray
    """(K, 2) px, across."""
    px: FloatArray
    """(K, 2) where paint is seen; NaN where none is."""
    weight: FloatArray
    """(K,) px of line that a place stands for, less where paint is too thin to be seen; 0 where none can be."""
    is_step: BoolArray
    """(K,) whether a step at the edge of a table was measured, because no paint is seen."""


# The fields of `_Places` of a line, with widths of its paint, px, before the last.
_Parts = tuple[FloatArray, NDArray[np.int64], FloatArray, FloatArray, FloatArray, FloatArray]


def build_court_camera(homography: FloatArray, sport: Sport, width: int, height: int) -> CourtCamera:
    """Build a camera of square pixels from a homography (3, 3) from metres on the court to pixels.

    The axes of the court are turned to what `models.core.court` says; a court looks the same from both ends.
    """
    middle = np.array([[1, 0, -(width - 1) / 2], [0, 1, -(height - 1) / 2], [0, 0, 1]])
    plane = middle @ homography
    plane *= np.sign(plane[2] @ np.array([sport.length / 2, sport.width / 2, 1]))
    focal = _choose_focal_length(plane, width)
    rays = plane / np.array([[focal], [focal], [1.0]])
    scale = (np.linalg.norm(rays[:, 0]) + np.linalg.norm(rays[:, 1])) / 2
    x_axis, y_axis, origin = (rays / scale).T
    basis, _, rest = np.linalg.svd(np.column_stack([x_axis, y_axis]), full_matrices=False)
    x_axis, y_axis = (basis @ rest).T
    up = np.cross(x_axis, y_axis)
    up = -up if up @ origin > 0 else up
    ahead = np.array([0, 0, 1.0]) - up[2] * up
    right = np.cross(ahead, up)
    is_left_handed = bool(abs(x_axis @ ahead) > abs(x_axis @ right))
    towards = (ahead, right) if is_left_handed else (right, ahead)
    signs = [np.sign(axis @ way) or 1.0 for axis, way in zip((x_axis, y_axis), towards, strict=True)]
    # The corner from which both axes point as they should.
    sizes, axes = (sport.length, sport.width), (x_axis, y_axis)
    for axis, sign, size in zip(axes, signs, sizes, strict=True):
        origin = origin + (axis * size if sign < 0 else 0.0)
    turn = np.column_stack([x_axis * signs[0], y_axis * signs[1], up])
    centre = -turn.T @ origin
    if is_left_handed:
        turn = turn @ np.diag([1.0, -1.0, 1.0])
    vector = cv2.Rodrigues(turn)[0].ravel()
    parameters = np.array([*centre, *vector, np.log(focal), 0.0])
    return CourtCamera(parameters, np.eye(CAMERA_PARAMETERS), width, height, is_left_handed)


def _choose_focal_length(plane: FloatArray, width: int) -> float:
    """Choose the focal length, px, that makes the axes of a plane square and of one scale."""
    u, v = plane[:, 0], plane[:, 1]
    focal = width * np.geomspace(0.35, 12.0, 200)
    stretch = np.stack([1 / focal, 1 / focal, np.ones_like(focal)], -1)
    a, b = u * stretch, v * stretch
    lengths = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    misfit = ((a * b).sum(1) / (lengths[0] * lengths[1])) ** 2 + np.log(lengths[0] / lengths[1]) ** 2
    return float(focal[np.argmin(misfit)])


def fit_court_camera(brightness: NDArray[np.float32], sport: Sport, camera: CourtCamera) -> CourtFit:
    """Fit a camera to the painted lines and the net in an image by robust least squares.

    Args:
        brightness: (H, W) grey levels.
        sport: the court.
        camera: a camera that is nearly right.
    """
    scale = max(1.0, brightness.shape[1] / REFERENCE_WIDTH_PX)
    extended = np.append(camera.parameters, 0.0)
    for reach in REACHES:
        places = measure_places(brightness, sport, camera, reach * scale, extended[-1])
        extended, spread, covariance = _solve(places, sport, camera, extended)
        visible, possible = (float(places.weight[part].sum()) for part in (np.isfinite(places.px[:, 0]), slice(None)))
        if visible < GIVE_UP_SHARE * possible:
            break
        camera = camera.replace_parameters(extended[:CAMERA_PARAMETERS])
    camera = replace(camera, covariance=covariance[:CAMERA_PARAMETERS, :CAMERA_PARAMETERS])
    places = measure_places(brightness, sport, camera, REACHES[-1] * scale, extended[-1])
    return _judge(places, sport, camera, extended, spread)


def fit_to_corners(sport: Sport, camera: CourtCamera, corners: FloatArray, sigma: float) -> CourtFit:
    """Fit a camera to four corners (4, 2) of the court, px with their error, where no lines are seen."""
    predicted_px = camera.to_pixels(_raise(sport.corners))
    px = corners[np.argmin(np.linalg.norm(predicted_px[:, None] - corners, axis=-1), axis=1)]
    places = _Places(
        np.repeat(_raise(sport.corners), 2, axis=0), np.arange(8), np.tile(np.eye(2), (4, 1)), np.repeat(px, 2, axis=0),
        np.ones(8), np.zeros(8, np.bool_),
    )  # fmt: skip
    extended = np.append(camera.parameters, 0.0)
    for _ in range(GAUSS_NEWTON_STEPS):
        extended, covariance = _step(places, sport, camera, extended, np.full(8, sigma**-2))
    r = _residuals(places, sport, camera, extended)
    camera = replace(
        camera.replace_parameters(extended[:CAMERA_PARAMETERS]),
        covariance=covariance[:CAMERA_PARAMETERS, :CAMERA_PARAMETERS],
    )
    unseen = np.full(len(sport.lines), np.nan)
    return CourtFit(camera, float(np.sqrt((r**2).mean())), np.nan, unseen, np.nan, 0.0)


def measure_places(
    brightness: NDArray[np.float32], sport: Sport, camera: CourtCamera, reach: float, net_shift: float = 0.0,
) -> _Places:  # fmt: skip
    """Measure where paint is seen across the lines and the net that a camera predicts."""
    parts = list[_Parts]()
    ends = [camera.to_pixels(_raise(np.array([one.start, one.end]))) for one in sport.lines]
    size = np.array([camera.width_px, camera.height_px])
    net = _net_places(sport, camera, net_shift)
    # The net may lie on a line in the picture.
    ends += [net[3][[0, -1]]]
    for k, one in enumerate(sport.lines):
        start, end = np.array(one.start), np.array(one.end)
        share = _even_shares(camera, _raise(start), _raise(end), size)
        xyz = _raise(start + share[:, None] * (end - start))
        along = _raise(end - start) / np.linalg.norm(end - start)
        side = one.width / 2 * np.array([-along[1], along[0], 0])
        px, normal, width, step = _look_at(camera, xyz, along * PROBE_M, side)
        parts.append((xyz, np.full(len(px), k), normal, px, width, step * np.clip(width / THIN_PX, 0, 1)))
    parts.append(net)
    for k, (_, _, _, px, width, weight) in enumerate(parts):
        for other, (p, q) in enumerate(ends):
            if other != k and np.isfinite([*p, *q]).all():
                weight[_distance_to(px, p, q) < CROSSING_PX + width] = 0.0
    xyz, line, normal, px, width, weight = (np.concatenate(part) for part in zip(*parts, strict=True))
    inside = np.all((px > 3) & (px < size - 4), axis=-1)
    xyz, normal, px, width, weight = (part[inside] for part in (xyz, normal, px, width, weight))
    line = line[inside].astype(np.int64)
    shift, _ = measure_crests(brightness, px, normal, width, reach, line < len(sport.lines))
    outward = np.array([*map(partial(_find_outward, sport), sport.lines), np.zeros(3)])[line]
    sign = np.sign(((camera.to_pixels(xyz + PROBE_M * outward) - px) * normal).sum(1))
    is_step = np.isnan(shift) & (sign != 0) & (width < MERGED_PX)
    shift[is_step] = sign[is_step] * measure_steps(
        brightness, px[is_step], sign[is_step, None] * normal[is_step], width[is_step], reach
    )
    return _Places(xyz, line, normal, px + shift[:, None] * normal, weight, is_step)


def _find_outward(sport: Sport, line: CourtLine) -> FloatArray:
    """Find the direction (3,) from a line at the edge of a table to the floor beside it; 0 for any other line."""
    way = np.zeros(3)
    for axis, size in enumerate((sport.length, sport.width)):
        place = line.start[axis]
        if sport.floor < 0 and place == line.end[axis] and min(place, size - place) <= line.width:
            way[axis] = 1.0 if place > size / 2 else -1.0
    return way


def _net_places(sport: Sport, camera: CourtCamera, net_shift: float) -> _Parts:
    """Return places at the middle of the tape of the net, as `measure_places` lists them."""
    net, half_tape = sport.net, TAPE_SHARE / 2 * sport.net.height
    y = np.linspace(-net.overhang, sport.width + net.overhang, PLACES_PER_LINE)[1:-1]
    z = net.height_at(y, sport.width) + net_shift - half_tape
    xyz = np.column_stack([np.full_like(y, sport.length / 2), y, z])
    px, normal, width, step = _look_at(camera, xyz, np.array([0, PROBE_M, 0]), np.array([0, 0, half_tape]))
    return xyz, np.full(len(y), len(sport.lines)), normal, px, width, step


def _even_shares(camera: CourtCamera, start: FloatArray, end: FloatArray, size: FloatArray) -> FloatArray:
    """Return shares of the way along a line, at even distances in the image, of places inside it."""
    fine = np.linspace(0, 1, 200)
    px = camera.to_pixels(start + fine[:, None] * (end - start))
    inside = np.all((px > 0) & (px < size), axis=-1)
    steps = np.where(inside[1:] & inside[:-1], np.linalg.norm(np.diff(px, axis=0), axis=1), 0.0)
    run = np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps))])
    count = int(min(PLACES_PER_LINE, run[-1] / PLACE_STEP_PX))
    return np.asarray(np.interp((np.arange(count) + 0.5) / max(count, 1) * run[-1], run, fine))


def _look_at(
    camera: CourtCamera, xyz: FloatArray, along: FloatArray, side: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Project places (K, 3): pixels, normals (K, 2) across, width across, and px of line per place (K,)."""
    px = camera.to_pixels(xyz)
    direction = camera.to_pixels(xyz + along) - px
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
    normal = np.column_stack([-direction[:, 1], direction[:, 0]])
    across = camera.to_pixels(xyz + side) - camera.to_pixels(xyz - side)
    step = np.linalg.norm(np.gradient(px, axis=0), axis=1) if len(px) > 1 else np.zeros(len(px))
    return px, normal, np.abs((across * normal).sum(1)), step


def _raise(xy: FloatArray) -> FloatArray:
    return np.concatenate([xy, np.zeros((*xy.shape[:-1], 1))], axis=-1)


def _distance_to(px: FloatArray, p: FloatArray, q: FloatArray) -> FloatArray:
    """Measure the distances of pixels (K, 2) to a segment."""
    way = q - p
    share = np.clip((px - p) @ way / max(float(way @ way), 1e-12), 0, 1)
    return np.asarray(np.linalg.norm(px - p - share[:, None] * way, axis=1))


def _residuals(places: _Places, sport: Sport, camera: CourtCamera, extended: FloatArray) -> FloatArray:
    """Compute px (K,) from where the camera puts lines to where paint is seen, across them."""
    is_net = places.line == len(sport.lines)
    xyz = places.xyz + np.where(is_net, extended[-1], 0.0)[:, None] * np.array([0, 0, 1.0])
    px = camera.replace_parameters(extended[:CAMERA_PARAMETERS]).to_pixels(xyz)
    return np.asarray(((places.px - px) * places.normal).sum(1))


def _solve(
    places: _Places, sport: Sport, camera: CourtCamera, extended: FloatArray
) -> tuple[FloatArray, float, FloatArray]:
    """Fit camera and height of the net: the parameters (9,), the spread of residuals, px, and the covariance."""
    # Places of the net stand for a height that is one unknown more; the measured ones are relative to it.
    is_net = places.line == len(sport.lines)
    good = np.isfinite(places.px[:, 0]) & (places.weight > 0)
    base = np.where(is_net, extended[-1], 0.0)
    places = _Places(
        (places.xyz - base[:, None] * np.array([0, 0, 1.0]))[good], places.line[good], places.normal[good],
        places.px[good], places.weight[good], places.is_step[good],
    )  # fmt: skip
    covariance, spread = np.eye(9), LEAST_ERROR_PX
    if len(places.line) < MIN_PLACES:
        return extended, np.inf, covariance
    for _ in range(GAUSS_NEWTON_STEPS):
        r = _residuals(places, sport, camera, extended)
        spread = max(LEAST_ERROR_PX, 1.4826 * float(np.median(np.abs(r))))
        weight = 1 / (1 + (r / (2.5 * spread)) ** 2) ** 2 / (spread**2 * _correlation_length(r, places.line))
        extended, covariance = _step(places, sport, camera, extended, weight, LINE_ERROR_PX)
        if not np.isfinite(extended).all():
            return np.append(camera.parameters, 0.0), np.inf, np.eye(9)
    return extended, spread, covariance


def _step(
    places: _Places, sport: Sport, camera: CourtCamera, extended: FloatArray, weight: FloatArray,
    line_error: float = 0.0,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Take a step of Gauss and Newton: the parameters (9,), NaN where there is none, and their covariance."""
    prior_mean = np.array([*np.zeros(6), FOCAL_MEAN + np.log(camera.width_px), 0.0, 0.0])
    net_sigma = NET_SIGMA_SHARE * sport.net.height
    prior = np.diag([*np.zeros(6), FOCAL_SIGMA**-2, LENS_SIGMA**-2, net_sigma**-2])
    r = _residuals(places, sport, camera, extended)
    jacobian = np.column_stack([
        (_residuals(places, sport, camera, extended + step) - _residuals(places, sport, camera, extended - step))
        / (2 * step.sum())
        for step in np.diag([1e-3 * sport.width] * 3 + [1e-5] * 4 + [1e-4] * 2)
    ])  # fmt: skip
    information, gradient = _normal_equations(jacobian, r, weight, places.line, line_error)
    information, gradient = information + prior, gradient + prior @ (extended - prior_mean)
    try:
        covariance = np.linalg.inv(information)
    except np.linalg.LinAlgError:
        return np.full(9, np.nan), np.eye(9)
    change = -covariance @ gradient
    # Turns by more than half a radian, or a third of the focal length, leave what is linear.
    change *= min(1.0, 0.3 / max(abs(change[6]), 1e-9), 0.5 / max(np.abs(change[3:6]).max(), 1e-9))
    return extended + change, np.asarray(covariance)


def _normal_equations(
    jacobian: FloatArray, r: FloatArray, weight: FloatArray, line: NDArray[np.int64], line_error: float
) -> tuple[FloatArray, FloatArray]:
    """Build the normal equations of residuals of which those of a line share an error (Woodbury's identity).

    This error is `line_error`, px, or what the means of the lines show; 0 where none is shared.
    """
    information, gradient = (jacobian.T * weight) @ jacobian, (jacobian.T * weight) @ r
    if line_error == 0:
        return information, gradient
    sums = np.bincount(line, weight)
    means = np.bincount(line, weight * r) / np.where(sums > 0, sums, np.inf)
    offset = max(line_error, float(np.sqrt((means**2).sum() / max(int((sums > 0).sum()), 1))))
    for k in np.flatnonzero(sums > 0):
        part = line == k
        pull, push = weight[part] @ jacobian[part], weight[part] @ r[part]
        share = 1 / (offset**-2 + sums[k])
        information -= share * np.outer(pull, pull)
        gradient -= share * pull * push
    return information, gradient


def _correlation_length(r: FloatArray, line: NDArray[np.int64]) -> float:
    """Estimate how many neighbouring places of a line share their error: twice the sum of the autocorrelation."""
    total, power = 1.0, float((r**2).mean())
    for lag in range(1, 25):
        is_pair = line[lag:] == line[:-lag]
        share = float((r[lag:] * r[:-lag])[is_pair].mean()) / max(power, 1e-12) if is_pair.any() else 0.0
        if share < 0.05:
            break
        total += 2 * share
    return total


def _judge(places: _Places, sport: Sport, camera: CourtCamera, extended: FloatArray, spread: float) -> CourtFit:
    count = len(sport.lines)
    base = np.where(places.line == count, extended[-1], 0.0)
    at_rest = replace(places, xyz=places.xyz - base[:, None] * np.array([0, 0, 1.0]))
    r = _residuals(at_rest, sport, camera, extended)
    is_seen = np.isfinite(r) & (np.abs(r) < max(2.0, 4 * spread))
    totals = np.bincount(places.line, places.weight, count + 1)
    paint = float((places.weight * (is_seen & ~places.is_step & (places.line < count))).sum())
    is_seen &= ~places.is_step | (paint > MIN_PAINT_SHARE * totals[:-1].sum())
    hits = np.bincount(places.line, places.weight * is_seen, count + 1)
    shares = np.where(totals > 0, hits / np.maximum(totals, 1e-9), np.nan)
    on_lines = is_seen & (places.line < count) & (places.weight > 0)
    error = float(np.sqrt((r[on_lines] ** 2).mean())) if on_lines.any() else np.inf
    share = float(hits[:-1].sum() / max(totals[:-1].sum(), 1e-9))
    return CourtFit(camera, error, share, shares[:-1], float(shares[-1]), float(hits[:-1].sum()))
