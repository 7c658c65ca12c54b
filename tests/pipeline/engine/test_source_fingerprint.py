"""The hashes of a stage change with every edit of code that it uses, and with no other edit."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

import pytest

from pipeline.engine.source_fingerprint import PACKAGES, ROOT, hash_sources, library_versions


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """Write a small project: two stages, a helper three imports deep, a catalogue of effects, a font."""
    return write_files(
        tmp_path,
        {
            "pipeline/__init__.py": "",
            "pipeline/fit.py": "from models.first import one\n",
            "pipeline/render.py": "def run():\n    import models.drawing.pen\n",
            "models/__init__.py": "",
            "models/first.py": "import numpy\nfrom models import second\n",
            "models/second.py": "from models.third import three\nfrom models.catalogue import ALL\n",
            "models/third.py": "three = 3\n",
            "models/unused.py": "nothing = None\n",
            "models/catalogue.py": 'ALL = discover_modules("models.effects")\n',
            "models/effects/__init__.py": "",
            "models/effects/slope.py": "class Slope: ...\n",
            "models/drawing/__init__.py": "",
            "models/drawing/pen.py": "FONT = 'fonts/Plain.ttf'\n",
            "models/drawing/paper.py": "white = 255\n",
            "models/drawing/fonts/Plain.ttf": "letters",
        },
    )


def write_files(folder: Path, files: Mapping[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


def edit(path: Path, text: str) -> None:
    """Change a file but not its modification time."""
    before = path.stat()
    path.write_text(text)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def test_a_helper_three_imports_deep_counts_for_the_stage_that_uses_it(project: Path) -> None:
    fit, render = (hash_sources(f"pipeline.{name}", project) for name in ("fit", "render"))
    edit(project / "models/third.py", "three = 4\n")
    after = hash_sources("pipeline.fit", project)
    assert {name for name in fit if fit[name] != after[name]} == {"models/third.py"}
    assert hash_sources("pipeline.render", project) == render


def test_a_module_that_is_not_imported_does_not_count(project: Path) -> None:
    assert "models/unused.py" not in hash_sources("pipeline.fit", project)


def test_an_import_inside_a_function_counts(project: Path) -> None:
    assert "models/drawing/pen.py" in hash_sources("pipeline.render", project)


def test_a_font_counts_for_the_module_that_names_it(project: Path) -> None:
    assert "models/drawing/fonts/Plain.ttf" not in hash_sources("models.drawing.paper", project)
    assert "models/drawing/fonts/Plain.ttf" in hash_sources("pipeline.render", project)
    assert "models/drawing/fonts/Plain.ttf" not in hash_sources("pipeline.fit", project)


def test_a_file_in_a_docstring_does_not_count(project: Path) -> None:
    edit(project / "models/drawing/paper.py", '"""Fonts are in fonts/."""\nwhite = 255\n')
    assert "models/drawing/fonts/Plain.ttf" not in hash_sources("models.drawing.paper", project)


def test_a_new_effect_file_counts(project: Path) -> None:
    before = hash_sources("pipeline.fit", project)
    (project / "models/effects/nap.py").write_text("class Nap: ...\n")
    assert hash_sources("pipeline.fit", project).keys() - before.keys() == {"models/effects/nap.py"}


def test_a_new_import_counts_at_once(project: Path) -> None:
    hash_sources("pipeline.fit", project)
    edit(project / "models/third.py", "import models.unused\n")
    assert "models/unused.py" in hash_sources("pipeline.fit", project)


def test_the_fit_does_not_depend_on_drawing_and_the_drawing_depends_on_its_fonts() -> None:
    fit, render = hash_sources("pipeline.stages.explain_stage"), hash_sources("pipeline.stages.render_stage")
    assert not [name for name in fit if name.startswith(("video/", "detectors/"))]
    assert [name for name in render if name.endswith(".ttf")]
    assert not [name for name in render if name.startswith("detectors/")]


def test_every_library_that_computes_has_a_version() -> None:
    libraries = {"torch", "opencv-python-headless", "onnxruntime", "numpy", "av", "scipy", "numba", "scikit-image"}
    assert libraries == library_versions().keys()


def test_every_font_template_and_network_counts_for_a_stage() -> None:
    stages = [path.stem for path in (ROOT / "pipeline" / "stages").glob("[a-z]*.py")]
    counted = {name for stage in stages for name in hash_sources(f"pipeline.stages.{stage}")}
    packages = ("pipeline", "detectors", "video", "models")
    kinds = (".ttf", ".html", ".css", ".js", ".onnx")
    data = {str(p.relative_to(ROOT)) for package in packages for p in (ROOT / package).rglob("*") if p.suffix in kinds}
    data = {name for name in data if not name.startswith("pipeline/app/page/")}  # shown by no stage
    assert data
    assert data <= counted


def test_the_page_of_the_report_does_not_make_the_detection_stale() -> None:
    assert (ROOT / "pipeline/reporting/pages/templates/report.html").is_file()
    assert "pipeline/reporting/pages/templates/report.html" not in hash_sources("pipeline.stages.detect_stage")


def test_foreign_modules_beside_the_packages_of_a_wheel_do_not_count(project: Path) -> None:
    before = hash_sources("pipeline.fit", project)
    write_files(project, dict.fromkeys(("numpy/__init__.py", "numpy/linalg.py", "six.py", "stages/__init__.py"), ""))
    edit(project / "models/third.py", "import numpy.linalg\nimport six\nimport stages\nthree = 3\n")
    after = hash_sources("pipeline.fit", project)
    assert after.keys() == before.keys()
    assert {name for name in before if before[name] != after[name]} == {"models/third.py"}


def test_an_installed_copy_hashes_only_the_packages_of_the_project(tmp_path: Path) -> None:
    """Lay the packages out as a wheel does, beside foreign modules that they import."""
    site = tmp_path / "site-packages"
    for package in PACKAGES:
        shutil.copytree(ROOT / package, site / package, ignore=shutil.ignore_patterns("__pycache__"))
    write_files(site, {f"{name}/__init__.py": "" for name in ("numpy", "cv2", "scipy", "rich")} | {"six.py": ""})
    stages = ("read", "calibrate", "detect", "track", "explain", "laws", "render", "record", "report", "export")
    for stage in stages:
        module = f"pipeline.stages.{stage}_stage"
        assert hash_sources(module, site) == hash_sources(module)
        assert {name.split("/")[0] for name in hash_sources(module, site)} <= set(PACKAGES)
