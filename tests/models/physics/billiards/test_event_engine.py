"""The simulation engine: exact solutions, symmetries and conservation, over all contact models."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from support.shot_inputs import kinetic_energy

from models.core.scene import Table
from models.core.typing import FloatArray
from models.estimation.table_learning.learned_table import DEFAULT_SCATTER
from models.physics.billiards import parameter_vector
from models.physics.billiards.ball_cushion.rebound_correction import rebound_energy
from models.physics.billiards.contact_models import (
    BALL_MODELS,
    CUSHION_MODELS,
    REGISTERED_BALL_MODELS,
    REGISTERED_CUSHION_MODELS,
)
from models.physics.billiards.simulation import contact_resolution
from models.physics.billiards.simulation.event_engine import (
    EVENT_FIRST,
    EVENT_KIND,
    EVENT_SECOND,
    EVENT_SPEED,
    EVENT_TIME,
    disturb_rebound,
    to_cushion_axes,
)
from models.physics.billiards.simulation.simulate_shot import BallSet, simulate
from models.physics.billiards.simulation.table_physics import Physics, contact_parameters
from models.physics.billiards.tables import TABLE_PRESETS

CAROM = TABLE_PRESETS["carom-match"]
POOL = TABLE_PRESETS["pool-9ft"]
POOL_WITHOUT = replace(POOL, pockets=False)
G = 9.81
LAWS = [*product(CUSHION_MODELS, ["inelastic"]), *product(["mirror"], BALL_MODELS)]
every_law = pytest.mark.parametrize(("cushion", "ball"), LAWS)
STRENGTHS = {
    "sliding_friction": {"mu": 0.2}, "rolling_resistance": {"mu": 0.01}, "spin_decay": {"rate": 10.0},
    "cushion_restitution": {"e": 0.85}, "cushion_restitution_speed": {"slope": 0.02}, "cushion_friction": {"mu": 0.2},
    "ball_restitution": {"e": 0.95}, "ball_friction": {"mu": 0.06},
}  # fmt: skip


def physics(cushion: str = "mirror", ball: str = "inelastic", **more: dict[str, float]) -> Physics:
    """Build the physics of all usual effects that the models read, and `more`."""
    used = {*contact_parameters(cushion, ball), "sliding_friction.mu", "rolling_resistance.mu", "spin_decay.rate"}
    chosen = {e: v for e, v in STRENGTHS.items() if all(f"{e}.{name}" in used for name in v)}
    return Physics.from_effects({**chosen, **more}, cushion, ball)


def one(*state: float, radius: float = 0.03, mass: float = 0.2) -> BallSet:
    return BallSet(("cue",), np.array([state]), np.array([radius]), np.array([mass]))


def several(rng: np.random.Generator, count: int, table: Table = CAROM) -> BallSet:
    """Draw balls of unequal size at random places, three of them moving with heavy spins."""
    places: list[FloatArray] = []
    while len(places) < count:
        place = rng.uniform([0.05, 0.05], [table.length - 0.05, table.width - 0.05])
        if all(np.hypot(*(place - other)) > 0.07 for other in places):
            places.append(place)
    motion = np.zeros((count, 5))
    motion[:3] = rng.normal(size=(3, 5)) * [2.0, 2.0, 60.0, 60.0, 60.0]
    ids = tuple(f"ball-{k}" for k in range(count))
    radius = rng.uniform(0.028, 0.031, count)
    return BallSet(ids, np.hstack([places, motion]), radius, 0.2 * (radius / 0.03) ** 3)


def rack(gap: float, seed: int = 1) -> BallSet:
    """Build a rack of nine balls and a cue ball at 8 m/s; the gaps between balls are about `gap` (m)."""
    rng, radius = np.random.default_rng(seed), 0.028575
    rows = [(i, j - (n - 1) / 2) for i, n in enumerate([1, 2, 3, 2, 1]) for j in range(n)]
    places = np.array(
        [[1.905 + i * np.sqrt(0.75) * (2 * radius + gap), 0.635 + j * (2 * radius + gap)] for i, j in rows]
    )
    state = np.zeros((10, 7))
    state[0] = [0.6, 0.635 + rng.normal(0, 0.002), 8.0, 0.0, 0.0, 8.0 / radius, 0.0]
    state[1:, :2] = places + rng.normal(0, gap / 6, places.shape)
    return BallSet(tuple("c123456789"), state, np.full(10, radius), np.full(10, 0.17))


def test_the_code_of_a_model_selects_it_in_compiled_code() -> None:
    p, ball = physics().values, (1.0, 0.5, 3.0, 4.0, 20.0)
    for code, model in enumerate(REGISTERED_CUSHION_MODELS):
        assert contact_resolution.rebound(code, *ball, 0.03, 0.2, p) == model.resolve(*ball, 0.03, 0.2, p), model.name
    pair = (*ball, -1.0, 0.2, 1.0, -5.0, 9.0, 0.03, 0.029, 0.2, 0.19)
    for code, model in enumerate(REGISTERED_BALL_MODELS):
        assert contact_resolution.dispatch_ball_model(code, *pair, p) == model.resolve(*pair, p), model.name


def test_a_ball_struck_without_spin_rolls_at_five_sevenths_of_its_speed() -> None:
    run = simulate(
        one(0.3, 0.5, 2.0, 0.0, 0, 0, 0), CAROM, Physics.from_effects({"sliding_friction": {"mu": 0.2}}), 0.6
    )
    slid = 2 / 7 * 2.0 / (0.2 * G)
    state = run.states_at(slid)[0]
    assert state[2] == pytest.approx(5 / 7 * 2.0, rel=1e-12)
    assert state[5] == pytest.approx(5 / 7 * 2.0 / 0.03, rel=1e-12)
    assert state[0] == pytest.approx(0.3 + 12 / 49 * 4.0 / (0.2 * G), rel=1e-12)
    np.testing.assert_array_equal(run.states_at(0.6)[0, 2:], [state[2], 0, 0, state[5], 0])


def test_a_rolling_ball_stops_after_v_squared_over_two_mu_g() -> None:
    shot = simulate(one(0.3, 0.5, 0.6, 0.0, 0, 20.0, 0), CAROM, physics(), 20.0)
    assert shot.states_at(20.0)[0, 0] == pytest.approx(0.3 + 0.36 / (2 * 0.01 * G), rel=1e-12)
    assert shot.events.kind == ("strike", "rest")
    assert shot.events.t[1] == pytest.approx(0.6 / (0.01 * G), rel=1e-12)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_rolling_ball_feels_five_sevenths_of_a_slope(direction: float) -> None:
    v, mu, fall = 0.3 * direction, 0.01, 3.0
    shot = simulate(one(1.4, 0.7, v, 0.0, 0, v / 0.03, 0), CAROM, physics(slope={"slope_x": fall}), 20.0)
    slow = (mu * direction - 5 / 7 * fall * 1e-3) * G
    assert shot.states_at(20.0)[0, 0] == pytest.approx(1.4 + v**2 / (2 * slow), abs=1e-9)


def test_a_slope_that_friction_holds_leaves_a_ball_at_rest_and_a_steeper_one_moves_it() -> None:
    still = one(1.0, 0.7, 0, 0, 0, 0, 0)
    np.testing.assert_array_equal(
        simulate(still, CAROM, physics(slope={"slope_x": 13.9}), 5.0).states_at(5.0), still.state
    )
    moved = simulate(still, CAROM, physics(slope={"slope_x": 15.0, "slope_y": 20.0}), 1.0).states_at(1.0)[0]
    pull = (5 / 7 * 0.025 - 0.01) * G
    np.testing.assert_allclose(moved[:2] - [1.0, 0.7], 0.5 * pull * np.array([0.6, 0.8]), atol=1e-9)


def test_drag_slows_a_ball_as_its_exact_solution_says() -> None:
    """x = ln(1 + k v t) / k for air, v (1 - exp(-k t)) / k for a viscous medium; no friction."""
    ball = one(0.3, 0.7, 1.0, 0, 0, 0, 0)
    air = simulate(ball, CAROM, Physics.from_effects({"air_drag": {"k": 0.3}}), 2.0).states_at(1.7)[0, 0]
    assert air == pytest.approx(0.3 + np.log1p(0.3 * 1.7) / 0.3, abs=1e-9)
    viscous = simulate(ball, CAROM, Physics.from_effects({"viscous_drag": {"k": 0.4}}), 2.0).states_at(1.7)[0, 0]
    assert viscous == pytest.approx(0.3 - np.expm1(-0.4 * 1.7) / 0.4, abs=1e-9)


def test_nap_slows_a_ball_less_with_it_than_against_it() -> None:
    for direction in (1.0, -1.0):
        ball = one(1.4, 0.7, 0.4 * direction, 0, 0, 0.4 * direction / 0.03, 0)
        went = abs(simulate(ball, CAROM, physics(nap={"mu": 0.002}), 20.0).states_at(20.0)[0, 0] - 1.4)
        assert went == pytest.approx(0.16 / (2 * (0.01 - 0.002 * direction) * G), rel=1e-12)


def test_side_spin_decays_at_its_rate_and_stays_zero() -> None:
    run = simulate(one(1.0, 0.7, 0.1, 0, 0, 0.1 / 0.03, -20.0), CAROM, physics(), 5.0)
    np.testing.assert_allclose(
        run.states_at(np.array([0.0, 0.5, 1.9, 2.1, 4.0]))[:, 0, 6], [-20, -15, -1, 0, 0], atol=1e-12
    )


@every_law
def test_energy_never_grows_and_no_ball_leaves_or_overlaps(cushion: str, ball: str) -> None:
    rng, met = np.random.default_rng(11), 0
    for _ in range(15):
        balls = several(rng, 6)
        run = simulate(balls, CAROM, physics(cushion, ball), 4.0)
        t = np.linspace(0.0, 4.0, 801)
        states = run.states_at(t)
        joules = kinetic_energy(states, balls.radius, balls.mass).sum(axis=1)
        assert np.diff(joules).max() <= 1e-12 * joules[0]
        met += len(run.contacts)
        low, high = states[..., :2] - balls.radius[:, None], states[..., :2] + balls.radius[:, None]
        assert low.min() > -2e-6
        assert np.all(high.max(axis=(0, 1)) < np.array([CAROM.length, CAROM.width]) + 2e-6)
        for a, b in zip(*np.triu_indices(6, 1), strict=True):
            apart = np.hypot(*(states[:, a, :2] - states[:, b, :2]).T) - balls.radius[a] - balls.radius[b]
            assert apart.min() > -2e-6
    assert met > 60


@every_law
def test_momentum_is_kept_where_balls_touch(cushion: str, ball: str) -> None:
    rng, met = np.random.default_rng(5), 0
    for _ in range(30):
        balls = several(rng, 6)
        run = simulate(balls, CAROM, physics(cushion, ball), 2.0)
        alone = np.flatnonzero(
            (run.contacts[:, EVENT_KIND] == 0) & (np.diff(run.contacts[:, EVENT_TIME], append=9.0) > 1e-7)
        )
        for k in alone:
            pair = run.contacts[k, [EVENT_FIRST, EVENT_SECOND]].astype(int)
            t = run.contacts[k, EVENT_TIME]
            before, after = run.states_at(t - 1e-9)[pair], run.states_at(t + 1e-9)[pair]
            np.testing.assert_allclose(balls.mass[pair] @ after[:, 2:4], balls.mass[pair] @ before[:, 2:4], atol=1e-8)
            met += 1
    assert met > 20


@every_law
def test_mirrored_and_turned_shots_run_mirrored_and_turned(cushion: str, ball: str) -> None:
    rng = np.random.default_rng(3)
    size = np.array([CAROM.length, CAROM.width])
    mirror = np.array([1.0, -1.0, -1.0, 1.0, -1.0])
    turn = np.array([-1.0, -1.0, -1.0, -1.0, 1.0])
    for _ in range(5):
        balls = several(rng, 4)
        t = np.linspace(0, 1.0, 50)
        straight = simulate(balls, CAROM, physics(cushion, ball), 1.0).states_at(t)
        for signs, place in ((mirror, lambda xy: xy * [1, -1] + [0, size[1]]), (turn, lambda xy: size - xy)):
            state = np.hstack([place(balls.state[:, :2]), balls.state[:, 2:] * signs])
            transformed = simulate(replace(balls, state=state), CAROM, physics(cushion, ball), 1.0).states_at(t)
            np.testing.assert_allclose(transformed[..., :2], place(straight[..., :2]), atol=1e-6)
            np.testing.assert_allclose(transformed[..., 2:4], straight[..., 2:4] * signs[:2], atol=1e-5)


@every_law
def test_a_shot_elsewhere_on_the_cloth_runs_the_same(cushion: str, ball: str) -> None:
    balls = BallSet(
        ("a", "b"),
        np.array([[0.5, 0.5, 1.5, 0.1, 5, 20, 30], [0.8, 0.53, 0, 0, 0, 0, 0]]),
        np.full(2, 0.03),
        np.ones(2),
    )
    t, by = np.linspace(0, 0.5, 40), np.array([0.7, 0.3])
    moved = replace(balls, state=balls.state + np.array([*by, 0, 0, 0, 0, 0]))
    first, second = (simulate(b, CAROM, physics(cushion, ball), 0.5).states_at(t) for b in (balls, moved))
    np.testing.assert_allclose(second[..., :2], first[..., :2] + by, atol=1e-12)


def test_no_ball_tunnels_at_any_speed() -> None:
    for speed in (1.0, 100.0, 1e5):
        state = np.array([[0.1, 0.7, speed, 0, 0, 0, 0], [1.0, 0.7 + 0.0599, 0, 0, 0, 0, 0]])
        run = simulate(
            BallSet(("a", "b"), state, np.full(2, 0.03), np.ones(2)), CAROM, Physics.from_effects({}), 1.5 / speed
        )
        assert run.events.kind == ("strike", "ball")
        across = 0.0599 / 0.06
        assert run.events.speed[1] == pytest.approx(speed * np.sqrt(1 - across**2), rel=1e-9)


def test_a_frictionless_ball_returns_to_where_mirrors_say() -> None:
    run = simulate(one(0.5, 0.5, 1.7, 0.9, 0, 0, 0), CAROM, Physics.from_effects({}), 30.0)
    t = np.linspace(0, 30, 400)
    for axis, (v, length) in enumerate(((1.7, CAROM.length - 0.06), (0.9, CAROM.width - 0.06))):
        unfolded = (0.47 + v * t) % (2 * length)
        folded = np.where(unfolded > length, 2 * length - unfolded, unfolded) + 0.03
        np.testing.assert_allclose(run.states_at(t)[:, 0, axis], folded, atol=1e-10)


def test_a_cradle_of_touching_balls_hands_the_speed_on() -> None:
    state = np.zeros((5, 7))
    state[:, 0], state[:, 1] = [0.5, 1.0, 1.06, 1.12, 1.18], 0.7
    state[0, 2] = 1.0
    run = simulate(
        BallSet(tuple("abcde"), state, np.full(5, 0.03), np.ones(5)),
        CAROM,
        Physics.from_effects({}, ball="elastic"),
        1.0,
    )
    np.testing.assert_allclose(run.states_at(1.0)[:, 2], [0, 0, 0, 0, 1.0], atol=1e-9)


@every_law
def test_a_frozen_rack_is_broken_in_finite_steps(cushion: str, ball: str) -> None:
    balls = rack(0.0)
    run = simulate(balls, POOL_WITHOUT, physics(cushion, ball), 8.0)
    assert 20 < len(run.contacts) < 2000
    joules = kinetic_energy(run.states_at(np.linspace(0, 8, 500)), balls.radius, balls.mass).sum(axis=1)
    assert np.diff(joules).max() <= 1e-12 * joules[0]
    assert np.abs(run.states_at(8.0)[:, 2:4]).max() < 1.5


@pytest.mark.parametrize("v", [(0.8, 0.0), (0.8, 0.3), (0.0, 0.0)])
def test_a_ball_frozen_to_a_cushion_stays_out_of_it(v: tuple[float, float]) -> None:
    for spin in ([0, 0, 0], [40.0, 0, 20.0], [-40.0, 30.0, 0]):
        run = simulate(one(1.0, CAROM.width - 0.03, *v, *spin), CAROM, physics(slope={"slope_y": 3.0}), 3.0)
        assert run.states_at(np.linspace(0, 3, 300))[:, 0, 1].max() < CAROM.width - 0.03 + 2e-6
        assert len(run.contacts) < 3000


def test_balls_that_press_on_each_other_meet_a_finite_number_of_times() -> None:
    """A ball with heavy top spin pushes a frozen one ahead."""
    state = np.array([[0.5, 0.7, 0, 0, 0, 100.0, 0], [0.56, 0.7, 0, 0, 0, 0, 0]])
    balls = BallSet(("a", "b"), state, np.full(2, 0.03), np.full(2, 0.2))
    run = simulate(balls, CAROM, physics(), 4.0)
    assert 0 < len(run.contacts) < 2000
    t = np.linspace(0, 4, 400)
    assert np.diff(run.states_at(t)[:, :, 0], axis=1).min() > 0.06 - 2e-6
    assert np.diff(kinetic_energy(run.states_at(t), balls.radius, balls.mass).sum(axis=1)).max() < 1e-12


def test_a_ball_rolled_at_a_pocket_drops_and_one_beside_it_does_not() -> None:
    for table, name in ((POOL, "top"), (POOL, "bottom-right"), (TABLE_PRESETS["snooker-12ft"], "top-left")):
        target = table.pocket_centres[
            ("top-left", "top", "top-right", "bottom-left", "bottom", "bottom-right").index(name)
        ]
        begin = np.array([table.length / 2, table.width / 2])
        way = (target - begin) / np.linalg.norm(target - begin)
        ball = one(*begin, *(1.5 * way), 0, 0, 0, radius=table.ball_radius)
        events = simulate(ball, table, physics(), 6.0).events
        assert (events.kind[-1], events.b[-1]) == ("pocket", name)
        across = np.array([-way[1], way[0]])
        beside = one(*(begin + 0.11 * across), *(1.5 * way), 0, 0, 0, radius=table.ball_radius)
        assert simulate(beside, table, physics(), 3.0).events.kind[1] == "cushion"


def test_the_events_of_a_shot_are_told_in_order_with_their_places() -> None:
    run = simulate(one(0.5, 0.7, 2.0, 0.0, 0, 2.0 / 0.03, 0), CAROM, physics(), 20.0)
    events = run.events
    assert events.kind[:2] == ("strike", "cushion")
    assert events.b[1] == "right"
    np.testing.assert_allclose(events.xy[1], [CAROM.length - 0.03, 0.7], atol=1e-12)
    assert events.speed[1] == pytest.approx(run.contacts[0, EVENT_SPEED])
    assert events.kind[-1] == "rest"


@pytest.mark.parametrize("more", [{}, {"slope": {"slope_x": 2.0, "slope_y": -1.0}, "air_drag": {"k": 0.05}}])
def test_the_trajectory_says_the_same_as_the_run(more: dict[str, dict[str, float]]) -> None:
    run = simulate(several(np.random.default_rng(2), 4), CAROM, physics(**more), 4.0)
    t = np.linspace(0, 4, 1001)
    state = run.to_trajectory().at(t)
    np.testing.assert_allclose(state.xy, run.states_at(t)[..., :2], atol=1e-7)
    np.testing.assert_allclose(state.w, run.states_at(t)[..., 4:], atol=0.01)


def test_wrong_physics_is_named() -> None:
    for effects, laws, word in (
        ({"magic": {"mu": 1.0}}, ("mirror", "inelastic"), "magic"),
        ({"sliding_friction": {"nu": 1.0}}, ("mirror", "inelastic"), "nu"),
        ({"ball_friction": {"mu": 0.1}}, ("mirror", "alciatore"), "inelastic"),
        ({"ball_restitution": {"e": 0.9}}, ("mirror", "elastic"), "alciatore"),
        ({"ball_restitution": {"e": 1.2}}, ("mirror", "inelastic"), "1.2"),
        ({"sliding_friction": {"mu": -0.1}}, ("mirror", "inelastic"), "-0.1"),
        ({}, ("han", "inelastic"), "han_2005"),
        ({"nap": {"mu": 0.1}}, ("mirror", "inelastic"), "nap"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=word):
            Physics.from_effects(effects, *laws)
    assert len(parameter_vector.PARAMETER_NAMES) == len(parameter_vector.neutral_parameters())


def test_a_friction_that_is_nearly_none_is_like_none_where_drag_outweighs_it() -> None:
    """A slide that would last for weeks: steps of a tenth of it overflow, and a path of NaN never ends."""
    ball = one(0.4, 0.5, 1.7, 0.6, 3.4, -19.0, 0)
    drag = {"air_drag": {"k": 0.18}}
    none = simulate(ball, CAROM, Physics.from_effects(drag), 0.5).states_at(0.5)
    nearly = simulate(ball, CAROM, Physics.from_effects({**drag, "sliding_friction": {"mu": 4e-8}}), 0.5).states_at(0.5)
    np.testing.assert_allclose(nearly, none, atol=1e-4)


def test_a_disturbance_changes_the_rebound_by_its_share_of_the_speed() -> None:
    balls = BallSet(
        ("a",), np.array([[0.5, 0.6, -2.0, 0.0, 0.0, -2.0 / 0.028, 0.0]]), np.array([0.028]), np.array([0.17])
    )
    table = Table("t", "pool", 2.54, 1.27, 0.028, 0.17, False)
    physics = Physics.from_effects({"cushion_restitution": {"e": 0.9}}, "mirror", "elastic")
    plain, none = simulate(balls, table, physics, 1.0), simulate(balls, table, physics, 1.0, None, np.zeros((3, 5)))
    np.testing.assert_allclose(
        plain.states_at(np.array([0.9])), none.states_at(np.array([0.9])), rtol=1e-12, atol=1e-12
    )
    shares = np.array([[-0.1, 0.2, 0.0, 0.0, 0.2]])  # all together create no energy
    moved = simulate(balls, table, physics, 1.0, None, shares)
    t = np.array([plain.contacts[0, EVENT_TIME] + 1e-9])
    difference = (moved.states_at(t) - plain.states_at(t))[0, 0]
    # n points to -x at the left cushion, t = z x n to -y
    assert difference[2:4] == pytest.approx([0.2, -0.4], abs=1e-6)
    assert difference[6] == pytest.approx(0.4 / 0.028, abs=1e-4)
    into = simulate(balls, table, physics, 1.0, None, np.array([[5.0, 0.0, 0.0, 0.0, 0.0]]))
    assert into.states_at(t)[0, 0, 2] > 0  # however large, it still leaves the cushion


@pytest.mark.parametrize("degrees", [0.0, 45.0, 85.0, 89.5])
def test_a_disturbed_rebound_creates_no_energy_and_leaves_the_cushion(degrees: float) -> None:
    """Undisturbed grazing rebounds lose so little that a third of plain additions would create energy."""
    angle, radius, rng = np.radians(degrees), 0.03, np.random.default_rng(34)
    v = 2.0 * np.array([-np.cos(angle), np.sin(angle)])
    state = np.array([0.0, 0.0, *v, -v[1] / radius, v[0] / radius, 10.0])
    values, out = physics("han_2005").values, np.empty(7)
    left_behind = np.array([-1.0, 0.0])
    before = to_cushion_axes(state, *left_behind, radius)
    contact_resolution.resolve_cushion_contact(
        state, *left_behind, radius, 0.2, values, CUSHION_MODELS.index("han_2005"), False, out
    )
    moved = 0
    for shares in DEFAULT_SCATTER.draw(rng, (500,)):
        disturbed = out.copy()
        disturb_rebound(disturbed, *left_behind, radius, before, shares)
        axes = to_cushion_axes(disturbed, *left_behind, radius)
        assert rebound_energy(*axes) <= rebound_energy(*before) * (1 + 1e-9)
        assert axes[0] < 0  # n points into the cushion
        moved += not np.allclose(disturbed, out, rtol=1e-3)
    assert moved > 450  # they are reduced, not dropped
