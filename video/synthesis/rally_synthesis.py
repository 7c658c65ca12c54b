"""Frames between the frames of a rally: its object where the flights put it, all else by optical flow or as filmed."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Self

import cv2
import numpy as np

from models.core.rally import Rally
from models.core.scene import apply_homography
from models.core.srgb import LUMA_601
from models.core.typing import BoolArray, ByteArray, Float32Array, FloatArray, ImageArray
from models.estimation.rally.rally_views import evaluate_rally
from video.drawing.masks import blend_colours, blend_levels
from video.flow.moving_regions import MovingRegion, find_moving_regions
from video.flow.optical_flow import smooth_step
from video.io.clip import Clip, read_frames
from video.io.yuv_frame import Canvas, YuvFrame, convert_colours

# Frames on either side of a frame that may show what its object hides; the nearest ones come first.
REACH = 3
NEIGHBOURS = tuple(sign * step for step in range(1, REACH + 1) for sign in (-1, 1))
# Radii of the object, and px, around its streak that are replaced: compression spreads it over a block's edge.
ERASED_RADII, ERASED_PX = 1.5, 3.0
# px around that by which frames are compared, and over which the replacement fades.
RING_PX, FADE_PX = 5.0, 3
# Levels by which the ring around the object may differ in the frame that replaces it; else the place is inpainted.
MAX_RING_DIFFERENCE = 14.0
# Levels, and multiple of the mean difference in the ring, that noise and compression make; and how many times more the
# object differs from its background at least.
NOISE_LEVELS, NOISE_FACTOR, MIN_CONTRAST = 2.0, 1.5, 2.0
# Luma of a bright object where nothing shines through it, and the largest factor by which a streak is fainter.
FULL_LEVEL, MAX_DILUTION = 220.0, 8.0
# Shares of the size of a player by which the box around is widened: arms and rackets move beyond it.
PLAYER_MARGIN = (0.45, 0.3)
# Share of the frame that a box of a player fills at most.
MAX_PLAYER_SHARE = 0.25
# Frames before and after a gap whose players count: some frames miss one who stands still.
PLAYER_ROWS = 5
# px by which the corners may move from a frame to the next under a camera that counts as still.
STILL_PX = 0.1
# Radii by which the path of an object that no flight explains may bend within three frames; else it is no object.
MAX_BEND_RADII = 2.5
# Side of the cells in which frames of a moving camera are compared, px; levels by which what keeps its place in the
# image differs after the camera's turn is undone, and the share of that by which it differs before at most.
GRAPHICS_CELL_PX, GRAPHICS_LEVELS, GRAPHICS_SHARE = 4, 10.0, 0.35
# px, least radius of what is seen of an object.
MIN_RADIUS_PX = 1.5


@dataclass(frozen=True, slots=True)
class RallyTimeline:
    """Where the object of a rally is in the image at any time."""

    rally: Rally
    centre: FloatArray
    """(T, 2) px in each frame, from the flights where they cover it; NaN where it is unknown."""
    swept: FloatArray
    """(T, 3, 2) px, half a frame before, at, and half a frame after each frame: no streak reaches farther."""
    radius: FloatArray
    """(T,) px, apparent radius of the object; that above the court where its place is unknown."""
    filmed: FloatArray
    """(T, 2) px where the frame shows the object on a flight or, without one, on a smooth path; NaN elsewhere."""

    def locate_times(self, t: FloatArray) -> tuple[np.ndarray, FloatArray]:
        """Return the rows of the last frames at or before times (...), and the elapsed shares of the gaps."""
        own = self.rally.t
        rows = np.clip(np.searchsorted(own, np.asarray(t), side="right") - 1, 0, max(len(own) - 2, 0))
        return rows, np.clip((t - own[rows]) / (own[rows + 1] - own[rows]), 0.0, 1.0)

    def project(self, xyz: FloatArray, t: FloatArray | float) -> FloatArray:
        """Project places (..., 3), m, to pixels (..., 2) of the image at times that are broadcast against the places.

        Between two frames a moving camera turns evenly, which is exact to a small part of its turn.
        """
        camera, frame = self.rally.scene.camera, self.rally.frame
        if camera.motion is None:
            return camera.to_pixels(xyz)
        rows, share = self.locate_times(np.asarray(t, np.float64))
        before, after = (camera.to_pixels(xyz, frame[row]) for row in (rows, rows + 1))
        return np.asarray(before + np.asarray(share)[..., None] * (after - before))

    def find_places(self, t: FloatArray, frame_t: float | None = None) -> FloatArray:
        """Find where the object is at times (K,): (K, 2) px; NaN where neither a flight nor two frames show it.

        The pixels are those of the image at each time, or all of the image at `frame_t`, s.
        """
        places = self.project(evaluate_rally(self.rally, t).xyz, t if frame_t is None else frame_t)
        rows, share = self.locate_times(t)
        between = self.filmed[rows] + share[:, None] * (self.filmed[rows + 1] - self.filmed[rows])
        between = np.where(share[:, None] == 1, self.filmed[rows + 1], between)
        return np.where(np.isfinite(places), places, np.where(share[:, None] == 0, self.filmed[rows], between))

    def camera_step(self, first: int, second: int) -> FloatArray | None:
        """Return the homography (3, 3) from pixels of one row's frame to another's; None where nothing moves."""
        camera = self.rally.scene.camera
        motion = camera.motion_of(self.rally.frame[[first, second]])
        if motion is None:
            return None
        step = motion[1] @ np.linalg.inv(motion[0])
        corners = np.array([[0, 0, 1], [camera.width_px, 0, 1], [0, camera.height_px, 1]], np.float64).T
        moved = step @ corners
        is_still = np.abs(moved[:2] / moved[2] - corners[:2]).max() < STILL_PX
        return None if is_still else np.asarray(step / step[2, 2])


def build_rally_timeline(rally: Rally) -> RallyTimeline:
    """Find where the object of a rally is in every frame, and how large it looks."""
    sport, camera = rally.scene.sport, rally.scene.camera
    xyz = evaluate_rally(rally, rally.t).xyz
    flies = np.isfinite(xyz[:, 0])
    away = np.where(flies[:, None], xyz, [sport.length / 2, sport.width / 2, 1.0]) - camera.centre
    radius = np.exp(camera.parameters[6]) * sport.object.radius / np.linalg.norm(away, axis=1)
    radius = np.maximum(radius, MIN_RADIUS_PX)
    bend = np.full(len(rally.t), np.inf)
    bend[1:-1] = np.nan_to_num(np.linalg.norm(np.diff(rally.px, n=2, axis=0), axis=1), nan=np.inf)
    is_smooth = bend < MAX_BEND_RADII * radius
    filmed = np.where((rally.is_used | (~flies & is_smooth))[:, None], rally.px, np.nan)
    none, half = np.full((len(rally.t), 3, 2), np.nan), np.median(np.diff(rally.t)) / 2
    timeline = RallyTimeline(rally, none[:, 0], none, radius, filmed)
    centre, *ends = (timeline.find_places(rally.t + off) for off in (0.0, -half, half))
    swept = np.stack([ends[0], centre, ends[1]], axis=1)
    return replace(timeline, centre=centre, swept=np.where(np.isfinite(swept), swept, centre[:, None]))


@dataclass(frozen=True, slots=True)
class ObjectSprite:
    """What one frame shows of the object."""

    rgba: Float32Array
    """(h, w, 4) colours times coverage, and coverage from 0 to 1."""
    middle: FloatArray
    """(2,) px of the sprite, where the flight puts the object in that frame."""


@dataclass(frozen=True, slots=True)
class RallyFrame:
    """A decoded frame, separated into the object and the rest."""

    row: int
    t: float
    image: ImageArray
    planes: YuvFrame
    """As decoded."""
    background: ImageArray
    """(H, W, 3) without the object."""
    background_planes: YuvFrame
    sprite: ObjectSprite | None
    """None where the object was not seen."""

    @classmethod
    def separate(cls, timeline: RallyTimeline, row: int, images: dict[int, ImageArray]) -> Self:
        """Separate the frame of a row; `images` holds those around it by their rows."""
        image, t = images[row], float(timeline.rally.t[row])
        planes = YuvFrame.from_rgb(image)
        erased = _erase_object(timeline, row, images) if np.isfinite(timeline.filmed[row]).all() else None
        if erased is None:
            return cls(row, t, image, planes, image, planes, None)
        patch, (x, y), sprite = erased
        background, clean = image.copy(), planes.mix(planes, 0.0)
        height, width = patch.shape[:2]
        background[y : y + height, x : x + width] = patch
        clean.paste(patch, x, y)
        return cls(row, t, image, planes, background, clean, sprite)


def _erase_object(
    timeline: RallyTimeline, row: int, images: dict[int, ImageArray]
) -> tuple[ImageArray, tuple[int, int], ObjectSprite | None] | None:
    """Return a patch without the object, its corner (x, y), which is even, and the object; None outside the image."""
    image, centre = images[row], timeline.filmed[row]
    half_streak = np.nan_to_num(timeline.rally.streak[row]) / 2
    reach = ERASED_RADII * float(timeline.radius[row]) + ERASED_PX
    streak = np.stack([centre - half_streak, centre + half_streak])
    path = np.concatenate([timeline.swept[row] + centre - timeline.centre[row], streak])
    margin = reach + RING_PX + 2
    low = np.maximum(path.min(axis=0) - margin, 0)
    high = np.minimum(path.max(axis=0) + margin, image.shape[1::-1])
    x0, y0, x1, y1 = (int(side) // 2 * 2 for side in (*low, *high))
    if x1 - x0 < 4 or y1 - y0 < 4:
        return None
    box = (x0, y0, x1, y1)
    near, far = _distance_to_line(box, streak), _distance_to_line(box, path[:3])
    patch = image[y0:y1, x0:x1].astype(np.float32)
    ring = (np.minimum(near, far) > reach) & (np.minimum(near, far) < reach + RING_PX)
    swept = float(np.ptp(path, axis=0).max()) / 2 + reach
    ground, noise = _fill_patch(timeline, row, images, (x0, y0), patch, near < reach, ring, swept)
    difference = np.abs(patch - ground).max(axis=-1)
    changed = ((difference > 2 * noise) & (far < reach)) | (near < reach)
    _, labels = cv2.connectedComponents(changed.astype(np.uint8))
    own = np.isin(labels, np.unique(labels[near < reach])) & changed
    inside = cv2.blur(cv2.dilate(own.astype(np.float32), np.ones((3, 3))), (FADE_PX, FADE_PX))[..., None]
    clean = np.clip(np.rint(ground * inside + patch * (1 - inside)), 0, 255).astype(np.uint8)
    core = near < reach - ERASED_PX
    return clean, (x0, y0), _extract_sprite(patch, clean, core, noise, timeline.centre[row] - [x0, y0])


def _distance_to_line(box: tuple[int, int, int, int], line: FloatArray) -> FloatArray:
    """Return the distance (h, w) px of the pixels of a box from a line through points (n, 2) px."""
    x0, y0, x1, y1 = box
    px = np.stack(np.meshgrid(np.arange(x0, x1), np.arange(y0, y1)), axis=-1)
    least = np.full(px.shape[:2], np.inf)
    for start, end in pairwise(line):
        way, off = end - start, px - start
        along = np.clip(off @ way / max(float(way @ way), 1e-9), 0, 1)
        least = np.minimum(least, np.linalg.norm(off - along[..., None] * way, axis=-1))
    return least


def _fill_patch(
    timeline: RallyTimeline, row: int, images: dict[int, ImageArray], corner: tuple[int, int], patch: Float32Array,
    hole: BoolArray, ring: BoolArray, reach: float,
) -> tuple[Float32Array, float]:  # fmt: skip
    """Return what the object hides, (h, w, 3), from the frame whose surroundings of it are most similar, and its noise.

    Where no frame shows the place, the hole is inpainted.
    """
    rally, size = timeline.rally, patch.shape[1::-1]
    best, least = None, MAX_RING_DIFFERENCE
    for other in (row + step for step in NEIGHBOURS):
        gap = timeline.centre[other] - rally.px[row] if other in images else np.zeros(2)
        if float(np.hypot(*gap)) < reach + float(timeline.radius[row]):  # not so where the gap is NaN
            continue
        step = timeline.camera_step(row, other)
        shift = np.array([[1, 0, corner[0]], [0, 1, corner[1]], [0, 0, 1]], np.float64)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        to_other = shift if step is None else step @ shift
        here = cv2.warpPerspective(images[other], to_other, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        difference = patch - here
        light = np.median(difference[ring], axis=0)
        cost = float(np.abs(difference[ring] - light).mean())
        if cost < least:
            best, least = here + light.astype(np.float32), cost
    if best is None:
        filled = cv2.inpaint(patch.astype(np.uint8), hole.astype(np.uint8), 3, cv2.INPAINT_TELEA)
        best, least = filled.astype(np.float32), NOISE_LEVELS
    return best, NOISE_LEVELS + NOISE_FACTOR * least


def _extract_sprite(
    patch: Float32Array, ground: ImageArray, core: BoolArray, noise: float, middle: FloatArray
) -> ObjectSprite | None:
    """Extract the object by its difference from the background; None where it does not differ.

    At its own place, the sprite on the background is the frame itself, whatever its coverage: that only says how much
    of another background shines through.
    """
    change = patch - ground
    difference = np.abs(change).max(axis=-1)
    contrast = float(np.percentile(difference[core], 80)) if core.any() else 0.0
    if contrast < MIN_CONTRAST * noise or not np.isfinite(middle).all():
        return None
    brightest = core & (difference >= contrast)
    step, behind = (float(part[brightest].mean(axis=0) @ LUMA_601) for part in (change, ground))
    room = (FULL_LEVEL - behind if step > 0 else behind) / max(abs(step), 1e-3)
    dilution = float(np.clip(room, 1.0, MAX_DILUTION))
    share = np.clip((difference - noise / 2) / (contrast - noise / 2), 0, 1)
    cover = (share / dilution).astype(np.float32)[..., None]
    return ObjectSprite(np.concatenate([np.clip(patch - (1 - cover) * ground, 0, None), cover], axis=-1), middle)


def draw_sprites(image: Canvas, sprites: list[tuple[ObjectSprite, float]], centre: FloatArray) -> None:
    """Draw the weighted mean of sprites at a centre (2,) px, in place."""
    if not sprites or not np.isfinite(centre).all():
        return
    sizes = [np.array(sprite.rgba.shape[1::-1]) for sprite, _ in sprites]
    before = np.ceil(np.max([sprite.middle for sprite, _ in sprites], axis=0)) + 2
    after = (
        np.ceil(np.max([size - sprite.middle for size, (sprite, _) in zip(sizes, sprites, strict=True)], axis=0)) + 2
    )
    corner = np.floor(centre) - before
    width, height = (int(side) for side in before + after)
    total = np.zeros((height, width, 4), np.float32)
    for sprite, weight in sprites:
        shift = np.column_stack([np.eye(2), centre - corner - sprite.middle])
        total += np.float32(weight) * cv2.warpAffine(sprite.rgba, shift, (width, height), flags=cv2.INTER_CUBIC)
    cover = np.clip(total[..., 3], 0, 1)
    colours = np.clip(np.rint(total[..., :3] / np.maximum(total[..., 3:], 1e-3)), 0, 255).astype(np.uint8)
    blend_colours(image, colours, np.rint(255 * cover).astype(np.uint8), int(corner[0]), int(corner[1]))


@dataclass(frozen=True, slots=True)
class RallyInterval:
    """Two neighbouring frames of a rally, and what moves between them."""

    first: RallyFrame
    second: RallyFrame
    step: FloatArray | None
    """(3, 3) from pixels of the first frame to the second; None for a camera at rest."""
    regions: tuple[tuple[MovingRegion, ByteArray], ...]
    """Where players move, in pixels of the first frame, with levels instead of colours; and the coverage."""
    graphics: tuple[tuple[ImageArray, ByteArray, int, int], ...]
    """Levels, coverage and corner of what keeps its place in the image under a moving camera, as a score does."""
    hit_share: float
    """Elapsed share of the gap at which the object is hit or bounces; NaN where it is not."""

    def synthesize(self, share: float, centre: FloatArray) -> YuvFrame:
        """Synthesize the frame at a share of the gap, above 0 and below 1, with the object at a centre (2,) px."""
        weight = smooth_step(share)
        to_here = None if self.step is None else (1 - share) * np.eye(3) + share * self.step
        if self.step is None or to_here is None:
            frame = self.first.background_planes.mix(self.second.background_planes, weight)
        else:
            from_second = to_here @ np.linalg.inv(self.step)
            sides = ((self.first, to_here, 1 - weight), (self.second, from_second, weight))
            warped = [_warp_planes(side.background_planes, step) for side, step, part in sides if part > 0]
            frame = warped[0] if len(warped) == 1 else warped[0].mix(warped[1], weight)
        for region, cover in self.regions:
            x0, y0, x1, y1 = region.box
            moved = np.zeros(2)
            if to_here is not None:  # within the small box, the camera's turn is a shift
                middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
                moved = apply_homography(to_here, middle) - middle
            whole = np.floor(moved)
            patch = region.flow.interpolate(share, moved - whole)
            blend_levels(frame, patch, cover, x0 + int(whole[0]), y0 + int(whole[1]))
        for levels, cover, x, y in self.graphics:
            blend_levels(frame, levels, cover, x, y)
        draw_sprites(frame, self._weigh_sprites(share), centre)
        return frame

    def _weigh_sprites(self, share: float) -> list[tuple[ObjectSprite, float]]:
        """Return the sprites of both frames with weights; across a hit, only the one of its own side."""
        pair = ((self.first.sprite, 1 - share), (self.second.sprite, share))
        own = pair[int(share >= self.hit_share)][0] if np.isfinite(self.hit_share) else None
        if own is not None:
            return [(own, 1.0)]
        return [(sprite, weight) for sprite, weight in pair if sprite is not None]


def _warp_planes(frame: YuvFrame, step: FloatArray) -> YuvFrame:
    """Warp a frame by a homography (3, 3) of its pixels."""
    to_half = np.array([[0.5, 0, -0.25], [0, 0.5, -0.25], [0, 0, 1]])
    halves = to_half @ step @ np.linalg.inv(to_half)
    bright, blue, red = (
        cv2.warpPerspective(plane, by, plane.shape[::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for plane, by in zip(frame.planes, (step, halves, halves), strict=True)
    )
    return YuvFrame((bright, blue, red))


def prepare_rally_interval(timeline: RallyTimeline, first: RallyFrame, second: RallyFrame) -> RallyInterval:
    """Prepare the synthesis of frames between two neighbouring ones."""
    step = timeline.camera_step(first.row, second.row)
    after, within, graphics = second.background, find_play_mask(timeline, first.row), []
    if step is not None:
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        after = cv2.warpPerspective(after, step, after.shape[1::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
        moves, stays = _compare_with_camera(first.background, second.background, after)
        within &= moves
        graphics = _cut_out(first.background, stays)
    regions = []
    for region in find_moving_regions(first.background, after, step is None, within):
        one, two = (convert_colours(image) for image in region.flow.images)
        levels = replace(region, flow=replace(region.flow, images=(one, two), is_wide=True))  # half the cost of both
        regions.append((levels, np.asarray(255 * region.weight, np.uint8)))
    turns = [event.t for event in timeline.rally.events if first.t < event.t <= second.t]
    share = (turns[0] - first.t) / (second.t - first.t) if turns else np.nan
    return RallyInterval(first, second, step, tuple(regions), tuple(graphics), share)


def _compare_with_camera(first: ImageArray, second: ImageArray, after: ImageArray) -> tuple[BoolArray, BoolArray]:
    """Find the pixels (H, W) in which something moves on its own, and those of what keeps its place in the image.

    `after` is the second frame in pixels of the first: it shows the hall where the first does. Edges of the hall differ
    a little, for the camera is not known to a hundredth of a pixel, but far less than without the camera's turn.
    """
    size = (first.shape[1] // GRAPHICS_CELL_PX, first.shape[0] // GRAPHICS_CELL_PX)
    one, *others = (cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (first, second, after))
    unturned, turned = (cv2.absdiff(one, other).max(axis=2).astype(np.float32) for other in others)
    stays = ((turned > GRAPHICS_LEVELS) & (unturned < GRAPHICS_SHARE * turned)).astype(np.uint8)
    stays = cv2.morphologyEx(stays, cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))  # letters and what is between them
    stays = cv2.dilate(cv2.morphologyEx(stays, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)), np.ones((3, 3), np.uint8))
    moves = ((turned > GRAPHICS_SHARE * unturned) & (stays == 0)).astype(np.uint8)
    whole = (cv2.resize(mask, first.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0 for mask in (moves, stays))
    return next(whole), next(whole)


def _cut_out(image: ImageArray, mask: BoolArray) -> list[tuple[ImageArray, ByteArray, int, int]]:
    """Cut out the connected parts of a mask (H, W): levels, coverage, and left and top, px."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    parts = []
    for k, (x, y, width, height) in enumerate(stats[1:count, :4].tolist(), start=1):
        here = np.s_[y : y + height, x : x + width]
        cover = cv2.blur(
            (labels[here] == k).astype(np.float32), (GRAPHICS_CELL_PX + 1,) * 2, borderType=cv2.BORDER_CONSTANT
        )
        parts.append((convert_colours(image[here]), np.asarray(255 * cover, np.uint8), x, y))
    return parts


def find_play_mask(timeline: RallyTimeline, row: int) -> BoolArray:
    """Find the pixels (H, W) in which players may move: around them in frames around a row, or around the court."""
    rally, camera, sport = timeline.rally, timeline.rally.scene.camera, timeline.rally.scene.sport
    mask = np.zeros((camera.height_px, camera.width_px), np.uint8)
    size = np.ptp(rally.players[:, 1:].reshape(-1, 2, 2), axis=1)
    near = size.prod(axis=1) < MAX_PLAYER_SHARE * mask.size  # a larger box encloses what a camera that turns moves
    near &= np.isin(rally.players[:, 0], rally.frame[max(row - PLAYER_ROWS, 0) : row + PLAYER_ROWS + 2])
    for left, top, right, bottom in rally.players[near, 1:]:
        x, y = PLAYER_MARGIN[0] * (right - left), PLAYER_MARGIN[1] * (bottom - top)
        low, high = np.maximum([left - x, top - y], 0).astype(int), np.array([right + x, bottom + y]).astype(int)
        mask[low[1] : high[1], low[0] : high[0]] = 1
    if not near.any():
        (behind, beside), top = sport.surroundings, sport.floor + sport.reach
        x, y = np.array([-behind, sport.length + behind]), np.array([-beside, sport.width + beside])
        volume = np.stack(np.meshgrid(x, y, [sport.floor, top]), axis=-1).reshape(-1, 3)
        px = timeline.project(volume, float(rally.t[row]))
        hull = cv2.convexHull(np.clip(px[np.isfinite(px).all(axis=1)], -1e4, 1e4).astype(np.int32))
        cv2.fillConvexPoly(mask, hull, 1)
    return mask.astype(bool)


@dataclass(frozen=True, slots=True)
class InBetweenFrame:
    """A frame of a slow motion before annotation."""

    t: float
    canvas: YuvFrame
    centre: FloatArray
    """(2,) px of the object; NaN where it is unknown."""
    is_seen: bool
    """Whether one of the two frames around shows the object."""


def synthesize_rally_frames(clip: Clip, timeline: RallyTimeline, times: FloatArray) -> Iterator[InBetweenFrame]:
    """Yield the frames at ascending times (K,), s; at the time of a decoded frame, that frame as it is."""
    rows, share = timeline.locate_times(times)
    centres = timeline.find_places(times)
    first, interval = None, None
    order = deque(zip(times.tolist(), rows.tolist(), share.tolist(), centres, strict=True))
    for second in separate_frames(clip, timeline, int(rows[0]), int(rows[-1]) + 1):
        while first is not None and order and order[0][1] == first.row:
            t, _, part, centre = order.popleft()
            is_seen = first.sprite is not None or second.sprite is not None
            if part in (0.0, 1.0):
                side = second if part else first
                yield InBetweenFrame(t, side.planes.mix(side.planes, 0.0), centre, side.sprite is not None)
                continue
            if interval is None or interval.first is not first:
                interval = prepare_rally_interval(timeline, first, second)
            yield InBetweenFrame(t, interval.synthesize(part, centre), centre, is_seen)
        first = second


def separate_frames(clip: Clip, timeline: RallyTimeline, first: int, last: int) -> Iterator[RallyFrame]:
    """Yield the separated frames of the rows from the first to the last; at most 2 `REACH` + 1 images are held."""
    low, high = max(first - REACH, 0), min(last + REACH + 1, len(timeline.rally.t))
    images: dict[int, ImageArray] = {}
    ready = zip(range(low, high), read_frames(clip, indices=timeline.rally.frame[low:high]), strict=True)
    for row in range(first, last + 1):
        while max(images, default=low - 1) < min(row + REACH, high - 1):
            at, (_, image) = next(ready)
            images[at] = image
        yield RallyFrame.separate(timeline, row, images)
        images.pop(row - REACH, None)
