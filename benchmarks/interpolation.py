"""Withhold pictures of real clips, make them anew, and compare: trueroll beside its rivals and an oracle.

    python benchmarks/interpolation.py [-o DIR] [--only WORD] [--step 2] [--gaps 40] [--reuse] [--rendered] [--anew N]

Prints one table per clip and one over all: PSNR on the paths of the balls by class of gap (contact, fast: further than
a radius, slow), distance from the ball's real place, balls missing or doubled, and what is elsewhere (`stirred`: where
something moves there). The oracle is the best translated sprite on the real picture; it is blind elsewhere. Of
rendered clips (the samples, and N shots drawn anew from each) it is the shot filmed again, with the true places and
other noise. DIR gets sheets of the worst, of seed-drawn and of all contact pictures.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from between_rendered import film_of, samples_of
from between_rivals import FlowBothWays, blended, minterpolated
from between_scores import Scored, Tally, score_picture
from between_sheets import write_sheet
from between_truth import CLASSES, Lying, Passing, lying_in, oracle_picture, passings, plate_of
from run_folder import FOOTAGE, ROOT, read_run, run_clip
from withheld import Withheld, made_by_trueroll, pictures_of, withhold

from video.io.chroma import square_colours

CLIPS = ("carom_F1", "pool8_game2_clip1", "snooker_video_13_0030_0034")
SEED, DRAWN, WORST = 7, 8, 12
RIVALS = ("blend", "DIS both ways", "minterpolate")
Pictures = dict[str, dict[int, np.ndarray]]
"""By method and place."""
Tallies = dict[str, dict[str, Tally]]
"""By method and class."""


def kept(stem: Path, reuse: bool, make: Callable[[], Pictures]) -> Pictures:
    """The rivals' pictures, kept in files: they take a second each and do not change."""
    files = {rival: stem.with_name(f"{stem.name}_{rival.split()[0]}.npz") for rival in RIVALS}
    if reuse and all(file.is_file() for file in files.values()):
        stored = {rival: np.load(file) for rival, file in files.items()}
        return {rival: {int(k): found[k] for k in found.files} for rival, found in stored.items()}
    made = make()
    for rival, file in files.items():
        np.savez(file, **{str(k): v for k, v in made[rival].items()})
    return made


def rivals_of(held: Withheld, pictures: list[np.ndarray], places: list[int]) -> Pictures:
    """Every rival's pictures at the places."""
    blends, flows, compensated = {}, {}, {}
    for row in sorted({place // held.step for place in places}):
        low, high = max(row - 1, 0), min(row + 3, len(held.visible))
        near = [pictures[k * held.step] for k in range(low, high)]
        by_ffmpeg = minterpolated(near, held.step)
        flow = FlowBothWays(*(pictures[(row + side) * held.step] for side in (0, 1)))
        for place in (p for p in places if p // held.step == row):
            share = place % held.step / held.step
            blends[place] = blended(*flow.pictures, share)
            flows[place] = flow.at(share)
            compensated[place] = by_ffmpeg[place - low * held.step]
    return dict(zip(RIVALS, (blends, flows, compensated), strict=True))


def chosen(balls: dict[int, list[Passing]], most: int, rng: np.random.Generator) -> list[int]:
    """Places to score: half of them with contacts at the most, the others drawn."""
    contacts = [place for place, found in balls.items() if any(b.kind == "contact" for b in found)]
    contacts = sorted(rng.permutation(contacts)[: most // 2].tolist())
    others = [place for place in balls if place not in contacts]
    return sorted({*contacts, *rng.permutation(others)[: most - len(contacts)].tolist()})


@dataclass(frozen=True)
class Case:
    """A clip with pictures withheld, and what is true of them."""

    held: Withheld
    pictures: list[np.ndarray]
    """D, visible and withheld."""
    passings: list[Passing]
    lying: Lying
    again: list[np.ndarray] | None = None
    """D pictures of the same shot filmed again; None: the oracle is the best sprite."""


def real_cases(arguments: argparse.Namespace) -> Iterator[Case]:
    """Real clips, the balls' places as a run of the whole clip saw them."""
    if not FOOTAGE.is_dir():
        raise SystemExit(f"real footage is not at {FOOTAGE}")
    word = arguments.only
    for source in sorted(FOOTAGE.glob("*.mp4")):
        if word not in source.stem if word else source.stem not in CLIPS:
            continue
        full = arguments.out / f"full_{source.stem}"
        if not (full / "tracks.csv").is_file():
            run_clip(source, full)
        held, run = withhold(source, arguments.step, arguments.out), read_run(full)
        yield Case(held, pictures_of(held), list(passings(held, run)), lying_in(held, run))


def rendered_cases(arguments: argparse.Namespace) -> Iterator[Case]:
    """Films of the sample shots and of new ones."""
    for sample in samples_of(arguments.only, arguments.anew, SEED):
        film = film_of(sample, arguments.out)
        yield Case(film.held, pictures_of(film.held), film.passings, film.lying, film.again)


def score_case(case: Case, arguments: argparse.Namespace) -> Tallies:
    """One clip: its table and its sheets."""
    held, pictures, stem = case.held, case.pictures, arguments.out / case.held.source.stem
    balls: dict[int, list[Passing]] = defaultdict(list)
    for passing in case.passings:
        balls[passing.place].append(passing)
    places = chosen(balls, arguments.gaps, np.random.default_rng(SEED))
    ours = made_by_trueroll(held)
    for k, real in enumerate(pictures[:: held.step]):
        if not np.array_equal(ours[k * held.step], real):
            raise SystemExit(f"{held.name}: the original {k} is not untouched")
    kept_at = stem.with_name(f"{stem.name}_{held.step}_{arguments.gaps}")
    rivals = kept(kept_at, arguments.reuse, lambda: rivals_of(held, pictures, places))
    plate = plate_of(pictures, case.lying)
    tallies: Tallies = defaultdict(lambda: defaultdict(Tally))
    shown = {}
    for place in places:
        around = _around(held, pictures, place)
        scored = Scored.of(balls[place], pictures[place], around, plate)
        made = {"trueroll": ours[place], **{n: _as_filmed(r[place]) for n, r in rivals.items()}}
        if case.again is None:
            made["oracle"] = _as_filmed(oracle_picture(balls[place], pictures[place], around, plate))
        else:
            made["filmed again"] = case.again[place]
        for method, picture in made.items():
            score_picture(scored, picture, tallies[method])
        shown[place] = {"before": around[0], "real": pictures[place], **made, "after": around[1]}
    _sheets(stem, balls, shown)
    return tallies


def _as_filmed(picture: np.ndarray) -> np.ndarray:
    """With one colour for every two by two pixels, as all these clips have it: nobody is worse for what is coded so."""
    filmed = picture.copy()
    square_colours(filmed, (0, 0, picture.shape[1], picture.shape[0]))
    return filmed


def _around(held: Withheld, pictures: list[np.ndarray], place: int) -> tuple[np.ndarray, np.ndarray]:
    row = place // held.step
    return pictures[row * held.step], pictures[(row + 1) * held.step]


def _sheets(stem: Path, balls: dict[int, list[Passing]], shown: dict[int, dict[str, np.ndarray]]) -> None:
    """Crops around each moving ball (contacts: around all that meet), the worst first."""
    rows = []
    for place, pictures in shown.items():
        for ball in balls[place]:
            x, y = np.rint(ball.centre).astype(int)
            half = int(2 * ball.radius)
            here = np.s_[max(y - half, 0) : y + half, max(x - half, 0) : x + half]
            error = float(((pictures["trueroll"][here].astype(float) - pictures["real"][here]) ** 2).mean())
            rows.append((error, ball.kind, (f"{place} {ball.ball} {ball.kind}", [ball], pictures)))
    rows.sort(key=lambda row: -row[0])
    drawn = np.random.default_rng(SEED).permutation(len(rows))[:DRAWN]
    write_sheet(stem.with_name(f"{stem.name}_worst.png"), [row for *_, row in rows[:WORST]])
    write_sheet(stem.with_name(f"{stem.name}_drawn.png"), [rows[k][2] for k in drawn])
    write_sheet(stem.with_name(f"{stem.name}_contacts.png"), [row for _, kind, row in rows if kind == "contact"])


def print_table(title: str, tallies: Tallies) -> None:
    print(f"\n## {title}\n")
    cells = " | ".join(f"{kind} dB | px | missing, doubled" for kind in CLASSES)
    print(f"| method | {cells} | elsewhere dB | SSIM | stirred dB |\n|{'---|' * (3 * len(CLASSES) + 4)}")
    for method, found in tallies.items():
        parts = []
        for kind in CLASSES:
            t = found[kind]
            parts += [
                f"{t.psnr:.1f} ({t.middle:.1f})",
                f"{t.centre:.2f}",
                f"{t.missing}, {t.doubled} of {len(t.centres)}",
            ]
        elsewhere = found["elsewhere"]
        parts += [f"{elsewhere.psnr:.2f}", f"{np.mean(elsewhere.ssim):.4f}", f"{found['stirred'].psnr:.1f}"]
        print(f"| {method} | {' | '.join(parts)} |", flush=True)


def pooled(all_tallies: list[Tallies]) -> Tallies:
    total: Tallies = defaultdict(lambda: defaultdict(Tally))
    for tallies in all_tallies:
        for method, by_class in tallies.items():
            for kind, tally in by_class.items():
                mine = total[method][kind]
                mine.squares += tally.squares
                mine.centres += tally.centres
                mine.ssim += tally.ssim
                mine.missing += tally.missing
                mine.doubled += tally.doubled
    return total


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out" / "interpolation", help="where sheets go")
    parser.add_argument("--only", default="", help="every real clip whose name holds this word; default three")
    parser.add_argument("--step", type=int, default=2, help="one of so many pictures stays visible")
    parser.add_argument("--gaps", type=int, default=40, help="withheld pictures to score per clip")
    parser.add_argument("--reuse", action="store_true", help="take what the rivals made before")
    parser.add_argument("--rendered", action="store_true", help="rendered films of the sample shots, not real clips")
    parser.add_argument("--anew", type=int, default=1, help="shots drawn anew from each sample, with --rendered")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    all_tallies = []
    for case in rendered_cases(arguments) if arguments.rendered else real_cases(arguments):
        all_tallies.append(score_case(case, arguments))
        print_table(f"{case.held.source.stem}, 1 of {case.held.step} visible", all_tallies[-1])
    if len(all_tallies) > 1:
        print_table("all clips", pooled(all_tallies))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
