"""Rings of wanted places: where they are drawn, and in which colour."""

from __future__ import annotations

import numpy as np

from models.physics.billiards.tables import TABLE_PRESETS
from video.overlay.placement_overlay import (
    MISPLACED_COLOUR,
    PLACED_COLOUR,
    PlacedRing,
    draw_places,
    project_ball_outline,
)
from video.rendering.pinhole_camera import look_at

TABLE = TABLE_PRESETS["pool-9ft"]
MIDDLE = np.array([TABLE.length / 2, TABLE.width / 2, 0.0])
CAMERA = look_at(TABLE, MIDDLE + np.array([0.0, 2.5, 1.6]), MIDDLE, 1400.0, 1280, 720)


def test_the_outline_is_where_lines_of_sight_touch_the_ball() -> None:
    xy = np.array([0.4, 1.1])
    rays = np.column_stack([project_ball_outline(CAMERA, xy, TABLE.ball_radius), np.ones(72)])
    directions = rays @ np.linalg.inv(CAMERA.matrix[:, :3]).T
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    to_centre = np.append(xy, TABLE.ball_radius) - CAMERA.position
    distance = np.linalg.norm(to_centre - (directions @ to_centre)[:, None] * directions, axis=1)
    np.testing.assert_allclose(distance, TABLE.ball_radius, rtol=1e-9)


def test_rings_have_the_colour_of_their_state_and_an_arrow_points_from_the_ball_to_its_place() -> None:
    image = np.zeros((720, 1280, 3), np.uint8)
    placed, wanted, present = np.array([0.6, 0.4]), np.array([1.6, 0.7]), np.array([1.9, 0.7])
    rings = [
        PlacedRing(placed, PLACED_COLOUR, ""),
        PlacedRing(wanted, MISPLACED_COLOUR, "", present),
    ]
    drawn = draw_places(image, CAMERA, rings, TABLE.ball_radius, [])
    assert not image.any()
    for xy, colour in ((placed, PLACED_COLOUR), (wanted, MISPLACED_COLOUR)):
        outline = np.rint(project_ball_outline(CAMERA, xy, TABLE.ball_radius)).astype(int)
        on_ring = drawn[outline[:, 1], outline[:, 0]].astype(int)
        assert np.mean(np.abs(on_ring - colour).max(axis=1) < 60) > 0.9
    between = CAMERA.to_pixels((wanted + present) / 2, TABLE.ball_radius)
    x, y = np.rint(between).astype(int)
    assert (np.abs(drawn[y - 2 : y + 3, x].astype(int) - MISPLACED_COLOUR).max(axis=1) < 60).any()
