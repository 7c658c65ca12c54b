"""An effect whose strength would have to become negative where a fit begins is also begun from a usual strength."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from support.pucks import AIR_DRAG, FRICTION, SIDEWAYS, SLOPE, Effect, Filming, Gliding, Pucks, film, one

from diagnosis.fitting.diagnosis_windows import split_into_segments
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, build_diagnosis_problem, fit_effects
from diagnosis.fitting.shot_preparation import WHITE_NOISE, apply_noise_estimate, estimate_noise
from diagnosis.selection.effect_selection import (
    REFITS_PER_STEP,
    fit_without_effect,
    needs_all_effects,
    propose_hypotheses,
)
from diagnosis.selection.hypotheses import EffectSearch, Hypothesis
from diagnosis.selection.hypothesis_trials import try_hypothesis
from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray
from models.estimation.multiple_shooting.shooting_windows import LinearizedWindow

STRENGTH = 1.2
"""1/s, size of the true strength of the sideways force."""


@dataclass(frozen=True)
class BentPucks(Pucks):
    """Pucks whose sideways force is s (s - side) of its strength s, which is 0 or has the sign of `side`."""

    side: float = 1.0

    def build_model(
        self, segments: tuple[Recording, ...], forms: tuple[str, ...], jacobian_mask: BoolArray | None = None
    ) -> Gliding:
        return BentGliding(self, segments, super().build_model(segments, forms, jacobian_mask).wanted)


class BentGliding(Gliding):
    """The model of these pucks."""

    def linearize(self, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
        k = self.scene.names.index("sideways.c")
        assert isinstance(self.scene, BentPucks)
        bent = np.array(shared)
        bent[k] = shared[k] * (shared[k] - self.scene.side)
        linear = super().linearize(window, start, bent)
        linear.shared_jacobian[:, :, k] *= 2 * shared[k] - self.scene.side
        return linear


def search_bent_pucks(side: float, slope: Effect = SLOPE, most: float = 3.0) -> EffectSearch:
    """Begin a search with pucks whose sideways force is uphill from its bound."""
    low, high = sorted((0.0, most * side))
    bent = Effect("sideways", (one("c", "1/s", 1.0, low, high),), (0.0,))
    problem = build_diagnosis_problem(BentPucks((FRICTION, slope, bent), side=side), WHITE_NOISE)
    truth = {"friction.mu": 0.02, "sideways.c": STRENGTH * (STRENGTH - 1)}
    filmed = film(np.random.default_rng(1), truth, Filming(shots=4))
    base = fit_effects(problem, split_into_segments(problem, apply_noise_estimate(filmed, estimate_noise(filmed))))
    return EffectSearch(problem, Hypothesis(frozenset(), base), simulator_fit=base)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_effect_that_begins_uphill_from_its_bound_is_found_beyond_the_hill(side: float) -> None:
    search = search_bent_pucks(side)
    problem, base = search.problem, search.base.fitted
    stuck = fit_effects(problem, base.segments, ("sideways",), base.forms, base.shared, base.starts)
    assert stuck.shared[problem.mask(("sideways",))] == 0
    fitted = try_hypothesis(search, frozenset({"sideways"}), search.base).fitted
    assert fitted.shared[problem.mask(("sideways",))] == pytest.approx(side * STRENGTH, abs=0.02)
    assert fitted.lack_of_fit < 1.2 < stuck.lack_of_fit


@pytest.mark.parametrize("refits", [0, REFITS_PER_STEP])
@pytest.mark.parametrize("partners", [(), ("sideways",)])
def test_a_partner_that_its_bound_keeps_absent_is_tried_beside_what_is_named(
    partners: tuple[str, ...], refits: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To first order the pucks ask for less than no sideways force; where no other is there, it ranks nevertheless."""
    search = search_bent_pucks(1.0, replace(SLOPE, partners=partners))
    monkeypatch.setattr("diagnosis.selection.effect_selection.REFITS_PER_STEP", refits)
    slope = try_hypothesis(search, frozenset({"slope"}), search.base)
    proposed = propose_hypotheses(search, slope)
    assert (frozenset({"slope", "sideways"}) in proposed) >= bool(partners)
    assert len(proposed) == len(set(proposed))
    assert search.blocked_pairs == {frozenset({"slope", name}) for name in partners}


@pytest.mark.parametrize(("most", "starts"), [(3.0, [1.0, 3.0]), (0.8, [0.8])])
def test_each_start_from_a_usual_strength_is_fitted_once(
    most: float, starts: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bounds may cut both to the same."""
    search, tried = search_bent_pucks(1.0, most=most), list[float]()
    column = search.problem.mask(("sideways",))

    def record(problem: DiagnosisProblem, segments: object, *given: Any) -> EffectFit:
        if len(given) == 4:  # neither a coarse fit, which has options, nor from a coarse fit at the bound
            tried.extend(value for value in given[2][column] if value > 0)
        return replace(search.base.fitted, names=given[0])

    monkeypatch.setattr("diagnosis.selection.hypothesis_trials.fit_effects", record)
    try_hypothesis(search, frozenset({"sideways"}), search.base)
    assert tried == starts


def test_of_effects_that_trade_strength_each_must_explain_a_share_of_what_remains_without_it() -> None:
    """The slope explains a quarter of what is left beside the sideways force, and little of all that the simulator
    lacks; the lens remains."""
    generic = replace(AIR_DRAG, kind="probe")
    problem = build_diagnosis_problem(Pucks((FRICTION, SLOPE, SIDEWAYS, generic)), WHITE_NOISE)
    truth = {"friction.mu": 0.02, "sideways.c": 0.6, "slope.slope_x": 2.0, "lens_distortion.k1": 0.01}
    filmed = film(np.random.default_rng(2), truth, Filming(shots=6))
    segments = split_into_segments(problem, apply_noise_estimate(filmed, estimate_noise(filmed)))
    search = EffectSearch(problem, Hypothesis(frozenset(), base := fit_effects(problem, segments)), simulator_fit=base)
    both = try_hypothesis(search, frozenset({"slope", "sideways"}), search.base)
    rest, without = both.fitted.lower_excess_cost, fit_without_effect(search, both, "slope")
    gain = without.cost - both.fitted.cost
    assert 0.1 * without.lower_excess_cost < gain < min(rest, 0.04 * base.lower_excess_cost)
    assert not needs_all_effects(search, both)
    search.blocked_pairs.add(frozenset({"slope", "other"}))
    assert not needs_all_effects(search, both)
    search.blocked_pairs.add(both.names)
    assert needs_all_effects(search, both)
