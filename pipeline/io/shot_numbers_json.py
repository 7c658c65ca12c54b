"""Numbers of shots in scene.json."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from models.core.errors import OptionError
from models.core.fit_result import SPIN_STATES, ShotNumber, ShotNumbers
from pipeline.io.strict_json import replace_nonfinite

# Key of scene.json.
KEY = "shot_numbers"


def describe_shot_numbers(shots: Sequence[ShotNumbers]) -> list[dict[str, Any]]:
    """Describe the numbers of shots for scene.json.

    Args:
        shots: Numbers per shot.

    Returns:
        One object of strict JSON per shot.
    """
    return [
        {
            "t": shot.t, "cue": shot.cue, "first": shot.first, "spin_state": shot.spin_state,
            "spin_state_probabilities": dict(zip(SPIN_STATES, shot.spin_state_probabilities, strict=False)),
            "potted": [{"ball": a, "pocket": b} for a, b in zip(shot.potted, shot.pockets, strict=True)],
            "numbers": [replace_nonfinite(asdict(one)) for one in shot.numbers],
        }
        for shot in shots
    ]  # fmt: skip


def parse_shot_numbers(scene: dict[str, Any]) -> tuple[ShotNumbers, ...]:
    """Parse the numbers of the shots of a scene.json.

    Args:
        scene: Content of the scene.json.

    Returns:
        Numbers per shot.

    Raises:
        OptionError: It has none, or they are malformed.
    """
    if KEY not in scene:
        raise OptionError("was written by a version without shot numbers; run the clip again")
    try:
        return tuple(_parse_shot(entry) for entry in scene[KEY])
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise OptionError(f"has shot numbers that cannot be used: {error}") from error


def _parse_shot(entry: dict[str, Any]) -> ShotNumbers:
    potted = entry["potted"]
    return ShotNumbers(
        float(entry["t"]), str(entry["cue"]), str(entry["first"]), entry["spin_state"],
        tuple(float(p) for p in entry["spin_state_probabilities"].values()),
        tuple(str(one["ball"]) for one in potted), tuple(str(one["pocket"]) for one in potted),
        tuple(_parse_number(one) for one in entry["numbers"]),
    )  # fmt: skip


def _parse_number(entry: dict[str, Any]) -> ShotNumber:
    value, sigma = (float("nan") if entry[name] is None else float(entry[name]) for name in ("value", "sigma"))
    return ShotNumber(
        str(entry["name"]), value, sigma, str(entry["unit"]), bool(entry["observable"]), str(entry["ball"]),
        str(entry["place"]),
    )  # fmt: skip
