"""The table as a viewer of the clip sees it: which rail is far, near, left or right, and which way up a plan lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.scene import CUSHIONS, POCKETS, Camera, Table
from models.core.typing import FloatArray

# Names of `CUSHIONS` after 0 to 3 quarter turns of the plan, clockwise.
_TURNED_RAILS = (
    ("left", "right", "far", "near"), ("far", "near", "right", "left"),
    ("right", "left", "near", "far"), ("near", "far", "left", "right"),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class TableView:
    """Orientation of a table in the frame."""

    turns: int = 0
    """Quarter turns, clockwise, from the plan of table coordinates (x right, y down) to the frame; 0 to 3."""

    def __post_init__(self) -> None:
        if self.turns not in range(4):
            raise ValueError(f"a view has 0 to 3 quarter turns; got {self.turns}")

    def name_rail(self, cushion: str) -> str:
        """Name a cushion as a viewer sees it.

        Args:
            cushion: One of `CUSHIONS`.

        Returns:
            `left`, `right`, `far` (at the top of the frame) or `near` (at its bottom).
        """
        return _TURNED_RAILS[self.turns][CUSHIONS.index(cushion)]

    def name_pocket(self, pocket: str) -> str:
        """Name a pocket as a viewer sees it.

        Args:
            pocket: One of `POCKETS`.

        Returns:
            Such as `far-left` for a corner, `far-side` for the pocket in the middle of a long rail.
        """
        rails = [self.name_rail(name) for name in pocket.split("-")]
        if len(rails) == 1:
            return f"{rails[0]}-side"
        return "-".join(sorted(rails, key=("far", "near", "left", "right").index))

    @property
    def pockets(self) -> dict[str, str]:
        """The pocket by its name in the frame."""
        return {self.name_pocket(name): name for name in POCKETS}

    def is_long(self, cushion: str) -> bool:
        """Return whether a cushion is a long one."""
        return cushion in ("top", "bottom")

    def find_size(self, table: Table) -> tuple[float, float]:
        """Find width and height, m, of a table as the frame shows it."""
        return (table.length, table.width) if self.turns % 2 == 0 else (table.width, table.length)

    def turn_points(self, xy: FloatArray, table: Table) -> FloatArray:
        """Turn points of the table to a plan that lies as in the frame.

        Args:
            xy: Points (..., 2), m.

        Returns:
            Points (..., 2), m: first coordinate to the right, second downwards, both from the corner at the top left
            of the turned plan.
        """
        x, y = xy[..., 0], xy[..., 1]
        turned = (
            (x, y), (table.width - y, x), (table.length - x, table.width - y), (y, table.length - x)
        )[self.turns]  # fmt: skip
        return np.stack(turned, axis=-1)


def find_table_view(camera: Camera, table: Table) -> TableView:
    """Find how a table lies in the frame.

    Args:
        camera: The calibrated camera.

    Returns:
        The quarter turn that agrees best with the directions of the middles of the rails from the middle of the table.
    """
    corners = table.corners
    middles = (corners[[0, 1, 0, 3]] + corners[[3, 2, 1, 2]]) / 2  # in the order of CUSHIONS
    px = camera.to_pixels(np.vstack([middles, corners.mean(axis=0)]), table.ball_radius)
    away = px[:4] - px[4]
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
    directions = {"left": (-1.0, 0.0), "right": (1.0, 0.0), "far": (0.0, -1.0), "near": (0.0, 1.0)}
    agreement = [
        sum(float(away[k] @ np.array(directions[name])) for k, name in enumerate(names)) for names in _TURNED_RAILS
    ]
    return TableView(int(np.argmax(agreement)))
