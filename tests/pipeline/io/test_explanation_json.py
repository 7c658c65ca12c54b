"""The explanation of a shot in scene.json."""

from __future__ import annotations

import json

import numpy as np
import pytest

from models.core.errors import OptionError
from models.core.events import Events
from models.core.shot_explanation import CauseHypothesis, Moment, ShotExplanation
from pipeline.io.explanation_json import describe_explanation, parse_explanation

NO_EVENTS = Events((), *(np.empty(0),) * 3, (), (), np.empty((0, 2)), *(np.empty(0),) * 4)


def _explanation() -> ShotExplanation:
    hypotheses = (CauseHypothesis("ball", "solid-1", 0.6), CauseHypothesis("unexplained", "", 0.4))
    return ShotExplanation((Moment("cue", 0.5, 0.01, np.array([1.0, 0.5]), hypotheses, ("hidden",)),), ("solid-2",))


def test_an_explanation_survives_the_file() -> None:
    entry = json.loads(json.dumps({"explanation": describe_explanation(_explanation())}))
    read = parse_explanation(entry, NO_EVENTS)
    assert read.moving_at_start == ("solid-2",)
    (moment,) = read.moments
    assert (moment.ball, moment.t, moment.doubts) == ("cue", 0.5, ("hidden",))
    assert [(one.cause, one.other, one.probability) for one in moment.hypotheses] == [
        ("ball", "solid-1", 0.6), ("unexplained", "", 0.4)
    ]  # fmt: skip
    assert read.contacts_of("solid-1", "cue") == [(moment, 0.6)]
    assert read.contacts_of("solid-2", "cue") == []


@pytest.mark.parametrize("change", [{"cause": "magic"}, {"probability": "high"}])
def test_a_malformed_explanation_is_an_error_that_names_it(change: dict[str, object]) -> None:
    entry = describe_explanation(_explanation())
    entry["moments"][0]["hypotheses"][0] |= change
    with pytest.raises(OptionError, match="explanation that cannot be used"):
        parse_explanation({"explanation": entry}, NO_EVENTS)


def test_a_folder_of_an_older_version_is_explained_by_its_events() -> None:
    one = np.array([0.5])
    events = Events(("ball",), one, one, one, ("cue",), ("red",), np.array([[1.0, 0.5]]), np.array([0.8]), *(one,) * 3)
    (moment,) = parse_explanation({}, events).moments
    assert moment.best == CauseHypothesis("ball", "red", 0.8)
    assert sum(hypothesis.probability for hypothesis in moment.hypotheses) == pytest.approx(1.0)
