"""One naming of balls, rails and pockets for all outputs and questions of a clip, and the table as a viewer sees it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from models.core.ball_look import BallLook
from models.core.scene import CUSHIONS, POCKETS, Camera, Game, Table
from models.core.typing import FloatArray

# Names of `CUSHIONS` after 0 to 3 quarter turns of the plan, clockwise.
_TURNED_RAILS = (
    ("left", "right", "far", "near"), ("far", "near", "right", "left"),
    ("right", "left", "near", "far"), ("near", "far", "left", "right"),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class TableView:
    """Orientation of a table in the frame."""

    turns: int = 0
    """Quarter turns, clockwise, from the plan of table coordinates (x right, y down) to the frame; 0 to 3."""

    def __post_init__(self) -> None:
        if self.turns not in range(4):
            raise ValueError(f"a view has 0 to 3 quarter turns; got {self.turns}")

    def name_rail(self, cushion: str) -> str:
        """Name a cushion as a viewer sees it.

        Args:
            cushion: One of `CUSHIONS`.

        Returns:
            `left`, `right`, `far` (at the top of the frame) or `near` (at its bottom).
        """
        return _TURNED_RAILS[self.turns][CUSHIONS.index(cushion)]

    def name_pocket(self, pocket: str) -> str:
        """Name a pocket as a viewer sees it.

        Args:
            pocket: One of `POCKETS`.

        Returns:
            Such as `far-left` for a corner, `far-side` for the pocket in the middle of a long rail.
        """
        rails = [self.name_rail(name) for name in pocket.split("-")]
        if len(rails) == 1:
            return f"{rails[0]}-side"
        return "-".join(sorted(rails, key=("far", "near", "left", "right").index))

    @property
    def pockets(self) -> dict[str, str]:
        """The pocket by its name in the frame."""
        return {self.name_pocket(name): name for name in POCKETS}

    def is_long(self, cushion: str) -> bool:
        """Return whether a cushion is a long one."""
        return cushion in ("top", "bottom")

    def find_size(self, table: Table) -> tuple[float, float]:
        """Find width and height, m, of a table as the frame shows it."""
        return (table.length, table.width) if self.turns % 2 == 0 else (table.width, table.length)

    def turn_points(self, xy: FloatArray, table: Table) -> FloatArray:
        """Turn points of the table to a plan that lies as in the frame.

        Args:
            xy: Points (..., 2), m.

        Returns:
            Points (..., 2), m: first coordinate to the right, second downwards, both from the corner at the top left
            of the turned plan.
        """
        x, y = xy[..., 0], xy[..., 1]
        turned = (
            (x, y), (table.width - y, x), (table.length - x, table.width - y), (y, table.length - x)
        )[self.turns]  # fmt: skip
        return np.stack(turned, axis=-1)


def find_table_view(camera: Camera, table: Table) -> TableView:
    """Find how a table lies in the frame.

    Args:
        camera: The calibrated camera.

    Returns:
        The quarter turn that agrees best with the directions of the middles of the rails from the middle of the table.
    """
    corners = table.corners
    middles = (corners[[0, 1, 0, 3]] + corners[[3, 2, 1, 2]]) / 2  # in the order of CUSHIONS
    px = camera.to_pixels(np.vstack([middles, corners.mean(axis=0)]), table.ball_radius)
    away = px[:4] - px[4]
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
    directions = {"left": (-1.0, 0.0), "right": (1.0, 0.0), "far": (0.0, -1.0), "near": (0.0, 1.0)}
    agreement = [
        sum(float(away[k] @ np.array(directions[name])) for k, name in enumerate(names)) for names in _TURNED_RAILS
    ]
    return TableView(int(np.argmax(agreement)))


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

    def find_rail(self, text: str) -> str | None:
        """Find the cushion that a person names by its canonical name, or as in the frame, such as `far long rail`."""
        if text in CUSHIONS:
            return text
        words = set(_split_words(text)) - {"the", "rail", "cushion"}
        fitting = [rail for rail in CUSHIONS if words and words <= set(_split_words(self.name_rail(rail)))]
        return fitting[0] if len(fitting) == 1 else None

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
