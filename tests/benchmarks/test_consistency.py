"""The comparison of outputs finds every statement that is altered."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.clips.consistency import RunStatements, find_contradictions, read_direction
from models.core.ball_look import BallLook
from models.core.naming import Naming

NAMING = Naming({"cue": BallLook("cue ball"), "solid-1": BallLook("yellow 1"), "solid-2": BallLook("blue 2")})
EVENTS = [
    {"kind": "strike", "t": "0.299877", "t_sigma": "0.000355", "frame": "17.993", "a": "cue", "b": "",
     "probability": "0.983", "gap_mm": "", "speed": "2.511757"},
    {"kind": "ball", "t": "0.538802", "t_sigma": "0.000087", "frame": "32.328", "a": "cue", "b": "solid-1",
     "probability": "0.997658", "gap_mm": "-28.067", "speed": "1.758363"},
]  # fmt: skip
REPORT = (
    "0.5388 s ± 0.1 ms | The cue ball and yellow 1 touch at 1.76 m/s (6.3 km/h) | 28.1 ± 0.1 mm from a miss | 99.8 %",
    "The cue ball hit yellow 1 first: half ball. It was struck at 0.2999 s ± 0.4 ms and left at 2.51 m/s (9.0 km/h).",
    "Cut angle | yellow 1 | 30.5 ± 0.3° left",
)
TERMINAL = "Shot: the cue ball at 0.2999 s, 2.51 ± 0.01 m/s (9.0 km/h), cut 30.5 ± 0.3° left, yellow 1 first (half)"


def find_kinds(report: tuple[str, ...], terminal: str) -> set[str]:
    run = RunStatements(Path(), NAMING, EVENTS)
    statements = [*run.read_events(), *run.read_rows(report, "report"), *run.read_rows([terminal], "terminal of run")]
    return {kind for kind, *_ in find_contradictions(statements)}


def test_a_rail_that_a_ball_touches_is_no_ball() -> None:
    run = RunStatements(Path(), NAMING, [{**EVENTS[1], "kind": "cushion", "b": "top"}])
    found = list(run.read_rows([f"The cue ball touched {NAMING.say('top')} at 0.5388 s ± 0.1 ms."], "report"))
    assert {one.key[1] for one in found if one.key[0] == "event"} == {"cushion cue top 0"}


@pytest.mark.parametrize(
    ("shown", "angle"),
    [("15.4 ± 0.1° to the long rails, towards «right» and «bottom»", "15.4°"),
     ("10 ± 1° to the short rails, towards «top» and «left»", "-100°"), ("2 cushions", "2 cushions")],
)  # fmt: skip
def test_a_direction_by_rails_is_an_angle(shown: str, angle: str) -> None:
    assert read_direction(shown) == angle


def test_outputs_that_agree_contradict_each_other_nowhere() -> None:
    assert find_kinds(REPORT, TERMINAL) == set()


@pytest.mark.parametrize(
    ("old", "new", "kind"),
    [
        ("0.5388 s", "0.5398 s", "number"),
        ("± 0.1 ms", "± 0.2 ms", "number"),
        ("1.76 m/s", "1.77 m/s", "number"),
        ("6.3 km/h", "6.8 km/h", "number"),
        ("28.1", "28.3", "number"),
        ("99.8 %", "99 %", "number"),
        ("99.8 %", "above 99.9 %", "number"),
        ("and yellow 1 touch", "and blue 2 touch", "event"),
        ("hit yellow 1 first", "hit blue 2 first", "words"),
        ("0.2999 s", "0.2889 s", "number"),
        ("30.5 ± 0.3° left", "30.5 ± 0.3° right", "number"),
        ("30.5 ± 0.3° left", "-30.5 ± 0.3°", "side"),
        ("30.5 ± 0.3° left", "30.5 ± 0.3 deg left", "words"),
        ("30.5 ± 0.3° left", "31 ± 0.3° left", "rounding"),
        ("30.5 ± 0.3° left", "none measurable (30.5 ± 0.3°)", "side"),
    ],
)
def test_an_altered_statement_of_one_output_is_found(old: str, new: str, kind: str) -> None:
    altered = tuple(row.replace(old, new) for row in REPORT)
    assert altered != REPORT
    assert kind in find_kinds(altered, TERMINAL)
