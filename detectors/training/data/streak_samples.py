"""Straightened streaks to train on: what the ball network says of drawn pictures, beside the truth."""

from __future__ import annotations

import os
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

from detectors.network.network_file import BallModel, open_model
from detectors.network.peak_decoding import Centres
from detectors.network.streak_crop import COLUMNS, ROWS, Straight
from detectors.network.streak_regressor import LEAST_WAY_RADII
from detectors.training.data.augmentation import vary
from detectors.training.data.training_shards import read_pictures, training_file
from models.core.typing import ByteArray, Float32Array, FloatArray

FORMS = 6
"""In how many forms a training picture is shown to the ball network."""
LEAST_SCORE = 0.12
"""From which the ball network's word of a streak counts: see `judge.FAINT_SCORE`."""
LEAST_VISIBLE, LEAST_RADIUS_PX = 0.35, 3.3
"""Of a ball that is measured: share that nothing hides, and size."""
SIZE_BAND = (0.6, 1.6)
"""Told over true radius: what differs more is another thing."""
RADIUS_ERROR, CENTRE_RADII, WAY_ERROR = 0.03, 0.05, 0.05
"""How far off a streak is shown, besides what the network errs by; standard deviations of the logarithm of the radius,
of the centre per axis in ball radii, and of the way's length and direction."""


@dataclass(frozen=True, slots=True)
class StreakPictures:
    """K straightened streaks."""

    shown: ByteArray
    """(K, ROWS, COLUMNS, 3)"""
    told: Float32Array
    """(K, 4) as in `Straight.told`, ball radii."""
    radius: Float32Array
    """(K,) px."""
    visible: Float32Array
    """(K,) share of the disc that nothing hides."""

    def __len__(self) -> int:
        return len(self.shown)


def streak_file(folder: Path, number: int, seer: Path, held_out: bool = False) -> Path:
    """File `number` of the streaks that the ball network in the file `seer` sees; made where it is missing."""
    mark = sha256(seer.read_bytes()).hexdigest()[:8]
    path = folder / f"{'held-out-' if held_out else ''}streaks-{mark}-{number:05d}.npz"
    if not path.exists():
        made = _streaks_in(training_file(folder, number, held_out), open_model(seer), 1 if held_out else FORMS, number)
        aside = path.with_suffix(f".{os.getpid()}.part")
        with aside.open("wb") as file:
            np.savez(file, shown=made.shown, told=made.told, radius=made.radius, visible=made.visible)
        aside.replace(path)
    return path


def read_streaks(path: Path) -> StreakPictures:
    """What `streak_file` wrote."""
    with np.load(path, allow_pickle=False) as arrays:
        return StreakPictures(*(arrays[name] for name in StreakPictures.__slots__))


def _streaks_in(file: Path, model: BallModel, forms: int, seed: int) -> StreakPictures:
    """The streaks that a network sees in the pictures of a file; the first form is the picture itself."""
    pictures, rng = read_pictures(file), np.random.default_rng(seed)
    rows: list[tuple[ByteArray, FloatArray, float, float]] = []
    for rgb, balls in zip(pictures.rgb, pictures.balls, strict=True):
        if forms > 1 and not (np.linalg.norm(balls[:, 3:5], axis=1) > balls[:, 2]).any():
            continue
        for form in range(forms):
            seen, there = vary(rng, rgb, balls) if form else (rgb, balls)
            rows += _beside_the_truth(rng, seen, there[~np.isnan(there[:, 0])].astype(np.float64), model)
    shown = np.array([row[0] for row in rows], dtype=np.uint8).reshape(-1, ROWS, COLUMNS, 3)
    told, radius, visible = (np.array([row[k] for row in rows], dtype=np.float32) for k in (1, 2, 3))
    return StreakPictures(shown, told.reshape(-1, 4), radius, visible)


def _beside_the_truth(
    rng: np.random.Generator, rgb: ByteArray, balls: FloatArray, model: BallModel
) -> list[tuple[ByteArray, FloatArray, float, float]]:
    """Straightened picture, what is true of it, radius and visible share of what a network says moves."""
    seen = model.see(np.ascontiguousarray(rgb), float(np.median(balls[:, 2])) if len(balls) else 1.0)
    found = []
    for k, ball in _same(seen, balls).items():
        _, _, radius, *way, _, visible = balls[ball]
        told = seen.streak[k]
        if not LEAST_WAY_RADII * seen.radius[k] < np.linalg.norm(told):
            continue
        if visible < LEAST_VISIBLE or radius < LEAST_RADIUS_PX:
            continue
        if not SIZE_BAND[0] < seen.radius[k] / radius < SIZE_BAND[1]:
            continue
        size = float(radius * np.exp(rng.normal(0, RADIUS_ERROR)))
        aside = np.array([-told[1], told[0]]) * rng.normal(0, WAY_ERROR)
        off = told * np.exp(rng.normal(0, WAY_ERROR)) + aside
        at = Straight(seen.centre[k] + rng.normal(0, CENTRE_RADII * size, 2), size, off)
        found.append((at.picture(rgb), at.told(balls[ball, :2], np.array(way)), size, float(visible)))
    return found


def _same(seen: Centres, balls: FloatArray) -> dict[int, int]:
    """Which ball (N, 7) each thing seen is, nearest first, every one once."""
    likely = seen.score > LEAST_SCORE
    apart = np.linalg.norm(seen.centre[:, None] - balls[None, :, :2], axis=-1)
    reach = np.maximum(0.7 * balls[:, 2], 2.0) + 0.5 * np.linalg.norm(balls[:, 3:5], axis=1)
    pairs = np.argwhere((apart < reach) & likely[:, None])
    of: dict[int, int] = {}
    for k, ball in pairs[np.argsort(apart[pairs[:, 0], pairs[:, 1]], kind="stable")].tolist():
        if k not in of and ball not in of.values():
            of[k] = ball
    return of
