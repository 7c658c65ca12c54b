"""Whether a simulated shot scores: a ball is potted, or a carom is made."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from models.estimation.forecast.ensemble_prediction import EventKey

Game = Literal["pot", "carom", "three-cushion"]
GAMES: tuple[Game, ...] = ("pot", "carom", "three-cushion")
# Cushions that the cue ball must touch before it meets the second ball.
CUSHIONS_NEEDED = {"carom": 0, "three-cushion": 3}


@dataclass(frozen=True, slots=True)
class ShotGoal:
    """What a shot must do to score."""

    game: Game
    ball: str = ""
    """The only ball that counts when potted; empty: any ball but the cue ball."""
    pocket: str = ""
    """The only pocket that counts; empty: any."""


def group_by_ball(
    events: Iterable[tuple[float, EventKey]], ids: Sequence[str]
) -> tuple[tuple[tuple[float, EventKey], ...], ...]:
    """Group contacts by the balls that they concern.

    Args:
        events: Times (s) and events, in the order of time; only contacts of balls, cushions and pockets count.
        ids: (N,) names of the balls.

    Returns:
        (N,) contacts of each ball, which is named first in each of them.
    """
    contacts: dict[str, list[tuple[float, EventKey]]] = {name: [] for name in ids}
    for t, (kind, a, b) in events:
        if kind in ("ball", "cushion", "pocket") and a in contacts:
            contacts[a].append((t, (kind, a, b)))
        if kind == "ball" and b in contacts:
            contacts[b].append((t, (kind, b, a)))
    return tuple(tuple(own) for own in contacts.values())


def is_scored(
    contacts: Sequence[Sequence[tuple[float, EventKey]]], ids: Sequence[str], cue: int, goal: ShotGoal
) -> bool:
    """Decide whether a shot scores.

    Args:
        contacts: (N,) times (s) and events of each ball, in the order of time.
        ids: (N,) names of the balls.
        cue: Index of the struck ball.
        goal: What must happen. A potted cue ball never scores.

    Returns:
        Whether it does.
    """
    own = [event for _, event in contacts[cue]]
    if any(kind == "pocket" for kind, _, _ in own):
        return False
    if goal.game == "pot":
        return any(
            kind == "pocket" and goal.ball in ("", name) and goal.pocket in ("", place)
            for ball in contacts
            for _, (kind, name, place) in ball
        )
    touched: set[str] = set()
    cushions = 0
    for kind, _, other in own:
        if kind == "cushion":
            cushions += 1
        elif kind == "ball" and other not in touched:
            touched.add(other)
            if len(touched) == len(ids) - 1:
                return cushions >= CUSHIONS_NEEDED[goal.game]
    return False
