"""Dry friction of a link that changes its sign: a Kalman filter takes a side, particles keep both until readings tell.

A joint with a harmonic drive turns slowly to and fro by half a degree; its link sticks at each end, and slips when the
spring is wound up. Where the velocity changes its sign, the motor's reading changes by twice friction over stiffness,
forty times the encoder's noise. Linearised at one velocity the reading says nothing of velocity or, creeping,
everything. Robot, noise and readings are the same for both. The last row is a Kalman filter that is told that friction
may be wrong by all of it.

    python examples/coulomb.py [--seeds N]
"""

from __future__ import annotations

import argparse

import numpy as np
import numpy.typing as npt

from linkside import ExtendedKalmanFilter, Noise, ParticleFilter, Robot, Sensor, Simulation, simulate
from linkside.control.controllers import JointPD

FloatArray = npt.NDArray[np.float64]
Method = ExtendedKalmanFilter | ParticleFilter

STIFFNESS, FRICTION, CREEP = 1e4, 4.0, 1e-4
ENCODER_STD, ACCELERATION_STD = 2e-5, 1.0
AMPLITUDE, PERIOD, DURATION, RATE = 0.01, 2.0, 4.0, 1000.0
SETTLED = 200
URDF = """<robot name="one"><link name="base"/><link name="arm">
  <inertial><origin xyz="0.3 0 0"/><mass value="4"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-7" upper="7" effort="1" velocity="1"/></joint></robot>"""


def main() -> None:
    """Estimate a few recordings, by both."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3, help="of noise and particles")
    seeds = range(parser.parse_args().seeds)
    robot = one_joint()
    recordings = [recording(robot, seed) for seed in seeds]
    noise = Noise(transmission=ENCODER_STD, motor_bias=0.0, motor_bias_walk=0.0)
    kalman = ExtendedKalmanFilter(robot, noise)
    wide = ExtendedKalmanFilter(robot, noise.updated(transmission=FRICTION / STIFFNESS))
    particles = [ParticleFilter(robot, noise, seed=seed, collapse="flag") for seed in seeds]
    print(f"{'link position, RMS [µrad] (NEES)':32} by recording")
    show("EKF", [kalman] * len(seeds), recordings)
    show("particles", particles, recordings)
    show("EKF, friction as noise", [wide] * len(seeds), recordings)


def one_joint() -> Robot:
    """Make an arm on a vertical axis, dry friction in its bearing, an accelerometer at its tip."""
    friction = [0.0, 0.0, 0.0, FRICTION, 1 / CREEP, 0.0]  # F tanh(q̇ / creep)
    drive = {"name": "j", "stiffness": STIFFNESS, "damping": 5.0, "motor_inertia": 1.0, "link_friction": friction}
    sensor = {"name": "a", "link": "arm", "xyz": [0.6, 0, 0], "noise_std": ACCELERATION_STD, "axes": "y"}
    return Robot.from_urdf(URDF, joints=[drive], accelerometers=[sensor], encoder={"resolution": 1e-6})


def recording(robot: Robot, seed: int) -> Simulation:
    """Simulate the motor following a cosine, and the link the motor."""
    t = np.arange(0.0, DURATION, 5e-3)
    path = 0.5 * AMPLITUDE * (1 - np.cos(2 * np.pi / PERIOD * t))
    control = JointPD(kp=2e4, kd=300.0, times=t, theta=path[:, None])
    sensors = {
        "theta": Sensor(noise=ENCODER_STD),
        "dtheta": Sensor(noise=1e-3),
        "acceleration": Sensor(noise=ACCELERATION_STD, bias=0.05),
    }
    tolerance = {"integrator": "adaptive", "rtol": 1e-8, "atol": 1e-10}
    return simulate(robot, control, DURATION, RATE, sensors=sensors, seed=seed, **tolerance)


def show(name: str, methods: list[Method], recordings: list[Simulation]) -> None:
    """One line."""
    judged = [judge(method, run) for method, run in zip(methods, recordings, strict=True)]
    print(f"{name:32}" + "".join(f"{error:8.1f} ({nees:.1f})" for error, nees in judged))


def judge(method: Method, run: Simulation) -> tuple[float, float]:
    """RMS error of the link's position [µrad], and of position and velocity in units of their covariance, squared."""
    estimate = method.run(run.log, covariance=True)
    assert estimate.covariance is not None
    error = np.concatenate([estimate.q - run.truth["q"], estimate.dq - run.truth["dq"]], axis=1)[SETTLED:]
    covariance = estimate.covariance[SETTLED:, :2, :2]
    square = np.einsum("ti,ti->t", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])
    return 1e6 * float(np.sqrt(np.mean(error[:, 0] ** 2))), float(np.mean(square)) / 2


if __name__ == "__main__":
    main()
