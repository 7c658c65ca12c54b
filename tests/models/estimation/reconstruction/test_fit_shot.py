"""The fit against an independent simulator: contacts, motion, warnings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.filmed_shots import PX_PER_M, RADIUS, film, match, position_rms_px, random_shot, scene
from support.fixed_step_table import GRIPPING, MIRROR, SPEED_DEPENDENT

from models.core.tracks import Tracks
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot

STILL = np.zeros((1, 2))


def only(tracks: Tracks, rows: np.ndarray) -> Tracks:
    """Tracks of some frames."""
    return replace(
        tracks, frame=tracks.frame[rows], t=tracks.t[rows], xy=tracks.xy[rows], px=tracks.px[rows],
        sigma=tracks.sigma[rows], sigma_along=tracks.sigma_along[rows], streak=tracks.streak[rows],
        radius_px=tracks.radius_px[rows],
    )  # fmt: skip


@pytest.mark.parametrize(
    ("law", "fps", "noise_px", "limit_ms"),
    [(MIRROR, 30, 0.3, 2.0), (SPEED_DEPENDENT, 60, 0.3, 4.0), (GRIPPING, 25, 0.5, 4.0)],
)
def test_contacts_of_random_shots_are_found_in_time(law: int, fps: int, noise_px: float, limit_ms: float) -> None:
    errors, missed, extra, true, rms = [], 0, 0, 0, []
    for seed in (1, 2, 3):
        shot = random_shot(seed, law=law, fps=fps, noise_px=noise_px)
        fit = view_shot(explain(shot.tracks, shot.scene))
        matched, lost, more = match(fit, shot)
        errors += matched
        missed, extra, true = missed + len(lost), extra + more, true + len(shot.contacts)
        rms.append(position_rms_px(fit, shot))
    assert np.median(np.abs(errors)) < limit_ms * 1e-3
    assert missed <= 0.1 * true
    assert extra <= 0.1 * true
    assert np.median(rms) < 0.6 * noise_px


def test_a_missed_colour_of_a_snooker_set_turns_the_trust_level_amber() -> None:
    kinds = ("cue", "yellow", "brown", "blue", "pink", "black", "red")
    places = np.column_stack([np.linspace(0.3, 2.1, 7), np.linspace(0.3, 0.9, 7)])
    shot = film(places, np.zeros((7, 2)), np.zeros((7, 3)), np.random.default_rng(1), seconds=0.5)
    table = replace(shot.scene.table, game="snooker")
    for present, level in ((kinds, "amber"), (("cue", "yellow", "green", "brown", "blue", "pink", "black"), "green")):
        tracks = replace(shot.tracks, kinds=present)
        trust = view_shot(explain(tracks, replace(shot.scene, table=table))).trust
        assert trust.level == level
        is_named = "No green ball was detected, although it belongs on the table." in trust.reasons
        assert is_named == (level == "amber")


def test_the_noise_is_that_of_moving_balls_and_agrees_with_chi2() -> None:
    """Frames of a ball at rest repeat their errors: with less noise at rest than in motion, that of motion counts."""
    shot = film(
        np.array([[0.5, 0.6], [1.6, 0.2]]), np.array([[1.0, 0.0], [0, 0]]), np.zeros((2, 3)), np.random.default_rng(2),
        seconds=1.6, noise_px=0.5,
    )  # fmt: skip
    xy = shot.tracks.xy.copy()
    xy[:, 1] = xy[0, 1]
    fit = view_shot(explain(replace(shot.tracks, xy=xy), shot.scene))
    assert fit.noise == pytest.approx(0.5 / PX_PER_M, rel=0.3)
    low, high = fit.chi2_range
    assert low < fit.chi2_per_dof < high < 2
    assert fit.trust.level == "green"


def test_a_collision_of_two_balls_is_timed_to_a_millisecond_and_errors_are_honest() -> None:
    z = []
    for seed in range(6):
        shot = film(
            np.array([[0.5, 0.6], [1.1, 0.61]]), np.array([[1.5, 0.0], [0, 0]]), np.zeros((2, 3)),
            np.random.default_rng(seed), seconds=1.6,
        )  # fmt: skip
        fit = view_shot(explain(shot.tracks, shot.scene))
        row = fit.events.kind.index("ball")
        error = fit.events.t[row] - shot.contacts[0][0]
        assert abs(error) < 1.5e-3
        assert fit.events.gap[row] < -0.03
        assert fit.events.speed[row] == pytest.approx(
            1.04, abs=0.08
        )  # it rolls by then: 5 sevenths of 1.5, less a little
        z.append(error / fit.events.t_sigma[row])
    assert np.sqrt(np.mean(np.square(z))) < 2.5


def test_the_error_of_a_path_is_honest_from_its_beginning_to_its_end() -> None:
    pulls, sigmas = [], []
    for seed in range(4):
        shot = film(
            np.array([[0.4, 0.6]]), np.array([[0.9, 0.05]]), np.zeros((1, 3)), np.random.default_rng(seed), seconds=3.0
        )
        fit = view_shot(explain(shot.tracks, shot.scene))
        values = slice(30, -5)  # from half a second after the strike on
        state = fit.trajectory.at(shot.tracks.t[values])
        off = state.xy[:, 0] - shot.xy[values, 0]
        pulls.append(off / state.sigma[:, :1])
        sigmas.append(state.sigma[:, 0])
    assert np.max(sigmas) < np.nanmedian(shot.tracks.sigma), "many frames determine more than one"
    assert 0.4 < np.sqrt(np.mean(np.square(pulls))) < 2.0


def test_a_miss_by_a_millimetre_is_no_contact() -> None:
    x = np.array([[0.5, 0.6], [1.1, 0.6 + 2 * RADIUS + 0.001]])
    shot = film(x, np.array([[1.5, 0.0], [0, 0]]), np.zeros((2, 3)), np.random.default_rng(0), seconds=1.6)
    fit = view_shot(explain(shot.tracks, shot.scene))
    assert "ball" not in fit.events.kind


@pytest.mark.parametrize(("speed", "rests"), [(0.07, 0), (0.09, 1)])
def test_a_ball_that_creeps_less_than_half_its_radius_by_itself_has_no_rest(speed: float, rests: int) -> None:
    """A swaying net that was taken for a ball moved by 13 mm: no event says that it came to rest."""
    x, v = np.array([[0.5, 0.6], [2.2, 0.2]]), np.array([[1.0, 0.1], [speed, 0.0]])
    shot = film(x, v, np.zeros((2, 3)), np.random.default_rng(1), seconds=2.4)
    fit = view_shot(explain(shot.tracks, shot.scene))
    way = np.linalg.norm(np.ptp(shot.xy[:, 1], axis=0)) / RADIUS
    assert (way > 0.5) == bool(rests)
    listed = list(zip(fit.events.kind, fit.events.a, strict=True))
    assert listed.count(("rest", shot.tracks.ids[1])) == rests


def test_a_strike_is_the_cue_ball_leaving_its_place() -> None:
    shot = random_shot(3)
    fit = view_shot(explain(shot.tracks, shot.scene))
    row = fit.events.kind.index("strike")
    assert fit.events.a[row] == "cue"
    assert fit.events.t[row] == pytest.approx(shot.strike, abs=4e-3)
    assert fit.events.frame[row] == pytest.approx(shot.strike * 30, abs=0.15)


@pytest.mark.parametrize(
    ("kinds", "is_sure"), [(("solid",), True), (("solid", "stripe"), True), (("solid", "cue"), False)]
)
def test_the_first_ball_that_moves_was_struck_where_no_cue_ball_is(kinds: tuple[str, ...], is_sure: bool) -> None:
    x, v, w = np.array([[0.5, 0.6], [2.2, 0.2]]), np.array([[1.5, 0.1], [0, 0]]), np.zeros((2, 3))
    count = len(kinds)
    shot = film(x[:count], v[:count], w[:count], np.random.default_rng(0), seconds=1.6)
    fit = view_shot(explain(replace(shot.tracks, kinds=kinds), shot.scene))
    strikes = [p for kind, p in zip(fit.events.kind, fit.events.probability, strict=True) if kind == "strike"]
    assert (max(strikes, default=0.0) > 0.8) == is_sure


def test_the_first_ball_that_moves_was_struck_where_it_drives_what_looks_like_the_cue_ball() -> None:
    """A stripe that shows its white side is taken for the cue ball."""
    x, v = np.array([[0.5, 0.6], [1.2, 0.61]]), np.array([[1.5, 0.0], [0, 0]])
    shot = film(x, v, np.zeros((2, 3)), np.random.default_rng(0), seconds=1.6)
    fit = view_shot(explain(replace(shot.tracks, kinds=("solid", "cue")), shot.scene))
    strike = fit.events.kind.index("strike")
    assert fit.events.a[strike] == shot.tracks.ids[0]
    assert fit.events.probability[strike] > 0.8


def test_a_ball_into_a_corner_is_potted_there_and_ends() -> None:
    x = np.array([[0.5, 0.5], [0.3, 0.3]])
    direction = -np.array([1.0, 1.0]) / np.sqrt(2)
    shot = film(x, np.array([1.2 * direction, [0, 0]]), np.zeros((2, 3)), np.random.default_rng(1), pocket=0.045)
    fit = view_shot(explain(shot.tracks, shot.scene))
    row = fit.events.kind.index("pocket")
    assert (fit.events.a[row], fit.events.b[row]) == ("solid-1", "top-left")
    gone = shot.tracks.t[~np.isfinite(shot.xy[:, 1, 0])][0]
    assert fit.events.t[row] == pytest.approx(gone, abs=0.06)
    assert np.isnan(fit.trajectory.at(gone + 0.5).xy[1]).all()


def test_a_ball_that_is_seen_while_it_falls_was_potted_when_it_came_into_the_mouth() -> None:
    """In the jaws it seems to bounce and to crawl, as in a clip of 15 frames per second."""
    x = np.array([[0.5, 0.5], [0.3, 0.3]])
    direction = -np.array([1.0, 1.0]) / np.sqrt(2)
    shot = film(
        x, np.array([1.2 * direction, [0, 0]]), np.zeros((2, 3)), np.random.default_rng(1), fps=15, pocket=0.045
    )
    tracks = shot.tracks
    gone = int(np.flatnonzero(~np.isfinite(shot.xy[:, 1, 0]))[0])
    fall = RADIUS * np.array([[1.2, 1.35], [1.1, 1.25], [1.2, 1.15], [1.0, 1.25]])
    columns = {name: getattr(tracks, name).copy() for name in ("xy", "sigma", "sigma_along")}
    for name, values in (("xy", fall), ("sigma", 1e-3), ("sigma_along", 1e-3)):
        columns[name][gone : gone + len(fall), 1] = values
    fit = view_shot(explain(replace(tracks, **columns), shot.scene))
    row = fit.events.kind.index("pocket")
    assert (fit.events.a[row], fit.events.b[row]) == ("solid-1", "top-left")
    assert fit.events.t[row] == pytest.approx(tracks.t[gone], abs=0.07)
    assert not [k for k in range(len(fit.events)) if (fit.events.kind[k], fit.events.a[k]) == ("cushion", "solid-1")]
    assert not [one for one in fit.explanation.moments if one.ball == "solid-1" and one.best.cause == "unexplained"]


def test_a_ball_at_rest_has_a_position_before_and_after_its_detections() -> None:
    shot = random_shot(2)
    tracks = replace(shot.tracks, xy=shot.tracks.xy.copy())
    tracks.xy[:20, 2] = np.nan
    fit = view_shot(explain(tracks, shot.scene))
    np.testing.assert_allclose(fit.trajectory.at(0.05).xy[2], shot.xy[0, 2], atol=1e-3)


def test_nothing_moves_and_nothing_happens() -> None:
    x = np.array([[0.4, 0.5], [1.4, 0.7]])
    shot = film(x, np.zeros((2, 2)), np.zeros((2, 3)), np.random.default_rng(5), seconds=2.0)
    fit = view_shot(explain(shot.tracks, shot.scene))
    assert len(fit.events) == 0
    assert fit.trust.level == "green"
    assert not fit.moving.any()
    np.testing.assert_allclose(fit.trajectory.at(1.0).xy, x, atol=5e-4)


def test_a_ball_whose_detections_leap_to_and_fro_rests() -> None:
    shot = random_shot(3)
    still = int(np.argmin(np.nanmax(np.linalg.norm(shot.xy - shot.xy[0], axis=2), axis=0)))
    tracks = replace(shot.tracks, xy=shot.tracks.xy.copy())
    leaps = np.random.default_rng(4).integers(0, 2, len(tracks.t) // 5 + 1).repeat(5)[: len(tracks.t)]
    tracks.xy[:, still] = shot.xy[0, still] + 0.3 * RADIUS * leaps[:, None] * [1.0, 0.3]
    fit = view_shot(explain(tracks, shot.scene))
    assert not fit.moving[:, still].any()
    assert not {k for k, a in zip(fit.events.kind, fit.events.a, strict=True) if a == tracks.ids[still]}
    assert fit.events.kind.count("strike") == 1


def test_a_strike_within_a_gap_is_found_from_the_way_back_to_the_place_of_rest() -> None:
    shot = random_shot(3)
    tracks = replace(shot.tracks, xy=shot.tracks.xy.copy())
    hidden = (tracks.t > shot.strike - 0.05) & (tracks.t < shot.strike + 0.15)
    tracks.xy[hidden, tracks.ids.index("cue")] = np.nan
    fit = view_shot(explain(tracks, shot.scene))
    row = fit.events.kind.index("strike")
    assert fit.events.a[row] == "cue"
    assert abs(fit.events.t[row] - shot.strike) < 3 * fit.events.t_sigma[row]
    assert fit.events.t_sigma[row] < 0.25


def test_a_failed_fit_shows_the_measurements(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("no solution")

    monkeypatch.setattr("models.estimation.reconstruction.explain_shot.refine_graph", fails)
    shot = random_shot(3)
    fit = view_shot(explain(shot.tracks, shot.scene))
    assert fit.trust.level == "red"
    assert "no solution" in fit.trust.reasons[0]
    assert np.isfinite(fit.trajectory.at(shot.tracks.t).xy[shot.tracks.is_observed]).all()


def test_the_error_of_a_rest_reaches_from_when_it_looks_still_to_when_it_stops() -> None:
    shot = film(
        np.array([[0.5, 0.6], [2.0, 0.3]]), np.array([[0.5, 0.0], [0, 0]]), np.zeros((2, 3)),
        np.random.default_rng(0), seconds=6.0,
    )  # fmt: skip
    fit = view_shot(explain(shot.tracks, shot.scene))
    row = fit.events.kind.index("rest")
    to_go = np.linalg.norm(shot.xy[:, 0] - shot.xy[-1, 0], axis=1)
    looks_still, stops = (shot.tracks.t[np.argmax(to_go < share * RADIUS)] for share in (0.025, 1e-6))
    t, sigma, frame = fit.events.t[row], fit.events.t_sigma[row], shot.tracks.t[1] - shot.tracks.t[0]
    assert looks_still - frame < t - sigma < t + sigma < stops + frame
    assert 2 * sigma > 0.8 * (stops - looks_still) > 0.08
    until = shot.tracks.truncate_after(float(fit.events.t[row]))
    events = view_shot(explain(until, shot.scene)).events
    assert all(t <= until.t[-1] for t, kind in zip(events.t, events.kind, strict=True) if kind == "rest")


def test_the_coefficients_of_the_cloth_come_out() -> None:
    shot = random_shot(6)
    values = {p.name: p for p in view_shot(explain(shot.tracks, shot.scene)).parameters}
    assert values["rolling_resistance.mu"].value == pytest.approx(0.0125, abs=0.001)
    assert not values["rolling_resistance.mu"].prior_only
    assert 0.12 < values["sliding_friction.mu"].value < 0.28


def test_clips_may_begin_and_end_in_motion() -> None:
    shot = random_shot(4)
    rows = np.arange(18, 70)
    cut = only(shot.tracks, rows)
    fit = view_shot(explain(cut, shot.scene))
    miss = (fit.trajectory.at(cut.t).xy - shot.xy[rows])[fit.moving] * PX_PER_M
    assert np.sqrt(np.nanmean(miss**2)) < 0.5
    assert (fit.moving & fit.accepted).sum() > 0.9 * fit.moving.sum()


def test_a_ball_that_obeys_no_law_is_measured_and_not_trusted() -> None:
    shot = random_shot(1, seconds=2.4)
    t = shot.tracks.t
    tracks = replace(shot.tracks, xy=shot.tracks.xy.copy())
    tracks.xy[:, 2] = np.stack([1.2 + 0.3 * np.sin(3 * t), 0.6 + 0.2 * np.cos(5 * t)], axis=1)
    sigma = np.full(tracks.sigma.shape, 0.3 / PX_PER_M)
    tracks = replace(tracks, sigma=sigma, sigma_along=sigma)
    fit = view_shot(explain(tracks, shot.scene))
    assert fit.trajectory.at(t[40:50]).measured[:, 2].any()
    assert fit.trust.level != "green"
    values = tracks.is_observed[:, 2]
    assert np.abs(fit.residual[values, 2]).max() < 0.05


def test_outliers_and_lost_frames_do_little_harm() -> None:
    shot = random_shot(3, missing=0.25)
    tracks = replace(shot.tracks, xy=shot.tracks.xy.copy())
    tracks.xy[60, 0] += 0.08
    tracks.xy[90, 1] -= 0.1
    fit = view_shot(explain(tracks, shot.scene))
    _, missed, extra = match(fit, shot)
    assert not missed
    assert extra == 0
    assert position_rms_px(fit, shot) < 0.5


def test_noise_is_not_taken_for_motion() -> None:
    shot = random_shot(3)
    sigma = np.full(shot.tracks.sigma.shape, 1e-3)
    anywhere = np.random.default_rng(0).uniform(0, 1, shot.tracks.xy.shape)
    fit = view_shot(explain(replace(shot.tracks, xy=anywhere, sigma=sigma, sigma_along=sigma), shot.scene))
    assert fit.trust.level == "red"


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5])
def test_few_frames_are_no_error(count: int) -> None:
    shot = random_shot(3)
    fit = view_shot(explain(only(shot.tracks, np.arange(count) + 30), shot.scene))
    assert fit.residual.shape == (count, 3, 2)


def test_empty_tracks_give_an_empty_fit() -> None:
    shot = random_shot(3)
    blind = replace(shot.tracks, xy=np.full_like(shot.tracks.xy, np.nan))
    fit = view_shot(explain(blind, scene()))
    assert len(fit.events) == 0
    assert fit.trust.level != "green"
    assert np.isnan(fit.trajectory.at(1.0).xy).all()


def test_the_same_tracks_give_the_same_bytes() -> None:
    shot = random_shot(2)
    one, two = (view_shot(explain(shot.tracks, shot.scene)) for _ in range(2))
    assert one.trajectory.position.tobytes() == two.trajectory.position.tobytes()
    assert one.events.t.tobytes() == two.events.t.tobytes()


def test_progress_ends_at_one() -> None:
    shot = random_shot(2, balls=2)
    values: list[float] = []
    view_shot(explain(shot.tracks, shot.scene, progress=values.append))
    assert values == sorted(values)
    assert values[-1] == 1.0
