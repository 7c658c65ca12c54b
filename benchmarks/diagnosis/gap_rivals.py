"""Three rivals of the diagnosis on the same shots: pysindy, a small network, and a certified sparse regression.

    python -m benchmarks.diagnosis.gap_rivals [--only flight] [--seeds 1] [--seed 0] [--shots 12] [--real DIR]

The shots are those of the kinds of case of `trueroll gapcheck`, or of the sets of real shots in DIR. Prints a row per
case and method: what is named, whether that is right, the closed share and the time, and how often each is right.

All of them explain the acceleration that the fitted simulator lacks (`rival_terms`). Two thirds of the shots that the
diagnosis does not hold out fit them, the others choose between fits, and the hold-out shots measure what is closed.
Terms of effects that the simulator has adjust its parameters, and are not named.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from scipy.stats import chi2, f

from benchmarks.diagnosis.rival_terms import ResidualSamples, sample_residuals
from diagnosis.fitting.shot_preparation import apply_noise_estimate
from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray
from models.estimation.gap_scenes.gap_scene import GapScene
from pipeline.experiments.gapcheck.billiards_cases import DEFAULT_KINDS, KINDS, CaseKind
from pipeline.experiments.gapcheck.blind_case import OpenedCase, build_oracle, diagnose_case, simulate_case
from pipeline.experiments.gapcheck.real_sets import (
    OpenedSet,
    RealSet,
    diagnose_real_set,
    list_real_sets,
    read_accepted_answers,
)
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import build_gap_scene

OURS, SINDY, NETWORK, SPARSE = "trueroll", "pysindy", "network", "sparse regression"
# Every so many shots of the fit choose, and fit nothing.
_CHOICE_EVERY = 3
# Thresholds of pysindy, relative to the rms of the accelerations; its default is the lowest.
_THRESHOLDS = (0.1, 0.2, 0.4, 0.8)
# False-discovery rate of the sparse regression (Benjamini and Hochberg 1995), and the level of all other tests.
_LEVEL = 0.01
# Hidden units, steps, learning rate and weight decay of the network.
_HIDDEN, _STEPS, _RATE, _DECAY = 8, 1000, 0.01, 1e-3


@dataclass(frozen=True, slots=True)
class MethodAnswer:
    """What one method says of a case or set."""

    method: str
    named: tuple[str, ...] = ()
    """Effects, terms that are no effect of the scene, or a verdict; empty where nothing is named."""
    right: bool | None = None
    """None where the method names nothing by its nature, or did not run."""
    closed: float = np.nan
    """Closed share of the acceleration that the simulator lacks on hold-out shots; NaN where noise explains it."""
    seconds: float = np.nan
    """s; those of rivals include the fit of the simulator."""
    note: str = ""
    """Why the method did not run."""


@dataclass(frozen=True, slots=True)
class RivalData:
    """Samples of the shots that rivals may use."""

    fitting: ResidualSamples
    choice: ResidualSamples
    """Samples of other shots, by which a method chooses."""
    simulator_effects: frozenset[str]
    seed: int

    @property
    def candidates(self) -> tuple[str, ...]:
        """Groups of terms that may be named."""
        return tuple(name for name in dict.fromkeys(self.fitting.groups) if name not in self.simulator_effects)


@dataclass(frozen=True, slots=True)
class RivalFit:
    """A fitted rival."""

    named: tuple[str, ...]
    predict: Callable[[ResidualSamples], FloatArray]
    """Predicts the accelerations (M, D) of samples."""


def fit_sindy(data: RivalData) -> RivalFit:
    """Fit pysindy (de Silva et al. 2020, doi:10.21105/joss.02104) with the threshold that predicts other shots best.

    Coordinates are samples of one equation, as every term has one coefficient for all of them.
    """
    from pysindy import STLSQ, SINDy
    from pysindy.feature_library import IdentityLibrary

    design, target = data.fitting.design, data.fitting.target
    scale, size = np.sqrt(np.square(design).mean(axis=0)) + 1e-300, float(np.sqrt(np.square(target).mean()))
    terms, models = design / scale, [np.zeros(design.shape[1])]
    for threshold in _THRESHOLDS:
        model = SINDy(optimizer=STLSQ(threshold=threshold), feature_library=IdentityLibrary())
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a threshold may remove every term
            # a derivative needs a state of its own: the first term; the others are control inputs
            model.fit(terms[:, :1], t=1.0, x_dot=(target / size)[:, None], u=terms[:, 1:])
        models.append(np.asarray(model.coefficients(), np.float64)[0] * size / scale)
    best = min(models, key=lambda one: float(np.square(data.choice.target - data.choice.design @ one).sum()))
    named = {name for name, value in zip(data.fitting.groups, best.tolist(), strict=True) if value}
    return RivalFit(tuple(name for name in data.candidates if name in named), lambda samples: samples.columns @ best)


def fit_network(data: RivalData) -> RivalFit:
    """Fit a network of one hidden layer to position and velocity, until other shots are predicted worse."""
    import torch

    centre, size = data.fitting.motion.mean(axis=0), data.fitting.motion.std(axis=0) + 1e-9
    unit = float(np.sqrt(np.square(data.fitting.values).mean()))
    inputs, coordinates = data.fitting.motion.shape[1], data.fitting.values.shape[1]
    generator = torch.Generator().manual_seed(data.seed)
    shapes = ((inputs, _HIDDEN), (_HIDDEN,), (_HIDDEN, coordinates), (coordinates,))
    weights = [torch.randn(shape, generator=generator, dtype=torch.float64) / inputs**0.5 for shape in shapes]
    for weight in weights:
        weight.requires_grad_()

    def evaluate(samples: ResidualSamples) -> torch.Tensor:
        hidden = torch.tanh(torch.from_numpy((samples.motion - centre) / size) @ weights[0] + weights[1])
        outputs: torch.Tensor = hidden @ weights[2] + weights[3]
        return outputs

    def measure_loss(samples: ResidualSamples) -> torch.Tensor:
        return (evaluate(samples) - torch.from_numpy(samples.values / unit)).square().mean()

    optimizer = torch.optim.Adam(weights, lr=_RATE, weight_decay=_DECAY)
    best, best_weights = np.inf, [weight.detach().clone() for weight in weights]
    for _ in range(_STEPS):
        optimizer.zero_grad()
        measure_loss(data.fitting).backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        with torch.no_grad():
            error = float(measure_loss(data.choice))
        if error < best:
            best, best_weights = error, [weight.detach().clone() for weight in weights]
    weights = best_weights
    return RivalFit((), lambda samples: np.asarray(evaluate(samples).numpy() * unit, np.float64))


def fit_sparse_regression(data: RivalData) -> RivalFit:
    """Fit a group-sparse regression whose terms are certified by other shots, the idea of LISDD (arXiv 2606.23215).

    Groups of terms are added and removed as long as the Bayesian information criterion falls. Of these, an F test on
    shots that chose nothing names some, with the false-discovery rate controlled over the whole library. `unknown`: the
    named terms explain less than half, and noise does not explain the rest.
    """
    support = _select_groups(data)
    has_adjusted = _mask_columns(data.fitting, data.simulator_effects)
    p_values = {name: _test_group(data.choice, has_adjusted, support, name) for name in sorted(support)}
    named = _control_false_discoveries(p_values, len(data.candidates))
    adjusted, better = (
        _solve_columns(data.fitting, has_adjusted | _mask_columns(data.fitting, names))[0] for names in ((), named)
    )
    before, after = (
        float(np.square(data.choice.target - data.choice.design @ one).mean()) for one in (adjusted, better)
    )
    if _exceeds_noise(after, data.choice.values.size) and before - after < (before - 1) / 2:
        named = ("unknown",)
    return RivalFit(named, lambda samples: samples.columns @ better)


def _mask_columns(samples: ResidualSamples, names: Iterable[str]) -> BoolArray:
    """Return a mask (C,) of the columns of some groups."""
    return np.isin(samples.groups, tuple(names))


def _solve_columns(samples: ResidualSamples, used: BoolArray) -> tuple[FloatArray, float, int]:
    """Fit the `used` (C,) columns: all coefficients (C,), the sum of squared residuals, and the rank."""
    design, target = samples.design, samples.target
    coefficients = np.zeros(len(used))
    coefficients[used], _, rank, _ = np.linalg.lstsq(design[:, used], target, rcond=1e-9)
    return coefficients, float(np.square(target - design @ coefficients).sum()), int(rank)


def _select_groups(data: RivalData) -> frozenset[str]:
    """Select groups by adding or removing one after the other as long as the Bayesian information criterion falls."""
    count, adjusted = data.fitting.values.size, data.simulator_effects

    def evaluate_criterion(names: frozenset[str]) -> float:
        _, left, rank = _solve_columns(data.fitting, _mask_columns(data.fitting, names | adjusted))
        return count * float(np.log(max(left, 1e-300) / count)) + rank * float(np.log(count))

    support, lowest = frozenset[str](), evaluate_criterion(frozenset())
    while True:
        best = min((support ^ {name} for name in data.candidates), key=evaluate_criterion)
        criterion = evaluate_criterion(best)
        if criterion >= lowest:
            return support
        support, lowest = best, criterion


def _test_group(samples: ResidualSamples, has_adjusted: BoolArray, support: frozenset[str], name: str) -> float:
    """Return the p-value of a group beside all others of the support, by an F test."""
    others = has_adjusted | _mask_columns(samples, support - {name})
    _, without, few = _solve_columns(samples, others)
    _, left, many = _solve_columns(samples, others | _mask_columns(samples, (name,)))
    free = samples.values.size - many
    if many == few or free < 1:
        return 1.0
    return float(f.sf((without - left) / (many - few) / max(left / free, 1e-300), many - few, free))


def _control_false_discoveries(p_values: dict[str, float], count: int) -> tuple[str, ...]:
    """Return the names that pass the procedure of Benjamini and Hochberg (1995) among `count` tests."""
    ordered = sorted(p_values, key=lambda name: p_values[name])
    passing = [k for k, name in enumerate(ordered, 1) if p_values[name] <= _LEVEL * k / count]
    return tuple(ordered[: max(passing, default=0)])


def _exceeds_noise(mean_square: float, count: int) -> bool:
    """Return whether a mean of squares, in variances of the noise, is too large for noise."""
    return bool(mean_square * count > chi2.isf(_LEVEL, count))


def _measure_closed_share(before: FloatArray, after: FloatArray) -> float:
    """Return (before^2 - after^2) / (before^2 - noise^2) of values in standard deviations; NaN for noise alone."""
    first, second = float(np.square(before).mean()), float(np.square(after).mean())
    if not _exceeds_noise(first, before.size):
        return np.nan
    return float(np.clip((first - second) / (first - 1), -1.0, 1.0))


# Methods in the order of the tables, and whether they name effects.
_RIVALS: tuple[tuple[str, Callable[[RivalData], RivalFit], bool], ...] = (
    (SINDY, fit_sindy, True), (NETWORK, fit_network, False), (SPARSE, fit_sparse_regression, True),
)  # fmt: skip


def compare_methods(
    scene: GapScene,
    recordings: tuple[Recording, ...],
    ours: MethodAnswer,
    judge: Callable[[tuple[str, ...]], bool],
    seed: int = 0,
) -> tuple[MethodAnswer, ...]:
    """Run the rivals on the shots of a diagnosis.

    Args:
        scene: Scene of the diagnosis.
        recordings: One recording per shot.
        ours: Answer of the diagnosis; its closed share is measured like those of the rivals.
        judge: Whether names are a right answer.
        seed: Random seed of the network.

    Returns:
        The answers, ours first.
    """
    began = time.perf_counter()
    oracle = build_oracle(scene, recordings)
    used = sample_residuals(oracle.problem, oracle.fitting_shots, oracle.base)
    holdout_shots = apply_noise_estimate(oracle.holdout_shots, oracle.noise)
    holdout = sample_residuals(oracle.problem, holdout_shots, oracle.base)
    shared_seconds = time.perf_counter() - began
    if used is None or holdout is None:
        return ours, *(MethodAnswer(name, note="no free motion to sample") for name, _, _ in _RIVALS)
    shots = np.unique(used.shot)
    chooses = np.isin(used.shot, shots[_CHOICE_EVERY - 1 :: _CHOICE_EVERY])
    if not chooses.any():
        chooses[_CHOICE_EVERY - 1 :: _CHOICE_EVERY] = True
    data = RivalData(used.select(~chooses), used.select(chooses), frozenset(scene.simulator_effects), seed)
    effects = frozenset(effect.name for effect in scene.effects)
    answers = [ours]
    if names := frozenset(ours.named) & frozenset(oracle.problem.candidates):
        better = sample_residuals(oracle.problem, holdout_shots, oracle.fit_with_effects(names))
        if better is not None:
            answers = [replace(ours, closed=_measure_closed_share(holdout.target, better.target))]
    for name, fit, gives_names in _RIVALS:
        if name == SINDY and find_spec("pysindy") is None:
            answers.append(MethodAnswer(name, note="pysindy is not installed"))
            continue
        began = time.perf_counter()
        rival = fit(data)
        seconds = shared_seconds + time.perf_counter() - began
        off = (holdout.values - rival.predict(holdout)) / holdout.sigma[:, None]
        # terms that are no effect of the scene say that it lacks an effect which its library does not hold
        meant = rival.named if effects & {*rival.named} or not rival.named else ("unknown",)
        right = judge(meant) if gives_names else None
        answers.append(
            MethodAnswer(name, rival.named, right, _measure_closed_share(holdout.target, off.ravel()), seconds)
        )
    return tuple(answers)


def compare_case(one: OpenedCase, folder: Path) -> tuple[MethodAnswer, ...]:
    """Run the rivals on a case that was diagnosed and opened, in its track folder."""
    read = read_track_folders([folder])
    ours = MethodAnswer(OURS, one.named, one.answer == "right", seconds=one.seconds)
    scene = one.kind.simulator(build_gap_scene(read))
    return compare_methods(scene, read.recordings, ours, lambda names: is_right_answer(one.kind, names), one.seed)


def compare_real_set(one: RealSet, opened: OpenedSet, seed: int = 0) -> tuple[MethodAnswer, ...]:
    """Run the rivals on a set of real shots that was diagnosed and opened."""
    read = read_track_folders([one.folder])
    ours = MethodAnswer(OURS, opened.named, opened.right, seconds=opened.seconds)
    accepted = read_accepted_answers(one)
    return compare_methods(
        build_gap_scene(read), read.recordings, ours, lambda names: frozenset(names) in accepted, seed
    )


def is_right_answer(kind: CaseKind, names: tuple[str, ...]) -> bool:
    """Return whether names are a right answer to a case; empty ones say that nothing is missing."""
    if not names:
        return not kind.withheld or kind.trap
    if kind.foreign:
        return names == ("unknown",)
    return kind.is_named_by(frozenset(names))


Comparison = tuple[str, tuple[MethodAnswer, ...]]


def compare_cases(only: str, seeds: range, shots: int, scratch: Path) -> Iterator[Comparison]:
    """Diagnose cases whose kind contains a word, and run the rivals on each."""
    for kind in KINDS if only else DEFAULT_KINDS:
        if only not in kind.name or (kind.engine and not find_spec(kind.engine)):
            continue
        for seed in seeds:
            folder = scratch / f"{kind.name}, seed {seed}"
            simulate_case(kind, seed, shots, 60.0, scratch / "sealed.json", folder)
            yield folder.name, compare_case(diagnose_case(kind, seed, folder), folder)


def compare_real_sets(real: Path, only: str, seed: int, scratch: Path) -> Iterator[Comparison]:
    """Diagnose the sets of a folder whose name contains a word, and run the rivals on each."""
    for one in list_real_sets(real, scratch):
        if only in one.name:
            opened = diagnose_real_set(one, scratch / one.name / "gap", seed)
            yield (
                one.name,
                (MethodAnswer(OURS, note=opened.unreadable),)
                if opened.unreadable
                else compare_real_set(one, opened, seed),
            )


def print_comparison(name: str, answers: Iterable[MethodAnswer]) -> None:
    """Print one row per method."""
    for one in answers:
        right = "-" if one.right is None else "yes" if one.right else "no"
        closed = f"{one.closed:.0%}" if math.isfinite(one.closed) else "-"
        seconds = f"{one.seconds:.1f}" if math.isfinite(one.seconds) else "-"
        said = one.note or " + ".join(one.named) or "-"
        print(f"| {name} | {one.method} | {said} | {right} | {closed} | {seconds} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="kinds of case, or sets, whose name contains this word")
    parser.add_argument("--seeds", type=int, default=1, help="number of cases per kind")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--shots", type=int, default=12, help="shots of a case")
    parser.add_argument("--real", type=Path, help="folder of sets of real shots, instead of cases")
    options = parser.parse_args()
    print("| case | method | answer | right | closed | seconds |\n|---|---|---|---|---|---|")
    marks: dict[str, list[bool]] = {}
    with tempfile.TemporaryDirectory() as folder:
        scratch, seeds = Path(folder), range(options.seed, options.seed + options.seeds)
        compared = (
            compare_real_sets(options.real, options.only, options.seed, scratch) if options.real
            else compare_cases(options.only, seeds, options.shots, scratch)
        )  # fmt: skip
        for name, answers in compared:
            print_comparison(name, answers)
            for one in answers:
                if one.right is not None:
                    marks.setdefault(one.method, []).append(one.right)
    for method, right in marks.items():
        print(f"{method}: right {sum(right)} of {len(right)}")


if __name__ == "__main__":
    main()
