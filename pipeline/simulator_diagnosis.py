"""Diagnosis of a simulator from outside, from recordings of its joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from diagnosis.diagnose import diagnose, explain_insufficient_data
from diagnosis.fitting.diagnosis_windows import fit_initial_windows, thin_out_windows
from diagnosis.fitting.display_names import format_parameter
from diagnosis.fitting.hypothesis_fits import build_diagnosis_problem, fit_effects
from diagnosis.fitting.shot_preparation import apply_noise_estimate, estimate_noise, split_shots
from diagnosis.selection.hypotheses import ProgressCallback, SearchOutlook, ignore_progress
from diagnosis.selection.hypothesis_trials import CLEAR_GAIN
from diagnosis.selection.study import ENOUGH_WINDOWS
from diagnosis.verdicts.verdict import DiagnosisReport
from models.core.errors import OptionError
from models.core.number_format import format_unit, format_with_sigma
from models.core.recording import Recording
from models.estimation.gap_scenes.billiards_scene import BilliardsScene, pair_with_simulator
from models.estimation.gap_scenes.gap_scene import GapScene
from models.estimation.gap_scenes.simulator_scene import SimulatorScene, build_simulator_scene, leave_out_failures
from models.numerics.executor import SERIAL, Executor
from models.physics.mechanisms.mechanism_catalogue import MECHANISM_EFFECTS
from pipeline.io.simulators.function_simulator import FunctionSimulator
from pipeline.io.simulators.mechanism_recordings import MechanismShots, read_mechanism_shots
from pipeline.io.simulators.pooltool_simulator import open_pooltool
from pipeline.reporting.text.gap_sentences import name_runs

# Standard deviations above 0 from which a friction belongs into a file.
_SEEN_SIGMAS = 2.0
# Share of its misfit that half a step must explain for it to be doubted: a step that is right explains none of it.
_STEP_SHARE = 0.1


def diagnose_mechanism(
    inputs: Sequence[Path],
    simulator: str,
    seed: int = 0,
    on_progress: ProgressCallback = ignore_progress,
    executor: Executor = SERIAL,
    on_note: Callable[[str], None] = lambda note: None,
) -> tuple[DiagnosisReport, dict[int, str], MechanismShots]:
    """Diagnose a simulator from outside.

    Args:
        inputs: Recordings: tables with a column per joint, MCAP files or ROS 2 bags.
        simulator: `FILE.xml` of MuJoCo, `MODULE:FUNCTION` of Python, or a table of simulated positions.
        seed: Seed of the noise and bootstrap draws.
        on_progress: Receives what the search does.
        executor: Distributes the fits over processes.
        on_note: Receives what was assumed of the recordings, before the search, which takes minutes.

    Returns:
        The report, with wrong coefficients of the simulator in its notes, the origin of each shot, and the shots.

    Raises:
        OptionError: The simulator or a recording cannot be used.
    """
    shots = read_mechanism_shots(inputs, simulator)
    for note in shots.notes:
        on_note(note)
    scene = build_simulator_scene(shots.simulator, shots.recordings, shots.histories)
    recordings, failed, total = leave_out_failures(scene, shots.recordings)
    reason = shots.simulator.failure or "positions grow without bound"
    fails = f"{simulator} fails in {failed} of {total} windows that begin as recorded: {reason}"
    if 2 * failed > total:
        raise OptionError(f"{fails}; check its time step, its units and the poses at which it begins")
    lost = (f"{fails}; they are left out",) if failed else ()
    doubts = (*lost, *_doubt_time_step(scene, recordings, on_progress, executor))
    for note in doubts:
        on_note(note)
    report = diagnose(scene, recordings, seed, on_progress, executor)
    origins = shots.origins
    if len(inputs) == 1:  # without the name of the file, and none where the number of the shot says all
        is_told_by_number = shots.run_count in (1, len(origins))
        origins = {} if is_told_by_number else {shot: name.partition(", ")[2] for shot, name in origins.items()}
    notes = (
        *_describe_changes(scene, report),
        *describe_coefficients(report),
        *report.notes,
        *shots.notes,
        *doubts,
    )

    def say(text: str) -> str:
        return name_runs(report.scene, text)

    worded = replace(report, notes=tuple(map(say, notes)), film_next=say(report.film_next), reason=say(report.reason))
    return worded, {shot: say(name) for shot, name in origins.items()}, shots


# Attributes of a joint of MuJoCo that hold the strengths of an effect, in their order.
_JOINT_ATTRIBUTES = {"joint_friction": ("frictionloss", "damping"), "armature": ("armature",)}


def _describe_changes(scene: SimulatorScene, report: DiagnosisReport) -> tuple[str, ...]:
    """Describe what to write into the file of a simulator that has the named effects, or wrong coefficients, itself."""
    fitted = {one.name: one for one in report.fitted}
    wrong = [one.name.partition(".")[0] for one in report.fitted if one.is_wrongly_stated]
    changes = []
    for effect in dict.fromkeys((*report.effects, *wrong)):
        if effect not in scene.simulator.own_effects or effect not in _JOINT_ATTRIBUTES:
            continue
        names = [(attribute, f"{effect}.{one.name}") for attribute, one in
                 zip(_JOINT_ATTRIBUTES[effect], MECHANISM_EFFECTS[effect].strengths, strict=True)]  # fmt: skip
        for joint in scene.simulator.joints:
            own = [(attribute, fitted.get(f"{name}_{joint.name}", fitted.get(name))) for attribute, name in names]
            texts = [
                f'{attribute}="{one.value:.4g}"'
                for attribute, one in own
                if one and not one.prior_only and (one.value > _SEEN_SIGMAS * one.sigma or one.is_wrongly_stated)
            ]
            if texts and not joint.body:
                changes.append(f"joint {joint.name} {' '.join(texts)}")
    return (f"in the file of your simulator, give {', '.join(changes)}",) if changes else ()


def _doubt_time_step(
    scene: SimulatorScene, recordings: tuple[Recording, ...], on_progress: ProgressCallback, executor: Executor
) -> tuple[str, ...]:
    """Doubt a function that explains recordings better with half its step: it errs by itself, as by a lag."""
    simulator, split = scene.simulator, split_shots(recordings)
    if not isinstance(simulator, FunctionSimulator) or explain_insufficient_data(scene, split):
        return ()
    on_progress("trying half the time step", (), SearchOutlook())
    shots = (*split.fitting, *split.selection)
    noise, finer = estimate_noise(shots), replace(scene, simulator=simulator.halve_step())
    problems = [build_diagnosis_problem(one, noise, executor) for one in (scene, finer)]
    used = thin_out_windows(problems[0], apply_noise_estimate(shots, noise), ENOUGH_WINDOWS)
    whole = fit_initial_windows(problems[0], used)
    half = fit_effects(problems[1], whole.segments, guess=whole.shared, starts=whole.starts)
    if not whole.cost - half.cost > max(CLEAR_GAIN, _STEP_SHARE * whole.lower_excess_cost):
        return ()
    return (
        f"with a step of {500 * simulator.time_step:.3g} ms instead of {1e3 * simulator.time_step:.3g} your simulator"
        " explains these runs better: a part of what it lacks is the error of its steps, which looks like a lag or"
        " another scale; give it a shorter time_step first",
    )


def pair_with_pooltool(scene: GapScene) -> BilliardsScene:
    """Let pooltool play the shots of a scene.

    Raises:
        OptionError: The scene is no billiards, or pooltool does not start.
    """
    if not isinstance(scene, BilliardsScene):
        raise OptionError(f"pooltool simulates billiards; these recordings are of the scene {scene.name}")
    return pair_with_simulator(scene, open_pooltool())


def describe_coefficients(report: DiagnosisReport) -> tuple[str, ...]:
    """Describe the coefficients of a simulator from outside that the recordings contradict; none of our own."""
    sentences: dict[tuple[str, str], list[str]] = {}
    for one in report.fitted:
        if one.is_wrongly_stated:
            effect, _, parameter = one.name.partition(".")
            is_common = effect not in MECHANISM_EFFECTS
            strength, joint = (parameter, "") if is_common else MECHANISM_EFFECTS[effect].split_parameter(parameter)
            # one sentence for all joints whose file states the same
            says = f"your {format_parameter(f'{effect}.{strength}')} is {one.stated:.4g}"
            place = f" ({format_parameter(joint)})" if joint else ""
            sentences.setdefault((says, one.unit), []).append(f"{format_with_sigma(one.value, one.sigma)}{place}")
    return tuple(
        f"{says}{'' if unit == '1' else f' {format_unit(unit)}'}, the recordings say {', '.join(values)}"
        for (says, unit), values in sentences.items()
    )
