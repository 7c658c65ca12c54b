from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import staged_shot as shot
from numpy.typing import NDArray

from video.inbetween import Sightings, open_interval, plate_of, sight, swept_by
from video.plate import Plate, learn_plate
from video.sprites import Outline, paste, peel

Picture = NDArray[np.uint8]
TIMES = np.arange(31) / shot.RATE


def perfect_plate() -> Plate:
    return Plate(shot.cloth(), np.ones((shot.HEIGHT, shot.WIDTH), dtype=bool))


def seen() -> Sightings:
    return sight(shot.scene(), shot.tracks(TIMES), shot.fit(TIMES))


def outline(t: float, ball: int = 0) -> Outline:
    centre = shot.place(t)[ball] * shot.SCALE + shot.MARGIN
    return Outline(centre[None], centre, shot.RADIUS * shot.SCALE)


def difference(a: Picture, b: Picture) -> NDArray[np.float64]:
    return np.asarray(np.abs(a.astype(float) - b.astype(float)), dtype=np.float64)


def midway(sightings: Sightings, plate: Plate, row: int, make: Callable[[float], Picture]) -> tuple[Picture, float]:
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
    paste(again, [(peeled.sprites[0], outline(0.5).centre, 1.0)])
    assert difference(again, picture).max() <= 3


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

    def hidden(t: float) -> Picture:
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

    def film(t: float) -> Picture:
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
        covered = np.zeros((40, 40), dtype=bool)
        covered[10:30, 10 + 2 * k : 14 + 2 * k] = True
        covered[14:18, 14:18] = True
        picture[covered] = 255
        samples.append((picture, covered, None))
    plate = learn_plate(swept, samples)
    assert np.array_equal(plate.known, swept)
    assert np.abs(plate.picture[swept].astype(float) - 100).max() < 8
    assert not plate.picture[~swept].any()


def test_the_plate_of_a_clip_shows_the_cloth_where_the_ball_rolled(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path)
    sightings = seen()
    plate = plate_of(sightings, clip)
    swept = swept_by(sightings)
    assert 0.03 < swept.mean() < 0.4
    assert difference(plate.picture, shot.cloth())[swept].mean() < 3


def test_streaks_are_cut_along_the_way_of_the_exposure() -> None:
    tracks = shot.tracks(TIMES)
    tracks.streak[10:, 0, 0] = 0.9 * 0.02
    sightings = sight(shot.scene(), tracks, shot.fit(TIMES))
    way = sightings.outline(20, 0).way
    assert len(way) > 1
    assert np.ptp(way[:, 0]) == pytest.approx(0.9 * 0.02 * shot.SCALE, rel=0.01)
    assert len(sightings.outline(20, 1).way) == 1


def test_tracks_and_fit_of_different_shots_are_refused() -> None:
    tracks = replace(shot.tracks(TIMES), ids=("cue", "blue"))
    with pytest.raises(ValueError, match="same balls"):
        sight(shot.scene(), tracks, shot.fit(TIMES))
