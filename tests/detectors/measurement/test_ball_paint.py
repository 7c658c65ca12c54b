"""Rendered balls of known colour and number get their name or none, and the colour that the picture shows."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from skimage.color import deltaE_ciede2000, rgb2lab

from benchmarks.detection.rendered_sets import measure_set, name_as_person, render_set
from models.core.ball_look import UNKNOWN_COLOUR

BLUE, GREEN, TAN = (0.13, 0.47, 0.68), (0.10, 0.50, 0.27), (0.62, 0.50, 0.33)
MAX_DIFFERENCE = 5.0
"""CIEDE2000 between the colour of a look and the centre of a ball without a number there."""


@pytest.mark.parametrize(
    ("numbers", "seed", "cloth", "light"),
    [
        (tuple(range(16)), 1, BLUE, (1.0, 1.0, 1.0)),
        ((0, 1, 3, 6, 9, 14), 2, GREEN, (1.0, 0.85, 0.6)),
        ((2, 4, 5, 7, 8, 10, 15), 3, TAN, (0.85, 1.0, 0.8)),
    ],
)
def test_a_ball_gets_its_own_name_or_number_or_none(
    numbers: tuple[int, ...],
    seed: int,
    cloth: tuple[float, float, float],
    light: tuple[float, float, float],
) -> None:
    rendered = render_set(numbers, seed, cloth, light)
    looks = rendered.describe()
    assert {look.number for look, number in zip(looks, numbers, strict=True) if look.number not in (0, number)} == set()
    assert np.count_nonzero([look.number for look in looks]) >= len(numbers) / 2
    right = [look.name in name_as_person(number) for look, number in zip(looks, numbers, strict=True)]
    assert np.mean(right) >= 0.95, [look.name for look in looks]


def test_the_colour_of_a_look_is_that_of_the_ball_in_the_picture() -> None:
    rendered = render_set((0, 1, 2, 3, 4, 5, 6, 7, 8), 4)
    for k, look in enumerate(rendered.describe()):
        column, row = np.rint(rendered.tracks.px[0, k]).astype(int)
        half = round(rendered.tracks.radius_px[0, k] / 2)
        middle = (slice(row - half, row + half + 1), slice(column - half, column + half + 1))
        shown = np.median([image[middle] for _, image in rendered.frames], axis=(0, 1, 2))
        difference = float(deltaE_ciede2000(*(rgb2lab(np.array([one]) / 255) for one in (shown, look.colour)))[0])
        assert difference < MAX_DIFFERENCE, (look, shown)


def test_a_ball_that_no_frame_shows_keeps_the_colour_of_its_class_and_has_no_number() -> None:
    rendered = render_set((0, 1, 3), 5)
    hidden = np.array([False, True, False])
    tracks = replace(rendered.tracks, xy=np.where(hidden[:, None], np.nan, rendered.tracks.xy))
    unseen, shown = replace(rendered, tracks=tracks).describe()[1:]
    assert (unseen.colour, unseen.number) == (UNKNOWN_COLOUR, 0)
    assert shown.name in name_as_person(3)


def test_coarse_chroma_and_overexposed_pixels_do_not_dilute_the_colour_of_a_ball() -> None:
    numbers = (0, 3, 5, 12)
    rendered = render_set(numbers, 6)
    spoiled = []
    for frame, image in rendered.frames:
        small = cv2.resize(cv2.cvtColor(image, cv2.COLOR_RGB2YCrCb)[..., 1:], None, fx=0.25, fy=0.25)
        coded = cv2.cvtColor(image, cv2.COLOR_RGB2YCrCb)
        coded[..., 1:] = cv2.resize(small, image.shape[1::-1])
        result = cv2.cvtColor(coded, cv2.COLOR_YCrCb2RGB)
        for (x, y), radius in zip(rendered.tracks.px[0], rendered.tracks.radius_px[0], strict=True):
            cv2.circle(result, (round(x), round(y)), round(0.35 * radius), (255, 255, 190), -1)
        spoiled.append((frame, result))
    spoiled_looks = replace(rendered, frames=tuple(spoiled)).describe()
    colours = [
        rgb2lab(np.array([[look.colour for look in looks]]) / 255)[0] for looks in (rendered.describe(), spoiled_looks)
    ]
    assert deltaE_ciede2000(*colours)[1:].max() < MAX_DIFFERENCE


@pytest.mark.filterwarnings("error")
def test_small_balls_in_an_oblique_view_leave_pixels_to_measure() -> None:
    rows = measure_set(9, 11)
    assert np.isfinite([difference for _, difference, _ in rows]).all()
    assert not [row for row in rows if row[2] == "WRONG NUMBER"]
