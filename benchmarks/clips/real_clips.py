"""Run the chain on every real clip and score it against the marks that come with the footage.

    python -m benchmarks.clips.real_clips [-o DIR] [--only WORD] [--reuse] [--no-sheets]

Needs the footage of ../shared/data; takes half a minute or more per clip. Prints one table per claim; DIR gets, per
clip, a run folder, a sheet of 20 frames and a strip for every contact.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from benchmarks.clips.contact_sheets import write_contact_strips, write_frames_sheet
from benchmarks.clips.mark_scores import MarkScore, score_carom, score_pool, score_snooker
from benchmarks.support.run_folder import FOOTAGE, ROOT, Outcome, RunFolder, read_run, run_clip

SEED = 2022


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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "-o", "--out", type=Path, default=ROOT / "out" / "real_clips", help="folder of the runs and sheets"
    )
    parser.add_argument("--only", default="", help="only clips whose name contains this word")
    parser.add_argument("--reuse", action="store_true", help="score existing run folders")
    parser.add_argument("--no-sheets", action="store_true", help="print scores only, write no sheets")
    arguments = parser.parse_args()
    if not FOOTAGE.is_dir():
        print(f"real footage is not at {FOOTAGE}", file=sys.stderr)
        return 1
    tables: dict[str, list[MarkScore]] = {"chain": [], "snooker": [], "carom": [], "pool8": []}
    scorers = {"snooker": score_snooker, "carom": score_carom, "pool8": score_pool}
    for clip in sorted(FOOTAGE.glob("*.mp4")):
        if arguments.only not in clip.stem:
            continue
        folder = arguments.out / clip.stem
        outcome = Outcome(0, 0.0, "") if arguments.reuse else run_clip(clip, folder)
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
        if family in scorers and truth.is_file():
            tables[family].append(scorers[family](clip.stem, run, json.loads(truth.read_text())))
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
    return 0


if __name__ == "__main__":
    sys.exit(main())
