"""Appearance of a rendered scene: colours, lamps, balls and camera sensor."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

# sRGB in [0, 1].
Colour = tuple[float, float, float]
BallStyle = Literal["plain", "solid", "stripe", "spotted"]
ClothMarks = Literal["none", "pool", "snooker", "carom"]
FloorKind = Literal["carpet", "planks", "dark"]


@dataclass(frozen=True, slots=True)
class Lamp:
    """A round lamp above the table, which acts on shadows and highlights like a sphere of light."""

    position: tuple[float, float, float]
    """m, in the table's frame; z above the cloth."""
    radius: float = 0.15
    """m; larger lamps give softer shadows."""
    strength: float = 1.0
    """Relative to the other lamps."""


@dataclass(frozen=True, slots=True)
class BallAppearance:
    """Colour and pattern of one ball."""

    kind: str
    """One of `models.core.tracks.KINDS`."""
    colour: Colour
    style: BallStyle = "plain"
    number: int | None = None
    """Number in a white disc on solid and striped balls."""


@dataclass(frozen=True, slots=True)
class SceneAppearance:
    """All properties of a scene except its geometry: colours, lamps, optics and noise."""

    cloth: Colour = (0.10, 0.42, 0.62)
    rail: Colour = (0.30, 0.17, 0.09)
    floor: Colour = (0.25, 0.24, 0.26)
    floor_kind: FloorKind = "carpet"
    marks: ClothMarks = "pool"
    lamps: tuple[Lamp, ...] = field(default_factory=lambda: (Lamp((0.8, 0.6, 1.2)), Lamp((1.8, 0.6, 1.2))))
    ambient: float = 0.35
    """Share of the light at the table's centre that comes from all directions."""
    brightness: float = 1.0
    """1: white paper at the table's centre just saturates the sensor."""
    gloss: float = 1.0
    """Strength of the reflections on balls."""
    wear: float = 1.0
    """Strength of the cloth's texture."""
    vignette: float = 0.12
    """Share of the light lost in the corners of the image."""
    blur_px: float = 0.55
    """px, standard deviation of the lens' point spread function."""
    noise: float = 1.2
    """Standard deviation at middle grey, 8-bit levels."""
    seed: int = 0
    """Random seed of the textures of cloth, wood and floor."""


# White of cue balls, stripes and number discs.
IVORY: Colour = (0.95, 0.93, 0.86)
# Colours of the numbers 1 to 8; 9 to 15 are the stripes of 1 to 7.
POOL_COLOURS: tuple[Colour, ...] = (
    (0.93, 0.70, 0.05), (0.06, 0.16, 0.55), (0.80, 0.08, 0.07), (0.27, 0.10, 0.42), (0.90, 0.36, 0.05),
    (0.03, 0.36, 0.18), (0.45, 0.07, 0.09), (0.03, 0.03, 0.03),
)  # fmt: skip
SNOOKER_COLOURS: dict[str, Colour] = {
    "cue": (0.95, 0.93, 0.86), "red": (0.68, 0.03, 0.04), "yellow": (0.92, 0.76, 0.08), "green": (0.02, 0.33, 0.16),
    "brown": (0.38, 0.18, 0.06), "blue": (0.05, 0.20, 0.62), "pink": (0.93, 0.50, 0.60), "black": (0.03, 0.03, 0.03),
}  # fmt: skip
CAROM_COLOURS: dict[str, Colour] = {
    "white": (0.95, 0.93, 0.88), "yellow": (0.95, 0.72, 0.04), "red": (0.75, 0.04, 0.05),
}  # fmt: skip


def pool_ball(number: int) -> BallAppearance:
    """Return the pool ball with a number; 0 is the cue ball."""
    if not 0 <= number <= 15:
        raise ValueError(f"pool balls have numbers 0 to 15; got {number}")
    if number == 0:
        return BallAppearance("cue", IVORY, "spotted")
    colour = POOL_COLOURS[(number - 1) % 8]
    if number == 8:
        return BallAppearance("eight", colour, "solid", 8)
    return (
        BallAppearance("solid", colour, "solid", number)
        if number < 8
        else BallAppearance("stripe", colour, "stripe", number)
    )


def snooker_ball(kind: str) -> BallAppearance:
    """Return a snooker ball by its colour, or `cue`."""
    return BallAppearance(kind, SNOOKER_COLOURS[kind], "plain")


def carom_ball(kind: str) -> BallAppearance:
    """Return a carom ball (white, yellow or red) with the dots of match balls."""
    return BallAppearance(kind, CAROM_COLOURS[kind], "spotted")
