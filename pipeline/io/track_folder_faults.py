"""What is wrong with a track folder, in sentences: files that are missing, and positions off the table it names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from models.core.errors import OptionError
from models.estimation.gap_scenes.gap_scene import Recording
from pipeline.reporting.text.sentences import told

TRACKS, SCENE = "tracks.csv", "scene.json"

_BEYOND = 0.1
"""lengths of the table that a position may lie beyond a cushion: what a camera that is not understood shifts it by."""
_ASTRAY = 0.25
"""share of positions off the table, more than lost and flying balls make up: the columns are no metres of it."""
_LONGEST = 10.0
"""m, thrice the length of the largest table: a longer one is not given in metres."""
_SMALLER = {100: "centimetres", 1000: "millimetres"}
"""Units that people write by mistake, by how many of them make a metre."""


def refuse_what_is_missing(folder: Path) -> None:
    """OptionError that says which file is missing, where it was sought, and what to do."""
    if folder.is_file():
        raise OptionError(
            f"A diagnosis reads folders, and {told(folder)} is a file; name the folder that holds {TRACKS} and {SCENE},"
            " of a clip the one that trueroll run made"
        )
    if not folder.is_dir():
        raise OptionError(
            f"There is no folder {told(folder)}; name one that trueroll run made, or one of your own with {TRACKS} and"
            f" {SCENE}"
        )
    missing = [name for name in (TRACKS, SCENE) if not (folder / name).is_file()]
    if not missing:
        return
    lacks = f"There is no {' and no '.join(missing)} in {told(folder)}"
    below = [path.parent for path in folder.glob(f"*/{TRACKS}") if (path.parent / SCENE).is_file()]
    if below:
        raise OptionError(f"{lacks}, but in {len(below)} of its folders; name these: {told(folder)}/*/")
    raise OptionError(
        f"{lacks}; a diagnosis needs {TRACKS} (where balls were seen) and {SCENE} (on which table): name a folder that"
        " trueroll run made, or write them as docs/formats.md says"
    )


def off_the_table(recordings: Sequence[Recording], size: tuple[float, float], path: Path) -> tuple[str, ...]:
    """A note where some positions, of which x and y come first, lie off a table of `size` (length, width; m), nothing
    where none do; OptionError where so many do that nothing sensible comes of it."""
    if max(size) > _LONGEST:
        raise OptionError(
            f"{told(path.with_name(SCENE))}: the table is {size[0]:g} x {size[1]:g} m; lengths are wanted in metres"
        )
    places = np.concatenate([one.places[one.seen][:, :2] for one in recordings])
    margin = _BEYOND * max(size)
    away = (places < -margin) | (places > np.array(size) + margin)
    worst = int(np.argmax(away.mean(axis=0)))
    if away[:, worst].mean() > _ASTRAY:
        low, high = float(places[:, worst].min()), float(places[:, worst].max())
        axis, side, most = "xy"[worst], ("length", "width")[worst], size[worst]
        raise OptionError(
            f"{told(path)}: {axis} goes from {low:.3g} to {high:.3g} m, but {SCENE} gives the table a {side} of"
            f" {most:g} m, so that {axis} lies between 0 and {most:g}{_unit_hint(high, most)}"
        )
    count = int(away.any(axis=1).sum())
    return (f"{count} of {len(places)} positions of {told(path)} lie off the table",) if count else ()


def _unit_hint(high: float, most: float) -> str:
    """Which unit would bring the largest value onto the table."""
    fits = [(count, unit) for count, unit in _SMALLER.items() if 0 < high / count <= most * (1 + _BEYOND)]
    return f"; if it is in {fits[0][1]}, divide x and y by {fits[0][0]}" if fits else "; correct the one or the other"
