"""Sentences on the tables: where the claims of the thesis hold, and where a spline is as good."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from statistics import median

from pipeline.experiments.thesis.compared_methods import (
    CONSTRAINT_NET,
    PHYSICS_NAME,
    PRETRAINED_NET,
    SPLINES,
    THESIS_NET,
)
from pipeline.experiments.thesis.experiment_plan import BASE_SETTING, FIRST_VARIANT
from pipeline.experiments.thesis.trials import Trial

CLAIMED_FACTOR = 100.0
"""Claimed ratio of errors to those of linear interpolation and ConstraintNet: Chen 2022, abstract and figure 6."""
MAX_FACTOR = 1e6
"""Largest stated ratio; beyond it only rounding errors are compared."""
EQUAL_FACTOR = 0.95
"""Ratio from which two errors are stated as equal."""
COMPARABLE_FACTOR = 2.0
"""Largest ratio of two errors that are called comparable."""


@dataclass(frozen=True, slots=True)
class SettingResult:
    """Results of all seeds of one setting."""

    scene: str
    variant: str
    fps: float
    noise: float
    mse: dict[str, float]
    """px^2 by method: linear's median over seeds, times the median ratio of the method to linear with the same seed.

    Methods with fewer seeds are thus compared on those. Networks that were not trained to the end are left out.
    """
    seeds: int
    untrained: dict[str, float]
    """CPU s of the networks that were not trained to the end with every seed: the longest training."""

    @property
    def setting(self) -> str:
        """The setting in words."""
        return f"{self.variant}, {self.fps:.3g} Hz, noise {self.noise:g} px"

    @property
    def is_own(self) -> bool:
        """Whether this is the setting of the thesis."""
        return FIRST_VARIANT.get(self.scene) == self.variant and (self.fps, self.noise) == BASE_SETTING


def trial_setting(trial: Trial) -> tuple[str, str, float, float]:
    """Return scene, variant, frame rate and noise of a trial."""
    case = trial.case
    return case.scene, case.variant, case.fps, case.noise


def summarize_settings(trials: Iterable[Trial]) -> list[SettingResult]:
    """Summarize trials by setting with medians over seeds.

    Args:
        trials: Trials of any settings.

    Returns:
        Results in the order in which settings first occur.
    """
    by_setting: dict[tuple[str, str, float, float], dict[str, dict[int, Trial]]] = {}
    for trial in trials:
        by_method = by_setting.setdefault(trial_setting(trial), {})
        by_method.setdefault(trial.method, {})[trial.case.seed] = trial
    return [SettingResult(*setting, *_summarize_methods(methods)) for setting, methods in by_setting.items()]


def _summarize_methods(methods: dict[str, dict[int, Trial]]) -> tuple[dict[str, float], int, dict[str, float]]:
    """Compute the median error of each method, the number of seeds, and CPU s of methods not trained to the end."""
    linear = methods["linear"]
    usual = median(trial.mse for trial in linear.values())
    errors, untrained = {}, {}
    for name, by_seed in methods.items():
        if all(trial.is_trained for trial in by_seed.values()):
            errors[name] = usual * median(trial.mse / linear[seed].mse for seed, trial in by_seed.items())
        else:
            untrained[name] = max(trial.seconds for trial in by_seed.values())
    return errors, max(map(len, methods.values())), untrained


def describe_scene_results(scene: str, results: list[SettingResult], trained: float = 1.0) -> list[str]:
    """Describe the results of one scene.

    Args:
        scene: Name of the scene.
        results: Results of all settings.
        trained: Share of their training that networks had.

    Returns:
        Sentences; empty where the scene has no results.
    """
    here = [cell for cell in results if cell.scene == scene]
    if not here:
        return []
    claim = _assess_boxes_claim(here) if scene == "boxes" else _assess_pendulum_claim(here, trained)
    candidates = [
        claim + _qualify_training(trained) if claim else "",
        _compare_splines(here),
        _describe_constraint_net(here),
        _describe_physics_fit(here),
        _list_untrained_networks(here),
    ]
    return [sentence for sentence in candidates if sentence]


def _list_untrained_networks(here: list[SettingResult]) -> str:
    """List the networks that were not trained to the end."""
    named = [
        f"{name} ({cell.setting}; {seconds:.0f} CPU s)" for cell in here for name, seconds in cell.untrained.items()
    ]
    return f"Not trained to the end, and compared with nothing: {', '.join(named)}." if named else ""


def format_times(gain: float) -> str:
    """Format a ratio with its significant digits."""
    if gain >= MAX_FACTOR:
        return f"over {MAX_FACTOR:,.0f}"
    return f"{gain:,.0f}" if gain >= 100 else f"{gain:.2g}"


def format_factor(gain: float) -> str:
    """Format how many times lower or higher an error is."""
    return f"{format_times(gain)} times lower" if gain >= 1 else f"{format_times(1 / max(gain, 1e-300))} times higher"


def format_comparison(gain: float, rival: str) -> str:
    """Format an error relative to that of a rival."""
    return f"that of {rival}" if EQUAL_FACTOR < gain < 1 / EQUAL_FACTOR else f"{format_factor(gain)} than {rival}"


def _format_range_end(gain: float) -> str:
    """Format an end of a range of ratios."""
    return "as high" if EQUAL_FACTOR < gain < 1 / EQUAL_FACTOR else format_factor(gain)


def find_best_method(cell: SettingResult, names: Iterable[str]) -> tuple[str, float] | None:
    """Find the method with the least error in a setting."""
    there = [(name, cell.mse[name]) for name in names if name in cell.mse]
    return min(there, key=lambda pair: pair[1]) if there else None


def compute_gains(here: list[SettingResult], names: Iterable[str], rival: str) -> list[tuple[SettingResult, float]]:
    """Compute how many times lower than `rival` the best of `names` is, in every setting that has both."""
    wanted = tuple(names)
    pairs = [(cell, find_best_method(cell, wanted)) for cell in here if rival in cell.mse]
    return [(cell, cell.mse[rival] / max(one[1], 1e-300)) for cell, one in pairs if one is not None]


def _assess_boxes_claim(here: list[SettingResult]) -> str:
    """Assess the claim of the thesis on boxes."""
    cell_gains = compute_gains(here, (THESIS_NET,), "linear")
    if not cell_gains:
        return ""
    alike = sum(1 / COMPARABLE_FACTOR < gain < COMPARABLE_FACTOR for _, gain in cell_gains)
    return (
        f"The thesis claims an error comparable to linear. Its network's is {_format_gains(cell_gains, 'linear')}: "
        f"within a factor of {COMPARABLE_FACTOR:g} of linear in {alike} of {_format_count(len(cell_gains), 'setting')}."
    )


def _assess_pendulum_claim(here: list[SettingResult], trained: float) -> str:
    """Assess the claim of the thesis on pendulums."""
    cell_gains = compute_gains(here, (THESIS_NET,), "linear")
    if not cell_gains:
        return ""
    claim = [f"The thesis claims an error {CLAIMED_FACTOR:g} times lower than linear."]
    claim += [_assess_base_setting(cell, gain, trained) for cell, gain in cell_gains if cell.is_own]
    others = [(cell, gain) for cell, gain in cell_gains if not cell.is_own]
    if others:
        holds = sum(gain >= CLAIMED_FACTOR for _, gain in others)
        named = "; ".join(cell.setting for cell, gain in others if gain >= CLAIMED_FACTOR)
        where = f" ({named})" if 0 < holds < len(others) else ""
        settings = _format_count(len(others), "other setting" if len(others) < len(cell_gains) else "setting")
        claim.append(
            f"In {settings} its network's is {_format_gains(others, 'linear')}; the claim holds in {holds}{where}."
        )
    return " ".join(claim)


def _qualify_training(trained: float) -> str:
    """Qualify results of networks that had only a share of their training."""
    return f" It had {trained:.0%} of its training at most: where the claim fails, that decides nothing." * (
        trained < 1
    )


def _assess_base_setting(cell: SettingResult, gain: float, trained: float) -> str:
    """Assess the claim in the setting in which the thesis makes it."""
    share = f" with {trained:.0%} of its training" if trained < 1 else ""
    holds = "the claim holds" if gain >= CLAIMED_FACTOR else "the claim fails"
    error = format_comparison(gain, "linear")
    return f"In the thesis' own setting ({cell.setting}) its network's{share} is {error}: {holds}."


def _compare_splines(here: list[SettingResult]) -> str:
    """Compare splines with the network of the thesis."""
    net_gains = compute_gains(here, (THESIS_NET,), "linear")
    spline_gains = compute_gains(here, SPLINES, "linear")
    if not net_gains or not spline_gains:
        return ""
    better = {cell.setting: gain for cell, gain in spline_gains}
    beaten = [cell.setting for cell, gain in net_gains if gain > better.get(cell.setting, 0.0)]
    text = (
        f"A spline, which learns nothing, does at least as well as that network in {len(net_gains) - len(beaten)} of "
    )
    but = f", but not with {'; '.join(beaten)}" if beaten else ""
    return f"{text}{_format_count(len(net_gains), 'setting')}{but}."


def _format_count(number: int, what: str) -> str:
    """Format a number of things."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def _describe_constraint_net(here: list[SettingResult]) -> str:
    """Describe the errors of ConstraintNet."""
    net_gains = compute_gains(here, (THESIS_NET,), CONSTRAINT_NET)
    constraint_gains = compute_gains(here, (CONSTRAINT_NET,), "linear")
    if not constraint_gains:
        return ""
    text = f"ConstraintNet's error is {_format_gains(constraint_gains, 'linear')}"
    if net_gains:
        text += f"; that of the thesis' network is {_format_gains(net_gains, CONSTRAINT_NET)}"
    pretrained_gains = compute_gains(here, (PRETRAINED_NET,), "linear")
    if pretrained_gains:
        text += (
            f"; pretrained on simulated scenes as in its paper, its own is {_format_gains(pretrained_gains, 'linear')}"
        )
    return text + "."


def _describe_physics_fit(here: list[SettingResult]) -> str:
    """Describe the errors of the physics fit."""
    physics_gains = compute_gains(here, (PHYSICS_NAME,), "cubic")
    if not physics_gains:
        return ""
    first = sum(
        find_best_method(cell, cell.mse) == find_best_method(cell, (PHYSICS_NAME,)) for cell, _ in physics_gains
    )
    return (
        f"The error of the fit of the physics itself is {_format_gains(physics_gains, 'cubic')}; it is the best of all "
        f"methods in {first} of {len(physics_gains)}."
    )


def _format_gains(cell_gains: list[tuple[SettingResult, float]], rival: str) -> str:
    """Format the gains over a rival of all settings."""
    values = [gain for _, gain in cell_gains]
    if len(values) == 1:
        return format_comparison(values[0], rival)
    span = f"from {_format_range_end(min(values))} to {_format_range_end(max(values))}"
    return f"{format_comparison(median(values), rival)} in the median setting ({span})"
