"""The interface of a kind of case in the blind check."""

from __future__ import annotations

from typing import Any, Protocol

from models.estimation.gap_scenes.gap_scene import GapScene


class CaseKind(Protocol):
    """A simulated world, the effects that act there, and those that the user's simulator has."""

    @property
    def name(self) -> str:
        """Unique name."""
        ...

    @property
    def world(self) -> str:
        """The script in worlds/ that simulates it."""
        ...

    @property
    def engine(self) -> str:
        """Package that the world needs beyond those of this project; empty where there is none."""
        ...

    @property
    def withheld(self) -> frozenset[str]:
        """Effects that the simulator lacks."""
        ...

    @property
    def foreign(self) -> bool:
        """Whether the missing effect is in no library: the right answer is `unknown`."""
        ...

    @property
    def family(self) -> frozenset[str]:
        """Effects of the library that are nearest to an effect of another form."""
        ...

    @property
    def trap(self) -> bool:
        """Whether the shots cannot show the missing effect, so that a name would be a guess."""
        ...

    @property
    def forms(self) -> tuple[str, ...]:
        """The true form of each choice between contact models; empty where the simulator has them."""
        ...

    def draw_experiment(self, seed: int, shots: int, fps: float) -> dict[str, Any]:
        """Draw an experiment of this kind in the format of its world."""
        ...

    def simulator(self, scene: GapScene) -> GapScene:
        """Return the scene with the simulator's contact models and library, which a track folder does not state."""
        ...

    def is_named_by(self, names: frozenset[str]) -> bool:
        """Return whether these names, and no others, are a right answer."""
        ...
