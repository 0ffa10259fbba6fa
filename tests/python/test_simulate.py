"""Simulation against energy, closed forms, inverse dynamics, MuJoCo and the filter."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import scipy.signal
from numpy.testing import assert_allclose

import linkside
from linkside import (
    AccelerationObserver,
    ElasticJointFilter,
    EstimatorError,
    Log,
    NumericalError,
    OutputError,
    Robot,
    Sensor,
    simulate,
)
from linkside.control.controllers import JointPD, SimpleAdaptive

from .robots import ARM, spring

DATA = Path(__file__).parents[1] / "data"
ROD = """<link name="{name}"><inertial><origin xyz="2.25 0 0"/><mass value="1.5075"/>
  <inertia ixx="0.01" ixy="0" ixz="0" iyy="{i}" iyz="0" izz="{i}"/></inertial></link>"""
AXIS = """<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>
  <origin xyz="{x} 0 0"/><axis xyz="0 0 1"/></joint>"""
LENGTH, MASS = 4.5, 1.5075
INERTIA = MASS * LENGTH**2 / 12
SPACE = (
    '<robot name="space"><link name="base"/>'
    + "".join(ROD.format(name=name, i=INERTIA) for name in ("upper", "fore"))
    + AXIS.format(name="one", parent="base", child="upper", x=0)
    + AXIS.format(name="two", parent="upper", child="fore", x=LENGTH)
    + "</robot>"
)
NONLINEAR = {
    "cubic_stiffness": 500.0,
    "soft_windup": {"stiffness": 10.0, "shape": 3000.0},
    "link_friction": [0.5, 150.0, 50.0, 2.0, 100.0, 0.5],
}


def space(**settings):
    drives = [{"name": name, "stiffness": 500.0, "motor_inertia": 1.0, **settings} for name in ("one", "two")]
    coupling = {"one": {"two": 1.0}} if settings else {}
    tool = {"link": "fore", "xyz": [LENGTH, 0, 0]}
    return Robot.from_urdf(SPACE, drives, gravity=[0, 0, 0], coupling=coupling, tool=tool)


def arm(**settings):
    drives = [spring("shoulder", damping=0.0, **settings), spring("elbow", damping=0.0, **settings)]
    return Robot.from_urdf(ARM, drives, coupling={"shoulder": {"elbow": 0.3}})


def still(t, state):
    return np.zeros(len(state.q))


def energy(robot, truth):
    """Kinetic energy of links and rotors, coupling included, and potential energy of gravity and springs."""
    data, total = robot.model.createData(), []
    drives = robot.drives
    for q, dq, theta, dtheta in zip(*(truth[k] for k in ("q", "dq", "theta", "dtheta")), strict=True):
        args = robot.model, data, robot.to_pinocchio(q)
        links = pin.computePotentialEnergy(*args) + pin.computeKineticEnergy(*args, robot.velocity_to_pinocchio(dq))
        rotors = sum(0.5 * d.motor_inertia * v**2 for d, v in zip(drives, dtheta, strict=True))
        torsion = theta - q
        springs = sum(
            0.5 * d.stiffness * x**2 + 0.25 * d.cubic_stiffness * x**4 for d, x in zip(drives, torsion, strict=True)
        )
        total.append(links + rotors + springs + dq @ robot.coupling @ dtheta)
    return np.array(total)


def test_a_free_robot_keeps_its_energy_for_ten_seconds():
    robot = arm(cubic_stiffness=1e6)
    start = {"q": [0.3, -0.4], "dq": [1.0, -2.0], "tau": [0, 0]}
    run = simulate(robot, still, 10.0, 1000.0, **start, substeps=10)
    total = energy(robot, run.truth)
    assert np.ptp(run.truth["q"][:, 0]) > 1.0
    assert_allclose(total, total[0], rtol=1e-8)


def accelerations(robot, controller, **start):
    """Truth at the second of two samples, the torque of the first having acted until then."""
    run = simulate(robot, controller, 1e-6, 1e6, **start)
    return {name: values[1] for name, values in run.truth.items()}, run


@pytest.mark.parametrize("seed", range(5))
def test_inverse_dynamics_of_what_happened_is_the_torque(seed):
    robot, rng = arm(cubic_stiffness=1e6), np.random.default_rng(seed)
    names = ("q", "dq", "theta", "dtheta")
    tau, start = rng.uniform(-50, 50, 2), {name: 0.1 * rng.standard_normal(2) for name in names}
    truth, _ = accelerations(robot, lambda t, state: tau, **start)
    torsion = truth["theta"] - truth["q"]
    spring_torque = 1e4 * torsion + 1e6 * torsion**3
    ddtheta = (tau - spring_torque - robot.coupling.T @ truth["ddq"]) / 1.5
    load = robot.inverse_dynamics(truth["q"], truth["dq"], truth["ddq"]) + robot.coupling @ ddtheta
    assert_allclose(load, spring_torque, rtol=1e-10, atol=1e-10 * np.abs(spring_torque).max())


@pytest.mark.parametrize("settings", [{}, NONLINEAR])
def test_two_links_are_the_closed_form(settings):
    """Ulrich and Sasiadek, ACC 2011, eqs. (1)-(16), links being slender rods."""
    rng, robot = np.random.default_rng(1), space(**settings)
    start = {name: scale * rng.standard_normal(2) for name, scale in (("q", 1), ("dq", 0.3), ("dtheta", 0.3))}
    start["theta"] = start["q"] + 0.05 * rng.standard_normal(2)
    tau = rng.uniform(-20, 20, 2)
    truth, _ = accelerations(robot, lambda t, state: tau, **start)
    (_, q2), (v1, v2), torsion = truth["q"], truth["dq"], truth["theta"] - truth["q"]
    a = 2 * INERTIA + MASS * (LENGTH**2 / 4 + LENGTH**2 * 1.25)
    b, c = MASS * LENGTH**2 / 2, INERTIA + MASS * LENGTH**2 / 4
    mass = np.array([[a + 2 * b * np.cos(q2), c + b * np.cos(q2)], [c + b * np.cos(q2), c]])
    coriolis = -b * np.sin(q2) * np.array([[v2, v1 + v2], [-v1, 0]])
    load, pull, coupling = coriolis @ truth["dq"], 500 * torsion, np.zeros((2, 2))
    if settings:
        pull = (500 * torsion**2 + 500 - 10 * np.exp(-3000 * torsion**2)) * torsion
        g, v = NONLINEAR["link_friction"], truth["dq"]
        load = load + g[0] * (np.tanh(g[1] * v) - np.tanh(g[2] * v)) + g[3] * np.tanh(g[4] * v) + g[5] * v
        coupling[0, 1] = 1.0
    whole = np.block([[mass, coupling], [coupling.T, np.eye(2)]])
    expected = np.linalg.solve(whole, np.concatenate([pull - load, tau - pull]))
    assert_allclose(truth["ddq"], expected[:2], rtol=1e-12, atol=1e-12)


def test_stiffer_joints_come_near_the_rigid_robot():
    drives = [{"name": name, "elastic": False, "motor_inertia": 1.5} for name in ("shoulder", "elbow")]
    rigid = Robot.from_urdf(ARM, drives)
    push = lambda t, state: [20 * np.sin(9 * t), 8 * np.cos(7 * t)]  # noqa: E731
    ends = []
    for stiffness in (1e4, 1e5, 1e6):
        elastic = Robot.from_urdf(ARM, [spring(d["name"]) | {"stiffness": stiffness} for d in drives])
        runs = [simulate(robot, push, 0.5, 1000.0, q=[0.3, 0.4], substeps=20) for robot in (elastic, rigid)]
        ends.append(np.abs(runs[0].truth["q"] - runs[1].truth["q"]).max())
    assert ends[0] < 0.05
    assert ends[1] < ends[0] / 5
    assert ends[2] < ends[1] / 5


def test_halving_the_step_shows_fourth_order():
    start = {"q": [0.3, -0.4], "dq": [1.0, -2.0]}
    runs = [simulate(arm(), still, 0.2, 500.0, **start, substeps=k).truth["q"] for k in (4, 8, 64)]
    coarse, fine = (np.abs(run - runs[2]).max() for run in runs[:2])
    assert 15 < coarse / fine < 17


def test_what_is_not_said_is_rest():
    robot = arm(cubic_stiffness=1e6)
    hold = robot.gravity_torque([0.5, 0.2])
    run = simulate(robot, lambda t, state: hold, 0.1, 1000.0, q=[0.5, 0.2])
    assert_allclose(run.truth["q"], np.tile([0.5, 0.2], (101, 1)), atol=1e-12)


def recorded(sensor, **settings):
    """Readings of motor positions, and the truth, of a swinging arm."""
    run = simulate(arm(), still, 0.5, 1000.0, q=[0.3, 0.4], dq=[1, 2], sensors={"theta": sensor}, **settings)
    return run.log.theta, run.truth["theta"]


def test_sensors_do_what_they_say():
    read, truth = recorded(Sensor(resolution=1e-3, bias=0.5))
    assert_allclose(read / 1e-3, np.round(read / 1e-3), atol=1e-9)
    assert np.abs(read - truth - 0.5).max() <= 0.5e-3 + 1e-12
    read, truth = recorded(Sensor(delay=2.5e-3))
    assert_allclose(read[3:], (truth[1:-2] + truth[:-3]) / 2, atol=1e-12)
    read, truth = recorded(Sensor(every=3))
    assert np.isnan(read[1:3]).all()
    assert_allclose(read[::3], truth[::3], atol=0)
    read, truth = recorded(Sensor(corner_frequency=20.0))
    # The filter as a system in continuous time, fed what runs straight between samples.
    constant, t = 1 / (2 * np.pi * 20.0), 1e-3 * np.arange(len(truth))
    for joint in range(truth.shape[1]):
        start = truth[0, joint]
        slow = scipy.signal.lsim(([1.0], [constant, 1.0]), truth[:, joint] - start, t)[1]
        assert_allclose(read[:, joint], start + slow, atol=1e-9)


def test_torque_sensors_read_what_the_links_need():
    """Of a coupled elbow, and of one that is rigid: inverse dynamics, friction and what its rotor pushes with."""
    friction, tau = [0.5, 15.0, 5.0, 2.0, 10.0, 0.5], [20.0, 5.0]
    start = {"q": [0.3, 0.4], "dq": [1, 2], "tau": tau, "sensors": {"torque": Sensor()}}
    for elastic, coupling in ((True, 0.3), (False, 0.0)):
        drives = [spring("shoulder", link_friction=friction), spring("elbow", elastic=elastic, link_friction=friction)]
        robot = Robot.from_urdf(ARM, drives, coupling={"shoulder": {"elbow": coupling}} if elastic else {})
        run = simulate(robot, lambda t, state: tau, 0.02, 1000.0, **start, substeps=2)
        truth = run.truth
        load = robot.inverse_dynamics(truth["q"], truth["dq"], truth["ddq"]) + robot.link_friction(truth["dq"])
        rotor = (tau[1] - load[:, 1] - coupling * truth["ddq"][:, 0]) / 1.5
        load[:, 0] += coupling * rotor
        assert_allclose(run.log.torque, load, atol=1e-9)


def test_torque_sensors_are_as_good_as_they_are_said_to_be():
    assert simulate(arm(), still, 0.02, 1000.0).log.torque is None
    sensor = Sensor(resolution=0.5, every=2)
    read = simulate(arm(), still, 0.02, 1000.0, q=[0.3, 0.4], sensors={"torque": sensor}).log.torque
    assert_allclose(read[::2], 0.5 * np.round(read[::2] / 0.5), atol=1e-12)
    assert np.isnan(read[1::2]).all()


def test_torque_sensors_are_filtered_in_the_loop():
    """They read exactly what the filter says they do, whatever it does not know."""
    robot = arm(motor_friction={"viscous": 5.0})
    hold = robot.gravity_torque([0.4, 0.4])
    control = JointPD(kp=2000.0, kd=120.0, times=[0.0, 0.5], theta=[[0, 0], [0.4, 0.4]], tau=hold)
    noise = {"theta": Sensor(noise=1e-4), "torque": Sensor(noise=1e-3)}
    errors = []
    for torque in (True, False):
        estimator = ElasticJointFilter(robot, linkside.ElasticNoise(joint_torque=1e-3), torque=torque)
        run = simulate(robot, control, 1.0, 1000.0, feedback=estimator, sensors=noise, substeps=4)
        late = run.truth["t"] > 0.5
        errors.append(np.abs(((run.known.theta - run.known.q) - (run.truth["theta"] - run.truth["q"]))[late]).max())
    assert errors[0] < 2e-6
    assert errors[1] > 3 * errors[0]


def test_the_log_has_accelerations_as_robot_yaml_says_they_are_recorded(tmp_path):
    sensor = {"name": "acc", "link": "fore", "bias": [0.5, 0, -0.2], "scale": [1.1, 0.9, 1.0]}
    robot = Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")], accelerometers=[sensor])
    hold = robot.gravity_torque([0.3, 0.4])
    rest = simulate(robot, lambda t, state: hold, 0.01, 1000.0, q=[0.3, 0.4], sensors={"acceleration": Sensor()})
    rest.write(tmp_path)
    upward = 9.81 * np.array([-np.sin(0.7), 0, np.cos(0.7)])
    assert_allclose(rest.log.acceleration, np.tile(upward, (11, 1)), atol=1e-9)
    assert_allclose(Log.read(tmp_path / "log.parquet", robot).acceleration, rest.log.acceleration, atol=0)


def test_noise_is_white_and_the_seed_decides():
    noise = Sensor(noise=0.01)
    (one, truth), (same, _), (other, _) = (recorded(noise, seed=seed) for seed in (1, 1, 2))
    assert (one == same).all()
    assert (one != other).any()
    assert 0.009 < np.std(one - truth) < 0.011


def test_the_log_is_one_that_the_filter_follows(tmp_path):
    robot = Robot.load(DATA / "kr15_six_axes" / "robot.yaml")
    hold = robot.gravity_torque(np.full(6, 0.2))
    push = lambda t, state: hold + 300 * np.sin(8 * t) * np.array([1, 1, 0.5, 0.1, 0.1, 0.05])  # noqa: E731
    run = simulate(robot, push, 1.0, 1000.0, q=np.full(6, 0.2), substeps=10)
    run.write(tmp_path)
    log = Log.read(tmp_path / "log.parquet", robot, check=False)
    assert_allclose(log.theta, run.log.theta, atol=0)
    moved = np.ptp(run.truth["theta"] - run.truth["q"], axis=0).max()
    error = np.abs(ElasticJointFilter(robot).run(log).q - run.truth["q"]).max()
    assert error < 0.05 * moved


def test_a_simulation_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file"):
        simulate(arm(), still, 0.01, 100.0, substeps=10).write(tmp_path / "file")


def square(speed=0.84, half=6.3):
    corners = half * np.array([[1, -1], [1, 1], [-1, 1], [-1, -1], [1, -1]])
    return np.arange(5) * 2 * half / speed, corners


def start_of_square():
    elbow = np.arccos((2 * 6.3**2 - 2 * LENGTH**2) / (2 * LENGTH**2))
    return [-np.pi / 4 - elbow / 2, elbow]


@pytest.mark.parametrize(("settings", "rms", "largest"), [({}, 0.0898, 0.467), (NONLINEAR, 0.0893, 0.444)])
def test_the_space_robot_follows_the_square(settings, rms, largest):
    """Figures of an independent implementation of the same reconstruction, within five per cent."""
    times, corners = square()
    run = simulate(
        space(**settings), SimpleAdaptive(times, corners, axes="xy"), 60.0, 1000.0, q=start_of_square(), tau=[0, 0]
    )
    model = follow(times, corners, run.truth["t"])
    error = np.linalg.norm(run.truth["tool"][:, :2] - model, axis=1)
    assert_allclose([np.sqrt((error**2).mean()), error.max()], [rms, largest], rtol=0.05)


def follow(times, corners, t):
    """The reference model's output, ω_n = 5 rad/s and ζ = 0.9, command held over a sample."""
    from scipy.linalg import expm

    phi, out = expm(np.array([[0, 1], [-25, -9]]) * t[1]), []
    command = np.column_stack([np.interp(t, times, axis) for axis in corners.T])
    state = np.vstack([command[0], [0, 0]])
    for target in command:
        out.append(state[0])
        state = phi @ (state - np.vstack([target, [0, 0]])) + np.vstack([target, [0, 0]])
    return np.array(out)


def test_joint_pd_settles_from_sensors_alone():
    robot = arm(motor_friction={"viscous": 5.0})
    hold = robot.gravity_torque([0.4, 0.4])
    goal = np.array([0.4, 0.4]) + hold / 1e4
    control = JointPD(kp=2000.0, kd=120.0, times=[0.0, 0.5], theta=[[0, 0], goal], tau=hold)
    run = simulate(robot, control, 3.0, 1000.0, feedback="sensors", substeps=4)
    assert_allclose(run.truth["q"][-1], [0.4, 0.4], atol=2e-3)


def test_the_estimate_closes_the_loop():
    times, corners = square()
    control = SimpleAdaptive(times, corners, axes="xy")
    settings = {"q": start_of_square(), "tau": [0, 0], "seed": 3}
    noise = {"theta": Sensor(noise=np.pi / 180), "dtheta": Sensor(noise=np.pi / 180)}
    robot = space()
    tuning = linkside.ElasticNoise(
        link_acceleration=1e-2,
        motor_acceleration=1e-2,
        transmission=np.pi / 180,
        motor_velocity=np.pi / 180,
        torque=0.0,
    )
    estimator = ElasticJointFilter(robot, tuning, disturbances=False, biases=())
    run = simulate(robot, control, 10.0, 1000.0, feedback=estimator, sensors=noise, **settings)
    late = run.truth["t"] > 5
    assert np.sqrt(((run.known.q - run.truth["q"])[late] ** 2).mean()) < 0.1 * np.pi / 180
    assert np.abs(run.known.q - run.truth["q"]).max() < 2 * np.pi / 180


def bad(match, error=EstimatorError, **settings):
    arguments = {"robot": arm(), "controller": still, "duration": 0.1, "rate": 1000.0} | settings
    with pytest.raises(error, match=match):
        simulate(**arguments)


def raising(t, state):
    raise KeyError("gone")


def test_a_step_too_large_says_which_is_not():
    with pytest.raises(EstimatorError, match="largest stable one") as error:
        simulate(arm(), still, 0.1, 20.0)
    substeps = int(str(error.value).split("at least ")[1].split()[0])
    assert np.isfinite(simulate(arm(), still, 5.0, 20.0, q=[0.1, 0], tau=[0, 0], substeps=substeps).truth["q"]).all()
    bad("largest stable one", rate=20.0, substeps=substeps - 1)


def test_controllers_that_fail_are_named():
    bad(r"failed at t = 0.000000000 s: KeyError: 'gone'", controller=raising)
    bad(r"torque of joint 1 is NaN at t = 0", controller=lambda t, state: [0.0, np.nan])
    bad(r"has 3 entries, expected 2", controller=lambda t, state: [0.0] * 3)
    bad("failed", controller=lambda t, state: "push")
    bad("controller is a int", controller=3)


def test_the_function_s_own_error_is_the_cause():
    with pytest.raises(EstimatorError) as error:
        simulate(arm(), raising, 0.1, 1000.0)
    assert isinstance(error.value.__cause__, KeyError)


def test_a_loop_that_runs_away_names_the_time():
    bad("not finite at t", NumericalError, controller=lambda t, s: 1e3 * s.dtheta + 1e150, duration=10.0)


def test_settings_out_of_range():
    bad("duration is 0", duration=0)
    bad("rate is -1", rate=-1)
    bad("substeps is 0", substeps=0)
    bad("keep_every is 0.5", keep_every=0.5)
    bad("seed is -1", seed=-1)
    bad(r"q has shape \(3,\)", q=[0, 0, 0])
    bad("dq is NaN", dq=[0, np.nan])
    bad("feedback is 'guess'", feedback="guess")
    bad("sensors: 'camera'", sensors={"camera": Sensor()})
    bad("noise is -1", sensors={"theta": Sensor(noise=-1.0)})
    bad("bias is NaN", sensors={"theta": Sensor(bias=np.nan)})
    bad("corner_frequency is 0", sensors={"theta": Sensor(corner_frequency=0.0)})
    bad("every is 0", sensors={"theta": Sensor(every=0)})
    six = Robot.load(DATA / "kr15_six_axes" / "robot.yaml")
    bad("feedback is of another robot: its names are", feedback=ElasticJointFilter(six))
    bad("feedback is of another robot: its names are", feedback=AccelerationObserver(six))
    sensor = {"name": "imu", "link": "fore", "xyz": [0.1, 0, 0.3]}
    sensing = Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")], accelerometers=[sensor])
    bad("feedback is of another robot: its acceleration_channels are", feedback=AccelerationObserver(sensing))
    accelerations = AccelerationObserver(arm(), accelerations="joints")
    bad("link accelerations are not simulated", feedback=accelerations)


def test_an_indefinite_inertia_is_refused_with_the_robot():
    drives = [spring("shoulder"), spring("elbow")]
    with pytest.raises(linkside.ConfigError, match="positive definite"):
        Robot.from_urdf(ARM, drives, coupling={"shoulder": {"elbow": 50.0}})


def test_controllers_out_of_range():
    good = {"times": [0, 1], "command": [[0, 0, 0]] * 2}
    bad("axes is 'xx'", controller=SimpleAdaptive(**good, axes="xx"))
    bad("command has shape", controller=SimpleAdaptive(**good, axes="x"))
    bad("number of tools", controller=SimpleAdaptive(**good))
    for name, value in {"position": (-1, 0), "leakage": (0, np.nan), "bandwidth": 0, "joint_damping": np.inf}.items():
        bad("expected a finite number", controller=SimpleAdaptive(**good, **{name: value}))
    bad("kp has 3 entries, expected 1 or 2", controller=JointPD([1, 2, 3], 1, [0], [[0, 0]]))
    bad("kd is NaN", controller=JointPD(1, np.nan, [0], [[0, 0]]))
    bad("reference has 0 entries", controller=JointPD(1, 1, np.empty(0), np.empty((0, 2))))
    bad("time of a knot is 0", controller=JointPD(1, 1, [0, 0], [[0, 0]] * 2))
    bad("reference is NaN", controller=JointPD(1, 1, [0], [[0, np.nan]]))
