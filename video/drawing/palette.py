"""Colours of what is drawn: balls by what they are called, cloth as it was seen, ink that reads on both."""

from __future__ import annotations

import cv2
import numpy as np

from models.core.typing import FloatArray

Colour = tuple[int, int, int]
"""sRGB, 0 to 255."""

WHITE: Colour = (255, 255, 255)
INK: Colour = (12, 16, 22)
"""Ground of panels and labels."""
MIST: Colour = (168, 178, 190)
"""Second-rank text on `INK`."""
FLASH: Colour = (255, 214, 102)
LIGHTS: dict[str, Colour] = {"green": (64, 200, 110), "amber": (255, 176, 32), "red": (240, 68, 68)}

KIND_COLOURS: dict[str, Colour] = {
    "cue": (246, 244, 232), "white": (246, 244, 232), "eight": (44, 44, 50), "black": (44, 44, 50),
    "red": (232, 48, 48), "yellow": (255, 206, 40), "green": (22, 146, 82), "brown": (150, 88, 44),
    "blue": (44, 104, 232), "pink": (255, 142, 178),
}  # fmt: skip
"""Balls whose name says their colour; the others keep the colour that was seen."""

LEAST_CHROMA = 45.0
"""C* to which a seen colour is raised, so that trails of dull pictures can be told apart."""
LUMA = np.array([0.299, 0.587, 0.114])
"""Shares of red, green and blue in brightness (ITU-R BT.601)."""
BRIGHT = 150.0
"""Levels of 255 from which ground is bright."""
LEAST_CONTRAST = 60.0
"""Levels of 255 of brightness by which a trail must differ from the cloth."""
SEEN_ON_INK, SEEN_ON_WHITE = 105.0, 148.0
"""Levels of 255 of brightness between which a grey line has 3 to 1 of contrast on dark ground and on white (WCAG 2.1,
1.4.11)."""
GREY_CHROMA = 10.0
"""C* below which a seen colour is grey and stays so."""


def lab_to_rgb(lab: FloatArray) -> Colour:
    """sRGB of a CIE L*a*b* colour (3,), D65."""
    rgb = cv2.cvtColor(np.asarray(lab, dtype=np.float32).reshape(1, 1, 3), cv2.COLOR_LAB2RGB).reshape(3)
    red, green, blue = (round(float(value) * 255) for value in np.clip(rgb, 0, 1))
    return red, green, blue


def ball_colour(kind: str, lab: FloatArray) -> Colour:
    """The colour in which a ball is drawn: of its name, else as seen (L*a*b* (3,)), no duller than `LEAST_CHROMA`."""
    if kind in KIND_COLOURS:
        return KIND_COLOURS[kind]
    if not np.isfinite(lab).all():
        return MIST
    chroma = float(np.hypot(lab[1], lab[2]))
    raised = np.array(lab, dtype=np.float64)
    raised[0] = np.clip(raised[0], 35.0, 85.0)
    if GREY_CHROMA < chroma < LEAST_CHROMA:
        raised[1:] *= LEAST_CHROMA / chroma
    return lab_to_rgb(raised)


def apart_from(colour: Colour, ground: Colour) -> Colour:
    """`colour`, or, where it could not be told from `ground`, a lighter one of its kind, on bright ground a darker."""
    distance = np.abs(np.array(colour, dtype=np.float64) - ground)
    if float(distance @ LUMA) >= LEAST_CONTRAST or distance.max() >= 2 * LEAST_CONTRAST:
        return colour
    return mix(colour, INK, 0.6) if float(np.array(ground) @ LUMA) > BRIGHT else mix(colour, WHITE, 0.45)


def legible(colour: Colour) -> Colour:
    """`colour`, lightened as far as letters in it need to be read on `INK`."""
    bright = float(np.array(colour) @ LUMA)
    return colour if bright >= BRIGHT else mix(colour, WHITE, (BRIGHT - bright) / (255 - bright))


def on_any_ground(colour: Colour) -> Colour:
    """`colour`, lightened or darkened as far as it needs to be seen on `INK` and on `WHITE`."""
    bright = float(np.array(colour) @ LUMA)
    if bright > SEEN_ON_WHITE:
        return mix(colour, (0, 0, 0), 1 - SEEN_ON_WHITE / bright)
    return mix(colour, WHITE, max(SEEN_ON_INK - bright, 0.0) / (255 - bright))


def mix(first: Colour, second: Colour, share: float) -> Colour:
    """`first` with a `share` of `second`."""
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(first, second, strict=True))
    return red, green, blue
