"""Training pictures on disk in numbered files. Number k is the same anywhere, so an interrupted run goes on."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.core.typing import ByteArray, Float32Array
from video.rendering.ball_arrangement import MOST_BALLS
from video.rendering.training_images import TrainingPicture, practice_pictures

PICTURES_PER_FILE = 240
COLUMNS = ("x", "y", "radius", "streak_x", "streak_y", "look", "visible")
"""Of a ball in `Pictures.balls`; lengths in px."""
HELD_OUT_SEED = 7_000_000
"""Files of held-out halls have numbers of their own."""


@dataclass(frozen=True, slots=True)
class Pictures:
    """P training pictures."""

    rgb: ByteArray
    """(P, S, S, 3)"""
    balls: Float32Array
    """(P, N, 7) columns as in COLUMNS; rows of NaN fill it up."""

    def __len__(self) -> int:
        return len(self.rgb)


def training_file(folder: Path, number: int, held_out: bool = False) -> Path:
    """File `number` of a folder; made where it is missing."""
    path = folder / f"{'held-out' if held_out else 'pictures'}-{number:05d}.npz"
    if not path.exists():
        rng = np.random.default_rng(number + HELD_OUT_SEED * held_out)
        made = stacked(list(practice_pictures(rng, PICTURES_PER_FILE, held_out)))
        aside = path.with_suffix(f".{os.getpid()}.part")
        with aside.open("wb") as file:
            np.savez(file, rgb=made.rgb, balls=made.balls)
        aside.replace(path)
    return path


def read_pictures(path: Path) -> Pictures:
    """What `training_file` wrote."""
    with np.load(path, allow_pickle=False) as arrays:
        return Pictures(arrays["rgb"], arrays["balls"])


def stacked(pictures: list[TrainingPicture]) -> Pictures:
    """Pictures as arrays."""
    balls = np.full((len(pictures), MOST_BALLS, len(COLUMNS)), np.nan, np.float32)
    for row, picture in zip(balls, pictures, strict=True):
        row[: len(picture.radius)] = np.column_stack(
            [picture.centre, picture.radius, picture.streak, picture.look, picture.visible]
        )
    return Pictures(np.stack([picture.rgb for picture in pictures]), balls)
