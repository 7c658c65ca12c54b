"""All kinds of case of the blind check."""

from __future__ import annotations

from pipeline.gapcheck.billiards_kinds import BILLIARDS
from pipeline.gapcheck.body_kinds import BODIES, BY_MUJOCO
from pipeline.gapcheck.kind import Kind

KINDS: tuple[Kind, ...] = (*BODIES, *BY_MUJOCO, *BILLIARDS)
