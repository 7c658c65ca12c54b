"""What a diagnosis says: where, which and how far, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from diagnosis.fitting.gap_closure import Ahead, Closing
from models.core.typing import FloatArray

Verdict = Literal["effects", "group", "none", "unknown", "undecidable"]


@dataclass(frozen=True, slots=True)
class Strength:
    """A parameter as these data tell it."""

    name: str
    unit: str
    value: float
    sigma: float
    detectable_from: float
    """smallest strength, of what the simulator has the smallest change, that these data could have shown; infinite
    where none."""
    prior_only: bool = False
    """True where these data did not determine it: value and sigma are mostly what was known beforehand."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """What may be missing, `none` and `unknown` included."""

    effect: str
    probability: float
    group: tuple[str, ...]
    """itself, and what these data cannot tell from it."""
    strengths: tuple[Strength, ...]


@dataclass(frozen=True, slots=True)
class Place:
    """A part of the gap, by the phase in which it shows."""

    phase: str
    share: float
    ball: str | None
    shot: int | None
    span: tuple[float, float] | None
    """s within its shot."""
    region: str | None
    grows_with: str | None


@dataclass(frozen=True, slots=True)
class EffectShare:
    """What one of several effects closes of the gap."""

    effect: str
    closed: float
    interval: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Gap:
    """How far the gap shrinks on shots that chose nothing."""

    metric: str
    horizon: float
    """s"""
    shots: tuple[int, ...]
    closing: Closing
    windows: tuple[Ahead, ...]
    before: tuple[FloatArray, ...]
    """predicted paths per window, (T, N, D)."""
    after: tuple[FloatArray, ...]


@dataclass(frozen=True, slots=True)
class Report:
    """The whole diagnosis."""

    scene: str
    model: tuple[str, ...]
    """effects of the user's simulator."""
    verdict: Verdict
    effects: tuple[str, ...]
    candidates: tuple[Candidate, ...]
    where: tuple[Place, ...]
    shape: str
    """what is left where something unknown is there, in words; empty otherwise."""
    gap: Gap
    per_effect: tuple[EffectShare, ...]
    fitted: tuple[Strength, ...]
    """all parameters of the improved simulator, as effect.parameter."""
    forms: tuple[str, ...]
    unidentifiable: tuple[str, ...]
    not_tested: tuple[str, ...]
    film_next: str
    p_value: float
    """chance that what the user's simulator leaves is noise."""
    notes: tuple[str, ...]

    @property
    def probability(self) -> float:
        """Of the answer: effects that are named together share it; NaN where nothing could be tested."""
        if self.effects:
            return sum(one.probability for one in self.candidates if one.effect in self.effects)
        return self.candidates[0].probability if self.candidates else float("nan")
