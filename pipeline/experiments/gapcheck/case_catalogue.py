"""All kinds of case of the blind check."""

from __future__ import annotations

from pipeline.experiments.gapcheck.billiards_cases import BILLIARDS_KINDS, BilliardsKind
from pipeline.experiments.gapcheck.body_cases import BODY_KINDS, DRIVEN_KINDS, MUJOCO_KINDS, WALL_KINDS, BodyKind

# A simulated world, the effects that act there, and those that the user's simulator has.
CaseKind = BodyKind | BilliardsKind
KINDS: tuple[CaseKind, ...] = (*BODY_KINDS, *MUJOCO_KINDS, *WALL_KINDS, *DRIVEN_KINDS, *BILLIARDS_KINDS)

_RARE_KINDS = (*WALL_KINDS, *DRIVEN_KINDS, *BILLIARDS_KINDS)
_DEFAULT_TABLES = ("nothing missing", "slope", "cushion law", "slope and lens distortion", "sticky patch")
# Kinds that are checked by default: no walls and no inputs, and one table for each kind of question, as a table takes a
# minute.
DEFAULT_KINDS: tuple[CaseKind, ...] = tuple(
    kind for kind in KINDS if kind not in _RARE_KINDS or kind.name in [f"billiards, {one}" for one in _DEFAULT_TABLES]
)
