"""Answer to an umpire's question about a run, with close-ups of the moment."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from models.core.answer import Answer, Quantity
from models.core.errors import OptionError, TruerollError
from models.core.naming import Naming
from models.core.scene import POCKETS, Camera
from models.core.typing import FloatArray
from models.estimation.contact_test import call_answers
from models.estimation.contact_test.call_answers import CallAnswer
from models.estimation.contact_test.rule_answers import GAMES, LOWEST_BALL_GAMES, answer_foul, answer_score
from models.estimation.contact_test.shot_record import ShotRecord
from pipeline.engine.atomic_write import replace_file, require_writable_folder
from pipeline.io.run_folder import SOURCE_FILE, read_scene_document
from pipeline.io.shot_folder import read_shot
from pipeline.reporting.text.call_sentences import CallWords, format_call, format_sequence
from video.io.clip import Clip, open_clip, read_frames
from video.io.clip_digest import compute_clip_digest
from video.overlay.close_up import CloseUpFrame, NamedOutline, draw_close_up, draw_frame_strip

QUESTIONS = ("contact", "first", "cushion-first", "pocket", "line", "score", "foul")
USAGE = "ask contact A B, first A, cushion-first A, pocket A top-left, line x=0.635 A, score, or foul"
UNTOLD = "A push or a double hit cannot be told from the clip: the tip of the cue is not tracked."
NUMBERS_UNKNOWN = "Which ball had to be hit first is not judged: the numbers of the balls are not known."
FIRST_BALL_UNKNOWN = "Which ball had to be hit first is not judged: name it with --on, such as --on solids or --on red."
LINE_POINTS = 33
"""Points of a drawn line; lens distortion may bend it."""
STRIP_NEIGHBOURS = 2
"""Frames of a strip before and after the nearest one."""


def answer_question(
    record: ShotRecord, words: Sequence[str], edge: bool = False, game: str = "", on: str = ""
) -> CallAnswer:
    """Answer a question.

    Args:
        record: Observations and fitted motion of a shot.
        words: The question, split at spaces; balls and pockets by their ids or by their names in the clip.
        edge: Whether a line is crossed by the edge of the ball instead of its centre.
        game: Game whose fouls are meant; empty for those common to the games of the table.
        on: What had to be hit first, see `answer_foul`; empty if unknown.

    Returns:
        The answer with its probability.

    Raises:
        OptionError: The question is malformed, or names an unknown ball, pocket or line.
    """
    kind, *rest = " ".join(words).split()
    if kind not in QUESTIONS or not (rest or kind in ("score", "foul")):
        raise OptionError(f"{USAGE}; got {' '.join(words)!r}")
    if edge and kind != "line":
        raise OptionError(f"--edge belongs to line; got {' '.join(words)!r}")
    if (game or on) and kind != "foul":
        raise OptionError(f"--game and --on belong to foul; got {' '.join(words)!r}")
    naming = record.naming
    try:
        if kind == "score":
            return answer_score(record, _require_ball(naming, rest) if rest else "")
        if kind == "foul":
            return answer_foul(record, _require_ball(naming, rest) if rest else "", game, naming.find_ball(on) or on)
        if kind == "line":
            axis, at = _parse_line(rest[0])
            return call_answers.answer_line(record, _require_ball(naming, rest[1:]), axis, at, edge)
        if kind == "first":
            return call_answers.answer_first_contact(record, _require_ball(naming, rest))
        if kind == "cushion-first":
            return call_answers.answer_cushion_first(record, _require_ball(naming, rest))
        if kind == "pocket":
            if not record.table.pockets:
                raise OptionError("this table has no pockets")
            return call_answers.answer_pocket(
                record, *_split_words(naming, rest, naming.find_pocket, _list_pockets(naming))
            )
        return call_answers.answer_contact(record, *_split_words(naming, rest, naming.find_ball, ""))
    except ValueError as error:
        raise OptionError(str(error)) from error


def _require_ball(naming: Naming, words: Sequence[str]) -> str:
    """Return the id of the ball that words name."""
    ball = naming.find_ball(" ".join(words))
    if ball is None:
        raise OptionError(f"a ball is one of {naming.list_balls()}; got {' '.join(words)!r}")
    return ball


def _split_words(
    naming: Naming, words: Sequence[str], find_second: Callable[[str], str | None], second: str
) -> tuple[str, str]:
    """Split words into a ball and a second thing, which may both have names of several words."""
    readings = {
        (ball, other)
        for k in range(1, len(words))
        if (ball := naming.find_ball(" ".join(words[:k]))) and (other := find_second(" ".join(words[k:])))
    }
    if len(readings) == 1:
        return readings.pop()
    problem = "these words can be split in several ways" if readings else f"got {' '.join(words)!r}"
    raise OptionError(f"{second and f'{second}; '}a ball is one of {naming.list_balls()}; {problem}")


def _list_pockets(naming: Naming) -> str:
    """List the pockets by both names."""
    return "a pocket is one of " + ", ".join(f"{naming.view.name_pocket(name)} ({name})" for name in POCKETS)


def answer_call(
    record: ShotRecord, words: Sequence[str], edge: bool, folder: Path, clip: Path | None, target: Path,
    game: str = "", on: str = "", share: Path | None = None,
) -> Answer:  # fmt: skip
    """Answer a question, and write a close-up and a strip of frames of its moment.

    Args:
        record: Observations and fitted motion of a shot.
        words: The question, as in `answer_question`.
        edge: Whether a line is crossed by the edge of the ball instead of its centre.
        folder: Run folder of the shot.
        clip: Video of the shot; None for the one that the run noted.
        target: Folder of the images; created if it does not exist.
        game: Game whose fouls are meant, as in `answer_question`.
        on: What had to be hit first, as in `answer_question`.
        share: Clip to share to write; None for none.

    Returns:
        The answer.

    Raises:
        OptionError: The question is malformed, or names an unknown ball, pocket or line.
        TruerollError: The given clip cannot be read.
    """
    require_writable_folder(target)
    record = replace(record, naming=replace(record.naming, game=GAMES.get(game, record.table.game)))
    call = answer_question(record, words, edge, game, on)
    text = format_call(call, record.naming)
    if share is not None:
        _write_share_clip(record, call, text, folder, clip, share)
    pictures, why_not = write_call_images(record, call, text, folder, clip, target, words)
    figures = (*pictures, *filter(None, [share]))
    parts = [(part, format_call(part, record.naming)) for part in call.parts]
    document = {
        "question": " ".join(words), **_build_document(record, call, text),
        "alternatives": [
            {"answer": name, "name": record.naming.name_ball(name), "probability": p} for name, p in call.alternatives
        ],
        "sequence": [
            {"met": one.other, "t": one.t, "t_sigma": one.t_sigma, "probability": one.probability} for one in call.path
        ],
        "parts": [{"kind": part.kind, **_build_document(record, part, words)} for part, words in parts],
        "pictures": [str(path) for path in pictures], "no_picture": why_not or None,
    }  # fmt: skip
    quantities = [
        Quantity("time", call.t, call.t_sigma, "s"),
        Quantity("margin", 1e3 * call.margin, 1e3 * call.margin_sigma, "mm"),
        *(Quantity(f"lead of cushion {part.subject[3]}", part.lead, part.lead_sigma, "s") for part in call.parts
          if part.kind == "cushions"),
    ]  # fmt: skip
    rows = [("question", "answer", "probability", "because")] if parts else []
    rows += [(words.question, words.verdict, words.probability, words.statement) for _, words in parts]
    notes = [UNTOLD] if call.kind == "foul" else []
    if call.kind == "foul" and call.subject[1] != "carom" and all(part.kind != "wrong-ball" for part in call.parts):
        notes.append(NUMBERS_UNKNOWN if call.subject[1] in LOWEST_BALL_GAMES else FIRST_BALL_UNKNOWN)
    return Answer(
        text.question, tuple(filter(None, [text.sentence, format_sequence(call, record.naming)])), text.verdict,
        call.stated_probability, tuple(one for one in quantities if math.isfinite(one.value)), tuple(rows),
        (*notes, *((f"No image: {why_not}",) if why_not else ())), document=document,
        figures=tuple(map(str, figures)),
    )  # fmt: skip


def _build_document(record: ShotRecord, call: CallAnswer, text: CallWords) -> dict[str, Any]:
    """Build the JSON values of a call without those of its parts."""
    numbers = {
        "probability": call.probability, "stated_probability": call.stated_probability, "t": call.t,
        "t_sigma": call.t_sigma, "frame": call.frame, "margin_mm": 1e3 * call.margin,
        "margin_mm_sigma": 1e3 * call.margin_sigma, "lead": call.lead, "lead_sigma": call.lead_sigma,
    }  # fmt: skip
    return {
        "asked": text.question, "verdict": call.verdict, "answer": text.verdict,
        **{name: value if math.isfinite(value) else None for name, value in numbers.items()},
        "reason": text.reason or None, "sentence": text.sentence, "margin": text.margin or None,
        "moved": list(call.moved),
    }  # fmt: skip


def _write_share_clip(
    record: ShotRecord, call: CallAnswer, text: CallWords, folder: Path, clip: Path | None, path: Path
) -> None:
    """Write a clip to share, for which the frames of the shot are needed."""
    from pipeline.actions.share_call import write_share_clip  # slow to import

    require_writable_folder(path.parent)
    source, why_not = find_run_clip(folder, clip)
    if source is None:
        raise OptionError(f"--share needs the frames of the shot: {why_not}")
    footage = select_run_subclip(folder, open_clip(source))
    write_share_clip(record, call, text, _sample_line(record, call), read_shot(folder), footage, path)


def _parse_line(text: str) -> tuple[str, float]:
    """Parse a line across the table, such as `x=0.635`, into its axis and coordinate (m)."""
    match = re.fullmatch(r"([xy])=([+-]?(?:\d+\.?\d*|\.\d+))", text)
    if match is None:
        raise OptionError(f"a line must be given as x=0.635 or y=0.3, in metres; got {text!r}")
    return match.group(1), float(match.group(2))


def write_call_images(
    record: ShotRecord, call: CallAnswer, text: CallWords, folder: Path, clip: Path | None, target: Path,
    words: Sequence[str],
) -> tuple[list[Path], str]:  # fmt: skip
    """Write a close-up and a strip of frames of the moment of a call.

    Args:
        record: Observations and fitted motion of a shot.
        call: The answer.
        text: The answer in words.
        folder: Run folder of the shot.
        clip: Video of the shot; None for the one that the run noted.
        target: Folder of the images; created if it does not exist.
        words: The question, for the file names.

    Returns:
        Paths of the images and an empty string, or no paths and the reason.

    Raises:
        TruerollError: The given clip cannot be read.
    """
    if not np.isfinite(call.t) or record.camera is None:
        return [], "the answer has no time." if record.camera else "the folder has no calibration."
    source, why_not = find_run_clip(folder, clip)
    if source is None:
        return [], why_not
    shown = record.frame[np.argsort(np.abs(record.shown - call.t), kind="stable")[: 2 * STRIP_NEIGHBOURS + 1]]
    try:
        frames = dict(read_frames(select_run_subclip(folder, open_clip(source)), indices=np.sort(shown)))
    except (TruerollError, ValueError) as error:
        if clip is not None:
            raise
        return [], f"{source} cannot be read: {error}"
    target.mkdir(parents=True, exist_ok=True)
    name = re.sub(r"[^A-Za-z0-9.=-]+", "_", "call " + " ".join(words))
    line = _sample_line(record, call)
    scenery = [
        _build_close_up_frame(record, record.camera, call, int(frame), image, line)
        for frame, image in sorted(frames.items())
    ]
    nearest = min(scenery, key=lambda scene: abs(scene.t - call.t))
    paths = [target / f"{name}.png", target / f"{name}_strip.png"]
    lines = [text.question, *filter(None, [text.margin]), text.moment]
    close = draw_close_up(nearest, f"{text.verdict}  ({text.probability})", lines)
    for path, image in zip(paths, (close, draw_frame_strip(scenery, call.t)), strict=True):
        with replace_file(path) as part:
            Image.fromarray(image).save(part, format="PNG")
    return paths, ""


def find_run_clip(folder: Path, clip: Path | None) -> tuple[Path | None, str]:
    """Find the video of a run: the given one, otherwise the one that the run noted if it is still the same file.

    Args:
        folder: Run folder.
        clip: Video that the user named; None for the noted one.

    Returns:
        The path and an empty string, or None and the reason.

    Raises:
        OptionError: The given clip is no file.
    """
    if clip is not None:
        if not clip.is_file():
            raise OptionError(f"A clip was expected; {clip} is not a file")
        return clip, ""
    digest = (read_scene_document(folder / "scene.json").get("clip") or {}).get("sha256")
    try:
        noted = Path(json.loads((folder / SOURCE_FILE).read_text(encoding="utf-8"))["path"])
        same = digest is None or compute_clip_digest(noted) == digest
    except (OSError, ValueError, KeyError, TypeError):
        return None, "the clip of this run has been moved; name it with --clip."
    return (noted, "") if same else (None, f"{noted} is now another clip; name the right one with --clip.")


def select_run_subclip(folder: Path, clip: Clip) -> Clip:
    """Return the part of the clip that the run was computed from.

    Args:
        folder: Run folder.
        clip: The whole clip.

    Returns:
        The part with the frames and times of the run.
    """
    with suppress(OSError, ValueError, KeyError, TypeError):
        noted = json.loads((folder / SOURCE_FILE).read_text(encoding="utf-8"))
        return clip.extract_subclip(int(noted["first"]), int(noted["stop"]))
    return clip


def _sample_line(record: ShotRecord, call: CallAnswer) -> FloatArray | None:
    """Sample points (n, 2) m of the line in question across the table; None where there is none."""
    if call.kind != "line":
        return None
    axis, at = _parse_line(call.subject[1])
    along = np.linspace(0, record.table.width if axis == "x" else record.table.length, LINE_POINTS)
    columns = (np.full(LINE_POINTS, at), along)
    return np.column_stack(columns if axis == "x" else columns[::-1])


def _build_close_up_frame(
    record: ShotRecord, camera: Camera, call: CallAnswer, frame: int, image: NDArray[np.uint8], line: FloatArray | None
) -> CloseUpFrame:
    """Build a close-up frame with the fitted outlines of the balls concerned and the line (n, 2) m in question."""
    t = float(record.shown[np.searchsorted(record.frame, frame)])
    drift = estimate_drift(record, camera, t)
    outlines = _build_outlines(record, camera, call, t, drift)
    line_px = None if line is None else camera.to_pixels(line, record.table.ball_radius) + drift
    pocket = _outline_pocket(record, camera, call.subject[1], drift) if call.kind == "pocket" else None
    moment = _build_outlines(record, camera, call, call.t, drift)
    return CloseUpFrame(image, frame, t, outlines, moment, line_px, pocket)


def _outline_pocket(record: ShotRecord, camera: Camera, name: str, drift: FloatArray) -> NamedOutline:
    """Build the circle of a pocket in which the centre of a ball drops."""
    table, centre = record.table, record.table.pocket_centres[POCKETS.index(name)]
    radius = float(camera.radius_px(centre, call_answers.POCKET_MOUTH_RADII * table.ball_radius))
    return NamedOutline(record.naming.name_pocket(name), camera.to_pixels(centre, table.ball_radius) + drift, radius)


def _build_outlines(
    record: ShotRecord, camera: Camera, call: CallAnswer, t: float, drift: FloatArray
) -> tuple[NamedOutline, ...]:
    """Build the fitted outlines at t (s) of the balls concerned."""
    outlines = []
    for name in call.balls:
        place = record.position_at(record.ball_index(name), t)
        if np.isfinite(place).all():
            centre = camera.to_pixels(place, record.table.ball_radius) + drift
            shown = record.naming.name_ball(name)
            outlines.append(NamedOutline(shown, centre, float(camera.radius_px(place, record.table.ball_radius))))
    return tuple(outlines)


def estimate_drift(record: ShotRecord, camera: Camera, t: float) -> FloatArray:
    """Estimate the shift of a frame from the reference frame by the positions of its balls.

    Args:
        record: Observations of a shot.
        camera: The calibration.
        t: Time of the frame, s.

    Returns:
        Shift (2,), px; 0 where the frame has no ball.
    """
    rows = np.abs(record.t - t) < 1e-9
    if not rows.any():
        return np.zeros(2)
    there = camera.to_pixels(record.xy[rows], record.table.ball_radius)
    shift: FloatArray = np.nanmedian(record.px[rows] - there, axis=0)
    return shift if np.isfinite(shift).all() else np.zeros(2)
