"""The scene of a simulator from outside: its parameters, and its derivatives."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from diagnosis.fitting.diagnosis_windows import fit_initial_windows
from diagnosis.fitting.hypothesis_fits import build_diagnosis_problem
from diagnosis.fitting.prediction_windows import build_prediction_windows, select_predictable
from diagnosis.fitting.shot_preparation import WHITE_NOISE
from models.core.recording import Recording, ReferenceFrame
from models.core.typing import FloatArray, IntArray
from models.estimation.gap_scenes.mechanism_inputs import InputHistory
from models.estimation.gap_scenes.outside_simulator import Stretch, simulate_motions
from models.estimation.gap_scenes.simulator_scene import SimulatorScene, build_simulator_scene
from models.estimation.multiple_shooting.shooting_fit import ShootingOptions, fit_windows
from models.estimation.multiple_shooting.shooting_windows import fix_parameters
from models.physics.mechanisms.mechanism_effect import Scale

mujoco = pytest.importorskip("mujoco", reason="mujoco is an extra")
SWING = """<body pos="{0} 0 0"><joint name="{1}" type="hinge" axis="0 1 0" damping="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -{2}" size="0.02" mass="0.5" contype="0" conaffinity="0"/></body>"""
BALL = '<body name="ball"><freejoint/><geom type="sphere" size="0.05" mass="0.1"/></body>'


def build_scene(bodies: str, names: tuple[str, ...]) -> tuple[SimulatorScene, Recording]:
    """Build the scene of a MuJoCo file, and a recording of what moves evenly in it."""
    from pipeline.io.simulators.mujoco_simulator import MujocoSimulator

    simulator = MujocoSimulator(mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>"))
    t = np.arange(60) / 100
    places = np.sin(3 * t[:, None] + np.arange(len(names)))[:, :, None]
    recording = Recording(
        0,
        np.arange(60),
        t,
        names,
        places,
        np.full((60, len(names)), 1e-3),
        ReferenceFrame(("q",), "rad", "joints"),
        True,
    )
    return build_simulator_scene(simulator, (recording,), {0: InputHistory(t, np.zeros((60, 0)))}), recording


def linearize(
    scene: SimulatorScene, recording: Recording, start: FloatArray, needed: IntArray
) -> tuple[FloatArray, FloatArray]:
    plan = scene.plan_differences(recording, start, scene.neutral, needed)
    return scene.linearize_positions(recording, scene.simulate([plan.stretch])[0], plan)


def test_joints_that_do_not_change_each_other_share_simulations_and_keep_their_derivatives():
    scene, recording = build_scene(SWING.format(0, "one", 0.4) + SWING.format(1, "two", 0.3), ("one", "two"))
    together = replace(
        scene, simulator=replace_trees(scene.simulator)
    )  # one tree: every derivative has a simulation of its own
    start = np.array([0.5, -0.4, 1.0, 0.5])
    needed = np.flatnonzero([owner in ("joint_friction", "air_drag", "gravity") for owner in scene.owners])
    shared, alone = (linearize(one, recording, start, needed) for one in (scene, together))
    assert scene.parameter_trees[needed].max() == 1
    for mine, other in zip(shared, alone, strict=True):
        np.testing.assert_allclose(mine, other, atol=1e-9)
    assert np.abs(alone[1]).max() > 0.1


LINK = '<geom type="capsule" fromto="0 0 0 0 0 -{0}" size="0.02" mass="{1}" contype="0" conaffinity="0"/>'
DOUBLE_PENDULUM = (
    f'<body><joint name="shoulder" type="hinge" axis="0 1 0"/>{LINK.format(0.3, 0.5)}<body pos="0 0 -0.3">'
    f'<joint name="elbow" type="hinge" axis="0 1 0"/>{LINK.format(0.25, 0.3)}</body></body>'
)


def test_the_motion_of_a_joint_without_a_sensor_is_found_whichever_way_it_swings():
    """From rest alone, the fit ends in a wrong minimum, with 84 times the variance of the noise."""
    scene, recording = build_scene(DOUBLE_PENDULUM, ("shoulder",))
    rng = np.random.default_rng(0)
    swing = np.array([-0.2, -1.05, 0.7, -9.6])
    seen = scene.predict_positions(recording, swing, scene.neutral, ())
    shot = replace(recording, positions=seen + 1e-3 * rng.standard_normal(seen.shape))
    own = build_simulator_scene(scene.simulator, (shot,), scene.histories)
    model = own.build_model((shot,), (), np.zeros(len(own.neutral), bool))
    fixed = fix_parameters(model, own.neutral, np.zeros(len(own.neutral), bool), own.priors)
    options = ShootingOptions(iterations=25, shot_iterations=10, is_smooth=own.is_smooth)
    fitted = fit_windows(fixed, options=options)
    assert fitted.chi2_per_dof < 1.5


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
def test_a_spring_beside_a_simulator_moves_a_joint_as_one_in_its_file(integrator: str):
    """A millisecond later, it braked the joint by a milliradian in half a second, and gravity fitted better."""
    from pipeline.io.simulators.mujoco_simulator import MujocoSimulator

    body, t = SWING.format(0, "hinge", 0.4), np.arange(101) / 100
    text = f'<mujoco><option timestep="0.002" integrator="{integrator}"/><worldbody>{body}</worldbody></mujoco>'
    paths = []
    for joint, values in (("", {"spring": (np.array([0.4]), np.zeros(1))}), (' stiffness="0.4"', {})):
        model = mujoco.MjModel.from_xml_string(text.replace(' damping="0.02"', joint))
        history = InputHistory(t, np.zeros((101, 0)))
        stretch = Stretch(0, (0.0, 1.0), history, np.array([[0.6, 0.0]]), [values])
        paths.append(simulate_motions(MujocoSimulator(model), [stretch], (Scale("rad"),))[0].states[0, :, 0])
    np.testing.assert_allclose(paths[0], paths[1], atol=1e-4)


@pytest.mark.parametrize("names", [("shoulder",), ("shoulder", "elbow")])
def test_a_joint_without_a_sensor_is_predicted_as_far_as_its_start_is_known(names: tuple[str, ...]):
    """Its start is hardly known from 15 rows of the other joint: what it does later says nothing of a gap."""
    scene, recording = build_scene(DOUBLE_PENDULUM, names)
    rng = np.random.default_rng(0)
    seen = scene.predict_positions(recording, np.array([-0.2, -1.05, 0.7, -9.6]), scene.neutral, ())
    shot = replace(recording, positions=seen + 1e-3 * rng.standard_normal(seen.shape))
    problem = build_diagnosis_problem(build_simulator_scene(scene.simulator, (shot,), scene.histories), WHITE_NOISE)
    fitted = fit_initial_windows(problem, (shot,))
    windows = build_prediction_windows(problem, (shot,))
    chosen = select_predictable(problem, windows, fitted, rng)
    rows = [sum(int(one.is_predicted.any(axis=1).sum()) for one in some) for some in (windows, chosen)]
    assert (rows[1] < rows[0] / 2) == (len(names) == 1)


def replace_trees(simulator):  # type: ignore[no-untyped-def]
    """Return the simulator with all joints in one tree."""
    from pipeline.io.simulators.mujoco_simulator import MujocoSimulator

    other = MujocoSimulator(simulator.model)
    other.joints = tuple(replace(joint, tree=0) for joint in other.joints)
    return other


def test_a_free_body_has_one_drag_for_its_place_and_no_spring():
    scene, _ = build_scene(BALL, ("ball.x", "ball.y", "ball.z"))
    names = {effect.name: [prior.name for prior in effect.parameters] for effect in scene.effects}
    assert names["air_drag"] == ["k_ball", "k_ball_turn"]
    assert names["sensor_scale"] == ["factor"]
    assert "spring" in scene.not_tested


SLIDE = """<body name="{0}" pos="{1} 0 0"><joint name="{0}" type="slide" axis="1 0 0"/>
<geom type="sphere" size="0.1" mass="1"/></body>"""


@pytest.mark.parametrize(
    ("constraint", "gap", "trees"),
    [
        ("", 1.0, 2),
        ("", 0.21, 1),
        ('<equality><connect body1="one" body2="two" anchor="0.5 0 0"/></equality>', 1.0, 1),
        ('<equality><joint joint1="one" joint2="two"/></equality>', 1.0, 1),
    ],
)
def test_bodies_that_touch_or_are_tied_do_not_share_simulations(constraint: str, gap: float, trees: int):
    from pipeline.io.simulators.mujoco_simulator import MujocoSimulator

    bodies = SLIDE.format("one", 0) + SLIDE.format("two", 1)
    text = f"<mujoco><worldbody>{bodies}</worldbody>{constraint}</mujoco>"
    simulator = MujocoSimulator(mujoco.MjModel.from_xml_string(text))
    found = simulator.find_touching(np.array([[0.0, 0.0], [1.0 - gap, 0.0]]))
    assert len({joint.tree for joint in found.joints}) == trees
    assert len({joint.tree for joint in pickle.loads(pickle.dumps(found)).joints}) == trees


SERVO = """<mujoco><worldbody><body><joint name="arm" type="hinge" axis="0 1 0" damping="2" armature="0.2"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.3"/></body></worldbody>
<actuator><position name="servo" joint="arm" kp="100" kv="2" forcerange="-{0} {0}"/></actuator></mujoco>"""


def stated(scene: SimulatorScene) -> FloatArray:
    """Return the values of all parameters that a file states."""
    return np.array([prior.value for prior in scene.priors])


def build_servo_scene() -> tuple[SimulatorScene, tuple[Recording, ...]]:
    """Build the scene of a servo whose largest force is six times that of its file, and recordings of steps."""
    from pipeline.io.simulators.mujoco_simulator import MujocoSimulator

    simulators = [MujocoSimulator(mujoco.MjModel.from_xml_string(SERVO.format(limit))) for limit in (1.0, 6.0)]
    t, still = np.arange(60) / 50, np.zeros((60, 1, 1))
    asked = {shot: InputHistory(t, np.where(t > 0.1, size, 0.0)[:, None]) for shot, size in enumerate((1.0, -0.7))}
    reference = ReferenceFrame(("q",), "rad", "joints")
    sigma = np.full((60, 1), 1e-3)
    blank = [Recording(shot, np.arange(60), t, ("arm",), still, sigma, reference, True) for shot in asked]
    true = build_simulator_scene(simulators[1], tuple(blank), asked)
    seen = tuple(replace(one, positions=true.predict_positions(one, np.zeros(2), stated(true), ())) for one in blank)
    return build_simulator_scene(simulators[0], seen, asked), seen


def test_a_largest_force_far_from_that_of_the_file_is_found_in_a_few_steps():
    """It is 17 usual strengths away, and a step of one of them at most would need as many."""
    scene, seen = build_servo_scene()
    names = [f"{effect.name}.{prior.name}" for effect in scene.effects for prior in effect.parameters]
    free = np.array([name == "actuator_gain.limit" for name in names])
    model = fix_parameters(scene.build_model(seen, (), free), stated(scene), free, scene.priors)
    fitted = fit_windows(model, options=ShootingOptions(iterations=10, is_smooth=True))
    assert fitted.shared[0] == pytest.approx(6.0, rel=0.02)


def test_windows_that_are_simulated_together_are_those_simulated_alone():
    scene, seen = build_servo_scene()
    model = scene.build_model(seen, ())
    starts, values = [np.array([0.1, 0.2]), np.array([0.0, -0.3])], [stated(scene)] * 2
    for has_jacobians, call in ((True, "linearize"), (False, "simulate")):
        together = model.simulate_ahead([0, 1], starts, values, has_jacobians)
        for k, start in enumerate(starts):
            one, other = (getattr(which, call)(k, start, stated(scene)) for which in (together, model))
            np.testing.assert_allclose(one.residual, other.residual, rtol=1e-9, atol=1e-9)
            if has_jacobians:
                np.testing.assert_allclose(one.shared_jacobian, other.shared_jacobian, rtol=1e-6, atol=1e-6)


def test_a_fit_simulates_once_per_step_where_derivatives_cost_nothing(monkeypatch: pytest.MonkeyPatch):
    scene, seen = build_servo_scene()
    free = np.array(
        [f"{owner}.{one.name}" == "actuator_gain.limit" for owner, one in zip(scene.owners, scene.priors, strict=True)]
    )
    counts, fits, calls, simulate = [], [], [], SimulatorScene.simulate
    monkeypatch.setattr(SimulatorScene, "simulate", lambda own, some: calls.append(1) or simulate(own, some))
    for is_free in (False, True):
        scene.simulator.is_free_beside_others = is_free  # type: ignore[misc]
        calls.clear()
        model = fix_parameters(scene.build_model(seen, (), free), stated(scene), free, scene.priors)
        fits.append(fit_windows(model, options=ShootingOptions(iterations=10, is_smooth=True)))
        counts.append(len(calls))
    assert np.array_equal(fits[0].shared, fits[1].shared)
    assert counts[1] < 0.7 * counts[0]


MOTOR = SERVO.replace('<position name="servo" joint="arm" kp="100" kv="2" forcerange="-{0} {0}"/>', "{0}")


@pytest.mark.parametrize(
    ("actuator", "strengths"),
    [
        ('<motor name="motor" joint="arm"/>', ["gain"]),
        ('<motor name="motor" joint="arm" forcerange="-1 1"/>', ["gain", "limit", "fall"]),
        ('<position name="servo" joint="arm" kp="100" kv="2"/>', ["gain", "damping"]),
    ],
)
def test_strengths_that_change_nothing_of_the_actuators_of_a_file_are_left_out(actuator: str, strengths: list[str]):
    from pipeline.io.simulators.mujoco_simulator import MujocoSimulator

    simulator = MujocoSimulator(mujoco.MjModel.from_xml_string(MOTOR.format(actuator)))
    t = np.arange(60) / 50
    asked = {0: InputHistory(t, np.sin(t)[:, None])}
    reference = ReferenceFrame(("q",), "rad", "joints")
    positions = np.sin(t)[:, None, None]
    shot = Recording(0, np.arange(60), t, ("arm",), positions, np.full((60, 1), 1e-3), reference, True)
    scene = build_simulator_scene(simulator, (shot,), asked)
    effect = next(one for one in scene.effects if one.name == "actuator_gain")
    assert [one.name for one in effect.parameters] == strengths
    before = scene.predict_positions(shot, np.zeros(2), stated(scene), ())
    names = [f"{one.name}.{prior.name}" for one in scene.effects for prior in one.parameters]
    for name in strengths:
        changed = np.where(np.array(names) == f"actuator_gain.{name}", 0.25, stated(scene))
        assert np.abs(scene.predict_positions(shot, np.zeros(2), changed, ()) - before).max() > 1e-6


SLIDERS = """<mujoco><option gravity="0 0 0"/><worldbody>
<body><joint name="strong" type="slide" axis="1 0 0"/><geom size="0.1" mass="2" contype="0" conaffinity="0"/></body>
<body><joint name="weak" type="slide" axis="0 1 0"/><geom size="0.1" mass="2" contype="0" conaffinity="0"/></body>
</worldbody><actuator><motor name="strong" joint="strong"/>
<motor name="weak" joint="weak" gear="2" forcerange="-3 3"/></actuator></mujoco>"""


def build_slider_scene(power: FloatArray) -> tuple[SimulatorScene, Recording]:
    """Build the scene of two sliders, of which one has a largest force of 6 N, with inputs (T,) for both."""
    from pipeline.io.simulators.mujoco_simulator import MujocoSimulator

    simulator = MujocoSimulator(mujoco.MjModel.from_xml_string(SLIDERS))
    t = np.arange(len(power)) / 50
    places = np.sin(t)[:, None, None] * np.ones((1, 2, 1))
    reference = ReferenceFrame(("q",), "m", "joints")
    sigma = np.full((len(t), 2), 1e-3)
    shot = Recording(0, np.arange(len(t)), t, ("strong", "weak"), places, sigma, reference, True)
    return build_simulator_scene(simulator, (shot,), {0: InputHistory(t, np.tile(power[:, None], 2))}), shot


def change(scene: SimulatorScene, **strengths: float) -> FloatArray:
    """Return what a file states, with other strengths of its actuators."""
    values, names = stated(scene), [prior.name for prior in scene.priors]
    for name, value in strengths.items():
        values[names.index(name)] = value
    return values


def test_of_several_actuators_each_has_the_strengths_that_change_it():
    scene, shot = build_slider_scene(np.full(60, 10.0))
    effect = next(one for one in scene.effects if one.name == "actuator_gain")
    assert [one.name for one in effect.parameters] == ["gain_strong", "gain_weak", "limit_weak", "fall_weak"]
    assert effect.parameters[-1].unit == "s/m"
    owned = [name == "actuator_gain" for name in scene.owners]
    assert scene.parameter_trees[owned].tolist() == [0, 1, 1, 1]
    ends = [
        scene.predict_positions(shot, np.zeros(4), change(scene, **changed), ())[-1, :, 0]
        for changed in ({}, {"gain_strong": 0.5}, {"limit_weak": 0.5})
    ]
    np.testing.assert_allclose(ends[1], ends[0] * [0.5, 1.0])
    np.testing.assert_allclose(ends[2], ends[0] * [1.0, 0.5])


def test_a_motor_loses_force_with_its_speed_while_it_has_power():
    """Its largest force, 12 N, falls by a fifth per m/s: 2 kg approach 5 m/s, and keep their speed without power."""
    t = np.arange(101) / 50
    scene, shot = build_slider_scene(np.full(101, 100.0))
    values = change(scene, limit_weak=2.0, fall_weak=0.2)
    states = scene.simulate_states(shot, np.zeros(4), values)
    np.testing.assert_allclose(states[:, 3], 5.0 * (1 - np.exp(-12.0 * 0.2 / 2.0 * t)), atol=0.01)
    released = replace(scene, histories={0: InputHistory(t, np.full((101, 2), np.nan))})
    states = released.simulate_states(shot, np.array([0.0, 0.0, 0.0, 3.0]), values)
    np.testing.assert_allclose(states[:, 3], 3.0)


@pytest.mark.parametrize(
    ("actuator", "offset", "is_tested"), [("motor", 0.0, True), ("motor", 0.5, False), ("position", 0.5, True)]
)
def test_a_dead_band_is_tested_where_it_differs_from_an_offset(actuator: str, offset: float, is_tested: bool):
    from pipeline.io.simulators.mujoco_simulator import MujocoSimulator

    _, recording = build_scene(SWING.format(0, "one", 0.4), ("one",))
    text = f"<worldbody>{SWING.format(0, 'one', 0.4)}</worldbody><actuator><{actuator} joint='one'/></actuator>"
    simulator = MujocoSimulator(mujoco.MjModel.from_xml_string(f"<mujoco>{text}</mujoco>"))
    given = offset + 0.2 * np.sin(9 * recording.t)[:, None]
    scene = build_simulator_scene(simulator, (recording,), {0: InputHistory(recording.t, given)})
    assert ("dead_band" in scene.not_tested) == (not is_tested)
    assert ("dead_band" in [one.name for one in scene.effects]) == is_tested
