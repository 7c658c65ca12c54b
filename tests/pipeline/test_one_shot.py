"""A run explains its shot once; answers about the run folder read it, and predictions use nothing later."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.carom_start import Home

import trueroll
from models.estimation.reconstruction import explain_shot
from pipeline.cli.execute import execute_command_line
from pipeline.io.saved_shot import publish_shot, read_shot, write_shot

ANSWERS = (
    ("call", "contact", "white", "yellow"), ("put-back",), ("compare",), ("what-if", "--speed", "+10%"),
    ("fit-table",), ("certify",),
)  # fmt: skip
"""Commands that are given a run folder; predictions explain the frames until their moment only."""


@pytest.mark.parametrize("command", ANSWERS, ids=lambda words: words[0])
def test_no_answer_about_a_run_folder_explains_the_shot_again(
    command: tuple[str, ...],
    home: Home,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    fits: list[object] = []
    original = explain_shot._explain_tracks

    def count(*arguments: object) -> object:
        fits.append(arguments)
        return original(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(explain_shot, "_explain_tracks", count)
    monkeypatch.setenv("TRUEROLL_CACHE", str(tmp_path / "cache"))
    folder = Path(shutil.copytree(home.out, tmp_path / "run"))
    word, *rest = command
    execute_command_line([word, str(folder), *rest, "-o", str(tmp_path / "answer")])
    assert not fits
    assert "Traceback" not in capsys.readouterr().err


def test_a_rail_is_hit_when_the_table_of_events_says_so(home: Home, tmp_path: Path) -> None:
    hit = next(row for row in home.rows("events.csv") if row["kind"] == "cushion")
    answer = trueroll.call(home.out, "rail", hit["a"], hit["b"], out=tmp_path)
    assert (answer.verdict, answer["time"].value) == ("yes", pytest.approx(float(hit["t"]), abs=1e-4))


def test_a_run_is_loaded_from_its_folder(home: Home) -> None:
    run = trueroll.load(home.out)
    assert np.round(run.events.t, 6) == pytest.approx(home.column("events.csv", "t"), abs=1e-6)
    assert run.trust.level == home.scene["trust"]["light"]
    assert len(run.to_arrow("tracks")) == len(home.rows("tracks.csv"))


@pytest.mark.slow
def test_contact_models_that_were_asked_for_are_loaded_and_used_by_what_if(own_home: Home, tmp_path: Path) -> None:
    done = own_home.trueroll("run", own_home.clip, "-o", own_home.out, "--no-video", "--laws")
    assert done.status == 0, done.err
    loaded = trueroll.load(own_home.out)
    assert loaded.laws is not None
    assert own_home.scene["laws"] is not None
    before = {path.name for path in (own_home.out / "shot" / "kept" / "entries").rglob("value.json")}
    done = own_home.trueroll("what-if", own_home.out, "--speed", "+10%", "-o", tmp_path / "answer")
    assert done.status == 0, done.err
    assert {path.name for path in (own_home.out / "shot" / "kept" / "entries").rglob("value.json")} == before
    shot = (own_home.out / "shot" / "shot.json").read_bytes()
    done = own_home.trueroll("run", own_home.clip, "-o", own_home.out, "--no-video")
    assert (own_home.out / "shot" / "shot.json").read_bytes() == shot, "the models are no part of the shot"
    assert own_home.scene["laws"] is None


def test_contact_models_that_nobody_asked_for_are_null_with_the_reason(home: Home) -> None:
    assert home.scene["laws"] is None
    assert "were not compared" in home.scene["laws_reason"]


def predict(folder: Path, out: Path, cache: Path) -> bytes:
    """Predict from 1.1 s on, and return the bytes of the table."""
    command = ["predict", str(folder), "--at", "1.1", "-o", str(out), "--cache", str(cache), "--json"]
    assert execute_command_line(command) == 0
    return (out / "prediction.csv").read_bytes()


def test_changed_later_frames_change_no_byte_of_a_prediction(
    home: Home, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [tmp_path / name for name in ("as_filmed", "changed")]
    for folder in folders:
        folder.mkdir()
        shutil.copy(home.out / "scene.json", folder)
    rows = home.rows("tracks.csv")
    for folder, shift in zip(folders, (0.0, 0.1), strict=True):
        with (folder / "tracks.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0].keys())
            writer.writeheader()
            for row in rows:
                later = float(row["t"]) > 1.1
                writer.writerow(row | ({"x": float(row["x"]) + shift, "y": float(row["y"]) - shift} if later else {}))
    for folder, shift in zip((tmp_path / "shot_as_filmed", tmp_path / "shot_changed"), (0.0, 0.1), strict=True):
        folders.append(folder)
        saved = read_shot(home.out)
        moved = saved.tracks.xy + shift * (saved.tracks.t > 1.1)[:, None, None]
        (folder / "fresh").mkdir(parents=True)
        write_shot(replace(saved, tracks=replace(saved.tracks, xy=moved)), {}, "1", folder / "fresh")
        publish_shot(folder / "fresh", folder)
    one, two, three, four = (
        predict(folder, tmp_path / f"out_{k}", tmp_path / f"cache_{k}") for k, folder in enumerate(folders)
    )
    assert one == two
    assert three == four
    assert json.loads(capsys.readouterr().out.splitlines()[0])["compared"]
