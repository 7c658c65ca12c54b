"""Which table it is: pockets, marks on the cloth and the size of the balls against that of the table."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import Table, apply_homography
from models.core.typing import FloatArray, ImageArray
from models.physics.billiards.tables import PRESETS
from video.calibration.ball_size import BallSizes
from video.calibration.camera_model import homography_between
from video.calibration.cloth_region import cloth_likeness

COMMON = {
    "pool-9ft": 1.0,
    "pool-8ft": 0.4,
    "pool-8ft-pro": 0.1,
    "pool-7ft": 0.3,
    "blackball-7ft": 0.08,
    "blackball-6ft": 0.08,
    "snooker-12ft": 0.4,
    "snooker-6ft": 0.25,
    "carom-match": 1.0,
    "carom-230": 0.15,
    "carom-210": 0.25,
}
"""How often a table is filmed, relative to others: decides only where ball sizes leave a doubt."""
SURE = 0.9
"""Probability of a preset below which the user is told what else the table could be."""
LIKELY = 0.05
"""Least probability of a preset that is told as an alternative."""
COULD_BE = "The table could also be "
"""How a doubt about the table begins."""
D_SEEN, D_IMAGINED = 0.7, 0.02
"""How often a semicircle at a quarter of the length is found on a snooker table, and on another: cloths without one,
lines too thin for a small picture; round shadows, rings of chalk."""
D_RADIUS = 0.164
"""Radius of the D over the width of the table: 292 mm on 1778 mm (WPBSA rules, section 1.1)."""
SHEET = (800, 400)
"""px of the plan view in which marks are looked for."""


@dataclass(frozen=True, slots=True)
class Guess:
    """The most probable preset, and what speaks for and against it."""

    table: Table
    probabilities: dict[str, float]
    """Of all presets that are filmed, by their names; they add up to 1."""
    note: str
    doubts: tuple[str, ...]
    """What else the table could be; empty where the preset is sure."""


def guess_table(sizes: BallSizes, pockets: bool, has_d: bool) -> Guess:
    """The most probable preset given the size of the balls, pockets and marks."""
    weights = {name: _weight(PRESETS[name], sizes, pockets, has_d) for name in COMMON}
    total = sum(weights.values())
    probabilities = {name: weight / total for name, weight in weights.items()}
    table = PRESETS[max(weights, key=lambda name: weights[name])]
    return Guess(table, probabilities, _why(table, sizes, pockets, has_d), _doubts(table, probabilities))


def _why(table: Table, sizes: BallSizes, pockets: bool, has_d: bool) -> str:
    reasons = ["it has pockets" if pockets else "it has no pockets"]
    if has_d:
        reasons.append("a D is drawn on its cloth")
    if sizes.count:
        reasons.append(f"its balls have {100 * sizes.share:.2f} +- {100 * sizes.sigma:.2f} % of its length as radius")
    else:
        reasons.append("no ball could be measured")
    return f"table taken for {table.name} because {', '.join(reasons)}; give --table to override"


def _doubts(table: Table, probabilities: dict[str, float]) -> tuple[str, ...]:
    """One sentence on the presets that are nearly as probable, the most probable first; none where one is sure."""
    if probabilities[table.name] >= SURE:
        return ()
    others = sorted((name for name in probabilities if name != table.name), key=lambda name: -probabilities[name])
    likely = [name for name in others if probabilities[name] > LIKELY] or others[:1]
    told = " or ".join(f"{name} ({_consequence(PRESETS[name], table)})" for name in likely)
    return (f"{COULD_BE}{told}: {table.name} is {probabilities[table.name]:.0%} probable; give --table.",)


def _consequence(other: Table, table: Table) -> str:
    """What becomes of every length and speed if it is the other table."""
    change = round(100 * (other.length / table.length - 1))
    if change == 0:
        return "the same lengths, other balls"
    return f"every length and speed {abs(change)} % {'larger' if change > 0 else 'smaller'}"


def _weight(table: Table, sizes: BallSizes, pockets: bool, has_d: bool) -> float:
    if table.pockets != pockets:
        return 0.0
    drawn = D_SEEN if table.game == "snooker" else D_IMAGINED
    weight = COMMON[table.name] * (drawn if has_d else 1 - drawn)
    if not sizes.count:
        return weight
    off = np.log(table.ball_radius / table.length / sizes.share) / (sizes.sigma / sizes.share)
    return weight * float(np.exp(-0.5 * min(off**2, 50.0)))


def pocket_share(picture: ImageArray, outer: FloatArray, noses: FloatArray, cloth: FloatArray) -> float:
    """Share of six places between corners and middles of the long noses and the cloth's outer edge that are no cloth.

    Near 1 with pockets, near 0 on a carom table, whose cushions run through. Corners (4, 2) px each.
    """
    angle, shade = cloth_likeness(picture, cloth)
    height, width = shade.shape
    broken = []
    for nose, edge in zip(_six(noses), _six(outer), strict=True):
        places = nose + np.linspace(0.15, 0.75, 7)[:, None] * (edge - nose)
        column = np.clip(np.rint(places[:, 0]).astype(int), 0, width - 1)
        row = np.clip(np.rint(places[:, 1]).astype(int), 0, height - 1)
        unlike = (angle[row, column] > 0.25) | (shade[row, column] < 0.45) | (shade[row, column] > 1.7)
        broken.append(float(np.mean(unlike)))
    return float(np.mean(np.array(broken) > 0.4))


def _six(corners: FloatArray) -> FloatArray:
    """Four corners and the middles, seen in perspective, of the two long sides (6, 2)."""
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    places = np.concatenate([square, [[0.5, 0.0], [0.5, 1.0]]])
    return apply_homography(homography_between(square, corners), places)


def has_snooker_d(background: ImageArray, noses: FloatArray) -> bool:
    """Whether a semicircle is drawn behind a baulk line, at either end of the table with noses (4, 2) px."""
    length, width = SHEET
    square = np.array([[0.0, 0.0], [length, 0.0], [length, width], [0.0, width]])
    to_sheet = homography_between(noses, square)
    grey = cv2.cvtColor(background, cv2.COLOR_RGB2GRAY)
    sheet = cv2.warpPerspective(grey, to_sheet, SHEET, flags=cv2.INTER_AREA)
    kernel = np.ones((7, 7), np.uint8)
    lines = np.maximum(
        cv2.morphologyEx(sheet, cv2.MORPH_BLACKHAT, kernel), cv2.morphologyEx(sheet, cv2.MORPH_TOPHAT, kernel)
    )
    return any(_d_at_left(side) for side in (lines, lines[:, ::-1]))


def _d_at_left(lines: NDArray[np.uint8]) -> bool:
    """Whether thin lines (H, W) trace an arc that opens to the right, far better than other places do."""
    height, length = lines.shape
    bearings = np.linspace(np.pi / 2 + 0.15, 3 * np.pi / 2 - 0.15, 60)
    centres = np.arange(int(0.13 * length), int(0.27 * length))
    radii = np.arange(int(0.9 * D_RADIUS * height), int(1.1 * D_RADIUS * height) + 1)
    column = np.rint(centres[:, None, None] + radii[None, :, None] * np.cos(bearings)).astype(int)
    row = np.rint((height - 1) / 2 + radii[None, :, None] * np.sin(bearings)).astype(int)
    traced = lines[np.broadcast_to(row, column.shape), column].astype(np.float64)
    # The lower quartile along the arc: nearly all of it must be drawn, a crossing line does not do.
    score = np.percentile(traced, 30, axis=2)
    return bool(score.max() > 4.0 and score.max() > 3.0 * np.median(score) + 2.0)
