"""Training of the flying-object network, its calibration and figures on rendered rallies, and its export."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

import cv2
import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor, nn

from detectors.flying.spot_network import COLUMNS, INPUT_NAME, OUTPUT_NAME, SCHEMA, streak_from_double_angle
from detectors.flying.spot_patches import FRAME_CHROMA, FRAME_LUMA, LAYERS, LUMA_LAYERS, PATCH_PX
from detectors.training.ball_evaluation import round_figures
from detectors.training.flying_samples import (
    FlyingShard,
    prepare_flying_file,
    prepare_rally_file,
    read_flying_file,
)
from detectors.training.onnx_export import PARITY_COUNTS, NetworkCalibration, write_onnx_network
from detectors.training.training_loop import StepCallback, TrainOptions, read_step_count, run_training
from detectors.training.training_shards import ShardRotation
from models.core.typing import ByteArray, Float32Array, FloatArray

CHECKPOINT = "flying.pt"
# Channels of the five convolutions, and units of the last hidden layer.
WIDTHS, HIDDEN_UNITS = (16, 24, 32, 32, 48), 48
SHARDS_IN_MEMORY = 8
# Share of the samples of a step that are the object.
OBJECT_SHARE = 0.35
# Levels that are added to the contrast of luma and of chroma in a patch, so that noise is not taken for contrast:
# chroma contains a third as much of it.
LEAST_CONTRAST, LEAST_COLOUR = 6.0, 2.0
# Least and largest logarithm of a sigma, px: coding and sharpening move real edges by a quarter of a px, whatever films
# say; and the error, in sigmas, beyond which it counts as an outlier.
LOG_SIGMA = (-1.4, 2.5)
OUTLIER_SIGMAS = 3.0
# Weight of the loss of the streak, per px.
STREAK_WEIGHT = 1.0
# Hold-out files of the calibration and of the figures.
CALIBRATION_FILE, FIGURES_FILE = 0, 1


class FlyingNetwork(nn.Module):
    """Patches (B, 16, 32, 32) of levels to (B, 7): logit, place, streak and log sigmas, see `COLUMNS`."""

    def __init__(self) -> None:
        super().__init__()
        sizes = zip((LAYERS, *WIDTHS), WIDTHS, (5, 3, 3, 3, 3), (2, 1, 2, 1, 2), strict=False)
        blocks: list[nn.Module] = []
        for inputs, outputs, side, stride in sizes:
            blocks += [
                nn.Conv2d(inputs, outputs, side, stride, side // 2, bias=False),
                nn.BatchNorm2d(outputs),
                nn.ReLU(),
            ]
        self.features = nn.Sequential(*blocks)
        cells = WIDTHS[-1] * (PATCH_PX // 8) ** 2
        self.head = nn.Sequential(
            nn.Flatten(), nn.Linear(cells, HIDDEN_UNITS), nn.ReLU(), nn.Linear(HIDDEN_UNITS, len(COLUMNS))
        )

    def forward(self, patches: Tensor) -> Tensor:
        """Judge patches."""
        outputs: Tensor = self.head(self.features(take_contrast(patches)))
        return outputs


def take_contrast(patches: Tensor) -> Tensor:
    """Take the mean levels of the frame and the spreads about them out of patches (B, 16, 32, 32)."""
    near = (LAYERS - LUMA_LAYERS) // 2
    luma = patches[:, :LUMA_LAYERS] - patches[:, FRAME_LUMA].mean(dim=(2, 3), keepdim=True)
    colour = patches[:, FRAME_CHROMA].mean(dim=(2, 3), keepdim=True)
    chroma = patches[:, LUMA_LAYERS:] - torch.cat([colour] * near, dim=1)
    scaled = [
        part / ((part**2).mean(dim=(1, 2, 3), keepdim=True).sqrt() + least)
        for part, least in ((luma, LEAST_CONTRAST), (chroma, LEAST_COLOUR))
    ]
    return torch.cat(scaled, dim=1)


class ExportedFlyingNetwork(nn.Module):
    """A network with its calibration: bytes in, probabilities and log sigmas that hold out."""

    def __init__(self, network: FlyingNetwork, calibration: NetworkCalibration) -> None:
        super().__init__()
        self.network, self.calibration = network.eval(), calibration

    def forward(self, patches: Tensor) -> Tensor:
        """Map bytes (B, 16, 32, 32) to (B, 7)."""
        outputs = self.network(patches.to(torch.float32))
        score = torch.sigmoid(self.calibration.slope * outputs[:, :1] + self.calibration.offset)
        sigma = outputs[:, 5:].clamp(*LOG_SIGMA) + float(np.log(self.calibration.sigma_factor))
        return torch.cat([score, outputs[:, 1:5], sigma], dim=1)


@dataclass(slots=True)
class FlyingTraining:
    """The training task."""

    folder: Path
    options: TrainOptions
    checkpoint: str = CHECKPOINT
    shards: ShardRotation[FlyingShard] = field(init=False)

    def __post_init__(self) -> None:
        def read(number: int, turn: int) -> FlyingShard:
            return read_flying_file(prepare_flying_file(self.folder, number))

        self.shards = ShardRotation(read, self.options.files, SHARDS_IN_MEMORY)

    def create_network(self) -> FlyingNetwork:
        """Create a network to load weights into."""
        return FlyingNetwork()

    create_initial_network = create_network

    def compute_loss(self, network: FlyingNetwork, step: int) -> tuple[Tensor, dict[str, float]]:
        """Compute the loss of the samples of a step."""
        rng = np.random.default_rng((self.options.seed, step))
        patches, truth = zip(*(self._draw_part(rng, shard) for shard in self.shards.shards_at(step)), strict=True)
        patch, true = vary_samples(rng, np.concatenate(patches), np.concatenate(truth))
        # Half precision takes two thirds of the time; places need more, and are the head's.
        with torch.autocast("cpu", torch.bfloat16):
            features = network.features(take_contrast(torch.from_numpy(patch)))
        return flying_loss(network.head(features.float()), torch.from_numpy(true))

    def _draw_part(self, rng: np.random.Generator, shard: FlyingShard) -> tuple[ByteArray, Float32Array]:
        count = max(1, self.options.batch // len(self.shards.shards))
        is_object = shard.truth[:, 0] > 0
        wanted = rng.random(count) < OBJECT_SHARE
        rows = [rng.choice(np.flatnonzero(is_object == want)) for want in wanted]
        return shard.patches[rows], shard.truth[rows]


def vary_samples(
    rng: np.random.Generator, patches: ByteArray, truth: Float32Array
) -> tuple[Float32Array, Float32Array]:
    """Mirror, transpose and reverse samples in time, and change their light and noise, at random."""
    truth = truth.copy()
    for axis, column in ((3, 1), (2, 2)):
        chosen = rng.random(len(patches)) < 0.5
        # A mirrored spot is one px before the middle.
        patches[chosen] = np.roll(np.flip(patches[chosen], axis), 1, axis)
        truth[chosen, column] *= -1
        truth[chosen, column + 2] *= -1
    chosen = rng.random(len(patches)) < 0.5
    patches[chosen] = patches[chosen].swapaxes(2, 3)
    truth[chosen] = truth[chosen][:, [0, 2, 1, 4, 3]]
    chosen = rng.random(len(patches)) < 0.5
    patches[chosen] = patches[chosen][:, [6, 5, 4, 3, 2, 1, 0, 9, 8, 7, 14, 15, 12, 13, 10, 11]]
    each = (len(patches), 1, 1, 1)
    gain = np.exp(rng.normal(0, 0.3, each)).astype(np.float32)
    # Windows of one draw of noise: a draw for every sample takes as long as the network.
    grain = np.lib.stride_tricks.sliding_window_view(rng.standard_normal(2**17, np.float32), patches[0].size)
    noise = grain[rng.integers(0, len(grain), len(patches))].reshape(patches.shape).copy()
    noise[:, LUMA_LAYERS:] *= LEAST_COLOUR / LEAST_CONTRAST
    return patches.astype(np.float32) * gain + rng.exponential(1.0, each).astype(np.float32) * noise, truth


def flying_loss(outputs: Tensor, truth: Tensor) -> tuple[Tensor, dict[str, float]]:
    """Compute the loss of outputs (B, 7) against truths (B, 5) as in `FlyingShard`."""
    is_object = truth[:, 0] > 0
    look = nn.functional.binary_cross_entropy_with_logits(outputs[:, 0], truth[:, 0])
    stated, true = outputs[is_object], truth[is_object]
    length = true[:, 3:].norm(dim=1, keepdim=True)
    along = torch.where(length > 0, true[:, 3:] / length.clamp(min=1e-6), torch.tensor([1.0, 0.0]))
    pull = off_streak(stated[:, 1:3] - true[:, 1:3], along) * torch.exp(-stated[:, 5:].clamp(*LOG_SIGMA))
    place = (huber(pull) + stated[:, 5:].clamp(*LOG_SIGMA)).sum(dim=1).mean()
    doubled = length * torch.stack([2 * along[:, 0] ** 2 - 1, 2 * along[:, 0] * along[:, 1]], dim=1)
    streak = STREAK_WEIGHT * (stated[:, 3:5] - doubled).norm(dim=1).mean()
    return 3 * look + place + streak, {"look": look.item(), "place": place.item(), "streak": streak.item()}


def off_streak(off: Tensor, along: Tensor) -> Tensor:
    """Turn displacements (B, 2) to (across, along) directions (B, 2)."""
    across = torch.stack([-along[:, 1], along[:, 0]], dim=1)
    return torch.stack([(off * across).sum(dim=1), (off * along).sum(dim=1)], dim=1)


def huber(pull: Tensor) -> Tensor:
    """Half the square of a pull, and beyond `OUTLIER_SIGMAS` a line."""
    size = pull.abs()
    return torch.where(size < OUTLIER_SIGMAS, 0.5 * size**2, OUTLIER_SIGMAS * (size - 0.5 * OUTLIER_SIGMAS))


def judge_shard(network: FlyingNetwork, shard: FlyingShard) -> FloatArray:
    """Run a network on all samples of a shard; (N, 7)."""
    network.eval()
    with torch.no_grad():
        parts = [
            network(torch.from_numpy(shard.patches[k : k + 512].astype(np.float32))) for k in range(0, len(shard), 512)
        ]
    return torch.cat(parts).numpy().astype(np.float64)


def measure_pulls(outputs: FloatArray, truth: Float32Array) -> FloatArray:
    """Errors (N, 2) across and along the streak of the network, in its sigmas."""
    off = torch.from_numpy(outputs[:, 1:3] - truth[:, 1:3])
    streak = streak_from_double_angle(outputs[:, 3:5])
    along = torch.from_numpy(streak / np.maximum(np.linalg.norm(streak, axis=1, keepdims=True), 1e-9))
    return off_streak(off, along).numpy() * np.exp(-np.clip(outputs[:, 5:], *LOG_SIGMA))


def calibrate(network: FlyingNetwork, shard: FlyingShard) -> NetworkCalibration:
    """Fit probabilities (Platt 1999) and the factor of the sigmas on hold-out spots, all of each frame."""
    outputs, is_object = judge_shard(network, shard), shard.truth[:, 0]

    def deviance(x: FloatArray) -> float:
        logit = x[0] * outputs[:, 0] + x[1]
        return float(np.mean(np.logaddexp(0, logit) - is_object * logit))

    slope, offset = minimize(deviance, [1.0, 0.0], method="Nelder-Mead").x
    # Of those that a track would use, and by the median: a few that were taken for something else do not widen all.
    used = (is_object > 0) & (outputs[:, 0] * slope + offset > 0)
    pulls = np.abs(measure_pulls(outputs[used], shard.truth[used]))
    return NetworkCalibration(float(slope), float(offset), float(np.quantile(pulls, 0.683)) if used.any() else 1.0)


def evaluate(network: FlyingNetwork, calibration: NetworkCalibration, shard: FlyingShard) -> dict[str, float]:
    """Compute figures on hold-out spots: recall and precision at 1/2, px, whitened errors and reliability."""
    outputs, is_object = judge_shard(network, shard), shard.truth[:, 0] > 0
    score = 1 / (1 + np.exp(-calibration.slope * outputs[:, 0] - calibration.offset))
    is_found = score > 0.5
    used = is_found & is_object
    error = outputs[used, 1:3] - shard.truth[used, 1:3]
    pulls = measure_pulls(outputs[used], shard.truth[used]) / calibration.sigma_factor
    bins = np.clip((score * 10).astype(int), 0, 9)
    reliability = {f"share_of_{b / 10:.1f}": float(is_object[bins == b].mean()) for b in range(10) if np.any(bins == b)}
    return round_figures(
        {
            "spots": float(len(shard)), "recall": float(used.sum() / max(is_object.sum(), 1)),
            "precision": float(used.sum() / max(is_found.sum(), 1)), "rms_px": float(np.sqrt(np.mean(error**2))),
            "median_px": float(np.median(np.linalg.norm(error, axis=1))) if len(error) else np.nan,
            "pull_rms": float(np.sqrt(np.mean(np.clip(pulls, -4, 4) ** 2))),
            "within_one": float(np.mean(np.abs(pulls) < 1)), "within_two": float(np.mean(np.abs(pulls) < 2)),
        }
        | reliability
    )  # fmt: skip


def train_flying_detector(work: Path, options: TrainOptions, out: Path, watch: StepCallback) -> dict[str, float]:
    """Train the network that judges spots of motion, and write it as an ONNX file.

    Args:
        work: Folder of samples and checkpoints; a second call continues an interrupted training.
        options: Length of the training, batch size and seed.
        out: ONNX file to write.
        watch: Called after each step.

    Returns:
        Its figures on rendered rallies by name.
    """
    torch.set_num_threads(options.threads)
    cv2.setNumThreads(1)
    work.mkdir(parents=True, exist_ok=True)
    network = run_training(FlyingTraining(work, options), work, options, watch)
    held_out = [
        read_flying_file(prepare_rally_file(work, file, is_held_out=True)) for file in (CALIBRATION_FILE, FIGURES_FILE)
    ]
    calibration = calibrate(network, held_out[0])
    figures = evaluate(network, calibration, held_out[1])
    recipe: dict[str, object] = asdict(options) | {"start": None, "steps_done": read_step_count(work / CHECKPOINT)}
    contract = {
        "schema": SCHEMA, "columns": ",".join(COLUMNS),
        "input": f"bytes (B, {LAYERS}, {PATCH_PX}, {PATCH_PX}) of luma and chroma",
        "pictures": json.dumps("drawn by flying_scenes.py and rendered by rally_clips.py; no real frame"),
    }  # fmt: skip
    facts: dict[str, object] = {"calibration": asdict(calibration), "held_out": figures, "recipe": recipe}
    rng = np.random.default_rng(0)
    parity = [rng.integers(0, 256, (n, LAYERS, PATCH_PX, PATCH_PX), dtype=np.uint8) for n in PARITY_COUNTS]
    exported = ExportedFlyingNetwork(network, calibration).eval()
    sides = {0: torch.export.Dim("spots", min=1)}
    write_onnx_network(exported, sides, (INPUT_NAME, OUTPUT_NAME), contract, facts, parity, out)
    return figures
