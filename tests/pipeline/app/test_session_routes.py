"""Commands on several shots, as the page starts them."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from support.app_requests import Visitor, write_run
from support.carom_start import Home

from pipeline.cli.execute import execute_command_line


def start(visitor: Visitor, names: Sequence[str], **body: object) -> tuple[int, dict[str, Any]]:
    shots = [visitor.library.identify(visitor.library.root / name) for name in names]
    reply = visitor.ask("POST", "api/sessions", {"shots": shots, **body})
    return reply.status, reply.document


def test_a_comparison_is_the_command_and_becomes_a_card(
    home: Home, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("one", "two"):
        shutil.copytree(home.out, tmp_path / name)
    visitor = Visitor(tmp_path)
    commands: list[tuple[str, list[str], Path]] = []

    def add_command(*given: Any) -> dict[str, Any]:
        commands.append(given)
        return {"id": "1"}

    monkeypatch.setattr(visitor.queue, "add_command", add_command)
    assert start(visitor, ("one", "two"), action="compare", group="ball") == (200, {"job": {"id": "1"}})
    ((name, arguments, folder),) = commands
    assert (name, folder.parent) == ("Comparison of 2 shots", tmp_path / "sessions")
    assert arguments == ["compare", str(tmp_path / "one"), str(tmp_path / "two"), "--group", "ball", "-o", str(folder)]
    assert execute_command_line(arguments) == 0
    (card,) = (one for one in visitor.library.list_cards() if one.kind == "session")
    assert card.name == f"Comparison 1 ({date.today().isoformat()})"
    start(visitor, ("one",), action="certify")
    assert commands[1][2] != folder


@pytest.mark.parametrize(
    ("body", "status", "sentence"),
    [
        ({"action": "delete"}, 422, "action is one of compare, certify, diagnose."), ({}, 422, "action is one of"),
        ({"action": "compare", "shots": []}, 422, "Choose at least one shot."),
        ({"action": "compare", "shots": ["../../etc"]}, 404, "There is no such shot"),
        ({"action": "diagnose", "simulator": "os:system"}, 422, "simulator is one of pooltool."),
        ({"action": "compare", "group": ["ball"]}, 422, "group is one of"),
    ],
)  # fmt: skip
def test_what_no_command_does_is_refused(body: dict[str, Any], status: int, sentence: str, tmp_path: Path) -> None:
    write_run(tmp_path / "one")
    visitor = Visitor(tmp_path)
    found, refusal = start(visitor, ("one",), **body)
    assert (found, sentence in refusal["error"]) == (status, True)
    assert not (tmp_path / "sessions").exists()
