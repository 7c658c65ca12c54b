"""Fans of predicted paths: where the balls of a posterior ensemble may roll, shaded on the plan of the table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from models.core.naming import Naming
from models.core.scene import Table
from models.core.typing import FloatArray, ImageArray
from video.drawing.masks import SHIFT
from video.drawing.palette import INK, WHITE, Colour, mix_colours
from video.drawing.table_plan import SUPERSAMPLE, TableInset, draw_table_plan

# Opacity of the shade where all samples pass.
MAX_SHADE = 0.8
# Power of the share of the samples in the opacity: a tenth of them is still seen.
SHADE_POWER = 0.5
# Factor by which the shade is computed smaller than the canvas: it has no detail below a ball.
SHADE_SCALE = 4
# m; a ball that travels less in every sample has no fan.
MIN_TRAVEL = 0.01


@dataclass(frozen=True, slots=True)
class PredictionFan:
    """Predicted paths of one ball, drawn over its observed path."""

    name: str
    """Id of the ball."""
    observed_path: FloatArray
    """(n, 2) m, until the moment of the prediction."""
    samples: FloatArray
    """(M, T, 2) m, posterior samples of the path; NaN once potted."""
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


def draw_prediction_fans(
    table: Table, naming: Naming, fans: Sequence[PredictionFan], title: str, is_played_otherwise: bool = False
) -> ImageArray:
    """Draw the predicted paths of several balls on an empty table.

    Args:
        table: Table to draw.
        naming: Names and looks of the balls, and how the table lies in the frame.
        fans: Predicted paths of each ball.
        title: Title below the table.
        is_played_otherwise: Whether the samples are plays of the observed shot otherwise: the thick line is their
            medoid, and the thin light one the observed path.

    Returns:
        Image (h, w, 3): the ground is shaded by the share of the samples in which the ball passes over it, the medoid
        is a light line, and later observations are dots.
    """
    thick, thin = [fan.observed_path for fan in fans], [fan.medoid_path for fan in fans]
    if is_played_otherwise:
        thick, thin = thin, thick

    def draw_fans(inset: TableInset, colours: Sequence[Colour]) -> None:
        for fan, colour in zip(fans, colours, strict=True):
            _shade_samples(inset, table, fan, colour)
        for fan, path, colour in zip(fans, thin, colours, strict=True):
            _draw_path_line(inset, path, mix_colours(colour, WHITE, 0.6))
            for place in fan.later_path[np.isfinite(fan.later_path).all(axis=1)]:
                centre = inset.to_fixed_point(place).tolist()
                cv2.circle(inset.canvas, centre, 2 * SUPERSAMPLE << SHIFT, INK, -1, cv2.LINE_AA, SHIFT)

    return draw_table_plan(table, naming, [fan.name for fan in fans], thick, np.empty((0, 2)), title, draw_fans)


def _shade_samples(inset: TableInset, table: Table, fan: PredictionFan, colour: Colour) -> None:
    """Shade the ground by the share of the samples in which the ball passes over it."""
    positions = np.where(np.isfinite(fan.samples), fan.samples, fan.samples[:, :1])
    if not positions.size or float(np.ptp(positions, axis=1).max()) < MIN_TRAVEL:
        return
    height, width = (side // SHADE_SCALE for side in inset.canvas.shape[:2])
    scale = float(np.linalg.norm(inset.table_to_canvas[:, 0])) / SHADE_SCALE
    breadth = max(round(2 * table.ball_radius * scale), 1)
    count, mask = np.zeros((height, width), np.float32), np.zeros((height, width), np.uint8)
    for sample in fan.samples:
        line = sample[np.isfinite(sample).all(axis=1)]
        if len(line) > 1:
            mask[:] = 0
            points = inset.to_fixed_point(line).reshape(-1, 1, 2) // SHADE_SCALE
            cv2.polylines(mask, [points], False, 1, breadth, cv2.LINE_8, SHIFT)
            count += mask
    size = (inset.canvas.shape[1], inset.canvas.shape[0])
    share = cv2.resize(cv2.GaussianBlur(count, (0, 0), breadth / 4), size) / len(fan.samples)
    cover = (MAX_SHADE * np.clip(share, 0, 1) ** SHADE_POWER)[..., None]
    ground = inset.canvas.astype(np.float32)
    inset.canvas[:] = np.rint(ground + (np.asarray(colour, np.float32) - ground) * cover).astype(np.uint8)


def _draw_path_line(inset: TableInset, path: FloatArray, colour: Colour) -> None:
    """Draw the finite points of a path (n, 2) m as a thin line."""
    line = path[np.isfinite(path).all(axis=1)]
    if len(line) > 1:
        cv2.polylines(
            inset.canvas, [inset.to_fixed_point(line).reshape(-1, 1, 2)], False, colour, SUPERSAMPLE, cv2.LINE_AA, SHIFT
        )
