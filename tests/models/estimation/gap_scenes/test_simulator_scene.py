"""The scene of a simulator from outside: its parameters, and its derivatives."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from models.core.recording import Recording, ReferenceFrame
from models.core.typing import FloatArray, IntArray
from models.estimation.gap_scenes.outside_simulator import InputHistory
from models.estimation.gap_scenes.simulator_scene import SimulatorScene, build_simulator_scene
from models.estimation.multiple_shooting.shooting_fit import ShootingOptions, fit_windows
from models.estimation.multiple_shooting.shooting_windows import fix_parameters

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
