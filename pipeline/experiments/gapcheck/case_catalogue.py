"""All kinds of case of the blind check."""

from __future__ import annotations

from pipeline.experiments.gapcheck.billiards_cases import BILLIARDS
from pipeline.experiments.gapcheck.body_cases import BODIES, BY_MUJOCO
from pipeline.experiments.gapcheck.case_kind import Kind

KINDS: tuple[Kind, ...] = (*BODIES, *BY_MUJOCO, *BILLIARDS)

_OF_TABLES = ("nothing missing", "slope", "cushion law", "slope and lens distortion", "sticky patch")
USUAL: tuple[Kind, ...] = tuple(
    kind for kind in KINDS if kind not in BILLIARDS or kind.name in [f"billiards, {one}" for one in _OF_TABLES]
)
"""Those that are checked where nobody says which: of tables one of each question, for a table takes a minute."""
