"""Results of all seeds of a setting as tables, and in which settings the claims of the thesis hold."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import median

from pipeline.experiments.thesis.compared_methods import (
    CONSTRAINT_NET,
    PHYSICS_NAME,
    PRETRAINED_NET,
    SPLINES,
    THESIS_NET,
)
from pipeline.experiments.thesis.thesis_scenes import ExperimentCase
from pipeline.experiments.thesis.trials import Trial

# Name of a variant of a scene.
UNITS = {"double-pendulum": "{} springs", "real": "From {} on", "boxes": "A ball of {} px/s", "pool": "{}"}
# Compared methods, the best of which counts, with their rivals.
COMPARISONS = (
    (f"network of the thesis ({THESIS_NET})", (THESIS_NET,), "linear"),
    (f"network of the thesis ({THESIS_NET})", (THESIS_NET,), CONSTRAINT_NET),
    ("best spline", SPLINES, "linear"),
    (CONSTRAINT_NET, (CONSTRAINT_NET,), "linear"),
    (PRETRAINED_NET, (PRETRAINED_NET,), "linear"),
    ("fit of the physics", (PHYSICS_NAME,), "cubic"),
)
COMPARISON_HEADS = ["median", "lowest", "highest", "lower in"]
# Claimed ratio of errors to those of linear interpolation and ConstraintNet: Chen 2022, abstract and figure 6.
CLAIMED_FACTOR = 100.0
# Largest stated ratio; beyond it only rounding errors are compared.
MAX_FACTOR = 1e6
# Largest ratio of two errors that count as comparable.
COMPARABLE_FACTOR = 2.0


@dataclass(frozen=True, slots=True)
class SettingResult:
    """Results of all seeds of one setting."""

    case: ExperimentCase
    """The setting, with its first seed."""
    mse: dict[str, float]
    """px^2 by method: linear's median over seeds, times the median ratio of the method to linear with the same seed.

    Methods with fewer seeds are thus compared on those. Networks that were not trained to the end are left out.
    """
    untrained: dict[str, float]
    """CPU s of the networks that were not trained to the end with every seed: the longest training."""


def summarize_settings(trials: Iterable[Trial]) -> list[SettingResult]:
    """Summarize trials by setting with medians over seeds.

    Args:
        trials: Trials of any settings.

    Returns:
        Results in the order in which settings first occur.
    """
    by_setting: dict[tuple[str, str, float, float], dict[str, dict[int, Trial]]] = {}
    cases: dict[tuple[str, str, float, float], ExperimentCase] = {}
    for trial in trials:
        setting = trial.case.setting
        cases.setdefault(setting, trial.case)
        by_setting.setdefault(setting, {}).setdefault(trial.method, {})[trial.case.seed] = trial
    return [SettingResult(case, *_summarize_methods(by_setting[setting])) for setting, case in cases.items()]


def _summarize_methods(methods: dict[str, dict[int, Trial]]) -> tuple[dict[str, float], dict[str, float]]:
    """Compute the median error of each method, and CPU s of methods not trained to the end."""
    linear = methods["linear"]
    usual = median(trial.mse for trial in linear.values())
    errors, untrained = {}, {}
    for name, by_seed in methods.items():
        if all(trial.is_trained for trial in by_seed.values()):
            errors[name] = usual * median(trial.mse / linear[seed].mse for seed, trial in by_seed.items())
        else:
            untrained[name] = max(trial.seconds for trial in by_seed.values())
    return errors, untrained


def describe_scene_results(scene: str, results: list[SettingResult], trained: float = 1.0) -> list[str]:
    """Describe the results of one scene.

    Args:
        scene: Name of the scene.
        results: Results of all settings.
        trained: Share of their training that networks had.

    Returns:
        Sentences; empty where the scene has no results.
    """
    here = [cell for cell in results if cell.case.scene == scene]
    if not here:
        return []
    untrained = [
        f"{name} ({cell.case}; {seconds:.0f} CPU s)" for cell in here for name, seconds in cell.untrained.items()
    ]
    sentence = f"Not trained to the end, and compared with nothing: {', '.join(untrained)}." if untrained else ""
    return [one for one in (_assess_claim(here, trained), sentence) if one]


def format_times(gain: float) -> str:
    """Format how many times lower an error is, with the significant digits."""
    if gain >= MAX_FACTOR:
        return f"over {MAX_FACTOR:,.0f}"
    return f"{gain:,.0f}" if gain >= 100 else f"{gain:.2g}"


def find_best_method(cell: SettingResult, names: Iterable[str]) -> tuple[str, float] | None:
    """Find the method with the least error in a setting."""
    there = [(name, cell.mse[name]) for name in names if name in cell.mse]
    return min(there, key=lambda pair: pair[1]) if there else None


def compute_gains(here: list[SettingResult], names: Iterable[str], rival: str) -> list[tuple[SettingResult, float]]:
    """Compute how many times lower than `rival` the best of `names` is, in every setting that has both."""
    wanted = tuple(names)
    pairs = [(cell, find_best_method(cell, wanted)) for cell in here if rival in cell.mse]
    return [(cell, cell.mse[rival] / max(one[1], 1e-300)) for cell, one in pairs if one is not None]


def _assess_claim(here: list[SettingResult], trained: float) -> str:
    """Assess the claim of the thesis about the error of its network relative to linear interpolation."""
    gains = compute_gains(here, (THESIS_NET,), "linear")
    if not gains:
        return ""
    claimed, least, most = f"{CLAIMED_FACTOR:g} times lower than", CLAIMED_FACTOR, math.inf
    if here[0].case.scene == "boxes":
        claimed, least, most = "comparable to", 1 / COMPARABLE_FACTOR, COMPARABLE_FACTOR
    successes = [cell for cell, gain in gains if least <= gain <= most]
    text = f"The thesis claims an error {claimed} that of linear interpolation."
    for cell, gain in gains:
        if cell.case.is_own:
            verdict = "holds" if cell in successes else "fails"
            text += f" In its own setting ({cell.case}) the factor is {format_times(gain)}: the claim {verdict}."
    named = f" ({'; '.join(str(cell.case) for cell in successes)})" if 0 < len(successes) < len(gains) else ""
    text += f" Settings in which it holds: {len(successes)} of {len(gains)}{named}."
    if trained < 1:
        text += f" The network had {trained:.0%} of its training at most: where the claim fails, that decides nothing."
    return text


Cell = tuple[str, str]
"""Text of a cell, and its style: best, worse (than linear), or empty."""


@dataclass(frozen=True, slots=True)
class ResultTable:
    """A table of methods; one column per setting, or per property of their training."""

    caption: str
    heads: list[str]
    rows: list[tuple[str, list[Cell]]]
    """Name and cells of each method."""


def format_csv(trials: Sequence[Trial]) -> str:
    """Format one row per trial, with the columns of the contract first."""
    text = io.StringIO()
    rows = [trial.row for trial in trials]
    writer = csv.DictWriter(text, list(rows[0]) if rows else ["scene"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def build_tables(scene: str, results: list[SettingResult]) -> list[ResultTable]:
    """Build the comparison of the methods over all settings of a scene, and a table for each variant."""
    here = [cell for cell in results if cell.case.scene == scene]
    variants = dict.fromkeys(cell.case.variant for cell in here)
    tables = [_build_table(variant, [cell for cell in here if cell.case.variant == variant]) for variant in variants]
    return [_compare_methods(here), *tables]


def _compare_methods(here: list[SettingResult]) -> ResultTable:
    """Compare methods with their rivals over all settings of a scene."""
    rows = []
    for name, methods, rival in COMPARISONS:
        gains = [gain for _, gain in compute_gains(here, methods, rival)]
        if gains:
            better = sum(gain > 1 for gain in gains)
            texts = [*map(format_times, (median(gains), min(gains), max(gains))), f"{better} of {len(gains)}"]
            rows.append((f"{name}, than {rival}", [(text, "") for text in texts]))
    return ResultTable("How many times lower the error is, over all settings", COMPARISON_HEADS, rows)


def _build_table(variant: str, here: list[SettingResult]) -> ResultTable:
    methods = dict.fromkeys(name for cell in here for name in (*cell.mse, *cell.untrained))
    heads = [f"{cell.case.fps:.3g} Hz, {cell.case.noise:g} px" for cell in here]
    first = ("linear: mse, px²", [(f"{cell.mse['linear']:.3g}", "worse") for cell in here])
    rest = [(name, [_format_cell(cell, name) for cell in here]) for name in methods if name != "linear"]
    name = UNITS[here[0].case.scene].format(variant)
    return ResultTable(f"{name[0].upper()}{name[1:]}: how many times lower than linear", heads, [first, *rest])


def _format_cell(cell: SettingResult, name: str) -> Cell:
    if name in cell.untrained:
        return f"not trained to the end ({cell.untrained[name]:.0f} s)", "worse"
    if name not in cell.mse:
        return "-", "worse"
    gain = cell.mse["linear"] / max(cell.mse[name], 1e-300)
    leader = find_best_method(cell, cell.mse)
    look = "best" if leader is not None and leader[0] == name else "worse" if gain < 1 else ""
    return format_times(gain) if gain >= 1e-3 else "lost", look


def build_learning_table(scene: str, trials: Sequence[Trial]) -> ResultTable | None:
    """Build the table of training costs in the first setting of a scene, where all methods run: medians over seeds."""
    here = [trial for trial in trials if trial.case.scene == scene]
    setting = here[0].case.setting if here else None
    by_method: dict[str, list[Trial]] = {}
    for trial in here:
        if trial.case.setting == setting and trial.parameters:
            by_method.setdefault(trial.method, []).append(trial)
    rows = []
    for method, some in by_method.items():
        parameters = median(trial.parameters for trial in some)
        steps = median(len(trial.loss) for trial in some)
        seconds = median(trial.seconds for trial in some)
        name = method if all(trial.is_trained for trial in some) else f"{method}, not trained to the end"
        texts = f"{int(parameters):,}", f"{int(steps):,}" if steps >= 1 else "-", f"{seconds:.1f}"
        rows.append((name, [(text, "") for text in texts]))
    caption = "Training cost of the methods, in the first setting"
    return ResultTable(caption, ["parameters", "steps", "CPU s"], rows) if rows else None
