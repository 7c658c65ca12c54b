"""Count events, errors and balls that are false in short clips in which things that are no balls move.

    python -m benchmarks.clips.traps [-o DIR] [--clips 200] [--seed 1] [--kinds ring,hand]

Clip K of a seed is always the same. In most clips all balls lie still, so that every event is false. In one clip in
four, the thing moves over a sample clip, whose true events are known. A run resumes: clips and run folders in DIR stay.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from benchmarks.clips.samples import SAMPLES
from benchmarks.clips.varied_clips import VIEWS, draw_camera, draw_clip, make
from benchmarks.support.row_files import append_row, read_rows
from benchmarks.support.run_folder import ROOT, RunFolder, read_columns, read_run, run_clip
from models.core.scene import Camera, Table
from models.core.srgb import decode_srgb, encode_srgb
from models.core.typing import FloatArray, ImageArray
from video.rendering.player_props import draw_rods, make_cue_rods, make_hand_rods
from video.rendering.scene_renderer import BallPoses, SceneView, apply_sensor_model, build_view, render_exposure

# px, frames and frames per second of a clip: 2.2 s.
SIZE, FRAMES, RATE = (640, 360), 56, 25
# Frames of a sample clip that are used; its stroke falls within the first half second.
SAMPLE_FRAMES = 75
LIKELY, SURE = 0.9, 0.99
# Largest time and distance between a reported and a true event that match.
MATCHING_SECONDS, MATCHING_RADII = 0.12, 4.0


@dataclass(frozen=True)
class TrapRow:
    """Result of one clip."""

    clip: str
    kind: str
    status: int
    seconds: float
    balls: int
    false_balls: int
    """Reported balls that lie or move where no ball does."""
    events: int
    likely: int
    """False events at 0.9 or more."""
    sure: int
    """False events at 0.99 or more."""
    sentence: str
    """The last line of a run that failed, otherwise the false events."""


@dataclass(frozen=True)
class Stage:
    """Where a thing moves: the table through its camera, with the balls at rest."""

    table: Table
    camera: Camera
    rest: FloatArray
    """(N, 2) m, places of the balls in the first frame."""
    view: SceneView | None
    """None over a sample clip."""


# Paints the thing over an image (H, W, 3) of a moment, 0 to 1 through the clip.
Painter = Callable[[ImageArray, float], ImageArray]
TrapMaker = Callable[[Stage, np.random.Generator], Painter]


def draw_path(stage: Stage, rng: np.random.Generator, inset: float = 0.1) -> Callable[[float], FloatArray]:
    """Draw a path over the cloth with two turns and halts, which passes over a ball; m as a function of 0 to 1."""
    size = np.array([stage.table.length, stage.table.width])
    stops = rng.uniform(inset, 1 - inset, (4, 2)) * size
    stops[rng.integers(1, 4)] = stage.rest[rng.integers(len(stage.rest))]
    times = np.cumsum(np.append(rng.uniform(0, 0.3), rng.uniform(0.1, 0.5, 3)))
    times /= max(1.0, float(times[-1]))

    def place(s: float) -> FloatArray:
        return np.array([np.interp(s, times, stops[:, axis]) for axis in (0, 1)])

    return place


def to_px(stage: Stage, xy: FloatArray, z: float = 0.0) -> FloatArray:
    return np.asarray(stage.camera.to_pixels(xy, z), np.float64)


def draw_circle(stage: Stage, xy: FloatArray, radii: float) -> FloatArray:
    """Return points (n, 2) px of a circle on the cloth, `radii` in ball radii."""
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    return to_px(stage, xy + radii * stage.table.ball_radius * np.column_stack([np.cos(angle), np.sin(angle)]))


def paint_mask(shape: tuple[int, ...], points: FloatArray, thickness: int | None, closed: bool = True) -> FloatArray:
    """Return the coverage (H, W), 0 to 1, of an outline, or of an area where `thickness` is None."""
    mask = np.zeros(shape[:2], np.uint8)
    fixed = [np.rint(points * 16).astype(np.int32)]
    if thickness is None:
        cv2.fillPoly(mask, fixed, 255, cv2.LINE_AA, 4)
    else:
        cv2.polylines(mask, fixed, closed, 255, thickness, cv2.LINE_AA, 4)
    return mask / 255.0


def add_light(image: ImageArray, mask: FloatArray, colour: FloatArray) -> ImageArray:
    """Add projected light of a colour (3,): everything reflects it in its own colour, and hides nothing."""
    linear = decode_srgb(image / 255.0)
    lit = linear * (1 + mask[..., None] * colour)
    return np.asarray(255 * encode_srgb(np.clip(lit, 0, 1)) + 0.5, np.uint8)


def blend(image: ImageArray, mask: FloatArray, colour: FloatArray) -> ImageArray:
    """Paint an opaque colour (3,), 0 to 255, over an image."""
    return np.asarray(image + (colour - image) * mask[..., None] + 0.5, np.uint8)


def make_still(stage: Stage, rng: np.random.Generator) -> Painter:
    return lambda image, s: image


def make_ring(stage: Stage, rng: np.random.Generator) -> Painter:
    """A projector's ring runs over the cloth, sometimes with its lines."""
    place, radii, light = draw_path(stage, rng), rng.uniform(0.8, 1.6), rng.uniform(1.0, 5.0) * rng.uniform(0.5, 1, 3)
    thick, line = int(rng.integers(1, 4)), rng.random() < 0.5

    def paint(image: ImageArray, s: float) -> ImageArray:
        mask = paint_mask(image.shape, draw_circle(stage, place(s), radii), thick)
        if line:
            ends = to_px(stage, np.array([place(0.0), place(1.0)]))
            mask = np.maximum(mask, paint_mask(image.shape, ends, 1, False))
        return add_light(image, mask, light)

    return paint


def make_light_spot(stage: Stage, rng: np.random.Generator) -> Painter:
    """A round spot of light, sharp or soft, runs over the table: a torch, a pointer, a lamp's glare."""
    place, radii, light = draw_path(stage, rng), rng.uniform(0.7, 2.0), rng.uniform(0.5, 4.0) * rng.uniform(0.7, 1, 3)
    soft = rng.uniform(0.0, 0.5)

    def paint(image: ImageArray, s: float) -> ImageArray:
        circle = draw_circle(stage, place(s), radii)
        mask = paint_mask(image.shape, circle, None)
        sigma = soft * float(np.ptp(circle, axis=0).max()) / 2
        return add_light(image, cv2.GaussianBlur(mask, (0, 0), sigma) if sigma > 0.3 else mask, light)

    return paint


def make_lines(stage: Stage, rng: np.random.Generator) -> Painter:
    """Projected lines turn about a ball, as aiming aids do."""
    pivot, angle = stage.rest[rng.integers(len(stage.rest))], rng.uniform(0, 2 * np.pi)
    turn, light, thick = rng.uniform(-2, 2), rng.uniform(1.0, 5.0) * rng.uniform(0.5, 1, 3), int(rng.integers(1, 4))

    def paint(image: ImageArray, s: float) -> ImageArray:
        at = angle + turn * s
        far = pivot + rng_length * np.array([np.cos(at), np.sin(at)])
        mask = paint_mask(image.shape, to_px(stage, np.array([pivot, far])), thick, False)
        return add_light(image, np.maximum(mask, paint_mask(image.shape, draw_circle(stage, pivot, 1.5), thick)), light)

    rng_length = float(rng.uniform(0.3, 0.8)) * stage.table.length
    return paint


def make_cursor(stage: Stage, rng: np.random.Generator) -> Painter:
    """A mouse cursor moves over the screen: an arrow, or a round pointer."""
    place, size = draw_path(stage, rng), float(rng.uniform(14, 26))
    arrow = np.array([[0, 0], [0, 1], [0.23, 0.78], [0.38, 1.1], [0.52, 1.03], [0.38, 0.72], [0.68, 0.7]]) * size
    is_round, tint = rng.random() < 0.4, rng.uniform(150, 255, 3)

    def paint(image: ImageArray, s: float) -> ImageArray:
        at = to_px(stage, place(s))
        if is_round:
            circle = at + size / 3 * np.column_stack([np.cos(np.arange(32) / 5.09), np.sin(np.arange(32) / 5.09)])
            return blend(image, 0.7 * paint_mask(image.shape, circle, None), tint)
        image = blend(image, paint_mask(image.shape, at + arrow, None), np.full(3, 255.0))
        return blend(image, paint_mask(image.shape, at + arrow, 1), np.zeros(3))

    return paint


def make_drawing(stage: Stage, rng: np.random.Generator) -> Painter:
    """Marks are drawn over the image: a growing stroke, a circle around a ball, a disc that is dragged."""
    place, colour = draw_path(stage, rng), rng.choice([[255, 230, 0], [255, 40, 40], [240, 240, 240]]).astype(float)
    thick, disc = int(rng.integers(2, 5)), rng.random() < 0.5
    radii = float(rng.uniform(0.8, 1.4))

    def paint(image: ImageArray, s: float) -> ImageArray:
        stroke = to_px(stage, np.array([place(u) for u in np.linspace(0, s, 24)]))
        image = blend(image, paint_mask(image.shape, stroke, thick, False), colour)
        circle = draw_circle(stage, place(s), radii)
        return blend(image, paint_mask(image.shape, circle, None if disc else thick), colour)

    return paint


def make_net(stage: Stage, rng: np.random.Generator) -> Painter:
    """White nets hang in the pockets and sway."""
    corners = stage.table.pocket_centres if stage.table.pockets else stage.table.corners
    sway, pale = rng.uniform(0.1, 0.4), float(rng.uniform(190, 250))

    def paint(image: ImageArray, s: float) -> ImageArray:
        masks = []
        for k, corner in enumerate(corners):
            shift = sway * stage.table.ball_radius * np.array([np.sin(9 * s + k), np.cos(7 * s + 2 * k)])
            threads = [draw_circle(stage, corner + shift * radii, radii) for radii in (0.5, 1.0, 1.5)]
            centre = to_px(stage, corner + shift)
            threads += [np.array([centre, end, centre]) for end in draw_circle(stage, corner, 1.6)[::6]]
            masks += [paint_mask(image.shape, thread, 1) for thread in threads]
        return blend(image, np.max(masks, axis=0), np.full(3, pale))

    return paint


def make_hand(stage: Stage, rng: np.random.Generator) -> Painter:
    """A hand, with or without a cue, moves over the table and touches no ball."""
    place, angle, cue = draw_path(stage, rng, 0.2), float(rng.uniform(0, 2 * np.pi)), rng.random() < 0.5
    forward = np.array([np.cos(angle), np.sin(angle)])
    sleeve = tuple(float(c) for c in rng.uniform(0.02, 0.8, 3))

    def paint(image: ImageArray, s: float) -> ImageArray:
        if stage.view is None:
            return image
        linear = decode_srgb(image / 255.0).astype(np.float32) / stage.view.appearance.brightness
        at = np.append(place(s), 0.0)
        rods = make_hand_rods(at, forward, (sleeve[0], sleeve[1], sleeve[2]))
        if cue:
            rods = (*rods, *make_cue_rods(at + np.append(0.2 * forward, 0.04), forward))
        draw_rods(linear, stage.camera, stage.view.lens, stage.view.illumination, rods)
        return np.asarray(255 * encode_srgb(np.clip(linear * stage.view.appearance.brightness, 0, 1)) + 0.5, np.uint8)

    return paint


def make_reflection(stage: Stage, rng: np.random.Generator) -> Painter:
    """The mirror image of something round and pale moves in a pane of glass: translucent, and over the rails too."""
    start, end = rng.uniform(-0.1, 1.1, (2, 2)) * [stage.table.length, stage.table.width]
    radii, opacity, colour = float(rng.uniform(0.8, 2.0)), float(rng.uniform(0.15, 0.6)), rng.uniform(120, 255, 3)

    def paint(image: ImageArray, s: float) -> ImageArray:
        circle = draw_circle(stage, start + s * (end - start), radii)
        mask = cv2.GaussianBlur(paint_mask(image.shape, circle, None), (0, 0), 1.0)
        return blend(image, opacity * mask, colour)

    return paint


def make_scoreboard(stage: Stage, rng: np.random.Generator) -> Painter:
    """A scoreboard with round icons slides over the table's edge."""
    side, height = int(rng.integers(2)), int(rng.integers(26, 60))
    colours = rng.uniform(30, 255, (6, 3))

    def paint(image: ImageArray, s: float) -> ImageArray:
        rows = image.shape[0]
        top = round((1 - min(2 * s, 1.0)) * -height) if side else round(rows - height * min(2 * s, 1.0))
        board = image.copy()
        cv2.rectangle(board, (60, top), (image.shape[1] - 60, top + height), (20, 28, 50), -1)
        for k, colour in enumerate(colours):
            centre = (90 + 40 * k + round(60 * s), top + height // 2)
            cv2.circle(board, centre, height // 4, [float(c) for c in colour], -1, cv2.LINE_AA)
        return board

    return paint


def make_knock(stage: Stage, rng: np.random.Generator) -> Painter:
    """Something knocks against the camera: the image jumps, swings and stays a little off."""
    at, size, after = rng.uniform(0.3, 0.7), rng.uniform(3, 12, 2) * rng.choice([-1, 1], 2), rng.uniform(-1, 1)

    def paint(image: ImageArray, s: float) -> ImageArray:
        since = s - at
        swing = (np.exp(-12 * since) * np.cos(60 * since) + 0.15 * after) if since > 0 else 0.0
        shift = np.array([[1, 0, swing * size[0]], [0, 1, swing * size[1]]])
        moved = cv2.warpAffine(image, shift, image.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(moved, np.uint8)

    return paint


def make_damage(stage: Stage, rng: np.random.Generator) -> Painter:
    """Packets are lost: blocks stay as they were, or come from elsewhere in the image."""
    at, grid = rng.uniform(0.2, 0.6), rng.random((64, 64)) < rng.uniform(0.05, 0.4)
    last: list[ImageArray] = []
    shift = rng.integers(-24, 24, 2)

    def paint(image: ImageArray, s: float) -> ImageArray:
        last.append(image)
        if not at < s < at + 0.2:
            return image
        mask = np.kron(grid, np.ones((16, 16), bool))[: image.shape[0], : image.shape[1], None]
        return np.where(mask, np.roll(last[max(len(last) - 8, 0)], shift, (0, 1)), image)

    return paint


TRAPS: dict[str, TrapMaker] = {
    "still": make_still, "ring": make_ring, "light spot": make_light_spot, "lines": make_lines, "cursor": make_cursor,
    "drawing": make_drawing, "net": make_net, "hand": make_hand, "reflection": make_reflection,
    "scoreboard": make_scoreboard, "knock": make_knock, "damage": make_damage,
}  # fmt: skip
# One clip in so many is made over a sample clip.
SAMPLE_SHARE = 4


def make_trap(seed: int, number: int, path: Path) -> tuple[str, dict[str, Any]]:
    """Write trap `number` of a seed; return its kind, and the truth: balls (T, N, 2) px and events."""
    kinds = list(TRAPS)
    kind = kinds[number % len(kinds)]
    rng = np.random.default_rng([seed, number, 7])
    over_sample = (number // len(kinds)) % SAMPLE_SHARE == SAMPLE_SHARE - 1 and kind != "hand"
    stage, images, truth = (open_sample if over_sample else render_still)(seed, number)
    paint = TRAPS[kind](stage, rng)
    count = truth["frames"]
    if not path.is_file():
        write_clip(path, (paint(image, k / (count - 1)) for k, image in enumerate(images)), truth["rate"])
    return kind, truth


def render_still(seed: int, number: int) -> tuple[Stage, Iterator[ImageArray], dict[str, Any]]:
    """Render balls at rest, with new noise in every frame."""
    sample, rng = draw_clip(seed, number), np.random.default_rng([seed, number, 8])
    camera = draw_camera(sample.table, VIEWS[0 if number % 3 else 1 + number % 2], SIZE, rng)
    view = build_view(sample.table, camera, sample.appearance, tuple(ball.appearance for ball in sample.balls))
    rest = np.array([[ball.x, ball.y] for ball in sample.balls])
    xyz = np.column_stack([rest, np.full(len(rest), sample.table.ball_radius)])
    poses = BallPoses(xyz, np.tile(np.eye(3), (len(rest), 1, 1)))
    light = render_exposure(view, lambda t: poses, 0.0)
    images = (apply_sensor_model(view, light, rng) for _ in range(FRAMES))
    px = camera.to_pixels(rest, sample.table.ball_radius)
    truth = {"frames": FRAMES, "rate": RATE, "px": np.tile(px, (FRAMES, 1, 1)), "events": []}
    return Stage(sample.table, camera, rest, view), images, truth


def open_sample(seed: int, number: int) -> tuple[Stage, Iterator[ImageArray], dict[str, Any]]:
    """Open the beginning of a sample clip, smaller."""
    path = sorted(SAMPLES.glob("*.mp4"))[number % 6]
    facts, rows = json.loads(path.with_suffix(".truth.json").read_text()), read_columns(path.with_suffix(".truth.csv"))
    scale = SIZE[0] / facts["width_px"]
    size = (SIZE[0], round(facts["height_px"] * scale / 2) * 2)
    resize = np.diag([scale, scale, 1.0])
    matrix = resize @ np.array(facts["camera"]["matrix"])
    names = list(dict.fromkeys(rows["id"]))
    frames = min(SAMPLE_FRAMES, facts["pictures"])
    px = np.full((frames, len(names), 2), np.nan)
    for frame, name, x, y in zip(rows["frame"].astype(int), rows["id"], rows["x_px"], rows["y_px"], strict=True):
        if frame < frames:
            px[frame, names.index(name)] = scale * x, scale * y
    first = rows["frame"] == 0
    times = rows["t"][np.unique(rows["frame"], return_index=True)[1]]
    table = Table(**{k: facts["table"][k] for k in ("name", "game", "length", "width", "pockets")},
                  ball_radius=facts["ball_radius"], ball_mass=0.17)  # fmt: skip
    corners = np.array([matrix @ [*corner, 0.0, 1.0] for corner in table.corners])
    camera = Camera(matrix, *size, corners[:, :2] / corners[:, 2:], np.eye(8), "cloth", 2.0, 0.3)
    events = [
        {**event, "frame": float(np.interp(event["t"], times, np.arange(len(times))))}
        for event in facts["events"]
        if event["t"] <= times[frames - 1]
    ]
    rate = Fraction(facts["fps"] or 30)
    truth = {"frames": frames, "rate": rate, "px": px, "events": events, "names": names}

    def read_images() -> Iterator[ImageArray]:
        with av.open(str(path)) as container:
            for k, frame in enumerate(container.decode(video=0)):
                if k == frames:
                    return
                image = frame.to_ndarray(format="rgb24")
                yield np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)

    return Stage(table, camera, np.column_stack([rows["x"], rows["y"]])[first], None), read_images(), truth


def write_clip(path: Path, images: Iterator[ImageArray], rate: Fraction | int, times: FloatArray | None = None) -> None:
    """Encode images (H, W, 3) at an even rate, or shown at `times` (T,) s."""
    part = path.with_suffix(".part.mp4")
    with av.open(str(part), "w") as container:
        stream = container.add_stream("libx264", rate=rate)
        stream.pix_fmt, stream.options = "yuv420p", {"crf": "21", "preset": "fast"}
        base = Fraction(1, make.CLOCK_HZ)
        if times is not None:
            stream.time_base = stream.codec_context.time_base = base
            stream.options |= {"bf": "0", "x264-params": "force-cfr=1"}
        for k, image in enumerate(images):
            if k == 0:
                stream.height, stream.width = image.shape[:2]
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
            if times is not None:
                frame.pts, frame.time_base = round(float(times[k]) / base), base
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    part.replace(path)


def score_run(clip: Path, kind: str, truth: dict[str, Any], run: RunFolder, seconds: float) -> TrapRow:
    """Count false balls and false events."""
    tracks, events = run.tracks, run.events
    balls = [str(name) for name in dict.fromkeys(tracks["id"])]
    false_balls = [name for name in balls if not is_true_ball(tracks, name, truth)]
    wrong = [k for k in range(len(events["kind"])) if not is_true_event(events, k, run, truth)]
    described = [
        f"{events['kind'][k]} {events['a'][k]} {events['b'][k]} {events['t'][k]:.2f} s {events['probability'][k]:.3f}"
        for k in wrong
    ]
    likely, sure = (sum(events["probability"][k] >= limit for k in wrong) for limit in (LIKELY, SURE))
    text = "; ".join([*(f"no ball: {name}" for name in false_balls), *described])
    return TrapRow(clip.stem, kind, 0, seconds, len(balls), len(false_balls), len(events["kind"]), likely, sure, text)


def is_true_ball(tracks: dict[str, np.ndarray], name: str, truth: dict[str, Any]) -> bool:
    """Return whether nine of ten observed places of a ball are those of one and the same true ball."""
    rows = (tracks["id"] == name) & (tracks["observed"] == 1) & (tracks["frame"] < truth["frames"])
    if not rows.any():
        return False
    px = np.stack([tracks["x_px"][rows], tracks["y_px"][rows]], axis=-1)
    gap = np.linalg.norm(truth["px"][tracks["frame"][rows].astype(int)] - px[:, None], axis=-1)
    near = gap < np.maximum(2.0 * tracks["radius_px"][rows], 10.0)[:, None]  # a knock moves the image by 12 px
    return bool(near.mean(axis=0).max() > 0.9)


def is_true_event(events: dict[str, np.ndarray], k: int, run: RunFolder, truth: dict[str, Any]) -> bool:
    """Return whether an event of this kind happens near its place and time."""
    if not len(truth["events"]):
        return False
    radius = float(np.median(run.tracks["radius_px"]))
    px = run.to_pixels(np.array([events["x"][k], events["y"][k]]))
    for event in truth["events"]:
        frame = int(np.clip(round(event["frame"]), 0, truth["frames"] - 1))
        gap = np.linalg.norm(truth["px"][frame, truth["names"].index(event["a"])] - px)
        late = abs(event["frame"] - events["frame"][k]) / float(truth["rate"])
        slack = 0.4 if event["kind"] == "rest" else MATCHING_SECONDS  # a rest is approached, not reached
        if event["kind"] == events["kind"][k] and late < slack and not gap > MATCHING_RADII * radius:
            return True
    return events["kind"][k] == "strike" and bool(events["t"][k] < 0.6)  # the world has no event of the strike


def print_table(rows: list[TrapRow]) -> None:
    print("\n| kind | clips | failed | refused | balls | false balls | events | false >= 0.9 | false >= 0.99 |")
    print("|---|---|---|---|---|---|---|---|---|")
    for kind in [*TRAPS, "all"]:
        own = [row for row in rows if kind in ("all", row.kind)]
        sums = [sum(getattr(row, n) for row in own) for n in ("balls", "false_balls", "events", "likely", "sure")]
        failed = sum("unexpected" in row.sentence.lower() for row in own if row.status)
        refused = sum(row.status != 0 for row in own) - failed
        print("|", " | ".join(map(str, [kind, len(own), failed, refused, *sums])), "|")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out" / "traps", help="folder of clips and runs")
    parser.add_argument("--clips", type=int, default=200, help="number of clips")
    parser.add_argument("--seed", type=int, default=1, help="seed")
    parser.add_argument("--kinds", default=",".join(TRAPS), help="kinds of traps, separated by commas")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    table, kinds = arguments.out / f"rows_{arguments.seed}.csv", arguments.kinds.split(",")
    rows = {row.clip: row for row in read_rows(table, TrapRow)}
    for number in range(arguments.clips):
        clip = arguments.out / f"trap_{arguments.seed}_{number:03}.mp4"
        if list(TRAPS)[number % len(TRAPS)] not in kinds or clip.stem in rows:
            continue
        kind, truth = make_trap(arguments.seed, number, clip)
        folder = clip.with_suffix("")
        outcome = run_clip(clip, folder, "--no-video")
        if outcome.status:
            row = TrapRow(clip.stem, kind, outcome.status, outcome.seconds, 0, 0, 0, 0, 0, outcome.sentence)
        else:
            row = score_run(clip, kind, truth, read_run(folder), outcome.seconds)
        rows[clip.stem] = row
        append_row(row, table)
        print(f"{row.clip} {kind}: {row.seconds:.0f} s {row.sentence}", file=sys.stderr, flush=True)
    print_table([row for row in rows.values() if row.kind in kinds])
    return 0


if __name__ == "__main__":
    sys.exit(main())
