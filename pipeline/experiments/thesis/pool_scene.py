"""Scene III: the balls of a real clip, in px, as tracked in a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.core.errors import OptionError
from models.core.typing import FloatArray
from pipeline.experiments.thesis.thesis_scenes import ExperimentCase, WithheldSeries, build_series
from pipeline.io.run_folder import read_csv_columns
from pipeline.io.text_table import Columns

# Least number of frames of a segment in which every ball was observed.
MIN_FRAMES = 15
# Least displacement between its first and last frame, px.
MIN_MOTION_PX = 1.0


@dataclass(frozen=True, slots=True)
class CompleteSegment:
    """Consecutive frames in which every ball was observed."""

    ids: tuple[str, ...]
    """(N,) balls."""
    t: FloatArray
    """(T,) s of the clip."""
    positions: FloatArray
    """(T, N, 2) px."""


def list_shots(run: Path) -> list[tuple[str, float]]:
    """List the shots of a run folder that can be used, with their frame rate.

    Args:
        run: Run folder.

    Returns:
        Variant name and frame rate, Hz, of each shot.
    """
    columns = _read_observations(run)
    shots = dict.fromkeys(columns["shot"].astype(int).tolist())
    return [
        (f"shot {shot}", _frame_rate(columns, shot))
        for shot in shots
        if _find_longest_segment(columns, shot) is not None
    ]


def build_pool_series(case: ExperimentCase, run: Path) -> WithheldSeries:
    """Build the series of the longest segment of a shot in which every ball was observed.

    Withheld positions are measured as well, so that no method can be better than their noise.

    Args:
        case: The experiment.
        run: Run folder.

    Returns:
        Series of all balls.

    Raises:
        OptionError: There is no such segment.
    """
    segment = read_complete_segment(run, parse_shot_number(case.variant))
    return build_series(case, segment.t - segment.t[0], segment.positions)


def parse_shot_number(variant: str) -> int:
    """Parse the number of a shot.

    Args:
        variant: Variant name, such as "shot 2".

    Returns:
        Index of the shot.
    """
    return int(variant.removeprefix("shot "))


def read_complete_segment(run: Path, shot: int) -> CompleteSegment:
    """Read the longest segment of a shot in which every ball was observed.

    Args:
        run: Run folder.
        shot: Index of the shot.

    Returns:
        The segment.

    Raises:
        OptionError: There is no such segment.
    """
    segment = _find_longest_segment(_read_observations(run), shot)
    if segment is None:
        raise OptionError(
            f"Shot {shot} of {run} has no {MIN_FRAMES} consecutive frames in which every ball was observed"
        )
    return segment


def _read_observations(run: Path) -> Columns:
    """Read the observed rows of tracks.csv."""
    columns = read_csv_columns(run / "tracks.csv", ("shot", "frame", "t", "id", "x_px", "y_px", "observed"))
    rows = (columns["observed"] > 0) & np.isfinite(columns["x_px"])
    return {name: values[rows] for name, values in columns.items()}


def _frame_rate(columns: Columns, shot: int) -> float:
    """Return the frame rate of a shot, Hz."""
    rows = columns["shot"] == shot
    return round(float(1 / np.median(np.diff(np.unique(columns["t"][rows])))), 2)


def _find_longest_segment(columns: Columns, shot: int) -> CompleteSegment | None:
    """Find the longest run of evenly spaced frames with all balls; None where it is too short."""
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
    if len(t[part]) < MIN_FRAMES or np.abs(np.diff(places[part][[0, -1]], axis=0)).max() < MIN_MOTION_PX:
        return None
    return CompleteSegment(tuple(ids), t[part], places[part])
