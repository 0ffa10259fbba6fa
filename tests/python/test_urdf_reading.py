"""A URDF is read as Pinocchio reads it, or refused by a line that says why."""

import re
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest

from linkside import ConfigError, ElasticJointFilter, ExtendedKalmanFilter, ReducedOrderObserver, Robot, RobotWarning
from linkside.robot import pinocchio_model
from linkside.robot.tree import SINGLE_AXIS
from linkside.robot.urdf import Urdf

from .robots import ARM, DATA, EXAMPLES, spring

JOINTS = [spring("shoulder"), spring("elbow")]
Q = [0.5, 0.5]


def gravity_torque(urdf):
    return Robot.from_urdf(urdf, JOINTS).gravity_torque(Q)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('mass value="3"', 'mass value="3 "'),
        ('mass value="3"', 'mass value=" 3"'),
        ('mass value="3"', 'mass value="3&#10;"'),
        ('mass value="3"', 'mass value="+3."'),
        ('mass value="3"', 'mass value="0.3E1"'),
        ('ixx="0.1"', 'ixx="0.1 "'),
        ('xyz="0 0 0.2"', 'xyz=" 0  0 0.2 "'),
        ('xyz="0 0 0.5"', 'xyz="0 0\t0.5"'),
        ('xyz="0 0 0.5"', 'xyz="0 0&#10;0.5"'),
        ('axis xyz="0 1 0"', 'axis xyz=" 0 1 0"'),
        ('axis xyz="0 1 0"', 'axis xyz="0 1e-3 0"'),
    ],
)
def test_blanks_and_spellings_of_numbers_do_not_matter(old, new):
    np.testing.assert_array_equal(gravity_torque(ARM.replace(old, new, 1)), gravity_torque(ARM))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            'mass value="3"',
            'mass value="3_0"',
            "link 'upper': expected a finite number in <inertial/mass value=…>, got '3_0'",
        ),
        ('mass value="3"', 'mass value="٣"', "got '٣'"),
        ('mass value="3"', 'mass value="0x3"', "got '0x3'"),
        ('mass value="3"', 'mass value="nan"', "got 'nan'"),
        ('xyz="0 0 0.5"', 'xyz="0 0 0_5"', "joint 'elbow': expected 3 finite numbers"),
        ('lower="-3"', 'lower="-3x"', "joint 'shoulder': expected a finite number in <limit lower=…>"),
        ("<inertial>", "<inertial/><inertial>", "link 'upper': <inertial> is there 2 times"),
        ('<mass value="3"/>', '<mass value="3"/><mass value="1"/>', "link 'upper': <mass> is there 2 times"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><axis xyz="1 0 0"/>', "joint 'shoulder': <axis> is there 2 times"),
        ('<child link="upper"/>', '<child link="upper"/><child link="fore"/>', "<child> is there 2 times"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><mimic/>', "joint 'shoulder': expected <mimic joint=…>"),
    ],
)
def test_what_readers_may_take_differently_is_refused(old, new, words):
    with pytest.raises(ConfigError, match=re.escape(words)):
        gravity_torque(ARM.replace(old, new, 1))


def chain(count, kind="revolute"):
    body = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    joint = f'<joint name="j{{0}}" type="{kind}"><parent link="l{{0}}"/><child link="l{{1}}"/><axis xyz="0 1 0"/>'
    joint += '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    links = "".join(f'<link name="l{i}">{body}</link>' for i in range(count + 1))
    return f'<robot name="r">{links}{"".join(joint.format(i, i + 1) for i in range(count))}</robot>'


@pytest.mark.parametrize(("count", "kind"), [(257, "revolute"), (6000, "fixed"), (6000, "revolute")])
def test_a_chain_beyond_all_bounds_is_a_message(count, kind):
    with pytest.raises(ConfigError, match=r"expected at most .* got \d+"):
        Robot.from_urdf(chain(count, kind), [spring("j0")])


def test_a_long_chain_within_bounds_is_read():
    assert Robot.from_urdf(chain(256), [spring("j0")]).n == 1


def test_elements_that_nest_without_end_are_a_message():
    with pytest.raises(ConfigError, match="at most 256 deep"):
        Robot.from_urdf("<robot name='r'>" + "<a>" * 100_000 + "</a>" * 100_000 + "</robot>", [spring("j0")])


URDFS = sorted([*EXAMPLES.glob("*/*/*.urdf"), *DATA.glob("*/*.urdf")])


def numbers(joint):
    """What a joint and its body are, each with the scale that its errors are relative to."""
    body = joint.body
    yield from ((joint.placement.rotation, 1), (joint.placement.translation, 1), (joint.axis, 1))
    yield from ((body.mass, body.mass), (body.com, 1), (body.inertia, np.abs(body.inertia).max()))


def assert_same(ours, theirs):
    """Same joints and links in the same order, to the rounding of rotations: both compute them in ways of their own."""
    for kind in ("name", "kind", "parent", "limits"):
        assert [getattr(j, kind) for j in ours.joints] == [getattr(j, kind) for j in theirs.joints]
    for kind in ("name", "joint"):
        assert [getattr(link, kind) for link in ours.links] == [getattr(link, kind) for link in theirs.links]
    for mine, other in zip(ours.joints, theirs.joints, strict=True):
        if mine.kind in SINGLE_AXIS:
            for (value, _), (want, scale) in zip(numbers(mine), numbers(other), strict=True):
                np.testing.assert_allclose(value, want, rtol=0, atol=4e-15 * scale, err_msg=mine.name)
    for mine, other in zip(ours.links, theirs.links, strict=True):
        np.testing.assert_allclose(mine.placement.rotation, other.placement.rotation, rtol=0, atol=4e-15)
        np.testing.assert_allclose(mine.placement.translation, other.placement.translation, rtol=0, atol=4e-15)


@pytest.mark.parametrize("path", URDFS, ids=lambda path: path.stem)
def test_trees_are_those_that_pinocchio_reads(path):
    try:
        urdf = Urdf.read(path)
    except ConfigError:
        pytest.skip("refused for what it says")
    ours, model = urdf.tree(), pin.buildModelFromXML(ET.tostring(urdf.root, encoding="unicode"))
    assert_same(ours, pinocchio_model.read(model))
    if all(joint.kind in SINGLE_AXIS for joint in ours.joints):
        assert_same(pinocchio_model.read(pinocchio_model.build(ours, (0.0, 0.0, -9.81))), ours)


@pytest.mark.parametrize(
    "path", [p for p in URDFS if "panda" in p.stem or "tiago_dual" in p.stem], ids=lambda p: p.stem
)
def test_locked_trees_are_those_that_pinocchio_reduces(path):
    urdf = Urdf.read(path)
    whole, model = urdf.tree(), pin.buildModelFromXML(ET.tostring(urdf.root, encoding="unicode"))
    names = [joint.name for joint in whole.joints][::2]
    reduced = pin.buildReducedModel(model, [model.getJointId(name) for name in names], pin.neutral(model))
    assert_same(whole.locked(names), pinocchio_model.read(reduced))


def test_a_link_that_hangs_on_itself_is_named():
    loop = ARM.replace('<parent link="base"/><child link="upper"/>', '<parent link="hand"/><child link="upper"/>')
    with pytest.raises(ConfigError, match="link 'fore' hangs on itself: joints lead from it back to it"):
        Robot.from_urdf(loop, JOINTS)


BARE = re.sub("<inertial>.*?</inertial>", "", ARM, flags=re.DOTALL)


@pytest.mark.parametrize("method", [ExtendedKalmanFilter, ElasticJointFilter, ReducedOrderObserver])
def test_methods_that_need_masses_refuse_links_without(method):
    robot = Robot.from_urdf(BARE, JOINTS)
    with pytest.raises(ConfigError, match=r"link '(upper|fore)', which joint '(shoulder|elbow)' moves, has no inertia"):
        method(robot)
    zero = np.zeros(2)
    with pytest.raises(ConfigError, match="forward dynamics needs masses"):
        robot.forward_dynamics(zero, zero, zero, zero, zero)


def test_a_link_with_a_shape_and_no_inertia_is_said_once():
    shape = '<link name="upper"><visual><geometry><box size="1 1 1"/></geometry></visual></link>'
    robot = Robot.from_urdf(re.sub('<link name="upper">.*?</link>', shape, ARM, flags=re.DOTALL), JOINTS)
    with pytest.warns(RobotWarning, match="link 'upper' has a shape and no inertia"):
        ExtendedKalmanFilter(robot)
    ExtendedKalmanFilter(robot)


def test_moments_that_no_body_has_are_said_by_the_method_that_uses_them():
    robot = Robot.from_urdf(ARM.replace('ixx="0.1"', 'ixx="5"', 1), JOINTS)
    with pytest.warns(RobotWarning, match=r"joint 'shoulder': principal moments of inertia .* more than the sum"):
        ExtendedKalmanFilter(robot)


def test_an_armature_that_would_be_dropped_is_said():
    model = pin.buildModelFromXML(ARM)
    model.armature = np.array([0.3, 0.0])
    with pytest.warns(RobotWarning, match=r"joint 'shoulder': the model's armature of 0\.3 kg m² is not used"):
        ExtendedKalmanFilter(Robot.from_pinocchio(model, JOINTS))
    model.armature = np.array([1.5, 1.5])  # the very motor_inertia: nothing is dropped
    ExtendedKalmanFilter(Robot.from_pinocchio(model, JOINTS))
