"""Who is named, and that names can be read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support import staged_shot as shot

from models.core.events import Events
from models.core.fit_result import Fit
from models.core.tracks import Tracks
from video.drawing.label_layout import Side, overlap
from video.matting.ball_timeline import sight
from video.overlay.annotation import GO_STEP, MOST_WORDS, Annotation, annotate
from video.overlay.frame_overlay import Balls
from video.overlay.motion_marks import marks_of, path_of

TIMES = np.arange(31) / shot.RATE


def jumping(pixels: float) -> Tracks:
    """The red ball rests; its circle is found to either side of it in turn, `pixels` apart."""
    tracks = shot.tracks(TIMES)
    side = 0.5 * pixels * (-1.0) ** np.arange(len(TIMES))
    tracks.px[:, 1, 0] += side
    tracks.xy[:, 1, 0] += side / shot.SCALE
    return tracks


def creeping(metres: float) -> tuple[Tracks, Fit]:
    """The red ball goes so far from 0.2 to 0.3 s, and rests before and after."""
    fit, tracks = shot.fit(TIMES), shot.tracks(TIMES)
    gone = metres * np.clip((TIMES - 0.2) / 0.1, 0, 1)
    tracks.xy[:, 1, 0] += gone
    tracks.px[:, 1, 0] += shot.SCALE * gone
    old, end = fit.trajectory, TIMES[-1]
    position = np.concatenate([old.position[:2], np.repeat(old.position[2:], 3, axis=0)])
    position[3, 1] = [metres / 0.1, 0]
    position[4, 0] += [metres, 0]
    trajectory = replace(
        old, ball=np.array([0, 0, 1, 1, 1]), start=np.array([0, 0.1, 0, 0.2, 0.3]),
        end=np.array([0.1, end, 0.2, 0.3, end]), position=position, spin=np.zeros((5, 2, 3)),
        phase=("rest", "roll", "rest", "roll", "rest"), covariance=np.tile(np.eye(4) * 1e-8, (5, 1, 1)),
    )  # fmt: skip
    return tracks, replace(fit, trajectory=trajectory)


def test_a_resting_ball_whose_circle_jumps_is_neither_moved_nor_named() -> None:
    sightings = sight(shot.scene(), jumping(2.5), shot.fit(TIMES))
    assert not sightings.moves[:, 1].any()
    assert sightings.moves[5:, 0].all()
    assert len(path_of(sightings, shot.fit(TIMES), 1).t) == 0


def test_a_ball_is_named_once_it_gets_somewhere() -> None:
    radius = shot.RADIUS
    for way, named in ((0.1 * radius, False), (1.0 * radius, True)):
        tracks, fit = creeping(way)
        sightings = sight(shot.scene(), tracks, fit)
        assert sightings.moves[6:8, 1].all(), "it does move in the picture"
        assert bool(len(path_of(sightings, fit, 1).spans)) == named


def named_pair() -> tuple[Annotation, Balls]:
    """Two balls that move side by side, their names held upon each other."""
    tracks, fit = creeping(shot.RADIUS)
    annotation = annotate(sight(shot.scene(), tracks, fit), tracks, fit, shot.cloth(), 8.0)
    yes = np.ones(2, dtype=bool)
    centre = np.array([[150.0, 100.0], [150.0, 100.0]])
    balls = Balls(centre, np.full(2, 8.0), np.ones(2), np.zeros((2, 2)), yes, ~yes, yes)
    return annotation, balls


def test_of_two_names_that_meet_one_goes_at_once() -> None:
    annotation, balls = named_pair()
    for _ in range(round(1 / GO_STEP) + 1):
        for ball in (0, 1):
            annotation.sides[ball] = Side(0.0, 0.7), Side(0.0, 0.7)
        annotation.draw(shot.cloth(), 0.25, balls, np.full((2, 2), np.nan))
    assert annotation.clear == {0: 1.0, 1: 0.0}


def test_names_that_stand_do_not_cover_each_other() -> None:
    annotation, balls = named_pair()
    for _ in range(60):
        annotation.draw(shot.cloth(), 0.25, balls, np.full((2, 2), np.nan))
    first, second = annotation.named
    assert overlap(first, second) <= MOST_WORDS * second[2] * second[3]


def test_of_many_contacts_at_once_the_hardest_are_drawn() -> None:
    fit, count = shot.fit(TIMES), 9
    t = np.append(0.2 + 0.002 * np.arange(count - 1), 0.4)
    speed = np.append([0.3, 2.0, 0.1, 1.0, 5.0, 0.2, 3.0, 0.4], 0.05)
    first, second = fit.trajectory.ids[:2]
    sure, zero = np.ones(count), np.zeros(count)
    events = Events(
        ("ball",) * count, t, np.full(count, 1e-4), t * shot.RATE, (first,) * count, (second,) * count,
        np.full((count, 2), 0.3), sure, zero, zero, speed,
    )  # fmt: skip
    marks = marks_of(sight(shot.scene(), shot.tracks(TIMES), fit), replace(fit, events=events))
    np.testing.assert_allclose([mark.t for mark in marks], t[[1, 3, 4, 6, 8]])
