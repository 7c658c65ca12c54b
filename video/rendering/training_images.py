"""Pictures to train a ball detector on, with exact truth: `practice_pictures(rng, count)`.

One hall gives a few pictures, because the empty table costs more than the balls on it. The renderer supplies the
geometry, the light, and exposures as integrals; here come what lies about, what a cheap camera does to light, and
what compression does to pictures.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import ByteArray, Float32Array, FloatArray
from video.rendering.ball_arrangement import Layout, random_layout
from video.rendering.random_hall import Hall, random_hall
from video.rendering.scene_clutter import paint_backdrop, paint_caption, paint_halos, paint_players
from video.rendering.scene_renderer import View, develop, expose, make_view, seen_centres
from video.rendering.table_rendering import off_table

SIZE_PX = 160
"""Side of a training picture."""
LOOKS = ("white", "black", "coloured", "striped")
"""What one picture shows of a ball's kind; its colour says the rest."""
PICTURES_PER_HALL = 6
MAGNIFIED_SHARE = 0.2
"""Share of halls rendered twice as large and scaled down, as the detector does with large balls."""
HALO_SHARE = 0.08
"""Share of pictures in which a projector draws rings about balls."""
CHANGED_LEVEL = 0.25
"""Relative change of a pixel's light by which something in front of a ball hides it."""
DISC_PLACES = 61


@dataclass(frozen=True, slots=True)
class TrainingPicture:
    """A picture and its N balls."""

    rgb: ByteArray
    """(S, S, 3)"""
    centre: FloatArray
    """(N, 2) px at mid-exposure."""
    radius: FloatArray
    """(N,) px."""
    streak: FloatArray
    """(N, 2) px travelled during the exposure."""
    look: NDArray[np.int64]
    """(N,) into LOOKS."""
    visible: FloatArray
    """(N,) share of the disc, at mid-exposure, that nothing hides."""


def practice_pictures(rng: np.random.Generator, count: int, held_out: bool = False) -> Iterator[TrainingPicture]:
    """`count` pictures; `held_out` ones show halls of a kind that training pictures never show."""
    made = 0
    while made < count:
        magnify = 2 if rng.random() < MAGNIFIED_SHARE else 1
        hall = random_hall(rng, SIZE_PX, magnify, held_out)
        view = make_view(hall.table, hall.camera, hall.look, hall.balls, exposure=1.0, samples=1)
        for _ in range(min(PICTURES_PER_HALL, count - made)):
            yield filmed(rng, hall, view, magnify)
            made += 1


def filmed(rng: np.random.Generator, hall: Hall, view: View, magnify: int = 1) -> TrainingPicture:
    """One picture of a hall through its camera, made `magnify` times smaller at the end."""
    layout = random_layout(rng, hall, magnify)
    view = replace(
        view,
        balls=tuple(hall.balls[i] for i in layout.which),
        empty=replace(view.empty, picture=_backdrop(rng, hall, view, layout)),
    )
    light = expose(view, layout.motion(), 0.0)
    before = light.copy()
    paint_players(rng, light, hall, view.light)
    hidden = np.abs(light - before).max(axis=2) > CHANGED_LEVEL * (before.max(axis=2) + 0.01)
    seen = _developed(rng, view, light)
    centre, radius, streak = _geometry(view, layout)
    visible = _visible(view, layout, centre, radius, hidden)
    if magnify > 1:
        small = (seen.shape[1] // magnify, seen.shape[0] // magnify)
        seen = np.asarray(cv2.resize(seen, small, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        centre, radius, streak = (centre + 0.5) / magnify - 0.5, radius / magnify, streak / magnify
    return TrainingPicture(seen, centre, radius, streak, _looks(view), visible)


def _backdrop(rng: np.random.Generator, hall: Hall, view: View, layout: Layout) -> Float32Array:
    picture = view.empty.picture.copy()
    height, width = picture.shape[:2]
    outside = off_table(hall.table, view.empty.point.reshape(-1, 3).astype(np.float64)).reshape(height, width)
    paint_backdrop(rng, picture, hall, outside.astype(np.float32))
    if rng.random() < HALO_SHARE:
        paint_halos(rng, picture, hall, layout.place[rng.random(len(layout.place)) < 0.6])
    return picture


def _geometry(view: View, layout: Layout) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centres (N, 2), radii (N,), streaks (N, 2) in px."""
    motion = layout.motion()
    streak = seen_centres(view, motion, 0.5) - seen_centres(view, motion, -0.5)
    radius = view.camera.radius_px(layout.place, view.table.ball_radius)
    return seen_centres(view, motion, 0.0), np.asarray(radius, dtype=np.float64), streak


def _visible(
    view: View, layout: Layout, centre: FloatArray, radius: FloatArray, hidden: NDArray[np.bool_]
) -> FloatArray:
    """Share (N,) of each disc that lies in the picture and that neither nearer balls nor players hide."""
    turns = np.arange(DISC_PLACES) * np.pi * (3 - np.sqrt(5.0))
    disc = np.sqrt((np.arange(DISC_PLACES) + 0.5) / DISC_PLACES)[:, None] * np.column_stack(
        [np.cos(turns), np.sin(turns)]
    )
    at = centre[:, None] + radius[:, None, None] * disc  # (N, D, 2)
    height, width = hidden.shape
    x, y = np.rint(at[..., 0]).astype(int), np.rint(at[..., 1]).astype(int)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    free = inside & ~hidden[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
    xyz = np.column_stack([layout.place, np.full(len(centre), layout.radius)])
    depth = np.linalg.norm(xyz - view.camera.eye, axis=1)
    covered = np.linalg.norm(at[:, :, None] - centre[None, None], axis=-1) < radius
    covered &= (depth[None] < depth[:, None])[:, None]
    return np.asarray((free & ~covered.any(axis=2)).mean(axis=1), dtype=np.float64)


def _looks(view: View) -> NDArray[np.int64]:
    of_kind = {"cue": "white", "white": "white", "eight": "black", "black": "black", "stripe": "striped"}
    return np.array([LOOKS.index(of_kind.get(ball.kind, "coloured")) for ball in view.balls], dtype=np.int64)


def _developed(rng: np.random.Generator, view: View, light: Float32Array) -> ByteArray:
    """Linear light to the picture that a file holds: white balance, sensor, camera's processing, captions, coding."""
    gain = np.exp(rng.normal(0, 0.12, 3)).astype(np.float32)
    picture = develop(view, np.asarray(light * gain, dtype=np.float32), rng)
    picture = _processed(rng, picture)
    if rng.random() < 0.08:
        paint_caption(rng, picture)
    return _coded(rng, picture)


def _processed(rng: np.random.Generator, picture: ByteArray) -> ByteArray:
    """Contrast, saturation, sharpening or softness, as cameras and editors add them."""
    levels = (np.arange(256) / 255.0) ** rng.uniform(0.7, 1.4)
    tone = np.clip(255 * (levels * rng.uniform(0.8, 1.1) + rng.uniform(-0.03, 0.08)), 0, 255).astype(np.uint8)
    picture = np.asarray(cv2.LUT(picture, tone), dtype=np.uint8)
    if rng.random() < 0.5:
        grey = cv2.cvtColor(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
        share = rng.uniform(0.4, 1.6)
        picture = np.asarray(cv2.addWeighted(picture, share, grey, 1 - share, 0), dtype=np.uint8)
    if rng.random() < 0.3:
        amount = rng.uniform(0.2, 1.2)
        soft = cv2.GaussianBlur(picture, (0, 0), rng.uniform(0.8, 1.6))
        picture = np.asarray(cv2.addWeighted(picture, 1 + amount, soft, -amount, 0), dtype=np.uint8)
    elif rng.random() < 0.2:
        size = picture.shape[1::-1]
        small = cv2.resize(picture, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
        picture = np.asarray(cv2.resize(small, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
    return picture


def _coded(rng: np.random.Generator, picture: ByteArray) -> ByteArray:
    """Blocks of 8 px, colour at half the resolution: JPEG stands for video as well, twice at different offsets."""
    for _ in range(int(rng.choice([0, 1, 1, 1, 2]))):
        quality = int(np.clip(rng.normal(70, 22), 15, 97))
        shift = int(rng.integers(0, 8))
        padded = cv2.copyMakeBorder(picture, shift, 0, shift, 0, cv2.BORDER_REFLECT)
        good, data = cv2.imencode(".jpg", padded, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if not good:
            raise RuntimeError("cv2 could not encode a JPEG picture in memory")
        decoded = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)
        picture = np.ascontiguousarray(decoded[shift:, shift:])
    return picture
