"""Long recordings of a motion that goes on, cut into shots: an effect is confirmed on others than it was fitted to.

Of a swinging arm one log of a minute is the rule. Its pieces begin in states of their own, as separate shots do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from diagnosis.fitting.prediction_windows import HORIZON_S
from diagnosis.fitting.shot_preparation import MIN_SHOTS_FOR_SELECTION
from models.core.recording import Recording
from pipeline.io.track_folder import TrackFolder

# Pieces of all recordings together, at most: a quarter of them can agree about an effect by chance with a probability
# of 1/8.
_PIECES = 16
# Rows of a piece at least: two windows of the shortest kind (`simulator_scene`). It also lasts as long as a prediction.
_LEAST_ROWS = 80


def cut_long_recordings(recordings: Sequence[Recording]) -> tuple[list[tuple[int, Recording]], str]:
    """Cut recordings into pieces of equal duration where they are too few to confirm anything.

    Pieces of one recording share what was set up once, such as the zero of an encoder: separate shots say more.

    Args:
        recordings: One per shot.

    Returns:
        Index of the recording of each piece and the piece, with shot numbers from 0 on; and a sentence without a full
        stop that says so, empty where nothing was cut.
    """
    count = len(recordings)
    most = _PIECES // count if 0 < count < MIN_SHOTS_FOR_SELECTION else 1
    pieces: list[tuple[int, Recording]] = []
    for source, one in enumerate(recordings):
        seconds = float(one.t[-1] - one.t[0]) if len(one.t) else 0.0
        parts = max(min(most, len(one.t) // _LEAST_ROWS, int(seconds / HORIZON_S)), 1)
        borders = np.searchsorted(one.t, one.t[0] + seconds * np.arange(1, parts) / parts) if parts > 1 else []
        for first, last in pairwise([0, *map(int, borders), len(one.t)]):
            pieces.append((source, replace(one.select_rows(first, last), shot=len(pieces))))
    if len(pieces) == count:
        return pieces, ""
    seconds = max(float(piece.t[-1] - piece.t[0]) for _, piece in pieces)
    what = "the recording was" if count == 1 else f"the {count} recordings were"
    return pieces, (
        f"{what} cut into {len(pieces)} pieces of up to {seconds:.3g} s, numbered from 0, so that some can confirm what"
        " others say; separate runs confirm more"
    )


def describe_times(piece: Recording) -> str:
    """Format the times of a piece, for the name of its shot."""
    return f"{piece.t[0]:.2f} to {piece.t[-1]:.2f} s"


def cut_pendulums(read: TrackFolder) -> TrackFolder:
    """Cut long recordings of pendulums; those of other scenes are as they were, as their bodies stop or leave."""
    if read.entry.scene != "pendulum":
        return read
    pieces, note = cut_long_recordings(read.recordings)
    if not note:
        return read
    names = [read.origins.get(one.shot, f"shot {one.shot}") for one in read.recordings]
    origins = {piece.shot: f"{names[source]}, {describe_times(piece)}" for source, piece in pieces}
    return replace(read, recordings=tuple(piece for _, piece in pieces), notes=(*read.notes, note), origins=origins)
