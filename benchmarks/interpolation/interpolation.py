"""Withhold frames of clips, interpolate them, and compare trueroll with its rivals and an oracle.

    python -m benchmarks.interpolation.interpolation [--quick] [-o DIR] [--only WORD] [--step 2] [--gaps 40] [--reuse]
        [--rendered] [--new-shots N]

Prints one table per clip and one over all: PSNR on the paths of the balls by class of gap (contact, fast: further than
a radius, slow), distance from the ball's real position, missing and doubled balls, and the rest of the frame
(`changing`: where something else moves). The oracle is the best translated sprite on the real frame; elsewhere it has
no meaning. For rendered clips (the samples, and N new shots from each), the reference is the same shot filmed again,
with other noise. DIR gets sheets of the worst, of random and of all contact frames. Needs the footage of ../shared/data
for real clips; RIFE gets an environment of its own and is left out where that cannot be made. Takes tens of minutes.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.interpolation.frame_scores import FrameTally, WithheldFrame, score_frame, to_decibels
from benchmarks.interpolation.frame_sheets import write_sheet
from benchmarks.interpolation.interpolation_rivals import FlowBothWays, blend_frames, run_minterpolate
from benchmarks.interpolation.rendered_clips import film_sample, generate_samples, read_sample_film
from benchmarks.interpolation.rife_frames import run_rife
from benchmarks.interpolation.withheld_frames import WithheldClip, interpolate_with_trueroll, read_all_frames, withhold
from benchmarks.interpolation.withheld_truth import (
    CLASSES,
    BallLocator,
    Passing,
    estimate_plate,
    find_passings,
    make_ball_locator,
    render_oracle,
)
from benchmarks.support.figures import (
    Figure,
    MissingInputError,
    add_quick_option,
    estimate_median,
    estimate_share,
    estimate_statistic,
    keep_recorded,
    run_quick,
)
from benchmarks.support.run_folder import FOOTAGE, ROOT, read_run, run_clip
from video.synthesis.frame_synthesis import subsample_chroma

CLIPS = ("carom_F1", "pool8_game2_clip1", "snooker_video_13_0030_0034")
SEED, RANDOM, WORST = 7, 8, 12
RIVALS = ("blend", "DIS both ways", "minterpolate", "RIFE")
# Sample clip and number of scored frames for `--quick`.
QUICK_CLIP, QUICK_GAPS = "carom_match", 10
# Frames by method and index.
FramesByMethod = dict[str, dict[int, np.ndarray]]
# Tallies by method and class.
Tallies = dict[str, dict[str, FrameTally]]


def load_or_make_rivals(stem: Path, reuse: bool, make: Callable[[], FramesByMethod]) -> FramesByMethod:
    """Load the frames of the rivals from files, or make and save them: they take a second each and do not change."""
    files = {rival: stem.with_name(f"{stem.name}_{rival.split()[0]}.npz") for rival in RIVALS}
    if reuse and all(file.is_file() for file in files.values()):
        stored = {rival: np.load(file) for rival, file in files.items()}
        return {rival: {int(k): file[k] for k in file.files} for rival, file in stored.items()}
    frames = make()
    for rival, made in frames.items():
        np.savez(files[rival], **{str(k): v for k, v in made.items()})
    return frames


def make_rival_frames(withheld: WithheldClip, frames: list[np.ndarray], places: list[int]) -> FramesByMethod:
    """Make the frames of every rival at the given indices."""
    return make_plain_rivals(withheld, frames, places) | make_rife_frames(withheld, frames, places)


def make_plain_rivals(withheld: WithheldClip, frames: list[np.ndarray], places: list[int]) -> FramesByMethod:
    """Make the frames of the rivals that need no environment of their own."""
    blends, flows, compensated = {}, {}, {}
    for row in sorted({place // withheld.step for place in places}):
        low, high = max(row - 1, 0), min(row + 3, len(withheld.visible))
        near = [frames[k * withheld.step] for k in range(low, high)]
        by_ffmpeg = run_minterpolate(near, withheld.step)
        flow = FlowBothWays(*(frames[(row + side) * withheld.step] for side in (0, 1)))
        for place in (p for p in places if p // withheld.step == row):
            share = place % withheld.step / withheld.step
            blends[place] = blend_frames(*flow.frames, share)
            flows[place] = flow.synthesize(share)
            compensated[place] = by_ffmpeg[place - low * withheld.step]
    return dict(zip(RIVALS, (blends, flows, compensated), strict=False))


def make_rife_frames(withheld: WithheldClip, frames: list[np.ndarray], places: list[int]) -> FramesByMethod:
    """Make the frames of RIFE; none, and a sentence, where its environment cannot be made or the step suits it not."""
    step, rows = withheld.step, sorted({place // withheld.step for place in places})
    if step & (step - 1):
        print(f"RIFE is left out: it halves gaps, and {step} is not a power of 2")
        return {}
    first, second = (np.stack([frames[(row + side) * step] for row in rows]) for side in (0, 1))
    try:
        filled = run_rife(first, second, step)
    except MissingInputError as error:
        print(f"RIFE is left out: {error}")
        return {}
    return {"RIFE": {place: filled[rows.index(place // step), place % step - 1] for place in places}}


def select_gaps(balls: dict[int, list[Passing]], most: int, rng: np.random.Generator) -> list[int]:
    """Select frames to score: at most half of them with contacts, the others at random."""
    contacts = [place for place, passings in balls.items() if any(b.kind == "contact" for b in passings)]
    contacts = sorted(rng.permutation(contacts)[: most // 2].tolist())
    others = [place for place in balls if place not in contacts]
    return sorted({*contacts, *rng.permutation(others)[: most - len(contacts)].tolist()})


@dataclass(frozen=True)
class InterpolationCase:
    """A clip with withheld frames, and their truth."""

    withheld: WithheldClip
    frames: list[np.ndarray]
    """D frames, visible and withheld."""
    passings: list[Passing]
    locate_balls: BallLocator
    again: list[np.ndarray] | None = None
    """D frames of the same shot filmed again; None: the oracle is the best sprite."""


def read_real_cases(arguments: argparse.Namespace) -> Iterator[InterpolationCase]:
    """Read real clips, with ball positions from a run on the whole clip."""
    if not FOOTAGE.is_dir():
        raise SystemExit(f"real footage is not at {FOOTAGE}")
    word = arguments.only
    for source in sorted(FOOTAGE.glob("*.mp4")):
        if word not in source.stem if word else source.stem not in CLIPS:
            continue
        full = arguments.out / f"full_{source.stem}"
        if not (full / "tracks.csv").is_file():
            outcome = run_clip(source, full)
            if not (full / "tracks.csv").is_file():
                raise SystemExit(f"the run of {source.name} failed: {outcome.sentence}")
        withheld, run = withhold(source, arguments.step, arguments.out), read_run(full)
        yield InterpolationCase(
            withheld, read_all_frames(withheld), list(find_passings(withheld, run)), make_ball_locator(withheld, run)
        )


def render_cases(arguments: argparse.Namespace) -> Iterator[InterpolationCase]:
    """Render clips of the sample shots and of new ones."""
    for sample in generate_samples(arguments.only, arguments.new_shots, SEED):
        film = film_sample(sample, arguments.out)
        yield InterpolationCase(
            film.withheld, read_all_frames(film.withheld), film.passings, film.locate_balls, film.again
        )


def score_case(case: InterpolationCase, arguments: argparse.Namespace) -> Tallies:
    """Score one clip and write its sheets."""
    withheld, frames, stem = case.withheld, case.frames, arguments.out / case.withheld.source.stem
    balls: dict[int, list[Passing]] = defaultdict(list)
    for passing in case.passings:
        balls[passing.place].append(passing)
    places = select_gaps(balls, arguments.gaps, np.random.default_rng(SEED))
    ours = interpolate_with_trueroll(withheld)
    for k, real in enumerate(frames[:: withheld.step]):
        if not np.array_equal(ours[k * withheld.step], real):
            raise SystemExit(f"{withheld.name}: the original frame {k} was changed")
    rivals_stem = stem.with_name(f"{stem.name}_{withheld.step}_{arguments.gaps}")
    rivals = load_or_make_rivals(rivals_stem, arguments.reuse, lambda: make_rival_frames(withheld, frames, places))
    plate = estimate_plate(frames, case.locate_balls)
    tallies: Tallies = defaultdict(lambda: defaultdict(FrameTally))
    shown = {}
    for place in places:
        around = _visible_neighbours(withheld, frames, place)
        scored = WithheldFrame.build(balls[place], frames[place], around, plate)
        synthesised = {"trueroll": ours[place], **{n: _subsample_colour(r[place]) for n, r in rivals.items()}}
        if case.again is None:
            synthesised["oracle"] = _subsample_colour(render_oracle(balls[place], frames[place], around, plate))
        else:
            synthesised["filmed again"] = case.again[place]
        for method, frame in synthesised.items():
            score_frame(scored, frame, tallies[method])
        shown[place] = {"before": around[0], "real": frames[place], **synthesised, "after": around[1]}
    _write_sheets(stem, balls, shown)
    return tallies


def _subsample_colour(image: np.ndarray) -> np.ndarray:
    """Subsample the colour to 2 x 2 pixels, as in all these clips, so that no method loses by the coding."""
    filmed = image.copy()
    subsample_chroma(filmed, (0, 0, image.shape[1], image.shape[0]))
    return filmed


def _visible_neighbours(withheld: WithheldClip, frames: list[np.ndarray], place: int) -> tuple[np.ndarray, np.ndarray]:
    row = place // withheld.step
    return frames[row * withheld.step], frames[(row + 1) * withheld.step]


def _write_sheets(stem: Path, balls: dict[int, list[Passing]], shown: dict[int, dict[str, np.ndarray]]) -> None:
    """Write crops around each moving ball: the worst, random ones, and all contacts."""
    rows = []
    for place, frames in shown.items():
        for ball in balls[place]:
            x, y = np.rint(ball.centre).astype(int)
            half = int(2 * ball.radius)
            here = np.s_[max(y - half, 0) : y + half, max(x - half, 0) : x + half]
            error = float(((frames["trueroll"][here].astype(float) - frames["real"][here]) ** 2).mean())
            rows.append((error, ball.kind, (f"{place} {ball.ball} {ball.kind}", [ball], frames)))
    rows.sort(key=lambda row: -row[0])
    chosen = np.random.default_rng(SEED).permutation(len(rows))[:RANDOM]
    write_sheet(stem.with_name(f"{stem.name}_worst.png"), [row for *_, row in rows[:WORST]])
    write_sheet(stem.with_name(f"{stem.name}_random.png"), [rows[k][2] for k in chosen])
    write_sheet(stem.with_name(f"{stem.name}_contacts.png"), [row for _, kind, row in rows if kind == "contact"])


def print_table(title: str, tallies: Tallies) -> None:
    print(f"\n## {title}\n")
    cells = " | ".join(f"{kind} dB | px | missing, doubled" for kind in CLASSES)
    print(f"| method | {cells} | elsewhere dB | SSIM | changing dB |\n|{'---|' * (3 * len(CLASSES) + 4)}")
    for method, by_class in tallies.items():
        parts = []
        for kind in CLASSES:
            t = by_class[kind]
            parts += [
                f"{t.psnr:.1f} ({t.median_psnr:.1f})",
                f"{t.median_centre_error:.2f}",
                f"{t.missing}, {t.doubled} of {len(t.centre_errors)}",
            ]
        elsewhere = by_class["elsewhere"]
        parts += [f"{elsewhere.psnr:.2f}", f"{np.mean(elsewhere.ssim):.4f}", f"{by_class['changing'].psnr:.1f}"]
        print(f"| {method} | {' | '.join(parts)} |", flush=True)


def pool_tallies(all_tallies: list[Tallies]) -> Tallies:
    total: Tallies = defaultdict(lambda: defaultdict(FrameTally))
    for tallies in all_tallies:
        for method, by_class in tallies.items():
            for kind, tally in by_class.items():
                mine = total[method][kind]
                mine.squared_errors += tally.squared_errors
                mine.centre_errors += tally.centre_errors
                mine.ssim += tally.ssim
                mine.missing += tally.missing
                mine.doubled += tally.doubled
    return total


def measure_figures(out: Path) -> list[Figure]:
    """Measure the figures of the documentation on a sample clip, all classes of gaps together."""
    film = read_sample_film(QUICK_CLIP, out)
    case = InterpolationCase(film.withheld, read_all_frames(film.withheld), film.passings, film.locate_balls)
    tallies = score_case(case, argparse.Namespace(out=out, gaps=QUICK_GAPS, reuse=False))
    figures = []
    for method, by_class in tallies.items():
        errors = np.concatenate([by_class[kind].squared_errors for kind in CLASSES])
        centres = np.concatenate([by_class[kind].centre_errors for kind in CLASSES])
        figures += [
            estimate_statistic(f"{method}: PSNR on the paths of balls", errors, "dB", lambda x: to_decibels(x.mean())),
            estimate_median(f"{method}: distance of a ball from its place, median", centres, "px"),
        ]
    if "RIFE" not in tallies:
        figures += keep_recorded("interpolation.interpolation", "RIFE", "see above")
    ours = [tallies["trueroll"][kind] for kind in CLASSES]
    count, wrong = sum(len(t.centre_errors) for t in ours), sum(t.missing + t.doubled for t in ours)
    return [*figures, estimate_share("trueroll: balls missing or doubled", wrong, count)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_quick_option(parser)
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out" / "interpolation", help="folder of the sheets")
    parser.add_argument(
        "--only", default="", help="only clips whose name contains this word; default: three real clips"
    )
    parser.add_argument("--step", type=int, default=2, help="every STEP-th frame stays visible")
    parser.add_argument("--gaps", type=int, default=40, help="withheld frames to score per clip")
    parser.add_argument("--reuse", action="store_true", help="reuse stored frames of the rivals")
    parser.add_argument(
        "--rendered", action="store_true", help="rendered clips of the sample shots instead of real clips"
    )
    parser.add_argument("--new-shots", type=int, default=1, help="new shots from each sample, with --rendered")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    if arguments.quick:
        inputs = f"every other frame of `{QUICK_CLIP}` withheld (30 to 15 fps), {QUICK_GAPS} gaps, seed {SEED}"
        run_quick("interpolation.interpolation", lambda: measure_figures(arguments.out), inputs)
        return 0
    all_tallies = []
    for case in render_cases(arguments) if arguments.rendered else read_real_cases(arguments):
        all_tallies.append(score_case(case, arguments))
        print_table(f"{case.withheld.source.stem}, 1 of {case.withheld.step} visible", all_tallies[-1])
    if len(all_tallies) > 1:
        print_table("all clips", pool_tallies(all_tallies))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
