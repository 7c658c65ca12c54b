"""Close passes of a recorded shot that are tested again with another cloth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import staged_shot as shot

from models.core.shot_explanation import CauseHypothesis, Moment, ShotExplanation
from models.estimation.contact_test.contact_moment import USUAL_CLOTH
from models.estimation.contact_test.contact_probability import ContactTestResult
from models.estimation.contact_test.shot_record import ShotRecord, make_shot_record
from models.estimation.reconstruction import shot_moments


def test_only_close_passes_are_tested_again_with_the_friction_of_the_record(monkeypatch: pytest.MonkeyPatch) -> None:
    times = np.arange(31) / shot.RATE
    fit = shot.fit(times)
    halves = CauseHypothesis("none", "", 0.5), CauseHypothesis("ball", "red", 0.5)
    graze = Moment("cue", 0.5, 1e-3, np.zeros(2), halves, ("close_pass",))
    strike = Moment("cue", 0.1, 1e-3, np.zeros(2), (CauseHypothesis("strike", "", 1.0),))
    scene = shot.scene()
    record = make_shot_record(
        shot.tracks(times), fit.events, fit.trajectory, scene.table, scene.camera, ShotExplanation((strike, graze))
    )
    cloth = replace(USUAL_CLOTH[0], sigma=0.05), USUAL_CLOTH[1]

    def evaluate(given: ShotRecord, one: int, two: int, t: float) -> ContactTestResult:
        assert given.cloth == cloth
        assert (given.ids[one], given.ids[two], t) == ("cue", "red", 0.5)
        return ContactTestResult(0.999, t, 1e-3, -1e-3, 1e-4, 1.0, 0.0, 0.5)

    monkeypatch.setattr(shot_moments, "evaluate_close_pass", evaluate)
    first, second = shot_moments.reevaluate_close_passes(replace(record, cloth=cloth)).explanation.moments
    assert first == strike
    assert second.best.cause == "ball"
    assert second.best.probability > 0.5
