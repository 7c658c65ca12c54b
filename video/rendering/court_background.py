"""What stands still in a rendered court: floor, lines, boards with letters, spectators, officials, table and net.

It is painted once per camera onto canvases larger and finer than the frames, without lens distortion; a frame is
warped from them. Painting order is back to front.
"""

from __future__ import annotations

import string
from collections.abc import Callable, Sequence
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
# m of floor before the court.
BEFORE = 12.0
# m: lower edge of the mesh of a net, height of its tape, radius of its posts.
NETS = {"badminton": (0.76, 0.0375, 0.02), "tennis": (0.0, 0.06, 0.03), "table-tennis": (0.0, 0.015, 0.006)}


@dataclass(frozen=True, slots=True, eq=False)
class CourtCanvas:
    """Paintings of a court without what moves."""

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
    soft = max(look.blur, 0.4) * FINENESS
    background, over = (
        np.asarray(cv2.GaussianBlur(image, (0, 0), soft), np.uint8) for image in (painter.image, net.image)
    )
    below = empty if table is None else np.asarray(cv2.GaussianBlur(table.image, (0, 0), soft), np.uint8)
    return CourtCanvas(to_canvas, background, below, over, crowd, people)


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
        return np.asarray(np.clip(ends[:, :2] / ends[:, 2:], -2e4, 2e4))

    def fill(self, polygon: Sequence[Sequence[float]] | FloatArray, colour: Colour, alpha: float = 1.0) -> None:
        """Fill a polygon (n, 3), m; other opacities than 1 are for layers."""
        points = self.project(np.asarray(polygon, np.float64))
        if len(points) < 3:
            return
        corners = [np.rint(points * 2**SHIFT).astype(np.int32)]
        cv2.fillPoly(self.image, corners, (*_byte(_scaled(colour, alpha)), round(255 * alpha)), cv2.LINE_AA, SHIFT)

    def spread(self, origin: FloatArray, along: FloatArray, down: FloatArray, texture: ByteArray) -> None:
        """Paint a texture (h, w, 3) on a parallelogram: a corner (3,), and the sides `along` and `down` (3,), m."""
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
        picture = cv2.warpPerspective(texture, shift @ plane, size, borderMode=cv2.BORDER_REPLICATE)
        mask = np.zeros((size[1], size[0]), np.uint8)
        cv2.fillPoly(mask, [np.rint((points - low) * 2**SHIFT).astype(np.int32)], 255, cv2.LINE_AA, SHIFT)
        window = self.image[low[1] : high[1], low[0] : high[0]]
        share = mask[..., None].astype(np.float32) / 255
        window[:] = np.rint(window * (1 - share) + picture * share).astype(np.uint8)


def paint_lines(image: ByteArray, projection: FloatArray, lines: Sequence[CourtLine], colour: Colour) -> None:
    """Paint lines of the plane z = 0 onto an image (h, w, 3 or 4), in place; each pixel by its covered share."""
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
        rays = np.column_stack([x, y, np.ones(len(x))]) @ to_court.T
        place, depth = rays[:, :2] / rays[:, 2:], rays[:, 2]
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
    is_side, floor, scale = sport.is_filmed_from_side, sport.floor, 1.7 if sport.name == "tennis" else 1.0
    length, width = (sport.width, sport.length) if is_side else (sport.length, sport.width)
    # m behind the court and beside it where the boards stand
    behind, beside = rng.uniform(2.1, 5.0) * scale, rng.uniform(*((4.0, 7.0) if is_side else (2.5, 5.0))) * scale
    end, left, right = length + behind, -beside, width + beside
    board = rng.uniform(0.7, 1.1) * (rng.uniform(1, 3) if sport.name == "tennis" else 1)
    has_stands = rng.random() < (0.9 if view == "broadcast" else 0.3)

    def place(depth: float, side: float, z: float) -> FloatArray:
        return np.array([side, depth, z] if is_side else [depth, side, z], np.float64)

    def enclose(low: float, high: float, back: float, make: Callable[[int], ByteArray]) -> None:
        """Paint what surrounds the court on three sides, from one height to another, `back` m sloping backwards."""
        for edge, out in ((left, -back), (right, back)):
            texture = make(10)
            painter.spread(
                place(-BEFORE, edge + out, high), place(end + BEFORE + back, 0, 0), place(0, -out, low - high), texture
            )
        painter.spread(
            place(end + back, left - back, high),
            place(0, right - left + 2 * back, 0),
            place(-back, 0, low - high),
            make(5),
        )

    rise, back = rng.uniform(4, 9), rng.uniform(8, 15)
    if has_stands:
        crowd = _make_crowd(rng, look)
        enclose(floor + board, floor + board + rise, back, lambda _: crowd)
    else:
        enclose(floor, floor + rise, 0.0, lambda _: _make_wall(rng, look))
    painter.fill(
        np.stack(
            [
                place(d, s, floor)
                for d, s in ((-BEFORE, left - 9), (end, left - 9), (end, right + 9), (-BEFORE, right + 9))
            ]
        ),
        look.floor,
    )
    texture = _make_floor(rng, sport, look, end, left, right)
    painter.spread(place(-BEFORE, left, floor), place(end + BEFORE, 0, 0), place(0, right - left, 0), texture)
    if has_stands or rng.random() < 0.4:
        enclose(floor, floor + board, 0.0, lambda count: _make_boards(rng, look, count))
    people = _paint_officials(rng, painter, sport, (end, left, right))
    rows = rng.uniform(0.1, 0.7, 12 if has_stands else 0)
    seats = [place(end + d * back, rng.uniform(left, right), floor + board + rise * d + 0.5) for d in rows]
    return np.array(seats).reshape(-1, 3), people


def _make_floor(
    rng: np.random.Generator, sport: Sport, look: CourtLook, end: float, left: float, right: float
) -> ByteArray:  # fmt: skip
    """Make the texture of the floor: runoff and court, wear, letters; rows across, columns along the view."""
    w, h = (int(v * FLOOR_RESOLUTION) for v in (end + BEFORE, right - left))
    texture = np.empty((h, w, 3), np.float32)
    texture[:] = _byte(look.floor)

    def area(along: float, across: float) -> tuple[slice, slice]:
        """Return rows and columns of the court and what is `along` behind its ends and `across` beside it."""
        spans = ((-across - left, sport.width + across - left), (BEFORE - along, BEFORE + sport.length + along))
        rows, columns = (slice(*(max(round(v * FLOOR_RESOLUTION), 0) for v in span)) for span in spans)
        return rows, columns

    if not sport.is_filmed_from_side:
        out = rng.uniform(1.0, 3.0) if sport.name == "badminton" else 0.9 * (end - sport.length)
        texture[area(out, rng.uniform(0.6, 2.0))] = _byte(look.runoff)
        texture[area(0.0, 0.0)] = _byte(look.court)
    wear = np.zeros((h, w), np.float32)
    for size, part in ((60, 0.5), (12, 0.3), (2, 0.2)):
        wear += np.float32(part) * _smooth_noise(rng, (h, w), size)
    texture *= 1 + np.float32(rng.uniform(0.02, 0.12 if look.surface in ("clay", "grass") else 0.05)) * wear[..., None]
    if look.surface == "grass" or rng.random() < 0.15:
        stripes = np.sign(np.sin(np.arange(w) / FLOOR_RESOLUTION * rng.uniform(1.5, 5.0)))
        texture *= (1 + np.float32(rng.uniform(0.01, 0.05)) * stripes.astype(np.float32))[None, :, None]
    finished = np.clip(texture, 0, 255).astype(np.uint8)
    court = np.zeros((h, w), bool)
    court[area(0.3, 0.3)] = sport.floor == 0.0 and rng.random() < 0.8
    for _ in range(int(rng.integers(0, 9))):
        ink = _byte(look.line) if rng.random() < 0.8 else rng.integers(0, 256, 3).tolist()
        word = _letters(rng, (int(rng.integers(40, 140)), int(rng.integers(20, 45))), (0, 0, 0), ink)
        word = word if sport.is_filmed_from_side else np.rot90(word, -1)
        y, x = (int(rng.integers(0, max(whole - part, 1))) for whole, part in zip((h, w), word.shape, strict=False))
        spot = (slice(y, y + word.shape[0]), slice(x, x + word.shape[1]))
        # most floors bear letters beside the court only
        if not court[spot].any() and finished[spot].shape == word.shape:
            finished[spot] = np.where(word.max(axis=2, keepdims=True) > 40, word, finished[spot])
    return finished


def _smooth_noise(rng: np.random.Generator, shape: tuple[int, int], size: float) -> Float32Array:
    """Return noise (h, w) of standard deviation about 1 that changes over `size` pixels."""
    small = rng.normal(size=(int(shape[0] / size) + 3, int(shape[1] / size) + 3)).astype(np.float32)
    return np.asarray(cv2.resize(small, shape[::-1], interpolation=cv2.INTER_CUBIC), np.float32)


def _letters(rng: np.random.Generator, size: tuple[int, int], ground: Sequence[int], ink: Sequence[int]) -> ByteArray:
    """Draw a word, or a sign, on a board of a size (width, height)."""
    (w, h), ink = size, [int(c) for c in ink]
    board = np.empty((h, w, 3), np.uint8)
    board[:] = ground
    word = "".join(rng.choice(list(string.ascii_uppercase + string.digits), int(rng.integers(3, 10))))
    font, bold = int(rng.choice([cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_TRIPLEX])), int(rng.integers(1, 4))
    (text_w, text_h), _ = cv2.getTextSize(word, font, 1.0, bold)
    scale = min(0.75 * w / text_w, 0.55 * h / text_h)
    at = (int((w - scale * text_w) / 2), int((h + scale * text_h) / 2))
    cv2.putText(board, word, at, font, scale, ink, max(1, round(bold * scale)), cv2.LINE_AA)
    if rng.random() < 0.4:
        spot = (int(rng.uniform(0.05, 0.95) * w), int(rng.uniform(0.3, 0.7) * h))
        cv2.circle(board, spot, max(int(rng.uniform(0.08, 0.3) * h), 1), ink, -1, cv2.LINE_AA)
    return board


def _make_boards(rng: np.random.Generator, look: CourtLook, count: int) -> ByteArray:
    """Make a row of boards with letters, most of them white."""
    boards = []
    grounds = look.banners[:1] if rng.random() < 0.4 else look.banners
    for _ in range(count):
        ink = (240, 240, 240) if rng.random() < 0.75 else _byte(sample_tint(rng, (0.1, 1.0), (0.0, 1.0)))
        boards.append(_letters(rng, (160, 48), _byte(grounds[int(rng.integers(len(grounds)))]), ink))
    return np.concatenate(boards, axis=1)


def _make_wall(rng: np.random.Generator, look: CourtLook) -> ByteArray:
    """Make a wall with windows and doors."""
    wall = np.empty((240, 640, 3), np.uint8)
    wall[:] = _byte(look.wall)
    for _ in range(int(rng.integers(0, 9))):
        x, y, w, h = (int(v) for v in rng.uniform((0, 0, 5, 5), (600, 200, 90, 90)))
        cv2.rectangle(wall, (x, y), (x + w, y + h), _byte(sample_tint(rng, (0.05, 1.0), (0.0, 0.5))), -1)
    light = 1 + 0.12 * _smooth_noise(rng, (240, 640), 90)[..., None]
    return np.clip(wall * light, 0, 255).astype(np.uint8)


def _make_crowd(rng: np.random.Generator, look: CourtLook) -> ByteArray:
    """Make rows of seats with spectators."""
    h, w, step = 520, 1500, 22
    texture = np.empty((h, w, 3), np.uint8)
    texture[:] = _byte(look.stands)
    dark, full = rng.uniform(0.15, 1.0), rng.uniform(0.15, 0.95)
    for row in range(step, h + step, step):
        cv2.rectangle(texture, (0, row - 6), (w, row), _byte(_scaled(look.stands, 0.7)), -1)
        for x in np.arange(4, w, 15)[rng.random(100) < full]:
            at = (int(x + rng.integers(-2, 3)), int(row - 6 + rng.integers(-2, 2)))
            shirt = (0.9, 0.9, 0.9) if rng.random() < 0.2 else sample_tint(rng, (0.05, 0.9), (0.0, 0.9))
            cv2.ellipse(texture, at, (6, 8), 0, 180, 360, _byte(_scaled(shirt, dark)), -1, cv2.LINE_AA)
            skin = _scaled((0.88, 0.68, 0.55), rng.uniform(0.3, 1.0) * dark)
            cv2.circle(texture, (at[0], at[1] - 11), 3, _byte(skin), -1, cv2.LINE_AA)
    return np.clip(texture * np.linspace(rng.uniform(0.2, 1.0), 1.0, h)[:, None, None], 0, 255).astype(np.uint8)


def _paint_officials(
    rng: np.random.Generator, painter: _Painter, sport: Sport, bounds: tuple[float, float, float]
) -> FloatArray:  # fmt: skip
    """Paint people who sit or stand beside the court, and boxes, farther ones first; returns those who move (K, 3)."""
    (end, left, right), movers = bounds, []
    spots = [(end - 0.6, rng.uniform(left, right)) for _ in range(int(rng.integers(0, 6)))]
    spots += [(rng.uniform(-2, end), float(rng.choice([left + 0.6, right - 0.6]))) for _ in range(int(rng.integers(8)))]
    if not sport.is_filmed_from_side:
        spots.append((sport.length / 2, -1.3 if rng.random() < 0.5 else sport.width + 1.3))
    for depth, side in sorted(spots, key=lambda spot: -spot[0]):
        at = np.array([side, depth, sport.floor] if sport.is_filmed_from_side else [depth, side, sport.floor])
        if rng.random() < 0.6:
            # a box: from the camera, its front, sides and top
            size = np.array([rng.uniform(0.2, 0.6), rng.uniform(0.2, 0.6), rng.uniform(0.3, 1.0)])
            colour = sample_tint(rng, (0.05, 0.8), (0.0, 0.9))
            for turned, share in (([1, 0, 2], 0.7), ([0, 1, 2], 0.85)):
                for edge in (1.0, -1.0):
                    front = np.array([[-1, edge, 0], [1, edge, 0], [1, edge, 1], [-1, edge, 1]])[:, turned]
                    painter.fill(at + size * front, _scaled(colour, share))
            painter.fill(at + size * np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]]), colour)
        if rng.random() < 0.75:
            feet = at + np.array([0, 0, rng.uniform(0.0, 0.9) if rng.random() < 0.3 else 0.0])
            if rng.random() < 0.4:
                movers.append(feet)
            else:
                draw_capsules(painter.image, painter.projection, make_figure(rng, feet, sample_outfit(rng)))
    return np.array(movers).reshape(-1, 3)


def _paint_table(rng: np.random.Generator, painter: _Painter, sport: Sport, look: CourtLook) -> None:
    """Paint a table with its legs, sides and lines."""
    length, width, thick = sport.length, sport.width, 0.04
    legs, dark = sample_tint(rng, (0.05, 0.7), (0.0, 0.8)), _scaled(look.court, 0.5)
    for x in np.array([-1, 1]) * (length / 2 - 0.35 if rng.random() < 0.6 else 0.3) + length / 2:
        for y in (width - 0.2, 0.2):
            leg = Capsule(np.array([x, y, sport.floor]), np.array([x, y, -thick]), 0.035, 0.035, legs)
            draw_capsules(painter.image, painter.projection, [leg])
    if rng.random() < 0.4:
        painter.fill([(0.8, 0.3, -0.7), (length - 0.8, 0.3, -0.7), (length - 0.5, 0.3, 0), (0.5, 0.3, 0)], legs)
    ring = [(0.0, 0.0), (length, 0.0), (length, width), (0.0, width)]
    for (ax, ay), (bx, by) in zip(ring[2:] + ring[:2], ring[3:] + ring[:3], strict=True):
        painter.fill([(ax, ay, -thick), (bx, by, -thick), (bx, by, 0), (ax, ay, 0)], dark)
    painter.fill([(x, y, 0.0) for x, y in ring], look.court)
    paint_lines(painter.image, painter.projection, sport.lines, look.line)


def _paint_net(rng: np.random.Generator, painter: _Painter, sport: Sport, look: CourtLook) -> None:
    """Paint mesh, tape and posts."""
    net, x, width = sport.net, sport.length / 2, sport.width
    # m: lower edge of the mesh, height of the tape, radius of the posts
    bottom, tape, post = NETS[sport.name]
    y = np.linspace(-net.overhang, width + net.overhang, 41)
    top = net.height_at(y, width)

    def fill_band(low: FloatArray, high: FloatArray, colour: Colour, alpha: float = 1.0) -> None:
        ends = [np.concatenate(pair) for pair in ((y, y[::-1]), (low, high[::-1]))]
        painter.fill(np.column_stack([np.full(2 * len(y), x), *ends]), colour, alpha)

    ink = (0.1, 0.1, 0.1) if sport.name == "tennis" or rng.random() < 0.7 else (0.45, 0.3, 0.2)
    fill_band(np.full_like(y, bottom), top - tape, ink, look.mesh)
    fill_band(top - tape, top, look.tape)
    if sport.name == "tennis":
        sides = (width / 2 - 0.025, width / 2 + 0.025)
        painter.fill(
            [(x, sides[0], 0), (x, sides[1], 0), (x, sides[1], net.height), (x, sides[0], net.height)], look.tape
        )
    colour = sample_tint(rng, (0.05, 0.9), (0.0, 0.9))
    posts = [
        Capsule(np.array([x, at, 0.0]), np.array([x, at, net.post_height]), post, post, colour) for at in (y[0], y[-1])
    ]
    draw_capsules(painter.image, painter.projection, posts)


def _shade(image: ByteArray, look: CourtLook) -> None:
    """Change the brightness over the image, in place, as uneven lamps and a lens do."""
    x, y = np.meshgrid(np.linspace(-1, 1, 64), np.linspace(-1, 1, 36))
    light = 1 + look.shading[0] * x + look.shading[1] * y - look.shading[2] * (x**2 + y**2) / 2
    full = cv2.resize(light.astype(np.float32), image.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    np.clip(image * full[..., None], 0, 255, out=image, casting="unsafe")


def _byte(colour: Colour) -> tuple[int, int, int]:
    r, g, b = (round(255 * min(max(c, 0.0), 1.0)) for c in colour)
    return (r, g, b)


def _scaled(colour: Colour, share: float) -> Colour:
    r, g, b = (c * share for c in colour)
    return (r, g, b)
