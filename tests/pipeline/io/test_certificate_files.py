"""Comparison of two certificates: which numbers differ beyond their errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models.core.errors import OptionError
from models.physics.billiards.tables import TABLE_PRESETS
from pipeline.io.certificate_files import (
    SCHEMA,
    compare_certificates,
    describe_comparison,
    read_certificate,
)
from pipeline.reporting.pages.certificate_page import (
    build_slope_figure,
    format_certificate,
    format_comparison,
    format_number,
    format_too_few,
)


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
    assert sentence == "Beyond their errors these numbers differ from spring: slope along the length."


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
    assert format_number("restitution", {"value": 0.858911, "sigma": 0.00083, "unit": ""}) == ("0.8589", "0.0008", "")
    assert format_number("roll_out", {"value": 33.6463, "sigma": 0.265, "unit": "m"}) == ("33.65", "0.27", "m")


def test_what_is_not_determined_says_what_it_needs() -> None:
    nothing = {"value": None, "sigma": None, "unit": ""}
    assert format_number("restitution_left", nothing)[0] == "not determined: needs 3 contacts with it"
    assert "a contact with the left and one with the right cushion" in format_number("length", nothing)[0]
    assert format_number("roll_out", nothing)[0] == "not determined"


def test_the_direction_of_a_slope_is_a_word() -> None:
    assert format_number("slope_x", {"value": -0.69, "sigma": 0.09, "unit": "mm/m"})[0] == "0.69 to the left"
    assert format_number("slope_y", {"value": 0.69, "sigma": 0.09, "unit": "mm/m"})[0] == "0.69 to the bottom"
    assert format_number("slope_y", {"value": -0.001, "sigma": 0.09, "unit": "mm/m"})[0] == "0"


def test_a_scatter_has_no_direction() -> None:
    scatter = {"value": 0.12, "sigma": 0.05, "unit": "mm/m", "count": 1}
    assert format_number("", scatter) == ("0.12", "0.05", "mm/m")


@pytest.mark.parametrize(("shots", "contacts", "warns"), [(1, 5, True), (6, 12, True), (6, 40, False)])
def test_a_certificate_of_few_shots_warns(shots: int, contacts: int, warns: bool) -> None:
    document = {**make_certificate(slope_x=(None, None), slope_y=(None, None), restitution=(None, None),
                                   roll_out=(None, None)), "shots": shots, "cushion_contacts": contacts}  # fmt: skip
    assert ("6 shots with some 40 cushion contacts are advised" in format_too_few(document)) == warns
    assert format_certificate(document).startswith("1 shot with 5 cushion contacts" if shots == 1 else "6 shots")


@pytest.mark.parametrize(("slope", "label", "symbol"), [(0.69, "falls 0.69 mm/m", ["circle", "arrow"]),
                                                        (0.02, "level within its errors", "circle")])  # fmt: skip
def test_the_fall_is_an_arrow_that_ends_in_the_middle_of_its_errors(slope: float, label: str, symbol: Any) -> None:
    numbers = make_certificate(slope_x=(-slope, 0.09), slope_y=(0.0, 0.07))["numbers"]
    figure = build_slope_figure(numbers, (), TABLE_PRESETS["carom-match"])
    arrow = next(trace for trace in figure.data if trace.mode == "lines+markers")
    errors = next(trace for trace in figure.data if trace.fill == "toself")
    assert arrow.x[1] < arrow.x[0]
    assert (arrow.x[1], arrow.y[1]) == pytest.approx((np.mean(errors.x[:-1]), np.mean(errors.y[:-1])), abs=1e-9)
    assert np.array_equal(arrow.marker.symbol, symbol)
    assert figure.layout.annotations[0].text == label


def test_a_comparison_with_computed_numbers_is_json() -> None:
    computed = make_certificate(slope_x=(np.float64(1.3), np.float64(0.1)))
    (row,) = describe_comparison(compare_certificates(computed, make_certificate(slope_x=(0.1, 0.1))))
    assert json.loads(json.dumps(row))["differs"] is True


@pytest.mark.parametrize(
    ("shots", "contacts", "enough"), [(7, 45, True), (6, 40, True), (5, 45, False), (7, 35, False)]
)
def test_a_certificate_rests_on_six_shots_with_forty_contacts(shots: int, contacts: int, enough: bool) -> None:
    text = format_too_few({"shots": shots, "cushion_contacts": contacts})
    assert (text == "") == enough
