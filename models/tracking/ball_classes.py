"""Ball classes from the appearance of balls over many frames, and unique ids."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, count, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from models.core.detections import Detections
from models.core.scene import Game
from models.core.typing import FloatArray, IntArray

# Of two balls whose centres are nearer than this many radii, one hides part of the other.
MIN_CLEARANCE = 1.9
# Unoccluded detections of a ball from which the occluded ones are ignored.
MIN_CLEAR_DETECTIONS = 5


@dataclass(frozen=True, slots=True)
class Appearance:
    """Appearance of N balls, averaged over many frames."""

    colour: FloatArray
    """(N, 3) median CIE L*a*b*."""
    white: FloatArray
    """(N,) median white share."""
    white_high: FloatArray
    """(N,) 90th percentile of the white share of a rolling ball, since a stripe shows its white only now and then; the
    median of a resting one.
    """
    white_rim: FloatArray
    """(N,) median white share of the outer ring."""
    value: FloatArray
    """(N,) median of the brightest channel, 0 to 1, where it is not white."""

    @property
    def chroma(self) -> FloatArray:
        """(N,) distance from grey."""
        return np.hypot(self.colour[:, 1], self.colour[:, 2])


def summarize_appearance(colours: list[FloatArray], rows: list[IntArray], detections: Detections) -> Appearance:
    """Summarize the appearance of N balls over their detections.

    Args:
        colours: N mean colours (3,), CIE L*a*b*.
        rows: N arrays with the rows of `detections` that belong to each ball.
        detections: All detections of the clip.

    Returns:
        The appearance of the N balls. Occluded detections are ignored where enough others exist.
    """
    is_clear = _is_unoccluded(detections)
    selected = [row[is_clear[row]] if is_clear[row].sum() >= MIN_CLEAR_DETECTIONS else row for row in rows]
    white, rim, value = detections.white, detections.white_rim, detections.value
    return Appearance(
        np.array(colours),
        np.array([np.median(white[row]) for row in selected]),
        np.array([np.percentile(white[row], 90 if _leaves_its_place(detections, row) else 50) for row in selected]),
        np.array([np.median(rim[row]) for row in selected]),
        np.array([np.median(value[row]) for row in selected]),
    )


def _leaves_its_place(detections: Detections, row: IntArray) -> bool:
    """Return whether a ball moves by more than its radius."""
    return bool(np.ptp(detections.centre[row], axis=0).max() > detections.radius[row].max())


def _is_unoccluded(detections: Detections) -> NDArray[np.bool_]:
    """Mark the detections (K,) that no other detection of the same frame overlaps."""
    is_clear = np.ones(len(detections), dtype=bool)
    ends = np.flatnonzero(np.diff(detections.frame, prepend=-1, append=np.iinfo(np.int64).max))
    for first, last in pairwise(ends):
        centre, radius = detections.centre[first:last], detections.radius[first:last]
        distance = np.linalg.norm(centre[:, None] - centre[None], axis=-1)
        np.fill_diagonal(distance, np.inf)
        is_clear[first:last] = (distance > MIN_CLEARANCE * (radius[:, None] + radius[None]) / 2).all(axis=1)
    return is_clear


# CIE L*a*b* under even, warm white light, read off photographs of sets; accurate to about 15.
SNOOKER_COLOURS = {
    "cue": (85.0, 0.0, 12.0), "red": (38.0, 50.0, 32.0), "yellow": (75.0, 5.0, 65.0), "green": (38.0, -35.0, 12.0),
    "brown": (38.0, 22.0, 30.0), "blue": (38.0, 0.0, -42.0), "pink": (68.0, 38.0, 12.0), "black": (18.0, 0.0, 2.0),
}  # fmt: skip
# CIE chroma above which colours are not distinguished by it.
MAX_CHROMA = 55.0
# Lab distance beyond which a snooker ball gets no class: three times the accuracy of `SNOOKER_COLOURS`.
MAX_COLOUR_DISTANCE = 45.0
# White share that the cue ball of snooker exceeds, and from which a ball has no colour, and the Lab distance that the
# contrary is worth: highlights cover less, on a pink up to 0.56; marks and rings more.
MIN_CUE_WHITE, CLEAR_WHITE, WRONG_WHITE_DISTANCE = 0.5, 0.7, 40.0
# Reds of a snooker set.
MAX_REDS = 15
# Balls of each class of a pool set.
POOL_SET = {"cue": 1, "eight": 1, "solid": 7, "stripe": 7}
# The brown among balls that all look red differs from their median colour by this factor more than usual, by this
# factor more than any other ball, and by at least this Lab distance: reds are many and alike in any light.
BROWN_TO_USUAL_RATIO, BROWN_TO_NEXT_RATIO, MIN_BROWN_DISTANCE = 2.5, 1.2, 8.0
# Least white likeness of a struck ball to be the cue ball, and by how much another ball may exceed it.
MIN_PALENESS, MAX_PALENESS_DEFICIT = 0.5, 0.2
# Lab distance within which pool balls have one colour, and how many balls of each of two colours make an English set.
SAME_COLOUR_DISTANCE, MIN_BALLS_PER_COLOUR = 14.0, 3
# Least sum of the white share of the outer ring and half of that of the disc for a stripe (0.3 by geometry; the number
# spot of a solid, a third of the ball's diameter, gives 0.2 at most); and the white share of the disc that a rolling
# stripe shows now and then.
MIN_STRIPE_WHITE, MIN_STRIPE_WHITE_HIGH = 0.25, 0.4
# The eight is the ball with the darkest brightest channel, if that is below this share of the lightest ball's and its
# white share is small: a dark blue or maroon ball has one bright channel.
MAX_EIGHT_VALUE, MAX_EIGHT_WHITE = 0.4, 0.35
# CIE a* or b* from which a ball has a hue that tells one set from another.
MIN_SET_CHROMA = 20.0
# White share up to which a ball is plain: a highlight covers less.
MAX_PLAIN_WHITE = 0.15
# Of blue, green and black, how many lie beside the reds of a snooker set. An English set has the black alone; an
# American one has no three alike reds.
MIN_SET_COLOURS = 2
# Stripes from which a set is no snooker set, which has none; the pink and a highlight look like one each.
MIN_STRIPES = 3
# Classes with several balls: their ids count from 1.
NUMBERED = ("solid", "stripe", "ball")
# Radii from its first place beyond which a ball has left it, if it stays away.
MIN_DEPARTURE_RADII = 1.0
# Frames at rest before a ball leaves: one that moves from the start may have been hit before.
MIN_REST_FRAMES = 3
# Frames between the first and the second departure; with fewer the order is uncertain.
MIN_HEAD_START = 2


def classify_balls(appearance: Appearance, game: Game, struck_ball: int | None = None) -> tuple[str, ...]:
    """Classify balls by their appearance.

    Args:
        appearance: Appearance of N balls.
        game: Game that the table is for; it decides which classes exist.
        struck_ball: Index of the ball that was struck first, probably the cue ball; None where unknown.

    Returns:
        One of `models.core.tracks.KINDS` per ball; `ball` where uncertain.
    """
    if not len(appearance.white):
        return ()
    game = recognise_set(appearance, game)
    if game == "carom":
        return _classify_carom(appearance)
    return _classify_snooker(appearance, struck_ball) if game == "snooker" else _classify_pool(appearance, struck_ball)


def recognise_set(appearance: Appearance, game: Game) -> Game:
    """Recognise the set that N balls belong to, which decides their names more surely than the size of the table does.

    Args:
        appearance: Appearance of the balls.
        game: Game that the table is for.

    Returns:
        The game of the set; that of the table where the balls leave it open.
    """
    if game == "carom":
        return game
    lightness, a, b = appearance.colour.T
    striped = _shows_stripe(appearance) & (np.hypot(a, b) > MIN_SET_CHROMA)
    plain = appearance.white < MAX_PLAIN_WHITE
    red = plain & (a > MIN_SET_CHROMA) & (a > b)
    yellow = plain & (b > MIN_SET_CHROMA) & (b > 1.5 * abs(a))
    others = sum(
        bool((plain & rule).any())
        for rule in (b < -MIN_SET_CHROMA, (a < -0.5 * MIN_SET_CHROMA) & (abs(b) < abs(a)), (lightness < 25) & (b > -10))
    )  # blue, green, black
    is_alike = red.sum() >= MIN_BALLS_PER_COLOUR and _have_one_colour(_scale_to_one_lightness(appearance.colour[red]))
    if game == "pool" and is_alike and yellow.sum() <= 1 and others >= MIN_SET_COLOURS and striped.sum() <= 1:
        return "snooker"
    return "pool" if game == "snooker" and not is_alike and striped.sum() >= MIN_STRIPES else game


def assign_ids(
    kinds: Sequence[str], xy: FloatArray, former: Sequence[str] = (), used: Sequence[str] = ()
) -> tuple[str, ...]:
    """Assign unique ids from classes and first places (N, 2): left before right, then top before bottom.

    Args:
        kinds: Classes of N balls.
        xy: Places of the balls.
        former: Ids that the balls had before a correction, empty for new balls: a ball keeps its own where that names
            its class, so that the correction of one ball renames no other.
        used: Ids of that time, also of balls that are gone; a new ball gets none of their numbers.

    Returns:
        N ids.
    """
    pairs = zip(kinds, former or [""] * len(kinds), strict=True)
    ids = [name if name.rstrip("-0123456789") == kind else "" for kind, name in pairs]
    for ball in np.lexsort((xy[:, 1], xy[:, 0])):
        if not ids[ball]:
            kind = kinds[ball]
            names = chain([kind] * (kind not in NUMBERED), (f"{kind}-{n}" for n in count(1 + (kind not in NUMBERED))))
            ids[ball] = next(name for name in names if name not in ids and (name == kind or name not in used))
    return tuple(ids)


def find_missing_colours(kinds: Sequence[str]) -> tuple[str, ...]:
    """Find the snooker colours that lie on the table by the rules, but that no ball has.

    All six do while a red is left; after the last red, they are potted in the order of their values. A table with half
    of them or fewer shows no frame but an exercise, of which nothing is known.

    Args:
        kinds: Classes of all balls.

    Returns:
        Classes of the missing balls, in the order of their values.
    """
    colours = [name for name in SNOOKER_COLOURS if name not in ("cue", "red")]
    present = [name for name in colours if name in kinds]
    due = colours if "red" in kinds or not present else colours[colours.index(present[0]) :]
    missing = tuple(name for name in due if name not in present)
    return missing if len(missing) < len(present) else ()


def _classify_snooker(appearance: Appearance, struck_ball: int | None) -> tuple[str, ...]:
    """Classify by the cheapest assignment with one ball of each colour and any number of reds."""
    names = list(SNOOKER_COLOURS)
    reference = np.array([SNOOKER_COLOURS[name] for name in names])
    weight = np.array([0.6, 1.0, 1.0])  # lightness is least reliable: it changes with the light and the highlight
    distance = np.hypot.reduce(
        (_limit_saturation(appearance.colour)[:, None] - _limit_saturation(reference)[None]) * weight, axis=2
    )
    paleness = np.clip((appearance.white - MIN_CUE_WHITE) / (CLEAR_WHITE - MIN_CUE_WHITE), 0.0, 1.0)
    is_cue = np.array(names) == "cue"
    distance += WRONG_WHITE_DISTANCE * np.where(is_cue, (appearance.white < MIN_CUE_WHITE)[:, None], paleness[:, None])
    distance[appearance.white >= CLEAR_WHITE, names.index("cue")] *= 0.5
    if struck_ball is not None:
        distance[struck_ball, names.index("cue")] *= 0.5
    reddish = np.flatnonzero(np.isin(np.argmin(distance, axis=1), [names.index("red"), names.index("brown")]))
    brown = _find_brown(appearance, reddish)
    if brown is not None:
        distance[reddish, names.index("brown")] = MAX_COLOUR_DISTANCE
        distance[brown, [names.index("red"), names.index("brown")]] = MAX_COLOUR_DISTANCE, 0.0
    return assign_to_set(distance, dict.fromkeys(names, 1) | {"red": MAX_REDS}, MAX_COLOUR_DISTANCE)


def _find_brown(appearance: Appearance, reddish: NDArray[np.int64]) -> int | None:
    """Find the brown among the balls (n,) that look red, if one differs from the others."""
    if len(reddish) <= MIN_BALLS_PER_COLOUR:
        return None
    colour = appearance.colour[reddish]
    # In even light the brown is darker, in uneven light only its hue and saturation tell it.
    outliers = [_find_outlier(one) for one in (colour, _scale_to_one_lightness(colour))]
    is_duller = appearance.chroma[reddish] < np.median(appearance.chroma[reddish])
    return next((int(reddish[k]) for k in outliers if k is not None and is_duller[k]), None)


def _find_outlier(colour: FloatArray) -> int | None:
    """Find the one of some colours (n, 3) that differs from all others, which are alike; None without one."""
    deviation = np.hypot.reduce(colour - np.median(colour, axis=0), axis=1)
    order = np.argsort(deviation)
    limit = max(BROWN_TO_USUAL_RATIO * np.median(deviation), BROWN_TO_NEXT_RATIO * deviation[order[-2]])
    return int(order[-1]) if deviation[order[-1]] > max(limit, MIN_BROWN_DISTANCE) else None


def _scale_to_one_lightness(colour: FloatArray) -> FloatArray:
    """Scale colours (n, 3) to their median lightness: balls in more or less light differ along their colour only."""
    return np.asarray(colour * np.median(colour[:, 0]) / np.maximum(colour[:, :1], 1.0))


def assign_to_set(cost: FloatArray, sizes: Mapping[str, int], undecided_cost: float) -> tuple[str, ...]:
    """Assign classes to N balls at the least total cost, each class to as many balls as the set has of it.

    Args:
        cost: (N, M) of each class for each ball.
        sizes: Number of balls of each of the M classes.
        undecided_cost: Of a ball that gets no class.

    Returns:
        One class per ball; `ball` for those without a class.
    """
    columns = np.repeat(np.arange(len(sizes)), list(sizes.values()))
    none = np.full((len(cost), len(cost)), undecided_cost)
    _, picks = linear_sum_assignment(np.concatenate([cost[:, columns], none], axis=1))
    names = [*np.array(list(sizes))[columns].tolist(), *["ball"] * len(cost)]
    return tuple(names[pick] for pick in picks)


def _limit_saturation(colour: FloatArray) -> FloatArray:
    """Limit the saturation of colours (..., 3): cameras exaggerate it, the hue stays."""
    chroma = np.hypot(colour[..., 1], colour[..., 2])
    share = np.minimum(1.0, MAX_CHROMA / np.maximum(chroma, 1e-9))
    return np.asarray(colour * np.stack([np.ones_like(share), share, share], axis=-1))


def _classify_carom(appearance: Appearance) -> tuple[str, ...]:
    """Find the best red, yellow and white ball; colours are compared with each other because the light differs."""
    lightness, a, b = appearance.colour.T
    cost = np.stack(
        [-(a - 0.3 * b), -(b - 0.8 * a), appearance.chroma - 0.3 * lightness - 10.0 * appearance.white], axis=1
    )
    balls, picks = linear_sum_assignment(cost - cost.min() + 1.0) if len(a) <= 3 else _assign_by_class(cost)
    kinds = ["ball"] * len(a)
    plausible = (a > 20.0, (b > 25.0) & (a < 35.0), (appearance.chroma < 40.0) & (lightness > 50.0))
    for ball, pick in zip(balls, picks, strict=True):
        if plausible[pick][ball]:
            kinds[ball] = ("red", "yellow", "white")[pick]
    return tuple(kinds)


def _assign_by_class(cost: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    picks, balls = linear_sum_assignment(cost.T)
    return balls, picks


def _classify_pool(appearance: Appearance, struck_ball: int | None) -> tuple[str, ...]:
    """Find the cue ball and the eight, then classify the rest.

    Two plain colours with many balls are an English set, otherwise there are solids and stripes.
    """
    lightness, a, b = appearance.colour.T
    kinds = np.where(_shows_stripe(appearance), "stripe", "solid").astype(object)
    cue = _find_cue_ball(appearance, struck_ball)
    if cue is not None:
        kinds[cue] = "cue"
    eight = int(np.argmin(np.where((kinds == "cue") | (appearance.white > MAX_EIGHT_WHITE), np.inf, appearance.value)))
    if (
        kinds[eight] != "cue"
        and appearance.value[eight] < MAX_EIGHT_VALUE * lightness.max() / 100
        and appearance.white[eight] < MAX_EIGHT_WHITE
    ):
        kinds[eight] = "eight"
    rest = (kinds != "cue") & (kinds != "eight")
    red = rest & (a > 25) & (a > 0.6 * b)
    yellow = rest & ~red & (b > 15) & (b > abs(a))
    if (
        min(red.sum(), yellow.sum()) >= MIN_BALLS_PER_COLOUR
        and _have_one_colour(appearance.colour[red])
        and _have_one_colour(appearance.colour[yellow])
    ):
        kinds[red], kinds[yellow] = "red", "yellow"
    for kind in ("solid", "stripe"):  # of more than a set has, the least certain get no class
        own = np.flatnonzero(kinds == kind)
        certainty = abs(_measure_stripe_white(appearance)[own] - MIN_STRIPE_WHITE)
        doubtful = own[np.argsort(-certainty, kind="stable")[POOL_SET[kind] :]]
        kinds[doubtful] = "ball"
    return tuple(kinds)


def _shows_stripe(appearance: Appearance) -> NDArray[np.bool_]:
    """Which balls (N,) show the white of a stripe."""
    striped = _measure_stripe_white(appearance)
    return np.asarray((striped >= MIN_STRIPE_WHITE) | (appearance.white_high >= MIN_STRIPE_WHITE_HIGH))


def _measure_stripe_white(appearance: Appearance) -> FloatArray:
    """Measure the white (N,) that `MIN_STRIPE_WHITE` bounds."""
    return np.asarray(appearance.white_rim + 0.5 * appearance.white)


def _find_cue_ball(appearance: Appearance, struck_ball: int | None) -> int | None:
    """Find the cue ball: the whitest one, or the struck one if it is pale (tinted light colours whites)."""
    whitest = int(np.argmax(appearance.white - appearance.chroma / 200))
    clear = appearance.white[whitest] > 0.6 and appearance.chroma[whitest] < 45
    if struck_ball is None or struck_ball == whitest:
        pale = struck_ball == whitest and _white_likeness(appearance)[whitest] > MIN_PALENESS
        return whitest if clear or pale else None
    paleness = _white_likeness(appearance)
    if paleness[struck_ball] > MIN_PALENESS and paleness[struck_ball] > paleness.max() - MAX_PALENESS_DEFICIT:
        return struck_ball
    return whitest if clear else None


def _white_likeness(appearance: Appearance) -> FloatArray:
    """Rate (N,) how much a ball looks like a white one in tinted light: light, with little colour, partly white."""
    return np.asarray(appearance.colour[:, 0] / 100 - appearance.chroma / 150 + appearance.white / 2)


def _have_one_colour(colour: FloatArray) -> bool:
    """Return whether balls (n, 3) share one colour, as those of an English set do, unlike solids and stripes."""
    deviation = np.hypot.reduce(colour - np.median(colour, axis=0), axis=1)
    return bool(np.percentile(deviation, 75) < SAME_COLOUR_DISTANCE)


def find_struck_ball(paths: Sequence[tuple[IntArray, FloatArray]], radius: float) -> int | None:
    """Find the ball struck first: the first one to leave its place is the cue ball, whatever its colour looks like.

    Args:
        paths: Frame indices (M,) and places (M, 2) m of each ball.
        radius: Radius of a ball, m.

    Returns:
        Index of the ball; None if uncertain.
    """
    departures = [_departure_frame(frame_index, xy, radius) for frame_index, xy in paths]
    ordered = sorted((at, ball) for ball, at in enumerate(departures) if at is not None)
    if not ordered or (len(ordered) > 1 and ordered[1][0] < ordered[0][0] + MIN_HEAD_START):
        return None
    return ordered[0][1]


def _departure_frame(frame_index: IntArray, xy: FloatArray, radius: float) -> int | None:
    """Find the frame index from which a ball stays away from its first place; None for one that stays."""
    if len(frame_index) <= MIN_REST_FRAMES:
        return None
    home = np.median(xy[:MIN_REST_FRAMES], axis=0)
    away = np.linalg.norm(xy - home, axis=1) > MIN_DEPARTURE_RADII * radius
    if not away[-1] or away[:MIN_REST_FRAMES].any():
        return None
    first_away = len(away) - int(np.argmin(away[::-1])) if not away.all() else 0
    return int(frame_index[first_away])
