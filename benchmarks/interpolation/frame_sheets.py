"""Sheets of synthesised frames beside the real ones, for visual inspection."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from benchmarks.interpolation.withheld_truth import Passing

TILE = (232, 174)
MOST_ROWS = 24


def write_sheet(path: Path, rows: list[tuple[str, list[Passing], dict[str, np.ndarray]]]) -> None:
    """Write one row per (caption, balls, frames by name): magnified crops around the balls' paths."""
    strips = [_compose_row(caption, balls, frames) for caption, balls, frames in rows[:MOST_ROWS]]
    if strips:
        widest = max(strip.shape[1] for strip in strips)
        padded = [np.pad(s, ((0, 4), (0, widest - s.shape[1]), (0, 0))) for s in strips]
        cv2.imwrite(str(path), cv2.cvtColor(np.vstack(padded), cv2.COLOR_RGB2BGR))


def _compose_row(caption: str, balls: list[Passing], frames: dict[str, np.ndarray]) -> np.ndarray:
    way, radius = np.concatenate([b.path for b in balls]), max(b.radius for b in balls)
    low, high = way.min(axis=0) - 2.5 * radius, way.max(axis=0) + 2.5 * radius
    middle, scale = (low + high) / 2, float(min(np.array(TILE) / (high - low)))
    shift = np.column_stack([scale * np.eye(2), np.array(TILE) / 2 - scale * middle])
    tiles = []
    for k, (name, frame) in enumerate(frames.items()):
        flags = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
        tile = cv2.warpAffine(frame, shift, TILE, flags=flags)
        words = f"{name}  {caption}" if k == 0 else name
        cv2.putText(tile, words, (4, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.36, (255, 255, 0), 1, cv2.LINE_AA)
        tiles += [tile, np.zeros((TILE[1], 3, 3), np.uint8)]
    return np.hstack(tiles[:-1])
