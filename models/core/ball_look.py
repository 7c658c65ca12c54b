"""How balls look in a clip, and what a person calls them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from string import ascii_uppercase

# sRGB, 0 to 255.
Colour = tuple[int, int, int]

WHITE: Colour = (255, 255, 255)
# Colour of a ball of which no pixel is known, such as one of a track folder: a grey that no ball has.
UNKNOWN_COLOUR: Colour = (168, 178, 190)

# Colours of balls that no clip shows and whose class names a colour.
CLASS_COLOURS: dict[str, Colour] = {
    "cue": (246, 244, 232), "white": (246, 244, 232), "eight": (44, 44, 50), "black": (44, 44, 50),
    "red": (232, 48, 48), "yellow": (255, 206, 40), "green": (22, 146, 82), "brown": (150, 88, 44),
    "blue": (44, 104, 232), "pink": (255, 142, 178),
}  # fmt: skip
# What a person calls a ball of a class, where it is not the name of the class.
_CLASS_NAMES = {"cue": "cue ball", "eight": "black 8"}


@dataclass(frozen=True, slots=True)
class BallLook:
    """How one ball looks, and what a person calls it."""

    name: str
    """Such as `red 3`, `green stripe`, `cue ball`; unique in its clip."""
    colour: Colour = UNKNOWN_COLOUR
    """Of its paint as the clip shows it: the median of its pixels that are neither white, in shade nor highlight."""
    number: int = 0
    """Number that follows from the colours of the set; 0 where none is certain."""
    is_striped: bool = False
    """Whether it is white with a band of `colour`."""


def format_colour(colour: Colour) -> str:
    """Format a colour for pages.

    Args:
        colour: sRGB, 0 to 255.

    Returns:
        Such as `#d63b3b`.
    """
    return "#{:02x}{:02x}{:02x}".format(*colour)


def parse_colour(text: str) -> Colour:
    """Parse a colour that `format_colour` wrote."""
    red, green, blue = bytes.fromhex(text[1:])
    return red, green, blue


def describe_unseen_balls(ids: Sequence[str], kinds: Sequence[str]) -> tuple[BallLook, ...]:
    """Describe balls of which no pixel is known.

    Args:
        ids: N ids.
        kinds: N ball classes.

    Returns:
        N looks by class and id.
    """
    return make_names_unique(
        [
            BallLook(
                _CLASS_NAMES.get(name, name.replace("-", " ")), CLASS_COLOURS.get(kind, UNKNOWN_COLOUR),
                8 if kind == "eight" else 0, kind == "stripe",
            )
            for name, kind in zip(ids, kinds, strict=True)
        ]
    )  # fmt: skip


def make_names_unique(looks: Sequence[BallLook]) -> tuple[BallLook, ...]:
    """Add a letter to names that several balls have, in their order: `blue stripe A`, `blue stripe B`."""
    count, used = Counter(look.name for look in looks), Counter[str]()
    unique = []
    for look in looks:
        if count[look.name] > 1:
            letter = ascii_uppercase[used[look.name] % 26]
            used[look.name] += 1
            look = replace(look, name=f"{look.name} {letter}")
        unique.append(look)
    return tuple(unique)
