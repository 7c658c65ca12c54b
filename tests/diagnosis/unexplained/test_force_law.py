"""The law of an unexplained force is recovered from accelerations, and none is reported where there is none."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest

from diagnosis.unexplained import force_law
from diagnosis.unexplained.force_law import ExcessAcceleration, find_force_law

PIECES, SHOTS = 120, 10
SIGMA = 0.05
"""m/s^2"""


def pieces(acceleration, seed: int = 0) -> ExcessAcceleration:
    """Draw pieces of motion in a plane, with an acceleration (M, 2) that depends on place and velocity."""
    rng = np.random.default_rng(seed)
    heading, speed = rng.uniform(0, 2 * np.pi, PIECES), rng.uniform(0.2, 3.0, PIECES)
    velocity = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    place = rng.uniform(0, 2, (PIECES, 2))
    values = acceleration(place, velocity) + SIGMA * rng.standard_normal((PIECES, 2))
    shot = np.arange(PIECES) % SHOTS
    return ExcessAcceleration(values, np.full(PIECES, SIGMA), shot, rng.uniform(0, 3, PIECES), place, velocity)


@pytest.mark.parametrize("power", [0.5, 1.5, 2.0])
def test_a_brake_by_a_power_of_speed_is_recovered_with_its_exponent(power: float) -> None:
    def brake(place: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        speed = np.linalg.norm(velocity, axis=1, keepdims=True)
        return -0.4 * speed ** (power - 1) * velocity

    law = find_force_law(pieces(brake), ("x", "y"))
    assert law is not None
    assert (law.direction, law.variable) == ("along", "speed")
    assert law.explained > 0.9
    assert np.abs(law.acceleration + 0.4 * law.at**power).max() < 0.1
    factor, exponent = map(float, re.fullmatch(r"a = (\S+) u\^(\S+)", law.formula).groups())  # type: ignore[union-attr]
    assert factor == pytest.approx(-0.4, rel=0.1)
    assert exponent == pytest.approx(power, abs=0.12)


def test_a_pull_that_grows_across_the_table_is_a_line_over_place() -> None:
    def pull(place: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        return np.stack([0.5 * (place[:, 0] - 1), np.zeros(PIECES)], axis=1)

    law = find_force_law(pieces(pull), ("x", "y"))
    assert law is not None
    assert (law.direction, law.variable) == ("x", "x")
    slope, offset = map(float, re.fullmatch(r"a = (\S+) u ([+-]\S+)", re.sub(r"([+-]) ", r"\1", law.formula)).groups())  # type: ignore[union-attr]
    assert slope == pytest.approx(0.5, abs=0.05)
    assert offset == pytest.approx(-0.5, abs=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_noise_has_no_law(seed: int) -> None:
    assert find_force_law(pieces(lambda place, velocity: np.zeros((PIECES, 2)), seed), ("x", "y")) is None


def test_a_few_pieces_have_no_law() -> None:
    one = pieces(lambda place, velocity: -velocity)
    few = ExcessAcceleration(
        one.values[:10], one.sigma[:10], one.shot[:10], one.t[:10], one.position[:10], one.velocity[:10]
    )
    assert find_force_law(few, ("x", "y")) is None


def test_a_wave_over_the_angle_is_drawn_right_from_pieces_that_are_half_a_wave_long() -> None:
    """Means over pieces hide a third of it: the curve has to be that of the law, not that of the means."""
    rng = np.random.default_rng(3)
    s = np.linspace(-1, 1, 401)
    shares = np.square(1 - s**2) / np.square(1 - s**2).sum()  # of each moment in the bend of a parabola
    moments = (2 * np.arange(9) + 1) / 9 - 1
    middle, half, count = rng.uniform(-1.2, 1.2, PIECES), 0.45, PIECES
    values = np.sin(4 * (middle[:, None] + half * s)) @ shares + 0.02 * rng.standard_normal(count)
    assert np.std(values) < 0.8 * np.std(np.sin(4 * middle))
    motion = np.zeros((count, 9, 3))
    motion[:, :, 1], motion[:, :, 2] = middle[:, None] + half * moments, 1.0
    column = np.ones((count, 1))
    excess = ExcessAcceleration(
        values[:, None],
        np.full(count, 0.02),
        np.arange(count) % SHOTS,
        np.zeros(count),
        middle[:, None],
        column,
        motion,
    )
    law = find_force_law(excess, ("q",))
    assert law is not None
    assert law.variable == "q"
    at, drawn = law.curve
    assert np.sqrt(np.mean(np.square(drawn - np.sin(4 * at)))) < 0.1 * np.std(np.sin(4 * at))


def test_pieces_grow_no_longer_than_the_windows_where_noise_hides_every_force(monkeypatch: pytest.MonkeyPatch) -> None:
    lengths = []

    def measure(problem: object, fitted: object, rows: int) -> ExcessAcceleration:
        lengths.append(rows)
        assert rows < 1000, "they would grow for ever"
        return pieces(lambda place, velocity: np.zeros((PIECES, 2)))

    monkeypatch.setattr(force_law, "measure_excess_acceleration", measure)
    windows = SimpleNamespace(segments=[SimpleNamespace(t=np.arange(rows)) for rows in (40, 120)])
    force_law.measure_resolved_acceleration(SimpleNamespace(scene=None), windows)  # type: ignore[arg-type]
    assert max(lengths) > 40
