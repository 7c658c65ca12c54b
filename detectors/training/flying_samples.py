"""Samples of the flying-object network, with their truth: random films train it, rendered rallies only check it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from detectors.flying.frame_windows import (
    FrameWindow,
    align_window,
    choose_lag,
    find_shifts,
    neighbours_of,
    reduce_image,
    soften_image,
)
from detectors.flying.motion_spots import find_spots, map_lone_change
from detectors.flying.object_size import choose_scale, is_inside, outline_of_play
from detectors.flying.spot_patches import LAYERS, MIDDLE, PATCH_PX, cut_patches
from detectors.training.flying_scenes import FlyingFilm, draw_film
from models.core.court_camera import CourtScene
from models.core.typing import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from models.sports.sport_catalogue import find_sports
from video.rendering.rally_clips import RallyClip, generate_rally_clips, simulate_rallies

# Films in a file.
FILMS_PER_FILE = 60
# Spots of a frame that are looked at, and those of them without the object that become samples.
SPOTS_PER_FRAME, NEGATIVES_PER_FRAME = 40, 10
# Share of the object that must be seen, and px by which a spot may be beside it and still be its own.
LEAST_VISIBLE, OWN_PX = 0.4, 4.0
# px beside the streak up to which a spot is neither the object nor something else.
UNCLEAR_PX = 9.0
# Rallies, clips and frames of a clip in a file of rallies, for each sport, and the offset of the files' seeds.
RALLIES, CLIPS, CLIP_FRAMES, SEED = 3, 4, 24, 9_100_000


@dataclass(frozen=True, slots=True)
class FlyingShard:
    """N spots."""

    patches: ByteArray
    """(N, 8, 32, 32) as in `cut_patches`."""
    truth: Float32Array
    """(N, 5) whether it is the object, its place from the spot, and its streak, px."""

    def __len__(self) -> int:
        return len(self.patches)


def prepare_flying_file(folder: Path, number: int) -> Path:
    """Draw the films of a file and cut their spots, unless it exists; its number determines them."""
    path = folder / f"flying-{number:05d}.npz"
    if not path.exists():
        rng = np.random.default_rng(number)
        write_flying_file(path, [cut_samples(rng, draw_film(rng), NEGATIVES_PER_FRAME) for _ in range(FILMS_PER_FILE)])
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


def cut_samples(rng: np.random.Generator, film: FlyingFilm, negatives: int) -> FlyingShard:
    """Cut the spots of the inner frames of a film; at most so many of each frame that are not the object."""
    patches, truth = [np.empty((0, LAYERS, PATCH_PX, PATCH_PX), np.uint8)], [np.empty((0, 5))]
    for k in range(2, len(film.luma) - 2):
        window = _window_of(film, k)
        place = find_spots(map_lone_change(window)).place[:SPOTS_PER_FRAME]
        truths = zip(film.centre[k], film.streak[k], film.visible[k], strict=True)
        judged = [judge_spots(place, *truth_of_one) for truth_of_one in truths]
        own, clear = np.array([j[0] for j in judged]), np.array([j[1] for j in judged])
        others = rng.permutation(np.flatnonzero(~own.any(axis=0) & clear.all(axis=0)))[:negatives]
        chosen = np.concatenate([np.flatnonzero(own.any(axis=0)), others])
        which = np.argmax(own, axis=0)
        rows = np.column_stack([own.any(axis=0), film.centre[k][which] - place, film.streak[k][which]])
        patches.append(cut_patches(window, place[chosen]))
        truth.append(rows[chosen])
    return FlyingShard(np.concatenate(patches), np.concatenate(truth).astype(np.float32))


def judge_spots(place: IntArray, centre: FloatArray, streak: FloatArray, visible: float) -> tuple[BoolArray, BoolArray]:
    """Tell which spots (K, 2) are the object, and of which it is clear whether they are."""
    off = centre - place
    length = float(np.linalg.norm(streak))
    along = streak / length if length else np.array([1.0, 0.0])
    beyond = np.maximum(np.abs(off @ along) - length / 2, 0.0)
    distance = np.hypot(beyond, off @ [-along[1], along[0]])
    is_own = (distance < OWN_PX) & (np.abs(off).max(axis=1) < MIDDLE - 2) & (visible >= LEAST_VISIBLE)
    is_clear = is_own | (distance > UNCLEAR_PX) | (visible == 0)
    return is_own, is_clear


def _window_of(film: FlyingFilm, k: int) -> FrameWindow:
    """Align the frames about frame k of a film."""
    around = slice(k - 2, k + 3)
    shifts = film.shifts[around] @ np.linalg.inv(film.shifts[k])
    is_still = np.array_equal(film.shifts[0], film.shifts[-1])
    return align_window(k, [image if is_still else soften_image(image) for image in film.luma[around]], shifts)


def prepare_rally_file(folder: Path, number: int) -> Path:
    """Render the rallies of a file and cut their spots, unless it exists; its number determines them."""
    path = folder / f"flying-rallies-{number:05d}.npz"
    if not path.exists():
        shards = []
        for k, sport in enumerate(sorted(find_sports())):
            seed = SEED + 10 * number + k
            rallies = simulate_rallies(sport, seed, RALLIES, folder / f"rallies-{number:05d}-{sport}")
            clips = generate_rally_clips(np.random.default_rng(seed), rallies, CLIP_FRAMES)
            shards += [cut_rally_samples(clip) for clip in islice(clips, CLIPS)]
        write_flying_file(path, shards)
    return path


def cut_rally_samples(clip: RallyClip) -> FlyingShard:
    """Cut all clear spots of the inner frames of a rendered clip, as `find_candidates` judges them."""
    truth = clip.truth
    camera, sport = truth.camera, truth.rally.sport
    scale = choose_scale(CourtScene(sport, camera, 0.0))
    images = [reduce_image(np.asarray(cv2.cvtColor(f, cv2.COLOR_RGB2GRAY), np.uint8), scale) for f in clip.frames]
    if camera.motion is not None:
        images = [soften_image(image) for image in images]
    patches, rows = [], []
    lag = choose_lag(truth.t)
    for k in range(2 * lag, len(images) - 2 * lag):
        around = neighbours_of(k, 0, len(images), lag)
        window = align_window(k, [images[i] for i in around], find_shifts(camera, around, scale))
        place = find_spots(map_lone_change(window)).place
        px = np.asarray((place + 0.5) / scale - 0.5, np.float64)
        place = place[is_inside(outline_of_play(sport, camera, k), px)][:SPOTS_PER_FRAME]
        centre, streak = (truth.px[k] + 0.5) * scale - 0.5, truth.streak[k] * scale
        is_own, is_clear = judge_spots(place, centre, streak, truth.shown[k] if truth.is_visible[k] else 0.1)
        table = np.column_stack([is_own, centre - place, np.broadcast_to(streak, place.shape)])
        patches.append(cut_patches(window, place)[is_clear])
        rows.append(table[is_clear])
    return FlyingShard(np.concatenate(patches), np.concatenate(rows).astype(np.float32))
