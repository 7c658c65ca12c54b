"""What code stands behind a stage: an edit anywhere below it shows, an edit beside it does not."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pipeline.engine.source_fingerprint import ROOT, library_versions, source_hashes


@pytest.fixture
def house(tmp_path: Path) -> Path:
    """A small project: a stage, a helper three imports deep, a catalogue of effects, a font."""
    files = {
        "stages/__init__.py": "",
        "stages/fit.py": "from rooms.first import one\n",
        "stages/render.py": "def run():\n    import rooms.drawing.pen\n",
        "rooms/__init__.py": "",
        "rooms/first.py": "import numpy\nfrom rooms import second\n",
        "rooms/second.py": "from rooms.third import three\nfrom rooms.effects.catalogue import ALL\n",
        "rooms/third.py": "three = 3\n",
        "rooms/beside.py": "nobody = None\n",
        "rooms/effects/__init__.py": "",
        "rooms/effects/catalogue.py": "from rooms.effects.slope import Slope\nALL = (Slope,)\n",
        "rooms/effects/slope.py": "class Slope: ...\n",
        "rooms/drawing/__init__.py": "",
        "rooms/drawing/pen.py": "FONT = 'fonts/Plain.ttf'\n",
        "rooms/drawing/paper.py": "white = 255\n",
        "rooms/drawing/fonts/Plain.ttf": "letters",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def edit(path: Path, text: str) -> None:
    """Change a file and hide it from whoever looks at times."""
    before = path.stat()
    path.write_text(text)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def test_a_helper_three_imports_deep_counts_for_the_stage_that_uses_it(house: Path) -> None:
    fit, render = (source_hashes(f"stages.{name}", house) for name in ("fit", "render"))
    edit(house / "rooms/third.py", "three = 4\n")
    after = source_hashes("stages.fit", house)
    assert {name for name in fit if fit[name] != after[name]} == {"rooms/third.py"}
    assert source_hashes("stages.render", house) == render


def test_what_nobody_imports_does_not_count(house: Path) -> None:
    assert "rooms/beside.py" not in source_hashes("stages.fit", house)


def test_an_import_inside_a_function_counts(house: Path) -> None:
    assert "rooms/drawing/pen.py" in source_hashes("stages.render", house)


def test_a_font_counts_for_the_module_that_names_it(house: Path) -> None:
    assert "rooms/drawing/fonts/Plain.ttf" not in source_hashes("rooms.drawing.paper", house)
    assert "rooms/drawing/fonts/Plain.ttf" in source_hashes("stages.render", house)
    assert "rooms/drawing/fonts/Plain.ttf" not in source_hashes("stages.fit", house)


def test_a_docstring_that_speaks_of_files_opens_none(house: Path) -> None:
    edit(house / "rooms/drawing/paper.py", '"""Fonts are in fonts/."""\nwhite = 255\n')
    assert "rooms/drawing/fonts/Plain.ttf" not in source_hashes("rooms.drawing.paper", house)


def test_a_new_effect_file_counts_before_the_catalogue_lists_it(house: Path) -> None:
    before = source_hashes("stages.fit", house)
    (house / "rooms/effects/nap.py").write_text("class Nap: ...\n")
    assert source_hashes("stages.fit", house).keys() - before.keys() == {"rooms/effects/nap.py"}


def test_a_new_import_counts_at_once(house: Path) -> None:
    source_hashes("stages.fit", house)
    edit(house / "rooms/third.py", "import rooms.beside\n")
    assert "rooms/beside.py" in source_hashes("stages.fit", house)


def test_the_fit_does_not_depend_on_drawing_and_the_drawing_depends_on_its_fonts() -> None:
    fit, render = source_hashes("pipeline.stages.fit_stage"), source_hashes("pipeline.stages.render_stage")
    assert not [name for name in fit if name.startswith(("video/", "detectors/"))]
    assert [name for name in render if name.endswith(".ttf")]
    assert not [name for name in render if name.startswith("detectors/")]


def test_every_library_that_computes_has_a_version() -> None:
    assert {"torch", "opencv-python-headless", "onnxruntime", "numpy", "av"} == library_versions().keys()


def test_every_font_template_and_network_counts_for_a_stage() -> None:
    stages = [path.stem for path in (ROOT / "pipeline" / "stages").glob("[a-z]*.py")]
    counted = {name for stage in stages for name in source_hashes(f"pipeline.stages.{stage}")}
    rooms = ("pipeline", "detectors", "video", "models")
    kinds = (".ttf", ".html", ".css", ".js", ".onnx")
    data = {str(p.relative_to(ROOT)) for room in rooms for p in (ROOT / room).rglob("*") if p.suffix in kinds}
    assert data
    assert data <= counted


def test_the_page_of_the_report_does_not_make_the_detection_stale() -> None:
    assert "pipeline/templates/report.html" not in source_hashes("pipeline.stages.detect_stage")
