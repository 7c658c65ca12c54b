"""Networks that measure one ball precisely: from a crop about a rough position to the offset of the true one.

One regressor measures balls at rest (`DISC`), the other motion-blur streaks (`STREAK`). They differ only in their
`OffsetRegressorKind`. Each sees its crop in all mirrored forms, and the results are averaged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from models.core.typing import ByteArray, FloatArray
from video.io.onnx_session import onnxruntime, open_measurement_session

# Zoom below which the image is first averaged over squares of whole pixels.
MIN_ZOOM = 0.7


def sample_patch(
    rgb: ByteArray, centre: FloatArray, linear: FloatArray, size: tuple[int, int], reach: float, zoom: float
) -> ByteArray:
    """Sample a patch of an image by a linear map.

    Args:
        rgb: Image (H, W, 3); its border is continued.
        centre: Px (2,) of the image at the middle of the patch.
        linear: Map (2, 2) from px of the image to px of the patch.
        size: Columns and rows of the patch.
        reach: Distance from the centre, px of the image, that the patch needs at most.
        zoom: Scale of the finer axis of `linear`, by which the averaging is chosen.

    Returns:
        The patch (rows, columns, 3).
    """
    part, shrunk, corner = _average_squares(rgb, centre, reach, zoom)
    # Px p of the image are (p + 1/2 - corner) / shrunk - 1/2 of the part.
    shift = linear @ (0.5 * shrunk - 0.5 + corner - centre)
    matrix = np.column_stack([linear * shrunk, shift + (np.array(size) - 1) / 2])
    shown = cv2.warpAffine(part, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(shown, dtype=np.uint8)


def _average_squares(
    rgb: ByteArray, centre: FloatArray, reach: float, zoom: float
) -> tuple[ByteArray, int, FloatArray]:
    """Average the part of an image within a reach over squares; the part, the side of a square and its corner."""
    squares = round(1 / zoom) if zoom < MIN_ZOOM else 1
    if squares == 1:
        return rgb, 1, np.zeros(2)
    height, width = rgb.shape[:2]
    half = int(np.ceil(reach)) + 2 * squares
    x0, y0 = (int(np.clip(c - half, 0, side - squares)) for c, side in zip(centre, (width, height), strict=True))
    across = max(min(x0 + 2 * half + 1, width) - x0, squares) // squares
    down = max(min(y0 + 2 * half + 1, height) - y0, squares) // squares
    part = rgb[y0 : y0 + down * squares, x0 : x0 + across * squares]
    small = cv2.resize(part, (across, down), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8), squares, np.array([x0, y0], dtype=np.float64)


# Rows and columns of a disc crop.
DISC_SIDE = 40
# Radius of the ball in a disc crop.
DISC_RADIUS_PX = 10.0
# Rows and columns of a streak crop.
STREAK_ROWS, STREAK_COLUMNS = 40, 80
# Radius of the ball across the streak in a streak crop.
STREAK_RADIUS_PX = 9.0
# Length shown beyond the middle of the ball at either end, ball radii; the margin across the streak follows from
# STREAK_ROWS and STREAK_RADIUS_PX.
STREAK_MARGIN_RADII = 2.2


@dataclass(frozen=True, slots=True)
class DiscCrop:
    """Placement of the crop of one ball at rest."""

    centre: FloatArray
    """(2,) px of the image at the middle of the crop."""
    radius: float
    """px of the image, of a ball there."""
    roll: float = 0.0
    """rad by which the crop is turned; detection uses 0, training crops are turned to resemble tilted cameras."""

    @property
    def axes(self) -> FloatArray:
        """Unit vectors (2, 2), rows, to the right and down of the crop."""
        cosine, sine = np.cos(self.roll), np.sin(self.roll)
        return np.array([[cosine, -sine], [sine, cosine]])

    def sample(self, rgb: ByteArray) -> ByteArray:
        """Sample the crop (DISC_SIDE, DISC_SIDE, 3) from an image (H, W, 3); its border is continued."""
        zoom = DISC_RADIUS_PX / self.radius
        return sample_patch(rgb, self.centre, zoom * self.axes, (DISC_SIDE, DISC_SIDE), DISC_SIDE / zoom, zoom)

    def offset_to(self, centre: FloatArray) -> FloatArray:
        """Offset (2,), ball radii along the axes, of a centre (2,) px; `shift` is the inverse."""
        return np.asarray(self.axes @ (centre - self.centre) / self.radius)

    def shift(self, offset: FloatArray) -> DiscCrop:
        """The crop whose centre is at an offset (2,) as of `offset_to`."""
        return DiscCrop(self.centre + self.radius * offset @ self.axes, self.radius, self.roll)


@dataclass(frozen=True, slots=True)
class StreakCrop:
    """Placement of the crop of one motion-blur streak."""

    centre: FloatArray
    """(2,) px of the image at the middle of the crop."""
    radius: float
    """px of the image, of the ball."""
    displacement: FloatArray
    """(2,) px that the ball moved during the exposure, not zero, sign unknown."""

    @property
    def axes(self) -> FloatArray:
        """Unit vectors along the streak and across it (2, 2), rows."""
        along = self.displacement / np.linalg.norm(self.displacement)
        return np.array([along, [-along[1], along[0]]])

    def sample(self, rgb: ByteArray) -> ByteArray:
        """Sample the crop (STREAK_ROWS, STREAK_COLUMNS, 3) from an image (H, W, 3); its border is continued."""
        length = float(np.linalg.norm(self.displacement))
        zoom_along = STREAK_COLUMNS / 2 / (length / 2 + STREAK_MARGIN_RADII * self.radius)
        zoom_across = STREAK_RADIUS_PX / self.radius
        linear = np.array([[zoom_along], [zoom_across]]) * self.axes
        reach = length / 2 + (STREAK_MARGIN_RADII + STREAK_ROWS / 2 / STREAK_RADIUS_PX) * self.radius
        return sample_patch(rgb, self.centre, linear, (STREAK_COLUMNS, STREAK_ROWS), reach, zoom_across)

    def offset_to(self, centre: FloatArray, displacement: FloatArray) -> FloatArray:
        """Offset (4,), ball radii, of another centre and displacement (2,) px; `shift` is the inverse.

        The shift of the centre along and across this streak, then the change of the displacement along and across it.
        """
        same_way = displacement if displacement @ self.displacement >= 0 else -displacement
        shift, change = self.axes @ (centre - self.centre), self.axes @ (same_way - self.displacement)
        return np.concatenate([shift, change]) / self.radius

    def shift(self, offset: FloatArray) -> StreakCrop:
        """The crop of the streak at an offset (4,) as of `offset_to`."""
        shift, change = self.radius * np.asarray(offset).reshape(2, 2) @ self.axes
        return StreakCrop(self.centre + shift, self.radius, self.displacement + change)


# Names of the input and the output in the ONNX files.
INPUT_NAME, OUTPUT_NAME = "shown", "told"
# A ball at rest whose first pass moves it farther than this, ball radii, gets a second pass from there.
SECOND_PASS_RADII = 0.1
# Passes over a streak; each starts from the result of the one before.
STREAK_PASSES = 2
# Displacements below this, ball radii, are not treated as streaks: they have no direction to turn the crop by.
MIN_STREAK_RADII = 0.35


@dataclass(frozen=True, slots=True)
class Mirror:
    """A reflection of the crop and its effect on the outputs."""

    axis: int
    """Axis of a stack of crops (K, rows, columns, 3) that is reversed."""
    signs: tuple[float, ...]
    """(n,) factors of the outputs."""


@dataclass(frozen=True, slots=True)
class OffsetRegressorKind:
    """Description of one kind of offset regressor."""

    name: str
    """Base name of its weight file and of its training checkpoint."""
    schema: str
    """Value of `trueroll.schema` in the metadata of its ONNX file."""
    subject: str
    """What it measures, for messages."""
    crop_content: str
    """What its crops show, for the metadata of its ONNX file."""
    rows: int
    columns: int
    outputs: tuple[str, ...]
    """Names of the n outputs, ball radii; the first two are the offset of the centre."""
    mirrors: tuple[Mirror, ...]
    """Reflections that map a crop to another possible crop."""
    widths: tuple[int, int, int]
    """Channels of the network at a half, a quarter and an eighth of the crop's sides."""

    @property
    def weight_file(self) -> Path:
        """The ONNX file that ships with the package."""
        return Path(__file__).parent / "weights" / f"{self.name}.onnx"

    @property
    def checkpoint(self) -> str:
        """File name of its training checkpoint."""
        return f"{self.name}-checkpoint.pt"

    def list_mirror_forms(self) -> list[tuple[tuple[int, ...], FloatArray]]:
        """Axes to reverse and signs (n,) of the outputs for every combination of the mirrors, the identity first."""
        forms: list[tuple[tuple[int, ...], FloatArray]] = [((), np.ones(len(self.outputs)))]
        for mirror in self.mirrors:
            forms += [((*axes, mirror.axis), signs * mirror.signs) for axes, signs in forms]
        return forms


# Centres of balls at rest, see `DiscCrop.offset_to`. Mirrored from left to right only.
DISC = OffsetRegressorKind(
    name="discs",
    schema="trueroll.discs/1",
    subject="balls at rest",
    crop_content="a ball in the middle each",
    rows=DISC_SIDE,
    columns=DISC_SIDE,
    outputs=("right", "down"),
    mirrors=(Mirror(2, (-1.0, 1.0)),),
    widths=(24, 40, 64),
)
# Centres and displacements of motion-blur streaks, see `StreakCrop.offset_to`. Mirrored along and across the streak.
STREAK = OffsetRegressorKind(
    name="streaks",
    schema="trueroll.streaks/1",
    subject="streaks",
    crop_content="straightened streaks",
    rows=STREAK_ROWS,
    columns=STREAK_COLUMNS,
    outputs=("ahead", "beside", "longer", "aside"),
    mirrors=(Mirror(2, (-1.0, 1.0, 1.0, -1.0)), Mirror(1, (1.0, -1.0, 1.0, -1.0))),
    widths=(16, 32, 64),
)


@dataclass(frozen=True, slots=True)
class OffsetRegressor:
    """An offset regressor in an ONNX file."""

    kind: OffsetRegressorKind
    session: onnxruntime.InferenceSession

    def regress_offsets(self, crops: ByteArray) -> tuple[FloatArray, FloatArray]:
        """Estimate the offsets of crops.

        Args:
            crops: RGB bytes (K, rows, columns, 3), K at least 1.

        Returns:
            Offsets (K, n) and their standard deviations (K, n), ball radii, each the mean over the mirrored forms.
        """
        forms, n = self.kind.list_mirror_forms(), len(self.kind.outputs)
        batch = np.concatenate([np.flip(crops, axes) for axes, _ in forms])
        outputs = np.asarray(self.session.run(None, {INPUT_NAME: batch})[0], dtype=np.float64)
        outputs = outputs.reshape(len(forms), len(crops), 2 * n)
        signs = np.array([signs for _, signs in forms])[:, None]  # (forms, 1, n)
        return (signs * outputs[..., :n]).mean(axis=0), np.exp(outputs[..., n:]).mean(axis=0)

    def measure_crops(
        self, rgb: ByteArray, crops: Sequence[DiscCrop] | Sequence[StreakCrop]
    ) -> tuple[FloatArray, FloatArray]:
        """Estimate the offsets (K, n) of crops of an image (H, W, 3) and their sigmas (K, n), ball radii."""
        return self.regress_offsets(np.stack([crop.sample(rgb) for crop in crops]))


@lru_cache(maxsize=4)
def open_offset_regressor(kind: OffsetRegressorKind, path: Path | None = None) -> OffsetRegressor:
    """Open an offset regressor; the one that ships with the package where no file is given.

    Args:
        kind: What it measures.
        path: Its ONNX file.

    Returns:
        The regressor.

    Raises:
        ModelError: The file holds no regressor of that kind.
    """
    return OffsetRegressor(kind, open_measurement_session(path or kind.weight_file, kind.schema, kind.subject))


def measure_discs(
    regressor: OffsetRegressor, rgb: ByteArray, centre: FloatArray, radius: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Measure the centres of balls at rest.

    Args:
        regressor: Regressor of kind `DISC`.
        rgb: Image (H, W, 3).
        centre: Rough centres (K, 2) px.
        radius: Radii (K,) px.

    Returns:
        Centres (K, 2) px, and their standard deviation per axis (K,) px.
    """
    if not len(centre):
        return centre, radius
    measured, sigma = _measure_discs_once(regressor, rgb, centre, radius)
    again = np.flatnonzero(np.linalg.norm(measured - centre, axis=1) > SECOND_PASS_RADII * radius)
    if len(again):
        measured[again], sigma[again] = _measure_discs_once(regressor, rgb, measured[again], radius[again])
    return measured, sigma


def _measure_discs_once(
    regressor: OffsetRegressor, rgb: ByteArray, centre: FloatArray, radius: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Do one pass of `measure_discs`, K at least 1."""
    crops = [DiscCrop(place, float(size)) for place, size in zip(centre, radius, strict=True)]
    offsets, sigma = regressor.measure_crops(rgb, crops)
    measured = np.array([crop.shift(offset).centre for crop, offset in zip(crops, offsets, strict=True)])
    return measured, radius * np.sqrt((sigma**2).mean(axis=1))


@dataclass(frozen=True, slots=True)
class StreakMeasurement:
    """Position of one motion-blur streak, px."""

    centre: FloatArray
    """(2,) of the ball at mid-exposure."""
    displacement: FloatArray
    """(2,) moved during the exposure, sign unknown."""
    sigma_across: float
    sigma_along: float
    """Standard deviation of the centre across and along the streak."""


def measure_streak(
    regressor: OffsetRegressor, rgb: ByteArray, centre: FloatArray, radius: float, displacement: FloatArray
) -> StreakMeasurement:
    """Measure the centre and the displacement of one motion-blur streak.

    Args:
        regressor: Regressor of kind `STREAK`.
        rgb: Image (H, W, 3).
        centre: Rough centre (2,) px.
        radius: Radius of the ball, px.
        displacement: Rough displacement during the exposure (2,) px, not zero.

    Returns:
        The streak.
    """
    crop, sigma = StreakCrop(centre, radius, displacement), np.zeros(4)
    for number in range(STREAK_PASSES):
        if number and np.linalg.norm(crop.displacement) < MIN_STREAK_RADII * radius:
            break
        offsets, sigmas = regressor.measure_crops(rgb, [crop])
        crop, sigma = crop.shift(offsets[0]), sigmas[0]
    return StreakMeasurement(crop.centre, crop.displacement, radius * float(sigma[1]), radius * float(sigma[0]))
