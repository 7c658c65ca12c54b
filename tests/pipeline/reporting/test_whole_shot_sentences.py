"""Sentences on what explains a whole shot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.staged_shot import fit as staged_fit

from models.core.fit_result import WholeShotFit, WholeShotMisfit, WholeShotSolution
from pipeline.reporting.text.fit_sentences import format_whole_shot

MISFIT = WholeShotMisfit("han_2005", "inelastic", 1.35, "red", "cushion", "top", 1.381, 0.0093, 4.2, 3.1)


def test_an_explained_shot_is_described_by_its_model_and_the_noise() -> None:
    laws = WholeShotSolution("han_2005", "inelastic", 1.69, (), 0.0, (), np.empty((0, 7)), np.empty((0, 7, 7)))
    sentence = format_whole_shot(replace(staged_fit(np.arange(31) / 30), laws=WholeShotFit(laws)))
    assert sentence == "Han 2005 explains the shot to 1.3 times the measurement noise."
    laws = replace(laws, equal_models=("mathavan_2010", "mirror"))
    sentence = format_whole_shot(replace(staged_fit(np.arange(31) / 30), laws=WholeShotFit(laws)))
    assert "Mathavan 2010 and Mirror explain it equally well: the shot does not decide between them." in sentence


def test_an_unexplained_shot_is_described_by_its_first_unexplained_contact() -> None:
    sentence = format_whole_shot(replace(staged_fit(np.arange(31) / 30), laws=WholeShotFit(misfit=MISFIT)))
    assert "Han 2005 explains all positions until 1.350 s." in sentence
    assert "that of red and the far long rail at 1.381 s: red deviates by 9.3 mm (RMS), 4.2 times" in sentence
    vague = replace(MISFIT, contact="", other="")
    sentence = format_whole_shot(replace(staged_fit(np.arange(31) / 30), laws=WholeShotFit(misfit=vague)))
    assert "Red then deviates from it by 9.3 mm" in sentence
    assert sentence.endswith("the best model leaves 3.1 times the noise.")


def test_without_a_fit_the_reason_is_given() -> None:
    assert (
        format_whole_shot(replace(staged_fit(np.arange(31) / 30), laws=WholeShotFit(refusal="No ball moved.")))
        == "No ball moved."
    )
