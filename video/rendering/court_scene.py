"""Random looks and cameras of rendered courts, and the rally that is rendered, as values.

The rally comes from elsewhere, such as the simulator in `worlds/rallies.py`; `read_rally` reads what that one writes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from models.core.court import Sport
from models.core.court_camera import CourtCamera
from models.core.typing import FloatArray
from models.sports.sport_catalogue import find_sports

View = Literal["broadcast", "phone"]
Colour = tuple[float, float, float]
# s between two places of a player's feet.
FEET_STEP = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class RallyPath:
    """The true motion of a rally."""

    sport: Sport
    t: FloatArray
    """(S,) s, evenly spaced."""
    xyz: FloatArray
    """(S, 3) m."""
    nose: FloatArray
    """(S, 3) direction of the cork of a shuttle; anything for a ball."""
    feet: FloatArray
    """(N, F, 3) m, place of the feet of N players, and the way that they have run, every `FEET_STEP` from 0 on."""
    strokes: tuple[tuple[float, int, FloatArray], ...]
    """t, index of the player, place (3,)."""
    truth: Mapping[str, Any]
    """Events, strokes and ending, as the simulator states them."""

    def place_at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Interpolate places (..., 3) and noses (..., 3) at times (...), s."""
        row = np.clip((t - self.t[0]) / (self.t[1] - self.t[0]), 0, len(self.t) - 1.001)
        low = row.astype(np.int64)
        share = (row - low)[..., None]
        place, nose = ((a[low] * (1 - share) + a[low + 1] * share) for a in (self.xyz, self.nose))
        return place, nose

    def feet_at(self, player: int, t: FloatArray) -> FloatArray:
        """Interpolate where a player stands (..., 2), m, and the way run (...,), m, at times (...), s: (..., 3)."""
        row = np.clip(np.asarray(t) / FEET_STEP, 0, self.feet.shape[1] - 1.001)
        low = row.astype(np.int64)
        share = (row - low)[..., None]
        return np.asarray(self.feet[player, low] * (1 - share) + self.feet[player, low + 1] * share)


def read_rally(path: Path) -> RallyPath:
    """Read a rally from the two files of `worlds/rallies.py`; `path` is that of one of them."""
    truth = json.loads(path.with_suffix(".json").read_text())
    with np.load(path.with_suffix(".npz")) as arrays:
        t, xyz, nose = arrays["t"], arrays["xyz"], arrays["nose"]
    clock = np.arange(0, t[-1] + 2 * FEET_STEP, FEET_STEP)
    feet = np.zeros((len(truth["players"]), len(clock), 3))
    for player, track in enumerate(truth["players"]):
        points = np.array(track, np.float64)
        points = points[np.concatenate([[True], np.diff(points[:, 0]) > 1e-3])]
        within = np.clip(clock, points[0, 0], points[-1, 0])
        feet[player, :, :2] = (
            PchipInterpolator(points[:, 0], points[:, 1:])(within) if len(points) > 1 else points[0, 1:]
        )
        steps = np.hypot(*np.diff(feet[player, :, :2], axis=0).T)
        feet[player, 1:, 2] = np.cumsum(steps)
    strokes = tuple((s["t"], s["player"], np.array(s["place"])) for s in truth["strokes"])
    return RallyPath(find_sports()[truth["sport"]], t, xyz, nose, feet, strokes, truth)


@dataclass(frozen=True, slots=True)
class Outfit:
    """Colours (sRGB, 0 to 1) and size of a player."""

    shirt: Colour
    shorts: Colour
    shoes: Colour
    socks: Colour
    skin: Colour
    hair: Colour
    racket: Colour
    size: float
    """Height over 1.75 m."""
    is_left: bool


@dataclass(frozen=True, slots=True)
class CourtLook:
    """Colours (sRGB, 0 to 1) of a court, and how its camera renders it."""

    surface: str
    court: Colour
    runoff: Colour
    floor: Colour
    line: Colour
    wall: Colour
    banners: tuple[Colour, ...]
    stands: Colour
    object: Colour
    opacity: float
    """Of the feathers of a shuttle."""
    tape: Colour
    mesh: float
    """Opacity of the net's mesh."""
    outfits: tuple[Outfit, ...]
    light: FloatArray
    """(3,) direction from which most light comes."""
    shadow: float
    """Opacity of shadows."""
    shading: tuple[float, float, float]
    """Change of brightness along x and y of the image, and darkening of its corners."""
    blur: float
    """px, standard deviation of the point spread."""
    noise: float
    """Standard deviation of the sensor noise at middle grey, of 255 levels."""
    scale: float
    """Of the resolution at which the frame was made before it was enlarged, at most 1."""
    sharpening: float
    exposure: float
    """s."""
    has_board: bool
    crf: int
    """Of the coding as H.264."""


def sample_tint(rng: np.random.Generator, value: tuple[float, float], saturation: tuple[float, float]) -> Colour:
    """Sample a colour with a range of brightness and of saturation, 0 to 1."""
    hue, s, v = rng.uniform(0, 6), rng.uniform(*saturation), rng.uniform(*value)
    channel = [v * (1 - s * float(np.clip(abs((hue + k) % 6 - 3) - 1, 0, 1))) for k in (0.0, 4.0, 2.0)]
    return (channel[0], channel[1], channel[2])


def _near(rng: np.random.Generator, colour: Colour, spread: float = 0.05) -> Colour:
    r, g, b = np.clip(np.array(colour) * rng.uniform(0.8, 1.15) + rng.normal(0, spread, 3), 0.01, 1)
    return (float(r), float(g), float(b))


def _dimmed(rng: np.random.Generator, colour: Colour) -> Colour:
    """Return a colour under lamps that are brighter or fainter than the camera expects."""
    r, g, b = np.clip(np.array(colour) * rng.uniform(0.65, 1.05) + rng.normal(0, 0.02, 3), 0.01, 1)
    return (float(r), float(g), float(b))


GREEN, BLUE, PURPLE, RED, WOOD, CLAY = (
    (0.25, 0.5, 0.36), (0.2, 0.33, 0.6), (0.36, 0.33, 0.55), (0.6, 0.25, 0.22), (0.68, 0.5, 0.32), (0.72, 0.42, 0.27),
)  # fmt: skip
GRASS, GREY, DARK = (0.42, 0.55, 0.28), (0.45, 0.45, 0.47), (0.12, 0.12, 0.16)
# Colours of the court and what surrounds it.
PAINTS: Mapping[str, tuple[Colour, ...]] = {
    "mat": (GREEN, GREEN, BLUE, RED, (0.1, 0.35, 0.3), WOOD), "hard": (BLUE, GREEN, PURPLE, (0.35, 0.55, 0.65), GREY),
    "clay": (CLAY,), "grass": (GRASS,), "table": (BLUE, (0.1, 0.2, 0.4), (0.12, 0.35, 0.28), (0.25, 0.25, 0.28)),
}  # fmt: skip
FLOORS: Mapping[str, tuple[Colour, ...]] = {
    "mat": (WOOD, BLUE, GREY, DARK, RED, GREEN), "hard": (GREEN, BLUE, RED, GREY, (0.55, 0.68, 0.42)),
    "clay": (CLAY,), "grass": (GRASS, (0.3, 0.45, 0.25)), "table": (RED, GREY, BLUE, DARK, WOOD),
}  # fmt: skip
BALLS: Mapping[str, tuple[Colour, ...]] = {
    "badminton": ((0.93, 0.93, 0.9), (0.97, 0.97, 0.97), (0.9, 0.93, 0.6)),
    "tennis": ((0.82, 0.92, 0.3), (0.75, 0.85, 0.25), (0.9, 0.95, 0.5)),
    "table-tennis": ((0.97, 0.97, 0.95), (0.98, 0.98, 0.98), (0.95, 0.6, 0.2)),
}


def sample_look(rng: np.random.Generator, sport: str, surface: str, view: View, fps: float) -> CourtLook:
    """Sample the look of a court."""
    paints, floors = PAINTS[surface], FLOORS[surface]
    court = _near(rng, paints[rng.integers(len(paints))])
    runoff = court if rng.random() < 0.4 else _near(rng, floors[rng.integers(len(floors))])
    floor = _near(rng, floors[rng.integers(len(floors))]) if sport != "tennis" or rng.random() < 0.3 else runoff
    balls, sunny = BALLS[sport], sport == "tennis" and bool(rng.random() < 0.6)
    away = rng.normal(0, 0.8 if sunny else 0.15, 2)
    soft = float(rng.uniform(0.4, 0.75) if view == "broadcast" else rng.uniform(0.35, 1.0))
    # fast shutters in daylight and under broadcast lamps
    slowest = min(1 / 50, 0.9 / fps)
    return CourtLook(
        surface, court, runoff, floor,
        _near(rng, (0.93, 0.93, 0.93), 0.02) if rng.random() < 0.92 else _near(rng, (0.9, 0.85, 0.3)),
        sample_tint(rng, (0.08, 0.6), (0.1, 0.9)),
        tuple(sample_tint(rng, (0.1, 0.9), (0.2, 0.95)) for _ in range(6)),
        sample_tint(rng, (0.04, 0.5), (0.0, 0.6)),
        _dimmed(rng, balls[rng.integers(len(balls))]), float(rng.uniform(0.25, 0.9)),
        _near(rng, (0.93, 0.93, 0.93), 0.02),
        float(rng.uniform(0.05, 0.35) if sport == "badminton" else rng.uniform(0.15, 0.45)),
        tuple(sample_outfit(rng) for _ in range(2)), np.array([*away, 1.0]) / np.linalg.norm([*away, 1.0]),
        float(rng.uniform(0.35, 0.6) if sunny else rng.uniform(0.05, 0.3)),
        (float(rng.normal(0, 0.08)), float(rng.normal(0, 0.1)), float(rng.uniform(0, 0.25))),
        soft, float(np.exp(rng.uniform(np.log(0.5), np.log(2.5 if view == "broadcast" else 5.0)))),
        float(rng.choice([1.0, 1.0, rng.uniform(0.6, 1.0)])), float(rng.choice([0.0, rng.uniform(0.0, 0.8)])),
        float(np.exp(rng.uniform(np.log(1 / 1000), np.log(slowest)))),
        bool(rng.random() < (0.85 if view == "broadcast" else 0.1)),
        int(rng.integers(17, 30)),
    )  # fmt: skip


def sample_outfit(rng: np.random.Generator) -> Outfit:
    """Sample the clothes of a player: white is common, above all of shoes."""

    def cloth(white: float) -> Colour:
        return (
            _near(rng, (0.93, 0.93, 0.93), 0.02) if rng.random() < white else sample_tint(rng, (0.05, 0.95), (0, 0.95))
        )

    skin = float(rng.uniform(0.25, 1.0))
    return Outfit(
        cloth(0.25), cloth(0.2), cloth(0.55), cloth(0.6), (0.88 * skin, 0.68 * skin, 0.55 * skin),
        _near(rng, (0.12, 0.1, 0.08), 0.03) if rng.random() < 0.8 else sample_tint(rng, (0.2, 0.9), (0.0, 0.5)),
        sample_tint(rng, (0.05, 0.95), (0.0, 0.9)), float(rng.uniform(0.93, 1.1)), bool(rng.random() < 0.12),
    )  # fmt: skip


def make_camera(
    sport: Sport, place: FloatArray, target: FloatArray, focal_px: float, k1: float, size: tuple[int, int],
    roll: float = 0.0,
) -> CourtCamera:  # fmt: skip
    """Make a camera at a place (3,), m, that looks at a target (3,); size is width and height, px; roll in rad."""
    forward = (target - place) / np.linalg.norm(target - place)
    is_left_handed = not sport.is_filmed_from_side
    sign = 1.0 if is_left_handed else -1.0
    right = sign * np.cross([0.0, 0.0, 1.0], forward)
    right /= np.linalg.norm(right)
    down = -sign * np.cross(forward, right)
    right, down = np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right
    turn = np.stack([right, down, forward]) @ np.diag([1.0, -sign, 1.0])
    vector = Rotation.from_matrix(turn).as_rotvec()
    parameters = np.concatenate([place, vector, [np.log(focal_px), k1]])
    return CourtCamera(parameters, np.zeros((8, 8)), size[0], size[1], is_left_handed)


def sample_camera(rng: np.random.Generator, sport: Sport, view: View, size: tuple[int, int]) -> CourtCamera:
    """Sample a camera that does not move yet: behind an end, or beside a table."""
    length, width = sport.length, sport.width
    for _ in range(3000):
        k1 = float(rng.normal(0, 0.01) if view == "broadcast" else rng.normal(-0.03, 0.03))
        if sport.is_filmed_from_side:
            if view == "broadcast":
                away, angle, share = rng.uniform(5, 10), rng.normal(0, 0.1), rng.uniform(0.27, 0.42)
                height = rng.uniform(1.3, 0.5 * away)
            else:
                away, angle, share = rng.uniform(2.6, 4.5), rng.normal(0, 0.35), rng.uniform(0.33, 0.55)
                height = rng.uniform(0.5, 1.3)
            place = np.array([length / 2 + away * np.sin(angle), width / 2 - away * np.cos(angle), height])
            focal = share * size[0] * away / length
            target = np.array([length / 2 + rng.normal(0, 0.15), width / 2, rng.uniform(-0.2, 0.35)])
        elif view == "broadcast":
            away, pitch = length * rng.uniform(0.75, 1.7), rng.uniform(0.28, 0.6)
            place = np.array([-away, width / 2 + rng.normal(0, 0.06) * width, (away + length / 2) * np.tan(pitch)])
            focal = rng.uniform(0.45, 0.72) * size[0] * np.hypot(away, place[2]) / width
            target = np.array([length * rng.uniform(0.38, 0.55), width / 2 + rng.normal(0, 0.02) * width, 0.5])
        else:
            away = rng.uniform(2.5, 6.0) if sport.name == "badminton" else rng.uniform(4.0, 9.0)
            place = np.array([-away, width * rng.uniform(-0.1, 1.1), rng.uniform(1.6, 4.5)])
            focal = size[0] / 2 / np.tan(np.radians(rng.uniform(50, 75)) / 2)
            target = np.array([length * rng.uniform(0.3, 0.55), width / 2 + rng.normal(0, 0.08) * width, 0.8])
        roll = float(rng.normal(0, 0.003 if view == "broadcast" else 0.02))
        camera = make_camera(sport, place, target, focal, k1, size, roll)
        # rallies that leave the picture show little; some do
        high = np.array([0.5 * length, width / 2, rng.uniform(2.5, 6.0)])
        behind = np.array([-rng.uniform(1.0, 4.5), width / 2, 0.0])
        is_high_enough = sport.name != "badminton" or camera.to_pixels(high)[1] > 0
        is_low_enough = sport.name != "tennis" or view == "phone" or camera.to_pixels(behind)[1] < size[1]
        if _shows_court(sport, camera, view) and is_high_enough and is_low_enough:
            return camera
    raise RuntimeError(f"no camera of a {view} view shows the court")


def _shows_court(sport: Sport, camera: CourtCamera, view: View) -> bool:
    """Check that the court is in the picture: all of it, or, for a phone, all but the nearer corners."""
    corners = np.column_stack([sport.corners, np.zeros(4)])
    px = camera.to_pixels(corners if view == "broadcast" or sport.is_filmed_from_side else corners[1:3])
    size = np.array([camera.width_px, camera.height_px])
    near = camera.to_pixels(np.array([0.25 * sport.length, sport.width / 2, 0.0]))
    far_px = np.linalg.norm(px[0] - px[1]) if len(px) == 2 else np.linalg.norm(px[1] - px[2])
    is_inside = bool(np.all((px > 0.01 * size) & (px < 0.99 * size)) and np.all((near > 0) & (near < size)))
    return is_inside and bool(far_px > 0.12 * size[0] or sport.is_filmed_from_side)


def sample_motion(
    rng: np.random.Generator, camera: CourtCamera, frames: int, fps: float, pan: float, shake: float, zoom: float
) -> FloatArray:  # fmt: skip
    """Sample homographies (T, 3, 3) of a camera that pans by about `pan` and shakes by `shake`, rad, and zooms."""
    turns = np.zeros((frames, 3))
    for size, seconds, axes in (
        (pan, 1.5, (1.0, 0.25, 0.02)),
        (shake, 0.15, (1.0, 1.0, 0.5)),
        (2 * shake, 0.7, (1.0, 1.0, 0.5)),
    ):
        turns += _wander(rng, frames, fps * seconds, 3) * np.array(axes) * size
    focal = np.exp(camera.parameters[6])
    zooms = np.exp(_wander(rng, frames, fps * 2.0, 1)[:, 0] * zoom)
    middle = np.array([[1, 0, (camera.width_px - 1) / 2], [0, 1, (camera.height_px - 1) / 2], [0, 0, 1.0]])
    before = np.linalg.inv(middle @ np.diag([focal, focal, 1.0]))
    rotation = Rotation.from_rotvec(turns[:, [1, 0, 2]]).as_matrix()
    after = middle @ np.stack([np.diag([focal * z, focal * z, 1.0]) for z in zooms])
    return np.asarray(after @ rotation @ before)


def _wander(rng: np.random.Generator, frames: int, span: float, count: int) -> FloatArray:
    """Return smooth random curves (T, count) of standard deviation 1 that change within `span` frames."""
    pad = int(4 * span) + 2
    rough = rng.normal(size=(frames + 2 * pad, count))
    smooth = gaussian_filter1d(rough, max(span, 0.3), axis=0)[pad : pad + frames]
    return np.asarray(smooth * np.sqrt(2 * np.sqrt(np.pi) * max(span, 0.3)))
