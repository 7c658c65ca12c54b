"""A clip to share that shows the moment of a call and its answer."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from models.core.errors import OptionError
from models.core.scene import POCKETS, Table
from models.core.shot import Shot
from models.core.typing import FloatArray
from models.estimation.contact_test.call_answers import POCKET_MOUTH_RADII, CallAnswer
from models.estimation.contact_test.shot_record import ShotRecord
from models.estimation.reconstruction.shot_views import view_shot
from pipeline.engine.atomic_write import replace_file
from pipeline.reporting.text.call_sentences import CallWords
from video.drawing.table_plan import draw_table_plan
from video.io.clip import Clip
from video.matting.ball_timeline import build_ball_timeline
from video.matting.hidden_background import estimate_hidden_background
from video.overlay.share_clip import WIDTH, SharedMoment, render_share_clip
from video.synthesis.frame_synthesis import estimate_clip_appearance

CIRCLE_POINTS = 65
"""Points of the outline of a pocket."""
PLAN_NAME_PX = 20
"""px, font size of the names on the plan."""


def write_share_clip(
    record: ShotRecord, call: CallAnswer, text: CallWords, line: FloatArray | None, shot: Shot, clip: Clip, path: Path
) -> None:
    """Write a clip to share of the moment of a call.

    Args:
        record: Observations and fitted motion of the shot.
        call: The answer.
        text: The answer in words.
        line: The line in question (n, 2), m; None for none.
        shot: The shot.
        clip: The frames of the shot.
        path: File to write.

    Raises:
        OptionError: The file is no .mp4.
    """
    if path.suffix.lower() != ".mp4":
        raise OptionError(f"--share writes an .mp4 file; got {path}")
    fit, naming = view_shot(shot), record.naming
    background = estimate_hidden_background(build_ball_timeline(shot.scene, shot.tracks, fit), clip)
    t, balls = find_moment(record, call)
    nothing = np.empty((0, 2))
    pocket = _trace_pocket(record.table, call.subject[1]) if call.kind == "pocket" else nothing
    moment = SharedMoment(
        t, balls, nothing if line is None else line, pocket, text.question, text.headline, text.margin, text.sentence
    )
    place = np.mean([record.position_at(record.ball_index(one), t) for one in balls], axis=0)
    paths = list(np.moveaxis(record.path, 1, 0))
    plan = draw_table_plan(
        record.table, naming, record.ids, paths, place[None], "", longest=WIDTH, name_px=PLAN_NAME_PX
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(path) as part:
        render_share_clip(clip, estimate_clip_appearance(background, clip), fit, naming, moment, plan, part)


def find_moment(record: ShotRecord, call: CallAnswer) -> tuple[float, tuple[str, ...]]:
    """Find the moment that a clip shows, s, and its balls: that of the answer, else when two balls were nearest.

    Args:
        record: Fitted motion of a shot.
        call: The answer; one such as "no ball" has no moment.
    """
    if np.isfinite(call.t) and call.balls:
        return call.t, call.balls
    one = record.ball_index(call.subject[0])
    distance = np.linalg.norm(record.path - record.path[:, [one]], axis=2)
    distance[:, one] = np.nan
    k, other = np.unravel_index(np.argmin(np.nan_to_num(distance, nan=np.inf)), distance.shape)
    return float(record.moments[k]), tuple(dict.fromkeys((record.ids[one], record.ids[int(other)])))


def _trace_pocket(table: Table, name: str) -> FloatArray:
    """Trace the circle (n, 2), m, in which the centre of a ball drops into a pocket."""
    angle = np.linspace(0, 2 * np.pi, CIRCLE_POINTS)
    circle = POCKET_MOUTH_RADII * table.ball_radius * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.asarray(table.pocket_centres[POCKETS.index(name)] + circle)
