"""The notebooks run from top to bottom, as a reader runs them."""

from __future__ import annotations

import os
import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
CELL_SECONDS = 300


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_with_its_outputs_which_every_web_page_shows(path: Path) -> None:
    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in cells), "run .ci/fill_notebooks.py"
    outputs = [output for cell in cells for output in cell.outputs]
    assert outputs
    for data in (output.data for output in outputs if "data" in output):
        assert set(data) <= {"text/plain", "image/png"}
        assert len(data.get("image/png", "")) < 400_000  # 300 kB of base64
    figures = [cell for cell in cells if cell.source.endswith("\nfigure")]
    assert all("image/png" in cell.outputs[-1].data for cell in figures)


def test_every_notebook_begins_with_the_command_that_opens_it() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for path in NOTEBOOKS:
        (command,) = re.findall(r"run `make ([a-z-]+)`, which", nbformat.read(path, as_version=4).cells[0].source)
        assert f"\n{command}: " in makefile


def needs_extra(path: Path) -> bool:
    """Return whether a notebook needs more than `make run` installs; `test_commands` runs the others."""
    return any("import mujoco" in cell.source for cell in nbformat.read(path, as_version=4).cells)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the notebook libraries themselves
@pytest.mark.slow
@pytest.mark.parametrize("path", [path for path in NOTEBOOKS if needs_extra(path)], ids=lambda path: path.stem)
def test_a_notebook_with_an_extra_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco", reason="mujoco is an extra")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setenv("TRUEROLL_CACHE", str(tmp_path / "cache"))
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(notebook, timeout=CELL_SECONDS, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
    assert all(cell.execution_count for cell in notebook.cells if cell.cell_type == "code")
