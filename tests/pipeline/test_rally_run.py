"""A clip of a rally goes through the same commands and files as a clip of billiards."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image
from support.carom_start import Home, run_program
from support.rally_stand_ins import locate_court, use_stand_ins

import trueroll
from models.core.court_camera import CourtScene
from models.core.errors import OptionError
from models.core.progress import Progress, ignore_progress
from models.core.rally import Rally
from models.sports.sport_catalogue import find_sports
from pipeline.actions.diagnose_batch import group_by_table
from pipeline.api import RallyRun
from pipeline.batch.clip_job import ClipLimits, ClipResult
from pipeline.batch.clip_run import run_job
from pipeline.batch.run_batch import Batch, run_batch
from pipeline.chain import FinishedRally, run_tables
from pipeline.cli.commands.run_command import _rally_to_json
from pipeline.engine.result_cache import ResultCache
from pipeline.io.corrections_file import corrections_path
from pipeline.io.rally_files import write_rally_files
from pipeline.io.saved_shot import read_rally, write_shot
from pipeline.io.track_folder import read_track_folders
from pipeline.recording_shots import find_recording_shots
from pipeline.reporting.text.rally_sentences import assess_rally_trust
from pipeline.run_options import RunOptions, list_setting_values
from video.io.clip import Clip, open_clip
from video.io.video_writer import VideoWriter

FILES = {
    "slow.mp4", "tracks.csv", "events.csv", "strokes.csv", "scene.json", "trajectory.csv",
    "recording.rrd", "report.html", "summary.json", "poster.png", "source.json", "shot",
}  # fmt: skip


def film_noise(path: Path, width: int = 320, views: int = 1, frames: int = 50) -> Path:
    """Film changing noise in the lower half of every view, each view of another brightness."""
    path.parent.mkdir(exist_ok=True)
    rng = np.random.default_rng(5)
    with VideoWriter(path, width, 180, Fraction(25)) as writer:
        for k in range(views * frames):
            image = np.full((180, width, 3), 40 + 170 * ((k // frames) % 2), np.uint8)
            image[90:] = rng.integers(0, 60, (90, width, 3), np.uint8) + 40
            writer.write(image)
    return path


@pytest.fixture(scope="module")
def courts(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Home]:
    """A run of a clip that shows a badminton court to the stand-ins."""
    home = Home(tmp_path_factory.mktemp("courts"))
    home.clip.parent.mkdir()
    film_noise(home.clip)
    with pytest.MonkeyPatch.context() as patch:
        use_stand_ins(patch)
        done = home.trueroll("run", home.clip, "-o", home.out)
        assert done.status == 0, done.err
        (home.folder / "printed.txt").write_text(done.out)
        yield home


def test_the_folder_of_a_rally_holds_the_files_of_a_run(courts: Home) -> None:
    assert {path.name for path in courts.out.iterdir()} == FILES


def test_a_run_prints_the_events_the_call_and_the_trust_level(courts: Home) -> None:
    text = (courts.folder / "printed.txt").read_text()
    for words in ("The shuttle is hit by the near player", "The shuttle lands", "In (above 99.9 %)", "far end line",
                  "trust: green", "report.html"):  # fmt: skip
        assert words in text


def test_tracks_have_heights_and_fill_in_the_hidden_frame(courts: Home) -> None:
    rows = courts.rows("tracks.csv")
    assert list(rows[0]) == ["shot", "frame", "t", "id", "kind", "x_px", "y_px", "x", "y", "z", "sigma", "radius_px",
                             "observed"]  # fmt: skip
    assert [row["observed"] for row in rows].count("0") == 1
    assert {row["id"] for row in rows} == {"shuttle"}
    frame = courts.column("tracks.csv", "frame")
    assert np.all(np.diff(frame) == 1)
    hidden = courts.column("tracks.csv", "observed") == 0
    for name in ("x_px", "y_px", "z"):  # between its neighbours
        values = courts.column("tracks.csv", name)
        assert np.all(np.abs(np.diff(values, 2)[np.flatnonzero(hidden) - 1]) < 0.2 * np.ptp(values))
    assert np.all(courts.column("tracks.csv", "sigma") > 0)
    assert np.all((courts.column("tracks.csv", "radius_px") > 1) & (courts.column("tracks.csv", "radius_px") < 10))


def test_events_name_the_player_and_the_place(courts: Home) -> None:
    hit, landing = courts.rows("events.csv")
    assert (hit["kind"], hit["a"], hit["b"], landing["kind"]) == ("hit", "shuttle", "near", "landing")
    assert [float(landing[name]) for name in "xyz"] == pytest.approx([13.0, 3.0, 0.033], abs=1e-3)
    assert float(landing["frame"]) == pytest.approx(25 * float(landing["t"]), abs=1e-3)


def test_strokes_have_speed_apex_height_over_the_net_and_landing(courts: Home) -> None:
    (row,) = courts.rows("strokes.csv")
    hit = courts.rows("events.csv")[0]
    assert (row["player"], row["t"], row["frame"]) == ("near", hit["t"], hit["frame"])
    assert float(row["speed_kmh"]) == pytest.approx(3.6 * float(hit["speed"]), abs=1e-4)
    assert float(row["speed_kmh_sigma"]) == pytest.approx(3.6 * 0.4, abs=1e-4)  # as staged
    assert float(row["apex"]) == pytest.approx(courts.column("trajectory.csv", "z").max(), abs=1e-3)
    assert 0 < float(row["apex_sigma"]) < 0.5
    at_net = np.interp(6.7, courts.column("trajectory.csv", "x"), courts.column("trajectory.csv", "z"))
    assert float(row["net"]) == pytest.approx(at_net - 0.033 - 1.53, abs=0.02)  # m, radius and edge
    assert [float(row[name]) for name in ("landing_x", "landing_y", "landing_seen")] == [13.0, 3.0, 1.0]
    assert float(row["in_probability"]) > 0.999
    shown = f"{float(row['speed_kmh']):.1f} ± 1.4 km/h"
    assert shown in (courts.folder / "printed.txt").read_text()


def test_tables_have_the_times_of_the_clip_although_its_frames_were_taken_at_others(
    courts: Home, tmp_path: Path
) -> None:
    rally, clip = read_rally(courts.out), open_clip(courts.clip)
    event, flight = rally.events[0], rally.flights[0]
    late = replace(
        rally, t=rally.t + 0.25, events=(replace(event, t=event.t + 0.25),),
        flights=(replace(flight, start=flight.start + 0.25, end=flight.end + 0.25),),
        landings=tuple(replace(one, t=one.t + 0.25) for one in rally.landings),
    )  # fmt: skip
    write_rally_files(clip, late, tmp_path)
    landing = json.loads((tmp_path / "scene.json").read_text())["landings"][0]
    assert landing["t"] == pytest.approx(courts.scene["landings"][0]["t"])
    printed, plain = (_rally_to_json(FinishedRally(tmp_path, clip, one)) for one in (late, rally))
    for name in ("events", "strokes"):
        times = [[row["t"] for row in document[name]][:1] for document in (printed, plain)]
        assert times[0] == pytest.approx(times[1])
    assert printed["landing"]["t"] == pytest.approx(plain["landing"]["t"])
    for name in ("tracks.csv", "events.csv", "strokes.csv", "trajectory.csv"):
        texts = [(folder / name).read_text(encoding="utf-8") for folder in (tmp_path, courts.out)]
        rows, before = (list(csv.DictReader(text.splitlines())) for text in texts)
        count = len(rows)
        assert count
        assert [float(row["t"]) for row in rows] == pytest.approx(
            [float(row["t"]) for row in before[:count]], abs=1.1e-3
        )
        if name == "trajectory.csv":
            assert float(rows[-1]["z"]) == pytest.approx(float(before[count - 1]["z"]), abs=0.02)


def test_the_trajectory_is_sampled_a_thousand_times_a_second_in_space(courts: Home) -> None:
    t, z, vz = (courts.column("trajectory.csv", name) for name in ("t", "z", "vz"))
    assert np.diff(t) == pytest.approx(0.001, abs=1e-6)
    assert np.gradient(z, t)[1:-1] == pytest.approx(vz[1:-1], abs=0.05)
    assert z[-1] == pytest.approx(0.033, abs=0.01)


def test_the_scene_states_court_calibration_flights_landing_and_trust(courts: Home) -> None:
    scene = courts.scene
    assert (scene["scene"], scene["sport"], scene["units"]) == ("rally", "badminton", "m")
    assert np.array(scene["calibration"]["covariance"]).shape == (8, 8)
    (flight,) = scene["flights"]
    assert {"value", "sigma", "unit"} == flight["parameters"]["drag"].keys()
    assert flight["chi2_per_dof"] == 1.1
    assert scene["landings"][0]["place"] == pytest.approx([13.0, 3.0, 0.033])
    assert scene["trust"]["light"] == "green"
    assert json.loads((courts.out / "summary.json").read_text())["hit_count"] == 1


def test_a_second_run_takes_everything_from_the_cache(courts: Home, tmp_path: Path) -> None:
    done = courts.trueroll("run", courts.clip, "-o", tmp_path / "again", "--json")
    assert json.loads(done.out)["landing"]["code"] == "in"
    assert [one["player"] for one in json.loads(done.out)["strokes"]] == ["near"]
    for path in courts.out.iterdir():
        if path.is_file():
            assert (tmp_path / "again" / path.name).read_bytes() == path.read_bytes()
    done = courts.trueroll("graph", courts.clip, "--json")
    views = {view["stage"]: view["state"] for view in json.loads(done.out)}
    assert {"court", "candidates", "rally", "render"} <= views.keys()
    assert set(views.values()) == {"cached"}


def test_the_saved_rally_reads_back_equal(courts: Home) -> None:
    rally = read_rally(courts.out)
    run = trueroll.load(courts.out)
    assert isinstance(run, RallyRun)
    assert run.rally.scene.sport == rally.scene.sport
    assert run.trajectory.at(0.5).xyz.shape == (1, 3)
    assert [one.kind for one in run.events] == ["hit", "landing"]
    assert len(run.tracks) == run.to_arrow("tracks").num_rows
    assert "far" in run.scene.sport.lines[1].name
    assert "lands" in run._repr_html_()
    with pytest.raises(OptionError, match="holds a rally of badminton"):
        _ = run.shot


def test_an_umpire_is_told_where_it_landed(courts: Home, tmp_path: Path) -> None:
    answer = trueroll.call(courts.out, "landing", out=tmp_path)
    assert answer.verdict == "in"
    assert answer.sentences[0] == "The near player won the last point: the shuttle was in."
    assert answer["distance"].value == pytest.approx(40, abs=0.5)
    assert answer["distance"].sigma == pytest.approx(3, abs=0.1)
    assert [Path(figure).is_file() for figure in answer.figures] == [True]
    box = run_program("call", courts.out, "landing", "--service-box", "-o", tmp_path, "--json")
    assert json.loads(box.out)["area"] == "service-box"
    assert "won the last point" not in box.out, "a service in its box may have been returned"
    assert trueroll.call(courts.out, "landing", "doubles", out=tmp_path).verdict == "in"


def test_the_height_over_the_net_has_an_error(courts: Home) -> None:
    answer = trueroll.call(courts.out, "net")
    assert answer["height"].sigma > 0
    assert len(answer.rows) == 2


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("call", "first", "cue"), "holds a rally of badminton: ask landing"),
        (("call", "landing", "--singles", "--doubles"), "with one of --singles"),
        (("call", "landing", "mixed"), "badminton has the areas"),
        (("call", "net", "--singles"), "got 'net --singles'"),
        (("predict", "--at", "99"), "--at must lie within what was seen, 0.500"),
        (("what-if",), "holds a rally of badminton"),
        (("put-back",), "rally"),
        (("compare",), "rally"),
        (("fit-table",), "rally"),
        (("certify",), "rally"),
    ],
)
def test_what_cannot_be_asked_of_a_rally_is_one_sentence(
    courts: Home, tmp_path: Path, words: tuple[str, ...], sentence: str
) -> None:
    command, *rest = words
    done = run_program(command, courts.out, *rest)
    assert done.status in (1, 2)
    assert sentence in " ".join(done.err.split())
    assert "Traceback" not in done.err


def test_the_flights_of_a_rally_are_diagnosed_in_the_image(courts: Home, tmp_path: Path) -> None:
    done = run_program("diagnose", courts.out, "-o", tmp_path / "gap", "--json")
    document = json.loads(done.out)
    assert (document["scene"], document["model"], document["gap"]["metric"]) == ("flight", ["air_drag"], "rms_px")
    assert document["verdict"] == "undecidable"  # of one flight
    assert (tmp_path / "gap" / "gap.html").is_file()


@pytest.mark.parametrize("sport", ["tennis", "table-tennis"])
def test_rallies_of_two_sports_are_diagnosed_separately(courts: Home, tmp_path: Path, sport: str) -> None:
    rally = read_rally(courts.out)
    other = replace(rally, scene=replace(rally.scene, sport=find_sports()[sport]))
    write_rally_files(open_clip(courts.clip), other, tmp_path)
    write_shot(other, {}, "", tmp_path)
    assert len(read_track_folders([tmp_path]).recordings) == 1
    with pytest.raises(OptionError, match="walls, radius or known inputs"):
        read_track_folders([courts.out, tmp_path])


def test_a_rally_is_predicted_from_what_was_seen_until_then(courts: Home, tmp_path: Path) -> None:
    answer = trueroll.predict(courts.out, at=0.8, out=tmp_path)
    assert answer["x"].value == pytest.approx(13.0, abs=0.1)
    document = json.loads((tmp_path / "prediction.json").read_text())
    assert document["compared"]["rms_px"] < 0.5
    assert document["compared"]["frames"] > 3


def test_a_clip_of_neither_kind_keeps_its_sentence(courts: Home, tmp_path: Path) -> None:
    clip = film_noise(tmp_path / "nothing.mp4", width=160)
    done = courts.trueroll("run", clip, "-o", tmp_path / "out")
    assert done.status == 1
    assert "table" in done.err or "cloth" in done.err
    done = courts.trueroll("run", clip, "-o", tmp_path / "out", "--sport", "tennis")
    assert "no lines of a known court are in view" in done.err
    assert not (tmp_path / "out" / "tracks.csv").exists()


def test_a_cut_ends_a_rally(courts: Home, tmp_path: Path) -> None:
    clip = film_noise(tmp_path / "match.mp4", views=3)
    done = courts.trueroll("run", clip, "-o", tmp_path / "out", "--sport", "tennis", "--shot", "2", "--no-video")
    assert done.status == 0, done.err
    assert "shot 2 of 3" in done.err
    assert json.loads((tmp_path / "out" / "scene.json").read_text())["clip"]["first_frame"] == 50
    assert json.loads((tmp_path / "out" / "scene.json").read_text())["sport"] == "tennis"


def test_the_sport_of_a_corrections_file_counts_before_a_run_too(courts: Home, tmp_path: Path) -> None:
    clip = film_noise(tmp_path / "match.mp4", views=3)
    corrections_path(clip).write_text('{"schema": "trueroll.corrections/1", "sport": "tennis"}')
    options, cache = RunOptions(), ResultCache(courts.cache)
    assert len(find_recording_shots(clip, options, cache, QuietFollower()).shots) == 3
    _, rally, *_ = run_tables(clip, tmp_path / "out", options, cache, QuietFollower())
    assert isinstance(rally, Rally)
    assert rally.scene.sport.name == "tennis"
    assert (tmp_path / "out" / "events.csv").is_file()
    assert not (tmp_path / "out" / "report.html").exists()


def test_what_was_set_for_a_sport_is_not_taken_for_it_without_the_sport(courts: Home, tmp_path: Path) -> None:
    """Tables search for a table first, as a run does, even where the folder holds a rally; without marks, only once."""
    clip, cache = film_noise(tmp_path / "rally.mp4"), ResultCache(tmp_path / "cache")
    corners = [[10, 20], [300, 20], [300, 170], [10, 170]]
    tables = []
    for marks in ({"sport": "tennis"}, {"corners": corners}, {"corners": corners}, {}, {}):
        corrections_path(clip).write_text(json.dumps({"schema": "trueroll.corrections/1", **marks}))
        follower = QuietFollower()
        _, rally, *_ = run_tables(clip, tmp_path / "out", RunOptions(), cache, follower)
        assert isinstance(rally, Rally)
        tables.append((rally.scene.sport.name, "calibrate" in follower.stages))
    assert tables == [
        ("tennis", False), ("badminton", True), ("badminton", True), ("badminton", True), ("badminton", False),
    ]  # fmt: skip


def test_a_check_grades_the_view_of_a_court(courts: Home, tmp_path: Path) -> None:
    still = tmp_path / "still.png"
    done = run_program("check", courts.clip, "-o", still, "--json")
    document = json.loads(done.out)
    assert (document["sport"], document["verdict"], done.status) == ("badminton", "doubts", 0)
    values = {one["code"]: one["value"] for one in document["measurements"]}
    assert values["rate"] == pytest.approx(25, abs=0.5)
    assert 1 < values["place"] < 20  # cm, at 0.7 px
    assert still.is_file()
    small = film_noise(tmp_path / "nothing.mp4", width=160)
    assert "A run refuses this clip" in run_program("check", small).out


def test_a_sport_that_is_not_known_is_refused(courts: Home) -> None:
    done = courts.trueroll("run", courts.clip, "--sport", "curling")
    assert done.status == 2
    assert "badminton, table-tennis or tennis was expected" in done.err


def test_frames_between_the_frames_of_a_rally_leave_the_originals_as_they_are(courts: Home, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    words = ("--factor", 2, "-o", tmp_path / "out.mp4", "--frames", frames, "--sport", "badminton")
    done = courts.trueroll("interpolate", courts.clip, *words)
    assert done.status == 0, done.err
    with av.open(str(courts.clip)) as film:
        real = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert len(list(frames.iterdir())) == 2 * len(real) - 1
    for k in (0, 17, 49):
        assert np.array_equal(np.asarray(Image.open(frames / f"{2 * k:06d}.png")), real[k])
    done = courts.trueroll("interpolate", courts.clip, "--factor", 2, "-o", tmp_path / "up.mp4", "--upright")
    assert "are for billiards" in done.err
    done = run_program("interpolate", courts.out, "--factor", 4, "-o", tmp_path / "fine.csv")
    assert "the flights of the run" in done.out


class QuietFollower:
    """Follows a batch and its clips without a word."""

    def __init__(self) -> None:
        self.stages: list[str] = []
        """Names of the stages that were started."""

    def start_stage(self, stage: str) -> Progress:
        self.stages.append(stage)
        return ignore_progress

    def finish_stage(self, stage: str, seconds: float, cached: bool) -> None: ...

    def start_shot(self, number: int, count: int, done: float) -> None: ...

    def write_note(self, sentence: str) -> None: ...

    def show_progress(self, clip: str, message: dict[str, Any]) -> None: ...

    def show_result(self, row: ClipResult, expected: int) -> None: ...


def test_a_batch_lists_rallies_and_what_is_neither(courts: Home, tmp_path: Path) -> None:
    clips = [film_noise(tmp_path / "in" / "nothing.mp4", width=160), film_noise(tmp_path / "in" / "rally.mp4")]
    clips.append(film_noise(tmp_path / "in" / "match.mp4", views=2))
    work = Batch(tmp_path / "in", tmp_path / "out", ResultCache(courts.cache), list_setting_values(RunOptions()),
                 ClipLimits())  # fmt: skip
    work.assign_folders(clips)
    follower = QuietFollower()
    run_batch(work, clips, lambda jobs, _: (run_job(job, follower) for job in jobs if job is not None), follower)
    match, nothing, rally = work.results
    assert (rally.status, rally.trust, rally.contacts, rally.sentence) == ("done", "green", 2, "")
    assert (match.shots, match.in_shots) == (2, True)
    assert nothing.status == "failed"
    page = (tmp_path / "out" / "summary.html").read_text()
    assert "badminton; 1 hit, 0 bounces" in page
    assert "landing: in" in page
    merged = (tmp_path / "out" / "match" / "events.csv").read_text().splitlines()
    rows = [line.split(",")[:2] for line in merged[1:]]
    assert rows == [["0", "hit"], ["0", "landing"], ["1", "hit"], ["1", "landing"]]
    assert list(group_by_table(work.results)) == []


def test_a_corrections_file_names_the_sport_the_corners_and_the_events(
    courts: Home, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = tmp_path / "rally.mp4"
    clip.write_bytes(courts.clip.read_bytes())
    given = []

    def locate(clip: Clip, sport: str | None, corners: str | None, progress: object) -> CourtScene:
        given.append((sport, corners))
        return locate_court(clip, sport, corners, progress)

    monkeypatch.setattr("video.calibration.court_finder.locate_court", locate)
    landing = float(courts.rows("events.csv")[1]["frame"])
    marks = {
        "schema": "trueroll.corrections/1", "sport": "tennis", "corners": [[10, 20], [300, 20], [300, 170], [10, 170]],
        "balls": [{"kind": "placed", "ball": {"frame": 2, "x_px": 40.0, "y_px": 50.0}}],
        "events": [{"kind": "delete", "event": "landing", "frame": landing},
                   {"kind": "mark", "event": "net", "frame": 20.0}],
    }  # fmt: skip
    corrections_path(clip).write_text(json.dumps(marks))
    run = trueroll.run(clip, tmp_path / "out", cache=tmp_path / "cache", no_video=True)
    assert isinstance(run, RallyRun)
    assert given == [("tennis", "10,20,300,20,300,170,10,170")]
    assert run.rally.notes == (
        "net-set-by-hand-at-0.80-s-fits-no-flight",
        "place-set-by-hand-in-frame-2-fits-no-flight",
    )
    assert assess_rally_trust(run.rally).reasons[-1] == "Place set by hand in frame 2 fits no flight."
    scene = json.loads((tmp_path / "out" / "scene.json").read_text())
    assert scene["set_by_hand"]["events"] == marks["events"]
    assert scene["sport"] == "tennis"
