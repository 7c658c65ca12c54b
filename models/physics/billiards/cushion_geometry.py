"""What stands around the cloth: noses of the cushions, jaws of the pockets, and the holes that balls drop into.

A ball turns where its centre is one radius from the nose. On a table with pockets every nose ends in a jaw: an arc that
is tangent to the nose, then a straight facing that runs into the pocket. A ball drops once its centre passes the edge
of the slate, a circle.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from models.core.scene import CUSHIONS, POCKETS, Table
from models.core.typing import FloatArray

NORMALS = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
"""(4, 2) into the cushions, in the order of `CUSHIONS`."""
FACING = 0.12
"""m, how far a facing runs into the pocket."""


@dataclass(frozen=True, slots=True)
class Mouth:
    """One kind of pocket: lengths in m for balls of `ball_radius`, in proportion for others."""

    gap: float
    """Between the two points where nose and facing would meet if they were sharp."""
    turn: float
    """Degrees by which the facing turns away from the nose."""
    jaw: float
    """Radius of the arc between the two."""
    shelf: float
    """From the middle of that gap to the edge of the slate."""
    hole: float
    """Radius of the circle of that edge."""


@dataclass(frozen=True, slots=True)
class Pockets:
    """Corner and middle pockets of one game."""

    ball_radius: float
    corner: Mouth
    middle: Mouth


POOL = Pockets(0.028575, Mouth(0.1159, 38.0, 0.003, 0.038, 0.057), Mouth(0.1286, 76.0, 0.003, 0.005, 0.060))
"""WPA equipment specifications, section 9: mouths 4.5 to 4.625 and 5 to 5.125 in, cut angles 142 and 104 degrees,
shelves 1 to 2.25 and 0 to 0.375 in; the holes are as wide as their castings."""
SNOOKER = Pockets(0.02625, Mouth(0.0860, 42.0, 0.070, 0.045, 0.045), Mouth(0.0960, 70.0, 0.050, 0.020, 0.045))
"""Round jaws. The WPBSA's templates are not published: 3 3/8 in between the facings of a corner, the usual figure of
makers, and radii estimates."""


@dataclass(frozen=True, slots=True)
class Rails:
    """The table as contacts see it; sides are indices of `CUSHIONS`."""

    lines: FloatArray
    """(L, 6) noses and facings: nx, ny into the cushion, c = n . x on the nose (m), the part of t = (-ny, nx) . x that
    exists from and to (m), side."""
    arcs: FloatArray
    """(A, 4) jaws: centre, radius (m), side."""
    holes: FloatArray
    """(H, 3) centre, radius (m), in the order of `POCKETS`."""


def rails(table: Table, offsets: FloatArray | None = None) -> Rails:
    """The rails of a table, each nose moved outwards by its offset (4,) in m, in the order of `CUSHIONS`."""
    return _moved(table, (0.0,) * len(CUSHIONS) if offsets is None else tuple(offsets.tolist()))


@lru_cache(maxsize=256)
def _moved(table: Table, offsets: tuple[float, ...]) -> Rails:
    moved = np.array(offsets)
    size = np.array([table.length, table.width])
    nose = np.array([0.0, table.length, 0.0, table.width])
    inward = np.sign(NORMALS.sum(axis=1))
    at = nose * inward + moved  # n . x on each nose
    if not table.pockets:
        lines = [[*NORMALS[side], at[side], -np.inf, np.inf, side] for side in range(len(CUSHIONS))]
        return Rails(np.array(lines), np.empty((0, 4)), np.empty((0, 3)))
    return _with_pockets(table, size, moved)


def _with_pockets(table: Table, size: FloatArray, moved: FloatArray) -> Rails:
    kind = SNOOKER if table.game == "snooker" else POOL
    scale = table.ball_radius / kind.ball_radius
    lines: list[list[float]] = []
    arcs: list[list[float]] = []
    for side, ends in enumerate(_noses(size, kind, scale)):
        shift = NORMALS[side] * moved[side]
        for begin, begin_mouth, end, end_mouth in ends:
            along = (end - begin) / np.linalg.norm(end - begin)
            cut = [scale * m.jaw * np.tan(np.radians(m.turn) / 2) for m in (begin_mouth, end_mouth)]
            first, last = begin + cut[0] * along + shift, end - cut[1] * along + shift
            lines.append(_line(NORMALS[side], first, last, side))
            for place, way, mouth in ((first, -along, begin_mouth), (last, along, end_mouth)):
                arc, facing = _jaw(place, way, mouth, scale, side)
                arcs.append(arc)
                lines.append(facing)
    return Rails(np.array(lines), np.array(arcs), _holes(table, kind, scale))


def _noses(size: FloatArray, kind: Pockets, scale: float) -> list[list[tuple[FloatArray, Mouth, FloatArray, Mouth]]]:
    """Per side, the noses between the sharp points of two mouths."""
    length, width = size
    corner, middle = scale * kind.corner.gap / np.sqrt(2), scale * kind.middle.gap / 2
    tips = []
    for side in range(4):
        fixed = (0.0, length, 0.0, width)[side]
        if side < 2:
            spans = [(corner, kind.corner, width - corner, kind.corner)]
        else:
            spans = [
                (corner, kind.corner, length / 2 - middle, kind.middle),
                (length / 2 + middle, kind.middle, length - corner, kind.corner),
            ]
        turned = [
            (np.array([fixed, a]), m, np.array([fixed, b]), n) if side < 2 else
            (np.array([a, fixed]), m, np.array([b, fixed]), n) for a, m, b, n in spans
        ]  # fmt: skip
        tips.append(turned)
    return tips


def _line(inward: FloatArray, first: FloatArray, last: FloatArray, side: int) -> list[float]:
    across = np.array([-inward[1], inward[0]])
    low, high = sorted((float(across @ first), float(across @ last)))
    return [float(inward[0]), float(inward[1]), float(inward @ first), low, high, side]


def _jaw(place: FloatArray, way: FloatArray, mouth: Mouth, scale: float, side: int) -> tuple[list[float], list[float]]:
    """The arc that begins at `place`, where a nose ends that goes in direction `way`, and the facing behind it."""
    radius, angle = scale * mouth.jaw, np.radians(mouth.turn)
    centre = place + radius * NORMALS[side]
    inward = np.cos(angle) * NORMALS[side] - np.sin(angle) * way
    onward = np.cos(angle) * way + np.sin(angle) * NORMALS[side]
    first = centre - radius * inward
    return [*map(float, centre), radius, side], _line(inward, first, first + FACING * onward, side)


def _holes(table: Table, kind: Pockets, scale: float) -> FloatArray:
    found = []
    middle_of_table = np.array([table.length, table.width]) / 2
    for name, place in zip(POCKETS, table.pocket_centres, strict=True):
        corner = "-" in name
        mouth = kind.corner if corner else kind.middle
        inward = np.sign(middle_of_table - place) * (1.0 if corner else np.array([0.0, 1.0]))
        inward = inward / np.linalg.norm(inward)
        depth = (mouth.shelf + mouth.hole - (mouth.gap / 2 if corner else 0.0)) * scale
        found.append([*(place - depth * inward), mouth.hole * scale])
    return np.array(found)
