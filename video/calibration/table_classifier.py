"""Classification of the table: which preset explains pockets, marks on the cloth and relative ball size."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.number_format import format_probability
from models.core.scene import BallSize, Table, apply_homography
from models.core.typing import FloatArray, ImageArray
from models.physics.billiards.tables import TABLE_PRESETS, estimate_preset_ball_size
from video.calibration.ball_size import BallSizes
from video.calibration.camera_model import homography_between
from video.calibration.cloth_region import compare_with_cloth

# Relative frequency of filmed tables (prior); decisive only where the ball sizes are ambiguous.
TABLE_PRIOR = {
    "pool-9ft": 1.0,
    "pool-8ft": 0.4,
    "pool-8ft-pro": 0.1,
    "pool-7ft": 0.3,
    "blackball-7ft": 0.08,
    "blackball-6ft": 0.08,
    "home-4ft": 0.08,
    "snooker-12ft": 0.4,
    "snooker-6ft": 0.25,
    "carom-match": 1.0,
    "carom-230": 0.15,
    "carom-210": 0.25,
}
# Probability of a preset below which the alternatives are reported to the user.
SURE_PROBABILITY = 0.9
# Smallest probability of a reported alternative.
MIN_ALTERNATIVE_PROBABILITY = 0.05
# First words of the warning about alternative tables.
ALTERNATIVES_PREFIX = "The table size is a guess: it could also be "
# Standard deviations between a measured ball size and the nearest preset up to which a preset explains it. Beyond them
# none does: the set is another, and the sizes of presets vary as much as the nearest one is off.
EXPLAINED_SIGMAS = 2.0
# Probability that a D is detected on a snooker table, and on another. Misses: no D on the cloth, lines too thin for a
# small image; false alarms: round shadows, rings of chalk.
D_TRUE_POSITIVE_RATE, D_FALSE_POSITIVE_RATE = 0.7, 0.02
# Radius of the D over the width of the table: 292 mm on 1778 mm (WPBSA rules, section 1.1).
D_RADIUS_WIDTHS = 0.164
# px, size of the plan view in which marks are searched.
PLAN_SIZE_PX = (800, 400)
# px of the plan, wider than any painted line (50 mm of 6.1 m are 3), and grey levels by which paint is brighter than
# the surface beside it; chalk and seams on cloth are darker or fainter.
LINE_WIDTH_PX, LINE_LEVELS = 13, 25
# Share of the width at the border that is left out: noses and their highlights.
LINE_BORDER = 0.04
# Place of the baulk line as a share of the length, and by how much tables and calibrations differ from it: 737 mm on
# 3569 mm (WPBSA rules, section 1.1), a fifth on English tables (WEPF rules, equipment).
BAULK_SHARE, BAULK_REACH = 0.2065, 0.02
# Grey levels by which a line on cloth is brighter or darker than the cloth in an image in which it is a pixel wide.
CLOTH_LINE_LEVELS = 8
# Share of a side over which a line runs, and the largest angle (rad) between them: the surface of a court is located by
# its mat, which is not quite parallel to its lines.
LINE_COVER, LINE_TILT = 0.5, 0.05


@dataclass(frozen=True, slots=True)
class TableClassification:
    """The most probable preset, with reasons and alternatives."""

    table: Table
    probabilities: dict[str, float]
    """Probabilities of all filmed presets by name; their sum is 1."""
    note: str
    warnings: tuple[str, ...]
    """Sentences on what else the table could be; empty where the preset is sure."""

    @property
    def scale_sigma(self) -> float:
        """Relative standard deviation of all lengths by the alternatives; 0 where there are none."""
        if not self.warnings:
            return 0.0
        shares = ((p, TABLE_PRESETS[name].length / self.table.length) for name, p in self.probabilities.items())
        return math.sqrt(sum(p * math.log(share) ** 2 for p, share in shares))

    def estimate_ball_size(self) -> BallSize:
        """Estimate the nominal size of the balls relative to the table, in units of the most probable preset.

        Returns:
            The estimate of source `preset`: spread of the candidate presets around the most probable one, and tolerance
            of its balls.
        """
        table = self.table
        nominal = estimate_preset_ball_size(table)
        variance = sum(
            probability * math.log(_ball_ratio(TABLE_PRESETS[name]) / _ball_ratio(table)) ** 2
            for name, probability in self.probabilities.items()
        )
        return replace(nominal, sigma=math.hypot(nominal.sigma, nominal.radius * math.sqrt(variance)))


def _ball_ratio(table: Table) -> float:
    return table.ball_radius / table.length


def classify_table(sizes: BallSizes, pockets: bool | None, has_d: bool) -> TableClassification:
    """Classify a table by the size of its balls, its pockets and its marks (Bayes' rule over the presets).

    Args:
        sizes: measured ball radius relative to the length of the table.
        pockets: whether the table has pockets; None where that could not be measured.
        has_d: whether its cloth shows the D of a snooker table.

    Returns:
        The most probable preset, with all probabilities.
    """
    presets = [TABLE_PRESETS[name] for name in TABLE_PRIOR]
    nearest = min(_deviation(table, sizes) for table in presets if pockets in (None, table.pockets))
    spread = max(nearest / EXPLAINED_SIGMAS, 1.0)
    weights = {table.name: _posterior_weight(table, sizes, spread, pockets, has_d) for table in presets}
    total = sum(weights.values())
    probabilities = {name: weight / total for name, weight in weights.items()}
    table = TABLE_PRESETS[max(weights, key=lambda name: weights[name])]
    return TableClassification(
        table, probabilities, _explain_choice(table, sizes, pockets, has_d), _format_alternatives(table, probabilities)
    )


def _explain_choice(table: Table, sizes: BallSizes, pockets: bool | None, has_d: bool) -> str:
    """Format the reasons for a preset as a sentence."""
    has_pockets = {True: "it has pockets", False: "it has no pockets", None: "its pockets could not be measured"}
    reasons = [has_pockets[pockets]]
    if has_d:
        reasons.append("its cloth has a D")
    if sizes.count:
        reasons.append(
            f"its balls have {100 * sizes.radius_ratio:.2f} ± {100 * sizes.sigma:.2f} % of its length as radius"
        )
    else:
        reasons.append("no ball could be measured")
    return f"table classified as {table.name} because {', '.join(reasons)}; state another table to override"


def _format_alternatives(table: Table, probabilities: dict[str, float]) -> tuple[str, ...]:
    """Format the nearly as probable presets as one sentence, the most probable first; empty where one is sure."""
    if probabilities[table.name] >= SURE_PROBABILITY:
        return ()
    others = sorted((name for name in probabilities if name != table.name), key=lambda name: -probabilities[name])
    likely = [name for name in others if probabilities[name] > MIN_ALTERNATIVE_PROBABILITY] or others[:1]
    alternatives = " or ".join(f"{name} ({_describe_difference(TABLE_PRESETS[name], table)})" for name in likely)
    share = format_probability(probabilities[table.name])
    return (
        f"{ALTERNATIVES_PREFIX}{alternatives}: {table.name} is {share} probable."
        f" If you know the size, run it again with the table stated, such as {likely[0]}.",
    )


def _describe_difference(other: Table, table: Table) -> str:
    """Describe the effect on lengths and speeds if it is the other table."""
    change = round(100 * (other.length / table.length - 1))
    if change == 0:
        return "the same lengths, other balls"
    return f"every length and speed {abs(change)} % {'larger' if change > 0 else 'smaller'}"


def _deviation(table: Table, sizes: BallSizes) -> float:
    """Return the standard deviations between the measured size of the balls and a preset; 0 without a measurement."""
    if not sizes.count:
        return 0.0
    return abs(math.log(_ball_ratio(table) / sizes.radius_ratio)) / (sizes.sigma / sizes.radius_ratio)


def _posterior_weight(table: Table, sizes: BallSizes, spread: float, pockets: bool | None, has_d: bool) -> float:
    """Return prior times likelihood of a preset, not normalised; `spread` widens the errors of sizes."""
    if pockets is not None and table.pockets != pockets:
        return 0.0
    detection_rate = D_TRUE_POSITIVE_RATE if table.game == "snooker" else D_FALSE_POSITIVE_RATE
    weight = TABLE_PRIOR[table.name] * (detection_rate if has_d else 1 - detection_rate)
    return weight * math.exp(-0.5 * min((_deviation(table, sizes) / spread) ** 2, 50.0))


def measure_pocket_share(image: ImageArray, outer: FloatArray, noses: FloatArray, cloth: FloatArray) -> float:
    """Measure how many of the six pocket positions differ from the cloth in colour.

    Args:
        image: (H, W, 3) RGB.
        outer: (4, 2) px, outer corners of the cloth.
        noses: (4, 2) px, corners of the noses in the same order.
        cloth: (3,) RGB colour of the cloth.

    Returns:
        A share near 1 with pockets, and near 0 on a carom table, whose cushions are continuous.
    """
    angle, shade = compare_with_cloth(image, cloth)
    height, width = shade.shape
    differing_shares = []
    for nose, edge in zip(_pocket_positions(noses), _pocket_positions(outer), strict=True):
        positions = nose + np.linspace(0.15, 0.75, 7)[:, None] * (edge - nose)
        column = np.clip(np.rint(positions[:, 0]).astype(int), 0, width - 1)
        row = np.clip(np.rint(positions[:, 1]).astype(int), 0, height - 1)
        differs = (angle[row, column] > 0.25) | (shade[row, column] < 0.45) | (shade[row, column] > 1.7)
        differing_shares.append(float(np.mean(differs)))
    return float(np.mean(np.array(differing_shares) > 0.4))


def _pocket_positions(corners: FloatArray) -> FloatArray:
    """Return the four corners and the perspective midpoints of the two long sides (6, 2)."""
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    positions = np.concatenate([square, [[0.5, 0.0], [0.5, 1.0]]])
    return apply_homography(homography_between(square, corners), positions)


def has_snooker_d(background: ImageArray, noses: FloatArray) -> bool:
    """Check whether the cloth shows the D of a snooker table, at either end.

    Args:
        background: (H, W, 3) RGB, the table without moving objects.
        noses: (4, 2) px, corners of the noses.

    Returns:
        True if an arc of the right size at the right place is far clearer than elsewhere.
    """
    lines = _extract_thin_lines(_draw_plan(background, noses))
    return any(_has_d_at_left(side) for side in (lines, lines[:, ::-1]))


def _extract_thin_lines(plan: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Extract by how much thin lines of a plan (H, W) are brighter or darker than what is beside them, grey levels."""
    kernel = np.ones((7, 7), np.uint8)
    bright, dark = (cv2.morphologyEx(plan, way, kernel) for way in (cv2.MORPH_TOPHAT, cv2.MORPH_BLACKHAT))
    return np.asarray(np.maximum(bright, dark), np.uint8)


def _draw_plan(image: ImageArray, noses: FloatArray) -> NDArray[np.uint8]:
    """Draw the grey plan of the surface between corners (4, 2) px."""
    length, width = PLAN_SIZE_PX
    square = np.array([[0.0, 0.0], [length, 0.0], [length, width], [0.0, width]])
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return np.asarray(
        cv2.warpPerspective(grey, homography_between(noses, square), PLAN_SIZE_PX, flags=cv2.INTER_AREA), np.uint8
    )


def count_painted_lines(image: ImageArray, noses: FloatArray) -> tuple[int, int]:
    """Count the bright lines that run over half of the surface, as on courts, without those at its border.

    Args:
        image: (H, W, 3) RGB, the table without moving objects.
        noses: (4, 2) px, corners of the noses.

    Returns:
        Number of lines along the surface and across it.
    """
    plan = _draw_plan(image, noses)
    kernel = np.ones((LINE_WIDTH_PX, LINE_WIDTH_PX), np.uint8)
    bright = (cv2.morphologyEx(plan, cv2.MORPH_TOPHAT, kernel) > LINE_LEVELS).astype(np.uint8)
    border = round(LINE_BORDER * PLAN_SIZE_PX[1])
    inner = bright[border:-border, border:-border]
    return _count_line_bundles(inner), _count_line_bundles(np.ascontiguousarray(inner.T))


def find_baulk_line(image: ImageArray, noses: FloatArray) -> float | None:
    """Find the baulk line of a snooker or English table.

    Args:
        image: (H, W, 3) RGB.
        noses: (4, 2) px, corners of the noses; the line runs across the side from the first to the second one.

    Returns:
        Its place, as a share of the length from the first corner; None unless one end alone has such a line.
    """
    lines = (_extract_thin_lines(_draw_plan(image, noses)) > CLOTH_LINE_LEVELS).astype(np.uint8)
    border = round(LINE_BORDER * lines.shape[0])
    cover = _measure_line_cover(np.ascontiguousarray(lines[border:-border].T))
    share = np.arange(len(cover)) / len(cover)
    ends = [np.where(np.abs(share - place) < BAULK_REACH, cover, 0) for place in (BAULK_SHARE, 1 - BAULK_SHARE)]
    places = [float(share[end.argmax()]) for end in ends if end.max() > LINE_COVER]
    return places[0] if len(places) == 1 else None


def _count_line_bundles(bright: NDArray[np.uint8]) -> int:
    """Count the lines of a mask (H, W) that run along its rows, tilted by up to `LINE_TILT`."""
    is_line = (_measure_line_cover(bright) > LINE_COVER).astype(np.int8)
    gap = np.ones(LINE_WIDTH_PX, np.uint8)
    joined = cv2.morphologyEx(is_line.view(np.uint8)[None], cv2.MORPH_CLOSE, gap[None])[0]
    return int(np.count_nonzero(np.diff(np.concatenate([[0], joined.astype(np.int8)])) > 0))


def _measure_line_cover(bright: NDArray[np.uint8]) -> FloatArray:
    """Measure over which share a line covers each row of a mask (H, W), tilted by up to `LINE_TILT`."""
    height, width = bright.shape
    tilts = np.linspace(-LINE_TILT, LINE_TILT, 13)
    column = np.arange(width)
    best = np.zeros(height)
    thick = cv2.dilate(bright, np.ones((3, 1), np.uint8))
    for tilt in tilts:
        row = np.arange(height)[:, None] + np.rint(np.tan(tilt) * (column - width / 2)).astype(int)
        best = np.maximum(best, thick[np.clip(row, 0, height - 1), column].mean(axis=1))
    return best


def _has_d_at_left(lines: NDArray[np.uint8]) -> bool:
    """Check whether thin lines (H, W) trace an arc that opens to the right, far better than elsewhere."""
    height, length = lines.shape
    bearings = np.linspace(np.pi / 2 + 0.15, 3 * np.pi / 2 - 0.15, 60)
    centres = np.arange(int(0.13 * length), int(0.27 * length))
    radii = np.arange(int(0.9 * D_RADIUS_WIDTHS * height), int(1.1 * D_RADIUS_WIDTHS * height) + 1)
    column = np.rint(centres[:, None, None] + radii[None, :, None] * np.cos(bearings)).astype(int)
    row = np.rint((height - 1) / 2 + radii[None, :, None] * np.sin(bearings)).astype(int)
    traced = lines[np.broadcast_to(row, column.shape), column].astype(np.float64)
    # A low percentile along the arc: nearly all of it must be visible, a crossing line is not enough.
    score = np.percentile(traced, 30, axis=2)
    return bool(score.max() > 4.0 and score.max() > 3.0 * np.median(score) + 2.0)
