"""The cases of benchmarks/gap.py: what is asked of the diagnosis of each kind of world."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from pipeline.experiments.gapcheck.body_cases import BODIES, TRAPS, BodyKind

NEAR = (4.0, 6.0)
"""standard deviations of a strength just above the noise."""
SLOW_CLOCK = 1.04
"""true pictures a second over those that are claimed."""


@dataclass(frozen=True)
class Case:
    """One question; how it is answered is in gap_trial.py."""

    asked: str
    """natural, near, none, withheld, foreign, pair, form, trap, garbage, 30 fps, 5 shots, 1 px"""
    kind: BodyKind
    hidden: frozenset[str] = frozenset()
    """Effects taken out of the library."""
    shots: int = 12
    fps: float = 60.0
    noise: float = 1.0
    """factor"""
    clock: float = 1.0
    """true pictures a second over those that are claimed"""

    @property
    def name(self) -> str:
        return f"{self.asked}: {self.kind.name}"


def cases() -> Iterator[Case]:
    """All of them, the most important first."""
    single = [kind for kind in BODIES if len(kind.withheld) == 1 and not (kind.foreign or kind.family)]
    yield from (Case("natural", kind) for kind in single)
    yield from (Case("none", kind) for kind in BODIES if not kind.withheld)
    yield from (Case("near", kind) for kind in single)
    yield from (Case("foreign", kind) for kind in BODIES if kind.foreign)
    yield from (Case("withheld", kind, hidden=kind.withheld) for kind in single)
    yield from (Case("pair", kind) for kind in BODIES if len(kind.withheld) == 2)
    yield from (Case("form", kind) for kind in BODIES if kind.family)
    yield from (Case("trap", kind) for kind in TRAPS)
    clean = [kind for kind in BODIES if not kind.withheld and not kind.camera]
    slow = [replace(kind, name=f"{kind.name}, wrong frame rate") for kind in clean]
    yield from (Case("trap", kind, clock=SLOW_CLOCK) for kind in slow)
    yield from (Case("garbage", kind) for kind in single)
    yield from (Case("30 fps", kind, fps=30.0) for kind in single)
    yield from (Case("5 shots", kind, shots=5) for kind in single)
    yield from (Case("1 px", kind, noise=1.0 / 0.3) for kind in single)
