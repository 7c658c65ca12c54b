"""Synthesis of a frame at any time between two decoded ones, with the moving balls at their fitted positions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from models.core.srgb import LUMA_601
from models.core.trajectory import State
from models.core.typing import Float32Array, FloatArray, ImageArray
from video.flow.moving_regions import MovingRegion, find_moving_regions
from video.flow.optical_flow import compute_flow, pixel_grid, smooth_step
from video.io.clip import Clip
from video.io.yuv_frame import YuvFrame
from video.matting.background_plate import BackgroundPlate
from video.matting.ball_matting import (
    MIN_STREAK_RADII,
    BallOutline,
    MattedFrame,
    MattedSprite,
    comparison_half_width,
    matte_balls,
    sample_path,
)
from video.matting.ball_timeline import BallTimeline
from video.matting.compositing import Box, RotationWarp, SpriteLayer, composite_balls, find_changed_boxes
from video.matting.hidden_background import HiddenBackground, find_visible_balls
from video.matting.sharp_balls import SharpBalls, collect_sharp_balls, deblur_pair
from video.matting.shutter_time import estimate_shutter_time
from video.synthesis.ball_rotation import (
    BallRotation,
    compare_rotated_views,
    estimate_rotation,
    shows_other_paint,
    states_between_frames,
)

NO_SHARP_BALLS = SharpBalls({})
# Radii of motion during the shutter time up to which the markings of a ball are rotated.
MAX_ROTATION_STREAK_RADII = 1.5
# Ratio of the view differences after rotation by spin and after optical flow, which fits the views to each other, up to
# which the spin is preferred.
MAX_ROTATION_ERROR_RATIO = 1.5
# Radii by which the ends of two similar streaks may differ.
SIMILAR_STREAK_RADII = 0.4
# Largest deviation from the chroma of the own 2 x 2 block, relative to that on a shifted grid; rounding alone gives a
# tenth.
MAX_ALIGNED_SHARE = 0.3
# One of this many rows of blocks is examined.
SAMPLED_ROW_STEP = 8


@dataclass(frozen=True, slots=True)
class ClipAppearance:
    """Appearance of a whole clip, estimated before any frame is synthesized."""

    timeline: BallTimeline
    plate: BackgroundPlate
    sharp_balls: SharpBalls


def estimate_clip_appearance(background: HiddenBackground, clip: Clip) -> ClipAppearance:
    """Estimate the sharp balls and the shutter time of a clip.

    Args:
        background: Positions of the balls, and the background plate.

    Returns:
        The appearance; its timeline has the estimated shutter time.
    """
    timeline, plate = background.timeline, background.plate
    sharp_balls = collect_sharp_balls(timeline, clip, plate)
    return ClipAppearance(estimate_shutter_time(timeline, clip, plate, sharp_balls), plate, sharp_balls)


@dataclass(frozen=True, slots=True)
class MovingBall:
    """One moving ball in the two frames of a gap."""

    ball: int
    radius: float
    """px."""
    sprites: tuple[MattedSprite | None, MattedSprite | None]
    """The ball in each frame; None where it is absent."""
    sharp_sprites: tuple[MattedSprite | None, MattedSprite | None] | None
    """The deblurred ball in the light of each frame; None where neither is streaked."""
    rotation: BallRotation | MarkingFlow | None
    """Rotation of the markings."""
    is_occluded: bool = False
    """The ball is absent from one frame because another ball occludes it, so it must not fade."""

    def build_layers(self, centre: FloatArray, path: FloatArray, share: float, progress: float) -> list[SpriteLayer]:
        """Return the layers of the ball at `centre` (2,) px with a streak along `path` (P, 2) px around it.

        Args:
            centre: Position, px; NaN if unknown.
            path: Motion while the shutter is open, px relative to the centre.
            share: Elapsed share of the gap, 0 to 1.
            progress: Elapsed share of the time for which the ball moves: a resting ball keeps its look.
        """
        if not np.isfinite(centre).all():
            return []
        warps = (None, None) if self.rotation is None else self.rotation.warps_at(share)
        share = float(self.sprites[0] is None) if self.is_occluded else progress
        if self.sharp_sprites is None:
            return self._mix_sprites(self.sprites, centre[None], (1 - share, share), warps)
        path = path if np.isfinite(path).all() else np.zeros((1, 2))
        similar = [
            sprite if sprite is not None and self._is_similar_streak(sprite.path, path) else None
            for sprite in self.sprites
        ]
        if similar == [None, None]:
            return self._mix_sprites(self.sharp_sprites, centre + sample_path(path), (1 - share, share), (None, None))
        # A view with a similar streak is more accurate than any synthesized streak.
        weights = (1 - share, share)
        total_weight = sum(weight for side, weight in zip(self.sprites, weights, strict=True) if side is not None)
        similar_weight = sum(weight for sprite, weight in zip(similar, weights, strict=True) if sprite is not None)
        # The similar view is used even where its weight at this time is 0.
        weights = (
            (weights[0] * total_weight / similar_weight, weights[1] * total_weight / similar_weight)
            if similar_weight > 0
            else (total_weight, total_weight)
        )
        return self._mix_sprites((similar[0], similar[1]), centre[None], weights, warps)

    def _is_similar_streak(self, path: FloatArray, wanted: FloatArray) -> bool:
        """Return whether two streaks look the same."""
        one, other = path[-1] - path[0], wanted[-1] - wanted[0]
        return float(min(np.hypot(*(one - other)), np.hypot(*(one + other)))) < SIMILAR_STREAK_RADII * self.radius

    @staticmethod
    def _mix_sprites(
        sprites: tuple[MattedSprite | None, MattedSprite | None],
        centres: FloatArray,
        weights: tuple[float, float],
        warps: tuple[RotationWarp | None, RotationWarp | None],
    ) -> list[SpriteLayer]:
        """Return a layer per available sprite."""
        parts = zip(sprites, weights, warps, strict=True)
        return [SpriteLayer(sprite, centres, weight, turn) for sprite, weight, turn in parts if sprite is not None]


@dataclass(frozen=True, slots=True)
class FrameInterval:
    """Two neighbouring decoded frames, separated into background, balls and other moving regions."""

    timeline: BallTimeline
    row: int
    first: ImageArray
    second: ImageArray
    matted: tuple[MattedFrame, MattedFrame]
    """Both frames without their moving balls."""
    balls: tuple[MovingBall, ...]
    resting: tuple[BallOutline, ...]
    """Outlines of the balls at rest."""
    regions: tuple[MovingRegion, ...]
    """Regions in which something other than balls moves, in pixels of the first frame."""
    scratch: ImageArray
    """(H, W, 3) where boxes of the planes are drawn: new memory would cost more than what is drawn."""
    has_square_chroma: bool = False
    """Whether the frames have one colour per two by two pixels, which synthesized frames then share."""

    def synthesize(self, t: float, centres: FloatArray, paths: FloatArray | None = None) -> ImageArray:
        """Synthesize the frame at time t.

        Args:
            t: Time, s; at the time of a decoded frame the result is that frame.
            centres: Positions of the balls (N, 2), px.
            paths: Motion of the balls while the shutter is open (P, N, 2), px relative to the centres.

        Returns:
            Image (H, W, 3).
        """
        share = self._share_at(t)
        if share in (0.0, 1.0):
            return (self.first if share == 0 else self.second).copy()
        image, layers = self._blend_backgrounds(t, share), self._build_layers(t, share, centres, paths)
        boxes = self._draw_moving_parts(image, t, share, layers)
        for box in boxes if self.has_square_chroma else ():
            subsample_chroma(image, box)
        return image

    def synthesize_planes(self, t: float, centres: FloatArray, paths: FloatArray | None = None) -> YuvFrame:
        """Synthesize the same frame for the encoder; both sides of it must be even.

        Both backgrounds are converted once. Only boxes in which something moves are drawn in RGB and converted.
        """
        share, (begin, end) = self._share_at(t), self.timeline.t[self.row : self.row + 2].tolist()
        if share in (0.0, 1.0) or self.timeline.camera_step(begin, end) is not None:
            return YuvFrame.from_rgb(self.synthesize(t, centres, paths))
        layers, weight = self._build_layers(t, share, centres, paths), smooth_step(share)
        before, after = (_convert_background(side) for side in self.matted)
        frame, image = before.mix(after, weight), self.scratch
        boxes = [*find_changed_boxes(image.shape, layers), *(region.box for region in self.regions)]
        places = [np.s_[y0 // 2 * 2 : y1 + y1 % 2, x0 // 2 * 2 : x1 + x1 % 2] for x0, y0, x1, y1 in boxes]
        for here in places:
            first, second = (side.background[here] for side in self.matted)
            image[here] = cv2.addWeighted(first, 1 - weight, second, weight, 0)
        self._draw_moving_parts(image, t, share, layers)
        for here in places:
            frame.paste(image[here], here[1].start, here[0].start)
        return frame

    def _share_at(self, t: float) -> float:
        """Return the elapsed share of the gap, 0 to 1."""
        return self.timeline.locate_time(t)[1] if t < self.timeline.t[self.row + 1] else 1.0

    def _draw_moving_parts(
        self, image: ImageArray, t: float, share: float, layers: list[list[SpriteLayer]]
    ) -> list[Box]:
        """Draw all that moves onto the backgrounds, in place; return the boxes that are not resampled."""
        camera_step = self.timeline.camera_step(float(self.timeline.t[self.row]), t) if self.regions else None
        for region in self.regions:
            region.blend_onto(image, share, camera_step)
        changed = composite_balls(image, layers, self.resting)
        return changed if camera_step is not None else [*changed, *(region.box for region in self.regions)]

    def _build_layers(
        self, t: float, share: float, centres: FloatArray, paths: FloatArray | None
    ) -> list[list[SpriteLayer]]:
        """Return the layers of the moving balls; the arguments are those of `synthesize`."""
        paths = np.zeros((1, *centres.shape)) if paths is None else paths
        progress = self.timeline.motion_progress_at(t)
        return [
            ball.build_layers(centres[ball.ball], paths[:, ball.ball], share, progress[ball.ball])
            for ball in self.balls
        ]

    def _blend_backgrounds(self, t: float, share: float) -> ImageArray:
        """Return the cross-fade of both backgrounds, a new image."""
        weight = smooth_step(share)
        sides = [self._warp_background(side, t) for side in (0, 1) if weight != 1 - side]
        if len(sides) == 1:
            return sides[0].copy()
        return np.asarray(cv2.addWeighted(sides[0], 1 - weight, sides[1], weight, 0), dtype=np.uint8)

    def _warp_background(self, side: int, t: float) -> ImageArray:
        """Return one background as the moving camera sees it at time t."""
        background = self.matted[side].background
        step = self.timeline.camera_step(float(self.timeline.t[self.row + side]), t)
        return background if step is None else _warp_image(background, step)


@lru_cache(maxsize=2)
def _convert_background(frame: MattedFrame) -> YuvFrame:
    """Convert a background for the encoder. Cached: it ends one gap and begins the next."""
    return YuvFrame.from_rgb(frame.background)


def subsample_chroma(image: ImageArray, box: Box) -> None:
    """Give every 2 x 2 pixels of a box (x0, y0, x1, y1) one chroma value, in place; the luma of each pixel stays."""
    x0, y0 = (max(side, 0) // 2 * 2 for side in box[:2])
    x1, y1 = (min(-(-side // 2), whole // 2) * 2 for side, whole in zip(box[2:], image.shape[1::-1], strict=True))
    if x1 > x0 and y1 > y0:
        here = image[y0:y1, x0:x1]
        here[:] = np.rint(np.clip(_average_chroma(here), 0, 255))


def has_subsampled_chroma(image: ImageArray) -> bool:
    """Return whether an image has one chroma value for every 2 x 2 pixels."""
    height, width = (side // 2 * 2 - 2 for side in image.shape[:2])
    deviations = []
    for shift in (0, 1):
        rows = image[shift : height + shift, shift : width + shift].reshape(height // 2, 2, width, 3)
        sample = rows[::SAMPLED_ROW_STEP].reshape(-1, width, 3)
        deviations.append(float(np.abs(_average_chroma(sample) - sample).mean()))
    return deviations[0] < MAX_ALIGNED_SHARE * deviations[1]


def _average_chroma(image: ImageArray) -> Float32Array:
    """Replace the chroma of an image (h, w, 3) of even sides by that of its 2 x 2 blocks, without rounding."""
    height, width = image.shape[:2]
    levels = cv2.cvtColor(image.astype(np.float32), cv2.COLOR_RGB2YCrCb)
    halves = cv2.resize(levels, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    levels[..., 1:] = cv2.resize(halves, (width, height), interpolation=cv2.INTER_NEAREST)[..., 1:]
    return np.asarray(cv2.cvtColor(levels, cv2.COLOR_YCrCb2RGB), dtype=np.float32)


def _warp_image(image: ImageArray, step: FloatArray) -> ImageArray:
    """Warp an image (H, W, 3) by a homography (3, 3)."""
    size = (image.shape[1], image.shape[0])
    return np.asarray(cv2.warpPerspective(image, step, size, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)


def prepare_interval(
    timeline: BallTimeline,
    plate: BackgroundPlate,
    row: int,
    first: ImageArray,
    second: ImageArray,
    sharp_balls: SharpBalls = NO_SHARP_BALLS,
    *,
    force_deblur: bool = False,
    previous: FrameInterval | None = None,
) -> FrameInterval:
    """Separate two neighbouring frames into their parts, from which any frame between them is synthesized.

    Args:
        timeline: Positions of the balls.
        plate: Background plate.
        row: Row of the first frame.
        first: First frame (H, W, 3).
        second: Second frame (H, W, 3).
        sharp_balls: Sharp views of the balls.
        force_deblur: Whether to deblur all balls, for a shutter time other than that of the clip.
        previous: The interval before; its parts are reused where the same balls move.

    Returns:
        The interval.
    """
    balls = timeline.balls_to_matte(row)
    is_reusable = previous is not None and previous.row == row - 1 and timeline.balls_to_matte(row - 1) == balls
    first_matted = (
        previous.matted[1] if previous is not None and is_reusable else _matte_frame(timeline, plate, row, first, balls)
    )
    matted = (first_matted, _matte_frame(timeline, plate, row + 1, second, balls))
    state = states_between_frames(timeline, row)
    moving_balls = [
        _prepare_moving_ball(timeline, sharp_balls, row, ball, (pair[0], pair[1]), state, force_deblur)
        for ball, *pair in zip(balls, *(side.sprites for side in matted), strict=True)
    ]
    step = timeline.camera_step(float(timeline.t[row + 1]), float(timeline.t[row]))
    second_background = matted[1].background if step is None else _warp_image(matted[1].background, step)
    regions = find_moving_regions(first_matted.background, second_background, step is None)
    has_square_chroma = (previous is not None and previous.has_square_chroma) or has_subsampled_chroma(first)
    resting = tuple(
        timeline.outline(row, int(ball)) for ball in np.flatnonzero(timeline.observed[row]) if ball not in balls
    )
    return FrameInterval(
        timeline, row, first, second, matted, tuple(moving_balls), resting, regions,
        np.empty_like(first) if previous is None else previous.scratch, has_square_chroma,
    )  # fmt: skip


def _prepare_moving_ball(
    timeline: BallTimeline,
    sharp_balls: SharpBalls,
    row: int,
    ball: int,
    sprites: tuple[MattedSprite | None, MattedSprite | None],
    state: State,
    force_deblur: bool,
) -> MovingBall:
    """Prepare a ball: deblur it where it is streaked, and estimate its rotation."""
    radius = float(np.nanmean(timeline.radius[row : row + 2, ball]))
    longest = max((sprite.streak_length for sprite in sprites if sprite is not None), default=0.0)
    first, second = sprites
    spin: BallRotation | None = None
    pair = None if first is None or second is None else (first, second)
    if pair is not None and not shows_other_paint(pair, radius):
        pair = None
    if pair is not None and longest < MAX_ROTATION_STREAK_RADII * radius:
        spin = estimate_rotation(timeline, row, ball, state, pair, radius)
    if force_deblur or longest > MIN_STREAK_RADII * radius:
        t = float(timeline.t[row])
        return MovingBall(ball, radius, sprites, deblur_pair(sharp_balls, ball, t, radius, sprites), spin)
    turn = None if pair is None else _select_rotation(spin, *pair, radius)
    return MovingBall(ball, radius, sprites, None, turn, _is_occluded(timeline, row, ball, sprites))


def _select_rotation(
    spin: BallRotation | None, first: MattedSprite, second: MattedSprite, radius: float
) -> BallRotation | MarkingFlow | None:
    """Select the rotation by spin, unless optical flow makes the two views far more similar."""
    flow = estimate_marking_flow(first, second, radius)
    if spin is None or flow is None:
        return flow if spin is None else spin
    spin_difference, flow_difference = (
        compare_rotated_views((first, second), radius, candidate.warps_at(0.5)) for candidate in (spin, flow)
    )
    return spin if spin_difference < MAX_ROTATION_ERROR_RATIO * flow_difference else flow


def _is_occluded(
    timeline: BallTimeline, row: int, ball: int, sprites: tuple[MattedSprite | None, MattedSprite | None]
) -> bool:
    """Return whether a ball is absent from one frame and another ball is in front of it there."""
    if (sprites[0] is None) == (sprites[1] is None):
        return False
    side = row + int(sprites[1] is None)
    away = timeline.centre[side] - timeline.centre[side, ball]
    near = np.hypot(away[:, 0], away[:, 1]) < 1.2 * timeline.radius[side]
    near[ball] = False
    return bool((near & (away[:, 1] > 0) & timeline.observed[side]).any())


def _matte_frame(
    timeline: BallTimeline, plate: BackgroundPlate, row: int, image: ImageArray, balls: tuple[int, ...]
) -> MattedFrame:
    """Separate those of `balls` that are visible from a frame."""
    is_visible = find_visible_balls(timeline, plate, row, image)
    visible = [ball for ball in balls if is_visible[ball]]
    if not visible:
        return MattedFrame(image, (None,) * len(balls))
    others = [timeline.outline(row, int(ball)) for ball in np.flatnonzero(is_visible) if ball not in visible]
    motion = timeline.camera_motion_at(float(timeline.t[row]))
    matted = matte_balls(image, [timeline.outline(row, ball) for ball in visible], others, plate, motion)
    sprites = dict(zip(visible, matted.sprites, strict=True))
    return MattedFrame(matted.background, tuple(sprites.get(ball) for ball in balls))


# px to which small balls are magnified before the flow is computed, and largest magnification: its patches are 8 px
# wide.
MIN_VIEW_SIDE, MAX_MAGNIFICATION = 96, 4.0
# Share of the difference between two views that an accepted flow may leave.
MAX_DIFFERENCE_SHARE = 0.9
# Radii by which a dot may move between two views; farther dots are not identifiable.
MAX_FLOW_RADII = 0.8
# Radii around its centre within which a ball must be visible for a flow to be measured.
VISIBLE_RADII = 0.8
# Radii over which the flow on a ball is averaged.
SMOOTHING_RADII = 0.12
# Map from RGBA to brightness times alpha, and alpha.
TO_GREY = np.array([[*LUMA_601, 0.0], [0.0, 0.0, 0.0, 1.0]], dtype=np.float32)


@dataclass(frozen=True, slots=True)
class MarkingFlow:
    """Flow of the markings of a ball from one view to the next, and back."""

    forward: Float32Array
    """(g, g, 2) px, centred on the ball."""
    backward: Float32Array
    """(g, g, 2) px."""

    def warps_at(self, share: float) -> tuple[RotationWarp, RotationWarp]:
        """Return the warps of the view before and of the view after to a share of the gap, 0 to 1."""
        return RotationWarp(np.float32(share) * self.forward), RotationWarp(np.float32(1 - share) * self.backward)


def estimate_marking_flow(first: MattedSprite, second: MattedSprite, radius: float) -> MarkingFlow | None:
    """Estimate the flow of the markings of a ball from the first view to the second.

    None where the flow explains nothing: plain, blurred or occluded balls.
    """
    half = comparison_half_width(radius)
    magnification = float(np.clip(MIN_VIEW_SIDE / (2 * half + 1), 1.0, MAX_MAGNIFICATION))
    if not all(_is_fully_visible(sprite, half, radius) for sprite in (first, second)):
        return None
    views = [_magnify_view(sprite, half, magnification) for sprite in (first, second)]
    flows = []
    for a, b in (views, views[::-1]):
        flow = compute_flow(a, b)
        if not _reduces_difference(flow, a, b):
            return None
        flows.append(_shrink_flow(flow, half, magnification, radius))
    return MarkingFlow(flows[0], flows[1])


@lru_cache(maxsize=64)
def _magnify_view(sprite: MattedSprite, half: int, magnification: float) -> ImageArray:
    """Return a magnified grey view (n, n) of the ball on a background of its own mean brightness, which has no edge.

    Cached and read-only: a view is used for the gap before it and for the gap after it.
    """
    grey, mask = cv2.split(sprite.patch_around_centre(cv2.transform(sprite.rgba, TO_GREY), half, magnification))
    mask = np.clip(mask, 0, 1)
    mean = cv2.sumElems(grey)[0] / max(cv2.sumElems(mask)[0], 1.0)
    return np.asarray(cv2.add(grey, np.float32(mean) * (1 - mask), dtype=cv2.CV_8U), dtype=np.uint8)


def _is_fully_visible(sprite: MattedSprite, half: int, radius: float) -> bool:
    """Return whether the ball except its rim is visible, neither occluded by another ball nor cut by the border."""
    centre, within = sprite.centre_in_rgba, VISIBLE_RADII * radius
    rows, columns = sprite.visibility.shape
    inside = min(centre) >= within and centre[0] + within <= columns - 1 and centre[1] + within <= rows - 1
    if inside and sprite.occlusion is None:
        return True
    visibility = sprite.patch_around_centre(sprite.visibility, half)
    place = np.arange(2 * half + 1) - half
    return bool(visibility[np.hypot(place[None], place[:, None]) < within].min() >= 0.5)


def _reduces_difference(flow: Float32Array, first: ImageArray, second: ImageArray) -> bool:
    """Return whether sampling the second image along the flow makes it similar to the first."""
    side = first.shape[0]
    warped = cv2.remap(second, pixel_grid(side, side) + flow, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    left, before = (cv2.norm(first, other, cv2.NORM_L2SQR) for other in (warped, second))
    return bool(left < MAX_DIFFERENCE_SHARE * before)


def _shrink_flow(flow: Float32Array, half: int, magnification: float, radius: float) -> Float32Array:
    """Reduce a flow to the original size, smooth it, limit its length and fade it out at the rim."""
    side = 2 * half + 1
    small = cv2.resize(flow, (side, side), interpolation=cv2.INTER_AREA) / np.float32(magnification)
    smooth = cv2.GaussianBlur(small, (0, 0), max(SMOOTHING_RADII * radius, 0.5))
    length = cv2.magnitude(*cv2.split(smooth))
    place = np.arange(side, dtype=np.float32) - half
    rim = np.clip(2 - np.hypot(place[None], place[:, None]) / (0.6 * radius), 0, 1)
    damping = np.minimum(1, MAX_FLOW_RADII * radius / np.maximum(length, 1e-6)) * rim
    return np.asarray(smooth * damping[..., None], dtype=np.float32)
