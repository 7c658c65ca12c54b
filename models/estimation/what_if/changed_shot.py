"""A shot played otherwise: paths with uncertainty, events with probabilities, and the probability that it scores."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray
from models.estimation.forecast.ensemble_prediction import PredictedEvent, list_contacts, summarize_events
from models.estimation.what_if.shot_outcome import ShotGoal, is_scored
from models.estimation.what_if.stroke_change import PlayerSpread, StrokeChange, change_stroke
from models.estimation.what_if.struck_ensemble import StruckEnsemble

LONGEST_SHOT = 15.0
"""s that a shot is simulated: all balls rest by then."""


@dataclass(frozen=True, slots=True)
class ChangedShot:
    """M plays of one shot of N balls at T times."""

    t: FloatArray
    """(T,) s after the strike."""
    members: FloatArray
    """(M, T, N, 2) m; NaN once a ball is potted."""
    events: tuple[PredictedEvent, ...]
    """Events that may happen, in the order of time, s after the strike."""
    scored: NDArray[np.bool_]
    """(M,) which plays score."""

    @property
    def probability(self) -> float:
        """Probability that the shot scores, with a Jeffreys prior, so that no finite ensemble is certain."""
        return float((self.scored.sum() + 0.5) / (len(self.scored) + 1.0))

    @property
    def probability_sigma(self) -> float:
        """Standard deviation of `probability` by the size of the ensemble."""
        p = self.probability
        return float(np.sqrt(p * (1 - p) / (len(self.scored) + 2.0)))


def play_changed_shot(
    ensemble: StruckEnsemble, change: StrokeChange, spread: PlayerSpread, goal: ShotGoal, t: FloatArray, seed: int
) -> ChangedShot:
    """Play every member of an ensemble with a changed stroke.

    The same seed gives the same strokes of the player, so that two changes compare.

    Args:
        ensemble: The shot at its strike.
        change: How the stroke differs from the real one.
        spread: Scatter of the player's strokes.
        goal: What must happen to score.
        t: (T,) s after the strike, ascending; paths at these times.
        seed: Random seed of the player's strokes.

    Returns:
        The plays.
    """
    strokes = spread.draw(np.random.default_rng([seed, 1]), len(ensemble.members))
    paths, order, scored = [], [], []
    for member, (factor, turn) in zip(ensemble.members, strokes, strict=True):
        state = member.balls.state.copy()
        radius = float(member.balls.radius[ensemble.cue])
        state[ensemble.cue] = change_stroke(state[ensemble.cue], radius, change, float(factor), float(turn))
        run = member.simulate_from(state, ensemble.table, LONGEST_SHOT)
        contacts = list_contacts(run)
        paths.append(run.states_at(t)[..., :2])
        order.append(contacts)
        scored.append(is_scored(contacts, ensemble.ids, ensemble.cue, goal))
    events = summarize_events(ensemble.ids, 0.0, order, {})
    return ChangedShot(t, np.stack(paths), events, np.array(scored, bool))
