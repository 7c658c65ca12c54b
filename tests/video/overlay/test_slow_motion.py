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

from benchmarks.clips.overlay_cover import count_hidden_pixels
from models.core.events import Events
from models.core.fit_result import Fit, Trust
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from models.core.typing import FloatArray, ImageArray
from video.io.clip import Clip
from video.io.video_options import OverlayStyle, RenderOptions
from video.io.video_writer import VideoWriter
from video.matting.ball_timeline import build_ball_timeline
from video.matting.hidden_background import HiddenBackground, estimate_hidden_background
from video.overlay import poster
from video.overlay.annotation import prepare_annotation
from video.overlay.frame_overlay import LABEL_LETTERS, Label
from video.overlay.motion_paths import EVENT_STRENGTHS
from video.overlay.poster import draw_poster
from video.overlay.slow_motion import CRF, SLOW_TUNING, balls_at_times, find_output_times, render_slow_motion
from video.synthesis.frame_synthesis import ClipAppearance, estimate_clip_appearance


def appearance_of(clip: Clip, tracks: Tracks | None = None, fit: Fit | None = None) -> ClipAppearance:
    """The appearance of the staged shot, with other tracks or another fit where passed."""
    return estimate_clip_appearance(
        estimate_hidden_background(
            build_ball_timeline(shot.scene(), tracks or shot.tracks(clip.t), fit or shot.fit(clip.t)), clip
        ),
        clip,
    )


def render_poster(clip: Clip, appearance: ClipAppearance, tracks: Tracks, fit: Fit, path: Path) -> None:
    """Write the poster of a clip."""
    still = draw_poster(clip, HiddenBackground(appearance.timeline, appearance.plate), tracks, fit)
    assert cv2.imwrite(str(path), cv2.cvtColor(still, cv2.COLOR_RGB2BGR))


def render_and_decode(
    folder: Path, options: RenderOptions, rate: int = shot.RATE, frame_count: int = 16
) -> tuple[list[ImageArray], Fraction, Path]:
    """The slow motion of the staged shot: its frames, frame rate and file."""
    clip = shot.clip_in(folder, frame_count, rate)
    path = folder / "slow.mp4"
    render_slow_motion(clip, appearance_of(clip), shot.tracks(clip.t), shot.fit(clip.t), path, options)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
        return frames, Fraction(stream.average_rate or 0), path


@pytest.mark.parametrize(("rate", "shown"), [(30, 30), (15, 25), (120, 60)])
def test_the_slowdown_is_exact_at_the_clips_rate_limited_to_25_and_60(tmp_path: Path, rate: int, shown: int) -> None:
    frames, out, _ = render_and_decode(tmp_path, RenderOptions(slow=4.0), rate)
    assert out == shown
    assert len(frames) == int(15 / rate * 4 * shown + 1e-6) + 1


def test_decoded_frames_are_unchanged_where_nothing_is_drawn(tmp_path: Path) -> None:
    frames, _, _ = render_and_decode(tmp_path, RenderOptions(slow=4.0))
    for k in (5, 9):
        real = shot.film(k / shot.RATE).astype(float)
        free = np.s_[140:190, 160:310]
        assert np.abs(frames[4 * k][free] - real[free]).mean() < 3


def test_the_ball_moves_evenly_between_the_frames(tmp_path: Path) -> None:
    frames, _, _ = render_and_decode(tmp_path, RenderOptions(slow=8.0))
    places = []
    for k in range(48, 96):
        x, y = shot.place(k / 8 / shot.RATE)[0] * shot.SCALE + shot.MARGIN
        part = frames[k][round(y) - 3 : round(y) + 4].astype(float).min(axis=2).mean(axis=0)
        near = np.arange(round(x) - 9, round(x) + 10)
        weight = np.clip(part[near] - 110, 0, None)
        places.append(float((weight * near).sum() / weight.sum()) - x)
    assert np.std(places) < 0.35


def test_every_frame_shows_clock_and_plan_and_after_the_strike_a_trail(tmp_path: Path) -> None:
    frames, _, _ = render_and_decode(tmp_path, RenderOptions(slow=4.0))
    bare, drawn = shot.film(14 / shot.RATE), frames[56]
    changed = np.abs(drawn.astype(int) - bare).max(axis=2) > 40
    assert 0.05 < changed.mean() < 0.5
    y = round(0.45 * shot.SCALE + shot.MARGIN)
    x = round((0.3 + 0.15) * shot.SCALE + shot.MARGIN)
    assert drawn[y, x].min() > 150
    before = np.abs(frames[8].astype(int) - shot.film(2 / shot.RATE)).max(axis=2) > 40
    assert not before[y - 5 : y + 5, x - 5 : x + 5].any()


def test_the_same_shot_gives_the_same_bytes(tmp_path: Path) -> None:
    digests = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        _, _, path = render_and_decode(tmp_path / name, RenderOptions(slow=2.0, quick=True))
        digests.append(hashlib.sha256(path.read_bytes()).hexdigest())
    assert digests[0] == digests[1]


def test_still_ends_are_trimmed_only_on_request(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 50)
    tracks, fit = shot.tracks(clip.t), shot.fit(clip.t)
    still = replace(tracks, xy=np.repeat(tracks.xy[:1], 50, axis=0), px=np.repeat(tracks.px[:1], 50, axis=0))
    lengths = []
    for trim in (False, True):
        path = tmp_path / f"{trim}.mp4"
        moved = replace(fit.trajectory, end=np.array([0.1, 0.5, clip.t[-1]]))
        options = RenderOptions(slow=1.0, trim_still=trim)
        fitted = replace(fit, trajectory=moved)
        render_slow_motion(clip, appearance_of(clip, still, fitted), still, fitted, path, options)
        with av.open(str(path)) as container:
            lengths.append(sum(1 for _ in container.decode(video=0)))
    assert lengths[0] == 50
    assert 25 <= lengths[1] <= 35


def test_trimming_begins_half_a_second_before_the_motion(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 40)
    tracks = shot.tracks(clip.t)
    still = replace(tracks, xy=np.repeat(tracks.xy[:1], 40, axis=0), px=np.repeat(tracks.px[:1], 40, axis=0))
    late = replace(shot.fit(clip.t).trajectory, start=np.array([0.0, 1.0, 0.0]), end=np.array([1.0, 1.2, clip.t[-1]]))
    fit = replace(shot.fit(clip.t), trajectory=late)
    timeline = build_ball_timeline(shot.scene(), still, fit)
    begins = [find_output_times(clip, timeline, RenderOptions(slow=1.0, trim_still=trim))[0] for trim in (False, True)]
    assert begins[0] == 0
    assert begins[1] == pytest.approx(0.5, abs=0.05)


def test_progress_increases_to_one(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 8)
    shares: list[float] = []
    record: Callable[[float], None] = shares.append
    fit = shot.fit(clip.t)
    render_slow_motion(
        clip,
        appearance_of(clip, None, fit),
        shot.tracks(clip.t),
        fit,
        tmp_path / "s.mp4",
        RenderOptions(slow=2.0),
        record,
    )
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_speed_up_is_refused() -> None:
    with pytest.raises(ValueError, match="1 to 1000 times slower"):
        RenderOptions(slow=0.5)


def test_the_poster_shows_the_ball_along_its_path(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 31)
    path = tmp_path / "poster.png"
    render_poster(clip, appearance_of(clip), shot.tracks(clip.t), shot.fit(clip.t), path)
    still = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
    assert still.shape == (shot.HEIGHT, shot.WIDTH, 3)
    last = shot.film(30 / shot.RATE)
    y = round(0.45 * shot.SCALE + shot.MARGIN)
    above = np.abs(still[y - 6].astype(int) - last[y - 6]).max(axis=1) > 30
    start, end = (round(x * shot.SCALE + shot.MARGIN) for x in (0.3, 0.3 + 0.9 * 0.7))
    runs = np.flatnonzero(np.diff(above[start - 20 : end].astype(int)) == 1)  # from before the ring around the start
    assert len(runs) >= 2


def test_the_poster_labels_every_contact_legibly_on_a_phone_or_counts_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[tuple[str, str, float]] = []
    monkeypatch.setattr(
        Label, "draw", lambda label, image, corner, scale, opacity=1.0: drawn.append((label.name, label.value, scale))
    )
    clip = shot.clip_in(tmp_path, 31)
    tracks, fit = shot.tracks(clip.t), shot.fit(clip.t)
    assert len(fit.events), "there is something to label"
    crowd = fit.events.select_rows(np.zeros(30, dtype=np.int64))
    for events in (fit.events, crowd):
        drawn.clear()
        render_poster(clip, appearance_of(clip), tracks, replace(fit, events=events), tmp_path / "poster.png")
        assert min(scale for *_, scale in drawn) * LABEL_LETTERS >= 9 * shot.WIDTH / 390 - 0.01
        timed = sum(value.endswith(" s") for _, value, _ in drawn)
        noted = sum(int(name.split()[0]) for name, *_ in drawn if name.endswith(("more contact", "more contacts")))
        assert timed + noted == sum(kind in EVENT_STRENGTHS for kind in events.kind)
    assert noted > 0


def test_a_line_leads_from_the_spot_to_every_label_of_the_poster(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    leaders: list[FloatArray] = []
    boxes: list[FloatArray] = []
    monkeypatch.setattr(poster, "draw_polyline", lambda view, points, width, colour: leaders.append(points))
    monkeypatch.setattr(
        Label, "draw",
        lambda label, image, corner, scale, opacity=1.0: boxes.append(np.stack([corner, corner + label.size(scale)])),
    )  # fmt: skip
    clip = shot.clip_in(tmp_path, 31)
    tracks, fit = shot.tracks(clip.t), shot.fit(clip.t)
    render_poster(clip, appearance_of(clip), tracks, fit, tmp_path / "poster.png")
    assert len(leaders) == 2 * len(boxes) > 0, "a dark outline and a line"
    for leader, (low, high) in zip(leaders[::2], boxes, strict=True):
        assert ((low <= leader[1]) & (leader[1] <= high)).all()


def test_a_shot_without_a_fit_is_shown_as_it_was_filmed(tmp_path: Path) -> None:
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
    bare = appearance_of(clip, None, empty)
    render_slow_motion(clip, bare, shot.tracks(clip.t), empty, path, RenderOptions(slow=2.0))
    render_poster(clip, bare, shot.tracks(clip.t), empty, tmp_path / "poster.png")
    with av.open(str(path)) as container:
        assert sum(1 for _ in container.decode(video=0)) == 15


def test_a_ball_without_a_fit_has_no_speed_and_a_resting_ball_has_speed_zero() -> None:
    times = np.arange(31) / shot.RATE
    fit = shot.fit(times)
    ends = replace(fit, trajectory=replace(fit.trajectory, end=np.array([0.1, 0.5, times[-1]])))
    timeline = build_ball_timeline(shot.scene(), shot.tracks(times), ends)
    for t, cue in ((0.05, 0.0), (0.45, 0.9), (0.55, np.nan)):
        speed = balls_at_times(timeline, timeline.state_at(np.array([t])), np.array([t]))[0].speed
        assert speed == pytest.approx([cue, 0.0], nan_ok=True)


def test_potted_balls_disappear_from_the_video(tmp_path: Path) -> None:
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
    appearance = appearance_of(clip, tracks, potted)
    render_slow_motion(clip, appearance, tracks, potted, path, RenderOptions(slow=4.0))
    render_poster(clip, appearance, tracks, potted, tmp_path / "poster.png")
    assert path.stat().st_size > 1000


def test_the_default_slow_motion_is_that_of_the_published_cost() -> None:
    """The tables of the page are in units of what encoding this many frames costs."""
    page = Path(__file__).parents[3] / "docs" / "explanation" / "scaling.md"
    assert "encoding its eightfold slow motion" in page.read_text(encoding="utf-8")
    assert RenderOptions().slow == 8


@pytest.mark.parametrize("style", ["coach", "umpire"])
def test_no_pixel_of_a_ball_is_covered(tmp_path: Path, style: OverlayStyle) -> None:
    clip = shot.clip_in(tmp_path, 16, shot.RATE)
    options = RenderOptions(slow=4.0, style=style)
    count = count_hidden_pixels(clip, shot.scene(), shot.tracks(clip.t), shot.fit(clip.t), options)
    assert (count.moving, count.resting) == (0, 0)
    assert count.drawn > 0


def test_where_balls_cross_every_place_of_a_panel_the_panels_lie_below_the_picture(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 16, shot.RATE)
    appearance = appearance_of(clip)
    crowd = replace(
        appearance.timeline, centre=np.random.default_rng(3).uniform(0, 320, appearance.timeline.centre.shape)
    )
    everywhere = replace(crowd, radius=np.full_like(crowd.radius, 90.0))
    free, crowded = (
        prepare_annotation(timeline, shot.tracks(clip.t), shot.fit(clip.t), shot.cloth(), 4.0)
        for timeline in (appearance.timeline, everywhere)
    )
    assert crowded.strip_height > 0
    assert min(crowded.inset_place[1], crowded.clock_place[1]) > shot.HEIGHT
    extended = crowded.extend(shot.cloth())
    assert extended.shape == (shot.HEIGHT + crowded.strip_height, shot.WIDTH, 3)
    assert extended.shape[0] % 2 == 0
    assert free.strip_height == 0 or free.inset_place[1] > shot.HEIGHT


def test_a_slow_motion_is_encoded_as_closely_as_with_the_rate_factor(tmp_path: Path) -> None:
    grain = np.random.default_rng(4).normal(0, 3, (4, shot.HEIGHT, shot.WIDTH, 3))
    frames = [
        np.clip(shot.film(0.3 + 0.005 * k) + grain[k // 8], 0, 255).astype(np.uint8)[: shot.HEIGHT // 2 * 2]
        for k in range(32)
    ]
    errors = []
    for tuning in (SLOW_TUNING, "me=dia:subme=0:cabac=0"):
        path = tmp_path / "a.mp4"
        with VideoWriter(path, shot.WIDTH, len(frames[0]), Fraction(30), crf=CRF, tuning=tuning) as writer:
            for frame in frames:
                writer.write(frame)
        with av.open(str(path)) as film:
            shown = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
        errors.append(float(np.mean([((a.astype(float) - b) ** 2).mean() for a, b in zip(shown, frames, strict=True)])))
    assert errors[0] <= 1.05 * errors[1]
