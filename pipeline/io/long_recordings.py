"""Long recordings of a motion that goes on, cut into shots: an effect is confirmed on others than it was fitted to.

Of a swinging arm one log of a minute is the rule. Its pieces begin in states of their own, as separate shots do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from models.core.recording import Recording

# Shots from which recordings are left as they are: half of them fit, a quarter confirms, a quarter reports.
_ENOUGH_SHOTS = 8
# Pieces of all recordings together: a quarter of them can agree about an effect by chance with a probability of 1/8.
_PIECES = 16
# Rows of a piece at least: two windows of the shortest kind (`simulator_scene`) whose motions do not say the same.
_LEAST_ROWS = 80


def cut_long_recordings(recordings: Sequence[Recording]) -> tuple[list[tuple[int, Recording]], str]:
    """Cut recordings into pieces of equal length where they are too few to confirm anything.

    Args:
        recordings: One per shot.

    Returns:
        Index of the recording of each piece and the piece, with shot numbers from 0 on; and a sentence without a full
        stop that says so, empty where nothing was cut.
    """
    count = len(recordings)
    most = -(-_PIECES // count) if 0 < count < _ENOUGH_SHOTS else 1
    pieces: list[tuple[int, Recording]] = []
    for source, one in enumerate(recordings):
        rows = len(one.t)
        parts = max(min(most, rows // _LEAST_ROWS), 1)
        for k in range(parts):
            piece = one.select_rows(rows * k // parts, rows * (k + 1) // parts)
            pieces.append((source, replace(piece, shot=len(pieces))))
    if len(pieces) == count:
        return pieces, ""
    seconds = max(float(piece.t[-1] - piece.t[0]) for _, piece in pieces)
    what = "The recording was" if count == 1 else f"The {count} recordings were"
    return (
        pieces,
        f"{what} cut into {len(pieces)} shots of up to {seconds:.3g} s, so that some can confirm what others say",
    )


def describe_times(piece: Recording) -> str:
    """Format the times of a piece, for the name of its shot."""
    return f"{piece.t[0]:.2f} to {piece.t[-1]:.2f} s"
