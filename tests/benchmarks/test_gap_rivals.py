"""The rivals of the diagnosis name and close what acts in simulated cases, and nothing where nothing is missing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.diagnosis.gap_rivals import (
    NETWORK,
    OURS,
    SINDY,
    SPARSE,
    MethodAnswer,
    RivalData,
    compare_methods,
    fit_network,
    fit_sparse_regression,
    is_right_answer,
)
from benchmarks.diagnosis.rival_terms import ResidualSamples, build_terms, sample_residuals
from pipeline.experiments.gapcheck.blind_case import build_oracle, simulate_case
from pipeline.experiments.gapcheck.body_cases import BODY_KINDS, BodyKind
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import build_gap_scene

FPS = 60.0


def find_kind(name: str) -> BodyKind:
    return next(kind for kind in BODY_KINDS if kind.name == name)


def compare(name: str, folder: Path, ours: tuple[str, ...]) -> dict[str, MethodAnswer]:
    kind = find_kind(name)
    simulate_case(kind, 4, 12, FPS, folder / "sealed.json", folder / "case")
    read = read_track_folders([folder / "case"])
    answers = compare_methods(
        build_gap_scene(read), read.recordings, MethodAnswer(OURS, ours), lambda names: is_right_answer(kind, names)
    )
    return {one.method: one for one in answers}


def test_air_drag_is_named_and_closed_by_the_sparse_regression(tmp_path: Path) -> None:
    answers = compare("flight, air drag", tmp_path, ("air_drag",))
    assert answers[SPARSE].named == ("air_drag",)
    assert answers[SPARSE].right
    assert answers[SPARSE].closed > 0.95
    assert answers[OURS].closed > 0.95
    assert answers[NETWORK].right is None
    assert answers[NETWORK].closed > 0.5
    assert answers[SPARSE].seconds > 0


def test_nothing_is_named_and_nothing_is_to_be_closed_where_nothing_is_missing(tmp_path: Path) -> None:
    answers = compare("flight, nothing missing", tmp_path, ("none",))
    assert answers[SPARSE].named == ()
    assert answers[SPARSE].right
    assert all(np.isnan(one.closed) for one in answers.values())


def test_pysindy_names_the_friction_of_a_slide(tmp_path: Path) -> None:
    pytest.importorskip("pysindy")
    answers = compare("slide, friction", tmp_path, ("sliding_friction",))
    assert "sliding_friction" in answers[SINDY].named
    assert answers[SINDY].closed > 0.9


def test_a_method_that_is_not_installed_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.diagnosis.gap_rivals.find_spec", lambda name: None)
    answers = compare("slide, friction", tmp_path, ())
    assert answers[SINDY].note == "pysindy is not installed"
    assert answers[SINDY].right is None
    assert answers[SPARSE].named == ("sliding_friction",)


def test_the_sampled_acceleration_is_that_of_the_effect(tmp_path: Path) -> None:
    simulate_case(find_kind("flight, viscous drag"), 4, 12, FPS, tmp_path / "sealed.json", tmp_path / "case")
    read = read_track_folders([tmp_path / "case"])
    oracle = build_oracle(build_gap_scene(read), read.recordings)
    samples = sample_residuals(oracle.problem, oracle.fitting_shots, oracle.base)
    assert samples is not None
    drag = oracle.fit_with_effects(frozenset({"viscous_drag"})).shared[1]
    column = samples.columns[:, :, samples.groups.index("viscous_drag")]
    off = (samples.values - drag * column) / samples.sigma[:, None]
    assert np.square(off).mean() == pytest.approx(1.0, abs=0.35)
    assert np.square(samples.target).mean() > 5


def make_samples(shots: int, law: Callable[[np.ndarray], np.ndarray], seed: int) -> ResidualSamples:
    """Make samples of flights in a plane, with noise of 0.1 m/s2."""
    rng = np.random.default_rng(seed)
    shot = np.repeat(np.arange(shots), 10)
    position, velocity = rng.uniform(-2, 2, (len(shot), 2)), rng.uniform(-8, 8, (len(shot), 2))
    terms = build_terms("flight", position, velocity)
    groups = tuple(name for name, part in terms.items() for _ in range(part.shape[2]))
    columns = np.concatenate(list(terms.values()), axis=2)
    values = law(velocity) + 0.1 * rng.standard_normal(velocity.shape)
    motion = np.concatenate([position, velocity], axis=1)
    return ResidualSamples(values, np.full(len(shot), 0.1), shot, motion, columns, groups)


def split(law: Callable[[np.ndarray], np.ndarray], seed: int = 0) -> RivalData:
    return RivalData(make_samples(8, law, seed), make_samples(4, law, seed + 1), frozenset({"viscous_drag"}), seed)


def test_false_discoveries_of_the_sparse_regression_are_rare() -> None:
    alarms = sum(bool(fit_sparse_regression(split(np.zeros_like, 2 * seed)).named) for seed in range(60))
    assert alarms <= 2


def test_terms_of_the_simulator_are_adjusted_and_not_named() -> None:
    fit = fit_sparse_regression(split(lambda v: -0.3 * v))
    assert fit.named == ()
    samples = make_samples(3, lambda v: -0.3 * v, 9)
    assert np.abs(samples.values - fit.predict(samples)).mean() < 0.15


def test_a_law_of_no_term_is_unknown_and_the_network_closes_a_part_of_it() -> None:
    def law(v: np.ndarray) -> np.ndarray:
        return np.stack([4 * np.sin(v[:, 1] / 2), 0 * v[:, 0]], axis=1)

    data = split(law)
    assert fit_sparse_regression(data).named == ("unknown",)
    samples = make_samples(6, law, 9)
    left = samples.values - fit_network(data).predict(samples)
    assert np.square(left).mean() < 0.5 * np.square(samples.values).mean()
    again = fit_network(data).predict(samples)
    assert np.array_equal(samples.values - again, left)


def test_names_are_judged_by_what_was_withheld() -> None:
    assert is_right_answer(find_kind("flight, air drag"), ("air_drag",))
    assert not is_right_answer(find_kind("flight, air drag"), ())
    assert not is_right_answer(find_kind("flight, air drag"), ("air_drag", "wind"))
    assert is_right_answer(find_kind("flight, nothing missing"), ())
    assert not is_right_answer(find_kind("flight, nothing missing"), ("unknown",))
    assert is_right_answer(find_kind("slide, curl"), ("unknown",))
    assert not is_right_answer(find_kind("flight, drag with speed^1.5"), ())


def test_without_free_motion_no_rival_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    module = "benchmarks.diagnosis.gap_rivals"
    oracle = SimpleNamespace(problem=None, fitting_shots=(), holdout_shots=(), noise=None, base=None)
    monkeypatch.setattr(f"{module}.build_oracle", lambda scene, recordings: oracle)
    monkeypatch.setattr(f"{module}.sample_residuals", lambda *_: None)
    monkeypatch.setattr(f"{module}.apply_noise_estimate", lambda shots, noise: shots)
    ours, *rivals = compare_methods(None, (), MethodAnswer(OURS, ("slope",)), lambda names: True)  # type: ignore[arg-type]
    assert ours.named == ("slope",)
    assert {one.note for one in rivals} == {"no free motion to sample"}
