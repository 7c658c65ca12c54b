"""A clip to share that shows the moment of a call and its answer."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from models.core.errors import OptionError
from models.core.shot import Shot
from models.core.typing import FloatArray
from models.estimation.contact_test.call_answers import CallAnswer
from models.estimation.contact_test.shot_record import ShotRecord
from pipeline.engine.atomic_write import replace_file
from pipeline.io.run_views import view_run
from pipeline.reporting.text.call_sentences import CallWords
from video.drawing.table_plan import draw_table_plan
from video.io.clip import Clip
from video.matting.ball_timeline import build_ball_timeline
from video.matting.hidden_background import estimate_hidden_background
from video.overlay.share_clip import WIDTH, SharedMoment, render_share_clip
from video.synthesis.frame_synthesis import estimate_clip_appearance

# px, font size of the names on the plan.
PLAN_NAME_PX = 20


def write_share_clip(
    record: ShotRecord, call: CallAnswer, text: CallWords, mark: FloatArray, shot: Shot, clip: Clip, path: Path
) -> None:
    """Write a clip to share of the moment of a call.

    Args:
        record: Observations and fitted motion of the shot.
        call: The answer.
        text: The answer in words.
        mark: The line or pocket in question (n, 2), m; empty for none.
        clip: The frames of the shot.
        path: File to write.

    Raises:
        OptionError: The file is no .mp4, or the answer has no moment.
    """
    if path.suffix.lower() != ".mp4":
        raise OptionError(f"--share writes an .mp4 file; got {path}")
    if not np.isfinite(call.t):
        raise OptionError("A clip to share shows a moment, and this answer has none; ask for one that has")
    fit, naming = view_run(shot), record.naming
    background = estimate_hidden_background(build_ball_timeline(shot.scene, shot.tracks, fit), clip)
    words = text.question, text.headline, text.margin, text.sentence
    moment = SharedMoment(call.t, call.balls, mark, *words)
    place = np.mean([record.position_at(record.ball_index(one), call.t) for one in call.balls], axis=0)
    paths = list(np.moveaxis(record.path, 1, 0))
    plan = draw_table_plan(
        record.table, naming, record.ids, paths, place[None], "", longest=WIDTH, name_px=PLAN_NAME_PX
    )
    with replace_file(path) as part:
        render_share_clip(clip, estimate_clip_appearance(background, clip), fit, naming, moment, plan, part)
