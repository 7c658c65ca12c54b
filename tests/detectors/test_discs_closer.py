"""Balls at rest that are measured closer: geometry, pictures to train on, training, export, what ships."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from support.rendered_balls import CLOTH, PX_PER_M, RADIUS, Ball, draw, drawn_scene

from detectors.measurement.circle_fit import Circles, fit_circles, softened
from detectors.network.disc_crop import RADIUS_PX, SIDE, Upright
from detectors.network.disc_regressor import MIRRORED, DiscModel, open_disc_model
from detectors.network.network_file import SHIPPED, model_facts
from detectors.network.outline_fusion import DOUBTED_PX, FILMED_FACTOR, Surroundings, measured_closer, outlined
from detectors.network.peak_decoding import Centres
from detectors.training.data.disc_samples import discs_in, shown_balls
from detectors.training.data.training_shards import Pictures, read_pictures, stacked
from detectors.training.disc_export import DiscFigures, disc_figures, export_discs
from detectors.training.disc_training import train_discs
from detectors.training.networks.disc_network import disc_network
from detectors.training.offset_export import Shipped
from detectors.training.training_loop import TrainOptions
from models.core.errors import ModelError
from video.rendering.training_images import practice_pictures

SIZE_PX = RADIUS * PX_PER_M
WHITE = (235.0, 235.0, 225.0)
MIDDLE = (SIDE - 1) / 2


def dotted(at: np.ndarray, size: float) -> np.ndarray:
    """A picture that is dark but for a soft dot at px (2,)."""
    y, x = np.mgrid[:300, :400]
    level = 250 * np.exp(-0.5 * ((x - at[0]) ** 2 + (y - at[1]) ** 2) / size**2)
    return np.repeat(level[..., None], 3, 2).astype(np.uint8)


def middle_of(shown: np.ndarray) -> np.ndarray:
    weight = shown[..., 0].astype(float)
    y, x = np.mgrid[: shown.shape[0], : shown.shape[1]]
    return np.array([(x * weight).sum(), (y * weight).sum()]) / weight.sum()


@pytest.mark.parametrize("radius", [5.0, 10.0, 31.0])
@pytest.mark.parametrize("turn", [0.0, 0.4, 3.0])
def test_a_place_beside_a_ball_is_shown_where_it_is_told(radius: float, turn: float) -> None:
    ball = Upright(np.array([203.3, 151.8]), radius, turn)
    for beside in ((0.0, 0.0), (0.7, 0.0), (-0.3, 0.5)):
        at = ball.moved(np.array(beside)).centre
        assert ball.told(at) == pytest.approx(beside)
        shown = middle_of(ball.picture(dotted(at, max(radius / 4, 1.5))))
        assert shown == pytest.approx(MIDDLE + RADIUS_PX * np.array(beside), abs=0.2)


def test_what_is_told_of_a_mirrored_picture_is_the_same_with_the_other_sign() -> None:
    told = Upright(np.array([60.0, 50.0]), 8.0).told(np.array([63.0, 48.0]))
    mirrored = Upright(np.array([-60.0, 50.0]), 8.0).told(np.array([-63.0, 48.0]))
    assert mirrored == pytest.approx(MIRRORED * told)


def test_a_drawn_ball_is_measured_from_a_rough_word() -> None:
    rng = np.random.default_rng(1)
    misses, pulls = [], []
    for _ in range(20):
        ball = Ball(*rng.uniform((150, 120), (450, 220)), rng.uniform(60, 250, 3))
        at = np.array([ball.x, ball.y]) + 0.25 * SIZE_PX * rng.normal(size=2)
        [centre], [sigma] = open_disc_model().measured(draw([ball], rng), at[None], np.array([SIZE_PX]))
        misses.append(centre - (ball.x, ball.y))
        pulls.append(misses[-1] / sigma)
    assert np.sqrt(np.mean(np.square(misses))) < 0.3
    assert np.abs(pulls).mean() < 2


def test_a_ball_that_another_covers_is_found_by_what_is_left_of_it() -> None:
    """Where its centre is, not where the middle of the rest is."""
    rng, misses, rests = np.random.default_rng(2), [], []
    for angle in np.linspace(0, 2 * np.pi, 8, endpoint=False):
        ball = Ball(300.0 + rng.random(), 180.0 + rng.random(), (220.0, 60.0, 50.0))
        over = np.array([ball.x, ball.y]) + 1.4 * SIZE_PX * np.array([np.cos(angle), np.sin(angle)])
        picture = draw([ball, Ball(*over, WHITE)], rng)
        [centre], _ = open_disc_model().measured(picture, np.array([[ball.x + 1, ball.y - 1]]), np.array([SIZE_PX]))
        misses.append(centre - (ball.x, ball.y))
        rests.append(np.linalg.norm(over - (ball.x, ball.y)) / 10)
    assert np.sqrt(np.mean(np.square(misses))) < 0.5 * np.mean(rests)


def test_none_and_one_at_the_border_are_measured_without_an_error() -> None:
    picture = draw([Ball(3.0, 2.0, WHITE)], np.random.default_rng(2))
    centre, sigma = open_disc_model().measured(picture, np.empty((0, 2)), np.empty(0))
    assert centre.shape == (0, 2)
    assert sigma.shape == (0,)
    for radius in (SIZE_PX, 6 * SIZE_PX):
        centre, sigma = open_disc_model().measured(picture, np.array([[1.0, 1.0]]), np.array([radius]))
        assert np.isfinite(centre).all()
        assert np.isfinite(sigma).all()


class Pointing(DiscModel):
    """One that says where all balls are, and keeps what it was asked."""

    asked: list[np.ndarray]

    def __init__(self, place: np.ndarray) -> None:
        object.__setattr__(self, "place", place)
        object.__setattr__(self, "asked", [])

    def measured(self, rgb: np.ndarray, centre: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where `place` is, and how far off that may be."""
        self.asked.append(centre)
        return np.tile(self.place, (len(centre), 1)), np.full(len(centre), 0.05)  # type: ignore[attr-defined]


def seen_at(places: np.ndarray, sigma: float) -> Centres:
    """What a ball network says of balls there."""
    one = np.ones(len(places))
    columns = {name: np.zeros((len(places), 4)) if name == "look" else one for name in Centres.__slots__}
    columns |= {"centre": places, "streak": np.zeros((len(places), 2)), "radius": SIZE_PX * one}
    return Centres(**{**columns, "across": sigma * one, "along": sigma * one})


def test_only_what_its_outline_leaves_in_doubt_is_looked_at_closer() -> None:
    """A ball with a clear outline stays where it is; one that the picture does not show is where the model says."""
    rng, place = np.random.default_rng(4), np.array([400.0, 201.0])
    picture = draw([Ball(200.0, 150.0, WHITE)], rng)
    seen = seen_at(np.array([[200.0, 150.0], [400.0, 200.0]]), 1.0)
    around = Surroundings(np.full(2, SIZE_PX), np.tile(CLOTH, (2, 1)), np.eye(3), drawn_scene())
    model, soft = Pointing(place), softened(picture)
    first, outlines = outlined(picture, soft, seen, around, 0)
    found = measured_closer(picture, soft, first, outlines, around, model, 0)
    assert [len(asked) for asked in model.asked] == [1]
    assert found.centre[0] == pytest.approx([200, 150], abs=0.2)
    assert found.sigma[0] < DOUBTED_PX
    assert found.centre[1] == pytest.approx(place, abs=0.01)
    assert first.centre[1] == pytest.approx([400, 200])  # nothing is there but the network's word
    assert found.sigma[1] == pytest.approx(FILMED_FACTOR * 0.05, rel=0.05)
    assert outlines.support[0] > 0.9
    assert outlines.support[1] == 0


@pytest.mark.parametrize(("off", "times"), [(0.0, 0), (0.2, 1)])
def test_an_outline_is_sought_anew_only_where_the_closer_look_moves_the_ball(
    off: float, times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = draw([Ball(200.0, 150.0, WHITE)], np.random.default_rng(4))
    seen, soft = seen_at(np.array([[201.0, 150.0]]), 1.0), softened(picture)
    around = Surroundings(np.full(1, SIZE_PX), np.array([CLOTH]), np.eye(3), drawn_scene())
    first, outlines = outlined(picture, soft, seen, around, 0)
    doubted = replace(first, sigma=np.full(1, 2 * DOUBTED_PX))
    sought = list[np.ndarray]()

    def counted(rgb: np.ndarray, soft: np.ndarray, centre: np.ndarray, *rest: Any) -> Circles:
        sought.append(centre)
        return fit_circles(rgb, soft, centre, *rest)

    monkeypatch.setattr("detectors.network.outline_fusion.fit_circles", counted)
    model = Pointing(np.array([200.0 + off * SIZE_PX, 150.0]))
    found = measured_closer(picture, soft, doubted, outlines, around, model, 0)
    assert len(sought) == times
    assert found.centre[0] == pytest.approx([200.0 + 0.5 * off * SIZE_PX, 150.0], abs=0.5 * off * SIZE_PX + 0.2)


def some(folder: Path) -> Pictures:
    """A folder with a short file of drawn pictures and one of held-out ones; what is in each of them."""
    folder.mkdir()
    held = stacked(list(practice_pictures(np.random.default_rng(3), 12)))
    for name in ("pictures-00000", "held-out-00000", "held-out-00001"):
        np.savez(folder / f"{name}.npz", rgb=held.rgb, balls=held.balls)
    return read_pictures(folder / "pictures-00000.npz")


def test_balls_to_train_on_show_what_is_told_of_them(tmp_path: Path) -> None:
    """What is told leads to where the ball is: by pictures in which a dot stands for each."""
    pictures = some(tmp_path / "work")
    dots = np.zeros_like(pictures.rgb)
    for rgb, balls in zip(dots, pictures.balls, strict=True):
        for x, y, radius in balls[~np.isnan(balls[:, 0]), :3]:
            cv2.circle(rgb, (round(float(x)), round(float(y))), max(int(radius / 4), 1), (255, 255, 255), -1)
    discs = discs_in(Pictures(dots, pictures.balls))
    assert len(discs) > 40
    given = [(discs, row) for row in range(len(discs))]
    made = shown_balls(np.random.default_rng(0), given)
    assert made.shown.tobytes() == shown_balls(np.random.default_rng(0), given).shown.tobytes()
    assert (made.visible > 0.35).all()
    assert (made.radius > 3.3).all()
    at = np.rint(MIDDLE + RADIUS_PX * made.told).astype(int)
    lit = [shown[y - 2 : y + 3, x - 2 : x + 3].max() for shown, (x, y) in zip(made.shown, at, strict=True)]
    assert np.mean(np.array(lit) > 120) > 0.97


def test_training_learns_what_it_is_shown_and_goes_on_after_an_interruption(tmp_path: Path) -> None:
    some(tmp_path / "work")
    costs, steps = list[float](), list[int]()
    options = TrainOptions(steps=90, hours=100.0, batch=16, files=1)

    def stop(step: int, done: float, parts: dict[str, float]) -> None:
        costs.append(sum(parts.values()))
        if step == 60:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_discs(tmp_path / "work", options, stop)
    train_discs(
        tmp_path / "work", options, lambda step, done, parts: (steps.append(step), costs.append(sum(parts.values())))
    )
    assert steps == list(range(61, 91))
    assert np.mean(costs[-10:]) < np.mean(costs[:10]) - 1


def test_figures_are_of_balls_that_can_be_seen(tmp_path: Path) -> None:
    pictures = some(tmp_path / "work")
    discs = discs_in(pictures)
    made = shown_balls(np.random.default_rng(0), [(discs, row) for row in range(len(discs))])
    torch.manual_seed(0)
    figures = disc_figures(disc_network(), 1.0, made)
    assert figures.discs == int((made.visible >= 0.5).sum())
    # It knows nothing yet, and says "here".
    assert figures.right == pytest.approx(float(np.sqrt((made.told[made.visible >= 0.5, 0] ** 2).mean())), rel=0.3)


def test_the_exported_network_says_what_it_is_and_agrees_with_the_trained_one(tmp_path: Path) -> None:
    pytest.importorskip("onnxscript", reason="needs the extra train")
    torch.manual_seed(0)
    network, path = disc_network().eval(), tmp_path / "discs.onnx"
    export_discs(network, 1.4, DiscFigures(3, 0.04, 0.05, 0.03, 0.04, 1.0), {"steps_done": 7}, path)
    facts = model_facts(path)
    assert facts["trueroll.schema"] == "trueroll.discs/1"
    assert json.loads(facts["trueroll.recipe"]) == {"steps_done": 7}
    shown = np.random.default_rng(0).integers(0, 256, (3, SIDE, SIDE, 3), dtype=np.uint8)
    told, sigma = open_disc_model(path).told(shown)
    with torch.no_grad():
        raw, mirrored = (
            Shipped(network, 1.4)(torch.from_numpy(form.copy())).numpy() for form in (shown, shown[:, :, ::-1])
        )
    assert told == pytest.approx((raw[:, :2] + MIRRORED * mirrored[:, :2]) / 2, abs=1e-3)
    assert sigma == pytest.approx((np.exp(raw[:, 2:]) + np.exp(mirrored[:, 2:])) / 2, rel=1e-2)


def test_another_network_is_refused_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="at rest"):
        open_disc_model(SHIPPED)
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"no network")
    with pytest.raises(ModelError, match="cannot be read"):
        open_disc_model(broken)
