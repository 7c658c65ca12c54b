"""Contact sheets for visual inspection: random frames with the tracks drawn in, and a strip around every contact."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from benchmarks.support.run_folder import RunFolder
from video.io.clip import open_clip, read_frames

COLOURS = {
    "cue": (255, 255, 255),
    "eight": (255, 0, 255),
    "red": (255, 60, 60),
    "yellow": (255, 220, 0),
    "white": (255, 255, 255),
}
SHEET_FRAMES = 20
STRIP_FRAMES = 7
STRIP_SIDE_RADII = 9.0
STRIP_PX = 150


def draw_tracks(rgb: np.ndarray, run: RunFolder, frame: int) -> np.ndarray:
    """Draw a ring and the name of every ball of `tracks.csv` into the frame; interpolated ones in grey."""
    image = rgb.copy()
    rows = np.flatnonzero(run.tracks["frame"] == frame)
    for row in rows:
        x, y, radius = (run.tracks[c][row] for c in ("x_px", "y_px", "radius_px"))
        if not np.isfinite(x + y):
            continue
        observed = run.tracks["observed"][row] == 1
        colour = COLOURS.get(str(run.tracks["kind"][row]), (0, 255, 255)) if observed else (128, 128, 128)
        radius = radius if np.isfinite(radius) else 10.0
        cv2.circle(image, (round(16 * x), round(16 * y)), round(16 * radius * 1.25), colour, 1, cv2.LINE_AA, 4)
        place = (round(x + radius * 1.2), round(y - radius * 1.2))
        cv2.putText(image, str(run.tracks["id"][row]), place, cv2.FONT_HERSHEY_SIMPLEX, 0.38, colour, 1, cv2.LINE_AA)
    cv2.putText(image, f"frame {frame}", (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 0), 1, cv2.LINE_AA)
    return image


def write_frames_sheet(source: Path, run: RunFolder, path: Path, seed: int) -> None:
    """Write a sheet of `SHEET_FRAMES` distinct frames, chosen at random, in four columns."""
    clip = open_clip(source)
    count = min(SHEET_FRAMES, len(clip.distinct_frames))
    frames = np.sort(np.random.default_rng(seed).choice(clip.distinct_frames, count, replace=False))
    cells = [draw_tracks(rgb, run, frame) for frame, rgb in read_frames(clip, indices=frames)]
    height = 480 * cells[0].shape[0] // cells[0].shape[1] * 4 // 3
    cells = [cv2.resize(c, (640, height), interpolation=cv2.INTER_AREA) for c in cells]
    cells += [np.zeros_like(cells[0])] * (-len(cells) % 4)
    sheet = np.vstack([np.hstack(cells[k : k + 4]) for k in range(0, len(cells), 4)])
    cv2.imwrite(str(path), cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))


def write_contact_strips(source: Path, run: RunFolder, path: Path) -> None:
    """Write one row per reported strike, contact and pocket: crops of the frames around it."""
    clip = open_clip(source)
    distinct = clip.distinct_frames
    rows = []
    for k in range(len(run.events["kind"])):
        if run.events["kind"][k] == "rest":
            continue
        middle = int(np.searchsorted(clip.t[distinct], run.events["t"][k]))
        first = int(np.clip(middle - STRIP_FRAMES // 2 - 1, 0, max(len(distinct) - STRIP_FRAMES, 0)))
        centre = run.to_pixels(np.array([run.events["x"][k], run.events["y"][k]]))
        radius = np.nanmedian(run.tracks["radius_px"])
        crops = [
            _crop_frame(rgb, centre, STRIP_SIDE_RADII * radius, f"{frame - run.events['frame'][k]:+.2f}")
            for frame, rgb in read_frames(clip, indices=distinct[first : first + STRIP_FRAMES])
        ]
        crops += [np.zeros_like(crops[0])] * (STRIP_FRAMES - len(crops))
        rows.append(np.hstack([_render_caption(run, k), *crops]))
    if rows:
        cv2.imwrite(str(path), cv2.cvtColor(np.vstack(rows), cv2.COLOR_RGB2BGR))


def _crop_frame(rgb: np.ndarray, centre: np.ndarray, side: float, label: str) -> np.ndarray:
    scale = STRIP_PX / side
    shift = np.array([[scale, 0, STRIP_PX / 2 - scale * centre[0]], [0, scale, STRIP_PX / 2 - scale * centre[1]]])
    crop = cv2.warpAffine(rgb, shift, (STRIP_PX, STRIP_PX), flags=cv2.INTER_LINEAR)
    return cv2.putText(crop, label, (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 0), 1, cv2.LINE_AA)


def _render_caption(run: RunFolder, k: int) -> np.ndarray:
    e = run.events
    image = np.zeros((STRIP_PX, 190, 3), np.uint8)
    lines = [
        f"{e['kind'][k]} {e['a'][k]} {e['b'][k]}",
        f"frame {e['frame'][k]:.2f}",
        f"{e['t'][k]:.4f} s +- {1000 * e['t_sigma'][k]:.1f} ms",
        f"p {e['probability'][k]:.2f}  v {e['speed'][k]:.2f} m/s",
    ]
    for row, line in enumerate(lines):
        cv2.putText(image, line, (6, 24 + 26 * row), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 255), 1, cv2.LINE_AA)
    return image
