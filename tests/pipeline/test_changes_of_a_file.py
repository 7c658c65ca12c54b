"""What to write into the file of a simulator, in the words of the file."""

from __future__ import annotations

from types import SimpleNamespace

from diagnosis.verdicts.verdict import Strength
from models.estimation.gap_scenes.outside_simulator import Joint
from pipeline.simulator_diagnosis import _describe_changes

INF = float("inf")


def describe(
    effects: tuple[str, ...],
    *fitted: Strength,
    joints: tuple[Joint, ...] = (Joint("hip", "rad"),),
) -> tuple[str, ...]:
    simulator = SimpleNamespace(own_effects={"joint_friction": (), "armature": ()}, joints=joints)
    return _describe_changes(SimpleNamespace(simulator=simulator), SimpleNamespace(effects=effects, fitted=fitted))  # type: ignore[arg-type]


def test_the_attributes_of_every_joint_are_given():
    fitted = [
        Strength(f"joint_friction.{name}_{joint}", "", value, 0.001, INF)
        for name, value in (("dry", 0.03), ("viscous", 0.015))
        for joint in ("hip", "knee")
    ]
    text = describe(("joint_friction",), *fitted, joints=(Joint("hip", "rad"), Joint("knee", "rad")))
    one = 'frictionloss="0.03" damping="0.015"'
    assert text == (f"in the file of your simulator, give joint hip {one}, joint knee {one}",)


def test_what_the_data_do_not_show_and_what_no_attribute_holds_is_left_out():
    hidden = Strength("armature.inertia", "kg m2", 0.0, 1.0, INF, prior_only=True)
    assert describe(("armature",), hidden) == ()
    unclear = Strength("joint_friction.dry", "N m", 0.002, 0.0015, INF)
    assert describe(("joint_friction",), unclear) == ()
    assert describe(("delay",), Strength("delay.time", "s", 0.1, 0.01, INF)) == ()
    assert describe(("armature",), Strength("armature.inertia", "kg m2", 0.02, 0.001, INF)) == (
        'in the file of your simulator, give joint hip armature="0.02"',
    )


def test_a_wrong_coefficient_is_given_even_where_it_is_zero_and_a_right_one_is_not():
    for value, sigma, text in ((0.0, 0.002, ('in the file of your simulator, give joint hip armature="0"',)),
                               (0.015, 0.002, ())):  # fmt: skip
        assert describe((), Strength("armature.inertia", "kg m2", value, sigma, INF, stated=0.02)) == text
