"""Shots of the same table are diagnosed together."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from pipeline.actions.diagnose_batch import diagnose_tables, group_by_table
from pipeline.batch.clip_job import ClipResult

GREEN, GREENER, BLUE = (40.0, -30.0, 20.0), (44.0, -33.0, 22.0), (35.0, 5.0, -45.0)


def build_result(
    out: Path, name: str, cloth: tuple[float, ...] | None, light: str = "green", length: float = 2.54
) -> ClipResult:
    folder = out / name
    folder.mkdir(parents=True)
    table = {"name": "pool-9ft", "length": length, "width": length / 2, "cloth_lab": cloth}
    (folder / "scene.json").write_text(json.dumps({"table": table, "ball_radius": 0.028575}))
    return ClipResult(f"{name}.mp4", "done", light, 1, 1.0, str(folder), "")


def test_tables_are_distinguished_by_size_and_cloth_without_untrusted_runs(tmp_path: Path) -> None:
    rows = [
        build_result(tmp_path, "a", GREEN), build_result(tmp_path, "b", GREENER), build_result(tmp_path, "c", BLUE),
        build_result(tmp_path, "d", GREEN, light="red"), build_result(tmp_path, "e", GREEN, length=2.24),
        build_result(tmp_path, "f", None),
        ClipResult("g.mp4", "failed", "", 0, 0.0, "", "no table"),
    ]  # fmt: skip
    tables = group_by_table(rows)
    assert [{folder.name for folder in table.folders} for table in tables] == [{"a", "b", "f"}, {"c"}, {"e"}]
    assert len({table.name for table in tables}) == 3


def test_shots_of_a_recording_go_to_the_tables_that_they_show(tmp_path: Path) -> None:
    row = build_result(tmp_path, "match", GREEN)
    for k, cloth in enumerate((GREEN, BLUE, GREEN)):
        build_result(tmp_path / "match", f"shot-{k + 1:03d}", cloth)
    scene = json.loads((tmp_path / "match" / "scene.json").read_text())
    scene["shots"] = [{"folder": f"shot-{k + 1:03d}", "trust": "green"} for k in range(3)]
    (tmp_path / "match" / "scene.json").write_text(json.dumps(scene))
    tables = group_by_table([replace(row, in_shots=True, shots=3)])
    assert [[folder.name for folder in table.folders] for table in tables] == [["shot-001", "shot-003"], ["shot-002"]]


def test_a_table_that_cannot_be_diagnosed_gives_a_sentence_and_stops_no_other(tmp_path: Path) -> None:
    tables = group_by_table([build_result(tmp_path, "a", GREEN), build_result(tmp_path, "b", BLUE)])
    answers = list(diagnose_tables(tables, tmp_path / "out", Console(quiet=True)))
    assert [table.name for table, _ in answers] == [table.name for table in tables]
    assert all(sentence.count("\n") == 0 and "tracks.csv" in sentence for _, sentence in answers)
    assert not list((tmp_path / "out").rglob("gap.json"))


@pytest.mark.parametrize("name", ["../../up", "a/b", ""])
def test_the_name_of_a_table_cannot_lead_to_another_folder(tmp_path: Path, name: str) -> None:
    row = build_result(tmp_path, "a", GREEN)
    path = tmp_path / "a" / "scene.json"
    scene = json.loads(path.read_text())
    scene["table"]["name"] = name
    path.write_text(json.dumps(scene))
    (table,) = group_by_table([row])
    assert "/" not in table.name
    assert ".." not in table.name
