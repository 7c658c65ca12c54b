"""Training of the offset regressors: samples, loss, interrupted training, figures, export."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from detectors.network.ball_model import SHIPPED_BALL_MODEL, read_model_metadata
from detectors.network.offset_regressor import (
    DISC,
    DISC_RADIUS_PX,
    DISC_SIDE,
    STREAK,
    STREAK_COLUMNS,
    STREAK_ROWS,
    OffsetRegressorKind,
    open_offset_regressor,
)
from detectors.training.detector_networks import OffsetNetwork, offset_loss
from detectors.training.offset_samples import (
    DiscShard,
    DiscSource,
    OffsetSamples,
    StreakSource,
    find_measurable_discs,
    prepare_streak_shard,
    read_streak_shard,
    stack_samples,
)
from detectors.training.offset_training import (
    evaluate_offset_network,
    fit_sigma_factor,
    train_offset_network,
)
from detectors.training.onnx_export import ExportedOffsetNetwork, export_offset_network
from detectors.training.training_loop import TrainOptions
from detectors.training.training_shards import TrainingShard, read_shard, stack_training_images
from video.rendering.training_images import generate_training_images

MIDDLE = (DISC_SIDE - 1) / 2
SOURCES: dict[str, Callable[[Path], Any]] = {
    DISC.name: lambda folder: DiscSource(folder, 0),
    STREAK.name: lambda folder: StreakSource(folder, SHIPPED_BALL_MODEL),
}
by_kind = pytest.mark.parametrize("kind", [DISC, STREAK], ids=lambda kind: kind.name)


@cache
def render_images() -> TrainingShard:
    """Render twelve images."""
    return stack_training_images(list(generate_training_images(np.random.default_rng(3), 12)))


def fill_folder(folder: Path) -> TrainingShard:
    """Write a short file of rendered images, the same as hold-out files; read its images."""
    folder.mkdir()
    shard = render_images()
    for name in ("pictures-00000", "held-out-00000", "held-out-00001"):
        np.savez(folder / f"{name}.npz", rgb=shard.rgb, balls=shard.balls)
    return read_shard(folder / "pictures-00000.npz")


def draw_all(discs: DiscShard) -> OffsetSamples:
    """Draw a sample of every ball."""
    rng = np.random.default_rng(0)
    return stack_samples(DISC, [discs.draw_sample(rng, row) for row in range(len(discs))])


def test_disc_samples_show_the_ball_at_its_offset(tmp_path: Path) -> None:
    """In images in which a dot stands for each ball."""
    shard = fill_folder(tmp_path / "work")
    dots = np.zeros_like(shard.rgb)
    for rgb, balls in zip(dots, shard.balls, strict=True):
        for x, y, radius in balls[~np.isnan(balls[:, 0]), :3]:
            cv2.circle(rgb, (round(float(x)), round(float(y))), max(int(radius / 4), 1), (255, 255, 255), -1)
    discs = find_measurable_discs(TrainingShard(dots, shard.balls))
    assert len(discs) > 40
    samples = draw_all(discs)
    assert samples.crops.tobytes() == draw_all(discs).crops.tobytes()
    assert (samples.visible > 0.35).all()
    assert (samples.radius > 3.3).all()
    at = np.rint(MIDDLE + DISC_RADIUS_PX * samples.offsets).astype(int)
    lit = [crop[y - 2 : y + 3, x - 2 : x + 3].max() for crop, (x, y) in zip(samples.crops, at, strict=True)]
    assert np.mean(np.array(lit) > 120) > 0.97


def test_streak_samples_are_written_once_and_read_back(tmp_path: Path) -> None:
    folder = tmp_path / "work"
    fill_folder(folder)
    samples = read_streak_shard(prepare_streak_shard(folder, 0, SHIPPED_BALL_MODEL))
    assert len(samples) > 20
    assert samples.crops.shape[1:] == (STREAK_ROWS, STREAK_COLUMNS, 3)
    assert (np.abs(samples.offsets[:, :2]) < 4).all()
    assert ((samples.radius > 3) & (samples.radius < 30)).all()
    path = prepare_streak_shard(folder, 0, SHIPPED_BALL_MODEL)
    before = path.stat().st_mtime_ns
    assert prepare_streak_shard(folder, 0, SHIPPED_BALL_MODEL).stat().st_mtime_ns == before
    assert samples.crops.tobytes() == read_streak_shard(path).crops.tobytes()


def test_the_truth_costs_least() -> None:
    offsets = torch.tensor([[0.3, -0.1, 0.5, 0.2]])

    def cost(predicted: torch.Tensor, log_sigma: float) -> float:
        outputs = torch.cat([predicted, torch.full((1, 4), log_sigma)], 1)
        return float(offset_loss(outputs, offsets, STREAK.outputs)[0])

    best = cost(offsets, -2.0)
    for k in range(4):
        off = offsets.clone()
        off[0, k] += 0.1
        assert cost(off, -2.0) > best
    # Where the error is 0.1, the sigma that costs least is 0.1.
    assert np.argmin([cost(offsets + 0.1, float(log_sigma)) for log_sigma in np.log([0.03, 0.1, 0.3])]) == 1


@pytest.mark.parametrize(("kind", "stop_at", "last"), [(DISC, 30, 45), (STREAK, 24, 36)], ids=["discs", "streaks"])
def test_training_reduces_the_loss_and_continues_after_an_interruption(
    tmp_path: Path, kind: OffsetRegressorKind, stop_at: int, last: int
) -> None:
    folder = tmp_path / "work"
    fill_folder(folder)
    costs, steps = list[float](), list[int]()
    options, source = TrainOptions(steps=last, hours=100.0, batch=16, files=1), SOURCES[kind.name](folder)

    def stop(step: int, done: float, parts: dict[str, float]) -> None:
        costs.append(sum(parts.values()))
        if step == stop_at:
            raise KeyboardInterrupt

    def note(step: int, done: float, parts: dict[str, float]) -> None:
        steps.append(step)
        costs.append(sum(parts.values()))

    with pytest.raises(KeyboardInterrupt):
        train_offset_network(source, folder, options, stop)
    train_offset_network(source, folder, options, note)
    assert steps == list(range(stop_at + 1, last + 1))
    assert np.mean(costs[-10:]) < np.mean(costs[:10]) - 1


def test_disc_figures_are_about_visible_balls(tmp_path: Path) -> None:
    discs = find_measurable_discs(fill_folder(tmp_path / "work"))
    samples = draw_all(discs)
    torch.manual_seed(0)
    figures = evaluate_offset_network(OffsetNetwork(DISC), 1.0, samples)
    is_clear = samples.visible >= 0.5
    assert figures["discs"] == int(is_clear.sum())
    # The untrained network gives offsets near zero.
    assert figures["right"] == pytest.approx(float(np.sqrt((samples.offsets[is_clear, 0] ** 2).mean())), rel=0.3)


def test_sigmas_are_calibrated_on_hold_out_streaks() -> None:
    torch.manual_seed(0)
    network, rng = OffsetNetwork(STREAK), np.random.default_rng(0)
    crops = rng.integers(0, 256, (400, STREAK_ROWS, STREAK_COLUMNS, 3), dtype=np.uint8)
    with torch.no_grad():
        outputs = network.eval()(torch.from_numpy(crops).permute(0, 3, 1, 2).float() / 255).numpy()
    offsets = outputs[:, :4] + 1.5 * np.exp(outputs[:, 4:]) * rng.normal(size=(400, 4))
    ones = np.ones(400, np.float32)
    samples = OffsetSamples(crops, offsets.astype(np.float32), 8 * ones, ones)
    factor = fit_sigma_factor(network, samples)
    assert factor == pytest.approx(1.5, rel=0.1)
    assert evaluate_offset_network(network, factor, samples)["pull_std"] == pytest.approx(1, abs=0.05)


@by_kind
def test_the_exported_network_describes_itself_and_agrees_with_the_trained_one(
    tmp_path: Path, kind: OffsetRegressorKind
) -> None:
    pytest.importorskip("onnxscript", reason="needs the extra train")
    torch.manual_seed(0)
    network, path = OffsetNetwork(kind).eval(), tmp_path / f"{kind.name}.onnx"
    export_offset_network(network, 1.4, {"pull_std": 1.0}, {"steps_done": 7}, path)
    facts = read_model_metadata(path)
    assert facts["trueroll.schema"] == f"trueroll.{kind.name}/1"
    assert json.loads(facts["trueroll.recipe"]) == {"steps_done": 7}
    noise = np.random.default_rng(0).integers(0, 256, (3, kind.rows, kind.columns, 3), dtype=np.uint8)
    crops = np.stack([cv2.GaussianBlur(crop, (0, 0), 2) for crop in noise])
    offsets, sigma = open_offset_regressor(kind, path).regress_offsets(crops)
    exported, forms, n = ExportedOffsetNetwork(network, 1.4), kind.list_mirror_forms(), len(kind.outputs)
    with torch.no_grad():
        raw = np.stack([exported(torch.from_numpy(np.flip(crops, axes).copy())).numpy() for axes, _ in forms])
    signs = np.stack([signs for _, signs in forms])[:, None]
    assert offsets == pytest.approx((signs * raw[..., :n]).mean(axis=0), abs=1e-3)
    assert sigma == pytest.approx(np.exp(raw[..., n:]).mean(axis=0), rel=1e-2)
