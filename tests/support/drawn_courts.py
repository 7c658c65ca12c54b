"""Simple pictures of courts from known cameras: lines, net, players, banners, noise, blur and compression."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from models.core.court import Sport
from models.core.court_camera import CourtCamera
from models.core.typing import FloatArray, ImageArray

Colour = tuple[int, int, int]
# Pictures are drawn larger by this factor and reduced, so that thin lines become faint rather than jagged.
OVERSAMPLING = 3


@dataclass(frozen=True)
class Looks:
    """Colours, RGB, and disturbances of a picture."""

    court: Colour = (60, 130, 80)
    ground: Colour = (40, 60, 140)
    wall: Colour = (30, 28, 34)
    paint: Colour = (235, 235, 230)
    tape: Colour = (225, 225, 220)
    players: int = 2
    banners: int = 10
    noise: float = 3.0
    blur: float = 0.7
    quality: int = 60
    rows: int = 0
    """Rows of a stand, each with a bright edge."""


LOOKS = {
    "badminton": Looks(),
    "tennis": Looks((85, 80, 150), (120, 165, 95)),
    "clay": Looks((190, 110, 70), (180, 105, 68), paint=(230, 220, 210), noise=5.0),
    "grass": Looks((90, 140, 60), (80, 130, 55), noise=6.0),
    "table-tennis": Looks((60, 62, 70), (75, 70, 75), paint=(215, 110, 190), tape=(210, 200, 215)),
    "blue table": Looks((40, 70, 150), (150, 60, 55)),
    "bright floor": Looks((45, 60, 68), (235, 215, 190), blur=1.0, players=0),
    "stand": Looks((0, 42, 95), (190, 50, 55), (40, 85, 75), rows=14),
}


def aim_camera(
    place: tuple[float, float, float], target: tuple[float, float, float], focal: float, *, is_left_handed: bool,
    size: tuple[int, int] = (1280, 720), k1: float = 0.0, roll: float = 0.0,
) -> CourtCamera:  # fmt: skip
    """Aim a camera of a focal length, px, from a place at a target, m, with a roll, rad."""
    flip = np.diag([1.0, -1.0, 1.0]) if is_left_handed else np.eye(3)
    ahead = flip @ (np.array(target) - np.array(place))
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross(ahead, [0, 0, 1.0])
    right = right / np.linalg.norm(right)
    turn = np.stack([right, np.cross(ahead, right), ahead])
    c, s = np.cos(roll), np.sin(roll)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ turn
    parameters = np.array([*place, *cv2.Rodrigues(turn)[0].ravel(), np.log(focal), k1])
    return CourtCamera(parameters, np.eye(8), *size, is_left_handed)


def draw_court(
    sport: Sport, camera: CourtCamera, looks: Looks, rng: np.random.Generator, *, has_net: bool = True
) -> ImageArray:
    """Draw a court (H, W, 3) RGB as a camera shows it."""
    factor = OVERSAMPLING
    height, width = camera.height_px, camera.width_px
    image = np.empty((height * factor, width * factor, 3), np.uint8)
    image[:] = looks.wall
    length, across = sport.length, sport.width
    margins = (8.0, 5.0) if sport.floor == 0 else (6.0, 4.0)
    _fill(image, camera, _outline(-margins[0], -margins[1], length + margins[0], across + margins[1]), sport.floor,
          looks.ground)  # fmt: skip
    _draw_rows(image, looks)
    _draw_banners(image, looks, rng)
    _draw_marks(image, sport, camera, margins)
    apron = 1.0 if sport.floor == 0 else 0.0
    _fill(image, camera, _outline(-apron, -apron, length + apron, across + apron), 0.0, looks.court)
    for line in sport.lines:
        (x1, y1), (x2, y2), w = line.start, line.end, line.width / 2
        is_across = x1 == x2
        _fill(image, camera, _outline(x1 - w * is_across, y1 - w * (not is_across), x2 + w * is_across,
                                      y2 + w * (not is_across)), 0.0, looks.paint)  # fmt: skip
    if has_net:
        _draw_net(image, sport, camera, looks)
    _draw_players(image, sport, camera, looks, rng)
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)
    small = cv2.GaussianBlur(small, (0, 0), looks.blur) + rng.normal(0, looks.noise, small.shape)
    coded = cv2.imencode(".jpg", np.clip(small, 0, 255).astype(np.uint8)[..., ::-1], [1, looks.quality])[1]
    decoded = cv2.imdecode(coded, cv2.IMREAD_COLOR)
    assert decoded is not None
    return np.ascontiguousarray(decoded[..., ::-1], np.uint8)


def _outline(x1: float, y1: float, x2: float, y2: float) -> FloatArray:
    """Return the outline (N, 2) of a rectangle, in many steps because lenses bend it."""
    corners = np.array([[x1, y1], [x2, y1], [x2, y2], [x1, y2], [x1, y1]])
    share = np.linspace(0, 1, 60, endpoint=False)[:, None]
    return np.concatenate([a + share * (b - a) for a, b in pairwise(corners)])


def _fill(image: ImageArray, camera: CourtCamera, xy: FloatArray, z: float | FloatArray, colour: Colour) -> None:
    xyz = np.column_stack([xy, np.broadcast_to(z, len(xy))])
    px = camera.to_pixels(_clip_to_front(xyz, camera))
    _fill_pixels(image, px, colour)


def _clip_to_front(xyz: FloatArray, camera: CourtCamera) -> FloatArray:
    """Clip an outline (N, 3) at a plane before the camera (Sutherland and Hodgman 1974)."""
    depth = xyz @ camera.matrix[2, :3] + camera.matrix[2, 3] - 0.2
    out = []
    for k in range(len(xyz)):
        a, b = depth[k], depth[(k + 1) % len(xyz)]
        if a > 0:
            out.append(xyz[k])
        if (a > 0) != (b > 0):
            out.append(xyz[k] + (xyz[(k + 1) % len(xyz)] - xyz[k]) * a / (a - b))
    return np.array(out).reshape(-1, 3)


def _fill_pixels(image: ImageArray, px: FloatArray, colour: Colour) -> None:
    if len(px) < 3:
        return
    places = np.clip(((px + 0.5) * OVERSAMPLING - 0.5) * 16, -1e6, 1e6)
    cv2.fillPoly(image, [np.rint(places).astype(np.int32)], colour, cv2.LINE_AA, 4)


def _draw_net(image: ImageArray, sport: Sport, camera: CourtCamera, looks: Looks) -> None:
    """Draw a dark half-transparent net with a bright tape of 5 % of its height."""
    y = np.linspace(-sport.net.overhang, sport.width + sport.net.overhang, 40)
    top = sport.net.height_at(y, sport.width)
    bottom = 0.5 * top if sport.name == "badminton" else 0 * top
    veiled = image.copy()
    for lower, canvas, colour in ((bottom, veiled, (30, 30, 30)), (0.945 * top, image, looks.tape)):
        if canvas is image:
            image[:] = cv2.addWeighted(image, 0.6, veiled, 0.4, 0)
        xyz = np.concatenate([np.column_stack([np.full_like(y, sport.length / 2), y, z]) for z in (top, lower)])
        xyz[len(y) :] = xyz[len(y) :][::-1]
        _fill_pixels(canvas, camera.to_pixels(xyz), colour)


def _draw_marks(image: ImageArray, sport: Sport, camera: CourtCamera, margins: tuple[float, float]) -> None:
    """Draw bright triangles that lie on the ground, always the same ones."""
    rng = np.random.default_rng(5)
    size = np.array([sport.length, sport.width])
    for _ in range(40):
        place = rng.uniform(-np.array(margins), size + np.array(margins))
        corners = place + rng.normal(0, 0.03 * sport.length, (3, 2))
        _fill(image, camera, corners, sport.floor, tuple(int(c) for c in rng.integers(90, 230, 3)))


def _draw_rows(image: ImageArray, looks: Looks) -> None:
    """Draw rows of a stand over the upper third of the picture."""
    height, width = image.shape[:2]
    for k in range(looks.rows):
        y = round(height / 3 * (k + 0.5) / looks.rows)
        cv2.line(image, (0, y + height // 60), (width, y), tuple(c + 40 for c in looks.wall), 5, cv2.LINE_AA)


def _draw_banners(image: ImageArray, looks: Looks, rng: np.random.Generator) -> None:
    """Draw bright bars and letters in the upper third of the picture."""
    height, width = image.shape[:2]
    for k in range(looks.banners):
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0, 0.25 * height))
        colour = tuple(int(c) for c in rng.integers(60, 255, 3))
        if k % 2:
            cv2.putText(image, "BANNER", (x, y), cv2.FONT_HERSHEY_SIMPLEX, height / 600, colour, height // 150)
        else:
            cv2.line(image, (x, y), (x + int(rng.uniform(0.1, 0.5) * width), y + int(rng.normal(0, 30))), colour, 6)


def _draw_players(image: ImageArray, sport: Sport, camera: CourtCamera, looks: Looks, rng: np.random.Generator) -> None:
    for k in range(looks.players):
        beyond = 0.6 if sport.floor < 0 else -0.15 * sport.length
        foot = np.array([-beyond if k % 2 else sport.length + beyond, rng.uniform(0.2, 0.8) * sport.width, sport.floor])
        px = camera.to_pixels(foot + np.array([[0, 0, 0], [0, 0, 1.8]]))
        if not np.isfinite(px).all():
            continue
        places = (px + 0.5) * OVERSAMPLING
        size = (float(np.linalg.norm(places[1] - places[0])) / 2, float(np.linalg.norm(places[1] - places[0])) / 7)
        angle = float(np.degrees(np.arctan2(*(places[1] - places[0])[::-1])))
        colour = tuple(int(c) for c in rng.integers(20, 230, 3))
        centre = tuple(int(c) for c in np.clip(places.mean(0), -1e5, 1e5))
        cv2.ellipse(image, centre, (int(size[0]), int(size[1])), angle, 0, 360, colour, -1, cv2.LINE_AA)
