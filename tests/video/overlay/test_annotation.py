"""Selection of the named balls, and legibility of the names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support import staged_shot as shot

from models.core.events import Events
from models.core.fit_result import Fit
from models.core.tracks import Tracks
from video.drawing.label_layout import LabelPosition, overlap_share
from video.matting.ball_timeline import build_ball_timeline
from video.overlay.annotation import Annotation, prepare_annotation
from video.overlay.frame_overlay import FrameBalls
from video.overlay.motion_paths import FAINT_OPACITY, ContactMark, sample_motion_path, select_contact_marks
from video.overlay.slow_motion import MAX_REPLAYS, select_replay_marks

TIMES = np.arange(31) / shot.RATE


def jumping(pixels: float) -> Tracks:
    """The red ball rests; its circle is detected on either side of it in turn, `pixels` apart."""
    tracks = shot.tracks(TIMES)
    side = 0.5 * pixels * (-1.0) ** np.arange(len(TIMES))
    tracks.px[:, 1, 0] += side
    tracks.xy[:, 1, 0] += side / shot.SCALE
    return tracks


def creeping(metres: float) -> tuple[Tracks, Fit]:
    """The red ball moves by so many metres from 0.2 to 0.3 s, and rests before and after."""
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
    timeline = build_ball_timeline(shot.scene(), jumping(2.5), shot.fit(TIMES))
    assert not timeline.moving[:, 1].any()
    assert timeline.moving[5:, 0].all()
    assert len(sample_motion_path(timeline, shot.fit(TIMES), 1).t) == 0


def test_a_ball_is_named_once_it_travels() -> None:
    radius = shot.RADIUS
    for way, named in ((0.1 * radius, False), (1.0 * radius, True)):
        tracks, fit = creeping(way)
        timeline = build_ball_timeline(shot.scene(), tracks, fit)
        assert timeline.moving[6:8, 1].all(), "it does move in the frame"
        assert bool(len(sample_motion_path(timeline, fit, 1).spans)) == named


def overlapping_pair() -> tuple[Annotation, FrameBalls]:
    """Two balls that move side by side, with overlapping names."""
    tracks, fit = creeping(shot.RADIUS)
    annotation = prepare_annotation(build_ball_timeline(shot.scene(), tracks, fit), tracks, fit, shot.cloth(), 8.0)
    yes = np.ones(2, dtype=bool)
    centre = np.array([[150.0, 100.0], [150.0, 100.0]])
    balls = FrameBalls(centre, np.full(2, 8.0), np.ones(2), np.zeros((2, 2)), yes, ~yes, yes)
    return annotation, balls


def test_one_of_two_overlapping_names_disappears_at_once() -> None:
    annotation, balls = overlapping_pair()
    annotation.labels.opacity = {0: 1.0, 1: 1.0}
    for ball in (0, 1):
        annotation.labels.positions[ball] = LabelPosition(0.0, 0.7), LabelPosition(0.0, 0.7)
    annotation.draw(shot.cloth(), 0.25, balls, np.full((2, 2), np.nan))
    assert annotation.labels.opacity == {0: 1.0, 1: 0.0}


def test_visible_names_do_not_cover_each_other() -> None:
    annotation, balls = overlapping_pair()
    for _ in range(60):
        annotation.draw(shot.cloth(), 0.25, balls, np.full((2, 2), np.nan))
    first, second = annotation.name_rects
    assert overlap_share(first, [second]) == 0


def test_only_the_hardest_of_many_simultaneous_contacts_are_drawn() -> None:
    fit, count = shot.fit(TIMES), 9
    t = np.append(0.2 + 0.002 * np.arange(count - 1), 0.4)
    speed = np.append([0.3, 2.0, 0.1, 1.0, 5.0, 0.2, 3.0, 0.4], 0.05)
    first, second = fit.trajectory.ids[:2]
    sure, zero = np.ones(count), np.zeros(count)
    events = Events(
        ("ball",) * count, t, np.full(count, 1e-4), t * shot.RATE, (first,) * count, (second,) * count,
        np.full((count, 2), 0.3), sure, zero, zero, speed,
    )  # fmt: skip
    marks = select_contact_marks(
        build_ball_timeline(shot.scene(), shot.tracks(TIMES), fit), replace(fit, events=events)
    )
    np.testing.assert_allclose([mark.t for mark in marks], t[[1, 3, 4, 6, 8]])


def marks_of(*probabilities: float) -> tuple[ContactMark, ...]:
    """Cushion contacts of the cue ball with these probabilities, 0.1 s apart."""
    fit, count = shot.fit(TIMES), len(probabilities)
    t, nan = 0.2 + 0.1 * np.arange(count), np.full(count, np.nan)
    events = Events(
        ("cushion",) * count, t, np.full(count, 1e-4), t * shot.RATE, ("cue",) * count, ("top",) * count,
        np.full((count, 2), 0.3), np.array(probabilities), nan, nan, np.ones(count),
    )  # fmt: skip
    timeline = build_ball_timeline(shot.scene(), shot.tracks(TIMES), fit)
    return select_contact_marks(timeline, replace(fit, events=events))


def test_undecided_events_are_faint_with_their_probability_and_improbable_ones_not_drawn() -> None:
    sure, undecided, unlikely = marks_of(0.95, 0.61, 0.05, 0.1)
    assert (sure.label.name, sure.opacity) == ("cue – far long rail", 1.0)
    assert "%" not in sure.label.value
    assert (undecided.label.name, undecided.opacity) == ("cue – far long rail ?", FAINT_OPACITY)
    assert undecided.label.value.endswith("61 %")
    assert unlikely.label.value.endswith("10 %")


def test_an_undecided_flash_and_its_label_change_the_image_less() -> None:
    timeline = build_ball_timeline(shot.scene(), shot.tracks(TIMES), shot.fit(TIMES))
    nothing = np.full((2, 2), np.nan)
    yes = np.ones(2, dtype=bool)
    balls = FrameBalls(nothing, np.full(2, 8.0), np.zeros(2), np.zeros((2, 2)), ~yes, ~yes, yes)
    changes = []
    for opacity in (1.0, FAINT_OPACITY):
        annotation = prepare_annotation(timeline, shot.tracks(TIMES), shot.fit(TIMES), shot.cloth(), 8.0)
        (mark,) = marks_of(0.95)
        images = [shot.cloth(), shot.cloth()]
        for k, marks in enumerate(((), (replace(mark, opacity=opacity),))):
            annotation.marks = marks
            images[k] = annotation.draw(images[k], 0.23, balls, nothing)
        changes.append(float(np.abs(images[1].astype(float) - images[0]).sum()))
    assert 0.3 * changes[0] < changes[1] < 0.7 * changes[0]


def test_replays_show_sure_contacts_first() -> None:
    marks = marks_of(0.95, *[0.5] * MAX_REPLAYS)
    selected = select_replay_marks(marks[::-1])
    assert selected[0] == marks[0]
    assert len(selected) == MAX_REPLAYS
