"""Run the chain on the sample clips and score it against their exact truth.

    python -m benchmarks.clips.samples [--quick] [-o DIR] [--only WORD] [--reuse]

Takes up to a minute per clip without a cache. Prints one row per clip: positions (px, RMS per axis over visible moving
balls in all frames), contact times (ms), missed and extra contacts. Half of the clips (`other` models) move by contact
models that the fit does not have.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.support.figures import (
    Figure,
    add_quick_option,
    estimate_median,
    estimate_rms,
    estimate_share,
    run_quick,
)
from benchmarks.support.run_folder import ROOT, RunFolder, read_columns, read_run, run_clip

SAMPLES = ROOT / "sample_videos"
# Clips for `--quick`, the first with the contact models of the fit, the second with others.
QUICK_CLIPS = ("many_contacts", "carom_match")
# Parts of the path of a ball that count as cases of the noise: errors of successive frames are correlated.
PATH_PARTS = 5
# Largest time between a reported and a true contact of the same balls that still match, s.
MATCHING_SECONDS = 0.1
MODEL_LABELS = {False: "same", True: "other"}
# Speed above which a ball counts as moving, m/s.
MOVING_SPEED = 0.02


@dataclass(frozen=True)
class SampleScore:
    name: str
    foreign: bool
    measured_px: float
    fitted_px: float
    fitted_mm: float
    contact_ms: list[float]
    missed: list[str]
    extra: list[str]
    part_px: list[float]
    """RMS per axis of the fitted path, px, of each part of each path."""


def pair_balls(run: RunFolder, truth: dict[str, np.ndarray]) -> dict[str, str]:
    """Return our id of every true ball: the track with the least median distance."""
    pairs = {}
    for name in dict.fromkeys(truth["id"]):
        distances = {}
        for ball in dict.fromkeys(run.tracks["id"]):
            mine, true = _common_rows(run.tracks, ball, truth, name)
            if len(mine) >= 5:
                distances[str(ball)] = float(np.median(np.hypot(*(mine - true).T)))
        if distances:
            best = min(distances, key=distances.__getitem__)
            if distances[best] < 20:
                pairs[str(name)] = best
    return pairs


def _common_rows(
    tracks: dict[str, np.ndarray], ball: str, truth: dict[str, np.ndarray], name: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return measured and true pixels (K, 2) in the frames where both have the ball."""
    ours = (tracks["id"] == ball) & (tracks["observed"] == 1)
    theirs = (truth["id"] == name) & (truth["visible"] == 1)
    _, a, b = np.intersect1d(tracks["frame"][ours], truth["frame"][theirs], return_indices=True)
    mine = np.stack([tracks[c][ours][a] for c in ("x_px", "y_px")], axis=-1)
    true = np.stack([truth[c][theirs][b] for c in ("x_px", "y_px")], axis=-1)
    return mine, true


def select_moving_rows(truth: dict[str, np.ndarray], name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times (K,), positions (K, 2) m and pixels (K, 2) of a true ball while it moves and is visible."""
    rows = (truth["id"] == name) & (truth["visible"] == 1)
    t, xy = truth["t"][rows], np.stack([truth["x"][rows], truth["y"][rows]], axis=-1)
    px = np.stack([truth["x_px"][rows], truth["y_px"][rows]], axis=-1)
    if len(t) < 3:
        return t[:0], xy[:0], px[:0]
    moves = np.hypot(*np.gradient(xy, t, axis=0).T) > MOVING_SPEED
    return t[moves], xy[moves], px[moves]


def score_sample(clip: Path, run: RunFolder) -> SampleScore:
    facts: dict[str, Any] = json.loads(clip.with_suffix(".truth.json").read_text())
    truth = read_columns(clip.with_suffix(".truth.csv"))
    pairs = pair_balls(run, truth)
    measured, fitted_px, fitted_m, part_px = [], [], [], []
    for name, ball in pairs.items():
        mine, true = _common_rows(run.tracks, ball, truth, name)
        measured.append((mine - true).ravel())
        t, xy, px = select_moving_rows(truth, name)
        times, path_px = run.path_of(ball)
        rows = run.trajectory["id"] == ball
        inside = (t >= times.min()) & (t <= times.max()) if len(times) else np.zeros(len(t), bool)
        for axis, column in enumerate("xy"):
            fitted_m.append(np.interp(t[inside], times, run.trajectory[column][rows]) - xy[inside, axis])
            fitted_px.append(np.interp(t[inside], times, path_px[:, axis]) - px[inside, axis])
        parts = np.array_split(np.column_stack(fitted_px[-2:]), PATH_PARTS)
        part_px += [_compute_rms([part]) for part in parts if len(part)]
    errors, missed, extra = score_contacts(run, facts["events"], pairs)
    missed += [f"ball {name}" for name in dict.fromkeys(truth["id"]) if name not in pairs]
    return SampleScore(
        clip.stem, bool(facts["foreign"]), _compute_rms(measured), _compute_rms(fitted_px),
        1000 * _compute_rms(fitted_m), errors, missed, extra, part_px
    )  # fmt: skip


def _compute_rms(parts: list[np.ndarray]) -> float:
    values = np.concatenate(parts) if parts else np.array([np.nan])
    return float(np.sqrt(np.mean(values**2)))


def score_contacts(
    run: RunFolder, true_events: list[dict[str, Any]], pairs: dict[str, str]
) -> tuple[list[float], list[str], list[str]]:
    """Return time errors (ms) of the matched contacts, missed contacts, and reported contacts without a true one."""
    e = run.events
    taken: set[int] = set()
    errors, missed = [], []
    for true in true_events:
        if true["kind"] not in ("ball", "cushion"):
            continue
        names = {pairs.get(true["a"], true["a"]), pairs.get(true["b"], true["b"])}
        hits = [
            k
            for k in range(len(e["kind"]))
            if k not in taken and e["kind"][k] == true["kind"] and {str(e["a"][k]), str(e["b"][k])} == names
        ]
        best = min(hits, key=lambda k: abs(e["t"][k] - true["t"]), default=None)
        if best is None or abs(e["t"][best] - true["t"]) > MATCHING_SECONDS:
            missed.append(f"{true['kind']} {true['a']} {true['b']} {true['t']:.3f} s")
            continue
        taken.add(best)
        errors.append(1000 * float(e["t"][best] - true["t"]))
    extra = [
        f"{e['kind'][k]} {e['a'][k]} {e['b'][k]} {e['t'][k]:.3f} s"
        for k in range(len(e["kind"]))
        if e["kind"][k] in ("ball", "cushion") and k not in taken
    ]
    return errors, missed, extra


def measure_figures(folder: Path) -> list[Figure]:
    """Measure the figures of the documentation on one clip of each kind of contact models."""
    scores = []
    for name in QUICK_CLIPS:
        clip = SAMPLES / f"{name}.mp4"
        outcome = run_clip(clip, folder / name, "--no-video")
        if outcome.status:
            raise SystemExit(f"{name}: {outcome.sentence}")
        scores.append(score_sample(clip, read_run(folder / name)))
    found, extra = sum(len(s.contact_ms) for s in scores), sum(len(s.extra) for s in scores)
    figures = [
        estimate_share("contacts found", found, found + sum(len(s.missed) for s in scores)),
        estimate_share("false contacts", extra, found + extra),
    ]
    for score in scores:
        label = f"{MODEL_LABELS[score.foreign]} contact models"
        figures += [
            estimate_median(f"{label}: error of contact times, median", np.abs(score.contact_ms), "ms"),
            estimate_rms(f"{label}: error of positions per axis, RMS", score.part_px, "px"),
        ]
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_quick_option(parser)
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out" / "samples", help="folder of the runs")
    parser.add_argument("--only", default="", help="only clips whose name contains this word")
    parser.add_argument("--reuse", action="store_true", help="score existing run folders")
    arguments = parser.parse_args()
    if arguments.quick:
        inputs = f"clips {' and '.join(QUICK_CLIPS)} of `sample_videos/`; n counts contacts, and fifths of paths"
        run_quick("clips.samples", lambda: measure_figures(arguments.out), inputs)
        return 0
    print("| clip | models | measured px | fitted px | fitted mm | contact median ms | contacts | missed | extra |")
    print("|---|---|---|---|---|---|---|---|---|")
    scores, failed = [], False
    for clip in sorted(SAMPLES.glob("*.mp4")):
        if arguments.only not in clip.stem:
            continue
        folder = arguments.out / clip.stem
        if not arguments.reuse:
            outcome = run_clip(clip, folder)
            if outcome.status:
                print(f"| {clip.stem} | failed: {outcome.sentence} |||||||")
                failed = True
                continue
        scores.append(score_sample(clip, read_run(folder)))
        s = scores[-1]
        print(
            f"| {s.name} | {MODEL_LABELS[s.foreign]} | {s.measured_px:.2f} | {s.fitted_px:.2f} | {s.fitted_mm:.2f} "
            f"| {np.median(np.abs(s.contact_ms)) if s.contact_ms else np.nan:.1f} | {len(s.contact_ms)} "
            f"| {'; '.join(s.missed)} | {'; '.join(s.extra)} |"
        )
    for foreign in (False, True):
        half = [s for s in scores if s.foreign is foreign]
        times = [abs(ms) for s in half for ms in s.contact_ms]
        if half and times:
            px = np.sqrt(np.mean([s.fitted_px**2 for s in half]))
            print(
                f"\n{MODEL_LABELS[foreign]} contact models: fitted {px:.2f} px RMS per axis, "
                f"contacts {np.median(times):.1f} ms median"
            )
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
