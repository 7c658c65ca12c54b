"""Cases of rendered rallies: each a clip with its truth in a folder of its own, made once."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.support.run_folder import ROOT
from models.core.court_camera import CourtCamera, CourtScene
from models.core.typing import FloatArray
from models.sports.sport_catalogue import find_sports
from video.rendering.court_players import pose_player
from video.rendering.court_renderer import FrameTruth, locate_object
from video.rendering.court_scene import CourtLook, RallyPath, View, read_rally
from video.rendering.rally_clips import (
    RallyTruth,
    collect_truth,
    film_rally,
    simulate_rallies,
    stage_rally,
    write_frames,
)

# Turns of views and rates over the rallies of a sport; their numbers share no divisor.
VIEWS: tuple[View, ...] = ("broadcast", "broadcast", "phone")
RATES = (25, 30, 50, 60)
HIGH_SHARE = 5
"""Every so many rallies, one is filmed at 1080p."""


@dataclass(frozen=True)
class CourtCase:
    """A rally of a sport by its number, as it is filmed."""

    sport: str
    number: int
    seed: int
    strokes: tuple[int, int]

    @property
    def view(self) -> View:
        return VIEWS[self.number % len(VIEWS)]

    @property
    def fps(self) -> int:
        return RATES[self.number % len(RATES)]

    @property
    def size(self) -> tuple[int, int]:
        return (1920, 1080) if self.number % HIGH_SHARE == HIGH_SHARE - 1 else (1280, 720)

    @property
    def name(self) -> str:
        return f"{self.sport}_{self.seed}_{self.number:03d}"

    @property
    def draw(self) -> int:
        """Seed of all that is drawn for this case."""
        return int(np.random.SeedSequence([self.seed, self.number, len(self.sport)]).generate_state(1)[0])


@dataclass(frozen=True)
class CourtTruth:
    """Truth of a clip of T frames, as `write_truth` writes it."""

    folder: Path
    stated: dict[str, Any]
    columns: dict[str, FloatArray]
    scene: CourtScene

    @property
    def fps(self) -> float:
        return float(self.stated["fps"])


def write_rally_clip(
    folder: Path, rally: RallyPath, view: View, fps: float, seed: int, size: tuple[int, int] = (1280, 720),
    span: tuple[float, float] | None = None,
) -> RallyTruth:  # fmt: skip
    """Render a rally to `clip.mp4`, with `truth.npz` and `truth.json`.

    Args:
        size: width and height, px.
        span: s of the rally, of which the clip shows that part; None for all of it.

    Returns:
        The truth.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rng, rate = np.random.default_rng(seed), Fraction(fps).limit_denominator(1001)
    renderer, camera, look, t = stage_rally(rng, rally, view, rate, size, span or (rally.t[0], rally.t[-1]))
    shown = write_frames(folder / "clip.mp4", renderer, look, rate, size, "veryfast")
    truth = collect_truth(rally, camera, look, rate, t, shown)
    write_truth(folder, truth, view)
    return truth


def write_truth(folder: Path, truth: RallyTruth, view: View) -> None:
    """Write `truth.npz` and `truth.json`."""
    camera = truth.camera
    motion = np.empty((0, 3, 3)) if camera.motion is None else camera.motion
    np.savez_compressed(
        folder / "truth.npz", t=truth.t, xyz=truth.xyz, px=truth.px, streak=truth.streak, radius_px=truth.radius_px,
        shown=truth.shown, contrast=truth.contrast, is_visible=truth.is_visible, players=truth.players,
        camera=camera.parameters, motion=motion,
    )  # fmt: skip
    content = {
        "sport": truth.sport, "view": view, "fps": float(truth.fps), "exposure": truth.exposure, "start": truth.start,
        "width": camera.width_px, "height": camera.height_px, "is_left_handed": camera.is_left_handed,
        "events": truth.events, "strokes": truth.rally.truth["strokes"], "ending": truth.rally.truth["ending"],
        "surface": truth.rally.truth["surface"],
    }  # fmt: skip
    (folder / "truth.json").write_text(json.dumps(content))


@cache
def hash_renderer() -> str:
    """Hash the code that plays and renders rallies: what an older one made is made anew."""
    files = (ROOT / "worlds" / "rallies.py", *sorted((ROOT / "video" / "rendering").glob("*.py")))
    return hashlib.sha256(b"".join(one.read_bytes() for one in files)).hexdigest()[:8]


def render_case(case: CourtCase, folder: Path) -> Path:
    """Render a case below a folder, unless it is there; returns its folder."""
    target = folder / f"{case.name}_{hash_renderer()}"
    if not (target / "truth.json").exists():
        (path,) = simulate_rallies(case.sport, case.draw, 1, target / "rally", strokes=case.strokes)
        write_rally_clip(target, read_rally(path), case.view, case.fps, case.draw, case.size)
    return target


def film_case(case: CourtCase, folder: Path) -> Path:
    """Write the truth of a case below a folder, unless it is there, without its clip; returns its folder."""
    target = folder / f"{case.name}_{hash_renderer()}_truth"
    if not (target / "truth.json").exists():
        (path,) = simulate_rallies(case.sport, case.draw, 1, target / "rally", strokes=case.strokes)
        rally, rate = read_rally(path), Fraction(case.fps)
        span = (float(rally.t[0]), float(rally.t[-1]))
        camera, look, t = film_rally(np.random.default_rng(case.draw), rally, case.view, rate, case.size, span)
        shown = [_see_frame(rally, camera, look, t, k) for k in range(len(t))]
        write_truth(target, collect_truth(rally, camera, look, rate, t, shown), case.view)
    return target


def _see_frame(rally: RallyPath, camera: CourtCamera, look: CourtLook, t: FloatArray, k: int) -> FrameTruth:
    """Find where the object and the players are in a frame, and whether a body, the table or the edge hides it."""
    frame = None if camera.motion is None else k
    places, px, radius = locate_object(rally, camera, look, float(t[k]), frame)
    at, depth = px[1], float(np.linalg.norm(places[1] - camera.centre))
    is_shown = bool(np.isfinite(px).all() and (at > 0).all() and (at < [camera.width_px, camera.height_px]).all())
    boxes = []
    for player, outfit in enumerate(look.outfits[: len(rally.feet)]):
        body, head = pose_player(rally, player, outfit, float(t[k]))
        ends = np.array([[part.a, part.b] for part in body])
        sizes = np.array([[part.radius_a, part.radius_b] for part in body])
        spots = camera.to_pixels(ends, frame)
        away = np.linalg.norm(ends - camera.centre, axis=-1)
        sizes_px = sizes * float(np.exp(camera.parameters[6])) / away
        rim = camera.to_pixels(np.stack([head.centre + head.axes[0], head.centre - head.axes[0]]), frame)
        ends_px = [(spots + sign * sizes_px[..., None]).reshape(-1, 2) for sign in (-1, 1)]
        outline = np.concatenate([*ends_px, rim])
        boxes.append(np.concatenate([np.nanmin(outline, axis=0), np.nanmax(outline, axis=0)]))
        along = spots[:, 1] - spots[:, 0]
        share = np.clip(((at - spots[:, 0]) * along).sum(1) / np.maximum((along**2).sum(1), 1e-9), 0, 1)
        off = np.linalg.norm(spots[:, 0] + share[:, None] * along - at, axis=1)
        is_shown &= not bool(((off < sizes_px.max(axis=1)) & (away.mean(axis=1) < depth)).any())
    sport, eye = rally.sport, camera.centre
    if sport.floor < 0 and places[1, 2] < 0:
        over = eye + eye[2] / (eye[2] - places[1, 2]) * (places[1] - eye)
        is_shown &= not bool((over[:2] > 0).all() and (over[:2] < [sport.length, sport.width]).all())
    shown = np.array([float(is_shown)])
    return FrameTruth(at[None], (px[2] - px[0])[None], np.array([radius]), shown, 255 * shown, np.array(boxes))


def read_truth(folder: Path) -> CourtTruth:
    """Read the truth of a clip."""
    stated = json.loads((folder / "truth.json").read_text())
    with np.load(folder / "truth.npz") as arrays:
        columns = dict(arrays)
    motion = columns["motion"] if len(columns["motion"]) else None
    size = (stated["width"], stated["height"])
    # a calibrated camera that is practically exact
    camera = CourtCamera(columns["camera"], 1e-12 * np.eye(8), *size, stated["is_left_handed"], motion)
    return CourtTruth(folder, stated, columns, CourtScene(find_sports()[stated["sport"]], camera, 0.0))
