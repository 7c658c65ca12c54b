"""Sentences on how a clip is filmed: what was measured, what is good, and what to change."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from models.core.scene import Table
from video.filming_check.measure_filming import FilmingLimits, FilmingMeasurement, Limit

# The verdict as a sentence.
VERDICT_WORDS = {
    "go": "Go: the clip is filmed well.",
    "doubts": "Go with doubts: the clip can be used, and could be better.",
    "no-go": "No-go: change this before you film on.",
}
# Signs of the levels of measurements.
LEVEL_SIGNS = {"good": "✓", "doubt": "!", "bad": "✗", "unknown": "–"}
LIMITS = FilmingLimits()
# Faults of the light as a whole.
LIGHT_CODES = ("exposure", "clipping")


@dataclass(frozen=True, slots=True)
class FilmingWords:
    """How a measurement is written."""

    name: str
    unit: str
    digits: int
    advice: str
    """What to change if it is not good."""
    unknown: str = "not measured"
    """Why there is no value."""


# Words for each measurement.
WORDS = {
    "exposure": FilmingWords(
        "brightness of the table", "of 255", 0, "Add light over the table, or raise the exposure.",
    ),
    "clipping": FilmingWords(
        "clipped pixels", "%", 1, "Lower the exposure, or lock it on the cloth: parts of the image are plain white.",
    ),
    "flicker": FilmingWords(
        "change of the light", "%", 1,
        "Lock the exposure; if the lamps flicker, choose a rate of 50 or 25 fps (60 or 30 where mains have 60 Hz).",
    ),
    "glare": FilmingWords(
        "glare on the cloth", "% of it", 1, "Move the lamp or the camera until its reflection leaves the cloth.",
    ),
    "motion_blur": FilmingWords(
        "exposure time", "ms", 1, "Shorten the exposure (1/500 s): set it by hand, and add light.",
        "no ball was measured in two consecutive frames between which it moved by three radii",
    ),
    "frame_rate": FilmingWords("distinct frames", "per s", 1, "Choose 60 fps or more in the camera."),
    "duplicates": FilmingWords(
        "duplicate frames", "%", 0,
        "Use the file as the camera wrote it; a converter or a screen recorder repeated frames.",
    ),
    "irregular_times": FilmingWords(
        "irregular frame steps", "%", 0, "Switch off the variable frame rate of the camera or screen recorder.",
    ),
    "corners": FilmingWords(
        "corners of the table in view", "of 4", 0,
        "Move the camera back or up until all four corners are visible, or state where they are.",
    ),
    "ball_size": FilmingWords(
        "diameter of a far ball", "px", 1, "Go nearer, use the full resolution, or film from higher up.",
        "no table was found",
    ),
    "camera_drift": FilmingWords(
        "motion of the camera", "px", 1, "Fix the camera to a tripod or the ceiling, and do not zoom.",
        "too little detail around the table",
    ),
    "compression": FilmingWords(
        "brightness lost by compression", "of 255 levels", 0,
        "Use the original file at a higher bit rate, not one sent by a messenger.", "the codec does not state it",
    ),
    "focus": FilmingWords(
        "blur of edges", "of a ball's radius", 2,
        "Focus on the middle of the table and lock the focus; clean the lens.", "too few clear edges",
    ),
}  # fmt: skip


def format_value(one: FilmingMeasurement) -> str:
    """Format a value with its unit."""
    words = WORDS[one.code]
    if math.isnan(one.value):
        return words.unknown
    if one.code == "motion_blur" and one.value == 0:
        return "no streaks"
    if math.isinf(one.value):
        return "most frames do not match the first one"
    return f"{one.value:.{words.digits}f} {words.unit}"


def format_bounds(limit: Limit) -> str:
    """Format from or up to which value a measurement with a limit is good, and from where it is bad."""
    good, bad = ("at least", "below") if limit.bad < limit.good else ("at most", "above")
    return f"{good} {limit.good:g}; no-go {bad} {limit.bad:g}"


def format_advice(measurements: Sequence[FilmingMeasurement], refusal: str) -> list[str]:
    """Format what to change, the worst first.

    Args:
        refusal: Why a run refuses the clip; empty otherwise.

    Returns:
        One sentence per measurement that is not good.
    """
    lines = [
        f"{WORDS[one.code].name}: {format_value(one)}. {WORDS[one.code].advice}" for one in rank_faults(measurements)
    ]
    return [f"A run refuses this clip: {refusal}.", *lines] if refusal else lines


def format_located_table(table: Table, ball_count: int) -> str:
    """Format the table and the number of balls that a run would start from."""
    balls = f"{ball_count} ball{'' if ball_count == 1 else 's'}"
    return f"Table {table.name}, {table.length:g} x {table.width:.3g} m; {balls} in the first frame looked at."


def rank_faults(measurements: Sequence[FilmingMeasurement]) -> list[FilmingMeasurement]:
    """Rank the measurements that are not good: by level, causes before what they may cause, then the worst first.

    All else is measured in the light of the frames, so that too little or too much of it is named first of its level. A
    table may be missing because of any other fault, so that a table out of view is named last.
    """
    faults = [one for one in measurements if one.level in ("doubt", "bad")]
    return sorted(
        faults,
        key=lambda one: (
            one.level != "bad", one.code not in LIGHT_CODES, one.code == "corners", -_measure_excess(one)
        ),
    )  # fmt: skip


def _measure_excess(one: FilmingMeasurement) -> float:
    """Return how far a value is beyond the last good one, relative to the last one that is not bad."""
    limit = LIMITS.find_limit(one.code)
    return (one.value - limit.good) / (limit.bad - limit.good)
