"""Geometry around the cloth: noses of the cushions, jaws of the pockets, and the holes that balls drop into.

The path of a ball turns where its centre is one radius from the nose. On a table with pockets every nose ends in a jaw:
an arc that is tangent to the nose, then a straight facing that runs into the pocket. A ball drops when its centre
passes the edge of the slate, a circle.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from models.core.scene import CUSHIONS, POCKETS, Table
from models.core.typing import FloatArray

# (4, 2) unit normals into the cushions, in the order of `CUSHIONS`.
CUSHION_NORMALS = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
# m, length of a facing into the pocket.
FACING_LENGTH = 0.12


@dataclass(frozen=True, slots=True)
class PocketMouth:
    """Shape of one kind of pocket: lengths in m for balls of `ball_radius`, in proportion for others."""

    width: float
    """Between the two points where nose and facing would meet if they were sharp."""
    facing_angle: float
    """Degrees by which the facing turns away from the nose."""
    jaw_radius: float
    """Radius of the arc between the two."""
    shelf_depth: float
    """From the middle of that gap to the edge of the slate."""
    hole_radius: float
    """Radius of the circle of that edge."""


@dataclass(frozen=True, slots=True)
class PocketGeometry:
    """Corner and middle pockets of one game."""

    ball_radius: float
    corner: PocketMouth
    middle: PocketMouth


# WPA equipment specifications, section 9: mouths 4.5 to 4.625 and 5 to 5.125 in, cut angles 142 and 104 degrees,
# shelves 1 to 2.25 and 0 to 0.375 in; the holes are as wide as their castings.
POOL_POCKETS = PocketGeometry(
    0.028575, PocketMouth(0.1159, 38.0, 0.003, 0.038, 0.057), PocketMouth(0.1286, 76.0, 0.003, 0.005, 0.060)
)
# Round jaws. The templates of the WPBSA are not published: 3 3/8 in between the facings of a corner is the usual figure
# of makers; the radii are estimates.
SNOOKER_POCKETS = PocketGeometry(
    0.02625, PocketMouth(0.0860, 42.0, 0.070, 0.045, 0.045), PocketMouth(0.0960, 70.0, 0.050, 0.020, 0.045)
)


@dataclass(frozen=True, slots=True)
class Rails:
    """Parts of the table that balls can touch; sides are indices of `CUSHIONS`."""

    lines: FloatArray
    """(L, 6) noses and facings: nx, ny into the cushion, c = n . x on the nose (m), the part of t = (-ny, nx) . x that
    exists from and to (m), side."""
    arcs: FloatArray
    """(A, 4) jaws: centre, radius (m), side."""
    holes: FloatArray
    """(H, 3) centre, radius (m), in the order of `POCKETS`."""


@dataclass(frozen=True, slots=True)
class MouthLine:
    """Line between the two noses of a pocket."""

    middle: FloatArray
    """(2,) m, its middle."""
    outward: FloatArray
    """(2,) unit vector from the table into the pocket: the centre line of the pocket."""
    ends: FloatArray
    """(2, 2) m, the two noses."""

    def measure_gap(self, places: FloatArray) -> FloatArray:
        """Measure how far places (n, 2) m are from the line, m: negative where they are between the noses and beyond.

        Args:
            places: NaN for none.

        Returns:
            The distances (n,).
        """
        along = np.diff(self.ends, axis=0)[0]
        depth = (places - self.middle) @ self.outward
        beside = np.abs((places - self.middle) @ along) / np.hypot(*along) - np.hypot(*along) / 2
        return np.asarray(np.where(beside > 0, np.hypot(beside, depth), -depth))


def find_mouth_line(table: Table, pocket: str) -> MouthLine:
    """Find the line that a ball must cross to fall into a pocket.

    Args:
        table: Table with pockets.
        pocket: One of `POCKETS`.

    Returns:
        The line, square to the centre line of the pocket.
    """
    kind = _select_pockets(table)
    place = table.pocket_centres[POCKETS.index(pocket)]
    inward = np.sign(np.array([table.length, table.width]) / 2 - place)
    inward = inward / np.linalg.norm(inward)
    is_corner = "-" in pocket
    half = table.ball_radius / kind.ball_radius * (kind.corner if is_corner else kind.middle).width / 2
    place = place + half * is_corner * inward
    to_nose = half * np.array([-inward[1], inward[0]])
    return MouthLine(place, -inward, np.stack([place - to_nose, place + to_nose]))


def build_rails(table: Table, offsets: FloatArray | None = None) -> Rails:
    """Build the rails of a table.

    Args:
        table: Size, game and pockets.
        offsets: (4,) m, outward offset of each nose in the order of `CUSHIONS`; None for none.

    Returns:
        The rails.
    """
    return _build_offset_rails(table, (0.0,) * len(CUSHIONS) if offsets is None else tuple(offsets.tolist()))


@lru_cache(maxsize=256)
def _build_offset_rails(table: Table, offsets: tuple[float, ...]) -> Rails:
    """Build the rails of a table whose noses have outward offsets, m."""
    moved = np.array(offsets)
    size = np.array([table.length, table.width])
    nose = np.array([0.0, table.length, 0.0, table.width])
    inward = np.sign(CUSHION_NORMALS.sum(axis=1))
    at = nose * inward + moved  # n . x on each nose
    if not table.pockets:
        lines = [[*CUSHION_NORMALS[side], at[side], -np.inf, np.inf, side] for side in range(len(CUSHIONS))]
        return Rails(np.array(lines), np.empty((0, 4)), np.empty((0, 3)))
    return _build_pocket_rails(table, size, moved)


def _build_pocket_rails(table: Table, size: FloatArray, moved: FloatArray) -> Rails:
    kind = _select_pockets(table)
    scale = table.ball_radius / kind.ball_radius
    lines: list[list[float]] = []
    arcs: list[list[float]] = []
    for side, ends in enumerate(_find_nose_ends(size, kind, scale)):
        shift = CUSHION_NORMALS[side] * moved[side]
        for begin, begin_mouth, end, end_mouth in ends:
            along = (end - begin) / np.linalg.norm(end - begin)
            cut = [scale * m.jaw_radius * np.tan(np.radians(m.facing_angle) / 2) for m in (begin_mouth, end_mouth)]
            first, last = begin + cut[0] * along + shift, end - cut[1] * along + shift
            lines.append(_build_line(CUSHION_NORMALS[side], first, last, side))
            for place, way, mouth in ((first, -along, begin_mouth), (last, along, end_mouth)):
                arc, facing = _build_jaw(place, way, mouth, scale, side)
                arcs.append(arc)
                lines.append(facing)
    return Rails(np.array(lines), np.array(arcs), _build_holes(table, kind, scale))


def _select_pockets(table: Table) -> PocketGeometry:
    return SNOOKER_POCKETS if table.game == "snooker" else POOL_POCKETS


def _find_nose_ends(
    size: FloatArray, kind: PocketGeometry, scale: float
) -> list[list[tuple[FloatArray, PocketMouth, FloatArray, PocketMouth]]]:
    """Find for each side the ends of its noses and the mouths there.

    The ends are where nose and facing would meet if they were sharp.
    """
    length, width = size
    corner, middle = scale * kind.corner.width / np.sqrt(2), scale * kind.middle.width / 2
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


def _build_line(inward: FloatArray, first: FloatArray, last: FloatArray, side: int) -> list[float]:
    """Build the line of a nose or facing from its first to its last point."""
    across = np.array([-inward[1], inward[0]])
    low, high = sorted((float(across @ first), float(across @ last)))
    return [float(inward[0]), float(inward[1]), float(inward @ first), low, high, side]


def _build_jaw(
    place: FloatArray, way: FloatArray, mouth: PocketMouth, scale: float, side: int
) -> tuple[list[float], list[float]]:
    """Build the arc of a jaw and the facing behind it.

    The nose ends at `place` and goes in direction `way`.
    """
    radius, angle = scale * mouth.jaw_radius, np.radians(mouth.facing_angle)
    centre = place + radius * CUSHION_NORMALS[side]
    inward = np.cos(angle) * CUSHION_NORMALS[side] - np.sin(angle) * way
    onward = np.cos(angle) * way + np.sin(angle) * CUSHION_NORMALS[side]
    first = centre - radius * inward
    return [*map(float, centre), radius, side], _build_line(inward, first, first + FACING_LENGTH * onward, side)


def _build_holes(table: Table, kind: PocketGeometry, scale: float) -> FloatArray:
    """Build the circles (H, 3) of the pockets."""
    holes = []
    middle_of_table = np.array([table.length, table.width]) / 2
    for name, place in zip(POCKETS, table.pocket_centres, strict=True):
        corner = "-" in name
        mouth = kind.corner if corner else kind.middle
        inward = np.sign(middle_of_table - place) * (1.0 if corner else np.array([0.0, 1.0]))
        inward = inward / np.linalg.norm(inward)
        depth = (mouth.shelf_depth + mouth.hole_radius - (mouth.width / 2 if corner else 0.0)) * scale
        holes.append([*(place - depth * inward), mouth.hole_radius * scale])
    return np.array(holes)
