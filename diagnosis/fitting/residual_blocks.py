"""Groups of observations in which something systematic would show: by shot, body, phase, place, speed, time, picture.

Two kinds of sums are taken: the mean of what a fit leaves, along and across the motion and by coordinate, in each
group; and how much of it varies slowly within windows. Both are compared with noise that went through the same fit, so
that how much a fit can absorb, and that groups overlap, is allowed for; the largest of all gives one p-value.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from diagnosis.fitting.fit_residuals import DRAWS, Residuals
from diagnosis.fitting.names import group
from models.core.typing import BoolArray, FloatArray

_LEAST = 8
"""observations of a group."""
_ABSORBED = 0.1
"""share of a sum of noise that a fit must leave for the sum to say anything."""
_BINS = 5
_GRID = 3
_WAVES = 5
"""half periods in a window, up to which what is left counts as slow."""


@dataclass(frozen=True, slots=True)
class Block:
    """A group of observations that share something."""

    family: str
    """shot, body, phase, speed, direction, place, time, since_contact, radius, row, slow."""
    label: str
    """which member of the family; of slow ones the group that varies so, in words."""
    here: BoolArray
    """(K,)"""


@dataclass(frozen=True, slots=True)
class Finding:
    """What stands out most."""

    block: Block
    direction: str
    """along, across, a coordinate's number, or `waves` for what varies slowly."""
    z: float
    """standard deviations of chance."""


@dataclass(frozen=True, slots=True)
class Structure:
    """Whether anything systematic is left, and where it stands out."""

    p_value: float
    """chance that the largest of all groups would be as large without a cause."""
    findings: tuple[Finding, ...]
    """the largest per family, largest first."""


def structure(found: Residuals) -> Structure:
    """The largest group mean of what a fit left, against chance."""
    named, sums, drawn = [], [], []
    groups = list(blocks(found))
    for block in groups:
        for direction, unit in _directions(found):
            weight = unit[block.here]
            chance = np.tensordot(weight, found.drawn[block.here], axes=2)
            if chance.std() < _ABSORBED * np.linalg.norm(weight):
                continue
            named.append((block, direction))
            sums.append(float((weight * found.left[block.here]).sum()))
            drawn.append(chance)
    for block, energy, chance in _slow(found, groups):
        named.append((block, "waves"))
        sums.append(energy)
        drawn.append(chance)
    return _judged(named, np.array(sums), np.array(drawn))


def _judged(named: list[tuple[Block, str]], sums: FloatArray, drawn: FloatArray) -> Structure:
    if not len(sums):
        return Structure(1.0, ())
    spread = np.maximum(drawn.std(axis=1), 1e-12)
    middle = np.where([direction == "waves" for _, direction in named], drawn.mean(axis=1), 0.0)
    z, chance = (sums - middle) / spread, (drawn - middle[:, None]) / spread[:, None]
    one_sided = np.array([direction == "waves" for _, direction in named])
    z = np.where(one_sided, z, np.abs(z))
    largest = np.where(one_sided[:, None], chance, np.abs(chance)).max(axis=0)
    best: dict[str, Finding] = {}
    for k in np.argsort(-z):
        block, direction = named[k]
        best.setdefault(block.family, Finding(block, direction, float(z[k])))
    return Structure(_p_value(float(z.max()), largest), tuple(best.values()))


def _p_value(largest: float, chance: FloatArray) -> float:
    """From the draws where they reach, beyond them by the normal tail of as many groups as they act like."""
    counted = (1 + int((chance >= largest).sum())) / (1 + len(chance))
    alike = np.log(0.5) / np.log1p(-2 * norm.sf(float(np.median(chance))))
    beyond = -np.expm1(alike * np.log1p(-min(2 * float(norm.sf(largest)), 1 - 1e-16)))
    return float(counted if counted > 5 / len(chance) else min(counted, beyond))


def _directions(found: Residuals) -> Iterator[tuple[str, FloatArray]]:
    """(K, D) unit vectors."""
    count, coordinates = found.left.shape
    speed = found.speed[:, None]
    along = np.where(speed > 0, found.velocity / np.maximum(speed, 1e-12), 0.0)
    yield "along", along
    if coordinates == 2:
        yield "across", np.stack([-along[:, 1], along[:, 0]], axis=1)
    for axis in range(coordinates):
        yield str(axis), np.broadcast_to(np.eye(coordinates)[axis], (count, coordinates))


def blocks(found: Residuals) -> Iterator[Block]:
    """All groups with enough observations and not everything in them."""
    count = len(found.left)
    for block in _all_blocks(found):
        if block.here.sum() >= _LEAST and (block.family == "all" or block.here.sum() < count):
            yield block


def _all_blocks(found: Residuals) -> Iterator[Block]:
    yield Block("all", "all", np.ones(len(found.left), bool))
    for family, values in (("shot", found.shot), ("body", found.body), ("phase", found.phase)):
        yield from (Block(family, str(value), values == value) for value in np.unique(values))
    yield from _binned("time", found.t)
    yield from _binned("speed", found.speed)
    yield from _binned("since_contact", found.since_contact)
    if found.left.shape[1] == 2:
        heading = np.arctan2(found.velocity[:, 1], found.velocity[:, 0])
        sector = np.round(heading / (np.pi / 4)).astype(int) % 8
        yield from (Block("direction", f"{45 * k} degrees", sector == k) for k in range(8))
        yield from _placed(found.place)
    if found.image is not None:
        yield from _binned("radius", np.linalg.norm(found.image, axis=1))
        yield from _binned("row", found.image[:, 1])


def _binned(family: str, values: FloatArray) -> Iterator[Block]:
    """Groups of as many observations each, by a number."""
    known = np.isfinite(values)
    if known.sum() < _BINS * _LEAST or np.ptp(values[known]) == 0:
        return
    edges = np.quantile(values[known], np.linspace(0, 1, _BINS + 1))
    for k in range(_BINS):
        here = known & (values >= edges[k]) & ((values < edges[k + 1]) | (k == _BINS - 1))
        yield Block(family, f"{edges[k]:.3g} to {edges[k + 1]:.3g}", here)


def _placed(place: FloatArray) -> Iterator[Block]:
    """Groups by place on a grid over where bodies were."""
    low, high = np.quantile(place, 0.01, axis=0), np.quantile(place, 0.99, axis=0)
    cell = np.clip(((place - low) / np.maximum(high - low, 1e-12) * _GRID).astype(int), 0, _GRID - 1)
    for i in range(_GRID):
        for j in range(_GRID):
            middle = low + (np.array([i, j]) + 0.5) / _GRID * (high - low)
            label = f"({middle[0]:.2f}, {middle[1]:.2f})"
            yield Block("place", label, (cell[:, 0] == i) & (cell[:, 1] == j))


def _slow(found: Residuals, groups: list[Block]) -> Iterator[tuple[Block, float, FloatArray]]:
    """Per shot, body and altogether: the energy of slow waves in what is left, and of noise (DRAWS,).

    As its cube root: an energy of few waves is far from normal, its cube root is nearly so (Wilson, Hilferty 1931).
    """
    energy: dict[str, tuple[Block, float, FloatArray]] = {}
    wanted = [block for block in groups if block.family in ("all", "shot", "body", "phase")]
    for window in np.unique(found.window):
        for body in np.unique(found.body[found.window == window]):
            own = np.flatnonzero((found.window == window) & (found.body == body))
            if len(own) < 2 * _WAVES:
                continue
            waves = np.cos(np.pi * np.outer(np.arange(_WAVES), (np.arange(len(own)) + 0.5) / len(own)))
            one = float(np.square(waves @ found.left[own]).sum()) / len(own)
            chance = np.square(np.tensordot(waves, found.drawn[own], axes=1)).sum(axis=(0, 1)) / len(own)
            for block in wanted:
                if block.here[own].mean() > 0.5:
                    slow = Block("slow", group(block.family, block.label), block.here)
                    before = energy.get(block.family + block.label, (slow, 0.0, np.zeros(DRAWS)))
                    energy[block.family + block.label] = (slow, before[1] + one, before[2] + chance)
    yield from ((block, float(np.cbrt(one)), np.cbrt(chance)) for block, one, chance in energy.values())
