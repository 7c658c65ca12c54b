"""What a ball is called: kinds from colours seen over many pictures, and unique ids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from models.scene import Game

Floats = NDArray[np.float64]

SNOOKER_COLOURS = {
    "cue": (85.0, 0.0, 12.0), "red": (38.0, 50.0, 32.0), "yellow": (75.0, 5.0, 65.0), "green": (38.0, -35.0, 12.0),
    "brown": (38.0, 22.0, 30.0), "blue": (38.0, 0.0, -42.0), "pink": (68.0, 38.0, 12.0), "black": (18.0, 0.0, 2.0),
}  # fmt: skip
"""CIE L*a*b* under even, warm white light; read off photographs of sets, good to about 15."""
MOST_SATURATED = 55.0
"""CIE chroma beyond which colours are not told apart by it."""
UNSURE_COLOUR = 45.0
"""Lab distance beyond which a snooker ball has no name."""
PALE, PALER = 0.5, 0.2
"""Paleness from which a struck ball is believed to be the cue ball, and by how much another may beat it."""
ONE_COLOUR, LEAST_OF_A_COLOUR = 14.0, 3
"""Lab distance within which pool balls have one colour, and how many of each of two colours make an English set."""
MOST_OF_A_SOLID, LEAST_OF_A_STRIPE, LEAST_OF_A_TURN = 0.18, 0.2, 0.4
"""White share of a solid at most (the ring about its number, seen from the front, is about a fifth of a ball) and of a
stripe at least, usually; and of a stripe now and then while it rolls."""
NUMBERED = ("solid", "stripe", "ball")
"""Kinds of which there are always several: their ids count from 1."""


@dataclass(frozen=True, slots=True)
class Look:
    """How N balls look over many pictures."""

    colour: Floats
    """(N, 3) median CIE L*a*b*."""
    white: Floats
    """(N,) median white share."""
    white_high: Floats
    """(N,) 90th percentile of the white share: a stripe shows it while it rolls."""

    @property
    def chroma(self) -> Floats:
        """(N,) distance from grey."""
        return np.hypot(self.colour[:, 1], self.colour[:, 2])


def name_kinds(look: Look, game: Game, struck: int | None = None) -> tuple[str, ...]:
    """One of `models.tracks.KINDS` per ball; `ball` where unsure. The ball that is `struck` is hardly another's."""
    if not len(look.white):
        return ()
    if game == "carom":
        return _carom(look)
    return _snooker(look, struck) if game == "snooker" else _pool(look, struck)


def name_ids(kinds: tuple[str, ...], xy: Floats) -> tuple[str, ...]:
    """Unique ids from kinds and first places (N, 2): left before right, then top before bottom."""
    ids = [""] * len(kinds)
    count: dict[str, int] = {}
    for ball in np.lexsort((xy[:, 1], xy[:, 0])):
        kind = kinds[ball]
        count[kind] = count.get(kind, 0) + 1
        plain = count[kind] == 1 and kind not in NUMBERED
        ids[ball] = kind if plain else f"{kind}-{count[kind]}"
    return tuple(ids)


def _snooker(look: Look, struck: int | None) -> tuple[str, ...]:
    """One ball of each colour, any number of reds: the cheapest way to give every ball a name."""
    names = list(SNOOKER_COLOURS)
    reference = np.array([SNOOKER_COLOURS[name] for name in names])
    weight = np.array([0.6, 1.0, 1.0])  # lightness says least: it changes with the light and the highlight
    distance = np.hypot.reduce((_calm(look.colour)[:, None] - _calm(reference)[None]) * weight, axis=2)
    distance[:, names.index("cue")] += 40.0 * (look.white < 0.5)
    distance[look.white >= 0.7, names.index("cue")] *= 0.5
    if struck is not None:
        distance[struck, names.index("cue")] *= 0.5
    balls = len(look.white)
    column = names + ["red"] * (balls - 1) + ["ball"] * balls
    reds = np.repeat(distance[:, [names.index("red")]], balls - 1, axis=1)
    cost = np.concatenate([distance, reds, np.full((balls, balls), UNSURE_COLOUR)], axis=1)
    _, chosen = linear_sum_assignment(cost)
    return tuple(column[c] for c in chosen)


def _calm(colour: Floats) -> Floats:
    """Colours (..., 3) with their saturation limited: cameras exaggerate it, the hue stays."""
    chroma = np.hypot(colour[..., 1], colour[..., 2])
    share = np.minimum(1.0, MOST_SATURATED / np.maximum(chroma, 1e-9))
    return np.asarray(colour * np.stack([np.ones_like(share), share, share], axis=-1))


def _carom(look: Look) -> tuple[str, ...]:
    """Red, yellow, white: the three that fit best; colours in relation to each other, as the light differs."""
    lightness, a, b = look.colour.T
    cost = np.stack([-(a - 0.3 * b), -(b - 0.8 * a), look.chroma - 0.3 * lightness - 10.0 * look.white], axis=1)
    balls, picks = linear_sum_assignment(cost - cost.min() + 1.0) if len(a) <= 3 else _pick(cost)
    kinds = ["ball"] * len(a)
    plausible = (a > 20.0, (b > 25.0) & (a < 35.0), (look.chroma < 40.0) & (lightness > 50.0))
    for ball, pick in zip(balls, picks, strict=True):
        if plausible[pick][ball]:
            kinds[ball] = ("red", "yellow", "white")[pick]
    return tuple(kinds)


def _pick(cost: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    picks, balls = linear_sum_assignment(cost.T)
    return balls, picks


def _pool(look: Look, struck: int | None) -> tuple[str, ...]:
    """Cue and eight once; two many-fold plain colours are an English set, otherwise solids and stripes."""
    lightness, a, b = look.colour.T
    kinds = np.array(["ball"] * len(a), dtype=object)
    kinds[(look.white < MOST_OF_A_SOLID) & (look.white_high < LEAST_OF_A_TURN)] = "solid"
    kinds[(look.white >= LEAST_OF_A_STRIPE) | (look.white_high >= LEAST_OF_A_TURN)] = "stripe"
    cue = _cue(look, struck)
    if cue is not None:
        kinds[cue] = "cue"
    darkness = np.where(kinds == "cue", np.inf, lightness + 0.5 * look.chroma + 60 * look.white)
    eight = int(np.argmin(darkness))
    if lightness[eight] < 40 and look.chroma[eight] < 25 and look.white[eight] < 0.35:
        kinds[eight] = "eight"
    rest = (kinds != "cue") & (kinds != "eight")
    red = rest & (a > 25) & (a > 0.6 * b)
    yellow = rest & ~red & (b > 15) & (b > abs(a))
    if min(red.sum(), yellow.sum()) >= LEAST_OF_A_COLOUR and _alike(look.colour[red]) and _alike(look.colour[yellow]):
        kinds[red], kinds[yellow] = "red", "yellow"
    return tuple(kinds)


def _cue(look: Look, struck: int | None) -> int | None:
    """The cue ball: the whitest one, or the struck one where it is pale: tinted light makes whites yellow or green."""
    whitest = int(np.argmax(look.white - look.chroma / 200))
    clear = look.white[whitest] > 0.6 and look.chroma[whitest] < 45
    if struck is None or struck == whitest:
        pale = struck == whitest and _paleness(look)[whitest] > PALE
        return whitest if clear or pale else None
    paleness = _paleness(look)
    if paleness[struck] > PALE and paleness[struck] > paleness.max() - PALER:
        return struck
    return whitest if clear else None


def _paleness(look: Look) -> Floats:
    """(N,) how much a ball looks like a white one in tinted light: light, with little colour, some of it white."""
    return np.asarray(look.colour[:, 0] / 100 - look.chroma / 150 + look.white / 2)


def _alike(colour: Floats) -> bool:
    """Whether balls (n, 3) have one colour: those of an English set do, solids and stripes do not."""
    off = np.hypot.reduce(colour - np.median(colour, axis=0), axis=1)
    return bool(np.percentile(off, 75) < ONE_COLOUR)
