"""Hold-out samples of the flying-object network: spots of rendered rallies, which it is not trained on."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from detectors.flying.frame_windows import (
    align_window,
    choose_lag,
    find_shifts,
    neighbours_of,
    reduce_image,
    soften_image,
)
from detectors.flying.motion_spots import find_spots, map_lone_change
from detectors.flying.object_size import choose_scale, is_inside, outline_of_play
from detectors.flying.spot_patches import cut_patches
from detectors.training.flying_samples import SPOTS_PER_FRAME, FlyingShard, judge_spots, write_flying_file
from models.core.court_camera import CourtScene
from models.sports.sport_catalogue import find_sports
from video.rendering.rally_clips import RallyClip, generate_rally_clips, simulate_rallies

# Rallies, clips and frames of a clip in a file, for each sport, and the offset of the files' seeds.
RALLIES, CLIPS, FRAMES, SEED = 3, 5, 12, 9_100_000


def prepare_rally_file(folder: Path, number: int) -> Path:
    """Render the rallies of a file and cut their spots, unless it exists; its number determines them."""
    path = folder / f"flying-rallies-{number:05d}.npz"
    if not path.exists():
        shards = []
        for k, sport in enumerate(sorted(find_sports())):
            seed = SEED + 10 * number + k
            rallies = simulate_rallies(sport, seed, RALLIES, folder / f"rallies-{number:05d}-{sport}")
            clips = generate_rally_clips(np.random.default_rng(seed), rallies, FRAMES)
            shards += [cut_rally_samples(clip) for clip in islice(clips, CLIPS)]
        write_flying_file(path, shards)
    return path


def cut_rally_samples(clip: RallyClip) -> FlyingShard:
    """Cut all clear spots of a rendered clip, as `find_candidates` judges them."""
    truth = clip.truth
    camera, sport = truth.camera, truth.rally.sport
    scale = choose_scale(CourtScene(sport, camera, 0.0))
    images = [reduce_image(np.asarray(cv2.cvtColor(f, cv2.COLOR_RGB2GRAY), np.uint8), scale) for f in clip.frames]
    if camera.motion is not None:
        images = [soften_image(image) for image in images]
    patches, rows = [], []
    for k in range(len(images)):
        around = neighbours_of(k, 0, len(images), choose_lag(truth.t))
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
