"""Figures carry their noise, and a page whose figures moved beyond it is rewritten and reported."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.support import figures
from benchmarks.support.figures import (
    Figure,
    compare_figures,
    estimate_count,
    estimate_median,
    estimate_rms,
    estimate_share,
    format_block,
    parse_figures,
    state_cost,
    state_exact,
)
from benchmarks.update_figures import QuickRun, update_figures

ERROR = Figure("error", 0.5, 0.1, "ms", 20)
FOUND = Figure("found", 95.0, 9.0, "%", 20)


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """Make a README and a page with one table each; the first has a second reader."""
    (tmp_path / "docs").mkdir()
    accuracy = format_block("a.accuracy", [ERROR, FOUND], "seeds 0 to 19")
    cost = format_block("b.cost", [state_cost("run", 2.0, "s", 3)], "one clip", alone=True)
    (tmp_path / "README.md").write_text(f"# Project\n\n{accuracy}\n\nText.\n")
    (tmp_path / "docs" / "page.md").write_text(f"# Page\n\n{cost}\n\nBetween.\n\n{accuracy}\n\nEnd.\n")
    return tmp_path


def run_figures(*measured: Figure, seconds: float = 2.0) -> dict[str, QuickRun]:
    blocks = {
        "a.accuracy": format_block("a.accuracy", measured, "seeds 0 to 19"),
        "b.cost": format_block("b.cost", [state_cost("run", seconds, "s", 3)], "one clip", alone=True),
    }
    return {script: QuickRun(script, 0, f"log\n{block}\n", "", 1.0) for script, block in blocks.items()}


def test_a_figure_within_its_noise_passes_and_keeps_its_recorded_value(project: Path) -> None:
    before = (project / "README.md").read_text()
    assert update_figures(root=project, run=run_figures(Figure("error", 0.59, 0.12, "ms", 20), FOUND).__getitem__)
    assert (project / "README.md").read_text() == before
    measured = Figure("error", 0.59, 0.12, "ms", 20), Figure("found", 20.0, 5.0, "%", 30)
    assert not update_figures(root=project, run=run_figures(*measured).__getitem__)
    for page in (project / "README.md", project / "docs" / "page.md"):
        assert "| error | 0.500 | 0.10 | ms | 20 |\n| found | 20.0 | 5.0 | % | 30 |" in page.read_text()
    assert (project / "docs" / "page.md").read_text().endswith("<!-- /figures -->\n\nEnd.\n")


@pytest.mark.parametrize(
    "measured",
    [
        [Figure("error", 0.61, 0.1, "ms", 20), FOUND],
        [Figure("error", 0.39, 0.1, "ms", 20), FOUND],
        [Figure("error", np.nan, 0.1, "ms", 20), FOUND],
        [Figure("error", 0.5, 0.1, "s", 20), FOUND],
        [ERROR],
        [ERROR, FOUND, Figure("switches", 1.0, 1.0, "", 20)],
    ],
    ids=["worse", "better", "not a number", "another unit", "gone", "new"],
)
def test_a_figure_beyond_its_noise_is_reported_and_written(project: Path, measured: list[Figure]) -> None:
    assert not update_figures(root=project, run=run_figures(*measured).__getitem__)
    assert update_figures(["b.cost"], root=project, run=run_figures(*measured).__getitem__)
    assert parse_figures((project / "README.md").read_text()).keys() == {one.name for one in measured}
    moved = [one for one in measured if one not in (ERROR, FOUND)]
    assert all(
        format_block("a.accuracy", [one], "").splitlines()[5] in (project / "README.md").read_text() for one in moved
    )


def test_check_leaves_the_pages_as_they_are(project: Path) -> None:
    before = (project / "docs" / "page.md").read_text()
    assert not update_figures(root=project, check=True, run=run_figures(ERROR, FOUND, seconds=5.0).__getitem__)
    assert (project / "docs" / "page.md").read_text() == before


def test_a_script_that_fails_stops_nothing_and_keeps_its_table(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = run_figures(ERROR, FOUND, seconds=5.0)
    runs["a.accuracy"] = QuickRun("a.accuracy", 1, "", "ZeroDivisionError: a sentence", 1.0)
    before = (project / "README.md").read_text()
    assert not update_figures(root=project, run=runs.__getitem__)
    assert (project / "README.md").read_text() == before
    assert "| run | 5.00 | 5.0 | s | 3 |" in (project / "docs" / "page.md").read_text()
    assert "ZeroDivisionError: a sentence" in capsys.readouterr().out


def test_a_script_without_its_inputs_is_skipped(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = run_figures(ERROR, FOUND)
    runs["a.accuracy"] = QuickRun("a.accuracy", figures.SKIPPED, "a.accuracy is skipped: no footage\n", "", 1.0)
    assert update_figures(root=project, run=runs.__getitem__)
    assert "no footage" in capsys.readouterr().out


def test_pages_that_differ_are_an_error(project: Path) -> None:
    page = project / "docs" / "page.md"
    page.write_text(page.read_text().replace("0.500", "0.700"))
    with pytest.raises(ValueError, match=r"a\.accuracy needs one table"):
        figures.read_record("a.accuracy", project)


def test_noise_is_two_standard_errors() -> None:
    """Over many draws, the values of a figure spread by half its noise (Gaussian errors, fair coins)."""
    rng, n = np.random.default_rng(0), 20
    draws = rng.normal(size=(100, n))
    for estimate in (estimate_median, estimate_rms):
        drawn = [estimate("x", x, "") for x in draws]
        assert np.mean([f.noise for f in drawn]) == pytest.approx(2 * np.std([f.value for f in drawn]), rel=0.2)
    counts = [estimate_count("x", rng.poisson(2.0, n).tolist(), "") for _ in range(200)]
    assert np.mean([f.noise for f in counts]) == pytest.approx(2 * np.std([f.value for f in counts]), rel=0.2)
    shares = [estimate_share("x", int((x > 0).sum()), n) for x in draws]
    assert np.mean([f.noise for f in shares]) == pytest.approx(2 * np.std([f.value for f in shares]), rel=0.2)


def test_noise_that_cannot_be_estimated_is_an_error() -> None:
    with pytest.raises(ValueError, match="two cases"):
        estimate_median("x", [1.0], "")
    with pytest.raises(ValueError, match="all finite"):
        estimate_rms("x", [1.0, np.nan], "")
    assert estimate_share("x", 30, 30).noise > 0
    assert estimate_count("x", [0, 0, 0, 0], "").noise == 0.5


def test_an_exact_value_tolerates_its_rounding_alone() -> None:
    record = {"speed": state_exact("speed", 0.8114, "m/s")}
    assert not compare_figures(record, {"speed": state_exact("speed", 0.8116, "m/s")})
    assert compare_figures(record, {"speed": state_exact("speed", 0.8131, "m/s")})
