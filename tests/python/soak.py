"""Filters at work for days: a robot goes round, its sensors are noisy anew in each round, and truth is known.

    python tests/python/soak.py [--samples 1e7] [--joints 8] [--methods observer ekf ...]

Every method must be as good in the last tenth of the rounds as in the first after it has settled, and memory must not
grow. Prints a line a method, and what a week at 1 kHz would take; exit status 1 if one fails.
"""

import argparse
import sys
import time
from dataclasses import replace

import numpy as np
import psutil

from linkside import (
    AccelerationObserver,
    CubatureKalmanFilter,
    ElasticJointFilter,
    ExtendedKalmanFilter,
    Noise,
    ParticleFilter,
    ReducedOrderObserver,
    Robot,
    simulate,
)
from linkside.control.controllers import JointPD
from linkside.simulation import Sensor

RATE = 1000.0
ROUND = 4.0
"""A round of the motion [s]."""

WEEK = 7 * 24 * 3600 * RATE
"""Samples."""

ENCODER, ACCELEROMETER, GYROSCOPE, TORQUE = 2e-6, 0.05, 0.005, 1.0
"""Standard deviations of readings [rad, m/s², rad/s, N m]."""

SETTLING = 5
"""Rounds before errors count."""

METHODS = {
    "observer": lambda robot: AccelerationObserver(robot, period=1 / RATE),
    "reduced-order": lambda robot: ReducedOrderObserver(robot, period=1 / RATE),
    "ekf": lambda robot: ExtendedKalmanFilter(robot, Noise(jerk=50.0)),
    "ckf": lambda robot: CubatureKalmanFilter(robot, Noise(jerk=50.0)),
    "elastic-ekf": lambda robot: ElasticJointFilter(robot, motor_torque="held"),
    "particle": lambda robot: ParticleFilter(robot, Noise(jerk=50.0), particles=500),
}

COST = {"ckf": 5, "elastic-ekf": 2, "particle": 500}
"""By how much fewer samples a dear method gets."""


def robot_of(joints):
    """An arm of so many joints, with a gyroscope and an accelerometer on every second link."""
    link = (
        '<link name="l{i}"><inertial><origin xyz="0.1 0.01 0.15"/><mass value="{mass}"/>'
        '<inertia ixx="0.05" ixy="0" ixz="0" iyy="0.06" iyz="0" izz="0.02"/></inertial></link>'
    )
    joint = (
        '<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{k}"/><origin xyz="0.05 0 0.25"/>'
        '<axis xyz="{axis}"/><limit lower="-3" upper="3" effort="1e4" velocity="10"/></joint>'
    )
    parts = [link.format(i=i, mass=round(8 / (1 + i), 3)) for i in range(joints + 1)]
    parts += [joint.format(i=i, k=i + 1, axis=("0 0 1", "0 1 0", "1 0 0")[i % 3]) for i in range(joints)]
    places = [{"link": f"l{i}", "xyz": [0.1, 0.05, 0.2]} for i in range(1, joints + 1)]
    return Robot.from_urdf(
        f'<robot name="arm">{"".join(parts)}</robot>',
        [{"name": f"j{i}", "stiffness": 2e4, "damping": 20.0, "motor_inertia": 2.0} for i in range(joints)],
        accelerometers=[{"name": f"a{i}", "noise_std": ACCELEROMETER, **place} for i, place in enumerate(places)],
        encoder={"resolution": ENCODER * 12**0.5},
        torque={"noise_std": TORQUE},
        tool={"link": f"l{joints}", "xyz": [0.0, 0.0, 0.2]},
        rate_hz=RATE,
    )


def one_round(robot):
    """A round without noise, and its truth: the third, when what the start left is gone."""
    t = np.arange(0, 3 * ROUND + 1e-9, 1e-2)
    phase = 2 * np.pi * t / ROUND
    wave = np.stack([0.3 * np.sin(phase + i) + 0.1 * np.sin(3 * phase + 2 * i) for i in range(robot.n)], axis=1)
    inertia = np.diag(robot.mass_matrix(np.zeros(robot.n))) + 2.0
    control = JointPD(kp=2000 * inertia, kd=80 * inertia, times=t, theta=wave)
    exact = {kind: Sensor() for kind in ("theta", "acceleration")}
    run = simulate(robot, control, 3 * ROUND, RATE, q=wave[0], sensors=exact, substeps=4)
    rows = slice(round(2 * ROUND * RATE), round(3 * ROUND * RATE))
    return run.log[rows], run.truth["q"][rows]


def rounds(log, count, rng):
    """The round again and again, with new noise."""
    noise = {"theta": ENCODER, "acceleration": ACCELEROMETER, "tau": TORQUE}
    for number in range(count):
        signals = {
            name: getattr(log, name) + rng.normal(0, std, getattr(log, name).shape) for name, std in noise.items()
        }
        yield replace(log, t=log.t - log.t[0] + number * ROUND, **signals)


def soak(name, robot, samples, seed=0):
    """Run a method: samples, time [s], error at first and at last [rad], its spread, growth of memory [B]."""
    log, truth = one_round(robot)
    count = max(round(samples / len(log)), 4 * SETTLING)
    errors, memory, process = [], [], psutil.Process()
    began = time.process_time()
    for estimate in METHODS[name](robot).run_pieces(rounds(log, count, np.random.default_rng(seed))):
        errors.append(np.sqrt(np.mean((estimate.q - truth) ** 2)))
        memory.append(process.memory_info().rss)
    used = time.process_time() - began
    settled = np.array(errors[SETTLING:])
    tenth = max(len(settled) // 10, 1)
    grown = max(memory[-tenth:]) - max(memory[:SETTLING])
    return count * len(log), used, settled[:tenth].mean(), settled[-tenth:].mean(), settled.std(), grown


def main():
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=float, default=1e7)
    parser.add_argument("--joints", type=int, default=8)
    parser.add_argument("--methods", nargs="*", choices=METHODS, default=list(METHODS))
    told = parser.parse_args()
    robot, sound = robot_of(told.joints), True
    print("| method | samples | µs a sample | error at first [rad] | at last | memory grown [kB] | a week |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name in told.methods:
        count, used, first, last, spread, grown = soak(name, robot, told.samples / COST.get(name, 1))
        each = used / count
        print(
            f"| {name} | {count:.2g} | {1e6 * each:.1f} | {first:.3g} | {last:.3g} | {grown // 1024} "
            f"| {WEEK * each / 3600:.1f} h |",
            flush=True,
        )
        sound &= abs(last - first) < 4 * spread and grown < 20_000_000
    return 0 if sound else 1


if __name__ == "__main__":
    sys.exit(main())
