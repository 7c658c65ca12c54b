"""`trueroll fit-table` learns a table from track folders, resumes, and refuses what is no table."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.shot_folders import FPS, write_shots

from models.estimation.reconstruction.explain_shot import explain
from pipeline.actions import fit_table
from pipeline.cli.execute import execute_command_line
from pipeline.io.observed_shot import read_observed_shot


@pytest.mark.slow
def test_a_table_is_learned_into_a_profile_that_predict_reads(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, profile = write_shots(tmp_path / "shots", 5), tmp_path / "profile.json"
    command = ["fit-table", str(folder), "-o", str(profile), "--cache", str(tmp_path / "cache"), "--json"]
    assert execute_command_line(command) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["laws"]["cushion"] == "han_2005"
    assert document["effects"]["rolling_resistance"]["mu"]["value"] == pytest.approx(0.006, rel=0.05)
    assert document["learned_from"]["shots"] == 5
    assert document["correction"] == {"gain": None, "weights": []}  # too few contacts for a network
    first = profile.read_bytes()
    page = profile.with_suffix(".html").read_text()
    assert "learned: han_2005" in page
    assert "stronge, catalogue values" in page
    assert execute_command_line(command[:-1]) == 0  # from the cache
    formula = re.search(r"Restitution (0\.\d+) v", capsys.readouterr().out)
    assert formula is not None
    assert 0.8 < float(formula[1]) < 0.95  # the spin of a rolling ball changes that of 0.9
    assert profile.read_bytes() == first
    predict = ["predict", str(folder), "--at", "2", "--seconds", "1", "-o", str(tmp_path / "out")]
    assert execute_command_line([*predict, "--profile", str(profile)]) == 0
    assert "white" in (tmp_path / "out" / "prediction.csv").read_text()


def test_shots_of_two_tables_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [str(write_shots(tmp_path / name, 1, length)) for name, length in (("one", 2.84), ("other", 2.54))]
    command = ["fit-table", *folders, "-o", str(tmp_path / "p.json"), "--cache", str(tmp_path / "c")]
    assert execute_command_line(command) == 2
    assert "one table is learned at a time" in capsys.readouterr().err
    assert not (tmp_path / "p.json").exists()


def test_a_folder_without_tracks_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute_command_line(["fit-table", str(tmp_path), "--cache", str(tmp_path / "c")]) == 2
    assert "tracks.csv or a folder with one was expected" in capsys.readouterr().err


@pytest.mark.slow
def test_an_unusable_shot_is_reported_and_the_others_teach_the_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, profile = write_shots(tmp_path / "shots", 4), tmp_path / "profile.json"
    with (folder / "tracks.csv").open("a") as file:
        file.write("4,0,0.5,white,1.0,0.7\n4,1,0.4,white,1.1,0.7\n")  # time goes back
    load = fit_table.load_shot

    def fail_once(source: Path, number: int, *rest: Any) -> Any:
        if number == 1:
            raise FloatingPointError("the shot does not end")
        return load(source, number, *rest)

    monkeypatch.setattr(fit_table, "load_shot", fail_once)
    missing = str(tmp_path / "missing")
    command = ["fit-table", missing, str(folder), "-o", str(profile), "--cache", str(tmp_path / "cache"), "--json"]
    assert execute_command_line(command) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["learned_from"]["shots"] == 3
    reasons = document["refused"]
    assert len(reasons) == 3
    assert "tracks.csv or a folder with one was expected" in reasons[0]
    assert "t must increase" in reasons[1]
    assert "shot 1: the shot does not end" in reasons[2]


def test_cloth_and_contacts_are_learned_at_the_same_times(tmp_path: Path) -> None:
    """Two frames are lost while the container shows an even rate: the fit corrects the times, so must the paths."""
    folder = write_shots(tmp_path / "shots", 1)
    tracks, scene, _ = read_observed_shot(folder)
    rows = np.flatnonzero(~np.isin(np.arange(len(tracks.t)), [30, 31]))
    shown = replace(
        tracks, frame=tracks.frame[: len(rows)], t=tracks.t[: len(rows)], xy=tracks.xy[rows], px=tracks.px[rows],
        sigma=tracks.sigma[rows], sigma_along=tracks.sigma_along[rows], streak=tracks.streak[rows],
        radius_px=tracks.radius_px[rows],
    )  # fmt: skip
    _, prepared = fit_table.prepare_shot(explain(shown, scene))
    lag = prepared.t - tracks.t[rows]
    assert np.ptp(lag) < 0.3 / FPS  # as captured, up to a common offset
    assert np.ptp(shown.t - tracks.t[rows]) == pytest.approx(2 / FPS)
