"""What a ball is called: kinds from colours seen over many pictures, and unique ids."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.core.scene import Game
from models.core.typing import FloatArray
from models.numerics.assignment import assigned
from models.tracking.appearance import Look

SNOOKER_COLOURS = {
    "cue": (85.0, 0.0, 12.0), "red": (38.0, 50.0, 32.0), "yellow": (75.0, 5.0, 65.0), "green": (38.0, -35.0, 12.0),
    "brown": (38.0, 22.0, 30.0), "blue": (38.0, 0.0, -42.0), "pink": (68.0, 38.0, 12.0), "black": (18.0, 0.0, 2.0),
}  # fmt: skip
"""CIE L*a*b* under even, warm white light; read off photographs of sets, good to about 15."""
MOST_SATURATED = 55.0
"""CIE chroma beyond which colours are not told apart by it."""
UNSURE_COLOUR = 60.0
"""Lab distance beyond which a snooker ball has no name."""
UNLIKE_REDS, UNLIKE_NEXT, LEAST_UNLIKE = 2.5, 1.2, 8.0
"""The brown among balls that all look red is as many times as far from their middle as they usually are, and farther
than any other one by such a factor and such a Lab distance: reds are many and alike, in any light."""
PALE, PALER = 0.5, 0.2
"""Paleness from which a struck ball is believed to be the cue ball, and by how much another may beat it."""
ONE_COLOUR, LEAST_OF_A_COLOUR = 14.0, 3
"""Lab distance within which pool balls have one colour, and how many of each of two colours make an English set."""
LEAST_OF_A_STRIPE, LEAST_OF_A_TURN = 0.25, 0.4
"""White of the outer ring and half of that of the disc, together: of a stripe at least (by its geometry from 0.3; the
spot of a solid's number, a third of the ball's diameter, gives 0.2 at most); and share of the disc that is white on a
stripe now and then while it rolls."""
BLACK, MOST_OF_AN_EIGHT = 0.4, 0.35
"""The eight is the ball that is darkest in its brightest channel, where that is darker than this share of the lightest
ball and less of it is white: a dark blue or maroon ball has one bright channel."""
NUMBERED = ("solid", "stripe", "ball")
"""Kinds of which there are always several: their ids count from 1."""


def name_kinds(look: Look, game: Game, struck: int | None = None) -> tuple[str, ...]:
    """One of `models.core.tracks.KINDS` per ball; `ball` where unsure. The ball that is `struck` is hardly another's."""
    if not len(look.white):
        return ()
    if game == "carom":
        return _carom(look)
    return _snooker(look, struck) if game == "snooker" else _pool(look, struck)


def name_ids(kinds: tuple[str, ...], xy: FloatArray) -> tuple[str, ...]:
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
    reddish = np.flatnonzero(np.isin(np.argmin(distance, axis=1), [names.index("red"), names.index("brown")]))
    brown = _brown_among(look, reddish)
    if brown is not None:
        distance[reddish, names.index("brown")] = UNSURE_COLOUR
        distance[brown, [names.index("red"), names.index("brown")]] = UNSURE_COLOUR, 0.0
    return _cheapest(distance, names)


def _brown_among(look: Look, reddish: NDArray[np.int64]) -> int | None:
    """Which of the balls (n,) that seem red is the brown, where one is not like the others."""
    if len(reddish) <= LEAST_OF_A_COLOUR:
        return None
    off = np.hypot.reduce(look.colour[reddish] - np.median(look.colour[reddish], axis=0), axis=1)
    order = np.argsort(off)
    brown, usual = int(reddish[order[-1]]), float(np.median(off))
    duller = look.chroma[brown] < np.median(look.chroma[reddish])
    apart = off[order[-1]] > max(UNLIKE_REDS * usual, UNLIKE_NEXT * off[order[-2]], LEAST_UNLIKE)
    return brown if apart and duller else None


def _cheapest(distance: FloatArray, names: list[str]) -> tuple[str, ...]:
    """A name for each of N balls, each of the M names once and "red" any number of times, from distances (N, M)."""
    balls = len(distance)
    column = names + ["red"] * (balls - 1) + ["ball"] * balls
    reds = np.repeat(distance[:, [names.index("red")]], balls - 1, axis=1)
    cost = np.concatenate([distance, reds, np.full((balls, balls), UNSURE_COLOUR)], axis=1)
    _, chosen = assigned(cost)
    return tuple(column[c] for c in chosen)


def _calm(colour: FloatArray) -> FloatArray:
    """Colours (..., 3) with their saturation limited: cameras exaggerate it, the hue stays."""
    chroma = np.hypot(colour[..., 1], colour[..., 2])
    share = np.minimum(1.0, MOST_SATURATED / np.maximum(chroma, 1e-9))
    return np.asarray(colour * np.stack([np.ones_like(share), share, share], axis=-1))


def _carom(look: Look) -> tuple[str, ...]:
    """Red, yellow, white: the three that fit best; colours in relation to each other, as the light differs."""
    lightness, a, b = look.colour.T
    cost = np.stack([-(a - 0.3 * b), -(b - 0.8 * a), look.chroma - 0.3 * lightness - 10.0 * look.white], axis=1)
    balls, picks = assigned(cost - cost.min() + 1.0) if len(a) <= 3 else _pick(cost)
    kinds = ["ball"] * len(a)
    plausible = (a > 20.0, (b > 25.0) & (a < 35.0), (look.chroma < 40.0) & (lightness > 50.0))
    for ball, pick in zip(balls, picks, strict=True):
        if plausible[pick][ball]:
            kinds[ball] = ("red", "yellow", "white")[pick]
    return tuple(kinds)


def _pick(cost: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    picks, balls = assigned(cost.T)
    return balls, picks


def _pool(look: Look, struck: int | None) -> tuple[str, ...]:
    """Cue and eight once; two many-fold plain colours are an English set, otherwise solids and stripes."""
    lightness, a, b = look.colour.T
    striped = look.white_rim + 0.5 * look.white
    shows = (striped >= LEAST_OF_A_STRIPE) | (look.white_high >= LEAST_OF_A_TURN)
    kinds = np.where(shows, "stripe", "solid").astype(object)
    cue = _cue(look, struck)
    if cue is not None:
        kinds[cue] = "cue"
    eight = int(np.argmin(np.where((kinds == "cue") | (look.white > MOST_OF_AN_EIGHT), np.inf, look.value)))
    if (
        kinds[eight] != "cue"
        and look.value[eight] < BLACK * lightness.max() / 100
        and look.white[eight] < MOST_OF_AN_EIGHT
    ):
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


def _paleness(look: Look) -> FloatArray:
    """(N,) how much a ball looks like a white one in tinted light: light, with little colour, some of it white."""
    return np.asarray(look.colour[:, 0] / 100 - look.chroma / 150 + look.white / 2)


def _alike(colour: FloatArray) -> bool:
    """Whether balls (n, 3) have one colour: those of an English set do, solids and stripes do not."""
    off = np.hypot.reduce(colour - np.median(colour, axis=0), axis=1)
    return bool(np.percentile(off, 75) < ONE_COLOUR)
