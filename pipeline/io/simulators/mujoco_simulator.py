"""A MuJoCo model (MJCF or URDF) as a simulator under diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from models.core.errors import OptionError
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.gap_scenes.mechanism_inputs import EffectValues
from models.estimation.gap_scenes.outside_simulator import Drive, Joint
from pipeline.engine.extras import name_remedy
from pipeline.reporting.text.text_formatting import escape_text

# Names of the degrees of freedom of joints that have several, after the name of their body.
FREE_NAMES, _BALL_NAMES = ("x", "y", "z", "rx", "ry", "rz"), ("rx", "ry", "rz")
# Coordinates of a place before those of a turn, by kind of joint.
_LINES = {"line": 1, "free": 3, "ball": 0}
# Gap over the size of the mechanism from which bodies nearly touch: what is between the recorded poses that are tried.
_NEAR = 0.05
# Models with other values that are kept, one for every parameter of two fits, and their bytes.
_MAX_COPIES, _MAX_COPY_BYTES = 200, 2e8


# Kinds of shapes that viewers draw as they are.
SHAPE_KINDS = ("sphere", "capsule", "ellipsoid", "cylinder", "box")


@dataclass(frozen=True, slots=True)
class Shape:
    """A shape of a body, as a viewer draws it."""

    body: str
    """Name of its body."""
    kind: str
    """One of `SHAPE_KINDS`, or mesh."""
    size: FloatArray
    """(3,) m: radius and half length, or half sizes; of a mesh, those of the box around it."""
    middle: FloatArray
    """(3,) m, in its own frame; zero but for a mesh."""
    geom: int
    """Its number in the model."""
    is_fixed: bool
    """Whether its body never moves."""


def read_mujoco_file(path: Path) -> MujocoSimulator:
    """Read a model of MuJoCo.

    Args:
        path: MJCF or URDF file.

    Returns:
        The simulator.

    Raises:
        OptionError: The package is missing, or it cannot read the file.
    """
    try:
        import mujoco
    except ImportError as error:
        raise OptionError(f"A MuJoCo file needs the package mujoco; {name_remedy('simulators')}") from error
    if not path.is_file():
        raise OptionError(f"A MuJoCo file was expected; there is no {escape_text(path)}")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise OptionError(f"MuJoCo cannot read {escape_text(path)}: {reason[:200]}; correct the file") from error
    if not 0 < model.opt.timestep < np.inf:
        raise OptionError(f"{escape_text(path)} states a time step of {model.opt.timestep:g} s; give one above 0")
    if model.na > 0:
        raise OptionError(
            f"{escape_text(path)} has actuators with a state of their own (na = {model.na}), which a diagnosis cannot"
            " start within a run; replace them by motors or position servos"
        )
    if not ((model.body_mass > 0) & (model.body_weldid != 0)).any():
        raise OptionError(
            f"{escape_text(path)} has no joint with a mass, so that nothing in it can move; name another file"
        )
    return MujocoSimulator(model)


class MujocoSimulator:
    """A MuJoCo model; see `models.estimation.gap_scenes.outside_simulator.OutsideSimulator`."""

    takes_forces = True
    is_free_beside_others = False
    failure = "MuJoCo finds no finite motion"

    def __init__(self, model: Any, touching: tuple[tuple[int, int], ...] = ()) -> None:
        """Take a model, and pairs of its kinematic trees that touch."""
        import mujoco

        self._mujoco = mujoco
        self.model, self.data = model, mujoco.MjData(model)
        mujoco.set_mju_user_warning(lambda text: None)  # it would write a file; `advance` finds runs that diverge
        self._copies: dict[tuple[object, ...], Any] = {}
        self._size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        self.time_step = float(model.opt.timestep)
        has_stages = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
        self.velocity_lag = 0.0 if has_stages else self.time_step / 2
        self._touching = touching
        self.joints, self.places = self._list_joints()
        self.inputs = tuple(self._name("actuator", k) for k in range(model.nu))
        self.drives = tuple(self._describe_drive(k) for k in range(model.nu))
        self.servo_joints = tuple(one.joint if self._is_servo(k) else -1 for k, one in enumerate(self.drives))
        moving = np.flatnonzero((model.body_mass > 0) & (model.body_weldid != 0))
        self._last_body = int(moving[-1])
        self.last_mass = float(model.body_mass[self._last_body])
        self.own_effects = self._list_own_effects()
        self.rest = self._find_rest()

    def __reduce__(self) -> tuple[Callable[..., MujocoSimulator], tuple[Any, tuple[tuple[int, int], ...]]]:
        """Pickle the model as its file states it."""
        return MujocoSimulator, (self.model, self._touching)

    def find_touching(self, poses: FloatArray) -> MujocoSimulator:
        """Find which kinematic trees touch in poses (K, N), or nearly; return the simulator that knows of it."""
        near = copy(self.model)
        near.geom_margin[:] += _NEAR * near.stat.extent
        states, touching = np.concatenate([poses, 0 * poses], axis=1), set(self._touching)
        for state in states:
            self._set_state(state)
            self._mujoco.mj_forward(near, self.data)
            trees = near.body_treeid[near.geom_bodyid[self.data.contact.geom]]
            touching |= {(int(one), int(other)) for one, other in trees if one != other and min(one, other) >= 0}
        return MujocoSimulator(self.model, tuple(sorted(touching)))

    def list_shapes(self) -> tuple[Shape, ...]:
        """List the shapes of all bodies to draw: simple ones, or the boxes around meshes of a body with no other."""
        kinds = {int(getattr(self._mujoco.mjtGeom, f"mjGEOM_{name.upper()}")): name for name in (*SHAPE_KINDS, "mesh")}
        shapes, model = list[Shape](), self.model
        for k, kind in enumerate(model.geom_type.tolist()):
            if kind in kinds:
                name, body = kinds[kind], int(model.geom_bodyid[k])
                centre, half = np.split(model.geom_aabb[k], 2)
                size, middle = (half, centre) if name == "mesh" else (model.geom_size[k], np.zeros(3))
                fixed = int(model.body_weldid[body]) == 0
                shapes.append(Shape(self._name("body", body), name, size, middle, k, fixed))
        simple = {model.geom_bodyid[one.geom] for one in shapes if one.kind != "mesh"}
        return tuple(one for one in shapes if one.kind != "mesh" or model.geom_bodyid[one.geom] not in simple)

    def place_shapes(self, shapes: Sequence[Shape], poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return places (K, S, 3) m and rotation matrices (K, S, 3, 3) of S shapes in poses (K, N) of all joints."""
        geoms, places, turns = [one.geom for one in shapes], [], []
        for pose in poses:
            self._set_state(np.concatenate([pose, 0 * pose]))
            self._mujoco.mj_kinematics(self.model, self.data)
            places.append(self.data.geom_xpos[geoms])
            turns.append(self.data.geom_xmat[geoms].reshape(-1, 3, 3))
        return np.array(places), np.array(turns)

    def _join_trees(self) -> IntArray:
        """Number the kinematic trees; those that a constraint, a tendon or a contact couples have one number."""
        model, kinds = self.model, self._mujoco.mjtEq
        numbers, pairs, trees = np.arange(model.ntree), list(self._touching), model.body_treeid
        ties = (int(kinds.mjEQ_CONNECT), int(kinds.mjEQ_WELD))
        for k in range(model.neq):
            if model.eq_type[k] in ties:
                is_site = model.eq_objtype[k] == int(self._mujoco.mjtObj.mjOBJ_SITE)
                ends = (int(model.eq_obj1id[k]), int(model.eq_obj2id[k]))
                one, other = (int(trees[model.site_bodyid[end] if is_site else end]) for end in ends)
                pairs.append((one, other))
        if model.ntendon or any(kind not in ties for kind in model.eq_type):
            # rare: which joints these hold is not looked up
            pairs += [(0, tree) for tree in range(model.ntree)]
        for one, other in pairs:
            if min(one, other) >= 0:
                numbers[numbers == numbers[one]] = numbers[other]
        return np.asarray(numbers)

    def _apply_effect(self, model: Any, name: str, parts: tuple[FloatArray, ...]) -> None:
        """Apply one of the own effects to a model."""
        first = parts[0]
        if name == "joint_friction":
            model.dof_frictionloss[:], model.dof_damping[:] = parts
        elif name == "armature":
            model.dof_armature[:] = first
        elif name == "gravity":
            model.opt.gravity[:] += np.concatenate(parts)
        elif name == "payload":
            mass = model.body_mass[self._last_body]
            model.body_inertia[self._last_body] *= 1 + first[0] / mass
            model.body_mass[self._last_body] = mass + first[0]
        elif name == "actuator_gain":
            model.actuator_gainprm[:] *= first[:, None]
            model.actuator_biasprm[:, :2] *= first[:, None]
            model.actuator_biasprm[:, 2] *= parts[1]
            model.actuator_forcerange[:] *= parts[2][:, None]

    def begin(
        self, starts: FloatArray, values: Sequence[EffectValues], powered: BoolArray, shots: IntArray, t: FloatArray
    ) -> MujocoRuns:
        """Begin runs side by side; see `OutsideSimulator.begin`."""
        full = np.empty((len(starts), self._size))
        for state, own in zip(starts, full, strict=True):
            self._set_state(state)
            self._mujoco.mj_getState(self.model, self.data, own, self._mujoco.mjtState.mjSTATE_FULLPHYSICS)
        return MujocoRuns(
            self, [self._find_copy(own, has_power) for own, has_power in zip(values, powered, strict=True)], full
        )

    def _set_state(self, state: FloatArray) -> None:
        """Bring the data of MuJoCo into a state (2N,)."""
        self._mujoco.mj_resetData(self.model, self.data)
        for kind, address, first in self.places:
            if kind == "line":
                self.data.qpos[address] = state[first]
                continue
            turn = first + _LINES[kind]
            self.data.qpos[address : address + turn - first] = state[first:turn]
            angle = float(np.linalg.norm(state[turn : turn + 3]))
            axis = state[turn : turn + 3] / angle if angle > 0 else np.array([1.0, 0.0, 0.0])
            place = address + turn - first
            self._mujoco.mju_axisAngle2Quat(self.data.qpos[place : place + 4], axis, angle)
        self.data.qvel[:] = state[len(self.joints) :]

    def _find_copy(self, values: EffectValues, powered: BoolArray) -> Any:
        """Find the model with values of effects, and without the power that it lacks, or make it."""
        own = ((name, *(one.tobytes() for one in parts)) for name, parts in sorted(values.items()))
        key = (powered.tobytes(), *own)
        if key not in self._copies:
            if len(self._copies) >= min(_MAX_COPIES, _MAX_COPY_BYTES / self._mujoco.mj_sizeModel(self.model)):
                self._copies.clear()
            self._copies[key] = self._change_copy(values, powered)
        return self._copies[key]

    def _change_copy(self, values: EffectValues, powered: BoolArray) -> Any:
        """Make a model with values of effects."""
        model = copy(self.model)
        for name, parts in values.items():
            self._apply_effect(model, name, parts)
        self._mujoco.mj_setConst(model, self.data)
        model.actuator_gainprm[~powered], model.actuator_biasprm[~powered] = 0.0, 0.0
        if "actuator_gain" in values:
            _, _, limit, fall = values["actuator_gain"]
            for k in np.flatnonzero(powered & (fall != 0)):
                model.dof_damping[self.drives[k].joint] += fall[k] * limit[k] * self.drives[k].limit
        return model

    def _name(self, kind: str, number: int) -> str:
        """Return the name of an object, or its kind and number where it has none."""
        objects = {"joint": self._mujoco.mjtObj.mjOBJ_JOINT, "actuator": self._mujoco.mjtObj.mjOBJ_ACTUATOR,
                   "body": self._mujoco.mjtObj.mjOBJ_BODY}  # fmt: skip
        return cast("str | None", self._mujoco.mj_id2name(self.model, objects[kind], number)) or f"{kind}{number}"

    def _list_joints(self) -> tuple[tuple[Joint, ...], list[tuple[str, int, int]]]:
        """List the degrees of freedom, and for each joint its kind, its address in qpos, and its first one."""
        kinds, joints, places = self._mujoco.mjtJoint, [], []
        trees = self._join_trees()
        for j in range(self.model.njnt):
            kind, address = int(self.model.jnt_type[j]), int(self.model.jnt_qposadr[j])
            first = int(self.model.jnt_dofadr[j])
            body = self._name("body", int(self.model.jnt_bodyid[j]))
            if kind == int(kinds.mjJNT_FREE):
                entries = [
                    (f"{body}.{axis}", *(("rad", f"{body}_turn") if axis[0] == "r" else ("m", body)))
                    for axis in FREE_NAMES
                ]
                places.append(("free", address, first))
            elif kind == int(kinds.mjJNT_BALL):
                entries = [(f"{body}.{axis}", "rad", f"{body}_turn") for axis in _BALL_NAMES]
                places.append(("ball", address, first))
            else:
                entries = [(self._name("joint", j), "m" if kind == int(kinds.mjJNT_SLIDE) else "rad", "")]
                places.append(("line", address, first))
            inertia = self.model.dof_M0[first : first + len(entries)]
            limit = float(np.abs(self.model.jnt_range[j]).max()) if self.model.jnt_limited[j] else float("inf")
            joints += [
                Joint(name, unit, float(one), limit, group, int(trees[self.model.dof_treeid[first]]))
                for (name, unit, group), one in zip(entries, inertia, strict=True)
            ]
        return tuple(joints), places

    def _is_servo(self, actuator: int) -> bool:
        """Return whether an actuator takes a position, rather than a force or speed."""
        gain, bias = self.model.actuator_gainprm[actuator, 0], self.model.actuator_biasprm[actuator, 1]
        return bool(gain != 0 and np.isclose(gain, -bias))

    def _describe_drive(self, actuator: int) -> Drive:
        """Describe what an actuator does on its joint."""
        model = self.model
        is_joint = model.actuator_trntype[actuator] == int(self._mujoco.mjtTrn.mjTRN_JOINT)
        joint = int(model.jnt_dofadr[model.actuator_trnid[actuator, 0]]) if is_joint else -1
        limited = bool(model.actuator_forcelimited[actuator])
        gear = float(model.actuator_gear[actuator, 0])
        limit = abs(gear) * float(model.actuator_forcerange[actuator, 1]) if limited else float("inf")
        return Drive(joint, float(model.actuator_gainprm[actuator, 0]) * gear, limit)

    def _find_rest(self) -> FloatArray:
        """Find the state (2N,) that the file states."""
        rest, place = np.zeros(2 * len(self.joints)), self.model.qpos0
        for kind, address, first in self.places:
            turn = first + _LINES[kind]
            rest[first:turn] = place[address : address + _LINES[kind]]
            if kind != "line":
                at = address + _LINES[kind]
                rest[turn : turn + 3] = find_rotation(place[at : at + 4])
        return rest

    def _list_own_effects(self) -> dict[str, tuple[float, ...]]:
        """List the effects that the model has itself, with the values of all their parameters."""
        model = self.model
        own: dict[str, tuple[float, ...]] = {
            "joint_friction": (*model.dof_frictionloss.tolist(), *model.dof_damping.tolist()),
            "armature": tuple(model.dof_armature.tolist()),
            "gravity": (0.0, 0.0, 0.0),
            "payload": (0.0,),
        }
        if model.nu:
            is_limited = model.actuator_forcelimited.astype(bool)
            turns = np.array([one.joint >= 0 and bool(not self.joints[one.joint].body) for one in self.drives])
            damps = model.actuator_biasprm[:, 2] != 0
            has_strength = (np.ones(model.nu, bool), damps, is_limited, is_limited & turns)
            stated = np.where(np.array(has_strength), np.array([[1.0], [1.0], [1.0], [0.0]]), np.nan)
            own["actuator_gain"] = tuple(stated.ravel().tolist())
        return own


class MujocoRuns:
    """Runs of a MuJoCo model; see `models.estimation.gap_scenes.outside_simulator.SimulatorRuns`."""

    def __init__(self, simulator: MujocoSimulator, models: list[Any], full: FloatArray) -> None:
        from mujoco import mjtState, rollout

        self._simulator, self._models, self._full = simulator, models, full
        self._spec = int(mjtState.mjSTATE_CTRL) | int(mjtState.mjSTATE_QFRC_APPLIED)
        self._rollout = rollout.Rollout(nthread=0)
        self._time_step = simulator.time_step

    def advance(self, inputs: FloatArray, force: FloatArray) -> FloatArray:
        """Let the runs go on by M steps, in compiled code."""
        runs, steps, _ = inputs.shape
        nq, count = self._simulator.model.nq, len(self._simulator.joints)
        control = np.concatenate([inputs, np.repeat(force[:, None], steps, axis=1)], axis=2)
        path = np.empty((runs, steps, self._full.shape[1]))
        self._rollout.rollout(
            self._models, [self._simulator.data], self._full, control, control_spec=self._spec, skip_checks=True,
            nstep=steps, state=path,
        )  # fmt: skip
        # MuJoCo ends a run that diverges, and begins it anew: its time then stands still
        expected = self._full[:, :1] + self._time_step * np.arange(1, steps + 1)
        has_failed = ~(np.abs(path[:, :, 0] - expected) < self._time_step / 2) | ~np.isfinite(path).all(axis=2)
        path[np.logical_or.accumulate(has_failed, axis=1)] = np.nan
        self._full = np.ascontiguousarray(path[:, -1])
        states = np.empty((runs, steps, 2 * count))
        states[:, :, count:] = path[:, :, 1 + nq : 1 + nq + count]
        for kind, address, first in self._simulator.places:
            turn, place = first + _LINES[kind], 1 + address + _LINES[kind]
            states[:, :, first:turn] = path[:, :, 1 + address : place]
            if kind != "line":
                states[:, :, turn : turn + 3] = find_rotation(path[:, :, place : place + 4])
        return states


def find_rotation(quaternion: FloatArray) -> FloatArray:
    """Return the rotation vectors (..., 3) of quaternions (..., 4), w first."""
    sine = np.linalg.norm(quaternion[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, quaternion[..., :1])
    angle = np.where(angle > np.pi, angle - 2 * np.pi, angle)
    return np.asarray(quaternion[..., 1:] / np.maximum(sine, 1e-300) * angle)
