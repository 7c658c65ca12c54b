"""Answers to an umpire's questions about a rally: where did it land, and how high over the net did it fly?"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from models.core.answer import Answer, Quantity
from models.core.errors import OptionError
from models.core.number_format import format_flight_speed, format_probability
from models.core.rally import Rally
from models.estimation.rally.landing_judgement import LandingCall, judge_landing, judge_net
from models.estimation.rally.landing_margin import format_distance
from models.estimation.rally.stroke_summary import find_service
from pipeline.actions.answer_call import open_run_clip
from pipeline.engine.atomic_write import replace_file, require_writable_folder
from pipeline.reporting.text.rally_sentences import describe_landing_call, format_crossing, format_landing
from pipeline.reporting.text.stroke_sentences import format_point
from video.io.clip import Clip

QUESTIONS = ("landing", "net")
# The area of a service, which is the first stroke of a rally.
SERVICE_BOX = "service-box"


def answer_rally_call(
    rally: Rally, words: Sequence[str], area: str | None, folder: Path, clip: Path | None, target: Path
) -> Answer:
    """Answer a question about a rally, and write a close-up of its landing.

    Args:
        words: `landing`, perhaps with the name of an area, or `net`.
        area: Name of the area; None for that of the words, else the usual one.
        folder: Run folder of the rally.
        clip: Video of the rally; None for the one that the run noted.
        target: Folder of the image; created if it does not exist.

    Returns:
        The answer.

    Raises:
        OptionError: The question is malformed, or names an unknown area.
        TruerollError: The given clip cannot be read.
    """
    require_writable_folder(target)
    answer, call = state_rally_call(rally, words, area, folder)
    if call is None:
        return answer
    figures, why_not = _draw_landing(rally, call, folder, clip, target)
    return replace(
        answer, notes=(f"No image: {why_not}",) if why_not else (), figures=figures,
        document={**answer.document, "pictures": list(figures), "no_picture": why_not or None},
    )  # fmt: skip


def state_rally_call(
    rally: Rally, words: Sequence[str], area: str | None, folder: Path
) -> tuple[Answer, LandingCall | None]:
    """State the answer to a question about a rally in words and numbers, without an image.

    Args:
        words: As in `answer_rally_call`.
        area: Name of the area; None for that of the words, else the usual one.
        folder: Run folder of the rally, which errors name.

    Returns:
        The answer, and the call of a landing; None for the net.

    Raises:
        OptionError: The question is malformed, or names an unknown area.
    """
    kind, *rest = " ".join(words).split() or [""]
    if kind not in QUESTIONS or (kind == "net" and (rest or area)) or len([*rest, *([area] if area else [])]) > 1:
        question = " ".join([*words, *([f"--{area}"] if area else [])])
        raise OptionError(
            f"{folder} holds a rally of {rally.scene.sport.name}: ask landing, landing with one of"
            f" {', '.join(rally.scene.sport.areas)}, or net; got {question!r}"
        )
    if kind == "net":
        return _answer_net(rally), None
    name = area or (rest[0] if rest else None)
    try:
        call = find_service(rally, name) if name == SERVICE_BOX else judge_landing(rally, name)
    except ValueError as error:
        raise OptionError(str(error)) from error
    if call is None:
        raise OptionError(
            "the first stroke of this rally was returned before it landed, or is not known, so the service cannot be"
            " judged; ask landing for the last stroke"
        )
    return _answer_landing(rally, call), call


def _answer_landing(rally: Rally, call: LandingCall) -> Answer:
    """Answer where a rally landed."""
    words = format_landing(call, rally)
    winner = "" if call.area == SERVICE_BOX else format_point(rally, call).headline
    quantities = [
        Quantity("distance", 100 * call.distance, 100 * call.distance_sigma, "cm"),
        Quantity("speed", call.speed, call.speed_sigma, "m/s"),
    ]  # fmt: skip
    if call.landing is not None:
        sigma = np.sqrt(np.diag(call.landing.covariance))
        quantities += [Quantity("xyz"[k], float(call.landing.place[k]), float(sigma[k]), "m") for k in range(2)]
        quantities.append(Quantity("time", call.landing.t, call.landing.t_sigma, "s"))
    return Answer(
        words.question, tuple(filter(None, (winner, words.sentence, words.advice))), words.verdict,
        max(call.probability, call.out_probability), tuple(one for one in quantities if math.isfinite(one.value)),
        document={"question": "landing", "asked": words.question, **describe_landing_call(call, rally)},
    )  # fmt: skip


def _draw_landing(
    rally: Rally, call: LandingCall, folder: Path, clip: Path | None, target: Path
) -> tuple[tuple[str, ...], str]:
    """Draw the close-up of a landing; return its path and an empty string, or no path and the reason."""
    if call.landing is None:
        return (), "the answer has no place."
    footage, why_not = open_run_clip(folder, clip)
    if footage is None:
        return (), why_not
    return write_landing_picture(rally, call, footage, target), ""


def write_landing_picture(rally: Rally, call: LandingCall, footage: Clip, target: Path) -> tuple[str, ...]:
    """Write the close-up of a landing, and return its path."""
    from video.overlay.landing_close_up import draw_landing  # slow to import

    path = target / f"call_landing_{re.sub('[^A-Za-z0-9-]+', '_', call.area)}.png"
    with replace_file(path) as part:
        Image.fromarray(draw_landing(footage, rally, call)).save(part, format="PNG")
    return (str(path),)


def _answer_net(rally: Rally) -> Answer:
    """Answer how high over the net the object flew."""
    name, crossings = rally.scene.sport.object.name, judge_net(rally)
    question = f"How high over the net did the {name} fly?"
    if not crossings:
        text = f"No flight of the {name} over the net is known."
        return Answer(question, (text,), document={"question": "net", "asked": question, "crossings": []})
    last = crossings[-1]
    rows = [
        (f"{one.t:.2f} s", "-" * (one.height < 0) + format_distance(one.height, one.height_sigma),
         format_flight_speed(one.speed), format_probability(one.over_probability))
        for one in crossings
    ]  # fmt: skip
    document = {
        "question": "net", "asked": question,
        "crossings": [
            {"t": one.t, "place": one.place, "height": one.height, "height_sigma": one.height_sigma,
             "speed": one.speed, "probability_over": one.over_probability, "touches": one.is_touch}
            for one in crossings
        ],
    }  # fmt: skip
    sentence = format_crossing(last, name)
    return Answer(
        question, (sentence,), probability=last.over_probability,
        quantities=(Quantity("height", 100 * last.height, 100 * last.height_sigma, "cm"),
                    Quantity("speed", last.speed, unit="m/s"), Quantity("time", last.t, unit="s")),
        rows=(("at", "lowest point over the edge", "speed", "over it"), *rows), document=document,
    )  # fmt: skip
