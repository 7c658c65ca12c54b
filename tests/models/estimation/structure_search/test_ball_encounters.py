"""Ball contacts without a visible velocity change: rows of balls, and racks."""

from __future__ import annotations

import numpy as np
import pytest
from support.filmed_shots import RADIUS, WIDTH, Filmed, film

from models.core.contact_graph import ClothFriction, Contact, ContactGraph, Segment
from models.estimation.joint_fit.contact_cascades import predict_cascade
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from models.physics.billiards.cloth.closed_form_motion import evaluate_kinematics

CLOTH = ClothFriction(0.2, 0.01)
GAP = 0.004
"""m between the balls of a row."""


def row_shot(balls: int, seed: int) -> Filmed:
    """A cue ball runs into a row of others, almost straight."""
    rng = np.random.default_rng(seed)
    x = np.zeros((balls + 1, 2))
    x[0] = [0.6, WIDTH / 2]
    x[1:, 0] = 1.2 + np.arange(balls) * (2 * RADIUS + GAP)
    x[1:, 1] = WIDTH / 2 + rng.uniform(-0.1, 0.1, balls) * RADIUS
    v, w = np.zeros_like(x), np.zeros((balls + 1, 3))
    v[0, 0] = rng.uniform(1.0, 2.0)
    w[0, 1] = v[0, 0] / RADIUS
    return film(x, v, w, rng, seconds=3.0, noise_px=0.5)


def resting_row(balls: int, v: float) -> ContactGraph:
    """Ball 0 runs at v m/s into a row of `balls` at rest; it touches the first at t = 0.1 s."""
    places = 0.5 + 2 * RADIUS + np.arange(balls) * (2 * RADIUS + GAP)
    segments = [Segment(0, False, None, None, 0.0, np.array([0.5 - 0.1 * v, 0.6, v, 0, 0, 0, 0, 0]))]
    segments += [
        Segment(k + 1, True, None, None, 0.0, np.array([x, 0.6, 0, 0, 0, 0, 0, 0])) for k, x in enumerate(places)
    ]
    return ContactGraph(tuple(segments), ())


def test_a_cascade_runs_down_a_row_at_the_speed_of_the_balls() -> None:
    hits = predict_cascade(resting_row(3, 1.0), CLOTH, 0, 1, 0.1, 0.05, RADIUS)
    assert [(hit.a, hit.b) for hit in hits[:3]] == [(0, 1), (1, 2), (2, 3)]
    pace = 0.975 * evaluate_kinematics(resting_row(3, 1.0).segments[0].state[None], np.array([0.1]), CLOTH)[0, 2]
    assert np.diff([hit.t for hit in hits[:3]]) == pytest.approx([GAP / pace, GAP / pace / 0.975], rel=0.02)


def test_a_cascade_keeps_momentum_and_gains_no_energy() -> None:
    graph = resting_row(4, 2.0)
    before = evaluate_kinematics(graph.segments[0].state[None], np.array([0.1]), CLOTH)[0, 2:4]
    v = {0: before} | {k: np.zeros(2) for k in range(1, 5)}
    for hit in predict_cascade(graph, CLOTH, 0, 1, 0.1, 0.05, RADIUS):
        v[hit.a], v[hit.b] = hit.after_a[2:4], hit.after_b[2:4]
        assert sum(v.values()) == pytest.approx(before)
        assert sum(float(u @ u) for u in v.values()) <= float(before @ before)


def test_a_cascade_begins_with_what_balls_did_before_the_change_that_it_explains() -> None:
    graph = resting_row(2, 1.0)
    after = np.array([*graph.segments[0].state[:2] + np.array([0.1, 0.0]), *np.zeros(6)])
    altered = graph.insert_contact(Contact("free", 0.1, (0,), ()), (after,))
    expected, fresh = (predict_cascade(s, CLOTH, 0, 1, 0.1, 0.05, RADIUS) for s in (graph, altered))
    assert [(hit.a, hit.b) for hit in fresh] == [(hit.a, hit.b) for hit in expected]
    assert [hit.t for hit in fresh] == pytest.approx([hit.t for hit in expected])


def test_nearly_every_first_contact_of_a_row_is_found() -> None:
    """A ball between two others hardly moves between its contacts, five milliseconds apart at 30 fps."""
    count = 0
    for seed in range(4):
        shot = row_shot(2, seed)
        events = view_shot(explain(shot.tracks, shot.scene)).events
        for t, kind, a, b in shot.contacts[:2]:
            count += any(
                events.kind[k] == kind and {events.a[k], events.b[k]} == {a, b} and abs(events.t[k] - t) < 1 / 60
                for k in range(len(events))
            )
    assert count >= 7


def test_merged_contacts_keep_what_the_others_join() -> None:
    zero = np.zeros(8)
    segments = tuple(Segment(k % 3, True, None, None, 0.1 * k, zero) for k in range(3))
    graph = ContactGraph(segments, ())
    for k, t in ((0, 1.0), (1, 1.1), (2, 1.2)):
        graph = graph.insert_contact(Contact("free", t, (k,), ()), (zero,))
    first, second = graph.contacts[0], graph.contacts[2]
    joined = Contact("ball", 1.1, (*first.before, *second.before), (*first.after, *second.after))
    merged = graph.merge_contacts(0, 2, joined)
    assert [c.kind for c in merged.contacts] == ["ball", "free"]
    for number, contact in enumerate(merged.contacts):
        assert {merged.segments[k].end for k in contact.before} == {number}
        assert {merged.segments[k].start for k in contact.after} == {number}


def test_a_part_of_a_graph_holds_only_contacts_within() -> None:
    graph = ContactGraph((Segment(0, True, None, None, 0.0, np.zeros(8)),), ())
    graph = graph.insert_contact(Contact("free", 1.0, (0,), ()), (np.ones(8),))
    graph = graph.insert_contact(Contact("free", 2.0, (1,), ()), (np.ones(8),))
    part = graph.select_segments([1, 2])
    assert [c.t for c in part.contacts] == [2.0]
    assert part.segments[0].start is None
    assert part.segments[0].t0 == 1.0
    assert (part.segments[0].end, part.segments[1].start) == (0, 0)


def test_only_the_first_strike_can_be_a_cues() -> None:
    moving = np.array([0.5, 0.5, 1.0, 0, 1.0, 0, 0, 0])
    graph = ContactGraph(tuple(Segment(k, True, None, None, 0.0, np.zeros(8)) for k in range(2)), ())
    graph = graph.insert_contact(Contact("strike", 1.0, (0,), ()), (moving,))
    graph = graph.insert_contact(Contact("strike", 1.5, (1,), ()), (moving,))
    assert [c.pushed for c in graph.mark_pushed_strikes().contacts] == [False, True]
