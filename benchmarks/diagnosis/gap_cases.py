"""The cases of benchmarks/diagnosis/gap.py: questions to the diagnosis about each kind of simulated body."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from pipeline.experiments.gapcheck.body_cases import BODY_KINDS, DRAG, DRIVEN_KINDS, FRICTION, WALL_KINDS, BodyKind

# Standard deviations of a strength just above the noise.
NEAR = (4.0, 6.0)
# True frame rate over the stated one.
SLOW_CLOCK = 1.04


# Kinds whose shots are alike in everything that would show the cause: the right answer names none, or a group.
TRAP_KINDS = (
    BodyKind(
        "slide, slope along the one way of all bodies",
        "slide",
        {**FRICTION, "slope": {"slope_x": (2.0, 6.0), "slope_y": (0.0, 0.0)}},
        ("sliding_friction",),
        throw={"angle": 0.0},
    ),
    BodyKind("flight, air drag at one speed and angle", "flight", DRAG, throw={"speed": 9.0, "angle": 1.2}),
)


@dataclass(frozen=True)
class GapCase:
    """One question; gap_trial.py scores the answer."""

    question: str
    """natural, near, none, withheld, foreign, pair, form, trap, garbage, walls, driven, 30 fps, 5 shots,
    1 px."""
    kind: BodyKind
    hidden: frozenset[str] = frozenset()
    """Effects removed from the library."""
    shots: int = 12
    fps: float = 60.0
    noise: float = 1.0
    """Factor on the usual noise."""
    clock: float = 1.0
    """True frame rate over the stated one."""

    @property
    def name(self) -> str:
        return f"{self.question}: {self.kind.name}"


def generate_cases() -> Iterator[GapCase]:
    """Generate all cases, the most important first."""
    single = [kind for kind in BODY_KINDS if len(kind.withheld) == 1 and not (kind.foreign or kind.family)]
    yield from (GapCase("natural", kind) for kind in single)
    yield from (GapCase("none", kind) for kind in BODY_KINDS if not kind.withheld)
    yield from (GapCase("near", kind) for kind in single)
    yield from (GapCase("foreign", kind) for kind in BODY_KINDS if kind.foreign)
    yield from (GapCase("withheld", kind, hidden=kind.withheld) for kind in single)
    yield from (GapCase("pair", kind) for kind in BODY_KINDS if len(kind.withheld) == 2)
    yield from (GapCase("form", kind) for kind in BODY_KINDS if kind.family)
    yield from (GapCase("trap", kind) for kind in TRAP_KINDS)
    yield from (GapCase("walls", kind) for kind in WALL_KINDS)
    yield from (GapCase("driven", kind) for kind in DRIVEN_KINDS)
    clean = [kind for kind in BODY_KINDS if not kind.withheld and not kind.camera]
    slow = [replace(kind, name=f"{kind.name}, wrong frame rate") for kind in clean]
    yield from (GapCase("trap", kind, clock=SLOW_CLOCK) for kind in slow)
    yield from (GapCase("garbage", kind) for kind in single)
    yield from (GapCase("30 fps", kind, fps=30.0) for kind in single)
    yield from (GapCase("5 shots", kind, shots=5) for kind in single)
    yield from (GapCase("1 px", kind, noise=1.0 / 0.3) for kind in single)
