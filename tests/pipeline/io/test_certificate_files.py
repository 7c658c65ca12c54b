"""Comparison of two certificates: which numbers differ beyond their errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models.core.errors import OptionError
from pipeline.io.tables.certificate_files import SCHEMA, compare_certificates, read_certificate
from pipeline.reporting.pages.certificate_page import format_comparison, format_number


def make_certificate(**values: tuple[float | None, float | None]) -> dict[str, Any]:
    numbers = {name: {"value": v, "sigma": s, "unit": "", "count": 9} for name, (v, s) in values.items()}
    return {"schema": SCHEMA, "numbers": numbers}


def test_only_what_differs_by_far_more_than_its_error_differs() -> None:
    first = make_certificate(slope_x=(0.2, 0.1), restitution=(0.85, 0.003), roll_out=(24.0, 0.5))
    second = make_certificate(slope_x=(1.3, 0.1), restitution=(0.852, 0.003), roll_out=(24.9, 0.5))
    rows = {row.name: row for row in compare_certificates(first, second)}
    assert [name for name, row in rows.items() if row.differs] == ["slope_x"]
    assert rows["slope_x"].difference == pytest.approx(1.1)
    assert rows["slope_x"].sigma == pytest.approx(np.hypot(0.1, 0.1))
    sentence = format_comparison(tuple(rows.values()), "spring")
    assert (
        sentence == "Beyond their errors these numbers differ from spring: slope along the length (falls to the right)."
    )


def test_what_one_of_them_does_not_determine_is_not_compared() -> None:
    rows = compare_certificates(make_certificate(slope_x=(None, None)), make_certificate(slope_x=(1.3, 0.1)))
    assert rows == ()


def test_equal_tables_are_called_different_in_one_of_a_hundred_comparisons() -> None:
    rng, names = np.random.default_rng(4), [f"n{k}" for k in range(8)]
    alarms = 0
    for _ in range(3000):
        pair = [make_certificate(**{n: (float(rng.normal()), 1.0) for n in names}) for _ in range(2)]
        alarms += any(row.differs for row in compare_certificates(*pair))
    assert 0.005 < alarms / 3000 < 0.016


@pytest.mark.parametrize("content", ["no json", "{}", json.dumps({"schema": "trueroll.gap/1"}), json.dumps([1])])
def test_what_is_no_certificate_is_refused(tmp_path: Path, content: str) -> None:
    file = tmp_path / "other.json"
    file.write_text(content)
    with pytest.raises(OptionError, match="--compare wants a certificate"):
        read_certificate(file)


def test_numbers_have_as_many_digits_as_their_errors() -> None:
    assert format_number({"value": 0.858911, "sigma": 0.00083, "unit": ""}) == ("0.85891", "0.00083", "")
    assert format_number({"value": 33.6463, "sigma": 0.265, "unit": "m"}) == ("33.65", "0.27", "m")
    assert format_number({"value": None, "sigma": None, "unit": "m"})[0] == "not determined"
