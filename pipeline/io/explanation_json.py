"""The explanation of a shot in scene.json."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np

from models.core.errors import OptionError
from models.core.events import Events
from models.core.shot_explanation import Cause, CauseHypothesis, Doubt, Moment, ShotExplanation, explain_by_events


def describe_explanation(explanation: ShotExplanation) -> dict[str, Any]:
    """Describe an explanation for scene.json.

    Args:
        explanation: All moments with their hypotheses.

    Returns:
        JSON object.
    """
    return {
        "moving_at_start": list(explanation.moving_at_start),
        "moments": [
            {
                "ball": moment.ball, "t": moment.t, "t_sigma": moment.t_sigma,
                "x": float(moment.xy[0]), "y": float(moment.xy[1]), "doubts": list(moment.doubts),
                "hypotheses": [
                    {"cause": one.cause, "other": one.other, "probability": one.probability}
                    for one in moment.hypotheses
                ],
            }
            for moment in explanation.moments
        ],
    }  # fmt: skip


def parse_explanation(scene: dict[str, Any], events: Events) -> ShotExplanation:
    """Parse the explanation of a scene.json.

    Args:
        scene: Content of the scene.json.
        events: Events of the folder, which stand for the explanation in folders of older versions.

    Returns:
        The explanation.

    Raises:
        OptionError: The entry is malformed.
    """
    entry = scene.get("explanation")
    if entry is None:
        return explain_by_events(events)
    try:
        return ShotExplanation(
            tuple(_parse_moment(moment) for moment in entry["moments"]),
            tuple(str(name) for name in entry["moving_at_start"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise OptionError(f"scene.json has an explanation that cannot be used: {error}") from error


def _parse_moment(moment: dict[str, Any]) -> Moment:
    hypotheses = tuple(
        CauseHypothesis(_require(one["cause"], Cause), str(one["other"]), float(one["probability"]))
        for one in moment["hypotheses"]
    )
    if not hypotheses:
        raise ValueError("a moment has no hypothesis")
    doubts = tuple(_require(name, Doubt) for name in moment["doubts"])
    xy = np.array([moment["x"], moment["y"]], dtype=np.float64)
    return Moment(str(moment["ball"]), float(moment["t"]), float(moment["t_sigma"]), xy, hypotheses, doubts)


def _require(word: str, allowed: Any) -> Any:
    """Return a word; raise ValueError if it is none of the allowed ones."""
    if word not in get_args(allowed):
        raise ValueError(f"{word!r} is none of {', '.join(get_args(allowed))}")
    return word
