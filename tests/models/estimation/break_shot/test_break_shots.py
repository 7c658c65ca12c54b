"""Break shots: contacts within a frame are reconstructed from where the balls went."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from support.filmed_shots import RADIUS, Filmed, film, scene

from models.core.fit_result import Fit
from models.core.typing import FloatArray
from models.estimation.break_shot.break_search import search_break, summarize_break
from models.estimation.break_shot.break_simulation import OVERLAP_SIGMA, BreakModel, BreakShot
from models.estimation.contact_test.call_answers import answer_contact, answer_first_contact
from models.estimation.contact_test.shot_record import make_shot_record
from models.estimation.reconstruction import explain_shot
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from models.estimation.shot_numbers.measure_shots import measure_shots

SIGMA, INTERVAL = 0.002, 1 / 30
"""m, and s between frames."""


def rack(rows: int, rng: np.random.Generator) -> FloatArray:
    """Balls (N, 2) m of a triangle, up to half a millimetre off their places."""
    pitch = 2 * RADIUS + 6e-4
    places = [(1.7 + row * pitch * np.sqrt(0.75), 0.63 + (k - row / 2) * pitch) for row in range(rows)
              for k in range(row + 1)]  # fmt: skip
    return np.array(places) + rng.uniform(-2.5e-4, 2.5e-4, (len(places), 2))


def hit(rows: int, seed: int, noise: float = SIGMA) -> tuple[BreakShot, FloatArray]:
    """A rack that a ball runs into, as measured by a camera, and the parameters (P,) that it was simulated from."""
    rng = np.random.default_rng(seed)
    lying = rack(rows, rng)
    coming = np.array([1.4, 0.635, 4.0, 0.05, 1.0, 0.0, 0.3])
    count, contact = len(lying) + 1, 0.06
    t = INTERVAL * np.arange(7)
    empty = BreakShot(
        tuple(range(count)), 0.0, contact, coming, np.full(7, np.inf), lying, np.full(count - 1, 4e-4),
        np.array([t[-1]]), np.zeros(1, np.int64), np.zeros((1, 2)), np.eye(2)[None], INTERVAL, (0.2, 0.01), 1.0,
        scene().table,
    )  # fmt: skip
    numbers = np.concatenate([coming, lying.ravel(), [0.2, 0.95, 1.0]])
    path = BreakModel(empty, np.inf).simulate(numbers).states_at(t)[..., :2]
    frame, ball = np.nonzero((t[:, None] > contact) | (np.arange(count) == 0))
    measured = path[frame, ball] + rng.normal(0, noise, (len(frame), 2))
    break_shot = BreakShot(
        empty.balls, 0.0, contact, coming + np.array([0, 0, 0.1, 0.05, -1.0, 0.2, -0.3]), empty.incoming_sigma,
        lying + rng.normal(0, 4e-4, lying.shape), empty.rest_sigma, t[frame], ball, measured,
        np.repeat(np.eye(2)[None] / SIGMA, len(frame), axis=0), INTERVAL, (0.2, 0.01), 1.0, scene().table,
    )  # fmt: skip
    return break_shot, numbers


def test_slopes_are_those_of_small_steps() -> None:
    break_shot, numbers = hit(2, 3, noise=0.0)
    model = BreakModel(break_shot, np.inf)
    _, run = model.evaluate_residuals(numbers)
    slope, step = model.evaluate_jacobian(numbers, run), 1e-7
    for k in range(len(numbers)):
        by = np.where(np.arange(len(numbers)) == k, step, 0.0)
        ahead, behind = model.evaluate_residuals(numbers + by)[0], model.evaluate_residuals(numbers - by)[0]
        np.testing.assert_allclose((ahead - behind) / (2 * step), slope[:, k], rtol=2e-3, atol=0.05)


def test_overlapping_balls_are_moved_apart_and_others_stay() -> None:
    break_shot, numbers = hit(3, 1)
    squeezed = numbers.copy()
    places = squeezed[7:-3].reshape(-1, 2)
    places[:] = places.mean(axis=0) + 0.995 * (places - places.mean(axis=0))
    model = BreakModel(break_shot, np.inf)
    free = model.separate_balls(squeezed)[7:-3].reshape(-1, 2)
    apart = np.linalg.norm(free[:, None] - free, axis=2)[np.triu_indices(len(free), 1)]
    assert apart.min() > 2 * RADIUS - OVERLAP_SIGMA
    assert np.abs(free - places).max() < 1e-3
    np.testing.assert_array_equal(model.separate_balls(numbers), numbers)


def contacts_of(break_shot: BreakShot, numbers: FloatArray) -> list[frozenset[int]]:
    """Pairs of balls that meet within 50 ms of the hit, faster than 6 cm/s."""
    events = BreakModel(break_shot, np.inf).simulate(numbers).events
    early = (np.array(events.kind) == "ball") & (events.t < break_shot.hit + 0.06) & (events.speed > 0.06)
    return [frozenset((int(events.a[k]), int(events.b[k]))) for k in np.flatnonzero(early)]


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_search_finds_the_contacts_that_no_frame_shows(seed: int) -> None:
    break_shot, numbers = hit(4, seed)
    ensemble = search_break(break_shot, np.random.default_rng(seed))
    assert ensemble is not None
    assert ensemble.chi2_per_dof < 2
    assert ensemble.weight.sum() == pytest.approx(1.0)
    pairs = [frozenset((touch.a, touch.b)) for touch in summarize_break(ensemble).contacts if touch.speed > 0.06]
    true = contacts_of(break_shot, numbers)
    shared = sum(min(pairs.count(pair), true.count(pair)) for pair in set(true))
    assert shared > 0.8 * len(true)
    assert shared > 0.8 * len(pairs)


def test_the_same_seed_gives_the_same_simulation() -> None:
    break_shot, _ = hit(3, 4)
    one, two = (search_break(break_shot, np.random.default_rng(7)) for _ in range(2))
    assert one is not None
    assert two is not None
    np.testing.assert_array_equal(one.samples[0].parameters, two.samples[0].parameters)


def test_a_break_that_no_simulation_explains_is_not_reconstructed() -> None:
    break_shot, _ = hit(3, 5)
    shuffled = np.random.default_rng(0).permutation(break_shot.xy)
    nonsense = BreakShot(*(shuffled if name == "xy" else getattr(break_shot, name) for name in BreakShot.__slots__))
    assert search_break(nonsense, np.random.default_rng(1)) is None


def simulate_break(seed: int) -> Filmed:
    """A break of a rack of ten on an independent table."""
    rng = np.random.default_rng(seed)
    x = np.concatenate([[[0.7, 0.60]], rack(4, rng)])
    v, w = np.zeros_like(x), np.zeros((len(x), 3))
    v[0] = 4.5 * (x[1] - x[0]) / np.hypot(*(x[1] - x[0]))
    return film(x, v, w, rng, noise_px=0.8, seconds=1.6)


@cache
def reconstruct_break(seed: int) -> tuple[Filmed, Fit]:
    filmed = simulate_break(seed)
    return filmed, view_shot(explain(filmed.tracks, filmed.scene))


def early(filmed: Filmed, fit: Fit) -> tuple[list[frozenset[str]], list[frozenset[str]]]:
    """Contacts of balls within 50 ms of the first one: the true ones, and the fitted ones."""
    true = [(t, frozenset((a, b))) for t, kind, a, b in filmed.contacts if kind == "ball"]
    until = min(t for t, _ in true) + 0.05
    events = fit.events
    fitted = [(events.t[k], frozenset((events.a[k], events.b[k]))) for k in range(len(events))
            if events.kind[k] == "ball"]  # fmt: skip
    return [pair for t, pair in true if t <= until], [pair for t, pair in fitted if t <= until]


@pytest.mark.parametrize("seeds", [(1,), pytest.param((1, 2, 3), marks=pytest.mark.slow)])
def test_a_break_is_reconstructed_contact_by_contact(seeds: tuple[int, ...]) -> None:
    pairs, true, shared = 0, 0, 0
    for seed in seeds:
        filmed, fit = reconstruct_break(seed)
        happened, fitted = early(filmed, fit)
        pairs, true = pairs + len(fitted), true + len(happened)
        shared += sum(min(fitted.count(pair), happened.count(pair)) for pair in set(happened))
    assert shared > 0.8 * true
    assert shared > 0.75 * pairs


def test_a_break_that_no_simulation_explains_has_a_first_contact_and_no_strokes_of_its_balls() -> None:
    filmed = simulate_break(1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(explain_shot, "reconstruct_breaks", lambda solution, seen, table: (solution, seen, ()))
        shot = explain(filmed.tracks, filmed.scene)
    fit = view_shot(shot)
    assert shot.solution is not None
    (rack,) = fit.explanation.breaks
    assert {rack.ball, *rack.rack} == {*shot.tracks.ids}
    happened, fitted = early(filmed, fit)
    assert fitted == happened[:1]
    strikes = {fit.events.a[k] for k in range(len(fit.events)) if fit.events.kind[k] == "strike"}
    assert strikes <= {rack.ball}
    record = make_shot_record(
        shot.tracks, fit.events, fit.trajectory, filmed.scene.table, filmed.scene.camera, fit.explanation
    )
    assert answer_first_contact(record, rack.ball).verdict == "yes"
    neighbours = [ball for ball in rack.rack if ball not in happened[0]][:2]
    assert answer_contact(record, *neighbours).verdict == "inconclusive"
    assert {one.cue for one in measure_shots(fit, shot.solution, shot.tracks, filmed.scene.table)} <= {rack.ball}


def test_paths_lead_through_a_break() -> None:
    """No piece begins further from the end of the one before than the ball goes in a millisecond, or 2 mm."""
    path = reconstruct_break(1)[1].trajectory
    for ball in range(len(path.ids)):
        rows = np.flatnonzero(path.ball == ball)
        for one, two in pairwise(rows):
            if path.start[two] - path.end[one] > 1e-6:
                continue
            tau = path.end[one] - path.start[one]
            left = np.array([1.0, tau, tau**2, tau**3]) @ path.position[one]
            speed = np.hypot(*(np.array([0.0, 1.0, 2 * tau, 3 * tau**2]) @ path.position[one]))
            assert np.hypot(*(path.position[two, 0] - left)) < 1e-3 * max(speed, 2.0)
