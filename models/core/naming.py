"""One naming of balls, rails and pockets for all outputs and questions of a clip."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from models.core.ball_look import BallLook
from models.core.scene import CUSHIONS, POCKETS, Camera, Game, Table
from models.core.table_view import TableView, find_table_view


@dataclass(frozen=True, slots=True)
class Naming:
    """What balls, rails and pockets of one clip are called; ids and canonical names stay in files."""

    looks: Mapping[str, BallLook] = field(default_factory=dict)
    """Looks by the id of the ball."""
    view: TableView = field(default_factory=TableView)
    game: Game = "pool"

    def name_ball(self, ball: str) -> str:
        """Name a ball, such as `red 3` for `solid-2`; what is no ball of the clip keeps its name."""
        look = self.looks.get(ball)
        return ball if look is None else look.name

    def say(self, body: str) -> str:
        """Name a ball or a cushion within a sentence, such as `red 3`, `the cue ball`, `the far long rail`."""
        if body in self.looks:
            name = self.name_ball(body)
            return name if re.search(r"( [A-Z]|\d)$", name) else f"the {name}"
        return f"the {self.name_rail(body)}" if body in CUSHIONS else body

    def find_look(self, ball: str) -> BallLook:
        """Find how a ball looks; grey where nothing is known of it."""
        return self.looks.get(ball, BallLook(ball))

    @property
    def rail_word(self) -> str:
        """What players of the game call a cushion: rail in pool, cushion elsewhere."""
        return "rail" if self.game == "pool" else "cushion"

    def name_rail(self, cushion: str) -> str:
        """Name a cushion as a viewer of the clip sees it, such as `far long rail` for `top`."""
        if cushion not in CUSHIONS:
            return cushion
        return f"{self.view.name_rail(cushion)} {'long' if self.view.is_long(cushion) else 'short'} {self.rail_word}"

    def name_pocket(self, pocket: str) -> str:
        """Name a pocket as a viewer of the clip sees it, such as `far-left pocket` for `top-left`."""
        return f"{self.view.name_pocket(pocket)} pocket" if pocket in POCKETS else pocket

    def find_ball(self, text: str) -> str | None:
        """Find the id of the ball that a person names; None where no ball or more than one fits."""
        fitting = self.find_balls(text)
        return fitting[0] if len(fitting) == 1 else None

    def find_balls(self, text: str) -> list[str]:
        """Find the ids of the balls that a person may mean.

        Args:
            text: An id, a name, a number, or a word of a name, in any case. `solid 2` is the ball with that number
                rather than the one with the id `solid-2`.

        Returns:
            The ids; those that fit best.
        """
        wanted = _split_words(text)
        if not wanted:
            return []
        plain = [word for word in wanted if word not in ("the", "ball", "number")] or wanted
        number = [word for word in plain if word not in ("solid", "stripe")]
        by_rank = (
            [ball for ball in self.looks if ball == text.strip().lower()],
            [ball for ball, look in self.looks.items() if _split_words(look.name) in (wanted, plain)],
            [ball for ball, look in self.looks.items() if number == [str(look.number)] and look.number],
            [ball for ball, look in self.looks.items() if set(plain) <= set(_split_words(look.name))],
            [ball for ball in self.looks if _split_words(ball) == plain],
            [ball for ball in self.looks if ball == "cue" and plain == ["white"]],
        )
        return next((balls for balls in by_rank if balls), [])

    def explain_no_ball(self, text: str) -> str:
        """Explain why a text names no ball: it names several, a rail, or nothing of the clip; empty where it does."""
        fitting = self.find_balls(text)
        if len(fitting) > 1:
            return f"{text!r} is {' or '.join(map(self.name_ball, fitting))}"
        words = set(_split_words(text)) - {"the"}
        if words and not fitting and any(words <= set(_split_words(self.name_rail(rail))) for rail in CUSHIONS):
            return f"{text!r} is a {self.rail_word}, not a ball"
        return "" if fitting else f"no ball of this clip is {text!r}; it has {self.list_balls()}"

    def find_pocket(self, text: str) -> str | None:
        """Find the pocket that a person names.

        Args:
            text: A canonical name, or the name in the frame, such as `far-left` or `near side`.

        Returns:
            One of `POCKETS`; None where none fits.
        """
        if text in POCKETS:
            return text
        words = sorted(word for word in _split_words(text) if word not in ("pocket", "corner", "the"))
        names = {**{name: name for name in POCKETS}, **self.view.pockets}
        by_words = {tuple(sorted(_split_words(name))): pocket for name, pocket in names.items()}
        return by_words.get(tuple(words))

    def list_balls(self) -> str:
        """List the names of all balls, with their ids where these differ."""
        return ", ".join(
            look.name if _split_words(look.name) == _split_words(ball) else f"{look.name} ({ball})"
            for ball, look in self.looks.items()
        )


def build_naming(table: Table, camera: Camera | None, ids: Sequence[str], looks: Sequence[BallLook]) -> Naming:
    """Build the naming of a clip.

    Args:
        camera: Its calibration; None for a table that no camera filmed, which lies as its plan.
        ids: N ids of balls.
        looks: How these balls look.

    Returns:
        The naming.
    """
    view = TableView() if camera is None else find_table_view(camera, table)
    return Naming(dict(zip(ids, looks, strict=True)), view, table.game)


def join_names(names: Iterable[str]) -> str:
    """Join names by commas and "and".

    Args:
        names: Any number of names.

    Returns:
        Such as `red 3, yellow 1 and the cue ball`.
    """
    texts = list(names)
    return " and ".join([*(", ".join(texts[:-1]),) * (len(texts) > 1), *texts[-1:]])


def _split_words(text: str) -> list[str]:
    """Split a name into lower-case words and numbers."""
    return re.findall(r"[a-z]+|[0-9]+", text.lower())
