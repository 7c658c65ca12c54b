"""An oracle that knows the missing effects: how far it closes the gap, and which effects it cannot separate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diagnosis.fitting.diagnosis_windows import fit_adaptively
from diagnosis.fitting.gap_closure import GapClosure, measure_closure
from diagnosis.fitting.hypothesis_fits import (
    DiagnosisProblem,
    EffectFit,
    build_diagnosis_problem,
    fit_effects,
    linearize_fit,
)
from diagnosis.fitting.noise_estimation import NoiseEstimate, apply_noise_estimate, estimate_noise
from diagnosis.fitting.shot_split import split_shots
from diagnosis.selection.signatures import compute_signatures
from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.gap_scenes.gap_scene import GapScene

SEPARATION_CHI2 = 9.0
"""chi2 from which two causes are separable when only they are compared: three standard deviations."""


@dataclass(frozen=True, slots=True)
class Oracle:
    """The shots of a case as the diagnosis splits them, and the fit of the simulator."""

    problem: DiagnosisProblem
    noise: NoiseEstimate
    fitting_shots: tuple[Recording, ...]
    """Fitting and selection shots."""
    holdout_shots: tuple[Recording, ...]
    """Hold-out shots."""
    base: EffectFit
    """Fit of the simulator."""

    def fit_with_effects(self, names: frozenset[str], forms: tuple[str, ...] = ()) -> EffectFit:
        """Fit a simulator that also has these effects, and contact models of these forms where given."""
        return fit_adaptively(self.problem, self.fitting_shots, tuple(sorted(names)), forms or None)

    def measure_closure(self, better: EffectFit, shots: tuple[Recording, ...]) -> GapClosure:
        """Measure which share of the prediction error the true simulator removes on hold-out shots."""
        with_sigmas = apply_noise_estimate(shots, self.noise)
        return measure_closure(self.problem, with_sigmas, self.base, better, np.random.default_rng(0))

    def can_separate(self, truth: EffectFit, other: frozenset[str]) -> bool:
        """Return whether other effects explain the same shots worse than the true ones."""
        rival = fit_effects(self.problem, truth.segments, tuple(sorted(other)))
        return (rival.cost - truth.cost) / truth.lack_of_fit > SEPARATION_CHI2

    def strength_sigmas(self, names: frozenset[str], strengths: FloatArray) -> float:
        """Return how many standard deviations the strengths (p,) of missing effects are, all else adjusted."""
        mask = self.problem.mask(tuple(names))
        effect_signatures = compute_signatures(
            self.problem,
            linearize_fit(self.problem, self.base).shot_information,
            self.base.free,
            self.base.lack_of_fit,
        )
        size: float = float(strengths @ effect_signatures.information[np.ix_(mask, mask)] @ strengths)
        return float(np.sqrt(max(size, 0.0)))


def build_oracle(scene: GapScene, recordings: tuple[Recording, ...]) -> Oracle:
    """Split recordings and fit the simulator.

    Args:
        scene: Scene with a catalogue of effects.
        recordings: One recording per shot.

    Returns:
        The oracle.

    Raises:
        ValueError: There is nothing to fit.
    """
    split = split_shots(recordings)
    noise = estimate_noise((*split.fitting, *split.selection))
    question = build_diagnosis_problem(scene, noise.correlation)
    opened = apply_noise_estimate((*split.fitting, *split.selection), noise)
    return Oracle(question, noise, opened, split.holdout, fit_adaptively(question, opened))
