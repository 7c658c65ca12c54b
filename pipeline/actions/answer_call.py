"""Answer to an umpire's question about a run, with close-ups of the moment."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from models.core.answer import Answer, Quantity
from models.core.errors import OptionError, TruerollError
from models.core.naming import Naming, join_names
from models.core.scene import CUSHIONS, POCKETS, Camera
from models.core.typing import FloatArray
from models.estimation.contact_test import call_answers
from models.estimation.contact_test.call_answers import CallAnswer, QuestionKind
from models.estimation.contact_test.rule_answers import FIRST_BALL_GROUPS, answer_foul, answer_score
from models.estimation.contact_test.shot_record import REST_SPEED, ShotRecord
from models.physics.billiards.cushion_geometry import find_mouth_line
from pipeline.engine.atomic_write import replace_file, require_writable_folder
from pipeline.io.run_folder import read_source
from pipeline.io.saved_shot import read_shot
from pipeline.io.strict_json import read_json
from pipeline.reporting.text.call_sentences import CallWords, format_call, format_sequence
from pipeline.stages.read_stage import ReadOptions
from video.io.clip import Clip, open_clip, read_frames
from video.io.clip_digest import compute_clip_digest
from video.overlay.close_up import CloseUpFrame, NamedOutline, draw_close_up, draw_frame_strip

# Answers to the questions that name a ball alone.
ABOUT_ONE_BALL: dict[str, Callable[[ShotRecord, str], CallAnswer]] = {
    "first": call_answers.answer_first_contact, "cushion-first": call_answers.answer_cushion_first,
    "score": answer_score,
}  # fmt: skip
QUESTIONS = ("contact", "rail", "pocket", "line", "foul", *ABOUT_ONE_BALL)
USAGE = "ask contact A B, rail A left, first A, cushion-first A, pocket A top-left, line x=0.635 A, score, or foul"
UNTOLD = "A push, a double hit, or a ball that leaves the table cannot be told from the clip."
# Questions whose answer may change after the clip.
MAY_HAPPEN_LATER: tuple[QuestionKind, ...] = ("contact", "rail", "pocket", "line", "score", "foul")
STILL_MOVING = "When the clip ends, {} still move{}: what comes later is not judged."
FIRST_BALL_UNKNOWN = "Which ball had to be hit first is not judged: name the ball on, such as {}."
# Points of a drawn line, which lens distortion may bend.
LINE_POINTS = 33
# Frames of a strip before and after the nearest one.
STRIP_NEIGHBOURS = 2


def answer_question(record: ShotRecord, words: Sequence[str], edge: bool = False, on: str = "") -> CallAnswer:
    """Answer a question.

    Args:
        record: Observations and fitted motion of a shot.
        words: The question, split at spaces; balls and pockets by their ids or by their names in the clip.
        edge: Whether a line is crossed by the edge of the ball instead of its centre.
        on: What had to be hit first, see `answer_foul`; empty if unknown.

    Returns:
        The answer with its probability.

    Raises:
        OptionError: The question is malformed, or names an unknown ball, pocket or line.
    """
    kind, *rest = " ".join(words).split() or [""]
    if kind not in QUESTIONS or not (rest or kind in ("score", "foul")):
        raise OptionError(f"{USAGE}; got {' '.join(words)!r}")
    if edge and kind != "line":
        raise OptionError(f"belongs to line; got {' '.join(words)!r}", option="edge")
    if on and kind != "foul":
        raise OptionError(f"belongs to foul; got {' '.join(words)!r}", option="on")
    naming = record.naming
    try:
        if kind == "contact":
            return call_answers.answer_contact(record, *_split_words(naming, words, naming.find_ball))
        if kind == "rail":
            return call_answers.answer_rail(record, *_split_words(naming, words, naming.find_rail))
        if kind == "pocket":
            return call_answers.answer_pocket(record, *_split_words(naming, words, naming.find_pocket))
        if kind == "line":
            axis, at = _parse_line(rest[0])
            return call_answers.answer_line(record, _require_ball(naming, rest[1:]), axis, at, edge)
        ball = _require_ball(naming, rest) if rest else ""
        if kind == "foul":
            return answer_foul(record, ball, naming.find_ball(on) or on)
        return ABOUT_ONE_BALL[kind](record, ball)
    except ValueError as error:
        raise OptionError(str(error)) from error


def _require_ball(naming: Naming, words: Sequence[str]) -> str:
    """Return the id of the ball that words name."""
    ball = naming.find_ball(" ".join(words))
    if ball is None:
        raise OptionError(naming.explain_no_ball(" ".join(words)))
    return ball


def _split_words(naming: Naming, words: Sequence[str], find_second: Callable[[str], str | None]) -> tuple[str, str]:
    """Split a question into a ball and a second thing, which may both have names of several words."""
    kind, *rest = " ".join(words).split()
    if len(rest) < 2:
        needed = "two balls" if kind == "contact" else f"a ball and a {kind}"
        raise OptionError(f"{kind} needs {needed}; got {' '.join(rest)!r}")
    halves = [(" ".join(rest[:k]), " ".join(rest[k:])) for k in range(1, len(rest))]
    pairs = [(naming.find_ball(one), find_second(two)) for one, two in halves]
    readings = {(ball, other) for ball, other in pairs if ball and other}
    if len(readings) == 1:
        return readings.pop()
    if readings:
        raise OptionError(f"the words {' '.join(rest)!r} can be split in several ways")
    problems = [
        (naming.explain_no_ball(one), "" if other else _explain_no_second(naming, kind, two))
        for (one, two), (_, other) in zip(halves, pairs, strict=True)
    ]
    fewest = min(problems, key=lambda pair: (sum(map(bool, pair)), len("".join(pair))))  # the likeliest split
    raise OptionError("; ".join(filter(None, fewest)))


def _explain_no_second(naming: Naming, kind: str, text: str) -> str:
    """Explain why a text names no second ball, pocket or cushion of a question."""
    if kind == "contact":
        return naming.explain_no_ball(text)
    name, places = (naming.view.name_pocket, POCKETS) if kind == "pocket" else (naming.name_rail, CUSHIONS)
    return f"a {kind} is one of {', '.join(f'{name(one)} ({one})' for one in places)}; got {text!r}"


def answer_call(
    record: ShotRecord, words: Sequence[str], edge: bool, folder: Path, clip: Path | None, target: Path,
    on: str = "", share: Path | None = None,
) -> Answer:  # fmt: skip
    """Answer a question, and write a close-up and a strip of frames of its moment.

    Args:
        record: Observations and fitted motion of a shot.
        words: The question, as in `answer_question`.
        edge: Whether a line is crossed by the edge of the ball instead of its centre.
        folder: Run folder of the shot.
        clip: Video of the shot; None for the one that the run noted.
        target: Folder of the images; created if it does not exist.
        on: What had to be hit first, as in `answer_question`.
        share: Clip to share to write; None for none.

    Returns:
        The answer.

    Raises:
        OptionError: The question is malformed, or names an unknown ball, pocket or line.
        TruerollError: The given clip cannot be read.
    """
    require_writable_folder(target)
    call = answer_question(record, words, edge, on)
    text = format_call(call, record.naming)
    footage, why_not = open_run_clip(folder, clip)
    if share is not None:
        from pipeline.actions.share_call import write_share_clip  # slow to import

        if footage is None:
            raise OptionError(f"--share needs the frames of the shot: {why_not}")
        write_share_clip(record, call, text, trace_mark(record, call), read_shot(folder), footage, share)
    pictures: list[Path] = []
    if footage is not None:
        pictures, why_not = write_call_images(
            record, call, text, footage, target, [*words, *(("on", on) if on else ())]
        )
    answer = state_call(record, call, words, on)
    return replace(
        answer, notes=(*answer.notes, *((f"No image: {why_not}",) if why_not else ())),
        document={**answer.document, "pictures": [str(path) for path in pictures], "no_picture": why_not or None},
        figures=tuple(map(str, (*pictures, *filter(None, [share])))),
    )  # fmt: skip


def state_call(record: ShotRecord, call: CallAnswer, words: Sequence[str], on: str = "") -> Answer:
    """State the answer to a question in words and numbers, without images.

    Args:
        record: Observations and fitted motion of a shot.
        call: The answer.
        words: The question, as in `answer_question`.
        on: What had to be hit first, as in `answer_question`.
    """
    text = format_call(call, record.naming)
    parts = [(part, format_call(part, record.naming)) for part in call.parts]
    document = {
        "question": " ".join(words), **_build_document(call, text),
        "alternatives": [
            {"answer": name, "name": record.naming.name_ball(name), "probability": p} for name, p in call.alternatives
        ],
        "sequence": [
            {"met": one.other, "t": one.t, "t_sigma": one.t_sigma, "probability": one.probability} for one in call.path
        ],
        "parts": [{"kind": part.kind, **_build_document(part, own)} for part, own in parts],
    }  # fmt: skip
    quantities = [
        Quantity("time", call.t, call.t_sigma, "s"),
        Quantity("margin", 1e3 * call.margin, 1e3 * call.margin_sigma, "mm"),
    ]  # fmt: skip
    rows = [("question", "answer", "probability", "because")] if parts else []
    rows += [(own.question, own.verdict, own.probability, own.statement) for _, own in parts]
    notes = [UNTOLD] if call.kind == "foul" else []
    end = float(record.moments[-1])
    moving = [
        ball for k, ball in enumerate(record.ids) if ball in call.subject and record.speed_at(k, end) > REST_SPEED
    ]
    if moving and call.verdict == "no" and call.kind in MAY_HAPPEN_LATER:
        notes.append(STILL_MOVING.format(join_names(map(record.naming.say, moving)), "s" * (len(moving) < 2)))
    if call.kind == "foul" and not on:
        notes.append(FIRST_BALL_UNKNOWN.format(" or ".join(FIRST_BALL_GROUPS[record.table.game])))
    return Answer(
        text.question, tuple(filter(None, [text.sentence, format_sequence(call, record.naming)])), text.verdict,
        call.stated_probability, tuple(one for one in quantities if math.isfinite(one.value)), tuple(rows),
        tuple(notes), document=document,
    )  # fmt: skip


def _build_document(call: CallAnswer, text: CallWords) -> dict[str, Any]:
    """Build the JSON values of a call without those of its parts."""
    numbers = {
        "probability": call.stated_probability, "t": call.t, "t_sigma": call.t_sigma, "frame": call.frame,
        "margin_mm": 1e3 * call.margin, "margin_mm_sigma": 1e3 * call.margin_sigma,
    }  # fmt: skip
    return {
        "asked": text.question, "code": call.verdict, "verdict": text.verdict, "likely": text.likely,
        **{name: value if math.isfinite(value) else None for name, value in numbers.items()},
        "reason": text.reason or None, "sentence": text.sentence, "margin": text.margin or None,
        "moved": list(call.moved),
    }  # fmt: skip


def _parse_line(text: str) -> tuple[str, float]:
    """Parse a line across the table, such as `x=0.635`, into its axis and coordinate (m)."""
    match = re.fullmatch(r"([xy])=([+-]?(?:\d+\.?\d*|\.\d+))", text)
    if match is None:
        raise OptionError(f"a line must be given as x=0.635 or y=0.3, in metres; got {text!r}")
    return match.group(1), float(match.group(2))


def write_call_images(
    record: ShotRecord, call: CallAnswer, text: CallWords, footage: Clip, target: Path, words: Sequence[str]
) -> tuple[list[Path], str]:
    """Write a close-up and a strip of frames of the moment of a call.

    Args:
        record: Observations and fitted motion of a shot.
        call: The answer.
        text: The answer in words.
        footage: Frames of the shot.
        target: Folder of the images; created if it does not exist.
        words: The question, for the file names.

    Returns:
        Paths of the images and an empty string, or no paths and the reason.
    """
    if not np.isfinite(call.t) or record.camera is None:
        return [], "the answer has no time." if record.camera else "the folder has no calibration."
    shown = record.frame[np.argsort(np.abs(record.shown - call.t), kind="stable")[: 2 * STRIP_NEIGHBOURS + 1]]
    name = re.sub(r"[^A-Za-z0-9.=-]+", "_", "call " + " ".join(words))
    scenery = [
        _build_close_up_frame(record, record.camera, call, int(frame), image)
        for frame, image in read_frames(footage, indices=np.sort(shown))
    ]
    nearest = min(scenery, key=lambda scene: abs(scene.t - call.t))
    paths = [target / f"{name}.png", target / f"{name}_strip.png"]
    lines = [text.question, *filter(None, [text.margin]), text.moment]
    close = draw_close_up(nearest, f"{text.verdict}  ({text.probability})", lines)
    for path, image in zip(paths, (close, draw_frame_strip(scenery, call.t)), strict=True):
        with replace_file(path) as part:
            Image.fromarray(image).save(part, format="PNG")
    return paths, ""


def open_run_clip(folder: Path, clip: Path | None) -> tuple[Clip | None, str]:
    """Open the video of a run: the given one, or the one that the run was computed from, if that file is unchanged.

    Args:
        folder: Run folder.
        clip: Video that the user named; None for the noted one.

    Returns:
        The part of the video that the run was computed from and an empty string, or None and the reason.

    Raises:
        OptionError: There is no such clip.
        TruerollError: The given clip cannot be read.
    """
    noted = read_source(folder)
    path = noted.get("path") if clip is None else clip
    if path is None or not (source := Path(path)).exists():  # a folder of numbered images is a clip too
        if clip is not None:
            raise OptionError(f"A clip was expected; there is no {clip}")
        return None, "the clip of this run has been moved; name it with --clip."
    try:
        digest = (read_json(folder / "scene.json", "A run folder has a scene.json").get("clip") or {}).get("sha256")
        if clip is None and digest not in (None, compute_clip_digest(source)):
            return None, f"{source} is now another clip; name the right one with --clip."
        settings = noted.get("settings", {})
        read = ReadOptions(settings.get("fps"), settings.get("pixel_aspect"))
        footage = open_clip(source, fps=read.rate, aspect=read.aspect)
    except (TruerollError, OSError) as error:
        if clip is not None:
            raise
        return None, f"{source} cannot be read: {error}"
    return footage.extract_subclip(int(noted["first"]), int(noted["stop"])) if "first" in noted else footage, ""


def trace_mark(record: ShotRecord, call: CallAnswer) -> FloatArray:
    """Trace points (n, 2) m of the line in question, or of the mouth of the pocket in question.

    Args:
        record: The shot.
        call: The answer.

    Returns:
        The points; none for other questions.
    """
    if call.kind == "pocket":
        return find_mouth_line(record.table, call.subject[1]).ends
    if call.kind != "line":
        return np.empty((0, 2))
    axis, at = _parse_line(call.subject[1])
    along = np.linspace(0, record.table.width if axis == "x" else record.table.length, LINE_POINTS)
    points = np.column_stack([np.full(LINE_POINTS, at), along])
    return points if axis == "x" else points[:, ::-1]


def _build_close_up_frame(
    record: ShotRecord, camera: Camera, call: CallAnswer, frame: int, image: NDArray[np.uint8]
) -> CloseUpFrame:
    """Build a close-up frame with the fitted outlines of the balls concerned, and the line or mouth in question."""
    t = float(record.shown[np.searchsorted(record.frame, frame)])
    drift = estimate_drift(record, camera, t)
    outlines = _build_outlines(record, camera, call, t, drift)
    mark = trace_mark(record, call)
    line = camera.to_pixels(mark, record.table.ball_radius) + drift if len(mark) else None
    moment = _build_outlines(record, camera, call, call.t, drift)
    return CloseUpFrame(image, frame, t, outlines, moment, line, shows_line=call.kind == "pocket")


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
