from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from support import staged_shot as shot

from models.core.events import Events
from models.core.fit_result import Fit, Trust
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from models.core.typing import ImageArray
from video.io.clip import Clip
from video.io.options import RenderOptions
from video.matting.ball_timeline import sight
from video.overlay.ball_outlines import balls_at
from video.overlay.slow_motion import render_poster, render_slow_motion
from video.synthesis.frame_synthesis import Scenery, scenery_of


def scenery(clip: Clip, tracks: Tracks | None = None, fit: Fit | None = None) -> Scenery:
    """What the table and the balls of the staged shot look like; of other tracks or another fit where given."""
    return scenery_of(sight(shot.scene(), tracks or shot.tracks(clip.t), fit or shot.fit(clip.t)), clip)


def rendered(
    folder: Path, options: RenderOptions, rate: int = shot.RATE, pictures: int = 16
) -> tuple[list[ImageArray], Fraction, Path]:
    """The slow motion of the staged shot: pictures, rate, file."""
    clip = shot.clip_in(folder, pictures, rate)
    path = folder / "slow.mp4"
    render_slow_motion(clip, scenery(clip), shot.tracks(clip.t), shot.fit(clip.t), path, options)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        made = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
        return made, Fraction(stream.average_rate or 0), path


@pytest.mark.parametrize(("rate", "shown"), [(30, 30), (15, 25), (120, 60)])
def test_it_is_exactly_so_much_slower_at_the_clips_rate_within_25_and_60(tmp_path: Path, rate: int, shown: int) -> None:
    made, out, _ = rendered(tmp_path, RenderOptions(slow=4.0), rate)
    assert out == shown
    assert len(made) == int(15 / rate * 4 * shown + 1e-6) + 1


def test_real_pictures_come_back_where_nothing_is_drawn(tmp_path: Path) -> None:
    made, _, _ = rendered(tmp_path, RenderOptions(slow=4.0))
    for k in (5, 9):
        real = shot.film(k / shot.RATE).astype(float)
        free = np.s_[140:190, 160:310]
        assert np.abs(made[4 * k][free] - real[free]).mean() < 3


def test_the_ball_goes_evenly_between_the_pictures(tmp_path: Path) -> None:
    made, _, _ = rendered(tmp_path, RenderOptions(slow=8.0))
    places = []
    for k in range(48, 96):
        x, y = shot.place(k / 8 / shot.RATE)[0] * shot.SCALE + shot.MARGIN
        part = made[k][round(y) - 3 : round(y) + 4].astype(float).min(axis=2).mean(axis=0)
        near = np.arange(round(x) - 9, round(x) + 10)
        weight = np.clip(part[near] - 110, 0, None)
        places.append(float((weight * near).sum() / weight.sum()) - x)
    assert np.std(places) < 0.35


def test_every_picture_carries_clock_plan_and_after_the_strike_a_trail(tmp_path: Path) -> None:
    made, _, _ = rendered(tmp_path, RenderOptions(slow=4.0))
    bare, drawn = shot.film(14 / shot.RATE), made[56]
    changed = np.abs(drawn.astype(int) - bare).max(axis=2) > 40
    assert 0.05 < changed.mean() < 0.5
    y = round(0.45 * shot.SCALE + shot.MARGIN)
    x = round((0.3 + 0.15) * shot.SCALE + shot.MARGIN)
    assert drawn[y, x].min() > 150
    before = np.abs(made[8].astype(int) - shot.film(2 / shot.RATE)).max(axis=2) > 40
    assert not before[y - 5 : y + 5, x - 5 : x + 5].any()


def test_the_same_shot_gives_the_same_bytes(tmp_path: Path) -> None:
    digests = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        _, _, path = rendered(tmp_path / name, RenderOptions(slow=2.0, quick=True))
        digests.append(hashlib.sha256(path.read_bytes()).hexdigest())
    assert digests[0] == digests[1]


def test_still_ends_are_cut_only_when_asked(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 50)
    tracks, fit = shot.tracks(clip.t), shot.fit(clip.t)
    still = replace(tracks, xy=np.repeat(tracks.xy[:1], 50, axis=0), px=np.repeat(tracks.px[:1], 50, axis=0))
    lengths = []
    for trim in (False, True):
        path = tmp_path / f"{trim}.mp4"
        moved = replace(fit.trajectory, end=np.array([0.1, 0.5, clip.t[-1]]))
        options = RenderOptions(slow=1.0, trim_still=trim)
        fitted = replace(fit, trajectory=moved)
        render_slow_motion(clip, scenery(clip, still, fitted), still, fitted, path, options)
        with av.open(str(path)) as container:
            lengths.append(sum(1 for _ in container.decode(video=0)))
    assert lengths[0] == 50
    assert 25 <= lengths[1] <= 35


def test_it_says_at_what_time_of_the_clip_it_begins(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 40)
    tracks = shot.tracks(clip.t)
    still = replace(tracks, xy=np.repeat(tracks.xy[:1], 40, axis=0), px=np.repeat(tracks.px[:1], 40, axis=0))
    late = replace(shot.fit(clip.t).trajectory, start=np.array([0.0, 1.0, 0.0]), end=np.array([1.0, 1.2, clip.t[-1]]))
    fit = replace(shot.fit(clip.t), trajectory=late)
    begins = []
    for trim in (False, True):
        options = RenderOptions(slow=1.0, trim_still=trim)
        begins.append(render_slow_motion(clip, scenery(clip, still, fit), still, fit, tmp_path / "slow.mp4", options))
    assert begins[0] == 0
    assert begins[1] == pytest.approx(0.5, abs=0.05)


def test_progress_goes_to_one(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 8)
    seen: list[float] = []
    tell: Callable[[float], None] = seen.append
    fit = shot.fit(clip.t)
    render_slow_motion(
        clip, scenery(clip, None, fit), shot.tracks(clip.t), fit, tmp_path / "s.mp4", RenderOptions(slow=2.0), tell
    )
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


def test_a_speed_up_is_refused() -> None:
    with pytest.raises(ValueError, match="1 to 1000 times slower"):
        RenderOptions(slow=0.5)


def test_the_poster_shows_the_ball_all_along_its_way(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 31)
    path = tmp_path / "poster.png"
    render_poster(clip, scenery(clip), shot.tracks(clip.t), shot.fit(clip.t), path)
    still = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
    assert still.shape == (shot.HEIGHT, shot.WIDTH, 3)
    last = shot.film(30 / shot.RATE)
    y = round(0.45 * shot.SCALE + shot.MARGIN)
    above = np.abs(still[y - 6].astype(int) - last[y - 6]).max(axis=1) > 30
    start, end = (round(x * shot.SCALE + shot.MARGIN) for x in (0.3, 0.3 + 0.9 * 0.7))
    runs = np.flatnonzero(np.diff(above[start:end].astype(int)) == 1)
    assert len(runs) >= 2


def test_a_shot_without_any_fit_is_shown_as_it_was_filmed(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 8)
    fit = shot.fit(clip.t)
    nothing = Trajectory(
        shot.IDS, np.empty(0, dtype=np.int64), np.empty(0), np.empty(0), np.empty((0, 4, 2)), np.empty((0, 2, 3)), (),
        np.empty((0, 4, 4)),
    )  # fmt: skip
    none = np.empty(0)
    quiet = Events((), none, none, none, (), (), np.empty((0, 2)), none, none, none, none)
    path = tmp_path / "slow.mp4"
    empty = replace(fit, trajectory=nothing, events=quiet, trust=Trust("red", ("nothing fits",)))
    bare = scenery(clip, None, empty)
    render_slow_motion(clip, bare, shot.tracks(clip.t), empty, path, RenderOptions(slow=2.0))
    render_poster(clip, bare, shot.tracks(clip.t), empty, tmp_path / "poster.png")
    with av.open(str(path)) as container:
        assert sum(1 for _ in container.decode(video=0)) == 15


def test_a_ball_that_is_followed_no_longer_has_no_speed_and_one_that_rests_has_none_to_speak_of() -> None:
    times = np.arange(31) / shot.RATE
    fit = shot.fit(times)
    ends = replace(fit, trajectory=replace(fit.trajectory, end=np.array([0.1, 0.5, times[-1]])))
    sightings = sight(shot.scene(), shot.tracks(times), ends)
    for t, cue in ((0.05, 0.0), (0.45, 0.9), (0.55, np.nan)):
        speed = balls_at(sightings, sightings.state(np.array([t])), np.array([t]))[0].speed
        assert speed == pytest.approx([cue, 0.0], nan_ok=True)


def test_balls_never_seen_again_after_a_pocket_leave_the_picture(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 16)
    tracks, fit = shot.tracks(clip.t), shot.fit(clip.t)
    gone = tracks.t > 0.3
    for values in (tracks.xy, tracks.px):
        values[gone, 0] = np.nan
    for values in (tracks.sigma, tracks.sigma_along, tracks.radius_px):
        values[gone, 0] = np.nan
    ends = replace(fit.trajectory, end=np.array([0.1, 0.31, clip.t[-1]]))
    one = np.ones(1)
    pocket = Events(
        ("pocket",), 0.31 * one, 2e-3 * one, 9.3 * one, ("cue",), ("top",), shot.place(0.31)[:1], one, np.nan * one,
        np.nan * one, one,
    )  # fmt: skip
    path = tmp_path / "slow.mp4"
    potted = replace(fit, trajectory=ends, events=pocket)
    seen = scenery(clip, tracks, potted)
    render_slow_motion(clip, seen, tracks, potted, path, RenderOptions(slow=4.0))
    render_poster(clip, seen, tracks, potted, tmp_path / "poster.png")
    assert path.stat().st_size > 1000
