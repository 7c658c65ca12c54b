"""What the blind check asks of a kind of case, whatever moves in it."""

from __future__ import annotations

from typing import Any, Protocol

from models.estimation.gap_scenes.gap_scene import GapScene


class Kind(Protocol):
    """A world, what acts there, and what of it the simulator has."""

    @property
    def name(self) -> str: ...

    @property
    def world(self) -> str:
        """The script in worlds/ that plays it."""
        ...

    @property
    def engine(self) -> str:
        """The package beyond our own that its world needs; empty where there is none."""
        ...

    @property
    def withheld(self) -> frozenset[str]:
        """What the simulator lacks."""
        ...

    @property
    def foreign(self) -> bool:
        """Whether what it lacks is in no library: the right answer is `unknown`."""
        ...

    @property
    def family(self) -> frozenset[str]:
        """Effects of the library that come nearest to what acts in another form."""
        ...

    @property
    def trap(self) -> bool:
        """Whether these shots cannot tell what is missing, so that a name needs more than luck."""
        ...

    @property
    def forms(self) -> tuple[str, ...]:
        """One for each of the scene's alternatives, as they act; empty where the simulator has them."""
        ...

    def drawn(self, seed: int, shots: int, fps: float) -> dict[str, Any]:
        """An experiment of this kind, as its world reads it."""
        ...

    def simulator(self, scene: GapScene) -> GapScene:
        """The scene with the laws of its simulator and what the library holds, which a track folder cannot say."""
        ...

    def is_named_by(self, names: frozenset[str]) -> bool:
        """Whether these names, and no others, are a right answer."""
        ...
