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

from models.core.events import Events
from models.core.fit_result import Fit, Trust
from models.core.scene import Camera, Scene, Table
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from models.core.typing import ImageArray
from video.io.clip import Clip, open_clip, read_frames
from video.matting.background_plate import UNDER, Plate, learn_plate
from video.matting.ball_matting import Outline, peel
from video.matting.ball_timeline import Sightings, sight
from video.matting.compositing import Layer, paste
from video.matting.frame_store import Gallery
from video.matting.hidden_background import plate_of, swept_by
from video.synthesis.frame_synthesis import Seen, open_interval

TIMES = np.arange(31) / shot.RATE


def perfect_plate() -> Plate:
    return Plate(shot.cloth(), np.ones((shot.HEIGHT, shot.WIDTH), dtype=bool))


def seen(times: NDArray[np.float64] = TIMES) -> Sightings:
    return sight(shot.scene(), shot.tracks(times), shot.fit(times))


def outline(t: float, ball: int = 0) -> Outline:
    centre = shot.place(t)[ball] * shot.SCALE + shot.MARGIN
    return Outline(centre[None], centre, shot.RADIUS * shot.SCALE)


def difference(a: ImageArray, b: ImageArray) -> NDArray[np.float64]:
    return np.asarray(np.abs(a.astype(float) - b.astype(float)), dtype=np.float64)


def midway(
    sightings: Sightings, plate: Plate, row: int, make: Callable[[float], ImageArray]
) -> tuple[ImageArray, float]:
    """The picture made halfway between two that `make` films, and its time."""
    first, second = (float(t) for t in sightings.t[[row, row + 1]])
    t = (first + second) / 2
    state = sightings.state(np.array([t]))
    interval = open_interval(sightings, plate, row, make(first), make(second))
    return interval.at(t, sightings.centres(t, state.xy[0])), t


def test_a_ball_pasted_where_it_was_gives_the_picture_back() -> None:
    picture = shot.film(0.5)
    peeled = peel(picture, [outline(0.5)], [outline(0.5, 1)], perfect_plate(), None)
    again = peeled.behind.copy()
    assert peeled.sprites[0] is not None
    paste(again, [[Layer(peeled.sprites[0], outline(0.5).centre[None], 1.0)]])
    assert difference(again, picture).max() <= 3


def test_a_ball_does_not_take_the_colour_of_its_neighbour_for_its_shade() -> None:
    """Two balls that touch, both taken out: pasted elsewhere, one leaves the cloth beside it as it is."""
    other = outline(0.5)
    below = np.array([0, 1.9 * other.radius])
    beside_it = replace(other, way=other.way + below, centre=other.centre + below)
    picture = shot.film(0.5)
    x, y = np.meshgrid(np.arange(shot.WIDTH), np.arange(shot.HEIGHT))
    picture[np.hypot(x - beside_it.centre[0], y - beside_it.centre[1]) < beside_it.radius] = (250, 245, 240)
    sprite = peel(picture, [other, beside_it], [], perfect_plate(), None).sprites[1]
    assert sprite is not None
    tint = np.ptp(sprite.shade, axis=2)
    assert tint.max() < 0.15


def test_the_bright_fringe_of_a_ball_goes_with_it() -> None:
    def fringed(t: float) -> ImageArray:
        y, x = np.mgrid[0 : shot.HEIGHT, 0 : shot.WIDTH]
        away = np.hypot(x - outline(t).centre[0], y - outline(t).centre[1]) - outline(t).radius
        glow = 90 * np.clip(1 - np.abs(away - 1.5) / 2, 0, 1)[..., None] * (1.0, 0.2, 0.3)
        return np.clip(shot.film(t) + glow, 0, 255).astype(np.uint8)

    peeled = peel(fringed(0.5), [outline(0.5)], [outline(0.5, 1)], perfect_plate(), None)
    moved = peeled.behind.copy()
    assert peeled.sprites[0] is not None
    paste(moved, [[Layer(peeled.sprites[0], outline(0.6).centre[None], 1.0)]])
    ring = np.abs(outline(0.6).distance(0, 0, shot.WIDTH, shot.HEIGHT) - outline(0.6).radius - 1.5) < 1.5
    assert difference(moved, fringed(0.6))[ring].mean() < 5
    assert difference(moved, shot.film(0.6))[ring].mean() > 15, "a fringe that nobody would miss tells nothing"


def test_a_resting_ball_is_taken_out_where_another_goes_by_in_front_of_it() -> None:
    for below, taken in ((-1.2, (0, 1)), (1.2, (0,)), (-2.5, (0,))):
        assert beside(seen(TIMES[::3]), 7, below).taken_out(7) == taken


def test_slow_balls_that_lie_over_each_other_are_left_to_the_flow() -> None:
    for below, taken in ((-1.2, ()), (1.2, ()), (-2.5, (0,)), (2.5, (0,))):
        assert beside(seen(), 20, below).taken_out(20) == taken


def test_a_ball_over_another_that_was_not_seen_is_left_to_the_flow_for_longer() -> None:
    """Where it lies is a guess: cut out there, it would take half of the other one along."""
    for every, radii, taken in ((3, 1.6, ()), (4, 2.1, (0, 1))):
        sightings = beside(seen(TIMES[::every]), 5, -1.2)
        goes = np.linalg.norm(np.diff(sightings.centre[5:7, 0], axis=0)) / sightings.radius[5, 0]
        assert goes == pytest.approx(radii, abs=0.1)
        observed = sightings.observed.copy()
        observed[6, 0] = False
        assert replace(sightings, observed=observed).taken_out(5) == taken
        assert sightings.taken_out(5) == (0, 1)


def beside(sightings: Sightings, row: int, below: float) -> Sightings:
    """The resting ball so many radii below the middle of the way that the other one goes after the picture `row`."""
    centre = sightings.centre.copy()
    way = centre[row : row + 2, 0]
    centre[:, 1] = way.mean(axis=0) + np.array([0, below * shot.RADIUS * shot.SCALE])
    return replace(sightings, centre=centre)


def test_a_ball_at_rest_has_one_place_though_it_was_measured_at_many() -> None:
    rng, tracks = np.random.default_rng(8), shot.tracks(TIMES)
    measured = tracks.px + rng.normal(0, 1.5, tracks.px.shape)
    sightings = sight(shot.scene(), replace(tracks, px=measured), shot.fit(TIMES))
    assert np.ptp(sightings.centre[:, 1], axis=0).max() < 1e-6
    assert np.abs(sightings.centre[0, 1] - np.median(measured[:, 1], axis=0)).max() < 1e-6
    moving = slice(5, None)
    np.testing.assert_array_equal(sightings.centre[moving, 0], measured[moving, 0])


def test_a_ball_lies_where_it_was_seen_until_it_is_struck() -> None:
    """It was seen 2 px off after the strike; before it, that tells nothing."""
    times = np.array([0.0, 0.04, 0.16, 0.2])
    tracks = shot.tracks(times)
    px = tracks.px.copy()
    px[2, 0] += [0.0, 2.0]
    sightings = sight(shot.scene(), replace(tracks, px=px), shot.fit(times))
    before, after = 0.09, 0.13  # struck at 0.1 s, between the pictures of 0.04 and 0.16 s
    for t, off in ((before, 0.0), (after, 1.0)):
        state = sightings.state(np.array([t]))
        placed, put = sightings.centres(t, state.xy[0])[0], sightings.project(state.xy[0], t)[0]
        assert placed - put == pytest.approx([0.0, off], abs=0.15)
    assert sightings.gone_at(before)[0] == 0


def test_behind_a_peeled_ball_is_the_cloth_without_its_shadow() -> None:
    peeled = peel(shot.film(0.5), [outline(0.5)], [outline(0.5, 1)], perfect_plate(), None)
    assert difference(peeled.behind, shot.film(0.5, shown=(1,))).max() <= 6


def test_the_fill_takes_the_light_of_its_own_picture() -> None:
    darker = (shot.film(0.5) * 0.85).astype(np.uint8)
    peeled = peel(darker, [outline(0.5)], [], perfect_plate(), None)
    x, y = np.rint(outline(0.5).centre).astype(int)
    truth = shot.film(0.5, shown=(1,)) * 0.85
    assert difference(peeled.behind, truth.astype(np.uint8))[y - 12 : y + 13, x - 12 : x + 13].mean() < 3


def test_a_picture_between_two_is_what_a_camera_would_have_filmed() -> None:
    sightings = seen()
    made, t = midway(sightings, perfect_plate(), 20, shot.film)
    missed = difference(made, shot.film(t))
    assert missed.mean() < 0.3
    assert missed.max() < 40
    blend = (shot.film(float(TIMES[20])) / 2.0 + shot.film(float(TIMES[21])) / 2.0).astype(np.uint8)
    assert missed.mean() < 0.1 * difference(blend, shot.film(t)).mean()


def test_real_pictures_are_shown_bit_for_bit() -> None:
    sightings = seen()
    first, second = shot.film(float(TIMES[20])), shot.film(float(TIMES[21]))
    interval = open_interval(sightings, perfect_plate(), 20, first, second)
    for t, real in ((TIMES[20], first), (TIMES[21], second)):
        centres = sightings.centres(float(t), sightings.state(np.array([t])).xy[0])
        assert np.array_equal(interval.at(float(t), centres), real)


def test_a_resting_ball_is_left_as_it_is() -> None:
    sightings = seen()
    made, t = midway(sightings, perfect_plate(), 20, shot.film)
    x, y = np.rint(outline(t, 1).centre).astype(int)
    assert np.array_equal(made[y - 20 : y + 20, x - 20 : x + 20], shot.film(t)[y - 20 : y + 20, x - 20 : x + 20])
    assert not sightings.moves[:, 1].any()
    assert not sightings.moves[:3, 0].any()


def test_a_ball_that_was_missed_but_is_in_the_picture_is_not_doubled() -> None:
    tracks = shot.tracks(TIMES)
    tracks.xy[20, 0], tracks.px[20, 0] = np.nan, np.nan
    sightings = sight(shot.scene(), tracks, shot.fit(TIMES))
    made, t = midway(sightings, perfect_plate(), 20, shot.film)
    assert difference(made, shot.film(t)).mean() < 0.3


def test_a_ball_that_is_hidden_in_one_picture_comes_from_the_other() -> None:
    tracks = shot.tracks(TIMES)
    tracks.xy[20, 0], tracks.px[20, 0] = np.nan, np.nan
    sightings = sight(shot.scene(), tracks, shot.fit(TIMES))

    def hidden(t: float) -> ImageArray:
        return shot.film(t, shown=(1,)) if t < TIMES[20] + 1e-6 else shot.film(t)

    made, t = midway(sightings, perfect_plate(), 20, hidden)
    x, y = np.rint(outline(t).centre).astype(int)
    assert made[y, x].min() > 0.35 * shot.film(t)[y, x].min()
    assert difference(made, shot.film(t, shown=(1,)))[:, : x - 20].max() <= 6


def test_a_drifting_camera_carries_the_table_with_it() -> None:
    motion = np.tile(np.eye(3), (len(TIMES), 1, 1))
    motion[:, 0, 2] = np.arange(len(TIMES)) * 2.0
    tracks = shot.tracks(TIMES)
    tracks.px[..., 0] += motion[:, 0, 2][:, None]
    sightings = sight(shot.scene(motion), tracks, shot.fit(TIMES))

    def film(t: float) -> ImageArray:
        return np.roll(shot.film(t), round(t * shot.RATE) * 2, axis=1)

    made, t = midway(sightings, perfect_plate(), 10, film)
    expected = np.roll(shot.film(t), 21, axis=1)
    assert difference(made, expected)[:, 40:].mean() < 1.0


def test_the_plate_is_the_median_of_what_is_free_and_grows_where_nothing_is() -> None:
    rng = np.random.default_rng(1)
    swept = np.zeros((40, 40), dtype=bool)
    swept[10:30, 10:30] = True
    samples = []
    for k in range(9):
        picture = np.clip(100 + rng.normal(0, 3, (40, 40, 3)), 0, 255).astype(np.uint8)
        covered = np.zeros((40, 40), dtype=np.uint8)
        covered[10:30, 10 + 2 * k : 14 + 2 * k] = UNDER
        covered[14:18, 14:18] = UNDER
        picture[covered > 0] = 255
        samples.append((picture, covered, None))
    plate = learn_plate(swept, samples)
    assert np.array_equal(plate.known, swept)
    assert np.abs(plate.picture[swept].astype(float) - 100).max() < 8
    assert not plate.picture[~swept].any()


def test_the_plate_of_a_clip_shows_the_cloth_where_the_ball_rolled(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path)
    sightings = seen()
    plate = plate_of(sightings, Gallery(sightings, clip))
    swept = swept_by(sightings)
    assert 0.03 < swept.mean() < 0.4
    assert difference(plate.picture, shot.cloth())[swept].mean() < 3


def test_a_ball_seen_to_move_is_moved_even_if_the_fit_says_that_it_rests() -> None:
    fit = shot.fit(TIMES)
    resting = fit.trajectory.position.copy()
    resting[1, 1] = 0
    wrong = replace(fit, trajectory=replace(fit.trajectory, position=resting))
    sightings = sight(shot.scene(), shot.tracks(TIMES), wrong)
    made, t = midway(sightings, perfect_plate(), 20, shot.film)
    assert difference(made, shot.film(t)).mean() < 0.3


def test_streaks_are_cut_along_the_way_of_the_exposure() -> None:
    tracks = shot.tracks(TIMES)
    tracks.streak[10:, 0, 0] = 0.9 * 0.02
    sightings = sight(shot.scene(), tracks, shot.fit(TIMES))
    way = sightings.outline(20, 0).way
    assert len(way) > 1
    assert np.ptp(way[:, 0]) == pytest.approx(0.9 * 0.02 * shot.SCALE, rel=0.01)
    assert len(sightings.outline(20, 1).way) == 1


@pytest.mark.parametrize(
    ("rows", "opened", "exposure"),
    [
        (slice(4, None), 0.08, 0.08),
        (slice(6, 7), 0.9, 0.0),  # longer than from picture to picture: two balls taken for one
        (slice(6, 7), 0.08, 0.0),  # no other picture is blurred, though the ball is as fast
        (slice(6, 7), 0.05, 0.05),  # too short to be seen everywhere
    ],
)
def test_a_streak_tells_the_exposure_unless_other_pictures_contradict_it(
    rows: slice, opened: float, exposure: float
) -> None:
    times = TIMES[::3]
    tracks = shot.tracks(times)
    tracks.streak[rows, 0, 0] = 0.9 * opened
    assert sight(shot.scene(), tracks, shot.fit(times)).exposure == pytest.approx(exposure, rel=1e-6)


@pytest.mark.parametrize(("gone", "alike"), [(0.0, 1), (1.0, 0), (0.3, 1)])
def test_the_streak_that_is_alike_is_shown_whole_even_at_the_other_end(gone: float, alike: int) -> None:
    """Before a ball is struck its second sighting counts for nothing; if it alone looks right, it is shown."""
    sprite = peel(shot.film(0.5), [outline(0.5)], [outline(0.5, 1)], perfect_plate(), None).sprites[0]
    assert sprite is not None
    way = np.linspace([-6.0, 0.0], [6.0, 0.0], 9)
    streaked, other = replace(sprite, way=way), replace(sprite, way=way[:, ::-1])
    sides = (other, streaked) if alike else (streaked, other)
    ball = Seen(0, 8.0, sides, (sprite, sprite), None)
    layers = ball.layers(np.array([50.0, 60.0]), way, 0.4, gone)
    assert [layer.sprite is streaked for layer in layers] == [True]
    assert layers[0].weight == pytest.approx(1.0)


def test_tracks_and_fit_of_different_shots_are_refused() -> None:
    tracks = replace(shot.tracks(TIMES), ids=("cue", "blue"))
    with pytest.raises(ValueError, match="same balls"):
        sight(shot.scene(), tracks, shot.fit(TIMES))


def overhead(table: Table, scale: float, left: float, top: float, clip: Clip) -> Scene:
    """A camera straight above: `scale` px/m, the nose corner at (left, top) px."""
    matrix = np.array([[scale, 0, 0, left], [0, scale, 0, top], [0, 0, 1e-9, 1.0]])
    camera = Camera(matrix, clip.width, clip.height, table.corners * scale + [left, top], np.eye(8), "noses", 9.0, 1.0)
    return Scene(table, camera, np.array([45.0, 10.0, -60.0]), ())


def drawn_through(tracks: Tracks) -> Fit:
    """A fit without physics: smooth curves through the places of the tracks."""
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


def test_withheld_pictures_of_a_real_clip_are_made_better_than_by_blending(footage: Path) -> None:
    """Every other picture of carom_F1 is hidden and made from its neighbours; compared around the moving balls."""
    clip = open_clip(footage / "carom_F1.mp4")
    truth = json.loads((footage / "carom_F1.gt.json").read_text())
    rows = np.arange(40, 61)
    px = np.array([[truth["tracks"][name][row][1:3] for name in ("red", "white", "yellow")] for row in rows], float)
    table = Table("carom-match", "carom", 2.84, 1.42, 0.03075, 0.21, False)
    scale = (740 - 134) / (2.84 - 2 * 0.03075)  # the extremes of the centres, as the truth file states them
    scene = overhead(table, scale, 134 - 0.03075 * scale, 103 - 0.03075 * scale, clip)
    small = np.full(px.shape[:2], 1e-3)
    lab = np.array([[45.0, 60.0, 40.0], [92.0, 0.0, 5.0], [80.0, 5.0, 75.0]])
    ids = ("red", "white", "yellow")
    everything = Tracks(
        rows, clip.t[rows], ids, ids, scene.camera.to_table(px, 0.03075), px, small, small, np.zeros_like(px),
        np.full(px.shape[:2], 6.6), lab,
    )  # fmt: skip
    half = replace(everything, **{
        name: getattr(everything, name)[::2]
        for name in ("frame", "t", "xy", "px", "sigma", "sigma_along", "streak", "radius_px")
    })  # fmt: skip
    sightings = sight(scene, half, drawn_through(half))
    plate = plate_of(sightings, Gallery(sightings, clip))
    pictures = [picture for _, picture in read_frames(clip, indices=rows)]
    made_error, blend_error = [], []
    for row in range(len(half.t) - 1):
        first, real, second = pictures[2 * row : 2 * row + 3]
        t = float(everything.t[2 * row + 1])
        interval = open_interval(sightings, plate, row, first, second)
        made = interval.at(t, sightings.centres(t, sightings.state(np.array([t])).xy[0]))
        for ball in (0, 2):
            x, y = np.rint(px[2 * row + 1, ball]).astype(int)
            here = np.s_[y - 12 : y + 13, x - 12 : x + 13]
            made_error.append(float((difference(made[here], real[here]) ** 2).mean()))
            blend = first[here] / 2.0 + second[here] / 2.0
            blend_error.append(float((difference(blend.astype(np.uint8), real[here]) ** 2).mean()))
    gain = 10 * np.log10(np.mean(blend_error) / np.mean(made_error))
    assert gain > 6, f"{gain:.1f} dB"
