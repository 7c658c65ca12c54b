"""Caroms and fouls are called as shots with known truth were played."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support import fixed_step_table as truth
from support.filmed_shots import DELAY, RADIUS, Filmed, film

from models.core.events import Events
from models.core.fit_result import CauseHypothesis, Moment, ShotExplanation
from models.core.number_format import format_probability
from models.core.scene import CUSHIONS
from models.estimation.contact_test import rule_answers
from models.estimation.contact_test.call_answers import answer_first_contact
from models.estimation.contact_test.rule_answers import answer_foul, answer_score
from models.estimation.contact_test.shot_record import CandidateContact, ShotRecord, make_shot_record
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from pipeline.reporting.text.call_sentences import UNCHANGED, format_call

START = np.array([[0.6, 0.4], [1.3, 0.62]])
"""m, the cue ball and the first ball of every carom."""
AIM = np.array([3.262, 1.268])
"""m/s, at which the cue ball grazes the first ball and goes on to the cushions."""
SPIN = np.array([-AIM[1], AIM[0], 0.0]) / RADIUS
SECONDS = 5.0


def play(x: np.ndarray, v: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Play a shot: times (T,) s, paths (T, N, 2) m, and the contacts (K, 5)."""
    return truth.play(x, v, w, seconds=SECONDS - DELAY, fps=600, law=truth.MIRROR, pocket=0.0, mu_s=0.2, mu_r=0.01)


def build_record(filmed: Filmed) -> ShotRecord:
    """Explain a filmed shot."""
    shot = explain(filmed.tracks, filmed.scene)
    fit = view_shot(shot)
    return make_shot_record(
        filmed.tracks, fit.events, fit.trajectory, filmed.scene.table, filmed.scene.camera, fit.explanation
    )


@cache
def film_carom(cushions: int, gap: float) -> tuple[Filmed, ShotRecord]:
    """A carom whose second ball lies beside the path after a number of cushions; it is missed by a gap, m, if > 0."""
    v, w = np.zeros((3, 2)), np.zeros((3, 3))
    v[0], w[0] = AIM, SPIN
    t, path, log = play(START, v[:2], w[:2])
    rails = [row[0] for row in log if row[1] == 1 and row[2] == 0]
    assert len(rails) > cushions, "the shot reaches enough cushions"
    since = rails[cushions - 1] if cushions else next(row[0] for row in log if row[1] == 2)
    options = []
    for share in (0.3, 0.5, 0.7):
        k = int(np.searchsorted(t, since + share * (rails[cushions] - since)))
        along = path[k + 1, 0] - path[k - 1, 0]
        across = np.array([-along[1], along[0]]) / np.hypot(*along)
        for side in (1, -1):
            place = path[k, 0] + side * (2 * RADIUS + gap) * across
            options.append((np.linalg.norm(path[t < since] - place, axis=2).min(), place))
    free, second = max(options, key=lambda option: option[0])
    assert free > 2.5 * RADIUS, "nothing touches the second ball before"
    filmed = film(np.vstack([START, second]), v, w, np.random.default_rng(cushions), seconds=SECONDS, missing=0.0)
    return filmed, build_record(filmed)


def find_truth(filmed: Filmed) -> tuple[float, list[float]]:
    """The time of the contact with the second ball (infinite for none), and those of the cushions of the cue ball."""
    second = [t for t, kind, *pair in filmed.contacts if kind == "ball" and {*pair} == {"cue", "solid-2"}]
    return min(second, default=math.inf), [t for t, kind, a, _ in filmed.contacts if (kind, a) == ("cushion", "cue")]


@pytest.mark.parametrize("cushions", [0, 1, 2, 3])
def test_a_carom_counts_the_cushions_before_the_second_ball(cushions: int) -> None:
    filmed, record = film_carom(cushions, -0.02)
    second, rails = find_truth(filmed)
    assert sum(t < second for t in rails) == cushions
    score = answer_score(record)
    assert (score.verdict, score.subject) == ("yes", ("cue", "solid-1", "solid-2"))
    assert score.t == pytest.approx(second, abs=0.004)
    one, three = score.parts[2:]
    assert (one.verdict, three.verdict) == ("yes" if cushions >= 1 else "no", "yes" if cushions >= 3 else "no")
    told = [entry.t for entry in score.path if entry.other in CUSHIONS]
    assert told == pytest.approx(rails, abs=0.01)


@pytest.mark.parametrize("gap", [0.02, 0.0005])
def test_a_missed_ball_is_no_point_or_undecided_and_says_by_how_much(gap: float) -> None:
    filmed, record = film_carom(3, gap)
    assert find_truth(filmed)[0] == math.inf
    score = answer_score(record)
    assert score.verdict == "no" if gap > 0.01 else score.verdict != "yes"
    assert score.margin == pytest.approx(gap, abs=max(4 * score.margin_sigma, 1e-3))
    assert score.parts[3].verdict == score.verdict
    assert score.doubts or score.verdict != "inconclusive"
    sentence = format_call(score, record.naming).sentence
    assert (UNCHANGED in sentence) == (gap < 0.01), "the gap alone does not decide, but the motion after it does"


def touch(other: str, t: float, probability: float, t_sigma: float = 1e-3) -> CandidateContact:
    """A possible contact of the cue ball."""
    return CandidateContact(0, other, t, t_sigma, probability, math.nan, math.nan)


def test_the_order_of_two_contacts_is_as_sure_as_their_times() -> None:
    balls = [[touch("red", 0.5, 1.0)], [touch("yellow", 2.0, 0.9)]]
    rails = [touch("left", 1.0, 1.0), touch("top", 1.5, 0.8), touch("right", 2.0 - 1e-9, 1.0, 0.01)]
    shares = rule_answers._count_cushions(balls, rails)
    assert shares.sum() == pytest.approx(0.9)
    assert shares == pytest.approx([0.0, 0.9 * 0.2 * 0.5, 0.9 * 0.5, 0.9 * 0.8 * 0.5], abs=1e-6)
    later = [*rails[:2], touch("right", 2.01, 1.0, 0.01)]
    assert rule_answers._count_cushions(balls, later)[3] == pytest.approx(0.9 * 0.8 * 0.160, abs=2e-3)  # a sigma late
    either = [touch("left", 1.0, 1.0), touch("top", 1.5, 1.0), touch("right", 2.0, 0.1)]
    assert rule_answers._count_cushions(balls, either)[3] == 0.0, "of hypotheses about one moment, one holds"


def film_pool(
    first: tuple[float, float], v: tuple[float, float], pocket: float = 0.0, seconds: float = 3.0
) -> tuple[Filmed, ShotRecord]:
    """A cue ball at (0.6, 0.6) m, an object ball, and one that nothing touches."""
    x = np.array([[0.6, 0.6], first, [2.2, 0.3]])
    velocity, w = np.zeros((3, 2)), np.zeros((3, 3))
    velocity[0], w[0, :2] = v, np.array([-v[1], v[0]]) / RADIUS
    filmed = film(x, velocity, w, np.random.default_rng(3), seconds=seconds, missing=0.0, pocket=pocket)
    return filmed, build_record(filmed)


def list_fouls(record: ShotRecord, on: str = "") -> tuple[str, dict[str, str]]:
    """The verdict on a foul, and those of its parts."""
    foul = answer_foul(record, "", on)
    return foul.verdict, {part.kind: part.verdict for part in foul.parts}


def test_no_rail_after_contact_is_a_foul_and_says_how_near_a_ball_came() -> None:
    filmed, record = film_pool((0.9, 0.6), (0.6, 0.0))
    assert all(kind == "ball" for _, kind, *_ in filmed.contacts)
    verdict, parts = list_fouls(record)
    assert (verdict, parts["no-contact"], parts["no-rail"]) == ("yes", "no", "yes")
    no_rail = next(part for part in answer_foul(record).parts if part.kind == "no-rail")
    assert (no_rail.balls, no_rail.met) == (("solid-1",), "right")
    assert no_rail.margin == pytest.approx(2.54 - RADIUS - filmed.xy[:, 1, 0].max(), abs=0.005)
    snooker, carom = (replace(record, table=replace(record.table, game=game)) for game in ("snooker", "carom"))
    assert list_fouls(snooker)[0] == "no", "snooker has no such rule"
    with pytest.raises(ValueError, match="foul is a question of pool and snooker"):
        answer_foul(carom)


def test_a_rail_is_looked_for_in_the_whole_clip_where_the_time_of_the_contact_is_unknown() -> None:
    _, record = film_pool((0.9, 0.6), (0.6, 0.0))
    unknown, whole = (rule_answers._find_nearest_rail(record, t) for t in (np.nan, -1.0))
    assert (unknown.ball, unknown.other, unknown.t) == (whole.ball, whole.other, whole.t)


def test_a_ball_on_a_rail_after_the_contact_is_no_foul() -> None:
    _, record = film_carom(0, -0.02)
    verdict, parts = list_fouls(record, "solids")
    assert verdict == "no"
    assert set(parts.values()) == {"no"}
    assert {"no-contact", "wrong-ball", "no-rail", "frozen"} == set(parts)


def test_the_first_ball_is_judged_by_what_is_on_and_not_where_that_is_unknown() -> None:
    _, record = film_pool((0.9, 0.6), (0.6, 0.0))
    assert "wrong-ball" not in list_fouls(record)[1]
    assert list_fouls(record, "solid-1")[1]["wrong-ball"] == "no"
    assert list_fouls(record, "solid-2")[1]["wrong-ball"] == "yes"
    with pytest.raises(ValueError, match="no ball of this clip"):
        answer_foul(record, "", "stripes")


def weaken(record: ShotRecord, cause: str, p: float) -> ShotRecord:
    """The record with the probability p of the first moment with a cause, which may have had another one instead."""
    moments = list(record.explanation.moments)
    k = next(k for k, moment in enumerate(moments) if moment.best.cause == cause)
    doubt = CauseHypothesis("unexplained", "", 1 - p)
    moments[k] = replace(moments[k], hypotheses=(replace(moments[k].best, probability=p), doubt))
    return replace(record, explanation=replace(record.explanation, moments=tuple(moments)))


def test_a_foul_is_undecided_where_the_ball_that_was_hit_first_is() -> None:
    _, clear = film_carom(0, -0.02)
    record = weaken(clear, "ball", 0.6)
    first, foul = answer_first_contact(record, "cue"), answer_foul(record)
    assert (first.verdict, foul.verdict) == ("inconclusive", "inconclusive")
    assert foul.doubts == first.doubts
    assert foul.stated_probability < 0.9
    no_contact = format_call(foul.parts[0], record.naming)
    assert no_contact.verdict == "no"
    assert "(or an unknown ball " in no_contact.statement
    assert answer_foul(clear).verdict == "no"


@pytest.mark.parametrize(("on", "likely"), [("solid-1", "no foul"), ("solid-2", "wrong ball first")])
def test_an_undecided_foul_names_the_side_that_its_probability_is_of(on: str, likely: str) -> None:
    foul = answer_foul(weaken(film_carom(0, -0.02)[1], "ball", 0.6), "", on)
    assert foul.verdict == "inconclusive"
    words = format_call(foul, film_carom(0, -0.02)[1].naming)
    assert words.likely == likely
    stated = format_probability(foul.probability if foul.probability > 0.5 else 1 - foul.probability)
    assert words.headline == f"Cannot be decided ({likely}: {stated})"


def test_a_struck_ball_that_does_not_move_is_told_from_the_one_that_does() -> None:
    with pytest.raises(ValueError, match="solid 2 does not move in this clip; the cue ball was struck"):
        answer_foul(film_pool((0.9, 0.6), (0.6, 0.0))[1], "solid-2")


def test_a_ball_that_moves_when_the_clip_begins_is_no_part_of_a_stroke_that_the_clip_shows() -> None:
    _, record = film_pool((0.9, 0.6), (0.6, 0.0))
    record = replace(record, explanation=replace(record.explanation, moving_at_start=("solid-2",)))
    assert answer_first_contact(record, "cue").verdict == "yes"
    assert answer_first_contact(weaken(record, "strike", 0.3), "cue").verdict == "inconclusive"


def test_a_cue_ball_in_a_pocket_that_met_no_ball_is_two_fouls() -> None:
    aim = np.array([2.54, 1.27]) - [0.6, 0.6]
    _, record = film_pool((0.6, 1.0), tuple(2.5 * aim / np.hypot(*aim)), pocket=0.06)
    foul = answer_foul(record)
    verdicts = {part.kind: part.verdict for part in foul.parts}
    assert (foul.verdict, verdicts["no-contact"], verdicts["scratch"]) == ("yes", "yes", "yes")
    assert "no-rail" not in verdicts, "there is no contact after which it could be asked"
    near = next(part for part in foul.parts if part.kind == "no-contact")
    assert near.margin > 0.1


@pytest.mark.parametrize(("gap", "wanted"), [(0.0, {"yes", "inconclusive"}), (0.02, {"no"})])
def test_a_frozen_ball_is_one_that_no_gap_can_be_measured_to(gap: float, wanted: set[str]) -> None:
    _, record = film_pool((0.6 + 2 * RADIUS + gap, 0.6), (1.0, 0.2))
    frozen = next(part for part in answer_foul(record).parts if part.kind == "frozen")
    assert frozen.verdict in wanted
    assert frozen.margin == pytest.approx(gap, abs=4 * frozen.margin_sigma)


def test_a_later_stroke_does_not_mend_the_first_one() -> None:
    _, record = film_pool((0.9, 0.6), (0.6, 0.0))
    nan = np.array([math.nan])
    events = Events(("strike", "strike"), np.array([DELAY, 2.9]), np.full(2, 1e-3), np.array([12.0, 87.0]),
                    ("cue", "cue"), ("", ""), np.zeros((2, 2)), np.ones(2), np.repeat(nan, 2), np.repeat(nan, 2),
                    np.repeat(nan, 2))  # fmt: skip
    rail = Moment("solid-1", 2.95, 1e-3, np.zeros(2), (CauseHypothesis("cushion", "right", 1.0),))
    explanation = ShotExplanation((*record.explanation.moments, rail))
    two = replace(record, events=events, explanation=explanation)
    assert list_fouls(two)[1]["no-rail"] == "yes"
    assert list_fouls(replace(two, events=record.events))[1]["no-rail"] == "no", "without a second stroke it counts"
