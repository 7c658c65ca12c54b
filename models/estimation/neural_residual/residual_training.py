"""Training of the neural residual of one scene, and the decision whether it is used.

Shots are split into fitting shots and stopping shots; reporting is up to the caller, on others. A network is trained
from zero output in short rounds; training stops where the prediction of the stopping shots no longer improves. The
network is enabled only where it reduces their prediction error by at least a tenth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.scene import Table
from models.core.typing import FloatArray
from models.estimation.multiple_shooting.fixed_parameters import FixedParameterModel
from models.estimation.multiple_shooting.shooting_fit import ShootingFit, ShootingOptions, fit_windows
from models.estimation.neural_residual.residual_windows import ResidualChains, residual_priors
from models.estimation.whole_shot.cushion_chains import REBOUND_SCATTER, ChainSegment
from models.physics.effect import Prior

MIN_GAIN = 0.1
"""Share of the error on stopping shots that a residual has to remove."""
OUTPUT_SIGMA = 0.1
"""Prior standard deviation of the outputs: typical relative error of friction and rebound models."""
LEAD_TIME = 0.5
"""s of a chain from which the rest is predicted."""
PREDICTION_HORIZON = 2.0
"""s of prediction: beyond that, unobserved spin and scatter dominate."""
_PHYSICS_OPTIONS = ShootingOptions(iterations=20, shot_iterations=8)
_ROUND_OPTIONS = ShootingOptions(iterations=3, shot_iterations=1)
_ROUND_COUNT = 3
_START_OPTIONS = ShootingOptions(iterations=8, shot_iterations=6)
_POLISH_OPTIONS = ShootingOptions(iterations=2, shot_iterations=1)


@dataclass(frozen=True, slots=True)
class TrainedResidual:
    """A trained correction, and its gain on the stopping shots."""

    is_enabled: bool
    """Whether it predicted the stopping shots better by `MIN_GAIN`."""
    weight_priors: tuple[Prior, ...]
    """Priors of the weights, for `ResidualChains`."""
    best_values: FloatArray
    """(P,) physics, then weights, of the best round."""
    physics_values: FloatArray
    """(8,) fitted without the network."""
    error_without: float
    """m, typical open-loop error on the stopping shots without the network."""
    error_with: float
    """m, the same with the best round, which these shots selected: other shots have to confirm it."""

    @property
    def gain(self) -> float:
        """Share of the error that the best network removed."""
        return 1.0 - self.error_with / self.error_without

    @property
    def active_weights(self) -> tuple[Prior, ...]:
        """Priors of the weights in use: none where the network is disabled."""
        return self.weight_priors if self.is_enabled else ()

    @property
    def parameter_values(self) -> FloatArray:
        """(P,) parameters in use: physics, then the weights where the network is enabled."""
        return self.best_values if self.is_enabled else self.physics_values

    def build_model(
        self, segments: tuple[ChainSegment, ...], table: Table, law: str, scatter: float = REBOUND_SCATTER
    ) -> ResidualChains:
        """Build the model in use for other segments of the scene; `parameter_values` are its parameters."""
        return ResidualChains(segments, table, law, self.active_weights, scatter=scatter)


def train_residual(
    fitting_segments: tuple[ChainSegment, ...],
    stopping_segments: tuple[ChainSegment, ...],
    table: Table,
    law: str,
    seed: int,
    scatter: float = REBOUND_SCATTER,
    strength: float = OUTPUT_SIGMA,
) -> TrainedResidual:
    """Train the residual of one scene.

    Args:
        fitting_segments: Segments to fit.
        stopping_segments: Segments that stop the training.
        table: Dimensions of the table.
        law: Name of the cushion contact model.
        seed: Random seed of the hidden weights.
        scatter: Scatter of the rebound, as a share of the speed.
        strength: Prior standard deviation of the outputs.

    Returns:
        The residual of the best round.
    """
    bare = ResidualChains(fitting_segments, table, law, scatter=scatter)
    physics = fit_windows(bare, options=_PHYSICS_OPTIONS)
    without = geometric_mean_error(prediction_errors(replace(bare, segments=stopping_segments), physics.shared))
    weights = residual_priors(strength, seed)
    error, shared = _train_rounds(replace(bare, weights=weights), stopping_segments, physics)
    on = error <= (1.0 - MIN_GAIN) * without
    return TrainedResidual(on, weights, shared, physics.shared, without, error)


def prediction_errors(model: ResidualChains, shared: FloatArray, lead: float = LEAD_TIME) -> FloatArray:
    """Measure the open-loop prediction error of each chain.

    The start of each chain is fitted to its first `lead` s; cushions and spin then follow from the model alone.

    Args:
        model: Chains to predict.
        shared: (P,) shared parameters.
        lead: s after the first sample that are fitted.

    Returns:
        (C,) m, RMS error in the following `PREDICTION_HORIZON` s.
    """
    chains: dict[int, list[ChainSegment]] = {}
    for segment in model.segments:
        chains.setdefault(segment.chain, []).append(segment)
    chain_errors = [
        _chain_errors(replace(model, segments=tuple(segments)), shared, lead)
        for segments in chains.values()
        if not segments[0].continues_previous
    ]
    return np.array([np.sqrt(np.mean(misses**2)) for misses in chain_errors if len(misses)])


def geometric_mean_error(errors: FloatArray) -> float:
    """Compute the geometric mean of errors (C,): one deviating shot counts once; NaN without errors."""
    return float(np.exp(np.mean(np.log(np.maximum(errors, 1e-6))))) if len(errors) else float("nan")


def _train_rounds(
    model: ResidualChains, unseen: tuple[ChainSegment, ...], physics: ShootingFit
) -> tuple[float, FloatArray]:
    """Train until the error on the stopping segments rises; return the least error and the parameters there."""
    shared = np.concatenate([physics.shared, [prior.value for prior in model.weights]])
    starts, best = physics.starts, (float("inf"), shared)
    for _ in range(_ROUND_COUNT):
        fit = fit_windows(model, shared, _ROUND_OPTIONS, starts)
        shared, starts = fit.shared, fit.starts
        error = geometric_mean_error(prediction_errors(replace(model, segments=unseen), shared))
        if not error < best[0]:
            break
        best = (error, shared)
        if fit.converged:
            break
    return best


def _chain_errors(chain: ResidualChains, shared: FloatArray, lead: float) -> FloatArray:
    """Measure the distances (m) between predicted and observed positions of one chain."""
    first = chain.segments[0]
    is_lead = first.t <= first.t[0] + lead if len(first.t) else np.empty(0, bool)
    if is_lead.sum() < 5:
        return np.empty(0)
    lead_segment = replace(
        first, t=first.t[is_lead], xy=first.xy[is_lead], whitening=first.whitening[is_lead], bounce=None
    )
    lead_model = replace(chain, segments=(lead_segment,))
    errors: list[FloatArray] = []
    starts: tuple[FloatArray, ...] | None = None
    for model, options in (
        (lead_model.without_network(), _START_OPTIONS),
        (lead_model, _POLISH_OPTIONS),
    ):  # the search is faster with the physics alone
        count = len(model.unknowns)
        fixed_model = FixedParameterModel(model, shared[:count], np.zeros(count, bool), model.unknowns)
        starts = fit_windows(fixed_model, options=options, starts=starts).starts
    state = lead_model.windows[0].start if starts is None else starts[0]
    for k, segment in enumerate(chain.segments):
        value, _ = chain.predict_motion(state, segment.t - segment.begin, shared)
        ahead = (segment.t > first.t[0] + lead) & (segment.t <= first.t[0] + lead + PREDICTION_HORIZON)
        errors.append(np.linalg.norm(value[ahead, :2] - segment.xy[ahead], axis=1))
        if segment.bounce is None or k + 1 == len(chain.segments):
            break
        state, _, _ = chain.predict_past_cushion(segment, state, chain.segments[k + 1].begin, shared)
    return np.concatenate(errors)
