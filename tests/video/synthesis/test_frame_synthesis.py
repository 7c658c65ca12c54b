from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from support import staged_shot as shot
from support.sample_clips import read_sample_truth

from models.core.events import Events
from models.core.fit_result import Fit, Trust
from models.core.scene import Camera, Scene, Table
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from models.core.typing import ImageArray
from video.io.clip import Clip, open_clip, read_frames
from video.io.yuv_frame import YuvFrame
from video.matting.background_plate import COVERED_BY_BALL, BackgroundPlate, estimate_background_plate
from video.matting.ball_matting import BallOutline, matte_balls
from video.matting.ball_timeline import BallTimeline, build_ball_timeline
from video.matting.compositing import SpriteLayer, composite_balls
from video.matting.hidden_background import estimate_hidden_background, find_covered_region
from video.synthesis.frame_synthesis import MovingBall, prepare_interval

TIMES = np.arange(31) / shot.RATE


def perfect_plate() -> BackgroundPlate:
    return BackgroundPlate(shot.cloth(), np.ones((shot.HEIGHT, shot.WIDTH), dtype=bool))


def build_staged_timeline(times: NDArray[np.float64] = TIMES) -> BallTimeline:
    return build_ball_timeline(shot.scene(), shot.tracks(times), shot.fit(times))


def outline(t: float, ball: int = 0) -> BallOutline:
    centre = shot.place(t)[ball] * shot.SCALE + shot.MARGIN
    return BallOutline(centre[None], centre, shot.RADIUS * shot.SCALE)


def difference(a: ImageArray, b: ImageArray) -> NDArray[np.float64]:
    return np.asarray(np.abs(a.astype(float) - b.astype(float)), dtype=np.float64)


def midway(
    timeline: BallTimeline, plate: BackgroundPlate, row: int, make: Callable[[float], ImageArray]
) -> tuple[ImageArray, float]:
    """The frame synthesized halfway between two that `make` films, and its time."""
    first, second = (float(t) for t in timeline.t[[row, row + 1]])
    t = (first + second) / 2
    state = timeline.state_at(np.array([t]))
    interval = prepare_interval(timeline, plate, row, make(first), make(second))
    return interval.synthesize(t, timeline.centres_at(t, state.xy[0])), t


def test_a_ball_composited_at_its_place_restores_the_frame() -> None:
    image = shot.film(0.5)
    matted = matte_balls(image, [outline(0.5)], [outline(0.5, 1)], perfect_plate(), None)
    again = matted.background.copy()
    assert matted.sprites[0] is not None
    composite_balls(again, [[SpriteLayer(matted.sprites[0], outline(0.5).centre[None], 1.0)]])
    assert difference(again, image).max() <= 3


def test_the_colour_of_a_neighbouring_ball_is_no_shading() -> None:
    """Two touching balls, both matted: composited elsewhere, one leaves the cloth beside it unchanged."""
    other = outline(0.5)
    below = np.array([0, 1.9 * other.radius])
    beside_it = replace(other, path=other.path + below, centre=other.centre + below)
    image = shot.film(0.5)
    x, y = np.meshgrid(np.arange(shot.WIDTH), np.arange(shot.HEIGHT))
    image[np.hypot(x - beside_it.centre[0], y - beside_it.centre[1]) < beside_it.radius] = (250, 245, 240)
    sprite = matte_balls(image, [other, beside_it], [], perfect_plate(), None).sprites[1]
    assert sprite is not None
    tint = np.ptp(sprite.shading, axis=2)
    assert tint.max() < 0.15


def test_the_bright_fringe_of_a_ball_moves_with_it() -> None:
    def fringed(t: float) -> ImageArray:
        y, x = np.mgrid[0 : shot.HEIGHT, 0 : shot.WIDTH]
        away = np.hypot(x - outline(t).centre[0], y - outline(t).centre[1]) - outline(t).radius
        glow = 90 * np.clip(1 - np.abs(away - 1.5) / 2, 0, 1)[..., None] * (1.0, 0.2, 0.3)
        return np.clip(shot.film(t) + glow, 0, 255).astype(np.uint8)

    matted = matte_balls(fringed(0.5), [outline(0.5)], [outline(0.5, 1)], perfect_plate(), None)
    moved = matted.background.copy()
    assert matted.sprites[0] is not None
    composite_balls(moved, [[SpriteLayer(matted.sprites[0], outline(0.6).centre[None], 1.0)]])
    ring = np.abs(outline(0.6).distance_to_path(0, 0, shot.WIDTH, shot.HEIGHT) - outline(0.6).radius - 1.5) < 1.5
    assert difference(moved, fringed(0.6))[ring].mean() < 5
    assert difference(moved, shot.film(0.6))[ring].mean() > 15, "the fringe must be strong enough to be missed"


def test_a_resting_ball_is_matted_where_another_passes_in_front_of_it() -> None:
    for below, taken in ((-1.2, (0, 1)), (1.2, (0,)), (-2.5, (0,))):
        assert with_neighbour(build_staged_timeline(TIMES[::3]), 7, below).balls_to_matte(7) == taken


def test_slow_overlapping_balls_are_left_to_the_flow() -> None:
    for below, taken in ((-1.2, ()), (1.2, ()), (-2.5, (0,)), (2.5, (0,))):
        assert with_neighbour(build_staged_timeline(), 20, below).balls_to_matte(20) == taken


def test_overlapping_balls_are_left_to_the_flow_up_to_a_higher_speed_if_one_is_undetected() -> None:
    """Its position is uncertain: matted there, it would take half of the other ball along."""
    for every, radii, taken in ((3, 1.6, ()), (4, 2.1, (0, 1))):
        timeline = with_neighbour(build_staged_timeline(TIMES[::every]), 5, -1.2)
        goes = np.linalg.norm(np.diff(timeline.centre[5:7, 0], axis=0)) / timeline.radius[5, 0]
        assert goes == pytest.approx(radii, abs=0.1)
        observed = timeline.observed.copy()
        observed[6, 0] = False
        assert replace(timeline, observed=observed).balls_to_matte(5) == taken
        assert timeline.balls_to_matte(5) == (0, 1)


def with_neighbour(timeline: BallTimeline, row: int, below: float) -> BallTimeline:
    """The timeline with the resting ball some radii below the middle of the other ball's path after `row`."""
    centre = timeline.centre.copy()
    path = centre[row : row + 2, 0]
    centre[:, 1] = path.mean(axis=0) + np.array([0, below * shot.RADIUS * shot.SCALE])
    return replace(timeline, centre=centre)


def test_a_resting_ball_has_one_position_despite_measurement_noise() -> None:
    rng, tracks = np.random.default_rng(8), shot.tracks(TIMES)
    measured = tracks.px + rng.normal(0, 1.5, tracks.px.shape)
    timeline = build_ball_timeline(shot.scene(), replace(tracks, px=measured), shot.fit(TIMES))
    assert np.ptp(timeline.centre[:, 1], axis=0).max() < 1e-6
    assert np.abs(timeline.centre[0, 1] - np.median(measured[:, 1], axis=0)).max() < 1e-6
    moving = slice(5, None)
    np.testing.assert_array_equal(timeline.centre[moving, 0], measured[moving, 0])


def test_a_ball_stays_at_its_observed_position_until_it_is_struck() -> None:
    """Its position was observed 2 px off after the strike, which does not matter before it."""
    times = np.array([0.0, 0.04, 0.16, 0.2])
    tracks = shot.tracks(times)
    px = tracks.px.copy()
    px[2, 0] += [0.0, 2.0]
    timeline = build_ball_timeline(shot.scene(), replace(tracks, px=px), shot.fit(times))
    before, after = 0.09, 0.13  # struck at 0.1 s, between the frames at 0.04 and 0.16 s
    for t, off in ((before, 0.0), (after, 1.0)):
        state = timeline.state_at(np.array([t]))
        corrected, predicted = timeline.centres_at(t, state.xy[0])[0], timeline.project(state.xy[0], t)[0]
        assert corrected - predicted == pytest.approx([0.0, off], abs=0.15)
    assert timeline.motion_progress_at(before)[0] == 0


def test_the_background_behind_a_ball_is_the_cloth_without_its_shadow() -> None:
    matted = matte_balls(shot.film(0.5), [outline(0.5)], [outline(0.5, 1)], perfect_plate(), None)
    assert difference(matted.background, shot.film(0.5, shown=(1,))).max() <= 6


def test_the_background_has_the_light_of_its_own_frame() -> None:
    darker = (shot.film(0.5) * 0.85).astype(np.uint8)
    matted = matte_balls(darker, [outline(0.5)], [], perfect_plate(), None)
    x, y = np.rint(outline(0.5).centre).astype(int)
    truth = shot.film(0.5, shown=(1,)) * 0.85
    assert difference(matted.background, truth.astype(np.uint8))[y - 12 : y + 13, x - 12 : x + 13].mean() < 3


def test_an_in_between_frame_looks_as_a_camera_would_have_filmed_it() -> None:
    timeline = build_staged_timeline()
    synthesized, t = midway(timeline, perfect_plate(), 20, shot.film)
    error = difference(synthesized, shot.film(t))
    assert error.mean() < 0.3
    assert error.max() < 40
    blend = (shot.film(float(TIMES[20])) / 2.0 + shot.film(float(TIMES[21])) / 2.0).astype(np.uint8)
    assert error.mean() < 0.1 * difference(blend, shot.film(t)).mean()


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 0.9, 1.0])
def test_the_planes_for_the_encoder_show_the_synthesized_image(share: float) -> None:
    timeline = build_staged_timeline()
    interval = prepare_interval(timeline, perfect_plate(), 20, shot.film(float(TIMES[20])), shot.film(float(TIMES[21])))
    t = float(TIMES[20] * (1 - share) + TIMES[21] * share)
    centres = timeline.centres_at(t, timeline.state_at(np.array([t])).xy[0])
    wanted = YuvFrame.from_rgb(interval.synthesize(t, centres))
    for plane, exact in zip(interval.synthesize_planes(t, centres).planes, wanted.planes, strict=True):
        assert difference(plane, exact).max() <= 1  # the backgrounds are mixed before they are rounded, or after


def test_decoded_frames_are_unchanged() -> None:
    timeline = build_staged_timeline()
    first, second = shot.film(float(TIMES[20])), shot.film(float(TIMES[21]))
    interval = prepare_interval(timeline, perfect_plate(), 20, first, second)
    for t, real in ((TIMES[20], first), (TIMES[21], second)):
        centres = timeline.centres_at(float(t), timeline.state_at(np.array([t])).xy[0])
        assert np.array_equal(interval.synthesize(float(t), centres), real)


def test_a_resting_ball_is_unchanged() -> None:
    timeline = build_staged_timeline()
    synthesized, t = midway(timeline, perfect_plate(), 20, shot.film)
    x, y = np.rint(outline(t, 1).centre).astype(int)
    assert np.array_equal(synthesized[y - 20 : y + 20, x - 20 : x + 20], shot.film(t)[y - 20 : y + 20, x - 20 : x + 20])
    assert not timeline.moving[:, 1].any()
    assert not timeline.moving[:3, 0].any()


def test_an_undetected_but_visible_ball_is_not_doubled() -> None:
    tracks = shot.tracks(TIMES)
    tracks.xy[20, 0], tracks.px[20, 0] = np.nan, np.nan
    timeline = build_ball_timeline(shot.scene(), tracks, shot.fit(TIMES))
    synthesized, t = midway(timeline, perfect_plate(), 20, shot.film)
    assert difference(synthesized, shot.film(t)).mean() < 0.3


def test_a_ball_that_is_hidden_in_one_frame_comes_from_the_other() -> None:
    tracks = shot.tracks(TIMES)
    tracks.xy[20, 0], tracks.px[20, 0] = np.nan, np.nan
    timeline = build_ball_timeline(shot.scene(), tracks, shot.fit(TIMES))

    def hidden(t: float) -> ImageArray:
        return shot.film(t, shown=(1,)) if t < TIMES[20] + 1e-6 else shot.film(t)

    synthesized, t = midway(timeline, perfect_plate(), 20, hidden)
    x, y = np.rint(outline(t).centre).astype(int)
    assert synthesized[y, x].min() > 0.35 * shot.film(t)[y, x].min()
    assert difference(synthesized, shot.film(t, shown=(1,)))[:, : x - 20].max() <= 6


def test_a_moving_camera_moves_the_table() -> None:
    motion = np.tile(np.eye(3), (len(TIMES), 1, 1))
    motion[:, 0, 2] = np.arange(len(TIMES)) * 2.0
    tracks = shot.tracks(TIMES)
    tracks.px[..., 0] += motion[:, 0, 2][:, None]
    timeline = build_ball_timeline(shot.scene(motion), tracks, shot.fit(TIMES))

    def film(t: float) -> ImageArray:
        return np.roll(shot.film(t), round(t * shot.RATE) * 2, axis=1)

    synthesized, t = midway(timeline, perfect_plate(), 10, film)
    expected = np.roll(shot.film(t), 21, axis=1)
    assert difference(synthesized, expected)[:, 40:].mean() < 1.0


def test_the_plate_is_the_median_of_uncovered_pixels_and_inpainted_elsewhere() -> None:
    rng = np.random.default_rng(1)
    region = np.zeros((40, 40), dtype=bool)
    region[10:30, 10:30] = True
    samples = []
    for k in range(9):
        image = np.clip(100 + rng.normal(0, 3, (40, 40, 3)), 0, 255).astype(np.uint8)
        covered = np.zeros((40, 40), dtype=np.uint8)
        covered[10:30, 10 + 2 * k : 14 + 2 * k] = COVERED_BY_BALL
        covered[14:18, 14:18] = COVERED_BY_BALL
        image[covered > 0] = 255
        samples.append((image, covered, None))
    plate = estimate_background_plate(region, samples)
    assert np.array_equal(plate.valid, region)
    assert np.abs(plate.image[region].astype(float) - 100).max() < 8
    assert not plate.image[~region].any()


def test_the_plate_of_a_clip_shows_the_cloth_where_the_ball_rolled(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path)
    timeline = build_staged_timeline()
    plate = estimate_hidden_background(timeline, clip).plate
    region = find_covered_region(timeline)
    assert 0.03 < region.mean() < 0.4
    assert difference(plate.image, shot.cloth())[region].mean() < 3


def test_a_ball_observed_to_move_is_moved_even_if_it_rests_in_the_fit() -> None:
    fit = shot.fit(TIMES)
    resting = fit.trajectory.position.copy()
    resting[1, 1] = 0
    wrong = replace(fit, trajectory=replace(fit.trajectory, position=resting))
    timeline = build_ball_timeline(shot.scene(), shot.tracks(TIMES), wrong)
    synthesized, t = midway(timeline, perfect_plate(), 20, shot.film)
    assert difference(synthesized, shot.film(t)).mean() < 0.3


def test_streaks_are_matted_along_the_path_during_the_shutter_time() -> None:
    tracks = shot.tracks(TIMES)
    tracks.streak[10:, 0, 0] = 0.9 * 0.02
    timeline = build_ball_timeline(shot.scene(), tracks, shot.fit(TIMES))
    path = timeline.outline(20, 0).path
    assert len(path) > 1
    assert np.ptp(path[:, 0]) == pytest.approx(0.9 * 0.02 * shot.SCALE, rel=0.01)
    assert len(timeline.outline(20, 1).path) == 1


@pytest.mark.parametrize(
    ("rows", "opened", "exposure"),
    [
        (slice(4, None), 0.08, 0.08),
        (slice(6, 7), 0.9, 0.0),  # longer than the frame interval: two merged balls
        (slice(6, 7), 0.08, 0.0),  # no other frame is blurred at the same speed
        (slice(6, 7), 0.05, 0.05),  # too short to be visible in all frames
    ],
)
def test_a_streak_measures_the_shutter_time_unless_other_frames_contradict_it(
    rows: slice, opened: float, exposure: float
) -> None:
    times = TIMES[::3]
    tracks = shot.tracks(times)
    tracks.streak[rows, 0, 0] = 0.9 * opened
    assert build_ball_timeline(shot.scene(), tracks, shot.fit(times)).shutter_time == pytest.approx(exposure, rel=1e-6)


@pytest.mark.parametrize(("gone", "alike"), [(0.0, 1), (1.0, 0), (0.3, 1)])
def test_a_similar_streak_is_used_alone_even_at_the_other_end_of_the_gap(gone: float, alike: int) -> None:
    """Before a ball is struck its second view has no weight; if it alone looks right, it is used."""
    sprite = matte_balls(shot.film(0.5), [outline(0.5)], [outline(0.5, 1)], perfect_plate(), None).sprites[0]
    assert sprite is not None
    path = np.linspace([-6.0, 0.0], [6.0, 0.0], 9)
    streaked, other = replace(sprite, path=path), replace(sprite, path=path[:, ::-1])
    sides = (other, streaked) if alike else (streaked, other)
    ball = MovingBall(0, 8.0, sides, (sprite, sprite), None)
    layers = ball.build_layers(np.array([50.0, 60.0]), path, 0.4, gone)
    assert [layer.sprite is streaked for layer in layers] == [True]
    assert layers[0].weight == pytest.approx(1.0)


def test_tracks_and_fit_of_different_shots_are_refused() -> None:
    tracks = replace(shot.tracks(TIMES), ids=("cue", "blue"), looks=())
    with pytest.raises(ValueError, match="same balls"):
        build_ball_timeline(shot.scene(), tracks, shot.fit(TIMES))


def overhead(table: Table, scale: float, left: float, top: float, clip: Clip) -> Scene:
    """A camera straight above: `scale` px/m, the nose corner at (left, top) px."""
    matrix = np.array([[scale, 0, 0, left], [0, scale, 0, top], [0, 0, 1e-9, 1.0]])
    camera = Camera(matrix, clip.width, clip.height, table.corners * scale + [left, top], np.eye(8), "noses", 9.0, 1.0)
    return Scene(table, camera, np.array([45.0, 10.0, -60.0]), ())


def smooth_fit(tracks: Tracks) -> Fit:
    """A fit without physics: smooth curves through the positions of the tracks."""
    count = len(tracks.t) - 1
    pieces = [PchipInterpolator(tracks.t, tracks.xy[:, ball]).c[::-1] for ball in range(len(tracks.ids))]
    total = count * len(tracks.ids)
    trajectory = Trajectory(
        tracks.ids, np.repeat(np.arange(len(tracks.ids)), count), np.tile(tracks.t[:-1], len(tracks.ids)),
        np.tile(tracks.t[1:], len(tracks.ids)), np.concatenate([piece.transpose(1, 0, 2) for piece in pieces]),
        np.full((total, 2, 3), np.nan), ("measured",) * total, np.tile(np.eye(4) * 1e-6, (total, 1, 1)),
    )  # fmt: skip
    none = np.empty(0)
    events = Events((), none, none, none, (), (), np.empty((0, 2)), none, none, none, none)
    shape = tracks.xy.shape[:2]
    yes, trust = np.ones(shape, dtype=bool), Trust("red", ("no physics",))
    return Fit(events, trajectory, (), 1e-3, 1.0, np.zeros(tracks.xy.shape), yes, ~yes, trust)


def compare_with_blending(
    clip: Clip, rows: np.ndarray, px: np.ndarray, table: Table, scene: Scene, radius: float
) -> float:
    """Withhold every other frame, synthesize it, and compare around the balls that move.

    Args:
        clip: The clip, of three balls.
        rows: (T,) consecutive frames, an odd number.
        px: (T, 3, 2) centres of red, white and yellow.
        table: Its size.
        scene: Table and camera.
        radius: Of the balls, px.

    Returns:
        By how many dB the synthesized frames are better than blends of their neighbours.
    """
    small = np.full(px.shape[:2], 1e-3)
    lab = np.array([[45.0, 60.0, 40.0], [92.0, 0.0, 5.0], [80.0, 5.0, 75.0]])
    ids = ("red", "white", "yellow")
    everything = Tracks(
        rows, clip.t[rows], ids, ids, scene.camera.to_table(px, table.ball_radius), px, small, small,
        np.zeros_like(px), np.full(px.shape[:2], radius), lab,
    )  # fmt: skip
    half = replace(everything, **{
        name: getattr(everything, name)[::2]
        for name in ("frame", "t", "xy", "px", "sigma", "sigma_along", "streak", "radius_px")
    })  # fmt: skip
    timeline = build_ball_timeline(scene, half, smooth_fit(half))
    plate = estimate_hidden_background(timeline, clip).plate
    images = [image for _, image in read_frames(clip, indices=rows)]
    moving = np.flatnonzero(np.linalg.norm(px[-1] - px[0], axis=1) > radius)
    made_error, blend_error = [], []
    for row in range(len(half.t) - 1):
        first, real, second = images[2 * row : 2 * row + 3]
        t = float(everything.t[2 * row + 1])
        interval = prepare_interval(timeline, plate, row, first, second)
        synthesized = interval.synthesize(t, timeline.centres_at(t, timeline.state_at(np.array([t])).xy[0]))
        for ball in moving:
            x, y = np.rint(px[2 * row + 1, ball]).astype(int)
            here = np.s_[y - 12 : y + 13, x - 12 : x + 13]
            made_error.append(float((difference(synthesized[here], real[here]) ** 2).mean()))
            blend = first[here] / 2.0 + second[here] / 2.0
            blend_error.append(float((difference(blend.astype(np.uint8), real[here]) ** 2).mean()))
    return float(10 * np.log10(np.mean(blend_error) / np.mean(made_error)))


def test_withheld_frames_of_a_real_clip_are_synthesized_better_than_by_blending(footage: Path) -> None:
    clip = open_clip(footage / "carom_F1.mp4")
    truth = json.loads((footage / "carom_F1.gt.json").read_text())
    rows = np.arange(40, 61)
    px = np.array([[truth["tracks"][name][row][1:3] for name in ("red", "white", "yellow")] for row in rows], float)
    table = Table("carom-match", "carom", 2.84, 1.42, 0.03075, 0.21, False)
    scale = (740 - 134) / (2.84 - 2 * 0.03075)  # extremes of the centres, from the truth file
    scene = overhead(table, scale, 134 - 0.03075 * scale, 103 - 0.03075 * scale, clip)
    gain = compare_with_blending(clip, rows, px, table, scene, 6.6)
    assert gain > 6, f"{gain:.1f} dB"


def test_withheld_frames_of_a_rendered_clip_are_synthesized_better_than_by_blending() -> None:
    truth = read_sample_truth("carom_match")
    clip, table = open_clip(truth.path), truth.table
    rows = np.arange(60, 81)
    px = np.stack([truth.px[rows, truth.ids.index(name)] for name in ("red", "white", "yellow")], axis=1)
    flat_xy, flat_px = truth.xy.reshape(-1, 2), truth.px.reshape(-1, 2)
    far, near = int(np.nanargmax(flat_xy.sum(axis=1))), int(np.nanargmin(flat_xy.sum(axis=1)))
    scale = float(np.linalg.norm(flat_px[far] - flat_px[near]) / np.linalg.norm(flat_xy[far] - flat_xy[near]))
    left, top = flat_px[near] - scale * flat_xy[near]
    gain = compare_with_blending(clip, rows, px, table, overhead(table, scale, left, top, clip), 8.3)
    assert gain > 6, f"{gain:.1f} dB"
