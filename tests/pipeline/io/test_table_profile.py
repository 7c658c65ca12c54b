"""A table profile, from the file of a diagnosis to the prior of a fit."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.diagnosis_reports import TABLE, make_report, make_strength

from models.core.errors import OptionError
from pipeline.io.gap_files import PROFILE_FILE, write_profile_files
from pipeline.io.table_profile import parse_table_prior, read_profile_text
from pipeline.run_options import RunOptions, build_options, format_changed_settings, list_settings


def write_profile(folder: Path) -> Path:
    report = make_report(
        make_strength("rolling_resistance.mu", 0.008, 0.0001), make_strength("slope.slope_x", 1.5, 0.1, "mm/m"),
        make_strength("lens_distortion.k1", 0.02), forms=("han_2005", "inelastic"),
    )  # fmt: skip
    write_profile_files(report, TABLE, folder)
    return folder / PROFILE_FILE


def test_what_a_diagnosis_wrote_is_what_a_fit_starts_from(tmp_path: Path) -> None:
    table = parse_table_prior(read_profile_text(write_profile(tmp_path)))
    assert (table.laws.cushion, table.laws.ball) == ("han_2005", "inelastic")
    priors = {prior.name: (prior.value, prior.sigma) for prior in table.priors}
    assert priors["slope.slope_x"] == (1.5, 0.1)
    assert priors["rolling_resistance.mu"] == (0.008, 0.0001)
    assert "lens_distortion.k1" not in priors


def test_options_hold_the_content_so_that_another_content_is_noticed(tmp_path: Path) -> None:
    path = write_profile(tmp_path)
    usual = {name: setting.default for name, setting in list_settings().items()}
    first = build_options(usual | {"profile": str(path)})
    assert format_changed_settings(first) == ("--profile",)
    content = json.loads(path.read_text())
    content["effects"]["slope"]["slope_x"]["value"] = 2.5
    path.write_text(json.dumps(content))
    assert build_options(usual | {"profile": str(path)}) != first
    assert build_options(usual | {"profile": first.fit.profile}) == first
    assert build_options(usual) == RunOptions()


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
        read_profile_text(path)


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="trueroll diagnose"):
        read_profile_text(tmp_path / "nothing.json")


def test_the_fit_of_whole_shots_is_off_unless_it_is_asked_for() -> None:
    usual = {name: setting.default for name, setting in list_settings().items()}
    for value, words in ((False, ()), (True, ("--laws",))):
        options = build_options(usual | {"laws": value})
        assert options.fit.laws is value
        assert format_changed_settings(options) == words
