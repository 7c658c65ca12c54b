"""What stands still in a rendered court: floor, lines, boards with letters, spectators, officials, table and net.

It is painted once per camera onto canvases larger and finer than the frames, without lens distortion; a frame is
warped from them. Painting order is back to front.
"""

from __future__ import annotations

import string
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from models.core.court import CourtLine, Sport
from models.core.court_camera import CourtCamera
from models.core.typing import ByteArray, Float32Array, FloatArray
from video.rendering.court_players import Capsule, draw_capsules, make_figure
from video.rendering.court_scene import Colour, CourtLook, View, sample_outfit, sample_tint

# Canvas pixels per pixel of the frame, along each axis.
FINENESS = 2
# Fractional bits of coordinates in OpenCV's drawing functions.
SHIFT = 4
# m in front of the camera from which things are drawn.
NEAREST = 0.25
# Pixels per metre of the floor's texture.
FLOOR_RESOLUTION = 24.0


@dataclass(frozen=True, slots=True, eq=False)
class CourtCanvas:
    """Paintings of a court without what moves."""

    projection: FloatArray
    """(3, 4) from m to homogeneous canvas pixels."""
    from_reference: FloatArray
    """(3, 3) from undistorted pixels of the reference image to canvas pixels."""
    background: ByteArray
    """(h, w, 3) sRGB."""
    table: ByteArray
    """(h, w, 4) premultiplied colour and opacity of the table; empty (0, 0, 4) where the court is the floor."""
    net: ByteArray
    """(h, w, 4) of the net."""
    crowd: FloatArray
    """(K, 3) m, places of spectators who move."""
    people: FloatArray
    """(K, 3) m, feet of others beside the court who move."""


def paint_court(
    rng: np.random.Generator, sport: Sport, camera: CourtCamera, look: CourtLook, view: View, box: FloatArray
) -> CourtCanvas:  # fmt: skip
    """Paint a court.

    Args:
        box: (4,) left, top, right and bottom of what the frames show, in undistorted pixels of the reference image.
    """
    low, high = np.floor(box[:2]) - 2, np.ceil(box[2:]) + 2
    offset = (0.5 - low) * FINENESS - 0.5
    to_canvas = np.array([[FINENESS, 0, offset[0]], [0, FINENESS, offset[1]], [0, 0, 1.0]])
    width, height = ((high - low) * FINENESS).astype(int)
    painter = _Painter(to_canvas @ camera.matrix, np.zeros((height, width, 3), np.uint8))
    painter.image[:] = _byte(_scaled(look.stands, 0.5))
    crowd, people = _paint_surroundings(rng, painter, sport, look, view)
    empty = np.zeros((0, 0, 4), np.uint8)
    table = painter.layer() if sport.floor < 0 else None
    if table is None:
        paint_lines(painter.image, painter.projection, sport.lines, look.line)
    else:
        _paint_table(rng, table, sport, look)
    net = painter.layer()
    _paint_net(rng, net, sport, look)
    _shade(painter.image, look)
    layers = (painter.image, empty if table is None else table.image, net.image)
    soft = max(look.blur, 0.4) * FINENESS
    blurred = [cv2.GaussianBlur(layer, (0, 0), soft) if layer.size else layer for layer in layers]
    return CourtCanvas(painter.projection, to_canvas, *(np.asarray(b, np.uint8) for b in blurred), crowd, people)


@dataclass(slots=True, eq=False)
class _Painter:
    """An image that things in space are painted onto, in place."""

    projection: FloatArray
    image: ByteArray

    def layer(self) -> _Painter:
        return _Painter(self.projection, np.zeros((*self.image.shape[:2], 4), np.uint8))

    def project(self, polygon: FloatArray) -> FloatArray:
        """Clip a polygon (n, 3), m, to what is in front of the camera; returns its points (m, 2)."""
        points = np.column_stack([polygon, np.ones(len(polygon))]) @ self.projection.T
        depth, clipped = points[:, 2] - NEAREST, []
        for a, b, da, db in zip(points, np.roll(points, -1, 0), depth, np.roll(depth, -1), strict=True):
            if da > 0:
                clipped.append(a)
            if da * db < 0:
                clipped.append(a + da / (da - db) * (b - a))
        ends = np.array(clipped).reshape(-1, 3)
        return np.clip(ends[:, :2] / ends[:, 2:], -2e4, 2e4)

    def fill(self, polygon: Sequence[Sequence[float]] | FloatArray, colour: Colour, alpha: float = 1.0) -> None:
        """Fill a polygon (n, 3), m."""
        points = self.project(np.asarray(polygon, np.float64))
        if len(points) < 3:
            return
        corners = [np.rint(points * 2**SHIFT).astype(np.int32)]
        if alpha >= 1 or self.image.shape[2] == 3:
            cv2.fillPoly(self.image, corners, (*_byte(colour), 255), cv2.LINE_AA, SHIFT)
        else:
            premultiplied = _byte(_scaled(colour, alpha))
            cv2.fillPoly(self.image, corners, (*premultiplied, round(255 * alpha)), cv2.LINE_AA, SHIFT)

    def spread(self, origin: FloatArray, along: FloatArray, down: FloatArray, texture: ByteArray) -> None:
        """Paint a texture (h, w, 3) on the parallelogram with a corner (3,) and the sides `along` and `down` (3,), m."""
        corners = np.stack([origin, origin + along, origin + along + down, origin + down])
        points = self.project(corners)
        if len(points) < 3:
            return
        h, w = texture.shape[:2]
        plane = self.projection @ np.column_stack(
            [np.append(along / w, 0), np.append(down / h, 0), np.append(origin + along / (2 * w) + down / (2 * h), 1)]
        )
        low = np.clip(np.floor(points.min(0)), 0, self.image.shape[1::-1]).astype(int)
        high = np.clip(np.ceil(points.max(0)) + 1, 0, self.image.shape[1::-1]).astype(int)
        if np.any(high - low < 1):
            return
        shift = np.array([[1, 0, -low[0]], [0, 1, -low[1]], [0, 0, 1.0]])
        size = (int(high[0] - low[0]), int(high[1] - low[1]))
        seen = cv2.warpPerspective(
            texture, shift @ plane, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        mask = np.zeros((size[1], size[0]), np.uint8)
        cv2.fillPoly(mask, [np.rint((points - low) * 2**SHIFT).astype(np.int32)], 255, cv2.LINE_AA, SHIFT)
        window = self.image[low[1] : high[1], low[0] : high[0]]
        share = mask[..., None].astype(np.float32) / 255
        window[:] = np.rint(window * (1 - share) + seen * share).astype(np.uint8)


def paint_lines(image: ByteArray, projection: FloatArray, lines: Sequence[CourtLine], colour: Colour) -> None:
    """Paint lines of the plane z = 0 onto an image (h, w, 3 or 4), in place; each pixel by the share that is covered."""
    from_court = projection[:, [0, 1, 3]]
    to_court = np.linalg.inv(from_court)
    value = np.array([*_byte(colour), 255][: image.shape[2]], np.float64)
    painter = _Painter(projection, image)
    for line in lines:
        a, b = np.array(line.start), np.array(line.end)
        along = (b - a) / np.linalg.norm(b - a)
        across = np.array([-along[1], along[0]])
        wide = line.width / 2 + 0.06
        around = np.stack([a - wide * along - wide * across, b + wide * along - wide * across,
                           b + wide * along + wide * across, a - wide * along + wide * across])  # fmt: skip
        mask = np.zeros(image.shape[:2], np.uint8)
        points = painter.project(np.column_stack([around, np.zeros(4)]))
        if len(points) < 3:
            continue
        cv2.polylines(mask, [np.rint(points).astype(np.int32)], True, 255, 5)
        cv2.fillPoly(mask, [np.rint(points).astype(np.int32)], 255)
        y, x = np.nonzero(mask)
        seen = np.column_stack([x, y, np.ones(len(x))]) @ to_court.T
        place, depth = seen[:, :2] / seen[:, 2:], seen[:, 2]
        share = np.ones(len(x))
        for axis, middle, half in ((across, a, line.width / 2), (along, (a + b) / 2, np.linalg.norm(b - a) / 2)):
            off = (place - middle) @ axis
            # m by which this distance changes from a pixel to the next
            slope = (to_court[:2, :2].T @ axis - np.outer(place @ axis, to_court[2, :2])) / depth[:, None]
            pixel = np.linalg.norm(slope, axis=1) + 1e-9
            inner, outer = (off - half) / pixel, (off + half) / pixel
            share *= np.clip(outer + 0.5, 0, 1) - np.clip(inner + 0.5, 0, 1)
        was = image[y, x].astype(np.float64)
        image[y, x] = np.rint(was + (value - was) * share[:, None]).astype(np.uint8)


def _paint_surroundings(
    rng: np.random.Generator, painter: _Painter, sport: Sport, look: CourtLook, view: View
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Paint floor, walls, stands and people; returns places (K, 3) of spectators, and of others, who move."""
    is_side, floor, scale = (
        sport.is_filmed_from_side,
        sport.floor,
        {"badminton": 1.0, "tennis": 1.7}.get(sport.name, 1.0),
    )
    length, width = (sport.width, sport.length) if is_side else (sport.length, sport.width)
    # metres behind the court and beside it where the boards stand
    behind, beside = (rng.uniform(2.2, 5.0), rng.uniform(4.0, 7.0)) if is_side else (
        rng.uniform(2.0, 5.0) * scale, rng.uniform(2.5, 5.0) * scale)  # fmt: skip
    before = 12.0

    def place(depth: float, side: float, z: float) -> FloatArray:
        return np.array([side, depth, z] if is_side else [depth, side, z])

    end, left, right = length + behind, -beside, width + beside
    board, has_stands = (
        rng.uniform(0.7, 1.1) * (rng.uniform(1, 3) if sport.name == "tennis" else 1),
        rng.random() < (0.9 if view == "broadcast" else 0.3),
    )
    rise, back = rng.uniform(4, 9), rng.uniform(8, 15)
    if has_stands:
        crowd = _make_crowd(rng, look)
        painter.spread(
            place(end + back, left - back, floor + board + rise),
            place(0, right - left + 2 * back, 0),
            place(-back, 0, -rise),
            crowd,
        )
        for edge, out in ((left, -1.0), (right, 1.0)):
            painter.spread(
                place(end + back, edge + out * back, floor + board + rise),
                place(-end - before - back, 0, 0),
                place(0, -out * back, -rise),
                crowd,
            )
    else:
        wall = rng.uniform(4, 9)
        painter.spread(
            place(end, left, floor + wall), place(0, right - left, 0), place(0, 0, -wall), _make_wall(rng, look)
        )
        for edge in (left, right):
            painter.spread(
                place(end, edge, floor + wall), place(-end - before, 0, 0), place(0, 0, -wall), _make_wall(rng, look)
            )
    painter.fill(
        [
            place(-before, left - 9, floor),
            place(end + 0.5, left - 9, floor),
            place(end + 0.5, right + 9, floor),
            place(-before, right + 9, floor),
        ],
        look.floor,
    )
    texture = _make_floor(rng, sport, look, before, end, left, right)
    painter.spread(place(-before, left, floor), place(end + before, 0, 0), place(0, right - left, 0), texture)
    if has_stands or rng.random() < 0.4:
        for edge in (left, right):
            painter.spread(
                place(-before, edge, floor + board),
                place(end + before, 0, 0),
                place(0, 0, -board),
                _make_boards(rng, look, 10),
            )
        painter.spread(
            place(end, left, floor + board), place(0, right - left, 0), place(0, 0, -board), _make_boards(rng, look, 5)
        )
    people = _paint_officials(rng, painter, sport, look, (end, left, right))
    depth = rng.uniform(0.1, 0.7, 12) * back
    seats = [place(end + d, rng.uniform(left, right), floor + board + rise * d / back + 0.5) for d in depth]
    return np.array(seats) if has_stands else np.empty((0, 3)), people


def _make_floor(
    rng: np.random.Generator, sport: Sport, look: CourtLook, before: float, end: float, left: float, right: float
) -> ByteArray:  # fmt: skip
    """Make the texture of the floor: runoff and court, wear, letters; rows across, columns along the view."""
    w, h = (int(v * FLOOR_RESOLUTION) for v in (end + before, right - left))
    texture = np.empty((h, w, 3), np.float32)
    texture[:] = _byte(look.floor)
    is_side = sport.is_filmed_from_side
    length, width = (sport.width, sport.length) if is_side else (sport.length, sport.width)

    def area(out_along: float, out_across: float) -> tuple[slice, slice]:
        rows, columns = (
            (-out_across - left, width + out_across - left),
            (before - out_along, before + length + out_along),
        )
        a, b, c, d = (max(int(round(v * FLOOR_RESOLUTION)), 0) for v in (*rows, *columns))
        return slice(a, b), slice(c, d)

    if not is_side:
        texture[
            area(rng.uniform(1.0, 3.0) if sport.name == "badminton" else 0.9 * (end - length), rng.uniform(0.6, 2.0))
        ] = _byte(look.runoff)
        texture[area(0.0, 0.0)] = _byte(look.court)
    wear = sum(_smooth_noise(rng, (h, w), size) * share for size, share in ((60, 0.5), (12, 0.3), (2, 0.2)))
    texture *= 1 + np.float32(rng.uniform(0.02, 0.12 if look.surface in ("clay", "grass") else 0.05)) * wear[..., None]
    if look.surface == "grass" or rng.random() < 0.15:
        stripes = np.sign(np.sin(np.arange(w) / FLOOR_RESOLUTION * rng.uniform(1.5, 5.0)))
        texture *= (1 + np.float32(rng.uniform(0.01, 0.05)) * stripes.astype(np.float32))[None, :, None]
    finished = np.clip(texture, 0, 255).astype(np.uint8)
    for _ in range(int(rng.integers(0, 7))):
        ink = _byte(look.line) if rng.random() < 0.8 else rng.integers(0, 256, 3).tolist()
        word = _letters(rng, (rng.integers(40, 140), rng.integers(20, 45)), (0, 0, 0), ink)
        if not is_side:
            word = np.ascontiguousarray(np.rot90(word, -1))
        _stamp(rng, finished, word, (sport.floor == 0.0 and rng.random() < 0.8, area(0.3, 0.3)))
    return finished


def _stamp(
    rng: np.random.Generator, texture: ByteArray, word: ByteArray, away: tuple[bool, tuple[slice, slice]]
) -> None:
    """Write letters somewhere on the floor, in place; mostly beside the court."""
    h, w = word.shape[:2]
    for _ in range(20):
        y, x = int(rng.integers(0, max(texture.shape[0] - h, 1))), int(rng.integers(0, max(texture.shape[1] - w, 1)))
        rows, columns = away[1]
        is_on_court = y < rows.stop and y + h > rows.start and x < columns.stop and x + w > columns.start
        if not (away[0] and is_on_court) and texture[y : y + h, x : x + w].shape == word.shape:
            mask = word.max(axis=2, keepdims=True) > 40
            texture[y : y + h, x : x + w] = np.where(mask, word, texture[y : y + h, x : x + w])
            return


def _smooth_noise(rng: np.random.Generator, shape: tuple[int, int], size: float) -> Float32Array:
    """Return noise (h, w) of standard deviation about 1 that changes over `size` pixels."""
    small = rng.normal(size=(int(shape[0] / size) + 3, int(shape[1] / size) + 3)).astype(np.float32)
    return np.asarray(cv2.resize(small, shape[::-1], interpolation=cv2.INTER_CUBIC), np.float32)


def _letters(rng: np.random.Generator, size: Sequence[int], ground: Sequence[int], ink: Sequence[int]) -> ByteArray:
    """Draw a word, or a sign, on a board of a size (width, height)."""
    w, h = int(size[0]), int(size[1])
    board = np.empty((h, w, 3), np.uint8)
    board[:] = ground
    word = "".join(rng.choice(list(string.ascii_uppercase + string.digits), int(rng.integers(3, 10))))
    font, bold = (
        int(rng.choice([cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_TRIPLEX])),
        int(rng.integers(1, 4)),
    )
    (text_w, text_h), _ = cv2.getTextSize(word, font, 1.0, bold)
    scale = min(0.75 * w / text_w, 0.55 * h / text_h)
    at = (int((w - scale * text_w) / 2), int((h + scale * text_h) / 2))
    cv2.putText(board, word, at, font, scale, [int(c) for c in ink], max(1, round(bold * scale)), cv2.LINE_AA)
    if rng.random() < 0.4:
        spot = (int(rng.uniform(0.05, 0.95) * w), int(rng.uniform(0.3, 0.7) * h))
        cv2.circle(board, spot, max(int(rng.uniform(0.08, 0.3) * h), 1), [int(c) for c in ink], -1, cv2.LINE_AA)
    return board


def _make_boards(rng: np.random.Generator, look: CourtLook, count: int) -> ByteArray:
    """Make a row of boards with letters, most of them white."""
    is_uniform, own = rng.random() < 0.4, look.banners[0]
    boards = []
    for _ in range(count):
        ground = own if is_uniform else look.banners[int(rng.integers(len(look.banners)))]
        ink = (240, 240, 240) if rng.random() < 0.75 else _byte(sample_tint(rng, (0.1, 1.0), (0.0, 1.0)))
        boards.append(_letters(rng, (160, 48), _byte(ground), ink))
    return np.concatenate(boards, axis=1)


def _make_wall(rng: np.random.Generator, look: CourtLook) -> ByteArray:
    """Make a wall with windows, doors and seams."""
    wall = np.empty((240, 640, 3), np.uint8)
    wall[:] = _byte(look.wall)
    for _ in range(int(rng.integers(0, 9))):
        x, y = int(rng.integers(0, 600)), int(rng.integers(0, 200))
        colour = _byte(sample_tint(rng, (0.05, 1.0), (0.0, 0.5)))
        cv2.rectangle(wall, (x, y), (x + int(rng.integers(5, 90)), y + int(rng.integers(5, 90))), colour, -1)
    light = 1 + 0.12 * _smooth_noise(rng, (240, 640), 90)[..., None]
    return np.clip(wall * light, 0, 255).astype(np.uint8)


def _make_crowd(rng: np.random.Generator, look: CourtLook) -> ByteArray:
    """Make rows of seats with spectators."""
    h, w = 520, 1500
    texture = np.empty((h, w, 3), np.uint8)
    texture[:] = _byte(look.stands)
    dark, full, step = rng.uniform(0.15, 1.0), rng.uniform(0.15, 0.95), 22
    for row in range(step, h + step, step):
        cv2.rectangle(texture, (0, row - 6), (w, row), _byte(_scaled(look.stands, 0.7)), -1)
        for x in range(4, w, 15):
            if rng.random() > full:
                continue
            at = (x + int(rng.integers(-2, 3)), row - 6 + int(rng.integers(-2, 2)))
            shirt = (0.9, 0.9, 0.9) if rng.random() < 0.2 else sample_tint(rng, (0.05, 0.9), (0.0, 0.9))
            cv2.ellipse(texture, at, (6, 8), 0, 180, 360, _byte(_scaled(shirt, dark)), -1, cv2.LINE_AA)
            skin = rng.uniform(0.3, 1.0) * dark
            cv2.circle(texture, (at[0], at[1] - 11), 3, _byte((0.88 * skin, 0.68 * skin, 0.55 * skin)), -1, cv2.LINE_AA)
    light = np.linspace(rng.uniform(0.2, 1.0), 1.0, h)[:, None, None]
    return np.clip(texture * light, 0, 255).astype(np.uint8)


def _paint_officials(
    rng: np.random.Generator, painter: _Painter, sport: Sport, look: CourtLook, bounds: tuple[float, float, float]
) -> FloatArray:  # fmt: skip
    """Paint people who sit or stand beside the court, and boxes, farther ones first; returns those who move (K, 3)."""
    (end, left, right), movers = bounds, []
    spots = [(end - 0.6, rng.uniform(left, right)) for _ in range(int(rng.integers(0, 6)))]
    spots += [
        (rng.uniform(-2, end), float(rng.choice([left + 0.6, right - 0.6]))) for _ in range(int(rng.integers(0, 8)))
    ]
    if not sport.is_filmed_from_side:
        spots.append((sport.length / 2, -1.3 if rng.random() < 0.5 else sport.width + 1.3))
    for depth, side in sorted(spots, key=lambda spot: -spot[0]):
        x, y = (side, depth) if sport.is_filmed_from_side else (depth, side)
        half, tall = rng.uniform(0.2, 0.6), rng.uniform(0.3, 1.0)
        if rng.random() < 0.6:
            _paint_box(painter, (x, y), half, sport.floor, tall, sample_tint(rng, (0.05, 0.8), (0.0, 0.9)))
        if rng.random() < 0.75:
            feet = np.array([x, y, sport.floor + (rng.uniform(0.0, 0.9) if rng.random() < 0.3 else 0.0)])
            if rng.random() < 0.4:
                movers.append(feet)
            else:
                draw_capsules(painter.image, painter.projection, make_figure(rng, feet, sample_outfit(rng)))
    return np.array(movers).reshape(-1, 3)


def _paint_box(
    painter: _Painter, at: tuple[float, float], half: float, low: float, tall: float, colour: Colour
) -> None:
    x, y = at
    ring = [(x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half)]
    for (ax, ay), (bx, by), share in zip(ring[1:] + ring[:1], ring[2:] + ring[:2], (0.6, 0.9, 0.7, 0.8), strict=True):
        painter.fill([(ax, ay, low), (bx, by, low), (bx, by, low + tall), (ax, ay, low + tall)], _scaled(colour, share))
    painter.fill([(px, py, low + tall) for px, py in ring], colour)


def _paint_table(rng: np.random.Generator, painter: _Painter, sport: Sport, look: CourtLook) -> None:
    """Paint a table with its legs, sides and lines."""
    length, width, thick = sport.length, sport.width, 0.04
    legs, dark = sample_tint(rng, (0.05, 0.7), (0.0, 0.8)), _scaled(look.court, 0.5)
    for x in (0.35, length - 0.35) if rng.random() < 0.6 else (0.5 * length - 0.3, 0.5 * length + 0.3):
        for y in (width - 0.2, 0.2):
            draw_capsules(
                painter.image,
                painter.projection,
                [Capsule(np.array([x, y, sport.floor]), np.array([x, y, -thick]), 0.035, 0.035, legs)],
            )
    if rng.random() < 0.4:
        painter.fill(
            [(0.8, 0.3, -0.7), (length - 0.8, 0.3, -0.7), (length - 0.5, 0.3, -thick), (0.5, 0.3, -thick)], legs
        )
    ring = [(0.0, 0.0), (length, 0.0), (length, width), (0.0, width)]
    for (ax, ay), (bx, by) in zip(ring[2:] + ring[:2], ring[3:] + ring[:3], strict=True):
        painter.fill([(ax, ay, -thick), (bx, by, -thick), (bx, by, 0), (ax, ay, 0)], dark)
    painter.fill([(x, y, 0.0) for x, y in ring], look.court)
    paint_lines(painter.image, painter.projection, sport.lines, look.line)


def _paint_net(rng: np.random.Generator, painter: _Painter, sport: Sport, look: CourtLook) -> None:
    """Paint mesh, tape and posts."""
    net, x, width = sport.net, sport.length / 2, sport.width
    bottom = 0.76 if sport.name == "badminton" else 0.0
    y = np.linspace(-net.overhang, width + net.overhang, 41)
    top = net.height_at(y, width)
    tape = {"badminton": 0.0375, "tennis": 0.06}.get(sport.name, 0.015)
    lower = top - tape

    def band(low: FloatArray, high: FloatArray) -> FloatArray:
        xs = np.full(2 * len(y), x)
        return np.column_stack([xs, np.concatenate([y, y[::-1]]), np.concatenate([low, high[::-1]])])

    ink = _scaled((0.1, 0.1, 0.1), 1.0) if sport.name == "tennis" or rng.random() < 0.7 else (0.45, 0.3, 0.2)
    painter.fill(band(np.full_like(y, bottom), lower), ink, look.mesh)
    cell = {"badminton": 0.02, "tennis": 0.045}.get(sport.name, 0.0125)
    scale = np.linalg.norm(
        np.diff(painter.project(np.array([[x, 0, bottom], [x, 1, bottom], [x, 0.5, bottom]]))[:2], axis=0)
    )
    if scale * cell > 2.5:
        faint = _byte(_scaled(ink, 0.9))
        for side in np.arange(y[0], y[-1], cell):
            self_top = float(net.height_at(np.array(side), width)) - tape
            _line(painter, (x, side, bottom), (x, side, self_top), (*faint, 200))
        for z in np.arange(bottom, net.height - tape, cell):
            _line(painter, (x, y[0], z), (x, y[-1], z), (*faint, 200))
    painter.fill(band(lower, top), look.tape)
    if sport.name == "tennis":
        middle = width / 2
        painter.fill(
            [
                (x, middle - 0.025, 0),
                (x, middle + 0.025, 0),
                (x, middle + 0.025, net.height),
                (x, middle - 0.025, net.height),
            ],
            look.tape,
        )
    post = 0.02 if sport.name != "table-tennis" else 0.006
    colour = sample_tint(rng, (0.05, 0.9), (0.0, 0.9))
    foot = sport.floor if sport.name != "table-tennis" else 0.0
    for side in (y[0], y[-1]):
        draw_capsules(
            painter.image,
            painter.projection,
            [Capsule(np.array([x, side, foot]), np.array([x, side, net.post_height]), post, post, colour)],
        )


def _line(
    painter: _Painter, a: tuple[float, float, float], b: tuple[float, float, float], colour: tuple[int, ...]
) -> None:
    ends = np.array([a, b, b])
    points = np.rint(painter.project(ends) * 2**SHIFT).astype(int)
    if len(points) == 3:
        cv2.line(painter.image, points[0].tolist(), points[1].tolist(), colour, 1, cv2.LINE_AA, SHIFT)


def _shade(image: ByteArray, look: CourtLook) -> None:
    """Change the brightness over the image, in place, as uneven lamps and a lens do."""
    h, w = image.shape[:2]
    x, y = np.meshgrid(np.linspace(-1, 1, 64), np.linspace(-1, 1, 36))
    light = 1 + look.shading[0] * x + look.shading[1] * y - look.shading[2] * (x**2 + y**2) / 2
    full = cv2.resize(light.astype(np.float32), (w, h), interpolation=cv2.INTER_LINEAR)
    np.clip(image * full[..., None], 0, 255, out=image, casting="unsafe")


def _byte(colour: Colour) -> tuple[int, int, int]:
    r, g, b = (int(round(255 * min(max(c, 0.0), 1.0))) for c in colour)
    return (r, g, b)


def _scaled(colour: Colour, share: float) -> Colour:
    r, g, b = (c * share for c in colour)
    return (r, g, b)
