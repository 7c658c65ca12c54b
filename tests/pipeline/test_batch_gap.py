"""Shots of one table are diagnosed together, and no others."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from pipeline.actions.diagnose_batch import diagnose_tables, tables_of
from pipeline.batch.clip_job import Row

GREEN, GREENER, BLUE = (40.0, -30.0, 20.0), (44.0, -33.0, 22.0), (35.0, 5.0, -45.0)


def ran(out: Path, name: str, cloth: tuple[float, ...] | None, light: str = "green", length: float = 2.54) -> Row:
    folder = out / name
    folder.mkdir(parents=True)
    table = {"name": "pool-9ft", "length": length, "width": length / 2, "cloth_lab": cloth}
    (folder / "scene.json").write_text(json.dumps({"table": table, "ball_radius": 0.028575}))
    return Row(f"{name}.mp4", "done", light, 1, 1.0, str(folder), "")


def test_tables_are_told_by_size_and_cloth_and_the_untrusted_are_left_out(tmp_path: Path) -> None:
    rows = [
        ran(tmp_path, "a", GREEN), ran(tmp_path, "b", GREENER), ran(tmp_path, "c", BLUE),
        ran(tmp_path, "d", GREEN, light="red"), ran(tmp_path, "e", GREEN, length=2.24), ran(tmp_path, "f", None),
        Row("g.mp4", "failed", "", 0, 0.0, "", "no table"),
    ]  # fmt: skip
    tables = tables_of(rows)
    assert [{folder.name for folder in table.folders} for table in tables] == [{"a", "b", "f"}, {"c"}, {"e"}]
    assert len({table.name for table in tables}) == 3


def test_shots_of_a_recording_go_to_the_tables_that_they_show(tmp_path: Path) -> None:
    row = ran(tmp_path, "match", GREEN)
    for k, cloth in enumerate((GREEN, BLUE, GREEN)):
        ran(tmp_path / "match", f"shot-{k + 1:03d}", cloth)
    scene = json.loads((tmp_path / "match" / "scene.json").read_text())
    scene["shots"] = [{"folder": f"shot-{k + 1:03d}", "trust": "green"} for k in range(3)]
    (tmp_path / "match" / "scene.json").write_text(json.dumps(scene))
    tables = tables_of([replace(row, in_shots=True, shots=3)])
    assert [[folder.name for folder in table.folders] for table in tables] == [["shot-001", "shot-003"], ["shot-002"]]


def test_a_table_that_cannot_be_diagnosed_is_a_sentence_and_stops_no_other(tmp_path: Path) -> None:
    tables = tables_of([ran(tmp_path, "a", GREEN), ran(tmp_path, "b", BLUE)])
    said = list(diagnose_tables(tables, tmp_path / "out", Console(quiet=True)))
    assert [table.name for table, _ in said] == [table.name for table in tables]
    assert all(sentence.count("\n") == 0 and "tracks.csv" in sentence for _, sentence in said)
    assert not list((tmp_path / "out").rglob("gap.json"))


@pytest.mark.parametrize("name", ["../../up", "a/b", ""])
def test_a_name_of_a_table_leads_nowhere_else(tmp_path: Path, name: str) -> None:
    row = ran(tmp_path, "a", GREEN)
    path = tmp_path / "a" / "scene.json"
    scene = json.loads(path.read_text())
    scene["table"]["name"] = name
    path.write_text(json.dumps(scene))
    (table,) = tables_of([row])
    assert "/" not in table.name
    assert ".." not in table.name
