"""What the tables say, in plain words: where the thesis' claims hold, and where a spline does as well."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from statistics import median

import numpy as np

from pipeline.thesis.methods import CONSTRAINT_NET, PHYSICS_NAME, SPLINES, THESIS_NET
from pipeline.thesis.series import Case
from pipeline.thesis.trials import Trial

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
    """px^2 by method, the median over the seeds."""
    seeds: int

    @property
    def setting(self) -> str:
        return f"{self.variant}, {self.fps:.3g} Hz, noise {self.noise:g} px"


def cells(trials: Iterable[Trial]) -> list[Cell]:
    """Medians over seeds, in the order in which settings first come."""
    found: dict[tuple[str, str, float, float], dict[str, list[float]]] = {}
    for trial in trials:
        case: Case = trial.case
        setting = (case.scene, case.variant, case.fps, case.noise)
        found.setdefault(setting, {}).setdefault(trial.method, []).append(trial.mse)
    return [
        Cell(*setting, {name: float(median(values)) for name, values in methods.items()},
             max(map(len, methods.values())))
        for setting, methods in found.items()
    ]  # fmt: skip


def sentences(scene: str, found: list[Cell], trained: float = 1.0) -> list[str]:
    """What the cells of one scene show; networks had the share `trained` of their training."""
    here = [cell for cell in found if cell.scene == scene]
    if not here:
        return []
    claim = _thesis(scene, here)
    if claim and trained < 1:
        claim += f" With {trained:.0%} of its training that decides nothing about the claim."
    said = [claim, _splines(here), _constraint(here), _physics(here)]
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


def best(cell: Cell, names: Iterable[str]) -> tuple[str, float] | None:
    """The best of some methods in a cell."""
    there = [(name, cell.mse[name]) for name in names if name in cell.mse]
    return min(there, key=lambda pair: pair[1]) if there else None


def gains(here: list[Cell], names: Iterable[str], rival: str) -> list[tuple[Cell, float]]:
    """How many times lower than `rival` the best of `names` is, in every cell that has both."""
    wanted = tuple(names)
    pairs = [(cell, best(cell, wanted)) for cell in here if rival in cell.mse]
    return [(cell, cell.mse[rival] / max(one[1], 1e-300)) for cell, one in pairs if one is not None]


def _thesis(scene: str, here: list[Cell]) -> str:
    found = gains(here, (THESIS_NET,), "linear")
    if not found:
        return ""
    values = np.array([gain for _, gain in found])
    own = f"Its network's is {_all(found, 'linear')}"
    if scene == "boxes":
        alike = int(np.sum((values > 1 / ALIKE) & (values < ALIKE)))
        return (
            f"The thesis claims an error comparable to linear. {own}: within a factor of {ALIKE:g} of linear in "
            f"{alike} of {len(values)} settings."
        )
    holds = int(np.sum(values >= CLAIMED))
    where = "; ".join(cell.setting for cell, gain in found if gain >= CLAIMED)
    return (
        f"The thesis claims an error {CLAIMED:g} times lower than linear. {own}; the claim holds in {holds} of "
        f"{len(values)} settings{f' ({where})' if 0 < holds < len(values) else ''}."
    )


def _splines(here: list[Cell]) -> str:
    pairs = [(best(cell, (THESIS_NET,)), best(cell, SPLINES)) for cell in here]
    there = [(net, spline) for net, spline in pairs if net and spline]
    if not there:
        return ""
    better = sum(spline[1] <= net[1] for net, spline in there)
    return (
        f"A spline, which learns nothing, does at least as well as that network in {better} of {len(there)} settings."
    )


def _constraint(here: list[Cell]) -> str:
    found = gains(here, (THESIS_NET,), CONSTRAINT_NET)
    own = gains(here, (CONSTRAINT_NET,), "linear")
    if not own:
        return ""
    text = f"ConstraintNet's error is {_all(own, 'linear')}"
    if found:
        text += f"; that of the thesis' network is {_all(found, CONSTRAINT_NET)}"
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
    span = f"from {factor(min(values))} to {factor(max(values))}"
    return f"{compared(median(values), rival)} in the median setting ({span})"
