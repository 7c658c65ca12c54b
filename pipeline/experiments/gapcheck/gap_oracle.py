"""Whoever knows what is missing: how far the gap shrinks for them, and what not even they could tell apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diagnosis.fitting.diagnosis_windows import fit_adaptively
from diagnosis.fitting.gap_closure import Closing, closed_ahead
from diagnosis.fitting.hypothesis_fits import Fitted, Question, fit, look, question_of
from diagnosis.fitting.noise_estimation import Noise, estimate_noise, with_noise
from diagnosis.fitting.shot_split import split_shots
from diagnosis.selection.signatures import signatures
from models.core.typing import FloatArray
from models.estimation.gap_scenes.gap_scene import GapScene, Recording

APART = 9.0
"""chi2 from which somebody who compares only two causes can tell them: three standard deviations."""


@dataclass(frozen=True, slots=True)
class Oracle:
    """The shots of a case as the diagnosis splits them, and what the simulator makes of them."""

    question: Question
    noise: Noise
    open: tuple[Recording, ...]
    """Shots that a cause may be sought in."""
    held_out: tuple[Recording, ...]
    base: Fitted

    def knowing(self, names: frozenset[str], forms: tuple[str, ...] = ()) -> Fitted:
        """The fit of a simulator that has these effects as well, and laws of these forms where any are given."""
        return fit_adaptively(self.question, self.open, tuple(sorted(names)), forms or None)

    def closes(self, better: Fitted, shots: tuple[Recording, ...]) -> Closing:
        """How much of the gap a better simulator closes on shots that chose nothing."""
        told = with_noise(shots, self.noise)
        return closed_ahead(self.question, told, self.base, better, np.random.default_rng(0))

    def tells(self, truth: Fitted, other: frozenset[str]) -> bool:
        """Whether other effects explain the same shots worse than the true ones do."""
        rival = fit(self.question, truth.pieces, tuple(sorted(other)))
        return (rival.cost - truth.cost) / truth.lack > APART

    def sigmas(self, names: frozenset[str], strengths: FloatArray) -> float:
        """How many standard deviations strengths (p,) of missing effects are, all else adjusted."""
        mask = self.question.mask(tuple(names))
        found = signatures(self.question, look(self.question, self.base).told, self.base.free, self.base.lack)
        size: float = float(strengths @ found.information[np.ix_(mask, mask)] @ strengths)
        return float(np.sqrt(max(size, 0.0)))


def oracle_of(scene: GapScene, recordings: tuple[Recording, ...]) -> Oracle:
    """ValueError where there is nothing to fit."""
    split = split_shots(recordings)
    noise = estimate_noise((*split.fit, *split.select))
    question = question_of(scene, noise.correlation)
    opened = with_noise((*split.fit, *split.select), noise)
    return Oracle(question, noise, opened, split.report, fit_adaptively(question, opened))
