"""Diagnosis reports with chosen fitted parameters."""

from __future__ import annotations

from diagnosis.fitting.gap_closure import GapClosure
from diagnosis.verdicts.verdict import DiagnosisReport, Gap, Strength, Unexplained
from models.physics.billiards.tables import TABLE_PRESETS

NOTHING_UNEXPLAINED = Unexplained(0.0, 0.0, 1.0, (), "", None, None)
TABLE = TABLE_PRESETS["pool-9ft"]


def make_report(*fitted: Strength, forms: tuple[str, str] = ("mirror", "inelastic")) -> DiagnosisReport:
    """Make a diagnosis whose only content is the fitted parameters and the contact models."""
    nothing = GapClosure(0.0, 0.0, 0.0, float("nan"), (-1.0, 1.0), False)
    return DiagnosisReport(
        "billiards", ("sliding_friction",), "effects", ("slope",), (), (),
        Gap("rms_m", 0.85, (), nothing, (), (), ()),
        (), NOTHING_UNEXPLAINED, fitted, forms, (), (), "", 1.0, (),
    )  # fmt: skip


def make_strength(name: str, value: float, sigma: float = 0.1, unit: str = "1") -> Strength:
    """Make a fitted parameter."""
    return Strength(name, unit, value, sigma, 0.0)
