"""The simulator of rallies: its physics, its rules, and that a seed gives the same rally."""

from __future__ import annotations

import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from worlds import rallies

SPORTS = ("badminton", "tennis", "table-tennis")
WITHOUT_NET = np.array([1e7, 6.0, 1.5, 1.5, 0.0, -1e9, 0.2, 0.0, 0.5, 1.0, 0.0])


def play(sport: str, seed: int, ending: str = "") -> dict:
    for attempt in range(20):
        rally = rallies.play_rally(sport, np.random.default_rng([seed, attempt]), (3, 8), ending)
        if rally:
            return rally
    raise AssertionError("no rally was found")


@pytest.fixture(scope="module")
def played() -> dict[str, list[dict]]:
    return {sport: [play(sport, seed) for seed in range(6)] for sport in SPORTS}


def test_a_shuttle_falls_at_its_terminal_speed() -> None:
    game = rallies.draw_game("badminton", np.random.default_rng(0))
    start = np.concatenate([[0, 3, 100.0], [0, 0, -0.1], [0, 0, -1.0], np.zeros(3)])
    path, _ = rallies.fly(start, rallies.SHUTTLE, game.air, WITHOUT_NET, 5000)
    assert 6.5 < -path[-1, 5] < 7.0


def test_a_shuttle_turns_its_nose_into_the_wind_after_a_hit() -> None:
    game = rallies.draw_game("badminton", np.random.default_rng(0))
    start = rallies.launch(game, np.array([0, 3, 50.0]), 50.0, 0.2, 0.0, np.array([0.2, 0.1]))
    path, _ = rallies.fly(start, rallies.SHUTTLE, game.air, WITHOUT_NET, 600)
    v = path[:, 3:6] / np.linalg.norm(path[:, 3:6], axis=1)[:, None]
    along = (v * path[:, 6:9]).sum(axis=1)
    # Cohen et al. 2015: turned round after about 30 ms, steady after some tenths of a second
    assert along[0] < -0.95
    assert 0.01 < np.argmax(along > 0) * rallies.STEP < 0.04
    assert along[-100:].min() > 0.99


@pytest.mark.parametrize("sport", SPORTS)
def test_energy_never_grows_in_flight(sport: str, played: dict[str, list[dict]]) -> None:
    for rally in played[sport]:
        path = rally["path"]
        energy = (path[:, 3:6] ** 2).sum(axis=1) / 2 + rallies.GRAVITY * path[:, 2]
        if sport != "badminton":
            court = rallies.COURTS[sport]
            energy += rallies.INERTIA[court.kind] * court.radius**2 * (path[:, 6:9] ** 2).sum(axis=1) / 2
        first = round(rally["strokes"][0]["t"] / rallies.STEP)
        hits = {round(stroke["t"] / rallies.STEP) + k for stroke in rally["strokes"] for k in (-1, 0)}
        growth = np.diff(energy)
        quiet = [i for i in range(first, len(growth)) if i not in hits]
        # the net gives a ball that touches its edge a little height
        nets = {round(e["t"] / rallies.STEP) + k for e in rally["events"] if e["kind"] == "net" for k in (-1, 0, 1)}
        assert max(growth[i] for i in quiet if i not in nets) < 1e-3


@pytest.mark.parametrize("sport", SPORTS)
def test_all_strokes_but_the_last_cross_the_net(sport: str, played: dict[str, list[dict]]) -> None:
    middle = rallies.COURTS[sport].length / 2
    for rally in played[sport]:
        strokes = rally["strokes"]
        for stroke, after in pairwise(strokes):
            assert stroke["player"] == 1 - after["player"]
            assert (stroke["place"][0] < middle) == (after["place"][0] > middle)
            part = rally["path"][round(stroke["t"] / rallies.STEP) : round(after["t"] / rallies.STEP)]
            over = part[np.argmin(np.abs(part[:, 0] - middle))]
            assert over[2] > rallies.COURTS[sport].net[0] - 0.01


@pytest.mark.parametrize("sport", SPORTS)
def test_players_do_not_outrun_people(sport: str, played: dict[str, list[dict]]) -> None:
    for rally in played[sport]:
        for track in rally["players"]:
            points = np.array(track)
            steps, spans = np.hypot(*np.diff(points[:, 1:], axis=0).T), np.diff(points[:, 0])
            assert np.all(steps <= 9.0 * spans + 2.2)


@pytest.mark.parametrize("sport", SPORTS)
@pytest.mark.parametrize("ending", ["in", "out", "net"])
def test_the_last_stroke_ends_as_planned(sport: str, ending: str) -> None:
    rally = play(sport, 11, ending)
    landings = [event for event in rally["events"] if event["kind"] == "landing"]
    assert len(landings) == 1
    assert rally["ending"]["is_in"] == (ending == "in")
    assert rally["ending"]["net"] == (ending == "net")
    if ending == "in":
        assert 0 <= rally["ending"]["margin"] < 0.21
    row = round(landings[0]["t"] / rallies.STEP)
    assert np.abs(rally["path"][row, :2] - landings[0]["place"][:2]).max() < 0.12


def test_a_ball_without_spin_bounces_back_with_its_restitution() -> None:
    state = np.array([0, 0, 0.05, 3.0, 0, -5.0, 0, 0, 0, 0, 0, 0])
    rallies.bounce(state, rallies.TENNIS, 0.0335, 0.8, 0.01, 0.6, 0.55)
    assert state[5] == pytest.approx((0.8 - 0.05) * 5.0)
    # grip: the contact point comes to rest
    assert state[3] - 0.0335 * state[7] == pytest.approx(0.0, abs=1e-9)


def test_a_seed_gives_the_same_rallies_in_a_process_of_its_own(tmp_path: Path) -> None:
    experiment = tmp_path / "experiment.json"
    experiment.write_text(json.dumps({"sport": "table-tennis", "seed": 3, "rallies": 1}))
    script = Path(rallies.__file__)
    subprocess.run([sys.executable, str(script), str(experiment), str(tmp_path / "out")], check=True)
    rallies.run_experiment(json.loads(experiment.read_text()), tmp_path / "again")
    for name in ("0000.npz", "0000.json"):
        if name.endswith("json"):
            assert (tmp_path / "out" / name).read_text() == (tmp_path / "again" / name).read_text()
        else:
            with np.load(tmp_path / "out" / name) as a, np.load(tmp_path / "again" / name) as b:
                assert np.allclose(a["xyz"], b["xyz"], atol=1e-9)
