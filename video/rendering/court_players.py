"""Players of rendered rallies: figures of tapered capsules that run, reach and swing their rackets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from models.core.typing import ByteArray, FloatArray
from video.rendering.court_scene import Colour, Outfit, RallyPath

SHIFT = 4
# Points (16, 2) of a unit circle.
CIRCLE = np.column_stack([np.cos(np.arange(16) * np.pi / 8), np.sin(np.arange(16) * np.pi / 8)])
# Places along half an arc, -1 to 1.
ARC = np.linspace(-1.0, 1.0, 8)
# s within which a stroke raises the racket, and the time in which it sweeps half of its arc.
SWING_S, SWEEP_S, SWEEP_RAD = 0.38, 0.055, 1.3
# m, from the hand to the middle of the head, and radius of the head.
RACKETS = {"badminton": (0.52, 0.11), "tennis": (0.50, 0.135), "table-tennis": (0.13, 0.078)}


@dataclass(frozen=True, slots=True)
class Capsule:
    """A tapered rod with round ends (3,), m, its radii, m, and colour."""

    a: FloatArray
    b: FloatArray
    radius_a: float
    radius_b: float
    colour: Colour


@dataclass(frozen=True, slots=True)
class Head:
    """The head of a racket: a disc, either open with a rim or filled."""

    centre: FloatArray
    axes: FloatArray
    """(2, 3) m, from the centre to the rim."""
    colour: Colour
    is_filled: bool


def make_figure(
    rng: np.random.Generator | None, feet: FloatArray, outfit: Outfit, facing: float = 0.0,
    stride: tuple[float, float] = (0.0, 0.0), hand: FloatArray | None = None, crouch: float = 0.0,
) -> list[Capsule]:  # fmt: skip
    """Make a person.

    Args:
        rng: draws a posture of somebody who sits or stands; None for a player.
        feet: (3,) m, between the feet.
        facing: rad, direction of the view in the plane.
        stride: phase and reach (m) of the steps.
        hand: (3,) m, place of the hand with the racket.
        crouch: share by which the knees are bent.
    """
    k = outfit.size
    if rng is not None:
        facing, crouch = rng.uniform(-np.pi, np.pi), rng.choice([0.05, 0.5])
    ahead = np.array([np.cos(facing), np.sin(facing), 0.0])
    aside, up = np.array([ahead[1], -ahead[0], 0.0]), np.array([0.0, 0.0, 1.0])
    hip_z = k * (0.92 - 0.35 * crouch)
    hips, lean = feet + hip_z * up - 0.1 * crouch * ahead, 0.15 + 0.5 * crouch
    neck = hips + k * 0.52 * (np.cos(lean) * up + np.sin(lean) * ahead)
    head = neck + k * 0.2 * (up + 0.3 * ahead)
    parts: list[Capsule] = []

    def add(a: FloatArray, b: FloatArray, wide: float, narrow: float, colour: Colour) -> None:
        parts.append(Capsule(a, b, wide * k, narrow * k, colour))

    for side in (-1.0, 1.0):
        swing = side * stride[1] * np.sin(stride[0])
        lift = max(side * np.cos(stride[0]), 0.0) * 0.35 * stride[1]
        ankle = feet + aside * side * k * (0.13 + 0.14 * crouch) + ahead * swing + (0.08 + lift) * up
        hip = hips + aside * side * 0.1 * k
        knee = (hip + ankle) / 2 + ahead * (0.07 + 0.3 * crouch + 0.2 * stride[1])
        add(hip, knee, 0.085, 0.06, outfit.skin)
        add(hip, hip + 0.6 * (knee - hip), 0.105, 0.095, outfit.shorts)
        add(knee, ankle, 0.058, 0.04, outfit.skin)
        add(knee + 0.65 * (ankle - knee), ankle, 0.045, 0.042, outfit.socks)
        add(ankle - 0.03 * up - 0.05 * ahead, ankle - 0.04 * up + 0.17 * ahead, 0.05, 0.042, outfit.shoes)
    add(hips + 0.02 * up, neck - 0.12 * up, 0.145, 0.17, outfit.shirt)
    add(neck, head, 0.06, 0.06, outfit.skin)
    add(head, head + 0.03 * up, 0.095, 0.09, outfit.skin)
    add(head + 0.06 * up - 0.04 * ahead, head + 0.05 * up - 0.02 * ahead, 0.095, 0.09, outfit.hair)
    own = -1.0 if outfit.is_left else 1.0
    for side in (-1.0, 1.0):
        shoulder = neck + aside * side * 0.19 * k - 0.06 * up
        reach = k * (-0.32 * up + 0.28 * ahead + 0.12 * side * aside)
        if side == own and hand is not None:
            reach = hand - shoulder
        wrist = shoulder + reach * min(1.0, 0.6 * k / max(float(np.linalg.norm(reach)), 1e-6))
        bend = np.sqrt(max((0.31 * k) ** 2 - float(np.sum((wrist - shoulder) ** 2)) / 4, 0.0))
        elbow = (shoulder + wrist) / 2 - bend * (0.8 * up - 0.6 * side * aside)
        add(shoulder, elbow, 0.055, 0.045, outfit.skin)
        add(shoulder, shoulder + 0.6 * (elbow - shoulder), 0.07, 0.062, outfit.shirt)
        add(elbow, wrist, 0.043, 0.034, outfit.skin)
        add(wrist, wrist, 0.045, 0.045, outfit.skin)
    return parts


def pose_player(rally: RallyPath, player: int, outfit: Outfit, t: float) -> tuple[list[Capsule], Head]:
    """Return the body and the racket's head of a player at a time, s."""
    times = np.array([t - 0.05, t, t + 0.05])
    feet = rally.feet_at(player, times)
    v = (feet[2, :2] - feet[0, :2]) / 0.1
    speed, middle = float(np.hypot(*v)), rally.sport.length / 2
    to_net = 0.0 if feet[1, 0] < middle else np.pi
    facing = to_net + 0.5 * float(np.clip(v[1] / 4, -1, 1)) * (1 if feet[1, 0] < middle else -1)
    strokes = [(s[0] - t, s[2]) for s in rally.strokes if s[1] == player]
    gap, contact = min(strokes, key=lambda s: abs(s[0]), default=(np.inf, np.zeros(3)))
    rod, rim = RACKETS[rally.sport.name]
    share = float(np.clip(1 - abs(gap) / SWING_S, 0, 1))
    share = share**2 * (3 - 2 * share)
    overhead = contact[2] - rally.sport.floor
    jump = share * max(overhead - 2.55 * outfit.size, 0.0)
    crouch = 0.25 * (1 - share) + share * float(np.clip(0.9 - 0.5 * overhead, 0.05, 0.8))
    ground = np.array([*feet[1, :2], rally.sport.floor + jump])
    shoulder = ground + np.array([0, 0, outfit.size * (1.36 - 0.45 * crouch)])
    forward = np.array([np.cos(to_net), np.sin(to_net), 0.0])
    side = np.array([forward[1], -forward[0], 0.0]) * (-1.0 if outfit.is_left else 1.0)
    ready = ground + 0.45 * forward + 0.25 * side + np.array([0, 0, 1.05 * outfit.size])
    swept = contact
    if share > 0:
        # the head swings about the shoulder: downwards overhead, otherwise across
        turn = -SWEEP_RAD * np.tanh(gap / SWEEP_S)
        arm = contact - shoulder
        axis = (
            np.cross([0.0, 0.0, 1.0], forward)
            if overhead > 1.9
            else np.array([0.0, 0.0, -np.sign(arm @ side) or 1.0]) * np.sign(side @ np.cross([0, 0, 1.0], forward))
        )
        swept = shoulder + _turn(arm, axis, turn)
    centre = ready + share * (swept - ready)
    pointing = centre - shoulder
    pointing = pointing / max(float(np.linalg.norm(pointing)), 1e-6)
    if share < 0.5:
        pointing = pointing + (1 - 2 * share) * np.array([0, 0, 0.8])
        pointing /= np.linalg.norm(pointing)
    hand = centre - rod * pointing
    phase = 4.0 * float(feet[1, 2])
    stride = (phase + 0.8 * share, min(0.08 * speed, 0.38) + 0.25 * share)
    body = make_figure(None, ground, outfit, facing, stride, hand, crouch)
    body.append(Capsule(hand, centre - rim * pointing, 0.013, 0.01, outfit.racket))
    across = np.cross(pointing, forward + np.array([0, 0, 0.3]))
    across = across / max(float(np.linalg.norm(across)), 1e-6)
    is_bat = rally.sport.name == "table-tennis"
    return body, Head(centre, np.stack([rim * 1.2 * pointing, rim * across]), outfit.racket, is_bat)


def _turn(vector: FloatArray, axis: FloatArray, angle: float) -> FloatArray:
    """Turn a vector (3,) about a unit axis (3,) by an angle, rad."""
    along = axis * (axis @ vector)
    return np.asarray(along + np.cos(angle) * (vector - along) + np.sin(angle) * np.cross(axis, vector))


def draw_capsules(
    image: ByteArray, projection: FloatArray, capsules: Sequence[Capsule], offset: FloatArray | None = None
) -> None:
    """Draw capsules onto an image (h, w, 3 or 4), farther ones first, in place; `offset` (2,) px is its first pixel."""
    if not capsules:
        return
    ends = np.array([[c.a, c.b] for c in capsules])
    rays = ends @ projection[:, :3].T + projection[:, 3]
    depth = rays[..., 2]
    px = rays[..., :2] / depth[..., None] - (0 if offset is None else offset)
    scale = np.linalg.norm(
        projection[0, :3]
        - projection[2, :3] * (projection[0, :3] @ projection[2, :3]) / (projection[2, :3] @ projection[2, :3])
    )
    radius = np.array([[c.radius_a, c.radius_b] for c in capsules]) * scale / depth
    # the outline: arcs about both ends between the common tangents
    way = px[:, 1] - px[:, 0]
    heading = np.arctan2(way[:, 1], way[:, 0])[:, None]
    tangent = np.arccos(np.clip((radius[:, 0] - radius[:, 1]) / np.maximum(np.hypot(*way.T), 1e-6), -1, 1))[:, None]
    angle = np.concatenate(
        [heading + tangent * ARC, heading + tangent + (2 * np.pi - 2 * tangent) * (ARC + 1) / 2], axis=1
    )
    half = len(ARC)
    far, near = (np.stack([np.cos(a), np.sin(a)], -1) for a in (angle[:, :half], angle[:, half:]))
    outline = np.concatenate(
        [px[:, 1:] + radius[:, 1, None, None] * far, px[:, :1] + radius[:, 0, None, None] * near], axis=1
    )
    fixed = np.rint(np.clip(outline, -2e4, 2e4) * 2**SHIFT).astype(np.int32)
    for i in np.argsort(-depth.mean(axis=1)):
        if depth[i].min() >= 0.3:
            colour = (*(int(255 * c) for c in capsules[i].colour), 255)
            cv2.fillConvexPoly(image, fixed[i], colour, cv2.LINE_AA, SHIFT)


def draw_head(image: ByteArray, projection: FloatArray, head: Head, offset: FloatArray) -> None:
    """Draw the head of a racket onto an image (h, w, 4), in place."""
    rim = head.centre + CIRCLE @ head.axes
    rays = rim @ projection[:, :3].T + projection[:, 3]
    if rays[:, 2].min() < 0.3:
        return
    points = [np.rint((rays[:, :2] / rays[:, 2:] - offset) * 2**SHIFT).astype(np.int32)]
    colour = (*(int(255 * c) for c in head.colour), 255)
    if head.is_filled:
        cv2.fillPoly(image, points, colour, cv2.LINE_AA, SHIFT)
    else:
        size = float(np.ptp(rays[:, :2] / rays[:, 2:], axis=0).max())
        cv2.fillPoly(image, points, (50, 50, 50, 60), cv2.LINE_AA, SHIFT)
        cv2.polylines(image, points, True, colour, max(1, round(size / 14)), cv2.LINE_AA, SHIFT)
