"""Cushion models: properties that hold for all of them, and each against its own oracle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from models.core.typing import FloatArray
from models.physics.billiards import parameter_vector
from models.physics.billiards.ball_cushion import han_2005, mathavan_2010, stronge
from models.physics.billiards.contact_model import NOSE_HEIGHT, contact_inclination

Rebound = Callable[..., tuple[float, ...]]

LAWS = {"han_2005": han_2005, "mathavan_2010": mathavan_2010, "stronge": stronge}
RADIUS = 0.028575
MASS = 0.17
SPEEDS = np.array([1.0, 1.0, RADIUS, RADIUS, RADIUS])
"""Turns vn, vt, wn, wt, wz into speeds of the surface, m/s."""
SIN_THETA, COS_THETA = contact_inclination(parameter_vector.neutral_parameters(), NOSE_HEIGHT)
every_law = pytest.mark.parametrize("name", LAWS)


def physics(e: float = 0.85, mu: float = 0.2, cloth: float = 0.2, slope: float = 0.0) -> FloatArray:
    p = parameter_vector.neutral_parameters()
    p[parameter_vector.CUSHION_E], p[parameter_vector.CUSHION_E_SLOPE] = e, slope
    p[parameter_vector.CUSHION_MU], p[parameter_vector.SLIDING_MU] = mu, cloth
    return p


def rebound(name: str, ball: FloatArray, p: FloatArray) -> FloatArray:
    """Resolve a contact by a model: vn, vt, wn, wt, wz."""
    return np.array(LAWS[name].rebound(*ball.tolist(), RADIUS, MASS, p))


def energy(ball: FloatArray) -> float:
    """Return the energy of a solid sphere per mass, J/kg."""
    speeds = ball * SPEEDS
    return float(0.5 * (speeds[:2] @ speeds[:2] + 0.4 * speeds[2:] @ speeds[2:]))


def contacts(seed: int, count: int) -> list[tuple[FloatArray, FloatArray]]:
    """Draw balls of 0.02 to 8 m/s with spins up to several times that of rolling, a third rolling; and parameters."""
    rng = np.random.default_rng(seed)
    cases = []
    for i in range(count):
        speed = np.exp(rng.uniform(np.log(0.02), np.log(8.0)))
        ball = np.array([speed, rng.normal() * speed, *(rng.normal(size=3) * rng.choice([1.0, 4.0]) * speed / RADIUS)])
        if i % 3 == 0:
            ball[2:4] = -ball[1] / RADIUS, ball[0] / RADIUS
        cases.append((ball, physics(rng.uniform(0, 1), rng.uniform(0, 0.6), rng.uniform(0, 0.5))))
    return cases


@every_law
def test_energy_never_grows_and_no_ball_goes_through_the_cushion(name: str) -> None:
    for ball, p in contacts(1, 10_000):
        after = rebound(name, ball, p)
        assert np.all(np.isfinite(after))
        assert after[0] <= 0.0
        assert energy(after) <= energy(ball) * (1 + 1e-6), (ball, p)


@every_law
def test_a_mirrored_ball_rebounds_mirrored(name: str) -> None:
    mirror = np.array([1.0, -1.0, -1.0, 1.0, -1.0])
    for ball, p in contacts(2, 300):
        np.testing.assert_allclose(rebound(name, mirror * ball, p), mirror * rebound(name, ball, p), atol=1e-12)


@every_law
def test_twice_the_speed_and_spin_rebound_twice_as_fast(name: str) -> None:
    for ball, p in contacts(3, 300):
        np.testing.assert_allclose(rebound(name, 2 * ball, p), 2 * rebound(name, ball, p), rtol=1e-9, atol=1e-9)


@every_law
def test_without_friction_only_the_normal_speed_changes(name: str) -> None:
    """In the models of Han and Stronge the impulse towards the cloth is lost; with the cloth nothing is lost."""
    for ball, p in contacts(4, 200):
        p[[parameter_vector.CUSHION_MU, parameter_vector.SLIDING_MU]] = 0.0
        e = p[parameter_vector.CUSHION_E]
        after = rebound(name, ball, p)
        effective = e if name == "mathavan_2010" else max((1 + e) * COS_THETA**2 - 1, 0.0)
        np.testing.assert_allclose(after[1:], ball[1:], rtol=1e-12)
        assert after[0] == pytest.approx(-effective * ball[0], rel=1e-7, abs=1e-12)


def test_mathavans_elastic_frictionless_cushion_is_a_mirror() -> None:
    ball = np.array([1.3, 0.7, 10.0, -20.0, 30.0])
    after = rebound("mathavan_2010", ball, physics(e=1.0, mu=0.0, cloth=0.0))
    np.testing.assert_allclose(after, ball * [-1, 1, 1, 1, 1], rtol=1e-9)


@every_law
def test_restitution_falls_with_the_normal_speed(name: str) -> None:
    ball = np.array([2.0, 0.5, 0.0, 30.0, 10.0])
    falling = rebound(name, ball, physics(e=0.9, slope=0.05))
    np.testing.assert_allclose(falling, rebound(name, ball, physics(e=0.8)), rtol=1e-12)


@every_law
def test_restitution_falls_with_a_power_of_the_normal_speed(name: str) -> None:
    ball, falling = np.array([2.0, 0.5, 0.0, 30.0, 10.0]), physics(e=0.9)
    falling[parameter_vector.CUSHION_E_POWER] = 0.2
    same = rebound(name, ball, physics(e=0.9 * 2.0**-0.2))
    np.testing.assert_allclose(rebound(name, ball, falling), same, rtol=1e-12)


@every_law
def test_running_english_opens_the_angle_and_check_side_closes_it(name: str) -> None:
    """Side spin that moves the surface backwards along the cushion accelerates the ball, the other sense slows it."""
    plain, running, check = (
        rebound(name, np.array([1.0, 0.5, -0.5 / RADIUS, 1.0 / RADIUS, wz]), physics()) for wz in (0.0, -80.0, 80.0)
    )
    assert running[1] > plain[1] > check[1]


@every_law
def test_derivatives_by_a_complex_step_match_differences(name: str) -> None:
    for ball, p in contacts(5, 60):
        p[parameter_vector.CUSHION_E] = 0.5 + 0.49 * p[parameter_vector.CUSHION_E]
        x = np.concatenate([ball, [RADIUS], p])
        scale = np.concatenate([ball[0] / SPEEDS, [RADIUS], np.ones(len(p))])
        if not smooth_nearby(name, x, scale):
            continue
        for i in [*range(6), *(6 + np.flatnonzero(parameters_in_use(name)))]:
            nudged = x.astype(np.complex128)
            nudged[i] += 1e-30j * scale[i]
            exact = np.imag(evaluate(name, nudged)) / 1e-30
            h = np.zeros(len(x))
            h[i] = 1e-4 * scale[i]
            difference = (evaluate(name, x + h) - evaluate(name, x - h)) / 2e-4
            error = np.abs((exact - difference) * SPEEDS).max() / ball[0]
            assert error <= 2e-4 * (1 + np.abs(x[0:5] * SPEEDS).max() / ball[0]), (i, x)


def evaluate(name: str, x: NDArray) -> NDArray:
    return np.array(LAWS[name].rebound(*x[:6], np.asarray(MASS, x.dtype)[()], x[6:]))


def parameters_in_use(name: str) -> NDArray[np.bool_]:
    return np.array([n in LAWS[name].MODEL.parameters for n in parameter_vector.PARAMETER_NAMES])


def smooth_nearby(name: str, x: FloatArray, scale: FloatArray) -> bool:
    """Whether second differences are small, as they are away from the border between sticking and slipping."""
    at = evaluate(name, x)
    for i in range(6):
        h = np.zeros(len(x))
        h[i] = 1e-3 * scale[i]
        bend = evaluate(name, x + h) + evaluate(name, x - h) - 2 * at
        if np.abs(bend * SPEEDS).max() > 2e-5 * x[0]:
            return False
    return True


@every_law
def test_outcomes_are_continuous_across_sticking_and_slipping(name: str) -> None:
    spins = np.linspace(-150.0, 150.0, 3001)
    outcomes = np.array([rebound(name, np.array([1.0, 0.4, 5.0, 20.0, w]), physics()) for w in spins]) * SPEEDS
    speed_per_step = RADIUS * (spins[1] - spins[0])
    assert np.abs(np.diff(outcomes, axis=0)).max() <= 3 * speed_per_step
    slopes = np.diff(outcomes[:, 1]) / speed_per_step
    assert slopes.max() - slopes.min() > 0.1, "the range of spins has to hold both"


@every_law
def test_a_law_depends_on_the_parameters_it_declares_and_on_no_other(name: str) -> None:
    ball = np.array([2.0, 0.5, 0.0, 30.0, 240.0])
    before = rebound(name, ball, physics())
    for i, parameter in enumerate(parameter_vector.PARAMETER_NAMES):
        p = physics()
        p[i] += 0.01
        changed = bool(np.any(rebound(name, ball, p) != before))
        assert changed == (parameter in LAWS[name].MODEL.parameters), parameter
    assert set(LAWS[name].MODEL.parameters) <= set(parameter_vector.PARAMETER_NAMES)


def test_hans_friction_stops_the_slip_or_acts_at_its_bound() -> None:
    """Eqs 18 to 20: sticking where the slip is below 7/2 mu (1 + e) times the closing speed."""
    modes = set()
    for ball, p in contacts(6, 400):
        along = ball[1] + RADIUS * (COS_THETA * ball[4] - SIN_THETA * ball[2])
        slip = np.hypot(along, -SIN_THETA * ball[0] - RADIUS * ball[3])
        bound = p[parameter_vector.CUSHION_MU] * (1 + p[parameter_vector.CUSHION_E]) * COS_THETA * ball[0]
        after = rebound("han_2005", ball, p)
        left = after[1] + RADIUS * (COS_THETA * after[4] - SIN_THETA * after[2])
        sticks = bool(slip < 3.5 * bound)
        modes.add(sticks)
        expected = 0.0 if sticks else along * (1 - 3.5 * bound / slip)
        assert left == pytest.approx(expected, abs=1e-12 * (1 + slip))
    assert modes == {True, False}


def coulomb_at_both_contacts(ball: FloatArray, p: FloatArray, creep: float) -> FloatArray:
    """Mathavan's equations by scipy's Radau, in the speeds of the ball itself; friction is smooth over `creep` m/s."""
    e, nose_mu, cloth_mu = (
        p[i] for i in (parameter_vector.CUSHION_E, parameter_vector.CUSHION_MU, parameter_vector.SLIDING_MU)
    )

    sine, cosine = contact_inclination(p, NOSE_HEIGHT)

    def rates(_: float, x: FloatArray) -> list[float]:
        vn, vt, a, b, c, _work = x
        st, sk, un, ut = vt + cosine * c - sine * a, -sine * vn - b, vn - b, vt + a
        nose = nose_mu / np.sqrt(st**2 + sk**2 + creep**2)
        load = max(sine + cosine * nose * sk, 0.0)
        cloth = cloth_mu * load / np.sqrt(un**2 + ut**2 + creep**2)
        ft, fk, gn, gt = -nose * st, -nose * sk, -cloth * un, -cloth * ut
        spin = (2.5 * (gt - sine * ft), -2.5 * (fk + gn), 2.5 * cosine * ft)
        return [gn - cosine - sine * fk, ft + gt, *spin, cosine * vn]

    def stopped(_: float, x: FloatArray) -> float:
        return float(x[0])

    def returned(_: float, x: FloatArray) -> float:
        return float(x[5] - (1 - e * e) * work)

    stopped.terminal = returned.terminal = True  # type: ignore[attr-defined]
    accuracy = {"method": "Radau", "rtol": 1e-9, "atol": 1e-11}
    compressed = solve_ivp(rates, (0, 50), [*(ball * SPEEDS), 0.0], events=stopped, **accuracy).y_events[0][0]
    work = compressed[5]
    after = solve_ivp(rates, (0, 50), compressed, events=returned, **accuracy).y_events[0][-1]
    return np.asarray(after[:5] / SPEEDS)


def test_mathavans_impulses_match_an_independent_integrator() -> None:
    rng = np.random.default_rng(7)
    for height in (0.0,) * 8 + (1.1, 1.4):
        ball = np.array([rng.uniform(0.3, 3), rng.normal(), *(rng.normal(size=3) * 40)])
        p = physics(rng.uniform(0.5, 0.98), rng.uniform(0.05, 0.3), rng.uniform(0.1, 0.3))
        p[parameter_vector.CUSHION_HEIGHT] = height
        after = rebound("mathavan_2010", ball, p)
        same = coulomb_at_both_contacts(ball, p, mathavan_2010.CREEP * ball[0])
        coulomb = coulomb_at_both_contacts(ball, p, 0.01 * mathavan_2010.CREEP * ball[0])
        assert np.abs((after - same) * SPEEDS).max() <= 1e-6 * ball[0]
        assert np.abs((after - coulomb) * SPEEDS).max() <= 3e-4 * ball[0]


def test_cloth_under_a_pressed_ball_rubs_by_a_factor_of_its_own() -> None:
    ball, pressed = np.array([2.0, 0.5, 0.0, 30.0, 240.0]), physics(cloth=0.2)
    pressed[parameter_vector.CUSHION_CLOTH_FACTOR] = 1.3
    rough = rebound("mathavan_2010", ball, physics(cloth=0.26))
    assert np.allclose(rebound("mathavan_2010", ball, pressed), rough, rtol=1e-9)


def test_mathavans_straight_stun_shot_has_its_closed_form() -> None:
    """A ball without spin that slides at both contacts throughout: constant forces, so the speeds are linear in P."""
    mu, e = 0.01, 0.9
    after = rebound("mathavan_2010", np.array([1.0, 0.0, 0.0, 0.0, 0.0]), physics(e, mu, 0.0))
    # The ball slides down the nose at first; its slip turns at P = first, and friction with it.
    rise = SIN_THETA * COS_THETA + (2.5 + SIN_THETA**2) * mu
    first = SIN_THETA / rise
    assert first < 1 / COS_THETA, "the slip has to turn while the ball is still pressed in"
    fall = COS_THETA + SIN_THETA * mu
    speed, turned = 1 - fall * first, -2.5 * mu * first
    later = COS_THETA - SIN_THETA * mu
    stop = speed / later
    work = COS_THETA * (0.5 * (1 + speed) * first + 0.5 * speed * stop)
    leaving = np.sqrt(2 * e * e * work * later / COS_THETA)
    spin = turned + 2.5 * mu * (stop + leaving / later)
    np.testing.assert_allclose(after[[0, 3]] * SPEEDS[[0, 3]], [-leaving, spin], atol=mathavan_2010.CREEP)


def tip_followed_in_small_steps(q: FloatArray, e: float, steps: int = 40_000) -> FloatArray:
    """Integrate Stronge's tip by a return mapping: extend the tangential spring, then limit its force to the bound."""
    phi = np.zeros_like(q)
    length = 0.5 * np.pi * (1 + e) / steps
    for i in range(steps):
        tau = (i + 0.5) * length
        force = np.sin(tau) if tau < 0.5 * np.pi else np.cos((tau - 0.5 * np.pi) / e)
        middle = q - stronge.BETA * phi * 0.5 * length
        phi = np.clip(phi + length * middle / stronge.ETA_SQUARED, -force, force)
        q = q - stronge.BETA * phi * length
    return q


@pytest.mark.parametrize("e", [0.3, 0.7, 0.98])
def test_stronges_closed_form_matches_small_steps_of_its_springs(e: float) -> None:
    q = np.linspace(0.01, 9.0, 300)
    exact = np.array([stronge.evaluate_final_slip(x, e) if x < gross(e) else x - stronge.BETA * (1 + e) for x in q])
    np.testing.assert_allclose(exact, tip_followed_in_small_steps(q, e), atol=1e-3)
    assert exact.min() < -0.3, "the rubber turns the slip round"


def gross(e: float) -> float:
    """Return the slip above which the tip slides throughout."""
    return stronge.BETA + max(stronge.BETA * e - stronge.ETA_SQUARED / e, 0.0)


def test_stronge_and_han_agree_where_the_nose_slides_throughout() -> None:
    ball = np.array([1.0, 0.5, 0.0, 0.0, 120.0])
    p = physics(mu=0.1)
    np.testing.assert_allclose(rebound("stronge", ball, p), rebound("han_2005", ball, p), rtol=1e-12)
