"""Models of two balls: properties that hold for all of them, and each against its own oracle."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from models.core.typing import FloatArray
from models.physics.billiards import parameter_vector
from models.physics.billiards.ball_ball import alciatore, mass_spring

LAWS = {"alciatore": alciatore, "mass_spring": mass_spring}
RADIUS = 0.028575
MASS = 0.17
every_law = pytest.mark.parametrize("name", LAWS)


def physics(e: float = 0.95, mu: float = 0.06) -> FloatArray:
    p = np.zeros(len(parameter_vector.PARAMETER_NAMES))
    p[parameter_vector.BALL_E], p[parameter_vector.BALL_MU] = e, mu
    return p


def collide(name: str, balls: FloatArray, sizes: FloatArray, p: FloatArray) -> FloatArray:
    """Resolve a contact by a model: vn, vt, wn, wt, wz of both balls (2, 5); sizes are ra, rb, ma, mb."""
    return np.array(LAWS[name].collide(*balls.ravel().tolist(), *sizes.tolist(), p)).reshape(2, 5)


def contacts(seed: int, count: int) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Draw pairs that close at up to 10 m/s with heavy spins, a third of equal balls, a fifth with little slip."""
    rng = np.random.default_rng(seed)
    cases = []
    for i in range(count):
        balls = rng.normal(size=(2, 5)) * np.array([2.0, 2.0, 80.0, 80.0, 80.0])
        balls[:, 1:] *= 0.03 if i % 5 == 0 else 1.0
        balls[:, 0] = rng.uniform(-2, 2) + np.array([0.5, -0.5]) * rng.uniform(0.01, 10)
        ratios = np.ones(2) if i % 3 == 0 else rng.uniform(0.8, 1.25, 2)
        sizes = np.array([RADIUS, RADIUS * ratios[0], MASS, MASS * ratios[1]])
        cases.append((balls, sizes, physics(rng.uniform(0, 1), rng.uniform(0, 0.3))))
    return cases


def energy(balls: FloatArray, sizes: FloatArray) -> float:
    inertia = 0.4 * sizes[2:] * sizes[:2] ** 2
    motion = sizes[2:] @ np.sum(balls[:, :2] ** 2, axis=1) + inertia @ np.sum(balls[:, 2:] ** 2, axis=1)
    return float(0.5 * motion)


def slip(balls: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return the slip of the surface of a relative to that of b, along t and z."""
    a, b = balls
    return np.array([a[1] - b[1] + sizes[0] * a[4] + sizes[1] * b[4], -sizes[0] * a[3] - sizes[1] * b[3]])


@every_law
def test_energy_never_grows_and_momentum_is_kept(name: str) -> None:
    for balls, sizes, p in contacts(1, 10_000):
        after = collide(name, balls, sizes, p)
        assert energy(after, sizes) <= energy(balls, sizes) * (1 + 1e-12)
        assert np.abs(sizes[2:] @ (after[:, :2] - balls[:, :2])).max() <= 1e-12


@every_law
def test_the_balls_part_at_the_restitution(name: str) -> None:
    for balls, sizes, p in contacts(2, 300):
        after = collide(name, balls, sizes, p)
        closing = balls[0, 0] - balls[1, 0]
        assert after[1, 0] - after[0, 0] == pytest.approx(p[parameter_vector.BALL_E] * closing, rel=1e-9, abs=1e-12)


@every_law
def test_each_ball_keeps_its_angular_momentum_about_the_point_of_contact(name: str) -> None:
    for balls, sizes, p in contacts(3, 300):
        after = collide(name, balls, sizes, p)
        for i, side in ((0, -1.0), (1, 1.0)):
            radius = sizes[i]
            before_and_after = [0.4 * radius * b[i, 4] + side * b[i, 1] for b in (balls, after)]
            assert before_and_after[1] == pytest.approx(before_and_after[0], abs=1e-12)
            assert after[i, 2] == balls[i, 2]


@every_law
def test_mirrored_and_exchanged_balls_part_mirrored_and_exchanged(name: str) -> None:
    mirror = np.array([1.0, -1.0, -1.0, 1.0, -1.0])
    turn = np.array([-1.0, -1.0, -1.0, -1.0, 1.0])
    for balls, sizes, p in contacts(4, 300):
        after = collide(name, balls, sizes, p)
        np.testing.assert_allclose(collide(name, mirror * balls, sizes, p), mirror * after, atol=1e-12)
        exchanged = collide(name, turn * balls[::-1], sizes[[1, 0, 3, 2]], p)
        np.testing.assert_allclose(exchanged, turn * after[::-1], atol=1e-9)


@every_law
def test_a_moving_observer_sees_the_same_contact(name: str) -> None:
    drift = np.array([0.7, -1.1, 0.0, 0.0, 0.0])
    for balls, sizes, p in contacts(5, 300):
        after = collide(name, balls, sizes, p)
        np.testing.assert_allclose(collide(name, balls + drift, sizes, p), after + drift, atol=1e-9)


@every_law
def test_friction_acts_against_the_slip_and_stops_it_at_most(name: str) -> None:
    shares = []
    for balls, sizes, p in contacts(6, 500):
        before, after = slip(balls, sizes), collide(name, balls, sizes, p)
        # The vertical velocity is dropped, so the up and down slip loses only what turns the balls: 5/7 of it.
        left = slip(after, sizes) / before
        lost = 1.0 - left
        assert lost[1] == pytest.approx(5 / 7 * lost[0], abs=1e-9)
        assert -1e-12 <= left[0] <= 1.0
        shares.append(left[0])
    assert min(shares) < 1e-9, "some have to run as gears"
    assert max(shares) > 0.5, "some have to slide throughout"


@every_law
def test_derivatives_by_a_complex_step_match_differences(name: str) -> None:
    law = LAWS[name]
    scale = np.concatenate(
        [[1.0, 1.0, 30.0, 30.0, 30.0] * 2, [RADIUS] * 2, [MASS] * 2, np.ones(len(parameter_vector.PARAMETER_NAMES))]
    )
    checked = 0
    for balls, sizes, p in contacts(7, 100):
        p[parameter_vector.BALL_E] = 0.1 + 0.8 * p[parameter_vector.BALL_E]
        x = np.concatenate([balls.ravel(), sizes, p])
        used = np.array([n in law.MODEL.parameters for n in parameter_vector.PARAMETER_NAMES])
        for i in [*range(14), *(14 + np.flatnonzero(used))]:
            nudged = x.astype(np.complex128)
            nudged[i] += 1e-30j * scale[i]
            exact = np.imag(np.array(law.collide(*nudged[:14], nudged[14:]))) / 1e-30
            h = np.zeros(len(x))
            h[i] = 1e-6 * scale[i]
            up, down, at = (np.array(law.collide(*y[:14], y[14:])) for y in (x + h, x - h, x))
            if np.abs((up + down - 2 * at) / scale[:10]).max() > 1e-9:
                continue  # on the border between sticking and sliding
            checked += 1
            np.testing.assert_allclose((up - down) / 2e-6 / scale[:10], exact / scale[:10], rtol=1e-6, atol=1e-6)
    assert checked > 1000


@every_law
def test_outcomes_are_continuous_across_gearing_and_sliding(name: str) -> None:
    balls = np.array([[1.0, 0.0, 0.0, 10.0, 0.0], [0.0] * 5])
    outcomes = []
    spins = np.linspace(-60.0, 60.0, 4001)
    for spin in spins:
        balls[0, 4] = spin
        outcomes.append(collide(name, balls, np.array([RADIUS, RADIUS, MASS, MASS]), physics()))
    jumps = np.abs(np.diff(np.array(outcomes)[:, :, :2], axis=0)).max()
    assert jumps <= RADIUS * (spins[1] - spins[0])


@every_law
def test_a_law_depends_on_the_parameters_it_declares_and_on_no_other(name: str) -> None:
    balls, sizes = np.array([[2.0, 1.5, 0.0, 10.0, 60.0], [0.0] * 5]), np.array([RADIUS, RADIUS, MASS, MASS])
    before = collide(name, balls, sizes, physics())
    for i, parameter in enumerate(parameter_vector.PARAMETER_NAMES):
        p = physics()
        p[i] += 0.01
        assert bool(np.any(collide(name, balls, sizes, p) != before)) == (parameter in LAWS[name].MODEL.parameters), (
            parameter
        )


@pytest.mark.parametrize("cut", [5.0, 15.0, 30.0, 45.0, 70.0])
@pytest.mark.parametrize("roll", [0.0, 1.0])
@pytest.mark.parametrize("speed", [0.3, 1.0, 3.0])
def test_the_throw_is_that_of_alciatores_proof(speed: float, cut: float, roll: float) -> None:
    """A-14: tan(throw) = min(mu v cos(cut) / slip, 1/7) (v sin(cut) - R wz) / (v cos(cut)), for e = 1."""
    phi, wz, topspin = np.radians(cut), 12.0, roll * speed / RADIUS
    cue = np.array([speed * np.cos(phi), speed * np.sin(phi), -topspin * np.sin(phi), topspin * np.cos(phi), -wz])
    _, thrown = collide("alciatore", np.array([cue, np.zeros(5)]), np.array([RADIUS, RADIUS, MASS, MASS]), physics(1.0))
    along = speed * np.sin(phi) - RADIUS * wz
    size = np.hypot(along, RADIUS * topspin * np.cos(phi))
    mu = 0.00995 + 0.108 * np.exp(-1.088 * size)
    expected = min(mu * speed * np.cos(phi) / size, 1 / 7) * along / (speed * np.cos(phi))
    assert thrown[1] / thrown[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("e", [0.2, 0.7, 0.95, 1.0])
def test_the_spring_and_damper_integrated_part_as_the_closed_form_says(e: float) -> None:
    """Chen 2022, eqs 1 to 6, for two balls on a line, by scipy's DOP853."""
    masses, v = np.array([0.17, 0.15]), 1.3
    reduced = masses.prod() / masses.sum()
    damper = 2 * mass_spring.damping_ratio(e) * np.sqrt(mass_spring.STIFFNESS * reduced)

    def rates(_: float, x: FloatArray) -> FloatArray:
        force = mass_spring.STIFFNESS * (x[0] - x[1]) + damper * (x[2] - x[3])
        return np.array([x[2], x[3], -force / masses[0], force / masses[1]])

    def parted(t: float, x: FloatArray) -> float:
        return float(x[0] - x[1]) + (1.0 if t == 0 else 0.0)

    parted.terminal = True  # type: ignore[attr-defined]
    run = solve_ivp(rates, (0, 1), [0, 0, v, 0], "DOP853", events=parted, rtol=1e-10, atol=1e-14, max_step=1e-5)
    sizes = np.array([RADIUS, RADIUS, *masses])
    after = collide("mass_spring", np.array([[v, 0.0, 0, 0, 0], [0.0] * 5]), sizes, physics(e))
    np.testing.assert_allclose(run.y_events[0][0][2:], after[:, 0], rtol=1e-6)
    assert run.t_events[0][0] == pytest.approx(mass_spring.contact_duration(*masses, e), rel=1e-6)


def test_springs_rub_a_little_longer_than_they_push_in_sum() -> None:
    """A spring that pulls at the end causes friction only while it pushes; here from the force in small steps."""
    e = 0.6
    ratio = mass_spring.damping_ratio(e)
    tau = np.linspace(0.0, np.pi / np.sqrt(1 - ratio**2), 200_001)
    root = np.sqrt(1 - ratio**2)
    x = np.exp(-ratio * tau) * np.sin(root * tau) / root
    speed = np.exp(-ratio * tau) * (np.cos(root * tau) - ratio / root * np.sin(root * tau))
    force = x + 2 * ratio * speed
    assert mass_spring.pushing_impulse(e) == pytest.approx(np.trapezoid(np.maximum(force, 0.0), tau), rel=1e-8)
    assert np.trapezoid(force, tau) == pytest.approx(1 + e, rel=1e-8)
