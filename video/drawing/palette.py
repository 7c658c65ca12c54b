"""Colours of drawings: balls by their names, cloth as filmed, and colours that contrast with their background."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from models.core.ball_look import WHITE as WHITE
from models.core.ball_look import Colour as Colour
from models.core.srgb import LUMA_601
from models.core.typing import FloatArray

# Background of panels and labels.
INK: Colour = (12, 16, 22)
# Secondary text on `INK`.
MUTED_GREY: Colour = (168, 178, 190)
# Contact flashes and highlighted lines.
FLASH: Colour = (255, 214, 102)
# Colours of the trust levels.
TRUST_COLOURS: dict[str, Colour] = {"green": (64, 200, 110), "amber": (255, 176, 32), "red": (240, 68, 68)}

# Brightness of 255 from which a background counts as bright.
BRIGHT_LUMA = 150.0
# Least difference in brightness, of 255, between a trail and the cloth.
MIN_LUMA_CONTRAST = 60.0
# Brightness limits, of 255, between which a grey line has a contrast of 3 to 1 both on a dark background and on white
# (WCAG 2.1, 1.4.11).
MIN_LUMA_ON_DARK, MAX_LUMA_ON_WHITE = 105.0, 148.0


def lab_to_rgb(lab: FloatArray) -> Colour:
    """Convert a CIE L*a*b* colour to sRGB.

    Args:
        lab: L*, a*, b* (3,), illuminant D65.

    Returns:
        sRGB, 0 to 255.
    """
    rgb = cv2.cvtColor(np.asarray(lab, dtype=np.float32).reshape(1, 1, 3), cv2.COLOR_LAB2RGB).reshape(3)
    red, green, blue = (round(float(value) * 255) for value in np.clip(rgb, 0, 1))
    return red, green, blue


def ensure_contrast(colour: Colour, background: Colour) -> Colour:
    """Lighten or darken a colour that is too similar to its background.

    Args:
        colour: Colour of a line.
        background: Colour behind the line.

    Returns:
        The colour itself if it contrasts; else a darker one on a bright background, a lighter one on others.
    """
    distance = np.abs(np.array(colour, dtype=np.float64) - background)
    if float(distance @ LUMA_601) >= MIN_LUMA_CONTRAST or distance.max() >= 2 * MIN_LUMA_CONTRAST:
        return colour
    return (
        mix_colours(colour, INK, 0.6)
        if float(np.array(background) @ LUMA_601) > BRIGHT_LUMA
        else mix_colours(colour, WHITE, 0.45)
    )


def lighten_for_text(colour: Colour) -> Colour:
    """Lighten a colour until letters in it are legible on `INK`.

    Args:
        colour: Colour of the letters.

    Returns:
        The colour itself if it is bright enough, else a lighter one of the same hue.
    """
    bright = float(np.array(colour) @ LUMA_601)
    return colour if bright >= BRIGHT_LUMA else mix_colours(colour, WHITE, (BRIGHT_LUMA - bright) / (255 - bright))


def darken_for_white(colour: Colour) -> Colour:
    """Darken a colour until a line in it is visible on `WHITE`; the hue stays."""
    bright = float(np.array(colour) @ LUMA_601)
    return mix_colours(colour, (0, 0, 0), max(1 - MAX_LUMA_ON_WHITE / max(bright, 1.0), 0.0))


def adapt_to_any_background(colour: Colour) -> Colour:
    """Lighten or darken a colour until a line in it is visible both on `INK` and on `WHITE`.

    Args:
        colour: Colour of the line.

    Returns:
        A colour of the same hue whose brightness lies between the limits for both backgrounds.
    """
    colour = darken_for_white(colour)
    bright = float(np.array(colour) @ LUMA_601)
    return mix_colours(colour, WHITE, max(MIN_LUMA_ON_DARK - bright, 0.0) / (255 - bright))


@lru_cache(maxsize=256)
def mix_colours(first: Colour, second: Colour, share: float) -> Colour:
    """Mix two colours linearly in sRGB.

    Args:
        first: Colour at share 0.
        second: Colour at share 1.
        share: Share of the second colour, 0 to 1.

    Returns:
        The mixed colour.
    """
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(first, second, strict=True))
    return red, green, blue
