"""What the tables say, in plain words: where the thesis' claims hold, and where a spline does as well."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from statistics import median

from pipeline.experiments.thesis.compared_methods import CONSTRAINT_NET, PHYSICS_NAME, SPLINES, TAUGHT, THESIS_NET
from pipeline.experiments.thesis.experiment_plan import BASE, FIRST_VARIANT
from pipeline.experiments.thesis.trials import Trial

CLAIMED = 100.0
"""times lower than linear and than ConstraintNet: the abstract of Chen 2022, figure 6."""
MOST_TOLD = 1e6
"""a factor above which only rounding is compared."""
EVEN = 0.95
"""within this factor an error is another one's."""
ALIKE = 2.0
"""within this factor two errors are called the same."""


@dataclass(frozen=True, slots=True)
class Cell:
    """All seeds of one setting."""

    scene: str
    variant: str
    fps: float
    noise: float
    mse: dict[str, float]
    """px^2 by method: linear's median over the seeds, times the median of a method's shares of linear's with the same
    seed, so that methods with fewer seeds are judged by those that they had."""
    seeds: int

    @property
    def setting(self) -> str:
        return f"{self.variant}, {self.fps:.3g} Hz, noise {self.noise:g} px"

    @property
    def is_own(self) -> bool:
        """Whether this is the setting of the thesis."""
        return FIRST_VARIANT.get(self.scene) == self.variant and (self.fps, self.noise) == BASE


def setting_of(trial: Trial) -> tuple[str, str, float, float]:
    """What trials of a cell have in common."""
    case = trial.case
    return case.scene, case.variant, case.fps, case.noise


def cells(trials: Iterable[Trial]) -> list[Cell]:
    """Medians over seeds, in the order in which settings first come."""
    found: dict[tuple[str, str, float, float], dict[str, dict[int, float]]] = {}
    for trial in trials:
        by_method = found.setdefault(setting_of(trial), {})
        by_method.setdefault(trial.method, {})[trial.case.seed] = trial.mse
    return [Cell(*setting, _medians(methods), max(map(len, methods.values()))) for setting, methods in found.items()]


def _medians(methods: dict[str, dict[int, float]]) -> dict[str, float]:
    linear = methods["linear"]
    usual = median(linear.values())
    return {
        name: usual * median(mse / linear[seed] for seed, mse in by_seed.items()) for name, by_seed in methods.items()
    }


def sentences(scene: str, found: list[Cell], trained: float = 1.0) -> list[str]:
    """What the cells of one scene show; networks had the share `trained` of their training."""
    here = [cell for cell in found if cell.scene == scene]
    if not here:
        return []
    claim = _likeness(here) if scene == "boxes" else _thesis(here, trained)
    said = [claim + _short(trained) if claim else "", _splines(here), _constraint(here), _physics(here)]
    return [sentence for sentence in said if sentence]


def times(gain: float) -> str:
    """A factor with two or three digits that are worth reading."""
    if gain >= MOST_TOLD:
        return f"over {MOST_TOLD:,.0f}"
    return f"{gain:,.0f}" if gain >= 100 else f"{gain:.2g}"


def factor(gain: float) -> str:
    """How many times lower an error is, or higher."""
    return f"{times(gain)} times lower" if gain >= 1 else f"{times(1 / max(gain, 1e-300))} times higher"


def compared(gain: float, rival: str) -> str:
    """An error beside a rival's."""
    return f"that of {rival}" if EVEN < gain < 1 / EVEN else f"{factor(gain)} than {rival}"


def _span(gain: float) -> str:
    """An end of a range of factors."""
    return "as high" if EVEN < gain < 1 / EVEN else factor(gain)


def best(cell: Cell, names: Iterable[str]) -> tuple[str, float] | None:
    """The best of some methods in a cell."""
    there = [(name, cell.mse[name]) for name in names if name in cell.mse]
    return min(there, key=lambda pair: pair[1]) if there else None


def gains(here: list[Cell], names: Iterable[str], rival: str) -> list[tuple[Cell, float]]:
    """How many times lower than `rival` the best of `names` is, in every cell that has both."""
    wanted = tuple(names)
    pairs = [(cell, best(cell, wanted)) for cell in here if rival in cell.mse]
    return [(cell, cell.mse[rival] / max(one[1], 1e-300)) for cell, one in pairs if one is not None]


def _likeness(here: list[Cell]) -> str:
    """What the thesis claims of boxes."""
    found = gains(here, (THESIS_NET,), "linear")
    if not found:
        return ""
    alike = sum(1 / ALIKE < gain < ALIKE for _, gain in found)
    return (
        f"The thesis claims an error comparable to linear. Its network's is {_all(found, 'linear')}: within a factor "
        f"of {ALIKE:g} of linear in {alike} of {_count(len(found), 'setting')}."
    )


def _thesis(here: list[Cell], trained: float) -> str:
    """What the thesis claims of pendulums."""
    found = gains(here, (THESIS_NET,), "linear")
    if not found:
        return ""
    said = [f"The thesis claims an error {CLAIMED:g} times lower than linear."]
    said += [_own_claim(cell, gain, trained) for cell, gain in found if cell.is_own]
    others = [(cell, gain) for cell, gain in found if not cell.is_own]
    if others:
        holds = sum(gain >= CLAIMED for _, gain in others)
        named = "; ".join(cell.setting for cell, gain in others if gain >= CLAIMED)
        where = f" ({named})" if 0 < holds < len(others) else ""
        said.append(
            f"In {_count(len(others), 'other setting' if len(others) < len(found) else 'setting')} its network's is "
            f"{_all(others, 'linear')}; the claim holds in {holds}{where}."
        )
    return " ".join(said)


def _short(trained: float) -> str:
    """A reservation for networks that had a share of their training."""
    return f" It had {trained:.0%} of its training at most: where the claim fails, that decides nothing." * (
        trained < 1
    )


def _own_claim(cell: Cell, gain: float, trained: float) -> str:
    """Whether the claim holds in the setting in which it is made."""
    share = f" with {trained:.0%} of its training" if trained < 1 else ""
    holds = "the claim holds" if gain >= CLAIMED else "the claim fails"
    return f"In the thesis' own setting ({cell.setting}) its network's{share} is {compared(gain, 'linear')}: {holds}."


def _splines(here: list[Cell]) -> str:
    found = gains(here, (THESIS_NET,), "linear")
    splines = gains(here, SPLINES, "linear")
    if not found or not splines:
        return ""
    better = {cell.setting: gain for cell, gain in splines}
    beaten = [cell.setting for cell, gain in found if gain > better.get(cell.setting, 0.0)]
    text = f"A spline, which learns nothing, does at least as well as that network in {len(found) - len(beaten)} of "
    but = f", but not with {'; '.join(beaten)}" if beaten else ""
    return f"{text}{_count(len(found), 'setting')}{but}."


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _constraint(here: list[Cell]) -> str:
    found = gains(here, (THESIS_NET,), CONSTRAINT_NET)
    own = gains(here, (CONSTRAINT_NET,), "linear")
    if not own:
        return ""
    text = f"ConstraintNet's error is {_all(own, 'linear')}"
    if found:
        text += f"; that of the thesis' network is {_all(found, CONSTRAINT_NET)}"
    taught = gains(here, (TAUGHT,), "linear")
    if taught:
        text += f"; taught from simulated scenes as its authors do, its own is {_all(taught, 'linear')}"
    return text + "."


def _physics(here: list[Cell]) -> str:
    found = gains(here, (PHYSICS_NAME,), "cubic")
    if not found:
        return ""
    first = sum(best(cell, cell.mse) == best(cell, (PHYSICS_NAME,)) for cell, _ in found)
    return (
        f"The error of the fit of the physics itself is {_all(found, 'cubic')}; it is the best of all methods in "
        f"{first} of {len(found)}."
    )


def _all(found: list[tuple[Cell, float]], rival: str) -> str:
    """The gains over a rival of all settings as words."""
    values = [gain for _, gain in found]
    if len(values) == 1:
        return compared(values[0], rival)
    span = f"from {_span(min(values))} to {_span(max(values))}"
    return f"{compared(median(values), rival)} in the median setting ({span})"
