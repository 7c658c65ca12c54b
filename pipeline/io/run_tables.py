"""Writing of the tables of a run: tracks.csv, trajectory.csv and scene.json."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from models.core.ball_look import format_colour
from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.fit_result import SPIN_STATES, Fit, Parameter, ShotExplanation, ShotNumbers, WholeShotFit
from models.core.scene import Camera, Scene
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from models.core.typing import FloatArray
from pipeline.io.corrections_file import describe_corrections
from pipeline.io.csv_tables import SHOT_NUMBER, Columns, write_columns, write_states
from pipeline.io.strict_json import format_strict_json, replace_nonfinite
from pipeline.reporting.text.check_list import select_check_places
from pipeline.reporting.text.fit_sentences import format_whole_shot, note_corrections
from pipeline.reporting.text.text_formatting import summarize_trust
from video.io.clip import Clip

TRAJECTORY_HZ = 1000.0
DEFAULT_MODEL = ("rolling_resistance", "sliding_friction", "spin_decay", "cushion_restitution", "ball_restitution")
# Fitted groups of parameters that are no effects of the catalogue.
TABLE_PARAMETERS = ("ball_size", "collision_radius", "nose")


def write_tracks(scene: Scene, tracks: Tracks, fit: Fit, path: Path) -> None:
    """Write tracks.csv: one row per ball and distinct frame, observed or filled in by the physics (`observed` 0).

    Args:
        scene: Table and camera.
        tracks: Tracks of T frames and N balls.
        fit: The fit of the shot.
        path: File to write.
    """
    filled = fit.trajectory.at(tracks.t)
    is_observed = tracks.is_observed
    row, ball = np.nonzero(is_observed | (np.isfinite(filled.xy[..., 0]) & ~filled.measured))
    observed = is_observed[row, ball]
    frame = tracks.frame[row]
    xy = np.where(observed[:, None], tracks.xy[row, ball], filled.xy[row, ball])
    computed = scene.camera.to_pixels(filled.xy[row, ball], scene.table.ball_radius, frame)
    px = np.where(observed[:, None], tracks.px[row, ball], computed)
    radius = np.where(observed, tracks.radius_px[row, ball], scene.camera.radius_px(xy, scene.table.ball_radius))
    columns: Columns = {
        "shot": np.full(len(row), SHOT_NUMBER), "frame": frame, "t": tracks.t[row],
        "id": [tracks.ids[k] for k in ball], "kind": [tracks.kinds[k] for k in ball],
        "x_px": px[:, 0], "y_px": px[:, 1], "x": xy[:, 0], "y": xy[:, 1],
        "sigma": np.where(observed, tracks.sigma[row, ball], filled.sigma[row, ball]),
        "radius_px": radius, "observed": observed.astype(np.int64),
    }  # fmt: skip
    write_columns(columns, path)


def write_trajectory(motion: Trajectory, path: Path) -> None:
    """Write trajectory.csv: the fitted motion at `TRAJECTORY_HZ`, ball by ball.

    Args:
        motion: Fitted motion of N balls.
        path: File to write.
    """
    first = float(motion.start.min()) if len(motion.start) else 0.0
    last = float(motion.end.max()) if len(motion.end) else 0.0
    t = np.arange(math.ceil(first * TRAJECTORY_HZ), math.floor(last * TRAJECTORY_HZ) + 1) / TRAJECTORY_HZ
    write_states(motion.ids, t, motion.at(t), path)


def write_scene(
    clip: Clip, scene: Scene, tracks: Tracks, fit: Fit, path: Path, corrections: Corrections = NO_CORRECTIONS
) -> None:
    """Write scene.json: table, calibration, fitted model, trust level, explanation and places to check.

    Args:
        scene: Table and camera.
        tracks: Tracks of T frames and N balls.
        fit: The fit of the shot.
        path: File to write.
        corrections: What a person corrected.
    """
    table, trust, scene = scene.table, fit.trust, note_corrections(scene, corrections, tracks)
    document = {
        "scene": "billiards",
        "units": "m",
        "fps": float(clip.fps),
        "table": {"name": table.name, "game": table.game, "length": table.length, "width": table.width,
                  "pockets": table.pockets, "cloth_lab": scene.cloth_lab.tolist()},
        "ball_radius": table.ball_radius,
        "ball_size": _describe_ball_size(scene, fit),
        "ball_mass": table.ball_mass,
        "image": _describe_image(scene.camera, table.ball_radius, scene),
        "calibration": _describe_calibration(scene),
        "model": sorted(_describe_effects(fit)) or list(DEFAULT_MODEL),
        "effects": _describe_effects(fit),
        "laws": None if fit.laws is None else _describe_laws(fit, fit.laws, table.ball_radius),
        "laws_reason": format_whole_shot(fit),
        "balls": _describe_balls(tracks, fit),
        "fit": _describe_fit_quality(tracks, fit),
        "shot_numbers": describe_shot_numbers(fit.shot_numbers),
        "trust": summarize_trust(trust),
        "explanation": _describe_explanation(fit.explanation),
        "check_here": _describe_check_places(scene, tracks, fit),
        "set_by_hand": {**describe_corrections(corrections), "outcomes": [asdict(one) for one in fit.mark_outcomes]},
        "notes": list(dict.fromkeys([*clip.notes, *fit.profile_misfits, *scene.notes])),
        "clip": {"sha256": clip.digest, "frames": clip.frame_count, "distinct": len(clip.distinct_frames),
                 "repeats": clip.frames[clip.is_duplicate].tolist(), "first_frame": clip.first_frame,
                 "begins": float(clip.t[0]), "seconds": float(clip.t[-1] - clip.t[0])},
    }  # fmt: skip
    path.write_text(format_strict_json(document), encoding="utf-8")


def _describe_ball_size(scene: Scene, fit: Fit) -> dict[str, Any]:
    """Describe the ball size that all stages use, and its independent estimates, with that of the contacts."""
    from models.estimation.reconstruction.plausibility import estimate_contact_ball_size  # slow to import

    contacts = estimate_contact_ball_size(fit.parameters, scene.table.ball_radius)
    size, estimates = scene.ball_size, [*scene.ball_size_estimates, *([] if contacts is None else [contacts])]
    return {
        "radius": size.radius, "sigma": size.sigma, "source": size.source,
        "estimates": [{"source": one.source, "radius": one.radius, "sigma": one.sigma} for one in estimates],
    }  # fmt: skip


def _describe_image(camera: Camera, radius: float, scene: Scene) -> dict[str, Any]:
    centre = np.array([scene.table.length / 2, scene.table.width / 2])
    scale = 1 / math.sqrt(abs(float(np.linalg.det(camera.metres_per_pixel(centre, radius)))))
    origin = camera.to_pixels(np.zeros(2), radius)
    return {"px_per_m": scale, "origin_px": origin.tolist(), "width_px": camera.width_px, "height_px": camera.height_px}


def _describe_calibration(scene: Scene) -> dict[str, Any]:
    camera = scene.camera
    return {
        "plane": camera.plane,
        "matrix": camera.matrix.tolist(),
        "matrix_about": "(x, y, z above the cloth, 1) in m to homogeneous px of the reference frame",
        "corners_px": camera.corners_px.tolist(),
        "corner_covariance_px2": camera.corner_covariance.tolist(),
        "camera_height": camera.height,
        "camera_height_sigma": camera.height_sigma,
        "scale_sigma": camera.scale_sigma,
        "camera_moves": camera.motion is not None,
    }


def _describe_effects(fit: Fit) -> dict[str, dict[str, Any]]:
    """Describe the parameters of effects; those of `TABLE_PARAMETERS` are in `laws` and `ball_size`."""
    effects: dict[str, dict[str, Any]] = {}
    for p in fit.parameters if fit.whole_shot is None else fit.whole_shot.parameters:
        effect, _, name = p.name.partition(".")
        if effect not in TABLE_PARAMETERS:
            effects.setdefault(effect, {})[name] = _describe_parameter(p)
    return effects


def _describe_parameter(p: Parameter) -> dict[str, Any]:
    return {"value": p.value, "sigma": p.sigma, "unit": p.unit, "prior_only": p.prior_only}


def _describe_laws(fit: Fit, laws: WholeShotFit, radius: float) -> dict[str, Any]:
    """Describe the contact models, the radius of contact, and the offsets of the cushion noses."""
    sentence = format_whole_shot(fit)
    if laws.solution is None:
        misfit = None if laws.misfit is None else asdict(laws.misfit)
        return {"cushion": None, "ball": None, "why": sentence, "misfit": misfit}
    parameters = {p.name: p for p in laws.solution.parameters}
    factor = parameters["collision_radius.factor"]
    size = replace(factor, value=factor.value * radius, sigma=factor.sigma * radius, unit="m")
    noses = {
        name.partition(".")[2]: _describe_parameter(p) for name, p in parameters.items() if name.startswith("nose.")
    }
    return {
        "cushion": laws.solution.cushion_model,
        "ball": laws.solution.ball_model,
        "why": sentence,
        "chi2_per_dof": laws.solution.chi2_per_dof,
        "times_noise": math.sqrt(laws.solution.chi2_per_dof),
        "collision_radius": _describe_parameter(size),
        "noses": noses,
    }


def _describe_balls(tracks: Tracks, fit: Fit) -> list[dict[str, Any]]:
    """Describe each ball with its initial state and covariance.

    If contact models explain the whole shot, this is the state at the strike with its spin (7 values).
    """
    balls, motion = [], fit.trajectory
    for k, ball in enumerate(motion.ids):
        rows = np.flatnonzero(motion.ball == k)
        column = tracks.ids.index(ball)
        look = tracks.looks[column]
        facts: dict[str, Any] = {"id": ball, "kind": tracks.kinds[column], "name": look.name,
                                 "number": look.number or None, "colour": format_colour(look.colour)}  # fmt: skip
        if fit.whole_shot is not None and ball in fit.whole_shot.ids:
            at = fit.whole_shot.ids.index(ball)
            facts |= _describe_state(fit.whole_shot.t, fit.whole_shot.state[at], fit.whole_shot.covariance[at])
        elif len(rows):
            first = rows[0]
            state = [*motion.position[first, 0], *motion.position[first, 1], *motion.spin[first, 0]]
            facts |= _describe_state(motion.start[first], state, motion.covariance[first])
        balls.append(facts)
    return balls


def _describe_state(t: float, state: Sequence[float] | FloatArray, covariance: FloatArray) -> dict[str, Any]:
    names = ("x", "y", "vx", "vy", "wx", "wy", "wz")
    return {"t": t, **dict(zip(names, state, strict=True)), "covariance": covariance.tolist()}


def _describe_check_places(scene: Scene, tracks: Tracks, fit: Fit) -> list[dict[str, Any]]:
    """Describe the places where the explanation is least sure or a track most likely wrong, worst first."""
    from pipeline.reporting.text.check_sentences import format_check_place  # slow to import

    return [
        {
            "frame": place.frame, "t": place.t, "balls": list(place.balls), "x": place.xy[0], "y": place.xy[1],
            **dict(zip(("x_px", "y_px"), scene.camera.to_pixels(place.xy, scene.table.ball_radius, place.frame),
                       strict=True)),
            "uncertainty": place.uncertainty, "codes": list(dict.fromkeys(one.code for one in place.reasons)),
            "reason": format_check_place(place, fit.naming),
        }
        for place in select_check_places(tracks, fit, scene.table)
    ]  # fmt: skip


def _describe_fit_quality(tracks: Tracks, fit: Fit) -> dict[str, float]:
    """Describe noise, misfit, and the ball-seconds of motion that accepted fits explain."""
    step = np.gradient(tracks.t)[:, None] if len(tracks.t) > 1 else np.zeros((len(tracks.t), 1))
    return {
        "noise_m": fit.noise,
        "chi2_per_dof": fit.chi2_per_dof,
        "moving_s": float(np.sum(step * fit.moving)),
        "accepted_s": float(np.sum(step * (fit.moving & fit.accepted))),
    }


def _describe_explanation(explanation: ShotExplanation) -> dict[str, Any]:
    """Describe an explanation for scene.json.

    Args:
        explanation: All moments with their hypotheses.

    Returns:
        JSON object.
    """
    return {
        "moving_at_start": list(explanation.moving_at_start),
        "moments": [
            {
                "ball": moment.ball, "t": moment.t, "t_sigma": moment.t_sigma,
                "x": float(moment.xy[0]), "y": float(moment.xy[1]), "doubts": list(moment.doubts),
                "hypotheses": [
                    {"cause": one.cause, "other": one.other, "probability": one.probability}
                    for one in moment.hypotheses
                ],
            }
            for moment in explanation.moments
        ],
    }  # fmt: skip


def describe_shot_numbers(shots: Sequence[ShotNumbers]) -> list[dict[str, Any]]:
    """Describe the numbers of shots for scene.json.

    Args:
        shots: Numbers per shot.

    Returns:
        One object of strict JSON per shot.
    """
    return [
        {
            "t": shot.t, "cue": shot.cue, "first": shot.first, "spin_state": shot.spin_state,
            "spin_state_probabilities": dict(zip(SPIN_STATES, shot.spin_state_probabilities, strict=False)),
            "potted": [{"ball": a, "pocket": b} for a, b in zip(shot.potted, shot.pockets, strict=True)],
            "numbers": [replace_nonfinite(asdict(one)) for one in shot.numbers],
        }
        for shot in shots
    ]  # fmt: skip
