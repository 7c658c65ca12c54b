"""A table profile, from the file that a diagnosis wrote to what a fit starts from."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from test_gap_cure import TABLE, of, told

from models.core.errors import OptionError
from pipeline.io.profile_export import PROFILE, write_cure
from pipeline.io.table_profile import profile_text, table_of
from pipeline.options import RunOptions, collect, run_settings, told_apart


def written(folder: Path) -> Path:
    report = told(
        of("rolling_resistance.mu", 0.008, 0.0001), of("slope.slope_x", 1.5, 0.1, "mm/m"),
        of("lens_distortion.k1", 0.02), forms=("han_2005", "inelastic"),
    )  # fmt: skip
    write_cure(report, TABLE, folder)
    return folder / PROFILE


def test_what_a_diagnosis_wrote_is_what_a_fit_starts_from(tmp_path: Path) -> None:
    table = table_of(profile_text(written(tmp_path)))
    assert (table.laws.cushion, table.laws.ball) == ("han_2005", "inelastic")
    known = {prior.name: (prior.value, prior.sigma) for prior in table.priors}
    assert known["slope.slope_x"] == (1.5, 0.1)
    assert known["rolling_resistance.mu"] == (0.008, 0.0001)
    assert "lens_distortion.k1" not in known


def test_options_hold_the_content_so_that_another_content_is_noticed(tmp_path: Path) -> None:
    path = written(tmp_path)
    usual = {name: setting.default for name, setting in run_settings().items()}
    first = collect(usual | {"profile": str(path)})
    assert told_apart(first) == ("--profile",)
    content = json.loads(path.read_text())
    content["effects"]["slope"]["slope_x"]["value"] = 2.5
    path.write_text(json.dumps(content))
    assert collect(usual | {"profile": str(path)}) != first
    assert collect(usual | {"profile": first.fit.profile}) == first
    assert collect(usual) == RunOptions()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "--profile"),
        ('{"effects": {"gravity": {"g": {"value": 1}}}}', "gravity"),
        ('{"effects": {"slope": {"slope_x": {"value": 900}}}}', "between"),
        ('{"effects": {}, "laws": {"cushion": "bouncy"}}', "mirror"),
    ],
)
def test_a_file_that_is_no_profile_is_refused_in_a_sentence(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "other.json"
    path.write_text(content)
    with pytest.raises(OptionError, match=words):
        profile_text(path)


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="trueroll diagnose"):
        profile_text(tmp_path / "nothing.json")
