"""Generic laws in a diagnosis: no candidates, and without a column in linearised fits."""

from __future__ import annotations

import numpy as np
from support.reference_frames import PLANE

from diagnosis.fitting.hypothesis_fits import build_diagnosis_problem, fit_effects, linearize_fit
from diagnosis.fitting.shot_preparation import WHITE_NOISE
from models.core.recording import Recording
from models.estimation.gap_scenes.billiards_scene import build_billiards_scene
from models.estimation.gap_scenes.sliding_scene import build_sliding_scene
from models.physics.billiards.tables import TABLE_PRESETS


def test_the_generic_laws_of_billiards_are_no_candidates() -> None:
    problem = build_diagnosis_problem(build_billiards_scene(TABLE_PRESETS["carom-match"], ()), WHITE_NOISE)
    assert problem.probes == ("cloth_force", "cushion_rebound", "ball_impulse")
    assert "slope" in problem.candidates
    assert not set(problem.probes) & set(problem.candidates)


def test_a_linearised_fit_leaves_out_generic_laws_alone() -> None:
    problem = build_diagnosis_problem(build_sliding_scene(), WHITE_NOISE)
    t = np.arange(20) / 60
    places = np.stack([1.2 * t - 0.6 * t**2, 0.3 * t], axis=1)[:, None]
    shot = Recording(0, np.arange(20), t, ("body",), places, np.full((20, 1), 1e-3), PLANE)
    information = linearize_fit(problem, fit_effects(problem, (shot,))).shot_information.information[0]
    generic = problem.mask(problem.probes)
    assert generic.any()
    assert not information[generic].any()
    assert (np.diag(information)[~generic] > 0).all()
