"""Checks of a track folder: missing files, and positions off its table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from models.core.errors import OptionError
from models.core.recording import Recording
from pipeline.reporting.text.text_formatting import escape_text

TRACKS_FILE, SCENE_FILE = "tracks.csv", "scene.json"

_MAX_OVERSHOOT = 0.1
"""Tolerated distance beyond a cushion, in table lengths: a badly calibrated camera shifts positions by as much."""
_MAX_SHARE_OFF_TABLE = 0.25
"""Largest tolerated share of positions off the table: lost and flying balls are fewer, wrong units give more."""
_MAX_TABLE_LENGTH = 10.0
"""m, three times the length of the largest table: a larger value is not in metres."""
_SMALLER_UNITS = {100: "centimetres", 1000: "millimetres"}
"""Units that are used by mistake, by their number in a metre."""


def require_track_files(folder: Path) -> None:
    """Raise an OptionError if a folder lacks a file of a track folder; it names the file, the place and the remedy."""
    if folder.is_file():
        raise OptionError(
            f"A diagnosis reads folders, and {escape_text(folder)} is a file; name the folder with {TRACKS_FILE} and"
            f" {SCENE_FILE}, for a clip the one that trueroll run wrote"
        )
    if not folder.is_dir():
        raise OptionError(
            f"There is no folder {escape_text(folder)}; name one that trueroll run wrote, or one of your own with"
            f" {TRACKS_FILE} and {SCENE_FILE}"
        )
    missing = [name for name in (TRACKS_FILE, SCENE_FILE) if not (folder / name).is_file()]
    if not missing:
        return
    lacks = f"There is no {' and no '.join(missing)} in {escape_text(folder)}"
    below = [path.parent for path in folder.glob(f"*/{TRACKS_FILE}") if (path.parent / SCENE_FILE).is_file()]
    if below:
        raise OptionError(f"{lacks}, but in {len(below)} of its folders; name these: {escape_text(folder)}/*/")
    raise OptionError(
        f"{lacks}; a diagnosis needs {TRACKS_FILE} (positions of the balls) and {SCENE_FILE} (the table): name a"
        " folder that trueroll run wrote, or write them as described in docs/reference/file-formats.md"
    )


def find_positions_off_table(recordings: Sequence[Recording], size: tuple[float, float], path: Path) -> tuple[str, ...]:
    """Find positions off the table.

    Args:
        recordings: Recordings whose first two coordinates are x and y.
        size: Length and width of the table, m.
        path: Their tracks.csv, for the messages.

    Returns:
        A note with the number of positions off the table; empty if there are none.

    Raises:
        OptionError: The table is too large to be in metres, or too many positions are off it.
    """
    if max(size) > _MAX_TABLE_LENGTH:
        raise OptionError(
            f"{escape_text(path.with_name(SCENE_FILE))}: the table is {size[0]:g} x {size[1]:g} m; lengths must be"
            " in metres"
        )
    places = np.concatenate([one.positions[one.is_observed][:, :2] for one in recordings])
    margin = _MAX_OVERSHOOT * max(size)
    away = (places < -margin) | (places > np.array(size) + margin)
    worst = int(np.argmax(away.mean(axis=0)))
    if away[:, worst].mean() > _MAX_SHARE_OFF_TABLE:
        low, high = float(places[:, worst].min()), float(places[:, worst].max())
        axis, side, most = "xy"[worst], ("length", "width")[worst], size[worst]
        raise OptionError(
            f"{escape_text(path)}: {axis} goes from {low:.3g} to {high:.3g} m, but {SCENE_FILE} gives the table a"
            f" {side} of {most:g} m, so that {axis} lies between 0 and {most:g}{_suggest_unit(high, most)}"
        )
    count = int(away.any(axis=1).sum())
    return (f"{count} of {len(places)} positions of {escape_text(path)} are off the table",) if count else ()


def _suggest_unit(high: float, most: float) -> str:
    """Suggest the unit in which the largest value would be on the table."""
    fits = [(count, unit) for count, unit in _SMALLER_UNITS.items() if 0 < high / count <= most * (1 + _MAX_OVERSHOOT)]
    return f"; if it is in {fits[0][1]}, divide x and y by {fits[0][0]}" if fits else "; correct the one or the other"
