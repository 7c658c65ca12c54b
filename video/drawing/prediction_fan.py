"""Fans of predicted paths: where the balls of a posterior ensemble may roll, shaded on the plan of the table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from models.core.scene import Table
from models.core.typing import ByteArray, Float32Array, FloatArray, ImageArray
from video.drawing.circles import SHIFT
from video.drawing.palette import INK, WHITE, Colour, mix_colours
from video.drawing.table_plan import SUPERSAMPLE, TableInset, draw_table_plan

SHADED_SHARES = ((0.9, 0.28), (0.5, 0.42))
"""Shares of the samples that are shaded together, and the opacity of each shade."""
STROKE_PX = 4
"""Line width of a sample in px of the final image, wide enough to close the gaps between samples."""
EDGE_RADII, EDGE_CONTRAST = 0.2, 3.0
"""Blur of the edge of an area, ball radii, and the factor by which it is sharpened again: the edge becomes rounder, not
wider."""
EDGE_MARGIN_RADII = 1 + 4 * EDGE_RADII
"""Ball radii beyond its paths that an area is drawn in: the disc that closes gaps, and four standard deviations of the
blur."""
SPREAD_QUANTILE = 0.75
"""Quantile of the distances of the samples from their median, over all times, that is the spread of a fan."""
MIN_TRAVEL = 0.01
"""m; a ball that travels less in every sample has no fan."""


@dataclass(frozen=True, slots=True)
class PredictionFan:
    """Predicted paths of one ball, drawn over its observed path."""

    name: str
    observed_path: FloatArray
    """(n, 2) m, until the moment of the prediction."""
    samples: FloatArray
    """(M, T, 2) m, posterior samples of the path; NaN once potted."""
    outlyingness: FloatArray
    """(M,) share of the samples that are more central than this one."""
    later_path: FloatArray
    """(m, 2) m, observed positions after the prediction; empty if there are none."""

    @property
    def medoid_path(self) -> FloatArray:
        """Return the sample (T, 2) m nearest to all others, a feasible path, unlike a mean over rebounds.

        The medoid by mean distance (Kaufman and Rousseeuw, 1987); a potted ball counts at its last position.
        """
        if not self.samples.size:
            return np.empty((0, 2))
        is_potted = np.isnan(self.samples[..., 0])
        last_finite = np.maximum.accumulate(np.where(is_potted, 0, np.arange(is_potted.shape[1])), axis=1)
        positions = np.take_along_axis(self.samples, last_finite[..., None], axis=1)
        points = positions[..., 0] + 1j * positions[..., 1]
        distances, added, before = np.zeros(len(points)), np.zeros(len(points)), None
        for row in points.T[::2]:  # one moment at a time: all pairs at all moments take gigabytes
            if before is None or not np.array_equal(row, before):
                added = np.nan_to_num(np.abs(row[:, None] - row)).sum(axis=1)
            distances += added
            before = row
        medoid: FloatArray = self.samples[int(np.argmin(distances))]
        return medoid


def draw_prediction_fans(table: Table, fans: Sequence[PredictionFan], title: str) -> ImageArray:
    """Draw the predicted paths of several balls on an empty table.

    Args:
        table: Table to draw.
        fans: Predicted paths of each ball.
        title: Title below the table.

    Returns:
        Image (h, w, 3): areas that hold 90 and 50 % of the samples are shaded, the medoid is a light line, and later
        observations are dots.
    """

    def draw_fans(inset: TableInset, colours: Sequence[Colour]) -> None:
        for fan, colour in zip(fans, colours, strict=True):
            _shade_samples(inset, fan, colour)
        for fan, colour in zip(fans, colours, strict=True):
            _draw_path_line(inset, fan.medoid_path, mix_colours(colour, WHITE, 0.6))
            for place in fan.later_path[np.isfinite(fan.later_path).all(axis=1)]:
                cv2.circle(
                    inset.canvas,
                    inset.to_fixed_point(place).tolist(),
                    2 * SUPERSAMPLE << SHIFT,
                    INK,
                    -1,
                    cv2.LINE_AA,
                    SHIFT,
                )

    return draw_table_plan(
        table, [fan.name for fan in fans], [fan.observed_path for fan in fans], np.empty((0, 2)), title, draw_fans
    )


def draw_changed_shot(table: Table, fans: Sequence[PredictionFan], title: str) -> ImageArray:
    """Draw a shot that is played otherwise over the real one.

    Args:
        table: Table to draw.
        fans: Plays of each ball, over its real path.
        title: Title below the table.

    Returns:
        Image (h, w, 3): areas that hold 90 and 50 % of the plays are shaded, the medoid is the path of the ball, and
        the real path is a thin light line.
    """

    def draw_fans(inset: TableInset, colours: Sequence[Colour]) -> None:
        for fan, colour in zip(fans, colours, strict=True):
            _shade_samples(inset, fan, colour)
        for fan, colour in zip(fans, colours, strict=True):
            _draw_path_line(inset, fan.observed_path, mix_colours(colour, WHITE, 0.6))

    paths = [fan.medoid_path for fan in fans]
    return draw_table_plan(table, [fan.name for fan in fans], paths, np.empty((0, 2)), title, draw_fans)


def _shade_samples(inset: TableInset, fan: PredictionFan, colour: Colour) -> None:
    """Shade the areas that hold the most central samples of a fan."""
    positions = np.where(np.isfinite(fan.samples), fan.samples, fan.samples[:, :1])
    travel = float(np.ptp(positions, axis=1).max(initial=0.0)) if positions.size else 0.0
    if travel < MIN_TRAVEL:
        return
    scale = float(np.linalg.norm(inset.table_to_canvas[:, 0]))
    away = np.linalg.norm(positions - np.median(positions, axis=0), axis=2)
    # Samples that agree leave no gaps; a wider disc would fill the corners of their path.
    radius = float(np.clip(np.quantile(away, SPREAD_QUANTILE) * scale, STROKE_PX, inset.ball_radius))
    for share, strength in SHADED_SHARES:
        mask = np.zeros(inset.canvas.shape[:2], np.uint8)
        for sample in fan.samples[fan.outlyingness <= share]:
            line = sample[np.isfinite(sample).all(axis=1)]
            if len(line) > 1:
                cv2.polylines(mask, [inset.to_fixed_point(line).reshape(-1, 1, 2)], False, 255, STROKE_PX * SUPERSAMPLE,
                              cv2.LINE_AA, SHIFT)  # fmt: skip
        left, top, width, height = cv2.boundingRect(mask)
        margin = int(np.ceil(EDGE_MARGIN_RADII * radius))
        part = (slice(max(top - margin, 0), top + height + margin), slice(max(left - margin, 0), left + width + margin))
        cover = _close_gaps(mask[part], radius)[..., None] * strength
        ground = inset.canvas[part].astype(np.float32)
        inset.canvas[part] = np.rint(ground + (np.asarray(colour, np.float32) - ground) * cover).astype(np.uint8)


def _close_gaps(mask: ByteArray, radius: float) -> Float32Array:
    """Close the gaps between paths that are narrower than a ball, and smooth the edge.

    A morphological closing with a disc of the size of a drawn ball: where no ball fits between two paths, neither the
    gap nor the notch says anything about where it goes.

    Args:
        mask: (h, w) 255 on a path.
        radius: px, of the disc: that of a drawn ball, or less.

    Returns:
        (h, w) share of each pixel that belongs to the area.
    """
    from skimage.morphology import isotropic_closing  # slow to import

    half = cv2.resize(mask, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)  # the blur hides the lost detail
    is_path = half >= 128
    area = (isotropic_closing(is_path, radius / 2) | is_path).astype(np.float32)
    smooth = cv2.resize(cv2.GaussianBlur(area, (0, 0), EDGE_RADII * radius / 2), mask.shape[::-1])
    return np.asarray(np.clip(EDGE_CONTRAST * (smooth - 0.5) + 0.5, 0, 1), np.float32)


def _draw_path_line(inset: TableInset, path: FloatArray, colour: Colour) -> None:
    """Draw the finite points of a path (n, 2) m as a thin line."""
    line = path[np.isfinite(path).all(axis=1)]
    if len(line) > 1:
        cv2.polylines(
            inset.canvas, [inset.to_fixed_point(line).reshape(-1, 1, 2)], False, colour, SUPERSAMPLE, cv2.LINE_AA, SHIFT
        )
