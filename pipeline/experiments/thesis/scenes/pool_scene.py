"""Scene III: the balls of a real clip, in px, as a run of the chain saw them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.core.errors import OptionError
from models.core.typing import FloatArray
from pipeline.experiments.thesis.scenes.withheld_series import Case, Series, filmed
from pipeline.io.run_folder import Columns, read_table

LEAST_FRAMES = 15
"""of a stretch in which every ball was seen."""
MOVED = 1.0
"""px between first and last: a stretch in which nothing moves shows nothing."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """Pictures in which every ball was seen."""

    ids: tuple[str, ...]
    """(N,)"""
    t: FloatArray
    """(T,) s of the clip."""
    places: FloatArray
    """(T, N, 2) px."""


def shots_of(run: Path) -> list[tuple[str, float]]:
    """The shots of a run folder, and their frames per second."""
    columns = _seen(run)
    shots = dict.fromkeys(columns["shot"].astype(int).tolist())
    return [(f"shot {shot}", _rate(columns, shot)) for shot in shots if _stretch(columns, shot) is not None]


def pool(case: Case, run: Path) -> Series:
    """The longest stretch of a shot in which every ball was seen in every frame; withheld are measured places too,
    so that no method can be better than their noise. OptionError where there is no such stretch."""
    found = stretch_of(run, number_of(case.variant))
    return filmed(case, found.t - found.t[0], found.places)


def number_of(variant: str) -> int:
    """The number of a shot by its name."""
    return int(variant.removeprefix("shot "))


def stretch_of(run: Path, shot: int) -> Stretch:
    """What a shot has of pictures with every ball."""
    found = _stretch(_seen(run), shot)
    if found is None:
        raise OptionError(f"Shot {shot} of {run} has no {LEAST_FRAMES} frames on end in which every ball was seen")
    return found


def _seen(run: Path) -> Columns:
    columns = read_table(run / "tracks.csv", ("shot", "frame", "t", "id", "x_px", "y_px", "observed"))
    rows = (columns["observed"] > 0) & np.isfinite(columns["x_px"])
    return {name: values[rows] for name, values in columns.items()}


def _rate(columns: Columns, shot: int) -> float:
    rows = columns["shot"] == shot
    return round(float(1 / np.median(np.diff(np.unique(columns["t"][rows])))), 2)


def _stretch(columns: Columns, shot: int) -> Stretch | None:
    """The longest run of even frames with all balls, None where too short."""
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
    return Stretch(tuple(ids), t[part], places[part])
