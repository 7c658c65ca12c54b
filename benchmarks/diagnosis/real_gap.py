"""Compare the diagnosis of real shots with rivals that look at the missing acceleration alone.

    python -m benchmarks.diagnosis.real_gap [DIR ...] [--only WORD]

DIR holds sets of real shots with sealed answers, as for `trueroll gapcheck --real` (default: the shared measurements).
All methods learn from the same shots and are judged on the hold-out shots of the diagnosis:

- trueroll: the named effects.
- sparse: sequentially thresholded least squares (Brunton, Proctor, Kutz 2016, doi:10.1073/pnas.1517384113) of the
  acceleration that the simulator lacks, on a library of terms; the largest term names the effect.
- network: a small network from position and velocity to that acceleration; it names nothing.
- correlation: the effect whose signature correlates most with the residuals of the simulator.

`explained` is the share of the squared missing acceleration beyond noise that a method explains on hold-out shots.
About ten minutes on one core, most of it for trueroll itself.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.support.run_folder import ROOT
from diagnosis.fitting.diagnosis_windows import split_into_segments
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, fit_start_states, linearize_fit
from diagnosis.fitting.noise_estimation import apply_noise_estimate
from diagnosis.fitting.shot_split import split_shots
from diagnosis.selection.hypotheses import ignore_progress
from diagnosis.selection.signatures import compute_signatures
from diagnosis.selection.study import Study, run_study
from diagnosis.unexplained.excess_acceleration import ExcessAcceleration, measure_excess_acceleration
from models.core.errors import TruerollError
from models.core.typing import FloatArray
from models.estimation.gap_scenes.gap_scene import Recording
from pipeline.experiments.gapcheck.real_sets import RealSet, list_real_sets, read_accepted_answers
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import build_gap_scene

SOURCES = (ROOT.parent / "shared/data/physics/real_gap", ROOT.parent / "shared/data/physics")
TERMS = {
    "constant along the motion": ("sliding_friction", "joint_friction"),
    "speed": ("viscous_drag", "joint_friction"),
    "speed squared": ("air_drag",),
    "sideways": ("magnus",),
    "constant": ("slope", "wind", "gravity_tilt"),
    "place": ("spring_nonlinearity",),
}
"""Terms of the sparse regression, and the effects of which each is the law."""
MIN_CONTRIBUTION = 0.1
"""rms of a term over that of the acceleration below which it is removed."""
HIDDEN, WEIGHT_DECAY, STEPS = 16, 1e-3, 200


@dataclass(frozen=True)
class Rival:
    """A method on one set."""

    method: str
    names: tuple[str, ...]
    """Named effects; of several, any may be meant."""
    explained: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path, default=[one for one in SOURCES if one.is_dir()])
    parser.add_argument("--only", default="", help="only sets whose name contains this word")
    options = parser.parse_args()
    if not options.folders:
        parser.exit(message="the shared measurements are not there; name a folder of real sets\n")
    print(f"{'set':20} {'method':12} {'first name right':17} {'explained':>9}  named")
    with tempfile.TemporaryDirectory() as scratch:
        for folder in options.folders:
            for one in list_real_sets(folder, Path(scratch)):
                if options.only in one.name:
                    _print_set(one)


def _print_set(one: RealSet) -> None:
    try:
        rivals = compare_methods(one)
    except (TruerollError, ValueError) as error:
        print(f"{one.name:20} {error}")
        return
    right = frozenset[str]().union(*read_accepted_answers(one))
    for rival in rivals:
        mark = "-" if not rival.names else "yes" if right & set(rival.names) else "no"
        names = " or ".join(rival.names)
        print(f"{one.name:20} {rival.method:12} {mark:17} {rival.explained:9.2f}  {names}", flush=True)


def compare_methods(one: RealSet) -> list[Rival]:
    """Diagnose a set, and let the rivals learn from the same shots."""
    read = read_track_folders([one.folder])
    scene = build_gap_scene(read)
    split = split_shots(read.recordings)
    study = run_study(scene, split, np.random.default_rng(0), ignore_progress)
    problem, base, full = study.problem, study.base, study.full
    training = measure_excess_acceleration(problem, base)
    reporting = apply_noise_estimate(split.holdout, study.noise)
    before, after = (_measure_on(problem, reporting, fitted) for fitted in (base, full))
    share = _explained(before.values - after.values, before) if len(before.sigma) == len(after.sigma) else float("nan")
    alone = sorted(study.best.names, key=lambda name: _cost_without(study, name), reverse=True)
    sparse, term = fit_sparse_terms(training)
    network = fit_network(training)
    return [
        Rival("trueroll", tuple(alone[:1]), share),
        Rival("sparse", TERMS[term] if term else (), _explained(sparse(before), before)),
        Rival("network", (), _explained(network(before), before)),
        Rival("correlation", (_most_correlated(problem, base),), float("nan")),
    ]


def _cost_without(study: Study, name: str) -> float:
    """Return the cost of the best hypothesis without an effect."""
    other = study.search.hypotheses.get(study.best.names - {name})
    return float("inf") if other is None else other.fitted.cost


def _measure_on(problem: DiagnosisProblem, recordings: tuple[Recording, ...], like: EffectFit) -> ExcessAcceleration:
    """Measure the acceleration that the model of a fit lacks on other shots."""
    segments = split_into_segments(problem, recordings)
    return measure_excess_acceleration(problem, fit_start_states(problem, segments, like))


def _explained(predicted: FloatArray, samples: ExcessAcceleration) -> float:
    """Return the share of the squared acceleration beyond noise that a prediction (M, D) explains."""
    weights = 1 / np.square(samples.sigma)
    before = float(weights @ np.square(samples.values).sum(axis=1))
    left = float(weights @ np.square(samples.values - predicted).sum(axis=1))
    excess = before - samples.values.size
    return (before - left) / excess if excess > 0 else float("nan")


Prediction = Callable[[ExcessAcceleration], FloatArray]


def fit_sparse_terms(training: ExcessAcceleration) -> tuple[Prediction, str]:
    """Fit the terms by sequentially thresholded least squares; return the prediction and the largest term."""
    names, columns = _build_terms(training)
    weights = np.repeat(1 / training.sigma, training.values.shape[1])
    target = training.values.ravel()
    active = np.ones(len(names), bool)
    factors = np.zeros(len(names))
    for _ in range(len(names)):
        factors = np.zeros(len(names))
        factors[active] = np.linalg.lstsq(weights[:, None] * columns[:, active], weights * target, rcond=None)[0]
        size = np.linalg.norm(weights[:, None] * columns * factors, axis=0) / np.linalg.norm(weights * target)
        small = active & (size < MIN_CONTRIBUTION)
        if not small.any():
            break
        active &= ~small
    largest = names[int(np.argmax(size))] if active.any() else ""
    return lambda samples: (_build_terms(samples)[1] @ factors).reshape(samples.values.shape), largest


def _build_terms(samples: ExcessAcceleration) -> tuple[list[str], FloatArray]:
    """Build the columns (M * D, terms): vectors with one factor, constants and places with one per coordinate."""
    speed = np.maximum(samples.speed, 1e-9)[:, None]
    vectors = [samples.velocity / speed, samples.velocity, samples.velocity * speed]
    names = list(TERMS)[:3]
    count, coordinates = samples.values.shape
    if coordinates > 1:
        turned = np.zeros_like(samples.velocity)
        turned[:, 0], turned[:, -1] = -samples.velocity[:, -1], samples.velocity[:, 0]
        vectors.append(turned)
        names.append("sideways")
    for axis in np.eye(coordinates):
        vectors += [np.tile(axis, (count, 1)), samples.position * axis]
        names += ["constant", "place"]
    return names, np.stack([one.ravel() for one in vectors], axis=1)


def fit_network(training: ExcessAcceleration) -> Prediction:
    """Fit a network with one hidden layer from position and velocity to the acceleration."""
    import torch

    torch.manual_seed(0)
    inputs = np.concatenate([training.position, training.velocity], axis=1)
    middle, spread = inputs.mean(axis=0), inputs.std(axis=0) + 1e-9
    scale = float(np.sqrt(np.square(training.values).mean()))
    x, y = torch.tensor((inputs - middle) / spread), torch.tensor(training.values / scale)
    weights = torch.tensor((np.median(training.sigma) / training.sigma)[:, None])
    layers = (torch.nn.Linear(x.shape[1], HIDDEN), torch.nn.Tanh(), torch.nn.Linear(HIDDEN, y.shape[1]))
    net = torch.nn.Sequential(*layers).double()
    optimizer = torch.optim.LBFGS(net.parameters(), max_iter=STEPS, line_search_fn="strong_wolfe")

    def evaluate() -> torch.Tensor:
        optimizer.zero_grad()
        loss = (weights * (net(x) - y)).square().mean()
        loss = loss + WEIGHT_DECAY * sum(one.square().sum() for one in net.parameters())
        loss.backward()
        return loss

    optimizer.step(evaluate)  # type: ignore[no-untyped-call]

    def predict(samples: ExcessAcceleration) -> FloatArray:
        own = (np.concatenate([samples.position, samples.velocity], axis=1) - middle) / spread
        with torch.no_grad():
            return np.asarray(net(torch.tensor(own)).numpy() * scale)

    return predict


def _most_correlated(problem: DiagnosisProblem, base: EffectFit) -> str:
    """Name the candidate whose signature explains most of the residuals of the simulator to first order."""
    signatures = compute_signatures(problem, linearize_fit(problem, base).shot_information, base.free)
    return max(problem.candidates, key=lambda name: signatures.gain(problem.mask((name,))))


if __name__ == "__main__":
    main()
