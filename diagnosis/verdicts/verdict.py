"""The values of a diagnosis report."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from diagnosis.fitting.gap_closure import CLEAR_TIMES_FLOOR, UNKNOWN_CLOSURE, GapClosure
from diagnosis.fitting.prediction_windows import PredictionWindow
from diagnosis.unexplained.force_law import ForceLaw
from diagnosis.unexplained.local_patch import LocalPatch
from models.core.answer import format_html
from models.core.typing import FloatArray

# Standard deviations from which a coefficient of a simulator is called wrong.
_WRONG_SIGMAS = 3.0

Verdict = Literal["effects", "group", "none", "unknown", "undecidable"]


@dataclass(frozen=True, slots=True)
class Strength:
    """Estimate of a parameter."""

    name: str
    unit: str
    value: float
    sigma: float
    detectable_from: float
    """Smallest detectable strength, or change of a simulator's parameter; infinite where there is none."""
    prior_only: bool = False
    """True where the data did not determine the parameter: value and sigma come from the prior."""
    shot_spread: float = 0.0
    """Standard deviation of the strength between shots, of one body where bodies differ; 0 where all shots may have the
    same."""
    body_spread: float = 0.0
    """Standard deviation of the strength between bodies; 0 where all bodies may have the same."""
    stated: float = float("nan")
    """Value of a coefficient that a simulator from outside states; NaN of others."""

    @property
    def is_wrongly_stated(self) -> bool:
        """Whether the data contradict the value that a simulator states."""
        return not self.prior_only and abs(self.value - self.stated) > _WRONG_SIGMAS * self.sigma


@dataclass(frozen=True, slots=True)
class BodyStrength:
    """Strengths of an effect on one body."""

    body: str
    shots: int
    """Number of shots that they were estimated from."""
    strengths: tuple[Strength, ...]
    """Parameters that differ between bodies."""


@dataclass(frozen=True, slots=True)
class CandidateEffect:
    """An effect that may be missing, or `none` or `unknown`."""

    effect: str
    probability: float
    group: tuple[str, ...]
    """The effect itself, and those that these data cannot separate from it."""
    strengths: tuple[Strength, ...]
    sign_flip_p_value: float = float("nan")
    """Of a named effect: probability that shots without a missing effect agree as well, whatever their noise; NaN where
    it has no strength, or the shots are too few."""
    sign_flip_limit: float = float("nan")
    """Smallest such probability that so many shots allow."""
    fitted_beside: tuple[str, ...] | None = None
    """Effects beside which the strengths were fitted, and the simulator's; None where they were not fitted."""
    per_body: tuple[BodyStrength, ...] = ()
    """Of a named effect whose strength differs between bodies: the strengths of each, else empty."""


@dataclass(frozen=True, slots=True)
class GapLocation:
    """A part of the gap, by phase."""

    phase: str
    share: float
    ball: str | None = None
    shot: int | None = None
    span: tuple[float, float] | None = None
    """s within its shot."""
    region: str | None = None
    grows_with: str | None = None


@dataclass(frozen=True, slots=True)
class EffectShare:
    """Part of the gap that an effect closes."""

    effect: str
    closed: float
    """Its part of what all named effects close together (Shapley's value); of a single effect, what it closes."""
    interval: tuple[float, float]
    """95 % interval of `closed`."""
    alone: float
    """What it closes without the other named effects."""
    is_measured: bool = True
    """Whether it closes more of the gap beside the other named effects than chance explains."""


@dataclass(frozen=True, slots=True)
class Unexplained:
    """What remains of the gap after the named effects."""

    share: float = float("nan")
    """Share of the squared gap before, both beyond the floor; NaN where it is not resolved."""
    size: float = float("nan")
    """rms of the error after beyond the floor, in m or rad; NaN where nothing could be predicted."""
    times_floor: float = float("nan")
    """Error after over the floor; NaN without a floor."""
    where: tuple[GapLocation, ...] = ()
    """The phases in which the fit leaves more than noise, by their share of it; empty where it leaves only noise."""
    shape: str = ""
    """The largest systematic residuals in words; empty where they are noise."""
    law: ForceLaw | None = None
    """How the force that is missing varies, and its nearest formula."""
    patch: LocalPatch | None = None
    """The place where bodies are braked more, or less, than around it."""
    probability: float = float("nan")
    """Probability that something systematic remains; NaN where what remains is noise."""

    @property
    def is_clear(self) -> bool:
        """Whether the remaining error clearly exceeds the attainable one."""
        return self.times_floor >= CLEAR_TIMES_FLOOR


@dataclass(frozen=True, slots=True)
class Gap:
    """How far the gap shrinks on hold-out shots."""

    metric: str
    horizon: float
    """Duration of predictions, s."""
    shots: tuple[int, ...] = ()
    closure: GapClosure = UNKNOWN_CLOSURE
    windows: tuple[PredictionWindow, ...] = ()
    before: tuple[FloatArray, ...] = ()
    """Predicted positions (T, N, D) of each window, without the effects."""
    after: tuple[FloatArray, ...] = ()
    """The same with the effects."""
    floor_reason: str = ""
    """Why the floor is unknown; empty where it is known."""
    coordinates: tuple[str, ...] = ()
    """Names of the coordinates; empty without windows."""
    as_stated: float = float("nan")
    """rms distance with the coefficients that the file of the simulator states, before they are fitted; NaN without a
    file."""

    @property
    def unit(self) -> str:
        """Unit of a coordinate: m or rad."""
        return self.metric.removeprefix("rms_")


@dataclass(frozen=True, slots=True)
class ShotUse:
    """Which shots were used for what, and their noise."""

    fitting: tuple[int, ...] = ()
    """Shots that estimated the strengths that selection shots confirmed."""
    selection: tuple[int, ...] = ()
    """Shots that confirmed effects; in the end they estimate the strengths, too."""
    holdout: tuple[int, ...] = ()
    """Shots that measured the gap."""
    noise: float = float("nan")
    """Typical standard deviation of an observed coordinate, in m or rad; NaN where it is unknown."""


@dataclass(frozen=True, slots=True, repr=False)
class DiagnosisReport:
    """The result of a diagnosis."""

    scene: str
    model: tuple[str, ...]
    """Effects of the user's simulator."""
    verdict: Verdict
    effects: tuple[str, ...]
    candidates: tuple[CandidateEffect, ...]
    where: tuple[GapLocation, ...]
    gap: Gap
    per_effect: tuple[EffectShare, ...]
    """Shares of the named effects; of the best one where none is named."""
    unexplained: Unexplained
    fitted: tuple[Strength, ...]
    """All parameters of the improved simulator, named `effect.parameter`."""
    forms: tuple[str, ...]
    unidentifiable: tuple[str, ...]
    not_tested: tuple[str, ...]
    film_next: str
    p_value: float
    """Probability that the residuals of the user's simulator are noise."""
    notes: tuple[str, ...]
    reason: str = ""
    """Why nothing is decided, or why effects were withdrawn; empty where neither is so."""
    shot_use: ShotUse = ShotUse()

    def __repr__(self) -> str:
        answer = ", ".join(self.effects) or self.verdict
        closed = self.gap.closure.closed
        gap = f", gap closed by {closed:.1%}" if math.isfinite(closed) else ""
        return f"DiagnosisReport({self.scene}: {answer} ({self.probability:.3f}){gap})"

    def _repr_html_(self) -> str:
        """Show the candidates in a notebook."""
        rows = [(one.effect, f"{one.probability:.3f}") for one in self.candidates]
        return format_html([repr(self), self.film_next], [("missing effect", "probability"), *rows])

    @property
    def probability(self) -> float:
        """Probability of the answer; named effects share it. NaN where nothing could be tested."""
        if self.effects:
            return sum(one.probability for one in self.candidates if one.effect in self.effects)
        return self.candidates[0].probability if self.candidates else float("nan")
