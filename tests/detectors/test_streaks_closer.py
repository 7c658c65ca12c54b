"""Streaks that are straightened and measured closer: geometry, training pictures, training, export, what ships."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from support.rendered_balls import PX_PER_M, RADIUS, Ball, draw

from detectors.network.network_file import SHIPPED, model_facts
from detectors.network.streak_crop import COLUMNS, MARGIN_RADII, RADIUS_PX, ROWS, Straight
from detectors.network.streak_regressor import MIRRORED, open_streak_model
from detectors.training.data.streak_samples import StreakPictures, read_streaks, streak_file
from detectors.training.data.training_shards import stacked
from detectors.training.networks.offset_network import measuring_loss
from detectors.training.networks.streak_network import TOLD, streak_network
from detectors.training.offset_export import Shipped, sigma_factor
from detectors.training.streak_export import StreakFigures, export_streaks, streak_figures
from detectors.training.streak_training import train_streaks
from detectors.training.training_loop import TrainOptions
from models.core.errors import ModelError
from video.rendering.training_images import practice_pictures

SIZE_PX = RADIUS * PX_PER_M
WHITE = (235.0, 235.0, 225.0)


def dotted(at: np.ndarray, size: float) -> np.ndarray:
    """A picture that is dark but for a soft dot at px (2,)."""
    y, x = np.mgrid[:300, :400]
    return np.repeat((250 * np.exp(-0.5 * ((x - at[0]) ** 2 + (y - at[1]) ** 2) / size**2))[..., None], 3, 2).astype(
        np.uint8
    )


def middle_of(shown: np.ndarray) -> np.ndarray:
    weight = shown[..., 0].astype(float)
    y, x = np.mgrid[: shown.shape[0], : shown.shape[1]]
    return np.array([(x * weight).sum(), (y * weight).sum()]) / weight.sum()


@pytest.mark.parametrize("radius", [5.0, 9.0, 21.0])
@pytest.mark.parametrize("way", [(20.0, 0.0), (-13.0, 31.0), (4.0, -40.0)])
def test_the_ends_of_a_streak_come_to_the_ends_of_its_picture(radius: float, way: tuple[float, float]) -> None:
    straight = Straight(np.array([203.3, 151.8]), radius, np.array(way))
    length = float(np.hypot(*way))
    ahead = COLUMNS / (length + 2 * MARGIN_RADII * radius)
    for end in (-0.5, 0.0, 0.5):
        for beside in (0.0, 0.8):
            at = straight.centre + end * straight.way + beside * radius * straight.axes[1]
            shown = middle_of(straight.picture(dotted(at, max(radius / 4, 1.5))))
            hoped = np.array([(COLUMNS - 1) / 2 + end * length * ahead, (ROWS - 1) / 2 + beside * RADIUS_PX])
            assert shown == pytest.approx(hoped, abs=0.35)


def test_what_is_told_of_a_streak_leads_to_it() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        one, other = (Straight(rng.normal(200, 10, 2), 8.0, rng.normal(0, 20, 2)) for _ in range(2))
        moved = one.moved(one.told(other.centre, other.way))
        assert moved.centre == pytest.approx(other.centre)
        assert moved.way * np.sign(moved.way @ other.way) == pytest.approx(other.way)
        assert moved.way @ one.way > 0 or abs(moved.way @ one.way) < 1e-9


def test_what_is_told_of_a_mirrored_picture_is_the_same_with_other_signs() -> None:
    """By a picture that is mirrored along with the streak, and with the truth."""
    centre, truth, way, true_way = (
        np.array([60.0, 50.0]),
        np.array([63.0, 48.0]),
        np.array([20.0, 0]),
        np.array([24, 3.0]),
    )
    told = Straight(centre, 8.0, way).told(truth, true_way)
    for signs, flip in zip(MIRRORED, ((1, 1), (-1, 1), (1, -1), (-1, -1)), strict=True):
        mirrored = Straight(centre * flip, 8.0, way).told(truth * flip, true_way * flip)
        assert mirrored == pytest.approx(signs * told)


def test_the_truth_costs_least() -> None:
    told = torch.tensor([[0.3, -0.1, 0.5, 0.2]])
    best = float(measuring_loss(torch.cat([told, torch.full((1, 4), -2.0)], 1), told, TOLD)[0])
    for k in range(4):
        off = told.clone()
        off[0, k] += 0.1
        assert float(measuring_loss(torch.cat([off, torch.full((1, 4), -2.0)], 1), told, TOLD)[0]) > best
    # Where the miss is 0.1, the width that costs least is 0.1.
    widths = np.log([0.03, 0.1, 0.3])
    costs = [
        float(measuring_loss(torch.cat([told + 0.1, torch.full((1, 4), float(w))], 1), told, TOLD)[0]) for w in widths
    ]
    assert np.argmin(costs) == 1


@pytest.mark.parametrize("streak", [(14.0, 5.0), (-9.0, 22.0), (38.0, -17.0)])
def test_a_drawn_streak_is_measured_from_a_rough_word(streak: tuple[float, float]) -> None:
    rng = np.random.default_rng(1)
    misses, pulls = [], []
    for _ in range(8):
        ball = Ball(*rng.uniform((150, 120), (450, 220)), WHITE, streak)
        picture = draw([ball], rng)
        way = np.array(streak) * rng.uniform(0.85, 1.15) * rng.choice([-1, 1])
        at = np.array([ball.x, ball.y]) + rng.normal(0, 2.0, 2)
        found = open_streak_model().measured(picture, at, SIZE_PX, way)
        along = np.array(streak) / np.hypot(*streak)
        miss = found.centre - (ball.x, ball.y)
        misses.append(miss)
        pulls.append([miss @ along / found.along, (miss @ [-along[1], along[0]]) / found.across])
        assert np.linalg.norm(found.way * np.sign(found.way @ way) - np.array(streak) * np.sign(way @ streak)) < 4
    assert np.sqrt(np.mean(np.square(misses))) < 0.7
    assert np.abs(pulls).mean() < 2


def test_a_streak_at_the_border_is_measured_without_an_error() -> None:
    picture = draw([Ball(4.0, 3.0, WHITE, (20.0, 0.0))], np.random.default_rng(2))
    for radius in (SIZE_PX, 6 * SIZE_PX):
        found = open_streak_model().measured(picture, np.array([1.0, 1.0]), radius, np.array([20.0, 3.0]))
        assert np.isfinite([*found.centre, *found.way, found.across, found.along]).all()


def filled(folder: Path) -> Path:
    """A folder with a short file of drawn pictures and one of held-out ones."""
    folder.mkdir()
    held = stacked(list(practice_pictures(np.random.default_rng(3), 12)))
    for name in ("pictures-00000", "held-out-00000", "held-out-00001"):
        np.savez(folder / f"{name}.npz", rgb=held.rgb, balls=held.balls)
    return folder


def test_streaks_to_train_on_show_what_is_told_of_them(tmp_path: Path) -> None:
    folder = filled(tmp_path / "work")
    held = read_streaks(streak_file(folder, 0, SHIPPED))
    assert len(held) > 20
    assert held.shown.shape[1:] == (ROWS, COLUMNS, 3)
    assert (np.abs(held.told[:, :2]) < 4).all()
    assert ((held.radius > 3) & (held.radius < 30)).all()
    path = streak_file(folder, 0, SHIPPED)
    before = path.stat().st_mtime_ns
    assert streak_file(folder, 0, SHIPPED).stat().st_mtime_ns == before
    assert held.shown.tobytes() == read_streaks(path).shown.tobytes()


def test_training_learns_what_it_is_shown_and_goes_on_after_an_interruption(tmp_path: Path) -> None:
    folder, costs, steps = filled(tmp_path / "work"), list[float](), list[int]()
    options = TrainOptions(steps=60, hours=100.0, batch=16, files=1)

    def stop(step: int, done: float, parts: dict[str, float]) -> None:
        costs.append(sum(parts.values()))
        if step == 40:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_streaks(folder, SHIPPED, options, stop)
    train_streaks(
        folder, SHIPPED, options, lambda step, done, parts: (steps.append(step), costs.append(sum(parts.values())))
    )
    assert steps == list(range(41, 61))
    assert np.mean(costs[-10:]) < np.mean(costs[:10]) - 1


def test_errors_are_made_honest_on_held_out_streaks() -> None:
    torch.manual_seed(0)
    network, rng = streak_network(), np.random.default_rng(0)
    shown = rng.integers(0, 256, (400, ROWS, COLUMNS, 3), dtype=np.uint8)
    with torch.no_grad():
        said = network.eval()(torch.from_numpy(shown).permute(0, 3, 1, 2).float() / 255).numpy()
    told = said[:, :4] + 1.5 * np.exp(said[:, 4:]) * rng.normal(size=(400, 4))
    ones = np.ones(400, np.float32)
    pictures = StreakPictures(shown, told.astype(np.float32), 8 * ones, ones)
    factor = sigma_factor(network, pictures.shown, pictures.told)
    assert factor == pytest.approx(1.5, rel=0.1)
    assert streak_figures(network, factor, pictures).pull_std == pytest.approx(1, abs=0.05)


def test_the_exported_network_says_what_it_is_and_agrees_with_the_trained_one(tmp_path: Path) -> None:
    pytest.importorskip("onnxscript", reason="needs the extra train")
    torch.manual_seed(0)
    network, path = streak_network().eval(), tmp_path / "streaks.onnx"
    export_streaks(network, 1.4, StreakFigures(3, 0.4, 0.2, 0.1, 0.05, 0.08, 1.0), {"steps_done": 7}, path)
    facts = model_facts(path)
    assert facts["trueroll.schema"] == "trueroll.streaks/1"
    assert json.loads(facts["trueroll.recipe"]) == {"steps_done": 7}
    shown = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 256, (ROWS, COLUMNS, 3), dtype=np.uint8), (0, 0), 2)
    told, sigma = open_streak_model(path).told(shown)
    with torch.no_grad():
        forms = np.stack([shown, shown[:, ::-1], shown[::-1], shown[::-1, ::-1]])
        raw = Shipped(network, 1.4)(torch.from_numpy(forms)).numpy()
    assert told == pytest.approx((MIRRORED * raw[:, :4]).mean(axis=0), abs=1e-3)
    assert sigma == pytest.approx(np.exp(raw[:, 4:]).mean(axis=0), rel=1e-2)


def test_another_network_is_refused_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="streaks"):
        open_streak_model(SHIPPED)
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"no network")
    with pytest.raises(ModelError, match="cannot be read"):
        open_streak_model(broken)
