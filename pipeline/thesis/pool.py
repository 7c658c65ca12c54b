"""Scene III: the balls of a real clip, in px, as a run of the chain saw them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from models.errors import OptionError
from pipeline.run_folder import Columns, read_table
from pipeline.thesis.series import Case, Floats, Series, filmed

LEAST_FRAMES = 15
"""of a stretch in which every ball was seen."""
MOVED = 1.0
"""px between first and last: a stretch in which nothing moves shows nothing."""


def shots_of(run: Path) -> list[tuple[str, float]]:
    """The shots of a run folder, and their frames per second."""
    columns = _seen(run)
    shots = dict.fromkeys(columns["shot"].astype(int).tolist())
    return [(f"shot {shot}", _rate(columns, shot)) for shot in shots if _stretch(columns, shot) is not None]


def pool(case: Case, run: Path) -> Series:
    """The longest stretch of a shot in which every ball was seen in every frame; withheld are measured places too,
    so that no method can be better than their noise. OptionError where there is no such stretch."""
    found = _stretch(_seen(run), int(case.variant.removeprefix("shot ")))
    if found is None:
        raise OptionError(f"{run} has no {case.variant} with {LEAST_FRAMES} frames in which every ball was seen")
    t, places = found
    return filmed(case, t - t[0], places)


def _seen(run: Path) -> Columns:
    columns = read_table(run / "tracks.csv", ("shot", "frame", "t", "id", "x_px", "y_px", "observed"))
    rows = (columns["observed"] > 0) & np.isfinite(columns["x_px"])
    return {name: values[rows] for name, values in columns.items()}


def _rate(columns: Columns, shot: int) -> float:
    rows = columns["shot"] == shot
    return round(float(1 / np.median(np.diff(np.unique(columns["t"][rows])))), 2)


def _stretch(columns: Columns, shot: int) -> tuple[Floats, Floats] | None:
    """Times (T,) and places (T, N, 2) px of the longest run of even frames with all balls, None where too short."""
    rows = columns["shot"] == shot
    t, row = np.unique(columns["t"][rows], return_inverse=True)
    ids = sorted(set(columns["id"][rows].tolist()))
    places = np.full((len(t), len(ids), 2), np.nan)
    ball = np.array([ids.index(name) for name in columns["id"][rows]], np.int64)
    places[row, ball] = np.stack([columns["x_px"][rows], columns["y_px"][rows]], axis=1)
    step = np.diff(t)
    whole = np.isfinite(places).all(axis=(1, 2))
    joined = whole[1:] & whole[:-1] & (np.abs(step / np.median(step) - 1) < 0.2) if len(step) else np.zeros(0, bool)
    ends = np.flatnonzero(np.diff(np.concatenate([[False], joined, [False]]).astype(int)))
    if not len(ends):
        return None
    starts, stops = ends[::2], ends[1::2]
    longest = int(np.argmax(stops - starts))
    part = slice(int(starts[longest]), int(stops[longest]) + 1)
    if len(t[part]) < LEAST_FRAMES or np.abs(np.diff(places[part][[0, -1]], axis=0)).max() < MOVED:
        return None
    return t[part], places[part]
