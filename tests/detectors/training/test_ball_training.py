"""Training images, targets, training and export of the ball network."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from detectors.network.ball_model import CentreModel, open_ball_model, read_model_metadata
from detectors.network.peak_decoding import STREAK_UNIT_PX, decode_maps
from detectors.training.augmentation import apply_similarity, apply_square_symmetry, augment_image
from detectors.training.ball_evaluation import (
    PeakMatches,
    fit_calibration,
    fit_logistic,
    summarize_matches,
)
from detectors.training.ball_training import load_exported_weights, to_network_input, train_ball_network
from detectors.training.detector_networks import BallNetwork, build_targets, compute_ball_loss, encode_streaks
from detectors.training.onnx_export import (
    ExportedBallNetwork,
    NetworkCalibration,
    build_parity_inputs,
    export_ball_network,
    max_disagreement,
)
from detectors.training.training_loop import TrainOptions
from detectors.training.training_shards import (
    IMAGES_PER_SHARD,
    prepare_shard_file,
    read_shard,
    stack_training_images,
)
from video.rendering.random_scene import HOLD_OUT_ELEVATION, generate_scene
from video.rendering.training_images import SIZE_PX, TrainingImage, generate_training_images

FEW = 6


@pytest.fixture(scope="module")
def images() -> list[TrainingImage]:
    return list(generate_training_images(np.random.default_rng(3), FEW))


def test_the_same_number_gives_the_same_pictures(images: list[TrainingImage]) -> None:
    again = next(generate_training_images(np.random.default_rng(3), 1))
    assert again.rgb.tobytes() == images[0].rgb.tobytes()
    assert again.centre.tobytes() == images[0].centre.tobytes()


def test_truth_is_within_what_the_network_is_made_for(images: list[TrainingImage]) -> None:
    for image in images:
        is_visible = image.visible > 0.5
        assert image.rgb.shape == (SIZE_PX, SIZE_PX, 3)
        assert ((image.visible >= 0) & (image.visible <= 1)).all()
        assert (image.radius[is_visible] > 1.5).all()
        assert (image.radius[is_visible] < 30).all()
        assert ((image.centre[is_visible] > -1) & (image.centre[is_visible] < SIZE_PX)).all()


def test_a_ball_is_drawn_where_the_truth_says() -> None:
    """An image with one ball less differs from the other in a disc about that ball's centre, half lit or not."""
    from video.rendering.random_scene import arrange_balls
    from video.rendering.scene_renderer import build_view, render_exposure

    rng = np.random.default_rng(11)
    scene = generate_scene(rng, SIZE_PX)
    scene = replace(scene, appearance=replace(scene.appearance, ambient=1.0, gloss=0.0))
    view = build_view(scene.table, scene.camera, scene.appearance, scene.balls, exposure=1.0, samples=1)
    layout = arrange_balls(rng, scene)
    assert len(layout.look_index) > 0
    one = replace(
        layout,
        look_index=layout.look_index[:1],
        position=layout.position[:1],
        displacement=0 * layout.displacement[:1],
        rotation=layout.rotation[:1],
        is_rolling=layout.is_rolling[:1],
    )
    none = replace(
        one,
        look_index=one.look_index[:0],
        position=one.position[:0],
        displacement=one.displacement[:0],
        rotation=one.rotation[:0],
        is_rolling=one.is_rolling[:0],
    )
    light = render_exposure(replace(view, balls=(scene.balls[0],)), one.poses_at, 0.0)
    empty = render_exposure(replace(view, balls=()), none.poses_at, 0.0)
    centre = scene.camera.to_pixels(one.position, scene.table.ball_radius)[0]
    radius = float(scene.camera.radius_px(one.position, scene.table.ball_radius)[0])
    y, x = np.mgrid[:SIZE_PX, :SIZE_PX]
    inside = np.hypot(x - centre[0], y - centre[1]) < 0.9 * radius
    changed = np.abs(light - empty).max(axis=2) > 0.02 * empty.max()
    assert changed[inside].mean() > 0.6


def test_held_out_halls_are_of_a_kind_that_training_never_shows() -> None:
    rng = np.random.default_rng(0)

    def elevation(held_out: bool) -> float:
        scene = generate_scene(rng, SIZE_PX, hold_out=held_out)
        middle = scene.camera.to_table(np.array([SIZE_PX / 2, SIZE_PX / 2]), 0.0)
        eye = scene.camera.position
        return float(np.degrees(np.arctan2(eye[2], np.linalg.norm(eye[:2] - middle))))

    low, high = HOLD_OUT_ELEVATION
    assert all(low - 1 < elevation(True) < high + 1 for _ in range(20))
    assert not any(low + 1 < elevation(False) < high - 1 for _ in range(60))


def balls_for(rows: list[tuple[float, float, float, float, float, int]]) -> torch.Tensor:
    balls = torch.full((1, 22, 7), float("nan"))
    for k, row in enumerate(rows):
        balls[0, k] = torch.tensor([*row, 1.0])
    return balls


BALLS = [(30.3, 41.8, 7.0, 0.0, 0.0, 0), (90.0, 100.7, 5.2, 14.0, -9.0, 3), (120.6, 33.1, 11.0, -20.0, 0.0, 2)]


def perfect_maps(balls: torch.Tensor, side: int) -> torch.Tensor:
    """Maps with the exact values in every cell that is decoded."""
    targets = build_targets(balls, side)
    cells = side // 4
    maps = torch.zeros((1, 12, cells, cells))
    maps[:, 0] = torch.logit(targets.score.clamp(1e-4, 1 - 1e-4))
    for cell, ball in zip(targets.cell.tolist(), targets.ball, strict=True):
        row, column = divmod(cell, cells)
        x, y, radius = ball[:3].tolist()
        maps[0, 1, row, column] = (x - (column * 4 + 1.5)) / 4
        maps[0, 2, row, column] = (y - (row * 4 + 1.5)) / 4
        maps[0, 3, row, column] = np.log(radius / 7.0)
        maps[0, 4:6, row, column] = encode_streaks(ball[3:5])
        maps[0, 6:8, row, column] = -4.0
        maps[0, 8 + int(ball[5]), row, column] = 20.0
    return maps


def test_perfect_maps_are_decoded_to_the_truth() -> None:
    balls = balls_for(BALLS)
    maps = perfect_maps(balls, SIZE_PX)
    maps[:, 0] = torch.sigmoid(maps[:, 0])
    detections = decode_maps(maps[0].numpy(), 0.5)
    order = np.argsort(detections.centre[:, 0])
    truth = np.array(BALLS)
    assert detections.centre[order] == pytest.approx(truth[:, :2], abs=1e-4)
    assert detections.radius[order] == pytest.approx(truth[:, 2], rel=1e-5)
    assert np.argmax(detections.appearance[order], axis=1).tolist() == [0, 3, 2]
    crossed = detections.streak[order, 0] * truth[:, 4] - detections.streak[order, 1] * truth[:, 3]
    assert crossed == pytest.approx(0.0, abs=1e-2)
    assert np.linalg.norm(detections.streak[order], axis=1) == pytest.approx(
        np.hypot(truth[:, 3], truth[:, 4]), abs=1e-4
    )


def test_the_truth_costs_less_than_anything_near_it() -> None:
    balls = balls_for(BALLS)
    targets = build_targets(balls, SIZE_PX)
    best, _ = compute_ball_loss(perfect_maps(balls, SIZE_PX), targets)
    for channel in range(1, 12):  # the focal loss of the score has no such optimum
        for change in (-0.3, 0.3):
            off = perfect_maps(balls, SIZE_PX)
            off[:, channel] += change if channel < 8 else 60 * change * (channel == 8)
            if channel in (6, 7) and change < 0:
                continue  # below the least sigma nothing changes
            worse, _ = compute_ball_loss(off, targets)
            assert float(worse) >= float(best) - 1e-4, f"channel {channel} {change:+}"


def test_a_cell_between_two_balls_costs_least_with_a_sigma_as_large_as_the_distance_to_either() -> None:
    balls = balls_for([(38.0, 41.5, 7.0, 0.0, 0.0, 1), (45.0, 41.5, 7.0, 0.0, 0.0, 1)])
    targets = build_targets(balls, SIZE_PX)
    row, column = 10, 10  # its middle, (41.5, 41.5), is as far from the one as from the other

    def cost(sigma: float) -> float:
        maps = perfect_maps(balls, SIZE_PX)
        maps[0, 1:3, row, column] = 0.0
        maps[0, 6:8, row, column] = np.log(sigma)
        return compute_ball_loss(maps, targets)[1]["centre"]

    costs = {sigma: cost(sigma) for sigma in (0.3, 1.0, 2.5, 10.0)}
    assert min(costs, key=lambda sigma: costs[sigma]) == 2.5  # 3.5 px along one axis, none along the other


def test_a_streak_is_there_at_every_cell_about_its_middle_along_it() -> None:
    streak = torch.tensor([[[50.0, 49.5, 7.0, 40.0, 0.0, 2.0, 1.0]]])
    sharp = torch.tensor([[[50.0, 49.5, 7.0, 0.0, 0.0, 2.0, 1.0]]])
    rows, columns = (build_targets(streak, SIZE_PX).score[0] > 0.999).nonzero().T
    assert set(rows.tolist()) == {12}
    # 0.12 x 40 px and the reach of a cell to either side of x = 50, cells' middles at 4 i + 1.5.
    assert columns.tolist() == [11, 12, 13]
    assert int((build_targets(sharp, SIZE_PX).score > 0.999).sum()) == 1


def test_hidden_balls_neither_count_nor_cost() -> None:
    hidden = balls_for(BALLS[:1])
    hidden[0, 0, 6] = 0.2
    targets = build_targets(hidden, SIZE_PX)
    assert float(targets.weight.sum()) == 0
    cell = (int(41.8 // 4), int(30.3 // 4))
    assert float(targets.counted[0][cell]) == 0
    assert float(targets.score.max()) == 0


def test_a_rotated_image_keeps_its_balls_under_their_pixels() -> None:
    rng = np.random.default_rng(5)
    rgb = np.zeros((SIZE_PX, SIZE_PX, 3), np.uint8)
    rgb[33, 101] = 255
    balls = np.full((2, 7), np.nan, np.float32)
    balls[0] = (101, 33, 7, 5, 2, 1, 1)
    for way in range(8):
        augmented, moved = apply_square_symmetry(rgb, balls, way)
        x, y = moved[0, :2].astype(int)
        assert augmented[y, x, 0] == 255
        assert np.hypot(*moved[0, 3:5]) == pytest.approx(np.hypot(5, 2))
    rgb[30:37, 98:105] = 255
    for _ in range(20):
        angle, zoom = rng.uniform(0, 6), rng.uniform(0.8, 1.3)
        linear = zoom * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        augmented, moved = apply_similarity(rgb, balls, linear, rng.uniform(60, 100, 2), [0, 0, 0])
        if moved[0, 6] == 1 and (moved[0, :2] > 8).all() and (moved[0, :2] < SIZE_PX - 9).all():
            weight = augmented[..., 0].astype(float)
            y, x = np.mgrid[:SIZE_PX, :SIZE_PX]
            middle = np.array([(x * weight).sum(), (y * weight).sum()]) / weight.sum()
            assert middle == pytest.approx(moved[0, :2], abs=0.1)
            assert moved[0, 2] == pytest.approx(7 * zoom, rel=1e-5)


def test_a_network_that_finds_nothing_has_figures_too() -> None:
    """After a minute of training no ball is detected; undefined figures are left out of the file."""
    none, pairs = np.empty(0), np.empty((0, 2))
    nothing = PeakMatches(none, none.astype(bool), pairs, pairs, none, none, 12, 0)
    figures = summarize_matches(nothing, 3)
    assert (figures["recall"], figures["precision"], figures["look_right"]) == (0.0, 0.0, 0.0)
    assert "sharp_rms_px" not in figures


def test_augmentation_adds_no_ball(images: list[TrainingImage]) -> None:
    shard = stack_training_images(images)
    rng = np.random.default_rng(0)
    for rgb, balls in zip(shard.rgb, shard.balls, strict=True):
        augmented, moved = augment_image(rng, rgb, balls)
        assert augmented.shape == rgb.shape
        assert augmented.dtype == np.uint8
        assert np.isnan(moved[:, 0]).sum() == np.isnan(balls[:, 0]).sum()


def fill_folder(folder: Path, images: list[TrainingImage], numbers: int = 1) -> Path:
    """Create a folder with short files of images."""
    folder.mkdir()
    shard = stack_training_images(images)
    for number in range(numbers):
        np.savez(folder / f"pictures-{number:05d}.npz", rgb=shard.rgb, balls=shard.balls)
    return folder


def test_an_interrupted_training_continues_to_the_same_network(tmp_path: Path, images: list[TrainingImage]) -> None:
    options = TrainOptions(steps=3, hours=100.0, batch=2, files=1)
    whole = train_ball_network(fill_folder(tmp_path / "whole", images), options, lambda step, done, parts: None)
    folder = fill_folder(tmp_path / "parts", images)

    def stop(step: int, done: float, parts: dict[str, float]) -> None:
        if step == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_ball_network(folder, options, stop)
    steps: list[int] = []
    again = train_ball_network(folder, options, lambda step, done, parts: steps.append(step))
    assert steps == [3]
    for mine, theirs in zip(whole.state_dict().values(), again.state_dict().values(), strict=True):
        assert torch.allclose(mine.float(), theirs.float(), atol=1e-5)


def test_training_finds_the_balls_it_is_shown(tmp_path: Path, images: list[TrainingImage]) -> None:
    losses: list[float] = []

    def note(step: int, done: float, parts: dict[str, float]) -> None:
        losses.append(parts["score"] + parts["centre"])

    train_ball_network(
        fill_folder(tmp_path / "work", images), TrainOptions(steps=60, hours=100.0, batch=3, files=1), note
    )
    assert np.mean(losses[-5:]) < 0.5 * np.mean(losses[:5])


@pytest.mark.slow
def test_lengths_of_streaks_are_learnt(tmp_path: Path) -> None:
    images = list(generate_training_images(np.random.default_rng(5), 96))
    network = train_ball_network(
        fill_folder(tmp_path / "work", images), TrainOptions(steps=1100, hours=100.0, files=1), lambda *_: None
    )
    data = stack_training_images(images)
    targets = build_targets(torch.from_numpy(data.balls), SIZE_PX)
    with torch.no_grad():
        maps = network(to_network_input(data.rgb)).movedim(1, -1)  # (B, h, w, channels)
    central = targets.weight > 0.4
    predicted = maps.reshape(-1, maps.shape[-1])[targets.cell[central], 4:6]
    true = encode_streaks(targets.ball[central, 3:5])
    long = true.norm(dim=-1) * STREAK_UNIT_PX > 10
    assert long.sum() > 20
    ratio = predicted[long].norm(dim=-1) / true[long].norm(dim=-1)
    assert float(ratio.median()) == pytest.approx(1, abs=0.3)


def test_files_of_pictures_are_read_as_they_were_written(tmp_path: Path, images: list[TrainingImage]) -> None:
    folder = fill_folder(tmp_path / "work", images)
    shard = read_shard(prepare_shard_file(folder, 0))
    assert shard.rgb.tobytes() == stack_training_images(images).rgb.tobytes()
    assert len(shard) == FEW < IMAGES_PER_SHARD


CALIBRATION = NetworkCalibration(1.7, -0.4, 1.3)


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[BallNetwork, Path]:
    """Export a network with statistics other than those of a new one."""
    pytest.importorskip("onnxscript", reason="needs the extra train")
    torch.manual_seed(1)
    network, path = BallNetwork(), tmp_path_factory.mktemp("exported") / "balls.onnx"
    with torch.no_grad():
        for _ in range(3):
            network(torch.randn(4, 3, 64, 64))
    export_ball_network(network.eval(), CALIBRATION, {}, {"steps": 3}, path)
    return network, path


def test_the_exported_network_describes_itself_and_agrees_with_the_trained_one(
    exported: tuple[BallNetwork, Path],
) -> None:
    network, path = exported
    assert max_disagreement(ExportedBallNetwork(network, CALIBRATION), path, build_parity_inputs()) < 1e-3
    facts = read_model_metadata(path)
    assert facts["trueroll.schema"] == "trueroll.balls/1"
    assert facts["trueroll.stride"] == "4"
    assert json.loads(facts["trueroll.recipe"]) == {"steps": 3}
    model = open_ball_model(path)
    assert isinstance(model, CentreModel)
    rgb = np.random.default_rng(0).integers(0, 256, (61, 83, 3), dtype=np.uint8)
    maps = model.compute_maps(rgb)
    assert maps.shape == (12, 16, 22)
    with torch.no_grad():
        padded = np.pad(rgb, ((0, 3), (0, 5), (0, 0)), mode="edge")
        raw = network(to_network_input(padded[None])).numpy()[0]
    assert maps[0] == pytest.approx(1 / (1 + np.exp(-(1.7 * raw[0] - 0.4))), abs=1e-3)
    assert maps[6] == pytest.approx(raw[6] + np.log(1.3), abs=1e-3)


def test_training_continues_from_an_exported_network(
    exported: tuple[BallNetwork, Path], images: list[TrainingImage]
) -> None:
    trained, path = exported
    torch.manual_seed(2)
    again, inputs = BallNetwork(), to_network_input(stack_training_images(images).rgb)
    load_exported_weights(again, path, inputs)
    with torch.no_grad():
        assert torch.allclose(trained(inputs), again.eval()(inputs), atol=1e-3)
        assert torch.allclose(again.train()(inputs), again.eval()(inputs), atol=0.05)


def test_scores_and_errors_are_calibrated_on_detections() -> None:
    rng = np.random.default_rng(2)
    n = 20000
    logit = rng.normal(0, 2, n)
    true = rng.random(n) < 1 / (1 + np.exp(-(2.0 * logit - 1.0)))
    slope, offset = fit_logistic(logit, true)
    assert slope == pytest.approx(2.0, abs=0.1)
    assert offset == pytest.approx(-1.0, abs=0.1)
    miss, sigma = rng.normal(0, 0.3, (n, 2)), np.full((n, 2), 0.2)
    matches = PeakMatches(1 / (1 + np.exp(-logit)), true, miss, sigma, np.zeros(n), np.ones(n), n, n)
    assert fit_calibration(matches).sigma_factor == pytest.approx(1.5, rel=0.03)
