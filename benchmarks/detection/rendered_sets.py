"""Measure names and colours of rendered pool balls against the paint they were rendered with.

    python -m benchmarks.detection.rendered_sets [--sets 18] [--seed 11]

Each set is a film of twelve balls at rest that turn a little, lit by one of three lights over one of four cloths, from
above or at an angle, coded as H.264 with 4:2:0 chroma. The true colour of a ball is that of the same ball without
number and stripe in the same place of a frame that is not coded.
"""

from __future__ import annotations

import argparse
import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import av
import numpy as np
from scipy.spatial.transform import Rotation
from skimage.color import rgb2lab

from benchmarks.detection.ball_looks import collect_pixels, compare_colours, measure_colour
from detectors.measurement.ball_paint import BallPaint, describe_balls, measure_paint, select_clear_frames
from models.core.ball_look import BallLook
from models.core.scene import Scene, Table
from models.core.tracks import Tracks
from models.core.typing import ByteArray
from video.rendering.pinhole_camera import look_at
from video.rendering.scene_appearance import Lamp, SceneAppearance, pool_ball
from video.rendering.scene_renderer import BallPoses, build_view, render_image

TABLE = Table("pool-9ft", "pool", 2.54, 1.27, 0.028575, 0.170, True)
MIDDLE = np.array([TABLE.length / 2, TABLE.width / 2, 0.0])
# Colours of the numbers 1 to 7 as the renderer paints them.
COLOURS = ("yellow", "blue", "red", "purple", "orange", "green", "maroon")
FRAMES = 6
CLOTHS = ((0.13, 0.47, 0.68), (0.10, 0.50, 0.27), (0.62, 0.50, 0.33), (0.55, 0.10, 0.20))
LIGHTS = ((1.0, 1.0, 1.0), (1.0, 0.85, 0.6), (0.85, 1.0, 0.8))
BRIGHTNESSES = (1.2, 1.0, 1.6)
# Widths of frames, px; tilts of the view, degrees; constant rate factors of H.264.
WIDTHS, TILTS, QUALITIES = (640, 896, 1280), (0.0, 50.0), (20, 26)


@dataclass(frozen=True)
class RenderedSet:
    """A film of balls at rest that turn on the spot."""

    frames: tuple[tuple[int, ByteArray], ...]
    tracks: Tracks
    scene: Scene
    numbers: tuple[int, ...]

    def measure(self) -> BallPaint:
        """Measure the paint of the balls."""
        rows = select_clear_frames(self.tracks, TABLE.ball_radius)
        return measure_paint(self.frames, self.tracks, rows, self.scene)

    def describe(self) -> tuple[BallLook, ...]:
        """Describe the balls."""
        return describe_balls(self.measure(), self.tracks, "pool")


def render_set(
    numbers: Sequence[int],
    seed: int,
    cloth: tuple[float, float, float] = (0.13, 0.47, 0.68),
    light: tuple[float, float, float] = (1.0, 1.0, 1.0),
    brightness: float = 1.2,
    width: int = 1280,
    tilt: float = 0.0,
    turn: float | None = None,
    is_plain: bool = False,
) -> RenderedSet:
    """Render a film.

    Args:
        numbers: Numbers of the N balls; 0 is the cue ball.
        seed: Source of places, turns and noise.
        cloth: sRGB of the cloth, 0 to 1.
        light: Factors of red, green and blue in linear light.
        brightness: As in `SceneAppearance`.
        width: Of the frames, px.
        tilt: Of the view from the vertical, degrees.
        turn: Standard deviation of the turn from frame to frame about each axis, rad; None turns balls at random.
        is_plain: Whether the balls have neither numbers nor stripes.

    Returns:
        Images and true tracks, with the classes of the balls.
    """
    rng = np.random.default_rng(seed)
    count, radius = len(numbers), TABLE.ball_radius
    distance, height = 3.68, width * 9 // 16
    angle = np.radians(tilt)
    eye = MIDDLE + np.array([0.02, 0.02 + distance * np.sin(angle), distance * np.cos(angle)])
    focal, up = 0.8 * width / TABLE.length * distance, (0.0, 0.0, 1.0) if tilt else (0.0, -1.0, 0.0)
    camera = look_at(TABLE, eye, MIDDLE, focal, width, height, up=up)
    lamps = tuple(Lamp((TABLE.length * (k + 0.5) / 3, TABLE.width / 2, 1.3), 0.16) for k in range(3))
    appearance = SceneAppearance(cloth=cloth, brightness=brightness, lamps=lamps, seed=seed)
    balls = tuple(pool_ball(number) for number in numbers)
    if is_plain:
        balls = tuple(replace(ball, style="plain", number=None) for ball in balls)
    view = build_view(TABLE, camera, appearance, balls, samples=1)
    cells = rng.permutation(18)[:count]
    xy = np.column_stack([0.25 + 0.4 * (cells % 6), 0.2 + 0.42 * (cells // 6)]) + rng.uniform(-0.06, 0.06, (count, 2))
    xyz = np.column_stack([xy, np.full(count, radius)])
    gains = np.asarray(light)
    images, pose = [], Rotation.random(count, rng)
    for frame in range(FRAMES):
        poses = BallPoses(xyz, pose.as_matrix())
        image = render_image(view, lambda _, poses=poses: poses, 0.0, rng)  # type: ignore[misc]
        levels = 255 * np.clip((image / 255.0) ** 2.2 * gains, 0, 1) ** (1 / 2.2)
        images.append((frame, np.rint(levels).astype(np.uint8)))
        step = None if turn is None else Rotation.from_rotvec(rng.normal(0.0, turn, (count, 3)))
        pose = Rotation.random(count, rng) if step is None else step * pose
    middle = rgb2lab(images[0][1])[height * 2 // 7 : height * 5 // 7, width // 4 : width * 3 // 4]
    cloth_lab = np.median(middle.reshape(-1, 3), axis=0)
    scene = Scene(TABLE, camera, cloth_lab, ())
    px = camera.to_pixels(xy, radius)
    size = np.linalg.norm(camera.to_pixels(xy + np.array([radius, 0.0]), radius) - px, axis=1)
    ids = tuple(
        f"{ball.kind}-{k + 1}" if number % 8 else ball.kind
        for k, (number, ball) in enumerate(zip(numbers, balls, strict=True))
    )
    shape = (FRAMES, count)
    tracks = Tracks(
        np.arange(FRAMES), np.arange(FRAMES) / 30, ids, tuple(ball.kind for ball in balls),
        np.broadcast_to(xy, (*shape, 2)), np.broadcast_to(px, (*shape, 2)), np.full(shape, 1e-3), np.full(shape, 1e-3),
        np.zeros((*shape, 2)), np.broadcast_to(size, shape), np.zeros((count, 3)),
    )  # fmt: skip
    return RenderedSet(tuple(images), tracks, scene, tuple(numbers))


def encode_frames(rendered: RenderedSet, quality: int) -> RenderedSet:
    """Return the set as H.264 of this constant rate factor shows it."""
    buffer, images = io.BytesIO(), [image for _, image in rendered.frames]
    with av.open(buffer, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.height, stream.width, stream.pix_fmt = *images[0].shape[:2], "yuv420p"
        stream.options = {"crf": str(quality)}
        for image in [*images, None]:
            container.mux(stream.encode(None if image is None else av.VideoFrame.from_ndarray(image, "rgb24")))
    buffer.seek(0)
    with av.open(buffer) as container:
        decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    return replace(rendered, frames=tuple(enumerate(decoded)))


def name_as_person(number: int) -> set[str]:
    """Return the words by which a person may call a ball."""
    if number in (0, 8):
        return {"cue ball" if number == 0 else "black 8"}
    colour = COLOURS[(number - 1) % 8]
    words = {colour, "brown"} if colour == "maroon" else {colour}
    return {f"{word} {number}" for word in words} | ({f"{word} stripe" for word in words} if number > 8 else words)


def measure_set(index: int, seed: int) -> list[tuple[int, float, str]]:
    """Return width, colour difference and verdict of the name of each ball of a set."""
    rng = np.random.default_rng([seed, index])
    numbers = (0, 8, *sorted(rng.permutation([*range(1, 8), *range(9, 16)])[:10].tolist()))
    width, kind = WIDTHS[index // 2 % 3], (CLOTHS[index % 4], LIGHTS[index % 3], BRIGHTNESSES[index % 3])
    own_seed, tilt = int(rng.integers(2**31)), TILTS[index % 2]
    rendered = encode_frames(render_set(numbers, own_seed, *kind, width, tilt, turn=0.12), QUALITIES[index % 2])
    plain = render_set(numbers, own_seed, *kind, width, tilt, turn=0.12, is_plain=True)
    truth = [measure_colour(collect_pixels(dict(plain.frames), plain.tracks, [0], k)) for k in range(len(numbers))]
    rows = []
    for look, number, true_colour in zip(rendered.describe(), numbers, truth, strict=True):
        difference = float(compare_colours(np.array([look.colour]), np.array([true_colour]))[0])
        is_right = look.number == number or any(look.name in name.split(" ball") for name in name_as_person(number))
        is_bare = look.number == 0 and look.name.split()[0] in ("solid", "stripe", "ball")
        verdict = "WRONG NUMBER" if look.number not in (0, number) else "right" if is_right else "wrong"
        rows.append((width, difference, "none" if is_bare else verdict))
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=int, default=18, help="films of twelve balls (default %(default)s)")
    parser.add_argument("--seed", type=int, default=11, help="source of all that is random (default %(default)s)")
    chosen = parser.parse_args(arguments)
    rows = [row for index in range(chosen.sets) for row in measure_set(index, chosen.seed)]
    widths, differences = (np.array([row[k] for row in rows]) for k in (0, 1))
    print("names: " + ", ".join(f"{n} {verdict}" for verdict, n in Counter(row[2] for row in rows).most_common()))
    for width in (*WIDTHS, None):
        of_width = differences[(widths == width) | (width is None)]
        print(
            f"{'all' if width is None else f'{width} px wide'}: {len(of_width)} balls, colour difference median "
            f"{np.median(of_width):.1f}, largest {of_width.max():.1f}, {np.mean(of_width < 5):.0%} below 5"
        )


if __name__ == "__main__":
    main()
