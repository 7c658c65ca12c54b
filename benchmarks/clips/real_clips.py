"""Run the chain on every real clip and score it against the marks that come with the footage.

    python -m benchmarks.clips.real_clips [--quick] [-o DIR] [--only WORD] [--reuse] [--no-sheets] [--no-video]

Needs the footage of ../shared/data; takes half a minute or more per clip. Prints one table per claim; DIR gets, per
clip, a run folder, a sheet of 20 frames and a strip for every contact.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

from benchmarks.clips.contact_sheets import write_contact_strips, write_frames_sheet
from benchmarks.clips.mark_scores import MarkScore, score_carom, score_labelled_events, score_pool, score_snooker
from benchmarks.support.figures import (
    Figure,
    MissingInputError,
    add_quick_option,
    estimate_mean,
    estimate_median,
    estimate_rms,
    estimate_share,
    run_quick,
)
from benchmarks.support.run_folder import FOOTAGE, ROOT, Outcome, RunFolder, read_run, run_clip

SEED = 2022
SCORERS = {"snooker": score_snooker, "carom": score_carom, "pool8": score_pool}
# Clips for `--quick`: one of each game, the shortest to process.
QUICK_CLIPS = ("carom_F3", "pool8_game3_clip1", "snooker_video_13_0030_0034")


def print_table(title: str, header: tuple[str, ...], scores: list[MarkScore]) -> None:
    print(f"\n## {title}\n\n| clip | {' | '.join(header)} |\n|{'---|' * (len(header) + 1)}")
    for score in scores:
        print(f"| {score.name} | {' | '.join(score.cells)} |")


def score_chain(stem: str, outcome: Outcome, run: RunFolder | None) -> MarkScore:
    if run is None:
        return MarkScore(stem, (f"{outcome.seconds:.0f} s", "refused", "-", outcome.sentence), {})
    quality = run.scene["fit"]
    share = quality["accepted_s"] / quality["moving_s"] if quality["moving_s"] else 1.0
    events = run.events["kind"]
    counts = ", ".join(f"{np.sum(events == kind)} {kind}" for kind in dict.fromkeys(events))
    trust = run.scene["trust"]
    return MarkScore(stem, (f"{outcome.seconds:.0f} s", trust["light"], f"{share:.0%}", counts), {"accepted": [share]})


def measure_figures(folder: Path) -> list[Figure]:
    """Measure the figures of the documentation on one clip of each game."""
    if not FOOTAGE.is_dir():
        raise MissingInputError(f"real footage is not at {FOOTAGE}")
    samples: dict[str, list[float]] = defaultdict(list)
    for stem in QUICK_CLIPS:
        outcome = run_clip(FOOTAGE / f"{stem}.mp4", folder / stem, "--no-video")
        if outcome.status:
            raise SystemExit(f"{stem}: {outcome.sentence}")
        run = read_run(folder / stem)
        score = SCORERS[stem.split("_")[0]](stem, run, json.loads((FOOTAGE / f"{stem}.gt.json").read_text()))
        for name, values in (score_chain(stem, outcome, run).samples | score.samples).items():
            samples[name] += values
    found, boxed, true, claimed, switches, rows = (
        int(sum(samples[name])) for name in ("found", "boxed", "true", "claimed", "switches", "rows")
    )
    frames = np.array(samples["frame"])
    return [
        estimate_rms("carom: centres of three balls, RMS distance", samples["distance"], "px"),
        estimate_share("carom: rows with another ball", switches, rows),
        estimate_share("pool: balls of first and last frame found", found, boxed),
        estimate_share("pool: reported balls that are true", true, claimed),
        estimate_median("snooker: path against marks by hand, median", samples["place"], "px"),
        estimate_share("snooker: events within three frames", int(np.sum(frames <= 3)), len(frames)),
        estimate_mean("share of moving time that an accepted fit explains", 100 * np.array(samples["accepted"]), "%"),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_quick_option(parser)
    parser.add_argument(
        "-o", "--out", type=Path, default=ROOT / "out" / "real_clips", help="folder of the runs and sheets"
    )
    parser.add_argument("--only", default="", help="only clips whose name contains this word")
    parser.add_argument("--reuse", action="store_true", help="score existing run folders")
    parser.add_argument("--no-sheets", action="store_true", help="print scores only, write no sheets")
    parser.add_argument("--no-video", action="store_true", help="leave out the slow motion")
    arguments = parser.parse_args()
    if arguments.quick:
        run_quick("clips.real_clips", lambda: measure_figures(arguments.out), f"clips {', '.join(QUICK_CLIPS)}")
        return 0
    if not FOOTAGE.is_dir():
        print(f"real footage is not at {FOOTAGE}", file=sys.stderr)
        return 1
    tables: dict[str, list[MarkScore]] = {"chain": [], "snooker": [], "carom": [], "pool8": [], "labels": []}
    flags = ("--no-video",) if arguments.no_video else ()
    for clip in sorted(FOOTAGE.glob("*.mp4")):
        if arguments.only not in clip.stem:
            continue
        folder = arguments.out / clip.stem
        outcome = Outcome(0, 0.0, "") if arguments.reuse else run_clip(clip, folder, *flags)
        run = read_run(folder) if outcome.status == 0 and (folder / "scene.json").is_file() else None
        print(
            f"{clip.stem}: {outcome.seconds:.0f} s, status {outcome.status} {outcome.sentence if run is None else ''}",
            file=sys.stderr,
        )
        tables["chain"].append(score_chain(clip.stem, outcome, run))
        if run is None:
            continue
        family = clip.stem.split("_")[0]
        truth = clip.with_name(clip.stem + ".gt.json")
        if family in SCORERS and truth.is_file():
            tables[family].append(SCORERS[family](clip.stem, run, json.loads(truth.read_text())))
        labels = clip.with_name(clip.stem + ".events.json")
        if labels.is_file():
            tables["labels"].append(score_labelled_events(clip.stem, run, json.loads(labels.read_text())))
        if not arguments.no_sheets:
            write_frames_sheet(clip, run, arguments.out / f"{clip.stem}_frames.png", SEED)
            write_contact_strips(clip, run, arguments.out / f"{clip.stem}_contacts.png")
    print_table("Every clip", ("time", "trust", "accepted share of moving time", "events"), tables["chain"])
    print_table(
        "Snooker marks", ("place median px", "within 5 px", "event within 3 frames", "missed"), tables["snooker"]
    )
    pooled = {k: np.array([v for s in tables["snooker"] for v in s.samples[k]]) for k in ("place", "frame")}
    if len(pooled["place"]):
        places, frames = pooled["place"], pooled["frame"]
        print(f"\nall marks: place median {np.median(places):.2f} px, within 5 px {np.mean(places <= 5):.0%}")
        print(f"event within 3 frames: {np.mean(frames <= 3):.0%} of {len(frames)}")
    header = (
        "RMS px after one shift",
        "rows missing",
        "rows > 10 px off",
        "marked events found",
        "reported contacts marked",
    )
    print_table("Carom", header, tables["carom"])
    print_table("Pool boxes", ("recall", "precision", "ball class right", "missed"), tables["pool8"])
    print_table("Labelled events", ("found", "missed", "false at 90 % or more", "which"), tables["labels"])
    names = ("hits", "labels", "false")
    hits, count, false = (int(sum(v for s in tables["labels"] for v in s.samples[k])) for k in names)
    print(f"\nall labelled events: {hits} of {count} found, {false} false at 90 % or more")
    return 0


if __name__ == "__main__":
    sys.exit(main())
