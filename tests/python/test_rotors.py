"""Motors that links carry: held to Pinocchio, which has each rotor as a body, by simulator, filter and smoother."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkside import ElasticJointFilter, ElasticJointSmoother, Robot, Sensor, simulate

from .robots import models, spring
from .test_forward_dynamics import six_axes

NAMES = [f"a{i}" for i in range(1, 7)]
ROTORS = {
    "a2": {"link": "l1", "axis": [0, 1, 0]},
    "a3": {"link": "l2", "axis": [0.6, 0.0, 0.8]},
    "a5": {"link": "l3", "axis": [1, 0, 0]},
    "a6": {"link": "l5", "axis": [0, 0.8, -0.6]},
}


def with_rotors(robot):
    """The model with each rotor as one more body that has nothing but its spin inertia."""
    model, config = robot.model.copy(), robot.config
    names = robot.names
    for motor, rotor in config.rotors.items():
        drive = robot.drives[names.index(motor)]
        frame = model.frames[model.getFrameId(rotor.link)]
        axis = frame.placement.rotation @ np.array(rotor.axis) / np.linalg.norm(rotor.axis)
        joint = model.addJoint(
            frame.parentJoint, pin.JointModelRevoluteUnaligned(axis), pin.SE3.Identity(), f"rotor of {motor}"
        )
        spin = drive.motor_inertia / drive.gear_ratio**2
        model.appendBodyToJoint(joint, pin.Inertia(0.0, np.zeros(3), spin * np.outer(axis, axis)), pin.SE3.Identity())
    return model


def extended(robot, links, motors, of_links):
    """Links' numbers in Pinocchio's order, then rotors'."""
    spins = [motors[robot.names.index(m)] * robot.drives[robot.names.index(m)].gear_ratio for m in robot.config.rotors]
    return np.concatenate([of_links(links), spins])


def six(rotors=ROTORS, rigid=(), **drive):
    drives = [
        spring(
            name,
            elastic=name not in rigid,
            stiffness=k,
            motor_inertia=b,
            gear_ratio=ratio,
            **({"damping": 0.0} | drive),
        )
        for name, k, b, ratio in zip(
            NAMES, (9e3, 9e3, 6e3, 1e3, 8e2, 5e2), (4, 4, 2, 0.3, 0.3, 0.2), (12, 9, -7, 8, 5, -6), strict=True
        )
    ]
    return Robot.from_urdf(six_axes(), drives, rotors=rotors)


@settings(max_examples=40, deadline=None)
@given(models(), st.integers(0, 2**32 - 1))
def test_links_and_carried_motors_accelerate_as_pinocchio_says(model, seed):
    rng = np.random.default_rng(seed)
    names = list(model.names)[1:]
    drives = [spring(name, gear_ratio=float(rng.uniform(2, 9) * rng.choice([-1, 1]))) for name in names]
    carried = {
        name: {"link": f"link{rng.integers(len(names))}", "axis": rng.standard_normal(3).tolist()} for name in names
    }
    robot = Robot.from_pinocchio(model, drives, rotors=carried)
    q, dq, torsion, slip, tau = rng.uniform(-1, 1, (5, robot.n)) * [[3], [1], [0.02], [3], [20]]
    shaft = 1e4 * torsion + 5.0 * slip
    ddq, ddtheta = robot.forward_dynamics(q, dq, q + torsion, dq + slip, tau)
    whole = with_rotors(robot)
    links = robot.velocity_to_pinocchio
    velocity = extended(robot, dq, dq + slip, links)
    spins = [(tau - shaft)[names.index(m)] / robot.drives[names.index(m)].gear_ratio for m in carried]
    torque = np.concatenate([links(shaft), spins])
    position = np.concatenate([robot.to_pinocchio(q), rng.uniform(-3, 3, robot.n)])
    expected = pin.aba(whole, whole.createData(), position, velocity, torque)
    found = extended(robot, ddq, ddtheta, links)
    np.testing.assert_allclose(found, expected, atol=1e-9 * max(1.0, np.abs(expected).max()))


def swing(robot, duration, **settings):
    start = {"q": [0.3, -0.5, 0.8, 0.2, -0.4, 0.1], "dq": [1.0, -1.0, 2.0, 1.5, -2.0, 3.0], "tau": np.zeros(6)}
    return simulate(robot, lambda t, state: np.zeros(6), duration, 1000.0, **(start | settings))


def test_a_free_robot_with_rotors_keeps_its_energy():
    robot = six()
    truth = swing(robot, 2.0, substeps=10).truth
    whole, stiffness = with_rotors(robot), np.array([d.stiffness for d in robot.drives])
    alone = np.array([0.0 if name in ROTORS else d.motor_inertia for name, d in zip(NAMES, robot.drives, strict=True)])
    data, total = whole.createData(), []
    for q, dq, theta, dtheta in zip(*(truth[k] for k in ("q", "dq", "theta", "dtheta")), strict=True):
        position = np.concatenate([robot.to_pinocchio(q), np.zeros(len(ROTORS))])
        velocity = extended(robot, dq, dtheta, robot.velocity_to_pinocchio)
        links = pin.computeKineticEnergy(whole, data, position, velocity) + pin.computePotentialEnergy(
            whole, data, position
        )
        total.append(links + 0.5 * alone @ dtheta**2 + 0.5 * stiffness @ (theta - q) ** 2)
    assert np.ptp(truth["q"], axis=0).min() > 0.5  # every joint swings
    assert np.ptp(total) < 1e-8 * np.abs(total).max()


def test_torque_sensors_read_what_links_need_beside_rotors():
    """Behind springs and behind rigid drives: Pinocchio's inverse dynamics of links that carry rotors."""
    robot = six(rigid=("a3", "a4"))
    run = swing(robot, 0.05, substeps=4, sensors={"torque": Sensor()})
    whole, truth = with_rotors(robot), run.truth
    data, links, elastic = whole.createData(), robot.velocity_to_pinocchio, robot.elastic
    stiffness = np.array([drive.stiffness for drive in robot.drives])
    for read, q, dq, ddq, theta, dtheta in zip(
        run.log.torque, *(truth[k] for k in ("q", "dq", "ddq", "theta", "dtheta")), strict=True
    ):
        spring = stiffness * (theta - q)
        position = np.concatenate([robot.to_pinocchio(q), np.zeros(len(ROTORS))])
        motion = position, extended(robot, dq, dtheta, links)
        held = pin.rnea(whole, data, *motion, np.concatenate([links(ddq), np.zeros(len(ROTORS))]))[robot.n :]
        spins = []
        for motor, own in zip(ROTORS, held, strict=True):
            j, drive = NAMES.index(motor), robot.drives[NAMES.index(motor)]
            # No torque acts on a motor but its spring's; a rigid one turns with its link.
            free = (-spring[j] / drive.gear_ratio - own) / (drive.motor_inertia / drive.gear_ratio**2)
            spins.append(free if drive.elastic else ddq[j] * drive.gear_ratio)
        load = pin.rnea(whole, data, *motion, np.concatenate([links(ddq), spins]))[robot.velocity_index]
        np.testing.assert_allclose(read, load, atol=1e-8 * np.abs(load).max())
        np.testing.assert_allclose(read[elastic], spring[elastic], atol=1e-9)


TIP = [{"name": name, "link": link, "xyz": [0.1, 0.05, 0.02]} for name, link in (("fore", "l3"), ("hand", "l6"))]


@pytest.fixture(scope="module")
def figures():
    """Largest errors of the links after the start [rad]: with rotors, without, and where robot.yaml lacks them."""

    def errors(true, told, method):
        run = simulate(
            true,
            lambda t, state: true.gravity_torque(np.zeros(6)) + 8.0 * np.sin(np.arange(3, 9) * 2 * t),
            0.6,
            1000.0,
            sensors={"theta": Sensor(noise=1e-6), "acceleration": Sensor(noise=0.02)},
            substeps=4,
            seed=3,
        )
        return np.abs(method(told, motor_torque="held").run(run.log).q - run.truth["q"])[100:].max()

    def robot(rotors):
        config = six(rotors, damping=2.0).config.model_dump(exclude={"urdf"})
        return Robot.from_urdf(six_axes(), **(config | {"accelerometers": TIP}))

    carried, plain = robot(ROTORS), robot({})
    return {
        method: [errors(*pair, method) for pair in ((carried, carried), (plain, plain), (carried, plain))]
        for method in (ElasticJointFilter, ElasticJointSmoother)
    }


@pytest.mark.parametrize("method", [ElasticJointFilter, ElasticJointSmoother])
def test_elastic_filters_are_as_good_with_rotors_and_wrong_where_they_are_left_out(figures, method):
    carried, plain, lacking = figures[method]
    assert carried < 1.2 * plain
    assert lacking > 50 * carried
