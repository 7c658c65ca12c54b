"""Run the notebooks and store them with their outputs, figures as pictures that every web page of a notebook shows.

    python .ci/fill_notebooks.py [NAME...]

Needs the packages of the tests and chromedriver.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
FIGURE = "application/vnd.plotly.v1+json"
SIZE = {"format": "png", "width": 720, "height": 400, "scale": 1}
DRAW = """
const [figure, size, done] = arguments;
Plotly.toImage({ data: figure.data, layout: figure.layout }, size).then((uri) => done(uri.split(",")[1]));"""


def fill_notebook(path: Path) -> None:
    """Run a notebook in a folder of its own, and write it back with outputs."""
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "sample_videos").mkdir()
        shutil.copy(ROOT / "sample_videos" / "overhead_pool.mp4", Path(folder) / "sample_videos")
        NotebookClient(notebook, timeout=900, resources={"metadata": {"path": folder}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    draw_figures([output.data for output in outputs if FIGURE in output.get("data", {})])
    for cell in notebook.cells:
        cell.metadata.clear()  # times of execution
        cell["outputs"] = [one for one in cell.get("outputs", []) if one.get("name") != "stderr"]
        if cell.cell_type != "code":
            del cell["outputs"]
    notebook.metadata["language_info"] = {"name": "python"}
    nbformat.write(notebook, path)


def draw_figures(bundles: list[dict[str, object]]) -> None:
    """Replace figures that need a script by their pictures."""
    from plotly.offline import get_plotlyjs
    from support.browser import open_chromium

    if not bundles:
        return
    with open_chromium() as browser:
        browser.execute_script(get_plotlyjs())
        for bundle in bundles:
            figure = bundle[FIGURE]
            bundle.clear()
            bundle["image/png"] = browser.execute_async_script(DRAW, figure, SIZE)


if __name__ == "__main__":
    os.environ["PYTHONPATH"] = str(ROOT)
    for path in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")):
        if not sys.argv[1:] or path.stem in sys.argv[1:]:
            fill_notebook(path)
