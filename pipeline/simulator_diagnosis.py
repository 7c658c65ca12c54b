"""Diagnosis of a simulator from outside, from recordings of its joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from diagnosis.diagnose import diagnose
from diagnosis.fitting.display_names import format_parameter
from diagnosis.selection.hypotheses import ProgressCallback, ignore_progress
from diagnosis.verdicts.verdict import DiagnosisReport
from models.core.number_format import format_unit, format_with_sigma
from models.estimation.gap_scenes.simulator_scene import SimulatorScene, build_simulator_scene
from models.numerics.executor import SERIAL, Executor
from pipeline.io.simulators.mechanism_recordings import read_mechanism_shots

# Standard deviations from which a coefficient of a simulator is called wrong.
_WRONG_SIGMAS = 3.0


def diagnose_mechanism(
    inputs: Sequence[Path],
    simulator: str,
    seed: int = 0,
    on_progress: ProgressCallback = ignore_progress,
    executor: Executor = SERIAL,
) -> tuple[DiagnosisReport, dict[int, str]]:
    """Diagnose a simulator from outside.

    Args:
        inputs: Recordings: tables with a column per joint, MCAP files or ROS 2 bags.
        simulator: `FILE.xml` of MuJoCo, `MODULE:FUNCTION` of Python, or a table of simulated positions.
        seed: Seed of the noise and bootstrap draws.
        on_progress: Receives what the search does.
        executor: Distributes the fits over processes.

    Returns:
        The report, with wrong coefficients of the simulator in its notes, and the origin of each shot.

    Raises:
        OptionError: The simulator or a recording cannot be used.
    """
    shots = read_mechanism_shots(inputs, simulator)
    scene = build_simulator_scene(shots.simulator, shots.recordings, shots.histories)
    report = diagnose(scene, shots.recordings, seed, on_progress, executor)
    origins = shots.origins if len(inputs) > 1 or shots.is_cut else {}
    return replace(report, notes=(*_describe_coefficients(scene, report), *report.notes, *shots.notes)), dict(origins)


def _describe_coefficients(scene: SimulatorScene, report: DiagnosisReport) -> tuple[str, ...]:
    """Describe the coefficients of the simulator that the recordings contradict."""
    stated = {
        f"{effect.name}.{prior.name}": prior.value
        for effect in scene.effects
        if effect.name in scene.simulator_effects
        for prior in effect.parameters
    }
    wrong = (
        one
        for one in report.fitted
        if one.name in stated and not one.prior_only and abs(one.value - stated[one.name]) > _WRONG_SIGMAS * one.sigma
    )
    return tuple(
        f"your {format_parameter(one.name)} is {stated[one.name]:.4g} {format_unit(one.unit)}, the recordings say"
        f" {format_with_sigma(one.value, one.sigma)}"
        for one in wrong
    )
