"""The places to check are those where the explanation or a track is least sure, each named in one sentence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import synthetic_run as shot

from models.core.fit_result import Cause, CauseHypothesis, Doubt, Fit, Moment, ShotExplanation
from models.core.naming import Naming
from models.core.tracks import Tracks
from pipeline.reporting.text.check_list import MAX_PLACES, CheckPlace, select_check_places
from pipeline.reporting.text.check_sentences import format_alternatives, format_check_place, format_least_sure

TIMES = np.arange(shot.FRAMES) / shot.RATE
TABLE = shot.make_scene().table
Case = tuple[Tracks, Fit]


def make_case(hidden: dict[int, slice] | None = None) -> Case:
    """White rolls at 1 m/s, red rests; balls are not detected in the `hidden` rows."""
    xy = shot.make_paths(TIMES).copy()
    for ball, rows in (hidden or {}).items():
        xy[rows, ball] = np.nan
    one = np.ones(xy.shape[:2])
    names = ("white", "red")
    colour = np.array([[95.0, 0.0, 3.0], [45.0, 60.0, 40.0]])
    tracks = Tracks(
        np.arange(shot.FRAMES), TIMES, names, names, xy, 100 * xy, 0.002 * one, 0.002 * one, 0 * xy, 3 * one, colour
    )
    return tracks, shot.make_fit(TIMES)


def moment(ball: str, t: float, *hypotheses: CauseHypothesis, doubts: tuple[Doubt, ...] = ()) -> Moment:
    return Moment(ball, t, 1e-3, np.array([0.2 + t, 0.5]), hypotheses, doubts)


def touch(other: str, p: float) -> tuple[CauseHypothesis, CauseHypothesis]:
    pair = CauseHypothesis("ball", other, p), CauseHypothesis("unexplained", "", 1 - p)
    return pair if p >= 0.5 else pair[::-1]


def select(case: Case, *moments: Moment, moving_at_start: tuple[str, ...] = ()) -> list[CheckPlace]:
    tracks, fit = case
    return select_check_places(tracks, replace(fit, explanation=ShotExplanation(moments, moving_at_start)), TABLE)


def codes(places: list[CheckPlace]) -> list[list[str]]:
    return [[reason.code for reason in place.reasons] for place in places]


def test_where_everything_is_sure_there_is_nothing_to_check() -> None:
    assert select(make_case(), moment("white", 0.3, *touch("red", 0.95))) == []


def test_an_undecided_contact_is_a_place_with_its_hypotheses_and_missed_frames() -> None:
    (place,) = select(make_case({0: slice(9, 11)}), moment("white", 0.33, *touch("red", 0.61), doubts=("hidden",)))
    assert (place.frame, place.balls) == (10, ("white", "red"))
    assert place.uncertainty == pytest.approx(0.39)
    assert format_check_place(place, Naming()) == (
        "White: what it met at 0.3300 s ± 1.0 ms is unsure: red 61 %, something else 39 %;"
        " it was not detected for 2 frames."
    )


def test_the_least_sure_comes_first_and_at_most_ten_remain() -> None:
    probabilities = np.linspace(0.3, 0.88, 7)
    moments = [moment(name, 0.1 * k, CauseHypothesis("cushion", "top", float(p)),
                      CauseHypothesis("unexplained", "", 1 - p))
               for k, p in enumerate(probabilities) for name in ("white", "red")]  # fmt: skip
    places = select(make_case(), *moments)
    assert len(places) == MAX_PLACES
    uncertainties = [place.uncertainty for place in places]
    assert uncertainties == sorted(uncertainties, reverse=True)
    assert uncertainties[0] == pytest.approx(0.7)


def test_places_of_one_ball_within_two_frames_are_one() -> None:
    first, same, later = (moment("white", t, *touch("red", 0.6)) for t in (0.30, 0.35, 0.50))
    assert codes(select(make_case(), first, same, later)) == [["undecided", "undecided"], ["undecided"]]
    (place, _) = select(make_case(), first, same, later)
    sentence = format_check_place(place, Naming())
    assert sentence.endswith("; also unsure at 0.3500 s ± 1.0 ms: red 60 %, something else 40 %.")


def test_a_rest_without_another_cause_is_no_place_to_check() -> None:
    rest = (CauseHypothesis("rest", "", 0.6), CauseHypothesis("none", "", 0.4))
    assert select(make_case(), moment("white", 0.3, *rest)) == []


def test_a_change_of_velocity_without_a_cause_is_named() -> None:
    (place,) = select(make_case(), moment("white", 0.3, CauseHypothesis("unexplained", "", 1.0), doubts=("no_cause",)))
    assert place.uncertainty == 1.0
    assert (
        format_check_place(place, Naming())
        == "White: it changes its speed or direction at 0.3000 s ± 1.0 ms for no known cause."
    )


def test_a_sure_contact_explains_the_change_of_the_other_ball_too() -> None:
    contact, rivals = moment("white", 0.3, *touch("red", 0.95)), moment("red", 0.31, *touch("blue", 0.002))
    assert select(make_case(), contact, rivals) == []
    assert codes(select(make_case(), rivals)) == [["unexplained"]]


@pytest.mark.parametrize(
    ("hypotheses", "question", "answer"),
    [
        ((("none", "", 0.8), ("ball", "red", 0.2)), "whether it touched another ball", "no contact"),
        ((("strike", "", 0.7), ("none", "", 0.3)), "whether it was struck", "strike 70 %, not str"),
        ((("pocket", "top", 0.7), ("none", "", 0.3)), "whether it fell into a pocket", "far-side p"),
    ],
)
def test_the_sentence_asks_what_the_moment_leaves_open(hypotheses: tuple, question: str, answer: str) -> None:
    (place,) = select(make_case(), moment("white", 0.3, *(CauseHypothesis(*one) for one in hypotheses)))
    sentence = format_check_place(place, Naming())
    assert sentence.startswith(f"White: {question} at 0.3000 s ± 1.0 ms is unsure: {answer}")


def test_long_gaps_of_moving_balls_are_places_and_those_of_resting_ones_are_none() -> None:
    (place,) = select(make_case({0: slice(6, 12), 1: slice(6, 12)}))
    assert (place.balls, place.frame, place.reasons[0].value) == (("white",), 8, 6.0)
    assert place.xy == pytest.approx([0.2 + 8 / shot.RATE, 0.5])
    assert format_check_place(place, Naming()) == "White: it moves, but is not detected for 6 frames around 0.267 s."
    assert select(make_case({0: slice(6, 8)})) == []


def test_a_gap_that_no_accepted_fit_bridges_is_less_sure() -> None:
    tracks, fit = make_case({0: slice(6, 12)})
    (bridged,) = select((tracks, fit))
    accepted = fit.accepted.copy()
    accepted[8, 0] = False
    measured = select((tracks, replace(fit, accepted=accepted, moving=fit.moving & accepted)))
    assert measured[0].uncertainty == pytest.approx(2 * bridged.uncertainty)


def test_a_track_that_ends_while_its_ball_moves_is_a_place_unless_the_ball_fell() -> None:
    tracks, fit = make_case({0: slice(16, None)})
    (place,) = select((tracks, fit))
    assert format_check_place(place, Naming()) == "White: it is not detected any more after 0.500 s, although it moves."
    events = replace(fit.events, kind=("strike", "pocket"))
    assert select((tracks, replace(fit, events=events))) == []


def test_motion_without_an_accepted_fit_is_a_place() -> None:
    tracks, fit = make_case()
    accepted = fit.accepted.copy()
    accepted[6:12] = False
    (place,) = select((tracks, replace(fit, accepted=accepted)))
    assert format_check_place(place, Naming()) == "White: its motion from 0.200 s to 0.400 s is not explained."


def test_a_detection_far_from_the_path_is_a_place_at_its_largest_distance() -> None:
    tracks, fit = make_case()
    residual = np.full_like(fit.residual, 1e-3)
    residual[7:9, 1] = [[0.02, 0.0], [0.04, 0.0]]
    (place,) = select((tracks, replace(fit, residual=residual)))
    assert (place.frame, place.balls) == (8, ("red",))
    assert format_check_place(place, Naming()) == "Red: it is detected 40 mm beside its path at 0.267 s."
    residual[7:9, 1] = [0.4 * TABLE.ball_radius, 0.0]  # nearer than half a radius
    assert select((tracks, replace(fit, residual=residual))) == []


@pytest.mark.parametrize(("offset", "found"), [(2.5, True), (3.5, False)])
def test_balls_that_pass_while_neither_is_detected_may_be_exchanged(offset: float, found: bool) -> None:
    tracks, fit = make_case({0: slice(6, 8), 1: slice(6, 8)})
    position = fit.trajectory.position.copy()
    position[1, 0] = [0.2 + 7 / shot.RATE, 0.5 + offset * TABLE.ball_radius]
    places = select((tracks, replace(fit, trajectory=replace(fit.trajectory, position=position))))
    assert codes(places) == ([["identity"]] if found else [])
    if found:
        assert "White: it and red pass each other at 0.233 s while neither is detected" in format_check_place(
            places[0], Naming()
        )


def test_like_colours_are_exchanged_more_easily() -> None:
    tracks, fit = make_case({0: slice(6, 8), 1: slice(6, 8)})
    position = fit.trajectory.position.copy()
    position[1, 0] = [0.2 + 7 / shot.RATE, 0.5 + 2.5 * TABLE.ball_radius]
    fit = replace(fit, trajectory=replace(fit.trajectory, position=position))
    (unlike,) = select((tracks, fit))
    (like,) = select((replace(tracks, colour=np.tile(tracks.colour[0], (2, 1))), fit))
    assert like.uncertainty == pytest.approx(0.7)
    assert unlike.uncertainty < 0.35


def test_a_ball_that_moves_when_it_is_first_detected_is_a_place_there() -> None:
    (place,) = select(make_case({0: slice(0, 5)}), moving_at_start=("white",))
    assert (place.frame, place.uncertainty) == (5, 0.6)
    assert "already moves when it is first detected, at 0.167 s" in format_check_place(place, Naming())
    (begun,) = select(make_case(), moving_at_start=("white",))
    assert (begun.frame, begun.uncertainty) == (0, 0.3)


def test_a_clip_without_frames_has_no_places() -> None:
    tracks, fit = make_case()
    empty = replace(
        tracks, frame=tracks.frame[:0], t=tracks.t[:0], xy=tracks.xy[:0], px=tracks.px[:0], sigma=tracks.sigma[:0],
        sigma_along=tracks.sigma_along[:0], streak=tracks.streak[:0], radius_px=tracks.radius_px[:0],
    )  # fmt: skip
    assert select_check_places(empty, fit, TABLE) == []


@pytest.mark.parametrize(
    ("kind", "other", "category", "words"),
    [("pocket", "top-right", "fall", "not potted 8 %: it is last detected where its path leads there"),
     ("pocket", "top-right", "vanish",
      "not potted 8 %: it is last detected near there"),
     ("strike", "", "strike", "not struck 8 %")],
)  # fmt: skip
def test_the_least_sure_event_names_its_alternative(kind: Cause, other: str, category: str, words: str) -> None:
    _, fit = make_case()
    events = replace(fit.events, kind=("strike", kind), b=("", other), probability=np.array([0.99, 0.92]))
    causes = (CauseHypothesis(kind, other, 0.92, category), CauseHypothesis("none", "", 0.08))
    explanation = ShotExplanation((moment("white", float(events.t[1]), *causes),))
    least = format_least_sure(events, range(2), explanation, Naming())
    rests = replace(events, kind=("rest", kind), probability=np.array([0.5, 0.92]))
    assert format_least_sure(rests, range(2), explanation, Naming()) == least, "a rest has an unsure time"
    assert least.startswith("white ")
    assert least.endswith(f" (92 %, or {words})")
    assert format_alternatives(events, 0, explanation, Naming()) == "", "no moment stands for it"
    assert format_least_sure(replace(events, probability=np.ones(2)), range(2), explanation, Naming()) == ""
