"""Two beliefs that a Kalman filter cannot hold: one cut off by joint limits, and one with two peaks.

An incremental encoder tells how far a motor went since it was switched on, not where it is.

Homing without a stop: a joint that has used most of its range can only be where its limits leave room for that. Nothing
in the readings says so, and a mean with a covariance cannot.

One axis of an accelerometer: on a pendulum it reads g sin q, the same at q and at π - q, until the pendulum moves.

    python examples/constraints.py [--seeds N]
"""

from __future__ import annotations

import argparse

import numpy as np
import numpy.typing as npt

import linkside
from linkside import Log, Noise, ParticleFilter, Robot

FloatArray = npt.NDArray[np.float64]

MASS, ARM, INERTIA, STIFFNESS, SENSOR, GRAVITY = 2.0, 0.5, 0.1, 3e4, 0.8, 9.81
PERIOD, ENCODER_STD, ACCELERATION_STD = 1e-3, 1e-3, 0.05
URDF = """<robot name="one"><link name="base"/><link name="arm">
  <inertial><origin xyz="0 0 {low}"/><mass value="{mass}"/>
    <inertia ixx="{i}" ixy="0" ixz="0" iyy="{i}" iyz="0" izz="{i}"/></inertial></link>
  <joint name="j" type="revolute"><parent link="base"/><child link="arm"/><origin rpy="{roll} 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-7" upper="7" effort="1" velocity="1"/></joint></robot>"""


def main() -> None:
    """Estimate both, by both."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3, help="how often the particle filter is repeated")
    seeds = range(parser.parse_args().seeds)
    print(f"{'error at the end [rad]':34}{'EKF':>8}   particles, by seed")
    show("limits of ±0.5 rad", *homing(seeds))
    for q in (0.8, np.pi - 0.8):
        show(f"two peaks, truth is {q:.2f} rad", *two_peaks(q, seeds))


def homing(seeds: range) -> tuple[float, list[float]]:
    """Estimate a horizontal arm that starts 0.03 rad off its lower limit, with an encoder that is 0.07 rad out."""
    robot, log, truth = recording(-0.47, 0.96, reads=-0.40, gravity=0.0)
    noise = Noise(motor_bias=0.1, position=0.1, transmission=ENCODER_STD, jerk=30.0)
    kalman = linkside.ExtendedKalmanFilter(robot, noise)
    settings = {"particles": 2000, "kernel": 1.0, "limits": {"j": (-0.5, 0.5)}, "start": "rest"}
    ours = [ParticleFilter(robot, noise, seed=seed, **settings) for seed in seeds]
    return error(kalman, log, truth), [error(method, log, truth) for method in ours]


def two_peaks(start: float, seeds: range) -> tuple[float, list[float]]:
    """Estimate a pendulum that was switched on somewhere, its accelerometer reading g sin 0.8."""
    robot, log, truth = recording(start, 0.3, reads=0.0, gravity=GRAVITY)
    known = {"motor_bias": 3.0, "acceleration_bias": 0.02, "transmission": ENCODER_STD, "jerk": 20.0}
    kalman = linkside.ExtendedKalmanFilter(robot, Noise(position=3.0, **known))
    peaks = [[0.8], [np.pi - 0.8]]
    noise = Noise(position=0.02, **known)
    ours = [ParticleFilter(robot, noise, particles=4000, kernel=None, initial=peaks, seed=seed) for seed in seeds]
    return error(kalman, log, truth), [error(method, log, truth) for method in ours]


def recording(start: float, travel: float, *, reads: float, gravity: float) -> tuple[Robot, Log, float]:
    """One joint that goes there and back in a second; returns its last position also."""
    t = PERIOD * np.arange(1200)
    phase = 2 * np.pi * np.clip(t - 0.02, 0.0, 1.0)
    q: FloatArray = start + 0.5 * travel * (1 - np.cos(phase))
    ddq = np.where((t > 0.02) & (t < 1.02), 2 * np.pi**2 * travel * np.cos(phase), 0.0)
    torque = (INERTIA + MASS * ARM**2) * ddq + MASS * ARM * gravity * np.sin(q)
    theta = q + torque / STIFFNESS
    rng = np.random.default_rng(0)
    theta += reads - theta[0] + ENCODER_STD * rng.standard_normal(len(t))
    acceleration = -SENSOR * ddq - gravity * np.sin(q) + ACCELERATION_STD * rng.standard_normal(len(t))
    robot = one_joint(horizontal=gravity == 0.0)
    return robot, Log.from_table({"t": t, "theta_j": theta, "a_x": acceleration}, robot, check=False), float(q[-1])


def one_joint(*, horizontal: bool) -> Robot:
    """Make an arm that hangs, or one that turns about a vertical axis."""
    urdf = URDF.format(low=-ARM, mass=MASS, i=INERTIA, roll=np.pi / 2 if horizontal else 0.0)
    drive = {"name": "j", "stiffness": STIFFNESS, "damping": 0.0, "motor_inertia": 1.0}
    sensor = {"name": "a", "link": "arm", "xyz": [0, 0, -SENSOR], "noise_std": ACCELERATION_STD, "axes": "x"}
    return Robot.from_urdf(urdf, joints=[drive], accelerometers=[sensor], encoder={"resolution": 1e-6})


def error(method: linkside.ExtendedKalmanFilter | ParticleFilter, log: Log, truth: float) -> float:
    """Last estimate less the truth [rad]."""
    return float(method.run(log).q[-1, 0] - truth)


def show(name: str, kalman: float, ours: list[float]) -> None:
    """One line."""
    print(f"{name:34}{kalman:8.3f}   " + " ".join(f"{e:.3f}" for e in ours))


if __name__ == "__main__":
    main()
