"""Samples of the flying-object network with their truth, from random films and from rendered rallies."""

from __future__ import annotations

import os
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from detectors.flying.frame_windows import (
    FrameWindow,
    PlaneImage,
    align_window,
    choose_lags,
    find_shifts,
    neighbours_of,
    reduce_image,
    soften_image,
)
from detectors.flying.motion_spots import find_window_spots
from detectors.flying.object_size import choose_scale, outline_of_play
from detectors.flying.spot_patches import LAYERS, PATCH_PX, cut_patches
from detectors.training.flying_scenes import FlyingFilm, draw_film
from models.core.court_camera import CourtScene
from models.core.typing import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from models.sports.sport_catalogue import find_sports
from video.rendering.rally_clips import RallyClip, generate_rally_clips, is_object_visible, simulate_rallies

# Films in a file, and by how many of their frames near and far neighbours are away.
FILMS_PER_FILE, FILM_LAGS = 60, (1, 4)
# Spots of a frame without the object that become samples of a training.
NEGATIVES_PER_FRAME = 12
# Share of the object that must be seen, and px by which a spot may be beside it and still be its own.
LEAST_VISIBLE, OWN_PX = 0.4, 4.0
# px beside the streak up to which a spot is neither the object nor something else, and those along each axis of the
# image from which the reduced layers of a patch show the whole of most streaks.
UNCLEAR_PX, LARGEST_OFF_PX = 9.0, 26.0
# Rallies and clips of each sport in a file of rallies, s of a clip, and further objects in a training clip.
RALLIES, CLIPS, CLIP_S, OTHERS = 4, 4, 0.8, 9
# Offsets of the seeds of files that train, and of those that check.
TRAINING_SEED, HOLD_OUT_SEED = 8_100_000, 9_100_000


@dataclass(frozen=True, slots=True)
class FlyingShard:
    """N spots."""

    patches: ByteArray
    """(N, 16, 32, 32) as in `cut_patches`."""
    truth: Float32Array
    """(N, 5) whether it is the object, its place from the spot, and its streak, px."""

    def __len__(self) -> int:
        return len(self.patches)


def prepare_flying_file(folder: Path, number: int) -> Path:
    """Make a file of samples to train on, unless it exists; its number determines them.

    Rendered rallies show the object among players and nets, random films in a greater variety: files alternate.
    """
    if number % 2 == 0:
        return prepare_rally_file(folder, number)
    path = folder / f"flying-{number:05d}.npz"
    if not path.exists():
        rng = np.random.default_rng(number)
        write_flying_file(path, [cut_film_samples(rng, draw_film(rng)) for _ in range(FILMS_PER_FILE)])
    return path


def write_flying_file(path: Path, shards: list[FlyingShard]) -> None:
    """Write samples as one file, whole or not at all."""
    aside = path.with_suffix(f".{os.getpid()}.part")
    with aside.open("wb") as file:
        patches = np.concatenate([shard.patches for shard in shards])
        np.savez(file, patches=patches, truth=np.concatenate([shard.truth for shard in shards]))
    aside.replace(path)


def read_flying_file(path: Path) -> FlyingShard:
    """Read a file that `prepare_flying_file` wrote."""
    with np.load(path, allow_pickle=False) as arrays:
        return FlyingShard(arrays["patches"], arrays["truth"])


def cut_film_samples(rng: np.random.Generator, film: FlyingFilm) -> FlyingShard:
    """Cut spots of the frames of a random film."""
    is_still = np.array_equal(film.shifts[0], film.shifts[-1])
    neutral = np.full((film.luma.shape[1] // 2, film.luma.shape[2] // 2, 2), 128, np.uint8)
    images = [PlaneImage(luma, neutral) for luma in film.luma]
    if not is_still:
        images = [soften_image(image) for image in images]
    shards = []
    for k in range(2, len(images) - 2):
        around = neighbours_of(k, 0, len(images), FILM_LAGS)
        window = align_window(k, [images[i] for i in around], film.shifts[around] @ np.linalg.inv(film.shifts[k]))
        place = find_window_spots(window, None)
        shards.append(cut_samples(window, place, film.centre[k], film.streak[k], film.visible[k], rng))
    return join_shards(shards)


def cut_samples(
    window: FrameWindow, place: IntArray, centre: FloatArray, streak: FloatArray, visible: FloatArray,
    rng: np.random.Generator | None = None,
) -> FlyingShard:  # fmt: skip
    """Cut the clear spots of a frame, with generator only `NEGATIVES_PER_FRAME` of those without an object.

    Args:
        window: The frame and its neighbours.
        place: (K, 2) spots.
        centre: (N, 2) working px, the objects.
        streak: (N, 2) working px.
        visible: (N,) share of each that is seen.
        rng: Chooses spots without an object.
    """
    judged = [judge_spots(place, *truth) for truth in zip(centre, streak, visible, strict=True)]
    own, clear = np.array([j[0] for j in judged]), np.array([j[1] for j in judged])
    is_own, is_clear = own.any(axis=0), clear.all(axis=0)
    empty = np.flatnonzero(~is_own & is_clear)
    if rng is not None:
        empty = rng.permutation(empty)[:NEGATIVES_PER_FRAME]
    chosen = np.concatenate([np.flatnonzero(is_own), empty])
    # Of overlapping streaks the one with the nearer centre.
    off = np.where(own, np.linalg.norm(centre[:, None] - place, axis=2), np.inf)
    which = np.argmin(off, axis=0)
    rows = np.column_stack([is_own, centre[which] - place, streak[which]])
    return FlyingShard(cut_patches(window, place[chosen]), rows[chosen].astype(np.float32))


def split_planes(frame: ByteArray) -> PlaneImage:
    """Split an image (H, W, 3), sRGB, of even sides into its planes."""
    height, width = frame.shape[:2]
    planes = np.asarray(cv2.cvtColor(frame, cv2.COLOR_RGB2YUV_I420), np.uint8)
    return PlaneImage(planes[:height], np.moveaxis(planes[height:].reshape(2, height // 2, width // 2), 0, 2).copy())


def join_shards(shards: list[FlyingShard]) -> FlyingShard:
    """Join shards to one."""
    patches, truth = [np.empty((0, LAYERS, PATCH_PX, PATCH_PX), np.uint8)], [np.empty((0, 5), np.float32)]
    return FlyingShard(
        np.concatenate(patches + [shard.patches for shard in shards]),
        np.concatenate(truth + [shard.truth for shard in shards]),
    )


def judge_spots(place: IntArray, centre: FloatArray, streak: FloatArray, visible: float) -> tuple[BoolArray, BoolArray]:
    """Tell which spots (K, 2) are the object, and of which it is clear whether they are."""
    off = centre - place
    length = float(np.linalg.norm(streak))
    along = streak / length if length else np.array([1.0, 0.0])
    beyond = np.maximum(np.abs(off @ along) - length / 2, 0.0)
    distance = np.hypot(beyond, off @ [-along[1], along[0]])
    is_far = np.abs(off).max(axis=1) > LARGEST_OFF_PX
    is_own = (distance < OWN_PX) & ~is_far & (visible >= LEAST_VISIBLE)
    is_clear = is_own | (distance > UNCLEAR_PX) | is_far | (visible == 0)
    return is_own, is_clear


def prepare_rally_file(folder: Path, number: int, is_held_out: bool = False) -> Path:
    """Render the rallies of a file and cut their spots, unless it exists; its number determines them.

    Held out files hold all spots of one object, as `find_candidates` judges them.
    """
    path = folder / f"{'held-out' if is_held_out else 'flying'}-rallies-{number:05d}.npz"
    if not path.exists():
        shards = []
        for k, sport in enumerate(sorted(find_sports())):
            seed = (HOLD_OUT_SEED if is_held_out else TRAINING_SEED) + 10 * number + k
            rng = np.random.default_rng(seed)
            rallies = simulate_rallies(sport, seed, RALLIES, path.with_suffix("") / sport)
            clips = generate_rally_clips(rng, rallies, CLIP_S, others=0 if is_held_out else OTHERS)
            shards += [cut_rally_samples(clip, None if is_held_out else rng) for clip in islice(clips, CLIPS)]
        write_flying_file(path, shards)
    return path


def cut_rally_samples(clip: RallyClip, rng: np.random.Generator | None) -> FlyingShard:
    """Cut the clear spots of the frames of a rendered clip, as `cut_samples` does."""
    truth = clip.truth
    camera, scene = truth.camera, CourtScene(truth.rally.sport, truth.camera, 0.0)
    scale = choose_scale(scene)
    images = [reduce_image(split_planes(frame), scale) for frame in clip.frames]
    if camera.motion is not None:
        images = [soften_image(image) for image in images]
    own = np.column_stack([truth.px, truth.streak, truth.shown, truth.contrast])
    objects = np.concatenate([own[:, None], truth.others.reshape(len(own), -1, 6)], axis=1)
    (lag, far), shards = choose_lags(truth.t), []
    # Training takes the ends as well, whose far neighbours are of one side: two thirds more samples of a clip.
    end = far if rng is None else 0
    for k in range(end, len(images) - end, lag):
        around = neighbours_of(k, 0, len(images), (lag, far))
        window = align_window(k, [images[i] for i in around], find_shifts(camera, around, scale))
        place = find_window_spots(window, outline_of_play(scene, scale, k))
        flying = objects[k][np.isfinite(objects[k]).all(axis=1)]
        # What is hardly seen is neither the object nor something else.
        visible = np.where(is_object_visible(flying[:, 4], flying[:, 5]), flying[:, 4], 0.1)
        shards.append(
            cut_samples(window, place, (flying[:, :2] + 0.5) * scale - 0.5, flying[:, 2:4] * scale, visible, rng)
        )
    return join_shards(shards)
